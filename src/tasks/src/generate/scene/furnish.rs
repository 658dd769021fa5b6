//! Furniture into the rooms of a flat: every piece stands where pieces of its kind stand, leaves
//! doorways and its own front free, and never closes a passage. Whole cells of 5 cm; never says
//! what anything looks like.

use crate::random::Stream;

use super::{
    flat::{Cells, Flat, Plot},
    kinds::{DOUBLE_BED, Kind, SINGLE_BED, Stand, kind},
};

/// Free floor before a piece and on both sides of a doorway: 90 cm.
const PASSAGE: i32 = 18;
/// From a border to the wall's face.
const WALL: i32 = 1;
/// Least gap between two bodies.
const GAP: i32 = 1;
/// Attempts for one room.
const TRIES: usize = 24;

/// A piece of furniture with its place.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Piece {
    pub(super) category: String,
    pub(super) room: usize,
    pub(super) kind: Kind,
    /// Quarter turns its front is turned from +x.
    pub(super) quarters: usize,
    pub(super) surface: Cells,
    pub(super) height_cm: i32,
    /// What it takes of the floor, back to the wall.
    body: Cells,
    /// What must stay free for it.
    clear: Vec<Cells>,
}

/// Furnishes a room, in the order of the brief; none where it has no place for all its pieces.
pub(super) fn furnish(flat: &Flat, room: usize, stream: &mut Stream) -> Option<Vec<Piece>> {
    let mut placed = (0..TRIES).find_map(|_| furnish_room(flat, room, stream))?;
    // Ids follow the brief, not what had to be placed first.
    let wanted = flat.plots[room].pieces.iter();
    wanted
        .map(|category| {
            let index = placed
                .iter()
                .position(|piece| piece.category == *category)?;
            Some(placed.remove(index))
        })
        .collect()
}

fn furnish_room(flat: &Flat, room: usize, stream: &mut Stream) -> Option<Vec<Piece>> {
    let plot = &flat.plots[room];
    // Beside a tea table another table stands at a wall.
    let has_tea_table = plot.pieces.iter().any(|category| category == "tea table");
    let at_home = |category: &str| {
        if category == "table" && has_tea_table {
            "entry"
        } else {
            plot.kind
        }
    };
    let kinds = plot
        .pieces
        .iter()
        .map(|category| kind(category, at_home(category)).map(|kind| (category, kind)));
    let mut wanted: Vec<(&String, Kind)> = kinds.collect::<Option<_>>()?;
    // What has least choice first.
    wanted.sort_by_key(|(category, kind)| match kind.stand {
        Stand::Bed => 0,
        Stand::BesideBed => 1,
        Stand::Middle => 2,
        Stand::Wall if *category == "couch" => 3,
        Stand::OppositeCouch => 4,
        Stand::BeforeCouch => 5,
        Stand::Row => 6,
        Stand::Wall => 7,
    });
    let beds = wanted
        .iter()
        .filter(|(_, kind)| kind.stand == Stand::Bed)
        .count();
    let mut room = Room {
        plot,
        room,
        ways: doorway_zones(flat, room),
        placed: Vec::new(),
    };
    for (category, kind) in wanted {
        let piece = room.place(category, kind, beds, stream)?;
        room.placed.push(piece);
    }
    Some(room.placed)
}

/// The floor on this room's side of its doorways.
fn doorway_zones(flat: &Flat, room: usize) -> Vec<Cells> {
    let ways = flat.doorways.iter().filter(|way| way.rooms.contains(&room));
    ways.map(|way| {
        let (mut low, mut high) = ([0; 2], [0; 2]);
        low[way.across] = way.at - PASSAGE;
        high[way.across] = way.at + PASSAGE;
        low[1 - way.across] = way.from - 1;
        high[1 - way.across] = way.to + 1;
        Cells { low, high }
    })
    .collect()
}

/// A room that is being furnished.
struct Room<'a> {
    plot: &'a Plot,
    room: usize,
    ways: Vec<Cells>,
    placed: Vec<Piece>,
}

