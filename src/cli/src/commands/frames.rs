//! `reel frames`: the pictures of a trace as PNG files.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use reel_trace::Trace;
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH};
use serde_json::json;

use crate::Answer;

/// Write the pictures of a trace as PNG files, and a contact sheet of all of them.
/// Pictures that the trace leaves out are rendered again.
///
/// Example:
///   reel frames traces-out/FDP_home_0001--oracle--0.mcap --out pictures
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The trace
    #[arg(value_name = "TRACE")]
    trace: PathBuf,
    /// Folder for the pictures
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Only the contact sheet
    #[arg(long)]
    sheet_only: bool,
    /// Print the files as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<Answer> {
    let trace = Trace::read(&arguments.trace)?;
    fs::create_dir_all(&arguments.out).with_context(|| format!("cannot make the folder {}", arguments.out.display()))?;
    let mut files = Vec::new();
    if !arguments.sheet_only {
        for (step, rgb) in pictures(&trace)? {
            let name = step.map_or_else(|| "start.png".to_owned(), |step| format!("call_{step:03}.png"));
            let path = arguments.out.join(name);
            write(&path, &png(&rgb)?)?;
            files.push(path);
        }
    }
    if trace.image(None).is_some() {
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
    Ok(Answer::Yes)
}

/// The pictures as the trace holds them; where it holds none, rendered again by an exact replay.
fn pictures(trace: &Trace) -> anyhow::Result<Vec<(Option<u32>, Vec<u8>)>> {
    let mut pictures = Vec::new();
    for step in std::iter::once(None).chain(trace.steps.iter().map(|step| Some(step.step))) {
        if let Some(rgb) = trace.frame_rgb(step)? {
            pictures.push((step, rgb));
        }
    }
    if pictures.is_empty() {
        let replayed = reel_replay::replay_with(trace, |step, frame| pictures.push((step, frame.rgb.clone())));
        if let Err(verdict) = replayed {
            bail!("{}: the pictures cannot be made again: {verdict}", trace.path.display());
        }
    }
    Ok(pictures)
}

fn png(rgb: &[u8]) -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, FRAME_WIDTH as u32, FRAME_HEIGHT as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header()?.write_image_data(rgb)?;
    Ok(bytes)
}

fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}
