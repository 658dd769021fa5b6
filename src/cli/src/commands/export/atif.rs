//! `reel export atif`: traces in the Agent Trajectory Interchange Format.

use std::{fs, path::PathBuf};

use anyhow::Context;
use reel_import::atif::LOST;
use reel_trace::trace_stem;
use serde_json::json;

use super::readable::{Traces, tell_lost};
use crate::{ExitStatus, otlp};

/// Traces as trajectories in ATIF 1.7, the Agent Trajectory Interchange Format, which Harbor, Inspect
/// Scout, Phoenix and NeMo read: one document per episode, with its images in a folder beside it.
///
/// The first turn is the instruction with the image of the start, every later one a call with what the policy
/// said and thought, its tokens, and the outcome with its image. `extra.reel` has what the
/// format has no field for: task, rewards, world graphs, error codes. What `reel import
/// atif` cannot give back is printed.
///
/// Example:
///   reel export atif traces --out trajectories
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Traces, or folders of them
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Folder for the documents; made if it is not there
    #[arg(long, value_name = "DIR", default_value = "trajectories")]
    out: PathBuf,
    /// Print one JSON object per document, and one of what is lost
    #[arg(long)]
    json: bool,
}

/// Writes a document for each trace.
pub fn execute(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let mut traces = Traces::find(&arguments.paths)?;
    traces.expect_distinct_names()?;
    let out = &arguments.out;
    fs::create_dir_all(out).with_context(|| format!("cannot make the folder {}", out.display()))?;
    traces.each(|path, trace, bar| {
        let stem = trace_stem(path);
        let exported = reel_import::atif::export(&trace, &stem, &otlp::tools(&trace))?;
        let document = out.join(format!("{stem}.json"));
        let write = |path: &PathBuf, bytes: &[u8]| {
            fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
        };
        write(&document, &serde_json::to_vec_pretty(&exported.trajectory)?)?;
        if !exported.images.is_empty() {
            let folder = out.join(&stem);
            fs::create_dir_all(&folder)
                .with_context(|| format!("cannot make the folder {}", folder.display()))?;
        }
        for (name, image) in &exported.images {
            write(&out.join(name), image)?;
        }
        if arguments.json {
            let steps = exported.trajectory.steps.len();
            let told = json!({"trace": path, "document": document, "steps": steps, "images": exported.images.len()});
            bar.suspend(|| println!("{told}"));
        }
        Ok(())
    })?;
    if !arguments.json {
        println!("{} trajectories in {}", traces.exported(), out.display());
    }
    tell_lost("atif", LOST, arguments.json);
    Ok(traces.status())
}
