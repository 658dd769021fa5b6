//! `reel import`: what other frameworks recorded, as traces.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::Context;
use rayon::prelude::*;
use reel_import::{
    ImportError, ImportOptions, ImportedEpisode, SuccessRule,
    otel::SpanEpisode,
    robot::{Mapping, Recording},
};
use reel_tasks::ObjectOrder;
use reel_world::Scenes;
use serde_json::json;

use crate::{ExitStatus, inputs, progress};

/// Convert recordings of other frameworks and of robots into traces.
#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Episodes that agents of the published REAL framework played: its `eval_output` folder
    #[command(verbatim_doc_comment)]
    ///
    /// Every folder <scene>/<task>/<model> becomes one trace: calls, outcomes, images, world
    /// graphs, markers, the held object, answers of the user, the model's text and
    /// latency; rewards and metrics by Reel's rules. The traces can be shown, scored and queried
    /// like any other, but not executed again, and `reel replay` says so. The files
    /// hold no sizes and captions; with --tasks the benchmark's own files give them. What the
    /// camera saw is in no file: where the reward for asking depends on it, a note says between
    /// which totals the reward lies, and the trace holds the lower one.
    ///
    /// A truncated file is named and the steps before it are imported. A second import gives the
    /// same bytes.
    ///
    /// Examples:
    ///   reel import real-eval eval_output --out traces
    ///   reel import real-eval eval_output --out traces --tasks real-bench/tasks
    ///   reel show traces/FDO_verify_task_9--gpt-4o--0123456789abcdef.mcap
    ///
    /// Exit code 0: all imported; 2: nothing could be; 3: imported, but something was lost or
    /// left out.
    RealEval {
        /// The `eval_output` folder, or any folder in it
        #[arg(value_name = "DIR")]
        folder: PathBuf,
        /// Name of the run that the traces belong to
        #[arg(long, value_name = "NAME", default_value = "real-eval")]
        run: String,
        #[command(flatten)]
        importing: Importing,
    },
    /// Recordings of a real robot: MCAP files and folders of rosbag2, by a mapping of their topics
    #[command(verbatim_doc_comment)]
    ///
    /// A mapping file (TOML) says what each topic is: calls, results, primitives, odometry,
    /// latencies of the low-level model, alignment, cameras, world graphs, what is held, markers,
    /// answers of the user, text of the policy, beginning and end of episodes. Messages may be in
    /// JSON, in protobuf or in CDR (ROS 2). schemas/robot_mapping.example.toml is one to begin
    /// with; docs/robots.md explains it. A recording without calls is one of trials: every
    /// primitive in it becomes a step.
    ///
    /// The traces can be shown, put into tables and queried like any other, but not executed again,
    /// and `reel replay` says so. What a recording does not hold is absent.
    ///
    /// A truncated file is read to its end; a damaged chunk or message is named and left out. A
    /// second import gives the same bytes.
    ///
    /// Examples:
    ///   reel import robot monday.mcap --mapping robot.toml --out traces
    ///   reel import robot bags --mapping robot.toml --out traces --tasks tasks --scene scene.json
    ///   reel ingest traces --store store && reel query --store store --named primitives
    ///
    /// Exit code 0: all imported; 2: nothing could be; 3: imported, but something was lost or
    /// left out.
    Robot {
        /// An MCAP file, a folder that rosbag2 wrote, or a folder of such
        #[arg(value_name = "FILE|DIR")]
        recordings: PathBuf,
        /// Mapping file (TOML) of the topics
        #[arg(long, value_name = "FILE")]
        mapping: PathBuf,
        /// Name of the run that the traces belong to
        #[arg(long, value_name = "NAME", default_value = "robot")]
        run: String,
        #[command(flatten)]
        importing: Importing,
    },
    /// Trajectories of any agent in ATIF, the Agent Trajectory Interchange Format
    #[command(verbatim_doc_comment)]
    ///
    /// Every document becomes one trace, and every agent to which it delegates one more: each call is
    /// a step with its result and image, what the agent said and thought, and its tokens. A turn without a
    /// call is a call of `message`. Documents that `reel export atif` wrote keep task, rewards and
    /// world graphs; in all other documents the task has no goal, and nothing says whether it succeeded. The
    /// traces can be shown and queried like any other, but not executed again.
    ///
    /// Images have to be files beside the document, of the size that the head camera has; others are named and left
    /// out. A second import gives the same bytes.
    ///
    /// Examples:
    ///   reel import atif trajectory.json --out traces
    ///   reel import atif jobs --out traces && reel ingest traces && reel query --named tool_transitions
    ///
    /// Exit code 0: all imported; 2: nothing could be; 3: imported, but something was lost or
    /// left out.
    Atif {
        /// A document (.json), or a folder with documents in it
        #[arg(value_name = "FILE|DIR")]
        documents: PathBuf,
        /// Name of the run that the traces belong to
        #[arg(long, value_name = "NAME", default_value = "atif")]
        run: String,
        #[command(flatten)]
        importing: Importing,
    },
    /// Logs of Inspect: every sample of an evaluation becomes a trace
    #[command(verbatim_doc_comment)]
    ///
    /// Each call of a sample is a step with its result, what the model said and thought, and its tokens; scores are kept
    /// with the names that Inspect gives them (column `scores`), and target and metadata as facts of the task. Which
    /// score says success is --success; without it the first score does, if it is correct or incorrect, true or
    /// false, 1 or 0. Several epochs of a sample are rollouts of one group. Logs that `reel export inspect` wrote keep
    /// task, rewards and world graphs. The traces can be shown and queried like any other, but not executed again.
    ///
    /// Examples:
    ///   reel import inspect logs --out traces
    ///   reel import inspect logs/2026-11-28_swe.eval --success 'tests.passed>=0.9' --out traces
    ///
    /// Exit code 0: all imported; 2: nothing could be; 3: imported, but something was lost or
    /// left out.
    Inspect {
        /// A log (.eval, or .json with its samples), or a folder with logs in it
        #[arg(value_name = "FILE|DIR")]
        logs: PathBuf,
        /// Name of the run that the traces belong to
        #[arg(long, value_name = "NAME", default_value = "inspect")]
        run: String,
        /// The score that says success, and from which value on (default 1)
        #[arg(long, value_name = "NAME[>=VALUE]")]
        success: Option<SuccessRule>,
        #[command(flatten)]
        importing: Importing,
    },
    /// Spans of OpenTelemetry: what an instrumented agent of any framework did, as traces
    #[command(verbatim_doc_comment)]
    ///
    /// Reads OTLP in files (.json and .jsonl as the collector's file exporter writes them, .pb, .binpb, .otlp; also .gz), by the
    /// semantic conventions for generative AI, OpenInference and OpenLLMetry. One conversation is one episode, else one trace
    /// id. Each execution of a tool is a step with its arguments and result; what the model said before it, its tokens and errors
    /// stand with it. Results of evaluations are scores; which of them says success is --success, as for Inspect. Spans that
    /// `reel export otel` wrote keep task, rewards and world graphs. Other spans are counted and not read.
    ///
    /// Examples:
    ///   reel import otel spans --out traces
    ///   reel import otel spans.jsonl --task test.case.name --success 'quality>=0.5' --out traces
    ///
    /// Exit code 0: all imported; 2: nothing could be; 3: imported, but something was lost or
    /// left out.
    Otel {
        /// A file of spans, or a folder with such files in it
        #[arg(value_name = "FILE|DIR")]
        spans: PathBuf,
        /// Name of the run that the traces belong to
        #[arg(long, value_name = "NAME", default_value = "otel")]
        run: String,
        /// The score that says success, and from which value on (default 1)
        #[arg(long, value_name = "NAME[>=VALUE]")]
        success: Option<SuccessRule>,
        /// Attribute of spans that names the task; without it the conversation or trace id does
        #[arg(long = "task", value_name = "ATTRIBUTE")]
        task_attribute: Option<String>,
        #[command(flatten)]
        importing: Importing,
    },
}

