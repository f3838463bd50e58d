//! Patient: efforts, coughs, secretions, and a lung that changes from a given breath on.

use core::f64::consts::TAU;

use super::config::{PatientConfig, Strain};
use super::coughs::Coughs;
use super::drive::Drive;
use super::pulse::pulse;
use crate::math::{cos, round};
use crate::random::stream;

/// `ChaCha` stream of the efforts.
const DRIVE_STREAM: u64 = 2;
/// `ChaCha` stream of the coughs.
const COUGH_STREAM: u64 = 3;

/// The patient. A passive or regular one has no state but the number of breaths received.
#[derive(Clone, Debug)]
pub(super) struct Patient {
    config: PatientConfig,
    venting: bool,
    breath: u32,
    /// Absent for efforts that are all the same, or none.
    drive: Option<Drive>,
    coughs: Coughs,
    /// The last strain, and when it began, s.
    strain: Option<(Strain, f64)>,
}

impl Patient {
    /// A patient who has not been ventilated yet, on a venting circuit; irregular efforts and coughs are drawn from
    /// `seed`.
    #[inline(never)]
    pub(super) fn new(config: PatientConfig, seed: u64) -> Self {
        Self {
            drive: Drive::new(&config, stream(seed, DRIVE_STREAM)),
            coughs: Coughs::new(&config, stream(seed, COUGH_STREAM)),
            strain: None,
            config,
            venting: true,
            breath: 0,
        }
    }

    /// Adds a cough at this time, s.
    pub(super) fn cough(&mut self, peak: f64, at_s: f64) {
        self.coughs.add(peak, at_s);
    }

