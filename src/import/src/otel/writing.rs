//! A trace is written as spans.

use std::collections::BTreeMap;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use reel_otlp::{
    ExportTraceServiceRequest, InstrumentationScope, KeyValue, Resource, Span, Status,
    any_value::Value as Attribute,
    batches,
    span::{Event, SpanKind},
    status::StatusCode,
};
use reel_trace::Trace;
use reel_world::{
    DT_S, Digest,
    record::{EndReason, StepRecord},
};
use serde::Serialize;
use serde_json::{Value, json};

use super::{REQUEST_BYTES_MAX, names};
use crate::atif::{self, Content, OURS, Part, Source, Step, Trajectory};

/// When spans begin that have no clock: 2000-01-01, in nanoseconds since 1970.
const START_UNIX_NS: u64 = 946_684_800_000_000_000;
/// Shortest time of a span, so that starts tell the order.
const SPAN_NS_MIN: u64 = 1_000;
/// The provider of an agent that asks no model, and of one whose provider is not recorded.
const PROVIDER: &str = "reel";

/// How spans hold images.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum ImageParts {
    /// A part of type `uri` with the digest of the image.
    #[default]
    Reference,
    /// A part of type `blob` with the image in base64.
    Blob,
}

/// What spans hold of a trace.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SpanOptions {
    /// Whether they hold words: messages, arguments, results, and the records of Reel.
    pub content: bool,
    /// How they hold images; without words they hold none.
    pub images: ImageParts,
    /// When the episode was.
    pub clock: SpanClock,
}

/// When an episode was. Traces of the simulator have no clock: it took what the policy and the simulated robot took.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum SpanClock {
    /// By the clock of the trace; without one it begins with the year 2000, so that equal traces give equal spans.
    #[default]
    Recorded,
    /// It begins then, in nanoseconds since 1970.
    StartsAt(u64),
    /// By the clock of the trace; without one it ends then, in nanoseconds since 1970.
    EndsAt(u64),
}

impl Default for SpanOptions {
    fn default() -> Self {
        Self {
            content: true,
            images: ImageParts::Reference,
            clock: SpanClock::Recorded,
        }
    }
}

/// A trace as the spans of one trace of a collector, the root first. `tools` are those that the policy could call, in
/// OpenAI's schema.
///
/// # Errors
/// When a record cannot be written as JSON.
pub fn export(
    trace: &Trace,
    tools: &[Value],
    options: &SpanOptions,
) -> serde_json::Result<Vec<Span>> {
    let exported = atif::export(trace, "", tools)?;
    let mut writer = Writer::new(trace, &exported.trajectory, exported.images, *options);
    writer.spans.push(Span::default());
    let mut records = trace.steps.iter();
    let mut opening = Vec::new();
    for step in &exported.trajectory.steps {
        match step.source {
            Source::System => {}
            Source::User => opening.push(step),
            Source::Agent => {
                if let Some(record) = records.next() {
                    writer.decision(step, record, &opening)?;
                    opening.clear();
                }
            }
        }
    }
    let root = writer.root(&exported.trajectory)?;
    writer.spans[0] = root;
    if let (SpanClock::EndsAt(end), None) = (options.clock, recorded_start(trace)) {
        let late = i128::from(end) - i128::from(writer.spans[0].end_time_unix_nano);
        writer.spans.iter_mut().for_each(|span| shift(span, late));
    }
    Ok(writer.spans)
}

/// A trace as requests to a collector, each of a size that it takes.
///
/// # Errors
/// As [`export`].
pub fn requests(
    trace: &Trace,
    tools: &[Value],
    options: &SpanOptions,
) -> serde_json::Result<Vec<ExportTraceServiceRequest>> {
    let resource = Resource {
        attributes: vec![
            KeyValue::new("service.name", "reel"),
            KeyValue::new("service.version", trace.header.build.as_str()),
        ],
        ..Resource::default()
    };
    let scope = InstrumentationScope {
        name: "reel".to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        ..InstrumentationScope::default()
    };
    let spans = export(trace, tools, options)?;
    Ok(batches(&resource, &scope, spans, REQUEST_BYTES_MAX))
}

/// Spans on their way.
struct Writer<'a> {
    trace: &'a Trace,
    images: BTreeMap<String, Vec<u8>>,
    options: SpanOptions,
    /// Digest that all ids follow from.
    seed: String,
    model: String,
    conversation: String,
    spans: Vec<Span>,
    start_ns: u64,
    now_ns: u64,
    sim_step: u64,
    /// What the policy got since its last response.
    news: Vec<Value>,
}

