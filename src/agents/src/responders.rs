//! Who answers from outside while an episode runs: a user, and whoever knows what a query means.
//! Every answer becomes an input of the step, so that replay asks nobody.

use std::{collections::BTreeMap, error::Error};

use reel_episode::user::violations;
use reel_world::{
    InstanceId, Scene, Task, WorldGraph,
    record::{Lookup, StartRecord, StepRecord, UserReply},
};
use serde_json::Value;

/// Whoever was asked does not answer.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub struct ResponderError(pub Box<dyn Error + Send + Sync>);

impl ResponderError {
    /// Wraps the error that explains why no answer came.
    pub fn new(why: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        Self(why.into())
    }
}

/// A simulated user, or a real one.
pub trait User {
    /// Answers a question of the robot.
    ///
    /// # Errors
    /// When it cannot be reached.
    fn answer(&mut self, asked: &UserQuestion<'_>) -> Result<UserReply, ResponderError>;
}

/// A question, and what a user knows of the world when it is asked (docs/spec.md#simulated-user):
/// never a pose, never an image.
#[derive(Clone, Copy, Debug)]
pub struct UserQuestion<'a> {
    /// Text that the robot asks the user.
    pub question: &'a str,
    /// The task, goal included: it is the user's.
    pub task: &'a Task,
    /// Scene that the episode plays in.
    pub scene: &'a Scene,
    /// Where everything was at the start.
    pub initial: &'a WorldGraph,
    /// What happened before. The last step is what the auxiliary observation is of.
    pub steps: &'a [StepRecord],
    /// What the robot saw before the first call.
    pub seen_at_start: &'a [InstanceId],
}

impl UserQuestion<'_> {
    /// What the robot sees now: in the image, or told in words.
    pub fn sees(&self) -> Vec<&InstanceId> {
        match self.steps.last() {
            Some(step) => seen(step).collect(),
            None => self.seen_at_start.iter().collect(),
        }
    }

    /// Whether the robot has seen the target by now.
    pub fn saw_target(&self) -> bool {
        let is_target = |object: &InstanceId| *object == self.task.target;
        self.seen_at_start.iter().any(is_target)
            || self.steps.iter().any(|step| seen(step).any(is_target))
    }
}

fn seen(step: &StepRecord) -> impl Iterator<Item = &InstanceId> {
    step.visible
        .iter()
        .map(|object| &object.object)
        .chain(&step.listed)
        .chain(&step.held)
}

/// Whoever knows which categories a query means.
pub trait Matcher {
    /// Those of the categories that a query means; none at all is an answer, too.
    ///
    /// # Errors
    /// When it cannot be reached.
    fn look_up(&mut self, query: &str, categories: &[&str]) -> Result<Lookup, ResponderError>;
}

/// Who answers from outside. Without a user the rules answer, without a matcher the vocabulary.
#[derive(Default)]
pub struct Responders {
    /// Answers the `ask` tool; `None` if the rule-based user does.
    pub user: Option<Box<dyn User + Send>>,
    /// Says what `show_object_by_category` shall look for.
    pub matcher: Option<Box<dyn Matcher + Send>>,
    /// Who they are, for the trace: beside the policy's own settings.
    pub settings: BTreeMap<String, Value>,
}

/// The rules of the simulated user that replies from outside broke, one for each time.
pub(crate) fn broken_rules(
    task: &Task,
    scene: &Scene,
    start: &StartRecord,
    steps: &[StepRecord],
) -> Vec<&'static str> {
    let seen_at_start: Vec<InstanceId> = start
        .visible
        .iter()
        .map(|object| object.object.clone())
        .collect();
    let replies = steps
        .iter()
        .enumerate()
        .filter_map(|(index, step)| Some((index, step.input.user_reply.as_ref()?)));
    let broken = replies.flat_map(|(index, reply)| {
        let (initial, steps) = (&start.graphs.physics, &steps[..index]);
        let asked = UserQuestion {
            question: "",
            task,
            scene,
            initial,
            steps,
            seen_at_start: &seen_at_start,
        };
        violations(task, scene, &reply.text, asked.saw_target())
    });
    broken.collect()
}
