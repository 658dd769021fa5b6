//! Where REAL's generator puts objects: on the cells of a grid over a surface, where a robot can
//! get near and far from what stands there already. Of equal cells ours are taken in their order,
//! so that equal arguments give equal places.

use reel_world::Rect;

use super::placement::MARGIN_M;

/// Side of a cell, in metres.
const CELL_M: f64 = 0.05;
/// Radius around a place in which free floor counts, in metres.
pub const REACH_RADIUS_M: f64 = 0.3;
/// Least value of a cell of an occupancy map that is free.
const FREE: u8 = 2;
/// Lengths that differ by less are equal, in metres.
const EPSILON_M: f64 = 1e-9;

/// A map of the floor in square cells, row by row; row 0 has the largest y.
#[derive(Clone, PartialEq, Debug)]
pub struct OccupancyMap {
    /// World position of the corner where row 0 and column 0 begin, in metres.
    pub origin: [f64; 2],
    /// Side of a cell, in metres.
    pub resolution_m: f64,
    /// Cells of a row.
    pub columns: usize,
    /// Row by row; 2 and more is free.
    pub cells: Vec<u8>,
}

impl OccupancyMap {
    /// How many free cells have their centre within [`REACH_RADIUS_M`] of a point.
    pub fn free_cells_near(&self, [x, y]: [f64; 2]) -> usize {
        let centre = |index: usize| {
            let (row, column) = (index / self.columns, index % self.columns);
            let along = |cell: usize| (cell as f64 + 0.5) * self.resolution_m;
            [self.origin[0] + along(column), self.origin[1] - along(row)]
        };
        let near = |index: &usize| {
            let [cell_x, cell_y] = centre(*index);
            (cell_x - x).hypot(cell_y - y) <= REACH_RADIUS_M + EPSILON_M
        };
        (0..self.cells.len())
            .filter(|index| self.cells[*index] >= FREE)
            .filter(near)
            .count()
    }
}

/// A surface and what already stands on it.
#[derive(Debug)]
pub struct GridPlacement {
    surface: Rect,
    /// Where objects stand and their width and depth.
    placed: Vec<([f64; 2], [f64; 2])>,
}

impl GridPlacement {
    /// An empty surface, given by two opposite corners in any order.
    pub fn new(one: [f64; 2], other: [f64; 2]) -> Self {
        let corner = |pick: fn(f64, f64) -> f64| [0, 1].map(|axis| pick(one[axis], other[axis]));
        Self {
            surface: Rect {
                min: corner(f64::min),
                max: corner(f64::max),
            },
            placed: Vec::new(),
        }
    }

    /// The best cells for an object (width, depth), all equally good; empty if it fits nowhere. An
    /// object keeps a margin of 5 cm to the rim and to others. Of the places that fit, those count
    /// that can be reached best (`reach` of a place, more is better), and of these the ones
    /// farthest from the object that is nearest.
    pub fn best(&self, size: [f64; 2], reach: impl Fn([f64; 2]) -> usize) -> Vec<[f64; 2]> {
        let cells = |axis: usize| {
            let (min, max) = (self.surface.min[axis], self.surface.max[axis]);
            let rim = size[axis] / 2.0 + MARGIN_M - EPSILON_M;
            let centres = (0..)
                .map(move |index| min + (f64::from(index) + 0.5) * CELL_M)
                .take_while(move |centre| *centre < max);
            centres.filter(move |centre| centre - min >= rim && max - centre >= rim)
        };
        let spread = |at: &[f64; 2]| {
            let away = self
                .placed
                .iter()
                .map(|(other, _)| (at[0] - other[0]).hypot(at[1] - other[1]));
            away.fold(f64::INFINITY, f64::min)
        };
        let fitting = cells(0)
            .flat_map(|x| cells(1).map(move |y| [x, y]))
            .filter(|at| self.is_free(*at, size));
        let scored: Vec<([f64; 2], (usize, f64))> =
            fitting.map(|at| (at, (reach(at), spread(&at)))).collect();
        let Some(most) = scored.iter().map(|(_, (reach, _))| *reach).max() else {
            return Vec::new();
        };
        let farthest = scored
            .iter()
            .filter(|(_, (reach, _))| *reach == most)
            .map(|(_, (_, spread))| *spread)
            .fold(0.0, f64::max);
        let best = scored
            .into_iter()
            .filter(|(_, (reach, spread))| *reach == most && *spread >= farthest - EPSILON_M);
        best.map(|(at, _)| at).collect()
    }

    /// Puts an object (width, depth) at a place.
    pub fn put(&mut self, at: [f64; 2], size: [f64; 2]) {
        self.placed.push((at, size));
    }

    fn is_free(&self, at: [f64; 2], size: [f64; 2]) -> bool {
        self.placed.iter().all(|(other, other_size)| {
            (0..2).any(|axis| {
                let apart = (size[axis] + other_size[axis]) / 2.0 + MARGIN_M;
                (at[axis] - other[axis]).abs() >= apart - EPSILON_M
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn anywhere(_: [f64; 2]) -> usize {
        0
    }

    #[test]
    fn a_surface_has_cells_within_its_margins_and_fills_up() {
        let mut table = GridPlacement::new([0.4, 0.2], [0.0, 0.0]);
        let near = |cells: Vec<[f64; 2]>, expected: &[[f64; 2]]| {
            assert_eq!(cells.len(), expected.len(), "{cells:?}");
            for (cell, expected) in cells.iter().zip(expected) {
                assert!(
                    (0..2).all(|axis| (cell[axis] - expected[axis]).abs() < 1e-9),
                    "{cells:?}"
                );
            }
        };
        let size = [0.05, 0.05];
        assert_eq!(table.best(size, anywhere).len(), 6 * 2);
        table.put([0.075, 0.075], size);
        near(table.best(size, anywhere), &[[0.325, 0.125]]);
        table.put([0.325, 0.125], size);
        near(
            table.best(size, anywhere),
            &[[0.175, 0.125], [0.225, 0.075]],
        );
        assert!(table.best([0.2, 0.15], anywhere).is_empty());
    }

    #[test]
    fn a_place_near_free_floor_goes_before_a_far_one() {
        let cells = (0..40 * 40)
            .map(|index| if index % 40 >= 25 { 2 } else { 1 })
            .collect();
        let map = OccupancyMap {
            origin: [-1.0, 1.0],
            resolution_m: 0.05,
            columns: 40,
            cells,
        };
        let mut table = GridPlacement::new([-0.5, -0.5], [0.5, 0.5]);
        for _ in 0..2 {
            let best = table.best([0.1, 0.1], |at| map.free_cells_near(at));
            assert!(
                !best.is_empty() && best.iter().all(|[x, _]| (x - 0.375).abs() < 1e-9),
                "{best:?}"
            );
            table.put(best[0], [0.1, 0.1]);
        }
    }
}
