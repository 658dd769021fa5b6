//! `reel export lerobot`: a LeRobot dataset from traces.

use std::{fs, path::PathBuf};

use anyhow::{Context, bail};
use rayon::prelude::*;
use reel_lerobot::{
    DatasetDescription, EncodedEpisode, ExportSettings, LeRobotError, LeRobotWriter, encode,
};
use reel_replay::MotionRate;
use serde_json::json;

use super::shared::{CardOptions, command};
use crate::{ExitStatus, inputs, progress};

/// Episodes that replay exactly as a LeRobot dataset of version 3, which LeRobot 0.6 loads: state, action, rewards
/// and words in Parquet, and the robot's view as AV1 video.
///
/// Without --fps there is one frame for each decision: what the robot saw, and the call that it made. With --fps the
/// frames between are rendered, too: physics as it is executed again, and the robot on the route whose length the
/// simulator counts (the simulator itself sets the robot to its goal at once).
///
/// Examples:
///   reel export lerobot traces --out lerobot
///   reel export lerobot traces --out lerobot --fps 10 --successful --camera-size 640x480
///
/// Exit code 3: some traces were left out, since they do not replay exactly.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Traces, or folders of them
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Folder for the dataset, which must not be there
    #[arg(long, value_name = "DIR", default_value = "lerobot")]
    out: PathBuf,
    /// Frames per second, from 1 to 240; without it one frame for each decision
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=240))]
    fps: Option<u32>,
    /// Speed of the driving robot in metres per second, with --fps
    #[arg(long, value_name = "M/S", default_value_t = 0.5, requires = "fps")]
    drive_speed: f32,
    /// Speed of the turning robot in radians per second, with --fps
    #[arg(long, value_name = "RAD/S", default_value_t = 1.5, requires = "fps")]
    turn_speed: f32,
    /// Show the numbers of marked things, as the agent saw them
    #[arg(long, conflicts_with = "fps")]
    marks: bool,
    /// Leave out subtasks and calls in words, for tools that know LeRobot before 0.6
    #[arg(long)]
    no_language: bool,
    /// Only episodes that succeeded
    #[arg(long)]
    successful: bool,
    /// Width and height of the video in pixels, even numbers
    #[arg(long, value_name = "WxH", default_value = "320x240", value_parser = size)]
    camera_size: (usize, usize),
    /// Quantizer of the video, from 0 (best) to 255 (smallest)
    #[arg(long, value_name = "N", default_value_t = 60)]
    quantizer: u8,
    #[command(flatten)]
    assets: inputs::Assets,
    /// What the dataset is called
    #[arg(long, value_name = "NAME", default_value = "reel-lerobot")]
    name: String,
    #[command(flatten)]
    card: CardOptions,
    /// Seed of the wordings of subtasks
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Threads; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print the counts as JSON
    #[arg(long)]
    json: bool,
}

/// What became of a trace.
enum Outcome {
    Encoded(Box<EncodedEpisode>),
    Failed,
    Refused(String),
}

