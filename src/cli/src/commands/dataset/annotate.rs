//! `reel dataset annotate`: reasoning, History, schedule and subtask for traces that came without words.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::anyhow;

use rayon::prelude::*;
use reel_annotate::{
    BATCH, Entry, FrameBefore, ModelAnnotator, PrivilegedFacts, Provenance, PublicTask, Step,
    annotate, episode_seed, history_check, notes_path, version, write_notes,
};
use reel_history::{EpisodeFacts, StepFacts};
use reel_llm::client::Client;
use reel_prompt::Prompt;
use reel_trace::{Trace, encode_png};
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, record::StateDigests};
use serde_json::json;

use crate::{ExitStatus, inputs, model::Model, progress, prompt::PromptArguments};

/// Write what an agent might have said along with each decision of a trace: reasoning, History,
/// schedule and subtask, from what it could know at that moment. By rules in varied words, or by a
/// model behind an OpenAI-compatible endpoint, ten decisions a request or one (`--decisions-per-request`), with
/// the images that the agent saw (`--frames`) or without. The model reads the prompt
/// that the agent acts on (`--prompt`; without it the one of Reel), so that its notes fit. Its note
/// stands only if it is complete, says nothing that an agent cannot know and no History that the
/// record refutes; else the rules' note stands in, and the file says why. The notes go into a file
/// beside the trace, `<trace>.notes.jsonl`, which `reel export sft --annotations notes` reads; the trace
/// is not changed. Broken off, the same command goes on where it stopped. `reel export sft` needs
/// none of this: it writes the rules' words itself.
///
/// Example:
///   reel dataset annotate traces
///   reel dataset annotate traces --endpoint http://localhost:8000/v1 --model qwen3-vl
///   reel dataset annotate traces --endpoint http://localhost:8000/v1 --model qwen3-vl --frames --decisions-per-request 1
///   reel dataset annotate traces --endpoint http://localhost:8000/v1 --model qwen3-vl --prompt real_grpo_prompt.txt
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Traces, or folders of them
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    #[command(flatten)]
    model: Model,
    #[command(flatten)]
    prompt: PromptArguments,
    #[command(flatten)]
    assets: inputs::Assets,
    /// Give the model the image that the agent saw before each decision: as recorded, or drawn again
    #[arg(long, requires = "model")]
    frames: bool,
    /// Decisions in one request, 1 to 10; with 1 the model writes step by step, with the last result
    #[arg(long, value_name = "N", requires = "model", default_value_t = BATCH as u8, value_parser = clap::value_parser!(u8).range(1..=BATCH as i64))]
    decisions_per_request: u8,
    /// Folder in which a model's replies are kept
    #[arg(long, value_name = "DIR", default_value = "annotate-cache")]
    cache: PathBuf,
    /// File to which every call of a model is added, one JSON object a line
    #[arg(long, value_name = "FILE", default_value = "annotate-calls.jsonl")]
    log: PathBuf,
    /// Seed of the rules' choice of words
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Traces at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print one JSON object per trace
    #[arg(long)]
    json: bool,
}

/// What came of a trace.
struct TraceResult {
    decisions: usize,
    resumed: usize,
    /// Why the rules' notes stand in a model's place.
    fallbacks: Vec<(usize, String)>,
}

/// Annotates the given traces, prints the counts and names each that failed.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let files = inputs::trace_files();
    let paths = inputs::traces(&files, &arguments.paths)?;
    let client = arguments.model.client(&arguments.cache, &arguments.log)?;
    let prompt = arguments.prompt.prompt()?;
    let bar = progress::bar(paths.len(), "annotating");
    let pool = inputs::pool(arguments.jobs)?;
    let note = |path: &PathBuf| {
        let noted = note(&files, path, client.as_ref(), &prompt, arguments);
        bar.inc(1);
        noted
    };
    let noted: Vec<anyhow::Result<TraceResult>> =
        pool.install(|| paths.par_iter().map(note).collect());
    bar.finish_and_clear();
    let (mut decisions, mut fallbacks, mut errors) = (0, 0, 0);
    for (path, noted) in paths.iter().zip(noted) {
        match noted {
            Ok(noted) => {
                decisions += noted.decisions;
                fallbacks += noted.fallbacks.len();
                if arguments.json {
                    let reasons: Vec<_> = noted
                        .fallbacks
                        .iter()
                        .map(|(call, reason)| json!({ "call": call, "reason": reason }))
                        .collect();
                    let TraceResult {
                        decisions, resumed, ..
                    } = noted;
                    println!(
                        "{}",
                        json!({ "trace": path, "decisions": decisions, "resumed": resumed, "by_rules_because": reasons })
                    );
                }
            }
            Err(error) => {
                errors += 1;
                eprintln!("reel: {}: {error:#}", path.display());
            }
        }
    }
    if !arguments.json {
        let by_rules = if client.is_some() {
            format!("; {fallbacks} by rules in the model's place")
        } else {
            String::new()
        };
        println!(
            "{decisions} decisions of {} traces annotated{by_rules}",
            paths.len() - errors
        );
    }
    Ok(if errors > 0 {
        ExitStatus::Partial
    } else {
        ExitStatus::Success
    })
}

