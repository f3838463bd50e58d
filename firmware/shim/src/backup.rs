//! Backup domain (RM0090, sections 5.1.2, 7.3.20 and 26): memory of 4 KiB, and a calendar clock on a crystal of 32,768 Hz. A
//! cell supplies both while the main supply is away.
//!
//! QEMU has neither. [`Domain`] is what the cell keeps: it survives a reset in memory, and the end of QEMU in a file. A program
//! gets no access to it before it has enabled that, and only writes the clock's time in the clock's initialisation mode. Missing
//! are alarms, interrupts, time stamps, the clock's own 20 registers, and any clock source but the crystal.

use crate::store::Store;

/// Length of the memory, bytes.
pub const MEMORY_BYTES: u32 = 4096;
/// Address at which the shim keeps the domain, as in the linker script.
pub const ADDRESS: u32 = 0x1000_AC00;
/// Number of words of a domain.
pub const WORDS: usize = MEMORY_WORDS + 4;
/// Length of a domain in its file, bytes.
pub const BYTES: usize = 4 * WORDS;
/// Place of the clock's time in a domain; its date follows.
pub const TIME: usize = MEMORY_WORDS + 1;

const MEMORY_WORDS: usize = MEMORY_BYTES as usize / 4;
const CONTROL: usize = MEMORY_WORDS;
const DATE: usize = TIME + 1;
const REGULATOR: usize = DATE + 1;

/// Date of a clock that was not set: the year 0.
const NO_DATE: u32 = 0x2101;
/// `RCC_BDCR`.
mod control {
    pub const CRYSTAL_ON: u32 = 1;
    pub const CRYSTAL_READY: u32 = 1 << 1;
    pub const SOURCE: u32 = 0b11 << 8;
    pub const CRYSTAL: u32 = 0b01 << 8;
    pub const CLOCK_ON: u32 = 1 << 15;
    pub const RESET: u32 = 1 << 16;
}

/// The part of the chip that the cell supplies: memory, `RCC_BDCR`, time, date, and whether the memory's regulator is on.
#[derive(Clone, Debug, PartialEq, Eq)]
#[repr(transparent)]
pub struct Domain([u32; WORDS]);

impl Domain {
    /// The domain when the cell is inserted: the memory has any content.
    pub fn new() -> Self {
        let mut domain = Self([0; WORDS]);
        domain.renew();
        domain
    }

    /// A cell is inserted.
    pub fn renew(&mut self) {
        self.lose_memory();
        (self.0[CONTROL], self.0[TIME], self.0[DATE]) = (0, 0, NO_DATE);
    }

    fn lose_memory(&mut self) {
        let mut word = 0x6C61_6D65_u32;
        for cell in &mut self.0[..MEMORY_WORDS] {
            word = word.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            *cell = word;
        }
        self.0[REGULATOR] = 0;
    }

    /// The domain in a file of [`BYTES`].
    pub fn from_bytes(bytes: &[u8; BYTES]) -> Self {
        let mut words = bytes.as_chunks().0.iter().copied().map(u32::from_le_bytes);
        Self(core::array::from_fn(|_| words.next().unwrap_or(0)))
    }

    /// The words of the domain.
    pub fn words(&self) -> &[u32; WORDS] {
        &self.0
    }

    /// The main supply was away for this time while the cell was there.
    pub fn outlast(&mut self, seconds: u32) {
        if self.0[REGULATOR] == 0 {
            self.lose_memory();
        }
        if self.runs() {
            (0..seconds).for_each(|_| self.count());
        }
    }

    /// Whether the clock runs.
    fn runs(&self) -> bool {
        const NEEDED: u32 = control::CLOCK_ON | control::CRYSTAL_ON | control::CRYSTAL_READY;
        let register = self.0[CONTROL];
        register & NEEDED == NEEDED && register & control::SOURCE == control::CRYSTAL
    }

    /// The next second of the clock.
    fn count(&mut self) {
        let mut time = self.0[TIME];
        for (shift, end) in [(0, 0x60), (8, 0x60), (16, 0x24)] {
            let (next, carries) = next(time >> shift & 0xFF, end, 0);
            time = time & !(0xFF << shift) | next << shift;
            if !carries {
                self.0[TIME] = time;
                return;
            }
        }
        self.0[TIME] = time;
        self.count_day();
    }

    fn count_day(&mut self) {
        let date = self.0[DATE];
        let (year, month, day) = (date >> 16 & 0xFF, date >> 8 & 0x1F, date & 0x3F);
        let end = match month {
            // Divided by four, ten years leave two, and sixteen none.
            2 if (year + 2 * (year >> 4)).is_multiple_of(4) => 0x30,
            2 => 0x29,
            4 | 6 | 9 | 0x11 => 0x31,
            _ => 0x32,
        };
        let weekday = (date >> 13 & 7) % 7 + 1;
        let (day, month_ends) = next(day, end, 1);
        let (month, year_ends) = if month_ends { next(month, 0x13, 1) } else { (month, false) };
        let (year, _) = if year_ends { next(year, 0xA0, 0) } else { (year, false) };
        self.0[DATE] = year << 16 | weekday << 13 | month << 8 | day;
    }

