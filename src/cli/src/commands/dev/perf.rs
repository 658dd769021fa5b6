//! `reel dev perf`: what things cost, measured in one process and one thread.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

use anyhow::{Context, anyhow};
use reel_agents::{EpisodeJob, RecordTo, builtin, run_all};
use reel_counterfactual::blame::{CompetentAgent, alternative, blame};
use reel_episode::EpisodeConfig;
use reel_replay::{SnapshotCache, seek, verify_with};
use reel_reward::Preset;
use reel_sim::{
    CallContext, PreparedTask, Simulator, geometry::Pose, physics::Physics, render::Detail,
};
use reel_tasks::{DrawOptions, draw};
use reel_trace::{Images, Trace, encode_webp};
use reel_world::{
    FRAME_HEIGHT, FRAME_WIDTH, Family, Profile, Scene, Skills, Task, record::PolicyInfo,
};
use serde::Serialize;

use crate::{ExitStatus, inputs};

/// Physics steps after spawning that are timed: the world is awake in all of them.
const PHYSICS_STEPS: u32 = 200;
const PHYSICS_ROUNDS: u32 = 12;
const FRAMES: u32 = 60;

/// Policies whose failures are measured.
const FAULTY: [&str; 3] = ["wrong-object", "wrong-receptacle", "oscillating"];

/// Rounds of what is compared, in turn; the best of each counts.
const ROUNDS: usize = 3;

/// Measure on embedded defaults, ratios in one run and in turn: physics against the same rapier
/// world stepped with nothing of ours; images and their encoding; recording with and without a
/// trace and on two workers; replay with and without shading; seeking by a snapshot; blame of
/// failed episodes; bytes of a trace.
///
/// Example:
///   cargo run --release -p reel-cli --no-default-features -- dev perf
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Number of tasks drawn for the measurement
    #[arg(long, value_name = "N", default_value_t = 12)]
    count: usize,
    /// Folder for the traces of the measurement; removed at the end
    #[arg(long, value_name = "DIR", default_value = "bench-out")]
    out: PathBuf,
    /// Measure physics steps alone: how fast the machine is, in a moment
    #[arg(long)]
    physics: bool,
    /// Print the measurements as one JSON object
    #[arg(long)]
    json: bool,
}

/// Physics steps in one thread.
#[derive(Serialize)]
struct PhysicsSpeed {
    /// Steps per second with our digest of each.
    physics_steps_per_s: f64,
    bare_rapier_steps_per_s: f64,
    physics_to_bare: f64,
}

/// Everything that `reel dev perf` measures: rates, durations, ratios and sizes.
#[derive(Serialize)]
struct Figures {
    episodes: usize,
    calls_per_episode: f64,
    #[serde(flatten)]
    physics: PhysicsSpeed,
    frame_ms: f64,
    geometry_ms: f64,
    webp_ms: f64,
    /// One worker, images stored.
    episodes_per_s: f64,
    two_workers_to_one: f64,
    record_to_unrecorded: f64,
    lean_record_to_unrecorded: f64,
    replay_to_record: f64,
    replay_without_shading_to_record: f64,
    exact: usize,
    seek_cached_ms: f64,
    seek_from_start_ms: f64,
    seek_cached_to_start: f64,
    /// Of failed episodes: measured from the records, with the alternative played, and with
    /// it recorded and replayed.
    blame_to_replay: [f64; 3],
    bytes_full: f64,
    bytes_lean: f64,
}

