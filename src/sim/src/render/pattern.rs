//! Owns the patterns of surfaces: where the second colour shows. Arithmetic on object
//! space only, no images.

use super::block::{Block, LANES, Quantity, each, floor, to_integer};
use crate::geometry::{FOCAL_PX, Shape};

/// How a face is unrolled into flat coordinates.
pub(super) struct Mapping {
    axes: [usize; 2],
    /// Length of a quarter turn in metres; 0 on flat faces.
    quarter: f32,
    period: [f32; 2],
    per_metre: [f32; 2],
}

impl Mapping {
    pub fn new(shape: &Shape, face: u8, flat: bool) -> Self {
        let (extents, radius) = match *shape {
            Shape::Cuboid { half } => (half, 0.0),
            Shape::Cylinder {
                radius,
                half_height,
            }
            | Shape::Cone {
                radius,
                half_height,
            } => ([radius, radius, half_height], radius),
            Shape::Ball { radius } => ([radius; 3], radius),
            Shape::Capsule {
                radius,
                half_height,
            } => ([radius, radius, radius + half_height], radius),
        };
        if flat {
            let normal = if radius > 0.0 {
                2
            } else {
                usize::from(face / 2)
            };
            let (a, b) = ((normal + 1) % 3, (normal + 2) % 3);
            let axes = if extents[a] >= extents[b] {
                [a, b]
            } else {
                [b, a]
            };
            let period = repetition(extents[axes[0]], extents[axes[1]]);
            return Self {
                axes,
                quarter: 0.0,
                period: [period; 2],
                per_metre: [1.0 / period; 2],
            };
        }
        let quarter = radius * core::f32::consts::FRAC_PI_2;
        let period = repetition(extents[2], radius);
        // A whole number of repetitions goes around.
        let count = libm::fmaxf(libm::roundf(4.0 * quarter / period), 3.0);
        let period = [period, 4.0 * quarter / count];
        Self {
            axes: [2, 0],
            quarter,
            period,
            per_metre: period.map(|length| 1.0 / length),
        }
    }

    /// Flat coordinates of the points of a block.
    #[inline(always)]
    pub fn unroll(&self, block: &mut Block, groups: usize) {
        block.along = block.point[self.axes[0]];
        if self.quarter > 0.0 {
            let quarter = self.quarter;
            each(
                groups,
                [&block.point[0], &block.point[1]],
                [&mut block.across],
                #[inline(always)]
                |[x, y]| [turn(x, y) * quarter],
            );
        } else {
            block.across = block.point[self.axes[1]];
        }
    }

    /// How much of the second colour bands along the face show, 0 to 1. Like the others, what is
    /// finer than a pixel fades to its mean.
    #[inline(always)]
    pub fn stripes(&self, block: &mut Block, groups: usize) {
        let (period, per_metre) = (self.period[0], self.per_metre[0]);
        each(
            groups,
            [&block.along, &block.inverse_depth],
            [&mut block.share],
            #[inline(always)]
            |[along, inverse]| {
                let pixels_per_metre = FOCAL_PX * inverse;
                let distance = (0.25 - (fraction(along * per_metre + 0.25) - 0.5).abs()) * period;
                let seen = (distance * pixels_per_metre + 0.5).clamp(0.0, 1.0);
                [fade(seen, 0.5, period * pixels_per_metre)]
            },
        );
    }

    /// How much of the second colour rows of dots show.
    #[inline(always)]
    pub fn dots(&self, block: &mut Block, groups: usize) {
        let ([along_period, across_period], [per_along, per_across]) =
            (self.period, self.per_metre);
        let radius = 0.3 * along_period;
        each(
            groups,
            [&block.along, &block.across, &block.inverse_depth],
            [&mut block.share],
            #[inline(always)]
            |[along, across, inverse]| {
                let pixels_per_metre = FOCAL_PX * inverse;
                let row = along * per_along;
                // half a period in every other row
                let shift = fraction(floor(row) * 0.5);
                let (u, v) = (
                    fraction(row) - 0.5,
                    fraction(across * per_across + shift) - 0.5,
                );
                let (u, v) = (u * along_period, v * across_period);
                let distance = (radius - (u * u + v * v) / radius) * 0.5;
                [fade(
                    (distance * pixels_per_metre + 0.5).clamp(0.0, 1.0),
                    0.28,
                    along_period * pixels_per_metre,
                )]
            },
        );
    }