    /// Stores to `RCC_BDCR`; `crystal` if the board has a sound one. The clock's source can be selected once.
    fn control(&mut self, store: Store, crystal: bool) {
        let before = self.0[CONTROL];
        let mut value = store.over(before) & !control::CRYSTAL_READY;
        if value & control::RESET != 0 {
            (self.0[CONTROL], self.0[TIME], self.0[DATE]) = (control::RESET, 0, NO_DATE);
            return;
        }
        if before & control::SOURCE != 0 {
            value = value & !control::SOURCE | before & control::SOURCE;
        }
        if value & control::CRYSTAL_ON != 0 && crystal {
            value |= control::CRYSTAL_READY;
        }
        self.0[CONTROL] = value;
    }
}

impl Default for Domain {
    fn default() -> Self {
        Self::new()
    }
}

/// The binary coded decimal after `number`, or `first` and true at `end`.
fn next(number: u32, end: u32, first: u32) -> (u32, bool) {
    let next = if number & 15 == 9 { (number | 15) + 1 } else { number + 1 };
    if next == end { (first, true) } else { (next, false) }
}

/// The chip's access to the domain, which a reset closes.
#[derive(Clone, Debug)]
pub struct Access {
    /// Number of keys of the clock that were written.
    keys: usize,
    /// Whether the clock is in its initialisation mode.
    initialises: bool,
    /// Time of the last look at the clock, ns, and the part of the current second before it.
    looked: Option<u32>,
    second_ns: u32,
}

const KEYS: [u32; 2] = [0xCA, 0x53];
const SECOND_NS: u32 = 1_000_000_000;
/// Bits of `RTC_ISR`: the date was set, the registers for reading follow the clock, initialisation mode.
const IS_SET: u32 = 1 << 4;
const FOLLOWS: u32 = 1 << 5;
const INITIALISES: u32 = 1 << 6;
const INITIALISE: u32 = 1 << 7;

impl Access {
    /// Access after a reset.
    pub(crate) const fn new() -> Self {
        Self { keys: 0, initialises: false, looked: None, second_ns: 0 }
    }

    /// Lets the clock run until `now`, in nanoseconds, wrapping; true if a second has passed. Call it more often than that.
    pub fn run(&mut self, domain: &mut Domain, now: u32, crystal: bool) -> bool {
        let passed = self.looked.replace(now).map_or(0, |before| now.wrapping_sub(before));
        if !domain.runs() || !crystal || self.initialises {
            return false;
        }
        self.second_ns = self.second_ns.saturating_add(passed);
        let over = self.second_ns >= SECOND_NS;
        if over {
            self.second_ns -= SECOND_NS;
            domain.count();
        }
        over
    }

    /// `RCC_BDCR`.
    pub fn read_control(&self, domain: &Domain, crystal: bool) -> u32 {
        let lost = if crystal { 0 } else { control::CRYSTAL_READY };
        domain.0[CONTROL] & !lost
    }

    /// The word of the clock at an offset; zero for registers that are not modelled.
    pub fn read_clock(&self, domain: &Domain, offset: u32) -> u32 {
        match offset {
            0x00 => domain.0[TIME],
            0x04 => domain.0[DATE],
            0x0C => {
                let set = if domain.0[DATE] & 0xFF_0000 == 0 { 0 } else { IS_SET };
                let follows = if domain.runs() && !self.initialises { FOLLOWS } else { 0 };
                let initialises = if self.initialises { INITIALISES | INITIALISE } else { 0 };
                set | follows | initialises
            }
            _ => 0,
        }
    }

    /// Stores to the clock at an offset; returns the place of the changed word. It has no effect before both keys were written.
    pub fn write_clock(&mut self, domain: &mut Domain, offset: u32, store: Store) -> Option<usize> {
        let open = self.keys == KEYS.len();
        match offset {
            0x00 if open && self.initialises => domain.0[TIME] = store.over(domain.0[TIME]),
            0x04 if open && self.initialises => domain.0[DATE] = store.over(domain.0[DATE]),
            0x0C if open => self.initialises = store.bits() & INITIALISE != 0 && domain.runs(),
            0x24 => {
                let right = KEYS.get(self.keys) == Some(&(store.bits() & 0xFF));
                self.keys = if right { self.keys + 1 } else { 0 };
            }
            _ => {}
        }
        match offset {
            0x00 => Some(TIME),
            0x04 => Some(DATE),
            _ => None,
        }
    }
}

/// Stores to `RCC_BDCR`; returns the places of the words that may have changed.
pub fn write_control(domain: &mut Domain, store: Store, crystal: bool) -> [usize; 3] {
    domain.control(store, crystal);
    [CONTROL, TIME, DATE]
}

/// Switches the memory's regulator on; returns the place of the changed word.
pub fn regulate(domain: &mut Domain) -> usize {
    domain.0[REGULATOR] = 1;
    REGULATOR
}

/// The word of the memory at an offset.
pub fn read_memory(domain: &Domain, offset: u32) -> u32 {
    domain.0[..MEMORY_WORDS].get(offset as usize / 4).copied().unwrap_or(0)
}

