//! Boxes around solids, over the affine maps that [`reel_tasks::assets::affine`] owns.

use reel_world::{Solid, SolidShape};

pub(crate) use reel_tasks::assets::affine::{Affine, Vector, cross, dot, length, unit};

/// A box along the axes: lower and upper corner.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct Bounds {
    pub(crate) low: Vector,
    pub(crate) high: Vector,
}

impl Bounds {
    /// The box of a primitive.
    pub(crate) fn of(primitive: &Solid) -> Self {
        let axes = Affine::of_quaternion(primitive.rotation).axes;
        let reach: Vector = match primitive.shape {
            SolidShape::Box { half } => std::array::from_fn(|axis| {
                (0..3)
                    .map(|side| (axes[side][axis] * half[side]).abs())
                    .sum()
            }),
            SolidShape::Cylinder {
                radius,
                half_height,
            } => std::array::from_fn(|axis| {
                let along = axes[2][axis];
                (along * half_height).abs() + radius * libm::sqrt((1.0 - along * along).max(0.0))
            }),
            SolidShape::Sphere { radius } => [radius; 3],
        };
        let at = primitive.position;
        Self {
            low: std::array::from_fn(|axis| at[axis] - reach[axis]),
            high: std::array::from_fn(|axis| at[axis] + reach[axis]),
        }
    }

    /// The box of points, or `None` of none.
    pub(crate) fn of_points(points: impl IntoIterator<Item = Vector>) -> Option<Self> {
        let point = |at| Self { low: at, high: at };
        points.into_iter().map(point).reduce(Self::with)
    }

    /// The box of several, or `None` of none.
    pub(crate) fn of_all<'a>(primitives: impl IntoIterator<Item = &'a Solid>) -> Option<Self> {
        primitives.into_iter().map(Self::of).reduce(Self::with)
    }

    pub(crate) fn with(self, other: Self) -> Self {
        Self {
            low: std::array::from_fn(|axis| self.low[axis].min(other.low[axis])),
            high: std::array::from_fn(|axis| self.high[axis].max(other.high[axis])),
        }
    }

    pub(crate) fn center(&self) -> Vector {
        std::array::from_fn(|axis| (self.low[axis] + self.high[axis]) * 0.5)
    }

    pub(crate) fn half(&self) -> Vector {
        std::array::from_fn(|axis| (self.high[axis] - self.low[axis]) * 0.5)
    }

    /// As a primitive; thinner than a millimetre it is a millimetre thick.
    pub(crate) fn solid(&self, color: [u8; 3]) -> Solid {
        Solid {
            shape: SolidShape::Box {
                half: self.half().map(|half| half.max(0.0005)),
            },
            position: self.center(),
            rotation: [0.0, 0.0, 0.0, 1.0],
            color,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turned_box_is_as_large_as_it_looks() {
        let flat = Solid {
            shape: SolidShape::Box {
                half: [1.0, 0.5, 0.1],
            },
            position: [0.0; 3],
            rotation: [0.0, 0.0, 0.0, 1.0],
            color: [0; 3],
        };
        let map = Affine::translation([2.0, 0.0, 0.0])
            .after(&Affine::turned(2, std::f64::consts::FRAC_PI_2));
        let bounds = Bounds::of(&map.primitive(&flat));
        for (found, wanted) in bounds.low.into_iter().zip([1.5, -1.0, -0.1]) {
            assert!((found - wanted).abs() < 1e-9, "{bounds:?}");
        }
        let map = Affine::scaled([2.0, 1.0, 3.0]);
        let half = Bounds::of(&map.primitive(&flat)).half();
        for (found, wanted) in half.into_iter().zip([2.0, 0.5, 0.3]) {
            assert!((found - wanted).abs() < 1e-9, "{half:?}");
        }
    }
}
