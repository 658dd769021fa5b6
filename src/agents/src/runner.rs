//! Plays an episode with a policy and records it, and plays many on several
//! threads. Never decides anything.

use std::{
    any::Any,
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
};

use rayon::prelude::*;
use reel_episode::EpisodeConfig;
use reel_trace::Trace;
use reel_world::{
    Family, Scene, Task,
    record::{EndReason, EndRecord, EpisodeHeader, StartRecord, StepRecord},
};

use crate::{
    AgentError, Injected, Injection, Label, Policy, Responders, policy,
    record::RecordTo,
    responders::{broken_rules, refused_rules},
    running::RunningEpisode,
};

/// How an episode went.
#[derive(Clone, PartialEq, Debug)]
pub struct EpisodeReport {
    /// Id of the episode, from its header.
    pub episode_id: String,
    /// Id of the task that was played.
    pub task_id: String,
    /// Family of the task that was played.
    pub family: Family,
    /// Name of the policy, as in the trace header.
    pub policy: String,
    /// Seed of the episode, from its header.
    pub seed: u64,
    /// SR: no goal change is left.
    pub success: bool,
    /// CR: share of the goal changes that hold.
    pub completion: f64,
    /// Sum of the rewards of all steps, undiscounted.
    pub total_reward: f64,
    /// SPL; none where the shortest path is unknown.
    pub spl: Option<f64>,
    /// Number of decisions that the policy made.
    pub length: u32,
    /// Number of `ask` calls in the episode.
    pub asks: u32,
    /// Reason why the episode ended, e.g. finished or aborted.
    pub end_reason: EndReason,
    /// The trace, where one was recorded.
    pub trace: Option<PathBuf>,
    /// Its length in bytes; 0 without a trace.
    pub bytes: u64,
    /// Why the policy gave up on the goal, where it failed for that.
    pub unreachable: Option<String>,
    /// Tokens read and written by a model; none where nobody counted any.
    pub tokens: Option<[u64; 2]>,
    /// How long the policy took for all its decisions, in nanoseconds; 0 where nobody measured.
    pub latency_ns: u64,
    /// The rules of the simulated user that replies from outside broke, one for each time.
    pub broken_rules: Vec<&'static str>,
    /// The rules that replies broke which a model gave and the policy did not get, one for each time.
    pub refused_rules: Vec<String>,
}

impl EpisodeReport {
    /// How an episode went by its records: where it was recorded and why the policy gave up,
    /// they do not say.
    pub(crate) fn new(
        header: &EpisodeHeader,
        (task, scene): (&Task, &Scene),
        (start, steps, end): (&StartRecord, &[StepRecord], &EndRecord),
    ) -> Self {
        let (metrics, (tokens, latency_ns)) = (&end.metrics, spent(steps));
        Self {
            episode_id: header.episode_id.clone(),
            task_id: header.task_id.clone(),
            family: header.family,
            policy: header.policy.name.clone(),
            seed: header.seed,
            success: metrics.success,
            completion: metrics.completion,
            total_reward: metrics.total_reward,
            spl: metrics.spl,
            length: end.steps,
            asks: metrics.asks,
            end_reason: end.reason,
            trace: None,
            bytes: 0,
            unreachable: None,
            tokens,
            latency_ns,
            broken_rules: broken_rules(task, scene, start, steps),
            refused_rules: refused_rules(steps),
        }
    }

    /// How a recorded episode went; none where the recording has no end.
    pub fn of_trace(trace: &Trace, path: &Path) -> Option<Self> {
        let records = (&trace.start, trace.steps.as_slice(), trace.end.as_ref()?);
        let report = Self::new(&trace.header, (&trace.task, &trace.scene), records);
        Some(Self {
            trace: Some(path.to_owned()),
            ..report
        })
    }
}

