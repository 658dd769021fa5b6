//! What a policy is, what it is shown, and the policies by name. Never how one decides.

use std::sync::Arc;

use crate::plan::ObjectIndex;
use reel_episode::{Briefing, Observation, Privileged};
use reel_world::{
    Attributes, ObjectInstance, ReceptacleId, Scene, Task,
    record::{PolicyInfo, StepInput},
};

use crate::{AgentError, Explorer, GoalHint, Oracle, Planner, ResponderError, faults};

/// What decides in an episode.
pub trait Policy {
    /// Name and settings, for the trace.
    fn info(&self) -> PolicyInfo;

    /// Whether it reads the simulator's truth. A policy under evaluation never does.
    fn needs_privileged(&self) -> bool;

    /// The next call.
    ///
    /// # Errors
    /// When whoever it asks does not answer. The episode ends there, as aborted. What can be told
    /// to it as feedback (an unknown tool, an answer without a call) is no such error.
    fn act(&mut self, context: &PolicyContext<'_>) -> Result<StepInput, ResponderError>;

    /// Is shown a call that somebody else decided where it would have been asked, before what comes
    /// of it: takes in what it would have learnt and remembered had it made this call itself. There
    /// is no truth in the context. Who keeps nothing from call to call has nothing to do.
    fn observe(&mut self, _context: &PolicyContext<'_>, _input: &StepInput) {}

    /// Why it gave up on the goal, if it did.
    fn gave_up(&self) -> Option<String> {
        None
    }
}

/// What a policy knows when it decides.
#[derive(Clone, Copy, Debug)]
pub struct PolicyContext<'a> {
    /// What it was told at the start.
    pub briefing: &'a Briefing,
    /// What its last call gave.
    pub observation: &'a Observation,
    /// What a perfect eye reads from the image and the text of the last call.
    pub perceived: &'a [PerceivedItem],
    /// The simulator's truth, only for a policy that wants it.
    pub truth: Option<&'a Privileged<'a>>,
    /// Decisions taken so far.
    pub step: u32,
}

/// One thing in view, numbered or told of: the stand-in for perception of the built-in policies.
/// It holds no identifier of an object and no position.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct PerceivedItem {
    /// Its number, where it has one.
    pub marker: Option<u32>,
    /// Whether it is a receptacle; else it is an object.
    pub furniture: bool,
    /// Category of the object or furniture, e.g. `alarm clock`.
    pub category: String,
    /// How one would describe it. Of a receptacle's captions the one that stands in the
    /// instruction, if any: who knows the instruction sees that it fits.
    pub caption: Option<String>,
    /// Colour, material, shape and size words of an object, as one sees them.
    pub attributes: Attributes,
    /// For an object the receptacle it is seen on; for a receptacle which of the briefing's it is.
    pub receptacle_hint: Option<ReceptacleId>,
    /// For an object a number that it keeps for the whole episode: who follows things with the
    /// eyes knows them again.
    pub object: Option<ObjectIndex>,
}

impl PerceivedItem {
    /// As an object that has a look and no name.
    pub(crate) fn described(&self) -> ObjectInstance {
        ObjectInstance {
            instance: String::new().into(),
            asset: String::new().into(),
            category: self.category.clone(),
            caption: self.caption.clone(),
            attributes: self.attributes.clone(),
            size: [0.0; 3],
            position: [0.0; 3],
            yaw: 0.0,
            receptacle: String::new().into(),
            reference_rest: None,
        }
    }
}

/// Every built-in policy: name and what it does, in one line.
#[rustfmt::skip]
pub const POLICIES: &[(&str, &str)] = &[
    (
        "oracle",
        "knows the truth and follows the published plan (paper, Oracle Trajectory Generation)",
    ),
    (
        "planner",
        "sees only what an agent sees: searches the candidates, remembers, asks when several fit",
    ),
    (
        "planner-words",
        "the planner with nothing but the words: any furniture and object of the kind they name may be meant",
    ),
    ("wrong-object", "the oracle, but it takes a similar object for the target"),
    ("wrong-receptacle", "the oracle, but it takes a similar receptacle for the destination"),
    ("no-ask", "the oracle, but it never asks and takes any object that fits the instruction"),
    ("oscillating", "the oracle up to the pick, then it drives to and fro until the horizon"),
    ("forgets-door", "the oracle, but it never opens a door"),
    (
        "gibberish",
        "the oracle, but now and then it calls unknown tools, bad arguments or stale numbers",
    ),
    (
        "explorer",
        "tries every tool on whatever it sees, at random, to find what breaks; it wants no goal",
    ),
];

/// A built-in policy by name. `seed` is of everything random in it.
///
/// # Errors
/// When no policy is called so.
pub fn policy(
    name: &str,
    task: &Arc<Task>,
    scene: &Arc<Scene>,
    seed: u64,
) -> Result<Box<dyn Policy + Send>, AgentError> {
    Ok(match name {
        "oracle" => Box::new(Oracle::new(task.clone(), seed)),
        "planner" => Box::new(Planner::new(GoalHint::of_task(task), seed)),
        "planner-words" => Box::new(Planner::new(GoalHint::of_words(task, scene), seed)),
        "wrong-object" => Box::new(faults::wrong_object(task, seed)),
        "wrong-receptacle" => Box::new(faults::wrong_receptacle(task, scene, seed)),
        "no-ask" => Box::new(faults::no_ask(task, seed)),
        "oscillating" => Box::new(faults::Oscillating::new(task, scene, seed)),
        "forgets-door" => Box::new(faults::forgets_door(task, seed)),
        "gibberish" => Box::new(faults::Gibberish::new(task, seed)),
        "explorer" => Box::new(Explorer::new(task, seed)),
        _ => {
            return Err(AgentError::UnknownPolicy {
                name: name.to_owned(),
            });
        }
    })
}

/// The names, for messages.
pub(crate) fn names() -> String {
    POLICIES
        .iter()
        .map(|(name, _)| *name)
        .collect::<Vec<_>>()
        .join(", ")
}

/// Name and seed of a built-in policy.
pub(crate) fn info(name: &str, seed: u64) -> PolicyInfo {
    PolicyInfo {
        name: name.to_owned(),
        checkpoint: None,
        parameters: [("seed".to_owned(), seed.into())].into(),
    }
}
