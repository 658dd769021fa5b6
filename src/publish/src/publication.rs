//! A folder that was looked at: what kind of dataset it is, the files that are published with the
//! generated ones, and everything that speaks against publishing it. Changes nothing.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

use reel_world::printable_line;
use serde::Serialize;
use serde_json::Value;

use crate::{
    Check, Problems, PublishError, PublishedFile, card,
    folder::{is_generated, scan, secret_message},
    generated::{CHECKSUMS, GIT_ATTRIBUTES, checksums, git_attributes, read_checksums},
    secrets::{local_path_in, secrets_in},
    texts::{self, Visitor, read_json},
    verdicts::Verdicts,
};

/// The file by which a LeRobot dataset is known.
const LEROBOT_INFO: &str = "meta/info.json";
/// Lines of the card that are shown before anything is published.
const HEAD_LINES: usize = 40;

/// Which kind of dataset a folder is.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum DatasetKind {
    /// An export of examples or rollouts, with `manifest.json`.
    Export,
    /// An export of preference pairs, with `manifest.json`.
    Preferences,
    /// A LeRobot dataset of version 3, of Reel or of any origin.
    #[serde(rename = "lerobot")]
    LeRobot,
}

/// A dataset as it would be published.
#[derive(Clone, Debug)]
pub struct Publication {
    kind: DatasetKind,
    files: BTreeMap<String, PublishedFile>,
    problems: Problems,
    notes: Vec<String>,
    card: Option<String>,
    card_head: Vec<String>,
}

impl Publication {
    /// Reads a folder whole and checks it; `progress` is told the bytes that were read. Errors of
    /// `reel dataset lint` are the caller's to add.
    ///
    /// # Errors
    /// Fails if the folder is no dataset, holds too much or cannot be read. Everything else that
    /// is wrong is in [`Publication::problems`].
    pub fn open(root: &Path, mut progress: impl FnMut(u64)) -> Result<Self, PublishError> {
        let kind = DatasetKind::of(root)?;
        let mut problems = Problems::default();
        let mut files = scan(root, &mut problems, &mut progress)?;
        let mut notes = Vec::new();
        let card = card::check(root, &files, &mut problems);
        check_manifest(root, kind, &files, &mut problems, &mut notes)?;
        check_checksums(&files, &mut problems)?;
        check_texts(kind, &files, &mut problems);
        add_generated(&mut files);
        let head = card.as_ref().map_or("", |card| &card.head);
        Ok(Self {
            kind,
            files,
            problems,
            notes,
            card_head: head.lines().take(HEAD_LINES).map(printable_line).collect(),
            card: card.map(|card| card.text),
        })
    }

    /// Which kind of dataset it is.
    pub fn dataset_kind(&self) -> DatasetKind {
        self.kind
    }

    /// The files that are published, by path.
    pub fn files(&self) -> &BTreeMap<String, PublishedFile> {
        &self.files
    }

    /// What speaks against publishing.
    pub fn problems(&self) -> &Problems {
        &self.problems
    }

    /// What the caller found itself is added here.
    pub fn problems_mut(&mut self) -> &mut Problems {
        &mut self.problems
    }

    /// What is worth knowing and no problem, safe to print.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// The first lines of the card's front matter, safe to print.
    pub fn card_head(&self) -> &[String] {
        &self.card_head
    }

    /// The whole card; `None` if there is none that can be read.
    pub fn card(&self) -> Option<&str> {
        self.card.as_deref()
    }
}

