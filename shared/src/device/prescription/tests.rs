//! Tests of the prescription: every interruption, at every store. Verifies: kept-settings.

use super::super::Status;
use super::super::self_test::Check;
use super::*;
use crate::breath::{DEFAULT_PERIOD_US, paper_settings};
use crate::link::messages::DeviceKind;
use crate::recorder::cell::fuse;
use crate::safety::ladder::Level;
use crate::safety::monitors::Monitors;
use crate::sensor::Readings;
use proptest::prelude::*;

const BREATH: usize = 3000;

fn device() -> Control {
    Control::new(DeviceKind::Simulated, DEFAULT_PERIOD_US, 168_000_000)
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
        Self::start_at(memory, interruption, None)
    }

    fn start_at(
        memory: &'a PrescriptionMemory,
        interruption: Option<Interruption>,
        now: Option<ClockTime>,
    ) -> Self {
        let (mut control, mut prescription) = (device(), Prescription::attach(memory, interruption, now));
        assert_eq!(prescription.resume(&mut control, true), None);
        Self { control, prescription }
    }

    fn ticks(&mut self, count: usize) {
        self.ticks_on(count, 5.0);
    }

    /// Ticks in which the airway sensor, the only one, reads this.
    fn ticks_on(&mut self, count: usize, reading: f32) {
        for _ in 0..count {
            let output = self.control.step(reading);
            self.prescription.keep(&self.control, &output);
        }
    }

    fn ask(&mut self, request: ControlRequest) {
        self.prescription.execute(&mut self.control, &request, HostRole::Steers);
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
const CUT: Option<Interruption> = Some(Interruption::PowerCut);

#[test]
fn only_unrequested_resets_by_program_or_supply_interrupt() {
    let of = Interruption::of;
    assert_eq!(of(ResetCause::Watchdog, false, false), HANG);
    assert_eq!(of(ResetCause::Software, true, false), HANG);
    assert_eq!(of(ResetCause::Software, true, true), DIP);
    assert_eq!(of(ResetCause::BrownOut, false, false), DIP);
    assert_eq!(of(ResetCause::PowerOn, false, false), CUT);
    for requested in [ResetCause::Pin, ResetCause::Software, ResetCause::Other] {
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
fn settings_are_kept_from_the_second_tick_of_a_breath_on() {
    let memory = PrescriptionMemory::new();
    let mut run = Run::start(&memory, None);
    run.ask(ControlRequest::Apply(paper_settings(25.0)));
    run.ask(ControlRequest::Start);
    for kept in [None, Some(paper_settings(25.0))] {
        run.ticks(1);
        assert_eq!(memory.newest().map(|(_, _, settings)| settings), kept);
    }
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
        // No gas comes out.
        let output = run.control.step(Readings { flow: 0.0, ..70.0.into() });
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
    run.ticks(2);
    run.ventilate(&paper_settings(30.0), 1);
    assert_eq!(memory.newest().map(|(place, sequence, _)| (place, sequence)), Some((0, 0)));
    assert_eq!(resumed(&memory, DIP), Some(paper_settings(30.0)));
}

/// Verifies: resume-count.
#[test]
fn a_program_that_fails_before_the_end_of_each_breath_ends_in_standby() {
    let memory = PrescriptionMemory::new();
    for completed in [1, BREATH / 2, BREATH - 1] {
        Run::start(&memory, None).ventilate(&paper_settings(25.0), 1);
        for time in 0..RESUMES {
            let mut run = Run::start(&memory, HANG);
            run.ticks(completed);
            assert!(run.control.prescription().is_some(), "time {time}, after {completed} ticks");
        }
        assert_eq!(resumed(&memory, HANG), None);
    }
    Run::start(&memory, None).ventilate(&paper_settings(25.0), 1);
    for _ in 0..3 * RESUMES {
        assert!(resumed(&memory, DIP).is_some(), "a supply that flickers is no failure of the program");
    }
    for _ in 0..3 * RESUMES {
        let mut run = Run::start(&memory, HANG);
        run.ticks(BREATH + 2);
        assert!(run.control.prescription().is_some(), "breaths are completed");
    }
}

/// A sensor that is silent at the start of a resumption delays the first breath, or backup ventilation begins it. Verifies: resume-count.
#[test]
fn a_resumption_without_a_reading_keeps_the_settings_and_counts() {
    for (silent, read) in
        [(1, 0), (1, 1), (2, BREATH / 2), (4, BREATH - 5), (5, 0), (100, 0), (BREATH - 10, 0)]
    {
        let memory = noted();
        for time in 0..RESUMES {
            let mut run = Run::start(&memory, HANG);
            run.ticks_on(silent, f32::NAN);
            run.ticks(read);
            let kept = run.control.prescription();
            assert_eq!(kept, Some(paper_settings(25.0)), "time {time}, {silent} ticks without a reading");
            assert_eq!(memory.notes.absence_s(Some(NOTED)), Some(0), "and so is the note");
        }
        assert_eq!(found(&memory, HANG, Some(NOTED)), (false, Some(ChipEvent::ResumedTooOften)), "{silent}");
    }
}

#[test]
fn a_stop_before_the_first_reading_of_a_resumption_ends_it() {
    let memory = noted();
    let mut run = Run::start(&memory, HANG);
    run.ticks_on(2, f32::NAN);
    run.ask(ControlRequest::Stop);
    run.ticks_on(1, f32::NAN);
    assert_eq!(found(&memory, HANG, Some(NOTED)), (false, None));
}

#[test]
fn who_starts_a_waiting_device_before_its_first_reading_decides() {
    let memory = noted();
    let mut run = Run { control: device(), prescription: Prescription::attach(&memory, DIP, None) };
    run.ask(ControlRequest::Apply(paper_settings(10.0)));
    run.ask(ControlRequest::Start);
    run.ticks_on(1, f32::NAN);
    assert!(!run.prescription.is_due(), "nothing resumes into the new ventilation");
    assert_eq!(run.prescription.resume(&mut run.control, true), None);
    run.ticks(2);
    assert_eq!(run.control.prescription(), Some(paper_settings(10.0)));
    assert_eq!(resumed(&memory, DIP), Some(paper_settings(10.0)));
}

/// The answer to a request, which the server gets from a device that may wait to resume.
fn status(run: &mut Run) -> Status {
    match run.prescription.execute(&mut run.control, &ControlRequest::Status, HostRole::Steers) {
        ControlReply::Status(status) => status,
        reply @ ControlReply::Response(_) => panic!("{reply:?}"),
    }
}

#[test]
fn the_flash_is_left_alone_while_ventilation_waits_to_resume() {
    let memory = noted();
    let mut run = Run { control: device(), prescription: Prescription::attach(&memory, DIP, None) };
    run.ticks(100);
    assert_eq!(run.prescription.leave(&run.control), Leave::Nothing);
    assert_eq!((status(&mut run).mode, status(&mut run).leave()), (Mode::Standby, Leave::Nothing));
    let check = ControlRequest::SelfTest(Some(Check::Circuit));
    let refused = ControlReply::Response(Response::Refused(Refusal::Ventilating));
    assert_eq!(run.prescription.execute(&mut run.control, &check, HostRole::Steers), refused);
    assert!(!status(&mut run).moves_valves);
    let results = ControlRequest::SelfTest(None);
    assert_ne!(run.prescription.execute(&mut run.control, &results, HostRole::Steers), refused);
    run.ask(ControlRequest::Stop);
    run.ticks(1);
    assert_eq!(
        (run.prescription.leave(&run.control), status(&mut run).leave()),
        (Leave::Erase, Leave::Erase)
    );
    assert_ne!(
        run.prescription.execute(&mut run.control, &check, HostRole::Steers),
        refused,
        "the wait is over"
    );
}

#[test]
fn who_stops_or_starts_a_waiting_device_decides() {
    let memory = PrescriptionMemory::new();
    Run::start(&memory, None).ventilate(&paper_settings(25.0), 1);
    let waiting = || Run { control: device(), prescription: Prescription::attach(&memory, DIP, None) };
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

/// Times of the clock: that of a note, and some after it.
const NOTED: ClockTime = ClockTime { time: 0x10_0000, date: 0x26_5122 };
const AFTER_15_MIN: ClockTime = ClockTime { time: 0x10_1500, ..NOTED };
const AFTER_15_MIN_1_S: ClockTime = ClockTime { time: 0x10_1501, ..NOTED };

/// Memory of a device that has ventilated with a PIP of 25 cmH2O and noted the time.
fn noted() -> PrescriptionMemory {
    let memory = PrescriptionMemory::new();
    Run::start(&memory, None).ventilate(&paper_settings(25.0), 1);
    memory.ventilates_at(NOTED);
    memory
}

/// What a start at this time finds: whether ventilation is to resume, and why not.
fn found(
    memory: &PrescriptionMemory,
    interruption: Option<Interruption>,
    now: Option<ClockTime>,
) -> (bool, Option<ChipEvent>) {
    let prescription = Prescription::attach(memory, interruption, now);
    assert_eq!(prescription.is_interrupted(), prescription.is_due() || prescription.refused().is_some());
    (prescription.is_due(), prescription.refused())
}

#[test]
fn ventilation_resumes_up_to_15_min_after_a_power_cut_and_not_later() {
    let memory = noted();
    let mut run = Run::start_at(&memory, CUT, Some(AFTER_15_MIN));
    run.ticks(1);
    assert_eq!(run.control.prescription(), Some(paper_settings(25.0)));
    assert_eq!(run.control.state().level(), Level::Pid);
    assert_eq!(run.prescription.refused(), None);
    let memory = noted();
    assert_eq!(found(&memory, CUT, Some(AFTER_15_MIN_1_S)), (false, Some(ChipEvent::AbsentTooLong)));
    assert_eq!(found(&memory, CUT, Some(NOTED)), (false, None), "and is over");
}

#[test]
fn the_limit_holds_for_every_interruption_with_a_clock() {
    for interruption in [HANG, DIP] {
        assert_eq!(found(&noted(), interruption, Some(AFTER_15_MIN)), (true, None), "{interruption:?}");
        let late = found(&noted(), interruption, Some(AFTER_15_MIN_1_S));
        assert_eq!(late, (false, Some(ChipEvent::AbsentTooLong)), "{interruption:?}");
    }
}

#[test]
fn after_a_power_cut_of_unknown_length_nothing_resumes() {
    const EARLIER: ClockTime = ClockTime { time: 0x09_5959, ..NOTED };
    const NO_TIME: ClockTime = ClockTime { time: u32::MAX, ..NOTED };
    let unknown = Some(ChipEvent::AbsenceUnknown);
    for now in [None, Some(EARLIER), Some(NO_TIME)] {
        assert_eq!(found(&noted(), CUT, now), (false, unknown), "{now:?}");
        assert_eq!(found(&noted(), DIP, now), (true, None), "a dip is short: {now:?}");
        assert_eq!(found(&noted(), HANG, now), (true, None), "a reset is short: {now:?}");
    }
    let memory = PrescriptionMemory::new();
    Run::start(&memory, None).ventilate(&paper_settings(25.0), 1);
    assert_eq!(found(&memory, CUT, Some(NOTED)), (false, unknown), "no note yet");
}

#[test]
fn a_power_cut_without_a_ventilation_is_a_first_start() {
    let none = (false, None);
    assert_eq!(found(&PrescriptionMemory::new(), CUT, Some(NOTED)), none, "empty memory");
    let memory = noted();
    let mut run = Run::start_at(&memory, CUT, Some(NOTED));
    run.ticks(1);
    run.ask(ControlRequest::Stop);
    run.ticks(1);
    assert_eq!(found(&memory, CUT, Some(NOTED)), none, "after a stop");
    assert_eq!(found(&noted(), None, Some(NOTED)), none, "a requested restart");
}

#[test]
fn a_damaged_prescription_is_reported_and_resumes_nothing() {
    for interruption in [CUT, DIP, HANG] {
        let memory = noted();
        memory.copies[0].settings[0].store(0);
        assert_eq!(found(&memory, interruption, Some(NOTED)), (false, Some(ChipEvent::PrescriptionDamaged)));
        assert_eq!(found(&memory, interruption, Some(NOTED)), (false, None), "once");
    }
    let memory = noted();
    memory.copies[1].magic.store(MAGIC);
    assert_eq!(found(&memory, CUT, Some(NOTED)), (true, None), "one valid copy is enough");
}

#[test]
fn a_program_that_fails_too_often_is_reported() {
    let memory = noted();
    (0..RESUMES).for_each(|_| drop(Run::start(&memory, HANG)));
    assert_eq!(found(&memory, HANG, Some(NOTED)), (false, Some(ChipEvent::ResumedTooOften)));
}

/// The time that the supply was away and the time that it is too low count together.
#[test]
fn a_supply_that_stays_low_ends_the_wait_after_15_min() {
    const AFTER_14_MIN_59_S: ClockTime = ClockTime { time: 0x10_1459, ..NOTED };
    for (now, seconds) in [(Some(AFTER_14_MIN_59_S), 1), (Some(AFTER_15_MIN), 0), (None, 900)] {
        let memory = noted();
        let mut control = device();
        let mut prescription = Prescription::attach(&memory, DIP, now);
        for tick in 0..1000 * seconds {
            assert_eq!(prescription.resume(&mut control, false), None, "tick {tick}");
        }
        assert!(prescription.is_due() && control.mode() == Mode::Standby);
        assert_eq!(prescription.resume(&mut control, false), Some(ChipEvent::AbsentTooLong));
        assert_eq!(prescription.resume(&mut control, true), None);
        assert_eq!((prescription.is_due(), control.mode()), (false, Mode::Standby));
        assert_eq!(found(&memory, DIP, now), (false, None), "and is over");
    }
    let memory = noted();
    let (mut control, mut prescription) =
        (device(), Prescription::attach(&memory, DIP, Some(AFTER_14_MIN_59_S)));
    (0..1000).for_each(|_| assert_eq!(prescription.resume(&mut control, false), None));
    assert_eq!(prescription.resume(&mut control, true), None);
    assert_eq!(control.mode(), Mode::Ventilating, "in the last tick it does resume");
}

#[test]
fn a_note_of_an_earlier_ventilation_does_not_count() {
    let memory = noted();
    let mut run = Run::start_at(&memory, CUT, Some(NOTED));
    run.ticks(1);
    run.ask(ControlRequest::Stop);
    run.ticks(1);
    assert_eq!(memory.notes.absence_s(Some(NOTED)), None, "the stop clears it");
    memory.ventilates_at(NOTED);
    run.ventilate(&paper_settings(20.0), 1);
    assert_eq!(memory.notes.absence_s(Some(NOTED)), None, "so does the next start");
    memory.ventilates_at(AFTER_15_MIN);
    run.ask(ControlRequest::Apply(paper_settings(30.0)));
    run.ticks(2 * BREATH);
    assert_eq!(memory.notes.absence_s(Some(AFTER_15_MIN)), Some(0), "and no later breath");
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

    /// Whatever the sensor reads in the ticks before each failure: less than a breath proves nothing, and no more than a stop
    /// takes the settings away.
    #[test]
    fn a_program_that_fails_before_a_breath_resumes_three_times_whatever_is_read(
        readings in prop::collection::vec(prop_oneof![Just(f32::NAN), Just(5.0f32), any::<f32>()], 1..40),
        stops in any::<bool>(),
    ) {
        let memory = noted();
        for _ in 0..RESUMES {
            let mut run = Run::start(&memory, HANG);
            for reading in &readings {
                run.ticks_on(1, *reading);
            }
            prop_assert_eq!(run.control.prescription(), Some(paper_settings(25.0)));
            if stops {
                run.ask(ControlRequest::Stop);
                run.ticks_on(1, f32::NAN);
                prop_assert_eq!(found(&memory, HANG, Some(NOTED)), (false, None));
                return Ok(());
            }
        }
        prop_assert_eq!(found(&memory, HANG, Some(NOTED)), (false, Some(ChipEvent::ResumedTooOften)));
    }

    /// A reset at any store leaves the settings before or after it, and never others or none.
    #[test]
    fn a_reset_at_any_store_leaves_old_or_new_settings(
        list in prop::collection::vec(settings(), 2..6), stores in 0usize..14,
    ) {
        let memory = PrescriptionMemory::new();
        let mut prescription = Prescription::attach(&memory, None, None);
        let mut control = device();
        let mut start = |settings: &Settings, prescription: &mut Prescription| {
            control = device();
            control.execute(&ControlRequest::Apply(*settings));
            control.execute(&ControlRequest::Start);
            for _ in 0..2 {
                let output = control.step(5.0);
                prescription.keep(&control, &output);
            }
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
