//! One module a command: its arguments, and what it does.

pub mod bench;
#[cfg(feature = "analytics")]
pub mod demo;
pub mod doctor;
pub mod explain;
pub mod export;
pub mod frames;
pub mod gate;
pub mod import;
#[cfg(feature = "analytics")]
pub mod ingest;
pub mod mint;
pub mod paranoid;
#[cfg(feature = "analytics")]
pub mod query;
pub mod recover;
pub mod repack;
pub mod replay;
#[cfg(feature = "analytics")]
pub mod reward;
pub mod run;
pub mod show;
#[cfg(feature = "analytics")]
pub mod tables;
pub mod tasks;
