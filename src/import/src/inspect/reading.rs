//! Logs are found and read; each of their samples is written as a trace.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use reel_world::record::{EndReason, Reported, Score};
use serde_json::{Map, Value, json};

use super::{
    archive::Archive,
    model::{Content, Header, Message, Part, Sample, Spec, Usage},
};
use crate::{
    ImportError, ImportLoss, ImportOptions, ImportedEpisode, SuccessRule,
    atif::{
        Agent, Call, CallResult, Content as Words, Episode, LogFacts, Media, OURS, Observation,
        Part as WordsPart, Source, Step, StepMetrics, Trajectory, VERSION, read_file,
    },
    layout::files_below,
    lenient,
};

/// Largest log that is one JSON document.
const BYTES_MAX: u64 = 1 << 30;
/// How texts and images name an attachment of their sample.
const ATTACHMENT: &str = "attachment://";

/// The logs under a folder, or the file itself: files `.eval`, and files `.json` that begin like a
/// log.
///
/// # Errors
/// When a folder cannot be listed, or there is none.
pub fn logs(root: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let found = files_below(root, |path| {
        path.extension().is_some_and(|end| end == "eval") || is_log(path)
    })?;
    if found.is_empty() {
        return Err(ImportError::NoLog {
            root: root.to_owned(),
        });
    }
    Ok(found)
}

/// Whether a file is one JSON document with the parts of a log.
fn is_log(path: &Path) -> bool {
    path.extension().is_some_and(|end| end == "json")
        && read_file(path, BYTES_MAX).is_ok_and(|bytes| {
            let parts = lenient::document::<BTreeMap<String, serde::de::IgnoredAny>>(&bytes);
            parts.is_ok_and(|parts| {
                ["eval", "samples"]
                    .iter()
                    .all(|key| parts.contains_key(*key))
            })
        })
}

/// Writes the samples of a log as traces into the folder `out`, which exists. Equal samples give
/// equal bytes under an equal name. A sample that cannot be imported has its error in its place.
///
/// # Errors
/// When the file is no log, it has no sample, or a trace cannot be written.
pub fn import(
    source: &Path,
    out: &Path,
    options: &ImportOptions<'_>,
    rule: Option<&SuccessRule>,
) -> Result<Vec<Result<ImportedEpisode, ImportError>>, ImportError> {
    let refuse = |reason: String| ImportError::Storage {
        path: source.to_owned(),
        reason,
    };
    let log = Log {
        source,
        out,
        options,
        rule,
    };
    let mut results = Vec::new();
    let mut keep = |sample: Result<ImportedEpisode, ImportError>, lost: Option<String>| {
        let lost = lost.map(|message| ImportLoss {
            file: source.to_owned(),
            message,
        });
        match sample {
            Err(ImportError::Trace(error)) => return Err(ImportError::Trace(error)),
            Ok(mut imported) => {
                imported.losses.extend(lost);
                results.push(Ok(imported));
            }
            refused => results.push(refused),
        }
        Ok(())
    };
    if source.extension().is_some_and(|end| end == "json") {
        let bytes = read_file(source, BYTES_MAX).map_err(&refuse)?;
        let header: Header = lenient::document(&bytes)
            .map_err(|error| refuse(format!("not a log of Inspect: {error}")))?;
        // The document is read at once: the first sample tells what is lost of any.
        let mut lost = lenient::long_integers_told(&bytes);
        for (number, sample) in (1..).zip(header.samples.unwrap_or_default()) {
            let sample = serde_json::from_value(sample)
                .map_err(|error| refuse(format!("sample {number} is not understood: {error}")));
            let sample = sample.and_then(|sample| log.sample(&header.eval, sample));
            let lost = if sample.is_ok() { lost.take() } else { None };
            keep(sample, lost)?;
        }
    } else {
        let mut archive = Archive::open(source).map_err(&refuse)?;
        // A log that broke off has no header yet, but what it began with.
        let names = ["header.json", "_journal/start.json"];
        let name = names.iter().find(|name| archive.has(name));
        let name = name.ok_or_else(|| refuse("no log of Inspect: it has no header".to_owned()))?;
        let (header, _): (Header, _) = archive.read(name).map_err(&refuse)?;
        for name in archive.samples() {
            match archive.read(&name).map_err(&refuse) {
                Ok((sample, lost)) => keep(log.sample(&header.eval, sample), lost)?,
                Err(error) => keep(Err(error), None)?,
            }
        }
    }
    if results.is_empty() {
        return Err(refuse("the log has no sample".to_owned()));
    }
    Ok(results)
}

