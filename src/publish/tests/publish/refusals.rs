//! What must not be published, and what it is told.

use std::{fs, path::Path, sync::Arc};

use arrow::{
    array::{ArrayRef, RecordBatch, StringArray},
    datatypes::{DataType, Field, Schema},
};
use parquet::{arrow::ArrowWriter, basic::Compression, file::properties::WriterProperties};
use reel_publish::{Check, DatasetKind, Publication};
use serde_json::{Value, json};

use crate::sample::{card, export, list, open, problems, row};

/// A token that is none, in two parts, so that no scanner takes this file for a leak.
fn token() -> String {
    format!("hf{}{}", "_", "aB3".repeat(12))
}

fn home() -> String {
    format!("/{}/{}", "home", "me/traces/a.mcap")
}

/// A fresh export that was changed, with its manifest written again.
fn changed(change: impl Fn(&Path)) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    export(folder.path());
    change(folder.path());
    list(folder.path());
    folder
}

fn with_rows(rows: &[Value]) -> tempfile::TempDir {
    let rows: String = rows.iter().map(|row| format!("{row}\n")).collect();
    changed(|root| fs::write(root.join("train/train-00000.jsonl"), &rows).unwrap())
}

fn only(root: &Path, check: Check) -> Vec<String> {
    let publication = open(root);
    let counts = publication.problems().counts();
    assert!(
        counts.len() == 1 && counts.contains_key(&check),
        "{:?}",
        publication.problems().kept_problems()
    );
    problems(root, check)
}

#[test]
fn a_clean_export_has_no_problems() {
    let folder = changed(|_| ());
    let publication = open(folder.path());
    assert_eq!(publication.problems().kept_problems().len(), 0);
    assert_eq!(publication.dataset_kind(), DatasetKind::Export);
    assert_eq!(publication.card_head()[1], "license: cc-by-4.0");
}

#[cfg(unix)]
#[test]
fn hostile_folders_are_refused() {
    use std::os::unix::{ffi::OsStrExt, fs::symlink, net::UnixListener};

    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    export(root);
    symlink("/etc/hostname", root.join("train/link.jsonl")).unwrap();
    symlink("/etc", root.join("folder")).unwrap();
    fs::write(root.join("a\nb.json"), "{}").unwrap();
    fs::write(root.join("\u{1b}[31m.txt"), "x").unwrap();
    fs::write(root.join("empty.json"), "").unwrap();
    fs::write(root.join(".env"), "x").unwrap();
    fs::create_dir(root.join(".git")).unwrap();
    let name = std::ffi::OsStr::from_bytes(b"\xff.json");
    fs::write(root.join(name), "{}").unwrap();
    let _socket = UnixListener::bind(root.join("socket")).unwrap();
    fs::write(root.join(".export.jsonl"), "").unwrap();
    let publication = open(root);
    assert_eq!(publication.problems().counts()[&Check::Files], 10);
    let shown = problems(root, Check::Files).join("\n");
    for part in [
        "link.jsonl: a link",
        "folder: a link",
        "a\\nb.json",
        "empty.json: an empty file",
    ] {
        assert!(shown.contains(part), "{part}: {shown}");
    }
    assert!(
        shown.contains(".export.jsonl: the export was broken off"),
        "{shown}"
    );
    assert!(
        !shown.contains('\u{1b}') && shown.lines().count() == 10,
        "{shown}"
    );
    let files = publication.files();
    assert!(
        !files
            .keys()
            .any(|path| path.contains("link") || path.contains("folder"))
    );
    assert!(publication.problems().forbid(&Check::ALL));
}

#[test]
fn a_manifest_cannot_lead_out_of_the_folder() {
    for path in ["../a", "/etc/passwd", "a/../../b", "a\\b", ""] {
        let folder = changed(|_| ());
        let place = folder.path().join("manifest.json");
        let mut manifest: Value = serde_json::from_slice(&fs::read(&place).unwrap()).unwrap();
        let entry = json!({ "path": path, "bytes": 1, "blake3": "00" });
        manifest["files"].as_array_mut().unwrap().push(entry);
        fs::write(&place, manifest.to_string()).unwrap();
        let shown = problems(folder.path(), Check::Checksums);
        assert!(shown[0].contains("outside"), "{path}: {shown:?}");
    }
}

