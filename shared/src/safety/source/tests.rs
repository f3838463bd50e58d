//! Tests of the choice of the pressure sensor.

use super::*;
use crate::breath::{Breath, DEFAULT_PERIOD_US, paper_settings};
use crate::settings::Settings;
use core::ops::Range;

mod gas;

const PEEP: f32 = 5.0;

/// Both sensors with their state.
struct Run {
    source: PressureSource,
    state: SourceState,
    tick: u32,
}

impl Run {
    fn new() -> Self {
        let source = PressureSource::new(1000, Monitors::ALL);
        Self { source, state: SourceState::default(), tick: 0 }
    }

    /// A tick at these pressures, with the noise of working sensors.
    fn tick(&mut self, airway: f32, outlet: f32) -> Chosen {
        self.tick += 1;
        let noise = |shift: u32| 0.07 * (((self.tick + shift) * 7 % 5) as f32 - 2.0);
        let readings = Readings { airway: airway + noise(0), outlet: outlet + noise(2), flow: 0.0 };
        self.source.check(&mut self.state, &readings, Expected::Any, 0.0)
    }

    fn ticks(&mut self, count: u32, airway: f32, outlet: f32) -> Chosen {
        (0..count).map(|_| self.tick(airway, outlet)).last().unwrap_or_default()
    }

    /// The end of an expiration; whether a sensor is wrong.
    fn expiration(&mut self, airway: f32, outlet: f32, flow: f32) -> bool {
        self.rest(2900..3000, airway, outlet);
        self.source.compare(&mut self.state, flow, false)
    }

    /// Ticks of an expiration.
    fn rest(&mut self, ticks: Range<u32>, airway: f32, outlet: f32) {
        for tick in ticks {
            self.tick(airway, outlet);
            self.record(tick, airway, outlet);
        }
    }

    fn record(&mut self, tick: u32, airway: f32, outlet: f32) {
        self.record_with(tick, Readings { airway, outlet, flow: 0.0 });
    }

    fn record_with(&mut self, tick: u32, readings: Readings) {
        let breath = Breath::new(&paper_settings(25.0), DEFAULT_PERIOD_US).unwrap();
        self.source.record(&mut self.state, &breath.at(tick), 50, &readings, 0.0);
    }

    /// The end of an inspiration; whether a sensor is wrong.
    fn plateau(&mut self, airway: f32, outlet: f32) -> bool {
        (900..1000).for_each(|tick| self.record(tick, airway, outlet));
        // The outlet sensor is right.
        self.source.at_plateau(&mut self.state, PEEP, 20.0 * (outlet - PEEP))
    }
}

fn near(chosen: Chosen, pressure: f32) -> bool {
    chosen.reading.pressure().is_some_and(|chosen| (chosen - pressure).abs() < 0.5)
}

#[test]
fn the_airway_sensor_is_believed_and_the_outlet_sensor_in_its_place() {
    let mut run = Run::new();
    assert!(near(run.ticks(100, 20.0, 23.0), 20.0));
    let lost = run.ticks(20, f32::NAN, 23.0);
    assert!(near(lost, 23.0) && matches!(lost.reading, Reading::Fresh(_)));
    assert_eq!(lost.findings[0], Some(Fault::ReadingNotANumber));
    assert!(near(run.ticks(5050, 20.0, 23.0), 20.0), "sound for 5 s");
}

#[test]
fn a_sensor_that_returns_is_not_used_at_once() {
    let mut run = Run::new();
    run.ticks(100, 20.0, 23.0);
    run.ticks(20, f32::NAN, 23.0);
    assert!(near(run.ticks(4900, 20.0, 23.0), 23.0));
}

#[test]
fn without_either_there_is_no_pressure() {
    let mut run = Run::new();
    run.ticks(100, 20.0, 23.0);
    let lost = run.ticks(20, f32::NAN, f32::NAN);
    assert_eq!(lost.reading, Reading::Lost);
    assert!(!run.state.is_sound());
    assert_eq!(lost.findings[1], Some(Fault::OutletSensorLost));
}

#[test]
fn a_machine_without_the_second_sensor_has_no_finding_about_it() {
    let mut run = Run::new();
    let chosen = run.ticks(1000, 20.0, f32::NAN);
    assert!(near(chosen, 20.0) && chosen.findings == [None; 3] && run.state.is_sound());
    assert!(!run.expiration(20.0, f32::NAN, 0.0));
}

