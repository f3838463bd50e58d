//! A table as text within a width: where it is too wide, headers wrap at blanks; columns that still do not fit follow
//! below, each block with the columns that name a row.

use std::io::IsTerminal;

use comfy_table::{Attribute, Cell, CellAlignment, LineStyle, TableStyle};

use super::table::Table;

/// A single rule below the header.
const RULED: TableStyle = TableStyle::new().header_separator(LineStyle::none().fill('─').junction('─'));
/// Characters of a line where standard output is no terminal.
const LINE: usize = 80;
/// Characters of a line beside those of a column's cell: usually, and in a table that is too wide.
const GAPS: [usize; 2] = [3, 2];

impl Table {
    /// Text for standard output, within the terminal's width, or 80 characters: uses bold only on a terminal and if
    /// `NO_COLOR` is not set.
    pub fn to_terminal(&self) -> String {
        let wanted = std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
        let width = comfy_table::Table::new().width().map_or(LINE, usize::from);
        self.render(wanted && std::io::stdout().is_terminal(), width)
    }

    /// Text without escape sequences, the same everywhere, as wide as its cells.
    pub fn to_plain(&self) -> String {
        self.render(false, usize::MAX)
    }

    pub(super) fn render(&self, styled: bool, width: usize) -> String {
        let title = if self.title.is_empty() { String::new() } else { wrapped(&self.title, width) + "\n" };
        format!("{title}{}", draw(self, styled, width))
    }
}

/// The table without its title, in lines of at most `width` characters if its cells allow that.
fn draw(table: &Table, styled: bool, width: usize) -> String {
    let all: Vec<usize> = (0..table.columns()).collect();
    let whole: Vec<String> = all.iter().map(|index| table.head(*index).to_owned()).collect();
    let narrow: Vec<String> = all.iter().map(|index| wrapped(&whole[*index], table.widest(*index))).collect();
    let [usual_gap, small_gap] = GAPS;
    let column =
        |heads: &[String], gap: usize, index: usize| gap + table.widest(index).max(length(&heads[index]));
    for (heads, gap) in [(&whole, usual_gap), (&narrow, usual_gap), (&narrow, small_gap)] {
        if all.iter().map(|index| column(heads, gap, *index)).sum::<usize>() <= width {
            return block(table, styled, &all, heads, gap);
        }
    }
    let column = |index: usize| column(&narrow, small_gap, index);
    let fits = |names: usize| (0..names).map(column).sum::<usize>() <= width / 2;
    let named = (1..=all.len()).find(|names| fits(*names) && table.is_named_by(*names));
    let names = named.unwrap_or(1);
    let blocks = blocks(names, all.len(), column, width);
    let drawn = blocks.iter().map(|columns| block(table, styled, columns, &narrow, small_gap));
    drawn.collect::<Vec<_>>().join("\n\n")
}

/// The columns of each block: those that name a row, and some of the others.
fn blocks(names: usize, columns: usize, wide: impl Fn(usize) -> usize, width: usize) -> Vec<Vec<usize>> {
    let named: Vec<usize> = (0..names).collect();
    let mut blocks = vec![named.clone()];
    for index in names..columns {
        let last = blocks.len() - 1;
        let used: usize = blocks[last].iter().map(|index| wide(*index)).sum();
        if used + wide(index) > width && blocks[last].len() > names {
            blocks.push(named.clone());
        }
        let last = blocks.len() - 1;
        blocks[last].push(index);
    }
    blocks
}

/// A text in lines of at most `width` characters, or of its longest word.
fn wrapped(text: &str, width: usize) -> String {
    let width = text.split(' ').map(|word| word.chars().count()).max().unwrap_or(0).max(width);
    let mut lines: Vec<String> = Vec::new();
    for word in text.split(' ') {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines.join("\n")
}

/// Characters of the longest line.
fn length(text: &str) -> usize {
    text.lines().map(|line| line.chars().count()).max().unwrap_or(0)
}

fn block(table: &Table, styled: bool, columns: &[usize], heads: &[String], gap: usize) -> String {
    let mut drawn = comfy_table::Table::new();
    drawn.load_style(RULED).force_no_tty();
    if styled {
        drawn.enforce_styling();
    }
    let align = |index| if table.is_numeric(index) { CellAlignment::Right } else { CellAlignment::Left };
    drawn.set_header(columns.iter().map(|&index| Cell::new(&heads[index]).set_alignment(align(index))));
    for row in &table.rows {
        drawn.add_row(columns.iter().map(|&index| {
            let cell = row.get(index).cloned().unwrap_or_default();
            let text = Cell::new(table.starred(index, &cell)).set_alignment(align(index));
            if styled && cell.is_best() { text.add_attribute(Attribute::Bold) } else { text }
        }));
    }
    let right = (gap - GAPS[1]) as u16;
    for column in drawn.column_iter_mut() {
        column.set_padding((1, right));
    }
    drawn.lines().map(|line| line.trim_end().to_owned()).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::super::table::Cell as Value;
    use super::*;

    fn table(columns: usize) -> Table {
        let heads: Vec<String> = (0..columns).map(|n| format!("pressure of unit {n}")).collect();
        let mut table = Table::new("", &heads.iter().map(String::as_str).collect::<Vec<_>>());
        let numbers = (1..columns).map(|n| Value::number(n as f64, 2));
        table.row([Value::text("R20C20")].into_iter().chain(numbers).collect());
        table
    }

    #[test]
    fn a_wide_table_stays_within_its_lines_and_loses_no_column() {
        for columns in 1..30 {
            let text = table(columns).render(false, LINE);
            assert!(text.lines().all(|line| line.chars().count() <= LINE), "{text}");
            for n in 1..columns {
                assert!(text.contains(&format!("{n}.00")), "{text}");
            }
        }
    }

    #[test]
    fn a_table_that_fits_is_drawn_as_it_is() {
        assert_eq!(table(3).render(false, LINE), table(3).to_plain());
    }

    #[test]
    fn rows_of_one_name_keep_the_columns_that_tell_them_apart() {
        let mut table = table(20);
        let mut other = table.rows[0].clone();
        other[1] = Value::number(1.5, 2);
        table.row(other);
        let text = table.render(false, LINE);
        for block in text.split("\n\n") {
            assert!(block.contains("1.00") && block.contains("1.50"), "{text}");
        }
    }

    #[test]
    fn each_block_names_its_rows() {
        let text = table(20).render(false, LINE);
        assert_eq!(text.matches("R20C20").count(), text.split("\n\n").count(), "{text}");
        assert!(text.matches("R20C20").count() > 1, "{text}");
    }
}
