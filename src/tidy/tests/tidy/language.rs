//! The words of the code: public identifiers use the field's terms, and a doc comment says more
//! than a name. Reads files of the repository only.

use reel_tidy::rust_files;

use super::none;

/// Words that no public identifier contains, split at `_` and at capital letters.
const PARTS: &str = "
    luck deed deeds household households errand errands oddity oddities thing things parked
    elsewhere dealt tend whom whose nobody somebody told said begun misfit unfit mend mending
    mended teller seat seats awake wake stranger picture pictures moment moments film habits
    beside lay again patient ours shelves
";

/// Words that are no public identifier as a whole: pronouns and participles name nothing.
const WHOLE: &str = "
    what which who here now then this it both made kept given seen wanted shown drawn paid fired
    proven answered called saw did tell say reach looks lay bare spoken moved elsewhere cast
";

/// Names that no public type has: two crates would each have one, with another meaning.
const TYPES: &str = "
    Row Place What Which Options Answer Error State Kind Seen Known Told Said Made Kept Given
    Listed Now Moment Picture Refusal Wording Watch Begun Written Stored Measured Recorded
    Prepared Asked Named Marked Held Passed Beside Alone Then About Words Cast Luck Deed Thing
    Oddity Errand Household Parked Patient
";

/// Files and identifiers in them that keep such a word because it is written into JSON, TOML or
/// tables: another name there is a change of format.
const SERIALISED: &[(&str, &str)] = &[
    ("src/history/src/step_facts.rs", "things"),
    ("src/history/src/step_facts.rs", "seen"),
];

/// Files and identifiers in them that keep such a word: `then` composes poses as in nalgebra.
const ALLOWED: &[(&str, &str)] = &[("src/sim/src/geometry.rs", "then")];

/// Fewest words of a doc comment.
const DOC_WORDS_MIN: usize = 4;

#[test]
fn public_identifiers_are_terms_of_the_field() {
    let sources = rust_files()
        .into_iter()
        .filter(|(path, _)| path.contains("/src/"));
    none(sources.flat_map(|(path, text)| {
        public_identifiers(&text)
            .into_iter()
            .filter(|identifier| !keeps_word(&path, &identifier.name))
            .filter_map(|identifier| {
                let word = ruled_out(&identifier)?;
                let Identifier { line, name, .. } = identifier;
                Some(format!(
                    "{path}:{line}: `{name}`: `{word}` is no term of the field"
                ))
            })
            .collect::<Vec<_>>()
    }));
}

#[test]
fn doc_comments_are_sentences() {
    none(rust_files().iter().flat_map(|(path, text)| {
        short_doc_comments(text)
            .into_iter()
            .map(move |(line, comment)| format!("{path}:{line}: `{comment}` says nothing"))
    }));
}

fn keeps_word(path: &str, name: &str) -> bool {
    SERIALISED
        .iter()
        .chain(ALLOWED)
        .any(|allowed| *allowed == (path, name))
}

#[test]
fn every_exception_is_still_needed() {
    let sources = rust_files();
    none(SERIALISED.iter().chain(ALLOWED).filter_map(|(path, name)| {
        let text = sources
            .iter()
            .find(|(file, _)| file == path)
            .map(|(_, text)| text);
        let found = text.is_some_and(|text| {
            public_identifiers(text)
                .iter()
                .any(|identifier| identifier.name == *name)
        });
        (!found).then(|| format!("{path}: no public `{name}`: take it off the list"))
    }));
}

#[derive(PartialEq, Eq, Debug)]
struct Identifier {
    line: usize,
    name: String,
    is_type: bool,
}

