//! Traces into the store: read in parallel, committed in bounded portions, each whole
//! or not at all.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap, HashSet},
    path::{Path, PathBuf},
    sync::{
        atomic::{AtomicUsize, Ordering},
        mpsc,
    },
};

use arrow::{
    array::{AsArray, BooleanArray, RecordBatch},
    compute::{concat_batches, filter_record_batch},
};
use deltalake::kernel::Action;
use rayon::prelude::*;
use reel_trace::RecordsReader;
use serde::Serialize;

use super::{
    Refused, Store, StoreError, TRIES_MAX,
    contents::{StoreContents, column_of, file_key},
    location::absolute,
    parts::{Merge, parts},
    reading::{DocumentSet, Key, TraceKey, TraceRows, key},
};
use crate::{Table, rows::Rows};

/// Bytes of Arrow memory after which a portion is committed.
const PORTION_BYTES: usize = 48 << 20;
/// Traces that a thread turns into one batch.
const TRACES_PER_BATCH: usize = 16;
/// Batches read ahead at a time.
const BATCHES_AHEAD: usize = 16;

/// Called with (files done, files in all) from several threads.
pub type Progress<'a> = &'a (dyn Fn(usize, usize) + Sync);

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
    /// The store's version afterwards.
    pub version: u64,
}

/// What waits to be committed.
#[derive(Default)]
struct Portion {
    batches: Vec<TraceRows>,
    bytes: usize,
}

impl Store {
    /// Reads traces into the tables, several at a time. A file that is as it was when it was read
    /// costs a look at its size and time; a trace that is there already changes nothing; of two
    /// with the same episode id and other content the later path wins; a file that is no sound
    /// trace is quarantined and the rest goes on. What is committed by the time of a kill stays,
    /// and the next ingest goes on from there. Several processes may ingest at a time.
    ///
    /// # Errors
    /// When the store cannot be read or written.
    pub fn ingest(
        &mut self,
        paths: &[PathBuf],
        progress: Progress<'_>,
    ) -> Result<IngestReport, StoreError> {
        let files = self.trace_files.clone();
        self.ingest_by(
            paths,
            TRACES_PER_BATCH,
            progress,
            |groups, seen, done, take| {
                let reader = RecordsReader::new(files.clone());
                let prefetch = |groups: Option<&[Vec<PathBuf>]>| {
                    let groups = groups.into_iter().flatten();
                    groups.for_each(|group| files.prefetch(group));
                };
                let read = |group: &Vec<PathBuf>| {
                    let rows = TraceRows::read(&reader, group, &seen);
                    done(group.len());
                    rows
                };
                std::thread::scope(|scope| {
                    let (sender, receiver) =
                        mpsc::sync_channel::<Vec<Result<TraceRows, StoreError>>>(1);
                    let (read, prefetch) = (&read, &prefetch);
                    scope.spawn(move || {
                        let mut chunks = groups.chunks(BATCHES_AHEAD).peekable();
                        prefetch(chunks.peek().copied());
                        while let Some(ahead) = chunks.next() {
                            prefetch(chunks.peek().copied());
                            if sender.send(ahead.par_iter().map(read).collect()).is_err() {
                                return;
                            }
                        }
                    });
                    receiver.iter().flatten().try_for_each(|rows| take(rows?))
                })
            },
        )
    }

