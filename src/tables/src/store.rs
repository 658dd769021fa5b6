//! The tables on disk: Parquet parts and a manifest that names those that count.
//!
//! `DIR/<table>/part-<number>.parquet`, and `DIR/manifest.json`, which is replaced by an atomic rename: what it does not
//! name does not exist, so a killed ingest leaves nothing half-visible. A part is never changed; when a trace supersedes
//! another, the old one's part is written anew without it. Files out of use are deleted by the *next* ingest, so that a
//! query that runs meanwhile keeps its files.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs::{self, File, TryLockError},
    io::{self, Write},
    path::{Path, PathBuf},
    sync::atomic::{AtomicUsize, Ordering},
};

use arrow::{
    array::{Array, AsArray, BooleanArray, RecordBatch},
    compute::{concat_batches, filter_record_batch},
    error::ArrowError,
};
use parquet::{
    arrow::{ArrowWriter, arrow_reader::ParquetRecordBatchReaderBuilder},
    basic::{Compression, ZstdLevel},
    errors::ParquetError,
    file::properties::WriterProperties,
};
use rayon::prelude::*;
use reel_trace::Trace;
use reel_world::Digest;
use serde::{Deserialize, Serialize};

use crate::{Table, Tables, joined, one};

/// Version of the folder's layout and of the tables' columns.
const FORMAT: u32 = 1;
/// Traces of one part: bounds the memory of an ingest, and what a kill can lose.
const TRACES_PER_PART: usize = 256;
const MANIFEST: &str = "manifest.json";
const LOCK: &str = "lock";

/// Called with (files done, files in all) from several threads.
pub type Progress<'a> = &'a (dyn Fn(usize, usize) + Sync);

/// A folder of tables.
#[derive(Debug)]
pub struct Store {
    dir: PathBuf,
    manifest: Manifest,
}

/// What an ingest did.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize)]
pub struct IngestReport {
    /// Episodes that are new.
    pub added: usize,
    /// Files whose trace is in the store already.
    pub unchanged: usize,
    /// Episodes whose rows were replaced, because a trace of the same episode id has other content.
    pub superseded: usize,
    /// Files left out, with the reason.
    pub quarantined: Vec<(PathBuf, String)>,
}

/// Why the store cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// No store there.
    #[error("no tables here; fill them with `reel ingest`: {dir}", dir = dir.display())]
    NoStore {
        /// Where.
        dir: PathBuf,
    },
    /// Another process ingests.
    #[error("another ingest is writing these tables; wait for it to end: {dir}", dir = dir.display())]
    Busy {
        /// Where.
        dir: PathBuf,
    },
    /// A store of another version.
    #[error("the tables have format {found}, this version reads {FORMAT}; ingest the traces anew into another folder: {dir}", dir = dir.display())]
    OtherFormat {
        /// The manifest's format.
        found: u32,
        /// Where.
        dir: PathBuf,
    },
    /// A file or folder cannot be read or written.
    #[error("cannot {action}: {source}: {path}", path = path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// The system's reason.
        source: io::Error,
        /// Which file.
        path: PathBuf,
    },
    /// The manifest is no manifest.
    #[error("the manifest is damaged: {source}; ingest the traces anew into another folder: {path}", path = path.display())]
    Manifest {
        /// What JSON says.
        source: serde_json::Error,
        /// Which file.
        path: PathBuf,
    },
    /// A part cannot be read or written.
    #[error("part of a table: {source}: {path}", path = path.display())]
    Parquet {
        /// What Parquet says.
        source: ParquetError,
        /// Which file.
        path: PathBuf,
    },
    /// Columns of different parts do not fit together.
    #[error("rows of the tables: {0}")]
    Arrow(#[from] ArrowError),
}

