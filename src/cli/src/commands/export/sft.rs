//! `reel export sft`: supervised training sets out of a store.

use std::{collections::BTreeSet, path::PathBuf};

use anyhow::Context;
use reel_dataset::{Encoding, Format, PictureOptions, Ratios, Style, WriterOptions};
use reel_export::{Selection, SftOptions, SftReport, SplitBy, Words};
use reel_query::Session;
use reel_tables::Store;

use crate::{Answer, inputs, progress};

/// Training examples from the episodes of a store: what the agent saw before a decision, and what it should do. Only episodes
/// that replay bit for bit become rows; every row names its trace, call, verdict, reward preset and rules. Broken off, the
/// same command goes on where it stopped. Same store version, same options: same bytes.
///
/// Example:
///   reel ingest traces --store store
///   reel export sft --store store --out sft --format trl
///   reel dataset lint sft
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The store: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store")]
    store: String,
    /// An earlier version of the store
    #[arg(long, value_name = "N")]
    version: Option<u64>,
    /// Folder of the dataset
    #[arg(long, value_name = "DIR", default_value = "sft")]
    out: PathBuf,
    /// What loads it: parquet (Hugging Face), trl, openai, ms-swift, llama-factory, qwen-vl
    #[arg(long, value_name = "NAME", default_value = "parquet", value_parser = format)]
    format: Format,
    /// How a decision is put: single-turn (the paper's), multi-turn (an episode with native tool calls), multi-turn-prefix
    #[arg(long, value_name = "STYLE", default_value = "single-turn", value_parser = style)]
    style: Style,
    /// Only episodes that fulfil this condition on table `episodes`, in SQL, e.g. "family = 'SUL' AND spl > 0.5"
    #[arg(long = "where", value_name = "SQL")]
    condition: Option<String>,
    /// Failed and broken-off episodes too, up to their decisive step (run `reel taxonomy` before)
    #[arg(long)]
    failed: bool,
    /// With --failed: decisions from the decisive step on too
    #[arg(long, requires = "failed")]
    after_decisive: bool,
    /// Episodes with a discounted return below this are left out
    #[arg(long, value_name = "RETURN", allow_negative_numbers = true)]
    return_min: Option<f64>,
    /// At most so many episodes a task
    #[arg(long, value_name = "N")]
    per_task: Option<usize>,
    /// Decisions that were mistakes are examples too: failed calls, wrong picks and places
    #[arg(long)]
    mistakes: bool,
    /// Decisions right after a mistake are no examples
    #[arg(long)]
    no_recoveries: bool,
    /// Decisions whose own History contradicts the record are examples too, their History mended
    #[arg(long)]
    contradictions: bool,
    /// Cut to the median size: family, tool
    #[arg(long, value_name = "WHAT", value_delimiter = ',', value_parser = ["family", "tool"])]
    balance: Vec<String>,
    /// Whose words: auto (a model's own where it spoke, else written by rules), rules, recorded
    #[arg(long, value_name = "WORDS", default_value = "auto", value_parser = words)]
    words: Words,
    /// What is kept together in a part of the dataset: task or scene
    #[arg(long, value_name = "WHAT", default_value = "task", value_parser = split_by)]
    split: SplitBy,
    /// Share of the validation part
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    validation: f64,
    /// Share of the test part
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    test: f64,
    /// Pictures: png, webp (both lossless), jpeg or none
    #[arg(long, value_name = "FORMAT", default_value = "png", value_parser = ["png", "webp", "jpeg", "none"])]
    images: String,
    /// Most pixels of a picture; 0: as they were taken (640 x 480)
    #[arg(long, value_name = "PIXELS", default_value_t = 100_352)]
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
    #[arg(long, value_name = "TOKENS", default_value_t = reel_dataset::CONTEXT_TOKENS)]
    budget: u32,
    /// What the dataset is called
    #[arg(long, value_name = "NAME", default_value = "reel-sft")]
    name: String,
    /// Licence of the data, as the dataset's card names it
    #[arg(long, value_name = "NAME", default_value = "other")]
    licence: String,
    /// Of every draw: splits, caps, balance, wordings
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Threads; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

/// A format by its name.
pub fn format(name: &str) -> Result<Format, String> {
    let known = Format::ALL.map(Format::as_str).join(", ");
    Format::parse(name).ok_or_else(|| format!("no such format; known are {known}"))
}

fn style(name: &str) -> Result<Style, String> {
    let known = Style::ALL.map(Style::as_str).join(", ");
    Style::parse(name).ok_or_else(|| format!("no such style; known are {known}"))
}

fn words(name: &str) -> Result<Words, String> {
    match name {
        "auto" => Ok(Words::Auto),
        "rules" => Ok(Words::Rules),
        "recorded" => Ok(Words::Recorded),
        _ => Err("known are auto, rules and recorded".into()),
    }
}