    /// [`Store::ingest`], where somebody else reads the traces: `read` gets them in groups of so
    /// many, hands the rows of each group on in the order of the groups, and says how many traces
    /// are done. Of the tasks and scenes in the set no rows are needed.
    ///
    /// # Errors
    /// As [`Store::ingest`], and what `read` says; what was committed before stays.
    pub fn ingest_by<E: From<StoreError>>(
        &mut self,
        paths: &[PathBuf],
        group: usize,
        progress: Progress<'_>,
        read: impl FnOnce(
            &[Vec<PathBuf>],
            DocumentSet,
            &(dyn Fn(usize) + Sync),
            &mut dyn FnMut(TraceRows) -> Result<(), E>,
        ) -> Result<(), E>,
    ) -> Result<IngestReport, E> {
        self.reload()?;
        let paths: BTreeSet<PathBuf> = paths
            .iter()
            .map(|path| absolute(path).unwrap_or_else(|_| path.clone()))
            .collect();
        let mut known = self.known(&paths)?;
        let mut report = IngestReport::default();
        let fresh: Vec<PathBuf> = paths
            .iter()
            .filter(|path| !known.files.contains(&file_key(&self.trace_files, path)))
            .cloned()
            .collect();
        let groups: Vec<Vec<PathBuf>> = fresh.chunks(group).map(<[PathBuf]>::to_vec).collect();
        report.unchanged = paths.len() - fresh.len();
        let done = AtomicUsize::new(report.unchanged);
        progress(report.unchanged, paths.len());
        let seen = DocumentSet::new(known.tasks.union(&known.scenes).copied());
        let more = |count: usize| {
            progress(
                done.fetch_add(count, Ordering::Relaxed) + count,
                paths.len(),
            )
        };
        let mut portion = Portion::default();
        read(&groups, seen, &more, &mut |rows| {
            portion.push(rows);
            if portion.bytes >= PORTION_BYTES {
                let full = std::mem::take(&mut portion);
                self.take(full, &paths, &mut known, &mut report)?;
                // Merges change no row; a version that is not theirs is another writer's.
                let merged = self.merge_small_files(Merge::INGESTED)?;
                if known.version + merged == self.version() {
                    known.version = self.version();
                }
            }
            Ok(())
        })?;
        self.take(portion, &paths, &mut known, &mut report)?;
        self.merge_small_files(Merge::INGESTED)?;
        report.version = self.version();
        Ok(report)
    }

    /// Files that were left out and not ingested since, with the reason.
    ///
    /// # Errors
    /// When the table cannot be read.
    pub fn quarantine(&self) -> Result<BTreeMap<String, String>, StoreError> {
        self.quarantined(&self.tables[&Table::Quarantine])
    }

    /// Commits a portion; looks again and repeats where another writer was quicker.
    fn take(
        &mut self,
        portion: Portion,
        paths: &BTreeSet<PathBuf>,
        known: &mut StoreContents,
        report: &mut IngestReport,
    ) -> Result<(), StoreError> {
        for _ in 0..TRIES_MAX {
            if known.version != self.version() {
                *known = self.known(paths)?;
            }
            let mut attempt = report.clone();
            match self.try_take(&portion, paths, known, &mut attempt) {
                Ok(committed) => {
                    *report = attempt;
                    if let Some(version) = committed {
                        known.version = version;
                        self.reload()?;
                    }
                    return Ok(());
                }
                Err(Refused::Failed(error)) => return Err(error),
                Err(Refused::Conflict) => {
                    self.reload()?;
                    // of no version: what was taken over from the failed try is forgotten
                    known.version = u64::MAX;
                }
            }
        }
        Err(StoreError::Busy {
            tries: TRIES_MAX,
            location: self.location.to_string(),
        })
    }

