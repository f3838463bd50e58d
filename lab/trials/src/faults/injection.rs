//! Faults, and how they are injected.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

use shared::reset::ResetCause;
use shared::sensor::Readings;
use shared::settings::Settings;
use shared::timing::WATCHDOG_MAX_US;

use plant::bench::Failure;

/// Scale of a sensor's reading on the bus: units per cmH2O, and the pressure of the value zero, cmH2O.
const WORD: (f32, f32) = (600.0, -25.0);
/// Time from the hang of the control task to the reset by the watchdog, ms: the longest of any chip.
const WATCHDOG_MS: u32 = WATCHDOG_MAX_US / 1000;
/// Time without supply in a trial, ms.
pub(super) const POWERLESS_MS: u32 = 10_000;
/// Time from a reset until the control task runs again, ms.
const BOOT_MS: u32 = 300;

/// A fault to inject.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Injection {
    /// The reading stays at its last value.
    StuckAtLast,
    /// The reading stays at one value, cmH2O.
    StuckAt(f32),
    /// The reading stays near one value, cmH2O, with the noise of an intact sensor.
    NoisyAt(f32),
    /// The reading is this number, possibly not a number (NaN).
    Reads(f32),
    /// The reading drifts, cmH2O/s.
    Drift(f32),
    /// The reading has this offset, cmH2O.
    Offset(f32),
    /// The reading of the outlet's pressure sensor has this offset, cmH2O.
    OutletOffset(f32),
    /// The reading gets additional noise of this standard deviation, cmH2O.
    Noise(f32),
    /// This share of the readings is missing.
    Dropped(f32),
    /// The two bytes are swapped in this share of the readings.
    SwappedBytes(f32),
    /// The outlet's pressure sensor gives no number.
    OutletLost,
    /// Neither pressure sensor gives a number.
    BothLost,
    /// The flow sensor gives no number.
    FlowLost,
    /// The flow sensor gives this number, L/s.
    FlowReads(f32),
    /// The same, and a part of the machine fails.
    FlowReadsAndPart(f32, Failure),
    /// Neither pressure sensor gives a number, and the flow sensor gives this one, L/s.
    BothLostAndFlow(f32),
    /// Neither pressure sensor gives a number, and a part of the machine fails.
    BothLostAndPart(Failure),
    /// A part of the machine fails.
    Part(Failure),
    /// The tube is disconnected, and connected again after this time, ms.
    Reconnected(u32),
    /// This number of control ticks per hundred is missed.
    MissedTicks(u32),
    /// The control task hangs until the watchdog resets the chip.
    Hang,
    /// The supply dips, which resets the chip.
    BrownOut,
    /// The supply is away for this time, s. A trial runs only the first 10 s of it.
    PowerCut(u32),
    /// The patient coughs with this peak, cmH2O, in the middle of every inspiration.
    Coughs(f64),
    /// The patient coughs six times in a row with this peak, cmH2O, in every third breath of 3 s.
    CoughTrains(f64),
    /// The lung changes: factors on its resistance and its compliance.
    NewLung(f64, f64),
    /// The operator enters another rate, 1/min, and inspiratory time, s.
    NewTiming(f32, f32),
    /// The host stops sending.
    HostSilent,
    /// Another host connects and sends its own settings and gains.
    OtherHost,
    /// The supply dips, the chip finds its weights damaged, and the host starts it again.
    Weights(Damage),
    /// No injection: the controller itself is hostile from the start.
    Controller,
}

/// Damage to the weights in flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Damage {
    /// One bit of the newer image is flipped; the other slot is empty.
    FlippedBit,
    /// The supply was cut while the newer image was being stored; the older one is intact.
    TornStore,
}

/// The effect of a fault on the readings.
#[derive(Debug)]
pub struct SensorFault {
    injection: Injection,
    rng: ChaCha8Rng,
    last: Option<f32>,
    ms: u32,
}

