//! Examples: a conversation up to a decision, from which a model learns that decision (SPEC sections 4 and 8).
//! Owns what becomes an example and what is refused. Knows no format, no file.

use std::{
    borrow::Cow,
    fmt,
    sync::{Arc, LazyLock},
};

use reel_prompt::{self as prompt, Decision};
use reel_world::NameSet;
use serde::Serialize;

use crate::{Episode, ImageId, LeakKind, Rollout, Secrets, Source, Split, Step, json, privileged, strip};

/// How a decision is put to a model.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Style {
    /// The paper's: one user turn with everything, the latest pictures only, the answer as text.
    #[default]
    SingleTurn,
    /// Native tool calls: an example is an episode up to the last decision to learn.
    MultiTurn,
    /// Native tool calls: an example is the conversation up to one decision, and only that one is learned.
    MultiTurnPrefix,
}

impl Style {
    /// All of them.
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

/// A text that many examples share: its JSON escapes are made once.
#[derive(PartialEq, Eq, Debug)]
pub struct Text {
    raw: String,
    escaped: Vec<u8>,
}

impl Text {
    /// Escapes it.
    pub fn new(raw: impl Into<String>) -> Self {
        let raw = raw.into();
        let mut escaped = Vec::with_capacity(raw.len() + raw.len() / 8);
        json::escape(&mut escaped, &raw);
        Self { raw, escaped }
    }

    /// The text.
    pub fn as_str(&self) -> &str {
        &self.raw
    }

    pub(crate) fn escaped(&self) -> &[u8] {
        &self.escaped
    }
}

/// A turn of the conversation.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Turn {
    /// How to behave.
    System(Arc<Text>),
    /// What the agent is told: what every decision of the episode is told, what only this one is, the pictures.
    User {
        /// The same for the whole episode.
        setting: Arc<Text>,
        /// Of this decision.
        situation: String,
        /// What it sees.
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
        /// The call's.
        id: String,
        /// The tool as it was called.
        name: String,
        /// What it told.
        text: String,
        /// What the agent saw.
        images: Vec<ImageId>,
    },
}

impl Turn {
    /// Its pictures.
    pub fn images(&self) -> &[ImageId] {
        match self {
            Turn::User { images, .. } | Turn::Outcome { images, .. } => images,
            _ => &[],
        }
    }
}

/// What all examples of an episode have in common.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct About {
    /// As in the trace.
    pub episode_id: String,
    /// The task's id.
    pub task_id: String,
    /// The task's family.
    pub family: String,
    /// The scene.
    pub scene_id: String,
    /// Who decided.
    pub policy: String,
    /// What the agent was told to do.
    pub instruction: String,
    /// The part of the dataset.
    pub split: Split,
    /// Where it comes from.
    pub source: Source,
    /// The fields of the provenance that are the episode's, as JSON without braces.
    provenance: String,
}

/// What a model learns one decision, or one episode, from.
#[derive(Clone, PartialEq, Debug)]
pub struct Example {
    /// `<episode>/<call>`; a whole episode's call is its last.
    pub id: String,
    /// The decision to learn; the last one of a whole episode.
    pub call: u32,
    /// Its tool by the name in the paper.
    pub tool: String,
    /// Its episode.
    pub about: Arc<About>,
    /// How it is put.
    pub style: Style,
    /// The conversation; the last turn is what is learned.
    pub turns: Vec<Turn>,
    /// The tools as a JSON list of `{type: function, function: {name, description, parameters}}`, where they are not in the
    /// user's turn.
    pub tools: Option<Arc<Text>>,
    /// What the decision was worth, in rows for reinforcement learning.
    pub rollout: Option<Rollout>,
}

