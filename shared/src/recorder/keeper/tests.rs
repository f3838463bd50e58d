use std::boxed::Box;
use std::vec::Vec;

use super::super::tests::{POWER_ON, RESET, bytes, happenings, run};
use super::super::{
    Boot, ChipEvent, FAST_TAIL, Happening, LOG_ENTRIES, Recorder, RecorderPart, RecorderStatus,
    RecordingState, SLOW_ENTRIES,
};
use super::*;
use crate::flash::archive::STEP_UNITS;
use crate::flash::{ERASED, UNIT};
use crate::safety::alarms::Fault;
use crate::ventilator::Mode;

const SECTOR: usize = 65_536;
const STARTS: [u32; 2] = [0, SECTOR as u32];
/// Ticks between two calls of [`Keeper::step`].
const INTERVAL: usize = 64;
/// Steps of a copy: the last one writes the record and the commit word.
const STEPS: usize = (4 * WORDS).div_ceil(UNIT * STEP_UNITS) + 1;

type Nor = crate::flash::nor::Nor<4, SECTOR>;

fn memory() -> Box<RecorderMemory> {
    Box::new(RecorderMemory::new())
}

/// A device with flash.
struct Device<'a> {
    memory: &'a RecorderMemory,
    recorder: Recorder<'a>,
    keeper: Keeper,
    flash: Nor,
}

impl<'a> Device<'a> {
    fn start(memory: &'a RecorderMemory, mut flash: Nor, boot: Boot) -> Self {
        let (keeper, restored) = Keeper::attach(&mut flash, STARTS, memory, boot.cause);
        let recorder = Recorder::attach(memory, Boot { restored, ..boot });
        Self { memory, recorder, keeper, flash }
    }

    /// Runs ticks and then a step; whether it erases.
    fn step(&mut self, mode: Mode, leave: Leave) -> bool {
        run(&mut self.recorder, mode, [9.0; INTERVAL]);
        let erases = self.keeper.step(&mut self.flash, self.memory, leave);
        if erases {
            self.keeper.erase(&mut self.flash);
        }
        erases
    }

    /// Ventilates and lets the recording end with a fault or a stop.
    fn ventilate(&mut self, ticks: usize, end: Mode) {
        for tick in (0..ticks).step_by(INTERVAL) {
            run(&mut self.recorder, Mode::Ventilating, [(tick % 50) as f32; INTERVAL]);
            assert!(!self.keeper.step(&mut self.flash, self.memory, Leave::Nothing));
        }
        run(&mut self.recorder, end, [1.0; FAST_TAIL as usize]);
    }

    /// Ventilates until a stop, and completes the copy.
    fn copy(&mut self, ticks: usize) {
        self.ventilate(ticks, Mode::Standby);
        for _ in 0..STEPS + 4 {
            self.step(Mode::Standby, Leave::Erase);
        }
        assert!(self.keeper.kept == self.memory.end() && self.keeper.archive.is_erased());
    }
}

/// All that a host can read of the recorded ticks.
fn recording(memory: &RecorderMemory) -> (RecorderStatus, [Vec<u8>; 2]) {
    let status = RecorderStatus { boot: 0, log: crate::recorder::Held::default(), ..memory.status() };
    (status, [RecorderPart::Fast, RecorderPart::Slow].map(|part| bytes(memory, part)))
}