#[test]
fn a_lost_sensor_does_not_count_before_its_first_reading() {
    let mut run = Run::new();
    let first = run.tick(f32::NAN, f32::NAN);
    assert_eq!(first.reading, Reading::None);
    assert!(!run.state.is_sound());
}

#[test]
fn a_noisy_sensor_stands_back_behind_a_quiet_one() {
    let mut run = Run::new();
    let noisy = |n: u32| 20.0 + 1.2 * ((n * 7 % 5) as f32 - 2.0);
    let quiet = (0..300).map(|n| run.tick(noisy(n), 23.0)).last().unwrap();
    assert!(near(quiet, 23.0) && quiet.findings == [None; 3] && quiet.replaced == Some(Fault::ReadingNoisy));
    let mut run = Run::new();
    let both = (0..300).map(|n| run.tick(noisy(n), noisy(n + 1))).last().unwrap();
    assert_eq!(
        (both.findings[0], both.replaced),
        (Some(Fault::ReadingNoisy), None),
        "then the airway sensor it is"
    );
}

#[test]
fn noise_is_a_finding_unless_a_quiet_sensor_takes_the_place() {
    let noisy = |n: u32| 5.0 + 1.2 * ((n * 7 % 5) as f32 - 2.0);
    let mut run = Run::new();
    (0..2).for_each(|_| _ = run.expiration(5.0, 9.0, 0.0));
    let only = (0..300).map(|n| run.tick(noisy(n), 9.0)).last().unwrap();
    assert!(run.state.outlet.doubted && near(only, noisy(299)), "the other one has lost a comparison");
    assert_eq!((only.findings[0], only.replaced), (Some(Fault::ReadingNoisy), None));
    let mut run = Run::new();
    let higher = (0..300).map(|n| run.tick(noisy(n), 17.0 + noisy(n + 1))).last().unwrap();
    assert!(near(higher, 17.0 + noisy(300)), "the other one is used, but noisy too");
    assert_eq!((higher.findings[0], higher.replaced), (Some(Fault::ReadingNoisy), None));
}

#[test]
fn only_the_noise_of_the_sensor_in_use_makes_the_reading_noisy() {
    let is_noisy = |airway: f32, outlet: f32| {
        let mut run = Run::new();
        let swings = |n: u32, by: f32| 20.0 + by * ((n * 7 % 5) as f32 - 2.0);
        (0..300).for_each(|n| _ = run.tick(swings(n, airway), swings(n, outlet)));
        (run.state.uses_outlet, run.state.is_noisy())
    };
    assert_eq!([is_noisy(0.0, 0.0), is_noisy(0.0, 1.2)], [(false, false); 2]);
    assert_eq!((is_noisy(1.2, 0.0), is_noisy(1.2, 1.2)), ((true, false), (false, true)));
}

#[test]
fn a_check_that_is_left_out_finds_nothing() {
    let mut run = Run::new();
    run.source = PressureSource::new(1000, Monitors::ALL.without(Fault::ReadingNotANumber));
    run.ticks(100, 20.0, 23.0);
    let missing = run.ticks(20, f32::NAN, 23.0);
    assert_eq!(missing.findings, [None; 3]);
    assert!(matches!(missing.reading, Reading::Bridged(_)));
}

#[test]
fn the_higher_reading_shows_peep_unless_its_flow_or_a_lost_sensor_denies_it() {
    let mut run = Run::new();
    run.ticks(100, PEEP, PEEP);
    let shows = |state: &SourceState, outlet: f32, flow: f32| {
        state.shows_peep(&Readings { airway: PEEP - 3.0, outlet, flow: 0.0 }, flow, PEEP)
    };
    assert_eq!([PEEP, PEEP - 0.6].map(|outlet| shows(&run.state, outlet, 0.0)), [true, false]);
    // 0.4 L/s lose 1.6 cmH2O in the tube.
    assert_eq!([PEEP + 1.2, PEEP + 1.0].map(|outlet| shows(&run.state, outlet, 0.4)), [true, false]);
    run.ticks(100, PEEP, f32::NAN);
    assert!(!shows(&run.state, PEEP, 0.0), "a lost sensor");
}