/// A log on its way to traces.
struct Log<'a> {
    source: &'a Path,
    out: &'a Path,
    options: &'a ImportOptions<'a>,
    rule: Option<&'a SuccessRule>,
}

impl Log<'_> {
    fn sample(&self, spec: &Spec, mut sample: Sample) -> Result<ImportedEpisode, ImportError> {
        let facts = facts(spec, &sample, self.rule);
        let unmet = SuccessRule::unmet(self.rule, &facts.reported.scores);
        let kept = sample.metadata.remove(OURS);
        let uuid = sample.uuid.take();
        let place = format!("sample {}, epoch {}", sample.id, sample.epoch);
        let tool_definitions = tools(&sample);
        let (steps, left_out) = turns(sample);
        let trajectory = Trajectory {
            schema_version: VERSION.to_owned(),
            session_id: uuid,
            trajectory_id: None,
            agent: Agent {
                name: spec.model.clone(),
                version: String::new(),
                model_name: Some(spec.model.clone()),
                tool_definitions,
                extra: Map::new(),
            },
            steps,
            notes: None,
            final_metrics: None,
            continued_trajectory_ref: None,
            extra: kept
                .map(|kept| (OURS.to_owned(), kept))
                .into_iter()
                .collect(),
            subagent_trajectories: Vec::new(),
        };
        let mut episode = Episode::new(self.source, self.options, facts);
        unmet.into_iter().for_each(|what| episode.note(what));
        left_out.into_iter().for_each(|what| episode.lose(what));
        let written = episode.write(trajectory, self.out);
        written.map_err(|error| match error {
            ImportError::NoStep { path, reason } => ImportError::NoStep {
                path,
                reason: format!("{place}: {reason}"),
            },
            other => other,
        })
    }
}

/// What a log tells of a sample beside its conversation.
fn facts(spec: &Spec, sample: &Sample, rule: Option<&SuccessRule>) -> LogFacts {
    let id = match &sample.id {
        Value::String(id) => id.clone(),
        other => other.to_string(),
    };
    let task_id = format!("{}/{id}", spec.task);
    let scores = scores(&sample.scores);
    let success = SuccessRule::judge(rule, &scores);
    let of_task = [
        (
            "target",
            Some(sample.target.clone()).filter(|it| !is_empty(it)),
        ),
        (
            "metadata",
            Some(Value::Object(without_ours(&sample.metadata))).filter(|it| !is_empty(it)),
        ),
    ];
    let settings = [
        ("eval_id", spec.eval_id.clone().map(Value::from)),
        ("solver", spec.solver.clone().map(Value::from)),
        ("task_version", spec.task_version.clone()),
        ("epoch", Some(sample.epoch.into())),
        (
            "error",
            sample
                .error
                .as_ref()
                .map(|error| error.message.clone().into()),
        ),
        ("limit", sample.limit.clone()),
    ];
    let named = |facts: Vec<(&str, Option<Value>)>| -> BTreeMap<String, Value> {
        let known = facts.into_iter();
        known
            .filter_map(|(name, value)| Some((name.to_owned(), value.filter(|it| !it.is_null())?)))
            .collect()
    };
    LogFacts {
        group: (spec.config.epochs.unwrap_or(1) > 1).then(|| {
            let eval = spec.eval_id.as_deref().unwrap_or(&spec.task);
            (format!("{eval}/{id}"), sample.epoch.saturating_sub(1))
        }),
        task_id: Some(task_id),
        task_type: Some(spec.task.clone()).filter(|task| !task.is_empty()),
        task_facts: named(of_task.into()),
        parameters: named(settings.into()),
        failed_calls: failed_calls(&sample.messages),
        end: match (&sample.error, &sample.limit) {
            (Some(_), _) => Some(EndReason::Fault),
            (None, Some(limit)) if !limit.is_null() => Some(EndReason::Horizon),
            _ => None,
        },
        reported: Reported { success, scores },
    }
}

