//! What the clients of a world know: what they sent, and what was acknowledged. Held against the
//! disk when all is over.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use axum::body::Bytes;
use hyper::StatusCode;
use reel_trace::{Trace, TraceError, TraceFiles};
use reel_world::record::StepRecord;
use serde_json::Value;

/// What the clients of a world know.
pub struct Ledger {
    /// Whole traces that are uploaded, which are no recordings of this server.
    pub samples: Vec<Bytes>,
    /// Id of a task that is served.
    pub task: String,
    /// Whether the disk may fail.
    pub faults: bool,
    calls: BTreeMap<String, Vec<SentCall>>,
    answers: usize,
    uploads: BTreeMap<String, Upload>,
    violations: Vec<String>,
    events: blake3::Hasher,
}

/// A call that was sent.
pub struct SentCall {
    policy: String,
    name: &'static str,
    arguments: Value,
    /// What it was answered with, where the answer came and says that it is recorded.
    acknowledged: Option<String>,
    /// Whether the power went after it, and calls are not synced.
    may_be_lost: bool,
}

impl SentCall {
    /// A call that was not answered yet.
    pub fn new(policy: &str, name: &'static str, arguments: Value) -> Self {
        Self {
            policy: policy.to_owned(),
            name,
            arguments,
            acknowledged: None,
            may_be_lost: false,
        }
    }
}

/// What is known of an upload by its name.
#[derive(Default)]
struct Upload {
    /// The samples that were sent under it.
    sent: BTreeSet<usize>,
    /// The one that is there for certain.
    kept: Option<usize>,
    /// Whether none is there for certain.
    deleted: bool,
}

impl Ledger {
    /// A ledger of a world in which nothing was done.
    pub fn new(samples: Vec<Bytes>, task: String) -> Self {
        Self {
            samples,
            task,
            faults: false,
            calls: BTreeMap::new(),
            answers: 0,
            uploads: BTreeMap::new(),
            violations: Vec::new(),
            events: blake3::Hasher::new(),
        }
    }

    /// Something that a client saw.
    pub fn saw(&mut self, event: &str) {
        self.events.update(event.as_bytes());
    }

    /// Something that may never be.
    pub fn violated(&mut self, what: String) {
        self.violations.push(what);
    }

    /// An answer that says that the server could not do it. Where the disk is well, it always can.
    pub fn refused(&mut self, method: &str, path: &str, status: StatusCode, body: &[u8]) {
        let text = String::from_utf8_lossy(body);
        let of_disk = [
            StatusCode::INSUFFICIENT_STORAGE,
            StatusCode::SERVICE_UNAVAILABLE,
        ];
        let expected = self.faults && (of_disk.contains(&status) || !text.contains("panicked"));
        if !expected {
            self.violated(format!("{method} {path}: {status} {text}"));
        }
    }

    /// A call of a worker is on its way; its number.
    pub fn send(&mut self, worker: &str, call: SentCall) -> usize {
        let calls = self.calls.entry(worker.to_owned()).or_default();
        calls.push(call);
        calls.len() - 1
    }

    /// A call of a worker was answered.
    pub fn answered(&mut self, worker: &str, number: usize, recorded: bool, text: &str) {
        let call = &mut self.calls.get_mut(worker).expect("it was sent")[number];
        self.events.update(text.as_bytes());
        self.answers += 1;
        // What ends an episode is answered with the next one, and none may have been running.
        if recorded && call.name != "finish" {
            call.acknowledged = Some(text.to_owned());
        }
    }

    /// The power went, and calls are not synced: those so far may be lost, and none after it.
    pub fn power_lost(&mut self) {
        for call in self.calls.values_mut().flatten() {
            call.may_be_lost = true;
        }
    }

    /// How many calls were acknowledged.
    pub fn acknowledged(&self) -> usize {
        let calls = self.calls.values().flatten();
        calls.filter(|call| call.acknowledged.is_some()).count()
    }

    /// How many calls were answered, whatever with.
    pub fn answers(&self) -> usize {
        self.answers
    }

    /// How many uploads are kept for certain.
    pub fn kept(&self) -> usize {
        let kept = |upload: &&Upload| upload.kept.is_some();
        self.uploads.values().filter(kept).count()
    }

    /// A sample is sent under a name.
    pub fn uploads(&mut self, name: &str, sample: usize) {
        let upload = self.uploads.entry(name.to_owned()).or_default();
        upload.sent.insert(sample);
        upload.deleted = false;
    }

    /// A sample was taken under a name, which nothing else may have had.
    pub fn uploaded(&mut self, name: &str, sample: usize) {
        let upload = self.uploads.entry(name.to_owned()).or_default();
        if let Some(before) = upload.kept.replace(sample) {
            self.violated(format!(
                "{name}: sample {sample} was taken where {before} is"
            ));
        }
    }

    /// A deletion is on its way: from now on nobody knows whether it is there.
    pub fn deletes(&mut self, name: &str) {
        self.uploads.entry(name.to_owned()).or_default().kept = None;
    }

    /// The trace of a name was deleted.
    pub fn deleted(&mut self, name: &str) {
        self.uploads.entry(name.to_owned()).or_default().deleted = true;
    }

