//! Open furniture: tables, desks, cabinets, beds, couches, shelves, seats, and a plain block for
//! what we do not know.
//!
//! Everything is built in the frame of its [`Spot`]: x to the front, the surface centred over the
//! origin. Solid parts never stand above the surface inside its rectangle; backs, arms and
//! headboards go where the spot is free.

mod beds;
mod seating;
mod storage;
mod tables;

use super::{
    layout::Spot,
    looks::{Feature, Paint, Traits},
    parts::{Parts, block},
};
use crate::geometry::Pattern;
pub(super) use storage::{base_cabinet, handle};

const WHITE: Paint = Paint::plain([236, 235, 230]);
const DARK: Paint = Paint::plain([44, 43, 44]);
const CLOTH: [Paint; 5] = [
    Paint::plain([104, 116, 132]),
    Paint::plain([150, 140, 126]),
    Paint::plain([86, 110, 98]),
    Paint::plain([128, 84, 76]),
    Paint::plain([188, 178, 162]),
];
const METAL: Paint = Paint {
    color: [168, 172, 176],
    accent: [214, 216, 218],
    pattern: Pattern::Glossy,
};

/// Woods that furniture is made of where no caption says.
pub(super) fn woods() -> [Paint; 4] {
    [
        [186, 142, 92],
        [112, 78, 54],
        [212, 176, 126],
        [148, 100, 62],
    ]
    .map(Paint::grain)
}

/// What kind of furniture to build.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Kind {
    Table,
    Desk,
    Cabinet,
    Counter,
    Bed,
    Couch,
    Shelf,
    Seat,
    Bench,
    Block,
}

impl Kind {
    /// By the letters of a category, e.g. `coffeetable`.
    pub(super) fn of(category: &str) -> Self {
        let is = |kinds: &[&str]| kinds.iter().any(|kind| category.contains(kind));
        if is(&[
            "cabinet",
            "nightstand",
            "dresser",
            "drawer",
            "chest",
            "wardrobe",
            "sideboard",
            "tvstand",
            "credenza",
            "buffet",
        ]) || is(&["vanity", "cupboard", "bedside", "console", "tvunit"])
        {
            Kind::Cabinet
        } else if is(&["shelf", "bookcase", "rack"]) {
            Kind::Shelf
        } else if is(&["counter", "island", "stove", "hob", "worktop"]) {
            Kind::Counter
        } else if is(&["desk"]) {
            Kind::Desk
        } else if is(&["couch", "sofa", "armchair", "loveseat", "recliner"]) && !is(&["table"]) {
            Kind::Couch
        } else if is(&["bench", "ottoman", "pouf"]) {
            Kind::Bench
        } else if is(&["stool", "chair"]) {
            Kind::Seat
        } else if is(&["table", "stand"]) {
            Kind::Table
        } else if category == "bed" || is(&["daybed", "bunkbed", "singlebed", "doublebed"]) {
            Kind::Bed
        } else {
            Kind::Block
        }
    }

    /// Least depth and width of a surface whose extent the scene is not sure of, in metres.
    pub(super) fn least_size(self) -> [f32; 2] {
        match self {
            Kind::Table => [0.6, 0.6],
            Kind::Desk => [0.5, 1.0],
            Kind::Cabinet => [0.35, 0.4],
            Kind::Counter => [0.5, 0.6],
            Kind::Bed => [1.6, 1.2],
            Kind::Couch => [0.7, 0.8],
            Kind::Shelf => [0.3, 0.6],
            Kind::Seat => [0.35, 0.35],
            Kind::Bench => [0.35, 0.9],
            Kind::Block => [0.4, 0.4],
        }
    }
}

/// Builds open furniture whose surface has height `z`.
pub(super) fn build(kind: Kind, spot: &Spot, z: f32, traits: &Traits, parts: &mut Parts) {
    let piece = Piece {
        d: spot.half_depth,
        w: spot.half_width,
        z,
        free: spot.free,
        traits,
    };
    match kind {
        Kind::Table => piece.table(spot.free_around(), parts),
        Kind::Desk => piece.desk(parts),
        Kind::Cabinet => piece.cabinet(parts),
        Kind::Counter => piece.counter(parts),
        Kind::Bed => piece.bed(parts),
        Kind::Couch => piece.couch(parts),
        Kind::Shelf => piece.shelf(parts),
        Kind::Seat => piece.seat(parts),
        Kind::Bench => piece.bench(parts),
        Kind::Block => piece.block(parts),
    }
}

/// Half depth and half width of the surface, its height, the room around it, and what
/// people say of it.
struct Piece<'a> {
    d: f32,
    w: f32,
    z: f32,
    free: [f32; 4],
    traits: &'a Traits,
}

impl Piece<'_> {
    fn block(&self, parts: &mut Parts) {
        let Self {
            d, w, z, traits, ..
        } = *self;
        let body = traits.paint_or(
            Feature::Body,
            &[WHITE, woods()[0], woods()[1], CLOTH[0], CLOTH[4]],
        );
        let under = z - 0.02_f32.min(z * 0.3);
        parts.solid(
            block([-d + 0.01, -w + 0.01, 0.0], [d - 0.01, w - 0.01, under]),
            body,
        );
        parts.solid(
            block([-d, -w, under], [d, w, z]),
            traits.paint(Feature::Top).unwrap_or(body.shaded(0.88)),
        );
    }
}

/// The four corners of a rectangle around the origin; never past the middle.
pub(super) fn corners(x: f32, y: f32) -> [(f32, f32); 4] {
    let (x, y) = (x.max(0.001), y.max(0.001));
    [(x, y), (-x, y), (-x, -y), (x, -y)]
}
