//! One rendered image with its instance ids and depth.

use serde::{Deserialize, Serialize};

use crate::Digest;

/// Width of the head camera's image, in pixels.
pub const FRAME_WIDTH: usize = 640;
/// Height of the head camera's image, in pixels.
pub const FRAME_HEIGHT: usize = 480;

/// An image of the head camera, row by row from the top left.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Frame {
    /// 8-bit RGB, `FRAME_WIDTH * FRAME_HEIGHT * 3` bytes, Set-of-Mark overlay included.
    pub rgb: Vec<u8>,
    /// Entity id of every pixel (index into the simulator's entity table; 0 is nothing).
    pub ids: Vec<u16>,
    /// Depth along the optical axis in millimetres; 0 is nothing.
    pub depth_mm: Vec<u16>,
}

/// Digests of a frame's raw buffers, never of encoded bytes.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct FrameDigests {
    /// Of the RGB bytes.
    pub rgb: Digest,
    /// Of the instance ids, little-endian.
    pub ids: Digest,
    /// Of the depth, little-endian.
    pub depth: Digest,
}

impl Frame {
    /// A black frame in which every entity id and depth is 0.
    pub fn new() -> Self {
        let pixels = FRAME_WIDTH * FRAME_HEIGHT;
        Self {
            rgb: vec![0; pixels * 3],
            ids: vec![0; pixels],
            depth_mm: vec![0; pixels],
        }
    }

    /// Digests of the three buffers.
    pub fn digests(&self) -> FrameDigests {
        let le = |values: &[u16]| {
            let bytes: Vec<u8> = values
                .iter()
                .flat_map(|value| value.to_le_bytes())
                .collect();
            Digest::of(&bytes)
        };
        FrameDigests {
            rgb: Digest::of(&self.rgb),
            ids: le(&self.ids),
            depth: le(&self.depth_mm),
        }
    }
}

impl Default for Frame {
    fn default() -> Self {
        Self::new()
    }
}
