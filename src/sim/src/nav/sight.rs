//! Lines of sight: a segment against the solid parts of a scene.
//!
//! Boxes, cylinders and balls are exact; capsules and cones count as the cylinder around them.
//! Objects are not part of it, and doors only as they stand when open.

use crate::{
    geometry::{Part, Pose, Shape, dot, sub},
    model::{Furniture, SceneModel},
};

/// A solid part that can hide things.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Solid {
    /// The furniture it belongs to; `None` for the shell.
    pub(super) owner: Option<usize>,
    /// Bounding box: lower and upper corner.
    pub(super) bounds: [[f32; 3]; 2],
    center: [f32; 3],
    /// Its axes in the scene frame.
    axes: [[f32; 3]; 3],
    shape: Shape,
}

impl Solid {
    /// Whether a segment passes through it; touching its surface is not passing.
    pub(super) fn hides(&self, from: [f32; 3], to: [f32; 3]) -> bool {
        let [low, high] = self.bounds;
        for axis in 0..3 {
            let (a, b) = (from[axis], to[axis]);
            if a.max(b) <= low[axis] || a.min(b) >= high[axis] {
                return false;
            }
        }
        let origin = sub(from, self.center);
        let way = sub(to, from);
        let origin = self.axes.map(|axis| dot(axis, origin));
        let way = self.axes.map(|axis| dot(axis, way));
        let inside = match self.shape {
            Shape::Cuboid { half } => (0..3).try_fold([0.0, 1.0], |span, axis| {
                slab(span, origin[axis], way[axis], half[axis])
            }),
            Shape::Ball { radius } => round([0.0, 1.0], &origin, &way, radius),
            Shape::Cylinder {
                radius,
                half_height,
            }
            | Shape::Cone {
                radius,
                half_height,
            } => slab([0.0, 1.0], origin[2], way[2], half_height)
                .and_then(|span| round(span, &origin[..2], &way[..2], radius)),
            Shape::Capsule {
                radius,
                half_height,
            } => slab([0.0, 1.0], origin[2], way[2], half_height + radius)
                .and_then(|span| round(span, &origin[..2], &way[..2], radius)),
        };
        inside.is_some()
    }
}

/// The solid parts of a scene: the shell's, then the furniture's.
pub(super) fn solids(model: &SceneModel) -> Vec<Solid> {
    let shell = model.shell.iter().map(|part| (None, part));
    let present = model
        .furniture
        .iter()
        .enumerate()
        .filter(|(_, furniture)| furniture.present);
    let furniture = present
        .flat_map(|(index, furniture)| furniture.parts.iter().map(move |part| (Some(index), part)));
    shell
        .chain(furniture)
        .filter(|(_, part)| part.solid)
        .filter_map(|(owner, part)| solid(owner, part))
        .collect()
}

/// The door of a piece of furniture, or the drawer that it is, as it stands when open.
pub(super) fn open_panel(owner: usize, furniture: &Furniture) -> Vec<Solid> {
    let Some(door) = &furniture.door else {
        return Vec::new();
    };
    door.parts_at(1.0)
        .filter(|part| part.solid)
        .filter_map(|part| solid(Some(owner), &part))
        .collect()
}

/// Whether none of the solids hides one point from the other. Points that are
/// not finite see nothing.
pub(super) fn is_clear<'a>(
    mut solids: impl Iterator<Item = &'a Solid>,
    from: [f32; 3],
    to: [f32; 3],
) -> bool {
    from.iter().chain(&to).all(|value| value.is_finite())
        && !solids.any(|solid| solid.hides(from, to))
}

fn solid(owner: Option<usize>, part: &Part) -> Option<Solid> {
    let corners = part.box_corners();
    if !corners.as_flattened().iter().all(|value| value.is_finite()) {
        return None;
    }
    let bounds = corners
        .iter()
        .fold([[f32::MAX; 3], [f32::MIN; 3]], |[low, high], corner| {
            [
                std::array::from_fn(|axis| low[axis].min(corner[axis])),
                std::array::from_fn(|axis| high[axis].max(corner[axis])),
            ]
        });
    let Pose { position, .. } = part.pose;
    let axes =
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| part.pose.rotate(axis));
    Some(Solid {
        owner,
        bounds,
        center: position,
        axes,
        shape: part.shape,
    })
}

/// Cuts the span of a ray, as fractions of its way, to where one coordinate lies
/// within `half` of 0.
fn slab([start, end]: [f32; 2], origin: f32, way: f32, half: f32) -> Option<[f32; 2]> {
    if way == 0.0 {
        return (origin.abs() < half).then_some([start, end]);
    }
    let (a, b) = ((-half - origin) / way, (half - origin) / way);
    not_empty([start.max(a.min(b)), end.min(a.max(b))])
}

/// Cuts the span of a ray to where it lies within `radius` of the origin.
fn round([start, end]: [f32; 2], origin: &[f32], way: &[f32], radius: f32) -> Option<[f32; 2]> {
    let product = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
    let (a, b, c) = (
        product(way, way),
        product(origin, way),
        product(origin, origin) - radius * radius,
    );
    if a == 0.0 {
        return (c < 0.0).then_some([start, end]);
    }
    let discriminant = b * b - a * c;
    if discriminant <= 0.0 {
        return None;
    }
    let root = libm::sqrtf(discriminant);
    not_empty([start.max((-b - root) / a), end.min((-b + root) / a)])
}

fn not_empty([start, end]: [f32; 2]) -> Option<[f32; 2]> {
    (start < end).then_some([start, end])
}
