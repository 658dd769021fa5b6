//! What our own exporter writes is read back as it was meant, and nothing is wrong with it.

use std::path::Path;

use reel_dataset::lint::{LintOptions, Part, lint};
use reel_dataset::{
    DatasetError, Episode, ExampleOptions, Format, ImageOptions, ImageStore, PrivilegedFacts,
    PublicReceptacle, Shards, Source, Split, Step, Style, TaskBriefing, examples,
};
use reel_world::{Digest, NameSet};
use serde_json::{Value, json};

use super::{Folder, of, open};

fn episode(id: &str) -> Episode {
    let calls = [
        (
            "nav_to",
            json!({ "receptacle_name": "shelf_1" }),
            "Arrived at shelf_1.",
            "Nothing has been done yet.",
        ),
        (
            "show_object_by_category",
            json!({ "target_category": "vase" }),
            "Found 1 object(s) matching 'vase': marker 1.",
            "I went to shelf_1.",
        ),
        (
            "pick",
            json!({ "marker_id": 1 }),
            "Picked up the object with marker 1.",
            "I went to shelf_1. I looked for vases.",
        ),
        (
            "finish",
            Value::Null,
            "Episode finished.",
            "I went to shelf_1. I looked for vases. I picked up the vase.",
        ),
    ];
    let step =
        |(at, (tool, arguments, outcome, history)): (usize, (&str, Value, &str, &str))| Step {
            call: at as u32,
            tool: tool.into(),
            call_name: tool.into(),
            arguments,
            outcome: outcome.into(),
            reasoning: format!("This is thought {at} of {id}."),
            history: history.into(),
            subtask: "bring it".into(),
            images: vec![Digest::of(format!("{id} {at}").as_bytes())],
            learn: true,
            ..Step::default()
        };
    let shelf = PublicReceptacle {
        id: "shelf_1".into(),
        category: "shelf".into(),
        room: "hall/0".into(),
    };
    Episode {
        episode_id: id.into(),
        task_id: format!("FDP/{id}"),
        family: "FDP".into(),
        scene_id: "home".into(),
        policy: "oracle".into(),
        split: Split::Train,
        briefing: TaskBriefing::new(
            format!("Bring the vase of {id}."),
            vec![shelf],
            PrivilegedFacts::none(),
        )
        .into(),
        names: NameSet::Paper,
        agent: None,
        steps: calls.into_iter().enumerate().map(step).collect(),
        source: Source::default(),
    }
}

/// Writes two episodes in a format and style; the number of rows.
fn write(root: &Path, format: Format, style: Style) -> u64 {
    let frames = ImageStore::new(root, ImageOptions::default());
    let mut shards = Shards::new(root, format, Split::Train, 3);
    let mut rows = 0;
    for episode in ["e1", "e2"].map(episode) {
        for (at, image) in episode
            .steps
            .iter()
            .flat_map(|step| &step.images)
            .enumerate()
        {
            let rgb: Vec<u8> = (0..40 * 30 * 3)
                .map(|pixel| (pixel * at + usize::from(image.0[0])) as u8)
                .collect();
            frames.put(*image, &rgb, 40, 30).expect("an image");
        }
        let made = examples(
            &episode,
            &ExampleOptions {
                style,
                failed_calls: false,
            },
        );
        assert_eq!(made.refused, []);
        for example in &made.examples {
            let (mut row, mut provenance) = (Vec::new(), Vec::new());
            match format.write_row(example, &frames, &mut row) {
                Err(DatasetError::UnsupportedFormat { .. }) => continue,
                written => written.expect("a row"),
            }
            example.provenance(&mut provenance);
            shards.push(&row, &provenance).expect("a row");
            rows += 1;
        }
    }
    shards.finish().expect("written");
    if format == Format::LlamaFactory {
        let columns = json!({ "messages": "conversations", "images": "images", "system": "system", "tools": "tools" });
        let info = json!({ "train": { "file_name": "train", "formatting": "sharegpt", "columns": columns } });
        std::fs::write(root.join("dataset_info.json"), info.to_string()).expect("a file");
    }
    rows
}

#[test]
fn every_format_and_style_is_read_back_without_a_finding() {
    for format in Format::ALL
        .into_iter()
        .filter(|format| *format != Format::Parquet)
    {
        for style in Style::ALL {
            let folder = Folder::new();
            let rows = write(folder.path(), format, style);
            let dataset = open(folder.path());
            let told = format!("{} {}", format.as_str(), style.as_str());
            for example in dataset
                .rows()
                .map(|row| row.unwrap_or_else(|error| panic!("{told}: {error}")))
            {
                assert_eq!(
                    (example.format, example.split.as_deref()),
                    (format, Some("train")),
                    "{told}"
                );
                assert!(
                    example.episode().is_some_and(|it| it.starts_with('e'))
                        && example.call_number().is_some(),
                    "{told}: {:?}",
                    example.meta
                );
                let frames = example
                    .turns
                    .iter()
                    .flat_map(|turn| &turn.parts)
                    .filter(|part| matches!(part, Part::Image(_)))
                    .count();
                // REAL's first prompt of an episode holds no image.
                let bare = style == Style::SingleTurn && example.call_number() == Some(0);
                assert!(frames > 0 || bare, "{told}");
                assert_eq!(frames, example.images.len(), "{told}");
            }
            let report = lint(&dataset, &LintOptions::default(), |_| ());
            assert_eq!((report.rows, report.unreadable), (rows, 0), "{told}");
            // Two episodes that differ in two words are near-duplicates; they do
            // not call all tools.
            let expected = ["near-duplicates", "balance"];
            let wrong: Vec<_> = report
                .checks
                .iter()
                .filter(|check| check.findings > 0 && !expected.contains(&check.check))
                .collect();
            assert!(wrong.is_empty(), "{told}\n{report}");
            assert_eq!(
                of(&report, "history").applies,
                style == Style::SingleTurn,
                "{told}\n{report}"
            );
            assert_eq!(
                of(&report, "published parsers").applies,
                style == Style::SingleTurn,
                "{told}\n{report}"
            );
            assert!(of(&report, "answers").applies, "{told}\n{report}");
        }
    }
}
