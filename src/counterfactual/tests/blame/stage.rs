//! Tasks, and episodes of them.

use std::{path::PathBuf, sync::Arc};

use reel_agents::{Injection, Label, RecordTo, Responders, policy, run_episode, run_injected};
use reel_counterfactual::blame::Blame;
use reel_tasks::{DrawOptions, draw, home_scene};
use reel_trace::{Images, RecordOptions, Trace};
use reel_world::{Family, Scene, Task};
use tempfile::TempDir;

use crate::episodes::config;

/// Tasks in their scene, and a folder for traces.
pub struct Stage {
    pub tasks: Vec<Arc<Task>>,
    pub scene: Arc<Scene>,
    folder: TempDir,
}

impl Stage {
    pub fn new(count: usize, seed: u64) -> Self {
        let scene = home_scene();
        let options = DrawOptions {
            scene: &scene,
            families: &Family::ALL,
            count,
            seed,
        };
        Self::of(
            draw(&options).tasks.into_iter().map(Arc::new).collect(),
            Arc::new(scene),
        )
    }

    pub fn of(tasks: Vec<Arc<Task>>, scene: Arc<Scene>) -> Self {
        Self {
            tasks,
            scene,
            folder: tempfile::tempdir().unwrap(),
        }
    }

    /// Plays a task with a policy by name.
    pub fn play(&self, task: &Arc<Task>, name: &str) -> Trace {
        let mut policy = policy(name, task, &self.scene, 3).unwrap();
        let path = self.path(task, name);
        run_episode(
            config(task, &self.scene, 3),
            policy.as_mut(),
            Responders::default(),
            Some(&to(&path)),
        )
        .unwrap();
        Trace::read(&path).unwrap()
    }

    /// Plays a task in which something goes wrong.
    pub fn play_injected(&self, task: &Arc<Task>, injection: &Injection) -> (Trace, Label) {
        let path = self.path(task, &injection.seed.to_string());
        let (_, label) = run_injected(
            config(task, &self.scene, injection.seed),
            injection,
            Some(&to(&path)),
        )
        .unwrap();
        (Trace::read(&path).unwrap(), label)
    }

    pub fn folder(&self) -> &std::path::Path {
        self.folder.path()
    }

    fn path(&self, task: &Task, name: &str) -> PathBuf {
        self.folder
            .path()
            .join(format!("{}-{name}.mcap", task.task_id.replace('/', "-")))
    }
}

fn to(path: &std::path::Path) -> RecordTo {
    RecordTo {
        path: path.to_owned(),
        options: RecordOptions::from(Images::None),
    }
}

/// An episode with its costs, a line a step.
pub fn told(trace: &Trace, blame: &Blame) -> String {
    let number = |number: Option<u32>| number.map_or("-".to_owned(), |number| number.to_string());
    let lines = trace.steps.iter().zip(&blame.costs).map(|(step, cost)| {
        let text = step.outcome.text.replace('\n', " ");
        let call = step.input.call.to_string();
        format!(
            "{:>3} {call:<56} {:>3} {:>2}  {text:.60}",
            step.step,
            number(cost.before),
            number(cost.regret)
        )
    });
    lines.collect::<Vec<_>>().join("\n")
}
