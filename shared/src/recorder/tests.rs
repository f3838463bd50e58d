use crate::control::memory::Lesson;
use std::boxed::Box;
use std::vec;
use std::vec::Vec as StdVec;

use proptest::prelude::*;

use super::cell::fuse;
use super::entry::{EVENT_BYTES, TICK_BYTES};
use super::*;
use crate::breath::{DEFAULT_PERIOD_US, Phase, paper_settings};
use crate::device::ControlRequest;
use crate::device::KNOWN_GOOD;
use crate::device::control::Control;
use crate::link::messages::{ControllerChoice, DeviceKind};
use crate::reset::ResetCause;
use crate::safety::filter::ValveCommand;
use crate::safety::monitors::Monitors;
use crate::settings::Settings;
use crate::ventilator::{Mode, Output, Sample};

pub const POWER_ON: Boot = Boot { cause: ResetCause::PowerOn, failed: false, weights: None, restored: false };
pub const RESET: Boot = Boot { cause: ResetCause::Watchdog, ..POWER_ON };

fn sample(breath: u32, tick: u32) -> Sample {
    let pressure = f32::NAN;
    let (phase, target) = (Phase::Inspiration, 20.0);
    Sample {
        breath,
        tick,
        phase,
        target,
        pressure,
        u_in: 0.0,
        u_out: true,
        explore: 0.0,
        learned: 0.0,
        flow: None,
    }
}

/// Records a tick with safe valves, since only the safety filter can make other commands.
fn tick(recorder: &mut Recorder, mode: Mode, reading: f32) {
    let sample = (mode == Mode::Ventilating).then(|| sample(3, 5));
    let output = Output { command: ValveCommand::SAFE, mode, sample, alarm: None };
    let settings = Settings::default();
    recorder.record(&RecorderInput {
        reading,
        output: &output,
        settings: &settings,
        learned: false,
        lesson: Lesson::Forget,
        missed: 0,
    });
}

pub fn run(recorder: &mut Recorder, mode: Mode, readings: impl IntoIterator<Item = f32>) {
    readings.into_iter().for_each(|reading| tick(recorder, mode, reading));
}

/// A device for plants whose readings the tests make up.
fn control() -> Control {
    let control = Control::new(DeviceKind::Simulated, DEFAULT_PERIOD_US, 1).unwrap();
    control.with_monitors(Monitors::ANY_PLANT)
}

/// Reads the bytes of all entries of a part, page by page.
pub fn bytes(memory: &RecorderMemory, part: RecorderPart) -> StdVec<u8> {
    let status = memory.status();
    let held = match part {
        RecorderPart::Fast => status.fast,
        RecorderPart::Slow => status.slow,
        RecorderPart::Log => status.log,
    };
    let (mut from, mut all) = (held.first, StdVec::new());
    loop {
        let page = memory.page(part, from);
        assert_eq!((page.part, page.first), (part, from));
        if page.bytes.is_empty() {
            return all;
        }
        let length = if part == RecorderPart::Log { EVENT_BYTES } else { TICK_BYTES };
        assert_eq!(page.bytes.len() % length, 0, "whole entries");
        from += (page.bytes.len() / length) as u32;
        all.extend_from_slice(&page.bytes);
    }
}

fn ticks(memory: &RecorderMemory, part: RecorderPart) -> StdVec<Option<TickEntry>> {
    bytes(memory, part).as_chunks().0.iter().map(|entry| TickEntry::read(*entry)).collect()
}

/// Pressures of a part as whole numbers, gaps as -1.
fn pressures(memory: &RecorderMemory, part: RecorderPart) -> StdVec<i32> {
    ticks(memory, part).iter().map(|entry| entry.map_or(-1, |entry| (entry.pressure + 0.5) as i32)).collect()
}

fn log(memory: &RecorderMemory) -> StdVec<LogEntry> {
    bytes(memory, RecorderPart::Log)
        .as_chunks()
        .0
        .iter()
        .map(|entry| LogEntry::read(*entry).unwrap())
        .collect()
}

pub fn happenings(memory: &RecorderMemory) -> StdVec<Happening> {
    log(memory).iter().map(|entry| entry.happening).collect()
}