#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Manifest {
    format: u32,
    /// Number of the next part.
    next_part: u64,
    /// File names, the same in every table's folder.
    parts: Vec<String>,
    episodes: BTreeMap<String, Entry>,
    tasks: BTreeSet<Digest>,
    quarantine: BTreeMap<PathBuf, String>,
}

/// Where an episode's rows come from and lie.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Entry {
    trace: PathBuf,
    digest: Digest,
    part: String,
}

/// A trace read and spread into rows.
struct Rows {
    path: PathBuf,
    episode_id: String,
    digest: Digest,
    task: Digest,
    tables: Tables,
}

impl Store {
    /// Opens a store for reading or ingesting.
    ///
    /// # Errors
    /// When there is none, or it is damaged or of another version.
    pub fn open(dir: impl Into<PathBuf>) -> Result<Self, StoreError> {
        let dir = dir.into();
        let manifest = read_manifest(&dir)?.ok_or_else(|| StoreError::NoStore { dir: dir.clone() })?;
        Ok(Self { dir, manifest })
    }

    /// Opens a store, or makes an empty one where there is none.
    ///
    /// # Errors
    /// When the folder cannot be made, or the store is damaged or of another version.
    pub fn open_or_create(dir: impl Into<PathBuf>) -> Result<Self, StoreError> {
        let dir = dir.into();
        for table in Table::ALL {
            let folder = dir.join(table.name());
            fs::create_dir_all(&folder).map_err(io_error("make the folder", &folder))?;
        }
        if read_manifest(&dir)?.is_none() {
            write_manifest(&dir, &Manifest { format: FORMAT, ..Manifest::default() })?;
        }
        Self::open(dir)
    }

    /// The Parquet files of a table.
    pub fn files(&self, table: Table) -> Vec<PathBuf> {
        self.manifest.parts.iter().map(|part| self.dir.join(table.name()).join(part)).collect()
    }

    /// Episode ids with the traces they came from, in order of the ids.
    pub fn episodes(&self) -> impl Iterator<Item = (&str, &Path)> {
        self.manifest.episodes.iter().map(|(id, entry)| (id.as_str(), entry.trace.as_path()))
    }

    /// Files that were left out and not ingested since, with the reason.
    pub fn quarantine(&self) -> impl Iterator<Item = (&Path, &str)> {
        self.manifest.quarantine.iter().map(|(path, reason)| (path.as_path(), reason.as_str()))
    }

    /// Reads traces into the tables, several at a time. A trace that is there already costs nothing more than its reading;
    /// of two with the same episode id and other content the later path wins; a file that is no sound trace is quarantined
    /// and the rest goes on. What is done by the time of a kill stays.
    ///
    /// # Errors
    /// When the store cannot be written, or another ingest is at it.
    pub fn ingest(&mut self, paths: &[PathBuf], progress: Progress<'_>) -> Result<IngestReport, StoreError> {
        let _lock = self.lock()?;
        self.manifest = read_manifest(&self.dir)?.ok_or_else(|| StoreError::NoStore { dir: self.dir.clone() })?;
        self.delete_unused()?;
        let paths: BTreeSet<&PathBuf> = paths.iter().collect();
        let sorted: Vec<&PathBuf> = paths.iter().copied().collect();
        let done = AtomicUsize::new(0);
        let mut report = IngestReport::default();
        for chunk in sorted.chunks(TRACES_PER_PART) {
            let read = |path: &&PathBuf| {
                let rows = read_rows(path);
                progress(done.fetch_add(1, Ordering::Relaxed) + 1, sorted.len());
                rows.map_err(|reason| ((*path).clone(), reason))
            };
            let results: Vec<_> = chunk.par_iter().map(read).collect();
            self.take(results, &paths, &mut report)?;
        }
        Ok(report)
    }

