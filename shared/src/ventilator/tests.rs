//! Tests of the ventilator's state machine.

use super::*;
use crate::breath::{DEFAULT_PERIOD_US, paper_settings};
use crate::control::features::FeatureSpec;
use crate::control::network::Network;
use crate::control::pid::PidGains;
use crate::control::residual::{Residual, ResidualSpec};
use proptest::prelude::*;
use std::vec::Vec;

mod lessons;
mod samples;
mod sines;

const GAINS: PidGains = PidGains { p: 2.0, i: 20.0, d: 0.0 };

/// A ventilator for plants whose readings the tests make up.
fn ventilator() -> Ventilator {
    let pid = Pid::new(GAINS, DEFAULT_PERIOD_US).unwrap();
    Ventilator::new(DEFAULT_PERIOD_US, Controller::Pid(pid)).with_monitors(Monitors::ANY_PLANT)
}

/// The same ventilator with a network that always adds `percent` to the PID.
fn learned(percent: f32) -> Ventilator {
    let mut network = Network::zero();
    network.output.bias[0] = 0.01 * percent;
    let spec = ResidualSpec {
        period_us: DEFAULT_PERIOD_US,
        gains: GAINS,
        lambda: 1.0,
        authority: 100.0,
        features: FeatureSpec::default(),
    };
    let residual = Residual::new(spec, network).unwrap();
    Ventilator::new(DEFAULT_PERIOD_US, Controller::Residual(residual)).with_monitors(Monitors::ANY_PLANT)
}

fn started(ventilator: &Ventilator) -> VentilatorState {
    let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
    state.start();
    state
}

fn run(ventilator: &Ventilator, state: &mut VentilatorState, ticks: u32, pressure: f32) -> Output {
    for _ in 1..ticks {
        ventilator.step(state, pressure);
    }
    ventilator.step(state, pressure)
}

#[test]
fn standby_holds_the_valves_safe() {
    let ventilator = ventilator();
    let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
    let output = run(&ventilator, &mut state, 100, 5.0);
    assert_eq!((output.command, output.mode, output.sample), (ValveCommand::SAFE, Mode::Standby, None));
}

#[test]
fn a_breath_runs_through_its_phases() {
    let ventilator = ventilator();
    let mut state = started(&ventilator);
    let sample = |output: Output| output.sample.unwrap();
    let first = sample(run(&ventilator, &mut state, 1, 5.0));
    assert_eq!((first.phase, first.u_out, first.breath, first.tick), (Phase::Inspiration, false, 0, 0));
    assert!(first.u_in > 0.0);
    assert_eq!((state.breath_number(), state.tick()), (0, 1));
    let fall = sample(run(&ventilator, &mut state, 1000, 15.0));
    assert_eq!((fall.phase, fall.u_out), (Phase::Fall, true));
    assert!(fall.u_in.abs() < f32::EPSILON);
    let rest = sample(run(&ventilator, &mut state, 500, 5.0));
    assert_eq!((rest.phase, rest.u_out), (Phase::Expiration, true));
    assert!((rest.u_in - 5.0).abs() < f32::EPSILON, "the bias");
    let next = sample(run(&ventilator, &mut state, 1500, 5.0));
    assert_eq!((next.breath, next.tick, next.phase), (1, 0, Phase::Inspiration));
    run(&ventilator, &mut state, 3099, 5.0);
    assert_eq!((state.breath_number(), state.tick()), (2, 100));
}

/// Asks for a constant command; remembers where the valve stood before the breath, then each command that was applied.
struct Constant(f32);

impl ControlLaw for Constant {
    type State = Vec<f32>;

    fn initial_state(&self) -> Vec<f32> {
        Vec::new()
    }

    fn start_breath(&self, state: &mut Vec<f32>, command: f32) {
        *state = Vec::from([command]);
    }

    fn step(&self, _: &mut Vec<f32>, _: &Observation) -> ControlOutput {
        ControlOutput::plain(self.0)
    }

    fn applied(&self, state: &mut Vec<f32>, command: f32) {
        state.push(command);
    }
}