#[test]
fn far_apart_for_20_ms_the_higher_one_counts() {
    for (airway, outlet) in [(5.0, 20.0), (20.0, 5.0)] {
        let mut run = Run::new();
        run.ticks(100, 12.0, 12.0);
        let before = run.ticks(19, airway, outlet);
        assert!(near(before, airway) && before.findings[2].is_none() && before.doubtful);
        let after = run.ticks(1, airway, outlet);
        assert!(near(after, 20.0));
        assert_eq!(after.findings[2], Some(Fault::SensorsDisagree));
    }
    let mut run = Run::new();
    assert_eq!(run.ticks(1000, 20.0, 29.0).findings, [None; 3], "the tube's drop at full flow");
}

#[test]
fn the_other_sensor_is_told_until_one_is_lost() {
    let mut run = Run::new();
    run.ticks(100, PEEP, PEEP);
    let other = [14.0, 16.0].map(|outlet| run.tick(PEEP, outlet).other.map(f32::round));
    assert_eq!(other, [Some(14.0), Some(16.0)]);
    assert_eq!(run.ticks(30, f32::NAN, PEEP).other, None);
}

#[test]
fn while_gas_flows_out_a_pressure_above_peep_is_no_sign_of_a_wrong_sensor() {
    let doubted = |airway: f32, outlet: f32, flow: f32| {
        let mut run = Run::new();
        for _ in 0..2 {
            (2900..3000).for_each(|tick| {
                run.tick(airway, outlet);
                run.record_with(tick, Readings { airway, outlet, flow });
            });
            run.source.compare(&mut run.state, 0.0, false);
        }
        (run.state.airway.doubted, run.state.outlet.doubted)
    };
    assert_eq!(doubted(9.0, 2.0, 0.0), (true, false), "at rest");
    assert_eq!(doubted(9.0, 2.0, -0.6), (false, true), "4 cmH2O at 0.6 L/s");
    assert_eq!(doubted(9.0, 5.5, -0.1), (true, false), "a sensor that lags");
    // 0.6 L/s explain 4.2 cmH2O above PEEP.
    assert_eq!(
        [9.0, 10.1].map(|airway| doubted(airway, 5.5, -0.6)),
        [(false, false); 2],
        "either may be right"
    );
    assert_eq!(doubted(10.3, 5.5, -0.6), (true, false), "more than the flow explains");
}

#[test]
fn a_sensor_that_the_gas_denies_gives_way_to_the_other_one() {
    let denies = |airway: f32, outlet: f32| {
        let mut run = Run::new();
        run.ticks(100, airway, outlet);
        let readings = Readings { airway, outlet, flow: 0.0 };
        let first = run.source.deny(&mut run.state, &readings);
        let uses = run.ticks(1, airway, outlet).reading.pressure().map(f32::round);
        (first, uses)
    };
    assert_eq!(denies(14.0, 5.0), (true, Some(5.0)));
    assert_eq!(denies(14.0, 9.0), (true, Some(9.0)));
    assert_eq!(denies(5.0, 5.5), (false, Some(5.0)), "they read the same");
    assert_eq!([denies(7.0, 5.0), denies(7.25, 5.0)], [(false, Some(7.0)), (true, Some(5.0))]);
    assert_eq!(denies(9.0, f32::NAN), (false, Some(9.0)), "there is no other");
}

#[test]
fn after_two_expirations_the_sensor_closer_to_peep_is_believed() {
    for (airway, outlet, believed) in
        [(10.0, 5.2, 5.2), (5.3, 1.0, 5.3), (1.0, 5.0, 5.0), (5.0, 9.0, 5.0), (6.0, 3.9, 6.0)]
    {
        let mut run = Run::new();
        assert!(!run.expiration(airway, outlet, 0.0), "once may be a cough");
        assert!(run.expiration(airway, outlet, 0.0));
        assert!(near(run.tick(airway, outlet), believed), "{airway} and {outlet}");
    }
    let mut run = Run::new();
    assert!(!(0..5).any(|_| run.expiration(5.0, 6.9, 0.0)), "within 2 cmH2O");
    assert!(!(0..5).any(|_| run.expiration(5.0, 7.9, 0.3)), "explained by the flow in the tube");
    assert!(
        !(0..9).any(|n| run.expiration(5.0, if n % 2 == 0 { 9.0 } else { 5.0 }, 0.0)),
        "never twice in a row"
    );
}

