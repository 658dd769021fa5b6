//! `reel bench`: how good an agent is, in the form of the paper's tables.

mod budget;
mod comparison;
mod table;

use std::{
    fs,
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use anyhow::{Context, bail};
use reel_agents::{AgentError, EpisodeJob, EpisodeReport, Participants, RecordTo, run_all};
use reel_episode::EpisodeConfig;
use reel_reward::Preset;
use reel_sim::sim_version;
use reel_tasks::ObjectOrder;
use reel_trace::{Durability, FrameLayers, Images, RecordOptions, Trace};
use reel_world::{
    Digest, Family, Profile, Skills, Task,
    record::{EndReason, PolicyInfo},
};
use serde_json::json;

use crate::{
    ExitStatus,
    agent_arguments::{AgentArguments, AgentSet},
    commands::run::remove_abandoned,
    inputs,
    otlp::OtlpArguments,
    progress,
};
use budget::Budget;
use comparison::compare;
use table::{rows, table};

/// Episodes at a time where models are asked: they wait for the endpoint most of the time.
const JOBS_WITH_MODELS: usize = 8;

/// Benchmark an agent on tasks: success (with Wilson's 95 % interval), completion, SPL, steps,
/// questions, reward, latency and tokens by family, as in the paper's main table. Every episode is
/// recorded with the answers of its models, so that replay needs none. The same command resumes
/// after an interruption. The speed of Reel itself is measured by `reel dev perf`.
///
/// Examples:
///   reel bench --tasks tasks --agent planner --out bench/planner
///   reel bench --tasks tasks --agent real-agent --endpoint http://localhost:8000/v1 --model qwen3-vl --repeat 3 --out bench/qwen
///   reel bench --tasks tasks --agent function-calling --endpoint https://api.example/v1 --model m --api-key-env API_KEY
///     --user-model m --prices 0.5,1.5 --max-cost 20 --out bench/m
///   reel bench --tasks tasks --agent real-agent --endpoint http://localhost:8000/v1 --model student --logprobs --out bench/old
///   reel bench --compare bench/planner bench/qwen     # the same tasks and seeds, paired
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Task file (REAL-Bench YAML) or folder of them
    #[arg(long, value_name = "PATH", required_unless_present = "compare")]
    tasks: Option<PathBuf>,
    /// Compare the episodes of two folders instead of playing
    #[arg(long, num_args = 2, value_names = ["A", "B"], conflicts_with = "tasks")]
    compare: Option<Vec<PathBuf>>,
    #[command(flatten)]
    scene: inputs::SceneArguments,
    #[command(flatten)]
    players: AgentArguments,
    /// Episodes of every task, each with a seed of its own
    #[arg(long, value_name = "N", default_value_t = 1)]
    repeat: u64,
    /// Seed of the first episode of every task
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Folder for the traces
    #[arg(long, value_name = "DIR", default_value = "bench-out")]
    out: PathBuf,
    /// Name of the run, which is part of the identity of its episodes: runs of one model before and
    /// after a fine-tune need two names. Without it the name of the folder OUT
    #[arg(long = "run", value_name = "NAME")]
    run_name: Option<String>,
    /// Episodes at a time; without it one for each core, 8 where models are asked
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// How the environment behaves where the paper and the published code differ: paper, real-repo
    /// (the published evaluation server) or real-gspo (the published training server)
    #[arg(long, value_name = "NAME", default_value = "paper")]
    profile: String,
    /// How reliable the robot's skills are: perfect, or real-v1 as on the paper's robot
    #[arg(long, value_name = "NAME", default_value = "perfect", value_parser = inputs::skills)]
    skills: Skills,
    /// Record no images; replay renders them again
    #[arg(long)]
    no_images: bool,
    /// Record of each frame besides: depth (16-bit millimetres), masks (instance ids), or both with a
    /// comma between
    #[arg(long, value_name = "LAYERS", default_value = "", hide_default_value = true, value_parser = inputs::layers)]
    record: FrameLayers,
    /// Start no further episode after this many input and output tokens
    #[arg(long, value_name = "N")]
    max_total_tokens: Option<u64>,
    /// Start no further episode above this cost; needs --prices
    #[arg(long, value_name = "COST", requires = "prices")]
    max_cost: Option<f64>,
    /// Start no further episode after this many minutes
    #[arg(long, value_name = "MINUTES")]
    max_minutes: Option<f64>,
    /// Prices of a million input and output tokens, in any currency
    #[arg(long, value_name = "INPUT,OUTPUT", value_delimiter = ',', num_args = 1)]
    prices: Option<Vec<f64>>,
    #[command(flatten)]
    otlp: OtlpArguments,
    /// Print the result table as one JSON object
    #[arg(long)]
    json: bool,
}

