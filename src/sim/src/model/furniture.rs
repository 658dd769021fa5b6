//! Open furniture: tables, desks, cabinets, beds, couches, shelves, seats, and a plain block for
//! what we do not know.
//!
//! Everything is built in the frame of its [`Spot`]: x to the front, the surface centred over the
//! origin. Solid parts never stand above the surface inside its rectangle; backs, arms and
//! headboards go where the spot is free.

use super::{
    layout::{BACK, FRONT, LEFT, RIGHT, Spot},
    looks::{Feature, Paint, Traits},
    parts::{Axis, Parts, ball, block, pillar, rod},
};
use crate::geometry::Pattern;

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
    fn table(&self, free_around: f32, parts: &mut Parts) {
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

    fn desk(&self, parts: &mut Parts) {
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

    fn cabinet(&self, parts: &mut Parts) {
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

    fn counter(&self, parts: &mut Parts) {
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

    fn bed(&self, parts: &mut Parts) {
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

    fn couch(&self, parts: &mut Parts) {
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

    fn shelf(&self, parts: &mut Parts) {
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

    fn seat(&self, parts: &mut Parts) {
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

    fn bench(&self, parts: &mut Parts) {
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

    /// A drawer front with its handle, on a face that looks to the front.
    fn drawer(
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
pub(super) fn handle(parts: &mut Parts, traits: &Traits, [face, y, z]: [f32; 3], length: f32) {
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
pub(super) fn base_cabinet(parts: &mut Parts, [d, w]: [f32; 2], z: f32, body: Paint, top: Paint) {
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

/// The four corners of a rectangle around the origin; never past the middle.
pub(super) fn corners(x: f32, y: f32) -> [(f32, f32); 4] {
    let (x, y) = (x.max(0.001), y.max(0.001));
    [(x, y), (-x, y), (-x, -y), (x, -y)]
}