#[test]
fn an_expiration_that_an_effort_ends_is_compared_before_the_effort() {
    let mut run = Run::new();
    for _ in 0..2 {
        run.record(0, 5.0, 5.0);
        run.rest(2000..2100, 5.0, 10.0);
        run.rest(2100..2140, 4.5, 4.5);
        let wrong = run.source.compare(&mut run.state, 0.0, true);
        assert_eq!(wrong, run.state.outlet.doubted);
    }
    assert!(run.state.outlet.doubted);
}

#[test]
fn sensors_are_not_compared_while_the_pressure_falls_unless_the_breath_ends_so() {
    let wrong = |ticks: Range<u32>, rate: f32, triggered: bool| {
        let (mut run, settings) = (Run::new(), Settings { rate, ..paper_settings(25.0) });
        let breath = Breath::new(&settings, DEFAULT_PERIOD_US).unwrap();
        (0..2).any(|_| {
            run.ticks(10, 5.0, 5.0);
            for tick in ticks.clone() {
                let readings = Readings { airway: 5.0, outlet: 10.0, flow: 0.0 };
                run.source.record(&mut run.state, &breath.at(tick), 50, &readings, 0.0);
            }
            run.source.compare(&mut run.state, 0.0, triggered)
        })
    };
    assert!(!wrong(1000..1449, 20.0, true) && wrong(1500..1700, 20.0, true));
    // 40 breaths a minute have no rest after the fall.
    assert!(wrong(1000..1500, 40.0, false) && !wrong(1000..1450, 40.0, false));
}

#[test]
fn sensors_that_agree_again_in_three_whole_breaths_are_both_used() {
    let wrong = || {
        let mut run = Run::new();
        run.expiration(10.0, 5.0, 0.0);
        run.expiration(10.0, 5.0, 0.0);
        run
    };
    let agree = |run: &mut Run, plateau: f32, count: u32| {
        for _ in 0..count {
            run.plateau(20.0, plateau);
            run.expiration(5.5, 5.0, 0.0);
        }
        run.state.airway.doubted
    };
    assert!(agree(&mut wrong(), 22.0, 2) && !agree(&mut wrong(), 22.0, 3));
    assert!(agree(&mut wrong(), 26.0, 9), "not at the end of the inspiration");
}

#[test]
fn a_sensor_with_a_wrong_gain_is_out_of_use_until_it_agrees_again() {
    let mut run = Run::new();
    run.ticks(10, 5.0, 5.0);
    assert!(!run.plateau(25.0, 25.0) && !run.plateau(25.0, 31.0) && run.plateau(25.0, 31.0));
    run.expiration(5.0, 5.0, 0.0);
    assert!(run.state.airway.doubted && near(run.ticks(100, 20.0, 25.0), 25.0), "it is right at PEEP only");
    (0..9).for_each(|_| {
        run.plateau(20.0, 25.0);
        run.expiration(5.0, 5.0, 0.0);
    });
    assert!(run.state.airway.doubted);
    (0..3).for_each(|_| {
        run.plateau(25.0, 25.0);
        run.expiration(5.0, 5.0, 0.0);
    });
    assert!(!run.state.airway.doubted);
}

#[test]
fn what_shows_at_rest_or_is_left_out_is_not_judged_at_the_end_of_inspirations() {
    let wrong = |run: &mut Run| (0..3).any(|_| run.plateau(25.0, 31.0));
    let mut run = Run::new();
    run.expiration(10.0, 5.0, 0.0);
    assert!(!wrong(&mut run) && run.state.are_both_sound(), "PEEP will tell which one is wrong");
    run.expiration(5.0, 5.0, 0.0);
    assert!(wrong(&mut run) && run.state.airway.doubted);
    let mut run = Run::new();
    run.source = PressureSource::new(1000, Monitors::ALL.without(Fault::SensorsDisagree));
    run.ticks(10, 5.0, 5.0);
    assert!(!wrong(&mut run) && run.state.are_both_sound());
    let mut run = Run::new();
    run.ticks(100, 5.0, 5.0);
    run.ticks(20, f32::NAN, 5.0);
    assert!(!wrong(&mut run) && !run.state.outlet.doubted, "one is lost");
}

