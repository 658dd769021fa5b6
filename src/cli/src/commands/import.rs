//! `reel import`: what other frameworks recorded, as traces.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use rayon::prelude::*;
use reel_import::{ImportError, Imported, Options};
use reel_tasks::Listed;
use serde_json::json;

use crate::{Answer, inputs, progress};

/// Turn what other frameworks recorded into traces.
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
    /// Every folder <scene>/<task>/<model> becomes one trace: calls, outcomes, pictures, world
    /// graphs, markers, the held object, answers of the user, what the model said and how long it
    /// took; rewards and metrics by Reel's rules. The traces can be shown, scored and asked in SQL
    /// like any other, but there is nothing to re-execute, and `reel replay` says so. The files
    /// hold no sizes and captions; with --tasks the benchmark's own files give them, and the
    /// reward for asking becomes exact.
    ///
    /// A torn file is named and the steps before it are imported. Importing again gives the same
    /// bytes.
    ///
    /// Examples:
    ///   reel import real-eval eval_output --out traces
    ///   reel import real-eval eval_output --out traces --tasks real-bench/tasks
    ///   reel show traces/FDO_verify_task_9--gpt-4o--0123456789abcdef.mcap
    ///
    /// Exit code 0: all imported; 2: nothing could be; 3: imported, but something was lost or left out.
    RealEval {
        /// The `eval_output` folder, or any folder in it
        #[arg(value_name = "DIR")]
        folder: PathBuf,
        /// Folder for the traces; made if it is not there
        #[arg(long, value_name = "TRACES", default_value = "traces-out")]
        out: PathBuf,
        /// The benchmark's task files: file or folder
        #[arg(long, value_name = "PATH")]
        tasks: Option<PathBuf>,
        /// Their scene; without it `s7_scene.json` beside the tasks
        #[arg(long, value_name = "FILE")]
        scene: Option<PathBuf>,
        /// Name of the run that the traces belong to
        #[arg(long, value_name = "NAME", default_value = "real-eval")]
        run: String,
        /// Episodes at a time; without it one for each core
        #[arg(long, value_name = "N")]
        jobs: Option<usize>,
        /// Print one JSON object an episode
        #[arg(long)]
        json: bool,
    },
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<Answer> {
    let Command::RealEval { folder, out, tasks, scene, run, jobs, json } = &arguments.command;
    let episodes = reel_import::episodes(folder)?;
    let beside = tasks.as_deref().and_then(Path::parent).map(|folder| folder.join("s7_scene.json")).filter(|file| file.exists());
    let scene = match scene.clone().or(beside) {
        Some(file) => Some(inputs::scene(Some(&file))?),
        None if tasks.is_some() => bail!("the task files need their scene; give it with --scene"),
        None => None,
    };
    let (tasks, broken) = match (tasks, &scene) {
        (Some(path), Some(scene)) => inputs::tasks(path, scene, Listed::AsWritten)?,
        _ => (Vec::new(), 0),
    };
    fs::create_dir_all(out).with_context(|| format!("cannot make the folder {}", out.display()))?;
    let options = Options { run_id: run, tasks: &tasks, scene: scene.as_deref() };
    let bar = progress::bar(episodes.len(), "import");
    let one = |episode: &PathBuf| {
        let imported = reel_import::import(episode, out, &options);
        bar.inc(1);
        imported
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(inputs::workers(*jobs)).build()?;
    let results: Vec<_> = pool.install(|| episodes.par_iter().with_max_len(1).map(one).collect());
    bar.finish_and_clear();
    for (episode, result) in episodes.iter().zip(&results) {
        tell(episode, result, *json)?;
    }
    Ok(answer(&results, broken, out, *json))
}

fn tell(episode: &Path, result: &Result<Imported, ImportError>, as_json: bool) -> anyhow::Result<()> {
    match result {
        Ok(imported) if as_json => println!("{}", serde_json::to_string(imported)?),
        Ok(imported) => {
            let Imported { steps, pictures, .. } = imported;
            let end = format!("{:?}", imported.end).to_lowercase();
            let success = if imported.success { "success" } else { "no success" };
            println!("{}: {steps} steps, {pictures} pictures, {end}, {success}", imported.trace.display());
            imported.notes.iter().for_each(|note| println!("  note: {note}"));
        }
        Err(error) if as_json => println!("{}", json!({ "source": episode, "error": error.to_string() })),
        Err(_) => {}
    }
    match result {
        Ok(imported) => imported.losses.iter().for_each(|loss| eprintln!("reel: {loss}")),
        Err(error) => eprintln!("reel: not imported: {error}"),
    }
    Ok(())
}

/// Sums up; episodes that the agent skipped are no loss.
fn answer(results: &[Result<Imported, ImportError>], broken_tasks: usize, out: &Path, as_json: bool) -> Answer {
    let imported: Vec<&Imported> = results.iter().filter_map(|result| result.as_ref().ok()).collect();
    let skipped = results.iter().filter(|result| matches!(result, Err(ImportError::Skipped { .. }))).count();
    let failed = results.len() - imported.len() - skipped;
    let incomplete = imported.iter().filter(|imported| !imported.losses.is_empty()).count();
    if !as_json {
        println!(
            "{} of {} episodes imported into {}: {incomplete} of them with losses, {failed} not imported, {skipped} skipped by the agent",
            imported.len(),
            results.len(),
            out.display()
        );
    }
    match (imported.len(), failed + incomplete + broken_tasks) {
        (_, 0) => Answer::Yes,
        (0, _) => Answer::BadInput,
        _ => Answer::Loss,
    }
}
