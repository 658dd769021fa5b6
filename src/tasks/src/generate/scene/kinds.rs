//! Furniture and rooms that generated scenes consist of: how large pieces are, how they stand, and
//! what belongs into a room.
//!
//! Only categories that the simulator has a model for. Lengths are whole cells of 5 cm.

/// Cells in a metre.
pub(super) const CELLS_PER_M: f64 = 20.0;

/// How a piece stands in its room.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Stand {
    /// With its back to a wall, free in front.
    Wall,
    /// As `Wall`, best side by side with others of its kind: kitchens.
    Row,
    /// With its head to a wall, free at its sides.
    Bed,
    /// Beside the head of a bed.
    BesideBed,
    /// Opposite the couch of the room and in line with it: TV stands.
    OppositeCouch,
    /// Before the couch, or in the middle.
    BeforeCouch,
    /// In the middle, free all around.
    Middle,
}

/// A kind of furniture in a kind of room.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Kind {
    /// Least and greatest width (side to side) and depth of the surface.
    pub(super) width: [i32; 2],
    pub(super) depth: [i32; 2],
    /// Height of the surface, in cm.
    pub(super) height_cm: [i32; 2],
    /// From the wall to the surface.
    pub(super) back: i32,
    /// What the body has beyond the surface at either side, and in front.
    pub(super) side: i32,
    pub(super) front: i32,
    pub(super) door: bool,
    pub(super) stand: Stand,
}

const fn open(width: [i32; 2], depth: [i32; 2], height_cm: [i32; 2]) -> Kind {
    Kind {
        width,
        depth,
        height_cm,
        back: 2,
        side: 0,
        front: 0,
        door: false,
        stand: Stand::Wall,
    }
}

const fn closed(width: [i32; 2], depth: [i32; 2], height_cm: [i32; 2]) -> Kind {
    Kind {
        side: 1,
        front: 2,
        door: true,
        stand: Stand::Row,
        ..open(width, depth, height_cm)
    }
}

/// The kind of a category in a kind of room; none where we do not make such a piece.
pub(super) fn kind(category: &str, room: &str) -> Option<Kind> {
    Some(match (category, room) {
        ("bed", _) => Kind {
            back: 8,
            side: 1,
            front: 1,
            stand: Stand::Bed,
            ..open([20, 34], [40, 40], [44, 52])
        },
        ("couch", _) => Kind {
            back: 6,
            side: 3,
            ..open([32, 38], [14, 15], [40, 44])
        },
        ("table", "dining room") => Kind {
            stand: Stand::Middle,
            ..open([28, 34], [16, 18], [72, 76])
        },
        ("table", "living room") => Kind {
            stand: Stand::BeforeCouch,
            ..open([20, 24], [11, 13], [40, 46])
        },
        ("tea table", _) => Kind {
            stand: Stand::BeforeCouch,
            ..open([18, 22], [11, 13], [38, 44])
        },
        ("table", "balcony") => open([14, 17], [13, 14], [68, 74]),
        ("table", _) => open([17, 20], [13, 15], [72, 76]),
        ("desk", _) => open([24, 28], [12, 13], [72, 76]),
        ("cabinet", "living room") => open([26, 32], [8, 9], [52, 60]),
        ("cabinet", "dining room") => open([22, 28], [8, 9], [78, 86]),
        ("cabinet", "bathroom" | "toilet" | "washroom" | "corridor" | "entry" | "balcony") => {
            open([14, 17], [7, 7], [76, 86])
        }
        ("cabinet", _) => open([18, 22], [8, 9], [76, 96]),
        ("shoe cabinet", _) => open([16, 20], [7, 7], [76, 90]),
        ("chest of drawers", _) => open([18, 22], [9, 9], [84, 94]),
        ("nightstand", _) => Kind {
            stand: Stand::BesideBed,
            ..open([9, 10], [8, 8], [46, 54])
        },
        ("tv stand", _) => Kind {
            stand: Stand::OppositeCouch,
            ..open([26, 32], [8, 9], [46, 54])
        },
        ("shelf", _) => open([18, 22], [8, 8], [76, 92]),
        ("counter", _) => Kind {
            stand: Stand::Row,
            ..open([22, 30], [12, 12], [88, 92])
        },
        ("sink", _) => Kind {
            back: 3,
            side: 2,
            front: 2,
            stand: Stand::Row,
            ..open([10, 12], [9, 9], [82, 86])
        },
        ("refrigerator" | "fridge", _) => closed([12, 12], [11, 11], [88, 92]),
        ("microwave", _) => closed([11, 11], [10, 10], [96, 100]),
        ("electric cooker", _) => closed([10, 11], [10, 10], [86, 92]),
        ("washing machine", _) => closed([12, 12], [11, 11], [38, 42]),
        _ => return None,
    })
}

/// Width of a bed for one.
pub(super) const SINGLE_BED: [i32; 2] = [20, 22];
/// Width of a bed for two.
pub(super) const DOUBLE_BED: [i32; 2] = [30, 34];

/// How a kind of room is built.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct RoomKind {
    /// Width and depth where it has no more than two pieces.
    pub(super) width: i32,
    pub(super) depth: i32,
    /// Whether one passes through it: other rooms have their doors to it.
    pub(super) passed: bool,
    /// What belongs into it, the most important first.
    pub(super) pieces: &'static [&'static str],
}

/// Every kind of room we build. Balconies lie before the outline, corridors between its two bands.
#[rustfmt::skip]
pub(super) const ROOM_KINDS: &[(&str, RoomKind)] = &[
    ("living room", room(88, 86, true, &["couch", "table", "tv stand", "cabinet"])),
    (
        "kitchen",
        room(
            54,
            64,
            false,
            &[
                "refrigerator",
                "counter",
                "microwave",
                "sink",
                "electric cooker",
                "table",
            ],
        ),
    ),
    ("bedroom", room(70, 76, false, &["bed", "cabinet", "nightstand", "desk", "chest of drawers"])),
    ("dining room", room(68, 72, true, &["table", "cabinet", "cabinet"])),
    ("toilet", room(40, 56, false, &["sink", "cabinet"])),
    ("bathroom", room(44, 56, false, &["sink", "cabinet", "cabinet"])),
    ("washroom", room(46, 60, false, &["washing machine", "sink", "cabinet"])),
    ("study room", room(58, 64, false, &["desk", "cabinet", "shelf"])),
    ("entry", room(46, 60, true, &["shoe cabinet", "cabinet"])),
    ("balcony", room(76, 40, false, &["table", "cabinet"])),
    ("corridor", room(0, 32, true, &["shoe cabinet", "cabinet"])),
];

const fn room(width: i32, depth: i32, passed: bool, pieces: &'static [&'static str]) -> RoomKind {
    RoomKind {
        width,
        depth,
        passed,
        pieces,
    }
}

/// The kind of a room by its name, e.g. `bedroom/1`.
pub(super) fn room_kind(name: &str) -> Option<(&'static str, RoomKind)> {
    let word = name.split('/').next().unwrap_or(name);
    ROOM_KINDS.iter().find(|(kind, _)| *kind == word).copied()
}
