//! Training sets by the command: words by rules and by a model, rollout groups, tokens by
//! a model's own tokenizer.

use std::fs;

use serde_json::Value;

use super::{complaint, endpoint::endpoint, expect};

fn lines(text: &str) -> Vec<Value> {
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}")))
        .collect()
}

#[test]
fn a_models_notes_stand_where_nothing_is_against_them() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 2 --seed 3 --out tasks");
    reel!(
        folder,
        "run --tasks tasks --policy oracle --no-images --out traces"
    );
    reel!(folder, "ingest traces --store store");
    let bare = complaint(
        folder,
        3,
        "export sft --store store --annotations notes --image-format none --out bare",
    );
    assert!(bare.contains("annotate the trace first"), "{bare}");

    // the rules' notes are the words that the export writes by itself
    let said = reel!(folder, "dataset annotate traces");
    assert!(said.contains("of 2 traces annotated"), "{said}");
    let rows = |words: &str| {
        let export = format!(
            "export sft --store store --images none --format trl --annotations {words} \
            --out {words}"
        );
        expect(folder, 0, &export);
        lines(&fs::read_to_string(folder.join(words).join("train/train-00000.jsonl")).unwrap())
    };
    let (notes, rules) = (rows("notes"), rows("rules"));
    assert!(notes.len() > 10 && notes.len() == rules.len());
    for (note, rule) in notes.iter().zip(&rules) {
        assert_eq!(note["completion"], rule["completion"]);
    }

    // a model: what it says of the first decision is taken, what it claims falsely of
    // the second is not
    let note = |step: usize, history: &str| {
        serde_json::json!({
            "step": step, "reasoning": "Let me think.", "history": history, "schedule": "All of it.", "subtask": "The next thing.",
        })
    };
    let answer = Value::from(vec![
        note(0, "Nothing was done yet."),
        note(1, "I placed the object on bed_1."),
    ])
    .to_string();
    let url = endpoint(&answer);
    let said = lines(&reel!(
        folder,
        "dataset annotate traces --endpoint {url} --model scripted --json"
    ));
    for trace in &said {
        let by_rules = trace["by_rules_because"].as_array().unwrap();
        assert_eq!(
            by_rules.len() as u64 + 1,
            trace["decisions"].as_u64().unwrap(),
            "{trace}"
        );
        assert!(
            by_rules[0]["reason"]
                .as_str()
                .unwrap()
                .contains("placed the object"),
            "{trace}"
        );
    }
    let calls = fs::read_to_string(folder.join("annotate-calls.jsonl"))
        .unwrap()
        .lines()
        .count();
    assert!(calls >= 2);
    // nothing is asked twice, not even without the endpoint
    let again = lines(&reel!(
        folder,
        "dataset annotate traces --endpoint {url} --model scripted --json"
    ));
    assert!(
        again
            .iter()
            .all(|trace| trace["resumed"] == trace["decisions"]),
        "{again:?}"
    );
    assert_eq!(
        fs::read_to_string(folder.join("annotate-calls.jsonl"))
            .unwrap()
            .lines()
            .count(),
        calls
    );
}

