//! The link task: it passes bytes, requests and reports between the line, the server and the control task, and owns the flash.

use embassy_futures::select::{Either, select};
use shared::device::ControlReport;
use shared::device::server::{DeviceFacts, NextStep, Server};
use shared::link::frame::{DECODER_BYTES, FRAME_BYTES, FrameDecoder, Poll, encode_frame};
use shared::link::messages::{ToDevice, ToHost, read_request};
use shared::recorder::keeper::{Keeper, Leave};

use static_cell::StaticCell;

use super::control_task::{self, REPLY, REPORTS, REQUEST};
use super::drivers::flash::BoardFlash;
use super::drivers::{clock, link_uart, supply, watchdog};
use super::storage::Storage;
use super::{prescription, recorder};

/// Version of the firmware: major, minor, patch.
pub const VERSION: [u16; 3] = [
    number(env!("CARGO_PKG_VERSION_MAJOR")),
    number(env!("CARGO_PKG_VERSION_MINOR")),
    number(env!("CARGO_PKG_VERSION_PATCH")),
];
/// Most bytes read from the line at once.
const CHUNK: usize = 64;

const fn number(digits: &str) -> u16 {
    match u16::from_str_radix(digits, 10) {
        Ok(number) => number,
        Err(_) => panic!("cargo gives version numbers in digits"),
    }
}

/// The device's server half. Static and built in place: as part of the task it would be moved through the stack.
static SERVER: StaticCell<Server<'static>> = StaticCell::new();

/// Builds the server. Called once.
#[inline(never)]
pub fn prepare(facts: DeviceFacts) -> &'static mut Server<'static> {
    SERVER.init_with(|| Server::new(facts, recorder::memory()))
}

/// Serves the link; never returns.
#[embassy_executor::task]
pub async fn run(server: &'static mut Server<'static>, mut storage: Storage, mut keeper: Option<Keeper>) {
    let mut decoder = FrameDecoder::<DECODER_BYTES>::new();
    let mut chunk = [0; CHUNK];
    loop {
        match select(link_uart::receive(&mut chunk), REPORTS.receive()).await {
            Either::First(count) => {
                for byte in &chunk[..count] {
                    if let Poll::Frame(content) = decoder.push(*byte) {
                        match read_request(content) {
                            Ok(request) => serve(server, &mut storage, &request).await,
                            Err(unreadable) => {
                                if let Some(refusal) = unreadable.refusal() {
                                    send(&refusal).await;
                                }
                            }
                        }
                    }
                }
                server.corrupt_frames(decoder.counters().corrupt().wrapping_add(link_uart::lost()));
            }
            Either::Second(report) => {
                for event in server.report(&report) {
                    send(&event).await;
                }
                // The counters come regularly, in every mode.
                if let ControlReport::Counters(_) = report {
                    prescription::tend(control_task::ventilates());
                    if let Some(keeper) = &mut keeper {
                        keep_recording(keeper, storage.flash());
                    }
                }
            }
        }
    }
}

/// Handles a request up to its answer. Like [`Server::serve`], but the control half answers in its next tick.
async fn serve(server: &mut Server<'_>, storage: &mut Storage, request: &ToDevice) {
    let mut step = server.receive(request, clock::number(), storage);
    let answer = loop {
        step = match step {
            NextStep::Control(request, role) => {
                REQUEST.signal((request, role));
                server.control_replied(REPLY.wait().await, storage)
            }
            NextStep::Answer(answer) => break answer,
        };
    };
    send(&answer.message).await;
    if answer.restart {
        link_uart::flush();
        cortex_m::peripheral::SCB::sys_reset();
    }
}

/// Does the next piece of work on the copy of the flight recorder in flash.
fn keep_recording(keeper: &mut Keeper, flash: &mut BoardFlash) {
    let allowed = control_task::leave();
    let leave = if allowed != Leave::Nothing && supply::has_returned() { allowed } else { Leave::Nothing };
    if keeper.step(flash, recorder::memory(), leave) {
        // The core stalls while a sector is erased.
        watchdog::with_long_timeout(|| keeper.erase(flash));
    }
}

async fn send(message: &ToHost) {
    let mut buffer = [0; FRAME_BYTES];
    // The buffer has room for every message.
    if let Ok(frame) = encode_frame(message, &mut buffer) {
        link_uart::send(frame).await;
    }
}
