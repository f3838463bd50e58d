//! The nominal machine as a model-based law knows it: the inspiratory valve forwards, from commands to flow, and inverted, from flow to
//! the travel of its stem.
//!
//! A law gets the values of the machine's type, as its maker states them, and the usual lung on that type. The unit and the lung that
//! it controls differ from them.

use plant::bench::{BenchConfig, ValveConfig};
use shared::breath::period_s;
use shared::control::COMMAND_MAX;
use shared::math;

use super::lung::Lung;

/// Nominal values of a machine, in the units of the control law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Machine {
    /// Time in which a command has no effect, s.
    pub dead_time_s: f32,
    /// Time constant of the valve's actuator, s.
    pub lag_s: f32,
    /// Backlash between actuator and stem, percent.
    pub play: f32,
    dead_zone: f32,
    exponent: f32,
    full_flow: f32,
    supply: f32,
    /// Loss of pressure in the blower per square of the flow, cmH2O/(L/s)^2; zero without one.
    drop: f32,
    /// Compliance of the circuit, mL/cmH2O.
    pub circuit: f32,
    /// The usual lung on such a machine.
    pub usual: Lung,
}

impl Machine {
    /// The machine of a nominal bench: its valve and circuit, and its lung as the usual one; nothing of `[unit]`.
    pub fn of(bench: &BenchConfig) -> Self {
        let lung = &bench.lung.first;
        let ValveConfig {
            dead_time_ms,
            lag_ms,
            backlash_percent,
            dead_zone_percent,
            curve_exponent,
            max_flow_l_per_s,
            supply_pressure_cmh2o,
        } = bench.valve;
        Self {
            dead_time_s: (1e-3 * dead_time_ms) as f32,
            lag_s: (1e-3 * lag_ms) as f32,
            play: backlash_percent as f32,
            dead_zone: dead_zone_percent as f32,
            exponent: curve_exponent as f32,
            full_flow: max_flow_l_per_s as f32,
            supply: supply_pressure_cmh2o as f32,
            drop: bench.blower.map_or(0.0, |blower| blower.drop_cmh2o_per_l2_s2 as f32),
            circuit: bench.circuit.compliance_ml_per_cmh2o as f32,
            usual: Lung {
                resistance: lung.resistance_cmh2o_per_l_s as f32,
                compliance: lung.compliance_ml_per_cmh2o as f32,
            },
        }
    }

    /// Pressure that drives a flow against a pressure, cmH2O.
    fn drive(&self, pressure: f32) -> f32 {
        (self.supply - pressure).max(0.01 * self.supply)
    }

    /// Flow of the fully open valve alone against a pressure in cmH2O, L/s.
    fn full_flow(&self, pressure: f32) -> f32 {
        self.full_flow * (self.drive(pressure) / self.supply).sqrt()
    }

    /// Flow through the valve at a travel of its stem in percent, against a pressure in cmH2O, L/s.
    pub fn flow(&self, stem: f32, pressure: f32) -> f32 {
        let open = (stem - self.dead_zone) / (COMMAND_MAX - self.dead_zone);
        let alone = self.full_flow(pressure) * math::limit(open, 0.0, 1.0).powf(self.exponent);
        // The losses of valve and blower add up.
        alone / (1.0 + self.drop * alone * alone / self.drive(pressure)).sqrt()
    }

    /// Position of the stem after the actuator has moved, percent: closing, it lags by the play, near the seat by less.
    pub fn follow(&self, stem: f32, actuator: f32) -> f32 {
        math::limit(stem, actuator, actuator + self.play.min(actuator))
    }

    /// Travel of the stem in percent that gives a flow in L/s against a pressure in cmH2O: the end of the dead zone for no flow, full
    /// travel for a flow that the valve does not reach.
    pub fn stem(&self, flow: f32, pressure: f32) -> f32 {
        let left = 1.0 - self.drop * flow * flow / self.drive(pressure);
        let alone = if left > 0.0 { flow / left.sqrt() } else { f32::INFINITY };
        let share = math::limit(alone / self.full_flow(pressure), 0.0, 1.0);
        self.dead_zone + (COMMAND_MAX - self.dead_zone) * share.powf(1.0 / self.exponent)
    }
}

