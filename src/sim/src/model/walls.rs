//! Floor slabs and walls: as the scene gives them, or around the rooms with
//! an opening between neighbours.

use reel_world::{Room, Scene, Wall};

use super::{
    layout::Rectangle,
    looks::Paint,
    parts::{Frame, Parts, block},
};
use crate::geometry::{Part, Pattern};

/// Thickness of a wall, in metres.
const THICKNESS_M: f32 = 0.1;
/// Height of a wall that the scene does not give, in metres.
const HEIGHT_M: f64 = 2.5;
/// Width of an opening, in metres; also the shortest shared edge that gets one.
const OPENING_M: f32 = 1.0;
/// A shorter shared edge is left wholly open, in metres.
const WHOLLY_OPEN_BELOW_M: f32 = 1.7;
/// An opening keeps this far from the ends of its edge, so that the corner stands, in metres.
const CORNER_M: f32 = 0.1;
/// Furniture farther away than this does not count, in metres.
const FAR_M: f32 = 1.2;

/// The walls of a scene; `furniture` are the footprints that openings keep away from.
pub(super) fn walls(scene: &Scene, furniture: &[Rectangle]) -> Vec<Wall> {
    if let Some(walls) = &scene.walls {
        return walls.clone();
    }
    let edges = edges(&scene.rooms);
    let openings = openings(&edges, furniture);
    let mut walls = Vec::new();
    for edge in &edges {
        let mut from = edge.from;
        let mut cuts: Vec<&Opening> = openings
            .iter()
            .filter(|opening| opening.is_in(edge))
            .collect();
        cuts.sort_by(|a, b| a.from.total_cmp(&b.from));
        for cut in cuts {
            walls.extend(edge.wall(from, cut.from));
            from = cut.to;
        }
        walls.extend(edge.wall(from, edge.to));
    }
    walls
}

/// Floor slabs by room, then walls with their skirting boards.
pub(super) fn shell(scene: &Scene, walls: &[Wall]) -> Vec<Part> {
    let mut parts = Parts::new(Frame::OUTER);
    for room in &scene.rooms {
        for rect in room.footprint() {
            let ([x0, y0], [x1, y1]) = (rect.min.map(|c| c as f32), rect.max.map(|c| c as f32));
            parts.solid(
                block([x0, y0, -0.1], [x1, y1, 0.0]),
                floor_paint(&room.name),
            );
        }
    }
    for wall in walls {
        let [low, high] = thick(wall, walls);
        parts.solid(
            block(
                [low[0], low[1], 0.0],
                [high[0], high[1], wall.height as f32],
            ),
            Paint::plain([226, 222, 212]),
        );
        let skirting = 0.008;
        let (low, high) = (low.map(|c| c - skirting), high.map(|c| c + skirting));
        parts.look(
            block([low[0], low[1], 0.0], [high[0], high[1], 0.09]),
            Paint::plain([246, 245, 240]),
        );
    }
    parts.finish()
}

/// A stretch of border between two rooms, or between a room and the outside.
#[derive(Clone, Copy, PartialEq, Debug)]
struct Edge {
    /// Index of the axis it is perpendicular to.
    across: usize,
    /// Coordinate on that axis.
    at: f32,
    from: f32,
    to: f32,
    /// The two rooms, if there are two.
    rooms: Option<(usize, usize)>,
    /// From here to the middle of the wall: the wall between rooms stands on the border, one to
    /// the outside behind it.
    shift: f32,
}

impl Edge {
    fn point(&self, along: f32) -> [f64; 2] {
        let mut point = [f64::from(along); 2];
        point[self.across] = f64::from(self.at + self.shift);
        point
    }

    fn wall(&self, from: f32, to: f32) -> Option<Wall> {
        (to - from > 0.02).then(|| Wall {
            from: self.point(from),
            to: self.point(to),
            height: HEIGHT_M,
        })
    }
}

/// A gap in an edge.
#[derive(Clone, Copy, PartialEq, Debug)]
struct Opening {
    across: usize,
    at: f32,
    from: f32,
    to: f32,
}

