//! An episode at one of its steps, as those know it who answer from outside while it goes on.

use std::{path::PathBuf, sync::Arc};

use reel_episode::user::UserQuestion;
use reel_world::{InstanceId, Scene, Task, WorldGraph, record::StepRecord};

/// Which step of which episode is next.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct EpisodePosition {
    /// The trace that the episode becomes.
    pub recording: PathBuf,
    /// How many calls were made.
    pub step: u32,
}

/// What there is to know at a step, the goal included: never for the policy.
#[derive(Clone, Debug)]
pub struct Situation {
    /// The step that is next.
    pub position: EpisodePosition,
    /// The task, goal included.
    pub task: Arc<Task>,
    /// Scene that the episode plays in.
    pub scene: Arc<Scene>,
    /// Where everything was at the start.
    pub initial: WorldGraph,
    /// What the robot saw before the first call.
    pub seen_at_start: Vec<InstanceId>,
    /// The calls so far, and what came of them.
    pub steps: Vec<StepRecord>,
}

impl Situation {
    /// A question at this step, for a simulated user.
    pub fn question<'a>(&'a self, question: &'a str) -> UserQuestion<'a> {
        UserQuestion {
            question,
            task: &self.task,
            scene: &self.scene,
            initial: &self.initial,
            steps: &self.steps,
            seen_at_start: &self.seen_at_start,
            refused: &[],
        }
    }
}
