//! Tests of backup ventilation.

use super::*;
use crate::breath::{DEFAULT_PERIOD_US, paper_settings};
use crate::settings::Settings;

fn breath(pip: f32) -> Breath {
    Breath::new(&paper_settings(pip), DEFAULT_PERIOD_US).unwrap()
}

/// A good breath with a command per tick and a valve that gives 0.4 L/s, without a flow sensor; then the next inspiration begins.
fn good(backup: &mut Backup, breath: &Breath, command: impl Fn(u32) -> f32) {
    backup.start_breath();
    for tick in 0..breath.inspiration_ticks() {
        backup.count(f32::NAN, 0.4, breath.period_s());
        backup.record(&breath.at(tick), command(tick));
    }
    backup.accept(breath);
    backup.start_breath();
}

#[test]
fn the_commands_of_good_breaths_return() {
    let (breath, mut backup) = (breath(25.0), Backup::new());
    let command = |tick: u32| if tick < 300 { 80.0 } else { 20.0 };
    for _ in 0..5 {
        good(&mut backup, &breath, command);
    }
    for tick in [0, 150, 290, 320, 600, 999] {
        assert!((backup.command(&breath.at(tick), true) - command(tick)).abs() < 1e-3, "tick {tick}");
    }
}

#[test]
fn a_bin_has_the_mean_of_its_commands() {
    let (breath, mut backup) = (breath(25.0), Backup::new());
    good(&mut backup, &breath, |tick| tick as f32);
    // The bin of the 500th millisecond has the ticks 500 to 515.
    assert!((backup.command(&breath.at(510), true) - 507.5).abs() < 1e-3);
}

#[test]
fn a_new_breath_has_three_tenths_of_the_mean() {
    let (breath, mut backup) = (breath(25.0), Backup::new());
    good(&mut backup, &breath, |_| 30.0);
    good(&mut backup, &breath, |_| 40.0);
    assert!((backup.command(&breath.at(500), true) - 33.0).abs() < 1e-3);
}

#[test]
fn a_breath_that_was_not_good_is_forgotten() {
    let (breath, mut backup) = (breath(25.0), Backup::new());
    good(&mut backup, &breath, |_| 30.0);
    backup.start_breath();
    for tick in 0..1000 {
        backup.record(&breath.at(tick), 100.0);
    }
    backup.start_breath();
    assert!((backup.command(&breath.at(500), true) - 30.0).abs() < 1e-4);
}

#[test]
fn before_the_first_good_breath_a_stiff_lung_is_filled_to_pip() {
    // 200 mL within a second: 20 cmH2O in a lung of 10 mL/cmH2O.
    let command = Backup::new().command(&breath(25.0).at(0), true);
    assert!((command * FLOW_PER_COMMAND - 0.2).abs() < 1e-4, "{command} %");
    let short = Settings { inspiratory_time: 0.5, ..paper_settings(25.0) };
    let short = Breath::new(&short, DEFAULT_PERIOD_US).unwrap();
    let command = Backup::new().command(&short.at(0), true);
    assert!((command * FLOW_PER_COMMAND - 0.4).abs() < 1e-4, "{command} % in half a second");
}

#[test]
fn other_settings_never_deliver_more_than_the_profile() {
    let mut backup = Backup::new();
    good(&mut backup, &breath(25.0), |_| 40.0);
    assert!((backup.command(&breath(15.0).at(10), true) - 20.0).abs() < 1e-3);
    assert!((backup.command(&breath(35.0).at(10), true) - 40.0).abs() < 1e-3);
    good(&mut backup, &breath(15.0), |_| 10.0);
    assert!((backup.command(&breath(15.0).at(10), true) - 10.0).abs() < 1e-3, "a mean of one kind of breath");
}

/// A breath with a control period of 20 ms.
fn slow_breath(inspiratory_time: f32) -> Breath {
    Breath::new(&Settings { inspiratory_time, ..paper_settings(25.0) }, 20_000).unwrap()
}

