//! The score of one breath, from samples of its inspiration.

use serde::{Deserialize, Serialize};
use shared::breath::{Breath, Phase, period_s};
use shared::settings::Settings;

use super::ValveEffort;
use monitoring::curve::{Tracking, mean_over_time};
use ventilator::Tick;

/// Start of the late part of the inspiration, s; by then a good controller has finished the rise.
const LATE_FROM_S: f64 = 0.15;
/// Length of the plateau at the end of the inspiration, s: what the rise of a short inspiration leaves of it.
pub const PLATEAU_S: f64 = 0.3;
/// Time from the end of the target's rise to the earliest start of the plateau, s: before that, the pressure still rises.
const SETTLING_S: f64 = 0.1;
/// Distance from PIP that the plateau may have: cmH2O, plus this share of PIP (ISO 80601-2-12, as makers of ventilators declare it).
const PLATEAU_TOLERANCE: (f64, f64) = (2.0, 0.04);

/// How well an inspiration followed its target; for several breaths, the mean of every value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Mean absolute error over the inspiration, cmH2O (Suo et al. 2021, section 5).
    pub score: f64,
    /// Time from 10 % to 90 % of the way from PEEP to PIP, ms; if 90 % is never reached, the whole inspiration.
    pub rise_ms: f64,
    /// Highest pressure above PIP, cmH2O, at least 0.
    pub overshoot: f64,
    /// Mean distance from PIP over the last 0.3 s, cmH2O; over less where the target reaches PIP less than 0.4 s before the end.
    pub plateau_error: f64,
    /// Mean absolute error after the first 150 ms, cmH2O.
    pub late_error: f64,
    /// Movement of the inspiratory valve over the plateau.
    #[serde(default)]
    pub effort: ValveEffort,
    /// Whether the pressure limit ended the inspiration: 1 or 0. Only a ventilation that goes on after that has such inspirations.
    #[serde(default, skip_serializing_if = "is_none")]
    pub cut: f64,
}

/// Whether no inspiration was cut.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it so")]
fn is_none(cut: &f64) -> bool {
    *cut <= 0.0
}

/// Pressure, target and command of an inspiration, sampled at the start of every control tick.
#[derive(Clone, Debug, Default)]
pub struct InspirationRecord {
    /// Tick by tick, in one row each, so that thousands of running records take little of the processor's cache.
    ticks: Vec<RecordedTick>,
    cut: bool,
}

/// Pressure and target, cmH2O, and command, percent.
#[derive(Clone, Copy, Debug)]
struct RecordedTick {
    pressure: f32,
    target: f32,
    command: f32,
}

impl InspirationRecord {
    /// Adds a tick of the inspiration: the true pressure, or the measured one if the true one is unknown.
    pub fn add(&mut self, tick: &Tick) {
        if tick.sample.phase == Phase::Inspiration {
            self.push(tick, tick.sample.target);
        }
    }

    /// Forgets all ticks.
    pub fn clear(&mut self) {
        self.ticks.clear();
        self.cut = false;
    }

    /// Pressure and target, cmH2O, and command, percent, of every tick so far.
    pub fn curves(&self) -> [Vec<f64>; 3] {
        let curve =
            |of: fn(&RecordedTick) -> f32| self.ticks.iter().map(|tick| f64::from(of(tick))).collect();
        [curve(|tick| tick.pressure), curve(|tick| tick.target), curve(|tick| tick.command)]
    }

    /// Like [`Self::add`]; the rest of an inspiration that was ended at the pressure limit counts too, with the planned target. Without
    /// it, such an inspiration would score by its beginning alone.
    pub fn add_planned(&mut self, tick: &Tick, planned: &Breath) {
        self.add(tick);
        let sample = &tick.sample;
        if sample.phase != Phase::Inspiration && planned.phase(sample.tick) == Phase::Inspiration {
            self.cut = true;
            self.push(tick, planned.target(sample.tick));
        }
    }

    fn push(&mut self, Tick { sample, truth }: &Tick, target: f32) {
        let pressure = truth.map_or(sample.pressure, |truth| truth.airway_pressure);
        self.ticks.push(RecordedTick { pressure, target, command: sample.u_in });
    }

    /// Scores the breath with these settings.
    pub fn score(&self, breath: &Settings, period_us: u32) -> Score {
        let period_s = f64::from(period_s(period_us));
        let [pressure, target, command] = self.curves();
        Score {
            effort: valve_effort(breath, &command, period_s),
            cut: f64::from(u8::from(self.cut)),
            ..score_breath(breath, period_s, &pressure, &target)
        }
    }

