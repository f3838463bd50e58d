//! What limits a loop, in words, with the figure that says so. Nothing is changed by it.

use std::f64::consts::TAU;

use serde::Serialize;

use super::estimate::Estimate;
use super::interval::SureMargins;
use super::stability::RequiredMargins;
use verdict::Cause;
use verdict::response::{Inspiration, Response};

/// Share of the angle between no loop gain and the edge of stability that a delay may take at the crossover.
const DELAY_SHARE: f64 = 1.0 / 3.0;
/// Play that is named, percent of the command, and the residual with it as a share of that without.
const PLAY_PERCENT: f64 = 6.0;
const WITH_PLAY: f64 = 0.8;
/// Part of the inspired gas that does not come back with a leak.
const LEAK_SHARE: f64 = 0.1;

/// A piece of advice.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Advice {
    /// What limits the loop.
    pub cause: Cause,
    /// The advice, with its figure.
    pub text: String,
}

/// What the advice rests on beside the margins.
#[derive(Clone, Debug, Default)]
pub(super) struct Evidence {
    /// Commands and pressures of breaths with a sine.
    pub excited: Vec<Inspiration>,
    /// Control period, s.
    pub period_s: f64,
    /// Gas that flowed in during a breath without a sine, and that did not come back, mL; none without a flow sensor.
    pub gas_ml: Option<(f64, f64)>,
}

/// The advice on a loop.
pub(super) fn advice(margins: &SureMargins, estimates: &[Estimate], evidence: &Evidence) -> Vec<Advice> {
    let all = [gain(margins), delay(margins, estimates), play(evidence), leak(evidence)];
    all.into_iter().flatten().collect()
}

/// Lower gains, if a margin is too small.
fn gain(margins: &SureMargins) -> Option<Advice> {
    let required = RequiredMargins::default();
    let measured = margins.measured.as_ref()?;
    let (ms, factor) = (margins.ms.sure(), margins.gain_margin.sure());
    let too_high = ms.is_some_and(|ms| ms.low > required.ms);
    let too_small = factor.is_some_and(|factor| factor.high.is_some_and(|high| high < required.gain_margin));
    if !(too_high || too_small) {
        return None;
    }
    let lower = factor.map(|factor| {
        format!(
            "; at {:.0} % of these gains the gain margin would be {}",
            (100.0 * factor.value / required.gain_margin).min(100.0),
            required.gain_margin
        )
    });
    Some(Advice {
        cause: Cause::Gain,
        text: format!(
            "the gain is too high: Ms is {:.2} at {:.1} Hz, at most {} is robust{}",
            measured.ms,
            measured.ms_hz,
            required.ms,
            lower.unwrap_or_default()
        ),
    })
}

/// A shorter delay, if it takes much of the angle at the crossover.
fn delay(margins: &SureMargins, estimates: &[Estimate]) -> Option<Advice> {
    let crossover_hz = margins.measured.as_ref()?.crossover_hz?;
    // From the plant's angle above the crossover, where lags have reached their quarter turns and the delay goes on.
    let high: Vec<&Estimate> =
        estimates.iter().filter(|at| at.counts() && at.response.hz >= crossover_hz).collect();
    let (first, last) = (high.first()?, high.last()?);
    let turned: f64 = high
        .windows(2)
        .map(|pair| {
            let step = (pair[1].plant / pair[0].plant).arg();
            if step > 0.0 { step - TAU } else { step }
        })
        .sum();
    let delay_s = -turned / (TAU * (last.response.hz - first.response.hz));
    let share = 2.0 * delay_s * crossover_hz;
    (share.is_finite() && share >= DELAY_SHARE).then(|| Advice {
        cause: Cause::Delay,
        text: format!(
            "the delay from command to pressure limits the loop: {:.0} ms take {:.0} of 180 degrees at the crossover of {crossover_hz:.1} Hz; \
             look for slow valves, filters and long lines",
            1e3 * delay_s,
            180.0 * share
        ),
    })
}

/// The valve's play, if it explains the pressures of sines far better than none.
fn play(evidence: &Evidence) -> Option<Advice> {
    let Response { play_percent, with_play } = Response::fit(&evidence.excited, evidence.period_s)?;
    (play_percent >= PLAY_PERCENT && with_play <= WITH_PLAY).then(|| Advice {
        cause: Cause::Play,
        text: format!(
            "the valve has play: {play_percent:.0} % of its command explain the sines {:.1} times as well as none; repair it before \
             raising the gains, since a smaller sine sees another loop",
            1.0 / with_play
        ),
    })
}

