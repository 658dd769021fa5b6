//! Owns how surfaces look: light, patterns and the sRGB tables. Works from what is visible in each pixel: the
//! point on the surface follows from pixel and depth, so nothing is interpolated. Knows no triangles.

use std::sync::LazyLock;

use reel_world::{FRAME_HEIGHT, FRAME_WIDTH};

use super::mesh::{BOTTOM, TOP};
use super::pattern::{self, SurfacePoint};
use super::raster::CameraFromPart;
use crate::geometry::{FOCAL_PX, Part, Pattern, Pose, Shape, dot};

/// A part that may be visible, with all that its pixels need.
pub(super) struct Surface {
    pub entity: u16,
    shape: Shape,
    pattern: Pattern,
    color: [f32; 3],
    accent: [f32; 3],
    /// Right, down, forward and the position of the camera in the frame of the part.
    axes: [[f32; 3]; 3],
    eye: [f32; 3],
    /// Towards the key light and up, in the frame of the part.
    key: [f32; 3],
    up: [f32; 3],
}

impl Surface {
    /// `pose` takes the part's frame to the scene.
    pub fn new(entity: u16, part: &Part, pose: &Pose, camera_from_part: &CameraFromPart) -> Self {
        let axes = camera_from_part.rows;
        let away = camera_from_part.translation;
        let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| pose.rotate(axis));
        Self {
            entity,
            shape: part.shape,
            pattern: part.pattern,
            color: part.color.map(to_linear),
            accent: part.accent.map(to_linear),
            axes,
            eye: [0, 1, 2].map(|k| -(axes[0][k] * away[0] + axes[1][k] * away[1] + axes[2][k] * away[2])),
            key: columns.map(|column| dot(column, KEY)),
            up: columns.map(|column| column[2]),
        }
    }

    /// The normal of a flat face; nothing on a round one.
    fn flat_normal(&self, face: u8) -> Option<[f32; 3]> {
        match self.shape {
            Shape::Cuboid { .. } => {
                let mut normal = [0.0; 3];
                normal[usize::from(face / 2)] = if face % 2 == 1 { 1.0 } else { -1.0 };
                Some(normal)
            }
            _ if face == TOP => Some([0.0, 0.0, 1.0]),
            _ if face == BOTTOM => Some([0.0, 0.0, -1.0]),
            _ => None,
        }
    }

    /// The normal at a point of a round face. The true shape's rather than the mesh's, hence smooth.
    fn round_normal(&self, [x, y, z]: [f32; 3]) -> [f32; 3] {
        match self.shape {
            Shape::Ball { radius } => [x / radius, y / radius, z / radius],
            Shape::Capsule { radius, half_height } => {
                let beyond = z - z.clamp(-half_height, half_height);
                [x / radius, y / radius, beyond / radius]
            }
            Shape::Cone { radius, half_height } => {
                let out = (x * x + y * y).sqrt().max(1e-6);
                let slant = (radius * radius + 4.0 * half_height * half_height).sqrt();
                let level = 2.0 * half_height / (slant * out);
                [x * level, y * level, radius / slant]
            }
            Shape::Cylinder { radius, .. } | Shape::Cuboid { half: [radius, ..] } => [x / radius, y / radius, 0.0],
        }
    }

    /// Whether a face looks up, so that things stand on it and darken it.
    pub fn receives_contact(&self, face: u8) -> bool {
        self.flat_normal(face).is_some_and(|normal| dot(normal, self.up) > 0.8)
    }

    /// Colours pixels `x..` of row `y`, given their inverse depths.
    pub fn shade(&self, face: u8, x: usize, y: usize, inverse_depth: &[f32], rgb: &mut [u8]) {
        let encode = &LINEAR_TO_SRGB;
        let flat = self.flat_normal(face);
        let pixels = rgb.as_chunks_mut::<3>().0.iter_mut().zip(inverse_depth);
        if let (Some(normal), Pattern::Plain) = (flat, self.pattern) {
            let light = light(dot(normal, self.key), dot(normal, self.up));
            let color = [0, 1, 2].map(|k| self.color[k] * light[k]);
            for (pixel, &inverse) in pixels {
                let weight = falloff(inverse);
                *pixel = color.map(|channel| encode.get(channel * weight));
            }
            return;
        }
        let flat_light = flat.map(|normal| light(dot(normal, self.key), dot(normal, self.up)));
        let surface = pattern::Mapping::new(&self.shape, face, flat.is_some());
        let [right, down, forward] = self.axes;
        let across_y = (y as f32 + 0.5 - FRAME_HEIGHT as f32 * 0.5) / FOCAL_PX;
        let row = [0, 1, 2].map(|k| forward[k] + down[k] * across_y);
        for (i, (pixel, &inverse)) in pixels.enumerate() {
            let across_x = ((x + i) as f32 + 0.5 - FRAME_WIDTH as f32 * 0.5) / FOCAL_PX;
            let depth = 1.0 / inverse;
            let ray = [0, 1, 2].map(|k| row[k] + right[k] * across_x);
            let point = [0, 1, 2].map(|k| self.eye[k] + ray[k] * depth);
            let normal = flat.unwrap_or_else(|| self.round_normal(point));
            let light = flat_light.unwrap_or_else(|| light(dot(normal, self.key), dot(normal, self.up)));
            let weight = falloff(inverse);
            let mut color = self.color;
            let mut shine = 0.0;
            match self.pattern {
                Pattern::Plain => {}
                Pattern::Glossy => shine = shine_of(normal, ray, self.key),
                Pattern::Stripes | Pattern::Dots | Pattern::Grain => {
                    let at: SurfacePoint = surface.at(point, depth / FOCAL_PX);
                    let share = pattern::accent_share(self.pattern, &at);
                    color = [0, 1, 2].map(|k| color[k] + (self.accent[k] - color[k]) * share);
                }
            }
            *pixel = [0, 1, 2].map(|k| encode.get((color[k] * light[k] + shine * (0.4 + 0.6 * self.accent[k])) * weight));
        }
    }
}

