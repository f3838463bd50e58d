//! The open-loop distance of a classical identification, for comparison with a learned simulator's.
//!
//! The lung is identified from the training breaths; the pressure of a held-out breath is then predicted from its
//! *measured flow* and the pressure before it. A simulator has less information: it sees only commands.

use std::ops::Range;

use super::cycle::{Cycle, Drift, FlowPath};
use super::{LungCycles, LungId, lungs};
use data::recording::Recording;
use engine::least_squares::solve;

/// Time before an inspiration over which its starting pressure is averaged, s.
const AVERAGE_S: f64 = 0.05;
/// Number of shared coefficients, 1/C, R and R2: P0 is fitted per breath.
const SHARED: usize = 3;

/// The lung as identified from its training breaths.
struct Motion {
    coefficients: [f64; SHARED],
    /// Offset of the flow sensors, L/s.
    offset: f64,
}

/// Mean absolute error of the equation of motion on the inspirations `judged`, with its coefficients fitted to the
/// inspirations `training` of the same lung, cmH2O.
///
/// `None` without flow, or if no judged inspiration has a lung that can be fitted.
pub fn open_loop(recording: &Recording, training: &[Range<usize>], judged: &[Range<usize>]) -> Option<f64> {
    let cycles = lungs(recording).ok()?;
    let (mut sum, mut count) = (0.0, 0);
    let mut done: Vec<_> = Vec::new();
    for lung in judged.iter().map(|rows| LungId::of(recording, rows.start)) {
        if done.contains(&lung) {
            continue;
        }
        done.push(lung.clone());
        let of_lung = |rows: &&Range<usize>| LungId::of(recording, rows.start) == lung;
        let training: Vec<_> = training.iter().filter(of_lung).cloned().collect();
        let Some(motion) = motion(recording, &cycles, &training) else { continue };
        for rows in judged.iter().filter(of_lung) {
            let predicted = motion.predict(recording, rows)?;
            let errors = predicted.iter().zip(&recording.pressure[rows.clone()]);
            sum += errors.map(|(p, measured)| (p - f64::from(*measured)).abs()).sum::<f64>();
            count += rows.len();
        }
    }
    (count > 0).then(|| sum / count as f64)
}

/// Least squares over the inspirations of one lung; their cycles give the offset of the sensors.
fn motion(recording: &Recording, lungs: &[LungCycles], inspirations: &[Range<usize>]) -> Option<Motion> {
    let breaths = lungs.iter().flat_map(|lung| &lung.breaths);
    let own = breaths.filter(|(rows, _)| inspirations.iter().any(|i| i.start == rows.start));
    let offsets: Vec<f64> = own.map(|(_, breath)| breath.offset()).collect();
    let offset = if offsets.is_empty() { 0.0 } else { offsets.iter().sum::<f64>() / offsets.len() as f64 };
    let (mut rows, mut values) = (Vec::new(), Vec::new());
    for inspiration in inspirations {
        let cycle = Cycle::new(recording, inspiration, inspiration.len())?;
        let columns = cycle.rows(Drift::Known(offset), &FlowPath::default());
        let count = columns.len() as f64;
        // Subtracting the means removes P0 of each breath.
        let mean: [f64; SHARED] =
            std::array::from_fn(|n| columns.iter().map(|row| row[n + 1]).sum::<f64>() / count);
        let level = cycle.pressure().iter().sum::<f64>() / count;
        rows.extend(columns.iter().map(|row| std::array::from_fn::<_, SHARED, _>(|n| row[n + 1] - mean[n])));
        values.extend(cycle.pressure().iter().map(|p| p - level));
    }
    let solution = solve(&rows, &values)?;
    Some(Motion { coefficients: solution.coefficients, offset })
}

impl Motion {
    /// Pressures of an inspiration, starting from the mean pressure and flow just before it.
    fn predict(&self, recording: &Recording, rows: &Range<usize>) -> Option<Vec<f64>> {
        let drift = Drift::Known(self.offset);
        let columns = Cycle::new(recording, rows, rows.len())?.rows(drift, &FlowPath::default());
        let average = ((AVERAGE_S / recording.provenance.period_s()).round() as usize).max(1);
        let before = rows.start.saturating_sub(average)..rows.start.max(1);
        let before = Cycle::new(recording, &before, before.len())?;
        let (pressure, flows) = (before.pressure(), before.rows(drift, &FlowPath::default()));
        let flow = flows.iter().map(|row| row[2]).sum::<f64>() / flows.len() as f64;
        let rise = |volume: f64, flow: f64| {
            let [elastance, linear, square] = self.coefficients;
            elastance * volume + linear * flow + square * flow * flow.abs()
        };
        let start = pressure.iter().sum::<f64>() / pressure.len() as f64 - rise(0.0, flow);
        Some(columns.iter().map(|row| start + rise(row[1], row[2])).collect())
    }
}
