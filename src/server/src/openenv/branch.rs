//! Episodes that start from a call of a recorded one. Never which decisions follow.

use std::{
    collections::BTreeMap,
    sync::{Mutex, PoisonError},
};

use reel_live::{BranchInputs, BranchedEpisode, Session, StartedEpisode};
use reel_replay::{Fork, Rollout, Verdict, frame_at};
use reel_trace::{Images, Trace};

use super::refusal::Refusal;
use crate::{rest::ApiError, service::App};

/// How many episodes began at each call of a trace, by prompt group.
#[derive(Debug, Default)]
pub(crate) struct SiblingCounts(Mutex<BTreeMap<String, u32>>);

impl SiblingCounts {
    /// The place of the next episode of a group.
    fn next(&self, group_id: String) -> Rollout {
        let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let count = counts.entry(group_id.clone()).or_default();
        let index = *count;
        *count = count.saturating_add(1);
        Rollout { group_id, index }
    }
}

/// A call of a recorded episode.
#[derive(Clone, Debug)]
pub(super) struct Origin {
    /// Name of the trace.
    pub trace: String,
    /// How many of its calls come before.
    pub call: u32,
}

/// Begins an episode at a call of a recorded one. All that begin at one call are a prompt group.
pub(super) fn begin(
    app: &App,
    session: &mut Session,
    origin: &Origin,
    label: Option<&str>,
) -> Result<StartedEpisode, Refusal> {
    let parent = app.archive.read(&origin.trace).map_err(Refusal::Trace)?;
    check(app, &parent).map_err(|why| {
        Refusal::Trace(ApiError::unprocessable(
            "bad_branch",
            format!("no episode can start from trace {}: {why}", origin.trace),
        ))
    })?;
    let open = |inputs: BranchInputs| {
        open(app, &parent, origin, inputs)
            .map_err(|verdict| app.archive.redact_path(&verdict.to_string()))
    };
    Ok(session.begin_branch(&parent.task, label, open)?)
}

/// Whether episodes of this server can go on from the trace: by its rules, and paid as it pays.
fn check(app: &App, parent: &Trace) -> Result<(), String> {
    let (setup, header) = (app.pool.setup(), &parent.header);
    if header.profile != setup.profile {
        return Err(format!(
            "it has profile {:?} and this server {:?} (play.profile)",
            header.profile, setup.profile
        ));
    }
    if header.reward_preset != setup.preset.name() {
        return Err(format!(
            "it has reward preset '{}' and this server '{}' (play.preset)",
            header.reward_preset,
            setup.preset.name()
        ));
    }
    Ok(())
}

fn open(
    app: &App,
    parent: &Trace,
    origin: &Origin,
    inputs: BranchInputs,
) -> Result<BranchedEpisode, Verdict> {
    let call = usize::try_from(origin.call).unwrap_or(usize::MAX);
    let fork = Fork::at(parent, call, Some(app.snapshots.cache()))?;
    let frames = match app.pool.setup().options.images {
        Images::Full => fork.frames_before()?,
        _ => BTreeMap::new(),
    };
    // With its numbers: markers of the last look can still be named.
    let last = parent.steps[..call].last();
    let last_frame = last
        .filter(|step| step.digests.frame.is_some())
        .map(|step| frame_at(parent, Some(step.step), Some(app.snapshots.cache())))
        .transpose()?;
    let group_id = format!("{}--{}--{}", inputs.run_id, origin.trace, origin.call);
    let rollout = app.siblings.next(group_id);
    let episode = fork.open_rollout(inputs.run_id, inputs.policy, rollout)?;
    Ok(BranchedEpisode {
        episode,
        frames,
        last_frame,
    })
}
