//! `reel export real-eval`: traces as the files of REAL's evaluation client.

use std::{
    collections::BTreeMap,
    path::PathBuf,
    time::{SystemTime, UNIX_EPOCH},
};

use anyhow::Context;
use reel_import::eval_client::{RunSettings, replay::RecordedRun, run};
use serde_json::{Map, json};

use crate::{ExitStatus, inputs};

/// End of the range of episodes that the client has by default.
const END_IDX: i64 = 999_999;

/// Traces as the `eval_output` that REAL's published agents write, so that its own analysis reads
/// them: for each episode a folder <scene>/<task>/<model> with its calls, results, images and
/// summary, and for each model a file with all results. Success is the client's: it compares the
/// last world graph with the goal. `reel import real-eval` reads the folder back.
///
/// Images come from the trace; run `reel trace expand` on lean traces before. Folders that hold something
/// are skipped, as the client does.
///
/// Example:
///   reel export real-eval traces --out eval_output
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Traces, or folders of them
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Folder for the files
    #[arg(long, value_name = "DIR", default_value = "eval_output")]
    out: PathBuf,
    /// What the files of results begin with, and their mode
    #[arg(long, value_name = "NAME", default_value = "reel")]
    prefix: String,
    /// End of the names of the files of results; without it the time, YYYYMMDD_HHMMSS_ffffff in UTC
    #[arg(long, value_name = "TAG")]
    run_tag: Option<String>,
    /// Print one JSON object per model
    #[arg(long)]
    json: bool,
}

/// Runs `reel export real-eval`.
pub fn execute(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let mut models: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    let files = inputs::trace_files();
    for path in inputs::traces(&files, &arguments.paths)? {
        let model = files.read(&path)?.header.policy.name;
        models.entry(model).or_default().push(path);
    }
    let run_tag = match &arguments.run_tag {
        Some(tag) => tag.clone(),
        None => now()?,
    };
    let mut skipped = 0;
    for (model, paths) in models {
        let settings = RunSettings {
            out: arguments.out.clone(),
            model: model.clone(),
            prefix: arguments.prefix.clone(),
            steps_max: u32::MAX,
            start_idx: 0,
            end_idx: i64::try_from(paths.len())?.max(END_IDX),
            metadata: Map::new(),
            run_tag: run_tag.clone(),
        };
        let mut recorded = RecordedRun::new(&files, &paths);
        let results = match run(&settings, &mut recorded) {
            Ok(results) => results,
            Err(error) => {
                return Err(recorded
                    .problem()
                    .map_or_else(|| error.into(), anyhow::Error::from));
            }
        };
        skipped += results["skipped"].as_u64().unwrap_or_default();
        if arguments.json {
            println!("{}", json!({ "out": arguments.out, "results": results }));
        } else {
            let [total, finished, successes] =
                ["total", "finished", "successes"].map(|key| results[key].clone());
            println!(
                "{model}: {total} episodes in {}, {finished} finished, {successes} successes",
                arguments.out.display()
            );
        }
    }
    if skipped > 0 {
        eprintln!(
            "reel: {skipped} episodes skipped: their folders are not empty; give another --out"
        );
    }
    Ok(if skipped > 0 {
        ExitStatus::Partial
    } else {
        ExitStatus::Success
    })
}

/// Now, as the client names its runs.
fn now() -> anyhow::Result<String> {
    let since = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .context("the clock stands before 1970")?;
    let time = i64::try_from(since.as_micros())
        .ok()
        .and_then(chrono::DateTime::from_timestamp_micros);
    Ok(time
        .context("the clock stands too far in the future")?
        .format("%Y%m%d_%H%M%S_%6f")
        .to_string())
}
