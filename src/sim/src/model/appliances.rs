//! Kitchen and bathroom pieces: sinks, pots on their stove, lids, and box shells that open
//! at the front with a hinged door. Built like [`super::furniture`]; a door is a body of its
//! own around its hinge.

use std::f32::consts::FRAC_PI_2;

use reel_world::Door;

use super::{
    DoorModel, DoorMotion,
    furniture::{base_cabinet, corners, woods},
    layout::{BACK, LEFT, RIGHT, Spot},
    looks::{Feature, Paint, Traits},
    parts::{Axis, Frame, Parts, block, pillar, rod},
};
use crate::geometry::{Pattern, Pose};

const STEEL: Paint = Paint {
    color: [176, 180, 184],
    accent: [224, 226, 228],
    pattern: Pattern::Glossy,
};
const DARK: Paint = Paint::plain([40, 41, 44]);
const WHITE: Paint = Paint::plain([238, 238, 235]);
const CERAMIC: Paint = Paint {
    color: [244, 244, 241],
    accent: [255, 255, 255],
    pattern: Pattern::Glossy,
};
/// Thickness of the shell of a box and of its door, in metres.
const SHELL_M: f32 = 0.03;
/// Gap between a shell and its closed door, in metres.
const DOOR_GAP_M: f32 = 0.002;

/// A box that opens at the front.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Enclosure {
    Washer,
    Oven,
    Microwave,
    Cooker,
    Refrigerator,
    Cupboard,
}

impl Enclosure {
    /// By the letters of a category; boxes without a door only if they are appliances.
    pub(super) fn of(category: &str, has_door: bool) -> Option<Self> {
        let is = |kinds: &[&str]| kinds.iter().any(|kind| category.contains(kind));
        Some(
            if is(&["wash", "dryer", "laundry"])
                && (has_door || is(&["machine", "washer", "dryer"]))
            {
                Enclosure::Washer
            } else if is(&["microwave", "toasteroven"]) {
                Enclosure::Microwave
            } else if is(&["cooker"]) {
                Enclosure::Cooker
            } else if is(&["oven"]) {
                Enclosure::Oven
            } else if is(&["fridge", "refrigerator", "freezer"]) {
                Enclosure::Refrigerator
            } else if has_door {
                Enclosure::Cupboard
            } else {
                return None;
            },
        )
    }

    /// Least depth and width of an interior whose extent the scene is not sure of, in metres.
    pub(super) fn least_size(self) -> [f32; 2] {
        match self {
            Enclosure::Microwave | Enclosure::Cupboard => [0.4, 0.45],
            _ => [0.5, 0.5],
        }
    }

    /// Free height inside, in metres.
    pub(super) fn clearance(self) -> f32 {
        match self {
            Enclosure::Microwave => 0.35,
            Enclosure::Refrigerator => 0.5,
            Enclosure::Washer | Enclosure::Cooker => 0.42,
            Enclosure::Oven | Enclosure::Cupboard => 0.4,
        }
    }
}

/// Builds a box shell around an interior whose floor has height `z`; gives its door, closed,
/// in the scene frame.
pub(super) fn enclosure(
    kind: Enclosure,
    door: Door,
    spot: &Spot,
    z: f32,
    traits: &Traits,
    parts: &mut Parts,
) -> Option<DoorModel> {
    let (d, w, t) = (spot.half_depth, spot.half_width, SHELL_M);
    let ceiling = z + kind.clearance();
    let body = match kind {
        Enclosure::Washer | Enclosure::Refrigerator => {
            traits.paint_or(Feature::Body, &[WHITE, STEEL])
        }
        Enclosure::Cupboard => traits.paint_or(Feature::Body, &[WHITE, woods()[0], woods()[1]]),
        _ => traits.paint_or(Feature::Body, &[STEEL, DARK, WHITE]),
    };
    let inside = body.shaded(if body.color[0] < 90 { 1.25 } else { 0.82 });
    let (back, right, left) = (-d - t, -w - t, w + t);
    // The front of the floor and of the walls, the back of the closed door.
    let front = d + 0.004;
    let floor = match kind {
        Enclosure::Microwave | Enclosure::Cooker if z > 0.5 => {
            let deck = z - t;
            let front = [
                Paint::plain([226, 226, 222]),
                woods()[2],
                Paint::plain([104, 116, 122]),
            ][traits.choose("counter", 3)];
            base_cabinet(parts, [d + t, w + t], deck, front, woods()[3]);
            deck
        }
        _ => 0.0,
    };
    parts.solid(block([back, right, floor], [front, left, z]), body);
    parts.look(
        block([-d, -w, z - 0.01], [front + 0.0005, w, z + 0.0004]),
        inside,
    );
    parts.solid(block([back, right, z], [-d, left, ceiling]), body);
    parts.solid(block([-d, right, z], [front, -w, ceiling]), body);
    parts.solid(block([-d, w, z], [front, left, ceiling]), body);
    let head = match kind {
        Enclosure::Refrigerator => (ceiling + 0.5).max(1.55),
        Enclosure::Washer | Enclosure::Oven => ceiling + 0.1,
        _ => ceiling + t,
    };
    parts.solid(block([back, right, ceiling], [front, left, head]), body);
    let face = front + DOOR_GAP_M;
    match kind {
        Enclosure::Refrigerator => {
            for [low, high] in [[0.06, z - t], [ceiling + t, head - 0.01]] {
                if high - low > 0.1 {
                    parts.look(
                        block([front, right + 0.005, low], [face + t, left - 0.005, high]),
                        body,
                    );
                    let handle = if door == Door::Right {
                        right + 0.06
                    } else {
                        left - 0.06
                    };
                    parts.look(
                        rod(
                            Axis::Z,
                            [face + t + 0.02, handle, (low + high) * 0.5],
                            (high - low) * 0.3,
                            0.01,
                        ),
                        STEEL,
                    );
                }
            }
        }
        Enclosure::Washer | Enclosure::Oven => {
            parts.look(
                block(
                    [front, right + 0.01, ceiling + t],
                    [front + 0.004, left - 0.01, head - 0.01],
                ),
                DARK,
            );
            for share in [-0.6_f32, -0.3, 0.4] {
                parts.look(
                    rod(
                        Axis::X,
                        [front + 0.01, w * share, ceiling + 0.065],
                        0.012,
                        0.018,
                    ),
                    STEEL,
                );
            }
            if z > 0.14 {
                parts.look(
                    block(
                        [front, right + 0.02, 0.03],
                        [front + 0.003, left - 0.02, z - t - 0.01],
                    ),
                    body.shaded(0.92),
                );
            }
        }
        Enclosure::Cupboard | Enclosure::Microwave | Enclosure::Cooker => {}
    }
    door.exists().then(|| {
        let size = [2.0 * (w + t), ceiling + t - (z - t)];
        hinged(
            kind,
            door,
            spot.frame,
            [face, w + t, z - t],
            size,
            body,
            traits,
        )
    })
}

