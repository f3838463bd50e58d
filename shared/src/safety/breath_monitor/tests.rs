//! Tests of the checks of each breath.

use super::*;
use crate::breath::{Breath, DEFAULT_PERIOD_US, Phase, paper_settings};
use crate::settings::Settings;
use std::vec::Vec;

mod open_tube;
mod settings;

/// Input of the monitor in one breath: pressure and volume at the end of the inspiration, pressure at the end of the
/// expiration, pressure until 50 ms before the end of each phase, a constant command.
#[derive(Clone, Copy)]
struct Seen {
    plateau: f32,
    volume: f32,
    baseline: f32,
    before: f32,
    command: f32,
    /// Tick at which the inspiration was ended at the pressure limit; from the next one on the pressure is `before`.
    cut: Option<u32>,
}

const GOOD: Seen =
    Seen { plateau: 25.0, volume: 400.0, baseline: 5.1, before: 15.0, command: 10.0, cut: None };
/// A breath that meets the limit of 60 cmH2O.
const CUT: Seen = Seen { plateau: 60.0, volume: 1100.0, cut: Some(300), ..GOOD };

fn breath() -> Breath {
    Breath::new(&paper_settings(25.0), DEFAULT_PERIOD_US).unwrap()
}

impl Seen {
    fn at<'a>(&self, breath: &'a Breath, tick: u32) -> BreathInput<'a> {
        let Self { plateau, volume, baseline, before, command, cut } = *self;
        let inspires = breath.phase(tick) == Phase::Inspiration;
        let (end, at_end) =
            if inspires { (breath.inspiration_ticks(), plateau) } else { (breath.total_ticks(), baseline) };
        let pressure = match cut {
            Some(cut) if inspires => {
                if tick <= cut {
                    plateau
                } else {
                    before
                }
            }
            _ => {
                if tick + 50 >= end {
                    at_end
                } else {
                    before
                }
            }
        };
        let cut = cut.is_some_and(|cut| tick >= cut);
        BreathInput {
            moment: breath.at(tick),
            cut,
            pressure,
            command,
            cap: Cap::None,
            volume,
            share: 1.0,
            reached: None,
            inspired: None,
            returned: 0.0,
            refill: 0.0,
            leaks: false,
            flow: None,
            doubtful: false,
            moved: 0.0,
            last: None,
        }
    }
}

/// The first fault in a sequence of breaths, with the index of the breath.
fn complaint(breaths: &[Seen]) -> Option<(usize, Fault)> {
    complaint_with(breaths, |_| {})
}

