//! Episodes that are played from Python, call by call, from a task's start or from any call of a
//! recorded episode.

use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use pyo3::prelude::*;
use rayon::prelude::*;
use reel_agents::{RecordTo, RunningEpisode};
use reel_episode::{Episode, EpisodeConfig, PreparedTask, Rollout};
use reel_replay::frames_at;
use reel_reward::Preset;
use reel_sim::{Simulator, Snapshot, render::Detail};
use reel_trace::{Durability, Images, RecordOptions, Trace};
use reel_world::{
    Frame, Skills, ToolCall,
    record::{EndReason, Parent, PolicyInfo, PolicyOutput, StepInput, StepRecord},
};

use crate::{
    convert,
    error::{OrRaise as _, refuse},
    policy::{Observation, report},
    tasks::{TaskSet, profile},
};

/// What came of a call: for the agent its observation, for the trainer reward and end.
#[pyclass(frozen, get_all, module = "reel._reel")]
pub struct StepResult {
    observation: Py<Observation>,
    /// Sum of the reward terms of this call.
    reward: f64,
    /// The terms that are not zero: `task`, `prog`, `phys`, `ask`, `time`, `safe`.
    reward_terms: BTreeMap<String, f64>,
    /// Whether the episode ended by a call of the agent, or by a fault.
    terminated: bool,
    /// Whether the horizon ended it.
    truncated: bool,
    /// Why it ended; none while it runs.
    end_reason: Option<String>,
}

/// How episodes are recorded.
#[derive(Clone, FromPyObject)]
#[pyo3(from_item_all)]
pub struct Recording {
    path: PathBuf,
    images: bool,
    fsync: bool,
}

impl Recording {
    /// What the runner is told.
    pub fn to(&self) -> RecordTo {
        let images = if self.images {
            Images::Full
        } else {
            Images::None
        };
        RecordTo {
            path: self.path.clone(),
            options: RecordOptions {
                durability: if self.fsync {
                    Durability::Fsync
                } else {
                    Durability::Write
                },
                ..RecordOptions::from(images)
            },
        }
    }
}

/// A running episode of the simulator, played call by call.
#[pyclass(frozen, module = "reel._reel")]
pub struct Simulation {
    running: Mutex<Option<RunningEpisode>>,
    /// Whether images are drawn in colour.
    images: bool,
}

impl Simulation {
    fn new(running: RunningEpisode, images: bool) -> Self {
        Self {
            running: Mutex::new(Some(running)),
            images,
        }
    }

    fn lock(&self) -> MutexGuard<'_, Option<RunningEpisode>> {
        self.running.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Looks at the episode, or says that it is over.
    fn with<T>(&self, look: impl FnOnce(&mut RunningEpisode) -> PyResult<T>) -> PyResult<T> {
        let mut running = self.lock();
        look(
            running
                .as_mut()
                .ok_or_else(|| refuse("the episode was closed; start another"))?,
        )
    }

    /// Makes a call, without the interpreter.
    fn execute(&self, input: StepInput) -> PyResult<()> {
        self.with(|running| {
            if let Some(reason) = running.episode().ended() {
                let reason = name_of(reason);
                return Err(refuse(format!(
                    "the episode has ended ({reason}); reset it"
                )));
            }
            running.execute(input, None).or_raise()
        })
    }

    fn result(&self, py: Python<'_>) -> PyResult<StepResult> {
        self.with(|running| {
            let ended = running.episode().ended();
            let last = running.episode().steps().last();
            Ok(StepResult {
                observation: Py::new(py, Observation::of(py, running, self.images)?)?,
                reward: last.map_or(0.0, |step| step.reward_total()),
                reward_terms: last.map_or_else(BTreeMap::new, terms),
                terminated: ended.is_some_and(|reason| reason != EndReason::Horizon),
                truncated: ended == Some(EndReason::Horizon),
                end_reason: ended.map(name_of),
            })
        })
    }
}

