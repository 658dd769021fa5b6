//! Furniture with shelves, drawers and compartments inside. The piece is what is left of a block
//! when an opening is cut into its front for each part; a part is what stands in its opening.
//!
//! Built in the frame of the piece (x to the front). A part's floor is the slab that its scene
//! gives; an opening reaches from there to the board below the next floor above, or to the top.

use reel_world::{Door, Scene};

use super::{
    appliances::{Enclosure, hinged},
    door::{DoorModel, DoorMotion},
    furniture::{corners, handle, woods},
    layout::{Rectangle, Spot, rectangle},
    looks::{Feature, Paint, Traits},
    parts::{Frame, Parts, block},
};
use crate::geometry::Pose;

/// Thickness of boards and panels, in metres.
const BOARD_M: f32 = 0.018;
/// Thickness of the sides and the back of a drawer, in metres.
const DRAWER_WALL_M: f32 = 0.01;
/// Gap around a drawer, in metres.
const GAP_M: f32 = 0.003;
/// How far the front of a drawer covers the boards around its opening, in metres.
const FRONT_OVERLAP_M: f32 = 0.007;
/// A body whose lowest opening is above this height stands on legs, in metres.
const LEGS_FROM_M: f32 = 0.35;
/// Least width of what stands beside the openings, in metres.
const SIDE_M: f32 = 0.02;
/// Share of its depth that a drawer comes out.
const EXTENSION: f32 = 0.92;
/// Share of the height of its opening that the sides of a drawer take.
const DRAWER_SIDES: f32 = 0.6;

/// The hole for one part, in the frame of the piece.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Opening {
    /// Index of the part in the scene.
    pub(super) part: usize,
    /// The hole in the plane of the front: lower and upper corner as y, z.
    hole: [[f32; 2]; 2],
    /// The surface of the part: lower and upper corner as x, y.
    surface: Rectangle,
    /// Height of the surface.
    floor: f32,
}

/// A part as it is built.
pub(super) struct BuiltPart {
    pub(super) door: Option<DoorModel>,
    /// Free height above its surface, in metres.
    pub(super) clearance: f32,
}

/// A piece of furniture and the openings in it.
pub(super) struct Cabinet {
    spot: Spot,
    top: f32,
    openings: Vec<Opening>,
}

impl Cabinet {
    /// The piece of an index with its parts; `None` if it has none.
    pub(super) fn of(scene: &Scene, whole: usize, spot: Spot) -> Option<Self> {
        let id = &scene.receptacles[whole].id;
        let top = scene.receptacles[whole].surface_max[2] as f32;
        let parts = scene.receptacles.iter().enumerate();
        let parts = parts.filter(|(_, part)| part.part_of.as_ref() == Some(id));
        let mut openings: Vec<Opening> = parts
            .map(|(index, part)| {
                let surface = inside(&spot.frame, rectangle(part));
                let walls = match part.door {
                    Door::Drawer => DRAWER_WALL_M + GAP_M,
                    _ => 0.0,
                };
                let side = spot.half_width - SIDE_M * 0.5;
                Opening {
                    part: index,
                    hole: [
                        [
                            (surface[0][1] - walls).max(-side),
                            part.surface_min[2] as f32 - GAP_M,
                        ],
                        [(surface[1][1] + walls).min(side), top - BOARD_M],
                    ],
                    surface,
                    floor: part.surface_max[2] as f32,
                }
            })
            .collect();
        for index in 0..openings.len() {
            let mine = openings[index];
            let above = openings.iter().filter(|other| {
                other.hole[0][0] < mine.hole[1][0]
                    && mine.hole[0][0] < other.hole[1][0]
                    && other.hole[0][1] > mine.floor
            });
            let ceiling = above.fold(mine.hole[1][1], |least, other| {
                least.min(other.hole[0][1] - BOARD_M)
            });
            openings[index].hole[1][1] = ceiling.max(mine.floor + 0.01);
        }
        (!openings.is_empty()).then_some(Self {
            spot,
            top,
            openings,
        })
    }

