//! The environment for reinforcement learning: one, or a batch that steps on several threads.

use std::sync::Arc;

use environment::{
    ActionKind, Choice, EnvironmentError, ObservationKind, ObservationStream, Outcomes, Plants, Reward,
    TaskConfig,
};
use numpy::{PyArray1, PyReadonlyArray1, PyReadwriteArray1, PyReadwriteArray2};
use plant::prescriptions::Prescriptions;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use shared::breath::Breath;
use shared::control::Observation;
use shared::device::KNOWN_GOOD;
use shared::explore::Exploration;
use shared::settings::FIELDS;
use ventilator::{SourceError, seeds};

use crate::bench::{Bench, Family};
use crate::{errors, values};

/// The exception for an error of an environment.
fn exception(error: &EnvironmentError) -> PyErr {
    match error {
        // A bench is refused because of its description or of the control period.
        EnvironmentError::Source(SourceError::Bench(_)) => errors::value(error),
        EnvironmentError::Ended | EnvironmentError::Source(_) | EnvironmentError::Threads { .. } => {
            errors::runtime(error)
        }
        _ => errors::value(error),
    }
}

/// The seeds of the sensor noise that a command of the trainer uses: `collect`, `evaluate` or `tune-pid` with this seed.
#[pyfunction]
pub fn noise_seeds(command: &str, #[pyo3(from_py_with = values::whole)] seed: u64) -> PyResult<Vec<u64>> {
    match command {
        "collect" => Ok(vec![seeds::collection(seed, 0)]),
        "evaluate" => Ok(seeds::evaluation(seed)),
        "tune-pid" => Ok(vec![seeds::tuning(seed)]),
        _ => Err(errors::value(format!("{command} has no noise: choose collect, evaluate or tune-pid"))),
    }
}

/// The prescriptions of this name or, without one, the usual ones of the plants with these changes.
fn prescribed(
    plants: &Plants,
    name: Option<&str>,
    pips: Option<Vec<f32>>,
    settings: Option<&Bound<'_, PyDict>>,
) -> PyResult<Prescriptions> {
    let Some(name) = name else {
        let usual = plants.usual();
        let settings = values::changed(usual.settings, settings)?;
        return Ok(Prescriptions { pips: pips.unwrap_or(usual.pips), settings, ..Prescriptions::default() });
    };
    if pips.is_some() || settings.is_some() {
        return Err(errors::value("prescriptions take the place of pips and settings: leave these out"));
    }
    plants.prescriptions(name).map_err(|e| errors::of(&e))
}

/// A validated task.
#[pyclass(module = "eupnea._native", name = "Task", frozen)]
pub struct Task {
    task: Arc<environment::Task>,
}

#[pymethods]
impl Task {
    #[new]
    #[pyo3(signature = (*, benches=None, family=None, prescriptions=None, pips=None, settings=None, breathing=false,
        period_us=values::PERIOD_US, hold=10, breaths=1, observation="ours", residual=None, reward=(1.0, 0.0, 0.0), monitors=true))]
    #[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
    fn new(
        benches: Option<Vec<PyRef<'_, Bench>>>,
        family: Option<PyRef<'_, Family>>,
        prescriptions: Option<&str>,
        pips: Option<Vec<f32>>,
        settings: Option<&Bound<'_, PyDict>>,
        breathing: bool,
        #[pyo3(from_py_with = values::whole)] period_us: u32,
        #[pyo3(from_py_with = values::whole)] hold: u32,
        #[pyo3(from_py_with = values::whole)] breaths: u32,
        observation: &str,
        residual: Option<(Option<Vec<f32>>, f32)>,
        reward: (f64, f64, f64),
        monitors: bool,
    ) -> PyResult<Self> {
        let plants = match (benches, family) {
            (Some(_), Some(_)) => return Err(errors::value("lungs and a family: choose one of them")),
            (_, Some(family)) => Plants::Family(Box::new(family.family.clone())),
            (Some(benches), None) => {
                Plants::Benches(benches.iter().map(|bench| bench.config.clone()).collect())
            }
            (None, None) => TaskConfig::default().plants,
        };
        let prescriptions = prescribed(&plants, prescriptions, pips, settings)?;
        let action = match residual {
            Some((gains, authority)) => {
                let gains = gains.map_or(Ok(KNOWN_GOOD), |gains| values::gains(&gains))?;
                ActionKind::Residual { gains, authority }
            }
            None => ActionKind::Valve,
        };
        let observation = ObservationKind::from_name(observation).map_err(|e| exception(&e))?;
        let reward = Reward { error: reward.0, effort: reward.1, overshoot: reward.2 };
        let config = TaskConfig {
            plants,
            prescriptions: Some(prescriptions),
            breathing,
            period_us,
            hold,
            breaths,
            observation,
            action,
            reward,
            monitors,
        };
        let task = environment::Task::new(config).map_err(|e| exception(&e))?;
        Ok(Self { task: Arc::new(task) })
    }

    /// Length of an observation.
    #[getter]
    fn observations(&self) -> usize {
        self.task.observations()
    }

    /// Steps of the longest episode.
    #[getter]
    fn steps(&self) -> u32 {
        self.task.steps()
    }
}

