//! Beds with bedding, pillows and a headboard.

use super::{CLOTH, Piece, corners, woods};
use crate::model::{
    layout::{BACK, FRONT, LEFT, RIGHT},
    looks::{Feature, Paint},
    parts::{Axis, Parts, block, rod},
};

impl Piece<'_> {
    pub(super) fn bed(&self, parts: &mut Parts) {
        let Self {
            d, w, z, traits, ..
        } = *self;
        let frame = traits.paint_or(Feature::Legs, &woods());
        let cloth = traits
            .paint(Feature::Bedding)
            .or(traits.paint(Feature::Body));
        let bedding = cloth.unwrap_or(CLOTH[traits.choose("bedding", CLOTH.len())]);
        let pillow = traits
            .paint(Feature::Pillows)
            .unwrap_or(Paint::plain(match bedding.color {
                [r, g, b] if u32::from(r) + u32::from(g) + u32::from(b) < 240 => [96, 96, 102],
                _ => [246, 246, 244],
            }));
        let side = |index: usize, most: f32| (self.free[index] * 0.5).min(most);
        let (left, right, front) = (side(LEFT, 0.04), side(RIGHT, 0.04), side(FRONT, 0.04));
        let head = self.free[BACK].min(0.42);
        let mattress = z * 0.55;
        parts.solid(
            block(
                [-d - head, -w - right, z * 0.2],
                [d + front, w + left, mattress],
            ),
            frame,
        );
        for (x, y) in corners(d - 0.05, w - 0.05) {
            parts.solid(
                block([x - 0.04, y - 0.04, 0.0], [x + 0.04, y + 0.04, z * 0.2]),
                frame.shaded(0.8),
            );
        }
        parts.solid(
            block(
                [-d - head, -w - right * 0.8, mattress],
                [d + front * 0.8, w + left * 0.8, z],
            ),
            bedding,
        );
        // A sheet of the second colour hangs over the sides, a runner of it lies across the foot.
        let second = if traits.has(&["layered", "runner"]) {
            Paint::glossy(bedding.accent)
        } else {
            bedding.shaded(0.94)
        };
        let hem = z - (z - mattress) * 0.45;
        parts.look(
            block([-d, -w - right, hem], [d + front, w + left, z - 0.004]),
            second,
        );
        if traits.has(&["runner", "layered"]) {
            parts.look(
                block([d * 0.3, -w - right, hem], [d * 0.75, w + left, z + 0.0012]),
                second.shaded(0.85),
            );
        }
        if head >= 0.03 {
            let board = head.min(0.05);
            parts.solid(
                block(
                    [-d - head - 0.002, -w - right, 0.0],
                    [-d - head + board, w + left, z + 0.38],
                ),
                frame,
            );
            let count = if w > 0.55 { 2 } else { 1 };
            let (depth, half) = (head - board, w / count as f32);
            for index in 0..count {
                let y = -w + half * (2.0 * index as f32 + 1.0);
                let [near, far] = [-d - depth + 0.01, -d - 0.005];
                if far - near > 0.08 {
                    let (thick, middle) = (0.055_f32.min((far - near) * 0.4), (near + far) * 0.5);
                    parts.look(
                        block(
                            [near, y - half * 0.8, z],
                            [far, y + half * 0.8, z + thick * 1.3],
                        ),
                        pillow,
                    );
                    parts.look(
                        rod(Axis::Y, [middle, y, z + thick], half * 0.76, thick),
                        pillow.shaded(1.03),
                    );
                }
            }
        }
    }
}
