//! The occupancy grid: which cells of the floor are taken, where the base can stand, and
//! which cells are connected.
//!
//! Never searches paths (see `path`) and never looks at heights beyond what the base and
//! the camera can hit.

use std::ops::RangeInclusive;

use super::{CAMERA_HEIGHT_M, CELL_M, ROBOT_RADIUS_M, footprint::Footprint};
use crate::{geometry::Part, model::SceneModel};

/// Parts that end at or below this height are floor, in metres.
const FLOOR_M: f32 = 0.02;
/// Parts that start at or above this height are above the robot: a hand's breadth over
/// the camera, in metres.
const ROBOT_TOP_M: f32 = CAMERA_HEIGHT_M + 0.1;
/// Between these heights something stands in the robot's way.
pub(super) const ROBOT_HEIGHTS_M: [f32; 2] = [FLOOR_M, ROBOT_TOP_M];
/// A gap between floor slabs up to twice this wide is floor too, in metres.
const SEAM_M: f32 = 0.01;
/// Cells around the rooms; always taken, so that neighbours of a free cell always exist.
const MARGIN: i32 = 5;
/// Most cells along an edge of the grid (100 m): a bound on memory for odd scenes.
const SIDE_MAX: usize = 2000;

/// Row-major cells; cell (0, 0) starts at `origin` cells from the origin of the scene.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Grid {
    origin: [i32; 2],
    pub(super) width: usize,
    height: usize,
    /// Overlapped by something solid, or not floor.
    occupied: Vec<bool>,
    /// Too close to an occupied cell for the base.
    blocked: Vec<bool>,
    /// Which connected region a free cell belongs to.
    region: Vec<u32>,
    /// Number of cells of each connected region, indexed by the labels in `region`.
    region_cells: Vec<u32>,
}

impl Grid {
    /// Paints the solid parts of a scene.
    pub(super) fn new(model: &SceneModel) -> Self {
        let mut grid = Self::painted(model, ROBOT_HEIGHTS_M, None);
        if grid.width > 0 {
            grid.blocked = inflated(&grid.occupied, grid.width);
        }
        grid.connect();
        grid
    }

    /// Paints the solid parts of a scene between two heights, but for those of one piece of
    /// furniture. Nothing is inflated or connected: such a grid only knows what is occupied.
    pub(super) fn painted(
        model: &SceneModel,
        [from, to]: [f32; 2],
        leaving_out: Option<usize>,
    ) -> Self {
        let [low, high] = model.bounds;
        let fits = |value: f32| value.abs() < 1e4;
        if !(low.iter().chain(&high).copied().all(fits) && low[0] < high[0] && low[1] < high[1]) {
            return Self::unconnected([0, 0], 0, Vec::new());
        }
        let origin = low.map(|value| cell_along(value) as i32 - MARGIN);
        let side = |axis: usize| {
            ((cell_along(high[axis]) as i32 + MARGIN - origin[axis]) as usize + 1).min(SIDE_MAX)
        };
        let (width, height) = (side(0), side(1));
        let mut grid = Self::unconnected(origin, width, vec![false; width * height]);

        let solid = |part: &&Part| part.solid;
        let shell: Vec<Footprint> = model
            .shell
            .iter()
            .filter(solid)
            .filter_map(Footprint::of)
            .collect();
        let furniture = model.furniture.iter().enumerate();
        let piece = |index: usize| model.furniture[index].part_of.unwrap_or(index);
        let left_out = leaving_out.map(piece);
        let furniture = furniture
            .filter(|(index, furniture)| furniture.present && left_out != Some(piece(*index)));
        let furniture: Vec<Footprint> = furniture
            .flat_map(|(_, furniture)| {
                furniture
                    .parts
                    .iter()
                    .filter(solid)
                    .filter_map(Footprint::of)
            })
            .collect();

        let (floor, walls): (Vec<&Footprint>, Vec<&Footprint>) =
            shell.iter().partition(|footprint| footprint.top <= FLOOR_M);
        if !floor.is_empty() {
            grid.occupied.fill(true);
        }
        for slab in floor {
            let [low, high] = slab.bounds;
            for cell in grid.cells_within(
                low.map(|value| value - SEAM_M),
                high.map(|value| value + SEAM_M),
            ) {
                if slab.contains(grid.center(cell), SEAM_M) {
                    grid.occupied[cell] = false;
                }
            }
        }
        for obstacle in walls.into_iter().chain(&furniture) {
            if obstacle.top > from && obstacle.bottom < to {
                for cell in grid.cells_within(obstacle.bounds[0], obstacle.bounds[1]) {
                    if obstacle.overlaps_square(grid.center(cell), CELL_M * 0.5) {
                        grid.occupied[cell] = true;
                    }
                }
            }
        }
        for cell in 0..grid.occupied.len() {
            let [column, row] = grid.place(cell);
            let inside = (MARGIN as usize..width - MARGIN as usize).contains(&column)
                && (MARGIN as usize..height - MARGIN as usize).contains(&row);
            grid.occupied[cell] |= !inside;
        }
        grid
    }

