//! Tables on legs, and desks with their drawers.

use super::{Piece, WHITE, corners, woods};
use crate::model::{
    looks::Feature,
    parts::{Parts, block, pillar},
};

impl Piece<'_> {
    pub(super) fn table(&self, free_around: f32, parts: &mut Parts) {
        let Self {
            d, w, z, traits, ..
        } = *self;
        let body = traits.paint_or(Feature::Body, &woods());
        let top = traits.paint(Feature::Top).unwrap_or(body);
        let legs = traits.paint(Feature::Legs).unwrap_or(body.shaded(0.86));
        let thickness = (z * 0.15).min(0.036);
        let under = z - thickness;
        let rounded = traits.has(&["rounded", "round", "oval", "circular"]);
        if rounded {
            let radius = free_around.clamp(0.012, 0.06);
            parts.solid(block([-d, -w - radius, under], [d, w + radius, z]), top);
            parts.solid(block([-d - radius, -w, under], [d + radius, w, z]), top);
            for (x, y) in corners(d, w) {
                parts.solid(pillar([x, y], under, z, radius), top);
            }
        } else {
            let overhang = free_around.clamp(0.0, 0.012);
            parts.solid(
                block(
                    [-d - overhang, -w - overhang, under],
                    [d + overhang, w + overhang, z],
                ),
                top,
            );
        }
        let leg = (d.min(w) * 0.14).clamp(0.018, 0.04);
        let (x, y) = (d - leg - 0.01, w - leg - 0.01);
        let round = rounded || traits.has(&["cylindrical"]) || traits.choose("legs", 3) == 0;
        for (x, y) in corners(x, y) {
            let shape = if round {
                pillar([x, y], 0.0, under, leg)
            } else {
                block([x - leg, y - leg, 0.0], [x + leg, y + leg, under])
            };
            parts.solid(shape, legs);
        }
        if z > 0.45 {
            parts.solid(block([-x, -y, under - 0.07], [x, y, under]), legs);
        } else if traits.choose("lower shelf", 2) == 0 {
            parts.solid(block([-x, -y, z * 0.3], [x, y, z * 0.3 + 0.015]), legs);
        }
    }

    pub(super) fn desk(&self, parts: &mut Parts) {
        let Self {
            d, w, z, traits, ..
        } = *self;
        let body = traits.paint_or(Feature::Body, &[WHITE, woods()[0], woods()[1], woods()[2]]);
        let top = traits.paint(Feature::Top).unwrap_or(body);
        let under = z - 0.03_f32.min(z * 0.2);
        parts.solid(
            block([-d - 0.004, -w - 0.01, under], [d + 0.012, w + 0.01, z]),
            top,
        );
        let single =
            traits.has(&["single", "simple", "cylindrical"]) || traits.choose("drawers", 4) == 0;
        if single {
            let legs = traits.paint(Feature::Legs).unwrap_or(body.shaded(0.92));
            for (x, y) in corners(d - 0.04, w - 0.04) {
                parts.solid(pillar([x, y], 0.0, under, 0.026), legs);
            }
            parts.solid(
                block(
                    [-d + 0.02, -w + 0.02, under - 0.12],
                    [d - 0.005, w - 0.02, under],
                ),
                body.shaded(0.95),
            );
            let front = (w * 0.5).min(0.35);
            self.drawer(parts, [d - 0.005, 0.0, under - 0.06], [front, 0.05], body);
            return;
        }
        let tower = (w * 0.42).min(0.24);
        let sides: &[f32] = if w > 0.6 && traits.has(&["wide", "unit", "large"]) {
            &[-1.0, 1.0]
        } else {
            &[1.0]
        };
        for side in sides {
            let middle = side * (w - tower);
            parts.solid(
                block(
                    [-d + 0.01, middle - tower, 0.0],
                    [d - 0.012, middle + tower, under],
                ),
                body.shaded(0.96),
            );
            for row in 0..3 {
                let height = (under - 0.04) / 3.0;
                let center = 0.03 + height * (row as f32 + 0.5);
                self.drawer(
                    parts,
                    [d - 0.012, middle, center],
                    [tower - 0.015, height * 0.5 - 0.012],
                    body,
                );
            }
        }
        if sides.len() == 1 {
            parts.solid(
                block([-d + 0.01, -w + 0.01, 0.0], [d - 0.03, -w + 0.045, under]),
                body.shaded(0.92),
            );
        }
        parts.look(
            block(
                [-d + 0.012, -w + 0.05, z * 0.45],
                [-d + 0.03, w - tower, under],
            ),
            body.shaded(0.88),
        );
    }
}
