//! Words: which categories a query in open vocabulary means, attribute words of a caption, and
//! whether an object fits what was said.
//!
//! All of it is a committed vocabulary (`data/vocabulary.txt`, `data/attributes.txt`) and simple
//! rules over English words: the same answer everywhere, readable by people. Never a model, and
//! nothing about a particular scene or task.

mod phrase;
mod vocabulary;
mod words;

use std::collections::{BTreeMap, BTreeSet};

use crate::{Attributes, ObjectInstance};
use phrase::{Phrase, phrases};
use vocabulary::{attributes, heads, vocabulary};
use words::{Token, normal};
pub use words::{lemma, words};

/// How a query met categories, from the best kind to none.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum MatchKind {
    /// The category consists of the same words as the query.
    Exact,
    /// The same words up to plural, articles and spelling with or without spaces.
    Lemma,
    /// Another word for the same.
    Synonym,
    /// One is a more general word for the other, by the vocabulary or by the head
    /// noun (`alarm clock`, `clock`).
    Hypernym,
    /// No category that is present matches the query.
    None,
}

/// The categories that a query means.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Match {
    /// Sorted, without repetition; empty only for [`MatchKind::None`].
    pub categories: Vec<String>,
    /// The best kind of match that any category reached.
    pub kind: MatchKind,
}

/// Matches a query to the categories that are present (docs/spec.md#tools,
/// `show_object_by_category`): all that match in the best kind. A hypernym means all its members;
/// where nothing else matches, the head of the query decides.
pub fn match_category(query: &str, categories: &BTreeSet<&str>) -> Match {
    let query_words = words(query);
    let query = normal(query);
    let canonical = vocabulary().canonical(&query);
    let compact = query.replace(' ', "");
    let pick = |kind: MatchKind, matches: &dyn Fn(&str) -> bool| {
        let categories: Vec<String> = categories
            .iter()
            .filter(|name| matches(name))
            .map(ToString::to_string)
            .collect();
        (!query.is_empty() && !categories.is_empty()).then_some(Match { categories, kind })
    };
    let is = |name: &str, kind: &str| vocabulary().lineage(&normal(name)).contains(kind);
    pick(MatchKind::Exact, &|name| words(name) == query_words)
        .or_else(|| {
            pick(MatchKind::Lemma, &|name| {
                normal(name).replace(' ', "") == compact
            })
        })
        .or_else(|| {
            pick(MatchKind::Synonym, &|name| {
                vocabulary().canonical(&normal(name)) == canonical
            })
        })
        .or_else(|| pick(MatchKind::Hypernym, &|name| is(name, &canonical)))
        .or_else(|| {
            heads(&query).find_map(|head| {
                let head = vocabulary().canonical(head);
                pick(MatchKind::Hypernym, &|name| is(name, &head))
            })
        })
        .unwrap_or(Match {
            categories: Vec::new(),
            kind: MatchKind::None,
        })
}

/// Whether the word list knows a query: as it stands, or without its first words.
pub fn is_known_word(query: &str) -> bool {
    let name = normal(query);
    std::iter::once(name.as_str())
        .chain(heads(&name))
        .any(|part| vocabulary().known(part) || is_known_kind(part))
}

/// Whether a thing of this category is also called `kind`: the same, a synonym, a hypernym or its
/// head noun (`alarm clock` is a `timekeeping device`).
pub fn is_a(category: &str, kind: &str) -> bool {
    vocabulary()
        .lineage(&normal(category))
        .contains(&vocabulary().canonical(&normal(kind)))
}

/// Whether it is known of any category that it is of this kind; else [`is_a`] only finds
/// what is called so.
pub fn is_known_kind(kind: &str) -> bool {
    vocabulary().has_kinds(&vocabulary().canonical(&normal(kind)))
}

