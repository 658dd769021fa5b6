//! `reel export`: training sets and recordings for other tools.

#[cfg(feature = "analytics")]
mod atif;
mod coco;
#[cfg(feature = "analytics")]
mod inspect;
#[cfg(feature = "analytics")]
mod lerobot;
#[cfg(feature = "analytics")]
mod otel;
#[cfg(feature = "analytics")]
mod preferences;
#[cfg(feature = "analytics")]
mod readable;
mod real_annotation;
mod real_eval;
#[cfg(feature = "analytics")]
mod rl;
#[cfg(feature = "analytics")]
mod sft;
#[cfg(feature = "analytics")]
mod shared;

#[cfg(feature = "analytics")]
pub use rl::Grouping;
#[cfg(feature = "analytics")]
pub use shared::{StoreSource, format};

use std::path::PathBuf;

use serde_json::json;

use crate::ExitStatus;

/// Write training sets and recordings for other tools.
#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    #[command(
        about = "Supervised training sets: what the agent saw before a decision, and what it should do"
    )]
    #[cfg(feature = "analytics")]
    Sft(Box<sft::Arguments>),
    #[command(about = "Rollout groups for reinforcement learning: rewards, returns and advantages")]
    #[cfg(feature = "analytics")]
    Rl(Box<rl::Arguments>),
    #[command(
        about = "Preference pairs: failed decisions beside their smallest repairs, and value targets"
    )]
    #[cfg(feature = "analytics")]
    Preferences(preferences::Arguments),
    #[command(about = "Traces as the eval_output that REAL's published agents write")]
    RealEval(real_eval::Arguments),
    #[command(about = "Traces in the files of REAL's annotation script")]
    #[cfg(feature = "analytics")]
    RealAnnotation(real_annotation::Arguments),
    #[command(about = "Traces as trajectories of ATIF, which other tools for agents read")]
    #[cfg(feature = "analytics")]
    Atif(atif::Arguments),
    #[command(about = "Traces as logs of Inspect, for its viewer and Inspect Scout")]
    #[cfg(feature = "analytics")]
    Inspect(inspect::Arguments),
    #[command(about = "Traces as spans of OpenTelemetry, in files or to a collector")]
    #[cfg(feature = "analytics")]
    Otel(otel::Arguments),
    #[command(about = "Episodes with their motion and video as a LeRobot dataset")]
    #[cfg(feature = "analytics")]
    Lerobot(Box<lerobot::Arguments>),
    #[command(about = "Frames of traces with masks of everything in them, as COCO has it")]
    Coco(coco::Arguments),
    /// One episode as a Rerun recording: images, transforms, boxes, transcript, rewards
    #[cfg(feature = "rerun")]
    #[command(verbatim_doc_comment)]
    ///
    /// Example:
    ///   reel export rrd traces-out/FDP_home_0001--oracle--0.mcap --out episode.rrd
    Rrd {
        /// Trace of the episode to export
        #[arg(value_name = "TRACE")]
        trace: PathBuf,
        /// Show of each frame besides: depth (as a point cloud, too), masks (with the names of
        /// instances), or both with a comma between
        #[arg(long, value_name = "LAYERS", default_value = "", hide_default_value = true, value_parser = crate::inputs::layers)]
        layers: reel_trace::FrameLayers,
        /// Rerun recording (.rrd) to write
        #[arg(long, value_name = "FILE", default_value = "episode.rrd")]
        out: PathBuf,
        /// Print the path of the recording as JSON
        #[arg(long)]
        json: bool,
    },
    /// One episode as a glTF 2.0 binary: the scene's surfaces, and every move as an animation
    #[command(verbatim_doc_comment)]
    ///
    /// Second 0 of the animation is the start, second k + 1 the end of step k. Nodes are named by
    /// receptacle and object; `extras` say kind, category, target and goal. Units are metres.
    ///
    /// Example:
    ///   reel export gltf traces-out/FDP_home_0001--oracle--0.mcap --out episode.glb
    Gltf {
        /// Trace of the episode to export
        #[arg(value_name = "TRACE")]
        trace: PathBuf,
        #[command(flatten)]
        assets: crate::inputs::Assets,
        /// The glTF binary to write
        #[arg(long, value_name = "FILE", default_value = "episode.glb")]
        out: PathBuf,
        /// Print the path of the file as JSON
        #[arg(long)]
        json: bool,
    },
    /// A contact sheet PNG of one episode
    #[command(verbatim_doc_comment)]
    ///
    /// Example:
    ///   reel export sheet traces-out/FDP_home_0001--oracle--0.mcap --out sheet.png
    Sheet {
        /// Trace of the episode to draw
        #[arg(value_name = "TRACE")]
        trace: PathBuf,
        /// PNG file of the contact sheet
        #[arg(long, value_name = "FILE", default_value = "contact_sheet.png")]
        out: PathBuf,
        /// Print the path of the contact sheet as JSON
        #[arg(long)]
        json: bool,
    },
}

/// Writes the training set, recording or contact sheet that the subcommand names.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match &arguments.command {
        #[cfg(feature = "analytics")]
        Command::Sft(arguments) => sft::run(arguments),
        #[cfg(feature = "analytics")]
        Command::Rl(arguments) => rl::run(arguments),
        #[cfg(feature = "analytics")]
        Command::Preferences(arguments) => preferences::run(arguments),
        Command::RealEval(arguments) => real_eval::execute(arguments),
        #[cfg(feature = "analytics")]
        Command::Atif(arguments) => atif::execute(arguments),
        #[cfg(feature = "analytics")]
        Command::Inspect(arguments) => inspect::execute(arguments),
        #[cfg(feature = "analytics")]
        Command::Otel(arguments) => otel::execute(arguments),
        #[cfg(feature = "analytics")]
        Command::Lerobot(arguments) => lerobot::execute(arguments),
        Command::Coco(arguments) => coco::execute(arguments),
        #[cfg(feature = "analytics")]
        Command::RealAnnotation(arguments) => real_annotation::run(arguments),
        #[cfg(feature = "rerun")]
        Command::Rrd {
            trace,
            layers,
            out,
            json,
        } => {
            std::fs::write(
                out,
                reel_view::rrd(&crate::inputs::trace_files().read(trace)?, *layers)?,
            )?;
            if *json {
                println!("{}", json!({ "out": out }));
            } else {
                println!(
                    "{}: open it with `rerun {0}`; `reel view` needs no Rerun",
                    out.display()
                );
            }
            Ok(ExitStatus::Success)
        }
        Command::Gltf {
            trace,
            assets,
            out,
            json,
        } => {
            let trace = assets.read(&crate::inputs::trace_files(), trace)?;
            std::fs::write(out, reel_view::glb(&trace))?;
            if *json {
                println!("{}", json!({ "out": out }));
            } else {
                println!("{}", out.display());
            }
            Ok(ExitStatus::Success)
        }
        Command::Sheet { trace, out, json } => {
            std::fs::write(
                out,
                reel_view::contact_sheet(&crate::inputs::trace_files().read(trace)?)?,
            )?;
            if *json {
                println!("{}", json!({ "out": out }));
            } else {
                println!("{}", out.display());
            }
            Ok(ExitStatus::Success)
        }
    }
}
