//! Whether a reply gives away what the user keeps to itself: a raw id, or where exactly the target
//! stands (rules 2 and 4). Reads a text as a person would: look-alike letters, invisible characters
//! and ids that are spelled out hide nothing. Does not find what is encoded, in another language, or
//! said by a hint that only the layout explains.

use reel_world::{
    Receptacle, Scene, Task,
    language::{is_a, lemma, quotes, words},
};
use unicode_normalization::{UnicodeNormalization as _, char::is_combining_mark};
use unicode_security::confusable_detection::skeleton;

/// Says where something stands, as a word.
const PLACING: [&str; 57] = reel_world::words! {
    corner beside behind underneath beneath under above below between opposite adjacent near
    edge front middle center centre metre metres meter meters centimetre centimetres centimeter
    centimeters cm inch inches feet foot paces steps degrees coordinates coordinate minus equals
    shelf drawer alongside nearby "o'clock" oclock rear
    halfway wall window end flanked atop leaning company surrounded amid among percent closest
};
/// Says where something stands, in several words.
const PLACINGS: [&str; 23] = [
    "next to",
    "close to",
    "closer to",
    "far from",
    "on top of the",
    "on top of a",
    "right next",
    "right beside",
    "right side",
    "right hand",
    "right of",
    "to the right",
    "on the right",
    "on your right",
    "left side",
    "left hand",
    "left of",
    "to the left",
    "on the left",
    "on your left",
    "by the",
    "along the",
    "together with",
];
/// How words for a direction begin that are of no other use.
const DIRECTION: [&str; 8] = reel_world::words! {
    north south east west leftward rightward leftmost rightmost
};
/// A clause with one of these speaks of time, of the size of a thing, or of what the robot said, and
/// not of a place.
const ELSEWHERE: [&str; 25] = reel_world::words! {
    "i'll" "i'd" day time hour hours minutes later tonight today evening morning
    long longest wide widest tall size diameter thick
    described named mentioned listed told
};
/// A sentence with one of these may say where something is.
const LOCATING: [&str; 27] = reel_world::words! {
    is "it's" its lies lying sits sitting stands standing rests left find found look check checked try tried
    at under from than passed reached see saw here
};
/// What rooms are called besides their names.
const ROOMS: [&str; 14] = reel_world::words! {
    bedroom kitchen bathroom toilet hallway corridor hall lounge balcony study office area room den
};
/// What may stand before the name of a room without being a thing in it.
const NO_THING: [&str; 14] = reel_world::words! {
    one it them that this somewhere around anything something thing things look looking place
};
const ORDINALS: [&str; 7] = reel_world::words! { first second third fourth fifth sixth last };
/// What may stand between an ordinal and what it counts.
const COUNTED: [&str; 8] = reel_world::words! { piece pieces of the these those two one };
/// Words of a caption that describe nothing.
const CONNECTING: [&str; 16] = reel_world::words! {
    the a an my our your with of on in to and for where we that
};
/// What a clause says that is about the destination.
const BRINGING: [&str; 15] = reel_world::words! {
    put place bring deliver deposit drop carry move store goes belongs onto into return set
};
const NUMBERS: [&str; 13] = reel_world::words! {
    zero one two three four five six seven eight nine ten eleven twelve
};
/// Most words in which a name is said.
const NAME_WORDS: usize = 3;
/// So many words from a placing word on have to be the instruction's own.
const QUOTED_WORDS: usize = 5;
/// So many words of a caption in a row tell which is meant.
const CAPTION_WORDS: usize = 2;
/// How many letters and digits of an asset's id are enough to tell which it is.
const ID_PART: usize = 8;

/// Which of the rules a reply breaks that gives something away: `exact_position`, `raw_id`.
pub fn leaks(task: &Task, scene: &Scene, reply: &str) -> Vec<&'static str> {
    let reply = plain(reply);
    let mut found = Vec::new();
    if tells_position(task, scene, &reply) {
        found.push("exact_position");
    }
    if id_in(task, scene, &reply).is_some() {
        found.push("raw_id");
    }
    found
}

/// The first identifier of an object, an asset or a receptacle that a text speaks, in whatever
/// spelling. What is a word, too (`sink`), is none.
pub fn spoken_id<'a>(task: &'a Task, scene: &'a Scene, text: &str) -> Option<&'a str> {
    id_in(task, scene, &plain(text))
}

