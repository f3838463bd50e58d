//! Tables for the terminal, HTML and Markdown from one description.

use std::collections::HashSet;

use super::text::escape;

/// One cell.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct Cell {
    text: String,
    numeric: bool,
    best: bool,
}

impl Cell {
    /// Left-aligned text.
    pub fn text(text: impl Into<String>) -> Self {
        Self { text: text.into(), ..Self::default() }
    }

    /// For Markdown: a marked cell is bold.
    pub(super) fn to_markdown(&self) -> String {
        let text = self.text.replace('|', "\\|");
        if self.best { format!("**{text}**") } else { text }
    }

    pub(super) fn is_best(&self) -> bool {
        self.best
    }

    /// A right-aligned number with `decimals` decimals. NaN shows as `NaN`.
    pub fn number(value: f64, decimals: usize) -> Self {
        Self { text: format!("{value:.decimals$}"), numeric: true, best: false }
    }

    /// A number that may be unknown, which shows as `-`.
    pub fn known(value: Option<f64>, decimals: usize) -> Self {
        value.map_or_else(|| Self::right("-"), |value| Self::number(value, decimals))
    }

    /// A right-aligned whole number.
    pub fn count(value: usize) -> Self {
        Self { text: value.to_string(), numeric: true, best: false }
    }

    /// Right-aligned text, for example a number with its unit.
    pub fn right(text: impl Into<String>) -> Self {
        Self { text: text.into(), numeric: true, best: false }
    }

    /// Marks the cell if it is the best of its kind: with a star, and in bold where available.
    #[must_use]
    pub fn best_if(self, best: bool) -> Self {
        Self { best, ..self }
    }
}

/// Header of a column, with the unit, and its cell for an item.
pub type Column<'a, T> = (&'a str, &'a dyn Fn(&T) -> Cell);

/// A table. A column is right-aligned if its first row has a number there.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Table {
    /// Title above the table; may be empty.
    pub title: String,
    /// Headers of the columns, with units.
    pub header: Vec<String>,
    /// Cells; short rows are padded with empty cells.
    pub rows: Vec<Vec<Cell>>,
}

impl Table {
    /// A table without rows.
    pub fn new(title: impl Into<String>, header: &[&str]) -> Self {
        let header = header.iter().map(|&head| head.to_owned()).collect();
        Self { title: title.into(), header, rows: Vec::new() }
    }

    /// A table with a row for each item; a column is its header and a function that makes its cell.
    pub fn of<T>(title: impl Into<String>, items: &[T], columns: &[Column<'_, T>]) -> Self {
        let row = |item: &T| columns.iter().map(|(_, cell)| cell(item)).collect();
        Self {
            title: title.into(),
            header: columns.iter().map(|(head, _)| (*head).to_owned()).collect(),
            rows: items.iter().map(row).collect(),
        }
    }

    /// Adds a row.
    pub fn row(&mut self, cells: Vec<Cell>) {
        self.rows.push(cells);
    }

    /// The text of a cell; right-aligned columns with a star get a blank in its place elsewhere, so that digits align.
    pub(super) fn starred(&self, index: usize, cell: &Cell) -> String {
        let stars = self.rows.iter().any(|row| row.get(index).is_some_and(|cell| cell.best));
        match (cell.best, stars && self.is_numeric(index)) {
            (true, _) => format!("{}*", cell.text),
            (false, true) => format!("{} ", cell.text),
            (false, false) => cell.text.clone(),
        }
    }

    /// Number of columns of the longest row.
    pub(super) fn columns(&self) -> usize {
        self.rows.iter().map(Vec::len).chain([self.header.len()]).max().unwrap_or(0)
    }

    pub(super) fn head(&self, index: usize) -> &str {
        self.header.get(index).map_or("", String::as_str)
    }

    /// Whether the first `columns` cells of the rows are different in each row.
    pub(super) fn is_named_by(&self, columns: usize) -> bool {
        let mut names = HashSet::new();
        self.rows.iter().all(|row| names.insert(&row[..columns.min(row.len())]))
    }

    /// Characters of a column's longest cell.
    pub(super) fn widest(&self, index: usize) -> usize {
        let cells = self.rows.iter().filter_map(|row| row.get(index));
        let lengths = |cell| self.starred(index, cell).lines().map(|line| line.chars().count()).max();
        cells.filter_map(lengths).max().unwrap_or(0)
    }

    pub(super) fn is_numeric(&self, index: usize) -> bool {
        self.rows.first().and_then(|row| row.get(index)).is_some_and(|cell| cell.numeric)
    }

    /// As an HTML table that scrolls in a box of its own, below its caption.
    pub fn to_html(&self) -> String {
        let class = |index| {
            if self.is_numeric(index) { " class=\"number\"" } else { "" }
        };
        let head = |index| format!("<th{}>{}</th>", class(index), escape(self.head(index)));
        // Outside the box that scrolls, so that the caption is as wide as the page.
        let caption = format!("<figcaption>{}</figcaption>\n", escape(&self.title));
        let mut html = String::from("<figure class=\"table\">\n");
        html.extend((!self.title.is_empty()).then_some(caption));
        html += "<div class=\"scroll\"><table>\n<thead><tr>";
        html.extend((0..self.columns()).map(head));
        html += "</tr></thead>\n<tbody>\n";
        for row in &self.rows {
            html += "<tr>";
            html.extend((0..self.columns()).map(|index| {
                let cell = row.get(index).cloned().unwrap_or_default();
                let text = escape(&cell.text);
                let text = if cell.best { format!("<strong>{text}</strong>") } else { text };
                format!("<td{}>{text}</td>", class(index))
            }));
            html += "</tr>\n";
        }
        html + "</tbody></table></div>\n</figure>\n"
    }
}
