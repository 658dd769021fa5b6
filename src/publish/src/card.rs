//! What the card of a dataset says in its YAML front matter: license, and which files the viewer
//! and `load_dataset` read. Never changes a card.

use std::{collections::BTreeMap, fs::File, io::Read as _, path::Path};

use saphyr_parser::{Event, Parser, ScalarStyle};
use serde_json::{Map, Value};

use crate::{Check, Problems, PublishedFile};

/// Longest card that is read, in bytes.
const CARD_BYTES_MAX: u64 = 4 << 20;
/// Longest front matter, in bytes.
const FRONT_BYTES_MAX: usize = 256 << 10;
/// Deepest nesting of the front matter.
const LEVELS_MAX: usize = 32;

/// The card as it was read.
pub(crate) struct Card {
    /// The whole text, as the Hub is asked to validate it.
    pub text: String,
    /// The lines between the fences.
    pub head: String,
}

/// Reads the card and checks it against the files; what is wrong is added to the problems.
pub(crate) fn check(
    root: &Path,
    files: &BTreeMap<String, PublishedFile>,
    problems: &mut Problems,
) -> Option<Card> {
    let name = reel_dataset::CARD;
    let mut refuse = |check: Check, message: &str| problems.add(check, name, None, message);
    if !files.contains_key(name) {
        let message =
            "missing; write one with a front matter that names the license, or export again";
        refuse(Check::Card, message);
        return None;
    }
    let (card, front) = match read(&root.join(name)) {
        Ok(read) => read,
        Err(reason) => {
            refuse(Check::Card, &reason);
            return None;
        }
    };
    if let Some(reason) = license_problem(&front) {
        refuse(Check::License, &reason);
    }
    for reason in file_problems(&front, files) {
        refuse(Check::Card, &reason);
    }
    Some(card)
}

fn read(place: &Path) -> Result<(Card, Value), String> {
    let failed = |error: std::io::Error| format!("it cannot be read: {error}");
    let mut text = String::new();
    let file = File::open(place).map_err(failed)?;
    file.take(CARD_BYTES_MAX + 1)
        .read_to_string(&mut text)
        .map_err(failed)?;
    if text.len() as u64 > CARD_BYTES_MAX {
        return Err("more than 4 MiB; a card is a page for people".to_owned());
    }
    let head = front_matter(&text)
        .ok_or("it has no front matter: YAML between two lines of ---, at the very beginning")?;
    if head.len() > FRONT_BYTES_MAX {
        return Err("a front matter of more than 256 KiB".to_owned());
    }
    let front = parse(head)?;
    let head = head.to_owned();
    Ok((Card { text, head }, front))
}

fn front_matter(text: &str) -> Option<&str> {
    let rest = text.strip_prefix('\u{feff}').unwrap_or(text);
    let rest = rest.strip_prefix("---")?;
    let rest = rest
        .strip_prefix("\r\n")
        .or_else(|| rest.strip_prefix('\n'))?;
    let end = rest
        .match_indices("---")
        .map(|(at, _)| at)
        .find(|at| *at == 0 || rest[..*at].ends_with('\n'))?;
    Some(&rest[..end])
}

/// Why a license is none that a reader can rely on.
fn license_problem(front: &Value) -> Option<String> {
    let how = "name one with `--license` of the export (e.g. cc-by-4.0), or in the card";
    let names: Vec<&str> = match &front["license"] {
        Value::String(name) => vec![name],
        Value::Array(names) => names.iter().filter_map(Value::as_str).collect(),
        _ => Vec::new(),
    };
    let named = |key: &str| front[key].as_str().is_some_and(|it| !it.trim().is_empty());
    match names[..] {
        [] => Some(format!("the card names no license; {how}")),
        _ if names.iter().any(|name| matches!(*name, "" | "unknown")) => {
            Some(format!("the license is unknown; {how}"))
        }
        _ if names.contains(&"other") && !(named("license_name") && named("license_link")) => Some(
            format!("the license `other` needs a license_name and a license_link; {how}"),
        ),
        _ => None,
    }
}

/// Which files the card names for the viewer that are not there.
fn file_problems(front: &Value, files: &BTreeMap<String, PublishedFile>) -> Vec<String> {
    let configs = front["configs"].as_array().map_or(&[][..], Vec::as_slice);
    let mut wrong = Vec::new();
    for config in configs {
        let name = config["config_name"].as_str().unwrap_or("default");
        let patterns = patterns(&config["data_files"]);
        if patterns.is_empty() {
            wrong.push(format!("config {name} names no data_files"));
        }
        for pattern in patterns {
            let Ok(glob) = glob::Pattern::new(&pattern) else {
                wrong.push(format!("config {name}: no pattern of files: {pattern}"));
                continue;
            };
            let options = glob::MatchOptions {
                require_literal_separator: true,
                ..glob::MatchOptions::default()
            };
            if !files.keys().any(|path| glob.matches_with(path, options)) {
                wrong.push(format!(
                    "config {name}: no file matches {pattern}; the viewer and load_dataset would fail"
                ));
            }
        }
    }
    wrong
}

