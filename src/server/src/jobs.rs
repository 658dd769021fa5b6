//! Long work: commands of `reel` itself, each in a process of its own. Every such command
//! survives being killed and goes on where it stopped, so cancelling is killing; and what breaks
//! in one breaks nothing else.

use std::{
    collections::{BTreeMap, VecDeque},
    ffi::OsString,
    path::Path,
    process::Stdio,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::{SystemTime, UNIX_EPOCH},
};

use reel_trace::is_remote;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tokio::{
    io::{AsyncBufReadExt as _, AsyncRead, AsyncReadExt as _, BufReader},
    process::Command,
    sync::{Semaphore, watch},
};
use tokio_util::sync::CancellationToken;
use utoipa::ToSchema;

use crate::{archive::Archive, rest::ApiError};

/// Finished jobs that are remembered.
const REMEMBERED: usize = 200;
/// Most that is kept of what a job prints.
const OUTPUT_BYTES: u64 = 4 << 20;
/// Longest option of an export: what command lines take anywhere.
const OPTION_BYTES: usize = 16 << 10;
/// Jobs at work at once; the others wait.
const AT_ONCE: usize = 1;

/// What a job does.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub(crate) enum Work {
    /// Reads traces into the tables.
    Ingest {
        /// Which; without it all.
        #[serde(default)]
        traces: Vec<String>,
    },
    /// Replays traces and compares every digest.
    Replay {
        /// Which; without it all.
        #[serde(default)]
        traces: Vec<String>,
    },
    /// Measures every failed episode of the tables.
    Blame {},
    /// Says of every failed episode of the tables why it failed.
    Taxonomy {},
    /// Measures what each capability cost, and records each branch that rescues a failed episode.
    Attribute {},
    /// Plays the plausible other calls of every step of traces, and keeps what came of them.
    Counterfactuals {
        /// Which; without it every failed episode of the tables.
        #[serde(default)]
        traces: Vec<String>,
    },
    /// Scores the episodes of the tables under a built-in reward preset.
    Reward {
        /// Name of the built-in reward preset to score with.
        preset: String,
    },
    /// Writes a training set of the tables into `exports/<name>` of the data folder.
    Export {
        /// `sft`, `rl` or `preferences`.
        set: Set,
        /// Name of the folder.
        name: String,
        /// Further options of `reel export`, e.g. `{"format": "trl",
        /// "validation": 0.1, "failed": true}`.
        #[serde(default)]
        options: BTreeMap<String, Value>,
    },
}

/// A kind of training set.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Set {
    /// Examples for supervised fine-tuning, from `reel export sft`.
    Sft,
    /// Rollout groups for reinforcement learning, from `reel export rl`.
    Rl,
    /// Preference pairs of episodes, from `reel export preferences`.
    Preferences,
}

/// Options of exports that may come from outside: none names a file.
const EXPORT_OPTIONS: [&str; 31] = reel_world::words! {
    format style failed where words split validation test images pixels "allow-unverified"
    "no-replay" "rows-per-file" budget licence seed "group-size" "same-seed" eps returns advantage
    scale "virtual-max" "no-images" version annotations "context-length" "image-format" license
    "max-pixels" "store-version"
};

/// Where a job stands.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum JobState {
    /// Others are at work.
    Waiting,
    /// The job's command is running now.
    Running,
    /// The command succeeded, possibly naming what it left out.
    Done,
    /// It could not be done.
    Failed,
    /// Somebody stopped it. What it had done stays; the same job goes on from there.
    Cancelled,
}

/// A job with its state, its progress and its report.
#[derive(Clone, PartialEq, Debug, Serialize, ToSchema)]
pub(crate) struct Job {
    /// Number of the job, counted from 1 since the server started.
    pub id: u64,
    /// What the job does, as the client requested it.
    pub work: Work,
    /// State of the job, e.g. waiting, running or failed.
    pub state: JobState,
    /// How much is done.
    pub done: u64,
    /// Of how much, where that is known.
    pub total: Option<u64>,
    /// What it is at.
    pub message: String,
    /// What it reported, as `reel ... --json` prints it: one value a line.
    pub report: Vec<Value>,
    /// What it complained of.
    pub errors: Vec<String>,
    /// When it was asked for, in seconds since 1970.
    pub created: u64,
}