/// A valve that follows commands in the model, to estimate the flow that they caused.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelValve {
    /// Commands that have not taken effect, the oldest at `oldest`.
    delayed: Vec<f32>,
    oldest: usize,
    actuator: f32,
    stem: f32,
}

impl ModelValve {
    /// A closed valve.
    pub fn closed(machine: &Machine, period_us: u32) -> Self {
        let ticks = (machine.dead_time_s / period_s(period_us)).round() as usize;
        Self { delayed: vec![0.0; ticks], ..Self::default() }
    }

    /// Takes the command of a tick in percent; returns the mean flow over the tick against a pressure in cmH2O, L/s.
    pub fn advance(&mut self, machine: &Machine, period_us: u32, command: f32, pressure: f32) -> f32 {
        let due = match self.delayed.get_mut(self.oldest) {
            Some(place) => std::mem::replace(place, command),
            None => command,
        };
        self.oldest = if self.oldest + 1 < self.delayed.len() { self.oldest + 1 } else { 0 };
        self.actuator += math::lag_factor(machine.lag_s, period_s(period_us)) * (due - self.actuator);
        self.stem = machine.follow(self.stem, self.actuator);
        machine.flow(self.stem, pressure)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plant::bench::Bench;
    use plant::bench::family::Family;
    use shared::breath::DEFAULT_PERIOD_US;

    fn machine() -> Machine {
        Machine::of(&BenchConfig::default())
    }

    #[test]
    fn the_usual_lung_is_that_of_the_nominal_bench() {
        let usual = |name: &str| Machine::of(&Family::find(name).unwrap().nominal()).usual;
        assert_eq!(usual("adult"), machine().usual);
        assert!(usual("neonate").compliance < 0.5 * usual("adult").compliance);
    }

    #[test]
    fn the_inverse_of_the_valve_gives_back_the_flow() {
        for (machine, end_of_dead_zone, most) in [(machine(), 4.0, 1.2), (blower_machine().0, 22.0, 0.9)] {
            for flow in [0.0, 0.01, 0.3, most] {
                assert!((machine.flow(machine.stem(flow, 20.0), 20.0) - flow).abs() < 1e-4, "{flow}");
            }
            assert!((machine.stem(99.0, 20.0) - 100.0).abs() < 1e-4);
            let at_rest = machine.stem(-1.0, 20.0);
            assert!(
                (at_rest - end_of_dead_zone).abs() < 1e-4,
                "no flow keeps the stem at the dead zone's end"
            );
        }
    }

    fn blower_machine() -> (Machine, BenchConfig) {
        let bench = Family::find("blower").unwrap().nominal();
        (Machine::of(&bench), bench)
    }

    #[test]
    fn the_model_follows_the_valve_of_the_nominal_bench() {
        follows_the_valve(&machine(), &BenchConfig::paper(20.0, 20.0));
    }

    #[test]
    fn the_model_follows_the_valve_of_a_blower_at_its_speed() {
        let (machine, mut bench) = blower_machine();
        bench.blower.as_mut().unwrap().sag_percent_per_l_per_s = 0.0;
        follows_the_valve(&machine, &bench);
    }

    fn follows_the_valve(machine: &Machine, config: &BenchConfig) {
        let mut bench = Bench::new(config, 5.0, 1).unwrap();
        let mut model = ModelValve::closed(machine, DEFAULT_PERIOD_US);
        for tick in 0..600 {
            let command = if tick < 100 { 60.0 } else { 25.0 - 0.02 * tick as f32 };
            let pressure = bench.truth().airway_pressure as f32;
            let flow = model.advance(machine, DEFAULT_PERIOD_US, command, pressure);
            bench.step(command, false);
            let truth = bench.truth().flow_valve;
            assert!((f64::from(flow) - truth).abs() < 0.03, "tick {tick}: {flow}, not {truth}");
        }
    }
}
