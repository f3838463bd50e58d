//! Respiratory drive of a patient whose efforts differ in strength and interval, and who may make two at once.

use rand_chacha::ChaCha8Rng;

use super::config::{MOST_EFFORT_CMH2O, PatientConfig};
use crate::random::{normal, share};

/// One inspiratory effort.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Effort {
    /// Beginning, s.
    pub(super) started_s: f64,
    /// Peak muscle pressure, cmH2O.
    pub(super) peak: f64,
}

/// A second effort that follows at once.
#[derive(Clone, Copy, Debug)]
struct Second {
    peak: f64,
    /// Beginning of the effort after it, s.
    then_s: f64,
}

/// The drive and its state, the last effort and the beginning of the next.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    rng: ChaCha8Rng,
    peak: f64,
    interval_s: f64,
    duration_s: f64,
    /// Spread of peak and interval, as a share of their means (sd).
    spread: f64,
    /// Share of the efforts that a second one follows.
    doubled: f64,
    effort: Option<Effort>,
    efforts: u32,
    next_s: f64,
    second: Option<Second>,
}

impl Drive {
    /// A drive whose first effort begins with the simulation; it draws from `rng`. `None` for a patient who makes no
    /// efforts or the same one again and again, which needs no state.
    #[inline(never)]
    pub(super) fn new(config: &PatientConfig, rng: ChaCha8Rng) -> Option<Self> {
        let varies = config.effort_variability_percent > 0.0 || config.double_efforts_percent > 0.0;
        if config.effort_cmh2o <= 0.0 || !varies {
            return None;
        }
        let mut drive = Self {
            rng,
            peak: config.effort_cmh2o,
            interval_s: 60.0 / config.effort_rate_per_min,
            duration_s: config.effort_duration_s,
            spread: config.effort_variability_percent / 100.0,
            doubled: config.double_efforts_percent / 100.0,
            effort: None,
            efforts: 0,
            next_s: 0.0,
            second: None,
        };
        drive.advance(0.0);
        Some(drive)
    }

    /// Begins the next effort if it is due at this time, s.
    pub(super) fn advance(&mut self, time_s: f64) {
        if time_s < self.next_s {
            return;
        }
        let started_s = self.next_s;
        let peak = match self.second.take() {
            Some(second) => {
                self.next_s = second.then_s;
                second.peak
            }
            None => self.draw(started_s),
        };
        self.effort = Some(Effort { started_s, peak });
        self.efforts = self.efforts.saturating_add(1);
    }

    /// Draws the effort that begins now and all that follows from it; returns its peak.
    fn draw(&mut self, started_s: f64) -> f64 {
        // All four are always drawn, so that changing one setting does not affect the others' draws.
        let [peak, interval, second_peak] = [(); 3].map(|()| self.factor());
        let uniform = share(&mut self.rng);
        let end_s = started_s + self.duration_s;
        let next_s = started_s + self.interval_s * interval;
        if uniform < self.doubled {
            let then_s = next_s.max(end_s + self.duration_s);
            self.second = Some(Second { peak: self.limited(second_peak), then_s });
            self.next_s = end_s;
        } else {
            self.next_s = next_s.max(end_s);
        }
        self.limited(peak)
    }

    fn factor(&mut self) -> f64 {
        1.0 + self.spread * normal(&mut self.rng)
    }

    fn limited(&self, factor: f64) -> f64 {
        (self.peak * factor).clamp(0.0, MOST_EFFORT_CMH2O)
    }

    /// The last effort that began.
    pub(super) fn effort(&self) -> Option<Effort> {
        self.effort
    }

