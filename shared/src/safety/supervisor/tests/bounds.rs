//! Tests of the supervisor at its bounds: counts, shares and times of SAFETY.md to the tick.

use super::*;
use crate::safety::indications::FaultSet;

#[test]
fn an_alarm_is_present_for_two_breaths_after_its_condition() {
    let mut run = Run::new();
    run.missed(5);
    (0..2).for_each(|_| good_breath(&mut run, false));
    assert!(run.state.indications().present().has(Fault::MissedTicks));
    run.check(5.0, Some(0));
    assert!(!run.state.indications().present().has(Fault::MissedTicks));
}

#[test]
fn what_another_part_has_found_has_the_response_of_its_row() {
    let mut run = Run::new();
    run.supervisor.report(&mut run.state, Fault::Restarted);
    assert_eq!(run.state.level(), Level::Pid);
    run.state.begin();
    assert_eq!(run.state.take_begun(), Some(Fault::Restarted), "the start forgets no alarm");
    assert!(run.state.acknowledge() && !run.state.acknowledge());
}

#[test]
fn before_the_first_reading_nothing_is_known_and_after_five_missing_ones_no_sensor_is_sound() {
    let mut run = Run::new();
    let breath = breath();
    let beliefs: Vec<_> = (0..5)
        .map(|tick| run.supervisor.check(&mut run.state, &f32::NAN.into(), breath.at(tick)))
        .map(|belief| belief.map(|belief| (belief.level, belief.pressure as i32)))
        .collect();
    assert_eq!(beliefs, [None, None, None, None, Some((Level::Backup, 5))], "with PEEP in its place");
}

#[test]
fn gas_without_a_reading_counts_in_inspirations_alone() {
    let mut run = Run::new();
    assert_eq!(run.inspire(SOFT, 30.0), None);
    let mut volume_after = |ticks: Range<u32>| {
        for tick in ticks {
            run.check(f32::NAN, Some(tick));
            run.filter(ControlOutput::plain(30.0), tick >= 1000);
        }
        run.state.lung.volume()
    };
    let volume = volume_after(0..1000);
    assert!((200.0..350.0).contains(&volume), "{volume} mL at 0.3 L/s");
    assert_eq!(volume_after(1000..3000).to_bits(), volume.to_bits());
}

#[test]
fn gas_explains_a_cut_if_it_predicts_half_of_the_way_from_pip_to_the_limit() {
    // PIP is 20, the limit 60 cmH2O.
    let strikes = |predicted: f32| {
        let mut run = Run::new();
        assert_eq!(run.inspire(STIFF, 30.0), None);
        let mut pressure = 5.0;
        for tick in 0..1000 {
            let reached = run.state.lung.predicted_pressure().unwrap() >= predicted;
            pressure = if reached { pressure + 10.0 } else { 5.0 + 0.1 * run.state.lung.volume() };
            run.check(pressure.min(65.0) + dither(tick), Some(tick));
            run.filter(ControlOutput::plain(60.0), false);
        }
        run.state.cut == Cut::ByGas
    };
    assert_eq!([25.0, 37.0, 41.0].map(strikes), [false, false, true]);
}

#[test]
fn gas_that_flows_on_explains_an_early_cut_whatever_the_lung_was_and_is_a_strike_of_its_own() {
    // The tube narrows: the same gas raises the pressure by more. Against a cough none flows.
    let cut_at = |level: Level, share: f32, ends: u32| {
        let mut run = Run::new();
        (0..2).for_each(|_| assert_eq!(run.inspire(Lung::Elastic(0.05), 30.0), None));
        run.state.ladder.step_down(level);
        for tick in 0..ends + 10 {
            let pressure = 10.0 + 50.0 * (tick as f32 / ends as f32).min(1.1);
            let flow = share * run.state.lung.valve_flow();
            run.check_all(Readings { flow, ..Readings::from(pressure + dither(tick)) }, Some(tick));
            run.filter(ControlOutput::plain(30.0), false);
        }
        let (cut, mut length) = (run.state.cut, ends + 10);
        while length < 3000 && !run.supervisor.end_tick(&mut run.state, &breath().at(length), false) {
            run.check_all(Readings { flow: 0.0, ..Readings::from(5.0 + dither(length)) }, Some(length));
            run.filter(ControlOutput::plain(0.0), true);
            length += 1;
        }
        run.check(5.0, Some(0));
        (cut, run.state.level(), length < 1500)
    };
    let cut = |share, ends| cut_at(Level::Learned, share, ends);
    let patients = (Cut::ByPatient, Level::Learned, false);
    assert_eq!([cut(-0.1, 250), cut(0.4, 250), cut(0.6, 800)], [patients; 3]);
    assert_eq!(cut(0.6, 250), (Cut::ByFirstGas, Level::Pid, true), "the next breath comes a second later");
    let capped = (Cut::ByFirstGas, Level::CappedPid, false);
    assert_eq!(cut_at(Level::CappedPid, 0.6, 250), capped, "no other controller is left");
}

