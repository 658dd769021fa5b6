//! Errors of Reel as Python exceptions, with the texts of the command line.

use std::{error::Error, fmt::Write as _};

use pyo3::{
    create_exception,
    exceptions::{PyBaseException, PyException},
    prelude::*,
};
use reel_replay::Verdict;

create_exception!(
    reel,
    ReelError,
    PyException,
    "What Reel refuses, with what is wrong, where, and what to do."
);
create_exception!(
    reel,
    DivergenceError,
    ReelError,
    "A replay gave other bits than the trace holds; the text names the first difference."
);

create_exception!(
    reel,
    PolicyError,
    ReelError,
    "A policy written in Python raised an exception. The text names it, the task and the step, \
     `task_id` and `step` hold them, and `__cause__` is the exception itself."
);

/// The exception of a policy as a [`PolicyError`] that names task and step. What ends the process
/// (Ctrl-C, `sys.exit`) stays what it is.
///
/// # Errors
/// Fails if the exception has no text.
#[pyfunction]
pub fn policy_error<'py>(
    task_id: &str,
    step: u32,
    raised: Bound<'py, PyBaseException>,
) -> PyResult<Bound<'py, PyBaseException>> {
    let py = raised.py();
    if !raised.is_instance_of::<PyException>() || raised.is_instance_of::<PolicyError>() {
        return Ok(raised);
    }
    let text = raised.str()?;
    let kind = raised.get_type().name()?;
    let what = match raised.is_instance_of::<ReelError>() {
        true => format!("failed: {text}"),
        false => format!("raised {kind}: {text}"),
    };
    let error = PolicyError::new_err(format!("task {task_id}, step {step}: the policy {what}"));
    error.set_cause(py, Some(PyErr::from_value(raised.into_any())));
    let value = error.into_value(py).into_bound(py);
    value.setattr("task_id", task_id)?;
    value.setattr("step", step)?;
    Ok(value)
}

/// An error and its causes in one line, as the command line prints them.
pub fn raise(error: &dyn Error) -> PyErr {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(because) = cause {
        let _infallible = write!(text, ": {because}");
        cause = because.source();
    }
    ReelError::new_err(text)
}

/// A text that says what is wrong.
pub fn refuse(text: impl Into<String>) -> PyErr {
    ReelError::new_err(text.into())
}

/// Why something of a trace could not be executed.
pub fn not_executed(verdict: &Verdict) -> PyErr {
    match verdict {
        Verdict::Diverged { .. } => DivergenceError::new_err(verdict.to_string()),
        Verdict::Refused { reason } | Verdict::NotReplayable { reason } => refuse(reason.clone()),
        other => refuse(other.to_string()),
    }
}

/// Results of libraries as results for Python.
pub trait OrRaise<T> {
    /// The value, or the error as [`ReelError`].
    fn or_raise(self) -> PyResult<T>;
}

impl<T, E: Error> OrRaise<T> for Result<T, E> {
    fn or_raise(self) -> PyResult<T> {
        self.map_err(|error| raise(&error))
    }
}