impl Job {
    pub fn ended(&self) -> bool {
        !matches!(self.state, JobState::Waiting | JobState::Running)
    }
}

/// All jobs of this server.
pub(crate) struct Jobs {
    command: Arc<Paths>,
    next: AtomicU64,
    at_once: Arc<Semaphore>,
    known: Mutex<VecDeque<KnownJob>>,
    closing: CancellationToken,
    running: prometheus_client::metrics::gauge::Gauge,
}

struct KnownJob {
    job: watch::Receiver<Job>,
    stop: CancellationToken,
    /// Jobs that were superseded are not listed, but whoever saw one can still ask how it ended.
    listed: bool,
}

/// Where jobs find and leave things.
pub(crate) struct Paths {
    /// Path of the `reel` executable that runs the jobs.
    pub reel: OsString,
    pub archive: Archive,
    pub store: String,
    pub exports: std::path::PathBuf,
    /// Folder of meshes, which commands take from `REEL_ASSETS`.
    pub assets: Option<std::path::PathBuf>,
}

/// A line of progress, as `REEL_PROGRESS=json` makes a command print them.
#[derive(Deserialize)]
struct Progress {
    progress: ProgressCount,
}

#[derive(Deserialize)]
struct ProgressCount {
    done: u64,
    total: Option<u64>,
    message: String,
}

impl Jobs {
    pub fn new(
        paths: Paths,
        closing: CancellationToken,
        running: prometheus_client::metrics::gauge::Gauge,
    ) -> Self {
        Self {
            command: Arc::new(paths),
            next: AtomicU64::new(1),
            at_once: Arc::new(Semaphore::new(AT_ONCE)),
            known: Mutex::default(),
            closing,
            running,
        }
    }

    /// Puts a job in the queue.
    pub fn start(&self, work: Work) -> Result<Job, ApiError> {
        let (arguments, left_out) = self.command.arguments(&work)?;
        let created = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .map_or(0, |time| time.as_secs());
        let job = Job {
            id: self.next.fetch_add(1, Ordering::Relaxed),
            work,
            state: JobState::Waiting,
            done: 0,
            total: None,
            message: String::new(),
            report: Vec::new(),
            errors: left_out,
            created,
        };
        let (sender, receiver) = watch::channel(job.clone());
        let stop = self.closing.child_token();
        {
            let mut known = self.lock();
            if known
                .iter()
                .filter(|known| !known.job.borrow().ended())
                .count()
                >= REMEMBERED
            {
                return Err(ApiError::too_many(
                    "too many jobs are waiting; try again later",
                ));
            }
            while known.len() >= REMEMBERED {
                let ended = |known: &KnownJob| known.job.borrow().ended();
                let Some(oldest) = known
                    .iter()
                    .position(|known| !known.listed && ended(known))
                    .or_else(|| known.iter().position(ended))
                else {
                    break;
                };
                known.remove(oldest);
            }
            known.push_back(KnownJob {
                job: receiver,
                stop: stop.clone(),
                listed: true,
            });
        }
        let (at_once, command, running) = (
            self.at_once.clone(),
            self.command.clone(),
            self.running.clone(),
        );
        tokio::spawn(async move {
            let place = tokio::select! {
                place = at_once.acquire_owned() => place.expect("the places are never closed"),
                () = stop.cancelled() => {
                    sender.send_modify(|job| job.state = JobState::Cancelled);
                    return;
                }
            };
            running.inc();
            sender.send_modify(|job| job.state = JobState::Running);
            let state = run(&command, &arguments, &sender, &stop).await;
            sender.send_modify(|job| job.state = state);
            running.dec();
            let job = sender.borrow();
            tracing::info!(job = job.id, state = ?job.state, "a job ended");
            drop(place);
        });
        Ok(job)
    }

    /// Every listed job, the newest first.
    pub fn list(&self) -> Vec<Job> {
        self.lock()
            .iter()
            .rev()
            .filter(|known| known.listed)
            .map(|known| known.job.borrow().clone())
            .collect()
    }

