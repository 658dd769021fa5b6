//! Recomputed rewards into the store, one row an episode and version of a preset, side by side
//! with the recorded ones.

use std::{
    collections::{BTreeMap, HashSet},
    sync::Arc,
};

use arrow::{
    array::{
        ArrayBuilder as _, ArrayRef, AsArray, Float64Builder, Int32Builder, ListBuilder,
        RecordBatch, StringBuilder, StructBuilder,
    },
    datatypes::{DataType, Float64Type},
    ipc::{reader::StreamReader, writer::StreamWriter},
};
use reel_reward::{EpisodeReward, Preset};
use serde::Serialize;

use super::{Refused, Store, StoreError, TRIES_MAX};
use crate::{ScoredEpisode, Table};

/// Rows after which a portion is committed.
const ROWS_PER_PORTION: usize = 200_000;

/// What a rescoring did.
#[derive(Clone, PartialEq, Debug, Default, Serialize)]
pub struct RescoreReport {
    /// Episodes that were scored now.
    pub scored: usize,
    /// Episodes that had these rewards already: as recorded, or from an earlier scoring.
    pub unchanged: usize,
    /// Mean total reward of what was scored now.
    pub mean_total: Option<f64>,
    /// The store's version afterwards.
    pub version: u64,
}

/// Episodes scored under a preset, on their way into the store.
#[derive(Default)]
pub struct RescoredEpisodes {
    portions: Vec<RecordBatch>,
    /// Episodes that had the version already.
    unchanged: usize,
}

impl RescoredEpisodes {
    /// Adds what was scored elsewhere.
    pub fn append(&mut self, other: Self) {
        self.portions.extend(other.portions);
        self.unchanged += other.unchanged;
    }

    /// For another machine: a number (8 bytes), then an Arrow IPC stream.
    ///
    /// # Errors
    /// When Arrow refuses.
    pub fn to_bytes(&self) -> Result<Vec<u8>, StoreError> {
        let mut bytes = (self.unchanged as u64).to_le_bytes().to_vec();
        let mut writer = StreamWriter::try_new(&mut bytes, &Table::Rescored.schema())?;
        self.portions
            .iter()
            .try_for_each(|batch| writer.write(batch))?;
        writer.finish()?;
        drop(writer);
        Ok(bytes)
    }

    /// Reads rows from the bytes that [`RescoredEpisodes::to_bytes`] wrote.
    ///
    /// # Errors
    /// When it is something else.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, StoreError> {
        let wrong = |reason: &str| StoreError::Wire {
            reason: reason.to_owned(),
        };
        let (unchanged, rest) = bytes
            .split_first_chunk::<8>()
            .ok_or_else(|| wrong("they end early"))?;
        let reader = StreamReader::try_new(rest, None)?;
        if reader.schema().fields() != Table::Rescored.schema().fields() {
            return Err(wrong("the columns are other ones"));
        }
        let portions = reader.collect::<Result<Vec<RecordBatch>, _>>()?;
        Ok(Self {
            portions,
            unchanged: u64::from_le_bytes(*unchanged) as usize,
        })
    }
}

impl Store {
    /// Scores all episodes under a preset and keeps the result under the preset's version; what is
    /// there already stays, and what was recorded under the preset with the same terms is not kept
    /// a second time. `progress` gets the number of episodes scored.
    ///
    /// # Errors
    /// When the store cannot be read or written.
    pub fn rescore(
        &mut self,
        preset: &Preset,
        progress: impl FnMut(usize),
    ) -> Result<RescoreReport, StoreError> {
        self.reload()?;
        let scored = self.rescore_in(&self.file_names(Table::Episodes), preset, progress)?;
        self.append_rescored(scored, preset)
    }

    /// Scores the episodes in some files that are not scored under a preset yet, and keeps nothing.
    ///
    /// # Errors
    /// When the store cannot be read.
    pub fn rescore_in(
        &self,
        files: &[String],
        preset: &Preset,
        mut progress: impl FnMut(usize),
    ) -> Result<RescoredEpisodes, StoreError> {
        let version = preset.version().to_string();
        let known = self.versions_in(&self.tables[&Table::Rescored], &version)?;
        let mut scored = RescoredEpisodes::default();
        let (mut rows, mut count) = (Rows::new(preset.name(), &version), 0_usize);
        self.score_in(files, std::slice::from_ref(preset), |episode, rewards| {
            // what was recorded under the preset stands in its own rows already
            let recorded = episode.preset == preset.name() && episode.matches_recorded(&rewards[0]);
            if recorded || known.contains(episode.trace_digest) {
                scored.unchanged += 1;
                return true;
            }
            rows.push(episode, &rewards[0]);
            count += 1;
            if count % 1024 == 0 {
                progress(count);
            }
            if count % ROWS_PER_PORTION == 0 {
                scored.portions.push(rows.take());
            }
            true
        })?;
        progress(count);
        scored.portions.push(rows.take());
        scored.portions.retain(|batch| batch.num_rows() > 0);
        Ok(scored)
    }

