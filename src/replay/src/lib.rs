//! Re-executes a trace from its inputs and compares everything: every digest, image, text,
//! graph change, reward and metric. Names the first difference by call, physics step, body and
//! field, with both values.
//!
//! Never reads a clock or asks a policy: what was decided is in the trace.

mod changes;
mod comparison;
mod difference;
mod explain;
mod file_verdict;
mod fork;
mod mint;
mod motion;
mod player;
mod repack;
mod seek;
mod shard;
mod viewpoint;

use std::path::Path;

use rayon::prelude::*;
use reel_trace::{Trace, TraceError};
use reel_world::Frame;
use serde::{Deserialize, Serialize};

pub use changes::{
    ChangedEnd, ChangedOutcome, Changes, EndSummary, ReplayReport, changes, replay_outcomes_all,
};
pub use comparison::{CallPair, CallSummary, Comparison, EpisodeSummary, TaskMismatch, compare};
pub use difference::{Divergence, EpisodePosition};
pub use explain::{Explanation, FieldChange, FrameChange, body_changes, explain, state_at};
pub use file_verdict::{
    FileVerdict, verify, verify_all, verify_all_from_snapshots, verify_bytes,
    verify_catching_panics, verify_file,
};
pub use fork::{BranchVerification, Fork, episode_config, verify_branch, with_perfect_skills};
pub use mint::{MintError, MintOptions, Minted, MintedTrace, corpus, mint};
pub use motion::{MotionFrame, MotionPhase, MotionRate, MotionState, motion};
pub use player::{Replay, StepMismatch, check_meshes};
pub use reel_episode::Rollout;
pub use reel_sim::{SIM_VERSION, render::Detail};
pub use repack::{RepackError, compact, expand};
pub use seek::{SnapshotCache, frame_at, frames_at, seek, verify_restored};
pub use shard::{PackedTraces, pack, unpack};
pub use viewpoint::{View, Viewpoint, ViewpointError, view_at, views};

/// What a replay found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "verdict", rename_all = "snake_case")]
pub enum Verdict {
    /// Every digest, image and text is identical.
    Exact {
        /// Number of recorded calls that the replay covers.
        calls: u32,
        /// Physics steps re-executed, those of a sleeping world left out.
        physics_steps: u64,
        /// Number of frames that the replay rendered.
        #[serde(alias = "pictures")]
        images: u32,
    },
    /// The replay differs from the trace in at least one compared value.
    Diverged {
        /// The first difference, in the order of the episode.
        #[serde(flatten)]
        divergence: Box<Divergence>,
    },
    /// Recorded by another version of the simulator: nothing can be said.
    OtherSimulator {
        /// The version in the trace.
        recorded: u32,
        /// Version of this simulator for the trace's profile.
        #[serde(alias = "this")]
        current: u32,
        /// What changed in the versions between, the later ones last.
        changes: Vec<String>,
    },
    /// There is no simulator behind it (a robot, another simulator).
    NotReplayable {
        /// Why it cannot be executed again, e.g. an unknown reward preset.
        reason: String,
    },
    /// The trace cannot be read or was tampered with.
    Refused {
        /// What is wrong and where.
        reason: String,
    },
}

impl Verdict {
    /// Whether everything was identical.
    pub fn is_exact(&self) -> bool {
        matches!(self, Verdict::Exact { .. })
    }