/// The same of breaths of which each tick is altered.
fn complaint_with(breaths: &[Seen], alter: impl Fn(&mut BreathInput<'_>)) -> Option<(usize, Fault)> {
    let (breath, monitor) = (breath(), BreathMonitor::new(DEFAULT_PERIOD_US, Monitors::ALL));
    let mut state = BreathState::default();
    for (number, seen) in breaths.iter().enumerate() {
        for tick in 0..breath.total_ticks() {
            let mut input = seen.at(&breath, tick);
            alter(&mut input);
            if let Some(fault) = monitor.check(&mut state, &input) {
                return Some((number, fault));
            }
        }
    }
    None
}

fn volumes(inspired: f32, expired: f32) -> BreathVolumes {
    BreathVolumes { inspired, expired, leaked: 0.0 }
}

fn inspires(input: &BreathInput) -> bool {
    input.moment.inspires()
}

#[test]
fn good_breaths_give_no_complaint() {
    assert_eq!(complaint(&[GOOD; 10]), None);
    let soft = Seen { volume: 800.0, ..GOOD };
    let stiff = Seen { volume: 300.0, ..GOOD };
    assert_eq!(complaint(&[GOOD, soft, stiff, soft, GOOD]), None);
}

#[test]
fn an_expiration_that_stays_high_is_found_in_its_second_breath() {
    let high = Seen { baseline: 8.5, ..GOOD };
    assert_eq!(complaint(&[GOOD, high, high, GOOD]), Some((2, Fault::BaselineHigh)));
    assert_eq!(complaint(&[high, GOOD, high, GOOD]), None, "never twice in a row");
    assert_eq!(complaint(&[Seen { baseline: 8.0, ..GOOD }; 4]), None, "at the bound");
}

#[test]
fn a_lost_peep_is_found_in_its_third_breath() {
    let low = Seen { baseline: 2.5, ..GOOD };
    assert_eq!(complaint(&[GOOD, low, low, low]), Some((3, Fault::BaselineLow)));
    assert_eq!(complaint(&[low, low, GOOD, low, low]), None);
    assert_eq!(
        complaint(&[
            GOOD,
            Seen { baseline: 3.0, ..GOOD },
            Seen { baseline: 3.0, ..GOOD },
            Seen { baseline: 3.0, ..GOOD }
        ]),
        None,
        "at the bound"
    );
}

#[test]
fn what_an_effort_draws_below_peep_is_no_lost_peep() {
    let low = Seen { baseline: 2.5, ..GOOD };
    assert_eq!(complaint_with(&[low; 9], |input| input.moved = 1.1), None);
    assert_eq!(complaint_with(&[low; 9], |input| input.moved = 1.0), Some((2, Fault::BaselineLow)));
}

#[test]
fn an_expiration_that_an_effort_ends_is_judged_by_its_pressure_before() {
    let (breath, monitor) = (breath(), BreathMonitor::new(DEFAULT_PERIOD_US, Monitors::ALL));
    // Breaths that end at a tick, the last 50 ms of them at another pressure.
    let triggered = |count: usize, pressure: f32, effort: f32, end: u32| {
        let mut state = BreathState::default();
        let mut found = None;
        for _ in 0..count {
            for tick in 0..end {
                let pressure = if tick + 50 >= end { effort } else { pressure };
                let input = BreathInput { pressure, ..GOOD.at(&breath, tick) };
                assert_eq!(monitor.check(&mut state, &input), None);
            }
            found = monitor.triggered(&mut state, breath.settings().peep, end > 1800, false);
        }
        found
    };
    assert_eq!(triggered(2, 8.5, 5.0, 2500), Some(Fault::BaselineHigh));
    assert_eq!(triggered(1, 8.5, 5.0, 2500), None);
    assert_eq!(triggered(3, 8.5, 5.0, 1800), None, "still emptying");
    assert_eq!(triggered(4, 8.5, 5.0, 1800), Some(Fault::BaselineHigh), "trapped gas");
    assert_eq!(triggered(9, 8.0, 5.0, 1800), None, "at the bound");
    assert_eq!(triggered(3, 2.5, 5.0, 1800), Some(Fault::BaselineLow));
    assert_eq!(triggered(3, 2.5, 5.0, 2500), Some(Fault::BaselineLow));
    assert_eq!(triggered(9, 5.0, 0.0, 2500), None, "the effort itself");
    assert_eq!(triggered(9, 8.5, 8.5, 1100), Some(Fault::BaselineHigh), "in the fall");
    assert_eq!(triggered(9, 8.5, 8.5, 1099), None, "too short to tell");
}

#[test]
fn breaths_that_end_above_peep_add_up_however_they_end() {
    let (breath, monitor) = (breath(), BreathMonitor::new(DEFAULT_PERIOD_US, Monitors::ALL));
    // The breaths that raise the alarm; each ends at a tick and a pressure.
    let found = |ends: &[(u32, f32)]| {
        let mut state = BreathState::default();
        let raises = |(end, pressure): &(u32, f32)| {
            let seen = Seen { baseline: *pressure, before: *pressure, ..GOOD };
            let found = (0..*end).any(|tick| monitor.check(&mut state, &seen.at(&breath, tick)).is_some());
            let early = *end < breath.total_ticks();
            found || (early && monitor.triggered(&mut state, breath.settings().peep, false, false).is_some())
        };
        ends.iter().map(raises).collect::<Vec<_>>()
    };
    let (early, whole, low) = ((1800, 8.5), (3000, 8.5), (1800, 5.0));
    assert_eq!(found(&[early, early, whole, early]), [false, false, false, true]);
    assert_eq!(found(&[early, early, early, whole]), [false, false, false, true]);
    assert_eq!(found(&[early, early, early, low, early]), [false; 5]);
    assert_eq!(found(&[whole, early, whole]), [false, false, true], "two that had time to empty");
    assert_eq!(found(&[whole, low, whole]), [false; 3], "the one between has emptied");
}

#[test]
fn a_weak_inspiration_is_found_only_with_the_valve_wide_open() {
    let weak = Seen { plateau: 9.0, command: 100.0, ..GOOD };
    assert_eq!(complaint(&[GOOD, weak, weak]), Some((2, Fault::LowPressure)));
    assert_eq!(complaint(&[Seen { command: 20.0, ..weak }; 4]), None, "a controller that asks for little");
    assert_eq!(complaint(&[Seen { command: 60.0, ..weak }; 4]), None, "not yet wide open");
    assert_eq!(complaint(&[Seen { plateau: 11.0, ..weak }; 4]), None, "just enough");
    assert_eq!(
        complaint(&[Seen { command: 100.0, ..GOOD }; 4]),
        None,
        "a wide open valve that does its work"
    );
}

#[test]
fn a_pressure_that_is_gone_is_found_within_the_inspiration() {
    let gone = Seen { plateau: 1.0, before: 1.0, command: 100.0, ..GOOD };
    assert_eq!(complaint(&[GOOD, gone]), Some((1, Fault::Disconnection)));
    let just = Seen { plateau: 1.9, before: 1.9, ..gone };
    assert_eq!(complaint(&[GOOD, just]), Some((1, Fault::Disconnection)));
    assert_eq!(complaint(&[Seen { command: 30.0, ..gone }; 2]), None, "a valve that is hardly open");
    assert_eq!(complaint(&[GOOD, Seen { plateau: 2.0, before: 2.0, ..gone }]), None, "an effort");
    let empty_expiration = |input: &mut BreathInput<'_>| {
        if !inspires(input) {
            input.pressure = 1.0;
        }
    };
    assert_eq!(complaint_with(&[Seen { command: 100.0, ..GOOD }; 2], empty_expiration), None);
    assert_eq!(complaint(&[Seen { before: 1.0, command: 100.0, ..CUT }]), None, "after the limit");
}

