//! A list of parts being built, and how shapes are put: blocks by their corners,
//! rods along an axis.
//!
//! Furniture is built in its own frame (x to the front, y to its left, z up from the floor) and put
//! into the scene by quarter turns, so that boxes stay axis-aligned and heights stay exact. Never
//! decides what anything looks like.

use std::f32::consts::FRAC_1_SQRT_2;

use super::looks::Paint;
use crate::geometry::{Part, Pose, Shape};

/// A shape with its pose.
pub(super) type PosedShape = (Shape, Pose);

/// An axis of the frame things are built in.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Axis {
    X,
    Y,
    Z,
}

impl Axis {
    /// By number: 0 is x.
    pub(super) fn of(index: usize) -> Self {
        [Axis::X, Axis::Y, Axis::Z][index]
    }

    /// The rotation that takes z to this axis.
    fn rotation(self) -> [f32; 4] {
        match self {
            Axis::X => [0.0, FRAC_1_SQRT_2, 0.0, FRAC_1_SQRT_2],
            Axis::Y => [-FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2],
            Axis::Z => Pose::IDENTITY.rotation,
        }
    }
}

/// A box by its lower and upper corner; a side is at least one millimetre.
pub(super) fn block(low: [f32; 3], high: [f32; 3]) -> PosedShape {
    let half = [0, 1, 2].map(|axis| ((high[axis] - low[axis]) * 0.5).max(0.0005));
    let center = [0, 1, 2].map(|axis| (high[axis] + low[axis]) * 0.5);
    (Shape::Cuboid { half }, Pose::at(center))
}

/// A box by its centre and half extents.
pub(super) fn cuboid(center: [f32; 3], half: [f32; 3]) -> PosedShape {
    (
        Shape::Cuboid {
            half: half.map(|side| side.max(0.0005)),
        },
        Pose::at(center),
    )
}

/// A standing cylinder between two heights.
pub(super) fn pillar([x, y]: [f32; 2], low_z: f32, high_z: f32, radius: f32) -> PosedShape {
    let shape = Shape::Cylinder {
        radius: radius.max(0.0005),
        half_height: ((high_z - low_z) * 0.5).max(0.0005),
    };
    (shape, Pose::at([x, y, (low_z + high_z) * 0.5]))
}

/// A ball around `center`; lengths in metres, the radius at least 0.5 mm.
pub(super) fn ball(center: [f32; 3], radius: f32) -> PosedShape {
    (
        Shape::Ball {
            radius: radius.max(0.0005),
        },
        Pose::at(center),
    )
}

/// A cylinder along an axis.
pub(super) fn rod(axis: Axis, center: [f32; 3], half_length: f32, radius: f32) -> PosedShape {
    let shape = Shape::Cylinder {
        radius: radius.max(0.0005),
        half_height: half_length.max(0.0005),
    };
    (
        shape,
        Pose {
            position: center,
            rotation: axis.rotation(),
        },
    )
}

/// A capsule along an axis; `half_length` includes the round ends.
pub(super) fn capsule(axis: Axis, center: [f32; 3], half_length: f32, radius: f32) -> PosedShape {
    let radius = radius.max(0.0005);
    let shape = Shape::Capsule {
        radius,
        half_height: (half_length - radius).max(0.0005),
    };
    (
        shape,
        Pose {
            position: center,
            rotation: axis.rotation(),
        },
    )
}

/// A cone whose tip points along an axis, or against it.
pub(super) fn cone(
    axis: Axis,
    against: bool,
    center: [f32; 3],
    half_length: f32,
    radius: f32,
) -> PosedShape {
    let shape = Shape::Cone {
        radius: radius.max(0.0005),
        half_height: half_length.max(0.0005),
    };
    let rotation = match (axis, against) {
        (_, false) => axis.rotation(),
        (Axis::X, true) => [0.0, -FRAC_1_SQRT_2, 0.0, FRAC_1_SQRT_2],
        (Axis::Y, true) => [FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2],
        (Axis::Z, true) => [1.0, 0.0, 0.0, 0.0],
    };
    (
        shape,
        Pose {
            position: center,
            rotation,
        },
    )
}

/// Where a frame stands in the outer one: an origin on the floor and quarter turns around z.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Frame {
    /// Origin of this frame on the floor of the outer frame: x, y in metres.
    pub(super) origin: [f32; 2],
    /// Quarter turns, counter-clockwise: 0 leaves x along x.
    pub(super) quarters: usize,
}

impl Frame {
    /// The outer frame itself.
    pub(super) const OUTER: Frame = Frame {
        origin: [0.0; 2],
        quarters: 0,
    };

