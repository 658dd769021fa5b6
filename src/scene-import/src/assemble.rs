//! From the house that a file holds to a scene: rooms around furniture that has none, furniture off
//! the walls, ids, looks and captions.

use std::collections::BTreeMap;

use reel_tasks::generate::scene::{caption, draw_looks};
use reel_world::{
    Attributes, Door, FurnitureGeometry, FurnitureJoint, Receptacle, Rect, Room, Scene, Solid,
    SolidShape,
};

use crate::{
    affine::Bounds,
    captions::caption_parts,
    colors,
    house::{Body, Extent, House, Piece, RoomPlan},
    notes::Notes,
    parts::{Part, parts},
};

/// Free floor around furniture without a house, in metres.
const PLAIN_ROOM_MARGIN_M: f64 = 2.0;
/// Half the thickness of a wall and a little, in metres.
const WALL_MARGIN_M: f64 = 0.06;
/// Furniture is moved so far from a wall that it stands in, in metres.
const OFF_WALL_MAX_M: f64 = 0.2;
/// Thickness of the slab of a surface, in metres.
const SLAB_M: f64 = 0.03;

/// A scene, and which piece of the file each receptacle is.
pub(crate) struct Assembled {
    pub(crate) scene: Scene,
    /// In the order of the receptacles.
    pub(crate) sources: Vec<String>,
    pub(crate) notes: Notes,
}

/// Makes a scene of a house; `None` where nothing holds objects.
pub(crate) fn assemble(scene_id: &str, mut house: House) -> Option<Assembled> {
    let mut notes = std::mem::take(&mut house.notes);
    if house.rooms.is_empty() {
        house.rooms.push(plain_room(&mut house.pieces, &mut notes)?);
    }
    let names = room_names(&house.rooms);
    let mut built = Vec::new();
    let mut uncoloured = 0;
    for mut piece in std::mem::take(&mut house.pieces) {
        notes.about(&piece.source);
        let Some(room) = room_of(&piece, &house.rooms) else {
            notes.left_out("furniture outside of every room");
            continue;
        };
        off_the_walls(&mut piece, &house.rooms[room], &mut notes);
        if let Body::Solids(solids) = &mut piece.body
            && colors::fill(solids, uncoloured)
        {
            uncoloured += 1;
            notes.approximated("furniture without a colour in the file: coloured in turn");
        }
        built.push((piece, names[room].clone()));
    }
    notes.about("");
    let (mut receptacles, sources) = receptacles(built, &mut notes);
    if receptacles.is_empty() {
        return None;
    }
    write_captions(&mut receptacles, &house.rooms, &mut notes);
    let rooms = house
        .rooms
        .iter()
        .zip(names)
        .map(|(plan, name)| room(plan, name));
    let scene = Scene {
        scene_id: scene_id.to_owned(),
        rooms: rooms.collect(),
        walls: house.walls,
        robot_start: house.robot_start,
        receptacles,
        extra: BTreeMap::new(),
    };
    Some(Assembled {
        scene,
        sources,
        notes,
    })
}

/// A room around furniture that came without one; the furniture is put onto its floor.
fn plain_room(pieces: &mut [Piece], notes: &mut Notes) -> Option<RoomPlan> {
    for piece in pieces.iter_mut() {
        if let Body::Solids(solids) = &mut piece.body
            && let Some(bounds) = Bounds::of_all(solids.all())
            && bounds.low[2].abs() > 0.005
        {
            let side = if bounds.low[2] > 0.0 {
                "above"
            } else {
                "below"
            };
            notes.about(&format!("{}, {:.2} m", piece.source, bounds.low[2].abs()));
            notes.approximated(format!("furniture {side} the floor: put onto it"));
            notes.about("");
            solids.shift([0.0, 0.0, -bounds.low[2]]);
        }
    }
    let bounds = pieces.iter().filter_map(footprint).reduce(|a, b| Rect {
        min: [0, 1].map(|axis| a.min[axis].min(b.min[axis])),
        max: [0, 1].map(|axis| a.max[axis].max(b.max[axis])),
    })?;
    notes.approximated("no house in the file: one plain room around the furniture");
    let kind = match pieces.first().map(|piece| piece.category.as_str()) {
        Some("bed" | "chest of drawers" | "nightstand") => "bedroom",
        Some("refrigerator" | "microwave" | "electric cooker" | "counter" | "sink") => "kitchen",
        Some("desk") => "study room",
        _ => "living room",
    };
    Some(RoomPlan {
        kind: kind.to_owned(),
        rects: vec![Rect {
            min: bounds.min.map(|value| metres(value - PLAIN_ROOM_MARGIN_M)),
            max: bounds.max.map(|value| metres(value + PLAIN_ROOM_MARGIN_M)),
        }],
    })
}

