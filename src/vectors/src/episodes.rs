//! Recorded episodes in the home, and changed traces written again.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, OnceLock},
};

use reel_agents::{RecordTo, Responders, policy, run_episode};
use reel_episode::EpisodeConfig;
use reel_reward::Preset;
use reel_tasks::{DrawOptions, draw, home_scene};
use reel_trace::{Images, Recorder, Trace};
use reel_world::{Family, Profile, Scene, Skills, Task, record::PolicyInfo};

/// One task of each family.
pub fn tasks() -> &'static [Arc<Task>] {
    static TASKS: OnceLock<Vec<Arc<Task>>> = OnceLock::new();
    TASKS.get_or_init(|| {
        let options = DrawOptions {
            scene: &home_scene(),
            families: &Family::ALL,
            count: 4,
            seed: 7,
        };
        let tasks: Vec<_> = draw(&options).tasks.into_iter().map(Arc::new).collect();
        assert_eq!(tasks.len(), 4);
        tasks
    })
}

/// The tasks of REAL-Bench in their scene, or `None` where it is not there.
pub fn real_bench() -> Option<(Arc<Scene>, Vec<Arc<Task>>)> {
    let path = crate::real_bench()?;
    let scene = reel_tasks::scene::load(&path.join("s7_scene.json"))
        .unwrap()
        .scene;
    let tasks: Vec<_> = reel_tasks::load(&path.join("tasks"), &scene)
        .tasks
        .into_iter()
        .map(Arc::new)
        .collect();
    assert_eq!(tasks.len(), 180);
    Some((Arc::new(scene), tasks))
}

/// Plays a task and records it.
pub fn record(path: &Path, task: &Arc<Task>, name: &str, images: Images) -> PathBuf {
    record_seeded(path, task, name, 3, images)
}

/// Plays a task under a seed and records it.
pub fn record_seeded(
    path: &Path,
    task: &Arc<Task>,
    name: &str,
    seed: u64,
    images: Images,
) -> PathBuf {
    let scene = Arc::new(home_scene());
    let mut policy = policy(name, task, &scene, seed).unwrap();
    let config = config(task, &scene, seed);
    run_episode(
        config,
        policy.as_mut(),
        Responders::default(),
        Some(&RecordTo {
            path: path.to_owned(),
            options: images.into(),
        }),
    )
    .unwrap();
    path.to_owned()
}

/// What an episode of a task starts from.
pub fn config(task: &Arc<Task>, scene: &Arc<Scene>, seed: u64) -> EpisodeConfig {
    EpisodeConfig {
        task: task.clone(),
        scene: scene.clone(),
        seed,
        profile: Profile::Paper,
        skills: Skills::Perfect,
        meshes: reel_world::Meshes::default(),
        preset: Preset::paper(),
        run_id: "test".into(),
        policy: PolicyInfo::default(),
        rollout: None,
        parent: None,
    }
}

/// Writes a trace with the real recorder: checksums and chain are right.
pub fn write(path: &Path, trace: &Trace) -> PathBuf {
    let mut recorder =
        Recorder::create(path, &trace.header, &trace.task, &trace.scene, Images::None).unwrap();
    recorder.start(&trace.start, None).unwrap();
    for step in &trace.steps {
        recorder.input(step.step, &step.input).unwrap();
        recorder.step(step, None).unwrap();
    }
    recorder.end(trace.end.as_ref().unwrap()).unwrap();
    path.to_owned()
}
