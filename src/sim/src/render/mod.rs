//! Images: a software rasterizer with exact integer coverage, and Set-of-Mark overlays.
//!
//! Every image is a pure function of its arguments, to the bit, on every platform. Never decides
//! what is in a scene or what is worth a mark, and never encodes files.

mod block;
mod mesh;
mod outline;
mod overlay;
mod pattern;
mod raster;
mod shade;
pub mod text;
mod textured;

#[cfg(test)]
mod tests;

use std::{cell::RefCell, ops::Range};

use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame};

use crate::{
    geometry::{Camera, Part, Pose, dot},
    model::MeshModel,
};
use block::{Block, LANES, floor, on_vectors, to_integer};
use mesh::Tessellation;
use raster::{CameraFromPart, Visibility};
use shade::{ShadingFrame, Surface};
use textured::MeshSurface;

pub use overlay::{overlay, overlay_tinted};

/// A colour of linear light, from 0 to 1, as images have it.
pub fn srgb(linear: [f32; 3]) -> [u8; 3] {
    shade::LINEAR_TO_SRGB.encode(linear)
}

/// Parts or a mesh to draw with one pose and one entity id.
#[derive(Clone, Copy, Debug)]
pub struct Drawable<'a> {
    /// In the drawable's frame.
    pub parts: &'a [Part],
    /// In the drawable's frame.
    pub mesh: Option<&'a MeshModel>,
    /// Pose of the drawable in the scene frame (scene from drawable).
    pub pose: Pose,
    /// Written to the id buffer; 0 is nothing.
    pub entity: u16,
}

/// A surface that frames show, as triangles in the scene's frame.
#[derive(Clone, PartialEq, Debug)]
pub struct TriangleSurface {
    /// Instance id of its pixels.
    pub instance: u16,
    /// Corners of the triangles, in metres.
    pub corners: Vec<[f32; 3]>,
    /// Indices of the corners of each triangle, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Colour of each triangle without light, as linear RGB from 0 to 1: of a pattern its main
    /// colour, of a texture what its middle shows.
    pub colors: Vec<[f32; 3]>,
}

/// The surfaces that are drawn of a drawable: of each part, and of the mesh.
pub(crate) fn surfaces_of(drawable: &Drawable<'_>) -> Vec<TriangleSurface> {
    let mut surfaces = Vec::new();
    for part in drawable.parts {
        if let Some(shape) = Tessellation::of(&part.shape) {
            let pose = drawable.pose.then(&part.pose);
            let corners = shape.mesh.vertices.iter();
            let triangles = shape.mesh.triangles.iter();
            surfaces.push(TriangleSurface {
                instance: drawable.entity,
                corners: corners
                    .map(|corner| pose.apply(shape.place(corner)))
                    .collect(),
                triangles: triangles.map(|it| it.corners.map(u32::from)).collect(),
                colors: vec![part.color.map(shade::to_linear); shape.mesh.triangles.len()],
            });
        }
    }
    if let Some(model) = drawable.mesh {
        let corners = model.positions.iter();
        surfaces.push(TriangleSurface {
            instance: drawable.entity,
            corners: corners.map(|corner| drawable.pose.apply(*corner)).collect(),
            triangles: (model.mesh.data().triangles.iter())
                .map(|triangle| triangle.corners)
                .collect(),
            colors: (0..model.mesh.data().triangles.len())
                .map(|triangle| textured::middle_color(model, triangle))
                .collect(),
        });
    }
    surfaces
}

/// A number to draw.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct OverlayMark {
    /// The number that the label shows in the image.
    pub number: u32,
    /// The entity or the rectangle that the number marks.
    pub region: Region,
}

/// Where a mark goes.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Region {
    /// The pixels of an entity: its mask is tinted and outlined.
    Entity(u16),
    /// A rectangle in pixels: x0, y0, x1, y1 (inclusive, clipped to the image by the caller).
    Rectangle([u16; 4]),
}