impl<'a> Writer<'a> {
    fn new(
        trace: &'a Trace,
        told: &Trajectory,
        images: Vec<(String, Vec<u8>)>,
        options: SpanOptions,
    ) -> Self {
        let header = &trace.header;
        let chain = trace.chain().to_string();
        let start_ns = match options.clock {
            SpanClock::StartsAt(start) => start,
            SpanClock::Recorded | SpanClock::EndsAt(_) => {
                recorded_start(trace).unwrap_or(START_UNIX_NS)
            }
        };
        Self {
            trace,
            images: images.into_iter().collect(),
            options,
            seed: format!("{}\n{}\n{chain}", header.run_id, header.episode_id),
            model: told
                .agent
                .model_name
                .clone()
                .unwrap_or_else(|| header.policy.name.clone()),
            conversation: chain,
            spans: Vec::new(),
            start_ns,
            now_ns: start_ns,
            sim_step: 0,
            news: Vec::new(),
        }
    }

    /// The id of a span: the first bytes of a digest.
    fn id<const N: usize>(&self, kind: &str, step: Option<u32>) -> Vec<u8> {
        let step = step.map_or_else(String::new, |step| step.to_string());
        Digest::of(format!("otel\n{kind}\n{step}\n{}", self.seed).as_bytes()).0[..N].to_vec()
    }

    fn span(&mut self, kind: &str, step: u32, name: &str, took_ns: u64) -> Span {
        let start = self.now_ns;
        self.now_ns = self.now_ns.saturating_add(took_ns.max(SPAN_NS_MIN));
        Span {
            trace_id: self.id::<16>("trace", None),
            span_id: self.id::<8>(kind, Some(step)),
            parent_span_id: self.id::<8>("invoke_agent", None),
            name: format!("{kind} {name}"),
            start_time_unix_nano: start,
            end_time_unix_nano: self.now_ns,
            attributes: vec![
                KeyValue::new(names::OPERATION, kind),
                KeyValue::new(names::CONVERSATION, self.conversation.as_str()),
                KeyValue::new(names::AGENT_NAME, self.trace.header.policy.name.as_str()),
                KeyValue::new(names::STEP, step),
            ],
            ..Span::default()
        }
    }

    /// The spans of a decision: what the policy said, if it said anything, and the call.
    fn decision(
        &mut self,
        step: &Step,
        record: &StepRecord,
        opening: &[&Step],
    ) -> serde_json::Result<()> {
        for turn in opening {
            let parts = self.parts(&turn.message, false);
            self.news.push(json!({"role": "user", "parts": parts}));
        }
        let timing = self.trace.timings.get(&record.step).copied();
        let latency_ns = record.input.policy.as_ref().and_then(|it| it.latency_ns);
        let starts = matches!(self.options.clock, SpanClock::StartsAt(_));
        if let Some(timing) = timing.filter(|_| !starts) {
            self.now_ns = (timing.called_unix_ns)
                .saturating_sub(latency_ns.unwrap_or_default())
                .max(self.now_ns);
        }
        let called = step.tool_calls.first();
        let spoke = step.message != Content::Text(String::new())
            || step.reasoning_content.is_some()
            || step.metrics.is_some();
        let result = step.observation.iter().flat_map(|seen| &seen.results);
        let result = result.filter_map(|result| result.content.as_ref()).next();
        let kept = self.kept(&step.extra)?;
        if spoke || called.is_none() {
            let mut chat = self.chat(step, record.step, latency_ns.unwrap_or_default());
            if called.is_none() {
                chat.attributes.extend(kept.clone());
                let result = result.filter(|it| **it != Content::Text(String::new()));
                if let (Some(result), true) = (result, self.options.content) {
                    chat.attributes
                        .push(KeyValue::new(names::RESULT, self.result(result)));
                    let parts = self.parts(result, false);
                    self.news.push(json!({"role": "user", "parts": parts}));
                }
                chat.events.extend(self.reward(record));
            }
            self.spans.push(chat);
        }
        let Some(call) = called else { return Ok(()) };
        let simulated = record.sim_step.saturating_sub(self.sim_step) as f64 * f64::from(DT_S);
        self.sim_step = record.sim_step;
        let took_ns = timing.map_or((simulated * 1e9) as u64, |timing| timing.took_ns);
        let mut tool = self.span("execute_tool", record.step, &call.function_name, took_ns);
        tool.kind = SpanKind::Internal.into();
        tool.attributes.extend([
            KeyValue::new(names::TOOL_NAME, call.function_name.as_str()),
            KeyValue::new(names::TOOL_TYPE, "function"),
            KeyValue::new(names::CALL_ID, call.tool_call_id.as_str()),
            KeyValue::new("reel.reward", record.reward_total()),
        ]);
        if let Some(error) = record.outcome.error {
            tool.attributes
                .push(KeyValue::new(names::ERROR_TYPE, error.as_str()));
            tool.status = Some(failed(error.as_str()));
        }
        if self.options.content {
            let arguments = call.arguments.to_string();
            tool.attributes
                .push(KeyValue::new(names::CALL_ARGUMENTS, arguments));
            if let Some(result) = result {
                tool.attributes
                    .push(KeyValue::new(names::CALL_RESULT, self.result(result)));
                let mut response = vec![json!({
                    "type": "tool_call_response", "id": call.tool_call_id, "response": result.text(),
                })];
                // The words stand in the response.
                let parts = self.parts(result, false).into_iter();
                response.extend(parts.filter(|part| part["type"] != "text"));
                self.news.push(json!({"role": "tool", "parts": response}));
            }
        }
        tool.attributes.extend(kept);
        tool.events.extend(self.reward(record));
        self.spans.push(tool);
        Ok(())
    }