/// Colours a row of background: a soft gradient by how far the row looks up.
pub(super) fn background_row(camera_axes: &[[f32; 3]; 3], y: usize) -> [u8; 3] {
    let across_y = (y as f32 + 0.5 - FRAME_HEIGHT as f32 * 0.5) / FOCAL_PX;
    let up = camera_axes[2][2] + camera_axes[1][2] * across_y;
    let share = if up.is_finite() { (0.5 + up * 0.7).clamp(0.0, 1.0) } else { 0.5 };
    let (low, high) = ([0.42, 0.42, 0.40], [0.62, 0.71, 0.80]);
    [0, 1, 2].map(|k| LINEAR_TO_SRGB.get(low[k] + (high[k] - low[k]) * share))
}

/// Towards the key light in the scene: high, from behind the left of a robot that looks along +x.
const KEY: [f32; 3] = [-0.45, 0.36, 0.817];

/// Light on a surface, per channel, given the cosines of its normal with the key light and with up.
fn light(toward_key: f32, up: f32) -> [f32; 3] {
    // Wrapped around the terminator, as light of a large window is.
    let wrapped = (toward_key + 0.3) * (1.0 / 1.3);
    let key = if wrapped > 0.0 { wrapped * wrapped * 0.62 } else { 0.0 };
    let sky = 0.5 + 0.5 * up;
    [0.25 + 0.19 * sky + key, 0.235 + 0.215 * sky + key * 0.975, 0.225 + 0.25 * sky + key * 0.92]
}

/// Things far away are a little darker.
fn falloff(inverse_depth: f32) -> f32 {
    let square = inverse_depth * inverse_depth;
    square / (square + 0.012)
}

/// Mirror-like light: a spot towards the key light and a sheen at grazing angles.
fn shine_of(normal: [f32; 3], ray: [f32; 3], key: [f32; 3]) -> f32 {
    let toward_eye = -1.0 / dot(ray, ray).sqrt();
    let eye = ray.map(|c| c * toward_eye);
    let half = [0, 1, 2].map(|k| key[k] + eye[k]);
    let cosine = (dot(normal, half) / dot(half, half).sqrt().max(1e-3)).max(0.0);
    let (p2, facing) = (cosine * cosine, (1.0 - dot(normal, eye)).clamp(0.0, 1.0));
    let p4 = p2 * p2;
    let p8 = p4 * p4;
    let p32 = p8 * p8 * p8 * p8;
    let grazing = facing * facing;
    0.08 * p4 + 0.62 * p32 * p8 + 0.16 * grazing * grazing
}

/// An sRGB value as linear light.
fn to_linear(value: u8) -> f32 {
    SRGB_TO_LINEAR[usize::from(value)]
}

static SRGB_TO_LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| {
    core::array::from_fn(|value| {
        let encoded = value as f32 / 255.0;
        if encoded <= 0.04045 { encoded / 12.92 } else { libm::powf((encoded + 0.055) / 1.055, 2.4) }
    })
});

const LEVELS: usize = 4096;

static LINEAR_TO_SRGB: LazyLock<Encoder> = LazyLock::new(|| {
    Encoder(core::array::from_fn(|level| {
        let linear = (level as f32 + 0.5) / LEVELS as f32;
        let encoded = if linear <= 0.0031308 { linear * 12.92 } else { 1.055 * libm::powf(linear, 1.0 / 2.4) - 0.055 };
        (encoded * 255.0 + 0.5) as u8
    }))
});

/// Linear light to sRGB bytes.
struct Encoder([u8; LEVELS]);

impl Encoder {
    fn get(&self, linear: f32) -> u8 {
        // The cast saturates, so darkness and glare stay in the table.
        self.0[((linear * LEVELS as f32) as i32).clamp(0, LEVELS as i32 - 1) as usize]
    }
}
