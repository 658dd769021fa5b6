//! What people sit on: couches, seats and benches.

use super::{CLOTH, Piece, corners, woods};
use crate::model::{
    layout::{BACK, LEFT, RIGHT},
    looks::Feature,
    parts::{Axis, Parts, block, pillar, rod},
};

impl Piece<'_> {
    pub(super) fn couch(&self, parts: &mut Parts) {
        let Self {
            d, w, z, traits, ..
        } = *self;
        let cloth = traits
            .paint(Feature::Bedding)
            .unwrap_or_else(|| traits.paint_or(Feature::Body, &CLOTH));
        let arm = |free: f32| (free * 0.5).min(0.13);
        let (left, right) = (arm(self.free[LEFT]), arm(self.free[RIGHT]));
        let back = (self.free[BACK] * 0.6).min(0.2);
        let seat = z * 0.55;
        for (x, y) in corners(d - 0.05, w - 0.05) {
            parts.solid(
                pillar([x, y], 0.0, 0.06_f32.min(seat * 0.5), 0.025),
                woods()[1],
            );
        }
        parts.solid(
            block([-d, -w, 0.06_f32.min(seat * 0.5)], [d, w, seat]),
            cloth.shaded(0.82),
        );
        parts.solid(block([-d, -w, seat], [d, w, z]), cloth);
        let cushions = (libm::floorf(2.0 * w / 0.6) as usize).clamp(1, 4);
        for seam in 1..cushions {
            let y = -w + 2.0 * w * seam as f32 / cushions as f32;
            parts.look(
                block([-d, y - 0.005, seat], [d + 0.002, y + 0.005, z + 0.0008]),
                cloth.shaded(0.6),
            );
        }
        if back > 0.03 {
            parts.solid(
                block([-d - back, -w - right, 0.05], [-d, w + left, z + 0.4]),
                cloth.shaded(0.92),
            );
        }
        for (thick, low, high) in [(left, w, w + left), (right, -w - right, -w)] {
            if thick > 0.03 {
                parts.solid(
                    block([-d - back, low, 0.05], [d, high, z + 0.17]),
                    cloth.shaded(0.88),
                );
                parts.look(
                    rod(Axis::X, [0.0, (low + high) * 0.5, z + 0.17], d, thick * 0.5),
                    cloth.shaded(0.9),
                );
            }
        }
    }

    pub(super) fn seat(&self, parts: &mut Parts) {
        let Self {
            d, w, z, traits, ..
        } = *self;
        let body = traits.paint_or(Feature::Body, &woods());
        let top = traits
            .paint(Feature::Bedding)
            .or(traits.paint(Feature::Top))
            .unwrap_or(body);
        let under = z - 0.03_f32.min(z * 0.3);
        if traits.has(&["round", "circular"]) {
            parts.solid(pillar([0.0; 2], under, z, libm::sqrtf(d * d + w * w)), top);
        } else {
            parts.solid(block([-d, -w, under], [d, w, z]), top);
        }
        let legs = traits.paint(Feature::Legs).unwrap_or(body.shaded(0.85));
        for (x, y) in corners(d - 0.03, w - 0.03) {
            parts.solid(pillar([x, y], 0.0, under, 0.016), legs);
        }
        parts.look(
            rod(
                Axis::Y,
                [d - 0.03, 0.0, z * 0.35],
                (w - 0.03).max(0.01),
                0.009,
            ),
            legs,
        );
        if traits.has(&["chair", "backrest"]) && self.free[BACK] > 0.04 {
            parts.solid(
                block([-d - 0.03, -w, 0.0], [-d, w, z + 0.4]),
                body.shaded(0.92),
            );
        }
    }

    pub(super) fn bench(&self, parts: &mut Parts) {
        let Self {
            d, w, z, traits, ..
        } = *self;
        let body = traits.paint_or(Feature::Body, &woods());
        let top = traits
            .paint(Feature::Bedding)
            .or(traits.paint(Feature::Top))
            .unwrap_or(body);
        let under = z - 0.05_f32.min(z * 0.3);
        parts.solid(block([-d, -w, under], [d, w, z]), top);
        for y in [-w + 0.06, w - 0.06] {
            parts.solid(
                block([-d + 0.02, y - 0.025, 0.0], [d - 0.02, y + 0.025, under]),
                body.shaded(0.85),
            );
        }
        parts.look(
            block(
                [-0.02, -w + 0.06, z * 0.3],
                [0.02, w - 0.06, z * 0.3 + 0.05],
            ),
            body.shaded(0.78),
        );
    }
}
