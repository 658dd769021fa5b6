//! `reel run --check-isolation`: finds state that depends on what it must not depend on.

use std::{fs, path::Path, process::Command};

use anyhow::{Context, bail};
use reel_agents::EpisodeReport;
use reel_trace::Trace;

use crate::{commands::run::Arguments, inputs};

/// Plays the same episodes again in another process: another heap layout (freed memory is filled,
/// where the C library can do so), other thread count, tasks and listed objects in reverse order.
/// Prints the first difference of each episode that has one, and gives their number.
///
/// # Errors
/// When the other process fails, or a trace of it cannot be read.
pub fn leaks(arguments: &Arguments, reports: &[EpisodeReport]) -> anyhow::Result<usize> {
    let folder = std::env::temp_dir().join(format!("reel-paranoid-{}", std::process::id()));
    let found = play_again(arguments, &folder).and_then(|()| compare(reports, &folder));
    // What is left behind is only a copy.
    let _ = fs::remove_dir_all(&folder);
    let leaks = found?;
    for leak in &leaks {
        eprintln!("reel: {leak}");
    }
    if leaks.is_empty() && !arguments.json {
        println!(
            "paranoid: {} episodes are the same under another heap layout, thread count and input order",
            reports.len()
        );
    }
    Ok(leaks.len())
}

fn play_again(arguments: &Arguments, folder: &Path) -> anyhow::Result<()> {
    let workers = inputs::workers(arguments.jobs);
    let mut again =
        Command::new(reel_live::program().context("cannot find this program to run it again")?);
    again
        .arg("run")
        .arg("--tasks")
        .arg(&arguments.tasks)
        .args(["--policy", &arguments.policy]);
    again.args([
        "--seed",
        &arguments.seed.to_string(),
        "--profile",
        &arguments.profile,
        "--skills",
        arguments.skills.as_str(),
        "--no-images",
        "--reversed",
        "--json",
    ]);
    again
        .arg("--out")
        .arg(folder)
        .args(["--jobs", &(workers + 1).to_string()]);
    again.args(arguments.scene.flags());
    if let Some(assets) = arguments.assets.path() {
        again.arg("--assets").arg(assets);
    }
    again
        .env("MALLOC_PERTURB_", "165")
        .env("MALLOC_ARENA_MAX", "1")
        .env("MALLOC_MMAP_THRESHOLD_", "4096");
    let output = again.output().context("cannot run the episodes again")?;
    if !output.status.success() && output.status.code() != Some(3) {
        bail!(
            "the second run failed ({}): {}",
            output.status,
            String::from_utf8_lossy(&output.stderr)
        );
    }
    Ok(())
}

fn compare(reports: &[EpisodeReport], folder: &Path) -> anyhow::Result<Vec<String>> {
    let mut leaks = Vec::new();
    for path in reports.iter().filter_map(|report| report.trace.as_ref()) {
        let name = path.file_name().context("a trace has a name")?;
        let (first, second) = (Trace::read(path)?, Trace::read(&folder.join(name))?);
        if let Some(divergence) = reel_replay::first_divergence(&first, &second) {
            leaks.push(format!(
                "{}: state depends on the conditions it is computed under: {divergence}",
                path.display()
            ));
        }
    }
    Ok(leaks)
}
