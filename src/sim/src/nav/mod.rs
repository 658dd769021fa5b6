//! Where the robot can stand and go: a 5 cm occupancy grid, shortest paths, viewpoints with
//! a line of sight.
//!
//! Knows what is fixed: the shell and the furniture. Doors and movable objects are never part of
//! it, and nothing here changes the world. Equal arguments give equal answers; points that are not
//! finite or lie outside the flat are answered with "no".

mod footprint;
mod grid;
mod path;
mod sight;
#[cfg(test)]
mod tests;
mod vantage;

use crate::{geometry::Camera, model::SceneModel};

/// Edge of a grid cell, in metres.
pub const CELL_M: f32 = 0.05;
/// Radius of the robot's base, in metres.
pub const ROBOT_RADIUS_M: f32 = 0.2;
/// Height of the head camera, in metres.
pub const CAMERA_HEIGHT_M: f32 = 1.4;
/// Least distance between the robot's centre and the bounding box of the receptacle
/// it goes to (docs/spec.md#tools).
pub const STANDOFF_M: f32 = 0.6;
/// How far the arm reaches horizontally from the robot's centre.
pub const REACH_M: f32 = 1.0;

/// How far a blocked end of a path is moved to the nearest free cell, in metres.
const SNAP_M: f32 = 0.5;

/// The navigation map of a scene.
#[derive(Clone, PartialEq, Debug)]
pub struct NavMap {
    grid: grid::Grid,
    solids: Vec<sight::Solid>,
    /// By furniture: its front, if one looks into it.
    fronts: Vec<Option<vantage::Front>>,
    /// By furniture: what it is a part of.
    wholes: Vec<Option<usize>>,
}

/// A place to stand and look from.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Viewpoint {
    /// Position of the robot's base on the floor: x, y in metres.
    pub base: [f32; 2],
    /// The head camera there.
    pub camera: Camera,
    /// Length of the shortest path to it, in metres.
    pub path_length_m: f32,
}

/// Where anything fixed is between two heights, on the same cells as the map: for putting things on
/// surfaces, and for standing beside furniture.
#[derive(Clone, PartialEq, Debug)]
pub struct Occupancy {
    grid: grid::Grid,
}

impl Occupancy {
    /// What of the scene stands between two heights above the floor, but for the piece of furniture
    /// that `leaving_out` is or is a part of; outside the rooms all is taken.
    pub fn between(model: &SceneModel, heights_m: [f32; 2], leaving_out: Option<usize>) -> Self {
        Self {
            grid: grid::Grid::painted(model, heights_m, leaving_out),
        }
    }

    /// What the robot would meet on the floor, were furniture `leaving_out` not there.
    pub fn on_floor(model: &SceneModel, leaving_out: usize) -> Self {
        Self::between(model, grid::ROBOT_HEIGHTS_M, Some(leaving_out))
    }

    /// Whether no cell that a disc overlaps is occupied.
    pub fn disc_is_free(&self, center: [f32; 2], radius: f32) -> bool {
        self.grid.disc_is_clear(center, radius)
    }
}

impl NavMap {
    /// Builds the map from the solid parts below the robot's height; doors are left out.
    pub fn new(model: &SceneModel) -> Self {
        let fronts = model
            .furniture
            .iter()
            .enumerate()
            .map(|(index, furniture)| vantage::Front::of(index, furniture))
            .collect();
        Self {
            grid: grid::Grid::new(model),
            solids: sight::solids(model),
            fronts,
            wholes: model
                .furniture
                .iter()
                .map(|furniture| furniture.part_of)
                .collect(),
        }
    }

    /// Whether a solid's owner is a piece of furniture, or what that is a part of.
    fn is_of_piece(&self, owner: Option<usize>, furniture: usize) -> bool {
        let whole = self.wholes.get(furniture).copied().flatten();
        owner.is_some() && (owner == Some(furniture) || owner == whole)
    }

