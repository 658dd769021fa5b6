//! What people call shelves, drawers and compartments, and furniture of which there are several
//! that look alike.

use std::collections::BTreeMap;

use reel_world::{Receptacle, ReceptacleId};

const ORDINALS: &[&str] = &[
    "first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth",
];
/// Parts whose heights differ less are in one row, in metres.
const ROW_M: f64 = 0.08;

/// Furniture by its number in its room, and the room by its number among the rooms of its kind
/// where there are several.
pub(crate) fn numbered(piece: &Receptacle, number: usize, rooms_of_kind: usize) -> String {
    let (kind, index) = piece.room.rsplit_once('/').unwrap_or((&piece.room, "0"));
    let room = match index.parse::<usize>() {
        Ok(index) if rooms_of_kind > 1 => format!("{} {kind}", ordinal(index + 1)),
        _ => kind.to_owned(),
    };
    format!("the {} {} in the {room}", ordinal(number), piece.category)
}

fn ordinal(number: usize) -> String {
    let word = number.checked_sub(1).and_then(|index| ORDINALS.get(index));
    word.map_or_else(|| format!("number {number}"), |word| (*word).to_owned())
}

/// Names parts by where they are in their furniture: `the top drawer of the white cabinet`.
pub(crate) fn caption_parts(receptacles: &mut [Receptacle]) {
    let mut groups: BTreeMap<(ReceptacleId, String), Vec<usize>> = BTreeMap::new();
    for (index, receptacle) in receptacles.iter().enumerate() {
        if let Some(whole) = &receptacle.part_of {
            let key = (whole.clone(), receptacle.category.clone());
            groups.entry(key).or_default().push(index);
        }
    }
    for ((whole, category), members) in groups {
        let owner = receptacles.iter().find(|receptacle| receptacle.id == whole);
        let Some(owner) = owner else { continue };
        let owner_name = owner.main_caption().unwrap_or(&owner.category).to_owned();
        let places = places(receptacles, &members);
        for (index, place) in members.into_iter().zip(places) {
            let caption = if place.is_empty() {
                format!("the {category} of {owner_name}")
            } else {
                format!("the {place} {category} of {owner_name}")
            };
            receptacles[index].captions = BTreeMap::from([(caption, 1.0)]);
        }
    }
}

/// Words for where each of some parts is: its row from above, and its column as seen from the
/// front.
fn places(receptacles: &[Receptacle], members: &[usize]) -> Vec<String> {
    let mut heights: Vec<f64> = members
        .iter()
        .map(|index| receptacles[*index].surface_height())
        .collect();
    heights.sort_by(|a, b| b.total_cmp(a));
    heights.dedup_by(|next, kept| *kept - *next < ROW_M);
    let row_of = |index: usize| {
        let height = receptacles[index].surface_height();
        heights
            .iter()
            .rposition(|row| height <= *row + 1e-6)
            .unwrap_or(0)
    };
    members
        .iter()
        .map(|index| {
            let in_row: Vec<usize> = members
                .iter()
                .copied()
                .filter(|other| row_of(*other) == row_of(*index))
                .collect();
            let row = row_word(row_of(*index), heights.len());
            let column = column_word(receptacles, *index, in_row);
            [row, column]
                .into_iter()
                .filter(|word| !word.is_empty())
                .collect::<Vec<_>>()
                .join(" ")
        })
        .collect()
}

fn row_word(row: usize, rows: usize) -> String {
    match (row, rows) {
        (_, 1) => String::new(),
        (0, _) => "top".to_owned(),
        (row, rows) if row + 1 == rows => "bottom".to_owned(),
        (_, 3) => "middle".to_owned(),
        (row, _) => ordinal(row + 1),
    }
}

fn column_word(receptacles: &[Receptacle], index: usize, mut in_row: Vec<usize>) -> String {
    let from_left = |index: &usize| {
        let piece = &receptacles[*index];
        let center = [0, 1].map(|axis| (piece.surface_min[axis] + piece.surface_max[axis]) * 0.5);
        // Who looks at a front that looks along +x has +y to the right.
        match piece.facing_deg.unwrap_or(0.0) as i64 {
            0 => center[1],
            90 => -center[0],
            180 => -center[1],
            _ => center[0],
        }
    };
    in_row.sort_by(|a, b| from_left(a).total_cmp(&from_left(b)));
    let place = in_row.iter().position(|other| *other == index).unwrap_or(0);
    match (place, in_row.len()) {
        (_, 1) => String::new(),
        (0, _) => "left".to_owned(),
        (place, count) if place + 1 == count => "right".to_owned(),
        (_, 3) => "middle".to_owned(),
        (place, _) => ordinal(place + 1),
    }
}
