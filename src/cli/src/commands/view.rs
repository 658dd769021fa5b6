//! `reel view`: an episode in Rerun.

use std::{env, io::ErrorKind, net::SocketAddr, path::PathBuf, process::Command};

use anyhow::{Context, bail};
use reel_trace::FrameLayers;

use crate::{ExitStatus, inputs};

/// Open an episode in Rerun: the world in 3D, the robot's camera, the transcript and the rewards on
/// one timeline. Without an installed Rerun, Reel serves Rerun's web viewer until Ctrl-C.
///
/// Examples:
///   reel view traces/FDP_home_0001--oracle--0.mcap
///   reel view traces/FDP_home_0001--oracle--0.mcap --at 12 --web
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The trace of the episode to open
    #[arg(value_name = "TRACE")]
    trace: PathBuf,
    /// The step to begin at (in the web viewer)
    #[arg(long, value_name = "STEP")]
    at: Option<usize>,
    #[command(flatten)]
    assets: inputs::Assets,
    /// The web viewer, even where Rerun is installed
    #[arg(long)]
    web: bool,
    /// Where the web viewer listens
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:9876")]
    listen: SocketAddr,
    /// Show of each frame besides: depth (as a point cloud, too), masks (with the names of instances), or
    /// both with a comma between
    #[arg(long, value_name = "LAYERS", default_value = "", hide_default_value = true, value_parser = inputs::layers)]
    layers: FrameLayers,
}

/// Opens an episode in Rerun, or serves Reel's web viewer until Ctrl-C.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let trace = arguments
        .assets
        .read(&inputs::trace_files(), &arguments.trace)?;
    let last = trace.steps.len().checked_sub(1);
    if let Some(step) = arguments
        .at
        .filter(|step| last.is_none_or(|last| *step > last))
    {
        bail!(
            "there is no step {step}: the episode has {} steps",
            trace.steps.len()
        );
    }
    let recording = reel_view::rrd(&trace, arguments.layers)?;
    if !arguments.web {
        let file = env::temp_dir().join(format!(
            "reel-{}-{}.rrd",
            trace.header.episode_id,
            std::process::id()
        ));
        std::fs::write(&file, &recording)
            .with_context(|| format!("cannot write {}", file.display()))?;
        let ended = Command::new("rerun").arg(&file).status();
        let _ = std::fs::remove_file(&file);
        match ended {
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            ended => {
                let ended = ended.context("cannot run rerun; `--web` needs none")?;
                return Ok(if ended.success() {
                    ExitStatus::Success
                } else {
                    ExitStatus::CheckFailed
                });
            }
        }
    }
    serve(arguments, recording)
}

#[cfg(all(feature = "service", feature = "rerun-viewer"))]
fn serve(arguments: &Arguments, recording: Vec<u8>) -> anyhow::Result<ExitStatus> {
    // A name for the address; what the file is called otherwise is of no concern there.
    let name = reel_trace::trace_stem(&arguments.trace);
    let name: String = name
        .chars()
        .map(|c| {
            if c.is_ascii_alphanumeric() || "-_.".contains(c) {
                c
            } else {
                '-'
            }
        })
        .collect();
    reel_server::view(
        arguments.listen,
        &name,
        arguments.at,
        recording,
        |address| {
            println!("{address}");
            println!("open it in a browser; Ctrl-C stops");
        },
    )?;
    Ok(ExitStatus::Success)
}

#[cfg(not(all(feature = "service", feature = "rerun-viewer")))]
fn serve(_: &Arguments, _: Vec<u8>) -> anyhow::Result<ExitStatus> {
    bail!(
        "Rerun is not installed (pip install rerun-sdk==0.36.3), and this build of reel has no web viewer"
    )
}
