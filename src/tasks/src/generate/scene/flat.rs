//! The empty flat: rooms in two bands (with a corridor between them, and in several wings,
//! where they are many), balconies before the outline, doorways and walls. Whole cells of 5
//! cm; never places furniture.

use crate::random::Stream;
use reel_world::Wall;

use super::{
    Brief,
    kinds::{CELLS_PER_M, RoomKind, room_kind},
};

/// Width of a doorway, and of a wide one.
const DOORWAY: [i32; 2] = [20, 34];
/// A doorway keeps this far from the ends of its edge.
const CORNER: i32 = 3;
/// Depth of a corridor.
const CORRIDOR: i32 = 32;
/// Most rooms along one corridor; more make another wing.
const WING_ROOMS: usize = 12;
/// Greatest width of a balcony, in cells of 5 cm.
const BALCONY_WIDTH: i32 = 90;
/// Arrangements that are tried.
const TRIES: usize = 300;
const WALL_HEIGHT_M: f64 = 2.5;

/// A rectangle of cells, its upper corner outside.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Cells {
    pub(super) low: [i32; 2],
    pub(super) high: [i32; 2],
}

impl Cells {
    /// Whether two share a cell.
    pub(super) fn meets(&self, other: &Cells) -> bool {
        (0..2).all(|axis| self.low[axis] < other.high[axis] && other.low[axis] < self.high[axis])
    }

    /// Whether the other lies within.
    pub(super) fn holds(&self, other: &Cells) -> bool {
        (0..2).all(|axis| self.low[axis] <= other.low[axis] && other.high[axis] <= self.high[axis])
    }

    /// Larger by a margin on every side.
    pub(super) fn grown(&self, margin: i32) -> Cells {
        Cells {
            low: self.low.map(|value| value - margin),
            high: self.high.map(|value| value + margin),
        }
    }

    pub(super) fn size(&self, axis: usize) -> i32 {
        self.high[axis] - self.low[axis]
    }
}

/// A room with its place.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Plot {
    pub(super) name: String,
    pub(super) kind: &'static str,
    pub(super) passed: bool,
    pub(super) rects: Vec<Cells>,
    pub(super) pieces: Vec<String>,
}

/// A stretch of a border between two rooms.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Doorway {
    /// The axis the border is perpendicular to, and its coordinate.
    pub(super) across: usize,
    pub(super) at: i32,
    pub(super) from: i32,
    pub(super) to: i32,
    pub(super) rooms: [usize; 2],
}

/// Rooms and the doorways between them.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Flat {
    pub(super) plots: Vec<Plot>,
    pub(super) doorways: Vec<Doorway>,
}

/// Arranges the rooms of a brief; none where no arrangement lets one reach every room without
/// passing through a bedroom or the like.
pub(super) fn arrange(brief: &Brief, stream: &mut Stream) -> Option<Flat> {
    let mut plots = Vec::new();
    let mut sizes = Vec::new();
    for (name, pieces) in &brief.rooms {
        let (
            kind,
            RoomKind {
                width,
                depth,
                passed,
                ..
            },
        ) = room_kind(name)?;
        plots.push(Plot {
            name: name.clone(),
            kind,
            passed,
            rects: Vec::new(),
            pieces: pieces.clone(),
        });
        let count = pieces.len() as i32;
        sizes.push([
            width + 8 * (count - 2).max(0) + stream.below(9) as i32,
            depth + 6 * (count - 3).max(0),
        ]);
    }
    let named = |kind: &str| {
        (0..plots.len())
            .filter(|index| plots[*index].kind == kind)
            .collect::<Vec<_>>()
    };
    let (balconies, corridors) = (named("balcony"), named("corridor"));
    let inner: Vec<usize> = (0..plots.len())
        .filter(|index| !balconies.contains(index) && !corridors.contains(index))
        .collect();
    let corridor = corridors.first().copied();
    if inner.is_empty() || corridors.len() > 1 || (corridor.is_none() && inner.len() > WING_ROOMS) {
        return None;
    }
    if !plots.iter().any(|plot| plot.passed) {
        plots[inner[0]].passed = true;
    }

    let wings = inner.len().div_ceil(WING_ROOMS);
    let of_wing =
        |wing: usize| -> Vec<usize> { inner.iter().copied().skip(wing).step_by(wings).collect() };
    let mut best: Option<(i32, Vec<Plot>)> = None;
    for _ in 0..if corridor.is_some() {
        TRIES / 10
    } else {
        TRIES
    } {
        let bands: Vec<[Vec<usize>; 2]> = (0..wings)
            .map(|wing| split(of_wing(wing), &sizes, stream))
            .collect();
        let mut tried = plots.clone();
        let stretch = lay_bands(&mut tried, &bands, &sizes, corridor);
        if balconies
            .iter()
            .all(|balcony| lay_balcony(&mut tried, *balcony, &bands, &sizes))
            && all_reached(&tried)
        {
            let score = score(&tried) - stretch;
            if best.as_ref().is_none_or(|(most, _)| score > *most) {
                best = Some((score, tried));
            }
        }
    }
    let (_, plots) = best?;
    let doorways = doorways(&plots, stream);
    Some(Flat { plots, doorways })
}

