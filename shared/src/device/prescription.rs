//! The prescription: the settings of a running ventilation, in memory that a reset leaves alone, so that ventilation resumes
//! after a reset that nobody requested.
//!
//! The memory holds two copies, which are written in turn: a reset in the middle of a write leaves the other one. A copy
//! counts only with its magic word, its checksum and settings that pass validation. The end of ventilation clears both, so
//! that after a stop, a latched fault or a requested restart nothing moves by itself.
//!
//! A program that fails again and again before it has completed a breath resumes [`RESUMES`] times; then it waits in standby,
//! where a host can reach it.

use super::ControlRequest;
use super::control::Control;
use crate::checksum::{CRC_32, fnv};
use crate::recorder::cell::Word;
use crate::reset::ResetCause;
use crate::settings::{FIELDS, Settings};
use crate::ventilator::{Mode, Output};

/// Times that ventilation resumes after failures of the program without a completed breath in between.
pub const RESUMES: u16 = 3;

/// Number of settings.
const COUNT: usize = FIELDS.len();
/// Marks a complete copy; another layout has another one.
const MAGIC: u32 = fnv(&[0x5072_6573, 1, COUNT as u32]);

/// What a reset has interrupted ventilation by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interruption {
    /// The supply fell.
    Supply,
    /// A control tick did not end, or the program failed.
    Program,
}

impl Interruption {
    /// The interruption for a start with this cause; none after power-up, a requested restart or the reset pin. `failed`: the
    /// program restarted itself after a failure; `supply_low`: that failure was the falling supply.
    pub fn of(cause: ResetCause, failed: bool, supply_low: bool) -> Option<Self> {
        match cause {
            ResetCause::BrownOut => Some(Self::Supply),
            ResetCause::Software if failed && supply_low => Some(Self::Supply),
            ResetCause::Software if failed => Some(Self::Program),
            ResetCause::Watchdog => Some(Self::Program),
            ResetCause::PowerOn | ResetCause::Pin | ResetCause::Software | ResetCause::Other => None,
        }
    }
}

/// A copy of the settings.
#[derive(Debug)]
#[repr(C)]
struct Copy {
    magic: Word,
    /// Higher in the copy that was written later, wrapping.
    sequence: Word,
    settings: [Word; COUNT],
    checksum: Word,
}

impl Copy {
    const fn new() -> Self {
        Self {
            magic: Word::new(),
            sequence: Word::new(),
            settings: [const { Word::new() }; COUNT],
            checksum: Word::new(),
        }
    }

    /// Sequence number and settings, if the copy is complete and undamaged and the settings are valid.
    fn read(&self) -> Option<(u32, Settings)> {
        let words = self.settings.each_ref().map(Word::load);
        let sequence = self.sequence.load();
        let whole = self.magic.load() == MAGIC && self.checksum.load() == checksum(sequence, &words);
        let settings = Settings::from_values(words.map(f32::from_bits));
        (whole && settings.validate().is_ok()).then_some((sequence, settings))
    }

    /// Writes it; valid only after the last store.
    fn write(&self, sequence: u32, settings: &Settings) {
        self.magic.store(0);
        let words = settings.values().map(f32::to_bits);
        self.sequence.store(sequence);
        self.settings.iter().zip(words).for_each(|(cell, word)| cell.store(word));
        self.checksum.store(checksum(sequence, &words));
        self.magic.store(MAGIC);
    }

    fn clear(&self) {
        self.magic.store(0);
    }
}

fn checksum(sequence: u32, words: &[u32; COUNT]) -> u32 {
    let mut digest = CRC_32.digest();
    digest.update(&sequence.to_le_bytes());
    for word in words {
        digest.update(&word.to_le_bytes());
    }
    digest.finalize()
}

/// The memory of the prescription. With any content, [`Prescription::attach`] makes it usable.
#[derive(Debug)]
#[repr(C)]
pub struct PrescriptionMemory {
    copies: [Copy; 2],
    /// Times resumed without a completed breath since, and the complement of that number.
    resumes: Word,
}

