//! Questions in the plans of tasks by the command: annotated, gone on with, played and replayed;
//! proposals of a model.

use std::{fs, path::Path};

use serde_json::Value;

use super::expect;

fn annotated(folder: &Path, more: &[&str]) -> Value {
    let arguments = ["task", "annotate", "made", "--out", "social", "--json"];
    serde_json::from_str(&expect(folder, 0, &[&arguments, more].concat())).unwrap()
}

fn files(folder: &Path) -> Vec<(String, String)> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path
                .extension()
                .is_some_and(|extension| extension == "yaml")
            {
                found.push((
                    path.display().to_string(),
                    fs::read_to_string(path).unwrap(),
                ));
            }
        }
    }
    found.sort();
    found
}

#[test]
fn annotated_tasks_are_played_and_replayed_and_a_broken_off_run_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(
        folder,
        "task generate --scene S3 --count 16 --seed 1 --out made"
    );
    let first = annotated(folder, &[]);
    let count = first["annotated"].as_u64().unwrap();
    assert!(count >= 10 && first["unchanged"] == 0, "{first}");
    let before = files(&folder.join("social"));
    assert_eq!(before.len() as u64, count);

    fs::remove_file(&before[0].0).unwrap();
    fs::write(&before[1].0, &before[1].1[..100]).unwrap();
    let again = annotated(folder, &["--jobs", "1"]);
    assert_eq!(
        (again["annotated"].as_u64(), again["unchanged"].as_u64()),
        (Some(count), Some(count - 2)),
        "{again}"
    );
    assert_eq!(files(&folder.join("social")), before);
    assert_eq!(
        annotated(folder, &["--seed", "2"])["unchanged"],
        0,
        "other options make other tasks"
    );
    annotated(folder, &[]);

    reel!(
        folder,
        "run --tasks social/S3 --scene social/S3.json --no-images --out traces"
    );
    reel!(folder, "replay traces");
    expect(folder, 2, "task annotate made --out social --strategies C");
}

#[cfg(feature = "service")]
#[test]
fn a_models_proposal_stands_where_nothing_is_against_it() {
    use reel_tasks::generate::social::{AnnotateOptions, Strategy, annotate};

    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(
        folder,
        "task generate --scene S3 --count 8 --seed 1 --out made"
    );
    let scene = reel_tasks::generate::scene::built_in("S3").unwrap();
    let tasks = reel_tasks::load(&folder.join("made/S3"), &scene).tasks;
    let options = AnnotateOptions {
        strategies: &Strategy::ALL,
        seed: 77,
    };
    let (task, wanted) = tasks
        .iter()
        .find_map(|task| Some((task, annotate(task, &scene, &options).ok()?)))
        .unwrap();
    let proposal = serde_json::json!({ "instruction": wanted.task.instruction, "actions": wanted.annotations });

    let url = super::endpoint::endpoint(&format!("It is vague.</think>```json\n{proposal}\n```"));
    let said = annotated(folder, &["--endpoint", &url, "--model", "scripted"]);
    let fallbacks: u64 = said["fallbacks"]
        .as_object()
        .unwrap()
        .values()
        .map(|count| count.as_u64().unwrap())
        .sum();
    assert_eq!(fallbacks + 1, said["annotated"].as_u64().unwrap(), "{said}");
    let again = reel_tasks::load(&folder.join("social/S3"), &scene).tasks;
    let done = again
        .iter()
        .find(|again| again.task_id == task.task_id)
        .unwrap();
    assert_eq!(
        (&done.instruction, &done.plan),
        (&wanted.task.instruction, &wanted.task.plan)
    );
    assert!(
        done.extra["episodes[0].social"]["author"]
            .as_str()
            .unwrap()
            .starts_with("scripted by prompt")
    );
    // Nobody is asked a second time, and nobody has to be there.
    let kept = annotated(
        folder,
        &["--endpoint", "http://127.0.0.1:9/v1", "--model", "scripted"],
    );
    assert_eq!(kept["unchanged"], said["annotated"]);
}

