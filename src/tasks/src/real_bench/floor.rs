//! The floor of a rebuilt scene: rooms that hold their furniture and tile a rectangle, and places
//! for furniture that has none. Task files say which room a receptacle is in, and nothing about
//! walls, so everything here is assumed.

use std::collections::BTreeSet;

use reel_world::Rect;

/// A gap between furniture that leaves room on both sides of a wall, in metres.
const WIDE_M: f64 = 0.6;
/// Free floor between the outermost furniture and the outer walls, in metres.
const OUTER_FLOOR_M: f64 = 1.4;
/// Side of a room of which nothing is known but its name, in metres.
const UNKNOWN_ROOM_M: f64 = 3.0;
/// Borders between rooms shorter than this have no passage, in metres.
const PASSAGE_M: f64 = 1.0;
/// Distance of placed furniture from the walls, in metres.
const FROM_WALL_M: f64 = 0.1;
/// Distance between the places that are tried, in metres.
const STEP_M: f64 = 0.1;
/// Furniture that is farther away than this does not count, in metres.
const FAR_M: f64 = 1.5;

/// A part of the floor.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Tile {
    /// Index of its room.
    pub room: usize,
    pub rect: Rect,
}

/// Tiles a rectangle with `rooms` rooms, so that each holds its furniture. Where pieces of several
/// rooms cannot be separated by straight cuts, some reach out of their room.
pub(super) fn tiles(rooms: usize, pieces: &[Tile]) -> Vec<Tile> {
    let mut tiles = Vec::new();
    let mut bounds = Rect {
        min: [0.0; 2],
        max: [0.0; 2],
    };
    if let Some(hull) = hull(pieces) {
        let outward = |value: f64, by: f64| ((value + by) * 10.0).round() / 10.0;
        bounds = Rect {
            min: hull.min.map(|c| outward(c, -OUTER_FLOOR_M)),
            max: hull.max.map(|c| outward(c, OUTER_FLOOR_M)),
        };
        split(bounds, pieces.to_vec(), &mut tiles);
    }
    for room in 0..rooms {
        if !tiles.iter().any(|tile| tile.room == room) {
            let [x, y] = [bounds.max[0], bounds.min[1]];
            tiles.push(Tile {
                room,
                rect: Rect {
                    min: [x, y],
                    max: [x + UNKNOWN_ROOM_M, y + UNKNOWN_ROOM_M],
                },
            });
            bounds.max[0] += UNKNOWN_ROOM_M;
        }
    }
    tiles
}

/// Whether one can walk from every room to every other if each two neighbours share one opening.
pub(super) fn is_connected(rooms: usize, tiles: &[Tile]) -> bool {
    // Tiles of one room are one space where they touch; a room in two parts would need
    // openings of its own.
    let joined = |a: &Tile, b: &Tile| border(&a.rect, &b.rect) >= PASSAGE_M;
    let reached = |allowed: &dyn Fn(&Tile) -> bool, from: usize| {
        let mut seen = vec![from];
        let mut next = 0;
        while next < seen.len() {
            let at = seen[next];
            let more: Vec<usize> = (0..tiles.len())
                .filter(|i| {
                    !seen.contains(i) && allowed(&tiles[*i]) && joined(&tiles[at], &tiles[*i])
                })
                .collect();
            seen.extend(more);
            next += 1;
        }
        seen.len()
    };
    let whole = (0..rooms).all(|room| {
        let parts: Vec<usize> = (0..tiles.len())
            .filter(|index| tiles[*index].room == room)
            .collect();
        parts
            .first()
            .is_some_and(|first| reached(&|tile| tile.room == room, *first) == parts.len())
    });
    whole && reached(&|_| true, 0) == tiles.len()
}

