//! What is wrong with the texts of an episode: each is looked at once, however many examples repeat
//! it. Owns what is refused; what privileged text looks like is told elsewhere.

use std::{borrow::Cow, fmt};

use crate::{
    Episode, LeakKind, PrivilegedFacts, Step,
    privileged::{JSON_TRIES_MAX, find_leak},
};

/// A decision that did not become an example, or an episode that gave none.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct RefusedDecision {
    /// Id of the episode that the decision belongs to.
    pub episode_id: String,
    /// The decision; none where the whole episode was refused.
    pub call: Option<u32>,
    /// Why the decision or the whole episode is refused.
    pub reason: RefusalReason,
}

/// Why a decision is refused.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum RefusalReason {
    /// Something that an agent must not know is in a text.
    Leak {
        /// The kind of privileged text that was found.
        kind: LeakKind,
        /// In which text, e.g. `History of call 3`.
        field: String,
        /// The privileged text, cut to its first 80 characters.
        excerpt: String,
    },
    /// A text holds what trainers take for an image or a turn.
    Tag {
        /// The tag that the text holds, e.g. `<image>`.
        tag: &'static str,
        /// Name of the text that holds the tag, e.g. `History of call 3`.
        field: String,
    },
}

impl fmt::Display for RefusalReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            RefusalReason::Leak {
                kind,
                field,
                excerpt,
            } => write!(f, "{field} holds {kind}: {excerpt:?}"),
            RefusalReason::Tag { tag, field } => write!(
                f,
                "{field} holds {tag:?}, which trainers take for a turn or an image"
            ),
        }
    }
}

/// Why a text is refused, by the name of the text.
pub(crate) fn refusal(
    text: &str,
    secrets: &PrivilegedFacts,
    field: impl Fn() -> String,
) -> Option<RefusalReason> {
    if text.is_empty() {
        return None;
    }
    refusal_but_for(&[], text, secrets, field)
}

/// [`refusal`], with these tags allowed.
fn refusal_but_for(
    allowed: &[&str],
    text: &str,
    secrets: &PrivilegedFacts,
    field: impl Fn() -> String,
) -> Option<RefusalReason> {
    let mut tags = CONTROL_TAGS.iter().filter(|tag| !allowed.contains(tag));
    let tag = tags.find(|tag| text.contains('<') && text.contains(**tag));
    if let Some(tag) = tag {
        return Some(RefusalReason::Tag {
            tag,
            field: field(),
        });
    }
    let leak = find_leak(text, secrets)?;
    Some(RefusalReason::Leak {
        kind: leak.kind,
        field: field(),
        excerpt: leak.excerpt(text),
    })
}

/// Whether one look at many texts says that none of them needs a look of its own. What stands
/// between them is in no JSON, so that none goes on from one text to the next and hides what
/// the next one holds.
pub(crate) fn clean<'t>(
    texts: impl IntoIterator<Item = &'t str>,
    secrets: &PrivilegedFacts,
) -> bool {
    let together = texts
        .into_iter()
        .filter(|text| !text.is_empty())
        .collect::<Vec<_>>()
        .join("\n\0\n");
    together.matches(['{', '[']).count() <= JSON_TRIES_MAX
        && refusal(&together, secrets, String::new).is_none()
}

/// What is wrong with each text of the decisions of an episode; empty where nothing
/// is wrong with any.
pub(crate) struct Checks {
    steps: Vec<StepChecks>,
}

struct StepChecks {
    reasoning: Option<RefusalReason>,
    history: Option<RefusalReason>,
    /// New Schedule, Current subtask.
    plan: Option<RefusalReason>,
    action: Option<RefusalReason>,
    outcome: Option<RefusalReason>,
}

impl Checks {
    /// Looks at an episode with its arguments as JSON and its outcomes without payloads.
    pub fn of(episode: &Episode, arguments: &[String], outcomes: &[Cow<'_, str>]) -> Self {
        let secrets = episode.briefing.secrets();
        let steps = episode.steps.iter().zip(arguments).zip(outcomes);
        let as_they_came = episode.steps.iter().any(|step| step.answer.is_some());
        let texts = steps.clone().flat_map(|((step, arguments), outcome)| {
            let Step {
                reasoning,
                history,
                schedule,
                subtask,
                call_name,
                message,
                ..
            } = step;
            [
                message,
                reasoning,
                history,
                schedule,
                subtask,
                call_name,
                arguments.as_str(),
                outcome,
            ]
        });
        if !as_they_came && clean(texts, secrets) {
            return Self { steps: Vec::new() };
        }
        let steps = steps.map(|((step, arguments), outcome)| {
            let check = |what: &str, text: &str| {
                refusal(text, secrets, || format!("{what} of call {}", step.call))
            };
            if let Some(answer) = &step.answer {
                // All of it is in the row, and later prompts remember of it what they want: without JSON's escapes.
                let field = || format!("the answer of call {}", step.call);
                let read = [answer, &step.history, &step.call_name, arguments];
                let refused = |text: &String| refusal_but_for(&THOUGHT_TAGS, text, secrets, field);
                return StepChecks {
                    reasoning: None,
                    history: read.into_iter().find_map(refused),
                    plan: None,
                    action: None,
                    outcome: check("the outcome", outcome),
                };
            }
            StepChecks {
                reasoning: check("the reasoning", &step.reasoning),
                history: check("the History", &step.history),
                plan: check("the New Schedule", &step.schedule)
                    .or_else(|| check("the Current subtask", &step.subtask)),
                action: check("the tool", &step.call_name)
                    .or_else(|| check("the arguments", arguments))
                    .or_else(|| check("the words", &step.message)),
                outcome: check("the outcome", outcome),
            }
        });
        Self {
            steps: steps.collect(),
        }
    }

    /// Of a decision with every History up to it, and the action and outcome before it.
    pub fn single_turn(&self, index: usize) -> Option<&RefusalReason> {
        let StepChecks {
            reasoning,
            plan,
            action,
            ..
        } = self.steps.get(index)?;
        let said = [reasoning, plan, action]
            .into_iter()
            .find_map(Option::as_ref);
        let remembered = || {
            self.steps[..=index]
                .iter()
                .find_map(|step| step.history.as_ref())
        };
        said.or_else(remembered)
            .or_else(|| self.call(index.checked_sub(1)?))
    }

    /// Of a call and its outcome.
    pub fn call(&self, index: usize) -> Option<&RefusalReason> {
        let step = self.steps.get(index)?;
        step.action.as_ref().or(step.outcome.as_ref())
    }

    /// Of a conversation up to and with a decision; its state is not in it.
    pub fn conversation(&self, target: usize) -> Option<&RefusalReason> {
        let said = self
            .steps
            .iter()
            .take(target + 1)
            .find_map(|step| step.reasoning.as_ref().or(step.action.as_ref()));
        said.or_else(|| {
            self.steps
                .iter()
                .take(target)
                .find_map(|step| step.outcome.as_ref())
        })
    }
}

/// What an answer as it came is made of, and no trainer takes out of it.
const THOUGHT_TAGS: [&str; 4] = ["<think>", "</think>", "<tool_call>", "</tool_call>"];

/// What trainers and templates take for images, turns or thoughts.
const CONTROL_TAGS: [&str; 10] = reel_world::words! {
    "<image>" "<video>" "<audio>" "<|" "<think>" "</think>" "<tool_call>" "</tool_call>"
    "<tool_response>" "</tool_response>"
};
