//! Examples: a conversation up to a decision, from which a model learns that decision
//! (docs/spec.md#policy-context and docs/spec.md#sft-data). Owns what becomes an example. Knows
//! no format, no file.

use std::{
    borrow::Cow,
    mem,
    sync::{Arc, LazyLock, OnceLock},
};

use reel_prompt::{self as prompt, CallLog, CallOutcome, DecisionAnswer, HistoryLines, SingleTurn};
use reel_world::{NameSet, SPOKEN_TURN};
use serde::Serialize;

use crate::{
    AgentSetup, Episode, ImageId, RefusalReason, RefusedDecision, Rollout, Source, Split, Step,
    json, refusal::Checks, strip,
};

/// How a decision is put to a model.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Style {
    /// That of REAL's trainer: one user message with everything, the latest image only, the answer
    /// as text. The only style that REAL's published parsers read.
    #[default]
    SingleTurn,
    /// Native tool calls: an example is an episode up to the last decision to learn.
    MultiTurn,
    /// Native tool calls: an example is the conversation up to one decision, and only
    /// that one is learned.
    MultiTurnPrefix,
}

impl Style {
    /// All styles, in the order of their declaration.
    pub const ALL: [Style; 3] = [Style::SingleTurn, Style::MultiTurn, Style::MultiTurnPrefix];

    /// As it stands on the command line and in manifests.
    pub fn as_str(self) -> &'static str {
        match self {
            Style::SingleTurn => "single-turn",
            Style::MultiTurn => "multi-turn",
            Style::MultiTurnPrefix => "multi-turn-prefix",
        }
    }

    /// Reads what [`Style::as_str`] wrote.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|style| style.as_str() == text)
    }
}

/// What becomes an example.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize)]
pub struct ExampleOptions {
    /// How a decision is put.
    pub style: Style,
    /// Learn failed calls too; otherwise they are context only.
    pub failed_calls: bool,
}

/// A text that many examples share: its JSON escapes are made once, if at all.
#[derive(Debug, Default)]
pub struct SharedText {
    raw: String,
    escaped: OnceLock<Vec<u8>>,
}

impl SharedText {
    /// Holds a text; its JSON escapes are made at first use.
    pub fn new(raw: impl Into<String>) -> Self {
        Self {
            raw: raw.into(),
            escaped: OnceLock::new(),
        }
    }

    /// The text as it was given, without JSON escapes.
    pub fn as_str(&self) -> &str {
        &self.raw
    }

    pub(crate) fn escaped(&self) -> &[u8] {
        self.escaped.get_or_init(|| {
            let mut escaped = Vec::with_capacity(self.raw.len() + self.raw.len() / 8);
            json::escape(&mut escaped, &self.raw);
            escaped
        })
    }
}

/// A turn of the conversation.
#[derive(Clone, Debug)]
pub enum Turn {
    /// The system message, which says how to behave.
    System(Arc<SharedText>),
    /// What the agent is told, and its images. A `<image>` in the text stands for
    /// the first of them.
    User {
        /// The beginning, which is the same for the whole episode.
        setting: Arc<SharedText>,
        /// The rest, of this decision.
        situation: String,
        /// Images that the agent sees at this turn.
        images: Vec<ImageId>,
    },
    /// What the model shall say, as text.
    Answer(String),
    /// What the model shall say, as a native tool call.
    Call {
        /// `<think>...</think>` and a line's end, or nothing.
        thought: String,
        /// Pairs it with its outcome, e.g. `call_3`.
        id: String,
        /// The tool as it was called.
        name: String,
        /// The arguments, a JSON object.
        arguments: String,
        /// Whether it is learned.
        learn: bool,
    },
    /// What the tool told, and what the agent saw then if that was new.
    Outcome {
        /// Id of the call that the outcome belongs to, e.g. `call_3`.
        id: String,
        /// The tool as it was called.
        name: String,
        /// Text that the tool returned to the agent.
        text: String,
        /// What the agent saw.
        images: Vec<ImageId>,
    },
}

impl Turn {
    /// Images of the turn, in order; empty if it has none.
    pub fn images(&self) -> &[ImageId] {
        match self {
            Turn::User { images, .. } | Turn::Outcome { images, .. } => images,
            _ => &[],
        }
    }
}

