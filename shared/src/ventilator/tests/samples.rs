//! What the record of a tick tells beyond pressure and command: the learned part and the flow.

use super::*;

/// Asks for commands that change with the tick, the learned one by another amount than the PID's.
#[derive(Clone)]
struct Split;

impl Split {
    fn parts(tick: u32) -> ControlOutput {
        ControlOutput { base: 20.1 + 0.013 * tick as f32, command: 33.7 - 0.017 * tick as f32 }
    }
}

impl ControlLaw for Split {
    type State = ();

    fn initial_state(&self) {}

    fn start_breath(&self, (): &mut (), _: f32) {}

    fn step(&self, (): &mut (), seen: &Observation) -> ControlOutput {
        Self::parts(seen.tick)
    }

    fn applied(&self, (): &mut (), _: f32) {}
}

/// Runs ticks on readings by the tick of the breath; returns the level and the sample of each.
fn levels<C: ControlLaw>(
    ventilator: &Ventilator<C>,
    state: &mut VentilatorState<C::State>,
    ticks: u32,
    readings: impl Fn(u32) -> Readings,
) -> Vec<(Level, Sample)> {
    let step = |_| {
        let sample = ventilator.step(state, readings(state.tick())).sample.unwrap();
        (state.level(), sample)
    };
    (0..ticks).map(step).collect()
}

#[test]
fn the_learned_part_is_the_difference_to_the_pid_in_inspirations_also_while_exploring() {
    let quiet = Ventilator::new(DEFAULT_PERIOD_US, Split).with_monitors(Monitors::ANY_PLANT);
    let exploring = quiet.clone().with_exploration(Some(Exploration {
        boundary_probability: 1.0,
        boundary_height: (10.0, 10.0),
        ..Exploration::default()
    }));
    for ventilator in [quiet, exploring] {
        let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
        state.start();
        for (level, sample) in levels(&ventilator, &mut state, 6000, |_| Readings::from(15.0)) {
            let parts = Split::parts(sample.tick);
            let inspires = sample.phase == Phase::Inspiration;
            let expected = if inspires { parts.command - parts.base } else { 0.0 };
            assert_eq!((level, sample.learned.to_bits()), (Level::Learned, expected.to_bits()), "{sample:?}");
        }
    }
}

#[test]
fn the_learned_part_is_exactly_zero_below_the_top_of_the_ladder() {
    let seen = |monitors: Monitors, start: fn(&mut VentilatorState), readings: &dyn Fn(u32) -> Readings| {
        let ventilator = learned(25.0).with_monitors(monitors);
        let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
        start(&mut state);
        let samples = levels(&ventilator, &mut state, 3000, readings);
        let inspired = samples.iter().filter(|(_, sample)| sample.phase == Phase::Inspiration);
        inspired.map(|(level, sample)| (*level, sample.learned.to_bits())).collect::<Vec<_>>()
    };
    let steady = |_| Readings::from(15.0);
    let noisy = |tick: u32| Readings::from(15.0 + 1.2 * ((tick * 7 % 5) as f32 - 2.0));
    let ends = |tick: u32| Readings::from(if tick < 100 { 15.0 + 0.1 * (tick % 3) as f32 } else { f32::NAN });
    let runs = [
        (Level::Pid, seen(Monitors::ANY_PLANT, VentilatorState::resume, &steady)),
        (Level::CappedPid, seen(Monitors::ALL, VentilatorState::start, &noisy)),
        (Level::Backup, seen(Monitors::ALL, VentilatorState::start, &ends)),
    ];
    for (lower, ticks) in runs {
        assert!(ticks.iter().any(|(level, _)| *level == lower), "{lower:?} is never reached");
        for (level, learned) in ticks {
            assert_eq!(learned != 0, level == Level::Learned, "{level:?}");
        }
    }
}

#[test]
fn a_pid_has_no_learned_part() {
    let ventilator = ventilator();
    let samples = levels(&ventilator, &mut started(&ventilator), 3000, |_| Readings::from(15.0));
    assert!(samples.iter().all(|(_, sample)| sample.learned.to_bits() == 0));
}

#[test]
fn the_flow_is_recorded_as_it_is_read_and_a_missing_one_is_none() {
    let ventilator = ventilator();
    let flow = |tick: u32| if tick % 10 == 9 { f32::NAN } else { 0.4 - 0.0003 * tick as f32 };
    let readings = |tick| Readings { flow: flow(tick), ..Readings::from(15.0) };
    for (_, sample) in levels(&ventilator, &mut started(&ventilator), 3000, readings) {
        let flow = flow(sample.tick);
        assert_eq!(sample.flow, (!flow.is_nan()).then_some(flow));
    }
}
