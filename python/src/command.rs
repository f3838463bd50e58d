//! Commands of `lab` and `trainer`, called from Python: the same arguments and the same results, bit for bit.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use host::cli::Cli as Trainer;
use host::command::Observer;
use host::command::call::{self as command, CallError};
use lab::cli::Cli as Lab;
use progress::Event;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

use crate::errors;

/// Time between two checks for Ctrl-C and for progress.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Progress that has not been reported yet: stage, done, total.
type News = Mutex<Vec<(String, usize, usize)>>;

/// Runs a command and returns the content of its JSON as text. `progress(stage, done, total)` is called with the progress; Ctrl-C stops the
/// command, which keeps its results so far, and raises `KeyboardInterrupt`.
#[pyfunction]
#[pyo3(signature = (arguments, progress=None))]
pub fn call(py: Python<'_>, arguments: Vec<OsString>, progress: Option<Py<PyAny>>) -> PyResult<String> {
    let (news, stop) = (Arc::new(News::default()), Arc::new(AtomicBool::new(false)));
    let (answer, answers) = channel();
    let answers = Mutex::new(answers);
    let worker = std::thread::Builder::new().spawn({
        let (news, stop) = (news.clone(), stop.clone());
        move || {
            let observer = |event: &Event<'_>| note(&news, event);
            let _ = answer.send(run(&arguments, &observer, &stop));
        }
    });
    worker.map_err(errors::runtime)?;
    let mut interrupted = None;
    let outcome = loop {
        match py.detach(|| answers.lock().unwrap_or_else(PoisonError::into_inner).recv_timeout(POLL_INTERVAL))
        {
            Ok(outcome) => break outcome,
            Err(RecvTimeoutError::Disconnected) => {
                // The panic's message is on standard error.
                return Err(PyRuntimeError::new_err("the command failed unexpectedly: please report this"));
            }
            Err(RecvTimeoutError::Timeout) => {}
        }
        if let Err(error) = py.check_signals() {
            stop.store(true, Ordering::SeqCst);
            // A second Ctrl-C does not wait for the command.
            if let Some(first) = interrupted.replace(error) {
                return Err(first);
            }
        }
        if interrupted.is_none()
            && let Err(error) = report(py, &news, progress.as_ref())
        {
            interrupted = Some(error);
            stop.store(true, Ordering::SeqCst);
        }
    };
    if let Some(error) = interrupted {
        return Err(error);
    }
    report(py, &news, progress.as_ref())?;
    outcome.map_err(|error| exception(&error))
}

/// The help of a command, as the command line prints it.
#[pyfunction]
pub fn command_help(name: &str) -> PyResult<String> {
    command::help::<Lab>(name).or_else(|| command::help::<Trainer>(name)).ok_or_else(|| unknown(name))
}

/// The options of a command without their dashes, each with whether it is repeated for several values.
#[pyfunction]
pub fn command_options(name: &str) -> PyResult<BTreeMap<String, bool>> {
    command::options::<Lab>(name).or_else(|| command::options::<Trainer>(name)).ok_or_else(|| unknown(name))
}

/// Runs a command of the laboratory or, if it has none of that name, of the trainer.
fn run(arguments: &[OsString], observer: &Observer, stop: &AtomicBool) -> Result<String, CallError> {
    let name = arguments.first().and_then(|name| name.to_str()).unwrap_or_default();
    match command::options::<Lab>(name) {
        Some(_) => command::call::<Lab>(arguments, observer, stop),
        None => command::call::<Trainer>(arguments, observer, stop),
    }
}

fn unknown(name: &str) -> PyErr {
    PyValueError::new_err(format!("there is no command {name}: see `trainer --help` and `lab --help`"))
}

/// Notes the latest progress of a stage.
fn note(news: &News, event: &Event<'_>) {
    let stage = event.label();
    let mut news = news.lock().unwrap_or_else(PoisonError::into_inner);
    match news.iter_mut().find(|(name, ..)| *name == stage) {
        // Parts that run in parallel report out of order.
        Some((_, done, total)) => (*done, *total) = ((*done).max(event.done), event.total),
        None => news.push((stage, event.done, event.total)),
    }
}

/// Reports the latest progress.
fn report(py: Python<'_>, news: &News, progress: Option<&Py<PyAny>>) -> PyResult<()> {
    let news = std::mem::take(&mut *news.lock().unwrap_or_else(PoisonError::into_inner));
    let Some(progress) = progress else { return Ok(()) };
    news.into_iter().try_for_each(|event| progress.call1(py, event).map(drop))
}

fn exception(error: &CallError) -> PyErr {
    match error {
        CallError::Usage(text) => PyValueError::new_err(text.clone()),
        CallError::Stopped => errors::runtime(error),
        CallError::Failed(cause) => {
            let text = error.to_string();
            errors::from_chain(cause.as_ref(), text.clone()).unwrap_or_else(|| PyRuntimeError::new_err(text))
        }
    }
}