/// How much of an image is drawn.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Detail {
    /// The complete frame: RGB, instance ids and depth.
    #[default]
    Full,
    /// Instance ids and depth; RGB stays black. Everything but the image itself
    /// is decided by these.
    Geometry,
}

/// Draws the drawables as the camera sees them. What has no finite pose or no extent is left out.
///
/// Surfaces nearer than 5 cm are cut off. Where two parts are equally far, the
/// earlier drawable is seen.
pub fn render(camera: &Camera, drawables: &[Drawable<'_>], detail: Detail) -> Frame {
    BUFFERS.with_borrow_mut(|buffers| draw(camera, drawables, detail, buffers))
}

/// What drawing a frame needs beside it.
struct Buffers {
    visibility: Visibility,
    /// How much of 256 lines take away from each pixel.
    lines: Vec<u8>,
}

thread_local! {
    /// Those of the frame before: to get and clear the memory anew takes longer than to fill it.
    static BUFFERS: RefCell<Buffers> = RefCell::new(Buffers {
        visibility: Visibility::new(),
        lines: vec![0; FRAME_WIDTH * FRAME_HEIGHT],
    });
}

fn draw(
    camera: &Camera,
    drawables: &[Drawable<'_>],
    detail: Detail,
    Buffers { visibility, lines }: &mut Buffers,
) -> Frame {
    let camera_axes = camera.axes();
    visibility.clear();
    let mut surfaces = Surfaces::default();
    let camera_from = |pose: &Pose| {
        let columns =
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| pose.rotate(axis));
        CameraFromPart {
            rows: camera_axes.map(|axis| columns.map(|column| dot(axis, column))),
            translation: camera.to_camera(pose.position),
        }
    };
    for drawable in drawables {
        for part in drawable.parts {
            let Some(tessellation) = Tessellation::of(&part.shape) else {
                continue;
            };
            let pose = drawable.pose.then(&part.pose);
            let camera_from_part = camera_from(&pose);
            if camera_from_part.sees(tessellation.bound) {
                visibility.draw(
                    &tessellation,
                    &camera_from_part,
                    code_of(surfaces.parts.len()),
                );
                surfaces.parts.push(Surface::new(
                    drawable.entity,
                    part,
                    &pose,
                    &camera_from_part,
                ));
            }
        }
        if let Some(model) = drawable.mesh {
            let camera_from_part = camera_from(&drawable.pose);
            if camera_from_part.sees(model.bound) {
                let first = surfaces.next_mesh;
                surfaces.next_mesh += visibility.draw_mesh(model, &camera_from_part, first);
                let place = ShadingFrame::new(&drawable.pose, &camera_from_part);
                surfaces
                    .meshes
                    .push(MeshSurface::new(drawable.entity, first, model, place));
            }
        }
    }
    let mut frame = Frame::new();
    on_vectors(
        #[inline(always)]
        || identify(visibility, &surfaces, &mut frame),
    );
    if detail == Detail::Geometry {
        return frame;
    }
    on_vectors(
        #[inline(always)]
        || color(&camera_axes, visibility, &surfaces, &mut frame),
    );
    outline::darken_contacts(visibility, &surfaces, &mut frame);
    outline::draw_edges(visibility, lines, &mut frame);
    frame
}

/// All that may be visible.
struct Surfaces<'a> {
    /// Eight codes each, from 1.
    parts: Vec<Surface>,
    /// As many codes as triangles, from [`FIRST_MESH`].
    meshes: Vec<MeshSurface<'a>>,
    /// Code of the first triangle of the next mesh.
    next_mesh: u32,
}

/// What a code other than 0 stands for: a face of a part or a triangle of a mesh.
enum VisibleFace<'s, 'a> {
    Part(&'s Surface, u8),
    Mesh(&'s MeshSurface<'a>, usize),
}

impl Default for Surfaces<'_> {
    fn default() -> Self {
        Self {
            parts: Vec::new(),
            meshes: Vec::new(),
            next_mesh: FIRST_MESH,
        }
    }
}

