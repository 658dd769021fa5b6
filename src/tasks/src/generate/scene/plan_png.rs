//! A floor plan in pixels: shapes anti-aliased, text from a bitmap font. Never lays anything out.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster};
use tiny_skia::{
    Color, FillRule, LineJoin, Paint, PathBuilder, Pixmap, PremultipliedColorU8, Rect, Stroke,
    Transform,
};

use super::{
    SceneError,
    plan::{CHARACTER, Colour, Item, Label, Plan},
};

/// The plan as a PNG file.
pub(super) fn draw(plan: &Plan) -> Result<Vec<u8>, SceneError> {
    let [width, height] = plan.size.map(|length| length.ceil() as u32);
    let failed = |reason: String| SceneError::Png { reason };
    let mut image = Pixmap::new(width, height)
        .ok_or_else(|| failed(format!("{width} x {height} pixels are too many")))?;
    image.fill(Color::WHITE);
    for item in &plan.items {
        match item {
            Item::Text(label) => write(&mut image, label),
            shape => draw_shape(&mut image, shape),
        }
    }
    // Nothing shows through the paper, so that there is no alpha to keep.
    let rgb: Vec<u8> = image
        .pixels()
        .iter()
        .flat_map(|pixel| [pixel.red(), pixel.green(), pixel.blue()])
        .collect();
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    let written = encoder.write_header().and_then(|mut writer| {
        writer.write_image_data(&rgb)?;
        writer.finish()
    });
    written.map_err(|error| failed(error.to_string()))?;
    Ok(bytes)
}

fn draw_shape(image: &mut Pixmap, item: &Item) {
    let paint = |[red, green, blue]: Colour| {
        let mut paint = Paint::default();
        paint.set_color_rgba8(red, green, blue, 255);
        paint
    };
    let mut path = PathBuilder::new();
    let (fill, edge) = match item {
        Item::Rect {
            corner: [x, y],
            size: [width, height],
            fill,
            edge,
        } => {
            if let Some(rect) = Rect::from_xywh(*x as f32, *y as f32, *width as f32, *height as f32)
            {
                path.push_rect(rect);
            }
            (Some(*fill), *edge)
        }
        Item::Line {
            points,
            colour,
            width,
        } => {
            for (index, [x, y]) in points.iter().enumerate() {
                if index == 0 {
                    path.move_to(*x as f32, *y as f32)
                } else {
                    path.line_to(*x as f32, *y as f32)
                }
            }
            (None, Some((*colour, *width)))
        }
        Item::Disc {
            centre: [x, y],
            radius,
            fill,
        } => {
            path.push_circle(*x as f32, *y as f32, *radius as f32);
            (Some(*fill), None)
        }
        Item::Text(_) => return,
    };
    let Some(path) = path.finish() else { return };
    if let Some(fill) = fill {
        image.fill_path(
            &path,
            &paint(fill),
            FillRule::Winding,
            Transform::identity(),
            None,
        );
    }
    if let Some((colour, width)) = edge {
        let stroke = Stroke {
            width: width as f32,
            line_join: LineJoin::Round,
            ..Stroke::default()
        };
        image.stroke_path(&path, &paint(colour), &stroke, Transform::identity(), None);
    }
}

/// Writes a line of text around its centre; what the font does not have is a `?`.
fn write(image: &mut Pixmap, label: &Label) {
    let weight = if label.bold {
        FontWeight::Bold
    } else {
        FontWeight::Regular
    };
    let glyph = |character: char| get_raster(character, weight, RasterHeight::Size20);
    let [long, high] = [
        label.text.len() as f64 * CHARACTER[0],
        RasterHeight::Size20.val() as f64,
    ];
    let [x, y] = label.centre.map(f64::round);
    let (width, height) = (i64::from(image.width()), i64::from(image.height()));
    for (index, character) in label.text.chars().enumerate() {
        let Some(glyph) = glyph(character).or_else(|| glyph('?')) else {
            continue;
        };
        for (row, line) in glyph.raster().iter().enumerate() {
            for (column, ink) in line.iter().enumerate() {
                let along =
                    (index as f64 * CHARACTER[0] + column as f64 - long * 0.5).floor() as i64;
                let down = (row as f64 - high * 0.5).floor() as i64;
                let (dx, dy) = if label.upright {
                    (down, -along)
                } else {
                    (along, down)
                };
                let (x, y) = (x as i64 + dx, y as i64 + dy);
                if *ink > 0 && (0..width).contains(&x) && (0..height).contains(&y) {
                    blend(
                        &mut image.pixels_mut()[(y * width + x) as usize],
                        label.colour,
                        *ink,
                    );
                }
            }
        }
    }
}

fn blend(pixel: &mut PremultipliedColorU8, colour: Colour, ink: u8) {
    let mix = |under: u8, over: u8| {
        ((u32::from(under) * (255 - u32::from(ink)) + u32::from(over) * u32::from(ink)) / 255) as u8
    };
    let [red, green, blue] = colour;
    let mixed = PremultipliedColorU8::from_rgba(
        mix(pixel.red(), red),
        mix(pixel.green(), green),
        mix(pixel.blue(), blue),
        255,
    );
    *pixel = mixed.unwrap_or(*pixel);
}
