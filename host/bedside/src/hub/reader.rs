//! Reads the flight recorder of a connected device, page by page, between the other requests.

use std::sync::Arc;

use shared::link::messages::{Request, Response};
use shared::recorder::entry::{EVENT_BYTES, TICK_BYTES};
use shared::recorder::{
    FAST_ENTRIES, Held, LOG_ENTRIES, LogEntry, Page, RecorderPart, RecorderStatus, SLOW_ENTRIES, TickEntry,
};

use crate::flight_recorder::Entries;
use crate::viewers::Viewer;

/// A part of a flight recorder, bytes of an entry, and most entries.
type Part = (RecorderPart, usize, usize);
/// The parts in the order in which they are read: the ring first that is overwritten fastest.
const PARTS: [Part; 3] = [
    (RecorderPart::Fast, TICK_BYTES, FAST_ENTRIES),
    (RecorderPart::Slow, TICK_BYTES, SLOW_ENTRIES),
    (RecorderPart::Log, EVENT_BYTES, LOG_ENTRIES),
];

/// What comes after an answer of the device.
#[derive(Debug)]
pub enum Next {
    /// Another request.
    Ask(Request),
    /// What was read.
    Done(Box<Entries>),
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
    /// Of each part: the next entry to read, the first one that it had not yet when the reading began, and the bytes so far.
    parts: [(u32, u32, Vec<u8>); PARTS.len()],
}

impl RecorderReader {
    /// The first request of a reading.
    pub const FIRST: Request = Request::GetRecorder;

    /// Begins a reading.
    pub fn new(viewer: Arc<Viewer>, id: u32) -> Self {
        Self { viewer, id, parts: Default::default() }
    }

    /// Takes an answer; none if it belongs to another request.
    pub fn take(&mut self, request: &Request, result: &Result<Response, String>) -> Option<Next> {
        let asked = match request {
            Request::GetRecorder => None,
            Request::ReadRecorder { part, .. } => Some(*part),
            _ => return None,
        };
        Some(match result {
            Ok(Response::Recorder(status)) => {
                self.begin(status);
                self.go_on()
            }
            Ok(Response::Recorded(page)) if asked == Some(page.part) && self.add(page) => self.go_on(),
            Ok(_) => Next::Failed("unexpected answer from the device".to_owned()),
            Err(reason) => Next::Failed(reason.clone()),
        })
    }

    fn begin(&mut self, status: &RecorderStatus) {
        let held = [status.fast, status.slow, status.log];
        self.parts = std::array::from_fn(|place| {
            let (Held { first, next, .. }, (_, _, most)) = (held[place], PARTS[place]);
            (first.max(next.saturating_sub(most as u32)), next, Vec::new())
        });
    }

    /// Adds a page; false if it is from before what was asked for.
    fn add(&mut self, page: &Page) -> bool {
        let place = PARTS.iter().position(|(part, ..)| *part == page.part).unwrap_or_default();
        let ((_, length, _), (next, end, bytes)) = (PARTS[place], &mut self.parts[place]);
        if page.first < *next {
            return false;
        }
        if page.first > *next {
            // The oldest entries were overwritten meanwhile: what was read does not join what follows.
            bytes.clear();
        }
        let fresh = end.saturating_sub(page.first) as usize;
        let count = fresh.min(page.bytes.len() / length);
        bytes.extend_from_slice(&page.bytes[..count * length]);
        // An empty page means that there are no more.
        *next = if count == 0 { *end } else { page.first.saturating_add(count as u32) };
        true
    }

    fn go_on(&mut self) -> Next {
        let unread = PARTS.iter().zip(&self.parts).find(|(_, (next, end, _))| next < end);
        if let Some(((part, ..), (next, ..))) = unread {
            return Next::Ask(Request::ReadRecorder { part: *part, from: *next });
        }
        let [fast, slow, log] = std::mem::take(&mut self.parts).map(|(_, _, bytes)| bytes);
        // A damaged event is left out.
        let log = log.as_chunks().0.iter().filter_map(|entry| LogEntry::read(*entry)).collect();
        Next::Done(Box::new(Entries { fast: ticks(&fast), slow: ticks(&slow), log }))
    }
}

