//! Second pass through a PIRDS file: a row for each reading of the airway pressure.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::survey::{FlowSensors, Survey};
use super::{Events, faulty, open};
use crate::identity::TestRun;
use crate::import::map::{QUANTITIES, Quantity};
use crate::import::rows::{Disorder, Fields, RowSource, TableRow, index_of};
use crate::pirds::{Event, Measurement, PER_CMH2O, PER_LITRE_PER_SECOND, PhaseMark};
use crate::recording::{DatasetError, INSPIRATION};

/// The rows of a file.
pub(super) struct EventRows<'a> {
    path: PathBuf,
    reader: Events,
    bytes: Arc<AtomicU64>,
    survey: &'a Survey,
    /// Index of the file's group.
    group: Option<u32>,
    /// The running phase and its start, ms.
    phase: Option<(u32, PhaseMark)>,
    /// The latest ambient pressure, in units; 0 if the readings are relative.
    ambient: i32,
    flows: [LatestFlow; 2],
    /// The reading of the pressure whose row is not complete: a flow of the same time may follow.
    open: Option<(u32, TableRow)>,
    last_breath: Option<u32>,
    /// Readings of the pressure that were there before.
    repeated: usize,
}

/// The latest reading of a flow, and one that belongs to the next row.
#[derive(Debug, Clone, Copy, Default)]
struct LatestFlow {
    now: i32,
    next: Option<i32>,
}

impl<'a> EventRows<'a> {
    pub(super) fn open(path: &Path, survey: &'a Survey) -> Result<Self, DatasetError> {
        let (reader, bytes) = open(path)?;
        Ok(Self {
            path: path.to_owned(),
            reader,
            bytes,
            group: None,
            phase: None,
            ambient: survey.ambient.map_or(0, |(_, median)| median),
            flows: [LatestFlow::default(); 2],
            open: None,
            last_breath: None,
            repeated: 0,
            survey,
        })
    }

    /// Takes a reading; returns the row that it completes.
    fn measured(&mut self, reading: &Measurement, group: u32) -> Option<TableRow> {
        let Measurement { sensor, ms, value, .. } = *reading;
        if self.survey.ambient.is_some_and(|(ambient, _)| ambient == sensor) {
            self.ambient = value;
        }
        let flow = match self.survey.flow {
            Some(FlowSensors::Net(net)) => (net == sensor).then_some(0),
            Some(FlowSensors::Each { inward, outward }) => {
                [inward, outward].iter().position(|one| *one == sensor)
            }
            None => None,
        };
        if let Some(flow) = flow {
            let of_open_row = self.open.is_some_and(|(open, _)| ms <= open);
            let latest = &mut self.flows[flow];
            if of_open_row { latest.now = value } else { latest.next = Some(value) }
        }
        if sensor != self.survey.pressure {
            return None;
        }
        // A writer that repeats each event does so before the flow of the same time.
        let same = |row: TableRow| row.get(Quantity::Pressure).to_bits() == self.relative(value).to_bits();
        let again = |(open, row): (u32, TableRow)| open == ms && same(row);
        if self.open.is_some_and(again) {
            self.repeated += 1;
            return None;
        }
        let complete = self.complete();
        self.flows.iter_mut().for_each(|flow| flow.now = flow.next.take().unwrap_or(flow.now));
        self.open = Some((ms, self.row(ms, value, group)));
        complete
    }

    /// A reading of the pressure without the ambient one, cmH2O.
    fn relative(&self, value: i32) -> f64 {
        (f64::from(value) - f64::from(self.ambient)) / PER_CMH2O
    }

    /// A row without its flows.
    fn row(&mut self, ms: u32, value: i32, group: u32) -> TableRow {
        let mut fields: Fields = [0.0; QUANTITIES];
        let mut set = |quantity: Quantity, value: f64| fields[quantity as usize] = value;
        set(Quantity::Time, f64::from(ms) * 1e-3);
        set(Quantity::Pressure, self.relative(value));
        set(Quantity::UIn, f64::NAN);
        let (mut next_breath, mut inspires) = (false, false);
        if let Some((start, mark)) = self.phase {
            set(Quantity::Target, mark.target(ms.saturating_sub(start)).into());
            inspires = mark.phase == INSPIRATION;
            next_breath = self.last_breath.replace(mark.breath) != Some(mark.breath);
        }
        TableRow { fields, next_breath, inspires, group }
    }

    /// The open row with its flows.
    fn complete(&mut self) -> Option<TableRow> {
        let (_, mut row) = self.open.take()?;
        let [first, second] = self.flows.map(|flow| f64::from(flow.now) / PER_LITRE_PER_SECOND);
        let [inward, outward] = match self.survey.flow {
            Some(FlowSensors::Each { .. }) => [first, second],
            _ => [first.max(0.0), (-first).max(0.0)],
        };
        row.fields[Quantity::FlowIn as usize] = inward;
        row.fields[Quantity::FlowOut as usize] = outward;
        Some(row)
    }
}

impl RowSource for EventRows<'_> {
    fn next(&mut self, groups: &mut Vec<TestRun>) -> Result<Option<TableRow>, DatasetError> {
        let group = *self.group.get_or_insert_with(|| {
            let name = self.path.file_stem().unwrap_or_default().to_string_lossy();
            index_of(groups, name.as_ref().into())
        });
        while let Some(event) = self.reader.next_event().map_err(|fault| faulty(&self.path, fault))? {
            let row = match event {
                Event::Measurement(reading) => self.measured(&reading, group),
                Event::Phase(ms, mark) => {
                    self.phase = Some((ms, mark));
                    None
                }
                Event::Other(_) => None,
            };
            if row.is_some() {
                return Ok(row);
            }
        }
        Ok(self.complete())
    }

    fn position(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    fn disorder(&self) -> Disorder {
        Disorder { repeated: self.repeated, ..Disorder::default() }
    }

    fn unused(&self) -> std::collections::BTreeMap<String, usize> {
        self.survey.unused.clone()
    }
}
