//! Owns the tessellation of shapes: closed unit meshes, wound counter-clockwise seen from outside.
//! The level of detail depends on the size of a shape only, never on the view.

use std::sync::LazyLock;

use crate::geometry::Shape;

/// Face numbers of round shapes; a cuboid's are `axis * 2`, plus 1 on the positive side.
pub(super) const SIDE: u8 = 0;
pub(super) const TOP: u8 = 1;
pub(super) const BOTTOM: u8 = 2;

/// A corner of a unit mesh: `unit * scale`, moved along z by `lift` times the half height
/// of a capsule's cylinder.
#[derive(Clone, Copy)]
pub(super) struct Vertex {
    pub unit: [f32; 3],
    pub lift: f32,
}

pub(super) struct Triangle {
    pub corners: [u16; 3],
    pub face: u8,
}

#[derive(Default)]
pub(super) struct Mesh {
    pub vertices: Vec<Vertex>,
    pub triangles: Vec<Triangle>,
}

/// A unit mesh and how to stretch it into a shape.
#[derive(Clone, Copy)]
pub(super) struct Tessellation {
    pub mesh: &'static Mesh,
    pub scale: [f32; 3],
    pub lift: f32,
    /// Of the sphere around the origin that holds the shape, in metres.
    pub bound: f32,
}

impl Tessellation {
    /// The mesh of a shape; nothing when an extent is not positive and finite.
    pub fn of(shape: &Shape) -> Option<Self> {
        let meshes = &*MESHES;
        let (mesh, scale, lift) = match *shape {
            Shape::Cuboid { half } => (&meshes.cuboid, half, 0.0),
            Shape::Cylinder {
                radius,
                half_height,
            } => (
                &meshes.cylinders[detail(radius)],
                [radius, radius, half_height],
                0.0,
            ),
            Shape::Cone {
                radius,
                half_height,
            } => (
                &meshes.cones[detail(radius)],
                [radius, radius, half_height],
                0.0,
            ),
            Shape::Ball { radius } => (&meshes.balls[detail(radius)], [radius; 3], 0.0),
            Shape::Capsule {
                radius,
                half_height,
            } => (&meshes.capsules[detail(radius)], [radius; 3], half_height),
        };
        let drawable = scale
            .iter()
            .all(|&extent| extent > 0.0 && extent < LARGEST_M)
            && (0.0..LARGEST_M).contains(&lift);
        let bound = match shape {
            Shape::Ball { radius } => *radius,
            Shape::Capsule {
                radius,
                half_height,
            } => radius + half_height,
            Shape::Cylinder {
                radius,
                half_height,
            }
            | Shape::Cone {
                radius,
                half_height,
            } => length([*radius, 0.0, *half_height]),
            Shape::Cuboid { half } => length(*half),
        };
        drawable.then_some(Self {
            mesh,
            scale,
            lift,
            bound,
        })
    }

    /// A corner in the frame of the shape.
    pub fn place(&self, vertex: &Vertex) -> [f32; 3] {
        let [x, y, z] = vertex.unit;
        [
            x * self.scale[0],
            y * self.scale[1],
            z * self.scale[2] + vertex.lift * self.lift,
        ]
    }
}

/// Beyond this nothing is drawn, so that no coordinate can overflow.
pub(super) const LARGEST_M: f32 = 1.0e4;

const SEGMENTS: [u16; 4] = [12, 16, 24, 40];

struct Meshes {
    cuboid: Mesh,
    cylinders: [Mesh; 4],
    cones: [Mesh; 4],
    balls: [Mesh; 4],
    capsules: [Mesh; 4],
}

static MESHES: LazyLock<Meshes> = LazyLock::new(|| Meshes {
    cuboid: cuboid(),
    cylinders: SEGMENTS.map(cylinder),
    cones: SEGMENTS.map(cone),
    balls: SEGMENTS.map(|segments| ball(segments, false)),
    capsules: SEGMENTS.map(|segments| ball(segments, true)),
});

/// Which of `SEGMENTS` a radius in metres gets.
fn detail(radius: f32) -> usize {
    [0.02, 0.06, 0.25]
        .iter()
        .filter(|&&limit| radius > limit)
        .count()
}