/// Rooms in random order, cut where both halves are about equally wide.
fn split(rooms: Vec<usize>, sizes: &[[i32; 2]], stream: &mut Stream) -> [Vec<usize>; 2] {
    let rooms = stream.pick_some(&rooms, rooms.len());
    let width = |rooms: &[usize]| rooms.iter().map(|room| sizes[*room][0]).sum::<i32>();
    let cut = (1..=rooms.len())
        .min_by_key(|cut| (width(&rooms[..*cut]) - width(&rooms[*cut..])).abs())
        .unwrap_or(1);
    [rooms[..cut].to_vec(), rooms[cut..].to_vec()]
}

/// Gives the rooms of all wings their rectangles; gives how many cells rooms became wider
/// than they would be.
fn lay_bands(
    plots: &mut [Plot],
    wings: &[[Vec<usize>; 2]],
    sizes: &[[i32; 2]],
    corridor: Option<usize>,
) -> i32 {
    let band_width = |band: &[usize]| band.iter().map(|room| sizes[*room][0]).sum::<i32>();
    let width = wings
        .iter()
        .flatten()
        .map(|band| band_width(band))
        .max()
        .unwrap_or(0);
    let mut stretch = 0;
    let mut strips = Vec::new();
    let mut y = 0;
    for wing in wings {
        for (index, band) in wing.iter().enumerate().filter(|(_, band)| !band.is_empty()) {
            let depth = band.iter().map(|room| sizes[*room][1]).max().unwrap_or(0);
            let own = band_width(band);
            stretch += width - own;
            let (mut x, mut share) = (0, 0);
            for room in band {
                share += sizes[*room][0];
                let end = share * width / own;
                plots[*room].rects = vec![Cells {
                    low: [x, y],
                    high: [end, y + depth],
                }];
                x = end;
            }
            y += depth;
            if index == 0 && corridor.is_some() {
                strips.push(Cells {
                    low: [0, y],
                    high: [width, y + CORRIDOR],
                });
                y += CORRIDOR;
            }
        }
    }
    if let Some(corridor) = corridor {
        if let [first, .., last] = strips[..] {
            strips.push(Cells {
                low: [-CORRIDOR, first.low[1]],
                high: [0, last.high[1]],
            });
        }
        plots[corridor].rects = strips;
    }
    stretch
}

/// Puts a balcony before an outer room, one that has none yet; whether there is one.
fn lay_balcony(
    plots: &mut [Plot],
    balcony: usize,
    wings: &[[Vec<usize>; 2]],
    sizes: &[[i32; 2]],
) -> bool {
    const HOSTS: [&str; 5] = reel_world::words! {
        "living room" "dining room" bedroom "study room" kitchen
    };
    let depth = sizes[balcony][1];
    let outer = [(&wings[0][0], false), (&wings[wings.len() - 1][1], true)];
    let before = |host: &Cells, above: bool| {
        let y = if above {
            host.high[1]
        } else {
            host.low[1] - depth
        };
        let width = host.size(0).min(BALCONY_WIDTH);
        Cells {
            low: [host.low[0], y],
            high: [host.low[0] + width, y + depth],
        }
    };
    let places = HOSTS.iter().flat_map(|kind| {
        let rooms = outer
            .iter()
            .flat_map(|(band, above)| band.iter().map(move |room| (*room, *above)));
        rooms
            .filter(|(room, _)| plots[*room].kind == *kind)
            .map(|(room, above)| before(&plots[room].rects[0], above))
    });
    let free = |place: &Cells| {
        plots
            .iter()
            .flat_map(|plot| &plot.rects)
            .all(|rect| !rect.meets(place))
    };
    let place = places.into_iter().find(free);
    plots[balcony].rects = place.into_iter().collect();
    place.is_some()
}

