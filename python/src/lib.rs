//! The native half of the Python package `eupnea`: thin wrappers around the crates of the host side.
//!
//! Every function checks its arguments and turns errors into Python exceptions of the fitting type; work that takes long releases
//! the interpreter's lock. The Python half, `eupnea/`, adds names, documentation and Gymnasium's interfaces.

#![expect(clippy::needless_pass_by_value, reason = "what Python passes is converted to values of our own")]

mod bench;
mod command;
mod controller;
mod environment;
mod errors;
mod simulator;
mod values;
mod ventilator;

use pyo3::prelude::*;

/// The module `eupnea._native`.
#[pymodule]
mod _native {
    #[pymodule_export]
    use crate::bench::{Bench, Family};
    #[pymodule_export]
    use crate::command::{call, command_help, command_options};
    #[pymodule_export]
    use crate::controller::Controller;
    #[pymodule_export]
    use crate::environment::{Batch, Environment, Observer, Task, noise_seeds};
    #[pymodule_export]
    const KNOWN_GOOD: (f32, f32, f32) = {
        let gains = shared::device::KNOWN_GOOD;
        (gains.p, gains.i, gains.d)
    };
    #[pymodule_export]
    const PRESCRIPTIONS: [&str; 2] = plant::prescriptions::NAMES;
    #[pymodule_export]
    use crate::simulator::Simulator;
    #[pymodule_export]
    use crate::ventilator::Ventilator;
}
