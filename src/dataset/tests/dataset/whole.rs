//! A whole dataset: same inputs, same bytes; the manifest and the card say what is in it; and how
//! fast rows are made.

use std::{collections::BTreeMap, fs, path::Path, time::Instant};

use reel_dataset::{
    DatasetWriter, Description, ExampleOptions, Format, ImageOptions, ImageStore, MANIFEST,
    Manifest, PrivilegedFacts, Rollout, Split, Style, WriterOptions, examples, files,
};
use reel_world::{Digest, TokenLogprobs};
use serde_json::{Value, json};

use crate::sample::{episode, put_frames, told};

/// Writes a small dataset with two parts.
pub fn write(root: &Path, format: Format, style: Style) -> Manifest {
    let options = WriterOptions {
        rows_max: 4,
        ..WriterOptions::new(format)
    };
    let mut writer = DatasetWriter::new(root, options);
    for (id, split) in [
        ("e1", Split::Train),
        ("e2", Split::Train),
        ("e3", Split::Validation),
    ] {
        let mut episode = episode(id, split);
        episode.briefing = told(
            &format!("Bring the vase of {id}."),
            "hall/0",
            PrivilegedFacts::none(),
        );
        episode.steps.retain(|step| step.error.is_none());
        put_frames(&episode, writer.images());
        let made = examples(
            &episode,
            &ExampleOptions {
                style,
                failed_calls: false,
            },
        )
        .examples;
        let prepared = writer.prepare(&made).unwrap();
        writer.push(&made, &prepared).unwrap();
    }
    writer.count_skipped("the trace does not replay", 1);
    let description = Description {
        prompt: reel_prompt::Prompt::builtin(),
        name: "sample".into(),
        style,
        command: "reel export sft".into(),
        options: json!({"seed": 1}),
        table_version: 12,
        licence: "MIT".into(),
    };
    writer.finish(description).unwrap()
}

#[test]
fn same_inputs_same_bytes() {
    let [first, second] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let manifest = write(first.path(), Format::LlamaFactory, Style::SingleTurn);
    write(second.path(), Format::LlamaFactory, Style::SingleTurn);
    assert_eq!(files(first.path()).unwrap(), files(second.path()).unwrap());
    let read = |folder: &Path, name: &str| fs::read_to_string(folder.join(name)).unwrap();
    assert_eq!(read(first.path(), MANIFEST), read(second.path(), MANIFEST));
    assert_eq!(manifest.files, files(first.path()).unwrap());
    for file in &manifest.files {
        let bytes = fs::read(first.path().join(&file.path)).unwrap();
        assert_eq!(
            (bytes.len() as u64, Digest::of(&bytes)),
            (file.bytes, file.blake3),
            "{}",
            file.path
        );
    }
    let shards: BTreeMap<Split, Vec<u64>> = manifest
        .shards
        .iter()
        .map(|(split, shards)| (*split, shards.iter().map(|it| it.rows).collect()))
        .collect();
    assert_eq!(
        shards,
        BTreeMap::from([
            (Split::Train, vec![4, 4, 2]),
            (Split::Validation, vec![4, 1])
        ])
    );
    assert_eq!(
        (manifest.counts.examples, manifest.counts.tools["pick"]),
        (15, 3)
    );
    assert_eq!(
        manifest
            .leakage
            .iter()
            .map(|it| it.kind.as_str())
            .collect::<Vec<_>>(),
        ["scene"],
        "all play at home"
    );
    assert_eq!(manifest.tokens.as_ref().unwrap().examples, 15);
    let info: Value = serde_json::from_str(&read(first.path(), "dataset_info.json")).unwrap();
    assert_eq!(info["sample_train"]["file_name"], "train");
}

