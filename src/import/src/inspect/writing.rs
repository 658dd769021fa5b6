//! Traces are written as the samples of a log.

use std::{
    collections::{BTreeMap, BTreeSet},
    io,
    path::Path,
};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use reel_trace::Trace;
use reel_world::{
    ErrorCode, Task,
    record::{EndReason, EndRecord, Score, StepRecord},
};
use serde::Serialize;
use serde_json::{Map, Value, json};

use super::{
    archive::ArchiveWriter,
    model::{
        Call, CallError, Choice, Content, Message, Output, Part, Sample, SampleError, Usage,
        VERSION,
    },
};
use crate::atif::{self, Content as Words, OURS, Part as WordsPart, Source, Step};

/// Name of the task in the logs that are written: each sample names its own.
const TASK: &str = "reel";
/// Most characters of a text in a summary.
const SUMMARY_CHARACTERS: usize = 1000;

/// Key of the object that stands for the value of a score that was not given, until the document
/// is written as text.
const UNSCORED: &str = "reel: not scored";

/// A document in JSON, with NaN where Inspect has it: as the value of a score that was not given.
fn json_of(document: &impl Serialize) -> serde_json::Result<Vec<u8>> {
    let text = serde_json::to_string(document)?;
    // No text within the document can hold this: its quotation marks would be escaped.
    let unscored = json!({ UNSCORED: null }).to_string();
    Ok(text.replace(&unscored, "NaN").into_bytes())
}

/// A log that is being written: one policy with the episodes that it played.
pub struct LogWriter {
    archive: ArchiveWriter,
    policy: String,
    /// The epochs of each task that are written.
    epochs: BTreeMap<String, BTreeSet<u32>>,
    summaries: Vec<Value>,
    /// Sum and number of each score that is a number.
    scores: BTreeMap<String, (f64, u32)>,
    tokens: Usage,
}

impl LogWriter {
    /// Begins a log of what a policy played.
    ///
    /// # Errors
    /// When the file cannot be made.
    pub fn create(path: &Path, policy: &str) -> io::Result<Self> {
        Ok(Self {
            archive: ArchiveWriter::create(path)?,
            policy: policy.to_owned(),
            epochs: BTreeMap::new(),
            summaries: Vec::new(),
            scores: BTreeMap::new(),
            tokens: Usage::default(),
        })
    }

    /// Adds an episode as a sample, with its images. Its epoch is its number among the rollouts of
    /// its group, if none of the task has that; else the next one that is free.
    ///
    /// # Errors
    /// When a record cannot be written as JSON, or the file not at all.
    pub fn add(&mut self, trace: &Trace) -> io::Result<()> {
        let epochs = self.epochs.entry(trace.task.task_id.clone()).or_default();
        let numbered = trace
            .header
            .rollout_index
            .and_then(|index| index.checked_add(1));
        let numbered = numbered.filter(|epoch| !epochs.contains(epoch));
        let free = || {
            (1..)
                .find(|epoch| !epochs.contains(epoch))
                .unwrap_or_default()
        };
        let epoch = numbered.unwrap_or_else(free);
        epochs.insert(epoch);
        let sample = sample(trace, epoch)?;
        let usage = sample.output.usage.unwrap_or_default();
        self.tokens.input_tokens += usage.input_tokens;
        self.tokens.output_tokens += usage.output_tokens;
        self.tokens.total_tokens += usage.total_tokens;
        for (name, score) in &sample.scores {
            let value = match &score["value"] {
                Value::String(grade) => Some(f64::from(u8::from(grade == "C"))),
                value => value.as_f64(),
            };
            if let Some(value) = value {
                let (sum, count) = self.scores.entry(name.clone()).or_default();
                *sum += value;
                *count += 1;
            }
        }
        let input: String = trace
            .task
            .instruction
            .chars()
            .take(SUMMARY_CHARACTERS)
            .collect();
        self.summaries.push(json!({
            "id": sample.id, "epoch": sample.epoch, "input": input, "target": sample.target, "scores": sample.scores,
            "model_usage": usage_of(&self.policy, usage), "completed": true, "retries": 0, "uuid": sample.uuid,
            "error": sample.error.as_ref().map(|error| &error.message),
            "limit": sample.limit.as_ref().map(|limit| &limit["type"]), "message_count": sample.messages.len(),
        }));
        // As Inspect names them.
        let name = format!("samples/{}_epoch_{epoch}.json", trace.task.task_id);
        self.archive.add(&name, &json_of(&sample)?)
    }

