//! What an image's file says of itself: format, size, whether it is whole. Reads
//! headers; never decodes pixels.

use std::fmt;

use serde::Serialize;

/// What the header says.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
pub struct ImageHeader {
    /// Format of the file, recognised by its first bytes.
    pub format: ImageFormat,
    /// Width in pixels, as the header says, at least 1.
    pub width: u32,
    /// Height in pixels, as the header says, at least 1.
    pub height: u32,
}

/// Formats that trainers read.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
pub enum ImageFormat {
    /// PNG, recognised by its signature of eight bytes.
    Png,
    /// JPEG, recognised by its first bytes `ff d8`.
    Jpeg,
    /// WebP, recognised by `RIFF` and `WEBP` in its header.
    WebP,
}

/// Why an image cannot be used.
#[derive(thiserror::Error, Clone, Copy, PartialEq, Eq, Debug)]
pub enum ImageError {
    /// There are no bytes to read.
    #[error("the image is empty")]
    Empty,
    /// Another format, or none.
    #[error("the image is not PNG, JPEG or WebP")]
    Unknown,
    /// The header names no size.
    #[error("the header of the image is broken")]
    Header,
    /// It stops before its end.
    #[error("the image is cut off")]
    CutOff,
}

impl ImageHeader {
    /// Reads a whole image's header and looks for its end.
    ///
    /// # Errors
    /// A [`ImageError`] for what a decoder would refuse; damage inside the pixels is not seen.
    pub fn of(bytes: &[u8]) -> Result<Self, ImageError> {
        match bytes {
            [] => Err(ImageError::Empty),
            [0x89, b'P', b'N', b'G', 0x0d, 0x0a, 0x1a, 0x0a, ..] => png(bytes),
            [0xff, 0xd8, ..] => jpeg(bytes),
            [
                b'R',
                b'I',
                b'F',
                b'F',
                _,
                _,
                _,
                _,
                b'W',
                b'E',
                b'B',
                b'P',
                ..,
            ] => webp(bytes),
            _ => Err(ImageError::Unknown),
        }
    }

    fn new(format: ImageFormat, width: u32, height: u32) -> Result<Self, ImageError> {
        if width == 0 || height == 0 {
            Err(ImageError::Header)
        } else {
            Ok(Self {
                format,
                width,
                height,
            })
        }
    }

    /// Number of pixels in the image: width times height.
    pub fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }
}

impl fmt::Display for ImageHeader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let format = match self.format {
            ImageFormat::Png => "PNG",
            ImageFormat::Jpeg => "JPEG",
            ImageFormat::WebP => "WebP",
        };
        write!(f, "{}x{} {format}", self.width, self.height)
    }
}

fn png(bytes: &[u8]) -> Result<ImageHeader, ImageError> {
    let header = bytes.get(..24).ok_or(ImageError::CutOff)?;
    if &header[12..16] != b"IHDR" {
        return Err(ImageError::Header);
    }
    let image = ImageHeader::new(
        ImageFormat::Png,
        big_u32(&header[16..20]),
        big_u32(&header[20..24]),
    )?;
    // Chunks of length, type, data, checksum up to IEND.
    let mut at = 8;
    loop {
        let head = bytes.get(at..at + 8).ok_or(ImageError::CutOff)?;
        let length = usize::try_from(big_u32(&head[..4])).unwrap_or(usize::MAX);
        let end = at.saturating_add(length).saturating_add(12);
        if end > bytes.len() {
            return Err(ImageError::CutOff);
        }
        if &head[4..] == b"IEND" {
            return Ok(image);
        }
        at = end;
    }
}

fn jpeg(bytes: &[u8]) -> Result<ImageHeader, ImageError> {
    let mut at = 2;
    let image = loop {
        let marker = bytes.get(at..at + 2).ok_or(ImageError::CutOff)?;
        if marker[0] != 0xff {
            return Err(ImageError::Header);
        }
        let kind = marker[1];
        if kind == 0xff {
            at += 1;
            continue;
        }
        if matches!(kind, 0x01 | 0xd0..=0xd7) {
            at += 2;
            continue;
        }
        let length = bytes.get(at + 2..at + 4).ok_or(ImageError::CutOff)?;
        let length = usize::from(u16::from_be_bytes([length[0], length[1]]));
        let is_frame = matches!(kind, 0xc0..=0xcf) && !matches!(kind, 0xc4 | 0xc8 | 0xcc);
        if is_frame {
            let size = bytes.get(at + 5..at + 9).ok_or(ImageError::CutOff)?;
            let [height, width] = [[size[0], size[1]], [size[2], size[3]]]
                .map(|it| u32::from(u16::from_be_bytes(it)));
            break ImageHeader::new(ImageFormat::Jpeg, width, height)?;
        }
        if kind == 0xda || length < 2 {
            return Err(ImageError::Header);
        }
        at += 2 + length;
    };
    // Some writers pad with a few bytes after the end marker.
    let tail = &bytes[bytes.len().saturating_sub(64)..];
    if tail.windows(2).any(|pair| pair == [0xff, 0xd9]) {
        Ok(image)
    } else {
        Err(ImageError::CutOff)
    }
}

