//! Evaluations and traces on virtual benches.

use rayon::ThreadPoolBuilder;
use shared::breath::{DEFAULT_PERIOD_US, paper_settings, period_s};
use shared::control::pid::{Pid, PidGains, PidState};
use shared::control::{ControlLaw, ControlOutput, Observation};

use super::*;

fn pid(p: f32, i: f32) -> Controller {
    Controller::Pid(Pid::new(PidGains { p, i, d: 0.0 }, DEFAULT_PERIOD_US).unwrap())
}

fn lung() -> BenchConfig {
    BenchConfig::paper(20.0, 20.0)
}

/// Two waveforms, two breaths of each, two seeds.
fn small() -> Plan {
    Plan {
        waveforms: at_pips(&[15.0, 30.0], &Settings::default()),
        breaths: 2,
        seeds: vec![1, 2],
        ..Plan::default()
    }
}

#[test]
fn the_number_of_threads_does_not_change_a_bit() {
    let with = |threads| {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| evaluate(&lung(), &pid(1.0, 30.0), &small()).unwrap())
    };
    let alone = with(1);
    assert_eq!(alone, with(2));
    assert_eq!(alone, with(1), "and it is reproducible");
}

#[test]
fn a_better_pid_scores_better() {
    let score = |controller| evaluate(&lung(), &controller, &small()).unwrap().mean.score;
    let (none, weak, good) = (score(pid(0.0, 0.0)), score(pid(0.5, 5.0)), score(pid(1.5, 40.0)));
    assert!(good < weak && weak < none, "{good} < {weak} < {none}");
    assert!((12.0..18.0).contains(&none), "a closed valve misses by PIP - PEEP: {none}");
}

#[test]
fn means_are_those_of_waveforms_and_seeds() {
    let evaluation = evaluate(&lung(), &pid(1.0, 30.0), &small()).unwrap();
    let by_waveform = evaluation.waveforms.iter().map(|w| w.score.score).sum::<f64>() / 2.0;
    let by_seed = evaluation.by_seed.iter().sum::<f64>() / 2.0;
    assert!((evaluation.mean.score - by_waveform).abs() < 1e-12);
    assert!((evaluation.mean.score - by_seed).abs() < 1e-12);
    assert!(
        evaluation.by_seed[0].to_bits() != evaluation.by_seed[1].to_bits(),
        "noise differs between seeds"
    );
    assert_eq!(evaluation.waveforms.iter().map(|w| w.pip).collect::<Vec<_>>(), [15.0, 30.0]);
}

#[test]
fn a_seeds_score_is_that_of_the_seed_alone() {
    let both = evaluate(&lung(), &pid(1.0, 30.0), &small()).unwrap();
    let second = Plan { seeds: vec![2], ..small() };
    let alone = evaluate(&lung(), &pid(1.0, 30.0), &second).unwrap();
    assert_eq!(alone.mean.score.to_bits(), both.by_seed[1].to_bits());
}

#[test]
fn what_follows_the_last_inspiration_is_cut_without_a_trace() {
    let plan = Plan {
        waveforms: at_pips(&[20.0], &Settings::default()),
        breaths: 1,
        seeds: vec![3],
        ..Plan::default()
    };
    let settings = plan.waveforms[0];
    assert!(cut_short(&settings).rate > 59.0, "the last breath is a third as long");
    let whole = trace(&lung(), &pid(1.0, 30.0), &settings, plan.period_us, 3, 1).unwrap();
    let expected = score_breath(&settings, 1e-3, &whole.pressure[..1000], &whole.target[..1000]);
    let scored = evaluate(&lung(), &pid(1.0, 30.0), &plan).unwrap().mean;
    assert!((scored.score - expected.score).abs() < 1e-9);
    assert!((scored.plateau_error - expected.plateau_error).abs() < 1e-9);
}

#[test]
fn a_score_has_the_valve_effort_of_the_plateau() {
    let plan = Plan {
        waveforms: at_pips(&[20.0], &Settings::default()),
        breaths: 1,
        seeds: vec![3],
        ..Plan::default()
    };
    let noisy = evaluate(&lung(), &pid(4.0, 30.0), &plan).unwrap().mean.effort;
    let settings = plan.waveforms[0];
    let curves = trace(&lung(), &pid(4.0, 30.0), &settings, plan.period_us, 3, 1).unwrap();
    let plateau: Vec<f64> = curves.u_in[700..1000].to_vec();
    assert_eq!(noisy, ValveEffort::of(&plateau, f64::from(period_s(plan.period_us))));
    let calm = evaluate(&lung(), &pid(1.0, 30.0), &plan).unwrap().mean.effort;
    assert!(calm.total_variation < 0.5 * noisy.total_variation, "noise acts through the gain");
}

#[test]
fn breaths_before_the_scored_ones_have_the_same_settings_as_these() {
    let plan = Plan { warm_up: 20, breaths: 2, ..small() };
    assert_eq!(
        breaths(&plan, &plan.waveforms[0]),
        vec![plan.waveforms[0]; 22],
        "a change could make a controller forget"
    );
    let plan = Plan { warm_up: 1, ..plan };
    assert_eq!(breaths(&plan, &plan.waveforms[0])[..2], [plan.waveforms[0]; 2]);
    assert_eq!(breaths(&plan, &plan.waveforms[0])[2], cut_short(&plan.waveforms[0]));
}