    /// The span of a response, with what came since the last one.
    fn chat(&mut self, step: &Step, number: u32, took_ns: u64) -> Span {
        let model = self.model.clone();
        let mut chat = self.span("chat", number, &model, took_ns);
        chat.kind = SpanKind::Client.into();
        chat.attributes.extend([
            KeyValue::new(names::PROVIDER, self.provider()),
            KeyValue::new(names::REQUEST_MODEL, model),
        ]);
        let tokens = step.metrics.as_ref();
        let tokens = [
            (names::INPUT_TOKENS, tokens.and_then(|it| it.prompt_tokens)),
            (
                names::OUTPUT_TOKENS,
                tokens.and_then(|it| it.completion_tokens),
            ),
        ];
        for (name, count) in tokens {
            chat.attributes
                .extend(count.map(|count| KeyValue::new(name, count)));
        }
        let news = std::mem::take(&mut self.news);
        if !self.options.content {
            return chat;
        }
        let reasoning = step.reasoning_content.iter();
        let mut parts: Vec<Value> = reasoning
            .map(|words| json!({"type": "reasoning", "content": words}))
            .collect();
        parts.extend(self.parts(&step.message, false));
        parts.extend(step.tool_calls.iter().map(|call| {
            json!({"type": "tool_call", "id": call.tool_call_id, "name": call.function_name, "arguments": call.arguments})
        }));
        let output = json!([{"role": "assistant", "parts": parts}]);
        chat.attributes.extend([
            KeyValue::new(names::INPUT_MESSAGES, Value::from(news).to_string()),
            KeyValue::new(names::OUTPUT_MESSAGES, output.to_string()),
        ]);
        chat
    }

    fn provider(&self) -> String {
        let told = self.trace.header.policy.parameters.get("provider");
        told.and_then(Value::as_str).unwrap_or(PROVIDER).to_owned()
    }

    /// What a record keeps of a trace beside the conventions, where words may be written.
    fn kept(&self, extra: &serde_json::Map<String, Value>) -> serde_json::Result<Option<KeyValue>> {
        let kept = extra.get(OURS).filter(|_| self.options.content);
        let text = kept.map(serde_json::to_string).transpose()?;
        Ok(text.map(|text| KeyValue::new(names::RECORD, text)))
    }

    /// The parts of a message; `whole` images stand in blobs where the options say so.
    fn parts(&self, content: &Content, whole: bool) -> Vec<Value> {
        let parts = match content {
            Content::Text(text) if text.is_empty() => return Vec::new(),
            Content::Text(text) => return vec![json!({"type": "text", "content": text})],
            Content::Parts(parts) => parts,
        };
        let part = |part: &Part| match part {
            Part::Text { text } => Some(json!({"type": "text", "content": text})),
            Part::Image { source } => {
                let bytes = self.images.get(&source.path)?;
                let mime = &source.media_type;
                Some(match whole && self.options.images == ImageParts::Blob {
                    true => {
                        json!({"type": "blob", "modality": "image", "mime_type": mime, "content": STANDARD.encode(bytes)})
                    }
                    false => {
                        let uri = format!("blake3:{}", Digest::of(bytes));
                        json!({"type": "uri", "modality": "image", "mime_type": mime, "uri": uri})
                    }
                })
            }
            Part::Audio { .. } => None,
        };
        parts.iter().filter_map(part).collect()
    }