#[test]
fn a_pressure_is_gone_for_longer_while_the_command_is_capped() {
    let (breath, monitor) = (breath(), BreathMonitor::new(DEFAULT_PERIOD_US, Monitors::ALL));
    let gone = Seen { plateau: 1.0, before: 1.0, baseline: 1.0, command: 40.0, ..GOOD };
    let found = |cap: Cap| {
        let mut state = BreathState::default();
        (0..2 * breath.total_ticks()).find(|tick| {
            let input = gone.at(&breath, tick % breath.total_ticks());
            monitor.check(&mut state, &BreathInput { cap, ..input }) == Some(Fault::Disconnection)
        })
    };
    // The inspiration of 1 s is too short for the second time: the next one goes on with it.
    let capped = Some(3000 + 199);
    assert_eq!([Cap::None, Cap::ByLimit, Cap::ByNoise].map(found), [Some(599), capped, capped]);
}

#[test]
fn an_inspiration_that_noise_keeps_from_its_pressure_is_weak_below_four_fifths_of_the_rise() {
    let found = |cap: Cap, plateau: f32| {
        complaint_with(&[Seen { plateau, before: plateau, ..GOOD }; 3], |input| input.cap = cap)
    };
    assert_eq!(found(Cap::ByNoise, 20.9), Some((1, Fault::LowPressure)));
    assert_eq!([found(Cap::ByNoise, 21.1), found(Cap::ByLimit, 20.9), found(Cap::None, 20.9)], [None; 3]);
}

#[test]
fn a_pressure_without_a_flow_to_the_patient_is_no_open_tube() {
    let gone = Seen { plateau: 1.0, before: 1.0, command: 100.0, ..GOOD };
    let found = |flow| complaint_with(&[gone], |input| input.flow = flow);
    let open = Some((0, Fault::Disconnection));
    assert_eq!((found(None), found(Some(0.02)), found(Some(0.019))), (open, open, None));
}

#[test]
fn a_baseline_that_only_one_of_two_sensors_shows_is_none() {
    let high = Seen { baseline: 9.0, before: 9.0, ..GOOD };
    let found = |doubtful| complaint_with(&[high; 3], |input| input.doubtful = doubtful);
    assert_eq!((found(false), found(true)), (Some((1, Fault::BaselineHigh)), None));
}

#[test]
fn another_sensor_has_no_compliance_to_compare_with() {
    let stiff = Seen { volume: 20.0, ..GOOD };
    let occluded = |changes: bool| {
        let mut state = BreathState::default();
        found(&mut state, &breath(), &[GOOD; 2]);
        if changes {
            state.sensor_changed();
        }
        !found(&mut state, &breath(), &[stiff; 3]).is_empty()
    };
    assert!(occluded(false) && !occluded(true));
}

