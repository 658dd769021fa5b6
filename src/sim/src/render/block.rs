//! Owns how many pixels are computed at once: neighbouring ones, as an array for each quantity, in
//! loops that run on vectors. Knows neither surfaces nor patterns.
//!
//! The loops are plain: no operation is fused, approximated or reordered, so a vector of any width
//! computes the bits that one pixel after the other would.

use reel_world::FRAME_WIDTH;

use super::shade::{Encoder, LEVELS, LINEAR_TO_SRGB, falloff};

/// So many pixels are computed by one operation where the processor can.
pub(super) const LANES: usize = 8;

/// So many groups of them are computed at once.
const GROUPS: usize = 8;

/// So many pixels are computed at once.
pub(super) const BLOCK: usize = LANES * GROUPS;

/// A quantity of each pixel.
pub(super) type Quantity = [[f32; LANES]; GROUPS];

/// Quantities of neighbouring pixels that show one face. Of the last group of lanes, those after
/// the last pixel hold anything.
pub(super) struct Block {
    encoder: &'static Encoder,
    /// How many groups of lanes hold pixels.
    groups: usize,
    pub inverse_depth: Quantity,
    /// From the eye, of length 1 along the optical axis.
    pub ray: [Quantity; 3],
    /// What is seen, in the frame of the part.
    pub point: [Quantity; 3],
    pub normal: [Quantity; 3],
    /// Light that falls on it, by channel.
    pub light: [Quantity; 3],
    /// Flat coordinates of the point, in metres.
    pub along: Quantity,
    pub across: Quantity,
    /// Noise of a pattern.
    pub noise: [Quantity; 3],
    /// How much of the second colour, or of mirrored light, is seen.
    pub share: Quantity,
    /// Linear light, by channel.
    pub color: [Quantity; 3],
    levels: [[[i32; LANES]; GROUPS]; 3],
}

impl Block {
    pub fn new() -> Self {
        let quantity = [[0.0; LANES]; GROUPS];
        Self {
            encoder: &LINEAR_TO_SRGB,
            groups: 0,
            inverse_depth: quantity,
            ray: [quantity; 3],
            point: [quantity; 3],
            normal: [quantity; 3],
            light: [quantity; 3],
            along: quantity,
            across: quantity,
            noise: [quantity; 3],
            share: quantity,
            color: [quantity; 3],
            levels: [[[0; LANES]; GROUPS]; 3],
        }
    }

    /// Takes other pixels, at most [`BLOCK`]; gives how many groups of lanes hold them.
    #[inline(always)]
    pub fn take(&mut self, inverse_depth: &[f32]) -> usize {
        self.inverse_depth.as_flattened_mut()[..inverse_depth.len()].copy_from_slice(inverse_depth);
        self.groups = inverse_depth.len().div_ceil(LANES);
        self.groups
    }

    /// One colour for all pixels but for how far they are.
    #[inline(always)]
    pub fn color_alike(&mut self, [red, green, blue]: [f32; 3]) {
        each(
            self.groups,
            [&self.inverse_depth],
            self.color.each_mut(),
            #[inline(always)]
            |[inverse]| {
                let kept = falloff(inverse);
                [red * kept, green * kept, blue * kept]
            },
        );
    }

    /// The first colour and `share` of the way to the second.
    #[inline(always)]
    pub fn mix(&mut self, first: [f32; 3], way: [f32; 3]) {
        each(
            self.groups,
            [&self.share],
            self.color.each_mut(),
            #[inline(always)]
            |[share]| {
                [
                    first[0] + way[0] * share,
                    first[1] + way[1] * share,
                    first[2] + way[2] * share,
                ]
            },
        );
    }

    /// Lets the light fall on the colours.
    #[inline(always)]
    pub fn apply_light(&mut self) {
        for (color, light) in self.color.iter_mut().zip(&self.light) {
            change(
                self.groups,
                color,
                [light],
                #[inline(always)]
                |color, [light]| color * light,
            );
        }
    }

    /// Takes from the colours what is lost on the way to the eye.
    #[inline(always)]
    pub fn apply_falloff(&mut self) {
        for color in &mut self.color {
            change(
                self.groups,
                color,
                [&self.inverse_depth],
                #[inline(always)]
                |color, [inverse]| color * falloff(inverse),
            );
        }
    }

    /// Writes the colours as bytes.
    #[inline(always)]
    pub fn encode(&mut self, rgb: &mut [u8]) {
        for (levels, color) in self.levels.iter_mut().zip(&self.color) {
            for (levels, color) in levels.iter_mut().zip(color).take(self.groups) {
                *levels = level(color);
            }
        }
        let [red, green, blue] = &self.levels;
        let groups = red.iter().zip(green).zip(blue);
        for (pixels, ((red, green), blue)) in rgb.chunks_mut(LANES * 3).zip(groups) {
            let pixels = pixels.as_chunks_mut::<3>().0;
            let bytes = |red, green, blue| {
                let encoder = self.encoder;
                [red, green, blue].map(|level: i32| encoder.byte(level as usize))
            };
            // Along a row light changes slowly: many neighbours are equal.
            let alike = |channel: &[i32; LANES]| *channel == [channel[0]; LANES];
            if alike(red) && alike(green) && alike(blue) {
                pixels.fill(bytes(red[0], green[0], blue[0]));
                continue;
            }
            for (pixel, ((red, green), blue)) in
                pixels.iter_mut().zip(red.iter().zip(green).zip(blue))
            {
                *pixel = bytes(*red, *green, *blue);
            }
        }
    }
}

