use super::*;

/// Resistance and compliance of the patient.
const LUNG: (f64, f64) = (20.0, 20.0);

/// A breath in which nothing is wrong: PIP 20, PEEP 5, limit 60, 400 mL and 8 L/min.
fn sound() -> BreathTruth {
    let limits = Settings {
        tidal_volume_low: 300.0,
        tidal_volume_high: 500.0,
        minute_volume_low: 6.0,
        minute_volume_high: 10.0,
        ..Settings::default()
    };
    let mut breath = BreathTruth::new(&limits, true);
    (breath.ended, breath.expired, breath.minute_volume) = (true, 400.0, Some(8.0));
    (breath.peak, breath.lowest) = (21.0, 4.8);
    (breath.plateau, breath.baseline) = (Some(20.0), Some(5.1));
    (breath.leak, breath.leak_at_end, breath.resistance) = (0.005, 0.002, Some(LUNG.0));
    breath
}

/// A sensor with these errors, alternating, over a breath.
fn sensor(errors: [f64; 2]) -> SensorTruth {
    let mut sensor = SensorTruth::default();
    for (number, error) in errors.into_iter().cycle().take(3000).enumerate() {
        let pressure = 10.0 + 0.01 * number as f64;
        sensor.add((pressure + error) as f32, pressure);
    }
    sensor
}

fn with(change: impl Fn(&mut BreathTruth)) -> BreathTruth {
    let mut breath = sound();
    change(&mut breath);
    breath
}

/// Whether the alarm is deserved after this breath, once and twice, with a sound one running.
fn verdicts(fault: Fault, breath: &BreathTruth) -> (bool, bool) {
    let after = |breaths: [&BreathTruth; 2]| {
        let breaths = breaths.into_iter().cloned().chain([sound()]).collect();
        judge(fault, &History::of(breaths, LUNG)) == Verdict::Deserved
    };
    (after([&sound(), breath]), after([breath, breath]))
}

#[track_caller]
fn deserved_once(fault: Fault, change: impl Fn(&mut BreathTruth)) {
    assert_eq!(verdicts(fault, &with(change)), (true, true), "{fault:?}");
}

#[track_caller]
fn deserved_twice(fault: Fault, change: impl Fn(&mut BreathTruth)) {
    let breath = with(change);
    assert_eq!(verdicts(fault, &breath), (false, true), "{fault:?}");
    let new = BreathTruth { settled: false, ..breath };
    assert_eq!(verdicts(fault, &new), (false, false), "{fault:?} after a change of the settings");
}

#[track_caller]
fn undeserved(fault: Fault, change: impl Fn(&mut BreathTruth)) {
    assert_eq!(verdicts(fault, &with(change)), (false, false), "{fault:?}");
}

#[test]
fn nothing_is_deserved_if_nothing_is_wrong_and_low_priorities_are_only_counted() {
    for fault in Fault::all() {
        let verdict = judge(fault, &History::of(vec![sound(); 3], LUNG));
        let low = fault.alarm().priority == Priority::Low;
        assert_eq!(verdict, if low { Verdict::Counted } else { Verdict::Undeserved }, "{fault:?}");
    }
}

#[test]
fn pressure_above_the_limit() {
    for fault in [Fault::HighPressure, Fault::CommandCapped] {
        deserved_once(fault, |breath| breath.peak = 60.5);
        undeserved(fault, |breath| breath.peak = 58.0);
    }
    deserved_once(Fault::HardLimit, |breath| breath.vented_above_ms = 700);
    undeserved(Fault::HardLimit, |breath| breath.vented_above_ms = 300);
    deserved_once(Fault::SustainedPressure, |breath| breath.away_ms = 15_000);
    undeserved(Fault::SustainedPressure, |breath| breath.away_ms = 3000);
}

#[test]
fn a_baseline_away_from_peep() {
    let high = with(|breath| (breath.baseline, breath.settled) = (Some(8.5), false));
    assert_eq!(verdicts(Fault::BaselineHigh, &high), (false, true), "whether the settings are new or not");
    undeserved(Fault::BaselineHigh, |breath| (breath.baseline, breath.peep_is_lower) = (Some(8.5), true));
    undeserved(Fault::BaselineHigh, |breath| breath.baseline = Some(6.5));
    deserved_twice(Fault::BaselineLow, |breath| breath.baseline = Some(2.5));
    undeserved(Fault::BaselineLow, |breath| breath.baseline = Some(4.5));
    let effort = |breath: &mut BreathTruth| (breath.baseline, breath.effort_at_end) = (Some(2.5), 6.0);
    undeserved(Fault::BaselineLow, effort);
    deserved_twice(Fault::BaselineLow, |breath| {
        effort(breath);
        breath.leak = 0.3;
    });
}

