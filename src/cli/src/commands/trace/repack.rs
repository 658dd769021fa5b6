//! `reel trace compact` and `reel trace expand`: traces without their images, and with them again.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use rayon::prelude::*;
use reel_replay::RepackError;
use reel_trace::{Trace, TraceSummary, content};
use serde_json::json;

use crate::{ExitStatus, inputs, progress};

/// Drop the frames of traces: about a twentieth of the bytes remains. Their digests stay, and
/// `reel trace expand` renders the images again, bit for bit, with a build of the same simulator
/// version. Each trace is replayed first, so that every dropped frame can be rendered again.
///
/// Examples:
///   reel trace compact traces-out --out lean
///   reel trace compact traces-out --in-place
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Compact {
    #[command(flatten)]
    common: Common,
    /// Skip the replay before
    #[arg(long)]
    unverified: bool,
}

/// Render the frames of compacted traces again: the result has the bytes of the trace as it was
/// recorded with frames.
///
/// Examples:
///   reel trace expand lean --out full
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Expand {
    #[command(flatten)]
    common: Common,
}

#[derive(clap::Args)]
struct Common {
    /// Trace files, or folders of them
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Folder for the new traces
    #[arg(
        long,
        value_name = "DIR",
        required_unless_present = "in_place",
        conflicts_with = "in_place"
    )]
    out: Option<PathBuf>,
    /// Replace each trace, at once and only when the new one is whole
    #[arg(long)]
    in_place: bool,
    #[command(flatten)]
    assets: inputs::Assets,
    /// Traces at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print one JSON object per trace
    #[arg(long)]
    json: bool,
}

/// Drops the frames of traces (`reel trace compact`), after a replay unless told otherwise.
pub fn compact(arguments: &Compact) -> anyhow::Result<ExitStatus> {
    repack(&arguments.common, "compact", |trace, to| {
        reel_replay::compact(trace, to, !arguments.unverified)
    })
}

/// Renders the frames of lean traces again (`reel trace expand`).
pub fn expand(arguments: &Expand) -> anyhow::Result<ExitStatus> {
    repack(&arguments.common, "expand", reel_replay::expand)
}

/// A trace that was written again.
struct Repacked {
    from: PathBuf,
    to: PathBuf,
    bytes: [u64; 2],
    /// Bytes before and after, by what they are.
    content: BTreeMap<String, [u64; 2]>,
}

fn repack(
    arguments: &Common,
    name: &'static str,
    write: impl Fn(&Trace, &Path) -> Result<TraceSummary, RepackError> + Sync,
) -> anyhow::Result<ExitStatus> {
    let files = inputs::trace_files();
    let paths = inputs::traces(&files, &arguments.paths)?;
    let assets = arguments.assets.open()?;
    let targets = targets(&paths, arguments.out.as_deref())?;
    if let Some(out) = &arguments.out {
        fs::create_dir_all(out)
            .with_context(|| format!("cannot make the folder {}", out.display()))?;
    }
    let bar = progress::bar(paths.len(), name);
    let one = |(from, to): (&PathBuf, &PathBuf)| -> anyhow::Result<Repacked> {
        let mut shares: BTreeMap<String, [u64; 2]> = BTreeMap::new();
        let mut take = |which: usize, path: &Path| -> anyhow::Result<()> {
            for (what, bytes) in content(&files, path)? {
                shares.entry(what).or_default()[which] += bytes;
            }
            Ok(())
        };
        take(0, from)?;
        let trace = files.read(from)?.with_meshes(&assets);
        let summary =
            write(&trace, to).with_context(|| format!("{} is left as it is", from.display()))?;
        take(1, to)?;
        bar.inc(1);
        Ok(Repacked {
            from: from.clone(),
            to: to.clone(),
            bytes: [trace.bytes, summary.bytes],
            content: shares,
        })
    };
    let pool = inputs::pool(arguments.jobs)?;
    let results: Vec<_> = pool.install(|| {
        paths
            .par_iter()
            .zip(&targets)
            .with_max_len(1)
            .map(one)
            .collect()
    });
    bar.finish_and_clear();
    let mut done = Vec::new();
    for result in results {
        match result {
            Ok(repacked) => done.push(repacked),
            Err(error) => eprintln!("reel: {error:#}"),
        }
    }
    if arguments.json {
        for Repacked {
            from,
            to,
            bytes: [before, after],
            content,
        } in &done
        {
            println!(
                "{}",
                json!({ "trace": from, "out": to, "bytes_before": before, "bytes_after": after, "content": content })
            );
        }
    } else {
        print(&done, paths.len());
    }
    Ok(if done.len() == paths.len() {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}

fn targets(paths: &[PathBuf], out: Option<&Path>) -> anyhow::Result<Vec<PathBuf>> {
    let Some(out) = out else {
        return Ok(paths.to_vec());
    };
    let mut taken: BTreeMap<PathBuf, &PathBuf> = BTreeMap::new();
    let mut targets = Vec::new();
    for path in paths {
        let target = out.join(format!("{}.mcap", reel_trace::trace_stem(path)));
        if let Some(other) = taken.insert(target.clone(), path) {
            bail!(
                "{} and {} would both become {}; give them one folder each",
                other.display(),
                path.display(),
                target.display()
            );
        }
        targets.push(target);
    }
    Ok(targets)
}

fn print(done: &[Repacked], asked: usize) {
    let count = done.len().max(1) as u64;
    let mean = |which: usize| {
        done.iter()
            .map(|repacked| repacked.bytes[which])
            .sum::<u64>()
            / count
    };
    println!(
        "{} of {asked} traces: {} bytes each became {}",
        done.len(),
        mean(0),
        mean(1)
    );
    let mut sums: BTreeMap<&str, [u64; 2]> = BTreeMap::new();
    for (what, bytes) in done.iter().flat_map(|repacked| &repacked.content) {
        let sum = sums.entry(what).or_default();
        (sum[0], sum[1]) = (sum[0] + bytes[0], sum[1] + bytes[1]);
    }
    let mut sums: Vec<_> = sums.into_iter().collect();
    sums.sort_by_key(|(_, bytes)| std::cmp::Reverse(bytes[0].max(bytes[1])));
    println!("  bytes each, before compression of chunks      before      after");
    for (what, [before, after]) in sums {
        println!("  {what:42} {:9} {:10}", before / count, after / count);
    }
}
