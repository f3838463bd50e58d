//! `lab runs`: lists, compares and plots the runs that left a record in a folder.

use std::path::PathBuf;

use anyhow::{Context as _, ensure};
use serde::Serialize;

use campaign::record::{Ending, Record, State};
use data::kind::Kind;
use experiments::runs::{
    Comparison, OptionDifference, Run, RunsError, check_figure, figure_names, find, listed, named, plots,
    sort,
};
use host::command::{Command, Context, OutFile, Output, OutputArgs, write};
use show::report::{Block, Cell, Plot, Report, Section, Table, duration};

/// List, compare and plot runs by the records they leave
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  lab runs out
  lab runs out --figure mean.learned --sort mean.learned --filter bench=R20C20
  lab runs out --compare seed-1 seed-2
  lab runs out/sweep --figure mean.learned --plot learned.svg --x seed
  lab runs out --plot curves.svg --report runs.html

A record is the file made-by.json in the folder of a command with --out, or, for a command that
writes only --json FILE.json, FILE.made-by.json: program, command with all options, machine, engine,
times, how the run ended, and the numbers of its JSON. A run is named by its folder, or by any end
of this path that no other run has. Figures are paths into the JSON, such as mean.learned; of a
curve the list shows the last value.

Killed: the process has disappeared. Unfinished: the run began on a different machine and has not
ended; it may still be running. examples/python/runs.py copies the records into MLflow and
TensorBoard.")]
pub struct Args {
    /// Folder to search, with all folders below
    #[arg(value_name = "DIR")]
    dir: PathBuf,
    /// Figure to show, or to plot; repeatable
    #[arg(long, value_name = "NAME")]
    figure: Vec<String>,
    /// Only runs with this value of an option, as in seed=3, or with this text in name, command, revision or machine; repeatable
    #[arg(long, value_name = "TEXT")]
    filter: Vec<String>,
    /// Sort by a figure or an option [default: by time]
    #[arg(long, value_name = "NAME")]
    sort: Option<String>,
    /// Only these runs, and only what differs between them; percentages are relative to the first
    #[arg(long, value_name = "RUN", num_args = 2..)]
    compare: Vec<String>,
    /// Plot the figures by run, and curves over each other [default: training curves]
    #[arg(long, value_name = "FILE.svg", value_parser = OutFile::of(Kind::Picture))]
    plot: Option<OutFile>,
    /// Plot the figures against this option or figure
    #[arg(long, value_name = "NAME", requires = "figure")]
    x: Option<String>,
    /// Write list, comparison and plots to an HTML report
    #[arg(long, value_name = "FILE.html", value_parser = OutFile::of(Kind::Page))]
    report: Option<OutFile>,
    /// Also list the tasks with shards
    #[arg(long)]
    tasks: bool,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`.
#[derive(Serialize)]
pub struct Summary {
    runs: Vec<Listed>,
    comparison: Option<Comparison>,
}

/// A run in `--json`.
#[derive(Serialize)]
pub struct Listed {
    name: String,
    state: State,
    #[serde(flatten)]
    record: Record,
}

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.output.json()
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let runs = self.chosen()?;
        let comparison = (!self.compare.is_empty()).then(|| Comparison::of(&runs));
        let tables = match &comparison {
            Some(comparison) => comparison_tables(comparison),
            None => vec![list(&runs, &self.figure)],
        };
        for table in &tables {
            context.table(table);
        }
        for run in &runs {
            if let Ending::Failed(error) = &run.record.ending {
                context.line(&format!("{} failed: {error}", run.name));
            }
        }
        if comparison.is_none() && self.figure.is_empty() {
            let names = figure_names(&runs);
            context.line(&format!("figures to show with --figure: {}", listed(names.into_iter())));
        }
        if let Some(file) = &self.plot {
            write(file, Plot::stacked(&plots(&runs, &self.figure, self.x.as_deref())?)?.as_bytes())?;
            context.saved(file);
        }
        context.report(self.report.as_deref(), || self.report(&runs, tables))?;
        Ok(Some(Summary { runs: runs.into_iter().map(Listed::of).collect(), comparison }))
    }
}

impl Listed {
    fn of(run: Run) -> Self {
        Self { name: run.name, state: run.record.state(), record: run.record }
    }
}

impl Args {
    /// The runs that are asked for, in order.
    fn chosen(&self) -> anyhow::Result<Vec<Run>> {
        let found = find(&self.dir, self.tasks)?;
        for damaged in found.damaged {
            eprintln!("warning: {damaged}");
        }
        let mut runs = found.runs;
        runs.retain(|run| self.filter.iter().all(|text| run.matches(text)));
        ensure!(
            !runs.is_empty() || self.filter.is_empty(),
            "no run in {} has {}",
            self.dir.display(),
            self.filter.join(" and ")
        );
        ensure!(!runs.is_empty(), "{} contains no record of a run that can be read", self.dir.display());
        if !self.compare.is_empty() {
            let named = self.compare.iter().map(|name| named(&runs, &self.dir, name).cloned());
            runs = named.collect::<Result<_, _>>()?;
        }
        for name in &self.figure {
            check_figure(&runs, name)?;
        }
        if let Some(by) = &self.sort {
            if !runs.iter().any(|run| run.option(by).is_some()) {
                check_figure(&runs, by).context("--sort takes a figure or an option")?;
            }
            sort(&mut runs, by);
        }
        Ok(runs)
    }

    fn report(&self, runs: &[Run], tables: Vec<Table>) -> anyhow::Result<Report> {
        let heading = if self.compare.is_empty() { "List" } else { "Differences" };
        let mut sections = vec![Section::new(heading, "", tables.into_iter().map(Block::Table).collect())];
        let plots = match plots(runs, &self.figure, self.x.as_deref()) {
            // The list alone is a report too.
            Err(RunsError::NothingToPlot { .. }) => Vec::new(),
            plots => plots?,
        };
        if !plots.is_empty() {
            sections.push(Section::new("Figures", "", plots.into_iter().map(Block::Plot).collect()));
        }
        let title = format!("Runs in {}", self.dir.display());
        Ok(Report { title, sections, ..Report::default() })
    }
}

/// Whether a figure has a number in any run.
fn has_figure(runs: &[Run], name: &str) -> bool {
    runs.iter().any(|run| run.figure(name).is_some())
}

/// A row for every run. No best value is marked, because a figure may be an error or a share.
fn list(runs: &[Run], figures: &[String]) -> Table {
    let header = ["", "run", "command", "seed", "revision", "machine", "state", "time"];
    // The name of a list of curves has no number to show.
    let figures: Vec<&str> =
        figures.iter().map(String::as_str).filter(|name| has_figure(runs, name)).collect();
    let header: Vec<&str> = header.into_iter().chain(figures.iter().copied()).collect();
    let mut table = Table::new("", &header);
    for (n, run) in runs.iter().enumerate() {
        let mut row = vec![
            Cell::count(n + 1),
            Cell::text(&run.name),
            Cell::text(run.command()),
            Cell::right(run.option("seed").unwrap_or("-")),
            Cell::text(&run.record.revision),
            Cell::text(run.place()),
            Cell::text(state(run.record.state())),
            Cell::right(duration(run.record.spent_s)),
        ];
        row.extend(figures.iter().map(|figure| number(run.figure(figure))));
        table.row(row);
    }
    table
}

fn comparison_tables(comparison: &Comparison) -> Vec<Table> {
    let runs: Vec<&str> = comparison.runs.iter().map(String::as_str).collect();
    let differences = |title: &str, of: &str, found: &[OptionDifference]| {
        let header: Vec<&str> = [of].into_iter().chain(runs.iter().copied()).collect();
        let mut table = Table::new(title, &header);
        for OptionDifference { name, values } in found {
            let values = values.iter().map(|value| Cell::right(value.as_deref().unwrap_or("-")));
            table.row([Cell::text(name)].into_iter().chain(values).collect());
        }
        table
    };
    let percent = runs.iter().skip(1).map(|run| format!("{run}, %"));
    let header: Vec<String> =
        ["figure"].into_iter().chain(runs.iter().copied()).map(str::to_owned).chain(percent).collect();
    let mut figures = Table { header, ..Table::new("Different figures", &[]) };
    for figure in &comparison.figures {
        let values = figure.values.iter().map(|value| number(*value));
        let percent = figure.percent.iter();
        let percent =
            percent.map(|value| Cell::right(value.map_or("-".into(), |value| format!("{value:+.1}"))));
        figures.row([Cell::text(&figure.name)].into_iter().chain(values).chain(percent).collect());
    }
    let tables = vec![
        differences("Different origin", "fact", &comparison.origin),
        differences("Different options", "option", &comparison.options),
        figures,
    ];
    let differing: Vec<Table> = tables.into_iter().filter(|table| !table.rows.is_empty()).collect();
    if differing.is_empty() { vec![Table::new("The runs do not differ", &["figure"])] } else { differing }
}

/// The state in a word.
fn state(state: State) -> &'static str {
    match state {
        State::Running => "running",
        State::Killed => "killed",
        State::Unfinished => "unfinished",
        State::Complete => "complete",
        State::Stopped => "stopped",
        State::Failed => "failed",
    }
}

/// A figure with as many decimals as it needs.
fn number(value: Option<f64>) -> Cell {
    match value {
        None => Cell::right("-"),
        Some(value) if value.fract() == 0.0 && value.abs() < 1e15 => Cell::number(value, 0),
        Some(value) if value.abs() < 1e-3 => Cell::right(format!("{value:.3e}")),
        Some(value) => Cell::number(value, 4),
    }
}
