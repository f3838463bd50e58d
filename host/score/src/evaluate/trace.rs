//! Curves of a few breaths, for plots.

use serde::{Deserialize, Serialize};
use shared::breath::period_s;
use shared::control::pid::{Pid, PidState};
use shared::control::{COMMAND_MAX, ControlLaw, Controller, Observation};
use shared::settings::Settings;
use shared::ventilator::opening;

use plant::bench::BenchConfig;
use ventilator::{BenchSource, Source, SourceError};

/// Number of breaths before the recorded ones, so that those do not start from rest.
const WARM_UP: usize = 1;

/// Curves of some breaths: columns of equal length, a row for every control tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BreathTrace {
    /// Time since the start of the first recorded breath, s.
    pub time_s: Vec<f64>,
    /// Target, cmH2O.
    pub target: Vec<f64>,
    /// True airway pressure, cmH2O.
    pub pressure: Vec<f64>,
    /// Pressure as measured by the sensor, cmH2O.
    pub measured: Vec<f64>,
    /// Command of the inspiratory valve, percent.
    pub u_in: Vec<f64>,
    /// Whether the expiratory valve is open.
    pub u_out: Vec<bool>,
}

impl BreathTrace {
    /// Points of one of its columns up to the time `until` in s.
    pub fn points(&self, column: &[f64], until: f64) -> Vec<(f64, f64)> {
        let both = self.time_s.iter().copied().zip(column.iter().copied());
        both.take_while(|(time, _)| *time < until).collect()
    }

    /// Command of the expiratory valve, percent: 0 or 100.
    pub fn u_out_percent(&self) -> Vec<f64> {
        self.u_out.iter().map(|open| opening(*open).into()).collect()
    }

    /// The residual as applied, percent: the command of each tick of an inspiration less that of the PID underneath; 0 in expirations.
    /// The PID's state is reset at each breath, so the measured pressures and the commands determine what it requested.
    pub fn residual(&self, pid: &Pid) -> Vec<f64> {
        let mut state = PidState::new();
        let ticks = self.measured.iter().zip(&self.target).zip(self.u_in.iter().zip(&self.u_out));
        ticks
            .map(|((measured, target), (command, expires))| {
                if *expires {
                    state = PidState::new();
                    return 0.0;
                }
                command - pid_under(pid, &mut state, *measured as f32, *target as f32, *command as f32)
            })
            .collect()
    }
}

/// The command of the PID under a residual, percent, in a tick in which `command` was applied.
fn pid_under(pid: &Pid, state: &mut PidState, pressure: f32, target: f32, command: f32) -> f64 {
    let seen = Observation { pressure, target, pip: target, peep: target, tick: 0, rise_ticks: 0 };
    // The integral waits while the command with the residual is saturated: a bounded command says no more of the residual.
    let extra = if command >= COMMAND_MAX {
        f32::MAX
    } else if command <= 0.0 {
        f32::MIN
    } else {
        let integral = state.integral;
        let mut alone = *state;
        pid.step(&mut alone, &seen, 0.0);
        command - (pid.gains().p * (target - pressure) + integral + alone.derivative)
    };
    f64::from(pid.step(state, &seen, extra).base)
}

/// Runs one unrecorded breath, then records `breaths`; `seed` is that of the sensor noise.
///
/// # Errors
/// Refused settings, a control period that the bench cannot run or a fault of the ventilator.
pub fn trace(
    bench: &BenchConfig,
    controller: &Controller,
    settings: &Settings,
    period_us: u32,
    seed: u64,
    breaths: usize,
) -> Result<BreathTrace, SourceError> {
    trace_after(WARM_UP, bench, controller, settings, period_us, seed, breaths)
}

/// Like [`trace`], after this number of unrecorded breaths.
///
/// # Errors
/// See [`trace`].
pub fn trace_after<C: ControlLaw + Clone>(
    warm_up: usize,
    bench: &BenchConfig,
    controller: &C,
    settings: &Settings,
    period_us: u32,
    seed: u64,
    breaths: usize,
) -> Result<BreathTrace, SourceError> {
    let mut source = BenchSource::new(bench, controller.clone(), settings, period_us, seed)?;
    trace_source_after(warm_up, &mut source, settings, breaths)
}

/// Like [`trace`], on any ventilator.
///
/// # Errors
/// See [`trace`].
pub fn trace_source(
    source: &mut dyn Source,
    settings: &Settings,
    breaths: usize,
) -> Result<BreathTrace, SourceError> {
    trace_source_after(WARM_UP, source, settings, breaths)
}

/// Like [`trace_after`], on any ventilator.
///
/// # Errors
/// See [`trace`].
pub fn trace_source_after<C>(
    warm_up: usize,
    source: &mut dyn Source<C>,
    settings: &Settings,
    breaths: usize,
) -> Result<BreathTrace, SourceError> {
    let period = f64::from(period_s(source.period_us()));
    let mut trace = BreathTrace::default();
    source.upcoming(&vec![*settings; warm_up + breaths])?;
    for _ in 0..warm_up {
        source.breath(settings, &mut |_| ())?;
    }
    for _ in 0..breaths {
        source.breath(settings, &mut |tick| {
            let sample = &tick.sample;
            let measured = f64::from(sample.pressure);
            trace.time_s.push(trace.time_s.len() as f64 * period);
            trace.target.push(f64::from(sample.target));
            trace.pressure.push(tick.truth.map_or(measured, |truth| f64::from(truth.airway_pressure)));
            trace.measured.push(measured);
            trace.u_in.push(f64::from(sample.u_in));
            trace.u_out.push(sample.u_out);
        })?;
    }
    Ok(trace)
}