    /// Builds the piece around its openings.
    pub(super) fn build(&self, traits: &Traits, parts: &mut Parts) {
        let (d, w) = (self.spot.half_depth, self.spot.half_width);
        let body = body_of(traits);
        let top = traits.paint(Feature::Top).unwrap_or(body.shaded(1.08));
        let under = self.top - BOARD_M;
        parts.solid(block([-d, -w, under], [d, w, self.top]), top);
        let [low, high] = self.block(under);
        parts.solid(
            block([-d, low[0], low[1]], [-d + BOARD_M, high[0], high[1]]),
            body.shaded(0.9),
        );
        for [from, to] in self.boards(low, high) {
            parts.solid(
                block([-d + BOARD_M, from[0], from[1]], [d, to[0], to[1]]),
                body,
            );
        }
        if low[1] > LEGS_FROM_M {
            let legs = traits.paint(Feature::Legs).unwrap_or(body.shaded(0.86));
            for (x, y) in corners(d - 0.03, w - 0.03) {
                let foot = if (low[0]..=high[0]).contains(&y) {
                    low[1]
                } else {
                    under
                };
                parts.solid(
                    block([x - 0.022, y - 0.022, 0.0], [x + 0.022, y + 0.022, foot]),
                    legs,
                );
            }
            return;
        }
        parts.solid(
            block(
                [-d + 0.01, low[0] + 0.01, 0.0],
                [d - 0.03, high[0] - 0.01, low[1]],
            ),
            body.shaded(0.75),
        );
        // A table top that reaches beyond the body stands on a side there.
        for (from, to) in [(-w, low[0]), (high[0], w)] {
            if to - from > 0.1 {
                let at = if from < low[0] { from } else { to - 0.03 };
                parts.solid(
                    block([-d + 0.01, at, 0.0], [d - 0.02, at + 0.03, under]),
                    body.shaded(0.92),
                );
            }
        }
    }

    /// The block that the openings are cut into, up to a height: its corners as y, z.
    fn block(&self, under: f32) -> [[f32; 2]; 2] {
        let (mut low, mut high) = ([f32::MAX; 2], [f32::MIN; 2]);
        for Opening { hole, .. } in &self.openings {
            low = [low[0].min(hole[0][0]), low[1].min(hole[0][1])];
            high = [high[0].max(hole[1][0]), high[1].max(hole[1][1])];
        }
        let w = self.spot.half_width;
        // What is nearly as wide as the top is as wide.
        let side = |edge: f32| if w - edge < 0.15 { w } else { edge + SIDE_M };
        [
            [-side(-low[0]), (low[1] - BOARD_M).max(0.0)],
            [side(high[0]), under],
        ]
    }

    /// What is left of the block around the openings, as rectangles y, z: one for each run of
    /// a band between two heights at which an opening begins or ends.
    fn boards(&self, low: [f32; 2], high: [f32; 2]) -> Vec<[[f32; 2]; 2]> {
        let cuts = |axis: usize| {
            let edges = self
                .openings
                .iter()
                .flat_map(|opening| opening.hole.map(|corner| corner[axis]));
            let mut cuts: Vec<f32> = edges.chain([low[axis], high[axis]]).collect();
            cuts.sort_by(f32::total_cmp);
            cuts.dedup();
            cuts.retain(|cut| (low[axis]..=high[axis]).contains(cut));
            cuts
        };
        let (ys, zs) = (cuts(0), cuts(1));
        let is_open = |y: f32, z: f32| {
            self.openings.iter().any(|Opening { hole, .. }| {
                (hole[0][0]..hole[1][0]).contains(&y) && (hole[0][1]..hole[1][1]).contains(&z)
            })
        };
        let mut boards = Vec::new();
        for band in zs.windows(2) {
            let middle = (band[0] + band[1]) * 0.5;
            let mut from = None;
            for span in ys.windows(2) {
                if is_open((span[0] + span[1]) * 0.5, middle) {
                    if let Some(start) = from.take() {
                        boards.push([[start, band[0]], [span[0], band[1]]]);
                    }
                } else {
                    from.get_or_insert(span[0]);
                }
            }
            if let Some(start) = from {
                boards.push([[start, band[0]], [high[0], band[1]]]);
            }
        }
        boards
    }

