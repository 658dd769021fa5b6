//! The committed vocabulary: synonyms, hypernyms and attribute words, read from the two files of
//! `data/`. Never matches anything by itself.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::LazyLock,
};

use super::words::normal;

/// Synonyms and hypernyms (`data/vocabulary.txt`; the format stands at its top).
#[derive(Debug, Default)]
pub(super) struct Vocabulary {
    /// Name or synonym, in normal form -> canonical name.
    canonical: BTreeMap<String, String>,
    /// The same without spaces, so that `washing machine` finds `washingmachine`.
    compact: BTreeMap<String, String>,
    /// Canonical name -> canonical names of what is directly more general.
    parents: BTreeMap<String, Vec<String>>,
}

/// Attribute words (`data/attributes.txt`): kind -> word -> the word it means the same as.
pub(super) type AttributeTable = BTreeMap<String, BTreeMap<String, String>>;

static VOCABULARY: LazyLock<Vocabulary> =
    LazyLock::new(|| Vocabulary::parse(include_str!("../../data/vocabulary.txt")));
static ATTRIBUTES: LazyLock<AttributeTable> =
    LazyLock::new(|| parse_attributes(include_str!("../../data/attributes.txt")));

/// Synonyms and hypernyms of `data/vocabulary.txt`, parsed at first use.
pub(super) fn vocabulary() -> &'static Vocabulary {
    &VOCABULARY
}

/// The committed attribute words.
pub(super) fn attributes() -> &'static AttributeTable {
    &ATTRIBUTES
}

impl Vocabulary {
    fn parse(text: &str) -> Self {
        let mut vocabulary = Self::default();
        let rows: Vec<[Vec<String>; 3]> = lines(text).map(row).collect();
        for [name, synonyms, _] in &rows {
            for word in name.iter().chain(synonyms) {
                let other = vocabulary.canonical.insert(word.clone(), name[0].clone());
                assert!(
                    other.is_none_or(|other| other == name[0]),
                    "vocabulary.txt: \"{word}\" means two things"
                );
                vocabulary
                    .compact
                    .insert(word.replace(' ', ""), name[0].clone());
            }
        }
        for [name, _, hypernyms] in rows {
            let parents = hypernyms
                .iter()
                .map(|word| vocabulary.canonical(word))
                .collect();
            vocabulary.parents.insert(name[0].clone(), parents);
        }
        vocabulary
    }

    /// Whether a name in normal form stands in the vocabulary.
    pub(super) fn known(&self, name: &str) -> bool {
        self.canonical.contains_key(name) || self.compact.contains_key(&name.replace(' ', ""))
    }

    /// Whether something in the vocabulary is a kind of this, by its canonical name.
    pub(super) fn has_kinds(&self, name: &str) -> bool {
        self.parents.values().flatten().any(|parent| parent == name)
    }

    /// The canonical name of a name in normal form; the name itself where it is unknown.
    pub(super) fn canonical(&self, name: &str) -> String {
        let found = self
            .canonical
            .get(name)
            .or_else(|| self.compact.get(&name.replace(' ', "")));
        found.cloned().unwrap_or_else(|| name.to_owned())
    }

    /// What a thing is: its canonical name, its head nouns as far as they are known, and
    /// all hypernyms of these.
    pub(super) fn lineage(&self, name: &str) -> BTreeSet<String> {
        let mut open = vec![self.canonical(name)];
        if !self.known(name) {
            open.extend(
                heads(name)
                    .filter(|head| self.known(head))
                    .map(|head| self.canonical(head)),
            );
        }
        let mut lineage = BTreeSet::new();
        while let Some(next) = open.pop() {
            open.extend(self.parents.get(&next).into_iter().flatten().cloned());
            lineage.insert(next);
        }
        lineage
    }
}

/// The name without its first word, its first two words, and so on: `old alarm clock`
/// gives `alarm clock`, `clock`.
pub(super) fn heads(name: &str) -> impl Iterator<Item = &str> {
    name.match_indices(' ').map(|(space, _)| &name[space + 1..])
}

fn lines(text: &str) -> impl Iterator<Item = &str> {
    text.lines()
        .map(|line| line.split('#').next().unwrap_or_default().trim())
        .filter(|line| !line.is_empty())
}

fn row(line: &str) -> [Vec<String>; 3] {
    let mut columns = line.split('|').map(|column| {
        column
            .split(',')
            .map(normal)
            .filter(|word| !word.is_empty())
            .collect()
    });
    let columns: [Vec<String>; 3] = [(); 3].map(|()| columns.next().unwrap_or_default());
    assert_eq!(
        columns[0].len(),
        1,
        "vocabulary.txt: one name a line, in \"{line}\""
    );
    columns
}

fn parse_attributes(text: &str) -> AttributeTable {
    let mut table = AttributeTable::new();
    for line in lines(text) {
        let (kind, words) = line
            .split_once(':')
            .unwrap_or_else(|| panic!("attributes.txt: no kind in \"{line}\""));
        for word in words.split(',').map(str::trim) {
            let (word, same) = word.split_once('=').unwrap_or((word, word));
            table
                .entry(kind.to_owned())
                .or_default()
                .insert(word.to_owned(), same.to_owned());
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hypernyms_chain() {
        let vocabulary = vocabulary();
        let lineage = vocabulary.lineage("alarm clock");
        assert!(
            ["alarm clock", "clock", "timekeeping device"]
                .iter()
                .all(|name| lineage.contains(*name)),
            "{lineage:?}"
        );
        assert!(
            vocabulary
                .lineage("golden delicious apple")
                .contains("food")
        );
    }

    #[test]
    fn no_thing_is_its_own_hypernym_and_every_hypernym_is_known() {
        let vocabulary = vocabulary();
        for (name, parents) in &vocabulary.parents {
            for parent in parents {
                assert!(
                    vocabulary.known(parent),
                    "{name}: hypernym {parent} has no line of its own"
                );
                assert!(
                    !vocabulary.lineage(parent).contains(name),
                    "{name} is its own hypernym through {parent}"
                );
            }
        }
        assert!(vocabulary.parents.len() > 150);
    }

    #[test]
    fn an_attribute_stands_for_a_word_of_its_own_kind() {
        for (kind, words) in attributes() {
            for same in words.values() {
                let known = words.get(same).is_none_or(|again| again == same);
                assert!(
                    known,
                    "{kind}: {same} is itself only another word for something"
                );
            }
        }
    }
}
