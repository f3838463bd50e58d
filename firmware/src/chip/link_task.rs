//! The link task: moves bytes, orders and reports between the line, the desk and the control task; owns the flash.

use embassy_futures::select::{Either, select};
use shared::control::residual::Residual;
use shared::device::Report;
use shared::device::desk::{Desk, Facts, Step};
use shared::link::frame::{DECODER_BYTES, FRAME_BYTES, FrameDecoder, Poll, encode_frame};
use shared::link::messages::{Slot, SlotState, ToDevice, ToHost, read_request};
use shared::weights::IMAGE_BYTES;
use shared::weights::slots::Slots;

use static_cell::StaticCell;

use super::control_task::{ANSWER, ORDER, REPORTS};
use super::drivers::flash::{WeightsFlash, slots};
use super::drivers::{link_uart, watchdog};
use super::recorder;

/// Version of the firmware: major, minor, patch.
pub const VERSION: [u16; 3] = [
    number(env!("CARGO_PKG_VERSION_MAJOR")),
    number(env!("CARGO_PKG_VERSION_MINOR")),
    number(env!("CARGO_PKG_VERSION_PATCH")),
];
/// Bytes taken from the line at once.
const CHUNK: usize = 64;

const fn number(digits: &str) -> u16 {
    match u16::from_str_radix(digits, 10) {
        Ok(number) => number,
        Err(_) => panic!("cargo gives versions in digits"),
    }
}

/// The weights slots.
pub struct Storage {
    slots: Slots<WeightsFlash>,
}

impl Storage {
    /// The slots of a flash.
    pub fn new(flash: WeightsFlash) -> Self {
        Self { slots: Slots::new(flash, slots().map(|slot| slot.start)) }
    }

    /// The newest weights that this chip can reproduce bit for bit, what both slots hold, and which one was taken.
    pub fn load(&mut self) -> (Option<Residual>, [SlotState; 2], Option<Slot>) {
        let loaded = self.slots.load();
        let states = self.slots.states();
        match loaded {
            Some((slot, image)) => (Some(image.residual), states, Some(slot)),
            None => (None, states, None),
        }
    }

    /// Stores a validated image; the core stands still while a sector is erased. Gives the slot that took it, if one
    /// did, and what both hold now.
    fn store(&mut self, image: &[u8; IMAGE_BYTES]) -> (Option<Slot>, [SlotState; 2]) {
        let stored = watchdog::patiently(|| self.slots.store(image));
        (stored.ok().map(|(slot, _)| slot), self.slots.states())
    }
}

/// The device's other half. Kept here and built in place: as part of the task it would be moved over the stack.
static DESK: StaticCell<Desk> = StaticCell::new();

/// Makes the desk. Called once.
#[inline(never)]
pub fn prepare(facts: Facts) -> &'static mut Desk {
    DESK.init_with(|| Desk::new(facts))
}

/// Runs for ever.
#[embassy_executor::task]
pub async fn run(desk: &'static mut Desk, mut storage: Storage) {
    let mut decoder = FrameDecoder::<DECODER_BYTES>::new();
    let mut chunk = [0; CHUNK];
    loop {
        match select(link_uart::receive(&mut chunk), REPORTS.receive()).await {
            Either::First(count) => {
                for byte in &chunk[..count] {
                    if let Poll::Frame(content) = decoder.push(*byte) {
                        match read_request(content) {
                            Ok(request) => serve(desk, &mut storage, &request).await,
                            Err(unreadable) => {
                                if let Some(sequence) = unreadable.sequence {
                                    send(&desk.unreadable(sequence)).await;
                                }
                            }
                        }
                    }
                }
                desk.corrupt_frames(decoder.counters().corrupt().wrapping_add(link_uart::lost()));
            }
            Either::Second(report) => tell(desk, &report).await,
        }
    }
}

/// Takes a request to its answer.
async fn serve(desk: &mut Desk, storage: &mut Storage, request: &ToDevice) {
    let mut step = desk.receive(request);
    loop {
        step = match step {
            Step::Send(answer) => return send(&answer).await,
            Step::Ask(order) => {
                ORDER.signal(order);
                desk.answered(ANSWER.wait().await)
            }
            Step::Look(look) => desk.looked(recorder::memory().look(look)),
            Step::Store => {
                let (slot, states) = storage.store(desk.image());
                desk.stored(slot, states)
            }
            Step::Restart(answer) => {
                send(&answer).await;
                link_uart::flush();
                cortex_m::peripheral::SCB::sys_reset();
            }
        };
    }
}

async fn tell(desk: &mut Desk, report: &Report) {
    for event in desk.report(report) {
        send(&event).await;
    }
}

async fn send(message: &ToHost) {
    let mut buffer = [0; FRAME_BYTES];
    // The buffer has room for every message.
    if let Ok(frame) = encode_frame(message, &mut buffer) {
        link_uart::send(frame).await;
    }
}
