//! `reel run`: plays tasks with a policy and records every episode.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context, bail};
use reel_agents::{
    AgentError, EpisodeJob, EpisodeReport, POLICIES, Participants, RecordTo, Responders, builtin,
    run_all,
};
use reel_episode::EpisodeConfig;
use reel_reward::Preset;
use reel_tasks::ObjectOrder;
use reel_trace::{Durability, FrameLayers, Images, RecordOptions};
use reel_world::{Assets as _, Meshes, Profile, Scenes, Skills, Task, record::PolicyInfo};

use crate::{ExitStatus, commands::isolation_check, inputs, progress};
#[cfg(feature = "service")]
use crate::{
    match_arguments::{EMBEDDINGS, MatchArguments},
    model::client_of,
};
#[cfg(feature = "service")]
use reel_llm::client::Endpoint;

/// Run a policy in the simulator: play tasks, each in its scene, and record every episode as a
/// trace. `reel bench` runs agents that a model drives; `reel record` records other MCP servers.
///
/// Examples:
///   reel run --tasks tasks                            # the oracle, each task in the scene that it names
///   reel run --tasks tasks --assets meshes            # objects with a mesh in this folder are that, to see and to touch
///   reel run --tasks real-bench/tasks --policy wrong-object --seed 7 --out traces/wrong   # after reel task real-bench
///
/// Policies: oracle, planner, planner-words, wrong-object, wrong-receptacle, no-ask, oscillating, forgets-door,
/// gibberish, explorer.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Task file (REAL-Bench YAML) or folder of them
    #[arg(long, value_name = "PATH")]
    pub tasks: PathBuf,
    #[command(flatten)]
    pub scene: inputs::SceneArguments,
    #[command(flatten)]
    pub assets: inputs::Assets,
    /// Built-in policy that decides every call
    #[arg(long, value_name = "NAME", default_value = "oracle")]
    pub policy: String,
    /// Seed of every random draw
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Folder for the traces
    #[arg(long, value_name = "DIR", default_value = "traces-out")]
    out: PathBuf,
    /// Episodes at a time; without it one for each core
    #[arg(long, value_name = "N")]
    pub jobs: Option<usize>,
    /// How the environment behaves where the paper and the published code differ: paper, real-repo
    /// (the published evaluation server) or real-gspo (the published training server)
    #[arg(long, value_name = "NAME", default_value = "paper")]
    pub profile: String,
    /// How reliable the robot's skills are: perfect, or real-v1 as on the paper's robot (picks,
    /// places and doors fail now and then, the base arrives centimetres beside its goal)
    #[arg(long, value_name = "NAME", default_value = "perfect", value_parser = inputs::skills)]
    pub skills: Skills,
    /// Record no images; replay renders them again
    #[arg(long)]
    no_images: bool,
    /// Record of each frame besides: depth (16-bit millimetres), masks (instance ids), or both with a
    /// comma between
    #[arg(long, value_name = "LAYERS", default_value = "", hide_default_value = true, value_parser = inputs::layers)]
    record: FrameLayers,
    /// Play everything a second time under other conditions (heap layout, thread count, order of
    /// tasks and of the objects in their files) and name the first state field that depends on them
    #[arg(long = "check-isolation", alias = "paranoid")]
    paranoid: bool,
    /// What a recorded call survives: write (the death of the process) or fsync (the
    /// loss of power, too)
    #[arg(long, value_name = "NAME", default_value = "write")]
    durability: String,
    /// Take tasks, and the objects that their files list, in reverse order (a check: the traces
    /// must not depend on it)
    #[arg(long, hide = true)]
    reversed: bool,
    #[cfg(feature = "service")]
    #[command(flatten)]
    matching: MatchArguments,
    /// OpenAI-compatible endpoint of the embedding model, up to /v1
    #[cfg(feature = "service")]
    #[arg(long, value_name = "URL", requires = "embedding_model")]
    endpoint: Option<String>,
    /// Environment variable that holds the endpoint's key, where one is needed
    #[cfg(feature = "service")]
    #[arg(long = "api-key-env", value_name = "VARIABLE", requires = "endpoint")]
    key_from: Option<String>,
    /// Print one JSON object per episode instead of the table
    #[arg(long)]
    pub json: bool,
}