fn ticks(bytes: &[u8]) -> Vec<Option<TickEntry>> {
    bytes.as_chunks().0.iter().map(|entry| TickEntry::read(*entry)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::Metrics;
    use crate::viewers::Viewers;
    use shared::recorder::RecordingState;

    fn reader() -> RecorderReader {
        let viewer = Viewers::new(Arc::new(Metrics::new(&[]))).add("here", 0).unwrap();
        RecorderReader::new(viewer, 7)
    }

    /// The state of a recorder that holds these entries of its fast ring and of its log.
    fn status(fast: [u32; 2], log: [u32; 2]) -> Response {
        let held = |[first, next]: [u32; 2]| Held { first, next, origin: 0 };
        let (recording, boot, tick, tick_boot) = (RecordingState::Nothing, 1, 0, 1);
        let (fast, slow, log) = (held(fast), Held::default(), held(log));
        Response::Recorder(RecorderStatus { recording, boot, tick, tick_boot, fast, slow, log })
    }

    /// A page whose entries are zeros; the first byte of each tick is its number.
    fn page(part: RecorderPart, first: u32, entries: usize) -> Response {
        let length = if part == RecorderPart::Log { EVENT_BYTES } else { TICK_BYTES };
        let number =
            |byte: usize| if byte.is_multiple_of(length) { first as usize + byte / length } else { 0 };
        let bytes = (0..entries * length).map(|byte| number(byte) as u8).collect();
        Response::Recorded(Page { part, first, bytes })
    }

    fn read(part: RecorderPart, from: u32) -> Request {
        Request::ReadRecorder { part, from }
    }

    fn asks(next: Option<&Next>, part: RecorderPart, from: u32) {
        assert!(matches!(next, Some(Next::Ask(request)) if *request == read(part, from)), "{next:?}");
    }

    #[test]
    fn parts_are_read_page_by_page_up_to_the_end_at_the_start() {
        use RecorderPart::{Fast, Log};
        let mut reader = reader();
        asks(reader.take(&RecorderReader::FIRST, &Ok(status([0, 50], [5, 30]))).as_ref(), Fast, 0);
        assert!(reader.take(&Request::Identify, &Ok(page(Fast, 0, 30))).is_none(), "not asked by it");
        asks(reader.take(&read(Fast, 0), &Ok(page(Fast, 0, 30))).as_ref(), Fast, 30);
        // The slow ring is empty.
        asks(reader.take(&read(Fast, 30), &Ok(page(Fast, 30, 30))).as_ref(), Log, 5);
        asks(reader.take(&read(Log, 5), &Ok(page(Log, 5, 18))).as_ref(), Log, 23);
        let Some(Next::Done(entries)) = reader.take(&read(Log, 23), &Ok(page(Log, 23, 18))) else { panic!() };
        assert_eq!((entries.fast.len(), entries.slow.len()), (50, 0));
    }

    #[test]
    fn what_was_read_before_entries_that_were_overwritten_is_left_out() {
        use RecorderPart::Fast;
        let mut reader = reader();
        reader.take(&RecorderReader::FIRST, &Ok(status([0, 80], [0, 0])));
        asks(reader.take(&read(Fast, 0), &Ok(page(Fast, 0, 30))).as_ref(), Fast, 30);
        asks(reader.take(&read(Fast, 30), &Ok(page(Fast, 50, 20))).as_ref(), Fast, 70);
        let Some(Next::Done(entries)) = reader.take(&read(Fast, 70), &Ok(page(Fast, 70, 30))) else {
            panic!()
        };
        let Response::Recorded(expected) = page(Fast, 50, 30) else { panic!() };
        assert_eq!(format!("{:?}", entries.fast), format!("{:?}", ticks(&expected.bytes)));
    }

    #[test]
    fn whatever_a_device_answers_a_reading_ends() {
        use RecorderPart::{Fast, Log, Slow};
        let oldest = u32::MAX - LOG_ENTRIES as u32;
        let first = |answer| {
            let mut reader = reader();
            asks(
                reader.take(&RecorderReader::FIRST, &Ok(status([9, 3], [0, u32::MAX]))).as_ref(),
                Log,
                oldest,
            );
            reader.take(&read(Log, oldest), &answer)
        };
        assert!(matches!(first(Ok(page(Log, u32::MAX - 1024, 0))), Some(Next::Done(_))), "an empty page");
        assert!(matches!(first(Ok(page(Log, 3, 18))), Some(Next::Failed(_))), "a page from before");
        assert!(matches!(first(Ok(page(Slow, oldest, 18))), Some(Next::Failed(_))), "a page of another part");
        assert!(matches!(first(Ok(page(Fast, u32::MAX, 1))), Some(Next::Failed(_))));
        assert!(matches!(first(Ok(Response::Done)), Some(Next::Failed(_))), "another answer");
        assert!(matches!(first(Err("unplugged".to_owned())), Some(Next::Failed(_))));
    }
}
