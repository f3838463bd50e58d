//! Routes accesses to the modelled parts by address.

use crate::backup::{self, Access, Domain};
use crate::decode::Direction;
use crate::flash::{self, Flash, Operation};
use crate::iwdg::Iwdg;
use crate::plant_port::{Line, PlantPort};
use crate::pwr::Pwr;
use crate::rcc::{self, Rcc};
use crate::record::{self, Record};
use crate::store::{Store, Width};

const RTC: u32 = 0x4000_2800;
const IWDG: u32 = 0x4000_3000;
const USART2: u32 = 0x4000_4400;
const PWR: u32 = 0x4000_7000;
const GPIOA: u32 = 0x4002_0000;
const GPIOB: u32 = 0x4002_0400;
const RCC: u32 = 0x4002_3800;
const FLASH: u32 = 0x4002_3C00;
const BACKUP: u32 = 0x4002_4000;
const BACKUP_LAST: u32 = BACKUP + backup::MEMORY_BYTES - 1;
/// Address range of each part, bytes; its registers are at the start.
const PART_BYTES: u32 = 0x400;
const SLOTS_LAST: u32 = flash::SLOTS + flash::SLOTS_BYTES - 1;

/// A range of addresses where accesses fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// First address, a multiple of the length.
    pub address: u32,
    /// Length in bytes, a power of two.
    pub bytes: u32,
    /// Number of eighths at its start where they do not.
    pub open_eighths: u32,
    /// Whether loads are allowed without a fault.
    pub readable: bool,
}

impl Region {
    /// First address where accesses fault.
    pub const fn first(&self) -> u32 {
        self.address + self.open_eighths * (self.bytes / 8)
    }

    /// Last address where accesses fault.
    pub const fn last(&self) -> u32 {
        self.address + (self.bytes - 1)
    }
}

/// All regions; the memory protection unit supports eight.
pub const REGIONS: [Region; 8] = [
    Region { address: RCC, bytes: 2 * PART_BYTES, open_eighths: 0, readable: false },
    Region { address: GPIOA, bytes: 2 * PART_BYTES, open_eighths: 0, readable: false },
    Region { address: PWR, bytes: PART_BYTES, open_eighths: 0, readable: false },
    Region { address: IWDG, bytes: PART_BYTES, open_eighths: 0, readable: false },
    Region { address: USART2, bytes: PART_BYTES, open_eighths: 0, readable: false },
    Region { address: RTC, bytes: PART_BYTES, open_eighths: 0, readable: false },
    Region { address: BACKUP, bytes: backup::MEMORY_BYTES, open_eighths: 0, readable: false },
    Region { address: flash::START, bytes: flash::BYTES, open_eighths: 3, readable: true },
];

/// Whether an access to an address faults.
#[inline]
pub fn is_refused(address: u32, direction: Direction) -> bool {
    match address - address % PART_BYTES {
        USART2 | RTC | IWDG | PWR | GPIOA | GPIOB | RCC | FLASH | BACKUP..=BACKUP_LAST => true,
        flash::SLOTS..=SLOTS_LAST => direction == Direction::Store,
        _ => false,
    }
}

/// Environment of the models.
pub trait Outside: Line {
    /// Current time in nanoseconds, wrapping.
    fn now(&mut self) -> u32;
    /// Changes the content of the slots.
    fn change(&mut self, operation: Operation);
    /// Cuts the power.
    fn cut_power(&mut self);
    /// The part of the chip that the cell supplies.
    fn domain(&mut self) -> &mut Domain;
    /// Keeps the word at this place of it.
    fn keep(&mut self, place: usize);
}

/// Interrupts that the core gets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interrupts {
    /// The non-maskable one, of the clock security system.
    pub non_maskable: bool,
    /// The line of the supply voltage detector, if it is enabled.
    pub supply: bool,
}

/// The modelled parts, except their state in the record.
#[derive(Clone, Debug)]
pub struct Chip {
    rcc: Rcc,
    pwr: Pwr,
    flash: Flash,
    /// The watchdog, which the system tick checks.
    pub iwdg: Iwdg,
    plant_port: PlantPort,
    backup: Access,
    /// Whether the supply voltage was low at the last look.
    supply_low: bool,
}

impl Chip {
    /// The parts after a reset, with the record's reset flags, option bytes and conditions.
    pub fn of(record: &Record) -> Self {
        let supply_low = record.conditions & record::SUPPLY_LOW != 0;
        Self { flash: Flash::new(record.options), supply_low, ..Self::new(record.reset_flags) }
    }

