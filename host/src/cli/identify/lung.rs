//! `trainer identify FILE`: identifies the lungs in a recording.

use std::path::Path;

use anyhow::{Context as _, bail};
use serde::Serialize;

use super::LungArgs;
use crate::command::{Context, quoted, write};
use data::recording::Recording;
use show::report::{Block, Cell, Plot, Report, Section, Series, Style, Table};
use verdict::identify::cycle::{Cycle, FlowPath};
use verdict::identify::{Estimate, Identified, LungCycles, bench, identify, lungs};

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Found {
    plant: String,
    lungs: Vec<Identified>,
}

/// Identifies the lungs of a recording.
pub fn run(data: &Path, args: &LungArgs, context: &Context<'_>) -> anyhow::Result<Found> {
    let recording = Recording::load(data)?;
    let mut found = identify(&recording).with_context(|| format!("cannot identify {}", data.display()))?;
    if let Some(group) = &args.group {
        let names = names(&found);
        found.retain(|lung| lung.id.to_string() == *group);
        if found.is_empty() {
            bail!("{} has no lung named {group} that can be identified; it has {names}", data.display());
        }
    }
    context.table(&table(&found));
    context.table(&behind_circuit(&found));
    context.table(&flaws(&found));
    for line in remarks(&found) {
        context.line(&line);
    }
    if let Some(path) = &args.write_plant {
        let [lung] = &found[..] else {
            bail!("a bench has one lung, the recording {}: choose one with --group", names(&found));
        };
        let bench = bench::bench(lung, &recording)
            .with_context(|| format!("the lung {} is outside the bench's limits", lung.id))?;
        write(path, bench::to_toml(&bench, lung).as_bytes())?;
        context.saved(path);
    }
    context.report(args.report.as_deref(), || {
        let mut report = report(&recording, &found)?;
        report.sections.push(next(data, args.write_plant.as_deref(), &found));
        Ok(report)
    })?;
    Ok(Found { plant: recording.provenance.plant, lungs: found })
}

fn next(data: &Path, written: Option<&Path>, found: &[Identified]) -> Section {
    let evaluate = |bench: &Path| format!("trainer evaluate --controller adult --bench {}", quoted(bench));
    let compare = (
        "Compare a PID with the shipped controller on this lung:",
        evaluate(written.unwrap_or(Path::new("lung.toml"))),
    );
    let group =
        found.first().map(|lung| format!(" --group {}", quoted(lung.id.to_string()))).unwrap_or_default();
    let write = format!("trainer identify {}{group} --write-plant lung.toml", quoted(data));
    match written {
        Some(_) => Section::next(&[compare]),
        None => Section::next(&[("Write a lung as the description of a bench:", write), compare]),
    }
}

fn names(lungs: &[Identified]) -> String {
    lungs.iter().map(|lung| lung.id.to_string()).collect::<Vec<_>>().join(", ")
}

fn table(found: &[Identified]) -> Table {
    let mut table = Table::new(
        "Equation of motion over whole breaths, 95 % intervals; C mL/cmH2O, R cmH2O/(L/s), R2 cmH2O/(L/s)^2",
        &[
            "lung",
            "nominal C",
            "C",
            "C uncorrected",
            "nominal R",
            "R",
            "R2",
            "offset, mL/s",
            "residual, cmH2O",
            "breaths",
        ],
    );
    for lung in found {
        let offset = |per_s: f64| 1000.0 * per_s;
        table.row(vec![
            Cell::text(lung.id.to_string()),
            nominal(lung.id.nominal_compliance),
            estimate(&lung.compliance),
            lung.uncorrected_compliance.map_or_else(|| Cell::right("unknown"), |c| Cell::number(c, 1)),
            nominal(lung.id.nominal_resistance),
            estimate(&lung.resistance),
            estimate(&lung.turbulence),
            Cell::number(offset(lung.offset.value), 1),
            Cell::number(lung.residual, 2),
            Cell::count(lung.breaths),
        ]);
    }
    table
}

