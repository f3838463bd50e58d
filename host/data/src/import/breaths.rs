//! Turns a stream of samples into breaths on an even grid of time.

use std::collections::VecDeque;

use super::account::{Account, ImportSummary};
use super::map::{EndBy, Quantity, StartBy, TableLayout};
use super::rises::is_up;
use super::rows::{Between, TableRow};
use crate::recording::{DatasetError, EXPIRATION, FALL, INSPIRATION, RecordingWriter, Row};

/// A breath is not resampled if all of its rows are within this share of a period from the grid.
const UNEVEN: f64 = 0.05;
/// Time before the end of an inspiration whose middle pressure is its PIP if there is no set-point, seconds.
const PLATEAU_S: f64 = 0.1;
/// Time before a breath whose middle pressure is its PEEP if there is no set-point, seconds.
const PEEP_S: f64 = 0.2;
/// Step of the set-point that is an edge, not a ramp, cmH2O.
const EDGE: f64 = 2.0;
/// Number of rows after which a breath without an end is discarded.
const MOST_ROWS: usize = 200_000;

/// Collects samples into breaths and writes their rows, one breath at a time.
pub(super) struct Assembler<'a> {
    pub(super) account: Account,
    pub(super) writer: RecordingWriter,
    layout: &'a TableLayout,
    period_s: f64,
    /// The samples of the current breath; before it the set-point, and the pressures of the last expiration.
    breath: Vec<TableRow>,
    target_before: f64,
    pressures_before: Vec<f64>,
    recent: VecDeque<f64>,
    last: Option<TableRow>,
    within: bool,
    after_gap: bool,
    number: u32,
    rows: Vec<Row>,
}

impl<'a> Assembler<'a> {
    pub(super) fn new(layout: &'a TableLayout, period_s: f64, writer: RecordingWriter) -> Self {
        Self {
            account: Account::default(),
            writer,
            layout,
            period_s,
            breath: Vec::new(),
            target_before: 0.0,
            pressures_before: Vec::new(),
            recent: VecDeque::new(),
            last: None,
            within: false,
            after_gap: false,
            number: 0,
            rows: Vec::new(),
        }
    }

    /// Takes the next sample; writes a breath that ends with it.
    pub(super) fn push(&mut self, sample: TableRow) -> Result<(), DatasetError> {
        if self.last.is_some_and(|last| last.group != sample.group) {
            self.end_of_stretch()?;
        }
        let numbered = self.layout.start == StartBy::Number && sample.next_breath;
        let between = self.last.map_or(Between::Nothing, |last| Between::of(&last, &sample, self.period_s));
        let follows = between != Between::Gap;
        self.account.counts.filled += usize::from(between == Between::FewRows && self.within);
        if !numbered && (!follows || self.breath.len() >= MOST_ROWS) {
            self.end_of_stretch()?;
            self.after_gap = true;
            self.account.counts.gaps += 1;
        }
        if !follows {
            self.recent.clear();
        }
        if sample.next_breath {
            self.finish()?;
            (self.within, self.after_gap) = (true, false);
            self.target_before = self.last.unwrap_or(sample).get(Quantity::Target);
            self.pressures_before = self.recent.drain(..).collect();
        }
        self.remember(&sample);
        self.account.sample(&sample, if numbered { None } else { self.last.as_ref() });
        if self.within {
            self.breath.push(sample);
        } else if self.after_gap {
            self.account.counts.dropped_after_gap += 1;
        } else {
            self.account.counts.dropped_before_first_breath += 1;
        }
        self.last = Some(sample);
        Ok(())
    }

    /// Ends the current breath before a gap.
    pub(super) fn end_of_stretch(&mut self) -> Result<(), DatasetError> {
        self.finish()?;
        (self.last, self.within, self.after_gap) = (None, false, false);
        self.recent.clear();
        Ok(())
    }

    /// Keeps the pressure for the PEEP of the next breath.
    fn remember(&mut self, sample: &TableRow) {
        let rows = ((PEEP_S / self.period_s).round() as usize).max(1);
        while self.recent.len() >= rows {
            self.recent.pop_front();
        }
        self.recent.push_back(sample.get(Quantity::Pressure));
    }

    /// PEEP without a set-point: what the pressure rested at before the breath, which a start that is found late does
    /// not change; at a first row, that row's pressure.
    fn peep_before(&self, first: &TableRow) -> f32 {
        middle(self.pressures_before.clone()).unwrap_or(first.get(Quantity::Pressure)) as f32
    }

    /// PEEP by the set-point: where it rests after the inspiration or, if it never comes down, where it was before.
    fn peep_set(&self, samples: &[TableRow]) -> f64 {
        let target = |sample: &TableRow| sample.get(Quantity::Target);
        let highest = samples.iter().map(target).fold(f64::NEG_INFINITY, f64::max);
        let last = samples.last().map_or(highest, target);
        if is_up(highest as f32, last as f32) { last } else { self.target_before.min(last) }
    }

    fn finish(&mut self) -> Result<(), DatasetError> {
        if self.breath.is_empty() {
            return Ok(());
        }
        let samples = std::mem::take(&mut self.breath);
        let even = evened(&samples, self.period_s, &mut self.account.counts);
        self.fill_rows(even.as_deref().unwrap_or(&samples));
        self.account.breath(&samples, &self.rows);
        self.rows.iter().try_for_each(|row| self.writer.push(*row))?;
        self.number += 1;
        // Reuse the memory.
        self.breath = samples;
        self.breath.clear();
        Ok(())
    }

