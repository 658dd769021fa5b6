//! What is substituted in an episode, and playing it.

use std::collections::BTreeMap;

use reel_agents::{EpisodeReport, Policy, RecordTo, RunningEpisode, policy};
use reel_episode::Episode;
use reel_replay::Fork;
use reel_sim::render::Detail;
use reel_trace::{Images, Trace};
use reel_world::{
    ToolCall,
    record::{PolicyInfo, StepInput, StepRecord},
};
use serde_json::{Value, json};

use crate::branch::BranchError;

/// The policy of every branch in its header, whoever plays it on: its episodes are counted apart
/// from all others. Its parameters say what was substituted.
pub const POLICY_NAME: &str = "branch";

/// What comes instead of the parent's calls.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Branch {
    /// The calls that come first.
    pub calls: Vec<ToolCall>,
    /// How the branch goes on after these calls.
    pub continuation: Continuation,
}

/// How a branch goes on after the substituted calls.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub enum Continuation {
    /// Not at all: it ends as aborted, unless the calls ended it.
    #[default]
    Stop,
    /// With the parent's calls from this one on, and the answers from outside that came with them,
    /// but without the words: these were said of another world.
    Parent(usize),
    /// With a built-in policy, which has watched all that came before.
    Policy {
        /// Name of the built-in policy, e.g. `oracle`.
        name: String,
        /// The seed of everything random in it.
        seed: u64,
    },
}

impl Branch {
    /// A built-in policy takes over at once.
    pub fn policy(name: &str, seed: u64) -> Self {
        Self {
            calls: Vec::new(),
            continuation: Continuation::Policy {
                name: name.to_owned(),
                seed,
            },
        }
    }

    /// One call instead of the parent's at `at`, and then the rest of the parent's.
    pub fn replacing(at: usize, call: ToolCall) -> Self {
        Self {
            calls: vec![call],
            continuation: Continuation::Parent(at + 1),
        }
    }

    /// Who decides in it, for the header: what was substituted, and in whose episode.
    pub fn info(&self, parent: &Trace) -> PolicyInfo {
        let mut parameters: BTreeMap<String, Value> = BTreeMap::new();
        parameters.insert("of".into(), json!(parent.header.policy.name));
        if !self.calls.is_empty() {
            parameters.insert("calls".into(), json!(self.calls));
        }
        let mut then = |value: Value| parameters.insert("then".into(), value);
        match &self.continuation {
            Continuation::Stop => {}
            Continuation::Parent(from) => drop(then(json!({ "parent": from }))),
            Continuation::Policy { name, seed } => {
                drop(then(json!({ "policy": name, "seed": seed })))
            }
        }
        PolicyInfo {
            name: POLICY_NAME.into(),
            checkpoint: None,
            parameters,
        }
    }

    /// Plays it from there to its end, and records it. Unrecorded it is played without shading
    /// images, which takes a third of the time; what comes of it is the same.
    ///
    /// # Errors
    /// When the policy or a call to go on with does not exist, the parent's images cannot be had,
    /// or the trace cannot be written.
    pub fn play(
        &self,
        fork: &Fork<'_>,
        record: Option<&RecordTo>,
    ) -> Result<EpisodeReport, BranchError> {
        self.play_shown(fork, record, |_| ())
    }

    /// Plays it unrecorded, and gives all steps of its episode besides, the parent's included.
    ///
    /// # Errors
    /// As [`Branch::play`].
    pub fn play_for_steps(
        &self,
        fork: &Fork<'_>,
    ) -> Result<(EpisodeReport, Vec<StepRecord>), BranchError> {
        let mut steps = Vec::new();
        let report = self.play_shown(fork, None, |episode| steps = episode.steps().to_vec())?;
        Ok((report, steps))
    }

