//! The supervisor checks the volumes of each breath.

use super::*;
use crate::safety::lung_estimator::command_for;

/// Ticks at the end of an expiration in which the lung has emptied.
const EMPTY: u32 = 500;

/// A passive patient who leaks.
struct Patient {
    run: Run,
    settings: Settings,
    /// Leak, L/s at 1 cmH2O.
    leak: f32,
    /// Gas of each breath that stays in the lung, mL.
    kept: f32,
    /// Pressure above PEEP, cmH2O.
    above: f32,
}

impl Patient {
    fn new(settings: Settings) -> Self {
        Self { run: Run::new(), settings, leak: 0.0, kept: 0.0, above: 0.0 }
    }

    /// Breaths with this volume of the lung, mL; the alarms that begin.
    fn breathe(&mut self, count: usize, volume: f32) -> Vec<Fault> {
        let breath = Breath::new(&self.settings, DEFAULT_PERIOD_US).unwrap();
        let (inspiration, total) = (breath.inspiration_ticks(), breath.total_ticks());
        let mut alarms = Vec::new();
        for tick in (0..count).flat_map(|_| 0..total) {
            let inspires = tick < inspiration;
            let flow = if inspires {
                volume / 1000.0
            } else if tick < total - EMPTY {
                (self.kept - volume) / (total - EMPTY - inspiration) as f32
            } else {
                0.0
            };
            let (leak, airway) = (3.0 * self.leak, self.settings.peep + self.above + dither(tick));
            let readings = Readings { airway, outlet: f32::NAN, flow: flow + leak };
            let Run { supervisor, state, .. } = &mut self.run;
            if let Some(belief) = supervisor.check(state, &readings, breath.at(tick)) {
                let given = ControlOutput::plain(command_for(flow.max(0.0) + leak));
                supervisor.command(state, &belief, given, !inspires);
            }
            alarms.extend(self.run.state.take_begun());
        }
        alarms
    }
}

/// Settings with a PEEP at which nothing else is wrong, and a lower limit of the tidal volume, mL.
fn limited(tidal_volume_low: f32) -> Settings {
    Settings { peep: 9.0, tidal_volume_low, ..paper_settings(20.0) }
}

#[test]
fn a_tidal_volume_below_its_limit_is_an_alarm_after_three_breaths() {
    let mut patient = Patient::new(limited(300.0));
    assert_eq!(patient.breathe(5, 400.0), []);
    assert_eq!(patient.breathe(3, 200.0), []);
    assert_eq!(patient.breathe(1, 200.0), [Fault::TidalVolumeLow]);
}

#[test]
fn settings_that_change_in_every_breath_do_not_delay_that_alarm() {
    let mut patient = Patient::new(limited(300.0));
    let mut breathe = |number: usize, volume: f32| {
        patient.settings.rate = [20.0, 20.1][number % 2];
        patient.breathe(1, volume)
    };
    assert!((0..5).all(|number| breathe(number, 400.0).is_empty()));
    assert_eq!((5..20).find(|number| breathe(*number, 200.0) == [Fault::TidalVolumeLow]), Some(5 + 3));
}

#[test]
fn the_gas_of_a_leak_is_no_part_of_the_expired_volume_and_no_loss_from_it() {
    // 0.03 L/s: 60 mL in the 2 s of an expiration, and 90 mL in a breath, of which a fifth is in doubt.
    for (limit, alarms) in [(390.0, &[][..]), (425.0, &[Fault::TidalVolumeLow])] {
        let mut patient = Patient::new(limited(0.0));
        patient.leak = 0.01;
        patient.breathe(30, 400.0);
        patient.settings = limited(limit);
        assert_eq!(patient.breathe(30, 400.0), alarms, "{limit} mL");
    }
}

#[test]
fn a_flow_sensor_that_is_lost_is_told() {
    let mut patient = Patient::new(limited(0.0));
    patient.breathe(3, 400.0);
    assert_eq!(patient.breathe(2, f32::NAN), [Fault::FlowSensorLost]);
}

/// Good breaths at 30 % with 0.3 L/s, then half of an inspiration without a pressure sensor at this share of the flow; the command
/// of backup ventilation, percent, and the volume that the lung estimate has counted, mL.
fn blind_at(share: f32, monitors: Monitors) -> (f32, f32) {
    let mut run = Run::new();
    run.supervisor = Supervisor::new(DEFAULT_PERIOD_US, monitors);
    good_breaths(&mut run, 3, 1.0);
    for tick in 0..500 {
        tick_at(&mut run, tick, f32::NAN, share);
    }
    (run.backup(500), run.state.lung.volume())
}

/// A tick at 30 % with this share of the valve's flow.
fn tick_at(run: &mut Run, tick: u32, airway: f32, share: f32) {
    tick_with(run, tick, airway, (30.0, share, 0.14 * share));
}

/// A tick at a command, percent, with a share of the valve's flow, and a flow out of the lung, L/s.
fn tick_with(run: &mut Run, tick: u32, airway: f32, (command, share, out): (f32, f32, f32)) {
    let inspires = breath().phase(tick) == Phase::Inspiration;
    let flow = match tick {
        _ if inspires => share * run.state.lung.valve_flow(),
        1000..2500 => -4.0 / 3.0 * out,
        _ => 0.0,
    };
    run.check_all(Readings { airway, outlet: f32::NAN, flow }, Some(tick));
    run.filter(ControlOutput::plain(if inspires { command } else { 0.0 }), !inspires);
}