    /// The version that was committed, if something had to be written.
    fn try_take(
        &mut self,
        portion: &Portion,
        paths: &BTreeSet<PathBuf>,
        known: &mut StoreContents,
        report: &mut IngestReport,
    ) -> Result<Option<u64>, Refused> {
        if !known.whole {
            self.look_up("episode_id", &portion.ids(|_| true), known)?;
        }
        let verdicts = self.judge(portion, paths, known, report)?;
        let mut moved = BTreeMap::new();
        for (table, have) in [(Table::Tasks, &known.tasks), (Table::Scenes, &known.scenes)] {
            if let Some(version) = self.add_missing(table, portion, have)? {
                moved.insert(table, version);
            }
        }
        if let Some(version) = self.update_quarantine(portion)? {
            moved.insert(Table::Quarantine, version);
        }
        report.quarantined.extend(
            portion
                .batches
                .iter()
                .flat_map(|batch| batch.bad.iter().cloned()),
        );

        let mut rows = Vec::new();
        for (batch, keep) in portion.batches.iter().zip(&verdicts.keep) {
            rows.push(filter_record_batch(
                &batch.episodes,
                &BooleanArray::from(keep.clone()),
            )?);
        }
        rows.retain(|batch| batch.num_rows() > 0);
        let mut actions = self.without(&verdicts.replaced, &verdicts.overwritten)?;
        if !rows.is_empty() {
            actions.extend(self.write_parts(&self.tables[&Table::Episodes], rows)?);
        }
        if actions.is_empty() && moved.is_empty() {
            return Ok(None);
        }
        let version = self.commit_episodes(actions, &moved)?;
        for (batch, keep) in portion.batches.iter().zip(&verdicts.keep) {
            for (read, _) in batch.read.iter().zip(keep).filter(|(_, keep)| **keep) {
                known
                    .episodes
                    .insert(key(&read.episode_id), key(&read.digest));
                known.paths.insert(key(&read.path), key(&read.episode_id));
                let file = file_key(&self.trace_files, Path::new(&read.path));
                known.files.insert(file);
            }
            known
                .tasks
                .extend(batch.tasks.iter().map(|(task, _)| *task));
            known
                .scenes
                .extend(batch.scenes.iter().map(|(scene, _)| *scene));
        }
        Ok(Some(version))
    }

    /// Which rows of a portion go in, and whose rows they replace.
    fn judge(
        &self,
        portion: &Portion,
        paths: &BTreeSet<PathBuf>,
        known: &StoreContents,
        report: &mut IngestReport,
    ) -> Result<Verdicts, StoreError> {
        let mut last: HashMap<&str, (usize, usize)> = HashMap::new();
        let mut verdicts = Verdicts {
            keep: Vec::new(),
            replaced: BTreeSet::new(),
            overwritten: BTreeSet::new(),
        };
        let same_content = self
            .traces_of(&portion.ids(|read| {
                known.episodes.get(&key(&read.episode_id)) == Some(&key(&read.digest))
            }))?;
        let mut other_content: BTreeSet<String> = BTreeSet::new();
        for (index, batch) in portion.batches.iter().enumerate() {
            verdicts.keep.push(vec![true; batch.read.len()]);
            for (row, read) in batch.read.iter().enumerate() {
                // a file that held another episode holds this one now
                if known
                    .paths
                    .get(&key(&read.path))
                    .is_some_and(|episode| *episode != key(&read.episode_id))
                {
                    verdicts.overwritten.insert(read.path.clone());
                }
                let stored = same_content.get(&read.episode_id);
                match known.episodes.get(&key(&read.episode_id)) {
                    // the trace was moved, its old file is another one by now, or its file holds
                    // more beside the records (frames, log-probabilities): its row learns where
                    // and how it is
                    Some(digest)
                        if *digest == key(&read.digest)
                            && stored.is_some_and(|(path, bytes)| match *path == read.path {
                                true => self
                                    .trace_files
                                    .metadata(Path::new(path))
                                    .is_ok_and(|facts| facts.bytes != *bytes),
                                false => !known
                                    .files
                                    .contains(&file_key(&self.trace_files, Path::new(path))),
                            }) =>
                    {
                        other_content.insert(read.episode_id.clone());
                    }
                    Some(digest) if *digest == key(&read.digest) && stored.is_some() => {
                        verdicts.keep[index][row] = false;
                        report.unchanged += 1;
                        continue;
                    }
                    // its row went when another episode took its file, in an earlier portion
                    Some(digest) if *digest == key(&read.digest) => {}
                    Some(_) => {
                        other_content.insert(read.episode_id.clone());
                    }
                    None => {}
                }
                let earlier = last.get(read.episode_id.as_str()).copied();
                match earlier
                    .map(|(batch, row)| portion.batches[batch].read[row].digest == read.digest)
                {
                    Some(true) => {
                        verdicts.keep[index][row] = false;
                        report.unchanged += 1;
                        continue;
                    }
                    Some(false) => {
                        let (index, row) = earlier.expect("it was just compared");
                        verdicts.keep[index][row] = false;
                        report.superseded += 1;
                    }
                    None => {}
                }
                last.insert(&read.episode_id, (index, row));
            }
        }
        let traces = self.traces_of(&other_content)?;
        for (index, row) in last.into_values() {
            let read = &portion.batches[index].read[row];
            match traces.get(&read.episode_id) {
                None => report.added += 1,
                // it is as it was when it was read, stands later, and won then too
                Some((trace, _))
                    if *trace > read.path
                        && paths.contains(Path::new(trace))
                        && known
                            .files
                            .contains(&file_key(&self.trace_files, Path::new(trace))) =>
                {
                    verdicts.keep[index][row] = false;
                    report.unchanged += 1;
                }
                Some(_) => {
                    verdicts.replaced.insert(read.episode_id.clone());
                    report.superseded += 1;
                }
            }
        }
        Ok(verdicts)
    }

