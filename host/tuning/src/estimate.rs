//! The response at one frequency, from the signals of its breaths.
//!
//! Each signal of a breath becomes one complex number: its correlation with the breath's sine. Over the breaths of a frequency, whose
//! phases divide a turn evenly, it has three parts: the response to the sine, which does not depend on the phase; what every breath
//! has in common, such as the trend of a plateau, which turns back with the phase; and the conjugate response, because the window
//! is no whole number of periods, which turns back twice as fast. Even phases make the three orthogonal, so that the mean is the
//! response alone. What is left is noise, and tells how sure the mean is.

use std::f64::consts::TAU;

use num_complex::Complex64;
use serde::Serialize;

use super::response::ResponsePoint;

/// Least coherence at which a frequency counts.
pub const COHERENT: f64 = 0.8;
/// Largest share of the time in which the command reaches the valve's limits: beyond it the sine was cut, and the loop looks more
/// stable than it is.
pub const LIMITED: f64 = 0.03;
/// Parts of the signals over the phases, which are not noise.
const PARTS: usize = 3;

/// One tick of a window.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// Angle of the sine, turns.
    pub turns: f64,
    /// The sine itself, percent.
    pub sine: f64,
    /// Command with the sine, percent.
    pub command: f64,
    /// Measured pressure, cmH2O.
    pub pressure: f64,
}

/// The signals of a breath, correlated with its sine.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Correlated {
    /// Phase of the sine at its start, turns.
    pub phase: f64,
    sine: Complex64,
    /// Command without the sine.
    before: Complex64,
    pressure: Complex64,
    /// Sine and command without it in both halves of the window.
    halves: [[Complex64; 2]; 2],
    /// Share of the ticks in which the valve's limits cut the command.
    limited: f64,
}

impl Correlated {
    /// Correlates the ticks of a window.
    pub fn of(phase: f64, window: &[Moment]) -> Self {
        let at_limit = |moment: &&Moment| {
            moment.command <= 0.0 || moment.command >= f64::from(shared::control::COMMAND_MAX)
        };
        let limited = window.iter().filter(at_limit).count() as f64 / window.len().max(1) as f64;
        let correlated = |of: fn(&Moment) -> f64| correlate(window, of);
        let (first, second) = window.split_at(window.len() / 2);
        let half = |half: &[Moment]| {
            let turned = |of: fn(&Moment) -> f64| {
                half.iter().map(|moment| Complex64::cis(-TAU * moment.turns) * of(moment)).sum::<Complex64>()
            };
            [turned(|moment| moment.sine), turned(|moment| moment.command - moment.sine)]
        };
        Self {
            phase,
            sine: correlated(|moment| moment.sine),
            before: correlated(|moment| moment.command - moment.sine),
            pressure: correlated(|moment| moment.pressure),
            halves: [half(first), half(second)],
            limited,
        }
    }
}

/// The response at a frequency, with how sure it is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// The response.
    #[serde(flatten)]
    pub response: ResponsePoint,
    /// Response of the plant P, cmH2O per percent.
    pub plant: Complex64,
    /// Coherence of sine and command, or of sine and pressure, whichever is lower: the share of a breath's power that the sine
    /// explains.
    pub coherence: f64,
    /// Standard deviation of the loop gain.
    pub loop_sd: f64,
    /// Share of the time in which the command was cut at the valve's limits.
    pub limited: f64,
    /// Response of the command without the sine to the sine, and its standard deviation: from it come all others.
    #[serde(skip)]
    pub(super) before: Complex64,
    #[serde(skip)]
    pub(super) before_sd: f64,
    /// How far it still changes within the window: half of the difference between its halves. It does not shrink with more breaths.
    #[serde(skip)]
    pub(super) unsettled: f64,
    /// Breaths more than parts of their signals.
    #[serde(skip)]
    pub(super) freedom: usize,
}

