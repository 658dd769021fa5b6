//! Owns what makes a picture readable: shadows where things touch what they stand on, and thin lines between
//! things. Works on pixels and their neighbours only.

use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame};

use super::raster::Visibility;
use super::shade::Surface;
use super::surface_of;
use crate::geometry::FOCAL_PX;

/// Darkens surfaces that look up close to other things at the same depth.
pub(super) fn darken_contacts(visibility: &Visibility, surfaces: &[Surface], frame: &mut Frame) {
    for y in 0..FRAME_HEIGHT {
        let row = y * FRAME_WIDTH;
        let mut x = 0;
        for run in visibility.codes[row..row + FRAME_WIDTH].chunk_by(|a, b| a == b) {
            let from = x;
            x += run.len();
            let receives = run[0] != 0 && {
                let (surface, face) = surface_of(run[0]);
                surfaces[surface].receives_contact(face)
            };
            if !receives {
                continue;
            }
            for column in from..x {
                let shadow = contact_of(visibility, &frame.ids, column, y);
                if shadow > 0 {
                    scale(&mut frame.rgb, row + column, 256 - shadow);
                }
            }
        }
    }
}

/// Darkens the pixels along the outlines of things, strongly, and along the edges of their parts, weakly.
pub(super) fn draw_edges(visibility: &Visibility, surfaces: &[Surface], frame: &mut Frame) {
    let (codes, depths) = (&visibility.codes, &visibility.inverse_depth);
    let mut darkest = vec![0u8; FRAME_WIDTH * FRAME_HEIGHT];
    let mut compare = |a: usize, b: usize| {
        if codes[a] == codes[b] {
            return;
        }
        let (here, there) = (identity(codes[a], surfaces), identity(codes[b], surfaces));
        let strength = match (here, there) {
            (Some((a, _)), Some((b, _))) if surfaces[a].entity == surfaces[b].entity => {
                if a == b {
                    FACE_EDGE
                } else {
                    PART_EDGE
                }
            }
            _ => OUTLINE,
        };
        // The line lies on the nearer thing. Equal depths are told apart by what does not depend on drawing order.
        let a_is_nearer = depths[a] > depths[b] || (depths[a] == depths[b] && frame.ids[a] >= frame.ids[b]);
        let on = if a_is_nearer { a } else { b };
        darkest[on] = darkest[on].max(strength);
    };
    for y in 0..FRAME_HEIGHT {
        let row = y * FRAME_WIDTH;
        for at in row..row + FRAME_WIDTH - 1 {
            compare(at, at + 1);
        }
        if y + 1 < FRAME_HEIGHT {
            for at in row..row + FRAME_WIDTH {
                compare(at, at + FRAME_WIDTH);
            }
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

fn identity(code: u32, surfaces: &[Surface]) -> Option<(usize, u8)> {
    (code != 0).then(|| surface_of(code)).filter(|(surface, _)| *surface < surfaces.len())
}

/// Shadow of 256 at a pixel: how much of its surroundings is another thing at about the same depth.
fn contact_of(visibility: &Visibility, ids: &[u16], x: usize, y: usize) -> i32 {
    let here = y * FRAME_WIDTH + x;
    let inverse = visibility.inverse_depth[here];
    let depth = 1.0 / inverse;
    let reach = FOCAL_PX * 0.03 * inverse;
    let mut shadow = 0;
    for (right, up, weight) in [(0.0, 0.3, 30), (0.0, 0.85, 22), (-0.8, 0.4, 16), (0.8, 0.4, 16), (-1.6, 0.2, 9), (1.6, 0.2, 9)] {
        let column = x as i32 + (right * reach) as i32;
        let line = y as i32 - (up * reach) as i32 - 1;
        if !(0..FRAME_WIDTH as i32).contains(&column) || line < 0 {
            continue;
        }
        let there = line as usize * FRAME_WIDTH + column as usize;
        let other = visibility.inverse_depth[there];
        if ids[there] != ids[here] && other > 0.0 && (1.0 / other - depth).abs() < 0.08 {
            shadow += weight;
        }
    }
    shadow
}

fn scale(rgb: &mut [u8], pixel: usize, of_256: i32) {
    for channel in &mut rgb[pixel * 3..pixel * 3 + 3] {
        *channel = (i32::from(*channel) * of_256 >> 8) as u8;
    }
}
