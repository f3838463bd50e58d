//! A physical simulator of many units: valve, circuit and lung by their equations, with a few numbers for each unit.
//!
//! A breath names its unit as its ventilator and, if the lung is another unit's, that one as its group.
//!
//! The structure is known; the numbers are learned from recordings of each unit, by the same open-loop rollouts as those of
//! the other simulators. An unrecorded unit is a new set of numbers, so families of units can be drawn
//! around the learned ones ([`spread`]).
//!
//! ```text
//! commands -> valve -> w               dead time, lag, play, dead zone, curve                 valve.rs
//! w -> circuit, lung -> p -> sensor    supply, expiratory valve as it closes, leak, R, C      lung.rs
//! ```
//!
//! The lag of the sensor is not learned: the pressures do not tell it from the lag of the valve, and a valve must keep its own when it
//! works on the lung of another unit.
//!
//! Each equation is written once over a [`Number`]: on lanes it gives the pressures, on a tape their
//! gradients, in a graph the exported file.

mod equations;
mod graph;
mod lung;
mod numbers;
pub mod spread;
mod valve;

use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use shared::settings::Settings;

use self::equations::{GIVEN, INPUTS, NUMBERS, SENSED, STATE, UnitEquations};
pub use self::numbers::{MACHINE_NUMBERS, UNIT_NUMBERS, UnitNumbers, scaled, valve_flows};
use super::block::Block;
use super::design::{Design, Dynamics};
use super::shape::{ShapeError, members, within};
use super::trajectory::Trajectory;
use super::{BreathStart, COMMAND_SCALE, CommandLog, Members, Timing};
use crate::graph::state::State;
use crate::graph::{Builder, Value};
use engine::number::Number;
use engine::{LANES, Lane};

/// Usual numbers of a unit, in the order of the parameters. Each parameter is the logarithm of its number.
const USUAL: [f32; PER_UNIT] = [
    12.0,  // dead time, ms
    25.0,  // lag, ms
    4.0,   // play, %
    4.0,   // dead zone, %
    1.3,   // exponent of the curve
    1.6,   // full flow, L/s
    150.0, // supply pressure, cmH2O
    20.0,  // R, cmH2O/(L/s)
    0.1,   // turbulence, s/L
    20.0,  // C, mL/cmH2O
    0.02,  // leak at 30 cmH2O, L/s
    1.5,   // compliance of the circuit, mL/cmH2O
    15.0,  // lag of the expiratory valve, ms
    0.4,   // orifice of the expiratory valve, L/s at 1 cmH2O
    4.0,   // lag of the sensor, ms
    3.0,   // resistance of the expiratory path, cmH2O/(L/s)
    35.0,  // upper inflection of the lung, cmH2O
];
/// Number of parameters of a unit.
pub const PER_UNIT: usize = 17;
/// Number of parameters of the valve; those of the lung follow.
const VALVE: usize = 7;
const MS_PER_S: f32 = 1e3;

/// Time in which the flow that is drawn out of a circuit rises, s.
const DRAWN_WITHIN_S: f32 = 0.2;
/// Longest phase of a breath that a file may have, ms.
const PHASE_MAX_MS: usize = 3_600_000;

/// Shape of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnitConfig {
    /// Division of time: one tick per block.
    pub timing: Timing,
    /// Number of units.
    pub units: usize,
    /// Inspiratory time of a breath of which nothing else is known, ms.
    pub inspiration_ms: u32,
    /// Its expiratory time, ms.
    pub expiration_ms: u32,
}

impl UnitConfig {
    /// The shape for a control period in microseconds and this number of units, in the paper's breaths.
    pub fn for_period(period_us: u32, units: usize) -> Self {
        Self::for_breaths(period_us, units, &Settings::default())
    }

    /// The shape in breaths with these settings.
    pub fn for_breaths(period_us: u32, units: usize, settings: &Settings) -> Self {
        let timing = Timing { period_us, block_ticks: 1, parts: 1, points: 1, channels: 1 };
        let ms = |seconds: f32| (1e3 * seconds).round() as u32;
        let breath_s = 60.0 / settings.rate;
        Self {
            timing,
            units,
            inspiration_ms: ms(settings.inspiratory_time),
            expiration_ms: ms(breath_s - settings.inspiratory_time),
        }
    }

    /// Inspiratory and expiratory time of the breaths, s.
    fn phases(&self) -> [f32; 2] {
        [self.inspiration_ms, self.expiration_ms].map(|ms| ms as f32 * 1e-3)
    }

