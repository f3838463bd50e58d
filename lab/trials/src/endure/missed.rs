//! Alarms that were due and did not come: conditions well beyond an alarm's bound that last and raise nothing.

use shared::safety::alarms::Fault;
use shared::safety::indications::FaultSet;
use shared::safety::volume_monitor::DOUBT;

use super::truth::{BreathTruth, per_minute};

/// Breaths in a row with a condition after which an alarm must be present.
pub const LASTS: u32 = 6;
/// Leak, L/s at 30 cmH2O.
const LEAK: f64 = 0.4;
/// Pressure above PEEP at the end of an expiration, cmH2O.
const BASELINE: f64 = 4.0;
/// Pressure above the limit, cmH2O.
const ABOVE_LIMIT: f64 = 2.0;
/// Distance of a volume from its limit, as a share of that.
const BEYOND: f64 = 0.2;
/// Time without a breath, s.
const APNOEA_S: f64 = 30.0;

/// A condition that must raise an alarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Condition {
    /// A leak of more than 0.4 L/s at 30 cmH2O.
    Leak,
    /// More than 4 cmH2O above PEEP at the end of the expiration.
    BaselineHigh,
    /// More than 2 cmH2O above the pressure limit.
    AboveLimit,
    /// A tidal volume a fifth below its limit, whatever a leak leaves in doubt.
    TidalVolumeLow,
    /// A tidal volume a fifth above its limit.
    TidalVolumeHigh,
    /// A minute volume a fifth below its limit.
    MinuteVolumeLow,
    /// A minute volume a fifth above its limit.
    MinuteVolumeHigh,
    /// No breath for half a minute.
    Apnoea,
}

impl Condition {
    /// All conditions.
    pub const ALL: [Self; 8] = [
        Self::Leak,
        Self::BaselineHigh,
        Self::AboveLimit,
        Self::TidalVolumeLow,
        Self::TidalVolumeHigh,
        Self::MinuteVolumeLow,
        Self::MinuteVolumeHigh,
        Self::Apnoea,
    ];

    /// Name in tables and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Leak => "leak",
            Self::BaselineHigh => "baseline-high",
            Self::AboveLimit => "above-limit",
            Self::TidalVolumeLow => "tidal-volume-low",
            Self::TidalVolumeHigh => "tidal-volume-high",
            Self::MinuteVolumeLow => "minute-volume-low",
            Self::MinuteVolumeHigh => "minute-volume-high",
            Self::Apnoea => "apnoea",
        }
    }

    /// Whether it holds in a breath.
    fn holds(self, breath: &BreathTruth) -> bool {
        let baseline = breath.baseline.unwrap_or_else(|| breath.peep());
        let (settings, minute, tidal) = (&breath.settings, breath.minute_volume, breath.expired);
        // A large leak may take fifty times the gas of a small breath.
        let doubt = f64::from(DOUBT) * breath.leaked();
        let per_minute = if doubt > 0.0 { per_minute(doubt, breath.seconds()) } else { 0.0 };
        let (lowest, highest) = breath.minute_limits;
        match self {
            Self::Leak => breath.leak > LEAK,
            Self::BaselineHigh => baseline > breath.peep() + BASELINE,
            Self::AboveLimit => breath.peak > breath.limit() + ABOVE_LIMIT,
            Self::TidalVolumeLow => low(breath.given() + doubt, settings.tidal_volume_low),
            Self::TidalVolumeHigh => high(tidal - doubt, settings.tidal_volume_high),
            Self::MinuteVolumeLow => minute.is_some_and(|volume| low(volume + per_minute, lowest)),
            Self::MinuteVolumeHigh => minute.is_some_and(|volume| high(volume - per_minute, highest)),
            Self::Apnoea => breath.without_s >= APNOEA_S,
        }
    }

    /// The alarms of which one must be present.
    fn alarms(self) -> &'static [Fault] {
        match self {
            Self::Leak => &[Fault::Leak, Fault::Disconnection, Fault::LowPressure, Fault::BaselineLow],
            Self::BaselineHigh => &[Fault::BaselineHigh, Fault::SustainedPressure, Fault::HardLimit],
            Self::AboveLimit => {
                &[Fault::HighPressure, Fault::CommandCapped, Fault::LearnedDistrusted, Fault::HardLimit]
            }
            Self::TidalVolumeLow => &[Fault::TidalVolumeLow, Fault::FlowSensorLost],
            Self::TidalVolumeHigh => &[Fault::TidalVolumeHigh, Fault::FlowSensorLost],
            // Breaths that are each too small, or too large, tell the same.
            Self::MinuteVolumeLow => &[Fault::MinuteVolumeLow, Fault::TidalVolumeLow, Fault::FlowSensorLost],
            Self::MinuteVolumeHigh => {
                &[Fault::MinuteVolumeHigh, Fault::TidalVolumeHigh, Fault::FlowSensorLost]
            }
            Self::Apnoea => &[Fault::Apnoea, Fault::FlowSensorLost],
        }
    }
}

/// Whether a volume is far below its limit.
fn low(volume: f64, limit: f32) -> bool {
    volume < (1.0 - BEYOND) * f64::from(limit)
}

/// Whether a volume is far above its limit, if it has one.
fn high(volume: f64, limit: f32) -> bool {
    limit > 0.0 && volume > (1.0 + BEYOND) * f64::from(limit)
}

