//! Episodes played in the home, and spoilt ones.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use reel_agents::{RecordTo, policy, run_episode};
use reel_episode::EpisodeConfig;
use reel_reward::Preset;
use reel_tasks::{GenerateOptions, generate, home};
use reel_trace::{Images, Recorder, Trace};
use reel_world::{Family, Profile, Task, chain, record::PolicyInfo};

fn tasks(seed: u64) -> Vec<Arc<Task>> {
    let made = generate(&GenerateOptions { scene: &home(), families: &Family::ALL, count: 4, seed });
    made.tasks.into_iter().map(Arc::new).collect()
}

/// One task of each family, played and recorded.
pub fn play(folder: &Path, name: &str, images: Images) -> Vec<PathBuf> {
    fs::create_dir_all(folder).unwrap();
    let play = |(index, task): (usize, &Arc<Task>)| {
        let path = folder.join(format!("{name}-{index}.mcap"));
        record(&path, task, name, 3, images);
        path
    };
    tasks(7).iter().enumerate().map(play).collect()
}

fn record(path: &Path, task: &Arc<Task>, name: &str, seed: u64, images: Images) {
    let scene = Arc::new(home());
    let mut policy = policy(name, task, &scene, seed).unwrap();
    let config = EpisodeConfig {
        task: task.clone(),
        scene,
        seed,
        profile: Profile::Paper,
        preset: Preset::paper(),
        run_id: "test".into(),
        policy: PolicyInfo { name: name.into(), ..PolicyInfo::default() },
        parent: None,
    };
    run_episode(config, policy.as_mut(), Some(&RecordTo { path: path.to_owned(), options: images.into() })).unwrap();
}

/// Traces that must not be trained on.
pub struct Played {
    /// Its chain holds, but it is not what the simulator gives.
    pub diverging: PathBuf,
    /// To be changed.
    pub changed: PathBuf,
    /// To be removed.
    pub gone: PathBuf,
}

impl Played {
    /// Three more episodes, of which one was forged.
    pub fn spoilt(folder: &Path) -> Self {
        let path = |name: &str| folder.join(format!("{name}.mcap"));
        let [diverging, changed, gone] = [path("diverging"), path("changed"), path("gone")];
        let task = &tasks(7)[0];
        for (seed, path) in [(11, &changed), (12, &gone), (13, &diverging)] {
            record(path, task, "oracle", seed, Images::None);
        }
        let mut trace = Trace::read(&diverging).unwrap();
        trace.steps[1].outcome.text.push_str(" And more.");
        relink(&mut trace);
        write(&diverging, &trace);
        Self { diverging, changed, gone }
    }
}

/// Makes the chain of a changed trace hold again, and the end fit it.
fn relink(trace: &mut Trace) {
    let mut link = trace.start.digests.chain;
    for step in &mut trace.steps {
        step.digests.chain = chain::step_link(&link, step);
        link = step.digests.chain;
    }
    let end = trace.end.as_mut().unwrap();
    (end.chain, end.steps) = (link, trace.steps.len() as u32);
}

/// Writes a trace with the real recorder: checksums and chain are right.
fn write(path: &Path, trace: &Trace) {
    fs::remove_file(path).unwrap();
    let mut recorder = Recorder::create(path, &trace.header, &trace.task, &trace.scene, Images::None).unwrap();
    recorder.start(&trace.start, None).unwrap();
    for step in &trace.steps {
        recorder.input(step.step, &step.input).unwrap();
        recorder.step(step, None).unwrap();
    }
    recorder.end(trace.end.as_ref().unwrap()).unwrap();
}
