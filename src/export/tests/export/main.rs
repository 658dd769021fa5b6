//! The training set: what a row holds, what is refused, and that Hugging Face `datasets` reads it.

#[path = "../../../tables/tests/tables/play.rs"]
#[expect(dead_code, reason = "the tests of several crates share it")]
mod play;

use std::{fs::File, path::Path, process::Command};

use play::{Play, success};
use polars_core::prelude::{AnyValue, DataFrame};
use polars_io::{SerReader, parquet::read::ParquetReader};
use reel_export::{SftOptions, SftReport, sft};
use reel_trace::Images;
use reel_world::{ErrorCode, Family, record::PolicyOutput};
use tempfile::TempDir;

fn export(dir: &Path, plays: &[Play], options: SftOptions) -> (SftReport, DataFrame) {
    let record = |play: &Play| play.record_as(&dir.join(format!("{}.mcap", play.header.episode_id)), Images::Full);
    let paths: Vec<_> = plays.iter().map(record).collect();
    let out = dir.join("sft.parquet");
    let verify =
        |path: &Path| if path.to_string_lossy().contains("diverged") { Err("call 2 differs".to_owned()) } else { Ok(()) };
    let report = sft(&paths, &out, options, &verify, &|_, _| ()).unwrap();
    assert_eq!(report.bytes, out.metadata().unwrap().len());
    (report, ParquetReader::new(File::open(out).unwrap()).finish().unwrap())
}

/// The text of a message: 0 system, 1 user, 2 assistant.
fn message(frame: &DataFrame, row: usize, index: usize) -> String {
    let AnyValue::List(messages) = frame.column("messages").unwrap().get(row).unwrap() else { panic!("a list") };
    let contents = messages.struct_().unwrap().field_by_name("content").unwrap();
    contents.str().unwrap().get(index).unwrap().to_owned()
}

#[test]
fn only_verified_successes_are_exported() {
    let dir = TempDir::new().unwrap();
    let plays =
        [success("oracle", Family::FDP, 1), success("diverged", Family::FDP, 1), Play::new("hasty", Family::FDP, 1).finish()];
    let (report, frame) = export(dir.path(), &plays, SftOptions::default());
    assert_eq!((report.episodes, report.rows, report.unsuccessful), (1, 6, 1));
    assert_eq!(report.refused.len(), 1);
    assert_eq!(report.refused[0].1, "not verified: call 2 differs");
    assert_eq!(frame.height(), 6);
    let dir = TempDir::new().unwrap();
    let (report, _) = export(dir.path(), &plays, SftOptions { all: true });
    assert_eq!((report.episodes, report.rows, report.unsuccessful, report.refused.len()), (2, 7, 0, 1));
}

#[test]
fn a_row_is_what_the_policy_saw_and_did() {
    let dir = TempDir::new().unwrap();
    let thought = PolicyOutput {
        reasoning: "The clock is white.".into(),
        history: "I went to the table.".into(),
        plan: "Pick the clock.".into(),
        ..PolicyOutput::default()
    };
    let play = Play::new("model", Family::FDP, 1)
        .nav("table_1")
        .thinking(thought)
        .fails("pick", ErrorCode::NoMarkerMap)
        .find("alarm clock");
    let (report, frame) = export(dir.path(), &[play.finish()], SftOptions { all: true });
    assert_eq!((report.rows, report.failed_calls), (3, 1));
    assert!(
        message(&frame, 0, 1).contains("Progress:\nNothing done yet.") && message(&frame, 0, 1).contains("Last action: none")
    );
    let first = message(&frame, 0, 2);
    assert!(first.starts_with(
        "<think>The clock is white.</think>\n{\"History\":\"I went to the table.\",\"New Schedule\":\"Pick the clock.\""
    ));
    assert!(first.ends_with("\"next_action\":{\"tool_name\":\"nav_to\",\"args\":{\"receptacle_name\":\"table_1\"}}}"), "{first}");
    let user = message(&frame, 1, 1);
    assert!(user.contains("Last outcome: It does not work: no_marker_map."), "the failed call is told, though not imitated");
    assert!(user.contains("- cabinet_1 (cabinet, living room/0)") && user.contains("\"name\":\"show_receptacles\""));
    assert!(!message(&frame, 1, 2).contains("<think>"));
    assert!(
        message(&frame, 2, 1)
            .contains("1. nav_to(receptacle_name=\"table_1\"): You are at table_1.\n2. pick(marker_id=1): It does not work")
    );
}

#[test]
fn no_privileged_word_reaches_a_row() {
    let dir = TempDir::new().unwrap();
    let plays = Family::ALL.map(|family| success("oracle", family, 1));
    let (report, frame) = export(dir.path(), &plays, SftOptions::default());
    assert_eq!(report.episodes, 4);
    for row in 0..frame.height() {
        let text = [0, 1, 2].map(|index| message(&frame, row, index)).concat();
        assert_eq!(text.matches("<image>").count(), 1);
        for task in plays.iter().map(|play| &play.task) {
            for object in &task.objects {
                assert!(!text.contains(object.instance.as_str()) && !text.contains(object.asset.as_str()), "{text}");
            }
            assert!(task.goal_changes().iter().all(|change| !text.contains(&change.to_string())));
        }
        if text.contains("timekeeping") {
            assert!(!text.contains(&plays[3].task.precise_instruction), "a fuzzy task stays fuzzy");
        }
    }
    let telling = PolicyOutput { reasoning: format!("I take {}.", play::TARGET), ..PolicyOutput::default() };
    let dir = TempDir::new().unwrap();
    let (report, _) = export(dir.path(), &[success("cheat", Family::FDP, 1).thinking(telling)], SftOptions::default());
    assert!(report.refused[0].1.contains("must not know"), "{:?}", report.refused);
    assert_eq!((report.episodes, report.rows), (0, 0));
}

#[test]
fn hugging_face_datasets_decodes_the_images() {
    let python = std::env::var("REEL_PYTHON").unwrap_or_else(|_| "python3".into());
    let importable =
        Command::new(&python).args(["-c", "import datasets, PIL"]).output().is_ok_and(|output| output.status.success());
    if !importable {
        eprintln!("skipped: {python} has no `datasets` and `pillow` (REEL_PYTHON names another one)");
        return;
    }
    let dir = TempDir::new().unwrap();
    export(dir.path(), &[success("oracle", Family::SUL, 1), success("oracle", Family::FDO, 2)], SftOptions::default());
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/check_datasets.py");
    let output = Command::new(&python).arg(script).arg(dir.path()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(String::from_utf8_lossy(&output.stdout).trim(), "16 rows, 16 images of 640 x 480");
}
