//! The measurement of an exactly known loop in breaths, and its refusals.

use std::f64::consts::TAU;
use std::sync::atomic::AtomicBool;

use num_complex::Complex64;
use plant::bench::BenchConfig;
use progress::Progress;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, Normal};
use shared::breath::{Breath, DEFAULT_PERIOD_US, Phase};
use shared::control::pid::{Pid, PidGains, PidState};
use shared::control::{Controller, Observation};
use shared::explore::Exploration;
use shared::explore::sines::SineSweep;
use shared::settings::Settings;
use shared::ventilator::Sample;
use ventilator::{BenchSource, Source, SourceError, Tick};

use crate::interval::{Finding, SureMargins};
use crate::measure::{MeasureError, measure};
use crate::measurement::{Ended, Measured, Plan, PlanError};
use crate::response::ResponsePoint;
use crate::stability::Margins;

const GAINS: PidGains = PidGains { p: 3.0, i: 25.0, d: 0.0 };
/// The plant: gain, cmH2O per percent; lag, s; dead time, ticks.
const PLANT: (f64, f64, usize) = (0.5, 0.1, 25);

/// A ventilator whose plant is a lag behind a dead time, exact at the ticks: every frequency of its loop is known.
struct Known {
    pid: Pid,
    sweep: Option<SineSweep>,
    number: u32,
    /// Noise of the pressure reading, cmH2O (sd).
    noise: f64,
    rng: ChaCha8Rng,
    /// The breath from which on no sine is added.
    alarm_from: u32,
}

impl Known {
    fn new(noise: f64) -> Self {
        let pid = Pid::new(GAINS, DEFAULT_PERIOD_US).unwrap();
        Self { pid, sweep: None, number: 0, noise, rng: ChaCha8Rng::seed_from_u64(7), alarm_from: u32::MAX }
    }
}

/// Loop gain and plant by formula.
fn exact(hz: f64) -> ResponsePoint {
    let (gain, lag_s, dead) = PLANT;
    let keep = (-1e-3 / lag_s).exp();
    let tick = |ticks: f64| Complex64::cis(-TAU * hz * 1e-3 * ticks);
    let plant = tick(1.0 + dead as f64) * (gain * (1.0 - keep)) / (Complex64::ONE - tick(1.0) * keep);
    // The integral of a tick counts in the same tick.
    let integral = f64::from(GAINS.i) * 1e-3 / (Complex64::ONE - tick(1.0));
    let loop_gain = (integral + f64::from(GAINS.p)) * plant;
    ResponsePoint { hz, loop_gain, path: plant / (Complex64::ONE + loop_gain) }
}

impl Source for Known {
    fn period_us(&self) -> u32 {
        DEFAULT_PERIOD_US
    }

    fn plant(&self) -> String {
        "a lag".into()
    }

    fn plant_parameters(&self) -> String {
        String::new()
    }

    fn configure(&mut self, _: Controller, _: Option<Exploration>) -> Result<(), SourceError> {
        Ok(())
    }

    fn sweep(&mut self, sweep: Option<SineSweep>) -> Result<(), SourceError> {
        self.sweep = sweep;
        Ok(())
    }

    fn breath(&mut self, settings: &Settings, sink: &mut dyn FnMut(&Tick)) -> Result<(), SourceError> {
        let (gain, lag_s, dead) = PLANT;
        let keep = (-1e-3 / lag_s).exp();
        let breath = Breath::new(settings, DEFAULT_PERIOD_US)?;
        let sine = self.sweep.filter(|_| self.number < self.alarm_from);
        let sine = sine.and_then(|sweep| sweep.sine(self.number, DEFAULT_PERIOD_US));
        let Settings { pip, peep, .. } = *settings;
        let noise = Normal::new(0.0, self.noise).unwrap();
        let (mut state, mut pressure) = (PidState::new(), f64::from(peep));
        let mut under_way = vec![pressure / gain; dead];
        for tick in 0..breath.inspiration_ticks() {
            let reading = (pressure + noise.sample(&mut self.rng)) as f32;
            let target = breath.target(tick);
            let seen =
                Observation { pressure: reading, target, pip, peep, tick, rise_ticks: breath.rise_ticks() };
            let own = self.pid.step(&mut state, &seen, 0.0).command;
            let explore = sine.map_or(0.0, |sine| sine.at(tick));
            let u_in = (own + explore).clamp(0.0, 100.0);
            let sample = Sample {
                breath: self.number,
                tick,
                phase: Phase::Inspiration,
                target,
                pressure: reading,
                u_in,
                u_out: false,
                explore,
                learned: 0.0,
                flow: None,
            };
            sink(&Tick { sample, truth: None });
            under_way.insert(0, u_in.into());
            pressure = keep * pressure + (1.0 - keep) * gain * under_way.pop().unwrap();
        }
        self.number += 1;
        Ok(())
    }

    fn acknowledge(&mut self) -> Result<(), SourceError> {
        Ok(())
    }
}

fn run(source: &mut Known, plan: &Plan) -> Measured {
    measure(source, plan, &Progress::silent()).unwrap()
}

/// The margins by formula, on a fine grid.
fn exact_margins(plan: &Plan) -> Margins {
    let (low, high) = plan.band_hz;
    let hz = |n: u32| f64::from(low) * f64::from(high / low).powf(f64::from(n) / 2000.0);
    Margins::of(&(0..=2000).map(|n| exact(hz(n))).collect::<Vec<_>>()).unwrap()
}

