//! What a store holds already of the traces of an ingest. A large ingest reads all keys of the store,
//! a small one looks up those of its traces.

use std::{
    collections::{BTreeSet, HashMap, HashSet},
    path::{Path, PathBuf},
};

use arrow::{
    array::{AsArray, RecordBatch},
    datatypes::Int64Type,
};
use reel_trace::TraceFiles;

use super::{
    SIDE, Store, StoreError,
    parts::parts,
    reading::{Key, key},
};
use crate::Table;

/// An ingest of at most so many traces looks for them in the store; a larger one reads what the
/// store holds first, which takes about 110 bytes of memory an episode.
const LOOKED_UP_MAX: usize = 256;
/// Looking up pays in stores of so many times as many episodes.
const EPISODES_PER_LOOKUP: usize = 100;

/// What an ingest looks at of a row of `episodes`.
const CONTENT_COLUMNS: [&str; 5] = [
    "episode_id",
    "trace_digest",
    "trace",
    "trace_bytes",
    "trace_modified_ns",
];

/// What the store holds: all of it, or what concerns the traces of one small ingest.
#[derive(Default)]
pub(super) struct StoreContents {
    /// Trace digest by episode id.
    pub(super) episodes: HashMap<Key, Key>,
    /// Files as they were when they were read.
    pub(super) files: HashSet<Key>,
    /// Episode by the path of its trace.
    pub(super) paths: HashMap<Key, Key>,
    pub(super) tasks: HashSet<Key>,
    pub(super) scenes: HashSet<Key>,
    /// Whether it is all; else episodes are looked up as their ids become known.
    pub(super) whole: bool,
    /// The version of the store that holds it.
    pub(super) version: u64,
}

impl StoreContents {
    fn take_row(&mut self, batch: &RecordBatch, row: usize) {
        let text = |column: &str| batch[column].as_string::<i32>().value(row);
        let number = |column: &str| batch[column].as_primitive::<Int64Type>().value(row);
        let (episode, trace) = (key(text("episode_id")), text("trace"));
        self.episodes.insert(episode, key(text("trace_digest")));
        self.paths.insert(key(trace), episode);
        self.files.insert(identity(
            trace,
            number("trace_bytes") as u64,
            number("trace_modified_ns"),
        ));
    }
}

impl Store {
    /// What the store holds of some traces before they are read.
    pub(super) fn known(&self, paths: &BTreeSet<PathBuf>) -> Result<StoreContents, StoreError> {
        let parts = self.parts(Table::Episodes);
        let episodes: usize = parts.iter().map(|part| part.rows).sum();
        let mut known = StoreContents {
            version: self.version(),
            whole: paths.len() > LOOKED_UP_MAX || episodes < paths.len() * EPISODES_PER_LOOKUP,
            ..StoreContents::default()
        };
        if known.whole {
            let table = &self.tables[&Table::Episodes];
            self.read_parts(table, &parts, Some(&CONTENT_COLUMNS), |_, batch| {
                (0..batch.num_rows()).for_each(|row| known.take_row(&batch, row));
                Ok(())
            })?;
            for (table, keys) in [
                (Table::Tasks, &mut known.tasks),
                (Table::Scenes, &mut known.scenes),
            ] {
                *keys = self.keys(&self.tables[&table], column_of(table), None)?;
            }
        } else {
            let traces = paths.iter().map(|path| path.display().to_string());
            self.look_up("trace", &traces.collect(), &mut known)?;
        }
        Ok(known)
    }

    /// Adds the episodes whose `column` is one of some texts.
    pub(super) fn look_up(
        &self,
        column: &str,
        texts: &BTreeSet<String>,
        known: &mut StoreContents,
    ) -> Result<(), StoreError> {
        self.read_parts_with(
            &self.tables[&Table::Episodes],
            &self.parts(Table::Episodes),
            (column, texts),
            Some(&CONTENT_COLUMNS),
            |_, batch| {
                let column = batch[column].as_string::<i32>();
                (0..batch.num_rows())
                    .filter(|row| texts.contains(column.value(*row)))
                    .for_each(|row| known.take_row(&batch, row));
                Ok(())
            },
        )
    }

    /// The keys of a table, or which of some texts are among them.
    pub(super) fn keys(
        &self,
        table: &deltalake::DeltaTable,
        column: &str,
        among: Option<&BTreeSet<String>>,
    ) -> Result<HashSet<Key>, StoreError> {
        let mut keys = HashSet::new();
        let take = |_, batch: RecordBatch| {
            keys.extend(batch[column].as_string::<i32>().iter().flatten().map(key));
            Ok(())
        };
        match among {
            Some(texts) => {
                self.read_parts_with(table, &parts(table), (column, texts), Some(&[column]), take)?
            }
            None => self.read_parts(table, &parts(table), Some(&[column]), take)?,
        }
        Ok(keys)
    }

    /// The traces that some episodes were read from, and their sizes in bytes.
    pub(super) fn traces_of(
        &self,
        episodes: &BTreeSet<String>,
    ) -> Result<HashMap<String, (String, u64)>, StoreError> {
        let mut traces = HashMap::new();
        self.read_parts_with(
            &self.tables[&Table::Episodes],
            &self.parts(Table::Episodes),
            ("episode_id", episodes),
            Some(&["episode_id", "trace", "trace_bytes"]),
            |_, batch| {
                let (ids, files) = (
                    batch["episode_id"].as_string::<i32>(),
                    batch["trace"].as_string::<i32>(),
                );
                let sizes = batch["trace_bytes"].as_primitive::<Int64Type>();
                let wanted = ids
                    .iter()
                    .zip(files)
                    .zip(sizes)
                    .filter_map(|((id, file), size)| Some((id?, file?, size?)));
                let wanted = wanted.filter(|(id, ..)| episodes.contains(*id));
                traces.extend(wanted.map(|(id, file, size)| {
                    (id.to_owned(), (file.to_owned(), size.max(0) as u64))
                }));
                Ok(())
            },
        )?;
        Ok(traces)
    }
}

pub(super) fn column_of(table: Table) -> &'static str {
    assert!(
        SIDE[..2].contains(&table),
        "only tasks and scenes have a digest for a key"
    );
    if table == Table::Tasks {
        "task_digest"
    } else {
        "scene_digest"
    }
}

pub(super) fn file_key(files: &TraceFiles, path: &Path) -> Key {
    let (bytes, modified_ns) = files
        .metadata(path)
        .map_or((0, 0), |facts| (facts.bytes, facts.modified_ns));
    identity(&path.display().to_string(), bytes, modified_ns)
}

/// Of a file as it is.
fn identity(path: &str, bytes: u64, modified_ns: i64) -> Key {
    key(&format!("{path}\n{bytes}\n{modified_ns}"))
}
