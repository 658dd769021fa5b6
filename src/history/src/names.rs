//! The episode's own names: which receptacles and which objects a phrase may mean. Never looks
//! at a sentence's grammar.

use std::{
    cell::{OnceCell, RefCell},
    collections::{BTreeMap, BTreeSet},
};

use reel_world::language;

use crate::{
    EpisodeFacts,
    content::lemmas,
    grammar::{ANYTHING, ANYWHERE},
};

/// How well one thing fits a phrase, or one deed a claim.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) enum MatchQuality {
    No,
    Maybe,
    Yes,
}

/// What a phrase means.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub(crate) struct Referent {
    /// Indices of the receptacles it surely means, in any order; any of them.
    pub(crate) places: Vec<usize>,
    /// Of those it may mean.
    pub(crate) maybe_places: Vec<usize>,
    /// Indices of the objects it surely means; any of them.
    pub(crate) objects: Vec<usize>,
    /// Of those it may mean.
    pub(crate) maybe_objects: Vec<usize>,
    /// Any receptacle: `the receptacle`.
    pub(crate) any_place: bool,
    /// Any object: `the object`, `it`.
    pub(crate) any_object: bool,
    /// Nothing is known of the words: it may mean anything.
    pub(crate) open: bool,
    /// The words, for comparison with queries.
    pub(crate) words: String,
}

impl Referent {
    /// A referent that fits every object and receptacle, as `it` does.
    pub(crate) fn anything() -> Self {
        Self {
            any_object: true,
            any_place: true,
            ..Self::default()
        }
    }

    /// How a receptacle fits.
    pub(crate) fn fits_receptacle(&self, place: Option<usize>) -> MatchQuality {
        match place {
            _ if self.any_place => MatchQuality::Yes,
            None => MatchQuality::Maybe,
            Some(place) if self.places.contains(&place) => MatchQuality::Yes,
            Some(place) if self.open || self.maybe_places.contains(&place) => MatchQuality::Maybe,
            Some(_) => MatchQuality::No,
        }
    }

    /// How an object fits.
    pub(crate) fn fits_object(&self, thing: Option<usize>) -> MatchQuality {
        match thing {
            _ if self.any_object => MatchQuality::Yes,
            None => MatchQuality::Maybe,
            Some(thing) if self.objects.contains(&thing) => MatchQuality::Yes,
            Some(thing) if self.open || self.maybe_objects.contains(&thing) => MatchQuality::Maybe,
            Some(_) => MatchQuality::No,
        }
    }

    /// Whether it speaks of receptacles, as far as the words tell.
    pub(crate) fn is_receptacle(&self) -> bool {
        !self.places.is_empty()
            || !self.maybe_places.is_empty()
            || self.any_place && !self.any_object
            || self.names_place()
    }

    /// Whether it speaks of objects, as far as the words tell.
    pub(crate) fn is_object(&self) -> bool {
        !self.objects.is_empty()
            || !self.maybe_objects.is_empty()
            || self.any_object
            || !self.is_receptacle() && !self.open && !self.words.is_empty()
    }

    fn is_open(&self) -> bool {
        self.open || self.any_object || self.any_place
    }

    /// A receptacle that the scene does not have: `wardrobe_7`.
    fn names_place(&self) -> bool {
        looks_like_id(&self.words)
    }
}

/// `table_1`: a receptacle's id, of this scene or of none.
pub(crate) fn looks_like_id(word: &str) -> bool {
    word.rsplit_once('_').is_some_and(|(name, number)| {
        !name.is_empty() && !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit())
    })
}

/// A name of several words.
struct Caption {
    words: Vec<String>,
    place: Option<usize>,
    thing: Option<usize>,
}

/// The names of an episode, and the phrases that were looked up already.
pub(crate) struct Names {
    setting: EpisodeFacts,
    ids: BTreeMap<String, usize>,
    /// Names of several words by their first word, the longest first.
    captions: BTreeMap<String, Vec<Caption>>,
    /// Of the receptacles, then of the objects: made when a phrase asks for it.
    descriptions: Vec<OnceCell<Description>>,
    /// Lemmas of the instruction.
    instruction: BTreeSet<String>,
    known: RefCell<BTreeMap<String, Referent>>,
    same: RefCell<BTreeMap<String, bool>>,
}

/// The words of one receptacle or object.
#[derive(Clone)]
struct Description {
    words: BTreeSet<String>,
    attributes: reel_world::Attributes,
}

/// Phrases that are remembered; a text that brings more is looked up afresh.
const REMEMBERED: usize = 4096;
/// Longest phrase in words that names one thing.
const LONGEST_PHRASE: usize = 12;