/// A door whose back lies at `x`, between `-y` and `y`, from height `z` on; `size`
/// is width and height.
pub(super) fn hinged(
    kind: Enclosure,
    side: Door,
    frame: Frame,
    [x, y, z]: [f32; 3],
    [width, height]: [f32; 2],
    body: Paint,
    traits: &Traits,
) -> DoorModel {
    // Seen from the front, left is -y. The hinge is on the outer corner, so that the
    // door clears the shell.
    let (hinge, sign) = if side == Door::Right {
        (y, -1.0_f32)
    } else {
        (-y, 1.0_f32)
    };
    let mut parts = Parts::new(Frame::OUTER);
    let sideways =
        |from: f32, to: f32| [(from * sign).min(to * sign), (from * sign).max(to * sign)];
    let panel = |low: [f32; 2], high: [f32; 2], back: f32, front: f32| {
        let [y0, y1] = sideways(low[0], high[0]);
        block([back, y0, low[1]], [front, y1, high[1]])
    };
    let center = [(width * 0.5) * sign, height * 0.5];
    parts.solid(panel([0.0, 0.0], [width, height], -SHELL_M, 0.0), body);
    match kind {
        Enclosure::Washer => {
            let radius = width.min(height) * 0.36;
            parts.look(
                rod(Axis::X, [0.002, center[0], center[1]], 0.008, radius),
                STEEL,
            );
            parts.look(
                rod(Axis::X, [0.006, center[0], center[1]], 0.01, radius * 0.78),
                Paint::glossy([66, 84, 96]),
            );
        }
        Enclosure::Oven | Enclosure::Microwave | Enclosure::Cooker => {
            let (low, high) = ([width * 0.1, height * 0.18], [width * 0.76, height * 0.82]);
            parts.look(panel(low, high, -0.002, 0.003), Paint::glossy([30, 33, 38]));
        }
        Enclosure::Refrigerator | Enclosure::Cupboard => {
            parts.look(
                panel([0.03, 0.03], [width - 0.03, height - 0.03], -0.002, 0.003),
                body.shaded(0.95),
            );
        }
    }
    let handle = traits.paint_or(Feature::Handles, &[STEEL, DARK]);
    let from_edge = (width - 0.045) * sign;
    parts.look(
        rod(Axis::Z, [0.026, from_edge, center[1]], height * 0.28, 0.009),
        handle,
    );
    for share in [0.26, 0.74] {
        parts.look(
            rod(Axis::X, [0.012, from_edge, height * share], 0.014, 0.006),
            handle,
        );
    }
    let outer = x + SHELL_M;
    DoorModel {
        closed: frame.pose(&Pose::at([outer, hinge, z])),
        parts: parts.finish(),
        motion: DoorMotion::Hinge(-FRAC_PI_2 * sign),
        center: frame.point([outer, 0.0, z + height * 0.5]),
        guided: false,
    }
}

