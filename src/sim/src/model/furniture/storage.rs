//! Cabinets, kitchen counters and shelves, and their drawers, doors and handles.

use super::{CLOTH, DARK, METAL, Piece, WHITE, corners, woods};
use crate::{
    geometry::Pattern,
    model::{
        looks::{Feature, Paint, Traits},
        parts::{Axis, Parts, ball, block, pillar, rod},
    },
};

impl Piece<'_> {
    pub(super) fn cabinet(&self, parts: &mut Parts) {
        let Self {
            d, w, z, traits, ..
        } = *self;
        let body = traits.paint_or(
            Feature::Body,
            &[WHITE, woods()[1], woods()[0], woods()[3], DARK],
        );
        let top = traits.paint(Feature::Top).unwrap_or(body.shaded(1.08));
        let detail = traits.paint(Feature::Detail);
        let plinth = 0.05_f32.min(z * 0.2);
        let under = z - 0.022_f32.min(z * 0.2);
        let feet = !traits.has(&["flat", "box"]) && traits.choose("feet", 2) == 0;
        if feet {
            for (x, y) in corners(d - 0.03, w - 0.03) {
                parts.solid(
                    block([x - 0.02, y - 0.02, 0.0], [x + 0.02, y + 0.02, plinth]),
                    body.shaded(0.7),
                );
            }
        } else {
            parts.solid(
                block([-d + 0.01, -w + 0.01, 0.0], [d - 0.03, w - 0.01, plinth]),
                body.shaded(0.75),
            );
        }
        parts.solid(block([-d, -w, plinth], [d - 0.002, w, under]), body);
        parts.solid(block([-d, -w, under], [d, w, z]), top);
        if traits.has(&["rounded", "round", "curved"]) && self.free.iter().all(|free| *free > 0.03)
        {
            parts.solid(block([-d, -w - 0.025, plinth], [d, w + 0.025, z]), top);
            for (x, y) in corners(d, w) {
                parts.solid(pillar([x, y], plinth, z, 0.025), top);
            }
        }
        let face = d + 0.001;
        if let Some(detail) = detail.filter(|_| traits.has(&["circle", "grill", "mesh", "cube"])) {
            let middle = (plinth + under) * 0.5;
            let radius = (w.min((under - plinth) * 0.5)) * 0.62;
            let mesh = Paint {
                color: detail.color,
                accent: DARK.color,
                pattern: Pattern::Dots,
            };
            parts.look(rod(Axis::X, [face, 0.0, middle], 0.006, radius), mesh);
            parts.look(
                rod(Axis::X, [face, 0.0, middle], 0.008, radius * 0.3),
                body.shaded(0.8),
            );
            return;
        }
        let rows = (libm::floorf((under - plinth) / 0.24 + 0.5) as usize).clamp(1, 4);
        let columns = if w > 0.45 { 2 } else { 1 };
        let (height, width) = ((under - plinth) / rows as f32, 2.0 * w / columns as f32);
        for row in 0..rows {
            for column in 0..columns {
                let center = [
                    face,
                    -w + width * (column as f32 + 0.5),
                    plinth + height * (row as f32 + 0.5),
                ];
                let half = [width * 0.5 - 0.012, height * 0.5 - 0.01];
                match detail {
                    // An open compartment shows its coloured back.
                    Some(detail) if row + 1 == rows && rows > 1 => {
                        let [x, y, z] = center;
                        parts.look(
                            block(
                                [x - 0.004, y - half[0], z - half[1]],
                                [x + 0.003, y + half[0], z + half[1]],
                            ),
                            detail,
                        );
                    }
                    _ => self.drawer(parts, center, half, body),
                }
            }
        }
        if traits.has(&["slatted", "slats"]) {
            let count = libm::floorf(2.0 * w / 0.06) as usize;
            for slat in 0..count {
                let y = -w + 0.06 * (slat as f32 + 0.5);
                parts.look(
                    block(
                        [face, y - 0.008, plinth],
                        [face + 0.014, y + 0.008, plinth + height],
                    ),
                    woods()[0],
                );
            }
        }
    }

    pub(super) fn counter(&self, parts: &mut Parts) {
        let Self {
            d, w, z, traits, ..
        } = *self;
        let body = traits.paint_or(
            Feature::Body,
            &[
                WHITE,
                Paint::plain([92, 108, 118]),
                woods()[0],
                Paint::plain([120, 132, 116]),
            ],
        );
        let stone = [
            Paint {
                color: [224, 222, 216],
                accent: [186, 184, 180],
                pattern: Pattern::Grain,
            },
            DARK,
            woods()[2],
        ];
        base_cabinet(
            parts,
            [d, w],
            z,
            body,
            traits.paint_or(Feature::Top, &stone),
        );
        if traits.has(&["stove", "burner", "burners", "hob"]) {
            for (x, y) in corners(d * 0.5, w * 0.5) {
                parts.look(pillar([x, y], z - 0.004, z + 0.001, d.min(w) * 0.34), DARK);
            }
        }
    }

    pub(super) fn shelf(&self, parts: &mut Parts) {
        let Self {
            d, w, z, traits, ..
        } = *self;
        let body = traits.paint_or(Feature::Body, &[woods()[0], WHITE, woods()[1], woods()[3]]);
        let board = 0.022_f32.min(z * 0.3);
        parts.solid(
            block([-d, -w, z - board], [d, w, z]),
            traits.paint(Feature::Top).unwrap_or(body),
        );
        for [low, high] in [[-w, -w + board], [w - board, w]] {
            parts.solid(block([-d, low, 0.0], [d, high, z - board]), body);
        }
        let detail = traits.paint(Feature::Detail).unwrap_or(body.shaded(0.8));
        parts.solid(
            block([-d, -w + board, 0.0], [-d + 0.012, w - board, z - board]),
            detail,
        );
        let rows = (libm::floorf(z / 0.33) as usize).max(1);
        let pitch = (z - board) / rows as f32;
        for row in 0..rows {
            let low = pitch * row as f32 + if row == 0 { 0.03 } else { 0.0 };
            parts.solid(
                block(
                    [-d + 0.012, -w + board, low],
                    [d - 0.004, w - board, low + board],
                ),
                body,
            );
            // A few books, which nobody can take.
            let mut y = -w + board + 0.02;
            for book in 0..traits.choose(&format!("books {row}"), 7) {
                let thick = 0.02 + 0.006 * traits.choose(&format!("book {row} {book}"), 4) as f32;
                let tall = (pitch - 0.08)
                    .min(0.2 + 0.01 * traits.choose(&format!("tall {row} {book}"), 5) as f32);
                if y + thick > w - board || tall < 0.06 {
                    break;
                }
                let paint = CLOTH[traits.choose(&format!("cover {row} {book}"), CLOTH.len())];
                parts.look(
                    block(
                        [-d + 0.02, y, low + board],
                        [d * 0.6, y + thick, low + board + tall],
                    ),
                    paint,
                );
                y += thick + 0.002;
            }
        }
    }

    /// A drawer front with its handle, on a face that looks to the front.
    pub(super) fn drawer(
        &self,
        parts: &mut Parts,
        [x, y, z]: [f32; 3],
        [half_width, half_height]: [f32; 2],
        body: Paint,
    ) {
        let [half_width, half_height] = [half_width.max(0.02), half_height.max(0.015)];
        let gap = body.shaded(if body.color.iter().all(|c| *c < 90) {
            1.3
        } else {
            0.6
        });
        let (seam_width, seam_height) = (half_width + 0.006, half_height + 0.006);
        parts.look(
            block(
                [x - 0.004, y - seam_width, z - seam_height],
                [x + 0.002, y + seam_width, z + seam_height],
            ),
            gap,
        );
        parts.look(
            block(
                [x - 0.004, y - half_width, z - half_height],
                [x + 0.008, y + half_width, z + half_height],
            ),
            body.shaded(0.98),
        );
        handle(
            parts,
            self.traits,
            [x + 0.008, y, z],
            (half_width * 0.5).min(0.09),
        );
    }
}