#[test]
fn the_first_two_breaths_with_a_lower_peep_are_known() {
    let mut history = History::of(vec![sound()], LUNG);
    let at = |peep: f32| Settings { peep, ..Settings::default() };
    let lower = [5.0, 3.0, 3.0, 3.0, 6.0].map(|peep| {
        history.start_breath(&at(peep));
        history.running().peep_is_lower
    });
    assert_eq!(lower, [false, true, true, false, false]);
}

#[test]
fn an_inspiration_that_does_not_reach_its_pressure() {
    deserved_twice(Fault::LowPressure, |breath| breath.plateau = Some(9.0));
    undeserved(Fault::LowPressure, |breath| breath.plateau = Some(12.0));
}

#[test]
fn leak_and_disconnection() {
    deserved_twice(Fault::Leak, |breath| breath.leak_at_end = 0.1);
    deserved_twice(Fault::Leak, |breath| breath.leak_share = 0.25);
    let new = with(|breath| (breath.leak, breath.leak_share, breath.settled) = (0.2, 0.5, false));
    assert_eq!(verdicts(Fault::Leak, &new), (false, true), "a large leak at settings that are new");
    undeserved(Fault::Leak, |breath| (breath.leak_at_end, breath.leak_share) = (0.02, 0.05));
    deserved_once(Fault::Disconnection, |breath| breath.leak = 20.0);
    undeserved(Fault::Disconnection, |breath| breath.leak = 0.5);
    undeserved(Fault::Disconnection, |breath| (breath.lowest, breath.effort) = (-5.0, 20.0));
}

#[test]
fn an_occluded_tube() {
    deserved_twice(Fault::Occlusion, |breath| breath.resistance = Some(2e5));
    undeserved(Fault::Occlusion, |breath| breath.resistance = Some(30.0));
    undeserved(Fault::Occlusion, |breath| breath.cough = 60.0);
}

#[test]
fn volumes_outside_their_limits() {
    deserved_once(Fault::MinuteVolumeLow, |breath| breath.minute_limits.0 = 8.0);
    // Each breath has limits of its own, so that no change of the settings excuses one.
    let small = with(|breath| (breath.expired, breath.settled) = (320.0, false));
    assert_eq!(verdicts(Fault::TidalVolumeLow, &small), (false, true));
    undeserved(Fault::TidalVolumeLow, |breath| breath.expired = 340.0);
    undeserved(Fault::TidalVolumeLow, |breath| (breath.ended, breath.expired) = (false, 0.0));
    let large = with(|breath| (breath.expired, breath.settled) = (460.0, false));
    assert_eq!(verdicts(Fault::TidalVolumeHigh, &large), (false, true));
    undeserved(Fault::TidalVolumeHigh, |breath| breath.expired = 440.0);
    deserved_once(Fault::MinuteVolumeLow, |breath| breath.minute_volume = Some(6.5));
    undeserved(Fault::MinuteVolumeLow, |breath| breath.minute_volume = Some(6.7));
    deserved_once(Fault::MinuteVolumeHigh, |breath| breath.minute_volume = Some(9.1));
    undeserved(Fault::MinuteVolumeHigh, |breath| breath.minute_volume = Some(8.9));
    let off = |breath: &mut BreathTruth| {
        (breath.settings, breath.minute_limits) = (Settings::default(), (0.0, 0.0));
        (breath.expired, breath.minute_volume) = (4000.0, Some(80.0));
    };
    undeserved(Fault::TidalVolumeHigh, off);
    undeserved(Fault::MinuteVolumeHigh, off);
    deserved_once(Fault::Apnoea, |breath| breath.without_s = 20.0);
    undeserved(Fault::Apnoea, |breath| breath.without_s = 18.0);
}

