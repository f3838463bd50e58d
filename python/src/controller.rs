//! A controller of a device, stepped from Python.

use std::path::{Path, PathBuf};

use learn::controller::learned::Learned;
use learn::controller::shipped;
use numpy::PyArray1;
use pyo3::prelude::*;
use shared::control::memory::Lesson;
use shared::control::pid::Pid;
use shared::control::{ControlLaw, ControllerState, Observation};
use shared::math::ticks;
use shared::weights::decode;

use crate::{errors, values};

/// The lessons in the order of their numbers on the policy link.
const LESSONS: [Lesson; 3] = [Lesson::Adopt, Lesson::Discard, Lesson::Forget];

/// A PID, or a PID with a learned residual: the code of the chip.
#[pyclass(module = "eupnea", name = "Controller")]
pub struct Controller {
    pub law: shared::control::Controller,
    pub period_us: u32,
    name: String,
    state: ControllerState,
    tick: u32,
    /// Command of the last tick, percent, until it is known which command the valve had.
    pending: Option<f32>,
}

impl Controller {
    fn of(law: shared::control::Controller, period_us: u32, name: String) -> Self {
        Self { law, period_us, name, state: ControllerState::new(), tick: 0, pending: None }
    }

    /// Ends the last tick with the command that the valve had, percent; default: the computed one.
    fn end_tick(&mut self, applied: Option<f32>) {
        if let Some(command) = self.pending.take() {
            self.law.applied(&mut self.state, applied.unwrap_or(command));
        }
    }
}

/// The weights image of a shipped controller, of a file of weights, or of a trained controller.
fn image(path: &Path) -> PyResult<Vec<u8>> {
    if let Some(image) = path.to_str().and_then(shipped::image) {
        return Ok(image.to_vec());
    }
    if path.extension().is_some_and(|extension| extension == "bin") {
        return Ok(std::fs::read(path)?);
    }
    if path.extension().is_none() && !path.exists() {
        let names: Vec<_> = shipped::names().collect();
        let text =
            format!("there is no controller {}: name a file, or one of {}", path.display(), names.join(", "));
        return Err(errors::value(text));
    }
    Learned::load(path).and_then(|learned| learned.image()).map_err(|e| errors::of(&e))
}

#[pymethods]
impl Controller {
    /// A PID with these gains.
    #[staticmethod]
    #[pyo3(signature = (gains, *, period_us=values::PERIOD_US))]
    fn pid(gains: Vec<f32>, #[pyo3(from_py_with = values::whole)] period_us: u32) -> PyResult<Self> {
        let gains = values::gains(&gains)?;
        values::check_period(period_us)?;
        let pid = Pid::new(gains, period_us).map_err(|e| errors::of(&e))?;
        let name = format!("PID {},{},{}", gains.p, gains.i, gains.d);
        Ok(Self::of(shared::control::Controller::Pid(pid), period_us, name))
    }

    /// A learned controller: a shipped one by its name, a file of `trainer train`, or a weights image (`.bin`).
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        let image = decode(&image(&path)?).map_err(|e| errors::of(&e))?;
        let period_us = image.residual.spec().period_us;
        let name = path.display().to_string();
        Ok(Self::of(shared::control::Controller::Residual(image.residual), period_us, name))
    }

    #[getter]
    fn name(&self) -> String {
        self.name.clone()
    }

    #[getter]
    fn period_us(&self) -> u32 {
        self.period_us
    }

    /// Gains of the PID, or of the one underneath.
    #[getter]
    fn gains(&self) -> (f32, f32, f32) {
        let gains = self.law.pid().gains();
        (gains.p, gains.i, gains.d)
    }

    /// Forgets all breaths.
    fn reset(&mut self) {
        (self.state, self.tick, self.pending) = (ControllerState::new(), 0, None);
    }

    /// Starts a breath, with the valve at `command` percent; `learn` keeps what the last breath taught, unless a lesson was given.
    #[pyo3(signature = (command=0.0, *, learn=true))]
    fn start_breath(&mut self, command: f32, learn: bool) {
        let lesson = if learn { Lesson::Adopt } else { Lesson::Discard };
        self.end_tick(None);
        if self.tick > 0 {
            self.law.learn(&mut self.state, lesson);
        }
        self.law.start_breath(&mut self.state, command);
        self.tick = 0;
    }

    /// Ends an inspiration with a lesson, by its number; `applied` is the command that the valve had in the last tick, percent.
    #[pyo3(signature = (lesson, applied=None))]
    fn learn(
        &mut self,
        #[pyo3(from_py_with = values::whole)] lesson: usize,
        applied: Option<f32>,
    ) -> PyResult<()> {
        let unknown =
            || errors::value(format!("there is no lesson {lesson}: 0 adopts, 1 discards, 2 forgets"));
        let lesson = *LESSONS.get(lesson).ok_or_else(unknown)?;
        self.end_tick(applied);
        self.law.learn(&mut self.state, lesson);
        self.tick = 0;
        Ok(())
    }

    /// One tick of an inspiration whose target rises from PEEP to PIP within `rise_time`, s; `applied` is the command that the valve had
    /// in the tick before. Returns the command in percent.
    #[pyo3(signature = (pressure, target, *, pip=None, peep=None, rise_time=0.0, applied=None))]
    fn step(
        &mut self,
        pressure: f32,
        target: f32,
        pip: Option<f32>,
        peep: Option<f32>,
        rise_time: f32,
        applied: Option<f32>,
    ) -> f32 {
        self.end_tick(applied);
        let peep = peep.unwrap_or(shared::settings::Settings::default().peep);
        let rise_ticks = ticks(rise_time, self.period_us);
        let seen =
            Observation { pressure, target, pip: pip.unwrap_or(target), peep, tick: self.tick, rise_ticks };
        let command = self.law.step(&mut self.state, &seen).command;
        (self.pending, self.tick) = (Some(command), self.tick.saturating_add(1));
        command
    }

    /// A tick for each pressure and target; returns the commands in percent.
    #[pyo3(signature = (pressures, targets, *, pip=None, peep=None, rise_time=0.0))]
    fn __call__<'py>(
        &mut self,
        py: Python<'py>,
        pressures: Vec<f32>,
        targets: Vec<f32>,
        pip: Option<f32>,
        peep: Option<f32>,
        rise_time: f32,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        if pressures.len() != targets.len() {
            return Err(errors::value("pressures and targets need the same length"));
        }
        let ticks = pressures.into_iter().zip(targets);
        let commands: Vec<f32> =
            ticks.map(|(pressure, target)| self.step(pressure, target, pip, peep, rise_time, None)).collect();
        Ok(PyArray1::from_vec(py, commands))
    }

    fn __repr__(&self) -> String {
        format!("Controller({:?})", self.name)
    }
}
