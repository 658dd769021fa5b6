//! What furniture looks like, in the attribute words that the renderer shows, such that pieces
//! of one name differ.

use std::collections::BTreeMap;

use crate::random::Stream;
use reel_world::Attributes;

/// The name that people call a category by, of which several categories may be
/// kinds: its last word.
pub(super) fn noun(category: &str) -> &str {
    category.rsplit(' ').next().unwrap_or(category)
}

/// What is said of two features of pieces of one noun: words of the first differ first, then
/// those of the second.
struct Palette {
    first: Feature,
    second: Feature,
}

/// A feature and the words that are said of it.
type Feature = (&'static str, &'static [&'static str]);

const BODIES: &[&str] = &[
    "white", "black", "gray", "brown", "oak", "green", "blue", "red",
];
const APPLIANCES: &[&str] = &["white", "silver", "black"];
/// So many words of a feature are what most homes have; they come first.
const USUAL: usize = 5;

fn palette(noun: &str) -> Palette {
    let (first, second): (Feature, Feature) = match noun {
        "bed" => (
            (
                "bedding",
                &[
                    "blue", "white", "green", "red", "gray", "yellow", "purple", "pink",
                ],
            ),
            ("pillows", &["white", "gray", "beige", "navy"]),
        ),
        "couch" => (
            (
                "colour",
                &["gray", "blue", "beige", "green", "red", "brown"],
            ),
            ("material", &["fabric"]),
        ),
        "table" => (
            ("colour", &["white", "black", "brown", "oak", "gray"]),
            ("top", &["", "glass", "marble", "walnut"]),
        ),
        "counter" => (
            ("colour", &["white", "gray", "blue", "green", "oak"]),
            ("top", &["granite", "marble", "walnut"]),
        ),
        "sink" => (
            (
                "top",
                &["oak", "black", "white", "walnut", "granite", "blue"],
            ),
            ("basin", &["white", "gray", "beige", "green"]),
        ),
        "shelf" => (("colour", BODIES), ("material", &["wooden", "metal"])),
        "refrigerator" | "fridge" | "microwave" | "machine" | "cooker" => (
            ("colour", APPLIANCES),
            ("handles", &["silver", "black", "brass", "white"]),
        ),
        _ => (
            ("colour", BODIES),
            ("handles", &["black", "silver", "brass", "white"]),
        ),
    };
    Palette { first, second }
}

/// The attributes of pieces of these categories, in their order; none where a palette
/// has too few looks.
pub(super) fn draw(categories: &[&str], stream: &mut Stream) -> Option<Vec<Attributes>> {
    let mut decks: BTreeMap<&str, std::vec::IntoIter<Attributes>> = BTreeMap::new();
    for category in categories {
        decks
            .entry(noun(category))
            .or_insert_with(|| deck(noun(category), stream));
    }
    categories
        .iter()
        .map(|category| decks.get_mut(noun(category))?.next())
        .collect()
}

/// Every look of a noun, those that differ in the first feature first.
fn deck(noun: &str, stream: &mut Stream) -> std::vec::IntoIter<Attributes> {
    let Palette {
        first: (first, of_first),
        second: (second, of_second),
    } = palette(noun);
    let (usual, rare) = of_first.split_at(USUAL.min(of_first.len()));
    let firsts = [
        stream.pick_some(usual, usual.len()),
        stream.pick_some(rare, rare.len()),
    ]
    .concat();
    let seconds = stream.pick_some(of_second, of_second.len());
    let mut looks = Vec::new();
    for round in 0..seconds.len() {
        for (index, word) in firsts.iter().enumerate() {
            let other = seconds[(index + round) % seconds.len()];
            // Handles in the colour of the door are none to speak of.
            if *word == other {
                continue;
            }
            let feature =
                |kind: &str, word: &str| (kind_of(kind, word).to_owned(), vec![word.to_owned()]);
            // Of a table with a top of its own the rest is legs.
            let first = if noun == "table" && !other.is_empty() {
                "legs"
            } else {
                first
            };
            let said = [(first, *word), (second, other)]
                .into_iter()
                .filter(|(_, word)| !word.is_empty());
            looks.push(said.map(|(kind, word)| feature(kind, word)).collect());
        }
    }
    looks.into_iter()
}

/// Wood is a material, not a colour.
fn kind_of<'a>(kind: &'a str, word: &str) -> &'a str {
    if kind == "colour" && word == "oak" {
        "material"
    } else {
        kind
    }
}
