//! The operator, who sets and changes as at a bedside: weaning, recruitment, another rhythm, another shape, at times everything.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use shared::settings::{LIMIT_MARGIN, Settings};

use super::chance::uniform;
use super::ward::{Kind, ventilates};
use plant::bench::BenchConfig;
use plant::prescriptions::field;

/// Breaths between two courses.
const PAUSE: (f64, f64) = (100.0, 400.0);
/// Weaning: steps of PIP, their size, cmH2O, and the breaths of each; share of the steps that are taken back.
const WEANING_STEPS: std::ops::RangeInclusive<u32> = 2..=6;
const WEANING_STEP: (f64, f64) = (1.0, 3.0);
const WEANING_BREATHS: (f64, f64) = (30.0, 120.0);
const BACK: f64 = 0.2;
/// Recruitment: size of the steps of PEEP, cmH2O, and the breaths of each.
const RECRUITMENT_STEP: (f64, f64) = (2.0, 5.0);
const RECRUITMENT_BREATHS: (f64, f64) = (3.0, 10.0);
/// Least distance of PIP above PEEP that is left after weaning, cmH2O.
const WEANED: f32 = 5.0;

/// Settings that the operator enters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SettingsChange {
    /// Time, s.
    pub at_s: f64,
    /// The new settings.
    pub settings: Settings,
}

/// A step of a course: settings, and the breaths before them.
type Step = (f64, Settings);

/// Draws the changes of a stay of some hours, course after course.
pub(super) fn changes(
    rng: &mut ChaCha8Rng,
    kind: &Kind,
    bench: &BenchConfig,
    first: Settings,
    hours: f64,
) -> Vec<SettingsChange> {
    let (mut changes, mut settings, mut at_s) = (Vec::new(), first, 0.0);
    loop {
        at_s += uniform(rng, PAUSE) * 60.0 / f64::from(settings.rate);
        for (breaths, next) in course(rng, kind, bench, settings) {
            at_s += breaths * 60.0 / f64::from(settings.rate);
            if at_s >= hours * 3600.0 {
                return changes;
            }
            if ventilates(bench, &next) {
                settings = next;
                changes.push(SettingsChange { at_s, settings });
            }
        }
        if at_s >= hours * 3600.0 {
            return changes;
        }
    }
}

fn course(rng: &mut ChaCha8Rng, kind: &Kind, bench: &BenchConfig, before: Settings) -> Vec<Step> {
    let other = kind.prescription(rng, bench);
    match rng.random_range(0..12) {
        0..3 => weaning(rng, before),
        3..5 => recruitment(rng, before, kind.highest_peep),
        5..8 => vec![(0.0, rhythm(rng, before, &other))],
        8..11 => vec![(0.0, shape(rng, before, &other))],
        _ => vec![(0.0, other)],
    }
}

/// PIP falls step by step, and at times rises again.
fn weaning(rng: &mut ChaCha8Rng, before: Settings) -> Vec<Step> {
    let (size, steps) = (uniform(rng, WEANING_STEP) as f32, rng.random_range(WEANING_STEPS));
    let mut pip = before.pip;
    let step = |_| {
        let wanted = if rng.random_bool(BACK) { pip + size } else { pip - size };
        // Already weaned further than this, a patient stays there.
        pip = wanted.max(before.peep + WEANED).min(before.pip);
        (uniform(rng, WEANING_BREATHS), Settings { pip, ..before })
    };
    (0..steps).map(step).collect()
}

/// PEEP rises in steps to its highest value, with PIP and where needed the limit above it, and comes down again.
fn recruitment(rng: &mut ChaCha8Rng, before: Settings, highest: f32) -> Vec<Step> {
    let (size, breaths) = (uniform(rng, RECRUITMENT_STEP) as f32, uniform(rng, RECRUITMENT_BREATHS));
    let highest = uniform(rng, (f64::from(before.peep), f64::from(highest))) as f32;
    let at = |peep: f32| {
        let pip = (before.pip + peep - before.peep).min(field("pip").max);
        let pressure_limit = before.pressure_limit.max(pip + LIMIT_MARGIN).min(field("pressure_limit").max);
        (breaths, Settings { peep, pip, pressure_limit, ..before })
    };
    let count = ((highest - before.peep) / size).floor() as u16;
    let up = (1..=count).chain((0..count).rev());
    up.map(|step| at(before.peep + size * f32::from(step))).collect()
}