/// Colour, material, shape and size words of a caption, as they were said, in their order.
pub fn attribute_words(text: &str) -> Attributes {
    let mut found = Attributes::new();
    let lower = text.to_lowercase();
    for chunk in lower.split(|letter: char| !letter.is_alphanumeric() && letter != '-') {
        let known = |word: &str| attributes().values().any(|words| words.contains_key(word));
        let parts: Vec<&str> = if known(chunk) {
            vec![chunk]
        } else {
            chunk.split('-').collect()
        };
        for part in parts {
            for (kind, _) in attributes()
                .iter()
                .filter(|(_, words)| words.contains_key(part))
            {
                let words: &mut Vec<String> = found.entry(kind.clone()).or_default();
                if !words.iter().any(|word| word == part) {
                    words.push(part.to_owned());
                }
            }
        }
    }
    found
}

/// Whether a text says a caption word for word, but for case and punctuation.
pub fn quotes(text: &str, caption: &str) -> bool {
    let (text, caption) = (words(text), words(caption));
    !caption.is_empty() && text.windows(caption.len()).any(|window| window == caption)
}

/// `an` before a vowel letter, else `a`, as REAL writes it: sound does not count.
pub fn article(word: &str) -> &'static str {
    let vowel = word.starts_with(|first: char| "aeiou".contains(first.to_ascii_lowercase()));
    if vowel { "an" } else { "a" }
}

/// `egg` as `an egg`.
pub fn indefinite(noun: &str) -> String {
    format!("{} {noun}", article(noun))
}

/// Whether an object is compatible with an instruction or a reply.
///
/// A text speaks of objects in noun phrases; those that say where something stands or shall go
/// do not count. The object fits when its caption is quoted, or when one of the phrases names
/// its category, a synonym, a hypernym or only `one`, and the object does not contradict the
/// description there: a short description (up to three words) must hold word by word, but for
/// colours, materials, shapes and sizes of which the object's own description says nothing; of a
/// longer one at least 70% of the words must stand in the object's description. An object that
/// is described nowhere contradicts nothing. `not the red one` rules out what fits it. A text
/// that speaks of no object rules nothing out, but with a `purpose` (SUL tasks) the object must
/// at least serve it.
pub fn fits(text: &str, object: &ObjectInstance, purpose: Option<&str>) -> bool {
    let thing = ObjectWords::of(object);
    if object
        .caption
        .as_deref()
        .is_some_and(|caption| words(caption).len() > 2 && quotes(text, caption))
    {
        return true;
    }
    let phrases: Vec<Phrase> = phrases(text).into_iter().filter(names_something).collect();
    if phrases
        .iter()
        .any(|phrase| phrase.negated && thing.fits(phrase))
    {
        return false;
    }
    let mut positive = phrases.iter().filter(|phrase| !phrase.negated).peekable();
    match positive.peek() {
        None => purpose.is_none_or(|purpose| is_a(&object.category, purpose)),
        Some(_) => positive.any(|phrase| thing.fits(phrase)),
    }
}

/// Whether a text speaks of an object that can be carried, if only as `the red one`.
pub fn names_object(text: &str) -> bool {
    phrases(text).iter().any(names_something)
}

/// Longest name in words that is looked for in a phrase.
const LONGEST_NAME: usize = 4;
/// Up to so many words a description must hold word by word.
const SHORT_DESCRIPTION: usize = 3;
/// Of a longer description so many percent of the words.
const SHARE_PERCENT: usize = 70;

/// Words that stand for any object.
const ANYTHING: [&str; 6] = ["one", "object", "item", "thing", "something", "both"];

/// Words that describe nothing.
const EMPTY: [&str; 66] = crate::words! {
    a an the my your our some any this that these those up of with and or is it its in on for me i
    you yes no do does are there should which what where how exactly design designed featuring
    feature look one object item thing something both as by be was can could please right same style
    color colour slightly just only sure we
};

/// What is known of an object, in comparable words.
struct ObjectWords {
    lineage: BTreeSet<String>,
    described: bool,
    words: BTreeSet<String>,
    /// Kinds of attribute the description speaks of.
    kinds: BTreeMap<String, BTreeSet<String>>,
}