fn note(
    files: &reel_trace::TraceFiles,
    path: &Path,
    client: Option<&Client>,
    prompt: &Arc<Prompt>,
    arguments: &Arguments,
) -> anyhow::Result<TraceResult> {
    let trace = arguments.assets.read(files, path)?;
    let public = PublicTask::of(&trace.task, &trace.scene);
    let steps = Step::all(&trace);
    let seed = episode_seed(arguments.seed, &trace.chain());
    let notes = notes_path(path);
    let Some(client) = client else {
        let entries: Vec<Entry> = annotate(&public, &steps, seed)
            .into_iter()
            .map(Entry::from)
            .collect();
        let provenance = Provenance {
            trace: trace.chain(),
            steps: steps.len(),
            annotator: "rules".to_owned(),
            version: version(),
            seed,
            request: None,
        };
        write_notes(&notes, &provenance, &entries)?;
        return Ok(TraceResult {
            decisions: entries.len(),
            resumed: 0,
            fallbacks: Vec::new(),
        });
    };
    let setting = EpisodeFacts::of(&trace.task, &trace.scene, &trace.start.graphs.physics);
    let check = history_check(setting, trace.steps.iter().map(StepFacts::of).collect());
    let seen = if arguments.frames {
        frames_before(&trace)?
    } else {
        BTreeMap::new()
    };
    let frames = |decision: usize| {
        let rgb = seen.get(&decision)?;
        Some(encode_png(rgb, FRAME_WIDTH as u32, FRAME_HEIGHT as u32))
    };
    let annotator = ModelAnnotator {
        client,
        seed,
        check: &check,
        prompt: Arc::clone(prompt),
        decisions: usize::from(arguments.decisions_per_request),
        frames: arguments.frames.then_some(&frames as &FrameBefore<'_>),
    };
    let written = annotator.annotate(
        &public,
        &steps,
        &PrivilegedFacts::of(&trace.task),
        trace.chain(),
        &notes,
    )?;
    let fallback = |(call, entry): (usize, Entry)| Some((call, entry.fallback?));
    Ok(TraceResult {
        decisions: written.entries.len(),
        resumed: written.resumed,
        fallbacks: written
            .entries
            .into_iter()
            .enumerate()
            .filter_map(fallback)
            .collect(),
    })
}

/// The image that the agent saw before each decision: that of the last result, where it had one.
fn frames_before(trace: &Trace) -> anyhow::Result<BTreeMap<usize, Vec<u8>>> {
    let shown = |step: Option<u32>, digests: &StateDigests| {
        digests.frame.is_some() || trace.image(step).is_some()
    };
    let start = shown(None, &trace.start.digests).then_some(None);
    let steps = trace.steps.iter();
    let steps = steps.filter(|step| shown(Some(step.step), &step.digests));
    let wanted: BTreeSet<Option<u32>> = start
        .into_iter()
        .chain(steps.map(|step| Some(step.step)))
        .collect();
    let frames = reel_replay::frames_at(trace, &wanted);
    let frames = frames.map_err(|verdict| anyhow!("its frames cannot be had: {verdict}"))?;
    let after = |step: Option<u32>| step.map_or(0, |step| step as usize + 1);
    Ok(frames
        .into_iter()
        .map(|(step, rgb)| (after(step), rgb))
        .collect())
}
