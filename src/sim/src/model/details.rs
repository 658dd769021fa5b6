//! What is seen of objects and never touched: stems, dials, pages, labels, ears, buttons.
//! Nothing here is solid.

use super::{
    looks::Paint,
    objects::Item,
    parts::{Axis, Parts, ball, cone, cuboid, pillar, rod},
};

const PAPER: Paint = Paint::plain([244, 241, 230]);
const INK: Paint = Paint::plain([34, 34, 36]);
/// How far a detail stands out of what it lies on, in metres.
const PROUD_M: f32 = 0.0008;

/// Stem and leaf of a fruit whose top has a height.
pub(super) fn stem(item: &Item, top: f32, parts: &mut Parts) {
    let radius = item.half[0].min(item.half[1]);
    if item.says(&[
        "apple", "pear", "pepper", "tomato", "avocado", "pumpkin", "eggplant",
    ]) {
        parts.look(
            pillar([0.0; 2], top - 0.004, top + radius * 0.22, radius * 0.06),
            Paint::plain([92, 64, 36]),
        );
        if item.says(&["apple", "leaf", "tomato"]) {
            parts.look(
                cuboid(
                    [radius * 0.16, 0.0, top + radius * 0.1],
                    [radius * 0.17, radius * 0.08, 0.001],
                ),
                Paint::plain([80, 140, 52]),
            );
        }
    } else if item.says(&["bun", "sushi", "band", "stripe"]) {
        let center = [0.0, 0.0, top - 0.25 * item.half[2]];
        parts.look(
            cuboid(
                center,
                [item.half[0] * 0.7, item.half[1] * 0.7, item.half[2] * 0.26],
            ),
            item.paint.second(),
        );
    }
}

/// Tip, cap and eraser of a pen along its longest axis.
pub(super) fn tip(item: &Item, parts: &mut Parts) {
    let axis = if item.longest() == 2 {
        2
    } else {
        item.lengthwise()
    };
    let (long, along) = (item.half[axis], Axis::of(axis));
    let radius = (0..3)
        .filter(|other| *other != axis)
        .map(|other| item.half[other])
        .fold(f32::MAX, f32::min);
    let at = |share: f32| {
        let mut center = [0.0; 3];
        center[axis] = share * long;
        center
    };
    if item.says(&["pencil", "crayon"]) {
        parts.look(
            cone(along, false, at(0.93), long * 0.07, radius),
            Paint::grain([222, 184, 132]),
        );
        parts.look(
            rod(along, at(-0.94), long * 0.06, radius * 1.04),
            Paint::plain([226, 126, 136]),
        );
        parts.look(
            rod(along, at(-0.85), long * 0.03, radius * 1.06),
            Paint::glossy([176, 180, 184]),
        );
    } else if item.says(&["pen", "marker", "stylus"]) {
        parts.look(cone(along, false, at(0.95), long * 0.05, radius * 0.8), INK);
        parts.look(
            rod(along, at(-0.65), long * 0.34, radius * 1.08),
            item.paint.second(),
        );
        parts.look(
            rod(along, at(0.15), long * 0.02, radius * 1.05),
            Paint::glossy([190, 192, 196]),
        );
    } else {
        parts.look(
            rod(along, at(-0.6), long * 0.38, radius * 1.05),
            item.paint.second(),
        );
    }
}

/// The inside of a dish, seen from above.
pub(super) fn hollow(item: &Item, radius: f32, parts: &mut Parts) {
    let z = item.half[2];
    let filled = item.says(&["soup", "pasta", "food"]);
    let inside = if filled {
        item.paint.second()
    } else {
        item.paint.shaded(0.8)
    };
    parts.look(
        pillar([0.0; 2], z - 0.002, z + PROUD_M, radius * 0.9),
        inside,
    );
    parts.look(
        pillar([0.0; 2], z - 0.002, z + PROUD_M * 1.5, radius * 0.62),
        inside.shaded(0.88),
    );
    let band = (z * 0.22).max(0.0006);
    parts.look(
        pillar([0.0; 2], z * 0.45 - band, z * 0.45 + band, radius + PROUD_M),
        item.paint.second(),
    );
    if item.says(&["handle", "basket"]) {
        for side in [-1.0, 1.0] {
            parts.look(
                cuboid(
                    [side * radius * 0.95, 0.0, z + z * 0.15],
                    [radius * 0.05, radius * 0.2, z * 0.18],
                ),
                item.paint.shaded(0.8),
            );
        }
    }
}