/// Whole numbers that are possible pressures, ascending and repeated.
fn counting(from: u32, count: u32) -> impl Iterator<Item = f32> {
    (from..from + count).map(|number| (number % 200) as f32)
}

fn counted(from: u32, count: u32) -> StdVec<i32> {
    counting(from, count).map(|number| number as i32).collect()
}

#[test]
fn the_recorder_fits_into_its_memory() {
    assert!(size_of::<RecorderMemory>() <= 44 * 1024, "{} bytes", size_of::<RecorderMemory>());
    assert!(size_of::<RecorderMemory>() <= BYTES);
}

#[test]
fn the_last_two_seconds_are_kept_in_order_with_their_ticks() {
    let memory = Box::new(RecorderMemory::new());
    let mut recorder = Recorder::attach(&memory, POWER_ON);
    run(&mut recorder, Mode::Standby, counting(0, 77));
    run(&mut recorder, Mode::Ventilating, counting(0, 10));
    assert_eq!(pressures(&memory, RecorderPart::Fast), [vec![-1], counted(0, 10)].concat());
    run(&mut recorder, Mode::Ventilating, counting(10, 4000));
    assert_eq!(pressures(&memory, RecorderPart::Fast), counted(2010, 2000));
    let RecorderStatus { fast, recording, tick, tick_boot, .. } = memory.status();
    assert_eq!(fast.tick(fast.next - 1, 1), 77 + 4009);
    assert_eq!((recording, tick, tick_boot), (RecordingState::Running, 77, 1));
}

#[test]
fn the_last_minute_keeps_every_peak() {
    let memory = Box::new(RecorderMemory::new());
    let mut recorder = Recorder::attach(&memory, POWER_ON);
    run(&mut recorder, Mode::Ventilating, (0..60_040).map(|tick| if tick == 60_003 { 61.0 } else { 8.0 }));
    let slow = pressures(&memory, RecorderPart::Slow);
    assert_eq!(slow.len(), SLOW_ENTRIES);
    let held = memory.status().slow;
    let peak = slow.iter().position(|pressure| *pressure == 61).unwrap() as u32;
    assert_eq!(held.tick(held.first + peak, SLOW_STRIDE), 60_019, "the last of the twenty");
    assert_eq!(slow.iter().filter(|pressure| **pressure == 8).count(), SLOW_ENTRIES - 1);
}

#[test]
fn readings_that_are_no_number_do_not_hide_the_others() {
    let memory = Box::new(RecorderMemory::new());
    let mut recorder = Recorder::attach(&memory, POWER_ON);
    run(&mut recorder, Mode::Ventilating, (0..20).map(|tick| if tick == 7 { 9.0 } else { f32::NAN }));
    run(&mut recorder, Mode::Ventilating, [f32::NAN; 20]);
    let slow = ticks(&memory, RecorderPart::Slow);
    assert!((slow[1].unwrap().pressure - 9.0).abs() < 0.01 && slow[2].unwrap().pressure.is_nan());
}

#[test]
fn a_fault_ends_the_recording_after_its_tail_and_nothing_but_a_new_start_goes_on() {
    let memory = Box::new(RecorderMemory::new());
    let mut recorder = Recorder::attach(&memory, POWER_ON);
    run(&mut recorder, Mode::Ventilating, counting(0, 3000));
    let fault = Mode::Fault(Fault::HighPressure);
    run(&mut recorder, fault, counting(3000, FAST_TAIL + 100));
    let kept = bytes(&memory, RecorderPart::Fast);
    assert_eq!(
        pressures(&memory, RecorderPart::Fast),
        counted(1500, 2000),
        "half a second after the fault is recorded"
    );
    assert_eq!(ticks(&memory, RecorderPart::Fast)[1500].unwrap().activity, Activity::Fault);
    assert_eq!(
        (memory.status().recording, memory.status().tick),
        (RecordingState::Fault(Fault::HighPressure), 3000)
    );
    run(&mut recorder, fault, counting(0, SLOW_TAIL));
    let slow = bytes(&memory, RecorderPart::Slow);
    assert_eq!(slow.len() / TICK_BYTES, 1 + (3000 + SLOW_TAIL as usize) / 20);
    run(&mut recorder, fault, [50.0; 1000]);
    run(&mut recorder, Mode::Standby, [50.0; 1000]);
    assert_eq!(
        (bytes(&memory, RecorderPart::Fast), bytes(&memory, RecorderPart::Slow)),
        (kept, slow),
        "recording has stopped"
    );
    run(&mut recorder, Mode::Ventilating, [1.0, 2.0]);
    assert_eq!(pressures(&memory, RecorderPart::Fast)[1997..], [-1, 1, 2], "a gap, then the new run");
    assert_eq!(memory.status().recording, RecordingState::Running);
}

