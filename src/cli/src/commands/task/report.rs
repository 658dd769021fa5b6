//! `reel task report`: what a set of tasks is like, beside another one.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use reel_tasks::generate::task::report::{DistributionRow, report};
use reel_world::Task;
use serde_json::json;

use crate::{ExitStatus, inputs};

/// Show how plan length, distractors, object sizes and instruction length are distributed in
/// a set of tasks.
///
/// Example:
///   reel task report made --compare real-bench/tasks
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder of task files to describe
    #[arg(value_name = "DIR")]
    tasks: PathBuf,
    #[command(flatten)]
    scene: inputs::SceneArguments,
    /// Folder of other tasks to compare with
    #[arg(long = "compare", alias = "against", value_name = "DIR")]
    against: Option<PathBuf>,
    /// Print the distributions as one JSON object
    #[arg(long)]
    json: bool,
}

/// Prints how a folder's tasks are distributed, beside those of another folder if given.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let ours = report(&tasks(&arguments.tasks, &arguments.scene)?);
    let theirs = arguments
        .against
        .as_deref()
        .map(|folder| tasks(folder, &arguments.scene))
        .transpose()?
        .map(|tasks| report(&tasks));
    if arguments.json {
        println!("{}", json!({ "tasks": ours, "against": theirs }));
        return Ok(ExitStatus::Success);
    }
    let head = "     n    min  median    mean     max";
    println!(
        "{:6} {:30} {head}{}",
        "family",
        "",
        theirs.as_ref().map_or(String::new(), |_| format!(
            "   | against {}",
            head.trim_start()
        ))
    );
    for row in &ours {
        let other = theirs
            .iter()
            .flatten()
            .find(|other| (other.family, other.quantity) == (row.family, row.quantity));
        let family = row.family.map_or("all", |family| family.as_str());
        println!(
            "{family:6} {:30} {}{}",
            row.quantity,
            numbers(row),
            other.map_or(String::new(), |row| format!("   | {}", numbers(row)))
        );
    }
    Ok(ExitStatus::Success)
}

fn numbers(row: &DistributionRow) -> String {
    let of = &row.distribution;
    format!(
        "{:6} {:6.2} {:7.2} {:7.2} {:7.2}",
        of.count, of.min, of.median, of.mean, of.max
    )
}

/// The tasks of a folder, in whatever scenes.
fn tasks(folder: &Path, scene: &inputs::SceneArguments) -> anyhow::Result<Vec<Task>> {
    let loaded = inputs::tasks(folder, scene, reel_tasks::ObjectOrder::AsWritten)?;
    Ok(loaded.tasks.into_iter().map(Arc::unwrap_or_clone).collect())
}