#[test]
fn an_inspiration_of_few_ticks_fills_every_bin() {
    let (breath, mut backup) = (slow_breath(0.4), Backup::new());
    good(&mut backup, &breath, |tick| tick as f32);
    for tick in 0..breath.inspiration_ticks() {
        assert!((backup.command(&breath.at(tick), true) - tick as f32).abs() < 1e-4);
    }
    good(&mut backup, &breath, |_| 10.0);
    let means = [0, 1, 2, 19].map(|tick| backup.command(&breath.at(tick), true));
    let expected = [3.0, 3.7, 4.4, 16.3];
    assert!(means.iter().zip(expected).all(|(mean, e)| (mean - e).abs() < 1e-4), "{means:?}");
}

#[test]
fn the_commands_keep_their_time_whatever_the_inspiratory_time_and_the_last_one_lasts() {
    let mut backup = Backup::new();
    good(&mut backup, &slow_breath(0.4), |tick| tick as f32);
    for inspiratory_time in [0.2, 0.6] {
        let breath = slow_breath(inspiratory_time);
        let expected = |tick: u32| tick.min(19) as f32;
        let as_expected = |tick: u32| (backup.command(&breath.at(tick), true) - expected(tick)).abs() < 1e-4;
        assert!((0..breath.inspiration_ticks()).all(as_expected), "{inspiratory_time} s");
    }
    good(&mut backup, &slow_breath(0.6), |_| 10.0);
    let command = backup.command(&slow_breath(0.4).at(5), true);
    assert!((command - 10.0).abs() < 1e-4, "a mean of breaths of one length: {command}");
}

#[test]
fn without_a_flow_sensor_the_valve_closes_when_its_model_has_given_the_volume_of_the_good_breaths() {
    for inspiratory_time in [0.2, 1.0, 2.4, 5.0] {
        for (pip, share) in [(25.0, 1.0), (35.0, 1.0), (15.0, 0.5)] {
            let mut backup = Backup::new();
            good(&mut backup, &breath(25.0), |_| 30.0);
            let settings = Settings { inspiratory_time, rate: 10.0, ..paper_settings(pip) };
            let later = Breath::new(&settings, DEFAULT_PERIOD_US).unwrap();
            for tick in 0..later.inspiration_ticks() {
                let opens = backup.command(&later.at(tick), true) > 0.0;
                backup.count(f32::NAN, if opens { 0.4 } else { 0.0 }, 0.001);
            }
            let most = share * 400.0_f32.min(400.0 * inspiratory_time / share);
            assert!((backup.modelled - most).abs() < 0.5, "{inspiratory_time} s: {} mL", backup.modelled);
        }
    }
}

#[test]
fn a_flow_sensor_that_shows_little_gets_no_more_than_a_low_supply_takes_away() {
    let (breath, mut backup) = (breath(25.0), Backup::new());
    delivered(&mut backup, &breath, 0.4, 0.4);
    backup.start_breath();
    let mut command = |modelled: f32| {
        (backup.measured, backup.modelled) = (0.55 * modelled, modelled);
        backup.command(&breath.at(999), true)
    };
    assert!(command(660.0) > 29.0 && command(667.0).abs() < 1e-6);
    // Half of the rise: 400 / 2 / 0.6 mL, of which 55 % are less than 200 mL.
    let mut command = |modelled: f32| {
        (backup.measured, backup.modelled) = (0.55 * modelled, modelled);
        backup.command(&self::breath(15.0).at(999), true)
    };
    assert!(command(330.0) > 14.0 && command(334.0).abs() < 1e-6);
}

#[test]
fn at_its_end_the_last_command_is_not_known_and_the_one_before_lasts() {
    let (breath, mut backup) = (slow_breath(0.4), Backup::new());
    backup.start_breath();
    let last = breath.inspiration_ticks() - 1;
    (0..last).for_each(|tick| backup.record(&breath.at(tick), 10.0 + tick as f32));
    backup.count(0.4, 0.4, 0.02);
    backup.accept(&breath);
    let mut next = backup.clone();
    next.start_breath();
    assert!((next.command(&breath.at(last), false) - 9.0 - last as f32).abs() < 1e-4);
    assert_eq!(backup.volumes.good()[BINS - 1].to_bits(), backup.volumes.good()[BINS - 4].to_bits());
    // The command of the last tick comes after this and belongs to no mean.
    backup.record(&breath.at(last), 90.0);
    good(&mut backup, &breath, |_| 10.0);
    assert!((backup.command(&breath.at(0), false) - 10.0).abs() < 1e-4);
}

