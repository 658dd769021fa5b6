//! `reel replay`: re-executes traces and compares everything.

use reel_replay::{
    FileVerdict, ReplayReport, Verdict, replay_outcomes_all, verify_all, verify_all_from_snapshots,
};
use reel_world::Assets;
use std::{collections::BTreeMap, path::PathBuf};

use crate::{
    ExitStatus,
    cluster_arguments::ClusterArguments,
    commands::{dev::gate, explain},
    inputs, progress,
};

/// Execute traces again from their inputs and compare every digest, image, text, reward and metric.
/// On a difference it names the call, the physics step, the body and the field, with both values.
///
/// Examples:
///   reel replay traces-out
///   reel replay traces-out/FDP_home_0001--oracle--0.mcap --json
///   reel replay trace.mcap --explain --images-out why     # every difference, in ULPs, images and texts
///   reel replay trace.mcap --explain --against old/reel # both builds' states at the first differing physics step
///   reel replay traces-out --store store                # the verdicts go to its table `verdicts`
///   reel replay traces-out --restored 5                 # also from snapshots after 5 calls of each episode
///   reel replay traces/golden/v1 --outcomes
///   reel replay traces-out --assets meshes              # recorded with these meshes
///   reel replay s3://lab/traces --cluster 10.0.0.1:50050 # by many machines (`reel cluster`)
///
/// Exit code 0: all identical; 1: something differs, a trace was refused, or cannot be
/// executed again (robots, imports).
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Trace files, or folders of them, also s3://bucket/folder
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    #[command(flatten)]
    assets: inputs::Assets,
    #[command(flatten)]
    in_cluster: ClusterArguments,
    /// Traces at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print everything that differs at the first differing call: bodies and fields with their
    /// distance in ULPs, the first differing physics step, images, texts
    #[arg(long, conflicts_with = "restored")]
    explain: bool,
    /// With --explain: another build of reel, whose motion states at the first differing physics
    /// step are compared too
    #[arg(long, value_name = "BIN", requires = "explain")]
    against: Option<PathBuf>,
    /// With --explain: folder for images of differing frames (recorded, replayed, difference)
    #[arg(
        long = "images-out",
        alias = "pictures",
        value_name = "DIR",
        requires = "explain"
    )]
    frames: Option<PathBuf>,
    /// Print the motion states after a physics step of a call, both from 0, e.g. 3:120
    /// or start:499, as JSON
    #[arg(long, value_name = "CALL:STEP", conflicts_with_all = ["explain", "restored"])]
    state_at: Option<String>,
    /// Also restore each episode from snapshots after this many of its calls, chosen by its digest,
    /// and compare the rest
    #[arg(long, value_name = "N")]
    restored: Option<usize>,
    /// Execute traces that are not exact to their end, those of other simulator versions too, and
    /// list the outcomes that change
    #[arg(long, conflicts_with_all = ["explain", "restored"])]
    outcomes: bool,
    /// Keep the verdicts in the tables of this store, where pages, SQL and exports find them
    #[cfg(feature = "analytics")]
    #[arg(long, value_name = "DIR", conflicts_with_all = ["explain", "state_at", "outcomes", "restored"])]
    store: Option<String>,
    /// Print one JSON object per trace
    #[arg(long)]
    json: bool,
}