impl Arguments {
    /// Of a million tokens read and written; none where they are not two.
    fn prices(&self) -> Option<[f64; 2]> {
        self.prices.as_deref()?.try_into().ok()
    }
}

/// Benchmarks an agent on tasks, or compares the episodes of two folders.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match arguments.compare.as_deref() {
        Some([a, b]) => compare(a, b, arguments.json),
        _ => play(arguments),
    }
}

impl Arguments {
    /// Name of the run: the one given, or that of the folder.
    fn run_name(&self) -> anyhow::Result<String> {
        if let Some(name) = &self.run_name {
            return Ok(name.clone());
        }
        let folder = fs::canonicalize(&self.out)?;
        Ok(folder.file_name().map_or_else(
            || "bench".into(),
            |name| name.to_string_lossy().into_owned(),
        ))
    }
}

fn play(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let profile = Profile::parse(&arguments.profile).with_context(|| {
        format!(
            "no profile is called '{}'; there are paper, real-repo and real-gspo",
            arguments.profile
        )
    })?;
    if arguments.prices.is_some() && arguments.prices().is_none() {
        bail!("--prices takes two numbers, of a million input and output tokens, like 0.5,1.5");
    }
    let tasks = arguments.tasks.as_deref().expect("clap demands it");
    let inputs::Tasks {
        tasks,
        scenes,
        broken,
    } = inputs::tasks(tasks, &arguments.scene, ObjectOrder::AsWritten)?;
    fs::create_dir_all(&arguments.out)
        .with_context(|| format!("cannot make the folder {}", arguments.out.display()))?;
    let agents = arguments
        .players
        .agent_set(&arguments.out.join("calls.jsonl"))?;
    let name = agents.name();
    let run = arguments.run_name()?;
    let job = |task: &Arc<Task>, seed: u64| {
        let file = format!("{}--{name}--{seed}.mcap", task.task_id)
            .replace(|c: char| "/\\: ".contains(c), "_");
        let path = arguments.out.join(file);
        remove_abandoned(&path.with_added_extension("part"));
        let images = if arguments.no_images {
            Images::None
        } else {
            Images::Full
        };
        EpisodeJob {
            config: EpisodeConfig {
                task: task.clone(),
                scene: scenes
                    .of(task)
                    .expect("tasks are loaded with their scenes")
                    .clone(),
                seed,
                profile,
                skills: arguments.skills,
                meshes: reel_world::Meshes::default(),
                preset: Preset::paper(),
                run_id: format!("{run}-{name}-{seed}"),
                policy: PolicyInfo::default(),
                rollout: None,
                parent: None,
            },
            policy: name.clone(),
            record: Some(RecordTo {
                path,
                options: RecordOptions {
                    images,
                    layers: arguments.record,
                    durability: Durability::default(),
                },
            }),
            command: format!(
                "reel bench --agent {} --seed {seed} --jobs 1 ...",
                arguments.players.agent
            ),
        }
    };
    let seeds = arguments.seed..arguments.seed.saturating_add(arguments.repeat);
    let jobs: Vec<EpisodeJob> = seeds
        .flat_map(|seed| tasks.iter().map(move |task| (task, seed)))
        .map(|(task, seed)| job(task, seed))
        .collect();
    let all = jobs.len();
    let (mut reports, mut open) = (Vec::new(), Vec::new());
    for job in jobs {
        match played(&job, &agents, arguments.players.logprobs)? {
            Some(report) => reports.push(report),
            None => open.push(job),
        }
    }
    if !reports.is_empty() {
        eprintln!(
            "reel: {} of {all} episodes were played before",
            reports.len()
        );
    }
    let budget = Budget::new(arguments);
    reports.iter().for_each(|report| budget.spend(report));
    let bar = progress::bar(all, &name);
    bar.set_position(reports.len() as u64);
    let successes = AtomicU64::new(reports.iter().filter(|report| report.success).count() as u64);
    let workers = if agents.uses_model() {
        arguments.jobs.unwrap_or(JOBS_WITH_MODELS)
    } else {
        inputs::workers(arguments.jobs)
    };
    let instantiate = |job: &EpisodeJob| -> Result<Participants, AgentError> {
        let not_played = |why| AgentError::NotPlayed {
            task: job.config.task.task_id.clone(),
            seed: job.config.seed,
            why,
        };
        budget.check().map_err(not_played)?;
        agents.instantiate(job)
    };
    let exporter = arguments.otlp.exporter()?;
    let results = run_all(open, workers, instantiate, |report| {
        budget.spend(report);
        if let (Some(exporter), Some(trace)) = (&exporter, &report.trace) {
            exporter.push(trace);
        }
        let successes = successes.fetch_add(u64::from(report.success), Ordering::Relaxed)
            + u64::from(report.success);
        bar.inc(1);
        bar.set_message(format!(
            "{name}: {:.0} % succeed",
            100.0 * successes as f64 / bar.position() as f64
        ));
    });
    bar.finish_and_clear();
    if let Some(exporter) = exporter {
        exporter.finish();
    }
    let (mut failed, mut skipped) = (0, 0);
    for result in results {
        match result {
            Ok(report) => reports.push(report),
            Err(AgentError::NotPlayed { .. }) => skipped += 1,
            Err(error) => {
                failed += 1;
                eprintln!("reel: {:#}", anyhow::Error::from(error));
            }
        }
    }
    // In an order of its own, so that a run in parts ends with the table of one.
    reports.sort_by(|a, b| (a.family, &a.task_id, a.seed).cmp(&(b.family, &b.task_id, b.seed)));
    let prices = arguments.prices();
    if arguments.json {
        println!(
            "{}",
            json!({"agent": name, "memory_options": agents.memory_options(), "episodes": all, "played": reports.len(), "rows": rows(&reports, prices)})
        );
    } else {
        let memory = agents.memory_options();
        let heading = match &memory[..] {
            [] => name.clone(),
            enabled => format!("{name}, memory options {}", enabled.join(", ")),
        };
        print!("{}", table(&heading, arguments.skills, &reports, prices));
        println!("traces: {}", arguments.out.display());
    }
    if arguments.players.logprobs {
        tell_missing_logprobs(&reports)?;
    }
    if skipped > 0 {
        eprintln!(
            "reel: {skipped} episodes were not begun: {}; the same command goes on",
            budget.check().err().unwrap_or_default()
        );
    }
    Ok(if failed > 0 || skipped > 0 {
        ExitStatus::CheckFailed
    } else if broken > 0 {
        ExitStatus::Partial
    } else {
        ExitStatus::Success
    })
}