impl Names {
    pub(crate) fn new(setting: EpisodeFacts) -> Self {
        let ids = setting
            .places
            .iter()
            .enumerate()
            .map(|(index, place)| (place.id.to_lowercase(), index))
            .collect();
        let mut captions: BTreeMap<String, Vec<Caption>> = BTreeMap::new();
        let mut add = |text: &str, place, thing| {
            let mut words = language::words(text);
            if words
                .first()
                .is_some_and(|word| matches!(word.as_str(), "the" | "a" | "an"))
            {
                words.remove(0);
            }
            if words.len() > 1 {
                captions.entry(words[0].clone()).or_default().push(Caption {
                    words,
                    place,
                    thing,
                });
            }
        };
        for (index, place) in setting.places.iter().enumerate() {
            place
                .captions
                .iter()
                .for_each(|caption| add(caption, Some(index), None));
            add(&place.id.replace('_', " "), Some(index), None);
        }
        for (index, thing) in setting.things.iter().enumerate() {
            thing
                .caption
                .iter()
                .for_each(|caption| add(caption, None, Some(index)));
        }
        for list in captions.values_mut() {
            list.sort_by_key(|caption| std::cmp::Reverse(caption.words.len()));
        }
        let descriptions = vec![OnceCell::new(); setting.places.len() + setting.things.len()];
        let instruction = lemmas(&setting.instruction);
        Self {
            ids,
            captions,
            descriptions,
            instruction,
            known: RefCell::default(),
            same: RefCell::default(),
            setting,
        }
    }

    pub(crate) fn setting(&self) -> &EpisodeFacts {
        &self.setting
    }

    /// The receptacle of an id.
    pub(crate) fn receptacle(&self, id: &str) -> Option<usize> {
        self.ids
            .get(id)
            .copied()
            .or_else(|| self.ids.get(&id.to_lowercase()).copied())
    }

    /// The object of a key.
    pub(crate) fn object(&self, key: &str) -> Option<usize> {
        self.setting
            .things
            .iter()
            .position(|thing| thing.key == key)
    }

    /// An id, or a caption of several words, at the start of some words: how many words,
    /// and what they mean.
    pub(crate) fn opening(&self, words: &[&str]) -> Option<(usize, Referent)> {
        let first = words.first()?;
        if let Some(place) = self.ids.get(*first) {
            return Some((
                1,
                Referent {
                    places: vec![*place],
                    words: (*first).to_owned(),
                    ..Referent::default()
                },
            ));
        }
        if looks_like_id(first) {
            return Some((
                1,
                Referent {
                    words: (*first).to_owned(),
                    ..Referent::default()
                },
            ));
        }
        let captions = self.captions.get(*first)?;
        let matches = |caption: &&Caption| {
            caption.words.len() <= words.len()
                && caption.words.iter().zip(words).all(|(a, b)| a == b)
        };
        let length = captions.iter().find(matches)?.words.len();
        let all: Vec<&Caption> = captions
            .iter()
            .filter(|caption| caption.words.len() == length)
            .filter(matches)
            .collect();
        let places = all.iter().filter_map(|caption| caption.place).collect();
        let things = all.iter().filter_map(|caption| caption.thing).collect();
        Some((
            length,
            Referent {
                places,
                objects: things,
                words: words[..length].join(" "),
                ..Referent::default()
            },
        ))
    }

    /// What a noun phrase without article means.
    pub(crate) fn phrase(&self, words: &[&str]) -> Referent {
        let words = &words[words.len().saturating_sub(LONGEST_PHRASE)..];
        let text = words.join(" ");
        if let Some(known) = self.known.borrow().get(&text) {
            return known.clone();
        }
        let referent = Referent {
            words: text.clone(),
            ..self.resolve(words)
        };
        let mut known = self.known.borrow_mut();
        if known.len() < REMEMBERED {
            known.insert(text, referent.clone());
        }
        referent
    }

    fn resolve(&self, words: &[&str]) -> Referent {
        let Some(last) = words.last() else {
            return Referent::anything();
        };
        let head = language::lemma(last);
        if ANYTHING.contains(&head.as_str()) || ANYTHING.contains(last) {
            return Referent {
                any_object: true,
                any_place: *last == "one",
                ..Referent::default()
            };
        }
        if ANYWHERE.contains(&head.as_str()) {
            return Referent {
                any_place: true,
                ..Referent::default()
            };
        }
        for start in 0..words.len() {
            let hits = self.named(&words[start..].join(" "));
            if !hits.is_empty() {
                return self.narrowed(&hits, &words[..start]);
            }
        }
        // a known thing that is not here is none of what is here; other words may mean anything
        let absent = self.setting.complete && words.len() <= 3 && language::names_object(last);
        Referent {
            open: !absent,
            ..Referent::default()
        }
    }

    /// Indices (receptacles first) of what goes by a name.
    fn named(&self, name: &str) -> Vec<usize> {
        let compact = |text: &str| {
            language::words(text)
                .iter()
                .map(|word| language::lemma(word))
                .collect::<String>()
        };
        let name_compact = compact(name);
        let is = |category: &str| {
            let head = category.rsplit(' ').next().unwrap_or(category);
            language::is_a(category, name)
                || compact(category) == name_compact
                || compact(head) == name_compact
        };
        let hits: BTreeSet<&str> = self
            .categories()
            .collect::<BTreeSet<_>>()
            .into_iter()
            .filter(|category| is(category))
            .collect();
        self.categories()
            .enumerate()
            .filter(|(_, category)| hits.contains(category))
            .map(|(index, _)| index)
            .collect()
    }

