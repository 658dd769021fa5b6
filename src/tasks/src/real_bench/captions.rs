//! How people call receptacles, learned from the instructions of the tasks: files name a receptacle
//! by its id only, instructions by a caption, in one of a few sentences. Words that occur only in
//! tasks of one receptacle and in several contexts are a caption; what stays of an instruction
//! without its captions is a sentence; and the sentences tell the rarer captions.
//!
//! Knows no wording of its own: nothing is found in tasks that share no sentence.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use crate::field::Field;

/// Longest caption, in words.
const WORDS_MAX: usize = 12;
/// Words that belong to an object that is named, before it.
const ARTICLES: [&str; 3] = ["a", "an", "the"];

/// Captions with how often they are used.
pub(super) type Captions = BTreeMap<String, f64>;

/// The captions of receptacles.
pub(super) fn of_receptacles(
    files: &[(&Path, Field<'_>)],
    receptacles: &[String],
) -> BTreeMap<String, Captions> {
    let mut words = Words::new(receptacles.len());
    let mut texts: Vec<Text> = Vec::new();
    for (_, root) in files {
        for text in instructions(root, receptacles, &mut words).unwrap_or_default() {
            if !texts
                .iter()
                .any(|known| known.raw == text.raw && known.places == text.places)
            {
                texts.push(text);
            }
        }
    }
    let sentences = sentences(&texts, &words);
    let readings: Vec<Vec<Reading>> = texts
        .iter()
        .map(|text| {
            sentences
                .iter()
                .flat_map(|sentence| readings(text, sentence, &words))
                .collect()
        })
        .collect();
    // A caption that other texts confirm decides where a text can be read in several ways.
    let mut votes: BTreeMap<(usize, &str), f64> = BTreeMap::new();
    for (text, readings) in texts.iter().zip(&readings) {
        for reading in readings {
            for (place, caption) in text.mentions(reading) {
                #[expect(clippy::cast_precision_loss, reason = "a text has few readings")]
                let share = 1.0 / readings.len() as f64;
                *votes.entry((place, caption)).or_default() += share;
            }
        }
    }
    let mut captions: BTreeMap<String, Captions> = BTreeMap::new();
    for (text, readings) in texts.iter().zip(&readings) {
        let support = |reading: &Reading| {
            text.mentions(reading)
                .map(|mention| votes[&mention])
                .into_iter()
                .fold(f64::MAX, f64::min)
        };
        let best = readings.iter().reduce(|best, other| {
            if support(other) > support(best) {
                other
            } else {
                best
            }
        });
        for (place, caption) in best.into_iter().flat_map(|reading| text.mentions(reading)) {
            *captions
                .entry(receptacles[place].clone())
                .or_default()
                .entry(caption.to_owned())
                .or_default() += 1.0;
        }
    }
    captions
}

/// Words as numbers: 0 is the object, then come the receptacles, then the words.
struct Words {
    numbers: BTreeMap<String, u32>,
    receptacles: usize,
}

const OBJECT: u32 = 0;

impl Words {
    fn new(receptacles: usize) -> Self {
        Self {
            numbers: BTreeMap::new(),
            receptacles,
        }
    }

    fn of(&mut self, word: &str) -> u32 {
        let next = self.place(self.receptacles + self.numbers.len());
        *self.numbers.entry(word.to_owned()).or_insert(next)
    }

    /// The number that stands for a receptacle.
    #[expect(clippy::cast_possible_truncation, reason = "a benchmark has few words")]
    fn place(&self, receptacle: usize) -> u32 {
        receptacle as u32 + 1
    }

    /// Whether a number is a word that captions may hold.
    fn is_word(&self, number: u32) -> bool {
        number > self.place(self.receptacles) - 1 && !self.marks().any(|mark| mark == number)
    }

    fn marks(&self) -> impl Iterator<Item = u32> {
        [",", ".", ";"]
            .into_iter()
            .filter_map(|mark| self.numbers.get(mark).copied())
    }
}

/// An instruction with the words that may describe its receptacles.
struct Text {
    raw: String,
    /// Its words, with the object as one of them, and where in `raw` they stand.
    words: Vec<u32>,
    spans: Vec<(usize, usize)>,
    /// Indices of source and destination among the receptacles.
    places: [usize; 2],
}

/// Which words of a text name its source and its destination.
type Reading = [(usize, usize); 2];

impl Text {
    /// The receptacles that a reading names, with their captions.
    fn mentions(&self, reading: &Reading) -> [(usize, &str); 2] {
        let caption =
            |(from, to): (usize, usize)| &self.raw[self.spans[from].0..self.spans[to - 1].1];
        [
            (self.places[0], caption(reading[0])),
            (self.places[1], caption(reading[1])),
        ]
    }
}

/// The instructions of a file that name its target.
fn instructions(root: &Field<'_>, receptacles: &[String], words: &mut Words) -> Option<Vec<Text>> {
    let mut texts = Vec::new();
    for episode in root.get("episodes").ok()?.items().ok()? {
        let text = |field: &Field<'_>, key: &str| {
            Some(
                field
                    .find(key)
                    .ok()??
                    .text()
                    .ok()?
                    .trim_end_matches('.')
                    .to_owned(),
            )
        };
        let place = |key: &str| {
            receptacles
                .iter()
                .position(|id| Some(id.as_str()) == text(&episode, key).as_deref())
        };
        let places = [place("src")?, place("dest")?];
        let target = episode
            .get("obj_meta")
            .ok()?
            .get(&text(&episode, "target_object_id")?)
            .ok()?;
        let names = [
            text(&target, "detailed_caption"),
            text(&target, "category"),
            text(&episode, "purpose"),
        ];
        for key in ["benchmark_instruction", "task_description"] {
            let Some(raw) = episode.find(key).ok()?.and_then(|field| field.text().ok()) else {
                continue;
            };
            // ASCII only, so that places in both cases are the same.
            let lower = raw.to_ascii_lowercase();
            let named = names.iter().flatten().find_map(|name| {
                let at = lower.find(&name.to_ascii_lowercase())?;
                Some((at, at + name.len()))
            });
            if let Some(object) = named {
                let (numbers, spans) = split(raw, object, words);
                texts.push(Text {
                    raw: raw.to_owned(),
                    words: numbers,
                    spans,
                    places,
                });
            }
        }
    }
    Some(texts)
}

/// The words of a text, with the object in `object` as one word.
fn split(raw: &str, object: (usize, usize), words: &mut Words) -> (Vec<u32>, Vec<(usize, usize)>) {
    let (mut numbers, mut spans): (Vec<u32>, Vec<(usize, usize)>) = (Vec::new(), Vec::new());
    let mut add =
        |from: usize, to: usize, numbers: &mut Vec<u32>, spans: &mut Vec<(usize, usize)>| {
            let mut start = None;
            for (at, c) in raw[from..to]
                .char_indices()
                .map(|(at, c)| (from + at, c))
                .chain([(to, ' ')])
            {
                let ends = c.is_whitespace() || ",.;".contains(c);
                if let (true, Some(begin)) = (ends, start) {
                    numbers.push(words.of(&raw[begin..at]));
                    spans.push((begin, at));
                    start = None;
                }
                if !c.is_whitespace() && ends {
                    numbers.push(words.of(&raw[at..at + 1]));
                    spans.push((at, at + 1));
                }
                if !ends && start.is_none() {
                    start = Some(at);
                }
            }
        };
    add(0, object.0, &mut numbers, &mut spans);
    while spans
        .last()
        .is_some_and(|(from, to)| ARTICLES.contains(&&raw[*from..*to]))
    {
        numbers.pop();
        spans.pop();
    }
    numbers.push(OBJECT);
    spans.push(object);
    add(object.1, raw.len(), &mut numbers, &mut spans);
    (numbers, spans)
}

/// The sentences that instructions are made of: words, the object,
/// and [`SOURCE`] and [`DESTINATION`].
fn sentences(texts: &[Text], words: &Words) -> Vec<Vec<u32>> {
    let mut counts: BTreeMap<Vec<u32>, usize> = BTreeMap::new();
    for (text, masked) in texts.iter().zip(mask(texts, words)) {
        let ends = text.places.map(|place| words.place(place));
        let role = |number: u32| {
            if number == ends[0] {
                SOURCE
            } else {
                DESTINATION
            }
        };
        let sentence: Vec<u32> = masked
            .into_iter()
            .map(|number| {
                if ends.contains(&number) {
                    role(number)
                } else {
                    number
                }
            })
            .collect();
        let once = |role: u32| sentence.iter().filter(|number| **number == role).count() == 1;
        if once(SOURCE) && once(DESTINATION) {
            *counts.entry(sentence).or_default() += 1;
        }
    }
    // A sentence that lacks words of a more frequent one comes from captions with words too many.
    let lacks = |one: &[u32], other: &[u32]| {
        let mut rest = other.iter();
        one.len() < other.len() && one.iter().all(|number| rest.any(|next| next == number))
    };
    let shortened = |one: &[u32], count: usize| {
        counts
            .iter()
            .any(|(other, more)| *more > count && lacks(one, other))
    };
    let good = counts
        .iter()
        .filter(|(sentence, count)| **count >= 2 && !shortened(sentence, **count));
    good.map(|(sentence, _)| sentence.clone()).collect()
}

/// Stands for the source in a sentence.
const SOURCE: u32 = u32::MAX - 1;
/// Stands for the destination in a sentence.
const DESTINATION: u32 = u32::MAX;

/// The texts with the captions that can be told by their words alone as one word each.
fn mask(texts: &[Text], words: &Words) -> Vec<Vec<u32>> {
    let mut masked: Vec<Vec<u32>> = texts.iter().map(|text| text.words.clone()).collect();
    while let Some((caption, place)) = clearest(texts, &masked, words) {
        for (_, masked) in texts
            .iter()
            .zip(&mut masked)
            .filter(|(text, _)| text.places.contains(&place))
        {
            while let Some(at) = masked
                .windows(caption.len())
                .position(|window| window == caption)
            {
                masked.splice(at..at + caption.len(), [words.place(place)]);
            }
        }
    }
    masked
}

/// What is known of some words in a row.
#[derive(Default)]
struct Use {
    /// The receptacles that all texts with them have in common.
    places: Option<BTreeSet<usize>>,
    before: BTreeSet<Option<u32>>,
    after: BTreeSet<Option<u32>>,
    texts: BTreeSet<usize>,
}

/// The words in a row that explain the most: only in tasks of one receptacle, in several contexts.
fn clearest(texts: &[Text], masked: &[Vec<u32>], words: &Words) -> Option<(Vec<u32>, usize)> {
    let mut uses: BTreeMap<&[u32], Use> = BTreeMap::new();
    for (index, (text, masked)) in texts.iter().zip(masked).enumerate() {
        for from in 0..masked.len() {
            let length = masked[from..]
                .iter()
                .take(WORDS_MAX)
                .take_while(|number| words.is_word(**number))
                .count();
            for to in from + 2..=from + length {
                let known = uses.entry(&masked[from..to]).or_default();
                let here = BTreeSet::from(text.places);
                known.places = Some(
                    known
                        .places
                        .take()
                        .map_or_else(|| here.clone(), |places| &places & &here),
                );
                known
                    .before
                    .insert(from.checked_sub(1).map(|at| masked[at]));
                known.after.insert(masked.get(to).copied());
                known.texts.insert(index);
            }
        }
    }
    let mut best: Option<(usize, &[u32], usize)> = None;
    for (caption, known) in &uses {
        let [Some(place), None] = ({
            let mut places = known.places.iter().flatten().copied();
            [places.next(), places.next()]
        }) else {
            continue;
        };
        let explained = known.texts.len() * (caption.len() - 1);
        if known.before.len() > 1
            && known.after.len() > 1
            && best.is_none_or(|(most, ..)| explained > most)
        {
            best = Some((explained, caption, place));
        }
    }
    best.map(|(_, caption, place)| (caption.to_vec(), place))
}

/// All ways in which a text is this sentence.
fn readings(text: &Text, sentence: &[u32], words: &Words) -> Vec<Reading> {
    let mut found = Vec::new();
    read(&text.words, sentence, 0, [(0, 0); 2], words, &mut found);
    found
}

fn read(
    text: &[u32],
    sentence: &[u32],
    at: usize,
    reading: Reading,
    words: &Words,
    found: &mut Vec<Reading>,
) {
    let Some((next, rest)) = sentence.split_first() else {
        if at == text.len() {
            found.push(reading);
        }
        return;
    };
    if *next != SOURCE && *next != DESTINATION {
        if text.get(at) == Some(next) {
            read(text, rest, at + 1, reading, words, found);
        }
        return;
    }
    let length = text[at.min(text.len())..]
        .iter()
        .take(WORDS_MAX)
        .take_while(|number| words.is_word(**number))
        .count();
    for to in at + 1..=at + length {
        let mut reading = reading;
        reading[usize::from(*next == DESTINATION)] = (at, to);
        read(text, rest, to, reading, words, found);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document;

    fn task(instruction: &str, src: &str, dest: &str) -> String {
        format!(
            "{{episodes: [{{benchmark_instruction: \"{instruction}\", src: {src}, dest: {dest}, target_object_id: m, \
             obj_meta: {{m: {{category: mug}}}}}}]}}"
        )
    }

    fn found(tasks: &[String]) -> BTreeMap<String, Vec<String>> {
        let nodes: Vec<_> = tasks
            .iter()
            .map(|task| document::parse(task).unwrap())
            .collect();
        let files: Vec<(&Path, Field<'_>)> = nodes
            .iter()
            .map(|node| (Path::new("task.yaml"), Field::root(node)))
            .collect();
        let receptacles = ["table_1", "table_2", "bed_1", "sink_1"].map(str::to_owned);
        let captions = of_receptacles(&files, &receptacles);
        captions
            .into_iter()
            .map(|(id, captions)| (id, captions.into_keys().collect()))
            .collect()
    }

    #[test]
    fn captions_are_what_sentences_leave_over() {
        let mut tasks = Vec::new();
        let called = [
            ("table_1", "the table to eat at"),
            ("table_1", "a big  table"),
            ("table_2", "the low table"),
            ("bed_1", "the bed with a net"),
        ];
        for (src, source) in called {
            for (dest, destination) in called.iter().filter(|(dest, _)| *dest != src) {
                tasks.push(task(
                    &format!("Bring the mug from {source} to {destination}."),
                    src,
                    dest,
                ));
                tasks.push(task(
                    &format!("Take a mug on {source}, and put it on {destination} at last."),
                    src,
                    dest,
                ));
            }
        }
        // Named once only.
        tasks.push(task(
            "Bring the mug from the low table to one steel sink next to the door.",
            "table_2",
            "sink_1",
        ));
        let expected: [(&str, &[&str]); 4] = [
            ("bed_1", &["the bed with a net"]),
            ("sink_1", &["one steel sink next to the door"]),
            ("table_1", &["a big  table", "the table to eat at"]),
            ("table_2", &["the low table"]),
        ];
        let expected = expected.map(|(id, captions)| {
            (
                id.to_owned(),
                captions.iter().map(|text| (*text).to_owned()).collect(),
            )
        });
        assert_eq!(found(&tasks), BTreeMap::from(expected));
    }

    #[test]
    fn too_few_tasks_tell_nothing() {
        assert_eq!(
            found(&[task(
                "Bring the mug from the table to the bed.",
                "table_1",
                "bed_1"
            )]),
            BTreeMap::new()
        );
    }
}
