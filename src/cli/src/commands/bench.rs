//! `reel bench`: what things cost, measured in one process and one thread.

use std::{fs, path::PathBuf, sync::Arc, time::Instant};

use anyhow::Context;
use reel_sim::{Simulator, geometry::Pose, physics::Physics};
use reel_tasks::{GenerateOptions, generate};
use reel_trace::{Trace, encode_webp};
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Family, Profile, Scene, Task};
use serde_json::json;

use crate::{Answer, commands::run, inputs};

/// Physics steps after spawning that are timed: the world is awake in all of them.
const PHYSICS_STEPS: u32 = 200;
const PHYSICS_ROUNDS: u32 = 12;
const PICTURES: u32 = 60;

/// Measure, in one thread on embedded defaults: physics steps per second against the same rapier world stepped with
/// nothing of ours, milliseconds per picture and per encoded picture, episodes per second, replay against record
/// time, bytes per episode.
///
/// Example:
///   cargo run --release -p reel-cli --no-default-features -- bench
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// How many tasks
    #[arg(long, value_name = "N", default_value_t = 12)]
    count: usize,
    /// Folder for the traces of the measurement; removed at the end
    #[arg(long, value_name = "DIR", default_value = "bench-out")]
    out: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<Answer> {
    let scene = inputs::scene(None)?;
    let made = generate(&GenerateOptions { scene: &scene, families: &Family::ALL, count: arguments.count, seed: 1 });
    let tasks: Vec<Arc<Task>> = made.tasks.into_iter().map(Arc::new).collect();
    let first = tasks.first().context("no task could be made")?;

    let (ours, bare) = physics(&scene, first);
    let (picture_ms, webp_ms) = pictures(&scene, first);
    let play = |images: bool, folder: &str| -> anyhow::Result<(f64, Vec<PathBuf>)> {
        let out = arguments.out.join(folder);
        let plan = run::Plan {
            scene: scene.clone(),
            policy: "oracle",
            seed: 1,
            profile: Profile::Paper,
            out: &out,
            images,
            durability: Default::default(),
        };
        let begun = Instant::now();
        let results = run::play(&plan, &tasks, 1, "reel bench")?;
        let seconds = begun.elapsed().as_secs_f64();
        let reports = results.into_iter().collect::<Result<Vec<_>, _>>()?;
        Ok((seconds, reports.into_iter().filter_map(|report| report.trace).collect()))
    };
    let (record_s, full) = play(true, "full")?;
    let (_, without) = play(false, "without_images")?;
    let begun = Instant::now();
    let verdicts = reel_replay::verify_all(&full, 1, |_, _| {});
    let replay_s = begun.elapsed().as_secs_f64();
    let exact = verdicts.iter().filter(|verdict| verdict.is_exact()).count();
    let (bytes_full, bytes_without) = (mean_bytes(&full)?, mean_bytes(&without)?);
    let calls: usize = full.iter().map(|path| Ok(Trace::read(path)?.steps.len())).sum::<anyhow::Result<usize>>()?;
    fs::remove_dir_all(&arguments.out).with_context(|| format!("cannot clear {}", arguments.out.display()))?;

    let episodes = full.len() as f64;
    if arguments.json {
        println!(
            "{}",
            json!({ "physics_steps_per_s": ours, "bare_rapier_steps_per_s": bare, "physics_ratio": ours / bare,
                    "picture_ms": picture_ms, "webp_ms": webp_ms, "episodes_per_s": episodes / record_s,
                    "calls_per_episode": calls as f64 / episodes, "replay_to_record": replay_s / record_s,
                    "exact": exact, "episodes": full.len(), "bytes_full": bytes_full, "bytes_without_images": bytes_without })
        );
    } else {
        println!("physics steps per second      {ours:10.0}   {:.2} of the bare rapier loop ({bare:.0})", ours / bare);
        println!("picture, rendered             {picture_ms:10.2} ms");
        println!("picture, encoded (WebP)       {webp_ms:10.2} ms");
        println!(
            "episodes per second per core  {:10.2}   recorded with pictures, {:.1} calls each",
            episodes / record_s,
            calls as f64 / episodes
        );
        println!("replay to record time         {:10.2}   {exact} of {} exact", replay_s / record_s, full.len());
        println!("trace bytes per episode       {bytes_full:10.0}   {bytes_without:.0} without pictures");
    }
    Ok(if exact == full.len() { Answer::Yes } else { Answer::No })
}

/// Steps per second with our digest of every step, and without anything of ours; interleaved, each the best of its rounds.
fn physics(scene: &Arc<Scene>, task: &Arc<Task>) -> (f64, f64) {
    let simulator = Simulator::new(scene.clone(), task.clone(), Profile::Paper, 0);
    let spawn = || {
        let models = simulator.object_models();
        let mut physics = Physics::new(simulator.model(), models.len());
        for (index, (object, model)) in task.objects.iter().zip(models).enumerate() {
            let [x, y, z] = object.position.map(|value| value as f32);
            physics.insert_object(index, model, Pose::yawed([x, y, z + 0.1], object.yaw as f32));
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
    (ours, bare)
}

/// Milliseconds per picture, rendered and encoded: the medians.
fn pictures(scene: &Arc<Scene>, task: &Arc<Task>) -> (f64, f64) {
    let mut simulator = Simulator::new(scene.clone(), task.clone(), Profile::Paper, 0);
    let (mut render, mut encode) = (Vec::new(), Vec::new());
    for index in 0..PICTURES {
        let target = &scene.receptacles[index as usize % scene.receptacles.len()].id;
        simulator.call(&reel_world::Tool::NavTo { receptacle: target.clone() });
        let begun = Instant::now();
        let frame = simulator.take_picture();
        render.push(begun.elapsed().as_secs_f64() * 1e3);
        let begun = Instant::now();
        std::hint::black_box(encode_webp(&frame.rgb, FRAME_WIDTH as u32, FRAME_HEIGHT as u32));
        encode.push(begun.elapsed().as_secs_f64() * 1e3);
    }
    (median(render), median(encode))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn mean_bytes(paths: &[PathBuf]) -> anyhow::Result<f64> {
    let sizes = paths.iter().map(|path| Ok(fs::metadata(path)?.len())).collect::<anyhow::Result<Vec<u64>>>()?;
    Ok(sizes.iter().sum::<u64>() as f64 / sizes.len().max(1) as f64)
}
