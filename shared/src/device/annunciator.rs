//! Alarm signals: what a sounder and two lamps do, from the alarms, an operator's acknowledgement and an audio pause.
//!
//! | priority | lamp | sounder | interval between bursts |
//! |---|---|---|---|
//! | high | red, flashing at 2 Hz | 10 pulses of 150 ms: 3 + 2, twice | 4 s |
//! | medium | yellow, flashing at 0.5 Hz | 3 pulses of 200 ms | 8 s |
//! | low | yellow, steady | 2 pulses of 200 ms | 20 s |
//!
//! The lamps show the most urgent alarm that is indicated; the sounder sounds for the most urgent one that nobody has
//! acknowledged. Patterns and rates follow IEC 60601-1-8 as its clauses 6.3.2 and 6.3.3 are remembered, without the standard at
//! hand: check them against it before you claim conformance. What was remembered is in the tests of this file.
//!
//! An audio pause silences the sounder for at most [`AUDIO_PAUSE_MAX`] and leaves the lamps alone. A new alarm ends it if it is
//! of high priority or of a higher one than all paused alarms.

pub use crate::link::messages::AudioStatus;
pub use crate::link::refusal::AUDIO_PAUSE_MAX;
use crate::link::refusal::Refusal;
use crate::safety::alarms::{ALARMS, Priority};
use crate::safety::indications::{FaultSet, Indications};

/// Microseconds in a millisecond.
const MS: u32 = 1_000;
/// Microseconds in a second.
const SECOND: u32 = 1_000_000;

/// Levels of the alarm outputs in a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Signals {
    /// Whether the sounder sounds.
    pub sounder: bool,
    /// Whether the red lamp is lit.
    pub red: bool,
    /// Whether the yellow lamp is lit.
    pub yellow: bool,
}

/// A burst of pulses and the silence after it, all in ms.
struct Burst {
    pulse: u32,
    /// Silence after each pulse but the last one.
    gaps: &'static [u32],
    interval: u32,
}

impl Burst {
    const HIGH: Self =
        Self { pulse: 150, gaps: &[100, 100, 350, 100, 700, 100, 100, 350, 100], interval: 4_000 };
    const MEDIUM: Self = Self { pulse: 200, gaps: &[200, 200], interval: 8_000 };
    const LOW: Self = Self { pulse: 200, gaps: &[200], interval: 20_000 };

    const fn of(priority: Priority) -> &'static Self {
        match priority {
            Priority::High => &Self::HIGH,
            Priority::Medium => &Self::MEDIUM,
            Priority::Low => &Self::LOW,
        }
    }

    /// Whether a pulse sounds at a time since the burst began, us; none if the next burst is due.
    fn sounds(&self, at: u32) -> Option<bool> {
        let mut end = 0;
        for gap in self.gaps.iter().chain([&self.interval]) {
            end += self.pulse * MS;
            if at < end {
                return Some(true);
            }
            end += gap * MS;
            if at < end {
                return Some(false);
            }
        }
        None
    }
}

/// Whether the lamp of a priority is lit at a time since it was switched on, us; none if its period is over.
fn lit(priority: Priority, at: u32) -> Option<bool> {
    let period = match priority {
        Priority::High => SECOND / 2,
        Priority::Medium => 2 * SECOND,
        Priority::Low => return Some(true),
    };
    (at < period).then_some(at < period / 2)
}

/// Bits of the faults with a priority, in the order of [`crate::safety::alarms::Fault`].
const fn bits_of(priority: Priority) -> u32 {
    let (mut bits, mut index) = (0, 0);
    while index < ALARMS.len() {
        if ALARMS[index].priority as u8 == priority as u8 {
            bits |= 1 << index;
        }
        index += 1;
    }
    bits
}

/// The highest priority in a set.
fn highest(faults: FaultSet) -> Option<Priority> {
    const PRIORITIES: [(Priority, u32); 3] = [
        (Priority::High, bits_of(Priority::High)),
        (Priority::Medium, bits_of(Priority::Medium)),
        (Priority::Low, bits_of(Priority::Low)),
    ];
    PRIORITIES.into_iter().find(|(_, bits)| faults.bits() & bits != 0).map(|(priority, _)| priority)
}

