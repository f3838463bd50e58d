//! How sure the margins are: the spread of the margins of loop gains drawn around the measured one.

use num_complex::Complex64;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{ChiSquared, Distribution, StandardNormal};
use serde::Serialize;

use super::estimate::Estimate;
use super::response::ResponsePoint;
use super::stability::Margins;

/// Number of draws.
const DRAWS: usize = 400;
/// Share of the draws beyond each end of an interval of 95 %.
const BEYOND: f64 = 0.025;
/// Largest half width of an interval as a share of its margin: a margin that is less sure is not stated.
pub const SURE: f64 = 0.1;
/// Fewest frequencies from which margins are read.
const FEWEST: usize = 6;

/// A margin with its interval of 95 %.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sure {
    /// The margin.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end; none if it lies beyond the measured frequencies.
    pub high: Option<f64>,
}

impl Sure {
    /// Whether the interval is narrow enough to state the margin.
    pub fn is_sure(&self) -> bool {
        let within = |end: f64| (end - self.value).abs() <= SURE * self.value;
        within(self.low) && self.high.is_some_and(within)
    }
}

/// What the measurement says of a margin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Finding {
    /// The margin.
    Found(Sure),
    /// The coherence does not suffice; the margin as far as it is known.
    NotEnoughCoherence(Option<Sure>),
    /// It lies outside the measured frequencies.
    OutsideFrequencies,
}

impl Finding {
    /// The margin, if it is sure.
    pub fn sure(&self) -> Option<Sure> {
        match self {
            Self::Found(sure) => Some(*sure),
            Self::NotEnoughCoherence(_) | Self::OutsideFrequencies => None,
        }
    }
}

/// The margins of a loop, each with how sure it is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SureMargins {
    /// Ms.
    pub ms: Finding,
    /// Gain margin.
    pub gain_margin: Finding,
    /// Delay margin, ms.
    pub delay_margin_ms: Finding,
    /// All margins of the measured loop gain; none if too few frequencies count.
    pub measured: Option<Margins>,
}

impl SureMargins {
    /// The margins from the frequencies that count.
    pub fn of(all: &[Estimate], seed: u64) -> Self {
        let estimates = without_gap(all);
        let response: Vec<ResponsePoint> = estimates.iter().map(|estimate| estimate.response).collect();
        let cut = estimates.len() < all.len() && all.iter().any(Estimate::is_cut);
        let measured = Margins::of(&response).filter(|_| response.len() >= FEWEST && !cut);
        let Some(margins) = measured else {
            let none = Finding::NotEnoughCoherence(None);
            return Self { ms: none, gain_margin: none, delay_margin_ms: none, measured };
        };
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let drawn: Vec<Margins> =
            (0..DRAWS).filter_map(|_| Margins::of(&drawn(&estimates, &mut rng))).collect();
        let finding = |of: fn(&Margins) -> Option<f64>| finding(of(&margins), drawn.iter().map(of));
        // At the first frequency, the sensitivity falls: its maximum may lie below.
        let lowest = response[0].hz * 1.01;
        let ms = finding(|margins| Some(margins.ms));
        Self {
            ms: if margins.ms_hz > lowest { ms } else { Finding::OutsideFrequencies },
            gain_margin: finding(|margins| margins.gain_margin),
            delay_margin_ms: finding(|margins| margins.delay_margin_ms),
            measured,
        }
    }

    /// Whether every margin was found or lies outside the measured frequencies.
    pub fn suffices(&self) -> bool {
        [self.ms, self.gain_margin, self.delay_margin_ms]
            .iter()
            .all(|finding| !matches!(finding, Finding::NotEnoughCoherence(_)))
    }
}

/// The estimates that count, from the first one on until one that does not: across a gap the loop gain is unknown. Those that follow
/// count again only above all margins, where the loop gain is small and noise decides, so they are left out.
fn without_gap(estimates: &[Estimate]) -> Vec<&Estimate> {
    estimates
        .iter()
        .skip_while(|estimate| !estimate.counts())
        .take_while(|estimate| estimate.counts())
        .collect()
}

/// A response drawn around the estimates: heavier tails make up for a spread that is known from a few breaths only.
fn drawn(estimates: &[&Estimate], rng: &mut ChaCha8Rng) -> Vec<ResponsePoint> {
    let mut normal = || -> f64 { StandardNormal.sample(&mut *rng) };
    let noises: Vec<Complex64> = estimates
        .iter()
        .map(|_| Complex64::new(normal(), normal()) * std::f64::consts::FRAC_1_SQRT_2)
        .collect();
    estimates
        .iter()
        .zip(noises)
        .map(|(estimate, noise)| {
            // Real and imaginary part each have the breaths' freedom.
            let freedom = 2.0 * estimate.freedom as f64;
            let spread = ChiSquared::new(freedom).map_or(freedom, |squared| squared.sample(&mut *rng));
            let sd = (estimate.before_sd * (freedom / spread).sqrt()).hypot(estimate.unsettled);
            let before = estimate.before + noise * sd;
            ResponsePoint { loop_gain: -before / (Complex64::ONE + before), ..estimate.response }
        })
        .collect()
}

/// What is found of a margin, given those of the draws.
fn finding(value: Option<f64>, drawn: impl Iterator<Item = Option<f64>>) -> Finding {
    // An absent margin is larger than any other.
    let mut all: Vec<f64> = drawn.map(|margin| margin.unwrap_or(f64::INFINITY)).collect();
    all.sort_by(f64::total_cmp);
    let at =
        |share: f64| all.get(((all.len() as f64 * share) as usize).min(all.len().saturating_sub(1))).copied();
    let (Some(low), Some(high)) = (at(BEYOND), at(1.0 - BEYOND)) else {
        return Finding::NotEnoughCoherence(None);
    };
    match value {
        None => Finding::OutsideFrequencies,
        Some(value) => {
            let sure = Sure { value, low, high: high.is_finite().then_some(high) };
            if sure.is_sure() { Finding::Found(sure) } else { Finding::NotEnoughCoherence(Some(sure)) }
        }
    }
}
