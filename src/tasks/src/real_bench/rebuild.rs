//! A scene from the placements of its tasks. The published scenes are not public; their task files
//! say where objects stand, on which receptacle, in which room. From this follow, without an
//! assumption, the receptacles with their order, rooms and doors, the heights of surfaces, and a
//! lower bound of their extents. The rest is assumed, and the scene file says what.

use std::{collections::BTreeMap, path::Path};

use reel_world::{Rect, Scene};
use serde_json::{Value, json};

use super::{captions, floor};
use crate::{TaskError, error::Problem, field::Field, placement::SPAWN_GAP_M, scene};

/// The published generator keeps objects this far from the edge of a surface, in metres.
const EDGE_MARGIN_M: f64 = 0.05;
/// Heights that differ by less than this are one surface, in metres.
const SAME_HEIGHT_M: f64 = 0.001;
/// Thickness of the slab whose top is the surface, in metres.
const SLAB_M: f64 = 0.03;
/// Side of a surface on which nothing was ever placed, in metres.
const ASSUMED_SIDE_M: f64 = 0.6;
/// Height of such a surface, in metres: of a counter, or the floor of what has a door.
const ASSUMED_HEIGHT_M: [f64; 2] = [0.85, 0.35];
/// With fewer placements the simulator may give a surface the size that is usual for its category;
/// with more than the second number, the bound is close.
const FEW_MANY: [usize; 2] = [10, 60];

/// A scene rebuilt from placements, and how certain each receptacle of it is.
#[derive(Clone, Debug)]
pub struct RebuiltScene {
    /// The scene, in the form of a scene file.
    pub scene: Scene,
    /// The text of its file.
    pub text: String,
    /// What is known of each receptacle, in their order.
    pub evidence: Vec<Evidence>,
    /// What is doubtful, for people.
    pub warnings: Vec<String>,
}

/// What the task files prove of a receptacle.
#[derive(Clone, PartialEq, Debug)]
pub struct Evidence {
    /// Id of the receptacle, e.g. `table_1`.
    pub receptacle: String,
    /// Id of the room that the receptacle stands in, e.g. `kitchen/0`.
    pub room: String,
    /// How many objects are placed on it, in all tasks. With none, its place, height and extents
    /// are assumed; else the height is proven and the extents are a lower bound.
    pub placements: usize,
    /// Height of its surface, in metres.
    pub height_m: f64,
    /// Extents of its surface along x and y, in metres.
    pub extents_m: [f64; 2],
    /// Whether it has a door.
    pub door: bool,
}

/// What task files say of a receptacle.
#[derive(Default)]
struct ReceptacleEvidence {
    room: Option<String>,
    door: bool,
    /// Footprint and height of the surface below each placed object.
    placed: Vec<(Rect, f64)>,
}

