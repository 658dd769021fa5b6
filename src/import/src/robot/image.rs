//! Images of a robot's camera: files as they came, and their pixels at the size that a trace
//! holds. An image of another shape stands in the middle between black bars, as large as it fits.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use fast_image_resize::{
    Resizer,
    images::{TypedImage, TypedImageRef},
    pixels::U8x3,
};
use reel_trace::{decode_png, encode_png, robot::CameraImage};
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame};
use serde_json::Value;
use zune_jpeg::{
    JpegDecoder,
    zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions},
};

/// Most pixels of an image.
const PIXELS_MAX: usize = 64 << 20;

/// The image in a message: a file in JPEG or PNG, or raw pixels beside their size, which
/// become a PNG file.
///
/// # Errors
/// What is wrong with it.
pub(crate) fn of_message(message: &Value, pointer: &str) -> Result<CameraImage, String> {
    let text = message
        .pointer(pointer)
        .and_then(Value::as_str)
        .ok_or_else(|| format!("no bytes at '{pointer}'"))?;
    let data = STANDARD
        .decode(text)
        .map_err(|error| format!("no bytes at '{pointer}' ({error})"))?;
    if let Some(format) = format(&data) {
        return Ok(CameraImage {
            format: format.to_owned(),
            data,
        });
    }
    let beside = pointer
        .rsplit_once('/')
        .and_then(|(parent, _)| message.pointer(parent));
    let size = |key: &str| {
        usize::try_from(beside?.get(key)?.as_u64()?)
            .ok()
            .filter(|side| (1..=16_384).contains(side))
    };
    let (Some(width), Some(height), Some(encoding)) = (
        size("width"),
        size("height"),
        beside.and_then(|beside| beside.get("encoding")?.as_str()),
    ) else {
        return Err("neither a JPEG nor a PNG file, and no raw image either".to_owned());
    };
    let channels: &[usize] = match encoding {
        "rgb8" | "8UC3" => &[3, 0, 1, 2],
        "bgr8" => &[3, 2, 1, 0],
        "rgba8" => &[4, 0, 1, 2],
        "bgra8" => &[4, 2, 1, 0],
        "mono8" | "8UC1" => &[1, 0, 0, 0],
        other => {
            return Err(format!(
                "raw pixels in {other}; rgb8, bgr8, rgba8, bgra8 and mono8 are read"
            ));
        }
    };
    let row = size_of_row(beside, width * channels[0]);
    if width * height > PIXELS_MAX || data.len() < row * (height - 1) + width * channels[0] {
        return Err(format!(
            "{} bytes for {width} x {height} pixels in {encoding}",
            data.len()
        ));
    }
    let pixels = data
        .chunks(row)
        .take(height)
        .flat_map(|row| row[..width * channels[0]].chunks_exact(channels[0]));
    let rgb: Vec<u8> = pixels
        .flat_map(|pixel| channels[1..].iter().map(|channel| pixel[*channel]))
        .collect();
    Ok(CameraImage {
        format: "png".to_owned(),
        data: encode_png(&rgb, width as u32, height as u32),
    })
}

/// Bytes from one row to the next.
fn size_of_row(beside: Option<&Value>, least: usize) -> usize {
    let told = beside
        .and_then(|beside| beside.get("step")?.as_u64())
        .and_then(|step| usize::try_from(step).ok());
    told.filter(|step| (least..=PIXELS_MAX).contains(step))
        .unwrap_or(least)
}

/// An image file in JPEG or PNG, of any size, as it came, and as a trace holds it: at 640 x
/// 480, one of another shape between black bars. Pixels have no digests of instances and depth:
/// no camera tells them.
///
/// # Errors
/// What is wrong with it.
pub fn camera_image(data: Vec<u8>) -> Result<(CameraImage, Frame), String> {
    let format = format(&data).ok_or("it is neither a JPEG nor a PNG file")?;
    let image = CameraImage {
        format: format.to_owned(),
        data,
    };
    let (frame, _) = frame(&image)?;
    Ok((image, frame))
}

