//! What a model wrote as an opinion: lenient about the form (fences, thoughts before, trailing
//! commas, capitals), strict about the content. What is wrong comes back in words that the
//! model can be told.

use serde_json::{Deserializer, Map, Value};

use super::{Case, Opinion, vocabulary};
use crate::CLASSES;

/// Places in a text that are tried as the beginning of a JSON object.
const TRIES_MAX: usize = 1000;
/// Most characters of a comment.
const COMMENT_CHARACTERS: usize = 2000;
/// Most characters of a proposed name.
const NAME_CHARACTERS: usize = 100;

/// Reads an opinion on a case. Public for the fuzz targets.
#[doc(hidden)]
pub fn parse(text: &str, case: &Case) -> Result<Opinion, String> {
    let answer = text
        .rsplit_once("</think>")
        .map_or(text, |(_, answer)| answer);
    let fields = fields(answer, "class")?;
    let field = |name: &str| field(&fields, name);

    let named = words(field("class")).unwrap_or_default();
    let class = vocabulary::class(&named).ok_or_else(|| {
        format!(
            "`class` is {:?}, and has to be one of {}",
            one_line(&named, NAME_CHARACTERS),
            CLASSES.join(", ")
        )
    })?;
    let (mut sub_class, mut proposed_sub_class) = (None, None);
    for name in [words(field("proposedsubclass")), words(field("subclass"))]
        .into_iter()
        .flatten()
    {
        match vocabulary::sub_class(&name) {
            Some((of, known)) if of == class => sub_class = Some(known.to_owned()),
            Some((of, known)) => {
                return Err(format!(
                    "`sub_class` {known} belongs to {of}; the sub-classes of {class} are {}",
                    vocabulary::sub_classes(class).join(", ")
                ));
            }
            None => proposed_sub_class = Some(one_line(&name, NAME_CHARACTERS)),
        }
    }
    Ok(Opinion {
        class: class.to_owned(),
        sub_class,
        proposed_sub_class,
        step: step(field("step"), case)?,
        comment: one_line(
            &words(field("comment")).unwrap_or_default(),
            COMMENT_CHARACTERS,
        ),
        confidence: confidence(field("confidence"))?,
        overruled: false,
    })
}

/// Reads whether a step is decisive: the reason if it is.
pub(super) fn parse_step(text: &str) -> Result<Option<String>, String> {
    let answer = text
        .rsplit_once("</think>")
        .map_or(text, |(_, answer)| answer);
    let fields = fields(answer, "decisive")?;
    let value = field(&fields, "decisive");
    let said = value.and_then(|value| match value {
        Value::Bool(said) => Some(*said),
        Value::String(text) => match text.trim().to_lowercase().as_str() {
            "true" | "yes" => Some(true),
            "false" | "no" => Some(false),
            _ => None,
        },
        _ => None,
    });
    let said = said.ok_or("`decisive` has to be true or false")?;
    let comment = words(field(&fields, "comment")).unwrap_or_default();
    Ok(said.then(|| one_line(&comment, COMMENT_CHARACTERS)))
}

/// The fields of the last JSON object that has one of this name.
fn fields(answer: &str, name: &str) -> Result<Map<String, Value>, String> {
    object(answer, name)
        .or_else(|| object(&without_trailing_commas(answer), name))
        .ok_or_else(|| format!("it holds no complete JSON object with a field `{name}`"))
}

fn field<'a>(fields: &'a Map<String, Value>, name: &str) -> Option<&'a Value> {
    fields
        .iter()
        .find(|(key, _)| vocabulary::letters(key) == name)
        .map(|(_, value)| value)
}

/// A text as one line of at most so many characters, without what a terminal would obey.
pub(super) fn one_line(text: &str, characters: usize) -> String {
    let line: String = text
        .trim()
        .chars()
        .take(characters)
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    line.trim_end().to_owned()
}

/// The last JSON object with a field of this name: models weigh before they decide.
fn object(text: &str, name: &str) -> Option<Map<String, Value>> {
    let (mut last, mut from) = (None, 0);
    for (at, _) in text.match_indices('{').take(TRIES_MAX) {
        if at < from {
            continue;
        }
        let mut objects = Deserializer::from_str(&text[at..]).into_iter::<Map<String, Value>>();
        if let Some(Ok(object)) = objects.next()
            && object.keys().any(|key| vocabulary::letters(key) == name)
        {
            from = at + objects.byte_offset();
            last = Some(object);
        }
    }
    last
}

/// Commas before a closing bracket go. Tried only where nothing parses, so that no
/// good string is touched.
fn without_trailing_commas(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for (at, c) in text.char_indices() {
        if c != ',' || !text[at + 1..].trim_start().starts_with(['}', ']']) {
            out.push(c);
        }
    }
    out
}

/// A text that says something.
fn words(value: Option<&Value>) -> Option<String> {
    let text = value?.as_str()?.trim();
    let nothing =
        text.is_empty() || ["null", "none", "n/a"].contains(&text.to_lowercase().as_str());
    (!nothing).then(|| text.to_owned())
}

