//! Pictures: a software rasterizer with exact integer coverage, and Set-of-Mark overlays.

use reel_world::Frame;

use crate::geometry::{Camera, Part, Pose};

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

/// Draws the drawables as the camera sees them.
pub fn render(camera: &Camera, drawables: &[Drawable<'_>]) -> Frame {
    let _ = (camera, drawables);
    unimplemented!("by the render helper")
}

/// Draws numbered Set-of-Mark overlays into the RGB of a frame; ids and depth stay.
pub fn overlay(frame: &mut Frame, marks: &[Mark]) {
    let _ = (frame, marks);
    unimplemented!("by the render helper")
}
