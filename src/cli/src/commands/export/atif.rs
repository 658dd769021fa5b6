//! `reel export atif`: traces in the Agent Trajectory Interchange Format.

use std::{collections::BTreeSet, fs, path::PathBuf};

use anyhow::Context;
use reel_import::atif::LOST;
use reel_trace::trace_stem;
use reel_world::record::Backend;
use serde_json::{Value, json};

use crate::{ExitStatus, inputs, progress};

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
    let files = inputs::trace_files();
    let traces = inputs::traces(&files, &arguments.paths)?;
    let mut stems = BTreeSet::new();
    if let Some(twice) = traces.iter().find(|path| !stems.insert(trace_stem(path))) {
        anyhow::bail!(
            "two traces are called {}; export them into different folders, or rename one: {}",
            trace_stem(twice),
            twice.display()
        );
    }
    let bar = progress::bar(traces.len(), "export");
    let out = &arguments.out;
    fs::create_dir_all(out).with_context(|| format!("cannot make the folder {}", out.display()))?;
    let mut unread = 0;
    for path in &traces {
        let trace = match files.read(path) {
            Ok(trace) => trace,
            Err(error) => {
                bar.suspend(|| eprintln!("reel: not exported: {error}"));
                unread += 1;
                continue;
            }
        };
        let stem = trace_stem(path);
        let header = &trace.header;
        let tools = match header.backend {
            Backend::Sim => Some(reel_prompt::functions(header.profile.names())),
            Backend::Robot | Backend::Proxy | Backend::Imported => {
                header.policy.parameters.get("tools").cloned()
            }
        };
        let tools = tools
            .as_ref()
            .and_then(Value::as_array)
            .cloned()
            .unwrap_or_default();
        let exported = reel_import::atif::export(&trace, &stem, &tools)?;
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
        bar.inc(1);
        if arguments.json {
            let steps = exported.trajectory.steps.len();
            let told = json!({"trace": path, "document": document, "steps": steps, "images": exported.images.len()});
            bar.suspend(|| println!("{told}"));
        }
    }
    bar.finish_and_clear();
    if arguments.json {
        println!(
            "{}",
            json!({ "lost": LOST.iter().map(|(field, what)| json!({"field": field, "becomes": what})).collect::<Value>() })
        );
    } else {
        println!(
            "{} trajectories in {}",
            traces.len() - unread,
            out.display()
        );
        println!("reel import atif gives back all but:");
        for (field, what) in LOST {
            println!("  {field}: {what}");
        }
    }
    Ok(match traces.len() - unread {
        _ if unread == 0 => ExitStatus::Success,
        0 => ExitStatus::BadInput,
        _ => ExitStatus::Partial,
    })
}