    /// The parts of a new chip after a reset, with these reset flags.
    pub const fn new(reset_flags: u32) -> Self {
        Self {
            rcc: Rcc::new(reset_flags),
            pwr: Pwr::new(),
            flash: Flash::new(flash::NEW_OPTIONS),
            iwdg: Iwdg::new(),
            plant_port: PlantPort::new(),
            backup: Access::new(),
            supply_low: false,
        }
    }

    /// Applies the conditions of the record.
    pub fn suffer(&mut self, record: &Record) -> Interrupts {
        let was_low = core::mem::replace(&mut self.supply_low, record.conditions & record::SUPPLY_LOW != 0);
        Interrupts {
            non_maskable: record.conditions & record::NO_CRYSTAL != 0 && self.rcc.stop_crystal(),
            supply: self.supply_low && !was_low && self.pwr.detects(),
        }
    }

    /// Lets the host of a program without a plant set the pace.
    pub fn pace(&mut self, outside: &mut impl Outside) {
        self.plant_port.tick(outside);
    }

    /// Lets the calendar clock run up to now.
    pub fn run_clock(&mut self, record: &Record, outside: &mut impl Outside) {
        let now = outside.now();
        if self.backup.run(outside.domain(), now, has_clock_crystal(record)) {
            for place in [backup::TIME, backup::TIME + 1] {
                outside.keep(place);
            }
        }
    }

    /// Returns the result of a load, zero-extended.
    #[inline]
    pub fn load(&mut self, address: u32, width: Width, record: &Record, outside: &mut impl Outside) -> u32 {
        let offset = (address % PART_BYTES) & !3;
        let word = match address - address % PART_BYTES {
            USART2 => self.plant_port.read(offset, outside),
            RCC if offset != rcc::BACKUP_CONTROL => self.rcc.read(offset),
            part => self.load_elsewhere(part, address & !3, record, outside.domain()),
        };
        word >> (8 * (address & 3)) & width.mask()
    }

    /// A load from a part that is rarely used. Not inlined, so that the other traps stay short.
    #[inline(never)]
    fn load_elsewhere(&mut self, part: u32, address: u32, record: &Record, domain: &Domain) -> u32 {
        let offset = address % PART_BYTES;
        match part {
            RCC => self.backup.read_control(domain, has_clock_crystal(record)),
            RTC => self.backup.read_clock(domain, offset),
            BACKUP..=BACKUP_LAST if self.rcc.drives_backup_memory() => {
                backup::read_memory(domain, address - BACKUP)
            }
            IWDG => self.iwdg.read(offset),
            PWR => self.pwr.read(offset, record.conditions & record::SUPPLY_LOW != 0),
            GPIOA => record.ports[0].read(offset),
            GPIOB => record.ports[1].read(offset),
            FLASH => self.flash.read(offset),
            _ => 0,
        }
    }

    /// Executes a store.
    #[inline]
    pub fn store(
        &mut self,
        address: u32,
        width: Width,
        value: u32,
        record: &mut Record,
        outside: &mut impl Outside,
    ) {
        let (offset, store) = ((address % PART_BYTES) & !3, Store::new(address, width, value));
        match address - address % PART_BYTES {
            USART2 => self.plant_port.write(offset, store, outside),
            flash::SLOTS..=SLOTS_LAST => change(self.flash.program(address, width, value), record, outside),
            part => self.store_elsewhere(part, address & !3, store, record, outside),
        }
    }

    /// A store to a part that is rarely used. Not inlined, so that the other traps stay short.
    #[inline(never)]
    fn store_elsewhere(
        &mut self,
        part: u32,
        address: u32,
        store: Store,
        record: &mut Record,
        outside: &mut impl Outside,
    ) {
        let offset = address % PART_BYTES;
        match part {
            IWDG => {
                if let Some(gap_ns) = self.iwdg.write(offset, store, outside.now()) {
                    record.fed(gap_ns);
                }
            }
            PWR => {
                self.pwr.write(offset, store);
                if self.pwr.regulates_backup() {
                    let place = backup::regulate(outside.domain());
                    outside.keep(place);
                }
            }
            RTC | BACKUP..=BACKUP_LAST | RCC if part != RCC || offset == rcc::BACKUP_CONTROL => {
                self.store_to_backup(address, store, record, outside);
            }
            GPIOA => record.ports[0].write(offset, store),
            GPIOB => record.ports[1].write(offset, store),
            RCC => {
                self.rcc.write(offset, store, record.conditions & record::NO_CRYSTAL == 0);
                record.reset_flags = self.rcc.flags();
            }
            FLASH => {
                change(self.flash.write(offset, store), record, outside);
                record.flash_access = self.flash.read(0);
                record.options = self.flash.programmed();
            }
            _ => {}
        }
    }

