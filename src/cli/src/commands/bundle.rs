//! `reel bundle`: a benchmark run in one file that carries its proof.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::Context;
use rayon::prelude::*;
use reel_bundle::{BundleInputs, CheckedBundle, Key, make};
use reel_trace::{Limits, PackedEpisode, Trace, TraceFiles};
use reel_world::record::{EndReason, EndRecord};

use crate::{ExitStatus, inputs, progress};

/// Traces that are packed at a time.
const BATCH: usize = 64;

/// Put a benchmark run into one file that carries its proof: the tasks and scenes, every episode as
/// its inputs (the words of the models among them), the table of results, an in-toto statement over
/// all of it, and a signature. Every episode is executed again while it is packed.
///
/// Examples:
///   reel bundle bench/planner --tasks tasks --out planner.reel
///   reel bundle bench/qwen --tasks tasks --key ~/.ssh/id_ed25519 --out qwen.reel
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The folder of the run, as `reel bench` writes it
    #[arg(value_name = "DIR")]
    run: PathBuf,
    /// The file to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// The tasks that were to be played (REAL-Bench YAML, or a folder of them); without it those that were
    #[arg(long, value_name = "PATH")]
    tasks: Option<PathBuf>,
    #[command(flatten)]
    scene: inputs::SceneArguments,
    #[command(flatten)]
    assets: inputs::Assets,
    /// Name of the run, for people; without it the name of the folder
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// Private key that signs it, as OpenSSH writes them (Ed25519); `reel key new` makes one
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// Make it although episodes are missing; they count as failures
    #[arg(long)]
    partial: bool,
    /// Leave the log of the model calls (calls.jsonl) out
    #[arg(long)]
    no_log: bool,
    /// Traces at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
}

/// Puts a run into one file.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let tasks = match &arguments.tasks {
        Some(path) => super::verify::task_entries(path, &arguments.scene)?,
        None => Vec::new(),
    };
    let key = arguments.key.as_deref().map(key).transpose()?;
    let calls = arguments.run.join("calls.jsonl");
    let calls = match !arguments.no_log && calls.is_file() {
        true => Some(fs::read(&calls).with_context(|| format!("cannot read {}", calls.display()))?),
        false => None,
    };
    let name = match &arguments.name {
        Some(name) => name.clone(),
        None => folder_name(&arguments.run)?,
    };
    let scratch = std::env::temp_dir().join(format!("reel-bundle-{}", std::process::id()));
    fs::create_dir_all(&scratch)?;
    let made = episodes(arguments).and_then(|episodes| {
        let made = BundleInputs {
            name,
            episodes,
            tasks,
            partial: arguments.partial,
            calls,
            key: key.as_ref(),
        };
        Ok(make(made, &scratch)?)
    });
    let _ = fs::remove_dir_all(&scratch);
    let bundle = made?;
    let bytes = bundle.to_bytes()?;
    fs::write(&arguments.out, &bytes)
        .with_context(|| format!("cannot write {}", arguments.out.display()))?;
    let checked = CheckedBundle::new(&bundle, None, None)?;
    let manifest = checked.manifest();
    let result = manifest
        .results
        .last()
        .context("a table has its last line")?;
    println!(
        "{}: {} of {} episodes, {} bytes; {result}",
        arguments.out.display(),
        result.played,
        result.episodes,
        bytes.len()
    );
    match &key {
        Some(key) => println!("signed by {}", key.signer()),
        None => println!("not signed: --key FILE signs it"),
    }
    Ok(ExitStatus::Success)
}

/// The episodes of the run that came to their end, packed and executed again.
fn episodes(arguments: &Arguments) -> anyhow::Result<Vec<(PackedEpisode, EndRecord)>> {
    let files = arguments.assets.trace_files()?;
    let paths = inputs::traces(&files, std::slice::from_ref(&arguments.run))?;
    let pool = inputs::pool(arguments.jobs)?;
    let bar = progress::bar(paths.len(), "pack");
    let mut packed = Vec::new();
    for batch in paths.chunks(BATCH) {
        let one = |path: &PathBuf| {
            let episode = episode(&files, path);
            bar.inc(1);
            episode.with_context(|| format!("{} cannot be bundled", path.display()))
        };
        let batch: Vec<_> = pool.install(|| batch.par_iter().with_max_len(1).map(one).collect());
        for episode in batch {
            packed.extend(episode?);
        }
    }
    bar.finish_and_clear();
    Ok(packed)
}

/// None of an episode that was aborted: it is as if it had not been played.
fn episode(files: &TraceFiles, path: &Path) -> anyhow::Result<Option<(PackedEpisode, EndRecord)>> {
    let bytes = files.bytes(path)?;
    let trace = files.with_meshes(Trace::from_bytes(path, &bytes, &Limits::default())?);
    let Some(end) = trace
        .end
        .clone()
        .filter(|end| end.reason != EndReason::Aborted)
    else {
        return Ok(None);
    };
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let packed = reel_replay::pack(&trace, &bytes, &name).map_err(anyhow::Error::msg)?;
    Ok(Some((packed, end)))
}

fn key(path: &Path) -> anyhow::Result<Key> {
    let text = fs::read_to_string(path)
        .with_context(|| format!("cannot read the key {}", path.display()))?;
    Key::from_openssh(&text).with_context(|| path.display().to_string())
}

fn folder_name(folder: &Path) -> anyhow::Result<String> {
    let folder = fs::canonicalize(folder)
        .with_context(|| format!("cannot read the folder {}", folder.display()))?;
    let name = folder.file_name().unwrap_or_default();
    Ok(name.to_string_lossy().into_owned())
}
