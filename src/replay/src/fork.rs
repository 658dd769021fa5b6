//! Moments of a recorded episode from which another future can be played, as often as wanted, and
//! whether a trace branches from another. What is played from there is somebody else's decision.

use std::collections::{BTreeMap, BTreeSet};

use reel_episode::{Episode, EpisodeConfig, Rollout};
use reel_sim::{Snapshot, render::Detail};
use reel_trace::Trace;
use reel_world::{
    Skills,
    record::{EpisodeHeader, Parent, PolicyInfo},
};
use serde::Serialize;

use crate::{
    Divergence, EpisodePosition, Replay, SnapshotCache, Verdict, difference, frames_at, player,
    seek, verify_trace,
};

/// The moment before a call of a recorded episode: the state there, and all that led to it,
/// compared with the record.
#[derive(Clone, Debug)]
pub struct Fork<'t> {
    parent: &'t Trace,
    call: usize,
    snapshot: Snapshot,
}

impl<'t> Fork<'t> {
    /// Goes to the moment before call `call`; that after the last call, where the
    /// episode had not ended.
    ///
    /// # Errors
    /// Why nothing can be executed, the first difference on the way, or that
    /// nothing can come there.
    pub fn at(
        parent: &'t Trace,
        call: usize,
        cache: Option<&SnapshotCache>,
    ) -> Result<Self, Verdict> {
        let replay = seek(parent, call, cache)?;
        Self::of(&replay).ok_or_else(|| Verdict::Refused {
            reason: format!(
                "the episode ended with call {}: branch at one of the calls 0 to {0}",
                call.saturating_sub(1)
            ),
        })
    }

    /// The moment that a replay has come to; none where the episode is over.
    pub fn of(replay: &Replay<'t>) -> Option<Self> {
        let episode = replay.episode();
        episode.ended().is_none().then(|| Self {
            parent: replay.trace(),
            call: replay.calls(),
            snapshot: episode.snapshot(),
        })
    }

    /// Every such moment, in order, by executing the episode once. Images are not compared.
    ///
    /// # Errors
    /// Why nothing can be executed, or the first difference.
    pub fn at_every_call(parent: &'t Trace) -> Result<Vec<Self>, Verdict> {
        let (mut replay, _) = Replay::start(parent, Detail::Geometry)?;
        let mut forks: Vec<Self> = Self::of(&replay).into_iter().collect();
        while replay.step()?.is_some() {
            forks.extend(Self::of(&replay));
        }
        Ok(forks)
    }

    /// The trace it is a moment of.
    pub fn parent(&self) -> &'t Trace {
        self.parent
    }

    /// How many calls of it were before: the first call that may differ.
    pub fn call(&self) -> usize {
        self.call
    }

    /// An episode that went as the parent did up to here. `policy` says who decides from
    /// now on, `detail` how much of the images to come is drawn; only with all of it can
    /// the episode be recorded.
    ///
    /// # Errors
    /// Why nothing can be executed.
    pub fn open(&self, policy: PolicyInfo, detail: Detail) -> Result<Episode, Verdict> {
        let run_id = format!("branch-{}", self.parent.header.episode_id);
        let rollout = Rollout::of(&self.parent.header);
        self.open_in(run_id, policy, rollout, detail)
    }

    /// [`Fork::open`] in a run and a prompt group of its own, to be recorded.
    ///
    /// # Errors
    /// As [`Fork::open`].
    pub fn open_rollout(
        &self,
        run_id: String,
        policy: PolicyInfo,
        rollout: Rollout,
    ) -> Result<Episode, Verdict> {
        self.open_in(run_id, policy, Some(rollout), Detail::Full)
    }

    /// RGB of the images that the agent got up to here, by call (`None`: before the first): those
    /// that the parent holds, or rendered again.
    ///
    /// # Errors
    /// Why an image cannot be had.
    pub fn frames_before(&self) -> Result<BTreeMap<Option<u32>, Vec<u8>>, Verdict> {
        let with_frame = self.parent.steps[..self.call]
            .iter()
            .filter(|step| step.digests.frame.is_some());
        let moments: BTreeSet<Option<u32>> = with_frame
            .map(|step| Some(step.step))
            .chain([None])
            .collect();
        frames_at(self.parent, &moments)
    }

    fn open_in(
        &self,
        run_id: String,
        policy: PolicyInfo,
        rollout: Option<Rollout>,
        detail: Detail,
    ) -> Result<Episode, Verdict> {
        let mut config = player::config(self.parent)?;
        config.run_id = run_id;
        config.policy = policy;
        config.rollout = rollout;
        let call = u32::try_from(self.call).unwrap_or(u32::MAX);
        config.parent = Some(Parent {
            trace: self.parent.chain(),
            call,
        });
        let (start, steps) = (
            self.parent.start.clone(),
            self.parent.steps[..self.call].to_vec(),
        );
        Episode::branch(config, start, steps, &self.snapshot, detail).map_err(|error| {
            Verdict::Refused {
                reason: error.to_string(),
            }
        })
    }
}

