//! `reel store reward`: rewards again, under any preset.

use std::{fs, path::PathBuf};

use anyhow::{Context, bail};
use base64::{Engine as _, engine::general_purpose::STANDARD as BASE64};
use reel_reward::{Preset, RewardDifference, TrainerEnd, difference};
use reel_tables::{RescoredEpisodes, Store, StoreError, Table};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::{ExitStatus, cluster_arguments::ClusterArguments, progress};

/// Score the episodes of a store again, from its tables, under any preset: `paper`, `real-repo`
/// (the published reward class), `real-trainer` (what the published trainer pays, until it stops),
/// or a TOML file of your own (schemas/reward_preset.example.toml). The result is kept beside the
/// recorded rewards under the preset's version, and the view `rewards` has both; an episode that
/// was recorded with these very terms is not kept twice.
///
/// Examples:
///   reel store reward --store store --preset real-trainer
///   reel store reward --store store --check
///   reel store reward --store store --diff paper my_preset.toml
///   reel store reward --list
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The store: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store")]
    store: String,
    #[command(flatten)]
    in_cluster: ClusterArguments,
    /// Score under this preset and keep the result
    #[arg(long, value_name = "PRESET")]
    preset: Option<String>,
    /// List the episodes whose rewards differ between two presets, by how much and through
    /// which component; keeps nothing
    #[arg(long, num_args = 2, value_names = ["A", "B"], conflicts_with = "preset")]
    diff: Option<Vec<String>>,
    /// Compare the recorded terms of every episode with what its preset gives now, bit for bit;
    /// exit code 1 where one differs
    #[arg(long, conflicts_with_all = ["preset", "diff"])]
    check: bool,
    /// List the built-in presets with their versions and terms
    #[arg(long)]
    list: bool,
    /// Print JSON, one line an episode where episodes are listed
    #[arg(long)]
    json: bool,
}

/// Scores episodes under a preset, compares presets, or checks recorded rewards.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    if arguments.list {
        list(arguments.json);
        return Ok(ExitStatus::Success);
    }
    match (&arguments.preset, &arguments.diff) {
        (Some(name), _) => keep(arguments, &PresetSource::find(name)?),
        (None, Some(names)) => compare(
            arguments,
            &PresetSource::find(&names[0])?,
            &PresetSource::find(&names[1])?,
        ),
        (None, None) if arguments.check => check(arguments),
        (None, None) => bail!("name one of --preset PRESET, --diff A B, --check or --list"),
    }
}

fn list(as_json: bool) {
    for preset in Preset::built_in() {
        if as_json {
            println!(
                "{}",
                json!({ "name": preset.name(), "version": preset.version().to_string(), "content": preset.content() })
            );
            continue;
        }
        println!("{}  version {}", preset.name(), preset.version().short());
        for term in preset.base().terms() {
            println!(
                "  {:28} {:>7}  {}: {}",
                term.name(),
                preset.weight(term),
                term.component(),
                term.doc()
            );
        }
    }
}

fn keep(
    arguments: &Arguments,
    PresetSource { preset, text }: &PresetSource,
) -> anyhow::Result<ExitStatus> {
    let spinner = progress::spinner();
    let mut store = Store::open(&arguments.store)?;
    let told = |done: usize| {
        spinner.set_message(format!("{done} episodes scored"));
        spinner.tick();
    };
    let mut scored = RescoredEpisodes::default();
    let in_cluster =
        score_in_cluster(
            arguments,
            &store,
            &Request::Keep(text.clone()),
            |part| match part {
                Response::Kept(rows) => {
                    scored.append(RescoredEpisodes::from_bytes(&BASE64.decode(rows)?)?);
                    Ok(())
                }
                _ => bail!("an executor answered something else"),
            },
        )?;
    let report = if in_cluster {
        store.append_rescored(scored, preset)
    } else {
        store.rescore(preset, told)
    };
    spinner.finish_and_clear();
    let report = report?;
    if arguments.json {
        println!(
            "{}",
            json!({ "preset": preset.name(), "version": preset.version().to_string(), "report": report })
        );
    } else {
        let mean = report
            .mean_total
            .map(|mean| format!(", mean total {mean:.3}"))
            .unwrap_or_default();
        println!(
            "{} episodes scored under '{}' (version {}){mean}; {} had it already",
            report.scored,
            preset.name(),
            preset.version().short(),
            report.unchanged
        );
    }
    Ok(ExitStatus::Success)
}

