//! How long ventilation was interrupted, by a calendar clock that runs on while the supply is away. Verifies: absence-limit.
//!
//! While the device ventilates, it notes the clock's time again and again, in memory that outlasts the supply. The next start
//! compares the newest note with the clock. A clock that is not running, that shows no date or that shows an earlier time than
//! the note gives no answer. Nor does a note that a power cut has torn, but there are two, which are written in turn.

use crate::checksum::CRC_32;
use crate::recorder::cell::Word;

/// Longest interruption after which ventilation resumes by itself, s. Fulfils: absence-limit.
pub const LONGEST_ABSENCE_S: u32 = 15 * 60;

/// Days of each month of a common year.
const MONTHS: [u32; 12] = [31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];

/// Time of a calendar clock of 24 hours, as the registers of an STM32F4 contain it (RM0090, sections 26.6.1 and 26.6.2): binary
/// coded decimals of hours, minutes and seconds, and of year, weekday, month and day. The weekday is ignored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockTime {
    /// Time register.
    pub time: u32,
    /// Date register.
    pub date: u32,
}

impl ClockTime {
    /// Time to which a clock that has lost its own is set. Not of the year 0, in which the clock counts as not set.
    pub const FIRST: Self = Self { time: 0, date: 0x0001_2101 };

    /// Seconds since the start of the year 2000; none if the registers contain no time of day or no date.
    pub fn seconds(self) -> Option<u32> {
        const TIME_BITS: u32 = 0x003F_7F7F;
        const DATE_BITS: u32 = 0x00FF_FF3F;
        if self.time & !TIME_BITS != 0 || self.date & !DATE_BITS != 0 {
            return None;
        }
        let hour = decimal(self.time >> 16, 24)?;
        let minute = decimal(self.time >> 8, 60)?;
        let second = decimal(self.time, 60)?;
        let year = decimal(self.date >> 16, 100)?;
        let month = decimal(self.date >> 8 & 0x1F, 13)?;
        let days = days(year, month, decimal(self.date, 32)?)?;
        Some(((days * 24 + hour) * 60 + minute) * 60 + second)
    }
}

/// The number below `end` that the lowest byte contains as two decimal digits.
fn decimal(byte: u32, end: u32) -> Option<u32> {
    let (tens, units) = (byte >> 4 & 15, byte & 15);
    let number = 10 * tens + units;
    (units < 10 && number < end).then_some(number)
}

/// Days from the start of the year 2000 to this date, with years from 0 to 99 and months and days from 1.
fn days(year: u32, month: u32, day: u32) -> Option<u32> {
    let before = month.checked_sub(1)? as usize;
    let leap = |month: u32| u32::from(month == 2 && year.is_multiple_of(4));
    let length = MONTHS.get(before)? + leap(month);
    if !(1..=length).contains(&day) {
        return None;
    }
    let months: u32 = (1..month).zip(MONTHS).map(|(number, days)| days + leap(number)).sum();
    Some(365 * year + year.div_ceil(4) + months + day - 1)
}

/// A time, with a checksum.
#[derive(Debug)]
#[repr(C)]
struct Note {
    time: Word,
    date: Word,
    checksum: Word,
}

impl Note {
    const fn new() -> Self {
        Self { time: Word::new(), date: Word::new(), checksum: Word::new() }
    }

    /// Seconds of the clock, if the note is complete and undamaged.
    fn read(&self) -> Option<u32> {
        let noted = ClockTime { time: self.time.load(), date: self.date.load() };
        (self.checksum.load() == checksum(noted)).then(|| noted.seconds())?
    }

    /// Writes it; valid only after the last store.
    fn write(&self, now: ClockTime) {
        self.clear();
        self.time.store(now.time);
        self.date.store(now.date);
        self.checksum.store(checksum(now));
    }

    /// Makes it invalid.
    fn clear(&self) {
        self.checksum.store(!checksum(ClockTime { time: self.time.load(), date: self.date.load() }));
    }
}

fn checksum(noted: ClockTime) -> u32 {
    let mut digest = CRC_32.digest();
    digest.update(&noted.time.to_le_bytes());
    digest.update(&noted.date.to_le_bytes());
    digest.finalize()
}

/// The last times at which the device ventilated, in memory with any content.
#[derive(Debug)]
#[repr(C)]
pub(super) struct Notes([Note; 2]);

impl Notes {
    pub(super) const fn new() -> Self {
        Self([const { Note::new() }; 2])
    }

    fn read(&self) -> [Option<u32>; 2] {
        self.0.each_ref().map(Note::read)
    }

    /// Notes that the device ventilates now, in place of the older or invalid note. A time that is not later is not noted.
    pub(super) fn write(&self, now: ClockTime) {
        let [first, second] = self.read();
        if now.seconds() > first.max(second) {
            self.0[usize::from(first > second)].write(now);
        }
    }

    pub(super) fn clear(&self) {
        self.0.iter().for_each(Note::clear);
    }

