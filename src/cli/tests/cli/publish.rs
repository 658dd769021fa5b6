//! `reel publish` from outside: exports of each kind to a folder and to a Hub on this machine.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use reel_vectors::hub::{StubHub, TOKEN};
use serde_json::Value;

use super::{complaint, expect};

/// Traces of two policies in a store, with images.
fn store(folder: &Path) {
    reel!(folder, "task generate --count 4 --seed 3 --out tasks");
    for policy in ["oracle", "wrong-object"] {
        reel!(folder, "run --tasks tasks --policy {policy} --out traces");
    }
    reel!(folder, "ingest traces --store store");
}

/// Rollouts of two seeds, without images.
fn rollouts(folder: &Path) {
    for seed in ["1", "2"] {
        reel!(
            folder,
            "run --tasks tasks --seed {seed} --policy wrong-object --no-images --out rollouts"
        );
    }
    reel!(folder, "ingest rollouts --store rollout-store");
}

/// The report of a command that must end with the given exit code.
fn report(folder: &Path, code: i32, arguments: &str) -> Value {
    let said = expect(folder, code, &format!("publish {arguments} --json"));
    serde_json::from_str(&said).unwrap_or_else(|error| panic!("{error}: {said}"))
}

/// What PyPI `datasets` says of a published folder, where it is installed.
fn loaded(folder: &Path, arguments: &[String]) {
    if let Some(python) = reel_vectors::python("datasets, PIL") {
        let mut script = reel_vectors::script(python, "formats/publish.py");
        reel_vectors::run(script.arg(folder).args(arguments));
    }
}

#[test]
fn exports_of_each_kind_become_folders_that_load() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    store(folder);
    rollouts(folder);
    let exports = [
        ("sft", "sft --store store --image-format png"),
        ("trl", "sft --store store --format trl --image-format none"),
        (
            "rl",
            "rl --store rollout-store --format trl --image-format none --group-size 2",
        ),
        ("preferences", "preferences --store store --no-images"),
    ];
    for (name, export) in exports {
        reel!(folder, "export {export} --out {name} --license cc-by-4.0");
        let to = format!("{name} --to published/of/{name}");
        let planned = report(folder, 0, &to);
        assert_eq!(planned["executed"], false);
        assert!(!folder.join("published/of").join(name).exists());
        let done = report(folder, 0, &format!("{to} --execute"));
        assert_eq!(
            (&done["executed"], &done["files"]),
            (&true.into(), &planned["files"])
        );
        let again = reel!(folder, "publish {to} --execute");
        assert!(again.contains("nothing to do"), "{again}");
        let manifest = fs::read(folder.join(name).join("manifest.json")).unwrap();
        let counts = &serde_json::from_slice::<Value>(&manifest).unwrap()["counts"];
        let rows = match name {
            "preferences" => &counts["pairs"],
            _ => &counts["splits"]["train"],
        };
        assert!(rows.as_u64() > Some(0), "{name}: {counts}");
        let mut arguments = vec![format!("train={rows}")];
        if name == "sft" {
            arguments.push("--images".to_owned());
        }
        loaded(&folder.join("published/of").join(name), &arguments);
    }
    let lerobot = "export lerobot traces --camera-size 64x48 --out lerobot";
    reel!(folder, "{lerobot} --license apache-2.0");
    reel!(folder, "publish lerobot --to lerobot-published --execute");
    reel!(folder, "dataset lint lerobot-published");
}

#[test]
fn what_is_wrong_is_told_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    store(folder);
    reel!(
        folder,
        "export sft --store store --format trl --image-format none --out set"
    );
    let refused = report(folder, 1, "set --to published --execute");
    assert_eq!(refused["executed"], false);
    assert_eq!(
        refused["problem_counts"],
        serde_json::json!({ "license": 1 })
    );
    assert!(!folder.join("published").exists());
    complaint(folder, 2, "publish set --to published --allow license");
    complaint(folder, 2, "publish tasks --to published");
    let hub_only = complaint(folder, 2, "publish set --to published --private");
    assert!(hub_only.contains("--private is for the Hub"), "{hub_only}");
    let both = complaint(folder, 2, "publish set --to traces/published");
    assert!(both.contains("./"), "{both}");
}

#[test]
fn a_hub_gets_what_the_dry_run_shows() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    store(folder);
    reel!(
        folder,
        "export sft --store store --out set --license cc-by-4.0 --image-format png"
    );
    let stub = StubHub::start();
    let publish = |token: &str, arguments: &str| -> Output {
        Command::new(env!("CARGO_BIN_EXE_reel"))
            .current_dir(folder)
            .env_remove("REEL_CONFIG")
            .env("HF_ENDPOINT", stub.address())
            .env("HF_TOKEN", token)
            .env("HF_HOME", folder)
            .args(["publish", "set", "--to", "tester/household"])
            .args(arguments.split_whitespace())
            .output()
            .unwrap()
    };
    let json = |output: Output| -> Value {
        let complaint = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{complaint}");
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let planned = json(publish(TOKEN, "--json"));
    assert!(stub.take_requests("PUT").is_empty());
    assert!(stub.state().repositories.is_empty());
    let done = json(publish(TOKEN, "--json --private --execute"));
    let paths = |report: &Value| -> Vec<String> {
        let files = report["files"].as_array().unwrap().iter();
        files
            .map(|file| file["path"].as_str().unwrap().to_owned())
            .collect()
    };
    assert_eq!(paths(&planned), paths(&done));
    let there = stub.files("tester/household", "main");
    assert_eq!(there.keys().cloned().collect::<Vec<_>>(), paths(&done));
    assert!(stub.state().repositories["tester/household"].private);
    stub.take_requests("");
    let again = publish(TOKEN, "--execute");
    assert!(String::from_utf8_lossy(&again.stdout).contains("nothing to do"));
    let sent = stub.take_requests("");
    assert!(
        !sent
            .iter()
            .any(|it| it.starts_with("PUT") || it.contains("commit")),
        "{sent:?}"
    );
    let wrong = publish("wrong", "");
    let told = String::from_utf8_lossy(&wrong.stderr);
    assert!(
        wrong.status.code() == Some(2) && told.contains("HF_TOKEN"),
        "{told}"
    );
}
