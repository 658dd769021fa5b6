//! `reel trace logprobs`: what other policies give the tokens of recorded episodes.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use reel_trace::{ScoredTokens, Trace};

use crate::{ExitStatus, inputs};

/// Log-probabilities of the tokens that a model wrote: list those that traces hold, and add those
/// of another checkpoint for the same tokens. They are in channel /logprobs, outside of every
/// digest, so a trace keeps its identity; ingest it again afterwards.
///
/// A line of JSON for each decision and policy: {"episode_id", "step", "policy", "tokens",
/// "logprobs"}; policy `old` sampled the tokens.
///
/// Examples:
///   reel trace logprobs list traces > tokens.jsonl      # to be scored with another checkpoint
///   reel trace logprobs add traces --from scored.jsonl
///   reel trace logprobs add traces --from other-traces --policy new   # the same tasks and seeds, the same tokens
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Print what traces hold, a line of JSON for each decision and policy
    List {
        /// Traces or folders of them
        #[arg(required = true, value_name = "TRACE")]
        traces: Vec<PathBuf>,
    },
    /// Add another policy's log-probabilities to traces, in place
    Add {
        /// Traces or folders of them
        #[arg(required = true, value_name = "TRACE")]
        traces: Vec<PathBuf>,
        /// Lines of JSON (.jsonl), or traces of the other policy: a file or a folder
        #[arg(long, value_name = "PATH")]
        from: PathBuf,
        /// The other policy's name, e.g. new or ref; with lines: only those of
        /// this policy are added
        #[arg(long, value_name = "NAME")]
        policy: Option<String>,
    },
}

/// Lists or adds log-probabilities.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match &arguments.command {
        Command::List { traces } => list(traces),
        Command::Add {
            traces,
            from,
            policy,
        } => add(traces, from, policy.as_deref()),
    }
}

fn list(paths: &[PathBuf]) -> anyhow::Result<ExitStatus> {
    let mut any = false;
    let files = inputs::trace_files();
    for path in inputs::traces(&files, paths)? {
        for line in files.read(&path)?.scored_tokens() {
            println!("{}", serde_json::to_string(&line)?);
            any = true;
        }
    }
    if !any {
        eprintln!(
            "reel: no trace there holds log-probabilities; `reel bench --logprobs` records them"
        );
    }
    Ok(if any {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}

fn add(paths: &[PathBuf], from: &Path, policy: Option<&str>) -> anyhow::Result<ExitStatus> {
    let mut traces = Vec::new();
    let files = inputs::trace_files();
    for path in inputs::traces(&files, paths)? {
        traces.push(files.read(&path)?);
    }
    let is_lines = from
        .extension()
        .is_some_and(|extension| extension == "jsonl" || extension == "json");
    let scored = if is_lines {
        lines(from, policy)?
    } else {
        of_traces(&traces, from, policy)?
    };
    let mut by_episode: BTreeMap<String, Vec<ScoredTokens>> = BTreeMap::new();
    for line in scored {
        by_episode
            .entry(line.episode_id.clone())
            .or_default()
            .push(line);
    }
    // all of it, or nothing: no file is written before everything fits
    let (mut changed, mut decisions) = (Vec::new(), 0);
    for mut trace in traces {
        let Some(lines) = by_episode.remove(&trace.header.episode_id) else {
            continue;
        };
        lines.iter().try_for_each(|line| trace.add_scored(line))?;
        decisions += lines.len();
        changed.push(trace);
    }
    for episode in by_episode.keys() {
        eprintln!(
            "reel: no trace given is of episode {episode}; its log-probabilities are left out"
        );
    }
    if changed.is_empty() {
        bail!(
            "{} holds no log-probabilities of these traces; `reel trace logprobs list` shows their episodes",
            from.display()
        );
    }
    for trace in &changed {
        trace.save()?;
    }
    println!(
        "log-probabilities of {decisions} decisions added to {} traces; ingest them again",
        changed.len()
    );
    Ok(if by_episode.is_empty() {
        ExitStatus::Success
    } else {
        ExitStatus::Partial
    })
}

fn lines(from: &Path, policy: Option<&str>) -> anyhow::Result<Vec<ScoredTokens>> {
    let text =
        fs::read_to_string(from).with_context(|| format!("cannot read {}", from.display()))?;
    let mut lines = ScoredTokens::read_lines(&text, from)?;
    match policy {
        Some(policy) => lines.retain(|line| line.policy == policy),
        // what `reel trace logprobs list` wrote of the policy that sampled is in the traces already
        None => lines.retain(|line| line.policy != reel_world::OLD_POLICY),
    }
    Ok(lines)
}

/// Which episodes of two policies belong together.
fn pair(trace: &Trace) -> (reel_world::Digest, u64, Option<u32>) {
    (
        trace.header.task_digest,
        trace.header.seed,
        trace.header.rollout_index,
    )
}

/// What the policy of other traces gave its tokens, as lines about these traces.
fn of_traces(
    traces: &[Trace],
    from: &Path,
    policy: Option<&str>,
) -> anyhow::Result<Vec<ScoredTokens>> {
    let policy = policy
        .context("--policy is missing: the name of the policy of the other traces, e.g. new")?;
    let mut others: BTreeMap<_, Trace> = BTreeMap::new();
    let files = inputs::trace_files();
    for path in inputs::traces(&files, &[from.to_owned()])? {
        let trace = files.read(&path)?;
        if let Some(twice) = others.insert(pair(&trace), trace) {
            bail!(
                "{} holds several episodes of task {} at seed {}; give a folder of one policy",
                from.display(),
                twice.header.task_id,
                twice.header.seed
            );
        }
    }
    let mut scored = Vec::new();
    for trace in traces {
        let Some(other) = others.get(&pair(trace)) else {
            continue;
        };
        let steps = |trace: &Trace| trace.logprobs().map(|(step, _)| step).collect::<Vec<_>>();
        if steps(trace) != steps(other) {
            bail!(
                "{} and {} have log-probabilities of other decisions ({} and {}): their tokens are not the same",
                trace.path.display(),
                other.path.display(),
                steps(trace).len(),
                steps(other).len()
            );
        }
        scored.extend(other.sampled_as(&trace.header.episode_id, policy));
    }
    Ok(scored)
}
