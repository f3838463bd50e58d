//! Faults that a bench description schedules: what fails, when, how strongly and how often.
//!
//! ```toml
//! [[faults]]                                  # water in the line of the airway sensor, for a minute and a half
//! from_s = 30
//! to_s = 120
//! what = { sensor = { signal = "airway", distortion = { lag_ms = 50 } } }
//! [[faults]]                                  # a kink in every third breath of three seconds
//! from_s = 60
//! repeats = { for_s = 3, every_s = 9 }
//! what = { part = { tube_narrowed = 8 } }
//! [[faults]]
//! from_s = 45
//! what = { strain = { cmh2o = 100, duration_s = 3 } }
//! ```

use core::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use super::{BenchError, Failure, PEEP_RANGE_CMH2O, check};
use crate::storage::MOST_DELAY_MS;

/// Longest time of a bench, s.
const LONGEST_S: f64 = 1e7;
/// Longest delay of a reading, ms.
const LONGEST_DELAY_MS: f64 = if cfg!(feature = "std") { 10_000.0 } else { MOST_DELAY_MS as f64 };

/// A fault of the bench.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FaultConfig {
    /// Beginning, s.
    pub from_s: f64,
    /// End, s; without it the fault stays.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_s: Option<f64>,
    /// Occurrences between beginning and end; without it the fault is there all the time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeats: Option<Repeats>,
    /// What fails.
    pub what: Faulty,
}

/// Occurrences of a fault that comes and goes, such as an intermittent contact.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Repeats {
    /// Duration of each, s.
    pub for_s: f64,
    /// Time from the beginning of one to that of the next, s.
    pub every_s: f64,
}

/// What fails.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Faulty {
    /// The reading of one or several sensors.
    Sensor {
        /// Which.
        signal: Signal,
        /// What happens to it.
        distortion: Distortion,
    },
    /// A part of the machine.
    Part(Failure),
    /// The pressure of the gas supply swings: the flow falls to a share and returns.
    SupplySwings {
        /// Smallest share of the flow.
        least: f64,
        /// Frequency, Hz.
        hz: f64,
    },
    /// A leak in inspirations only, or in expirations only.
    LeakInPhase {
        /// Whether it leaks in inspirations.
        inspiration: bool,
        /// Flow at 30 cmH2O, L/s.
        l_per_s: f64,
    },
    /// The lung: factors on its resistances and compliances.
    Lung {
        /// Factor on the resistances.
        resistance: f64,
        /// Factor on the compliances.
        compliance: f64,
    },
    /// The patient strains, at the beginning of each occurrence.
    Strain(Strain),
}

/// Which readings a distortion changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Signal {
    /// The pressure at the airway opening.
    Airway,
    /// The pressure at the machine's outlet.
    Outlet,
    /// The flow.
    Flow,
    /// Both pressures: a common cause, such as a wet line.
    Pressures,
    /// All three: the converter.
    Converter,
}

impl Signal {
    /// Whether it contains this single signal.
    pub(crate) fn contains(self, single: Self) -> bool {
        match self {
            Self::Converter => true,
            Self::Pressures => single != Self::Flow,
            signal => signal == single,
        }
    }
}

/// What happens to a reading. Numbers are in the unit of the signal, cmH2O or L/s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Distortion {
    /// Adds a constant.
    Offset(f64),
    /// Multiplies it.
    Gain(f64),
    /// First-order lag with this time constant, ms.
    LagMs(f64),
    /// Delays it by this time, ms.
    DeadTimeMs(f64),
    /// Adds an offset that grows by so much in a second.
    DriftPerS(f64),
    /// Adds white noise of this standard deviation.
    Noise(f64),
    /// Adds a sine.
    Hum {
        /// Its amplitude.
        amplitude: f64,
        /// Its frequency, Hz.
        hz: f64,
    },
    /// Rounds it to a multiple of this step.
    Quantum(f64),
    /// Limits it.
    Saturates {
        /// Lowest reading.
        low: f64,
        /// Highest reading.
        high: f64,
    },
    /// Stands at its last value.
    Freezes,
    /// Stands at any value, with this noise.
    Stands {
        /// The value.
        at: f64,
        /// Standard deviation of the noise.
        noise: f64,
    },
    /// Spikes of this height in a share of the samples.
    Spikes {
        /// Share of the samples.
        share: f64,
        /// Height.
        height: f64,
    },
    /// Is missing in a share of the samples.
    Missing(f64),
}

