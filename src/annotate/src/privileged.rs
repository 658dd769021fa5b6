//! What an agent cannot know, and whether a note says it. Used on what a model writes; what the
//! rules write cannot know it. What no agent may ever know is found by [`reel_dataset::find_leak`];
//! owned here is what it has not seen or heard yet.

use reel_dataset::{LeakKind, find_leak};
use reel_world::{Task, language};
use serde_json::{Value, json};

use crate::{Annotation, Step, step::MarkedItem};

/// The truth about a task, for the annotator's eyes only.
#[derive(Clone, Debug)]
pub struct PrivilegedFacts {
    ids: reel_dataset::PrivilegedFacts,
    things: Vec<Secret>,
    instruction: String,
    precise: Option<String>,
    goal: Vec<String>,
    target: String,
}

/// An object and its looks.
#[derive(Clone, PartialEq, Debug)]
struct Secret {
    key: String,
    category: String,
    caption: Option<String>,
    receptacle: String,
}

impl PrivilegedFacts {
    /// What is true of a task.
    pub fn of(task: &Task) -> Self {
        let raw = |id: &str| id.contains('_') || id.chars().any(|letter| letter.is_ascii_digit());
        let ids = task
            .objects
            .iter()
            .flat_map(|object| [object.instance.as_str(), object.asset.as_str()]);
        PrivilegedFacts {
            ids: reel_dataset::PrivilegedFacts::new(
                ids.filter(|id| raw(id)).map(|id| (LeakKind::Instance, id)),
                task.initial.receptacles.keys().map(|id| id.as_str()),
            ),
            things: task
                .objects
                .iter()
                .map(|object| Secret {
                    key: object.instance.to_string(),
                    category: object.category.clone(),
                    caption: object.caption.clone(),
                    receptacle: object.receptacle.to_string(),
                })
                .collect(),
            instruction: task.instruction.clone(),
            precise: (task.precise_instruction != task.instruction)
                .then(|| task.precise_instruction.clone()),
            goal: task
                .goal_changes()
                .iter()
                .map(ToString::to_string)
                .collect(),
            target: task.target.to_string(),
        }
    }

    /// What is wrong with a note that is written before a decision: it names what is privileged in
    /// every text, a position, or what nobody has seen or said before it.
    pub fn leak(&self, note: &Annotation, before: &[Step<'_>]) -> Option<String> {
        let text = [
            &note.reasoning,
            &note.history,
            &note.schedule,
            &note.subtask,
        ]
        .map(String::as_str)
        .join("\n");
        if let Some(leak) = find_leak(&text, &self.ids) {
            return Some(format!("it names {}: {}", leak.kind, leak.excerpt(&text)));
        }
        if let Some(number) = position(&text) {
            return Some(format!("it gives a position: {number}"));
        }
        let shown = |secret: &Secret| {
            before.iter().filter(|step| step.error.is_none()).any(|step| {
                let marked =
                    step.markers.iter().any(|(_, marked)| matches!(marked, MarkedItem::Object(thing) if thing.key == secret.key));
                marked || step.visible.iter().any(|thing| thing.key == secret.key)
            })
        };
        let said = |words: &str| {
            let argument = |step: &Step<'_>| {
                step.argument
                    .as_deref()
                    .is_some_and(|argument| language::quotes(argument, words))
            };
            let reply = |step: &Step<'_>| {
                step.reply
                    .is_some_and(|reply| language::quotes(reply, words))
            };
            language::quotes(&self.instruction, words)
                || before.iter().any(|step| argument(step) || reply(step))
        };
        let captions: Vec<&Secret> = self.things.iter().filter(|secret| shown(secret)).collect();
        let unseen = self
            .things
            .iter()
            .filter(|secret| !shown(secret))
            .filter_map(|secret| secret.caption.as_deref());
        let unseen = unseen.filter(|caption| {
            !captions
                .iter()
                .any(|secret| secret.caption.as_deref() == Some(caption))
        });
        let mut hidden = unseen
            .chain(self.precise.as_deref())
            .filter(|words| !said(words));
        hidden
            .find(|words| language::quotes(&text, words))
            .map(|words| format!("it says what was not seen or told yet: {words}"))
    }

    /// The truth as a line for the annotator.
    pub(crate) fn truth(&self) -> Value {
        let objects: Vec<Value> = self
            .things
            .iter()
            .map(|secret| {
                json!({"category": secret.category, "looks": secret.caption, "stands_on": secret.receptacle,
                       "is_what_is_meant": secret.key == self.target})
            })
            .collect();
        json!({"precise_instruction": self.precise, "goal": self.goal, "objects": objects})
    }

    /// Whether a marker stands for what is meant.
    pub(crate) fn is_target(&self, marked: &MarkedItem<'_>) -> bool {
        matches!(marked, MarkedItem::Object(thing) if thing.key == self.target)
    }
}

/// A number with two or more decimals, as positions have them.
fn position(text: &str) -> Option<&str> {
    text.split(|letter: char| !letter.is_ascii_digit() && letter != '.')
        .find(|word| {
            let decimals = word.split_once('.').map_or("", |(_, decimals)| decimals);
            decimals.len() >= 2
                && decimals.chars().all(|digit| digit.is_ascii_digit())
                && !word.starts_with('.')
        })
}
