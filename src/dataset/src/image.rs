//! Images on disk: resized to a pixel budget, encoded, named by the digest of their bytes, each
//! written once. Owns sizes and encodings; where pixels come from is the caller's.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::{
        Mutex,
        atomic::{AtomicU64, Ordering},
    },
};

use fast_image_resize::{
    Resizer,
    images::{TypedImage, TypedImageRef},
    pixels::U8x3,
};
use reel_world::Digest;
use serde::{Deserialize, Serialize};

use crate::{DatasetError, ImageId};

/// The most pixels of an image in training (docs/spec.md#sft-data).
pub const PIXELS_MAX: u32 = 100_352;
/// The fewest pixels of an image in training; smaller images are enlarged.
pub const PIXELS_MIN: u32 = 784;

/// How images are encoded.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Encoding {
    /// PNG without loss, which is the default.
    #[default]
    Png,
    /// WebP without loss, in smaller files than PNG.
    Webp,
    /// With loss, from 1 to 100.
    Jpeg {
        /// Quality from 1 to 100, where 100 is best.
        quality: u8,
    },
}

impl Encoding {
    fn extension(self) -> &'static str {
        match self {
            Encoding::Png => "png",
            Encoding::Webp => "webp",
            Encoding::Jpeg { .. } => "jpg",
        }
    }

    /// As data URLs name it.
    pub fn mime(self) -> &'static str {
        match self {
            Encoding::Png => "image/png",
            Encoding::Webp => "image/webp",
            Encoding::Jpeg { .. } => "image/jpeg",
        }
    }
}

/// What is made of an image.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
pub struct ImageOptions {
    /// How it is encoded.
    pub encoding: Encoding,
    /// The most pixels; none keeps every image as it is.
    pub pixels_max: Option<u32>,
    /// Sides are multiples of this many pixels where an image is resized: 28 for Qwen2.5-VL, 32
    /// for Qwen3-VL, else 1.
    pub side_multiple: u32,
}

impl Default for ImageOptions {
    fn default() -> Self {
        Self {
            encoding: Encoding::default(),
            pixels_max: Some(PIXELS_MAX),
            side_multiple: 1,
        }
    }
}

impl ImageOptions {
    /// The width and height that an image gets: its own where it is within the budget, else the
    /// largest of its aspect ratio within it, at least [`PIXELS_MIN`] pixels.
    pub fn size(&self, width: u32, height: u32) -> (u32, u32) {
        let Some(most) = self.pixels_max else {
            return (width, height);
        };
        let (pixels, multiple) = (
            f64::from(width) * f64::from(height),
            f64::from(self.side_multiple.max(1)),
        );
        let least = f64::from(PIXELS_MIN.min(most));
        let most = f64::from(most);
        let whole = |side: u32| side.is_multiple_of(self.side_multiple.max(1));
        if pixels <= most && pixels >= least && (whole(width) && whole(height)) {
            return (width, height);
        }
        let fitted = |scale: f64, round: fn(f64) -> f64| {
            let side = |side: u32| {
                (round(f64::from(side) * scale / multiple) * multiple).max(multiple) as u32
            };
            (side(width), side(height))
        };
        if pixels < least {
            fitted((least / pixels).sqrt(), f64::ceil)
        } else {
            fitted((most / pixels).sqrt().min(1.0), f64::floor)
        }
    }
}

/// An image on disk.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct StoredImage {
    /// From the dataset's folder, with `/`: `images/ab/<64 digits>.png`.
    pub path: String,
    /// Width of the image as written, in pixels.
    pub width: u32,
    /// Height of the image as written, in pixels.
    pub height: u32,
    /// Size of the file.
    pub bytes: u64,
}

/// The images of a dataset. May be used from several threads; what is written does not
/// depend on their order.
pub struct ImageStore {
    root: PathBuf,
    options: ImageOptions,
    written: Mutex<BTreeMap<ImageId, StoredImage>>,
    parts: AtomicU64,
}

impl ImageStore {
    /// An empty store that writes its images under `<root>/images`.
    pub fn new(root: &Path, options: ImageOptions) -> Self {
        Self {
            root: root.to_owned(),
            options,
            written: Mutex::default(),
            parts: AtomicU64::new(0),
        }
    }

    /// How they are made.
    pub fn options(&self) -> &ImageOptions {
        &self.options
    }

    /// An image that was put before.
    pub fn get(&self, image: &ImageId) -> Option<StoredImage> {
        self.written().get(image).cloned()
    }

    /// Takes over an image that an earlier run put; false where its file is not as it was.
    pub fn reuse(&self, image: ImageId, frame: &StoredImage) -> bool {
        let there =
            fs::metadata(self.root.join(&frame.path)).is_ok_and(|file| file.len() == frame.bytes);
        if there {
            self.written().insert(image, frame.clone());
        }
        there
    }