    /// A store to the backup domain; without effect before the program has opened it.
    fn store_to_backup(&mut self, address: u32, store: Store, record: &Record, outside: &mut impl Outside) {
        if !self.pwr.opens_backup() {
            return;
        }
        let (offset, domain) = (address % PART_BYTES, outside.domain());
        let changed = match address {
            BACKUP..=BACKUP_LAST if self.rcc.drives_backup_memory() => {
                backup::write_memory(domain, address - BACKUP, store)
            }
            BACKUP..=BACKUP_LAST => None,
            RCC.. => {
                let changed = backup::write_control(domain, store, has_clock_crystal(record));
                for place in changed {
                    outside.keep(place);
                }
                None
            }
            _ => self.backup.write_clock(domain, offset, store),
        };
        if let Some(place) = changed {
            outside.keep(place);
        }
    }
}

/// Whether the crystal of the calendar clock is sound.
fn has_clock_crystal(record: &Record) -> bool {
    record.conditions & record::NO_CLOCK_CRYSTAL == 0
}

fn change(operation: Option<Operation>, record: &mut Record, outside: &mut impl Outside) {
    if let Some(operation) = operation {
        record.flash_operations += 1;
        outside.change(operation);
        if record.flash_operations == record.power_cut {
            outside.cut_power();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rcc::ResetCause;
    use std::vec::Vec;

    #[derive(Default)]
    struct Recorder {
        operations: Vec<Operation>,
        power_cuts: usize,
        domain: Domain,
        kept: Vec<usize>,
    }

    impl Line for Recorder {
        fn send(&mut self, _: &[u8]) {}

        fn receive(&mut self, bytes: &mut [u8]) -> usize {
            bytes[0] = 0x5A;
            1
        }
    }

    impl Outside for Recorder {
        fn now(&mut self) -> u32 {
            123
        }

        fn change(&mut self, operation: Operation) {
            self.operations.push(operation);
        }

        fn cut_power(&mut self) {
            self.power_cuts += 1;
        }

        fn domain(&mut self) -> &mut Domain {
            &mut self.domain
        }

        fn keep(&mut self, place: usize) {
            self.kept.push(place);
        }
    }

    #[test]
    fn regions_are_aligned_apart_and_as_many_as_fit() {
        assert!(REGIONS.len() <= 8);
        for (n, region) in REGIONS.iter().enumerate() {
            assert!(
                region.bytes.is_power_of_two() && region.address.is_multiple_of(region.bytes),
                "{region:x?}"
            );
            for other in &REGIONS[..n] {
                assert!(
                    region.last() < other.first() || other.last() < region.first(),
                    "{region:x?} {other:x?}"
                );
            }
        }
    }

    #[test]
    fn what_is_refused_is_what_the_regions_cover() {
        for region in REGIONS {
            for address in [region.first(), region.last()] {
                assert!(is_refused(address, Direction::Store), "{address:#x}");
                assert_eq!(is_refused(address, Direction::Load), !region.readable, "{address:#x}");
            }
            for address in [region.first() - 1, region.last() + 1] {
                let elsewhere =
                    REGIONS.iter().all(|other| !(other.first()..=other.last()).contains(&address));
                assert_ne!(is_refused(address, Direction::Store), elsewhere, "{address:#x}");
            }
        }
    }

    #[test]
    fn each_part_answers_at_its_address() {
        let (mut chip, mut record, mut outside) = (Chip::new(0), Record::at_power_on(), Recorder::default());
        for (address, value) in [
            (RCC, 0x83),
            (FLASH + 0x10, 1 << 31),
            (PWR + 4, 1 << 14),
            (IWDG + 8, 0xFFF),
            (USART2, 0xC0),
            (GPIOA, 0xA800_0000),
            (GPIOB, 0x280),
        ] {
            assert_eq!(chip.load(address, Width::Word, &record, &mut outside), value, "{address:#x}");
        }
        chip.store(GPIOB + 0x18, Width::Word, 1, &mut record, &mut outside);
        assert_eq!(chip.load(GPIOB + 0x14, Width::Word, &record, &mut outside), 1);
    }

    #[test]
    fn narrow_loads_take_their_bytes() {
        let (mut chip, record, mut outside) =
            (Chip::new(0x1234_5678 & !0x01FF_FFFF), Record::at_power_on(), Recorder::default());
        assert_eq!(chip.load(RCC + 0x77, Width::Byte, &record, &mut outside), 0x12);
        assert_eq!(chip.load(RCC + 0x76, Width::Half, &record, &mut outside), 0x1200);
    }

    #[test]
    fn removed_reset_flags_are_removed_for_the_next_start_too() {
        let flags = ResetCause::PowerOn.flags();
        let (mut chip, mut outside) = (Chip::new(flags), Recorder::default());
        let mut record = Record::at_power_on();
        record.reset_flags = flags;
        chip.store(RCC + 0x74, Width::Word, 1 << 24, &mut record, &mut outside);
        assert_eq!(record.reset_flags, 0);
    }

    /// The enable bits of the backup domain and of its memory's clock, and the word that is read after a store.
    #[test]
    fn the_backup_memory_is_written_once_it_is_open_and_has_a_clock() {
        for (open, clock, expected) in [(0, 0, 0), (1 << 8, 0, 0), (0, 1 << 18, 0), (1 << 8, 1 << 18, 9)] {
            let (mut chip, mut record, mut outside) =
                (Chip::new(0), Record::at_power_on(), Recorder::default());
            backup::write_memory(&mut outside.domain, 0xFFC, Store::word(0));
            for (address, value) in [(PWR, open), (RCC + 0x30, clock), (BACKUP_LAST - 3, 9)] {
                chip.store(address, Width::Word, value, &mut record, &mut outside);
            }
            assert_eq!(chip.load(BACKUP_LAST - 3, Width::Word, &record, &mut outside), expected);
            assert_eq!(outside.kept.contains(&0x3FF), expected != 0);
        }
    }

    #[test]
    fn the_clock_of_an_open_domain_starts_is_set_and_runs() {
        let (mut chip, mut record, mut outside) = (Chip::new(0), Record::at_power_on(), Recorder::default());
        chip.store(RCC + 0x70, Width::Word, 0x8101, &mut record, &mut outside);
        assert_eq!(chip.load(RCC + 0x70, Width::Word, &record, &mut outside), 0, "closed");
        let stores = [(PWR, 1 << 8), (RCC + 0x70, 0x8101), (RTC + 0x24, 0xCA), (RTC + 0x24, 0x53)];
        for (address, value) in
            stores.into_iter().chain([(RTC + 0xC, 0x80), (RTC + 4, 0x01_2101), (RTC + 0xC, 0)])
        {
            chip.store(address, Width::Word, value, &mut record, &mut outside);
        }
        assert_eq!(chip.load(RCC + 0x70, Width::Word, &record, &mut outside), 0x8103);
        assert_eq!(chip.load(RTC + 4, Width::Word, &record, &mut outside), 0x01_2101);
        assert_eq!(chip.load(RTC + 0xC, Width::Word, &record, &mut outside), 0x30);
        assert!(outside.kept.contains(&(backup::TIME + 1)));
    }

    /// Opens the flash controller for programming by words.
    fn unlock(chip: &mut Chip, record: &mut Record, outside: &mut Recorder) {
        for (offset, value) in [(0x04, 0x4567_0123), (0x04, 0xCDEF_89AB), (0x10, 1 | 2 << 8)] {
            chip.store(FLASH + offset, Width::Word, value, record, outside);
        }
    }

    #[test]
    fn the_slots_are_programmed_by_stores_to_them() {
        let (mut chip, mut record, mut outside) = (Chip::new(0), Record::at_power_on(), Recorder::default());
        unlock(&mut chip, &mut record, &mut outside);
        chip.store(0x080F_FFFC, Width::Word, 7, &mut record, &mut outside);
        assert_eq!(
            outside.operations,
            [Operation::Program { address: 0x080F_FFFC, width: Width::Word, value: 7 }]
        );
        assert_eq!(record.flash_operations, 1);
    }

    #[test]
    fn the_power_is_cut_after_the_chosen_operation_and_no_other() {
        let (mut chip, mut record, mut outside) = (Chip::new(0), Record::at_power_on(), Recorder::default());
        unlock(&mut chip, &mut record, &mut outside);
        record.power_cut = 2;
        for (operations, cuts) in [(1, 0), (2, 1), (3, 1)] {
            chip.store(flash::SLOTS, Width::Word, 0, &mut record, &mut outside);
            assert_eq!((outside.operations.len(), outside.power_cuts), (operations, cuts));
        }
    }
}