#[test]
fn only_an_inspiration_tells_that_the_pressure_is_back() {
    let (breath, monitor) = (breath(), BreathMonitor::new(DEFAULT_PERIOD_US, Monitors::ALL));
    let gone = Seen { plateau: 1.0, before: 1.0, command: 40.0, ..GOOD };
    let disconnected = |between: (u32, f32, f32, bool)| {
        let (mut state, (tick, pressure, command, cut)) = (BreathState::default(), between);
        let ticks = (0..500).map(|tick| gone.at(&breath, tick));
        let middle = BreathInput { cut, pressure, command, ..gone.at(&breath, tick) };
        let all = ticks.clone().chain([middle]).chain(ticks.take(100));
        all.map(|input| monitor.check(&mut state, &input)).any(|found| found == Some(Fault::Disconnection))
    };
    assert!(!disconnected((500, 2.0, 40.0, false)), "an effort has ended");
    assert!(disconnected((1500, 5.0, 0.0, false)), "an expiration");
    assert!(disconnected((500, 5.0, 0.0, true)), "cut at the limit");
    assert!(disconnected((500, 1.0, 0.0, false)), "little gas");
}

#[test]
fn a_tube_that_takes_no_volume_is_found_in_its_second_breath() {
    let occluded = Seen { volume: 40.0, ..GOOD };
    assert_eq!(complaint(&[GOOD, GOOD, occluded, occluded]), Some((3, Fault::Occlusion)));
    assert_eq!(complaint(&[GOOD, occluded, GOOD, occluded]), None);
    // 24 mL/cmH2O before; a third of it is still believed.
    let filled = |volume| Seen { volume, ..GOOD };
    assert_eq!(complaint(&[filled(480.0), filled(160.0), filled(160.0)]), None);
    assert_eq!(complaint(&[filled(480.0), filled(159.0), filled(159.0)]), Some((2, Fault::Occlusion)));
}

#[test]
fn an_inspiration_that_refills_the_lung_is_no_measure_of_the_others() {
    let refilled = Seen { volume: 1300.0, ..GOOD };
    let found = |refill: f32| {
        complaint_with(&[refilled, GOOD, GOOD], |input| {
            input.refill = if input.volume > 1000.0 { refill } else { 0.0 };
        })
    };
    assert_eq!((found(259.0), found(261.0)), (Some((2, Fault::Occlusion)), None));
    let occluded = Seen { volume: 40.0, ..GOOD };
    assert_eq!(complaint_with(&[GOOD, occluded, occluded], |input| input.refill = 9.0), None);
}

#[test]
fn gas_that_comes_out_has_been_in_the_lung_whatever_the_ratio_of_volume_and_pressure() {
    let low = Seen { volume: 100.0, ..GOOD };
    let with =
        |breaths: &[Seen], expired| complaint_with(breaths, |input| input.last = Some(volumes(1.0, expired)));
    let lows = [[GOOD].as_slice(), &[low; 12]].concat();
    assert_eq!(with(&lows, 80.0), None, "efforts took more gas before");
    assert_eq!(with(&lows, 79.0), Some((10, Fault::Occlusion)), "a narrowed tube");
    assert_eq!(with(&lows, 50.0), Some((10, Fault::Occlusion)));
    assert_eq!(with(&lows, 49.0), Some((2, Fault::Occlusion)), "it stays in the circuit");
    let cough = Seen { volume: 60.0, ..CUT };
    let train: Vec<Seen> = [GOOD].into_iter().chain([cough; 12]).collect();
    assert_eq!(with(&train, 30.0), None);
    assert_eq!(with(&[GOOD, cough, cough], 29.0), Some((2, Fault::Occlusion)));
}

#[test]
fn gas_that_an_effort_takes_in_an_expiration_has_passed_the_tube() {
    let lows = [[GOOD].as_slice(), &[Seen { volume: 100.0, ..GOOD }; 12]].concat();
    let with = |inspired| complaint_with(&lows, |input| input.last = Some(volumes(inspired, 1.0)));
    assert_eq!(with(50.0), Some((10, Fault::Occlusion)), "a narrowed tube");
    assert_eq!(with(49.0), Some((2, Fault::Occlusion)), "it stays in the circuit");
}

#[test]
fn gas_that_reaches_the_patient_has_passed_the_tube() {
    let lows = [[GOOD].as_slice(), &[Seen { volume: 100.0, ..GOOD }; 12]].concat();
    let with = |reached| complaint_with(&lows, |input| input.reached = Some(reached));
    assert_eq!(with(50.0), Some((10, Fault::Occlusion)), "a narrowed tube");
    assert_eq!(with(49.0), Some((2, Fault::Occlusion)), "it stays in the circuit");
}

