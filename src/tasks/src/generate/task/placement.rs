//! Where objects stand: the static filter, and collision-free placement within reach
//! (paper, Collision-Free Object Placement and Two-Stage Task Filtering;
//! docs/spec.md#placement and docs/spec.md#task-filters). Never simulates.

use std::collections::BTreeMap;

use crate::Stream;
use reel_world::Rect;
use serde::Serialize;

use super::ground::{Side, Site};
pub use crate::placement::{MARGIN_M, TRIES_MAX};
use crate::placement::{are_apart, footprint};

/// Objects stand at most so far from the edge they are reached over, in metres.
pub const BAND_M: f64 = 0.5;
/// Radius in which the nearest point of that edge has to be free of anything else, in metres.
pub const STAND_RADIUS_M: f64 = 0.05;
/// Grid of candidates within the band, in metres.
const STEP_M: f64 = 0.05;

/// Why an object cannot be placed.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PlacementError {
    /// Its footprint does not fit the surface.
    TooLarge,
    /// It is higher than the room above the surface.
    TooTall,
    /// The static filter found no free place in [`TRIES_MAX`] tries.
    TriesExceeded,
    /// There is a free place, but none within reach over an edge at which a robot can stand.
    OutOfReach,
}

impl PlacementError {
    /// The reason as a phrase for reports, e.g. `too large for the surface`.
    pub fn as_str(self) -> &'static str {
        match self {
            PlacementError::TooLarge => "too large for the surface",
            PlacementError::TooTall => "too tall for the room above the surface",
            PlacementError::TriesExceeded => "no free place in 2000 tries",
            PlacementError::OutOfReach => "no free place within reach",
        }
    }
}

/// The static filter: whether objects (width, depth, height) fit on a surface
/// together, tried at random.
pub fn static_filter(
    site: &Site,
    sizes: &[[f64; 3]],
    stream: &mut Stream,
) -> Result<(), PlacementError> {
    let mut placed: Vec<Rect> = Vec::new();
    for size in sizes {
        let centres = centres(site, *size)?;
        let found = (0..TRIES_MAX).find_map(|_| {
            let centre = [0, 1].map(|axis| stream.between(centres.min[axis], centres.max[axis]));
            let footprint = footprint(centre, *size);
            placed
                .iter()
                .all(|other| are_apart(&footprint, other))
                .then_some(footprint)
        });
        placed.push(found.ok_or(PlacementError::TriesExceeded)?);
    }
    Ok(())
}

/// What stands where, as it is placed.
#[derive(Debug, Default)]
pub struct Placement {
    placed: BTreeMap<String, Vec<Rect>>,
}

impl Placement {
    /// Finds a place for an object (width, depth, height) and takes it; gives the centre of its
    /// box on the surface.
    ///
    /// Candidates lie on a grid over strips along the edges. Of those that are free
    /// and within reach it takes the one farthest from all objects placed before; the
    /// first object stands anywhere.
    pub fn place(
        &mut self,
        site: &Site,
        size: [f64; 3],
        stream: &mut Stream,
    ) -> Result<[f64; 3], PlacementError> {
        let centres = centres(site, size)?;
        let placed = self
            .placed
            .entry(site.receptacle.id.to_string())
            .or_default();
        let candidates = candidates(site, &centres, stream);
        let free: Vec<[f64; 2]> = candidates
            .into_iter()
            .filter(|centre| {
                placed
                    .iter()
                    .all(|other| are_apart(&footprint(*centre, size), other))
                    && is_valid(site, *centre, size)
            })
            .collect();
        let spread = |centre: &[f64; 2]| {
            placed
                .iter()
                .map(|other| distance(*centre, middle(other)))
                .fold(f64::INFINITY, f64::min)
        };
        let best = match placed.as_slice() {
            [] => stream.pick(&free).copied(),
            // The first of equals.
            _ => free
                .iter()
                .rev()
                .max_by(|a, b| spread(a).total_cmp(&spread(b)))
                .copied(),
        };
        let centre = best.ok_or(PlacementError::OutOfReach)?;
        placed.push(footprint(centre, size));
        Ok([
            centre[0],
            centre[1],
            site.receptacle.surface_height() + size[2] / 2.0,
        ])
    }
}

/// Whether an object may stand at a place of a site, other objects apart: its round footprint is
/// free, and it can be reached.
pub fn is_valid(site: &Site, centre: [f64; 2], [width, depth, _]: [f64; 3]) -> bool {
    let (side, away) = nearest_side(site, centre);
    away <= BAND_M
        && site.is_free_around(side.nearest(&site.surface(), centre), STAND_RADIUS_M)
        && site.is_free_above(centre, 0.5 * (width * width + depth * depth).sqrt())
}

/// The edge an object is reached over, and how far it is: the nearest one, or the
/// one with the door.
pub fn nearest_side(site: &Site, centre: [f64; 2]) -> (Side, f64) {
    let surface = site.surface();
    let sides = Side::ALL
        .into_iter()
        .filter(|side| site.front.is_none_or(|front| front == *side));
    let by_distance = sides.map(|side| (side, side.distance(&surface, centre)));
    by_distance
        .min_by(|(_, a), (_, b)| a.total_cmp(b))
        .expect("a surface has four sides")
}

/// Where the centre of an object can be.
fn centres(site: &Site, [width, depth, height]: [f64; 3]) -> Result<Rect, PlacementError> {
    if height + site.headroom_m > site.clearance_m {
        return Err(PlacementError::TooTall);
    }
    let Rect { min, max } = site.surface();
    let rim = [width / 2.0 + MARGIN_M, depth / 2.0 + MARGIN_M];
    let centres = Rect {
        min: [0, 1].map(|axis| min[axis] + rim[axis]),
        max: [0, 1].map(|axis| max[axis] - rim[axis]),
    };
    if (0..2).any(|axis| centres.min[axis] >= centres.max[axis]) {
        Err(PlacementError::TooLarge)
    } else {
        Ok(centres)
    }
}

/// Grid points within the strips along the edges, at a random offset; whole millimetres.
fn candidates(site: &Site, centres: &Rect, stream: &mut Stream) -> Vec<[f64; 2]> {
    let axis = |axis: usize, stream: &mut Stream| -> Vec<f64> {
        let (from, to) = (centres.min[axis], centres.max[axis]);
        let start = from + stream.between(0.0, STEP_M.min(to - from));
        let count = ((to - start) / STEP_M) as usize + 1;
        let points =
            (0..count).map(|index| ((start + index as f64 * STEP_M) * 1000.0).round() / 1000.0);
        points.filter(|point| (from..=to).contains(point)).collect()
    };
    let (xs, ys) = (axis(0, stream), axis(1, stream));
    let points = ys.iter().flat_map(|y| xs.iter().map(|x| [*x, *y]));
    points
        .filter(|point| nearest_side(site, *point).1 <= BAND_M)
        .collect()
}

fn middle(rect: &Rect) -> [f64; 2] {
    [0, 1].map(|axis| (rect.min[axis] + rect.max[axis]) / 2.0)
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sqrt()
}
