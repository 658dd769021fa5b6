//! Pictures as lossless WebP (in traces) and PNG (for people and policies).

use image_webp::{ColorType, WebPDecoder, WebPEncoder};
use std::io::Cursor;

/// Encodes 8-bit RGB, row by row from the top left, without loss.
///
/// # Panics
/// When `rgb` is not `width * height * 3` bytes long or a side is 0 or above 16384: a programmer's error.
pub fn encode_webp(rgb: &[u8], width: u32, height: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let encoder = WebPEncoder::new(&mut bytes);
    encoder.encode(rgb, width, height, ColorType::Rgb8).expect("the picture has the size it says and memory does not fail");
    bytes
}

/// Decodes a WebP picture to 8-bit RGB with its width and height; none when it is no such picture or has more
/// than `pixels_max` pixels.
pub fn decode_webp(bytes: &[u8], pixels_max: u32) -> Option<(Vec<u8>, u32, u32)> {
    let mut decoder = WebPDecoder::new(Cursor::new(bytes)).ok()?;
    let (width, height) = decoder.dimensions();
    let fits = width.checked_mul(height).is_some_and(|pixels| pixels <= pixels_max);
    if !fits || decoder.has_alpha() || decoder.is_animated() {
        return None;
    }
    let mut rgb = vec![0; decoder.output_buffer_size()?];
    decoder.read_image(&mut rgb).ok()?;
    Some((rgb, width, height))
}

/// Encodes 8-bit RGB as PNG, quickly rather than small.
///
/// # Panics
/// When `rgb` is not `width * height * 3` bytes long: a programmer's error.
pub fn encode_png(rgb: &[u8], width: u32, height: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().expect("writing to memory does not fail");
    writer.write_image_data(rgb).expect("the picture has the size it says");
    writer.finish().expect("writing to memory does not fail");
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lossless() {
        let rgb: Vec<u8> = (0..48 * 32 * 3).map(|i| (i * i / 7 % 251) as u8).collect();
        let bytes = encode_webp(&rgb, 48, 32);
        assert_eq!(decode_webp(&bytes, 48 * 32), Some((rgb, 48, 32)));
        assert_eq!(decode_webp(&bytes, 48 * 32 - 1), None);
        assert_eq!(decode_webp(&bytes[..bytes.len() / 2], 48 * 32), None);
    }
}
