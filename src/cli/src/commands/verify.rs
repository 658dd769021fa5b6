//! `reel verify`: whether what bundles claim holds, once their episodes were executed again.

use std::{
    collections::{BTreeMap, btree_map::Entry},
    fs,
    panic::{self, AssertUnwindSafe},
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context, bail};
use rayon::prelude::*;
use reel_bundle::{
    Benchmark, Bundle, CheckedBundle, Finding, FindingKind, Manifest, Sample, Signer, TaskEntry,
    Verification,
};
use reel_tasks::ObjectOrder;
use reel_world::{Assets, Digest, printable_line};
use serde_json::json;

use crate::{ExitStatus, inputs, progress};

/// What a verdict proves and what it does not.
pub const NOT_PROVEN: &str = "Proven: these calls, in these scenes, with these seeds, give these results, under this reward. Not proven: that the model named \
                          here wrote these words, nor that no other run was made and left out.";

/// Execute the episodes of bundles again, recompute rewards, metrics and intervals, and say in one
/// line whether the claim holds. Exit code 1 where it does not. A sample is drawn anew each time,
/// after the bundle was handed in; what it may have missed is printed.
///
/// Examples:
///   reel verify planner.reel
///   reel verify planner.reel --tasks tasks --signer lab.pub    # these very tasks, signed by this key
///   reel verify submissions/*.reel --sample 5% --json
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Bundles to verify, as `reel bundle` writes them
    #[arg(value_name = "BUNDLE", required = true)]
    bundles: Vec<PathBuf>,
    #[command(flatten)]
    checks: Checks,
    /// Who must have signed it: a public key (`ssh-ed25519 AAAA...`) or a file with one
    #[arg(long, value_name = "KEY")]
    signer: Option<String>,
    /// Print one JSON object for each bundle
    #[arg(long)]
    json: bool,
}

/// What bundles are compared with, and how much of them is executed.
#[derive(clap::Args)]
pub struct Checks {
    /// The tasks of the benchmark: a bundle with others, or without some, does not hold
    #[arg(long, value_name = "PATH")]
    tasks: Option<PathBuf>,
    #[command(flatten)]
    scene: inputs::SceneArguments,
    #[command(flatten)]
    assets: inputs::Assets,
    /// Execute only this share of the episodes, e.g. 5%
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub sample: Option<f64>,
    /// Draw the sample by this seed again
    #[arg(long, value_name = "N", requires = "sample")]
    seed: Option<u64>,
    /// Episodes at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
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

/// Verifies bundles; exit code 1 where one does not hold.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let benchmark = arguments.checks.benchmark()?;
    let signer = arguments.signer.as_deref().map(signer).transpose()?;
    let (mut verified, mut unreadable) = (Vec::new(), 0);
    for path in &arguments.bundles {
        let verification = arguments
            .checks
            .verify(path, benchmark.as_ref(), signer.as_ref());
        match verification {
            Ok((_, verification)) => {
                tell(path, &verification, arguments.json);
                verified.push((path.as_path(), verification));
            }
            Err(error) => {
                unreadable += 1;
                let reason = printable_line(&format!("{error:#}"));
                if arguments.json {
                    println!(
                        "{}",
                        json!({"bundle": path.to_string_lossy(), "holds": false, "refused": reason})
                    );
                } else {
                    println!("{}: DOES NOT HOLD: {reason}", told(path));
                }
            }
        }
    }
    let duplicates = duplicates(verified.iter().map(|(path, one)| (*path, one)));
    for (one, other) in &duplicates {
        eprintln!(
            "reel: {} and {} are one run under two names: the same calls and words in every episode",
            told(one),
            told(other)
        );
    }
    if !arguments.json && verified.iter().any(|(_, one)| one.holds) {
        println!("{NOT_PROVEN}");
    }
    let holds =
        unreadable == 0 && duplicates.is_empty() && verified.iter().all(|(_, one)| one.holds);
    Ok(match holds {
        true => ExitStatus::Success,
        false => ExitStatus::CheckFailed,
    })
}

