//! The rule-based simulated user (docs/spec.md#simulated-user; paper, Simulated
//! User Module). Four rules:
//!
//! 1. Goal-driven: every reply leads from the start towards the goal.
//! 2. Information barrier: it never tells the exact place of the target; of the source it says no
//!    more than the instruction does, or else the room.
//! 3. Dynamic clarification: it names the target only after the robot saw it, by what tells it from
//!    the other objects seen.
//! 4. No raw ids.
//!
//! [`violations`] checks a reply of any source against them. The user is deterministic, and never
//! sees a pose or an image.

mod leaks;
mod question;
mod rules;
mod situation;

use std::collections::BTreeSet;

use reel_world::{
    Door, InstanceId, ObjectInstance, Receptacle, Scene, Task, language,
    record::{UserReply, UserSource},
};

pub use leaks::{leaks, spoken_id};
use question::Topic;
pub use question::clarifying_question;
pub use rules::violations;
pub use situation::UserQuestion;

/// What the user knows: the task, how people call the furniture, and what the robot saw and holds.
#[derive(Clone, Debug)]
pub struct RuleUser {
    task: Task,
    scene: Scene,
    seen: BTreeSet<InstanceId>,
    held: Option<InstanceId>,
    action: String,
}

impl RuleUser {
    /// A user for a task in its scene.
    pub fn new(task: &Task, scene: &Scene) -> Self {
        Self {
            task: task.clone(),
            scene: scene.clone(),
            seen: BTreeSet::new(),
            held: None,
            action: String::new(),
        }
    }

    /// Replaces the auxiliary observation: the action the robot just took and the objects it sees.
    /// What was seen once stays known.
    pub fn observe(&mut self, action: &str, visible: &[InstanceId]) {
        action.clone_into(&mut self.action);
        self.seen.extend(visible.iter().cloned());
    }

    /// Tells the user what the gripper holds after that action.
    pub fn observe_held(&mut self, held: Option<&InstanceId>) {
        self.seen.extend(held.cloned());
        self.held = held.cloned();
    }

    /// The action of the last auxiliary observation.
    pub fn last_action(&self) -> &str {
        &self.action
    }

    /// Whether the robot saw the target.
    pub fn saw_target(&self) -> bool {
        self.seen.contains(&self.task.target)
    }

    /// Answers a question of the robot by the user's rules.
    pub fn answer(&self, question: &str) -> UserReply {
        UserReply {
            text: self.reply(question),
            source: UserSource::RuleBased,
        }
    }

    fn reply(&self, question: &str) -> String {
        let topic = Topic::of(question);
        match &self.held {
            Some(held) if *held == self.task.target && topic != Topic::Destination => {
                return format!(
                    "Yes, that is what I meant. {}",
                    self.destination(question, false)
                );
            }
            Some(held) if *held != self.task.target && topic != Topic::Destination => {
                return format!(
                    "That is not what I meant, please put it back. {}",
                    self.object()
                );
            }
            _ => {}
        }
        match topic {
            Topic::Destination => self.destination(question, true),
            Topic::Object | Topic::Source if !self.saw_target() => self.object(),
            Topic::Object
                if question::wants_yes_or_no(question) && language::names_object(question) =>
            {
                let target = self.task.target_object();
                let yes = language::fits(question, target, self.task.purpose.as_deref());
                format!("{}, {}", if yes { "Yes" } else { "No" }, self.object())
            }
            Topic::Object => self.object(),
            Topic::Source => format!("You have seen it already. {}", self.object()),
        }
    }

    /// What is meant: by name once it was seen, else as vaguely as the instruction.
    fn object(&self) -> String {
        if self.saw_target() {
            return format!("I mean {}.", self.description());
        }
        format!("I mean {}. {}", self.vaguely(), self.source())
    }

    fn vaguely(&self) -> String {
        let category = &self.task.target_object().category;
        match &self.task.purpose {
            Some(purpose) => language::indefinite(purpose),
            None if language::quotes(&self.task.instruction, category) => {
                language::indefinite(category)
            }
            None => "what I asked for".to_owned(),
        }
    }

    /// Where to look, no more exactly than the instruction says.
    fn source(&self) -> String {
        let Some(source) = self.scene.receptacle(&self.task.src) else {
            return "Please look around.".to_owned();
        };
        match quoted_caption(source, &self.task.instruction) {
            Some(caption) if source.door != Door::None => {
                format!("Please check what is inside {}.", with_the(caption))
            }
            Some(caption) => format!("Please check what is on {}.", with_the(caption)),
            None => format!("Please have a look around in the {}.", source.room_name()),
        }
    }

