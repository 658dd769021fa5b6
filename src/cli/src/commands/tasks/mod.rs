//! `reel tasks`: checks task files, makes them (`generate` from a table of what belongs where, `compatibility`; `draw` for
//! measurements), puts questions into their plans (`annotate`), and says what they are like (`report`).

mod annotate;
mod compatibility;
mod generate;
mod report;

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context, bail};
use reel_tasks::{GenerateOptions, Listed, generate};
use reel_world::{Family, Scene, Task};
use serde_json::json;

use super::scene::scene_file;
use crate::{Answer, inputs};

/// Check or make task files.
#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Load task files, name what is broken by file, line and field, and list every oddity
    #[command(verbatim_doc_comment)]
    ///
    /// Example:
    ///   reel tasks check real-bench/tasks --scene real-bench/s7_scene.json
    Check {
        /// Task file or folder
        #[arg(value_name = "PATH")]
        path: PathBuf,
        /// Scene file; without it `s7_scene.json` beside the tasks, else the home that comes with Reel
        #[arg(long, value_name = "FILE")]
        scene: Option<PathBuf>,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Draw plain tasks of one scene: what the published measurements of this project were made with
    #[command(verbatim_doc_comment)]
    ///
    /// One object moves, out of the 240 of the small library; nothing is simulated before it is kept.
    /// Use `reel tasks generate` for training and evaluation.
    ///
    /// Example:
    ///   reel tasks draw --count 40 --seed 1 --out tasks
    Draw {
        /// Scene file; without it the home that comes with Reel
        #[arg(long, value_name = "FILE")]
        scene: Option<PathBuf>,
        /// How many tasks
        #[arg(long, value_name = "N", default_value_t = 40)]
        count: usize,
        /// Families, in turn
        #[arg(long, value_name = "FDP,FODP,FDO,SUL", value_delimiter = ',')]
        families: Vec<String>,
        /// Seed of everything random
        #[arg(long, value_name = "N", default_value_t = 0)]
        seed: u64,
        /// Folder for the files
        #[arg(long, value_name = "DIR", default_value = "tasks-out")]
        out: PathBuf,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    Generate(generate::Arguments),
    Annotate(annotate::Arguments),
    Compatibility(compatibility::Arguments),
    Report(report::Arguments),
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<Answer> {
    match &arguments.command {
        Command::Check { path, scene, json } => check(path, scene.clone(), *json),
        Command::Generate(arguments) => generate::run(arguments),
        Command::Annotate(arguments) => annotate::run(arguments),
        Command::Compatibility(arguments) => compatibility::run(arguments),
        Command::Report(arguments) => report::run(arguments),
        Command::Draw { scene, count, families, seed, out, json } => {
            let scene = inputs::scene(scene.as_deref())?;
            let families = parse_families(families)?;
            let made = generate(&GenerateOptions { scene: &scene, families: &families, count: *count, seed: *seed });
            for task in &made.tasks {
                save(&out.join(format!("{}.yaml", task.task_id)), &reel_tasks::yaml::write(task, &scene))?;
            }
            if *json {
                println!("{}", json!({ "tasks": made.tasks.len(), "rejected": made.rejected, "out": out }));
            } else {
                println!("{} tasks in {}", made.tasks.len(), out.display());
                for (reason, count) in &made.rejected {
                    println!("  rejected {count}: {reason}");
                }
            }
            Ok(if made.tasks.len() == *count { Answer::Yes } else { Answer::No })
        }
    }
}

/// Writes a file as a whole or not at all.
fn save(path: &Path, text: &str) -> anyhow::Result<()> {
    let folder = path.parent().unwrap_or(path);
    fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let part = path.with_extension("part");
    fs::write(&part, text).with_context(|| format!("cannot write {}", part.display()))?;
    fs::rename(&part, path).with_context(|| format!("cannot write {}", path.display()))
}

/// Writes the scene of tasks beside them.
fn save_scene(folder: &Path, scene: &Scene) -> anyhow::Result<()> {
    save(&folder.join(format!("{}.json", scene.scene_id)), &scene_file(scene)?)
}

/// A scene and tasks for it.
type Set = (Arc<Scene>, Vec<Arc<Task>>);

/// The tasks of a file or folder, in whatever scenes: a folder that `reel tasks generate` wrote brings its scenes along; else the scene
/// is `s7_scene.json` beside the tasks, or the home. Also how many files are broken.
fn sets(path: &Path) -> anyhow::Result<(Vec<Set>, usize)> {
    let mut scenes: Vec<PathBuf> = Vec::new();
    if path.is_dir() {
        let entries = fs::read_dir(path).with_context(|| format!("cannot list {}", path.display()))?;
        for entry in entries {
            let path = entry.with_context(|| format!("cannot list {}", path.display()))?.path();
            if path.extension().is_some_and(|extension| extension == "json") && path.with_extension("").is_dir() {
                scenes.push(path);
            }
        }
    }
    scenes.sort();
    let mut broken = 0;
    let mut load = |tasks: &Path, scene: Option<&Path>| -> anyhow::Result<Set> {
        let scene = inputs::scene(scene)?;
        let (tasks, unread) = inputs::tasks(tasks, &scene, Listed::AsWritten)?;
        broken += unread;
        Ok((scene, tasks))
    };
    let sets = if scenes.is_empty() {
        vec![load(path, scene_beside(path).as_deref())?]
    } else {
        scenes.iter().map(|scene| load(&scene.with_extension(""), Some(scene))).collect::<anyhow::Result<_>>()?
    };
    Ok((sets, broken))
}

/// The scene that lies beside published tasks.
fn scene_beside(tasks: &Path) -> Option<PathBuf> {
    tasks.parent().map(|folder| folder.join("s7_scene.json")).filter(|file| file.exists())
}

fn check(path: &Path, scene: Option<PathBuf>, as_json: bool) -> anyhow::Result<Answer> {
    let scene = inputs::scene(scene.or_else(|| scene_beside(path)).as_deref())?;
    let report = reel_tasks::load(path, &scene);
    let (loaded, files) = (report.tasks.len(), report.tasks.len() + report.broken.len());
    if files == 0 {
        bail!("no task file (.yaml) in {}", path.display());
    }
    if as_json {
        let broken: Vec<String> = report.broken.iter().map(ToString::to_string).collect();
        println!("{}", json!({ "loaded": loaded, "files": files, "oddities": report.oddities, "broken": broken }));
    } else {
        for oddity in &report.oddities {
            println!("{oddity}");
        }
        for error in &report.broken {
            println!("broken: {error}");
        }
        let mut kinds: BTreeMap<&str, usize> = BTreeMap::new();
        for oddity in &report.oddities {
            *kinds.entry(oddity.kind.as_str()).or_default() += 1;
        }
        println!("{loaded} of {files} tasks load in scene {}", scene.scene_id);
        for (kind, count) in kinds {
            println!("  {count:4} {kind}");
        }
    }
    Ok(if report.broken.is_empty() { Answer::Yes } else { Answer::No })
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
        Family::parse(name).with_context(|| format!("no family is called '{name}'; there are FDP, FODP, FDO, SUL"))
    };
    names.iter().map(parse).collect()
}