    /// Adds the tasks or scenes of a portion that are not there yet; the new version
    /// where there were any.
    fn add_missing(
        &self,
        table: Table,
        portion: &Portion,
        known: &HashSet<Key>,
    ) -> Result<Option<u64>, Refused> {
        let of = |batch: &'_ TraceRows| {
            if table == Table::Tasks {
                &batch.tasks
            } else {
                &batch.scenes
            }
            .clone()
        };
        let rows = portion
            .batches
            .iter()
            .flat_map(of)
            .filter(|(digest, _)| !known.contains(digest));
        let rows: BTreeMap<Key, RecordBatch> = rows.collect();
        if rows.is_empty() {
            return Ok(None);
        }
        let newest = self.newest_to_write(table)?;
        let wanted = rows.values().map(|row| {
            let digest = row[column_of(table)].as_string::<i32>();
            digest.value(0).to_owned()
        });
        let there = self.keys(&newest, column_of(table), Some(&wanted.collect()))?;
        let missing: Vec<&RecordBatch> = rows
            .iter()
            .filter(|(digest, _)| !there.contains(digest))
            .map(|(_, row)| row)
            .collect();
        if missing.is_empty() {
            // A writer may have died between this table and its episodes, which do not name it then.
            let named = self.tables[&table].version();
            return Ok(newest.version().filter(|newest| Some(*newest) != named));
        }
        let actions = self.write_parts(&newest, vec![concat_batches(&table.schema(), missing)?])?;
        self.commit_side(&newest, actions).map(Some)
    }

    /// Puts the bad files of a portion into quarantine and takes the sound ones out.
    fn update_quarantine(&self, portion: &Portion) -> Result<Option<u64>, Refused> {
        let nobody = portion.batches.iter().all(|batch| batch.bad.is_empty());
        if nobody && self.parts(Table::Quarantine).is_empty() {
            return Ok(None);
        }
        let newest = self.newest_to_write(Table::Quarantine)?;
        let before = self.quarantined(&newest)?;
        let mut after = before.clone();
        for batch in &portion.batches {
            batch
                .read
                .iter()
                .for_each(|read| drop(after.remove(&read.path)));
            after.extend(
                batch
                    .bad
                    .iter()
                    .map(|(path, reason)| (path.display().to_string(), reason.clone())),
            );
        }
        if after == before {
            // A writer may have died between this table and its episodes, which do not name it
            // then.
            let named = self.tables[&Table::Quarantine].version();
            return Ok(newest.version().filter(|newest| Some(*newest) != named));
        }
        let mut actions: Vec<Action> = parts(&newest)
            .into_iter()
            .map(|part| Action::Remove(part.remove))
            .collect();
        if !after.is_empty() {
            actions.extend(self.write_parts(
                &newest,
                vec![Rows::quarantine(&after).map_err(StoreError::from)?],
            )?);
        }
        self.commit_side(&newest, actions).map(Some)
    }

    /// Actions that take the rows of some episodes, and those read from some
    /// files, out of `episodes`.
    fn without(
        &self,
        episodes: &BTreeSet<String>,
        files: &BTreeSet<String>,
    ) -> Result<Vec<Action>, StoreError> {
        let mut actions = Vec::new();
        if episodes.is_empty() && files.is_empty() {
            return Ok(actions);
        }
        let goes = |batch: &RecordBatch| -> Vec<bool> {
            let (ids, traces) = (
                batch["episode_id"].as_string::<i32>(),
                batch["trace"].as_string::<i32>(),
            );
            (0..batch.num_rows())
                .map(|row| episodes.contains(ids.value(row)) || files.contains(traces.value(row)))
                .collect()
        };
        let table = &self.tables[&Table::Episodes];
        let parts = self.parts(Table::Episodes);
        let mut touched = BTreeSet::new();
        for lookup in [("episode_id", episodes), ("trace", files)] {
            let columns = ["episode_id", "trace"];
            self.read_parts_with(table, &parts, lookup, Some(&columns), |index, batch| {
                if goes(&batch).contains(&true) {
                    touched.insert(index);
                }
                Ok(())
            })?;
        }
        for (_, part) in parts
            .into_iter()
            .enumerate()
            .filter(|(index, _)| touched.contains(index))
        {
            let mut kept = Vec::new();
            self.read_parts(table, std::slice::from_ref(&part), None, |_, batch| {
                let keep: BooleanArray = goes(&batch).into_iter().map(|goes| Some(!goes)).collect();
                kept.push(filter_record_batch(&batch, &keep)?);
                Ok(())
            })?;
            kept.retain(|batch| batch.num_rows() > 0);
            if !kept.is_empty() {
                actions.extend(self.write_parts(table, kept)?);
            }
            actions.push(Action::Remove(part.remove));
        }
        Ok(actions)
    }

    fn quarantined(
        &self,
        table: &deltalake::DeltaTable,
    ) -> Result<BTreeMap<String, String>, StoreError> {
        let mut files = BTreeMap::new();
        self.read_parts(table, &parts(table), None, |_, batch| {
            let (traces, reasons) = (
                batch["trace"].as_string::<i32>(),
                batch["reason"].as_string::<i32>(),
            );
            let rows = traces
                .iter()
                .zip(reasons)
                .filter_map(|(trace, reason)| Some((trace?.to_owned(), reason?.to_owned())));
            files.extend(rows);
            Ok(())
        })?;
        Ok(files)
    }
}

struct Verdicts {
    /// By batch and row: whether it goes in.
    keep: Vec<Vec<bool>>,
    /// Episodes that are there with other content, or from a file that is gone.
    replaced: BTreeSet<String>,
    /// Files that held another episode when they were read before.
    overwritten: BTreeSet<String>,
}

impl Portion {
    /// The episodes whose reading fulfils a condition.
    fn ids(&self, wanted: impl Fn(&TraceKey) -> bool) -> BTreeSet<String> {
        let reads = self
            .batches
            .iter()
            .flat_map(|batch| &batch.read)
            .filter(|read| wanted(read));
        reads.map(|read| read.episode_id.clone()).collect()
    }

    fn push(&mut self, batch: TraceRows) {
        let rows = batch
            .tasks
            .iter()
            .chain(&batch.scenes)
            .map(|(_, rows)| rows)
            .chain([&batch.episodes]);
        self.bytes += rows.map(RecordBatch::get_array_memory_size).sum::<usize>();
        self.batches.push(batch);
    }
}