#[test]
fn a_fault_in_standby_is_logged_and_leaves_the_recording_alone() {
    let memory = Box::new(RecorderMemory::new());
    let mut recorder = Recorder::attach(&memory, POWER_ON);
    run(&mut recorder, Mode::Fault(Fault::ReadingNotANumber), [f32::NAN; 2000]);
    assert_eq!((memory.status().recording, memory.status().fast.next), (RecordingState::Nothing, 0));
    assert_eq!(happenings(&memory)[1..], [Happening::Fault(Fault::ReadingNotANumber)]);
}

#[test]
fn a_reset_while_ventilating_leaves_the_recording_and_names_it() {
    let memory = Box::new(RecorderMemory::new());
    let mut recorder = Recorder::attach(&memory, POWER_ON);
    run(&mut recorder, Mode::Ventilating, counting(0, 700));
    let mut recorder = Recorder::attach(&memory, RESET);
    run(&mut recorder, Mode::Standby, [0.0; 100]);
    let RecorderStatus { boot, recording, tick, tick_boot, .. } = memory.status();
    assert_eq!((boot, recording, tick, tick_boot), (2, RecordingState::Reset, 699, 1));
    assert_eq!(pressures(&memory, RecorderPart::Fast), [vec![-1], counted(0, 700)].concat());
    let boots: StdVec<_> = log(&memory).iter().map(|entry| (entry.boot, entry.tick)).collect();
    assert_eq!(boots.first(), Some(&(1, 0)));
    assert_eq!(boots.last(), Some(&(2, 0)));
}

#[test]
fn power_up_empties_everything_and_a_dip_of_the_supply_keeps_the_log_alone() {
    for (cause, ticks, events) in
        [(ResetCause::BrownOut, 0, 3), (ResetCause::PowerOn, 0, 1), (ResetCause::Pin, 11, 3)]
    {
        let memory = Box::new(RecorderMemory::new());
        let mut recorder = Recorder::attach(&memory, POWER_ON);
        run(&mut recorder, Mode::Ventilating, counting(0, 10));
        Recorder::attach(&memory, Boot { cause, ..POWER_ON });
        assert_eq!(pressures(&memory, RecorderPart::Fast).len(), ticks, "{cause:?}");
        assert_eq!(log(&memory).len(), events, "{cause:?}");
    }
}

#[test]
fn memory_of_another_layout_is_emptied() {
    for spoil in
        [|memory: &RecorderMemory| memory.layout.store(7), |memory: &RecorderMemory| memory.magic.store(7)]
    {
        let memory = Box::new(RecorderMemory::new());
        let mut recorder = Recorder::attach(&memory, POWER_ON);
        run(&mut recorder, Mode::Ventilating, counting(0, 10));
        spoil(&memory);
        Recorder::attach(&memory, RESET);
        assert_eq!((memory.status().boot, memory.status().fast.next, log(&memory).len()), (1, 0, 1));
    }
}

