//! Prints one digest for each episode it reads and for each scene made to fail: what the
//! determinism checks compare between builds, CPUs and C libraries. Builds without files, clocks,
//! threads or C code, for wasm32 too.
//!
//! Episodes come on standard input, one JSON document a line, as `reel show
//! --json` prints them. Arguments:
//!
//! - `--restored`: each call is executed by an episode restored from bytes, and the scenes are
//!   restored as they move;
//! - `--workers N`: N threads play the episodes, and all of them play every episode;
//! - `--reversed`: last episode first;
//! - `--recorded`: executes nothing and prints what the traces say, in their order.

use std::{
    collections::BTreeMap,
    io::{self, BufRead},
    sync::Arc,
};

use reel_episode::{Episode, EpisodeConfig, Rollout};
use reel_reward::Preset;
use reel_sim::{Snapshot, stress::Stress};
use reel_world::{
    Digest, Scene, Skills, Task,
    record::{EndRecord, EpisodeHeader, StartRecord, StepRecord},
};
use serde::Deserialize;

/// One second of motion: what differs in a scene made to fail differs early.
const STRESS_STEPS: u32 = 240;

/// A recorded episode, as `reel show --json` prints it.
#[derive(Clone, Deserialize)]
struct Recorded {
    header: EpisodeHeader,
    task: Arc<Task>,
    scene: Arc<Scene>,
    start: StartRecord,
    steps: Vec<StepRecord>,
    end: Option<EndRecord>,
}

/// How episodes are played.
#[derive(Clone, Copy)]
struct Condition {
    restored: bool,
    workers: usize,
    reversed: bool,
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let has = |flag: &str| arguments.iter().any(|argument| argument == flag);
    let after = |flag: &str| {
        arguments
            .iter()
            .position(|argument| argument == flag)
            .and_then(|at| arguments.get(at + 1))
    };
    let workers = after("--workers").map_or(1, |count| {
        count.parse().expect("--workers takes a whole number")
    });
    let condition = Condition {
        restored: has("--restored"),
        workers,
        reversed: has("--reversed"),
    };
    let lines = io::stdin()
        .lock()
        .lines()
        .map(|line| line.expect("standard input can be read"));
    let mut episodes: Vec<Recorded> = lines
        .map(|line| {
            serde_json::from_str(&line)
                .expect("each line is a trace as `reel show --json` prints it")
        })
        .collect();
    if has("--recorded") {
        for episode in &episodes {
            let end = episode
                .end
                .as_ref()
                .expect("the trace of a finished episode");
            let digest = digest(&episode.start, &episode.steps, end);
            println!("{} {digest}", episode.header.episode_id);
        }
        return;
    }
    if condition.reversed {
        episodes.reverse();
    }
    for (name, digest) in play_all(episodes, condition) {
        println!("{name} {digest}");
    }
    for scene in Stress::ALL {
        println!(
            "{} {}",
            scene.name(),
            scene.run(STRESS_STEPS, condition.restored.then_some(5))
        );
    }
}

/// Digests by episode; every worker has to find the same.
fn play_all(episodes: Vec<Recorded>, condition: Condition) -> BTreeMap<String, Digest> {
    let all = move |episodes: Vec<Recorded>| -> BTreeMap<String, Digest> {
        episodes
            .iter()
            .map(|episode| {
                (
                    episode.header.episode_id.clone(),
                    play(episode, condition.restored),
                )
            })
            .collect()
    };
    if condition.workers == 1 {
        return all(episodes);
    }
    #[expect(
        clippy::disallowed_methods,
        reason = "the check is that threads change nothing"
    )]
    let workers: Vec<_> = (0..condition.workers)
        .map(|worker| {
            let mut episodes = episodes.clone();
            let at = worker % episodes.len().max(1);
            episodes.rotate_left(at);
            std::thread::spawn(move || all(episodes))
        })
        .collect();
    let mut found = workers
        .into_iter()
        .map(|worker| worker.join().expect("a worker ends"));
    let first = found.next().expect("there is a worker");
    assert!(
        found.all(|other| other == first),
        "two threads found different digests"
    );
    first
}

/// Of every record of an episode: inputs, texts, rewards, and the digests of states and images.
fn digest(start: &StartRecord, steps: &[StepRecord], end: &EndRecord) -> Digest {
    Digest::of_json(&(start, steps, end))
}

fn play(recorded: &Recorded, restored: bool) -> Digest {
    let header = &recorded.header;
    let config = EpisodeConfig {
        task: recorded.task.clone(),
        scene: recorded.scene.clone(),
        seed: header.seed,
        profile: header.profile,
        skills: Skills::Perfect,
        meshes: reel_world::Meshes::default(),
        preset: Preset::parse(&header.reward_preset).expect("a known preset"),
        run_id: header.run_id.clone(),
        policy: header.policy.clone(),
        rollout: Rollout::of(header),
        parent: header.parent.clone(),
    };
    let (mut episode, start, _) =
        Episode::start(config.clone()).expect("task and scene belong together");
    let mut steps = Vec::new();
    for step in &recorded.steps {
        if restored {
            let snapshot = Snapshot::from_bytes(&episode.snapshot().to_bytes())
                .expect("what was written can be read");
            episode = Episode::resume(config.clone(), start.clone(), steps.clone(), &snapshot)
                .expect("it is of this moment");
        }
        steps.push(episode.step(step.input.clone()).record);
    }
    digest(&start, &steps, &episode.end())
}
