//! What the controller is taught of each breath, and when it forgets.

use super::*;

/// Follows lessons: the breaths that it was taught, in order.
struct Pupil;

impl ControlLaw for Pupil {
    type State = Vec<Lesson>;

    fn initial_state(&self) -> Vec<Lesson> {
        Vec::new()
    }

    fn learn(&self, state: &mut Vec<Lesson>, lesson: Lesson) -> Lesson {
        state.push(lesson);
        lesson
    }

    fn start_breath(&self, _: &mut Vec<Lesson>, _: f32) {}

    fn step(&self, _: &mut Vec<Lesson>, seen: &Observation) -> ControlOutput {
        ControlOutput::plain(2.0 * (seen.target - seen.pressure))
    }

    fn applied(&self, _: &mut Vec<Lesson>, _: f32) {}
}

/// The monitors for any plant, and that of missed ticks.
fn monitors() -> Monitors {
    let others =
        Fault::all().filter(|fault| !Monitors::ANY_PLANT.has(*fault) && *fault != Fault::MissedTicks);
    others.fold(Monitors::ALL, Monitors::without)
}

/// A ventilator with this pupil on a lung that follows the target, except that `disturb` may change the pressure of a breath's tick,
/// and the settings between breaths; returns the lessons of each breath, the first of which also forgets.
fn taught(
    breaths: u32,
    mut disturb: impl FnMut(&Ventilator<Pupil>, &mut VentilatorState<Vec<Lesson>>, &mut f32),
) -> Vec<Vec<Lesson>> {
    let ventilator = Ventilator::new(DEFAULT_PERIOD_US, Pupil).with_monitors(monitors());
    let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
    state.start();
    let mut lessons = Vec::new();
    for _ in 0..breaths {
        state.controller.clear();
        let number = state.breath_number();
        while state.breath_number() == number {
            let mut pressure = if state.tick() < 1000 { 18.0 } else { 5.0 };
            disturb(&ventilator, &mut state, &mut pressure);
            ventilator.step(&mut state, pressure);
        }
        lessons.push(state.controller.clone());
    }
    lessons
}

/// Runs ticks near the target.
fn run_any(ventilator: &Ventilator<Pupil>, state: &mut VentilatorState<Vec<Lesson>>, ticks: u32) {
    for _ in 0..ticks {
        ventilator.step(state, 18.0);
    }
}

#[test]
fn an_undisturbed_breath_is_adopted_once_and_the_first_of_all_forgets_what_was_before() {
    let lessons = taught(3, |_, _, _| ());
    assert_eq!(
        lessons,
        [std::vec![Lesson::Forget, Lesson::Adopt], std::vec![Lesson::Adopt], std::vec![Lesson::Adopt]]
    );
}

#[test]
fn the_controller_learns_in_the_first_tick_after_the_inspiration() {
    let ventilator = Ventilator::new(DEFAULT_PERIOD_US, Pupil).with_monitors(Monitors::ANY_PLANT);
    let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
    assert_eq!(state.lesson(), Lesson::Forget);
    state.start();
    run_any(&ventilator, &mut state, 1000);
    assert_eq!((state.controller.clone(), state.lesson()), (std::vec![Lesson::Forget], Lesson::Forget));
    ventilator.step(&mut state, 18.0);
    assert_eq!((state.controller.len(), state.lesson()), (2, Lesson::Adopt));
}

/// Lessons of the two breaths around a change from the paper's settings at PIP 20 to these.
fn taught_through_a_change_to(settings: Settings) -> [Vec<Lesson>; 2] {
    let mut lessons = taught(4, |ventilator, state, _| {
        if state.tick() == 500 {
            let unchanged = state.breath_number() < 2;
            let next = if unchanged { paper_settings(20.0) } else { settings };
            ventilator.apply(state, &next).unwrap();
        }
    });
    let after = lessons.pop().unwrap();
    [lessons.pop().unwrap(), after]
}

