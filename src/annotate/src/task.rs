//! What a task says to the agent, taken apart into the thing, where it is and where it shall go.
//!
//! The truth about the task is used here once, to find out which words of the instruction
//! mean what. What comes out are words of the instruction and the list of receptacles that
//! every agent starts with.

use reel_world::{ReceptacleId, Scene, Task, language};

use crate::english;

/// A task as an agent knows it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct PublicTask {
    /// What the agent is told.
    pub instruction: String,
    /// What shall be moved, in words of the instruction: `the timekeeping device`.
    pub object: String,
    /// The same, short: `the notebook`.
    pub object_short: String,
    /// What the thing is for, where the instruction says no more.
    pub purpose: Option<String>,
    /// How many things shall be moved.
    pub moves: usize,
    /// Where the object is at the start of the task.
    pub source: ReceptacleRole,
    /// Where it shall go.
    pub destination: ReceptacleRole,
    /// Every receptacle of the scene, whether the task names it or not.
    pub receptacles: Vec<PublicReceptacle>,
}

/// A part that a receptacle plays in the task.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct ReceptacleRole {
    /// In words of the instruction: `the white cabinet with black handles`.
    pub phrase: String,
    /// Receptacles of the kind that the phrase names; empty where it names none.
    pub alike: Vec<String>,
}

/// A receptacle of the scene: what agents are told of it, and its captions.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct PublicReceptacle {
    /// Its id, which agents know.
    pub id: String,
    /// Category of the furniture, e.g. `cabinet`.
    pub category: String,
    /// Name of the room it stands in, e.g. `living room`.
    pub room: String,
    /// What people call it. Not known to agents: says which of the instruction's words apply
    /// to what they see.
    pub names: Vec<String>,
}

impl PublicTask {
    /// Takes a task apart.
    pub fn of(task: &Task, scene: &Scene) -> Self {
        let target = task
            .objects
            .iter()
            .find(|object| object.instance == task.target);
        let quoted = |words: &&str| language::quotes(&task.instruction, words);
        let category = target.map(|object| object.category.as_str()).filter(quoted);
        let caption = target
            .and_then(|object| object.caption.as_deref())
            .filter(quoted);
        let purpose = task.purpose.as_deref().filter(quoted);
        let named =
            |words: Option<&str>| words.map(|words| english::definite(&english::noun(words)));
        let places = scene.receptacles.iter().map(|receptacle| PublicReceptacle {
            id: receptacle.id.to_string(),
            category: receptacle.category.clone(),
            room: receptacle.room_name().to_owned(),
            names: receptacle.captions.keys().cloned().collect(),
        });
        let places: Vec<PublicReceptacle> = places.collect();
        let moved = task.goal_changes();
        let moved = moved
            .iter()
            .filter(|event| event.object().is_some())
            .count()
            / 2;
        PublicTask {
            instruction: task.instruction.clone(),
            object: named(caption.or(purpose).or(category))
                .unwrap_or_else(|| "the object".to_owned()),
            object_short: named(category.or(purpose)).unwrap_or_else(|| "the object".to_owned()),
            purpose: purpose.map(str::to_owned),
            moves: moved.max(1),
            source: ReceptacleRole::of(
                &task.src,
                &places,
                &task.instruction,
                "the place where it is",
            ),
            destination: ReceptacleRole::of(
                &task.dest,
                &places,
                &task.instruction,
                "the place where it shall go",
            ),
            receptacles: places,
        }
    }

    /// Finds a receptacle by its id; `None` if the scene has none of that id.
    pub fn receptacle(&self, id: &str) -> Option<&PublicReceptacle> {
        self.receptacles.iter().find(|place| place.id == id)
    }
}

impl PublicReceptacle {
    /// What the furniture is called: `washing machine`.
    pub(crate) fn kind(&self) -> String {
        if self.category == "washingmachine" {
            "washing machine".to_owned()
        } else {
            self.category.replace('_', " ")
        }
    }
}

impl ReceptacleRole {
    fn of(
        id: &ReceptacleId,
        places: &[PublicReceptacle],
        instruction: &str,
        unnamed: &str,
    ) -> Self {
        let Some(place) = places.iter().find(|place| place.id == id.as_str()) else {
            return ReceptacleRole {
                phrase: unnamed.to_owned(),
                alike: Vec::new(),
            };
        };
        let names = place
            .names
            .iter()
            .map(String::as_str)
            .chain([place.category.as_str()]);
        let phrase = names
            .filter(|name| language::quotes(instruction, name))
            .max_by_key(|name| name.len());
        let Some(phrase) = phrase else {
            return ReceptacleRole {
                phrase: unnamed.to_owned(),
                alike: Vec::new(),
            };
        };
        let said = says_category(phrase, &place.category);
        let alike = places
            .iter()
            .filter(|other| said && other.category == place.category)
            .map(|other| other.id.clone());
        ReceptacleRole {
            phrase: english::definite(&english::noun(phrase)),
            alike: alike.collect(),
        }
    }

    /// Receptacles of that kind: of those in the room that the phrase names, if it names one.
    pub(crate) fn possible<'a>(&'a self, task: &PublicTask) -> Vec<&'a str> {
        let in_room = |id: &&String| {
            task.receptacle(id).is_some_and(|place| {
                !place.room.is_empty() && language::quotes(&self.phrase, &place.room)
            })
        };
        let in_room: Vec<&str> = self
            .alike
            .iter()
            .filter(in_room)
            .map(String::as_str)
            .collect();
        if in_room.is_empty() {
            self.alike.iter().map(String::as_str).collect()
        } else {
            in_room
        }
    }

    /// Whether the phrase says more than the kind.
    pub(crate) fn is_description(&self, task: &PublicTask) -> bool {
        task.receptacles.iter().any(|place| self.describes(place))
    }

    /// Whether a receptacle is of the kind that is named.
    pub(crate) fn may_be(&self, id: &str) -> bool {
        self.alike.iter().any(|other| other == id)
    }

    /// Whether people call a receptacle so: what one sees on arrival.
    pub(crate) fn describes(&self, place: &PublicReceptacle) -> bool {
        let phrase = self.phrase.to_lowercase();
        place
            .names
            .iter()
            .any(|name| english::definite(&english::noun(name)).to_lowercase() == phrase)
    }
}

/// Whether a phrase names a category in some word: `fridge` for `refrigerator`,
/// `washing machine` for `washingmachine`.
fn says_category(phrase: &str, category: &str) -> bool {
    let words = language::words(phrase);
    let named = |name: &str| language::is_a(name, category) || language::is_a(category, name);
    words.iter().any(|word| named(word)) || words.windows(2).any(|pair| named(&pair.join(" ")))
}
