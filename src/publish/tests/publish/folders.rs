//! Datasets published to folders.

use std::{fs, path::Path, process::Command};

use reel_publish::{FileStatus, Plan, PublishError, existing_files, publish_to_folder};

use crate::sample::{export, files, list, open};

fn publish(source: &Path, target: &Path, delete: bool) -> Plan {
    let publication = open(source);
    let plan = Plan::new(
        publication.files(),
        &existing_files(source, target).unwrap(),
    );
    publish_to_folder(&publication, &plan, target, delete, |_| ()).unwrap();
    plan
}

/// What is beside a target: a staged folder must not stay.
fn entries(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn a_folder_holds_the_dataset_and_checksums_that_hold() {
    let folder = tempfile::tempdir().unwrap();
    let (source, target) = (folder.path().join("source"), folder.path().join("a/target"));
    export(&source);
    let before = files(&source);
    let plan = publish(&source, &target, false);
    assert_eq!(plan.count(FileStatus::New), plan.files.len());
    assert_eq!(before, files(&source), "the dataset is not changed");
    let mut there = files(&target);
    assert!(
        there
            .remove(".gitattributes")
            .unwrap()
            .starts_with(b"*.jsonl filter=lfs")
    );
    assert!(there.remove("SHA256SUMS").is_some());
    assert_eq!(there, before);
    assert_eq!(entries(&folder.path().join("a")), ["target"]);
    let checked = Command::new("sha256sum")
        .args(["--check", "--strict", "SHA256SUMS"])
        .current_dir(&target)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&checked.stdout);
    assert!(checked.status.success(), "{said}");
    assert_eq!(said.lines().count(), plan.files.len() - 1, "{said}");

    // what was published can be published again, to the same bytes
    let copy = folder.path().join("copy");
    publish(&target, &copy, false);
    assert_eq!(files(&copy), files(&target));
}

#[test]
fn only_what_changed_is_new_and_what_is_only_there_stays() {
    let folder = tempfile::tempdir().unwrap();
    let (source, target) = (folder.path().join("source"), folder.path().join("target"));
    export(&source);
    publish(&source, &target, false);
    let plan = Plan::new(
        open(&source).files(),
        &existing_files(&source, &target).unwrap(),
    );
    assert!(plan.is_done(true));

    fs::rename(source.join("images/a.png"), source.join("images/b.png")).unwrap();
    list(&source);
    let plan = publish(&source, &target, false);
    let changed = plan.files.iter();
    let changed: Vec<&str> = changed
        .filter(|file| file.status == FileStatus::Changed)
        .map(|file| file.path.as_str())
        .collect();
    assert_eq!(changed, ["SHA256SUMS", "manifest.json"]);
    assert_eq!(plan.only_at_target, ["images/a.png"]);
    assert_eq!(entries(&target.join("images")), ["a.png", "b.png"]);
    assert!(!plan.is_done(false));

    let plan = publish(&source, &target, true);
    assert_eq!(plan.count(FileStatus::Equal), plan.files.len());
    assert_eq!(entries(&target.join("images")), ["b.png"]);
    assert_eq!(entries(folder.path()), ["source", "target"]);
}

#[test]
fn folders_that_hold_other_things_are_no_target() {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("source");
    export(&source);
    let refused = |target: &Path| {
        let error = existing_files(&source, target).unwrap_err();
        assert!(matches!(error, PublishError::Target { .. }), "{error}");
        error.to_string()
    };
    let other = folder.path().join("other");
    fs::create_dir(&other).unwrap();
    assert!(existing_files(&source, &other).unwrap().is_empty());
    fs::write(other.join("thesis.tex"), "x").unwrap();
    assert!(refused(&other).contains("no published dataset"));
    fs::write(other.join("SHA256SUMS"), "").unwrap();
    assert!(existing_files(&source, &other).is_ok());
    fs::create_dir(other.join(".git")).unwrap();
    assert!(refused(&other).contains("hidden"));
    assert!(refused(&other.join("thesis.tex")).contains("no folder"));
    assert!(refused(&source).contains("in each other"));
    assert!(refused(&source.join("train/published")).contains("in each other"));
    assert!(refused(folder.path()).contains("in each other"));
}

#[test]
fn a_file_that_changes_meanwhile_leaves_the_target_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let (source, target) = (folder.path().join("source"), folder.path().join("target"));
    export(&source);
    publish(&source, &target, false);
    let before = files(&target);
    let publication = open(&source);
    let plan = Plan::new(
        publication.files(),
        &existing_files(&source, &target).unwrap(),
    );
    fs::write(source.join("train/train-00000.jsonl"), "{}\n").unwrap();
    let error = publish_to_folder(&publication, &plan, &target, false, |_| ()).unwrap_err();
    assert!(matches!(error, PublishError::Changed { .. }), "{error}");
    assert_eq!(files(&target), before);
    assert_eq!(entries(folder.path()), ["source", "target"]);
}
