//! Textures from PNG and JPEG bytes, as 8-bit sRGB. Their size is known before anything is decoded.

use std::{collections::BTreeMap, io::Cursor};

use png::{ColorType, Limits, Transformations};
use reel_world::mesh::{TEXELS_MAX, Texture};
use zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};
use zune_jpeg::JpegDecoder;

use crate::assets::{MeshError, SiblingFiles, limits::TEXTURE_SIDE_MAX};

/// The textures of a mesh, each of them once.
#[derive(Default)]
pub(crate) struct TextureSet {
    list: Vec<Texture>,
    /// By file, or by number inside of one.
    known: BTreeMap<String, u16>,
}

impl TextureSet {
    /// The texture of a file beside the mesh.
    pub fn file(&mut self, name: &str, beside: &dyn SiblingFiles) -> Result<u16, MeshError> {
        self.of(name, || {
            beside
                .read(name)
                .map_err(|reason| MeshError::texture(name, reason))
        })
    }

    /// The texture of that name, from bytes that are asked for where it is new.
    pub fn of(
        &mut self,
        name: &str,
        bytes: impl FnOnce() -> Result<Vec<u8>, MeshError>,
    ) -> Result<u16, MeshError> {
        if let Some(index) = self.known.get(name) {
            return Ok(*index);
        }
        let used: usize = self.list.iter().map(|texture| texture.rgb.len() / 3).sum();
        let texture = decode(&bytes()?, TEXELS_MAX - used)
            .map_err(|reason| MeshError::texture(name, reason))?;
        let index = u16::try_from(self.list.len())
            .map_err(|_| MeshError::Broken("it has too many textures".into()))?;
        self.list.push(texture);
        self.known.insert(name.to_owned(), index);
        Ok(index)
    }

    /// Returns all decoded textures, in the order of their indices.
    pub fn finish(self) -> Vec<Texture> {
        self.list
    }
}

fn decode(bytes: &[u8], texels_max: usize) -> Result<Texture, MeshError> {
    match bytes {
        [0x89, b'P', b'N', b'G', ..] => decode_png(bytes, texels_max),
        [0xff, 0xd8, ..] => decode_jpeg(bytes, texels_max),
        _ => Err(MeshError::Unsupported(
            "an image that is neither PNG nor JPEG".into(),
        )),
    }
}

fn check_size(width: u32, height: u32, texels_max: usize) -> Result<(), MeshError> {
    let side = width.max(height);
    if side > TEXTURE_SIDE_MAX {
        return Err(MeshError::too_large(
            "pixels on one side",
            side as usize,
            TEXTURE_SIDE_MAX as usize,
            "scale it down",
        ));
    }
    let texels = width as usize * height as usize;
    if texels > texels_max {
        let what = "pixels, with the other textures of the mesh";
        return Err(MeshError::too_large(
            what,
            texels + TEXELS_MAX - texels_max,
            TEXELS_MAX,
            "scale it down",
        ));
    }
    Ok(())
}

fn decode_png(bytes: &[u8], texels_max: usize) -> Result<Texture, MeshError> {
    let broken = |error: png::DecodingError| MeshError::Broken(format!("no sound PNG ({error})"));
    let mut decoder = png::Decoder::new_with_limits(
        Cursor::new(bytes),
        Limits {
            bytes: 4 * TEXELS_MAX * 4,
        },
    );
    decoder.set_transformations(Transformations::EXPAND | Transformations::STRIP_16);
    let mut reader = decoder.read_info().map_err(broken)?;
    let (width, height) = (reader.info().width, reader.info().height);
    check_size(width, height, texels_max)?;
    let size = reader
        .output_buffer_size()
        .ok_or_else(|| MeshError::Broken("no sound PNG (its size)".into()))?;
    let mut pixels = vec![0; size];
    let shown = reader.next_frame(&mut pixels).map_err(broken)?;
    pixels.truncate(shown.buffer_size());
    let rgb: Vec<u8> = match shown.color_type {
        ColorType::Rgb => pixels,
        ColorType::Rgba => pixels
            .as_chunks::<4>()
            .0
            .iter()
            .flat_map(|[r, g, b, _]| [*r, *g, *b])
            .collect(),
        ColorType::Grayscale => pixels.iter().flat_map(|grey| [*grey; 3]).collect(),
        ColorType::GrayscaleAlpha => pixels
            .as_chunks::<2>()
            .0
            .iter()
            .flat_map(|[grey, _]| [*grey; 3])
            .collect(),
        ColorType::Indexed => return Err(MeshError::Broken("no sound PNG (its palette)".into())),
    };
    Ok(Texture { width, height, rgb })
}

fn decode_jpeg(bytes: &[u8], texels_max: usize) -> Result<Texture, MeshError> {
    let broken = |what: String| MeshError::Broken(format!("no sound JPEG ({what})"));
    // Without vector instructions, so that every machine decodes the same.
    let options = DecoderOptions::new_safe()
        .jpeg_set_out_colorspace(ColorSpace::RGB)
        .set_strict_mode(true);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder
        .decode_headers()
        .map_err(|error| broken(format!("{error:?}")))?;
    let info = decoder
        .info()
        .ok_or_else(|| broken("it has no header".into()))?;
    let (width, height) = (u32::from(info.width), u32::from(info.height));
    check_size(width, height, texels_max)?;
    let rgb = decoder
        .decode()
        .map_err(|error| broken(format!("{error:?}")))?;
    Ok(Texture { width, height, rgb })
}