#[test]
fn a_hum_around_peep_is_a_difference_and_the_humming_sensor_is_wrong() {
    let mut run = Run::new();
    let mut wrong = false;
    for _ in 0..2 {
        run.ticks(10, 5.0, 5.0);
        for tick in 2900..3000 {
            let hum = 5.0 * (0.314 * tick as f32).sin();
            run.record(tick, PEEP + hum, PEEP);
        }
        wrong = run.source.compare(&mut run.state, 0.0, false);
    }
    assert!(wrong && run.state.airway.doubted);
}

#[test]
fn a_reading_follows_the_last_one_of_the_same_sensor_only() {
    let mut run = Run::new();
    let follows = [20.0, 20.0, f32::NAN, 20.0, 20.0].map(|airway| run.tick(airway, 23.0).follows);
    let (gap, same) = (Follows::Gap, Follows::Same);
    assert_eq!(follows, [gap, same, gap, gap, same]);
    let others = (0..40).filter(|_| run.tick(8.0, 23.0).follows == Follows::Other).count();
    assert_eq!(others, 1, "the one that is higher");
}

#[test]
fn of_two_sensors_the_one_that_does_not_respond_is_wrong() {
    let readings = |airway, outlet| Readings { airway, outlet, flow: 0.0 };
    for (airway, outlet) in [(5.0, 20.0), (20.0, 5.0)] {
        let mut run = Run::new();
        run.ticks(10, 5.0, 5.0);
        assert!(run.source.unresponsive(&mut run.state, &readings(airway, outlet), 0.5));
        assert_eq!(run.state.airway.doubted, airway < outlet);
        assert_eq!(run.state.outlet.doubted, outlet < airway);
    }
    let mut run = Run::new();
    run.ticks(10, 5.0, 5.0);
    assert!(!run.source.unresponsive(&mut run.state, &readings(5.0, 6.5), 0.0), "neither responds");
    assert!(!run.source.unresponsive(&mut run.state, &readings(5.0, 10.9), 1.0), "the flow in the tube");
    assert!(!run.source.unresponsive(&mut run.state, &readings(6.9, 5.0), 1.0), "within 2 cmH2O");
    assert!(run.state.are_both_sound());
    assert!(run.state.is_sound() && !run.state.airway.doubted && !run.state.outlet.doubted);
    run.ticks(20, f32::NAN, 5.0);
    assert!(!run.source.unresponsive(&mut run.state, &readings(f32::NAN, 20.0), 0.0), "there is only one");
    assert!(!run.state.are_both_sound());
}

/// Tick at which a sensor that stands still is found, while the other one rises by so much per tick, cmH2O, and the
/// flow by so much, L/s.
fn frozen(rise: f32, flow: f32, airway_stands: bool, expected: Expected) -> Option<u32> {
    let mut run = Run::new();
    run.ticks(100, 12.0, 12.0);
    (1..400).find(|tick| {
        let living = 12.0 + rise * *tick as f32 + 0.07 * (tick % 3) as f32;
        let [airway, outlet] = if airway_stands { [12.0, living] } else { [living, 12.0] };
        let readings = Readings { airway, outlet, flow: 0.0 };
        let chosen = run.source.check(&mut run.state, &readings, expected, flow * *tick as f32);
        let found = [Some(Fault::ReadingFrozen), Some(Fault::OutletSensorLost)];
        chosen.findings[usize::from(!airway_stands)] == found[usize::from(!airway_stands)]
    })
}

#[test]
fn a_sensor_that_stands_still_while_the_other_one_moves_is_frozen() {
    for airway_stands in [true, false] {
        // 2 cmH2O, the smoothing's 10 ms, and 60 ms.
        let found = frozen(0.05, 0.0, airway_stands, Expected::Any);
        assert!(found.is_some_and(|tick| (100..120).contains(&tick)), "{found:?}");
        assert_eq!(frozen(0.0, 0.0, airway_stands, Expected::Any), None, "nothing moves");
        assert_eq!(
            frozen(0.05, 0.02, airway_stands, Expected::Any),
            None,
            "the flow in the tube explains it"
        );
        assert_eq!(frozen(0.0, 0.0, airway_stands, Expected::RiseTo(25.0)), None, "the other one denies it");
    }
}

