//! Training sets out of a store of tables: which episodes and decisions, verified how, in which
//! words, order and part (docs/spec.md#sft-data and docs/spec.md#dataset-formats).
//!
//! Owns the choice, the verification and the order of rows; what a row looks like is
//! `reel-dataset`'s matter. Nothing that is not verified leaves the store, unless asked
//! for, and then every row says so. Equal store versions and options give equal bytes, on
//! any number of threads.

mod contradictions;
mod episode;
mod gspo;
mod parquet;
mod rollouts;
mod rows;
mod select;
mod task_index;
mod training;
mod verify;

use std::{
    collections::BTreeMap,
    io,
    path::{Path, PathBuf},
    sync::Arc,
};

use reel_dataset::{
    DatasetError, Leakage, Ratios, Split, Splits, Style, TokenReport, WriterOptions,
};
use reel_prompt::Prompt;
use reel_tables::{Store, StoreError};
use serde::Serialize;

pub use contradictions::{check_failed_histories, check_histories};
pub use gspo::{GroupObjective, GspoOptions, GspoReport, Sequence, SequenceUnit, gspo};
pub use rollouts::RolloutOptions;
pub use select::Selection;
pub use training::{Figures, LoggedObjective, LoggedStep, LoggedUpdate, TrainingLog};

/// Called with the number of episodes that are done, from several threads.
pub type Progress<'a> = &'a (dyn Fn(usize) + Sync);

/// Whose reasoning, History, schedule and subtask an example has.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum AnnotationSource {
    /// A model's own where one spoke, mended; else written by rules.
    #[default]
    Auto,
    /// Text written by rules, even where a model spoke.
    Rules,
    /// Text as recorded; History sentences that the record contradicts are mended or dropped.
    Recorded,
    /// Of the file beside each trace that `reel dataset annotate` wrote.
    Notes,
}

impl AnnotationSource {
    /// Whose they are for an episode, by whether a model spoke in it.
    fn of(self, a_model_spoke: impl FnOnce() -> bool) -> Self {
        match self {
            AnnotationSource::Auto if a_model_spoke() => AnnotationSource::Recorded,
            AnnotationSource::Auto => AnnotationSource::Rules,
            words => words,
        }
    }
}

/// What is kept together in one part of a dataset.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SplitBy {
    /// The episodes of a task.
    #[default]
    Task,
    /// The episodes of a scene.
    Scene,
}

/// A training set to be made.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct ExportOptions {
    /// Which episodes and decisions.
    pub selection: Selection,
    /// Format and size of the files, and how images are made.
    pub writer: WriterOptions,
    /// How a decision is put.
    pub style: Style,
    /// What single turns are put by.
    #[serde(skip)]
    pub prompt: Arc<Prompt>,
    /// Whose reasoning, History, schedule and subtask the examples have.
    pub words: AnnotationSource,
    /// What a part keeps together.
    pub split_by: SplitBy,
    /// Shares of the data that train, validation and test get.
    pub ratios: Ratios,
    /// Whether examples have images.
    pub images: bool,
    /// Episodes that are not verified too; their rows say so.
    pub allow_unverified: bool,
    /// Replay what no verdict is kept of.
    pub replay: bool,
    /// Rows for reinforcement learning: what each decision was worth in its group.
    pub rollouts: Option<RolloutOptions>,
    /// A model's `tokenizer.json`, to count tokens by.
    #[serde(skip)]
    pub tokenizer: Option<PathBuf>,
    /// Rows name traces below this folder by the path from there, which means something on other
    /// machines too. `None`: as the store names them.
    #[serde(skip)]
    pub trace_base: Option<PathBuf>,
    /// What the dataset is called.
    pub name: String,
    /// Its licence, as an SPDX name or `other`.
    pub licence: String,
    /// The command that makes it again.
    pub command: String,
}

/// What an export did.
#[derive(Clone, PartialEq, Debug, Default, Serialize)]
pub struct ExportReport {
    /// Number of examples in each split of the dataset.
    pub examples: BTreeMap<Split, u64>,
    /// Episodes that gave some.
    pub episodes: u64,
    /// Version of the store that was read.
    pub table_version: u64,
    /// Episodes and decisions that were left out, by the reason.
    pub excluded: BTreeMap<&'static str, u64>,
    /// Examples that the format cannot hold, by the reason.
    pub unwritable: BTreeMap<String, u64>,
    /// Episodes and decisions that were refused, with the trace and the reason.
    pub refused: Vec<RefusedEpisode>,
    /// Examples of episodes that are not verified.
    pub unverified: u64,
    /// Sentences of recorded Histories that were mended, and dropped.
    pub history: HistoryRepairs,
    /// Number of different images in the dataset.
    pub images: usize,
    /// How long the examples are.
    pub tokens: Option<TokenReport>,
    /// What is in several parts.
    pub leakage: Vec<Leakage>,
}

/// Sentences of Histories that contradicted the record.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize)]
pub struct HistoryRepairs {
    /// Number of sentences that were corrected by the record.
    pub corrected: u64,
    /// Number of sentences that were dropped from Histories.
    pub dropped: u64,
}

