//! Typical sizes of furniture by category, for files that name assets without their sizes, and
//! where the surface of a piece of a size is.

/// From side to side, from back to front, and up, in metres.
const TYPICAL: &[(&str, [f64; 3])] = &[
    ("bed", [1.5, 2.05, 0.95]),
    ("bench", [0.9, 0.45, 0.45]),
    ("cabinet", [0.9, 0.45, 0.85]),
    ("chest of drawers", [1.0, 0.5, 0.9]),
    ("couch", [1.9, 0.9, 0.85]),
    ("counter", [1.4, 0.62, 0.9]),
    ("desk", [1.2, 0.65, 0.75]),
    ("electric cooker", [0.6, 0.6, 0.9]),
    ("microwave", [0.55, 0.42, 0.32]),
    ("nightstand", [0.45, 0.42, 0.55]),
    ("refrigerator", [0.8, 0.75, 1.8]),
    ("shelf", [0.9, 0.4, 0.9]),
    ("shoe cabinet", [0.9, 0.35, 0.85]),
    ("sink", [0.6, 0.5, 0.85]),
    ("table", [1.2, 0.75, 0.74]),
    ("tea table", [1.0, 0.6, 0.42]),
    ("tv stand", [1.4, 0.42, 0.5]),
    ("washing machine", [0.62, 0.6, 0.88]),
];

/// The typical size of a category, or that of a table.
pub(crate) fn typical(category: &str) -> [f64; 3] {
    let known = TYPICAL.iter().find(|(known, _)| *known == category);
    known.map_or([1.0, 0.6, 0.75], |(_, size)| *size)
}

/// Where the surface lies in the box of a piece.
pub(crate) struct SurfaceSpot {
    pub(crate) height_m: f64,
    pub(crate) back_m: f64,
    pub(crate) front_m: f64,
    pub(crate) side_m: f64,
    pub(crate) has_door: bool,
}

/// The surface of a piece of this category and size; the simulator puts backs, arms and doors
/// into the rest.
pub(crate) fn surface(category: &str, [_, _, height]: [f64; 3]) -> SurfaceSpot {
    let open = |height_m: f64| SurfaceSpot {
        height_m: height_m.clamp(0.2, 1.1),
        back_m: 0.02,
        front_m: 0.0,
        side_m: 0.01,
        has_door: false,
    };
    let closed = |height_m: f64| SurfaceSpot {
        back_m: 0.08,
        front_m: 0.08,
        side_m: 0.06,
        has_door: true,
        ..open(height_m)
    };
    match category {
        "bed" => SurfaceSpot {
            back_m: 0.35,
            side_m: 0.05,
            front_m: 0.05,
            ..open((height * 0.5).clamp(0.35, 0.55))
        },
        "couch" => SurfaceSpot {
            back_m: 0.25,
            side_m: 0.15,
            ..open((height * 0.5).clamp(0.35, 0.5))
        },
        "sink" => SurfaceSpot {
            back_m: 0.08,
            side_m: 0.05,
            front_m: 0.05,
            ..open(height.clamp(0.75, 0.9))
        },
        "refrigerator" => closed(0.9),
        "microwave" => closed(0.98),
        "electric cooker" => closed(0.88),
        "washing machine" => closed(0.4),
        _ => open(height),
    }
}