/// The borders between two rooms that are long enough for a doorway.
fn borders(plots: &[Plot], a: usize, b: usize) -> Vec<Doorway> {
    let mut borders = Vec::new();
    for one in &plots[a].rects {
        for other in &plots[b].rects {
            for across in 0..2 {
                let along = 1 - across;
                let (from, to) = (
                    one.low[along].max(other.low[along]),
                    one.high[along].min(other.high[along]),
                );
                let at = [
                    (one.high[across], other.low[across]),
                    (one.low[across], other.high[across]),
                ];
                if let Some((at, _)) = at.into_iter().find(|(mine, others)| mine == others)
                    && to - from >= DOORWAY[0] + 2 * CORNER
                {
                    borders.push(Doorway {
                        across,
                        at,
                        from,
                        to,
                        rooms: [a, b],
                    });
                }
            }
        }
    }
    borders
}

fn are_neighbours(plots: &[Plot], a: usize, b: usize) -> bool {
    !borders(plots, a, b).is_empty()
}

/// Rooms that a room may have its door to, the best first.
fn hosts(plots: &[Plot], room: usize) -> Vec<usize> {
    let order: &[&str] = match plots[room].kind {
        "balcony" => &[
            "living room",
            "dining room",
            "bedroom",
            "study room",
            "kitchen",
        ],
        "kitchen" => &["dining room", "corridor", "living room", "entry"],
        _ => &["corridor", "living room", "dining room", "entry"],
    };
    let neighbours =
        (0..plots.len()).filter(|other| *other != room && are_neighbours(plots, room, *other));
    let open = neighbours.filter(|other| plots[*other].passed || plots[room].kind == "balcony");
    let mut hosts: Vec<usize> = open
        .filter(|other| plots[*other].kind != "balcony")
        .collect();
    hosts.sort_by_key(|other| {
        order
            .iter()
            .position(|kind| *kind == plots[*other].kind)
            .unwrap_or(order.len())
    });
    hosts
}

/// Whether every room has a door to one that is passed through, and those are joined.
fn all_reached(plots: &[Plot]) -> bool {
    let passed: Vec<usize> = (0..plots.len())
        .filter(|room| plots[*room].passed)
        .collect();
    let mut seen = vec![passed[0]];
    let mut next = 0;
    while next < seen.len() {
        let new = passed
            .iter()
            .filter(|room| !seen.contains(room) && are_neighbours(plots, seen[next], **room));
        seen.extend(new.copied().collect::<Vec<_>>());
        next += 1;
    }
    seen.len() == passed.len()
        && (0..plots.len()).all(|room| plots[room].passed || !hosts(plots, room).is_empty())
}

/// What is pleasant: dining between kitchen and living room, the entry at one's side.
fn score(plots: &[Plot]) -> i32 {
    let first = |kind: &str| plots.iter().position(|plot| plot.kind == kind);
    let near = |a: &str, b: &str, worth: i32| match (first(a), first(b)) {
        (Some(a), Some(b)) if are_neighbours(plots, a, b) => worth,
        _ => 0,
    };
    near("kitchen", "dining room", 40)
        + near("living room", "dining room", 40)
        + near("entry", "living room", 10)
}