/// What all examples of an episode have in common.
#[derive(Clone, Debug, Default)]
pub struct EpisodeInfo {
    /// As in the trace.
    pub episode_id: String,
    /// Id of the task that the episode plays.
    pub task_id: String,
    /// Family of the episode's task, e.g. `FDP`.
    pub family: String,
    /// Id of the scene that the episode plays in.
    pub scene_id: String,
    /// Name of the policy that made the decisions, e.g. `oracle`.
    pub policy: String,
    /// What the agent was told to do.
    pub instruction: String,
    /// The part of the dataset.
    pub split: Split,
    /// Where it comes from.
    pub source: Source,
    /// Names the texts of the prompt.
    pub prompt_digest: String,
    /// The fields of the provenance that are the episode's, as JSON without braces; made when
    /// a row holds them.
    provenance: OnceLock<String>,
}

/// What a model learns one decision, or one episode, from.
#[derive(Clone, Debug)]
pub struct Example {
    /// `<episode>/<call>`; a whole episode's call is its last.
    pub id: String,
    /// The decision to learn; the last one of a whole episode.
    pub call: u32,
    /// Its tool by the name in the paper.
    pub tool: String,
    /// Facts that all examples of its episode have in common.
    pub about: Arc<EpisodeInfo>,
    /// How it is put.
    pub style: Style,
    /// The conversation; the last turn is what is learned.
    pub turns: Vec<Turn>,
    /// The tools as a JSON list of `{type: function, function: {name, description, parameters}}`,
    /// where they are not in the user's turn.
    pub tools: Option<Arc<SharedText>>,
    /// What the decision was worth, in rows for reinforcement learning.
    pub rollout: Option<Rollout>,
}

impl Example {
    /// Its images, in the order of their tags.
    pub fn images(&self) -> impl Iterator<Item = &ImageId> {
        self.turns.iter().flat_map(Turn::images)
    }

    /// Appends the provenance as one JSON object.
    pub fn provenance(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(b"{\"example\":");
        json::string(out, &self.id);
        out.extend_from_slice(format!(",\"call\":{},\"tool\":", self.call).as_bytes());
        json::string(out, &self.tool);
        out.push(b',');
        out.extend_from_slice(self.about.provenance().as_bytes());
        out.push(b'}');
    }

    /// The turns as (role, text) with one `<image>` tag an image; calls as JSON under `tool_call`,
    /// outcomes under `tool_response`: what the tables' column `messages` holds.
    pub fn messages(&self) -> Vec<(&'static str, Cow<'_, str>)> {
        let tags = |images: &[ImageId]| IMAGE_TAG.repeat(images.len());
        let mut messages = Vec::with_capacity(self.turns.len());
        for turn in &self.turns {
            match turn {
                Turn::System(text) => messages.push(("system", text.as_str().into())),
                Turn::User {
                    setting,
                    situation,
                    images,
                } => {
                    let text = [setting.as_str(), situation].concat();
                    let missing = images.get(tags_in(&text)..).map(tags).unwrap_or_default();
                    messages.push(("user", (text + &missing).into()));
                }
                Turn::Answer(text) => messages.push(("assistant", text.into())),
                Turn::Call {
                    thought,
                    name,
                    arguments,
                    ..
                } => {
                    if !thought.is_empty() {
                        messages.push(("assistant", thought.into()));
                    }
                    messages.push(("tool_call", call_json(name, arguments).into()));
                }
                Turn::Outcome { text, images, .. } => messages.push((
                    "tool_response",
                    [text, tags(images).as_str()].concat().into(),
                )),
            }
        }
        messages
    }
}

/// The line of a History for a call whose texts are refused.
const UNTOLD_CALL: &str = "I called a tool.";

/// What stands for an image in a text.
pub(crate) const IMAGE_TAG: &str = "<image>";

/// How many images a text stands for.
pub(crate) fn tags_in(text: &str) -> usize {
    text.matches(IMAGE_TAG).count()
}

/// `{"name": ..., "arguments": {...}}`
pub(crate) fn call_json(name: &str, arguments: &str) -> String {
    format!(
        "{{\"name\":{},\"arguments\":{arguments}}}",
        json::quoted(name)
    )
}

/// The examples of an episode.
#[derive(Clone, Debug, Default)]
pub struct Examples {
    /// The examples, in the order of their decisions.
    pub examples: Vec<Example>,
    /// What was left out because of its texts. Steps that are not to be learned do not count.
    pub refused: Vec<RefusedDecision>,
}