/// Stores to the memory at an offset; returns the place of the changed word.
pub fn write_memory(domain: &mut Domain, offset: u32, store: Store) -> Option<usize> {
    let place = offset as usize / 4;
    let word = domain.0[..MEMORY_WORDS].get_mut(place)?;
    *word = store.over(*word);
    Some(place)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A domain whose clock runs, and the access that has set it.
    fn running() -> (Domain, Access) {
        let (mut domain, mut access) = (Domain::new(), Access::new());
        write_control(&mut domain, Store::word(0x8101), true);
        set(&mut domain, &mut access, 0x23_5958, 0x24_8228);
        (domain, access)
    }

    fn set(domain: &mut Domain, access: &mut Access, time: u32, date: u32) {
        for (offset, value) in
            [(0x24, 0xFF), (0x24, 0xCA), (0x24, 0x53), (0x0C, 0x80), (0, time), (4, date), (0x0C, 0)]
        {
            access.write_clock(domain, offset, Store::word(value));
        }
    }

    #[test]
    fn a_new_clock_has_no_date_and_stands() {
        let (mut domain, mut access) = (Domain::new(), Access::new());
        assert_eq!(access.read_clock(&domain, 0x0C), 0);
        assert!(!access.run(&mut domain, 0, true) && !access.run(&mut domain, SECOND_NS, true));
    }

    #[test]
    fn a_clock_that_was_set_counts_seconds_days_and_leap_days() {
        let (mut domain, mut access) = running();
        assert_eq!(access.read_clock(&domain, 0x0C), IS_SET | FOLLOWS);
        assert!(!access.run(&mut domain, 5, true));
        assert!(!access.run(&mut domain, SECOND_NS + 4, true));
        assert!(access.run(&mut domain, SECOND_NS + 5, true));
        assert_eq!([0, 4].map(|offset| access.read_clock(&domain, offset)), [0x23_5959, 0x24_8228]);
        domain.outlast(1);
        assert_eq!(domain.0[TIME..=DATE], [0, 0x24_A229], "2024 is a leap year");
        domain.outlast(86_400 + 900);
        assert_eq!(domain.0[TIME..=DATE], [0x00_1500, 0x24_C301]);
        set(&mut domain, &mut access, 0x19_5959, 0x19_1231);
        domain.outlast(1);
        assert_eq!(domain.0[TIME..=DATE], [0x20_0000, 0x19_1231]);
        domain.outlast(4 * 3600);
        assert_eq!(domain.0[TIME..=DATE], [0, 0x20_2101]);
    }

    #[test]
    fn the_time_is_set_with_both_keys_and_in_the_initialisation_mode_only() {
        let (domain, _) = running();
        for omitted in 0..3 {
            let (mut domain, mut access) = (domain.clone(), Access::new());
            for (number, (offset, value)) in
                [(0x24, 0xCA), (0x24, 0x53), (0x0C, 0x80), (0, 0x11_1111)].into_iter().enumerate()
            {
                if number != omitted {
                    access.write_clock(&mut domain, offset, Store::word(value));
                }
            }
            assert_eq!(domain.0[TIME], 0x23_5958, "{omitted}");
        }
    }

    #[test]
    fn without_its_crystal_the_clock_stands_and_says_so() {
        let (mut domain, mut access) = running();
        access.run(&mut domain, 0, false);
        assert!(!access.run(&mut domain, SECOND_NS, false));
        assert_eq!(access.read_control(&domain, false), 0x8101);
        assert_eq!(access.read_control(&domain, true), 0x8103);
    }

    #[test]
    fn the_source_is_selected_once_and_a_reset_of_the_domain_clears_the_clock_and_not_the_memory() {
        let (mut domain, access) = running();
        write_memory(&mut domain, 8, Store::word(7));
        write_control(&mut domain, Store::word(0x8201), true);
        assert_eq!(access.read_control(&domain, true), 0x8103);
        write_control(&mut domain, Store::word(control::RESET), true);
        assert_eq!((domain.0[TIME], domain.0[DATE], read_memory(&domain, 8)), (0, NO_DATE, 7));
        write_control(&mut domain, Store::word(0), true);
        assert_eq!(access.read_control(&domain, true), 0);
    }

    #[test]
    fn the_memory_outlasts_the_supply_with_its_regulator_on() {
        let mut domain = Domain::new();
        assert_ne!(read_memory(&domain, 8), 0, "any content");
        write_memory(&mut domain, 8, Store::word(7));
        domain.outlast(1);
        assert_ne!(read_memory(&domain, 8), 7, "it is off");
        write_memory(&mut domain, 8, Store::word(7));
        regulate(&mut domain);
        domain.outlast(1);
        assert_eq!(read_memory(&domain, 8), 7);
    }

    #[test]
    fn a_domain_comes_back_from_its_file() {
        let domain = Domain::new();
        let mut bytes = [0; BYTES];
        for (bytes, word) in bytes.as_chunks_mut().0.iter_mut().zip(domain.words()) {
            *bytes = word.to_le_bytes();
        }
        assert_eq!(Domain::from_bytes(&bytes), domain);
    }
}
