//! `reel trace frames`: the images of a trace as PNG files.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, anyhow, bail};
use reel_replay::Verdict;
use reel_trace::{FrameLayers, Trace, TraceError, encode_png, encode_png16};
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame};
use serde_json::json;

use crate::{ExitStatus, camera::Camera, inputs};

/// Write the frames of a trace as PNG files, and a contact sheet of all of them. Frames that the
/// trace leaves out are rendered again; so are those of other cameras, which show the robot.
/// --robot-camera writes the images that a robot's further camera recorded, as they came;
/// `reel show` lists the cameras.
///
/// Examples:
///   reel trace frames traces-out/FDP_home_0001--oracle--0.mcap --out images
///   reel trace frames trace.mcap --out images --at 4      # the image of call 4 alone, rendered again
///   reel trace frames trace.mcap --out images --at 4 --camera top-down
///   reel trace frames trace.mcap --out images --camera follow:target
///   reel trace frames trace.mcap --out images --camera free --eye 1,1,1.8 --look-at 3,2,0.8
///   reel trace frames trace.mcap --out images --layers rgb,depth,masks   # call_003.png, .depth.png, .masks.png
///   reel trace frames robot.mcap --out images --robot-camera wrist       # wrist_0000.jpeg and so on
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
    /// What to write of each frame: rgb (the image); depth (16-bit gray PNG, millimetres along the optical axis,
    /// 0 where nothing is); masks (16-bit gray PNG of instance ids, which instances.json names)
    #[arg(long, value_name = "LAYERS", value_delimiter = ',', default_value = "rgb", value_parser = ["rgb", "depth", "masks"])]
    layers: Vec<String>,
    /// The recorded images of this further camera of a robot instead, by its name or topic
    #[arg(long, value_name = "TOPIC", conflicts_with_all = ["at", "sheet_only", "layers", "camera"])]
    robot_camera: Option<String>,
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
    let mut output = Output {
        folder: &arguments.out,
        layers: &arguments.layers,
        files: Vec::new(),
    };
    if let Some(camera) = &arguments.robot_camera {
        return robot_camera(&trace, camera, output, arguments);
    }
    if let Some(call) = arguments.at {
        output.frame(Some(call), &frame_at(&trace, call, arguments)?)?;
    } else if !arguments.sheet_only {
        frames(&trace, &arguments.camera, &mut output)?;
    }
    if output.wants("masks") && !arguments.sheet_only {
        let table = reel_world::instances(&trace.task, &trace.scene);
        output.file("instances.json", &serde_json::to_vec_pretty(&table)?)?;
    }
    let sheet = arguments.at.is_none() && output.wants("rgb") && arguments.camera.is_head();
    if sheet && trace.image_count() > 0 {
        output.file("contact_sheet.png", &reel_view::contact_sheet(&trace)?)?;
    }
    let files = output.files;
    if arguments.json {
        println!("{}", json!({ "trace": arguments.trace, "files": files }));
    } else {
        for path in &files {
            println!("{}", path.display());
        }
    }
    Ok(ExitStatus::Success)
}

/// Writes the images of a robot's further camera as they were recorded.
fn robot_camera(
    trace: &Trace,
    camera: &str,
    mut output: Output<'_>,
    arguments: &Arguments,
) -> anyhow::Result<ExitStatus> {
    let Some(frames) = reel_import::robot::camera_frames(trace, camera) else {
        let cameras = trace.sensors.iter().filter_map(|channel| {
            let name = channel.camera.as_ref()?;
            Some(format!("{name} ({})", channel.topic))
        });
        let cameras: Vec<String> = cameras.collect();
        let known = match cameras.is_empty() {
            true => "it has no further camera".to_owned(),
            false => format!("there are: {}", cameras.join(", ")),
        };
        bail!("{}: no camera '{camera}'; {known}", trace.path.display())
    };
    let stem: String = camera
        .trim_start_matches('/')
        .chars()
        .map(|letter| {
            if letter.is_alphanumeric() {
                letter
            } else {
                '_'
            }
        })
        .collect();
    let (mut listed, mut status) = (Vec::new(), ExitStatus::Success);
    for (index, (unix_ns, image)) in frames.into_iter().enumerate() {
        match image {
            Ok(image) => {
                output.file(&format!("{stem}_{index:04}.{}", image.format), &image.data)?;
                listed.push(json!({
                    "file": output.files.last(), "unix_ns": unix_ns, "call": call_at(trace, unix_ns),
                }));
            }
            Err(why) => {
                eprintln!("reel: image {index} of {camera} at {unix_ns} ns cannot be read: {why}");
                status = ExitStatus::Partial;
            }
        }
    }
    if arguments.json {
        println!("{}", json!({ "trace": arguments.trace, "images": listed }));
    } else {
        for path in &output.files {
            println!("{}", path.display());
        }
    }
    Ok(status)
}

