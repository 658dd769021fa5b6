//! What receptacles and objects are called, so that nothing else is meant: by their captions,
//! else by their attributes.

use std::collections::BTreeSet;

use crate::wording::definite;
use reel_world::{Attributes, ObjectInstance, Receptacle, Scene, language};

/// Words that tell nothing apart.
const EMPTY: &[&str] = &[
    "a", "an", "the", "with", "and", "in", "on", "of", "one", "that", "which", "its", "is", "only",
];

/// The phrases that mean this receptacle and no other of the scene: the captions that do,
/// or, if none does, one made from category, attributes and room; none if not even that
/// tells it from the others.
///
/// A phrase may mean another receptacle if that is of the same category and all words of the phrase
/// are said of it.
pub fn receptacle(receptacle: &Receptacle, scene: &Scene) -> Vec<String> {
    let others: Vec<BTreeSet<String>> = scene
        .receptacles
        .iter()
        .filter(|other| other.id != receptacle.id && other.category == receptacle.category)
        .map(said_of)
        .collect();
    let shared = |caption: &str| {
        let same = |other: &&Receptacle| {
            other
                .captions
                .keys()
                .any(|key| key.eq_ignore_ascii_case(caption))
        };
        scene.receptacles.iter().filter(same).count() > 1
    };
    let is_unique = |phrase: &String| {
        let words = content(phrase);
        !shared(phrase) && !others.iter().any(|other| words.is_subset(other))
    };
    let captions: Vec<String> = receptacle
        .captions
        .keys()
        .filter(|caption| is_unique(caption))
        .cloned()
        .collect();
    if !captions.is_empty() {
        return captions;
    }
    let room = receptacle.room_name();
    let plain = [
        format!("the {}", receptacle.category),
        format!("the {} in the {room}", receptacle.category),
    ];
    let attributed = phrases(&receptacle.category, &receptacle.attributes);
    let in_room = attributed
        .iter()
        .map(|phrase| format!("{phrase} in the {room}"));
    plain
        .into_iter()
        .chain(attributed.iter().cloned())
        .chain(in_room)
        .find(is_unique)
        .into_iter()
        .collect()
}

/// How an object can be called, the fullest description first, then by one or two attribute words,
/// then by its category.
pub fn object(category: &str, caption: &str, attributes: &Attributes) -> Vec<String> {
    let mut all = vec![definite(caption)];
    all.extend(phrases(category, attributes));
    all.push(format!("the {category}"));
    all
}

/// Whether all words of a phrase are said of a receptacle.
pub fn may_mean_receptacle(phrase: &str, receptacle: &Receptacle) -> bool {
    content(phrase).is_subset(&said_of(receptacle))
}

/// Whether a phrase may mean an object: all words of it are said of it.
pub fn may_mean(phrase: &str, object: &ObjectInstance) -> bool {
    let attributes = object.attributes.values().flatten().map(String::as_str);
    let texts = attributes
        .chain(object.caption.as_deref())
        .chain([object.category.as_str()]);
    content(phrase).is_subset(&texts.flat_map(content).collect())
}

/// `the red mug`, `the small red mug`, ...: one attribute word, then two.
fn phrases(category: &str, attributes: &Attributes) -> Vec<String> {
    // In the order in which English puts them.
    let kinds = ["size", "shape", "colour", "material"];
    let words: Vec<&str> = kinds
        .iter()
        .filter_map(|kind| attributes.get(*kind))
        .flatten()
        .map(String::as_str)
        .collect();
    let category = category.trim();
    let mut all: Vec<String> = words
        .iter()
        .map(|word| format!("the {word} {category}"))
        .collect();
    for (index, first) in words.iter().enumerate() {
        all.extend(
            words[index + 1..]
                .iter()
                .map(|second| format!("the {first} {second} {category}")),
        );
    }
    all
}

/// Every word that is said of a receptacle.
fn said_of(receptacle: &Receptacle) -> BTreeSet<String> {
    let captions = receptacle
        .captions
        .keys()
        .flat_map(|caption| content(caption));
    let attributes = receptacle.attributes.iter().flat_map(|(kind, words)| {
        content(kind)
            .into_iter()
            .chain(words.iter().flat_map(|word| content(word)))
    });
    captions
        .chain(attributes)
        .chain(content(&receptacle.category))
        .chain(content(&receptacle.room))
        .collect()
}

fn content(phrase: &str) -> BTreeSet<String> {
    let words = language::words(phrase);
    words
        .iter()
        .filter(|word| !EMPTY.contains(&word.as_str()))
        .map(|word| language::lemma(word))
        .collect()
}
