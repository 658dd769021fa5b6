//! Tasks of the four families, for any scenes: drawn from what belongs where (`compatibility`),
//! worded so that exactly what is meant is meant (`describe`, `wording`), placed (`ground`,
//! `placement`) and kept only where both filters of the paper let them pass (`placement`, `settle`)
//! and the robot can get near.
//!
//! Every draft is a function of seed, scene, family, type and its number alone, so that nothing
//! depends on the number of threads, and more tasks begin with the fewer. Whether somebody can do a
//! task is found out by whoever plays it.

pub mod compatibility;
pub(crate) mod describe;
mod draft;
pub mod grid;
mod ground;
mod make;
pub mod placement;
pub mod real;
pub mod report;
mod settle;
mod statistics;
pub(crate) mod wording;

pub use compatibility::Compatibility;
pub use draft::{Difficulty, DraftError, TaskType};
pub use ground::{SceneSites, Side, Site};
pub use make::{GenerateOptions, GenerateReport, MakeError, Placing, make};
pub use settle::{FALL_MAX_M, FARTHEST_M, SettleError, can_be_approached, settle, spawn};
pub use statistics::{Rejection, Statistics};