fn split_by(name: &str) -> Result<SplitBy, String> {
    match name {
        "task" => Ok(SplitBy::Task),
        "scene" => Ok(SplitBy::Scene),
        _ => Err("known are task and scene".into()),
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<Answer> {
    let options = options(arguments)?;
    let store = match arguments.version {
        Some(version) => Store::open_at(&arguments.store, version)?,
        None => Store::open(&arguments.store)?,
    };
    let (verifying, writing) = (progress::spinner(), progress::spinner());
    verifying.set_message("episodes verified");
    writing.set_message("episodes written");
    let make = || {
        let verified = |count: usize| verifying.inc(count as u64);
        let written = |count: usize| writing.inc(count as u64);
        reel_export::sft(&store, &arguments.out, &options, &verified, &written)
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(inputs::workers(arguments.jobs)).build()?;
    let report = pool.install(make);
    verifying.finish_and_clear();
    writing.finish_and_clear();
    tell(&report?, arguments)
}

fn options(arguments: &Arguments) -> anyhow::Result<SftOptions> {
    let train = 1.0 - arguments.validation - arguments.test;
    let balances = |what: &str| arguments.balance.iter().any(|name| name == what);
    let encoding = match arguments.images.as_str() {
        "webp" => Some(Encoding::Webp),
        "jpeg" => Some(Encoding::Jpeg { quality: 90 }),
        "png" => Some(Encoding::Png),
        _ => None,
    };
    let pixels_max = (arguments.pixels > 0).then_some(arguments.pixels);
    Ok(SftOptions {
        selection: Selection {
            episodes: arguments.condition.as_deref().map(|condition| episodes(arguments, condition)).transpose()?,
            failed: arguments.failed,
            return_min: arguments.return_min,
            per_task_max: arguments.per_task,
            mistakes: arguments.mistakes,
            recoveries: !arguments.no_recoveries,
            after_decisive: arguments.after_decisive,
            contradictions: arguments.contradictions,
            balance_families: balances("family"),
            balance_tools: balances("tool"),
            seed: arguments.seed,
        },
        writer: WriterOptions {
            pictures: PictureOptions { encoding: encoding.unwrap_or_default(), pixels_max, ..PictureOptions::default() },
            rows_max: arguments.rows_per_file,
            budget: arguments.budget,
            ..WriterOptions::new(arguments.format)
        },
        style: arguments.style,
        words: arguments.words,
        split_by: arguments.split,
        ratios: Ratios::new([train, arguments.validation, arguments.test]).context("--validation and --test")?,
        pictures: encoding.is_some(),
        allow_unverified: arguments.allow_unverified,
        replay: !arguments.no_replay,
        name: arguments.name.clone(),
        licence: arguments.licence.clone(),
        command: command(std::env::args().skip(1)),
    })
}

/// The command without what does not decide what is in the dataset.
fn command(arguments: impl Iterator<Item = String>) -> String {
    let mut said = vec!["reel".to_owned()];
    let mut arguments = arguments;
    while let Some(argument) = arguments.next() {
        match argument.split('=').next() {
            Some("--out" | "--jobs") if !argument.contains('=') => drop(arguments.next()),
            Some("--out" | "--jobs" | "--json") => {}
            _ if argument.contains(|letter: char| letter.is_whitespace() || "'\"$()<>|&;*?".contains(letter)) => {
                said.push(format!("'{}'", argument.replace('\'', "'\\''")));
            }
            _ => said.push(argument),
        }
    }
    said.join(" ")
}

/// The episodes that fulfil a condition.
fn episodes(arguments: &Arguments, condition: &str) -> anyhow::Result<BTreeSet<String>> {
    let store = match arguments.version {
        Some(version) => Store::open_at(&arguments.store, version)?,
        None => Store::open(&arguments.store)?,
    };
    let batches = Session::new(store)?
        .run(&format!("SELECT episode_id FROM episodes WHERE {condition}"))
        .with_context(|| format!("--where {condition}"))?;
    let mut found = BTreeSet::new();
    for batch in &batches {
        found.extend(reel_tables::rows_from::<(String,)>(batch)?.into_iter().map(|(episode,)| episode));
    }
    Ok(found)
}

fn tell(report: &SftReport, arguments: &Arguments) -> anyhow::Result<Answer> {
    for refusal in &report.refused {
        let call = refusal.call.map_or_else(String::new, |call| format!(", call {call}"));
        eprintln!("reel: {}{call} is left out: {}", refusal.trace, refusal.reason);
    }
    let answer = if report.refused.is_empty() { Answer::Yes } else { Answer::Loss };
    if arguments.json {
        println!("{}", serde_json::to_string(report)?);
        return Ok(answer);
    }
    let examples: u64 = report.examples.values().sum();
    let parts: Vec<String> = report.examples.iter().map(|(split, count)| format!("{} {count}", split.as_str())).collect();
    println!("{examples} examples ({}) of {} episodes in {}", parts.join(", "), report.episodes, arguments.out.display());
    println!("  {} pictures; store version {}", report.pictures, report.table_version);
    for (reason, count) in &report.left_out {
        println!("  left out: {count} {reason}");
    }
    if !report.refused.is_empty() {
        println!("  refused: {} (said above)", report.refused.len());
    }
    if report.unverified > 0 {
        println!("  {} examples are of episodes that are not verified, and say so", report.unverified);
    }
    if report.history.mended + report.history.dropped > 0 {
        println!(
            "  sentences of Histories that the record refutes: {} mended, {} dropped",
            report.history.mended, report.history.dropped
        );
    }
    Ok(answer)
}
