//! Owns how surfaces look: light, patterns and the sRGB tables. Works from what is visible in
//! each pixel: the point on the surface follows from pixel and depth, so nothing is
//! interpolated. Knows no triangles.

use std::sync::LazyLock;

use reel_world::{FRAME_HEIGHT, FRAME_WIDTH};

use super::mesh::{BOTTOM, TOP};
use super::pattern::{Mapping, dots, grain, stripes};
use super::raster::CameraFromPart;
use crate::geometry::{FOCAL_PX, Part, Pattern, Pose, Shape, add, dot, sub};

/// A part that may be visible, with all that its pixels need.
pub(super) struct Surface {
    pub entity: u16,
    shape: Shape,
    pattern: Pattern,
    color: [f32; 3],
    accent: [f32; 3],
    /// Colour of mirrored light.
    gloss: [f32; 3],
    place: ShadingFrame,
}

/// What surrounds a part or a mesh, in its own frame.
pub(super) struct ShadingFrame {
    /// Right, down and forward of the camera.
    axes: [[f32; 3]; 3],
    /// Position of the camera.
    pub eye: [f32; 3],
    /// Towards the key light.
    pub key: [f32; 3],
    pub up: [f32; 3],
}

impl ShadingFrame {
    /// `pose` takes the frame to the scene.
    pub fn new(pose: &Pose, camera_from_part: &CameraFromPart) -> Self {
        let axes = camera_from_part.rows;
        let away = camera_from_part.translation;
        let columns =
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| pose.rotate(axis));
        Self {
            axes,
            eye: [0, 1, 2]
                .map(|k| -(axes[0][k] * away[0] + axes[1][k] * away[1] + axes[2][k] * away[2])),
            key: columns.map(|column| dot(column, KEY)),
            up: columns.map(|column| column[2]),
        }
    }

    /// What the middle of a pixel shows at an inverse depth.
    #[inline]
    pub fn point(&self, x: usize, y: usize, inverse_depth: f32) -> [f32; 3] {
        let [right, down, forward] = self.axes;
        let across = (x as f32 + 0.5 - FRAME_WIDTH as f32 * 0.5) / FOCAL_PX;
        let along = (y as f32 + 0.5 - FRAME_HEIGHT as f32 * 0.5) / FOCAL_PX;
        let ray = add(add(forward, scaled(down, along)), scaled(right, across));
        add(self.eye, scaled(ray, 1.0 / inverse_depth))
    }
}

impl Surface {
    /// `pose` takes the part's frame to the scene.
    pub fn new(entity: u16, part: &Part, pose: &Pose, camera_from_part: &CameraFromPart) -> Self {
        Self {
            entity,
            shape: part.shape,
            pattern: part.pattern,
            color: part.color.map(to_linear),
            accent: part.accent.map(to_linear),
            gloss: part.accent.map(|channel| 0.4 + 0.6 * to_linear(channel)),
            place: ShadingFrame::new(pose, camera_from_part),
        }
    }

    /// The normal of a flat face; nothing on a round one.
    #[inline]
    fn flat_normal(&self, face: u8) -> Option<[f32; 3]> {
        match self.shape {
            Shape::Cuboid { .. } => {
                let side = if face % 2 == 1 { 1.0 } else { -1.0 };
                Some([0, 1, 2].map(|axis| if face / 2 == axis { side } else { 0.0 }))
            }
            _ if face == TOP => Some([0.0, 0.0, 1.0]),
            _ if face == BOTTOM => Some([0.0, 0.0, -1.0]),
            _ => None,
        }
    }

    /// The normal at a point of a round face. The true shape's rather than
    /// the mesh's, hence smooth.
    #[inline]
    fn round_normal(&self, [x, y, z]: [f32; 3]) -> [f32; 3] {
        match self.shape {
            Shape::Ball { radius } => [x / radius, y / radius, z / radius],
            Shape::Capsule {
                radius,
                half_height,
            } => {
                let beyond = z - z.clamp(-half_height, half_height);
                [x / radius, y / radius, beyond / radius]
            }
            Shape::Cone {
                radius,
                half_height,
            } => {
                let out = (x * x + y * y).sqrt().max(1e-6);
                let slant = (radius * radius + 4.0 * half_height * half_height).sqrt();
                let level = 2.0 * half_height / (slant * out);
                [x * level, y * level, radius / slant]
            }
            Shape::Cylinder { radius, .. } | Shape::Cuboid { half: [radius, ..] } => {
                [x / radius, y / radius, 0.0]
            }
        }
    }

