//! Symbolic planning over task and world graph: the published plan of a task as intents, a plan
//! from any state to the goal, and its cost in tool calls.
//!
//! Pure functions. Never perception, geometry, randomness or the simulator: who turns an intent
//! into calls is a policy.

mod belief;
mod cost;
mod planner;
mod published;

use std::fmt;

use reel_world::{InstanceId, ReceptacleId, Scene, Task, WorldGraph};

pub use belief::{
    Belief, CallEffect, DeliveryGoal, Move, ObjectIndex, Objection, PerceivedView, Presumption,
};
pub use cost::{calls, cost_to_go};
pub use planner::plan;
pub use published::published_plan;

/// One thing to get done: a few tool calls each (paper, Algorithm "Oracle Trajectory Generation").
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Intent {
    /// Stand at the receptacle.
    NavTo(ReceptacleId),
    /// Look for the object where the robot stands, until it is gazed at.
    Find {
        /// What to ask the detector for.
        category: String,
        /// Instance id of the object to find.
        target: InstanceId,
    },
    /// Pick up the object with this instance id.
    Pick(InstanceId),
    /// Put what is held on the receptacle.
    Place(ReceptacleId),
    /// Open the door of the receptacle.
    Open(ReceptacleId),
    /// Close the door of the receptacle.
    Close(ReceptacleId),
    /// Ask the user what is meant.
    Ask {
        /// The object to bring about which it is asked.
        about: InstanceId,
        /// What to say, word for word; none where it depends on what is seen.
        question: Option<String>,
    },
    /// Call `finish` to end the episode.
    Finish,
}

impl fmt::Display for Intent {
    /// In words that hold no identifier of an object, so that a policy may say them.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Intent::NavTo(receptacle) => write!(f, "go to {receptacle}"),
            Intent::Find { category, .. } => write!(f, "find the {category}"),
            Intent::Pick(_) => f.write_str("pick it up"),
            Intent::Place(receptacle) => write!(f, "place it on {receptacle}"),
            Intent::Open(receptacle) => write!(f, "open {receptacle}"),
            Intent::Close(receptacle) => write!(f, "close {receptacle}"),
            Intent::Ask { .. } => f.write_str("ask which one is meant"),
            Intent::Finish => f.write_str("finish"),
        }
    }
}

/// A moment to plan from.
#[derive(Clone, Copy, Debug)]
pub struct PlanningState<'a> {
    /// The task, goal included.
    pub task: &'a Task,
    /// The scene: which receptacles may be placed upon.
    pub scene: &'a Scene,
    /// Where everything is now.
    pub graph: &'a WorldGraph,
    /// What the gripper holds.
    pub held: Option<&'a InstanceId>,
    /// The receptacle the robot stands at.
    pub at: Option<&'a ReceptacleId>,
}

/// Why no plan leads to the goal.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("{object} cannot be brought to its goal: {reason}")]
pub struct Unreachable {
    /// Instance id of the object that cannot reach its goal.
    pub object: InstanceId,
    /// What is in the way.
    pub reason: String,
}

#[cfg(test)]
mod tests;
