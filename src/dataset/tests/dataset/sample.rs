//! A small episode for the tests.

use std::sync::Arc;

use reel_dataset::{
    Episode, ImageId, ImageStore, PrivilegedFacts, PublicReceptacle, Source, Split, Step,
    TaskBriefing,
};
use reel_world::{Digest, NameSet, ToolSpec};
use serde_json::{Value, json};

/// An episode of six decisions with a failed call in it.
pub fn episode(id: &str, split: Split) -> Episode {
    #[rustfmt::skip]
    let calls = [
        ("nav_to", json!({"receptacle_name": "shelf_1"}), "Arrived at shelf_1."),
        (
            "show_object_by_category",
            json!({"target_category": "vase"}),
            "Found 2 object(s) matching 'vase': marker 1, marker 2.",
        ),
        ("pick", json!({"marker_id": 7}), "Marker ID 7 not found in the marker map."),
        (
            "pick",
            json!({"marker_id": 2}),
            "Picked up the object with marker 2.\nDebug Info:\n{\"CURRENT_POS\": [1.0, 2.0]}",
        ),
        (
            "ask",
            json!({"question": "To which \"table\"?\n"}),
            "The one at the window \\ the glass one.",
        ),
        ("finish", Value::Null, "Episode finished."),
    ];
    let step = |(at, (tool, arguments, outcome)): (usize, (&str, Value, &str))| Step {
        call: at as u32,
        tool: tool.into(),
        call_name: ToolSpec::by_name(tool).unwrap().name(NameSet::Paper).into(),
        arguments,
        outcome: outcome.into(),
        error: (at == 2).then(|| "severe: unknown marker".into()),
        reasoning: if at == 5 {
            String::new()
        } else {
            format!("I think {at} times.")
        },
        history: format!("I did {at} things."),
        schedule: "Bring it.".into(),
        subtask: "Find \"it\".".into(),
        answer: None,
        message: String::new(),
        held: None,
        images: if at == 0 {
            Vec::new()
        } else {
            vec![image(id, at / 2)]
        },
        learn: true,
        rollout: None,
    };
    Episode {
        episode_id: id.into(),
        task_id: format!("FDP/{id}"),
        family: "FDP".into(),
        scene_id: "home".into(),
        policy: "oracle".into(),
        split,
        briefing: told(
            "Bring the vase to the \"glass\" table.",
            "living room/0",
            PrivilegedFacts::none(),
        ),
        names: NameSet::Paper,
        agent: None,
        steps: calls.into_iter().enumerate().map(step).collect(),
        source: Source {
            trace_digest: "d".repeat(64),
            trace_uri: format!("traces/{id}.mcap"),
            verdict: "exact".into(),
            verdict_sim_version: "2".into(),
            preset: "paper".into(),
            preset_digest: "e".repeat(64),
            rules_version: String::new(),
            table_version: 12,
            annotator: "rules-1".into(),
        },
    }
}

/// What its agent was told, with the room of its second receptacle.
pub fn told(instruction: &str, room: &str, secrets: PrivilegedFacts) -> Arc<TaskBriefing> {
    let receptacle = |id: &str, category: &str, room: &str| PublicReceptacle {
        id: id.into(),
        category: category.into(),
        room: room.into(),
    };
    let receptacles = vec![
        receptacle("shelf_1", "shelf", "living room/0"),
        receptacle("table_2", "table", room),
    ];
    Arc::new(TaskBriefing::new(instruction, receptacles, secrets))
}

fn image(id: &str, at: usize) -> ImageId {
    Digest::of(format!("{id} {at}").as_bytes())
}

/// Puts the images of an episode.
pub fn put_frames(episode: &Episode, frames: &ImageStore) {
    for (at, image) in episode
        .steps
        .iter()
        .flat_map(|step| &step.images)
        .enumerate()
    {
        let rgb: Vec<u8> = (0..640 * 480 * 3)
            .map(|i| (i / 7 + at * 40 + usize::from(image.0[0])) as u8)
            .collect();
        frames.put(*image, &rgb, 640, 480).unwrap();
    }
}