    /// Efforts begun so far.
    pub(super) fn efforts(&self) -> u32 {
        self.efforts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    /// The first `count` efforts.
    fn efforts(config: &PatientConfig, seed: u64, count: u32) -> Vec<Effort> {
        let mut drive = Drive::new(config, ChaCha8Rng::seed_from_u64(seed)).unwrap();
        let mut efforts = vec![drive.effort().unwrap()];
        for ms in 1.. {
            drive.advance(f64::from(ms) * 1e-3);
            if drive.efforts() as usize > efforts.len() {
                efforts.push(drive.effort().unwrap());
            }
            if drive.efforts() == count {
                break;
            }
        }
        efforts
    }

    fn config(effort_variability_percent: f64, double_efforts_percent: f64) -> PatientConfig {
        PatientConfig {
            effort_cmh2o: 8.0,
            effort_rate_per_min: 15.0,
            effort_variability_percent,
            double_efforts_percent,
            ..PatientConfig::default()
        }
    }

    fn intervals(efforts: &[Effort]) -> Vec<f64> {
        efforts.windows(2).map(|pair| pair[1].started_s - pair[0].started_s).collect()
    }

    fn mean_and_sd(values: &[f64]) -> (f64, f64) {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        (mean, (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt())
    }

    #[test]
    fn a_regular_or_passive_patient_needs_no_drive() {
        let rng = || ChaCha8Rng::seed_from_u64(1);
        assert!(Drive::new(&config(0.0, 0.0), rng()).is_none());
        assert!(Drive::new(&PatientConfig { effort_cmh2o: 0.0, ..config(20.0, 20.0) }, rng()).is_none());
    }

    #[test]
    fn peak_and_interval_spread_by_the_stated_share() {
        let efforts = efforts(&config(20.0, 0.0), 1, 4000);
        let peaks: Vec<f64> = efforts.iter().map(|effort| effort.peak).collect();
        // Five standard errors: 1.6 % of a mean, 6 % of an sd.
        for (what, values, expected) in [("peak", peaks, 8.0), ("interval", intervals(&efforts), 4.0)] {
            let (mean, sd) = mean_and_sd(&values);
            assert!((mean / expected - 1.0).abs() < 0.016, "{what}: mean {mean}");
            assert!((sd / (0.2 * expected) - 1.0).abs() < 0.06, "{what}: sd {sd}");
        }
    }

    #[test]
    fn the_stated_share_of_efforts_is_followed_at_once_by_another() {
        let config = config(0.0, 25.0);
        let efforts = efforts(&config, 1, 4000);
        let intervals = intervals(&efforts);
        let at_once = |interval: &&f64| (**interval - config.effort_duration_s).abs() < 1e-9;
        let doubles = intervals.iter().filter(at_once).count() as f64;
        // Of five efforts, four are first ones, and one of those is doubled.
        assert!((doubles / intervals.len() as f64 - 0.2).abs() < 0.03, "{doubles}");
        // A second effort does not delay the next first one.
        let (mean, _) = mean_and_sd(&intervals);
        assert!((mean - 4.0 / 1.25).abs() < 0.1, "{mean}");
        assert!(efforts.iter().all(|effort| (effort.peak - 8.0).abs() < 1e-12));
    }

    #[test]
    fn every_effort_is_doubled_at_100_percent() {
        let efforts = efforts(&config(0.0, 100.0), 1, 9);
        let starts: Vec<f64> = efforts.iter().map(|effort| effort.started_s).collect();
        for (found, expected) in starts.iter().zip([0.0, 0.8, 4.0, 4.8, 8.0, 8.8, 12.0, 12.8, 16.0]) {
            assert!((found - expected).abs() < 1e-9, "{starts:?}");
        }
    }

    #[test]
    fn no_effort_begins_before_the_last_one_ended_and_none_exceeds_the_limit() {
        let wild = PatientConfig {
            effort_cmh2o: 30.0,
            effort_rate_per_min: 40.0,
            effort_duration_s: 1.2,
            ..config(100.0, 50.0)
        };
        let efforts = efforts(&wild, 1, 1000);
        assert!(intervals(&efforts).iter().all(|interval| *interval >= 1.2 - 1e-9));
        assert!(efforts.iter().all(|effort| (0.0..=MOST_EFFORT_CMH2O).contains(&effort.peak)));
        assert!(efforts.iter().any(|effort| effort.peak >= MOST_EFFORT_CMH2O));
    }

    #[test]
    fn the_same_seed_gives_the_same_efforts() {
        let with = |seed| efforts(&config(20.0, 10.0), seed, 50);
        assert_eq!(with(7), with(7));
        assert_ne!(with(7), with(8));
    }
}
