//! Owns text in images: ASCII from a fixed bitmap font. Never measures or breaks
//! lines for its callers.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

/// Height of a line of text.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum TextSize {
    /// Lines 16 pixels high, in regular weight.
    Small,
    /// Lines 20 pixels high, in bold.
    Medium,
    /// Lines 24 pixels high, in bold.
    Large,
}

impl TextSize {
    /// Height of a line in pixels.
    pub fn height(self) -> usize {
        self.font().1.val()
    }

    /// Width of a text in pixels: every character is as wide as the others.
    pub fn width(self, text: &str) -> usize {
        let (weight, height) = self.font();
        get_raster_width(weight, height) * text.chars().count()
    }

    fn font(self) -> (FontWeight, RasterHeight) {
        match self {
            Self::Small => (FontWeight::Regular, RasterHeight::Size16),
            Self::Medium => (FontWeight::Bold, RasterHeight::Size20),
            Self::Large => (FontWeight::Bold, RasterHeight::Size24),
        }
    }
}

/// Draws one line of text into an 8-bit RGB image, `x` and `y` being its upper left corner. What
/// is not printable ASCII becomes `?`; what lies outside the image is left out.
#[expect(
    clippy::too_many_arguments,
    reason = "an image is three arguments, and contact sheets have plain buffers"
)]
pub fn draw_text(
    rgb: &mut [u8],
    width: usize,
    height: usize,
    x: i32,
    y: i32,
    size: TextSize,
    color: [u8; 3],
    text: &str,
) {
    let (weight, raster_height) = size.font();
    let advance = get_raster_width(weight, raster_height) as i64;
    let mut left = i64::from(x);
    for character in text.chars() {
        let printable = if matches!(character, ' '..='~') {
            character
        } else {
            '?'
        };
        let Some(glyph) = get_raster(printable, weight, raster_height) else {
            continue;
        };
        for (row, line) in (i64::from(y)..).zip(glyph.raster()) {
            for (column, &coverage) in (left..).zip(*line) {
                let inside =
                    (0..width as i64).contains(&column) && (0..height as i64).contains(&row);
                if coverage == 0 || !inside {
                    continue;
                }
                let at = (row as usize * width + column as usize) * 3;
                if let Some(pixel) = rgb.get_mut(at..at + 3) {
                    blend(pixel, color, u16::from(coverage));
                }
            }
        }
        left += advance;
    }
}

/// Mixes a colour into a pixel; 255 covers it.
pub(super) fn blend(pixel: &mut [u8], color: [u8; 3], coverage: u16) {
    for (channel, target) in pixel.iter_mut().zip(color) {
        *channel = ((u16::from(*channel) * (255 - coverage) + u16::from(target) * coverage + 127)
            / 255) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_stays_inside_and_is_seen() {
        let mut rgb = vec![0; 40 * 30 * 3];
        for (x, y) in [(-5, -5), (30, 20), (i32::MAX, i32::MIN), (2, 2)] {
            draw_text(&mut rgb, 40, 30, x, y, TextSize::Large, [255, 200, 0], "12");
        }
        assert!(rgb.as_chunks::<3>().0.contains(&[255, 200, 0]));
        // A buffer shorter than promised is no reason to fall over.
        draw_text(
            &mut rgb[..100],
            40,
            30,
            0,
            0,
            TextSize::Small,
            [255; 3],
            "short",
        );
    }

    #[test]
    fn unknown_characters_are_question_marks() {
        let image = |text| {
            let mut rgb = vec![0; 40 * 30 * 3];
            draw_text(&mut rgb, 40, 30, 0, 0, TextSize::Medium, [255; 3], text);
            rgb
        };
        assert_eq!(image("\u{e9}\n"), image("??"));
        assert_ne!(image("1"), image("?"));
        assert_eq!(
            TextSize::Medium.width("12"),
            2 * TextSize::Medium.width("1")
        );
    }
}
