//! An image in memory with the few strokes that a contact sheet needs: fill, paste, text.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

/// 8-bit red, green, blue.
pub(crate) type Colour = [u8; 3];

/// What images of episodes are drawn in.
pub(crate) mod colours {
    use super::Colour;

    pub(crate) const PAPER: Colour = [241, 243, 246];
    pub(crate) const CARD: Colour = [255, 255, 255];
    pub(crate) const INK: Colour = [28, 34, 44];
    pub(crate) const FAINT: Colour = [104, 114, 130];
    pub(crate) const GREEN: Colour = [28, 132, 76];
    pub(crate) const RED: Colour = [190, 42, 48];
    pub(crate) const BLUE: Colour = [52, 98, 178];
}

/// Size and weight of text.
#[derive(Clone, Copy)]
pub(crate) enum Font {
    Small,
    SmallBold,
    Medium,
    MediumBold,
    Title,
}

impl Font {
    fn parts(self) -> (FontWeight, RasterHeight) {
        match self {
            Font::Small => (FontWeight::Regular, RasterHeight::Size16),
            Font::SmallBold => (FontWeight::Bold, RasterHeight::Size16),
            Font::Medium => (FontWeight::Regular, RasterHeight::Size20),
            Font::MediumBold => (FontWeight::Bold, RasterHeight::Size20),
            Font::Title => (FontWeight::Bold, RasterHeight::Size24),
        }
    }

    /// Height of a line, in pixels.
    pub(crate) fn height(self) -> usize {
        self.parts().1.val()
    }

    /// Width of every character, in pixels.
    pub(crate) fn width(self) -> usize {
        let (weight, height) = self.parts();
        get_raster_width(weight, height)
    }
}

/// An RGB image, row by row from the top left.
pub(crate) struct Canvas {
    pub(crate) width: usize,
    pub(crate) height: usize,
    rgb: Vec<u8>,
}

impl Canvas {
    pub(crate) fn new(width: usize, height: usize, colour: Colour) -> Self {
        Self {
            width,
            height,
            rgb: colour.repeat(width * height),
        }
    }

    /// Fills a rectangle, cut at the border.
    pub(crate) fn fill(&mut self, x: usize, y: usize, width: usize, height: usize, colour: Colour) {
        for row in y..(y + height).min(self.height) {
            for column in x..(x + width).min(self.width) {
                self.set(column, row, colour);
            }
        }
    }

    /// Pastes an RGB image of that width.
    pub(crate) fn paste(&mut self, x: usize, y: usize, rgb: &[u8], width: usize) {
        for (row, pixels) in rgb.chunks_exact(width * 3).enumerate() {
            for (column, colour) in pixels.as_chunks::<3>().0.iter().enumerate() {
                self.set(x + column, y + row, *colour);
            }
        }
    }

    /// Pastes an RGB image at half its size: each pixel is the mean of four.
    pub(crate) fn paste_halved(
        &mut self,
        x: usize,
        y: usize,
        rgb: &[u8],
        width: usize,
        height: usize,
    ) {
        for row in 0..height / 2 {
            for column in 0..width / 2 {
                let mean = |channel: usize| {
                    let corner = |dx: usize, dy: usize| {
                        u16::from(rgb[((row * 2 + dy) * width + column * 2 + dx) * 3 + channel])
                    };
                    ((corner(0, 0) + corner(1, 0) + corner(0, 1) + corner(1, 1) + 2) / 4) as u8
                };
                self.set(x + column, y + row, [mean(0), mean(1), mean(2)]);
            }
        }
    }

    /// Writes one line; what the font does not have is a `?`.
    pub(crate) fn text(&mut self, x: usize, y: usize, text: &str, font: Font, colour: Colour) {
        let (weight, height) = font.parts();
        for (index, character) in text.chars().enumerate() {
            let glyph =
                get_raster(character, weight, height).or_else(|| get_raster('?', weight, height));
            let Some(glyph) = glyph else { continue };
            for (dy, row) in glyph.raster().iter().enumerate() {
                for (dx, ink) in row.iter().enumerate() {
                    self.blend(x + index * glyph.width() + dx, y + dy, colour, *ink);
                }
            }
        }
    }

    /// The pixels as 8-bit RGB, row by row from the top left.
    pub(crate) fn into_rgb(self) -> Vec<u8> {
        self.rgb
    }

    /// The image as PNG.
    pub(crate) fn png(&self) -> Result<Vec<u8>, png::EncodingError> {
        encode_png(&self.rgb, self.width as u32, self.height as u32)
    }

    fn set(&mut self, x: usize, y: usize, colour: Colour) {
        if x < self.width && y < self.height {
            let at = (y * self.width + x) * 3;
            self.rgb[at..at + 3].copy_from_slice(&colour);
        }
    }

    fn blend(&mut self, x: usize, y: usize, colour: Colour, ink: u8) {
        if ink == 0 || x >= self.width || y >= self.height {
            return;
        }
        let at = (y * self.width + x) * 3;
        let ink = u32::from(ink);
        for (under, over) in self.rgb[at..at + 3].iter_mut().zip(colour) {
            *under = ((u32::from(*under) * (255 - ink) + u32::from(over) * ink + 127) / 255) as u8;
        }
    }
}

/// An RGB buffer as PNG.
pub(crate) fn encode_png(
    rgb: &[u8],
    width: u32,
    height: u32,
) -> Result<Vec<u8>, png::EncodingError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(rgb)?;
    writer.finish()?;
    Ok(bytes)
}

/// Text as lines of at most so many characters, broken at spaces where possible; the last line is
/// cut with `...` where there would be too many.
pub(crate) fn wrap(text: &str, columns: usize, lines_max: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    let mut line = String::new();
    for word in text.split_whitespace() {
        let mut word: Vec<char> = word.chars().collect();
        let length = line.chars().count();
        if length > 0 && length + 1 + word.len() > columns {
            lines.push(std::mem::take(&mut line));
        } else if length > 0 {
            line.push(' ');
        }
        while word.len() > columns {
            let rest = word.split_off(columns);
            lines.push(word.into_iter().collect());
            word = rest;
        }
        line.extend(word);
    }
    if !line.is_empty() {
        lines.push(line);
    }
    if lines.len() > lines_max {
        lines.truncate(lines_max);
        if let Some(last) = lines.last_mut() {
            *last = last
                .chars()
                .take(columns.saturating_sub(3))
                .chain("...".chars())
                .collect();
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wraps_at_spaces_and_cuts() {
        assert_eq!(wrap("one two three", 7, 5), ["one two", "three"]);
        assert_eq!(wrap("abcdefghij k", 4, 5), ["abcd", "efgh", "ij k"]);
        assert_eq!(wrap("one two three four", 7, 1), ["one ..."]);
        assert_eq!(wrap("", 7, 2), Vec::<String>::new());
    }

    #[test]
    fn text_leaves_ink_inside_its_box_only() {
        let mut canvas = Canvas::new(40, 30, [0; 3]);
        canvas.text(2, 3, "A\u{1F600}", Font::Small, [255; 3]);
        let inked: Vec<usize> = (0..40 * 30)
            .filter(|pixel| canvas.rgb[pixel * 3] > 0)
            .collect();
        assert!(!inked.is_empty());
        let inside = |pixel: &usize| {
            (2..2 + 2 * Font::Small.width()).contains(&(pixel % 40))
                && (3..19).contains(&(pixel / 40))
        };
        assert!(inked.iter().all(inside));
    }
}
