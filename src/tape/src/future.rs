//! What follows where an agent leaves a recording of the simulator: a live episode from that exact
//! state, recorded as a branch. Equal calls give what `reel branch` gives.

use std::{collections::BTreeMap, path::PathBuf, sync::Arc};

use reel_live::{
    BranchInputs, BranchedEpisode, CallResult, EndedEpisode, Host, LiveError, PreparedTaskCache,
    Session, Setup, TraceObserver,
};
use reel_replay::{Fork, Verdict};
use reel_reward::Preset;
use reel_trace::{Images, RecordOptions};
use reel_world::{Scenes, record::StepInput};

use crate::{Tape, TapeSettings};

/// A live episode that branches from a recording.
pub(crate) struct LiveFuture(Session);

/// Who plays it, where.
pub(crate) struct Player<'a> {
    pub settings: &'a TapeSettings,
    pub session: &'a str,
    pub policy: &'a str,
}

impl LiveFuture {
    /// Restores the state before call `step` by executing all before it, and records it as a branch.
    ///
    /// # Errors
    /// Why it cannot go on from there, in words: the recording does not replay, or the branch cannot
    /// be written.
    pub fn open(tape: &Tape, step: usize, player: &Player<'_>) -> Result<Self, String> {
        let trace = tape.trace();
        let fork = Fork::at(trace, step, None).map_err(|verdict| verdict.to_string())?;
        let images = if trace.image_count() > 0 {
            Images::Full
        } else {
            Images::None
        };
        let setup = setup(tape, player, images).map_err(|verdict| verdict.to_string())?;
        let mut session = Session::new(player.session, Arc::new(setup), None);
        session.set_policy(player.policy);
        let open = |inputs: BranchInputs| {
            branched(&fork, inputs, images).map_err(|verdict| verdict.to_string())
        };
        let begun = session.begin_branch(&trace.task, None, open);
        begun.map_err(|error| error.to_string())?;
        Ok(Self(session))
    }

    /// Makes a call in the simulator, and records it.
    ///
    /// # Errors
    /// When no episode runs, or the branch cannot be written.
    pub fn call(&mut self, input: StepInput) -> Result<CallResult, LiveError> {
        self.0.call(input)
    }

    /// Whether a call can be made.
    pub fn is_running(&self) -> bool {
        self.0.is_running()
    }

    /// Ends the episode: how it ended, and its trace.
    ///
    /// # Errors
    /// When the branch cannot be written.
    pub fn end(mut self) -> Result<(Option<EndedEpisode>, Option<PathBuf>), LiveError> {
        self.0.abort()?;
        let state = self.0.state();
        Ok((state.ended, state.trace))
    }
}

/// The settings of the recording, for what follows.
fn setup(tape: &Tape, player: &Player<'_>, images: Images) -> Result<Setup, Verdict> {
    let (trace, header) = (tape.trace(), &tape.trace().header);
    let preset = Preset::parse(&header.reward_preset).ok_or_else(|| Verdict::NotReplayable {
        reason: format!("unknown reward preset '{}'", header.reward_preset),
    })?;
    Ok(Setup {
        tasks: vec![trace.task.clone()],
        scenes: Scenes::from(trace.scene.clone()),
        meshes: trace.meshes.clone(),
        seed: header.seed,
        profile: header.profile,
        skills: header.skills,
        preset,
        run_id: "replay".to_owned(),
        folder: player.settings.branches.clone(),
        answer_settings: BTreeMap::new(),
        options: RecordOptions::from(images),
        host: Host::default(),
        stages: PreparedTaskCache::default(),
        on_finished: TraceObserver::default(),
    })
}

fn branched(
    fork: &Fork<'_>,
    inputs: BranchInputs,
    images: Images,
) -> Result<BranchedEpisode, Verdict> {
    let frames = match images {
        Images::Full => fork.frames_before()?,
        Images::None => BTreeMap::new(),
    };
    let episode = fork.open(inputs.policy, reel_replay::Detail::Full)?;
    Ok(BranchedEpisode {
        episode,
        frames,
        last_frame: None,
    })
}