    /// Whether a face looks up, so that things stand on it and darken it.
    pub fn receives_contact(&self, face: u8) -> bool {
        self.flat_normal(face)
            .is_some_and(|normal| dot(normal, self.place.up) > 0.8)
    }

    /// Colours pixels `x..` of row `y`, given their inverse depths.
    pub fn shade(&self, face: u8, x: usize, y: usize, inverse_depth: &[f32], rgb: &mut [u8]) {
        let encode: &Encoder = &LINEAR_TO_SRGB;
        let flat = self.flat_normal(face);
        if let (Some(normal), Pattern::Plain) = (flat, self.pattern) {
            let light = light(dot(normal, self.place.key), dot(normal, self.place.up));
            let color = [0, 1, 2].map(|k| self.color[k] * light[k]);
            for (pixel, &inverse) in rgb.as_chunks_mut::<3>().0.iter_mut().zip(inverse_depth) {
                let weight = falloff(inverse);
                *pixel = encode.encode(scaled(color, weight));
            }
            return;
        }
        let mapping = Mapping::new(&self.shape, face, flat.is_some());
        let run = Run {
            surface: self,
            flat,
            x,
            y,
            inverse_depth,
        };
        let mixed = |share: f32| {
            (
                add(self.color, scaled(sub(self.accent, self.color), share)),
                [0.0; 3],
            )
        };
        // One loop for each pattern, so that each is short.
        match self.pattern {
            Pattern::Plain => run.shade(rgb, |_| (self.color, [0.0; 3])),
            Pattern::Glossy => run.shade(rgb, |at| {
                (
                    self.color,
                    scaled(self.gloss, shine_of(at.normal, at.ray, self.place.key)),
                )
            }),
            Pattern::Stripes => run.shade(rgb, |at| {
                mixed(stripes(&mapping.at(at.point, at.pixels_per_metre)))
            }),
            Pattern::Dots => run.shade(rgb, |at| {
                mixed(dots(&mapping.at(at.point, at.pixels_per_metre)))
            }),
            Pattern::Grain => run.shade(rgb, |at| {
                mixed(grain(&mapping.at(at.point, at.pixels_per_metre)))
            }),
        }
    }
}

/// Neighbouring pixels that show one face.
struct Run<'a> {
    surface: &'a Surface,
    /// The normal, if it is the same everywhere.
    flat: Option<[f32; 3]>,
    x: usize,
    y: usize,
    inverse_depth: &'a [f32],
}

/// What a pixel sees, in the frame of the part.
struct ShadingPoint {
    point: [f32; 3],
    normal: [f32; 3],
    /// From the eye, of length 1 along the optical axis.
    ray: [f32; 3],
    pixels_per_metre: f32,
}

impl Run<'_> {
    /// Lights the colours that `look` gives: of the surface itself and of what it mirrors.
    #[inline(always)]
    fn shade(&self, rgb: &mut [u8], look: impl Fn(&ShadingPoint) -> ([f32; 3], [f32; 3])) {
        let encode: &Encoder = &LINEAR_TO_SRGB;
        let surface = self.surface;
        let lit = |normal: [f32; 3]| {
            light(
                dot(normal, surface.place.key),
                dot(normal, surface.place.up),
            )
        };
        let flat = self.flat.map(|normal| (normal, lit(normal)));
        let [right, down, forward] = surface.place.axes;
        let across_y = (self.y as f32 + 0.5 - FRAME_HEIGHT as f32 * 0.5) / FOCAL_PX;
        let row = add(forward, scaled(down, across_y));
        let mut across = self.x as f32 + 0.5 - FRAME_WIDTH as f32 * 0.5;
        for (pixel, &inverse) in rgb
            .as_chunks_mut::<3>()
            .0
            .iter_mut()
            .zip(self.inverse_depth)
        {
            let ray = add(row, scaled(right, across * (1.0 / FOCAL_PX)));
            across += 1.0;
            let point = add(surface.place.eye, scaled(ray, 1.0 / inverse));
            let (normal, [red, green, blue]) = flat.unwrap_or_else(|| {
                let normal = surface.round_normal(point);
                (normal, lit(normal))
            });
            let (own, mirrored) = look(&ShadingPoint {
                point,
                normal,
                ray,
                pixels_per_metre: FOCAL_PX * inverse,
            });
            let color = add([own[0] * red, own[1] * green, own[2] * blue], mirrored);
            *pixel = encode.encode(scaled(color, falloff(inverse)));
        }
    }
}