impl SensorFault {
    /// A fault that starts now.
    pub fn new(injection: Injection, rng: ChaCha8Rng) -> Self {
        Self { injection, rng, last: None, ms: 0 }
    }

    /// The readings that the ventilator gets in place of the true ones.
    pub fn readings(&mut self, readings: Readings) -> Readings {
        let none = f32::NAN;
        match self.injection {
            Injection::OutletLost => Readings { outlet: none, ..readings },
            Injection::OutletOffset(offset) => Readings { outlet: readings.outlet + offset, ..readings },
            Injection::BothLost | Injection::BothLostAndPart(_) => {
                Readings { airway: none, outlet: none, ..readings }
            }
            Injection::BothLostAndFlow(flow) => Readings { airway: none, outlet: none, flow },
            Injection::FlowLost => Readings { flow: none, ..readings },
            Injection::FlowReads(flow) | Injection::FlowReadsAndPart(flow, _) => {
                Readings { flow, ..readings }
            }
            _ => Readings { airway: self.reading(readings.airway), ..readings },
        }
    }

    /// The reading of the airway sensor.
    fn reading(&mut self, reading: f32) -> f32 {
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

/// A reading whose two bytes were swapped in transmission.
fn swapped(reading: f32) -> f32 {
    let word = ((reading - WORD.1) * WORD.0) as u16;
    f32::from(word.swap_bytes()) / WORD.0 + WORD.1
}

/// The effect of a fault on the control task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// It runs.
    Runs,
    /// It misses the tick: the valves keep their state.
    Misses,
    /// The chip is reset at this tick.
    Reset(ResetCause),
    /// The chip starts; the valves are safe.
    Boots,
}

/// Time between two trains of coughs, and between two coughs of a train, ms; coughs of a train.
const TRAIN_MS: (u32, u32) = (9000, 500);
const TRAIN: u32 = 6;

impl Injection {
    /// Whether a cough of a train begins `ms` milliseconds after the first.
    pub fn coughs(ms: u32) -> bool {
        let since = ms % TRAIN_MS.0;
        since.is_multiple_of(TRAIN_MS.1) && since / TRAIN_MS.1 < TRAIN
    }

    /// The settings after it, if these were in force before.
    pub fn settings(self, before: Settings) -> Settings {
        match self {
            Self::NewTiming(rate, inspiratory_time) => Settings { rate, inspiratory_time, ..before },
            _ => before,
        }
    }

    /// The state of the control task `ms` milliseconds after the fault.
    pub fn task(self, ms: u32) -> Task {
        match self {
            Self::MissedTicks(part) if ms % 100 < part => Task::Misses,
            Self::Hang if ms < WATCHDOG_MS => Task::Misses,
            Self::Hang if ms == WATCHDOG_MS => Task::Reset(ResetCause::Watchdog),
            Self::Hang if ms < WATCHDOG_MS + BOOT_MS => Task::Boots,
            Self::BrownOut | Self::Weights(_) if ms == 0 => Task::Reset(ResetCause::BrownOut),
            Self::BrownOut | Self::Weights(_) if ms < BOOT_MS => Task::Boots,
            Self::PowerCut(_) if ms == 0 => Task::Reset(ResetCause::PowerOn),
            Self::PowerCut(_) if ms < POWERLESS_MS + BOOT_MS => Task::Boots,
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
    fn trains_have_six_coughs_in_three_seconds() {
        let coughs: Vec<_> = (0..12_000).filter(|ms| Injection::coughs(*ms)).collect();
        assert_eq!(coughs[..7], [0, 500, 1000, 1500, 2000, 2500, 9000]);
    }

    #[test]
    fn a_hanging_task_is_ended_by_the_watchdog() {
        let tasks =
            [0, WATCHDOG_MS - 1, WATCHDOG_MS, WATCHDOG_MS + 1, 5000].map(|ms| Injection::Hang.task(ms));
        let reset = Task::Reset(ResetCause::Watchdog);
        assert_eq!(tasks, [Task::Misses, Task::Misses, reset, Task::Boots, Task::Runs]);
    }
}