#[test]
fn the_controller_is_told_where_the_valve_stood_and_what_was_applied_in_the_inspiration() {
    let ventilator = Ventilator::new(DEFAULT_PERIOD_US, Constant(120.0)).with_monitors(Monitors::ANY_PLANT);
    let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
    state.start();
    for _ in 0..3000 {
        ventilator.step(&mut state, 5.0);
    }
    assert_eq!((state.controller.len(), state.controller[0] as i32), (1001, 0));
    assert!(state.controller[1..].iter().all(|command| (command - 100.0).abs() < f32::EPSILON));
    ventilator.step(&mut state, 5.0);
    assert_eq!((state.controller.len(), state.controller[0] as i32), (2, 5), "after the bias");
}

#[test]
fn settings_wait_for_the_next_breath() {
    let ventilator = ventilator();
    let mut state = started(&ventilator);
    run(&ventilator, &mut state, 10, 5.0);
    ventilator.apply(&mut state, &paper_settings(30.0)).unwrap();
    assert_eq!(state.pending(), Some(&paper_settings(30.0)));
    let before = run(&ventilator, &mut state, 990, 5.0).sample.unwrap();
    assert!((before.target - 20.0).abs() < f32::EPSILON);
    let after = run(&ventilator, &mut state, 2001, 5.0).sample.unwrap();
    assert_eq!((after.tick, state.pending()), (0, None));
    assert!((after.target - 30.0).abs() < f32::EPSILON);
}

#[test]
fn refused_settings_leave_those_in_force() {
    let ventilator = ventilator();
    let mut state = started(&ventilator);
    assert!(ventilator.apply(&mut state, &paper_settings(f32::NAN)).is_err());
    let next = run(&ventilator, &mut state, 3001, 5.0).sample.unwrap();
    assert!((next.target - 20.0).abs() < f32::EPSILON);
}

#[test]
fn at_the_pressure_limit_the_inspiration_ends() {
    let ventilator = ventilator();
    let mut state = started(&ventilator);
    run(&ventilator, &mut state, 1, 59.0);
    assert!(!state.cut());
    let over = run(&ventilator, &mut state, 3, 61.0);
    assert!(state.cut());
    assert_eq!((over.command, over.mode), (ValveCommand::SAFE, Mode::Ventilating));
    let sample = run(&ventilator, &mut state, 800, 7.0).sample.unwrap();
    assert_eq!((sample.phase, sample.u_out, sample.target as i32), (Phase::Fall, true, 5));
    let next = run(&ventilator, &mut state, 2197, 5.0).sample.unwrap();
    assert_eq!((next.tick, next.phase, next.u_out), (0, Phase::Inspiration, false));
}

#[test]
fn a_pressure_that_stays_above_its_limit_latches_until_acknowledged() {
    let ventilator = ventilator();
    let mut state = started(&ventilator);
    let stuck = Readings { flow: 0.0, ..76.0.into() };
    (0..700).for_each(|_| assert_eq!(ventilator.step(&mut state, stuck).mode, Mode::Ventilating));
    let output = (0..3).map(|_| ventilator.step(&mut state, stuck)).find(|output| output.alarm.is_some());
    let output = output.unwrap();
    assert_eq!((output.command, output.mode), (ValveCommand::SAFE, Mode::Fault(Fault::HardLimit)));
    assert_eq!(output.alarm, Some(Fault::HardLimit));
    assert_eq!(run(&ventilator, &mut state, 1, 76.0).alarm, None, "reported once");
    state.start();
    let output = run(&ventilator, &mut state, 10_000, 5.0);
    assert_eq!((output.command, output.mode), (ValveCommand::SAFE, Mode::Fault(Fault::HardLimit)));
    assert!(state.acknowledge());
    assert_eq!(state.mode(), Mode::Standby);
    assert!(!state.acknowledge(), "no alarm is left");
    state.start();
    assert_eq!(run(&ventilator, &mut state, 1, 5.0).mode, Mode::Ventilating);
}

#[test]
fn without_a_pressure_reading_breath_follows_breath() {
    let ventilator = ventilator();
    let mut state = started(&ventilator);
    for _ in 0..3 {
        let good = run(&ventilator, &mut state, 500, 18.0).sample.unwrap();
        assert!(good.u_in > 0.0 && state.has_sensor());
        run(&ventilator, &mut state, 500, 18.0);
        run(&ventilator, &mut state, 2000, 5.0);
    }
    let output = run(&ventilator, &mut state, 6500, f32::NAN);
    let sample = output.sample.unwrap();
    assert_eq!((output.mode, state.level(), sample.breath), (Mode::Ventilating, Level::Backup, 5));
    assert!(sample.u_in > 0.0 && !sample.u_out && sample.pressure.is_nan() && !state.has_sensor());
}