    /// Initial parameters: usual numbers for every unit.
    pub fn initialise(&self) -> Vec<f32> {
        let usual = USUAL.map(f32::ln);
        (0..self.units).flat_map(|_| usual).collect()
    }
}

impl Design for UnitConfig {
    fn timing(&self) -> &Timing {
        &self.timing
    }

    fn parameters(&self) -> usize {
        self.units * PER_UNIT
    }

    fn members(&self) -> usize {
        self.units
    }

    fn many_lungs(&self) -> bool {
        self.units > 1
    }

    fn check(&self) -> Result<(), ShapeError> {
        self.timing.check()?;
        self.timing.check_single_ticks()?;
        members("units", self.units, 1)?;
        within("inspiration_ms", self.inspiration_ms as usize, 1, PHASE_MAX_MS)?;
        within("expiration_ms", self.expiration_ms as usize, 1, PHASE_MAX_MS)
    }

    fn initialise(&self, _rng: &mut ChaCha8Rng) -> Vec<f32> {
        UnitConfig::initialise(self)
    }

    fn dynamics(&self, parameters: &[f32], blocks: usize) -> Box<dyn Dynamics> {
        Box::new(Units {
            config: *self,
            parameters: parameters.to_vec(),
            machines: [None; LANES],
            lungs: [None; LANES],
            start: BreathStart::default(),
            dead_time: [0; LANES],
            trajectory: Trajectory::new(UnitEquations::new(self), blocks),
        })
    }

    fn graph(&self, graph: &mut Builder, block: &Block, parameters: &[f32]) -> (Value, State) {
        graph::unit(graph, block, self, parameters)
    }
}

/// The units with their parameters, and the forward values and backward gradients of a rollout.
#[derive(Debug)]
struct Units {
    config: UnitConfig,
    parameters: Vec<f32>,
    machines: Members,
    lungs: Members,
    start: BreathStart,
    /// Whole ticks of the dead time.
    dead_time: [usize; LANES],
    trajectory: Trajectory<UnitEquations, GIVEN, NUMBERS, STATE, INPUTS>,
}

/// Share of the way that is left after a tick, with this lag in ms.
fn left_after<Q: Number>(lag: Q, tick_s: f32) -> Q {
    (lag.constant(-MS_PER_S * tick_s) / lag).exp()
}

impl Units {
    /// Index of the first parameter of a lane's unit; the first unit's if it is not known.
    fn first(&self, member: Option<u32>) -> usize {
        let unit = member.map_or(0, |unit| unit as usize);
        if unit < self.config.units { unit * PER_UNIT } else { 0 }
    }

    /// A parameter of the unit in each lane.
    fn parameter(&self, n: usize) -> Lane {
        let members = if n < VALVE { &self.machines } else { &self.lungs };
        Lane::from_fn(|l| self.parameters[self.first(members[l]) + n])
    }

    /// Starts the breath from commands at rest: after them for long enough, the actuator has reached its
    /// command.
    fn start(&mut self, rest: &Lane) {
        let BreathStart { pressure, peep, plateau, phases, plateau_command, .. } = self.start;
        let [inspiration, expiration] = phases.unwrap_or_else(|| self.config.phases().map(Lane::splat));
        let [rest, before] = [*rest, plateau_command].map(|scaled| scaled.map(|u| COMMAND_SCALE * u));
        let known = [pressure, peep, plateau, inspiration, expiration, rest, before];
        let given =
            std::array::from_fn(|n| n.checked_sub(PER_UNIT).map_or_else(|| self.parameter(n), |n| known[n]));
        self.dead_time =
            self.trajectory.equations.dead_time(given[valve::DEAD_TIME]).0.map(|ticks| ticks as usize);
        self.trajectory.begin(&given);
    }

    /// Block of the command that is older than a lane's dead time by `age`; none before the breath.
    fn delayed(&self, block: usize, age: usize, l: usize) -> Option<usize> {
        block.checked_sub(self.dead_time[l] + age)
    }
}

impl Dynamics for Units {
    fn load(&mut self, parameters: &[f32]) {
        self.parameters.copy_from_slice(parameters);
    }

    fn begin(&mut self, start: &BreathStart) {
        self.machines = start.ventilator;
        self.lungs = std::array::from_fn(|l| start.group[l].or(start.ventilator[l]));
        self.start = *start;
    }

