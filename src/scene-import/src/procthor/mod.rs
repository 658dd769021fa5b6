//! Houses of ProcTHOR and AI2-THOR as JSON (`CreateHouse`): rooms, walls with door openings, and
//! furniture by the type of its asset. Their frame is left-handed with y up; x and z become x and y.

mod objects;
mod walls;

use reel_world::Rect;
use serde::Deserialize;
use serde_json::Value;

use crate::{
    ImportError, categories,
    files::is_sane,
    house::{House, RoomPlan},
    notes::Notes,
    polygons, surfaces,
};

pub(crate) use objects::AssetSizes;

/// Most rooms, walls, doors or objects of a house.
const ITEMS_MAX: usize = 20_000;

/// A point or the Euler angles of a turn.
#[derive(Clone, Copy, PartialEq, Debug, Default, Deserialize)]
struct Triple {
    #[serde(default)]
    x: f64,
    #[serde(default)]
    y: f64,
    #[serde(default)]
    z: f64,
}

impl Triple {
    fn is_sane(&self) -> bool {
        [self.x, self.y, self.z].into_iter().all(is_sane)
    }

    /// Where it is on the floor of a scene.
    fn floor(&self) -> [f64; 2] {
        [self.x, self.z]
    }
}

#[derive(Deserialize)]
struct HouseFile {
    rooms: Vec<RoomItem>,
    #[serde(default)]
    walls: Vec<walls::WallItem>,
    #[serde(default)]
    doors: Vec<walls::DoorItem>,
    #[serde(default)]
    windows: Vec<Value>,
    #[serde(default)]
    objects: Vec<objects::ObjectItem>,
    #[serde(default)]
    metadata: Value,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct RoomItem {
    #[serde(default)]
    id: String,
    #[serde(default)]
    room_type: String,
    floor_polygon: Vec<Triple>,
}

/// Reads the JSON of a house.
pub(crate) fn read(text: &str, file: &str, sizes: &AssetSizes) -> Result<House, ImportError> {
    let parsed: HouseFile = serde_json::from_str(text).map_err(|error| ImportError::Syntax {
        file: file.to_owned(),
        line: error.line(),
        problem: format!("no ProcTHOR house: {error}"),
    })?;
    let counts = [
        parsed.rooms.len(),
        parsed.walls.len(),
        parsed.doors.len(),
        parsed.objects.len(),
    ];
    if let Some(count) = counts.into_iter().find(|count| *count > ITEMS_MAX) {
        return Err(ImportError::invalid(
            file,
            "rooms, walls, doors, objects",
            format!("{count} of a kind, and at most {ITEMS_MAX} are read"),
        ));
    }
    let mut notes = Notes::default();
    let mut rooms = Vec::new();
    for (index, item) in parsed.rooms.iter().enumerate() {
        let at = format!("rooms[{index}] ({})", item.id);
        let rects = floor(&item.floor_polygon, file, &at, &mut notes)?;
        let kind = categories::room(&item.room_type).unwrap_or("room");
        rooms.push(RoomPlan {
            kind: kind.to_owned(),
            rects,
        });
    }
    if rooms.is_empty() {
        return Err(ImportError::invalid(
            file,
            "rooms",
            "none; a house needs at least one room",
        ));
    }
    if parsed.walls.is_empty() {
        notes.approximated("house without walls: they are built around its rooms");
    }
    note_overlaps(&parsed.rooms, &rooms, &mut notes);
    for _ in &parsed.windows {
        notes.left_out("window: walls are whole there");
    }
    let walls = walls::walls(&parsed.walls, &parsed.doors, file, &mut notes)?;
    let pieces = objects::pieces(&parsed.objects, sizes, file, &mut notes)?;
    Ok(House {
        name: String::new(),
        rooms,
        walls,
        robot_start: agent(&parsed.metadata),
        pieces,
        notes,
    })
}

/// Rooms that lie over each other: what stands there is of the first.
fn note_overlaps(items: &[RoomItem], rooms: &[RoomPlan], notes: &mut Notes) {
    let overlap = |a: &RoomPlan, b: &RoomPlan| {
        let pairs = a
            .rects
            .iter()
            .flat_map(|one| b.rects.iter().map(move |other| (one, other)));
        pairs
            .filter_map(|(one, other)| surfaces::shared(one, other))
            .map(|rect| surfaces::area(&rect))
            .sum::<f64>()
    };
    for (index, room) in rooms.iter().enumerate() {
        for (before, other) in rooms.iter().enumerate().take(index) {
            if overlap(room, other) > 0.05 {
                let [one, other] = [before, index].map(|at| &items[at].id);
                notes.approximated(format!("rooms that overlap: {one} and {other}"));
            }
        }
    }
}

fn floor(
    polygon: &[Triple],
    file: &str,
    at: &str,
    notes: &mut Notes,
) -> Result<Vec<Rect>, ImportError> {
    if let Some(index) = polygon.iter().position(|point| !point.is_sane()) {
        return Err(ImportError::invalid(
            file,
            format!("{at}.floorPolygon[{index}]"),
            "is no finite point within 1000 km",
        ));
    }
    let points: Vec<[f64; 2]> = polygon.iter().map(Triple::floor).collect();
    let floor = polygons::rectangles(&points)
        .map_err(|problem| ImportError::invalid(file, format!("{at}.floorPolygon"), problem))?;
    if floor.is_approximate {
        notes.approximated(format!(
            "room with oblique walls: squares of {} m",
            polygons::CELL_M
        ));
    }
    Ok(floor.rects)
}

/// Where the house says an agent starts: x, y, and yaw in radians.
fn agent(metadata: &Value) -> Option<[f64; 3]> {
    let agent = metadata.get("agent")?;
    let at: Triple = serde_json::from_value(agent.get("position")?.clone()).ok()?;
    let turn = agent.get("rotation");
    let degrees = turn
        .and_then(|turn| turn.as_f64().or_else(|| turn.get("y")?.as_f64()))
        .unwrap_or(0.0);
    if !at.is_sane() || !is_sane(degrees) {
        return None;
    }
    let [x, y] = at.floor();
    let yaw = (90.0 - degrees).rem_euclid(360.0).to_radians();
    Some([x, y, yaw].map(|value| (value * 10_000.0).round() / 10_000.0))
}

/// Whether JSON is a house of this format.
pub(crate) fn is_house(text: &str) -> bool {
    let head = text.trim_start();
    head.starts_with('{') && head.contains("\"floorPolygon\"")
}