/// Twelve seconds with a pressure in each expiration by its tick, in which all gas comes out again.
fn circuit<C: ControlLaw>(
    ventilator: &Ventilator<C>,
    pressure: impl Fn(u32) -> f32,
) -> (Vec<Sample>, VentilatorState<C::State>) {
    let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
    state.start();
    let mut samples = Vec::new();
    for n in 0..12_000 {
        let tick = state.tick();
        let noise = 0.07 * ((n * 7 % 5) as f32 - 2.0);
        let inspires = (tick as f32 * 0.2).min(20.0) + 5.0;
        let pressure = if tick < 1000 { inspires } else { pressure(tick) };
        let flow = if tick < 1000 { 0.4 } else { -0.2 };
        let readings = Readings { flow, ..Readings::from(pressure + noise) };
        samples.push(ventilator.step(&mut state, readings).sample.unwrap());
    }
    (samples, state)
}

#[test]
fn an_expiration_that_still_falls_delays_the_next_breath_and_pip_follows_a_stuck_baseline() {
    let all = ventilator().with_monitors(Monitors::ALL);
    let breathe = |pressure: &dyn Fn(u32) -> f32| circuit(&all, pressure).0;
    let longest = |samples: &[Sample]| samples.iter().map(|sample| sample.tick).max();
    let highest = |samples: &[Sample]| samples.iter().map(|sample| sample.target as i32).max();
    let sound = breathe(&|_| 5.0);
    assert_eq!((longest(&sound), highest(&sound)), (Some(2999), Some(20)));
    let slow = breathe(&|tick| 25.0 - 0.005 * (tick - 1000) as f32);
    assert_eq!((longest(&slow), highest(&slow)), (Some(4420), Some(20)), "until it is 3 cmH2O above PEEP");
    let stuck = breathe(&|_| 12.0);
    assert_eq!((longest(&stuck), highest(&stuck)), (Some(2999), Some(27)));
}

/// Asks for nothing; remembers the highest PIP that it saw.
struct Highest;

impl ControlLaw for Highest {
    type State = f32;

    fn initial_state(&self) -> f32 {
        0.0
    }

    fn start_breath(&self, _: &mut f32, _: f32) {}

    fn step(&self, highest: &mut f32, seen: &Observation) -> ControlOutput {
        *highest = highest.max(seen.pip);
        ControlOutput::plain(0.0)
    }

    fn applied(&self, _: &mut f32, _: f32) {}
}

#[test]
fn the_controller_sees_the_pip_that_follows_a_stuck_baseline() {
    let all = Ventilator::new(DEFAULT_PERIOD_US, Highest).with_monitors(Monitors::ALL);
    let highest = |baseline: f32| {
        let falls = |tick| (25.0 - 0.1 * (tick - 1000) as f32).max(baseline);
        circuit(&all, falls).1.controller as i32
    };
    assert_eq!((highest(5.0), highest(12.0)), (20, 27));
}

#[test]
fn the_compensation_of_a_leak_is_added_to_the_bias() {
    let (samples, _) = circuit(&ventilator().with_monitors(Monitors::ALL), |_| 3.5);
    let last = samples.last().unwrap();
    assert_eq!((last.phase, last.u_in as i32), (Phase::Expiration, 45), "a bias of 5 and at most 40");
}

#[test]
fn exploration_acts_only_at_the_top_of_the_ladder() {
    let exploring = ventilator().with_exploration(Some(Exploration {
        boundary_probability: 1.0,
        boundary_height: (10.0, 10.0),
        ..Exploration::default()
    }));
    let mut state = started(&exploring);
    exploring.missed(&mut state, 1);
    assert!(run(&exploring, &mut state, 1, 15.0).sample.unwrap().explore > 0.0, "a new breath");
    exploring.missed(&mut state, 1);
    assert!(run(&exploring, &mut state, 1, 15.0).sample.unwrap().explore.abs() < 1e-6);
}