    /// Removes what a killed run left of the images that it was writing. Nobody else may write
    /// here.
    ///
    /// # Errors
    /// When a folder cannot be read, or a file not be removed.
    pub fn sweep(&self) -> Result<(), DatasetError> {
        let images = self.root.join("images");
        let folders = match fs::read_dir(&images) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
            folders => folders.map_err(DatasetError::io(&images))?,
        };
        for folder in folders {
            let folder = folder.map_err(DatasetError::io(&images))?.path();
            for file in fs::read_dir(&folder).map_err(DatasetError::io(&folder))? {
                let file = file.map_err(DatasetError::io(&folder))?.path();
                if file
                    .extension()
                    .is_some_and(|extension| extension == "part")
                {
                    fs::remove_file(&file).map_err(DatasetError::io(&file))?;
                }
            }
        }
        Ok(())
    }

    /// How many images were put.
    pub fn count(&self) -> usize {
        self.written().len()
    }

    /// Resizes, encodes and writes an image (8-bit RGB, row by row), unless it was before.
    ///
    /// # Errors
    /// When the pixels are not what the size says, or the file cannot be written.
    pub fn put(
        &self,
        image: ImageId,
        rgb: &[u8],
        width: u32,
        height: u32,
    ) -> Result<StoredImage, DatasetError> {
        if let Some(frame) = self.get(&image) {
            return Ok(frame);
        }
        let (bytes, width, height) = self.options.encode(image, rgb, width, height)?;
        let name = Digest::of(&bytes).to_string();
        let path = format!(
            "images/{}/{name}.{}",
            &name[..2],
            self.options.encoding.extension()
        );
        let file = self.root.join(&path);
        if !file.exists() {
            let folder = self.root.join("images").join(&name[..2]);
            fs::create_dir_all(&folder).map_err(DatasetError::io(&folder))?;
            // Threads may write the same image: each its own file, and any of
            // them is the image.
            let part = folder.join(format!(
                "{}.part",
                self.parts.fetch_add(1, Ordering::Relaxed)
            ));
            fs::write(&part, &bytes)
                .and_then(|()| fs::rename(&part, &file))
                .map_err(DatasetError::io(&file))?;
        }
        let frame = StoredImage {
            path,
            width,
            height,
            bytes: bytes.len() as u64,
        };
        self.written().insert(image, frame.clone());
        Ok(frame)
    }

    /// The file of an image.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn bytes(&self, frame: &StoredImage) -> Result<Vec<u8>, DatasetError> {
        let file = self.root.join(&frame.path);
        fs::read(&file).map_err(DatasetError::io(&file))
    }

    fn written(&self) -> std::sync::MutexGuard<'_, BTreeMap<ImageId, StoredImage>> {
        self.written
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

impl ImageOptions {
    /// The encoded image with its width and height.
    ///
    /// # Errors
    /// When the pixels are not what the size says.
    pub fn encode(
        &self,
        image: ImageId,
        rgb: &[u8],
        width: u32,
        height: u32,
    ) -> Result<(Vec<u8>, u32, u32), DatasetError> {
        if width == 0 || height == 0 || rgb.len() as u64 != 3 * u64::from(width) * u64::from(height)
        {
            return Err(DatasetError::Pixels {
                image,
                found: rgb.len(),
                width,
                height,
            });
        }
        let refused = |reason: String| DatasetError::Encode { image, reason };
        let (new_width, new_height) = self.size(width, height);
        let resized;
        let pixels = if (new_width, new_height) == (width, height) {
            rgb
        } else {
            resized = resize(rgb, (width, height), (new_width, new_height)).map_err(refused)?;
            &resized
        };
        let bytes = match self.encoding {
            Encoding::Png => png(pixels, new_width, new_height),
            Encoding::Webp => webp(pixels, new_width, new_height),
            Encoding::Jpeg { quality } => jpeg(pixels, new_width, new_height, quality),
        };
        Ok((bytes.map_err(refused)?, new_width, new_height))
    }
}

/// An image of 8-bit RGB in another size, filtered by convolution; sizes are width and height in pixels.
///
/// # Errors
/// When the pixels do not fill the size, or a side is 0.
pub fn resize(rgb: &[u8], from: (u32, u32), to: (u32, u32)) -> Result<Vec<u8>, String> {
    let source = TypedImageRef::<U8x3>::from_buffer(from.0, from.1, rgb)
        .map_err(|error| error.to_string())?;
    let mut resized = vec![0; to.0 as usize * to.1 as usize * 3];
    let mut target = TypedImage::<U8x3>::from_buffer(to.0, to.1, &mut resized)
        .map_err(|error| error.to_string())?;
    // As `resize`, without the code of the other types of pixels, which differs from build to
    // build.
    Resizer::new()
        .resize_typed(&source, &mut target, None)
        .map_err(|error| error.to_string())?;
    Ok(resized)
}

