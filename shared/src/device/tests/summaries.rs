//! The summary of a breath: its leak, and what the controller made of it.

use super::*;

#[test]
fn the_summary_of_a_breath_tells_the_leak_that_the_breaths_before_have_shown() {
    // 400 mL go in and 200 mL come out, in 3 s at 9 cmH2O: a leak of 0.2 L / (3 s * 3 cmH2O^0.5).
    let leaks = |tick| {
        let flow = match tick {
            0..1000 => 0.4,
            1000..2000 => -0.2,
            _ => 0.0,
        };
        Readings { flow, ..Readings::from(9.0) }
    };
    let mut rig = Rig::new(None);
    rig.start();
    rig.run_on(4 * TICKS_OF_A_BREATH, leaks);
    rig.run_at(TICKS_OF_A_BREATH + 1, 9.0);
    let known: Vec<_> = rig.breaths().iter().map(|breath| breath.leak).collect();
    assert!(known[2..4].iter().all(|leak| (leak.unwrap() - 0.2 / 9.0).abs() < 1e-4), "{known:?}");
    assert_eq!((known.len(), known[0], known[4]), (5, None, None), "not measured yet, and not any more");
    let mut blind = Rig::new(None);
    blind.start();
    blind.run_at(4 * TICKS_OF_A_BREATH + 1, 9.0);
    assert_eq!(blind.breaths().iter().map(|breath| breath.leak).collect::<Vec<_>>(), [None; 4]);
}

#[test]
fn the_summary_of_a_breath_tells_what_the_controller_made_of_it_and_how_many_it_remembers() {
    let mut rig = Rig::new(Some(&residual()));
    rig.start();
    rig.run(6 * TICKS_OF_A_BREATH + 500);
    // A missed tick in the inspiration of the seventh breath.
    rig.control.record(&late(1));
    rig.run(TICKS_OF_A_BREATH);
    rig.ask(Request::ApplySettings(paper_settings(25.0)));
    rig.run(2 * TICKS_OF_A_BREATH);
    let lessons: Vec<_> = rig.breaths().iter().map(|breath| (breath.lesson, breath.adopted)).collect();
    let adopted = |count| (Lesson::Adopt, count);
    let first = [1, 2, 3, LEARNING, LEARNING, LEARNING].map(adopted);
    let rest = [(Lesson::Discard, LEARNING), (Lesson::Forget, 0), adopted(1)];
    assert_eq!(lessons, [&first[..], &rest].concat());
}

#[test]
fn a_pid_remembers_no_breath() {
    let mut rig = Rig::new(Some(&residual()));
    rig.ask(Request::SetController(ControllerChoice::Pid(KNOWN_GOOD)));
    rig.start();
    rig.run(3 * TICKS_OF_A_BREATH + 1);
    let lessons: Vec<_> = rig.breaths().iter().map(|breath| (breath.lesson, breath.adopted)).collect();
    assert_eq!(lessons, [(Lesson::Forget, 0); 3]);
}