#[test]
fn the_lowest_pid_is_the_compiled_in_one() {
    let silly = Pid::new(PidGains { p: 0.0, i: 0.0, d: 0.0 }, DEFAULT_PERIOD_US).unwrap();
    let all = Ventilator::new(DEFAULT_PERIOD_US, Controller::Pid(silly)).with_monitors(Monitors::ALL);
    let mut state = started(&all);
    let noisy = |n: u32| 15.0 + 1.2 * ((n * 7 % 5) as f32 - 2.0);
    let last = (0..300).map(|n| all.step(&mut state, noisy(n)).command.u_in()).last();
    assert_eq!(state.level(), Level::CappedPid);
    assert!(last.unwrap() > 10.0);
}

#[test]
fn a_resumed_ventilation_starts_with_the_pid() {
    let ventilator = learned(60.0);
    let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
    state.resume();
    assert_eq!((state.mode(), state.level()), (Mode::Ventilating, Level::Pid));
}

#[test]
fn exploration_adds_to_the_command_and_is_recorded() {
    let quiet = ventilator();
    let exploring = ventilator().with_exploration(Some(Exploration {
        boundary_probability: 1.0,
        boundary_height: (10.0, 10.0),
        ..Exploration::default()
    }));
    let first = |v: &Ventilator| run(v, &mut started(v), 1, 15.0).sample.unwrap();
    assert!((first(&exploring).u_in - first(&quiet).u_in - 10.0).abs() < 1e-4);
    assert!((first(&exploring).explore - 10.0).abs() < 1e-6);
}

/// SAFETY.md on a hand-over: the learned part fades at the slew, and the PID underneath continues, its integral neither
/// reset nor fitted to the applied command. Verifies: residual-slew.
#[test]
fn a_hand_over_is_a_ramp_of_the_learned_part_alone() {
    let (learned, pid) = (learned(60.0), ventilator());
    let (mut state, mut pid_state) = (started(&learned), started(&pid));
    // Difference between each command and that of a PID without a network, thousandths of a percent.
    let mut added = |state: &mut VentilatorState, readings: &[f32]| -> Vec<i32> {
        let mut added = |reading| {
            let command = learned.step(state, reading).command.u_in();
            command - pid.step(&mut pid_state, reading).command.u_in()
        };
        readings.iter().map(|reading| (1000.0 * added(*reading) + 0.5) as i32).collect()
    };
    assert_eq!(added(&mut state, &[15.0; 4]), [25_000, 50_000, 60_000, 60_000]);
    assert_eq!(added(&mut state, &[f32::NAN, 15.0]), [35_000, 60_000], "bridged");
    learned.missed(&mut state, 1);
    assert_eq!(added(&mut state, &[15.0; 100])[..4], [35_000, 10_000, 0, 0], "the PID takes over");
    assert!(added(&mut state, &[20.0; 2894]).iter().all(|percent| *percent == 0));
    assert_eq!(added(&mut state, &[15.0; 4]), [25_000, 50_000, 60_000, 60_000], "the next breath");
}

proptest! {
    /// For any readings and requests in any order: the command stays in range, the expiratory valve is open unless an
    /// inspiration runs, and a fault stays until it is acknowledged.
    #[test]
    fn no_sequence_of_events_leaves_the_state_machine(
        events in prop::collection::vec((0u8..12, prop::num::f32::ANY, -20.0f32..80.0), 1..400),
    ) {
        let ventilator = ventilator();
        let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
        for (kind, wild, tame) in events {
            let before = state.mode();
            match kind {
                0 => state.start(),
                1 => state.stop(),
                2 => { state.acknowledge(); }
                3 => { let _ = ventilator.apply(&mut state, &paper_settings(tame)); }
                _ => {
                    let output = ventilator.step(&mut state, if kind == 4 { wild } else { tame });
                    prop_assert!((0.0..=100.0).contains(&output.command.u_in()));
                    let inspiring = output.sample.is_some_and(|s| s.phase == Phase::Inspiration);
                    prop_assert_eq!(output.command.u_out(), !inspiring);
                    prop_assert!(!state.cut() || output.command.u_out());
                }
            }
            if let Mode::Fault(_) = before {
                prop_assert!(kind == 2 || state.mode() == before);
            }
        }
    }
}

