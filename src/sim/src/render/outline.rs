//! Owns what makes an image readable: shadows where things touch what they stand on, and thin
//! lines between things. Works on pixels and their neighbours only.

use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame};

use super::raster::Visibility;
use super::{FIRST_MESH, Surfaces, VisibleFace, for_runs, surface_of};
use crate::geometry::FOCAL_PX;

/// Darkens surfaces that look up close to other things at the same depth.
pub(super) fn darken_contacts(visibility: &Visibility, surfaces: &Surfaces<'_>, frame: &mut Frame) {
    // Neighbours mostly show the same face.
    let (mut known, mut receives) = (0, false);
    let alone = Cells::of(&frame.ids);
    for (cell_y, cell_x) in alone.busy(visibility) {
        for y in cell_y * CELL..(cell_y + 1) * CELL {
            for at in y * FRAME_WIDTH + cell_x * CELL..y * FRAME_WIDTH + (cell_x + 1) * CELL {
                let code = visibility.codes[at];
                if code != known {
                    known = code;
                    receives = code != 0
                        && match surfaces.at(code) {
                            VisibleFace::Part(surface, face) => surface.receives_contact(face),
                            VisibleFace::Mesh(mesh, triangle) => mesh.receives_contact(triangle),
                        };
                }
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
pub(super) fn draw_edges(visibility: &Visibility, darkest: &mut [u8], frame: &mut Frame) {
    let (codes, depths) = (&visibility.codes, &visibility.inverse_depth);
    darkest.fill(0);
    let mut draw = |a: usize, b: usize| {
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
        for_runs(row, |run, _| {
            if run.start > 0 {
                let at = y * FRAME_WIDTH + run.start;
                draw(at - 1, at);
            }
        });
    }
    let pieces = codes
        .chunks_exact(TILE)
        .zip(codes[FRAME_WIDTH..].chunks_exact(TILE));
    for (i, _) in pieces
        .enumerate()
        .filter(|(_, (here, below))| here != below)
    {
        for at in i * TILE..(i + 1) * TILE {
            if codes[at] != codes[at + FRAME_WIDTH] {
                draw(at, at + FRAME_WIDTH);
            }
        }
    }
    let pieces = darkest.as_chunks::<TILE>().0.iter().enumerate();
    for (i, piece) in pieces.filter(|(_, piece)| **piece != [0; TILE]) {
        for (at, &strength) in (i * TILE..).zip(piece) {
            if strength > 0 {
                scale(&mut frame.rgb, at, 256 - i32::from(strength));
            }
        }
    }
}

/// How much of 256 a line takes away.
const OUTLINE: u8 = 130;
const PART_EDGE: u8 = 64;
const FACE_EDGE: u8 = 34;

/// Lines are looked for in pieces of so many pixels of a row, which is a multiple of it.
const TILE: usize = 32;

/// Side of the square cells in which neighbours are looked for; both sides of the image are
/// multiples of it.
const CELL: usize = 8;
const CELLS_ACROSS: usize = FRAME_WIDTH / CELL;
const CELLS_DOWN: usize = FRAME_HEIGHT / CELL;

/// The thing that each cell shows, where it is only one.
struct Cells(Vec<Option<u16>>);

impl Cells {
    fn of(ids: &[u16]) -> Self {
        let mut cells = Vec::with_capacity(CELLS_ACROSS * CELLS_DOWN);
        for rows in ids.chunks_exact(FRAME_WIDTH * CELL) {
            for x in (0..FRAME_WIDTH).step_by(CELL) {
                let first = rows[x];
                let mut rows = rows.chunks_exact(FRAME_WIDTH);
                let alone = rows.all(|row| row[x..x + CELL] == [first; CELL]);
                cells.push(alone.then_some(first));
            }
        }
        Self(cells)
    }

    /// Whether nothing but a thing is in the cells within the reach of one.
    fn is_around(
        &self,
        thing: u16,
        [x, y]: [usize; 2],
        (_, aside, far): (usize, usize, usize),
    ) -> bool {
        let columns = x.saturating_sub(aside.div_ceil(CELL))
            ..=(x + aside.div_ceil(CELL)).min(CELLS_ACROSS - 1);
        (y.saturating_sub(far.div_ceil(CELL))..=y).all(|y| {
            let row = &self.0[y * CELLS_ACROSS..][columns.clone()];
            row.iter().all(|cell| *cell == Some(thing))
        })
    }

    /// Rows and columns of the cells in which shadows can fall: what lies within the reach of their
    /// pixels, beside and above, is not one thing.
    fn busy(&self, visibility: &Visibility) -> impl Iterator<Item = (usize, usize)> {
        (0..CELLS_ACROSS * CELLS_DOWN)
            .map(|i| (i / CELLS_ACROSS, i % CELLS_ACROSS))
            .filter(move |&(y, x)| {
                let Some(thing) = self.0[y * CELLS_ACROSS + x] else {
                    return true;
                };
                // Most cells have nothing else as far as any pixel reaches.
                !self.is_around(thing, [x, y], taps(f32::MAX))
                    && !self.is_around(thing, [x, y], taps(nearest_in(visibility, [x, y])))
            })
    }
}

/// The largest inverse depth in a cell.
fn nearest_in(visibility: &Visibility, [x, y]: [usize; 2]) -> f32 {
    let mut columns = [0.0_f32; CELL];
    let rows = visibility.inverse_depth[y * CELL * FRAME_WIDTH..].chunks_exact(FRAME_WIDTH);
    for row in rows.take(CELL) {
        for (nearest, &inverse) in columns.iter_mut().zip(&row[x * CELL..]) {
            *nearest = if inverse > *nearest {
                inverse
            } else {
                *nearest
            };
        }
    }
    columns.into_iter().fold(
        0.0,
        |nearest, inverse| if inverse > nearest { inverse } else { nearest },
    )
}

/// Where a pixel's surroundings are looked at: how far up, aside, and far up, in pixels; none grows
/// with the distance.
#[inline(always)]
fn taps(inverse_depth: f32) -> (usize, usize, usize) {
    let reach = (FOCAL_PX * CONTACT_M * inverse_depth).min(REACH_MAX_PX);
    let pixels = |length: f32| usize::from(length as u8);
    (
        pixels(0.25 * reach) + 1,
        pixels(reach),
        pixels(0.75 * reach) + 1,
    )
}

/// Shadows of what is nearest reach no farther.
const REACH_MAX_PX: f32 = 30.0;

/// Shadow of 256 at a pixel: how much of its surroundings is another thing at about the same depth.
fn contact_of(visibility: &Visibility, ids: &[u16], x: usize, y: usize) -> i32 {
    let here = y * FRAME_WIDTH + x;
    let inverse = visibility.inverse_depth[here];
    let depth = 1.0 / inverse;
    let (near, aside, far) = taps(inverse);
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
