//! Owns how surfaces look: light, patterns and the sRGB tables. Works from what is visible in
//! each pixel: the point on the surface follows from pixel and depth, so nothing is
//! interpolated. Knows no triangles.

use std::sync::LazyLock;

use reel_world::{FRAME_HEIGHT, FRAME_WIDTH};

use super::block::{BLOCK, Block, OFFSETS, change, each, fill};
use super::mesh::{BOTTOM, TOP};
use super::pattern::Mapping;
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

    /// Light on a surface of the frame, by its normal.
    #[inline(always)]
    fn light(&self, normal: [f32; 3]) -> [f32; 3] {
        light(dot(normal, self.key), dot(normal, self.up))
    }

    /// Rays and points of the pixels `x..` of row `y`.
    #[inline(always)]
    fn see(&self, block: &mut Block, [x, y]: [usize; 2], groups: usize) {
        let [right, down, forward] = self.axes;
        let along = (y as f32 + 0.5 - FRAME_HEIGHT as f32 * 0.5) / FOCAL_PX;
        let row = add(forward, scaled(down, along));
        let first = x as f32 + 0.5 - FRAME_WIDTH as f32 * 0.5;
        for k in 0..3 {
            let (row, right, eye) = (row[k], right[k], self.eye[k]);
            each(
                groups,
                [&OFFSETS, &block.inverse_depth],
                [&mut block.ray[k], &mut block.point[k]],
                #[inline(always)]
                |[offset, inverse]| {
                    let ray = row + right * ((first + offset) * (1.0 / FOCAL_PX));
                    [ray, eye + ray * (1.0 / inverse)]
                },
            );
        }
    }

    /// Adds what a glossy surface mirrors.
    #[inline(always)]
    fn mirror(&self, block: &mut Block, gloss: [f32; 3], groups: usize) {
        let ([x, y, z], [ray_x, ray_y, ray_z]) = (block.normal.each_ref(), block.ray.each_ref());
        each(
            groups,
            [x, y, z, ray_x, ray_y, ray_z],
            [&mut block.share],
            #[inline(always)]
            |[x, y, z, ray_x, ray_y, ray_z]| [shine_of([x, y, z], [ray_x, ray_y, ray_z], self.key)],
        );
        for (color, gloss) in block.color.iter_mut().zip(gloss) {
            change(
                groups,
                color,
                [&block.share],
                #[inline(always)]
                |color, [share]| color + gloss * share,
            );
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
    #[inline(always)]
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

    /// Whether a face looks up, so that things stand on it and darken it.
    pub fn receives_contact(&self, face: u8) -> bool {
        self.flat_normal(face)
            .is_some_and(|normal| dot(normal, self.place.up) > 0.8)
    }

    /// Colours pixels `x..` of row `y`, given their inverse depths.
    #[inline(always)]
    pub fn shade(
        &self,
        block: &mut Block,
        face: u8,
        [x, y]: [usize; 2],
        inverse_depth: &[f32],
        rgb: &mut [u8],
    ) {
        let flat = self.flat_normal(face);
        let plain = match (flat, self.pattern) {
            (Some(normal), Pattern::Plain) => Some(self.place.light(normal)),
            _ => None,
        };
        let pieces = inverse_depth
            .chunks(BLOCK)
            .zip(rgb.chunks_mut(BLOCK * 3))
            .zip((x..).step_by(BLOCK));
        for ((inverse_depth, rgb), x) in pieces {
            let groups = block.take(inverse_depth);
            if let Some(light) = plain {
                block.color_alike([0, 1, 2].map(|k| self.color[k] * light[k]));
            } else {
                self.color_block(block, face, flat, [x, y], groups);
            }
            block.encode(rgb);
        }
    }

    /// Fills the colours of a block from what its pixels see.
    #[inline(always)]
    fn color_block(
        &self,
        block: &mut Block,
        face: u8,
        flat: Option<[f32; 3]>,
        [x, y]: [usize; 2],
        groups: usize,
    ) {
        self.place.see(block, [x, y], groups);
        match flat {
            Some(normal) => {
                let light = self.place.light(normal);
                for k in 0..3 {
                    fill(&mut block.normal[k], normal[k], groups);
                    fill(&mut block.light[k], light[k], groups);
                }
            }
            None => {
                self.round_normals(block, groups);
                let [red, green, blue] = block.light.each_mut();
                each(
                    groups,
                    block.normal.each_ref(),
                    [red, green, blue],
                    #[inline(always)]
                    |normal| self.place.light(normal),
                );
            }
        }
        match self.pattern {
            Pattern::Plain | Pattern::Glossy => {
                for k in 0..3 {
                    fill(&mut block.color[k], self.color[k], groups);
                }
            }
            Pattern::Stripes | Pattern::Dots | Pattern::Grain => {
                let mapping = Mapping::new(&self.shape, face, flat.is_some());
                mapping.unroll(block, groups);
                match self.pattern {
                    Pattern::Stripes => mapping.stripes(block, groups),
                    Pattern::Dots => mapping.dots(block, groups),
                    _ => mapping.grain(block, groups),
                }
                block.mix(self.color, sub(self.accent, self.color));
            }
        }
        block.apply_light();
        if let Pattern::Glossy = self.pattern {
            self.place.mirror(block, self.gloss, groups);
        }
        block.apply_falloff();
    }

    /// The normals at the points of a round face: the true shape's rather than the mesh's, hence
    /// smooth.
    #[inline(always)]
    fn round_normals(&self, block: &mut Block, groups: usize) {
        let (points, normals) = (block.point.each_ref(), block.normal.each_mut());
        match self.shape {
            Shape::Ball { radius } => each(
                groups,
                points,
                normals,
                #[inline(always)]
                |[x, y, z]| [x / radius, y / radius, z / radius],
            ),
            Shape::Capsule {
                radius,
                half_height,
            } => each(
                groups,
                points,
                normals,
                #[inline(always)]
                |[x, y, z]| {
                    let beyond = z - z.clamp(-half_height, half_height);
                    [x / radius, y / radius, beyond / radius]
                },
            ),
            Shape::Cone {
                radius,
                half_height,
            } => {
                let slant = (radius * radius + 4.0 * half_height * half_height).sqrt();
                each(
                    groups,
                    points,
                    normals,
                    #[inline(always)]
                    |[x, y, _]| {
                        let out = (x * x + y * y).sqrt().max(1e-6);
                        let level = 2.0 * half_height / (slant * out);
                        [x * level, y * level, radius / slant]
                    },
                );
            }
            Shape::Cylinder { radius, .. } | Shape::Cuboid { half: [radius, ..] } => each(
                groups,
                points,
                normals,
                #[inline(always)]
                |[x, y, _]| [x / radius, y / radius, 0.0],
            ),
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
#[inline(always)]
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
#[inline(always)]
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
#[inline(always)]
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

/// Of linear light, from dark to as bright as a pixel gets.
pub(super) const LEVELS: usize = 4096;

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
    /// The byte of a level.
    #[inline(always)]
    pub fn byte(&self, level: usize) -> u8 {
        self.0[level % LEVELS]
    }

    #[inline]
    pub fn encode(&self, [red, green, blue]: [f32; 3]) -> [u8; 3] {
        // The cast saturates, so darkness and glare stay in the table.
        let level = |linear: f32| ((linear * LEVELS as f32) as i32).clamp(0, LEVELS as i32 - 1);
        [red, green, blue].map(|linear| self.byte(level(linear) as usize))
    }
}

/// A vector or colour times a number; inlined, unlike `map`, into what runs for every pixel.
#[inline(always)]
pub(super) fn scaled(v: [f32; 3], factor: f32) -> [f32; 3] {
    [v[0] * factor, v[1] * factor, v[2] * factor]
}
