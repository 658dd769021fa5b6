//! What the exports of training sets share: the store, the words, the images, the parts, the run
//! and the telling.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use anyhow::Context;
use reel_dataset::{Encoding, Format, ImageOptions, Ratios, Style, WriterOptions};
use reel_export::{AnnotationSource, ExportOptions, ExportReport, Selection, SplitBy};
use reel_query::QuerySession;
use reel_tables::Store;

use crate::{
    ExitStatus, inputs, progress,
    prompt::{MemoryArguments, PromptArguments},
};

/// Which episodes of which store.
#[derive(clap::Args)]
pub struct StoreSource {
    /// The store: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store")]
    store: String,
    #[command(flatten)]
    assets: inputs::Assets,
    /// An earlier version of the store
    #[arg(long = "store-version", alias = "version", value_name = "N")]
    version: Option<u64>,
    /// Only episodes that fulfil this condition on table `episodes`, in SQL, e.g. "family = 'SUL'
    /// AND spl > 0.5"
    #[arg(long = "where", value_name = "SQL")]
    condition: Option<String>,
}

impl StoreSource {
    /// Opens the store that the arguments name.
    pub fn open(&self) -> anyhow::Result<Store> {
        self.assets.store(&self.store, self.version)
    }

    /// The episodes that fulfil the condition; `None` if there is no condition.
    pub fn episodes(&self) -> anyhow::Result<Option<BTreeSet<String>>> {
        self.chosen("episode_id")
    }

    /// The traces of the failed episodes that fulfil the condition, in the order of the store.
    pub fn failed_traces(&self) -> anyhow::Result<Vec<String>> {
        let mut failed = self.open()?.failed_traces()?;
        if let Some(chosen) = self.chosen("trace")? {
            failed.retain(|trace| chosen.contains(trace));
        }
        Ok(failed)
    }

    /// What this column of `episodes` says where the condition holds; `None` if there is no
    /// condition.
    fn chosen(&self, column: &str) -> anyhow::Result<Option<BTreeSet<String>>> {
        let Some(condition) = &self.condition else {
            return Ok(None);
        };
        let batches = QuerySession::new(self.open()?)?
            .run(&format!("SELECT {column} FROM episodes WHERE {condition}"))
            .with_context(|| format!("--where {condition}"))?;
        let mut found = BTreeSet::new();
        for batch in &batches {
            found.extend(
                reel_tables::rows_from::<(String,)>(batch)?
                    .into_iter()
                    .map(|(value,)| value),
            );
        }
        Ok(Some(found))
    }
}

/// What the card of a dataset says and no export knows.
#[derive(clap::Args)]
pub struct CardOptions {
    /// Licence of the data, as the dataset's card names it
    #[arg(
        long = "license",
        alias = "licence",
        value_name = "NAME",
        default_value = "other"
    )]
    pub licence: String,
}

/// What every training set is asked.
#[derive(clap::Args)]
pub struct CommonArguments {
    #[command(flatten)]
    source: StoreSource,
    /// Whose words: auto (a model's own where it spoke, else written by rules), rules, recorded,
    /// notes (of `reel dataset annotate`)
    #[arg(long = "annotations", alias = "words", value_name = "WORDS", default_value = "auto", value_parser = words)]
    words: AnnotationSource,
    #[command(flatten)]
    prompt: PromptArguments,
    #[command(flatten)]
    memory: MemoryArguments,
    /// What is kept together in a part of the dataset: task or scene
    #[arg(long, value_name = "WHAT", default_value = "task", value_parser = split_by)]
    split: SplitBy,
    /// Share of the validation part
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    validation: f64,
    /// Share of the test part
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    test: f64,
    /// Images: png, webp (both lossless), jpeg or none
    #[arg(long = "image-format", alias = "images", value_name = "FORMAT", default_value = "png", value_parser = ["png", "webp", "jpeg", "none"])]
    images: String,
    /// Most pixels of an image; 0: as they were taken (640 x 480)
    #[arg(
        long = "max-pixels",
        alias = "pixels",
        value_name = "PIXELS",
        default_value_t = 100_352
    )]
    pixels: u32,
    /// Episodes that were not verified too; their rows say so
    #[arg(long)]
    allow_unverified: bool,
    /// Replay nothing: only what earlier exports verified counts as verified
    #[arg(long)]
    no_replay: bool,
    /// Examples in a file
    #[arg(long, value_name = "N", default_value_t = 5_000)]
    rows_per_file: u64,
    /// Tokens of an example beyond which it counts as too long
    #[arg(long = "context-length", alias = "budget", value_name = "TOKENS", default_value_t = reel_dataset::CONTEXT_TOKENS)]
    budget: u32,
    /// The `tokenizer.json` of the model that shall learn, to count tokens by; without it a
    /// token is four bytes
    #[arg(long, value_name = "FILE")]
    tokenizer: Option<PathBuf>,
    #[command(flatten)]
    card: CardOptions,
    /// Seed of every draw: splits, caps, balance, groups, wordings
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Threads; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

