//! One pass over the frames: what their indices, times, tasks and values are, and what is compared afterwards.

use std::{
    borrow::Cow,
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use arrow::{
    array::RecordBatch,
    datatypes::{DataType, Field, Schema},
};
use reel_dataset::lint::{ExampleRef, Severity};
use reel_world::Digest;

use super::{
    findings::{Check, place},
    folder::{Feature, Folder, parquet_files},
    tables::{Numbers, columns, open},
};

/// Seconds by which a timestamp may differ from its frame's, as LeRobot tolerates it.
const TOLERANCE_S: f64 = 1e-4;
/// Words in the name of an observation that tell what an agent has to find out.
const GROUND_TRUTH: [&str; 8] = [
    "goal",
    "success",
    "reward",
    "ground_truth",
    "oracle",
    "privileged",
    "target",
    "label",
];
/// These columns say where a frame is; LeRobot's tools keep their statistics from before a change.
const BOOKKEEPING: [&str; 5] = [
    "timestamp",
    "frame_index",
    "episode_index",
    "index",
    "task_index",
];

/// Running statistics of a number of a column.
#[derive(Clone, Copy)]
struct Running {
    min: f64,
    max: f64,
    mean: f64,
    /// Sum of the squares of the differences from the mean.
    squares: f64,
    count: f64,
}

/// What is known of an episode after its frames were read.
struct EpisodeSeen {
    first: ExampleRef,
    first_index: i64,
    file: PathBuf,
    frames: i64,
    tasks: BTreeSet<i64>,
    /// Of states and actions, frame by frame.
    digest: Digest,
}

/// What the frames are.
pub(super) struct Scan {
    pub(super) frames: u64,
    episodes: BTreeMap<i64, EpisodeSeen>,
    columns: BTreeMap<String, Vec<Running>>,
    /// Pairs of an observation and another column that were equal in every frame so far.
    equal: BTreeSet<(String, String)>,
}

/// The columns of a batch as numbers.
type Columns<'a> = BTreeMap<&'a str, Numbers>;

impl Scan {
    pub(super) fn run(
        folder: &Folder,
        frames: &mut Check,
        features: &mut Check,
        episodes: &mut Check,
        progress: &mut impl FnMut(u64),
    ) -> Self {
        let mut scan = Self {
            frames: 0,
            episodes: BTreeMap::new(),
            columns: BTreeMap::new(),
            equal: told_pairs(folder),
        };
        let files = parquet_files(&folder.root.join("data")).unwrap_or_default();
        if files.is_empty() {
            let message = "there is no Parquet file below data".to_owned();
            episodes.add("no-data", Severity::Error, None, message);
        }
        for path in &files {
            let numeric = |name: &str| {
                folder
                    .features
                    .get(name)
                    .is_some_and(|feature| feature.dtype != "language")
            };
            let opened = open(path, numeric).and_then(|(schema, batches)| {
                check_schema(folder, path, &schema, features);
                let mut row = 0;
                for batch in batches {
                    let batch = batch?;
                    scan.batch(folder, path, row, &batch, frames);
                    row += batch.num_rows() as u64;
                    progress(scan.frames);
                }
                Ok(())
            });
            if let Err(reason) = opened {
                let message = format!("{}: not a whole Parquet file: {reason}", path.display());
                episodes.add("unreadable", Severity::Error, None, message);
            }
        }
        scan
    }

    fn batch(
        &mut self,
        folder: &Folder,
        path: &Path,
        first_row: u64,
        batch: &RecordBatch,
        check: &mut Check,
    ) {
        let columns = columns(batch);
        for row in 0..batch.num_rows() {
            let at = place(self.frames, &folder.root, path, first_row + row as u64);
            self.values(&columns, row, &at, check);
            self.frame(folder, path, &columns, row, at, check);
            self.frames += 1;
        }
    }

    /// Takes the values of a frame into the statistics.
    fn values(&mut self, columns: &Columns<'_>, row: usize, at: &ExampleRef, check: &mut Check) {
        for (name, numbers) in columns {
            let values = numbers.row(row);
            if let Some(dimension) = values.iter().position(|value| !value.is_finite()) {
                let message = format!("{name}[{dimension}] is {}", values[dimension]);
                check.add("not-finite", Severity::Error, Some(at.clone()), message);
                continue;
            }
            let running = self.columns.entry((*name).to_owned()).or_default();
            if running.is_empty() {
                running.resize(values.len(), Running::new());
            }
            for (running, value) in running.iter_mut().zip(values) {
                running.add(value);
            }
        }
        self.equal.retain(|(observation, other)| {
            match (
                columns.get(observation.as_str()),
                columns.get(other.as_str()),
            ) {
                (Some(one), Some(two)) => one.row(row) == two.row(row),
                _ => false,
            }
        });
    }

    /// Checks a frame's place in its episode, and takes it into the episode.
    fn frame(
        &mut self,
        folder: &Folder,
        path: &Path,
        columns: &Columns<'_>,
        row: usize,
        at: ExampleRef,
        check: &mut Check,
    ) {
        let integer = |name: &str| columns.get(name).and_then(|numbers| numbers.integer(row));
        let mut complain =
            |kind, message| check.add(kind, Severity::Error, Some(at.clone()), message);
        let Some(episode) = integer("episode_index") else {
            complain("no-episode", "episode_index is no integer".to_owned());
            return;
        };
        let index = integer("index").unwrap_or(-1);
        if index != self.frames as i64 {
            complain("index", format!("index is {index}, not {}", self.frames));
        }
        let seen = self.episodes.entry(episode).or_insert_with(|| EpisodeSeen {
            first: at.clone(),
            first_index: index,
            file: path.to_owned(),
            frames: 0,
            tasks: BTreeSet::new(),
            digest: Digest::of(&[]),
        });
        let frame = integer("frame_index").unwrap_or(-1);
        if frame != seen.frames {
            let message = format!(
                "frame_index of episode {episode} is {frame}, not {}",
                seen.frames
            );
            complain("frame-index", message);
        }
        let expected = seen.frames as f64 / folder.fps;
        let timestamp = columns.get("timestamp").map(|numbers| numbers.row(row));
        let timestamp = timestamp
            .and_then(|values| values.first().copied())
            .unwrap_or(f64::NAN);
        // Times of LeRobot are 32-bit.
        let tolerance = TOLERANCE_S.max(expected * f64::from(f32::EPSILON));
        if timestamp.is_finite() && (timestamp - expected).abs() > tolerance {
            let message = format!(
                "timestamp is {timestamp} s, and at {} fps {expected} s",
                folder.fps
            );
            complain("timestamp", message);
        }
        match integer("task_index") {
            Some(task) if folder.has_task(task) => drop(seen.tasks.insert(task)),
            task => {
                let task = task.map_or("null".to_owned(), |task| task.to_string());
                complain(
                    "task",
                    format!("task_index {task} is not in meta/tasks.parquet"),
                );
            }
        }
        let mut bytes = seen.digest.0.to_vec();
        for (name, numbers) in columns {
            if name.starts_with("observation.") || name.starts_with("action") {
                bytes.extend(
                    numbers
                        .row(row)
                        .iter()
                        .flat_map(|value| value.to_bits().to_le_bytes()),
                );
            }
        }
        seen.digest = Digest::of(&bytes);
        seen.frames += 1;
    }

    /// What the metadata says of each episode against its frames.
    pub(super) fn check_episodes(&self, folder: &Folder, check: &mut Check) {
        let mut told = BTreeSet::new();
        for episode in &folder.episodes {
            told.insert(episode.index);
            let index = episode.index;
            let Some(seen) = self.episodes.get(&index) else {
                let message = format!("episode {index} has no frame");
                check.add("no-frames", Severity::Error, None, message);
                continue;
            };
            let first = || Some(seen.first.clone());
            if seen.frames != episode.length {
                let message = format!(
                    "episode {index} has {} frames, and its length is {}",
                    seen.frames, episode.length
                );
                check.add("frame-count", Severity::Error, first(), message);
            }
            if seen.first_index != episode.from {
                let message = format!(
                    "episode {index} begins at index {}, and dataset_from_index is {}",
                    seen.first_index, episode.from
                );
                check.add("first-index", Severity::Error, first(), message);
            }
            if seen.file != episode.data {
                let message = format!(
                    "episode {index} is in {}, and should be in {}",
                    seen.file.display(),
                    episode.data.display()
                );
                check.add("file", Severity::Error, first(), message);
            }
        }
        for (index, seen) in self
            .episodes
            .iter()
            .filter(|(index, _)| !told.contains(index))
        {
            let message = format!("episode {index} has frames, and meta/episodes does not name it");
            check.add(
                "unknown",
                Severity::Error,
                Some(seen.first.clone()),
                message,
            );
        }
    }

    /// The stored statistics against those of the frames; those of images are not computed again.
    pub(super) fn check_statistics(&self, folder: &Folder, check: &mut Check) {
        let path = folder.root.join("meta/stats.json");
        let stored: Option<serde_json::Value> = std::fs::read(&path)
            .ok()
            .and_then(|bytes| serde_json::from_slice(&bytes).ok());
        let Some(stored) = stored else {
            check.not_applicable("no readable meta/stats.json");
            return;
        };
        for (name, frames) in &self.columns {
            let Some(stored) = stored.get(name) else {
                let message = format!("there are none of {name}");
                check.add("missing", Severity::Warning, None, message);
                continue;
            };
            let mut complain = |kind: &'static str, message: String| {
                if BOOKKEEPING.contains(&name.as_str()) {
                    let message = format!(
                        "{message}; no trainer reads it, and delete_episodes, split_dataset and merge_datasets of \
                         LeRobot do not compute it anew"
                    );
                    check.add("bookkeeping", Severity::Warning, None, message);
                } else {
                    check.add(kind, Severity::Error, None, message);
                }
            };
            let shape = folder.features.get(name).map(|feature| &feature.shape[..]);
            let shape = shape.unwrap_or_default();
            let running = as_stored(frames, shape, flat(&stored["min"]).len());
            for (statistic, of) in STATISTICS {
                let told = flat(&stored[statistic]);
                let found: Vec<f64> = if statistic == "count" {
                    frames.first().map(of).into_iter().collect()
                } else {
                    running.iter().map(of).collect()
                };
                let close = |(told, found): (&f64, &f64)| {
                    (told - found).abs() <= 1e-4 * found.abs().max(told.abs()).max(1.0)
                };
                if told.len() != found.len() || !told.iter().zip(&found).all(close) {
                    let message =
                        format!("{statistic} of {name} is {told:?}, and the frames give {found:?}");
                    complain("differs", message);
                }
            }
            check_quantiles(name, stored, &running, &mut complain);
        }
        check.note(format!("{} columns", self.columns.len()));
    }

    /// Observations whose names or values tell what an agent should find out.
    pub(super) fn check_leaks(&self, folder: &Folder, check: &mut Check) {
        let mut looked = 0;
        for (name, feature) in &folder.features {
            let Some(observation) = name.strip_prefix("observation.") else {
                continue;
            };
            looked += 1;
            let parts = folder.info["features"][name]["names"]
                .as_array()
                .into_iter()
                .flatten();
            let parts = parts.filter_map(|part| part.as_str()).chain([observation]);
            for part in parts {
                let words = part.to_lowercase();
                if let Some(word) = GROUND_TRUTH.iter().find(|word| words.contains(**word)) {
                    let message = format!("{name}: {part} names a {word} ({})", feature.dtype);
                    check.add("name", Severity::Warning, None, message);
                }
            }
        }
        for (observation, other) in self.equal.iter().filter(|_| self.frames > 1) {
            if self.varies(observation) {
                let message = format!("{observation} equals {other} in every frame");
                check.add("equal", Severity::Error, None, message);
            }
        }
        check.note(format!("{looked} observations"));
    }

    /// Where an episode begins.
    pub(super) fn place(&self, episode: u64) -> Option<ExampleRef> {
        let seen = self.episodes.get(&i64::try_from(episode).ok()?)?;
        Some(seen.first.clone())
    }

    /// The numbers of the tasks of an episode.
    pub(super) fn tasks_of(&self, episode: u64) -> impl Iterator<Item = i64> {
        let episode = i64::try_from(episode).unwrap_or(i64::MAX);
        let tasks = self.episodes.get(&episode).map(|seen| seen.tasks.clone());
        tasks.unwrap_or_default().into_iter()
    }

    /// Pairs of an episode and an equal later one.
    pub(super) fn repeated(&self) -> Vec<(u64, u64)> {
        let mut known: BTreeMap<Digest, u64> = BTreeMap::new();
        let mut pairs = Vec::new();
        for (episode, seen) in &self.episodes {
            let episode = u64::try_from(*episode).unwrap_or_default();
            match known.get(&seen.digest) {
                Some(first) => pairs.push((*first, episode)),
                None => drop(known.insert(seen.digest, episode)),
            }
        }
        pairs
    }

    fn varies(&self, column: &str) -> bool {
        let running = self.columns.get(column);
        running.is_some_and(|all| all.iter().any(|running| running.min < running.max))
    }
}