impl Opening {
    fn is_in(&self, edge: &Edge) -> bool {
        self.across == edge.across
            && self.at == edge.at
            && self.from >= edge.from
            && self.to <= edge.to
    }
}

/// All borders of rooms, cut where the rooms beside them change; not those inside one room.
fn edges(rooms: &[Room]) -> Vec<Edge> {
    // Whole millimetres, so that borders of neighbours meet.
    let whole = |value: f64| libm::round(value * 1000.0) as i64;
    let rects: Vec<(usize, [i64; 2], [i64; 2])> = rooms
        .iter()
        .enumerate()
        .flat_map(|(room, data)| {
            data.footprint()
                .into_iter()
                .map(move |rect| (room, rect.min.map(whole), rect.max.map(whole)))
        })
        .collect();
    let mut edges: Vec<Edge> = Vec::new();
    for across in 0..2 {
        let along = 1 - across;
        let mut lines: Vec<i64> = rects
            .iter()
            .flat_map(|(_, min, max)| [min[across], max[across]])
            .collect();
        lines.sort_unstable();
        lines.dedup();
        for line in lines {
            let touching = rects
                .iter()
                .filter(|(_, min, max)| min[across] == line || max[across] == line);
            let mut cuts: Vec<i64> = touching
                .flat_map(|(_, min, max)| [min[along], max[along]])
                .collect();
            cuts.sort_unstable();
            cuts.dedup();
            for pair in cuts.windows(2) {
                let spans =
                    |min: &[i64; 2], max: &[i64; 2]| min[along] <= pair[0] && pair[1] <= max[along];
                let below = rects
                    .iter()
                    .find(|(_, min, max)| max[across] == line && spans(min, max))
                    .map(|rect| rect.0);
                let above = rects
                    .iter()
                    .find(|(_, min, max)| min[across] == line && spans(min, max))
                    .map(|rect| rect.0);
                let (rooms, shift) = match (below, above) {
                    (None, None) => continue,
                    (Some(a), Some(b)) if a == b => continue,
                    (Some(a), Some(b)) => (Some((a.min(b), a.max(b))), 0.0),
                    (Some(_), None) => (None, THICKNESS_M * 0.5),
                    (None, Some(_)) => (None, -THICKNESS_M * 0.5),
                };
                let metres = |value: i64| value as f32 / 1000.0;
                let (at, from, to) = (metres(line), metres(pair[0]), metres(pair[1]));
                let edge = Edge {
                    across,
                    at,
                    from,
                    to,
                    rooms,
                    shift,
                };
                match edges.last_mut() {
                    Some(last)
                        if Edge {
                            from: last.from,
                            ..edge
                        } == Edge { to, ..*last }
                            && last.to == from =>
                    {
                        last.to = to
                    }
                    _ => edges.push(edge),
                }
            }
        }
    }
    edges
}

/// One opening for each pair of neighbours, where furniture stands farthest away.
fn openings(edges: &[Edge], furniture: &[Rectangle]) -> Vec<Opening> {
    let mut pairs: Vec<(usize, usize)> = edges.iter().filter_map(|edge| edge.rooms).collect();
    pairs.sort_unstable();
    pairs.dedup();
    let mut openings = Vec::new();
    for pair in pairs {
        let mut best: Option<(f32, Opening)> = None;
        for edge in edges.iter().filter(|edge| edge.rooms == Some(pair)) {
            for opening in candidates(edge) {
                let middle = ((opening.from + opening.to) - (edge.from + edge.to)) * 0.5;
                // A little off the middle is no worse than a chair's width nearer to furniture.
                let score = room_around(&opening, furniture) - 0.01 * libm::fabsf(middle);
                if best.is_none_or(|(most, _)| score > most + 1e-4) {
                    best = Some((score, opening));
                }
            }
        }
        openings.extend(best.map(|(_, opening)| opening));
    }
    openings
}