impl<'a> Surfaces<'a> {
    fn at(&self, code: u32) -> VisibleFace<'_, 'a> {
        if code < FIRST_MESH {
            let (surface, face) = surface_of(code);
            return VisibleFace::Part(&self.parts[surface], face);
        }
        let mesh = &self.meshes[self.meshes.partition_point(|mesh| mesh.first <= code) - 1];
        VisibleFace::Mesh(mesh, (code - mesh.first) as usize)
    }

    fn entity(&self, code: u32) -> u16 {
        match self.at(code) {
            VisibleFace::Part(surface, _) => surface.entity,
            VisibleFace::Mesh(mesh, _) => mesh.entity,
        }
    }
}

/// From here on codes of the visibility buffer are triangles of meshes.
const FIRST_MESH: u32 = 1 << 31;

/// Faces per part in the codes of the visibility buffer.
const FACES: u32 = 8;

/// Code of the first face of a surface; 0 is nothing.
fn code_of(surface: usize) -> u32 {
    surface as u32 * FACES + 1
}

/// Surface and face of a part's code.
fn surface_of(code: u32) -> (usize, u8) {
    (((code - 1) / FACES) as usize, ((code - 1) % FACES) as u8)
}

/// Fills ids and depth from what is visible.
#[inline(always)]
fn identify(visibility: &Visibility, surfaces: &Surfaces<'_>, frame: &mut Frame) {
    for (depth_mm, &inverse) in frame.depth_mm.iter_mut().zip(&visibility.inverse_depth) {
        let rounded = 1000.0 / inverse + 0.5;
        let rounded = if rounded < 65_535.0 {
            rounded
        } else {
            65_535.0
        };
        *depth_mm = if inverse > 0.0 {
            to_integer(floor(rounded)) as u16
        } else {
            0
        };
    }
    for_runs(
        &visibility.codes,
        #[inline(always)]
        |span, code| {
            if code != 0 {
                frame.ids[span].fill(surfaces.entity(code));
            }
        },
    );
}

/// Calls with each longest stretch of equal codes, from the first on.
#[inline(always)]
pub(crate) fn for_runs<T: Copy + PartialEq>(codes: &[T], mut call: impl FnMut(Range<usize>, T)) {
    let mut start = 0;
    while let Some(&code) = codes.get(start) {
        let rest = &codes[start..];
        let alike = rest.as_chunks::<LANES>().0.iter();
        let groups = alike.take_while(|group| **group == [code; LANES]).count();
        let last = rest[groups * LANES..].iter();
        let last = last.take_while(|other| **other == code).count();
        let end = start + groups * LANES + last;
        call(start..end, code);
        start = end;
    }
}

/// Fills RGB from what is visible, run by run of one face.
#[inline(always)]
fn color(
    camera_axes: &[[f32; 3]; 3],
    visibility: &Visibility,
    surfaces: &Surfaces<'_>,
    frame: &mut Frame,
) {
    let mut block = Block::new();
    for y in 0..FRAME_HEIGHT {
        let background = shade::background_row(camera_axes, y);
        let row = y * FRAME_WIDTH;
        for_runs(
            &visibility.codes[row..row + FRAME_WIDTH],
            #[inline(always)]
            |run, code| {
                let x = run.start;
                let span = row + run.start..row + run.end;
                let rgb = &mut frame.rgb[span.start * 3..span.end * 3];
                if code == 0 {
                    rgb.as_chunks_mut::<3>().0.fill(background);
                    return;
                }
                let inverse_depth = &visibility.inverse_depth[span];
                match surfaces.at(code) {
                    VisibleFace::Part(surface, face) => {
                        surface.shade(&mut block, face, [x, y], inverse_depth, rgb);
                    }
                    VisibleFace::Mesh(mesh, triangle) => {
                        mesh.shade(triangle, x, y, inverse_depth, rgb);
                    }
                }
            },
        );
    }
}
