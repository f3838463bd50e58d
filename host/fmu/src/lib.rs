//! Bench and ventilator as a functional mock-up unit (FMU, FMI 2.0 for co-simulation), for Simulink, Modelica and others.
//!
//! An FMU is an archive: a description of its variables, a shared library for the machine that wrote it, and the bench and the
//! controller as resources. The library, `fmu_library`, passes each call to a [`Component`], which runs the same ventilator on the same
//! bench as `trainer collect`.
#![forbid(unsafe_code)]

mod archive;
mod component;
mod description;
mod resources;
mod variables;

pub use archive::archive;
pub use component::{Component, FmuError};
pub use description::description;
pub use resources::Resources;