/// Label and lid of a standing can or jar.
pub(super) fn bands(item: &Item, radius: f32, parts: &mut Parts) {
    let z = item.half[2];
    parts.look(
        pillar([0.0; 2], -z * 0.55, z * 0.45, radius + PROUD_M),
        item.paint.second(),
    );
    parts.look(
        pillar([0.0; 2], z * 0.82, z + PROUD_M, radius + PROUD_M),
        item.paint.shaded(0.75),
    );
}

/// Frosting and a few crumbs.
pub(super) fn topping(item: &Item, radius: f32, parts: &mut Parts) {
    let z = item.half[2];
    parts.look(
        pillar([0.0; 2], z * 0.4, z + PROUD_M, radius * 0.97),
        item.paint.second(),
    );
    parts.look(
        pillar([0.0; 2], -z, -z * 0.85, radius + PROUD_M),
        item.paint.shaded(0.7),
    );
    for (x, y) in [
        (0.5, 0.1),
        (-0.3, 0.5),
        (-0.4, -0.4),
        (0.2, -0.6),
        (0.05, 0.05),
    ] {
        parts.look(
            ball([x * radius, y * radius, z], radius * 0.1),
            item.paint.shaded(0.9),
        );
    }
}

/// The two ends of a roll or a can along an axis.
pub(super) fn roll(item: &Item, along: Axis, half_length: f32, radius: f32, parts: &mut Parts) {
    parts.look(
        rod(along, [0.0; 3], half_length + PROUD_M, radius * 0.35),
        item.paint.second().shaded(0.7),
    );
    parts.look(
        rod(along, [0.0; 3], half_length * 0.6, radius + PROUD_M),
        item.paint.second(),
    );
}

/// A label on the top and around the middle of a box.
pub(super) fn label(item: &Item, parts: &mut Parts) {
    let [x, y, z] = item.half;
    let wide = [0.55, 0.7, 0.4][item.choose("label", 3)];
    parts.look(
        cuboid([0.0, 0.0, z], [x * wide, y * wide, PROUD_M]),
        item.paint.second(),
    );
    let band = z * [0.3, 0.18, 0.5][item.choose("band", 3)];
    parts.look(
        cuboid([0.0; 3], [x + PROUD_M, y + PROUD_M, band.max(0.0006)]),
        item.paint.shaded(0.86),
    );
    if item.says(&["handle", "basket"]) {
        parts.look(
            cuboid([0.0, 0.0, z * 1.1], [x * 0.1, y * 0.6, z * 0.1]),
            item.paint.shaded(0.7),
        );
    }
}

/// The axis that a thing's faces look along, and the short and the long side of its faces.
fn face_axes(item: &Item) -> [usize; 3] {
    let flat = item.flattest();
    let [a, b] = match flat {
        0 => [1, 2],
        1 => [0, 2],
        _ => [0, 1],
    };
    if item.half[a] <= item.half[b] {
        [flat, a, b]
    } else {
        [flat, b, a]
    }
}

/// Pages, title and spiral of a book whose covers look along its flattest axis.
pub(super) fn book(item: &Item, parts: &mut Parts) {
    let [flat, short, long] = face_axes(item);
    let mut pages = item.half;
    pages[flat] *= 0.74;
    pages[long] += PROUD_M;
    let mut center = [0.0; 3];
    center[short] = PROUD_M;
    parts.look(cuboid(center, pages), PAPER);
    let mut title = item.half.map(|side| side * 0.5);
    title[flat] = item.half[flat] + PROUD_M;
    title[long] = item.half[long] * 0.16;
    let mut at = [0.0; 3];
    at[long] = item.half[long] * [0.3, 0.45, -0.2][item.choose("title", 3)];
    let ink = if item.paint.accent == item.paint.color {
        item.paint.shaded(0.6)
    } else {
        item.paint.second()
    };
    parts.look(cuboid(at, title), ink);
    if item.says(&["elastic", "band", "strap"]) {
        let mut band = item.half.map(|side| side + PROUD_M * 1.5);
        band[short] = item.half[short] * 0.04;
        let mut at = [0.0; 3];
        at[short] = item.half[short] * 0.75;
        parts.look(cuboid(at, band), ink);
    }
    if item.says(&["spiral"]) {
        for index in 0..9 {
            let mut at = [0.0; 3];
            at[short] = -item.half[short];
            at[long] = item.half[long] * (index as f32 - 4.0) * 0.22;
            parts.look(
                rod(
                    Axis::of(long),
                    at,
                    item.half[long] * 0.035,
                    (item.half[flat] * 1.1).min(0.012),
                ),
                INK,
            );
        }
    }
}