impl ObjectWords {
    fn of(object: &ObjectInstance) -> Self {
        let mut text = object.caption.clone().unwrap_or_default();
        for word in object.attributes.values().flatten() {
            text.push(' ');
            text.push_str(word);
        }
        let described = !text.trim().is_empty();
        let lineage = vocabulary().lineage(&normal(&object.category));
        let words: BTreeSet<String> = words(&text)
            .iter()
            .chain(&words(&object.category))
            .flat_map(|word| [lemma(word), plain(word)])
            .collect();
        let kinds = attribute_words(&text)
            .into_iter()
            .map(|(kind, words)| (kind, words.iter().map(|word| plain(word)).collect()));
        Self {
            lineage,
            described,
            words,
            kinds: kinds.collect(),
        }
    }

    /// Whether the phrase names the object and says nothing against it.
    fn fits(&self, phrase: &Phrase) -> bool {
        let tokens = &phrase.tokens;
        let mut named = vec![false; tokens.len()];
        for (at, length, name) in names(tokens) {
            if self.lineage.contains(&name) {
                named[at..at + length].fill(true);
            }
        }
        let anything = || {
            let of_anything = |token: &Token| {
                token
                    .word()
                    .is_some_and(|word| ANYTHING.contains(&lemma(word).as_str()))
            };
            tokens.iter().any(of_anything)
                && !names(tokens).iter().any(|(_, _, name)| is_thing(name))
        };
        if !named.contains(&true) && !anything() {
            return false;
        }
        if !self.described {
            return true;
        }
        let words = tokens
            .iter()
            .zip(&named)
            .filter(|(_, named)| !**named)
            .filter_map(|(token, _)| token.word());
        let description: Vec<&str> = words.filter(|word| !EMPTY.contains(word)).collect();
        let short = description.len() <= SHORT_DESCRIPTION;
        let holding = description
            .iter()
            .filter(|word| self.holds(word, short))
            .count();
        if short {
            holding == description.len()
        } else {
            holding * 100 >= description.len() * SHARE_PERCENT
        }
    }

    fn holds(&self, word: &str, generous: bool) -> bool {
        let mut kinds = attributes()
            .iter()
            .filter(|(_, words)| words.contains_key(word))
            .map(|(kind, _)| kind)
            .peekable();
        let silent =
            generous && kinds.peek().is_some() && !kinds.any(|kind| self.kinds.contains_key(kind));
        silent || self.words.contains(&plain(word)) || self.words.contains(&lemma(word))
    }
}

/// A word, or the attribute word it means the same as.
fn plain(word: &str) -> String {
    attributes()
        .values()
        .find_map(|words| words.get(word))
        .cloned()
        .unwrap_or_else(|| lemma(word))
}

/// Canonical names in a phrase: first token, length in tokens, name. A word that is also an
/// attribute (`orange`) is a name only where no noun follows it.
fn names(tokens: &[Token]) -> Vec<(usize, usize, String)> {
    let mut found = Vec::new();
    for at in 0..tokens.len() {
        for length in 1..=LONGEST_NAME.min(tokens.len() - at) {
            let Some(words) = tokens[at..at + length]
                .iter()
                .map(Token::word)
                .collect::<Option<Vec<_>>>()
            else {
                break;
            };
            let follows = tokens
                .get(at + length)
                .and_then(Token::word)
                .is_some_and(|next| !EMPTY.contains(&next));
            let attribute = length == 1
                && attributes()
                    .values()
                    .any(|table| table.contains_key(words[0]));
            let names_nothing = EMPTY.contains(&words[0]) || attribute && follows;
            if !names_nothing {
                found.push((
                    at,
                    length,
                    vocabulary().canonical(&normal(&words.join(" "))),
                ));
            }
        }
    }
    found
}

/// Whether a canonical name is a known thing that can be carried.
fn is_thing(name: &str) -> bool {
    vocabulary().known(name) && !vocabulary().lineage(name).contains("furniture")
}

fn names_something(phrase: &Phrase) -> bool {
    let anything = |word: &str| ANYTHING.contains(&lemma(word).as_str());
    phrase.taken
        || phrase.tokens.iter().filter_map(Token::word).any(anything)
        || names(&phrase.tokens)
            .iter()
            .any(|(_, _, name)| is_thing(name))
}

#[cfg(test)]
mod tests;
