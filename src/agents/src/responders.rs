//! Who answers from outside while an episode runs: a user, and whoever knows what a query means.
//! Every answer becomes an input of the step, so that replay asks nobody.

use std::{collections::BTreeMap, error::Error};

use reel_episode::user::{UserQuestion, leaks, violations};
use reel_world::{
    InstanceId, Scene, Task,
    record::{Lookup, RefusedReply, StartRecord, StepInput, StepRecord, UserReply, UserSource},
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

/// How often a user is asked one question until it gives nothing away.
pub const USER_TRIES: usize = 3;

/// Asks a user for the reply of a step. A model's reply that gives something away
/// ([`reel_episode::user::leaks`]) or is empty is kept as refused, and the model is asked again, told why; after
/// [`USER_TRIES`] of them there is no reply from outside, and the rule-based user answers. What a
/// person says stands.
///
/// # Errors
/// When the user cannot be reached.
pub fn ask_user(
    user: &mut dyn User,
    asked: &UserQuestion<'_>,
    input: &mut StepInput,
) -> Result<(), ResponderError> {
    while input.refused_replies.len() < USER_TRIES {
        let reply = user.answer(&UserQuestion {
            refused: &input.refused_replies,
            ..*asked
        })?;
        let broken = match reply.source {
            UserSource::Model if reply.text.trim().is_empty() => vec!["empty"],
            UserSource::Model => leaks(asked.task, asked.scene, &reply.text),
            UserSource::RuleBased | UserSource::Human => Vec::new(),
        };
        if broken.is_empty() {
            input.user_reply = Some(reply);
            return Ok(());
        }
        input.refused_replies.push(RefusedReply {
            text: reply.text,
            rules: broken.into_iter().map(str::to_owned).collect(),
        });
    }
    Ok(())
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
        .filter_map(|(index, step)| Some((index, step, step.input.user_reply.as_ref()?)));
    let broken = replies.flat_map(|(index, step, reply)| {
        let question = step.input.call.argument().unwrap_or_default();
        let asked = UserQuestion {
            question: &question,
            task,
            scene,
            initial: &start.graphs.physics,
            steps: &steps[..index],
            seen_at_start: &seen_at_start,
            refused: &[],
        };
        violations(task, scene, &reply.text, asked.reported_target())
    });
    broken.collect()
}

/// The rules that refused replies broke, one for each reply and rule.
pub(crate) fn refused_rules(steps: &[StepRecord]) -> Vec<String> {
    let refused = steps.iter().flat_map(|step| &step.input.refused_replies);
    refused.flat_map(|reply| reply.rules.clone()).collect()
}
