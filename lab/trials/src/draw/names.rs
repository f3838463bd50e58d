//! What faults are called, and the alarms that name them.

use shared::safety::alarms::Fault;
use shared::settings::Settings;

use super::case::Case;
use plant::bench::{Distortion, Failure, Faulty, Signal};

/// Alarms about one pressure sensor.
const PRESSURE: &[&str] = &[
    "reading-nan",
    "reading-range",
    "reading-jumps",
    "reading-frozen",
    "reading-noisy",
    "sensors-disagree",
    "outlet-sensor-lost",
    "backup-ventilation",
    "no-response",
    "command-capped",
];
/// Alarms that two wrong pressures can raise besides: no third sensor tells what the pressure is.
const PRESSURES: &[&str] =
    &["baseline-high", "baseline-low", "low-pressure", "high-pressure", "disconnection", "occlusion"];
const FLOW: &[&str] = &["flow-sensor-lost"];
/// Alarms about breaths that have become small.
const SMALL: &[&str] = &[
    "ventilation-falls",
    "ventilation-lost",
    "tidal-volume-low",
    "minute-volume-low",
    "apnoea",
    "low-pressure",
    "occlusion",
];
/// Alarms about gas that escapes.
const LEAK: &[&str] = &["disconnection", "leak", "baseline-low", "low-pressure"];
/// Alarms about gas that cannot get out, and about valves.
const VALVE: &[&str] = &[
    "baseline-high",
    "baseline-low",
    "high-pressure",
    "hard-limit",
    "sustained-pressure",
    "no-response",
    "command-capped",
    "backup-ventilation",
];
const CLOCK: &[&str] = &["missed-ticks"];
/// Share of the rise that a breath needs.
const LEAST_RISE: f32 = 0.1;

impl Case {
    /// Names of its faults, without their numbers, in alphabetical order: cases of one class have the same.
    pub fn class(&self) -> String {
        let faults = self.bench.faults.iter().map(|fault| {
            let recurs = if fault.repeats.is_some() { ", now and then" } else { "" };
            format!("{}{recurs}", name(&fault.what))
        });
        let stalls = self.stalls.map(|_| "missed ticks".to_owned());
        let host = self.host.map(|_| "settings that change".to_owned());
        let mut names: Vec<String> = faults.chain(stalls).chain(host).collect();
        names.sort();
        if names.is_empty() { "no fault".to_owned() } else { names.join(" + ") }
    }

    /// Whether an alarm names one of its faults, or a consequence.
    pub fn is_named_by(&self, alarm: Fault) -> bool {
        let id = alarm.alarm().id;
        let of_bench = self.bench.faults.iter().any(|fault| names(&fault.what, id));
        // With a fault in each of them, no third sensor tells what the pressure is.
        let both = [Signal::Airway, Signal::Outlet].into_iter().all(|signal| self.has_fault_of(signal));
        // Without a flow sensor a lost supply looks like an open tube.
        let supply =
            |what: &Faulty| matches!(what, Faulty::Part(Failure::SupplyLost | Failure::SupplyFalls(_)));
        let lost =
            self.bench.faults.iter().any(|fault| supply(&fault.what)) && self.has_fault_of(Signal::Flow);
        of_bench
            || (lost && LEAK.contains(&id))
            || (both && PRESSURES.contains(&id))
            || (self.stalls.is_some() && CLOCK.contains(&alarm.alarm().id))
    }

    /// Whether all pressure sensors read wrong by one cause: then none of them is another's witness.
    pub fn is_of_a_common_cause(&self) -> bool {
        self.has_fault_of(Signal::Pressures) || self.has_fault_of(Signal::Converter)
    }

    fn has_fault_of(&self, sensor: Signal) -> bool {
        let is_of = |what: &Faulty| matches!(what, Faulty::Sensor { signal, .. } if *signal == sensor);
        self.bench.faults.iter().any(|fault| is_of(&fault.what))
    }

    /// Whether a PEEP valve is stuck where no breath is left between it and PIP: less than a tenth of the rise.
    fn is_shut(&self, what: &Faulty) -> bool {
        let Settings { pip, peep, .. } = self.settings;
        let least = f64::from(pip - LEAST_RISE * (pip - peep));
        matches!(what, Faulty::Part(Failure::PeepValveStuck(at)) if *at > least)
    }

    /// Whether a valve or the way out does not obey, so that no command keeps the pressure down.
    pub fn disobeys(&self) -> bool {
        self.bench.faults.iter().any(|fault| {
            matches!(
                fault.what,
                Faulty::Part(
                    Failure::InspiratoryValveStuck(_)
                        | Failure::BothValvesStuck(_)
                        | Failure::ExpiratoryValveClosed
                        | Failure::FilterClogged
                        | Failure::FilterNarrowed(_)
                )
            ) || self.is_shut(&fault.what)
        })
    }
}

/// Whether a fault is one of what the ventilator knows, such as a sensor, not of what it can do.
pub(super) fn is_of_knowledge(what: &Faulty) -> bool {
    matches!(what, Faulty::Sensor { .. })
}

