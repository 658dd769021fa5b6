//! A mesh as the model of an object: fitted into the object's box, with the hull
//! that it collides by.

use std::sync::Arc;

use reel_world::Mesh;

use super::hull::{Hull, hull};
use crate::geometry::add;

/// What is thinner than this collides as if it were so thick, in metres.
const LEAST_M: f32 = 0.001;

/// A mesh in the frame of an object.
#[derive(Clone, PartialEq, Debug)]
pub struct MeshModel {
    /// What it was made from.
    pub mesh: Arc<Mesh>,
    /// Its vertices in the object's frame, in metres.
    pub positions: Vec<[f32; 3]>,
    /// Convex hull by which the object collides in physics.
    pub hull: Hull,
    /// Of the sphere around the object's frame that holds it, in metres.
    pub bound: f32,
}

impl MeshModel {
    /// Scales a mesh, all sides alike, so that it just fits into a box of these half extents, and
    /// stands it on the middle of the box's bottom.
    pub(super) fn fit(mesh: &Arc<Mesh>, half: [f32; 3]) -> Self {
        let [low, high] = mesh.bounds();
        let sides = [0, 1, 2].map(|axis| high[axis] - low[axis]);
        let fits = |axis: usize| {
            if sides[axis] > 0.0 {
                half[axis] * 2.0 / sides[axis]
            } else {
                f32::INFINITY
            }
        };
        let scale = fits(0).min(fits(1)).min(fits(2));
        let origin = [(low[0] + high[0]) * 0.5, (low[1] + high[1]) * 0.5, low[2]];
        let place = |point: &[f32; 3]| {
            let [x, y, z] = [0, 1, 2].map(|axis| (point[axis] - origin[axis]) * scale);
            let placed = [x, y, z - half[2]];
            // Rounding, and vertices of no triangle, which may lie anywhere.
            [0, 1, 2].map(|axis| placed[axis].clamp(-half[axis], half[axis]))
        };
        let positions: Vec<[f32; 3]> = mesh.data().positions.iter().map(place).collect();
        let corners = mesh
            .data()
            .triangles
            .iter()
            .flat_map(|triangle| triangle.corners);
        let seen: Vec<[f32; 3]> = corners.map(|corner| positions[corner as usize]).collect();
        let bound = libm::sqrtf(half[0] * half[0] + half[1] * half[1] + half[2] * half[2]);
        Self {
            mesh: mesh.clone(),
            hull: solid(&seen),
            positions,
            bound,
        }
    }
}

/// The hull of points; a thick one where they lie, nearly, in a plane.
fn solid(points: &[[f32; 3]]) -> Hull {
    let low = [0, 1, 2].map(|axis| {
        points
            .iter()
            .map(|point| point[axis])
            .fold(f32::INFINITY, f32::min)
    });
    let high = [0, 1, 2].map(|axis| {
        points
            .iter()
            .map(|point| point[axis])
            .fold(f32::NEG_INFINITY, f32::max)
    });
    let thin = (0..3).any(|axis| high[axis] - low[axis] < LEAST_M);
    if let (false, Some(hull)) = (thin, hull(points)) {
        return hull;
    }
    let sides = [0, 1, 2].map(|axis| (high[axis] - low[axis]).max(LEAST_M));
    let corner = |corner: u8| {
        add(
            low,
            [0, 1, 2].map(|axis| {
                if corner >> axis & 1 == 1 {
                    sides[axis]
                } else {
                    0.0
                }
            }),
        )
    };
    hull(&(0..8).map(corner).collect::<Vec<_>>()).expect("a box has a hull")
}