    /// A job, to be watched.
    pub fn watch(&self, id: u64) -> Result<watch::Receiver<Job>, ApiError> {
        let known = self.lock();
        let found = known
            .iter()
            .find(|known| known.job.borrow().id == id)
            .map(|known| known.job.clone());
        found.ok_or_else(|| {
            ApiError::not_found(format!(
                "unknown job {id}; only the latest jobs are remembered"
            ))
        })
    }

    /// Leaves a job out of the list.
    pub fn unlist(&self, id: u64) {
        self.lock()
            .iter_mut()
            .filter(|known| known.job.borrow().id == id)
            .for_each(|known| known.listed = false);
    }

    /// Stops a waiting or running job; fails if it has ended or is unknown.
    pub fn cancel(&self, id: u64) -> Result<(), ApiError> {
        let job = self.watch(id)?;
        if job.borrow().ended() {
            return Err(ApiError::conflict(
                "ended",
                format!("job {id} has already ended"),
            ));
        }
        let known = self.lock();
        known
            .iter()
            .filter(|known| known.job.borrow().id == id)
            .for_each(|known| known.stop.cancel());
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<KnownJob>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Paths {
    /// The command line of a job, and what of it cannot be done.
    fn arguments(&self, work: &Work) -> Result<(Vec<OsString>, Vec<String>), ApiError> {
        let (mut arguments, mut left_out) = (Vec::<OsString>::new(), Vec::new());
        let mut say = |words: &[&str]| arguments.extend(words.iter().map(OsString::from));
        match work {
            Work::Ingest { traces } => {
                say(&["ingest", "--json", "--store", &self.store]);
                arguments.extend(self.traces(traces, &mut left_out)?);
            }
            Work::Replay { traces } => {
                say(&["replay", "--json"]);
                // Before the first ingest there are no tables to keep verdicts in.
                if is_remote(Path::new(&self.store))
                    || Path::new(&self.store).join("episodes").exists()
                {
                    say(&["--store", &self.store]);
                }
                arguments.extend(self.traces(traces, &mut left_out)?);
            }
            Work::Blame {} => say(&["blame", "--json", "--store", &self.store]),
            Work::Taxonomy {} => say(&["taxonomy", "--json", "--store", &self.store]),
            Work::Attribute {} => {
                let branches = self.archive.folder().display().to_string();
                say(&["attribute", "--json", "--store", &self.store]);
                say(&["--branches", &branches]);
            }
            Work::Counterfactuals { traces } => {
                say(&["counterfactuals", "--json", "--store", &self.store]);
                if !traces.is_empty() {
                    arguments.extend(self.traces(traces, &mut left_out)?);
                }
            }
            Work::Reward { preset } => {
                if reel_reward::Preset::parse(preset).is_none() {
                    let known = reel_reward::Preset::built_in()
                        .map(|preset| preset.name().to_owned())
                        .join("', '");
                    let text = format!("no preset is called '{preset}'; built in are '{known}'");
                    return Err(ApiError::unprocessable("unknown_preset", text));
                }
                say(&[
                    "store",
                    "reward",
                    "--json",
                    "--store",
                    &self.store,
                    "--preset",
                    preset,
                ]);
            }
            Work::Export { set, name, options } => {
                reel_live::check_name(name).map_err(|_| {
                    ApiError::unprocessable(
                        "bad_name",
                        format!("'{name}' is not a valid folder name"),
                    )
                })?;
                let set = match set {
                    Set::Sft => "sft",
                    Set::Rl => "rl",
                    Set::Preferences => "preferences",
                };
                say(&[
                    "export",
                    set,
                    "--json",
                    "--store",
                    &self.store,
                    "--out",
                    &self.exports.join(name).display().to_string(),
                ]);
                for (option, value) in options {
                    if !EXPORT_OPTIONS.contains(&option.as_str()) {
                        let text = format!(
                            "no option is called '{option}'; there are {}",
                            EXPORT_OPTIONS.join(", ")
                        );
                        return Err(ApiError::unprocessable("unknown_option", text));
                    }
                    match value {
                        Value::Bool(true) => arguments.push(format!("--{option}").into()),
                        Value::Bool(false) | Value::Null => {}
                        Value::String(text) if text.contains('\0') || text.len() > OPTION_BYTES => {
                            let text = format!(
                                "option '{option}' takes a text of at most {OPTION_BYTES} bytes without NUL"
                            );
                            return Err(ApiError::unprocessable("bad_option", text));
                        }
                        Value::String(text) => arguments.push(format!("--{option}={text}").into()),
                        Value::Number(number) => {
                            arguments.push(format!("--{option}={number}").into())
                        }
                        _ => {
                            let text =
                                format!("option '{option}' takes a text, a number or a boolean");
                            return Err(ApiError::unprocessable("bad_option", text));
                        }
                    }
                }
            }
        }
        Ok((arguments, left_out))
    }

    /// The files of traces; those of a selection that are gone are left out, unless all are.
    fn traces(
        &self,
        names: &[String],
        left_out: &mut Vec<String>,
    ) -> Result<Vec<OsString>, ApiError> {
        if names.is_empty() {
            return Ok(vec![self.archive.folder().as_os_str().to_owned()]);
        }
        let mut files = Vec::new();
        let mut first = None;
        for name in names {
            match self.archive.existing(name) {
                Ok(path) => files.push(path.into_os_string()),
                Err(error) => {
                    left_out.push(format!("left out: {}", error.message()));
                    first = first.or(Some(error));
                }
            }
        }
        match first {
            Some(error) if files.is_empty() => Err(error),
            _ => Ok(files),
        }
    }
}

/// Runs a command to its end.
async fn run(
    paths: &Paths,
    arguments: &[OsString],
    job: &watch::Sender<Job>,
    stop: &CancellationToken,
) -> JobState {
    let mut command = Command::new(&paths.reel);
    // Secrets of the server are no business of its jobs.
    command
        .args(arguments)
        .env("REEL_PROGRESS", "json")
        .env_remove("REEL_TOKEN")
        .envs(paths.assets.as_ref().map(|assets| ("REEL_ASSETS", assets)))
        .stdin(Stdio::null());
    command
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .kill_on_drop(true);
    let mut child = match command.spawn() {
        Ok(child) => child,
        Err(error) => {
            job.send_modify(|job| {
                job.errors
                    .push(format!("the command cannot be started: {error}"))
            });
            return JobState::Failed;
        }
    };
    let (stdout, stderr) = (
        child.stdout.take().expect("it is piped"),
        child.stderr.take().expect("it is piped"),
    );
    let reports = lines(stdout, |line| {
        let line = paths.archive.redact_path(&line);
        let value = serde_json::from_str(&line).unwrap_or(Value::String(line));
        job.send_modify(|job| job.report.push(value));
    });
    let complaints = lines(stderr, |line| {
        match serde_json::from_str::<Progress>(&line) {
            Ok(Progress { progress }) => job.send_modify(|job| {
                (job.done, job.total, job.message) =
                    (progress.done, progress.total, progress.message);
            }),
            Err(_) => job.send_modify(|job| job.errors.push(paths.archive.redact_path(&line))),
        }
    });
    let ended = async { tokio::join!(reports, complaints, child.wait()).2 };
    tokio::select! {
        ended = ended => match ended {
            // 3: done, and what was left out is named.
            Ok(status) if matches!(status.code(), Some(0 | 3)) => JobState::Done,
            Ok(status) => {
                job.send_modify(|job| job.errors.push(format!("the command exited with {status}")));
                JobState::Failed
            }
            Err(_) => JobState::Failed,
        },
        () = stop.cancelled() => JobState::Cancelled,
    }
}

/// Every line of a stream, as long as it does not print without end.
async fn lines(stream: impl AsyncRead + Unpin, mut take: impl FnMut(String)) {
    let mut reader = BufReader::new(stream.take(OUTPUT_BYTES));
    let mut line = Vec::new();
    while reader
        .read_until(b'\n', &mut line)
        .await
        .is_ok_and(|bytes| bytes > 0)
    {
        let text = String::from_utf8_lossy(&line).trim_end().to_owned();
        line.clear();
        if !text.is_empty() {
            take(text);
        }
    }
    // Nobody reads on, but the command must not stop for that.
    let _ = tokio::io::copy(
        &mut reader.into_inner().into_inner(),
        &mut tokio::io::sink(),
    )
    .await;
}
