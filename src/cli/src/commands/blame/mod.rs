//! `reel blame`: measures failed episodes; `evaluation` holds the result against injected faults.

mod evaluation;

use std::path::{Path, PathBuf};

use anyhow::Context;
use base64::{Engine as _, engine::general_purpose::STANDARD as BASE64};
use reel_counterfactual::blame::{
    Blame, BlameOptions, Cause, CompetentAgent, MeasuredTrace, blame_all,
};
#[cfg(feature = "analytics")]
use reel_tables::{BlameRow, Store};
use reel_trace::Trace;

use crate::{ExitStatus, cluster_arguments::ClusterArguments, inputs, progress};

/// The agents that episodes can be measured against.
#[derive(Clone, Copy, PartialEq, Eq, Debug, clap::ValueEnum)]
enum Competent {
    Planner,
    PlannerWords,
}

impl From<Competent> for CompetentAgent {
    fn from(agent: Competent) -> Self {
        match agent {
            Competent::Planner => Self::Planner,
            Competent::PlannerWords => Self::PlannerWords,
        }
    }
}

/// Measure why episodes failed. From every step of an episode reel computes how many decisions a
/// competent agent that knows what this agent knew still needs at worst: it looks before it picks,
/// asks where several things fit, and puts back wrong objects. A step that loses
/// decisions has a regret; the decisive step is the first loss that was never recovered. Then a
/// competent agent takes over at that step; a kept branch is verified by a replay.
///
/// Examples:
///   reel blame trace.mcap                        # the decisive step, why, and what would have been better
///   reel blame trace.mcap --steps                # what every step cost
///   reel blame traces-out --branches better      # of every failed one a branch that succeeds, replayed
///   reel blame traces-out --competent-agent planner-words   # measured against one with nothing but the words
///   reel blame traces-out --json | jq -r '.decisive.cause'
///   reel blame --store store && reel query --store store "SELECT cause, count(*) FROM blame GROUP BY cause"
///   reel blame faulty --labels                   # how often it is right, on what `reel agent faults run` wrote
///
/// Costs and regrets are in decisions; `knowing` is the cost if the meant receptacles are known, too.
/// Causes: perception (the wrong candidate, although its look tells it apart), communication (no
/// question although several candidates fit), memory (against what was known), primitive (a skill of
/// the robot failed), other.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Trace files, or folders of them
    #[arg(value_name = "PATH", required_unless_present_any = inputs::INSTEAD_OF_PATHS)]
    paths: Vec<PathBuf>,
    #[command(flatten)]
    assets: inputs::Assets,
    #[command(flatten)]
    in_cluster: ClusterArguments,
    /// Competent agent to measure against, a built-in policy. `planner` knows which receptacles the
    /// words may mean and the caption of the object; `planner-words` knows nothing but the words
    /// and may take for meant what they only fit
    #[arg(long, value_name = "POLICY", value_enum, default_value_t = Competent::Planner)]
    competent_agent: Competent,
    /// Print the cost of every step
    #[arg(long)]
    steps: bool,
    /// Keep the branch in which the alternative succeeds, and replay it
    #[arg(long, value_name = "DIR")]
    branches: Option<PathBuf>,
    /// Play no alternatives: measure from the records alone, some thousand episodes a second
    #[arg(long, conflicts_with = "branches")]
    no_alternatives: bool,
    /// Measure every failed episode of this store, and keep the results in its table `blame`; check
    /// the claims of its Histories, too (table `contradictions`)
    #[cfg(feature = "analytics")]
    #[arg(long, value_name = "STORE", conflicts_with_all = ["paths", "labels", "competent_agent"])]
    store: Option<String>,
    /// Compare with the labels of injected faults that lie beside the traces
    #[arg(long, conflicts_with = "json")]
    labels: bool,
    /// Traces at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print one JSON object per trace
    #[arg(long)]
    json: bool,
}

