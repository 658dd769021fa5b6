//! A question, and what the user knows of the world when it is asked.

use reel_world::{
    InstanceId, ObjectInstance, Scene, Task, WorldGraph,
    language::{fits, names_object, words},
    record::{Marker, MarkerTarget, RefusedReply, StepRecord},
};

/// Says that the robot sees something.
const SEEING: [&str; 14] = reel_world::words! {
    see sees seeing seen saw found find spotted notice noticed visible there showing identified
};

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
    /// What the user said to this question and the robot did not get, because it gave something away.
    pub refused: &'a [RefusedReply],
}

impl UserQuestion<'_> {
    /// What the robot sees now, the objects of the auxiliary observation: those in the image of the
    /// last step, those that its result told in words, and what the gripper holds.
    pub fn sees(&self) -> Vec<&InstanceId> {
        match self.steps.last() {
            Some(step) => step
                .visible
                .iter()
                .map(|object| &object.object)
                .chain(&step.listed)
                .chain(&step.held)
                .collect(),
            None => self.seen_at_start.iter().collect(),
        }
    }

    /// Whether the robot has reported seeing the target: it listed or numbered it by a call, holds
    /// it, or says in a question that it sees something that fits it. That some pixels of the target
    /// were in an image is no report.
    pub fn reported_target(&self) -> bool {
        let target = self.task.target_object();
        let id = &target.instance;
        let told = |step: &StepRecord| {
            let marked = |marker: &Marker| marker.target == MarkerTarget::Object(id.clone());
            step.held.as_ref() == Some(id)
                || step.listed.contains(id)
                || step.markers.iter().any(marked)
        };
        let asked = self.steps.iter().filter_map(question);
        self.steps.iter().any(told)
            || asked
                .chain([self.question])
                .any(|question| reports(question, target))
    }
}

/// The question of a step, if it is one.
fn question(step: &StepRecord) -> Option<&str> {
    step.reply.as_ref()?;
    step.input.call.arguments.get("question")?.as_str()
}

/// Whether a text says that the robot sees something that an object fits.
fn reports(text: &str, object: &ObjectInstance) -> bool {
    words(text)
        .iter()
        .any(|word| SEEING.contains(&word.as_str()))
        && names_object(text)
        && fits(text, object, None)
}
