//! A report as Markdown, with its plots in separate files, for places that do not show HTML.

use std::path::Path;

use super::{Block, Cell, Plot, Report, ReportError, Section, Table};
use data::files::write_atomically;

impl Report {
    /// Writes `name.md` to a folder, and each plot to its subfolder `figures`.
    ///
    /// # Errors
    /// A plot that cannot be drawn, or a file that cannot be written.
    pub fn save_markdown(&self, folder: &Path, name: &str) -> Result<(), ReportError> {
        let write = |file: String, text: &str| {
            let path = folder.join(file);
            write_atomically(&path, text.as_bytes()).map_err(|source| ReportError::Write { path, source })
        };
        for plot in self.plots() {
            write(figure(plot), &plot.to_svg()?)?;
        }
        write(format!("{name}.md"), &self.to_markdown())
    }

    fn plots(&self) -> impl Iterator<Item = &Plot> {
        let blocks = self.sections.iter().flat_map(|section| &section.blocks);
        blocks.flat_map(|block| match block {
            Block::Plot(plot) => std::slice::from_ref(plot),
            Block::PlotRow(plots) => plots,
            Block::Table(_) | Block::HeatMap(_) | Block::Text(_) | Block::Command(_) => &[],
        })
    }

    fn to_markdown(&self) -> String {
        let head = format!("# {}\n\n{}\n", self.title, self.subtitle);
        let sections: String = self.sections.iter().map(Section::to_markdown).collect();
        let foot = self.provenance.as_ref().map_or_else(String::new, |provenance| {
            let origin = format!("Seed {}, revision {}.", provenance.seed, provenance.git_revision);
            let lines = std::iter::once(&origin).chain(&provenance.notes);
            lines.flat_map(|line| ["\n", line, "\n"]).collect()
        });
        head + &sections + &foot
    }
}

impl Section {
    fn to_markdown(&self) -> String {
        let block = |block: &Block| match block {
            Block::Table(table) => format!("\n{}", table.to_markdown()),
            Block::Plot(plot) => format!("\n{}", image(plot)),
            Block::PlotRow(plots) => format!("\n{}", plots.iter().map(image).collect::<String>()),
            Block::Text(words) => format!("\n{words}\n"),
            Block::Command(line) => format!("\n    {line}\n"),
            // Only the HTML page shows maps.
            Block::HeatMap(_) => String::new(),
        };
        let blocks: String = self.blocks.iter().map(block).collect();
        format!("\n## {}\n\n{}\n{blocks}", self.heading, self.text)
    }
}

impl Table {
    fn to_markdown(&self) -> String {
        let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
        let rule = (0..self.header.len()).map(|index| if self.is_numeric(index) { "---:" } else { "---" });
        let mut text = if self.title.is_empty() { String::new() } else { format!("{}\n\n", self.title) };
        text += &line(self.header.clone());
        text += &line(rule.map(str::to_owned).collect());
        text.extend(self.rows.iter().map(|row| line(row.iter().map(Cell::to_markdown).collect())));
        text
    }
}

fn image(plot: &Plot) -> String {
    format!("![{}]({})\n", plot.title, figure(plot))
}

/// Name of a plot's file, made from its title.
fn figure(plot: &Plot) -> String {
    let title = plot.title.to_lowercase();
    let words = title.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty());
    format!("figures/{}.svg", words.collect::<Vec<_>>().join("-"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::{Series, Style};

    #[test]
    fn tables_and_figures_become_markdown_and_files() {
        let mut table = Table::new("Errors, cmH2O", &["lung", "error"]);
        table.row(vec![Cell::text("R20C20"), Cell::number(0.912, 3).best_if(true)]);
        let plot = Plot {
            title: "Score, by lung".into(),
            series: vec![Series::new("s", Style::Line, vec![(0.0, 1.0), (1.0, 2.0)])],
            ..Plot::default()
        };
        let blocks = vec![Block::Table(table), Block::Plot(plot)];
        let section = Section { heading: "Lungs".into(), text: "Words.".into(), blocks };
        let report = Report {
            title: "Title".into(),
            subtitle: "Line.".into(),
            sections: vec![section],
            provenance: None,
        };
        let folder = tempfile::tempdir().unwrap();
        report.save_markdown(folder.path(), "results").unwrap();
        let text = std::fs::read_to_string(folder.path().join("results.md")).unwrap();
        insta::assert_snapshot!(text);
        assert!(folder.path().join("figures/score-by-lung.svg").exists());
    }
}