impl Example {
    /// Its pictures, in the order of their tags.
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
        out.extend_from_slice(self.about.provenance.as_bytes());
        out.push(b'}');
    }

    /// The turns as (role, text) with one `<image>` tag a picture; calls as JSON under `tool_call`, outcomes under
    /// `tool_response`: what the tables' column `messages` holds.
    pub fn messages(&self) -> Vec<(&'static str, Cow<'_, str>)> {
        let tags = |images: &[ImageId]| "<image>".repeat(images.len());
        let mut messages = Vec::with_capacity(self.turns.len());
        for turn in &self.turns {
            match turn {
                Turn::System(text) => messages.push(("system", text.as_str().into())),
                Turn::User { setting, situation, images } => {
                    messages.push(("user", [setting.as_str(), situation, &tags(images)].concat().into()));
                }
                Turn::Answer(text) => messages.push(("assistant", text.into())),
                Turn::Call { thought, name, arguments, .. } => {
                    if !thought.is_empty() {
                        messages.push(("assistant", thought.into()));
                    }
                    messages.push(("tool_call", call_json(name, arguments).into()));
                }
                Turn::Outcome { text, images, .. } => {
                    messages.push(("tool_response", [text, tags(images).as_str()].concat().into()))
                }
            }
        }
        messages
    }
}

/// `{"name": ..., "arguments": {...}}`
pub(crate) fn call_json(name: &str, arguments: &str) -> String {
    format!("{{\"name\":{},\"arguments\":{arguments}}}", json::quoted(name))
}

/// A decision that did not become an example, or an episode that gave none.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Refused {
    /// The episode.
    pub episode_id: String,
    /// The decision; none where the whole episode was refused.
    pub call: Option<u32>,
    /// Why.
    pub reason: Refusal,
}

/// Why a decision is refused.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Refusal {
    /// Something that an agent must not know is in a text.
    Leak {
        /// What.
        kind: LeakKind,
        /// In which text, e.g. `History of call 3`.
        field: String,
        /// How it begins.
        excerpt: String,
    },
    /// A text holds what trainers take for a picture or a turn.
    Tag {
        /// What.
        tag: &'static str,
        /// In which text.
        field: String,
    },
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Refusal::Leak { kind, field, excerpt } => write!(f, "{field} holds {kind}: {excerpt:?}"),
            Refusal::Tag { tag, field } => write!(f, "{field} holds {tag:?}, which trainers take for a turn or a picture"),
        }
    }
}

/// The examples of an episode.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Examples {
    /// In order.
    pub examples: Vec<Example>,
    /// What was left out because of its texts. Steps that are not to be learned do not count.
    pub refused: Vec<Refused>,
}

/// Makes the examples of an episode; every text that goes out is stripped of payloads and refused where that is not enough.
pub fn examples(episode: &Episode, options: &ExampleOptions, secrets: &Secrets) -> Examples {
    let outcomes: Vec<String> = episode.steps.iter().map(|step| strip(&step.outcome).into_owned()).collect();
    let checks = Checks::of(episode, &outcomes, secrets);
    let about = Arc::new(about(episode));
    let learned = |step: &&Step| step.learn && (options.failed_calls || step.error.is_none());
    let wanted: Vec<usize> = (0..episode.steps.len()).filter(|index| learned(&&episode.steps[*index])).collect();
    let mut made = Examples::default();
    let refuse =
        |call: Option<u32>, reason: &Refusal| Refused { episode_id: episode.episode_id.clone(), call, reason: reason.clone() };
    if let Some(reason) = &checks.setting {
        made.refused.push(refuse(None, reason));
        return made;
    }
    let Some(&last) = wanted.last() else {
        return made;
    };
    let example = |index: usize, turns: Vec<Turn>, tools: Option<Arc<Text>>| {
        let step = &episode.steps[index];
        let id = format!("{}/{}", episode.episode_id, step.call);
        let (about, tool, rollout) = (Arc::clone(&about), step.tool.clone(), step.rollout.clone());
        Example { id, call: step.call, tool, about, style: options.style, turns, tools, rollout }
    };
    if options.style == Style::SingleTurn {
        let system = Arc::new(Text::new(prompt::SYSTEM_SINGLE_TURN.trim_end()));
        let setting = Arc::new(Text::new(setting(episode, Some(episode.names))));
        let decisions: Vec<Decision<'_>> =
            episode.steps.iter().zip(&outcomes).map(|(step, outcome)| decision(step, outcome)).collect();
        for index in wanted {
            match checks.single_turn(index) {
                Some(reason) => made.refused.push(refuse(Some(episode.steps[index].call), reason)),
                None => {
                    let step = &episode.steps[index];
                    let mut situation = prompt::situation(&decisions[..index]);
                    if !step.images.is_empty() {
                        situation.push_str(prompt::VIEW);
                    }
                    let user = Turn::User { setting: Arc::clone(&setting), situation, images: step.images.clone() };
                    let turns = vec![Turn::System(Arc::clone(&system)), user, Turn::Answer(prompt::answer(&decisions[index]))];
                    made.examples.push(example(index, turns, None));
                }
            }
        }
        return made;
    }
    let system = Arc::new(Text::new(prompt::SYSTEM_MULTI_TURN.trim_end()));
    let setting = Arc::new(Text::new(setting(episode, None)));
    let tools = tools(episode.names);
    let targets = if options.style == Style::MultiTurn { vec![last] } else { wanted.clone() };
    for target in targets {
        if let Some(reason) = checks.conversation(target) {
            let call = (options.style == Style::MultiTurnPrefix).then(|| episode.steps[target].call);
            made.refused.push(refuse(call, reason));
            continue;
        }
        let learn =
            |index: usize| if options.style == Style::MultiTurn { wanted.binary_search(&index).is_ok() } else { index == target };
        let first =
            Turn::User { setting: Arc::clone(&setting), situation: String::new(), images: episode.steps[0].images.clone() };
        let mut turns = vec![Turn::System(Arc::clone(&system)), first];
        for (index, step) in episode.steps[..=target].iter().enumerate() {
            let (id, name) = (format!("call_{}", step.call), step.call_name.clone());
            let (thought, arguments) = (prompt::thought(&step.reasoning), prompt::arguments(&step.arguments));
            turns.push(Turn::Call { thought, id: id.clone(), name: name.clone(), arguments, learn: learn(index) });
            if index < target {
                let seen = &episode.steps[index + 1].images;
                let images = if *seen == step.images { Vec::new() } else { seen.clone() };
                turns.push(Turn::Outcome { id, name, text: outcomes[index].clone(), images });
            }
        }
        made.examples.push(example(target, turns, Some(Arc::clone(&tools))));
    }
    made
}

