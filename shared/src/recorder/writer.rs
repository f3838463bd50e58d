//! The writer: it records ticks during and shortly after ventilation, and events always.

use super::entry::{Activity, ChipEvent, GAP, Happening, LogEntry, TickEntry};
use super::{CLEAR, FAST_TAIL, RecorderMemory, RecordingState, SLOW_STRIDE, SLOW_TAIL};
use crate::control::memory::Lesson;
use crate::reset::ResetCause;
use crate::settings::Settings;
use crate::ventilator::{Mode, Output};

/// Least number of ticks between two log entries of a kind that could occur in every tick or breath.
pub const LOG_INTERVAL: u32 = 60_000;

/// Description of the device's start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Boot {
    /// Cause of the start.
    pub cause: ResetCause,
    /// Whether a failure of the program caused the start.
    pub failed: bool,
    /// Id of the loaded weights.
    pub weights: Option<u32>,
    /// Whether the memory had lost its content and contains a copy from flash.
    pub restored: bool,
}

/// Input of the recorder in a control tick.
#[derive(Clone, Copy, Debug)]
pub struct RecorderInput<'a> {
    /// Pressure as read, cmH2O.
    pub reading: f32,
    /// Output of the tick.
    pub output: &'a Output,
    /// Settings in force.
    pub settings: &'a Settings,
    /// Whether learned weights run.
    pub learned: bool,
    /// What the controller last learned.
    pub lesson: Lesson,
    /// Ticks missed since the last one that ran.
    pub missed: u32,
}

/// Writer of a [`RecorderMemory`]; there must be only one.
#[derive(Debug)]
pub struct Recorder<'a> {
    memory: &'a RecorderMemory,
    boot: u16,
    interrupted: bool,
    /// Number of the next tick.
    now: u32,
    mode: Mode,
    /// Ticks that are still recorded after ventilation has ended.
    fast_left: u32,
    slow_left: u32,
    /// Ticks until the next entry of [`super::RecorderPart::Slow`].
    until_slow: u32,
    /// Highest pressure since the last such entry, cmH2O; NaN if there was no number.
    highest: f32,
    learned: Option<bool>,
    settings: RateLimited<Happening>,
    lesson: RateLimited<Lesson>,
    missed: u32,
    missed_logged: RateLimited<u32>,
}

/// A value that is logged after a change, at most once per [`LOG_INTERVAL`].
#[derive(Clone, Copy, Debug)]
struct RateLimited<T> {
    logged: Option<(T, u32)>,
}

impl<T: Copy + PartialEq> RateLimited<T> {
    const NEVER: Self = Self { logged: None };

    /// Whether to log this value now.
    fn is_due(&mut self, value: T, now: u32) -> bool {
        let due =
            self.logged.is_none_or(|(last, when)| last != value && now.wrapping_sub(when) >= LOG_INTERVAL);
        if due {
            self.logged = Some((value, now));
        }
        due
    }
}

impl<'a> Recorder<'a> {
    /// Attaches to memory with any content, as its first user since the device started. The content of an earlier run is
    /// kept if the supply was stable, or if it was restored from flash. Otherwise power-up clears everything, a supply dip
    /// everything except the log, whose entries have checksums.
    pub fn attach(memory: &'a RecorderMemory, boot: Boot) -> Self {
        if (boot.cause == ResetCause::PowerOn && !boot.restored) || !memory.is_sound() {
            memory.format();
        } else if boot.cause == ResetCause::BrownOut && !boot.restored {
            memory.fast.empty();
            memory.slow.empty();
            memory.set_recording(RecordingState::Nothing, 0);
        }
        let running = memory.recording().filter(|(recording, _)| *recording == RecordingState::Running);
        if let Some((_, before)) = running {
            let fast = memory.fast.held();
            memory.tick.store(fast.tick(fast.next.wrapping_sub(1), 1));
            memory.set_recording(RecordingState::Reset, before);
        }
        memory.clear.store(0);
        let number = memory.boots().unwrap_or(0).wrapping_add(1);
        memory.set_boots(number);
        let recorder = Self {
            memory,
            boot: number,
            interrupted: running.is_some(),
            now: 0,
            mode: Mode::Standby,
            fast_left: 0,
            slow_left: 0,
            until_slow: 0,
            highest: f32::NAN,
            learned: None,
            settings: RateLimited::NEVER,
            lesson: RateLimited::NEVER,
            missed: 0,
            missed_logged: RateLimited { logged: Some((0, LOG_INTERVAL.wrapping_neg())) },
        };
        recorder.enter(Happening::Boot { cause: boot.cause, failed: boot.failed });
        if boot.restored {
            recorder.enter(Happening::Chip(ChipEvent::RecorderRestored));
        }
        if let Some(id) = boot.weights {
            recorder.enter(Happening::Weights(id));
        }
        recorder
    }

    /// Whether the last run ended while the device ventilated.
    pub fn interrupted(&self) -> bool {
        self.interrupted
    }

    /// Logs an event of the chip, which the ticks do not show.
    pub fn log(&self, event: ChipEvent) {
        self.enter(Happening::Chip(event));
    }

