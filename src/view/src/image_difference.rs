//! Two images that should be equal, side by side with where they differ.

use reel_world::{FRAME_HEIGHT, FRAME_WIDTH};

use crate::{
    ViewError,
    canvas::{Canvas, Font},
};

const MARGIN: usize = 12;
const TITLE_HEIGHT: usize = 30;
/// Beside a differing pixel this many more are painted each way, so that a single one is seen.
const HALO: usize = 2;

/// Recorded, replayed, and in red where they differ (with the pixels around), as PNG. Both are RGB
/// of the head camera.
///
/// # Errors
/// When the PNG cannot be made.
pub fn image_difference(recorded: &[u8], replayed: &[u8]) -> Result<Vec<u8>, ViewError> {
    let mut canvas = Canvas::new(
        3 * (FRAME_WIDTH + MARGIN) + MARGIN,
        FRAME_HEIGHT + TITLE_HEIGHT + 2 * MARGIN,
        [241, 243, 246],
    );
    let faint: Vec<u8> = recorded.iter().map(|value| 160 + value / 4).collect();
    let top = TITLE_HEIGHT + MARGIN;
    let left = |panel: usize| MARGIN + panel * (FRAME_WIDTH + MARGIN);
    for (panel, (title, rgb)) in [
        ("recorded", recorded),
        ("replayed", replayed),
        ("difference", &faint),
    ]
    .iter()
    .enumerate()
    {
        canvas.text(left(panel), MARGIN / 2, title, Font::Title, [28, 34, 44]);
        canvas.paste(left(panel), top, rgb, FRAME_WIDTH);
    }
    for (index, (a, b)) in recorded
        .chunks_exact(3)
        .zip(replayed.chunks_exact(3))
        .enumerate()
    {
        if a != b {
            let (x, y) = (index % FRAME_WIDTH, index / FRAME_WIDTH);
            let (x0, y0) = (x.saturating_sub(HALO), y.saturating_sub(HALO));
            let (width, height) = (
                (x + HALO).min(FRAME_WIDTH - 1) - x0 + 1,
                (y + HALO).min(FRAME_HEIGHT - 1) - y0 + 1,
            );
            canvas.fill(left(2) + x0, top + y0, width, height, [214, 30, 36]);
        }
    }
    Ok(canvas.png()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_pixel_is_seen() {
        let recorded = vec![90; FRAME_WIDTH * FRAME_HEIGHT * 3];
        let mut replayed = recorded.clone();
        replayed[(200 * FRAME_WIDTH + 300) * 3] = 91;
        let red = |png: &[u8]| {
            let mut reader = png::Decoder::new(std::io::Cursor::new(png))
                .read_info()
                .unwrap();
            let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut rgb).unwrap();
            rgb.chunks_exact(3)
                .filter(|pixel| pixel[0] > 200 && pixel[1] < 60 && pixel[2] < 60)
                .count()
        };
        assert_eq!(red(&image_difference(&recorded, &recorded).unwrap()), 0);
        assert_eq!(
            red(&image_difference(&recorded, &replayed).unwrap()),
            (2 * HALO + 1) * (2 * HALO + 1)
        );
    }
}
