//! Reads the event log of a connected device's flight recorder, page by page, between the other requests.

use std::sync::Arc;

use shared::link::messages::{Request, Response};
use shared::recorder::entry::EVENT_BYTES;
use shared::recorder::{Held, LOG_ENTRIES, LogEntry, RecorderPart};

use crate::viewers::Viewer;

/// What comes after an answer of the device.
#[derive(Debug)]
pub enum Next {
    /// Another request.
    Ask(Request),
    /// The log, oldest event first.
    Done(Vec<LogEntry>),
    /// Why it cannot be read.
    Failed(String),
}

/// A reading for a page.
#[derive(Debug)]
pub struct LogReader {
    /// The page.
    pub viewer: Arc<Viewer>,
    /// Id of its request.
    pub id: u32,
    /// The next entry to read, and the first one that the log had not yet when the reading began.
    next: u32,
    end: u32,
    entries: Vec<LogEntry>,
}

impl LogReader {
    /// The first request of a reading.
    pub const FIRST: Request = Request::GetRecorder;

    /// Begins a reading.
    pub fn new(viewer: Arc<Viewer>, id: u32) -> Self {
        Self { viewer, id, next: 0, end: 0, entries: Vec::new() }
    }

    /// Takes an answer; none if it belongs to another request.
    pub fn take(&mut self, request: &Request, result: &Result<Response, String>) -> Option<Next> {
        if !matches!(request, Request::GetRecorder | Request::ReadRecorder { .. }) {
            return None;
        }
        Some(match result {
            Ok(Response::Recorder(status)) => {
                let Held { first, next, .. } = status.log;
                (self.next, self.end) = (first.max(next.saturating_sub(LOG_ENTRIES as u32)), next);
                self.go_on()
            }
            Ok(Response::Recorded(page)) if page.first >= self.next => {
                let fresh = self.end.saturating_sub(page.first) as usize;
                let read = page.bytes.as_chunks::<EVENT_BYTES>().0.iter().take(fresh);
                // An empty page means that there are no more.
                let count = read.len() as u32;
                self.next = if count == 0 { self.end } else { page.first.saturating_add(count) };
                // A damaged event is left out.
                self.entries.extend(read.filter_map(|entry| LogEntry::read(*entry)));
                self.go_on()
            }
            Ok(_) => Next::Failed("unexpected answer from the device".to_owned()),
            Err(reason) => Next::Failed(reason.clone()),
        })
    }

    fn go_on(&mut self) -> Next {
        if self.next < self.end {
            Next::Ask(Request::ReadRecorder { part: RecorderPart::Log, from: self.next })
        } else {
            Next::Done(std::mem::take(&mut self.entries))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::Metrics;
    use crate::viewers::Viewers;
    use shared::recorder::{Page, RecorderStatus, RecordingState};

    fn reader() -> LogReader {
        let viewer = Viewers::new(Arc::new(Metrics::new(&[]))).add("here", 0).unwrap();
        LogReader::new(viewer, 7)
    }

    fn status(first: u32, next: u32) -> Response {
        let log = Held { first, next, origin: 0 };
        let none = Held::default();
        let (recording, boot, tick, tick_boot) = (RecordingState::Nothing, 1, 0, 1);
        Response::Recorder(RecorderStatus { recording, boot, tick, tick_boot, fast: none, slow: none, log })
    }

    fn page(first: u32, entries: usize) -> Response {
        let bytes = (0..entries * EVENT_BYTES).map(|_| 0).collect();
        Response::Recorded(Page { part: RecorderPart::Log, first, bytes })
    }

    fn read(from: u32) -> Request {
        Request::ReadRecorder { part: RecorderPart::Log, from }
    }

    fn asks(next: Option<&Next>, from: u32) {
        assert!(matches!(next, Some(Next::Ask(request)) if *request == read(from)), "{next:?}");
    }

    #[test]
    fn pages_are_read_one_after_the_other_up_to_the_end_at_the_start() {
        let mut reader = reader();
        asks(reader.take(&LogReader::FIRST, &Ok(status(5, 30))).as_ref(), 5);
        assert!(reader.take(&Request::Identify, &Ok(page(5, 18))).is_none(), "not asked by it");
        asks(reader.take(&read(5), &Ok(page(5, 18))).as_ref(), 23);
        assert!(matches!(reader.take(&read(23), &Ok(page(23, 18))), Some(Next::Done(_))));
    }

    #[test]
    fn whatever_a_device_answers_a_reading_ends() {
        let first = |answer: Result<Response, &str>| {
            let mut reader = reader();
            let oldest = u32::MAX - LOG_ENTRIES as u32;
            asks(reader.take(&LogReader::FIRST, &Ok(status(0, u32::MAX))).as_ref(), oldest);
            reader.take(&read(oldest), &answer.map_err(str::to_owned))
        };
        assert!(matches!(first(Ok(page(u32::MAX - 1024, 0))), Some(Next::Done(_))), "an empty page");
        assert!(matches!(first(Ok(page(3, 18))), Some(Next::Failed(_))), "a page from before");
        assert!(matches!(first(Ok(Response::Done)), Some(Next::Failed(_))), "another answer");
        assert!(matches!(first(Err("unplugged")), Some(Next::Failed(_))));
    }
}
