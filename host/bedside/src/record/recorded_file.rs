//! A file that is being written: how far it is, and what is in it.

use std::path::PathBuf;

/// Why a recording cannot hold a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gap {
    /// A value is no number.
    NoNumber,
    /// The settings are not known.
    Unset,
}

/// How far a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// It is being created.
    Opening,
    /// It takes rows.
    Open,
    /// It is being finished.
    Closing,
}

/// A file that is being written.
#[derive(Clone, Debug)]
pub struct RecordedFile {
    /// How far it is.
    pub stage: Stage,
    /// Its path.
    pub path: PathBuf,
    /// The page that has started it, or what has triggered it, in words.
    pub by: String,
    /// Samples in it.
    pub samples: u64,
    /// Samples for which the writer had no room.
    pub lost: u64,
    /// Samples with a value that is no number, and those from before the device reported its settings.
    left_out: u64,
    unset: u64,
}

impl RecordedFile {
    /// A file that a page has started, or an event has triggered.
    pub fn new(path: PathBuf, by: &str) -> Self {
        let by = by.to_owned();
        Self { stage: Stage::Opening, path, by, samples: 0, lost: 0, left_out: 0, unset: 0 }
    }

    /// Whether it takes rows.
    pub fn takes(&self) -> bool {
        self.stage != Stage::Closing
    }

    /// A sample that is not in it.
    pub fn leave_out(&mut self, gap: Gap) {
        *match gap {
            Gap::NoNumber => &mut self.left_out,
            Gap::Unset => &mut self.unset,
        } += 1;
    }

    /// What is not in it, in words.
    pub fn gaps(&self) -> Vec<String> {
        let gaps = [
            (self.left_out, "left out", "with a value that is no number"),
            (self.unset, "left out", "before the device reported its settings"),
            (self.lost, "lost", "for which the disk was too slow"),
        ];
        let gaps = gaps.into_iter().filter(|(count, ..)| *count > 0);
        gaps.map(|(count, what, why)| format!("{what}: {count} samples {why}")).collect()
    }

    /// What is in it, in words.
    pub fn content(&self) -> String {
        let written = format!("{} samples written to {}", self.samples, self.path.display());
        std::iter::once(written).chain(self.gaps()).collect::<Vec<_>>().join("; ")
    }
}
