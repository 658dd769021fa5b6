//! Scenes as data: rooms, walls, receptacles with surfaces and doors, and how they are described.
//!
//! This is the scene file format (`schemas/scene.schema.json`) too, so that the scene in a trace
//! reads like the scene on disk. Metres, z up; x and y span the floor. Geometry built from it
//! (legs, shelves, colliders) belongs to the simulator.

use std::{collections::BTreeMap, sync::Arc};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::{Attributes, FurnitureGeometry, ReceptacleId, Task};

/// A scene: a flat with furniture.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Scene {
    /// Its name; tasks refer to it.
    pub scene_id: String,
    /// The rooms of the scene; their footprints do not overlap.
    pub rooms: Vec<Room>,
    /// Walls. Absent: the simulator builds them around the rooms, with
    /// an opening between neighbours.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub walls: Option<Vec<Wall>>,
    /// Where the robot starts: x, y in metres, yaw in radians (0 looks along +x).
    /// Absent: the simulator chooses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot_start: Option<[f64; 3]>,
    /// The furniture, in the order of the file.
    pub receptacles: Vec<Receptacle>,
    /// Fields we do not know, kept.
    #[serde(flatten)]
    pub extra: BTreeMap<String, Value>,
}

/// Scenes by their id: those that a set of tasks plays in.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Scenes(BTreeMap<String, Arc<Scene>>);

impl Scenes {
    /// The scene of a task, or `None` if it is not among these.
    pub fn of(&self, task: &Task) -> Option<&Arc<Scene>> {
        self.0.get(&task.scene_id)
    }

    /// The scene of an id, or `None` if it is not among these.
    pub fn get(&self, scene_id: &str) -> Option<&Arc<Scene>> {
        self.0.get(scene_id)
    }

    /// Adds a scene; one of the same id makes way.
    pub fn insert(&mut self, scene: Arc<Scene>) {
        self.0.insert(scene.scene_id.clone(), scene);
    }

    /// The scenes, sorted by id.
    pub fn iter(&self) -> impl Iterator<Item = &Arc<Scene>> {
        self.0.values()
    }

    /// The scene, if there is exactly one.
    pub fn only(&self) -> Option<&Arc<Scene>> {
        self.0.values().next().filter(|_| self.0.len() == 1)
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

impl From<Arc<Scene>> for Scenes {
    fn from(scene: Arc<Scene>) -> Self {
        let mut scenes = Self::default();
        scenes.insert(scene);
        scenes
    }
}

/// A room as a union of rectangles.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Room {
    /// Name of the room that receptacles refer to, e.g. `living room/0`.
    pub name: String,
    /// Its exact footprint: disjoint rectangles. Absent: the one rectangle `min`..`max`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rects: Vec<Rect>,
    /// Lower corner of the bounding rectangle.
    pub min: [f64; 2],
    /// Upper corner of the bounding rectangle.
    pub max: [f64; 2],
    /// Fields we do not know, kept.
    #[serde(flatten)]
    pub extra: BTreeMap<String, Value>,
}

/// An axis-aligned rectangle on the floor.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub struct Rect {
    /// Lower corner: x, y.
    pub min: [f64; 2],
    /// Upper corner: x, y.
    pub max: [f64; 2],
}

/// A straight wall from one point to another, axis-aligned.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub struct Wall {
    /// One end: x, y.
    pub from: [f64; 2],
    /// The other end: x, y.
    pub to: [f64; 2],
    /// Height of the wall, in metres.
    pub height: f64,
}

/// A fixed piece of furniture that holds objects.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Receptacle {
    /// Id of the receptacle in its scene, e.g. `table_1`.
    pub id: ReceptacleId,
    /// Name of its room.
    pub room: String,
    /// Category of the furniture, e.g. `table`.
    pub category: String,
    /// The door, if it has one, or that it is a drawer.
    #[serde(default)]
    pub door: Door,
    /// The furniture whose shelf or drawer it is. Its surface then lies inside of that
    /// furniture, below the furniture's own, which is the top.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part_of: Option<ReceptacleId>,
    /// How people call it, with how often (weight); any of them may stand in an instruction.
    #[serde(default)]
    pub captions: BTreeMap<String, f64>,
    /// Attribute words by kind (colour, top, handles, bedding, ...), which the renderer shows.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub attributes: Attributes,
    /// Lower corner of the slab whose top is the interaction surface.
    pub surface_min: [f64; 3],
    /// Upper corner of that slab; its z is the height of the surface.
    pub surface_max: [f64; 3],
    /// Direction its front looks to, in degrees around z (0 is +x). Absent: the simulator
    /// chooses the freest side.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub facing_deg: Option<f64>,
    /// Whether it may be placed upon.
    #[serde(default = "yes", skip_serializing_if = "is_true")]
    pub placeable: bool,
    /// The receptacle it lies on (a lid on its pot). It is taken off while that one holds objects.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub covers: Option<ReceptacleId>,
    /// What it consists of. Absent: the simulator builds it by category and attributes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub geometry: Option<FurnitureGeometry>,
    /// Fields we do not know, kept.
    #[serde(flatten)]
    pub extra: BTreeMap<String, Value>,
}

/// How a receptacle opens, if it does: by a door with a hinge, or as a drawer. In files also a
/// plain boolean.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
#[serde(from = "DoorField", into = "DoorField")]
pub enum Door {
    /// The receptacle has no door; the default.
    #[default]
    None,
    /// Vertical hinge on the left, seen from the front.
    Left,
    /// Vertical hinge on the right, seen from the front.
    Right,
    /// No hinge: all of it slides out to the front.
    Drawer,
}

