//! Runs the faults of a bench description: begins and ends them, and distorts the readings.

use core::f64::consts::TAU;

use rand_chacha::ChaCha8Rng;

use super::Bench;
use crate::config::{Distortion, FaultConfig, Faulty, Signal};
use crate::delay::Delay;
use crate::math::{cos, exp, round, sin};
use crate::random::{self, normal, stream};
use crate::step::STEP_S;
use crate::storage::{List, MOST_FAULTS};

/// `ChaCha` stream of the first distorted signal; each has one of its own.
const FIRST_STREAM: u64 = 16;
/// The signals, each with a distorter of its own.
const SIGNALS: [Signal; 3] = [Signal::Airway, Signal::Outlet, Signal::Flow];

/// Most delay lines on a chip: those of one fault.
const MOST_DELAYS: usize = SIGNALS.len();

/// The faults of a bench and their state.
#[derive(Clone, Debug, Default)]
pub(super) struct Faults {
    scheduled: List<Scheduled, MOST_FAULTS>,
    /// For each fault that delays readings, a line for each signal.
    delays: List<Delay, MOST_DELAYS>,
    /// Last reading of each signal: a distortion that begins continues from it.
    last: [f64; 3],
}

/// A fault and its state.
#[derive(Clone, Debug)]
struct Scheduled {
    config: FaultConfig,
    active: bool,
    distorters: [Distorter; 3],
    memo: Memo,
    /// Place of its first delay line, if it delays.
    delays: usize,
}

impl Faults {
    /// As after [`Self::plan`]. Not inlined: it is built in the caller's place.
    #[inline(never)]
    pub(super) fn new(faults: &[FaultConfig], seed: u64) -> Self {
        let mut planned = Self::default();
        planned.plan(faults, seed);
        planned
    }

    /// Replaces all by faults that have not begun; their random numbers come from `seed`. One after another is built in its place:
    /// all at once would take most of a chip's stack.
    pub(super) fn plan(&mut self, faults: &[FaultConfig], seed: u64) {
        self.scheduled.clear();
        self.delays.clear();
        self.last = [0.0; 3];
        for (place, config) in faults.iter().enumerate() {
            let first = FIRST_STREAM + 3 * place as u64;
            let distorters = core::array::from_fn(|n| Distorter::new(stream(seed, first + n as u64)));
            let delays = self.delays.len();
            self.scheduled.extend([Scheduled {
                config: *config,
                active: false,
                distorters,
                memo: Memo::NONE,
                delays,
            }]);
            if let Some(delay_ms) = config.delay_ms() {
                self.delays.extend(SIGNALS.iter().map(|_| Delay::new(delay_ms)));
            }
        }
    }

    pub(super) fn are_none(&self) -> bool {
        self.scheduled.is_empty()
    }

    /// The reading of a signal at a time, s, after the faults that are present.
    pub(super) fn reading(&mut self, signal: Signal, reading: f32, time_s: f64) -> f32 {
        let place = SIGNALS.iter().position(|single| *single == signal).unwrap_or(0);
        let mut value = f64::from(reading);
        for fault in &mut self.scheduled {
            if let (true, Faulty::Sensor { signal: distorted, distortion }) =
                (fault.active, fault.config.what)
                && distorted.contains(signal)
            {
                let distorter = &mut fault.distorters[place];
                let delay = self.delays.get_mut(fault.delays + place);
                value = distorter.apply(distortion, value, time_s, self.last[place], delay, &mut fault.memo);
            }
        }
        if value.is_finite() {
            self.last[place] = value;
        }
        value as f32
    }
}

/// Whether a fault is present at a time, s.
fn is_present(fault: &FaultConfig, time_s: f64) -> bool {
    let since = time_s - fault.from_s;
    let within = since >= 0.0 && fault.to_s.is_none_or(|to_s| time_s < to_s);
    within && fault.repeats.is_none_or(|repeats| since % repeats.every_s < repeats.for_s)
}

impl Bench {
    /// Begins and ends the faults that are due at this time, s.
    pub(super) fn run_faults(&mut self, time_s: f64, u_out: bool) {
        let mut parts_change = false;
        for place in 0..self.faults.scheduled.len() {
            let fault = &mut self.faults.scheduled[place];
            let (what, present) = (fault.config.what, is_present(&fault.config, time_s));
            if fault.active != present {
                fault.active = present;
                fault.distorters.iter_mut().for_each(Distorter::restart);
                parts_change |= self.change(what, present, time_s);
            }
        }
        if parts_change {
            self.refail();
        }
        for place in 0..self.faults.scheduled.len() {
            let fault = &self.faults.scheduled[place];
            if fault.active {
                self.swing(fault.config.what, time_s, u_out);
            }
        }
    }