/// Measures failed episodes, then prints their decisive steps or stores them.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let files = arguments.assets.trace_files()?;
    #[cfg(feature = "analytics")]
    let mut store = arguments.store.as_ref().map(Store::open).transpose()?;
    #[cfg(feature = "analytics")]
    let paths = match &store {
        Some(store) => store
            .failed_traces()?
            .into_iter()
            .map(PathBuf::from)
            .collect(),
        None => inputs::traces(&files, &arguments.paths)?,
    };
    #[cfg(not(feature = "analytics"))]
    let paths = inputs::traces(&files, &arguments.paths)?;
    if let Some(folder) = &arguments.branches {
        std::fs::create_dir_all(folder)?;
    }
    let bar = progress::bar(paths.len(), "blame");
    let options = BlameOptions {
        competent_agent: arguments.competent_agent.into(),
        alternatives: !arguments.no_alternatives,
        branches: arguments.branches.clone(),
    };
    let measured =
        match arguments
            .in_cluster
            .map_traces("blame", &asked(&options), &paths, |more| bar.inc(more))?
        {
            Some(answers) => answers
                .into_iter()
                .zip(&paths)
                .map(|(answer, path)| received(answer, path, &options))
                .collect::<Result<_, _>>()?,
            None => blame_all(
                &files,
                &paths,
                inputs::workers(arguments.jobs),
                &options,
                || bar.inc(1),
            ),
        };
    bar.finish_and_clear();
    let mut unreadable = false;
    for (path, measured) in paths.iter().zip(&measured) {
        match measured {
            Err(reason) => {
                eprintln!("reel: {reason}");
                unreadable = true;
            }
            Ok(measured) if arguments.json => println!("{}", serde_json::to_string(measured)?),
            Ok(_) if arguments.labels => {}
            #[cfg(feature = "analytics")]
            Ok(_) if store.is_some() => {}
            Ok(measured) => print(measured, &files.read(path)?, arguments.steps),
        }
    }
    let measured: Vec<MeasuredTrace> = measured.into_iter().flatten().collect();
    #[cfg(feature = "analytics")]
    if let Some(store) = &mut store {
        store.replace_blame(&measured.iter().map(stored).collect::<Vec<_>>())?;
        reel_export::check_failed_histories(store)?;
        if !arguments.json {
            print_summary(&measured);
            let without_goal = store.count_failed_without_goal()?;
            if without_goal > 0 {
                println!(
                    "{without_goal} more failed as told; their tasks have no goal to measure against"
                );
            }
            println!("kept in table `blame` of {}", store.location());
        }
        return Ok(if unreadable {
            ExitStatus::Partial
        } else {
            ExitStatus::Success
        });
    }
    if arguments.labels && !arguments.json {
        evaluation::print(&files, &measured)?;
    } else if !arguments.json && measured.len() > 1 {
        print_summary(&measured);
    }
    Ok(if unreadable {
        ExitStatus::CheckFailed
    } else {
        ExitStatus::Success
    })
}

/// What an executor says of a trace: what was measured, and the branch that was to be kept.
#[derive(serde::Serialize, serde::Deserialize)]
struct ExecutorReply {
    measured: Result<MeasuredTrace, String>,
    /// The file of the branch, in base64.
    branch: Option<String>,
}

/// What an executor is asked: whether alternatives are played, and whether
/// their branches are wanted.
fn asked(options: &BlameOptions) -> (CompetentAgent, bool, bool) {
    (
        options.competent_agent,
        options.alternatives,
        options.branches.is_some(),
    )
}

