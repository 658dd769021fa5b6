//! Owns coverage and visibility: projects meshes, clips them at the near plane and fills triangles
//! with exact integer edge functions. Writes inverse depth and surface codes; knows no colours.

use reel_world::{FRAME_HEIGHT, FRAME_WIDTH};

use super::{
    block::{INDICES, LANES, on_vectors},
    mesh::Tessellation,
};
use crate::{
    geometry::{FOCAL_PX, add, dot},
    model::MeshModel,
};

/// Distance of the near plane in metres.
pub(super) const NEAR_M: f32 = 0.05;

/// What is seen in each pixel.
pub(super) struct Visibility {
    /// One over the depth along the optical axis in metres; 0 is nothing.
    pub inverse_depth: Vec<f32>,
    /// Code given to `draw` plus the face of the mesh; 0 is nothing.
    pub codes: Vec<u32>,
    corners: Vec<Corner>,
}

/// Rotation (rows) and translation into the camera frame.
#[derive(Clone, Copy)]
pub(super) struct CameraFromPart {
    pub rows: [[f32; 3]; 3],
    pub translation: [f32; 3],
}

impl CameraFromPart {
    /// Whether a sphere around the part's origin can be seen: false for what is not finite or
    /// far beyond any home.
    pub fn sees(&self, bound: f32) -> bool {
        let [x, y, z] = self.translation;
        let (half_width, half_height) = (FRAME_WIDTH as f32 * 0.5, FRAME_HEIGHT as f32 * 0.5);
        let outside = |offset: f32, half: f32| {
            (FOCAL_PX * libm::fabsf(offset) - half * z)
                / libm::sqrtf(FOCAL_PX * FOCAL_PX + half * half)
        };
        z + bound > NEAR_M
            && z < super::mesh::LARGEST_M
            && outside(x, half_width) < bound
            && outside(y, half_height) < bound
            && self.rows.iter().flatten().all(|entry| entry.is_finite())
    }
}

impl Visibility {
    pub fn new() -> Self {
        let pixels = FRAME_WIDTH * FRAME_HEIGHT;
        Self {
            inverse_depth: vec![0.0; pixels],
            codes: vec![0; pixels],
            corners: Vec::new(),
        }
    }

    /// Nothing is seen any more.
    pub fn clear(&mut self) {
        self.inverse_depth.fill(0.0);
        self.codes.fill(0);
    }

    /// Draws a mesh; triangles that show their back are left out. On equal depths
    /// the earlier drawn stays.
    pub fn draw(
        &mut self,
        tessellation: &Tessellation,
        camera_from_part: &CameraFromPart,
        code: u32,
    ) {
        let points = tessellation
            .mesh
            .vertices
            .iter()
            .map(|vertex| tessellation.place(vertex));
        let triangles = tessellation.mesh.triangles.iter();
        let triangles = triangles.map(|triangle| {
            (
                triangle.corners.map(usize::from),
                code + u32::from(triangle.face),
            )
        });
        on_vectors(
            #[inline(always)]
            || self.fill_all(points, triangles, camera_from_part),
        );
    }

    /// Draws both sides of the triangles of a mesh, each with a code of its own from `first` on;
    /// gives how many there are.
    pub fn draw_mesh(
        &mut self,
        model: &MeshModel,
        camera_from_part: &CameraFromPart,
        first: u32,
    ) -> u32 {
        let triangles = &model.mesh.data().triangles;
        let sides = (first..).zip(triangles).flat_map(|(code, triangle)| {
            let [a, b, c] = triangle.corners.map(|corner| corner as usize);
            [([a, b, c], code), ([a, c, b], code)]
        });
        let points = model.positions.iter().copied();
        on_vectors(
            #[inline(always)]
            || self.fill_all(points, sides, camera_from_part),
        );
        triangles.len() as u32
    }

