//! `reel branch`: another future of a recorded episode, and whether a trace is one.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use reel_agents::{EpisodeReport, RecordTo};
use reel_counterfactual::branch::{Branch, Continuation, fork, parse_call, parse_calls};
use reel_replay::{BranchVerification, EndSummary, verify_branch};
use reel_trace::{Images, RecordOptions, Trace};
use reel_world::{Digest, ToolCall};
use serde_json::json;

use crate::{ExitStatus, commands::run::remove_abandoned, inputs};

/// Play another future of a recorded episode: its calls up to one, exactly as they were, then other
/// calls or a policy. The result is a trace like any other; its header names the parent, the call
/// and what was substituted.
///
/// Examples:
///   reel branch trace.mcap --at 6 --call '{"name": "pick", "arguments": {"marker_id": 2}}'
///   reel branch trace.mcap --at 6 --policy planner            # it watches calls 0 to 5, then takes over
///   reel branch trace.mcap --at 6 --calls calls.jsonl --then oracle
///   reel branch trace.mcap --at 6 --call '{"name": "walk_around"}' --then parent     # instead of call 6
///   reel branch trace.mcap --at 6 --call '{"name": "walk_around"}' --then parent:6   # before call 6
///   reel branch trace.mcap --at 6 --then parent:7                                    # without call 6
///   reel branch trace.mcap --check branch.mcap                # the same up to there, and exact?
///   reel diff trace.mcap branch.mcap
///
/// Without --policy and --then the branch ends after the calls. Exit code 1: the parent
/// does not replay up to there, or a checked trace is no branch of it or not exact.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The trace to branch from
    #[arg(value_name = "TRACE")]
    trace: PathBuf,
    /// Call (from 0) before which it branches: this many calls are kept. The number of all calls
    /// continues an episode that was aborted
    #[arg(long, value_name = "K", required_unless_present = "check")]
    at: Option<usize>,
    /// A call to make there, as JSON: {"name": .., "arguments": {..}}; several in their order
    #[arg(long, value_name = "JSON")]
    call: Vec<String>,
    /// File of calls to make there, one JSON a line
    #[arg(long, value_name = "FILE", conflicts_with = "call")]
    calls: Option<PathBuf>,
    /// A built-in policy to take over there (see `reel run --help`)
    #[arg(long, value_name = "NAME", conflicts_with_all = ["call", "calls", "then"])]
    policy: Option<String>,
    /// What comes after the calls: a built-in policy, parent (the parent's calls after those that
    /// were replaced), or parent:J (the parent's calls from J on)
    #[arg(long, value_name = "WHO")]
    then: Option<String>,
    /// Seed of the policy; without it that of the episode
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// The trace to write; without it TRACE--at-K--<digest>.mcap in this folder
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Whether the branch holds images, full or none; without it as the parent does
    #[arg(long, value_name = "WHICH")]
    images: Option<String>,
    /// Check that this trace is a branch of TRACE: what they have in common is the same,
    /// and it replays exactly
    #[arg(long, value_name = "BRANCH", conflicts_with_all = ["at", "call", "calls", "policy", "then", "seed", "out", "images"])]
    check: Vec<PathBuf>,
    #[command(flatten)]
    assets: inputs::Assets,
    #[command(flatten)]
    cache: inputs::Cache,
    /// Print one JSON object per branch
    #[arg(long)]
    json: bool,
}

/// Plays a branch of a trace, or checks that traces are branches of it.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let parent = arguments
        .assets
        .read(&inputs::trace_files(), &arguments.trace)?;
    let Some(at) = arguments.at else {
        return check(&parent, arguments);
    };
    let branch = what(arguments, &parent, at)?;
    let images = match arguments.images.as_deref() {
        None if parent.image_count() > 0 => Images::Full,
        None | Some("none") => Images::None,
        Some("full") => Images::Full,
        Some(other) => bail!("--images is full or none, not '{other}'"),
    };
    let path = arguments
        .out
        .clone()
        .unwrap_or_else(|| default_path(&arguments.trace, &parent, &branch, at));
    if same_file(&path, &arguments.trace) {
        bail!(
            "{} is the parent; give the branch another name",
            path.display()
        );
    }
    let made = fork(&parent, at, arguments.cache.open().as_ref()).and_then(|fork| {
        remove_abandoned(&path.with_added_extension("part"));
        branch.play(
            &fork,
            Some(&RecordTo {
                path: path.clone(),
                options: RecordOptions::from(images),
            }),
        )
    });
    let report = match made {
        Err(error) if error.is_divergence() => {
            eprintln!("reel: {error}");
            return Ok(ExitStatus::CheckFailed);
        }
        made => made?,
    };
    let made = Trace::read(&path)?;
    if arguments.json {
        println!("{}", in_json(&report, &made, &parent, at));
    } else {
        print(&branch, &made, &parent, at);
    }
    Ok(ExitStatus::Success)
}

