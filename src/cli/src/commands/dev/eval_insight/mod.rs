//! `reel dev eval-insight`: perturbed episodes whose truth comes from counterfactual play, and how
//! often the taxonomy and blame name it. Never how either of them decides.

mod score;

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::Context;
use rayon::prelude::*;
use reel_agents::{
    RecordTo, cluttered,
    perturb::{Split, sample_perturbation},
};
use reel_counterfactual::{
    blame::blame,
    truth::{EpisodeTruth, Label, play_perturbed},
};
use reel_episode::EpisodeConfig;
use reel_reward::Preset;
use reel_tasks::{DrawOptions, draw};
use reel_trace::{Durability, Images, RecordOptions, Trace};
use reel_world::{Family, Meshes, Profile, Scene, Skills, Task, record::PolicyInfo};
use serde::{Deserialize, Serialize};

use crate::{ExitStatus, inputs, progress};

/// Measure taxonomy and blame on perturbed competent play. The truth of every episode is fixed
/// before Reel's answer is computed: operators are switched off one by one, and the oracle takes
/// over at every call. The two halves share no operator, task or seed.
///
/// Examples:
///   reel dev eval-insight --split development --episodes 300 --seed 1 --out insight --examples 20
///   reel dev eval-insight --split report --episodes 1000 --seed 1 --out insight --json
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Half of the operators, tasks and seeds: development or report
    #[arg(long, value_parser = ["development", "report"])]
    split: String,
    /// Number of episodes to play
    #[arg(long, value_name = "N", default_value_t = 200)]
    episodes: u64,
    /// Seed of tasks and perturbations
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Folder for traces, store and truth.json
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Classes from elsewhere, as `reel taxonomy --json` prints them, instead of this build's
    #[arg(long, value_name = "FILE")]
    classes: Option<PathBuf>,
    /// List so many wrong answers; only of the development half
    #[arg(long, value_name = "N", default_value_t = 0)]
    examples: usize,
    /// Episodes at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print the figures as one JSON object
    #[arg(long)]
    json: bool,
}

/// Tasks that are drawn for a half.
const TASKS: usize = 200;

/// One episode: its truth, its trace, and what blame says.
#[derive(Serialize)]
struct Played {
    trace: PathBuf,
    #[serde(flatten)]
    truth: EpisodeTruth,
    steps: u32,
    first_error: Option<u32>,
}

/// What Reel says of an episode.
#[derive(Clone, Default)]
struct ReelAnswer {
    label: Option<Label>,
    decisive: Option<u32>,
}

#[derive(Deserialize)]
struct ClassLine {
    episode_id: String,
    class: String,
    sub_class: String,
}

/// Plays, finds the truth, asks Reel, and prints how often it is right.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let split = if arguments.split == "report" {
        Split::Report
    } else {
        Split::Development
    };
    if split == Split::Report && arguments.examples > 0 {
        anyhow::bail!("--examples lists wrong answers of the development half only");
    }
    let traces = arguments.out.join("traces");
    fs::create_dir_all(&traces)
        .with_context(|| format!("cannot make the folder {}", traces.display()))?;
    let played = play(arguments, split, &traces)?;
    fs::write(
        arguments.out.join("truth.json"),
        serde_json::to_string_pretty(&played)? + "\n",
    )?;
    let mut answers = classes(arguments, &played)?;
    for one in &played {
        let decisive = blame(&Trace::read(&one.trace)?).decisive;
        answers
            .entry(one.truth.episode_id.clone())
            .or_default()
            .decisive = decisive.map(|decisive| decisive.step);
    }
    let figures = score::Figures::new(&played, &answers);
    if arguments.json {
        println!("{}", serde_json::to_string(&figures)?);
    } else {
        print!("{}", figures.text());
        score::print_examples(&played, &answers, arguments.examples);
    }
    Ok(ExitStatus::Success)
}

