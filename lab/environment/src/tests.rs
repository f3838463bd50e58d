//! Episodes alone and in batches: the same bits as the judge's, whatever runs beside them.

use std::sync::Arc;

use learn::controller::authors::averages::averages;
use plant::bench::BenchConfig;
use plant::bench::family::Family;
use plant::prescriptions::Prescriptions;
use proptest::prelude::*;
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::pid::{Pid, PidGains};
use shared::control::{Controller, Observation};
use shared::settings::Settings;
use trials::robust::plant_run::{PlantRun, breaths};

use super::*;

const GAINS: PidGains = PidGains { p: 3.0, i: 30.0, d: 0.0 };

fn environment(config: TaskConfig) -> Environment {
    Environment::new(Arc::new(Task::new(config).unwrap()), 1)
}

/// Runs an episode with one action; returns the rewards.
fn run(environment: &mut Environment, action: f32) -> Vec<f64> {
    let mut rewards = Vec::new();
    while environment.is_running() {
        rewards.push(environment.step(action).unwrap().reward);
    }
    rewards
}

fn family() -> Plants {
    Plants::Family(Box::new(Family::find("adult").unwrap()))
}

#[test]
fn a_pid_without_a_correction_has_the_scores_of_the_robustness_test() {
    let action = ActionKind::Residual { gains: GAINS, authority: 100.0 };
    let pid = Controller::Pid(Pid::new(GAINS, DEFAULT_PERIOD_US).unwrap());
    for name in ["paper", "bedside"] {
        let prescriptions = family().prescriptions(name).unwrap();
        let (plants, own) = (family(), Some(prescriptions.clone()));
        let config =
            TaskConfig { plants, prescriptions: own, breaths: 3, hold: 1, action, ..TaskConfig::default() };
        let mut environment = environment(config);
        for number in 0..4 {
            environment.reset().unwrap();
            run(&mut environment, 0.0);
            let plant = PlantRun::new(&Family::find("adult").unwrap(), &prescriptions, 1, number, 3);
            let scores: Vec<f64> = environment.episode().scores.iter().map(|score| score.score).collect();
            assert_eq!(scores, breaths(&plant, &pid).unwrap().every, "{name}, plant {number}");
        }
    }
}

#[test]
fn an_episode_of_drawn_prescriptions_has_its_own_length_and_breathing_patient() {
    let prescriptions = Some(Prescriptions::find("bedside").unwrap());
    let config = TaskConfig { prescriptions, breathing: true, ..TaskConfig::default() };
    let mut environment = environment(config);
    let mut lengths = Vec::new();
    for _ in 0..20 {
        environment.reset().unwrap();
        let steps = run(&mut environment, -1.0).len();
        let Episode { settings, steps: planned, .. } = environment.episode();
        assert_eq!(steps as u32, *planned);
        assert!((steps as f32 - settings.inspiratory_time * 100.0).abs() <= 1.1, "{steps} {settings:?}");
        assert!(*planned <= environment.task().steps());
        lengths.push(steps);
    }
    assert_eq!(environment.task().steps(), 300, "the longest inspiration is 3 s");
    lengths.dedup();
    assert!(lengths.len() > 15, "{lengths:?}");
}

#[test]
fn plants_and_waveforms_take_turns() {
    let lungs = BenchConfig::preset("paper").unwrap();
    let mut environment = environment(TaskConfig { plants: Plants::Benches(lungs), ..TaskConfig::default() });
    let mut seen = Vec::new();
    for _ in 0..54 {
        environment.reset().unwrap();
        let episode = environment.episode();
        seen.push((episode.plant.clone(), episode.settings.pip.to_bits()));
    }
    seen.sort();
    seen.dedup();
    assert_eq!(seen.len(), 54, "each of nine lungs at each of six PIPs");
}

#[test]
fn an_expiration_runs_between_two_breaths_of_an_episode() {
    let mut environment = environment(TaskConfig { breaths: 2, hold: 1, ..TaskConfig::default() });
    environment.reset().unwrap();
    let rewards = run(&mut environment, -0.7);
    assert_eq!(rewards.len(), 2000);
    // After an expiration the pressure is near PEEP again, far from the target.
    assert!(rewards[1000] < -4.0 && rewards[1000] < rewards[999], "{} {}", rewards[999], rewards[1000]);
    assert_eq!(environment.episode().scores.len(), 2);
}