    /// A grid whose occupied cells are given row by row, without inflation. The
    /// border must be occupied.
    #[cfg(test)]
    pub(super) fn from_occupied(origin: [i32; 2], width: usize, occupied: Vec<bool>) -> Self {
        let mut grid = Self::unconnected(origin, width, occupied);
        grid.blocked.clone_from(&grid.occupied);
        grid.connect();
        grid
    }

    /// How many cells there are.
    pub(super) fn len(&self) -> usize {
        self.occupied.len()
    }

    /// The cell a point lies in.
    pub(super) fn cell(&self, point: [f32; 2]) -> Option<usize> {
        if !point.iter().all(|value| value.is_finite()) {
            return None;
        }
        let column = cell_along(point[0]) - i64::from(self.origin[0]);
        let row = cell_along(point[1]) - i64::from(self.origin[1]);
        let inside =
            (0..self.width as i64).contains(&column) && (0..self.height as i64).contains(&row);
        inside.then(|| row as usize * self.width + column as usize)
    }

    /// The centre of a cell.
    pub(super) fn center(&self, cell: usize) -> [f32; 2] {
        let [column, row] = self.place(cell);
        [
            center_along(self.origin[0] + column as i32),
            center_along(self.origin[1] + row as i32),
        ]
    }

    /// Column and row of a cell.
    pub(super) fn place(&self, cell: usize) -> [usize; 2] {
        [cell % self.width, cell / self.width]
    }

    /// Whether something overlaps a cell.
    pub(super) fn is_occupied(&self, cell: usize) -> bool {
        self.occupied[cell]
    }

    /// Whether the base can stand in the centre of a cell.
    pub(super) fn is_free(&self, cell: usize) -> bool {
        !self.blocked[cell]
    }

    /// Whether a path joins two free cells.
    pub(super) fn connected(&self, from: usize, to: usize) -> bool {
        self.is_free(from) && self.is_free(to) && self.region[from] == self.region[to]
    }

    /// How many cells can be reached from a free cell.
    pub(super) fn reachable_cells(&self, cell: usize) -> u32 {
        if self.is_free(cell) {
            self.region_cells[self.region[cell] as usize]
        } else {
            0
        }
    }

    /// The cells that overlap a rectangle, row by row.
    pub(super) fn cells_within(
        &self,
        low: [f32; 2],
        high: [f32; 2],
    ) -> impl Iterator<Item = usize> + use<> {
        let columns = clipped(low[0], high[0], self.origin[0], self.width);
        let rows = clipped(low[1], high[1], self.origin[1], self.height);
        let width = self.width;
        rows.flat_map(move |row| columns.clone().map(move |column| row * width + column))
    }

    /// The free cell a point lies in, else the nearest one (the first of equals) within a distance.
    pub(super) fn nearest_free(&self, point: [f32; 2], within_m: f32) -> Option<usize> {
        if let Some(cell) = self.cell(point)
            && self.is_free(cell)
        {
            return Some(cell);
        }
        if !point.iter().all(|value| value.is_finite()) {
            return None;
        }
        let low = point.map(|value| value - within_m);
        let high = point.map(|value| value + within_m);
        let mut best: Option<(f32, usize)> = None;
        for cell in self
            .cells_within(low, high)
            .filter(|cell| self.is_free(*cell))
        {
            let [x, y] = self.center(cell);
            let square = (x - point[0]) * (x - point[0]) + (y - point[1]) * (y - point[1]);
            if square <= within_m * within_m && best.is_none_or(|(least, _)| square < least) {
                best = Some((square, cell));
            }
        }
        best.map(|(_, cell)| cell)
    }

