//! A text as it reads with JSON's escapes resolved, and where each place of it stands in the text itself: a secret in
//! JSON that is itself a string of JSON is found by what it means, and replaced where it stands.

use std::ops::Range;

/// How many levels of strings in strings are looked through.
pub(crate) const LEVELS: usize = 4;
/// Escapes of a text that are resolved. A text with more is unreadable to the rules.
const ESCAPES_MAX: usize = 4 << 20;

/// A text with its escapes resolved.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Unescaped {
    pub text: String,
    /// Where lengths shift: an offset in the resolved text, and the one in the source from there on.
    shifts: Vec<(usize, usize)>,
}

/// A text that has more escapes than are resolved.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct TooManyEscapes;

impl Unescaped {
    /// Resolves the escapes of a text; `None` if it has none.
    pub(crate) fn of(source: &str) -> Result<Option<Self>, TooManyEscapes> {
        let mut from = match source.find('\\') {
            Some(first) => first,
            None => return Ok(None),
        };
        let mut text = source[..from].to_owned();
        let mut shifts = Vec::new();
        loop {
            let rest = &source[from..];
            let (letter, length) = escape(rest).unwrap_or(('\\', 1));
            text.push(letter);
            from += length;
            if length > 1 {
                if shifts.len() == ESCAPES_MAX {
                    return Err(TooManyEscapes);
                }
                shifts.push((text.len(), from));
            }
            match source[from..].find('\\') {
                Some(next) => {
                    text.push_str(&source[from..from + next]);
                    from += next;
                }
                None => {
                    text.push_str(&source[from..]);
                    break;
                }
            }
        }
        Ok(Some(Self { text, shifts }).filter(|it| !it.shifts.is_empty()))
    }

    /// Where a range of the resolved text stands in the source.
    pub(crate) fn in_source(&self, range: Range<usize>) -> Range<usize> {
        let place = |at: usize| {
            let before = self.shifts.partition_point(|(resolved, _)| *resolved <= at);
            match before.checked_sub(1).map(|index| self.shifts[index]) {
                Some((resolved, source)) => source + (at - resolved),
                None => at,
            }
        };
        place(range.start)..place(range.end)
    }
}

/// The letter that an escape at the beginning stands for, and how long the escape is.
fn escape(text: &str) -> Option<(char, usize)> {
    let letter = match text.as_bytes().get(1)? {
        b'"' => '"',
        b'\\' => '\\',
        b'/' => '/',
        b'b' => '\u{8}',
        b'f' => '\u{c}',
        b'n' => '\n',
        b'r' => '\r',
        b't' => '\t',
        b'u' => return unicode(text),
        _ => return None,
    };
    Some((letter, 2))
}

fn unicode(text: &str) -> Option<(char, usize)> {
    let unit = |at: usize| {
        let digits = text.get(at..at + 6)?.strip_prefix("\\u")?;
        let hex = digits.bytes().all(|byte| byte.is_ascii_hexdigit());
        u16::from_str_radix(digits, 16).ok().filter(|_| hex)
    };
    let first = unit(0)?;
    if let Some(letter) = char::from_u32(u32::from(first)) {
        return Some((letter, 6));
    }
    let pair = char::decode_utf16([first, unit(6)?]).next()?.ok()?;
    Some((pair, 12))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn places_lead_back() {
        let source = r#"a\u0073k-\"x\" \ud83d\ude00 \q end"#;
        let resolved = Unescaped::of(source).unwrap().unwrap();
        assert_eq!(resolved.text, "ask-\"x\" 😀 \\q end");
        let at = resolved.text.find("sk-\"x").unwrap();
        assert_eq!(&source[resolved.in_source(at..at + 5)], r#"\u0073k-\"x"#);
        let face = resolved.text.find('😀').unwrap();
        assert_eq!(&source[resolved.in_source(face..face + 4)], r"\ud83d\ude00");
        assert_eq!(Unescaped::of("plain"), Ok(None));
        assert_eq!(Unescaped::of(r"\q \ud83d"), Ok(None));
    }

    proptest! {
        #[test]
        fn what_json_escapes_is_resolved(text in ".{0,40}") {
            let json = serde_json::to_string(&text).unwrap();
            let inner = &json[1..json.len() - 1];
            let resolved = Unescaped::of(inner).unwrap().map_or(inner.to_owned(), |it| it.text);
            // Control characters have a form of their own, which is an escape too.
            prop_assert_eq!(resolved, text);
        }

        #[test]
        fn every_range_leads_into_the_source(text in "([\\\\u0-9a-f\"néz/]|\\\\u00e9|\\\\n){0,40}") {
            if let Some(resolved) = Unescaped::of(&text).unwrap() {
                let places: Vec<usize> = resolved.text.char_indices().map(|(at, _)| at).chain([resolved.text.len()]).collect();
                for pair in places.windows(2) {
                    let range = resolved.in_source(pair[0]..pair[1]);
                    prop_assert!(text.get(range).is_some_and(|part| !part.is_empty()));
                }
            }
        }
    }
}