    /// A result: its words, or a list of parts where it has an image, or words that could be taken for such a list.
    fn result(&self, content: &Content) -> String {
        match content {
            Content::Text(text) if !text.trim_start().starts_with(['[', '"']) => text.clone(),
            content => Value::from(self.parts(content, true)).to_string(),
        }
    }

    /// The reward of a step as the result of an evaluation.
    fn reward(&self, record: &StepRecord) -> Option<Event> {
        if record.reward.is_empty() {
            return None;
        }
        let terms = record.reward.iter().map(|term| {
            let reason = Some(term.reason.as_str()).filter(|_| self.options.content);
            let reason = reason.filter(|reason| !reason.is_empty());
            let reason = reason.map_or_else(String::new, |reason| format!(" ({reason})"));
            format!("{} {}{reason}", term.component, term.value)
        });
        let why = terms.collect::<Vec<_>>().join("; ");
        Some(self.evaluation("reward", Some(record.reward_total()), None, Some(&why)))
    }

    fn evaluation(
        &self,
        name: &str,
        value: Option<f64>,
        label: Option<&str>,
        explanation: Option<&str>,
    ) -> Event {
        let facts = [
            Some(KeyValue::new(names::EVALUATION_NAME, name)),
            value.map(|value| KeyValue::new(names::SCORE_VALUE, value)),
            label.map(|label| KeyValue::new(names::SCORE_LABEL, label)),
            explanation.map(|words| KeyValue::new(names::EXPLANATION, words)),
        ];
        Event {
            time_unix_nano: self.now_ns,
            name: names::EVALUATION.to_owned(),
            attributes: facts.into_iter().flatten().collect(),
            ..Event::default()
        }
    }

    /// The span of the episode, once all others are made.
    fn root(&self, told: &Trajectory) -> serde_json::Result<Span> {
        let header = &self.trace.header;
        let policy = &header.policy.name;
        let end = self.trace.end.as_ref();
        let mut attributes = vec![
            KeyValue::new(names::OPERATION, "invoke_agent"),
            KeyValue::new(names::PROVIDER, self.provider()),
            KeyValue::new(names::AGENT_NAME, policy.as_str()),
            KeyValue::new(names::CONVERSATION, self.conversation.as_str()),
            KeyValue::new(names::REQUEST_MODEL, self.model.as_str()),
        ];
        let version = Some(&told.agent.version).filter(|it| !it.is_empty() && *it != "unknown");
        attributes.extend(version.map(|it| KeyValue::new(names::AGENT_VERSION, it.as_str())));
        attributes.extend(self.facts());
        if self.options.content {
            attributes.extend(self.words(told));
            if let Some(kept) = told.extra.get(OURS) {
                attributes.push(KeyValue::new(names::EPISODE, serde_json::to_string(kept)?));
            }
        }
        let fault = end.is_some_and(|end| end.reason == EndReason::Fault);
        if fault {
            attributes.push(KeyValue::new(names::ERROR_TYPE, "fault"));
        }
        Ok(Span {
            trace_id: self.id::<16>("trace", None),
            span_id: self.id::<8>("invoke_agent", None),
            name: format!("invoke_agent {policy}"),
            kind: SpanKind::Internal.into(),
            start_time_unix_nano: self.start_ns,
            end_time_unix_nano: self.now_ns.max(self.start_ns.saturating_add(SPAN_NS_MIN)),
            attributes,
            events: self.scores(),
            status: fault.then(|| failed("a fault ended the episode")),
            ..Span::default()
        })
    }

    /// What Reel knows of the episode, without words.
    fn facts(&self) -> Vec<KeyValue> {
        let header = &self.trace.header;
        let end = self.trace.end.as_ref();
        let success = end.and_then(|end| end.success(&self.trace.task));
        let goal = end.filter(|_| self.trace.task.has_goal());
        let text = |text: String| Some(Attribute::from(text));
        let number = |value: f64| Attribute::from(value);
        let facts = [
            ("task_id", text(header.task_id.clone())),
            ("family", text(name_of(&header.family))),
            ("scene_id", text(header.scene_id.clone())),
            ("run_id", text(header.run_id.clone())),
            ("episode_id", text(header.episode_id.clone())),
            ("group_id", header.group_id.clone().map(Attribute::from)),
            ("rollout_index", header.rollout_index.map(Attribute::from)),
            // Its 64 bits have no sign.
            ("seed", text(header.seed.to_string())),
            ("profile", text(name_of(&header.profile))),
            ("backend", text(name_of(&header.backend))),
            ("reward_preset", text(header.reward_preset.clone())),
            ("sim_version", Some(header.sim_version.into())),
            ("build", text(header.build.clone())),
            ("trace_digest", text(self.conversation.clone())),
            ("steps", Some((self.trace.steps.len() as u32).into())),
            ("end_reason", end.map(|end| name_of(&end.reason).into())),
            ("success", success.map(Attribute::from)),
            ("completion", goal.map(|end| number(end.metrics.completion))),
            (
                "total_reward",
                goal.map(|end| number(end.metrics.total_reward)),
            ),
        ];
        let known = facts.into_iter();
        known
            .filter_map(|(name, value)| Some(KeyValue::new(&format!("reel.{name}"), value?)))
            .collect()
    }