/// A scripted model answers every request with a dialogue of strategy A for one task; the requests
/// come out of the channel.
#[cfg(feature = "service")]
fn dialogue_endpoint(answer: String) -> (String, std::sync::mpsc::Receiver<Value>) {
    let (sender, requests) = std::sync::mpsc::channel();
    let url = super::endpoint::answering(move |request| {
        sender.send(request).unwrap();
        super::endpoint::completion(&answer)
    });
    (url, requests)
}

#[cfg(all(feature = "service", feature = "analytics"))]
#[test]
fn a_models_dialogue_with_the_floor_plan_is_played_and_every_turn_is_shown() {
    use reel_tasks::generate::{
        scene::{Plan, built_in},
        social::{AnnotateOptions, Strategy, annotate},
    };

    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(
        folder,
        "task generate --scene S3 --count 12 --seed 1 --out made"
    );
    let scene = built_in("S3").unwrap();
    let options = AnnotateOptions {
        strategies: &[Strategy::A],
        seed: 5,
    };
    let tasks = reel_tasks::load(&folder.join("made/S3"), &scene).tasks;
    let (task, wanted) = tasks
        .iter()
        .filter_map(|task| Some((task, annotate(task, &scene, &options).ok()?)))
        .find(|(_, wanted)| wanted.annotations.len() == 3)
        .expect("a dialogue of two turns and a question in view");
    let answer = serde_json::json!({ "instruction": wanted.task.instruction, "actions": wanted.annotations });
    let (url, requests) = dialogue_endpoint(answer.to_string());
    annotated(folder, &["--endpoint", &url, "--model", "scripted"]);

    // The model saw the floor plan, and the file says which.
    let png = Plan::of(&scene).png().unwrap();
    let parts = requests.recv().unwrap()["messages"][1]["content"].clone();
    let image = parts[2]["image_url"]["url"].as_str().unwrap();
    let sent = image.strip_prefix("data:image/png;base64,").unwrap();
    use base64::Engine as _;
    let engine = base64::engine::general_purpose::STANDARD;
    assert_eq!(engine.decode(sent).unwrap(), png);
    let reread = reel_tasks::load(&folder.join("social/S3"), &scene).tasks;
    let done = reread
        .iter()
        .find(|done| done.task_id == task.task_id)
        .unwrap();
    assert_eq!(done.plan, wanted.task.plan);
    let social = &done.extra["episodes[0].social"];
    let digest = reel_world::Digest::of(&png);
    assert_eq!(social["image"]["digest"], serde_json::json!(digest));
    let by_rules = reread
        .iter()
        .find(|done| done.extra["episodes[0].social"]["author"] == "rules");
    let by_rules = &by_rules.unwrap().extra["episodes[0].social"];
    assert!(by_rules.get("image").is_none(), "{by_rules}");

    // A model of text alone gets text alone, and the tasks are annotated anew.
    let (url, requests) = dialogue_endpoint(answer.to_string());
    let anew = annotated(
        folder,
        &["--endpoint", &url, "--model", "scripted", "--no-image"],
    );
    assert_eq!(anew["unchanged"], 0, "{anew}");
    assert!(requests.recv().unwrap()["messages"][1]["content"].is_string());

    // Each turn is a step: in the trace, the transcript and the tables.
    let file = format!("social/S3/{}.yaml", task.task_id);
    reel!(
        folder,
        "run --tasks {file} --scene social/S3.json --no-images --out traces"
    );
    reel!(folder, "replay traces");
    let name = fs::read_dir(folder.join("traces")).unwrap().next().unwrap();
    let shown = expect(folder, 0, &["show", name.unwrap().path().to_str().unwrap()]);
    reel!(folder, "ingest traces --store store");
    let sql = "SELECT step, question, reply FROM steps WHERE tool = 'ask' ORDER BY step";
    let told = expect(
        folder,
        0,
        &["query", sql, "--store", "store", "--format", "json"],
    );
    let turns: Vec<Value> = serde_json::from_str(&told).unwrap();
    let steps: Vec<u64> = turns
        .iter()
        .map(|turn| turn["step"].as_u64().unwrap())
        .collect();
    assert_eq!((steps.len(), &steps[..2]), (3, &[0, 1][..]), "{told}");
    for turn in turns {
        for said in [&turn["question"], &turn["reply"]] {
            assert!(shown.contains(said.as_str().unwrap()), "{said}\n{shown}");
        }
    }
}