fn failed_calls(messages: &[Message]) -> BTreeSet<String> {
    let wrong_arguments = messages.iter().flat_map(|message| &message.tool_calls);
    let wrong_arguments = wrong_arguments.filter(|call| call.parse_error.is_some());
    let failed = messages.iter().filter(|message| message.error.is_some());
    let failed = failed.filter_map(|message| message.tool_call_id.clone());
    wrong_arguments
        .map(|call| call.id.clone())
        .chain(failed)
        .collect()
}

fn without_ours(metadata: &Map<String, Value>) -> Map<String, Value> {
    let others = metadata.iter().filter(|(key, _)| *key != OURS);
    others
        .map(|(key, value)| (key.clone(), value.clone()))
        .collect()
}

fn is_empty(value: &Value) -> bool {
    match value {
        Value::Null => true,
        Value::String(text) => text.is_empty(),
        Value::Array(items) => items.is_empty(),
        Value::Object(fields) => fields.is_empty(),
        Value::Bool(_) | Value::Number(_) => false,
    }
}

/// The scores of a sample, those of several values one by one. One that was not given has no value.
fn scores(told: &Map<String, Value>) -> Vec<Score> {
    let mut scores = Vec::new();
    for (name, score) in told {
        let explanation = score.get("explanation").and_then(Value::as_str);
        let mut add = |name: String, value: &Value| {
            let (value, label) = match value {
                Value::Null => (None, None),
                Value::Number(number) => (number.as_f64(), None),
                Value::Bool(flag) => (Some(f64::from(u8::from(*flag))), Some(flag.to_string())),
                Value::String(text) => (number_of(text), Some(text.clone())),
                other => (None, Some(other.to_string())),
            };
            scores.push(Score {
                name,
                value,
                label,
                explanation: explanation.map(str::to_owned),
            });
        };
        match score.get("value").unwrap_or(score) {
            Value::Object(parts) => {
                for (part, value) in parts {
                    add(format!("{name}.{part}"), value);
                }
            }
            Value::Array(parts) => {
                for (number, value) in parts.iter().enumerate() {
                    add(format!("{name}.{number}"), value);
                }
            }
            value => add(name.clone(), value),
        }
    }
    scores
}

/// The number that Inspect takes for a grade.
fn number_of(label: &str) -> Option<f64> {
    match label.to_ascii_lowercase().as_str() {
        "c" | "yes" | "true" => Some(1.0),
        "p" => Some(0.5),
        "i" | "n" | "no" | "false" => Some(0.0),
        other => other.parse().ok().filter(|number: &f64| number.is_finite()),
    }
}

/// The tools that were declared to the model, each as it was declared first: a log names all of
/// them with every inference of the model.
fn tools(sample: &Sample) -> Vec<Value> {
    let mut names = BTreeSet::new();
    let declared = sample.events.iter().flat_map(|event| &event.tools);
    declared
        .filter_map(|tool| {
            let name = tool.get("name")?.as_str()?;
            if !names.insert(name) {
                return None;
            }
            let of_function = ["name", "description", "parameters"];
            let known = of_function.map(|key| Some((key.to_owned(), tool.get(key)?.clone())));
            let function: Map<String, Value> = known.into_iter().flatten().collect();
            Some(json!({"type": "function", "function": function}))
        })
        .collect()
}