fn behind_circuit(found: &[Identified]) -> Table {
    let mut table = Table::new(
        "The same behind the circuit, whose compliance is chosen for the smallest residual",
        &["lung", "circuit C", "C", "R", "R2", "residual, cmH2O"],
    );
    for lung in found {
        let behind = &lung.behind_circuit;
        table.row(vec![
            Cell::text(lung.id.to_string()),
            Cell::number(behind.circuit_compliance, 2),
            estimate(&behind.compliance),
            estimate(&behind.resistance),
            estimate(&behind.turbulence),
            Cell::number(behind.residual, 2),
        ]);
    }
    table
}

fn flaws(found: &[Identified]) -> Table {
    let mut table = Table::new(
        "Flaws of the flow",
        &["lung", "leak, mL/s/cmH2O", "flow late by, ms", "breaths left out"],
    );
    for lung in found {
        table.row(vec![
            Cell::text(lung.id.to_string()),
            estimate(&lung.leak),
            estimate(&lung.flow_delay_ms),
            Cell::count(lung.breaths_left_out),
        ]);
    }
    table
}

/// The remarks of all lungs, each with its lung's name.
fn remarks(found: &[Identified]) -> Vec<String> {
    let of_lung = |lung: &Identified| {
        let name = lung.id.to_string();
        lung.remarks.iter().map(move |remark| format!("lung {name}: {remark}")).collect::<Vec<_>>()
    };
    found.iter().flat_map(of_lung).collect()
}

fn nominal(value: Option<f64>) -> Cell {
    value.map_or_else(|| Cell::right("unknown"), |value| Cell::number(value, 0))
}

fn estimate(estimate: &Estimate) -> Cell {
    let half = 0.5 * (estimate.high - estimate.low);
    // An elastance whose interval contains zero gives no upper limit of the compliance.
    let half = if half < 1e6 { format!("{half:.1}") } else { "?".to_owned() };
    Cell::right(format!("{:.1} ±{half}", estimate.value))
}

fn report(recording: &Recording, found: &[Identified]) -> anyhow::Result<Report> {
    let plots = lungs(recording)?
        .iter()
        .filter_map(|lung| plots(lung, found.iter().find(|found| found.id == lung.id)?))
        .flatten()
        .collect();
    Ok(Report {
        title: "Identified lungs".into(),
        subtitle: recording.provenance.plant.clone(),
        sections: vec![
            Section {
                heading: "Estimates".into(),
        text: "P = P0 + V/C + R q + R2 q|q|, fitted to each whole breath; intervals come from the spread between \
               breaths. The offset is the mean net flow over a breath, which is removed."
                    .into(),
                blocks: [table(found), behind_circuit(found), flaws(found)]
                    .into_iter()
                    .map(Block::Table)
                    .chain(remarks(found).into_iter().map(Block::Text))
                    .collect(),
            },
            Section {
                heading: "One breath of each lung".into(),
                text: "The measured pressure, and the pressure fitted with the measured flow; beside it the residuals, \
                       which are the fitted pressures minus the measured one."
                    .into(),
                blocks: vec![Block::PlotRow(plots)],
            },
        ],
        provenance: Some(recording.provenance.clone()),
    })
}

/// The middle breath of a lung with its fits, and the residuals of both.
fn plots(lung: &LungCycles, found: &Identified) -> Option<[Plot; 2]> {
    let (_, breath) = lung.breaths.get(lung.breaths.len() / 2)?;
    let path = found.taken_out;
    let behind = FlowPath { circuit: found.behind_circuit.circuit_compliance, ..path };
    let measured = Series::new("measured", Style::Line, points(breath, breath.pressure()));
    let fits = [
        Series::new("equation of motion", Style::Line, points(breath, &breath.fitted(&path)?)),
        Series::new("behind the circuit", Style::Line, points(breath, &breath.fitted(&behind)?)),
    ];
    let residuals = fits.iter().map(|fit| fit.minus(&measured)).collect();
    let curves = [measured].into_iter().chain(fits).collect();
    let name = lung.id.to_string();
    let residuals = Plot::over_time(format!("{name}: residuals"), "residual, cmH2O", residuals);
    Some([Plot::over_time(name, "pressure, cmH2O", curves), residuals])
}

fn points(breath: &Cycle, values: &[f64]) -> Vec<(f64, f64)> {
    values.iter().enumerate().map(|(row, value)| (row as f64 * breath.period_s(), *value)).collect()
}