#[test]
fn sensors_that_both_stand_still_or_an_only_one_are_judged_by_what_the_commands_predict() {
    let found = |outlet: f32, expected| {
        let mut run = Run::new();
        run.ticks(100, 12.0, if outlet.is_nan() { outlet } else { 12.0 });
        let readings = Readings { airway: 12.0, outlet, flow: 0.0 };
        (1..400).find(|_| {
            run.source.check(&mut run.state, &readings, expected, 0.0).findings[0]
                == Some(Fault::ReadingFrozen)
        })
    };
    assert_eq!(found(f32::NAN, Expected::RiseTo(25.0)), Some(61));
    assert_eq!(found(f32::NAN, Expected::FallTo(5.0)), Some(61));
    assert_eq!(found(12.0, Expected::FallTo(5.0)), Some(81), "20 ms to see that the other one stands too");
    assert_eq!((found(f32::NAN, Expected::Any), found(12.0, Expected::RiseTo(13.0))), (None, None));
}

#[test]
fn a_sensor_is_used_again_when_it_was_sound_for_five_seconds() {
    for (count, believed) in [(4999, 23.0), (5000, 20.0)] {
        let mut run = Run::new();
        run.ticks(100, 20.0, 23.0);
        run.ticks(20, f32::NAN, 23.0);
        assert!(near(run.ticks(count, 20.0, 23.0), believed), "after {count} ms");
    }
    let mut noisy = Run::new();
    (0..300).for_each(|n| _ = noisy.tick(20.0 + 1.2 * ((n * 7 % 5) as f32 - 2.0), 23.0));
    assert!(near(noisy.ticks(4990, 20.0, 23.0), 23.0) && near(noisy.ticks(200, 20.0, 23.0), 20.0));
}

#[test]
fn sensors_that_are_as_far_apart_as_a_bound_agree() {
    // Steps that are exact, and equal for both sensors.
    let last = |apart: f32| {
        let mut run = Run::new();
        let reading = |n: u32| 12.0 + 0.25 * (n % 3) as f32;
        let tick = |n| Readings { airway: reading(n), outlet: reading(n) + apart, flow: 0.0 };
        (0..100).map(|n| run.source.check(&mut run.state, &tick(n), Expected::Any, 0.0)).last().unwrap()
    };
    assert_eq!([FAR_APART, -FAR_APART].map(|apart| last(apart).findings), [[None; 3]; 2]);
    assert_eq!(last(FAR_APART + 0.25).findings[2], Some(Fault::SensorsDisagree));
    assert_eq!(
        [DOUBTFUL, -DOUBTFUL, 2.25, -2.25].map(|apart| last(apart).doubtful),
        [false, false, true, true]
    );
    let silent = |outlet| {
        let mut run = Run::new();
        run.ticks(10, 5.0, 5.0);
        let found =
            run.source.unresponsive(&mut run.state, &Readings { airway: 5.0, outlet, flow: 0.0 }, 0.0);
        (found, run.state.airway.doubted, run.state.outlet.doubted)
    };
    assert_eq!([3.0, 7.0].map(silent), [(false, false, false); 2]);
    assert_eq!([2.75, 7.25].map(silent), [(true, false, true), (true, true, false)]);
}

#[test]
fn the_bounds_at_the_end_of_a_breath_are_exact() {
    let wrong = |airway, outlet, flow| {
        let mut run = Run::new();
        (0..2).map(|_| run.expiration(airway, outlet, flow)).last() == Some(true)
    };
    assert!(!wrong(5.0, 7.0, 0.0) && wrong(5.0, 7.1, 0.0));
    assert!(!wrong(5.0, 9.0, 0.5) && wrong(5.0, 9.1, 0.5), "4 cmH2O/(L/s) in the tube");
    let used_again = |airway, plateau| {
        let mut run = Run::new();
        (0..2).for_each(|_| _ = run.expiration(10.0, 5.0, 0.0));
        (0..3).for_each(|_| {
            run.plateau(20.0, plateau);
            run.expiration(airway, 5.0, 0.0);
        });
        !run.state.airway.doubted
    };
    assert!(used_again(6.0, 23.0) && !used_again(6.1, 23.0) && !used_again(6.0, 23.1));
    let mut run = Run::new();
    (0..2).for_each(|_| _ = run.expiration(PEEP + 2.5, PEEP - 2.5, 0.0));
    assert!(run.state.outlet.doubted && !run.state.airway.doubted, "equally far from PEEP");
}