/// What every import takes.
#[derive(clap::Args)]
struct Importing {
    /// Folder for the traces; made if it is not there
    #[arg(long, value_name = "TRACES", default_value = "traces-out")]
    out: PathBuf,
    /// The benchmark's task files: file or folder
    #[arg(long, value_name = "PATH")]
    tasks: Option<PathBuf>,
    #[command(flatten)]
    scene: inputs::SceneArguments,
    /// Episodes or recordings at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print one JSON object per episode
    #[arg(long)]
    json: bool,
}

/// Imports episodes of the REAL framework or recordings of a robot as traces.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match &arguments.command {
        Command::RealEval {
            folder,
            run,
            importing,
        } => {
            let episodes = reel_import::episodes(folder)?;
            let (results, broken) = importing.each(&episodes, run, reel_import::import)?;
            for (episode, result) in episodes.iter().zip(&results) {
                tell(episode, result, importing.json)?;
            }
            Ok(answer(&results, broken, &importing.out, importing.json))
        }
        Command::Robot {
            recordings,
            mapping,
            run,
            importing,
        } => robot(recordings, mapping, run, importing),
        Command::Atif {
            documents,
            run,
            importing,
        } => {
            let documents = reel_import::atif::documents(documents)?;
            documents_of_many(&documents, run, importing, reel_import::atif::import)
        }
        Command::Inspect {
            logs,
            run,
            success,
            importing,
        } => {
            let logs = reel_import::inspect::logs(logs)?;
            let one = |log: &Path, out: &Path, options: &ImportOptions<'_>| {
                reel_import::inspect::import(log, out, options, success.as_ref())
            };
            documents_of_many(&logs, run, importing, one)
        }
        Command::Otel {
            spans,
            run,
            success,
            task_attribute,
            importing,
        } => otel(
            spans,
            run,
            success.as_ref(),
            task_attribute.as_deref(),
            importing,
        ),
    }
}

