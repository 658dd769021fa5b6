//! Shelves, drawers and compartments for the furniture of a scene: which piece gets which, where
//! they lie in it and what they are called. Draws nothing at random.

use std::collections::{BTreeMap, BTreeSet};

use super::check;

use reel_world::{Door, Receptacle, Scene};

/// Kinds of furniture that get parts, those first that do so before others of their room.
const KINDS: &[(&str, &[Part])] = &[
    (
        "chest of drawers",
        &[
            drawer("bottom", [0.0, 1.0], 0.1),
            drawer("middle", [0.0, 1.0], 0.4),
            drawer("top", [0.0, 1.0], 0.7),
        ],
    ),
    (
        "shelf",
        &[
            shelf("lower", [0.0, 1.0], 0.08),
            shelf("upper", [0.0, 1.0], 0.52),
        ],
    ),
    (
        "nightstand",
        &[shelf("", [0.0, 1.0], 0.12), drawer("", [0.0, 1.0], 0.55)],
    ),
    (
        "cabinet",
        &[
            compartment("left", [0.0, 0.5], Door::Left),
            compartment("right", [0.5, 1.0], Door::Right),
            drawer("", [0.0, 1.0], 0.72),
        ],
    ),
    (
        "tv stand",
        &[shelf("", [0.0, 0.5], 0.14), drawer("", [0.5, 1.0], 0.14)],
    ),
    ("desk", &[drawer("", [0.55, 1.0], 0.76)]),
    (
        "shoe cabinet",
        &[shelf("", [0.0, 1.0], 0.1), drawer("", [0.0, 1.0], 0.55)],
    ),
];

/// Distance of a surface from the sides of its piece, and from another beside it, in metres.
const SIDE_M: f64 = 0.03;
/// Distance of a surface from the back of its piece, in metres.
const BACK_M: f64 = 0.03;
/// Thickness of the floor of a part, in metres.
const FLOOR_M: f64 = 0.01;

/// A part of a kind of furniture.
#[derive(Clone, Copy)]
struct Part {
    category: &'static str,
    /// The word that tells it from others of its piece; empty if there is no other.
    which: &'static str,
    door: Door,
    /// From the left to the right of the piece, seen from its front, as shares of its width.
    across: [f64; 2],
    /// Height of its floor, as a share of the height of the piece.
    floor: f64,
}

const fn drawer(which: &'static str, across: [f64; 2], floor: f64) -> Part {
    Part {
        category: "drawer",
        which,
        door: Door::Drawer,
        across,
        floor,
    }
}

const fn shelf(which: &'static str, across: [f64; 2], floor: f64) -> Part {
    Part {
        category: "shelf",
        which,
        door: Door::None,
        across,
        floor,
    }
}

const fn compartment(which: &'static str, across: [f64; 2], door: Door) -> Part {
    Part {
        category: "compartment",
        which,
        door,
        across,
        floor: 0.12,
    }
}

/// Gives shelves, drawers and compartments to one piece of every room that has one for it: the
/// first whose parts pass [`check`].
pub fn with_parts(scene: &Scene) -> Scene {
    let mut fitted = scene.clone();
    let mut done: BTreeSet<&str> = BTreeSet::new();
    for (category, parts) in KINDS {
        for whole in &scene.receptacles {
            let is_plain = whole.geometry.is_none() && whole.part_of.is_none();
            if whole.category != *category || !is_plain || whole.door.exists() {
                continue;
            }
            let Some(degrees) = whole.facing_deg else {
                continue;
            };
            if !scene.is_usable(whole) || done.contains(whole.room.as_str()) {
                continue;
            }
            let quarters = ((degrees / 90.0).round() as i64).rem_euclid(4) as usize;
            let made = parts.iter().map(|part| part.of(whole, quarters));
            let mut tried = fitted.clone();
            tried.receptacles.extend(made);
            let pieces = tried.receptacles.iter_mut();
            // "The chest of drawers" would be any of its drawers.
            for piece in pieces.filter(|piece| piece.id == whole.id) {
                let captions = std::mem::take(&mut piece.captions).into_iter();
                piece.captions = captions
                    .map(|(caption, weight)| (format!("the top of {caption}"), weight))
                    .collect();
            }
            let is_new = |at: &str| {
                fitted
                    .receptacles
                    .iter()
                    .all(|known| known.id.as_str() != at)
            };
            let faults = check(&tried);
            if !faults.iter().any(|finding| is_new(&finding.at)) {
                done.insert(&whole.room);
                fitted = tried;
            }
        }
    }
    fitted
}

impl Part {
    /// The part of a piece whose front looks along +x after so many quarter turns.
    fn of(&self, whole: &Receptacle, quarters: usize) -> Receptacle {
        let name = match self.which {
            "" => self.category.to_owned(),
            which => format!("{which} {}", self.category),
        };
        let captions = whole.captions.iter().map(|(caption, weight)| {
            let piece = caption.strip_prefix("the ").unwrap_or(caption);
            (format!("the {name} of the {piece}"), *weight)
        });
        let (min, max) = (whole.surface_min, whole.surface_max);
        let (front, side) = (quarters % 2, 1 - quarters % 2);
        let (mut low, mut high) = (min, max);
        // Seen from the front, the left is where y is low for a front along +x.
        let left_is_low = matches!(quarters, 0 | 3);
        let width = max[side] - min[side];
        let [from, to] = if left_is_low {
            self.across
        } else {
            [1.0 - self.across[1], 1.0 - self.across[0]]
        };
        low[side] = millimetres(min[side] + width * from + SIDE_M);
        high[side] = millimetres(min[side] + width * to - SIDE_M);
        if matches!(quarters, 0 | 1) {
            low[front] = millimetres(min[front] + BACK_M);
        } else {
            high[front] = millimetres(max[front] - BACK_M);
        }
        high[2] = millimetres(max[2] * self.floor);
        low[2] = millimetres(high[2] - FLOOR_M);
        Receptacle {
            id: format!("{}_{}", whole.id, name.replace(' ', "_")).into(),
            category: self.category.to_owned(),
            door: self.door,
            part_of: Some(whole.id.clone()),
            captions: captions.collect(),
            surface_min: low,
            surface_max: high,
            extra: BTreeMap::new(),
            ..whole.clone()
        }
    }
}

fn millimetres(metres: f64) -> f64 {
    (metres * 1000.0).round() / 1000.0
}