#[test]
fn a_tube_that_keeps_the_gas_out_in_three_breaths_lowers_the_command_and_a_late_cough_does_not() {
    // After two good breaths the pressure rises to its limit, and `share` of the valve's gas has reached the patient by then.
    let after = |breaths: u32, rises_at: u32, share: f32, other: f32| {
        let (mut run, mut pressure) = (Run::new(), 5.0_f32);
        for (number, tick) in (0..2 + breaths).flat_map(|n| (0..breath().total_ticks()).map(move |t| (n, t)))
        {
            let (inspires, cut) = (breath().phase(tick) == Phase::Inspiration, run.state.cut());
            let (valve, volume) = (run.state.lung.valve_flow(), run.state.lung.volume());
            let (rise, flow) = match number {
                0 | 1 if inspires && tick > 0 => (0.05 * volume, valve),
                0 | 1 => (0.0, if pressure > 5.0 { -0.6 } else { 0.0 }),
                _ if inspires && cut => (0.0, -1.0),
                _ if inspires => (3.0 * tick.saturating_sub(rises_at) as f32, share * valve),
                _ => (0.0, 0.0),
            };
            // No faster down than a lung empties, or a cough ends.
            pressure = (5.0 + rise.min(60.0)).max(pressure - if number < 2 { 0.03 } else { 2.0 });
            let airway = pressure + dither(tick);
            run.check_all(Readings { airway, outlet: airway.min(other), flow }, Some(tick));
            run.filter(ControlOutput::plain(30.0), !inspires);
        }
        run.check(5.0, Some(0));
        let told = run.state.indications().present().has(Fault::CommandCapped);
        assert_eq!(told, run.state.level() == Level::CappedPid);
        told.then(|| run.state.ladder.cap())
    };
    let narrowed = |breaths| after(breaths, 150, 0.3, f32::INFINITY);
    assert_eq!([2, 3, 4].map(narrowed), [None, Some(40.0), Some(20.0)]);
    assert_eq!(
        after(3, 10, 0.6, f32::INFINITY),
        Some(20.0),
        "strikes by the first gas have capped it before"
    );
    assert_eq!(after(4, 800, 1.0, f32::INFINITY), None, "a cough");
    let denied = |other| after(3, 150, 0.3, other);
    assert_eq!([39.0, 39.5].map(denied), [None, Some(40.0)], "the other sensor denies a pressure 2 above it");
}

#[test]
fn the_sensors_are_compared_over_the_last_fifty_milliseconds_of_a_breath() {
    // Each expiration is lengthened by 0.4 s.
    let disagree = |apart: &dyn Fn(u32) -> f32| {
        let mut run = Run::new();
        for tick in (0..4).flat_map(|_| 0..3400) {
            let airway = if tick < 1000 { 15.0 } else { 5.0 } + dither(tick);
            let readings = Readings { outlet: airway + apart(tick), ..Readings::from(airway) };
            run.check_all(readings, Some(tick));
        }
        run.state.indications().present().has(Fault::SensorsDisagree)
    };
    assert!(!disagree(&|tick| if tick < 1000 || (2950..3000).contains(&tick) { 1.9 } else { 9.0 }));
    assert!([2950, 2999].iter().all(|at| disagree(&|tick| if tick == *at { 9.0 } else { 1.9 })));
}

/// The volumes of a breath of which this share came out again.
fn expired(share: f32) -> Volumes {
    let mut volumes = Volumes::default();
    volumes.add(0.03125, 9.0, 0.0, 1.0);
    volumes.add(-0.03125 * share, 9.0, 0.0, 1.0);
    volumes
}

