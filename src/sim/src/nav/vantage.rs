//! Where to stand to look at furniture or to reach a point: candidates, their order, and
//! what counts as seen.
//!
//! Chooses among the free cells of the grid only; never moves anything.

use super::{
    CAMERA_HEIGHT_M, NavMap, REACH_M, STANDOFF_M, Viewpoint,
    path::{UNREACHED, costs_from, metres},
    sight::{Solid, is_clear, open_panel},
};
use crate::{
    geometry::{Camera, FOCAL_PX, distance_2d, dot, sub},
    model::{Furniture, SceneModel, Surface},
};

/// Distances from the furniture's bounding box to stand at, in metres; later ones only where
/// earlier ones have nothing.
const STANDOFFS_M: [[f32; 2]; 3] = [[STANDOFF_M, 1.4], [0.3, STANDOFF_M], [1.4, 2.0]];
/// Horizontal distances from a target to reach it from, in metres; later ones only where
/// earlier ones have nothing.
const REACHES_M: [[f32; 2]; 3] = [[0.35, REACH_M], [0.0, 0.35], [REACH_M, 1.3]];
/// Distances that differ by less are equally close, in metres.
const BUCKET_M: f32 = 0.1;
/// Height over the surface at which it is looked at, in metres.
const OVER_SURFACE_M: f32 = 0.02;

/// The front of what one looks into: of furniture with a door, and of shelves and drawers.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Front {
    /// Centre of the closed door or of the opening, in the scene frame.
    center: [f32; 3],
    facing: [f32; 2],
    /// The open door, which must not stand in the way when one looks in.
    panel: Vec<Solid>,
}

impl Front {
    pub(super) fn of(index: usize, furniture: &Furniture) -> Option<Self> {
        let center = match (&furniture.door, furniture.part_of) {
            (Some(door), _) => door.center,
            (None, Some(_)) => opening(furniture),
            (None, None) => return None,
        };
        Some(Self {
            center,
            facing: furniture.facing,
            panel: open_panel(index, furniture),
        })
    }

    /// Whether a point lies less than 60 degrees off the direction the front faces.
    fn sees(&self, [x, y]: [f32; 2]) -> bool {
        let [dx, dy] = [x - self.center[0], y - self.center[1]];
        dx * self.facing[0] + dy * self.facing[1] > 0.5 * libm::sqrtf(dx * dx + dy * dy)
    }
}

/// Centre of the front of a shelf, in the scene frame.
fn opening(furniture: &Furniture) -> [f32; 3] {
    let [low, high] = furniture.bounds;
    std::array::from_fn(|axis| {
        let middle = (low[axis] + high[axis]) * 0.5;
        match furniture.facing.get(axis) {
            Some(facing) => middle + facing * (high[axis] - low[axis]) * 0.5,
            None => middle,
        }
    })
}

/// The viewpoint for furniture `index`; see [`NavMap::viewpoint`].
pub(super) fn viewpoint(
    map: &NavMap,
    model: &SceneModel,
    robot: [f32; 2],
    index: usize,
) -> Option<Viewpoint> {
    let furniture = model
        .furniture
        .get(index)
        .filter(|furniture| furniture.present)?;
    let costs = costs_from(&map.grid, map.snapped(robot)?);
    let front = map.fronts.get(index).and_then(Option::as_ref);
    let surface = furniture.open_surface();
    let [center, samples @ ..] = surface_points(&surface);
    let (target, look_at) = match front {
        Some(front) => (
            front.center,
            std::array::from_fn(|axis| (front.center[axis] + center[axis]) * 0.5),
        ),
        None => (center, center),
    };
    let (mut own, others): (Vec<&Solid>, Vec<&Solid>) = map
        .solids
        .iter()
        .partition(|solid| map.is_of_piece(solid.owner, index));
    own.extend(front.iter().flat_map(|front| &front.panel));
    let [low, high] = furniture.bounds.map(|[x, y, _]| [x, y]);

    STANDOFFS_M.iter().find_map(|[near, far]| {
        let area = [low.map(|value| value - far), high.map(|value| value + far)];
        // A segment from the area to the target meets only what meets the rectangle around both.
        let others: Vec<&Solid> = others
            .iter()
            .copied()
            .filter(|solid| meets(solid, area, target))
            .collect();
        let mut places: Vec<(u32, u32, usize)> = Vec::new();
        for cell in map
            .grid
            .cells_within(area[0], area[1])
            .filter(|cell| costs[*cell] != UNREACHED)
        {
            let base = map.grid.center(cell);
            let away = distance_to_rectangle(base, low, high);
            if (*near..=*far).contains(&away) && front.is_none_or(|front| front.sees(base)) {
                let excess = libm::floorf((away - STANDOFF_M).abs() / BUCKET_M) as u32;
                places.push((excess, costs[cell], cell));
            }
        }
        places.sort_unstable();

        // The first with the least hidden; it cannot get better than nothing hidden and
        // all in the image.
        let mut best: Option<((usize, bool), Viewpoint)> = None;
        for (_, cost, cell) in places {
            let base = map.grid.center(cell);
            let camera = Camera::looking_at(eye(base), look_at);
            let unseen =
                |point: &&[f32; 3]| !is_clear(own.iter().copied(), camera.position, **point);
            let hidden = samples.iter().chain([&center]).filter(unseen).count();
            let rank = (hidden, !in_image(&camera, &surface));
            if best.as_ref().is_none_or(|(least, _)| rank < *least)
                && is_clear(others.iter().copied(), camera.position, target)
            {
                best = Some((
                    rank,
                    Viewpoint {
                        base,
                        camera,
                        path_length_m: metres(cost),
                    },
                ));
                if rank == (0, false) {
                    break;
                }
            }
        }
        best.map(|(_, viewpoint)| viewpoint)
    })
}