#[test]
fn a_host_clears_the_recording_and_the_log_records_it() {
    let memory = Box::new(RecorderMemory::new());
    let mut recorder = Recorder::attach(&memory, POWER_ON);
    run(&mut recorder, Mode::Ventilating, counting(0, 100));
    run(&mut recorder, Mode::Fault(Fault::HighPressure), [30.0]);
    memory.request_clear();
    for _ in 0..2 {
        let RecorderStatus { recording, fast, slow, .. } = memory.status();
        assert_eq!(
            (recording, fast.next - fast.first, slow.next - slow.first),
            (RecordingState::Nothing, 0, 0)
        );
        run(&mut recorder, Mode::Fault(Fault::HighPressure), [30.0; 1000]);
    }
    assert_eq!(happenings(&memory).last(), Some(&Happening::Cleared));
    run(&mut recorder, Mode::Standby, [5.0]);
    run(&mut recorder, Mode::Ventilating, [6.0]);
    memory.request_clear();
    run(&mut recorder, Mode::Ventilating, [7.0, 8.0]);
    assert_eq!(pressures(&memory, RecorderPart::Fast), [7, 8], "a running one continues");
    assert_eq!(memory.status().recording, RecordingState::Running);
}

#[test]
fn the_log_holds_a_thousand_events_and_drops_the_oldest() {
    let memory = Box::new(RecorderMemory::new());
    let mut recorder = Recorder::attach(&memory, POWER_ON);
    for _ in 0..600 {
        run(&mut recorder, Mode::Ventilating, [5.0]);
        run(&mut recorder, Mode::Standby, [5.0]);
    }
    let log = log(&memory);
    assert_eq!(log.len(), LOG_ENTRIES);
    assert_eq!(log.last().unwrap(), &LogEntry { tick: 1199, boot: 1, happening: Happening::Stop });
    assert!(log.windows(2).all(|pair| pair[0].tick + 1 == pair[1].tick));
}

#[test]
fn settings_of_every_breath_do_not_push_the_rest_out_of_the_log() {
    let memory = Box::new(RecorderMemory::new());
    let mut recorder = Recorder::attach(&memory, POWER_ON);
    let mut control = control();
    control.execute(&ControlRequest::Apply(paper_settings(10.0)));
    control.execute(&ControlRequest::Start);
    for breath in 0..60 {
        control.execute(&ControlRequest::Apply(paper_settings(10.0 + (breath % 20) as f32)));
        for _ in 0..3000 {
            let output = control.step(5.0);
            recorder.record(&control.moment(5.0, &output, 1));
        }
    }
    let found = happenings(&memory);
    let of = |wanted: fn(&Happening) -> bool| found.iter().filter(|one| wanted(one)).count();
    assert_eq!(of(|one| matches!(one, Happening::Settings { .. })), 3, "{found:?}");
    assert_eq!(of(|one| matches!(one, Happening::Missed { .. })), 3, "{found:?}");
    assert_eq!(of(|one| *one == Happening::Controller { learned: false }), 1);
    assert!(found.contains(&Happening::Settings { pip: 10.0, peep: 5.0, rate: 20.0 }));
}

#[test]
fn an_alarm_that_does_not_end_ventilation_is_logged_and_recording_goes_on() {
    let memory = Box::new(RecorderMemory::new());
    let mut recorder = Recorder::attach(&memory, POWER_ON);
    run(&mut recorder, Mode::Ventilating, [5.0]);
    let told = |mode, alarm| Output { command: ValveCommand::SAFE, mode, sample: None, alarm: Some(alarm) };
    let distrusted = told(Mode::Ventilating, Fault::LearnedDistrusted);
    let latched = told(Mode::Fault(Fault::HardLimit), Fault::HardLimit);
    let settings = Settings::default();
    for output in [&distrusted, &latched] {
        recorder.record(&RecorderInput {
            reading: 5.0,
            output,
            settings: &settings,
            learned: false,
            lesson: Lesson::Forget,
            missed: 0,
        });
    }
    let told: StdVec<Happening> = happenings(&memory)
        .into_iter()
        .filter(|one| matches!(one, Happening::Alarm(_) | Happening::Fault(_)))
        .collect();
    assert_eq!(told, [Happening::Alarm(Fault::LearnedDistrusted), Happening::Fault(Fault::HardLimit)]);
}

