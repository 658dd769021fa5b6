//! How people call the furniture of a scene: captions made of what is seen, each true
//! of one piece only.

use std::collections::BTreeMap;

use crate::random::Stream;
use reel_world::{Receptacle, language::indefinite};

use super::looks::noun;

/// Pieces nearer than this are next to each other, in metres.
const BESIDE_M: f64 = 0.35;
/// Pieces before a couch stand at most this far from it, in metres.
const BEFORE_M: f64 = 1.2;
/// A bed of this width is for two, in metres.
const DOUBLE_M: f64 = 1.4;

/// One thing that a caption says.
#[derive(Clone, PartialEq, Debug)]
enum Fact {
    /// Its colour or wood.
    Body(String),
    /// A part and what it is like: `handles`, `black`.
    Part(&'static str, String),
    Size(&'static str),
    Room(String),
    /// A place beside or before something there is one of.
    At(String),
}

/// Gives every piece two or three captions, the usual one with the greatest weight; false where a
/// piece has none that is true of it alone.
pub(super) fn write(pieces: &mut [Receptacle], stream: &mut Stream) -> bool {
    write_each(pieces, stream).is_empty()
}

/// Gives every piece two or three captions, and returns the indices of those that have none that is
/// true of them alone.
pub(super) fn write_each(pieces: &mut [Receptacle], stream: &mut Stream) -> Vec<usize> {
    let mut without = Vec::new();
    let facts: Vec<Vec<Fact>> = (0..pieces.len())
        .map(|index| facts(pieces, index))
        .collect();
    for index in 0..pieces.len() {
        let most = 2 + stream.below(2);
        let name = pieces[index].category.clone();
        let alone = |said: &[&Fact]| {
            let others = (0..pieces.len())
                .filter(|other| *other != index && is_called(&pieces[*other], &name));
            others
                .filter(|other| said.iter().all(|fact| facts[*other].contains(fact)))
                .count()
                == 0
        };
        let own = &facts[index];
        let mut sayings: Vec<Vec<&Fact>> = vec![Vec::new()];
        sayings.extend(own.iter().map(|fact| vec![fact]));
        sayings.extend(pairs(own));
        sayings.extend(own.iter().enumerate().flat_map(|(first, fact)| {
            pairs(&own[first + 1..])
                .into_iter()
                .map(move |pair| [vec![fact], pair].concat())
        }));
        // The shortest that are true of it alone; then what says more than they do.
        let (mut told, mut longer): (Vec<Vec<&Fact>>, Vec<Vec<&Fact>>) = (Vec::new(), Vec::new());
        for said in sayings.into_iter().filter(|said| alone(said)) {
            let says_more = told
                .iter()
                .any(|other| !other.is_empty() && other.iter().all(|fact| said.contains(fact)));
            if says_more {
                longer.push(said)
            } else {
                told.push(said)
            }
        }
        let captions: Vec<String> = told
            .iter()
            .chain(&longer)
            .take(most)
            .map(|said| phrase(&name, said))
            .collect();
        if captions.is_empty() {
            without.push(index);
        }
        let weights = [3.0, 2.0, 1.0];
        pieces[index].captions = captions
            .into_iter()
            .zip(weights)
            .collect::<BTreeMap<_, _>>();
    }
    without
}

fn pairs(facts: &[Fact]) -> Vec<Vec<&Fact>> {
    let later = |first: usize| facts[first + 1..].iter();
    facts
        .iter()
        .enumerate()
        .flat_map(|(first, fact)| later(first).map(move |other| vec![fact, other]))
        .collect()
}

/// Whether people may call a piece by a name: a tea table is a table.
fn is_called(piece: &Receptacle, name: &str) -> bool {
    piece.category == name || (noun(&piece.category) == name && !name.contains(' '))
}

/// What can be said of a piece, in the order people say it.
fn facts(pieces: &[Receptacle], index: usize) -> Vec<Fact> {
    let piece = &pieces[index];
    let word = |kind: &str| piece.attributes.get(kind).and_then(|words| words.first());
    let mut facts = Vec::new();
    let material = word("material").filter(|word| word.as_str() != "fabric");
    facts.extend(word("colour").or(material).cloned().map(Fact::Body));
    let parts = ["bedding", "top", "basin", "handles", "pillows", "legs"];
    facts.extend(
        parts
            .iter()
            .filter_map(|part| Some(Fact::Part(part, word(part)?.clone()))),
    );
    facts.push(Fact::Room(piece.room_name().to_owned()));
    facts.extend(neighbours(pieces, index).into_iter().map(Fact::At));
    if piece.category == "bed" {
        let width = (0..2)
            .map(|axis| piece.surface_max[axis] - piece.surface_min[axis])
            .fold(f64::MAX, f64::min);
        facts.push(Fact::Size(if width >= DOUBLE_M {
            "double"
        } else {
            "single"
        }));
    }
    facts
}

/// Places relative to things of which the scene has one.
fn neighbours(pieces: &[Receptacle], index: usize) -> Vec<String> {
    let piece = &pieces[index];
    let is_one = |other: &Receptacle| {
        pieces
            .iter()
            .filter(|any| is_called(any, noun(&other.category)))
            .count()
            == 1
    };
    let others = pieces
        .iter()
        .filter(|other| other.id != piece.id && other.room == piece.room && is_one(other));
    let mut places = Vec::new();
    for other in others {
        let gap = |axis: usize| {
            let [low, high] = [other.surface_min[axis], other.surface_max[axis]];
            (low - piece.surface_max[axis]).max(piece.surface_min[axis] - high)
        };
        let apart = gap(0).max(gap(1));
        let ahead = other.facing_deg.is_some_and(|degrees| {
            let axis = usize::from(degrees == 90.0 || degrees == 270.0);
            let forward = piece.surface_min[axis] + piece.surface_max[axis]
                > other.surface_min[axis] + other.surface_max[axis];
            gap(axis) > 0.0 && gap(1 - axis) < -0.2 && forward == (degrees < 180.0)
        });
        if apart <= BESIDE_M && gap(0).min(gap(1)) < -0.1 {
            places.push(format!("next to the {}", other.category));
        } else if other.category == "couch" && ahead && apart <= BEFORE_M {
            places.push("in front of the couch".to_owned());
        }
    }
    places
}

fn phrase(name: &str, said: &[&Fact]) -> String {
    let name = if name == "tv stand" { "TV stand" } else { name };
    let mut before = String::new();
    let mut with = Vec::new();
    let mut after = String::new();
    for fact in said {
        match fact {
            Fact::Body(word) => before = format!("{before}{word} "),
            Fact::Size(word) => before = format!("{word} {before}"),
            Fact::Part(part @ ("top" | "basin"), word) => {
                with.push(format!("{} {part}", indefinite(word)))
            }
            Fact::Part(part, word) => with.push(format!("{word} {part}")),
            Fact::Room(room) => {
                let at = if room == "balcony" { "on" } else { "in" };
                after = format!("{after} {at} the {room}");
            }
            Fact::At(place) => after = format!("{after} {}", place.replace("tv stand", "TV stand")),
        }
    }
    let with = if with.is_empty() {
        String::new()
    } else {
        format!(" with {}", with.join(" and "))
    };
    format!("the {before}{name}{with}{after}")
}
