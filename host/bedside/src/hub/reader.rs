//! Reads the flight recorder of a connected device between the other requests.

use std::sync::Arc;

use device::blackbox::Reading;
use shared::link::messages::{Request, Response};

use super::{Worker, send};
use crate::flight_recorder::content;
use crate::stream::{Answer, ToPage};
use crate::viewers::Viewer;

/// What comes after an answer of the device.
#[derive(Debug)]
pub enum Next {
    /// Another request.
    Ask(Request),
    /// All is read.
    Done(Box<Reading>),
    /// Why it cannot be read.
    Failed(String),
}

/// A reading for a page.
#[derive(Debug)]
pub struct RecorderReader {
    /// The page.
    pub viewer: Arc<Viewer>,
    /// Id of its request.
    pub id: u32,
    /// What was read; none before the device has reported what there is.
    reading: Option<Reading>,
}

impl RecorderReader {
    /// The first request of a reading.
    pub const FIRST: Request = Request::GetRecorder;

    /// Begins a reading.
    pub fn new(viewer: Arc<Viewer>, id: u32) -> Self {
        Self { viewer, id, reading: None }
    }

    /// Takes an answer; none if it belongs to another request.
    pub fn take(&mut self, request: &Request, result: &Result<Response, String>) -> Option<Next> {
        if !matches!(request, Request::GetRecorder | Request::ReadRecorder { .. }) {
            return None;
        }
        let reading = match (result, self.reading.take()) {
            (Ok(Response::Recorder(status)), None) => Some(Reading::new(*status)),
            (Ok(Response::Recorded(page)), Some(mut reading)) => reading.take(page).then_some(reading),
            (Ok(_), _) => None,
            (Err(reason), _) => return Some(Next::Failed(reason.clone())),
        };
        Some(match reading.map(|reading| (reading.request(), reading)) {
            Some((Some(request), reading)) => {
                self.reading = Some(reading);
                Next::Ask(request)
            }
            Some((None, reading)) => Next::Done(Box::new(reading)),
            None => Next::Failed("unexpected answer from the device".to_owned()),
        })
    }
}

impl Worker {
    /// Begins to read the flight recorder; an answer if that is not possible.
    pub(super) fn read_recorder(&mut self, viewer: &Arc<Viewer>, id: u32) -> Option<Answer> {
        if self.reading.is_some() {
            return Some(Answer::refused(Some(id), "the flight recorder is being read: try again soon"));
        }
        match self.source.ask(RecorderReader::FIRST) {
            Ok(()) => {
                self.reading = Some(RecorderReader::new(Arc::clone(viewer), id));
                None
            }
            Err(why) => Some(Answer::refused(Some(id), why.to_string())),
        }
    }

    /// Goes on reading the flight recorder with an answer of the device.
    pub(super) fn read_on(&mut self, request: &Request, result: &Result<Response, String>) {
        let Some(next) = self.reading.as_mut().and_then(|reading| reading.take(request, result)) else {
            return;
        };
        let failed = match next {
            Next::Ask(request) => self.source.ask(request).err().map(|why| why.to_string()),
            Next::Failed(reason) => Some(reason),
            Next::Done(reading) => {
                let Some(RecorderReader { viewer, id, .. }) = self.reading.take() else { return };
                let blackbox = reading.finish(self.period_us);
                let ticks = blackbox.fast.ticks().count() + blackbox.slow.ticks().count();
                let read = format!("{ticks} ticks and {} events read", blackbox.log.len());
                let recorder = Box::new(content(&blackbox));
                send(&viewer, &ToPage::Recorder { device: self.device, recorder });
                send(&viewer, &ToPage::Answer(Answer::done(id, read)));
                return;
            }
        };
        if let Some(reason) = failed
            && let Some(RecorderReader { viewer, id, .. }) = self.reading.take()
        {
            send(&viewer, &ToPage::Answer(Answer::refused(Some(id), reason)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::Metrics;
    use crate::viewers::Viewers;
    use shared::recorder::{Held, Page, RecorderPart, RecorderStatus, RecordingState};

    const READ: Request = Request::ReadRecorder { part: RecorderPart::Log, from: 5 };

    fn reader() -> RecorderReader {
        let viewer = Viewers::new(Arc::new(Metrics::new(&[]))).add("here", 0).unwrap();
        RecorderReader::new(viewer, 7)
    }

    /// The state of a recorder with three events.
    fn status() -> Response {
        let log = Held { first: 5, next: 8, origin: 0 };
        let (fast, slow) = (Held::default(), Held::default());
        let (recording, boot, tick, tick_boot) = (RecordingState::Nothing, 1, 0, 1);
        Response::Recorder(RecorderStatus { recording, boot, tick, tick_boot, fast, slow, log })
    }

    fn empty_page(first: u32) -> Response {
        Response::Recorded(Page { part: RecorderPart::Log, first, bytes: heapless::Vec::new() })
    }

    fn begun() -> RecorderReader {
        let mut reader = reader();
        let next = reader.take(&RecorderReader::FIRST, &Ok(status()));
        assert!(matches!(next, Some(Next::Ask(READ))), "{next:?}");
        reader
    }

    #[test]
    fn a_reading_goes_on_with_its_own_answers_to_its_end() {
        let mut reader = begun();
        assert!(reader.take(&Request::Identify, &Ok(empty_page(5))).is_none(), "not asked by it");
        assert!(matches!(reader.take(&READ, &Ok(empty_page(5))), Some(Next::Done(_))));
    }

    #[test]
    fn a_reading_fails_with_what_does_not_answer_it() {
        let failed =
            |mut reader: RecorderReader, answer| matches!(reader.take(&READ, &answer), Some(Next::Failed(_)));
        assert!(failed(reader(), Ok(empty_page(5))), "before the device has reported what there is");
        for (answer, why) in [
            (Ok(empty_page(3)), "a page from before"),
            (Ok(status()), "the state again"),
            (Ok(Response::Done), "another answer"),
            (Err("unplugged".to_owned()), "none"),
        ] {
            assert!(failed(begun(), answer), "{why}");
        }
    }
}
