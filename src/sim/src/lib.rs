//! The simulator: rapier world, navigation, camera and rasterizer, tool handlers, state digests.
//!
//! Deterministic: no clock, thread, environment, file, hash-order container or `std`
//! transcendental (`clippy.toml` bans them).

pub mod geometry;
pub mod model;
pub mod nav;
pub mod physics;
pub mod placement;
pub mod published;
pub mod render;
pub mod stress;

mod drawn_bodies;
mod external_camera;
mod math;
mod motion_sampler;
mod perception;
mod prepared_task;
mod simulator;
mod skills;
mod snapshot;
mod tools;

pub use drawn_bodies::{DrawnBody, held_pose, robot_pose};
pub use motion_sampler::MotionSample;
pub use perception::{Perception, Segment};
pub use prepared_task::PreparedTask;
pub use simulator::{SPAWN_SETTLE_STEPS, Simulator, VISIBLE_PIXELS};
pub use skills::ActuationNoise;
pub use snapshot::{Snapshot, SnapshotError};
pub use tools::{CallContext, ToolResult};

use reel_world::Profile;

/// Version of this simulator: changes whenever any golden changes; the reason goes into
/// `traces/golden/NOTES.md`, and in a line below.
pub const SIM_VERSION: u32 = SIM_CHANGES.len() as u32;

/// A change of the simulator.
#[derive(Clone, Copy, Debug)]
pub struct SimChange {
    /// The profiles whose episodes it changes.
    pub profiles: &'static [Profile],
    /// What the version changes, in words for people.
    pub text: &'static str,
}

/// What each version of the simulator changed, the first one first.
pub const SIM_CHANGES: &[SimChange] = &[
    SimChange {
        profiles: &Profile::ALL,
        text: "the first simulator",
    },
    SimChange {
        profiles: &Profile::ALL,
        text: "mathematics from the libm crate instead of the C library: the inertia of compounds differs in its last bits",
    },
    SimChange {
        profiles: &[Profile::RealRepo, Profile::RealGspo],
        text: "the published servers' tools to the letter: what they refuse and say, markers, where things are put, physics steps",
    },
    SimChange {
        profiles: &[Profile::RealRepo, Profile::RealGspo],
        text: "a search without a match is recorded as nothing_found, the answer of the published servers' user as a reply",
    },
    SimChange {
        profiles: &[Profile::Paper],
        text: "show_receptacles marks the projected boxes of receptacles, as the paper does, instead of their pixels",
    },
];

/// The version whose episodes of a profile this simulator plays: that of the last
/// change that concerns it.
pub fn sim_version(profile: Profile) -> u32 {
    let concerns = |(_, change): &(u32, &SimChange)| change.profiles.contains(&profile);
    (1..)
        .zip(SIM_CHANGES)
        .filter(concerns)
        .map(|(version, _)| version)
        .last()
        .unwrap_or(SIM_VERSION)
}