impl Checks {
    /// The tasks that should have been played, where they are named.
    pub fn benchmark(&self) -> anyhow::Result<Option<Benchmark>> {
        let benchmark = |path: &PathBuf| -> anyhow::Result<Benchmark> {
            Ok(Benchmark {
                name: path.display().to_string(),
                tasks: task_entries(path, &self.scene)?,
            })
        };
        self.tasks.as_ref().map(benchmark).transpose()
    }

    /// Verifies a bundle; gives what it claims besides.
    pub fn verify(
        &self,
        path: &Path,
        benchmark: Option<&Benchmark>,
        signer: Option<&Signer>,
    ) -> anyhow::Result<(Manifest, Verification)> {
        let bytes = read(path).with_context(|| format!("cannot read {}", path.display()))?;
        let checked = CheckedBundle::new(&Bundle::from_bytes(&bytes)?, benchmark, signer)?;
        let assets = self.assets.open()?;
        let sample = match self.sample {
            None => Sample::all(checked.len()),
            Some(share) => {
                let seed = self.seed.map_or_else(random, Ok)?;
                Sample::draw(checked.len(), share, seed)
            }
        };
        let bar = progress::bar(sample.episodes.len(), "execute");
        let execute = |number: &u32| {
            let meshes =
                checked.meshes(*number, assets.as_ref().map(|assets| assets as &dyn Assets));
            let found = contained(*number, || checked.execute(*number, &meshes));
            bar.inc(1);
            found
        };
        let executed = sample.episodes.par_iter().with_max_len(1).map(execute);
        let found: Vec<Vec<Finding>> = inputs::pool(self.jobs)?.install(|| executed.collect());
        bar.finish_and_clear();
        let verification = checked.finish(sample, found.concat());
        Ok((checked.manifest().clone(), verification))
    }
}

/// A file that somebody handed in; no pipe or device, which may never end.
fn read(path: &Path) -> std::io::Result<Vec<u8>> {
    if !fs::metadata(path)?.is_file() {
        return Err(std::io::Error::other("it is no file"));
    }
    fs::read(path)
}

/// What an execution found. Where it breaks the simulator, that is one finding, and other episodes and bundles are executed still.
fn contained(number: u32, execution: impl FnOnce() -> Vec<Finding>) -> Vec<Finding> {
    panic::catch_unwind(AssertUnwindSafe(execution)).unwrap_or_else(|_| {
        let text =
            "it breaks the simulator (standard error has the place); this is a defect of Reel";
        vec![Finding::of_episode(FindingKind::Episode, number, text)]
    })
}

/// The name of a file that somebody handed in.
fn told(path: &Path) -> String {
    printable_line(&path.display().to_string())
}

fn tell(path: &Path, verification: &Verification, as_json: bool) {
    if as_json {
        let mut object = json!(verification);
        object["bundle"] = json!(path.to_string_lossy());
        println!("{object}");
        return;
    }
    println!("{}: {verification}", told(path));
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
pub fn duplicates<'a>(
    verified: impl Iterator<Item = (&'a Path, &'a Verification)>,
) -> Vec<(&'a Path, &'a Path)> {
    let mut first: BTreeMap<String, &Path> = BTreeMap::new();
    verified
        .filter(|(_, one)| one.episodes > 0)
        .filter_map(
            |(path, one)| match first.entry(one.run_digest.to_string()) {
                Entry::Occupied(other) => Some((*other.get(), path)),
                Entry::Vacant(none) => {
                    none.insert(path);
                    None
                }
            },
        )
        .collect()
}

/// Every task of a file or folder with the digests that a bundle claims of it.
pub fn task_entries(path: &Path, scene: &inputs::SceneArguments) -> anyhow::Result<Vec<TaskEntry>> {
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

/// A public key, or a file with one.
fn signer(text: &str) -> anyhow::Result<Signer> {
    if text.trim_start().starts_with("ssh-") && !Path::new(text).exists() {
        return Ok(Signer::from_openssh(text)?);
    }
    let content =
        fs::read_to_string(text).with_context(|| format!("cannot read the key {text}"))?;
    Signer::from_openssh(&content).with_context(|| text.to_owned())
}

/// A seed that nobody knew before.
fn random() -> anyhow::Result<u64> {
    getrandom::u64()
        .map_err(|error| anyhow::anyhow!("this machine gives no random numbers: {error}"))
}