impl Room<'_> {
    /// The best place for a piece, with some chance in it.
    fn place(&self, category: &str, kind: Kind, beds: usize, stream: &mut Stream) -> Option<Piece> {
        let mut draw =
            |[least, most]: [i32; 2]| least + stream.below((most - least + 1) as usize) as i32;
        let width = match kind.stand {
            Stand::Bed if beds > 1 || self.plot.rects[0].size(0) < 70 => draw(SINGLE_BED),
            Stand::Bed => draw(DOUBLE_BED),
            _ => draw(kind.width),
        };
        // Even lengths have their middle on a cell's edge.
        let (width, depth) = (width / 2 * 2, draw(kind.depth));
        let height_cm = draw(kind.height_cm);
        let mut best: Option<(i32, Piece)> = None;
        for quarters in 0..4 {
            for surface in self.surfaces(kind, quarters, [width, depth]) {
                let Some((body, clear)) = self.stands(kind, quarters, surface) else {
                    continue;
                };
                let piece = Piece {
                    category: category.to_owned(),
                    room: self.room,
                    kind,
                    quarters,
                    surface,
                    height_cm,
                    body,
                    clear,
                };
                let score = self.score(&piece) + stream.below(12) as i32;
                if best.as_ref().is_none_or(|(most, _)| score > *most) {
                    best = Some((score, piece));
                }
            }
        }
        best.map(|(_, piece)| piece)
    }

    /// Rectangles the surface may take when the front looks to a side.
    fn surfaces(&self, kind: Kind, quarters: usize, [width, depth]: [i32; 2]) -> Vec<Cells> {
        let (along, across) = axes(quarters);
        let mut found = Vec::new();
        let mut put = |back: i32, side: i32| {
            // `back` is the coordinate of the edge away from the front.
            let (mut low, mut high) = ([0; 2], [0; 2]);
            let front = if quarters < 2 {
                back + depth
            } else {
                back - depth
            };
            (low[along], high[along]) = (back.min(front), back.max(front));
            (low[across], high[across]) = (side, side + width);
            found.push(Cells { low, high });
        };
        for rect in &self.plot.rects {
            let sides = rect.low[across]..=rect.high[across] - width;
            match kind.stand {
                Stand::Middle | Stand::BeforeCouch => {
                    for back in (rect.low[along]..=rect.high[along]).step_by(2) {
                        for side in sides.clone().step_by(2) {
                            put(back, side);
                        }
                    }
                }
                Stand::BesideBed => {
                    let beds = self.placed.iter().filter(|piece| {
                        piece.kind.stand == Stand::Bed && piece.quarters == quarters
                    });
                    for bed in beds {
                        let back = against_wall(rect, quarters, kind.back);
                        put(back, bed.body.low[across] - GAP - width);
                        put(back, bed.body.high[across] + GAP);
                    }
                }
                _ => {
                    for side in sides {
                        put(against_wall(rect, quarters, kind.back), side);
                    }
                }
            }
        }
        found
    }

    /// Body and free floor of a surface, if it may stand there.
    fn stands(&self, kind: Kind, quarters: usize, surface: Cells) -> Option<(Cells, Vec<Cells>)> {
        let (along, across) = axes(quarters);
        let floats = matches!(kind.stand, Stand::Middle | Stand::BeforeCouch);
        let mut body = surface;
        let (back, front) = (if floats { 0 } else { kind.back - WALL }, kind.front);
        let (before, behind) = if quarters < 2 {
            (back, front)
        } else {
            (front, back)
        };
        body.low[along] -= before;
        body.high[along] += behind;
        body.low[across] -= kind.side;
        body.high[across] += kind.side;

        let inside = |cells: &Cells| {
            self.plot
                .rects
                .iter()
                .any(|rect| rect.grown(-WALL).holds(cells))
        };
        let hindered = |other: &Piece| {
            other.body.grown(GAP).meets(&body) || other.clear.iter().any(|clear| clear.meets(&body))
        };
        if !inside(&body)
            || self.ways.iter().any(|way| way.meets(&body))
            || self.placed.iter().any(hindered)
        {
            return None;
        }
        let is_free = |cells: &Cells| {
            inside(cells) && !self.placed.iter().any(|other| cells.meets(&other.body))
        };
        let clear = free_floor(kind, quarters, &body, surface.size(across));
        clear
            .into_iter()
            .find(|clear| clear.iter().all(is_free))
            .map(|clear| (body, clear))
    }

    /// How well a piece stands, in cells.
    fn score(&self, piece: &Piece) -> i32 {
        let (along, across) = axes(piece.quarters);
        let middle = |cells: &Cells, axis: usize| cells.low[axis] + cells.high[axis];
        let couch = self.placed.iter().find(|other| other.category == "couch");
        let rect = self
            .plot
            .rects
            .iter()
            .find(|rect| rect.holds(&piece.surface))
            .expect("it stands in the room");
        let off_center = |axis: usize| (middle(&piece.body, axis) - middle(rect, axis)).abs() / 2;
        let mut score = match (piece.kind.stand, couch) {
            (Stand::Middle, _) => {
                let lengthwise = rect.size(across) >= rect.size(along);
                -4 * (off_center(0) + off_center(1)) + if lengthwise { 60 } else { 0 }
            }
            (Stand::BeforeCouch, Some(couch)) => {
                let (_, side) = axes(couch.quarters);
                let beside = (middle(&piece.body, side) - middle(&couch.body, side)).abs() / 2;
                let ahead = distance(&piece.body, &couch.body);
                -4 * beside - 3 * (ahead - PASSAGE).abs()
                    + if piece.quarters == couch.quarters {
                        200
                    } else {
                        0
                    }
            }
            (Stand::BeforeCouch, None) => -2 * (off_center(0) + off_center(1)),
            (Stand::OppositeCouch, Some(couch)) => {
                let beside = (middle(&piece.body, across) - middle(&couch.body, across)).abs() / 2;
                let opposite = piece.quarters == (couch.quarters + 2) % 4;
                -4 * beside + if opposite { 300 } else { 0 }
            }
            (Stand::Bed, _)
                if self.placed.iter().any(|other| {
                    other.kind.stand == Stand::Bed && other.quarters == piece.quarters
                }) =>
            {
                150
            }
            (Stand::Bed, _) if piece.surface.size(across) >= DOUBLE_BED[0] => {
                -3 * off_center(across)
            }
            (_, None) if piece.category == "couch" => {
                // What stands opposite needs the wall there.
                let mut opposite = *rect;
                (opposite.low[across], opposite.high[across]) =
                    (piece.body.low[across], piece.body.high[across]);
                let way = self.ways.iter().any(|way| way.meets(&opposite));
                -3 * off_center(across) - if way { 150 } else { 0 }
            }
            _ if piece.kind.stand == Stand::OppositeCouch => -3 * off_center(across),
            _ => 0,
        };
        if piece.kind.stand == Stand::Row {
            let beside = self.placed.iter().any(|other| {
                other.kind.stand == Stand::Row
                    && other.quarters == piece.quarters
                    && distance(&piece.body, &other.body) <= 2
            });
            score += if beside { 200 } else { 0 };
        }
        // Nooks that nobody can stand in, between bodies or between a body and a wall.
        let nook = |gap: i32| {
            if (4..PASSAGE).contains(&gap) {
                30 - (gap - 4).min(PASSAGE - gap)
            } else {
                0
            }
        };
        for other in &self.placed {
            score -= nook(distance(&piece.body, &other.body));
        }
        for axis in 0..2 {
            score -= nook(piece.body.low[axis] - rect.low[axis] - WALL)
                + nook(rect.high[axis] - WALL - piece.body.high[axis]);
        }
        score
    }
}

