//! Re-executes a trace from its inputs and compares everything: every digest, picture, text, graph change, reward
//! and metric. Names the first difference by call, physics step, body and field, with both values.
//!
//! Never reads a clock or asks a policy: what was decided is in the trace.

mod difference;

use std::{path::Path, sync::Arc};

use rayon::prelude::*;
use reel_episode::{Episode, EpisodeConfig};
use reel_reward::Preset;
use reel_sim::SIM_VERSION;
use reel_trace::{Trace, TraceError};
use reel_world::{Frame, record::Backend};
use serde::Serialize;

pub use difference::{Divergence, Moment};

/// What a replay found.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "verdict", rename_all = "snake_case")]
pub enum Verdict {
    /// Every digest, picture and text is identical.
    Exact {
        /// Calls re-executed.
        calls: u32,
        /// Physics steps re-executed, those of a sleeping world left out.
        physics_steps: u64,
        /// Pictures rendered again.
        pictures: u32,
    },
    /// Something differs.
    Diverged {
        /// The first difference.
        #[serde(flatten)]
        divergence: Divergence,
    },
    /// Recorded by another version of the simulator: nothing can be said.
    OtherSimulator {
        /// The version in the trace.
        recorded: u32,
        /// This simulator's version.
        this: u32,
    },
    /// There is no simulator behind it (a robot, another simulator).
    NotReplayable {
        /// Why.
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
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Verdict::Exact { calls, physics_steps, pictures } => {
                write!(f, "exact: {calls} calls, {physics_steps} physics steps, {pictures} pictures")
            }
            Verdict::Diverged { divergence } => write!(f, "DIVERGED {divergence}"),
            Verdict::OtherSimulator { recorded, this } => {
                write!(f, "recorded by simulator {recorded}, this is {this}: replay it with the build that recorded it")
            }
            Verdict::NotReplayable { reason } => write!(f, "not replayable: {reason}"),
            Verdict::Refused { reason } => write!(f, "REFUSED {reason}"),
        }
    }
}

/// Replays one trace file.
pub fn verify(path: &Path) -> Verdict {
    match Trace::read(path) {
        Ok(trace) => verify_trace(&trace),
        Err(error) => refused(&error),
    }
}

/// Replays many trace files on so many threads; verdicts in the order of the paths.
pub fn verify_all<P: AsRef<Path> + Sync>(paths: &[P], workers: usize, on_done: impl Fn(&Path, &Verdict) + Sync) -> Vec<Verdict> {
    let one = |path: &P| {
        let path = path.as_ref();
        let verdict = std::panic::catch_unwind(|| verify(path)).unwrap_or_else(|_| Verdict::Refused {
            reason: format!("replaying it panicked; run `reel replay {}` alone and report what it prints", path.display()),
        });
        on_done(path, &verdict);
        verdict
    };
    match rayon::ThreadPoolBuilder::new().num_threads(workers).build() {
        Ok(pool) => pool.install(|| paths.par_iter().map(one).collect()),
        Err(_) => paths.iter().map(one).collect(),
    }
}

/// Replays a trace that was read.
pub fn verify_trace(trace: &Trace) -> Verdict {
    let header = &trace.header;
    if header.backend != Backend::Sim {
        return Verdict::NotReplayable { reason: format!("recorded from {:?}, not from our simulator", header.backend) };
    }
    if header.sim_version != SIM_VERSION {
        return Verdict::OtherSimulator { recorded: header.sim_version, this: SIM_VERSION };
    }
    let Some(preset) = Preset::parse(&header.reward_preset) else {
        return Verdict::NotReplayable { reason: format!("unknown reward preset '{}'", header.reward_preset) };
    };
    if let Err(error) = trace.verify_images() {
        return refused(&error);
    }
    match replay(trace, preset) {
        Ok(verdict) => verdict,
        Err(divergence) => Verdict::Diverged { divergence: *divergence },
    }
}

/// Re-executes a trace and hands every picture to `on_frame` (`None` is the start), whether or not the trace holds it.
///
/// # Errors
/// The first difference.
pub fn replay_with(
    trace: &Trace,
    preset: Preset,
    mut on_frame: impl FnMut(Option<u32>, &Frame),
) -> Result<Verdict, Box<Divergence>> {
    let header = &trace.header;
    let config = EpisodeConfig {
        task: Arc::new(trace.task.clone()),
        scene: Arc::new(trace.scene.clone()),
        seed: header.seed,
        profile: header.profile,
        preset,
        run_id: header.run_id.clone(),
        policy: header.policy.clone(),
    };
    let (mut episode, start, frame) = Episode::start(config)
        .map_err(|error| Box::new(Divergence::text(Moment::Start, "start", "an episode", &error.to_string())))?;
    difference::header(header, episode.header())?;
    difference::start(&trace.start, &start)?;
    on_frame(None, &frame);
    let mut pictures = 1;
    let mut physics_steps = start.digests.physics_steps.len() as u64;
    for recorded in &trace.steps {
        let output = episode.step(recorded.input.clone());
        difference::step(recorded, &output.record)?;
        physics_steps += output.record.digests.physics_steps.len() as u64;
        if let Some(frame) = &output.frame {
            on_frame(Some(recorded.step), frame);
            pictures += 1;
        }
    }
    let calls = trace.steps.len() as u32;
    if let Some(recorded) = &trace.end {
        // An episode that its runner stopped early ends as it did then.
        difference::end(recorded, &episode.end())?;
    }
    Ok(Verdict::Exact { calls, physics_steps, pictures })
}

fn replay(trace: &Trace, preset: Preset) -> Result<Verdict, Box<Divergence>> {
    replay_with(trace, preset, |_, _| {})
}

fn refused(error: &TraceError) -> Verdict {
    Verdict::Refused { reason: error.to_string() }
}
