//! A session: an exclusive simulator in which one agent plays one episode after another. Never
//! decides anything, never speaks a protocol.

mod begin;

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use reel_episode::{Briefing, Episode, StepOutput, Suspended};
use reel_trace::Recorder;
use reel_world::{
    Frame, InstanceId, ReceptacleId, Scene, Task,
    record::{EndReason, EndRecord, Graphs, Marker, Metrics, RobotState, StepInput, StepRecord},
};
use serde::Serialize;

use crate::{EpisodePosition, Lease, LiveError, Setup, Situation, restore_on};

pub use begin::{BranchInputs, BranchedEpisode};

/// An exclusive simulator in which one agent plays one episode after another.
pub struct Session {
    name: String,
    setup: Arc<Setup>,
    policy: String,
    lease: Option<Lease>,
    /// Which task of the list comes next.
    next: usize,
    /// How many episodes were begun.
    begun: u32,
    /// The last trace that was finished.
    finished: Option<PathBuf>,
    /// Id of the episode that was begun last.
    episode_id: Option<String>,
    now: Phase,
}

/// What there is at the moment. Taken out while something happens, so that a
/// panic leaves `Broken` behind.
enum Phase {
    Empty,
    Playing(Box<RunningEpisode>),
    Parked(Box<SuspendedEpisode>),
    Over {
        task: Arc<Task>,
        reason: EndReason,
        metrics: Metrics,
    },
    Broken {
        part: PathBuf,
        reason: String,
    },
}

struct RunningEpisode {
    episode: Episode,
    recorder: Recorder,
    path: PathBuf,
}

struct SuspendedEpisode {
    episode: Suspended,
    recorder: Recorder,
    path: PathBuf,
}

/// An episode that has begun.
#[derive(Debug)]
pub struct StartedEpisode {
    /// The task; only its briefing is for the policy.
    pub task: Arc<Task>,
    /// What the agent is told.
    pub briefing: Briefing,
    /// The id by which the task was asked for, if it was.
    pub requested: Option<String>,
    /// Index of the task among those served.
    pub index: usize,
    /// How many tasks are served.
    pub of: usize,
    /// How many episodes were begun here before.
    pub number: u32,
    /// The head camera's frame before the first call of this session.
    pub frame: Frame,
    /// The state before the first call of this session.
    pub view: PrivilegedState,
    /// The last call that the episode took over from its parent; `None` if it took over none.
    pub taken_over: Option<Box<StepRecord>>,
}

/// A call that was made, and is persisted.
#[derive(Debug)]
pub struct CallResult {
    /// The record; only what the profile shows is for the policy.
    pub step: StepRecord,
    /// The image, where the tool returns one.
    pub frame: Option<Frame>,
    /// With the published servers, which answer everything with an image: what the head sees,
    /// where the tool returns none.
    pub head_frame: Option<Frame>,
    /// The state after the call.
    pub view: PrivilegedState,
    /// Why the episode ended with it, if it did.
    pub ended: Option<EndReason>,
}

/// The state of an episode, privileged: what the published server calls its debug information.
#[derive(Clone, Debug)]
pub struct PrivilegedState {
    /// Where the objects are, by both authorities.
    pub graphs: Graphs,
    /// Objects on each receptacle by the registry, in the order of the scene and of their arrival.
    pub objects_by_receptacle: Vec<(ReceptacleId, Vec<InstanceId>)>,
    /// The marker map; `None` if there is none.
    pub markers: Option<Vec<Marker>>,
    /// What the gripper holds.
    pub held: Option<InstanceId>,
    /// The receptacle the robot stands at.
    pub landmark: Option<ReceptacleId>,
    /// Pose of the base and of the camera, and the path driven so far.
    pub robot: RobotState,
}

impl PrivilegedState {
    /// The state of an episode as it is now.
    pub fn of(episode: &Episode) -> Self {
        let simulator = episode.simulator();
        Self {
            graphs: simulator.graphs(),
            objects_by_receptacle: simulator.objects_by_receptacle(),
            markers: simulator
                .has_marker_map()
                .then(|| simulator.markers().to_vec()),
            held: simulator.held().cloned(),
            landmark: simulator.landmark().cloned(),
            robot: simulator.robot(),
        }
    }
}

/// How a session stands, for people.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct SessionStatus {
    /// `empty`, `playing`, `suspended`, `ended` or `failed`.
    pub state: &'static str,
    /// The task of the episode, if there is one.
    pub task_id: Option<String>,
    /// How many calls were made in it.
    pub steps: u32,
    /// How many episodes were begun.
    pub episodes: u32,
    /// Name of the policy that plays; `client` until one is set.
    pub policy: String,
    /// Why and how the last episode ended.
    pub ended: Option<EndedEpisode>,
    /// The last finished trace.
    pub trace: Option<PathBuf>,
}

/// How an episode ended.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct EndedEpisode {
    /// Why the episode ended, e.g. finished or aborted.
    pub reason: EndReason,
    /// Whether the goal held then.
    pub success: bool,
    /// Undiscounted cumulative reward of the episode.
    pub total_reward: f64,
}