fn compare(
    arguments: &Arguments,
    a: &PresetSource,
    b: &PresetSource,
) -> anyhow::Result<ExitStatus> {
    let store = Store::open(&arguments.store)?;
    let (mut changed, mut episodes) = (0_usize, 0_usize);
    let asked = Request::Compare(a.text.clone(), b.text.clone(), arguments.json);
    let in_cluster = score_in_cluster(arguments, &store, &asked, |part| match part {
        Response::Compared {
            episodes: more,
            lines,
        } => {
            episodes += more;
            changed += lines.len();
            lines.iter().for_each(|line| println!("{line}"));
            Ok(())
        }
        _ => bail!("an executor answered something else"),
    })?;
    if !in_cluster {
        differences(
            &store,
            &store.file_names(Table::Episodes),
            &[a.preset.clone(), b.preset.clone()],
            arguments.json,
            |line| {
                episodes += 1;
                if let Some(line) = line {
                    changed += 1;
                    println!("{line}");
                }
            },
        )?;
    }
    if !arguments.json {
        println!(
            "{changed} of {episodes} episodes change from '{}' to '{}'",
            a.preset.name(),
            b.preset.name()
        );
    }
    Ok(ExitStatus::Success)
}

/// Tells of every episode in some files how its rewards under two presets differ, if they do.
fn differences(
    store: &Store,
    files: &[String],
    presets: &[Preset; 2],
    as_json: bool,
    mut tell: impl FnMut(Option<String>),
) -> Result<(), StoreError> {
    store.score_in(files, presets, |episode, rewards| {
        tell(difference(&rewards[0], &rewards[1]).map(|found| line(as_json, episode, &found)));
        true
    })
}

fn line(
    as_json: bool,
    episode: &reel_tables::ScoredEpisode<'_>,
    found: &RewardDifference,
) -> String {
    let RewardDifference {
        before,
        after,
        components,
        steps,
        endings,
    } = found;
    if as_json {
        let components: serde_json::Map<String, serde_json::Value> = components
            .iter()
            .map(|(name, change)| {
                (
                    (*name).to_owned(),
                    json!({ "before": change.before, "after": change.after }),
                )
            })
            .collect();
        let line = json!({
            "episode_id": episode.episode_id, "policy": episode.policy, "task_id": episode.task_id, "trace": episode.trace,
            "before": before, "after": after, "components": components, "steps": steps,
            "end": endings.map(|ending| ending.map(|(step, why)| json!({ "step": step, "reason": why.as_str() }))),
        });
        return line.to_string();
    }
    let parts: Vec<String> = components
        .iter()
        .map(|(name, change)| format!("{name} {:+.3}", change.after - change.before))
        .collect();
    let done =
        |ending: (u32, TrainerEnd)| format!("; done at step {}: {}", ending.0, ending.1.as_str());
    let done: String = endings.iter().flatten().copied().map(done).collect();
    format!(
        "{}  {} {}  {before:.3} -> {after:.3} ({:+.3}): {}; steps {steps:?}{done}",
        episode.episode_id,
        episode.policy,
        episode.task_id,
        after - before,
        parts.join(", ")
    )
}

/// How the recorded terms stand to what their presets give now.
#[derive(Serialize, Deserialize, Default)]
struct TermComparison {
    equal: usize,
    /// Episode id and trace path of each episode whose recorded terms differ.
    differing: Vec<(String, String)>,
    unknown: usize,
}

fn checked(store: &Store, files: &[String]) -> Result<TermComparison, StoreError> {
    let presets = Preset::built_in();
    let mut found = TermComparison::default();
    store.score_in(files, &presets, |episode, rewards| {
        match presets
            .iter()
            .position(|preset| preset.name() == episode.preset)
        {
            None => found.unknown += 1,
            Some(index) if episode.matches_recorded(&rewards[index]) => found.equal += 1,
            Some(_) => found
                .differing
                .push((episode.episode_id.to_owned(), episode.trace.to_owned())),
        }
        true
    })?;
    Ok(found)
}

