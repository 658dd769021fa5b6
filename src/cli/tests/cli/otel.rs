//! Spans of OpenTelemetry: what a trace is afterwards, what becomes of those of other agents, and a collector.

use std::fs;

use reel_import::otel::{LOST, LOST_IMAGES};
use serde_json::Value;

use crate::{
    atif::{comes_back_but_for_what_is_listed, episodes},
    complaint, expect,
};

const PAGE: &str = include_str!("../../../../docs/opentelemetry.md");

#[test]
fn a_trace_comes_back_from_spans() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let count = episodes(folder);
    let blobs = ["--images", "blob"];
    comes_back_but_for_what_is_listed(folder, "otel", &blobs, count, (LOST, PAGE));
    for made in ["documents", "back", "again", "store"] {
        fs::remove_dir_all(folder.join(made)).unwrap();
    }
    let lost: Vec<(&str, &str)> = LOST.iter().copied().chain([LOST_IMAGES]).collect();
    let protobuf = ["--format", "protobuf"];
    comes_back_but_for_what_is_listed(folder, "otel", &protobuf, count, (&lost, PAGE));

    // Equal traces give equal spans.
    let first = fs::read(folder.join("documents/branch.binpb")).unwrap();
    let twice = ["export", "otel", "traces/branch.mcap", "--out", "twice"];
    expect(folder, 0, &[&twice[..], &protobuf].concat());
    assert_eq!(fs::read(folder.join("twice/branch.binpb")).unwrap(), first);

    // Without words the calls come back alone.
    let bare = [
        "export",
        "otel",
        "traces/branch.mcap",
        "--no-content",
        "--out",
        "bare",
    ];
    let told = expect(folder, 0, &bare);
    assert!(told.contains("the words are left out"), "{told}");
    let lines = expect(
        folder,
        0,
        &["import", "otel", "bare", "--out", "calls", "--json"],
    );
    let told: Value = serde_json::from_str(&lines).unwrap();
    assert!(told["steps"].as_u64().unwrap() > 0, "{told}");
}

#[test]
fn what_is_no_span_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let spans = include_str!("../../../../tests/formats/foreign/spans.jsonl");
    fs::write(folder.join("spans.jsonl"), spans).unwrap();
    fs::write(folder.join("torn.jsonl"), &spans[..spans.len() - 100]).unwrap();
    fs::write(folder.join("none.pb"), "none").unwrap();
    fs::write(folder.join("bad.json"), r#"{"resourceSpans": 3}"#).unwrap();
    fs::write(folder.join("other.json"), r#"{"resourceSpans": []}"#).unwrap();
    fs::create_dir(folder.join("empty")).unwrap();
    let import = |name| ["import", "otel", name, "--out", "out"];
    expect(folder, 0, &import("spans.jsonl"));
    let told = complaint(folder, 3, &import("torn.jsonl"));
    assert!(told.contains("torn.jsonl: not OTLP/JSON"), "{told}");
    for (name, why) in [
        ("none.pb", "not OTLP in protobuf"),
        ("bad.json", "not OTLP/JSON"),
        ("empty", "no spans of OpenTelemetry here"),
    ] {
        let told = complaint(folder, 2, &import(name));
        assert!(told.contains(why), "{told}");
    }
    let nothing = expect(folder, 2, &import("other.json"));
    assert!(nothing.contains("0 of 0 episodes"), "{nothing}");

    let to = |address| ["export", "otel", "out", "--to", address];
    let told = complaint(folder, 2, &to("localhost:4318"));
    assert!(told.contains("it is no address of a collector"), "{told}");
    let told = complaint(folder, 2, &to("http://me:secret@localhost:4318"));
    assert!(
        told.contains("OTEL_EXPORTER_OTLP_HEADERS") && !told.contains("secret"),
        "{told}"
    );
    let told = complaint(folder, 2, &["export", "otel", "out", "--start", "noon"]);
    assert!(told.contains("'noon' is no time"), "{told}");
}

/// The official messages, SDK and exporter of OpenTelemetry.
#[test]
fn third_party_readers_agree() {
    crate::service::script("formats/otel.py", &[]);
}
