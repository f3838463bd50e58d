//! Frequency response of a closed loop by lock-in: pairs of runs with opposite sines, correlated with the sine over whole periods.
//!
//! Both runs of a pair start from the same state, with the same noise to come. Half of their difference is the response to the sine:
//! noise, drift and the even harmonics of a curved valve cancel.

use std::f64::consts::TAU;

use num_complex::Complex64;
use serde::{Deserialize, Serialize};
use shared::breath::period_s;
use shared::control::{COMMAND_MAX, ControlLaw, Observation};
use shared::math;

use super::injection::{InjectionState, Sine, SineInjection};
use tuning::response::ResponsePoint;

/// A plant that is held at an operating point.
pub trait Process: Clone {
    /// Runs one control period with the inspiratory valve at `command` percent; returns the pressure reading at its end, cmH2O.
    fn step(&mut self, command: f32) -> f32;
}

/// How a response is measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sweep {
    /// Amplitude of the sine in the command, percent.
    pub amplitude: f64,
    /// Lowest and highest frequency, Hz.
    pub range_hz: (f64, f64),
    /// Number of frequencies, spaced evenly by their logarithm.
    pub frequencies: usize,
    /// Shortest time that is correlated, s; it is extended to whole periods.
    pub window_s: f64,
    /// Least number of periods that are correlated.
    pub periods: u32,
    /// Time between the start of the sine and that of the correlation, s, and at least one period.
    pub transient_s: f64,
}

impl Default for Sweep {
    fn default() -> Self {
        Self {
            amplitude: 10.0,
            range_hz: (0.5, 40.0),
            frequencies: 32,
            window_s: 2.0,
            periods: 3,
            transient_s: 1.0,
        }
    }
}

impl Sweep {
    /// The same sweep with another amplitude, percent.
    #[must_use]
    pub fn with_amplitude(self, amplitude: f64) -> Self {
        Self { amplitude, ..self }
    }

    /// The sine at a place of the sweep: whole periods in whole ticks, close to the wanted frequency.
    fn sine(&self, place: usize, period_s: f64) -> Sine {
        let share = place as f64 / (self.frequencies.max(2) - 1) as f64;
        let wanted_hz = self.range_hz.0 * (self.range_hz.1 / self.range_hz.0).powf(share);
        let periods = ((self.window_s * wanted_hz).ceil() as u32).max(self.periods);
        let ticks = (f64::from(periods) / (wanted_hz * period_s)).round() as u32;
        Sine { amplitude: self.amplitude, ticks, periods }
    }
}

/// A loop at rest: a plant with its reading, and the law's state.
#[derive(Clone, Debug)]
pub struct Rest<P, S> {
    process: P,
    state: InjectionState<S>,
    seen: Observation,
}

/// A loop: a law, what it sees besides the pressure, and the control period.
#[derive(Clone, Copy, Debug)]
pub struct Loop<'a, C> {
    /// The law.
    pub law: &'a C,
    /// Target, PIP and PEEP; the pressure is that before the first tick.
    pub seen: Observation,
    /// Control period, microseconds.
    pub period_us: u32,
    /// Last tick of the breath that the law sees.
    pub held_tick: u32,
}

/// Fourier sums over the ticks of a window.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    before: Complex64,
    after: Complex64,
    pressure: Complex64,
    /// Ticks in which the command with the sine was limited.
    limited: u32,
}

