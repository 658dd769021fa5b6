//! Owns how meshes look: colours, textures and smooth normals of their triangles, in the light of
//! everything else. What a pixel shows of a triangle follows from the point it sees, so nothing is
//! interpolated over the image.

use reel_world::mesh::{Texture, Triangle};

use super::shade::{
    Encoder, LINEAR_TO_SRGB, ShadingFrame, falloff, light, pixels_per_metre, scaled, to_linear,
};
use crate::{
    geometry::{add, cross, dot, sub},
    model::MeshModel,
};

/// How far the eye is for whom a triangle has one colour, in metres.
const SEEN_FROM_M: f32 = 2.0;

/// A mesh that may be visible.
pub(super) struct MeshSurface<'a> {
    pub entity: u16,
    /// Code of its first triangle.
    pub first: u32,
    model: &'a MeshModel,
    place: ShadingFrame,
}

/// A triangle with what all of its pixels share.
struct Facet<'a> {
    corner: [f32; 3],
    sides: [[f32; 3]; 2],
    /// Products of the sides, and what divides by their determinant.
    products: [f32; 3],
    inverse: f32,
    /// Flat normal of the triangle, on the side that faces the camera.
    normal: [f32; 3],
    normals: Option<[[f32; 3]; 3]>,
    color: [f32; 3],
    colors: Option<[[f32; 3]; 3]>,
    texture: Option<Texels<'a>>,
}

/// The texture of a triangle.
struct Texels<'a> {
    levels: &'a [Texture],
    points: [[f32; 2]; 3],
    per_metre: f32,
}

impl<'a> MeshSurface<'a> {
    pub fn new(entity: u16, first: u32, model: &'a MeshModel, place: ShadingFrame) -> Self {
        Self {
            entity,
            first,
            model,
            place,
        }
    }

    /// Whether a triangle looks up, so that things stand on it and darken it.
    pub fn receives_contact(&self, triangle: usize) -> bool {
        dot(self.facet(triangle).normal, self.place.up) > 0.8
    }

    /// Colours pixels `x..` of row `y` that show a triangle, given their inverse depths.
    pub fn shade(
        &self,
        triangle: usize,
        x: usize,
        y: usize,
        inverse_depth: &[f32],
        rgb: &mut [u8],
    ) {
        let encode: &Encoder = &LINEAR_TO_SRGB;
        let facet = self.facet(triangle);
        for ((x, pixel), &inverse) in (x..).zip(rgb.as_chunks_mut::<3>().0).zip(inverse_depth) {
            let weights = facet.weights(self.place.point(x, y, inverse));
            let normal = facet.normal_at(weights);
            let light = light(dot(normal, self.place.key), dot(normal, self.place.up));
            let color = facet.color_at(weights, inverse);
            *pixel = encode.encode(scaled(
                [
                    color[0] * light[0],
                    color[1] * light[1],
                    color[2] * light[2],
                ],
                falloff(inverse),
            ));
        }
    }

    fn facet(&self, triangle: usize) -> Facet<'_> {
        Facet::of(self.model, triangle, self.place.eye)
    }
}

/// The colour of the middle of a triangle without light, as linear RGB: of a texture what is seen
/// of it from [`SEEN_FROM_M`].
pub(super) fn middle_color(model: &MeshModel, triangle: usize) -> [f32; 3] {
    Facet::of(model, triangle, [0.0; 3]).color_at([1.0 / 3.0; 3], 1.0 / SEEN_FROM_M)
}

impl<'a> Facet<'a> {
    /// A triangle of a model, with its flat normal towards the eye.
    fn of(model: &'a MeshModel, triangle: usize, eye: [f32; 3]) -> Self {
        let data = model.mesh.data();
        let Triangle { corners, material } = data.triangles[triangle];
        let corners = corners.map(|corner| corner as usize);
        let [corner, b, c] = corners.map(|corner| model.positions[corner]);
        let sides = [sub(b, corner), sub(c, corner)];
        let products = [
            dot(sides[0], sides[0]),
            dot(sides[0], sides[1]),
            dot(sides[1], sides[1]),
        ];
        let inverse = inverse_of(products[0] * products[2] - products[1] * products[1]);
        let across = cross(sides[0], sides[1]);
        let twice_area = dot(across, across).sqrt();
        let outward = scaled(across, inverse_of(twice_area));
        let normal = if dot(outward, sub(eye, corner)) < 0.0 {
            scaled(outward, -1.0)
        } else {
            outward
        };
        let material = &data.materials[usize::from(material)];
        Self {
            corner,
            sides,
            products,
            inverse,
            normal,
            normals: (!data.normals.is_empty()).then(|| corners.map(|corner| data.normals[corner])),
            color: material.color,
            colors: (!data.colors.is_empty()).then(|| corners.map(|corner| data.colors[corner])),
            texture: material.texture.map(|texture| {
                let levels = model.mesh.levels(texture);
                let points = corners.map(|corner| data.texture_points[corner]);
                let [u, v] = [1, 2].map(|i| {
                    let size = [levels[0].width as f32, levels[0].height as f32];
                    [0, 1].map(|axis| (points[i][axis] - points[0][axis]) * size[axis])
                });
                let twice_texels = (u[0] * v[1] - u[1] * v[0]).abs();
                Texels {
                    levels,
                    points,
                    per_metre: (twice_texels * inverse_of(twice_area)).sqrt(),
                }
            }),
        }
    }