/// How a statistic follows from what was taken.
type Statistic = fn(&Running) -> f64;

/// Each statistic by its name in `stats.json`.
const STATISTICS: [(&str, Statistic); 5] = [
    ("min", |running| running.min),
    ("max", |running| running.max),
    ("mean", |running| running.mean),
    ("std", |running| (running.squares / running.count).sqrt()),
    ("count", |running| running.count),
];

/// Names of the quantiles in `stats.json`, from the lowest.
const QUANTILES: [&str; 5] = ["q01", "q10", "q50", "q90", "q99"];

impl Running {
    fn new() -> Self {
        Self {
            min: f64::INFINITY,
            max: f64::NEG_INFINITY,
            mean: 0.0,
            squares: 0.0,
            count: 0.0,
        }
    }

    /// Takes a value, by Welford's method.
    fn add(&mut self, value: f64) {
        self.min = self.min.min(value);
        self.max = self.max.max(value);
        self.count += 1.0;
        let difference = value - self.mean;
        self.mean += difference / self.count;
        self.squares += difference * (value - self.mean);
    }

    /// Takes all values that another has taken, by Chan's method.
    fn merge(&mut self, other: &Self) {
        self.min = self.min.min(other.min);
        self.max = self.max.max(other.max);
        let count = self.count + other.count;
        let share = other.count / count.max(1.0);
        let difference = other.mean - self.mean;
        self.mean += difference * share;
        self.squares += other.squares + difference * (self.count * share) * difference;
        self.count = count;
    }
}

