//! Owns the PNG of a scene: anti-aliased shapes, text from a bitmap font. Never lays anything out.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};
use tiny_skia::{
    FillRule, FilterQuality, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, PixmapPaint,
    PremultipliedColorU8, Stroke, Transform,
};

use super::SankeyError;
use super::palette::{BACKGROUND, Color};
use super::scene::{Anchor, Item, Scene, Segment, Shape, Text};
use super::text::ELLIPSIS;

/// A PNG file, `scale` pixels to a unit of the scene.
pub fn draw(scene: &Scene, scale: f32) -> Result<Vec<u8>, SankeyError> {
    let [width_px, height_px] =
        [scene.width, scene.height].map(|length| (length as f32 * scale).round() as u32);
    let mut image = Pixmap::new(width_px, height_px).ok_or(SankeyError::Size {
        width_px,
        height_px,
    })?;
    let [red, green, blue] = BACKGROUND;
    image.fill(tiny_skia::Color::from_rgba8(red, green, blue, 255));
    for item in &scene.items {
        match item {
            Item::Shape(shape) => draw_shape(&mut image, shape, scale),
            Item::Text(text) => draw_text(&mut image, text, scale),
        }
    }
    encode(&image)
}

fn draw_shape(image: &mut Pixmap, shape: &Shape, scale: f32) {
    let Some(path) = path_of(&shape.path) else {
        return;
    };
    let [red, green, blue] = shape.color;
    let mut paint = Paint::default();
    paint.set_color_rgba8(red, green, blue, (shape.opacity * 255.0).round() as u8);
    let transform = Transform::from_scale(scale, scale);
    match shape.stroke {
        Some(width) => {
            let stroke = Stroke {
                width: width as f32,
                line_cap: LineCap::Round,
                line_join: LineJoin::Round,
                ..Stroke::default()
            };
            image.stroke_path(&path, &paint, &stroke, transform, None);
        }
        None => image.fill_path(&path, &paint, FillRule::Winding, transform, None),
    }
}

fn path_of(segments: &[Segment]) -> Option<Path> {
    let mut path = PathBuilder::new();
    let point = |[x, y]: [f64; 2]| [x as f32, y as f32];
    for segment in segments {
        match *segment {
            Segment::Move(to) => {
                let [x, y] = point(to);
                path.move_to(x, y);
            }
            Segment::Line(to) => {
                let [x, y] = point(to);
                path.line_to(x, y);
            }
            Segment::Cubic(points) => {
                let [[x1, y1], [x2, y2], [x, y]] = points.map(point);
                path.cubic_to(x1, y1, x2, y2, x, y);
            }
            Segment::Close => path.close(),
        }
    }
    path.finish()
}

/// Sizes of the bitmap font, the smallest first.
const RASTERS: [RasterHeight; 4] = [
    RasterHeight::Size16,
    RasterHeight::Size20,
    RasterHeight::Size24,
    RasterHeight::Size32,
];

fn draw_text(image: &mut Pixmap, text: &Text, scale: f32) {
    let height_px = text.style.line_height() as f32 * scale;
    let raster = RASTERS
        .into_iter()
        .find(|raster| raster.val() as f32 >= height_px)
        .unwrap_or(RasterHeight::Size32);
    let weight = if text.style.bold() {
        FontWeight::Bold
    } else {
        FontWeight::Regular
    };
    let Some(line) = line_of(&text.content, weight, raster, text.color) else {
        return;
    };

    let zoom = height_px / raster.val() as f32;
    let width_px = line.width() as f32 * zoom;
    let left = text.x as f32 * scale
        - match text.anchor {
            Anchor::Start => 0.0,
            Anchor::Middle => width_px / 2.0,
            Anchor::End => width_px,
        };
    // The middle of the font's capitals is a sixteenth above the middle of its line.
    let top = text.y as f32 * scale - height_px * 7.0 / 16.0;
    let (left, top) = (left.round(), top.round());
    // Unscaled glyphs on whole pixels stay as sharp as they are.
    let quality = if zoom == 1.0 {
        FilterQuality::Nearest
    } else {
        FilterQuality::Bicubic
    };
    let paint = PixmapPaint {
        quality,
        ..PixmapPaint::default()
    };
    let mut put = |line: &Pixmap, opacity: f32, dx: f32, dy: f32| {
        let transform = Transform::from_row(zoom, 0.0, 0.0, zoom, left + dx, top + dy);
        image.draw_pixmap(
            0,
            0,
            line.as_ref(),
            &PixmapPaint { opacity, ..paint },
            transform,
            None,
        );
    };
    if text.halo
        && let Some(halo) = line_of(&text.content, weight, raster, BACKGROUND)
    {
        for [dx, dy] in [
            [-1.0, -1.0],
            [0.0, -1.0],
            [1.0, -1.0],
            [-1.0, 0.0],
            [1.0, 0.0],
            [-1.0, 1.0],
            [0.0, 1.0],
            [1.0, 1.0],
        ] {
            put(&halo, 0.6, dx * scale, dy * scale);
        }
    }
    put(&line, 1.0, 0.0, 0.0);
}

/// A line of text of its own, transparent around the glyphs.
fn line_of(
    content: &str,
    weight: FontWeight,
    raster: RasterHeight,
    [red, green, blue]: Color,
) -> Option<Pixmap> {
    let mut characters = Vec::new();
    for c in content.chars() {
        match c {
            ELLIPSIS => characters.extend(['.'; 3]),
            ' '..='~' => characters.push(c),
            _ => characters.push('?'),
        }
    }
    let advance = get_raster_width(weight, raster);
    let mut line = Pixmap::new((advance * characters.len()) as u32, raster.val() as u32)?;
    let width = line.width() as usize;
    for (index, character) in characters.into_iter().enumerate() {
        let Some(glyph) = get_raster(character, weight, raster) else {
            continue;
        };
        for (row, coverages) in glyph.raster().iter().enumerate() {
            let start = row * width + index * advance;
            for (pixel, &coverage) in line.pixels_mut()[start..start + advance]
                .iter_mut()
                .zip(*coverages)
            {
                let faded = |channel: u8| (u16::from(channel) * u16::from(coverage) / 255) as u8;
                if let Some(color) =
                    PremultipliedColorU8::from_rgba(faded(red), faded(green), faded(blue), coverage)
                {
                    *pixel = color;
                }
            }
        }
    }
    Some(line)
}

fn encode(image: &Pixmap) -> Result<Vec<u8>, SankeyError> {
    // Nothing shows through the background, so that there is no alpha to keep.
    let rgb: Vec<u8> = image
        .pixels()
        .iter()
        .flat_map(|pixel| [pixel.red(), pixel.green(), pixel.blue()])
        .collect();
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, image.width(), image.height());
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&rgb)?;
    writer.finish()?;
    Ok(bytes)
}
