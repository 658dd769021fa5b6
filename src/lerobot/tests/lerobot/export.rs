//! What is written: the same bytes from equal traces, every frame once, and nothing of a trace that does not replay.

use std::{collections::BTreeMap, fs, path::Path};

use reel_lerobot::{
    DatasetDescription, ExportSettings, LeRobotError, LeRobotWriter, encode, lint::lint,
};
use reel_replay::MotionRate;
use reel_trace::{Images, Trace};
use reel_vectors::episodes::{record, tasks};
use serde_json::{Value, json};

pub(crate) const SETTINGS: ExportSettings = ExportSettings {
    rate: None,
    marks: false,
    width: 64,
    height: 48,
    quantizer: 100,
    language: true,
    seed: 0,
};

/// Two episodes in a folder.
pub(crate) fn traces(folder: &Path) -> Vec<Trace> {
    let policies = ["oracle", "gibberish"];
    let record = |(index, policy): (usize, &str)| {
        let path = folder.join(format!("{index}.mcap"));
        Trace::read(&record(&path, &tasks()[index], policy, Images::None)).unwrap()
    };
    policies.into_iter().enumerate().map(record).collect()
}

pub(crate) fn export<'a>(
    root: &Path,
    settings: ExportSettings,
    traces: impl IntoIterator<Item = &'a Trace>,
) {
    let mut writer = LeRobotWriter::create(root, settings).unwrap();
    for trace in traces {
        writer.add(&encode(trace, &settings).unwrap()).unwrap();
    }
    let description = DatasetDescription {
        name: "household".to_owned(),
        licence: "CC-BY-4.0".to_owned(),
        command: "reel export lerobot".to_owned(),
    };
    writer.finish(&json!([]), &description).unwrap();
}

/// Every file by its path.
fn files(root: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut names = reel_dataset::files(root).unwrap();
    names.sort_by(|one, other| one.path.cmp(&other.path));
    names
        .into_iter()
        .map(|file| (file.path.clone(), fs::read(root.join(file.path)).unwrap()))
        .collect()
}

#[test]
fn equal_traces_give_equal_files_that_the_lint_accepts() {
    let folder = tempfile::tempdir().unwrap();
    let traces = traces(folder.path());
    let moving = ExportSettings {
        rate: Some(MotionRate {
            fps: 4,
            drive_m_s: 0.5,
            turn_rad_s: 1.5,
        }),
        ..SETTINGS
    };
    let mut lengths = Vec::new();
    let wordless = ExportSettings {
        language: false,
        ..SETTINGS
    };
    for (name, settings) in [
        ("decisions", SETTINGS),
        ("motion", moving),
        ("wordless", wordless),
    ] {
        let [one, other] =
            ["one", "other"].map(|part| folder.path().join(format!("{name}-{part}")));
        export(&one, settings, &traces);
        export(&other, settings, &traces);
        assert!(files(&one) == files(&other), "{name}");
        let report = lint(&one, 3, |_| ()).unwrap();
        assert!(
            report.checks.iter().all(|check| check.findings == 0),
            "{report}"
        );
        assert_eq!(report.episodes, 2);
        let card = fs::read_to_string(one.join("README.md")).unwrap();
        assert!(
            card.contains("\nlicense: \"cc-by-4.0\"\n") && card.contains("\n- LeRobot\n"),
            "{card}"
        );
        let info: Value =
            serde_json::from_slice(&fs::read(one.join("meta/info.json")).unwrap()).unwrap();
        assert_eq!(info["total_frames"], report.frames);
        for column in ["language_persistent", "language_events"] {
            assert_eq!(info["features"][column].is_object(), settings.language);
        }
        lengths.push(report.frames);
    }
    let calls: usize = traces.iter().map(|trace| trace.steps.len()).sum();
    assert_eq!(lengths[0], calls as u64);
    assert!(lengths[1] > 2 * lengths[0], "{lengths:?}");
}

#[test]
fn a_trace_that_does_not_replay_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut trace = traces(folder.path()).swap_remove(0);
    trace.steps[1].robot.base[0] += 0.5;
    let refused = encode(&trace, &SETTINGS);
    assert!(matches!(refused, Err(LeRobotError::NotExact { .. })));
    trace.steps.clear();
    assert!(matches!(
        encode(&trace, &SETTINGS),
        Err(LeRobotError::Empty { .. })
    ));
}
