//! The measurement on an exactly known loop, and on benches.

use std::f64::consts::{PI, TAU};

use num_complex::Complex64;
use rayon::ThreadPoolBuilder;
use shared::breath::{DEFAULT_PERIOD_US, paper_settings};
use shared::control::Observation;
use shared::control::features::FeatureSpec;
use shared::control::network::Network;
use shared::control::pid::{Pid, PidGains};
use shared::control::residual::{Residual, ResidualSpec};

use super::response::Process;
use super::*;
use crate::connected::{Agreement, Pair};
use tuning::interval::{Finding, Sure};
use tuning::measurement::Plan;
use tuning::response::ResponsePoint;

const PERIOD_S: f64 = 1e-3;

/// First-order lag behind a dead time, in whole ticks: exact at the ticks.
#[derive(Clone, Debug)]
struct LagPlant {
    /// cmH2O per percent.
    gain: f64,
    /// Share of the old value after a tick.
    keep: f64,
    pressure: f64,
    /// Commands under way, the next one last.
    under_way: Vec<f64>,
}

impl LagPlant {
    fn new(gain: f64, lag_s: f64, dead_time_ticks: usize) -> Self {
        let keep = (-PERIOD_S / lag_s).exp();
        Self { gain, keep, pressure: 0.0, under_way: vec![0.0; dead_time_ticks] }
    }

    /// Its response to the command at a frequency.
    fn at(&self, hz: f64) -> Complex64 {
        let tick = |ticks: f64| Complex64::cis(-TAU * hz * PERIOD_S * ticks);
        let late = tick(1.0 + self.under_way.len() as f64);
        late * (self.gain * (1.0 - self.keep)) / (Complex64::ONE - tick(1.0) * self.keep)
    }
}

impl Process for LagPlant {
    fn step(&mut self, command: f32) -> f32 {
        self.under_way.insert(0, f64::from(command));
        let due = self.under_way.pop().unwrap();
        self.pressure = self.keep * self.pressure + (1.0 - self.keep) * self.gain * due;
        self.pressure as f32
    }
}

fn pid(p: f32, i: f32, d: f32) -> Pid {
    Pid::new(PidGains { p, i, d }, DEFAULT_PERIOD_US).unwrap()
}

/// Loop gain of a PID on the lag, by formula.
fn loop_gain(plant: &LagPlant, pid: &Pid, hz: f64) -> Complex64 {
    residual_gain::pid(pid, Complex64::cis(-TAU * hz * PERIOD_S)) * plant.at(hz)
}

/// Margins by formula: bisection and a fine grid of frequencies.
fn by_formula(plant: &LagPlant, pid: &Pid) -> Margins {
    let grid: Vec<f64> = (0..200_000).map(|n| 0.5 * 80.0_f64.powf(f64::from(n) / 200_000.0)).collect();
    let sensitivity = |hz: f64| Complex64::ONE / (Complex64::ONE + loop_gain(plant, pid, hz));
    let at = |hz: f64| loop_gain(plant, pid, hz);
    let crossover = grid.iter().copied().rfind(|hz| at(*hz).norm() >= 1.0).unwrap();
    let opposite = grid.windows(2).find(|pair| at(pair[0]).im < 0.0 && at(pair[1]).im >= 0.0).unwrap()[0];
    let margin = PI + at(crossover).arg();
    let (ms_hz, ms) = grid
        .iter()
        .map(|hz| (*hz, sensitivity(*hz).norm()))
        .max_by(|one, other| one.1.total_cmp(&other.1))
        .unwrap();
    let disk = grid.iter().map(|hz| (sensitivity(*hz) - Complex64::from(0.5)).norm()).fold(0.0, f64::max);
    Margins {
        ms,
        ms_hz,
        gain_margin: Some(1.0 / at(opposite).norm()),
        phase_margin_deg: Some(margin.to_degrees()),
        delay_margin_ms: Some(1e3 * margin / (TAU * crossover)),
        disk_margin: 1.0 / disk,
        crossover_hz: Some(crossover),
        opposite_hz: Some(opposite),
    }
}