/// A half sine of muscle pressure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Strain {
    /// Peak, cmH2O: positive presses gas out, as in a strain; negative draws it in, as in a sigh.
    pub cmh2o: f64,
    /// Duration, s.
    pub duration_s: f64,
}

impl FaultConfig {
    /// Its delay of readings, ms, if it delays.
    pub(crate) fn delay_ms(&self) -> Option<f64> {
        match self.what {
            Faulty::Sensor { distortion: Distortion::DeadTimeMs(delay_ms), .. } => Some(delay_ms),
            _ => None,
        }
    }

    pub(super) fn validate(&self, place: usize) -> Result<(), BenchError> {
        let check = |field: &str, value, range| check(format_args!("faults[{place}].{field}"), value, range);
        check("from_s", self.from_s, 0.0..=LONGEST_S)?;
        if let Some(to_s) = self.to_s {
            check("to_s", to_s, 0.0..=LONGEST_S)?;
            if to_s <= self.from_s {
                return Err(BenchError::FaultTimes { place, problem: "ends before it begins: raise to_s" });
            }
        }
        if let Some(Repeats { for_s, every_s }) = self.repeats {
            check("repeats.for_s", for_s, 1e-3..=LONGEST_S)?;
            check("repeats.every_s", every_s, 1e-3..=LONGEST_S)?;
            if every_s <= for_s {
                return Err(BenchError::FaultTimes {
                    place,
                    problem: "recurs before it has ended: raise repeats.every_s",
                });
            }
        }
        self.what
            .numbers()
            .into_iter()
            .flatten()
            .try_for_each(|(name, value, range)| check(name, value, range))
    }
}

