//! A drawing, as a separate file or as part of a page, and the elements that it consists of, one in each line. Lengths are pixels.

use std::fmt::Write;

use super::curve::Point;
use super::role::{PAPER, own_style};
use super::text::escape;

/// SVG elements and their frame.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Svg {
    /// Width and height.
    pub size: (f64, f64),
    /// The SVG elements.
    pub elements: String,
}

impl Svg {
    /// Drawings below each other.
    pub fn stacked(drawings: &[Self]) -> Self {
        let mut whole = Self::default();
        for Self { size: (width, height), elements } in drawings {
            let top = whole.size.1;
            let _ = write!(whole.elements, "<g transform=\"translate(0 {top})\">\n{elements}</g>\n");
            whole.size = (whole.size.0.max(*width), top + height);
        }
        whole
    }

    /// A standalone document, with a background and colours for light and dark pages.
    pub fn to_document(&self) -> String {
        let own = format!("<style>\n{}</style>\n{}", own_style(), rectangle((0.0, 0.0), self.size, PAPER.0));
        self.element("", " xmlns=\"http://www.w3.org/2000/svg\"", &own)
    }

    /// A part of an HTML page, which has the style and needs no namespace; screen readers read `label`.
    pub fn to_html(&self, label: &str) -> String {
        self.element(&format!(" role=\"img\" aria-label=\"{}\"", escape(label)), "", "")
    }

    fn element(&self, before: &str, after: &str, own: &str) -> String {
        let Self { size: (width, height), elements } = self;
        format!(
            "<svg{before} width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\"{after}>\n{own}{elements}</svg>\n"
        )
    }
}

/// A line that joins points.
pub(super) fn line(points: &[Point], color: &str, width: f64, dashed: bool) -> String {
    let points: Vec<String> = points.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    let dashes = if dashed { " stroke-dasharray=\"7 5\"" } else { "" };
    format!(
        "<polyline points=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"{width}\"{dashes}/>\n",
        points.join(" ")
    )
}

/// A filled rectangle between two opposite corners.
pub(super) fn rectangle((x, y): Point, (other_x, other_y): Point, color: &str) -> String {
    format!(
        "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{color}\"/>\n",
        x.min(other_x),
        y.min(other_y),
        (other_x - x).abs(),
        (other_y - y).abs()
    )
}

/// A dot.
pub(super) fn dot((x, y): Point, color: &str) -> String {
    format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\" fill=\"{color}\"/>\n")
}

/// Words whose line is at `y`, with more attributes.
pub(super) fn text((x, y): Point, attributes: &str, words: &str) -> String {
    format!(
        "<text x=\"{x:.1}\" y=\"{y:.1}\" font-family=\"sans-serif\" fill=\"currentColor\" {attributes}>{}</text>\n",
        escape(words)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drawing_is_a_document_or_a_part_of_a_page() {
        let svg = Svg { size: (80.0, 40.5), elements: "<g/>\n".to_owned() };
        let document = svg.to_document();
        let head = "<svg width=\"80\" height=\"40.5\" viewBox=\"0 0 80 40.5\" xmlns=\"http://www.w3.org/2000/svg\">\n<style>\n";
        assert!(
            document.starts_with(head) && document.ends_with("fill=\"#FFFFFF\"/>\n<g/>\n</svg>\n"),
            "{document}"
        );
        assert!(document.contains("@media (prefers-color-scheme: dark)"));
        assert_eq!(
            svg.to_html("a < b"),
            "<svg role=\"img\" aria-label=\"a &lt; b\" width=\"80\" height=\"40.5\" viewBox=\"0 0 80 40.5\">\n<g/>\n</svg>\n"
        );
    }

    #[test]
    fn drawings_are_stacked_below_each_other() {
        let svg = |width, height| Svg { size: (width, height), elements: "<g/>\n".to_owned() };
        let both = Svg::stacked(&[svg(80.0, 40.0), svg(60.0, 20.0)]);
        assert_eq!(both.size, (80.0, 60.0));
        assert_eq!(
            both.elements,
            "<g transform=\"translate(0 0)\">\n<g/>\n</g>\n<g transform=\"translate(0 40)\">\n<g/>\n</g>\n"
        );
    }
}