/// Rate and inspiratory time go some of the way to other ones.
fn rhythm(rng: &mut ChaCha8Rng, before: Settings, other: &Settings) -> Settings {
    let share = uniform(rng, (0.1, 1.0));
    let between = |from: f32, to: f32| f64::from(from).powf(1.0 - share) * f64::from(to).powf(share);
    let rate = between(before.rate, other.rate) as f32;
    let inspiratory_time = between(before.inspiratory_time, other.inspiratory_time) as f32;
    Settings {
        fall_time: possible_fall(before.fall_time, rate, inspiratory_time),
        rate,
        inspiratory_time,
        ..before
    }
}

/// Another limit, rise, fall or bias.
fn shape(rng: &mut ChaCha8Rng, before: Settings, other: &Settings) -> Settings {
    let allowed = field("pressure_limit");
    let pressure_limit = (before.pip + other.pressure_limit - other.pip).clamp(allowed.min, allowed.max);
    let fall_time = possible_fall(other.fall_time, before.rate, before.inspiratory_time);
    match rng.random_range(0..4) {
        0 => Settings { pressure_limit: pressure_limit.max(before.pip + LIMIT_MARGIN), ..before },
        1 => Settings { rise_time: other.rise_time, ..before },
        2 => Settings { fall_time, ..before },
        _ => Settings { expiratory_bias: other.expiratory_bias, ..before },
    }
}

/// The fall that fits into a breath, s.
fn possible_fall(fall_time: f32, rate: f32, inspiratory_time: f32) -> f32 {
    // A breath of the last bits more than its phases, whose sum is rounded.
    fall_time.min(60.0 / rate - inspiratory_time * (1.0 + 1e-5)).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    fn before() -> Settings {
        Settings { pip: 25.0, peep: 5.0, pressure_limit: 32.0, ..Settings::default() }
    }

    fn generators() -> impl Iterator<Item = ChaCha8Rng> {
        (0..100).map(ChaCha8Rng::seed_from_u64)
    }

    #[test]
    fn weaning_lowers_pip_step_by_step_and_at_times_raises_it_again() {
        let mut raised = 0;
        for mut rng in generators() {
            let pips: Vec<_> = weaning(&mut rng, before()).iter().map(|(_, settings)| settings.pip).collect();
            assert!(pips.iter().all(|pip| (10.0..=25.0).contains(pip)), "{pips:?}");
            assert!(pips.windows(2).all(|pair| (pair[1] - pair[0]).abs() <= 3.01), "{pips:?}");
            raised += pips.windows(2).filter(|pair| pair[1] > pair[0]).count();
        }
        assert!((20..150).contains(&raised), "{raised}");
    }

    #[test]
    fn recruitment_raises_peep_with_pip_and_limit_and_comes_back() {
        let mut highest = 0.0_f32;
        for mut rng in generators() {
            let steps = recruitment(&mut rng, before(), 20.0);
            for (_, Settings { pip, peep, pressure_limit, .. }) in &steps {
                assert!((pip - peep - 20.0).abs() < 1e-4 && *pressure_limit >= pip + LIMIT_MARGIN);
                highest = highest.max(*peep);
            }
            assert!(steps.last().is_none_or(|(_, settings)| *settings == before()));
        }
        assert!((18.0..=20.0).contains(&highest), "{highest}");
    }

    #[test]
    fn another_rhythm_and_another_shape_are_possible() {
        let long = Settings { rate: 12.0, inspiratory_time: 3.0, fall_time: 1.0, ..before() };
        for mut rng in generators() {
            assert_eq!(rhythm(&mut rng, before(), &long).validate(), Ok(()));
            assert_eq!(rhythm(&mut rng, long, &before()).validate(), Ok(()));
            assert_eq!(shape(&mut rng, before(), &long).validate(), Ok(()));
        }
    }
}