/// Breaths at 30 % with a good rise of the pressure and this share of the valve's flow; the alarms that begin.
fn good_breaths(run: &mut Run, count: usize, share: f32) -> Vec<Fault> {
    breaths_with(run, count, (30.0, share, 0.14 * share))
}

/// The same with what [`tick_with`] takes.
fn breaths_with(run: &mut Run, count: usize, drive: (f32, f32, f32)) -> Vec<Fault> {
    let mut alarms = Vec::new();
    for tick in (0..count).flat_map(|_| 0..breath().total_ticks()) {
        let pressure = 5.0 + 0.015 * breath().inspiration_ticks().min(tick) as f32;
        let airway = if tick < 1000 { pressure } else { (20.0 - 0.02 * (tick - 1000) as f32).max(5.0) };
        tick_with(run, tick, airway + dither(tick), drive);
        alarms.extend(run.state.take_begun());
    }
    alarms
}

/// Command that takes less than half of the flow at 30 %, percent, and that flow, L/s.
const SMALL: (f32, f32) = (18.0, 0.13);

#[test]
fn breaths_that_lose_half_of_their_volume_are_an_alarm_without_a_limit() {
    let mut run = Run::new();
    assert_eq!(good_breaths(&mut run, 60, 1.0), []);
    let (command, flow) = SMALL;
    assert_eq!(breaths_with(&mut run, 7, (command, 1.0, 0.5 * flow)), [Fault::VentilationFalls]);
    assert_eq!(breaths_with(&mut run, 4, (command, 1.0, 0.5 * flow)), [Fault::VentilationLost]);
    // A flow sensor that shows less of the same flow has failed.
    let mut run = Run::new();
    good_breaths(&mut run, 60, 1.0);
    assert_eq!(good_breaths(&mut run, 30, 0.45), [Fault::FlowSensorLost]);
}

#[test]
fn a_higher_baseline_is_awaited_for_two_breaths_after_a_change_of_the_settings() {
    let mut patient = Patient::new(limited(0.0));
    assert_eq!(patient.breathe(5, 400.0), []);
    (patient.settings.peep, patient.above) = (5.0, 4.0);
    assert!(!patient.breathe(3, 400.0).contains(&Fault::BaselineHigh));
    assert!(patient.breathe(1, 400.0).contains(&Fault::BaselineHigh));
}

#[test]
fn gas_that_a_lung_takes_to_reach_a_higher_peep_is_no_leak() {
    // 50 of 400 mL come out in each of five breaths; the first of them fills the lung, of 50 mL/cmH2O.
    let losing = |rise: f32| {
        let mut patient = Patient::new(Settings { pip: 60.0, pressure_limit: 70.0, ..limited(0.0) });
        patient.breathe(5, 400.0);
        patient.settings.peep -= 8.0;
        patient.breathe(8, 400.0);
        patient.settings.peep += rise;
        patient.kept = 350.0;
        let mut alarms = patient.breathe(5, 400.0);
        patient.kept = 0.0;
        alarms.extend(patient.breathe(2, 400.0));
        alarms.contains(&Fault::Leak)
    };
    assert_eq!([losing(0.0), losing(6.0), losing(8.0)], [true, true, false]);
}

#[test]
fn small_breaths_whose_gas_stays_in_the_lung_are_no_leak() {
    let losing = |command: f32, flow: f32| {
        let mut run = Run::new();
        good_breaths(&mut run, 60, 1.0);
        {
            let a = breaths_with(&mut run, 12, (command, 1.0, 0.18 * flow));
            a.contains(&Fault::Leak)
        }
    };
    assert!(losing(30.0, 0.3) && !losing(SMALL.0, SMALL.1));
}

#[test]
fn gas_that_a_lung_takes_again_after_a_strain_is_no_leak() {
    let refills = |pressed: f32| {
        let mut patient = Patient::new(limited(0.0));
        assert_eq!(patient.breathe(5, 400.0), []);
        patient.kept = -pressed;
        patient.breathe(1, 400.0);
        patient.kept = 250.0;
        patient.breathe(6, 400.0)
    };
    assert_eq!((refills(1500.0), refills(0.0)), (Vec::new(), Vec::from([Fault::Leak])));
}

#[test]
fn without_a_pressure_sensor_the_flow_sensor_corrects_the_commands() {
    // 0.3 L/s in 460 ms: 28 mL of them are missing at four fifths.
    let (command, volume) = blind_at(1.0, Monitors::ALL);
    assert!((30.0..33.0).contains(&command) && (130.0..142.0).contains(&volume), "{command} % {volume} mL");
    let (corrected, less) = blind_at(0.8, Monitors::ALL);
    assert!((40.0..46.0).contains(&corrected), "{corrected} %");
    assert!((less / volume - 0.8).abs() < 0.03, "{less} mL");
}

#[test]
fn a_flow_sensor_that_stands_still_or_a_missing_response_leaves_the_commands() {
    for (share, monitors) in [
        (0.0, Monitors::ALL),
        (f32::NAN, Monitors::ALL),
        (0.8, Monitors::ALL.without_response(Response::BackupByFlow)),
    ] {
        let (command, volume) = blind_at(share, monitors);
        assert!((command - 30.0).abs() < 0.1, "{share}: {command} %");
        // The first 100 mL count as 60 at least.
        assert!((94.0..142.0).contains(&volume), "{share}: {volume} mL");
    }
}
