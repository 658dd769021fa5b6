//! `reel task generate`: tasks for any scenes, through both filters.

use std::{collections::BTreeSet, path::PathBuf, sync::Arc};

use anyhow::{Context, bail};
use reel_tasks::generate::task::{
    Compatibility, GenerateOptions, GenerateReport, Placing, Rejection, Statistics, TaskType, make,
    real,
};
use reel_tasks::real_proc;
use reel_world::Scene;
use serde_json::json;

use super::{parse_families, save, save_scene};
use crate::{ExitStatus, inputs, progress};

/// Generate tasks for any scenes, and keep those whose objects stay where they are put.
///
/// Tasks go to DIR/<scene>/<family>/, and the scene they are made for to DIR/<scene>.json.
///
/// Example:
///   reel task generate --count 200 --seed 1 --out made
///   reel task generate --scene S1,S2,S3,flat.json --families SUL --format real
///   reel task generate --scene S1 --count 100 --format real-proc --out proc
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Scenes: S1 to S7, S1-parts to S7-parts, home, or files; without it the home
    #[arg(long, value_name = "SCENES", value_delimiter = ',')]
    scene: Vec<PathBuf>,
    /// Task families to cycle through; without it all four
    #[arg(long, value_name = "FDP,FODP,FDO,SUL", value_delimiter = ',')]
    families: Vec<String>,
    /// Types: basic, distractor, articulation (or store, retrieve), interactive, gather
    #[arg(long, value_name = "TYPES", value_delimiter = ',')]
    types: Vec<String>,
    /// Table of what belongs where, as `reel task compatibility` writes it; without it the one
    /// that comes with Reel
    #[arg(long, value_name = "FILE")]
    compatibility: Option<PathBuf>,
    /// Number of tasks to generate
    #[arg(long, value_name = "N", default_value_t = 40)]
    count: usize,
    /// Seed of every random draw
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// reel; real: the schema of REAL-Bench and nothing else, which has no tasks that move several
    /// objects; or real-proc: one DIR/<scene>/<type>.yaml as REAL's task generator writes it, with
    /// objects on its placement grid
    #[arg(long, value_name = "NAME", default_value = "reel", value_parser = ["reel", "real", "real-proc"])]
    format: String,
    /// Folder for the files
    #[arg(long, value_name = "DIR", default_value = "tasks-out")]
    out: PathBuf,
    /// Threads; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print the statistics of the generation as one JSON object
    #[arg(long)]
    json: bool,
}

/// Generates tasks, writes the accepted ones and prints the statistics.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let scenes = super::scenes(&arguments.scene)?;
    let table = arguments
        .compatibility
        .as_ref()
        .map(super::compatibility::read)
        .transpose()?;
    let in_real = arguments.format == "real";
    let options = GenerateOptions {
        scenes: &scenes,
        library: reel_tasks::library::objects(),
        table: table.as_ref().unwrap_or(Compatibility::committed()),
        families: &parse_families(&arguments.families)?,
        types: &parse_types(&arguments.types, in_real)?,
        count: arguments.count,
        seed: arguments.seed,
        placing: if arguments.format == "real-proc" {
            Placing::Grid
        } else {
            Placing::NearEdge
        },
        jobs: inputs::workers(arguments.jobs),
    };
    let bar = progress::bar(arguments.count, "tasks");
    let made = make(&options, || bar.inc(1))?;
    bar.finish_and_clear();
    write(&made, &scenes, arguments)?;
    let statistics = &made.statistics;
    if arguments.json {
        let rejected: Vec<_> = statistics
            .rejected
            .iter()
            .map(|(why, count)| json!({ "filter": Rejection::FILTERS[why.filter()], "reason": why.as_str(), "count": count }))
            .collect();
        let summary = json!({
            "tasks": statistics.tasks, "drafts": statistics.drafts, "filters": statistics.filters(), "rejected": rejected,
            "receptacle_pairs": statistics.receptacle_pairs, "triplets": statistics.triplets, "out": arguments.out,
        });
        println!("{summary}");
    } else {
        print(statistics, arguments);
    }
    Ok(if made.tasks.len() == arguments.count {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}

fn print(statistics: &Statistics, arguments: &Arguments) {
    let Statistics {
        tasks,
        drafts,
        receptacle_pairs,
        triplets,
        ..
    } = statistics;
    println!(
        "{tasks} tasks in {}, from {drafts} drafts",
        arguments.out.display()
    );
    println!(
        "{receptacle_pairs} pairs of receptacles, {triplets} (source, destination, object) triplets"
    );
    println!("  filter      seen  passed");
    for step in statistics.filters() {
        let share = if step.examined == 0 {
            100.0
        } else {
            100.0 * step.passed as f64 / step.examined as f64
        };
        println!(
            "  {:8} {:7} {:7}  {share:5.1}%",
            step.filter, step.examined, step.passed
        );
        for (why, count) in statistics
            .rejected
            .iter()
            .filter(|(why, _)| Rejection::FILTERS[why.filter()] == step.filter)
        {
            println!("           {count:7}          {}", why.as_str());
        }
    }
}

fn write(
    made: &GenerateReport,
    scenes: &[Arc<Scene>],
    arguments: &Arguments,
) -> anyhow::Result<()> {
    let out = &arguments.out;
    for scene in made
        .tasks
        .iter()
        .map(|(scene, _)| *scene)
        .collect::<BTreeSet<_>>()
    {
        save_scene(out, &scenes[scene])?;
    }
    if arguments.format == "real-proc" {
        let tasks = made
            .tasks
            .iter()
            .map(|(scene, task)| (task, scenes[*scene].as_ref()));
        return real_proc::export(tasks)
            .iter()
            .try_for_each(|file| save(&out.join(&file.path), &file.text()));
    }
    for (index, (scene, task)) in made.tasks.iter().enumerate() {
        let scene = &scenes[*scene];
        let text = match arguments.format.as_str() {
            "real" => real::write(task, scene, index)
                .context("a task that moves several objects has no published form")?,
            _ => reel_tasks::yaml::write(task, scene),
        };
        save(
            &out.join(&scene.scene_id)
                .join(format!("{}.yaml", task.task_id)),
            &text,
        )?;
    }
    Ok(())
}

fn parse_types(names: &[String], in_real: bool) -> anyhow::Result<Vec<TaskType>> {
    let mut types = Vec::new();
    for name in names {
        let meant = TaskType::parse(name);
        if meant.is_empty() {
            bail!(
                "no type is called '{name}'; there are basic, distractor, articulation, store, retrieve, interactive, gather"
            );
        }
        types.extend(meant);
    }
    if in_real && types.contains(&TaskType::Gather) {
        bail!(
            "tasks of type gather move several objects, which the published schema cannot say; leave out --format real"
        );
    }
    if types.is_empty() {
        types = TaskType::ALL
            .into_iter()
            .filter(|kind| !in_real || *kind != TaskType::Gather)
            .collect();
    }
    Ok(types)
}
