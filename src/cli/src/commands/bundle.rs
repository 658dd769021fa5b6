//! `reel bundle` and `reel verify`: a benchmark run in one file, and whether what it claims holds.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context, bail};
use rayon::prelude::*;
use reel_bundle::{
    Benchmark, Bundle, BundleInputs, CheckedBundle, Finding, Key, Sample, Signer, TaskEntry,
    Verification, make,
};
use reel_tasks::ObjectOrder;
use reel_trace::{Limits, PackedEpisode, Trace, TraceFiles};
use reel_world::{
    Assets, Digest,
    record::{EndReason, EndRecord},
};
use serde_json::json;

use crate::{ExitStatus, inputs, progress};

/// What a verdict proves and what not.
const NOT_PROVEN: &str = "Proven: these calls, in these scenes, with these seeds, give these results, under this reward. Not proven: that the model named \
                          here wrote these words, nor that no other run was made and left out.";
/// Traces that are packed at a time.
const BATCH: usize = 64;

/// Put a benchmark run into one file that carries its proof: the tasks and scenes, every episode as its
/// inputs (the words of the models among them), the table of results, an in-toto statement over all of it,
/// and a signature. Every episode is executed again while it is packed.
///
/// Examples:
///   reel bundle bench/planner --tasks tasks --out planner.reel
///   reel bundle bench/qwen --tasks tasks --key ~/.ssh/id_ed25519 --out qwen.reel
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct BundleArguments {
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

/// Execute the episodes of bundles again, recompute rewards, metrics and intervals, and say in one line
/// whether the claim holds. Exit code 1 where it does not. A sample is drawn anew each time, after the
/// bundle was handed in; what it may have missed is printed.
///
/// Examples:
///   reel verify planner.reel
///   reel verify planner.reel --tasks tasks --signer lab.pub       # these very tasks, signed by this key
///   reel verify submissions/*.reel --sample 5% --json
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct VerifyArguments {
    /// Bundles to verify, as `reel bundle` writes them
    #[arg(value_name = "BUNDLE", required = true)]
    bundles: Vec<PathBuf>,
    /// The tasks of the benchmark: a bundle with others, or without some, does not hold
    #[arg(long, value_name = "PATH")]
    tasks: Option<PathBuf>,
    #[command(flatten)]
    scene: inputs::SceneArguments,
    #[command(flatten)]
    assets: inputs::Assets,
    /// Execute only this share of the episodes, e.g. 5%
    #[arg(long, value_name = "SHARE", value_parser = share)]
    sample: Option<f64>,
    /// Draw the sample by this seed again
    #[arg(long, value_name = "N", requires = "sample")]
    seed: Option<u64>,
    /// Who must have signed it: a public key (`ssh-ed25519 AAAA...`) or a file with one
    #[arg(long, value_name = "KEY")]
    signer: Option<String>,
    /// Episodes at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print one JSON object for each bundle
    #[arg(long)]
    json: bool,
}

/// A share of the episodes: `5%` or `0.05`.
fn share(text: &str) -> Result<f64, String> {
    let number = |text: &str| text.trim().parse::<f64>().ok();
    let share = match text.strip_suffix('%') {
        Some(percent) => number(percent).map(|percent| percent / 100.0),
        None => number(text),
    };
    share
        .filter(|share| *share > 0.0 && *share <= 1.0)
        .ok_or_else(|| "a share is like 5% or 0.05, above 0 and at most 100%".to_owned())
}

/// Puts a run into one file.
pub fn bundle(arguments: &BundleArguments) -> anyhow::Result<ExitStatus> {
    let tasks = match &arguments.tasks {
        Some(path) => task_entries(path, &arguments.scene)?,
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
fn episodes(arguments: &BundleArguments) -> anyhow::Result<Vec<(PackedEpisode, EndRecord)>> {
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

/// Verifies bundles; exit code 1 where one does not hold.
pub fn verify(arguments: &VerifyArguments) -> anyhow::Result<ExitStatus> {
    let benchmark = match &arguments.tasks {
        Some(path) => Some(Benchmark {
            name: path.display().to_string(),
            tasks: task_entries(path, &arguments.scene)?,
        }),
        None => None,
    };
    let signer = arguments.signer.as_deref().map(signer).transpose()?;
    let (mut verified, mut unreadable) = (Vec::new(), 0);
    for path in &arguments.bundles {
        match verify_one(path, arguments, benchmark.as_ref(), signer.as_ref()) {
            Ok(verification) => {
                tell(path, &verification, arguments.json);
                verified.push((path, verification));
            }
            Err(error) => {
                unreadable += 1;
                let reason = format!("{error:#}");
                if arguments.json {
                    println!(
                        "{}",
                        json!({"bundle": path, "holds": false, "refused": reason})
                    );
                } else {
                    println!("{}: DOES NOT HOLD: {reason}", path.display());
                }
            }
        }
    }
    let duplicates = duplicates(&verified);
    for (one, other) in &duplicates {
        eprintln!(
            "reel: {} and {} are one run under two names: the same calls and words in every episode",
            one.display(),
            other.display()
        );
    }
    if !arguments.json {
        println!("{NOT_PROVEN}");
    }
    let holds =
        unreadable == 0 && duplicates.is_empty() && verified.iter().all(|(_, one)| one.holds);
    Ok(match holds {
        true => ExitStatus::Success,
        false => ExitStatus::CheckFailed,
    })
}

fn verify_one(
    path: &Path,
    arguments: &VerifyArguments,
    benchmark: Option<&Benchmark>,
    signer: Option<&Signer>,
) -> anyhow::Result<Verification> {
    let bytes = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    let checked = CheckedBundle::new(&Bundle::from_bytes(&bytes)?, benchmark, signer)?;
    let assets = arguments.assets.open()?;
    let sample = match arguments.sample {
        None => Sample::all(checked.len()),
        Some(share) => {
            let seed = arguments.seed.map_or_else(random, Ok)?;
            Sample::draw(checked.len(), share, seed)
        }
    };
    let bar = progress::bar(sample.episodes.len(), "execute");
    let execute = |number: &u32| {
        let meshes = checked.meshes(*number, assets.as_ref().map(|assets| assets as &dyn Assets));
        let found = checked.execute(*number, &meshes);
        bar.inc(1);
        found
    };
    let found: Vec<Vec<Finding>> = inputs::pool(arguments.jobs)?.install(|| {
        sample
            .episodes
            .par_iter()
            .with_max_len(1)
            .map(execute)
            .collect()
    });
    bar.finish_and_clear();
    Ok(checked.finish(sample, found.concat()))
}

fn tell(path: &Path, verification: &Verification, as_json: bool) {
    if as_json {
        let mut object = json!(verification);
        object["bundle"] = json!(path);
        println!("{object}");
        return;
    }
    println!("{}: {verification}", path.display());
    for finding in verification.findings.iter().skip(1) {
        println!("  {finding}");
    }
    match &verification.signer {
        Some(signer) => println!("  signed by {signer}"),
        None => println!("  not signed"),
    }
    match &verification.benchmark {
        Some(benchmark) => println!("  tasks and scenes are those of {benchmark}"),
        None => println!(
            "  tasks and scenes are those in the bundle; --tasks PATH compares them with a benchmark's"
        ),
    }
    if !verification.miss_probability.is_empty() {
        let missed: Vec<String> = verification
            .miss_probability
            .iter()
            .map(|(forged, chance)| format!("{forged} forged: {:.1} %", 100.0 * chance))
            .collect();
        println!(
            "  drawn by seed {}; chance that the sample missed all of {}",
            verification.executed.seed,
            missed.join(", ")
        );
    }
}

/// Pairs of bundles in which the same was played.
fn duplicates<'a>(verified: &[(&'a PathBuf, Verification)]) -> Vec<(&'a PathBuf, &'a PathBuf)> {
    let mut pairs = Vec::new();
    for (index, (path, one)) in verified.iter().enumerate() {
        let same = |(_, other): &&(&PathBuf, Verification)| {
            other.run_digest == one.run_digest && other.episodes > 0
        };
        pairs.extend(
            verified[..index]
                .iter()
                .find(same)
                .map(|(other, _)| (*other, *path)),
        );
    }
    pairs
}

fn task_entries(path: &Path, scene: &inputs::SceneArguments) -> anyhow::Result<Vec<TaskEntry>> {
    let inputs::Tasks {
        tasks,
        scenes,
        broken,
    } = inputs::tasks(path, scene, ObjectOrder::AsWritten)?;
    if broken > 0 {
        bail!(
            "{broken} tasks of {} cannot be read, so nobody can say whether they were played",
            path.display()
        );
    }
    let entry = |task: &Arc<reel_world::Task>| -> anyhow::Result<TaskEntry> {
        let scene = scenes
            .of(task)
            .context("tasks are loaded with their scenes")?;
        Ok(TaskEntry {
            id: task.task_id.clone(),
            family: task.family,
            task: Digest::of_json(&**task),
            scene: Digest::of_json(&**scene),
        })
    };
    tasks.iter().map(entry).collect()
}

fn key(path: &Path) -> anyhow::Result<Key> {
    let text = fs::read_to_string(path)
        .with_context(|| format!("cannot read the key {}", path.display()))?;
    Key::from_openssh(&text).with_context(|| path.display().to_string())
}

/// A public key, or a file with one.
fn signer(text: &str) -> anyhow::Result<Signer> {
    if text.trim_start().starts_with("ssh-") {
        return Ok(Signer::from_openssh(text)?);
    }
    let content =
        fs::read_to_string(text).with_context(|| format!("cannot read the key {text}"))?;
    Signer::from_openssh(&content).with_context(|| text.to_owned())
}

fn folder_name(folder: &Path) -> anyhow::Result<String> {
    let folder = fs::canonicalize(folder)
        .with_context(|| format!("cannot read the folder {}", folder.display()))?;
    let name = folder.file_name().unwrap_or_default();
    Ok(name.to_string_lossy().into_owned())
}

/// A seed that nobody knew before.
fn random() -> anyhow::Result<u64> {
    getrandom::u64()
        .map_err(|error| anyhow::anyhow!("this machine gives no random numbers: {error}"))
}
