//! Writes a dataset episode by episode: tables and videos grow up to LeRobot's sizes, then the next file begins.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    num::NonZeroU32,
    path::{Path, PathBuf},
    sync::Arc,
};

use arrow::{datatypes::Schema, json::ReaderBuilder};
use parquet::{arrow::ArrowWriter, basic::Compression, file::properties::WriterProperties};
use reel_dataset::{CARD, MANIFEST};
use reel_view::Mp4File;
use serde_json::{Map, Value, json};

use crate::{
    CAMERA, CODEBASE_VERSION, DatasetDescription, EncodedEpisode, ExportSettings, LeRobotError,
    card::card,
    columns::{NUMERIC, episode_schema, features, frame_schema, task_schema},
    episode::timestamp,
    statistics::{ChannelHistograms, of_vectors},
};

/// Files in a folder `chunk-NNN`, and sizes from which on the next file begins.
const CHUNK_FILES: u64 = 1000;
const DATA_MIB: u64 = 100;
const VIDEO_MIB: u64 = 200;
const MIB: u64 = 1 << 20;

/// How much a dataset holds.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct DatasetCounts {
    /// Number of episodes, each from one trace.
    pub episodes: u64,
    /// Number of frames of all episodes.
    pub frames: u64,
    /// Number of different instructions.
    pub tasks: u64,
}

/// A table of several files.
struct Table {
    folder: PathBuf,
    schema: Arc<Schema>,
    file: u64,
    writer: Option<(PathBuf, ArrowWriter<File>)>,
}

/// A dataset that is being written.
pub struct LeRobotWriter {
    root: PathBuf,
    settings: ExportSettings,
    data: Table,
    episodes: Table,
    video: Option<Mp4File>,
    video_file: u64,
    /// The instructions with their numbers.
    tasks: BTreeMap<String, u64>,
    counts: DatasetCounts,
    pixels: ChannelHistograms,
    /// Every number of every column but the video's, for the statistics of all.
    values: BTreeMap<&'static str, Vec<Vec<f64>>>,
    sources: Vec<Value>,
}

impl LeRobotWriter {
    /// Whether a folder is what a writer left that was interrupted.
    pub fn is_unfinished(root: &Path) -> bool {
        let has = |name: &str| root.join(name).exists();
        ["meta", "data", "videos"].into_iter().all(has) && !has("meta/info.json")
    }