#[test]
fn rollout_groups_and_a_tokenizer() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 2 --seed 3 --out tasks");
    for seed in ["1", "2"] {
        reel!(
            folder,
            "run --tasks tasks --seed {seed} --policy wrong-object --no-images --out traces"
        );
    }
    reel!(folder, "ingest traces --store store");
    let words = r#"{"type": "WordLevel", "vocab": {"?": 0}, "unk_token": "?"}"#;
    let tokenizer = format!(
        r#"{{"version": "1.0", "pre_tokenizer": {{"type": "Whitespace"}}, "model": {words}}}"#
    );
    fs::write(folder.join("tokenizer.json"), tokenizer).unwrap();
    let export = [
        "export",
        "rl",
        "--store",
        "store",
        "--images",
        "none",
        "--tokenizer",
        "tokenizer.json",
        "--group-size",
        "2",
    ];
    let report = expect(
        folder,
        0,
        &[&export[..], &["--out", "rl", "--json"]].concat(),
    );
    let report: Value = serde_json::from_str(&report).unwrap();
    assert_eq!(report["episodes"], 4, "{report}");
    assert!(
        report["tokens"]["tokenizer"]
            .as_str()
            .unwrap()
            .starts_with("tokenizer.json "),
        "{report}"
    );
    for row in lines(&fs::read_to_string(folder.join("rl/train/train-00000.jsonl")).unwrap()) {
        assert_eq!(row["group_size"], 2);
        assert!(
            row["advantage"].is_number() && row["return"].is_number() && row["reward"].is_number()
        );
    }
    let tasks: Vec<String> =
        serde_json::from_str(&fs::read_to_string(folder.join("rl/tasks.json")).unwrap()).unwrap();
    assert_eq!(tasks.len(), 2);
    let linted = reel!(folder, "dataset lint rl --tokenizer tokenizer.json");
    assert!(linted.contains("counted by tokenizer.json"), "{linted}");
    let wrong = complaint(folder, 2, "dataset lint rl --tokenizer rl/tasks.json");
    assert!(
        wrong.contains("no tokenizer") && wrong.contains("tasks.json"),
        "{wrong}"
    );
    complaint(
        folder,
        2,
        "export rl --store store --format parquet --out other",
    );
}

/// A script of `tests` run by a Python that has packages; none where it has not.
fn python(packages: &str, script: &str, arguments: &[&str]) -> Option<String> {
    let python = reel_vectors::python(packages)?;
    let mut command = reel_vectors::script(python, script);
    Some(reel_vectors::run(command.args(arguments)))
}

/// The short form of `make bench-export`.
#[test]
fn the_benchmarks_script_makes_the_same_rows() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 2 --seed 3 --out tasks");
    for policy in ["oracle", "wrong-object"] {
        reel!(folder, "run --tasks tasks --policy {policy} --out full");
        reel!(
            folder,
            "run --tasks tasks --policy {policy} --no-images --out lean"
        );
    }
    let path = |name: &str| folder.join(name).display().to_string();
    let (full, lean, work) = (path("full"), path("lean"), path("work"));
    fs::create_dir(&work).unwrap();
    let arguments = [
        "--full",
        &full,
        "--lean",
        &lean,
        "--work",
        &work,
        "--reel",
        env!("CARGO_BIN_EXE_reel"),
        "--check",
    ];
    let packages = "blake3, datasets, mcap, google.protobuf, orjson, PIL, pyarrow, re2, zstandard";
    let Some(said) = python(packages, "bench/export.py", &arguments) else {
        return;
    };
    assert_eq!(said.matches("are the same").count(), 3, "{said}");
}

/// Another reader of the same traces, in Python, fills the same tables.
#[test]
fn the_benchmarks_script_makes_the_same_tables() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 2 --seed 5 --out tasks");
    for policy in ["oracle", "wrong-object", "no-ask"] {
        reel!(
            folder,
            "run --tasks tasks --policy {policy} --out traces --no-images"
        );
    }
    reel!(folder, "ingest traces --store store");
    let path = |name: &str| folder.join(name).display().to_string();
    let (traces, store, rows) = (path("traces"), path("store"), path("rows"));
    let packages = "blake3, deltalake, google.protobuf, mcap, orjson, pyarrow, zstandard";
    let read = python(
        packages,
        "bench/ingest_python.py",
        &[&traces, "--out", &rows],
    );
    if read.is_some() {
        let said = python(packages, "bench/check_ingest.py", &[&store, &rows]).unwrap();
        assert!(said.contains("episodes: 6 rows"), "{said}");
    }
}

/// The short form of `make prove-sft`.
#[test]
fn the_training_proof_has_tests_of_its_own() {
    python("jax", "training/test.py", &[]);
}
