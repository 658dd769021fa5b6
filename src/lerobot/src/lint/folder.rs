//! The metadata of a dataset: what `info.json`, the tasks and the episodes say.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use reel_dataset::lint::Severity;
use serde_json::Value;

use super::{
    LeRobotLintError,
    findings::Check,
    tables::{columns, open, texts},
};

/// What `info.json` says of a column.
pub(super) struct Feature {
    pub(super) dtype: String,
    pub(super) shape: Vec<u64>,
    /// Names of the sides of an image, or of the numbers of a vector, in lower case.
    pub(super) names: Vec<String>,
}

/// Where the frames of an episode are in a video.
#[derive(Clone, Copy)]
pub(super) struct VideoPart {
    pub(super) chunk: i64,
    pub(super) file: i64,
    pub(super) from_s: f64,
    pub(super) to_s: f64,
}

/// What the metadata says of an episode.
pub(super) struct EpisodeEntry {
    pub(super) index: i64,
    pub(super) length: i64,
    pub(super) from: i64,
    pub(super) to: i64,
    pub(super) data: PathBuf,
    pub(super) videos: BTreeMap<String, VideoPart>,
    /// The words of its tasks; none where the table does not tell.
    pub(super) tasks: Option<BTreeSet<String>>,
}

/// A dataset as its metadata describes it.
pub(super) struct Folder {
    pub(super) root: PathBuf,
    pub(super) info: Value,
    pub(super) fps: f64,
    pub(super) features: BTreeMap<String, Feature>,
    /// The words of each task, by `task_index`, in the order of the table.
    pub(super) tasks: Vec<(i64, Vec<String>)>,
    pub(super) episodes: Vec<EpisodeEntry>,
}

impl Folder {
    pub(super) fn open(root: &Path) -> Result<Self, LeRobotLintError> {
        let path = root.join("meta/info.json");
        let bytes = std::fs::read(&path).map_err(|source| LeRobotLintError::Read {
            path: path.clone(),
            source,
        })?;
        let unclear = |reason: String| LeRobotLintError::Info {
            path: path.clone(),
            reason,
        };
        let info: Value =
            serde_json::from_slice(&bytes).map_err(|error| unclear(error.to_string()))?;
        let fps = info["fps"].as_f64().filter(|fps| *fps > 0.0);
        let fps = fps.ok_or_else(|| unclear(format!("fps is {}, not above 0", info["fps"])))?;
        let declared = info["features"].as_object();
        let declared = declared.ok_or_else(|| unclear("there are no features".to_owned()))?;
        let features = declared.iter().map(|(name, feature)| {
            let shape = feature["shape"].as_array().into_iter().flatten();
            let names = feature["names"].as_array().into_iter().flatten();
            let feature = Feature {
                dtype: feature["dtype"].as_str().unwrap_or_default().to_owned(),
                shape: shape
                    .map(|side| side.as_u64().unwrap_or_default())
                    .collect(),
                names: names
                    .filter_map(|name| name.as_str().map(str::to_lowercase))
                    .collect(),
            };
            (name.clone(), feature)
        });
        let mut folder = Self {
            root: root.to_owned(),
            fps,
            features: features.collect(),
            tasks: Vec::new(),
            episodes: Vec::new(),
            info: info.clone(),
        };
        folder.read_tasks()?;
        for path in parquet_files(&root.join("meta/episodes"))? {
            folder.read_episodes(&path)?;
        }
        folder.episodes.sort_by_key(|episode| episode.index);
        Ok(folder)
    }

    /// Whether the table of tasks has this one.
    pub(super) fn has_task(&self, task: i64) -> bool {
        self.tasks.iter().any(|(index, _)| *index == task)
    }

    /// The names of the videos.
    pub(super) fn cameras(&self) -> impl Iterator<Item = &str> {
        let videos = self
            .features
            .iter()
            .filter(|(_, feature)| feature.dtype == "video");
        videos.map(|(name, _)| name.as_str())
    }

    /// A path by a template of `info.json`.
    pub(super) fn path(&self, template: &str, camera: &str, chunk: i64, file: i64) -> PathBuf {
        let template = self.info[template].as_str().unwrap_or_default();
        let name = template
            .replace("{chunk_index:03d}", &format!("{chunk:03}"))
            .replace("{file_index:03d}", &format!("{file:03}"))
            .replace("{video_key}", camera);
        // Nothing outside of the dataset is opened, whatever the template says.
        let inside = Path::new(&name)
            .components()
            .filter(|part| matches!(part, std::path::Component::Normal(_)));
        self.root.join(inside.collect::<PathBuf>())
    }