impl PrescriptionMemory {
    /// Memory filled with zeros.
    pub const fn new() -> Self {
        Self { copies: [const { Copy::new() }; 2], resumes: Word::new() }
    }

    /// The later of the valid copies: its place, sequence number and settings.
    fn newest(&self) -> Option<(usize, u32, Settings)> {
        let [first, second] = self.copies.each_ref().map(Copy::read);
        match (first, second) {
            (Some((before, _)), Some((after, settings))) if after.wrapping_sub(before) as i32 > 0 => {
                Some((1, after, settings))
            }
            (Some((sequence, settings)), _) => Some((0, sequence, settings)),
            (None, Some((sequence, settings))) => Some((1, sequence, settings)),
            (None, None) => None,
        }
    }

    /// Times resumed; a damaged number counts as none, since it does not tell that the program fails.
    fn resumes(&self) -> u16 {
        let word = self.resumes.load();
        if word as u16 == !(word >> 16) as u16 { word as u16 } else { 0 }
    }

    fn set_resumes(&self, times: u16) {
        self.resumes.store(u32::from(times) | u32::from(!times) << 16);
    }
}

impl Default for PrescriptionMemory {
    fn default() -> Self {
        Self::new()
    }
}

/// Writer of a [`PrescriptionMemory`], and what it held at the start; there must be only one.
#[derive(Debug)]
pub struct Prescription<'a> {
    memory: &'a PrescriptionMemory,
    /// Settings with which ventilation is to resume.
    due: Option<Settings>,
    /// Whether a failure of the program interrupted it.
    failed: bool,
    /// Settings in the newest copy.
    kept: Option<Settings>,
    /// Place and sequence number of the next copy.
    place: usize,
    sequence: u32,
}

impl<'a> Prescription<'a> {
    /// Attaches to memory with any content, as its first user since the device started.
    pub fn attach(memory: &'a PrescriptionMemory, interruption: Option<Interruption>) -> Self {
        let failed = interruption == Some(Interruption::Program);
        let found = memory.newest().filter(|_| interruption.is_some());
        let found = found.filter(|_| !failed || memory.resumes() < RESUMES);
        let (place, sequence) =
            found.map_or((0, 0), |(place, sequence, _)| (1 - place, sequence.wrapping_add(1)));
        let due = found.map(|(_, _, settings)| settings);
        let mut prescription = Self { memory, due, failed, kept: due, place, sequence };
        if due.is_none() {
            prescription.clear();
        }
        prescription
    }

    /// Whether ventilation is to resume.
    pub fn is_due(&self) -> bool {
        self.due.is_some()
    }

    /// Resumes ventilation if it is due; the caller waits with that until the supply is sound.
    #[cold]
    pub fn resume(&mut self, control: &mut Control) {
        let Some(settings) = self.due.take() else { return };
        if self.failed {
            self.memory.set_resumes(self.memory.resumes().saturating_add(1));
        }
        // Validated settings are refused by no control period of this device; if they are, it stays in standby.
        let _ = control.resume(&settings);
    }

    /// Takes note of a request before it is executed: who stops the device while it waits to resume ends that too.
    pub fn requested(&mut self, request: &ControlRequest) {
        if *request == ControlRequest::Stop && self.due.is_some() {
            self.clear();
        }
    }

    /// Keeps the settings of the breath that starts in a tick, and clears them in the first tick after ventilation. Call it in
    /// every tick before a request is executed, so that a stop is kept before any restart.
    #[inline]
    pub fn keep(&mut self, control: &Control, output: &Output) {
        match &output.sample {
            Some(sample) if sample.tick == 0 => self.breath_starts(control, sample.breath),
            None if self.kept.is_some() && (self.due.is_none() || output.mode != Mode::Standby) => {
                self.clear();
            }
            _ => {}
        }
    }