/// Imports spans, of which several files may hold one episode.
fn otel(
    root: &Path,
    run: &str,
    success: Option<&SuccessRule>,
    task_attribute: Option<&str>,
    importing: &Importing,
) -> anyhow::Result<ExitStatus> {
    let files = reel_import::otel::documents(root)?;
    let read = reel_import::otel::read(&files)?;
    let one = |told: &SpanEpisode, out: &Path, options: &ImportOptions<'_>| {
        reel_import::otel::import(told, out, options, success, task_attribute)
    };
    let (results, broken) = importing.each_of(&read.episodes, run, one)?;
    for (told, result) in read.episodes.iter().zip(&results) {
        tell(&told.source, result, importing.json)?;
    }
    read.losses
        .iter()
        .for_each(|loss| eprintln!("reel: {loss}"));
    if importing.json && !read.losses.is_empty() {
        println!("{}", json!({ "losses": read.losses }));
    }
    if read.without_agent > 0 {
        eprintln!(
            "reel: {} traces have no span of an agent and are no episodes",
            read.without_agent
        );
    }
    let lost = broken + read.losses.len();
    let answer = answer(&results, lost, &importing.out, importing.json);
    Ok(match answer {
        ExitStatus::Success if results.is_empty() => ExitStatus::BadInput,
        answer => answer,
    })
}

/// Imports documents of which each may hold several episodes.
fn documents_of_many(
    documents: &[PathBuf],
    run: &str,
    importing: &Importing,
    one: impl Fn(
        &Path,
        &Path,
        &ImportOptions<'_>,
    ) -> Result<Vec<Result<ImportedEpisode, ImportError>>, ImportError>
    + Sync,
) -> anyhow::Result<ExitStatus> {
    let (results, broken) = importing.each(documents, run, one)?;
    let mut episodes = Vec::new();
    for (document, result) in documents.iter().zip(results) {
        for episode in result.unwrap_or_else(|error| vec![Err(error)]) {
            tell(document, &episode, importing.json)?;
            episodes.push(episode);
        }
    }
    Ok(answer(&episodes, broken, &importing.out, importing.json))
}

fn robot(
    root: &Path,
    mapping: &Path,
    run: &str,
    importing: &Importing,
) -> anyhow::Result<ExitStatus> {
    let text = fs::read_to_string(mapping)
        .with_context(|| format!("cannot read the mapping {}", mapping.display()))?;
    let mapping = Mapping::parse(&text)
        .with_context(|| format!("the mapping {} is not understood", mapping.display()))?;
    let recordings = reel_import::robot::recordings(root)?;
    let one = |recording: &Path, out: &Path, options: &ImportOptions<'_>| {
        reel_import::robot::import(recording, &mapping, out, options)
    };
    let (results, broken) = importing.each(&recordings, run, one)?;
    let (mut episodes, mut incomplete) = (Vec::new(), broken);
    for (source, result) in recordings.iter().zip(results) {
        match result {
            Ok(recording) => {
                incomplete += usize::from(!recording.losses.is_empty());
                tell_recording(&recording, importing.json);
                for imported in recording.episodes {
                    let imported = Ok(imported);
                    tell(source, &imported, importing.json)?;
                    episodes.push(imported);
                }
            }
            Err(error) => {
                let error = Err(error);
                tell(source, &error, importing.json)?;
                episodes.push(error);
            }
        }
    }
    Ok(answer(
        &episodes,
        incomplete,
        &importing.out,
        importing.json,
    ))
}

