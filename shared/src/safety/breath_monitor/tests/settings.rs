//! What settings that change mean for the checks of each breath.

use super::*;

/// Breaths at settings of their own, of which each differs so much from the one before that breaths have to settle; the first fault.
fn complaint_at(breaths: &[(Settings, Seen)]) -> Option<(usize, Fault)> {
    let mut state = BreathState::default();
    let mut peep = breaths[0].0.peep;
    breaths.iter().enumerate().find_map(|(number, (settings, seen))| {
        state.settings_changed(peep);
        peep = settings.peep;
        let breath = Breath::new(settings, DEFAULT_PERIOD_US).unwrap();
        found(&mut state, &breath, &[*seen]).first().map(|(_, fault)| (number, *fault))
    })
}

#[test]
fn after_a_change_of_the_settings_two_baselines_are_not_judged_and_those_before_are_forgotten() {
    let changed = |before: &[Seen], after: &[Seen]| {
        let mut state = BreathState::default();
        found(&mut state, &breath(), before);
        state.settings_changed(5.0);
        found(&mut state, &breath(), after)
    };
    let (high, low) = (Seen { baseline: 8.5, before: 8.5, ..GOOD }, Seen { baseline: 2.5, ..GOOD });
    assert_eq!(changed(&[high], &[high; 4]), [(3, Fault::BaselineHigh)]);
    assert_eq!(changed(&[low; 2], &[low; 5]), [(4, Fault::BaselineLow)]);
    assert_eq!(changed(&[GOOD], &[high, high, GOOD, high]), []);
}

#[test]
fn settings_that_change_in_every_breath_hide_no_baseline() {
    let at = |peep: f32, pressure: f32| {
        (Settings { peep, ..paper_settings(25.0) }, Seen { baseline: pressure, before: pressure, ..GOOD })
    };
    let stuck = |pressure: f32, peeps: [f32; 2]| -> Vec<_> {
        (0..20).map(|number| at(peeps[number % 2], pressure)).collect()
    };
    // Two breaths are waited for once.
    assert_eq!(complaint_at(&stuck(15.0, [5.0, 6.0])), Some((3, Fault::BaselineHigh)));
    assert_eq!(complaint_at(&stuck(2.0, [5.0, 6.0])), Some((4, Fault::BaselineLow)));
    // The pressure is right in every other breath.
    assert_eq!(complaint_at(&stuck(15.0, [5.0, 15.0])), Some((4, Fault::BaselineHigh)));
    assert_eq!(complaint_at(&stuck(0.0, [10.0, 1.5])), Some((6, Fault::BaselineLow)));
    let sound: Vec<_> = (0..20).map(|number| [at(5.0, 5.1), at(15.0, 15.1)][number % 2]).collect();
    assert_eq!(complaint_at(&sound), None);
    let once: Vec<_> = (0..20)
        .map(|number| [at(5.0, if number == 6 { 9.0 } else { 5.1 }), at(8.5, 8.4)][number % 2])
        .collect();
    assert_eq!(complaint_at(&once), None, "one high baseline");
    let efforts: Vec<_> = (0..20).map(|number| [at(5.0, 2.5), at(5.0, 5.1)][number % 2]).collect();
    assert_eq!(complaint_at(&efforts), None, "low in every other breath, at a PEEP that stays");
}

#[test]
fn while_the_settings_change_a_baseline_that_still_falls_is_trapped_gas_only_in_the_fourth_breath() {
    let complaint = |fall: f32, changes: bool| {
        let (breath, monitor) = (breath(), BreathMonitor::new(DEFAULT_PERIOD_US, Monitors::ALL));
        let mut state = BreathState::default();
        (0..9).find(|_| {
            if changes {
                state.settings_changed(5.0);
            }
            (0..breath.total_ticks()).any(|tick| {
                let at_end = if tick + 50 >= breath.total_ticks() { 0.0 } else { fall };
                let input = BreathInput { pressure: 9.0 + at_end, ..GOOD.at(&breath, tick) };
                let input = if breath.at(tick).inspires() { GOOD.at(&breath, tick) } else { input };
                monitor.check(&mut state, &input).is_some()
            })
        })
    };
    assert_eq!((complaint(0.2, true), complaint(0.05, true)), (Some(2 + 3), Some(2 + 1)));
    assert_eq!(complaint(0.2, false), Some(1), "settings at rest");
}