    /// Writes header and summaries. `created` is the log's time in ISO 8601 with its zone.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn finish(mut self, created: &str) -> io::Result<()> {
        let samples = self.summaries.len();
        let scores = self.scores.iter().map(|(name, (sum, count))| {
            let mean = json!({"name": "mean", "value": sum / f64::from(*count), "params": {}});
            json!({"name": name, "scorer": name, "params": {}, "metrics": {"mean": mean}})
        });
        let epochs = self.epochs.values().filter_map(BTreeSet::last).max();
        let epochs = epochs.copied().unwrap_or(1);
        let id = reel_world::Digest::of_json(&self.summaries).to_string();
        let ids: Vec<&String> = self.epochs.keys().collect();
        let header = json!({
            "version": VERSION,
            "status": "success",
            "eval": {
                "eval_id": id[..22], "run_id": id[22..44], "created": created, "task": TASK, "task_id": id[44..], "task_version": 0,
                "task_attribs": {}, "task_args": {}, "dataset": {"name": TASK, "samples": ids.len(), "sample_ids": ids, "shuffled": false},
                "model": self.policy, "model_args": {}, "config": {"epochs": epochs}, "packages": {TASK: env!("CARGO_PKG_VERSION")},
            },
            "plan": {"name": "plan", "steps": [], "config": {}},
            "results": {"total_samples": samples, "completed_samples": samples, "scores": scores.collect::<Value>()},
            "stats": {"started_at": created, "completed_at": created, "model_usage": usage_of(&self.policy, self.tokens)},
        });
        self.archive
            .add("summaries.json", &json_of(&self.summaries)?)?;
        self.archive
            .add("header.json", &serde_json::to_vec(&header)?)?;
        self.archive.finish()
    }
}

fn usage_of(model: &str, usage: Usage) -> Value {
    if usage == Usage::default() {
        json!({})
    } else {
        json!({ model: usage })
    }
}

fn sample(trace: &Trace, epoch: u32) -> io::Result<Sample> {
    // Images are named by their number, and put where they are named.
    let exported = atif::export(trace, "", &[])?;
    let images: BTreeMap<String, Vec<u8>> = exported.images.into_iter().collect();
    let mut told = exported.trajectory;
    let mut messages: Vec<Message> = Vec::new();
    let mut usage = Usage::default();
    let mut records = trace.steps.iter();
    for step in told.steps {
        match step.source {
            Source::System => messages.push(said("system", content(step.message, &images))),
            Source::User => messages.push(said("user", content(step.message, &images))),
            Source::Agent => {
                if let Some(record) = records.next() {
                    decision(step, record, &images, &mut messages, &mut usage);
                }
            }
        }
    }
    for (number, message) in messages.iter_mut().enumerate() {
        message.id = Some(format!("{}-{number}", trace.header.episode_id));
    }
    let policy = &trace.header.policy.name;
    let written = |message: &&Message| message.role == "assistant";
    for message in messages
        .iter_mut()
        .filter(|message| message.role == "assistant")
    {
        message.model = Some(policy.clone());
    }
    let choice = messages.iter().rfind(written).map(|message| Choice {
        message: message.clone(),
        stop_reason: "stop".to_owned(),
    });
    let end = trace.end.as_ref();
    Ok(Sample {
        id: trace.task.task_id.clone().into(),
        epoch,
        input: trace.task.instruction.clone().into(),
        target: target(&trace.task),
        messages,
        output: Output {
            model: policy.clone(),
            choices: choice.into_iter().collect(),
            usage: (usage != Usage::default()).then_some(usage),
        },
        scores: end.map(|end| scores(&trace.task, end)).unwrap_or_default(),
        metadata: std::mem::take(&mut told.extra),
        store: Map::new(),
        events: Vec::new(),
        attachments: BTreeMap::new(),
        error: end
            .filter(|end| end.reason == EndReason::Fault)
            .map(|_| SampleError {
                message: fault(trace).to_owned(),
                ..SampleError::default()
            }),
        limit: end
            .filter(|end| end.reason == EndReason::Horizon)
            .map(|end| limit(trace, end)),
        uuid: Some(trace.header.episode_id.clone()),
    })
}

/// What ended an episode with a fault: what the log said from which it came, if it came from one.
fn fault(trace: &Trace) -> &str {
    let told = trace.header.policy.parameters.get("error");
    told.and_then(Value::as_str)
        .unwrap_or("a fault ended the episode")
}

/// Which limit ended an episode: what the log said from which it came, else its number of decisions.
fn limit(trace: &Trace, end: &EndRecord) -> Value {
    let told = trace.header.policy.parameters.get("limit");
    // Inspect reads no limit without a type and a number.
    let is_read = |told: &&Value| told["type"].is_string() && told["limit"].is_number();
    let told = told.filter(is_read).cloned();
    told.unwrap_or_else(
        || json!({"type": "custom", "limit": end.steps, "reason": "the horizon of the task"}),
    )
}

fn said(role: &str, content: Content) -> Message {
    Message {
        role: role.to_owned(),
        content,
        ..Message::default()
    }
}