/// Colours a row of background: a soft gradient by how far the row looks up.
pub(super) fn background_row(camera_axes: &[[f32; 3]; 3], y: usize) -> [u8; 3] {
    let across_y = (y as f32 + 0.5 - FRAME_HEIGHT as f32 * 0.5) / FOCAL_PX;
    let up = camera_axes[2][2] + camera_axes[1][2] * across_y;
    let share = if up.is_finite() {
        (0.5 + up * 0.7).clamp(0.0, 1.0)
    } else {
        0.5
    };
    let (low, high) = ([0.42, 0.42, 0.40], [0.62, 0.71, 0.80]);
    LINEAR_TO_SRGB.encode(add(low, scaled(sub(high, low), share)))
}

/// Towards the key light in the scene: high, from behind the left of a robot that looks along +x.
const KEY: [f32; 3] = [-0.45, 0.36, 0.817];

/// Light on a surface, per channel, given the cosines of its normal with the key light and with up.
#[inline]
pub(super) fn light(toward_key: f32, up: f32) -> [f32; 3] {
    // Wrapped around the terminator, as light of a large window is.
    let wrapped = (toward_key + 0.3) * (1.0 / 1.3);
    let key = if wrapped > 0.0 {
        wrapped * wrapped * 0.56
    } else {
        0.0
    };
    let sky = 0.5 + 0.5 * up;
    [
        0.335 + 0.2 * sky + key,
        0.32 + 0.22 * sky + key * 0.975,
        0.305 + 0.25 * sky + key * 0.93,
    ]
}

/// Things far away are a little darker.
#[inline]
pub(super) fn falloff(inverse_depth: f32) -> f32 {
    let square = inverse_depth * inverse_depth;
    square / (square + 0.008)
}

/// How many pixels a metre that faces the camera has.
#[inline]
pub(super) fn pixels_per_metre(inverse_depth: f32) -> f32 {
    FOCAL_PX * inverse_depth
}

/// Mirror-like light: a spot towards the key light and a sheen at grazing angles.
#[inline]
fn shine_of(normal: [f32; 3], ray: [f32; 3], key: [f32; 3]) -> f32 {
    let eye = scaled(ray, -1.0 / dot(ray, ray).sqrt());
    let half = add(key, eye);
    let cosine = (dot(normal, half) / dot(half, half).sqrt().max(1e-3)).max(0.0);
    let (p2, facing) = (cosine * cosine, (1.0 - dot(normal, eye)).clamp(0.0, 1.0));
    let p4 = p2 * p2;
    let p8 = p4 * p4;
    let p32 = p8 * p8 * p8 * p8;
    let grazing = facing * facing;
    0.08 * p4 + 0.62 * p32 * p8 + 0.16 * grazing * grazing
}

/// An sRGB value as linear light.
pub(super) fn to_linear(value: u8) -> f32 {
    SRGB_TO_LINEAR[usize::from(value)]
}

static SRGB_TO_LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| {
    core::array::from_fn(|value| {
        let encoded = value as f32 / 255.0;
        if encoded <= 0.04045 {
            encoded / 12.92
        } else {
            libm::powf((encoded + 0.055) / 1.055, 2.4)
        }
    })
});

const LEVELS: usize = 4096;

pub(super) static LINEAR_TO_SRGB: LazyLock<Encoder> = LazyLock::new(|| {
    Encoder(core::array::from_fn(|level| {
        let linear = (level as f32 + 0.5) / LEVELS as f32;
        let encoded = if linear <= 0.0031308 {
            linear * 12.92
        } else {
            1.055 * libm::powf(linear, 1.0 / 2.4) - 0.055
        };
        (encoded * 255.0 + 0.5) as u8
    }))
});

/// Linear light to sRGB bytes.
pub(super) struct Encoder([u8; LEVELS]);

impl Encoder {
    #[inline]
    pub fn encode(&self, [red, green, blue]: [f32; 3]) -> [u8; 3] {
        // The cast saturates, so darkness and glare stay in the table.
        let byte = |linear: f32| {
            self.0[((linear * LEVELS as f32) as i32).clamp(0, LEVELS as i32 - 1) as usize]
        };
        [byte(red), byte(green), byte(blue)]
    }
}

/// A vector or colour times a number; inlined, unlike `map`, into what runs for every pixel.
#[inline(always)]
pub(super) fn scaled(v: [f32; 3], factor: f32) -> [f32; 3] {
    [v[0] * factor, v[1] * factor, v[2] * factor]
}