fn png(rgb: &[u8], width: u32, height: u32) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_compression(png::Compression::Fast);
    let written = encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(rgb).and_then(|()| writer.finish()));
    written.map(|()| bytes).map_err(|error| error.to_string())
}

fn webp(rgb: &[u8], width: u32, height: u32) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let encoder = image_webp::WebPEncoder::new(&mut bytes);
    encoder
        .encode(rgb, width, height, image_webp::ColorType::Rgb8)
        .map_err(|error| error.to_string())?;
    Ok(bytes)
}

fn jpeg(rgb: &[u8], width: u32, height: u32, quality: u8) -> Result<Vec<u8>, String> {
    let side = |side: u32| {
        u16::try_from(side).map_err(|_| format!("a side of {side} pixels is more than JPEG holds"))
    };
    let mut bytes = Vec::new();
    let encoder = jpeg_encoder::Encoder::new(&mut bytes, quality.clamp(1, 100));
    encoder
        .encode(
            rgb,
            side(width)?,
            side(height)?,
            jpeg_encoder::ColorType::Rgb,
        )
        .map_err(|error| error.to_string())?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(width: u32, height: u32) -> Vec<u8> {
        (0..width * height * 3)
            .map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8)
            .collect()
    }

    #[test]
    fn sizes() {
        let size = |side_multiple, width, height| {
            ImageOptions {
                side_multiple,
                ..Default::default()
            }
            .size(width, height)
        };
        assert_eq!(size(1, 640, 480), (365, 274));
        assert_eq!(size(28, 640, 480), (364, 252));
        assert_eq!(size(32, 640, 480), (352, 256));
        assert_eq!(size(1, 320, 240), (320, 240));
        assert_eq!(size(28, 300, 200), (280, 196));
        assert_eq!(size(1, 10, 10), (28, 28));
        assert_eq!(
            ImageOptions {
                pixels_max: None,
                ..Default::default()
            }
            .size(640, 480),
            (640, 480)
        );
        for (width, height) in [(640, 480), (4000, 20), (1, 1), (317, 316), (9999, 9999)] {
            let (w, h) = size(28, width, height);
            assert!(w % 28 == 0 && h % 28 == 0 && w > 0 && h > 0);
        }
    }

    #[test]
    fn unresized_without_loss() {
        let rgb = noise(64, 48);
        let image = Digest::of(&rgb);
        let encode = |encoding| {
            ImageOptions {
                encoding,
                pixels_max: None,
                side_multiple: 1,
            }
            .encode(image, &rgb, 64, 48)
            .unwrap()
            .0
        };
        let png = encode(Encoding::Png);
        let mut reader = png::Decoder::new(std::io::Cursor::new(&png))
            .read_info()
            .unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        assert_eq!(pixels, rgb);
        let webp = encode(Encoding::Webp);
        let mut decoder = image_webp::WebPDecoder::new(std::io::Cursor::new(&webp)).unwrap();
        let mut pixels = vec![0; decoder.output_buffer_size().unwrap()];
        decoder.read_image(&mut pixels).unwrap();
        assert_eq!(pixels, rgb);
        assert_eq!(encode(Encoding::Jpeg { quality: 90 })[..2], [0xff, 0xd8]);
        assert!(matches!(
            ImageOptions::default().encode(image, &rgb[1..], 64, 48),
            Err(DatasetError::Pixels { .. })
        ));
    }

    #[test]
    fn written_once_and_resized() {
        let folder = tempfile::tempdir().unwrap();
        let frames = ImageStore::new(folder.path(), ImageOptions::default());
        let grey = vec![77; 640 * 480 * 3];
        let first = frames.put(Digest::of(b"1"), &grey, 640, 480).unwrap();
        let second = frames.put(Digest::of(b"2"), &grey, 640, 480).unwrap();
        assert_eq!((&first, first.width, first.height), (&second, 365, 274));
        assert_eq!(frames.count(), 2);
        let bytes = frames.bytes(&first).unwrap();
        assert!(first.path.ends_with(&format!("{}.png", Digest::of(&bytes))));
        let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes))
            .read_info()
            .unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        assert!(
            pixels.iter().all(|value| *value == 77),
            "a grey image stays grey"
        );
        assert_eq!(
            fs::read_dir(folder.path().join("images")).unwrap().count(),
            1
        );
    }
}