fn names(what: &Faulty, alarm: &str) -> bool {
    let has = |sets: &[&[&str]]| sets.iter().any(|set| set.contains(&alarm));
    match what {
        Faulty::Sensor { signal: Signal::Airway | Signal::Outlet, .. } => has(&[PRESSURE]),
        Faulty::Sensor { signal: Signal::Pressures, .. } => has(&[PRESSURE, PRESSURES]),
        Faulty::Sensor { signal: Signal::Flow, .. } => has(&[FLOW]),
        Faulty::Sensor { signal: Signal::Converter, .. } => has(&[PRESSURE, PRESSURES, FLOW, SMALL]),
        Faulty::Part(failure) => match failure {
            Failure::TubeOccluded | Failure::TubeNarrowed(_) => has(&[SMALL]),
            Failure::Disconnected | Failure::Leak(_) => has(&[LEAK, SMALL]),
            Failure::SupplyLost | Failure::SupplyFalls(_) => has(&[SMALL, VALVE]),
            // Its flow drops more pressure in the tube between the sensors than any command explains.
            Failure::InspiratoryValveStuck(_) | Failure::BothValvesStuck(_) => {
                has(&[VALVE, SMALL, &["sensors-disagree"]])
            }
            _ => has(&[VALVE, SMALL]),
        },
        Faulty::SupplySwings { .. } => has(&[SMALL, VALVE]),
        Faulty::LeakInPhase { .. } => has(&[LEAK, SMALL]),
        Faulty::Lung { .. } => has(&[SMALL, &["baseline-high", "tidal-volume-high", "minute-volume-high"]]),
        Faulty::Strain(_) => {
            // A strain can leave the range of the sensors, which are not used then.
            let reads = &["reading-range", "backup-ventilation"];
            has(&[SMALL, reads, &["high-pressure", "hard-limit", "baseline-high", "baseline-low"]])
        }
    }
}

fn name(what: &Faulty) -> String {
    match what {
        Faulty::Sensor { signal, distortion } => {
            let signal = match signal {
                Signal::Airway => "airway sensor",
                Signal::Outlet => "outlet sensor",
                Signal::Flow => "flow sensor",
                Signal::Pressures => "both pressure sensors",
                Signal::Converter => "converter",
            };
            format!("{signal}: {}", distorted(distortion))
        }
        Faulty::Part(failure) => part(*failure).to_owned(),
        Faulty::SupplySwings { .. } => "supply swings".to_owned(),
        Faulty::LeakInPhase { inspiration: true, .. } => "leak in inspirations".to_owned(),
        Faulty::LeakInPhase { .. } => "leak in expirations".to_owned(),
        Faulty::Lung { resistance, compliance } => {
            let narrow = if *resistance > 1.0 { "narrower" } else { "wider" };
            let stiff = if *compliance < 1.0 { "stiffer" } else { "softer" };
            format!("lung: {narrow}, {stiff}")
        }
        Faulty::Strain(strain) if strain.cmh2o < 0.0 => "sigh".to_owned(),
        Faulty::Strain(_) => "strain".to_owned(),
    }
}

fn distorted(distortion: &Distortion) -> &'static str {
    match distortion {
        Distortion::Offset(offset) if *offset > 0.0 => "offset up",
        Distortion::Offset(_) => "offset down",
        Distortion::Gain(gain) if *gain < 0.0 => "reversed",
        Distortion::Gain(gain) if *gain < 1.0 => "gain too low",
        Distortion::Gain(_) => "gain too high",
        Distortion::LagMs(_) => "lag",
        Distortion::DeadTimeMs(_) => "dead time",
        Distortion::DriftPerS(rate) if *rate > 0.0 => "drift up",
        Distortion::DriftPerS(_) => "drift down",
        Distortion::Noise(_) => "noise",
        Distortion::Hum { .. } => "hum",
        Distortion::Quantum(_) => "quantum",
        Distortion::Saturates { .. } => "saturation",
        Distortion::Freezes => "freeze",
        Distortion::Stands { noise, .. } if *noise > 0.0 => "constant with noise",
        Distortion::Stands { .. } => "constant",
        Distortion::Spikes { .. } => "spikes",
        Distortion::Missing(_) => "missing",
    }
}

fn part(failure: Failure) -> &'static str {
    match failure {
        Failure::TubeOccluded => "tube occluded",
        Failure::TubeNarrowed(_) => "tube narrowed",
        Failure::FilterClogged => "filter clogged",
        Failure::FilterNarrowed(_) => "filter narrowed",
        Failure::Disconnected => "disconnected",
        Failure::Leak(_) => "leak",
        Failure::InspiratoryValveStuck(_) => "inspiratory valve stuck",
        Failure::ValveLoose(_) => "valve loose",
        Failure::BothValvesStuck(_) => "both valves stuck",
        Failure::ExpiratoryValveClosed => "expiratory valve closed",
        Failure::PeepValveStuck(_) => "PEEP valve stuck",
        Failure::SupplyLost => "supply lost",
        Failure::SupplyFalls(_) => "supply falls",
    }
}
