//! The native part of the Python package `reel`: traces, simulations, stores and the command line
//! as Python objects. What people call is in `python/reel`; here are only crossings of the border.
//!
//! Work runs without the interpreter's lock, and Ctrl-C reaches it. Whatever is not a function of
//! its inputs (a Python policy) enters an episode as an input, as everywhere in Reel.

mod command;
mod convert;
mod error;
mod polars_plugin;
mod policy;
mod rows;
mod running;
mod sequence;
mod simulation;
mod store;
mod tasks;
mod trace;

use pyo3::prelude::*;

/// The native module of the package, `reel._reel`.
#[pymodule]
mod _reel {
    #[pymodule_export]
    use crate::command::main;
    #[pymodule_export]
    use crate::error::{DivergenceError, PolicyError, ReelError, policy_error};
    #[pymodule_export]
    use crate::policy::{Observation, run};
    #[pymodule_export]
    use crate::sequence::apply_to_steps;
    #[pymodule_export]
    use crate::simulation::{ForkPoint, Simulation, StepResult, step_all};
    #[pymodule_export]
    use crate::store::{Store, Stream, Table, named_query};
    #[pymodule_export]
    use crate::tasks::{TaskSet, tools};
    #[pymodule_export]
    use crate::trace::{Trace, replay_all, trace_paths};

    use super::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("SIM_VERSION", reel_sim::SIM_VERSION)
    }
}
