//! `reel dataset`: what is wrong with a training set, what its examples look like, and what is in a
//! set of any origin.

mod annotate;
mod diff;
mod gspo;
mod join;
mod profile;

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context, bail};
use reel_dataset::TokenizerFile;
use reel_dataset::lint::{Dataset, Format, LintOptions, image_bytes, lint, show};
use reel_lerobot::lint::{is_lerobot, lint as lint_dataset};

use crate::{ExitStatus, progress};

/// Check and show training sets of any origin (Hugging Face Parquet, Qwen-VL, ms-swift,
/// LLaMA-Factory, TRL and OpenAI files, and folders of them), describe, compare and join sets of
/// any columns, and complete what they are made from. `reel export` writes them.
///
/// Examples:
///   reel dataset lint sft
///   reel dataset show sft --row 12
///   reel dataset profile sft
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Look for leaks, contradictions, duplicates, bad labels, missing images and what the
    /// loader would do silently
    ///
    /// In a LeRobot dataset of version 3 (a folder with meta/info.json): metadata against frames,
    /// videos and statistics, splits, duplicates, and ground truth in observations. The options
    /// about tokens and similarity do not apply there.
    ///
    /// Exit code 1: something is an error.
    ///
    /// Example:
    ///   reel dataset lint sft
    ///   reel dataset lint lerobot
    #[command(verbatim_doc_comment)]
    Lint {
        #[command(flatten)]
        input: Input,
        /// Context length of the model in tokens; longer examples are reported
        #[arg(
            long = "context-length",
            alias = "budget",
            value_name = "TOKENS",
            default_value_t = 8_192
        )]
        budget: u64,
        /// The `tokenizer.json` of the model, to count tokens by; without it a token is four
        /// bytes
        #[arg(long, value_name = "FILE")]
        tokenizer: Option<PathBuf>,
        /// Similarity (0 to 1, of word triples) from which two examples are near-duplicates
        #[arg(
            long = "min-similarity",
            alias = "similarity",
            value_name = "SHARE",
            default_value_t = 0.9
        )]
        similarity: f64,
        /// Findings shown of each kind
        #[arg(long, value_name = "N", default_value_t = 3)]
        examples: usize,
        /// Print the report as one JSON object
        #[arg(long)]
        json: bool,
    },
    /// Print an example as the model sees it, and write its images
    ///
    /// Example:
    ///   reel dataset show sft --row 12 --images-out shown
    #[command(verbatim_doc_comment)]
    Show {
        #[command(flatten)]
        input: Input,
        /// Number of the example, from 0
        #[arg(long, value_name = "N", default_value_t = 0)]
        row: u64,
        /// Write the images into this folder
        #[arg(long, alias = "pictures", value_name = "DIR")]
        images_out: Option<PathBuf>,
    },
    #[command(about = "Describe the columns, lengths, duplicates and balance of any set")]
    Profile(profile::Arguments),
    #[command(about = "Compare two versions of a set: columns, rows, drift, balance")]
    Diff(diff::Arguments),
    #[command(about = "Join two sets by equal keys into a new file")]
    Join(join::Arguments),
    #[command(about = "Write reasoning and History for traces of agents that wrote none")]
    Annotate(annotate::Arguments),
    #[command(about = "Compute the GSPO objective of two recorded policies over the same tokens")]
    Gspo(Box<gspo::Arguments>),
}

#[derive(clap::Args)]
struct Input {
    /// Files or folders of one dataset
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// The format, if it cannot be detected: parquet, trl,
    /// openai, ms-swift, llama-factory, qwen-vl
    #[arg(long, value_name = "NAME", value_parser = crate::commands::export::format)]
    format: Option<Format>,
    /// Folder that relative image paths begin from; without it that of the file
    #[arg(long = "image-root", alias = "images", value_name = "DIR")]
    images: Option<PathBuf>,
}

/// Checks a training dataset, or prints one of its examples.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match &arguments.command {
        Command::Profile(arguments) => profile::run(arguments),
        Command::Diff(arguments) => diff::run(arguments),
        Command::Join(arguments) => join::run(arguments),
        Command::Annotate(arguments) => annotate::run(arguments),
        Command::Gspo(arguments) => gspo::run(arguments),
        Command::Lint {
            input,
            budget,
            tokenizer,
            similarity,
            examples,
            json,
        } => {
            let mut options = LintOptions {
                context_tokens_max: *budget,
                similarity_min: *similarity,
                examples_max: *examples,
                ..LintOptions::default()
            };
            if let Some(path) = tokenizer {
                options.tokenizer = Arc::new(TokenizerFile::open(path)?);
            }
            if let [root] = &input.paths[..]
                && is_lerobot(root)
            {
                return lint_lerobot(root, *examples, *json);
            }
            let dataset = input.open()?;
            let spinner = progress::spinner();
            spinner.set_message("rows");
            let report = lint(&dataset, &options, |rows| spinner.set_position(rows));
            spinner.finish_and_clear();
            if *json {
                println!("{}", serde_json::to_string(&report)?);
            } else {
                print!("{report}");
            }
            Ok(if report.is_bad() {
                ExitStatus::CheckFailed
            } else {
                ExitStatus::Success
            })
        }
        Command::Show {
            input,
            row,
            images_out,
        } => {
            let dataset = input.open()?;
            let Some(example) = dataset.row(*row) else {
                bail!("there is no example {row}; count from 0");
            };
            let example = example.with_context(|| format!("example {row} cannot be read"))?;
            println!("{}", show(&example));
            let Some(folder) = images_out else {
                return Ok(ExitStatus::Success);
            };
            fs::create_dir_all(folder)
                .with_context(|| format!("cannot make {}", folder.display()))?;
            for (index, image) in example.images.iter().enumerate() {
                let Some(bytes) = image_bytes(image) else {
                    eprintln!("reel: image {} is not there", index + 1);
                    continue;
                };
                let extension = match &bytes[..] {
                    [0x89, b'P', b'N', b'G', ..] => "png",
                    [0xff, 0xd8, ..] => "jpg",
                    _ => "webp",
                };
                let file = folder.join(format!("row-{row}-{}.{extension}", index + 1));
                fs::write(&file, &bytes)
                    .with_context(|| format!("cannot write {}", file.display()))?;
                println!("{}", file.display());
            }
            Ok(ExitStatus::Success)
        }
    }
}

/// Checks a LeRobot dataset, which says itself what it holds.
fn lint_lerobot(root: &Path, examples: usize, json: bool) -> anyhow::Result<ExitStatus> {
    let spinner = progress::spinner();
    spinner.set_message("frames");
    let report = lint_dataset(root, examples, |frames| spinner.set_position(frames));
    spinner.finish_and_clear();
    let report = report?;
    if json {
        println!("{}", serde_json::to_string(&report)?);
    } else {
        print!("{report}");
    }
    Ok(if report.is_bad() {
        ExitStatus::CheckFailed
    } else {
        ExitStatus::Success
    })
}

impl Input {
    fn open(&self) -> anyhow::Result<Dataset> {
        Ok(Dataset::open(
            &self.paths,
            self.format,
            self.images.clone(),
        )?)
    }
}