    /// Writes the rows of a breath whose samples are on the grid.
    fn fill_rows(&mut self, samples: &[TableRow]) {
        let has = |quantity: Quantity| self.layout.has(quantity);
        let has_target = has(Quantity::Target);
        let settled = self.peep_set(samples);
        let inspiration = self.inspiration(samples, settled as f32);
        let (pip, peep) = if has_target {
            let inspired = samples[..inspiration.max(1)].iter().map(|sample| sample.get(Quantity::Target));
            (setting(inspired.fold(settled, f64::max)), setting(settled))
        } else {
            (self.plateau(&samples[..inspiration.max(1)]), self.peep_before(&samples[0]))
        };
        self.rows.clear();
        for (tick, sample) in samples.iter().enumerate() {
            let value = |quantity: Quantity| sample.get(quantity) as f32;
            let optional = |quantity: Quantity| has(quantity).then(|| value(quantity));
            let inspires = tick < inspiration;
            let phase = match value(Quantity::Target) {
                _ if inspires => INSPIRATION,
                target if has_target && is_up(target, peep) => FALL,
                _ => EXPIRATION,
            };
            let closed = if inspires { 0.0 } else { 100.0 };
            self.rows.push(Row {
                breath: self.number,
                tick: tick as u32,
                phase,
                target: optional(Quantity::Target).unwrap_or(if inspires { pip } else { peep }),
                pressure: value(Quantity::Pressure),
                u_in: optional(Quantity::UIn).unwrap_or(0.0),
                u_out: optional(Quantity::UOut).unwrap_or(closed),
                pip,
                peep,
                flow_in: optional(Quantity::FlowIn),
                flow_out: optional(Quantity::FlowOut),
                resistance: optional(Quantity::Resistance),
                compliance: optional(Quantity::Compliance),
                u_psol: optional(Quantity::UPsol),
                group: Some(sample.group),
                ..Row::default()
            });
        }
    }

    /// Number of rows of the inspiration.
    fn inspiration(&self, samples: &[TableRow], peep: f32) -> usize {
        // PEEP may have been changed just before, and a flow needs a few rows to show.
        let once = |inspires: &dyn Fn(&TableRow) -> bool| {
            let begin = samples.iter().position(inspires).unwrap_or(0);
            begin + samples[begin..].iter().take_while(|sample| inspires(sample)).count()
        };
        match self.layout.end {
            EndBy::Time(seconds) => ((seconds / self.period_s).round() as usize).min(samples.len()),
            EndBy::Phase | EndBy::Found => once(&|sample| sample.inspires),
            EndBy::Target => once(&|sample| is_up(sample.get(Quantity::Target) as f32, peep)),
            EndBy::Valve => samples.iter().take_while(|sample| !sample.opens_out()).count(),
        }
    }

    /// PIP without a set-point, which an end that is found late does not change.
    fn plateau(&self, inspiration: &[TableRow]) -> f32 {
        let rows = ((PLATEAU_S / self.period_s).round() as usize).clamp(1, inspiration.len());
        let last = &inspiration[inspiration.len() - rows..];
        middle(last.iter().map(|sample| sample.get(Quantity::Pressure)).collect()).unwrap_or_default() as f32
    }
}

/// The middle value; none of none.
fn middle(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len().saturating_sub(1) / 2).copied()
}

/// A pressure setting, cmH2O, without the rounding error of its transmission.
fn setting(target: f64) -> f32 {
    ((target * 100.0).round() / 100.0) as f32
}

/// The samples on the grid; `None` if they are on it already. All values are interpolated alike, linearly, except across an edge of the
/// set-point or of the expiratory valve: there a tick takes the nearer row whole, so that pressure and target keep belonging together.
fn evened(samples: &[TableRow], period_s: f64, counts: &mut ImportSummary) -> Option<Vec<TableRow>> {
    let time = |n: usize| samples[n].get(Quantity::Time) - samples[0].get(Quantity::Time);
    let off = (0..samples.len()).map(|n| (time(n) - n as f64 * period_s).abs()).fold(0.0, f64::max);
    counts.furthest_from_grid_ms = counts.furthest_from_grid_ms.max(1e3 * off);
    if off <= UNEVEN * period_s {
        return None;
    }
    counts.resampled_breaths += 1;
    let ticks = (time(samples.len() - 1) / period_s + UNEVEN) as usize + 1;
    let mut after = 1;
    Some(
        (0..ticks)
            .map(|tick| {
                let now = tick as f64 * period_s;
                while after + 1 < samples.len() && time(after) <= now {
                    after += 1;
                }
                let (Some(a), Some(b)) = (samples.get(after - 1), samples.get(after)) else {
                    return samples[0];
                };
                let span = time(after) - time(after - 1);
                between(a, b, ((now - time(after - 1)) / span).clamp(0.0, 1.0))
            })
            .collect(),
    )
}

/// The row at a share of the way from one row to the next.
fn between(a: &TableRow, b: &TableRow, share: f64) -> TableRow {
    let nearer = if share < 0.5 { *a } else { *b };
    let step = b.get(Quantity::Target) - a.get(Quantity::Target);
    if step.abs() > EDGE || a.opens_out() != b.opens_out() {
        return nearer;
    }
    let mut row = nearer;
    for (value, (a, b)) in row.fields.iter_mut().zip(a.fields.iter().zip(b.fields)) {
        *value = a + share * (b - a);
    }
    row
}