/// A number, also one in words like `step 7`, that the transcript has.
fn step(value: Option<&Value>, case: &Case) -> Result<u32, String> {
    let number = match value {
        Some(Value::String(text)) => text
            .trim()
            .trim_start_matches(|c: char| c.is_alphabetic() || c == '#' || c == ' ')
            .parse()
            .ok(),
        Some(value) => value.as_f64().filter(|number| number.fract() == 0.0),
        None => None,
    };
    let range = || match (case.transcript.first(), case.transcript.last()) {
        (Some(first), Some(last)) => {
            format!("a step of the record, {} to {}", first.step, last.step)
        }
        _ => "a step of the record".to_owned(),
    };
    let said = || {
        value.map_or_else(
            || "missing".to_owned(),
            |value| one_line(&value.to_string(), NAME_CHARACTERS),
        )
    };
    let known = number.and_then(|number| {
        case.transcript
            .iter()
            .map(|turn| turn.step)
            .find(|step| f64::from(*step) == number)
    });
    known.ok_or_else(|| format!("`step` is {}, and has to be {}", said(), range()))
}

/// A number from 0 to 1, or one in percent that says so.
fn confidence(value: Option<&Value>) -> Result<f64, String> {
    let number = match value {
        Some(Value::String(text)) => match text.trim().strip_suffix('%') {
            Some(percent) => percent
                .trim()
                .parse()
                .ok()
                .map(|percent: f64| percent / 100.0),
            None => text.trim().parse().ok(),
        },
        Some(value) => value.as_f64(),
        None => None,
    };
    number
        .filter(|number| (0.0..=1.0).contains(number))
        .ok_or_else(|| "`confidence` has to be a number from 0 to 1".to_owned())
}

#[cfg(test)]
mod tests {
    use super::{super::CaseStep, *};

    fn parsed(text: &str) -> Result<Opinion, String> {
        let transcript = (0..10)
            .map(|step| CaseStep {
                step,
                ..CaseStep::default()
            })
            .collect();
        parse(
            text,
            &Case {
                transcript,
                ..Case::default()
            },
        )
    }

    const GOOD: &str = r#"{"class": "Lost Memory", "sub_class": "oscillation", "step": 4, "comment": "to and fro, {again},]", "confidence": 0.9}"#;

    #[test]
    fn forms_of_the_same_answer() {
        let expected = parsed(GOOD).unwrap();
        assert_eq!(
            (
                expected.class.as_str(),
                expected.sub_class.as_deref(),
                expected.step
            ),
            ("Lost Memory", Some("oscillation"), 4)
        );
        assert_eq!(
            (expected.comment.as_str(), expected.confidence),
            ("to and fro, {again},]", 0.9)
        );
        for form in [
            format!("```json\n{GOOD}\n```"),
            format!("<think>perhaps {{\"class\": \"Other\"}}</think>\n{GOOD}"),
            format!(
                "First {{not this}}, then {{\"class\": \"Other\", \"step\": 1}}; no: {GOOD} I am sure."
            ),
            format!("{{\"answer\": {GOOD}}}"),
            GOOD.replace(", \"step", ", \"else\": {\"class\": \"Other\"}, \"step"),
            GOOD.replace("sub_class", "Sub-Class")
                .replace("Lost Memory", "lost_memory")
                .replace("oscillation", "Oscillation"),
            GOOD.replace(": 4", ": \"step 4\"")
                .replace("0.9", "\"90%\""),
            GOOD.replace(": 4", ": 4.0")
                .replace(", \"step", ", \"proposed_sub_class\": \"none\", \"step"),
        ] {
            assert_eq!(parsed(&form), Ok(expected.clone()), "{form}");
        }
        let commas = r#"{"class": "Other", "sub_class": null, "step": 0, "comment": "x", "confidence": 1, }"#;
        assert_eq!(parsed(commas).unwrap().class, "Other");
    }

    #[test]
    fn a_name_of_its_own_is_a_proposal() {
        let mine = parsed(&GOOD.replace("oscillation", "Circled the\\u001b[31m table")).unwrap();
        assert_eq!(
            (mine.sub_class, mine.proposed_sub_class.as_deref()),
            (None, Some("Circled the [31m table"))
        );
        let known = parsed(&GOOD.replace("sub_class", "proposed_sub_class")).unwrap();
        assert_eq!(
            (known.sub_class.as_deref(), known.proposed_sub_class),
            (Some("oscillation"), None)
        );
    }

    #[test]
    fn what_is_wrong_is_said() {
        let long = "{".repeat(100_000);
        let numbers = "{\"class\": [".repeat(20_000);
        for (text, word) in [
            ("", "no complete JSON object"),
            ("I cannot tell.", "no complete JSON object"),
            (&GOOD[..60], "no complete JSON object"),
            (&long, "no complete JSON object"),
            (&numbers, "no complete JSON object"),
            (
                &GOOD.replace("Lost Memory", "Bad Luck"),
                "one of Object Confusion, Key Action Missing",
            ),
            (
                &GOOD.replace("\"Lost Memory\"", "7"),
                "one of Object Confusion, Key Action Missing",
            ),
            (
                &GOOD.replace("oscillation", "missing_ask"),
                "belongs to Key Action Missing",
            ),
            (&GOOD.replace(": 4", ": 10"), "0 to 9"),
            (&GOOD.replace(": 4", ": -1"), "0 to 9"),
            (&GOOD.replace(": 4", ": 4.5"), "0 to 9"),
            (&GOOD.replace(": 4", ": 1e99"), "0 to 9"),
            (&GOOD.replace("\"step\"", "\"stop\""), "missing"),
            (&GOOD.replace("0.9", "9"), "from 0 to 1"),
            (&GOOD.replace("0.9", "\"high\""), "from 0 to 1"),
            (&GOOD.replace("0.9", "\"NaN\""), "from 0 to 1"),
        ] {
            let what = parsed(text).unwrap_err();
            assert!(
                what.contains(word),
                "{}: {what}",
                &text[..text.len().min(80)]
            );
        }
    }
}
