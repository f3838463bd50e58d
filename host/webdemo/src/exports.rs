//! What the page calls. Only numbers pass between JavaScript and WebAssembly: the page writes its message into [`input`] and reads
//! the ones for it at [`message`].
#![expect(unsafe_code, reason = "an exported name is an unsafe attribute; there is no unsafe block")]

use std::cell::RefCell;

use crate::demo::{Demo, Message};

/// What [`next`] has found.
const NOTHING: u32 = 0;
/// A text.
const TEXT: u32 = 1;
/// Samples.
const SAMPLES: u32 = 2;

#[derive(Default)]
struct Page {
    demo: Option<Demo>,
    input: Vec<u8>,
    message: Vec<u8>,
}

thread_local! {
    static PAGE: RefCell<Page> = RefCell::default();
}

fn with<T>(run: impl FnOnce(&mut Page) -> T) -> T {
    PAGE.with_borrow_mut(run)
}

/// Starts the demonstration at a time in ms since 1970; 1 if it runs. If not, the message is the reason.
#[unsafe(no_mangle)]
pub extern "C" fn start(now_ms: f64) -> u32 {
    with(|page| match Demo::start(now_ms) {
        Ok(demo) => {
            page.demo = Some(demo);
            1
        }
        Err(why) => {
            page.message = why.to_string().into_bytes();
            0
        }
    })
}

/// Runs the devices until a time in ms since 1970.
#[unsafe(no_mangle)]
pub extern "C" fn advance(now_ms: f64) {
    with(|page| {
        if let Some(demo) = &mut page.demo {
            demo.advance(now_ms);
        }
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
        if let Some(demo) = &mut page.demo {
            demo.receive(&String::from_utf8_lossy(&page.input), now_ms);
        }
    });
}

/// Puts the next message for the page at [`message`]: 0 if there is none, 1 for a text, 2 for samples.
#[unsafe(no_mangle)]
pub extern "C" fn next() -> u32 {
    with(|page| match page.demo.as_mut().and_then(Demo::take) {
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
