//! `reel trace frames`: the images of a trace as PNG files.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, anyhow, bail};
use reel_trace::{Trace, encode_png};
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH};
use serde_json::json;

use crate::{ExitStatus, camera::Camera, inputs};

/// Write the frames of a trace as PNG files, and a contact sheet of all of them. Frames that the
/// trace leaves out are rendered again; so are those of other cameras, which show the robot.
///
/// Examples:
///   reel trace frames traces-out/FDP_home_0001--oracle--0.mcap --out images
///   reel trace frames trace.mcap --out images --at 4      # the image of call 4 alone, rendered again
///   reel trace frames trace.mcap --out images --at 4 --camera top-down
///   reel trace frames trace.mcap --out images --camera follow:target
///   reel trace frames trace.mcap --out images --camera free --eye 1,1,1.8 --look-at 3,2,0.8
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Trace whose frames are written as PNG files
    #[arg(value_name = "TRACE")]
    trace: PathBuf,
    /// Folder for the images
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Only the frame after this call (from 0), rendered again; the head camera's view if the call
    /// gave none
    #[arg(long, value_name = "CALL")]
    at: Option<u32>,
    #[command(flatten)]
    assets: inputs::Assets,
    #[command(flatten)]
    camera: Camera,
    #[command(flatten)]
    cache: inputs::Cache,
    /// Only the contact sheet
    #[arg(long, conflicts_with = "at")]
    sheet_only: bool,
    /// Print the files as JSON
    #[arg(long)]
    json: bool,
}

/// Writes the frames of a trace, or of one call, as PNG files.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let trace = arguments
        .assets
        .read(&inputs::trace_files(), &arguments.trace)?;
    fs::create_dir_all(&arguments.out)
        .with_context(|| format!("cannot make the folder {}", arguments.out.display()))?;
    let mut files = Vec::new();
    if let Some(call) = arguments.at {
        let path = arguments.out.join(file_name(Some(call)));
        write(&path, &png(&image_at(&trace, call, arguments)?))?;
        files.push(path);
    } else if !arguments.sheet_only {
        for (step, rgb) in images(&trace, &arguments.camera)? {
            let path = arguments.out.join(file_name(step));
            write(&path, &png(&rgb))?;
            files.push(path);
        }
    }
    if arguments.at.is_none() && trace.image_count() > 0 && arguments.camera.is_head() {
        let path = arguments.out.join("contact_sheet.png");
        write(&path, &reel_view::contact_sheet(&trace)?)?;
        files.push(path);
    }
    if arguments.json {
        println!("{}", json!({ "trace": arguments.trace, "files": files }));
    } else {
        for path in &files {
            println!("{}", path.display());
        }
    }
    Ok(ExitStatus::Success)
}

/// The images as the trace holds them; where it holds none, or from another camera, rendered
/// again by an exact replay.
fn images(trace: &Trace, camera: &Camera) -> anyhow::Result<Vec<(Option<u32>, Vec<u8>)>> {
    let mut images = Vec::new();
    if !camera.is_head() {
        let views = reel_replay::views(trace, &camera.viewpoint(&trace.task)?);
        let views = views.map_err(|verdict| {
            anyhow!(
                "{}: the frames cannot be rendered: {verdict}",
                trace.path.display()
            )
        })?;
        let moments = std::iter::once(None).chain(trace.steps.iter().map(|step| Some(step.step)));
        return Ok(moments.zip(views).collect());
    }
    for step in std::iter::once(None).chain(trace.steps.iter().map(|step| Some(step.step))) {
        if let Some(rgb) = trace.frame_rgb(step)? {
            images.push((step, rgb));
        }
    }
    if images.is_empty() {
        let replayed =
            reel_replay::replay_with(trace, |step, frame| images.push((step, frame.rgb.clone())));
        if let Err(verdict) = replayed {
            bail!(
                "{}: the frames cannot be rendered again: {verdict}",
                trace.path.display()
            );
        }
    }
    Ok(images)
}

/// The image of one call, rendered again.
fn image_at(trace: &Trace, call: u32, arguments: &Arguments) -> anyhow::Result<Vec<u8>> {
    let viewpoint = arguments.camera.viewpoint(&trace.task)?;
    let image = reel_replay::view_at(
        trace,
        Some(call),
        &viewpoint,
        arguments.cache.open().as_ref(),
    );
    image.map_err(|verdict| {
        anyhow!(
            "{}: cannot go to call {call}: {verdict}",
            trace.path.display()
        )
    })
}

fn file_name(step: Option<u32>) -> String {
    step.map_or_else(
        || "start.png".to_owned(),
        |step| format!("call_{step:03}.png"),
    )
}

fn png(rgb: &[u8]) -> Vec<u8> {
    encode_png(rgb, FRAME_WIDTH as u32, FRAME_HEIGHT as u32)
}

fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}