fn webp(bytes: &[u8]) -> Result<ImageHeader, ImageError> {
    let length = u32::from_le_bytes([bytes[4], bytes[5], bytes[6], bytes[7]]);
    if usize::try_from(length)
        .unwrap_or(usize::MAX)
        .saturating_add(8)
        > bytes.len()
    {
        return Err(ImageError::CutOff);
    }
    let head = bytes.get(12..30).ok_or(ImageError::CutOff)?;
    let (chunk, data) = (&head[..4], &head[8..]);
    let three = |at: usize| {
        u32::from(data[at]) | u32::from(data[at + 1]) << 8 | u32::from(data[at + 2]) << 16
    };
    let (width, height) = match chunk {
        b"VP8X" => (three(4) + 1, three(7) + 1),
        b"VP8L" if data[0] == 0x2f => {
            let bits = u32::from_le_bytes([data[1], data[2], data[3], data[4]]);
            ((bits & 0x3fff) + 1, (bits >> 14 & 0x3fff) + 1)
        }
        b"VP8 " if data[3..6] == [0x9d, 0x01, 0x2a] => {
            let side = |at: usize| u32::from(u16::from_le_bytes([data[at], data[at + 1]]) & 0x3fff);
            (side(6), side(8))
        }
        _ => return Err(ImageError::Header),
    };
    ImageHeader::new(ImageFormat::WebP, width, height)
}

fn big_u32(bytes: &[u8]) -> u32 {
    bytes
        .iter()
        .fold(0, |value, byte| value << 8 | u32::from(*byte))
}

/// Images written by hand, for tests of other modules too.
#[cfg(test)]
pub(crate) mod samples {
    /// A PNG's frame: header, one empty data chunk, end. No decoder is asked.
    pub(crate) fn png(width: u32, height: u32) -> Vec<u8> {
        let mut bytes = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
        bytes.extend(width.to_be_bytes());
        bytes.extend(height.to_be_bytes());
        bytes.extend(b"\x08\x02\0\0\0crc_");
        bytes.extend(b"\0\0\0\0IDATcrc_\0\0\0\0IENDcrc_");
        bytes
    }

    pub(crate) fn jpeg(width: u16, height: u16) -> Vec<u8> {
        let mut bytes = b"\xff\xd8\xff\xe0\0\x04ab\xff\xc0\0\x0b\x08".to_vec();
        bytes.extend(height.to_be_bytes());
        bytes.extend(width.to_be_bytes());
        bytes.extend(b"\x01\x01\x11\0\xff\xda\0\x02data\xff\xd9");
        bytes
    }

    pub(crate) fn webp(width: u32, height: u32) -> Vec<u8> {
        let mut bytes = b"RIFF\x16\0\0\0WEBPVP8X\x0a\0\0\0\0\0\0\0".to_vec();
        bytes.extend(&(width - 1).to_le_bytes()[..3]);
        bytes.extend(&(height - 1).to_le_bytes()[..3]);
        bytes
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn headers() {
        let sized = |bytes: &[u8]| ImageHeader::of(bytes).map(|it| it.to_string());
        assert_eq!(sized(&samples::png(364, 273)).as_deref(), Ok("364x273 PNG"));
        assert_eq!(
            sized(&samples::jpeg(640, 480)).as_deref(),
            Ok("640x480 JPEG")
        );
        assert_eq!(sized(&samples::webp(28, 700)).as_deref(), Ok("28x700 WebP"));
        assert_eq!(sized(b"GIF89a"), Err(ImageError::Unknown));
        assert_eq!(sized(b""), Err(ImageError::Empty));
        assert_eq!(sized(&samples::png(0, 3)), Err(ImageError::Header));
    }

    #[test]
    fn an_image_that_was_cut_off_is_noticed_wherever() {
        for bytes in [samples::png(8, 8), samples::jpeg(8, 8), samples::webp(8, 8)] {
            assert!(ImageHeader::of(&bytes).is_ok());
            for length in 0..bytes.len() {
                assert!(
                    ImageHeader::of(&bytes[..length]).is_err(),
                    "{length} of {} bytes",
                    bytes.len()
                );
            }
        }
    }

    proptest! {
        #[test]
        fn any_bytes(head in 0_usize..4, bytes in proptest::collection::vec(any::<u8>(), 0..80)) {
            let head: &[u8] = [&b"\x89PNG\r\n\x1a\n"[..], b"\xff\xd8\xff", b"RIFF\0\0\0\0WEBPVP8 ", b""][head];
            let _ = ImageHeader::of(&[head, &bytes].concat());
        }
    }
}
