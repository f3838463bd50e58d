//! The tables and figures of a farm.

use super::{FarmResult, Matrix, UnitResult};
use show::report::{Block, Cell, HeatMap, Report, Section, Table};

/// Notes on the numbers of the units.
const SCALE: &str = "Zero: reading of the sensor at no pressure. Flows are those of a circuit of 1.5 mL/cmH2O, because pressures alone do not tell their scale.";

/// The units: recordings, figures, calibrations and problems.
pub fn units(result: &FarmResult) -> Table {
    let calibrated = |value: fn(&shared::calibration::Calibration) -> f32, decimals| {
        move |unit: &UnitResult| Cell::known(unit.calibration.as_ref().map(|own| value(own).into()), decimals)
    };
    Table::of(
        "Units",
        &result.units,
        &[
            ("unit", &|unit| Cell::text(unit.name.as_str())),
            ("at", &|unit| Cell::text(&unit.place)),
            ("breaths", &|unit| Cell::count(unit.breaths)),
            ("connections", &|unit| Cell::count(unit.sessions as usize)),
            ("open-loop distance, cmH2O", &|unit| {
                Cell::known(unit.figures.as_ref().map(|own| own.figures.open_loop), 3)
            }),
            ("zero, cmH2O", &calibrated(|own| own.sensor_zero, 2)),
            ("dead time, ms", &calibrated(|own| own.dead_time_ms, 1)),
            ("lag, ms", &calibrated(|own| own.lag_ms, 1)),
            ("full flow, L/s", &calibrated(|own| own.valve_flow[3], 2)),
            ("weights", &|unit| Cell::text(unit.weights_id.as_deref().unwrap_or(""))),
        ],
    )
}

/// Changes of the units' calibrations; none if every unit has at most one.
pub fn drift(result: &FarmResult) -> Option<Table> {
    let mut table = Table::new(
        "Drift from the first calibration to the last",
        &["unit", "calibrations", "days", "zero, cmH2O", "dead time, ms", "lag, ms", "full flow, L/s"],
    );
    for unit in &result.units {
        let Some(drift) = &unit.drift else { continue };
        table.row(vec![
            Cell::text(unit.name.as_str()),
            Cell::count(drift.calibrations),
            Cell::number(drift.days, 1),
            Cell::number(drift.sensor_zero.into(), 2),
            Cell::number(drift.dead_time_ms.into(), 1),
            Cell::number(drift.lag_ms.into(), 1),
            Cell::number(drift.full_flow.into(), 2),
        ]);
    }
    (!table.rows.is_empty()).then_some(table)
}

/// Every controller on every unit.
pub fn matrix(matrix: &Matrix) -> Table {
    let units: Vec<String> = matrix.units.iter().map(|unit| format!("unit {unit}")).collect();
    let mut header = vec!["controller"];
    header.extend(units.iter().map(String::as_str));
    header.push("mean");
    let mut table = Table::new("Mean absolute error of each controller on each unit, cmH2O", &header);
    let best =
        |column: usize| matrix.rows.iter().filter_map(|row| row.scores[column]).fold(f64::INFINITY, f64::min);
    let best_mean = matrix.rows.iter().filter_map(|row| matrix.mean(row)).fold(f64::INFINITY, f64::min);
    for row in &matrix.rows {
        let mut cells = vec![Cell::text(&row.controller)];
        cells.extend(row.scores.iter().enumerate().map(|(column, score)| {
            Cell::known(*score, 3).best_if(score.is_some_and(|score| score <= best(column)))
        }));
        let mean = matrix.mean(row);
        cells.push(Cell::known(mean, 3).best_if(mean.is_some_and(|mean| mean <= best_mean)));
        table.row(cells);
    }
    table
}

/// The matrix as a figure.
pub fn map(matrix: &Matrix) -> HeatMap {
    HeatMap {
        title: "Mean absolute error of each controller on each unit, cmH2O".into(),
        x_label: "unit".into(),
        y_label: String::new(),
        x: (1..=matrix.units.len()).map(|number| number as f64).collect(),
        y: (1..=matrix.rows.len()).map(|number| number as f64).collect(),
        x_names: matrix.units.iter().map(ToString::to_string).collect(),
        y_names: matrix.rows.iter().rev().map(|row| row.controller.clone()).collect(),
        values: matrix.rows.iter().rev().map(|row| row.scores.clone()).collect(),
    }
}

/// The controllers of a virtual farm beside the reference bound of each unit.
pub fn floors(result: &FarmResult) -> Option<Table> {
    let (matrix, rivals) = (result.matrix.as_ref()?, result.rivals.as_ref()?);
    let header = ["unit", "bound, cmH2O", "farm / bound", "own / bound", "best / bound", "best controller"];
    let mut table = Table::new("Beside the reference bounds", &header);
    let farm = matrix.row("farm")?;
    let own = matrix.own();
    let ratio = |score: Option<f64>, bound: f64| Cell::known(score.map(|score| score / bound), 3);
    for (place, (unit, bound)) in matrix.units.iter().zip(&rivals.bounds).enumerate() {
        table.row(vec![
            Cell::text(unit.as_str()),
            Cell::number(*bound, 3),
            ratio(farm.scores[place], *bound),
            ratio(own[place], *bound),
            ratio(matrix.best(place).map(|(_, score)| score), *bound),
            Cell::text(matrix.best(place).map_or("", |(row, _)| &row.controller)),
        ]);
    }
    Some(table)
}

/// Mean error of the farm's controller divided by that of the best single PID; none unless all units are virtual.
pub fn of_best_pid(result: &FarmResult) -> Option<f64> {
    let matrix = result.matrix.as_ref()?;
    Some(matrix.mean(matrix.row("farm")?)? / matrix.mean(matrix.row("best single PID")?)?)
}

/// The problems of the units, a line for each: deviations from the band, simulators that no controller is trained on, failures.
pub fn problems(result: &FarmResult) -> Vec<String> {
    let outside = result.outside.iter().map(|outside| (&outside.unit, &outside.message));
    let unfit =
        result.units.iter().filter_map(|unit| Some((&unit.name, unit.figures.as_ref()?.unfit.as_ref()?)));
    let failed = result.units.iter().filter_map(|unit| Some((&unit.name, unit.problem.as_ref()?)));
    outside.chain(unfit).chain(failed).map(|(unit, what)| format!("unit {unit}: {what}")).collect()
}

/// Everything in one file.
pub fn report(result: &FarmResult) -> Report {
    let mut sections =
        vec![Section::new("Recordings and calibrations", SCALE, vec![Block::Table(units(result))])];
    let problems = problems(result);
    if !problems.is_empty() {
        sections.push(Section::new("Problems", problems.join("\n\n"), Vec::new()));
    }
    sections.extend(drift(result).map(|table| Section::new("Drift", "", vec![Block::Table(table)])));
    if let Some(found) = &result.matrix {
        let blocks = vec![Block::HeatMap(map(found)), Block::Table(matrix(found))];
        sections.push(Section::new("Every controller on every unit", "", blocks));
    }
    sections
        .extend(floors(result).map(|table| Section::new("Reference bounds", "", vec![Block::Table(table)])));
    Report {
        title: "Farm".into(),
        subtitle: format!("{} units", result.units.len()),
        sections,
        provenance: None,
    }
}