/// The sunk floor of a tray, on its largest face.
pub(super) fn tray(item: &Item, parts: &mut Parts) {
    let flat = item.flattest();
    for share in [0.9, 0.84] {
        let mut half = item.half.map(|side| side * share);
        half[flat] = item.half[flat] + PROUD_M * if share > 0.87 { 1.0 } else { 1.6 };
        parts.look(
            cuboid([0.0; 3], half),
            item.paint.shaded(if share > 0.87 { 0.6 } else { 0.88 }),
        );
    }
    if item.says(&["compartments", "compartment"]) {
        let long = item.longest();
        let mut half = item.half.map(|side| side * 0.84);
        half[flat] = item.half[flat] + PROUD_M * 2.4;
        half[long] = item.half[long] * 0.02;
        parts.look(cuboid([0.0; 3], half), item.paint.second());
    }
}

/// Rows of buttons and a screen on both faces of a flat device.
pub(super) fn buttons(item: &Item, parts: &mut Parts) {
    let [flat, short, long] = face_axes(item);
    let keys = if item.says(&["keyboard", "keys"]) {
        item.paint.shaded(0.8)
    } else {
        item.paint.second()
    };
    let mut patch = |across: f32, along: f32, size: [f32; 2], paint: Paint| {
        let mut center = [0.0; 3];
        center[short] = across * item.half[short];
        center[long] = along * item.half[long];
        let mut half = [0.0; 3];
        half[short] = size[0] * item.half[short];
        half[long] = size[1] * item.half[long];
        half[flat] = item.half[flat] + PROUD_M;
        parts.look(cuboid(center, half), paint);
    };
    if item.says(&["frame", "picture", "phone", "tablet"]) {
        return patch(0.0, 0.0, [0.86, 0.88], Paint::glossy([60, 74, 96]));
    }
    let screen = item.says(&["calculator", "display", "screen"]);
    if screen {
        patch(0.0, 0.7, [0.78, 0.16], Paint::plain([156, 176, 150]));
    }
    let rows = if screen { 4 } else { 6 };
    for row in 0..rows {
        for column in 0..3 {
            let along = -0.78 + row as f32 * if screen { 0.3 } else { 0.28 };
            let power = row + 1 == rows && column == 0 && item.says(&["remote"]);
            let paint = if power {
                Paint::plain([206, 46, 40])
            } else {
                keys
            };
            patch(-0.55 + 0.55 * column as f32, along, [0.18, 0.08], paint);
        }
    }
}

/// Dial and strap of a watch.
pub(super) fn watch(item: &Item, parts: &mut Parts) {
    let flat = item.flattest();
    let radius = (0..3)
        .filter(|axis| *axis != flat)
        .map(|axis| item.half[axis])
        .fold(f32::MAX, f32::min);
    let along = Axis::of(flat);
    parts.look(
        rod(along, [0.0; 3], item.half[flat] + 0.0012, radius * 0.98),
        Paint::glossy([188, 190, 194]),
    );
    parts.look(
        rod(along, [0.0; 3], item.half[flat] + 0.0018, radius * 0.8),
        Paint::plain([240, 240, 236]),
    );
}