#[test]
fn volumes_of_which_less_than_three_quarters_come_out_tell_nothing_of_the_tube() {
    let occlusion_after = |share| {
        let mut run = Run::new();
        for lung in [SOFT, SOFT, SOFT, STIFF, STIFF] {
            run.state.volumes = expired(share);
            assert_eq!(run.inspire(lung, 30.0), None);
        }
        run.state.indications().present().has(Fault::Occlusion)
    };
    assert!(occlusion_after(0.75) && !occlusion_after(0.74));
}

/// A breath whose pressure hardly falls when the valve opens, to this one, cmH2O; whether the last one has latched an alarm about that.
fn latches_above_peep(run: &mut Run, baseline: f32) -> bool {
    run.breathe(0..2, baseline, ControlOutput::plain(10.0));
    run.breathe(2..1000, 25.0, ControlOutput::plain(10.0));
    let fault = run.state.fault();
    run.breathe(1000..1002, 25.0, ControlOutput::plain(5.0));
    run.breathe(1002..3000, baseline, ControlOutput::plain(5.0));
    fault == Some(Fault::SustainedPressure)
}

#[test]
fn a_pressure_that_stays_up_for_a_quarter_of_a_minute_with_a_fifth_of_the_gas_inside_is_latched() {
    // In this breath, with these shares of the gas in every second one.
    let latched_in = |shares: [f32; 2], lost, baseline, efforts| {
        let mut run = Run::new();
        run.state.standing.add(lost, 0);
        latches_above_peep(&mut run, baseline);
        (0..9).find(|breath| {
            if efforts {
                run.effort(2999);
            }
            run.state.volumes = expired(shares[breath % 2]);
            latches_above_peep(&mut run, baseline)
        })
    };
    let stays = |share| latched_in([share; 2], 0.0, 22.5, false);
    assert_eq!((stays(0.2), stays(0.19)), (None, Some(4)));
    let falls = latched_in([0.19; 2], 0.0, 21.5, false);
    assert_eq!(falls, None, "it falls through a valve that opens");
    let ended_early = |other| latched_in([0.19, other], 0.0, 22.5, true);
    assert_eq!((ended_early(0.2), ended_early(0.19)), (None, Some(4)), "one effort proves nothing");
    // Of 31 mL in, 25 stay away.
    let lost = |lost| latched_in([0.19; 2], lost, 22.5, false);
    assert_eq!((lost(9.4), lost(9.9)), (Some(4), None), "a leak lets gas out");
}

#[test]
fn gas_that_a_leak_takes_does_not_stay_inside() {
    // 1 L in, of which a known leak takes a part; it takes a part of the expiration's flow too.
    let latched = |leak: f32, expiration: f32| {
        let mut run = Run::new();
        latches_above_peep(&mut run, 22.5);
        (0..7).any(|_| {
            run.state.volumes = Volumes::default();
            run.state.volumes.add(0.5, 16.0, leak, 2.0);
            run.state.volumes.add(expiration, 9.0, leak, 1.0);
            latches_above_peep(&mut run, 22.5)
        })
    };
    // 8 and 3 mL per 0.001 L/s at 1 cmH2O: three tenths of 1000 - 8 n are 150 + 3 n at 27.8.
    assert!(latched(0.0, -0.15) && latched(0.026, -0.15) && !latched(0.03, -0.15));
    assert!(!latched(0.125, 0.375), "the leak takes all of it");
}

#[test]
fn a_baseline_leaves_no_room_from_half_of_the_rise_and_five_above_peep_on() {
    let leaves_none = |pip: f32, baseline: f32| {
        let (mut run, breath) = (Run::new(), Breath::new(&paper_settings(pip), DEFAULT_PERIOD_US).unwrap());
        run.state.standing.observe(&breath.at(0), baseline);
        run.state.leaves_no_room(&breath, 5.0)
    };
    assert!(leaves_none(25.0, 15.1) && !leaves_none(25.0, 14.9));
    assert!(leaves_none(10.0, 10.1) && !leaves_none(10.0, 9.9));
}