    #[inline(always)]
    fn fill_all(
        &mut self,
        points: impl Iterator<Item = [f32; 3]>,
        triangles: impl Iterator<Item = ([usize; 3], u32)>,
        camera_from_part: &CameraFromPart,
    ) {
        let mut corners = core::mem::take(&mut self.corners);
        corners.clear();
        corners.extend(points.map(|point| {
            Corner::new(add(
                camera_from_part.rows.map(|row| dot(row, point)),
                camera_from_part.translation,
            ))
        }));
        for (triangle, code) in triangles {
            let [a, b, c] = triangle.map(|i| &corners[i]);
            match [a, b, c].iter().filter(|corner| corner.in_front).count() {
                0 => {}
                3 => self.fill([a.pixel, b.pixel, c.pixel], code),
                _ => self.fill_clipped([a, b, c], code),
            }
        }
        self.corners = corners;
    }

    /// Cuts a triangle at the near plane; what remains is a triangle or a quadrilateral.
    #[inline(always)]
    fn fill_clipped(&mut self, triangle: [&Corner; 3], code: u32) {
        let mut polygon = [ScreenPoint::default(); 4];
        let mut count = 0;
        for i in 0..3 {
            let (here, next) = (triangle[i], triangle[(i + 1) % 3]);
            if here.in_front {
                polygon[count] = here.pixel;
                count += 1;
            }
            if here.in_front != next.in_front {
                // Always from the visible end, so that two triangles cut their common edge
                // in the same point.
                let (inner, outer) = if here.in_front {
                    (here.point, next.point)
                } else {
                    (next.point, here.point)
                };
                let share = (NEAR_M - inner[2]) / (outer[2] - inner[2]);
                let x = inner[0] + share * (outer[0] - inner[0]);
                let y = inner[1] + share * (outer[1] - inner[1]);
                polygon[count] = ScreenPoint::project([x, y, NEAR_M]);
                count += 1;
            }
        }
        for i in 1..count - 1 {
            self.fill([polygon[0], polygon[i], polygon[i + 1]], code);
        }
    }

    /// Fills the pixels whose centres a front-facing triangle covers and in which it is nearest.
    /// Pixels on an edge belong to the triangle if it is a left or a top edge, so triangles that
    /// share an edge share no pixel.
    #[inline(always)]
    pub fn fill(&mut self, [a, c, b]: [ScreenPoint; 3], code: u32) {
        // Counter-clockwise from outside is negative with y down: corners two and
        // three are swapped above.
        let area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
        if area <= 0 {
            return;
        }
        let rows = pixel_range([a.y, b.y, c.y], FRAME_HEIGHT);
        let columns = pixel_range([a.x, b.x, c.x], FRAME_WIDTH);
        if rows.0 > rows.1 || columns.0 > columns.1 {
            return;
        }
        let edges = [Edge::new(b, c), Edge::new(c, a), Edge::new(a, b)];
        let weights = [a.inverse_depth, b.inverse_depth, c.inverse_depth];
        let (mut nearest, mut farthest) = (weights[0], weights[0]);
        for weight in weights {
            nearest = if weight > nearest { weight } else { nearest };
            farthest = if weight < farthest { weight } else { farthest };
        }
        // Inverse depth is linear over the image.
        let scale = 1.0 / area as f64;
        let share = [
            f64::from(weights[0]) * scale,
            f64::from(weights[1]) * scale,
            f64::from(weights[2]) * scale,
        ];
        let [one, two, three] = &edges;
        let weighted = |a: i64, b: i64, c: i64| {
            a as f64 * share[0] + b as f64 * share[1] + c as f64 * share[2]
        };
        let slope = weighted(one.per_x, two.per_x, three.per_x) * SUBPIXELS as f64;
        for y in rows.0..=rows.1 {
            let centre_y = y * SUBPIXELS + SUBPIXELS / 2;
            let values = [
                one.in_first_pixel(centre_y),
                two.in_first_pixel(centre_y),
                three.in_first_pixel(centre_y),
            ];
            let Some((first, last)) = span(&edges, values, columns) else {
                continue;
            };
            let ahead = SUBPIXELS * first;
            let start = weighted(
                values[0] + one.per_x * ahead,
                values[1] + two.per_x * ahead,
                values[2] + three.per_x * ahead,
            ) as f32;
            let row = y as usize * FRAME_WIDTH;
            let span = row + first as usize..row + last as usize + 1;
            let slope = slope as f32;
            let candidate = |index: f32| {
                let candidate = start + slope * index;
                let candidate = if candidate > nearest {
                    nearest
                } else {
                    candidate
                };
                if candidate < farthest {
                    farthest
                } else {
                    candidate
                }
            };
            let (depths, last_depths) = self.inverse_depth[span.clone()].as_chunks_mut::<LANES>();
            let (codes, last_codes) = self.codes[span].as_chunks_mut::<LANES>();
            let (indices, _) = INDICES.as_chunks::<LANES>();
            let last_indices = &INDICES[depths.len() * LANES..];
            // Whole groups are written, whoever wins: to write single lanes takes longer.
            for ((indices, depths), codes) in indices.iter().zip(depths).zip(codes) {
                let (mut new_depths, mut new_codes) = (*depths, *codes);
                for lane in 0..LANES {
                    let candidate = candidate(indices[lane]);
                    let wins = candidate > depths[lane];
                    new_depths[lane] = if wins { candidate } else { depths[lane] };
                    new_codes[lane] = if wins { code } else { codes[lane] };
                }
                (*depths, *codes) = (new_depths, new_codes);
            }
            let last = last_indices.iter().zip(last_depths).zip(last_codes);
            for ((index, depth), seen) in last {
                let candidate = candidate(*index);
                if candidate > *depth {
                    (*depth, *seen) = (candidate, code);
                }
            }
        }
    }
}