/// The observations of an environment, for an agent that was trained there and runs elsewhere.
#[pyclass(module = "eupnea._native", name = "Observer")]
pub struct Observer {
    stream: ObservationStream,
}

#[pymethods]
impl Observer {
    #[new]
    #[pyo3(signature = (kind="ours", period_us=values::PERIOD_US))]
    fn new(kind: &str, #[pyo3(from_py_with = values::whole)] period_us: u32) -> PyResult<Self> {
        let stream =
            ObservationKind::from_name(kind).and_then(|kind| ObservationStream::new(kind, period_us));
        Ok(Self { stream: stream.map_err(|e| exception(&e))? })
    }

    /// Starts a breath; the last command was `command` percent.
    fn start_breath(&mut self, command: f32) {
        self.stream.start_breath(command);
    }

    /// Observes a tick of an inspiration whose target rises to PIP within `rise_ticks`.
    #[pyo3(signature = (pressure, target, pip, peep, tick, rise_ticks=0))]
    #[expect(clippy::too_many_arguments, reason = "they are the columns of an observation")]
    fn see<'py>(
        &mut self,
        py: Python<'py>,
        pressure: f32,
        target: f32,
        pip: f32,
        peep: f32,
        #[pyo3(from_py_with = values::whole)] tick: u32,
        #[pyo3(from_py_with = values::whole)] rise_ticks: u32,
    ) -> Bound<'py, PyArray1<f32>> {
        let seen = Observation { pressure, target, pip, peep, tick, rise_ticks };
        PyArray1::from_slice(py, self.stream.see(&seen))
    }

    /// Records the command applied in the tick, percent.
    fn applied(&mut self, command: f32) {
        self.stream.applied(command);
    }
}

/// Scores of the last episode: the means over its breaths.
fn scores<'py>(py: Python<'py>, episode: &environment::Episode) -> PyResult<Bound<'py, PyDict>> {
    // The complete breaths of an aborted episode say too little.
    let unknown = episode.fault.is_some() || episode.scores.is_empty();
    let mean = score::evaluate::Score::mean(&episode.scores);
    let dict = PyDict::new(py);
    dict.set_item("number", episode.number)?;
    dict.set_item("plant", &episode.plant)?;
    dict.set_item("pip", episode.settings.pip)?;
    dict.set_item("steps", episode.steps)?;
    dict.set_item("breath_scores", episode.scores.iter().map(|score| score.score).collect::<Vec<_>>())?;
    for (name, value) in [
        ("score", mean.score),
        ("rise_ms", mean.rise_ms),
        ("overshoot", mean.overshoot),
        ("plateau_error", mean.plateau_error),
        ("late_error", mean.late_error),
        ("effort", mean.effort.total_variation),
    ] {
        dict.set_item(name, if unknown { f64::NAN } else { value })?;
    }
    dict.set_item("fault", episode.fault.map(|fault| format!("{fault:?}")))?;
    Ok(dict)
}

/// One environment.
#[pyclass(module = "eupnea._native", name = "Environment")]
pub struct Environment {
    environment: environment::Environment,
}

impl Environment {
    fn observation<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f32>> {
        PyArray1::from_slice(py, self.environment.observation())
    }
}

#[pymethods]
impl Environment {
    #[new]
    fn new(task: &Task, #[pyo3(from_py_with = values::whole)] seed: u64) -> Self {
        Self { environment: environment::Environment::new(task.task.clone(), seed) }
    }

