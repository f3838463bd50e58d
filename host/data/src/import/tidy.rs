//! Puts rows in the order of their times and drops those that are there twice, so that a few of them do not cost the breaths around.

use std::cmp::Ordering;
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};

use super::map::Quantity;
use super::rows::{Disorder, RowSource, TableRow};
use crate::identity::TestRun;
use crate::recording::DatasetError;

/// Number of rows, and of periods, within which a row finds its place.
const WINDOW: usize = 64;
/// Share of the rows out of place from which the file as a whole is out of order.
const MOST_ASTRAY: f64 = 0.2;
/// Number of rows after which that share is judged, and again at the end.
const JUDGED: usize = 20_000;
/// Share of the largest volume by which it falls at once where a meter starts again from zero.
const RESTART: f64 = 0.3;

/// The rows of a source in order.
#[derive(Debug)]
pub(super) struct Tidy<R> {
    source: R,
    /// Name of the file, for errors.
    file: PathBuf,
    period_s: f64,
    /// Number of rows that are held back; none where breaths are numbered, whose times may all begin at zero.
    window: usize,
    /// Whether [`Quantity::FlowIn`] holds a volume, L, of which the flow is made.
    volumes: bool,
    held: VecDeque<TableRow>,
    /// The first row of what is recorded after the held rows: another group, or a clock that was set back.
    beyond: Option<TableRow>,
    ended: bool,
    last: Option<TableRow>,
    largest_volume: f64,
    /// Rows read, and those whose time is before that of the row read before.
    rows: usize,
    backwards: usize,
    last_read: Option<(u32, f64)>,
    disorder: Disorder,
}

impl<R: RowSource> Tidy<R> {
    /// `ordered` sources, whose breaths are numbered, only lose repetitions.
    pub(super) fn new(source: R, file: &Path, period_s: f64, ordered: bool, volumes: bool) -> Self {
        Self {
            source,
            file: file.to_owned(),
            period_s,
            window: if ordered { 0 } else { WINDOW },
            volumes,
            held: VecDeque::with_capacity(WINDOW),
            beyond: None,
            ended: false,
            last: None,
            largest_volume: 0.0,
            rows: 0,
            backwards: 0,
            last_read: None,
            disorder: Disorder::default(),
        }
    }

    /// The next row of a source whose order is that of the file.
    fn next_as_is(&mut self, groups: &mut Vec<TestRun>) -> Result<Option<TableRow>, DatasetError> {
        let row = self.source.next(groups)?;
        match &row {
            Some(row) => self.count(row),
            None => self.ended = true,
        }
        if self.rows == JUDGED || self.ended {
            self.judge()?;
        }
        Ok(row)
    }

    /// Reads rows until enough are held back.
    fn fill(&mut self, groups: &mut Vec<TestRun>) -> Result<(), DatasetError> {
        while !self.ended && self.beyond.is_none() && self.held.len() < self.window {
            let Some(row) = self.source.next(groups)? else {
                self.ended = true;
                return self.judge();
            };
            self.count(&row);
            if self.rows == JUDGED {
                self.judge()?;
            }
            if self.belongs(&row) { self.hold(row) } else { self.beyond = Some(row) }
        }
        if self.held.is_empty()
            && let Some(first) = self.beyond.take()
        {
            self.last = None;
            self.hold(first);
            return self.fill(groups);
        }
        Ok(())
    }

    fn count(&mut self, row: &TableRow) {
        let now = (row.group, row.get(Quantity::Time));
        let back = |(group, time): (u32, f64)| group == now.0 && now.1 < time && !row.next_breath;
        self.rows += 1;
        self.backwards += usize::from(self.last_read.replace(now).is_some_and(back));
    }

    /// Fails if so many rows are out of place that the file as a whole is.
    fn judge(&self) -> Result<(), DatasetError> {
        let astray = |rows: usize| rows as f64 > MOST_ASTRAY * self.rows as f64;
        let (file, rows) = (self.file.clone(), self.rows);
        if astray(self.backwards) {
            return Err(DatasetError::Shuffled { path: file, backwards: self.backwards, rows });
        }
        if astray(self.disorder.same_time) {
            return Err(DatasetError::SameTime { path: file, same: self.disorder.same_time, rows });
        }
        Ok(())
    }

    /// Whether a row belongs to what is held: same group, and not from a clock that was set back.
    fn belongs(&self, row: &TableRow) -> bool {
        self.held.back().or(self.last.as_ref()).is_none_or(|newest| {
            let back = newest.get(Quantity::Time) - row.get(Quantity::Time);
            newest.group == row.group && back < WINDOW as f64 * self.period_s
        })
    }

    fn hold(&mut self, row: TableRow) {
        let time = row.get(Quantity::Time);
        let later = self.held.iter().rev().take_while(|held| held.get(Quantity::Time) > time).count();
        self.disorder.reordered += usize::from(later > 0);
        self.held.insert(self.held.len() - later, row);
    }

    /// Whether a row adds something to the one before.
    fn is_new(&mut self, row: &TableRow) -> bool {
        let Some(last) = self.last.filter(|last| last.group == row.group && !row.next_breath) else {
            return true;
        };
        let same = || last.fields.map(f64::to_bits) == row.fields.map(f64::to_bits);
        let count = match row.get(Quantity::Time).total_cmp(&last.get(Quantity::Time)) {
            Ordering::Greater => return true,
            // The assembler takes it for a gap.
            Ordering::Less if self.window == 0 => return true,
            Ordering::Less => &mut self.disorder.late,
            Ordering::Equal if same() => &mut self.disorder.repeated,
            Ordering::Equal => &mut self.disorder.same_time,
        };
        *count += 1;
        false
    }

    /// Replaces the volume by the flow that makes it, L/s.
    fn differentiate(&mut self, row: &mut TableRow, before: Option<TableRow>) {
        let volume = row.get(Quantity::FlowIn);
        self.largest_volume = self.largest_volume.max(volume);
        let flow = before.filter(|before| before.group == row.group).map_or(0.0, |before| {
            let (step, change) =
                (row.get(Quantity::Time) - before.get(Quantity::Time), volume - before.get(Quantity::FlowIn));
            let restarts = change < -RESTART * self.largest_volume;
            if restarts || step > 2.0 * self.period_s { 0.0 } else { change / step }
        });
        row.set_flow(flow);
    }
}

impl<R: RowSource> RowSource for Tidy<R> {
    fn next(&mut self, groups: &mut Vec<TestRun>) -> Result<Option<TableRow>, DatasetError> {
        loop {
            let row = if self.window == 0 {
                self.next_as_is(groups)?
            } else {
                self.fill(groups)?;
                self.held.pop_front()
            };
            let Some(row) = row else { return Ok(None) };
            if !self.is_new(&row) {
                continue;
            }
            let before = self.last.replace(row);
            let mut row = row;
            if self.volumes {
                self.differentiate(&mut row, before);
            }
            return Ok(Some(row));
        }
    }

    fn position(&self) -> u64 {
        self.source.position()
    }

    fn unused(&self) -> BTreeMap<String, usize> {
        self.source.unused()
    }

    fn disorder(&self) -> Disorder {
        let mut disorder = self.disorder;
        disorder.add(self.source.disorder());
        disorder
    }
}