/// An episode, or one of its decisions, that was refused.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct RefusedEpisode {
    /// Id of the episode that is refused, in whole or in part.
    pub episode_id: String,
    /// Where the episode's trace lies, as the store names it.
    pub trace: String,
    /// The decision; none: the whole episode.
    pub call: Option<u32>,
    /// Why the episode or the decision is refused.
    pub reason: String,
}

/// Why nothing was exported.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum ExportError {
    /// The store cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The dataset cannot be written.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A file cannot be read or written.
    #[error("cannot write the dataset: {source}: {path}", path = path.display())]
    Io { source: io::Error, path: PathBuf },
    /// The folder holds something else.
    #[error("this folder is not empty; choose another, or delete it: {path}", path = path.display())]
    OtherDataset { path: PathBuf },
    /// Returns, log-probabilities or parameters of which nothing can be computed.
    #[error("advantages: {0}")]
    Advantages(#[from] reel_reward::RewardError),
    /// Log-probabilities of which nothing can be computed.
    #[error("episode {episode_id}{}: {reason}", step.map_or_else(String::new, |step| format!(", step {step}")))]
    Logprobs {
        episode_id: String,
        /// The decision; `None` if it is about the whole episode.
        step: Option<u32>,
        reason: String,
    },
    /// No sequence of which an objective could be computed.
    #[error(
        "no episode in a group has log-probabilities of {policies}; record them with `reel bench --logprobs`, add those of other policies with `reel trace logprobs add`, and ingest the traces again"
    )]
    NoSequences { policies: String },
    /// The log of a training cannot be read.
    #[error("{}{}: {reason}", path.display(), line.map_or_else(String::new, |line| format!(", line {line}")))]
    TrainingLog {
        /// The file of the log that cannot be read.
        path: PathBuf,
        /// The line, from 1; `None` if it is about the whole file.
        line: Option<usize>,
        /// What is wrong with it.
        reason: String,
    },
    /// The columns of the Parquet file cannot be built.
    #[error("columns of the dataset: {0}")]
    Columns(#[from] ::arrow::error::ArrowError),
    /// A Parquet file cannot be written, e.g. because the disk is full.
    #[error("Parquet files of the dataset: {0}; make room and run the same command to go on")]
    Parquet(#[from] ::parquet::errors::ParquetError),
    /// A task or scene in the tables is none.
    #[error("episode {episode_id}: {reason}; ingest the traces into a new store")]
    Document { episode_id: String, reason: String },
}

/// Exports a training set from a store into an empty folder. Broken off, the same call goes on:
/// what was verified and drawn is not done twice.
///
/// # Errors
/// When the store cannot be read, the folder cannot be written, or holds another dataset. What
/// cannot be used of the store is refused in the report, and the rest goes on.
pub fn export(
    store: &Store,
    out: &Path,
    options: &ExportOptions,
    verifying: Progress<'_>,
    writing: Progress<'_>,
) -> Result<ExportReport, ExportError> {
    let mut report = ExportReport {
        table_version: store.version(),
        ..ExportReport::default()
    };
    let mut chosen = select::candidates(
        store,
        &options.selection,
        options.words,
        &mut report.excluded,
    )?;
    let verified = verify::verify(store, &chosen, options, verifying)?;
    let mut verdicts = verified.iter();
    chosen.retain_mut(|candidate| match verdicts.next() {
        Some(Err(reason)) if !options.allow_unverified => {
            report.refused.push(candidate.refusal(None, reason.clone()));
            false
        }
        Some(Err(_)) => {
            candidate.verified = false;
            true
        }
        _ => true,
    });
    select::cap_tasks(&mut chosen, &options.selection, &mut report.excluded);
    select::balance(&mut chosen, &options.selection, &mut report.excluded);
    if let Some(how) = &options.rollouts {
        if let Some(preset) = &how.preset {
            rollouts::rescore(&mut chosen, store, preset, &mut report.excluded)?;
        }
        rollouts::group(
            &mut chosen,
            how,
            options.selection.seed,
            &mut report.excluded,
        )?;
    }
    let group = |candidate: &select::Candidate| match options.split_by {
        SplitBy::Task => candidate.task_digest.clone(),
        SplitBy::Scene => candidate.scene_id.clone(),
    };
    let groups: Vec<(String, &str)> = chosen
        .iter()
        .map(|candidate| (group(candidate), candidate.family.as_str()))
        .collect();
    let named = groups
        .iter()
        .map(|(group, family)| (group.as_str(), *family));
    let splits = Splits::stratified(named, options.selection.seed, options.ratios);
    let place = |candidate| {
        (
            candidate,
            splits.of(&group(candidate)).unwrap_or(Split::Train),
        )
    };
    let places = chosen
        .iter()
        .map(|candidate| (candidate.episode_id.as_str(), place(candidate)))
        .collect();
    let manifest = rows::write(store, out, options, &places, writing, &mut report)?;
    report.examples = manifest.counts.splits;
    report.tokens = manifest.tokens;
    report.leakage = manifest.leakage;
    Ok(report)
}
