//! `reel export inspect`: traces as logs of Inspect.

use std::{collections::BTreeMap, fs, path::PathBuf, time::SystemTime};

use anyhow::Context;
use chrono::{DateTime, Utc};
use reel_import::{atif::LOST, inspect::LogWriter};
use serde_json::json;

use super::readable::{Traces, tell_lost};
use crate::ExitStatus;

/// Traces as logs of Inspect (.eval), which its viewer and Inspect Scout open: one log for each policy, one
/// sample for each episode, the second episode of a task as its second epoch.
///
/// A sample has the conversation with its images, `success`, `completion` and `total_reward` as scores, and what the
/// goal changes as target. `metadata.reel` of samples and messages has what the format has no field for. What
/// `reel import inspect` cannot give back is printed.
///
/// Example:
///   reel export inspect traces --out logs && inspect view --log-dir logs
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Traces, or folders of them
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Folder for the logs; made if it is not there
    #[arg(long, value_name = "DIR", default_value = "logs")]
    out: PathBuf,
    /// Print one JSON object per log, and one of what is lost
    #[arg(long)]
    json: bool,
}

/// A log that is being written beside the place where it will lie.
struct Log {
    writer: LogWriter,
    unfinished: PathBuf,
    path: PathBuf,
    samples: usize,
    /// When the newest of its traces was written.
    newest: SystemTime,
}

/// Writes a log for each policy.
pub fn execute(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let mut traces = Traces::find(&arguments.paths)?;
    let out = &arguments.out;
    fs::create_dir_all(out).with_context(|| format!("cannot make the folder {}", out.display()))?;
    let mut logs: BTreeMap<String, Log> = BTreeMap::new();
    traces.each(|path, trace, _| {
        let policy = &trace.header.policy.name;
        if !logs.contains_key(policy) {
            let log = begin(out, policy, &logs)?;
            logs.insert(policy.clone(), log);
        }
        let log = logs.get_mut(policy).expect("it was just begun");
        let written = log.writer.add(&trace);
        written.with_context(|| format!("cannot write {}", log.unfinished.display()))?;
        log.samples += 1;
        let modified = fs::metadata(path).and_then(|facts| facts.modified());
        log.newest = log.newest.max(modified.unwrap_or(SystemTime::UNIX_EPOCH));
        Ok(())
    })?;
    for (policy, log) in logs {
        let created = DateTime::<Utc>::from(log.newest).to_rfc3339();
        let placed = log.writer.finish(&created);
        let placed = placed.and_then(|()| fs::rename(&log.unfinished, &log.path));
        placed.with_context(|| format!("cannot write {}", log.path.display()))?;
        if arguments.json {
            let told = json!({"log": log.path, "policy": policy, "samples": log.samples});
            println!("{told}");
        } else {
            println!("{}: {} samples", log.path.display(), log.samples);
        }
    }
    tell_lost("inspect", LOST, arguments.json);
    Ok(traces.status())
}

/// A log with the name of a policy, as far as a file can have it, and a number where two are alike.
fn begin(out: &std::path::Path, policy: &str, logs: &BTreeMap<String, Log>) -> anyhow::Result<Log> {
    let letter = |c: char| {
        if c.is_ascii_alphanumeric() || "-_.".contains(c) {
            c
        } else {
            '_'
        }
    };
    let stem: String = policy.chars().map(letter).take(100).collect();
    let path = (1..)
        .map(|number| match number {
            1 => out.join(format!("{stem}.eval")),
            _ => out.join(format!("{stem}-{number}.eval")),
        })
        .find(|path| logs.values().all(|log| log.path != *path))
        .expect("there are more numbers than logs");
    let unfinished = path.with_extension("eval.part");
    let writer = LogWriter::create(&unfinished, policy)
        .with_context(|| format!("cannot write {}", unfinished.display()))?;
    Ok(Log {
        writer,
        unfinished,
        path,
        samples: 0,
        newest: SystemTime::UNIX_EPOCH,
    })
}
