//! The last seconds of telemetry, reduced to what a chart can show.
//!
//! Lost samples leave a gap: nothing is drawn where nothing was measured. A chart column that covers several ticks
//! shows the lowest and the highest of them, so that no spike is hidden.

use std::collections::VecDeque;

use shared::link::telemetry::TelemetryBatch;
use shared::ventilator::Sample;

/// A tick and its sample.
type Taken = (u64, Sample);
/// Points of a chart: seconds before now (negative), value.
pub type Points = Vec<(f64, f64)>;

/// Samples of the last seconds; the default window is empty.
#[derive(Clone, Debug, Default)]
pub struct TelemetryWindow {
    samples: VecDeque<Taken>,
    ticks: u64,
    period_us: u32,
}

impl TelemetryWindow {
    /// An empty window of `seconds` at a control period.
    pub fn new(seconds: f64, period_us: u32) -> Self {
        let period_us = period_us.max(1);
        let ticks = (seconds * 1e6 / f64::from(period_us)) as u64;
        Self { samples: VecDeque::new(), ticks: ticks.max(1), period_us }
    }

    /// Length, s.
    pub fn seconds(&self) -> f64 {
        self.age(self.ticks)
    }

    /// Adds a batch. If the ticks go back, the device was restarted, and all older samples are dropped.
    pub fn take(&mut self, batch: &TelemetryBatch) {
        for (tick, packed) in (batch.first_tick..).zip(&batch.samples) {
            if self.samples.back().is_some_and(|(last, _)| tick <= *last) {
                self.samples.clear();
            }
            self.samples.push_back((tick, packed.unpack()));
        }
        let newest = self.newest();
        while self.samples.front().is_some_and(|(tick, _)| newest - tick >= self.ticks) {
            self.samples.pop_front();
        }
    }

    /// The newest sample.
    pub fn last(&self) -> Option<&Sample> {
        self.samples.back().map(|(_, sample)| sample)
    }

    /// A value over time in unbroken pieces, with at most two points in each of `columns`.
    pub fn pieces(&self, columns: usize, value: impl Fn(&Sample) -> f32) -> Vec<Points> {
        let per_column = self.ticks.div_ceil(columns.max(1) as u64);
        let mut pieces: Vec<Points> = Vec::new();
        let mut column = Column::default();
        let mut before = None;
        for (tick, sample) in &self.samples {
            let follows = before.is_some_and(|before| before + 1 == *tick);
            before = Some(*tick);
            if !follows || column.place != tick / per_column {
                column.put(pieces.last_mut());
                column = Column { place: tick / per_column, ..Column::default() };
            }
            if !follows {
                pieces.push(Points::new());
            }
            column.add((-self.age(self.newest() - tick), f64::from(value(sample))));
        }
        column.put(pieces.last_mut());
        pieces
    }

    fn newest(&self) -> u64 {
        self.samples.back().map_or(0, |(tick, _)| *tick)
    }

    fn age(&self, ticks: u64) -> f64 {
        ticks as f64 * f64::from(self.period_us) * 1e-6
    }
}

/// Lowest and highest point of one column of a chart.
#[derive(Clone, Copy, Debug, Default)]
struct Column {
    place: u64,
    ends: Option<((f64, f64), (f64, f64))>,
}

impl Column {
    /// A value that is not a number is not drawn.
    fn add(&mut self, point: (f64, f64)) {
        if !point.1.is_finite() {
            return;
        }
        let (low, high) = self.ends.get_or_insert((point, point));
        if point.1 < low.1 {
            *low = point;
        }
        if point.1 > high.1 {
            *high = point;
        }
    }

    /// Appends both to a piece, in order of time.
    fn put(&self, piece: Option<&mut Points>) {
        if let (Some((low, high)), Some(piece)) = (self.ends, piece) {
            let (first, second) = if low.0 <= high.0 { (low, high) } else { (high, low) };
            piece.push(first);
            piece.extend((first != second).then_some(second));
        }
    }
}