fn doorways(plots: &[Plot], stream: &mut Stream) -> Vec<Doorway> {
    let mut pairs: Vec<[usize; 2]> = Vec::new();
    for room in 0..plots.len() {
        if plots[room].passed {
            pairs.extend(
                (0..room)
                    .filter(|other| plots[*other].passed)
                    .map(|other| [other, room]),
            );
        } else {
            pairs.extend(hosts(plots, room).first().map(|host| [*host, room]));
        }
    }
    let is = |room: usize, kinds: &[&str]| kinds.contains(&plots[room].kind);
    let open = |[a, b]: [usize; 2]| {
        let rooms = ["living room", "dining room", "balcony"];
        is(a, &rooms) && is(b, &rooms)
    };
    pairs
        .into_iter()
        .filter_map(|pair| {
            let border = borders(plots, pair[0], pair[1])
                .into_iter()
                .max_by_key(|border| border.to - border.from)?;
            let room = border.to - border.from - 2 * CORNER;
            let width = if open(pair) && room >= DOORWAY[1] + 8 {
                DOORWAY[1]
            } else {
                DOORWAY[0]
            };
            let spare = room - width;
            // Best at an end: so a long stretch of wall stays free.
            let shift = [0, 0, spare, spare, spare / 2][stream.below(5)];
            let from = border.from + CORNER + shift;
            Some(Doorway {
                from,
                to: from + width,
                ..border
            })
        })
        .collect()
}

impl Flat {
    /// The walls: between rooms on their border, to the outside behind it.
    pub(super) fn walls(&self) -> Vec<Wall> {
        let rects: Vec<(usize, &Cells)> = self
            .plots
            .iter()
            .enumerate()
            .flat_map(|(room, plot)| plot.rects.iter().map(move |rect| (room, rect)))
            .collect();
        let mut walls = Vec::new();
        for across in 0..2 {
            let along = 1 - across;
            let mut lines: Vec<i32> = rects
                .iter()
                .flat_map(|(_, rect)| [rect.low[across], rect.high[across]])
                .collect();
            lines.sort_unstable();
            lines.dedup();
            for at in lines {
                let touching = rects
                    .iter()
                    .filter(|(_, rect)| rect.low[across] == at || rect.high[across] == at);
                let ways = self
                    .doorways
                    .iter()
                    .filter(|way| way.across == across && way.at == at);
                let mut cuts: Vec<i32> = touching
                    .flat_map(|(_, rect)| [rect.low[along], rect.high[along]])
                    .collect();
                cuts.extend(ways.clone().flat_map(|way| [way.from, way.to]));
                cuts.sort_unstable();
                cuts.dedup();
                // Stretches of one sort: -1 and 1 have the outside there, 0 a room on both sides.
                let mut runs: Vec<(i32, i32, i32)> = Vec::new();
                for pair in cuts.windows(2) {
                    let spans =
                        |rect: &Cells| rect.low[along] <= pair[0] && pair[1] <= rect.high[along];
                    let below = rects
                        .iter()
                        .find(|(_, rect)| rect.high[across] == at && spans(rect))
                        .map(|(room, _)| room);
                    let above = rects
                        .iter()
                        .find(|(_, rect)| rect.low[across] == at && spans(rect))
                        .map(|(room, _)| room);
                    let sort = match (below, above) {
                        (None, None) => continue,
                        (Some(_), None) => 1,
                        (None, Some(_)) => -1,
                        (a, b) if a == b => continue,
                        _ => 0,
                    };
                    if ways
                        .clone()
                        .any(|way| way.from <= pair[0] && pair[1] <= way.to)
                    {
                        continue;
                    }
                    match runs.last_mut() {
                        Some((last, _, to)) if *last == sort && *to == pair[0] => *to = pair[1],
                        _ => runs.push((sort, pair[0], pair[1])),
                    }
                }
                walls.extend(runs.into_iter().map(|(sort, from, to)| {
                    let point = |end: i32| {
                        let mut point = [metres(f64::from(end)); 2];
                        point[across] = metres(f64::from(at) + f64::from(sort));
                        point
                    };
                    Wall {
                        from: point(from),
                        to: point(to),
                        height: WALL_HEIGHT_M,
                    }
                }));
            }
        }
        walls
    }
}

/// Cells in metres, to the millimetre.
pub(super) fn metres(cells: f64) -> f64 {
    (cells / CELLS_PER_M * 1000.0).round() / 1000.0
}