impl DatasetKind {
    /// The kind of a folder, by the files that only this kind has.
    ///
    /// # Errors
    /// Fails if the folder is no dataset that can be published.
    pub fn of(root: &Path) -> Result<Self, PublishError> {
        let refuse = |reason: String| PublishError::NoDataset {
            path: root.to_owned(),
            reason,
        };
        let metadata = fs::metadata(root).map_err(PublishError::read(root))?;
        if !metadata.is_dir() {
            return Err(refuse("it is no folder".to_owned()));
        }
        let is_file =
            |name: &str| fs::symlink_metadata(root.join(name)).is_ok_and(|entry| entry.is_file());
        if is_file(LEROBOT_INFO) {
            let info = read_json(&root.join(LEROBOT_INFO))
                .map_err(|reason| refuse(format!("{LEROBOT_INFO}: {}", printable_line(&reason))))?;
            let version = info["codebase_version"].as_str().unwrap_or_default();
            return if version.starts_with("v3.") {
                Ok(Self::LeRobot)
            } else {
                let version = printable_line(&version.chars().take(32).collect::<String>());
                Err(refuse(format!(
                    "a LeRobot dataset of version '{version}'; convert it to version 3 with LeRobot"
                )))
            };
        }
        if !is_file(reel_dataset::MANIFEST) {
            return Err(refuse(format!(
                "neither {} nor {LEROBOT_INFO} is in the folder",
                reel_dataset::MANIFEST
            )));
        }
        let manifest = read_json(&root.join(reel_dataset::MANIFEST)).map_err(|reason| {
            refuse(format!(
                "{}: {}",
                reel_dataset::MANIFEST,
                printable_line(&reason)
            ))
        })?;
        match manifest["format"].as_str() {
            Some("preferences") if manifest["files"].is_array() => Ok(Self::Preferences),
            Some(_) if manifest["files"].is_array() => Ok(Self::Export),
            _ => Err(refuse(format!(
                "{} is not the manifest of an export",
                reel_dataset::MANIFEST
            ))),
        }
    }
}

/// Adds `.gitattributes` where there is none, and the checksums of all files.
fn add_generated(files: &mut BTreeMap<String, PublishedFile>) {
    if !files.contains_key(GIT_ATTRIBUTES) {
        let bytes = git_attributes(files);
        let file = PublishedFile::in_memory(GIT_ATTRIBUTES, bytes);
        files.insert(file.path.clone(), file);
    }
    let sums = PublishedFile::in_memory(CHECKSUMS, checksums(files));
    files.insert(sums.path.clone(), sums);
}

/// The digests of the manifest against the files, and what it says of the splits.
fn check_manifest(
    root: &Path,
    kind: DatasetKind,
    files: &BTreeMap<String, PublishedFile>,
    problems: &mut Problems,
    notes: &mut Vec<String>,
) -> Result<(), PublishError> {
    let name = reel_dataset::MANIFEST;
    if !files.contains_key(name) {
        if kind == DatasetKind::LeRobot {
            notes.push("no manifest.json: the files are checked by the lint only".to_owned());
        }
        return Ok(());
    }
    let manifest = match read_json(&root.join(name)) {
        Ok(manifest) => manifest,
        Err(reason) => {
            problems.add(Check::Checksums, name, None, &reason);
            return Ok(());
        }
    };
    let mut listed: BTreeMap<&str, &Value> = BTreeMap::new();
    for entry in manifest["files"].as_array().into_iter().flatten() {
        match entry["path"].as_str().filter(|path| is_inside(path)) {
            Some(path) => {
                listed.insert(path, entry);
            }
            None => {
                let message = format!("it lists a file outside of the folder: {}", entry["path"]);
                problems.add(Check::Checksums, name, None, &message);
            }
        }
    }
    for (path, entry) in &listed {
        let Some(file) = files.get(*path) else {
            let message = "manifest.json lists it, and it is not there; export again";
            problems.add(Check::Checksums, path, None, message);
            continue;
        };
        if entry["blake3"] == file.blake3.as_str() && entry["bytes"] == file.bytes {
            continue;
        }
        if *path == reel_dataset::CARD {
            notes.push("the card was edited after the export".to_owned());
        } else {
            let message = "it is not the file that manifest.json lists; export again";
            problems.add(Check::Checksums, path, None, message);
        }
    }
    for path in files.keys() {
        if path != name && !is_generated(path) && !listed.contains_key(path.as_str()) {
            let message = "manifest.json does not list it; remove it, or export again";
            problems.add(Check::Checksums, path, None, message);
        }
    }
    check_leakage(&manifest, problems);
    Ok(())
}

/// Whether a path of a manifest stays in its folder.
fn is_inside(path: &str) -> bool {
    !path.is_empty()
        && !path.contains('\\')
        && path
            .split('/')
            .all(|part| !part.is_empty() && part != "." && part != "..")
}

