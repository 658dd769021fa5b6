//! Words for the colours of solids, as captions say them, and colours for those that have none.

use std::collections::BTreeMap;

use reel_world::{Attributes, SolidShape};

use crate::house::{Solids, SourceSolid};

/// Words and what they look like.
const WORDS: &[(&str, [u8; 3])] = &[
    ("white", [240, 240, 236]),
    ("black", [34, 34, 36]),
    ("gray", [140, 140, 140]),
    ("brown", [128, 84, 50]),
    ("beige", [214, 186, 146]),
    ("red", [184, 44, 40]),
    ("green", [66, 124, 70]),
    ("blue", [58, 94, 168]),
    ("yellow", [226, 190, 60]),
    ("orange", [222, 126, 44]),
    ("purple", [118, 70, 140]),
    ("pink", [226, 150, 176]),
];

/// Colours of pieces whose file gives none, in turn.
const DRAWN: &[&str] = &[
    "white", "brown", "gray", "beige", "black", "blue", "green", "red",
];

/// The word of a colour.
pub(crate) fn word(color: [u8; 3]) -> &'static str {
    let off = |[r, g, b]: [u8; 3]| {
        let far = |a: u8, b: u8| (i32::from(a) - i32::from(b)).pow(2);
        far(r, color[0]) + far(g, color[1]) + far(b, color[2])
    };
    let nearest = WORDS.iter().min_by_key(|(_, known)| off(*known));
    nearest.map_or("gray", |(word, _)| word)
}

/// Colours the solids whose file gives no colour: as the rest of the piece, or where there is none the
/// pieces in turn. Whether it took the next colour.
pub(crate) fn fill(solids: &mut Solids, index: usize) -> bool {
    let moving = solids.moving.iter().flat_map(|moving| &moving.solids);
    let known = solids
        .fixed
        .iter()
        .chain(moving)
        .find(|solid| solid.is_coloured);
    let known = known.map(|solid| solid.primitive.color);
    let name = DRAWN[index % DRAWN.len()];
    let (_, next) = WORDS
        .iter()
        .find(|(word, _)| *word == name)
        .expect("is among the words");
    let moving = solids
        .moving
        .iter_mut()
        .flat_map(|moving| &mut moving.solids);
    for solid in solids
        .fixed
        .iter_mut()
        .chain(moving)
        .filter(|solid| !solid.is_coloured)
    {
        solid.primitive.color = known.unwrap_or(*next);
    }
    known.is_none()
}

/// The attributes that a piece shows: its colour, that of its largest solids.
pub(crate) fn attributes(solids: &Solids) -> Attributes {
    let mut areas: BTreeMap<&str, f64> = BTreeMap::new();
    let moving = solids.moving.iter().flat_map(|moving| &moving.solids);
    for solid in solids.fixed.iter().chain(moving) {
        *areas.entry(word(solid.primitive.color)).or_default() += largest_face(solid);
    }
    let most = areas.into_iter().max_by(|a, b| a.1.total_cmp(&b.1));
    most.into_iter()
        .map(|(word, _)| ("colour".to_owned(), vec![word.to_owned()]))
        .collect()
}

fn largest_face(solid: &SourceSolid) -> f64 {
    match solid.primitive.shape {
        SolidShape::Box { half: [a, b, c] } => (a * b).max(b * c).max(a * c),
        SolidShape::Cylinder {
            radius,
            half_height,
        } => (radius * radius).max(radius * half_height),
        SolidShape::Sphere { radius } => radius * radius,
    }
}
