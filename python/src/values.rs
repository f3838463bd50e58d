//! Arguments that several classes take: settings, gains and the environment's options.

use pyo3::exceptions::{PyOverflowError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use shared::breath::{DEFAULT_PERIOD_US, PERIOD_BOUNDS_US};
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
            return Err(errors::value(text));
        };
        *slot = value.extract::<f32>()?.into();
    }
    serde_json::from_value(values).map_err(errors::value)
}

/// Refuses a control period that no ventilator has.
pub fn check_period(period_us: u32) -> PyResult<()> {
    let (shortest, longest) = PERIOD_BOUNDS_US;
    if (shortest..=longest).contains(&period_us) {
        return Ok(());
    }
    Err(errors::value(format!("period_us is {period_us}: it must be {shortest} to {longest}")))
}

/// Gains `(p, i)` or `(p, i, d)`.
pub fn gains(given: &[f32]) -> PyResult<PidGains> {
    match *given {
        [p, i] => Ok(PidGains { p, i, d: 0.0 }),
        [p, i, d] => Ok(PidGains { p, i, d }),
        _ => Err(PyValueError::new_err(format!("{} gains: give two or three, P, I and D", given.len()))),
    }
}

/// A whole number of Rust's type `T`, for `from_py_with`. One that does not fit raises a `ValueError`, not an `OverflowError`.
pub fn whole<'py, T>(value: &Bound<'py, PyAny>) -> PyResult<T>
where
    T: for<'a> FromPyObject<'a, 'py, Error = PyErr>,
{
    value.extract().map_err(|error: PyErr| {
        if error.is_instance_of::<PyOverflowError>(value.py()) {
            let most = u128::MAX >> (u128::BITS - 8 * size_of::<T>() as u32);
            errors::value(format!("{value} is out of range: give a whole number from 0 to {most}"))
        } else {
            error
        }
    })
}

/// As [`whole`], or none.
pub fn whole_or_none<'py, T>(value: &Bound<'py, PyAny>) -> PyResult<Option<T>>
where
    T: for<'a> FromPyObject<'a, 'py, Error = PyErr>,
{
    if value.is_none() { Ok(None) } else { whole(value).map(Some) }
}
