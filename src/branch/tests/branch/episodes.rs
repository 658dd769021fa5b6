//! Recorded episodes in the home, one task of each family, and branches of them.

use std::{
    path::PathBuf,
    sync::{Arc, OnceLock, atomic::AtomicUsize, atomic::Ordering},
};

use reel_agents::{RecordTo, policy, run_episode};
use reel_branch::Branch;
use reel_episode::EpisodeConfig;
use reel_reward::Preset;
use reel_tasks::{GenerateOptions, generate, home};
use reel_trace::{Images, Trace};
use reel_world::{Family, Profile, Task, record::PolicyInfo};
use tempfile::TempDir;

/// One task of each family.
pub fn tasks() -> &'static [Arc<Task>] {
    static TASKS: OnceLock<Vec<Arc<Task>>> = OnceLock::new();
    TASKS.get_or_init(|| {
        let options = GenerateOptions { scene: &home(), families: &Family::ALL, count: 4, seed: 11 };
        let tasks: Vec<_> = generate(&options).tasks.into_iter().map(Arc::new).collect();
        assert_eq!(tasks.len(), 4);
        tasks
    })
}

/// A folder of traces.
pub struct Folder {
    folder: TempDir,
    count: AtomicUsize,
}

impl Folder {
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap(), count: AtomicUsize::new(0) }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A name that nobody has.
    pub fn next(&self) -> PathBuf {
        self.path(&format!("{}.mcap", self.count.fetch_add(1, Ordering::Relaxed)))
    }

    /// Plays a task and records it.
    pub fn play(&self, task: &Arc<Task>, name: &str, images: Images) -> Trace {
        let scene = Arc::new(home());
        let mut policy = policy(name, task, &scene, 3).unwrap();
        let config = EpisodeConfig {
            task: task.clone(),
            scene,
            seed: 3,
            profile: Profile::Paper,
            preset: Preset::paper(),
            run_id: "test".into(),
            policy: PolicyInfo::default(),
            parent: None,
        };
        let record = RecordTo { path: self.next(), options: images.into() };
        run_episode(config, policy.as_mut(), Some(&record)).unwrap();
        Trace::read(&record.path).unwrap()
    }

    /// Plays a branch and records it.
    pub fn branch(&self, branch: &Branch, parent: &Trace, at: usize, images: Images) -> Trace {
        let record = RecordTo { path: self.next(), options: images.into() };
        branch.play_at(parent, at, Some(&record)).unwrap();
        Trace::read(&record.path).unwrap()
    }
}
