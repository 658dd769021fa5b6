//! What all episodes of a task are told: its words are put together once, and looked at once.

use std::sync::{Arc, OnceLock};

use reel_prompt as prompt;
use reel_world::NameSet;
use serde::{Deserialize, Serialize};

use crate::{
    Refusal, Secrets, Text,
    refusal::{clean, refusal},
};

/// What the agents of a task are told, and what they must not know.
#[derive(Debug)]
pub struct Told {
    instruction: String,
    receptacles: Vec<Receptacle>,
    secrets: Secrets,
    refusal: Option<Refusal>,
    /// As the beginning of the user's turn: without tools, with those of the paper, with those of the published code.
    settings: [OnceLock<Arc<Text>>; 3],
}

/// A piece of furniture as an agent knows it.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Receptacle {
    /// e.g. `table_1`
    pub id: String,
    /// e.g. `table`
    pub category: String,
    /// e.g. `living room/0`
    pub room: String,
}

impl Told {
    /// The instruction, the furniture in the scene's order, and what is privileged in the task.
    pub fn new(instruction: impl Into<String>, receptacles: Vec<Receptacle>, secrets: Secrets) -> Self {
        let instruction = instruction.into();
        let listed: Vec<String> =
            receptacles.iter().map(|Receptacle { id, category, room }| format!("{id} ({category}, {room})")).collect();
        let refusal = refusal(&instruction, &secrets, || "the instruction".into()).or_else(|| {
            let mut each = listed.iter().zip(&receptacles);
            let one = || each.find_map(|(text, it)| refusal(text, &secrets, || format!("receptacle {}", it.id)));
            (!clean(listed.iter().map(String::as_str), &secrets)).then(one).flatten()
        });
        Self { instruction, receptacles, secrets, refusal, settings: Default::default() }
    }

    /// What the agent was told to do.
    pub fn instruction(&self) -> &str {
        &self.instruction
    }

    /// What it must not know.
    pub fn secrets(&self) -> &Secrets {
        &self.secrets
    }

    /// Why no episode of the task gives an example.
    pub(crate) fn refusal(&self) -> Option<&Refusal> {
        self.refusal.as_ref()
    }

    /// The part of the user's turn that is the same at every decision; tools are told by these names, or not at all.
    pub(crate) fn setting(&self, tools: Option<NameSet>) -> Arc<Text> {
        let place = match tools {
            None => 0,
            Some(NameSet::Paper) => 1,
            Some(NameSet::RealRepo) => 2,
        };
        let text = self.settings[place].get_or_init(|| {
            let receptacles = self.receptacles.iter().map(|it| (it.id.as_str(), it.category.as_str(), it.room.as_str()));
            Arc::new(Text::new(prompt::setting(&self.instruction, tools, receptacles)))
        });
        Arc::clone(text)
    }
}
