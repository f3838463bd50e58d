//! A drawing, as a separate file or as part of a page.

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
}
