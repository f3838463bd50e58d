//! The result of a measurement in rows and words, for every display of it.

use super::estimate::Estimate;
use super::interval::{Finding, Sure, SureMargins};
use super::measurement::{Ended, Measured};
use super::stability::RequiredMargins;

/// A margin as it is shown.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Its name.
    pub name: &'static str,
    /// Its unit; empty for a ratio.
    pub unit: &'static str,
    /// The margin, if it is stated.
    pub value: Option<f64>,
    /// Why it is not.
    pub unstated: Option<&'static str>,
    /// Its interval of 95 %, also of a margin that is not sure enough to be stated: both ends, the upper one only if it lies within the
    /// measured frequencies.
    pub interval: Option<(f64, Option<f64>)>,
    /// Digits after the point that mean something.
    pub decimals: usize,
    /// What a robust loop keeps.
    pub robust: String,
    /// Whether this one keeps it; none if the margin is not stated.
    pub keeps: Option<bool>,
}

/// The margins, one a row.
pub fn rows(margins: &SureMargins) -> [Row; 3] {
    let SureMargins { ms, gain_margin, delay_margin_ms, .. } = margins;
    let required = RequiredMargins::default();
    let most = |limit: f64| (format!("at most {limit}"), move |value: f64| value <= limit);
    let least = |limit: f64| (format!("at least {limit}"), move |value: f64| value >= limit);
    let (most_ms, keeps_ms) = most(required.ms);
    let (least_gain, keeps_gain) = least(required.gain_margin);
    let (least_delay, keeps_delay) = least(required.delay_margin_ms);
    [
        row(("Ms", ""), ms, 2, most_ms, keeps_ms),
        row(("gain margin", ""), gain_margin, 2, least_gain, keeps_gain),
        row(("delay margin", "ms"), delay_margin_ms, 1, least_delay, keeps_delay),
    ]
}

fn row(
    (name, unit): (&'static str, &'static str),
    finding: &Finding,
    decimals: usize,
    robust: String,
    keeps: impl Fn(f64) -> bool,
) -> Row {
    let (sure, unstated) = match finding {
        Finding::Found(sure) => (Some(sure), None),
        Finding::NotEnoughCoherence(sure) => (sure.as_ref(), Some("not enough coherence")),
        Finding::OutsideFrequencies => (None, Some("outside the frequencies")),
    };
    let value = finding.sure().map(|sure| sure.value);
    let interval = sure.map(|Sure { low, high, .. }| (*low, *high));
    Row { name, unit, value, unstated, interval, decimals, robust, keeps: value.map(keeps) }
}

/// What was measured beside the margins: frequencies, working point, crossover, and why there is not more.
pub fn remarks(measured: &Measured) -> Vec<String> {
    let Measured { estimates, point, margins, ended, .. } = measured;
    let counting: Vec<&Estimate> = estimates.iter().filter(|estimate| estimate.counts()).collect();
    let mut lines = Vec::new();
    if let (Some(first), Some(last)) = (counting.first(), counting.last()) {
        let least = counting.iter().map(|estimate| estimate.coherence).fold(1.0, f64::min);
        lines.push(format!(
            "{} of {} frequencies count, {:.1} to {:.1} Hz, with a coherence of at least {least:.2}",
            counting.len(),
            measured.plan.frequencies,
            first.response.hz,
            last.response.hz
        ));
        lines.push(format!(
            "measured at {:.1} cmH2O and {:.0} % of the command; without a sine the valve moves {:.0} % a second",
            point.pressure, point.command, point.effort
        ));
    }
    if let Some(crossover) = margins.measured.and_then(|margins| margins.crossover_hz) {
        lines.push(format!("crossover {crossover:.1} Hz"));
    }
    match ended {
        Some(Ended::Stopped) => lines.push("stopped: only the frequencies measured so far are shown".into()),
        Some(Ended::Alarm(reason) | Ended::Failed(reason)) => lines.push(format!("ended early: {reason}")),
        None => {}
    }
    lines
}

/// Why a margin could not be stated, and what to do; none if each could, or if the measurement ended early.
pub fn unstated(measured: &Measured) -> Option<String> {
    if measured.ended.is_some() || measured.margins.suffices() {
        return None;
    }
    let cut = measured.estimates.iter().map(|estimate| estimate.limited).fold(0.0, f64::max);
    Some(if measured.estimates.iter().any(Estimate::is_cut) {
        format!(
            "not enough coherence: the valve's limits cut the sine for up to {:.0} % of the time: use a smaller amplitude, or a higher PIP for more flow",
            100.0 * cut
        )
    } else {
        "not enough coherence: use more breaths at each frequency, or a larger amplitude".into()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_margin_is_stated_with_its_interval_or_the_reason_why_not() {
        let sure = Sure { value: 1.8, low: 1.7, high: Some(1.9) };
        let margins = SureMargins {
            ms: Finding::Found(sure),
            gain_margin: Finding::NotEnoughCoherence(Some(Sure { high: None, ..sure })),
            delay_margin_ms: Finding::OutsideFrequencies,
            measured: None,
        };
        let [ms, gain, delay] = rows(&margins);
        assert_eq!((ms.value, ms.interval, ms.keeps), (Some(1.8), Some((1.7, Some(1.9))), Some(true)));
        assert_eq!((gain.value, gain.interval, gain.keeps), (None, Some((1.7, None)), None));
        assert_eq!(gain.unstated, Some("not enough coherence"));
        assert_eq!((delay.interval, delay.unstated), (None, Some("outside the frequencies")));
        let low = SureMargins { gain_margin: Finding::Found(sure), ..margins };
        assert_eq!((rows(&low)[1].keeps, rows(&low)[1].robust.as_str()), (Some(false), "at least 2"));
    }
}