#[pymethods]
impl Simulation {
    /// Starts an episode of a task.
    #[staticmethod]
    #[pyo3(signature = (tasks, index, seed = 0, profile = "paper", preset = "paper", skills = "perfect", policy = "python", run_id = None, group = None, images = true, record = None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn start(
        py: Python<'_>,
        tasks: &TaskSet,
        index: isize,
        seed: u64,
        profile: &str,
        preset: &str,
        skills: &str,
        policy: &str,
        run_id: Option<String>,
        group: Option<(String, u32)>,
        images: bool,
        record: Option<Recording>,
    ) -> PyResult<Self> {
        let config = EpisodeConfig {
            rollout: group.map(rollout),
            ..config(
                tasks,
                index,
                seed,
                (profile, preset, skills),
                policy,
                run_id,
            )?
        };
        py.detach(|| {
            let record = record.map(|record| record.to());
            let detail = if images || record.is_some() {
                Detail::Full
            } else {
                Detail::Geometry
            };
            RunningEpisode::start_with(config, detail, record.as_ref())
                .or_raise()
                .map(|running| Self::new(running, images))
        })
    }

    /// Makes a call; it is recorded before this returns, where the episode is recorded.
    #[pyo3(signature = (name, arguments = None, policy_output = None))]
    fn step(
        &self,
        py: Python<'_>,
        name: &str,
        arguments: Option<&Bound<'_, PyAny>>,
        policy_output: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<StepResult> {
        let input = input(convert::call(name, arguments)?, policy_output)?;
        py.detach(|| self.execute(input))?;
        self.result(py)
    }

    /// What the agent knows now.
    fn observe(&self, py: Python<'_>) -> PyResult<Observation> {
        self.with(|running| Observation::of(py, running, self.images))
    }

    /// What the robot's head sees now: RGB, depth in millimetres, instance ids.
    fn render<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let look = |running: &mut RunningEpisode| -> PyResult<Frame> {
            let episode = running.episode();
            if self.images {
                return Ok(episode.render_frame());
            }
            // this one draws geometry alone, and its image is black: a copy of it draws colours
            let header = episode.header();
            let stage = episode.simulator().stage().clone();
            let snapshot = episode.snapshot();
            let copy = Simulator::resume(stage, header.profile, header.seed, &snapshot);
            let copy = copy.or_raise()?;
            Ok(copy.render_from(&copy.camera()))
        };
        let frame = py.detach(|| self.with(look))?;
        convert::frame(py, frame)
    }

    /// How many calls were made, those before a fork included.
    #[getter]
    fn calls(&self) -> PyResult<usize> {
        self.with(|running| Ok(running.episode().steps().len()))
    }

    #[getter]
    fn ended(&self) -> PyResult<Option<String>> {
        self.with(|running| Ok(running.episode().ended().map(name_of)))
    }

    fn header<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.with(|running| convert::object(py, running.episode().header()))
    }

    fn task<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.with(|running| convert::object(py, &**running.episode().task()))
    }

    fn record<'py>(&self, py: Python<'py>, call: isize) -> PyResult<Bound<'py, PyAny>> {
        self.with(|running| {
            let steps = running.episode().steps();
            convert::object(py, &steps[convert::index(call, steps.len(), "call")?])
        })
    }

    /// Digest of the simulator's state: equal states have equal ones, bit for bit.
    fn state_digest(&self) -> PyResult<String> {
        self.with(|running| {
            let episode = running.episode();
            let digests = episode
                .steps()
                .last()
                .map_or(&episode.start_record().digests, |step| &step.digests);
            Ok(digests.state.to_string())
        })
    }

    /// Ends the episode, as aborted where it still runs, and says how it went.
    fn close<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let ended = py.detach(|| {
            let running = self.lock().take();
            running.map(|running| running.end(None)).transpose()
        });
        ended
            .or_raise()?
            .map(|ended| convert::object(py, &report(&ended)))
            .transpose()
    }
}

/// Makes one call in each of several episodes, on all cores: name, arguments and what a model said
/// with it.
#[pyfunction]
pub fn step_all(
    py: Python<'_>,
    simulations: Vec<Py<Simulation>>,
    calls: Vec<(String, Bound<'_, PyAny>, Option<Bound<'_, PyAny>>)>,
) -> PyResult<Vec<StepResult>> {
    if simulations.len() != calls.len() {
        return Err(refuse(format!(
            "{} calls for {} episodes",
            calls.len(),
            simulations.len()
        )));
    }
    let inputs = calls
        .iter()
        .map(|(name, arguments, output)| {
            input(convert::call(name, Some(arguments))?, output.as_ref())
        })
        .collect::<PyResult<Vec<_>>>()?;
    let episodes: Vec<&Simulation> = simulations.iter().map(Py::get).collect();
    py.detach(|| {
        let pairs = episodes.par_iter().zip(inputs).with_max_len(1);
        pairs
            .map(|(episode, input)| episode.execute(input))
            .collect::<PyResult<Vec<()>>>()
    })?;
    episodes.iter().map(|episode| episode.result(py)).collect()
}

/// The state of a recorded episode before one of its calls, from which other futures are played,
/// as often as wanted. What is expensive is done once: world, meshes and paths of the task.
#[pyclass(frozen, module = "reel._reel")]
pub struct ForkPoint {
    parent: Arc<Trace>,
    calls: usize,
    snapshot: Snapshot,
    stage: Arc<PreparedTask>,
}

impl ForkPoint {
    /// The state of an episode of a trace after so many calls.
    pub fn of(parent: Arc<Trace>, calls: usize, episode: &Episode) -> PyResult<Self> {
        if episode.ended().is_some() {
            let last = calls.saturating_sub(1);
            return Err(refuse(format!(
                "the episode ended with call {last}: fork at one of the calls 0 to {last}"
            )));
        }
        Ok(Self {
            parent,
            calls,
            snapshot: episode.snapshot(),
            stage: episode.simulator().stage().clone(),
        })
    }
}

#[pymethods]
impl ForkPoint {
    /// How many calls of the parent were before.
    #[getter]
    fn calls(&self) -> usize {
        self.calls
    }