/// `bedroom/0`, `bedroom/1`, in the order of the file.
fn room_names(rooms: &[RoomPlan]) -> Vec<String> {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    let name = |plan: &RoomPlan, number: usize| format!("{}/{number}", plan.kind);
    rooms
        .iter()
        .map(|plan| {
            let count = counts.entry(&plan.kind).or_default();
            *count += 1;
            name(plan, *count - 1)
        })
        .collect()
}

fn room(plan: &RoomPlan, name: String) -> Room {
    let bound = |pick: fn(f64, f64) -> f64, of: fn(&Rect) -> [f64; 2], start: f64| {
        [0, 1].map(|axis| {
            plan.rects
                .iter()
                .map(|rect| of(rect)[axis])
                .fold(start, pick)
        })
    };
    Room {
        name,
        rects: if plan.rects.len() > 1 {
            plan.rects.clone()
        } else {
            Vec::new()
        },
        min: bound(f64::min, |rect| rect.min, f64::MAX),
        max: bound(f64::max, |rect| rect.max, f64::MIN),
        extra: BTreeMap::new(),
    }
}

/// What a piece covers of the floor.
fn footprint(piece: &Piece) -> Option<Rect> {
    match &piece.body {
        Body::Sized(extent) => Some(extent.rect()),
        Body::Solids(solids) => {
            let Bounds { low, high } = Bounds::of_all(solids.all())?;
            Some(Rect {
                min: [low[0], low[1]],
                max: [high[0], high[1]],
            })
        }
    }
}

impl Extent {
    fn rect(&self) -> Rect {
        let [width, depth, _] = self.size;
        let half = if self.faces_along_x() {
            [depth, width]
        } else {
            [width, depth]
        }
        .map(|side| side * 0.5);
        Rect {
            min: [0, 1].map(|axis| self.center[axis] - half[axis]),
            max: [0, 1].map(|axis| self.center[axis] + half[axis]),
        }
    }

    fn faces_along_x(&self) -> bool {
        self.facing_deg == 0.0 || self.facing_deg == 180.0
    }
}

fn room_of(piece: &Piece, rooms: &[RoomPlan]) -> Option<usize> {
    let Rect { min, max } = footprint(piece)?;
    let center = [0, 1].map(|axis| (min[axis] + max[axis]) * 0.5);
    rooms
        .iter()
        .position(|room| room.rects.iter().any(|rect| rect.contains(center)))
}

/// Walls have a thickness that those of other simulators do not: furniture in them is moved inward.
fn off_the_walls(piece: &mut Piece, room: &RoomPlan, notes: &mut Notes) {
    let Some(print) = footprint(piece) else {
        return;
    };
    let center = [0, 1].map(|axis| (print.min[axis] + print.max[axis]) * 0.5);
    let Some(rect) = room.rects.iter().find(|rect| rect.contains(center)) else {
        return;
    };
    let mut by = [0.0; 2];
    for axis in 0..2 {
        let bounded = |at: f64, upper: bool| borders(room, rect, axis, at, upper);
        let low = rect.min[axis] + WALL_MARGIN_M - print.min[axis];
        let high = print.max[axis] - (rect.max[axis] - WALL_MARGIN_M);
        if low > 0.0 && low <= OFF_WALL_MAX_M && high < 0.0 && bounded(center[1 - axis], false) {
            by[axis] = low;
        } else if high > 0.0
            && high <= OFF_WALL_MAX_M
            && low < 0.0
            && bounded(center[1 - axis], true)
        {
            by[axis] = -high;
        }
    }
    if by == [0.0; 2] {
        return;
    }
    notes.approximated("furniture that touched a wall: moved off it");
    match &mut piece.body {
        Body::Sized(extent) => (0..2).for_each(|axis| extent.center[axis] += by[axis]),
        Body::Solids(solids) => solids.shift([by[0], by[1], 0.0]),
    }
}

/// Whether a room ends at a side of one of its rectangles, across from `at`.
fn borders(room: &RoomPlan, rect: &Rect, axis: usize, at: f64, upper: bool) -> bool {
    let edge = if upper {
        rect.max[axis] + 0.01
    } else {
        rect.min[axis] - 0.01
    };
    let mut beyond = [at; 2];
    beyond[axis] = edge;
    !room.rects.iter().any(|other| other.contains(beyond))
}