    /// How much of the second colour the grain of wood shows.
    #[inline(always)]
    pub fn grain(&self, block: &mut Block, groups: usize) {
        let [drift, rings, fibres] = block.noise.each_mut();
        each(
            groups,
            [&block.along],
            [&mut *drift],
            #[inline(always)]
            |[along]| [along * 2.3],
        );
        noise(drift, 117, groups);
        each(
            groups,
            [&block.across, drift],
            [&mut *rings, &mut *fibres],
            #[inline(always)]
            |[across, drift]| [across * 34.0 + drift * 2.6, across * 160.0 + drift * 4.0],
        );
        noise(rings, 3, groups);
        noise(fibres, 529, groups);
        each(
            groups,
            [rings, fibres, &block.inverse_depth],
            [&mut block.share],
            #[inline(always)]
            |[rings, fibres, inverse]| {
                let seen = (rings * rings * 0.75 + (fibres - 0.5) * 0.22).clamp(0.0, 1.0);
                [fade(seen, 0.36, 0.03 * (FOCAL_PX * inverse))]
            },
        );
    }
}

/// Distance of two stripes or rows of dots on a face of these half extents, in metres.
fn repetition(long: f32, short: f32) -> f32 {
    libm::fminf(
        libm::fminf(long * 0.4, libm::fmaxf(short, long * 0.15)),
        0.16,
    )
}

/// Takes a value towards its mean where a repetition is only few pixels wide.
#[inline(always)]
fn fade(value: f32, mean: f32, period_px: f32) -> f32 {
    let kept = (period_px * 0.5 - 0.75).clamp(0.0, 1.0);
    mean + (value - mean) * kept
}

/// The direction of a point around z in quarter turns, 0 to 4; exact at the axes,
/// nearly even between them.
#[inline(always)]
fn turn(x: f32, y: f32) -> f32 {
    let share = x / (x.abs() + y.abs() + 1e-9);
    // Evens the diamond out to a circle within half a percent.
    let even = share * (1.0 + 0.28 * (1.0 - share.abs()) * (2.0 * share.abs() - 1.0));
    if y >= 0.0 { 1.0 - even } else { 3.0 + even }
}

/// Smooth noise on a line, 0 to 1, in the place of the positions.
#[inline(always)]
fn noise(positions: &mut Quantity, stream: i32, groups: usize) {
    for group in &mut positions[..groups] {
        let mut cells = group.map(|_| 0_i32);
        for (cell, position) in cells.iter_mut().zip(&mut *group) {
            let whole = floor(*position);
            *cell = to_integer(whole).wrapping_add(stream);
            *position -= whole;
        }
        // The table is read apart from the computation, which would else wait for it.
        let mut ends = [[0.0; LANES]; 2];
        for (lane, cell) in cells.into_iter().enumerate() {
            ends[0][lane] = LATTICE[cell as usize % LATTICE.len()];
            ends[1][lane] = LATTICE[cell.wrapping_add(1) as usize % LATTICE.len()];
        }
        for (lane, position) in group.iter_mut().enumerate() {
            let (t, a, b) = (*position, ends[0][lane], ends[1][lane]);
            *position = a + (b - a) * (t * t * (3.0 - 2.0 * t));
        }
    }
}

/// Noise at whole positions: hashed integers, 0 to 1.
static LATTICE: [f32; 1024] = {
    let mut values = [0.0; 1024];
    let mut cell = 0;
    while cell < values.len() {
        let mut hash = (cell as u32)
            .wrapping_add(0x9e37_79b9)
            .wrapping_mul(0x85eb_ca6b);
        hash ^= hash >> 13;
        hash = hash.wrapping_mul(0xc2b2_ae35);
        hash ^= hash >> 16;
        values[cell] = (hash >> 8) as f32 * (1.0 / 16_777_216.0);
        cell += 1;
    }
    values
};

#[inline(always)]
fn fraction(value: f32) -> f32 {
    value - floor(value)
}
