//! The values within brackets of a text: objects and lists of JSON, of TOML, or as Python prints them; and the
//! numbers that are values there.

use std::ops::Range;

/// Deeper brackets are not told apart from what stands in them.
const DEPTH_MAX: usize = 64;
/// Longer numbers are read as words.
const NUMBER_MAX: usize = 64;

/// Where the texts, numbers and words are that stand within the bracket at `open`, without their quotes, and where the
/// bracket ends; names of members are left out. A bracket that is not closed reaches to the end of the text.
pub(crate) fn values(text: &str, open: usize) -> (Vec<Range<usize>>, usize) {
    let bytes = text.as_bytes();
    let mut values = Vec::new();
    let (mut depth, mut at) = (0, open);
    while let Some(&byte) = bytes.get(at) {
        match byte {
            b'{' | b'[' => {
                depth += 1;
                at += 1;
            }
            b'}' | b']' => {
                depth -= 1;
                at += 1;
            }
            b' ' | b'\t' | b'\r' | b'\n' | b',' | b':' | b'=' => at += 1,
            quote @ (b'"' | b'\'') => {
                let end = closing(bytes, at + 1, quote);
                if !is_name(bytes, end + 1) && end > at + 1 {
                    values.push(at + 1..end);
                }
                at = end + 1;
            }
            _ => {
                let ends = |byte: &u8| b" \t\r\n,:=[]{}\"'".contains(byte);
                let length = bytes[at..].iter().position(ends);
                let end = length.map_or(bytes.len(), |length| at + length);
                let word = &text[at..end];
                if !is_name(bytes, end)
                    && !["null", "None", "true", "false", "True", "False"].contains(&word)
                {
                    values.push(at..end);
                }
                at = end;
            }
        }
        if depth == 0 || depth > DEPTH_MAX {
            break;
        }
    }
    if depth > DEPTH_MAX {
        values.push(at..text.len());
        values.retain(|range| !range.is_empty());
        at = text.len();
    }
    (values, at)
}

/// Where the quote is that closes a text; the end where there is none.
fn closing(bytes: &[u8], from: usize, quote: u8) -> usize {
    let mut at = from;
    while let Some(&byte) = bytes.get(at) {
        match byte {
            b'\\' => at += 2,
            byte if byte == quote => return at,
            _ => at += 1,
        }
    }
    bytes.len()
}

/// Whether what ends here is the name of a member.
fn is_name(bytes: &[u8], end: usize) -> bool {
    let rest = bytes.get(end..).unwrap_or_default();
    let next = rest.iter().find(|byte| !b" \t\r\n".contains(byte));
    matches!(next, Some(b':' | b'='))
}

/// Where the whole number stands that has this place of a text in it or begins there, if it is the value of a member or of
/// a list in JSON; however deep the text is a string in other JSON.
pub(crate) fn number(text: &str, at: usize) -> Option<Range<usize>> {
    let bytes = text.as_bytes();
    let start = at - number_length(bytes[..at].iter().rev());
    let length = number_length(bytes[start..].iter());
    let end = start + length;
    if length > NUMBER_MAX || text[start..end].parse::<serde_json::Number>().is_err() {
        return None;
    }
    let before = without_space_at_end(&text[..start]);
    let is_value = if let Some(name) = before.strip_suffix(':') {
        without_space_at_end(name).ends_with(['"', '\''])
    } else if let Some(item) = before.strip_suffix(',') {
        let ends = |letter: char| letter.is_ascii_digit() || "\"']}".contains(letter);
        without_space_at_end(item).ends_with(ends)
    } else {
        before.ends_with('[')
    };
    let after = without_space_at_start(&text[end..]);
    let is_closed = after.is_empty() || after.starts_with([',', '}', ']']);
    (is_value && is_closed).then_some(start..end)
}

/// How many bytes at the beginning may be parts of a number.
fn number_length<'a>(bytes: impl Iterator<Item = &'a u8>) -> usize {
    bytes
        .take(NUMBER_MAX + 1)
        .take_while(|byte| byte.is_ascii_digit() || b"+-.eE".contains(byte))
        .count()
}

/// A text without the spaces that it ends with, also where these are escaped.
fn without_space_at_end(mut text: &str) -> &str {
    loop {
        text = text.trim_end();
        match text.strip_suffix(['n', 'r', 't']) {
            Some(rest) if rest.ends_with('\\') => text = rest.trim_end_matches('\\'),
            _ => return text,
        }
    }
}

/// A text without the spaces that it begins with, also where these are escaped.
fn without_space_at_start(mut text: &str) -> &str {
    loop {
        text = text.trim_start();
        let letter = text.trim_start_matches('\\');
        match letter.strip_prefix(['n', 'r', 't']) {
            Some(rest) if letter.len() < text.len() => text = rest,
            _ => return text,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_values_of_json_alone() {
        for (text, found) in [
            (r#"{"a": 12345}"#, Some("12345")),
            (r#"{"a":-1.5e3,"b":1}"#, Some("-1.5e3")),
            ("[1, 12345]", Some("1")),
            (r#"{\"a\": 123\n}"#, Some("123")),
            (r#"["a", 12]"#, Some("12")),
            ("a: 12345", None),
            ("a, 12345, b", None),
            (r#"{"a": 12-34}"#, None),
            (r#"{"a": 12 b}"#, None),
            (r#"{"a": "12"}"#, None),
            (r#"{"a": 007}"#, None),
        ] {
            let first = text.find(|letter: char| letter.is_ascii_digit()).unwrap();
            assert_eq!(
                number(text, first).map(|range| &text[range]),
                found,
                "{text}"
            );
        }
        assert_eq!(number(r#"{"a": 12345}"#, 8), Some(6..11));
        assert_eq!(number(&format!("[{}]", "1".repeat(100)), 1), None);
    }

    fn of(text: &str) -> Vec<&str> {
        let values = values(text, 0).0.into_iter();
        values.map(|range| &text[range]).collect()
    }

    #[test]
    fn names_are_left_out_and_the_bracket_ends_it() {
        assert_eq!(
            of(r#"{"user": "svc", "key": {"a": [1, 2.5, null]}, "n": true}, "other""#),
            ["svc", "1", "2.5"]
        );
        assert_eq!(of("['a b', \"c\\\"d\"] e"), ["a b", "c\\\"d"]);
        assert_eq!(of("{user = 'svc', port=80}"), ["svc", "80"]);
    }

    #[test]
    fn what_is_not_closed_reaches_to_the_end() {
        assert_eq!(of(r#"{"key": "unfin"#), ["unfin"]);
        assert_eq!(of("[a, b"), ["a", "b"]);
        assert_eq!(of("["), Vec::<&str>::new());
        let deep = "[".repeat(100) + "x";
        assert!(
            of(&deep).iter().any(|value| value.ends_with('x')),
            "{:?}",
            of(&deep)
        );
    }
}
