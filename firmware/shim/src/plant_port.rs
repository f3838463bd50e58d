//! USART2 as the line to the plant (RM0090, section 30): a port without interrupts or transmission time.
//!
//! Sending never waits. The sent bytes go to the host when the program reads the status twice in a row and there is nothing
//! to receive, since that is how a program waits for an answer; between two bytes that it sends it reads the status once.
//! The exchange takes no time on the chip.
//!
//! A program that has no plant on its line leaves the port off. For such a program the port itself sends empty requests at
//! regular intervals, so that the host can limit the speed of its virtual time.

use crate::store::Store;

/// Ticks from one empty request to the next while the port is off.
pub const PACE_TICKS: u32 = 10;

/// Buffer size in each direction, bytes.
const BUFFER: usize = 256;

const STATUS: u32 = 0x00;
const DATA: u32 = 0x04;
const CONTROL_1: u32 = 0x0C;
/// Offset of the last register.
const LAST: u32 = 0x18;
/// Flags TXE and TC: the transmitter is empty.
const SENT: u32 = 1 << 7 | 1 << 6;
/// Flag RXNE: a byte was received.
const RECEIVED: u32 = 1 << 5;
/// Bit UE in the first control register: the port is enabled.
const ENABLED: u32 = 1 << 13;

/// The other end of the line.
pub trait Line {
    /// Takes the sent bytes.
    fn send(&mut self, bytes: &[u8]);
    /// Copies received bytes to the buffer; returns their number, zero if there are none.
    fn receive(&mut self, bytes: &mut [u8]) -> usize;
}

/// The serial port.
#[derive(Clone, Debug)]
pub struct PlantPort {
    /// Values of baud rate and control registers.
    registers: [u32; LAST as usize / 4 + 1],
    outgoing: Queue,
    incoming: Queue,
    taken: usize,
    /// Whether the last access read the status.
    waiting: bool,
    /// Ticks since the last empty request.
    unpaced: u32,
}

#[derive(Clone, Debug)]
struct Queue {
    bytes: [u8; BUFFER],
    length: usize,
}

impl Queue {
    const fn new() -> Self {
        Self { bytes: [0; BUFFER], length: 0 }
    }

    fn filled(&self) -> &[u8] {
        &self.bytes[..self.length.min(BUFFER)]
    }
}

impl PlantPort {
    /// The port after a reset.
    pub(crate) const fn new() -> Self {
        let registers = [0; LAST as usize / 4 + 1];
        Self {
            registers,
            outgoing: Queue::new(),
            incoming: Queue::new(),
            taken: 0,
            waiting: false,
            unpaced: 0,
        }
    }

    /// A system tick: sends an empty request now and then, if the port is off.
    pub fn tick(&mut self, line: &mut impl Line) {
        self.unpaced += 1;
        if self.unpaced == PACE_TICKS {
            self.unpaced = 0;
            if !self.is_enabled() {
                line.send(&[]);
            }
        }
    }

    fn is_enabled(&self) -> bool {
        self.registers[CONTROL_1 as usize / 4] & ENABLED != 0
    }

    /// The word at an offset; zero where there is no register.
    #[inline]
    pub fn read(&mut self, offset: u32, line: &mut impl Line) -> u32 {
        match offset {
            STATUS => self.status(line),
            DATA => self.take(),
            _ => self.registers.get(offset as usize / 4).copied().unwrap_or(0),
        }
    }

    /// Stores to an offset.
    #[inline]
    pub fn write(&mut self, offset: u32, store: Store, line: &mut impl Line) {
        match offset {
            STATUS => {}
            DATA => self.give(store.bits() as u8, line),
            _ => {
                if let Some(register) = self.registers.get_mut(offset as usize / 4) {
                    *register = store.over(*register);
                }
            }
        }
    }

    #[inline]
    fn status(&mut self, line: &mut impl Line) -> u32 {
        if self.taken == self.incoming.length && self.waiting {
            self.flush(line);
            (self.taken, self.incoming.length) = (0, line.receive(&mut self.incoming.bytes));
        }
        self.waiting = true;
        if self.taken == self.incoming.length { SENT } else { SENT | RECEIVED }
    }

    #[inline]
    fn take(&mut self) -> u32 {
        self.waiting = false;
        let Some(byte) = self.incoming.filled().get(self.taken) else { return 0 };
        self.taken += 1;
        u32::from(*byte)
    }

    #[inline]
    fn give(&mut self, byte: u8, line: &mut impl Line) {
        self.waiting = false;
        if !self.is_enabled() {
            return;
        }
        if self.outgoing.length == BUFFER {
            self.flush(line);
        }
        self.outgoing.bytes[self.outgoing.length] = byte;
        self.outgoing.length += 1;
    }