    /// Of the receptacles, then of the objects.
    fn categories(&self) -> impl Iterator<Item = &str> {
        let places = self
            .setting
            .places
            .iter()
            .map(|place| place.category.as_str());
        places.chain(
            self.setting
                .things
                .iter()
                .map(|thing| thing.category.as_str()),
        )
    }

    /// By the index that [`Names::named`] gives.
    fn description(&self, index: usize) -> &Description {
        self.descriptions[index].get_or_init(|| {
            match index.checked_sub(self.setting.places.len()) {
                None => {
                    let place = &self.setting.places[index];
                    Description::new(
                        &place.category,
                        &format!("{} {}", place.captions.join(" "), place.room),
                    )
                }
                Some(thing) => {
                    let thing = &self.setting.things[thing];
                    Description::new(&thing.category, thing.caption.as_deref().unwrap_or(""))
                }
            }
        })
    }

    /// Of what goes by a name, what the words before it leave.
    fn narrowed(&self, hits: &[usize], adjectives: &[&str]) -> Referent {
        let grade = |index: &usize| (*index, self.description(*index).fits(adjectives));
        let graded: Vec<(usize, MatchQuality)> = hits.iter().map(grade).collect();
        let pick = |wanted: MatchQuality| {
            graded
                .iter()
                .filter(move |(_, fit)| *fit == wanted)
                .map(|(index, _)| *index)
        };
        let sure: Vec<usize> = pick(MatchQuality::Yes).collect();
        // only where another one fits better, a description rules out
        let maybe: Vec<usize> = if sure.is_empty() {
            hits.to_vec()
        } else {
            pick(MatchQuality::Maybe).collect()
        };
        let first_thing = self.setting.places.len();
        let split = |indices: Vec<usize>| {
            let (places, things): (Vec<usize>, Vec<usize>) =
                indices.into_iter().partition(|index| *index < first_thing);
            (
                places,
                things
                    .into_iter()
                    .map(|index| index - first_thing)
                    .collect(),
            )
        };
        let ((places, things), (maybe_places, maybe_things)) = (split(sure), split(maybe));
        Referent {
            places,
            objects: things,
            maybe_places,
            maybe_objects: maybe_things,
            ..Referent::default()
        }
    }

    /// Whether a query means what a phrase means, or one of them the more general.
    pub(crate) fn same(&self, query: &str, words: &str) -> bool {
        if query.is_empty() || words.is_empty() {
            return false;
        }
        let key = format!("{query}\n{words}");
        if let Some(same) = self.same.borrow().get(&key) {
            return *same;
        }
        let last = words.rsplit(' ').next().unwrap_or(words);
        let same = [words, last]
            .iter()
            .any(|name| language::is_a(query, name) || language::is_a(name, query))
            || lemmas(query).contains(&language::lemma(last));
        let mut known = self.same.borrow_mut();
        if known.len() < REMEMBERED {
            known.insert(key, same);
        }
        same
    }

    /// Whether the instruction speaks of what a phrase names.
    pub(crate) fn mentions(&self, words: &str) -> bool {
        let last = words.rsplit(' ').next().unwrap_or(words);
        self.instruction.contains(&language::lemma(last))
    }

    /// Whether a word names one thing rather than another: an object, a receptacle, a colour.
    pub(crate) fn is_specific(&self, word: &str) -> bool {
        let referent = self.phrase(&[word]);
        !referent.objects.is_empty()
            || !referent.places.is_empty()
            || !referent.is_open()
            || looks_like_id(word)
            || !language::attribute_words(word).is_empty()
    }

    /// How an object is called in a sentence.
    pub(crate) fn call(&self, thing: usize) -> String {
        self.setting.things[thing].category.clone()
    }
}

impl Description {
    fn new(category: &str, text: &str) -> Self {
        let words = language::words(text)
            .into_iter()
            .chain(language::words(category));
        let words = words
            .flat_map(|word| [language::lemma(&word), word])
            .collect();
        Self {
            words,
            attributes: language::attribute_words(text),
        }
    }

    /// How adjectives fit: an attribute of a kind that is described otherwise does not.
    fn fits(&self, adjectives: &[&str]) -> MatchQuality {
        let said = language::attribute_words(&adjectives.join(" "));
        let against = said.iter().any(|(kind, words)| {
            self.attributes
                .get(kind)
                .is_some_and(|own| !words.iter().any(|word| own.contains(word)))
        });
        if against {
            return MatchQuality::No;
        }
        let held =
            |word: &&str| self.words.contains(*word) || self.words.contains(&language::lemma(word));
        if adjectives.iter().all(held) {
            MatchQuality::Yes
        } else {
            MatchQuality::Maybe
        }
    }
}