#[test]
fn the_card_says_what_is_in_it() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), Format::OpenAi, Style::MultiTurn);
    let card = fs::read_to_string(folder.path().join("README.md")).unwrap();
    let (front, text) = card
        .strip_prefix("---\n")
        .unwrap()
        .split_once("\n---\n")
        .unwrap();
    assert!(front.contains("license: \"mit\"") && front.contains("path: \"train/*.jsonl\""));
    for part in [
        "| train | 2 |",
        "| FDP | 3 |",
        "reel export sft",
        "version 12 of the tables",
        "| the trace does not replay | 1 |",
        "`MIT`",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn rollouts_carry_what_decisions_were_worth() {
    let folder = tempfile::tempdir().unwrap();
    let frames = ImageStore::new(folder.path(), ImageOptions::default());
    let mut episode = episode("e1", Split::Train);
    put_frames(&episode, &frames);
    let steps = episode.steps.len() as u32;
    for step in &mut episode.steps {
        let worth = Rollout {
            group: "g".into(),
            group_size: 8,
            rollout: 5,
            seed: 3,
            step: step.call,
            steps,
            reward: -0.03,
            episode_return: 7.5,
            advantage: 1.25,
            success: true,
            logprobs: Some(
                TokenLogprobs::sampled(vec!["{".into(), "}".into()], vec![-0.5, -0.25]).unwrap(),
            ),
        };
        step.rollout = Some(worth);
    }
    let made = examples(
        &episode,
        &ExampleOptions {
            style: Style::SingleTurn,
            failed_calls: true,
        },
    );
    for (format, answers) in [(Format::Trl, "completion"), (Format::MsSwift, "messages")] {
        let mut row = Vec::new();
        format
            .write_row(&made.examples[2], &frames, &mut row)
            .unwrap();
        let row: Value = serde_json::from_slice(&row).unwrap();
        assert_eq!(
            (&row["return"], &row["advantage"], &row["reward"]),
            (&json!(7.5), &json!(1.25), &json!(-0.03))
        );
        assert_eq!(
            (&row["tokens"], &row["logprobs"]),
            (&json!(["{", "}"]), &json!({"old": [-0.5, -0.25]}))
        );
        assert_eq!(
            (&row["group"], &row["step"], &row["rollout"]),
            (&json!("g"), &json!(2), &json!(5))
        );
        assert!(!row[answers].as_array().unwrap().is_empty());
        assert_eq!(row["provenance"]["call"], 2);
    }
}

/// Prints a speed; asserts none.
#[test]
fn speed() {
    let folder = tempfile::tempdir().unwrap();
    let frames = ImageStore::new(folder.path(), ImageOptions::default());
    let mut episode = episode("e1", Split::Train);
    let steps = episode.steps.clone();
    episode.steps = steps
        .into_iter()
        .cycle()
        .take(30)
        .zip(0..)
        .map(|(step, call)| reel_dataset::Step {
            call,
            images: Vec::new(),
            ..step
        })
        .collect();
    let begin = Instant::now();
    let (mut count, mut bytes) = (0, 0);
    while count < 6_000 {
        let made = examples(
            &episode,
            &ExampleOptions {
                style: Style::SingleTurn,
                failed_calls: true,
            },
        );
        let mut rows = Vec::new();
        for example in &made.examples {
            Format::MsSwift
                .write_row(example, &frames, &mut rows)
                .unwrap();
        }
        count += made.examples.len();
        bytes += rows.len();
    }
    let s = begin.elapsed().as_secs_f64();
    eprintln!(
        "speed: {:.0} examples/s, {:.0} MB/s without images",
        count as f64 / s,
        bytes as f64 / s / 1e6
    );
    assert!(bytes > count * 1_000);
}

#[test]
fn threads_may_put_the_same_image() {
    let folder = tempfile::tempdir().unwrap();
    let frames = ImageStore::new(folder.path(), ImageOptions::default());
    let grey = vec![9; 640 * 480 * 3];
    let put = || frames.put(Digest::of(&grey), &grey, 640, 480).unwrap();
    let put_all: Vec<_> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..8).map(|_| scope.spawn(put)).collect();
        threads
            .into_iter()
            .map(|thread| thread.join().unwrap())
            .collect()
    });
    assert!(put_all.iter().all(|frame| *frame == put_all[0]));
    assert_eq!(files(folder.path()).unwrap().len(), 1);
}
