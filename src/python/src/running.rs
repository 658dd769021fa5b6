//! Long work beside the interpreter: without its lock, on another thread, while the one that waits
//! lets Ctrl-C through.

use std::{
    panic::{AssertUnwindSafe, catch_unwind, resume_unwind},
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread,
    time::Duration,
};

use pyo3::prelude::*;

use crate::error::OrRaise as _;

/// How often the waiting thread asks whether Ctrl-C was pressed.
const PATIENCE: Duration = Duration::from_millis(50);

/// Says to work on other threads that nobody waits for it any more.
#[derive(Debug, Default)]
pub struct Stop(AtomicBool);

impl Stop {
    /// Asks the work to end soon.
    pub fn set(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether the work shall end soon.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Runs work without the interpreter's lock. Where a signal's handler raises meanwhile (Ctrl-C),
/// `stop` is called, the work's end awaited, and the exception raised.
///
/// # Errors
/// What the signal's handler raised.
pub fn interruptible<T: Send>(
    py: Python<'_>,
    stop: impl Fn() + Sync,
    work: impl FnOnce() -> T + Send,
) -> PyResult<T> {
    let (end, raised) = py.detach(|| {
        thread::scope(|scope| {
            let (sender, ended) = mpsc::channel();
            scope.spawn(move || {
                let _nobody_left = sender.send(catch_unwind(AssertUnwindSafe(work)));
            });
            let mut raised = None;
            loop {
                match ended.recv_timeout(PATIENCE) {
                    Ok(end) => return (end, raised),
                    Err(_) => {
                        if let (None, Err(error)) =
                            (&raised, Python::attach(|py| py.check_signals()))
                        {
                            raised = Some(error);
                            stop();
                        }
                    }
                }
            }
        })
    });
    let value = end.unwrap_or_else(|panic| resume_unwind(panic));
    raised.map_or(Ok(value), Err)
}

/// Calls a Python function from a worker thread with the number of items that are done; what it
/// raises is printed as Python prints what nobody can catch.
pub fn report_progress(progress: Option<&Py<PyAny>>, done: usize) {
    if let Some(progress) = progress {
        Python::attach(|py| {
            if let Err(error) = progress.call1(py, (done,)) {
                error.write_unraisable(py, None);
            }
        });
    }
}

/// So many worker threads.
///
/// # Errors
/// When they cannot be started.
pub fn pool(jobs: usize) -> PyResult<rayon::ThreadPool> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(jobs.max(1))
        .build()
        .or_raise()
}