/// The receptacles of pieces with their rooms, and where each comes from.
fn receptacles(pieces: Vec<(Piece, String)>, notes: &mut Notes) -> (Vec<Receptacle>, Vec<String>) {
    let sized: Vec<&str> = pieces
        .iter()
        .filter(|(piece, _)| matches!(piece.body, Body::Sized(_)))
        .map(|(piece, _)| piece.category.as_str())
        .collect();
    let mut looks = draw_looks(&sized, 0).unwrap_or_default().into_iter();
    let mut found = Found::default();
    for (piece, room) in pieces {
        let Piece {
            source,
            category,
            body,
        } = piece;
        notes.about(&source);
        match body {
            Body::Sized(extent) => {
                notes.approximated("furniture of which the file has no look: one is drawn");
                let attributes = looks.next().unwrap_or_default();
                let receptacle = found.sized(&category, extent, room, attributes);
                found.add(receptacle, &source);
            }
            Body::Solids(solids) => {
                let attributes = colors::attributes(&solids);
                let (parts, facing) = parts(&category, solids, notes);
                if parts.is_empty() {
                    notes.left_out("furniture without a level surface");
                }
                found.solids((&source, &category), &parts, facing, &room, &attributes);
            }
        }
    }
    notes.about("");
    (found.receptacles, found.sources)
}

/// The receptacles that were made so far.
#[derive(Default)]
struct Found {
    receptacles: Vec<Receptacle>,
    sources: Vec<String>,
    numbers: BTreeMap<String, usize>,
}

impl Found {
    fn add(&mut self, receptacle: Receptacle, source: &str) {
        self.receptacles.push(receptacle);
        self.sources.push(source.to_owned());
    }

    /// The next id of a category, e.g. `chestofdrawers_2`.
    fn id(&mut self, category: &str) -> String {
        let letters = category.replace(' ', "");
        let number = self.numbers.entry(letters.clone()).or_default();
        *number += 1;
        format!("{letters}_{number}")
    }

    fn receptacle(&mut self, category: &str, room: String, rect: Rect, z: f64) -> Receptacle {
        let [x0, y0] = rect.min.map(metres);
        let [x1, y1] = rect.max.map(metres);
        let z = metres(z);
        Receptacle {
            id: self.id(category).into(),
            room,
            category: category.to_owned(),
            door: Door::None,
            part_of: None,
            captions: BTreeMap::new(),
            attributes: Attributes::new(),
            surface_min: [x0, y0, metres(z - SLAB_M)],
            surface_max: [x1, y1, z],
            facing_deg: None,
            placeable: true,
            covers: None,
            geometry: None,
            extra: BTreeMap::new(),
        }
    }

    fn sized(
        &mut self,
        category: &str,
        extent: Extent,
        room: String,
        attributes: Attributes,
    ) -> Receptacle {
        let surface = crate::sizes::surface(category, extent.size);
        let rect = {
            let mut inner = extent;
            let [width, depth, _] = extent.size;
            inner.size = [
                width - 2.0 * surface.side_m,
                depth - surface.back_m - surface.front_m,
                surface.height_m,
            ];
            let (sin, cos) = match extent.facing_deg as i64 {
                0 => (0.0, 1.0),
                90 => (1.0, 0.0),
                180 => (0.0, -1.0),
                _ => (-1.0, 0.0),
            };
            let ahead = (surface.back_m - surface.front_m) * 0.5;
            inner.center = [
                extent.center[0] + cos * ahead,
                extent.center[1] + sin * ahead,
            ];
            inner.rect()
        };
        let door = if surface.has_door {
            Door::Left
        } else {
            Door::None
        };
        Receptacle {
            door,
            attributes,
            facing_deg: Some(extent.facing_deg),
            ..self.receptacle(category, room, rect, surface.height_m)
        }
    }

