//! Policies in Python: what they are shown, and playing tasks with them.

use std::{fs, path::Path, sync::Arc};

use numpy::PyArray3;
use pyo3::{exceptions::PyKeyboardInterrupt, prelude::*};
use reel_agents::{
    EpisodeJob, EpisodeReport, Participants, Policy, PolicyContext, ResponderError, Responders,
    RunningEpisode, builtin, run_all,
};
use reel_world::record::{PolicyInfo, StepInput};
use serde_json::{Value, json};

use crate::{
    convert,
    error::{policy_error, refuse},
    running::{Stop, interruptible, report_progress},
    simulation::{Recording, config, input},
    tasks::TaskSet,
};

/// What an agent sees before a decision: nothing privileged.
#[pyclass(frozen, get_all, module = "reel._reel")]
pub struct Observation {
    /// The task's instruction, in words.
    instruction: String,
    /// The receptacles of the home: id, category, room.
    receptacles: Vec<(String, String, String)>,
    /// What the last call answered; empty before the first.
    text: String,
    /// Code of the last call's error; none where it did what it should.
    error: Option<String>,
    /// The new image, 480 x 640 x 3, uint8, RGB; none where the last call gave none.
    image: Option<Py<PyArray3<u8>>>,
    /// Category of what the gripper holds.
    held: Option<String>,
    /// Decisions taken so far.
    step: u32,
}

impl Observation {
    /// What the agent of a running episode sees now; `images` says whether they are drawn in colour.
    pub fn of(py: Python<'_>, running: &RunningEpisode, images: bool) -> PyResult<Self> {
        Self::new(py, &running.context(), images)
    }

    fn new(py: Python<'_>, context: &PolicyContext<'_>, images: bool) -> PyResult<Self> {
        let PolicyContext {
            briefing,
            observation,
            step,
            ..
        } = *context;
        // A copy: the frame stays what the episode knows.
        let image = observation
            .frame
            .as_ref()
            .filter(|_| images)
            .map(|frame| convert::rgb(py, frame.rgb.clone()));
        let receptacle = |(id, category, room): &(reel_world::ReceptacleId, String, String)| {
            (id.to_string(), category.clone(), room.clone())
        };
        Ok(Self {
            instruction: briefing.instruction.clone(),
            receptacles: briefing.receptacles.iter().map(receptacle).collect(),
            text: observation.text.clone(),
            error: observation.error.map(|code| code.as_str().to_owned()),
            image: image.transpose()?.map(Bound::unbind),
            held: observation.held.clone(),
            step,
        })
    }
}

/// A Python function that decides.
struct PythonPolicy {
    act: Py<PyAny>,
    /// Set by Ctrl-C: it is not asked again.
    stop: Arc<Stop>,
    name: String,
}

impl Policy for PythonPolicy {
    fn info(&self) -> PolicyInfo {
        PolicyInfo {
            name: self.name.clone(),
            ..PolicyInfo::default()
        }
    }

    fn needs_privileged(&self) -> bool {
        false
    }

    fn act(&mut self, context: &PolicyContext<'_>) -> Result<StepInput, ResponderError> {
        if self.stop.is_set() {
            return Err(ResponderError::new(PyKeyboardInterrupt::new_err(())));
        }
        Python::attach(|py| {
            let observation = Observation::new(py, context, true)?;
            let (name, arguments, output): (String, Bound<'_, PyAny>, Option<Bound<'_, PyAny>>) =
                self.act.call1(py, (observation,))?.extract(py)?;
            input(convert::call(&name, Some(&arguments))?, output.as_ref())
        })
        .map_err(ResponderError::new)
    }
}