    /// One word for it: `exact`, `diverged`, `other_simulator`, `not_replayable` or `refused`.
    pub fn name(&self) -> &'static str {
        match self {
            Verdict::Exact { .. } => "exact",
            Verdict::Diverged { .. } => "diverged",
            Verdict::OtherSimulator { .. } => "other_simulator",
            Verdict::NotReplayable { .. } => "not_replayable",
            Verdict::Refused { .. } => "refused",
        }
    }

    fn panicked(path: &Path) -> Self {
        let reason = format!(
            "replaying it panicked; run `reel replay {}` alone and report what it prints",
            path.display()
        );
        Verdict::Refused { reason }
    }
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Verdict::Exact {
                calls,
                physics_steps,
                images,
            } => {
                write!(
                    f,
                    "exact: {calls} calls, {physics_steps} physics steps, {images} images"
                )
            }
            Verdict::Diverged { divergence } => write!(f, "DIVERGED {divergence}"),
            Verdict::OtherSimulator {
                recorded,
                current,
                changes,
            } => {
                write!(
                    f,
                    "recorded by simulator {recorded}, this is {current}: replay it with the build that recorded it"
                )?;
                changes
                    .iter()
                    .try_for_each(|change| write!(f, "\n  {change}"))
            }
            Verdict::NotReplayable { reason } => write!(f, "not replayable: {reason}"),
            Verdict::Refused { reason } => write!(f, "REFUSED {reason}"),
        }
    }
}

/// Replays a trace that was read.
pub fn verify_trace(trace: &Trace) -> Verdict {
    verify_with(trace, Detail::Full)
}

/// Replays a trace that was read, drawing so much of its images: without RGB nothing is said
/// of the images' RGB.
pub fn verify_with(trace: &Trace, detail: Detail) -> Verdict {
    let replayed = check(trace, detail)
        .and_then(|()| Replay::start(trace, detail))
        .and_then(|(replay, _)| replay.finish(|_, _| {}));
    replayed.unwrap_or_else(|verdict| verdict)
}

/// What can be said of a trace before it is executed: that this simulator can, and that the images
/// in it are those of its digests (with RGB).
///
/// # Errors
/// The verdict, where it cannot be executed or an image is another.
pub fn check(trace: &Trace, detail: Detail) -> Result<(), Verdict> {
    player::config(trace)?;
    if detail == Detail::Full {
        trace.verify_images().map_err(|error| refused(&error))?;
    }
    Ok(())
}

/// Re-executes a trace and hands every image to `on_frame` (`None` is the start), whether or not
/// the trace holds it.
///
/// # Errors
/// Why nothing can be executed, or the first difference.
pub fn replay_with(
    trace: &Trace,
    mut on_frame: impl FnMut(Option<u32>, &Frame),
) -> Result<Verdict, Verdict> {
    let (replay, frame) = Replay::start(trace, Detail::Full)?;
    on_frame(None, &frame);
    replay.finish(|call, frame| on_frame(Some(call), frame))
}

/// The first difference between two traces of the same inputs; none where every record is equal.
pub fn first_divergence(a: &Trace, b: &Trace) -> Option<Divergence> {
    let compared = difference::header(&a.header, &b.header)
        .and_then(|()| difference::start(&a.start, &b.start))
        .and_then(|()| {
            a.steps
                .iter()
                .zip(&b.steps)
                .try_for_each(|(a, b)| difference::step(a, b))
        })
        .and_then(|()| match (&a.end, &b.end) {
            (Some(a), Some(b)) => difference::end(a, b),
            _ if a.end.is_none() && b.end.is_none() && a.steps.len() == b.steps.len() => Ok(()),
            _ => {
                let told = |trace: &Trace| {
                    format!(
                        "{} after {} calls",
                        if trace.end.is_some() {
                            "ended"
                        } else {
                            "broken off"
                        },
                        trace.steps.len()
                    )
                };
                Err(Box::new(Divergence::text(
                    EpisodePosition::End,
                    "end",
                    &told(a),
                    &told(b),
                )))
            }
        });
    compared.err().map(|divergence| *divergence)
}

fn refused(error: &TraceError) -> Verdict {
    Verdict::Refused {
        reason: error.to_string(),
    }
}

/// Does something with each path on so many threads; results in the order of the paths.
fn on_workers<P: Sync, T: Send>(
    paths: &[P],
    workers: usize,
    one: impl Fn(&P) -> T + Sync,
) -> Vec<T> {
    match rayon::ThreadPoolBuilder::new().num_threads(workers).build() {
        Ok(pool) => pool.install(|| paths.par_iter().map(&one).collect()),
        Err(_) => paths.iter().map(one).collect(),
    }
}
