//! A learned simulator: roll-outs and their gradients over batches of commands.

use std::path::PathBuf;

use engine::{LANES, Lane};
use learn::simulator::model::Model;
use learn::simulator::rollout::Rollout;
use learn::simulator::{BreathStart, COMMAND_SCALE};
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray2, PyUntypedArrayMethods, ndarray::Array2};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use shared::settings::Settings;

use crate::errors;

/// Ticks of the longest roll-out: a minute at 1 ms.
const TICKS_MAX: usize = 60_000;

/// A learned simulator, which anything differentiable can be trained through.
#[pyclass(module = "eupnea", name = "Simulator", frozen)]
pub struct Simulator {
    simulator: learn::simulator::model::Simulator,
    model: Model,
}

/// State of the plant at the start of a roll-out; pressures in cmH2O, commands in percent.
struct Start {
    pressure: f32,
    plateau: f32,
    rest: f32,
    plateau_command: f32,
    peep: f32,
    resistance: f32,
    compliance: f32,
}

impl Start {
    /// The start from keyword arguments; those that are absent have the defaults of the stub.
    fn new(
        simulator: &learn::simulator::model::Simulator,
        given: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let (usual, settings) = (BreathStart::default(), Settings::default());
        let mut values = [
            ("start_pressure", simulator.start_pressure),
            ("pip", settings.pip),
            ("rest", settings.expiratory_bias),
            ("plateau_command", f32::NAN),
            ("peep", usual.peep[0]),
            ("resistance", usual.resistance[0]),
            ("compliance", usual.compliance[0]),
        ];
        for (name, value) in given.into_iter().flatten().filter(|(_, value)| !value.is_none()) {
            let name: String = name.extract()?;
            let slot = values.iter_mut().find(|(known, _)| *known == name);
            let (_, slot) = slot.ok_or_else(|| {
                PyTypeError::new_err(format!(
                    "a roll-out has no argument {name}: see help(eupnea.Simulator.roll_out)"
                ))
            })?;
            *slot = value.extract()?;
            if !slot.is_finite() {
                return Err(errors::value(format!("{name} is {slot}: give a finite number")));
            }
        }
        let [pressure, plateau, rest, plateau_command, peep, resistance, compliance] =
            values.map(|(_, value)| value);
        // Without an inspiration before, the valve was at rest.
        let plateau_command = if plateau_command.is_nan() { rest } else { plateau_command };
        Ok(Self { pressure, plateau, rest, plateau_command, peep, resistance, compliance })
    }

    /// The same start in every lane.
    fn breath(&self) -> BreathStart {
        BreathStart {
            pressure: Lane::splat(self.pressure),
            plateau: Lane::splat(self.plateau),
            rest: Lane::splat(self.rest / COMMAND_SCALE),
            plateau_command: Lane::splat(self.plateau_command / COMMAND_SCALE),
            peep: Lane::splat(self.peep),
            resistance: Lane::splat(self.resistance),
            compliance: Lane::splat(self.compliance),
            ..BreathStart::default()
        }
    }
}

impl Simulator {
    /// Runs the commands of up to [`LANES`] inspirations; `each` gets the pressures of every tick.
    fn shard(&self, commands: &[&[f32]], start: &Start, mut each: impl FnMut(usize, Lane)) -> Rollout {
        let ticks = commands[0].len();
        let mut rollout = Rollout::new(&self.model, ticks);
        rollout.begin(&self.model, &start.breath(), &Lane::splat(start.rest));
        for tick in 0..ticks {
            each(tick, rollout.pressure());
            let of_lane = |lane: usize| commands[lane.min(commands.len() - 1)];
            rollout.advance(&Lane::from_fn(|lane| of_lane(lane)[tick]));
        }
        rollout
    }

    fn checked<'a>(commands: &'a PyReadonlyArray2<'_, f32>) -> PyResult<Vec<&'a [f32]>> {
        let [_, ticks] = *commands.shape() else { return Err(errors::value("commands need two dimensions")) };
        // A slice of an array in Fortran's order would have its rows and columns exchanged.
        let flat = commands.as_slice().ok().filter(|_| commands.is_c_contiguous());
        let flat = flat.ok_or_else(|| errors::value("commands must be contiguous: use ascontiguousarray"))?;
        if !(1..=TICKS_MAX).contains(&ticks) {
            return Err(errors::value(format!("{ticks} ticks: a roll-out has 1 to {TICKS_MAX}")));
        }
        if !flat.iter().all(|command| command.is_finite()) {
            return Err(errors::value("a command is not a finite number"));
        }
        Ok(flat.chunks(ticks).collect())
    }
}

