//! Affine maps of space, and how they move points and solids. Angles are radians; quaternions are
//! x, y, z, w.

use reel_world::{Solid, SolidShape};

/// A point, a direction or a length along each axis.
pub type Vector = [f64; 3];

/// Turns and scales, then moves.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Affine {
    /// The images of the unit vectors.
    pub axes: [Vector; 3],
    /// The image of the origin.
    pub origin: Vector,
}

impl Affine {
    /// The map that leaves everything where it is.
    pub const IDENTITY: Self = Self {
        axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        origin: [0.0; 3],
    };

    /// A translation by a vector.
    pub fn translation(origin: Vector) -> Self {
        Self {
            origin,
            ..Self::IDENTITY
        }
    }

    /// A scale along each axis.
    pub fn scaled(factors: Vector) -> Self {
        let mut map = Self::IDENTITY;
        for (axis, factor) in factors.into_iter().enumerate() {
            map.axes[axis][axis] = factor;
        }
        map
    }

    /// A turn around one of the axes: 0 is x.
    pub fn turned(axis: usize, angle: f64) -> Self {
        let mut direction = [0.0; 3];
        direction[axis] = 1.0;
        Self::around(direction, angle)
    }

    /// A turn around a direction, by the right hand.
    pub fn around(direction: Vector, angle: f64) -> Self {
        let Some(unit) = unit(direction) else {
            return Self::IDENTITY;
        };
        let (sin, cos) = (libm::sin(angle * 0.5), libm::cos(angle * 0.5));
        Self::of_quaternion([unit[0] * sin, unit[1] * sin, unit[2] * sin, cos])
    }

    /// A turn by a quaternion of any length but 0; by 0 there is none.
    pub fn of_quaternion(quaternion: [f64; 4]) -> Self {
        let length = libm::sqrt(quaternion.iter().map(|part| part * part).sum());
        if length == 0.0 || !length.is_finite() {
            return Self::IDENTITY;
        }
        let [x, y, z, w] = quaternion.map(|part| part / length);
        Self {
            axes: [
                [
                    1.0 - 2.0 * (y * y + z * z),
                    2.0 * (x * y + z * w),
                    2.0 * (x * z - y * w),
                ],
                [
                    2.0 * (x * y - z * w),
                    1.0 - 2.0 * (x * x + z * z),
                    2.0 * (y * z + x * w),
                ],
                [
                    2.0 * (x * z + y * w),
                    2.0 * (y * z - x * w),
                    1.0 - 2.0 * (x * x + y * y),
                ],
            ],
            origin: [0.0; 3],
        }
    }

    /// First `inner`, then this one.
    pub fn after(&self, inner: &Self) -> Self {
        Self {
            axes: inner.axes.map(|axis| self.direction(axis)),
            origin: self.point(inner.origin),
        }
    }

    /// A point: turned, scaled and moved.
    pub fn point(&self, point: Vector) -> Vector {
        let turned = self.direction(point);
        std::array::from_fn(|axis| turned[axis] + self.origin[axis])
    }

    /// A direction: turned and scaled, not moved.
    pub fn direction(&self, [x, y, z]: Vector) -> Vector {
        let [a, b, c] = self.axes;
        std::array::from_fn(|axis| a[axis] * x + b[axis] * y + c[axis] * z)
    }

    /// A primitive of the local frame, in the outer one. Scale that a shape cannot have (a sphere
    /// made longer on one side) is that of its longest side.
    pub fn primitive(&self, local: &Solid) -> Solid {
        let own = Self {
            origin: local.position,
            ..Self::of_quaternion(local.rotation)
        };
        let map = self.after(&own);
        let [x, y, z] = map.axes.map(length);
        let shape = match local.shape {
            SolidShape::Box { half: [a, b, c] } => SolidShape::Box {
                half: [a * x, b * y, c * z],
            },
            SolidShape::Cylinder {
                radius,
                half_height,
            } => SolidShape::Cylinder {
                radius: radius * x.max(y),
                half_height: half_height * z,
            },
            SolidShape::Sphere { radius } => SolidShape::Sphere {
                radius: radius * x.max(y).max(z),
            },
        };
        Solid {
            shape,
            position: map.origin,
            rotation: map.quaternion(),
            color: local.color,
        }
    }

    /// How it turns, as a unit quaternion. A mirrored map gives the turn of its mirror image: no
    /// primitive has handedness.
    pub fn quaternion(&self) -> [f64; 4] {
        let [Some(x), Some(y), Some(_)] = self.axes.map(unit) else {
            return [0.0, 0.0, 0.0, 1.0];
        };
        let Some(z) = unit(cross(x, y)) else {
            return [0.0, 0.0, 0.0, 1.0];
        };
        let y = cross(z, x);
        let quaternion = quaternion_of([x, y, z]);
        let length = libm::sqrt(quaternion.iter().map(|part| part * part).sum());
        quaternion.map(|part| part / length)
    }
}

/// The quaternion of three orthonormal axes, from the largest of its parts.
fn quaternion_of([x, y, z]: [Vector; 3]) -> [f64; 4] {
    let trace = x[0] + y[1] + z[2];
    if trace > 0.0 {
        let s = libm::sqrt(trace + 1.0) * 2.0;
        [
            (y[2] - z[1]) / s,
            (z[0] - x[2]) / s,
            (x[1] - y[0]) / s,
            s / 4.0,
        ]
    } else if x[0] > y[1] && x[0] > z[2] {
        let s = libm::sqrt(1.0 + x[0] - y[1] - z[2]) * 2.0;
        [
            s / 4.0,
            (y[0] + x[1]) / s,
            (z[0] + x[2]) / s,
            (y[2] - z[1]) / s,
        ]
    } else if y[1] > z[2] {
        let s = libm::sqrt(1.0 + y[1] - x[0] - z[2]) * 2.0;
        [
            (y[0] + x[1]) / s,
            s / 4.0,
            (z[1] + y[2]) / s,
            (z[0] - x[2]) / s,
        ]
    } else {
        let s = libm::sqrt(1.0 + z[2] - x[0] - y[1]) * 2.0;
        [
            (z[0] + x[2]) / s,
            (z[1] + y[2]) / s,
            s / 4.0,
            (x[1] - y[0]) / s,
        ]
    }
}

/// The length of a vector.
pub fn length(vector: Vector) -> f64 {
    libm::sqrt(dot(vector, vector))
}

/// Of length 1, or `None` where there is no direction.
pub fn unit(vector: Vector) -> Option<Vector> {
    let length = length(vector);
    (length > 1e-12 && length.is_finite()).then(|| vector.map(|part| part / length))
}

/// The inner product of two vectors.
pub fn dot(a: Vector, b: Vector) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The vector product of two vectors.
pub fn cross(a: Vector, b: Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quaternions_and_axes_agree() {
        for axis in 0..3 {
            for step in -7..=7 {
                let map = Affine::turned(axis, f64::from(step) * 0.41);
                let again = Affine::of_quaternion(map.quaternion());
                for (a, b) in map.axes.iter().flatten().zip(again.axes.iter().flatten()) {
                    assert!((a - b).abs() < 1e-12, "{axis} {step}");
                }
            }
        }
    }
}