/// What would be right: the changes of the goal, or what the log said from which the task came.
fn target(task: &Task) -> Value {
    if !task.has_goal() {
        let target = task.extra.get("target").filter(|it| !it.is_null());
        let target = target.cloned().unwrap_or("".into());
        // Inspect reads a text or a list of texts.
        let is_read = match &target {
            Value::Array(parts) => parts.iter().all(Value::is_string),
            other => other.is_string(),
        };
        return if is_read {
            target
        } else {
            target.to_string().into()
        };
    }
    let changes = task.goal_changes();
    changes.iter().map(ToString::to_string).collect()
}

/// The messages of a decision: what the policy said and called, and what it got.
fn decision(
    step: Step,
    record: &StepRecord,
    images: &BTreeMap<String, Vec<u8>>,
    messages: &mut Vec<Message>,
    usage: &mut Usage,
) {
    let mut metadata = step.extra;
    if let Some([read, written]) = record
        .input
        .policy
        .as_ref()
        .and_then(|policy| policy.tokens)
    {
        usage.input_tokens = usage.input_tokens.saturating_add(read);
        usage.output_tokens = usage.output_tokens.saturating_add(written);
        usage.total_tokens = usage.input_tokens.saturating_add(usage.output_tokens);
        // A message has no tokens of its own.
        if let Some(policy) = metadata
            .get_mut(OURS)
            .and_then(|kept| kept.pointer_mut("/input/policy"))
        {
            policy["tokens"] = json!([read, written]);
        }
    }
    let reasoning = step
        .reasoning_content
        .map(|reasoning| Part::Reasoning { reasoning });
    let mut parts: Vec<Part> = reasoning.into_iter().collect();
    match content(step.message, images) {
        Content::Text(text) if text.is_empty() => {}
        Content::Text(text) => parts.push(Part::Text { text }),
        Content::Parts(more) => parts.extend(more),
    }
    let calls = step.tool_calls.into_iter().map(|call| Call {
        id: call.tool_call_id,
        function: call.function_name,
        arguments: call.arguments,
        parse_error: None,
    });
    messages.push(Message {
        tool_calls: calls.collect(),
        metadata,
        ..said("assistant", Content::Parts(parts))
    });
    for result in step.observation.into_iter().flat_map(|seen| seen.results) {
        let words = result.content.map(|words| content(words, images));
        let words = words.unwrap_or_default();
        let Some(id) = result.source_call_id else {
            if words != Content::default() {
                messages.push(said("user", words));
            }
            continue;
        };
        messages.push(Message {
            tool_call_id: Some(id),
            function: Some(record.input.call.name.clone()),
            error: record.outcome.error.map(|code| CallError {
                kind: "unknown".to_owned(),
                // Which code it has tells more than words, but for agents with tools of their own.
                message: match &record.outcome.text {
                    text if code == ErrorCode::BackendError && !text.is_empty() => text.clone(),
                    _ => code.as_str().to_owned(),
                },
            }),
            ..said("tool", words)
        });
    }
}

/// A content with its images in it.
fn content(words: Words, images: &BTreeMap<String, Vec<u8>>) -> Content {
    let parts = match words {
        Words::Text(text) => return Content::Text(text),
        Words::Parts(parts) => parts,
    };
    let part = |part| match part {
        WordsPart::Text { text } => Some(Part::Text { text }),
        WordsPart::Image { source } => images.get(&source.path).map(|bytes| Part::Image {
            image: format!(
                "data:{};base64,{}",
                source.media_type,
                STANDARD.encode(bytes)
            ),
        }),
        WordsPart::Audio { .. } => None,
    };
    Content::Parts(parts.into_iter().filter_map(part).collect())
}

/// The scores of an episode: success, completion and reward where its task has a goal, and those
/// that were reported.
fn scores(task: &Task, end: &EndRecord) -> Map<String, Value> {
    let mut scores = Map::new();
    let mut add = |name: &str, value: Value, explanation: Option<&str>| {
        let value = if value.is_null() {
            json!({ UNSCORED: null })
        } else {
            value
        };
        scores.insert(
            name.to_owned(),
            json!({"value": value, "explanation": explanation}),
        );
    };
    if let Some(success) = end
        .success(task)
        .filter(|_| task.has_goal() || end.reported.scores.is_empty())
    {
        add("success", if success { "C" } else { "I" }.into(), None);
    }
    if task.has_goal() {
        add("completion", end.metrics.completion.into(), None);
        add("total_reward", end.metrics.total_reward.into(), None);
    }
    for Score {
        name,
        value,
        label,
        explanation,
    } in &end.reported.scores
    {
        let value = label.clone().map(Value::from).or(value.map(Value::from));
        add(name, value.unwrap_or_default(), explanation.as_deref());
    }
    scores
}
