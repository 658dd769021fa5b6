//! What all episodes of a task are told: its words are put together once, and looked at once.

use std::sync::{Arc, OnceLock};

use reel_prompt::{EpisodePrompt, Prompt, briefing};
use serde::{Deserialize, Serialize};

use crate::{
    PrivilegedFacts, RefusalReason, SharedText,
    refusal::{clean, refusal},
};

/// What the agents of a task are told, and what they must not know.
#[derive(Debug)]
pub struct TaskBriefing {
    instruction: String,
    receptacles: Vec<PublicReceptacle>,
    secrets: PrivilegedFacts,
    refusal: Option<RefusalReason>,
    prompt: Arc<Prompt>,
    /// In the words of the prompt, with the beginning that all its single turns share.
    single_turn: OnceLock<(Arc<EpisodePrompt>, Arc<SharedText>)>,
    /// The first user message of a conversation.
    briefing: OnceLock<Arc<SharedText>>,
}

/// A piece of furniture as an agent knows it.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct PublicReceptacle {
    /// Id of the receptacle, e.g. `table_1`.
    pub id: String,
    /// Category of the receptacle, e.g. `table`.
    pub category: String,
    /// Room that the receptacle stands in, e.g. `living room/0`.
    pub room: String,
}

impl TaskBriefing {
    /// The instruction, the furniture in the scene's order, and what is privileged in the task.
    pub fn new(
        instruction: impl Into<String>,
        receptacles: Vec<PublicReceptacle>,
        secrets: PrivilegedFacts,
    ) -> Self {
        let instruction = instruction.into();
        let listed: Vec<String> = receptacles
            .iter()
            .map(|PublicReceptacle { id, category, room }| format!("{id} ({category}, {room})"))
            .collect();
        let refusal = refusal(&instruction, &secrets, || "the instruction".into()).or_else(|| {
            let mut each = listed.iter().zip(&receptacles);
            let one = || {
                each.find_map(|(text, it)| {
                    refusal(text, &secrets, || format!("receptacle {}", it.id))
                })
            };
            (!clean(listed.iter().map(String::as_str), &secrets))
                .then(one)
                .flatten()
        });
        let prompt = Prompt::builtin();
        Self {
            instruction,
            receptacles,
            secrets,
            refusal,
            prompt,
            single_turn: OnceLock::new(),
            briefing: OnceLock::new(),
        }
    }

    /// Puts single turns by another prompt than the one that comes along.
    #[must_use]
    pub fn with_prompt(self, prompt: Arc<Prompt>) -> Self {
        Self {
            prompt,
            single_turn: OnceLock::new(),
            ..self
        }
    }

    /// What the agent was told to do.
    pub fn instruction(&self) -> &str {
        &self.instruction
    }

    /// What it must not know.
    pub fn secrets(&self) -> &PrivilegedFacts {
        &self.secrets
    }

    /// Why no episode of the task gives an example.
    pub(crate) fn refusal(&self) -> Option<&RefusalReason> {
        self.refusal.as_ref()
    }

    /// What single turns are put by.
    pub(crate) fn prompt(&self) -> &Prompt {
        &self.prompt
    }

    /// The task in the words of the prompt, and the beginning that all its single turns share.
    pub(crate) fn single_turn(&self) -> &(Arc<EpisodePrompt>, Arc<SharedText>) {
        self.single_turn.get_or_init(|| {
            let receptacles = self
                .receptacles
                .iter()
                .map(|it| (it.id.as_str(), it.room.as_str()));
            let episode =
                EpisodePrompt::new(Arc::clone(&self.prompt), &self.instruction, receptacles);
            let shared = Arc::new(SharedText::new(episode.shared()));
            (Arc::new(episode), shared)
        })
    }

    /// Whether a History that nobody wrote is the log of calls.
    pub(crate) fn call_log(&self) -> bool {
        self.prompt.memory().call_log
    }

    /// The first user message of a conversation.
    pub(crate) fn briefing(&self) -> Arc<SharedText> {
        let text = self.briefing.get_or_init(|| {
            let receptacles = self
                .receptacles
                .iter()
                .map(|it| (it.id.as_str(), it.category.as_str(), it.room.as_str()));
            Arc::new(SharedText::new(briefing(&self.instruction, receptacles)))
        });
        Arc::clone(text)
    }
}
