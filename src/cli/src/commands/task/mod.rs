//! `reel task`: checks task files, makes them (`generate` from a table of what belongs where,
//! `compatibility`; `draw` for measurements), reads the published ones (`real-bench`), puts
//! questions into their plans (`annotate`), and says what they are like (`report`).

mod annotate;
mod compatibility;
mod generate;
mod real_bench;
mod report;

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context, bail};
use reel_tasks::{DrawOptions, LoadedSet, ObjectOrder, draw};
use reel_world::{Family, Scene};
use serde_json::json;

use super::scene::scene_file;
use crate::{ExitStatus, inputs};

/// Check, generate, annotate and compare task files.
///
/// Examples:
///   reel task generate --count 200 --seed 1 --out tasks
///   reel task check tasks
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Load task files, name what is broken by file, line and field, and list every warning
    #[command(verbatim_doc_comment)]
    ///
    /// Example:
    ///   reel task check real-bench/tasks
    Check {
        /// Task file or folder
        #[arg(value_name = "PATH")]
        path: PathBuf,
        #[command(flatten)]
        scene: inputs::SceneArguments,
        /// Print counts, warnings and broken files as one JSON object
        #[arg(long)]
        json: bool,
    },
    /// Draw plain tasks of one scene: what the published measurements of this
    /// project were made with
    #[command(verbatim_doc_comment)]
    ///
    /// One object moves, out of the 240 of the small library; nothing is simulated before it is
    /// kept. Use `reel task generate` for training and evaluation.
    ///
    /// Example:
    ///   reel task draw --count 40 --seed 1 --out tasks
    Draw {
        /// Scene file; without it the home that comes with Reel
        #[arg(long, value_name = "FILE")]
        scene: Option<PathBuf>,
        /// Number of tasks to draw
        #[arg(long, value_name = "N", default_value_t = 40)]
        count: usize,
        /// Task families to cycle through; without it all four
        #[arg(long, value_name = "FDP,FODP,FDO,SUL", value_delimiter = ',')]
        families: Vec<String>,
        /// Seed of every random draw
        #[arg(long, value_name = "N", default_value_t = 0)]
        seed: u64,
        /// Folder for the files
        #[arg(long, value_name = "DIR", default_value = "tasks-out")]
        out: PathBuf,
        /// Print the counts of drawn and rejected tasks as JSON
        #[arg(long)]
        json: bool,
    },
    Generate(generate::Arguments),
    Annotate(annotate::Arguments),
    Compatibility(compatibility::Arguments),
    Report(report::Arguments),
    RealBench(real_bench::Arguments),
}

/// Checks, draws, generates, annotates, converts or describes tasks.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match &arguments.command {
        Command::Check { path, scene, json } => check(path, scene, *json),
        Command::Generate(arguments) => generate::run(arguments),
        Command::Annotate(arguments) => annotate::run(arguments),
        Command::Compatibility(arguments) => compatibility::run(arguments),
        Command::Report(arguments) => report::run(arguments),
        Command::RealBench(arguments) => real_bench::run(arguments),
        Command::Draw {
            scene,
            count,
            families,
            seed,
            out,
            json,
        } => {
            let scene = inputs::scene(scene.as_deref())?;
            let families = parse_families(families)?;
            let made = draw(&DrawOptions {
                scene: &scene,
                families: &families,
                count: *count,
                seed: *seed,
            });
            for task in &made.tasks {
                save(
                    &out.join(format!("{}.yaml", task.task_id)),
                    &reel_tasks::yaml::write(task, &scene),
                )?;
            }
            if *json {
                println!(
                    "{}",
                    json!({ "tasks": made.tasks.len(), "rejected": made.rejected, "out": out })
                );
            } else {
                println!("{} tasks in {}", made.tasks.len(), out.display());
                for (reason, count) in &made.rejected {
                    println!("  rejected {count}: {reason}");
                }
            }
            Ok(if made.tasks.len() == *count {
                ExitStatus::Success
            } else {
                ExitStatus::CheckFailed
            })
        }
    }
}

/// Writes a file as a whole or not at all.
fn save(path: &Path, text: &str) -> anyhow::Result<()> {
    let folder = path.parent().unwrap_or(path);
    fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let part = path.with_extension("part");
    fs::write(&part, text).with_context(|| format!("cannot write {}", part.display()))?;
    fs::rename(&part, path).with_context(|| format!("cannot write {}", path.display()))
}

/// Writes the scene of tasks beside them.
fn save_scene(folder: &Path, scene: &Scene) -> anyhow::Result<()> {
    save(
        &folder.join(format!("{}.json", scene.scene_id)),
        &scene_file(scene)?,
    )
}

fn check(path: &Path, scene: &inputs::SceneArguments, as_json: bool) -> anyhow::Result<ExitStatus> {
    let LoadedSet {
        report,
        scenes,
        warnings,
    } = reel_tasks::load_with(path, &scene.source()?, ObjectOrder::AsWritten);
    warnings
        .iter()
        .for_each(|warning| eprintln!("reel: {warning}"));
    let (loaded, files) = (report.tasks.len(), report.tasks.len() + report.broken.len());
    if files == 0 {
        bail!("no task file (.yaml) in {}", path.display());
    }
    if as_json {
        let broken: Vec<String> = report.broken.iter().map(ToString::to_string).collect();
        println!(
            "{}",
            json!({ "loaded": loaded, "files": files, "warnings": report.warnings, "broken": broken })
        );
    } else {
        for warning in &report.warnings {
            println!("{warning}");
        }
        for error in &report.broken {
            println!("broken: {error}");
        }
        let mut kinds: BTreeMap<&str, usize> = BTreeMap::new();
        for warning in &report.warnings {
            *kinds.entry(warning.kind.as_str()).or_default() += 1;
        }
        let names: Vec<&str> = scenes.iter().map(|scene| scene.scene_id.as_str()).collect();
        println!(
            "{loaded} of {files} tasks load in scene {}",
            names.join(", ")
        );
        for (kind, count) in kinds {
            println!("  {count:4} {kind}");
        }
    }
    Ok(if report.broken.is_empty() {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}

/// The scenes that were named; without a name the home.
fn scenes(named: &[PathBuf]) -> anyhow::Result<Vec<Arc<Scene>>> {
    match named {
        [] => Ok(vec![inputs::scene(None)?]),
        files => files.iter().map(|file| inputs::scene(Some(file))).collect(),
    }
}

fn parse_families(names: &[String]) -> anyhow::Result<Vec<Family>> {
    if names.is_empty() {
        return Ok(Family::ALL.to_vec());
    }
    let parse = |name: &String| {
        Family::parse(name)
            .with_context(|| format!("no family is called '{name}'; there are FDP, FODP, FDO, SUL"))
    };
    names.iter().map(parse).collect()
}
