//! What the page calls. Only numbers pass between JavaScript and WebAssembly: the page writes its message into [`input`] and reads
//! the ones for it at [`message`].
#![expect(unsafe_code, reason = "an exported name is an unsafe attribute; there is no unsafe block")]

use std::cell::RefCell;

use dfu::{Failed, Transfer};

use crate::board::Board;
use crate::demo::Demo;
use crate::flash::{Flash, built_in};
use crate::page::Message;

/// What [`next`] has found.
const NOTHING: u32 = 0;
/// A text.
const TEXT: u32 = 1;
/// Samples.
const SAMPLES: u32 = 2;
/// What [`transfer`] has found: nothing more, a transfer to the device, one from it, a pause.
const DONE: u32 = 0;
const OUT: u32 = 1;
const IN: u32 = 2;
const WAIT: u32 = 3;
/// Results of a transfer for [`took`]; any other is that the device is gone.
const CAME: u32 = 0;
const STALLED: u32 = 1;

#[derive(Default)]
struct Page {
    demo: Option<Demo>,
    /// The real device, which is shown in place of the demonstration.
    board: Option<Board>,
    flash: Flash,
    input: Vec<u8>,
    message: Vec<u8>,
}

thread_local! {
    static PAGE: RefCell<Page> = RefCell::default();
}

impl Page {
    /// 1 and the content as the message, or 0 and the reason.
    fn report(&mut self, result: Result<Vec<u8>, String>) -> u32 {
        let ok = result.is_ok();
        self.message = result.unwrap_or_else(String::into_bytes);
        ok.into()
    }

    fn next(&mut self) -> Option<Message> {
        match &mut self.board {
            Some(board) => board.take(),
            None => self.demo.as_mut()?.take(),
        }
    }
}

fn with<T>(run: impl FnOnce(&mut Page) -> T) -> T {
    PAGE.with_borrow_mut(run)
}

/// Starts the demonstration at a time in ms since 1970; 1 if it runs. If not, the message is the reason.
#[unsafe(no_mangle)]
pub extern "C" fn start(now_ms: f64) -> u32 {
    with(|page| {
        let started = Demo::start(now_ms).map(|demo| page.demo = Some(demo));
        page.report(started.map(|()| vec![]).map_err(|why| why.to_string()))
    })
}

/// Runs what is shown until a time in ms since 1970.
#[unsafe(no_mangle)]
pub extern "C" fn advance(now_ms: f64) {
    with(|page| match (&mut page.board, &mut page.demo) {
        (Some(board), _) => board.advance(now_ms as u64),
        (None, Some(demo)) => demo.advance(now_ms),
        (None, None) => {}
    });
}

/// Room for a message of the page of this many bytes.
#[unsafe(no_mangle)]
pub extern "C" fn input(bytes: u32) -> *mut u8 {
    with(|page| {
        page.input.clear();
        page.input.resize(bytes as usize, 0);
        page.input.as_mut_ptr()
    })
}

/// Takes the message of the page, at a time in ms since 1970.
#[unsafe(no_mangle)]
pub extern "C" fn receive(now_ms: f64) {
    with(|page| {
        let text = String::from_utf8_lossy(&page.input);
        match (&mut page.board, &mut page.demo) {
            (Some(board), _) => board.receive(&text, now_ms as u64),
            (None, Some(demo)) => demo.receive(&text, now_ms),
            (None, None) => {}
        }
    });
}

/// Puts the next message for the page at [`message`]: 0 if there is none, 1 for a text, 2 for samples.
#[unsafe(no_mangle)]
pub extern "C" fn next() -> u32 {
    with(|page| match page.next() {
        None => NOTHING,
        Some(Message::Text(text)) => {
            page.message = text.into_bytes();
            TEXT
        }
        Some(Message::Samples(bytes)) => {
            page.message = bytes;
            SAMPLES
        }
    })
}

/// Shows the device of a port that was just opened: with the page's random token, and a first sequence number that is random each time.
#[unsafe(no_mangle)]
pub extern "C" fn connect(token: u32, first: u32) {
    with(|page| page.board = Some(Board::new(token, first as u16)));
}