impl<C: ControlLaw> Loop<'_, C>
where
    C::State: Clone,
{
    /// Lets a plant settle under the law for this time, s. Also returns the standard deviation of the pressure reading over the last
    /// quarter of it, cmH2O.
    pub fn settle<P: Process>(&self, process: P, time_s: f64) -> (Rest<P, C::State>, f64) {
        let none = Sine { amplitude: 0.0, ticks: 1, periods: 1 };
        let law = SineInjection::new(self.law, none, self.held_tick);
        let mut state = law.initial_state();
        law.start_breath(&mut state, 0.0);
        let mut rest = Rest { process, state, seen: self.seen };
        let ticks = (time_s / self.period_s()) as u32;
        let mut last = Vec::with_capacity(ticks as usize / 4 + 1);
        for tick in 0..ticks {
            advance(&law, &mut rest);
            if tick >= ticks / 4 * 3 {
                last.push(f64::from(rest.seen.pressure));
            }
        }
        let mean = last.iter().sum::<f64>() / last.len().max(1) as f64;
        let variance = last.iter().map(|p| (p - mean).powi(2)).sum::<f64>() / last.len().max(1) as f64;
        (rest, variance.sqrt())
    }

    /// Measures the response of a loop at rest. Also returns the share of the ticks in which the command reached the valve's limits.
    pub fn response<P: Process>(&self, rest: &Rest<P, C::State>, sweep: &Sweep) -> (Vec<ResponsePoint>, f64) {
        let (mut limited, mut ticks) = (0, 0);
        let points = (0..sweep.frequencies)
            .map(|place| {
                let sine = sweep.sine(place, self.period_s());
                let up = self.run(rest, sine, sweep);
                let down = self.run(rest, Sine { amplitude: -sine.amplitude, ..sine }, sweep);
                limited += up.limited + down.limited;
                ticks += 2 * sine.ticks;
                let before = up.before - down.before;
                let after = up.after - down.after;
                ResponsePoint {
                    hz: f64::from(sine.periods) / (f64::from(sine.ticks) * self.period_s()),
                    loop_gain: -before / after,
                    path: (up.pressure - down.pressure) / (after - before),
                }
            })
            .collect();
        (points, f64::from(limited) / f64::from(ticks.max(1)))
    }

    /// Runs one sine and correlates its window.
    fn run<P: Process>(&self, rest: &Rest<P, C::State>, sine: Sine, sweep: &Sweep) -> Sums {
        let law = SineInjection::new(self.law, sine, self.held_tick);
        let mut run = rest.clone();
        run.state = run.state.restarted();
        let transient = ((sweep.transient_s / self.period_s()) as u32).max(sine.ticks / sine.periods);
        let mut sums = Sums::default();
        for tick in 0..transient + sine.ticks {
            let asked = advance(&law, &mut run);
            if tick < transient {
                continue;
            }
            let turn = Complex64::cis(-sine.angle(tick));
            let add = |sum: &mut Complex64, value: f32| *sum += turn * f64::from(value);
            add(&mut sums.before, run.state.before);
            add(&mut sums.after, run.state.after);
            // The reading at the end of this tick is that of the next one.
            add(&mut sums.pressure, run.seen.pressure);
            sums.limited += u32::from(asked.to_bits() != run.state.after.to_bits());
        }
        // The pressure was sampled a tick later than the commands.
        let later = Complex64::cis(-TAU * f64::from(sine.periods) / f64::from(sine.ticks));
        sums.pressure *= later;
        sums
    }

    fn period_s(&self) -> f64 {
        f64::from(period_s(self.period_us))
    }
}

/// One tick; returns the command with the sine before the valve's limits.
fn advance<C: ControlLaw, P: Process>(law: &SineInjection<'_, C>, run: &mut Rest<P, C::State>) -> f32 {
    let asked = law.step(&mut run.state, &run.seen).command;
    let command = math::limit(asked, 0.0, COMMAND_MAX);
    law.applied(&mut run.state, command);
    run.seen.pressure = run.process.step(command);
    run.seen.tick = run.seen.tick.saturating_add(1);
    asked
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sines_are_whole_periods_in_whole_ticks_and_spaced_evenly_by_their_logarithm() {
        let sweep = Sweep::default();
        let sines: Vec<Sine> = (0..sweep.frequencies).map(|place| sweep.sine(place, 1e-3)).collect();
        let hz = |sine: &Sine| f64::from(sine.periods) / (f64::from(sine.ticks) * 1e-3);
        assert!((hz(&sines[0]) - 0.5).abs() < 1e-3 && (hz(&sines[31]) - 40.0).abs() < 0.05);
        for pair in sines.windows(2) {
            assert!((hz(&pair[1]) / hz(&pair[0]) - 80.0_f64.powf(1.0 / 31.0)).abs() < 0.003);
        }
        for sine in &sines {
            assert!(sine.periods >= sweep.periods && f64::from(sine.ticks) >= 0.998 * 1e3 * sweep.window_s);
            assert!((sine.amplitude - sweep.amplitude).abs() < 1e-12);
        }
        assert_eq!((sines[0].periods, sines[31].periods), (3, 80));
        assert!((sweep.with_amplitude(3.0).sine(0, 1e-3).amplitude - 3.0).abs() < 1e-12);
    }

    #[test]
    fn a_complex_number_is_a_pair_in_json() {
        let text = serde_json::to_string(&Complex64::new(1.5, -2.0)).unwrap();
        assert_eq!(text, "[1.5,-2.0]");
        assert_eq!(serde_json::from_str::<Complex64>(&text).unwrap(), Complex64::new(1.5, -2.0));
    }
}