fn check(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let store = Store::open(&arguments.store)?;
    let mut found = TermComparison::default();
    let in_cluster = score_in_cluster(arguments, &store, &Request::Check, |part| match part {
        Response::Checked(more) => {
            found.equal += more.equal;
            found.unknown += more.unknown;
            found.differing.extend(more.differing);
            Ok(())
        }
        _ => bail!("an executor answered something else"),
    })?;
    if !in_cluster {
        found = checked(&store, &store.file_names(Table::Episodes))?;
    }
    let TermComparison {
        equal,
        differing,
        unknown,
    } = found;
    if arguments.json {
        println!(
            "{}",
            json!({ "equal": equal, "differing": differing, "other_presets": unknown })
        );
    } else {
        differing
            .iter()
            .take(20)
            .for_each(|(id, trace)| println!("{id} differs: {trace}"));
        if differing.len() > 20 {
            println!("and {} more; --json lists them all", differing.len() - 20);
        }
        println!(
            "{equal} episodes equal bit for bit, {} differ, {unknown} recorded under other presets",
            differing.len()
        );
    }
    Ok(if differing.is_empty() {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}

/// What executors are asked to do with the files of a store; presets as TOML.
#[derive(Serialize, Deserialize)]
enum Request {
    Keep(String),
    /// Whether lines are wanted as JSON.
    Compare(String, String, bool),
    Check,
}

/// What came of some files.
#[derive(Serialize, Deserialize)]
enum Response {
    /// Rows as [`RescoredEpisodes::to_bytes`] gives them, in base64.
    Kept(String),
    Compared {
        episodes: usize,
        lines: Vec<String>,
    },
    Checked(TermComparison),
}

/// Lets the cluster score the files of a store, if one is named: `take` gets what came of
/// each, in their order.
#[cfg(feature = "cluster")]
fn score_in_cluster(
    arguments: &Arguments,
    store: &Store,
    asked: &Request,
    mut take: impl FnMut(Response) -> anyhow::Result<()>,
) -> anyhow::Result<bool> {
    let Some(cluster) = arguments.in_cluster.open()? else {
        return Ok(false);
    };
    let place = crate::cluster_arguments::named_from_root(&[PathBuf::from(&arguments.store)])?;
    let options = serde_json::to_string(&(&place[0], store.version(), asked))?;
    let files: Vec<Vec<PathBuf>> = store
        .file_names(Table::Episodes)
        .into_iter()
        .map(|file| vec![file.into()])
        .collect();
    let bar = progress::bar(files.len(), "reward");
    cluster.work("reward", &options, &files, |part| {
        bar.inc(1);
        take(serde_json::from_slice(&part)?)
    })?;
    bar.finish_and_clear();
    Ok(true)
}

#[cfg(not(feature = "cluster"))]
fn score_in_cluster(
    _: &Arguments,
    _: &Store,
    _: &Request,
    _: impl FnMut(Response) -> anyhow::Result<()>,
) -> anyhow::Result<bool> {
    Ok(false)
}

/// What executors do for this command: with files of a store, at one version.
#[cfg(feature = "cluster")]
pub fn work() -> reel_cluster::TraceJob {
    let scored = |files: &[PathBuf], options: &str| -> anyhow::Result<Vec<u8>> {
        let (place, version, asked): (PathBuf, u64, Request) = serde_json::from_str(options)?;
        let store = Store::open_at(&place, version)?;
        let files: Vec<String> = files
            .iter()
            .map(|file| file.to_string_lossy().into_owned())
            .collect();
        let part = match asked {
            Request::Keep(preset) => {
                let rows = store.rescore_in(&files, &said(&preset)?, |_| ())?;
                Response::Kept(BASE64.encode(rows.to_bytes()?))
            }
            Request::Compare(a, b, as_json) => {
                let (mut episodes, mut lines) = (0, Vec::new());
                differences(&store, &files, &[said(&a)?, said(&b)?], as_json, |line| {
                    episodes += 1;
                    lines.extend(line);
                })?;
                Response::Compared { episodes, lines }
            }
            Request::Check => Response::Checked(checked(&store, &files)?),
        };
        Ok(serde_json::to_vec(&part)?)
    };
    let run = move |files: &[PathBuf], options: &str| {
        scored(files, options).map_err(|error| format!("{error:#}"))
    };
    reel_cluster::TraceJob {
        name: "reward",
        traces: false,
        run: std::sync::Arc::new(run),
    }
}

/// A preset with the text that says it: the name of a built-in one, or TOML.
pub(crate) struct PresetSource {
    pub(crate) preset: Preset,
    text: String,
}

impl PresetSource {
    /// A built-in preset, or one in a file.
    pub(crate) fn find(name: &str) -> anyhow::Result<Self> {
        if let Some(preset) = Preset::parse(name) {
            return Ok(Self {
                preset,
                text: name.to_owned(),
            });
        }
        let path = PathBuf::from(name);
        if !path.exists() {
            let known = Preset::built_in()
                .map(|preset| preset.name().to_owned())
                .join("', '");
            bail!("no preset is called '{name}' and there is no such file; built in are '{known}'");
        }
        let text = fs::read_to_string(&path).with_context(|| format!("cannot read {name}"))?;
        let preset =
            Preset::from_toml(&text).with_context(|| format!("the preset in {name} is wrong"))?;
        Ok(Self { preset, text })
    }
}

/// The preset that a text says.
#[cfg(feature = "cluster")]
fn said(text: &str) -> anyhow::Result<Preset> {
    Ok(match Preset::parse(text) {
        Some(preset) => preset,
        None => Preset::from_toml(text)?,
    })
}
