//! Where furniture stands: the rectangle of its surface, the side its front looks to, the free room
//! around it, and which piece is a lid. Reads the scene only; never builds parts.

use reel_world::{Receptacle, Room, Scene};

use super::parts::Frame;

/// Furniture keeps this distance from the border of its room: half a wall and a little.
const ROOM_MARGIN_M: f32 = 0.06;
/// Narrower room beside furniture is no passage for the robot.
const PASSAGE_M: f32 = 0.36;
/// The body of furniture leaves this much of a passage.
const KEPT_PASSAGE_M: f32 = 0.46;
/// More free room than this does not make a side a better front.
const FREE_ENOUGH_M: f32 = 1.5;

/// An axis-aligned rectangle: lower and upper corner.
pub(super) type Rectangle = [[f32; 2]; 2];

/// Sides of a piece of furniture, as indices of [`Spot::free`].
pub(super) const FRONT: usize = 0;
pub(super) const LEFT: usize = 1;
pub(super) const BACK: usize = 2;
pub(super) const RIGHT: usize = 3;

/// Where a piece of furniture stands.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Spot {
    /// Rectangle of the surface, in the scene frame.
    pub(super) surface: Rectangle,
    /// Its frame: the origin below the middle of the surface, x to the front.
    pub(super) frame: Frame,
    /// Half extent of the surface from back to front.
    pub(super) half_depth: f32,
    /// Half extent of the surface from side to side.
    pub(super) half_width: f32,
    /// Room that the body may take beyond the surface without closing a passage: front, left, back,
    /// right (of the piece itself).
    pub(super) free: [f32; 4],
}

impl Spot {
    /// Finds the spot of receptacle `index`; its surface is grown to the least size (depth, width)
    /// where the scene is not sure of it.
    pub(super) fn of(scene: &Scene, index: usize, least: [f32; 2], front_is_short: bool) -> Self {
        let receptacle = &scene.receptacles[index];
        let given = rectangle(receptacle);
        let free = [0, 1, 2, 3].map(|side| free_room(scene, index, given, side));
        let quarters = match receptacle.facing_deg {
            Some(degrees) => (libm::floor(degrees / 90.0 + 0.5) as i64).rem_euclid(4) as usize,
            None => best_front(given, free, front_is_short),
        };
        let surface = if is_unsure(receptacle) {
            grown(given, least, quarters, free)
        } else {
            given
        };
        let [low, high] = surface;
        let half = [(high[0] - low[0]) * 0.5, (high[1] - low[1]) * 0.5];
        let (half_depth, half_width) = if quarters.is_multiple_of(2) {
            (half[0], half[1])
        } else {
            (half[1], half[0])
        };
        let frame = Frame {
            origin: [(low[0] + high[0]) * 0.5, (low[1] + high[1]) * 0.5],
            quarters,
        };
        let free =
            [0, 1, 2, 3].map(|side| spare(free_room(scene, index, surface, (quarters + side) % 4)));
        Self {
            surface,
            frame,
            half_depth,
            half_width,
            free,
        }
    }

    /// Room on the tightest side.
    pub(super) fn free_around(&self) -> f32 {
        self.free.into_iter().fold(f32::MAX, f32::min)
    }
}

/// The receptacle that each receptacle lies on as its lid, by index.
pub(super) fn covered(scene: &Scene) -> Vec<Option<usize>> {
    let position = |id| {
        scene
            .receptacles
            .iter()
            .position(|receptacle| receptacle.id == id)
    };
    let told: Vec<Option<usize>> = scene
        .receptacles
        .iter()
        .map(|receptacle| receptacle.covers.clone().and_then(position))
        .collect();
    if told.iter().any(Option::is_some) {
        return told;
    }
    let lies_on = |upper: &Receptacle, lower: &Receptacle| {
        let rise = upper.surface_max[2] - lower.surface_max[2];
        let [a, b] = [rectangle(upper), rectangle(lower)];
        upper.part_of.is_none()
            && lower.part_of.is_none()
            && rise > 0.0
            && rise <= 0.06
            && (0..2).all(|axis| a[0][axis] < b[1][axis] && b[0][axis] < a[1][axis])
    };
    let below = |upper| {
        scene
            .receptacles
            .iter()
            .position(|lower| lies_on(upper, lower))
    };
    scene.receptacles.iter().map(below).collect()
}

/// The surface as the scene gives it.
pub(super) fn rectangle(receptacle: &Receptacle) -> Rectangle {
    let corner = |corner: [f64; 3]| [corner[0] as f32, corner[1] as f32];
    [
        corner(receptacle.surface_min),
        corner(receptacle.surface_max),
    ]
}

