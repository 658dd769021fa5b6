//! The simulator: rapier world, navigation, camera and rasterizer, tool handlers, state digests.
//!
//! Deterministic: no clock, thread, environment, file, hash-order container or `std` transcendental
//! (`clippy.toml` bans them).

pub mod geometry;
pub mod model;
pub mod nav;
pub mod physics;
pub mod placement;
pub mod render;
pub mod stress;

mod math;
mod outside;
mod simulator;
mod skills;
mod snapshot;
mod stage;
mod tools;

pub use simulator::{SPAWN_SETTLE_STEPS, Simulator, VISIBLE_PIXELS};
pub use skills::{Luck, Primitive};
pub use snapshot::{Snapshot, SnapshotError};
pub use stage::Stage;
pub use tools::{Given, ToolResult};

/// Changes whenever any golden changes; the reason goes into `traces/golden/NOTES.md`, and in a line below.
pub const SIM_VERSION: u32 = SIM_CHANGES.len() as u32;

/// What each version of the simulator changed, the first one first.
pub const SIM_CHANGES: &[&str] = &[
    "the first simulator",
    "mathematics from the libm crate instead of the C library: the inertia of compounds differs in its last bits",
];
