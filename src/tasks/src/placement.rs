//! The static filter: where an object may stand on a surface (paper,
//! Two-Stage Task Filtering; docs/spec.md#task-filters).

use std::collections::BTreeMap;

use reel_world::{Receptacle, ReceptacleId, Rect};

use crate::random::Stream;

/// Free rim of a surface, and free space between objects, in metres.
pub const MARGIN_M: f64 = 0.05;
/// Most tries of the static filter for one object.
pub const TRIES_MAX: usize = 2000;
/// Gap between an object and the surface it is about to settle
/// on, in metres (docs/spec.md#real-bench).
pub(crate) const SPAWN_GAP_M: f64 = 0.02;
/// Objects stand at most this far from an edge, in metres, so that a gripper reaches them.
const REACH_M: f64 = 0.45;
/// Highest object behind a door, in metres.
const DOOR_CLEARANCE_M: f64 = 0.25;

/// What already stands where.
#[derive(Default)]
pub(crate) struct Occupancy {
    taken: BTreeMap<ReceptacleId, Vec<Rect>>,
}

/// Why an object cannot be placed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum PlacementError {
    TooLarge,
    TriesExceeded,
}

/// Whether an object fits an empty receptacle at all.
pub(crate) fn fits(receptacle: &Receptacle, [width, depth, height]: [f64; 3]) -> bool {
    let Rect { min, max } = receptacle.surface_rect();
    let wide_enough =
        max[0] - min[0] >= width + 2.0 * MARGIN_M && max[1] - min[1] >= depth + 2.0 * MARGIN_M;
    wide_enough && (!receptacle.door.exists() || height <= DOOR_CLEARANCE_M)
}

impl Occupancy {
    /// Finds a free place on a receptacle and takes it; gives the centre of the object's box.
    pub fn place(
        &mut self,
        receptacle: &Receptacle,
        size: [f64; 3],
        stream: &mut Stream,
    ) -> Result<[f64; 3], PlacementError> {
        if !fits(receptacle, size) {
            return Err(PlacementError::TooLarge);
        }
        let surface = receptacle.surface_rect();
        let taken = self.taken.entry(receptacle.id.clone()).or_default();
        let half = [size[0] / 2.0, size[1] / 2.0];
        for _ in 0..TRIES_MAX {
            let centre = [0, 1].map(|axis| {
                let inset = half[axis] + MARGIN_M;
                round_mm(stream.between(surface.min[axis] + inset, surface.max[axis] - inset))
            });
            let edges = [0, 1].map(|axis| {
                (centre[axis] - surface.min[axis]).min(surface.max[axis] - centre[axis])
            });
            let footprint = footprint(centre, size);
            if edges[0].min(edges[1]) <= REACH_M
                && taken.iter().all(|other| are_apart(&footprint, other))
            {
                taken.push(footprint);
                let z = receptacle.surface_height() + size[2] / 2.0 + SPAWN_GAP_M;
                return Ok([centre[0], centre[1], (z * 10_000.0).round() / 10_000.0]);
            }
        }
        Err(PlacementError::TriesExceeded)
    }
}

/// The ground that an object (width, depth, height) covers around its centre.
pub(crate) fn footprint([x, y]: [f64; 2], [width, depth, _]: [f64; 3]) -> Rect {
    Rect {
        min: [x - width / 2.0, y - depth / 2.0],
        max: [x + width / 2.0, y + depth / 2.0],
    }
}

/// Whether two footprints keep [`MARGIN_M`] between them.
pub(crate) fn are_apart(a: &Rect, b: &Rect) -> bool {
    (0..2)
        .any(|axis| a.min[axis] >= b.max[axis] + MARGIN_M || b.min[axis] >= a.max[axis] + MARGIN_M)
}

fn round_mm(length_m: f64) -> f64 {
    (length_m * 1000.0).round() / 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_surface_fills_up_and_then_refuses() {
        let scene = crate::home_scene();
        let table = scene.receptacle(&"table_2".into()).unwrap();
        let (mut occupancy, mut stream) = (Occupancy::default(), Stream::new(1, "test", 0));
        let misfit =
            (0..100).find_map(|_| occupancy.place(table, [0.2, 0.2, 0.1], &mut stream).err());
        assert_eq!(misfit, Some(PlacementError::TriesExceeded));
        let placed = &occupancy.taken[&table.id];
        assert!((3..=8).contains(&placed.len()), "{placed:?}");
        for (index, a) in placed.iter().enumerate() {
            assert!(placed[..index].iter().all(|b| are_apart(a, b)));
        }
    }

    #[test]
    fn what_is_too_large_is_refused_at_once() {
        let scene = crate::home_scene();
        let place = |id: &str, size| {
            let receptacle = scene.receptacle(&id.into()).unwrap();
            Occupancy::default().place(receptacle, size, &mut Stream::new(1, "test", 0))
        };
        assert_eq!(
            place("table_2", [0.95, 0.2, 0.1]),
            Err(PlacementError::TooLarge)
        );
        assert_eq!(
            place("microwave_1", [0.1, 0.1, 0.26]),
            Err(PlacementError::TooLarge)
        );
        assert!(place("table_2", [0.1, 0.1, 0.26]).is_ok());
    }
}
