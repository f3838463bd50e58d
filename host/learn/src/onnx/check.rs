//! What this program computes for given inputs, so that the results of another runtime can be compared: inputs and outputs of an
//! exported graph, step by step.

use serde::Serialize;
use shared::breath::{period_s, rising};
use shared::control::memory::Lesson;
use shared::control::{ControlLaw, ControlOutput, Observation};

use super::controller::OBSERVATION;
use super::memory::lesson_number;
use super::simulator::START;
use crate::simulator::model::Simulator;
use crate::simulator::rollout::Rollout;
use crate::simulator::{BreathStart, COMMAND_SCALE};
use engine::{LANES, Lane};

/// Ticks of a breath's inspiration in a check, and breaths: enough to remember, to be surprised and to forget.
const TICKS: u32 = 700;
const BREATHS: u32 = 9;
/// Breath from which on the lung is another one, and the last breath, whose settings are new.
const CHANGED: u32 = 6;
/// Ticks of the breath of a simulator.
const SIMULATED: usize = 1000;
/// Command of the valve between two breaths, percent.
const REST: f32 = 5.0;

/// A step of a controller: a row of the input, and the commands; none after an inspiration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ControllerStep {
    /// Row of `observation`.
    pub observation: [f32; OBSERVATION.len()],
    /// The command and that of the PID alone, percent.
    pub commands: Option<[f32; 2]>,
}

/// Steps of a controller on an artificial lung, from rest.
pub fn controller<C: ControlLaw>(law: &C, period_us: u32) -> Vec<ControllerStep> {
    let (mut steps, mut state) = (Vec::new(), law.initial_state());
    for breath in 0..BREATHS {
        if breath + 1 == BREATHS {
            learn(law, &mut state, Lesson::Forget, 0.0, &mut steps);
        }
        let applied = breathe(law, &mut state, breath, period_us, &mut steps);
        let lesson = if breath == 2 { Lesson::Discard } else { Lesson::Adopt };
        learn(law, &mut state, lesson, applied, &mut steps);
    }
    steps
}

/// One inspiration; returns the last applied command, percent. The lung follows the command with a lag, the reading has a ripple, and
/// the applied command is not always the wanted one.
fn breathe<C: ControlLaw>(
    law: &C,
    state: &mut C::State,
    breath: u32,
    period_us: u32,
    steps: &mut Vec<ControllerStep>,
) -> f32 {
    let (pip, peep) = if breath + 1 == BREATHS { (30.0, 8.0) } else { (20.0, 5.0) };
    let gain = if breath >= CHANGED { 0.4 } else { 0.9 };
    let rise_ticks = TICKS / 10;
    let (mut pressure, mut applied) = (peep, REST);
    law.start_breath(state, applied);
    for tick in 0..TICKS {
        let phase = (tick + 17 * breath) as f32;
        let (measured, target) = (pressure + 0.1 * (1.3 * phase).sin(), rising(pip, peep, rise_ticks, tick));
        let seen = Observation { pressure: measured, target, pip, peep, tick, rise_ticks };
        let ControlOutput { base, command } = law.step(state, &seen);
        let [time, rise] = [tick, rise_ticks].map(|ticks| ticks as f32 * period_s(period_us));
        let observation = [measured, target, pip, peep, applied, time, -1.0, rise];
        steps.push(ControllerStep { observation, commands: Some([command, base]) });
        applied = (command + 5.0 * (0.05 * phase).sin()).clamp(0.0, 100.0);
        law.applied(state, applied);
        pressure += 0.02 * (peep + gain * applied - pressure);
    }
    applied
}

/// A lesson, in a step of its own.
fn learn<C: ControlLaw>(
    law: &C,
    state: &mut C::State,
    lesson: Lesson,
    applied: f32,
    steps: &mut Vec<ControllerStep>,
) {
    law.learn(state, lesson);
    let observation = [0.0, 0.0, 0.0, 0.0, applied, 0.0, lesson_number(lesson), 0.0];
    steps.push(ControllerStep { observation, commands: None });
}

/// A breath of a simulator: the state before it, the commands, percent, and the pressure after each of them, cmH2O.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SimulatedBreath {
    /// The row of `start`.
    pub start: [f32; START.len()],
    /// Number of ticks in a block.
    pub block_ticks: usize,
    /// Commands by tick.
    pub commands: Vec<f32>,
    /// Pressures by tick.
    pub pressures: Vec<f32>,
}

/// A breath of 1000 ticks of a simulator; `unit` as for [`super::simulator()`].
pub fn simulator(simulator: &Simulator, unit: Option<u32>) -> SimulatedBreath {
    let start = [simulator.start_pressure + 0.5, 6.0, 22.0, REST, 24.0, 35.0, 14.0];
    let [pressure, peep, plateau, rest, plateau_command, resistance, compliance] = start.map(Lane::splat);
    let scaled = |percent: Lane| percent.map(|percent| percent / COMMAND_SCALE);
    let before = BreathStart {
        pressure,
        peep,
        plateau,
        rest: scaled(rest),
        plateau_command: scaled(plateau_command),
        group: [None; LANES],
        ventilator: [unit; LANES],
        phases: None,
        drawn: Lane::ZERO,
        resistance,
        compliance,
    };
    let model = simulator.model();
    let mut rollout = Rollout::new(&model, SIMULATED);
    rollout.begin(&model, &before, &rest);
    let command = |tick: usize| {
        let time = tick as f32;
        (35.0 + 30.0 * (0.013 * time).sin() + 25.0 * (0.11 * time).sin()).clamp(0.0, 100.0)
    };
    let (mut commands, mut pressures) = (Vec::new(), Vec::new());
    for tick in 0..SIMULATED {
        commands.push(command(tick));
        rollout.advance(&Lane::splat(command(tick)));
        pressures.push(rollout.pressure()[0]);
    }
    SimulatedBreath { start, block_ticks: simulator.architecture.timing().block_ticks, commands, pressures }
}
