//! One module a command: its arguments, and what it does.

pub mod bench;
#[cfg(feature = "analytics")]
pub mod demo;
pub mod export;
pub mod frames;
pub mod gate;
#[cfg(feature = "analytics")]
pub mod ingest;
pub mod mint;
#[cfg(feature = "analytics")]
pub mod query;
pub mod replay;
pub mod run;
pub mod show;
pub mod tasks;