impl Arguments {
    /// What makes those who answer from outside: a matcher, if vectors are named.
    #[cfg(feature = "service")]
    fn responders(&self) -> anyhow::Result<Box<dyn Fn() -> Responders + Sync>> {
        let matching = self.matching.matching(|model| {
            let url = self.endpoint.as_deref();
            let endpoint = Endpoint::new(
                url.context("--endpoint is missing: the address of the model")?,
                model,
            );
            fs::create_dir_all(&self.out)
                .with_context(|| format!("cannot make the folder {}", self.out.display()))?;
            let (cache, log) = (self.out.join(EMBEDDINGS), self.out.join("calls.jsonl"));
            client_of(endpoint, self.key_from.as_deref(), &cache, &log).map(Arc::new)
        })?;
        Ok(Box::new(move || {
            let mut outside = Responders::default();
            if let Some(matching) = &matching {
                matching.install(&mut outside);
            }
            outside
        }))
    }

    #[cfg(not(feature = "service"))]
    #[expect(
        clippy::unused_self,
        clippy::unnecessary_wraps,
        reason = "the whole build asks models"
    )]
    fn responders(&self) -> anyhow::Result<Box<dyn Fn() -> Responders + Sync>> {
        Ok(Box::new(Responders::default))
    }
}

/// Plays the tasks with a built-in policy and records every episode as a trace.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    if !POLICIES.iter().any(|(name, _)| *name == arguments.policy) {
        let known: Vec<String> = POLICIES
            .iter()
            .map(|(name, what)| format!("  {name:17} {what}"))
            .collect();
        bail!(
            "no policy is called '{}'; there are\n{}",
            arguments.policy,
            known.join("\n")
        );
    }
    let Some(profile) = Profile::parse(&arguments.profile) else {
        bail!(
            "no profile is called '{}'; there are paper, real-repo and real-gspo",
            arguments.profile
        );
    };
    let Some(durability) = Durability::parse(&arguments.durability) else {
        bail!(
            "no durability is called '{}'; there are write and fsync",
            arguments.durability
        );
    };
    let listed = if arguments.reversed {
        ObjectOrder::Reversed
    } else {
        ObjectOrder::AsWritten
    };
    let inputs::Tasks {
        mut tasks,
        scenes,
        broken,
    } = inputs::tasks(&arguments.tasks, &arguments.scene, listed)?;
    if arguments.reversed {
        tasks.reverse();
    }
    let (meshes, refused) = arguments.assets.of(&tasks)?;
    let plan = Plan {
        scenes,
        meshes,
        policy: &arguments.policy,
        seed: arguments.seed,
        profile,
        skills: arguments.skills,
        out: &arguments.out,
        images: !arguments.no_images,
        layers: arguments.record,
        durability,
        responders: arguments.responders()?,
    };
    let scene_flag: String = arguments
        .scene
        .flags()
        .iter()
        .map(|word| format!(" {word}"))
        .collect();
    let skills_flag = if arguments.skills.are_perfect() {
        ""
    } else {
        " --skills real-v1"
    };
    let assets_flag = arguments.assets.path().map_or(String::new(), |path| {
        format!(" --assets {}", path.display())
    });
    let command = format!(
        "reel run --tasks {}{scene_flag}{assets_flag}{skills_flag} --policy {} --seed {} --jobs 1",
        arguments.tasks.display(),
        arguments.policy,
        arguments.seed
    );
    let results = play(&plan, &tasks, inputs::workers(arguments.jobs), &command)?;
    let mut failed = 0;
    let mut reports = Vec::new();
    for result in results {
        match result {
            Ok(report) => reports.push(report),
            Err(error) => {
                failed += 1;
                eprintln!("reel: {:#}", anyhow::Error::from(error));
            }
        }
    }
    if arguments.json {
        for report in &reports {
            println!("{}", json(report));
        }
    } else {
        print!("{}", summary(&arguments.policy, &reports));
        println!("traces: {}", arguments.out.display());
    }
    let leaks = if arguments.paranoid {
        isolation_check::leaks(arguments, &reports)?
    } else {
        0
    };
    Ok(if failed > 0 || leaks > 0 {
        ExitStatus::CheckFailed
    } else if broken + refused > 0 {
        ExitStatus::Partial
    } else {
        ExitStatus::Success
    })
}

/// How to play a set of tasks.
pub struct Plan<'a> {
    /// The scenes of the tasks.
    pub scenes: Scenes,
    /// What objects look like that are no primitives, those of all tasks.
    pub meshes: Meshes,
    /// Name of the policy.
    pub policy: &'a str,
    /// Seed of every random draw.
    pub seed: u64,
    /// Behaviour where paper and published code differ.
    pub profile: Profile,
    /// How reliable the robot's skills are.
    pub skills: Skills,
    /// Folder for the traces.
    pub out: &'a Path,
    /// Whether the traces hold the images.
    pub images: bool,
    /// What the traces hold of each frame besides.
    pub layers: FrameLayers,
    /// What a recorded call survives.
    pub durability: Durability,
    /// Makes those who answer from outside in an episode.
    pub responders: Box<dyn Fn() -> Responders + Sync>,
}