    fn take(
        &mut self,
        results: Vec<Result<Rows, (PathBuf, String)>>,
        paths: &BTreeSet<&PathBuf>,
        report: &mut IngestReport,
    ) -> Result<(), StoreError> {
        let before = self.manifest.quarantine.clone();
        let mut fresh: BTreeMap<String, Rows> = BTreeMap::new();
        let mut replaced: BTreeSet<String> = BTreeSet::new();
        for result in results {
            let rows = match result {
                Ok(rows) => rows,
                Err((path, reason)) => {
                    self.manifest.quarantine.insert(path.clone(), reason.clone());
                    report.quarantined.push((path, reason));
                    continue;
                }
            };
            self.manifest.quarantine.remove(&rows.path);
            if let Some(known) = self.manifest.episodes.get(&rows.episode_id) {
                let later_path_wins = known.trace > rows.path && paths.contains(&known.trace);
                if known.digest == rows.digest || later_path_wins {
                    report.unchanged += 1;
                    continue;
                }
                replaced.insert(rows.episode_id.clone());
            }
            let same_chunk = fresh.get(&rows.episode_id).map(|other| other.digest == rows.digest);
            match same_chunk {
                Some(true) => report.unchanged += 1,
                Some(false) => {
                    report.superseded += 1;
                    fresh.insert(rows.episode_id.clone(), rows);
                }
                None => {
                    let count = if replaced.contains(&rows.episode_id) { &mut report.superseded } else { &mut report.added };
                    *count += 1;
                    fresh.insert(rows.episode_id.clone(), rows);
                }
            }
        }
        if fresh.is_empty() && before == self.manifest.quarantine {
            return Ok(());
        }
        self.commit(fresh, &replaced)
    }

    /// Writes new parts, then the manifest that names them.
    fn commit(&mut self, fresh: BTreeMap<String, Rows>, replaced: &BTreeSet<String>) -> Result<(), StoreError> {
        let mut manifest = self.manifest.clone();
        let touched: BTreeSet<String> = replaced.iter().map(|id| manifest.episodes[id].part.clone()).collect();
        for old in touched {
            let part = manifest.new_part();
            for table in Table::ALL {
                let batch = read_part(&self.dir, table, &old)?;
                let kept = if table.is_by_task() { batch } else { without(&batch, replaced)? };
                write_part(&self.dir, table, &part, &kept)?;
            }
            manifest.parts.retain(|name| *name != old);
            for entry in manifest.episodes.values_mut().filter(|entry| entry.part == old) {
                entry.part.clone_from(&part);
            }
        }
        if !fresh.is_empty() {
            let part = manifest.new_part();
            let mut tables = Vec::new();
            for (episode_id, rows) in fresh {
                let entry = Entry { trace: rows.path, digest: rows.digest, part: part.clone() };
                manifest.episodes.insert(episode_id, entry);
                tables.push((manifest.tasks.insert(rows.task), rows.tables));
            }
            for (table, batch) in joined(&tables)? {
                write_part(&self.dir, table, &part, &batch)?;
            }
        }
        write_manifest(&self.dir, &manifest)?;
        self.manifest = manifest;
        Ok(())
    }

    fn lock(&self) -> Result<File, StoreError> {
        let path = self.dir.join(LOCK);
        let file = File::create(&path).map_err(io_error("make the lock", &path))?;
        match file.try_lock() {
            Ok(()) => Ok(file),
            Err(TryLockError::WouldBlock) => Err(StoreError::Busy { dir: self.dir.clone() }),
            Err(TryLockError::Error(source)) => Err(StoreError::Io { action: "lock", source, path }),
        }
    }

    fn delete_unused(&self) -> Result<(), StoreError> {
        for table in Table::ALL {
            let folder = self.dir.join(table.name());
            for entry in fs::read_dir(&folder).map_err(io_error("list", &folder))? {
                let path = entry.map_err(io_error("list", &folder))?.path();
                let named = path.file_name().is_some_and(|name| self.manifest.parts.iter().any(|part| **part == *name));
                if !named {
                    fs::remove_file(&path).map_err(io_error("delete", &path))?;
                }
            }
        }
        Ok(())
    }
}