/// Takes the input as bytes of the port, at a time in ms since 1970.
#[unsafe(no_mangle)]
pub extern "C" fn hear(now_ms: f64) {
    with(|page| {
        if let Some(board) = &mut page.board {
            board.hear(&page.input, now_ms as u64);
        }
    });
}

/// Makes the bytes to write to the port the message.
#[unsafe(no_mangle)]
pub extern "C" fn wire() {
    with(|page| page.message = page.board.as_mut().map_or_else(Vec::new, Board::wire));
}

/// The port is gone, at a time in ms since 1970.
#[unsafe(no_mangle)]
pub extern "C" fn unplugged(now_ms: f64) {
    with(|page| {
        if let Some(board) = &mut page.board {
            board.unplugged(now_ms as u64);
        }
    });
}

/// Leaves the device and shows the demonstration again; the message is the last bytes for the port.
#[unsafe(no_mangle)]
pub extern "C" fn leave() {
    with(|page| {
        page.message = page.board.take().map_or_else(Vec::new, |mut board| board.leave());
        if let Some(demo) = &mut page.demo {
            demo.greet();
        }
    });
}

/// Makes the key that the module was built with the message, which is empty without one.
#[unsafe(no_mangle)]
pub extern "C" fn release_key() {
    with(|page| page.message = built_in().map_or_else(Vec::new, |key| key.to_string().into_bytes()));
}

/// Verifies the input: a key, a line break and a release file. 1 and a description as JSON, or 0 and the reason as the message.
#[unsafe(no_mangle)]
pub extern "C" fn open_release() -> u32 {
    with(|page| {
        let opened = page.flash.open(&page.input);
        page.report(opened.map(String::into_bytes).map_err(|why| why.to_string()))
    })
}

/// Begins to flash it; the input is the name of the boot loader's interface. 1, or 0 and the reason as the message.
#[unsafe(no_mangle)]
pub extern "C" fn begin_flash() -> u32 {
    with(|page| {
        let begun = page.flash.begin(&String::from_utf8_lossy(&page.input));
        page.report(begun.map(|()| vec![]).map_err(|why| why.to_string()))
    })
}

/// The next transfer: 0 if all is done; 1 to the device, whose message is request (u8), value (u16, little-endian) and content; 2 from the
/// device, with request, value and length (u16); 3 a pause, with its ms (u32).
#[unsafe(no_mangle)]
pub extern "C" fn transfer() -> u32 {
    with(|page| {
        let head = |request: u8, value: u16| [&[request][..], &value.to_le_bytes()].concat();
        let (kind, message) = match page.flash.due() {
            Transfer::Done => (DONE, vec![]),
            Transfer::Out { request, value, data } => (OUT, [head(request, value), data].concat()),
            Transfer::In { request, value, length } => {
                (IN, [&head(request, value)[..], &length.to_le_bytes()].concat())
            }
            Transfer::Wait(ms) => (WAIT, ms.to_le_bytes().to_vec()),
        };
        page.message = message;
        kind
    })
}

/// Takes the result of that transfer: 0 with what came as the input, 1 if the device refused it, 2 if it is gone. 1 if flashing goes on, or
/// 0 and the reason as the message.
#[unsafe(no_mangle)]
pub extern "C" fn took(result: u32) -> u32 {
    with(|page| {
        let result = match result {
            CAME => Ok(page.input.as_slice()),
            STALLED => Err(Failed::Stalled),
            _ => Err(Failed::Gone),
        };
        let taken = page.flash.took(result);
        page.report(taken.map(|()| vec![]).map_err(|why| why.to_string()))
    })
}

/// Share of the flashing that is done, from 0 to 1.
#[unsafe(no_mangle)]
pub extern "C" fn flashed() -> f64 {
    with(|page| page.flash.share())
}

/// The message for the page.
#[unsafe(no_mangle)]
pub extern "C" fn message() -> *const u8 {
    with(|page| page.message.as_ptr())
}

/// Its length, bytes.
#[unsafe(no_mangle)]
pub extern "C" fn message_bytes() -> u32 {
    with(|page| page.message.len() as u32)
}
