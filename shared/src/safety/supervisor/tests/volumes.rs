//! The supervisor checks the volumes of each breath.

use super::*;

/// A passive patient who leaks.
struct Patient {
    run: Run,
    settings: Settings,
    /// Leak, L/s at 1 cmH2O.
    leak: f32,
}

impl Patient {
    fn new(settings: Settings) -> Self {
        Self { run: Run::new(), settings, leak: 0.0 }
    }

    /// Breaths with this volume of the lung, mL, at a pressure of 9 cmH2O; the alarms that begin.
    fn breathe(&mut self, count: usize, volume: f32) -> Vec<Fault> {
        let breath = Breath::new(&self.settings, DEFAULT_PERIOD_US).unwrap();
        let (inspiration, total) = (breath.inspiration_ticks(), breath.total_ticks());
        let mut alarms = Vec::new();
        for tick in (0..count).flat_map(|_| 0..total) {
            let flow =
                if tick < inspiration { volume / 1000.0 } else { -volume / (total - inspiration) as f32 };
            let airway = 9.0 + dither(tick);
            let readings = Readings { airway, outlet: f32::NAN, flow: flow + 3.0 * self.leak };
            self.run.supervisor.check(&mut self.run.state, &readings, breath.at(tick));
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
fn a_change_of_the_settings_delays_that_alarm_by_two_breaths() {
    let mut patient = Patient::new(limited(300.0));
    assert_eq!(patient.breathe(5, 400.0), []);
    patient.settings.pip = 21.0;
    assert_eq!(patient.breathe(5, 200.0), []);
    assert_eq!(patient.breathe(1, 200.0), [Fault::TidalVolumeLow]);
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
    let tick_of = |run: &mut Run, tick: u32, airway: f32, share: f32| {
        let inspires = breath().phase(tick) == Phase::Inspiration;
        let flow = if inspires { share * run.state.lung.valve_flow() } else { -0.05 };
        run.check_all(Readings { airway, outlet: f32::NAN, flow }, Some(tick));
        run.filter(ControlOutput::plain(if inspires { 30.0 } else { 0.0 }), !inspires);
    };
    for tick in (0..3).flat_map(|_| 0..breath().total_ticks()) {
        let pressure = 5.0 + 0.015 * breath().inspiration_ticks().min(tick) as f32;
        let airway = if tick < 1000 { pressure } else { (20.0 - 0.02 * (tick - 1000) as f32).max(5.0) };
        tick_of(&mut run, tick, airway + dither(tick), 1.0);
    }
    for tick in 0..500 {
        tick_of(&mut run, tick, f32::NAN, share);
    }
    (run.backup(500), run.state.lung.volume())
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