/// What a recording as a whole lost and leaves open, where that is anything.
fn tell_recording(recording: &Recording, as_json: bool) {
    let Recording {
        source,
        losses,
        notes,
        ..
    } = recording;
    match as_json {
        true if losses.is_empty() && notes.is_empty() => {}
        true => println!(
            "{}",
            json!({ "recording": source, "losses": losses, "notes": notes })
        ),
        false => notes
            .iter()
            .for_each(|note| println!("{}: note: {note}", source.display())),
    }
    losses.iter().for_each(|loss| eprintln!("reel: {loss}"));
}

impl Importing {
    /// Imports each of the files, several at a time; and how many of the task files are broken.
    fn each<T: Send>(
        &self,
        sources: &[PathBuf],
        run_id: &str,
        import: impl Fn(&Path, &Path, &ImportOptions<'_>) -> T + Sync,
    ) -> anyhow::Result<(Vec<T>, usize)> {
        let one = |source: &PathBuf, out: &Path, options: &ImportOptions<'_>| {
            import(source, out, options)
        };
        self.each_of(sources, run_id, one)
    }

    /// As [`Importing::each`], of sources that are no files.
    fn each_of<S: Sync, T: Send>(
        &self,
        sources: &[S],
        run_id: &str,
        import: impl Fn(&S, &Path, &ImportOptions<'_>) -> T + Sync,
    ) -> anyhow::Result<(Vec<T>, usize)> {
        let Importing {
            out,
            tasks,
            scene,
            jobs,
            ..
        } = self;
        let (tasks, scenes, broken) = match tasks {
            Some(path) => {
                let inputs::Tasks {
                    tasks,
                    scenes,
                    broken,
                } = inputs::tasks(path, scene, ObjectOrder::AsWritten)?;
                (tasks, Some(scenes), broken)
            }
            None => (Vec::new(), scene.fixed()?.map(Scenes::from), 0),
        };
        fs::create_dir_all(out)
            .with_context(|| format!("cannot make the folder {}", out.display()))?;
        let options = ImportOptions {
            run_id,
            tasks: &tasks,
            scenes: scenes.as_ref(),
        };
        let bar = progress::bar(sources.len(), "import");
        let one = |source: &S| {
            let imported = import(source, out, &options);
            bar.inc(1);
            imported
        };
        let pool = inputs::pool(*jobs)?;
        let results = pool.install(|| sources.par_iter().with_max_len(1).map(one).collect());
        bar.finish_and_clear();
        Ok((results, broken))
    }
}

fn tell(
    episode: &Path,
    result: &Result<ImportedEpisode, ImportError>,
    as_json: bool,
) -> anyhow::Result<()> {
    match result {
        Ok(imported) if as_json => println!("{}", serde_json::to_string(imported)?),
        Ok(imported) => {
            let ImportedEpisode { steps, images, .. } = imported;
            let end = format!("{:?}", imported.end).to_lowercase();
            let success = match imported.success {
                Some(true) => "success",
                Some(false) => "no success",
                None => "not judged",
            };
            println!(
                "{}: {steps} steps, {images} images, {end}, {success}",
                imported.trace.display()
            );
            imported
                .notes
                .iter()
                .for_each(|note| println!("  note: {note}"));
        }
        Err(error) if as_json => println!(
            "{}",
            json!({ "source": episode, "error": error.to_string() })
        ),
        Err(_) => {}
    }
    match result {
        Ok(imported) => imported
            .losses
            .iter()
            .for_each(|loss| eprintln!("reel: {loss}")),
        Err(error) => eprintln!("reel: not imported: {error}"),
    }
    Ok(())
}

/// Sums up; episodes that the agent skipped are no loss, what was lost beside the episodes is.
fn answer(
    results: &[Result<ImportedEpisode, ImportError>],
    lost_beside: usize,
    out: &Path,
    as_json: bool,
) -> ExitStatus {
    let imported: Vec<&ImportedEpisode> = results
        .iter()
        .filter_map(|result| result.as_ref().ok())
        .collect();
    let skipped = results
        .iter()
        .filter(|result| matches!(result, Err(ImportError::Skipped { .. })))
        .count();
    let failed = results.len() - imported.len() - skipped;
    let incomplete = imported
        .iter()
        .filter(|imported| !imported.losses.is_empty())
        .count();
    if !as_json {
        println!(
            "{} of {} episodes imported into {}: {incomplete} of them with losses, {failed} not imported, {skipped} skipped by the agent",
            imported.len(),
            results.len(),
            out.display()
        );
    }
    match (imported.len(), failed + incomplete + lost_beside) {
        (_, 0) => ExitStatus::Success,
        (0, _) => ExitStatus::BadInput,
        _ => ExitStatus::Partial,
    }
}
