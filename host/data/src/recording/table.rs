//! One recording in memory: a structure of arrays with one entry per control tick, whose columns are listed in
//! [`super::columns`].

use std::ops::Range;

use shared::breath::Phase;

use super::columns::{Extra, Recording, Row, Values, ValuesMut};
use super::error::DatasetError;
use crate::identity::{LungParameters, TestRun};
use crate::provenance::Provenance;

/// Phase of the rows in which the controller follows the inspiratory waveform and is scored.
pub const INSPIRATION: u8 = 0;
/// Phase of the rows in which the target falls from PIP to PEEP.
pub const FALL: u8 = 1;
/// Phase of the rows at PEEP.
pub const EXPIRATION: u8 = 2;
/// The number of a phase.
pub const fn phase_number(phase: Phase) -> u8 {
    match phase {
        Phase::Inspiration => INSPIRATION,
        Phase::Fall => FALL,
        Phase::Expiration => EXPIRATION,
    }
}

/// The phase with this number, if there is one.
pub const fn numbered_phase(number: u8) -> Option<Phase> {
    match number {
        INSPIRATION => Some(Phase::Inspiration),
        FALL => Some(Phase::Fall),
        EXPIRATION => Some(Phase::Expiration),
        _ => None,
    }
}

/// Names of the phases, by their number.
pub const PHASE_NAMES: [&str; 3] = ["inspiration", "fall", "expiration"];

/// The lowest and the highest value of a column; `None` if it is empty.
pub fn range(values: &[f32]) -> Option<(f32, f32)> {
    values.iter().copied().reduce(f32::min).zip(values.iter().copied().reduce(f32::max))
}

impl Row {
    /// The lung, if the row gives R and C.
    pub fn lung(&self) -> Option<LungParameters> {
        Some(LungParameters { resistance: self.resistance?, compliance: self.compliance? })
    }
}

impl Recording {
    /// An empty recording, with the columns of [`Extra::TRUTH`] or without any optional column.
    pub fn new(provenance: Provenance, with_truth: bool) -> Self {
        Self::with_extras(provenance, if with_truth { &Extra::TRUTH } else { &[] })
    }

    /// Removes the columns of the truth that were never filled.
    pub fn leave_out_unknown(&mut self) {
        for column in [&mut self.pressure_true, &mut self.pressure_sensor_true] {
            let unknown = |values: &Vec<f32>| !values.is_empty() && values.iter().all(|value| value.is_nan());
            if column.as_ref().is_some_and(unknown) {
                *column = None;
            }
        }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.breath.len()
    }

    /// Whether the recording has no rows.
    pub fn is_empty(&self) -> bool {
        self.breath.is_empty()
    }

    /// Appends the rows of another recording. Its breaths are renumbered to continue this one's, its groups and notes
    /// are added, and a note gives the origin of its rows.
    ///
    /// # Errors
    /// [`DatasetError::Different`] if periods or columns differ, or breath numbers run out; `self` is then unchanged.
    pub fn append(&mut self, other: &Self) -> Result<(), DatasetError> {
        if self.provenance.period_us != other.provenance.period_us {
            return Err(DatasetError::Different("the control period"));
        }
        if !self.columns().iter().map(|c| c.0).eq(other.columns().iter().map(|c| c.0)) {
            return Err(DatasetError::Different("their columns"));
        }
        let (Some(&first), Some(&last)) = (other.breath.first(), other.breath.last()) else {
            return Ok(());
        };
        let next = self.breath.last().map_or(Some(0), |last| last.checked_add(1));
        let renumber = |breath: u32| breath.checked_sub(first)?.checked_add(next?);
        let numbers = DatasetError::Different("breath numbers that can follow on");
        renumber(last).ok_or(numbers)?;

        let rows = self.len();
        let groups = self.provenance.groups.len() as u32;
        for ((name, mine), (_, theirs)) in self.columns_mut().into_iter().zip(other.columns()) {
            match (mine, theirs) {
                (ValuesMut::U32(mine), Values::U32(theirs)) => match name {
                    "breath" => mine.extend(theirs.iter().filter_map(|&breath| renumber(breath))),
                    "group" => mine.extend(theirs.iter().map(|group| group.saturating_add(groups))),
                    _ => mine.extend_from_slice(theirs),
                },
                (ValuesMut::U8(mine), Values::U8(theirs)) => mine.extend_from_slice(theirs),
                (ValuesMut::F32(mine), Values::F32(theirs)) => mine.extend_from_slice(theirs),
                _ => unreachable!("both lists have the same order"),
            }
        }
        self.note_origin(rows, &other.provenance);
        Ok(())
    }