/// Gives the statistics of the frames in as many numbers as are stored: LeRobot keeps only the last axis of an array,
/// and every number of it where each episode has one frame.
fn as_stored<'a>(running: &'a [Running], shape: &[u64], stored: usize) -> Cow<'a, [Running]> {
    let last_axis = shape.last().and_then(|side| usize::try_from(*side).ok());
    let last_axis = last_axis
        .filter(|side| (1..=running.len()).contains(side) && running.len().is_multiple_of(*side));
    match last_axis {
        Some(side) if stored != running.len() => {
            let mut kept = vec![Running::new(); side];
            for row in running.chunks_exact(side) {
                for (kept, running) in kept.iter_mut().zip(row) {
                    kept.merge(running);
                }
            }
            Cow::Owned(kept)
        }
        _ => Cow::Borrowed(running),
    }
}

/// Quantiles rise, from the least value to the greatest. What they are exactly is not computed: LeRobot takes them from
/// histograms and averages those of the episodes.
fn check_quantiles(
    name: &str,
    stored: &serde_json::Value,
    running: &[Running],
    complain: &mut impl FnMut(&'static str, String),
) {
    let told = QUANTILES.map(|quantile| (quantile, flat(&stored[quantile])));
    let told: Vec<_> = told
        .iter()
        .filter(|(_, values)| !values.is_empty())
        .collect();
    for (quantile, values) in &told {
        if values.len() != running.len() {
            let message = format!(
                "{quantile} of {name} has {} numbers, and the frames give {}",
                values.len(),
                running.len()
            );
            complain("differs", message);
            return;
        }
    }
    for (at, running) in running.iter().enumerate() {
        if running.count == 0.0 {
            continue;
        }
        let slack = 1e-3 * (running.max - running.min).max(1e-3);
        let mut least = ("min", running.min);
        let greatest = std::iter::once(("max", running.max));
        let told = told
            .iter()
            .map(|(quantile, values)| (*quantile, values[at]));
        for (quantile, value) in told.chain(greatest) {
            if value < least.1 - slack {
                let message = format!(
                    "{quantile} of number {at} of {name} is {value}, below {}, {}",
                    least.0, least.1
                );
                complain("quantiles", message);
                break;
            }
            least = (quantile, value);
        }
    }
}

/// All numbers of a JSON value, however nested.
fn flat(value: &serde_json::Value) -> Vec<f64> {
    match value {
        serde_json::Value::Array(values) => values.iter().flat_map(flat).collect(),
        serde_json::Value::Bool(value) => vec![f64::from(u8::from(*value))],
        other => other.as_f64().into_iter().collect(),
    }
}

/// Observations beside the columns that they must not equal.
fn told_pairs(folder: &Folder) -> BTreeSet<(String, String)> {
    let names = || {
        folder
            .features
            .iter()
            .filter(|(_, feature)| feature.dtype != "video")
    };
    let observations = names().filter(|(name, _)| name.starts_with("observation."));
    let told = |name: &str| name.starts_with("next.") || name.starts_with("action");
    observations
        .flat_map(|(observation, feature)| {
            names()
                .filter(|(name, other)| told(name) && other.shape == feature.shape)
                .map(|(name, _)| (observation.clone(), name.clone()))
        })
        .collect()
}

/// The columns of a file against the features of `info.json`.
fn check_schema(folder: &Folder, path: &Path, schema: &Schema, check: &mut Check) {
    let file = path.strip_prefix(&folder.root).unwrap_or(path).display();
    for (name, feature) in &folder.features {
        let column = schema.field_with_name(name);
        match (feature.dtype.as_str(), column) {
            ("video", Err(_)) => {}
            ("video", Ok(_)) => {
                let message = format!("{name} is a video, and {file} has a column of it");
                check.add("video-column", Severity::Warning, None, message);
            }
            (_, Err(_)) => {
                let message = format!("{name} is not in {file}");
                check.add("missing", Severity::Error, None, message);
            }
            (_, Ok(field)) => {
                if let Some(message) = difference(name, feature, field) {
                    check.add(
                        "type",
                        Severity::Error,
                        None,
                        format!("{message} in {file}"),
                    );
                }
            }
        }
    }
    let unknown = schema
        .fields()
        .iter()
        .filter(|field| !folder.features.contains_key(field.name()));
    for field in unknown {
        let message = format!(
            "{} is in {file}, and info.json does not name it",
            field.name()
        );
        check.add("undeclared", Severity::Error, None, message);
    }
}

/// How the type of a column differs from that of its feature.
fn difference(name: &str, feature: &Feature, field: &Field) -> Option<String> {
    let mut inner = field.data_type();
    let mut depth = 0;
    while let DataType::List(item) | DataType::LargeList(item) | DataType::FixedSizeList(item, _) =
        inner
    {
        if let DataType::FixedSizeList(_, size) = inner {
            let expected = feature.shape.get(depth).copied().unwrap_or_default();
            if u64::try_from(*size) != Ok(expected) {
                return Some(format!(
                    "{name} has the shape {:?}, and lists of {size}",
                    feature.shape
                ));
            }
        }
        inner = item.data_type();
        depth += 1;
    }
    let expected = match feature.dtype.as_str() {
        "float16" => DataType::Float16,
        "float32" => DataType::Float32,
        "float64" => DataType::Float64,
        "int8" => DataType::Int8,
        "int16" => DataType::Int16,
        "int32" => DataType::Int32,
        "int64" => DataType::Int64,
        "uint8" => DataType::UInt8,
        "uint16" => DataType::UInt16,
        "uint32" => DataType::UInt32,
        "uint64" => DataType::UInt64,
        "bool" => DataType::Boolean,
        // Images, texts and words have types of their own.
        _ => return None,
    };
    if *inner != expected {
        return Some(format!("{name} is {}, and {inner}", feature.dtype));
    }
    let dimensions = if feature.shape == [1] {
        0
    } else {
        feature.shape.len()
    };
    (depth != dimensions && !(depth == 1 && feature.shape == [1])).then(|| {
        format!(
            "{name} has the shape {:?}, and {depth} nested lists",
            feature.shape
        )
    })
}