impl Session {
    /// A session without an episode.
    pub fn new(name: &str, setup: Arc<Setup>, lease: Option<Lease>) -> Self {
        let (policy, now) = ("client".to_owned(), Phase::Empty);
        Self {
            name: name.to_owned(),
            setup,
            policy,
            lease,
            next: 0,
            begun: 0,
            finished: None,
            episode_id: None,
            now,
        }
    }

    /// Who plays from the next episode on.
    pub fn set_policy(&mut self, name: &str) {
        name.clone_into(&mut self.policy);
    }

    /// What all sessions play.
    pub fn setup(&self) -> &Arc<Setup> {
        &self.setup
    }

    /// The scene of the episode that runs, or of the one that comes next; that of the first task
    /// if all were played.
    pub fn scene(&self) -> Option<&Arc<Scene>> {
        match &self.now {
            Phase::Playing(playing) => Some(playing.episode.scene()),
            Phase::Parked(resting) => Some(resting.episode.scene()),
            _ => {
                let next = self.setup.tasks.get(self.next).or(self.setup.tasks.first());
                next.map(|task| self.setup.scene(task))
            }
        }
    }

    /// Whether an episode runs, so that a call can be made.
    pub fn is_running(&self) -> bool {
        matches!(self.now, Phase::Playing(_) | Phase::Parked(_))
    }

    /// Makes a call. It is persisted when this returns.
    ///
    /// # Errors
    /// When no episode runs, or the trace cannot be written: the episode is ended then.
    pub fn call(&mut self, input: StepInput) -> Result<CallResult, LiveError> {
        let mut playing = self.take()?;
        let step = calls(playing.episode.steps());
        playing.recorder.input(step, &input)?;
        let StepOutput { record, frame } = playing.episode.step(input);
        playing.recorder.step(&record, frame.as_ref())?;
        let shows_all = frame.is_none() && self.setup.profile.is_published();
        let look = shows_all.then(|| playing.episode.render_frame());
        let view = PrivilegedState::of(&playing.episode);
        let ended = playing.episode.ended();
        if ended.is_some() {
            let RunningEpisode {
                episode,
                recorder,
                path,
            } = *playing;
            self.close(episode.task().clone(), episode.end(), recorder, path)?;
        } else {
            self.now = Phase::Playing(playing);
        }
        Ok(CallResult {
            step: record,
            frame,
            head_frame: look,
            view,
            ended,
        })
    }

    /// What the agent was told.
    ///
    /// # Errors
    /// When no episode runs.
    pub fn briefing(&self) -> Result<Briefing, LiveError> {
        let task = self.task()?;
        Ok(Briefing::new(
            task,
            self.scene().ok_or(LiveError::NoEpisode)?,
        ))
    }

    /// The trace that the running episode becomes; `None` if no episode runs.
    pub fn recording(&self) -> Option<&Path> {
        match &self.now {
            Phase::Playing(playing) => Some(&playing.path),
            Phase::Parked(resting) => Some(&resting.path),
            _ => None,
        }
    }

    /// Id of the episode that was begun last, as its trace has it; `None` if none was.
    pub fn episode_id(&self) -> Option<&str> {
        self.episode_id.as_deref()
    }

    /// The task of the episode.
    ///
    /// # Errors
    /// When no episode runs.
    pub fn task(&self) -> Result<&Arc<Task>, LiveError> {
        match &self.now {
            Phase::Playing(playing) => Ok(playing.episode.task()),
            Phase::Parked(resting) => Ok(resting.episode.task()),
            _ => Err(self.refusal()),
        }
    }

    /// Which step of which episode is next; `None` if no episode runs.
    pub fn position(&self) -> Option<EpisodePosition> {
        let steps = match &self.now {
            Phase::Playing(playing) => playing.episode.steps(),
            Phase::Parked(resting) => resting.episode.steps(),
            _ => return None,
        };
        Some(EpisodePosition {
            recording: self.recording()?.to_owned(),
            step: calls(steps),
        })
    }

    /// What there is to know for whoever answers a question of the episode from outside.
    ///
    /// # Errors
    /// When no episode runs.
    pub fn situation(&self) -> Result<Situation, LiveError> {
        let (task, position) = (self.task()?, self.position());
        let (start, steps) = match &self.now {
            Phase::Playing(playing) => (playing.episode.start_record(), playing.episode.steps()),
            Phase::Parked(resting) => (resting.episode.start_record(), resting.episode.steps()),
            _ => return Err(self.refusal()),
        };
        let position = position.ok_or(LiveError::NoEpisode)?;
        Ok(Situation {
            position,
            task: task.clone(),
            scene: self.scene().ok_or(LiveError::NoEpisode)?.clone(),
            initial: start.graphs.physics.clone(),
            seen_at_start: start.visible.iter().map(|it| it.object.clone()).collect(),
            steps: steps.to_vec(),
        })
    }

    /// What the robot's head sees now; the episode stays as it is, awake or not.
    ///
    /// # Errors
    /// When no episode runs.
    pub fn render_frame(&self) -> Result<Frame, LiveError> {
        match &self.now {
            Phase::Playing(playing) => Ok(playing.episode.render_frame()),
            Phase::Parked(resting) => Ok(resting.episode.render_frame()?),
            _ => Err(self.refusal()),
        }
    }