    /// Records a tick, after all its other work.
    #[inline]
    pub fn record(&mut self, moment: &RecorderInput) {
        if self.memory.clear.load() == CLEAR {
            self.clear();
        }
        if moment.output.mode != self.mode {
            self.change(moment.output.mode);
        }
        match (moment.output.alarm, self.mode) {
            // A latched fault has been logged as a change of mode.
            (None, _) | (_, Mode::Fault(_)) => {}
            (Some(alarm), _) => self.enter(Happening::Alarm(alarm)),
        }
        if moment.missed > 0 {
            self.missed = self.missed.saturating_add(moment.missed);
        }
        if moment.output.sample.is_none_or(|sample| sample.tick == 0) {
            self.log_changes(moment);
        }
        if self.slow_left > 0 {
            self.record_tick(moment);
        }
        self.now = self.now.wrapping_add(1);
    }

    /// Records a tick in the fast ring and every 20th tick in the slow ring.
    fn record_tick(&mut self, moment: &RecorderInput) {
        let mut entry = entry(moment);
        if self.fast_left > 0 {
            self.memory.fast.push(entry.pack(), 1);
        }
        if entry.pressure > self.highest || self.highest.is_nan() {
            self.highest = entry.pressure;
        }
        self.until_slow = self.until_slow.saturating_sub(1);
        if self.until_slow == 0 {
            self.until_slow = SLOW_STRIDE;
            entry.pressure = core::mem::replace(&mut self.highest, f32::NAN);
            self.memory.slow.push(entry.pack(), SLOW_STRIDE);
        }
        if self.mode != Mode::Ventilating {
            self.fast_left = self.fast_left.saturating_sub(1);
            self.slow_left -= 1;
        }
        debug_assert!(self.fast_left <= self.slow_left, "the slow ring records for longer");
        debug_assert!((1..=SLOW_STRIDE).contains(&self.until_slow));
    }

    /// Handles a change of mode.
    #[cold]
    fn change(&mut self, mode: Mode) {
        let before = core::mem::replace(&mut self.mode, mode);
        match mode {
            Mode::Ventilating => {
                self.enter(Happening::Start);
                self.begin();
            }
            Mode::Standby if before == Mode::Ventilating => {
                self.enter(Happening::Stop);
                self.note(RecordingState::Stopped);
            }
            Mode::Standby => self.enter(Happening::Acknowledged),
            Mode::Fault(fault) => {
                self.enter(Happening::Fault(fault));
                if before == Mode::Ventilating {
                    self.note(RecordingState::Fault(fault));
                }
            }
        }
    }

    /// Begins a recording.
    fn begin(&mut self) {
        let RecorderMemory { fast, slow, .. } = self.memory;
        fast.push(GAP, 1);
        fast.set_origin(self.now.wrapping_sub(fast.next()));
        slow.push(GAP, SLOW_STRIDE);
        let first = self.now.wrapping_add(SLOW_STRIDE - 1);
        slow.set_origin(first.wrapping_sub(slow.next().wrapping_mul(SLOW_STRIDE)));
        (self.until_slow, self.highest) = (SLOW_STRIDE, f32::NAN);
        (self.fast_left, self.slow_left) = (FAST_TAIL, SLOW_TAIL);
        self.note(RecordingState::Running);
    }

    /// Sets the state of the recording from this tick on.
    fn note(&self, recording: RecordingState) {
        self.memory.tick.store(self.now);
        self.memory.set_recording(recording, self.boot);
    }

    /// Logs changes that take effect with a breath.
    fn log_changes(&mut self, moment: &RecorderInput) {
        if self.missed_logged.is_due(self.missed, self.now) {
            self.enter(Happening::Missed { ticks: self.missed });
        }
        if self.mode != Mode::Ventilating {
            return;
        }
        if self.learned.replace(moment.learned) != Some(moment.learned) {
            self.enter(Happening::Controller { learned: moment.learned });
        }
        if self.lesson.is_due(moment.lesson, self.now) {
            self.enter(Happening::Lesson(moment.lesson));
        }
        let settings = Happening::settings(moment.settings);
        if self.settings.is_due(settings, self.now) {
            self.enter(settings);
        }
    }

    #[cold]
    fn clear(&mut self) {
        self.enter(Happening::Cleared);
        self.memory.fast.empty();
        self.memory.slow.empty();
        if self.mode != Mode::Ventilating {
            (self.fast_left, self.slow_left) = (0, 0);
            self.note(RecordingState::Nothing);
        }
        self.memory.clear.store(0);
    }

    fn enter(&self, happening: Happening) {
        let entry = LogEntry { tick: self.now, boot: self.boot, happening };
        let RecorderMemory { log, .. } = self.memory;
        log.push(entry.pack(), 0);
    }
}

fn entry(moment: &RecorderInput) -> TickEntry {
    let Output { command, mode, sample, .. } = moment.output;
    let activity = match mode {
        Mode::Standby => Activity::Standby,
        Mode::Ventilating => Activity::Ventilating,
        Mode::Fault(_) => Activity::Fault,
    };
    TickEntry {
        pressure: moment.reading,
        target: sample.map(|sample| sample.target),
        u_in: command.u_in(),
        u_out: command.u_out(),
        phase: sample.map(|sample| sample.phase),
        explored: sample.is_some_and(|sample| sample.explore != 0.0),
        activity,
        breath: sample.map_or(0, |sample| sample.breath as u8),
    }
}