/// What the arguments ask to substitute.
fn what(arguments: &Arguments, parent: &Trace, at: usize) -> anyhow::Result<Branch> {
    let calls: Vec<ToolCall> = match &arguments.calls {
        Some(path) => {
            let text = fs::read_to_string(path)
                .with_context(|| format!("cannot read {}", path.display()))?;
            parse_calls(&text)
                .with_context(|| format!("cannot read calls from {}", path.display()))?
        }
        None => arguments
            .call
            .iter()
            .map(|text| parse_call(text))
            .collect::<Result<_, _>>()
            .context("--call")?,
    };
    let policy = |name: &String| Continuation::Policy {
        name: name.clone(),
        seed: arguments.seed.unwrap_or(parent.header.seed),
    };
    let then = match (&arguments.policy, &arguments.then) {
        (Some(name), _) => policy(name),
        (None, None) if calls.is_empty() => {
            bail!("name what follows at call {at}: --call, --calls, --policy or --then")
        }
        (None, None) => Continuation::Stop,
        (None, Some(who)) => match who.split_once(':') {
            None if who == "parent" && at + calls.len() > parent.steps.len() => {
                Continuation::Parent(parent.steps.len())
            }
            None if who == "parent" => Continuation::Parent(at + calls.len()),
            Some(("parent", from)) => Continuation::Parent(
                from.parse()
                    .with_context(|| format!("--then parent:{from}: no call"))?,
            ),
            _ => policy(who),
        },
    };
    Ok(Branch {
        calls,
        continuation: then,
    })
}

fn default_path(trace: &Path, parent: &Trace, branch: &Branch, at: usize) -> PathBuf {
    let stem = reel_trace::trace_stem(trace);
    let digest = Digest::of_json(&branch.info(parent)).to_string();
    PathBuf::from(format!("{stem}--at-{at}--{}.mcap", &digest[..8]))
}

fn same_file(a: &Path, b: &Path) -> bool {
    match (a.canonicalize(), b.canonicalize()) {
        (Ok(a), Ok(b)) => a == b,
        _ => false,
    }
}

fn in_json(report: &EpisodeReport, made: &Trace, parent: &Trace, at: usize) -> serde_json::Value {
    json!({
        "trace": report.trace, "episode_id": report.episode_id, "parent": made.header.parent, "parent_episode": parent.header.episode_id,
        "substituted": made.header.policy.parameters, "taken_over": at, "length": report.length, "success": report.success,
        "completion": report.completion, "total_reward": report.total_reward, "end_reason": report.end_reason,
        "bytes": report.bytes, "unreachable": report.unreachable,
    })
}

fn print(branch: &Branch, made: &Trace, parent: &Trace, at: usize) {
    println!("{} at call {at}", parent.path.display());
    for step in made.steps.iter().skip(at).take(branch.calls.len()) {
        let told = step.outcome.text.lines().next().unwrap_or_default();
        let told = step
            .outcome
            .error
            .map_or_else(|| told.to_owned(), |code| format!("{code}: {told}"));
        println!("  {:>3}  {}   {told}", step.step, step.input.call);
    }
    let so_far = (at + branch.calls.len()).min(made.steps.len());
    match (&branch.continuation, made.steps.len() - so_far) {
        (Continuation::Stop, _) => {}
        (Continuation::Parent(from), more) => {
            println!("  then {more} calls of the parent, from its call {from} on")
        }
        (Continuation::Policy { name, seed }, more) => {
            println!("  then {more} calls of {name}, seed {seed}")
        }
    }
    for (name, trace) in [("parent", parent), ("branch", made)] {
        match &trace.end {
            Some(end) => println!("{name}: {}", EndSummary::of(end, &trace.task)),
            None => println!("{name}: broken off after {} calls", trace.steps.len()),
        }
    }
    println!("trace: {}", made.path.display());
}

fn check(parent: &Trace, arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let mut all_hold = true;
    for path in &arguments.check {
        let branch = arguments.assets.read(&inputs::trace_files(), path)?;
        let descent = verify_branch(&branch, parent);
        all_hold &= descent.holds();
        if arguments.json {
            let mut line = serde_json::to_value(&descent)?;
            line["trace"] = json!(path);
            line["holds"] = json!(descent.holds());
            println!("{line}");
        } else {
            println!("{}: {}", path.display(), told(&descent, &branch));
        }
    }
    Ok(if all_hold {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}

fn told(descent: &BranchVerification, branch: &Trace) -> String {
    let call = branch
        .header
        .parent
        .as_ref()
        .map_or(0, |parent| parent.call);
    let prefix = match (&descent.unrelated, &descent.prefix) {
        (Some(reason), _) => format!("NO BRANCH of it: {reason}"),
        (None, Some(difference)) => format!("NOT THE SAME as its parent (recorded) {difference}"),
        (None, None) => format!("branches at call {call}, the same before"),
    };
    format!("{prefix}; {}", descent.verdict)
}