#[test]
fn a_disconnected_patient_gets_a_capped_probe_and_no_response_is_awaited() {
    let mut run = Run::new();
    (0..2).for_each(|_| assert_eq!(run.inspire(STIFF, 30.0), None));
    // In mid-inspiration, so that this breath tells nothing of the lung.
    for tick in 0..300 {
        run.check(5.0 + 0.1 * run.state.lung.volume() + dither(tick), Some(tick));
        run.command(ControlOutput::plain(35.0));
    }
    let probe = run.breathe(300..1000, 0.0, ControlOutput::plain(90.0));
    assert_eq!((run.state.level(), probe[699] as i32), (Level::Pid, 40));
    for _ in 0..2 {
        run.breathe(1000..3000, 0.0, ControlOutput::plain(5.0));
        run.breathe(0..1000, 0.0, ControlOutput::plain(90.0));
    }
    let present = run.state.indications().present();
    assert!(present.has(Fault::Disconnection) && !present.has(Fault::NoResponse));
    run.breathe(0..50, 6.0, LEARNED);
    assert_eq!(run.state.level(), Level::Learned);
}

/// A breath with this plateau, in cmH2O, at a command in percent that is recorded.
fn breath_to(run: &mut Run, plateau: f32, command: f32) {
    for tick in 0..breath().total_ticks() {
        let inspires = breath().phase(tick) == Phase::Inspiration;
        // The first tick is at PEEP, from where a response is counted.
        run.check(if inspires && tick > 0 { plateau } else { 5.0 } + dither(tick), Some(tick));
        run.filter(ControlOutput::plain(command), !inspires);
    }
}

#[test]
fn two_inspirations_in_a_row_to_three_tenths_of_the_rise_end_backup_ventilation() {
    let mut run = Run::new();
    assert_eq!(run.inspire(STIFF, 40.0), None);
    run.silent_after();
    // The last reading is 0.07 cmH2O above the plateau, and 4.5 above PEEP are wanted.
    let levels = [9.5, 9.4, 9.5, 9.5].map(|plateau| {
        breath_to(&mut run, plateau, 0.0);
        run.state.level()
    });
    assert_eq!(levels, [Level::Backup, Level::Backup, Level::Backup, Level::Pid]);
}

#[test]
fn an_inspiration_to_seven_tenths_of_the_rise_is_a_good_one() {
    let backup_after = |plateau| {
        let mut run = Run::new();
        breath_to(&mut run, plateau, 10.0);
        run.state.backup.start_breath();
        run.backup(500) as i32
    };
    let before = Backup::new().command(&breath().at(500), true) as i32;
    assert_eq!((backup_after(15.4), backup_after(15.5)), (before, 10));
}

#[test]
fn backup_ventilation_delivers_below_five_under_the_limit() {
    let mut run = Run::new();
    assert_eq!(run.inspire(STIFF, 30.0), None);
    run.state.backup = Backup::new();
    let predicted = run.state.lung.predicted_pressure().unwrap();
    let command = |pressure_limit| {
        let settings = Settings { pressure_limit, ..paper_settings(20.0) };
        let breath = Breath::new(&settings, DEFAULT_PERIOD_US).unwrap();
        run.supervisor.backup_command(&run.state, &breath.at(500))
    };
    assert!(predicted > 32.0 && command(predicted + 5.0).abs() < 1e-6 && command(predicted + 5.1) > 1.0);
}

#[test]
fn a_noisy_sensor_beside_a_quiet_one_is_no_reason_for_the_cap() {
    let mut run = Run::new();
    for tick in 0..200 {
        let airway = 15.0 + 1.2 * ((tick * 7 % 5) as f32 - 2.0);
        run.check_all(Readings { outlet: 15.0 + dither(tick), ..Readings::from(airway) }, Some(tick));
    }
    assert_eq!((run.state.take_begun(), run.state.level()), (Some(Fault::ReadingNoisy), Level::Learned));
}

#[test]
fn coughs_in_expirations_are_no_strikes() {
    let mut run = Run::new();
    (0..2).for_each(|_| assert_eq!(run.inspire(SOFT, 30.0), None));
    let mut alarms = Vec::new();
    for tick in (0..4).flat_map(|_| 0..breath().total_ticks()) {
        let inspires = breath().phase(tick) == Phase::Inspiration;
        let cough = if (1700..1750).contains(&tick) { 60.0 } else { 0.0 };
        let rise = if inspires { 0.02 * run.state.lung.volume() } else { 0.0 };
        run.check(5.0 + rise + cough + dither(tick), Some(tick));
        run.filter(ControlOutput::plain(30.0), !inspires);
        alarms.extend(run.state.take_begun());
    }
    assert_eq!((alarms, run.state.level()), (Vec::from([Fault::HighPressure]), Level::Learned));
}

