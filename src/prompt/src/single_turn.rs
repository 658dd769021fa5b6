//! One user turn a decision, as REAL's trainer puts it: the template, filled in with
//! what its memory holds.

use std::sync::{Arc, LazyLock};

use reel_world::{Digest, ToolCall};
use serde::Serialize;
use serde_json::Value;

use crate::{
    PromptWording, SYSTEM_MULTI_TURN, Slots, Template, TemplateError,
    answer::{action, log_line},
    published::{
        Hand, Item, MAX_TURNS, Observation, SchedulerMemory, ask_limit, canonical_tool,
        trainer_scene,
    },
};

/// The template that comes along.
pub const TEMPLATE: &str = include_str!("../texts/prompt.txt");

/// Raised when the same texts are filled with other values, so that their digest differs. 2: a
/// History that nobody wrote is empty, and only the last result's image is shown.
const REVISION: &str = "2";

/// The name that [`Prompt::builtin`] goes by.
const BUILTIN: &str = "reel";

/// What a prompt repeats that the model neither wrote nor saw just now. Either hides lost memory,
/// so both are off by default (docs/agents.md#a-models-memory).
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize)]
pub struct MemoryOptions {
    /// Where nobody wrote a History, its next line is the last call and its result.
    pub call_log: bool,
    /// After a result of text alone, the image of an earlier result stays in the prompt.
    pub keep_view: bool,
}

impl MemoryOptions {
    /// The options that are on, by the names that manifests and traces give them.
    pub fn enabled(self) -> impl Iterator<Item = &'static str> {
        [("call_log", self.call_log), ("keep_view", self.keep_view)]
            .into_iter()
            .filter_map(|(name, enabled)| enabled.then_some(name))
    }
}

/// A template, the sentences around its values, what they go by, and what is repeated in them.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Prompt {
    name: String,
    template_digest: Digest,
    template: Template,
    wording: PromptWording,
    memory: MemoryOptions,
}

impl Prompt {
    /// The one that comes along.
    pub fn builtin() -> Arc<Self> {
        static BUILTIN_PROMPT: LazyLock<Arc<Prompt>> = LazyLock::new(|| {
            let prompt = Prompt::new(BUILTIN, TEMPLATE, PromptWording::default());
            Arc::new(prompt.expect("the template that comes along passes the check"))
        });
        Arc::clone(&BUILTIN_PROMPT)
    }

    /// A template from a file. `name` stands in manifests and cards.
    ///
    /// # Errors
    /// Fails if the text is no usable template.
    pub fn new(
        name: impl Into<String>,
        template: &str,
        wording: PromptWording,
    ) -> Result<Self, TemplateError> {
        let template_digest = Digest::of(template.as_bytes());
        Ok(Self {
            name: name.into(),
            template_digest,
            template: Template::parse(template)?,
            wording,
            memory: MemoryOptions::default(),
        })
    }

    /// Its name: `reel`, or the file's.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// BLAKE3 of the template's bytes.
    pub fn template_digest(&self) -> Digest {
        self.template_digest
    }

    /// The sentences around the values.
    pub fn wording(&self) -> &PromptWording {
        &self.wording
    }

    /// The same prompt with other memory options.
    pub fn with_memory(self, memory: MemoryOptions) -> Self {
        Self { memory, ..self }
    }

    /// What it repeats of earlier decisions.
    pub fn memory(&self) -> MemoryOptions {
        self.memory
    }

    /// Names every text that a model is asked with, in each row and trace:
    /// template, sentences, system message, how they are filled, and the memory options that are on.
    pub fn digest(&self) -> Digest {
        let wording = serde_json::to_string(&self.wording).unwrap_or_default();
        let enabled: String = self.memory.enabled().collect();
        Digest::of(
            [
                self.template_digest.to_string().as_str(),
                &wording,
                SYSTEM_MULTI_TURN,
                REVISION,
                &enabled,
            ]
            .concat()
            .as_bytes(),
        )
    }
}

/// What an episode is about, as its prompts say it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct EpisodePrompt {
    prompt: Arc<Prompt>,
    scene: String,
    task: String,
}

