//! `reel trace copy`: files to buckets, and back.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicU64, AtomicUsize, Ordering},
    },
};

use anyhow::{Context, bail};
use rayon::prelude::*;
use reel_tables::buckets::UploadOutcome;
use reel_trace::{TraceFiles, is_remote};
use serde_json::json;

use crate::{ExitStatus, inputs, progress};

/// Copy files to a bucket of an S3-compatible store, or back: traces with what lies beside them.
/// Files that exist with the same size and are not older are skipped, so an interrupted copy
/// resumes. Large files go in parts; requests that fail are retried.
///
/// Every command that reads traces takes names in buckets, too: `reel replay s3://lab/traces`,
/// `reel ingest s3://lab/traces --store s3://lab/store`. What the store needs to know comes
/// from the environment: AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION,
/// AWS_ENDPOINT_URL, AWS_ALLOW_HTTP. Files are cached in REEL_BUCKET_CACHE (default
/// ~/.cache/reel-buckets) by digest, up to REEL_BUCKET_CACHE_GIB (default 10), and
/// revalidated when they are read again.
///
/// Examples:
///   reel trace copy traces-out s3://lab/traces
///   reel trace copy s3://lab/traces/FDP_home_0001--oracle--0.mcap .
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Files and folders to copy, folders with everything below them
    #[arg(required = true, value_name = "FROM")]
    from: Vec<PathBuf>,
    /// The folder to copy into, s3://bucket/folder or one of this machine
    #[arg(value_name = "TO")]
    to: PathBuf,
    /// Files at a time
    #[arg(long, value_name = "N", default_value_t = 8)]
    jobs: usize,
    /// Print counts, bytes and failures as one JSON object
    #[arg(long)]
    json: bool,
}

/// Copies files to or from a bucket and reports how many were sent or failed.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let outward = is_remote(&arguments.to);
    let buckets = Arc::new(inputs::buckets());
    let trace_files = TraceFiles::with_remote(buckets.clone());
    let files = files(&trace_files, &arguments.from)?;
    if let Some((file, _)) = files.iter().find(|(file, _)| is_remote(file) == outward) {
        let sides = if outward {
            "both are in buckets: the store's own tools copy within it"
        } else {
            "both are on this machine: cp does that"
        };
        bail!("{sides}: {} to {}", file.display(), arguments.to.display());
    }
    let bar = progress::bar(files.len(), "copy");
    let (copied, bytes) = (AtomicUsize::new(0), AtomicU64::new(0));
    let copy = |(from, name): &(PathBuf, String)| -> anyhow::Result<()> {
        let sent = if outward {
            let to = format!(
                "{}/{name}",
                arguments.to.to_string_lossy().trim_end_matches('/')
            );
            buckets.upload(from, &to)?
        } else {
            bring(&trace_files, from, &arguments.to.join(name))?
        };
        if let UploadOutcome::Sent { bytes: size } = sent {
            copied.fetch_add(1, Ordering::Relaxed);
            bytes.fetch_add(size, Ordering::Relaxed);
        }
        bar.inc(1);
        Ok(())
    };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(arguments.jobs.max(1))
        .build()?;
    let failed: Vec<String> = pool.install(|| {
        files
            .par_iter()
            .with_max_len(1)
            .filter_map(|file| copy(file).err().map(|error| format!("{error:#}")))
            .collect()
    });
    bar.finish_and_clear();
    failed.iter().for_each(|reason| eprintln!("reel: {reason}"));
    let (copied, bytes) = (copied.into_inner(), bytes.into_inner());
    let same = files.len() - copied - failed.len();
    if arguments.json {
        println!(
            "{}",
            json!({ "copied": copied, "bytes": bytes, "same": same, "failed": failed })
        );
    } else {
        let missing = if failed.is_empty() {
            String::new()
        } else {
            format!(", {} failed", failed.len())
        };
        println!(
            "{copied} copied ({:.1} MB), {same} there already{missing}; in {}",
            bytes as f64 / 1e6,
            arguments.to.display()
        );
    }
    Ok(if failed.is_empty() {
        ExitStatus::Success
    } else {
        ExitStatus::Partial
    })
}

/// Every file with its name below the folder it was found in.
fn files(trace_files: &TraceFiles, from: &[PathBuf]) -> anyhow::Result<Vec<(PathBuf, String)>> {
    let mut files = Vec::new();
    for path in from {
        let mut below = Vec::new();
        if is_remote(path) {
            below = trace_files
                .list_remote(path)
                .with_context(|| format!("cannot list {}", path.display()))?;
        } else if path.is_dir() {
            inputs::collect(path, &|_| true, &mut below)
                .with_context(|| format!("cannot list {}", path.display()))?;
        } else if path.exists() {
            below.push(path.clone());
        }
        if below.is_empty() {
            bail!("no such file or folder: {}", path.display());
        }
        for file in below {
            let name = match file.strip_prefix(path) {
                Ok(name) if !name.as_os_str().is_empty() => name.to_path_buf(),
                _ => PathBuf::from(
                    file.file_name()
                        .with_context(|| format!("it has no name: {}", file.display()))?,
                ),
            };
            let name = name
                .to_str()
                .with_context(|| format!("its name is no UTF-8: {}", file.display()))?
                .to_owned();
            files.push((file, name));
        }
    }
    files.sort();
    files.dedup();
    Ok(files)
}

/// Brings a file of a bucket into its place at once.
fn bring(files: &TraceFiles, from: &Path, to: &Path) -> anyhow::Result<UploadOutcome> {
    let here = files.local_copy(from)?;
    let bytes = fs::metadata(&here)
        .with_context(|| format!("cannot read {}", here.display()))?
        .len();
    let failed = || format!("cannot write {}", to.display());
    if to.exists() && fs::read(to).with_context(failed)? == fs::read(&here)? {
        return Ok(UploadOutcome::Same);
    }
    let folder = to.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(folder).with_context(failed)?;
    let part = to.with_added_extension("part");
    fs::write(&part, fs::read(&here)?)
        .and_then(|()| fs::rename(&part, to))
        .with_context(failed)?;
    Ok(UploadOutcome::Sent { bytes })
}