#[test]
fn a_breath_is_compared_with_the_smaller_of_the_last_two_good_ones() {
    let filled = |volume| Seen { volume, ..GOOD };
    // An effort doubles a volume; the next breaths have a quarter of that.
    let (drawn, small) = (filled(800.0), filled(200.0));
    assert_eq!(complaint(&[GOOD, drawn, small, small, small]), None);
    assert_eq!(complaint(&[drawn, GOOD, small, small, small]), None);
    assert_eq!(complaint(&[drawn, drawn, small, small]), Some((3, Fault::Occlusion)));
}

#[test]
fn a_lengthened_expiration_is_no_part_of_the_next_inspirations_mean() {
    let (monitor, mut state) = (BreathMonitor::new(1000, Monitors::ALL), BreathState::default());
    let breath = breath();
    let low = Seen { volume: 160.0, ..GOOD };
    let found = [GOOD, low, low].iter().find_map(|seen| {
        (0..breath.total_ticks() + 900).find_map(|tick| monitor.check(&mut state, &seen.at(&breath, tick)))
    });
    assert_eq!(found, None, "8 mL/cmH2O after 20");
    assert!(state.compliance(9.0).is_some_and(|compliance| (compliance - 8.0).abs() < 0.1));
}

#[test]
fn a_leak_that_is_mended_is_no_occlusion() {
    let leaky = Seen { volume: 1300.0, ..GOOD };
    let leaks = |input: &mut BreathInput<'_>| input.leaks = input.volume > 1000.0;
    let breaths = [leaky, leaky, leaky, GOOD, GOOD, GOOD];
    assert_eq!(complaint(&breaths), Some((4, Fault::Occlusion)));
    assert_eq!(complaint_with(&breaths, leaks), None);
    assert_eq!(
        complaint_with(
            &[GOOD, leaky, leaky, Seen { volume: 40.0, ..GOOD }, Seen { volume: 40.0, ..GOOD }],
            leaks
        ),
        Some((4, Fault::Occlusion))
    );
}

#[test]
fn a_breath_that_is_cut_short_tells_of_the_tube_alone_and_once() {
    assert_eq!(complaint(&[CUT; 4]), None);
    let filled = |volume| Seen { volume, ..CUT };
    // 20 mL/cmH2O before, and 55 cmH2O above PEEP.
    assert_eq!(complaint(&[GOOD, filled(370.0), filled(370.0), filled(370.0)]), None);
    let occluded = filled(360.0);
    assert_eq!(complaint(&[GOOD, occluded, occluded]), Some((2, Fault::Occlusion)));
    let stays_high = Seen { baseline: 8.5, ..GOOD };
    assert_eq!(complaint(&[GOOD, stays_high, occluded, occluded, GOOD]), None, "the valve has failed");
    let low = Seen { baseline: 1.0, ..CUT };
    assert_eq!(complaint(&[low; 6]), None, "the lung holds less than at PEEP");
    let weak = Seen { before: 6.0, command: 100.0, ..CUT };
    assert_eq!(complaint(&[weak; 4]), None, "no inspiration to judge");
}

#[test]
fn a_phase_is_judged_by_the_mean_over_its_end() {
    let at_last = |input: &BreathInput| input.moment.ends_inspiration();
    let open = Seen { command: 100.0, ..GOOD };
    let one_low_reading = |input: &mut BreathInput<'_>| {
        if at_last(input) {
            input.pressure = 5.0;
        }
    };
    assert_eq!(complaint_with(&[open; 4], one_low_reading), None);
    let weak = Seen { plateau: 9.0, ..GOOD };
    let one_high_command = |input: &mut BreathInput<'_>| {
        if at_last(input) {
            input.command = 100.0;
        }
    };
    assert_eq!(complaint_with(&[weak; 4], one_high_command), None);
}

/// All faults in breaths that go on from a state, each with the index of its breath.
fn found(state: &mut BreathState, breath: &Breath, breaths: &[Seen]) -> Vec<(usize, Fault)> {
    let monitor = BreathMonitor::new(DEFAULT_PERIOD_US, Monitors::ALL);
    let ticks = breaths.iter().enumerate().flat_map(|seen| (0..breath.total_ticks()).map(move |t| (seen, t)));
    let mut found: Vec<_> = ticks
        .filter_map(|((n, seen), tick)| Some((n, monitor.check(state, &seen.at(breath, tick))?)))
        .collect();
    found.dedup();
    found
}

