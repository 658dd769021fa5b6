//! What a server runs on, as arguments: the disk, and where work goes on that would keep others
//! waiting. Time is the runtime's (`tokio::time`), which a test may hold and turn on.

use std::{env, io, path::PathBuf, sync::Arc};

use reel_trace::{Disk, LocalDisk, TraceFiles};
use tokio::task::JoinHandle;

/// The machine under a server. The default is this one.
#[derive(Clone, Debug)]
pub struct Host {
    /// What traces are written to and read from.
    pub disk: Arc<dyn Disk>,
    /// Where work goes on that computes, or waits for the disk.
    pub work: Work,
}

/// Where work goes on that would keep others waiting.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Work {
    /// On threads of its own, beside those that serve.
    #[default]
    Threads,
    /// As a task among the others, in one piece: one order of everything, as simulations want it.
    Tasks,
}

/// Path of the program that this process runs, to run it again: of the Python package the command
/// that it installs, which `REEL_PROGRAM` names, because the process itself is Python.
///
/// # Errors
/// When the operating system does not say which program it is.
pub fn program() -> io::Result<PathBuf> {
    match env::var_os("REEL_PROGRAM") {
        Some(path) if !path.is_empty() => Ok(path.into()),
        _ => env::current_exe(),
    }
}

impl Default for Host {
    fn default() -> Self {
        Self {
            disk: Arc::new(LocalDisk),
            work: Work::default(),
        }
    }
}

impl Host {
    /// The traces of its disk.
    pub fn trace_files(&self) -> TraceFiles {
        TraceFiles::on(self.disk.clone())
    }
}

impl Work {
    /// Begins some work, which is done to its end, whoever stops waiting.
    pub fn spawn<T: Send + 'static>(
        self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> JoinHandle<T> {
        match self {
            Self::Threads => tokio::task::spawn_blocking(work),
            Self::Tasks => tokio::spawn(async move { work() }),
        }
    }
}