#[track_caller]
fn within_2_percent(found: &Margins, exact: &Margins) {
    let both = |value: fn(&Margins) -> f64| (value(found), value(exact));
    for (name, (found, exact)) in [
        ("ms", both(|m| m.ms)),
        ("gain", both(|m| m.gain_margin.unwrap())),
        ("phase", both(|m| m.phase_margin_deg.unwrap())),
        ("delay", both(|m| m.delay_margin_ms.unwrap())),
        ("disk", both(|m| m.disk_margin)),
        ("crossover", both(|m| m.crossover_hz.unwrap())),
        ("opposite", both(|m| m.opposite_hz.unwrap())),
    ] {
        assert!((found / exact - 1.0).abs() < 0.02, "{name}: {found}, not {exact}");
    }
}

fn measured<P: Process>(
    law: &impl ControlLaw<State: Clone>,
    plant: P,
    sweep: &Sweep,
) -> (Vec<ResponsePoint>, f64) {
    let seen = Observation { pressure: 0.0, target: 20.0, pip: 20.0, peep: 0.0, tick: 0, rise_ticks: 0 };
    let control = Loop { law, seen, period_us: DEFAULT_PERIOD_US, held_tick: 500 };
    let (rest, sd) = control.settle(plant, 5.0);
    assert!(sd < 0.01, "{sd}");
    control.response(&rest, sweep)
}

#[test]
fn margins_of_an_exactly_known_loop_are_within_2_percent() {
    for (p, i, d, dead_time) in [(2.0, 25.0, 0.0, 40), (3.0, 20.0, 0.0, 25), (2.5, 25.0, 0.05, 30)] {
        let (plant, pid) = (LagPlant::new(0.5, 0.1, dead_time), pid(p, i, d));
        let (response, limited) = measured(&Controller::Pid(pid), plant.clone(), &Sweep::default());
        within_2_percent(&Margins::of(&response).unwrap(), &by_formula(&plant, &pid));
        assert!(limited < 1e-12);
        for point in &response {
            let exact = loop_gain(&plant, &pid, point.hz);
            assert!((point.loop_gain - exact).norm() < 2e-3 * exact.norm(), "{point:?}, not {exact:?}");
            let path = plant.at(point.hz) * point.sensitivity();
            assert!((point.path - path).norm() < 5e-3 * path.norm(), "{point:?}, not {path:?}");
        }
    }
}

#[test]
fn a_delay_as_long_as_the_margin_makes_the_known_loop_oscillate() {
    let pid = pid(2.0, 25.0, 0.0);
    let margin = by_formula(&LagPlant::new(0.5, 0.1, 40), &pid).delay_margin_ms.unwrap();
    let law = Controller::Pid(pid);
    let seen = Observation { pressure: 0.0, target: 20.0, pip: 20.0, peep: 0.0, tick: 0, rise_ticks: 0 };
    let control = Loop { law: &law, seen, period_us: DEFAULT_PERIOD_US, held_tick: 500 };
    let rest_sd = |more: f64| control.settle(LagPlant::new(0.5, 0.1, 40 + more as usize), 20.0).1;
    assert!(rest_sd(0.7 * margin) < 0.3);
    assert!(rest_sd(1.3 * margin) > 3.0);
}

#[test]
fn a_sine_at_the_valves_limit_is_reported() {
    // 20 cmH2O need 40 percent: a sine of more than that reaches zero.
    let plant = LagPlant::new(0.5, 0.1, 10);
    let sweep = Sweep { frequencies: 2, ..Sweep::default() };
    let limited = |amplitude| {
        measured(&Controller::Pid(pid(0.5, 10.0, 0.0)), plant.clone(), &sweep.with_amplitude(amplitude)).1
    };
    assert!(limited(30.0) < 1e-12, "{}", limited(30.0));
    assert!(limited(60.0) > 0.05, "{}", limited(60.0));
}

/// A residual of one input with this weight, over a PID.
fn residual(place: usize, weight: f32) -> Residual {
    let mut network = Network::zero();
    network.hidden_1.weights[place][0] = 1e-3;
    network.hidden_2.weights[0][0] = 1.0;
    network.output.weights[0][0] = 1e3 * weight;
    let spec = ResidualSpec {
        period_us: DEFAULT_PERIOD_US,
        gains: PidGains { p: 3.0, i: 30.0, d: 0.0 },
        lambda: 1.0,
        authority: 100.0,
        features: FeatureSpec::default(),
    };
    Residual::new(spec, network).unwrap()
}

