//! Scenes: those that come along, those made by seed, what is wrong with one, and its floor plan.

mod brief;
mod captions;
mod check;
mod flat;
mod furnish;
mod image;
mod kinds;
mod looks;
mod parts;
mod plan;
mod plan_png;

use std::collections::BTreeMap;

use crate::random::Stream;
use reel_world::{Attributes, Door, Receptacle, Rect, Room, Scene};

pub use brief::{Brief, ROOMS_MAX};
pub use check::{Finding, PASSAGE_M, SceneFault, check};
pub use image::{View, receptacle_views};
pub use parts::with_parts;
pub use plan::Plan;

use self::{
    flat::{Flat, metres},
    furnish::Piece,
};

/// Flats that are tried for one scene.
const TRIES: usize = 60;
/// How often the rooms of one flat that have faults are furnished anew.
const REPAIRS: usize = 8;

/// The scenes that come along: six to train in, and the last to be evaluated in.
const BUILT_IN: [(&str, &str); 7] = [
    ("S1", include_str!("../../../data/scenes/S1.json")),
    ("S2", include_str!("../../../data/scenes/S2.json")),
    ("S3", include_str!("../../../data/scenes/S3.json")),
    ("S4", include_str!("../../../data/scenes/S4.json")),
    ("S5", include_str!("../../../data/scenes/S5.json")),
    ("S6", include_str!("../../../data/scenes/S6.json")),
    ("S7", include_str!("../../../data/scenes/S7.json")),
];

/// The same scenes with shelves, drawers and compartments in some of the furniture
/// ([`with_parts`]).
const WITH_PARTS: [(&str, &str); 7] = [
    (
        "S1-parts",
        include_str!("../../../data/scenes/S1-parts.json"),
    ),
    (
        "S2-parts",
        include_str!("../../../data/scenes/S2-parts.json"),
    ),
    (
        "S3-parts",
        include_str!("../../../data/scenes/S3-parts.json"),
    ),
    (
        "S4-parts",
        include_str!("../../../data/scenes/S4-parts.json"),
    ),
    (
        "S5-parts",
        include_str!("../../../data/scenes/S5-parts.json"),
    ),
    (
        "S6-parts",
        include_str!("../../../data/scenes/S6-parts.json"),
    ),
    (
        "S7-parts",
        include_str!("../../../data/scenes/S7-parts.json"),
    ),
];

/// Why a scene cannot be made or drawn.
#[derive(Clone, PartialEq, Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum SceneError {
    /// Too many rooms, or none.
    #[error("a scene has 1 to {most} rooms, not {asked}")]
    Rooms { asked: usize, most: usize },
    /// Too many receptacles, or none.
    #[error("a scene of {rooms} rooms has 1 to {most} receptacles, not {asked}")]
    Receptacles {
        rooms: usize,
        asked: usize,
        most: usize,
    },
    /// No flat was found.
    #[error(
        "no flat was found in {tries} tries for these rooms and this furniture; another seed or less furniture may do"
    )]
    NoFlat { tries: usize },
    /// An image cannot be encoded.
    #[error("cannot encode the floor plan: {reason}")]
    Png { reason: String },
}

/// The names of the scenes that come along.
pub fn names() -> impl Iterator<Item = &'static str> {
    BUILT_IN.iter().map(|(name, _)| *name)
}

/// The names of the same scenes with shelves and drawers.
pub fn names_with_parts() -> impl Iterator<Item = &'static str> {
    WITH_PARTS.iter().map(|(name, _)| *name)
}

/// A scene that comes along, by name: one of [`names`] or [`names_with_parts`], or the home of old.
pub fn built_in(name: &str) -> Option<Scene> {
    if name == "home" {
        return Some(crate::home_scene());
    }
    let mut known = BUILT_IN.iter().chain(&WITH_PARTS);
    let (name, text) = known.find(|(known, _)| *known == name)?;
    Some(
        crate::scene::parse(text, name)
            .expect("the committed scenes are well formed")
            .scene,
    )
}

/// A scene that comes along, by its id: what tasks call it.
pub fn by_id(scene_id: &str) -> Option<Scene> {
    built_in(scene_id).filter(|scene| scene.scene_id == scene_id)
}

