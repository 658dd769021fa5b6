//! Where the robot can stand and go: a 5 cm occupancy grid, shortest paths, viewpoints with a line of sight.

use crate::{geometry::Camera, model::SceneModel};

/// Edge of a grid cell, in metres.
pub const CELL_M: f32 = 0.05;
/// Radius of the robot's base, in metres.
pub const ROBOT_RADIUS_M: f32 = 0.2;
/// Height of the head camera, in metres.
pub const CAMERA_HEIGHT_M: f32 = 1.4;
/// Least distance between the robot's centre and the bounding box of the receptacle it goes to (SPEC section 2).
pub const STANDOFF_M: f32 = 0.6;
/// How far the arm reaches horizontally from the robot's centre.
pub const REACH_M: f32 = 1.0;

/// The navigation map of a scene.
#[derive(Clone, PartialEq, Debug)]
pub struct NavMap {}

/// A place to stand and look from.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Viewpoint {
    /// Base: x, y.
    pub base: [f32; 2],
    /// The head camera there.
    pub camera: Camera,
    /// Length of the shortest path to it, in metres.
    pub path_length_m: f32,
}

impl NavMap {
    /// Builds the map from the solid parts below the robot's height; doors are left out.
    pub fn new(model: &SceneModel) -> Self {
        let _ = model;
        unimplemented!("by the nav helper")
    }

    /// Length of the shortest collision-free path of the base, in metres.
    pub fn path_length(&self, from: [f32; 2], to: [f32; 2]) -> Option<f32> {
        let _ = (from, to);
        unimplemented!("by the nav helper")
    }

    /// The shortest path as points, both ends included.
    pub fn path(&self, from: [f32; 2], to: [f32; 2]) -> Option<Vec<[f32; 2]>> {
        let _ = (from, to);
        unimplemented!("by the nav helper")
    }

    /// Whether nothing fixed stands between two points; parts of the furniture `ignoring` do not count.
    pub fn line_of_sight(&self, from: [f32; 3], to: [f32; 3], ignoring: Option<usize>) -> bool {
        let _ = (from, to, ignoring);
        unimplemented!("by the nav helper")
    }

    /// The viewpoint for furniture `index`: nearest to the standoff, then to the robot, free, connected to the
    /// robot's base, with a line of sight to the surface (or the front of the door).
    pub fn viewpoint(&self, model: &SceneModel, robot: [f32; 2], index: usize) -> Option<Viewpoint> {
        let _ = (model, robot, index);
        unimplemented!("by the nav helper")
    }

    /// The pose closest to the robot's base from which `target` is within reach and in sight; `furniture` is what it
    /// stands on.
    pub fn approach(&self, robot: [f32; 2], target: [f32; 3], furniture: Option<usize>) -> Option<Viewpoint> {
        let _ = (robot, target, furniture);
        unimplemented!("by the nav helper")
    }

    /// A free cell to start in: the one given if it is free, else the nearest free one.
    pub fn free_near(&self, point: [f32; 2]) -> Option<[f32; 2]> {
        let _ = point;
        unimplemented!("by the nav helper")
    }
}