impl Door {
    /// Whether the receptacle opens and closes.
    pub fn exists(self) -> bool {
        self != Door::None
    }
}

#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum DoorField {
    Has(bool),
    Kind(DoorKind),
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum DoorKind {
    Left,
    Right,
    Drawer,
}

impl From<DoorField> for Door {
    fn from(field: DoorField) -> Self {
        match field {
            DoorField::Has(false) => Door::None,
            DoorField::Has(true) | DoorField::Kind(DoorKind::Left) => Door::Left,
            DoorField::Kind(DoorKind::Right) => Door::Right,
            DoorField::Kind(DoorKind::Drawer) => Door::Drawer,
        }
    }
}

impl From<Door> for DoorField {
    fn from(door: Door) -> Self {
        match door {
            Door::None => DoorField::Has(false),
            Door::Left => DoorField::Kind(DoorKind::Left),
            Door::Right => DoorField::Kind(DoorKind::Right),
            Door::Drawer => DoorField::Kind(DoorKind::Drawer),
        }
    }
}

fn yes() -> bool {
    true
}

#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde's skip_serializing_if passes a reference"
)]
fn is_true(value: &bool) -> bool {
    *value
}

impl Scene {
    /// The receptacle of this id, or `None` if the scene does not have it.
    pub fn receptacle(&self, id: &ReceptacleId) -> Option<&Receptacle> {
        self.receptacles
            .iter()
            .find(|receptacle| receptacle.id == *id)
    }

    /// Whether things can be put on a receptacle at all: lids, and what they cover,
    /// are not for that.
    pub fn is_usable(&self, receptacle: &Receptacle) -> bool {
        let covered = || {
            self.receptacles
                .iter()
                .any(|other| other.covers.as_ref() == Some(&receptacle.id))
        };
        receptacle.placeable && receptacle.covers.is_none() && !covered()
    }

    /// The shelves and drawers of a receptacle, in the order of the file.
    pub fn parts_of(&self, id: &ReceptacleId) -> impl Iterator<Item = &Receptacle> {
        self.receptacles
            .iter()
            .filter(move |receptacle| receptacle.part_of.as_ref() == Some(id))
    }

    /// The receptacles of each room, in the order of the file; rooms in the order
    /// of their first receptacle.
    pub fn rooms_and_furniture(&self) -> Vec<(&str, Vec<&ReceptacleId>)> {
        let mut rooms: Vec<(&str, Vec<&ReceptacleId>)> = Vec::new();
        for receptacle in &self.receptacles {
            match rooms.iter_mut().find(|(room, _)| *room == receptacle.room) {
                Some((_, ids)) => ids.push(&receptacle.id),
                None => rooms.push((&receptacle.room, vec![&receptacle.id])),
            }
        }
        rooms
    }

    /// Rooms and furniture as the published servers' `list_receptacles` prints them.
    pub fn furniture_listing(&self) -> String {
        let line = |id: &&ReceptacleId| format!("  - {id}\n");
        let room = |(room, ids): (&str, Vec<&ReceptacleId>)| {
            format!("Room: {room}\n{}", ids.iter().map(line).collect::<String>())
        };
        self.rooms_and_furniture().into_iter().map(room).collect()
    }

    /// Rooms and furniture, rooms in the order of the file.
    pub fn room_listing(&self) -> String {
        let mut text = String::new();
        for room in &self.rooms {
            let inside = self
                .receptacles
                .iter()
                .filter(|receptacle| receptacle.room == room.name);
            let lines: Vec<String> = inside
                .map(|receptacle| format!("  - {}\n", receptacle.id))
                .collect();
            if !lines.is_empty() {
                text.push_str(&format!("Room: {}\n{}", room.name, lines.concat()));
            }
        }
        text
    }
}

impl Room {
    /// Its footprint as rectangles.
    pub fn footprint(&self) -> Vec<Rect> {
        if self.rects.is_empty() {
            vec![Rect {
                min: self.min,
                max: self.max,
            }]
        } else {
            self.rects.clone()
        }
    }
}

impl Rect {
    /// Whether a point lies inside or on the border.
    pub fn contains(&self, [x, y]: [f64; 2]) -> bool {
        (self.min[0]..=self.max[0]).contains(&x) && (self.min[1]..=self.max[1]).contains(&y)
    }
}

impl Receptacle {
    /// Height of the interaction surface, in metres.
    pub fn surface_height(&self) -> f64 {
        self.surface_max[2]
    }

    /// The surface seen from above.
    pub fn surface_rect(&self) -> Rect {
        Rect {
            min: [self.surface_min[0], self.surface_min[1]],
            max: [self.surface_max[0], self.surface_max[1]],
        }
    }

    /// What people call its room: `bedroom` for `bedroom/1`.
    pub fn room_name(&self) -> &str {
        self.room.split('/').next().unwrap_or_default()
    }

    /// The caption people use most (the first in alphabet of equals).
    pub fn main_caption(&self) -> Option<&str> {
        let mut best: Option<(&str, f64)> = None;
        for (caption, weight) in &self.captions {
            if best.is_none_or(|(_, most)| *weight > most) {
                best = Some((caption, *weight));
            }
        }
        best.map(|(caption, _)| caption)
    }
}