/// Writes a dataset of all traces that replay exactly.
pub fn execute(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let settings = arguments.settings()?;
    if arguments.out.exists() {
        bail!(
            "{} is there already; name a folder that is not",
            arguments.out.display()
        );
    }
    let files = inputs::trace_files();
    let paths = inputs::traces(&files, &arguments.paths)?;
    let bar = progress::bar(paths.len(), "lerobot");
    // What is interrupted does not stand where a dataset is looked for, and does not keep the next run from it.
    let mut unfinished = arguments.out.clone().into_os_string();
    unfinished.push(".part");
    let unfinished = PathBuf::from(unfinished);
    if LeRobotWriter::is_unfinished(&unfinished) {
        fs::remove_dir_all(&unfinished)
            .with_context(|| format!("cannot remove {}", unfinished.display()))?;
    } else if unfinished.exists() {
        bail!(
            "{} is there and is no rest of an interrupted export: move it away",
            unfinished.display()
        );
    }
    let mut writer = LeRobotWriter::create(&unfinished, settings)?;
    let pool = inputs::pool(arguments.jobs)?;
    let (mut tools, mut refused, mut failed) = (None, 0, 0);
    for batch in paths.chunks(pool.current_num_threads()) {
        let of_trace = |path: &PathBuf| -> anyhow::Result<_> {
            let trace = arguments.assets.read(&files, path)?;
            let names = trace.header.profile.names();
            if arguments.successful && !trace.end.as_ref().is_some_and(|end| end.metrics.success) {
                return Ok((names, Outcome::Failed));
            }
            let outcome = match encode(&trace, &settings) {
                Ok(episode) => Outcome::Encoded(Box::new(episode)),
                Err(error @ (LeRobotError::NotExact { .. } | LeRobotError::Empty { .. })) => {
                    Outcome::Refused(error.to_string())
                }
                Err(error) => return Err(error.into()),
            };
            Ok((names, outcome))
        };
        let encoded: Vec<anyhow::Result<_>> =
            pool.install(|| batch.par_iter().map(of_trace).collect());
        bar.inc(batch.len() as u64);
        for episode in encoded {
            let (names, outcome) = episode?;
            match outcome {
                Outcome::Encoded(episode) => {
                    tools.get_or_insert_with(|| reel_prompt::functions(names));
                    writer.add(&episode)?;
                }
                Outcome::Failed => failed += 1,
                Outcome::Refused(reason) => {
                    refused += 1;
                    bar.suspend(|| eprintln!("reel: {reason}"));
                }
            }
        }
    }
    bar.finish_and_clear();
    let Some(tools) = tools else {
        let _ = fs::remove_dir_all(&unfinished);
        bail!(
            "no dataset is written: of {} traces {failed} failed and {refused} do not replay exactly",
            paths.len()
        );
    };
    let words = crate::words();
    let words = words
        .iter()
        .skip(1)
        .map(|word| word.to_string_lossy().into_owned());
    let description = DatasetDescription {
        name: arguments.name.clone(),
        licence: arguments.card.licence.clone(),
        command: command(words),
    };
    let counts = writer.finish(&tools, &description)?;
    let out = &arguments.out;
    fs::rename(&unfinished, out).with_context(|| {
        format!(
            "cannot rename {} to {}",
            unfinished.display(),
            out.display()
        )
    })?;
    if arguments.json {
        println!(
            "{}",
            json!({
                "out": out, "episodes": counts.episodes, "frames": counts.frames, "tasks": counts.tasks,
                "fps": settings.fps(), "refused": refused, "failed": failed,
            })
        );
    } else {
        println!(
            "{} frames of {} episodes of {} tasks at {} fps in {}",
            counts.frames,
            counts.episodes,
            counts.tasks,
            settings.fps(),
            out.display()
        );
        if refused + failed > 0 {
            println!("  left out: {failed} that failed, {refused} that do not replay exactly");
        }
    }
    Ok(if refused == 0 {
        ExitStatus::Success
    } else {
        ExitStatus::Partial
    })
}

impl Arguments {
    fn settings(&self) -> anyhow::Result<ExportSettings> {
        for (name, speed) in [
            ("--drive-speed", self.drive_speed),
            ("--turn-speed", self.turn_speed),
        ] {
            if !(speed.is_finite() && (0.01..=100.0).contains(&speed)) {
                bail!("{name} is from 0.01 to 100, not {speed}");
            }
        }
        let rate = self.fps.map(|fps| MotionRate {
            fps,
            drive_m_s: self.drive_speed,
            turn_rad_s: self.turn_speed,
        });
        let (width, height) = self.camera_size;
        Ok(ExportSettings {
            rate,
            marks: self.marks,
            width,
            height,
            quantizer: self.quantizer,
            language: !self.no_language,
            seed: self.seed,
        })
    }
}

/// Two sides as `WIDTHxHEIGHT`.
fn size(text: &str) -> Result<(usize, usize), String> {
    let side = |text: &str| {
        let side: Option<usize> = text.parse().ok();
        let sides = reel_view::SIDE_MIN..=reel_view::SIDE_MAX;
        side.filter(|side| sides.contains(side) && side.is_multiple_of(2))
    };
    let sides = text.split_once('x');
    sides
        .and_then(|(width, height)| Some((side(width)?, side(height)?)))
        .ok_or_else(|| {
            let [min, max] = [reel_view::SIDE_MIN, reel_view::SIDE_MAX];
            format!("expected two even numbers from {min} to {max}, e.g. 320x240")
        })
}