#[test]
fn an_action_is_held_and_the_last_one_for_what_is_left() {
    let mut held = environment(TaskConfig { hold: 300, ..TaskConfig::default() });
    let mut each = environment(TaskConfig { hold: 1, ..TaskConfig::default() });
    held.reset().unwrap();
    each.reset().unwrap();
    let (held, each) = (run(&mut held, -0.6), run(&mut each, -0.6));
    let means: Vec<f64> =
        each.chunks(300).map(|ticks| ticks.iter().sum::<f64>() / ticks.len() as f64).collect();
    assert_eq!(held, means);
}

/// The sum of the rewards of an episode in which the valve is open and of the same episode in which it is closed.
fn open_and_closed(config: TaskConfig, number: u32) -> [f64; 2] {
    let mut environment = environment(config);
    let choice = Choice { number: Some(number), ..Choice::default() };
    [1.0, -1.0].map(|action| {
        environment.reset_to(choice).unwrap();
        let total = run(&mut environment, action).iter().sum();
        assert_eq!(environment.episode().fault.is_some(), action > 0.0, "an open valve raises the pressure");
        total
    })
}

#[test]
fn an_abort_never_pays() {
    let rewards = [
        Reward::default(),
        Reward { error: 1.0, effort: 0.1, overshoot: 3.0 },
        Reward { error: 0.0, effort: 0.0, overshoot: 1.0 },
        Reward { error: 0.0, effort: 1.0, overshoot: 0.0 },
    ];
    // Held for the whole inspiration, the abort is in the only step.
    for (hold, reward) in
        [1, 10, 300, 1000].into_iter().zip(rewards.iter().cycle().skip(1)).chain([(1000, &rewards[0])])
    {
        for number in 0..6 {
            for name in ["paper", "bedside"] {
                let prescriptions = Some(Prescriptions::find(name).unwrap());
                let config = TaskConfig { hold, reward: *reward, prescriptions, ..TaskConfig::default() };
                let [open, closed] = open_and_closed(config, number);
                assert!(open < closed, "{name}, {hold} {reward:?}: {open} {closed}");
            }
        }
    }
}

#[test]
fn an_aborted_episode_counts_every_tick_that_did_not_run_as_the_worst() {
    let prescriptions = Some(Prescriptions::listed("one", &[20.0], Settings::default()));
    let config = TaskConfig { hold: 1000, prescriptions, ..TaskConfig::default() };
    let mut environment = environment(config);
    environment.reset().unwrap();
    let of_step = environment.step(1.0).unwrap();
    let ran = environment.inspiration()[0].len() as f64;
    assert!(of_step.ended && ran < 1000.0);
    // At the limit of 60 cmH2O the error from a PEEP of 5 cmH2O is 55 cmH2O.
    let of_missing = -55.0 * (1000.0 - ran + 1.0) / 1000.0;
    assert!(
        of_step.reward < of_missing && of_step.reward > of_missing - 40.0 * ran / 1000.0,
        "{of_step:?} {ran}"
    );
}

#[test]
fn a_control_period_is_checked_before_the_first_episode() {
    for period_us in [0, 500, 1500, 51_000] {
        let config = TaskConfig { period_us, ..TaskConfig::default() };
        assert!(Task::new(config).is_err(), "{period_us}");
    }
    let task = Task::new(TaskConfig { period_us: 4000, hold: 10, ..TaskConfig::default() }).unwrap();
    assert_eq!(task.steps(), 25);
}

#[test]
fn errors_of_the_authors_are_as_far_apart_as_in_their_controller() {
    // 10 ms are 2.5 ticks of 4 ms: three, as in the controller.
    let mut stream = ObservationStream::new(ObservationKind::Authors, 4000).unwrap();
    stream.start_breath(0.0);
    let see = |stream: &mut ObservationStream, tick: u32| {
        let pressure = if tick == 0 { 10.0 } else { 20.0 };
        stream
            .see(&Observation { pressure, target: 20.0, pip: 20.0, peep: 5.0, tick, rise_ticks: 0 })
            .to_vec()
    };
    let seen: Vec<_> = (0..4).map(|tick| see(&mut stream, tick)).collect();
    let mut errors = [0.0; 10];
    errors[1] = 1.0;
    assert_eq!(seen[3], averages(&errors));
}