#[test]
fn scores_after_some_breaths_are_those_of_a_longer_run_without_its_beginning() {
    let score = |warm_up, breaths| {
        let plan = Plan {
            waveforms: at_pips(&[20.0], &Settings::default()),
            seeds: vec![3],
            warm_up,
            breaths,
            ..Plan::default()
        };
        evaluate(&lung(), &pid(1.0, 30.0), &plan).unwrap().mean.score
    };
    assert!((score(2, 4) - (3.0 * score(2, 3) + score(5, 1)) / 4.0).abs() < 1e-9);
    let curves =
        trace_after(5, &lung(), &pid(1.0, 30.0), &paper_settings(20.0), DEFAULT_PERIOD_US, 3, 1).unwrap();
    let scored = score_breath(&paper_settings(20.0), 1e-3, &curves.pressure[..1000], &curves.target[..1000]);
    assert!((score(5, 1) - scored.score).abs() < 1e-9);
}

#[test]
fn settings_that_leave_nothing_to_cut_stay_as_they_are() {
    let fast = Settings { inspiratory_time: 0.4, fall_time: 0.2, rate: 60.0, ..Settings::default() };
    assert_eq!(cut_short(&fast), fast);
}

#[test]
fn a_fault_is_reported_as_such() {
    let plan = Plan {
        waveforms: at_pips(&[30.0], &Settings { pressure_limit: 35.0, ..Settings::default() }),
        ..small()
    };
    // With a slow valve and a stiff lung, the pressure is far above the limit before the valve has closed.
    let mut stiff = BenchConfig::paper(5.0, 3.0);
    stiff.valve.dead_time_ms = 60.0;
    let wild = evaluate(&stiff, &pid(80.0, 5000.0), &plan);
    assert!(matches!(wild, Err(SourceError::Fault { .. })), "{wild:?}");
}

#[test]
fn refused_settings_are_an_error() {
    let plan = Plan { waveforms: at_pips(&[20.0, 500.0], &Settings::default()), ..small() };
    let refused = evaluate(&lung(), &pid(1.0, 30.0), &plan);
    assert!(matches!(refused, Err(SourceError::Settings(_))));
}

#[test]
fn a_plan_without_seeds_or_waveforms_gives_an_empty_evaluation() {
    for plan in
        [Plan { seeds: vec![], ..small() }, Plan { waveforms: at_pips(&[], &Settings::default()), ..small() }]
    {
        let evaluation = evaluate(&lung(), &pid(1.0, 30.0), &plan).unwrap();
        assert_eq!(evaluation.mean, Score::default());
    }
}

#[test]
fn a_plan_and_an_evaluation_survive_json() {
    let evaluation = evaluate(&lung(), &pid(1.0, 30.0), &small()).unwrap();
    let text = serde_json::to_string(&evaluation).unwrap();
    assert_eq!(serde_json::from_str::<Evaluation>(&text).unwrap(), evaluation);
    let plan = Plan::tuning(u64::MAX);
    let text = toml::to_string(&plan).unwrap();
    assert_eq!(toml::from_str::<Plan>(&text).unwrap(), plan);
}

#[test]
fn a_trace_shows_whole_breaths_with_the_reading_beside_the_truth() {
    let trace = trace(&lung(), &pid(1.5, 40.0), &paper_settings(25.0), DEFAULT_PERIOD_US, 1, 2).unwrap();
    assert_eq!(trace.time_s.len(), 6000);
    assert!((trace.time_s[5999] - 5.999).abs() < 1e-6);
    assert_eq!((trace.target[500], trace.target[2500]), (25.0, 5.0));
    assert!((trace.pressure[900] - 25.0).abs() < 2.0);
    assert_eq!((trace.u_out[500], trace.u_out[1500]), (false, true));
    assert!(trace.u_in[500] > 0.0);
    let noise: Vec<f64> =
        trace.measured.iter().zip(&trace.pressure).skip(700).take(250).map(|(m, p)| m - p).collect();
    assert!(noise.iter().any(|n| n.abs() > 0.05) && noise.iter().all(|n| n.abs() < 1.5));
}

/// A PID to which something constant is added, percent.
#[derive(Clone)]
struct Raised(Pid, f32);

impl ControlLaw for Raised {
    type State = PidState;

    fn initial_state(&self) -> PidState {
        PidState::new()
    }

    fn start_breath(&self, state: &mut PidState, _command: f32) {
        *state = PidState::new();
    }

    fn step(&self, state: &mut PidState, seen: &Observation) -> ControlOutput {
        self.0.step(state, seen, self.1)
    }

    fn applied(&self, _state: &mut PidState, _command: f32) {}
}

#[test]
fn the_residual_of_a_trace_is_what_was_added_to_the_pid() {
    let pid = Pid::new(PidGains { p: 10.0, i: 60.0, d: 0.02 }, DEFAULT_PERIOD_US).unwrap();
    let settings = paper_settings(35.0);
    for added in [0.0, 7.0, -7.0] {
        let law = Raised(pid, added);
        let trace = trace_after(1, &lung(), &law, &settings, DEFAULT_PERIOD_US, 1, 2).unwrap();
        assert!(trace.u_in.contains(&100.0), "the command is saturated at first");
        let residual = trace.residual(&pid);
        for (tick, residual) in residual.iter().enumerate() {
            // It is faded in, and a saturated command has no room for it.
            let (least, most) = (added.min(0.0), added.max(0.0));
            let free = !trace.u_out[tick] && tick % 3000 > 300 && (1.0..99.0).contains(&trace.u_in[tick]);
            let expected = if free { added..=added } else { least..=most };
            let (low, high) = (f64::from(*expected.start()) - 0.01, f64::from(*expected.end()) + 0.01);
            assert!((low..=high).contains(residual), "tick {tick}: {residual} of {added}");
        }
    }
}
