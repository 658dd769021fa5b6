//! The fault library: episodes that fail in a known way, or nearly fail. An injection says what
//! goes wrong where; a policy acts it out on top of the oracle; a label says what came of it.
//!
//! Written from the paper's descriptions of failures (docs/spec.md#failure-taxonomy).
//! Never anything of the rules that classify: the two share nothing but the names of
//! classes and sub-classes. What a policy cannot cause (something falls, a robot's skill
//! fails) is no kind here.

mod choices;
mod clutter;
mod faults;
mod injected;
mod kind;
mod label;
mod plan;
mod sample;
mod scripted_call;
mod voice;

use reel_world::ReceptacleId;
use serde::{Deserialize, Serialize};

pub use clutter::cluttered;
pub use injected::Injected;
pub use kind::{Detour, FaultKind};
pub use label::{FaultLabel, Label, Primary};
pub use sample::{SampleOptions, admitted, paper_mix, sample};

/// One thing that goes wrong.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub struct Fault {
    /// Kind of fault that the policy acts out.
    pub kind: FaultKind,
    /// Where along the episode, from 0 to 1, where the kind leaves a choice.
    pub position: f64,
    /// How often or how long, from 1 to 3; where it is not repaired it may go on to the end.
    pub strength: u32,
    /// Whether the agent notices and corrects it.
    pub repaired: bool,
}

impl Fault {
    /// A fault in the middle of the episode, of middle strength, that is never corrected.
    pub fn new(kind: FaultKind) -> Self {
        Self {
            kind,
            position: 0.5,
            strength: 2,
            repaired: false,
        }
    }
}

/// What goes wrong in an episode. Without faults and detours: nothing does.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct Injection {
    /// What goes wrong, in any order.
    pub faults: Vec<Fault>,
    /// What is needless but harmless.
    pub detours: Vec<Detour>,
    /// Decides everything else: which object, which receptacle, how many turns, what is
    /// said, how it ends.
    pub seed: u64,
}

/// Why a task does not admit an injection.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum InjectionError {
    /// The kind wants an instruction that leaves open what is meant.
    #[error("{kind}: the instruction is precise; take a task with an underspecified one")]
    Precise { kind: FaultKind },
    /// The kind wants an instruction that says what is meant.
    #[error(
        "{kind}: the instruction is underspecified, so a wrong object would be a question not asked; take a precise task"
    )]
    Underspecified { kind: FaultKind },
    /// No object that could be taken by that fault.
    #[error("{kind}: the task has no object that could be taken by it")]
    NoObject { kind: FaultKind },
    /// No receptacle that the target could be put on by that fault.
    #[error("{kind}: the scene has no receptacle for it; the destination is {destination}")]
    NoReceptacle {
        kind: FaultKind,
        destination: ReceptacleId,
    },
    /// No door stands in the way.
    #[error("{kind}: no closed door is between {source_id} and {destination}")]
    NoDoor {
        kind: FaultKind,
        source_id: ReceptacleId,
        destination: ReceptacleId,
    },
    /// What is done by that fault cannot be undone.
    #[error("{kind}: it ends the episode and cannot be repaired")]
    NotRepairable { kind: FaultKind },
    /// One fault keeps the other from coming about.
    #[error("{first} and {second} exclude each other in this order or at all")]
    Conflict { first: FaultKind, second: FaultKind },
    /// A number is out of its range.
    #[error(
        "{kind}: position {position} must be within 0..=1 and strength {strength} within 1..=3"
    )]
    Range {
        kind: FaultKind,
        /// Position as requested, formatted as text; valid is 0 to 1.
        position: String,
        /// Strength as requested; valid is 1 to 3.
        strength: u32,
    },
}