    /// A dataset in this folder, which is made.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn create(root: &Path, settings: ExportSettings) -> Result<Self, LeRobotError> {
        for folder in ["meta", "data", "videos"] {
            make(&root.join(folder))?;
        }
        Ok(Self {
            root: root.to_owned(),
            settings,
            data: Table::new(root.join("data"), frame_schema(&settings)),
            episodes: Table::new(root.join("meta/episodes"), episode_schema()),
            video: None,
            video_file: 0,
            tasks: BTreeMap::new(),
            counts: DatasetCounts::default(),
            pixels: ChannelHistograms::new(),
            values: BTreeMap::new(),
            sources: Vec::new(),
        })
    }

    /// Appends an episode that was encoded with the dataset's settings.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn add(&mut self, episode: &EncodedEpisode) -> Result<(), LeRobotError> {
        let next_task = self.tasks.len() as u64;
        let task = *self.tasks.entry(episode.task.clone()).or_insert(next_task);
        self.data.turn_over(DATA_MIB * MIB)?;
        let rows = self.rows(episode, task);
        self.data.write(&rows)?;
        let (video_file, from_timestamp) = self.append_video(episode)?;
        let mut statistics = Map::new();
        for name in NUMERIC {
            let numbers: Vec<Vec<f64>> = rows.iter().map(|row| numbers(&row[name])).collect();
            statistics.insert(name.to_owned(), of_vectors(&numbers).into());
            self.values.entry(name).or_default().extend(numbers);
        }
        statistics.insert(CAMERA.to_owned(), episode.pixels.statistics().into());
        self.pixels.merge(&episode.pixels);
        let length = episode.frames.len() as u64;
        let seconds = length as f64 / f64::from(self.settings.fps());
        let mut row = json!({
            "episode_index": self.counts.episodes, "tasks": [episode.task], "length": length,
            "data/chunk_index": self.data.file / CHUNK_FILES, "data/file_index": self.data.file % CHUNK_FILES,
            "dataset_from_index": self.counts.frames, "dataset_to_index": self.counts.frames + length,
            "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0,
        });
        let video = |name: &str| format!("videos/{CAMERA}/{name}");
        row[video("chunk_index")] = json!(video_file / CHUNK_FILES);
        row[video("file_index")] = json!(video_file % CHUNK_FILES);
        row[video("from_timestamp")] = json!(from_timestamp);
        row[video("to_timestamp")] = json!(from_timestamp + seconds);
        for (column, values) in &statistics {
            for (statistic, value) in values.as_object().into_iter().flatten() {
                row[format!("stats/{column}/{statistic}")] = value.clone();
            }
        }
        for (name, value) in episode.origin.as_object().into_iter().flatten() {
            row[format!("reel/{name}")] = value.clone();
        }
        self.episodes.write(&[row])?;
        self.sources.push(episode.origin.clone());
        self.counts.episodes += 1;
        self.counts.frames += length;
        Ok(())
    }

    /// Completes the files, and writes statistics, tasks, `info.json`, the card and the manifest.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn finish(
        mut self,
        tools: &Value,
        description: &DatasetDescription,
    ) -> Result<DatasetCounts, LeRobotError> {
        self.data.close()?;
        self.episodes.close()?;
        if let Some(video) = self.video.take() {
            video.finish()?;
        }
        let mut ordered: Vec<(&String, &u64)> = self.tasks.iter().collect();
        ordered.sort_by_key(|(_, number)| **number);
        let rows: Vec<Value> = ordered
            .iter()
            .map(|(task, number)| json!({"task": task, "task_index": number}))
            .collect();
        write_table(&self.root.join("meta/tasks.parquet"), task_schema(), &rows)?;
        self.counts.tasks = rows.len() as u64;
        let mut statistics = Map::new();
        statistics.insert(CAMERA.to_owned(), self.pixels.statistics().into());
        for name in NUMERIC {
            let values = self.values.remove(name).unwrap_or_default();
            statistics.insert(name.to_owned(), of_vectors(&values).into());
        }
        self.write_json("meta/stats.json", &statistics.into())?;
        let info = self.info(tools);
        self.write_json("meta/info.json", &info)?;
        let path = self.root.join(CARD);
        let card = card(description, self.counts, self.settings.fps());
        fs::write(&path, card).map_err(|source| LeRobotError::Write { path, source })?;
        let manifest = json!({
            "name": description.name, "format": "lerobot", "codebase_version": CODEBASE_VERSION,
            "command": description.command, "licence": description.licence,
            "build": env!("CARGO_PKG_VERSION"), "subtasks": format!("rules-{}", reel_annotate::version()),
            "episodes": self.sources, "files": reel_dataset::files(&self.root)?,
        });
        self.write_json(MANIFEST, &manifest)?;
        Ok(self.counts)
    }

    /// The rows of an episode, as JSON by column.
    fn rows(&self, episode: &EncodedEpisode, task: u64) -> Vec<Value> {
        let fps = self.settings.fps();
        let numbered = episode.frames.iter().enumerate();
        numbered
            .map(|(at, frame)| {
                json!({
                    "observation.state": frame.state, "action": frame.action, "call.index": frame.call,
                    "call.tool": frame.tool, "call.phase": frame.phase, "next.reward": frame.reward,
                    "next.done": frame.is_last, "language_persistent": episode.persistent,
                    "language_events": frame.events, "timestamp": timestamp(at, fps), "frame_index": at,
                    "episode_index": self.counts.episodes, "index": self.counts.frames + at as u64, "task_index": task,
                })
            })
            .collect()
    }

    /// Appends the frames to the current video; its number, and the second at which they begin.
    fn append_video(&mut self, episode: &EncodedEpisode) -> Result<(u64, f64), LeRobotError> {
        let full = |video: &Mp4File| {
            video.frames() > 0 && video.bytes() + episode.video.bytes() as u64 > VIDEO_MIB * MIB
        };
        if let Some(video) = self.video.take_if(|video| full(video)) {
            video.finish()?;
            self.video_file += 1;
        }
        let fps = self.settings.fps();
        if self.video.is_none() {
            let path = path_of(
                &self.root.join("videos").join(CAMERA),
                self.video_file,
                "mp4",
            )?;
            let timescale = NonZeroU32::new(fps).unwrap_or(NonZeroU32::MIN);
            let begun = Mp4File::create(&path, self.settings.video(), timescale, 1)?;
            self.video = Some(begun);
        }
        let mut begins = 0;
        if let Some(video) = &mut self.video {
            begins = video.frames();
            video.append(&episode.video)?;
        }
        Ok((self.video_file, begins as f64 / f64::from(fps)))
    }

    fn info(&self, tools: &Value) -> Value {
        json!({
            "codebase_version": CODEBASE_VERSION, "robot_type": "reel_home_robot",
            "total_episodes": self.counts.episodes, "total_frames": self.counts.frames, "total_tasks": self.counts.tasks,
            "chunks_size": CHUNK_FILES, "data_files_size_in_mb": DATA_MIB, "video_files_size_in_mb": VIDEO_MIB,
            "fps": self.settings.fps(), "splits": {"train": format!("0:{}", self.counts.episodes)},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
            "features": features(&self.settings), "tools": tools,
        })
    }

    fn write_json(&self, name: &str, value: &Value) -> Result<(), LeRobotError> {
        let path = self.root.join(name);
        fs::write(&path, format!("{value:#}\n"))
            .map_err(|source| LeRobotError::Write { path, source })
    }
}

