//! What is wrong with a LeRobot dataset of version 3, ours or anybody's: metadata against data, videos and
//! statistics, splits, duplicates, and ground truth in observations.
//!
//! Reads file by file in batches and keeps per episode only its place, its task and a digest. Changes nothing.

mod findings;
mod folder;
mod frames;
mod tables;
mod videos;

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
    path::{Path, PathBuf},
};

use reel_dataset::lint::{CheckReport, Severity, write_checks};
use serde::Serialize;

use findings::Check;
use folder::Folder;
use frames::Scan;

/// Why a dataset cannot be checked at all.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum LeRobotLintError {
    /// A file cannot be read.
    #[error("cannot read: {source}: {path}", path = path.display())]
    Read {
        path: PathBuf,
        source: std::io::Error,
    },
    /// `info.json` does not say what the rest is read by.
    #[error("no information about a dataset of version 3: {reason}: {path}", path = path.display())]
    Info { path: PathBuf, reason: String },
    /// A table of the metadata is no whole Parquet file.
    #[error("not a whole Parquet file: {reason}: {path}", path = path.display())]
    Table { path: PathBuf, reason: String },
}

/// What the checks found.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct LeRobotReport {
    /// Number of episodes in the metadata.
    pub episodes: u64,
    /// Number of frames that were read.
    pub frames: u64,
    /// One for each check.
    pub checks: Vec<CheckReport>,
}

impl LeRobotReport {
    /// Whether anything is an error: the command's answer is then "no" (exit code 1).
    pub fn is_bad(&self) -> bool {
        self.checks
            .iter()
            .any(|check| check.worst == Some(Severity::Error))
    }

    /// The report of one check.
    pub fn check(&self, name: &str) -> Option<&CheckReport> {
        self.checks.iter().find(|check| check.check == name)
    }
}

impl fmt::Display for LeRobotReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{} frames of {} episodes in a LeRobot dataset",
            self.frames, self.episodes
        )?;
        write_checks(f, &self.checks)
    }
}

/// Whether a folder is a LeRobot dataset of version 3: its `meta/info.json` names the version.
pub fn is_lerobot(root: &Path) -> bool {
    let info = std::fs::read(root.join("meta/info.json")).unwrap_or_default();
    let info: serde_json::Value = serde_json::from_slice(&info).unwrap_or_default();
    info["codebase_version"]
        .as_str()
        .is_some_and(|version| version.starts_with("v3"))
}

/// Checks a dataset; `progress` is told the number of frames read so far, and `examples` findings of each kind are kept.
///
/// # Errors
/// When `info.json` or the tables of the metadata cannot be read.
pub fn lint(
    root: &Path,
    examples: usize,
    mut progress: impl FnMut(u64),
) -> Result<LeRobotReport, LeRobotLintError> {
    let folder = Folder::open(root)?;
    let check = |name, description| Check::new(name, description, examples);
    let mut frames = check(
        "frames",
        "indices, times and tasks of the frames, and values that are no numbers",
    );
    let mut features = check("features", "columns that are not what info.json says");
    let mut episodes = check("episodes", "places of the episodes against the frames");
    let scan = Scan::run(
        &folder,
        &mut frames,
        &mut features,
        &mut episodes,
        &mut progress,
    );
    let mut metadata = check("metadata", "totals of info.json against tables and frames");
    totals(&folder, &scan, &mut metadata);
    words_of_tasks(&folder, &scan, &mut metadata);
    folder.check_episodes(&mut episodes);
    scan.check_episodes(&folder, &mut episodes);
    let mut videos = check("videos", "video files against the episodes that they show");
    videos::check(&folder, &mut videos);
    let mut statistics = check("statistics", "meta/stats.json against the frames");
    scan.check_statistics(&folder, &mut statistics);
    let mut splits = check(
        "splits",
        "parts that overlap, leave out episodes or share tasks",
    );
    let parts = splits_of(&folder, &scan, &mut splits);
    let mut duplicates = check("duplicates", "episodes with equal states and actions");
    repeated(&scan, &parts, &mut duplicates);
    let mut leaks = check(
        "leaks",
        "observations that tell the goal, the reward, success or the action",
    );
    scan.check_leaks(&folder, &mut leaks);
    let checks = [
        metadata, features, episodes, frames, videos, statistics, splits, duplicates, leaks,
    ];
    Ok(LeRobotReport {
        episodes: folder.episodes.len() as u64,
        frames: scan.frames,
        checks: checks.map(|check| check.finish(scan.frames)).into(),
    })
}