/// The handle of a drawer, on its front, whose half length is `length` where it is a bar.
pub(in crate::model) fn handle(
    parts: &mut Parts,
    traits: &Traits,
    [face, y, z]: [f32; 3],
    length: f32,
) {
    let paint = traits.paint_or(
        Feature::Handles,
        &[METAL, DARK, Paint::plain([176, 132, 84])],
    );
    let style = if traits.has(&["knob", "knobs"]) {
        0
    } else if traits.has(&["rectangular", "flat", "pulls", "bar"]) {
        1
    } else {
        traits.choose("handle shape", 3)
    };
    match style {
        0 => {
            parts.look(
                rod(Axis::X, [face + 0.01, y, z], 0.01, 0.009),
                paint.shaded(0.8),
            );
            parts.look(ball([face + 0.022, y, z], 0.017), paint);
        }
        1 => parts.look(
            block(
                [face, y - length, z - 0.014],
                [face + 0.018, y + length, z + 0.014],
            ),
            paint,
        ),
        _ => parts.look(rod(Axis::Y, [face + 0.014, y, z], length, 0.007), paint),
    }
}

/// A kitchen base unit with doors and a worktop that reaches the floor; half depth
/// and half width first.
pub(in crate::model) fn base_cabinet(
    parts: &mut Parts,
    [d, w]: [f32; 2],
    z: f32,
    body: Paint,
    top: Paint,
) {
    let plinth = 0.08_f32.min(z * 0.15);
    let under = z - 0.035_f32.min(z * 0.2);
    parts.solid(
        block(
            [-d + 0.01, -w + 0.01, 0.0],
            [d - 0.05_f32.min(d * 0.5), w - 0.01, plinth],
        ),
        DARK,
    );
    parts.solid(
        block(
            [-d + 0.005, -w + 0.005, plinth],
            [d - 0.02, w - 0.005, under],
        ),
        body.shaded(0.9),
    );
    parts.solid(block([-d, -w, under], [d, w, z]), top);
    let doors = (libm::floorf(2.0 * w / 0.45) as usize).clamp(1, 8);
    let width = 2.0 * w / doors as f32;
    for index in 0..doors {
        let low = -w + width * index as f32;
        let [from, to] = [
            [d - 0.024, low + 0.008, plinth + 0.008],
            [d - 0.012, low + width - 0.008, under - 0.012],
        ];
        parts.look(block(from, to), body);
        let y = if index % 2 == 0 {
            low + width - 0.05
        } else {
            low + 0.05
        };
        parts.look(
            rod(
                Axis::Z,
                [d - 0.004, y, under - 0.12_f32.min(z * 0.3)],
                0.05_f32.min(z * 0.2),
                0.006,
            ),
            METAL,
        );
    }
}