#[test]
fn readings_of_a_lost_sensor_are_not_compared() {
    for lost in [(f32::NAN, 5.0), (10.0, f32::NAN)] {
        let mut run = Run::new();
        run.ticks(100, 10.0, 5.0);
        run.ticks(20, lost.0, lost.1);
        assert!(!(0..4).any(|_| run.expiration(10.0, 5.0, 0.0)), "not sound again");
        let apart = run.ticks(100, 18.0, 5.0);
        assert!(!apart.doubtful && apart.findings[2].is_none());
        assert!(!run.source.unresponsive(
            &mut run.state,
            &Readings { airway: 18.0, outlet: 5.0, flow: 0.0 },
            0.0
        ));
    }
    // A single missing reading spoils no comparison.
    for missing in [(f32::NAN, 5.0), (10.0, f32::NAN), (f32::INFINITY, 5.0), (10.0, f32::INFINITY)] {
        let mut run = Run::new();
        let mut expiration = || {
            run.record(2999, missing.0, missing.1);
            run.expiration(10.0, 5.0, 0.0)
        };
        assert!(!expiration() && expiration());
    }
    let mut run = Run::new();
    run.ticks(100, 10.0, f32::NAN);
    for _ in 0..4 {
        run.record(2999, 10.0, 200.0);
        assert!(!run.source.compare(&mut run.state, 0.0, false), "there is no second sensor");
    }
}

#[test]
fn a_comparison_that_is_left_out_takes_no_sensor_out_of_use() {
    let mut run = Run::new();
    run.source = PressureSource::new(1000, Monitors::ALL.without(Fault::SensorsDisagree));
    assert!(!(0..4).any(|_| run.expiration(20.0, 5.0, 0.0)));
    assert!(near(run.tick(20.0, 5.0), 20.0));
    let readings = Readings { airway: 5.0, outlet: 20.0, flow: 0.0 };
    assert!(!run.source.unresponsive(&mut run.state, &readings, 0.0));
}

#[test]
fn a_change_beyond_the_bound_and_the_change_of_the_flow_is_one_that_a_sensor_must_show() {
    // Both flows in L/s: when the reading last changed, and now.
    let must_change = |change: f32, flow_then: f32, flow: f32| {
        let mut run = Run::new();
        run.tick(12.0, 12.0);
        let existing = run.state.airway;
        let sensor = SensorState { other_then: 12.0, flow_then, ..existing };
        let other = SensorState { smooth: 12.0 + change, ..existing };
        run.source.must_change(&sensor, &other, Expected::Any, flow)
    };
    assert!(!must_change(MOVED, 0.0, 0.0) && must_change(2.125, 0.0, 0.0) && must_change(-2.125, 0.0, 0.0));
    assert!(!must_change(4.0, 0.0, 0.5) && must_change(4.125, 0.0, 0.5));
    assert!(must_change(2.125, 1.0, 1.0), "a steady flow explains no change");
}

#[test]
fn smoothed_readings_follow_with_a_time_constant_of_10_ms() {
    let mut run = Run::new();
    run.ticks(100, 12.0, 12.0);
    run.ticks(10, 22.0, 22.0);
    assert!([run.state.airway, run.state.outlet].iter().all(|sensor| (17.5..19.0).contains(&sensor.smooth)));
}

#[test]
fn a_missing_reading_in_the_last_window_spoils_no_comparison() {
    for missing in [(f32::NAN, 5.0), (10.0, f32::NAN), (f32::INFINITY, 5.0), (10.0, f32::INFINITY)] {
        let mut run = Run::new();
        let mut expiration = || {
            run.rest(2900..2999, 10.0, 5.0);
            run.record(2999, missing.0, missing.1);
            run.source.compare(&mut run.state, 0.0, false)
        };
        assert!(!expiration() && expiration());
    }
}