/// A counter with a basin whose floor is the surface.
pub(super) fn sink(spot: &Spot, z: f32, traits: &Traits, parts: &mut Parts) {
    let (d, w) = (spot.half_depth, spot.half_width);
    let border = (spot.free_around() * 0.5).clamp(0.005, 0.07);
    let body = [WHITE, Paint::plain([96, 110, 120]), woods()[0]][traits.choose("counter", 3)];
    let basin = traits.paint_or(Feature::Detail, &[CERAMIC]);
    let steel = traits.has(&["steel", "stainless", "metal", "metallic"]);
    let basin = if steel { STEEL } else { basin };
    let top = if steel {
        Paint::grain([70, 70, 74])
    } else {
        traits.paint_or(Feature::Top, &[woods()[2], DARK])
    };
    base_cabinet(parts, [d + border, w + border], z, body, top);
    if traits.has(&["round"]) {
        parts.look(
            pillar([0.0; 2], z - 0.01, z + 0.0008, d.min(w) * 0.98),
            basin,
        );
        parts.look(
            pillar([0.0; 2], z - 0.01, z + 0.0012, d.min(w) * 0.86),
            basin.shaded(0.9),
        );
    } else {
        parts.look(
            block([-d, -w, z - 0.01], [d, w, z + 0.0008]),
            basin.shaded(0.88),
        );
        if traits.has(&["double"]) {
            parts.look(block([-d, -0.012, z - 0.01], [d, 0.012, z + 0.003]), basin);
        }
    }
    let rim = 0.012;
    for [low, high] in [
        [[d, -w - rim], [d + rim, w + rim]],
        [[-d - rim, -w - rim], [-d, w + rim]],
        [[-d, w], [d, w + rim]],
        [[-d, -w - rim], [d, -w]],
    ] {
        parts.look(
            block([low[0], low[1], z - 0.02], [high[0], high[1], z + 0.004]),
            basin,
        );
    }
    let drains: &[f32] = if traits.has(&["double"]) {
        &[-0.5, 0.5]
    } else {
        &[0.0]
    };
    for share in drains {
        parts.look(pillar([0.0, w * share], z - 0.01, z + 0.0016, 0.022), DARK);
    }
    let tap = -d - border * 0.5;
    parts.look(pillar([tap, 0.0], z, z + 0.24, 0.013), STEEL);
    parts.look(
        rod(Axis::X, [tap + 0.07, 0.0, z + 0.24], 0.08, 0.011),
        STEEL,
    );
}

/// A pot on a stove that reaches the floor; the surface is its filled top.
pub(super) fn pot(spot: &Spot, z: f32, traits: &Traits, parts: &mut Parts) {
    let (d, w) = (spot.half_depth, spot.half_width);
    let radius = libm::sqrtf(d * d + w * w) + 0.002;
    let paint = traits.paint_or(
        Feature::Body,
        &[
            STEEL,
            Paint::glossy([150, 44, 40]),
            Paint::glossy([52, 60, 70]),
        ],
    );
    let height = 0.13_f32.min(z * 0.8);
    stove(spot, z - height, radius, parts);
    parts.solid(pillar([0.0; 2], z - height, z, radius), paint);
    parts.look(
        pillar([0.0; 2], z - 0.01, z + 0.0006, radius - 0.006),
        paint.shaded(0.6),
    );
    for y in [-radius - 0.02, radius + 0.02] {
        parts.look(
            block([-0.03, y - 0.022, z - 0.045], [0.03, y + 0.022, z - 0.03]),
            DARK,
        );
    }
}

/// A lid: a disc that lies on what has height `on`, or on a counter of its own
/// where it covers nothing.
pub(super) fn lid(spot: &Spot, z: f32, on: Option<f32>, traits: &Traits, parts: &mut Parts) {
    let (d, w) = (spot.half_depth, spot.half_width);
    let radius = libm::sqrtf(d * d + w * w) + 0.002;
    let paint = traits.paint_or(
        Feature::Body,
        &[
            Paint::glossy([150, 156, 160]),
            Paint::glossy([196, 214, 218]),
        ],
    );
    let below = on.unwrap_or(z - 0.03).clamp(0.0, z - 0.002);
    if on.is_none() {
        stove(spot, below, radius, parts);
    }
    parts.solid(pillar([0.0; 2], below, z, radius), paint);
    parts.look(
        pillar([0.0; 2], below, below + 0.006, radius + 0.006),
        paint.shaded(0.7),
    );
    parts.look(pillar([0.0; 2], z - 0.004, z + 0.0008, radius * 0.18), DARK);
}

/// A base unit with a hob, large enough for a pot of a radius, where the spot leaves room.
fn stove(spot: &Spot, z: f32, radius: f32, parts: &mut Parts) {
    if z < 0.1 {
        return;
    }
    let reach = |half: f32, free: f32| 0.25_f32.max(radius + 0.02).min(half + free).max(radius);
    let depth = reach(spot.half_depth, spot.free[BACK].min(spot.free[0]));
    let width = reach(spot.half_width, spot.free[LEFT].min(spot.free[RIGHT]));
    base_cabinet(
        parts,
        [depth, width],
        z,
        Paint::plain([208, 208, 204]),
        Paint::glossy([34, 35, 38]),
    );
    for (x, y) in corners(depth - 0.05, width - 0.05) {
        parts.look(
            pillar([x, y], z - 0.004, z + 0.001, 0.03),
            Paint::plain([90, 40, 36]),
        );
    }
}