/// Runs breaths in which the pressure falls by an effort from a tick on, until a breath starts; the ticks of each breath.
fn breathe_with_efforts(
    ventilator: &Ventilator,
    settings: &Settings,
    breaths: u32,
    seen: impl Fn(u32) -> Readings,
) -> Vec<(u32, bool)> {
    let mut state = ventilator.standby(settings).unwrap();
    state.start();
    let mut lengths = Vec::new();
    while state.breath_number() < breaths {
        let tick = state.tick();
        let before = state.breath_number();
        ventilator.step(&mut state, seen(tick));
        if state.breath_number() != before {
            lengths.push((tick + 1, state.triggered()));
        }
    }
    lengths
}

/// A pressure with an effort from a tick on.
fn inhales(from: u32) -> impl Fn(u32) -> Readings {
    move |tick| Readings::from(if tick < from { 5.0 } else { 3.0 } + fine(tick))
}

/// The least step of a fine sensor.
fn fine(tick: u32) -> f32 {
    if tick.is_multiple_of(2) { 0.0 } else { 1.0 / 1024.0 }
}

#[test]
fn an_effort_starts_the_next_breath_but_not_the_second_one() {
    let settings = paper_settings(20.0);
    let lengths = breathe_with_efforts(&ventilator(), &settings, 4, inhales(2000));
    assert_eq!(lengths, [(3000, false), (2010, true), (2010, true), (2010, true)]);
    let flow = |tick| Readings { flow: if tick < 2000 { -0.1 } else { -0.05 } + fine(tick), ..5.0.into() };
    assert_eq!(breathe_with_efforts(&ventilator(), &settings, 3, flow)[1..], [(2010, true); 2]);
}

#[test]
fn flow_that_makes_up_for_a_leak_does_not_rise_as_the_expiration_begins() {
    let ventilator = ventilator();
    let mut state = started(&ventilator);
    let mut breathe = |sagging: f32| {
        let ticks = 0..3000;
        let pressure = |tick| if tick < 1500 { 5.0 } else { sagging };
        ticks.map(|tick| ventilator.step(&mut state, pressure(tick)).sample.unwrap().u_in).collect::<Vec<_>>()
    };
    let closed = breathe(3.5);
    assert_eq!((closed[1499], closed[1500]), (0.0, 5.02), "the bias and the first rise");
    let open = breathe(5.0);
    assert!(open[1499] > 20.0 && (open[1500] - open[1499]).abs() < 0.1, "{} {}", open[1499], open[1500]);
}

#[test]
fn without_an_effort_or_a_trigger_the_clock_starts_the_breaths() {
    let settings = paper_settings(20.0);
    assert_eq!(breathe_with_efforts(&ventilator(), &settings, 6, |_| 5.0.into()), [(3000, false); 6]);
    let off = Settings { trigger_pressure: 0.0, trigger_flow: 0.0, ..settings };
    assert_eq!(breathe_with_efforts(&ventilator(), &off, 6, inhales(2000)), [(3000, false); 6]);
    let dull = Settings { trigger_pressure: 2.1, ..settings };
    assert_eq!(breathe_with_efforts(&ventilator(), &dull, 6, inhales(2000)), [(3000, false); 6]);
}

#[test]
fn a_reading_that_stands_in_for_a_missing_one_is_no_effort() {
    let settings = paper_settings(20.0);
    let missing = |tick| Readings::from(if (2000..2003).contains(&tick) { f32::NAN } else { 5.0 });
    assert_eq!(breathe_with_efforts(&ventilator(), &settings, 6, missing), [(3000, false); 6]);
}

#[test]
fn in_the_last_tick_effort_and_clock_start_one_breath() {
    let lengths = breathe_with_efforts(&ventilator(), &paper_settings(20.0), 6, inhales(2990));
    assert_eq!(lengths[1..], [(3000, true); 5]);
}

#[test]
fn a_restart_waits_for_the_clock_again() {
    let ventilator = ventilator();
    let mut state = started(&ventilator);
    for _ in 0..20_000 {
        let tick = state.tick();
        ventilator.step(&mut state, inhales(2000)(tick));
    }
    assert!(state.triggered());
    state.stop();
    state.start();
    assert!(!state.triggered());
}
