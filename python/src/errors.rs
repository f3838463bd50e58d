//! Errors of the library as Python exceptions of the fitting type.

use std::error::Error;
use std::io;

use pyo3::PyErr;
use pyo3::exceptions::{PyFileNotFoundError, PyOSError, PyRuntimeError, PyValueError};

/// A `ValueError`: an argument is wrong.
pub fn value(error: impl ToString) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// An exception for an error: an `OSError` if a file is its cause, else a `ValueError`, since all else is checked input.
pub fn of(error: &(impl Error + 'static)) -> PyErr {
    from_chain(error, error.to_string()).unwrap_or_else(|| value(error))
}

/// A `RuntimeError`: what was asked for cannot go on.
pub fn runtime(error: impl ToString) -> PyErr {
    PyRuntimeError::new_err(error.to_string())
}

/// An `OSError` with this text if a file is the cause of an error.
pub fn from_chain(error: &(dyn Error + 'static), text: String) -> Option<PyErr> {
    let mut cause = Some(error);
    while let Some(error) = cause {
        if let Some(error) = error.downcast_ref::<io::Error>() {
            let missing = error.kind() == io::ErrorKind::NotFound;
            return Some(if missing { PyFileNotFoundError::new_err(text) } else { PyOSError::new_err(text) });
        }
        cause = error.source();
    }
    None
}