fn setting(episode: &Episode, tools: Option<NameSet>) -> String {
    let receptacles = episode.receptacles.iter().map(|it| (it.id.as_str(), it.category.as_str(), it.room.as_str()));
    prompt::setting(&episode.instruction, tools, receptacles)
}

/// The tools as native tool calling names them.
fn tools(names: NameSet) -> Arc<Text> {
    static PAPER: LazyLock<Arc<Text>> = LazyLock::new(|| native(NameSet::Paper));
    static REAL_REPO: LazyLock<Arc<Text>> = LazyLock::new(|| native(NameSet::RealRepo));
    fn native(names: NameSet) -> Arc<Text> {
        Arc::new(Text::new(prompt::functions(names).to_string()))
    }
    Arc::clone(match names {
        NameSet::Paper => &PAPER,
        NameSet::RealRepo => &REAL_REPO,
    })
}

fn decision<'a>(step: &'a Step, outcome: &'a str) -> Decision<'a> {
    let Step { call, call_name, arguments, reasoning, history, schedule, subtask, .. } = step;
    Decision { call: *call, name: call_name, arguments, outcome, reasoning, history, schedule, subtask }
}

fn about(episode: &Episode) -> About {
    let source = &episode.source;
    let fields: [(&str, &str); 16] = [
        ("episode", &episode.episode_id),
        ("task", &episode.task_id),
        ("family", &episode.family),
        ("scene", &episode.scene_id),
        ("policy", &episode.policy),
        ("split", episode.split.as_str()),
        ("trace_digest", &source.trace_digest),
        ("trace_uri", &source.trace_uri),
        ("verdict", &source.verdict),
        ("verdict_sim_version", &source.verdict_sim_version),
        ("preset", &source.preset),
        ("preset_digest", &source.preset_digest),
        ("rules_version", &source.rules_version),
        ("table_version", &source.table_version.to_string()),
        ("annotator", &source.annotator),
        ("prompt_digest", &prompt::digest().to_string()),
    ];
    let field = |(key, value): &(&str, &str)| match *key {
        "table_version" => format!("\"{key}\":{value}"),
        _ => format!("\"{key}\":{}", json::quoted(value)),
    };
    About {
        episode_id: episode.episode_id.clone(),
        task_id: episode.task_id.clone(),
        family: episode.family.clone(),
        scene_id: episode.scene_id.clone(),
        policy: episode.policy.clone(),
        instruction: episode.instruction.clone(),
        split: episode.split,
        source: source.clone(),
        provenance: fields.iter().map(field).collect::<Vec<_>>().join(","),
    }
}