#[test]
fn an_inspiration_without_all_of_its_commands_is_no_part_of_the_mean() {
    let (breath, mut backup) = (breath(25.0), Backup::new());
    delivered(&mut backup, &breath, 0.4, 0.4);
    let known = |backup: &Backup| (*backup.commands.good(), *backup.volumes.good(), backup.course);
    let before = known(&backup);
    // The last bins begin at 969 and 985 ms.
    for recorded in [0..0, 1..1000, 16..1000, 0..969] {
        backup.start_breath();
        let all = recorded.start == 1;
        recorded.for_each(|tick| backup.record(&breath.at(tick), 90.0));
        backup.accept(&breath);
        assert_eq!(known(&backup) != before, all, "a tick that is missing in a bin does no harm");
        (backup.commands, backup.volumes, backup.course) = {
            let mut again = Backup::new();
            delivered(&mut again, &breath, 0.4, 0.4);
            (again.commands, again.volumes, again.course)
        };
    }
}

/// A good breath of 1 s with a constant flow by the sensor and by the model, L/s, and a command of 30 %.
fn delivered(backup: &mut Backup, breath: &Breath, sensor: f32, model: f32) {
    backup.start_breath();
    for tick in 0..breath.inspiration_ticks() {
        backup.count(sensor, model, 0.001);
        backup.record(&breath.at(tick), 30.0);
    }
    backup.accept(breath);
}

/// The command in the middle of an inspiration that has had this volume by the sensor and by the model, L, after good breaths
/// of 400 mL.
fn command_after(sensor: f32, model: f32, by_flow: bool) -> f32 {
    let (breath, mut backup) = (breath(25.0), Backup::new());
    delivered(&mut backup, &breath, 0.4, 0.4);
    backup.start_breath();
    backup.count(sensor, model, 1.0);
    backup.command(&breath.at(500), by_flow)
}

#[test]
fn a_volume_behind_its_course_opens_the_valve_further_and_one_ahead_of_it_closes_it() {
    // The bin of the middle ends after 507 or 515 ms.
    let behind = command_after(0.15, 0.2, true);
    assert!((behind - 52.0).abs() < 2.0, "50 mL are missing: {behind} %");
    let ahead = command_after(0.25, 0.2, true);
    assert!((ahead - 12.0).abs() < 2.0, "{ahead} %");
    assert!(command_after(0.38, 0.3, true).abs() < 1e-6, "far ahead");
    assert!((command_after(0.15, 0.2, false) - 30.0).abs() < 1e-3, "without this response");
}

#[test]
fn the_valve_closes_when_the_whole_volume_has_been_delivered() {
    let (breath, mut backup) = (breath(25.0), Backup::new());
    delivered(&mut backup, &breath, 0.4, 0.4);
    backup.start_breath();
    let mut command = |volume: f32| {
        (backup.measured, backup.modelled) = (volume, volume);
        backup.command(&breath.at(999), true)
    };
    assert!(command(399.0) > 29.0 && command(400.1).abs() < 1e-6);
    let whole = backup.good.unwrap().modelled;
    let mut by_model = |modelled: f32| {
        backup.modelled = modelled;
        backup.command(&breath.at(999), false)
    };
    assert!(by_model(0.99 * whole) > 29.0 && by_model(whole).abs() < 1e-6);
}

#[test]
fn a_flow_sensor_far_from_the_valves_model_is_not_believed() {
    // Half of the model's volume or one and a half, and 50 mL of the circuit.
    for (sensor, sound) in [(0.049, false), (0.051, true), (0.349, true), (0.351, false), (f32::NAN, false)] {
        let by_flow = (command_after(sensor, 0.2, true) - 30.0).abs() > 1e-3;
        assert_eq!(by_flow, sound, "{sensor}");
    }
}

/// A breath that has had these volumes by the sensor and by the model, mL, before any good one.
fn running(measured: f32, modelled: f32) -> Backup {
    Backup { measured, modelled, ..Backup::new() }
}

#[test]
fn a_sensor_lacks_gas_below_half_of_the_models_volume_and_that_of_the_circuit() {
    // Half of 400 mL, less 50.
    let lacks = [149.0, 150.0, 151.0, f32::NAN].map(|measured| running(measured, 400.0).lacks_gas());
    assert_eq!(lacks, [true, false, false, false], "a missing reading shows no lack");
    assert!(!running(0.0, 100.0).lacks_gas(), "all of it may be in the circuit");
}