    fn flush(&mut self, line: &mut impl Line) {
        if self.outgoing.length > 0 {
            line.send(self.outgoing.filled());
            self.outgoing.length = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;
    use std::vec::Vec;

    /// Stores the sent bytes and answers with prepared pieces.
    #[derive(Default)]
    struct Recorder {
        sent: Vec<Vec<u8>>,
        answers: VecDeque<Vec<u8>>,
    }

    impl Line for Recorder {
        fn send(&mut self, bytes: &[u8]) {
            self.sent.push(bytes.to_vec());
        }

        fn receive(&mut self, bytes: &mut [u8]) -> usize {
            let answer = self.answers.pop_front().unwrap_or_default();
            bytes[..answer.len()].copy_from_slice(&answer);
            answer.len()
        }
    }

    fn enabled(line: &mut Recorder) -> PlantPort {
        let mut port = PlantPort::new();
        port.write(CONTROL_1, Store::word(ENABLED), line);
        port
    }

    /// Sends like a driver, which waits for room before each byte.
    fn send(port: &mut PlantPort, line: &mut Recorder, bytes: &[u8]) {
        for &byte in bytes {
            assert_ne!(port.read(STATUS, line) & SENT, 0);
            port.write(DATA, Store::word(byte.into()), line);
        }
    }

    /// Receives like a driver, with at most `polls` consecutive polls without a byte.
    fn receive(port: &mut PlantPort, line: &mut Recorder, polls: usize) -> Vec<u8> {
        let (mut bytes, mut idle) = (Vec::new(), 0);
        while idle < polls {
            if port.read(STATUS, line) & RECEIVED == 0 {
                idle += 1;
            } else {
                bytes.push(port.read(DATA, line) as u8);
                idle = 0;
            }
        }
        bytes
    }

    #[test]
    fn a_frame_goes_out_whole_when_its_answer_is_awaited() {
        let mut line = Recorder { answers: [b"answer".to_vec()].into(), ..Recorder::default() };
        let mut port = enabled(&mut line);
        send(&mut port, &mut line, b"sixteen bytes...");
        assert!(line.sent.is_empty());
        assert_eq!(receive(&mut port, &mut line, 3), b"answer");
        assert_eq!(line.sent, [b"sixteen bytes..."]);
    }

    #[test]
    fn what_was_answered_is_not_asked_again() {
        let mut line = Recorder::default();
        let mut port = enabled(&mut line);
        send(&mut port, &mut line, b"frame");
        assert!(receive(&mut port, &mut line, 100).is_empty());
        assert_eq!(line.sent, [b"frame"]);
    }

    #[test]
    fn a_long_answer_comes_in_pieces() {
        let pieces = [std::vec![1; BUFFER], std::vec![2; BUFFER], std::vec![3; 5]];
        let mut line = Recorder { answers: pieces.clone().into(), ..Recorder::default() };
        let mut port = enabled(&mut line);
        send(&mut port, &mut line, b"frame");
        assert_eq!(receive(&mut port, &mut line, 3), pieces.concat());
    }

    #[test]
    fn more_than_the_buffer_holds_is_sent_in_pieces() {
        let mut line = Recorder::default();
        let mut port = enabled(&mut line);
        let bytes: Vec<u8> = (0..BUFFER + 10).map(|n| n as u8).collect();
        send(&mut port, &mut line, &bytes);
        receive(&mut port, &mut line, 2);
        assert_eq!(line.sent.concat(), bytes);
    }

    #[test]
    fn a_port_that_is_off_sends_nothing() {
        let mut line = Recorder::default();
        let mut port = PlantPort::new();
        send(&mut port, &mut line, b"frame");
        receive(&mut port, &mut line, 3);
        assert!(line.sent.is_empty());
    }

    #[test]
    fn a_port_that_is_off_lets_the_host_set_the_pace() {
        let requests = |port: &mut PlantPort| {
            let mut line = Recorder::default();
            (0..3 * PACE_TICKS).for_each(|_| port.tick(&mut line));
            line.sent
        };
        assert_eq!(requests(&mut PlantPort::new()), [[0; 0]; 3]);
        assert!(requests(&mut enabled(&mut Recorder::default())).is_empty());
    }

    #[test]
    fn speed_and_control_registers_are_stored() {
        let mut line = Recorder::default();
        let mut port = PlantPort::new();
        for offset in [0x08, 0x0C, 0x10, 0x14, 0x18] {
            port.write(offset, Store::word(offset + 7), &mut line);
            assert_eq!(port.read(offset, &mut line), offset + 7);
        }
    }
}
