//! A recorder between any MCP agent and any MCP tool server: passes everything through byte for
//! byte, and writes the episodes that go by as traces.
//!
//! `http`, `connection`, `events` and `stdio` pass bytes; `wire` and `sse` say where on the wire a
//! message begins and ends; `tap` reads calls and results in JSON-RPC; `session` decides what is
//! recorded before it is passed on, and what happens when that fails, `pending` which message is the result of a call;
//! `bridge` offers a server of
//! standard input and output over HTTP; `episode` makes records of it, with what `reel-import`
//! knows of the published server. What is recorded has no secrets in it that `reel-redact` finds. Never simulates, never answers in a server's place but to refuse,
//! and never makes a value up: what nobody said is zero or absent.
//!
//! Threads, not tasks: a connection is two copies that wait for each other's bytes, and a recording
//! is written where its call is read.

mod bridge;
mod connection;
mod episode;
mod error;
mod events;
mod http;
mod image;
mod mapping;
mod pending;
mod reading;
mod report;
mod session;
mod sessions;
mod sse;
mod stdio;
mod stop;
mod tap;
#[cfg(test)]
mod tests;
mod tls;
mod wire;

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use reel_redact::Rules;
use reel_reward::{OpenReward, Preset};
use reel_trace::{RecordOptions, Timing};
use reel_world::{
    Profile, Scenes, Task,
    record::{Backend, EndRecord, StepRecord},
};

pub use bridge::Bridge;
pub use error::ProxyError;
pub use http::{Proxy, Upstream};
pub use mapping::Mapping;
#[doc(hidden)]
pub use reading::read_connection;
pub use reel_import::MappingError;
pub use report::{Counts, PendingTraces, Report};
pub use stdio::run_stdio;

/// What happens when a recording cannot be written.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum OnFull {
    /// The call is refused with an error; nothing is passed on unrecorded.
    #[default]
    Stop,
    /// It is passed on unrecorded, and that is said.
    Continue,
}

/// What is told while it happens.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub enum ProxyEvent<'a> {
    /// An episode began in a session, and its recording with it.
    Began {
        /// Name of the session in which the episode began.
        session: &'a str,
        /// The task that the episode plays.
        task: &'a Task,
        /// The trace that it becomes.
        path: &'a Path,
        /// What was left open, and how it was decided.
        notes: &'a [String],
    },
    /// A step is on disk.
    Step {
        /// Name of the session that made the step.
        session: &'a str,
        /// Record of the step, as the trace holds it.
        record: &'a StepRecord,
        /// When the call came and how long its result took.
        timing: Timing,
    },
    /// An episode ended, and its trace is whole.
    Ended {
        /// Name of the session whose episode ended.
        session: &'a str,
        /// Path of the finished trace file.
        path: &'a Path,
        /// Why it ended, and what it came to.
        end: &'a EndRecord,
        /// Whether it succeeded; `None` where the task has no goal.
        success: Option<bool>,
        /// What is open of its reward, if that depends on what no server tells.
        open: Option<&'a OpenReward>,
    },
    /// An image that cannot stand in a trace: those are PNG files of the head camera's size.
    ImageOmitted {
        /// Name of the session whose image was omitted.
        session: &'a str,
        /// Why the trace cannot hold the image.
        why: &'a str,
    },
    /// Something was not recorded, or refused.
    RecordingFailed {
        /// Name of the session in which this happened.
        session: &'a str,
        /// What was not recorded or was refused, and why.
        problem: &'a str,
    },
}

/// Callback that receives every event of the recorder as it happens.
pub type EventHandler = Box<dyn Fn(ProxyEvent<'_>) + Send + Sync>;

/// How everything is recorded.
pub struct Setup {
    /// Folder for the traces; it is there.
    pub out: PathBuf,
    /// Name of the run that they belong to.
    pub run: String,
    /// What stands behind the server.
    pub backend: Backend,
    /// Whose words the server speaks.
    pub profile: Profile,
    /// Reward preset whose terms the steps hold.
    pub preset: Preset,
    /// Known tasks; the one that a server names is taken instead of what it says, the only one for
    /// a server that names none.
    pub tasks: Vec<Arc<Task>>,
    /// The scenes in which the known tasks play.
    pub scenes: Scenes,
    /// Name of the policy; without it, what agents call themselves.
    pub policy: Option<String>,
    /// Which tools are which, where their names do not say it.
    pub mapping: Option<Mapping>,
    /// What is a secret, and is replaced in everything that is written.
    pub rules: Arc<Rules>,
    /// What a recorded call survives.
    pub options: RecordOptions,
    /// What happens when a recording cannot be written.
    pub on_full: OnFull,
    /// Largest message that is looked into, in bytes.
    pub message_max: usize,
    /// How long a session without a goodbye may be silent before its episode ends.
    pub idle: Duration,
    /// Names of this machine that agents may call, besides addresses and localhost.
    pub hosts: Vec<String>,
    /// Callback that receives every event of the recorder as it happens.
    pub watch: EventHandler,
    /// Counts of sessions, episodes, calls and messages so far.
    pub report: Report,
    /// What is still being finished.
    pub endings: PendingTraces,
}

impl Setup {
    pub(crate) fn emit(&self, seen: ProxyEvent<'_>) {
        if let ProxyEvent::ImageOmitted { .. } = seen {
            self.report.count(|counts| counts.images_rejected += 1);
        }
        if let ProxyEvent::Ended { open, .. } = seen {
            self.report.count(|counts| {
                counts.episodes += 1;
                counts.open_rewards += u64::from(open.is_some());
            });
        }
        (self.watch)(seen);
    }
}
