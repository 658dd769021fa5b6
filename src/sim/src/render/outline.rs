//! Owns what makes an image readable: shadows where things touch what they stand on, and thin
//! lines between things. Works on pixels and their neighbours only.

use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame};

use super::raster::Visibility;
use super::{FACES, FIRST_MESH, Surfaces, VisibleFace, surface_of};
use crate::geometry::FOCAL_PX;

/// Darkens surfaces that look up close to other things at the same depth.
pub(super) fn darken_contacts(visibility: &Visibility, surfaces: &Surfaces<'_>, frame: &mut Frame) {
    let faces = (0..FACES as u8).map(|face| {
        surfaces
            .parts
            .iter()
            .map(move |surface| surface.receives_contact(face))
    });
    let receives: Vec<Vec<bool>> = faces.map(Iterator::collect).collect();
    for (tile_y, tile_x) in busy_tiles(&frame.ids) {
        for y in tile_y * TILE..(tile_y + 1) * TILE {
            for at in y * FRAME_WIDTH + tile_x * TILE..y * FRAME_WIDTH + (tile_x + 1) * TILE {
                if visibility.codes[at] == 0 {
                    continue;
                }
                let receives = match visibility.codes[at] {
                    code if code < FIRST_MESH => {
                        let (surface, face) = surface_of(code);
                        receives[usize::from(face)][surface]
                    }
                    code => {
                        matches!(surfaces.at(code), VisibleFace::Mesh(mesh, triangle) if mesh.receives_contact(triangle))
                    }
                };
                if receives {
                    let shadow = contact_of(visibility, &frame.ids, at % FRAME_WIDTH, y);
                    scale(&mut frame.rgb, at, 256 - shadow);
                }
            }
        }
    }
}

/// Darkens the pixels along the outlines of things, strongly, and along the edges
/// of their parts, weakly.
pub(super) fn draw_edges(visibility: &Visibility, frame: &mut Frame) {
    let (codes, depths) = (&visibility.codes, &visibility.inverse_depth);
    let mut darkest = vec![0u8; FRAME_WIDTH * FRAME_HEIGHT];
    let mut compare = |a: usize, b: usize| {
        if codes[a] == codes[b] {
            return;
        }
        let strength = if codes[a] == 0 || codes[b] == 0 || frame.ids[a] != frame.ids[b] {
            OUTLINE
        } else if codes[a] >= FIRST_MESH || codes[b] >= FIRST_MESH {
            // Triangles of one mesh: its faces are not what it is made of.
            return;
        } else if surface_of(codes[a]).0 != surface_of(codes[b]).0 {
            PART_EDGE
        } else {
            FACE_EDGE
        };
        // The line lies on the nearer thing. Equal depths are told apart by what does not
        // depend on drawing order.
        let a_is_nearer =
            depths[a] > depths[b] || (depths[a] == depths[b] && frame.ids[a] >= frame.ids[b]);
        let on = if a_is_nearer { a } else { b };
        darkest[on] = darkest[on].max(strength);
    };
    for (y, row) in codes.chunks_exact(FRAME_WIDTH).enumerate() {
        let mut at = y * FRAME_WIDTH;
        for run in row.chunk_by(|a, b| a == b) {
            if at > y * FRAME_WIDTH {
                compare(at - 1, at);
            }
            at += run.len();
        }
    }
    let pieces = codes
        .chunks_exact(TILE)
        .zip(codes[FRAME_WIDTH..].chunks_exact(TILE));
    for (i, _) in pieces
        .enumerate()
        .filter(|(_, (here, below))| here != below)
    {
        for at in i * TILE..(i + 1) * TILE {
            compare(at, at + FRAME_WIDTH);
        }
    }
    for (at, &strength) in darkest.iter().enumerate() {
        if strength > 0 {
            scale(&mut frame.rgb, at, 256 - i32::from(strength));
        }
    }
}

/// How much of 256 a line takes away.
const OUTLINE: u8 = 130;
const PART_EDGE: u8 = 64;
const FACE_EDGE: u8 = 34;

/// Side of the square tiles in which neighbours are looked for; both sides of the image
/// are multiples of it.
const TILE: usize = 32;

/// Rows and columns of the tiles in which shadows can fall: they or the tiles beside and
/// above hold several things.
fn busy_tiles(ids: &[u16]) -> impl Iterator<Item = (usize, usize)> {
    const ACROSS: usize = FRAME_WIDTH / TILE;
    const DOWN: usize = FRAME_HEIGHT / TILE;
    let tile = |tile_y: usize, tile_x: usize| {
        let first = ids[tile_y * TILE * FRAME_WIDTH + tile_x * TILE];
        let rows = ids[tile_y * TILE * FRAME_WIDTH..]
            .chunks_exact(FRAME_WIDTH)
            .take(TILE);
        let alone = rows
            .map(|row| {
                row[tile_x * TILE..][..TILE]
                    .iter()
                    .filter(|&&id| id != first)
                    .count()
            })
            .sum::<usize>()
            == 0;
        alone.then_some(first)
    };
    let tiles: Vec<Option<u16>> = (0..ACROSS * DOWN)
        .map(|i| tile(i / ACROSS, i % ACROSS))
        .collect();
    (0..ACROSS * DOWN)
        .map(|i| (i / ACROSS, i % ACROSS))
        .filter(move |&(y, x)| {
            let mut around = (y.saturating_sub(1)..=y)
                .flat_map(|y| (x.saturating_sub(1)..=(x + 1).min(ACROSS - 1)).map(move |x| (y, x)));
            let here = tiles[y * ACROSS + x];
            here.is_none() || around.any(|(y, x)| tiles[y * ACROSS + x] != here)
        })
}

/// Shadow of 256 at a pixel: how much of its surroundings is another thing at about the same depth.
fn contact_of(visibility: &Visibility, ids: &[u16], x: usize, y: usize) -> i32 {
    let here = y * FRAME_WIDTH + x;
    let inverse = visibility.inverse_depth[here];
    let depth = 1.0 / inverse;
    // Taps stay within the neighbouring tiles.
    let reach = (FOCAL_PX * CONTACT_M * inverse).min(TILE as f32 - 2.0);
    let pixels = |length: f32| usize::from(length as u8);
    let (near, aside, far) = (
        pixels(0.25 * reach) + 1,
        pixels(reach),
        pixels(0.75 * reach) + 1,
    );
    let weight_of = |x: usize, up: usize, weight: i32| {
        if x >= FRAME_WIDTH || up > y {
            return 0;
        }
        let there = (y - up) * FRAME_WIDTH + x;
        let other = visibility.inverse_depth[there];
        // As |1 / other - depth| < 0.08, without dividing; never true of nothing.
        let touches = ids[there] != ids[here] && (1.0 - other * depth).abs() < 0.08 * other;
        if touches { weight } else { 0 }
    };
    let left = if x >= aside {
        weight_of(x - aside, near, 20)
    } else {
        0
    };
    weight_of(x, near, 34) + weight_of(x, far, 24) + left + weight_of(x + aside, near, 20)
}

/// How far from a thing its shadow reaches, in metres.
const CONTACT_M: f32 = 0.04;

fn scale(rgb: &mut [u8], pixel: usize, of_256: i32) {
    for channel in &mut rgb[pixel * 3..pixel * 3 + 3] {
        *channel = ((i32::from(*channel) * of_256) >> 8) as u8;
    }
}