/// What the export itself found in two splits: tasks, and scenes where it split by scene.
fn check_leakage(manifest: &Value, problems: &mut Problems) {
    let by_scene = manifest["options"]["split_by"] == "scene";
    for leak in manifest["leakage"].as_array().into_iter().flatten() {
        let kind = leak["kind"].as_str().unwrap_or_default();
        if kind == "task" || (kind == "scene" && by_scene) {
            let key = leak["key"].as_str().unwrap_or_default();
            let key: String = key.chars().take(100).collect();
            let message = format!("{kind} {key} is in two splits; export again");
            problems.add(Check::Splits, reel_dataset::MANIFEST, None, &message);
        }
    }
}

/// The checksums that the folder brings along against its files.
fn check_checksums(
    files: &BTreeMap<String, PublishedFile>,
    problems: &mut Problems,
) -> Result<(), PublishError> {
    let Some(sums) = files.get(CHECKSUMS) else {
        return Ok(());
    };
    let place = sums.place();
    let text = fs::read_to_string(&place).map_err(PublishError::read(&place))?;
    let Some(entries) = read_checksums(&text) else {
        let message = "no list as sha256sum writes it; remove it, publishing writes a new one";
        problems.add(Check::Checksums, CHECKSUMS, None, message);
        return Ok(());
    };
    let listed: BTreeSet<&str> = entries.iter().map(|(path, _)| *path).collect();
    for path in files.keys() {
        if !is_generated(path) && !listed.contains(path.as_str()) {
            let message = "SHA256SUMS does not list it; remove it, or SHA256SUMS if the file was meant to be added";
            problems.add(Check::Checksums, path, None, message);
        }
    }
    for (path, digest) in entries {
        if files.get(path).is_none_or(|file| file.sha256 != digest) {
            let message = "SHA256SUMS has another digest of it; remove SHA256SUMS if the file was meant to change";
            problems.add(Check::Checksums, path, None, message);
        }
    }
    Ok(())
}

/// Secrets, paths and verdicts in the texts of all files.
fn check_texts(
    kind: DatasetKind,
    files: &BTreeMap<String, PublishedFile>,
    problems: &mut Problems,
) {
    let mut verdicts = Verdicts::new(kind);
    for (path, file) in files.iter().filter(|(_, file)| file.bytes > 0) {
        let mut visitor = TextChecks {
            path,
            problems,
            verdicts: &mut verdicts,
            secrets: BTreeSet::new(),
        };
        let visited = texts::visit(&file.place(), &mut visitor);
        let with_lines = visitor.secrets;
        for kind in file
            .secrets
            .iter()
            .filter(|kind| !with_lines.contains(*kind))
        {
            problems.add(Check::Secrets, path, None, &secret_message(kind));
        }
        if let Err(reason) = visited {
            problems.add(Check::Files, path, None, &format!("{reason}; export again"));
        }
    }
    verdicts.finish(problems);
}

struct TextChecks<'a> {
    path: &'a str,
    problems: &'a mut Problems,
    verdicts: &'a mut Verdicts,
    /// The kinds of secrets that were found in a line or row.
    secrets: BTreeSet<&'static str>,
}

impl TextChecks<'_> {
    fn find_secrets(&mut self, line: u64, bytes: &[u8]) {
        let line = (line > 0).then_some(line);
        for kind in secrets_in(bytes) {
            self.secrets.insert(kind);
            self.problems
                .add(Check::Secrets, self.path, line, &secret_message(kind));
        }
    }
}

impl Visitor for TextChecks<'_> {
    fn text(&mut self, line: u64, text: &str) {
        self.find_secrets(line, text.as_bytes());
        if let Some(found) = local_path_in(text) {
            let message = format!(
                "a path of one machine, {found}; export from the folder that holds traces and files, by relative paths"
            );
            let line = (line > 0).then_some(line);
            self.problems
                .add(Check::LocalPaths, self.path, line, &message);
        }
    }

    fn bytes(&mut self, line: u64, bytes: &[u8]) {
        self.find_secrets(line, bytes);
    }

    fn json_row(&mut self, line: u64, value: &Value) {
        self.verdicts
            .json_row(self.path, line, value, self.problems);
    }

    fn table_row(&mut self, line: u64, value: &dyn Fn(&str) -> Option<String>) {
        self.verdicts
            .table_row(self.path, line, value, self.problems);
    }
}