/// The report of an episode that was played before; none where it was not, or did not come to its
/// end. Another episode of that name is refused: it would be written over.
fn played(
    job: &EpisodeJob,
    agents: &AgentSet,
    logprobs: bool,
) -> anyhow::Result<Option<EpisodeReport>> {
    let path = &job.record.as_ref().expect("every episode is recorded").path;
    if !path.exists() {
        return Ok(None);
    }
    let Ok(trace) = Trace::read(path) else {
        return Ok(None);
    };
    let Participants { policy, outside } = agents.instantiate(job)?;
    let mut policy = policy.info();
    policy.parameters.extend(outside.settings);
    let (header, config) = (&trace.header, &job.config);
    let same = header.task_digest == Digest::of_json(&*config.task)
        && header.scene_digest == Digest::of_json(&*config.scene)
        && (header.profile, header.skills, header.seed)
            == (config.profile, config.skills, config.seed)
        && header.sim_version == sim_version(config.profile)
        && header.policy == policy;
    if !same {
        bail!(
            "{} was played with other settings, by another agent or simulator, or on another task of that name; give another folder with --out",
            path.display()
        );
    }
    let report = EpisodeReport::of_trace(&trace, path);
    let report = report.filter(|report| report.end_reason != EndReason::Aborted);
    if logprobs && report.is_some() && trace.logprobs().next().is_none() {
        bail!(
            "{} was played without --logprobs; give another folder with --out",
            path.display()
        );
    }
    Ok(report)
}

/// Says where the log-probabilities that were asked for are missing.
fn tell_missing_logprobs(reports: &[EpisodeReport]) -> anyhow::Result<()> {
    let (mut given, mut all) = (0, 0);
    for path in reports.iter().filter_map(|report| report.trace.as_deref()) {
        let trace = Trace::read(path)?;
        given += trace.logprobs().count();
        all += trace.steps.len();
    }
    if given < all {
        eprintln!("reel: the endpoint gave log-probabilities for {given} of {all} decisions");
    }
    Ok(())
}

/// What there is of each family, and all of it at the end.
fn by_family<T: Copy>(
    all: impl Iterator<Item = T> + Clone,
    family: impl Fn(&T) -> Family,
) -> Vec<(&'static str, Vec<T>)> {
    let mut groups: Vec<(&str, Vec<T>)> = Family::ALL
        .iter()
        .map(|wanted| {
            (
                wanted.as_str(),
                all.clone().filter(|one| family(one) == *wanted).collect(),
            )
        })
        .collect();
    groups.retain(|(_, group)| !group.is_empty());
    groups.push(("all", all.collect()));
    groups
}