/// The place to reach a target from; see [`NavMap::approach`].
pub(super) fn approach(
    map: &NavMap,
    robot: [f32; 2],
    target: [f32; 3],
    furniture: Option<usize>,
) -> Option<Viewpoint> {
    if !target.iter().all(|value| value.is_finite()) {
        return None;
    }
    let costs = costs_from(&map.grid, map.snapped(robot)?);
    let front = furniture.and_then(|index| map.fronts.get(index)?.as_ref());
    let on_floor = [target[0], target[1]];
    // In plain sight within comfortable reach, else past the furniture's own parts from wherever
    // it can be reached.
    let attempts = [(REACHES_M[0], None)]
        .into_iter()
        .chain(REACHES_M.map(|reach| (reach, furniture)));
    attempts.into_iter().find_map(|([near, far], ignoring)| {
        let area = [
            on_floor.map(|value| value - far),
            on_floor.map(|value| value + far),
        ];
        let fixed = map
            .solids
            .iter()
            .filter(|solid| ignoring.is_none_or(|index| !map.is_of_piece(solid.owner, index)));
        let solids = fixed.chain(front.iter().flat_map(|front| &front.panel));
        let solids: Vec<&Solid> = solids.filter(|solid| meets(solid, area, target)).collect();
        let mut places: Vec<(u32, usize)> = Vec::new();
        for cell in map
            .grid
            .cells_within(area[0], area[1])
            .filter(|cell| costs[*cell] != UNREACHED)
        {
            let base = map.grid.center(cell);
            if (near..=far).contains(&distance_2d(base, on_floor))
                && front.is_none_or(|front| front.sees(base))
            {
                places.push((costs[cell], cell));
            }
        }
        places.sort_unstable();
        let seen = |(_, cell): &(u32, usize)| {
            is_clear(solids.iter().copied(), eye(map.grid.center(*cell)), target)
        };
        let (cost, cell) = places.into_iter().find(seen)?;
        let base = map.grid.center(cell);
        Some(Viewpoint {
            base,
            camera: Camera::looking_at(eye(base), target),
            path_length_m: metres(cost),
        })
    })
}

/// Where the camera is while the base stands at a point.
fn eye([x, y]: [f32; 2]) -> [f32; 3] {
    [x, y, CAMERA_HEIGHT_M]
}

/// The centre of a surface and the points halfway to its corners, a little above it.
fn surface_points(surface: &Surface) -> [[f32; 3]; 5] {
    let at = |x: f32, y: f32| {
        let along = |axis: usize, part: f32| {
            surface.min[axis] + (surface.max[axis] - surface.min[axis]) * part
        };
        [along(0, x), along(1, y), surface.z + OVER_SURFACE_M]
    };
    [
        at(0.5, 0.5),
        at(0.25, 0.25),
        at(0.75, 0.25),
        at(0.25, 0.75),
        at(0.75, 0.75),
    ]
}

/// Whether a whole surface projects into the image.
fn in_image(camera: &Camera, surface: &Surface) -> bool {
    let axes = camera.axes();
    let [[left, back], [right, front]] = [surface.min, surface.max];
    [[left, back], [right, back], [left, front], [right, front]]
        .iter()
        .all(|[x, y]| {
            let way = sub([*x, *y, surface.z], camera.position);
            let [x, y, depth] = axes.map(|axis| dot(axis, way));
            depth > 0.05
                && x.abs() * FOCAL_PX <= 320.0 * depth
                && y.abs() * FOCAL_PX <= 240.0 * depth
        })
}

/// Whether a solid's bounding box meets the rectangle around an area and a point.
fn meets(solid: &Solid, area: [[f32; 2]; 2], point: [f32; 3]) -> bool {
    let [low, high] = solid.bounds;
    (0..2).all(|axis| {
        high[axis] >= area[0][axis].min(point[axis]) && low[axis] <= area[1][axis].max(point[axis])
    })
}

fn distance_to_rectangle(point: [f32; 2], low: [f32; 2], high: [f32; 2]) -> f32 {
    let beyond: [f32; 2] = std::array::from_fn(|axis| {
        (low[axis] - point[axis])
            .max(point[axis] - high[axis])
            .max(0.0)
    });
    distance_2d(beyond, [0.0; 2])
}
