//! `reel scene`: lists, makes, checks and draws scenes; lists the objects to put into them.

mod assets;
mod import;

use std::{
    fs, iter,
    path::{Path, PathBuf},
};

use anyhow::Context;
use reel_tasks::generate::{
    object_thumbnail,
    scene::{
        Brief, Finding, Plan, built_in, check, generate, names, names_with_parts, receptacle_views,
        with_parts,
    },
};
use reel_tasks::{
    library::{LibraryObject, objects},
    random::Stream,
};
use reel_world::Scene;
use serde_json::json;

use crate::{ExitStatus, inputs};

/// List, show, generate, check and draw scenes; check the meshes of objects.
///
/// Wherever a scene file is taken, the name of one that comes with Reel will do: `reel run --scene S3`.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// List the scenes that come with Reel, and what they have
    #[command(verbatim_doc_comment)]
    ///
    /// Example:
    ///   reel scene list
    List {
        /// Print the scenes as a JSON array
        #[arg(long)]
        json: bool,
    },
    /// Print the rooms of a scene with their furniture and its captions
    #[command(verbatim_doc_comment)]
    ///
    /// Examples:
    ///   reel scene show S3
    ///   reel scene show S7 --image s7.png    # each receptacle as the robot sees it, on one sheet
    Show {
        /// Name (S1 to S7, with shelves and drawers S1-parts to S7-parts, home) or file
        #[arg(value_name = "SCENE")]
        scene: PathBuf,
        /// Write a contact sheet: each receptacle from where the robot looks at it, doors open
        #[arg(long = "image", alias = "pictures", value_name = "PNG")]
        images: Option<PathBuf>,
        /// Print the scene file
        #[arg(long)]
        json: bool,
    },
    /// Generate a scene; equal seeds and sizes give equal scenes, and every one passes
    /// `reel scene check`
    #[command(verbatim_doc_comment)]
    ///
    /// Examples:
    ///   reel scene generate --seed 7 --out flat.json
    ///   reel scene generate --seed 7 --rooms 12 --receptacles 40 --out house.json
    ///   reel scene generate --seed 7 --like S3 --out s3_again.json    # the rooms and furniture of S3, arranged anew
    ///   reel scene generate --seed 7 --parts --out with_drawers.json
    Generate {
        /// Seed of every random draw
        #[arg(long, value_name = "N", default_value_t = 0)]
        seed: u64,
        /// Number of rooms in the new scene
        #[arg(long, value_name = "N", default_value_t = 6)]
        rooms: usize,
        /// How many receptacles; without it about two a room
        #[arg(long, value_name = "N")]
        receptacles: Option<usize>,
        /// With the rooms and furniture of this scene, by name or file
        #[arg(long, value_name = "SCENE", conflicts_with_all = ["rooms", "receptacles"])]
        like: Option<PathBuf>,
        /// Put shelves, drawers and compartments into some of the furniture
        #[arg(long)]
        parts: bool,
        /// Name of the scene; without it one of its size and seed
        #[arg(long, value_name = "NAME")]
        name: Option<String>,
        /// File to write; without it the scene goes to stdout
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Make scenes of houses and furniture of other simulators: ProcTHOR, USD, MJCF, URDF
    #[command(verbatim_doc_comment)]
    ///
    /// Example:
    ///   reel scene import house.json dresser.xml --out scenes
    ///
    /// Prints for each receptacle whether the robot reaches it, what was approximated, what was left
    /// out, and what `reel scene check` finds. Exit code 3: some files failed.
    Import(import::Arguments),
    /// Find the faults of a scene: furniture that overlaps, leaves its room, cannot be reached
    /// or seen, doors that hit something, passages under 0.9 m, captions that mislead. Exit code 1
    /// when there is anything
    #[command(verbatim_doc_comment)]
    ///
    /// Examples:
    ///   reel scene check S1 S2
    ///   reel scene check my_flat.json --json
    Check {
        /// Scenes to check, by name or file
        #[arg(value_name = "SCENE", required = true)]
        scenes: Vec<PathBuf>,
        /// Print the findings of each scene as JSON
        #[arg(long)]
        json: bool,
    },
    /// List the objects of the large library, all or some of them
    #[command(verbatim_doc_comment)]
    ///
    /// Example:
    ///   reel scene objects --sample 30 --seed 1 --image objects.png
    Objects {
        /// List only this many, drawn by the seed
        #[arg(long, value_name = "N")]
        sample: Option<usize>,
        /// Seed of the sample
        #[arg(long, value_name = "N", default_value_t = 0)]
        seed: u64,
        /// Write a contact sheet, each object with its caption
        #[arg(long = "image", alias = "pictures", value_name = "PNG")]
        images: Option<PathBuf>,
        /// Print the objects as a JSON array
        #[arg(long)]
        json: bool,
    },
    /// Draw the floor plan of a scene
    #[command(verbatim_doc_comment)]
    ///
    /// Example:
    ///   reel scene plan S3 --out s3.svg       # or .png
    Plan {
        /// Scene to draw, by name or file
        #[arg(value_name = "SCENE")]
        scene: PathBuf,
        /// File to write: its ending says whether SVG or PNG
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
    /// Read every mesh of a folder, and say what it is or why it is refused
    #[command(verbatim_doc_comment)]
    ///
    /// Example:
    ///   reel scene check-assets meshes
    ///
    /// Names meshes that no object of the library has, too. Exit code 1: a file is refused.
    CheckAssets {
        /// Folder of glTF, OBJ and USD files, each named by the asset it shows
        #[arg(value_name = "DIR")]
        folder: PathBuf,
        /// Print one JSON object per file
        #[arg(long)]
        json: bool,
    },
}

/// Lists, shows, generates, checks or draws scenes, or lists library objects.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match &arguments.command {
        Command::List { json } => list(*json),
        Command::Show {
            scene,
            images,
            json,
        } => show(scene, images.as_deref(), *json),
        Command::Generate {
            seed,
            rooms,
            receptacles,
            like,
            parts,
            name,
            out,
        } => {
            let (brief, default_name) = match like {
                Some(like) => {
                    let scene = inputs::scene(Some(like))?;
                    (Brief::of(&scene), format!("{}_like_{seed}", scene.scene_id))
                }
                None => {
                    let receptacles = receptacles.unwrap_or(rooms * 2);
                    (
                        Brief::draw(*rooms, receptacles, *seed)?,
                        format!("flat_{rooms}_{receptacles}_{seed}"),
                    )
                }
            };
            let mut scene = generate(&brief, name.as_ref().unwrap_or(&default_name), *seed)?;
            if *parts {
                scene = with_parts(&scene);
            }
            let text = scene_file(&scene)?;
            match out {
                Some(out) => {
                    write(out, text.as_bytes())?;
                    println!("{}: {}", out.display(), summary(&scene));
                }
                None => print!("{text}"),
            }
            Ok(ExitStatus::Success)
        }
        Command::CheckAssets { folder, json } => assets::check(folder, *json),
        Command::Import(arguments) => import::run(arguments),
        Command::Check { scenes, json } => check_all(scenes, *json),
        Command::Objects {
            sample,
            seed,
            images,
            json,
        } => list_objects(*sample, *seed, images.as_deref(), *json),
        Command::Plan { scene, out } => {
            let scene = inputs::scene(Some(scene))?;
            let plan = Plan::of(&scene);
            match out.extension().and_then(|ending| ending.to_str()) {
                Some("svg") => write(out, plan.svg().as_bytes())?,
                Some("png") => write(out, &plan.png()?)?,
                _ => anyhow::bail!("{}: a plan is written as .svg or .png", out.display()),
            }
            println!("{}", out.display());
            Ok(ExitStatus::Success)
        }
    }
}