#[test]
fn what_the_ventilator_did_is_what_is_recorded() {
    let memory = Box::new(RecorderMemory::new());
    let mut recorder = Recorder::attach(&memory, POWER_ON);
    let mut control = control();
    control.execute(&ControlRequest::Controller(ControllerChoice::Pid(KNOWN_GOOD)));
    control.execute(&ControlRequest::Apply(Settings::default()));
    control.execute(&ControlRequest::Start);
    let mut expected = StdVec::new();
    for tick in 0..1800 {
        let reading = 5.0 + tick as f32 / 100.0;
        let output = control.step(reading);
        recorder.record(&control.moment(reading, &output, 0));
        expected.push((reading, output.command, output.sample.unwrap()));
    }
    let found = ticks(&memory, RecorderPart::Fast);
    assert_eq!(found.len(), 1801);
    for (entry, (reading, command, sample)) in found[1..].iter().zip(&expected) {
        let entry = entry.unwrap();
        assert!((entry.pressure - reading).abs() <= 0.0051 && (entry.u_in - command.u_in()).abs() <= 0.0501);
        assert!((entry.target.unwrap() - sample.target).abs() <= 0.0051);
        assert_eq!((entry.u_out, entry.phase, entry.breath), (command.u_out(), Some(sample.phase), 0));
        assert_eq!((entry.activity, entry.explored), (Activity::Ventilating, false));
    }
}

#[test]
fn numbers_begin_again_without_a_gap() {
    let memory = Box::new(RecorderMemory::new());
    let mut recorder = Recorder::attach(&memory, POWER_ON);
    let slots = FAST_ENTRIES as u32 + 1;
    memory.fast.jump(Ring::<{ FAST_ENTRIES + 1 }, TICK_HALVES>::LIMIT - 1000);
    run(&mut recorder, Mode::Ventilating, counting(0, 999));
    let before = memory.status().fast;
    assert_eq!((before.next, before.tick(slots - 1, 1)), (slots, 998), "the last one before it has its tick");
    assert_eq!(pressures(&memory, RecorderPart::Fast), [vec![-1], counted(0, 999)].concat());
    run(&mut recorder, Mode::Ventilating, counting(999, 3000));
    let after = memory.status().fast;
    assert_eq!(after.tick(after.next - 1, 1), 3998);
    assert_eq!(pressures(&memory, RecorderPart::Fast), counted(1999, 2000));
}

#[test]
fn a_page_from_anywhere_begins_with_the_oldest_that_is_left_or_is_empty() {
    let memory = Box::new(RecorderMemory::new());
    let mut recorder = Recorder::attach(&memory, POWER_ON);
    run(&mut recorder, Mode::Ventilating, counting(0, 5000));
    let page = |from| {
        let page = memory.page(RecorderPart::Fast, from);
        (page.first, page.bytes.len() / TICK_BYTES)
    };
    assert_eq!(page(0), (3001, PAGE_BYTES / TICK_BYTES));
    assert_eq!(page(5000), (5000, 1));
    assert_eq!((page(5001).1, page(u32::MAX).1), (0, 0));
}

/// A short life with every kind of write: start, a full ring of ticks, a fault, its tail, a clear, a new start.
fn life(memory: &RecorderMemory) {
    let mut recorder = Recorder::attach(memory, Boot { weights: Some(7), ..RESET });
    run(&mut recorder, Mode::Ventilating, counting(0, 45));
    run(&mut recorder, Mode::Fault(Fault::HighPressure), counting(45, 5));
    run(&mut recorder, Mode::Standby, counting(50, 3));
    memory.request_clear();
    run(&mut recorder, Mode::Ventilating, counting(53, 25));
}