#[test]
fn after_a_loss_of_the_supply_the_recording_and_the_log_are_there_and_the_log_goes_on() {
    let (before, after) = (memory(), memory());
    let mut device = Device::start(&before, Nor::new(), Boot { weights: Some(7), ..POWER_ON });
    device.copy(5000);
    let (log, boot) = (happenings(&before), before.status().boot);
    let device = Device::start(&after, device.flash, POWER_ON);
    // The ring of 60 s was copied while it went on for its tail.
    let fast = |memory| (recording(memory).0.fast, recording(memory).1[0].clone());
    assert_eq!(fast(&after), fast(&before));
    let [mine, theirs] = [&after, &before].map(|memory| bytes(memory, RecorderPart::Slow));
    assert!(theirs.starts_with(&mine) && theirs.len() - mine.len() <= 6 * (STEPS + 4) * INTERVAL / 20);
    assert_eq!(after.status().recording, RecordingState::Stopped);
    assert_eq!((after.status().tick, after.status().tick_boot, after.status().boot), {
        let RecorderStatus { tick, tick_boot, .. } = before.status();
        (tick, tick_boot, boot + 1)
    });
    let start = [
        Happening::Boot { cause: ResetCause::PowerOn, failed: false },
        Happening::Chip(ChipEvent::RecorderRestored),
    ];
    assert_eq!(happenings(&after), [log, start.to_vec()].concat());
    assert!(!device.recorder.interrupted());
}

#[test]
fn a_reset_that_leaves_the_memory_alone_restores_nothing() {
    let memory = memory();
    let mut device = Device::start(&memory, Nor::new(), POWER_ON);
    device.copy(3000);
    let before = recording(&memory);
    let mut device = Device::start(&memory, device.flash, RESET);
    assert_eq!(recording(&memory), before);
    assert!(!happenings(&memory).contains(&Happening::Chip(ChipEvent::RecorderRestored)));
    let erases = device.flash.erases;
    (0..10).for_each(|_| assert!(!device.step(Mode::Standby, Leave::Erase)));
    assert_eq!((device.flash.erases, device.keeper.archive.is_running()), (erases, false), "it is kept");
}

#[test]
fn damaged_memory_is_restored_after_any_reset_and_without_a_copy_cleared() {
    let memory = memory();
    let device = Device::start(&memory, Nor::new(), POWER_ON);
    assert_eq!(memory.status().boot, 1);
    memory.magic.store(0);
    let mut device = Device::start(&memory, device.flash, RESET);
    assert_eq!((memory.status().boot, memory.status().recording), (1, RecordingState::Nothing));
    device.copy(3000);
    memory.magic.store(0);
    Device::start(&memory, device.flash, RESET);
    assert_eq!((memory.status().boot, memory.status().recording), (2, RecordingState::Stopped));
}

#[test]
fn a_copy_of_another_layout_is_not_restored() {
    let memory = memory();
    let mut device = Device::start(&memory, Nor::new(), POWER_ON);
    device.copy(3000);
    memory.layout.store(1);
    let end = memory.end();
    device.keeper.kept = None;
    for _ in 0..STEPS + 4 {
        device.step(Mode::Standby, Leave::Erase);
    }
    assert_eq!(device.keeper.kept, end);
    Device::start(&memory, device.flash, POWER_ON);
    assert_eq!((memory.status().boot, memory.status().recording), (1, RecordingState::Nothing));
}

#[test]
fn each_end_of_a_ventilation_is_copied_once_with_one_erase() {
    let memory = memory();
    let mut device = Device::start(&memory, Nor::new(), POWER_ON);
    device.copy(1000);
    assert_eq!(device.flash.erases, 2, "of the first slot before, of the second for the next copy");
    for copies in 1..4 {
        device.copy(1000);
        assert_eq!(device.flash.erases, 2 + copies);
        let written = device.flash.written.clone();
        (0..50).for_each(|_| assert!(!device.step(Mode::Standby, Leave::Erase)));
        assert!(device.flash.written == written, "nothing more is written");
    }
}