/// Fractions of a pixel that a corner can lie on.
pub(super) const SUBPIXELS: i64 = 256;

/// Corners are held within about a million pixels, so that edge functions fit 64 bits.
const FARTHEST_SUBPIXEL: f32 = (1u32 << 28) as f32;

/// A projected point in fixed-point image coordinates.
#[derive(Clone, Copy, Default)]
pub(super) struct ScreenPoint {
    pub x: i64,
    pub y: i64,
    pub inverse_depth: f32,
}

impl ScreenPoint {
    fn project([x, y, z]: [f32; 3]) -> Self {
        let inverse_depth = 1.0 / z;
        let fixed = |offset: f32, centre: usize| {
            let position = (centre as f32 + FOCAL_PX * offset * inverse_depth) * SUBPIXELS as f32;
            floor_to_integer(position.clamp(-FARTHEST_SUBPIXEL, FARTHEST_SUBPIXEL) + 0.5)
        };
        Self {
            x: fixed(x, FRAME_WIDTH / 2),
            y: fixed(y, FRAME_HEIGHT / 2),
            inverse_depth,
        }
    }
}

/// A corner of a mesh in the camera frame.
struct Corner {
    point: [f32; 3],
    in_front: bool,
    pixel: ScreenPoint,
}

impl Corner {
    fn new(point: [f32; 3]) -> Self {
        let in_front = point[2] >= NEAR_M;
        Self {
            point,
            in_front,
            pixel: if in_front {
                ScreenPoint::project(point)
            } else {
                ScreenPoint::default()
            },
        }
    }
}

/// `per_x * x + per_y * y + constant`: positive inside.
struct Edge {
    per_x: i64,
    per_y: i64,
    constant: i64,
    /// 0 where the edge itself belongs to the triangle (left and top edges), else -1.
    bias: i64,
}

impl Edge {
    #[inline(always)]
    fn new(from: ScreenPoint, to: ScreenPoint) -> Self {
        let (per_x, per_y) = (from.y - to.y, to.x - from.x);
        let left_or_top = per_x > 0 || (per_x == 0 && per_y > 0);
        Self {
            per_x,
            per_y,
            constant: from.x * to.y - from.y * to.x,
            bias: if left_or_top { 0 } else { -1 },
        }
    }

    /// Its value in the middle of the first pixel of a row.
    #[inline(always)]
    fn in_first_pixel(&self, centre_y: i64) -> i64 {
        self.per_x * (SUBPIXELS / 2) + self.per_y * centre_y + self.constant
    }
}