/// After a cut at any single store the memory has a valid state of that life, and stays usable.
#[test]
fn a_reset_at_any_store_leaves_no_wrong_entry() {
    let aged = || {
        let memory = Box::new(RecorderMemory::new());
        run(&mut Recorder::attach(&memory, POWER_ON), Mode::Ventilating, counting(100, 2600));
        memory
    };
    let whole = aged();
    fuse::set(usize::MAX);
    life(&whole);
    let stores = usize::MAX - fuse::left();
    assert!(stores > 300, "{stores}");
    // The old entries, then those of this life, with gaps in between.
    let story: StdVec<i32> =
        [counted(100, 2600), vec![-1], counted(0, 45), counted(45, 8), vec![-1], counted(53, 25)].concat();
    let followed = |found: &[i32]| found.is_empty() || story.windows(found.len()).any(|part| part == found);
    let all = log(&whole);
    for cut in 0..stores {
        let memory = aged();
        fuse::set(cut);
        life(&memory);
        fuse::set(usize::MAX);
        let mut recorder = Recorder::attach(&memory, RESET);
        let found = pressures(&memory, RecorderPart::Fast);
        assert!(followed(&found), "cut after {cut} stores: {found:?}");
        let events: StdVec<_> = log(&memory);
        let (last, before) = events.split_last().unwrap();
        assert!(matches!(last.happening, Happening::Boot { cause: ResetCause::Watchdog, .. }), "{cut}");
        assert!(before.iter().zip(&all).all(|(found, expected)| found.happening == expected.happening));
        assert!(before.len() <= all.len() && before.len() >= 2, "{cut}: {before:?}");
        run(&mut recorder, Mode::Ventilating, [1.0, 2.0, 3.0]);
        let found = pressures(&memory, RecorderPart::Fast);
        assert_eq!(found[found.len() - 4..], [-1, 1, 2, 3], "cut after {cut} stores");
    }
}

/// The same for a start on unformatted memory: afterwards it is unformatted or a valid recorder.
#[test]
fn a_reset_at_any_store_of_the_first_start_is_harmless() {
    for cut in 0..40 {
        let memory = Box::new(RecorderMemory::new());
        fuse::set(cut);
        Recorder::attach(&memory, POWER_ON);
        fuse::set(usize::MAX);
        let mut recorder = Recorder::attach(&memory, RESET);
        run(&mut recorder, Mode::Ventilating, [4.0]);
        assert_eq!(pressures(&memory, RecorderPart::Fast), [-1, 4]);
        assert!(log(&memory).iter().all(|entry| entry.boot <= 2 && entry.tick == 0));
    }
}