    /// Whether no cell that a disc overlaps is occupied.
    pub(super) fn disc_is_clear(&self, center: [f32; 2], radius: f32) -> bool {
        let low = center.map(|value| value - radius);
        let high = center.map(|value| value + radius);
        // Both corners inside the grid: the disc is; what lies outside is occupied.
        if self.cell(low).is_none()
            || self.cell(high).is_none()
            || self.cell(center).is_none_or(|cell| self.occupied[cell])
        {
            return false;
        }
        !self.cells_within(low, high).any(|cell| {
            let [x, y] = self.center(cell);
            let dx = ((x - center[0]).abs() - CELL_M * 0.5).max(0.0);
            let dy = ((y - center[1]).abs() - CELL_M * 0.5).max(0.0);
            self.occupied[cell] && dx * dx + dy * dy < radius * radius
        })
    }

    fn unconnected(origin: [i32; 2], width: usize, occupied: Vec<bool>) -> Self {
        let height = occupied.len().checked_div(width).unwrap_or(0);
        Self {
            origin,
            width,
            height,
            occupied,
            blocked: Vec::new(),
            region: Vec::new(),
            region_cells: Vec::new(),
        }
    }

    /// Labels connected regions. A diagonal step needs both cells beside it,
    /// so straight steps decide.
    fn connect(&mut self) {
        const NONE: u32 = u32::MAX;
        self.region = vec![NONE; self.occupied.len()];
        for start in 0..self.occupied.len() {
            if self.blocked[start] || self.region[start] != NONE {
                continue;
            }
            let label = self.region_cells.len() as u32;
            let mut cells = 0;
            let mut open = vec![start];
            self.region[start] = label;
            while let Some(cell) = open.pop() {
                cells += 1;
                for next in [cell - 1, cell + 1, cell - self.width, cell + self.width] {
                    if !self.blocked[next] && self.region[next] == NONE {
                        self.region[next] = label;
                        open.push(next);
                    }
                }
            }
            self.region_cells.push(cells);
        }
    }
}

/// Which cell a coordinate lies in, counted from the origin of the scene; of 32 bits,
/// so that differences fit.
fn cell_along(value: f32) -> i64 {
    i64::from(libm::floorf(value / CELL_M) as i32)
}

fn center_along(cell: i32) -> f32 {
    (cell as f32 + 0.5) * CELL_M
}

/// The cells of one axis between two coordinates.
#[expect(
    clippy::reversed_empty_ranges,
    reason = "an empty range is meant where nothing overlaps"
)]
fn clipped(low: f32, high: f32, origin: i32, side: usize) -> RangeInclusive<usize> {
    let first = (cell_along(low) - i64::from(origin)).max(0);
    let last = (cell_along(high) - i64::from(origin)).min(side as i64 - 1);
    if first > last {
        1..=0
    } else {
        first as usize..=last as usize
    }
}

/// Cells whose centre is closer than the robot's radius to the square of an occupied cell.
fn inflated(occupied: &[bool], width: usize) -> Vec<bool> {
    let radius = ROBOT_RADIUS_M / CELL_M;
    let reach = libm::ceilf(radius + 0.5) as usize;
    // Per row offset, the largest column offset that is still too close.
    let beyond = |offset: usize| (offset as f32 - 0.5).max(0.0);
    let too_close =
        |dx: usize, dy: usize| beyond(dx) * beyond(dx) + beyond(dy) * beyond(dy) < radius * radius;
    let spans: Vec<Option<u8>> = (0..=reach)
        .map(|dy| {
            (0..=reach)
                .rev()
                .find(|dx| too_close(*dx, dy))
                .map(|dx| dx as u8)
        })
        .collect();

    // Distance in columns to the nearest occupied cell of the same row.
    let none = (reach + 1) as u8;
    let mut gap = vec![none; occupied.len()];
    for (gap, occupied) in gap
        .chunks_exact_mut(width)
        .zip(occupied.chunks_exact(width))
    {
        let mut last = none;
        for (gap, occupied) in gap.iter_mut().zip(occupied) {
            last = if *occupied { 0 } else { (last + 1).min(none) };
            *gap = last;
        }
        for gap in gap.iter_mut().rev() {
            last = (last + 1).min(*gap);
            *gap = last;
        }
    }
    let mut blocked = occupied.to_vec();
    for (dy, span) in spans.iter().enumerate() {
        let Some(span) = span else { continue };
        let shift = (dy * width).min(occupied.len());
        for (blocked, gap) in blocked[shift..].iter_mut().zip(&gap) {
            *blocked |= gap <= span;
        }
        for (blocked, gap) in blocked.iter_mut().zip(&gap[shift..]) {
            *blocked |= gap <= span;
        }
    }
    blocked
}
