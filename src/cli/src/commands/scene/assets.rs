//! `reel scene check-assets`: what is in a folder of meshes.

use std::path::Path;

use anyhow::{Context, bail};
use reel_tasks::{
    assets::{AssetFolder, FileReport, MeshVerdict, Survey},
    library,
};
use serde_json::json;

use crate::ExitStatus;

/// Checks every mesh of a folder and prints which load and which are refused.
pub fn check(path: &Path, as_json: bool) -> anyhow::Result<ExitStatus> {
    let folder =
        AssetFolder::open(path).with_context(|| format!("cannot list {}", path.display()))?;
    let listed = folder.check();
    if listed.is_empty() {
        bail!(
            "no .glb, .gltf, .obj, .usd, .usda, .usdc or .usdz file in {}; each is named by the asset it shows, e.g. mug_01.glb",
            path.display()
        );
    }
    for file in &listed {
        if as_json {
            let mut row = json!(file);
            row["in_library"] = is_in_library(file).into();
            println!("{row}");
        } else {
            println!("{}", told(file));
        }
    }
    let count = |wanted: fn(&MeshVerdict) -> bool| {
        listed.iter().filter(|file| wanted(&file.verdict)).count()
    };
    let loads = count(|verdict| matches!(verdict, MeshVerdict::Loads(_)));
    let refused = count(|verdict| matches!(verdict, MeshVerdict::Refused { .. }));
    if !as_json {
        println!(
            "{loads} of {} files load, {refused} are refused",
            listed.len()
        );
        print_strangers(&listed);
    }
    Ok(if refused == 0 {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}

fn is_in_library(file: &FileReport) -> bool {
    let mut known = library::objects().iter();
    known.any(|object| object.asset.as_str() == file.asset)
}

/// Names the meshes that no object of the library has: a slip in a file name shows here, and
/// nowhere else.
fn print_strangers(listed: &[FileReport]) {
    const NAMED_MAX: usize = 5;
    let loads = |file: &&FileReport| matches!(file.verdict, MeshVerdict::Loads(_));
    let strangers: Vec<&str> = listed
        .iter()
        .filter(loads)
        .filter(|file| !is_in_library(file))
        .map(|file| file.asset.as_str())
        .collect();
    if strangers.is_empty() {
        return;
    }
    let named = &strangers[..strangers.len().min(NAMED_MAX)];
    let more = match strangers.len() - named.len() {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    println!(
        "note: no object of the library has the asset {}{more}; only tasks of your own that name it show it (reel scene objects lists the library)",
        named.join(", ")
    );
}

fn told(file: &FileReport) -> String {
    let name = &file.file;
    match &file.verdict {
        MeshVerdict::Refused { reason } => format!("{name}: REFUSED {reason}"),
        MeshVerdict::Hidden { by } => format!("{name}: not used, {by} comes first"),
        MeshVerdict::Loads(Survey {
            triangles,
            vertices,
            size: [x, y, z],
            manifold,
            watertight,
            textures,
            vertex_colors,
            digest,
        }) => {
            let skin = match (watertight, manifold) {
                (true, _) => "watertight",
                (false, true) => "open",
                (false, false) => "not manifold",
            };
            let mut looks: Vec<String> = textures
                .iter()
                .map(|[width, height]| format!("texture {width} x {height}"))
                .collect();
            looks.extend(vertex_colors.then(|| "colours of vertices".to_owned()));
            let looks = if looks.is_empty() {
                "plain".to_owned()
            } else {
                looks.join(", ")
            };
            let digest = digest.short();
            format!(
                "{name}: {triangles} triangles, {vertices} vertices, {x:.3} x {y:.3} x {z:.3}, {skin}, {looks}, {digest}"
            )
        }
    }
}