/// The patterns of `data_files`: a text, a list of texts, or a list of splits with a path each.
fn patterns(data_files: &Value) -> Vec<String> {
    match data_files {
        Value::String(pattern) => vec![pattern.clone()],
        Value::Array(items) => items.iter().flat_map(patterns).collect(),
        Value::Object(split) => split.get("path").map(patterns).unwrap_or_default(),
        _ => Vec::new(),
    }
}

/// YAML as a JSON value. Anchors and aliases are refused: a card needs none.
fn parse(text: &str) -> Result<Value, String> {
    let mut parser = Parser::new_from_str(text);
    let mut open: Vec<(Value, Option<String>)> = Vec::new();
    let mut root = Value::Null;
    while let Some(event) = parser.next_event() {
        let (event, span) = event.map_err(|error| {
            let line = error.marker().line() + 1;
            format!("the front matter is no YAML, line {line}: {}", error.info())
        })?;
        let done = match event {
            Event::Alias(_) => return Err("the front matter has an alias (*)".to_owned()),
            Event::SequenceStart(..) | Event::MappingStart(..) => {
                if open.len() >= LEVELS_MAX {
                    return Err("the front matter is nested too deeply".to_owned());
                }
                let empty = if matches!(event, Event::SequenceStart(..)) {
                    Value::Array(Vec::new())
                } else {
                    Value::Object(Map::new())
                };
                open.push((empty, None));
                continue;
            }
            Event::SequenceEnd | Event::MappingEnd => match open.pop() {
                Some((value, _)) => value,
                None => continue,
            },
            Event::Scalar(text, style, ..) => match &*text {
                "" | "null" | "~" if style == ScalarStyle::Plain => Value::Null,
                text => Value::String(text.to_owned()),
            },
            _ => continue,
        };
        match open.last_mut() {
            None => root = done,
            Some((Value::Array(items), _)) => items.push(done),
            Some((Value::Object(entries), key)) => match (key.take(), done) {
                (Some(name), value) => {
                    if entries.insert(name.clone(), value).is_some() {
                        let line = span.start.line() + 1;
                        return Err(format!("the front matter has {name} twice, line {line}"));
                    }
                }
                (None, Value::String(name)) => *key = Some(name),
                (None, Value::Null) => *key = Some(String::new()),
                (None, _) => return Err("the front matter has a key that is no text".to_owned()),
            },
            Some(_) => {}
        }
    }
    match root {
        Value::Object(_) => Ok(root),
        _ => Err("the front matter is no mapping of keys to values".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const FRONT: &str = "license: \"cc-by-4.0\"\ntags:\n- a\nconfigs:\n- config_name: default\n  data_files:\n  \
        - split: train\n    path: \"train/*.jsonl\"\n- config_name: other\n  data_files: a.jsonl\n";

    fn files(paths: &[&str]) -> BTreeMap<String, PublishedFile> {
        paths
            .iter()
            .map(|path| {
                let file = PublishedFile::in_memory(path, b"x".to_vec());
                ((*path).to_owned(), file)
            })
            .collect()
    }

    #[test]
    fn the_viewers_files_have_to_be_there() {
        let front = parse(FRONT).unwrap();
        assert_eq!(front["license"], "cc-by-4.0");
        let wrong = |paths: &[&str]| file_problems(&front, &files(paths)).len();
        assert_eq!(wrong(&["train/a.jsonl", "a.jsonl"]), 0);
        assert_eq!(wrong(&["train/b/a.jsonl", "a.jsonl"]), 1);
        assert_eq!(wrong(&[]), 2);
    }

    #[test]
    fn a_license_has_to_be_named() {
        let problem = |text: &str| license_problem(&parse(text).unwrap()).is_some();
        assert!(!problem("license: mit"));
        assert!(!problem("license:\n- mit\n- apache-2.0"));
        assert!(!problem(
            "license: other\nlicense_name: x\nlicense_link: LICENSE"
        ));
        for text in [
            "a: b",
            "license:",
            "license: unknown",
            "license: other",
            "license: other\nlicense_name: x",
            "license: []",
        ] {
            assert!(problem(text), "{text}");
        }
    }

    #[test]
    fn a_front_matter_is_found_and_bounded() {
        assert_eq!(front_matter("---\na: b\n---\nc"), Some("a: b\n"));
        assert_eq!(front_matter("---\r\na: b\r\n---"), Some("a: b\r\n"));
        for text in [
            "",
            "a: b",
            "---",
            "---\na: b",
            " ---\na\n---\n",
            "---a\n---\n",
        ] {
            assert_eq!(front_matter(text), None, "{text:?}");
        }
        for text in ["a: &x b\nc: *x", "- a", "a: b\na: c", "a: [", "{[a]: b}"] {
            assert!(parse(text).is_err(), "{text}");
        }
        let deep = format!("a: {}{}", "[".repeat(100), "]".repeat(100));
        assert!(parse(&deep).is_err());
    }

    proptest! {
        #[test]
        fn any_text_ends(text in "[-a: \\[\\]{}*&\"\n,|>!%]{0,80}") {
            let _ = parse(&text);
            let _ = front_matter(&format!("---\n{text}\n---\n"));
        }
    }
}