impl Manifest {
    fn new_part(&mut self) -> String {
        let name = format!("part-{:06}.parquet", self.next_part);
        self.next_part += 1;
        self.parts.push(name.clone());
        name
    }
}

fn read_rows(path: &Path) -> Result<Rows, String> {
    let trace = Trace::read(path).map_err(|error| error.to_string())?;
    Ok(Rows {
        path: path.to_path_buf(),
        episode_id: trace.header.episode_id.clone(),
        digest: trace.chain(),
        task: trace.header.task_digest,
        tables: one(&trace).map_err(|error| format!("does not fit the tables: {error}"))?,
    })
}

/// The batch without the rows of some episodes.
fn without(batch: &RecordBatch, episodes: &BTreeSet<String>) -> Result<RecordBatch, ArrowError> {
    let ids = batch.column_by_name("episode_id").expect("tables by episode have an episode_id").as_string::<i32>();
    let keep: BooleanArray = (0..ids.len()).map(|row| Some(!episodes.contains(ids.value(row)))).collect();
    filter_record_batch(batch, &keep)
}

fn read_part(dir: &Path, table: Table, part: &str) -> Result<RecordBatch, StoreError> {
    let path = dir.join(table.name()).join(part);
    let file = File::open(&path).map_err(io_error("open", &path))?;
    let parquet_error = |source| StoreError::Parquet { source, path: path.clone() };
    let reader = ParquetRecordBatchReaderBuilder::try_new(file).and_then(|builder| builder.build()).map_err(parquet_error)?;
    let batches = reader.collect::<Result<Vec<_>, _>>()?;
    Ok(concat_batches(&table.schema(), &batches)?)
}

fn write_part(dir: &Path, table: Table, part: &str, batch: &RecordBatch) -> Result<(), StoreError> {
    let path = dir.join(table.name()).join(part);
    let file = File::create(&path).map_err(io_error("make", &path))?;
    let properties = WriterProperties::builder().set_compression(Compression::ZSTD(ZstdLevel::default())).build();
    let parquet_error = |source| StoreError::Parquet { source, path: path.clone() };
    let mut writer = ArrowWriter::try_new(&file, batch.schema(), Some(properties)).map_err(parquet_error)?;
    writer.write(batch).map_err(parquet_error)?;
    writer.close().map_err(parquet_error)?;
    file.sync_all().map_err(io_error("sync", &path))
}

fn read_manifest(dir: &Path) -> Result<Option<Manifest>, StoreError> {
    let path = dir.join(MANIFEST);
    let text = match fs::read(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(io_error("read", &path)(error)),
    };
    let manifest_error = |source| StoreError::Manifest { source, path: path.clone() };
    let value: serde_json::Value = serde_json::from_slice(&text).map_err(manifest_error)?;
    let found = value["format"].as_u64().and_then(|format| u32::try_from(format).ok()).unwrap_or_default();
    if found != FORMAT {
        return Err(StoreError::OtherFormat { found, dir: dir.to_path_buf() });
    }
    serde_json::from_value(value).map(Some).map_err(manifest_error)
}

fn write_manifest(dir: &Path, manifest: &Manifest) -> Result<(), StoreError> {
    let (path, new) = (dir.join(MANIFEST), dir.join("manifest.json.new"));
    let mut text = serde_json::to_vec(manifest).expect("a manifest is JSON");
    text.push(b'\n');
    let mut file = File::create(&new).map_err(io_error("make", &new))?;
    file.write_all(&text).and_then(|()| file.sync_all()).map_err(io_error("write", &new))?;
    fs::rename(&new, &path).map_err(io_error("replace", &path))
}

fn io_error<'a>(action: &'static str, path: &'a Path) -> impl Fn(io::Error) -> StoreError + 'a {
    move |source| StoreError::Io { action, source, path: path.to_path_buf() }
}