#[test]
fn secrets_are_found_and_not_shown() {
    let token = token();
    let escaped: String = token
        .chars()
        .map(|c| format!("\\u{:04x}", c as u32))
        .collect();
    let line = format!(
        "{{\"prompt\":\"{escaped}\",\"provenance\":{{\"trace_digest\":\"a\",\"verdict\":\"exact\"}}}}\n"
    );
    let folder = changed(|root| fs::write(root.join("train/train-00000.jsonl"), &line).unwrap());
    let shown = only(folder.path(), Check::Secrets);
    assert!(
        shown[0].contains("train-00000.jsonl:1: a Hugging Face token"),
        "{shown:?}"
    );
    assert!(!shown[0].contains(&token));

    let bytes = [b"\x89PNG\0tEXtComment\0", token.as_bytes(), &[0; 9000]].concat();
    let folder = changed(|root| fs::write(root.join("images/a.png"), &bytes).unwrap());
    assert_eq!(only(folder.path(), Check::Secrets).len(), 1);

    let text = card("mit") + &token;
    let folder = changed(|root| fs::write(root.join("README.md"), &text).unwrap());
    let shown = problems(folder.path(), Check::Secrets);
    assert_told_once(&shown, "README.md:12: ");
}

/// One problem is shown, and it has this part.
fn assert_told_once(shown: &[String], part: &str) {
    assert!(shown.len() == 1 && shown[0].contains(part), "{shown:?}");
}

#[test]
fn passwords_of_any_address_are_secrets() {
    for address in [
        format!("postgres://admin:{}@db.example.com:5432/x", "Zk39slQpz71"),
        format!("mongodb+srv://u:{}@h", "p"),
        format!("redis://:{}@h", "pw"),
    ] {
        let folder = with_rows(&[row(&address, "exact")]);
        let shown = only(folder.path(), Check::Secrets);
        assert_told_once(&shown, ".jsonl:1: an address with a password");
    }
}

#[test]
fn secrets_in_names_are_found_and_not_shown() {
    let token = token();
    let folder = tempfile::tempdir().unwrap();
    export(folder.path());
    fs::write(folder.path().join(format!("{token}.txt")), "x\n").unwrap();
    let shown = problems(folder.path(), Check::Secrets);
    assert!(
        shown.len() == 1 && shown[0].contains(".txt: a Hugging Face token is in its name"),
        "{shown:?}"
    );
    let all = open(folder.path());
    let all = format!("{:?}", all.problems().kept_problems());
    assert!(!all.contains(&token), "{all}");
}

#[test]
fn paths_of_this_machine_are_found() {
    let mut leaking = row("one", "exact");
    leaking["provenance"]["trace_uri"] = home().into();
    let folder = with_rows(&[row("one", "exact"), leaking]);
    let shown = only(folder.path(), Check::LocalPaths);
    assert!(
        shown[0].contains("train-00000.jsonl:2: a path of one machine"),
        "{shown:?}"
    );
    assert!(!shown[0].contains("traces/a.mcap"), "{shown:?}");
    assert!(!open(folder.path()).problems().forbid(&[Check::LocalPaths]));
}

#[test]
fn rows_of_unverified_traces_are_found() {
    let folder = with_rows(&[row("one", "exact_without_rgb"), row("two", "unverified")]);
    let shown = only(folder.path(), Check::Unverified);
    assert!(
        shown[0].contains(":2: the trace is not verified (unverified)"),
        "{shown:?}"
    );
    let folder = with_rows(&[json!({ "prompt": "one" })]);
    let shown = only(folder.path(), Check::Unverified);
    assert!(shown[0].contains("1 of 1 rows name no trace"), "{shown:?}");
}

#[test]
fn cards_without_a_license_are_refused() {
    for license in ["other", "unknown", ""] {
        let text = card(license);
        let folder = changed(|root| fs::write(root.join("README.md"), &text).unwrap());
        assert_eq!(only(folder.path(), Check::License).len(), 1, "{license}");
    }
    let folder = changed(|root| fs::remove_file(root.join("README.md")).unwrap());
    assert!(only(folder.path(), Check::Card)[0].contains("missing"));
}

#[test]
fn checksums_have_to_hold() {
    let folder = changed(|_| ());
    let root = folder.path();
    fs::write(root.join("images/a.png"), "other").unwrap();
    fs::write(root.join("notes.txt"), "other").unwrap();
    fs::remove_file(root.join("train/train-00000.jsonl")).unwrap();
    let shown = problems(root, Check::Checksums).join("\n");
    for part in [
        "images/a.png: it is not",
        "notes.txt: manifest.json does not list",
        "jsonl: manifest.json lists it, and",
    ] {
        assert!(shown.contains(part), "{part}: {shown}");
    }
    let folder = changed(|_| ());
    let text = card("mit");
    fs::write(folder.path().join("README.md"), text).unwrap();
    let publication = open(folder.path());
    assert_eq!(publication.problems().kept_problems().len(), 0);
    assert_eq!(
        publication.notes(),
        ["the card was edited after the export"]
    );
    let sums = format!("{}  README.md\n", "0".repeat(64));
    fs::write(folder.path().join("SHA256SUMS"), sums).unwrap();
    let shown = only(folder.path(), Check::Checksums).join("\n");
    assert!(
        shown.contains("README.md: SHA256SUMS has another digest"),
        "{shown}"
    );
}