/// What an executor said, with trace and branch where they are here.
fn received(
    answer: ExecutorReply,
    trace: &Path,
    options: &BlameOptions,
) -> anyhow::Result<Result<MeasuredTrace, String>> {
    let mut measured = match answer.measured {
        Ok(measured) => measured,
        Err(reason) => return Ok(Err(reason)),
    };
    measured.trace = trace.to_owned();
    let there = measured
        .alternative
        .as_mut()
        .and_then(|found| found.trace.as_mut());
    if let (Some(folder), Some(path), Some(bytes)) = (&options.branches, there, answer.branch) {
        *path = folder.join(
            path.file_name()
                .context("the branch of an executor has no name")?,
        );
        std::fs::write(&*path, BASE64.decode(bytes)?)
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(Ok(measured))
}

/// What executors do for this command.
#[cfg(feature = "cluster")]
pub fn work(files: reel_trace::TraceFiles) -> reel_cluster::TraceJob {
    crate::cluster_arguments::work(
        "blame",
        move |traces, (competent_agent, alternatives, branches): (CompetentAgent, bool, bool)| {
            let folder = branches
                .then(tempfile::tempdir)
                .transpose()
                .map_err(|error| error.to_string())?;
            let options = BlameOptions {
                competent_agent,
                alternatives,
                branches: folder.as_ref().map(|folder| folder.path().to_owned()),
            };
            let answered = |measured: Result<MeasuredTrace, String>| {
                let kept = measured
                    .as_ref()
                    .ok()
                    .and_then(|one| one.alternative.as_ref()?.trace.as_ref());
                let branch = kept
                    .map(std::fs::read)
                    .transpose()
                    .map_err(|error| error.to_string())?
                    .map(|bytes| BASE64.encode(bytes));
                Ok(ExecutorReply { measured, branch })
            };
            blame_all(&files, traces, 1, &options, || ())
                .into_iter()
                .map(answered)
                .collect()
        },
    )
}

/// Measures the failed episodes of a store from their records alone, and keeps that.
#[cfg(feature = "analytics")]
pub fn measure(location: &str) -> anyhow::Result<()> {
    let mut store = inputs::store(location, None)?;
    let paths: Vec<PathBuf> = store
        .failed_traces()?
        .into_iter()
        .map(PathBuf::from)
        .collect();
    let files = inputs::trace_files();
    let measured = blame_all(
        &files,
        &paths,
        inputs::workers(None),
        &BlameOptions::default(),
        || (),
    );
    let rows: Vec<BlameRow> = measured.iter().flatten().map(stored).collect();
    store.replace_blame(&rows)?;
    Ok(reel_export::check_failed_histories(&store)?)
}

/// Measures the failed episodes of a store, and says what came of it.
#[cfg(feature = "analytics")]
pub fn measure_and_print(store: &str, jobs: Option<usize>) -> anyhow::Result<()> {
    let (paths, assets, store, in_cluster) = (
        Vec::new(),
        inputs::Assets::default(),
        Some(store.to_owned()),
        ClusterArguments::default(),
    );
    let arguments = Arguments {
        paths,
        assets,
        in_cluster,
        store,
        jobs,
        steps: false,
        branches: None,
        competent_agent: Competent::Planner,
        no_alternatives: false,
        labels: false,
        json: false,
    };
    run(&arguments).map(drop)
}

fn print(measured: &MeasuredTrace, trace: &Trace, steps: bool) {
    let MeasuredTrace {
        blame,
        alternative,
        no_alternative,
        ..
    } = measured;
    let how = match blame.success {
        Some(true) => "succeeded",
        Some(false) => "failed",
        None if trace.end.is_some() && !trace.task.has_goal() => "not judged",
        None => "broken off",
    };
    let against = match measured.competent_agent {
        CompetentAgent::Planner => "",
        CompetentAgent::PlannerWords => " against planner-words",
    };
    let episode = format!(
        "{}: {how} after {} calls",
        measured.trace.display(),
        trace.steps.len()
    );
    if !trace.task.has_goal() {
        println!(
            "{episode}; its task has no goal to measure them against: `reel taxonomy --rules` classifies such failures"
        );
        return;
    }
    println!("{episode}, {} decisions lost{against}", blame.wasted_steps);
    if steps {
        print_steps(blame, trace);
    }
    let Some(decisive) = &blame.decisive else {
        return;
    };
    println!(
        "  decisive  call {}  {}   {}",
        decisive.step, decisive.call, decisive.outcome
    );
    println!("  why       {}", decisive.explanation);
    println!("  cause     {}", cause(decisive.cause));
    match (alternative, no_alternative) {
        (Some(found), _) => {
            let who = match found.policy.as_str() {
                agent if agent == measured.competent_agent.policy() => {
                    "a competent agent goes on and succeeds"
                }
                _ => "only the oracle, which knows the truth, goes on and succeeds",
            };
            println!(
                "  better    {}; {who} after {} calls",
                found.call, found.length
            );
            if let Some(path) = &found.trace {
                let verdict = if found.verified {
                    "replays exactly"
                } else {
                    "DOES NOT REPLAY EXACTLY"
                };
                println!("  branch    {}: {verdict}", path.display());
            }
        }
        (None, Some(reason)) => println!("  better    nothing: {reason}"),
        (None, None) => println!("  better    {}", decisive.advised_call),
    }
    match (blame.repairable_at_end, blame.point_of_no_return) {
        (true, _) => println!("  in time   success was to be had for sure up to the last call"),
        (false, Some(step)) => {
            println!("  in time   after call {step} success could no longer be had for sure")
        }
        (false, None) => {}
    }
}

/// A row of table `blame`.
#[cfg(feature = "analytics")]
fn stored(measured: &MeasuredTrace) -> BlameRow {
    let MeasuredTrace {
        blame,
        alternative,
        no_alternative,
        ..
    } = measured;
    let decisive = blame.decisive.as_ref();
    let small = |number: u32| i32::try_from(number).unwrap_or(i32::MAX);
    BlameRow {
        episode_id: blame.episode_id.clone(),
        trace_digest: blame.trace_digest.to_string(),
        step: decisive.map(|decisive| small(decisive.step)),
        tool: decisive.map(|decisive| decisive.tool.clone()),
        harm: decisive.map(|decisive| decisive.harm.name().to_owned()),
        cause: decisive.map(|decisive| decisive.cause.name().to_owned()),
        explanation: decisive.map(|decisive| decisive.explanation.clone()),
        advised_call: decisive.map(|decisive| decisive.advised_call.to_string()),
        wasted_steps: small(blame.wasted_steps),
        point_of_no_return: blame.point_of_no_return.map(small),
        repairable_at_end: blame.repairable_at_end,
        perception: blame.shares.perception,
        communication: blame.shares.communication,
        memory: blame.shares.memory,
        primitive: blame.shares.primitive,
        other: blame.shares.other,
        alternative: alternative.as_ref().map(|found| found.policy.clone()),
        alternative_length: alternative.as_ref().map(|found| small(found.length)),
        alternative_trace: alternative
            .as_ref()
            .and_then(|found| Some(found.trace.as_ref()?.display().to_string())),
        verified: alternative.as_ref().is_some_and(|found| found.verified),
        reason: no_alternative.clone(),
    }
}

fn print_steps(blame: &Blame, trace: &Trace) {
    println!("  call  cost  after  regret  knowing");
    let number =
        |number: Option<u32>| number.map_or_else(|| "-".to_owned(), |number| number.to_string());
    for (step, cost) in trace.steps.iter().zip(&blame.costs) {
        let regret = cost.regret.map_or_else(
            || "-".to_owned(),
            |lost| {
                if lost == 0 {
                    String::new()
                } else {
                    lost.to_string()
                }
            },
        );
        let error = step
            .outcome
            .error
            .map_or_else(String::new, |code| format!("   {code}"));
        let [before, after, knowing] = [cost.before, cost.after, cost.hindsight].map(number);
        println!(
            "  {:>4} {before:>5} {after:>6} {regret:>7} {knowing:>8}   {}{error}",
            step.step, step.input.call
        );
    }
}

fn cause(cause: Cause) -> &'static str {
    match cause {
        Cause::Perception => "perception: what it could see told the candidate from the meant one",
        Cause::Communication => {
            "communication: several candidates fitted, and no answer told them apart"
        }
        Cause::Memory => "memory: the record before held that this leads nowhere",
        Cause::Primitive => "primitive: a skill of the robot failed, not the decision",
        Cause::Other => "other: something due was left out, or what came was no call",
    }
}