#[test]
fn volumes_that_are_smaller_than_the_usual_ones() {
    let verdicts = |fault: Fault, volume: f64, small_s: f64| {
        verdicts(
            fault,
            &with(|breath| {
                (breath.inspired, breath.expired, breath.usual) = (volume, volume, Some(400.0));
                breath.small_s = small_s;
            }),
        )
    };
    let [falls, lost] = [Fault::VentilationFalls, Fault::VentilationLost];
    assert_eq!((verdicts(falls, 290.0, 9.0), verdicts(falls, 300.0, 9.0)), ((false, true), (false, false)));
    assert_eq!((verdicts(lost, 210.0, 9.0), verdicts(lost, 230.0, 9.0)), ((false, true), (false, false)));
    assert_eq!((verdicts(lost, 290.0, 50.0), verdicts(lost, 290.0, 49.0)), ((false, true), (false, false)));
    // Of the usual volume nothing is known at first.
    undeserved(falls, |breath| (breath.inspired, breath.expired) = (0.0, 0.0));
}

#[test]
fn volumes_that_a_wrong_flow_sensor_shows() {
    let sees = |gain: f64, zero: f64| {
        move |breath: &mut BreathTruth| {
            for ms in 0..2000 {
                let flow = if ms < 1000 { 0.4 } else { -0.4 };
                breath.flow.add((gain * flow + zero) as f32, flow);
            }
            breath.usual = Some(400.0);
        }
    };
    for (low, high) in
        [(Fault::TidalVolumeLow, Fault::TidalVolumeHigh), (Fault::MinuteVolumeLow, Fault::MinuteVolumeHigh)]
    {
        let twice = |fault, gain| verdicts(fault, &with(sees(gain, 0.0))).1;
        assert!(twice(low, 0.7) && !twice(low, 1.4) && !twice(low, 0.92), "{low:?}");
        assert!(twice(high, 1.4) && !twice(high, 0.7) && !twice(high, 1.08), "{high:?}");
    }
    let fallen = |gain| verdicts(Fault::VentilationFalls, &with(sees(gain, 0.0)));
    // 400 mL that look like 240, or like 340.
    assert_eq!((fallen(0.6), fallen(0.85)), ((false, true), (false, false)));
    deserved_twice(Fault::Leak, sees(1.0, 0.05));
    undeserved(Fault::Leak, sees(1.0, 0.01));
    undeserved(Fault::Leak, sees(0.7, 0.0));
}

#[test]
fn a_pressure_that_does_not_respond() {
    deserved_once(Fault::NoResponse, |breath| breath.starved_ms = 200);
    deserved_once(Fault::NoResponse, |breath| breath.leak = 20.0);
    deserved_once(Fault::NoResponse, |breath| breath.airway = sensor([5.0, 5.0]));
    undeserved(Fault::NoResponse, |breath| breath.effort = 20.0);
}

#[test]
fn errors_of_the_sensors() {
    let airway = |errors| move |breath: &mut BreathTruth| breath.airway = sensor(errors);
    deserved_once(Fault::SensorsDisagree, airway([2.5, 2.5]));
    undeserved(Fault::SensorsDisagree, airway([1.0, 1.0]));
    deserved_once(Fault::ReadingNoisy, airway([0.5, -0.5]));
    undeserved(Fault::ReadingNoisy, airway([0.2, -0.2]));
    deserved_once(Fault::ReadingJumps, airway([0.0, 40.0]));
    undeserved(Fault::ReadingJumps, airway([0.0, 5.0]));
    deserved_once(Fault::ReadingOutOfRange, airway([0.0, -41.0]));
    undeserved(Fault::ReadingOutOfRange, airway([0.0, -39.0]));
    deserved_once(Fault::ReadingNotANumber, airway([0.0, f64::NAN]));
    undeserved(Fault::BackupVentilation, airway([5.0, 5.0]));
    deserved_once(Fault::BackupVentilation, |breath| {
        (breath.airway, breath.outlet) = (sensor([5.0, 5.0]), sensor([f64::NAN, f64::NAN]));
    });
}

#[test]
fn a_sensor_is_frozen_only_if_the_pressure_moves() {
    let frozen = |speed: f64| {
        let mut sensor = SensorTruth::default();
        (0..1000_u16).for_each(|ms| sensor.add(5.0, 5.0 + speed * f64::from(ms)));
        sensor
    };
    deserved_once(Fault::ReadingFrozen, |breath| breath.airway = frozen(0.05));
    undeserved(Fault::ReadingFrozen, |breath| breath.airway = frozen(0.0));
}

#[test]
fn the_bench_neither_misses_ticks_nor_resets_the_device() {
    for fault in [Fault::MissedTicks, Fault::Restarted] {
        undeserved(fault, |breath| breath.peak = 90.0);
    }
}
