//! The large object library: over 700 objects, made from the tables of `data/` by an attribute grammar, so that objects of a
//! category differ in colour and captions are unique; and where things of a purpose belong.
//!
//! A superset of the small library in `reel-tasks`: those objects are here too, with the same assets and captions.

mod picture;

use std::{collections::BTreeMap, sync::OnceLock};

use reel_tasks::attributes;
use reel_world::{AssetId, Attributes};
use serde::Deserialize;

pub use picture::picture;

/// An object that can be placed.
#[derive(Clone, PartialEq, Debug)]
pub struct Object {
    /// e.g. `mug_03`
    pub asset: AssetId,
    /// e.g. `mug`
    pub category: &'static str,
    /// What it is for, e.g. `drink container`; several categories share a purpose.
    pub purpose: &'static str,
    /// e.g. `Small green ceramic cylindrical mug with a curved handle.`
    pub caption: String,
    /// Words of the caption by kind.
    pub attributes: Attributes,
    /// Width, depth, height in metres.
    pub size: [f64; 3],
}

/// Where things belong.
#[derive(Clone, PartialEq, Debug, Deserialize)]
pub struct Home {
    /// Kinds of rooms, e.g. `kitchen`.
    pub rooms: Vec<String>,
    /// Categories of receptacles, e.g. `counter`.
    pub on: Vec<String>,
}

impl Home {
    /// Whether things of the purpose belong on a receptacle of a category in a room (`kitchen/0`).
    pub fn holds(&self, room: &str, category: &str) -> bool {
        let kind = room.split('/').next().unwrap_or(room);
        self.rooms.iter().any(|known| known == kind) && self.on.iter().any(|known| known == category)
    }
}

/// Objects of a category.
const VARIANTS: usize = 5;
/// Sizes they come in: the word in the caption, and the scale.
const SIZES: [(&str, f64); VARIANTS] = [("", 1.0), ("large", 1.2), ("", 1.0), ("small", 0.8), ("", 1.0)];
/// No object is lower, in metres: thinner ones are hard on any physics. Nor larger.
const LOWEST_M: f64 = 0.02;
const LARGEST_M: [f64; 3] = [0.39, 0.29, 0.29];

/// One row of `data/objects.json`.
#[derive(Deserialize)]
struct Category {
    category: String,
    purpose: String,
    size: [f64; 3],
    shape: String,
    colours: [String; VARIANTS],
    materials: Vec<String>,
    details: Vec<String>,
}

/// Every object, by category and number.
pub fn objects() -> &'static [Object] {
    static OBJECTS: OnceLock<Vec<Object>> = OnceLock::new();
    OBJECTS.get_or_init(|| rows().iter().flat_map(|row| (0..VARIANTS).map(move |number| row.object(number))).collect())
}

/// Where things belong, by purpose.
pub fn homes() -> &'static BTreeMap<String, Home> {
    static HOMES: OnceLock<BTreeMap<String, Home>> = OnceLock::new();
    HOMES.get_or_init(|| {
        serde_json::from_str(include_str!("../../data/purposes.json")).expect("the committed table is well formed")
    })
}

fn rows() -> &'static [Category] {
    static ROWS: OnceLock<Vec<Category>> = OnceLock::new();
    ROWS.get_or_init(|| {
        serde_json::from_str(include_str!("../../data/objects.json")).expect("the committed table is well formed")
    })
}

impl Category {
    fn object(&'static self, number: usize) -> Object {
        let (size_word, scale) = SIZES[number];
        let cycle = |words: &'static [String]| words.get(number % words.len().max(1)).map_or("", String::as_str);
        let words = [size_word, &self.colours[number], cycle(&self.materials), &self.shape, &self.category];
        let words: Vec<&str> = words.into_iter().filter(|word| !word.is_empty()).collect();
        let caption = capitalized(&format!("{} with {}.", words.join(" "), cycle(&self.details)));
        let mut size = [0, 1, 2].map(|axis| (self.size[axis] * scale).min(LARGEST_M[axis].max(self.size[axis])));
        size[2] = size[2].max(LOWEST_M);
        Object {
            asset: format!("{}_{:02}", self.category.replace(' ', "_"), number + 1).into(),
            category: &self.category,
            purpose: &self.purpose,
            attributes: attributes::from_caption(&caption),
            caption,
            size: size.map(|length| (length * 1000.0).round() / 1000.0),
        }
    }
}

fn capitalized(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}