fn id_in<'a>(task: &'a Task, scene: &'a Scene, plain: &str) -> Option<&'a str> {
    let sentences: Vec<Vec<String>> = sentences(plain).map(spelled).collect();
    let assets = || task.objects.iter().map(|object| object.asset.as_str());
    let instances = task.objects.iter().map(|object| object.instance.as_str());
    let receptacles = scene.receptacles.iter().map(|one| one.id.as_str());
    let raw = |id: &&str| id.contains('_') || id.chars().any(|letter| letter.is_ascii_digit());
    let whole = instances
        .chain(assets())
        .chain(receptacles)
        .filter(raw)
        .find(|id| sentences.iter().any(|sentence| speaks(sentence, id)));
    whole.or_else(|| {
        let part = |id: &&str| {
            let id = squeezed(id);
            let words = sentences.iter().flatten();
            words.clone().any(|word| {
                word.len() >= ID_PART
                    && word.contains(|letter: char| letter.is_ascii_digit())
                    && id.contains(word.as_str())
            })
        };
        assets().filter(raw).find(part)
    })
}

fn tells_position(task: &Task, scene: &Scene, reply: &str) -> bool {
    let destination = scene.receptacle(&task.dest);
    let own = without_names(reply, destination);
    let bare = without_names(reply, &scene.receptacles);
    let is_placed = clauses(&bare).any(|clause| is_placed(&words(clause), task, destination));
    let source = scene
        .receptacle(&task.src)
        .filter(|_| task.src != task.dest);
    is_placed
        || counts_furniture(&words(reply))
        || source.is_some_and(|source| {
            let mut captions = source.captions.keys();
            captions.any(|caption| describes(&own, caption, source.room_name(), task))
                || names_furniture(&own, task, scene, source)
        })
}

/// Whether a clause without names says where something stands, by numbers, directions or what is
/// beside it. What the instruction says in the same words does not count, nor what belongs to the
/// look of the target or to what the destination is.
fn is_placed(said: &[String], task: &Task, destination: Option<&Receptacle>) -> bool {
    let has = |list: &[&str]| said.iter().any(|word| list.contains(&word.as_str()));
    let directed = |word: &String| DIRECTION.iter().any(|way| word.starts_with(way));
    if said.iter().any(directed) {
        return true;
    }
    if has(&BRINGING) || has(&ELSEWHERE) {
        return false;
    }
    let known = known_words(task, destination);
    let quoted = |from: usize| {
        let to = (from + QUOTED_WORDS).min(said.len());
        quotes(&task.instruction, &said[from..to].join(" "))
    };
    let placing = |(index, word): (usize, &String)| {
        let placing = word.starts_with(|letter: char| letter.is_ascii_digit())
            || PLACING.contains(&word.as_str());
        placing && !known.contains(&lemma(word)) && !quoted(index.saturating_sub(1))
    };
    said.iter().enumerate().any(placing)
        || (0..said.len()).any(|at| {
            let rest = said[at..].join(" ") + " ";
            PLACINGS
                .iter()
                .any(|placing| rest.starts_with(&format!("{placing} ")))
                && !quoted(at)
        })
}

/// Words, in their basic form, for the look of the target and for what the destination is.
fn known_words(task: &Task, destination: Option<&Receptacle>) -> Vec<String> {
    let target = task.target_object();
    let look = target.caption.as_deref().unwrap_or_default();
    [look, &target.category]
        .into_iter()
        .chain(destination.map(|destination| &*destination.category))
        .flat_map(words)
        .map(|word| lemma(&word))
        .collect()
}

/// Whether a text says every word of a caption that describes something, in whatever order, or some
/// of them in a row, and thereby more than the instruction.
fn describes(text: &str, caption: &str, room: &str, task: &Task) -> bool {
    let (said, told) = (words(text), words(&task.instruction));
    let telling: Vec<String> = words(caption)
        .into_iter()
        .filter(|word| !CONNECTING.contains(&word.as_str()))
        .collect();
    let new = |words: &[String]| words.iter().any(|word| !told.contains(word));
    let look = task.target_object().caption.as_deref().unwrap_or_default();
    let in_a_row = |part: &[String]| {
        new(part)
            && said.windows(part.len()).any(|window| window == part)
            && !quotes(look, &part.join(" "))
            && !has_name(room, &part.join(" "))
    };
    !telling.is_empty()
        && (new(&telling) && telling.iter().all(|word| said.contains(word))
            || telling.windows(CAPTION_WORDS).any(in_a_row))
}