proptest! {
    /// Memory after power-up has any content. Without the magic and the layout it is cleared; with them by chance, nothing
    /// panics and no page is too long.
    #[test]
    fn garbage_is_refused_and_never_panics(
        words in prop::array::uniform9(any::<u32>()), header in prop::array::uniform3(any::<u32>()), marked: bool,
        from: u32,
    ) {
        let memory = Box::new(RecorderMemory::new());
        let ring = |index: usize| [words[index], words[index + 1], words[index + 2]];
        memory.fast.spoil(ring(0));
        memory.slow.spoil(ring(3));
        memory.log.spoil(ring(6));
        memory.boots.store(header[0]);
        memory.recording.store(header[1]);
        memory.clear.store(header[2]);
        memory.layout.store(if marked { LAYOUT } else { header[0] });
        memory.magic.store(if marked { MAGIC } else { header[1] });
        let mut recorder = Recorder::attach(&memory, RESET);
        let RecorderStatus { boot, recording, fast, slow, .. } = memory.status();
        prop_assert_eq!((boot, recording, fast.next - fast.first, slow.next - slow.first), (1, RecordingState::Nothing, 0, 0));
        run(&mut recorder, Mode::Ventilating, counting(0, 50));
        prop_assert_eq!(pressures(&memory, RecorderPart::Fast).len(), 51);
        memory.page(RecorderPart::Slow, from);
    }

    /// With any sequence of modes the rings contain the newest ticks in order, separated by gaps.
    #[test]
    fn ticks_stay_in_order_through_any_life(parts in prop::collection::vec((0u8..4, 1u32..900), 1..20)) {
        let memory = Box::new(RecorderMemory::new());
        let mut recorder = Recorder::attach(&memory, POWER_ON);
        let mut number = 0;
        for (kind, length) in parts {
            let mode = match kind {
                0 => Mode::Standby,
                1 => Mode::Fault(Fault::ReadingOutOfRange),
                _ => Mode::Ventilating,
            };
            run(&mut recorder, mode, counting(number, length));
            number += length;
            if kind == 3 {
                recorder = Recorder::attach(&memory, RESET);
            }
        }
        let found = pressures(&memory, RecorderPart::Fast);
        prop_assert!(found.len() <= FAST_ENTRIES);
        for pair in found.windows(2) {
            prop_assert!(pair[0] < 0 || pair[1] < 0 || pair[1] == (pair[0] + 1) % 200, "{:?}", pair);
        }
    }

    #[test]
    fn an_entry_keeps_its_values_to_their_resolution(
        pressure in prop_oneof![Just(f32::NAN), Just(f32::INFINITY), Just(f32::NEG_INFINITY), -150.0f32..300.0],
        target in prop::option::of(-1.0f32..90.0), u_in in 0.0f32..100.0, u_out: bool, explored: bool, breath: u8,
        phase in prop_oneof![
            Just(None), Just(Some(Phase::Inspiration)), Just(Some(Phase::Fall)), Just(Some(Phase::Expiration))
        ],
        activity in prop_oneof![Just(Activity::Standby), Just(Activity::Ventilating), Just(Activity::Fault)],
    ) {
        let entry = TickEntry { pressure, target, u_in, u_out, phase, explored, activity, breath };
        let read = TickEntry::read(stored(entry.pack())).unwrap();
        let near = |found: f32, expected: f32, step: f32| (found - expected).abs() <= 0.51 * step;
        prop_assert!(read.pressure.is_nan() == pressure.is_nan());
        prop_assert!(pressure.is_nan() || near(read.pressure, pressure.clamp(-99.99, 227.67), 0.01), "{}", read.pressure);
        prop_assert_eq!(read.target.is_some(), target.is_some());
        prop_assert!(target.is_none_or(|target| near(read.target.unwrap(), target.clamp(0.0, 81.9), 0.01)));
        prop_assert!(near(read.u_in, u_in, 0.1));
        prop_assert_eq!((read.u_out, read.phase, read.explored), (u_out, phase, explored));
        prop_assert_eq!((read.activity, read.breath), (activity, breath % 16));
    }

    #[test]
    fn no_flipped_bit_of_an_event_goes_unnoticed(tick: u32, boot: u16, argument: u32, bit in 0usize..96) {
        let entry = LogEntry { tick, boot, happening: Happening::Weights(argument) };
        let mut bytes: [u8; EVENT_BYTES] = stored(entry.pack());
        prop_assert_eq!(LogEntry::read(bytes), Some(entry));
        bytes[bit / 8] ^= 1 << (bit % 8);
        prop_assert_eq!(LogEntry::read(bytes), None);
    }

    #[test]
    fn any_bytes_are_an_entry_or_none(bytes: [u8; EVENT_BYTES], tick: [u8; TICK_BYTES]) {
        if let Some(entry) = LogEntry::read(bytes) {
            prop_assert_eq!(LogEntry::read(stored(entry.pack())).map(|again| again.tick), Some(entry.tick));
        }
        if let Some(entry) = TickEntry::read(tick) {
            prop_assert!(entry.pressure.is_nan() || entry.pressure.abs() < 230.0);
        }
    }
}

#[test]
fn every_happening_comes_back() {
    let all = [
        Happening::Boot { cause: ResetCause::Other, failed: true },
        Happening::Weights(u32::MAX),
        Happening::Start,
        Happening::Stop,
        Happening::Fault(Fault::HighPressure),
        Happening::Acknowledged,
        Happening::Controller { learned: true },
        Happening::Settings { pip: 35.5, peep: 20.0, rate: 80.0 },
        Happening::Missed { ticks: 1 << 30 },
        Happening::Cleared,
        Happening::Alarm(Fault::CommandCapped),
        Happening::Chip(ChipEvent::NoCrystal),
        Happening::Chip(ChipEvent::BrownOutLevelWrong),
        Happening::Chip(ChipEvent::RecorderRestored),
        Happening::Chip(ChipEvent::ResumedTooOften),
    ];
    for happening in all {
        let entry = LogEntry { tick: 1 << 31, boot: 65_535, happening };
        assert_eq!(LogEntry::read(stored(entry.pack())), Some(entry));
    }
    assert_eq!(LogEntry::read([0; EVENT_BYTES]), None, "empty memory is no event");
    assert_eq!(TickEntry::read(stored(entry::GAP)), None);
}

/// Halves as bytes in memory.
fn stored<const HALVES: usize, const BYTES: usize>(halves: [u16; HALVES]) -> [u8; BYTES] {
    let bytes: StdVec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
    bytes.try_into().unwrap()
}