/// Measures and prints the costs; the check fails if a replay is not exact.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let scene = inputs::scene(None)?;
    let made = draw(&DrawOptions {
        scene: &scene,
        families: &Family::ALL,
        count: if arguments.physics {
            1
        } else {
            arguments.count
        },
        seed: 1,
    });
    let tasks: Vec<Arc<Task>> = made.tasks.into_iter().map(Arc::new).collect();
    let first = tasks.first().context("no task could be made")?;
    let speed = physics(&scene, first);
    if arguments.physics {
        if arguments.json {
            println!("{}", serde_json::to_string(&speed)?);
        } else {
            print_physics(&speed);
        }
        return Ok(ExitStatus::Success);
    }
    let figures = measure(arguments, &scene, &tasks, speed)?;
    fs::remove_dir_all(&arguments.out)
        .with_context(|| format!("cannot clear {}", arguments.out.display()))?;
    if arguments.json {
        println!("{}", serde_json::to_string(&figures)?);
    } else {
        print(&figures);
    }
    Ok(if figures.exact == figures.episodes {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}

fn measure(
    arguments: &Arguments,
    scene: &Arc<Scene>,
    tasks: &[Arc<Task>],
    physics: PhysicsSpeed,
) -> anyhow::Result<Figures> {
    let [frame_ms, geometry_ms, webp_ms] = frames(scene, &tasks[0]);

    let play = |name: &str,
                images: Option<Images>,
                workers: usize|
     -> anyhow::Result<(f64, Vec<PathBuf>)> {
        let out = arguments.out.join(name);
        fs::create_dir_all(&out)
            .with_context(|| format!("cannot make the folder {}", out.display()))?;
        let jobs = tasks.iter().enumerate().map(|(index, task)| {
            job(
                scene,
                task,
                images.map(|images| (out.join(format!("{index}.mcap")), images)),
            )
        });
        let (jobs, begun) = (jobs.collect(), Instant::now());
        let reports = run_all(jobs, workers, builtin, |_| {})
            .into_iter()
            .collect::<Result<Vec<_>, _>>()?;
        Ok((
            begun.elapsed().as_secs_f64(),
            reports
                .into_iter()
                .filter_map(|report| report.trace)
                .collect(),
        ))
    };
    let mut best = [f64::INFINITY; 6];
    let (mut full, mut lean, mut exact) = (Vec::new(), Vec::new(), 0);
    let replay = |paths: &[PathBuf], detail| -> anyhow::Result<(f64, usize)> {
        let begun = Instant::now();
        let mut exact = 0;
        for path in paths {
            exact += usize::from(verify_with(&Trace::read(path)?, detail).is_exact());
        }
        Ok((begun.elapsed().as_secs_f64(), exact))
    };
    for _ in 0..ROUNDS {
        let seconds;
        (seconds, full) = play("full", Some(Images::Full), 1)?;
        best[0] = best[0].min(seconds);
        best[1] = best[1].min(play("none", None, 1)?.0);
        let seconds;
        (seconds, lean) = play("lean", Some(Images::None), 1)?;
        best[2] = best[2].min(seconds);
        best[3] = best[3].min(play("two", Some(Images::Full), 2)?.0);
        let (seconds, found) = replay(&full, Detail::Full)?;
        (best[4], exact) = (best[4].min(seconds), found);
        best[5] = best[5].min(replay(&full, Detail::Geometry)?.0);
    }
    let [record, unrecorded, lean_record, two, replayed, geometry] = best;
    let (cached, from_start) = seeks(&full, &arguments.out.join("snapshots"))?;
    let calls: usize = full
        .iter()
        .map(|path| Ok(Trace::read(path)?.steps.len()))
        .sum::<anyhow::Result<usize>>()?;
    let episodes = full.len() as f64;
    Ok(Figures {
        episodes: full.len(),
        calls_per_episode: calls as f64 / episodes,
        physics,
        frame_ms,
        geometry_ms,
        webp_ms,
        episodes_per_s: episodes / record,
        two_workers_to_one: record / two,
        record_to_unrecorded: record / unrecorded,
        lean_record_to_unrecorded: lean_record / unrecorded,
        replay_to_record: replayed / record,
        replay_without_shading_to_record: geometry / record,
        exact,
        seek_cached_ms: cached,
        seek_from_start_ms: from_start,
        seek_cached_to_start: cached / from_start,
        blame_to_replay: blames(scene, tasks, &arguments.out.join("failed"))?,
        bytes_full: mean_bytes(&full)?,
        bytes_lean: mean_bytes(&lean)?,
    })
}

fn row(name: &str, value: String, note: String) {
    println!("{name:32} {value:>10}   {note}");
}

fn print_physics(speed: &PhysicsSpeed) {
    let note = format!(
        "{:.2} of the bare rapier loop ({:.0})",
        speed.physics_to_bare, speed.bare_rapier_steps_per_s
    );
    row(
        "physics steps per second",
        format!("{:.0}", speed.physics_steps_per_s),
        note,
    );
}

fn print(figures: &Figures) {
    let Figures {
        episodes,
        exact,
        calls_per_episode,
        ..
    } = figures;
    print_physics(&figures.physics);
    row(
        "image",
        format!("{:.2} ms", figures.frame_ms),
        format!("{:.2} ms ids and depth alone", figures.geometry_ms),
    );
    row(
        "image, encoded as WebP",
        format!("{:.2} ms", figures.webp_ms),
        String::new(),
    );
    let note = format!("recorded with images, {calls_per_episode:.1} calls each");
    row(
        "episodes per second per core",
        format!("{:.2}", figures.episodes_per_s),
        note,
    );
    row(
        "two workers to one",
        format!("{:.2}", figures.two_workers_to_one),
        "episodes per second".to_owned(),
    );
    let note = format!("{:.2} without images", figures.lean_record_to_unrecorded);
    row(
        "recorded to unrecorded time",
        format!("{:.2}", figures.record_to_unrecorded),
        note,
    );
    row(
        "replay to record time",
        format!("{:.2}", figures.replay_to_record),
        format!("{exact} of {episodes} exact"),
    );
    let ratio = format!("{:.2}", figures.replay_without_shading_to_record);
    row(
        "  ids and depth, no shading",
        ratio,
        "everything but RGB compared".to_owned(),
    );
    let note = format!(
        "{:.1} ms executed from the start: {:.2}",
        figures.seek_from_start_ms, figures.seek_cached_to_start
    );
    row(
        "seek to a call, by snapshot",
        format!("{:.1} ms", figures.seek_cached_ms),
        note,
    );
    let [records, played, replayed] = figures.blame_to_replay;
    let note = format!(
        "{records:.3} from the records alone, {replayed:.2} with the branch recorded and replayed; medians"
    );
    row("blame to replay time", format!("{played:.2}"), note);
    let note = format!("{:.0} without images", figures.bytes_lean);
    row(
        "trace bytes per episode",
        format!("{:.0}", figures.bytes_full),
        note,
    );
}

/// What blame costs of a failed episode to what its replay does: from the records, with the better
/// future played, and with that recorded and replayed. Medians.
fn blames(scene: &Arc<Scene>, tasks: &[Arc<Task>], folder: &Path) -> anyhow::Result<[f64; 3]> {
    fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let jobs = tasks.iter().enumerate().flat_map(|(index, task)| {
        FAULTY.map(|policy| {
            let path = folder.join(format!("{index}-{policy}.mcap"));
            EpisodeJob {
                policy: policy.into(),
                ..job(scene, task, Some((path, Images::None)))
            }
        })
    });
    let reports = run_all(jobs.collect(), 1, builtin, |_| {})
        .into_iter()
        .collect::<Result<Vec<_>, _>>()?;
    let mut ratios: [Vec<f64>; 3] = Default::default();
    for path in reports
        .into_iter()
        .filter(|report| !report.success)
        .filter_map(|report| report.trace)
    {
        let trace = Trace::read(&path)?;
        let seconds = |work: &mut dyn FnMut() -> anyhow::Result<()>| -> anyhow::Result<f64> {
            let begun = Instant::now();
            work()?;
            Ok(begun.elapsed().as_secs_f64())
        };
        let replay =
            seconds(&mut || Ok(_ = std::hint::black_box(verify_with(&trace, Detail::Full))))?;
        let Some(decisive) = blame(&trace).decisive else {
            continue;
        };
        let better = path.with_extension("better.mcap");
        let records = seconds(&mut || Ok(_ = std::hint::black_box(blame(&trace))))?;
        let played = seconds(&mut || {
            Ok(_ = alternative(&trace, &decisive, None, CompetentAgent::default())?)
        })?;
        let replayed = seconds(&mut || {
            Ok(_ = alternative(&trace, &decisive, Some(&better), CompetentAgent::default())?)
        })?;
        for (ratios, cost) in ratios
            .iter_mut()
            .zip([records, records + played, records + replayed])
        {
            ratios.push(cost / replay);
        }
    }
    Ok(ratios.map(median))
}

fn job(scene: &Arc<Scene>, task: &Arc<Task>, record: Option<(PathBuf, Images)>) -> EpisodeJob {
    EpisodeJob {
        config: EpisodeConfig {
            task: task.clone(),
            scene: scene.clone(),
            seed: 1,
            profile: Profile::Paper,
            skills: Skills::Perfect,
            meshes: reel_world::Meshes::default(),
            preset: Preset::paper(),
            run_id: "bench".into(),
            policy: PolicyInfo::default(),
            rollout: None,
            parent: None,
        },
        policy: "oracle".into(),
        record: record.map(|(path, images)| RecordTo {
            path,
            options: images.into(),
        }),
        command: "reel bench".into(),
    }
}

/// Milliseconds to the state after two thirds of the calls, by a snapshot of the cache and executed
/// from the start: means.
fn seeks(paths: &[PathBuf], folder: &Path) -> anyhow::Result<(f64, f64)> {
    let cache = SnapshotCache::at(folder);
    let (mut cached, mut from_start) = (0.0, 0.0);
    for path in paths {
        let trace = Trace::read(path)?;
        let calls = trace.steps.len() * 2 / 3;
        let go = |cache: Option<&SnapshotCache>| -> anyhow::Result<f64> {
            let begun = Instant::now();
            let replay = seek(&trace, calls, cache)
                .map_err(|verdict| anyhow!("{}: {verdict}", path.display()))?;
            std::hint::black_box(replay.episode().simulator().sim_step());
            Ok(begun.elapsed().as_secs_f64() * 1e3)
        };
        from_start += go(None)?;
        go(Some(&cache))?;
        cached += go(Some(&cache))?;
    }
    Ok((cached / paths.len() as f64, from_start / paths.len() as f64))
}

/// Steps per second with our digest of every step, and without anything of ours; interleaved, each
/// the best of its rounds.
fn physics(scene: &Arc<Scene>, task: &Arc<Task>) -> PhysicsSpeed {
    let simulator = Simulator::new(
        PreparedTask::new(scene.clone(), task.clone()),
        Profile::Paper,
        0,
    );
    let spawn = || {
        let models = simulator.object_models();
        let mut physics = Physics::new(simulator.model(), models.len());
        for (index, (object, model)) in task.objects.iter().zip(models).enumerate() {
            let [x, y, z] = object.position.map(|value| value as f32);
            physics.insert_object(
                index,
                model,
                Pose::yawed([x, y, z + 0.1], object.yaw as f32),
            );
        }
        physics
    };
    let (mut ours, mut bare) = (0.0f64, 0.0f64);
    let mut sum = 0u32;
    for _ in 0..PHYSICS_ROUNDS {
        let mut world = spawn();
        let begun = Instant::now();
        for _ in 0..PHYSICS_STEPS {
            world.step();
            sum = sum.wrapping_add(world.step_digest());
        }
        ours = ours.max(f64::from(PHYSICS_STEPS) / begun.elapsed().as_secs_f64());
        let mut world = spawn();
        let begun = Instant::now();
        for _ in 0..PHYSICS_STEPS {
            world.step_bare();
        }
        bare = bare.max(f64::from(PHYSICS_STEPS) / begun.elapsed().as_secs_f64());
    }
    std::hint::black_box(sum);
    PhysicsSpeed {
        physics_steps_per_s: ours,
        bare_rapier_steps_per_s: bare,
        physics_to_bare: ours / bare,
    }
}

/// Milliseconds per image, rendered, rendered without shading, and encoded: the medians.
fn frames(scene: &Arc<Scene>, task: &Arc<Task>) -> [f64; 3] {
    let mut simulator = Simulator::new(
        PreparedTask::new(scene.clone(), task.clone()),
        Profile::Paper,
        0,
    );
    let (mut render, mut geometry, mut encode) = (Vec::new(), Vec::new(), Vec::new());
    for index in 0..FRAMES {
        let target = &scene.receptacles[index as usize % scene.receptacles.len()].id;
        simulator.call(
            &reel_world::Tool::NavTo {
                receptacle: target.clone(),
            },
            CallContext::default(),
        );
        let begun = Instant::now();
        let frame = simulator.capture_frame();
        render.push(begun.elapsed().as_secs_f64() * 1e3);
        simulator.set_detail(Detail::Geometry);
        let begun = Instant::now();
        std::hint::black_box(simulator.capture_frame());
        geometry.push(begun.elapsed().as_secs_f64() * 1e3);
        simulator.set_detail(Detail::Full);
        let begun = Instant::now();
        std::hint::black_box(encode_webp(
            &frame.rgb,
            FRAME_WIDTH as u32,
            FRAME_HEIGHT as u32,
        ));
        encode.push(begun.elapsed().as_secs_f64() * 1e3);
    }
    [median(render), median(geometry), median(encode)]
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn mean_bytes(paths: &[PathBuf]) -> anyhow::Result<f64> {
    let sizes = paths
        .iter()
        .map(|path| Ok(fs::metadata(path)?.len()))
        .collect::<anyhow::Result<Vec<u64>>>()?;
    Ok(sizes.iter().sum::<u64>() as f64 / sizes.len().max(1) as f64)
}
