//! What sessions play, and how it is recorded.

use std::{
    collections::{BTreeMap, HashMap},
    fmt,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, OnceLock, PoisonError, Weak},
};

use reel_episode::{EpisodeConfig, PreparedTask, Rollout};
use reel_reward::Preset;
use reel_trace::RecordOptions;
use reel_world::{Assets, Meshes, Profile, Scene, Scenes, Skills, Task, record::PolicyInfo};
use serde_json::{Value, json};

use crate::{Host, LiveError};

/// What every session of a server plays.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The tasks, in the order in which they are played.
    pub tasks: Vec<Arc<Task>>,
    /// The scenes they play in.
    pub scenes: Scenes,
    /// What the objects of the tasks look like that are no primitives.
    pub meshes: Meshes,
    /// Seed of everything random.
    pub seed: u64,
    /// Behaviour where paper and published code differ.
    pub profile: Profile,
    /// How reliable the robot's skills are.
    pub skills: Skills,
    /// Reward preset whose terms the steps hold.
    pub preset: Preset,
    /// The run that the episodes belong to.
    pub run_id: String,
    /// Folder for the traces.
    pub folder: PathBuf,
    /// Who answers from outside, for the traces: beside the policy's own settings.
    pub answer_settings: BTreeMap<String, Value>,
    /// Whether traces hold images, and what a recorded call survives.
    pub options: RecordOptions,
    /// What it all runs on.
    pub host: Host,
    /// Those of the tasks that are being played.
    pub stages: PreparedTaskCache,
    /// Who is told of each trace that is finished.
    pub on_finished: TraceObserver,
}

/// What is called with a trace, on the session's thread.
type ObserveTrace = Box<dyn Fn(&Path) + Send + Sync>;

/// Who is told of each trace when it is finished: set once, by whoever runs the sessions. It must not take long.
#[derive(Clone, Default)]
pub struct TraceObserver(Arc<OnceLock<ObserveTrace>>);

impl TraceObserver {
    /// Tells `observe` of each trace from now on. The first one that is set stays.
    pub fn set(&self, observe: impl Fn(&Path) + Send + Sync + 'static) {
        let _ = self.0.set(Box::new(observe));
    }

    /// Passes on that a trace is finished.
    pub(crate) fn finished(&self, trace: &Path) {
        if let Some(observe) = self.0.get() {
            observe(trace);
        }
    }
}

impl fmt::Debug for TraceObserver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let set = self.0.get().is_some();
        f.debug_tuple("TraceObserver").field(&set).finish()
    }
}

/// What the simulators of one task share, as long as there is one of them.
#[derive(Clone, Debug, Default)]
pub struct PreparedTaskCache(Arc<Mutex<HashMap<String, Weak<PreparedTask>>>>);

/// A session that is let for a prompt group: it plays one task at one seed so many times.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Lease {
    /// Id of the prompt group that the session is leased to.
    pub group_id: String,
    /// Id of the task that every rollout plays.
    pub task_id: String,
    /// The seed of every rollout.
    pub seed: u64,
    /// G, the number of rollouts that the session plays.
    pub rollouts: u32,
}

/// What a client asks of its next episode; where it asks nothing, the session decides.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct EpisodeRequest {
    /// Id of the task, or its part after the family; `None` if the seed or the list decides.
    pub task_id: Option<String>,
    /// Seed of everything random in the episode; `None` if the server's.
    pub seed: Option<u64>,
    /// What the client calls the episode, for the trace.
    pub label: Option<String>,
}

/// What tells an episode of a session from all others.
pub(crate) struct EpisodeKey<'a> {
    pub session: &'a str,
    /// How many episodes were begun there before.
    pub number: u32,
    pub policy: &'a str,
    pub lease: Option<&'a Lease>,
    /// The seed that the client asked for, if it did.
    pub seed: Option<u64>,
    /// What the client calls the episode, if it says.
    pub label: Option<&'a str>,
}

impl PreparedTaskCache {
    /// Lets the episodes of a task be played on this stage while somebody holds it.
    pub fn keep(&self, stage: &Arc<PreparedTask>) {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.insert(stage.task().task_id.clone(), Arc::downgrade(stage));
    }
}

impl Setup {
    /// Finds a task by its id.
    pub fn task(&self, task_id: &str) -> Option<&Arc<Task>> {
        self.tasks.iter().find(|task| task.task_id == task_id)
    }

    /// The scene of one of the tasks.
    ///
    /// # Panics
    /// Panics if it is not among the scenes: tasks are loaded with theirs.
    pub fn scene(&self, task: &Task) -> &Arc<Scene> {
        self.scenes
            .of(task)
            .expect("tasks are loaded with their scenes")
    }

