//! A model annotates with the images that the agent saw, which a lean trace gets by replay.

use std::{
    fs,
    sync::{Arc, Mutex},
};

use serde_json::{Value, json};

use crate::{
    endpoint::{answering, completion},
    expect,
};

#[test]
fn a_model_that_annotates_sees_what_the_agent_saw() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 1 --seed 35 --out tasks");
    reel!(folder, "run --tasks tasks --no-images --out traces");
    let images = Arc::new(Mutex::new(Vec::new()));
    let seen = Arc::clone(&images);
    let url = answering(move |request| {
        let parts = &request["messages"][1]["content"];
        let image = parts[2]["image_url"]["url"].as_str();
        seen.lock().unwrap().push(image.map(str::to_owned));
        let text = parts.as_str().or(parts[0]["text"].as_str()).unwrap();
        let (_, step) = text.rsplit_once("notes of steps ").unwrap();
        let step: usize = step.split(' ').next().unwrap().parse().unwrap();
        let note = json!([{"step": step, "reasoning": "I go on.", "history": "I have begun.", "schedule": "Go on.", "subtask": "Go on."}]);
        completion(&note.to_string())
    });
    let arguments = [
        "dataset",
        "annotate",
        "traces",
        "--endpoint",
        &url,
        "--model",
        "writer",
        "--frames",
        "--decisions-per-request",
        "1",
    ];
    expect(folder, 0, &arguments);
    let images = images.lock().unwrap();
    let mut files = fs::read_dir(folder.join("traces")).unwrap();
    let notes = files.find_map(|file| {
        let path = file.unwrap().path();
        path.to_string_lossy()
            .ends_with(".notes.jsonl")
            .then_some(path)
    });
    let notes = fs::read_to_string(notes.unwrap()).unwrap();
    let first: Value = serde_json::from_str(notes.lines().next().unwrap()).unwrap();
    assert_eq!(first["request"], json!({"decisions": 1, "frames": true}));
    assert_eq!(images.len() as u64, first["steps"].as_u64().unwrap());
    let shown: Vec<&String> = images.iter().flatten().collect();
    assert!(
        shown.len() > 4
            && shown
                .iter()
                .all(|url| url.starts_with("data:image/png;base64,iVBOR"))
    );
    assert!(
        shown.windows(2).any(|pair| pair[0] != pair[1]),
        "not always the same"
    );
    assert!(reel!(folder, "replay traces").contains("exact"));
}
