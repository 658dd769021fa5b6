//! `reel task real-bench`: the published benchmark, from a checkout of its repository into
//! task and scene files.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use reel_tasks::real_bench::{Checkout, RebuiltScene};
use serde_json::{Value, json};

use super::save;
use crate::ExitStatus;

/// Files that failed a check are named, so many of them.
const BROKEN_SHOWN: usize = 20;

/// Make REAL-Bench playable: check the published task files, rebuild their scenes from where
/// objects are placed, and write both.
///
/// CHECKOUT is a checkout of github.com/InternRobotics/REAL, or its folder `benchmark`. Everything
/// is checked as the published loader checks it; a file that fails is named and left out.
/// DIR/tasks/<family>/<task>.yaml are the published files, unchanged, and DIR/scenes/<scene>.json
/// the scenes. Commands that take tasks find the scene by themselves.
///
/// The published scenes are not public. Heights of surfaces follow from the placements exactly,
/// extents are lower bounds, and what nothing was placed on is assumed; the table says which.
///
/// Exit code 3 if files are left out or the bundle is not complete.
///
/// Example:
///   git clone https://github.com/InternRobotics/REAL
///   reel task real-bench REAL --out real-bench
///   reel run --tasks real-bench/tasks --out traces/real-bench
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Checkout of REAL, or its folder `benchmark`
    #[arg(value_name = "CHECKOUT")]
    checkout: PathBuf,
    /// Folder for tasks and scenes
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `reel task real-bench`.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let Arguments {
        checkout,
        out,
        json: as_json,
    } = arguments;
    let checkout = Checkout::read(checkout)?;
    let (mut broken, mut rebuilt) = (Vec::new(), Vec::new());
    let mut loaded = 0;
    for scene_id in checkout.scene_ids() {
        let scene = checkout
            .rebuild(scene_id)
            .with_context(|| format!("scene {scene_id} cannot be rebuilt"))?;
        let report = checkout.load(&scene.scene);
        broken.extend(report.broken.iter().map(ToString::to_string));
        loaded += report.tasks.len();
        save(
            &out.join("scenes").join(format!("{scene_id}.json")),
            &scene.text,
        )?;
        rebuilt.push((report.tasks.len(), scene));
    }
    broken.splice(0..0, checkout.broken.iter().map(ToString::to_string));
    if loaded == 0 {
        broken
            .iter()
            .take(BROKEN_SHOWN)
            .for_each(|error| eprintln!("reel: {error}"));
        bail!("no task could be loaded from {}", checkout.root.display());
    }
    for file in &checkout.files {
        copy(&file.path, &out.join("tasks").join(file.relative_path()))?;
    }
    let complaints: Vec<String> = checkout
        .complaints
        .iter()
        .map(ToString::to_string)
        .collect();
    let files = checkout.files.len() + checkout.broken.len();
    if *as_json {
        let scenes: Vec<Value> = rebuilt
            .iter()
            .map(|(tasks, scene)| scene_json(*tasks, scene))
            .collect();
        println!(
            "{}",
            json!({ "loaded": loaded, "files": files, "scenes": scenes, "broken": broken, "complaints": complaints, "out": out })
        );
    } else {
        broken
            .iter()
            .take(BROKEN_SHOWN)
            .for_each(|error| println!("broken: {error}"));
        if broken.len() > BROKEN_SHOWN {
            println!("broken: {} more files", broken.len() - BROKEN_SHOWN);
        }
        complaints
            .iter()
            .for_each(|complaint| println!("bundle: {complaint}"));
        rebuilt
            .iter()
            .for_each(|(tasks, scene)| print!("{}", table(*tasks, scene)));
        println!(
            "{loaded} of {files} tasks load; play them with `reel run --tasks {}`",
            out.join("tasks").display()
        );
    }
    Ok(if broken.is_empty() && complaints.is_empty() {
        ExitStatus::Success
    } else {
        ExitStatus::Partial
    })
}

/// Copies a published file as it is; nothing of it may be lost.
fn copy(from: &Path, to: &Path) -> anyhow::Result<()> {
    let text =
        fs::read_to_string(from).with_context(|| format!("cannot read {}", from.display()))?;
    save(to, &text)
}

fn table(tasks: usize, rebuilt: &RebuiltScene) -> String {
    let scene = &rebuilt.scene;
    let mut text = format!(
        "scene {}: {tasks} tasks, {} rooms, {} receptacles\n  {:22} {:18} {:>10} {:>16} {:>26}\n",
        scene.scene_id,
        scene.rooms.len(),
        scene.receptacles.len(),
        "receptacle",
        "room",
        "placements",
        "height",
        "extents"
    );
    for row in &rebuilt.evidence {
        let [height, extents] = if row.placements == 0 {
            ["assumed"; 2]
        } else {
            ["proven", "at least"]
        };
        let door = if row.door { " (door)" } else { "" };
        let [x, y] = row.extents_m;
        text.push_str(&format!(
            "  {:22} {:18} {:10} {:>16} {:>26}\n",
            format!("{}{door}", row.receptacle),
            row.room,
            row.placements,
            format!("{height} {:.3} m", row.height_m),
            format!("{extents} {x:.2} x {y:.2} m"),
        ));
    }
    for warning in &rebuilt.warnings {
        text.push_str(&format!("  note: {warning}\n"));
    }
    text
}

fn scene_json(tasks: usize, rebuilt: &RebuiltScene) -> Value {
    let receptacle = |row: &reel_tasks::real_bench::Evidence| {
        let (height, extents) = if row.placements == 0 {
            ("assumed", "assumed")
        } else {
            ("proven", "lower bound")
        };
        json!({
            "id": row.receptacle, "room": row.room, "door": row.door, "placements": row.placements,
            "height_m": row.height_m, "height": height, "extents_m": row.extents_m, "extents": extents,
        })
    };
    json!({
        "scene_id": rebuilt.scene.scene_id, "tasks": tasks, "warnings": rebuilt.warnings,
        "receptacles": rebuilt.evidence.iter().map(receptacle).collect::<Vec<_>>(),
    })
}
