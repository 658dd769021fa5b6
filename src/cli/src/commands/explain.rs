//! `reel replay --explain` and `--state-at`: why a replay differs, for people and as JSON.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, bail};
use reel_replay::{EpisodePosition, Explanation, FieldChange, body_changes, explain, state_at};
use reel_trace::TraceFiles;
use reel_world::{Assets, record::BodyState};
use serde_json::json;

use crate::ExitStatus;

/// Most lines of differing fields that are printed for people; JSON has all.
const LINES: usize = 24;

/// Another build of reel.
pub struct Build<'a> {
    /// Path of the other build's executable.
    pub path: &'a Path,
    /// Its folder of meshes.
    pub assets: Option<&'a Path>,
}

/// Explains the first difference of each trace.
pub fn run(
    files: &TraceFiles,
    paths: &[PathBuf],
    assets: &dyn Assets,
    against: Option<&Build<'_>>,
    frames: Option<&Path>,
    as_json: bool,
) -> anyhow::Result<ExitStatus> {
    let mut all_exact = true;
    for path in paths {
        let trace = files.read(path)?.with_meshes(assets);
        let explanation = explain(&trace);
        all_exact &= explanation.verdict.is_exact();
        let other = against
            .map(|build| other_states(build, path, &explanation))
            .transpose()?
            .flatten();
        let frame = frames
            .map(|folder| draw(&explanation, path, folder))
            .transpose()?
            .flatten();
        if as_json {
            let mut line = serde_json::to_value(&explanation)?;
            line["trace"] = json!(path);
            line["at_step"] = json!(other);
            line["image_file"] = json!(frame);
            println!("{line}");
        } else {
            print(
                path,
                &explanation,
                against.map(|build| build.path),
                other.as_deref(),
                frame.as_deref(),
            );
        }
    }
    Ok(if all_exact {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}

/// Prints motion states after a physics step as JSON.
pub fn print_state(
    files: &TraceFiles,
    paths: &[PathBuf],
    assets: &dyn Assets,
    place: &str,
) -> anyhow::Result<ExitStatus> {
    let (call, step) = place
        .split_once(':')
        .context("--state-at takes CALL:STEP, e.g. 3:120 or start:499")?;
    let moment = match call {
        "start" => EpisodePosition::Start,
        call => EpisodePosition::Call(
            call.parse()
                .with_context(|| format!("'{call}' is no call; --state-at takes CALL:STEP"))?,
        ),
    };
    let step = step
        .parse()
        .with_context(|| format!("'{step}' is no physics step; --state-at takes CALL:STEP"))?;
    for path in paths {
        match state_at(&files.read(path)?.with_meshes(assets), moment, step) {
            Ok(Some(bodies)) => println!(
                "{}",
                json!({ "trace": path, "at": place, "bodies": bodies })
            ),
            Ok(None) => bail!(
                "{}: fewer than {} physics steps are executed there",
                path.display(),
                step + 1
            ),
            Err(verdict) => bail!("{}: {verdict}", path.display()),
        }
    }
    Ok(ExitStatus::Success)
}

/// What differs between the motion states of the other build and ours at the
/// first differing physics step.
fn other_states(
    build: &Build<'_>,
    trace: &Path,
    explanation: &Explanation,
) -> anyhow::Result<Option<Vec<FieldChange>>> {
    let reel_replay::Verdict::Diverged { divergence } = &explanation.verdict else {
        return Ok(None);
    };
    let (Some(step), Some(ours)) = (divergence.physics_step, &explanation.bodies) else {
        return Ok(None);
    };
    let place = match divergence.position {
        EpisodePosition::Call(call) => format!("{call}:{step}"),
        _ => format!("start:{step}"),
    };
    let Build {
        path: build,
        assets,
    } = build;
    let output = Command::new(build)
        // Not as an argument, which builds without meshes do not know.
        .envs(assets.map(|assets| ("REEL_ASSETS", assets)))
        .arg("replay")
        .arg(trace)
        .args(["--state-at", &place])
        .output()
        .with_context(|| format!("cannot run {}", build.display()))?;
    if !output.status.success() {
        bail!(
            "{} gave no states at {place}: {}",
            build.display(),
            String::from_utf8_lossy(&output.stderr).trim()
        );
    }
    let mut answer: serde_json::Value =
        serde_json::from_slice(&output.stdout).with_context(|| {
            format!(
                "{} did not answer as `reel replay --state-at` does",
                build.display()
            )
        })?;
    let theirs: Vec<BodyState> = serde_json::from_value(answer["bodies"].take())
        .context("the other build's states are unreadable")?;
    Ok(Some(body_changes(&theirs, ours)))
}

fn draw(explanation: &Explanation, trace: &Path, folder: &Path) -> anyhow::Result<Option<PathBuf>> {
    let Some(frame) = &explanation.image else {
        return Ok(None);
    };
    let (Some(recorded), Some(replayed)) = (&frame.recorded, &frame.replayed) else {
        return Ok(None);
    };
    fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let name = reel_trace::trace_stem(trace);
    let path = folder.join(format!("{name}.difference.png"));
    fs::write(&path, reel_view::image_difference(recorded, replayed)?)
        .with_context(|| format!("cannot write {}", path.display()))?;
    Ok(Some(path))
}

fn print(
    path: &Path,
    explanation: &Explanation,
    against: Option<&Path>,
    other: Option<&[FieldChange]>,
    frame_file: Option<&Path>,
) {
    println!("{}: {}", path.display(), explanation.verdict);
    if let (Some(build), Some(changes)) = (against, other) {
        println!(
            "  motion after the first differing physics step, {} and here:",
            build.display()
        );
        print_fields(changes);
    }
    if !explanation.fields.is_empty() {
        println!("  what differs after that call, recorded and here:");
        print_fields(&explanation.fields);
    }
    if let Some(text) = &explanation.text {
        println!("  text: {text}");
    }
    if let Some(frame) = &explanation.image {
        match (frame.pixels, frame.bbox, frame.most) {
            (Some(0), ..) => println!("  image: RGB is equal, ids or depth differ"),
            (Some(pixels), Some([x0, y0, x1, y1]), Some(most)) => {
                println!(
                    "  image: {pixels} pixels differ by up to {most}, from ({x0}, {y0}) to ({x1}, {y1})"
                );
            }
            _ => println!(
                "  image: differs; the trace does not hold the recorded one (expand it with the build that made it)"
            ),
        }
    }
    if let Some(file) = frame_file {
        println!("  image: {}", file.display());
    }
}

fn print_fields(changes: &[FieldChange]) {
    for change in changes.iter().take(LINES) {
        let body = change
            .body
            .as_ref()
            .map_or(String::new(), |body| format!("{body} "));
        let ulps = change
            .ulps
            .map_or(String::new(), |ulps| format!("   {ulps} ULP"));
        println!(
            "    {body}{}: {} | {}{ulps}",
            change.field, change.recorded, change.replayed
        );
    }
    if changes.len() > LINES {
        println!(
            "    and {} more fields; --json has all",
            changes.len() - LINES
        );
    }
}