    fn solids(
        &mut self,
        (source, category): (&str, &str),
        parts: &[Part],
        facing: Option<f64>,
        room: &str,
        attributes: &Attributes,
    ) {
        let mut whole = None;
        let fixed = parts.first().map(|part| &part.geometry.fixed);
        let color = fixed.and_then(|fixed| Some(fixed.first()?.color));
        for part in parts {
            let category = part.role.map_or(category, |role| role.category());
            let mut receptacle = Receptacle {
                door: part.door,
                part_of: part.role.and(whole.clone()),
                attributes: attributes.clone(),
                facing_deg: facing,
                ..self.receptacle(category, room.to_owned(), part.rect, part.z)
            };
            let mut geometry = rounded(&part.geometry);
            if geometry == FurnitureGeometry::default() {
                // The board of a shelf stands in the furniture; what is seen of it is the shelf.
                geometry.fixed = color
                    .map(|color| board(&receptacle, color))
                    .into_iter()
                    .collect();
            }
            receptacle.geometry = Some(geometry);
            whole.get_or_insert_with(|| receptacle.id.clone());
            let joint = part.joint.as_ref().filter(|joint| !joint.is_empty());
            let source =
                joint.map_or_else(|| source.to_owned(), |joint| format!("{source}/{joint}"));
            self.add(receptacle, &source);
        }
    }
}

/// A box where the surface of a receptacle is.
fn board(receptacle: &Receptacle, color: [u8; 3]) -> Solid {
    let (low, high) = (receptacle.surface_min, receptacle.surface_max);
    Solid {
        shape: SolidShape::Box {
            half: [0, 1, 2].map(|axis| metres((high[axis] - low[axis]) * 0.5)),
        },
        position: [0, 1, 2].map(|axis| metres((high[axis] + low[axis]) * 0.5)),
        rotation: [0.0, 0.0, 0.0, 1.0],
        color,
    }
}

fn write_captions(receptacles: &mut [Receptacle], rooms: &[RoomPlan], notes: &mut Notes) {
    let mut wholes: Vec<Receptacle> = receptacles
        .iter()
        .filter(|receptacle| receptacle.part_of.is_none())
        .cloned()
        .collect();
    let without = caption(&mut wholes, 0);
    for index in &without {
        notes.approximated("furniture that looks like another: named by its number in its room");
        let number = 1 + wholes[..*index]
            .iter()
            .filter(|other| {
                other.category == wholes[*index].category && other.room == wholes[*index].room
            })
            .count();
        let kind = wholes[*index].room_name();
        let rooms_of_kind = rooms.iter().filter(|room| room.kind == kind).count();
        let name = crate::captions::numbered(&wholes[*index], number, rooms_of_kind);
        wholes[*index].captions.insert(name, 1.0);
    }
    let captions: BTreeMap<_, _> = wholes
        .into_iter()
        .map(|whole| (whole.id.clone(), whole.captions))
        .collect();
    for receptacle in receptacles.iter_mut() {
        if let Some(written) = captions.get(&receptacle.id) {
            receptacle.captions.clone_from(written);
        }
    }
    caption_parts(receptacles);
}

/// To a tenth of a millimetre, so that files are short and equal where sums differ in the last bit.
fn metres(value: f64) -> f64 {
    let rounded = (value * 10_000.0).round() / 10_000.0;
    if rounded == 0.0 { 0.0 } else { rounded }
}

fn rounded(geometry: &FurnitureGeometry) -> FurnitureGeometry {
    let all = |solids: &[Solid]| solids.iter().map(rounded_primitive).collect();
    let joint = geometry.joint.map(|joint| match joint {
        FurnitureJoint::Hinge {
            position,
            axis,
            open_deg,
        } => FurnitureJoint::Hinge {
            position: position.map(metres),
            axis,
            open_deg: metres(open_deg),
        },
        FurnitureJoint::Slide { open_by } => FurnitureJoint::Slide {
            open_by: open_by.map(metres),
        },
    });
    FurnitureGeometry {
        fixed: all(&geometry.fixed),
        moving: all(&geometry.moving),
        joint,
    }
}

fn rounded_primitive(primitive: &Solid) -> Solid {
    use reel_world::SolidShape::{Box, Cylinder, Sphere};
    let size = |value: f64| metres(value).max(0.0001);
    let shape = match primitive.shape {
        Box { half } => Box {
            half: half.map(size),
        },
        Cylinder {
            radius,
            half_height,
        } => Cylinder {
            radius: size(radius),
            half_height: size(half_height),
        },
        Sphere { radius } => Sphere {
            radius: size(radius),
        },
    };
    let whole = |value: f64| {
        let rounded = (value * 1e7).round() / 1e7;
        if rounded == 0.0 { 0.0 } else { rounded }
    };
    Solid {
        shape,
        position: primitive.position.map(metres),
        rotation: primitive.rotation.map(whole),
        color: primitive.color,
    }
}