/// Face, hands, bells and rim of a clock whose faces look along an axis.
pub(super) fn dial(item: &Item, thin: usize, radius: f32, boxy: bool, parts: &mut Parts) {
    let along = Axis::of(thin);
    // The face's own up: the longer of its two axes, z where it stands.
    let up = if thin == 2 { item.lengthwise() } else { 2 };
    let mut center = [0.0; 3];
    if thin != 2 && !boxy {
        center[2] = radius - item.half[2];
    }
    let depth = item.half[thin];
    let face =
        if item.says(&["black"]) && !item.says(&["white"]) && item.paint.color != [28, 28, 30] {
            INK
        } else {
            Paint::plain([246, 245, 240])
        };
    if boxy {
        let mut half = item.half.map(|side| side * 0.8);
        half[thin] = depth + PROUD_M;
        parts.look(
            cuboid(center, half),
            if item.says(&["digital", "led"]) {
                Paint::glossy([30, 40, 54])
            } else {
                face
            },
        );
    } else {
        parts.look(rod(along, center, depth + PROUD_M, radius * 0.82), face);
    }
    let hands = if face == INK {
        Paint::plain([240, 240, 240])
    } else {
        INK
    };
    let side = (0..3)
        .find(|axis| *axis != thin && *axis != up)
        .unwrap_or(0);
    for (axis, length) in [(up, 0.56), (side, 0.4)] {
        let mut half = [radius * 0.035; 3];
        half[thin] = depth + PROUD_M * 2.0;
        half[axis] = radius * length * 0.5;
        let mut at = center;
        at[axis] += radius * length * 0.5;
        parts.look(cuboid(at, half), hands);
    }
    if item.says(&["alarm", "bells", "bell"]) {
        for turn in [-1.0, 1.0] {
            let mut at = center;
            at[up] += radius * 0.85;
            at[side] += turn * radius * 0.55;
            parts.look(ball(at, radius * 0.24), item.paint.second());
        }
    }
}

/// Glass bulbs and sand of an hourglass along an axis.
pub(super) fn bulbs(item: &Item, along: Axis, axis: usize, radius: f32, parts: &mut Parts) {
    let long = item.half[axis];
    for (side, against) in [(-1.0, false), (1.0, true)] {
        let mut center = [0.0; 3];
        center[axis] = side * long * 0.42;
        parts.look(
            cone(along, against, center, long * 0.42, radius * 0.8),
            Paint::glossy([204, 222, 226]),
        );
    }
    let mut sand = [0.0; 3];
    sand[axis] = -long * 0.66;
    parts.look(
        rod(along, sand, long * 0.16, radius * 0.72),
        Paint::plain([226, 202, 150]),
    );
}

/// Head, ears, eyes and limbs of a figure whose head points along an axis; its face looks to -y, or
/// up where it lies.
pub(super) fn body(item: &Item, axis: usize, parts: &mut Parts) {
    let [x, y, z] = item.half;
    let long = item.half[axis];
    let side = if axis == 0 { 1 } else { 0 };
    let (front, sign) = if axis == 2 { (1, -1.0) } else { (2, 1.0) };
    let wide = item.half[side];
    let deep = item.half[front];
    let radius = wide.min(deep).min(long * 0.42);
    let at = |along: f32, across: f32, ahead: f32| {
        let mut center = [0.0; 3];
        center[axis] = along;
        center[side] = across;
        center[front] = ahead * sign;
        center
    };
    let paint = item.paint;
    let head = long - radius * 0.9;
    parts.look(ball(at(head, 0.0, 0.0), radius * 0.9), paint);
    parts.look(
        ball(at(-long * 0.35, 0.0, 0.0), x.min(y).min(z).min(long * 0.6)),
        paint,
    );
    parts.look(
        ball(at(-long * 0.3, 0.0, deep * 0.5), radius * 0.6),
        paint.second(),
    );
    for turn in [-1.0, 1.0] {
        parts.look(
            ball(
                at(head + radius * 0.7, turn * radius * 0.6, 0.0),
                radius * 0.3,
            ),
            paint.shaded(0.85),
        );
        parts.look(
            ball(
                at(head + radius * 0.15, turn * radius * 0.32, radius * 0.8),
                radius * 0.11,
            ),
            INK,
        );
        parts.look(
            ball(
                at(0.0, turn * (wide - radius * 0.35), deep * 0.2),
                radius * 0.34,
            ),
            paint.shaded(0.92),
        );
        parts.look(
            ball(
                at(
                    -long + radius * 0.4,
                    turn * (wide - radius * 0.4),
                    deep * 0.3,
                ),
                radius * 0.38,
            ),
            paint.shaded(0.88),
        );
    }
    parts.look(
        ball(at(head - radius * 0.15, 0.0, radius * 0.85), radius * 0.14),
        paint.shaded(0.5),
    );
}
