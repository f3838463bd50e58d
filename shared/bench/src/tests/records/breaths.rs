//! The breaths of a record, and what was measured in them at each step of the bench.

use std::path::Path;

use data::import::{MakairTelemetry, makair_telemetry};

use crate::STEP_S;

/// Fewest rows of an inspiration and of a breath, and the longest pause between rows of a whole breath, s.
const LEAST_ROWS: (usize, usize) = (30, 80);
const MOST_PAUSE_S: f64 = 0.05;
/// Time of an expiration that is replayed, s, and the longest replay.
const EXPIRATION_S: f64 = 0.5;
const MOST_S: f64 = 2.5;

/// Commands of a row, in force from a step of the breath on.
pub(super) struct Command {
    pub(super) from: usize,
    /// Positions of the blower's valve and of the patient valve, percent open.
    pub(super) u_in: f64,
    pub(super) u_out: f64,
    /// Speed of the blower, as a share of the highest.
    pub(super) speed: f64,
}

/// A breath from its first inspiratory row on.
pub(super) struct Breath {
    pub(super) commands: Vec<Command>,
    /// Speed that was set before the breath.
    pub(super) speed_before: f64,
    /// Steps of the inspiration.
    pub(super) inspired: usize,
    /// Pressure at the beginning and after each step, cmH2O.
    pub(super) start: f64,
    pub(super) pressures: Vec<f64>,
    /// Flows to and from the patient after each step, L/s; none where the record has none.
    pub(super) flows: Option<Vec<[f64; 2]>>,
}

/// The whole breaths of the record at `path`.
pub(super) fn breaths(path: &Path) -> Vec<Breath> {
    let rows = makair_telemetry(path).expect("the record is whole");
    let mut starts: Vec<usize> =
        (1..rows.len()).filter(|n| rows[*n].inspires && !rows[n - 1].inspires).collect();
    starts.push(rows.len());
    starts
        .windows(2)
        .filter_map(|pair| Breath::of(&rows[pair[0]..pair[1]], rows[pair[0] - 1].speed))
        .collect()
}

impl Breath {
    /// None if the breath is too short or has a gap.
    fn of(rows: &[MakairTelemetry], speed_before: f64) -> Option<Self> {
        let inspired = rows.iter().filter(|row| row.inspires).count();
        let gap = rows.windows(2).any(|pair| pair[1].time_s - pair[0].time_s > MOST_PAUSE_S);
        if inspired < LEAST_ROWS.0 || rows.len() < LEAST_ROWS.1 || gap {
            return None;
        }
        let since = |row: &MakairTelemetry| row.time_s - rows[0].time_s;
        let inspiration_s = since(rows.iter().rfind(|row| row.inspires)?);
        let most_s = MOST_S.min(inspiration_s + EXPIRATION_S).min(since(rows.last()?));
        let times: Vec<f64> = (1..=(most_s / STEP_S) as usize).map(|step| step as f64 * STEP_S).collect();
        let command = |row: &MakairTelemetry| Command {
            from: (since(row) / STEP_S).ceil() as usize,
            u_in: row.u_in,
            u_out: row.u_out,
            speed: row.speed,
        };
        let flow = |row: &MakairTelemetry, n: usize| row.flows.map_or(0.0, |flows| flows[n]);
        let flows =
            || times.iter().map(|at| [0, 1].map(|n| between(rows, *at, |row| flow(row, n)))).collect();
        Some(Self {
            commands: rows.iter().map(command).collect(),
            speed_before,
            inspired: ((inspiration_s / STEP_S) as usize).min(times.len()),
            start: rows[0].pressure,
            pressures: times.iter().map(|at| between(rows, *at, |row| row.pressure)).collect(),
            flows: rows[0].flows.map(|_| flows()),
        })
    }
}

/// A value at this time of the breath, s, on the line between two rows.
fn between(rows: &[MakairTelemetry], at: f64, value: impl Fn(&MakairTelemetry) -> f64) -> f64 {
    let since = |row: &MakairTelemetry| row.time_s - rows[0].time_s;
    let after = rows.partition_point(|row| since(row) <= at).clamp(1, rows.len() - 1);
    let [left, right] = [&rows[after - 1], &rows[after]];
    let part = (at - since(left)) / (since(right) - since(left));
    value(left) + (value(right) - value(left)) * part.min(1.0)
}