/// The image as a trace holds it, and whether that is all there is to it.
///
/// # Errors
/// What is wrong with it.
pub(crate) fn frame(image: &CameraImage) -> Result<(Frame, bool), String> {
    let (rgb, width, height) = if image.format == "png" {
        png(&image.data)?
    } else {
        jpeg(&image.data)?
    };
    let fits = (width, height) == (FRAME_WIDTH, FRAME_HEIGHT);
    let rgb = if fits {
        rgb
    } else {
        fitted(rgb, width, height)?
    };
    Ok((Frame::of_rgb(rgb), fits && image.format == "png"))
}

fn format(data: &[u8]) -> Option<&'static str> {
    match data {
        [0xff, 0xd8, 0xff, ..] => Some("jpeg"),
        [0x89, b'P', b'N', b'G', ..] => Some("png"),
        _ => None,
    }
}

fn png(data: &[u8]) -> Result<(Vec<u8>, usize, usize), String> {
    let side = |from: usize| Some(u32::from_be_bytes(*data.get(from..)?.first_chunk()?) as usize);
    let (Some(width), Some(height)) = (side(16), side(20)) else {
        return Err("a PNG file without a head".to_owned());
    };
    check(width, height)?;
    Ok((decode_png(data, (width, height))?, width, height))
}

fn jpeg(data: &[u8]) -> Result<(Vec<u8>, usize, usize), String> {
    let refused = |error| format!("not a readable JPEG image ({error:?})");
    let options = DecoderOptions::default().jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(data), options);
    decoder.decode_headers().map_err(refused)?;
    let info = decoder.info().ok_or("a JPEG file without a head")?;
    let (width, height) = (usize::from(info.width), usize::from(info.height));
    check(width, height)?;
    let rgb = decoder.decode().map_err(refused)?;
    if rgb.len() != width * height * 3 {
        return Err("a JPEG image that is not in colours".to_owned());
    }
    Ok((rgb, width, height))
}

fn check(width: usize, height: usize) -> Result<(), String> {
    let pixels = width.saturating_mul(height);
    if pixels == 0 || pixels > PIXELS_MAX {
        Err(format!("an image of {width} x {height} pixels"))
    } else {
        Ok(())
    }
}

/// As large as it fits, in the middle.
fn fitted(rgb: Vec<u8>, width: usize, height: usize) -> Result<Vec<u8>, String> {
    // Compared without a fraction: which side meets the border first.
    let (inner_width, inner_height) = match width * FRAME_HEIGHT >= height * FRAME_WIDTH {
        true => (FRAME_WIDTH, (height * FRAME_WIDTH / width).max(1)),
        false => ((width * FRAME_HEIGHT / height).max(1), FRAME_HEIGHT),
    };
    let refused = |error: &dyn std::fmt::Display| format!("it cannot be scaled ({error})");
    let source = TypedImageRef::<U8x3>::from_buffer(width as u32, height as u32, &rgb)
        .map_err(|error| refused(&error))?;
    let mut scaled = vec![0; inner_width * inner_height * 3];
    let mut target =
        TypedImage::<U8x3>::from_buffer(inner_width as u32, inner_height as u32, &mut scaled)
            .map_err(|error| refused(&error))?;
    // `resize` compiles every type of pixels, and LLVM writes the code of f32 differently in every
    // build.
    Resizer::new()
        .resize_typed(&source, &mut target, None)
        .map_err(|error| refused(&error))?;
    let (left, top) = (
        (FRAME_WIDTH - inner_width) / 2,
        (FRAME_HEIGHT - inner_height) / 2,
    );
    let mut frame = vec![0; FRAME_WIDTH * FRAME_HEIGHT * 3];
    for (row, pixels) in scaled.chunks_exact(inner_width * 3).enumerate() {
        let at = ((top + row) * FRAME_WIDTH + left) * 3;
        frame[at..at + pixels.len()].copy_from_slice(pixels);
    }
    Ok(frame)
}
