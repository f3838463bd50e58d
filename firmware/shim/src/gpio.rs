//! Pins of one port (RM0090, section 8): they keep the program's settings, which a debugger can read.
//!
//! Nothing is connected to the pins: an input has the level of its pull resistor, and is low without one.

use crate::store::Store;

/// Length of the registers, bytes.
pub const BYTES: u32 = 0x28;

const MODER: usize = 0;
const PUPDR: usize = 3;
const IDR: usize = 4;
const ODR: usize = 5;
const BSRR: usize = 6;

/// The registers of a port, in their order.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Gpio {
    registers: [u32; BYTES as usize / 4],
}

impl Gpio {
    /// A port whose mode, speed and pull registers hold these values after a reset.
    pub const fn new(mode: u32, speed: u32, pull: u32) -> Self {
        Self { registers: [mode, 0, speed, pull, 0, 0, 0, 0, 0, 0] }
    }

    /// A port with these register values.
    pub fn from_words(registers: [u32; BYTES as usize / 4]) -> Self {
        Self { registers }
    }

    /// Mode of a pin: 0 input, 1 output, 2 alternate function, 3 analogue.
    pub fn mode(&self, pin: u32) -> u32 {
        self.registers[MODER] >> (2 * pin) & 3
    }

    /// Whether a pin is high.
    pub fn level(&self, pin: u32) -> bool {
        self.levels() >> pin & 1 == 1
    }

    fn levels(&self) -> u32 {
        const OUTPUT: u32 = 1;
        const PULL_UP: u32 = 1;
        let level = |pin: u32| {
            let pulled_up = self.registers[PUPDR] >> (2 * pin) & 3 == PULL_UP;
            let driven = self.registers[ODR] >> pin & 1;
            if self.mode(pin) == OUTPUT { driven } else { u32::from(pulled_up) }
        };
        (0..16).fold(0, |levels, pin| levels | level(pin) << pin)
    }

    /// The word at an offset; zero where there is no register.
    pub fn read(&self, offset: u32) -> u32 {
        match offset as usize / 4 {
            IDR => self.levels(),
            BSRR => 0,
            index => self.registers.get(index).copied().unwrap_or(0),
        }
    }

    /// Stores to an offset.
    pub fn write(&mut self, offset: u32, store: Store) {
        match offset as usize / 4 {
            IDR => {}
            ODR => self.registers[ODR] = store.over(self.registers[ODR]) & 0xFFFF,
            BSRR => {
                let (set, reset) = (store.bits() & 0xFFFF, store.bits() >> 16);
                self.registers[ODR] = self.registers[ODR] & !reset | set;
            }
            index => {
                if let Some(register) = self.registers.get_mut(index) {
                    *register = store.over(*register);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Width;

    fn port() -> Gpio {
        Gpio::new(0, 0, 0)
    }

    #[test]
    fn an_output_has_the_level_that_was_set() {
        let mut port = port();
        port.write(0x00, Store::word(0b01 << 6));
        port.write(0x18, Store::word(1 << 3));
        assert!(port.level(3));
        assert_eq!(port.read(0x10), 1 << 3);
        port.write(0x18, Store::word(1 << 19));
        assert!(!port.level(3));
    }

    #[test]
    fn setting_wins_over_resetting() {
        let mut port = port();
        port.write(0x18, Store::word(1 << 16 | 1));
        assert_eq!(port.read(0x14), 1);
    }

    #[test]
    fn half_a_store_to_the_set_register_sets_nothing_else() {
        let mut port = port();
        port.write(0x14, Store::word(0xFF));
        port.write(0x18, Store::new(0x1A, Width::Half, 0x01));
        assert_eq!(port.read(0x14), 0xFE);
    }

    #[test]
    fn an_input_follows_its_pull_resistor() {
        let mut port = port();
        port.write(0x14, Store::word(0xFFFF));
        port.write(0x0C, Store::word(0b01 << 4));
        assert_eq!(port.read(0x10), 1 << 2);
    }
}