    /// Begins or ends a fault that is no distortion; whether it concerns a part, which [`Self::refail`] sets.
    fn change(&mut self, what: Faulty, begins: bool, time_s: f64) -> bool {
        match what {
            Faulty::Lung { resistance, compliance } if begins => {
                self.parts.lung.change(resistance, compliance);
            }
            Faulty::Lung { resistance, compliance } => {
                self.parts.lung.change(1.0 / resistance, 1.0 / compliance);
            }
            Faulty::Strain(strain) if begins => self.parts.patient.strain(strain, time_s),
            Faulty::Strain(_) | Faulty::Sensor { .. } => {}
            Faulty::Part(_) | Faulty::SupplySwings { .. } | Faulty::LeakInPhase { .. } => return true,
        }
        false
    }

    /// Repairs all parts, then makes those fail whose faults are present: one fault may end while another stays.
    fn refail(&mut self) {
        self.restore();
        for place in 0..self.faults.scheduled.len() {
            let fault = &self.faults.scheduled[place];
            if let (true, Faulty::Part(failure)) = (fault.active, fault.config.what) {
                self.fail(failure);
            }
        }
    }

    /// Follows a fault whose strength changes while it is present.
    fn swing(&mut self, what: Faulty, time_s: f64, u_out: bool) {
        match what {
            Faulty::SupplySwings { least, hz } => {
                let fallen = 0.5 - 0.5 * cos(TAU * hz * time_s);
                self.valve.supply(1.0 - (1.0 - least) * fallen);
            }
            Faulty::LeakInPhase { inspiration, l_per_s } if inspiration != u_out => {
                self.parts.circuit.fail(l_per_s);
            }
            Faulty::LeakInPhase { .. } => self.parts.circuit.repair(),
            _ => {}
        }
    }
}

/// The last value of a function that takes long: the signals have it in common, so a chip computes it once for all.
#[derive(Clone, Debug)]
struct Memo {
    of: f64,
    value: f64,
}

impl Memo {
    /// Of nothing yet.
    const NONE: Self = Self { of: f64::NAN, value: f64::NAN };

    fn get(&mut self, of: f64, function: impl FnOnce(f64) -> f64) -> f64 {
        if of.to_bits() != self.of.to_bits() {
            *self = Self { of, value: function(of) };
        }
        self.value
    }
}

/// State of the distortion of one signal.
#[derive(Clone, Debug)]
struct Distorter {
    rng: ChaCha8Rng,
    /// When the distortion began, and the time of its last reading, s; none before its first.
    times: Option<(f64, f64)>,
    /// Output of the lag; the frozen reading.
    kept: f64,
}

impl Distorter {
    fn new(rng: ChaCha8Rng) -> Self {
        Self { rng, times: None, kept: 0.0 }
    }

    fn restart(&mut self) {
        self.times = None;
    }