/// Whether a text names furniture, and not as what the instruction calls the source, nor as the
/// destination: what else is said of furniture tells where the source is. With its room the source is
/// told, too, where the instruction does not say the room.
fn names_furniture(text: &str, task: &Task, scene: &Scene, source: &Receptacle) -> bool {
    let destination = scene.receptacle(&task.dest);
    let names = |receptacle: &Receptacle, text: &str| {
        has_name(text, &receptacle.category)
            || words(text)
                .iter()
                .any(|word| is_furniture(word) && is_a(&receptacle.category, word))
    };
    let instruction = words(&task.instruction);
    let told = names(source, &task.instruction);
    let room_told = has_name(&task.instruction, source.room_name());
    let known = known_words(task, destination);
    let is_new = |word: &String| !instruction.contains(word) && !known.contains(&lemma(word));
    let mut source_named = false;
    let clauses = sentences(text).flat_map(|sentence| {
        let said = words(sentence);
        let locates = said.iter().any(|word| LOCATING.contains(&word.as_str()));
        clauses(sentence).map(move |clause| (locates, clause))
    });
    for (locates, clause) in clauses {
        let said = words(clause);
        let has = |list: &[&str]| said.iter().any(|word| list.contains(&word.as_str()));
        let is_destination =
            destination.is_some_and(|it| names(it, clause)) && (has(&BRINGING) || !locates);
        if is_destination || has(&ELSEWHERE) {
            continue;
        }
        let is_source = names(source, clause);
        let other = said.iter().any(|word| is_furniture(word) && is_new(word))
            || said.windows(3).any(|it| it == ["piece", "of", "furniture"])
            || scene.receptacles.iter().any(|other| {
                has_name(clause, &other.category) && !has_name(&task.instruction, &other.category)
            })
            || in_room(&said, &is_new);
        if other || is_source && !told || is_source && modified(&said, &is_new) {
            return true;
        }
        source_named |= is_source;
    }
    source_named && has_name(text, source.room_name()) && !room_told
}

/// `the dining table`, where the instruction speaks of a table alone.
fn modified(said: &[String], is_new: &impl Fn(&String) -> bool) -> bool {
    said.windows(2).any(|pair| {
        let article = [
            "the", "a", "my", "our", "this", "that", "same", "other", "which", "on",
        ];
        is_furniture(&pair[1]) && is_new(&pair[0]) && !article.contains(&pair[0].as_str())
    })
}

fn is_furniture(word: &str) -> bool {
    let singular = lemma(word);
    !["furniture", "dining"].contains(&word)
        && (is_a(word, "furniture") || is_a(&singular, "furniture"))
}

/// `the workstation in the bedroom`: something in a room that the instruction does not speak of.
fn in_room(said: &[String], is_new: &impl Fn(&String) -> bool) -> bool {
    (2..said.len().saturating_sub(1)).any(|at| {
        let articles = ["the", "a", "an", "our", "my"];
        let thing = &said[at - 1];
        said[at] == "in"
            && articles.contains(&said[at + 1].as_str())
            && said[at.saturating_sub(3)..at - 1]
                .iter()
                .any(|word| articles.contains(&word.as_str()))
            && is_new(thing)
            && !NO_THING.contains(&thing.as_str())
            && said[at + 2..]
                .iter()
                .take(2)
                .any(|word| ROOMS.contains(&word.as_str()))
    })
}

/// Whether a text says a name, however it is spelled: `dinning room` as `dining room`, `potlid` as
/// `pot lid`.
fn has_name(text: &str, name: &str) -> bool {
    let folded = |words: &[String]| {
        let mut letters: Vec<char> = words.iter().flat_map(|word| word.chars()).collect();
        letters.dedup();
        letters
    };
    let (said, name) = (words(text), folded(&words(name)));
    (1..=NAME_WORDS).any(|length| said.windows(length).any(|window| folded(window) == name))
}