impl EpisodePrompt {
    /// `receptacles` are ids with their rooms, in the scene's order.
    pub fn new<'a>(
        prompt: Arc<Prompt>,
        task: &str,
        receptacles: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Self {
        let mut rooms: Vec<(&str, Vec<&str>)> = Vec::new();
        for (id, room) in receptacles {
            match rooms.iter_mut().find(|(name, _)| *name == room) {
                Some((_, ids)) => ids.push(id),
                None => rooms.push((room, vec![id])),
            }
        }
        let scene = trainer_scene(rooms, &prompt.wording);
        Self {
            prompt,
            scene,
            task: task.to_owned(),
        }
    }

    /// The beginning that all prompts of the episode share.
    pub fn shared(&self) -> String {
        self.prompt.template.render_shared(&self.slots())
    }

    fn slots(&self) -> Slots<'_> {
        Slots {
            scene: &self.scene,
            task: &self.task,
            max_ask_limit: ask_limit(MAX_TURNS),
            ..Slots::default()
        }
    }
}

/// What came of a call.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct CallOutcome<'a> {
    /// The tool, by any of its names.
    pub tool: &'a str,
    /// What the tool told, without what is privileged.
    pub text: &'a str,
    /// How many images came with it.
    pub images: usize,
    /// The category of what the gripper holds afterwards.
    pub held: Option<&'a str>,
}

/// What a model remembers and sees, decision by decision.
#[derive(Clone, PartialEq, Debug)]
pub struct SingleTurn {
    episode: Arc<EpisodePrompt>,
    memory: SchedulerMemory,
    observation: String,
    ask_count: u32,
    hand: Hand,
    held: Option<String>,
}

impl SingleTurn {
    /// Before the first decision: nothing is remembered and nothing shown.
    pub fn new(episode: Arc<EpisodePrompt>) -> Self {
        let (memory, hand) = (SchedulerMemory::default(), Hand::default());
        Self {
            episode,
            memory,
            observation: String::new(),
            ask_count: 0,
            hand,
            held: None,
        }
    }

    /// The part of the next prompt that follows [`EpisodePrompt::shared`].
    pub fn rest(&self) -> String {
        let wording = &self.episode.prompt.wording;
        let hand = self.hand.describe(self.held.as_deref(), wording);
        let (progress, action) = (self.memory.task_progress(), self.memory.last_action_text());
        self.episode.prompt.template.render_rest(&Slots {
            task_progress: &progress,
            last_action: &action,
            last_observation: &self.observation,
            ask_count: self.ask_count,
            hand: &hand,
            ..self.episode.slots()
        })
    }

    /// The whole prompt of the next decision.
    pub fn prompt(&self) -> String {
        self.episode.shared() + &self.rest()
    }

    /// Takes in an answer and what came of its call.
    pub fn update(&mut self, answer: &str, outcome: &CallOutcome<'_>) {
        self.memory.update(answer, &self.episode.prompt.wording);
        self.observe(outcome);
    }

    /// Takes in a call that no answer made: the last action, and with
    /// [`MemoryOptions::call_log`] a line of the memory.
    pub fn watch(&mut self, call: &ToolCall, outcome: &CallOutcome<'_>) {
        if self.episode.prompt.memory.call_log {
            self.memory
                .note(&log_line(&call.name, &call.arguments, outcome.text));
        }
        self.memory
            .set_last_action(action(&call.name, &call.arguments));
        self.observe(outcome);
    }

    /// What the trainer's memory holds after the decisions so far.
    pub fn memory(&self) -> &SchedulerMemory {
        &self.memory
    }

    fn observe(&mut self, outcome: &CallOutcome<'_>) {
        let wording = &self.episode.prompt.wording;
        let (tool, _) = crate::published::published_call(outcome.tool, &Value::Null);
        let text = (!outcome.text.is_empty()).then_some(Item::Text(outcome.text));
        // The last content of a published result is its debug information, which nobody is shown.
        let contents: Vec<Item<'_>> = text
            .into_iter()
            .chain(std::iter::repeat_n(Item::Image, outcome.images))
            .chain([Item::Text("")])
            .collect();
        let observation = Observation::of_result(&tool, &contents, wording);
        self.ask_count += u32::from(canonical_tool(&tool) == "ask");
        self.hand.update(&tool, &observation.text);
        self.held = outcome.held.map(str::to_owned);
        self.observation = observation.in_rollout(wording);
    }
}
