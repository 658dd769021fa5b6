//! The values within brackets of a text: objects and lists of JSON, of TOML, or as Python prints them.

use std::ops::Range;

/// Deeper brackets are not told apart from what stands in them.
const DEPTH_MAX: usize = 64;

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

#[cfg(test)]
mod tests {
    use super::*;

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
