//! Pictures: a software rasterizer with exact integer coverage, and Set-of-Mark overlays.
//!
//! Every picture is a pure function of its arguments, to the bit, on every platform. Never decides what is in a
//! scene or what is worth a mark, and never encodes files.

mod mesh;
mod outline;
mod overlay;
mod pattern;
mod raster;
mod shade;
pub mod text;

#[cfg(test)]
mod tests;

use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame};

use crate::geometry::{Camera, Part, Pose, dot};
use mesh::Tessellation;
use raster::{CameraFromPart, Visibility};
use shade::Surface;

pub use overlay::overlay;

/// Parts to draw with one pose and one entity id.
#[derive(Clone, Copy, Debug)]
pub struct Drawable<'a> {
    /// In the drawable's frame.
    pub parts: &'a [Part],
    /// Scene from drawable.
    pub pose: Pose,
    /// Written to the id buffer; 0 is nothing.
    pub entity: u16,
}

/// A number to draw.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Mark {
    /// The number shown.
    pub number: u32,
    /// What it marks.
    pub region: Region,
}

/// Where a mark goes.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Region {
    /// The pixels of an entity: its mask is tinted and outlined.
    Entity(u16),
    /// A rectangle in pixels: x0, y0, x1, y1 (inclusive, clipped to the picture by the caller).
    Rectangle([u16; 4]),
}

/// How much of a picture is drawn.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Detail {
    /// All of it.
    #[default]
    Picture,
    /// Instance ids and depth; RGB stays black. Everything but the picture itself is decided by these.
    Geometry,
}

/// Draws the drawables as the camera sees them. What has no finite pose or no extent is left out.
///
/// Surfaces nearer than 5 cm are cut off. Where two parts are equally far, the earlier drawable is seen.
pub fn render(camera: &Camera, drawables: &[Drawable<'_>], detail: Detail) -> Frame {
    let camera_axes = camera.axes();
    let mut visibility = Visibility::new();
    let mut surfaces = Vec::new();
    for drawable in drawables {
        for part in drawable.parts {
            let Some(tessellation) = Tessellation::of(&part.shape) else { continue };
            let pose = drawable.pose.then(&part.pose);
            let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| pose.rotate(axis));
            let camera_from_part = CameraFromPart {
                rows: camera_axes.map(|axis| columns.map(|column| dot(axis, column))),
                translation: camera.to_camera(pose.position),
            };
            if camera_from_part.sees(tessellation.bound) {
                visibility.draw(&tessellation, &camera_from_part, code_of(surfaces.len()));
                surfaces.push(Surface::new(drawable.entity, part, &pose, &camera_from_part));
            }
        }
    }
    let mut frame = Frame::new();
    identify(&visibility, &surfaces, &mut frame);
    if detail == Detail::Geometry {
        return frame;
    }
    color(&camera_axes, &visibility, &surfaces, &mut frame);
    outline::darken_contacts(&visibility, &surfaces, &mut frame);
    outline::draw_edges(&visibility, &mut frame);
    frame
}

/// Faces per surface in the codes of the visibility buffer.
const FACES: u32 = 8;

/// Code of the first face of a surface; 0 is nothing.
fn code_of(surface: usize) -> u32 {
    surface as u32 * FACES + 1
}

/// Surface and face of a code other than 0.
fn surface_of(code: u32) -> (usize, u8) {
    (((code - 1) / FACES) as usize, ((code - 1) % FACES) as u8)
}

/// Fills ids and depth from what is visible.
fn identify(visibility: &Visibility, surfaces: &[Surface], frame: &mut Frame) {
    for (depth_mm, &inverse) in frame.depth_mm.iter_mut().zip(&visibility.inverse_depth) {
        *depth_mm = if inverse > 0.0 { (1000.0 / inverse + 0.5) as u16 } else { 0 };
    }
    let mut start = 0;
    for run in visibility.codes.chunk_by(|a, b| a == b) {
        if run[0] != 0 {
            frame.ids[start..start + run.len()].fill(surfaces[surface_of(run[0]).0].entity);
        }
        start += run.len();
    }
}

/// Fills RGB from what is visible, run by run of one face.
fn color(camera_axes: &[[f32; 3]; 3], visibility: &Visibility, surfaces: &[Surface], frame: &mut Frame) {
    for y in 0..FRAME_HEIGHT {
        let background = shade::background_row(camera_axes, y);
        let row = y * FRAME_WIDTH;
        let mut x = 0;
        for run in visibility.codes[row..row + FRAME_WIDTH].chunk_by(|a, b| a == b) {
            let span = row + x..row + x + run.len();
            let rgb = &mut frame.rgb[span.start * 3..span.end * 3];
            if run[0] == 0 {
                rgb.as_chunks_mut::<3>().0.fill(background);
            } else {
                let (surface, face) = surface_of(run[0]);
                surfaces[surface].shade(face, x, y, &visibility.inverse_depth[span], rgb);
            }
            x += run.len();
        }
    }
}