#[test]
fn the_commands_of_the_last_ticks_predict_the_course_of_the_pressure() {
    let mut run = Run::new();
    assert_eq!(run.inspire(STIFF, 40.0), None);
    for tick in 0..100 {
        run.check(5.0 + 0.1 * run.state.lung.volume() + dither(tick), Some(tick));
        run.command(ControlOutput::plain(40.0));
    }
    let expected =
        |state: &SupervisorState, tick| run.supervisor.expected(state, f32::NAN, &breath().at(tick));
    assert_eq!(expected(&run.state, 100), Expected::RiseTo(20.0));
    assert_eq!(expected(&run.state, 0), Expected::Any, "the estimate is that of the last breath");
    assert_eq!(expected(&run.state, 1000), Expected::Any, "no inspiration");
    let cut = SupervisorState { cut: Cut::ByGas, ..run.state.clone() };
    assert_eq!(expected(&cut, 100), Expected::Any);
    let open = |open| expected(&SupervisorState { open: Some(open), ..run.state.clone() }, 1040);
    assert_eq!((open(39), open(40)), (Expected::Any, Expected::FallTo(5.0)), "the valve takes 40 ms");
}

#[test]
fn each_expiration_is_compared_once_whether_the_clock_or_an_effort_ends_it() {
    let disagree = |breaths: u32, ticks: u32, effort: bool| {
        let mut run = Run::new();
        for _ in 0..breaths {
            for tick in 0..ticks {
                let (pressure, apart) = if tick < 1000 { (15.0, 0.0) } else { (5.0, 5.0) };
                let outlet = pressure + apart + dither(tick + 3);
                run.check_all(Readings { outlet, ..Readings::from(pressure + dither(tick)) }, Some(tick));
            }
            if effort {
                run.effort(ticks - 1);
            }
        }
        run.state.indications().present().has(Fault::SensorsDisagree)
    };
    assert!(disagree(2, 3000, false) && !disagree(2, 2999, false));
    assert!(disagree(2, 2500, true) && !disagree(1, 2500, true));
    assert!(!disagree(1, 3000, true), "an effort in the last tick");
}

#[test]
fn a_second_after_the_inspiration_an_effort_ends_an_expiration_with_a_baseline() {
    let high = |last: u32| {
        let mut run = Run::new();
        for _ in 0..2 {
            for tick in 0..=last {
                run.check(if tick < 1000 { 20.0 } else { 12.0 } + dither(tick), Some(tick));
            }
            run.effort(last);
        }
        run.state.indications().present().has(Fault::BaselineHigh)
    };
    assert_eq!((high(1999), high(2000)), (false, true));
}

#[test]
fn a_doubtful_pressure_below_peep_raises_no_flow() {
    let compensation = |outlet: f32| {
        let mut run = Run::new();
        for tick in 0..2000 {
            let (airway, outlet) = if tick < 1000 { (15.0, 15.0) } else { (3.0, outlet) };
            let outlet = outlet + dither(tick + 3);
            run.check_all(Readings { outlet, ..Readings::from(airway + dither(tick)) }, Some(tick));
        }
        run.state.expiration.compensation()
    };
    assert!(compensation(3.0) > 20.0 && compensation(6.0).abs() < 1e-6);
}

/// An inspiration with two sensors on a stiff lung that ends when this rise, cmH2O, is predicted.
fn filled_to(predicted: f32, second_sensor: bool) -> Run {
    filled_after(2, predicted, second_sensor)
}

/// The same after this number of inspirations.
fn filled_after(inspirations: u32, predicted: f32, second_sensor: bool) -> Run {
    let mut run = Run::new();
    (0..inspirations).for_each(|_| assert_eq!(run.inspire(STIFF, 30.0), None));
    for tick in 0.. {
        let pressure = 5.0 + 0.1 * run.state.lung.volume();
        let outlet = if second_sensor { pressure + dither(tick + 3) } else { f32::NAN };
        run.check_all(Readings { outlet, ..pressure.into() }, Some(tick));
        run.command(ControlOutput::plain(60.0));
        if run.state.lung.predicted_rise() > predicted {
            break;
        }
    }
    run
}