fn candidates(edge: &Edge) -> Vec<Opening> {
    let length = edge.to - edge.from;
    let opening = |from: f32, to: f32| Opening {
        across: edge.across,
        at: edge.at,
        from,
        to,
    };
    if length < OPENING_M - 1e-3 {
        return Vec::new();
    }
    if length < WHOLLY_OPEN_BELOW_M {
        return vec![opening(edge.from, edge.to)];
    }
    let steps = libm::floorf((length - OPENING_M - 2.0 * CORNER_M) / 0.05 + 1e-3) as usize;
    let start = |step: usize| edge.from + CORNER_M + step as f32 * 0.05;
    (0..=steps)
        .map(|step| opening(start(step), start(step) + OPENING_M))
        .collect()
}

/// Distance from an opening to the nearest furniture, at most [`FAR_M`].
fn room_around(opening: &Opening, furniture: &[Rectangle]) -> f32 {
    let along = 1 - opening.across;
    let distances = furniture.iter().map(|[low, high]| {
        let sideways = (low[along] - opening.to)
            .max(opening.from - high[along])
            .max(0.0);
        let ahead = (low[opening.across] - opening.at)
            .max(opening.at - high[opening.across])
            .max(0.0);
        libm::sqrtf(sideways * sideways + ahead * ahead)
    });
    distances.fold(FAR_M, f32::min)
}

/// A wall with its thickness; an end that meets another wall across is drawn out
/// to close the corner.
fn thick(wall: &Wall, walls: &[Wall]) -> Rectangle {
    let half = THICKNESS_M * 0.5;
    let along = usize::from((wall.to[0] - wall.from[0]).abs() < (wall.to[1] - wall.from[1]).abs());
    let ends = [wall.from.map(|c| c as f32), wall.to.map(|c| c as f32)];
    let mut low = [ends[0][0].min(ends[1][0]), ends[0][1].min(ends[1][1])];
    let mut high = [ends[0][0].max(ends[1][0]), ends[0][1].max(ends[1][1])];
    // How far an end must be drawn out to reach the far face of a wall across, which stands up to
    // half a wall off.
    let reach = |end: [f32; 2], outward: f32| {
        let side = 1 - along;
        let across = walls.iter().filter_map(|other| {
            let (from, to) = (other.from.map(|c| c as f32), other.to.map(|c| c as f32));
            let offset = (from[along] - end[along]) * outward;
            let crosses =
                libm::fabsf(to[along] - from[along]) < 1e-3 && libm::fabsf(offset) < half + 1e-3;
            let spans = from[side].min(to[side]) <= end[side] + half + 1e-3
                && from[side].max(to[side]) >= end[side] - half - 1e-3;
            (crosses && spans).then_some(offset + half)
        });
        across.fold(0.0, f32::max)
    };
    let (before, after) = (reach(low, -1.0), reach(high, 1.0));
    low[1 - along] -= half;
    high[1 - along] += half;
    low[along] -= before;
    high[along] += after;
    [low, high]
}

fn floor_paint(room: &str) -> Paint {
    let tiles = |color, accent| Paint {
        color,
        accent,
        pattern: Pattern::Dots,
    };
    let name = room.to_lowercase();
    let is = |kinds: &[&str]| kinds.iter().any(|kind| name.contains(kind));
    if is(&["kitchen"]) {
        tiles([206, 202, 192], [190, 186, 176])
    } else if is(&["wash", "bath", "toilet", "laundry"]) {
        tiles([188, 204, 208], [174, 192, 198])
    } else if is(&["bed"]) {
        Paint::grain([198, 164, 122])
    } else if is(&["study", "office"]) {
        Paint::grain([144, 104, 72])
    } else if is(&["living"]) {
        Paint::grain([182, 142, 98])
    } else if is(&["din"]) {
        Paint::grain([166, 122, 82])
    } else if is(&["hall", "corridor", "entrance"]) {
        tiles([176, 170, 160], [164, 158, 148])
    } else {
        Paint::grain([176, 138, 100])
    }
}
