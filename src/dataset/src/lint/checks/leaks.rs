//! Privileged text: what no agent reads (debug information, world graphs, plans, poses, instances,
//! oracle metadata), in prompts, answers, calls and descriptions of tools.
//!
//! Why: a model that trains on it learns to read what it will not have, or to make it up. Sure:
//! whatever is found is said somewhere in the row; other people's data may mean something else by
//! the same words. What is split over turns, spelled with letters of other alphabets, spaced out,
//! encoded or escaped is found; what is encrypted or said in other words is not. Memory: constant;
//! texts that were clean are remembered up to a bound.

use std::{borrow::Cow, collections::HashSet};

use crate::{PrivilegedFacts, find_leak};

use super::{
    Check, RowFacts,
    row_facts::{Key, key_of},
};
use crate::lint::{Part, Severity, Turn, report::Findings};

pub(super) struct Leaks {
    secrets: PrivilegedFacts,
    /// Long paragraphs that were clean: instructions and lists of tools are the same in all rows.
    clean: HashSet<Key>,
}

/// Paragraphs that are remembered, and how long they are at least, in bytes.
const CLEAN_MAX: usize = 4096;
const CLEAN_LENGTH_MIN: usize = 160;
/// Length of text on each side of the border of two turns, in characters.
const BORDER: usize = 200;

impl Leaks {
    pub(super) fn new() -> Self {
        Self {
            secrets: PrivilegedFacts::none(),
            clean: HashSet::new(),
        }
    }

    /// The first privileged thing in a text: what it is, and an excerpt.
    fn of(&mut self, text: &str) -> Option<(&'static str, String)> {
        let mut fresh = String::with_capacity(text.len());
        let mut long = Vec::new();
        for paragraph in text.split("\n\n") {
            let key = (paragraph.len() >= CLEAN_LENGTH_MIN).then(|| key_of(paragraph.as_bytes()));
            if key.is_some_and(|key| self.clean.contains(&key)) {
                continue;
            }
            long.extend(key);
            fresh.push_str(paragraph);
            fresh.push_str("\n\n");
        }
        let found = self.in_any_spelling(&fresh);
        if found.is_none() && self.clean.len() + long.len() <= CLEAN_MAX {
            self.clean.extend(long);
        }
        found
    }

    fn in_any_spelling(&self, text: &str) -> Option<(&'static str, String)> {
        let leak = |text: &str| {
            find_leak(text, &self.secrets)
                .map(|leak| (leak.kind.as_str(), around(text, &leak.span)))
        };
        leak(text).or_else(|| match plain_spelling(text) {
            Cow::Owned(plain) => leak(&plain),
            Cow::Borrowed(_) => None,
        })
    }
}

impl Check for Leaks {
    fn about(&self) -> (&'static str, &'static str) {
        (
            "leaks",
            "text that no agent may read: debug information, world graphs, plans, poses, instances, oracle metadata",
        )
    }

    fn see(&mut self, seen: &RowFacts, found: &mut Findings) {
        // Coordinates and plans of other worlds are the agent's own.
        if seen.has_own_tools() {
            return;
        }
        let turns: Vec<String> = seen.example.turns.iter().map(all_text).collect();
        let tools = seen.example.tools.as_ref().map(|tools| tools.to_string());
        let mut clean = true;
        for (number, text) in turns.iter().chain(&tools).enumerate() {
            if let Some((what, excerpt)) = self.of(text) {
                clean = false;
                let whose = seen
                    .example
                    .turns
                    .get(number)
                    .map_or("declaration of tools", |turn| turn.role.as_str());
                let answer = seen
                    .example
                    .turns
                    .get(number)
                    .is_some_and(|turn| turn.role.is_answer());
                let kind = if answer {
                    "in an answer"
                } else {
                    "in a prompt"
                };
                found.add(kind, Severity::Error, &[seen.place()], || {
                    (format!("{what}, in the {whose}'s text"), excerpt)
                });
            }
        }
        if !clean {
            return;
        }
        for pair in turns.windows(2) {
            let tail: String = pair[0]
                .trim_end()
                .chars()
                .rev()
                .take(BORDER)
                .collect::<Vec<_>>()
                .into_iter()
                .rev()
                .collect();
            let head: String = pair[1].trim_start().chars().take(BORDER).collect();
            let joined = ["", " "]
                .iter()
                .find_map(|between| self.in_any_spelling(&format!("{tail}{between}{head}")));
            if let Some((what, excerpt)) = joined {
                found.add("over two turns", Severity::Error, &[seen.place()], || {
                    (format!("{what}, split over two turns"), excerpt)
                });
            }
        }
    }
}