/// Whether a pressure without a response raises the alarm, or ends the inspiration in doubt, while the flow sensor shows a share of the valve's flow.
fn is_missing(mut run: Run, pressure: f32, share: f32, second_sensor: bool) -> bool {
    let flow = share * run.state.lung.flow();
    let outlet = if second_sensor { pressure } else { f32::NAN };
    let readings = Readings { airway: pressure, outlet, flow };
    // As if it had never risen: a pressure that falls is another matter.
    run.state.standing = Standing::default();
    run.supervisor.unresponsive(&mut run.state, pressure, &readings, breath().settings(), false);
    run.state.indications().present().has(Fault::NoResponse) || run.state.cut == Cut::InDoubt
}

#[test]
fn gas_that_a_patient_draws_in_is_no_missing_response() {
    let missing = |share: f32, predicted: f32, second_sensor: bool| {
        let run = filled_to(predicted, second_sensor);
        assert!((0.69..0.83).contains(&run.state.lung.flow()), "L/s at 60 %, less the back-pressure");
        is_missing(run, 8.0, share, second_sensor)
    };
    assert!(!missing(0.5, 12.0, true) && missing(0.49, 12.0, true), "half of the flow reaches the patient");
    assert!(!missing(1.0, 42.5, true) && missing(1.0, 43.0, true), "no effort takes away 40 cmH2O");
    assert!(missing(1.0, 12.0, false), "nothing confirms the only sensor");
    let risen = |predicted: f32| is_missing(filled_to(predicted, true), 9.0, 1.0, true);
    assert!(!risen(43.5) && risen(44.0), "4 of 44 are there");
    assert!(!is_missing(filled_after(1, 50.0, true), 5.0, 1.0, true), "a single inspiration proves nothing");
}

#[test]
fn a_pressure_that_stays_up_responds_whatever_is_predicted() {
    let Settings { pip, peep, .. } = *breath().settings();
    let at = |share: f32| is_missing(filled_to(50.0, true), peep + share * (pip - peep), 1.0, true);
    assert!(!at(0.301) && at(0.299), "30 % of the way from PEEP to PIP");
    let without_flow = |ticks: u32| {
        let mut run = filled_to(50.0, true);
        for tick in 900..900 + ticks {
            let (outlet, flow) = (25.0 + dither(tick + 3), run.state.lung.flow());
            run.check_all(Readings { airway: 25.0 + dither(tick), outlet, flow }, Some(tick));
            run.command(ControlOutput::plain(0.0));
        }
        let flow = run.state.lung.flow();
        (flow, is_missing(run, 25.0, 0.0, true))
    };
    let flows: Vec<_> = (40..80).map(without_flow).collect();
    assert!(flows.iter().any(|(flow, _)| *flow > 0.11) && flows.iter().any(|(flow, _)| *flow < 0.09));
    assert!(flows.iter().all(|(flow, missing)| *missing == (*flow >= 0.1)), "{flows:?}");
}

#[test]
fn a_leak_is_learned_from_a_connected_patient_alone() {
    let learned = |disconnected: bool| {
        let mut run = Run::new();
        run.breathe(0..1, 5.0, ControlOutput::plain(50.0));
        run.breathe(1..700, if disconnected { 0.0 } else { 15.0 }, ControlOutput::plain(50.0));
        assert_eq!(run.state.breath.is_disconnected(), disconnected);
        let pressure = if disconnected { 0.0 } else { 5.0 };
        for _ in 0..2 {
            (2900..3000).for_each(|tick| _ = run.check(pressure, Some(tick)));
            // 0.2 L in 1 s at 9 cmH2O, of which nothing comes out.
            run.state.volumes = Volumes::default();
            run.state.volumes.add(0.2, 9.0, 0.0, 1.0);
            (0..3).for_each(|tick| _ = run.check(pressure, Some(tick)));
        }
        run.state.expiration.compensation()
    };
    assert!(learned(false) > 10.0 && learned(true).abs() < 1e-6);
}

#[test]
fn without_a_breath_the_command_is_the_safe_one_at_once() {
    let mut run = Run::new();
    run.breathe(0..5, 15.0, ControlOutput { base: 0.0, command: 100.0 });
    run.check(15.0, None);
    assert_eq!(run.command(LEARNED), ValveCommand::SAFE, "however large the learned part was");
}

