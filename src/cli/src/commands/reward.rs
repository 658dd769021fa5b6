//! `reel reward`: rewards again, under any preset.

use std::{fs, path::PathBuf};

use anyhow::{Context, bail};
use reel_reward::{Preset, RewardDifference, difference};
use reel_tables::Store;
use serde_json::json;

use crate::{Answer, progress};

/// Score the episodes of a store again, from its tables, under any preset: `paper`, `real-repo`, or a TOML file of your own
/// (schemas/reward_preset.example.toml). The result is kept beside the recorded rewards under the preset's version, and the
/// view `rewards` has both.
///
/// Examples:
///   reel reward --store store --preset real-repo
///   reel reward --store store --check
///   reel reward --store store --diff paper my_preset.toml
///   reel reward --list
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The store: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store")]
    store: String,
    /// Score under this preset and keep the result
    #[arg(long, value_name = "PRESET")]
    preset: Option<String>,
    /// List the episodes whose rewards differ between two presets, by how much and through which component; keeps nothing
    #[arg(long, num_args = 2, value_names = ["A", "B"], conflicts_with = "preset")]
    diff: Option<Vec<String>>,
    /// Compare the recorded terms of every episode with what its preset gives now, bit for bit; exit code 1 where one differs
    #[arg(long, conflicts_with_all = ["preset", "diff"])]
    check: bool,
    /// List the built-in presets with their versions and terms
    #[arg(long)]
    list: bool,
    /// Print JSON, one line an episode where episodes are listed
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<Answer> {
    if arguments.list {
        list(arguments.json);
        return Ok(Answer::Yes);
    }
    match (&arguments.preset, &arguments.diff) {
        (Some(name), _) => keep(arguments, &preset(name)?),
        (None, Some(names)) => compare(arguments, &preset(&names[0])?, &preset(&names[1])?),
        (None, None) if arguments.check => check(arguments),
        (None, None) => bail!("say what to do: --preset PRESET, --diff A B, --check or --list"),
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
            println!("  {:28} {:>7}  {}: {}", term.name(), preset.weight(term), term.component(), term.doc());
        }
    }
}

fn keep(arguments: &Arguments, preset: &Preset) -> anyhow::Result<Answer> {
    let spinner = progress::spinner();
    let report = Store::open(&arguments.store)?.rescore(preset, |done| {
        spinner.set_message(format!("{done} episodes scored"));
        spinner.tick();
    });
    spinner.finish_and_clear();
    let report = report?;
    if arguments.json {
        println!("{}", json!({ "preset": preset.name(), "version": preset.version().to_string(), "report": report }));
    } else {
        let mean = report.mean_total.map(|mean| format!(", mean total {mean:.3}")).unwrap_or_default();
        println!(
            "{} episodes scored under '{}' (version {}){mean}; {} had it already",
            report.scored,
            preset.name(),
            preset.version().short(),
            report.unchanged
        );
    }
    Ok(Answer::Yes)
}

fn compare(arguments: &Arguments, a: &Preset, b: &Preset) -> anyhow::Result<Answer> {
    let store = Store::open(&arguments.store)?;
    let (mut changed, mut episodes) = (0_usize, 0_usize);
    store.score(&[a.clone(), b.clone()], |episode, rewards| {
        episodes += 1;
        if let Some(found) = difference(&rewards[0], &rewards[1]) {
            changed += 1;
            print_difference(arguments.json, episode, &found);
        }
        true
    })?;
    if !arguments.json {
        println!("{changed} of {episodes} episodes change from '{}' to '{}'", a.name(), b.name());
    }
    Ok(Answer::Yes)
}

fn print_difference(as_json: bool, episode: &reel_tables::ScoredEpisode<'_>, found: &RewardDifference) {
    let RewardDifference { before, after, components, steps } = found;
    if as_json {
        let components: serde_json::Map<String, serde_json::Value> = components
            .iter()
            .map(|(name, change)| ((*name).to_owned(), json!({ "before": change.before, "after": change.after })))
            .collect();
        let line = json!({
            "episode_id": episode.episode_id, "policy": episode.policy, "task_id": episode.task_id, "trace": episode.trace,
            "before": before, "after": after, "components": components, "steps": steps,
        });
        println!("{line}");
        return;
    }
    let parts: Vec<String> =
        components.iter().map(|(name, change)| format!("{name} {:+.3}", change.after - change.before)).collect();
    println!(
        "{}  {} {}  {before:.3} -> {after:.3} ({:+.3}): {}; steps {steps:?}",
        episode.episode_id,
        episode.policy,
        episode.task_id,
        after - before,
        parts.join(", ")
    );
}

fn check(arguments: &Arguments) -> anyhow::Result<Answer> {
    let store = Store::open(&arguments.store)?;
    let presets = Preset::built_in();
    let (mut equal, mut differing, mut unknown) = (0_usize, Vec::new(), 0_usize);
    store.score(&presets, |episode, rewards| {
        match presets.iter().position(|preset| preset.name() == episode.preset) {
            None => unknown += 1,
            Some(index) if episode.was_recorded_as(&rewards[index]) => equal += 1,
            Some(_) => differing.push((episode.episode_id.to_owned(), episode.trace.to_owned())),
        }
        true
    })?;
    if arguments.json {
        println!("{}", json!({ "equal": equal, "differing": differing, "other_presets": unknown }));
    } else {
        differing.iter().take(20).for_each(|(id, trace)| println!("{id} differs: {trace}"));
        if differing.len() > 20 {
            println!("and {} more; --json lists them all", differing.len() - 20);
        }
        println!("{equal} episodes equal bit for bit, {} differ, {unknown} recorded under other presets", differing.len());
    }
    Ok(if differing.is_empty() { Answer::Yes } else { Answer::No })
}

/// A built-in preset, or one in a file.
fn preset(name: &str) -> anyhow::Result<Preset> {
    if let Some(preset) = Preset::parse(name) {
        return Ok(preset);
    }
    let path = PathBuf::from(name);
    if !path.exists() {
        let known = Preset::built_in().map(|preset| preset.name().to_owned()).join("', '");
        bail!("no preset is called '{name}' and there is no such file; built in are '{known}'");
    }
    let text = fs::read_to_string(&path).with_context(|| format!("cannot read {name}"))?;
    Preset::from_toml(&text).with_context(|| format!("the preset in {name} is wrong"))
}
