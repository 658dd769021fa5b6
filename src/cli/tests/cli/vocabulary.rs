//! Open vocabulary from outside: vectors from a file decide what a search means, and what the word
//! list does not know is counted.

use std::{fs, path::Path, process::Command};

use crate::{complaint, expect};

#[test]
fn vectors_of_a_file_decide_and_replay_needs_no_file() {
    let Some(python) = reel_vectors::python("json") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 30 --seed 35 --out tasks");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/vocabulary/argmax.py");
    let done = Command::new(python)
        .arg(script)
        .args([env!("CARGO_BIN_EXE_reel"), "tasks", "."])
        .current_dir(folder)
        .output()
        .unwrap();
    assert!(
        done.status.success(),
        "{}{}",
        String::from_utf8_lossy(&done.stdout),
        String::from_utf8_lossy(&done.stderr)
    );

    // A search for a word without a vector ends the episode, and says what is missing.
    fs::write(folder.join("vectors.json"), r#"{"mug": [1, 0]}"#).unwrap();
    let text = complaint(
        folder,
        1,
        "run --tasks tasks --embedding-vectors vectors.json --out short",
    );
    assert!(text.contains("vectors.json has no vector of "), "{text}");
    let text = complaint(
        folder,
        2,
        "run --tasks tasks --min-similarity 0.9 --out short",
    );
    assert!(text.contains("needs --embedding-model"), "{text}");
}

#[test]
fn a_word_that_the_list_does_not_know_is_a_counted_miss() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 2 --seed 35 --out tasks");
    reel!(folder, "run --tasks tasks --no-images --out traces");
    let trace = fs::read_dir(folder.join("traces"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .min()
        .unwrap();
    let search = |word: &str| {
        format!(
            r#"{{"name": "show_object_by_category", "arguments": {{"target_category": "{word}"}}}}"#
        )
    };
    let calls = [search("Flibbertigibbet"), search("striped mug")].join("\n");
    fs::write(folder.join("calls.jsonl"), calls).unwrap();
    let trace = trace.display();
    reel!(
        folder,
        "branch {trace} --at 1 --calls calls.jsonl --out traces/branch.mcap"
    );
    reel!(folder, "ingest traces --store store");
    let rows = expect(
        folder,
        0,
        "query --store store --named vocabulary_misses --format json",
    );
    let rows: Vec<serde_json::Value> = serde_json::from_str(&rows).unwrap();
    assert_eq!(rows.len(), 1, "{rows:?}");
    assert_eq!(
        (&rows[0]["query"], &rows[0]["calls"], &rows[0]["failed"]),
        (&"flibbertigibbet".into(), &1.into(), &1.into())
    );
}
