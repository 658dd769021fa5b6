//! Rollout groups: rewards, returns and advantages, and which episodes form a group.

use std::{collections::BTreeMap, fs};

use reel_dataset::Format;
use reel_export::{ExportOptions, RolloutOptions, Selection};
use reel_tables::Store;
use reel_trace::Images;
use serde_json::Value;
use tempfile::TempDir;

use crate::{
    episodes::{record_seeded, tasks},
    export, options, rows,
};

#[test]
fn rollouts_are_worth_what_they_are_better_than_their_group() {
    let dir = TempDir::new().unwrap();
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    let folder = dir.path().join("traces");
    fs::create_dir_all(&folder).unwrap();
    let mut paths = Vec::new();
    for (task, count) in [(0, 3), (1, 1)] {
        for seed in 0..count {
            let path = folder.join(format!("{task}-{seed}.mcap"));
            paths.push(record_seeded(
                &path,
                &tasks()[task],
                "explorer",
                seed,
                Images::None,
            ));
        }
    }
    store.ingest(&paths, &|_, _| ()).unwrap();
    let rl = |name: &str, rollouts: RolloutOptions| {
        let selection = Selection {
            failed: true,
            mistakes: true,
            after_decisive: true,
            contradictions: true,
            ..Selection::default()
        };
        let how = ExportOptions {
            selection,
            rollouts: Some(rollouts),
            ..options(Format::Trl)
        };
        export(&store, &dir.path().join(name), &how)
    };
    let report = rl("all", RolloutOptions::default());
    let rows = rows(&dir.path().join("all"), "train");
    assert_eq!(
        (report.episodes, &report.excluded),
        (
            3,
            &BTreeMap::from([("episodes of groups with too few rollouts", 1)])
        )
    );
    let task: Vec<String> =
        serde_json::from_slice(&fs::read(dir.path().join("all/tasks.json")).unwrap()).unwrap();
    assert_eq!(task, [rows[0]["provenance"]["task"].as_str().unwrap()]);
    // rewards, returns and advantages by hand
    let mut episodes: BTreeMap<&str, Vec<&Value>> = BTreeMap::new();
    rows.iter().for_each(|row| {
        episodes
            .entry(row["provenance"]["episode"].as_str().unwrap())
            .or_default()
            .push(row)
    });
    let number = |row: &Value, key: &str| row[key].as_f64().unwrap();
    let returns: Vec<f64> = episodes
        .values()
        .map(|rows| {
            rows.iter()
                .map(|row| number(row, "reward") * 0.99_f64.powi(number(row, "step") as i32))
                .sum()
        })
        .collect();
    let mean = returns.iter().sum::<f64>() / 3.0;
    let deviation = (returns
        .iter()
        .map(|it| (it - mean) * (it - mean))
        .sum::<f64>()
        / 3.0)
        .sqrt();
    assert!(deviation > 0.1, "{returns:?}");
    for ((rows, worth), rollout) in episodes.values().zip(&returns).zip(0..) {
        for row in rows {
            assert_eq!(
                (row["group_size"].as_u64(), row["rollout"].as_u64()),
                (Some(3), Some(rollout))
            );
            assert_eq!(row["steps"].as_u64().unwrap() as usize, rows.len());
            assert!((number(row, "return") - worth).abs() < 1e-9, "{row}");
            assert!(
                (number(row, "advantage") - (worth - mean) / (deviation + 1e-6)).abs() < 1e-9,
                "{row}"
            );
        }
    }
    let report = rl(
        "two",
        RolloutOptions {
            group_size: Some(2),
            ..RolloutOptions::default()
        },
    );
    assert_eq!(
        (
            report.episodes,
            report.excluded["episodes beyond the size of their group"]
        ),
        (2, 1)
    );
    let report = rl(
        "seeds",
        RolloutOptions {
            same_seed: true,
            ..RolloutOptions::default()
        },
    );
    assert_eq!(report.episodes, 0, "no two have the same seed");
}
