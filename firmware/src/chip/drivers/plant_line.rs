//! Hardware in the loop: the lockstep plant link on USART2 in place of sensors and valves.
//!
//! One polled exchange per tick (more at the start of a breath): a frame and its answer. Without an answer in time there is
//! no reading, and the next exchange sends the same frame again.

use embassy_stm32::pac::USART2;
use shared::breath::DEFAULT_PERIOD_US;
use shared::device::control::PlantChange;
use shared::link::messages::DeviceKind;
use shared::link::plant_link::{PlantDecoder, PlantFrame, PlantMessage};
use shared::safety::filter::ValveCommand;
use shared::sensor::Readings;

use super::clock;
use super::core_clock::CORE_CLOCK;
use super::plant_interface::PlantInterface;

/// Longest wait for an answer, 3 ms in cycles. Ticks that pass meanwhile count as missed, and 5 in a breath latch a fault.
const TIMEOUT: u32 = CORE_CLOCK.0 / 1_000 * 3;
/// Longest wait for a plant that did not answer before, cycles: half a tick, so that the link task still gets time.
const RETRY_TIMEOUT: u32 = CORE_CLOCK.0 / 2_000;

/// The plant link as the ventilator's sensor and valves.
pub struct PlantLine {
    decoder: PlantDecoder,
    tick: u16,
    command: ValveCommand,
    /// Frame that was sent and not yet answered.
    unanswered: Option<PlantFrame>,
}

impl PlantLine {
    /// The line, which [`super::open_serial`] has opened; from then on its registers are polled.
    pub fn new() -> Self {
        Self { decoder: PlantDecoder::default(), tick: 0, command: ValveCommand::SAFE, unanswered: None }
    }

    /// Sends a message and waits for its answer; returns the pressure in it, cmH2O.
    fn exchange(&mut self, message: PlantMessage) -> Option<f32> {
        let timeout = if self.unanswered.is_some() { RETRY_TIMEOUT } else { TIMEOUT };
        if self.unanswered.is_none() {
            self.tick = self.tick.wrapping_add(1);
        }
        let frame = *self.unanswered.get_or_insert(PlantFrame { tick: self.tick, message });
        let start = clock::now();
        for byte in frame.encode() {
            while !USART2.sr().read().txe() {}
            USART2.dr().write(|w| w.set_dr(byte.into()));
        }
        loop {
            let status = USART2.sr().read();
            if status.rxne() {
                let byte = USART2.dr().read().dr() as u8;
                if let Some(pressure) = self.decoder.push(byte).and_then(|answer| answered(&frame, &answer)) {
                    self.unanswered = None;
                    return Some(pressure);
                }
            } else if clock::now().wrapping_sub(start) > timeout {
                return None;
            }
        }
    }
}

/// The pressure in `answer`, if it answers this frame.
fn answered(asked: &PlantFrame, answer: &PlantFrame) -> Option<f32> {
    if asked.tick != answer.tick {
        return None;
    }
    match (asked.message, answer.message) {
        (PlantMessage::Step { .. }, PlantMessage::Pressure { pressure })
        | (
            PlantMessage::Reset { .. } | PlantMessage::Peep { .. } | PlantMessage::Seed { .. },
            PlantMessage::Ready { pressure },
        ) => Some(pressure),
        _ => None,
    }
}

impl PlantInterface for PlantLine {
    const KIND: DeviceKind = DeviceKind::HardwareInTheLoop;

    fn read(&mut self, change: &PlantChange) -> Readings {
        let (u_in, u_out) = (self.command.u_in(), self.command.u_out());
        let turn =
            |line: &mut Self| change.peep.map(|pressure| line.exchange(PlantMessage::Peep { pressure }));
        // A new PEEP is for the breath that begins: send it after the last step of the previous breath, but before a reset.
        let reading = if let Some(seed) = change.reset {
            turn(self);
            self.exchange(PlantMessage::Seed { seed });
            self.exchange(PlantMessage::Reset { period_us: DEFAULT_PERIOD_US })
        } else {
            let reading = self.exchange(PlantMessage::Step { u_in, u_out });
            turn(self);
            reading
        };
        reading.unwrap_or(f32::NAN).into()
    }

    fn drive(&mut self, command: &ValveCommand) {
        self.command = *command;
    }
}
