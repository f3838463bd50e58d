//! The virtual bench: a plant that Python steps, and the descriptions of plants and families.

use numpy::PyArray1;
use plant::bench::{BenchConfig, Truth};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use shared::settings::Settings;

use crate::{errors, values};

/// A simulated ventilator, circuit, lung and patient, in steps of 1 ms.
#[pyclass(module = "eupnea", name = "Bench")]
pub struct Bench {
    pub config: BenchConfig,
    bench: plant::bench::Bench,
}

impl Bench {
    pub fn of(config: BenchConfig) -> PyResult<Self> {
        let bench =
            plant::bench::Bench::new(&config, Settings::default().peep, 0).map_err(|e| errors::of(&e))?;
        Ok(Self { config, bench })
    }
}

#[pymethods]
impl Bench {
    #[new]
    #[pyo3(signature = (lung="R20C20", *, seed=0, peep=None))]
    fn new(lung: &str, #[pyo3(from_py_with = values::whole)] seed: u64, peep: Option<f32>) -> PyResult<Self> {
        let config = BenchConfig::from_name(lung).map_err(|e| errors::of(&e))?;
        let mut bench = Self::of(config)?;
        bench.reset(seed, peep)?;
        Ok(bench)
    }

    /// The bench of a description in TOML.
    #[staticmethod]
    fn from_toml(text: &str) -> PyResult<Self> {
        Self::of(BenchConfig::from_toml(text).map_err(|e| errors::of(&e))?)
    }

    /// The benches that a name selects, such as `paper` or `iso`.
    #[staticmethod]
    fn preset(name: &str) -> PyResult<Vec<Self>> {
        BenchConfig::preset(name).map_err(|e| errors::of(&e))?.into_iter().map(Self::of).collect()
    }

    #[getter]
    fn name(&self) -> String {
        self.config.name.clone()
    }

    /// The description in TOML.
    fn to_toml(&self) -> String {
        self.config.to_toml()
    }

    /// Back to rest.
    #[pyo3(signature = (seed=0, peep=None))]
    fn reset(&mut self, #[pyo3(from_py_with = values::whole)] seed: u64, peep: Option<f32>) -> PyResult<f32> {
        let peep = peep.unwrap_or(Settings::default().peep);
        self.bench = plant::bench::Bench::new(&self.config, peep, seed).map_err(|e| errors::of(&e))?;
        Ok(peep)
    }

    /// One millisecond.
    fn step(&mut self, u_in: f32, u_out: bool) -> f32 {
        self.bench.step(u_in, u_out)
    }

    /// One millisecond for each command; returns the readings.
    fn run<'py>(&mut self, py: Python<'py>, u_in: Vec<f32>, u_out: bool) -> Bound<'py, PyArray1<f32>> {
        let readings: Vec<f32> =
            py.detach(|| u_in.iter().map(|u_in| self.bench.step(*u_in, u_out)).collect());
        PyArray1::from_vec(py, readings)
    }

    /// Sets the mechanical PEEP valve.
    fn set_peep(&mut self, peep: f32) {
        self.bench.set_peep(peep);
    }

    /// The sample of the pressure sensor at the machine's outlet.
    fn outlet_reading(&mut self) -> f32 {
        self.bench.outlet_reading()
    }

    /// The sample of the flow sensor.
    fn flow_reading(&mut self) -> f32 {
        self.bench.flow_reading()
    }

    /// The true state.
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let Truth {
            airway_pressure,
            sensor_pressure,
            alveolar_pressure,
            muscle_pressure,
            flow_valve,
            flow_lung,
            flow_expiratory,
            flow_leak,
            flow_relief,
            lung_volume_ml,
            valve_position,
            expiratory_opening,
            breath: _,
            effort_started_s: _,
            efforts,
        } = self.bench.truth();
        let truth = PyDict::new(py);
        for (name, value) in [
            ("airway_pressure", airway_pressure),
            ("sensor_pressure", sensor_pressure),
            ("alveolar_pressure", alveolar_pressure),
            ("muscle_pressure", muscle_pressure),
            ("flow_valve", flow_valve),
            ("flow_lung", flow_lung),
            ("flow_expiratory", flow_expiratory),
            ("flow_leak", flow_leak),
            ("flow_relief", flow_relief),
            ("lung_volume_ml", lung_volume_ml),
            ("valve_position", valve_position),
            ("expiratory_opening", expiratory_opening),
            ("efforts", f64::from(efforts)),
        ] {
            truth.set_item(name, value)?;
        }
        Ok(truth)
    }

    fn __repr__(&self) -> String {
        format!("Bench({:?})", self.config.name)
    }
}

/// A family of plants.
#[pyclass(module = "eupnea", name = "Family", frozen)]
pub struct Family {
    pub family: plant::bench::family::Family,
}

#[pymethods]
impl Family {
    #[new]
    fn new(name: &str) -> PyResult<Self> {
        let family = plant::bench::family::Family::find(name).map_err(|e| errors::of(&e))?;
        Ok(Self { family })
    }

    /// The family of a description in TOML.
    #[staticmethod]
    fn from_toml(text: &str) -> PyResult<Self> {
        let family = plant::bench::family::Family::from_toml(text).map_err(|e| errors::of(&e))?;
        Ok(Self { family })
    }

    #[getter]
    fn name(&self) -> String {
        self.family.name.clone()
    }

    /// Gains of the best single PID of the family, if known.
    #[getter]
    fn pid(&self) -> Option<(f32, f32, f32)> {
        self.family.pid.map(|gains| (gains.p, gains.i, gains.d))
    }

    /// The same under the prescriptions of the bedside.
    #[getter]
    fn bedside_pid(&self) -> Option<(f32, f32, f32)> {
        self.family.bedside_pid.map(|gains| (gains.p, gains.i, gains.d))
    }

    /// The plant with this number, of those that a seed gives.
    fn draw(
        &self,
        #[pyo3(from_py_with = values::whole)] seed: u64,
        #[pyo3(from_py_with = values::whole)] number: u32,
    ) -> PyResult<Bench> {
        Bench::of(self.family.draw(seed, number))
    }

    fn __repr__(&self) -> String {
        format!("Family({:?})", self.family.name)
    }
}