/// Plays tasks; results in their order.
///
/// # Errors
/// When the folder cannot be made.
pub fn play(
    plan: &Plan<'_>,
    tasks: &[Arc<Task>],
    workers: usize,
    command: &str,
) -> anyhow::Result<Vec<Result<EpisodeReport, AgentError>>> {
    fs::create_dir_all(plan.out)
        .with_context(|| format!("cannot make the folder {}", plan.out.display()))?;
    let job = |task: &Arc<Task>| {
        let name = format!(
            "{}--{}--{}.mcap",
            task.task_id.replace(['/', '\\'], "_"),
            plan.policy,
            plan.seed
        );
        let images = if plan.images {
            Images::Full
        } else {
            Images::None
        };
        let path = plan.out.join(name);
        remove_abandoned(&path.with_added_extension("part"));
        EpisodeJob {
            config: EpisodeConfig {
                task: task.clone(),
                scene: plan
                    .scenes
                    .of(task)
                    .expect("tasks are loaded with their scenes")
                    .clone(),
                seed: plan.seed,
                profile: plan.profile,
                skills: plan.skills,
                meshes: plan.meshes.meshes(&mut task.assets()),
                preset: Preset::paper(),
                run_id: format!("{}-{}", plan.policy, plan.seed),
                policy: PolicyInfo::default(),
                rollout: None,
                parent: None,
            },
            policy: plan.policy.to_owned(),
            record: Some(RecordTo {
                path,
                options: RecordOptions {
                    images,
                    layers: plan.layers,
                    durability: plan.durability,
                },
            }),
            command: command.to_owned(),
        }
    };
    let bar = progress::bar(tasks.len(), plan.policy);
    let participants = |job: &EpisodeJob| {
        Ok(Participants {
            outside: (plan.responders)(),
            ..builtin(job)?
        })
    };
    let results = run_all(
        tasks.iter().map(job).collect(),
        workers,
        participants,
        |_| bar.inc(1),
    );
    bar.finish_and_clear();
    Ok(results)
}

/// Removes what an interrupted run left of an episode: it is made again from the same inputs. A
/// part whose recorder still lives is locked, and stays.
pub fn remove_abandoned(part: &Path) {
    if fs::File::open(part).is_ok_and(|file| file.try_lock().is_ok()) {
        let _ = fs::remove_file(part);
    }
}

/// A table by family, and the tasks that could not be reached, by name and reason.
pub fn summary(policy: &str, reports: &[EpisodeReport]) -> String {
    let mut text = format!("{policy:18} episodes  success  completion  reward  length\n");
    let mut line = |name: &str, group: &[&EpisodeReport]| {
        let mean = |value: &dyn Fn(&EpisodeReport) -> f64| {
            group.iter().map(|report| value(report)).sum::<f64>() / group.len().max(1) as f64
        };
        text.push_str(&format!(
            "  {name:16} {:8} {:7.1}% {:10.1}% {:7.2} {:7.1}\n",
            group.len(),
            100.0 * mean(&|report| f64::from(u8::from(report.success))),
            100.0 * mean(&|report| report.completion),
            mean(&|report| report.total_reward),
            mean(&|report| f64::from(report.length)),
        ));
    };
    for family in reel_world::Family::ALL {
        let group: Vec<&EpisodeReport> = reports
            .iter()
            .filter(|report| report.family == family)
            .collect();
        if !group.is_empty() {
            line(family.as_str(), &group);
        }
    }
    line("all", &reports.iter().collect::<Vec<_>>());
    for report in reports.iter().filter(|report| !report.success) {
        if let Some(reason) = &report.unreachable {
            let what = if policy == "oracle" {
                "unreachable"
            } else {
                "gave up"
            };
            text.push_str(&format!("  {what}: {}: {reason}\n", report.task_id));
        }
    }
    text
}

fn json(report: &EpisodeReport) -> serde_json::Value {
    serde_json::json!({
        "episode_id": report.episode_id, "task_id": report.task_id, "family": report.family, "policy": report.policy,
        "seed": report.seed, "success": report.success, "completion": report.completion,
        "total_reward": report.total_reward, "length": report.length, "asks": report.asks,
        "end_reason": report.end_reason, "trace": report.trace, "bytes": report.bytes, "unreachable": report.unreachable,
    })
}