/// Makes the examples of an episode; every text that goes out is stripped of payloads and refused
/// where that is not enough.
pub fn examples(episode: &Episode, options: &ExampleOptions) -> Examples {
    let told = &episode.briefing;
    let mut made = Examples::default();
    let refuse = |call: Option<u32>, reason: &RefusalReason| RefusedDecision {
        episode_id: episode.episode_id.clone(),
        call,
        reason: reason.clone(),
    };
    if let Some(reason) = told.refusal() {
        made.refused.push(refuse(None, reason));
        return made;
    }
    // Single turns are put in the words of REAL's tools.
    if episode.agent.is_some() && options.style != Style::MultiTurn {
        return made;
    }
    let silent = |step: &Step| is_spoken(episode, step) && step.message.trim().is_empty();
    let learned = |step: &&Step| {
        step.learn && (options.failed_calls || step.error.is_none()) && !silent(step)
    };
    let wanted: Vec<usize> = (0..episode.steps.len())
        .filter(|index| learned(&&episode.steps[*index]))
        .collect();
    let Some(&last) = wanted.last() else {
        return made;
    };
    let outcomes: Vec<Cow<'_, str>> = episode
        .steps
        .iter()
        .map(|step| strip(&step.outcome))
        .collect();
    let arguments: Vec<String> = episode
        .steps
        .iter()
        .map(|step| prompt::arguments(&step.arguments))
        .collect();
    let checks = Checks::of(episode, &arguments, &outcomes);
    let about = Arc::new(about(episode));
    let example = |index: usize, turns: Vec<Turn>, tools: Option<Arc<SharedText>>| {
        let step = &episode.steps[index];
        let id = format!("{}/{}", episode.episode_id, step.call);
        let (about, tool, rollout) = (Arc::clone(&about), step.tool.clone(), step.rollout.clone());
        Example {
            id,
            call: step.call,
            tool,
            about,
            style: options.style,
            turns,
            tools,
            rollout,
        }
    };
    if options.style == Style::SingleTurn {
        let (episode_prompt, setting) = told.single_turn();
        let mut turn = SingleTurn::new(Arc::clone(episode_prompt));
        let (mut history, mut log) = (HistoryLines::default(), None);
        for (index, step) in episode.steps.iter().enumerate() {
            let last = match told.call_log() {
                true => CallLog::Last(log.as_deref()),
                false => CallLog::Off,
            };
            let written = DecisionAnswer {
                reasoning: &step.reasoning,
                history: &history.next(&step.history, last),
                schedule: &step.schedule,
                subtask: &step.subtask,
                tool_name: &step.call_name,
                arguments: Some(&step.arguments),
            };
            let answer = step.answer.clone().unwrap_or_else(|| written.text());
            if wanted.binary_search(&index).is_ok() {
                match checks.single_turn(index) {
                    Some(reason) => made.refused.push(refuse(Some(step.call), reason)),
                    None => {
                        // REAL's first prompt holds no observation yet, and so no image.
                        let images = if index == 0 {
                            Vec::new()
                        } else {
                            step.images.clone()
                        };
                        let user = Turn::User {
                            setting: Arc::clone(setting),
                            situation: turn.rest(),
                            images,
                        };
                        made.examples.push(example(
                            index,
                            vec![user, Turn::Answer(answer.clone())],
                            None,
                        ));
                    }
                }
            }
            let images = episode
                .steps
                .get(index + 1)
                .map_or(0, |next| next.images.len());
            turn.update(
                &answer,
                &CallOutcome {
                    tool: &step.call_name,
                    text: &outcomes[index],
                    images,
                    held: step.held.as_deref(),
                },
            );
            // A text that is refused must not come back as a line of the History.
            log = Some(match checks.call(index) {
                Some(_) => UNTOLD_CALL.to_owned(),
                None => prompt::log_line(&step.call_name, &step.arguments, &outcomes[index]),
            });
        }
        return made;
    }
    let Opening {
        system,
        setting,
        tools,
    } = Opening::of(episode);
    let targets = if options.style == Style::MultiTurn {
        vec![last]
    } else {
        wanted.clone()
    };
    for target in targets {
        if let Some(reason) = checks.conversation(target) {
            let call =
                (options.style == Style::MultiTurnPrefix).then(|| episode.steps[target].call);
            made.refused.push(refuse(call, reason));
            continue;
        }
        let learn = |index: usize| {
            if options.style == Style::MultiTurn {
                wanted.binary_search(&index).is_ok()
            } else {
                index == target
            }
        };
        let first = Turn::User {
            setting: Arc::clone(&setting),
            situation: String::new(),
            images: episode.steps[0].images.clone(),
        };
        let mut turns: Vec<Turn> = system.iter().cloned().map(Turn::System).collect();
        turns.push(first);
        // What was said and is not yet in a turn: nobody answered it.
        let mut unanswered = String::new();
        for (index, step) in episode.steps[..=target].iter().enumerate() {
            let (id, name) = (format!("call_{}", step.call), step.call_name.clone());
            let said = prompt::thought(&step.reasoning) + &step.message;
            if !said.is_empty() && !unanswered.is_empty() {
                unanswered.push_str("\n\n");
            }
            unanswered.push_str(&said);
            if is_spoken(episode, step) {
                let answer = &outcomes[index];
                if index == target || !answer.trim().is_empty() {
                    turns.push(Turn::Answer(mem::take(&mut unanswered)));
                }
                if index < target && !answer.trim().is_empty() {
                    turns.push(Turn::User {
                        setting: Arc::default(),
                        situation: answer.clone().into_owned(),
                        images: episode.steps[index + 1].images.clone(),
                    });
                }
                continue;
            }
            let (thought, arguments) = (mem::take(&mut unanswered), arguments[index].clone());
            turns.push(Turn::Call {
                thought,
                id: id.clone(),
                name: name.clone(),
                arguments,
                learn: learn(index),
            });
            if index < target {
                let seen = &episode.steps[index + 1].images;
                let images = if *seen == step.images {
                    Vec::new()
                } else {
                    seen.clone()
                };
                turns.push(Turn::Outcome {
                    id,
                    name,
                    text: outcomes[index].clone().into_owned(),
                    images,
                });
            }
        }
        made.examples.push(example(target, turns, tools.clone()));
    }
    made
}