/// The call that was made last before a moment; `None` before the first.
fn call_at(trace: &Trace, unix_ns: u64) -> Option<u32> {
    let made = trace
        .timings
        .iter()
        .filter(|(_, timing)| timing.called_unix_ns <= unix_ns);
    made.map(|(step, _)| *step).max()
}

/// Writes all frames as the trace holds them; where it does not hold what is wanted, or from another
/// camera, rendered again by an exact replay.
fn frames(trace: &Trace, camera: &Camera, output: &mut Output<'_>) -> anyhow::Result<()> {
    let wanted = FrameLayers {
        depth: output.wants("depth"),
        masks: output.wants("masks"),
    };
    let holds = (!output.wants("rgb") || trace.image_count() > 0) && trace.has_layers(wanted);
    let mut written = Ok(());
    let mut write = |step, frame: &Frame| {
        if written.is_ok() {
            written = output.frame(step, frame);
        }
    };
    if !camera.is_head() {
        let viewpoint = camera.viewpoint(&trace.task)?;
        reel_replay::views(trace, &viewpoint, |view| write(view.step, &view.frame))
            .map_err(|verdict| not_rendered(trace, &verdict))?;
        return written;
    }
    if !holds {
        reel_replay::replay_with(trace, &mut write)
            .map_err(|verdict| not_rendered(trace, &verdict))?;
        return written;
    }
    for step in std::iter::once(None).chain(trace.steps.iter().map(|step| Some(step.step))) {
        let frame = Frame {
            depth_mm: read(wanted.depth, || trace.depth_mm(step))?,
            ids: read(wanted.masks, || trace.instance_ids(step))?,
            ..Frame::of_rgb(read(output.wants("rgb"), || trace.frame_rgb(step))?)
        };
        output.frame(step, &frame)?;
    }
    Ok(())
}

/// What a trace holds, where it is wanted.
fn read<T>(
    wanted: bool,
    read: impl FnOnce() -> Result<Option<Vec<T>>, TraceError>,
) -> Result<Vec<T>, TraceError> {
    let held = wanted.then(read).transpose()?;
    Ok(held.flatten().unwrap_or_default())
}

fn not_rendered(trace: &Trace, verdict: &Verdict) -> anyhow::Error {
    anyhow!(
        "{}: the frames cannot be rendered again: {verdict}",
        trace.path.display()
    )
}

/// The frame of one call, rendered again.
fn frame_at(trace: &Trace, call: u32, arguments: &Arguments) -> anyhow::Result<Frame> {
    let viewpoint = arguments.camera.viewpoint(&trace.task)?;
    let frame = reel_replay::view_at(
        trace,
        Some(call),
        &viewpoint,
        arguments.cache.open().as_ref(),
    );
    frame.map_err(|verdict| {
        anyhow!(
            "{}: cannot go to call {call}: {verdict}",
            trace.path.display()
        )
    })
}

/// The folder that is written to, and what is in it by now.
struct Output<'a> {
    folder: &'a Path,
    layers: &'a [String],
    files: Vec<PathBuf>,
}

impl Output<'_> {
    fn wants(&self, layer: &str) -> bool {
        self.layers.iter().any(|wanted| wanted == layer)
    }

    /// Writes what is wanted of a frame and is there.
    fn frame(&mut self, step: Option<u32>, frame: &Frame) -> anyhow::Result<()> {
        let name = step.map_or_else(|| "start".to_owned(), |step| format!("call_{step:03}"));
        let (width, height) = (FRAME_WIDTH as u32, FRAME_HEIGHT as u32);
        if self.wants("rgb") && !frame.rgb.is_empty() {
            self.file(
                &format!("{name}.png"),
                &encode_png(&frame.rgb, width, height),
            )?;
        }
        for (layer, values) in [("depth", &frame.depth_mm), ("masks", &frame.ids)] {
            if self.wants(layer) && !values.is_empty() {
                let png = encode_png16(values, width, height);
                self.file(&format!("{name}.{layer}.png"), &png)?;
            }
        }
        Ok(())
    }

    fn file(&mut self, name: &str, bytes: &[u8]) -> anyhow::Result<()> {
        let path = self.folder.join(name);
        fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
        self.files.push(path);
        Ok(())
    }
}