    /// Where to put it, with yes or no if a receptacle was proposed.
    fn destination(&self, question: &str, may_confirm: bool) -> String {
        let into = |receptacle: &Receptacle| {
            receptacle.door != Door::None
                || ["sink", "pot", "basket", "box"].contains(&receptacle.category.as_str())
        };
        let Some(destination) = self.scene.receptacle(&self.task.dest) else {
            return "Please do as I asked.".to_owned();
        };
        let preposition = if into(destination) { "into" } else { "on" };
        let place = format!("put it {preposition} {}.", self.call(destination));
        let proposed = |receptacle: &Receptacle| {
            let caption = quoted_caption(receptacle, question).is_some();
            caption || language::quotes(question, receptacle.id.as_str())
        };
        if may_confirm && question::wants_yes_or_no(question) && proposed(destination) {
            format!("Yes, please {place}")
        } else if may_confirm
            && question::wants_yes_or_no(question)
            && self.scene.receptacles.iter().any(proposed)
        {
            format!("No, please {place}")
        } else {
            format!("Please {place}")
        }
    }

    /// How people call a receptacle: as in the instruction, else by a caption that no other has,
    /// else by category and room.
    fn call(&self, receptacle: &Receptacle) -> String {
        let others: Vec<&Receptacle> = self
            .scene
            .receptacles
            .iter()
            .filter(|other| other.id != receptacle.id)
            .collect();
        let unique = |caption: &str| {
            !others
                .iter()
                .any(|other| other.captions.contains_key(caption))
        };
        let main = receptacle.main_caption().filter(|caption| unique(caption));
        let any = || {
            receptacle
                .captions
                .keys()
                .map(String::as_str)
                .find(|caption| unique(caption))
        };
        match quoted_caption(receptacle, &self.task.instruction)
            .filter(|caption| unique(caption))
            .or(main)
            .or_else(any)
        {
            Some(caption) => with_the(caption),
            None => format!(
                "the {} in the {}",
                receptacle.category,
                receptacle.room_name()
            ),
        }
    }

    /// The target by the fewest words that tell it from everything else the robot saw that
    /// the instruction may mean.
    fn description(&self) -> String {
        let target = self.task.target_object();
        let others: Vec<&ObjectInstance> = self
            .task
            .objects
            .iter()
            .filter(|object| self.is_other_candidate(object))
            .collect();
        let tells = |text: &String| {
            let said = format!("I mean {text}.");
            language::fits(&said, target, None)
                && !others
                    .iter()
                    .any(|other| language::fits(&said, other, None))
        };
        let words = telling_words(target);
        let category = &target.category;
        let mut texts = vec![format!("the {category}")];
        texts.extend(words.iter().map(|word| format!("the {word} {category}")));
        for (index, first) in words.iter().enumerate() {
            texts.extend(
                words[index + 1..]
                    .iter()
                    .map(|second| format!("the {first} {second} {category}")),
            );
        }
        let caption = target
            .caption
            .as_ref()
            .map(|caption| format!("this {category}: {}", caption.trim_end_matches('.')));
        let fallback = caption.clone().unwrap_or_else(|| format!("the {category}"));
        texts.extend(caption);
        texts.into_iter().find(tells).unwrap_or(fallback)
    }

    fn is_other_candidate(&self, object: &ObjectInstance) -> bool {
        let target = self.task.target_object();
        let alike = || {
            language::is_a(&object.category, &target.category)
                || language::is_a(&target.category, &object.category)
        };
        object.asset != target.asset
            && self.seen.contains(&object.instance)
            && (alike()
                || language::fits(&self.task.instruction, object, self.task.purpose.as_deref()))
    }
}

/// Attribute words of an object that a person would use to tell it apart, colours first.
fn telling_words(object: &ObjectInstance) -> Vec<String> {
    const SHADES: [&str; 7] = [
        "light", "dark", "bright", "colored", "coloured", "clear", "metallic",
    ];
    let caption = language::attribute_words(object.caption.as_deref().unwrap_or_default());
    let mut words: Vec<String> = Vec::new();
    for kind in ["colour", "material", "shape", "size"] {
        for word in object
            .attributes
            .get(kind)
            .into_iter()
            .chain(caption.get(kind))
            .flatten()
        {
            if !SHADES.contains(&word.as_str()) && !words.contains(word) {
                words.push(word.clone());
            }
        }
    }
    words
}

/// The longest caption of a receptacle that a text quotes.
fn quoted_caption<'a>(receptacle: &'a Receptacle, text: &str) -> Option<&'a str> {
    let quoted = receptacle
        .captions
        .keys()
        .filter(|caption| language::quotes(text, caption));
    quoted
        .max_by_key(|caption| caption.len())
        .map(String::as_str)
}

fn with_the(caption: &str) -> String {
    let first = caption
        .split_whitespace()
        .next()
        .unwrap_or_default()
        .to_lowercase();
    if ["the", "a", "an", "my", "our"].contains(&first.as_str()) {
        caption.to_owned()
    } else {
        format!("the {caption}")
    }
}

#[cfg(test)]
mod tests;
