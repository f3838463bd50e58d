//! One self-contained HTML file with style, tables, plots and provenance. It has no script and loads nothing.

use std::path::Path;

use super::role::dark_rules;
use super::svg::Svg;
use super::text::escape;
use super::{HeatMap, Plot, ReportError, Table};
use data::files::write_atomically;
use data::provenance::Provenance;

const STYLE: &str = include_str!("style.css");

/// Scale of width and height of plots in a row, so that their text stays readable.
const ROW_SHARE: (f64, f64) = (0.65, 0.8);

/// A report.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Report {
    /// Heading, also the title of the window.
    pub title: String,
    /// Line below the heading; may be empty.
    pub subtitle: String,
    /// Sections in order.
    pub sections: Vec<Section>,
    /// Provenance, shown at the foot.
    pub provenance: Option<Provenance>,
}

/// One section of a report.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Section {
    /// Heading of the section.
    pub heading: String,
    /// Introduction; an empty line starts a paragraph.
    pub text: String,
    /// Content in order.
    pub blocks: Vec<Block>,
}

impl Section {
    /// A section with its introduction.
    pub fn new(heading: impl Into<String>, text: impl Into<String>, blocks: Vec<Block>) -> Self {
        Self { heading: heading.into(), text: text.into(), blocks }
    }

    /// What a reader can do next: purposes with their commands.
    pub fn next(steps: &[(&str, String)]) -> Self {
        let step = |(what, command): &(&str, String)| {
            [Block::Text((*what).to_owned()), Block::Command(command.clone())]
        };
        Self::new("What to do next", "", steps.iter().flat_map(step).collect())
    }
}

/// Content of a section.
#[derive(Debug, Clone, PartialEq)]
pub enum Block {
    /// A table.
    Table(Table),
    /// A plot of full width.
    Plot(Plot),
    /// Plots side by side, or stacked on a narrow screen.
    PlotRow(Vec<Plot>),
    /// A map of full width.
    HeatMap(HeatMap),
    /// Paragraphs, separated by empty lines.
    Text(String),
    /// A command line.
    Command(String),
}

impl Report {
    /// The whole file as text.
    ///
    /// # Errors
    /// The error of the first plot that cannot be drawn.
    pub fn to_html(&self) -> Result<String, ReportError> {
        let title = escape(&self.title);
        let mut html = format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <title>{title}</title>\n<style>\n{STYLE}{}</style>\n</head>\n<body>\n<header>\n<h1>{title}</h1>\n",
            dark_rules()
        );
        html.extend(
            (!self.subtitle.is_empty())
                .then(|| format!("<p class=\"subtitle\">{}</p>\n", escape(&self.subtitle))),
        );
        html += "</header>\n<main>\n";
        for section in &self.sections {
            html += &section.to_html()?;
        }
        html += "</main>\n";
        html.extend(self.provenance.as_ref().map(footer));
        Ok(html + "</body>\n</html>\n")
    }

    /// Writes the file, atomically replacing an older one.
    ///
    /// # Errors
    /// See [`Self::to_html`]; also if the file cannot be written.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<(), ReportError> {
        let path = path.as_ref();
        write_atomically(path, self.to_html()?.as_bytes())
            .map_err(|source| ReportError::Write { path: path.to_owned(), source })
    }
}

impl Section {
    fn to_html(&self) -> Result<String, ReportError> {
        let mut html = format!("<section>\n<h2>{}</h2>\n{}", escape(&self.heading), paragraphs(&self.text));
        for block in &self.blocks {
            html.push_str(&block.to_html()?);
        }
        Ok(html + "</section>\n")
    }
}

impl Block {
    fn to_html(&self) -> Result<String, ReportError> {
        Ok(match self {
            Self::Table(table) => table.to_html(),
            Self::Plot(plot) => figures("plots", &figure(&plot.title, &plot.drawing()?)),
            Self::PlotRow(plots) => {
                let row = plots.iter().map(|plot| Ok(figure(&plot.title, &smaller(plot).drawing()?)));
                figures("plots row", &row.collect::<Result<String, ReportError>>()?)
            }
            Self::HeatMap(map) => figures("plots", &figure(&map.title, &map.drawing()?)),
            Self::Text(text) => paragraphs(text),
            Self::Command(line) => format!("<pre class=\"command\">{}</pre>\n", escape(line)),
        })
    }
}

fn smaller(plot: &Plot) -> Plot {
    let scale = |pixels: u32, share: f64| (f64::from(pixels) * share).round() as u32;
    let (width, height) = plot.size();
    Plot { size: Some((scale(width, ROW_SHARE.0), scale(height, ROW_SHARE.1))), ..plot.clone() }
}

fn figures(class: &str, figures: &str) -> String {
    format!("<div class=\"{class}\">\n{figures}</div>\n")
}

fn figure(title: &str, svg: &Svg) -> String {
    format!("<figure>\n{}</figure>\n", svg.to_html(title))
}

fn paragraphs(text: &str) -> String {
    let mut html = String::new();
    html.extend(text.split("\n\n").map(str::trim).filter(|part| !part.is_empty()).map(paragraph));
    html
}

fn paragraph(text: &str) -> String {
    format!("<p>{}</p>\n", escape(text))
}

fn footer(provenance: &Provenance) -> String {
    let facts = [
        ("Plant", provenance.plant.clone()),
        ("Made by", provenance.source.clone()),
        ("Weights of the controller", provenance.weights_id.clone()),
        ("Seed of the random numbers", provenance.seed.to_string()),
        ("Control period", format!("{} µs", provenance.period_us)),
        ("Revision of the program", provenance.git_revision.clone()),
    ];
    let mut html = String::from("<footer>\n<h2>Origin of the data</h2>\n<dl>\n");
    let known = facts.iter().filter(|(_, fact)| !fact.is_empty());
    html.extend(known.map(|(name, fact)| format!("<div><dt>{name}</dt><dd>{}</dd></div>\n", escape(fact))));
    html += "</dl>\n";
    html.extend(provenance.notes.iter().map(|note| paragraph(note)));
    if !provenance.settings.is_null() {
        html += &details("Settings", &format!("{:#}", provenance.settings));
    }
    if !provenance.plant_parameters.is_empty() {
        html += &details("Plant parameters", &provenance.plant_parameters);
    }
    html + "</footer>\n"
}

fn details(summary: &str, text: &str) -> String {
    format!("<details><summary>{summary}</summary><pre>{}</pre></details>\n", escape(text.trim_end()))
}