fn play(arguments: &Arguments, split: Split, traces: &Path) -> anyhow::Result<Vec<Played>> {
    let scene = inputs::scene(None)?;
    // The halves draw their tasks from seeds that no seed on the command line can make equal.
    let half = u64::from(split == Split::Report);
    let seed = (arguments.seed << 1) | half;
    let options = DrawOptions {
        scene: &scene,
        families: &Family::ALL,
        count: TASKS,
        seed,
    };
    let tasks: Vec<Arc<Task>> = draw(&options).tasks.into_iter().map(Arc::new).collect();
    let bar = progress::bar(arguments.episodes as usize, "perturbed");
    let pool = inputs::pool(arguments.jobs)?;
    let episode = |number: u64| {
        let seed = (((arguments.seed << 24) + number) << 1) | half;
        let spread = number.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32;
        let task = &tasks[(spread % tasks.len() as u64) as usize];
        let task = cluttered(task, &scene, &tasks, seed).map_or_else(|| task.clone(), Arc::new);
        let played = one_episode(&task, &scene, split, seed, traces);
        bar.inc(1);
        played
    };
    let played: Vec<anyhow::Result<Option<Played>>> = pool.install(|| {
        (0..arguments.episodes)
            .into_par_iter()
            .map(episode)
            .collect()
    });
    bar.finish_and_clear();
    played.into_iter().filter_map(Result::transpose).collect()
}

fn one_episode(
    task: &Arc<Task>,
    scene: &Arc<Scene>,
    split: Split,
    seed: u64,
    traces: &Path,
) -> anyhow::Result<Option<Played>> {
    let perturbation = sample_perturbation(task, split, seed);
    let config = EpisodeConfig {
        scene: scene.clone(),
        task: task.clone(),
        seed,
        profile: Profile::Paper,
        skills: Skills::Perfect,
        meshes: Meshes::default(),
        preset: Preset::paper(),
        run_id: format!("insight-{}", split.name()),
        policy: PolicyInfo::default(),
        rollout: None,
        parent: None,
    };
    let path = traces.join(format!(
        "{}--{seed}.mcap",
        task.task_id.replace(['/', '\\'], "_")
    ));
    let options = RecordOptions {
        images: Images::None,
        durability: Durability::Write,
        ..RecordOptions::default()
    };
    let record = RecordTo {
        path: path.clone(),
        options,
    };
    let Some(truth) = play_perturbed(&config, &perturbation, &record)? else {
        fs::remove_file(&path)?;
        return Ok(None);
    };
    let trace = Trace::read(&path)?;
    let error = trace.steps.iter().find(|step| step.outcome.error.is_some());
    Ok(Some(Played {
        truth,
        steps: trace.steps.len() as u32,
        first_error: error.map(|step| step.step),
        trace: path,
    }))
}

/// What the taxonomy says, by episode.
fn classes(
    arguments: &Arguments,
    played: &[Played],
) -> anyhow::Result<BTreeMap<String, ReelAnswer>> {
    let lines = match &arguments.classes {
        Some(file) => {
            fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?
        }
        None => classify(arguments, played)?,
    };
    let answer = |line: &str| -> anyhow::Result<(String, ReelAnswer)> {
        let ClassLine {
            episode_id,
            class,
            sub_class,
        } = serde_json::from_str(line)?;
        let label = Some(Label { class, sub_class });
        Ok((
            episode_id,
            ReelAnswer {
                label,
                decisive: None,
            },
        ))
    };
    lines.lines().map(answer).collect()
}

/// Ingests the traces into a store, measures the failures and asks the rules, as `reel ingest`,
/// `reel blame --store` and `reel taxonomy` do.
#[cfg(feature = "analytics")]
fn classify(arguments: &Arguments, played: &[Played]) -> anyhow::Result<String> {
    let location = arguments.out.join("store").display().to_string();
    let paths: Vec<PathBuf> = played.iter().map(|one| one.trace.clone()).collect();
    let files = reel_trace::TraceFiles::default();
    let here = crate::cluster_arguments::ClusterArguments::default();
    crate::commands::ingest::ingest(&files, &paths, &location, &here)?;
    crate::commands::blame::measure(&location)?;
    let store = reel_tables::Store::open(&location)?;
    let session = crate::cluster_arguments::ClusterArguments::default()
        .session(store, reel_query::Limits::default())?;
    let verdicts = reel_taxonomy::classify(&session, &reel_taxonomy::RuleSet::built_in(), None)?;
    let lines: Result<Vec<String>, _> = verdicts
        .classes()
        .map(|class| serde_json::to_string(&class))
        .collect();
    Ok(lines?.join("\n"))
}

#[cfg(not(feature = "analytics"))]
fn classify(_: &Arguments, _: &[Played]) -> anyhow::Result<String> {
    eprintln!("reel: this build has no taxonomy; give --classes FILE to score classes");
    Ok(String::new())
}