/// The conversation as turns, and what of it no turn can hold.
fn turns(sample: Sample) -> (Vec<Step>, Vec<String>) {
    let tokens: BTreeMap<String, Usage> = sample
        .events
        .into_iter()
        .filter(|event| event.event == "model")
        .filter_map(|event| {
            let id = event.output.choices.into_iter().next()?.message.id?;
            Some((id, event.output.usage?))
        })
        .collect();
    let mut reader = Reader {
        attachments: sample.attachments,
        tokens,
        steps: Vec::new(),
        left_out: Vec::new(),
    };
    let before = |message: &&Message| message.role != "assistant";
    let mut opening = sample.messages.iter().take_while(before);
    let is_asked = opening.any(|message| message.role == "user");
    if let (false, Value::String(input)) = (is_asked, &sample.input) {
        reader.say(Source::User, Words::Text(input.clone()));
    }
    for message in sample.messages {
        reader.message(message);
    }
    for (number, step) in (1..).zip(&mut reader.steps) {
        step.step_id = number;
    }
    (reader.steps, reader.left_out)
}

/// Makes turns of messages.
struct Reader {
    attachments: BTreeMap<String, String>,
    /// Tokens by the message that the model wrote.
    tokens: BTreeMap<String, Usage>,
    steps: Vec<Step>,
    left_out: Vec<String>,
}

impl Reader {
    fn say(&mut self, source: Source, message: Words) {
        self.steps.push(Step {
            message,
            ..Step::of(source)
        });
    }

    fn message(&mut self, message: Message) {
        let place = format!("message {}", self.steps.len() + 1);
        let (words, reasoning) = self.content(message.content, &place);
        match message.role.as_str() {
            "assistant" => {
                let usage = message.id.and_then(|id| self.tokens.remove(&id));
                let mut extra = message.metadata;
                extra.retain(|key, _| key == OURS);
                let call = |call: super::model::Call| Call {
                    tool_call_id: call.id,
                    function_name: call.function,
                    arguments: call.arguments,
                };
                self.steps.push(Step {
                    message: words,
                    reasoning_content: (!reasoning.is_empty()).then_some(reasoning),
                    tool_calls: message.tool_calls.into_iter().map(call).collect(),
                    metrics: usage.map(|usage| StepMetrics {
                        prompt_tokens: Some(usage.input_tokens),
                        completion_tokens: Some(usage.output_tokens),
                        ..StepMetrics::default()
                    }),
                    extra,
                    ..Step::of(Source::Agent)
                });
            }
            "tool" => {
                // Where there is no other result, the model reads the error.
                let error = message.error.map(|error| error.message);
                let content = match (words, error) {
                    (Words::Text(text), Some(error)) if text.is_empty() => Words::Text(error),
                    (words, _) => words,
                };
                let result = CallResult {
                    source_call_id: message.tool_call_id,
                    content: Some(content),
                };
                let turn = self.steps.iter_mut().rev();
                match turn.into_iter().find(|step| step.source == Source::Agent) {
                    Some(step) => step
                        .observation
                        .get_or_insert_with(|| Observation {
                            results: Vec::new(),
                        })
                        .results
                        .push(result),
                    None => self.left_out.push(format!(
                        "{place}: a result before the first call is left out"
                    )),
                }
            }
            "system" => self.say(Source::System, words),
            _ => self.say(Source::User, words),
        }
    }

    /// The words and images of a content, and the reasoning in it.
    fn content(&mut self, content: Content, place: &str) -> (Words, String) {
        let parts = match content {
            Content::Text(text) => return (Words::Text(self.resolved(text)), String::new()),
            Content::Parts(parts) => parts,
        };
        let (mut words, mut thoughts) = (Vec::new(), Vec::new());
        for part in parts {
            match part {
                Part::Text { text } => words.push(WordsPart::Text {
                    text: self.resolved(text),
                }),
                Part::Reasoning { reasoning } => thoughts.push(self.resolved(reasoning)),
                Part::Image { image } => words.push(WordsPart::Image {
                    source: Media {
                        media_type: String::new(),
                        path: self.resolved(image),
                    },
                }),
                Part::Other => self.left_out.push(format!(
                    "{place}: a part that is neither text, reasoning nor image is left out"
                )),
            }
        }
        (Words::Parts(words), thoughts.join("\n"))
    }

    /// A text, or the attachment that it names.
    fn resolved(&self, text: String) -> String {
        let attached = text.strip_prefix(ATTACHMENT);
        let attached = attached.and_then(|name| self.attachments.get(name));
        attached.cloned().unwrap_or(text)
    }
}
