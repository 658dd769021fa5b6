//! Owns the SVG of a scene: escaped, numbers with two decimals at most, no ids, so that several
//! fit on one page.

use std::fmt::Write;

use super::palette::{BACKGROUND, Color};
use super::scene::{Anchor, Item, Scene, Segment, Shape, Text};

/// A whole SVG document.
pub fn write(scene: &Scene) -> String {
    let (width, height) = (number(scene.width), number(scene.height));
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"reel-sankey\" role=\"img\" width=\"{width}\" height=\"{height}\" \
         viewBox=\"0 0 {width} {height}\" font-family=\"{FONTS}\">\n<title>{}</title>\n<desc>{}</desc>\n<style>{STYLE}</style>\n\
         <path d=\"M0 0H{width}V{height}H0Z\" fill=\"{}\"/>\n",
        escaped(&scene.title),
        escaped(&scene.description),
        hex(BACKGROUND),
    );
    for item in &scene.items {
        match item {
            Item::Shape(shape) => push_shape(&mut svg, shape),
            Item::Text(text) => push_text(&mut svg, text),
        }
    }
    svg + "</svg>\n"
}

const FONTS: &str = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Noto Sans', 'Helvetica Neue', Arial, sans-serif";
const STYLE: &str = ".reel-sankey text{font-variant-numeric:tabular-nums;pointer-events:none}.reel-sankey path[fill-opacity]:has(title):hover{fill-opacity:.85}";

fn push_shape(svg: &mut String, shape: &Shape) {
    let mut path = String::new();
    for segment in &shape.path {
        match segment {
            Segment::Move(to) => path += &format!("M{}", point(*to)),
            Segment::Line(to) => path += &format!("L{}", point(*to)),
            Segment::Cubic(points) => path += &format!("C{}", points.map(point).join(" ")),
            Segment::Close => path.push('Z'),
        }
    }
    let color = hex(shape.color);
    let paint = match shape.stroke {
        Some(width) => {
            format!(
                "fill=\"none\" stroke=\"{color}\" stroke-width=\"{}\" stroke-linecap=\"round\" stroke-linejoin=\"round\"",
                number(width)
            )
        }
        None if shape.opacity < 1.0 => format!(
            "fill=\"{color}\" fill-opacity=\"{}\"",
            number(shape.opacity)
        ),
        None => format!("fill=\"{color}\""),
    };
    push(svg, format_args!("<path d=\"{path}\" {paint}"));
    match &shape.tooltip {
        Some(tooltip) => push(
            svg,
            format_args!("><title>{}</title></path>\n", escaped(tooltip)),
        ),
        None => svg.push_str("/>\n"),
    }
}

fn push_text(svg: &mut String, text: &Text) {
    // The capitals of the usual fonts are 0.72 em tall.
    let baseline = text.y + 0.36 * text.style.font_size();
    let (x, y, size, color) = (
        number(text.x),
        number(baseline),
        number(text.style.font_size()),
        hex(text.color),
    );
    push(
        svg,
        format_args!("<text x=\"{x}\" y=\"{y}\" font-size=\"{size}\" fill=\"{color}\""),
    );
    match text.anchor {
        Anchor::Start => {}
        Anchor::Middle => svg.push_str(" text-anchor=\"middle\""),
        Anchor::End => svg.push_str(" text-anchor=\"end\""),
    }
    if text.style.bold() {
        svg.push_str(" font-weight=\"600\"");
    }
    if text.halo {
        svg.push_str(
            " stroke=\"#ffffff\" stroke-opacity=\".8\" stroke-width=\"3.5\" stroke-linejoin=\"round\" paint-order=\"stroke\"",
        );
    }
    push(svg, format_args!(">{}</text>\n", escaped(&text.content)));
}

fn push(svg: &mut String, arguments: std::fmt::Arguments<'_>) {
    svg.write_fmt(arguments).expect("a string takes everything");
}

fn point([x, y]: [f64; 2]) -> String {
    format!("{} {}", number(x), number(y))
}

/// At most two decimals, no trailing zeros, no negative zero.
fn number(value: f64) -> String {
    let text = format!("{value:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" {
        "0".to_owned()
    } else {
        text.to_owned()
    }
}

fn hex([red, green, blue]: Color) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            _ => escaped.push(c),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_markup_is_none() {
        assert_eq!(
            [10.0, 1.5, 0.333, -0.001, 1200.0].map(number),
            ["10", "1.5", "0.33", "0", "1200"]
        );
        assert_eq!(
            escaped("<a b=\"'\">&"),
            "&lt;a b=&quot;&#39;&quot;&gt;&amp;"
        );
    }
}
