//! `reel demo`: the whole loop on embedded defaults.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

use anyhow::{Context, bail};
use reel_query::{Format, named};
use reel_tasks::{DrawOptions, draw};
use reel_trace::{Trace, TraceFiles};
use reel_world::{Family, Profile, Skills, Task};

use crate::{
    ExitStatus,
    cluster_arguments::ClusterArguments,
    commands::{blame, ingest, query, run, store, taxonomy},
    inputs, progress,
};

const POLICIES: [&str; 7] = [
    "oracle",
    "planner",
    "wrong-object",
    "wrong-receptacle",
    "no-ask",
    "oscillating",
    "forgets-door",
];

/// Run the whole loop on embedded defaults: generate tasks, play them with the oracle and with
/// policies that make mistakes, replay every episode bit for bit, read all into tables, query the
/// success rates, measure which call decided each failure, and draw one episode.
///
/// Example:
///   reel demo --out demo-out
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder for everything; what an earlier demo left there is replaced
    #[arg(long, value_name = "DIR", default_value = "demo-out")]
    out: PathBuf,
    /// Number of tasks; seven policies play each
    #[arg(long, value_name = "N", default_value_t = 30)]
    count: usize,
    /// Episodes at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
}

/// Draws tasks, then plays, replays, ingests, queries and explains their episodes.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let begun = Instant::now();
    let out = &arguments.out;
    let (traces, store) = (out.join("traces"), out.join("store"));
    for folder in [&traces, &store] {
        if folder.exists() {
            fs::remove_dir_all(folder)
                .with_context(|| format!("cannot clear {}", folder.display()))?;
        }
    }
    let workers = inputs::workers(arguments.jobs);
    let scene = inputs::scene(None)?;
    let made = draw(&DrawOptions {
        scene: &scene,
        families: &Family::ALL,
        count: arguments.count,
        seed: 1,
    });
    let tasks: Vec<Arc<Task>> = made.tasks.into_iter().map(Arc::new).collect();
    println!(
        "1. {} tasks in scene '{}' ({} receptacles)",
        tasks.len(),
        scene.scene_id,
        scene.receptacles.len()
    );

    println!("2. played and recorded");
    let mut recorded: Vec<PathBuf> = Vec::new();
    for policy in POLICIES {
        let plan = run::Plan {
            scenes: scene.clone().into(),
            meshes: reel_world::Meshes::default(),
            policy,
            seed: 1,
            profile: Profile::Paper,
            skills: Skills::Perfect,
            out: &traces,
            images: true,
            layers: Default::default(),
            durability: Default::default(),
            responders: Box::new(reel_agents::Responders::default),
        };
        let results = run::play(&plan, &tasks, workers, "reel demo --jobs 1")?;
        let reports = results.into_iter().collect::<Result<Vec<_>, _>>()?;
        let won = reports.iter().filter(|report| report.success).count();
        println!("   {policy:17} {won:3} of {} reach the goal", reports.len());
        recorded.extend(reports.into_iter().filter_map(|report| report.trace));
    }

    let bar = progress::bar(recorded.len(), "replay");
    let judged = reel_replay::verify_all(
        &TraceFiles::default(),
        &recorded,
        &reel_world::NoAssets,
        workers,
        |_, _| bar.inc(1),
    );
    bar.finish_and_clear();
    let exact = judged.iter().filter(|one| one.verdict.is_exact()).count();
    println!(
        "3. {exact} of {} episodes replay bit for bit",
        recorded.len()
    );
    for (path, one) in recorded
        .iter()
        .zip(&judged)
        .filter(|(_, one)| !one.verdict.is_exact())
    {
        println!("   {}: {}", path.display(), one.verdict);
    }
    if exact < recorded.len() {
        bail!("a replay diverged: that is a fault of Reel; please report it with the trace");
    }

    let store = store.to_string_lossy();
    let report = ingest::ingest(
        &inputs::trace_files(),
        &recorded,
        &store,
        &ClusterArguments::default(),
    )?;
    store::keep_verdicts(&inputs::store(&store, None)?, &judged)?;
    println!("4. {} episodes in tables\n", report.added);
    let name = "main_results";
    let named = named::by_name(name).with_context(|| format!("no query is called '{name}'"))?;
    println!(
        "{} (reel query --store {} --named {name})",
        named.summary(),
        store
    );
    query::print(&store, named.sql, Format::Table)?;
    let why = out.join("why.png");
    println!("\nWhich call lost the others (reel blame --store {store})");
    blame::measure_and_print(&store, arguments.jobs)?;
    println!("\nWhy they failed (reel taxonomy --store {store})");
    taxonomy::classify_and_print(&store, why.clone())?;
    println!();

    let sheet = out.join("contact_sheet.png");
    let episode = with_frames(&recorded)?;
    fs::write(&sheet, reel_view::contact_sheet(&Trace::read(&episode)?)?)?;
    println!(
        "{} episodes in {:.0} s. Where everything lies, and what to try next:",
        recorded.len(),
        begun.elapsed().as_secs_f64()
    );
    println!("  {}", sheet.display());
    println!("  {}", why.display());
    println!(
        "  reel serve --data {}        # then open http://127.0.0.1:8801",
        out.display()
    );
    println!("  reel show {}", episode.display());
    println!(
        "  reel query --store {} \"SELECT task_id, policy, length FROM episodes WHERE NOT success\"",
        store
    );
    println!("  reel export sft --store {store} --out sft");
    println!("  reel export rrd {} --out episode.rrd", episode.display());
    Ok(ExitStatus::Success)
}

/// The oracle's first FODP episode: same-category objects to tell apart.
fn with_frames(recorded: &[PathBuf]) -> anyhow::Result<PathBuf> {
    let name = |path: &Path| {
        path.file_name()
            .map(|name| name.to_string_lossy().into_owned())
            .unwrap_or_default()
    };
    let wanted =
        |path: &&PathBuf| name(path).starts_with("FODP") && name(path).contains("--oracle--");
    recorded
        .iter()
        .find(wanted)
        .or_else(|| recorded.first())
        .cloned()
        .context("nothing was recorded")
}
