//! Errors of Reel as Python exceptions, with the texts of the command line.

use std::{error::Error, fmt::Write as _};

use pyo3::{create_exception, exceptions::PyException, prelude::*};
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