    /// The reading after this distortion; `last` is the signal's last reading, `delay` the line of a distortion that delays.
    fn apply(
        &mut self,
        distortion: Distortion,
        value: f64,
        time_s: f64,
        last: f64,
        delay: Option<&mut Delay>,
        memo: &mut Memo,
    ) -> f64 {
        let begins = self.times.is_none();
        let (began_s, before_s) = self.times.unwrap_or((time_s, time_s));
        self.times = Some((began_s, time_s));
        if begins {
            self.kept = last;
        }
        match distortion {
            Distortion::Offset(offset) => value + offset,
            Distortion::Gain(gain) => value * gain,
            Distortion::LagMs(lag_ms) => {
                let share = memo.get(time_s - before_s, |since_s| 1.0 - exp(-since_s / (1e-3 * lag_ms)));
                // The first reading, and any without a lag.
                self.kept += if share.is_nan() { 0.0 } else { share } * (value - self.kept);
                self.kept
            }
            Distortion::DeadTimeMs(_) => delay.map_or(value, |delay| {
                if begins {
                    delay.fill(last as f32, time_s - STEP_S);
                }
                f64::from(delay.pass(value as f32, time_s))
            }),
            Distortion::DriftPerS(rate) => value + rate * (time_s - began_s),
            Distortion::Noise(sd) => value + sd * normal(&mut self.rng),
            Distortion::Hum { amplitude, hz } => {
                value + amplitude * memo.get(time_s, |time_s| sin(TAU * hz * time_s))
            }
            Distortion::Quantum(quantum) => quantum * round(value / quantum),
            Distortion::Saturates { low, high } => value.clamp(low, high),
            Distortion::Freezes => self.kept,
            Distortion::Stands { at, noise } => at + noise * normal(&mut self.rng),
            Distortion::Spikes { share, height } if random::share(&mut self.rng) < share => value + height,
            Distortion::Missing(share) if random::share(&mut self.rng) < share => f64::NAN,
            Distortion::Spikes { .. } | Distortion::Missing(_) => value,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::BIAS;
    use crate::{BenchConfig, Failure};

    fn bench(faults: &str) -> Bench {
        let config =
            BenchConfig::from_toml(&format!("{faults}\n[sensor]\nnoise_sd_cmh2o = 0\nquantum_cmh2o = 0"));
        Bench::new(&config.unwrap(), 5.0, 1).unwrap()
    }

    /// Readings of all three signals of a bench in slow breaths of 400 ms.
    fn readings(faults: &str, ms: u32) -> Vec<[f32; 3]> {
        let mut bench = bench(faults);
        let step = |n: u32| {
            let airway = bench.step(if n % 400 < 200 { 20.0 } else { 0.0 }, n % 400 >= 200);
            [airway, bench.outlet_reading(), bench.flow_reading()]
        };
        (0..ms).map(step).collect()
    }

    fn sensor(signal: &str, distortion: &str) -> String {
        let what = format!("what = {{ sensor = {{ signal = \"{signal}\", distortion = {distortion} }} }}");
        format!("[[faults]]\nfrom_s = 0.5\nto_s = 1.0\n{what}")
    }

    #[test]
    fn a_distortion_changes_its_signal_for_its_time() {
        let sound = readings("", 1500);
        for (signal, changed) in
            [("airway", [true, false, false]), ("pressures", [true, true, false]), ("converter", [true; 3])]
        {
            let found = readings(&sensor(signal, "{ offset = 3 }"), 1500);
            for place in 0..3 {
                let differs = |ms: usize| (found[ms][place] - sound[ms][place] - 3.0).abs() < 1e-4;
                assert_eq!(differs(500) && differs(999), changed[place], "{signal} {place}");
                assert_eq!(found[499][place].to_bits(), sound[499][place].to_bits());
                assert_eq!(found[1001][place].to_bits(), sound[1001][place].to_bits());
            }
        }
    }

    #[test]
    fn every_distortion_does_what_its_name_says() {
        let sound = readings("", 1000);
        let of = |distortion: &str| readings(&sensor("airway", distortion), 1000);
        let at = |found: &[[f32; 3]], ms: usize| f64::from(found[ms][0]);
        let true_at = |ms: usize| at(&sound, ms);
        assert!((at(&of("{ gain = 0.5 }"), 700) - 0.5 * true_at(700)).abs() < 1e-4);
        assert!((at(&of("{ drift_per_s = -2 }"), 800) - (true_at(800) - 0.6)).abs() < 0.01);
        assert!((at(&of("{ dead_time_ms = 100 }"), 900) - true_at(800)).abs() < 1e-4);
        let lagged = of("{ lag_ms = 50 }");
        // Behind a rising pressure, and above a falling one.
        assert!(at(&lagged, 850) < true_at(850) - 0.3 && at(&lagged, 650) > true_at(650) + 0.3);
        let frozen = of("\"freezes\"");
        assert!((500..1000).all(|ms| frozen[ms][0].to_bits() == frozen[499][0].to_bits()));
        let stands = of("{ stands = { at = 12, noise = 0.1 } }");
        assert!((500..1000).all(|ms| (at(&stands, ms) - 12.0).abs() < 0.6));
        assert!(stands[600][0].to_bits() != stands[601][0].to_bits());
        assert!((at(&of("{ saturates = { low = 0, high = 6 } }"), 600) - 6.0).abs() < 1e-6);
        assert!((at(&of("{ quantum = 4 }"), 600) / 4.0).fract().abs() < 1e-6);
        let counted = |found: &[[f32; 3]], odd: fn(f32, f32) -> bool| {
            (500..1000).filter(|ms| odd(found[*ms][0], sound[*ms][0])).count()
        };
        let missing = counted(&of("{ missing = 0.3 }"), |reading, _| reading.is_nan());
        let spikes =
            counted(&of("{ spikes = { share = 0.3, height = 9 } }"), |reading, sound| reading > sound + 8.0);
        assert!((110..190).contains(&missing) && (110..190).contains(&spikes), "{missing} {spikes}");
        let hum = of("{ hum = { amplitude = 2, hz = 50 } }");
        let noise = of("{ noise = 2 }");
        for found in [hum, noise] {
            let off = (500..1000).map(|ms| at(&found, ms) - true_at(ms));
            let square = off.map(|off| off * off).sum::<f64>() / 500.0;
            assert!((1.0..6.0).contains(&square), "{square}");
        }
    }

    #[test]
    fn a_fault_comes_and_goes_and_others_stay() {
        let occluded = "[[faults]]\nfrom_s = 0\nrepeats = { for_s = 0.1, every_s = 0.3 }\n\
                        what = { part = \"tube_occluded\" }";
        let lost = "[[faults]]\nfrom_s = 0.25\nwhat = { part = \"supply_lost\" }";
        let flow = |faults: &str| -> Vec<f64> {
            let mut bench = bench(faults);
            let mut step = || {
                bench.step(40.0, true);
                bench.truth().flow_lung
            };
            (0..1000).map(|_| step()).collect()
        };
        let found = flow(occluded);
        assert!(found[350].abs() < 1e-3 && found[250].abs() > 1e-3 && found[650].abs() < 1e-3);
        let mut both = bench(&format!("{occluded}\n{lost}"));
        for _ in 0..900 {
            both.step(60.0, false);
        }
        assert!(both.truth().flow_valve.abs() < 1e-9, "the supply is still lost");
    }

    #[test]
    fn supply_leak_lung_and_patient_follow_their_faults() {
        let run = |faults: &str, u_out: bool| {
            let mut bench = bench(&format!("[[faults]]\nfrom_s = 0\n{faults}"));
            for _ in 0..500 {
                bench.step(40.0, u_out);
            }
            bench.truth()
        };
        let swings = run("what = { supply_swings = { least = 0.2, hz = 1 } }", false);
        assert!(swings.flow_valve < 0.3 * run("what = { part = { supply_falls = 1 } }", false).flow_valve);
        let leaks =
            |u_out| run("what = { leak_in_phase = { inspiration = true, l_per_s = 2 } }", u_out).flow_leak;
        assert!(leaks(false) > 0.5 && leaks(true) < 0.1);
        let soft = run("what = { lung = { resistance = 1, compliance = 3 } }", false).airway_pressure;
        assert!(
            soft < run("what = { lung = { resistance = 1, compliance = 1 } }", false).airway_pressure - 3.0
        );
        let strain = run("what = { strain = { cmh2o = 80, duration_s = 1 } }", true);
        assert!((strain.muscle_pressure + 80.0).abs() < 1.0);
        let sigh = run("what = { strain = { cmh2o = -30, duration_s = 1 } }", true);
        assert!((sigh.muscle_pressure - 30.0).abs() < 1.0);
    }

    #[test]
    fn a_restarted_bench_is_a_new_one_bit_for_bit() {
        let described = |distortion: &str| {
            let patient = "[patient]\neffort_cmh2o = 6\neffort_variability_percent = 20\n";
            let fault = sensor("airway", distortion);
            BenchConfig::from_toml(&format!("{patient}{fault}\n{fault}\n{}", sensor("flow", "{ noise = 1 }")))
                .unwrap()
        };
        let run = |mut bench: Bench| -> Vec<[u32; 3]> {
            let step = |ms: u32| {
                let airway = bench.step(30.0, ms % 300 >= 100);
                [airway, bench.outlet_reading(), bench.flow_reading()].map(f32::to_bits)
            };
            (0..1500).map(step).collect()
        };
        let (first, then) = (described("{ dead_time_ms = 30 }"), described("{ dead_time_ms = 20 }"));
        let mut bench = Bench::new(&first, 5.0, 1).unwrap();
        for _ in 0..700 {
            bench.step(60.0, false);
        }
        bench.fail(Failure::SupplyLost);
        let as_it_was = run(bench.clone());
        assert!(bench.restart(&then, 99.0, 2).is_err());
        assert_eq!(run(bench.clone()), as_it_was, "no PEEP of a bench");
        bench.restart(&then, 8.0, 2).unwrap();
        assert_eq!(run(bench), run(Bench::new(&then, 8.0, 2).unwrap()));
    }

    #[test]
    fn a_lung_that_recovers_is_the_one_before() {
        let mut changed = bench(
            "[[faults]]\nfrom_s = 0\nto_s = 0.3\nwhat = { lung = { resistance = 4, compliance = 0.5 } }",
        );
        let mut sound = bench("");
        for _ in 0..20_000 {
            changed.step(BIAS, true);
            sound.step(BIAS, true);
        }
        assert!((changed.truth().lung_volume_ml - sound.truth().lung_volume_ml).abs() < 0.1);
        changed.fail(Failure::SupplyLost);
        changed.step(50.0, false);
        assert!(changed.truth().flow_valve.abs() < 1e-9, "what a caller makes fail stays failed");
    }
}