    /// Puts a running episode aside, so that it takes little memory.
    pub fn suspend(&mut self) {
        if self.is_in_memory()
            && let Ok(playing) = self.take()
        {
            let RunningEpisode {
                episode,
                recorder,
                path,
            } = *playing;
            self.now = Phase::Parked(Box::new(SuspendedEpisode {
                episode: episode.suspend(),
                recorder,
                path,
            }));
        }
    }

    /// Breaks down in the middle of a call, for tests of what happens then.
    #[doc(hidden)]
    pub fn inject_failure(&mut self, why: &str) {
        let _playing = self.take();
        panic!("{why}");
    }

    /// Whether a simulator is in memory.
    pub fn is_in_memory(&self) -> bool {
        matches!(self.now, Phase::Playing(_))
    }

    /// Ends what runs, as aborted.
    ///
    /// # Errors
    /// When its trace cannot be written.
    pub fn abort(&mut self) -> Result<(), LiveError> {
        match self.take_out() {
            Phase::Playing(playing) => {
                let RunningEpisode {
                    episode,
                    recorder,
                    path,
                } = *playing;
                self.close(episode.task().clone(), episode.end(), recorder, path)
            }
            Phase::Parked(resting) => {
                let SuspendedEpisode {
                    episode,
                    recorder,
                    path,
                } = *resting;
                self.close(episode.task().clone(), episode.end(), recorder, path)
            }
            Phase::Broken { part, .. } => {
                self.finished = restore_on(&self.setup.host.trace_files(), &part, None)
                    .ok()
                    .map(|recovery| recovery.trace)
                    .or(self.finished.take());
                self.now = Phase::Empty;
                Ok(())
            }
            now @ (Phase::Empty | Phase::Over { .. }) => {
                self.now = now;
                Ok(())
            }
        }
    }

    /// Status of the session: its state, task, step count and last trace.
    pub fn state(&self) -> SessionStatus {
        let (state, task, steps, ended) = match &self.now {
            Phase::Empty => ("empty", None, 0, None),
            Phase::Playing(playing) => (
                "playing",
                Some(playing.episode.task()),
                calls(playing.episode.steps()),
                None,
            ),
            Phase::Parked(resting) => (
                "suspended",
                Some(resting.episode.task()),
                calls(resting.episode.steps()),
                None,
            ),
            Phase::Over {
                task,
                reason,
                metrics,
            } => {
                let ended = EndedEpisode {
                    reason: *reason,
                    success: metrics.success,
                    total_reward: metrics.total_reward,
                };
                ("ended", Some(task), metrics.length, Some(ended))
            }
            Phase::Broken { .. } => ("failed", None, 0, None),
        };
        SessionStatus {
            state,
            task_id: task.map(|task| task.task_id.clone()),
            steps,
            episodes: self.begun,
            policy: self.policy.clone(),
            ended,
            trace: self.finished.clone(),
        }
    }

    fn close(
        &mut self,
        task: Arc<Task>,
        end: EndRecord,
        recorder: Recorder,
        path: PathBuf,
    ) -> Result<(), LiveError> {
        recorder.end(&end)?;
        self.setup.on_finished.finished(&path);
        self.finished = Some(path);
        self.now = Phase::Over {
            task,
            reason: end.reason,
            metrics: end.metrics,
        };
        Ok(())
    }

    /// Takes the running episode out, awake.
    fn take(&mut self) -> Result<Box<RunningEpisode>, LiveError> {
        if !self.is_running() {
            return Err(self.refusal());
        }
        match self.take_out() {
            Phase::Playing(playing) => Ok(playing),
            Phase::Parked(resting) => {
                let SuspendedEpisode {
                    episode,
                    recorder,
                    path,
                } = *resting;
                Ok(Box::new(RunningEpisode {
                    episode: episode.resume()?,
                    recorder,
                    path,
                }))
            }
            _ => unreachable!("it plays"),
        }
    }

    /// Takes out what there is. Should it not come back, because the simulator panics or the disk
    /// refuses, what is left says that it broke down.
    fn take_out(&mut self) -> Phase {
        let left = match &self.now {
            Phase::Playing(playing) => Some(&playing.path),
            Phase::Parked(resting) => Some(&resting.path),
            _ => None,
        };
        let left = left.map(|path| Phase::Broken {
            part: part(path),
            reason: "a call did not come to its end".to_owned(),
        });
        std::mem::replace(&mut self.now, left.unwrap_or(Phase::Empty))
    }

    fn refusal(&self) -> LiveError {
        match &self.now {
            Phase::Over { reason, .. } => LiveError::Over(*reason),
            Phase::Broken { reason, .. } => LiveError::Broken(reason.clone()),
            _ => LiveError::NoEpisode,
        }
    }
}

fn calls(steps: &[StepRecord]) -> u32 {
    u32::try_from(steps.len()).expect("an episode has few steps")
}

/// Where the recorder writes until the end.
fn part(path: &Path) -> PathBuf {
    path.with_added_extension("part")
}
