//! `make demo` and `make test` compile each dependency once, because it gets the same features from
//! both.

use std::{
    collections::{BTreeMap, BTreeSet},
    process::Command,
};

use reel_tidy::root;
use serde_json::Value;

/// Features by package id of the dependencies that a cargo command compiles.
fn features(arguments: &[&str]) -> BTreeMap<String, BTreeSet<String>> {
    let output = Command::new(env!("CARGO"))
        .current_dir(root())
        .args(arguments)
        .args([
            "--locked",
            "--workspace",
            "--unit-graph",
            "-Zunstable-options",
        ])
        .env("RUSTC_BOOTSTRAP", "1")
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let graph: Value = serde_json::from_slice(&output.stdout).unwrap();
    let mut packages: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for unit in graph["units"].as_array().unwrap() {
        let id = unit["pkg_id"].as_str().unwrap();
        if id.starts_with("registry") {
            packages
                .entry(id.to_owned())
                .or_default()
                .insert(unit["features"].to_string());
        }
    }
    packages
}

#[test]
fn the_demo_and_the_tests_share_every_dependency() {
    let (demo, test) = (
        features(&["build", "--bin", "reel"]),
        features(&["test", "--no-run"]),
    );
    assert!(demo.len() > 500, "{} packages", demo.len());
    for (package, features) in demo {
        assert_eq!(
            Some(&features),
            test.get(&package),
            "{package}: see src/tidy/Cargo.toml"
        );
    }
}
