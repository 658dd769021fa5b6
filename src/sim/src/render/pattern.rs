//! Owns the patterns of surfaces: where the second colour shows. Arithmetic on object
//! space only, no images.

use crate::geometry::Shape;

/// A point in the flat coordinates of a face, in metres, with the size of a pixel there.
pub(super) struct SurfacePoint {
    /// Along the longer side of a flat face, along the axis of a round one.
    along: f32,
    across: f32,
    /// Distance of two repetitions along and across.
    period: [f32; 2],
    /// Repetitions in a metre.
    per_metre: [f32; 2],
    pixels_per_metre: f32,
}

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

    /// Flat coordinates of a point of the face, and how many pixels a metre has there.
    #[inline(always)]
    pub fn at(&self, point: [f32; 3], pixels_per_metre: f32) -> SurfacePoint {
        let across = if self.quarter > 0.0 {
            turn(point[0], point[1]) * self.quarter
        } else {
            point[self.axes[1]]
        };
        SurfacePoint {
            along: point[self.axes[0]],
            across,
            period: self.period,
            per_metre: self.per_metre,
            pixels_per_metre,
        }
    }
}

/// How much of the second colour bands along the face show, 0 to 1. Like the others, what is finer
/// than a pixel fades to its mean.
#[inline(always)]
pub(super) fn stripes(at: &SurfacePoint) -> f32 {
    let distance =
        (0.25 - (fraction(at.along * at.per_metre[0] + 0.25) - 0.5).abs()) * at.period[0];
    let seen = (distance * at.pixels_per_metre + 0.5).clamp(0.0, 1.0);
    fade(seen, 0.5, at.period[0] * at.pixels_per_metre)
}

/// How much of the second colour rows of dots show.
#[inline(always)]
pub(super) fn dots(at: &SurfacePoint) -> f32 {
    let row = at.along * at.per_metre[0];
    let shift = if floor(row) as i32 & 1 == 0 { 0.0 } else { 0.5 };
    let (u, v) = (
        fraction(row) - 0.5,
        fraction(at.across * at.per_metre[1] + shift) - 0.5,
    );
    let (u, v) = (u * at.period[0], v * at.period[1]);
    let radius = 0.3 * at.period[0];
    let distance = (radius - (u * u + v * v) / radius) * 0.5;
    fade(
        (distance * at.pixels_per_metre + 0.5).clamp(0.0, 1.0),
        0.28,
        at.period[0] * at.pixels_per_metre,
    )
}

/// How much of the second colour the grain of wood shows.
#[inline(always)]
pub(super) fn grain(at: &SurfacePoint) -> f32 {
    let drift = noise(at.along * 2.3, 117);
    let rings = noise(at.across * 34.0 + drift * 2.6, 3);
    let fibres = noise(at.across * 160.0 + drift * 4.0, 529);
    let seen = (rings * rings * 0.75 + (fibres - 0.5) * 0.22).clamp(0.0, 1.0);
    fade(seen, 0.36, 0.03 * at.pixels_per_metre)
}

/// Distance of two stripes or rows of dots on a face of these half extents, in metres.
fn repetition(long: f32, short: f32) -> f32 {
    libm::fminf(
        libm::fminf(long * 0.4, libm::fmaxf(short, long * 0.15)),
        0.16,
    )
}

/// Takes a value towards its mean where a repetition is only few pixels wide.
#[inline]
fn fade(value: f32, mean: f32, period_px: f32) -> f32 {
    let kept = (period_px * 0.5 - 0.75).clamp(0.0, 1.0);
    mean + (value - mean) * kept
}

/// The direction of a point around z in quarter turns, 0 to 4; exact at the axes,
/// nearly even between them.
#[inline]
fn turn(x: f32, y: f32) -> f32 {
    let share = x / (x.abs() + y.abs() + 1e-9);
    // Evens the diamond out to a circle within half a percent.
    let even = share * (1.0 + 0.28 * (1.0 - share.abs()) * (2.0 * share.abs() - 1.0));
    if y >= 0.0 { 1.0 - even } else { 3.0 + even }
}

/// Smooth noise on a line, 0 to 1.
#[inline]
fn noise(position: f32, stream: usize) -> f32 {
    let cell = floor(position);
    let t = position - cell;
    let at = (cell as i32 as usize).wrapping_add(stream);
    let (a, b) = (
        LATTICE[at % LATTICE.len()],
        LATTICE[at.wrapping_add(1) % LATTICE.len()],
    );
    a + (b - a) * (t * t * (3.0 - 2.0 * t))
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

#[inline]
fn fraction(value: f32) -> f32 {
    value - floor(value)
}

/// Floor within the range of 32-bit integers, inlined: this runs for every pixel.
#[inline]
fn floor(value: f32) -> f32 {
    let whole = value as i32 as f32;
    if whole > value { whole - 1.0 } else { whole }
}
