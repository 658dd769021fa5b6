//! `reel claims`: sentences about episodes, counted anew over a store.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use reel_query::{
    Format, Limits, QuerySession,
    claim::{Claim, ClaimReport, ClaimVerdict, Tally},
    format,
};
use serde::Deserialize;
use serde_json::{Value, json};

use crate::{ExitStatus, inputs, progress};

/// Claims: sentences about episodes with the condition that decides for each episode, as the page
/// Claims of `reel serve` keeps them.
#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    what: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Count claims anew over a store, and compare them with what they promise: a gate in CI.
    ///
    /// A claim is a JSON file with a `title`, the sentence, and a `claim`: which episodes count
    /// (`of`, default all), which of them bear it out (`holds`, a condition in SQL, or `pattern`, a
    /// call pattern), and the share that is promised (`at_least`, `at_most`, from 0 to 1). A claim
    /// holds if its whole 95 % interval (exact, with tasks as clusters) keeps the promise, fails if
    /// none of it does, and is open otherwise.
    ///
    /// Examples:
    ///   reel claims check demo-out/definitions --store demo-out/store
    ///   reel claims check asks-first.json --store store --run checkpoint-12 --strict
    ///   reel claims check claims --store store --json | jq '.claims[] | {title, verdict, share}'
    ///
    /// Exit code 0: no claim fails; 1: one fails, or with --strict one is open or counts nothing;
    /// 2: a claim or the store cannot be read.
    #[command(verbatim_doc_comment)]
    Check(Check),
}

#[derive(clap::Args)]
struct Check {
    /// Files of claims, or folders of definitions; what is no claim in a folder is passed over
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// The store: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store")]
    store: String,
    #[command(flatten)]
    assets: inputs::Assets,
    /// Count the episodes of this run alone
    #[arg(long, value_name = "RUN")]
    run: Option<String>,
    /// A claim with a promise has to hold; that it does not fail is not enough
    #[arg(long)]
    strict: bool,
    /// Print verdicts, counts, runs and examples as one JSON object
    #[arg(long)]
    json: bool,
}

/// A definition, as far as it concerns claims.
#[derive(Deserialize)]
struct ClaimFile {
    title: String,
    claim: Option<Claim>,
    #[serde(flatten)]
    others: BTreeMap<String, Value>,
}

/// Keys of definitions that are no claims, and of all.
const OTHER_KEYS: [&str; 6] = ["text", "sql", "parameters", "chart", "panels", "view"];

/// Runs a command on claims.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match &arguments.what {
        Command::Check(check) => run_check(check),
    }
}