    /// Length of the shortest collision-free path of the base, in metres: that of [`NavMap::path`].
    pub fn path_length(&self, from: [f32; 2], to: [f32; 2]) -> Option<f32> {
        let (cost, _) = path::shortest(&self.grid, self.snapped(from)?, self.snapped(to)?)?;
        Some(path::metres(cost))
    }

    /// The shortest path as centres of cells, both ends included. An end that is blocked is moved
    /// to the nearest free cell within half a metre.
    pub fn path(&self, from: [f32; 2], to: [f32; 2]) -> Option<Vec<[f32; 2]>> {
        let (_, cells) = path::shortest(&self.grid, self.snapped(from)?, self.snapped(to)?)?;
        Some(
            cells
                .into_iter()
                .map(|cell| self.grid.center(cell))
                .collect(),
        )
    }

    /// Whether nothing fixed stands between two points; parts of the furniture
    /// `ignoring` do not count.
    pub fn line_of_sight(&self, from: [f32; 3], to: [f32; 3], ignoring: Option<usize>) -> bool {
        let solids = self
            .solids
            .iter()
            .filter(|solid| ignoring.is_none_or(|index| !self.is_of_piece(solid.owner, index)));
        sight::is_clear(solids, from, to)
    }

    /// The viewpoint for furniture `index`: free, connected to the robot's base, at least
    /// [`STANDOFF_M`] from its bounding box (nearer or farther only where there is nothing
    /// else), in front of its door if it has one, and with a line of sight to the surface (or
    /// the door) past everything else.
    ///
    /// Of those the one that sees most of the surface past the furniture's own parts, then with all
    /// of it in the image, then nearest to the standoff, then to the robot. `None` if there is
    /// none or the furniture is not there.
    pub fn viewpoint(
        &self,
        model: &SceneModel,
        robot: [f32; 2],
        index: usize,
    ) -> Option<Viewpoint> {
        vantage::viewpoint(self, model, robot, index)
    }

    /// The pose closest to the robot's base from which `target` is within [`REACH_M`] (at worst 1.3
    /// m) and in sight; `furniture` is what it stands on. Only if there is no such pose may parts
    /// of that furniture hide it.
    pub fn approach(
        &self,
        robot: [f32; 2],
        target: [f32; 3],
        furniture: Option<usize>,
    ) -> Option<Viewpoint> {
        vantage::approach(self, robot, target, furniture)
    }

    /// A place to start in: the one given if the base can stand there, else the centre of
    /// the nearest free cell.
    pub fn free_near(&self, point: [f32; 2]) -> Option<[f32; 2]> {
        if self.standable(point) {
            return Some(point);
        }
        self.grid
            .nearest_free(point, f32::INFINITY)
            .map(|cell| self.grid.center(cell))
    }

    /// Whether something solid overlaps the cell of a point, or it lies outside
    /// the rooms. Not inflated.
    pub fn occupied(&self, point: [f32; 2]) -> bool {
        self.grid
            .cell(point)
            .is_none_or(|cell| self.grid.is_occupied(cell))
    }

    /// Whether the base can stand in the cell of a point.
    pub fn standable(&self, point: [f32; 2]) -> bool {
        self.grid
            .cell(point)
            .is_some_and(|cell| self.grid.is_free(cell))
    }

    /// Whether no cell that a disc overlaps is occupied. Not inflated.
    pub fn cells_free_in_disc(&self, center: [f32; 2], radius: f32) -> bool {
        self.grid.disc_is_clear(center, radius)
    }

    /// Floor on which the base can drive from a point, in square metres; 0 where it cannot stand.
    /// Small values tell pockets between furniture from rooms.
    pub fn reachable_area_m2(&self, point: [f32; 2]) -> f32 {
        self.grid.cell(point).map_or(0.0, |cell| {
            self.grid.reachable_cells(cell) as f32 * (CELL_M * CELL_M)
        })
    }

    /// The free cell of a point that may be slightly blocked.
    fn snapped(&self, point: [f32; 2]) -> Option<usize> {
        self.grid.nearest_free(point, SNAP_M)
    }
}
