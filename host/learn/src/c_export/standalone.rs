//! The controller as the C file runs it: the core's controller and its limits, without a supervisor. The C file must give its bits.

use shared::breath::{Breath, Phase};
use shared::control::memory::{Lesson, outlasts};
use shared::control::residual::Residual;
use shared::control::{COMMAND_MAX, ControlLaw, ControlOutput, Controller, ControllerState, Observation};
use shared::math;
use shared::safety::slew::Slew;
use shared::sensor::HIGHEST_PRESSURE;
use shared::settings::{Settings, SettingsError};

/// A controller between limits of its own.
#[derive(Clone, Debug)]
pub struct Standalone {
    controller: Controller,
    period_us: u32,
    slew: Slew,
}

/// State of a [`Standalone`].
#[derive(Clone, Debug)]
pub struct StandaloneState {
    controller: ControllerState,
    breath: Option<Breath>,
    tick: u32,
    /// Whether something has disturbed the running inspiration; none after it.
    disturbed: Option<bool>,
    /// Whether the pressure limit has ended the inspiration.
    cut: bool,
    last_command: f32,
    /// Learned part of the last command, percent.
    learned: f32,
}

/// Command of one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Opening of the inspiratory valve, percent.
    pub u_in: f32,
    /// Whether the expiratory valve is open.
    pub u_out: bool,
    /// Target pressure, cmH2O.
    pub target: f32,
}

impl Command {
    const fn safe(target: f32) -> Self {
        Self { u_in: 0.0, u_out: true, target }
    }
}

impl Standalone {
    /// The controller between its limits.
    pub fn new(residual: &Residual) -> Self {
        let period_us = residual.spec().period_us;
        Self { controller: Controller::Residual(residual.clone()), period_us, slew: Slew::new(period_us) }
    }

    /// A state without a breath and with nothing remembered.
    pub fn initial_state(&self) -> StandaloneState {
        StandaloneState {
            controller: self.controller.initial_state(),
            breath: None,
            tick: 0,
            disturbed: None,
            cut: false,
            last_command: 0.0,
            learned: 0.0,
        }
    }

    /// Starts a breath.
    ///
    /// # Errors
    /// Settings that are refused by [`Breath::new`]; the running breath goes on.
    pub fn start_breath(
        &self,
        state: &mut StandaloneState,
        settings: &Settings,
    ) -> Result<(), SettingsError> {
        let breath = Breath::new(settings, self.period_us)?;
        if state.disturbed.is_some() {
            self.controller.learn(&mut state.controller, Lesson::Discard);
        }
        if !state.breath.is_some_and(|old| outlasts(old.settings(), settings)) {
            self.controller.learn(&mut state.controller, Lesson::Forget);
        }
        state.breath = Some(breath);
        (state.tick, state.disturbed, state.cut) = (0, Some(false), false);
        self.controller.start_breath(&mut state.controller, state.last_command);
        Ok(())
    }

    /// One tick with the airway pressure in cmH2O.
    pub fn step(&self, state: &mut StandaloneState, pressure: f32) -> Command {
        let Some(breath) = state.breath else { return Command::safe(0.0) };
        let moment = breath.at(state.tick);
        let settings = moment.settings();
        let sound = pressure.abs() <= HIGHEST_PRESSURE;
        state.cut |= moment.inspires() && sound && pressure > settings.pressure_limit;
        let (phase, target) = match moment.phase {
            Phase::Inspiration if state.cut => (Phase::Fall, settings.peep),
            phase => (phase, moment.target()),
        };
        if let Some(disturbed) = &mut state.disturbed {
            *disturbed |= state.cut || !sound;
            if phase != Phase::Inspiration {
                let lesson = if *disturbed { Lesson::Discard } else { Lesson::Adopt };
                self.controller.learn(&mut state.controller, lesson);
                state.disturbed = None;
            }
        }
        let command = if sound {
            let output = match phase {
                Phase::Inspiration => {
                    self.controller.step(&mut state.controller, &Observation::at(&moment, pressure))
                }
                Phase::Fall => ControlOutput::plain(0.0),
                Phase::Expiration => ControlOutput::plain(settings.expiratory_bias),
            };
            let (u_in, _) = self.slew.step(&mut state.learned, output, true);
            let u_in = math::limit(u_in, 0.0, COMMAND_MAX);
            if phase == Phase::Inspiration {
                self.controller.applied(&mut state.controller, u_in);
            }
            Command { u_in, u_out: phase != Phase::Inspiration, target }
        } else {
            state.learned = 0.0;
            Command::safe(target)
        };
        state.last_command = command.u_in;
        state.tick = state.tick.saturating_add(1);
        command
    }
}

impl StandaloneState {
    /// The breath; none before the first one.
    pub fn breath(&self) -> Option<&Breath> {
        self.breath.as_ref()
    }

    /// Tick of the breath, from 0.
    pub fn tick(&self) -> u32 {
        self.tick
    }

    /// Whether the breath has lasted its time.
    pub fn is_due(&self) -> bool {
        self.breath.is_none_or(|breath| self.tick >= breath.total_ticks())
    }

    /// Lets the running inspiration be left out of the memory.
    pub fn disturb(&mut self) {
        self.disturbed = self.disturbed.map(|_| true);
    }
}