impl Table {
    fn new(folder: PathBuf, schema: Schema) -> Self {
        Self {
            folder,
            schema: Arc::new(schema),
            file: 0,
            writer: None,
        }
    }

    /// Goes on in the next file if this one has so many bytes.
    fn turn_over(&mut self, bytes: u64) -> Result<(), LeRobotError> {
        let full = self
            .writer
            .as_ref()
            .is_some_and(|(_, writer)| writer.bytes_written() as u64 >= bytes);
        if full {
            self.close()?;
            self.file += 1;
        }
        Ok(())
    }

    /// Appends rows as a row group of their own, so that an episode can be read alone.
    fn write(&mut self, rows: &[Value]) -> Result<(), LeRobotError> {
        if self.writer.is_none() {
            let path = path_of(&self.folder, self.file, "parquet")?;
            let writer = open_table(&path, &self.schema)?;
            self.writer = Some((path, writer));
        }
        if let Some((path, writer)) = &mut self.writer {
            append(path, writer, &self.schema, rows)?;
        }
        Ok(())
    }

    fn close(&mut self) -> Result<(), LeRobotError> {
        if let Some((path, writer)) = self.writer.take() {
            writer
                .close()
                .map_err(|source| LeRobotError::Parquet { path, source })?;
        }
        Ok(())
    }
}

/// The numbers of a value of a column.
fn numbers(value: &Value) -> Vec<f64> {
    let number = |value: &Value| match value {
        Value::Bool(value) => f64::from(u8::from(*value)),
        other => other.as_f64().unwrap_or_default(),
    };
    match value {
        Value::Array(values) => values.iter().map(number).collect(),
        other => vec![number(other)],
    }
}

/// The path of a file by its number, whose folder is made.
fn path_of(folder: &Path, file: u64, extension: &str) -> Result<PathBuf, LeRobotError> {
    let chunk = folder.join(format!("chunk-{:03}", file / CHUNK_FILES));
    make(&chunk)?;
    Ok(chunk.join(format!("file-{:03}.{extension}", file % CHUNK_FILES)))
}

fn write_table(path: &Path, schema: Schema, rows: &[Value]) -> Result<(), LeRobotError> {
    let schema = Arc::new(schema);
    let mut writer = open_table(path, &schema)?;
    append(path, &mut writer, &schema, rows)?;
    let closed = writer.close().map(drop);
    closed.map_err(|source| LeRobotError::Parquet {
        path: path.to_owned(),
        source,
    })
}

fn open_table(path: &Path, schema: &Arc<Schema>) -> Result<ArrowWriter<File>, LeRobotError> {
    let file = File::create(path).map_err(|source| LeRobotError::Write {
        path: path.to_owned(),
        source,
    })?;
    let mut properties = WriterProperties::builder().set_compression(Compression::SNAPPY);
    if let Some(pandas) = schema.metadata().get("pandas") {
        let entry = parquet::file::metadata::KeyValue::new("pandas".to_owned(), pandas.clone());
        properties = properties.set_key_value_metadata(Some(vec![entry]));
    }
    ArrowWriter::try_new(file, schema.clone(), Some(properties.build())).map_err(|source| {
        LeRobotError::Parquet {
            path: path.to_owned(),
            source,
        }
    })
}

fn append(
    path: &Path,
    writer: &mut ArrowWriter<File>,
    schema: &Arc<Schema>,
    rows: &[Value],
) -> Result<(), LeRobotError> {
    let builder = ReaderBuilder::new(schema.clone()).with_batch_size(rows.len().max(1));
    let mut decoder = builder.build_decoder()?;
    decoder.serialize(rows)?;
    let failed = |source| LeRobotError::Parquet {
        path: path.to_owned(),
        source,
    };
    while let Some(batch) = decoder.flush()? {
        writer.write(&batch).map_err(failed)?;
    }
    writer.flush().map_err(failed)
}

fn make(folder: &Path) -> Result<(), LeRobotError> {
    fs::create_dir_all(folder).map_err(|source| LeRobotError::Write {
        path: folder.to_owned(),
        source,
    })
}