    /// Takes a vector to the outer frame.
    pub(super) fn turn(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        [[x, y], [-y, x], [-x, -y], [y, -x]][self.quarters % 4]
    }

    /// Takes a point to the outer frame.
    pub(super) fn point(&self, [x, y, z]: [f32; 3]) -> [f32; 3] {
        let [x, y] = self.turn([x, y]);
        [self.origin[0] + x, self.origin[1] + y, z]
    }

    /// Takes a pose to the outer frame.
    pub(super) fn pose(&self, pose: &Pose) -> Pose {
        let s = FRAC_1_SQRT_2;
        let rotation = [
            [0.0, 0.0, 0.0, 1.0],
            [0.0, 0.0, s, s],
            [0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, -s, s],
        ][self.quarters % 4];
        let turned = Pose {
            position: [0.0; 3],
            rotation,
        }
        .then(&Pose {
            position: [0.0; 3],
            ..*pose
        });
        Pose {
            position: self.point(pose.position),
            rotation: turned.rotation,
        }
    }
}

/// Parts being built in a frame.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Parts {
    frame: Frame,
    list: Vec<Part>,
}

impl Parts {
    /// Creates an empty list for parts whose poses are given in `frame`.
    pub(super) fn new(frame: Frame) -> Self {
        Self {
            frame,
            list: Vec::new(),
        }
    }

    /// Adds a part that physics knows.
    pub(super) fn solid(&mut self, placed: PosedShape, paint: Paint) {
        self.push(placed, paint, true);
    }

    /// Adds a part that is only seen.
    pub(super) fn look(&mut self, placed: PosedShape, paint: Paint) {
        self.push(placed, paint, false);
    }

    /// What was built, in the outer frame.
    pub(super) fn finish(self) -> Vec<Part> {
        self.list
    }

    fn push(&mut self, (shape, pose): PosedShape, paint: Paint, solid: bool) {
        let upright = pose.rotation == Pose::IDENTITY.rotation;
        let (shape, pose) = match shape {
            Shape::Cuboid { half: [x, y, z] } if upright => {
                let half = if self.frame.quarters.is_multiple_of(2) {
                    [x, y, z]
                } else {
                    [y, x, z]
                };
                (
                    Shape::Cuboid { half },
                    Pose::at(self.frame.point(pose.position)),
                )
            }
            _ if upright => (shape, Pose::at(self.frame.point(pose.position))),
            _ => (shape, self.frame.pose(&pose)),
        };
        let Paint {
            color,
            accent,
            pattern,
        } = paint;
        self.list.push(Part {
            shape,
            pose,
            color,
            accent,
            pattern,
            solid,
        });
    }
}

/// Half extents of the axis-aligned box around a part, in the frame its pose is in.
pub(super) fn extent(part: &Part) -> [f32; 3] {
    let along = part.pose.rotate([0.0, 0.0, 1.0]).map(libm::fabsf);
    let across = along.map(|c| libm::sqrtf((1.0 - c * c).max(0.0)));
    let spread =
        |radius: f32, half: f32| [0, 1, 2].map(|axis| across[axis] * radius + along[axis] * half);
    match part.shape {
        Shape::Ball { radius } => [radius; 3],
        Shape::Cylinder {
            radius,
            half_height,
        }
        | Shape::Cone {
            radius,
            half_height,
        } => spread(radius, half_height),
        Shape::Capsule {
            radius,
            half_height,
        } => along.map(|c| c * half_height + radius),
        Shape::Cuboid { half } => {
            let axes = [0, 1, 2].map(|axis| {
                let mut unit = [0.0; 3];
                unit[axis] = half[axis];
                part.pose.rotate(unit)
            });
            [0, 1, 2].map(|axis| axes.iter().map(|side| libm::fabsf(side[axis])).sum())
        }
    }
}

/// Lower and upper corner of the box around parts; a point at the origin for none.
pub(super) fn bounds<'a>(parts: impl Iterator<Item = &'a Part>) -> [[f32; 3]; 2] {
    let mut corners: Option<[[f32; 3]; 2]> = None;
    for part in parts {
        let (half, center) = (extent(part), part.pose.position);
        let low = [0, 1, 2].map(|axis| center[axis] - half[axis]);
        let high = [0, 1, 2].map(|axis| center[axis] + half[axis]);
        corners = Some(match corners {
            None => [low, high],
            Some([least, most]) => [
                [0, 1, 2].map(|axis| least[axis].min(low[axis])),
                [0, 1, 2].map(|axis| most[axis].max(high[axis])),
            ],
        });
    }
    corners.unwrap_or_default()
}
