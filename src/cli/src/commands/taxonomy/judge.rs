//! `reel taxonomy judge`: a model's opinion on failed episodes, beside the rules'.

use std::path::{Path, PathBuf};

use anyhow::Context;
use reel_llm::client::Clock as _;
use reel_query::QuerySession;
use reel_tables::{LabelRow, Store};
use reel_taxonomy::{
    StoredClass,
    judge::{
        Case, CaseImage, CaseObject, CaseStep, CaseTruth, JudgeOptions, JudgeReading, JudgedCase,
        RuleFinding, Source, judge_all,
    },
};
use reel_trace::TraceFiles;
use reel_world::{
    ObjectInstance, Task,
    record::{Backend, StepRecord},
};
use serde_json::json;

use crate::{
    ExitStatus,
    commands::taxonomy::classes_of,
    inputs,
    model::{Model, RealClock},
    progress,
};

/// Ask a model behind an OpenAI-compatible endpoint why episodes failed. It sees the transcript,
/// with `--max-frames` images and with `--truth` goal and captions, but not what the rules say, and cannot overturn what the simulator proved.
/// Its opinions are kept as labels of kind `judge`; `reel taxonomy agreement --reference judge` compares
/// them with the rules, and with `--prediction judge` says how far its confidence can be trusted. Every call is logged, and asked only once.
///
/// Examples:
///   reel taxonomy judge --store store --endpoint http://localhost:8000/v1 --model qwen3-vl --max-episodes 50
///   reel taxonomy judge --store store --endpoint http://localhost:8000/v1 --model qwen3-vl --step-by-step   # an author of its own
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The store: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store")]
    store: String,
    #[command(flatten)]
    assets: inputs::Assets,
    #[command(flatten)]
    model: Model,
    /// At most so many episodes
    #[arg(
        long = "max-episodes",
        alias = "max",
        value_name = "N",
        default_value_t = 100
    )]
    max: usize,
    /// At most so many images an episode: around the decisive step
    #[arg(
        long = "max-frames",
        alias = "frames",
        value_name = "N",
        default_value_t = 0
    )]
    frames: usize,
    /// Show the judge what only the simulator knows: which object was meant, where it stood and belongs,
    /// the looks of all objects, and what each call acted on
    #[arg(long)]
    truth: bool,
    /// Look for the decisive step one step at a time, without what comes after it; the class is asked
    /// with the whole record. As many calls as there are steps up to the decisive one, and one. Its labels have the author `MODEL step by step`
    #[arg(long)]
    step_by_step: bool,
    /// Folder in which replies are kept
    #[arg(long, value_name = "DIR", default_value = "judge-cache")]
    cache: PathBuf,
    /// File to which every call is added, one JSON object a line
    #[arg(long, value_name = "FILE", default_value = "judge-calls.jsonl")]
    log: PathBuf,
    /// Calls at a time
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print JSON, one line an episode
    #[arg(long)]
    json: bool,
}

/// Episodes whose cases are in memory at a time.
const PORTION: usize = 32;

/// Asks a model why episodes failed and stores its opinions as labels.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let client = arguments.model.client(&arguments.cache, &arguments.log)?;
    let client = client.context("--endpoint and --model are missing: the model that judges")?;
    let session = QuerySession::new(arguments.assets.store(&arguments.store, None)?)?;
    let mut failed = classes_of(&session, &arguments.store)?;
    failed.truncate(arguments.max);
    let options = JudgeOptions {
        reading: match arguments.step_by_step {
            true => JudgeReading::Steps,
            false => JudgeReading::Whole,
        },
        frames: arguments.frames,
        ..JudgeOptions::default()
    };
    let bar = progress::bar(failed.len(), "judging");
    let (mut labels, mut errors, mut agree, mut proven) = (Vec::new(), 0, 0, 0);
    for portion in failed.chunks(PORTION) {
        let mut cases = Vec::new();
        for episode in portion {
            match case(session.store().trace_files(), episode, arguments) {
                Ok(case) => cases.push(case),
                Err(error) => {
                    errors += 1;
                    eprintln!("reel: {}: {error:#}", episode.episode_id);
                }
            }
        }
        for verdict in judge_all(
            &cases,
            &client,
            &options,
            inputs::workers(arguments.jobs),
            |_| bar.inc(1),
        ) {
            let verdict = match verdict {
                Ok(verdict) => verdict,
                Err(error) => {
                    errors += 1;
                    eprintln!("reel: {error}");
                    continue;
                }
            };
            proven += usize::from(verdict.agrees.is_some());
            agree += usize::from(verdict.agrees == Some(true));
            if arguments.json {
                println!("{}", serde_json::to_string(&verdict)?);
            }
            labels.push(label(&verdict, options.reading));
        }
    }
    bar.finish_and_clear();
    let judged = labels.len();
    Store::open(&arguments.store)?.change_labels(|mut before| {
        before.retain(|old| {
            !labels
                .iter()
                .any(|new| (&new.episode_id, &new.author) == (&old.episode_id, &old.author))
        });
        before.extend(labels.iter().cloned());
        before
    })?;
    let summary = json!({ "judged": judged, "errors": errors, "proven": proven, "agree": agree });
    if arguments.json {
        println!("{summary}");
    } else {
        println!(
            "{judged} episodes judged; it agrees with the rules on {agree} of {proven} whose cause is proven; {errors} errors"
        );
    }
    Ok(if errors > 0 {
        ExitStatus::Partial
    } else {
        ExitStatus::Success
    })
}