/// All that the model reads or says in a turn.
fn all_text(turn: &Turn) -> String {
    let mut text = String::new();
    for part in &turn.parts {
        match part {
            Part::Text(said) => text.push_str(said),
            Part::Image(_) => text.push(' '),
            Part::Call(call) => text.push_str(&format!("\n\n{} {}", call.name, call.arguments)),
        }
    }
    text
}

fn around(text: &str, span: &std::ops::Range<usize>) -> String {
    let before = text[..span.start]
        .char_indices()
        .rev()
        .nth(30)
        .map_or(0, |(at, _)| at);
    let after = text[span.end..]
        .char_indices()
        .nth(60)
        .map_or(text.len(), |(at, _)| span.end + at);
    text[before..after]
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ")
}

/// A text as it would look in plain ASCII: letters that look alike, marks of emphasis, rows of
/// single letters, white space.
fn plain_spelling(text: &str) -> Cow<'_, str> {
    let mut plain = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '*' | '`' | '~' => {}
            '\u{300}'..='\u{36f}' => {}
            c if c.is_whitespace() => {
                if !plain.ends_with(' ') {
                    plain.push(' ');
                }
            }
            c => plain.push(look_alike(c)),
        }
    }
    let spaced = joined_letters(&plain);
    if spaced == text {
        Cow::Borrowed(text)
    } else {
        Cow::Owned(spaced)
    }
}

/// `w o r l d _ g r a p h` as one word: rows of at least five single letters.
fn joined_letters(text: &str) -> String {
    let mut words: Vec<String> = Vec::new();
    let mut run: Vec<&str> = Vec::new();
    let flush = |run: &mut Vec<&str>, words: &mut Vec<String>| {
        if run.len() >= 5 {
            words.push(run.concat());
        } else {
            words.extend(run.iter().map(|word| (*word).to_owned()));
        }
        run.clear();
    };
    for word in text.split(' ') {
        let letter = word.len() == 1
            && word
                .bytes()
                .all(|byte| byte.is_ascii_alphabetic() || byte == b'_');
        if letter {
            run.push(word);
        } else {
            flush(&mut run, &mut words);
            words.push(word.to_owned());
        }
    }
    flush(&mut run, &mut words);
    words.join(" ")
}

/// The ASCII letter that a letter of another alphabet looks like.
fn look_alike(c: char) -> char {
    match c {
        '\u{ff01}'..='\u{ff5e}' => char::from_u32(u32::from(c) - 0xfee0).unwrap_or(c),
        'а' | 'α' | 'à' | 'á' | 'â' | 'ä' => 'a',
        'А' | 'Α' => 'A',
        'В' | 'Β' => 'B',
        'с' | 'ϲ' => 'c',
        'С' | 'Ϲ' => 'C',
        'ԁ' => 'd',
        'е' | 'ё' | 'ε' | 'è' | 'é' | 'ê' => 'e',
        'Е' | 'Ε' => 'E',
        'ɡ' | 'ց' => 'g',
        'һ' => 'h',
        'Н' | 'Η' => 'H',
        'і' | 'ι' | 'ı' | 'ì' | 'í' => 'i',
        'І' | 'Ι' => 'I',
        'ј' => 'j',
        'К' | 'Κ' => 'K',
        'ӏ' => 'l',
        'М' | 'Μ' => 'M',
        'Ν' => 'N',
        'п' | 'ո' => 'n',
        'о' | 'ο' | 'օ' | 'ò' | 'ó' | 'ö' => 'o',
        'О' | 'Ο' => 'O',
        'р' | 'ρ' => 'p',
        'Р' | 'Ρ' => 'P',
        'г' => 'r',
        'ѕ' => 's',
        'Т' | 'Τ' => 'T',
        'τ' => 't',
        'υ' | 'ս' | 'ù' | 'ú' | 'ü' => 'u',
        'ѵ' | 'ν' => 'v',
        'ѡ' | 'ԝ' => 'w',
        'х' | 'χ' => 'x',
        'у' | 'γ' => 'y',
        '\u{2010}'..='\u{2015}' | '\u{2212}' => '-',
        '\u{2018}' | '\u{2019}' => '\'',
        '\u{201c}' | '\u{201d}' => '"',
        c => c,
    }
}