/// A place for a piece of furniture in its room: along a wall, as far from other furniture
/// as there is room.
pub(super) fn place(room: usize, side_m: f64, tiles: &[Tile], taken: &[Rect]) -> Rect {
    let mut best: Option<(f64, Rect)> = None;
    for tile in tiles.iter().filter(|tile| tile.room == room) {
        for (axis, high) in [(0, false), (0, true), (1, false), (1, true)] {
            let (low, room_there) = (
                tile.rect.min.map(|c| c + FROM_WALL_M),
                [0, 1].map(|a| extent(&tile.rect, a) - 2.0 * FROM_WALL_M - side_m),
            );
            if room_there.iter().any(|free| *free < 0.0) {
                continue;
            }
            let along = 1 - axis;
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a room has few steps"
            )]
            let steps = (room_there[along] / STEP_M).floor() as usize;
            for step in 0..=steps {
                let mut min = low;
                min[axis] += if high { room_there[axis] } else { 0.0 };
                #[expect(clippy::cast_precision_loss, reason = "a room has few steps")]
                let offset = step as f64 * STEP_M;
                min[along] += offset;
                let rect = Rect {
                    min,
                    max: min.map(|c| c + side_m),
                };
                let score = taken
                    .iter()
                    .map(|other| gap(&rect, other))
                    .fold(FAR_M, f64::min);
                if best.is_none_or(|(most, _)| score > most + 1e-6) {
                    best = Some((score, rect));
                }
            }
        }
    }
    let in_the_middle = || {
        let tile = tiles
            .iter()
            .find(|tile| tile.room == room)
            .expect("every room has a tile");
        let min = [0, 1].map(|axis| (tile.rect.min[axis] + tile.rect.max[axis] - side_m) / 2.0);
        Rect {
            min,
            max: min.map(|c| c + side_m),
        }
    };
    best.map_or_else(in_the_middle, |(_, rect)| rect)
}

/// The smallest rectangle around all pieces, or `None` if there is none.
fn hull(pieces: &[Tile]) -> Option<Rect> {
    let around = |a: Rect, b: Rect| Rect {
        min: [a.min[0].min(b.min[0]), a.min[1].min(b.min[1])],
        max: [a.max[0].max(b.max[0]), a.max[1].max(b.max[1])],
    };
    pieces.iter().map(|piece| piece.rect).reduce(around)
}

/// A straight cut through the floor.
struct Cut {
    axis: usize,
    at: f64,
}

/// Cuts a rectangle until every part holds furniture of one room only.
fn split(bounds: Rect, pieces: Vec<Tile>, tiles: &mut Vec<Tile>) {
    let alone = pieces.windows(2).all(|pair| pair[0].room == pair[1].room);
    let cut = if alone {
        None
    } else {
        best_cut(&bounds, &pieces)
    };
    let Some(cut) = cut else {
        let of = |room: usize| pieces.iter().filter(|piece| piece.room == room).count();
        let most = pieces
            .iter()
            .map(|piece| piece.room)
            .max_by_key(|room| (of(*room), usize::MAX - room));
        tiles.extend(most.map(|room| Tile { room, rect: bounds }));
        return;
    };
    let (mut low, mut high) = (bounds, bounds);
    low.max[cut.axis] = cut.at;
    high.min[cut.axis] = cut.at;
    let (below, above) = pieces
        .into_iter()
        .partition(|piece| centre(&piece.rect, cut.axis) < cut.at);
    split(low, below, tiles);
    split(high, above, tiles);
}

/// The cut that crosses the fewest pieces, then leaves the most rooms whole, then runs through the
/// widest gap. A gap in which the wall would stand at the furniture counts like a room in two
/// parts: it takes away places to stand.
fn best_cut(bounds: &Rect, pieces: &[Tile]) -> Option<Cut> {
    let mut best: Option<((usize, usize, i64), Cut)> = None;
    for axis in 0..2 {
        let mut sorted = pieces.to_vec();
        sorted.sort_by(|a, b| centre(&a.rect, axis).total_cmp(&centre(&b.rect, axis)));
        for at in 1..sorted.len() {
            let (below, above) = sorted.split_at(at);
            let low = below
                .iter()
                .map(|piece| piece.rect.max[axis])
                .fold(f64::MIN, f64::max);
            let high = above
                .iter()
                .map(|piece| piece.rect.min[axis])
                .fold(f64::MAX, f64::min);
            let (last, first) = (
                centre(&below[at - 1].rect, axis),
                centre(&above[0].rect, axis),
            );
            let middle = if low <= high {
                (low + high) / 2.0
            } else {
                (last + first) / 2.0
            };
            let cut = Cut {
                axis,
                at: (middle * 1000.0).round() / 1000.0,
            };
            let inside = bounds.min[axis] < cut.at && cut.at < bounds.max[axis];
            if !inside || last >= cut.at || first < cut.at {
                continue;
            }
            let crossed = pieces
                .iter()
                .filter(|piece| piece.rect.min[axis] < cut.at && cut.at < piece.rect.max[axis])
                .count();
            let rooms = |pieces: &[Tile]| {
                pieces
                    .iter()
                    .map(|piece| piece.room)
                    .collect::<BTreeSet<_>>()
            };
            let torn =
                rooms(below).intersection(&rooms(above)).count() + usize::from(high - low < WIDE_M);
            #[expect(clippy::cast_possible_truncation, reason = "a flat is not so wide")]
            let gap_mm = ((high - low) * 1000.0).round() as i64;
            let score = (crossed, torn, -gap_mm);
            if best.as_ref().is_none_or(|(least, _)| score < *least) {
                best = Some((score, cut));
            }
        }
    }
    best.map(|(_, cut)| cut)
}