fn print_summary(measured: &[MeasuredTrace]) {
    let failed: Vec<&MeasuredTrace> = measured
        .iter()
        .filter(|one| one.blame.success == Some(false))
        .collect();
    println!("{} of {} episodes failed", failed.len(), measured.len());
    let better = failed
        .iter()
        .filter(|one| one.alternative.is_some())
        .count();
    let verified = failed
        .iter()
        .filter(|one| one.alternative.as_ref().is_some_and(|found| found.verified))
        .count();
    let in_time = failed
        .iter()
        .filter(|one| one.blame.repairable_at_end)
        .count();
    // Only branches that are kept are replayed.
    let verified = if verified > 0 {
        format!(" ({verified} replayed exactly)")
    } else {
        String::new()
    };
    println!(
        "  in {better} the alternative succeeds{verified}, in {in_time} success was to be had to the end"
    );
    // Nothing was lost for good where nobody failed.
    if failed.is_empty() {
        return;
    }
    let shares = |share: fn(&Blame) -> f64| {
        failed.iter().map(|one| share(&one.blame)).sum::<f64>() / failed.len() as f64
    };
    for (name, share) in [
        ("perception", shares(|blame| blame.shares.perception)),
        ("communication", shares(|blame| blame.shares.communication)),
        ("memory", shares(|blame| blame.shares.memory)),
        ("primitive", shares(|blame| blame.shares.primitive)),
        ("other", shares(|blame| blame.shares.other)),
    ] {
        println!(
            "  {name:<14} {:>5.1}% of what was lost for good",
            100.0 * share
        );
    }
}