/// Plays the tasks of a set, each once, with a built-in policy (a name) or a Python one (a function
/// that makes, for each episode, the function that decides). Results in their order.
///
/// # Errors
/// Fails with the first exception of a policy, when the other episodes are done.
#[pyfunction]
#[pyo3(signature = (tasks, policy, factory, recordings, seed, profile, preset, skills, jobs, progress = None))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub fn run<'py>(
    py: Python<'py>,
    tasks: &TaskSet,
    policy: &str,
    factory: Option<Py<PyAny>>,
    recordings: Vec<Option<Recording>>,
    seed: u64,
    profile: &str,
    preset: &str,
    skills: &str,
    jobs: usize,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let job = |(index, record): (usize, Option<Recording>)| {
        let record = record.map(|record| record.to());
        if let Some(record) = &record {
            remove_abandoned(&record.path.with_added_extension("part"));
        }
        Ok(EpisodeJob {
            config: config(
                tasks,
                index as isize,
                seed,
                (profile, preset, skills),
                policy,
                None,
            )?,
            policy: policy.to_owned(),
            record,
            command: String::from("reel.run"),
        })
    };
    let jobs_to_play = recordings
        .into_iter()
        .enumerate()
        .map(job)
        .collect::<PyResult<Vec<_>>>()?;
    // A name that is none is one error, not one of each episode.
    if let (None, Some(first)) = (&factory, jobs_to_play.first()) {
        builtin(first).map_err(|error| refuse(chain(&error)))?;
    }
    let stop = Arc::new(Stop::default());
    let stopped = |job: &EpisodeJob| reel_agents::AgentError::NotPlayed {
        task: job.config.task.task_id.to_string(),
        seed,
        why: "interrupted".to_owned(),
    };
    let seat = |job: &EpisodeJob| {
        if stop.is_set() {
            return Err(stopped(job));
        }
        let Some(factory) = &factory else {
            return builtin(job);
        };
        let act = Python::attach(|py| factory.call0(py));
        Ok(Participants {
            policy: Box::new(PythonPolicy {
                act: act.map_err(|error| reel_agents::AgentError::NoAnswer {
                    task: job.config.task.task_id.to_string(),
                    seed,
                    step: 0,
                    source: ResponderError::new(error),
                })?,
                stop: Arc::clone(&stop),
                name: policy.to_owned(),
            }),
            outside: Responders::default(),
        })
    };
    let results = interruptible(
        py,
        || stop.set(),
        || {
            run_all(jobs_to_play, jobs, seat, |_| {
                report_progress(progress.as_ref(), 1)
            })
        },
    )?;
    let mut reports = Vec::new();
    for result in results {
        reports.push(match result {
            Ok(played) => report(&played),
            Err(error) => {
                if let Some(raised) = raised_by(py, &error)? {
                    return Err(raised);
                }
                json!({ "error": chain(&error) })
            }
        });
    }
    convert::object(py, &reports)
}

/// The exception of a Python policy that ended an episode.
fn raised_by(py: Python<'_>, error: &reel_agents::AgentError) -> PyResult<Option<PyErr>> {
    let reel_agents::AgentError::NoAnswer {
        task, step, source, ..
    } = error
    else {
        return Ok(None);
    };
    let Some(raised) = source.0.downcast_ref::<PyErr>() else {
        return Ok(None);
    };
    let raised = policy_error(task, *step, raised.value(py).clone())?;
    Ok(Some(PyErr::from_value(raised.into_any())))
}

/// Removes what an interrupted run left of an episode, as `reel run` does: it is played again. A
/// part whose recorder still lives is locked, and stays.
fn remove_abandoned(part: &Path) {
    if fs::File::open(part).is_ok_and(|file| file.try_lock().is_ok()) {
        let _in_the_way = fs::remove_file(part);
    }
}

pub fn chain(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |error| error.source());
    causes
        .map(ToString::to_string)
        .collect::<Vec<_>>()
        .join(": ")
}

/// How an episode went, for Python.
pub fn report(report: &EpisodeReport) -> Value {
    json!({
        "episode_id": report.episode_id, "task_id": report.task_id, "family": report.family,
        "policy": report.policy, "seed": report.seed, "success": report.success,
        "completion": report.completion, "total_reward": report.total_reward, "spl": report.spl,
        "length": report.length, "asks": report.asks, "end_reason": report.end_reason,
        "trace": report.trace, "bytes": report.bytes,
        "unreachable": report.unreachable,
    })
}
