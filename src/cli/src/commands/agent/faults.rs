//! `reel agent faults`: episodes that fail in a known way, to find out how often the
//! failure taxonomy is right.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context, bail};
use rayon::prelude::*;
use reel_agents::{
    EpisodeReport, FaultKind, Injection, Label, RecordTo, SampleOptions, cluttered, paper_mix,
    run_injected, sample,
};
use reel_episode::EpisodeConfig;
use reel_reward::Preset;
use reel_tasks::ObjectOrder;
use reel_trace::{Durability, Images, RecordOptions};
use reel_world::{FailureClass, Profile, Scene, Scenes, Skills, Task, record::PolicyInfo};
use serde_json::json;

use crate::{ExitStatus, inputs, progress};

/// Play tasks with a policy into whose decisions faults are injected, and record every episode as a
/// trace, with its label in a file `<trace>.label.json` beside it. Ingest does not read the labels;
/// `reel store label import` does.
///
/// Examples:
///   reel agent faults list
///   reel agent faults run --tasks tasks --episodes 200 --out faulty
///   reel agent faults run --tasks tasks --episodes 100 --paper --out paper
///   reel ingest faulty --store store && reel taxonomy --store store
///   reel store label import faulty --store store && reel taxonomy agreement --store store --reference injected
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    what: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// The kinds of fault, with their classes
    List {
        /// Print one JSON object per fault kind
        #[arg(long)]
        json: bool,
    },
    /// Play episodes with injected faults and label them
    Run(Run),
}

#[derive(clap::Args)]
struct Run {
    /// Task file (REAL-Bench YAML) or folder of them
    #[arg(long, value_name = "PATH")]
    tasks: PathBuf,
    #[command(flatten)]
    scene: inputs::SceneArguments,
    /// Folder for the traces and labels
    #[arg(long, value_name = "DIR", default_value = "faulty")]
    out: PathBuf,
    /// Number of episodes, spread over the tasks
    #[arg(
        long = "episodes",
        alias = "count",
        value_name = "N",
        default_value_t = 100
    )]
    count: u64,
    /// Seed of the first episode; each further one has the next
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Fault kinds to inject; without it all of them
    #[arg(long, value_name = "KIND", value_delimiter = ',')]
    kinds: Vec<String>,
    /// Share of episodes with two faults
    #[arg(
        long = "double-share",
        alias = "combinations",
        value_name = "SHARE",
        default_value_t = 0.0
    )]
    combinations: f64,
    /// Share of faults that the agent corrects itself
    #[arg(
        long = "repaired-share",
        alias = "repaired",
        value_name = "SHARE",
        default_value_t = 0.0
    )]
    repaired: f64,
    /// Share of episodes with harmless detours
    #[arg(
        long = "detour-share",
        alias = "detours",
        value_name = "SHARE",
        default_value_t = 0.33
    )]
    detours: f64,
    /// A hundred episodes in the proportions of the paper's analysis: 47 successes, 25 Object
    /// Confusion, 17 Key Action Missing, 9 Lost Memory, 2 Other; --count times a hundredth
    #[arg(long, conflicts_with = "kinds")]
    paper: bool,
    /// Record the images, too
    #[arg(long)]
    images: bool,
    /// Episodes at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print JSON, one line an episode
    #[arg(long)]
    json: bool,
}

/// Seeds between the tries of one episode: no other episode has them.
const TRY: u64 = 1 << 32;
/// Tries for an episode of the paper's mix: a fault may not fit a task, or not cost the success.
const TRIES_MAX: u64 = 60;

/// Lists the fault kinds, or plays and labels episodes with injected faults.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match &arguments.what {
        Command::List { json } => {
            for kind in FaultKind::ALL {
                if *json {
                    println!(
                        "{}",
                        json!({ "kind": kind, "class": kind.class(), "sub_class": kind.sub_class(), "says": kind.description() })
                    );
                } else {
                    println!(
                        "{:20} {:20} {}",
                        kind.name(),
                        kind.class().as_str(),
                        kind.description()
                    );
                }
            }
            Ok(ExitStatus::Success)
        }
        Command::Run(run) => play(run),
    }
}

