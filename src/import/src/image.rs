//! PNG files as images of a trace. Refuses what is not an image of the head
//! camera; never scales one.

use reel_trace::decode_png;
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame};

/// The pixels of a PNG file as 8-bit RGB; instance ids and depth are not in it and stay empty.
///
/// # Errors
/// What is wrong with it.
pub(crate) fn decode(bytes: &[u8]) -> Result<Frame, String> {
    decode_png(bytes, (FRAME_WIDTH, FRAME_HEIGHT)).map(Frame::of_rgb)
}
