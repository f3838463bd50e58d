//! A drawing, as a separate file or as part of a page.

use std::fmt::Write;

use super::html::escape;

/// SVG elements and their frame.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Svg {
    /// Width and height on the page, pixels.
    pub size: (f64, f64),
    /// Width and height of the canvas, in the units of the elements.
    pub canvas: (f64, f64),
    /// The SVG elements.
    pub elements: String,
}

impl Svg {
    /// Drawings of one scale below each other.
    pub fn stacked(drawings: &[Self]) -> Self {
        let mut whole = Self { size: (0.0, 0.0), canvas: (0.0, 0.0), elements: String::new() };
        for drawing in drawings {
            let top = whole.canvas.1;
            let _ =
                write!(whole.elements, "<g transform=\"translate(0 {top})\">\n{}</g>\n", drawing.elements);
            whole.size = (whole.size.0.max(drawing.size.0), whole.size.1 + drawing.size.1);
            whole.canvas = (whole.canvas.0.max(drawing.canvas.0), top + drawing.canvas.1);
        }
        whole
    }

    /// A standalone document.
    pub fn to_document(&self) -> String {
        self.element("", " xmlns=\"http://www.w3.org/2000/svg\"")
    }

    /// A part of an HTML page, which needs no namespace; screen readers read `label`.
    pub fn to_html(&self, label: &str) -> String {
        self.element(&format!(" role=\"img\" aria-label=\"{}\"", escape(label)), "")
    }

    fn element(&self, before: &str, after: &str) -> String {
        let Self { size: (width, height), canvas: (x, y), elements } = self;
        format!(
            "<svg{before} width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {x} {y}\"{after}>\n{elements}</svg>\n"
        )
    }
}

/// The elements within the root element of a document.
pub(super) fn elements(document: &str) -> Option<&str> {
    let (_, content) = document.split_once(">\n")?;
    content.strip_suffix("</svg>\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drawing_is_a_document_or_a_part_of_a_page() {
        let svg = Svg { size: (80.0, 40.0), canvas: (320.0, 160.5), elements: "<g/>\n".to_owned() };
        let document = svg.to_document();
        assert_eq!(
            document,
            "<svg width=\"80\" height=\"40\" viewBox=\"0 0 320 160.5\" xmlns=\"http://www.w3.org/2000/svg\">\n<g/>\n</svg>\n"
        );
        assert_eq!(elements(&document), Some("<g/>\n"));
        assert_eq!(
            svg.to_html("a < b"),
            "<svg role=\"img\" aria-label=\"a &lt; b\" width=\"80\" height=\"40\" viewBox=\"0 0 320 160.5\">\n<g/>\n</svg>\n"
        );
        assert_eq!(elements("<svg>"), None);
    }

    #[test]
    fn drawings_are_stacked_below_each_other() {
        let svg = |width, height| Svg {
            size: (width, height),
            canvas: (4.0 * width, 4.0 * height),
            elements: "<g/>\n".to_owned(),
        };
        let both = Svg::stacked(&[svg(80.0, 40.0), svg(60.0, 20.0)]);
        assert_eq!((both.size, both.canvas), ((80.0, 60.0), (320.0, 240.0)));
        assert_eq!(
            both.elements,
            "<g transform=\"translate(0 0)\">\n<g/>\n</g>\n<g transform=\"translate(0 160)\">\n<g/>\n</g>\n"
        );
    }
}