/// Makes a scene: equal briefs, names and seeds give equal scenes, and what
/// it gives passes [`check`].
///
/// # Errors
/// When no flat is found that takes all of it.
pub fn generate(brief: &Brief, scene_id: &str, seed: u64) -> Result<Scene, SceneError> {
    let scene = (0..TRIES).find_map(|index| {
        let mut stream = Stream::new(seed, "scene", index);
        let flat = flat::arrange(brief, &mut stream)?;
        let rooms = 0..flat.plots.len();
        let mut pieces: Vec<Vec<Piece>> = rooms
            .map(|room| furnish::furnish(&flat, room, &mut stream))
            .collect::<Option<_>>()?;
        for _ in 0..REPAIRS {
            let scene = assemble(scene_id, &flat, &pieces.concat(), &mut stream)?;
            let findings = check(&scene);
            if findings.is_empty() {
                return Some(scene);
            }
            // Only rooms with a fault are furnished anew, so that a large house is not
            // lost to one chair.
            for (room, plot) in flat.plots.iter().enumerate() {
                let inside = |at: &str| {
                    scene
                        .receptacles
                        .iter()
                        .any(|piece| piece.id.as_str() == at && piece.room == plot.name)
                };
                if findings
                    .iter()
                    .any(|finding| finding.at == plot.name || inside(&finding.at))
                {
                    pieces[room] = furnish::furnish(&flat, room, &mut stream)?;
                }
            }
        }
        None
    });
    scene.ok_or(SceneError::NoFlat { tries: TRIES })
}

/// Gives receptacles of a scene that was not generated their captions, from what their attributes,
/// rooms and neighbours say, and returns the indices of those that none is true of alone.
pub fn caption(receptacles: &mut [Receptacle], seed: u64) -> Vec<usize> {
    captions::write_each(receptacles, &mut Stream::new(seed, "captions", 0))
}

/// Attributes for receptacles whose looks are not known, such that those of one name differ; `None`
/// where there are more of a name than looks.
pub fn draw_looks(categories: &[&str], seed: u64) -> Option<Vec<Attributes>> {
    looks::draw(categories, &mut Stream::new(seed, "looks", 0))
}

fn assemble(scene_id: &str, flat: &Flat, pieces: &[Piece], stream: &mut Stream) -> Option<Scene> {
    let categories: Vec<&str> = pieces.iter().map(|piece| piece.category.as_str()).collect();
    let looks = looks::draw(&categories, stream)?;
    let mut numbers: BTreeMap<&str, usize> = BTreeMap::new();
    let mut receptacles: Vec<Receptacle> = Vec::new();
    for (piece, attributes) in pieces.iter().zip(looks) {
        let number = numbers
            .entry(&piece.category)
            .and_modify(|number| *number += 1)
            .or_insert(1);
        let corner = |corner: [i32; 2], height_cm: i32| {
            [
                metres(f64::from(corner[0])),
                metres(f64::from(corner[1])),
                f64::from(height_cm) / 100.0,
            ]
        };
        let hinge = [Door::Left, Door::Right][stream.below(2)];
        receptacles.push(Receptacle {
            id: format!("{}_{number}", piece.category.replace(' ', "")).into(),
            room: flat.plots[piece.room].name.clone(),
            category: piece.category.clone(),
            door: if piece.kind.door { hinge } else { Door::None },
            captions: BTreeMap::new(),
            attributes,
            surface_min: corner(piece.surface.low, piece.height_cm - 3),
            surface_max: corner(piece.surface.high, piece.height_cm),
            facing_deg: Some(90.0 * piece.quarters as f64),
            placeable: true,
            covers: None,
            part_of: None,
            geometry: None,
            extra: BTreeMap::new(),
        });
    }
    if !captions::write(&mut receptacles, stream) {
        return None;
    }
    let rooms = flat.plots.iter().map(|plot| {
        let corner = |corner: [i32; 2]| corner.map(|value| metres(f64::from(value)));
        let rects: Vec<Rect> = plot
            .rects
            .iter()
            .map(|rect| Rect {
                min: corner(rect.low),
                max: corner(rect.high),
            })
            .collect();
        let bound = |pick: fn(f64, f64) -> f64, of: fn(&Rect) -> [f64; 2], start: f64| {
            [0, 1].map(|axis| rects.iter().map(|rect| of(rect)[axis]).fold(start, pick))
        };
        let (min, max) = (
            bound(f64::min, |rect| rect.min, f64::MAX),
            bound(f64::max, |rect| rect.max, f64::MIN),
        );
        let rects = if rects.len() > 1 { rects } else { Vec::new() };
        Room {
            name: plot.name.clone(),
            rects,
            min,
            max,
            extra: BTreeMap::new(),
        }
    });
    let mut scene = Scene {
        scene_id: scene_id.to_owned(),
        rooms: rooms.collect(),
        walls: Some(flat.walls()),
        robot_start: None,
        receptacles,
        extra: BTreeMap::new(),
    };
    scene.robot_start = Some(check::spacious_place(&scene)?);
    Some(scene)
}