    fn play_shown(
        &self,
        fork: &Fork<'_>,
        record: Option<&RecordTo>,
        show: impl FnOnce(&Episode),
    ) -> Result<EpisodeReport, BranchError> {
        let parent = fork.parent();
        if let Continuation::Parent(from) = self.continuation
            && from > parent.steps.len()
        {
            return Err(BranchError::NoSuchCall {
                path: parent.path.clone(),
                from,
                calls: parent.steps.len(),
            });
        }
        let mut heir: Option<Box<dyn Policy + Send>> = match &self.continuation {
            Continuation::Policy { name, seed } => {
                Some(policy(name, &parent.task, &parent.scene, *seed)?)
            }
            _ => None,
        };
        let detail = if record.is_some() {
            Detail::Full
        } else {
            Detail::Geometry
        };
        let episode = fork
            .open(self.info(parent), detail)
            .map_err(|verdict| failed(fork, verdict))?;
        let mut frames = match record {
            Some(RecordTo { options, .. }) if options.images == Images::Full => {
                frames_before(fork)?
            }
            _ => BTreeMap::new(),
        };
        let mut running = RunningEpisode::resume(
            episode,
            record,
            |step| frames.remove(&step),
            witness(&mut heir),
        )?;
        for call in &self.calls {
            let input = StepInput::from_call(call.clone());
            make(&mut running, input, &mut heir)?;
        }
        if let Continuation::Parent(from) = self.continuation {
            for step in &parent.steps[from..] {
                make(
                    &mut running,
                    StepInput {
                        policy: None,
                        ..step.input.clone()
                    },
                    &mut heir,
                )?;
            }
        }
        if let Some(heir) = heir.as_deref_mut() {
            running.play(heir)?;
        }
        show(running.episode());
        Ok(running.end(heir.and_then(|heir| heir.gave_up()))?)
    }

    /// Goes to the moment before call `at` of the parent and plays it from there;
    /// see [`Fork::at`] and [`Branch::play`].
    ///
    /// # Errors
    /// When the parent cannot be executed up to there or differs on the
    /// way, and as [`Branch::play`].
    pub fn play_at(
        &self,
        parent: &Trace,
        at: usize,
        record: Option<&RecordTo>,
    ) -> Result<EpisodeReport, BranchError> {
        self.play(&fork(parent, at, None)?, record)
    }
}

/// [`Fork::at`] with an error that says where.
///
/// # Errors
/// When the parent cannot be executed up to there, or differs on the way.
pub fn fork<'t>(
    parent: &'t Trace,
    at: usize,
    cache: Option<&reel_replay::SnapshotCache>,
) -> Result<Fork<'t>, BranchError> {
    Fork::at(parent, at, cache).map_err(|verdict| BranchError::Parent {
        path: parent.path.clone(),
        call: at,
        verdict: Box::new(verdict),
    })
}

/// Makes a call, unless the episode has ended before.
fn make(
    running: &mut RunningEpisode,
    input: StepInput,
    heir: &mut Option<Box<dyn Policy + Send>>,
) -> Result<(), BranchError> {
    match running.episode().ended() {
        Some(_) => Ok(()),
        None => Ok(running.execute(input, witness(heir))?),
    }
}

fn witness(heir: &mut Option<Box<dyn Policy + Send>>) -> Option<&mut dyn Policy> {
    heir.as_deref_mut().map(|policy| policy as &mut dyn Policy)
}

/// The images that the agent got up to there: as the parent holds them, or drawn again.
fn frames_before(fork: &Fork<'_>) -> Result<BTreeMap<Option<u32>, Vec<u8>>, BranchError> {
    fork.frames_before().map_err(|verdict| BranchError::Frames {
        path: fork.parent().path.clone(),
        call: fork.call(),
        verdict: Box::new(verdict),
    })
}

fn failed(fork: &Fork<'_>, verdict: reel_replay::Verdict) -> BranchError {
    BranchError::Parent {
        path: fork.parent().path.clone(),
        call: fork.call(),
        verdict: Box::new(verdict),
    }
}