#[test]
fn a_residual_that_is_a_gain_on_the_error_measures_as_a_larger_proportional_gain() {
    // 0.1 of the scaled error: 10 % per 10 cmH2O.
    let law = Controller::Residual(residual(0, 0.1));
    let plant = LagPlant::new(0.5, 0.1, 30);
    let (response, _) = measured(&law, plant.clone(), &Sweep::default());
    within_2_percent(&Margins::of(&response).unwrap(), &by_formula(&plant, &pid(4.0, 30.0, 0.0)));
}

fn question() -> Question {
    Question { prescriptions: None, period_us: DEFAULT_PERIOD_US, sweep: Sweep::default(), seed: 1 }
}

fn default_lung(pip: f32) -> MeasuredPoint {
    let plant = BenchConfig::default();
    let point = OperatingPoint::new(&plant, &paper_settings(pip)).unwrap();
    measure_point(&plant, point, &Controller::Pid(pid(6.0, 290.0, 0.21)), &question()).unwrap()
}

/// The known PID, best on the nine lungs, is fast and close to its limits.
#[test]
fn the_margins_of_a_known_pid_on_the_default_lung_are_these() {
    for (pip, ms, gain, delay_ms, crossover_hz) in
        [(10.0, 2.87, 1.57, 19.9, 5.3), (20.0, 3.79, 1.40, 14.9, 6.4), (35.0, 5.22, 1.26, 9.4, 8.1)]
    {
        let measured = default_lung(pip);
        let margins = measured.margins.unwrap();
        for (name, found, known) in [
            ("Ms", margins.ms, ms),
            ("gain margin", margins.gain_margin.unwrap(), gain),
            ("delay margin", margins.delay_margin_ms.unwrap(), delay_ms),
            ("crossover", margins.crossover_hz.unwrap(), crossover_hz),
        ] {
            assert!((found / known - 1.0).abs() < 0.05, "PIP {pip}, {name}: {found}, not {known}");
        }
        assert!(measured.limited < 0.03 && measured.rest_sd_cmh2o < 0.5, "{measured:?}");
    }
}

#[test]
fn a_delay_as_long_as_the_measured_margin_makes_the_bench_oscillate() {
    let law = Controller::Pid(pid(6.0, 290.0, 0.21));
    let rest_sd = |more_ms: f64| {
        let mut plant = BenchConfig::default();
        let point = OperatingPoint::new(&plant, &paper_settings(35.0)).unwrap();
        plant.valve.dead_time_ms += more_ms;
        let held = point.bench(&plant, DEFAULT_PERIOD_US, 1).unwrap();
        let control =
            Loop { law: &law, seen: point.observation(), period_us: DEFAULT_PERIOD_US, held_tick: 500 };
        control.settle(held, SETTLE_S).1
    };
    let margin = default_lung(35.0).margins.unwrap().delay_margin_ms.unwrap();
    let (below, above) = (rest_sd(0.7 * margin), rest_sd(1.3 * margin));
    assert!(below < OSCILLATES_CMH2O && above > 2.0 * OSCILLATES_CMH2O, "{below} {above}");
}

#[test]
fn a_loop_that_oscillates_by_itself_has_no_margins() {
    let plant = BenchConfig::default();
    let point = OperatingPoint::new(&plant, &paper_settings(20.0)).unwrap();
    let question = Question { sweep: Sweep { frequencies: 2, ..Sweep::default() }, ..question() };
    let measured = measure_point(&plant, point, &Controller::Pid(pid(30.0, 300.0, 0.0)), &question).unwrap();
    assert!(measured.rest_sd_cmh2o > OSCILLATES_CMH2O);
    assert_eq!((measured.margins, measured.doubled), (None, None));
    assert_eq!(worst(std::slice::from_ref(&measured)), None);
}

/// A quick measurement of two plants.
fn quick(controller: &Controller, seed: u64) -> Vec<PlantMargins> {
    let sweep = Sweep { frequencies: 4, window_s: 0.5, ..Sweep::default() };
    let plants = [BenchConfig::paper(20.0, 20.0), BenchConfig::paper(5.0, 50.0)];
    let residual = match controller {
        Controller::Residual(residual) => Some(residual),
        Controller::Pid(_) => None,
    };
    measure(&plants, controller, residual, &Question { sweep, seed, ..question() }, &Progress::silent())
        .unwrap()
}