#[test]
fn an_effort_shows_in_a_reading_of_this_tick_alone() {
    let (mut run, breath) = (Run::new(), breath());
    let mut shows = |reading: f32, tick| {
        let belief = run.supervisor.check(&mut run.state, &reading.into(), breath.at(tick)).unwrap();
        (belief.pressure.to_bits(), belief.effort)
    };
    assert_eq!(shows(5.0, 0), (5.0_f32.to_bits(), 5.0));
    let (pressure, effort) = shows(f32::NAN, 1);
    assert!(pressure == 5.0_f32.to_bits() && effort.is_nan());
}

#[test]
fn flow_that_holds_peep_is_an_alarm_unless_the_patient_draws_it_in() {
    let alarmed = |flow: f32| {
        let mut run = Run::new();
        for _ in 0..9 {
            for tick in 0..1901 {
                let pressure = if tick < 1000 { 15.0 } else { 3.2 };
                let flow = if tick == 1900 { flow } else { 0.0 };
                run.check_all(Readings { flow, ..Readings::from(pressure + dither(tick)) }, Some(tick));
                run.filter(ControlOutput::plain(0.0), tick >= 1000);
            }
            run.effort(1900);
        }
        run.state.indications().present().has(Fault::BaselineLow)
    };
    // Of a step, 98 % are above the smoothed flow.
    assert!(alarmed(0.0) && alarmed(0.05) && !alarmed(0.052));
}

/// Two breaths into a tube at the room's pressure with full flow, after two that have shown the lung: the tick at which the first
/// inspiration is cut, and the alarms.
fn into_the_room(comes_back: bool) -> (Option<u32>, FaultSet) {
    let mut run = Run::new();
    (0..2).for_each(|_| assert_eq!(run.inspire(Lung::Elastic(0.05), 20.0), None));
    let (breath, mut cut) = (breath(), None);
    for tick in (0..2).flat_map(|_| 0..breath.total_ticks()) {
        let inspires = breath.phase(tick) == Phase::Inspiration;
        let returns = comes_back && (1050..1650).contains(&tick);
        let flow = match run.state.lung.valve_flow() {
            flow if inspires && !run.state.cut() => flow,
            _ => {
                if returns {
                    -1.5
                } else {
                    0.0
                }
            }
        };
        let readings = Readings { airway: 0.2 + dither(tick), outlet: f32::NAN, flow };
        run.check_all(readings, Some(tick));
        cut = cut.or(run.state.cut().then_some(tick));
        run.filter(ControlOutput::plain(100.0), !inspires);
        run.supervisor.end_tick(&mut run.state, &breath.at(tick), false);
    }
    (cut, run.state.indications().present())
}

#[test]
fn gas_that_flows_at_the_rooms_pressure_ends_the_inspiration_and_the_expiration_tells_why() {
    let (cut, alarms) = into_the_room(false);
    assert!(cut.is_some_and(|tick| tick < 600), "{cut:?}");
    assert!(alarms.has(Fault::Disconnection) && !alarms.has(Fault::NoResponse), "nothing comes back");
    let (cut, alarms) = into_the_room(true);
    assert!(cut.is_some_and(|tick| tick < 600), "no more gas than without a pressure that responds: {cut:?}");
    assert!(alarms.has(Fault::NoResponse) && !alarms.has(Fault::Disconnection), "the readings are wrong");
    assert!(!alarms.has(Fault::HighPressure));
}

#[test]
fn a_pressure_that_an_effort_draws_down_at_the_end_of_expirations_is_no_lost_peep() {
    let alarmed = |from: u32| {
        let mut run = Run::new();
        for tick in (0..4).flat_map(|_| 0..breath().total_ticks()) {
            let inspires = breath().phase(tick) == Phase::Inspiration;
            let pressure = match tick {
                _ if inspires => 20.0,
                tick if tick >= from => 2.0,
                _ => 5.0,
            };
            run.check_all(Readings { flow: 0.0, ..Readings::from(pressure + dither(tick)) }, Some(tick));
            run.filter(ControlOutput::plain(0.0), !inspires);
        }
        run.state.indications().present().has(Fault::BaselineLow)
    };
    assert!(alarmed(2500) && !alarmed(2850));
}