fn play(run: &Run) -> anyhow::Result<ExitStatus> {
    let known = |name: &String| {
        FaultKind::ALL
            .iter()
            .copied()
            .find(|kind| kind.name() == name)
            .with_context(|| format!("no fault is called '{name}'; see `reel agent faults list`"))
    };
    let mut kinds = run.kinds.iter().map(known).collect::<Result<Vec<_>, _>>()?;
    if kinds.is_empty() {
        kinds = FaultKind::ALL.to_vec();
    }
    for (name, share) in [
        ("--double-share", run.combinations),
        ("--repaired-share", run.repaired),
        ("--detour-share", run.detours),
    ] {
        if !(0.0..=1.0).contains(&share) {
            bail!("{name} is a share: give a number from 0 to 1");
        }
    }
    let inputs::Tasks {
        tasks,
        scenes,
        broken,
    } = inputs::tasks(&run.tasks, &run.scene, ObjectOrder::AsWritten)?;
    fs::create_dir_all(&run.out)
        .with_context(|| format!("cannot make the folder {}", run.out.display()))?;
    let wanted: Vec<ExpectedOutcome> = match run.paper {
        true => (0..run.count)
            .map(|number| {
                paper_mix()[(number % 100) as usize]
                    .map_or(ExpectedOutcome::Success, ExpectedOutcome::Class)
            })
            .collect(),
        false => vec![ExpectedOutcome::Any; run.count as usize],
    };
    let maker = CorpusWriter {
        run,
        scenes,
        tasks,
        kinds,
    };
    let bar = progress::bar(wanted.len(), "faults");
    let pool = inputs::pool(run.jobs)?;
    let results: Vec<anyhow::Result<Option<(EpisodeReport, Label)>>> = pool.install(|| {
        let episode = |(number, wanted): (usize, &ExpectedOutcome)| {
            let made = maker.episode(number as u64, *wanted);
            bar.inc(1);
            made
        };
        wanted.par_iter().enumerate().map(episode).collect()
    });
    bar.finish_and_clear();
    let mut counts: BTreeMap<String, u64> = BTreeMap::new();
    let mut answer = if broken > 0 {
        ExitStatus::Partial
    } else {
        ExitStatus::Success
    };
    for result in results {
        match result {
            Ok(Some((report, label))) => {
                let primary = label.primary.as_ref();
                let name = primary.map_or("no failure".to_owned(), |primary| {
                    format!("{} / {}", primary.class, primary.sub_class)
                });
                *counts.entry(name).or_default() += 1;
                if run.json {
                    println!(
                        "{}",
                        json!({ "episode_id": report.episode_id, "trace": report.trace, "success": report.success, "label": label })
                    );
                }
            }
            Ok(None) => *counts.entry("no task admits it".into()).or_default() += 1,
            Err(error) => {
                answer = ExitStatus::CheckFailed;
                eprintln!("reel: {error:#}");
            }
        }
    }
    if !run.json {
        counts
            .iter()
            .for_each(|(name, count)| println!("{count:6}  {name}"));
        println!("traces and labels: {}", run.out.display());
    }
    Ok(answer)
}

/// What an episode shall come to.
#[derive(Clone, Copy)]
enum ExpectedOutcome {
    Any,
    Success,
    Class(FailureClass),
}

struct CorpusWriter<'a> {
    run: &'a Run,
    scenes: Scenes,
    tasks: Vec<Arc<Task>>,
    kinds: Vec<FaultKind>,
}

impl CorpusWriter<'_> {
    /// Plays one episode; none where no task admits what is wanted.
    fn episode(
        &self,
        number: u64,
        wanted: ExpectedOutcome,
    ) -> anyhow::Result<Option<(EpisodeReport, Label)>> {
        let mut last = None;
        for attempt in 0..TRIES_MAX {
            let seed = self.run.seed + number + attempt * TRY;
            // consecutive episodes play tasks that lie far apart in their folder: of other families
            let spread = (number + attempt).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32;
            let task = &self.tasks[(spread % self.tasks.len() as u64) as usize];
            // something of another kind has to stand about, to be taken for the target
            let scene = self.scene(task);
            let task =
                cluttered(task, scene, &self.tasks, seed).map_or_else(|| task.clone(), Arc::new);
            let kinds = match wanted {
                ExpectedOutcome::Class(class) => FaultKind::of_class(class),
                ExpectedOutcome::Any | ExpectedOutcome::Success => self.kinds.clone(),
            };
            let options = SampleOptions {
                combinations: self.run.combinations,
                repaired: self.run.repaired,
                detours: self.run.detours,
                kinds: &kinds,
            };
            let drawn = sample(&task, scene, seed, &options);
            let injection = match wanted {
                ExpectedOutcome::Success => Some(Injection {
                    faults: vec![],
                    detours: drawn.map(|drawn| drawn.detours).unwrap_or_default(),
                    seed,
                }),
                ExpectedOutcome::Any | ExpectedOutcome::Class(_) => drawn,
            };
            let Some(injection) = injection else { continue };
            let path = self.run.out.join(format!(
                "{}--injected--{seed}.mcap",
                task.task_id.replace(['/', '\\'], "_")
            ));
            let (report, label) = self.record(task, &injection, &path)?;
            let as_wanted = match wanted {
                ExpectedOutcome::Any => true,
                ExpectedOutcome::Success => report.success,
                ExpectedOutcome::Class(class) => label
                    .primary
                    .as_ref()
                    .is_some_and(|primary| primary.class == class),
            };
            if as_wanted {
                return Ok(Some((report, label)));
            }
            for file in [path.clone(), path.with_added_extension("label.json")] {
                fs::remove_file(&file)
                    .with_context(|| format!("cannot remove {}", file.display()))?;
            }
            last = Some(report.task_id);
        }
        match last {
            Some(task) => bail!(
                "{TRIES_MAX} episodes came out otherwise than wanted; the last one played {task}"
            ),
            None => Ok(None),
        }
    }

    fn scene(&self, task: &Task) -> &Arc<Scene> {
        self.scenes
            .of(task)
            .expect("tasks are loaded with their scenes")
    }

    fn record(
        &self,
        task: Arc<Task>,
        injection: &Injection,
        path: &Path,
    ) -> anyhow::Result<(EpisodeReport, Label)> {
        let images = if self.run.images {
            Images::Full
        } else {
            Images::None
        };
        let config = EpisodeConfig {
            scene: self.scene(&task).clone(),
            task,
            seed: injection.seed,
            profile: Profile::Paper,
            skills: Skills::Perfect,
            meshes: reel_world::Meshes::default(),
            preset: Preset::paper(),
            run_id: format!("faults-{}", self.run.seed),
            policy: PolicyInfo::default(),
            rollout: None,
            parent: None,
        };
        let options = RecordOptions {
            images,
            durability: Durability::Write,
            ..RecordOptions::default()
        };
        Ok(run_injected(
            config,
            injection,
            Some(&RecordTo {
                path: path.to_owned(),
                options,
            }),
        )?)
    }
}