#[test]
fn an_inspiration_that_fills_a_lung_to_a_higher_peep_is_not_weak() {
    let raised = |plateau: f32, pips: f32| {
        let weak = Seen { plateau, before: plateau, baseline: 14.9, command: 90.0, ..GOOD };
        let at = |peep: f32| Settings { peep, ..paper_settings(pips) };
        let (before, after) = (Seen { before: 5.0, ..GOOD }, (at(15.0), weak));
        complaint_at(&[(at(5.0), before), after, after])
    };
    // 30 % of the rise from 15 to 25, from the PEEP before: 8 cmH2O.
    assert_eq!(raised(8.1, 25.0), None);
    assert_eq!(raised(7.9, 25.0), Some((2, Fault::LowPressure)));
}

#[test]
fn a_shorter_inspiration_may_take_as_much_less_and_an_occluded_tube_takes_less_still() {
    let at = |inspiratory_time: f32, volume: f32| {
        (Settings { inspiratory_time, ..paper_settings(25.0) }, Seen { volume, ..GOOD })
    };
    // 1 s of 3 s against 0.5 s: 0.67 against 0.42 s for the slowest lung; a third of 62 % of 400 mL.
    assert_eq!(complaint_at(&[at(1.0, 400.0), at(0.5, 84.0), at(0.5, 84.0)]), None);
    assert_eq!(complaint_at(&[at(1.0, 400.0), at(0.5, 82.0), at(0.5, 82.0)]), Some((2, Fault::Occlusion)));
    assert_eq!(complaint_at(&[at(0.5, 400.0), at(1.0, 132.0), at(1.0, 132.0)]), Some((2, Fault::Occlusion)));
    // However often it alternates before and after.
    let alternate: Vec<_> = (0..30)
        .map(|n| {
            [at(1.0, if n < 20 { 400.0 } else { 40.0 }), at(0.5, if n < 20 { 300.0 } else { 40.0 })][n % 2]
        })
        .collect();
    assert_eq!(complaint_at(&alternate), Some((21, Fault::Occlusion)));
}

#[test]
fn a_lung_that_a_higher_peep_has_left_is_no_occluded_tube() {
    let at = |peep: f32, volume: f32| {
        (Settings { peep, ..paper_settings(25.0) }, Seen { volume, baseline: peep, before: peep, ..GOOD })
    };
    // From 20 to 25 cmH2O it takes a quarter of the gas; then from 5 on, somewhat less than before.
    assert_eq!(complaint_at(&[at(20.0, 100.0), at(5.0, 100.0), at(20.0, 100.0)]), None);
    // What is missing is missing at any PEEP.
    let occluded = [at(20.0, 100.0), at(5.0, 400.0), at(20.0, 30.0), at(5.0, 30.0)];
    assert_eq!(complaint_at(&occluded), Some((3, Fault::Occlusion)));
    let slow = |second: f32| {
        let mut state = BreathState::default();
        let breaths = [at(20.0, 100.0), at(5.0, 100.0)].map(|(settings, seen)| {
            state.settings_changed(20.0);
            found(&mut state, &Breath::new(&settings, DEFAULT_PERIOD_US).unwrap(), &[seen])
        });
        assert!(breaths.iter().all(Vec::is_empty));
        let rested = Breath::new(&at(5.0, 0.0).0, DEFAULT_PERIOD_US).unwrap();
        let seen = Seen { volume: second, ..GOOD };
        found(&mut state, &rested, &[seen; 2])
    };
    assert_eq!(slow(140.0), [], "7 mL/cmH2O after 20");
    assert_eq!(slow(130.0), [(1, Fault::Occlusion)], "6.5 mL/cmH2O after 20");
}
