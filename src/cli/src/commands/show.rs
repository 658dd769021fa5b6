//! `reel show`: a trace as a readable transcript.

use std::path::PathBuf;

use anyhow::{Context, bail};
use reel_replay::seek;
use reel_reward::{OpenReward, Preset};
use reel_trace::{Trace, sensors::SensorChannel};
use serde_json::json;

use crate::{ExitStatus, inputs};

/// Print a trace as a readable transcript: calls, outcomes, graph changes, reward.
///
/// Examples:
///   reel show traces-out/FDP_home_0001--oracle--0.mcap
///   reel show trace.mcap --at 4                # the state before call 4, that is after calls 0 to 3
///   reel show trace.mcap --json | jq '.steps[].outcome.text'
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Trace to print as a transcript
    #[arg(value_name = "TRACE")]
    trace: PathBuf,
    /// Print the state after this many calls instead: robot, gripper, markers, graph, motion,
    /// computed again bit for bit
    #[arg(long, value_name = "CALLS")]
    at: Option<usize>,
    #[command(flatten)]
    assets: inputs::Assets,
    #[command(flatten)]
    cache: inputs::Cache,
    /// Print header, steps, end, what is open of the reward and how many secrets were redacted as JSON; with --at, the
    /// state
    #[arg(long)]
    json: bool,
}

/// Prints a trace as a transcript, or its state after a number of calls.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let (trace, lost) = Trace::read_partial(&inputs::trace_files(), &arguments.trace)
        .context("cannot show the trace")?;
    if let Some(calls) = arguments.at {
        return at(
            &trace.with_meshes(&arguments.assets.open()?),
            calls,
            arguments,
        );
    }
    let open = open_reward(&trace).map(|open| open.to_string());
    if arguments.json {
        let sensors: Vec<_> = trace.sensors.iter().map(SensorChannel::summary).collect();
        let whole = json!({
            "header": trace.header, "task": trace.task, "scene": trace.scene, "start": trace.start, "steps": trace.steps, "end": trace.end,
            "open_reward": open, "sensors": sensors, "redacted": trace.redacted(),
        });
        println!("{whole}");
    } else {
        print!("{}", reel_view::transcript(&trace));
        if let Some(open) = open {
            println!("{open}");
        }
    }
    if let Some(lost) = lost {
        eprintln!("reel: {}: {lost}", arguments.trace.display());
        return Ok(ExitStatus::Partial);
    }
    Ok(ExitStatus::Success)
}

/// What the record leaves open of the reward under its preset. None also where the preset is a file,
/// which no trace holds.
fn open_reward(trace: &Trace) -> Option<OpenReward> {
    reel_reward::open_reward_of_record(
        &Preset::parse(&trace.header.reward_preset)?,
        &trace.header,
        &trace.task,
        &trace.scene,
        &trace.start,
        &trace.steps,
    )
}

fn at(trace: &Trace, calls: usize, arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let replay = match seek(trace, calls, arguments.cache.open().as_ref()) {
        Ok(replay) => replay,
        Err(verdict) => bail!(
            "{}: cannot go to call {calls}: {verdict}",
            trace.path.display()
        ),
    };
    let simulator = replay.episode().simulator();
    if arguments.json {
        let state = json!({
            "calls": calls, "state_digest": simulator.digest(), "sim_step": simulator.sim_step(), "robot": simulator.robot(),
            "held": simulator.held(), "landmark": simulator.landmark(), "markers": simulator.markers(),
            "graphs": simulator.graphs(), "bodies": simulator.bodies(),
        });
        println!("{state}");
    } else {
        print!("{}", reel_view::state_text(&replay));
    }
    Ok(ExitStatus::Success)
}
