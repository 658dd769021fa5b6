//! Furniture whose scene says what it consists of: imported pieces.

use reel_world::{FurnitureGeometry, FurnitureJoint, Scene, Solid, SolidShape};

use super::{
    Built, ROOM_HEIGHT_M,
    door::{DoorModel, DoorMotion},
    layout::{Spot, rectangle},
    parts::{bounds, extent},
};
use crate::geometry::{Part, Pattern, Pose, Shape};

/// Builds a receptacle as its scene gives it.
pub(super) fn build(scene: &Scene, index: usize, geometry: &FurnitureGeometry) -> Built {
    let receptacle = &scene.receptacles[index];
    let parts: Vec<Part> = geometry.fixed.iter().map(part).collect();
    let moving: Vec<Part> = geometry.moving.iter().map(part).collect();
    let z = receptacle.surface_max[2] as f32;
    let [low, high] = rectangle(receptacle);
    let whole = receptacle.part_of.as_ref().unwrap_or(&receptacle.id);
    let same_piece = scene
        .receptacles
        .iter()
        .filter(|other| other.id == *whole || other.part_of.as_ref() == Some(whole))
        .filter_map(|other| other.geometry.as_ref())
        .flat_map(|geometry| geometry.fixed.iter().chain(&geometry.moving));
    let ceilings = same_piece.map(part).filter_map(|part| {
        let half = extent(&part);
        let over = (0..2).all(|axis| {
            part.pose.position[axis] - half[axis] < (low[axis] + high[axis]) * 0.5
                && part.pose.position[axis] + half[axis] > (low[axis] + high[axis]) * 0.5
        });
        let bottom = part.pose.position[2] - half[2];
        (over && bottom > z + 0.01).then_some(bottom - z)
    });
    let clearance = ceilings.fold((ROOM_HEIGHT_M - z).max(0.1), f32::min);
    let door = geometry.joint.as_ref().map(|joint| door(joint, &moving));
    Built {
        spot: Spot::of(scene, index, [0.0; 2], false),
        surface: [low, high],
        clearance,
        door,
        parts,
    }
}

fn door(joint: &FurnitureJoint, moving: &[Part]) -> DoorModel {
    let [low, high] = bounds(moving.iter());
    let center = [0, 1, 2].map(|axis| (low[axis] + high[axis]) * 0.5);
    let (closed, motion) = match joint {
        FurnitureJoint::Slide { open_by } => {
            let [x, y] = open_by.map(|value| value as f32);
            let closed = Pose::yawed(center, libm::atan2f(y, x));
            (closed, DoorMotion::Slide(libm::sqrtf(x * x + y * y)))
        }
        FurnitureJoint::Hinge {
            position,
            axis,
            open_deg,
        } => {
            let closed = Pose {
                position: position.map(|value| value as f32),
                rotation: z_to(axis.map(|value| value as f32)),
            };
            (closed, DoorMotion::Hinge((*open_deg as f32).to_radians()))
        }
    };
    let inverse = closed.inverse();
    let own = |part: &Part| Part {
        pose: inverse.then(&part.pose),
        ..*part
    };
    DoorModel {
        parts: moving.iter().map(own).collect(),
        closed,
        motion,
        center,
        guided: true,
    }
}

/// The shortest rotation that takes z to a direction.
fn z_to([x, y, z]: [f32; 3]) -> [f32; 4] {
    if z < -0.9999 {
        return [1.0, 0.0, 0.0, 0.0];
    }
    let rotation = [-y, x, 0.0, 1.0 + z];
    let length = libm::sqrtf(rotation.iter().map(|value| value * value).sum());
    rotation.map(|value| value / length)
}

fn part(primitive: &Solid) -> Part {
    let shape = match primitive.shape {
        SolidShape::Box { half } => Shape::Cuboid {
            half: half.map(|value| value as f32),
        },
        SolidShape::Cylinder {
            radius,
            half_height,
        } => Shape::Cylinder {
            radius: radius as f32,
            half_height: half_height as f32,
        },
        SolidShape::Sphere { radius } => Shape::Ball {
            radius: radius as f32,
        },
    };
    let rotation = primitive.rotation.map(|value| value as f32);
    let length = libm::sqrtf(rotation.iter().map(|value| value * value).sum());
    Part {
        shape,
        pose: Pose {
            position: primitive.position.map(|value| value as f32),
            rotation: rotation.map(|value| value / length),
        },
        color: primitive.color,
        accent: primitive.color,
        pattern: Pattern::Plain,
        solid: true,
    }
}
