//! Arguments that several classes take: settings, gains and the environment's options.

use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::pid::PidGains;
use shared::settings::Settings;

use crate::errors;

/// Control period used without another one, microseconds.
pub const PERIOD_US: u32 = DEFAULT_PERIOD_US;

/// Settings from keyword arguments with the names of the schema, such as `peep` and `rate`; the others keep their defaults.
pub fn settings(given: Option<&Bound<'_, PyDict>>) -> PyResult<Settings> {
    changed(Settings::default(), given)
}

/// These settings with some of them replaced. PIP is checked by those who use it.
pub fn changed(settings: Settings, given: Option<&Bound<'_, PyDict>>) -> PyResult<Settings> {
    let Some(given) = given else { return Ok(settings) };
    let mut values = serde_json::to_value(settings).map_err(errors::value)?;
    for (name, value) in given {
        let name: String = name.extract()?;
        let Some(slot) = values.get_mut(&name) else {
            let names: Vec<_> = shared::settings::FIELDS.iter().map(|field| field.name).collect();
            let text = format!("there is no setting {name}: choose from {}", names.join(", "));
            return Err(PyTypeError::new_err(text));
        };
        *slot = value.extract::<f32>()?.into();
    }
    serde_json::from_value(values).map_err(errors::value)
}

/// Gains `(p, i)` or `(p, i, d)`.
pub fn gains(given: &[f32]) -> PyResult<PidGains> {
    match *given {
        [p, i] => Ok(PidGains { p, i, d: 0.0 }),
        [p, i, d] => Ok(PidGains { p, i, d }),
        _ => Err(PyValueError::new_err(format!("{} gains: give two or three, P, I and D", given.len()))),
    }
}
