//! Advice: benches with one thing wrong, of drawn lungs and settings.

use super::*;
use plant::bench::BenchConfig;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use shared::control::pid::PidGains;
use shared::settings::Settings;

/// Drawn benches.
const CASES: u64 = 24;

/// Highest gains that are tried, and gains with a strong integral, with which the default bench rings.
const USUAL: PidGains = PidGains { p: 6.0, i: 60.0, d: 0.05 };
const INTEGRAL: PidGains = PidGains { p: 6.5, i: 265.0, d: 0.13 };

#[derive(Debug, Clone)]
struct Case {
    bench: BenchConfig,
    settings: Settings,
    gains: PidGains,
    seed: u64,
}

impl Case {
    /// A lung and its prescription.
    fn draw(seed: u64, gains: PidGains) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let (r, c) = (random.random_range(10.0..40.0), random.random_range(10.0..50.0));
        let bench = BenchConfig::paper(r, c);
        let peep = random.random_range(4.0..12.0);
        let pip = peep + random.random_range(8.0..18.0);
        let settings =
            Settings { pip, peep, trigger_flow: 0.0, trigger_pressure: 0.0, ..Settings::default() };
        Self { bench, settings, gains, seed }
    }

    /// The same with the highest gains with which it has no oscillation.
    fn calm(seed: u64) -> Option<Self> {
        let shares = [1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2];
        let calm = |case: &Self| !case.spots().iter().any(|spot| oscillates(spot.kind));
        shares.map(|share| Self::draw(seed, USUAL).scaled(share)).into_iter().find(calm)
    }

    fn spots(&self) -> Vec<SoreSpot> {
        self.spots_of_every(1)
    }

    /// Sore spots where only every so manieth tick is recorded.
    fn spots_of_every(&self, ticks: u32) -> Vec<SoreSpot> {
        let fine = bench::recorded(&self.bench, &self.settings, self.gains, 6, self.seed, false);
        let provenance = Provenance::new(1_000 * ticks, "bench");
        let mut recording = Recording::with_extras(provenance, &[Extra::FlowIn, Extra::FlowOut]);
        let rows = (0..fine.len()).filter_map(|row| fine.row(row));
        for row in rows.filter(|row| row.tick % ticks == 0) {
            recording.push(Row { tick: row.tick / ticks, ..row });
        }
        judge(&recording, Judged::True, &Limits::default()).unwrap().sore_spots
    }

    fn scaled(mut self, by: f32) -> Self {
        self.gains = PidGains { p: by * self.gains.p, i: by * self.gains.i, d: by * self.gains.d };
        self
    }
}

fn oscillates(kind: Kind) -> bool {
    matches!(kind, Kind::Overshoot | Kind::Undershoot | Kind::Oscillation)
}

/// Number of cases with a sore spot of a kind, and of those with each cause as its first advice.
fn causes(cases: impl Iterator<Item = Case>, concerns: fn(Kind) -> bool) -> (usize, [usize; 4]) {
    causes_among(cases.map(|case| case.spots()), concerns)
}

/// The same of the sore spots of cases.
fn causes_among(
    cases: impl Iterator<Item = Vec<SoreSpot>>,
    concerns: fn(Kind) -> bool,
) -> (usize, [usize; 4]) {
    let (mut sore, mut found) = (0, [0; 4]);
    for spots in cases {
        let spots: Vec<&SoreSpot> = spots.iter().filter(|spot| concerns(spot.kind)).collect();
        sore += usize::from(!spots.is_empty());
        if let Some(advice) = spots.iter().find_map(|spot| spot.advice.as_ref()) {
            found[advice.cause as usize] += 1;
        }
    }
    println!("{sore} sore; gain, delay, play, leak: {found:?}");
    (sore, found)
}

fn calm() -> impl Iterator<Item = Case> {
    (0..CASES).filter_map(Case::calm)
}

#[test]
fn gains_that_are_too_high_are_named() {
    let (sore, [gain, ..]) = causes(calm().map(|case| case.scaled(2.0)), oscillates);
    assert!(10 * gain >= 8 * sore && sore >= 10, "{gain} of {sore}");
}

fn late() -> impl Iterator<Item = Case> {
    calm().map(|mut case| {
        case.bench.valve.dead_time_ms = 30.0;
        case
    })
}

#[test]
fn a_long_delay_is_named() {
    let (sore, [_, delay, ..]) = causes(late(), oscillates);
    assert!(10 * delay >= 8 * sore && sore >= 10, "{delay} of {sore}");
}

#[test]
fn a_coarse_recording_does_not_tell_a_gain_from_a_delay() {
    let coarse = |case: Case| case.spots_of_every(20);
    let (sore, [_, wrong, ..]) = causes_among(calm().map(|case| coarse(case.scaled(2.0))), oscillates);
    assert!(sore >= 10 && wrong == 0, "{wrong} of {sore}");
    let (sore, [wrong, ..]) = causes_among(late().map(coarse), oscillates);
    assert!(sore >= 10 && wrong == 0, "{wrong} of {sore}");
}

#[test]
fn play_is_named_and_that_of_the_default_valve_is_not() {
    let with = |backlash_percent: f64| {
        let cases = (0..CASES).map(|seed| {
            let mut case = Case::draw(seed, INTEGRAL);
            case.bench.valve.backlash_percent = backlash_percent;
            case
        });
        causes(cases, oscillates)
    };
    let ((sore, [_, _, play, _]), (_, [_, _, wrong, _])) = (with(10.0), with(4.0));
    assert!(10 * play >= 6 * sore && sore >= 10 && wrong <= 1, "{play} of {sore}, {wrong} wrong");
}

#[test]
fn a_leak_is_named() {
    let leaking = calm().map(|mut case| {
        case.bench.circuit.leak_l_per_s_at_30_cmh2o = 0.3;
        case
    });
    let (sore, [.., leak]) = causes(leaking, |kind| !oscillates(kind));
    assert!(10 * leak >= 8 * sore && sore >= 5, "{leak} of {sore}");
}

#[test]
fn calm_benches_get_no_advice() {
    assert_eq!(causes(calm(), |_| true).1, [0; 4]);
}