/// Tokens read and written, where anybody counted them, and the time that
/// policies took, in nanoseconds.
fn spent(steps: &[StepRecord]) -> (Option<[u64; 2]>, u64) {
    let outputs = || steps.iter().filter_map(|step| step.input.policy.as_ref());
    let tokens = outputs().filter_map(|output| output.tokens).fold(
        None,
        |sum: Option<[u64; 2]>, [read, written]| {
            let [before, after] = sum.unwrap_or_default();
            Some([before + u64::from(read), after + u64::from(written)])
        },
    );
    (
        tokens,
        outputs().filter_map(|output| output.latency_ns).sum(),
    )
}

/// One episode to play.
#[derive(Clone, Debug)]
pub struct EpisodeJob {
    /// What it is a function of. Who decides is filled in by the runner.
    pub config: EpisodeConfig,
    /// Name of the policy, for messages; of a built-in one the name by which it is found.
    pub policy: String,
    /// Where to record it; none: nowhere.
    pub record: Option<RecordTo>,
    /// The command that plays this episode alone, for messages.
    pub command: String,
}

/// Who takes part in an episode: who decides, and who answers from outside.
pub struct Participants {
    /// Policy that decides every call of the episode.
    pub policy: Box<dyn Policy + Send>,
    /// Who answers from outside.
    pub outside: Responders,
}

/// The built-in policy that a job names, with the episode's seed, and nobody outside.
///
/// # Errors
/// When no policy is called so.
pub fn builtin(job: &EpisodeJob) -> Result<Participants, AgentError> {
    let policy = policy(
        &job.policy,
        &job.config.task,
        &job.config.scene,
        job.config.seed,
    )?;
    Ok(Participants {
        policy,
        outside: Responders::default(),
    })
}

/// Plays one episode to its end.
///
/// # Errors
/// When the episode cannot start, its trace cannot be written, or the policy or somebody outside
/// does not answer: then what was recorded is closed as aborted.
pub fn run_episode(
    mut config: EpisodeConfig,
    policy: &mut dyn Policy,
    outside: Responders,
    record: Option<&RecordTo>,
) -> Result<EpisodeReport, AgentError> {
    config.policy = policy.info();
    config.policy.parameters.extend(outside.settings.clone());
    let mut running = RunningEpisode::start(config, record)?.with_responders(outside);
    match running.play(policy) {
        Err(unanswered @ AgentError::NoAnswer { .. }) => {
            running.end(None)?;
            Err(unanswered)
        }
        played => {
            played?;
            running.end(policy.gave_up())
        }
    }
}

/// Plays one episode in which what the injection says goes wrong, and labels it. Where it is
/// recorded, the label is written beside the trace, as `<trace>.label.json`.
///
/// # Errors
/// When the task does not admit the injection, the episode cannot start, or trace or
/// label cannot be written.
pub fn run_injected(
    config: EpisodeConfig,
    injection: &Injection,
    record: Option<&RecordTo>,
) -> Result<(EpisodeReport, Label), AgentError> {
    let task = config.task.clone();
    let mut policy =
        Injected::new(&task, &config.scene, injection).map_err(|source| AgentError::Injection {
            task: task.task_id.clone(),
            source,
        })?;
    let report = run_episode(config, &mut policy, Responders::default(), record)?;
    let label = policy.label(&report.episode_id, report.success);
    if let Some(trace) = &report.trace {
        let mut path = trace.clone().into_os_string();
        path.push(".label.json");
        let text = serde_json::to_string_pretty(&label).expect("a label is plain data");
        #[expect(
            clippy::disallowed_methods,
            reason = "the label lies beside the trace; nothing is computed from it"
        )]
        std::fs::write(&path, text + "\n").map_err(|source| AgentError::Label {
            task: task.task_id.clone(),
            seed: injection.seed,
            path: path.into(),
            source,
        })?;
    }
    Ok((report, label))
}

