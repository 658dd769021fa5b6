//! Traces as rows, before anybody decides what becomes of them. Knows no store: another
//! machine may do this.

use std::{
    collections::HashSet,
    path::PathBuf,
    sync::{Mutex, PoisonError},
};

use arrow::{
    array::RecordBatch,
    compute::concat_batches,
    ipc::{reader::StreamReader, writer::StreamWriter},
};
use reel_trace::RecordsReader;
use reel_world::Digest;
use serde::{Deserialize, Serialize};

use super::StoreError;
use crate::{Table, rows::Rows};

/// Short digest of a text or of a file's identity, so that much is known in little memory.
pub(super) type Key = u128;

/// Rows of some traces.
pub struct TraceRows {
    pub(super) episodes: RecordBatch,
    pub(super) read: Vec<TraceKey>,
    /// Files that are no sound traces, with the reason.
    pub(super) bad: Vec<(PathBuf, String)>,
    pub(super) tasks: Vec<(Key, RecordBatch)>,
    pub(super) scenes: Vec<(Key, RecordBatch)>,
}

/// A row of episodes.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct TraceKey {
    pub path: String,
    pub episode_id: String,
    pub digest: String,
}

/// Tasks and scenes of which there are rows, or somebody makes them.
#[derive(Default)]
pub struct DocumentSet(Mutex<HashSet<Key>>);

impl DocumentSet {
    pub(super) fn new(keys: impl IntoIterator<Item = Key>) -> Self {
        Self(Mutex::new(keys.into_iter().collect()))
    }

    fn is_new(&self, key: Key) -> bool {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .insert(key)
    }
}

/// What goes before the batches of [`TraceRows::to_bytes`].
#[derive(Serialize, Deserialize)]
struct Head {
    read: Vec<TraceKey>,
    bad: Vec<(PathBuf, String)>,
    tasks: Vec<Key>,
    scenes: Vec<Key>,
}

impl TraceRows {
    /// Reads some traces; a file that is no sound trace is told of, and keeps
    /// the others from nothing.
    ///
    /// # Errors
    /// When Arrow refuses what the tables were made for.
    pub fn read(
        reader: &RecordsReader,
        paths: &[PathBuf],
        seen: &DocumentSet,
    ) -> Result<Self, StoreError> {
        let mut episodes = Rows::new(Table::Episodes)?;
        let empty = RecordBatch::new_empty(Table::Episodes.schema());
        let mut rows = Self {
            episodes: empty,
            read: vec![],
            bad: vec![],
            tasks: vec![],
            scenes: vec![],
        };
        reader.files().prefetch(paths);
        for path in paths {
            if path.to_str().is_none() {
                rows.bad
                    .push((path.clone(), "its name is no UTF-8: rename it".to_owned()));
                continue;
            }
            let trace = match reader.read(path) {
                Ok(trace) => trace,
                Err(error) => {
                    rows.bad.push((path.clone(), error.to_string()));
                    continue;
                }
            };
            // after it was read: then a bucket has told it already
            let modified_ns = reader
                .files()
                .metadata(path)
                .map_or(0, |facts| facts.modified_ns);
            if let Err(error) = episodes.push_episode(&trace, modified_ns) {
                // a row that fails may have filled some of its columns: the rows before it are
                // read again without it
                rows.bad
                    .push((path.clone(), format!("does not fit the tables: {error}")));
                let sound: Vec<PathBuf> = paths
                    .iter()
                    .filter(|other| *other != path)
                    .cloned()
                    .collect();
                let mut rest = Self::read(reader, &sound, seen)?;
                rest.bad
                    .extend(rows.bad.drain(..).filter(|(bad, _)| bad == path));
                rest.tasks.append(&mut rows.tasks);
                rest.scenes.append(&mut rows.scenes);
                return Ok(rest);
            }
            rows.read.push(TraceKey {
                path: path.display().to_string(),
                episode_id: trace.header.episode_id.clone(),
                digest: trace.chain().to_string(),
            });
            let (task, scene) = (
                key(&trace.header.task_digest.to_string()),
                key(&trace.header.scene_digest.to_string()),
            );
            if seen.is_new(task) {
                rows.tasks.push((task, Rows::task(&trace.task)?));
            }
            if seen.is_new(scene) {
                rows.scenes.push((scene, Rows::scene(&trace.scene)?));
            }
        }
        rows.episodes = episodes.finish()?;
        Ok(rows)
    }