/// Computes quantities of each pixel from others.
#[inline(always)]
pub(super) fn each<const N: usize, const M: usize>(
    groups: usize,
    from: [&Quantity; N],
    mut to: [&mut Quantity; M],
    compute: impl Fn([f32; N]) -> [f32; M],
) {
    for group in 0..groups.min(GROUPS) {
        let mut results = [[0.0; LANES]; M];
        for lane in 0..LANES {
            let mut values = [0.0; N];
            for (value, quantity) in values.iter_mut().zip(from) {
                *value = quantity[group][lane];
            }
            let found = compute(values);
            for (result, found) in results.iter_mut().zip(found) {
                result[lane] = found;
            }
        }
        for (to, result) in to.iter_mut().zip(results) {
            to[group] = result;
        }
    }
}

/// Gives a quantity of all pixels one value.
#[inline(always)]
pub(super) fn fill(quantity: &mut Quantity, value: f32, groups: usize) {
    quantity[..groups.min(GROUPS)].fill([value; LANES]);
}

/// Changes a quantity of each pixel by others.
#[inline(always)]
pub(super) fn change<const N: usize>(
    groups: usize,
    quantity: &mut Quantity,
    from: [&Quantity; N],
    compute: impl Fn(f32, [f32; N]) -> f32,
) {
    for (group, changed) in quantity.iter_mut().enumerate().take(groups) {
        let mut results = *changed;
        for lane in 0..LANES {
            let mut values = [0.0; N];
            for (value, quantity) in values.iter_mut().zip(from) {
                *value = quantity[group][lane];
            }
            results[lane] = compute(changed[lane], values);
        }
        *changed = results;
    }
}

/// How many pixels each pixel of a block lies after the first.
pub(super) static OFFSETS: Quantity = {
    let mut offsets = [[0.0; LANES]; GROUPS];
    let mut pixel = 0;
    while pixel < BLOCK {
        offsets[pixel / LANES][pixel % LANES] = pixel as f32;
        pixel += 1;
    }
    offsets
};

/// The numbers 0, 1, 2...: counting within a loop would keep it from running on vectors.
pub(super) static INDICES: [f32; FRAME_WIDTH] = {
    let mut indices = [0.0; FRAME_WIDTH];
    let mut index = 0;
    while index < FRAME_WIDTH {
        indices[index] = index as f32;
        index += 1;
    }
    indices
};

/// One and a half times 2^23, from where on floats are as far apart as integers. A sum with it is
/// rounded to an integer and holds it in its lowest bits: numbers below four million need neither
/// the rounding of the C library nor a cast, which would look out for those that do not fit.
const MIDDLE: f32 = 12_582_912.0;

/// The largest integer that is not above a number below four million.
#[inline(always)]
pub(super) fn floor(value: f32) -> f32 {
    let nearest = (value + MIDDLE) - MIDDLE;
    if nearest > value {
        nearest - 1.0
    } else {
        nearest
    }
}

/// The integer that a number below four million is.
#[inline(always)]
pub(super) fn to_integer(whole: f32) -> i32 {
    ((whole + MIDDLE).to_bits() as i32).wrapping_sub(MIDDLE.to_bits() as i32)
}

/// Where linear light stands in the table of the encoder, as [`Encoder::encode`] has it.
#[inline(always)]
fn level(linear: &[f32; LANES]) -> [i32; LANES] {
    let mut whole = [0.0; LANES];
    for (whole, linear) in whole.iter_mut().zip(linear) {
        *whole = floor(linear * LEVELS as f32);
    }
    let last = LEVELS as f32 - 1.0;
    for whole in &mut whole {
        *whole = if *whole > 0.0 { *whole } else { 0.0 };
        *whole = if *whole < last { *whole } else { last };
    }
    let mut levels = [0; LANES];
    for (level, whole) in levels.iter_mut().zip(whole) {
        *level = to_integer(whole);
    }
    levels
}

/// Runs work with the widest vectors of this machine's processor, which only what is inlined into
/// the work gets.
#[inline(always)]
pub(super) fn on_vectors<R>(work: impl FnOnce() -> R) -> R {
    #[cfg(test)]
    if WITHOUT_VECTORS.get() {
        return work();
    }
    pulp::Arch::new().dispatch(work)
}

#[cfg(test)]
thread_local! {
    /// Whether this thread renders as a processor without wider vectors would.
    pub(super) static WITHOUT_VECTORS: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_come_out_of_floats() {
        for whole in [-4_000_000_i32, -65_536, -1, 0, 1, 4095, 65_535, 4_000_000] {
            assert_eq!(to_integer(whole as f32), whole);
        }
        assert_eq!(to_integer(-0.0), 0);
        for eighth in -40_000..40_000 {
            let value = eighth as f32 * 0.125;
            assert_eq!(floor(value), libm::floorf(value));
            let beside = f32::from_bits(value.to_bits() + 1);
            assert_eq!(floor(beside), libm::floorf(beside));
        }
    }

    #[test]
    fn levels_are_those_of_the_encoder() {
        let encoder: &Encoder = &LINEAR_TO_SRGB;
        for step in -200..2200_i32 {
            let linear = step as f32 * 0.000_613_7;
            let [one, ..] = level(&[linear; LANES]);
            assert_eq!(
                [encoder.byte(one as usize); 3],
                encoder.encode([linear; 3]),
                "{linear}"
            );
        }
        let odd = [
            f32::NAN,
            f32::INFINITY,
            f32::NEG_INFINITY,
            -0.0,
            1e30,
            -1e30,
            1.0,
            0.999_999,
        ];
        let found = level(&odd);
        assert_eq!(found, [0, 4095, 0, 0, 4095, 0, 4095, 4095]);
    }
}
