//! Walls of a house along the axes, each once, with openings where doors are.

use std::collections::BTreeMap;

use reel_world::Wall;
use serde::Deserialize;

use super::Triple;
use crate::{ImportError, notes::Notes};

/// Walls that are nearer than this are one.
const SAME_M: f64 = 0.001;
/// Height of a wall that does not say it, in metres.
const HEIGHT_M: f64 = 2.5;

#[derive(Deserialize)]
pub(super) struct WallItem {
    #[serde(default)]
    id: String,
    polygon: Vec<Triple>,
    /// Whether the rooms are open to each other here.
    #[serde(default)]
    empty: bool,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct DoorItem {
    #[serde(default)]
    id: String,
    #[serde(default)]
    room0: String,
    #[serde(default)]
    room1: Option<String>,
    #[serde(default)]
    wall0: String,
    #[serde(default)]
    wall1: Option<String>,
    /// Two corners in the frame of `wall0`: along it from its first point, and up.
    #[serde(default)]
    hole_polygon: Vec<Triple>,
    /// The same in houses older than schema 1.0.
    #[serde(default)]
    bounding_box: Option<BoundingBox>,
}

#[derive(Deserialize)]
struct BoundingBox {
    min: Triple,
    max: Triple,
}

/// The ends of a wall on the floor, in its own direction.
#[derive(Clone, Copy)]
struct Line {
    from: [f64; 2],
    to: [f64; 2],
    height: f64,
}

/// The lines of walls: by axis along which they run and where they are across.
type Runs = BTreeMap<(usize, i64), Vec<[f64; 2]>>;

/// The walls of a house; `None` where it gives none.
pub(super) fn walls(
    items: &[WallItem],
    doors: &[DoorItem],
    file: &str,
    notes: &mut Notes,
) -> Result<Option<Vec<Wall>>, ImportError> {
    let mut lines: BTreeMap<&str, Line> = BTreeMap::new();
    let mut runs = Runs::new();
    let mut height = 0.0_f64;
    for (index, item) in items.iter().enumerate() {
        let at = || format!("walls[{index}] ({})", item.id);
        let line = line(&item.polygon).ok_or_else(|| {
            ImportError::invalid(file, at(), "its polygon has no lower edge of finite points")
        })?;
        lines.insert(&item.id, line);
        if item.empty {
            continue;
        }
        match run(&line) {
            Some((key, interval)) => runs.entry(key).or_default().push(interval),
            None => notes.left_out("wall that is oblique"),
        }
        height = height.max(line.height);
    }
    if items.is_empty() {
        return Ok(None);
    }
    let mut holes = Runs::new();
    for (index, door) in doors.iter().enumerate() {
        if leads_outside(door) {
            notes.approximated("door to the outside: stays closed");
            continue;
        }
        let hole = hole(door, &lines).ok_or_else(|| {
            let at = format!("doors[{index}] ({})", door.id);
            ImportError::invalid(
                file,
                at,
                "its wall0 is no wall, or it has no holePolygon of two finite points",
            )
        })?;
        if let Some((key, interval)) = run(&hole) {
            holes.entry(key).or_default().push(interval);
        }
    }
    let height = if height > 0.5 { height } else { HEIGHT_M };
    let mut walls = Vec::new();
    for (key, intervals) in runs {
        let cut = holes.get(&key).cloned().unwrap_or_default();
        walls.extend(
            without(joined(intervals), joined(cut))
                .into_iter()
                .map(|run| wall(key, run, height)),
        );
    }
    Ok(Some(walls))
}

/// The lower edge of a wall, in the order of its corners.
fn line(polygon: &[Triple]) -> Option<Line> {
    if !polygon.iter().all(Triple::is_sane) {
        return None;
    }
    let low = polygon
        .iter()
        .map(|point| point.y)
        .fold(f64::INFINITY, f64::min);
    let high = polygon
        .iter()
        .map(|point| point.y)
        .fold(f64::NEG_INFINITY, f64::max);
    let mut lower = polygon.iter().filter(|point| point.y - low < 0.01);
    let (from, to) = (lower.next()?, lower.next()?);
    Some(Line {
        from: from.floor(),
        to: to.floor(),
        height: high - low,
    })
}

/// A line along an axis: which axis and where across, and from where to where.
fn run(line: &Line) -> Option<((usize, i64), [f64; 2])> {
    let along =
        (0..2).find(|axis| (line.from[1 - axis] - line.to[1 - axis]).abs() < SAME_M * 5.0)?;
    let [a, b] = [line.from[along], line.to[along]];
    let across = (line.from[1 - along] / SAME_M).round() as i64;
    Some(((along, across), [a.min(b), a.max(b)]))
}

fn leads_outside(door: &DoorItem) -> bool {
    let is_outside = |wall: &str| wall.contains("exterior");
    door.room1.as_ref().is_none_or(|room| *room == door.room0)
        || is_outside(&door.wall0)
        || door.wall1.as_deref().is_none_or(is_outside)
}

fn hole(door: &DoorItem, lines: &BTreeMap<&str, Line>) -> Option<Line> {
    let line = lines.get(door.wall0.as_str())?;
    let (a, b) = match (door.hole_polygon.as_slice(), &door.bounding_box) {
        ([a, b, ..], _) => (*a, *b),
        (_, Some(given)) => (given.min, given.max),
        _ => return None,
    };
    if !a.is_sane() || !b.is_sane() {
        return None;
    }
    let along = [0, 1].map(|axis| line.to[axis] - line.from[axis]);
    let length = libm::hypot(along[0], along[1]);
    if length < SAME_M {
        return None;
    }
    let point =
        |distance: f64| [0, 1].map(|axis| line.from[axis] + along[axis] / length * distance);
    Some(Line {
        from: point(a.x),
        to: point(b.x),
        height: line.height,
    })
}

/// Intervals that touch as one, in order.
fn joined(mut intervals: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    intervals.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut joined: Vec<[f64; 2]> = Vec::new();
    for [from, to] in intervals {
        match joined.last_mut() {
            Some(last) if from <= last[1] + SAME_M => last[1] = last[1].max(to),
            _ => joined.push([from, to]),
        }
    }
    joined
}

/// What is left of intervals between holes.
fn without(intervals: Vec<[f64; 2]>, holes: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    let mut left = Vec::new();
    for [mut from, to] in intervals {
        for [low, high] in &holes {
            if *high > from && *low < to {
                left.push([from, *low]);
                from = *high;
            }
        }
        left.push([from, to]);
    }
    left.retain(|[from, to]| to - from > 0.02);
    left
}

fn wall((along, across): (usize, i64), [from, to]: [f64; 2], height: f64) -> Wall {
    let round = |value: f64| (value * 1000.0).round() / 1000.0;
    let point = |at: f64| {
        let mut point = [round(at); 2];
        point[1 - along] = round(across as f64 * SAME_M);
        point
    };
    Wall {
        from: point(from),
        to: point(to),
        height: round(height),
    }
}
