//! The thread that writes a device's files: a disk may take its time, a hub may not.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::thread::{self, JoinHandle};

use data::export::ExportError;
use data::provenance::Provenance;
use data::recording::{DatasetError, RecordingWriter, Row};
use shared::link::messages::{DeviceIdentity, Event};
use show::monitor::News;
use show::monitor::capture::Capture;
use thiserror::Error;

/// Rows and samples of news that may wait for the disk: fifteen seconds of a chip, whose samples are both.
pub const WAITING_MAX: usize = 30_000;

/// Why a recording is not written.
#[derive(Debug, Error)]
pub enum RecordError {
    /// The Parquet file.
    #[error(transparent)]
    Parquet(#[from] DatasetError),
    /// The MCAP file.
    #[error(transparent)]
    Mcap(#[from] ExportError),
    /// The thread has panicked.
    #[error("the writer has ended: restart the server to record again")]
    Ended,
}

/// The two files that can be written at the same time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Which {
    /// The recording that a page has started.
    Recording,
    /// A triggered capture.
    Capture,
}

/// The MCAP file beside a recording.
pub struct McapHead {
    /// Name of the device.
    pub name: String,
    /// The device.
    pub identity: DeviceIdentity,
    /// The start, ms since 1970.
    pub now_ms: u64,
}

/// Something to do.
pub enum Job {
    /// Create a file.
    Open {
        /// Which one.
        which: Which,
        /// Its path.
        path: PathBuf,
        /// Its origin.
        provenance: Box<Provenance>,
        /// With an MCAP file of the same name.
        mcap: Option<Box<McapHead>>,
    },
    /// Add rows.
    Rows {
        /// To which file.
        which: Which,
        /// The rows, in order.
        rows: Vec<Row>,
    },
    /// Add news, which came at a time in ms since 1970, to the MCAP file.
    News(Box<News>, u64),
    /// Mark the moment in the recording.
    Mark {
        /// The note in the Parquet file.
        note: String,
        /// The marker in the MCAP file.
        text: String,
        /// When, ms since 1970.
        now_ms: u64,
    },
    /// Finish a file.
    Close {
        /// Which one.
        which: Which,
        /// What to add to its notes.
        notes: Vec<String>,
    },
    /// Do nothing until the other end is dropped, like a disk that hangs.
    #[cfg(test)]
    Pause(Receiver<()>),
}

impl Job {
    /// What it takes of [`WAITING_MAX`].
    fn weight(&self) -> usize {
        match self {
            Self::Rows { rows, .. } => rows.len(),
            Self::News(news, _) => match &**news {
                News::Event(Event::Telemetry(batch)) => batch.samples.len(),
                _ => 1,
            },
            _ => 1,
        }
    }
}

/// What has become of a file.
#[derive(Debug)]
pub enum Report {
    /// It is there.
    Opened(Which),
    /// It could not be created.
    NotOpened(Which, RecordError),
    /// Writing has failed; the file is given up.
    Failed(Which, RecordError),
    /// It is finished.
    Closed(Which),
    /// The MCAP file ends; the recording goes on.
    McapFailed(RecordError),
}

/// The thread, as its owner sees it. It ends, when it has done everything, with the owner.
#[derive(Debug)]
pub struct Writer {
    jobs: Option<Sender<Job>>,
    reports: Receiver<Report>,
    /// Weight of the jobs that wait.
    waiting: Arc<AtomicUsize>,
    thread: Option<JoinHandle<()>>,
}

impl Writer {
    /// Starts it.
    pub fn start() -> Self {
        let (jobs, received) = channel::<Job>();
        let (report, reports) = channel();
        let waiting = Arc::new(AtomicUsize::new(0));
        let still = Arc::clone(&waiting);
        let thread = thread::spawn(move || {
            let mut files = OpenFiles { recording: None, capture: None, mcap: None };
            for job in received {
                let weight = job.weight();
                if let Some(done) = files.carry_out(job) {
                    // Nobody reads it if the owner is being dropped, but then the rest must be written all the same.
                    let _ = report.send(done);
                }
                still.fetch_sub(weight, Ordering::Relaxed);
            }
        });
        Self { jobs: Some(jobs), reports, waiting, thread: Some(thread) }
    }

    /// Whether there is room for samples: otherwise the disk is slower than they come.
    pub fn has_room(&self) -> bool {
        self.waiting.load(Ordering::Relaxed) < WAITING_MAX
    }

