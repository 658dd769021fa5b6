//! The short subset of the determinism checks: an episode in another thread and
//! restored before each call, and scenes made to fail against digests written here, so
//! that a platform or a build that computes otherwise fails `make test`. The whole of
//! it: tests/determinism.sh and tests/determinism-cross.sh.

mod impossible;

use std::sync::Arc;

use reel_episode::{Episode, EpisodeConfig};
use reel_reward::Preset;
use reel_sim::{Snapshot, stress::Stress};
use reel_tasks::{DrawOptions, draw, home_scene};
use reel_world::{
    Digest, Family, Profile, Scene, Skills, Task, ToolCall,
    record::{PolicyInfo, StepInput},
};
use serde_json::json;

/// The digests of so many steps of 1/240 s. They change with the engine and with [`Stress`],
/// and with nothing else.
const STRESS_STEPS: u32 = 100;
#[rustfmt::skip]
const STRESS: [(Stress, &str); 3] = [
    (Stress::Compounds, "a43a1d9ec45fe1b19e43059f58f3de3b682d22c1f9d416ec94655c932491ab3d"),
    (Stress::Limits, "52c848a25abe7a12f735d475346fe5a5bb71c98cfbc24afe7136ee4f7b41e17a"),
    (Stress::Crowd, "ffb4643cee1a559736afb306835e224809dc5583ceb5e7229c033d7ecb9d3e24"),
];

#[test]
fn scenes_made_to_fail_have_the_digests_written_here() {
    let found = STRESS.map(|(scene, _)| (scene, scene.run(STRESS_STEPS, None).to_string()));
    assert_eq!(
        found,
        STRESS.map(|(scene, digest)| (scene, digest.to_owned())),
        "this build computes otherwise"
    );
}

#[test]
fn restored_before_each_call_and_in_another_thread_an_episode_is_the_same() {
    let (straight, succeeded) = play(false);
    assert_eq!(succeeded, calls().len(), "a call that fails moves nothing");
    assert_eq!(play(true).0, straight, "restored before each call");
    #[expect(
        clippy::disallowed_methods,
        reason = "the check is that a thread changes nothing"
    )]
    let threads = [false, true].map(|restored| std::thread::spawn(move || play(restored).0));
    for thread in threads {
        assert_eq!(
            thread.join().expect("a thread ends"),
            straight,
            "in another thread"
        );
    }
}

/// A task in the home that comes with Reel.
fn home() -> (Scene, Task) {
    let scene = home_scene();
    let options = DrawOptions {
        scene: &scene,
        families: &[Family::FDO],
        count: 1,
        seed: 7,
    };
    let task = draw(&options).tasks.remove(0);
    (scene, task)
}

/// A digest of the records of an episode in the home, and how many of its calls succeeded.
fn play(restored: bool) -> (Digest, usize) {
    let (scene, task) = home();
    let config = EpisodeConfig {
        task: Arc::new(task),
        scene: Arc::new(scene),
        seed: 3,
        profile: Profile::Paper,
        skills: Skills::Perfect,
        meshes: reel_world::Meshes::default(),
        preset: Preset::paper(),
        run_id: "test".into(),
        policy: PolicyInfo::default(),
        rollout: None,
        parent: None,
    };
    let (mut episode, start, _) =
        Episode::start(config.clone()).expect("task and scene belong together");
    let mut steps = Vec::new();
    for call in calls() {
        if restored {
            let snapshot = Snapshot::from_bytes(&episode.snapshot().to_bytes())
                .expect("what was written can be read");
            episode = Episode::resume(config.clone(), start.clone(), steps.clone(), &snapshot)
                .expect("it is of this moment");
        }
        let input = StepInput::from_call(call);
        steps.push(episode.step(input).record);
    }
    let succeeded = steps
        .iter()
        .filter(|step| step.outcome.error.is_none())
        .count();
    let records = Digest::of_json(&(start, steps, episode.end()));
    (records, succeeded)
}

/// Opens the refrigerator, carries a teddy bear into it and closes it.
fn calls() -> Vec<ToolCall> {
    let to = |receptacle: &str| ToolCall::new("nav_to", json!({ "receptacle_name": receptacle }));
    let marked = |name: &str| ToolCall::new(name, json!({ "marker_id": 1 }));
    vec![
        to("refrigerator_1"),
        ToolCall::new("show_receptacles", json!({})),
        marked("open"),
        to("counter_1"),
        ToolCall::new(
            "show_object_by_category",
            json!({ "target_category": "teddy bear" }),
        ),
        marked("gaze_at"),
        marked("pick"),
        to("refrigerator_1"),
        ToolCall::new("show_receptacles", json!({})),
        marked("place"),
        marked("close"),
        ToolCall::new("finish", json!({})),
    ]
}