    fn breath_starts(&mut self, control: &Control, number: u32) {
        // Who starts it does not wait for it to resume.
        self.due = None;
        if number == 1 {
            self.memory.set_resumes(0);
        }
        let settings = control.prescription();
        if let Some(settings) = settings.filter(|_| settings != self.kept) {
            self.memory.copies[self.place % 2].write(self.sequence, &settings);
            (self.place, self.sequence) = (1 - self.place % 2, self.sequence.wrapping_add(1));
            self.kept = Some(settings);
        }
    }

    /// Clears both copies, the older one first: a reset in between leaves the newer one, not the older.
    #[cold]
    fn clear(&mut self) {
        (self.due, self.kept) = (None, None);
        self.memory.copies[self.place % 2].clear();
        self.memory.copies[1 - self.place % 2].clear();
        self.memory.set_resumes(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::{DEFAULT_PERIOD_US, paper_settings};
    use crate::link::messages::DeviceKind;
    use crate::recorder::cell::fuse;
    use crate::safety::ladder::Level;
    use crate::safety::monitors::Monitors;
    use proptest::prelude::*;

    const BREATH: usize = 3000;

    fn device() -> Control {
        Control::new(DeviceKind::Simulated, DEFAULT_PERIOD_US, None, 168_000_000)
            .unwrap()
            .with_monitors(Monitors::ANY_PLANT)
    }

    /// A run of a device from its start.
    struct Run<'a> {
        control: Control,
        prescription: Prescription<'a>,
    }

    impl<'a> Run<'a> {
        fn start(memory: &'a PrescriptionMemory, interruption: Option<Interruption>) -> Self {
            let (mut control, mut prescription) = (device(), Prescription::attach(memory, interruption));
            prescription.resume(&mut control);
            Self { control, prescription }
        }

        fn ticks(&mut self, count: usize) {
            for _ in 0..count {
                let output = self.control.step(5.0);
                self.prescription.keep(&self.control, &output);
            }
        }

        fn ask(&mut self, request: ControlRequest) {
            self.prescription.requested(&request);
            self.control.execute(&request);
        }

        /// Ventilates with these settings for a number of breaths.
        fn ventilate(&mut self, settings: &Settings, breaths: usize) {
            self.ask(ControlRequest::Apply(*settings));
            self.ask(ControlRequest::Start);
            self.ticks(breaths * BREATH);
        }
    }

    /// The settings with which the next start resumes.
    fn resumed(memory: &PrescriptionMemory, interruption: Option<Interruption>) -> Option<Settings> {
        let mut run = Run::start(memory, interruption);
        run.ticks(1);
        run.control.prescription()
    }

    const HANG: Option<Interruption> = Some(Interruption::Program);
    const DIP: Option<Interruption> = Some(Interruption::Supply);

    #[test]
    fn only_unrequested_resets_by_program_or_supply_interrupt() {
        let of = Interruption::of;
        assert_eq!(of(ResetCause::Watchdog, false, false), HANG);
        assert_eq!(of(ResetCause::Software, true, false), HANG);
        assert_eq!(of(ResetCause::Software, true, true), DIP);
        assert_eq!(of(ResetCause::BrownOut, false, false), DIP);
        for requested in [ResetCause::PowerOn, ResetCause::Pin, ResetCause::Software, ResetCause::Other] {
            assert_eq!(of(requested, false, false), None, "{requested:?}");
        }
    }

    #[test]
    fn an_interrupted_ventilation_resumes_with_its_settings_and_the_pid() {
        let memory = PrescriptionMemory::new();
        Run::start(&memory, None).ventilate(&paper_settings(25.0), 1);
        let mut run = Run::start(&memory, HANG);
        run.ticks(1);
        assert_eq!(run.control.prescription(), Some(paper_settings(25.0)));
        assert_eq!(run.control.state().level(), Level::Pid);
        drop(run);
        assert_eq!(resumed(&memory, DIP), Some(paper_settings(25.0)));
    }

    #[test]
    fn the_settings_in_force_are_kept_not_those_that_wait() {
        let memory = PrescriptionMemory::new();
        let mut run = Run::start(&memory, None);
        run.ventilate(&paper_settings(15.0), 1);
        run.ticks(10);
        run.ask(ControlRequest::Apply(paper_settings(30.0)));
        run.ticks(10);
        assert_eq!(resumed(&memory, HANG), Some(paper_settings(15.0)));
        run.ticks(BREATH);
        assert_eq!(resumed(&memory, HANG), Some(paper_settings(30.0)));
    }

    #[test]
    fn after_a_stop_a_fault_or_a_requested_restart_nothing_resumes() {
        let memory = PrescriptionMemory::new();
        let mut run = Run::start(&memory, None);
        run.ventilate(&paper_settings(15.0), 1);
        run.ask(ControlRequest::Stop);
        run.ticks(1);
        assert_eq!(resumed(&memory, HANG), None);
        let mut run = Run::start(&memory, None);
        run.ventilate(&paper_settings(15.0), 1);
        for _ in 0..1000 {
            let output = run.control.step(70.0);
            run.prescription.keep(&run.control, &output);
        }
        assert!(matches!(run.control.mode(), Mode::Fault(_)));
        assert_eq!(resumed(&memory, HANG), None);
        Run::start(&memory, None).ventilate(&paper_settings(15.0), 1);
        assert_eq!(resumed(&memory, None), None, "a requested restart");
        assert_eq!(resumed(&memory, HANG), None, "which has cleared it");
    }

    /// Whichever copy was written last, and wherever a reset interrupts the clearing.
    #[test]
    fn a_stop_leaves_none_of_the_copies_and_a_reset_meanwhile_never_the_older_one() {
        for (written, stores) in (1..=4).flat_map(|written| (0..=2).map(move |stores| (written, stores))) {
            let memory = PrescriptionMemory::new();
            let mut run = Run::start(&memory, None);
            (0..written).for_each(|n| run.ventilate(&paper_settings(10.0 + n as f32), 1));
            let last = memory.newest().map(|(_, _, settings)| settings);
            fuse::set(stores);
            run.ask(ControlRequest::Stop);
            run.ticks(1);
            fuse::set(usize::MAX);
            let found = memory.newest().map(|(_, _, settings)| settings);
            assert_eq!(found, last.filter(|_| stores < 2), "{written} written, {stores} cleared");
        }
    }

    #[test]
    fn the_sequence_number_wraps() {
        let memory = PrescriptionMemory::new();
        memory.copies[1].write(u32::MAX, &paper_settings(15.0));
        let mut run = Run::start(&memory, DIP);
        run.ticks(1);
        run.ventilate(&paper_settings(30.0), 1);
        assert_eq!(memory.newest().map(|(place, sequence, _)| (place, sequence)), Some((0, 0)));
        assert_eq!(resumed(&memory, DIP), Some(paper_settings(30.0)));
    }

    #[test]
    fn a_program_that_fails_before_each_breath_ends_in_standby() {
        let memory = PrescriptionMemory::new();
        Run::start(&memory, None).ventilate(&paper_settings(25.0), 1);
        for time in 0..RESUMES {
            assert!(resumed(&memory, HANG).is_some(), "time {time}");
        }
        assert_eq!(resumed(&memory, HANG), None);
        Run::start(&memory, None).ventilate(&paper_settings(25.0), 1);
        for _ in 0..3 * RESUMES {
            assert!(resumed(&memory, DIP).is_some(), "a supply that flickers is no failure of the program");
        }
        for _ in 0..3 * RESUMES {
            let mut run = Run::start(&memory, HANG);
            run.ticks(BREATH + 1);
            assert!(run.control.prescription().is_some(), "breaths are completed");
        }
    }

    #[test]
    fn who_stops_or_starts_a_waiting_device_decides() {
        let memory = PrescriptionMemory::new();
        Run::start(&memory, None).ventilate(&paper_settings(25.0), 1);
        let waiting = || Run { control: device(), prescription: Prescription::attach(&memory, DIP) };
        let mut run = waiting();
        run.ticks(100);
        assert!(run.prescription.is_due(), "it waits");
        assert!(waiting().prescription.is_due(), "a reset meanwhile changes nothing");
        run.ask(ControlRequest::Status);
        assert!(run.prescription.is_due() && memory.newest().is_some(), "nor does a question");
        run.ventilate(&paper_settings(10.0), 1);
        assert!(!run.prescription.is_due());
        assert_eq!(resumed(&memory, DIP), Some(paper_settings(10.0)));
        let mut run = waiting();
        run.ask(ControlRequest::Stop);
        run.ticks(1);
        assert!(!run.prescription.is_due() && resumed(&memory, DIP).is_none());
    }

    /// Settings that pass validation.
    fn settings() -> impl Strategy<Value = Settings> {
        let drawn = (7.0f32..40.0, 0.0f32..5.0, 4.0f32..30.0, 0.2f32..1.0, 45.0f32..70.0);
        drawn.prop_map(|(pip, peep, rate, inspiratory_time, pressure_limit)| Settings {
            pip,
            peep,
            rate,
            inspiratory_time,
            pressure_limit,
            ..Settings::default()
        })
    }

    proptest! {
        #[test]
        fn settings_survive_their_encoding(settings in settings()) {
            let copy = Copy::new();
            copy.write(7, &settings);
            prop_assert_eq!(copy.read(), Some((7, settings)));
        }

        #[test]
        fn any_flipped_bit_of_a_copy_is_found(settings in settings(), bit in 0usize..32 * (COUNT + 3)) {
            let copy = Copy::new();
            copy.write(7, &settings);
            let cells: std::vec::Vec<&Word> =
                [&copy.magic, &copy.sequence].into_iter().chain(&copy.settings).chain([&copy.checksum]).collect();
            let cell = cells[bit / 32];
            cell.store(cell.load() ^ 1 << (bit % 32));
            prop_assert_eq!(copy.read(), None);
        }

        #[test]
        fn memory_with_any_content_resumes_nothing_invalid(words in prop::array::uniform(any::<u32>()), sequence: u32) {
            let memory = PrescriptionMemory::new();
            memory.copies[0].settings.iter().zip(words).for_each(|(cell, word)| cell.store(word));
            memory.copies[0].sequence.store(sequence);
            memory.copies[0].checksum.store(checksum(sequence, &words));
            memory.copies[0].magic.store(MAGIC);
            let found = resumed(&memory, HANG);
            prop_assert_eq!(found.is_some(), Settings::from_values(words.map(f32::from_bits)).validate().is_ok());
        }

        /// A reset at any store leaves the settings before or after it, and never others or none.
        #[test]
        fn a_reset_at_any_store_leaves_old_or_new_settings(
            list in prop::collection::vec(settings(), 2..6), stores in 0usize..14,
        ) {
            let memory = PrescriptionMemory::new();
            let mut prescription = Prescription::attach(&memory, None);
            let mut control = device();
            let mut start = |settings: &Settings, prescription: &mut Prescription| {
                control = device();
                control.execute(&ControlRequest::Apply(*settings));
                control.execute(&ControlRequest::Start);
                let output = control.step(5.0);
                prescription.keep(&control, &output);
            };
            let (last, before) = list.split_last().unwrap();
            for settings in before {
                start(settings, &mut prescription);
            }
            fuse::set(stores);
            start(last, &mut prescription);
            fuse::set(usize::MAX);
            let found = memory.newest().map(|(_, _, settings)| settings);
            prop_assert!(found == Some(*last) || found == before.last().copied(), "{:?}", found);
        }
    }
}