#[test]
fn changed_settings_make_the_controller_forget_and_the_same_settings_do_not() {
    let paper = paper_settings(20.0);
    let changes = [
        Settings { pip: 25.0, ..paper },
        Settings { pip: 16.9, ..paper },
        Settings { peep: 8.1, ..paper },
        Settings { pip: 21.0, rise_time: 0.1, ..paper },
        Settings { inspiratory_time: 1.1, ..paper },
    ];
    for settings in changes {
        let lessons = taught_through_a_change_to(settings);
        assert_eq!(
            lessons,
            [std::vec![Lesson::Adopt], std::vec![Lesson::Forget, Lesson::Adopt]],
            "{settings:?}"
        );
    }
}

#[test]
fn a_small_step_of_pip_or_peep_leaves_what_was_learned() {
    let paper = paper_settings(20.0);
    for (pip, peep) in [(23.0, 5.0), (17.0, 5.0), (20.0, 8.0), (22.0, 3.0), (20.0, 5.0)] {
        let lessons = taught_through_a_change_to(Settings { pip, peep, ..paper });
        assert_eq!(lessons, [std::vec![Lesson::Adopt], std::vec![Lesson::Adopt]], "PIP {pip}, PEEP {peep}");
    }
}

#[test]
fn a_breath_that_an_effort_triggers_is_left_out() {
    let mut efforts = 0;
    let lessons = taught(4, |_, state, pressure| {
        *pressure += fine(state.tick());
        // The patient draws in the second expiration.
        if state.breath_number() == 1 && state.tick() > 2600 {
            *pressure = 1.0;
            efforts += 1;
        }
    });
    assert!(efforts > 0 && efforts < 390, "the effort has triggered");
    assert_eq!(lessons[1], [Lesson::Adopt], "it came after the inspiration");
    assert_eq!(lessons[2], [Lesson::Discard]);
    assert_eq!(lessons[3], [Lesson::Adopt]);
}

#[test]
fn a_cough_that_reaches_the_pressure_limit_is_left_out() {
    let lessons = taught(3, |_, state, pressure| {
        if state.breath_number() == 1 && (300..600).contains(&state.tick()) {
            *pressure = 60.0;
        }
    });
    assert_eq!(lessons[1], [Lesson::Discard]);
    assert_eq!(lessons[2], [Lesson::Adopt]);
}

#[test]
fn a_breath_during_an_alarm_is_left_out() {
    let lessons = taught(3, |ventilator, state, _| {
        if state.breath_number() == 1 && state.tick() == 300 {
            ventilator.raise(state, Fault::MissedTicks);
        }
    });
    assert_eq!((&lessons[0][1..], &lessons[1][..]), (&[Lesson::Adopt][..], &[Lesson::Discard][..]));
}

/// Also under an alarm that takes nothing away from the network.
#[test]
fn breaths_are_left_out_until_an_alarm_is_no_longer_present() {
    let lessons = taught(6, |ventilator, state, _| {
        if state.breath_number() == 1 && state.tick() == 300 {
            ventilator.raise(state, Fault::HighPressure);
        }
        assert_eq!(state.level(), Level::Learned);
        // It stays for two breaths without a finding.
        let at = (state.breath_number(), state.tick());
        assert_eq!(!state.indications().present().is_empty(), ((1, 300)..=(3, 300)).contains(&at), "{at:?}");
    });
    let learned: Vec<_> = lessons.iter().filter_map(|lessons| lessons.last().copied()).collect();
    let (adopt, discard) = (Lesson::Adopt, Lesson::Discard);
    assert_eq!(learned, [adopt, discard, discard, discard, adopt, adopt]);
}

#[test]
fn a_perturbed_breath_is_left_out() {
    let ventilator = Ventilator::new(DEFAULT_PERIOD_US, Pupil)
        .with_monitors(Monitors::ANY_PLANT)
        .with_exploration(Some(Exploration { boundary_probability: 1.0, ..Exploration::default() }));
    let mut state = ventilator.standby(&paper_settings(20.0)).unwrap();
    state.start();
    run_any(&ventilator, &mut state, 1001);
    assert_eq!(state.controller, [Lesson::Forget, Lesson::Discard]);
}
