//! `reel pack` and `reel unpack`: many episodes in one file, as their inputs, and their traces again.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Component, Path, PathBuf},
};

use anyhow::{Context, bail};
use rayon::prelude::*;
use reel_trace::{PackedEpisode, Shard, ShardWriter, Trace, TraceFiles, member, name_of_member};
use reel_world::{Assets as _, printable_line};
use serde_json::json;

use crate::{ExitStatus, inputs, progress};

/// Traces of a batch, which are executed side by side and written in their order.
const BATCH: usize = 64;

/// Pack traces into one file that keeps their inputs alone: 300 bytes an episode, where there are
/// hundreds. What came of the inputs is executed again when somebody reads it, so every byte of
/// each trace comes back, frames included, with a build of the same simulator version. Each trace
/// is executed before it is packed; one whose bytes do not come back is named and left out.
///
/// Commands that execute, show or ingest traces read FILE#EPISODE as a trace (EPISODE: a number
/// from 0, or an episode's id), and FILE as a folder of all of them. `reel trace doctor`, `recover`
/// and `copy` want the traces themselves: `reel unpack` writes them.
///
/// Examples:
///   reel pack traces --out traces.mcap
///   reel replay traces.mcap
///   reel show traces.mcap#7
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Pack {
    /// Trace files, or folders of them
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// File to write; it must not be there, and ends with .mcap
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    execution: Execution,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Write the traces of a packed file, or list its episodes. Each is executed again and compared with
/// the digest of the trace that was packed.
///
/// Examples:
///   reel unpack traces.mcap --list
///   reel unpack traces.mcap --out traces
///   reel unpack traces.mcap --out traces --episode 7 --episode 1f2e3d4c5b6a7988
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Unpack {
    /// File of packed episodes, as `reel pack` writes it
    #[arg(value_name = "FILE")]
    shard: PathBuf,
    /// Folder for the traces
    #[arg(long, value_name = "DIR", required_unless_present = "list")]
    out: Option<PathBuf>,
    /// Only this episode, by its number from 0 or its id; several times for several
    #[arg(long, value_name = "EPISODE")]
    episode: Vec<String>,
    /// List the episodes instead
    #[arg(long, conflicts_with = "out")]
    list: bool,
    #[command(flatten)]
    execution: Execution,
    /// Print one JSON object per episode
    #[arg(long)]
    json: bool,
}

/// How the episodes of a shard are executed.
#[derive(clap::Args)]
struct Execution {
    #[command(flatten)]
    assets: inputs::Assets,
    /// Traces at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
}

/// Executes traces, writes those that come back into a shard and names the others (`reel pack`).
pub fn pack(arguments: &Pack) -> anyhow::Result<ExitStatus> {
    let out = &arguments.out;
    if out.extension().is_none_or(|extension| extension != "mcap") {
        bail!("{}: a file of episodes ends with .mcap", out.display());
    }
    if out.exists() {
        bail!(
            "{} is there already; delete it, or choose another name",
            out.display()
        );
    }
    let files = arguments.execution.assets.trace_files()?;
    let names = names(&files, &arguments.paths)?;
    let pool = inputs::pool(arguments.execution.jobs)?;
    let bar = progress::bar(names.len(), "pack");
    let mut shard = ShardWriter::create(out)?;
    let (mut before, mut refused) = (0, Vec::new());
    let names: Vec<(String, PathBuf)> = names.into_iter().collect();
    for batch in names.chunks(BATCH) {
        let one = |(name, path): &(String, PathBuf)| {
            let packed = packed(&files, path, name);
            bar.inc(1);
            packed
        };
        let packed: Vec<_> = pool.install(|| batch.par_iter().with_max_len(1).map(one).collect());
        for (packed, (_, path)) in packed.into_iter().zip(batch) {
            match packed {
                Ok(packed) => {
                    before += packed.bytes;
                    shard.add(&packed)?;
                }
                Err(reason) => refused.push((path, reason)),
            }
        }
    }
    bar.finish_and_clear();
    if refused.len() == names.len() {
        for (path, reason) in &refused {
            eprintln!("reel: {} is not packed: {reason}", path.display());
        }
        bail!("none of the {} traces can be packed", names.len());
    }
    let done = shard.finish()?;
    let each = done.bytes / u64::from(done.episodes.max(1));
    if arguments.json {
        let refused: Vec<_> = refused
            .iter()
            .map(|(path, reason)| json!({ "trace": path, "reason": reason }))
            .collect();
        println!(
            "{}",
            json!({
                "shard": out, "episodes": done.episodes, "tasks": done.tasks, "scenes": done.scenes,
                "bytes_before": before, "bytes": done.bytes, "bytes_per_episode": each, "refused": refused,
            })
        );
    } else {
        for (path, reason) in &refused {
            eprintln!("reel: {} is not packed: {reason}", path.display());
        }
        println!(
            "{} of {} episodes ({} tasks, {} scenes): {before} bytes became {}, {each} an episode",
            done.episodes,
            names.len(),
            done.tasks,
            done.scenes,
            done.bytes
        );
    }
    Ok(match refused.is_empty() {
        true => ExitStatus::Success,
        false => ExitStatus::CheckFailed,
    })
}

/// The inputs of a trace, once they gave all of it again.
fn packed(files: &TraceFiles, path: &Path, name: &str) -> Result<PackedEpisode, String> {
    let read = || -> anyhow::Result<(Trace, Vec<u8>)> {
        let bytes = files.bytes(path)?;
        let trace = Trace::from_bytes(path, &bytes, &reel_trace::Limits::default())?;
        Ok((files.with_meshes(trace), bytes))
    };
    let (trace, bytes) = read().map_err(|error| format!("{error:#}"))?;
    reel_replay::pack(&trace, &bytes, name)
}

/// The traces of the paths, by the names that they have in the shard.
fn names(files: &TraceFiles, paths: &[PathBuf]) -> anyhow::Result<BTreeMap<String, PathBuf>> {
    let (mut names, mut noted) = (BTreeMap::new(), BTreeSet::new());
    for root in paths {
        for path in inputs::traces(files, std::slice::from_ref(root))? {
            let name = match path.strip_prefix(root) {
                Ok(below) if below != Path::new("") => below,
                _ => Path::new(path.file_name().context("a trace has a name")?),
            };
            let name = name
                .to_str()
                .with_context(|| format!("its name is not UTF-8: {}", path.display()))?;
            if let Some((shard, _)) = member(&path).filter(|_| !path.exists()) {
                if noted.insert(shard.to_owned()) {
                    eprintln!(
                        "reel: {} is packed already; `reel unpack` it to pack its traces anew",
                        shard.display()
                    );
                }
                continue;
            }
            if let Some(other) = names.insert(name.to_owned(), path.clone()) {
                bail!(
                    "{} and {} would both be {name} in the shard; pack them one folder at a time",
                    other.display(),
                    path.display()
                );
            }
        }
    }
    if names.is_empty() {
        bail!("there is no trace to pack");
    }
    Ok(names)
}

/// Writes the traces of a shard, or lists them (`reel unpack`).
pub fn unpack(arguments: &Unpack) -> anyhow::Result<ExitStatus> {
    let shard = Shard::open(&arguments.shard)?;
    let numbers: Vec<u32> = match arguments.episode.as_slice() {
        [] => (0..shard.len()).collect(),
        wanted => wanted
            .iter()
            .map(|episode| shard.find(episode))
            .collect::<Result<_, _>>()?,
    };
    let Some(out) = &arguments.out else {
        return list(&shard, &numbers, arguments.json);
    };
    let assets = arguments.execution.assets.open()?;
    let bar = progress::bar(numbers.len(), "unpack");
    let one = |number: &u32| -> anyhow::Result<PathBuf> {
        let packed = shard.episode(*number)?;
        let to = target(out, &packed.name)?;
        let meshes = match &assets {
            Some(folder) => folder.meshes(&mut packed.header.meshes.keys()),
            None => reel_world::Meshes::default(),
        };
        let bytes = reel_replay::unpack(&packed, &meshes).map_err(anyhow::Error::msg)?;
        write_new(&to, &bytes).with_context(|| format!("cannot write {}", to.display()))?;
        bar.inc(1);
        Ok(to)
    };
    let results: Vec<_> = inputs::pool(arguments.execution.jobs)?.install(|| {
        let one = |number| (number, one(number));
        numbers.par_iter().with_max_len(1).map(one).collect()
    });
    bar.finish_and_clear();
    let mut done = 0;
    for (number, result) in results {
        let member = name_of_member(&arguments.shard, *number);
        match result {
            Ok(path) => {
                done += 1;
                if arguments.json {
                    println!("{}", json!({ "episode": member, "trace": path }));
                }
            }
            Err(error) => eprintln!("reel: {}: {error:#}", member.display()),
        }
    }
    if !arguments.json {
        println!("{done} of {} traces in {}", numbers.len(), out.display());
    }
    Ok(match done == numbers.len() {
        true => ExitStatus::Success,
        false => ExitStatus::CheckFailed,
    })
}

fn list(shard: &Shard, numbers: &[u32], as_json: bool) -> anyhow::Result<ExitStatus> {
    if !as_json {
        println!("number  id                calls      bytes  trace");
    }
    for number in numbers {
        let PackedEpisode {
            name,
            header,
            inputs,
            bytes,
            chain,
            ..
        } = shard.episode(*number)?;
        let calls = inputs.len();
        if as_json {
            println!(
                "{}",
                json!({
                    "number": number, "episode_id": header.episode_id, "trace": name, "trace_digest": chain,
                    "task_id": header.task_id, "policy": header.policy.name, "seed": header.seed,
                    "calls": calls, "bytes": bytes,
                })
            );
        } else {
            println!(
                "{number:6}  {}  {calls:5}  {bytes:9}  {}",
                header.episode_id,
                printable_line(&name)
            );
        }
    }
    Ok(ExitStatus::Success)
}

/// Where a trace goes: below the folder, whatever the shard says.
fn target(out: &Path, name: &str) -> anyhow::Result<PathBuf> {
    let parts = Path::new(name).components();
    let inside = |part: Component<'_>| matches!(part, Component::Normal(_) | Component::CurDir);
    if name.is_empty() || !parts.clone().all(inside) {
        bail!(
            "the shard names its trace '{}', which is outside of {}",
            printable_line(name),
            out.display()
        );
    }
    Ok(out.join(name))
}

/// Writes a file where there is none, or one with these very bytes.
fn write_new(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder)?;
    }
    if fs::read(path).is_ok_and(|there| there == bytes) {
        return Ok(());
    }
    Ok(reel_trace::write_new(path, bytes)?)
}