    /// Starts an episode; returns its first observation.
    #[pyo3(signature = (seed=None, number=None, pip=None, noise=None))]
    fn reset<'py>(
        &mut self,
        py: Python<'py>,
        #[pyo3(from_py_with = values::whole_or_none)] seed: Option<u64>,
        #[pyo3(from_py_with = values::whole_or_none)] number: Option<u32>,
        pip: Option<f32>,
        #[pyo3(from_py_with = values::whole_or_none)] noise: Option<u64>,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        if let Some(seed) = seed {
            self.environment.seed(seed);
        }
        self.environment.reset_to(Choice { number, pip, noise }).map_err(|e| exception(&e))?;
        Ok(self.observation(py))
    }

    /// Runs one action; returns observation, reward and whether the episode ended.
    fn step<'py>(
        &mut self,
        py: Python<'py>,
        action: f32,
    ) -> PyResult<(Bound<'py, PyArray1<f32>>, f64, bool)> {
        let step = self.environment.step(action).map_err(|e| exception(&e))?;
        Ok((self.observation(py), step.reward, step.ended))
    }

    /// The episode that runs or has just ended.
    fn episode<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        scores(py, self.environment.episode())
    }

    /// Settings of the breaths of the running or the last episode, by name.
    fn settings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        for field in FIELDS {
            dict.set_item(field.name, field.value(&self.environment.episode().settings))?;
        }
        Ok(dict)
    }

    /// A perturbation as `collect` draws them, of this seed and the number of the episode: percent to add to the command of each tick.
    fn exploration<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = values::whole)] seed: u64,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let period_us = self.environment.task().config().period_us;
        let episode = self.environment.episode();
        let breath = Breath::new(&episode.settings, period_us).map_err(errors::value)?;
        let exploration = Exploration { seed: seeds::collection(seed, 0), ..Exploration::default() };
        let perturbation = exploration.perturbation(&breath, episode.number);
        let ticks = 0..breath.inspiration_ticks();
        Ok(PyArray1::from_iter(py, ticks.map(|tick| perturbation.at(tick, period_us))))
    }

    /// True pressure and target, cmH2O, and command, percent, of the running inspiration, or of the last one.
    fn inspiration<'py>(&self, py: Python<'py>) -> [Bound<'py, PyArray1<f64>>; 3] {
        self.environment.inspiration().map(|curve| PyArray1::from_vec(py, curve))
    }
}

/// Environments that step together.
#[pyclass(module = "eupnea._native", name = "Batch")]
pub struct Batch {
    batch: environment::Batch,
}

/// A buffer as a slice.
fn slice<'a, T: numpy::Element>(array: &'a mut PyReadwriteArray1<'_, T>) -> PyResult<&'a mut [T]> {
    array.as_slice_mut().map_err(errors::value)
}

#[pymethods]
impl Batch {
    #[new]
    fn new(
        task: &Task,
        #[pyo3(from_py_with = values::whole)] seed: u64,
        #[pyo3(from_py_with = values::whole)] count: usize,
        #[pyo3(from_py_with = values::whole)] threads: usize,
    ) -> PyResult<Self> {
        let batch = environment::Batch::new(&task.task, seed, count, threads).map_err(|e| exception(&e))?;
        Ok(Self { batch })
    }

    /// Starts an episode in every environment.
    fn reset<'py>(
        &mut self,
        py: Python<'py>,
        #[pyo3(from_py_with = values::whole_or_none)] seed: Option<u64>,
        mut observations: PyReadwriteArray2<'py, f32>,
        mut rewards: PyReadwriteArray1<'py, f64>,
        mut ended: PyReadwriteArray1<'py, bool>,
    ) -> PyResult<()> {
        let observations = observations.as_slice_mut().map_err(errors::value)?;
        let (rewards, ended) = (slice(&mut rewards)?, slice(&mut ended)?);
        let mut outcomes = Outcomes { observations, rewards, ended };
        py.detach(|| self.batch.reset(seed, &mut outcomes)).map_err(|e| exception(&e))
    }

    /// Runs one action in every environment, and starts those whose episodes ended with the step before.
    fn step<'py>(
        &mut self,
        py: Python<'py>,
        actions: PyReadonlyArray1<'py, f32>,
        mut observations: PyReadwriteArray2<'py, f32>,
        mut rewards: PyReadwriteArray1<'py, f64>,
        mut ended: PyReadwriteArray1<'py, bool>,
    ) -> PyResult<()> {
        let actions = actions.as_slice().map_err(errors::value)?;
        let observations = observations.as_slice_mut().map_err(errors::value)?;
        let (rewards, ended) = (slice(&mut rewards)?, slice(&mut ended)?);
        let mut outcomes = Outcomes { observations, rewards, ended };
        py.detach(|| self.batch.step(actions, &mut outcomes)).map_err(|e| exception(&e))
    }

    /// The episode of one environment that runs or has just ended.
    fn episode<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = values::whole)] index: usize,
    ) -> PyResult<Bound<'py, PyDict>> {
        match self.batch.environments().get(index) {
            Some(environment) => scores(py, environment.episode()),
            None => Err(errors::value(format!("there is no environment {index}"))),
        }
    }
}