/// Whether a step is a turn without a call, of an agent with tools of its own.
fn is_spoken(episode: &Episode, step: &Step) -> bool {
    episode.agent.is_some() && step.call_name == SPOKEN_TURN
}

/// How a conversation begins.
struct Opening {
    system: Option<Arc<SharedText>>,
    setting: Arc<SharedText>,
    tools: Option<Arc<SharedText>>,
}

impl Opening {
    fn of(episode: &Episode) -> Self {
        let Some(AgentSetup {
            system,
            tools: own_tools,
        }) = &episode.agent
        else {
            return Self {
                system: Some(Arc::clone(&SYSTEM_MULTI_TURN)),
                setting: episode.briefing.briefing(),
                tools: Some(tools(episode.names)),
            };
        };
        let shared = |text: &str| Arc::new(SharedText::new(text));
        Self {
            system: system.as_deref().map(shared),
            setting: shared(episode.briefing.instruction()),
            tools: own_tools.as_deref().map(shared),
        }
    }
}

static SYSTEM_MULTI_TURN: LazyLock<Arc<SharedText>> =
    LazyLock::new(|| Arc::new(SharedText::new(prompt::SYSTEM_MULTI_TURN.trim_end())));

/// The tools as native tool calling names them.
fn tools(names: NameSet) -> Arc<SharedText> {
    static PAPER: LazyLock<Arc<SharedText>> = LazyLock::new(|| native(NameSet::Paper));
    static REAL_REPO: LazyLock<Arc<SharedText>> = LazyLock::new(|| native(NameSet::RealRepo));
    fn native(names: NameSet) -> Arc<SharedText> {
        Arc::new(SharedText::new(prompt::functions(names).to_string()))
    }
    Arc::clone(match names {
        NameSet::Paper => &PAPER,
        NameSet::RealRepo => &REAL_REPO,
    })
}

fn about(episode: &Episode) -> EpisodeInfo {
    EpisodeInfo {
        episode_id: episode.episode_id.clone(),
        task_id: episode.task_id.clone(),
        family: episode.family.clone(),
        scene_id: episode.scene_id.clone(),
        policy: episode.policy.clone(),
        instruction: episode.briefing.instruction().to_owned(),
        split: episode.split,
        source: episode.source.clone(),
        prompt_digest: episode.briefing.prompt().digest().to_string(),
        provenance: OnceLock::new(),
    }
}

impl EpisodeInfo {
    fn provenance(&self) -> &str {
        self.provenance.get_or_init(|| {
            let source = &self.source;
            let fields: [(&str, &str); 16] = [
                ("episode", &self.episode_id),
                ("task", &self.task_id),
                ("family", &self.family),
                ("scene", &self.scene_id),
                ("policy", &self.policy),
                ("split", self.split.as_str()),
                ("trace_digest", &source.trace_digest),
                ("trace_uri", &source.trace_uri),
                ("verdict", &source.verdict),
                ("verdict_sim_version", &source.verdict_sim_version),
                ("preset", &source.preset),
                ("preset_digest", &source.preset_digest),
                ("rules_version", &source.rules_version),
                ("table_version", &source.table_version.to_string()),
                ("annotator", &source.annotator),
                ("prompt_digest", &self.prompt_digest),
            ];
            let field = |(key, value): &(&str, &str)| match *key {
                "table_version" => format!("\"{key}\":{value}"),
                _ => format!("\"{key}\":{}", json::quoted(value)),
            };
            fields.iter().map(field).collect::<Vec<_>>().join(",")
        })
    }
}
