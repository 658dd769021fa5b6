//! `reel trace video`: an episode as a video, with the calls as captions.

use std::{fs, path::PathBuf};

use anyhow::{Context, bail};
use reel_replay::{compare, views};
use reel_trace::Trace;
use reel_view::{Video, VideoSegment};
use serde_json::json;

use crate::{ExitStatus, camera::Camera, inputs};

/// Write an episode as GIF or MP4 (AV1): one frame a call, with the call, its result and the reward
/// as captions. An exact replay renders the frames, from any camera.
///
/// Examples:
///   reel trace video trace.mcap
///   reel trace video trace.mcap --camera top-down --out above.gif
///   reel trace video trace.mcap --compare branch.mcap --camera follow:target --fps 2
///   reel trace video trace.mcap --out episode.mp4          # AV1
///
/// Exit code 1: a trace does not replay exactly.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The trace to show as a video
    #[arg(value_name = "TRACE")]
    trace: PathBuf,
    /// Another trace of the task, e.g. a branch, to show beside it
    #[arg(long = "compare", alias = "beside", value_name = "TRACE")]
    beside: Option<PathBuf>,
    /// The file to write, .gif or .mp4; without it TRACE.gif in this folder
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    assets: inputs::Assets,
    #[command(flatten)]
    camera: Camera,
    /// Calls shown per second, from 0.01 to 50
    #[arg(long, value_name = "N", default_value_t = 0.7)]
    fps: f64,
    /// Print file, image size and number of images as JSON
    #[arg(long)]
    json: bool,
}

/// Replays one or two traces and writes their frames, with captions, as a GIF or MP4 file.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    if !(arguments.fps.is_finite() && (0.01..=50.0).contains(&arguments.fps)) {
        bail!("--fps is from 0.01 to 50, not {}", arguments.fps);
    }
    let default = || PathBuf::from(format!("{}.gif", reel_trace::trace_stem(&arguments.trace)));
    let out = arguments.out.clone().unwrap_or_else(default);
    let kind = out
        .extension()
        .map(|extension| extension.to_string_lossy().to_lowercase())
        .unwrap_or_default();
    if !["gif", "mp4"].contains(&kind.as_str()) {
        bail!("{}: a video is a .gif or an .mp4", out.display());
    }
    let files = inputs::trace_files();
    let traces: Vec<Trace> = [Some(&arguments.trace), arguments.beside.as_ref()]
        .into_iter()
        .flatten()
        .map(|path| arguments.assets.read(&files, path))
        .collect::<Result<_, _>>()?;
    if let [trace, beside] = &traces[..] {
        compare(trace, beside)?;
    }
    let mut images = Vec::new();
    for trace in &traces {
        let (mut seen, viewpoint) = (Vec::new(), arguments.camera.viewpoint(&trace.task)?);
        match views(trace, &viewpoint, |view| seen.push(view.frame.rgb)) {
            Ok(()) => images.push(seen),
            Err(verdict) => {
                eprintln!(
                    "reel: {}: the frames cannot be rendered: {verdict}",
                    trace.path.display()
                );
                return Ok(ExitStatus::CheckFailed);
            }
        }
    }
    let parts: Vec<VideoSegment<'_>> = traces
        .iter()
        .zip(&images)
        .map(|(trace, images)| VideoSegment {
            trace,
            frames: images,
        })
        .collect();
    let film = Video::new(&parts);
    match kind.as_str() {
        "mp4" => film.write_mp4(arguments.fps, &out)?,
        _ => fs::write(&out, film.gif(arguments.fps)?)
            .with_context(|| format!("cannot write {}", out.display()))?,
    }
    let bytes = fs::metadata(&out).map_or(0, |file| file.len());
    let Video {
        width,
        height,
        frames: images,
    } = &film;
    if arguments.json {
        println!(
            "{}",
            json!({ "file": out, "width": width, "height": height, "frames": images.len(), "bytes": bytes })
        );
    } else {
        println!(
            "{}: {} frames of {width} x {height}, {} KB",
            out.display(),
            images.len(),
            bytes / 1000
        );
    }
    Ok(ExitStatus::Success)
}