    fn note_origin(&mut self, first_row: usize, other: &Provenance) {
        let mine = &mut self.provenance;
        mine.groups.extend_from_slice(&other.groups);
        let weights = match other.weights_id.as_str() {
            "" => String::new(),
            id => format!(", controller weights {id}"),
        };
        mine.notes.push(format!(
            "The {} samples from number {} on are another recording: plant {}{weights}, seed {}, made by {}, revision {}.",
            self.breath.len() - first_row,
            first_row + 1,
            other.plant,
            other.seed,
            other.source,
            other.git_revision,
        ));
        mine.notes.extend_from_slice(&other.notes);
    }

    /// The test run of a row.
    pub fn test_run(&self, row: usize) -> Option<&TestRun> {
        let index = self.group.as_ref()?.get(row)?;
        self.provenance.groups.get(*index as usize)
    }

    /// Whether the rows give R and C of their lungs.
    pub fn names_lungs(&self) -> bool {
        self.resistance.is_some() && self.compliance.is_some()
    }

    /// The lung given in a row.
    pub fn lung(&self, row: usize) -> Option<LungParameters> {
        let [resistance, compliance] = [&self.resistance, &self.compliance].map(Option::as_ref);
        Some(LungParameters { resistance: *resistance?.get(row)?, compliance: *compliance?.get(row)? })
    }

    /// Rows of each breath.
    pub fn breaths(&self) -> Vec<Range<usize>> {
        let mut ranges = Vec::new();
        let mut start = 0;
        for chunk in self.breath.chunk_by(|a, b| a == b) {
            ranges.push(start..start + chunk.len());
            start += chunk.len();
        }
        ranges
    }

    /// Share of the inspiratory ticks that were perturbed, 0 to 1.
    pub fn explored(&self) -> f64 {
        let inspiratory = self.phase.iter().zip(&self.explore).filter(|(phase, _)| **phase == INSPIRATION);
        let (all, perturbed) = inspiratory
            .fold((0_usize, 0), |(all, some), (_, explore)| (all + 1, some + usize::from(*explore != 0.0)));
        perturbed as f64 / all.max(1) as f64
    }

    /// Rows of the inspiratory phase of each breath with a complete inspiration: recorded from tick 0, without a
    /// missing tick, and followed by a later phase of the same breath.
    pub fn inspirations(&self) -> Vec<Range<usize>> {
        self.breaths().into_iter().filter_map(|breath| self.inspiration(breath)).collect()
    }

    /// Rows of the inspiratory phase of the breath in these rows, if complete as in [`Self::inspirations`].
    pub fn inspiration(&self, breath: Range<usize>) -> Option<Range<usize>> {
        let length = self.phase[breath.clone()].iter().position(|&phase| phase != INSPIRATION)?;
        let whole = self.tick[breath.start..breath.start + length].iter().copied().eq(0..length as u32);
        (whole && length > 0).then_some(breath.start..breath.start + length)
    }

    /// Checks that all columns are equally long, every number is finite, phases and groups exist, and rows are in
    /// order: breath numbers never decrease, and ticks increase within a breath (with skips where a link lost rows).
    ///
    /// # Errors
    /// The first violated rule, with column and row.
    pub fn validate(&self) -> Result<(), DatasetError> {
        self.validate_rows()?;
        match &self.group {
            Some(group) => below("group", group.iter().copied(), self.provenance.groups.len()),
            None => Ok(()),
        }
    }

    /// Breath and tick of a row.
    pub(super) fn key(&self, row: usize) -> Option<(u32, u32)> {
        Some((*self.breath.get(row)?, *self.tick.get(row)?))
    }

    /// Like [`Self::validate`], without the groups.
    pub(super) fn validate_rows(&self) -> Result<(), DatasetError> {
        for (column, values) in self.columns() {
            if values.len() != self.len() {
                return Err(DatasetError::Length { column, rows: values.len(), expected: self.len() });
            }
            if let Values::F32(values) = values
                && let Some(row) = values.iter().position(|value| !value.is_finite())
            {
                return Err(DatasetError::NotFinite { column, row, value: values[row] });
            }
        }
        below("phase", self.phase.iter().map(|&phase| u32::from(phase)), usize::from(EXPIRATION) + 1)?;
        match (1..self.len()).find(|&row| self.key(row) <= self.key(row - 1)) {
            Some(row) => Err(DatasetError::Order(row)),
            None => Ok(()),
        }
    }
}

fn below(column: &'static str, values: impl Iterator<Item = u32>, limit: usize) -> Result<(), DatasetError> {
    match values.enumerate().find(|&(_, value)| value as usize >= limit) {
        Some((row, value)) => Err(DatasetError::OutOfRange { column, row, value, limit }),
        None => Ok(()),
    }
}