/// Replays the given traces and reports the first difference of each.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let files = inputs::trace_files();
    let paths = inputs::traces(&files, &arguments.paths)?;
    let assets = arguments.assets.open()?;
    if let Some(place) = &arguments.state_at {
        return explain::print_state(&files, &paths, &assets, place);
    }
    if arguments.explain {
        let other = arguments.against.as_deref().map(|build| explain::Build {
            path: build,
            assets: arguments.assets.path(),
        });
        return explain::run(
            &files,
            &paths,
            &assets,
            other.as_ref(),
            arguments.frames.as_deref(),
            arguments.json,
        );
    }
    if arguments.in_cluster.is_set() && arguments.assets.path().is_some() {
        eprintln!(
            "reel: the meshes are those of the executors (`reel cluster executor --assets`), not those named here"
        );
    }
    #[cfg(feature = "analytics")]
    let store = arguments
        .store
        .as_deref()
        .map(|store| inputs::store(store, None))
        .transpose()?;
    let bar = progress::bar(paths.len(), "replay");
    let workers = inputs::workers(arguments.jobs);
    if arguments.outcomes {
        let judgements = match arguments
            .in_cluster
            .map_traces("outcomes", &(), &paths, |more| bar.inc(more))?
        {
            // with the traces called as here
            Some(judged) => paths
                .iter()
                .zip(judged)
                .map(|(path, one)| ReplayReport {
                    trace: path.clone(),
                    ..one
                })
                .collect(),
            None => replay_outcomes_all(&files, &paths, &assets, workers, |_, _| bar.inc(1)),
        };
        bar.finish_and_clear();
        return tell_outcomes(&judgements, arguments.json);
    }
    let judged =
        match arguments
            .in_cluster
            .map_traces("replay", &arguments.restored, &paths, |more| bar.inc(more))?
        {
            Some(judged) => judged,
            None => verify(&files, &paths, &assets, workers, arguments.restored, || {
                bar.inc(1)
            }),
        };
    bar.finish_and_clear();
    let verdicts: Vec<Verdict> = judged.iter().map(|one| one.verdict.clone()).collect();
    let mut totals = [0u64; 3];
    for (path, verdict) in paths.iter().zip(&verdicts) {
        if arguments.json {
            let mut line = serde_json::to_value(verdict)?;
            line["trace"] = path.display().to_string().into();
            println!("{line}");
        } else if let Verdict::Exact {
            calls,
            physics_steps,
            images,
        } = verdict
        {
            totals[0] += u64::from(*calls);
            totals[1] += physics_steps;
            totals[2] += u64::from(*images);
            if paths.len() == 1 {
                println!("{}: {verdict}", path.display());
            }
        } else {
            println!("{}: {verdict}", path.display());
        }
    }
    let exact = verdicts.iter().filter(|verdict| verdict.is_exact()).count();
    if !arguments.json && paths.len() > 1 {
        let [calls, physics_steps, images] = totals;
        println!(
            "{exact} of {} traces replay exactly: {calls} calls, {physics_steps} physics steps, {images} images",
            paths.len()
        );
        if let Some(count) = arguments.restored {
            println!(
                "  each also restored from snapshots after {count} of its calls (all calls, where it has fewer)"
            );
        }
        for (kind, count) in kinds(&verdicts) {
            println!("  {kind}: {count}");
        }
    }
    // Last, so that a store that fails takes nobody's results away.
    #[cfg(feature = "analytics")]
    if let Some(store) = &store {
        crate::commands::store::keep_verdicts(store, &judged)?;
    }
    Ok(if exact == paths.len() {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}

fn verify(
    files: &reel_trace::TraceFiles,
    paths: &[PathBuf],
    assets: &dyn Assets,
    workers: usize,
    restored: Option<usize>,
    done: impl Fn() + Sync,
) -> Vec<FileVerdict> {
    match restored {
        None => verify_all(files, paths, assets, workers, |_, _| done()),
        Some(count) => {
            verify_all_from_snapshots(files, paths, assets, workers, count, |_, _| done())
        }
    }
}

/// What executors do for this command.
#[cfg(feature = "cluster")]
pub fn works(
    files: &reel_trace::TraceFiles,
    assets: &std::sync::Arc<Option<reel_tasks::assets::AssetFolder>>,
) -> [reel_cluster::TraceJob; 2] {
    use crate::cluster_arguments::work;

    let (of_replay, of_outcomes) = (assets.clone(), assets.clone());
    let (replay_files, outcome_files) = (files.clone(), files.clone());
    [
        work("replay", move |traces, restored| {
            Ok(verify(
                &replay_files,
                traces,
                &*of_replay,
                1,
                restored,
                || (),
            ))
        }),
        work("outcomes", move |traces, ()| {
            Ok(replay_outcomes_all(
                &outcome_files,
                traces,
                &*of_outcomes,
                1,
                |_, _| (),
            ))
        }),
    ]
}

/// Verdicts with what changed beside them.
fn tell_outcomes(judgements: &[ReplayReport], json: bool) -> anyhow::Result<ExitStatus> {
    for judgement in judgements {
        let ReplayReport {
            trace,
            verdict,
            outcomes,
        } = judgement;
        if json {
            println!("{}", serde_json::to_string(judgement)?);
            continue;
        }
        println!("{}: {verdict}", trace.display());
        let Some(changes) = outcomes.as_ref().filter(|_| !verdict.is_exact()) else {
            continue;
        };
        println!("  executed to the end: {changes}");
        for changed in &changes.outcomes {
            let (recorded, replayed) = (
                gate::outcome_line(&changed.recorded),
                gate::outcome_line(&changed.replayed),
            );
            println!(
                "  call {} {}\n    recorded  {recorded}\n    replayed  {replayed}",
                changed.call, changed.call_text
            );
        }
    }
    Ok(
        if judgements
            .iter()
            .all(|judgement| judgement.verdict.is_exact())
        {
            ExitStatus::Success
        } else {
            ExitStatus::CheckFailed
        },
    )
}

fn kinds(verdicts: &[Verdict]) -> BTreeMap<&'static str, usize> {
    let mut kinds = BTreeMap::new();
    for verdict in verdicts {
        let kind = match verdict {
            Verdict::Exact { .. } => continue,
            Verdict::Diverged { .. } => "diverged",
            Verdict::OtherSimulator { .. } => "recorded by another simulator version",
            Verdict::NotReplayable { .. } => "not replayable",
            Verdict::Refused { .. } => "refused",
        };
        *kinds.entry(kind).or_default() += 1;
    }
    kinds
}
