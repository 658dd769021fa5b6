//! `reel export real-annotation`: traces in the files of REAL's annotation script.

use std::{fs, path::PathBuf};

use anyhow::Context;
use reel_annotate::{
    Annotation, PublicTask, Step, annotate, episode_seed, notes_path,
    published::{RequestWording, answers, episode, events},
    read_notes,
};
use reel_trace::{Trace, encode_png};
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH};
use serde_json::{Value, json};

use crate::{ExitStatus, inputs, progress};

/// Traces in the forms of REAL's annotation script, tools under their old names:
///   streams/<n>.json, <n>_meta.json                the events that the script reads, and the task
///   template.json                                  what a model is asked, a record a step
///   obs/images/ep_<n>/ep_<n>_step_<i>.png          the images of the records
///   anno_checkpoint/annotated_checkpoint.<ep>.json the records of an episode with their thoughts
///   annotated_output.json                          those of all episodes
/// Thoughts are the notes beside a trace (`reel dataset annotate`), else those of the rules; the History of
/// a record is the numbered list of all results so far, as the script makes it.
/// docs/real-formats.md says how streams become the script's pickle files.
///
/// Example:
///   reel export real-annotation traces --out annotation
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Traces, or folders of them
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Folder for the files
    #[arg(long, value_name = "DIR", default_value = "annotation")]
    out: PathBuf,
    /// The part of the benchmark that the records name; without it the family of the task
    #[arg(long, value_name = "NAME")]
    subset: Option<String>,
    /// Seed of the rules' choice of words
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `reel export real-annotation`.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let files = inputs::trace_files();
    let paths = inputs::traces(&files, &arguments.paths)?;
    let out = &arguments.out;
    let (mut templates, mut samples, mut images): (Vec<Value>, Vec<Value>, usize) =
        (Vec::new(), Vec::new(), 0);
    let bar = progress::bar(paths.len(), "export");
    for (number, path) in (1..).zip(&paths) {
        let trace = files.read(path)?;
        let subset = arguments
            .subset
            .clone()
            .unwrap_or_else(|| trace.header.family.to_string());
        let written = episode(&trace, number, Some(subset));
        for step in 1..=written.steps.len() {
            let Some(image) = written.image_path(step) else {
                continue;
            };
            if let Some(rgb) = trace.frame_rgb(Some(trace.steps[step - 1].step))? {
                save(
                    &out.join(image),
                    &encode_png(&rgb, FRAME_WIDTH as u32, FRAME_HEIGHT as u32),
                )?;
                images += 1;
            }
        }
        let streams = out.join("streams");
        save_json(
            &streams.join(format!("{number}.json")),
            &json!(events(&trace, &written)),
        )?;
        save_json(
            &streams.join(format!("{number}_meta.json")),
            &written.task.to_json(),
        )?;
        let of_episode = written.samples(
            &answers(&notes(path, &trace, arguments.seed)?),
            &RequestWording::REEL,
        );
        let checkpoint = format!("anno_checkpoint/annotated_checkpoint.{}.json", written.id());
        save_json(&out.join(checkpoint), &json!(of_episode))?;
        templates.extend(written.templates(&RequestWording::REEL));
        samples.extend(of_episode);
        bar.inc(1);
    }
    bar.finish_and_clear();
    save_json(&out.join("template.json"), &json!(templates))?;
    save_json(&out.join("annotated_output.json"), &json!(samples))?;
    if arguments.json {
        println!(
            "{}",
            json!({ "out": out, "episodes": paths.len(), "records": samples.len(), "images": images })
        );
    } else {
        println!(
            "{} records of {} episodes and {images} images in {}",
            samples.len(),
            paths.len(),
            out.display()
        );
    }
    Ok(ExitStatus::Success)
}

/// The notes beside a trace; if there are none, those of the rules.
fn notes(path: &std::path::Path, trace: &Trace, seed: u64) -> anyhow::Result<Vec<Annotation>> {
    let beside = notes_path(path);
    if beside.exists() {
        let (_, entries) = read_notes(&beside, &trace.chain())?;
        return Ok(entries.into_iter().map(|entry| entry.note).collect());
    }
    let task = PublicTask::of(&trace.task, &trace.scene);
    Ok(annotate(
        &task,
        &Step::all(trace),
        episode_seed(seed, &trace.chain()),
    ))
}

fn save_json(path: &std::path::Path, value: &Value) -> anyhow::Result<()> {
    save(path, format!("{value:#}\n").as_bytes())
}

fn save(path: &std::path::Path, bytes: &[u8]) -> anyhow::Result<()> {
    let folder = path.parent().unwrap_or(path);
    fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}
