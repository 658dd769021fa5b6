//! PNG files as pictures of a trace. Refuses what is not a picture of the head camera; never scales one.

use std::io::Cursor;

use png::{ColorType, Decoder, Transformations};
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame};

/// The pixels of a PNG file as 8-bit RGB; instance ids and depth are not in it and stay empty.
///
/// # Errors
/// What is wrong with it.
pub fn decode(bytes: &[u8]) -> Result<Frame, String> {
    let refused = |error: png::DecodingError| format!("no PNG picture that can be read ({error})");
    let mut decoder = Decoder::new(Cursor::new(bytes));
    decoder.set_transformations(Transformations::EXPAND | Transformations::STRIP_16);
    let mut reader = decoder.read_info().map_err(refused)?;
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    if (width, height) != (FRAME_WIDTH, FRAME_HEIGHT) {
        return Err(format!("a picture of {width} x {height} pixels instead of {FRAME_WIDTH} x {FRAME_HEIGHT}"));
    }
    let size = reader.output_buffer_size().ok_or("a picture too large for memory")?;
    let mut pixels = vec![0; size];
    let info = reader.next_frame(&mut pixels).map_err(refused)?;
    pixels.truncate(info.buffer_size());
    let rgb = match info.color_type {
        ColorType::Rgb => pixels,
        ColorType::Rgba => pixels.chunks_exact(4).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect(),
        ColorType::Grayscale => pixels.iter().flat_map(|grey| [*grey; 3]).collect(),
        ColorType::GrayscaleAlpha => pixels.chunks_exact(2).flat_map(|pixel| [pixel[0]; 3]).collect(),
        ColorType::Indexed => return Err("a picture whose palette cannot be read".to_owned()),
    };
    Ok(Frame { rgb, ids: Vec::new(), depth_mm: Vec::new() })
}