    fn step(&mut self, block: usize, log: &CommandLog, points: &mut [Lane]) {
        if block == 0 {
            self.start(&log.block(None)[0]);
        }
        let mut commands = [Lane::ZERO; 2];
        for (age, command) in commands.iter_mut().enumerate() {
            for l in 0..LANES {
                command[l] = COMMAND_SCALE * log.block(self.delayed(block, age, l))[0][l];
            }
        }
        let [newer, older] = commands;
        let risen = (block as f32 * self.config.timing.block_s() / DRAWN_WITHIN_S).min(1.0);
        let drawn = self.start.drawn.map(|share| risen * share);
        points[0] = self.trajectory.step(block, &[newer, older, self.start.peep, drawn])[SENSED];
    }

    fn step_back(&mut self, block: usize, d_points: &[Lane], d_log: &mut CommandLog) {
        let [newer, older, ..] = self.trajectory.step_back(block, SENSED, &d_points[0]);
        for (age, d) in [newer, older].iter().enumerate() {
            for l in 0..LANES {
                if let Some(at) = self.delayed(block, age, l) {
                    d_log.block_mut(at)[0][l] += COMMAND_SCALE * d[l];
                }
            }
        }
    }

    fn finish(&self, gradient: &mut [f32]) {
        let learned = |(n, _): &(usize, &Lane)| *n != VALVE + lung::SENSOR;
        for (n, d) in self.trajectory.gradient()[..PER_UNIT].iter().enumerate().filter(learned) {
            let members = if n < VALVE { &self.machines } else { &self.lungs };
            for (l, member) in members.iter().enumerate() {
                gradient[self.first(*member) + n] += d[l];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::model::Architecture;
    use crate::simulator::tests_support::check_gradients_in_steps;

    /// Units with a prompt valve, so that it closes within the few steps of a test, and lungs that stiffen.
    fn prompt() -> (UnitConfig, Vec<f32>) {
        let config = UnitConfig::for_period(10_000, 2);
        let mut parameters = config.initialise();
        for unit in parameters.chunks_exact_mut(PER_UNIT) {
            (unit[0], unit[1]) = (6.3_f32.ln(), 8.0_f32.ln());
            // The pressures of a test reach it.
            unit[VALVE + lung::INFLECTION] = 8.0_f32.ln();
        }
        for (n, parameter) in parameters.iter_mut().enumerate() {
            *parameter += 0.1 * (0.7 * n as f32).cos();
        }
        (config, parameters)
    }

    #[test]
    fn gradients_of_a_rollout_agree_with_finite_differences() {
        let (config, parameters) = prompt();
        let learned = |n: &usize| n % PER_UNIT != VALVE + lung::SENSOR;
        let places = (0..parameters.len()).filter(learned);
        check_gradients_in_steps(1e-3, places, Architecture::Unit(config), &parameters);
    }

    #[test]
    fn a_flow_that_is_drawn_out_of_the_circuit_lowers_the_pressure() {
        let (config, parameters) = prompt();
        let last = |drawn: f32| {
            let mut units = config.dynamics(&parameters, 40);
            let (pressure, drawn) = (Lane::splat(5.0), Lane::splat(drawn));
            units.begin(&BreathStart { pressure, plateau: pressure, drawn, ..BreathStart::default() });
            let mut log = CommandLog::new(40, vec![Lane::splat(0.1)]);
            let mut points = [Lane::ZERO];
            for block in 0..40 {
                log.block_mut(block).fill(Lane::splat(0.8));
                units.step(block, &log, &mut points);
            }
            points[0][0]
        };
        assert!(last(0.2) < last(0.1) - 1.0 && last(0.1) < last(0.0) - 1.0);
    }

    #[test]
    fn the_valve_of_a_unit_works_on_the_lung_of_another() {
        let (config, parameters) = prompt();
        let pressures = |ventilator: u32, group: Option<u32>| {
            let mut units = config.dynamics(&parameters, 40);
            let pressure = Lane::splat(5.0);
            let start = BreathStart {
                pressure,
                plateau: pressure,
                ventilator: [Some(ventilator); LANES],
                group: [group; LANES],
                ..BreathStart::default()
            };
            let mut log = CommandLog::new(40, vec![Lane::splat(0.1)]);
            let mut points = [Lane::ZERO];
            units.begin(&start);
            (0..40)
                .map(|block| {
                    log.block_mut(block).fill(Lane::splat(0.8));
                    units.step(block, &log, &mut points);
                    points[0][0]
                })
                .collect::<Vec<f32>>()
        };
        let own = pressures(0, None);
        assert_eq!(own, pressures(0, Some(0)));
        assert_ne!(own, pressures(0, Some(1)));
        assert_ne!(pressures(1, None), pressures(0, Some(1)), "the valve is the other's");
        assert!(own.last() > own.first() && own.iter().all(|p| (4.9..60.0).contains(p)), "{own:?}");
    }
}