    /// Adds a job, whether there is room or not.
    pub fn give(&self, job: Job) {
        self.waiting.fetch_add(job.weight(), Ordering::Relaxed);
        if let Some(jobs) = &self.jobs {
            // Without the thread, `report` says that it has ended.
            let _ = jobs.send(job);
        }
    }

    /// The next report; never waits.
    ///
    /// # Errors
    /// [`RecordError::Ended`].
    pub fn report(&self) -> Result<Option<Report>, RecordError> {
        match self.reports.try_recv() {
            Ok(report) => Ok(Some(report)),
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => Err(RecordError::Ended),
        }
    }

    /// Waits until everything is written; returns the reports.
    pub fn end(&mut self) -> Vec<Report> {
        self.jobs = None;
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has already reported it.
            let _ = thread.join();
        }
        self.reports.try_iter().collect()
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        self.end();
    }
}

/// The open files.
struct OpenFiles {
    recording: Option<RecordingWriter>,
    capture: Option<RecordingWriter>,
    mcap: Option<Capture>,
}

impl OpenFiles {
    fn slot(&mut self, which: Which) -> &mut Option<RecordingWriter> {
        match which {
            Which::Recording => &mut self.recording,
            Which::Capture => &mut self.capture,
        }
    }

    /// Does a job. One for a file that has failed is dropped: the failure is reported already.
    fn carry_out(&mut self, job: Job) -> Option<Report> {
        match job {
            Job::Open { which, path, provenance, mcap } => {
                Some(match self.open(which, &path, *provenance, mcap.as_deref()) {
                    Ok(()) => Report::Opened(which),
                    Err(error) => Report::NotOpened(which, error),
                })
            }
            Job::Rows { which, rows } => self.add(which, rows),
            Job::News(news, now_ms) => {
                let failed = self.mcap.as_mut()?.take(&news, now_ms * 1_000_000);
                failed.then(|| self.end_mcap()).flatten()
            }
            Job::Mark { note, text, now_ms } => {
                self.recording.as_mut()?.provenance().notes.push(note);
                let failed = self.mcap.as_mut()?.mark(&text, now_ms * 1_000_000);
                failed.then(|| self.end_mcap()).flatten()
            }
            Job::Close { which, notes } => self.close(which, notes),
            #[cfg(test)]
            Job::Pause(until) => {
                while until.recv().is_ok() {}
                None
            }
        }
    }

    fn open(
        &mut self,
        which: Which,
        path: &Path,
        provenance: Provenance,
        mcap: Option<&McapHead>,
    ) -> Result<(), RecordError> {
        let recording = RecordingWriter::create(path, provenance, &[])?;
        // Half a recording would look like a whole one: without the MCAP file there is no Parquet file, either.
        if let Some(McapHead { name, identity, now_ms }) = mcap {
            let file = path.with_extension("mcap");
            self.mcap = Some(Capture::create(&file, name, identity, now_ms * 1_000_000)?);
        }
        *self.slot(which) = Some(recording);
        Ok(())
    }

    fn add(&mut self, which: Which, rows: Vec<Row>) -> Option<Report> {
        let slot = self.slot(which);
        let recording = slot.as_mut()?;
        let error = rows.into_iter().try_for_each(|row| recording.push(row)).err()?;
        *slot = None;
        if which == Which::Recording {
            // It ends with the recording; the first failure is the one that is reported.
            self.end_mcap();
        }
        Some(Report::Failed(which, error.into()))
    }

    /// Finishes a file, and the MCAP file with the recording, whatever happens to one of them.
    fn close(&mut self, which: Which, notes: Vec<String>) -> Option<Report> {
        let mcap = match which {
            Which::Recording => self.mcap.take(),
            Which::Capture => None,
        };
        let mcap = mcap.map_or(Ok(()), |mcap| mcap.finish().map(drop).map_err(RecordError::from));
        let mut recording = self.slot(which).take()?;
        recording.provenance().notes.extend(notes);
        let written = recording.finish().map_err(RecordError::from).and(mcap);
        Some(written.map_or_else(|error| Report::Failed(which, error), |()| Report::Closed(which)))
    }

    /// Gives up the MCAP file; reports its first failure.
    fn end_mcap(&mut self) -> Option<Report> {
        let reason = self.mcap.take()?.finish().err()?;
        Some(Report::McapFailed(reason.into()))
    }
}