fn value(finding: Finding) -> f64 {
    finding.sure().unwrap_or_else(|| panic!("{finding:?}")).value
}

#[test]
fn the_loop_gain_in_breaths_is_that_of_the_formula_and_not_the_closed_loop() {
    let plan = Plan::default();
    let measured = run(&mut Known::new(0.02), &plan);
    assert_eq!((measured.estimates.len(), measured.ended.clone()), (20, None));
    for estimate in &measured.estimates {
        let exact = exact(estimate.response.hz);
        let close = |found: Complex64, exact: Complex64| (found - exact).norm() < 0.06 * exact.norm();
        assert!(close(estimate.response.loop_gain, exact.loop_gain), "{estimate:?}, not {exact:?}");
        assert!(close(estimate.plant, exact.plant()), "{estimate:?}, not {exact:?}");
        assert!(estimate.coherence > 0.95 && estimate.limited < 1e-12, "{estimate:?}");
    }
    let exact = exact_margins(&plan);
    let SureMargins { ms, gain_margin, delay_margin_ms, .. } = measured.margins;
    for (found, exact) in [
        (ms, exact.ms),
        (gain_margin, exact.gain_margin.unwrap()),
        (delay_margin_ms, exact.delay_margin_ms.unwrap()),
    ] {
        assert!((value(found) / exact - 1.0).abs() < 0.05, "{found:?}, not {exact}");
    }
    assert!(measured.margins.suffices());
}

#[test]
fn noise_widens_the_intervals_until_no_margin_is_stated() {
    let plan = Plan::default();
    let width = |noise: f64| {
        let margins = run(&mut Known::new(noise), &plan).margins;
        match margins.gain_margin {
            Finding::Found(sure) | Finding::NotEnoughCoherence(Some(sure)) => {
                (margins.suffices(), sure.high.map_or(f64::INFINITY, |high| high - sure.low))
            }
            _ => (margins.suffices(), f64::INFINITY),
        }
    };
    let (quiet, noisy) = (width(0.02), width(5.0));
    assert!(quiet.0 && !noisy.0 && noisy.1 > 3.0 * quiet.1, "{quiet:?} {noisy:?}");
}

#[test]
fn what_every_breath_has_in_common_is_not_taken_for_a_response() {
    // Ramps of other heights, with the same noise.
    let gains = [20.0, 30.0].map(|pip| {
        let plan = Plan { settings: Settings { pip, ..Plan::default().settings }, ..Plan::default() };
        run(&mut Known::new(0.02), &plan).estimates
    });
    for (low, high) in gains[0].iter().zip(&gains[1]) {
        let (low, high) = (low.response.loop_gain, high.response.loop_gain);
        assert!((low - high).norm() < 1e-3 * low.norm(), "{low} {high}");
    }
}

#[test]
fn a_sine_without_room_is_refused_with_the_amplitude_that_is_allowed() {
    let refused = measure(
        &mut Known::new(0.0),
        &Plan { settings: Settings { pip: 7.0, ..Plan::default().settings }, ..Plan::default() },
        &Progress::silent(),
    );
    let Err(MeasureError::Plan(PlanError::NoRoom { amplitude, low, allowed, .. })) = refused else {
        panic!("{refused:?}")
    };
    assert!(amplitude > allowed && allowed < low && allowed > 0.0, "{amplitude} {low} {allowed}");
    let amplitude = Plan { amplitude: 30.0, ..Plan::default() }.validate();
    assert!(amplitude.unwrap_err().to_string().contains("allowed are 0 to 20 %"));
    let short =
        Plan { settings: Settings { inspiratory_time: 0.5, ..Plan::default().settings }, ..Plan::default() };
    assert!(matches!(short.validate(), Err(PlanError::TooShort { .. })));
}

#[test]
fn an_alarm_ends_the_measurement_and_what_was_measured_stays() {
    let mut source = Known { alarm_from: 40, ..Known::new(0.02) };
    let measured = run(&mut source, &Plan::default());
    assert!(matches!(measured.ended, Some(Ended::Alarm(_))), "{:?}", measured.ended);
    assert_eq!(measured.estimates.len(), (40 - 6) / 6);
    assert_eq!((source.number, source.sweep), (41, None), "at once, and without a sweep");
    assert!(!measured.margins.suffices());
}

#[test]
fn a_request_to_stop_ends_the_sweep_after_the_breath() {
    let stop = AtomicBool::new(false);
    let observer = |event: &progress::Event<'_>| {
        if event.done == 20 {
            stop.store(true, std::sync::atomic::Ordering::Relaxed);
        }
    };
    let mut source = Known::new(0.02);
    let measured = measure(&mut source, &Plan::default(), &Progress::new(&observer, &stop)).unwrap();
    assert_eq!((measured.ended, source.number, source.sweep), (Some(Ended::Stopped), 20, None));
    assert_eq!(measured.estimates.len(), 2);
}

#[test]
fn a_valve_at_its_limits_gives_no_margins() {
    let config = BenchConfig::paper(50.0, 20.0);
    let pid = Pid::new(PidGains { p: 7.4, i: 247.0, d: 0.18 }, DEFAULT_PERIOD_US).unwrap();
    let plan = Plan::default();
    let controller = Controller::Pid(pid);
    let mut source = BenchSource::new(&config, controller, &plan.settings, DEFAULT_PERIOD_US, 1).unwrap();
    match measure(&mut source, &plan, &Progress::silent()) {
        Err(MeasureError::Plan(PlanError::NoRoom { .. })) => {}
        other => assert!(!other.unwrap().margins.suffices()),
    }
}
