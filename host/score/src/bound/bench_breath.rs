//! The bench under a known command sequence: its periodic state, and the score of an inspiration.

use shared::breath::{Breath, Phase};
use shared::settings::Settings;

use super::BoundError;
use crate::evaluate::{Score, score_breath};
use plant::bench::{Bench, BenchConfig, STEP_S, steps_per_period};
use ventilator::SourceError;

/// Change of the alveolar pressure from breath to breath below which the bench counts as periodic, cmH2O.
const PERIODIC_CMH2O: f64 = 1e-4;
/// Limit on the breaths until the bench counts as periodic; enough for a lung that empties by a tenth per breath.
const MOST_BREATHS: usize = 100;

/// Largest difference between the lengths of a breath and of the interval between efforts, as a share.
const PHASE_SLIP: f64 = 1e-9;

/// Length of a breath in whole control periods, s.
pub(super) fn length_s(breath: &Breath) -> f64 {
    f64::from(breath.total_ticks()) * f64::from(breath.period_us()) * 1e-6
}

/// One waveform on one bench.
#[derive(Clone, Debug)]
pub(super) struct BenchBreath {
    pub(super) breath: Breath,
    steps_per_tick: u32,
    rest: Bench,
    /// The bench at the beginning of the inspiration, whatever its commands; none if the breath is one of many with the same commands.
    begun: Option<Bench>,
    /// Target at every tick of the inspiration, cmH2O.
    pub(super) target: Vec<f64>,
}

impl BenchBreath {
    /// The waveform of `settings` at a control period on a bench at rest. Efforts of its patient begin `delay_ms` before
    /// each inspiration.
    pub(super) fn new(
        config: &BenchConfig,
        settings: &Settings,
        period_us: u32,
        delay_ms: u32,
    ) -> Result<Self, BoundError> {
        let steps_per_tick = steps_per_period(period_us).map_err(SourceError::from)?;
        let breath = Breath::new(settings, period_us).map_err(SourceError::from)?;
        // The search uses no sensor: the seed of their noise is irrelevant, and without the two that can be absent the
        // bench runs 2 % faster.
        let mut config = config.clone();
        (config.outlet_sensor.present, config.flow_sensor.present) = (false, false);
        let mut rest = Bench::new(&config, settings.peep, 0).map_err(SourceError::from)?;
        if config.patient.effort_cmh2o > 0.0 {
            let per_breath = config.patient.effort_rate_per_min * length_s(&breath) / 60.0;
            if (per_breath - 1.0).abs() > PHASE_SLIP {
                return Err(BoundError::OtherRate { name: config.name, rate: 60.0 / length_s(&breath) });
            }
            for _ in 0..delay_ms {
                rest.step(settings.expiratory_bias, true);
            }
        }
        let target = (0..breath.inspiration_ticks()).map(|tick| f64::from(breath.target(tick))).collect();
        Ok(Self { breath, steps_per_tick, rest, begun: None, target })
    }

    /// Number of control ticks of the inspiration.
    pub(super) fn ticks(&self) -> usize {
        self.target.len()
    }

    /// Control period, ms.
    pub(super) fn tick_ms(&self) -> f64 {
        f64::from(self.steps_per_tick) * STEP_S * 1e3
    }

    /// Runs one control tick of the inspiration; returns the true airway pressure at its beginning, cmH2O.
    pub(super) fn tick(&self, bench: &mut Bench, u_in: f32) -> f64 {
        let pressure = bench.airway_pressure();
        for _ in 0..self.steps_per_tick {
            bench.step(u_in, false);
        }
        pressure
    }

    /// Pressure at every tick of the inspiration from `start` under `commands`, cmH2O.
    pub(super) fn inspire(&self, start: &Bench, commands: &[f32]) -> Vec<f64> {
        let mut bench = start.clone();
        commands.iter().map(|u_in| self.tick(&mut bench, *u_in)).collect()
    }

    /// The bench at the beginning of an inspiration, after enough breaths with `commands` to make it periodic. Between
    /// inspirations the valves are set as the ventilator sets them.
    pub(super) fn periodic(&self, commands: &[f32]) -> Bench {
        match &self.begun {
            Some(begun) => begun.clone(),
            None => self.after(MOST_BREATHS, |_| commands.to_vec()),
        }
    }

    /// The same breath with the bench of the one with this number from rest, from 1. `commands` are those of a breath on a bench at its
    /// beginning.
    pub(super) fn at_breath(&self, number: u32, commands: impl Fn(&Bench) -> Vec<f32>) -> Self {
        let earlier = number.saturating_sub(1) as usize;
        Self { begun: Some(self.after(earlier, commands)), ..self.clone() }
    }

    /// The bench after this number of breaths from rest, or fewer if it is periodic by then.
    fn after(&self, breaths: usize, commands: impl Fn(&Bench) -> Vec<f32>) -> Bench {
        let mut bench = self.rest.clone();
        for _ in 0..breaths {
            let before = bench.truth().alveolar_pressure;
            let commands = commands(&bench);
            self.run_breath(&mut bench, &commands);
            if (bench.truth().alveolar_pressure - before).abs() < PERIODIC_CMH2O {
                break;
            }
        }
        bench
    }

    fn run_breath(&self, bench: &mut Bench, commands: &[f32]) {
        for u_in in commands {
            self.tick(bench, *u_in);
        }
        let bias = self.breath.settings().expiratory_bias;
        for tick in self.breath.inspiration_ticks()..self.breath.total_ticks() {
            let u_in = if self.breath.phase(tick) == Phase::Expiration { bias } else { 0.0 };
            for _ in 0..self.steps_per_tick {
                bench.step(u_in, true);
            }
        }
    }

    /// The score that an evaluation gives to this pressure.
    pub(super) fn score(&self, pressure: &[f64]) -> Score {
        let period_s = f64::from(self.breath.period_s());
        score_breath(self.breath.settings(), period_s, pressure, &self.target)
    }
}
