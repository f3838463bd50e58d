//! Measures what the lung gets: breaths, their volume, and the longest gap between them.

use plant::bench::BenchConfig;
use plant::prescriptions::field;
use shared::settings::Settings;

/// Share of the threshold within which the lung is at its lowest volume.
const AT_REST: f64 = 0.05;

/// Breaths by the true volume of the lung, mL: one counts once it has risen by the threshold from its lowest volume.
#[derive(Clone, Debug)]
pub struct VolumeMeter {
    /// Smallest volume of a delivered breath, mL.
    threshold: f64,
    /// Lowest and highest volume of the running breath, mL.
    low: f64,
    high: f64,
    /// Whether the running breath counts.
    delivered: bool,
    /// Time of `low` and `high`, ms.
    low_ms: u32,
    high_ms: u32,
    /// End of the last delivered inspiration, ms.
    last_ms: u32,
    ventilation: Ventilation,
}

/// What a lung got over some time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ventilation {
    /// Delivered breaths.
    pub breaths: u32,
    /// Sum of their volumes, mL.
    pub volume: f64,
    /// Longest time from the end of a delivered inspiration to the beginning of the next one, ms.
    pub longest_gap_ms: u32,
}

impl VolumeMeter {
    /// A meter that starts at a lung volume, mL, at a time, ms.
    pub fn new(threshold: f64, volume: f64, ms: u32) -> Self {
        Self {
            threshold,
            low: volume,
            high: volume,
            delivered: false,
            low_ms: ms,
            high_ms: ms,
            last_ms: ms,
            ventilation: Ventilation::default(),
        }
    }

    /// Adds the volume of a tick.
    pub fn add(&mut self, volume: f64, ms: u32) {
        if volume > self.high {
            (self.high, self.high_ms) = (volume, ms);
        }
        // Until it rises clearly, the breath has not begun.
        if !self.delivered && volume <= self.low + AT_REST * self.threshold {
            (self.low, self.low_ms, self.high, self.high_ms) = (self.low.min(volume), ms, volume, ms);
        }
        if !self.delivered && volume >= self.low + self.threshold {
            self.delivered = true;
            self.gap(self.low_ms);
            self.ventilation.breaths += 1;
        }
        if self.delivered && volume <= self.high - self.threshold {
            self.ventilation.volume += self.high - self.low;
            self.last_ms = self.high_ms;
            (self.delivered, self.low, self.low_ms) = (false, volume, ms);
            (self.high, self.high_ms) = (volume, ms);
        }
    }

    fn gap(&mut self, until_ms: u32) {
        let gap = until_ms.saturating_sub(self.last_ms);
        self.ventilation.longest_gap_ms = self.ventilation.longest_gap_ms.max(gap);
    }

    /// What the lung got until this time, ms.
    pub fn finish(mut self, ms: u32) -> Ventilation {
        if self.delivered {
            self.ventilation.volume += self.high - self.low;
        } else {
            self.gap(ms);
        }
        self.ventilation
    }
}

/// Volume of a breath of a passive lung at these settings once breath follows breath evenly, mL.
pub fn passive_volume_ml(bench: &BenchConfig, settings: &Settings) -> f64 {
    let lung = &bench.lung.first;
    let time_constant_s = lung.resistance_cmh2o_per_l_s * lung.compliance_ml_per_cmh2o * 1e-3;
    let inspiration_s = f64::from(settings.inspiratory_time);
    let expiration_s = 60.0 / f64::from(settings.rate) - inspiration_s;
    let unfilled = (-inspiration_s / time_constant_s).exp();
    let unemptied = (-expiration_s / time_constant_s).exp();
    let rise = f64::from(settings.pip - settings.peep);
    let share = (1.0 - unfilled) * (1.0 - unemptied) / (1.0 - unfilled * unemptied);
    lung.compliance_ml_per_cmh2o * rise * share
}

/// Alarm limits of the volumes, as factors on what the passive lung gets; 0 for none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VolumeLimits {
    /// Lower and upper limit of the tidal volume.
    pub tidal: (f64, f64),
    /// Lower and upper limit of the minute volume.
    pub minute: (f64, f64),
}

impl VolumeLimits {
    /// The same settings with these limits for a lung.
    pub fn of(self, bench: &BenchConfig, settings: Settings) -> Settings {
        let tidal = passive_volume_ml(bench, &settings);
        let minute = 1e-3 * tidal * f64::from(settings.rate);
        let [tidal_volume_low, tidal_volume_high, minute_volume_low, minute_volume_high] =
            [tidal * self.tidal.0, tidal * self.tidal.1, minute * self.minute.0, minute * self.minute.1]
                .map(|limit| limit as f32);
        let tidal_volume_high = tidal_volume_high.min(field("tidal_volume_high").max);
        let minute_volume_high = minute_volume_high.min(field("minute_volume_high").max);
        Settings { tidal_volume_low, tidal_volume_high, minute_volume_low, minute_volume_high, ..settings }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Breaths of these volumes, mL, 3 s each, of which 1 s is the inspiration.
    fn measured(volumes: &[f64]) -> Ventilation {
        let mut meter = VolumeMeter::new(100.0, 50.0, 0);
        let mut ms = 0;
        for volume in volumes {
            for tick in 0..3000 {
                let share = if tick < 1000 {
                    f64::from(tick) / 1000.0
                } else {
                    (2.0 - f64::from(tick) / 1000.0).max(0.0)
                };
                meter.add(50.0 + volume * share, ms);
                ms += 1;
            }
        }
        meter.finish(ms)
    }

    #[test]
    fn the_limits_are_shares_of_what_the_lung_takes() {
        let settings = Settings { pip: 25.0, peep: 5.0, ..Settings::default() };
        // A time constant of 50 ms: the lung fills and empties.
        let fast = BenchConfig::paper(5.0, 10.0);
        assert!((passive_volume_ml(&fast, &settings) - 200.0).abs() < 0.1);
        let limits = VolumeLimits { tidal: (0.5, 2.0), minute: (0.0, 1.5) };
        let limits = limits.of(&fast, settings);
        let near = |value: f32, wanted: f32| (value - wanted).abs() < 0.01;
        assert!(near(limits.tidal_volume_low, 100.0) && near(limits.tidal_volume_high, 400.0));
        assert!(near(limits.minute_volume_low, 0.0) && near(limits.minute_volume_high, 6.0));
        // With 2.5 s it does neither: in 1 s it takes a third of the rest, and in 2 s gives out 55 %.
        let slow = passive_volume_ml(&BenchConfig::paper(50.0, 50.0), &settings);
        assert!((slow - 1000.0 * 0.26).abs() < 1.0, "{slow}");
    }

    #[test]
    fn breaths_and_their_volumes_are_counted() {
        let Ventilation { breaths, volume, longest_gap_ms } = measured(&[400.0; 5]);
        assert_eq!(breaths, 5);
        assert!((volume - 2000.0).abs() < 5.0, "{volume}");
        assert!((1900..=2100).contains(&longest_gap_ms), "{longest_gap_ms}");
    }

    #[test]
    fn a_missing_breath_lengthens_the_gap() {
        let Ventilation { breaths, longest_gap_ms, .. } = measured(&[400.0, 400.0, 60.0, 400.0]);
        assert_eq!(breaths, 3);
        assert!((4900..=5100).contains(&longest_gap_ms), "{longest_gap_ms}");
    }

    #[test]
    fn nothing_delivered_is_one_long_gap() {
        assert_eq!(measured(&[0.0; 4]), Ventilation { breaths: 0, volume: 0.0, longest_gap_ms: 12_000 });
    }
}