#[test]
fn refused_actions_move_nothing() {
    let mut environment = environment(TaskConfig::default());
    assert!(matches!(environment.step(0.0), Err(EnvironmentError::Ended)));
    environment.reset().unwrap();
    let mut same = Environment::new(Arc::new(environment.task().clone()), 1);
    same.reset().unwrap();
    assert!(matches!(environment.step(f32::NAN), Err(EnvironmentError::Action(_))));
    assert_eq!(environment.step(0.1).unwrap(), same.step(0.1).unwrap());
}

/// Observations, rewards and ends of some steps of a batch.
fn batch(count: usize, threads: usize, actions: &[f32]) -> Vec<(Vec<f32>, Vec<f64>, Vec<bool>)> {
    let config = TaskConfig { plants: family(), hold: 100, ..TaskConfig::default() };
    let task = Arc::new(Task::new(config).unwrap());
    let mut batch = Batch::new(&task, 7, count, threads).unwrap();
    let width = task.observations();
    let (mut observations, mut rewards, mut ended) =
        (vec![0.0; count * width], vec![0.0; count], vec![false; count]);
    let mut outcomes = Outcomes { observations: &mut observations, rewards: &mut rewards, ended: &mut ended };
    batch.reset(None, &mut outcomes).unwrap();
    let mut all = Vec::new();
    for action in actions {
        batch.step(&vec![*action; count], &mut outcomes).unwrap();
        all.push((outcomes.observations.to_vec(), outcomes.rewards.to_vec(), outcomes.ended.to_vec()));
    }
    all
}

#[test]
fn a_batch_does_not_depend_on_its_threads() {
    let actions: Vec<f32> = (0..25).map(|n| (n as f32 * 0.7).sin() * 0.3 - 0.6).collect();
    let alone = batch(9, 1, &actions);
    assert_eq!(batch(9, 2, &actions), alone);
    assert_eq!(batch(9, 4, &actions), alone);
    assert!(alone[9].2.iter().all(|ended| *ended) && !alone[10].2.contains(&true), "next-step reset");
}

#[test]
fn slices_of_another_length_are_refused() {
    let task = Arc::new(Task::new(TaskConfig::default()).unwrap());
    let mut batch = Batch::new(&task, 1, 2, 1).unwrap();
    let (mut observations, mut rewards, mut ended) = (vec![0.0; 47], vec![0.0; 2], vec![false; 2]);
    let mut outcomes = Outcomes { observations: &mut observations, rewards: &mut rewards, ended: &mut ended };
    assert!(matches!(batch.reset(None, &mut outcomes), Err(EnvironmentError::Length { .. })));
    assert!(matches!(batch.step(&[0.0], &mut outcomes), Err(EnvironmentError::Length { .. })));
    assert!(Batch::new(&task, 1, 0, 1).is_err() && Batch::new(&task, 1, 1, 0).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn any_actions_give_finite_rewards_and_one_end(
        actions in prop::collection::vec(-3.0_f32..3.0, 20),
        kind in prop::sample::select(vec![ObservationKind::Ours, ObservationKind::Authors, ObservationKind::Plain]),
        breathing: bool,
        number in 0_u32..1000,
    ) {
        let config = TaskConfig { plants: family(), breathing, hold: 50, observation: kind, ..TaskConfig::default() };
        let mut environment = environment(config);
        environment.reset_to(Choice { number: Some(number), ..Choice::default() }).unwrap();
        for (n, action) in actions.iter().enumerate() {
            let step = environment.step(*action).unwrap();
            let observation = environment.observation();
            prop_assert_eq!(observation.len(), kind.len());
            prop_assert!(step.reward.is_finite() && step.reward <= 0.0);
            prop_assert!(observation.iter().all(|value| value.is_finite()));
            prop_assert_eq!(step.ended, !environment.is_running());
            if step.ended {
                prop_assert!(n == 19 || environment.episode().fault.is_some());
                break;
            }
        }
        prop_assert!(!environment.is_running());
    }
}