fn list(as_json: bool) -> anyhow::Result<ExitStatus> {
    let scenes: Vec<Scene> = names()
        .chain(names_with_parts())
        .filter_map(built_in)
        .chain([reel_tasks::home_scene()])
        .collect();
    if as_json {
        let rows = scenes.iter().map(|scene| {
            json!({
                "scene": scene.scene_id,
                "rooms": scene.rooms.len(),
                "receptacles": scene.receptacles.len(),
                "parts": parts(scene),
                "captions": captions(scene),
            })
        });
        println!("{}", json!(rows.collect::<Vec<_>>()));
    } else {
        for scene in &scenes {
            println!("{:8} {}", scene.scene_id, summary(scene));
        }
    }
    Ok(ExitStatus::Success)
}

fn show(path: &Path, images: Option<&Path>, as_json: bool) -> anyhow::Result<ExitStatus> {
    let scene = inputs::scene(Some(path))?;
    if as_json {
        print!("{}", scene_file(&scene)?);
    } else {
        println!("{}: {}", scene.scene_id, summary(&scene));
        for room in &scene.rooms {
            let [width, depth] = [0, 1].map(|axis| room.max[axis] - room.min[axis]);
            println!("{}  {width:.1} x {depth:.1} m", room.name);
            let pieces = scene.receptacles.iter();
            let pieces = pieces.filter(|it| it.room == room.name && it.part_of.is_none());
            for piece in pieces.flat_map(|it| iter::once(it).chain(scene.parts_of(&it.id))) {
                let mut called: Vec<(&String, &f64)> = piece.captions.iter().collect();
                called.sort_by(|a, b| b.1.total_cmp(a.1));
                let called: Vec<&str> = called
                    .into_iter()
                    .map(|(caption, _)| caption.as_str())
                    .collect();
                let indent = if piece.part_of.is_some() { "  " } else { "" };
                let name = format!("{indent}{}", piece.id);
                println!("  {name:18} {}", called.join("; "));
            }
        }
    }
    if let Some(file) = images {
        write(file, &sheet(&scene)?)?;
    }
    Ok(ExitStatus::Success)
}

