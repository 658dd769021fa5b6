//! The rule-based simulated user (SPEC section 3): goal-driven, never tells the exact place, names the target only
//! after the robot saw it, never speaks raw ids.

use reel_world::{InstanceId, Task, record::UserReply};

/// What the user knows: the task, and the last auxiliary observation (paper, Simulated User Module).
#[derive(Clone, Debug)]
pub struct RuleUser {}

impl RuleUser {
    /// A user for a task.
    pub fn new(task: &Task) -> Self {
        let _ = task;
        unimplemented!("by the reward helper")
    }

    /// Replaces the auxiliary observation: the action the robot just took and the objects it sees.
    pub fn observe(&mut self, action: &str, visible: &[InstanceId]) {
        let _ = (action, visible);
        unimplemented!("by the reward helper")
    }

    /// Answers a question.
    pub fn answer(&mut self, question: &str) -> UserReply {
        let _ = question;
        unimplemented!("by the reward helper")
    }
}