#[test]
fn at_the_end_of_an_inspiration_the_sensor_has_shown_its_gas_or_far_less_or_more() {
    let shown = |measured: f32| running(measured, 400.0).gas_shown();
    // The circuit has had its share, so that half of the model's volume is the least, and 50 mL more than one and a half the most.
    assert_eq!([0.0, 199.0].map(shown), [Some(Ordering::Less); 2]);
    assert_eq!([200.0, 400.0, 650.0].map(shown), [Some(Ordering::Equal); 3]);
    assert_eq!([651.0, f32::NAN].map(shown), [Some(Ordering::Greater), None]);
    assert_eq!(
        [49.0, IN_CIRCUIT].map(|little| running(0.0, little).gas_shown()),
        [None, Some(Ordering::Less)]
    );
}

#[test]
fn half_of_the_good_breaths_gas_is_not_little() {
    let (breath, mut backup) = (breath(25.0), Backup::new());
    assert!(!backup.has_given_little(), "there was no good breath");
    delivered(&mut backup, &breath, 0.4, 0.4);
    let whole = backup.good.unwrap().modelled;
    let is_little = |share: f32| {
        backup.modelled = share * whole;
        backup.has_given_little()
    };
    assert_eq!([0.0, 0.49, 0.5, 1.0].map(is_little), [true, true, false, false]);
}

#[test]
fn the_elastance_is_the_rise_per_volume_that_the_flow_sensor_measured() {
    let (breath, mut backup) = (breath(25.0), Backup::new());
    delivered(&mut backup, &breath, f32::NAN, 0.5);
    assert_eq!(backup.elastance(), None, "it was not measured");
    // 20 cmH2O and 400 mL.
    delivered(&mut backup, &breath, 0.4, 0.5);
    assert!(backup.elastance().is_some_and(|elastance| (elastance - 0.05).abs() < 1e-5));
}

#[test]
fn a_missing_flow_reading_is_remembered_until_the_next_inspiration() {
    let mut backup = Backup::new();
    backup.count(f32::NAN, 0.4, 0.001);
    backup.count(0.4, 0.4, 0.001);
    assert!(!backup.is_flow_sound());
    backup.start_breath();
    assert!(backup.is_flow_sound());
}

#[test]
fn the_course_is_that_of_breaths_with_a_sound_flow_sensor() {
    let (breath, mut backup) = (breath(25.0), Backup::new());
    let whole = |backup: &Backup| backup.course.map(|course| course.whole as i32);
    let halfway = |backup: &Backup| backup.volumes.good()[31] as i32;
    delivered(&mut backup, &breath, f32::NAN, 0.4);
    delivered(&mut backup, &breath, 0.0, 0.0);
    delivered(&mut backup, &breath, 0.049, 0.1);
    assert_eq!(whole(&backup), None, "what was measured is far from the model");
    delivered(&mut backup, &breath, 0.4001, 0.4);
    delivered(&mut backup, &breath, f32::NAN, 0.4);
    assert_eq!(whole(&backup), Some(400));
    delivered(&mut backup, &breath, 0.5001, 0.4);
    assert_eq!(whole(&backup), Some(430), "a new breath has three tenths");
    assert_eq!(halfway(&backup), 250, "of the last breath");
    // Half of 430 mL.
    backup.start_breath();
    (backup.measured, backup.modelled) = (195.0, 195.0);
    let command = backup.command(&breath.at(499), true);
    assert!((command - 38.0).abs() < 0.5, "{command} %");
}

#[test]
fn the_course_of_another_rise_is_forgotten_and_scaled_down_for_a_smaller_one() {
    let (high, low, mut backup) = (breath(25.0), breath(15.0), Backup::new());
    delivered(&mut backup, &high, 0.4, 0.4);
    backup.start_breath();
    (backup.measured, backup.modelled) = (201.0, 201.0);
    assert!(backup.command(&low.at(999), true).abs() < 1e-6, "half of the rise, half of the volume");
    delivered(&mut backup, &low, f32::NAN, 0.2);
    assert!(backup.course.is_none());
}
