//! `reel export coco`: annotated frames for segmentation and detection.

use std::path::PathBuf;

use reel_view::{CocoDataset, CocoError};
use serde_json::json;

use crate::{ExitStatus, camera::Camera, inputs, progress};

/// Frames of traces that replay exactly, with masks of everything in them, as COCO has it: `images/`,
/// `instances.json` (run-length encoded masks of receptacles and objects with category, box and
/// `visible_share`: which part of an instance's pixels nothing stands before), `panoptic/` and
/// `panoptic.json`. Each image names its episode, trace digest and step.
///
/// A frame is taken before the first call and after each. Images have no marks unless --marks asks for what the
/// agent got.
///
/// Examples:
///   reel export coco traces --out coco
///   reel export coco traces --out coco --camera top-down
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Traces, or folders of them
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Folder for the files, which must not be there
    #[arg(long, value_name = "DIR", default_value = "coco")]
    out: PathBuf,
    /// Images with the marks that the agent got
    #[arg(long)]
    marks: bool,
    #[command(flatten)]
    assets: inputs::Assets,
    #[command(flatten)]
    camera: Camera,
    /// Print the counts as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `reel export coco`.
pub fn execute(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    if arguments.out.exists() {
        anyhow::bail!(
            "{} is there already; name a folder that is not",
            arguments.out.display()
        );
    }
    let files = inputs::trace_files();
    let paths = inputs::traces(&files, &arguments.paths)?;
    let bar = progress::bar(paths.len(), "coco");
    let mut dataset = CocoDataset::create(&arguments.out)?;
    let mut refused = 0;
    for path in &paths {
        let trace = arguments.assets.read(&files, path)?;
        let viewpoint = arguments.camera.viewpoint(&trace.task)?;
        match dataset.add(&trace, &viewpoint, arguments.marks) {
            Ok(()) => {}
            Err(error @ CocoError::NotExact { .. }) => {
                refused += 1;
                bar.suspend(|| eprintln!("reel: {error}"));
            }
            Err(error) => return Err(error.into()),
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let counts = dataset.finish()?;
    if arguments.json {
        println!(
            "{}",
            json!({
                "out": arguments.out, "images": counts.images, "annotations": counts.annotations,
                "categories": counts.categories, "refused": refused,
            })
        );
    } else {
        println!(
            "{} images with {} masks of {} categories in {}",
            counts.images,
            counts.annotations,
            counts.categories,
            arguments.out.display()
        );
    }
    Ok(if refused == 0 {
        ExitStatus::Success
    } else {
        ExitStatus::Partial
    })
}
