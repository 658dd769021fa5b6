//! What each capability of an agent cost: failed episodes played again with one capability
//! perfect and everything else as recorded, and what that does to the success rate.
//!
//! Never a prediction: an episode counts as rescued only if its branch succeeded in the
//! simulator.

mod agent;
mod estimate;
mod known;
mod played;

use serde::{Deserialize, Serialize};

pub use estimate::{Estimate, Interval, clustered_interval, estimates};
pub use known::known_success;
pub use played::{Attributed, AttributionOptions, CapabilityBranch, attribute, attribute_all};

/// A capability that can be made perfect on its own.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Capability {
    /// Telling apart by look: no pick or place of something that looks different from what is
    /// meant.
    Perception,
    /// Asking where several things fit.
    Communication,
    /// Acting on what was seen before: no return to searched places, no repeated failing call,
    /// no number of an earlier marker map.
    Memory,
    /// The skills of the robot: none fails, and motion has no noise.
    Primitives,
}

impl Capability {
    /// Every capability, in the order of reports.
    pub const ALL: [Capability; 4] = [
        Capability::Perception,
        Capability::Communication,
        Capability::Memory,
        Capability::Primitives,
    ];

    /// The name in JSON and tables.
    pub fn name(self) -> &'static str {
        match self {
            Capability::Perception => "perception",
            Capability::Communication => "communication",
            Capability::Memory => "memory",
            Capability::Primitives => "primitives",
        }
    }
}