    /// Opens an episode that went as the parent did up to here.
    #[pyo3(signature = (policy = "python", run_id = None, group = None, images = true, record = None))]
    fn open(
        &self,
        py: Python<'_>,
        policy: &str,
        run_id: Option<String>,
        group: Option<(String, u32)>,
        images: bool,
        record: Option<Recording>,
    ) -> PyResult<Simulation> {
        let header = &self.parent.header;
        let config = EpisodeConfig {
            task: self.stage.task().clone(),
            scene: self.stage.scene().clone(),
            seed: header.seed,
            profile: header.profile,
            skills: header.skills,
            meshes: self.parent.meshes.clone(),
            preset: Preset::parse(&header.reward_preset).ok_or_else(|| {
                refuse(format!(
                    "no reward preset is called {}",
                    header.reward_preset
                ))
            })?,
            run_id: run_id.unwrap_or_else(|| format!("branch-{}", header.episode_id)),
            policy: named(policy),
            rollout: group.map(rollout),
            parent: Some(Parent {
                trace: self.parent.chain(),
                call: u32::try_from(self.calls).unwrap_or(u32::MAX),
            }),
        };
        py.detach(|| self.play(config, images, record))
            .map(|running| Simulation::new(running, images))
    }
}

impl ForkPoint {
    fn play(
        &self,
        config: EpisodeConfig,
        images: bool,
        record: Option<Recording>,
    ) -> PyResult<RunningEpisode> {
        let record = record.map(|record| record.to());
        let detail = if images || record.is_some() {
            Detail::Full
        } else {
            Detail::Geometry
        };
        let (start, steps) = (
            self.parent.start.clone(),
            self.parent.steps[..self.calls].to_vec(),
        );
        let episode = Episode::branch_on(
            self.stage.clone(),
            config,
            start,
            steps,
            &self.snapshot,
            detail,
        )
        .or_raise()?;
        let mut shown = match &record {
            Some(record) if record.options.images == Images::Full => self.images()?,
            _ => Default::default(),
        };
        RunningEpisode::resume(episode, record.as_ref(), |step| shown.remove(&step), None)
            .or_raise()
    }

    /// The images that the parent's agent got up to here.
    fn images(&self) -> PyResult<BTreeMap<Option<u32>, Vec<u8>>> {
        let got = self.parent.steps[..self.calls]
            .iter()
            .filter(|step| step.digests.frame.is_some());
        let moments = std::iter::once(None)
            .chain(got.map(|step| Some(step.step)))
            .collect();
        frames_at(&self.parent, &moments).map_err(|verdict| crate::error::not_executed(&verdict))
    }
}

/// The reward terms of a call by name.
fn terms(step: &StepRecord) -> BTreeMap<String, f64> {
    let mut terms = BTreeMap::new();
    for term in &step.reward {
        *terms.entry(term.component.clone()).or_default() += term.value;
    }
    terms
}

/// What an episode of a task is a function of.
pub fn config(
    tasks: &TaskSet,
    index: isize,
    seed: u64,
    (profile_name, preset, skills): (&str, &str, &str),
    policy: &str,
    run_id: Option<String>,
) -> PyResult<EpisodeConfig> {
    use reel_world::Assets as _;

    let (task, scene) = tasks.get(index)?;
    Ok(EpisodeConfig {
        task: task.clone(),
        scene: scene.clone(),
        seed,
        profile: profile(profile_name)?,
        skills: Skills::parse(skills).ok_or_else(|| {
            refuse(format!(
                "no skills are called '{skills}'; there are perfect and real-v1"
            ))
        })?,
        meshes: tasks.meshes.meshes(&mut task.assets()),
        preset: Preset::parse(preset)
            .ok_or_else(|| refuse(format!("no reward preset is called '{preset}'")))?,
        run_id: run_id.unwrap_or_else(|| format!("{policy}-{seed}")),
        policy: named(policy),
        rollout: None,
        parent: None,
    })
}

fn named(policy: &str) -> PolicyInfo {
    PolicyInfo {
        name: policy.to_owned(),
        ..PolicyInfo::default()
    }
}

fn rollout((group_id, index): (String, u32)) -> Rollout {
    Rollout { group_id, index }
}

/// The input of a step; beside the call what the policy said: raw, reasoning, history, plan,
/// tokens, latency_ns.
pub fn input(call: ToolCall, output: Option<&Bound<'_, PyAny>>) -> PyResult<StepInput> {
    match output {
        Some(output) if !output.is_none() => {
            let output: PolicyOutput = pythonize::depythonize(output)?;
            Ok(StepInput::with_policy_output(call, output))
        }
        _ => Ok(StepInput::from_call(call)),
    }
}

/// An end's reason as traces write it.
pub fn name_of(reason: EndReason) -> String {
    let name = match reason {
        EndReason::Finished => "finished",
        EndReason::Horizon => "horizon",
        EndReason::Fault => "fault",
        EndReason::Aborted => "aborted",
    };
    name.to_owned()
}