#[test]
fn the_copy_begins_after_the_last_ticks_and_waits_for_leave() {
    let memory = memory();
    let mut device = Device::start(&memory, Nor::new(), POWER_ON);
    device.copy(1000);
    let fault = Mode::Fault(Fault::HardLimit);
    run(&mut device.recorder, Mode::Ventilating, [20.0; 3000]);
    for tick in (0..FAST_TAIL as usize).step_by(INTERVAL) {
        device.step(fault, Leave::Write);
        assert!(!device.keeper.archive.is_running(), "{tick} ticks after the end");
    }
    for _ in 0..3 {
        device.step(fault, Leave::Nothing);
        assert!(!device.keeper.archive.is_running());
    }
    device.step(fault, Leave::Write);
    assert!(device.keeper.archive.is_running());
    let erases = device.flash.erases;
    let written = |device: &Device| device.flash.written.iter().filter(|written| **written).count();
    let before = written(&device);
    device.step(fault, Leave::Write);
    assert_eq!(written(&device) - before, STEP_UNITS * UNIT, "a piece per step");
    (0..3).for_each(|_| assert!(!device.step(fault, Leave::Nothing)));
    assert_eq!(written(&device) - before, STEP_UNITS * UNIT, "and none without leave");
    for _ in 0..STEPS {
        device.step(fault, Leave::Write);
    }
    assert_eq!(device.keeper.kept, memory.end());
    assert_eq!(device.flash.erases, erases, "no erase in the safe state");
    assert!(device.step(Mode::Standby, Leave::Erase), "but in standby");
    assert!(!device.step(Mode::Standby, Leave::Erase));
}

#[test]
fn a_start_ends_a_running_copy_and_the_older_one_stays_until_the_next_end() {
    let (memory, after) = (memory(), memory());
    let mut device = Device::start(&memory, Nor::new(), POWER_ON);
    device.copy(1000);
    let older = device.keeper.kept;
    device.ventilate(1000, Mode::Standby);
    for _ in 0..5 {
        device.step(Mode::Standby, Leave::Erase);
    }
    assert!(device.keeper.archive.is_running());
    run(&mut device.recorder, Mode::Ventilating, [9.0; 3]);
    assert!(!device.keeper.step(&mut device.flash, &memory, Leave::Nothing));
    assert!(!device.keeper.archive.is_running());
    let (keeper, _) = Keeper::attach(&mut device.flash.clone(), STARTS, &after, ResetCause::PowerOn);
    assert_eq!(keeper.kept, older);
    device.copy(1000);
    let (keeper, _) = Keeper::attach(&mut device.flash, STARTS, &after, ResetCause::PowerOn);
    assert_eq!(keeper.kept, memory.end());
}

#[test]
fn a_cleared_recording_is_not_copied_and_ends_a_running_copy() {
    let memory = memory();
    let mut device = Device::start(&memory, Nor::new(), POWER_ON);
    device.copy(1000);
    let kept = device.keeper.kept;
    device.ventilate(1000, Mode::Standby);
    for _ in 0..3 {
        device.step(Mode::Standby, Leave::Erase);
    }
    memory.request_clear();
    for _ in 0..STEPS + 4 {
        device.step(Mode::Standby, Leave::Erase);
    }
    assert_eq!((device.keeper.kept, device.keeper.archive.is_running()), (kept, false));
}

#[test]
fn a_ventilation_that_a_reset_ended_is_copied_unless_it_resumes() {
    let memory = memory();
    let mut device = Device::start(&memory, Nor::new(), POWER_ON);
    run(&mut device.recorder, Mode::Ventilating, [9.0; 3000]);
    let mut device = Device::start(&memory, device.flash, RESET);
    assert_eq!(memory.status().recording, RecordingState::Reset);
    for _ in 0..STEPS + 4 {
        device.step(Mode::Standby, Leave::Erase);
    }
    assert_eq!(device.keeper.kept, memory.end());
    run(&mut device.recorder, Mode::Ventilating, [9.0; 100]);
    assert_eq!(memory.end(), None);
}

