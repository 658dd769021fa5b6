//! The file formats of REAL from outside: what is written reads back.

use std::{fs, path::Path};

use serde_json::Value;

use crate::{complaint, expect};

#[test]
fn tasks_of_the_generator_are_written_checked_and_played() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(
        folder,
        "task generate --scene S1 --count 6 --seed 2 --format real-proc --out proc"
    );
    let files: Vec<String> = fs::read_dir(folder.join("proc/S1"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
        .collect();
    assert!(
        files.len() > 2 && files.iter().all(|file| file.ends_with(".yaml")),
        "{files:?}"
    );
    let checked = reel!(folder, "task check proc/S1 --scene proc/S1.json --json");
    let checked: Value = serde_json::from_str(&checked).unwrap();
    assert_eq!(
        (&checked["loaded"], &checked["files"]),
        (&6.into(), &6.into())
    );
    reel!(
        folder,
        "run --tasks proc/S1 --scene proc/S1.json --policy oracle --out traces"
    );
    reel!(folder, "replay traces");
}

#[test]
fn evaluation_output_reads_back_and_is_not_overwritten() {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../traces/golden/FODP_workshop_fall--oracle--0.mcap");
    let golden = golden.to_str().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let told = reel!(folder, "export real-eval {golden} --run-tag t");
    assert!(
        told.starts_with("oracle: 1 episodes in eval_output, 1 finished, 1 successes"),
        "{told}"
    );
    let results: Value = serde_json::from_slice(
        &fs::read(folder.join("eval_output/reel_results_oracle_t.json")).unwrap(),
    )
    .unwrap();
    assert_eq!(
        (&results["success_rate"], &results["end_idx"]),
        (&1.0.into(), &999_999.into())
    );
    let imported = reel!(folder, "import real-eval eval_output --out traces --json");
    let imported: Value = serde_json::from_str(&imported).unwrap();
    assert_eq!(
        (&imported["success"], &imported["end"]),
        (&true.into(), &"finished".into())
    );
    assert!(
        complaint(folder, 3, &format!("export real-eval {golden}")).contains("give another --out")
    );
}

#[cfg(feature = "analytics")]
#[test]
fn annotation_files_hold_a_record_for_every_step() {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../traces/golden/FODP_workshop_fall--oracle--0.mcap");
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let told = expect(
        folder,
        0,
        &[
            "export",
            "real-annotation",
            golden.to_str().unwrap(),
            "--json",
        ],
    );
    let told: Value = serde_json::from_str(&told).unwrap();
    let read = |name: &str| -> Value {
        serde_json::from_slice(&fs::read(folder.join("annotation").join(name)).unwrap()).unwrap()
    };
    let samples = read("annotated_output.json");
    assert_eq!(told["records"], samples.as_array().unwrap().len());
    assert_eq!(
        read("anno_checkpoint/annotated_checkpoint.ep_000001.json"),
        samples
    );
    assert_eq!(
        read("template.json").as_array().unwrap().len(),
        samples.as_array().unwrap().len()
    );
    assert_eq!(read("template.json")[0]["metadata"]["eval_subset"], "FODP");
    assert!(read("streams/1_meta.json")["src"].is_string());
    let events = read("streams/1.json");
    assert!(
        events.as_array().unwrap()[1..]
            .iter()
            .all(|event| event["action"].is_string() && event.get("payload").is_some())
    );
}