    /// For another machine: a length (4 bytes) and JSON, then the batches of episodes, tasks and
    /// scenes as Arrow IPC streams.
    ///
    /// # Errors
    /// When Arrow refuses.
    pub fn to_bytes(&self) -> Result<Vec<u8>, StoreError> {
        let keys = |rows: &[(Key, RecordBatch)]| rows.iter().map(|(key, _)| *key).collect();
        let (read, bad) = (self.read.clone(), self.bad.clone());
        let head = Head {
            read,
            bad,
            tasks: keys(&self.tasks),
            scenes: keys(&self.scenes),
        };
        let head = serde_json::to_vec(&head).map_err(|error| damaged(&error.to_string()))?;
        let mut bytes = (head.len() as u32).to_le_bytes().to_vec();
        bytes.extend(head);
        let joined = |table: Table, rows: &[(Key, RecordBatch)]| {
            concat_batches(&table.schema(), rows.iter().map(|(_, row)| row))
        };
        for batch in [
            &self.episodes,
            &joined(Table::Tasks, &self.tasks)?,
            &joined(Table::Scenes, &self.scenes)?,
        ] {
            let mut writer = StreamWriter::try_new(&mut bytes, batch.schema_ref())?;
            writer.write(batch)?;
            writer.finish()?;
        }
        Ok(bytes)
    }

    /// What [`TraceRows::to_bytes`] gave.
    ///
    /// # Errors
    /// When it is something else.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, StoreError> {
        let cut = || damaged("they end early");
        let (length, rest) = bytes.split_first_chunk::<4>().ok_or_else(cut)?;
        let (head, mut rest) = rest
            .split_at_checked(u32::from_le_bytes(*length) as usize)
            .ok_or_else(cut)?;
        let head: Head =
            serde_json::from_slice(head).map_err(|error| damaged(&error.to_string()))?;
        let mut next = |table: Table| -> Result<RecordBatch, StoreError> {
            let mut reader = StreamReader::try_new(&mut rest, None)?;
            let batch = reader.next().ok_or_else(cut)??;
            // the end of the stream belongs to it
            let more = reader.next().is_some();
            if more || batch.schema_ref().fields() != table.schema().fields() {
                return Err(damaged("the columns are other ones"));
            }
            Ok(batch)
        };
        let (episodes, tasks, scenes) = (
            next(Table::Episodes)?,
            next(Table::Tasks)?,
            next(Table::Scenes)?,
        );
        let counts = [
            (episodes.num_rows(), head.read.len()),
            (tasks.num_rows(), head.tasks.len()),
            (scenes.num_rows(), head.scenes.len()),
        ];
        if counts.iter().any(|(rows, named)| rows != named) {
            return Err(damaged("some rows are missing"));
        }
        let split = |keys: Vec<Key>, rows: &RecordBatch| {
            keys.into_iter()
                .enumerate()
                .map(|(row, key)| (key, rows.slice(row, 1)))
                .collect()
        };
        let (tasks, scenes) = (split(head.tasks, &tasks), split(head.scenes, &scenes));
        Ok(Self {
            episodes,
            read: head.read,
            bad: head.bad,
            tasks,
            scenes,
        })
    }
}

pub(super) fn key(text: &str) -> Key {
    let Digest(bytes) = Digest::of(text.as_bytes());
    Key::from_le_bytes(bytes[..16].try_into().expect("16 of 32 bytes"))
}

fn damaged(reason: &str) -> StoreError {
    StoreError::Wire {
        reason: reason.to_owned(),
    }
}
