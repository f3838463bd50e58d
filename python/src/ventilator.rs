//! The ventilator of the chip, stepped from Python: breath timing, controller, monitors and safety filter.

use environment::no_monitors;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use shared::safety::monitors::Monitors;
use shared::sensor::Readings;
use shared::settings::Settings;
use shared::ventilator::{Mode, VentilatorState};

use crate::controller::Controller;
use crate::{errors, values};

/// The ventilator and its state.
#[pyclass(module = "eupnea", name = "Ventilator")]
pub struct Ventilator {
    ventilator: shared::ventilator::Ventilator,
    state: VentilatorState,
}

/// Result of a tick: commands of both valves, breath, tick, phase, target, level of the ladder, and the alarm that begins.
type Output = (f32, bool, u32, u32, Option<String>, f32, String, Option<String>);

#[pymethods]
impl Ventilator {
    #[new]
    #[pyo3(signature = (controller, *, monitors=true, **settings))]
    fn new(controller: &Controller, monitors: bool, settings: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let monitors = if monitors { Monitors::ALL } else { no_monitors() };
        let ventilator = shared::ventilator::Ventilator::new(controller.period_us, controller.law.clone());
        let ventilator = ventilator.with_monitors(monitors);
        let settings = values::settings(settings)?;
        let mut state = ventilator.standby(&settings).map_err(|e| errors::of(&e))?;
        state.start();
        Ok(Self { ventilator, state })
    }

    /// One control tick with the sensors' readings.
    #[pyo3(signature = (pressure, outlet=f32::NAN, flow=f32::NAN))]
    fn step(&mut self, pressure: f32, outlet: f32, flow: f32) -> Output {
        let output = self.ventilator.step(&mut self.state, Readings { airway: pressure, outlet, flow });
        let (command, alarm) = (output.command, output.alarm.map(|alarm| format!("{alarm:?}")));
        let sample = output.sample;
        (
            command.u_in(),
            command.u_out(),
            sample.map_or(0, |sample| sample.breath),
            sample.map_or(0, |sample| sample.tick),
            sample.map(|sample| format!("{:?}", sample.phase).to_lowercase()),
            sample.map_or(f32::NAN, |sample| sample.target),
            format!("{:?}", self.state.level()),
            alarm,
        )
    }

    /// Settings from the next breath on.
    #[pyo3(signature = (**settings))]
    fn apply(&mut self, settings: Option<&Bound<'_, PyDict>>) -> PyResult<()> {
        let latest = self.state.pending().unwrap_or(self.state.breath().settings());
        let settings = values::changed(*latest, settings)?;
        self.ventilator.apply(&mut self.state, &settings).map_err(|e| errors::of(&e))
    }

    /// Replaces the controller.
    fn set_controller(&mut self, controller: &Controller) -> PyResult<()> {
        if controller.period_us != self.ventilator.period_us() {
            return Err(errors::value("the controller was built for another control period"));
        }
        self.ventilator.set_controller(controller.law.clone());
        Ok(())
    }

    /// Starts ventilation after a stop.
    fn start(&mut self) {
        self.state.start();
    }

    /// Goes to standby.
    fn stop(&mut self) {
        self.state.stop();
    }

    /// Acknowledges all alarms, and leaves the latched safe state for standby.
    fn acknowledge(&mut self) -> bool {
        self.state.acknowledge()
    }

    /// `standby`, `ventilating` or `fault`.
    #[getter]
    fn mode(&self) -> &'static str {
        match self.state.mode() {
            Mode::Standby => "standby",
            Mode::Ventilating => "ventilating",
            Mode::Fault(_) => "fault",
        }
    }

    /// The latched fault, if there is one.
    #[getter]
    fn fault(&self) -> Option<String> {
        match self.state.mode() {
            Mode::Fault(fault) => Some(format!("{fault:?}")),
            _ => None,
        }
    }

    #[getter]
    fn period_us(&self) -> u32 {
        self.ventilator.period_us()
    }

    /// The settings in force, by name.
    #[getter]
    fn settings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let settings: &Settings = self.state.breath().settings();
        let dict = PyDict::new(py);
        for field in shared::settings::FIELDS {
            dict.set_item(field.name, field.value(settings))?;
        }
        Ok(dict)
    }
}
