//! Operating points on a bench: a plateau at which the valve is open for as long as the measurement takes.
//!
//! At the end of a long inspiration the lung is full and the valve almost closed: a sine would be cut, and the margins would look
//! large although nothing is controlled. Within a breath the valve is open, but an inspiration is too short for whole periods of a
//! slow sine. So the plateau is held with the mean flow of an inspiration, which is drawn out of the circuit whatever its pressure:
//! a constant flow changes neither the lung's impedance nor the valve's, and the valve works where it works in a breath. The
//! ventilator's monitors would end such a breath; therefore bench and control law run without them.

use serde::{Deserialize, Serialize};
use shared::breath::{DEFAULT_PERIOD_US, PAPER_PIPS, paper_settings};
use shared::control::Observation;
use shared::control::pid::{Pid, PidState};
use shared::settings::Settings;

use super::response::Process;
use plant::bench::{Bench, BenchConfig, BenchError, steps_per_period};

/// Flows of the operating points as shares of the valve's full flow: below, the sine would close the valve; above, it would
/// reach the valve's end.
const FLOW_SHARES: (f64, f64) = (0.1, 0.6);
/// Time of an inspiration at which the law's clock stops, s: in the middle, where the flow is near its mean.
pub const HELD_AT_S: f64 = 0.5;

/// A bench whose expiratory valve stays closed.
#[derive(Clone, Debug)]
pub struct HeldBench {
    bench: Bench,
    steps: u32,
}

impl Process for HeldBench {
    fn step(&mut self, command: f32) -> f32 {
        let mut pressure = f32::NAN;
        for _ in 0..self.steps {
            pressure = self.bench.step(command, false);
        }
        pressure
    }
}

/// Where a loop is measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OperatingPoint {
    /// PIP, cmH2O.
    pub pip: f32,
    /// PEEP, cmH2O.
    pub peep: f32,
    /// Flow through the valve, L/s.
    pub flow_l_s: f64,
}

impl OperatingPoint {
    /// The operating points of the paper's six waveforms on a bench.
    ///
    /// # Errors
    /// A bench that cannot be built.
    pub fn of_paper(config: &BenchConfig) -> Result<Vec<Self>, BenchError> {
        PAPER_PIPS.into_iter().map(|pip| Self::new(config, &paper_settings(pip))).collect()
    }

    /// The operating point of a prescription, on its plateau: its flow is the mean of an inspiration with a square rise under the
    /// default PID.
    ///
    /// # Errors
    /// A bench that cannot be built.
    pub fn new(config: &BenchConfig, settings: &Settings) -> Result<Self, BenchError> {
        let Settings { pip, peep, .. } = *settings;
        let pid = Pid::known_good(DEFAULT_PERIOD_US);
        let (mut bench, mut state) = (Bench::new(config, peep, 0)?, PidState::new());
        let mut pressure = peep;
        let before_ml = bench.truth().lung_volume_ml;
        let ticks = (f64::from(settings.inspiratory_time) * 1e6 / f64::from(DEFAULT_PERIOD_US)) as u32;
        for tick in 0..ticks {
            let seen = Observation { pressure, target: pip, pip, peep, tick, rise_ticks: 0 };
            pressure = bench.step(pid.step(&mut state, &seen, 0.0).command, false);
        }
        let taken_ml = bench.truth().lung_volume_ml - before_ml;
        let mean = 1e-3 * taken_ml / f64::from(settings.inspiratory_time);
        let full = config.full_flow_l_per_s();
        Ok(Self { pip, peep, flow_l_s: mean.clamp(FLOW_SHARES.0 * full, FLOW_SHARES.1 * full) })
    }

    /// The bench at PEEP, with the flow drawn out of its circuit; `seed` is that of the sensor noise.
    ///
    /// # Errors
    /// A bench that cannot be built, or a control period that it cannot run.
    pub fn bench(&self, config: &BenchConfig, period_us: u32, seed: u64) -> Result<HeldBench, BenchError> {
        let steps = steps_per_period(period_us)?;
        let mut bench = Bench::new(config, self.peep, seed)?;
        bench.draw(self.flow_l_s);
        Ok(HeldBench { bench, steps })
    }

    /// What a law sees at this point.
    pub fn observation(&self) -> Observation {
        let Self { pip, peep, .. } = *self;
        Observation { pressure: peep, target: pip, pip, peep, tick: 0, rise_ticks: 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::control::COMMAND_MAX;

    #[test]
    fn the_flow_is_the_mean_of_an_inspiration_within_the_valves_range() {
        let flow = |r, c, pip| {
            OperatingPoint::new(&BenchConfig::paper(r, c), &paper_settings(pip)).unwrap().flow_l_s
        };
        // 20 mL/cmH2O x 15 cmH2O in 1 s, of which 92 % enter within 2.5 time constants.
        let mean = flow(20.0, 20.0, 20.0);
        assert!(mean > 0.25 && mean < 0.29, "{mean}");
        let full = BenchConfig::default().full_flow_l_per_s();
        assert!((flow(50.0, 10.0, 10.0) - 0.1 * full).abs() < 1e-12);
        assert!((flow(5.0, 50.0, 35.0) - 0.6 * full).abs() < 1e-12);
    }

    #[test]
    fn the_valve_stays_open_at_the_plateau() {
        let point = OperatingPoint::new(&BenchConfig::default(), &paper_settings(20.0)).unwrap();
        let mut held = point.bench(&BenchConfig::default(), DEFAULT_PERIOD_US, 1).unwrap();
        let pid = Pid::known_good(DEFAULT_PERIOD_US);
        let (mut state, mut seen) = (PidState::new(), point.observation());
        for _ in 0..15_000 {
            let command = pid.step(&mut state, &seen, 0.0).command;
            assert!(command < COMMAND_MAX);
            seen.pressure = held.step(command);
        }
        let truth = held.bench.truth();
        assert!((truth.airway_pressure - 20.0).abs() < 1.0, "{truth:?}");
        assert!((truth.flow_valve - point.flow_l_s).abs() < 0.15 * point.flow_l_s, "{truth:?}");
    }

    #[test]
    fn a_control_period_of_several_steps_holds_the_command() {
        let (plant, point) = (BenchConfig::default(), OperatingPoint { pip: 20.0, peep: 5.0, flow_l_s: 0.2 });
        let mut fine = point.bench(&plant, 1000, 1).unwrap();
        let mut coarse = point.bench(&plant, 3000, 1).unwrap();
        for command in [30.0, 60.0, 10.0] {
            let readings = [0; 3].map(|_| fine.step(command));
            assert_eq!(coarse.step(command).to_bits(), readings[2].to_bits());
        }
        assert!(point.bench(&plant, 1500, 1).is_err());
    }
}