/// A signal of a priority, and the time since it began or repeated, us.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Course {
    priority: Option<Priority>,
    at: u32,
}

impl Course {
    /// Runs a tick; `on` gives the level at a time, and none at the end of the signal's period.
    fn step(
        &mut self,
        priority: Option<Priority>,
        period_us: u32,
        on: impl Fn(Priority, u32) -> Option<bool>,
    ) -> bool {
        if self.priority != priority {
            *self = Self { priority, at: 0 };
        }
        let Some(priority) = priority else { return false };
        let level = on(priority, self.at).or_else(|| {
            self.at = 0;
            on(priority, 0)
        });
        self.at += period_us;
        level == Some(true)
    }
}

/// State of the alarm signals; [`Annunciator::step`] runs once per tick. Fulfils: lamps-and-sounder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Annunciator {
    period_us: u32,
    sound: Course,
    lamp: Course,
    /// Alarms that nobody had acknowledged in the last tick.
    unacknowledged: FaultSet,
    /// Rest of the audio pause, us.
    pause: u32,
    signals: Signals,
}

impl Annunciator {
    /// Without an alarm; for a control period in microseconds.
    pub fn new(period_us: u32) -> Self {
        Self {
            period_us,
            sound: Course::default(),
            lamp: Course::default(),
            unacknowledged: FaultSet::default(),
            pause: 0,
            signals: Signals::default(),
        }
    }

    /// Runs a tick with the alarms after it.
    #[inline]
    pub fn step(&mut self, alarms: &Indications) {
        // Usually there is no alarm, and there was none.
        if self.lamp.priority.is_some() || !alarms.indicated().is_empty() {
            self.signal(alarms.indicated(), alarms.unacknowledged());
        }
    }

    #[inline(never)]
    fn signal(&mut self, indicated: FaultSet, unacknowledged: FaultSet) {
        self.end_pause(unacknowledged);
        self.unacknowledged = unacknowledged;
        let audible = highest(unacknowledged).filter(|_| self.pause == 0);
        self.pause = self.pause.saturating_sub(self.period_us);
        let sounder = self.sound.step(audible, self.period_us, |priority, at| Burst::of(priority).sounds(at));
        let shown = highest(indicated);
        let lamp = self.lamp.step(shown, self.period_us, lit);
        let red = lamp && shown == Some(Priority::High);
        self.signals = Signals { sounder, red, yellow: lamp && !red };
        debug_assert!(!sounder || !unacknowledged.is_empty(), "silent once all is acknowledged");
        debug_assert!(self.pause <= u32::from(AUDIO_PAUSE_MAX) * SECOND);
    }

    /// Ends the audio pause if an urgent alarm has begun, or if nothing is left to pause.
    fn end_pause(&mut self, unacknowledged: FaultSet) {
        let new = FaultSet::from_bits(unacknowledged.bits() & !self.unacknowledged.bits());
        let (new, paused) = (highest(new), highest(self.unacknowledged));
        if new == Some(Priority::High) || new > paused || unacknowledged.is_empty() {
            self.pause = 0;
        }
    }

    /// Levels of the outputs in the last tick.
    pub fn signals(&self) -> Signals {
        self.signals
    }

    /// Pauses the sounder for this many seconds, or ends the pause with 0.
    ///
    /// # Errors
    /// [`Refusal::PauseTooLong`]; [`Refusal::NothingSounds`] if every alarm is acknowledged. A running pause then goes on.
    pub fn pause(&mut self, seconds: u16) -> Result<AudioStatus, Refusal> {
        if seconds > AUDIO_PAUSE_MAX {
            return Err(Refusal::PauseTooLong);
        }
        if seconds > 0 && self.unacknowledged.is_empty() {
            return Err(Refusal::NothingSounds);
        }
        self.pause = u32::from(seconds) * SECOND;
        Ok(self.status())
    }

    /// State of the audio signals.
    pub fn status(&self) -> AudioStatus {
        AudioStatus { priority: highest(self.unacknowledged), pause_left: self.pause.div_ceil(SECOND) as u16 }
    }
}

#[cfg(test)]
mod tests;
