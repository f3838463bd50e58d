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
            self.run.supervisor.check(&mut self.run.state, &readings, &breath, Some(tick));
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
    // 0.03 L/s: 60 mL in the 2 s of an expiration.
    for (limit, alarms) in [(390.0, &[][..]), (410.0, &[Fault::TidalVolumeLow])] {
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