    /// The index of the task that an id means: the whole id, or the part after the family where
    /// only one task has it.
    pub(crate) fn find(&self, id: &str) -> Option<usize> {
        let whole = self.tasks.iter().position(|task| task.task_id == id);
        let mut short = self
            .tasks
            .iter()
            .enumerate()
            .filter(|(_, task)| task.short_id() == id)
            .map(|(index, _)| index);
        whole.or_else(|| short.next().filter(|_| short.next().is_none()))
    }

    /// The stage of one of the tasks.
    ///
    /// # Errors
    /// When the task plays in another scene.
    pub(crate) fn stage(&self, task: &Arc<Task>) -> Result<Arc<PreparedTask>, LiveError> {
        let known = || self.stages.0.lock().unwrap_or_else(PoisonError::into_inner);
        let fits = |stage: &Arc<PreparedTask>| Arc::ptr_eq(stage.task(), task);
        if let Some(stage) = known()
            .get(&task.task_id)
            .and_then(Weak::upgrade)
            .filter(fits)
        {
            return Ok(stage);
        }
        // Others need not wait meanwhile; who builds the same at the same time keeps its own.
        let stage = reel_episode::prepare_task(self.scene(task), task, &self.meshes(task))?;
        let mut known = known();
        known.retain(|_, stage| stage.strong_count() > 0);
        known.insert(task.task_id.clone(), Arc::downgrade(&stage));
        Ok(stage)
    }

    /// The meshes of a task's objects.
    fn meshes(&self, task: &Task) -> Meshes {
        self.meshes.meshes(&mut task.assets())
    }

    pub(crate) fn config(
        &self,
        task: &Arc<Task>,
        place: &EpisodeKey<'_>,
        before: u32,
    ) -> EpisodeConfig {
        let rollout = place.lease.map(|lease| Rollout {
            group_id: lease.group_id.clone(),
            index: place.number,
        });
        EpisodeConfig {
            task: task.clone(),
            scene: self.scene(task).clone(),
            seed: match place.lease {
                Some(lease) => lease.seed,
                None => place.seed.unwrap_or(self.seed),
            },
            profile: self.profile,
            skills: self.skills,
            meshes: self.meshes(task),
            preset: self.preset.clone(),
            run_id: self.run_id.clone(),
            policy: self.policy(place, before),
            rollout,
            parent: None,
        }
    }

    /// Who plays, for the header. `before` episodes had the name that the trace wanted.
    pub(crate) fn policy(&self, place: &EpisodeKey<'_>, before: u32) -> PolicyInfo {
        // Which session it was is part of the inputs: two agents that play the same task do not
        // play the same episode.
        let mut parameters = vec![
            ("session", json!(place.session)),
            ("number", json!(place.number)),
        ];
        if before > 0 {
            parameters.push(("before", json!(before)));
        }
        if let Some(label) = place.label {
            parameters.push(("episode_id", json!(label)));
        }
        PolicyInfo {
            name: place.policy.to_owned(),
            checkpoint: None,
            parameters: parameters
                .into_iter()
                .map(|(key, value)| (key.to_owned(), value))
                .chain(self.answer_settings.clone())
                .collect(),
        }
    }

    /// Where the episode is recorded, under a name that no trace and no recording has; and how many
    /// of its name there were before, of an earlier session that was called the same.
    pub(crate) fn path(&self, task: &Task, place: &EpisodeKey<'_>) -> (PathBuf, u32) {
        let task = task.task_id.replace(
            |c: char| !c.is_ascii_alphanumeric() && !"-_.".contains(c),
            "_",
        );
        let name = format!(
            "{}--{}--{:04}--{task}",
            self.run_id, place.session, place.number
        );
        let path = |before: u32| match before {
            0 => self.folder.join(format!("{name}.mcap")),
            _ => self.folder.join(format!("{name}--{before}.mcap")),
        };
        // A disk that does not say whether it is there refuses the recording when it begins.
        let there = |path: &PathBuf| self.host.disk.exists(path).unwrap_or(false);
        let taken = |path: &PathBuf| there(path) || there(&path.with_added_extension("part"));
        let mut names = (0..).map(|before| (path(before), before));
        names
            .find(|(path, _)| !taken(path))
            .expect("there is always a further number")
    }
}

/// Refuses a name that does not belong into a path.
///
/// # Errors
/// When it is empty, too long, or holds anything but letters, digits, `-`, `_` and `.`.
pub fn check_name(name: &str) -> Result<(), LiveError> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    let fine = (1..=64).contains(&name.len())
        && name.chars().all(allowed)
        && name.starts_with(|c: char| c.is_ascii_alphanumeric());
    if fine {
        Ok(())
    } else {
        Err(LiveError::Name(name.chars().take(80).collect()))
    }
}
