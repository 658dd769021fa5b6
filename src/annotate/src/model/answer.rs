//! What a model wrote as notes: lenient about the form (thoughts before, fences, other names for a
//! field, lists where a text belongs), strict about completeness.

use serde_json::{Deserializer, Map, Value};

use crate::{Annotation, english};

/// Places in a text that are tried as the beginning of a JSON object.
const TRIES_MAX: usize = 2000;
/// Longest part of a note, in characters.
const PART_CHARACTERS_MAX: usize = 6000;

/// Every complete note with its step; of several for one step the last. Public for the fuzz
/// targets.
#[doc(hidden)]
pub fn parse(text: &str) -> Vec<(usize, Annotation)> {
    let answer = text
        .rsplit_once("</think>")
        .map_or(text, |(_, answer)| answer);
    let mut notes: Vec<(usize, Annotation)> = Vec::new();
    let mut from = 0;
    for (at, _) in answer.match_indices('{').take(TRIES_MAX) {
        if at < from {
            continue;
        }
        let mut objects = Deserializer::from_str(&answer[at..]).into_iter::<Map<String, Value>>();
        if let Some(Ok(object)) = objects.next()
            && let Some((step, note)) = note(&object)
        {
            from = at + objects.byte_offset();
            notes.retain(|(other, _)| *other != step);
            notes.push((step, note));
        }
    }
    notes
}

fn note(object: &Map<String, Value>) -> Option<(usize, Annotation)> {
    let field = |names: &[&str]| {
        let named =
            |key: &str| names.contains(&key.to_lowercase().replace([' ', '_', '-'], "").as_str());
        object
            .iter()
            .find(|(key, _)| named(key))
            .map(|(_, value)| value)
    };
    let part = |names: &[&str]| {
        let text = words(field(names)?)?;
        (!text.is_empty() && text.chars().count() <= PART_CHARACTERS_MAX).then_some(text)
    };
    let note = Annotation {
        reasoning: part(&["reasoning", "think", "thought"])?,
        history: part(&["history"])?,
        schedule: part(&["schedule", "newschedule", "plan"])?,
        subtask: part(&["subtask", "currentsubtask"])?,
    };
    Some((number(field(&["step"])?)?, note))
}

/// A number, also one in words like `step 7`.
fn number(value: &Value) -> Option<usize> {
    match value {
        Value::Number(number) => usize::try_from(number.as_u64()?).ok(),
        Value::String(text) => text
            .trim_start_matches(|letter: char| !letter.is_ascii_digit())
            .trim_end()
            .parse()
            .ok(),
        _ => None,
    }
}

/// A text in one line; the items of a list as such.
fn words(value: &Value) -> Option<String> {
    match value {
        Value::String(text) => Some(english::one_line(text)),
        Value::Array(items) => Some(
            items
                .iter()
                .map(words)
                .collect::<Option<Vec<_>>>()?
                .join("; "),
        ),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOTE: &str =
        r#"{"step": 3, "reasoning": "r", "history": "h", "schedule": "s", "subtask": "t"}"#;

    #[test]
    fn forms_of_an_answer() {
        let whole = Annotation {
            reasoning: "r".into(),
            history: "h".into(),
            schedule: "s".into(),
            subtask: "t".into(),
        };
        for text in [
            NOTE.to_owned(),
            format!("[{NOTE}]"),
            format!("<think>{{\"step\": 3}}</think>Here you are:\n```json\n[\n{NOTE},\n]\n```"),
            format!(r#"{{"notes": [{NOTE}]}}"#),
            r#"{"Step": "step 3", "think": "r", "History": "h", "New Schedule": ["s"], "Current subtask": "t\n"}"#.to_owned(),
        ] {
            assert_eq!(parse(&text), [(3, whole.clone())], "{text}");
        }
    }

    #[test]
    fn what_is_no_whole_note_is_none() {
        for text in [
            "",
            "no",
            "{",
            r#"{"step": 3}"#,
            &NOTE.replace("\"h\"", "\"\""),
            &NOTE.replace("3", "\"x\""),
            &NOTE[..40],
        ] {
            assert!(parse(text).is_empty(), "{text}");
        }
        assert_eq!(
            parse(&format!("{NOTE}{}", NOTE.replace("\"r\"", "\"q\""))).len(),
            1
        );
    }
}