fn length(v: [f32; 3]) -> f32 {
    libm::sqrtf(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
}

impl Mesh {
    fn vertex(&mut self, unit: [f32; 3], lift: f32) {
        self.vertices.push(Vertex { unit, lift });
    }

    fn triangle(&mut self, a: u16, b: u16, c: u16, face: u8) {
        self.triangles.push(Triangle {
            corners: [a, b, c],
            face,
        });
    }

    fn ring(&mut self, segments: u16, radius: f32, z: f32, lift: f32) {
        for i in 0..segments {
            let angle = f32::from(i) * (core::f32::consts::TAU / f32::from(segments));
            self.vertex(
                [libm::cosf(angle) * radius, libm::sinf(angle) * radius, z],
                lift,
            );
        }
    }

    /// Joins two rings of corners that start at `lower` and `upper`.
    fn band(&mut self, segments: u16, lower: u16, upper: u16) {
        for i in 0..segments {
            let next = (i + 1) % segments;
            self.triangle(lower + i, lower + next, upper + next, SIDE);
            self.triangle(lower + i, upper + next, upper + i, SIDE);
        }
    }

    /// Closes a ring that starts at `first` with a flat polygon.
    fn cap(&mut self, segments: u16, first: u16, face: u8) {
        for i in 1..segments - 1 {
            let (a, b) = if face == TOP { (i, i + 1) } else { (i + 1, i) };
            self.triangle(first, first + a, first + b, face);
        }
    }
}

fn cuboid() -> Mesh {
    let mut mesh = Mesh::default();
    for corner in 0..8 {
        mesh.vertex(
            [0, 1, 2].map(|axis| if corner >> axis & 1 == 1 { 1.0 } else { -1.0 }),
            0.0,
        );
    }
    let quads: [[u16; 4]; 6] = [
        [0, 4, 6, 2],
        [1, 3, 7, 5],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 2, 3, 1],
        [4, 5, 7, 6],
    ];
    for (face, [a, b, c, d]) in (0..).zip(quads) {
        mesh.triangle(a, b, c, face);
        mesh.triangle(a, c, d, face);
    }
    mesh
}

fn cylinder(segments: u16) -> Mesh {
    let mut mesh = Mesh::default();
    mesh.ring(segments, 1.0, -1.0, 0.0);
    mesh.ring(segments, 1.0, 1.0, 0.0);
    mesh.band(segments, 0, segments);
    mesh.cap(segments, 0, BOTTOM);
    mesh.cap(segments, segments, TOP);
    mesh
}

fn cone(segments: u16) -> Mesh {
    let mut mesh = Mesh::default();
    mesh.ring(segments, 1.0, -1.0, 0.0);
    mesh.vertex([0.0, 0.0, 1.0], 0.0);
    for i in 0..segments {
        mesh.triangle(i, (i + 1) % segments, segments, SIDE);
    }
    mesh.cap(segments, 0, BOTTOM);
    mesh
}

/// A ball; split at the equator by a band when it is to become a capsule.
fn ball(segments: u16, capsule: bool) -> Mesh {
    let bands = segments / 2;
    let mut rings: Vec<(f32, f32)> = Vec::new();
    for j in 1..bands {
        let lift = if j < bands / 2 { -1.0 } else { 1.0 };
        let latitude = (f32::from(j) / f32::from(bands) - 0.5) * core::f32::consts::PI;
        if capsule && j == bands / 2 {
            rings.push((latitude, -1.0));
        }
        rings.push((latitude, lift));
    }
    let mut mesh = Mesh::default();
    for &(latitude, lift) in &rings {
        mesh.ring(segments, libm::cosf(latitude), libm::sinf(latitude), lift);
    }
    let south = mesh.vertices.len() as u16;
    mesh.vertex([0.0, 0.0, -1.0], -1.0);
    mesh.vertex([0.0, 0.0, 1.0], 1.0);
    let last = south - segments;
    for (lower, upper) in (0..last)
        .step_by(usize::from(segments))
        .zip((segments..).step_by(usize::from(segments)))
    {
        mesh.band(segments, lower, upper);
    }
    for i in 0..segments {
        let next = (i + 1) % segments;
        mesh.triangle(next, i, south, SIDE);
        mesh.triangle(last + i, last + next, south + 1, SIDE);
    }
    mesh
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::geometry::{add, cross, dot, sub};

    fn every_mesh() -> Vec<&'static Mesh> {
        let m = &*MESHES;
        let mut all = vec![&m.cuboid];
        all.extend(
            m.cylinders
                .iter()
                .chain(&m.cones)
                .chain(&m.balls)
                .chain(&m.capsules),
        );
        all
    }

    #[test]
    fn meshes_are_closed_and_wound_outwards() {
        for mesh in every_mesh() {
            let shape = Tessellation {
                mesh,
                scale: [1.0; 3],
                lift: 1.0,
                bound: 2.0,
            };
            let mut edges = BTreeSet::new();
            for triangle in &mesh.triangles {
                let [a, b, c] = triangle.corners;
                for edge in [(a, b), (b, c), (c, a)] {
                    assert!(edges.insert(edge), "an edge is used twice in one direction");
                }
                let [a, b, c] = triangle
                    .corners
                    .map(|i| shape.place(&mesh.vertices[usize::from(i)]));
                assert!(
                    dot(cross(sub(b, a), sub(c, a)), add(a, add(b, c))) > 0.0,
                    "a triangle looks inwards"
                );
            }
            assert!(
                edges.iter().all(|&(a, b)| edges.contains(&(b, a))),
                "a mesh has a hole"
            );
        }
    }

    #[test]
    fn shapes_without_extent_have_no_mesh() {
        for radius in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert!(Tessellation::of(&Shape::Ball { radius }).is_none());
            assert!(
                Tessellation::of(&Shape::Capsule {
                    radius: 0.1,
                    half_height: radius - 1.0
                })
                .is_none()
            );
        }
    }
}