/// Rebuilds the scene of task files that passed the published checks.
pub(super) fn rebuild(
    scene_id: &str,
    files: &[(&Path, Field<'_>)],
) -> Result<RebuiltScene, TaskError> {
    let mut known: BTreeMap<String, ReceptacleEvidence> = BTreeMap::new();
    let mut orders: Vec<Vec<String>> = Vec::new();
    for (path, root) in files {
        let read = read_file(root, &mut known)
            .map_err(|problem| problem.in_file(&path.display().to_string()))?;
        if !orders.contains(&read) {
            orders.push(read);
        }
    }
    let order = merged(orders);
    let room_of = |id: &String| {
        known[id]
            .room
            .clone()
            .unwrap_or_else(|| "room/0".to_owned())
    };
    let mut rooms: Vec<String> = Vec::new();
    for room in order.iter().map(room_of) {
        if !rooms.contains(&room) {
            rooms.push(room);
        }
    }
    let room_index = |id: &String| {
        rooms
            .iter()
            .position(|room| *room == room_of(id))
            .expect("collected above")
    };

    let mut warnings = Vec::new();
    let surfaces: BTreeMap<&String, (Rect, f64)> = order
        .iter()
        .filter_map(|id| Some((id, surface(id, &known[id].placed, &mut warnings)?)))
        .collect();
    let pieces: Vec<floor::Tile> = order
        .iter()
        .filter_map(|id| {
            Some(floor::Tile {
                room: room_index(id),
                rect: surfaces.get(id)?.0,
            })
        })
        .collect();
    let tiles = floor::tiles(rooms.len(), &pieces);

    let captions = captions::of_receptacles(files, &order);
    let mut taken: Vec<Rect> = pieces.iter().map(|piece| piece.rect).collect();
    let (mut receptacles, mut evidence) = (Vec::new(), Vec::new());
    for id in &order {
        let ReceptacleEvidence { door, placed, .. } = &known[id];
        let (rect, height) = surfaces.get(id).copied().unwrap_or_else(|| {
            let rect = floor::place(room_index(id), ASSUMED_SIDE_M, &tiles, &taken);
            taken.push(rect);
            (rect, ASSUMED_HEIGHT_M[usize::from(*door)])
        });
        let tenth_mm = |value: f64| (value * 10_000.0).round() / 10_000.0;
        let corner = |[x, y]: [f64; 2], z: f64| [x, y, z].map(tenth_mm);
        let mut receptacle = json!({
            "id": id, "room": room_of(id), "category": category(id), "door": door,
            "captions": captions.get(id).cloned().unwrap_or_default(),
            "surface_min": corner(rect.min, height - SLAB_M), "surface_max": corner(rect.max, height),
            "inferred_from": placed.len(), "confidence": confidence(placed.len()),
            "height": if placed.is_empty() { "assumed" } else { "proven" },
            "extents": if placed.is_empty() { "assumed" } else { "lower bound" },
        });
        if placed.is_empty() {
            receptacle["synthetic"] = json!(true);
        }
        receptacles.push(receptacle);
        let extents_m = [0, 1].map(|axis| tenth_mm(rect.max[axis] - rect.min[axis]));
        let (receptacle, room) = (id.clone(), room_of(id));
        evidence.push(Evidence {
            receptacle,
            room,
            placements: placed.len(),
            height_m: tenth_mm(height),
            extents_m,
            door: *door,
        });
    }
    let mut document = json!({
        "scene_id": scene_id,
        "note": format!(
            "Rebuilt from the placements of {} tasks. Proven: receptacles, rooms, doors, order, heights where objects were placed. Extents \
             are lower bounds. Assumed: the floors of rooms, and every surface that is called synthetic.",
            files.len()
        ),
        "rooms": rooms.iter().enumerate().map(|(index, name)| room(name, index, &tiles)).collect::<Vec<_>>(),
        "receptacles": receptacles,
    });
    if !floor::is_connected(rooms.len(), &tiles) {
        // Without walls every room can be reached.
        document["walls"] = json!([]);
        warnings.push(
            "rooms are not neighbours of each other as rebuilt: the scene has no walls inside"
                .to_owned(),
        );
    }
    let text = format!("{document:#}\n");
    let loaded = scene::parse(&text, &format!("{scene_id}.json"))?;
    warnings.extend(loaded.warnings);
    Ok(RebuiltScene {
        scene: loaded.scene,
        text,
        evidence,
        warnings,
    })
}

/// Adds what one file says, and gives its receptacles in their order.
fn read_file(
    root: &Field<'_>,
    known: &mut BTreeMap<String, ReceptacleEvidence>,
) -> Result<Vec<String>, Problem> {
    let objects = root.get("objects")?;
    let mut order = Vec::new();
    for episode in root.get("episodes")?.items()? {
        for (id, state) in episode.get("initial_world_graph")?.entries_as_written()? {
            let receptacle = known.entry(id.to_owned()).or_default();
            receptacle.door |= state.find("door")?.is_some();
            if let Some(room) = state.find("room")? {
                let name = receptacle
                    .room
                    .get_or_insert_with(|| room.text().unwrap_or_default().to_owned());
                if name != room.text()? {
                    return Err(room.problem(format!(
                        "{id} is in {}, but in {name} in another task of the scene",
                        room.text()?
                    )));
                }
            }
            order.push(id.to_owned());
        }
        for (key, placement) in episode.get("placements")?.entries()? {
            let [width, depth, height] = objects.get(key)?.get("size")?.vector()?;
            let [x, y, z] = placement.get("position")?.vector()?;
            let footprint = Rect {
                min: [x - width / 2.0, y - depth / 2.0],
                max: [x + width / 2.0, y + depth / 2.0],
            };
            let id = placement.get("furniture")?.text()?;
            known
                .entry(id.to_owned())
                .or_default()
                .placed
                .push((footprint, z - height / 2.0 - SPAWN_GAP_M));
        }
    }
    Ok(order)
}

/// One order from several that leave receptacles out: the longest, with each missing receptacle
/// behind the one it follows elsewhere.
fn merged(mut orders: Vec<Vec<String>>) -> Vec<String> {
    orders.sort_by_key(|order| std::cmp::Reverse(order.len()));
    let mut merged: Vec<String> = Vec::new();
    for order in orders {
        let mut at = 0;
        for id in order {
            match merged.iter().position(|known| *known == id) {
                Some(position) => at = position + 1,
                None => {
                    merged.insert(at, id);
                    at += 1;
                }
            }
        }
    }
    merged
}

/// The surface below all that is placed on a receptacle, or `None` if nothing is.
fn surface(id: &str, placed: &[(Rect, f64)], warnings: &mut Vec<String>) -> Option<(Rect, f64)> {
    let mut heights: Vec<f64> = placed.iter().map(|(_, height)| *height).collect();
    heights.sort_by(f64::total_cmp);
    let height = *heights.get(heights.len() / 2)?;
    let others = heights
        .iter()
        .filter(|other| (*other - height).abs() > SAME_HEIGHT_M)
        .count();
    if others > 0 {
        warnings.push(format!(
            "{others} of {} objects on {id} stand at other heights, from {:.3} to {:.3} m; {height:.3} m is taken",
            heights.len(),
            heights[0],
            heights[heights.len() - 1]
        ));
    }
    let around = |a: Rect, b: Rect| Rect {
        min: [a.min[0].min(b.min[0]), a.min[1].min(b.min[1])],
        max: [a.max[0].max(b.max[0]), a.max[1].max(b.max[1])],
    };
    let hull = placed
        .iter()
        .map(|(footprint, _)| *footprint)
        .reduce(around)?;
    Some((
        Rect {
            min: hull.min.map(|c| c - EDGE_MARGIN_M),
            max: hull.max.map(|c| c + EDGE_MARGIN_M),
        },
        height,
    ))
}

fn room(name: &str, index: usize, tiles: &[floor::Tile]) -> Value {
    let rects: Vec<Rect> = tiles
        .iter()
        .filter(|tile| tile.room == index)
        .map(|tile| tile.rect)
        .collect();
    let bound = |pick: fn(f64, f64) -> f64, of: fn(&Rect) -> [f64; 2], start: f64| {
        [0, 1].map(|axis| rects.iter().map(|rect| of(rect)[axis]).fold(start, pick))
    };
    let (min, max) = (
        bound(f64::min, |rect| rect.min, f64::MAX),
        bound(f64::max, |rect| rect.max, f64::MIN),
    );
    json!({ "name": name, "min": min, "max": max, "rects": rects })
}

/// The category in a receptacle's id: `table` of `table_1`.
fn category(id: &str) -> &str {
    id.rsplit_once('_')
        .filter(|(_, number)| number.chars().all(|c| c.is_ascii_digit()))
        .map_or(id, |(category, _)| category)
}

fn confidence(placements: usize) -> &'static str {
    match placements {
        0 => "none",
        count if count < FEW_MANY[0] => "low",
        count if count < FEW_MANY[1] => "medium",
        _ => "high",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_that_leave_receptacles_out_become_one() {
        let order = |text: &str| text.split(' ').map(str::to_owned).collect::<Vec<_>>();
        assert_eq!(
            merged(vec![order("a c e"), order("a b c d"), order("z c f")]),
            order("z a b c f e d")
        );
        assert_eq!(merged(vec![]), Vec::<String>::new());
    }

    #[test]
    fn the_surface_lies_below_what_is_placed_and_most_heights_win() {
        let placed = |x: f64, height: f64| {
            (
                Rect {
                    min: [x, 0.0],
                    max: [x + 0.2, 0.4],
                },
                height,
            )
        };
        let mut warnings = Vec::new();
        let (rect, height) = surface(
            "table_1",
            &[placed(0.0, 0.7), placed(1.0, 0.7), placed(0.5, 0.4)],
            &mut warnings,
        )
        .unwrap();
        assert_eq!((rect.min, height), ([-0.05, -0.05], 0.7));
        assert!((rect.max[0] - 1.25).abs() < 1e-9 && (rect.max[1] - 0.45).abs() < 1e-9);
        assert_eq!(
            warnings,
            [
                "1 of 3 objects on table_1 stand at other heights, from 0.400 to 0.700 m; 0.700 m is taken"
            ]
        );
        assert_eq!(surface("table_1", &[], &mut warnings), None);
    }

    #[test]
    fn a_category_is_an_id_without_its_number() {
        assert_eq!(
            (
                category("table_1"),
                category("tv_stand_12"),
                category("shelf")
            ),
            ("table", "tv_stand", "shelf")
        );
    }
}