/// Along the front's direction, and from side to side.
fn axes(quarters: usize) -> (usize, usize) {
    (quarters % 2, 1 - quarters % 2)
}

/// Where the back edge is when a piece stands so far from the wall.
fn against_wall(rect: &Cells, quarters: usize, gap: i32) -> i32 {
    let axis = quarters % 2;
    if quarters < 2 {
        rect.low[axis] + gap
    } else {
        rect.high[axis] - gap
    }
}

/// The floor that must stay free, one of these: before the front; of a bed at its sides, from the
/// foot to the pillows.
fn free_floor(kind: Kind, quarters: usize, body: &Cells, width: i32) -> Vec<Vec<Cells>> {
    let (along, across) = axes(quarters);
    let beside = |low_side: bool| {
        let mut cells = *body;
        let edge = if low_side {
            body.low[across]
        } else {
            body.high[across]
        };
        (cells.low[across], cells.high[across]) = if low_side {
            (edge - PASSAGE, edge)
        } else {
            (edge, edge + PASSAGE)
        };
        let pillows = 16;
        if quarters < 2 {
            cells.low[along] += pillows
        } else {
            cells.high[along] -= pillows
        }
        cells
    };
    let mut ahead = *body;
    if quarters < 2 {
        (ahead.low[along], ahead.high[along]) = (body.high[along], body.high[along] + PASSAGE);
    } else {
        (ahead.low[along], ahead.high[along]) = (body.low[along] - PASSAGE, body.low[along]);
    }
    match kind.stand {
        Stand::Middle | Stand::BeforeCouch => vec![vec![body.grown(PASSAGE)]],
        // Arms are short: a wide bed is reached from both sides, a narrow one from one.
        Stand::Bed if width >= DOUBLE_BED[0] => vec![vec![beside(true), beside(false)]],
        Stand::Bed => vec![vec![beside(true)], vec![beside(false)]],
        _ => vec![vec![ahead]],
    }
}

/// Least distance of two rectangles along the axis that parts them, in cells.
fn distance(a: &Cells, b: &Cells) -> i32 {
    let gap = |axis: usize| (a.low[axis] - b.high[axis]).max(b.low[axis] - a.high[axis]);
    gap(0).max(gap(1)).max(0)
}