fn centre(rect: &Rect, axis: usize) -> f64 {
    (rect.min[axis] + rect.max[axis]) / 2.0
}

fn extent(rect: &Rect, axis: usize) -> f64 {
    rect.max[axis] - rect.min[axis]
}

/// Length of the border that two rectangles share, in metres.
fn border(a: &Rect, b: &Rect) -> f64 {
    let shared = [0, 1].map(|axis| a.max[axis].min(b.max[axis]) - a.min[axis].max(b.min[axis]));
    match shared {
        [x, y] if x.abs() < 1e-9 && y > 0.0 => y,
        [x, y] if y.abs() < 1e-9 && x > 0.0 => x,
        _ => 0.0,
    }
}

/// Distance between two rectangles, in metres; below 0 where they overlap.
fn gap(a: &Rect, b: &Rect) -> f64 {
    let apart = [0, 1].map(|axis| (a.min[axis] - b.max[axis]).max(b.min[axis] - a.max[axis]));
    if apart.iter().all(|distance| *distance > 0.0) {
        apart[0].hypot(apart[1])
    } else {
        apart[0].max(apart[1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tile(room: usize, min: [f64; 2], max: [f64; 2]) -> Tile {
        Tile {
            room,
            rect: Rect { min, max },
        }
    }

    fn holds(tiles: &[Tile], piece: &Tile) -> bool {
        let corners = [piece.rect.min, piece.rect.max];
        corners.iter().all(|corner| {
            tiles
                .iter()
                .any(|tile| tile.room == piece.room && tile.rect.contains(*corner))
        })
    }

    #[test]
    fn rooms_tile_the_floor_and_hold_their_furniture() {
        // Room 1 lies around a corner of room 0.
        let pieces = [
            tile(0, [0.0, 1.0], [1.0, 2.0]),
            tile(0, [1.5, 1.5], [2.0, 2.5]),
            tile(1, [0.0, -2.0], [1.0, -1.0]),
            tile(1, [3.0, 1.0], [3.5, 1.5]),
            tile(2, [-3.0, 0.0], [-2.0, 1.0]),
        ];
        let tiles = tiles(3, &pieces);
        assert!(pieces.iter().all(|piece| holds(&tiles, piece)), "{tiles:?}");
        let area = |rect: &Rect| extent(rect, 0) * extent(rect, 1);
        let whole =
            (extent(&hull(&tiles).unwrap(), 0) * extent(&hull(&tiles).unwrap(), 1) * 1e6).round();
        assert_eq!(
            (tiles.iter().map(|tile| area(&tile.rect)).sum::<f64>() * 1e6).round(),
            whole
        );
        assert!(is_connected(3, &tiles));
    }

    #[test]
    fn a_room_without_known_furniture_is_built_on() {
        let tiles = tiles(2, &[tile(0, [0.0, 0.0], [1.0, 1.0])]);
        assert_eq!(tiles.len(), 2);
        assert!(is_connected(2, &tiles));
        assert!(!is_connected(
            2,
            &[
                tile(0, [0.0, 0.0], [1.0, 1.0]),
                tile(1, [5.0, 5.0], [6.0, 6.0])
            ]
        ));
    }

    #[test]
    fn placed_furniture_stands_at_a_wall_of_its_room_far_from_other_furniture() {
        let tiles = [tile(0, [0.0, 0.0], [4.0, 3.0])];
        let taken = [Rect {
            min: [0.1, 0.1],
            max: [1.0, 1.0],
        }];
        let rect = place(0, 0.6, &tiles, &taken);
        assert!(gap(&rect, &taken[0]) >= 1.0, "{rect:?}");
        assert!(tiles[0].rect.contains(rect.min) && tiles[0].rect.contains(rect.max));
        assert_eq!(
            place(0, 5.0, &tiles, &taken).min,
            [-0.5, -1.0],
            "too large: in the middle"
        );
    }

    #[test]
    fn pieces_that_no_cut_separates_still_give_rooms() {
        let pieces = [
            tile(0, [0.0, 0.0], [1.0, 1.0]),
            tile(1, [0.0, 0.0], [1.0, 1.0]),
            tile(1, [0.2, 0.2], [1.4, 1.4]),
        ];
        let tiles = tiles(2, &pieces);
        assert!(
            (0..2).all(|room| tiles.iter().any(|tile| tile.room == room)),
            "{tiles:?}"
        );
    }
}