/// Plays many episodes on `workers` threads; `seat` says who plays one, when it is about to begin.
/// Results come in the order of the jobs, whatever the order they end in; `on_done` is called from
/// the worker threads as episodes end. A panic ends only its own episode.
pub fn run_all(
    jobs: Vec<EpisodeJob>,
    workers: usize,
    seat: impl Fn(&EpisodeJob) -> Result<Participants, AgentError> + Sync,
    on_done: impl Fn(&EpisodeReport) + Sync,
) -> Vec<Result<EpisodeReport, AgentError>> {
    let pool = match rayon::ThreadPoolBuilder::new()
        .num_threads(workers.max(1))
        .build()
    {
        Ok(pool) => pool,
        Err(error) => {
            let failed = |_| {
                Err(AgentError::Workers {
                    workers,
                    message: error.to_string(),
                })
            };
            return jobs.iter().map(failed).collect();
        }
    };
    let play = |job: &EpisodeJob| {
        let report = contained(job, || {
            let Participants {
                mut policy,
                outside,
            } = seat(job)?;
            run_episode(
                job.config.clone(),
                policy.as_mut(),
                outside,
                job.record.as_ref(),
            )
        })?;
        on_done(&report);
        Ok(report)
    };
    // One job at a time: episodes differ much in length.
    pool.install(|| jobs.par_iter().with_max_len(1).map(play).collect())
}

/// Turns a panic into an error that says how to see it again.
fn contained<T>(
    job: &EpisodeJob,
    play: impl FnOnce() -> Result<T, AgentError>,
) -> Result<T, AgentError> {
    catch_unwind(AssertUnwindSafe(play)).unwrap_or_else(|panic| {
        Err(AgentError::Panicked {
            task: job.config.task.task_id.clone(),
            policy: job.policy.clone(),
            seed: job.config.seed,
            message: message_of(panic.as_ref()),
            command: job.command.clone(),
        })
    })
}

fn message_of(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "no message".to_owned())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use reel_world::{Profile, Scene, Skills, Task, record::PolicyInfo};
    use serde_json::json;

    use super::*;

    fn job() -> EpisodeJob {
        let task = json!({"task_id": "FDP/t_7", "family": "FDP", "scene_id": "flat", "instruction": "", "precise_instruction": "",
            "objects": [], "initial": {}, "goal": {}, "target": "apple", "src": "table_1", "dest": "desk_1"});
        let task: Task = serde_json::from_value(task).unwrap();
        let scene: Scene =
            serde_json::from_value(json!({"scene_id": "flat", "rooms": [], "receptacles": []}))
                .unwrap();
        let config = EpisodeConfig {
            task: Arc::new(task),
            scene: Arc::new(scene),
            seed: 11,
            preset: reel_reward::Preset::paper(),
            profile: Profile::Paper,
            skills: Skills::Perfect,
            meshes: reel_world::Meshes::default(),
            run_id: "run".into(),
            policy: PolicyInfo::default(),
            rollout: None,
            parent: None,
        };
        EpisodeJob {
            config,
            policy: "oracle".into(),
            record: None,
            command: "reel run --seed 11".into(),
        }
    }

    #[test]
    fn a_panic_becomes_an_error_that_can_be_reproduced() {
        let error = contained::<()>(&job(), || panic!("index {} is out of range", 4))
            .unwrap_err()
            .to_string();
        let expected = "task FDP/t_7, policy oracle, seed 11: the episode panicked: index 4 is out of range; \
                        reproduce it with: reel run --seed 11";
        assert_eq!(error, expected);
        assert_eq!(contained(&job(), || Ok(3)).unwrap(), 3);
    }

    #[test]
    fn results_come_in_the_order_of_the_jobs() {
        let unknown = |index: usize| EpisodeJob {
            policy: format!("nobody-{index}"),
            ..job()
        };
        let results = run_all((0..16).map(unknown).collect(), 2, builtin, |_| {});
        for (index, result) in results.into_iter().enumerate() {
            let error = result.unwrap_err().to_string();
            assert!(error.contains(&format!("'nobody-{index}'")), "{error}");
        }
    }
}
