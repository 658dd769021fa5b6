//! What there is to say of a sound mesh.

use std::collections::BTreeMap;

use reel_world::{Digest, Mesh};
use serde::Serialize;

/// A mesh in numbers.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Survey {
    /// Number of triangles of the mesh.
    pub triangles: usize,
    /// Vertices: corners that differ in place, normal, texture point or colour.
    pub vertices: usize,
    /// Width (x), depth (y), height (z), in units of its own.
    pub size: [f32; 3],
    /// Whether no edge has more than two triangles.
    pub manifold: bool,
    /// Whether every edge has two triangles, that go along it in opposite directions.
    pub watertight: bool,
    /// Width and height of each texture.
    pub textures: Vec<[u32; 2]>,
    /// Whether vertices have colours.
    pub vertex_colors: bool,
    /// What a trace names it by.
    pub digest: Digest,
}

impl Survey {
    /// Measures a mesh: counts, size, topology, textures and digest.
    pub fn of(mesh: &Mesh) -> Self {
        let data = mesh.data();
        let [low, high] = mesh.bounds();
        let edges = edges(mesh);
        Self {
            triangles: data.triangles.len(),
            vertices: data.positions.len(),
            size: [0, 1, 2].map(|axis| high[axis] - low[axis]),
            manifold: edges.values().all(|[along, against]| along + against <= 2),
            watertight: edges.values().all(|uses| *uses == [1, 1]),
            textures: data
                .textures
                .iter()
                .map(|texture| [texture.width, texture.height])
                .collect(),
            vertex_colors: !data.colors.is_empty(),
            digest: mesh.digest(),
        }
    }
}

/// How often each edge is used along and against its own direction. Vertices in one place are one;
/// triangles with two corners in one place have no area and do not count.
fn edges(mesh: &Mesh) -> BTreeMap<(u32, u32), [u32; 2]> {
    let mut places = BTreeMap::new();
    let positions = &mesh.data().positions;
    // Adding zero makes one zero of both.
    let place = |point: &[f32; 3]| point.map(|value| (value + 0.0).to_bits());
    let joined: Vec<u32> = positions
        .iter()
        .map(|point| {
            let next = places.len() as u32;
            *places.entry(place(point)).or_insert(next)
        })
        .collect();
    let mut edges = BTreeMap::new();
    for triangle in &mesh.data().triangles {
        let [a, b, c] = triangle.corners.map(|corner| joined[corner as usize]);
        if a == b || b == c || c == a {
            continue;
        }
        for (from, to) in [(a, b), (b, c), (c, a)] {
            edges.entry((from.min(to), from.max(to))).or_insert([0, 0])[usize::from(from > to)] +=
                1;
        }
    }
    edges
}