    /// Builds the part of an index of the scene. What its scene does not say it takes from the
    /// `whole`.
    pub(super) fn part(
        &self,
        part: usize,
        door: Door,
        [own, whole]: [&Traits; 2],
        parts: &mut Parts,
    ) -> BuiltPart {
        let opening = self.openings.iter().find(|opening| opening.part == part);
        let opening = opening.expect("a part has an opening in its whole");
        let body = own.paint(Feature::Body).unwrap_or(body_of(whole));
        let [[y0, low], [y1, high]] = opening.hole;
        let d = self.spot.half_depth;
        let clearance = high - opening.floor - if door == Door::Drawer { GAP_M } else { 0.0 };
        if door == Door::Drawer {
            let door = self.drawer(opening, body, whole);
            return BuiltPart {
                door: Some(door),
                clearance,
            };
        }
        let inside = body.shaded(if body.color[0] < 90 { 1.25 } else { 0.85 });
        parts.solid(
            block([-d + BOARD_M, y0, low], [d - 0.002, y1, opening.floor]),
            inside,
        );
        parts.look(
            block(
                [-d + BOARD_M, y0, opening.floor],
                [-d + BOARD_M + 0.002, y1, high],
            ),
            inside.shaded(0.9),
        );
        let door = door.exists().then(|| {
            let frame = self.frame_at((y0 + y1) * 0.5);
            let size = [y1 - y0 + 2.0 * FRONT_OVERLAP_M, high - low];
            let back = [d + GAP_M, size[0] * 0.5, low];
            DoorModel {
                guided: true,
                ..hinged(Enclosure::Cupboard, door, frame, back, size, body, whole)
            }
        });
        BuiltPart { door, clearance }
    }

    fn drawer(&self, opening: &Opening, body: Paint, whole: &Traits) -> DoorModel {
        let [[y0, low], [y1, high]] = opening.hole;
        let d = self.spot.half_depth;
        let (middle, half) = ((y0 + y1) * 0.5, (y1 - y0) * 0.5 - GAP_M);
        // In the frame of the drawer, from whose origin x goes to the front.
        let bottom = low + GAP_M;
        let back = (opening.surface[0][0] - d)
            .min(-0.05)
            .max(-2.0 * d + BOARD_M);
        let floor = (opening.floor - bottom).max(0.004);
        let sides = floor + (high - opening.floor) * DRAWER_SIDES;
        let wood = Paint::plain([214, 190, 150]);
        let mut parts = Parts::new(Frame::OUTER);
        parts.solid(block([back, -half, 0.0], [0.0, half, floor]), wood);
        for [from, to] in [[-half, -half + DRAWER_WALL_M], [half - DRAWER_WALL_M, half]] {
            parts.solid(
                block([back, from, floor], [0.0, to, sides]),
                wood.shaded(0.94),
            );
        }
        let wall = DRAWER_WALL_M;
        parts.solid(
            block(
                [back, -half + wall, floor],
                [back + wall, half - wall, sides],
            ),
            wood.shaded(0.9),
        );
        let (width, bottom_edge, top_edge) = (
            half + GAP_M + FRONT_OVERLAP_M,
            -GAP_M - FRONT_OVERLAP_M,
            high - bottom + FRONT_OVERLAP_M,
        );
        parts.solid(
            block([0.0, -width, bottom_edge], [BOARD_M, width, top_edge]),
            body.shaded(0.98),
        );
        let grip = (bottom_edge + top_edge) * 0.5;
        handle(
            &mut parts,
            whole,
            [BOARD_M, 0.0, grip],
            (width * 0.5).min(0.09),
        );
        let closed = self.spot.frame.pose(&Pose::at([d, middle, bottom]));
        let center = self.spot.frame.point([d + BOARD_M, middle, bottom + grip]);
        DoorModel {
            closed,
            parts: parts.finish(),
            motion: DoorMotion::Slide(-back * EXTENSION),
            center,
            guided: true,
        }
    }

    /// The frame of the piece, moved to its left.
    fn frame_at(&self, y: f32) -> Frame {
        let Frame { quarters, .. } = self.spot.frame;
        let [x, y, _] = self.spot.frame.point([0.0, y, 0.0]);
        Frame {
            origin: [x, y],
            quarters,
        }
    }
}

/// What the body of a piece looks like.
fn body_of(traits: &Traits) -> Paint {
    let [light, dark, pale, red] = woods();
    let white = Paint::plain([236, 235, 230]);
    traits.paint_or(Feature::Body, &[white, dark, light, red, pale])
}

/// A rectangle of the outer frame in a frame that stands in it.
fn inside(frame: &Frame, rectangle: Rectangle) -> Rectangle {
    let back = Frame {
        origin: [0.0; 2],
        quarters: 4 - frame.quarters % 4,
    };
    let [a, b] = rectangle
        .map(|corner| back.turn([0, 1].map(|axis: usize| corner[axis] - frame.origin[axis])));
    [
        [a[0].min(b[0]), a[1].min(b[1])],
        [a[0].max(b[0]), a[1].max(b[1])],
    ]
}