/// What the judge gets of an episode.
fn case(files: &TraceFiles, episode: &StoredClass, arguments: &Arguments) -> anyhow::Result<Case> {
    let (frames, truth) = (arguments.frames, arguments.truth);
    let trace = files
        .read(Path::new(&episode.trace))
        .context("its trace cannot be read")?;
    let turn = |step: &StepRecord| {
        let policy = step.input.policy.clone().unwrap_or_default();
        let asked = step.tool_name() == "ask";
        CaseStep {
            step: step.step,
            call: format!("{} {}", step.input.call.name, step.input.call.arguments),
            outcome: step.outcome.text.clone(),
            error: step
                .outcome
                .error
                .map(|code| code.to_string())
                .unwrap_or_default(),
            acted_on: match truth {
                true => acted_on(&trace.task, step),
                false => String::new(),
            },
            reasoning: policy.reasoning,
            history: policy.history,
            question: if asked {
                step.input.call.arguments["question"]
                    .as_str()
                    .unwrap_or_default()
                    .to_owned()
            } else {
                String::new()
            },
            answer: step
                .reply
                .as_ref()
                .map(|reply| reply.text.clone())
                .unwrap_or_default(),
        }
    };
    let decisive = u32::try_from(episode.step).unwrap_or(0);
    let first = decisive.saturating_sub(frames as u32 / 2);
    let images = (first..).take(frames).filter_map(|step| {
        let bytes = trace.image(Some(step))?.to_vec();
        Some(CaseImage {
            step,
            media_type: "image/webp".into(),
            bytes,
        })
    });
    Ok(Case {
        episode_id: episode.episode_id.clone(),
        instruction: trace.task.instruction.clone(),
        truth: truth.then(|| case_truth(&trace.task)),
        transcript: trace.steps.iter().map(turn).collect(),
        frames: images.collect(),
        rule_finding: Some(RuleFinding {
            class: episode.class.clone(),
            sub_class: Some(episode.sub_class.clone()),
            step: decisive,
            evidence: format!("rule for {} at step {decisive}", episode.sub_class),
        }),
        reduced: trace.header.backend != Backend::Sim,
    })
}

/// How an object looks, in words.
fn look(object: &ObjectInstance) -> String {
    object
        .caption
        .clone()
        .unwrap_or_else(|| object.category.clone())
}

/// What the task wanted, and where things stood.
fn case_truth(task: &Task) -> CaseTruth {
    let moved: Vec<_> = task.goal_objects().map(|object| &object.instance).collect();
    let (goal, others) = task
        .objects
        .iter()
        .partition::<Vec<_>, _>(|object| moved.contains(&&object.instance));
    let words = |object: &ObjectInstance, belongs_on: String| CaseObject {
        object: look(object),
        stood_on: object.receptacle.to_string(),
        belongs_on,
    };
    let belongs_on = |object: &ObjectInstance| {
        let to = task.goal.receptacle_of(&object.instance);
        to.map(ToString::to_string).unwrap_or_default()
    };
    CaseTruth {
        goal: goal
            .into_iter()
            .map(|object| words(object, belongs_on(object)))
            .collect(),
        others: others
            .into_iter()
            .map(|object| words(object, String::new()))
            .collect(),
    }
}

/// What a call acted on in truth.
fn acted_on(task: &Task, step: &StepRecord) -> String {
    let object = step
        .object
        .as_ref()
        .and_then(|id| task.object(id))
        .map(look);
    let receptacle = step.receptacle.as_ref().map(ToString::to_string);
    [object, receptacle]
        .into_iter()
        .flatten()
        .collect::<Vec<_>>()
        .join(", ")
}

/// The judge's opinion as a label; what it was overruled in is said in the note.
fn label(verdict: &JudgedCase, reading: JudgeReading) -> LabelRow {
    let opinion = &verdict.opinion;
    let proposal = opinion
        .proposed_sub_class
        .as_deref()
        .map(|name| format!(" (proposes '{name}')"))
        .unwrap_or_default();
    let standing = match verdict.source {
        Source::Rules if opinion.overruled => " [overruled by what is proven]",
        Source::Rules | Source::Judge => "",
    };
    LabelRow {
        episode_id: verdict.episode_id.clone(),
        author: match reading {
            JudgeReading::Whole => verdict.model.clone(),
            JudgeReading::Steps => format!("{} step by step", verdict.model),
        },
        kind: "judge".into(),
        class: opinion.class.clone(),
        sub_class: opinion.sub_class.clone(),
        step: i32::try_from(opinion.step).ok(),
        confidence: Some(opinion.confidence),
        note: Some(format!("{}{proposal}{standing}", opinion.comment)),
        at_ms: (RealClock.now_ns() / 1_000_000) as i64,
        blind: None,
    }
}
