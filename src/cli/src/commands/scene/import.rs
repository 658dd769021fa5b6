//! `reel scene import`: houses and furniture of other simulators as scene files.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use anyhow::Context;
use reel_scene_import::{ImportOptions, ImportReport, Imported, Note, SceneFormat, import};
use serde_json::json;

use super::{scene_file, write};
use crate::ExitStatus;

/// Kinds of what was approximated or left out that are printed; `--json` has all.
const KINDS_SHOWN: usize = 12;

/// Houses and furniture to import.
#[derive(clap::Args)]
pub struct Arguments {
    /// Files to import: ProcTHOR houses (.json), USD (.usda, .usdc, .usdz, .usd), MJCF
    /// (.xml, .mjcf), URDF (.urdf)
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    /// Folder for the scene files, one for each file, named as the scene
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Format of the files; without it by ending and content
    #[arg(long, value_name = "FORMAT", value_parser = format)]
    format: Option<SceneFormat>,
    /// Sizes of ProcTHOR's assets: JSON, {"asset": [x, y, z]} or its asset-database.json; without
    /// it a typical size of each category
    #[arg(long, value_name = "FILE")]
    asset_sizes: Option<PathBuf>,
    /// Print the reports as a JSON array
    #[arg(long)]
    json: bool,
}

fn format(name: &str) -> Result<SceneFormat, String> {
    SceneFormat::parse(name).ok_or_else(|| {
        let names = SceneFormat::ALL.map(SceneFormat::as_str);
        format!("there are {}", names.join(", "))
    })
}

/// Imports files, writes a scene for each and prints what became of them.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let options = ImportOptions {
        format: arguments.format,
        asset_sizes: arguments.asset_sizes.as_deref().map(sizes).transpose()?,
        scene_id: None,
    };
    fs::create_dir_all(&arguments.out)
        .with_context(|| format!("cannot make the folder {}", arguments.out.display()))?;
    let mut written: BTreeMap<PathBuf, &Path> = BTreeMap::new();
    let mut reports = Vec::new();
    let mut failed = 0;
    for path in &arguments.files {
        let Imported { scene, report } = match import(path, &options) {
            Ok(imported) => imported,
            Err(error) => {
                let error = error.to_string();
                let name = path.file_name().unwrap_or_default().to_string_lossy();
                // an error in another file, which this one names, begins with that one's name
                let said = error.strip_prefix(&format!("{name}: ")).unwrap_or(&error);
                eprintln!("reel: {}: {said}", path.display());
                failed += 1;
                continue;
            }
        };
        let out = arguments.out.join(format!("{}.json", scene.scene_id));
        if let Some(other) = written.get(&out) {
            eprintln!(
                "reel: {}: {} is written from {} already; rename one of them",
                path.display(),
                out.display(),
                other.display()
            );
            failed += 1;
            continue;
        }
        write(&out, scene_file(&scene)?.as_bytes())?;
        written.insert(out.clone(), path);
        if !arguments.json {
            print_report(&report, &out);
        }
        reports.push((out, report));
    }
    if arguments.json {
        let row = |(out, report): &(PathBuf, ImportReport)| {
            let mut row = json!(report);
            row["scene_file"] = json!(out);
            row
        };
        println!("{}", json!(reports.iter().map(row).collect::<Vec<_>>()));
    }
    Ok(match (failed, reports.len()) {
        (0, _) => ExitStatus::Success,
        (_, 0) => ExitStatus::BadInput,
        _ => ExitStatus::Partial,
    })
}

fn sizes(path: &Path) -> anyhow::Result<(String, String)> {
    let text =
        fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    Ok((text, path.display().to_string()))
}

fn print_report(report: &ImportReport, out: &Path) {
    println!(
        "{}: {}, {} rooms, {} receptacles, {} of them reached",
        out.display(),
        report.format,
        report.rooms,
        report.receptacles.len(),
        report.reached()
    );
    for receptacle in &report.receptacles {
        let reached = if receptacle.reached {
            ""
        } else {
            "  NOT REACHED"
        };
        println!("  {:20} {}{reached}", receptacle.id, receptacle.caption);
    }
    for (title, kinds) in [
        ("approximated", &report.approximated),
        ("left out", &report.left_out),
    ] {
        for (kind, note) in kinds.iter().take(KINDS_SHOWN) {
            println!("  {title}: {} x {kind}{}", note.count, named(note));
        }
        if kinds.len() > KINDS_SHOWN {
            println!(
                "  {title}: {} more kinds, see --json",
                kinds.len() - KINDS_SHOWN
            );
        }
    }
    for line in report.warnings.iter().chain(&report.findings) {
        println!("  check: {line}");
    }
}

/// In brackets, the first pieces of the file that a note concerns.
fn named(note: &Note) -> String {
    const NAMED_SHOWN: usize = 4;
    if note.of.is_empty() {
        return String::new();
    }
    let shown = note.of.len().min(NAMED_SHOWN);
    let more = if note.of.len() > shown { ", ..." } else { "" };
    format!(" ({}{more})", note.of[..shown].join(", "))
}