#[test]
fn a_lost_pressure_lies_two_below_peep_and_below_two_fifths_of_it() {
    let settings = Settings { peep: 3.0, ..paper_settings(25.0) };
    let at_3 = Breath::new(&settings, DEFAULT_PERIOD_US).unwrap();
    let lost = |breath: &Breath, pressure| {
        let seen = Seen { plateau: pressure, before: pressure, command: 100.0, ..GOOD };
        found(&mut BreathState::default(), breath, &[seen]) == [(0, Fault::Disconnection)]
    };
    assert!(!lost(&at_3, 1.0) && lost(&at_3, 0.99));
    assert!(!lost(&breath(), 2.0) && lost(&breath(), 1.99));
}

#[test]
fn the_patient_is_back_when_the_pressure_was_above_peep_for_fifty_milliseconds_of_an_inspiration() {
    let (breath, monitor) = (breath(), BreathMonitor::new(DEFAULT_PERIOD_US, Monitors::ALL));
    let gone = Seen { plateau: 1.0, before: 1.0, command: 100.0, ..GOOD };
    let still_gone = |pressures: &[f32]| {
        let mut state = BreathState::default();
        // The expiration at 5.1 cmH2O tells nothing.
        assert_eq!(found(&mut state, &breath, &[gone]), [(0, Fault::Disconnection)]);
        for (tick, pressure) in (0..).zip(pressures) {
            monitor.check(&mut state, &BreathInput { pressure: *pressure, ..gone.at(&breath, tick) });
        }
        state.is_disconnected()
    };
    assert!(still_gone(&[]) && still_gone(&[5.1; 49]) && !still_gone(&[5.1; 50]));
    assert!(still_gone(&[5.0; 999]), "at PEEP");
    assert!(still_gone(&[[5.1; 49].as_slice(), &[5.0], &[5.1; 49]].concat()), "not at a stretch");
}

#[test]
fn a_change_of_the_settings_connects_nobody() {
    let (breath, monitor) = (breath(), BreathMonitor::new(DEFAULT_PERIOD_US, Monitors::ALL));
    let gone = Seen { plateau: 1.0, before: 1.0, command: 100.0, ..GOOD };
    let mut state = BreathState::default();
    let ticks = |state: &mut BreathState, from: u32, to: u32, pressure: f32| {
        (from..to)
            .filter(|tick| {
                monitor.check(state, &BreathInput { pressure, ..gone.at(&breath, *tick) }).is_some()
            })
            .count()
    };
    assert_eq!(ticks(&mut state, 0, 400, 1.0), 0);
    state.settings_changed(5.0);
    assert_eq!(ticks(&mut state, 400, 600, 1.0), 1, "600 ms in all");
    assert_eq!(ticks(&mut state, 600, 630, 5.1), 30);
    state.settings_changed(5.0);
    assert!(state.is_disconnected());
    assert_eq!(ticks(&mut state, 630, 650, 5.1), 19, "back for 50 ms in all");
}

#[test]
fn a_lower_compliance_is_the_lungs_own_after_twenty_breaths() {
    let stiff = Seen { volume: 40.0, ..GOOD };
    let breaths = [[GOOD].as_slice(), &[stiff; 30]].concat();
    let expected: Vec<_> = (2..=20).map(|n| (n, Fault::Occlusion)).collect();
    assert_eq!(found(&mut BreathState::default(), &breath(), &breaths), expected);
}

#[test]
fn a_rise_of_three_or_less_tells_nothing_of_the_tube() {
    let (at, above) =
        (Seen { plateau: 8.0, volume: 1.0, ..GOOD }, Seen { plateau: 8.1, volume: 1.0, ..GOOD });
    assert_eq!(complaint(&[GOOD, at, at, at]), None);
    assert_eq!(complaint(&[GOOD, above, above]), Some((2, Fault::Occlusion)));
}

#[test]
fn the_end_of_a_phase_is_its_last_fifty_milliseconds() {
    assert_eq!(BreathMonitor::new(DEFAULT_PERIOD_US, Monitors::ALL).end_of_phase(), 50);
    // A mean of 8.0 cmH2O is at the bound; a single reading lifts it if it counts.
    let high = |at: u32| {
        complaint_with(&[Seen { baseline: 8.0, ..GOOD }; 2], |input| {
            if input.moment.tick == at {
                input.pressure = 20.0;
            }
        })
    };
    assert_eq!((high(2949), high(2950)), (None, Some((1, Fault::BaselineHigh))));
}
