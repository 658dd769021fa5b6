//! The object library: 154 categories of 5 objects each, made from the table of `data/objects.json`
//! by an attribute grammar, so that objects of a category differ in colour and captions are unique.

use std::sync::OnceLock;

use reel_world::{AssetId, Attributes, InstanceId, ObjectInstance, ReceptacleId};
use serde::Deserialize;

use crate::attributes;

/// An object that can be placed.
#[derive(Clone, PartialEq, Debug)]
pub struct LibraryObject {
    /// Id of the asset, e.g. `mug_03`.
    pub asset: AssetId,
    /// Category of the object, e.g. `mug`.
    pub category: String,
    /// What it is for, e.g. `drink container`; several categories share a purpose.
    pub purpose: String,
    /// e.g. `Small green ceramic cylindrical mug with a curved handle.`
    pub caption: String,
    /// Words of the caption by kind.
    pub attributes: Attributes,
    /// Width, depth, height in metres.
    pub size: [f64; 3],
}

/// Objects of a category.
const VARIANTS: usize = 5;
/// Sizes they come in: the word in the caption, and the scale.
const SIZES: [(&str, f64); VARIANTS] = [
    ("", 1.0),
    ("large", 1.2),
    ("", 1.0),
    ("small", 0.8),
    ("", 1.0),
];
/// No object is lower, in metres: thinner ones are hard on any physics. Nor made larger than this.
const LOWEST_M: f64 = 0.02;
const LARGEST_M: [f64; 3] = [0.39, 0.29, 0.29];
/// Categories and objects of each in [`small_library`].
const SMALL: [usize; 2] = [60, 4];

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
pub fn objects() -> &'static [LibraryObject] {
    static OBJECTS: OnceLock<Vec<LibraryObject>> = OnceLock::new();
    OBJECTS.get_or_init(|| {
        let rows: Vec<Category> = serde_json::from_str(include_str!("data/objects.json"))
            .expect("the committed table is well formed");
        rows.iter()
            .flat_map(|row| (0..VARIANTS).map(move |number| row.object(number)))
            .collect()
    })
}

/// The 240 objects of 60 categories that [`crate::draw`] draws from: what its seeds
/// mean depends on them.
pub fn small_library() -> &'static [LibraryObject] {
    static OBJECTS: OnceLock<Vec<LibraryObject>> = OnceLock::new();
    let [categories, each] = SMALL;
    OBJECTS.get_or_init(|| {
        objects()
            .chunks(VARIANTS)
            .take(categories)
            .flat_map(|row| row[..each].to_vec())
            .collect()
    })
}

impl LibraryObject {
    /// The object at the start of a task of this name: on a receptacle, the centre of
    /// its box at `position`.
    pub fn instance_at(
        &self,
        receptacle: &ReceptacleId,
        task_name: &str,
        position: [f64; 3],
    ) -> ObjectInstance {
        ObjectInstance {
            instance: InstanceId::new(&self.asset, receptacle, task_name),
            asset: self.asset.clone(),
            category: self.category.clone(),
            caption: Some(self.caption.clone()),
            attributes: self.attributes.clone(),
            size: self.size,
            position,
            yaw: 0.0,
            receptacle: receptacle.clone(),
            reference_rest: None,
        }
    }
}

impl Category {
    fn object(&self, number: usize) -> LibraryObject {
        let (size_word, scale) = SIZES[number];
        let cycle = |words: &[String]| {
            words
                .get(number % words.len().max(1))
                .cloned()
                .unwrap_or_default()
        };
        let words = [
            size_word,
            &self.colours[number],
            &cycle(&self.materials),
            &self.shape,
            &self.category,
        ];
        let words: Vec<&str> = words.into_iter().filter(|word| !word.is_empty()).collect();
        let caption = capitalize(&format!(
            "{} with {}.",
            words.join(" "),
            cycle(&self.details)
        ));
        let mut size = [0, 1, 2].map(|axis| {
            round_mm((self.size[axis] * scale).min(LARGEST_M[axis].max(self.size[axis])))
        });
        size[2] = size[2].max(LOWEST_M);
        LibraryObject {
            asset: format!("{}_{:02}", self.category.replace(' ', "_"), number + 1).into(),
            category: self.category.clone(),
            purpose: self.purpose.clone(),
            attributes: attributes::from_caption(&caption),
            caption,
            size,
        }
    }
}

fn round_mm(length_m: f64) -> f64 {
    (length_m * 1000.0).round() / 1000.0
}

pub(crate) fn capitalize(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| {
        first.to_uppercase().chain(letters).collect()
    })
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use super::*;

    #[test]
    fn every_object_has_its_own_asset_and_caption() {
        let distinct = |of: fn(&LibraryObject) -> String| {
            objects().iter().map(of).collect::<BTreeSet<_>>().len()
        };
        assert_eq!(
            (objects().len(), distinct(|object| object.category.clone())),
            (770, 154)
        );
        assert_eq!(distinct(|object| object.asset.to_string()), 770);
        assert_eq!(distinct(|object| object.caption.to_lowercase()), 770);
        assert_eq!(
            objects()[3].caption,
            "Small green ceramic cylindrical mug with a curved handle."
        );
        assert_eq!(small_library().len(), 240);
        assert!(
            small_library()
                .iter()
                .all(|object| objects().contains(object))
        );
    }

    #[test]
    fn a_caption_says_one_colour_no_other_of_the_category_has_and_a_size_that_is_true() {
        let mut seen = BTreeSet::new();
        for object in objects() {
            let [colour] = object.attributes["colour"].as_slice() else {
                panic!("one colour: {}", object.caption)
            };
            assert!(
                seen.insert((object.category.clone(), colour.clone())),
                "{colour} twice: {}",
                object.caption
            );
            let size = object
                .attributes
                .get("size")
                .map_or("", |words| words[0].as_str());
            let first = objects()
                .iter()
                .find(|other| other.category == object.category)
                .unwrap();
            let larger = object.size.iter().sum::<f64>() - first.size.iter().sum::<f64>();
            let told = if larger > 1e-9 {
                "large"
            } else if larger < -1e-9 {
                "small"
            } else {
                ""
            };
            assert_eq!(size, told, "{}", object.caption);
        }
    }

    #[test]
    fn every_purpose_has_several_categories_and_every_object_fits_a_surface() {
        for objects in [objects(), small_library()] {
            let mut categories: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
            for object in objects {
                categories
                    .entry(&object.purpose)
                    .or_default()
                    .insert(&object.category);
                let [width, depth, height] = object.size;
                let fits = (0.01..0.4).contains(&width)
                    && (0.01..0.3).contains(&depth)
                    && (LOWEST_M..0.3).contains(&height);
                assert!(fits, "{object:?}");
            }
            assert!(
                categories.len() >= 12 && categories.values().all(|of| of.len() >= 3),
                "{categories:?}"
            );
        }
    }
}