/// What a file declares as `pub`, with the variants of its public enums and public fields.
fn public_identifiers(text: &str) -> Vec<Identifier> {
    let mut found = Vec::new();
    // Indentation of the public enum that is open.
    let mut public_enum = None;
    for (number, line) in (1..).zip(text.lines()) {
        let code = line.trim_start();
        let indent = line.len() - code.len();
        if code == "mod tests {" {
            break;
        }
        if code.starts_with('}') && public_enum.is_some_and(|open| indent <= open) {
            public_enum = None;
        }
        let mut take = |name: &str, is_type| {
            found.push(Identifier {
                line: number,
                name: name.to_owned(),
                is_type,
            });
        };
        if let Some(declared) = code.strip_prefix("pub ") {
            let mut words = declared.split_whitespace().skip_while(|word| {
                matches!(*word, "const" | "async" | "unsafe" | "extern")
                    && !declared.starts_with("const ")
            });
            let keyword = words.next().unwrap_or_default();
            let next = identifier(words.next().unwrap_or_default());
            match keyword {
                "struct" | "enum" | "trait" | "type" | "union" => take(next, true),
                "const" if next == "fn" => {
                    take(identifier(words.next().unwrap_or_default()), false)
                }
                "fn" | "mod" | "const" | "static" => take(next, false),
                field if field.ends_with(':') => take(identifier(field), false),
                _ => {}
            }
            if keyword == "enum" && line.ends_with('{') {
                public_enum = Some(indent);
            }
        } else if public_enum.is_some_and(|open| indent == open + 4)
            && code.starts_with(|c: char| c.is_ascii_uppercase())
        {
            take(identifier(code), false);
        }
    }
    found
}

/// The identifier at the start of a text.
fn identifier(text: &str) -> &str {
    let end = text.find(|c: char| !c.is_alphanumeric() && c != '_');
    &text[..end.unwrap_or(text.len())]
}

/// The word that an identifier should not contain.
fn ruled_out(identifier: &Identifier) -> Option<&'static str> {
    let name = identifier.name.as_str();
    if identifier.is_type
        && let Some(found) = TYPES.split_whitespace().find(|banned| *banned == name)
    {
        return Some(found);
    }
    let lower = name.to_ascii_lowercase();
    if let Some(found) = WHOLE.split_whitespace().find(|banned| *banned == lower) {
        return Some(found);
    }
    let parts = words(name);
    PARTS
        .split_whitespace()
        .find(|banned| parts.iter().any(|part| part == banned))
}

/// The words of an identifier, in lower case.
fn words(name: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    for c in name.chars() {
        if c == '_' || c.is_ascii_uppercase() {
            words.push(String::new());
        }
        if c != '_' {
            words
                .last_mut()
                .expect("there is always one")
                .push(c.to_ascii_lowercase());
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

/// Doc comments with fewer than [`DOC_WORDS_MIN`] words, with the line of each.
fn short_doc_comments(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    let mut comment: Option<(usize, Vec<&str>)> = None;
    for (number, line) in (1..).zip(text.lines().chain([""])) {
        if let Some(said) = line.trim_start().strip_prefix("///") {
            comment
                .get_or_insert((number, Vec::new()))
                .1
                .extend(said.split_whitespace());
        } else if let Some((start, words)) = comment.take()
            && words.len() < DOC_WORDS_MIN
        {
            found.push((start, words.join(" ")));
        }
    }
    found
}

#[test]
fn finds_declarations_and_words() {
    let text = "pub struct Luck;\npub(crate) struct Deed;\npub enum E {\n    Thing,\n    Fine { what: u8 },\n}\n\
                pub const fn from_told() {}\n    pub seat: u8,\nimpl X {\n    Lost\n}\n";
    let names: Vec<String> = public_identifiers(text)
        .into_iter()
        .map(|found| found.name)
        .collect();
    assert_eq!(names, ["Luck", "E", "Thing", "Fine", "from_told", "seat"]);
    assert_eq!(words("SeatOf_two"), ["seat", "of", "two"]);
    let identifier = |name: &str, is_type| Identifier {
        line: 1,
        name: name.into(),
        is_type,
    };
    assert_eq!(ruled_out(&identifier("ActuationNoise", true)), None);
    assert_eq!(ruled_out(&identifier("LuckyDeed", true)), Some("deed"));
    assert_eq!(ruled_out(&identifier("what", false)), Some("what"));
    assert_eq!(ruled_out(&identifier("Row", true)), Some("Row"));
    assert_eq!(ruled_out(&identifier("row", false)), None);
}

#[test]
fn finds_short_comments() {
    let text = "/// Which.\nx\n/// One two three four.\ny\n    /// Two\n    /// lines.\n    z";
    assert_eq!(
        short_doc_comments(text),
        [(1, "Which.".to_owned()), (5, "Two lines.".to_owned())]
    );
}