#[test]
fn entries_that_are_overwritten_while_they_are_copied_are_left_out() {
    let (before, after) = (memory(), memory());
    let mut device = Device::start(&before, Nor::new(), POWER_ON);
    device.ventilate(20 * (SLOW_ENTRIES + 100), Mode::Standby);
    (0..LOG_ENTRIES).for_each(|_| device.recorder.log(ChipEvent::SupplyLow));
    for step in 0..STEPS + 4 {
        device.step(Mode::Standby, Leave::Erase);
        // Few enough for the ring, and at each place of it.
        (0..if step < STEPS { 20 } else { 0 }).for_each(|_| device.recorder.log(ChipEvent::NoCrystal));
    }
    let slow = before.status().slow;
    Device::start(&after, device.flash, POWER_ON);
    let found = after.status();
    assert!(found.slow.next < slow.next && found.slow.first <= slow.first, "{found:?} {slow:?}");
    let (from, all) = (found.slow.first, bytes(&after, RecorderPart::Slow));
    let same = bytes(&before, RecorderPart::Slow);
    let skipped = 6 * (slow.first - from) as usize;
    assert_eq!(all[skipped..], same[..all.len() - skipped], "the entries that both have");
    let log = happenings(&after);
    assert!(log.len() < LOG_ENTRIES && log.len() > LOG_ENTRIES / 4, "{}", log.len());
    let events = log.iter().filter(|event| matches!(event, Happening::Chip(_))).count();
    assert_eq!(events, log.len() - 1, "every event is whole, and the boot");
}

#[test]
fn a_cut_at_any_unit_leaves_the_old_or_the_new_recording() {
    let (first, after) = (memory(), memory());
    let mut device = Device::start(&first, Nor::new(), POWER_ON);
    device.copy(2500);
    let old = device.keeper.kept;
    device.ventilate(2500, Mode::Standby);
    let new = first.end();
    let steps = |flash: &mut Nor, supply: usize| {
        flash.supply = supply;
        let (mut keeper, _) = Keeper::attach(flash, STARTS, &first, ResetCause::Software);
        for _ in 0..STEPS + 4 {
            if keeper.step(flash, &first, Leave::Erase) {
                keeper.erase(flash);
            }
        }
        flash.supply = usize::MAX;
    };
    let whole = 4 * WORDS.next_multiple_of(8);
    let last = whole + UNIT..whole + 2 * UNIT + 8;
    for supply in (0..whole).step_by(611).chain(last).chain((whole..whole + SECTOR).step_by(4001)) {
        let mut flash = device.flash.clone();
        steps(&mut flash, supply);
        let (keeper, restored) = Keeper::attach(&mut flash, STARTS, &after, ResetCause::PowerOn);
        // After the commit word itself, only its padding may be missing.
        let expected = if supply < whole + UNIT + 4 { old } else { new };
        assert_eq!((keeper.kept, restored), (expected, true), "after {supply} bytes of {whole}");
        assert_eq!(after.end(), expected);
    }
}

#[test]
fn a_worn_flash_is_not_tried_again_before_the_next_end() {
    let memory = memory();
    let mut device = Device::start(&memory, Nor::new(), POWER_ON);
    device.flash.supply = 0;
    device.ventilate(1000, Mode::Standby);
    let erases = (0..20).filter(|_| device.step(Mode::Standby, Leave::Erase)).count();
    assert_eq!(erases, 1);
    device.flash.supply = SECTOR + 1000;
    device.ventilate(1000, Mode::Standby);
    let erases = (0..20).filter(|_| device.step(Mode::Standby, Leave::Erase)).count();
    assert_eq!((erases, device.keeper.kept), (1, memory.end()), "the first piece failed");
    device.flash = Nor::new();
    device.copy(1000);
}

#[test]
fn a_slot_has_the_length_of_its_content() {
    assert_eq!(Keeper::BYTES as usize, 4 * WORDS.next_multiple_of(8) + 3 * UNIT);
    let memory = memory();
    let mut device = Device::start(&memory, Nor::new(), POWER_ON);
    device.copy(1000);
    let length = device.flash.cells[..SECTOR].iter().rposition(|byte| *byte != ERASED).unwrap();
    assert!(length < Keeper::BYTES as usize && length > Keeper::BYTES as usize - UNIT, "{length}");
}

#[test]
fn a_leave_is_found_by_its_number() {
    for leave in [Leave::Nothing, Leave::Write, Leave::Erase] {
        assert_eq!(Leave::of(leave as u8), leave);
    }
    assert_eq!(Leave::of(77), Leave::Nothing);
}