    /// Episodes follow one another without a gap, in order and each as long as it says.
    pub(super) fn check_episodes(&self, check: &mut Check) {
        let mut next = 0;
        for (expected, episode) in (0..).zip(&self.episodes) {
            let index = episode.index;
            if index != expected {
                let message = format!("episode {index} stands where {expected} should");
                check.add("order", Severity::Error, None, message);
            }
            if episode.from != next {
                let message = format!(
                    "episode {index} begins at frame {}, not at {next}",
                    episode.from
                );
                check.add("range", Severity::Error, None, message);
            }
            if episode.to - episode.from != episode.length {
                let message = format!(
                    "episode {index} has the frames {}..{} and the length {}",
                    episode.from, episode.to, episode.length
                );
                check.add("length", Severity::Error, None, message);
            }
            next = episode.to;
        }
    }

    fn read_tasks(&mut self) -> Result<(), LeRobotLintError> {
        let path = self.root.join("meta/tasks.parquet");
        let broken = |reason| LeRobotLintError::Table {
            path: path.clone(),
            reason,
        };
        let (_, batches) = open(&path, |_| true).map_err(broken)?;
        for batch in batches {
            let batch = batch.map_err(broken)?;
            let columns = columns(&batch);
            let tasks = columns.get("task_index");
            let tasks = tasks.ok_or_else(|| broken("no column task_index".to_owned()))?;
            // LeRobot's own have the words as the index of a table of pandas.
            let mut words = batch.columns().iter().find_map(texts).unwrap_or_default();
            words.resize(batch.num_rows(), Vec::new());
            let rows = words.into_iter().enumerate();
            self.tasks
                .extend(rows.filter_map(|(row, words)| Some((tasks.integer(row)?, words))));
        }
        Ok(())
    }

    fn read_episodes(&mut self, path: &Path) -> Result<(), LeRobotLintError> {
        let broken = |reason| LeRobotLintError::Table {
            path: path.to_owned(),
            reason,
        };
        let cameras: Vec<String> = self.cameras().map(str::to_owned).collect();
        let (_, batches) = open(path, |name| !name.starts_with("stats/")).map_err(broken)?;
        for batch in batches {
            let batch = batch.map_err(broken)?;
            let columns = columns(&batch);
            let tasks = batch.column_by_name("tasks").and_then(texts);
            let value = |name: &str, row: usize| -> Result<f64, LeRobotLintError> {
                let column = columns.get(name);
                let column =
                    column.ok_or_else(|| broken(format!("no column {name} of numbers")))?;
                Ok(column.row(row).first().copied().unwrap_or(f64::NAN))
            };
            let integer = |name: &str, row: usize| value(name, row).map(|value| value as i64);
            for row in 0..batch.num_rows() {
                let mut videos = BTreeMap::new();
                for camera in &cameras {
                    let part = |name: &str| value(&format!("videos/{camera}/{name}"), row);
                    let part = VideoPart {
                        chunk: part("chunk_index")? as i64,
                        file: part("file_index")? as i64,
                        from_s: part("from_timestamp")?,
                        to_s: part("to_timestamp")?,
                    };
                    videos.insert(camera.clone(), part);
                }
                let [chunk, file] = [
                    integer("data/chunk_index", row)?,
                    integer("data/file_index", row)?,
                ];
                self.episodes.push(EpisodeEntry {
                    index: integer("episode_index", row)?,
                    length: integer("length", row)?,
                    from: integer("dataset_from_index", row)?,
                    to: integer("dataset_to_index", row)?,
                    data: self.path("data_path", "", chunk, file),
                    videos,
                    tasks: tasks
                        .as_ref()
                        .map(|tasks| tasks[row].iter().cloned().collect()),
                });
            }
        }
        Ok(())
    }
}

/// The Parquet files two levels below a folder, as LeRobot finds them, in order.
pub(super) fn parquet_files(folder: &Path) -> Result<Vec<PathBuf>, LeRobotLintError> {
    let list = |folder: &Path| -> Result<Vec<PathBuf>, LeRobotLintError> {
        let unreadable = |source| LeRobotLintError::Read {
            path: folder.to_owned(),
            source,
        };
        let mut found = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(unreadable)? {
            found.push(entry.map_err(unreadable)?.path());
        }
        found.sort();
        Ok(found)
    };
    let mut files = Vec::new();
    for chunk in list(folder)?.iter().filter(|path| path.is_dir()) {
        let parquet = |path: &PathBuf| path.extension().is_some_and(|end| end == "parquet");
        files.extend(list(chunk)?.into_iter().filter(parquet));
    }
    Ok(files)
}