    /// How much a point has of each corner: each at least 0, together 1.
    #[inline]
    fn weights(&self, point: [f32; 3]) -> [f32; 3] {
        let away = sub(point, self.corner);
        let along = [dot(away, self.sides[0]), dot(away, self.sides[1])];
        let [aa, ab, bb] = self.products;
        let b = ((bb * along[0] - ab * along[1]) * self.inverse).clamp(0.0, 1.0);
        let c = ((aa * along[1] - ab * along[0]) * self.inverse).clamp(0.0, 1.0 - b);
        [1.0 - b - c, b, c]
    }

    /// The smooth normal, on the side of the eye; the flat one where there is none.
    #[inline]
    fn normal_at(&self, weights: [f32; 3]) -> [f32; 3] {
        let Some(normals) = self.normals else {
            return self.normal;
        };
        let mixed = mix(normals, weights);
        let square = dot(mixed, mixed);
        if !(square > 1e-12 && square < 1e12) {
            return self.normal;
        }
        let length = square.sqrt();
        scaled(
            mixed,
            if dot(mixed, self.normal) < 0.0 {
                -1.0 / length
            } else {
                1.0 / length
            },
        )
    }

    #[inline]
    fn color_at(&self, weights: [f32; 3], inverse_depth: f32) -> [f32; 3] {
        let times = |a: [f32; 3], b: [f32; 3]| [a[0] * b[0], a[1] * b[1], a[2] * b[2]];
        let color = self
            .colors
            .map_or(self.color, |colors| times(self.color, mix(colors, weights)));
        match &self.texture {
            Some(texels) => times(color, texels.at(weights, inverse_depth).map(to_linear)),
            None => color,
        }
    }
}

impl Texels<'_> {
    /// The colour at a point of the triangle: the mean of four texels of the level whose texels are
    /// about as large as pixels.
    fn at(&self, [a, b, c]: [f32; 3], inverse_depth: f32) -> [u8; 3] {
        let mut per_pixel = self.per_metre / pixels_per_metre(inverse_depth);
        let mut level = 0;
        while per_pixel > 1.5 && level + 1 < self.levels.len() {
            per_pixel *= 0.5;
            level += 1;
        }
        let texture = &self.levels[level];
        let [p, q, r] = &self.points;
        let [u, v] = [0, 1].map(|axis| p[axis] * a + q[axis] * b + r[axis] * c);
        let (x, y) = (
            TexelSpan::new(u, texture.width),
            TexelSpan::new(v, texture.height),
        );
        let texel = |x: u32, y: u32, channel: usize| {
            u32::from(texture.rgb[(y * texture.width + x) as usize * 3 + channel])
        };
        [0, 1, 2].map(|channel| {
            let row = |y: u32| {
                texel(x.first, y, channel) * (256 - x.share) + texel(x.second, y, channel) * x.share
            };
            ((row(y.first) * (256 - y.share) + row(y.second) * y.share + (1 << 15)) >> 16) as u8
        })
    }
}

/// Between two neighbouring texels of a row or column that repeats.
struct TexelSpan {
    first: u32,
    second: u32,
    /// Of 256, of the second one.
    share: u32,
}

impl TexelSpan {
    #[inline]
    fn new(position: f32, size: u32) -> Self {
        // What is no number is 0: casts saturate, and the remainder keeps it inside.
        let whole = position as i64 as f32;
        let fraction = position - if whole > position { whole - 1.0 } else { whole };
        let fixed = (fraction * size as f32 * 256.0) as i64 - 128;
        let first = fixed.div_euclid(256).rem_euclid(i64::from(size)) as u32;
        Self {
            first,
            second: (first + 1) % size,
            share: fixed.rem_euclid(256) as u32,
        }
    }
}

#[inline]
fn mix([a, b, c]: [[f32; 3]; 3], weights: [f32; 3]) -> [f32; 3] {
    add(
        add(scaled(a, weights[0]), scaled(b, weights[1])),
        scaled(c, weights[2]),
    )
}

/// One over a number; 0 where that is none.
#[inline]
fn inverse_of(value: f32) -> f32 {
    let inverse = 1.0 / value;
    if inverse.is_finite() { inverse } else { 0.0 }
}