#[test]
fn plants_are_measured_in_order_whatever_the_number_of_threads() {
    let law = Controller::Pid(pid(3.0, 30.0, 0.0));
    let with = |threads, seed| {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| quick(&law, seed))
    };
    let alone = with(1, 1);
    assert_eq!(alone, with(2, 1));
    assert_ne!(alone, with(1, 2));
    assert_eq!(alone.iter().map(|plant| plant.plant.as_str()).collect::<Vec<_>>(), ["R20C20", "R5C50"]);
    assert!(alone.iter().all(|plant| plant.points.len() == 6 && plant.pid.is_none()));
    let highest = alone[0].points.iter().map(|point| point.margins.unwrap().ms).fold(0.0, f64::max);
    assert!((alone[0].worst.unwrap().ms - highest).abs() < 1e-12);
}

#[test]
fn the_residual_of_a_learned_controller_is_measured_beside_its_pid() {
    let measured = quick(&Controller::Residual(residual(0, 0.1)), 1);
    let pids = quick(&Controller::Pid(pid(3.0, 30.0, 0.0)), 1);
    for (learned, alone) in measured.iter().zip(&pids) {
        let pid = learned.pid.as_ref().unwrap();
        assert_eq!((&pid.points, pid.worst), (&alone.points, alone.worst));
        // 10 % per 10 cmH2O of the present error, at any frequency.
        let gain = pid.residual;
        assert!((gain.residual.value - 1.0).abs() < 0.02, "{gain:?}");
        assert!((gain.direct.value - 1.0).abs() < 0.02, "{gain:?}");
        let path = alone
            .points
            .iter()
            .flat_map(|point| &point.response)
            .map(|at| at.path.norm())
            .fold(0.0, f64::max);
        assert!((gain.times_loop.value / (gain.residual.value * path) - 1.0).abs() < 0.02, "{gain:?}");
    }
}

#[test]
fn a_stopped_measurement_gives_the_plants_that_are_done() {
    let stop = std::sync::atomic::AtomicBool::new(true);
    let law = Controller::Pid(pid(3.0, 30.0, 0.0));
    let none = measure(&[BenchConfig::default()], &law, None, &question(), &Progress::quiet(&stop)).unwrap();
    assert!(none.is_empty());
}

/// The whole comparison is `lab margins-in-breaths`.
#[test]
fn margins_measured_in_breaths_are_the_exact_ones_or_not_stated() {
    let family = plant::bench::family::Family::find("adult").unwrap();
    let plants = [BenchConfig::paper(20.0, 20.0), BenchConfig::paper(5.0, 20.0), family.draw(1, 1)];
    let law = Controller::Pid(pid(4.0, 120.0, 0.1));
    let compared =
        connected::compare(&plants, &law, DEFAULT_PERIOD_US, &Plan::default(), &Progress::silent()).unwrap();
    assert_eq!(compared.len(), 3);
    let mut stated = 0;
    for one in &compared {
        for (name, pair) in one.pairs() {
            assert_ne!(pair.agreement(), Agreement::Differs, "{}, {name}: {pair:?}", one.plant);
            stated += usize::from(pair.found.sure().is_some());
        }
    }
    assert!(stated >= 6, "{stated} of 9");
}

#[test]
fn a_measured_margin_agrees_within_a_tenth_or_where_both_lie_outside() {
    let found = |value| Finding::Found(Sure { value, low: value, high: Some(value) });
    let pair = |found, exact, outside| Pair { found, exact, outside }.agreement();
    assert_eq!(pair(found(2.19), Some(2.0), false), Agreement::Agrees);
    assert_eq!(pair(found(2.21), Some(2.0), false), Agreement::Differs);
    assert_eq!(pair(found(f64::NAN), Some(2.0), false), Agreement::Differs);
    assert_eq!(pair(found(2.0), None, true), Agreement::Differs);
    assert_eq!(pair(Finding::OutsideFrequencies, Some(200.0), true), Agreement::Agrees);
    assert_eq!(pair(Finding::OutsideFrequencies, Some(20.0), false), Agreement::Differs);
    assert_eq!(pair(Finding::NotEnoughCoherence(None), Some(2.0), false), Agreement::NotEnoughCoherence);
}
