//! REAL-Bench tasks, scenes, the object library and the task generator.
//!
//! Reads outside files, so everything here that fails says which file, which line and which field.
//! Never simulates: whether a task can be done is found out by running it.

pub mod assets;
pub mod attributes;
pub mod generate;
pub mod library;
pub mod scene;
pub mod yaml;

mod document;
mod draw;
mod error;
mod field;
mod load;
mod lookup;
mod placement;
pub mod random;
pub mod real_bench;
pub mod real_proc;
mod real_schema;
mod warning;
pub mod wording;

pub use draw::{DrawOptions, DrawnTasks, draw};
pub use error::TaskError;
pub use load::{LoadReport, LoadedSet, ObjectOrder, load, load_as, load_with, parse};
pub use lookup::SceneSource;
pub use random::Stream;
pub use scene::home_scene;
pub use warning::{TaskWarning, TaskWarningKind};