    /// Seconds since the newest note; none if there is no note, no time, or an earlier time than the note.
    pub(super) fn absence_s(&self, now: Option<ClockTime>) -> Option<u32> {
        let [first, second] = self.read();
        now?.seconds()?.checked_sub(first.max(second)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recorder::cell::fuse;
    use proptest::prelude::*;

    const DAY: u32 = 86_400;

    fn at(date: u32, time: u32) -> Option<u32> {
        ClockTime { time, date }.seconds()
    }

    /// A time on the day after the first.
    fn clock(time: u32) -> ClockTime {
        ClockTime { time, date: 0x0001_4102 }
    }

    #[test]
    fn the_registers_give_the_seconds_since_2000() {
        assert_eq!(at(0x00_0101, 0), Some(0));
        assert_eq!(at(0x00_0101, 0x23_5959), Some(DAY - 1));
        assert_eq!(at(0x00_0102, 0), Some(DAY));
        assert_eq!(at(0x00_0301, 0), Some((31 + 29) * DAY), "2000 is a leap year");
        assert_eq!(at(0x01_0301, 0), Some((366 + 31 + 28) * DAY), "2001 is none");
        assert_eq!(at(0x04_0229, 0), Some((4 * 365 + 1 + 31 + 28) * DAY));
        assert_eq!(at(0x04_0301, 0), Some((4 * 365 + 1 + 31 + 29) * DAY));
        // `date -u -d 2026-11-22T23:45:07 +%s`, less the seconds of 2000-01-01.
        assert_eq!(at(0x26_D122 | 0xE000, 0x23_4507), Some(1_795_391_107 - 946_684_800));
        assert_eq!(at(0x99_1231, 0x23_5959), Some(36_525 * DAY - 1));
        assert_eq!(ClockTime::FIRST.seconds(), Some(366 * DAY));
    }

    #[test]
    fn every_day_of_a_century_follows_the_day_before() {
        let bcd = |number: u32| 16 * (number / 10) + number % 10;
        let mut expected = 0;
        for (year, month, day) in
            (0..100).flat_map(|y| (0..=19).flat_map(move |m| (0..=39).map(move |d| (y, m, d))))
        {
            if let Some(seconds) = at(bcd(year) << 16 | bcd(month) << 8 | bcd(day), 0) {
                assert_eq!(seconds, expected, "{year}-{month}-{day}");
                expected += DAY;
            }
        }
        assert_eq!(expected, 36_525 * DAY);
    }

    #[test]
    fn what_is_no_date_or_no_time_of_day_is_none() {
        for date in [0x01_0001, 0x01_1301, 0x01_0100, 0x01_0132, 0x01_0229, 0x00_0230, 0x01_0431, 0x01_010A] {
            assert_eq!(at(date, 0), None, "{date:#08x}");
        }
        for date in [0x0A_0101, 0xA0_0101, 0x0100_0101, 0x00_0141] {
            assert_eq!(at(date, 0), None, "{date:#08x}");
        }
        for time in [0x24_0000, 0x00_6000, 0x00_0060, 0x00_000A, 0x40_0000, 0x00_8000, 0x00_0080] {
            assert_eq!(at(0x01_0101, time), None, "{time:#08x}");
        }
    }

    #[test]
    fn the_absence_is_the_time_since_the_newest_note() {
        let notes = Notes::new();
        assert_eq!(notes.absence_s(Some(clock(0x10_0000))), None, "no note");
        for time in [0x10_0000, 0x10_0001, 0x10_0002] {
            notes.write(clock(time));
            assert_eq!(notes.absence_s(Some(clock(time))), Some(0));
            assert_eq!(notes.absence_s(Some(clock(0x10_0100))), Some(60 - (time & 0xF)));
        }
        assert_eq!(notes.absence_s(None), None, "no clock");
        assert_eq!(notes.absence_s(Some(ClockTime { time: 0xFF, date: 0 })), None, "no time");
        notes.clear();
        assert_eq!(notes.absence_s(Some(clock(0x10_0100))), None, "cleared");
    }

    #[test]
    fn a_clock_that_has_gone_back_gives_no_answer() {
        let notes = Notes::new();
        notes.write(clock(0x10_0001));
        assert_eq!(notes.absence_s(Some(clock(0x10_0000))), None);
        notes.write(clock(0x10_0000));
        assert_eq!(notes.absence_s(Some(clock(0x10_0000))), None, "nor after another note");
    }

    #[test]
    fn a_time_is_noted_once_and_what_is_none_leaves_the_newest() {
        let notes = Notes::new();
        for time in [0x10_0000, 0x10_0001, 0x10_0001] {
            notes.write(clock(time));
        }
        assert_eq!(notes.read(), [0, 1].map(|second| Some(367 * DAY + 36_000 + second)));
        notes.write(ClockTime { time: 0x7F, date: 0 });
        assert_eq!(notes.absence_s(Some(clock(0x10_0002))), Some(1));
    }

    /// A power cut at each store of a note leaves the older or the new one.
    #[test]
    fn a_torn_note_leaves_the_one_before() {
        for stores in 0..=4 {
            let notes = Notes::new();
            notes.write(clock(0x10_0000));
            notes.write(clock(0x10_0001));
            fuse::set(stores);
            notes.write(clock(0x10_0010));
            fuse::set(usize::MAX);
            let expected = if stores < 4 { 29 } else { 20 };
            assert_eq!(notes.absence_s(Some(clock(0x10_0030))), Some(expected), "{stores} stores");
        }
    }

    proptest! {
        #[test]
        fn a_flipped_bit_leaves_the_other_note(bit in 0_u32..96) {
            let notes = Notes::new();
            notes.write(clock(0x10_0000));
            notes.write(clock(0x10_0010));
            let note = &notes.0[1];
            let word = [&note.time, &note.date, &note.checksum][bit as usize / 32];
            word.store(word.load() ^ 1 << (bit % 32));
            prop_assert_eq!(notes.absence_s(Some(clock(0x10_0030))), Some(30));
        }
    }
}