/// A number of a fault: its name, its value, and what is allowed.
type Number = (&'static str, f64, RangeInclusive<f64>);
/// The numbers of a fault: at most two.
type Numbers = [Option<Number>; 2];

fn one(name: &'static str, value: f64, range: RangeInclusive<f64>) -> Numbers {
    [Some((name, value, range)), None]
}

impl Faulty {
    fn numbers(&self) -> Numbers {
        match *self {
            Self::Sensor { distortion, .. } => distortion.numbers(),
            Self::Part(failure) => [failure_number(failure), None],
            Self::SupplySwings { least, hz } => [
                Some(("what.supply_swings.least", least, 0.0..=1.0)),
                Some(("what.supply_swings.hz", hz, 0.01..=50.0)),
            ],
            Self::LeakInPhase { l_per_s, .. } => one("what.leak_in_phase.l_per_s", l_per_s, 0.0..=20.0),
            Self::Lung { resistance, compliance } => [
                Some(("what.lung.resistance", resistance, 0.02..=50.0)),
                Some(("what.lung.compliance", compliance, 0.02..=50.0)),
            ],
            Self::Strain(Strain { cmh2o, duration_s }) => [
                Some(("what.strain.cmh2o", cmh2o, -150.0..=150.0)),
                Some(("what.strain.duration_s", duration_s, 0.02..=10.0)),
            ],
        }
    }
}

impl Distortion {
    fn numbers(&self) -> Numbers {
        let far = -1000.0..=1000.0;
        match *self {
            Self::Offset(value) => one("what.sensor.distortion.offset", value, far),
            Self::Gain(value) => one("what.sensor.distortion.gain", value, -10.0..=10.0),
            Self::LagMs(value) => one("what.sensor.distortion.lag_ms", value, 0.0..=10_000.0),
            Self::DeadTimeMs(value) => {
                one("what.sensor.distortion.dead_time_ms", value, 0.0..=LONGEST_DELAY_MS)
            }
            Self::DriftPerS(value) => one("what.sensor.distortion.drift_per_s", value, far),
            Self::Noise(value) => one("what.sensor.distortion.noise", value, 0.0..=1000.0),
            Self::Hum { amplitude, hz } => [
                Some(("what.sensor.distortion.hum.amplitude", amplitude, far)),
                Some(("what.sensor.distortion.hum.hz", hz, 0.01..=500.0)),
            ],
            Self::Quantum(value) => one("what.sensor.distortion.quantum", value, 1e-6..=1000.0),
            Self::Saturates { low, high } => [
                Some(("what.sensor.distortion.saturates.low", low, -1000.0..=high.max(-1000.0))),
                Some(("what.sensor.distortion.saturates.high", high, far)),
            ],
            Self::Freezes => [None, None],
            Self::Stands { at, noise } => [
                Some(("what.sensor.distortion.stands.at", at, far)),
                Some(("what.sensor.distortion.stands.noise", noise, 0.0..=1000.0)),
            ],
            Self::Spikes { share, height } => [
                Some(("what.sensor.distortion.spikes.share", share, 0.0..=1.0)),
                Some(("what.sensor.distortion.spikes.height", height, far)),
            ],
            Self::Missing(share) => one("what.sensor.distortion.missing", share, 0.0..=1.0),
        }
    }
}

/// The number of a failure, if it has one.
fn failure_number(failure: Failure) -> Option<Number> {
    let share = 1e-3..=1.0;
    let percent = 0.0..=100.0;
    Some(match failure {
        Failure::TubeNarrowed(factor) => ("what.part.tube_narrowed", factor, 1.0..=1e4),
        Failure::FilterNarrowed(left) => ("what.part.filter_narrowed", left, share),
        Failure::Leak(flow) => ("what.part.leak", flow, 0.0..=20.0),
        Failure::InspiratoryValveStuck(at) => ("what.part.inspiratory_valve_stuck", at, percent),
        Failure::BothValvesStuck(at) => ("what.part.both_valves_stuck", at, percent),
        Failure::ValveLoose(play) => ("what.part.valve_loose", play, percent),
        Failure::PeepValveStuck(peep) => ("what.part.peep_valve_stuck", peep, PEEP_RANGE_CMH2O),
        Failure::SupplyFalls(left) => ("what.part.supply_falls", left, 0.0..=2.0),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {

    use crate::BenchConfig;

    fn refused(fault: &str) -> String {
        BenchConfig::from_toml(&format!("[[faults]]\n{fault}")).unwrap_err().to_string()
    }

    #[test]
    fn a_description_with_faults_comes_back_from_its_text() {
        let text = include_str!("fault.rs");
        let example: Vec<_> = text
            .lines()
            .skip_while(|line| !line.contains("```toml"))
            .skip(1)
            .take_while(|line| !line.contains("```"))
            .map(|line| line.trim_start_matches("//!"))
            .collect();
        let bench = BenchConfig::from_toml(&example.join("\n")).unwrap();
        assert_eq!(bench.faults.len(), 3);
        assert_eq!(BenchConfig::from_toml(&bench.to_toml()).unwrap(), bench);
        assert!(!BenchConfig::default().to_toml().contains("faults"), "a sound bench reads as before");
    }

    #[test]
    fn what_a_bench_cannot_do_is_refused_by_its_name() {
        let narrowed = "what = { part = { tube_narrowed = 0.5 } }";
        assert!(refused(&format!("from_s = 3\n{narrowed}")).contains("faults[0].what.part.tube_narrowed"));
        assert!(refused(&format!("from_s = -3\n{narrowed}")).contains("faults[0].from_s"));
        let lost = "what = { part = \"supply_lost\" }";
        assert!(refused(&format!("from_s = 3\nto_s = 3\n{lost}")).contains("raise to_s"));
        assert!(
            refused(&format!("from_s = 3\nrepeats = {{ for_s = 2, every_s = 2 }}\n{lost}"))
                .contains("every_s")
        );
        let nan = "what = { sensor = { signal = \"airway\", distortion = { gain = nan } } }";
        assert!(refused(&format!("from_s = 3\n{nan}")).contains("distortion.gain"));
        assert!(refused("from_s = 3\nwhat = { sensor = { signal = \"nose\" } }").contains("nose"));
    }
}