/// `the second table`, `the last of these shelves`.
fn counts_furniture(said: &[String]) -> bool {
    said.iter().enumerate().any(|(index, word)| {
        let mut counted = said[index + 1..]
            .iter()
            .skip_while(|word| COUNTED.contains(&word.as_str()));
        ORDINALS.contains(&word.as_str())
            && counted
                .next()
                .is_some_and(|word| is_furniture(word) || word == "furniture")
    })
}

/// A text without the names of furniture and rooms, the longest first.
fn without_names<'a>(text: &str, receptacles: impl IntoIterator<Item = &'a Receptacle>) -> String {
    let mut names: Vec<String> = receptacles
        .into_iter()
        .flat_map(|receptacle| receptacle.captions.keys().map(String::as_str))
        .map(|caption| words(caption).join(" "))
        .filter(|name| !name.is_empty())
        .collect();
    names.sort_by_key(|name| std::cmp::Reverse(name.len()));
    names.dedup();
    let mut left = format!(" {} ", text.replace('-', " "));
    for name in names {
        left = left.replace(&format!(" {name}"), " ");
    }
    left
}

fn sentences(text: &str) -> impl Iterator<Item = &str> {
    text.split_inclusive(['.', '!', '?', ';', '\n', ' '])
        .scan((text, 0, 0), |(text, begin, end), part| {
            *end += part.len();
            let stops = part.ends_with(['!', '?', ';', '\n']) || part.ends_with('.');
            let next = text[*end..].chars().next();
            if (stops && next.is_none_or(char::is_whitespace)) || next.is_none() {
                let sentence = &text[*begin..*end];
                *begin = *end;
                Some(Some(sentence))
            } else {
                Some(None)
            }
        })
        .flatten()
}

fn clauses(text: &str) -> impl Iterator<Item = &str> {
    text.split(['.', '!', '?', ';', ',', '\n'])
        .flat_map(|part| part.split(" and "))
        .flat_map(|part| part.split(" then "))
}

/// The words of a sentence as parts of ids: numbers as digits, without the words for signs.
fn spelled(sentence: &str) -> Vec<String> {
    sentence
        .split(|letter: char| !letter.is_alphanumeric())
        .filter(|word| !word.is_empty() && !["underscore", "dash", "hyphen"].contains(word))
        .map(|word| {
            let number = NUMBERS.iter().position(|number| *number == word);
            number.map_or_else(|| word.to_owned(), |number| number.to_string())
        })
        .collect()
}

/// Whether words that follow each other are an id.
fn speaks(spelled: &[String], id: &str) -> bool {
    let id = squeezed(id);
    (0..spelled.len()).any(|start| {
        let mut rest = id.as_str();
        for word in &spelled[start..] {
            match rest.strip_prefix(word.as_str()) {
                Some("") => return true,
                Some(left) => rest = left,
                None => return false,
            }
        }
        false
    })
}

/// The letters and digits of an id.
fn squeezed(id: &str) -> String {
    id.chars()
        .filter(|letter| letter.is_alphanumeric())
        .flat_map(char::to_lowercase)
        .collect()
}

/// A text in lower case as one reads it: compatibility forms and look-alikes as the letters that
/// they look like, without what is invisible.
fn plain(text: &str) -> String {
    let mut plain = String::with_capacity(text.len());
    for letter in text.nfkc().filter(|letter| !is_invisible(*letter)) {
        match letter {
            _ if letter.is_ascii() => plain.push(letter),
            _ if letter.is_alphanumeric() => {
                let mut buffer = [0; 4];
                let looks_like = skeleton(letter.encode_utf8(&mut buffer));
                plain.extend(looks_like.filter(|letter| !is_combining_mark(*letter)));
            }
            _ if is_combining_mark(letter) => {}
            // Dashes and the like stand between words.
            _ => plain.push(' '),
        }
    }
    plain.to_lowercase()
}

/// Format characters and variation selectors.
fn is_invisible(letter: char) -> bool {
    matches!(letter,
        '\u{ad}' | '\u{34f}' | '\u{61c}' | '\u{180b}'..='\u{180f}' | '\u{200b}'..='\u{200f}'
        | '\u{202a}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{fe00}'..='\u{fe0f}'
        | '\u{feff}' | '\u{e0000}'..='\u{e0fff}')
}