    /// Oscillation of the pressure over the plateau, cmH2O: its range beyond the difference between its ends, so that a pressure
    /// that is still rising does not count. The first 150 ms after the rise of the target are left out, because a single overshoot is
    /// no oscillation; 0 without samples after them.
    pub fn oscillation(&self, breath: &Settings, period_us: u32) -> f64 {
        let period_s = f64::from(period_s(period_us));
        let [pressure, ..] = self.curves();
        let late = ticks(f64::from(breath.rise_time) + LATE_FROM_S, period_s);
        let plateau = plateau(breath, pressure.get(late..).unwrap_or_default(), late, period_s);
        let [first, .., last] = plateau else { return 0.0 };
        let highest = plateau.iter().copied().fold(*first, f64::max);
        let lowest = plateau.iter().copied().fold(*first, f64::min);
        highest - lowest - (last - first).abs()
    }
}

/// Distance from PIP that the plateau may have, cmH2O.
pub fn plateau_tolerance(pip: f32) -> f64 {
    let (absolute, share) = PLATEAU_TOLERANCE;
    absolute + share * f64::from(pip)
}

/// The samples of the plateau, the last one at least, of those from the tick `first` of an inspiration to its end.
fn plateau<'a>(breath: &Settings, samples: &'a [f64], first: usize, period_s: f64) -> &'a [f64] {
    let longest = samples.len().saturating_sub(ticks(PLATEAU_S, period_s).max(1));
    let settled = ticks(f64::from(breath.rise_time) + SETTLING_S, period_s).saturating_sub(first);
    &samples[longest.max(settled).min(samples.len().saturating_sub(1))..]
}

/// Valve effort over the plateau of an inspiration with these commands, percent.
pub fn valve_effort(breath: &Settings, commands: &[f64], period_s: f64) -> ValveEffort {
    ValveEffort::of(plateau(breath, commands, 0, period_s), period_s)
}

fn ticks(seconds: f64, period_s: f64) -> usize {
    (seconds / period_s).round() as usize
}

/// Scores an inspiration of true airway pressures, cmH2O, against the same number of targets, cmH2O. Samples are
/// `period_s` seconds apart, the first at the start of the inspiration. No samples give the default score. The valve effort, which
/// the pressure does not show, is zero.
///
/// Means over time use the trapezoidal rule: in a plain sum the first instant, when the error is largest, would weigh
/// more at a longer control period.
pub fn score_breath(breath: &Settings, period_s: f64, pressure: &[f64], target: &[f64]) -> Score {
    let (peep, pip) = (f64::from(breath.peep), f64::from(breath.pip));
    let errors: Vec<f64> = pressure.iter().zip(target).map(|(p, target)| (p - target).abs()).collect();
    let from_pip: Vec<f64> = pressure.iter().map(|p| (p - pip).abs()).collect();
    let late = ticks(LATE_FROM_S, period_s).min(errors.len().saturating_sub(1));
    let tracking = Tracking::of((peep, pip), period_s, pressure, target);
    Score {
        score: tracking.error,
        rise_ms: tracking.rise_ms,
        overshoot: tracking.overshoot,
        plateau_error: mean_over_time(plateau(breath, &from_pip, 0, period_s)),
        late_error: mean_over_time(&errors[late..]),
        effort: ValveEffort::default(),
        cut: 0.0,
    }
}