/// What is wrong with each text of an episode; each is looked at once, however many examples repeat it.
struct Checks {
    setting: Option<Refusal>,
    steps: Vec<StepChecks>,
}

#[derive(Default)]
struct StepChecks {
    reasoning: Option<Refusal>,
    /// History, New Schedule, Current subtask.
    state: Option<Refusal>,
    action: Option<Refusal>,
    outcome: Option<Refusal>,
}

impl Checks {
    fn of(episode: &Episode, outcomes: &[String], secrets: &Secrets) -> Self {
        let check = |field: &dyn Fn() -> String, text: &str| {
            if text.is_empty() {
                return None;
            }
            let tag = CONTROL_TAGS.iter().find(|tag| text.contains('<') && text.contains(**tag));
            if let Some(tag) = tag {
                return Some(Refusal::Tag { tag, field: field() });
            }
            let leak = privileged(text, secrets)?;
            Some(Refusal::Leak { kind: leak.kind, field: field(), excerpt: leak.excerpt(text) })
        };
        // One look at many texts, line by line, says that none of them needs a look of its own. Where there may be JSON, each
        // does: of one text only so much of it is read.
        let clean = |texts: &[&str]| {
            let together = texts.join("\n");
            !together.contains(['{', '[']) && check(&String::new, &together).is_none()
        };
        let listed = |it: &crate::Receptacle| format!("{} ({}, {})", it.id, it.category, it.room);
        let receptacle = |it: &crate::Receptacle| check(&|| format!("receptacle {}", it.id), &listed(it));
        let receptacles: Vec<String> = episode.receptacles.iter().map(listed).collect();
        let setting = check(&|| "the instruction".into(), &episode.instruction).or_else(|| {
            let clean = clean(&receptacles.iter().map(String::as_str).collect::<Vec<_>>());
            if clean { None } else { episode.receptacles.iter().find_map(receptacle) }
        });
        let steps = episode.steps.iter().zip(outcomes).map(|(step, outcome)| {
            let of = |what: &'static str| move || format!("{what} of call {}", step.call);
            let Step { reasoning, history, schedule, subtask, call_name, .. } = step;
            let arguments = check(&of("the arguments"), &step.arguments.to_string());
            if clean(&[reasoning, history, schedule, subtask, call_name, outcome]) {
                return StepChecks { action: arguments, ..StepChecks::default() };
            }
            StepChecks {
                reasoning: check(&of("the reasoning"), reasoning),
                state: check(&of("the History"), history)
                    .or_else(|| check(&of("the New Schedule"), schedule))
                    .or_else(|| check(&of("the Current subtask"), subtask)),
                action: check(&of("the tool"), call_name).or(arguments),
                outcome: check(&of("the outcome"), outcome),
            }
        });
        Self { setting, steps: steps.collect() }
    }

    /// Of a decision with the state, action and outcome before it.
    fn single_turn(&self, index: usize) -> Option<&Refusal> {
        let StepChecks { reasoning, state, action, .. } = &self.steps[index];
        let said = [reasoning, state, action].into_iter().find_map(Option::as_ref);
        said.or_else(|| {
            let before = self.steps.get(index.checked_sub(1)?)?;
            [&before.state, &before.action, &before.outcome].into_iter().find_map(Option::as_ref)
        })
    }

    /// Of a conversation up to and with a decision; its state is not in it.
    fn conversation(&self, target: usize) -> Option<&Refusal> {
        let said = self.steps[..=target].iter().find_map(|step| step.reasoning.as_ref().or(step.action.as_ref()));
        said.or_else(|| self.steps[..target].iter().find_map(|step| step.outcome.as_ref()))
    }
}

/// What trainers and templates take for pictures, turns or thoughts.
const CONTROL_TAGS: [&str; 10] = [
    "<image>",
    "<video>",
    "<audio>",
    "<|",
    "<think>",
    "</think>",
    "<tool_call>",
    "</tool_call>",
    "<tool_response>",
    "</tool_response>",
];