    /// Keeps what was scored under the preset's version; what is there already stays.
    ///
    /// # Errors
    /// When the store cannot be written.
    pub fn append_rescored(
        &mut self,
        scored: RescoredEpisodes,
        preset: &Preset,
    ) -> Result<RescoreReport, StoreError> {
        let RescoredEpisodes {
            portions,
            unchanged,
        } = scored;
        let count = portions.iter().map(RecordBatch::num_rows).sum();
        let totals = portions
            .iter()
            .flat_map(|batch| batch["total_reward"].as_primitive::<Float64Type>().values());
        let mean_total = (count > 0).then(|| totals.sum::<f64>() / count as f64);
        if !portions.is_empty() {
            self.keep(&portions, &preset.version().to_string())?;
        }
        Ok(RescoreReport {
            scored: count,
            unchanged,
            mean_total,
            version: self.version(),
        })
    }

    fn keep(&mut self, portions: &[RecordBatch], version: &str) -> Result<(), StoreError> {
        for _ in 0..TRIES_MAX {
            match self.try_keep(portions, version) {
                Ok(()) => return self.reload(),
                Err(Refused::Conflict) => self.reload()?,
                Err(Refused::Failed(error)) => return Err(error),
            }
        }
        Err(StoreError::Busy {
            tries: TRIES_MAX,
            location: self.location.to_string(),
        })
    }

    fn try_keep(&self, portions: &[RecordBatch], version: &str) -> Result<(), Refused> {
        let newest = self.newest_to_write(Table::Rescored)?;
        // what another rescoring, or one that was killed before its last
        // commit, has written meanwhile
        let there = self.versions_in(&newest, version)?;
        let mut missing = Vec::new();
        for batch in portions {
            let digests = batch["trace_digest"].as_string::<i32>();
            let keep = digests
                .iter()
                .map(|digest| Some(digest.is_some_and(|digest| !there.contains(digest))))
                .collect();
            missing.push(arrow::compute::filter_record_batch(batch, &keep)?);
        }
        missing.retain(|batch| batch.num_rows() > 0);
        let side = if missing.is_empty() {
            newest.version().unwrap_or_default()
        } else {
            let actions = self.write_parts(&newest, missing)?;
            self.commit_side(&newest, actions)?
        };
        self.commit_episodes(Vec::new(), &BTreeMap::from([(Table::Rescored, side)]))
            .map(drop)
    }

    /// Digests of the traces that were scored under a version.
    fn versions_in(
        &self,
        table: &deltalake::DeltaTable,
        version: &str,
    ) -> Result<HashSet<String>, StoreError> {
        let mut known = HashSet::new();
        self.read_parts(
            table,
            &super::parts::parts(table),
            Some(&["trace_digest", "version"]),
            |_, batch| {
                let (digests, versions) = (
                    batch["trace_digest"].as_string::<i32>(),
                    batch["version"].as_string::<i32>(),
                );
                let rows = digests
                    .iter()
                    .zip(versions)
                    .filter(|(_, found)| *found == Some(version));
                known.extend(rows.filter_map(|(digest, _)| digest.map(str::to_owned)));
                Ok(())
            },
        )?;
        Ok(known)
    }
}

/// Rows on their way into columns.
struct Rows<'a> {
    preset: &'a str,
    version: &'a str,
    episode_id: StringBuilder,
    trace_digest: StringBuilder,
    total: Float64Builder,
    discounted: Float64Builder,
    terms: ListBuilder<StructBuilder>,
}

impl<'a> Rows<'a> {
    fn new(preset: &'a str, version: &'a str) -> Self {
        let schema = Table::Rescored.schema();
        let terms = schema
            .field_with_name("terms")
            .expect("a column of ours")
            .data_type()
            .clone();
        let DataType::List(item) = terms else {
            unreachable!("terms are a list")
        };
        let DataType::Struct(fields) = item.data_type() else {
            unreachable!("of structs")
        };
        let builder = StructBuilder::from_fields(fields.clone(), 0);
        Self {
            preset,
            version,
            episode_id: StringBuilder::new(),
            trace_digest: StringBuilder::new(),
            total: Float64Builder::new(),
            discounted: Float64Builder::new(),
            terms: ListBuilder::new(builder).with_field(item),
        }
    }

    fn push(&mut self, episode: &ScoredEpisode<'_>, reward: &EpisodeReward) {
        self.episode_id.append_value(episode.episode_id);
        self.trace_digest.append_value(episode.trace_digest);
        self.total.append_value(reward.total());
        self.discounted.append_value(reward.discounted_return());
        for step in 0..reward.steps().len() {
            for fired in reward.terms(step) {
                let term = self.terms.values();
                term.field_builder::<Int32Builder>(0)
                    .expect("step")
                    .append_value(step as i32);
                term.field_builder::<StringBuilder>(1)
                    .expect("component")
                    .append_value(fired.term.component());
                term.field_builder::<Float64Builder>(2)
                    .expect("value")
                    .append_value(fired.value);
                term.append(true);
            }
        }
        self.terms.append(true);
    }

    fn take(&mut self) -> RecordBatch {
        let rows = self.episode_id.len();
        let constant = |text: &str| -> ArrayRef {
            Arc::new(arrow::array::StringArray::from_iter_values(
                std::iter::repeat_n(text, rows),
            ))
        };
        let columns: Vec<ArrayRef> = vec![
            Arc::new(self.episode_id.finish()),
            Arc::new(self.trace_digest.finish()),
            constant(self.preset),
            constant(self.version),
            Arc::new(self.total.finish()),
            Arc::new(self.discounted.finish()),
            Arc::new(self.terms.finish()),
        ];
        RecordBatch::try_new(Table::Rescored.schema(), columns)
            .expect("the columns are those of the schema")
    }
}