/// What the episode of a trace is a function of, with everything as it was recorded.
///
/// # Errors
/// Why nothing can be executed.
pub fn episode_config(trace: &Trace) -> Result<EpisodeConfig, Verdict> {
    player::config(trace)
}

/// What the episode of a trace starts from, but with skills that never fail, for a branch that
/// differs from its first call on. `policy` says who decides in it.
///
/// # Errors
/// Why nothing can be executed.
pub fn with_perfect_skills(parent: &Trace, policy: PolicyInfo) -> Result<EpisodeConfig, Verdict> {
    let mut config = player::config(parent)?;
    config.run_id = format!("branch-{}", parent.header.episode_id);
    config.policy = policy;
    config.skills = Skills::Perfect;
    config.parent = Some(Parent {
        trace: parent.chain(),
        call: 0,
    });
    Ok(config)
}

/// Whether a trace is a branch of another, and exact.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct BranchVerification {
    /// Why it is none of that trace at all: no branch, or another's.
    pub unrelated: Option<String>,
    /// The first difference between what they have in common: `recorded` is the parent's.
    pub prefix: Option<Divergence>,
    /// What a replay of the branch found.
    #[serde(flatten)]
    pub verdict: Verdict,
}

impl BranchVerification {
    /// Whether all of it holds.
    pub fn holds(&self) -> bool {
        self.unrelated.is_none() && self.prefix.is_none() && self.verdict.is_exact()
    }
}

/// Compares a branch with its parent up to the call it branches at, and replays it.
pub fn verify_branch(branch: &Trace, parent: &Trace) -> BranchVerification {
    let verdict = verify_trace(branch);
    let (unrelated, prefix) = match unrelated(branch, parent) {
        Err(reason) => (Some(reason), None),
        Ok(calls) => (None, prefix_difference(branch, parent, calls)),
    };
    BranchVerification {
        unrelated,
        prefix,
        verdict,
    }
}

/// How many calls it has from that trace, if it branches from it.
fn unrelated(branch: &Trace, parent: &Trace) -> Result<usize, String> {
    let Some(Parent { trace, call }) = &branch.header.parent else {
        return Err("it is no branch".to_owned());
    };
    if *trace != parent.chain() {
        return Err(format!(
            "it branches from the trace {trace}, and this is {}",
            parent.chain()
        ));
    }
    let calls = *call as usize;
    match parent.steps.len() {
        steps if steps < calls => Err(format!(
            "it branches at call {calls}, but this has {steps} calls"
        )),
        // A recording that broke off early holds less than what it took over.
        _ => Ok(calls.min(branch.steps.len())),
    }
}

/// The first difference in what a branch took over.
fn prefix_difference(branch: &Trace, parent: &Trace, calls: usize) -> Option<Divergence> {
    let compared = inputs(&parent.header, &branch.header)
        .and_then(|()| difference::start(&parent.start, &branch.start))
        .and_then(|()| {
            parent.steps[..calls]
                .iter()
                .zip(&branch.steps)
                .try_for_each(|(ours, theirs)| difference::step(ours, theirs))
        })
        .and_then(|()| substituted(branch, calls));
    compared.err().map(|divergence| *divergence)
}

/// Compares what a branch has from its parent's header.
fn inputs(parent: &EpisodeHeader, branch: &EpisodeHeader) -> Result<(), Box<Divergence>> {
    let inherited = EpisodeHeader {
        episode_id: branch.episode_id.clone(),
        run_id: branch.run_id.clone(),
        group_id: branch.group_id.clone(),
        rollout_index: branch.rollout_index,
        policy: branch.policy.clone(),
        parent: branch.parent.clone(),
        ..parent.clone()
    };
    difference::header(&inherited, branch)
}

/// Compares the calls that the header says were substituted with those that were made.
fn substituted(branch: &Trace, calls: usize) -> Result<(), Box<Divergence>> {
    let Some(told) = branch
        .header
        .policy
        .parameters
        .get("calls")
        .and_then(|calls| calls.as_array())
    else {
        return Ok(());
    };
    for (told, step) in told.iter().zip(&branch.steps[calls..]) {
        let made = serde_json::to_value(&step.input.call).expect("a call is always JSON");
        if *told != made {
            let (told, made) = (told.to_string(), made.to_string());
            return Err(Box::new(Divergence::text(
                EpisodePosition::Call(step.step),
                "substituted call",
                &told,
                &made,
            )));
        }
    }
    Ok(())
}