fn run_check(arguments: &Check) -> anyhow::Result<ExitStatus> {
    let claims = read_claims(&arguments.paths)?;
    let store = arguments.assets.store(&arguments.store, None)?;
    let session = QuerySession::with_limits(store, Limits::default())?;
    let bar = progress::bar(claims.len(), "claims");
    let (mut answers, mut passed, mut counted_any) = (Vec::new(), true, false);
    for (path, title, claim) in claims {
        let claim = match &arguments.run {
            Some(run) => claim.in_run(run),
            None => claim,
        };
        let rows = session
            .run(&claim.question())
            .with_context(|| format!("{}: the claim cannot be counted", path.display()))?;
        let rows = serde_json::from_str(&format(&rows, Format::Json)?)?;
        let report = ClaimReport::of(&claim, rows)?;
        counted_any |= report.all.episodes > 0;
        warn(&path, &report);
        let promised = claim.at_least.is_some() || claim.at_most.is_some();
        passed &= match report.all.verdict {
            Some(ClaimVerdict::Fails) => false,
            Some(ClaimVerdict::Holds) => true,
            Some(ClaimVerdict::Open) | None => !(promised && arguments.strict),
        };
        if arguments.json {
            let mut value = json!(report);
            value["path"] = json!(path);
            value["title"] = json!(title);
            answers.push(value);
        } else {
            print(&title, &claim, &report);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    if let (Some(run), false) = (&arguments.run, counted_any) {
        bail!(
            "no claim counts an episode of run '{run}'; `reel query --store STORE \"SELECT DISTINCT run_id FROM episodes\"` lists the runs"
        );
    }
    if arguments.json {
        println!("{}", json!({ "claims": answers, "passed": passed }));
    }
    Ok(if passed {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}

/// Says what conditions cannot see yet.
fn warn(path: &Path, report: &ClaimReport) {
    let unseen = [
        (report.unclassified, "no class", "reel taxonomy"),
        (report.unblamed, "no blame", "reel blame"),
    ];
    for (count, what, command) in unseen {
        if count > 0 {
            eprintln!(
                "reel: {}: {count} failed episodes of the store have {what} yet; run `{command}` first",
                path.display()
            );
        }
    }
}

/// The claims of files and folders, in order. A folder may hold other definitions, a file not.
fn read_claims(paths: &[PathBuf]) -> anyhow::Result<Vec<(PathBuf, String, Claim)>> {
    let mut claims = Vec::new();
    for path in paths {
        let files = if path.is_dir() {
            let entries = fs::read_dir(path)?.collect::<Result<Vec<_>, _>>()?;
            let mut files: Vec<PathBuf> = entries.into_iter().map(|entry| entry.path()).collect();
            files.retain(|file| file.extension().is_some_and(|it| it == "json"));
            files.sort();
            files
        } else {
            vec![path.clone()]
        };
        for file in files {
            match read_claim(&file)? {
                Some((title, claim)) => claims.push((file, title, claim)),
                None if path.is_dir() => {}
                None => bail!(
                    "{}: the definition is no claim: it has no `claim`",
                    file.display()
                ),
            }
        }
    }
    if claims.is_empty() {
        bail!(
            "no claim in {}",
            paths
                .iter()
                .map(|path| path.display().to_string())
                .collect::<Vec<_>>()
                .join(", ")
        );
    }
    Ok(claims)
}

fn read_claim(path: &Path) -> anyhow::Result<Option<(String, Claim)>> {
    let text =
        fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let file: ClaimFile = serde_json::from_str(&text)
        .with_context(|| format!("{}: not a definition", path.display()))?;
    let known = |key: &str| key == "text" || (file.claim.is_none() && OTHER_KEYS.contains(&key));
    if let Some(key) = file.others.keys().find(|key| !known(key)) {
        bail!("{}: unknown key `{key}` in the definition", path.display());
    }
    let Some(claim) = file.claim else {
        return Ok(None);
    };
    if let Err(problem) = claim.check() {
        bail!("{}: the claim {problem}", path.display());
    }
    Ok(Some((file.title, claim)))
}

fn print(title: &str, claim: &Claim, report: &ClaimReport) {
    let verdict = match report.all.verdict {
        Some(ClaimVerdict::Holds) => "holds",
        Some(ClaimVerdict::Open) => "open",
        Some(ClaimVerdict::Fails) => "FAILS",
        None => "-",
    };
    let title: String = title.chars().filter(|c| !c.is_control()).collect();
    println!("{verdict:<6} {title}");
    println!("       {}{}", counted(&report.all), promise(claim));
    if report.runs.len() > 1 {
        for one in &report.runs {
            let name = one.run_id.as_deref().unwrap_or("no run");
            println!("         {name:<28} {}", counted(&one.tally));
        }
    }
    if let Some(change) = &report.changed {
        let before = match change.before {
            ClaimVerdict::Holds => "it held",
            ClaimVerdict::Open => "it was open",
            ClaimVerdict::Fails => "it failed",
        };
        let run = change.run_id.as_deref().unwrap_or("no run");
        println!("       so since run {run}; before, {before}");
    }
    let examples = [
        ("example", &report.examples),
        ("counter-example", &report.counter_examples),
    ];
    for (what, examples) in examples {
        if let Some(one) = examples.first() {
            let trace = one.trace.as_deref().unwrap_or(&one.episode_id);
            println!("       {what}: {trace}");
        }
    }
}

fn counted(tally: &Tally) -> String {
    let percent = |share: f64| format!("{:.0}%", 100.0 * share);
    match (tally.share, tally.low, tally.high) {
        (Some(share), Some(low), Some(high)) => format!(
            "{} of {} episodes ({}, interval {} to {}), {} task{}",
            tally.holding,
            tally.episodes,
            percent(share),
            percent(low),
            percent(high),
            tally.tasks,
            if tally.tasks == 1 { "" } else { "s" }
        ),
        _ => "no episode counts".to_owned(),
    }
}

fn promise(claim: &Claim) -> String {
    // Two decimals at most.
    let percent = |share: f64| (10_000.0 * share).round() / 100.0;
    match (claim.at_least.map(percent), claim.at_most.map(percent)) {
        (None, None) => String::new(),
        (Some(least), None) => format!("; promised: at least {least}%"),
        (None, Some(most)) => format!("; promised: at most {most}%"),
        (Some(least), Some(most)) => format!("; promised: {least} to {most}%"),
    }
}
