//! Tables for the terminal and for HTML from one description.

use std::io::IsTerminal;

use comfy_table::{Attribute, CellAlignment, LineStyle, TableStyle};

use super::html::escape;

/// One rule, below the heads.
const RULED: TableStyle = TableStyle::new().header_separator(LineStyle::none().fill('─').junction('─'));

/// One cell.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Cell {
    text: String,
    numeric: bool,
    best: bool,
}

impl Cell {
    /// Words, to the left.
    pub fn text(text: impl Into<String>) -> Self {
        Self { text: text.into(), ..Self::default() }
    }

    /// For Markdown: the best of its kind is bold.
    pub(super) fn to_markdown(&self) -> String {
        let text = self.text.replace('|', "\\|");
        if self.best { format!("**{text}**") } else { text }
    }

    /// A number with so many decimals, to the right. NaN shows as `NaN`.
    pub fn number(value: f64, decimals: usize) -> Self {
        Self { text: format!("{value:.decimals$}"), numeric: true, best: false }
    }

    /// A number that may be unknown, which shows as `-`.
    pub fn known(value: Option<f64>, decimals: usize) -> Self {
        value.map_or_else(|| Self::right("-"), |value| Self::number(value, decimals))
    }

    /// A whole number, to the right.
    pub fn count(value: usize) -> Self {
        Self { text: value.to_string(), numeric: true, best: false }
    }

    /// A number that is written already, with its unit perhaps, to the right.
    pub fn right(text: impl Into<String>) -> Self {
        Self { text: text.into(), numeric: true, best: false }
    }

    /// Marks the best of its kind, if it is that: a star, bold where there is bold.
    #[must_use]
    pub fn best_if(self, best: bool) -> Self {
        Self { best, ..self }
    }
}

/// Head of a column, with the unit, and its cell for an item.
pub type Column<'a, T> = (&'a str, &'a dyn Fn(&T) -> Cell);

/// A table. A column stands to the right if its first row holds a number there.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Table {
    /// Line above the table; may be empty.
    pub title: String,
    /// Heads of the columns, with units.
    pub header: Vec<String>,
    /// Cells; short rows are filled with empty ones.
    pub rows: Vec<Vec<Cell>>,
}

impl Table {
    /// Table without rows.
    pub fn new(title: impl Into<String>, header: &[&str]) -> Self {
        let header = header.iter().map(|&head| head.to_owned()).collect();
        Self { title: title.into(), header, rows: Vec::new() }
    }

    /// Table with a row for each item; a column is its head and what stands in it.
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

    /// For standard output: bold marks only on a terminal and unless `NO_COLOR` is set.
    pub fn to_terminal(&self) -> String {
        let wanted = std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
        self.render(wanted && std::io::stdout().is_terminal())
    }

    /// As text without any escape sequence, the same everywhere.
    pub fn to_plain(&self) -> String {
        self.render(false)
    }

    pub(super) fn render(&self, styled: bool) -> String {
        let mut table = comfy_table::Table::new();
        table.load_style(RULED).force_no_tty();
        if styled {
            table.enforce_styling();
        }
        let align = |index| {
            if self.is_numeric(index) { CellAlignment::Right } else { CellAlignment::Left }
        };
        table.set_header(
            (0..self.columns())
                .map(|index| comfy_table::Cell::new(self.head(index)).set_alignment(align(index))),
        );
        for row in &self.rows {
            table.add_row((0..self.columns()).map(|index| {
                let cell = row.get(index).cloned().unwrap_or_default();
                let drawn = comfy_table::Cell::new(self.starred(index, &cell)).set_alignment(align(index));
                if styled && cell.best { drawn.add_attribute(Attribute::Bold) } else { drawn }
            }));
        }
        let body: Vec<_> = table.lines().map(|line| line.trim_end().to_owned()).collect();
        let title = if self.title.is_empty() { String::new() } else { format!("{}\n", self.title) };
        format!("{title}{}", body.join("\n"))
    }

    /// Right-aligned columns with a star keep a blank in its place, so that digits stay in line.
    fn starred(&self, index: usize, cell: &Cell) -> String {
        let stars = self.rows.iter().any(|row| row.get(index).is_some_and(|cell| cell.best));
        match (cell.best, stars && self.is_numeric(index)) {
            (true, _) => format!("{}*", cell.text),
            (false, true) => format!("{} ", cell.text),
            (false, false) => cell.text.clone(),
        }
    }

    /// Columns of the longest row.
    fn columns(&self) -> usize {
        self.rows.iter().map(Vec::len).chain([self.header.len()]).max().unwrap_or(0)
    }

    fn head(&self, index: usize) -> &str {
        self.header.get(index).map_or("", String::as_str)
    }

    pub(super) fn is_numeric(&self, index: usize) -> bool {
        self.rows.first().and_then(|row| row.get(index)).is_some_and(|cell| cell.numeric)
    }

    /// As an HTML `table` element.
    pub fn to_html(&self) -> String {
        let class = |index| {
            if self.is_numeric(index) { " class=\"number\"" } else { "" }
        };
        let head = |index| format!("<th{}>{}</th>", class(index), escape(self.head(index)));
        let mut html = String::from("<div class=\"scroll\"><table>\n");
        html.extend(
            (!self.title.is_empty()).then(|| format!("<caption>{}</caption>\n", escape(&self.title))),
        );
        html += "<thead><tr>";
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
        html + "</tbody></table></div>\n"
    }
}