#[pymethods]
impl Simulator {
    /// Reads a file of `trainer fit`.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        let simulator = learn::simulator::model::Simulator::load(&path).map_err(|e| errors::of(&e))?;
        let channels = simulator.architecture.timing().channels;
        if channels != 1 {
            let text = format!("the simulator has {channels} valves: a roll-out takes the commands of one");
            return Err(errors::value(text));
        }
        Ok(Self { model: simulator.model(), simulator })
    }

    #[getter]
    fn plant(&self) -> String {
        self.simulator.plant.clone()
    }

    #[getter]
    fn period_us(&self) -> u32 {
        self.simulator.architecture.timing().period_us
    }

    #[getter]
    fn noise(&self) -> f32 {
        self.simulator.noise
    }

    #[getter]
    fn start_pressure(&self) -> f32 {
        self.simulator.start_pressure
    }

    #[getter]
    fn parameters(&self) -> usize {
        self.simulator.architecture.parameters()
    }

    /// Name of the architecture.
    #[getter]
    fn architecture(&self) -> PyResult<String> {
        let value = serde_json::to_value(self.simulator.architecture).map_err(errors::value)?;
        Ok(value["architecture"].as_str().unwrap_or_default().to_owned())
    }

    /// Pressures at the start of each tick, cmH2O, for commands in percent; both have shape (breaths, ticks).
    #[pyo3(signature = (commands, **start))]
    fn roll_out<'py>(
        &self,
        py: Python<'py>,
        commands: PyReadonlyArray2<'py, f32>,
        start: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let start = Start::new(&self.simulator, start)?;
        let breaths = Self::checked(&commands)?;
        let ticks = breaths.first().map_or(0, |breath| breath.len());
        let mut pressures = Array2::zeros((breaths.len(), ticks));
        py.detach(|| {
            for (n, shard) in breaths.chunks(LANES).enumerate() {
                self.shard(shard, &start, |tick, pressure| {
                    (0..shard.len()).for_each(|lane| pressures[(n * LANES + lane, tick)] = pressure[lane]);
                });
            }
        });
        Ok(pressures.into_pyarray(py))
    }

    /// Gradient of a loss with respect to the commands, from its gradient with respect to the pressures; all have shape
    /// (breaths, ticks).
    #[pyo3(signature = (commands, d_pressures, **start))]
    fn gradient<'py>(
        &self,
        py: Python<'py>,
        commands: PyReadonlyArray2<'py, f32>,
        d_pressures: PyReadonlyArray2<'py, f32>,
        start: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let start = Start::new(&self.simulator, start)?;
        if commands.shape() != d_pressures.shape() {
            return Err(errors::value("commands and d_pressures need the same shape"));
        }
        let (breaths, slopes) = (Self::checked(&commands)?, Self::checked(&d_pressures)?);
        let ticks = breaths.first().map_or(0, |breath| breath.len());
        let mut gradient = Array2::zeros((breaths.len(), ticks));
        py.detach(|| {
            for (n, (shard, slopes)) in breaths.chunks(LANES).zip(slopes.chunks(LANES)).enumerate() {
                let mut rollout = self.shard(shard, &start, |_, _| ());
                rollout.start_back();
                for tick in (0..ticks).rev() {
                    let d_command = rollout.command_gradient(tick);
                    (0..shard.len()).for_each(|lane| gradient[(n * LANES + lane, tick)] = d_command[lane]);
                    let d_pressure = Lane::from_fn(|lane| slopes.get(lane).map_or(0.0, |slope| slope[tick]));
                    rollout.add_pressure_gradient(tick, &d_pressure);
                }
            }
        });
        Ok(gradient.into_pyarray(py))
    }

    fn __repr__(&self) -> String {
        format!("Simulator(plant={:?})", self.simulator.plant)
    }
}
