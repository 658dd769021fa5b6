//! What belongs where: which objects a receptacle of a kind plausibly holds in a room of a kind (`data/compatibility.json`), and
//! so which (source, destination, object) triplets make sense. Knows words, never sizes or places.

use std::{collections::BTreeMap, sync::OnceLock};

use reel_tasks::library::LibraryObject;
use reel_world::Receptacle;
use serde::Deserialize;

/// The table.
#[derive(Deserialize)]
pub struct Compatibility {
    /// Other names of rooms.
    rooms: BTreeMap<String, String>,
    /// Other names of receptacles.
    receptacles: BTreeMap<String, String>,
    /// Purposes and categories that go together, by a name.
    groups: BTreeMap<String, Vec<String>>,
    holds: Vec<Row>,
}

/// Receptacles of these kinds, in these rooms or in any, hold these things. The first row that fits a receptacle counts.
#[derive(Deserialize)]
struct Row {
    receptacles: Vec<String>,
    #[serde(default)]
    rooms: Vec<String>,
    /// Purposes, categories or names of groups.
    what: Vec<String>,
}

impl Compatibility {
    /// The table that comes with Reel.
    pub fn committed() -> &'static Self {
        static TABLE: OnceLock<Compatibility> = OnceLock::new();
        TABLE.get_or_init(|| {
            serde_json::from_str(include_str!("../../data/compatibility.json")).expect("the committed table is well formed")
        })
    }

    /// Whether an object plausibly stands on a receptacle.
    pub fn holds(&self, receptacle: &Receptacle, object: &LibraryObject) -> bool {
        self.row(receptacle).is_some_and(|row| row.what.iter().any(|what| self.means(what, object)))
    }

    /// Whether an object plausibly goes from one receptacle to the other.
    pub fn is_plausible(&self, src: &Receptacle, dest: &Receptacle, object: &LibraryObject) -> bool {
        src.id != dest.id && self.holds(src, object) && self.holds(dest, object)
    }

    /// Whether the table speaks of an object at all.
    pub fn knows_object(&self, object: &LibraryObject) -> bool {
        self.holds.iter().any(|row| row.what.iter().any(|what| self.means(what, object)))
    }

    fn means(&self, what: &str, object: &LibraryObject) -> bool {
        let is = |name: &str| name == object.purpose || name == object.category;
        is(what) || self.groups.get(what).is_some_and(|names| names.iter().any(|name| is(name)))
    }

    fn row(&self, receptacle: &Receptacle) -> Option<&Row> {
        let (room, kind) = (self.room(&receptacle.room), self.kind(&receptacle.category));
        let fits = |row: &&Row| row.receptacles.contains(&kind) && (row.rooms.is_empty() || row.rooms.contains(&room));
        self.holds.iter().find(fits)
    }

    /// `dinning room/0` is a dining room.
    fn room(&self, name: &str) -> String {
        let kind = name.split('/').next().unwrap_or(name).trim().to_lowercase();
        self.rooms.get(&kind).cloned().unwrap_or(kind)
    }

    /// The kind of a category: itself, another name of one, or the longest of both that stands in it (`coffee table`).
    fn kind(&self, category: &str) -> String {
        let letters: String = category.to_lowercase().chars().filter(|letter| letter.is_alphanumeric()).collect();
        let kinds = self.holds.iter().flat_map(|row| &row.receptacles).map(|kind| (kind, kind));
        let named = kinds.chain(&self.receptacles).filter(|(name, _)| letters.contains(name.as_str()));
        let longest = named.max_by_key(|(name, _)| name.len());
        longest.map_or(letters.clone(), |(_, kind)| kind.clone())
    }
}