/// Every receptacle from where the robot looks at it, with what people call it.
fn sheet(scene: &Scene) -> anyhow::Result<Vec<u8>> {
    let called = |index: usize| {
        scene.receptacles[index]
            .captions
            .keys()
            .cloned()
            .collect::<Vec<_>>()
            .join("; ")
    };
    let cards = receptacle_views(scene)
        .into_iter()
        .enumerate()
        .map(|(index, view)| reel_view::SheetImage {
            image: view.frame.map(|frame| frame.rgb),
            title: view.receptacle.to_string(),
            text: called(index),
        });
    Ok(reel_view::sheet(
        &format!("{}: {}", scene.scene_id, summary(scene)),
        &cards.collect::<Vec<_>>(),
    )?)
}

fn list_objects(
    sample: Option<usize>,
    seed: u64,
    images: Option<&Path>,
    as_json: bool,
) -> anyhow::Result<ExitStatus> {
    let all: Vec<&LibraryObject> = objects().iter().collect();
    let listed = match sample {
        Some(count) => Stream::new(seed, "objects", 0).pick_some(&all, count),
        None => all,
    };
    if as_json {
        let row = |object: &&LibraryObject| {
            let LibraryObject {
                asset,
                category,
                purpose,
                caption,
                size,
                ..
            } = object;
            json!({ "asset": asset, "category": category, "purpose": purpose, "caption": caption, "size": size })
        };
        println!("{}", json!(listed.iter().map(row).collect::<Vec<_>>()));
    } else {
        listed
            .iter()
            .for_each(|object| println!("{:24} {}", object.asset.as_str(), object.caption));
    }
    if let Some(file) = images {
        let card = |object: &&LibraryObject| reel_view::SheetImage {
            image: Some(object_thumbnail(object).rgb),
            title: object.asset.to_string(),
            text: object.caption.clone(),
        };
        write(
            file,
            &reel_view::sheet("objects", &listed.iter().map(card).collect::<Vec<_>>())?,
        )?;
    }
    Ok(ExitStatus::Success)
}

fn check_all(paths: &[PathBuf], as_json: bool) -> anyhow::Result<ExitStatus> {
    let mut checked: Vec<(String, Vec<Finding>)> = Vec::new();
    for path in paths {
        let scene = inputs::scene(Some(path))?;
        checked.push((scene.scene_id.clone(), check(&scene)));
    }
    let fine = checked.iter().all(|(_, findings)| findings.is_empty());
    if as_json {
        let rows: Vec<_> = checked
            .iter()
            .map(|(scene, findings)| json!({ "scene": scene, "findings": findings }))
            .collect();
        println!("{}", json!(rows));
    } else {
        for (scene, findings) in &checked {
            for Finding {
                at,
                place: [x, y],
                message,
                ..
            } in findings
            {
                println!("{scene}: {at} at ({x:.2}, {y:.2}): {message}");
            }
            println!("{scene}: {} findings", findings.len());
        }
    }
    Ok(if fine {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}

fn captions(scene: &Scene) -> usize {
    scene
        .receptacles
        .iter()
        .map(|piece| piece.captions.len())
        .sum()
}

fn summary(scene: &Scene) -> String {
    let parts = match parts(scene) {
        0 => String::new(),
        parts => format!(" ({parts} of them parts of others)"),
    };
    format!(
        "{} rooms, {} receptacles{parts}, {} captions",
        scene.rooms.len(),
        scene.receptacles.len(),
        captions(scene)
    )
}

/// How many receptacles are shelves, drawers or compartments of others.
fn parts(scene: &Scene) -> usize {
    let receptacles = scene.receptacles.iter();
    receptacles.filter(|it| it.part_of.is_some()).count()
}

/// A scene as it stands in files.
pub fn scene_file(scene: &Scene) -> anyhow::Result<String> {
    Ok(serde_json::to_string_pretty(scene)? + "\n")
}

fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}