    /// The words of the whole episode: what it was asked, with which tools, and what was said last.
    fn words(&self, told: &Trajectory) -> Vec<KeyValue> {
        let of = |source| told.steps.iter().filter(move |step| step.source == source);
        let system: Vec<Value> = of(Source::System)
            .flat_map(|step| self.parts(&step.message, true))
            .collect();
        let asked: Vec<Value> = of(Source::User)
            .map(|step| json!({"role": "user", "parts": self.parts(&step.message, true)}))
            .collect();
        let last = of(Source::Agent).next_back();
        let last = last.map(|step| self.parts(&step.message, true));
        let last = last.filter(|parts| !parts.is_empty());
        let last = last.map(|parts| json!([{"role": "assistant", "parts": parts}]));
        let tools: Vec<Value> = told.agent.tool_definitions.iter().map(flat_tool).collect();
        [
            (names::SYSTEM_INSTRUCTIONS, Value::from(system)),
            (names::INPUT_MESSAGES, Value::from(asked)),
            (names::OUTPUT_MESSAGES, last.unwrap_or_default()),
            (names::TOOL_DEFINITIONS, Value::from(tools)),
        ]
        .into_iter()
        .filter(|(_, value)| value.as_array().is_some_and(|list| !list.is_empty()))
        .map(|(name, value)| KeyValue::new(name, value.to_string()))
        .collect()
    }

    /// How the episode ended, as results of evaluations.
    fn scores(&self) -> Vec<Event> {
        let Some(end) = &self.trace.end else {
            return Vec::new();
        };
        let mut events = Vec::new();
        if let Some(success) = end.success(&self.trace.task) {
            let (value, label) = if success {
                (1.0, "pass")
            } else {
                (0.0, "fail")
            };
            events.push(self.evaluation("success", Some(value), Some(label), None));
        }
        if self.trace.task.has_goal() {
            let metrics = &end.metrics;
            events.push(self.evaluation("completion", Some(metrics.completion), None, None));
            events.push(self.evaluation("total_reward", Some(metrics.total_reward), None, None));
        }
        for score in &end.reported.scores {
            let words = score.explanation.as_deref();
            let words = words.filter(|_| self.options.content);
            events.push(self.evaluation(&score.name, score.value, score.label.as_deref(), words));
        }
        events
    }
}

/// When the first call came, less what the policy took for it, where the trace has a clock.
fn recorded_start(trace: &Trace) -> Option<u64> {
    let (step, timing) = trace.timings.first_key_value()?;
    let record = trace.steps.iter().find(|record| record.step == *step)?;
    let latency_ns = record.input.policy.as_ref().and_then(|it| it.latency_ns);
    Some((timing.called_unix_ns).saturating_sub(latency_ns.unwrap_or_default()))
}

/// Moves a span in time.
fn shift(span: &mut Span, by_ns: i128) {
    let moved = |time: &mut u64| {
        *time = u64::try_from(i128::from(*time) + by_ns).unwrap_or(0);
    };
    moved(&mut span.start_time_unix_nano);
    moved(&mut span.end_time_unix_nano);
    span.events
        .iter_mut()
        .for_each(|event| moved(&mut event.time_unix_nano));
}

fn failed(message: &str) -> Status {
    Status {
        message: message.to_owned(),
        code: StatusCode::Error.into(),
    }
}

/// The name that a value of an enum has in JSON.
fn name_of(value: &impl Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(Value::String(name)) => name,
        Ok(other) => other.to_string(),
        Err(_) => String::new(),
    }
}

/// A tool as the conventions have it: what OpenAI's schema has below `function` stands beside `type`.
fn flat_tool(tool: &Value) -> Value {
    let Some(function) = tool.get("function").and_then(Value::as_object) else {
        return tool.clone();
    };
    let mut flat = serde_json::Map::from_iter([("type".to_owned(), "function".into())]);
    flat.extend(function.clone());
    Value::Object(flat)
}