/// First and last pixel of a row that all edges hold inside, given the edges' values in the
/// middle of pixel 0.
#[inline(always)]
fn span(
    edges: &[Edge; 3],
    values: [i64; 3],
    (mut first, mut last): (i64, i64),
) -> Option<(i64, i64)> {
    if last - first < NARROW {
        let outside =
            |x: i64| (0..3).any(|i| values[i] + edges[i].bias + edges[i].per_x * SUBPIXELS * x < 0);
        while first <= last && outside(first) {
            first += 1;
        }
        while first < last && outside(last) {
            last -= 1;
        }
    } else {
        for (edge, value) in edges.iter().zip(values) {
            let (value, step) = (value + edge.bias, edge.per_x * SUBPIXELS);
            if step > 0 {
                first = first.max((step - 1 - value).div_euclid(step));
            } else if step < 0 {
                last = last.min(value.div_euclid(-step));
            } else if value < 0 {
                return None;
            }
        }
    }
    (first <= last).then_some((first, last))
}

/// Triangles of fewer columns than this are searched pixel by pixel, which gives the
/// same and spares divisions.
const NARROW: i64 = 24;

/// First and last pixel whose centre can lie within three coordinates, within the image.
#[inline(always)]
fn pixel_range([a, b, c]: [i64; 3], size: usize) -> (i64, i64) {
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    let first = (low - SUBPIXELS / 2 + SUBPIXELS - 1).div_euclid(SUBPIXELS);
    let last = (high - SUBPIXELS / 2).div_euclid(SUBPIXELS);
    (first.max(0), last.min(size as i64 - 1))
}

/// Floor as an integer, inlined: this runs for every corner.
fn floor_to_integer(value: f32) -> i64 {
    let whole = value as i64;
    whole - i64::from(whole as f32 > value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: i64, y: i64) -> ScreenPoint {
        ScreenPoint {
            x,
            y,
            inverse_depth: 1.0,
        }
    }

    /// Draws both windings, because one of them is the back.
    fn covered(corners: [ScreenPoint; 3]) -> Vec<u32> {
        let [a, b, c] = corners;
        let mut visibility = Visibility::new();
        visibility.fill([a, b, c], 1);
        visibility.fill([a, c, b], 1);
        visibility.codes
    }

    #[test]
    fn a_fan_covers_every_pixel_of_a_rectangle_once() {
        let corners = [
            point(10 * 256, 20 * 256),
            point(300 * 256, 20 * 256),
            point(300 * 256, 200 * 256),
            point(10 * 256, 200 * 256),
        ];
        // Through a pixel's centre, on a pixel's corner, and somewhere.
        for middle in [
            point(100 * 256 + 128, 77 * 256 + 128),
            point(155 * 256, 110 * 256),
            point(41_111, 33_333),
        ] {
            let mut times = vec![0; FRAME_WIDTH * FRAME_HEIGHT];
            for i in 0..4 {
                for (sum, code) in
                    times
                        .iter_mut()
                        .zip(covered([corners[i], corners[(i + 1) % 4], middle]))
                {
                    *sum += code;
                }
            }
            for y in 0..FRAME_HEIGHT {
                for x in 0..FRAME_WIDTH {
                    let inside = (10..300).contains(&x) && (20..200).contains(&y);
                    assert_eq!(
                        times[y * FRAME_WIDTH + x],
                        u32::from(inside),
                        "pixel {x}, {y}"
                    );
                }
            }
        }
    }

    #[test]
    fn edges_through_pixel_centres_belong_to_one_side() {
        let left = [
            point(128, 128),
            point(64 * 256 + 128, 64 * 256 + 128),
            point(128, 64 * 256 + 128),
        ];
        let right = [
            point(128, 128),
            point(64 * 256 + 128, 128),
            point(64 * 256 + 128, 64 * 256 + 128),
        ];
        let total: u32 = covered(left)
            .iter()
            .zip(covered(right))
            .map(|(a, b)| a + b)
            .sum();
        assert_eq!(total, 64 * 64);
    }
}