    /// Strains, or draws in gas, from this time on, s; it replaces a strain that has not ended.
    pub(super) fn strain(&mut self, strain: Strain, at_s: f64) {
        self.strain = Some((strain, at_s));
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

    /// Begins the effort and the cough that are due at this time, s. Time must not run backwards.
    #[inline]
    pub(super) fn advance(&mut self, time_s: f64) {
        if let Some(drive) = &mut self.drive {
            drive.advance(time_s);
        }
        self.coughs.advance(time_s);
    }

    /// Time since the start of a regular effort, s.
    fn since_regular_start_s(&self, time_s: f64) -> f64 {
        time_s % (60.0 / self.config.effort_rate_per_min)
    }

    /// Pressure of the respiratory muscles in cmH2O: positive draws gas in; a cough is negative.
    pub(super) fn muscle_pressure(&self, time_s: f64) -> f64 {
        let config = &self.config;
        let mut pressure = 0.0;
        if let Some(drive) = &self.drive {
            if let Some(effort) = drive.effort() {
                pressure += self.effort(effort.peak, time_s - effort.started_s, time_s);
            }
        } else if config.effort_cmh2o > 0.0 {
            pressure += self.effort(config.effort_cmh2o, self.since_regular_start_s(time_s), time_s);
        }
        if let Some((strain, at_s)) = self.strain {
            pressure -= strain.cmh2o * pulse(time_s - at_s, strain.duration_s);
        }
        pressure - self.coughs.pressure(time_s)
    }

    /// Pressure of an effort of this peak some time after its beginning, s. Its strength is that of the time when it began.
    fn effort(&self, peak: f64, since_s: f64, time_s: f64) -> f64 {
        let config = &self.config;
        let turns = (time_s - since_s) / config.effort_wanes_every_s;
        let waned = 0.5 - 0.5 * cos(TAU * turns);
        let strength = 1.0 - 0.01 * config.effort_wanes_percent * waned;
        strength * peak * pulse(since_s, config.effort_duration_s)
    }

    /// When the last effort began, s, and the number of efforts so far.
    pub(super) fn efforts(&self, time_s: f64) -> (Option<f64>, u32) {
        if let Some(drive) = &self.drive {
            return (drive.effort().map(|effort| effort.started_s), drive.efforts());
        }
        if self.config.effort_cmh2o <= 0.0 {
            return (None, 0);
        }
        let started_s = time_s - self.since_regular_start_s(time_s);
        let before = round(started_s * self.config.effort_rate_per_min / 60.0);
        (Some(started_s), before as u32 + 1)
    }

    /// Factor of the secretions on every resistance; `None` for a patient without them.
    #[inline]
    pub(super) fn secretions(&self, time_s: f64) -> Option<f64> {
        let growth = self.config.resistance_growth_percent_per_hour;
        (growth > 0.0).then(|| 1.0 + growth / 100.0 * time_s / 3600.0)
    }

    /// Breaths started so far.
    pub(super) fn breath(&self) -> u32 {
        self.breath
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn patient(config: PatientConfig) -> Patient {
        Patient::new(config, 1)
    }

    #[test]
    fn is_passive_by_default() {
        let patient = patient(PatientConfig::default());
        for ms in 0..10_000 {
            assert!(patient.muscle_pressure(f64::from(ms) * 1e-3).abs() < f64::EPSILON);
        }
    }

    #[test]
    fn effort_returns_at_its_rate() {
        let config =
            PatientConfig { effort_cmh2o: 8.0, effort_rate_per_min: 15.0, ..PatientConfig::default() };
        let patient = patient(config);
        let middle_s = 0.5 * config.effort_duration_s;
        for breath in 0..3 {
            let start_s = 4.0 * f64::from(breath);
            assert!((patient.muscle_pressure(start_s + middle_s) - 8.0).abs() < 1e-9);
            assert!(patient.muscle_pressure(start_s + config.effort_duration_s + 0.1).abs() < 1e-12);
        }
    }

    #[test]
    fn efforts_wane_and_come_back() {
        let regular =
            PatientConfig { effort_cmh2o: 8.0, effort_wanes_percent: 75.0, ..PatientConfig::default() };
        let irregular = PatientConfig { effort_variability_percent: 1e-9, ..regular };
        for config in [regular, irregular] {
            let mut patient = patient(config);
            let middle_ms = (500.0 * config.effort_duration_s) as u32;
            let mut pressure = |ms: u32| {
                patient.advance(f64::from(ms) * 1e-3);
                patient.muscle_pressure(f64::from(ms) * 1e-3)
            };
            let pressures: Vec<_> = (0..62_000).map(&mut pressure).collect();
            // 60 s from one strongest effort to the next; an effort begins every 4 s.
            let peaks = [0, 16_000, 28_000, 60_000].map(|from_ms| pressures[(from_ms + middle_ms) as usize]);
            assert!((peaks[0] - 8.0).abs() < 1e-6 && (peaks[3] - 8.0).abs() < 1e-6, "{peaks:?}");
            assert!(peaks[1] < 6.0 && peaks[2] < 2.2, "{peaks:?}");
        }
    }

    #[test]
    fn a_cough_is_one_expulsive_pulse() {
        let config = PatientConfig { cough_cmh2o: 40.0, cough_at_s: 2.0, ..PatientConfig::default() };
        let patient = patient(config);
        assert!(patient.muscle_pressure(1.999).abs() < 1e-12);
        assert!((patient.muscle_pressure(2.0 + 0.5 * config.cough_duration_s) + 40.0).abs() < 1e-9);
        assert!(patient.muscle_pressure(2.0 + config.cough_duration_s + 1e-3).abs() < 1e-12);
    }

    #[test]
    fn a_breath_starts_when_the_expiratory_valve_is_told_to_close() {
        let mut patient = patient(PatientConfig::default());
        for u_out in [true, false, false, true, true, false, true] {
            patient.observe(u_out);
        }
        assert_eq!(patient.breath(), 2);
    }

    #[test]
    fn the_lung_changes_once_at_the_stated_breath() {
        let config =
            PatientConfig { change_at_breath: 2, resistance_factor: 3.0, ..PatientConfig::default() };
        let mut patient = patient(config);
        let changes: Vec<_> = [false, true, false, true, false].map(|u_out| patient.observe(u_out)).into();
        assert_eq!(changes, [None, None, Some((3.0, 1.0)), None, None]);
    }

    #[test]
    fn a_regular_patient_tells_when_the_last_effort_began_and_how_many_there_were() {
        let patient = patient(PatientConfig { effort_cmh2o: 8.0, ..PatientConfig::default() });
        for (time_s, expected) in
            [(0.0, (0.0, 1)), (0.4, (0.0, 1)), (3.9, (0.0, 1)), (4.1, (4.0, 2)), (41.0, (40.0, 11))]
        {
            let (started_s, number) = patient.efforts(time_s);
            assert!((started_s.unwrap() - expected.0).abs() < 1e-9 && number == expected.1, "{time_s}");
        }
    }

    #[test]
    fn a_passive_patient_has_made_no_effort() {
        assert_eq!(patient(PatientConfig::default()).efforts(9.0), (None, 0));
    }

    #[test]
    fn efforts_with_next_to_no_variability_are_the_regular_ones() {
        let regular = PatientConfig { effort_cmh2o: 8.0, ..PatientConfig::default() };
        let varied = PatientConfig { effort_variability_percent: 1e-9, ..regular };
        let (regular, mut varied) = (patient(regular), patient(varied));
        for ms in 0..60_000 {
            let time_s = f64::from(ms) * 1e-3;
            varied.advance(time_s);
            let difference = regular.muscle_pressure(time_s) - varied.muscle_pressure(time_s);
            assert!(difference.abs() < 1e-6, "{time_s} s: {difference} cmH2O");
        }
    }

    #[test]
    fn efforts_and_coughs_draw_from_streams_of_their_own() {
        let quiet =
            PatientConfig { effort_cmh2o: 8.0, effort_variability_percent: 20.0, ..PatientConfig::default() };
        let coughing = PatientConfig { cough_cmh2o: 20.0, coughs_per_hour: 300.0, ..quiet };
        let (mut quiet, mut coughing) = (patient(quiet), patient(coughing));
        for ms in 0..300_000 {
            let time_s = f64::from(ms) * 1e-3;
            quiet.advance(time_s);
            coughing.advance(time_s);
            assert_eq!(quiet.efforts(time_s), coughing.efforts(time_s));
        }
    }

    #[test]
    fn secretions_raise_the_resistance_steadily() {
        let config = PatientConfig { resistance_growth_percent_per_hour: 50.0, ..PatientConfig::default() };
        let factor = patient(config).secretions(7200.0).unwrap();
        assert!((factor - 2.0).abs() < 1e-12, "{factor}");
        assert_eq!(patient(PatientConfig::default()).secretions(7200.0), None);
    }
}
