//! What can go wrong, and how it is brought about.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

use shared::reset::ResetCause;
use shared::timing::WATCHDOG_MAX_US;

use plant::bench::Failure;

/// Units of the word in which a sensor's reading travels, per cmH2O, and the pressure of the word zero, cmH2O.
const WORD: (f32, f32) = (600.0, -25.0);
/// Time from the hang of the control task to the reset by the watchdog, ms: the longest of any chip.
const WATCHDOG_MS: u32 = WATCHDOG_MAX_US / 1000;
/// A host takes so long to start the device again after a reset, ms.
pub(super) const RESTART_MS: u32 = 500;

/// A fault.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Injection {
    /// The reading stays at its last value.
    StuckAtLast,
    /// The reading stays at one value, cmH2O.
    StuckAt(f32),
    /// The reading stays about one value, cmH2O, with the noise of a sound sensor.
    NoisyAt(f32),
    /// The reading is this number, which may be none.
    Reads(f32),
    /// The reading drifts, cmH2O/s.
    Drift(f32),
    /// The reading is off by so much, cmH2O.
    Offset(f32),
    /// The reading gets noise of this standard deviation in addition, cmH2O.
    Noise(f32),
    /// This part of the readings is missing.
    Dropped(f32),
    /// The two bytes of this part of the readings are swapped.
    SwappedBytes(f32),
    /// A part of the machine fails.
    Part(Failure),
    /// So many control ticks in each hundred are missed.
    MissedTicks(u32),
    /// The control task hangs until the watchdog resets the chip.
    Hang,
    /// The supply dips, which resets the chip.
    BrownOut,
    /// The patient coughs with this peak, cmH2O, in the middle of every inspiration.
    Coughs(f64),
    /// The host falls silent.
    HostSilent,
    /// Another host comes and sends its own settings and gains.
    OtherHost,
    /// The supply dips, the chip finds its weights like this, and the host starts it again.
    Weights(Damage),
    /// Nothing: the controller itself is hostile from the start.
    Controller,
}

/// What has become of the weights in flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Damage {
    /// A bit of the newer image is flipped; the slot of the older one is empty.
    FlippedBit,
    /// The supply was cut while the newer image was stored; the older one is whole.
    TornStore,
}

/// What a fault does to the readings.
#[derive(Debug)]
pub struct SensorFault {
    injection: Injection,
    rng: ChaCha8Rng,
    last: Option<f32>,
    ms: u32,
}

impl SensorFault {
    /// From now on.
    pub fn new(injection: Injection, rng: ChaCha8Rng) -> Self {
        Self { injection, rng, last: None, ms: 0 }
    }

    /// What the ventilator gets to read in place of a reading.
    pub fn reading(&mut self, reading: f32) -> f32 {
        self.ms += 1;
        let last = *self.last.get_or_insert(reading);
        let mut normal = || self.rng.sample::<f32, _>(StandardNormal);
        match self.injection {
            Injection::StuckAtLast => last,
            Injection::StuckAt(value) | Injection::Reads(value) => value,
            Injection::NoisyAt(value) => value + 0.1 * normal(),
            Injection::Drift(rate) => reading + rate * 1e-3 * self.ms as f32,
            Injection::Offset(offset) => reading + offset,
            Injection::Noise(sd) => reading + sd * normal(),
            Injection::Dropped(part) if self.rng.random::<f32>() < part => f32::NAN,
            Injection::SwappedBytes(part) if self.rng.random::<f32>() < part => swapped(reading),
            _ => reading,
        }
    }
}

/// A reading whose two bytes were swapped on the way.
fn swapped(reading: f32) -> f32 {
    let word = ((reading - WORD.1) * WORD.0) as u16;
    f32::from(word.swap_bytes()) / WORD.0 + WORD.1
}

/// What a fault does to the control task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// It runs.
    Runs,
    /// It misses the tick: the valves stay as they were.
    Misses,
    /// The chip is reset at this tick.
    Reset(ResetCause),
}

impl Injection {
    /// What the control task does so many ms after the fault.
    pub fn task(self, ms: u32) -> Task {
        match self {
            Self::MissedTicks(part) if ms % 100 < part => Task::Misses,
            Self::Hang if ms < WATCHDOG_MS => Task::Misses,
            Self::Hang if ms == WATCHDOG_MS => Task::Reset(ResetCause::Watchdog),
            Self::BrownOut | Self::Weights(_) if ms == 0 => Task::Reset(ResetCause::BrownOut),
            _ => Task::Runs,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    fn readings(injection: Injection) -> Vec<f32> {
        let mut fault = SensorFault::new(injection, ChaCha8Rng::seed_from_u64(1));
        (0..1000).map(|n| fault.reading(20.0 + 0.01 * n as f32)).collect()
    }

    #[test]
    fn readings_go_wrong_as_named() {
        assert!(readings(Injection::StuckAtLast).iter().all(|p| p.to_bits() == 20.0_f32.to_bits()));
        assert!((readings(Injection::Drift(-2.0))[999] - (29.99 - 2.0)).abs() < 1e-3);
        let missing = readings(Injection::Dropped(0.3)).iter().filter(|p| p.is_nan()).count();
        assert!((250..350).contains(&missing), "{missing}");
        assert!((swapped(swapped(17.0)) - 17.0).abs() < 0.01 && (swapped(17.0) - 17.0).abs() > 5.0);
    }

    #[test]
    fn a_hanging_task_is_ended_by_the_watchdog() {
        let tasks = [0, WATCHDOG_MS - 1, WATCHDOG_MS, 5000].map(|ms| Injection::Hang.task(ms));
        assert_eq!(tasks, [Task::Misses, Task::Misses, Task::Reset(ResetCause::Watchdog), Task::Runs]);
    }
}
