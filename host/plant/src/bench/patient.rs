//! Patient: effort, cough, and a lung that changes from a given breath on.

use std::f64::consts::PI;

use super::config::PatientConfig;

/// A half sine of `duration`, 0 outside.
fn pulse(since_start_s: f64, duration_s: f64) -> f64 {
    if (0.0..duration_s).contains(&since_start_s) { (PI * since_start_s / duration_s).sin() } else { 0.0 }
}

/// The patient; the only state is the number of breaths received.
#[derive(Clone, Debug)]
pub(super) struct Patient {
    config: PatientConfig,
    venting: bool,
    breath: u32,
}

impl Patient {
    /// A patient who has not been ventilated yet, on a venting circuit.
    pub(super) fn new(config: PatientConfig) -> Self {
        Self { config, venting: true, breath: 0 }
    }

    /// Adds a cough at this time, s.
    pub(super) fn cough(&mut self, peak: f64, at_s: f64) {
        (self.config.cough_cmh2o, self.config.cough_at_s) = (peak, at_s);
    }

    /// Counts the breath if one starts; returns the factors on resistance and compliance if they change now.
    pub(super) fn observe(&mut self, u_out: bool) -> Option<(f64, f64)> {
        let starts = self.venting && !u_out;
        self.venting = u_out;
        if !starts {
            return None;
        }
        self.breath = self.breath.saturating_add(1);
        let config = &self.config;
        (self.breath == config.change_at_breath)
            .then_some((config.resistance_factor, config.compliance_factor))
    }

    /// Pressure of the respiratory muscles in cmH2O: positive draws gas in; a cough is negative.
    pub(super) fn muscle_pressure(&self, time_s: f64) -> f64 {
        let config = &self.config;
        let mut pressure = 0.0;
        if config.effort_cmh2o > 0.0 {
            let since_start_s = time_s % (60.0 / config.effort_rate_per_min);
            pressure += config.effort_cmh2o * pulse(since_start_s, config.effort_duration_s);
        }
        if config.cough_cmh2o > 0.0 {
            pressure -= config.cough_cmh2o * pulse(time_s - config.cough_at_s, config.cough_duration_s);
        }
        pressure
    }

    /// Breaths started so far.
    pub(super) fn breath(&self) -> u32 {
        self.breath
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_passive_by_default() {
        let patient = Patient::new(PatientConfig::default());
        for ms in 0..10_000 {
            assert!(patient.muscle_pressure(f64::from(ms) * 1e-3).abs() < f64::EPSILON);
        }
    }

    #[test]
    fn effort_returns_at_its_rate() {
        let config =
            PatientConfig { effort_cmh2o: 8.0, effort_rate_per_min: 15.0, ..PatientConfig::default() };
        let patient = Patient::new(config);
        let middle_s = 0.5 * config.effort_duration_s;
        for breath in 0..3 {
            let start_s = 4.0 * f64::from(breath);
            assert!((patient.muscle_pressure(start_s + middle_s) - 8.0).abs() < 1e-9);
            assert!(patient.muscle_pressure(start_s + config.effort_duration_s + 0.1).abs() < 1e-12);
        }
    }

    #[test]
    fn a_cough_is_one_expulsive_pulse() {
        let config = PatientConfig { cough_cmh2o: 40.0, cough_at_s: 2.0, ..PatientConfig::default() };
        let patient = Patient::new(config);
        assert!(patient.muscle_pressure(1.999).abs() < 1e-12);
        assert!((patient.muscle_pressure(2.0 + 0.5 * config.cough_duration_s) + 40.0).abs() < 1e-9);
        assert!(patient.muscle_pressure(2.0 + config.cough_duration_s + 1e-3).abs() < 1e-12);
    }

    #[test]
    fn a_breath_starts_when_the_expiratory_valve_is_told_to_close() {
        let mut patient = Patient::new(PatientConfig::default());
        for u_out in [true, false, false, true, true, false, true] {
            patient.observe(u_out);
        }
        assert_eq!(patient.breath(), 2);
    }

    #[test]
    fn the_lung_changes_once_at_the_stated_breath() {
        let config =
            PatientConfig { change_at_breath: 2, resistance_factor: 3.0, ..PatientConfig::default() };
        let mut patient = Patient::new(config);
        let changes: Vec<_> = [false, true, false, true, false].map(|u_out| patient.observe(u_out)).into();
        assert_eq!(changes, [None, None, Some((3.0, 1.0)), None, None]);
    }
}
