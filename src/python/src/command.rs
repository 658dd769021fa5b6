//! The command line, which the wheel carries too.

use std::ffi::OsString;

use pyo3::prelude::*;

/// Runs a command line, the program's name first, and gives the exit code. Ends the process itself
/// where the arguments are wrong.
#[pyfunction]
pub fn main(py: Python<'_>, words: Vec<OsString>) -> u8 {
    py.detach(|| reel_cli::main(words))
}