fn is_unsure(receptacle: &Receptacle) -> bool {
    let text = receptacle
        .extra
        .get("confidence")
        .and_then(|value| value.as_str());
    let synthetic = receptacle
        .extra
        .get("synthetic")
        .and_then(serde_json::Value::as_bool);
    synthetic == Some(true) || matches!(text, Some("low" | "none"))
}

/// Room from a side (0 is +x, then counter-clockwise) to the border of the room or
/// to the next furniture.
fn free_room(scene: &Scene, index: usize, [low, high]: Rectangle, side: usize) -> f32 {
    let receptacle = &scene.receptacles[index];
    let (along, across) = (side % 2, 1 - side % 2);
    let outward = side < 2;
    let edge = if outward { high[along] } else { low[along] };
    let ahead = |coordinate: f32| {
        if outward {
            coordinate - edge
        } else {
            edge - coordinate
        }
    };
    let mut free = f32::MAX;
    if let Some(room) = scene.rooms.iter().find(|room| room.name == receptacle.room) {
        let lines =
            [0.02, 0.5, 0.98].map(|share| low[across] + (high[across] - low[across]) * share);
        for line in lines {
            let mut start = [0.0; 2];
            start[along] = edge;
            start[across] = line;
            free = free.min(room_ahead(room, start, along, outward) - ROOM_MARGIN_M);
        }
    }
    for (other_index, other) in scene.receptacles.iter().enumerate() {
        let [other_low, other_high] = rectangle(other);
        let abreast = other_low[across] < high[across] && low[across] < other_high[across];
        let near = ahead(if outward {
            other_low[along]
        } else {
            other_high[along]
        });
        let passes = ahead(if outward {
            other_high[along]
        } else {
            other_low[along]
        }) > 0.0;
        let apart = other_index != index && other.part_of.is_none();
        if apart && abreast && passes && near > -0.02 {
            free = free.min(near - ROOM_MARGIN_M);
        }
    }
    if free == f32::MAX { 1.0 } else { free.max(0.0) }
}

/// What of the free room on a side the body may take.
fn spare(free: f32) -> f32 {
    if free < PASSAGE_M {
        free
    } else {
        (free - KEPT_PASSAGE_M).max(0.0)
    }
}

/// Distance from a point to the border of a room along an axis, across its rectangles.
fn room_ahead(room: &Room, start: [f32; 2], along: usize, outward: bool) -> f32 {
    const STEP: f32 = 0.01;
    let footprint = room.footprint();
    let mut point = start;
    for _ in 0..footprint.len() {
        let mut probe = point;
        probe[along] += if outward { STEP } else { -STEP };
        let Some(rect) = footprint
            .iter()
            .find(|rect| rect.contains(probe.map(f64::from)))
        else {
            break;
        };
        point[along] = if outward {
            rect.max[along]
        } else {
            rect.min[along]
        } as f32;
    }
    libm::fabsf(point[along] - start[along])
}

/// The freest side; of equals one along the favoured edge, then the first of +x, +y, -x, -y.
fn best_front([low, high]: Rectangle, free: [f32; 4], front_is_short: bool) -> usize {
    let size = [high[0] - low[0], high[1] - low[1]];
    let score = |side: usize| {
        // The edge of side 0 runs along y.
        let (edge, other) = (size[1 - side % 2], size[side % 2]);
        let favoured = if front_is_short {
            other > edge * 1.3
        } else {
            edge > other * 1.3
        };
        let room = free[side].min(FREE_ENOUGH_M);
        libm::floorf(room * 100.0) + if favoured && room > 0.5 { 40.0 } else { 0.0 }
    };
    let mut best = 0;
    for side in 1..4 {
        if score(side) > score(best) {
            best = side;
        }
    }
    best
}

/// A rectangle grown around its centre to a least (depth, width), as far as there is room.
fn grown(given: Rectangle, least: [f32; 2], quarters: usize, free: [f32; 4]) -> Rectangle {
    let [mut low, mut high] = given;
    for axis in 0..2 {
        let wanted = if (quarters + axis).is_multiple_of(2) {
            least[0]
        } else {
            least[1]
        };
        let missing = ((wanted - (high[axis] - low[axis])) * 0.5).max(0.0);
        high[axis] += missing.min(free[axis]);
        low[axis] -= missing.min(free[axis + 2]);
    }
    [low, high]
}