impl Estimate {
    /// The response at a frequency in Hz, from all its breaths; none from no more than there are parts.
    pub fn of(hz: f64, breaths: &[Correlated]) -> Option<Self> {
        let freedom = breaths.len().checked_sub(PARTS).filter(|freedom| *freedom > 0)?;
        let count = breaths.len() as f64;
        let sine = breaths.iter().map(|breath| breath.sine).sum::<Complex64>() / count;
        let (before, before_sd) = part(breaths, |breath| breath.before / sine);
        let (path, path_sd) = part(breaths, |breath| breath.pressure / sine);
        let [first, second] = [0, 1].map(|half| {
            let sum =
                |signal: usize| breaths.iter().map(|breath| breath.halves[half][signal]).sum::<Complex64>();
            sum(1) / sum(0)
        });
        let unsettled = 0.5 * (second - first).norm();
        let coherence = |response: Complex64, sd: f64| {
            // Of a single breath, whatever their number.
            let noise = sd * sd * count;
            response.norm_sqr() / (response.norm_sqr() + noise)
        };
        // The command after the sine is that before it and the sine itself.
        let sensitivity = Complex64::ONE + before;
        let loop_gain = -before / sensitivity;
        Some(Self {
            response: ResponsePoint { hz, loop_gain, path },
            plant: path / sensitivity,
            coherence: coherence(before, before_sd).min(coherence(path, path_sd)),
            loop_sd: before_sd.hypot(unsettled) / sensitivity.norm_sqr(),
            limited: breaths.iter().map(|breath| breath.limited).sum::<f64>() / count,
            before,
            before_sd,
            unsettled,
            freedom,
        })
    }

    /// Whether it can be relied on.
    pub fn counts(&self) -> bool {
        // In this form a NaN fails too.
        self.coherence >= COHERENT && !self.is_cut()
    }

    /// Whether the valve's limits have cut the sine.
    pub fn is_cut(&self) -> bool {
        let whole = self.limited <= LIMITED;
        !whole
    }
}

/// Correlates a signal with the sine. What every breath has in common cancels over the phases; the straight trend is what the start of
/// the sine has set in motion and what dies out slowly, and is left out.
fn correlate(window: &[Moment], of: impl Fn(&Moment) -> f64) -> Complex64 {
    let count = window.len() as f64;
    let mean = window.iter().map(&of).sum::<f64>() / count;
    // Time from the middle of the window, ticks: mean and slope are then independent.
    let timed =
        || window.iter().enumerate().map(|(tick, moment)| (tick as f64 - 0.5 * (count - 1.0), moment));
    let square = timed().map(|(time, _)| time * time).sum::<f64>();
    let slope = timed().map(|(time, moment)| time * of(moment)).sum::<f64>() / square;
    let turned = |(time, moment): (f64, &Moment)| {
        Complex64::cis(-TAU * moment.turns) * (of(moment) - mean - slope * time)
    };
    timed().map(turned).sum::<Complex64>() * (2.0 / count)
}

/// The part of a signal that does not depend on the phase, and its standard deviation (of the complex number: of both parts together).
fn part(breaths: &[Correlated], signal: impl Fn(&Correlated) -> Complex64) -> (Complex64, f64) {
    let count = breaths.len() as f64;
    let turned = |breath: &Correlated, times: f64| Complex64::cis(TAU * times * breath.phase);
    let parts: [Complex64; PARTS] = [0.0, 1.0, 2.0].map(|times| {
        breaths.iter().map(|breath| signal(breath) * turned(breath, times)).sum::<Complex64>() / count
    });
    let left = |breath: &Correlated| {
        let explained = parts.iter().zip([0.0, -1.0, -2.0]).map(|(part, times)| part * turned(breath, times));
        (signal(breath) - explained.sum::<Complex64>()).norm_sqr()
    };
    let noise = breaths.iter().map(left).sum::<f64>() / (count - PARTS as f64);
    (parts[0], (noise / count).sqrt())
}