/// The words of the tasks: one row a task, and the same words in the tables of tasks and of episodes, which loaders
/// take an instruction from.
fn words_of_tasks(folder: &Folder, scan: &Scan, check: &mut Check) {
    let mut by_index: BTreeMap<i64, &Vec<String>> = BTreeMap::new();
    let mut known: BTreeSet<&String> = BTreeSet::new();
    for (index, words) in &folder.tasks {
        let repeated = by_index.insert(*index, words).is_some();
        if repeated || words.iter().any(|words| !known.insert(words)) {
            let message = format!("task {index} stands twice in meta/tasks.parquet: {words:?}");
            check.add("repeated-task", Severity::Error, None, message);
        }
    }
    for episode in &folder.episodes {
        let (Some(told), Ok(index)) = (&episode.tasks, u64::try_from(episode.index)) else {
            continue;
        };
        let words = |task| by_index.get(&task).into_iter().flat_map(|it| it.iter());
        let found: BTreeSet<&String> = scan.tasks_of(index).flat_map(words).collect();
        if !found.is_empty() && !told.iter().eq(found.iter().copied()) {
            let message = format!(
                "episode {index} is {found:?} by its frames and meta/tasks.parquet, and {told:?} by meta/episodes"
            );
            check.add("task", Severity::Error, scan.place(index), message);
        }
    }
}

/// The totals of `info.json` against what is there.
fn totals(folder: &Folder, scan: &Scan, check: &mut Check) {
    for (name, found) in [
        ("total_episodes", folder.episodes.len() as u64),
        ("total_frames", scan.frames),
        ("total_tasks", folder.tasks.len() as u64),
    ] {
        match folder.info[name].as_u64() {
            Some(told) if told == found => {}
            Some(told) => check.add(
                "total",
                Severity::Error,
                None,
                format!("{name} is {told}, and there are {found}"),
            ),
            None => check.add(
                "missing",
                Severity::Error,
                None,
                format!("info.json has no {name}, which is {found}"),
            ),
        }
    }
    check.note(format!(
        "{} features, {} fps",
        folder.features.len(),
        folder.fps
    ));
}

/// The parts with their episodes, checked: in range, disjoint, complete, and of different tasks.
fn splits_of(folder: &Folder, scan: &Scan, check: &mut Check) -> BTreeMap<u64, String> {
    let count = folder.episodes.len() as u64;
    let mut parts: BTreeMap<u64, String> = BTreeMap::new();
    let Some(splits) = folder.info["splits"]
        .as_object()
        .filter(|splits| !splits.is_empty())
    else {
        check.add(
            "missing",
            Severity::Warning,
            None,
            "info.json names no splits".to_owned(),
        );
        return parts;
    };
    let mut tasks: BTreeMap<i64, BTreeSet<&str>> = BTreeMap::new();
    for (name, range) in splits {
        let range_text = range.as_str().unwrap_or_default();
        let ends = range_text.split_once(':');
        let ends = ends.and_then(|(from, to)| Some((from.parse().ok()?, to.parse().ok()?)));
        let Some((from, to)) = ends.filter(|(from, to): &(u64, u64)| from <= to && *to <= count)
        else {
            let message =
                format!("split {name} is {range}, which is no range of the {count} episodes");
            check.add("range", Severity::Error, None, message);
            continue;
        };
        for episode in from..to {
            if let Some(other) = parts.insert(episode, name.clone()) {
                let message = format!("episode {episode} is in {other} and in {name}");
                check.add("overlap", Severity::Error, scan.place(episode), message);
            }
            for task in scan.tasks_of(episode) {
                tasks.entry(task).or_default().insert(name);
            }
        }
    }
    let missing = (0..count).filter(|episode| !parts.contains_key(episode));
    for episode in missing {
        let message = format!("episode {episode} is in no split");
        check.add("left-out", Severity::Warning, scan.place(episode), message);
    }
    for (task, names) in tasks.iter().filter(|(_, names)| names.len() > 1) {
        let names: Vec<&str> = names.iter().copied().collect();
        let message = format!("task {task} is in {}", names.join(" and "));
        check.add("shared-task", Severity::Warning, None, message);
    }
    check.note(format!("{} splits", splits.len()));
    parts
}

/// Episodes that are equal to an earlier one; between splits that is worse.
fn repeated(scan: &Scan, parts: &BTreeMap<u64, String>, check: &mut Check) {
    for (first, again) in scan.repeated() {
        let (one, other) = (parts.get(&first), parts.get(&again));
        let (kind, severity) = if one == other {
            ("episode", Severity::Warning)
        } else {
            ("across-splits", Severity::Error)
        };
        let message = format!("episode {again} has the states and actions of episode {first}");
        check.add(kind, severity, scan.place(again), message);
    }
}