/// Watches for the conditions.
#[derive(Clone, Copy, Debug, Default)]
pub struct MissedWatch {
    streaks: [Streak; Condition::ALL.len()],
}

/// Breaths in a row with a condition.
#[derive(Clone, Copy, Debug, Default)]
struct Streak {
    breaths: u32,
    /// Whether an alarm has been present in one of them.
    raised: bool,
}

impl MissedWatch {
    /// Adds a complete breath and the alarms present at its end; returns the conditions that have now lasted without one.
    pub fn add(&mut self, breath: &BreathTruth, present: FaultSet) -> impl Iterator<Item = Condition> {
        let missed = Condition::ALL.into_iter().zip(&mut self.streaks).map(|(condition, streak)| {
            if breath.settled && condition.holds(breath) {
                streak.breaths += 1;
                streak.raised |= condition.alarms().iter().any(|fault| present.has(*fault));
            } else {
                *streak = Streak::default();
            }
            (condition, *streak)
        });
        let missed: Vec<_> = missed.filter(|(_, streak)| streak.breaths == LASTS && !streak.raised).collect();
        missed.into_iter().map(|(condition, _)| condition)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::settings::Settings;

    fn sound() -> BreathTruth {
        limited(&Settings::default())
    }

    /// A sound breath with these settings.
    fn limited(settings: &Settings) -> BreathTruth {
        let mut breath = BreathTruth::new(settings, true);
        (breath.peak, breath.baseline, breath.leak) = (25.0, Some(5.0), 0.1);
        breath
    }

    /// The condition that a breath repeated this many times is found to have missed, and how often.
    fn missed(breath: &BreathTruth, present: &[Fault], times: u32) -> Vec<Condition> {
        let bits = present.iter().map(|fault| 1 << *fault as u32).sum();
        let mut watch = MissedWatch::default();
        (0..times).flat_map(|_| watch.add(breath, FaultSet::from_bits(bits)).collect::<Vec<_>>()).collect()
    }

    #[test]
    fn a_lasting_condition_without_its_alarm_is_missed_once() {
        let leaks = BreathTruth { leak: 0.45, ..sound() };
        let high = BreathTruth { baseline: Some(9.5), ..sound() };
        let above = BreathTruth { peak: 63.0, ..sound() };
        let settings = Settings {
            tidal_volume_low: 300.0,
            tidal_volume_high: 500.0,
            minute_volume_low: 6.0,
            minute_volume_high: 10.0,
            ..Settings::default()
        };
        let volumes =
            |tidal, minute| BreathTruth { expired: tidal, minute_volume: Some(minute), ..limited(&settings) };
        assert_eq!(missed(&volumes(400.0, 8.0), &[], 5 * LASTS), []);
        let apnoea = BreathTruth { without_s: 31.0, ..sound() };
        for (breath, condition, alarm) in [
            (leaks, Condition::Leak, Fault::Leak),
            (high, Condition::BaselineHigh, Fault::BaselineHigh),
            (above, Condition::AboveLimit, Fault::CommandCapped),
            (volumes(230.0, 8.0), Condition::TidalVolumeLow, Fault::TidalVolumeLow),
            (volumes(610.0, 8.0), Condition::TidalVolumeHigh, Fault::TidalVolumeHigh),
            (volumes(400.0, 4.7), Condition::MinuteVolumeLow, Fault::MinuteVolumeLow),
            (volumes(400.0, 12.1), Condition::MinuteVolumeHigh, Fault::MinuteVolumeHigh),
            (apnoea, Condition::Apnoea, Fault::Apnoea),
        ] {
            assert_eq!(missed(&breath, &[], 5 * LASTS), [condition]);
            assert_eq!(missed(&breath, &[Fault::HostSilent], LASTS), [condition], "another alarm");
            assert_eq!(missed(&breath, &[alarm], 5 * LASTS), []);
            assert_eq!(missed(&breath, &[], LASTS - 1), []);
            let unsettled = BreathTruth { settled: false, ..breath };
            assert_eq!(missed(&unsettled, &[], 5 * LASTS), []);
        }
        let (small, large) = (volumes(400.0, 4.7), volumes(400.0, 12.1));
        assert_eq!(missed(&small, &[Fault::TidalVolumeLow], LASTS), [], "which tells the same");
        assert_eq!(missed(&large, &[Fault::TidalVolumeHigh], LASTS), []);
    }

    #[test]
    fn a_lung_that_refills_after_a_strain_is_given_gas() {
        let settings = Settings { tidal_volume_low: 100.0, ..Settings::default() };
        let breath = |inspired| BreathTruth { inspired, expired: 12.0, ..limited(&settings) };
        assert_eq!(missed(&breath(150.0), &[], LASTS), []);
        assert_eq!(missed(&breath(140.0), &[], LASTS), [Condition::TidalVolumeLow]);
    }

    #[test]
    fn a_sound_breath_misses_nothing_and_ends_a_streak() {
        assert_eq!(missed(&sound(), &[], 5 * LASTS), []);
        let mut watch = MissedWatch::default();
        let leaks = BreathTruth { leak: 0.45, ..sound() };
        for number in 0..5 * LASTS {
            let breath = if number % LASTS == 0 { sound() } else { leaks.clone() };
            assert_eq!(watch.add(&breath, FaultSet::default()).count(), 0);
        }
    }
}
