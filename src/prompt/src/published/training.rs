//! A finished rollout as the conversation that the trainer learns from: every turn's prompt
//! and answer, texts only, older prompts shortened, the oldest turns dropped where the
//! context is too long.

use serde_json::{Value, json};

use crate::{
    PromptWording,
    python::{self, Ascii},
};

/// Turns of a published rollout.
pub const MAX_TURNS: u32 = 50;

/// Characters that a conversation may have (`MCP_MAX_CONTEXT_CHARS`).
pub const MAX_CONTEXT_CHARS: usize = 18_432;

/// Least characters that an observation is cut to.
const OBSERVATION_CHARS_MIN: usize = 200;

/// How many questions a prompt allows in a rollout of so many turns: 15 of a hundred, rounded
/// up. Nothing enforces it.
pub fn ask_limit(max_turns: u32) -> u32 {
    (f64::from(max_turns) * 0.15).ceil() as u32
}

/// How older prompts are shortened.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Compression {
    /// Prompts at the end that stay as they are, at least one (`MCP_COMPRESS_KEEP_LAST_K`).
    pub keep_last: usize,
    /// Characters of an observation that stay, at least 200 (`MCP_COMPRESS_LAST_OBS_MAX_CHARS`).
    pub observation_chars: usize,
}

impl Default for Compression {
    /// What the code does unless told otherwise; the published launch script keeps one prompt.
    fn default() -> Self {
        Self {
            keep_last: 3,
            observation_chars: 1200,
        }
    }
}

/// A turn of a rollout.
#[derive(Clone, PartialEq, Debug)]
pub struct TrainingTurn {
    /// The prompt that the model answered.
    pub prompt: String,
    /// The model's answer of this turn, as it came.
    pub answer: String,
    /// The instruction of the episode.
    pub task: String,
    /// The last line of the memory before the answer; `{}` before the first.
    pub latest_progress: String,
    /// The last action before the answer.
    pub last_action: Value,
    /// The observation in the prompt.
    pub observation: String,
    /// The text graph that came with it, shown in shortened prompts only; empty if there is none.
    pub text_graph: String,
    /// How many questions were asked before this turn.
    pub ask_count: u32,
    /// The hand, in words.
    pub hand: String,
}

impl TrainingTurn {
    fn shortened(&self, compression: Compression, wording: &PromptWording) -> String {
        let mut observation = self.observation.clone();
        if !self.text_graph.is_empty() {
            observation = format!("{observation}\n{}{}", wording.text_graph, self.text_graph);
        }
        let length = compression.observation_chars.max(OBSERVATION_CHARS_MIN);
        let cut = python::prefix(&observation, length).len();
        if cut < observation.len() {
            observation.truncate(cut);
            observation.push_str(&wording.cut);
        }
        let slots = [
            ("{task}", self.task.clone()),
            ("{latest_progress_step}", self.latest_progress.clone()),
            (
                "{last_action}",
                python::dumps(&self.last_action, Ascii::Plain),
            ),
            ("{last_obs}", observation),
            ("{ask_count}", self.ask_count.to_string()),
            ("{hand_state_description}", self.hand.clone()),
        ];
        let mut text = String::new();
        let mut rest = wording.shortened_prompt.as_str();
        while let Some(at) = rest.find('{') {
            let (before, field) = rest.split_at(at);
            text.push_str(before);
            match slots.iter().find(|(name, _)| field.starts_with(name)) {
                Some((name, value)) => {
                    text.push_str(value);
                    rest = &field[name.len()..];
                }
                None => {
                    text.push('{');
                    rest = &field[1..];
                }
            }
        }
        text + rest
    }
}

/// The conversation of a rollout, and whether the trainer zeroes its reward because fewer than half
/// of its turns are left.
pub fn training_messages(
    turns: &[TrainingTurn],
    compression: Option<Compression>,
    max_chars: usize,
    wording: &PromptWording,
) -> (Vec<Value>, bool) {
    let shortened = compression.map_or(0, |compression| {
        turns.len().saturating_sub(compression.keep_last.max(1))
    });
    let mut pairs: Vec<(String, &str)> = Vec::with_capacity(turns.len());
    for (index, turn) in turns.iter().enumerate() {
        let prompt = match compression {
            Some(compression) if index < shortened => turn.shortened(compression, wording),
            _ => turn.prompt.clone(),
        };
        pairs.push((prompt, &turn.answer));
    }
    let length =
        |(prompt, answer): &(String, &str)| prompt.chars().count() + answer.chars().count();
    let mut chars: usize = pairs.iter().map(length).sum();
    let mut dropped = 0;
    while chars > max_chars && dropped + 1 < pairs.len() {
        chars -= length(&pairs[dropped]);
        dropped += 1;
    }
    let kept = &pairs[dropped..];
    let zeroed = dropped > 0 && 2 * kept.len() < pairs.len();
    let messages = kept.iter().flat_map(|(prompt, answer)| {
        [
            json!({"role": "user", "content": prompt}),
            json!({"role": "assistant", "content": answer}),
        ]
    });
    (messages.collect(), zeroed)
}

/// What the trainer's context manager sends of a conversation: its last user message; all of it
/// where there is none.
pub fn keep_last_user_message(history: &[Value]) -> Vec<Value> {
    match history
        .iter()
        .rev()
        .find(|message| message["role"] == "user")
    {
        Some(message) => vec![message.clone()],
        None => history.to_vec(),
    }
}