/// A leak, if gas does not come back.
fn leak(evidence: &Evidence) -> Option<Advice> {
    let (inflow, lost) = evidence.gas_ml?;
    (lost >= LEAK_SHARE * inflow && inflow > 0.0).then(|| Advice {
        cause: Cause::Leak,
        text: format!(
            "the circuit leaks, unless the flow sensor is off: {lost:.0} of {inflow:.0} mL do not come back ({:.0} %)",
            100.0 * lost / inflow
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::response::ResponsePoint;
    use num_complex::Complex64;

    /// Exact estimates of an integrator with this gain in 1/s behind a dead time in s.
    fn integrator(gain: f64, dead_time_s: f64) -> Vec<Estimate> {
        let at = |place: u32| {
            let hz = 1.6 * 15.6_f64.powf(f64::from(place) / 19.0);
            let omega = TAU * hz;
            let loop_gain = Complex64::cis(-omega * dead_time_s) / Complex64::new(0.0, omega / gain);
            let before = -loop_gain / (Complex64::ONE + loop_gain);
            Estimate {
                response: ResponsePoint { hz, loop_gain, path: Complex64::ONE },
                plant: loop_gain,
                coherence: 1.0,
                loop_sd: 0.0,
                limited: 0.0,
                before,
                before_sd: 0.0,
                unsettled: 0.0,
                freedom: 3,
            }
        };
        (0..20).map(at).collect()
    }

    fn causes(gain: f64, dead_time_s: f64) -> Vec<(Cause, String)> {
        let estimates = integrator(gain, dead_time_s);
        let evidence = Evidence { period_s: 1e-3, ..Evidence::default() };
        let all = advice(&SureMargins::of(&estimates, 1), &estimates, &evidence);
        all.into_iter().map(|advice| (advice.cause, advice.text)).collect()
    }

    #[test]
    fn too_high_a_gain_is_named_with_the_share_of_it_that_is_robust() {
        // Its gain margin is pi / (2 x 40 x 0.0245), 1.60: at 80 % it is 2.
        let all = causes(40.0, 0.0245);
        assert!(all[0].0 == Cause::Gain && all[0].1.contains("at 80 % of these gains"), "{all:?}");
        assert!(causes(14.0, 0.025).is_empty(), "{:?}", causes(14.0, 0.025));
    }

    #[test]
    fn a_delay_that_takes_a_third_of_the_angle_at_the_crossover_is_named_with_it() {
        // At 20 / 2 pi Hz, 60 ms are 69 degrees.
        let all = causes(20.0, 0.060);
        let delay = all.iter().find(|(cause, _)| *cause == Cause::Delay).unwrap();
        assert!(delay.1.contains("60 ms take 69 of 180 degrees"), "{delay:?}");
        assert!(causes(20.0, 0.030).iter().all(|(cause, _)| *cause != Cause::Delay));
    }

    #[test]
    fn gas_that_does_not_come_back_is_a_leak_from_a_tenth_on() {
        let of = |gas_ml| leak(&Evidence { gas_ml, ..Evidence::default() }).map(|advice| advice.text);
        assert!(of(Some((500.0, 60.0))).unwrap().contains("60 of 500 mL do not come back (12 %)"));
        assert_eq!(
            [of(Some((500.0, 49.0))), of(Some((0.0, 0.0))), of(Some((f64::NAN, 60.0))), of(None)],
            [const { None }; 4]
        );
    }

    /// Pressures of a lag behind a valve with this play, under sines.
    fn excited(play: f64) -> Vec<Inspiration> {
        let inspiration = |phase: u32| {
            let command: Vec<f64> = (0..650)
                .map(|tick| 30.0 + 10.0 * (TAU * (3e-3 * f64::from(tick) + f64::from(phase) / 6.0)).sin())
                .collect();
            let (mut stem, mut pressure) = (0.0_f64, 12.0);
            let moved = |command: &f64| {
                stem = stem.max(*command).min(command + play);
                pressure += 0.02 * (0.4 * stem - pressure);
                pressure
            };
            Inspiration { pressure: command.iter().map(moved).collect(), command }
        };
        (0..6).map(inspiration).collect()
    }

    #[test]
    fn a_valve_with_play_is_named_with_it_and_one_without_is_not() {
        let of = |width| play(&Evidence { excited: excited(width), period_s: 1e-3, gas_ml: None });
        let found = of(8.0).unwrap();
        assert!(found.cause == Cause::Play && found.text.contains("8 % of its command"), "{found:?}");
        assert_eq!(of(0.0), None);
    }
}