impl CommonArguments {
    /// The options of an export; the caller adds what is its own.
    pub fn options(
        &self,
        format: Format,
        style: Style,
        name: &str,
    ) -> anyhow::Result<ExportOptions> {
        let train = 1.0 - self.validation - self.test;
        let encoding = match self.images.as_str() {
            "webp" => Some(Encoding::Webp),
            "jpeg" => Some(Encoding::Jpeg { quality: 90 }),
            "png" => Some(Encoding::Png),
            _ => None,
        };
        let pixels_max = (self.pixels > 0).then_some(self.pixels);
        Ok(ExportOptions {
            selection: Selection {
                episodes: self.source.episodes()?,
                seed: self.seed,
                ..Selection::default()
            },
            writer: WriterOptions {
                images: ImageOptions {
                    encoding: encoding.unwrap_or_default(),
                    pixels_max,
                    ..ImageOptions::default()
                },
                rows_max: self.rows_per_file,
                budget: self.budget,
                ..WriterOptions::new(format)
            },
            style,
            prompt: self.memory.apply(&self.prompt.prompt()?),
            words: self.words,
            split_by: self.split,
            ratios: Ratios::new([train, self.validation, self.test])
                .context("--validation and --test")?,
            images: encoding.is_some(),
            allow_unverified: self.allow_unverified,
            replay: !self.no_replay,
            rollouts: None,
            tokenizer: self.tokenizer.clone(),
            trace_base: std::env::current_dir().ok(),
            name: name.to_owned(),
            licence: self.card.licence.clone(),
            command: command(
                crate::words()
                    .iter()
                    .skip(1)
                    .map(|word| word.to_string_lossy().into_owned()),
            ),
        })
    }

    /// Makes the dataset and tells of it.
    pub fn export(&self, out: &Path, options: &ExportOptions) -> anyhow::Result<ExitStatus> {
        let store = self.source.open()?;
        let (verifying, writing) = (progress::spinner(), progress::spinner());
        verifying.set_message("episodes verified");
        writing.set_message("episodes written");
        let make = || {
            let verified = |count: usize| verifying.inc(count as u64);
            let written = |count: usize| writing.inc(count as u64);
            reel_export::export(&store, out, options, &verified, &written)
        };
        let pool = inputs::pool(self.jobs)?;
        let report = pool.install(make);
        verifying.finish_and_clear();
        writing.finish_and_clear();
        tell(&report?, out, self.json)
    }
}

/// A format by its name.
pub fn format(name: &str) -> Result<Format, String> {
    let known = Format::ALL.map(Format::as_str).join(", ");
    Format::parse(name).ok_or_else(|| format!("no such format; known are {known}"))
}

pub fn style(name: &str) -> Result<Style, String> {
    let known = Style::ALL.map(Style::as_str).join(", ");
    Style::parse(name).ok_or_else(|| format!("no such style; known are {known}"))
}

fn words(name: &str) -> Result<AnnotationSource, String> {
    match name {
        "auto" => Ok(AnnotationSource::Auto),
        "rules" => Ok(AnnotationSource::Rules),
        "recorded" => Ok(AnnotationSource::Recorded),
        "notes" => Ok(AnnotationSource::Notes),
        _ => Err("known are auto, rules, recorded and notes".into()),
    }
}

fn split_by(name: &str) -> Result<SplitBy, String> {
    match name {
        "task" => Ok(SplitBy::Task),
        "scene" => Ok(SplitBy::Scene),
        _ => Err("known are task and scene".into()),
    }
}

/// The command without what does not decide what is in the dataset.
pub fn command(arguments: impl Iterator<Item = String>) -> String {
    let mut said = vec!["reel".to_owned()];
    let mut arguments = arguments;
    while let Some(argument) = arguments.next() {
        match argument.split('=').next() {
            Some("--out" | "--jobs") if !argument.contains('=') => drop(arguments.next()),
            Some("--out" | "--jobs" | "--json") => {}
            _ if argument.contains(|letter: char| {
                letter.is_whitespace() || "'\"$()<>|&;*?".contains(letter)
            }) =>
            {
                said.push(format!("'{}'", argument.replace('\'', "'\\''")));
            }
            _ => said.push(argument),
        }
    }
    said.join(" ")
}

fn tell(report: &ExportReport, out: &Path, json: bool) -> anyhow::Result<ExitStatus> {
    for refusal in &report.refused {
        let call = refusal
            .call
            .map_or_else(String::new, |call| format!(", call {call}"));
        eprintln!(
            "reel: {}{call} is left out: {}",
            refusal.trace, refusal.reason
        );
    }
    let answer = if report.refused.is_empty() {
        ExitStatus::Success
    } else {
        ExitStatus::Partial
    };
    if json {
        println!("{}", serde_json::to_string(report)?);
        return Ok(answer);
    }
    let examples: u64 = report.examples.values().sum();
    let parts: Vec<String> = report
        .examples
        .iter()
        .map(|(split, count)| format!("{} {count}", split.as_str()))
        .collect();
    println!(
        "{examples} examples ({}) of {} episodes in {}",
        parts.join(", "),
        report.episodes,
        out.display()
    );
    println!(
        "  {} images; store version {}",
        report.images, report.table_version
    );
    for (reason, count) in &report.excluded {
        println!("  left out: {count} {reason}");
    }
    for (reason, count) in &report.unwritable {
        println!("  left out: {count} examples that the format cannot hold: {reason}");
    }
    if !report.refused.is_empty() {
        println!("  refused: {} (listed above)", report.refused.len());
    }
    if report.unverified > 0 {
        println!(
            "  {} examples are of episodes that are not verified, and say so",
            report.unverified
        );
    }
    if report.history.corrected + report.history.dropped > 0 {
        println!(
            "  sentences of Histories that the record refutes: {} mended, {} dropped",
            report.history.corrected, report.history.dropped
        );
    }
    Ok(answer)
}
