//! How well the pressure of an inspiration follows its target.

/// Shares of the way from PEEP to PIP between which the rise is timed.
pub const RISE: (f64, f64) = (0.1, 0.9);

/// Tracking of an inspiration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tracking {
    /// Mean absolute error, cmH2O.
    pub error: f64,
    /// Time from 10 % to 90 % of the way from PEEP to PIP, ms; if 90 % is never reached, the whole inspiration.
    pub rise_ms: f64,
    /// Highest pressure above PIP, cmH2O, at least 0.
    pub overshoot: f64,
}

impl Tracking {
    /// Of pressures and as many targets, cmH2O, which are `period_s` seconds apart, the first at the start of the inspiration, on
    /// the way from PEEP to PIP. No samples give zeros.
    pub fn of((peep, pip): (f64, f64), period_s: f64, pressure: &[f64], target: &[f64]) -> Self {
        let errors: Vec<f64> = pressure.iter().zip(target).map(|(p, target)| (p - target).abs()).collect();
        let whole = pressure.len() as f64 * period_s;
        Self {
            error: mean_over_time(&errors),
            rise_ms: 1e3 * rise(pressure, (peep, pip), period_s).map_or(whole, |(start, end)| end - start),
            overshoot: pressure.iter().fold(0.0, |most: f64, p| most.max(p - pip)),
        }
    }
}

/// Times at which the pressure first reaches 10 and 90 % of the way between two pressures, s; `None` if it does not.
pub fn rise(pressure: &[f64], (from, to): (f64, f64), period_s: f64) -> Option<(f64, f64)> {
    let reached = |part: f64| Some(reached_at(pressure, from + part * (to - from))? * period_s);
    Some((reached(RISE.0)?, reached(RISE.1)?))
}

/// Mean of a quantity between its first and last sample, by the trapezoidal rule.
pub fn mean_over_time(samples: &[f64]) -> f64 {
    match samples {
        [] => 0.0,
        [only] => *only,
        [first, .., last] => {
            let sum: f64 = samples.iter().sum();
            (sum - 0.5 * (first + last)) / (samples.len() - 1) as f64
        }
    }
}

/// Index at which `level` is first reached, linearly interpolated between samples.
fn reached_at(pressure: &[f64], level: f64) -> Option<f64> {
    let index = pressure.iter().position(|p| *p >= level)?;
    match index.checked_sub(1).map(|before| pressure[before]) {
        Some(before) => Some(index as f64 - (pressure[index] - level) / (pressure[index] - before)),
        None => Some(0.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_is_tracked_as_it_was_drawn() {
        let pressure: Vec<f64> = (0..=20).map(|tick| 5.0 + f64::from(tick)).collect();
        let Tracking { error, rise_ms, overshoot } = Tracking::of((5.0, 15.0), 1e-3, &pressure, &[15.0; 21]);
        assert!(
            (error - 5.0).abs() < 1e-12 && (rise_ms - 8.0).abs() < 1e-9 && (overshoot - 10.0).abs() < 1e-12
        );
    }

    #[test]
    fn an_inspiration_that_never_rises_takes_all_its_time() {
        let Tracking { rise_ms, overshoot, .. } = Tracking::of((5.0, 15.0), 1e-3, &[5.0; 40], &[15.0; 40]);
        assert!((rise_ms - 40.0).abs() < 1e-9 && overshoot.abs() < 1e-12);
        assert_eq!(
            Tracking::of((5.0, 15.0), 1e-3, &[], &[]),
            Tracking { error: 0.0, rise_ms: 0.0, overshoot: 0.0 }
        );
    }
}