impl Score {
    /// Mean of every value; zeros without scores.
    pub fn mean(scores: &[Self]) -> Self {
        let share = 1.0 / scores.len().max(1) as f64;
        let mean = |figure: fn(&Self) -> f64| scores.iter().map(figure).sum::<f64>() * share;
        Self {
            score: mean(|s| s.score),
            rise_ms: mean(|s| s.rise_ms),
            overshoot: mean(|s| s.overshoot),
            plateau_error: mean(|s| s.plateau_error),
            late_error: mean(|s| s.late_error),
            effort: ValveEffort {
                total_variation: mean(|s| s.effort.total_variation),
                deviation: mean(|s| s.effort.deviation),
            },
            cut: mean(|s| s.cut),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plant::prescriptions::Prescriptions;
    use proptest::prelude::*;
    use shared::breath::paper_settings;

    /// One second at 1 kHz, PEEP 5, PIP 25, square target; `pressure` of the time in seconds.
    fn scored(pressure: impl Fn(f64) -> f64) -> Score {
        sampled(1e-3, pressure)
    }

    fn sampled(period_s: f64, pressure: impl Fn(f64) -> f64) -> Score {
        let samples = (1.0 / period_s).round() as usize;
        let pressure: Vec<f64> = (0..samples).map(|n| pressure(n as f64 * period_s)).collect();
        score_breath(&paper_settings(25.0), period_s, &pressure, &vec![25.0; samples])
    }

    fn close(actual: f64, expected: f64) {
        assert!((actual - expected).abs() < 1e-6, "{actual}, not {expected}");
    }

    #[test]
    fn perfect_tracking_scores_zero() {
        assert_eq!(scored(|_| 25.0), Score::default());
    }

    #[test]
    fn a_constant_offset_is_every_error_and_the_overshoot() {
        let above = scored(|_| 27.0);
        close(above.score, 2.0);
        close(above.late_error, 2.0);
        close(above.plateau_error, 2.0);
        close(above.overshoot, 2.0);
        let below = scored(|_| 23.5);
        close(below.plateau_error, 1.5);
        close(below.overshoot, 0.0);
    }

    #[test]
    fn a_ramp_rises_in_eight_tenths_of_its_time() {
        let ramp = scored(|t| (5.0 + 20.0 * t / 0.2).min(25.0));
        close(ramp.rise_ms, 160.0);
        // A triangle of 20 cmH2O over 0.2 s, in the 0.999 s between the first sample and the last.
        close(ramp.score, 0.5 * 20.0 * 0.2 / 0.999);
        close(ramp.plateau_error, 0.0);
    }

    #[test]
    fn late_error_leaves_the_first_150_ms_out() {
        close(scored(|t| if t < 0.1499 { 5.0 } else { 24.0 }).late_error, 1.0);
    }

    #[test]
    fn plateau_error_looks_at_the_last_300_ms_only() {
        close(scored(|t| if t < 0.6999 { 5.0 } else { 24.5 }).plateau_error, 0.5);
    }

    #[test]
    fn the_plateau_begins_after_the_rise_of_the_target() {
        let plateau_error = |inspiratory_time, rise_time, pressure: &dyn Fn(f64) -> f64| {
            let settings = Settings { inspiratory_time, rise_time, ..paper_settings(25.0) };
            let samples = (inspiratory_time * 1e3).round() as usize;
            let pressure: Vec<f64> = (0..samples).map(|n| pressure(n as f64 * 1e-3)).collect();
            score_breath(&settings, 1e-3, &pressure, &vec![25.0; samples]).plateau_error
        };
        let slow = |t: f64| if t < 0.3499 { 5.0 } else { 24.5 };
        close(plateau_error(0.5, 0.25, &slow), 0.5);
        // A rise that lasts nearly all of the inspiration leaves its last instant, as does an inspiration without time to settle.
        close(plateau_error(0.4, 0.4, &|t| 5.0 + 20.0 * t / 0.4), 0.05);
        close(plateau_error(0.09, 0.0, &|t| if t < 0.0885 { 5.0 } else { 24.0 }), 1.0);
        close(plateau_error(0.25, 0.0, &|t| if t < 0.0999 { 5.0 } else { 24.0 }), 1.0);
    }

    /// An inspiration at 1 kHz with this rise and this pressure over time.
    fn oscillation(inspiratory_time: f32, rise_time: f32, pressure: impl Fn(f64) -> f64) -> f64 {
        let settings = Settings { inspiratory_time, rise_time, ..paper_settings(25.0) };
        let ticks = (0..(inspiratory_time * 1e3).round() as u32).map(|tick| RecordedTick {
            pressure: pressure(f64::from(tick) * 1e-3) as f32,
            target: 25.0,
            command: 0.0,
        });
        InspirationRecord { ticks: ticks.collect(), cut: false }.oscillation(&settings, 1000)
    }

    #[test]
    fn a_rise_and_its_overshoot_are_no_oscillation() {
        let overshooting = |t: f64| 25.0 - 20.0 * (-t / 0.02).exp() + 10.0 * (t / 0.03) * (-t / 0.03).exp();
        for (inspiratory_time, rise_time) in [(0.25, 0.0), (0.4, 0.0), (0.4, 0.2), (0.4, 0.4), (3.0, 0.4)] {
            let ramp = |t: f64| (5.0 + 20.0 * t / f64::from(rise_time).max(1e-3)).min(25.0);
            let found = oscillation(inspiratory_time, rise_time, ramp);
            assert!(found < 1e-3, "{inspiratory_time} {rise_time}: {found}");
            let shaking = |t: f64| ramp(t) + 5.0 * (t * 2.0 * std::f64::consts::PI / 0.03).sin();
            let found = oscillation(inspiratory_time, rise_time, shaking);
            let seen = inspiratory_time - rise_time > 0.3;
            assert!(!seen || (4.0..=10.1).contains(&found), "{inspiratory_time} {rise_time}: {found}");
        }
        assert!(oscillation(0.4, 0.0, overshooting) < 1.0);
    }

    #[test]
    fn overshoot_is_the_highest_peak_above_pip() {
        let peaked = scored(|t| if (0.2..0.21).contains(&t) { 28.5 } else { 25.0 });
        close(peaked.overshoot, 3.5);
    }

    #[test]
    fn a_rise_that_never_ends_counts_as_the_whole_inspiration() {
        close(scored(|_| 15.0).rise_ms, 1000.0);
        close(scored(|_| 5.0).rise_ms, 1000.0);
    }

    #[test]
    fn the_control_period_does_not_change_the_score_of_a_pressure() {
        let rise = |t: f64| 25.0 - 20.0 * (-t / 0.05).exp();
        let (fine, coarse) = (sampled(1e-3, rise), sampled(0.01, rise));
        assert!((fine.score - coarse.score).abs() < 0.02, "{fine:?} {coarse:?}");
        assert!((fine.rise_ms - coarse.rise_ms).abs() < 2.0, "{fine:?} {coarse:?}");
    }

    #[test]
    fn nothing_to_score_is_no_panic() {
        assert_eq!(score_breath(&paper_settings(25.0), 1e-3, &[], &[]), Score::default());
    }

    #[test]
    fn a_mean_is_taken_figure_by_figure() {
        let scores = [scored(|_| 25.0), scored(|_| 27.0)];
        let mean = Score::mean(&scores);
        close(mean.score, 1.0);
        close(mean.overshoot, 1.0);
        close(mean.plateau_error, 1.0);
    }

    proptest! {
        #[test]
        fn any_prescription_is_scored_finitely(
            seed: u64,
            number: u32,
            pressure in prop::collection::vec(-20.0f32..100.0, 1..50),
        ) {
            let settings = Prescriptions::find("bedside").unwrap().draw(seed, number);
            let breath = Breath::new(&settings, 5000).unwrap();
            let ticks = (0..breath.inspiration_ticks()).map(|tick| RecordedTick {
                pressure: pressure[tick as usize % pressure.len()],
                target: breath.target(tick),
                command: 50.0,
            });
            let record = InspirationRecord { ticks: ticks.collect(), cut: false };
            let Score { score, rise_ms, overshoot, plateau_error, late_error, effort, .. } = record.score(&settings, 5000);
            let oscillation = record.oscillation(&settings, 5000);
            for figure in [score, overshoot, plateau_error, late_error, oscillation, effort.total_variation, effort.deviation] {
                prop_assert!(figure >= 0.0 && figure.is_finite());
            }
            prop_assert!(rise_ms <= 5.0 * f64::from(breath.inspiration_ticks()));
        }

        #[test]
        fn following_the_target_of_any_prescription_scores_zero(seed: u64, number: u32) {
            let settings = Prescriptions::find("bedside").unwrap().draw(seed, number);
            let breath = Breath::new(&settings, 1000).unwrap();
            let target: Vec<f64> = (0..breath.inspiration_ticks()).map(|tick| breath.target(tick).into()).collect();
            let found = score_breath(&settings, 1e-3, &target, &target);
            prop_assert_eq!((found.score, found.late_error, found.overshoot), (0.0, 0.0, 0.0));
            let last = f64::from(settings.pip) - target.last().unwrap();
            prop_assert!(found.plateau_error <= last + 1e-9, "{:?} {:?}", settings, found);
            prop_assert!(found.rise_ms <= 0.8e3 * f64::from(settings.rise_time) + 1.0 || last > 0.0, "{:?} {:?}", settings, found);
        }

        #[test]
        fn every_figure_is_finite_and_not_negative(pressure in prop::collection::vec(-20.0f64..100.0, 0..400)) {
            let target = vec![25.0; pressure.len()];
            let Score { score, rise_ms, overshoot, plateau_error, late_error, .. } =
                score_breath(&paper_settings(25.0), 0.005, &pressure, &target);
            for figure in [score, overshoot, plateau_error, late_error] {
                prop_assert!(figure >= 0.0 && figure.is_finite());
            }
            prop_assert!(rise_ms >= 0.0 && rise_ms <= 5.0 * pressure.len() as f64);
        }
    }
}
