//! What belongs where: which objects a receptacle of a kind plausibly holds in a room of a kind
//! (`data/compatibility.json`), and so which (source, destination, object) triplets make sense.
//! Knows words, never sizes or places.
//!
//! A model may write the table in the place of the committed one: it is asked once for every kind
//! of receptacle in every kind of room ([`Compatibility::receptacle_kinds`], [`question`]), and
//! what it answers is a row ([`judge`]). Never speaks to a model.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::OnceLock,
};

use crate::library::LibraryObject;
use reel_world::{Receptacle, Scene};
use serde::{Deserialize, Serialize};

/// What a model is told before it is asked about a place.
pub const PROMPT: &str = include_str!("../../../prompts/compatibility.md");

/// The compatibility table: which objects receptacles of a kind hold in rooms of a kind.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Compatibility {
    /// Other names of rooms.
    #[serde(default)]
    rooms: BTreeMap<String, String>,
    /// Other names of receptacles.
    #[serde(default)]
    receptacles: BTreeMap<String, String>,
    /// Purposes and categories that go together, by a name.
    #[serde(default)]
    groups: BTreeMap<String, Vec<String>>,
    holds: Vec<TableRow>,
}

/// Receptacles of these kinds, in these rooms or in any, hold these things. The first row that
/// fits a receptacle counts.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TableRow {
    receptacles: Vec<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    rooms: Vec<String>,
    /// Purposes, categories or names of groups.
    what: Vec<String>,
}

/// A kind of receptacle in a kind of room.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub struct ReceptacleKind {
    /// The kind of receptacle, e.g. `tvstand`.
    pub kind: String,
    /// The kind of room, e.g. `living room`.
    pub room: String,
}

/// What a model says that a place holds.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct CompatibilityAnswer {
    /// Purposes and categories of the library.
    pub known: Vec<String>,
    /// Words that the library does not have.
    pub unknown: Vec<String>,
}

/// What to ask about a place: everything there is, and where.
pub fn question(place: &ReceptacleKind, library: &[LibraryObject]) -> String {
    let mut things: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for object in library {
        things
            .entry(&object.purpose)
            .or_default()
            .insert(&object.category);
    }
    let lines: Vec<String> = things
        .into_iter()
        .map(|(purpose, categories)| {
            format!(
                "{purpose}: {}",
                categories.into_iter().collect::<Vec<_>>().join(", ")
            )
        })
        .collect();
    format!(
        "Place: {} in the {}\nThings, by purpose:\n{}\n",
        place.kind,
        place.room,
        lines.join("\n")
    )
}

/// The last list of words of an answer; none where there is no such list, or no word
/// of it is known.
pub fn judge(answer: &str, library: &[LibraryObject]) -> Option<CompatibilityAnswer> {
    let answer = answer
        .rsplit_once("</think>")
        .map_or(answer, |(_, said)| said);
    let read = |at: usize| {
        serde_json::Deserializer::from_str(&answer[at..])
            .into_iter::<Vec<String>>()
            .next()?
            .ok()
    };
    let words = answer.rmatch_indices('[').find_map(|(at, _)| read(at))?;
    let is_known = |word: &String| {
        library
            .iter()
            .any(|object| object.purpose == *word || object.category == *word)
    };
    let words: BTreeSet<String> = words
        .iter()
        .map(|word| word.trim().to_lowercase())
        .collect();
    let (known, unknown): (Vec<String>, Vec<String>) = words.into_iter().partition(is_known);
    (!known.is_empty()).then_some(CompatibilityAnswer { known, unknown })
}

impl Compatibility {
    /// The table that comes with Reel.
    pub fn committed() -> &'static Self {
        static TABLE: OnceLock<Compatibility> = OnceLock::new();
        TABLE.get_or_init(|| {
            serde_json::from_str(include_str!("../../../data/compatibility.json"))
                .expect("the committed table is well formed")
        })
    }

    /// The kinds of receptacles in kinds of rooms that scenes have.
    pub fn receptacle_kinds<'a>(
        &self,
        scenes: impl IntoIterator<Item = &'a Scene>,
    ) -> BTreeSet<ReceptacleKind> {
        let of_scene = |scene: &'a Scene| {
            let place = |one: &Receptacle| ReceptacleKind {
                kind: self.kind(&one.category),
                room: self.room(&one.room),
            };
            scene.receptacles.iter().map(place)
        };
        scenes.into_iter().flat_map(of_scene).collect()
    }

    /// A table in which these places hold these things, and all others what they held.
    pub fn with(&self, places: BTreeMap<ReceptacleKind, Vec<String>>) -> Self {
        let row = |(place, what): (ReceptacleKind, Vec<String>)| TableRow {
            receptacles: vec![place.kind],
            rooms: vec![place.room],
            what,
        };
        let mut table = self.clone();
        table.holds.splice(0..0, places.into_iter().map(row));
        table
    }

    /// Whether an object plausibly stands on a receptacle.
    pub fn holds(&self, receptacle: &Receptacle, object: &LibraryObject) -> bool {
        self.row(receptacle)
            .is_some_and(|row| row.what.iter().any(|what| self.means(what, object)))
    }

    /// Whether an object plausibly goes from one receptacle to the other.
    pub fn is_plausible(
        &self,
        src: &Receptacle,
        dest: &Receptacle,
        object: &LibraryObject,
    ) -> bool {
        src.id != dest.id && self.holds(src, object) && self.holds(dest, object)
    }

    /// Whether the table speaks of an object at all.
    pub fn knows_object(&self, object: &LibraryObject) -> bool {
        self.holds
            .iter()
            .any(|row| row.what.iter().any(|what| self.means(what, object)))
    }

    fn means(&self, what: &str, object: &LibraryObject) -> bool {
        let is = |name: &str| name == object.purpose || name == object.category;
        is(what)
            || self
                .groups
                .get(what)
                .is_some_and(|names| names.iter().any(|name| is(name)))
    }

    fn row(&self, receptacle: &Receptacle) -> Option<&TableRow> {
        let (room, kind) = (self.room(&receptacle.room), self.kind(&receptacle.category));
        let fits = |row: &&TableRow| {
            row.receptacles.contains(&kind) && (row.rooms.is_empty() || row.rooms.contains(&room))
        };
        self.holds.iter().find(fits)
    }

    /// `dinning room/0` is a dining room.
    fn room(&self, name: &str) -> String {
        let kind = name.split('/').next().unwrap_or(name).trim().to_lowercase();
        self.rooms.get(&kind).cloned().unwrap_or(kind)
    }

    /// The kind of a category: itself, another name of one, or the longest of both that stands
    /// in it (`coffee table`).
    fn kind(&self, category: &str) -> String {
        let letters: String = category
            .to_lowercase()
            .chars()
            .filter(|letter| letter.is_alphanumeric())
            .collect();
        let kinds = self
            .holds
            .iter()
            .flat_map(|row| &row.receptacles)
            .map(|kind| (kind, kind));
        let named = kinds
            .chain(&self.receptacles)
            .filter(|(name, _)| letters.contains(name.as_str()));
        let longest = named.max_by_key(|(name, _)| name.len());
        longest.map_or(letters.clone(), |(_, kind)| kind.clone())
    }
}