#[test]
fn files_that_checksums_do_not_list_are_refused() {
    let folder = changed(|_| ());
    let root = folder.path();
    fs::create_dir(root.join("meta")).unwrap();
    fs::write(
        root.join("meta/info.json"),
        r#"{"codebase_version": "v3.0"}"#,
    )
    .unwrap();
    fs::remove_file(root.join("manifest.json")).unwrap();
    let publication = open(root);
    let sums = publication.files().values();
    let sums: String = sums
        .filter(|file| root.join(&file.path).is_file())
        .map(|file| format!("{}  {}\n", file.sha256, file.path))
        .collect();
    fs::write(root.join("SHA256SUMS"), sums).unwrap();
    assert!(problems(root, Check::Checksums).is_empty());
    fs::write(root.join("added.txt"), "x\n").unwrap();
    assert_eq!(
        problems(root, Check::Checksums),
        [
            "checksums: added.txt: SHA256SUMS does not list it; remove it, or SHA256SUMS if the file was meant to be added"
        ]
    );
}

#[test]
fn a_task_in_two_splits_is_refused() {
    let folder = changed(|_| ());
    let place = folder.path().join("manifest.json");
    let mut manifest: Value = serde_json::from_slice(&fs::read(&place).unwrap()).unwrap();
    manifest["leakage"] = json!([
        { "kind": "scene", "key": "home", "splits": ["train", "test"] },
        { "kind": "task", "key": "FDP/1", "splits": ["train", "test"] },
    ]);
    fs::write(&place, manifest.to_string()).unwrap();
    assert_eq!(only(folder.path(), Check::Splits).len(), 1);
    manifest["options"] = json!({ "split_by": "scene" });
    fs::write(&place, manifest.to_string()).unwrap();
    assert_eq!(only(folder.path(), Check::Splits).len(), 2);
}

/// A compressed table, whose bytes show nothing.
#[test]
fn tables_are_read_cell_by_cell() {
    let texts = [home(), token(), "plain".to_owned()].map(|text| text + &" padding".repeat(500));
    let names = ["text", "trace_digest", "verdict"];
    let schema = Schema::new(
        names
            .map(|name| Field::new(name, DataType::Utf8, true))
            .to_vec(),
    );
    let column = |values: [&str; 3]| Arc::new(StringArray::from(values.to_vec())) as ArrayRef;
    let columns = vec![
        column([&texts[0], &texts[1], &texts[2]]),
        column(["a", "b", "c"]),
        column(["exact", "exact", "diverged"]),
    ];
    let batch = RecordBatch::try_new(Arc::new(schema), columns).unwrap();
    let folder = changed(|root| {
        fs::remove_file(root.join("train/train-00000.jsonl")).unwrap();
        let text = card("mit").replace("jsonl", "parquet");
        fs::write(root.join("README.md"), text).unwrap();
        let file = fs::File::create(root.join("train/train-00000.parquet")).unwrap();
        let level = parquet::basic::ZstdLevel::default();
        let properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(level))
            .set_statistics_enabled(parquet::file::properties::EnabledStatistics::None)
            .build();
        let mut writer = ArrowWriter::try_new(file, batch.schema(), Some(properties)).unwrap();
        writer.write(&batch).unwrap();
        writer.close().unwrap();
    });
    for (check, line) in [
        (Check::LocalPaths, 1),
        (Check::Secrets, 2),
        (Check::Unverified, 3),
    ] {
        let shown = problems(folder.path(), check);
        assert_eq!(shown.len(), 1, "{shown:?}");
        assert!(
            shown[0].contains(&format!("train-00000.parquet:{line}: ")),
            "{shown:?}"
        );
    }
}

#[test]
fn folders_that_are_no_dataset_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |root: &Path| Publication::open(root, |_| ()).unwrap_err().to_string();
    assert!(refused(folder.path()).contains("neither manifest.json nor meta/info.json"));
    assert!(refused(&folder.path().join("none")).contains("cannot read"));
    fs::write(folder.path().join("manifest.json"), "{}").unwrap();
    assert!(refused(folder.path()).contains("not the manifest of an export"));
    fs::create_dir(folder.path().join("meta")).unwrap();
    fs::write(
        folder.path().join("meta/info.json"),
        r#"{"codebase_version": "v2.1"}"#,
    )
    .unwrap();
    assert!(refused(folder.path()).contains("version 'v2.1'"));
    fs::write(
        folder.path().join("meta/info.json"),
        r#"{"codebase_version": "v3.0"}"#,
    )
    .unwrap();
    fs::write(folder.path().join("README.md"), card("mit")).unwrap();
    fs::remove_file(folder.path().join("manifest.json")).unwrap();
    let publication = open(folder.path());
    assert_eq!(publication.dataset_kind(), DatasetKind::LeRobot);
    assert_eq!(publication.notes().len(), 1);
}