    /// A digest of everything that clients saw.
    pub fn events(&self) -> blake3::Hash {
        self.events.finalize()
    }

    /// Everything that may never be, after a look at the disk.
    pub fn audit(
        &mut self,
        files: &TraceFiles,
        content: &BTreeMap<PathBuf, Vec<u8>>,
    ) -> Vec<String> {
        let mut recordings: BTreeMap<String, Vec<(String, String, Trace)>> = BTreeMap::new();
        for (path, bytes) in content {
            let name = path
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            match name.strip_suffix(".mcap") {
                Some(name) if self.uploads.contains_key(name) => self.check_upload(name, bytes),
                Some(_) => match files.read(path) {
                    Ok(trace) => {
                        let worker = &trace.header.policy.parameters["session"];
                        let worker = worker.as_str().unwrap_or_default();
                        let worker = worker.trim_start_matches("w-").to_owned();
                        let policy = trace.header.policy.name.clone();
                        recordings
                            .entry(worker)
                            .or_default()
                            .push((policy, name, trace));
                    }
                    Err(TraceError::NothingRestored { .. }) => {}
                    Err(error) => self.violated(format!("{name} is not whole: {error}")),
                },
                None => self.check_leftover(path, &name, content),
            }
        }
        for (name, upload) in &self.uploads {
            let there = content.keys().any(|path| {
                path.file_name()
                    .is_some_and(|file| file.to_str() == Some(&*format!("{name}.mcap")))
            });
            if upload.kept.is_some() && !there {
                self.violations
                    .push(format!("{name}: it was taken, and is not there"));
            }
            if upload.deleted && there {
                self.violations
                    .push(format!("{name}: it was deleted, and is there"));
            }
        }
        for (worker, calls) in &self.calls {
            let mut own = recordings.remove(worker).unwrap_or_default();
            own.sort_by(|one, other| (&one.0, &one.1).cmp(&(&other.0, &other.1)));
            let problem = compare(calls, &own);
            self.violations
                .extend(problem.map(|problem| format!("{worker}: {problem}")));
        }
        let strangers = recordings
            .keys()
            .map(|worker| format!("{worker}: nobody played there"));
        self.violations.extend(strangers);
        std::mem::take(&mut self.violations)
    }

    fn check_upload(&mut self, name: &str, bytes: &[u8]) {
        let upload = &self.uploads[name];
        let found = self.samples.iter().position(|sample| **sample == *bytes);
        let expected = match (upload.kept, found) {
            (Some(kept), Some(found)) => kept == found,
            (None, Some(found)) => upload.sent.contains(&found),
            (_, None) => false,
        };
        if !expected {
            let text = format!(
                "{name}: sample {found:?} is there, {:?} was taken",
                upload.kept
            );
            self.violated(text);
        }
    }

    /// Beside whole traces there are only recordings that hold more than could be restored.
    fn check_leftover(&mut self, path: &Path, name: &str, content: &BTreeMap<PathBuf, Vec<u8>>) {
        let restored = path.with_extension("");
        let second = restored.with_extension("recovered.mcap");
        let is_part = name.ends_with(".mcap.part");
        if !is_part || !(content.contains_key(&restored) || content.contains_key(&second)) {
            self.violated(format!("{name} is left over"));
        }
    }
}

/// Whether the traces of a worker hold what it sent, in its order: all that was acknowledged, with
/// the answers that it got, and nothing else.
fn compare(sent: &[SentCall], traces: &[(String, String, Trace)]) -> Option<String> {
    let recorded: Vec<(&str, &StepRecord)> = traces
        .iter()
        .flat_map(|(policy, _, trace)| trace.steps.iter().map(|step| (policy.as_str(), step)))
        .collect();
    // How many of the recorded calls may be those that were sent so far.
    let mut reached = BTreeSet::from([0]);
    for (number, call) in sent.iter().enumerate() {
        let is = |&at: &usize| {
            recorded.get(at).is_some_and(|(policy, step)| {
                let (found, answered) = (&step.input.call, &call.acknowledged);
                *policy == call.policy
                    && found.name == call.name
                    && found.arguments == call.arguments
                    && answered
                        .as_ref()
                        .is_none_or(|text| *text == step.outcome.text)
            })
        };
        let mut next: BTreeSet<usize> = reached
            .iter()
            .filter(|at| is(at))
            .map(|at| at + 1)
            .collect();
        if call.acknowledged.is_none() || call.may_be_lost {
            next.extend(&reached);
        }
        if next.is_empty() {
            let shown =
                |(policy, step): &(&str, &StepRecord)| format!("{policy} {}", step.input.call);
            let all: Vec<String> = recorded.iter().map(shown).collect();
            return Some(format!(
                "call {number} ({} {} {}) was acknowledged with {:?}, and is not in the traces: {all:?}",
                call.policy, call.name, call.arguments, call.acknowledged
            ));
        }
        reached = next;
    }
    (!reached.contains(&recorded.len())).then(|| {
        let all: Vec<String> = recorded
            .iter()
            .map(|(_, step)| step.input.call.to_string())
            .collect();
        format!("the traces hold calls that nobody sent there: {all:?}")
    })
}
