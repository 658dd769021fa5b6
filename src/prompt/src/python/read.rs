//! JSON as Python reads it: `NaN` and `Infinity` are numbers, the last of equal keys holds,
//! nothing follows the value.
//!
//! Two values have no place in [`Value`]: `nan`, `inf` and `-inf` become these texts, and half of a
//! surrogate pair becomes U+FFFD.

use serde_json::{Map, Value};

/// Python gives up on deeper values (`RecursionError`).
const DEPTH_MAX: usize = 400;

/// `json.loads`: the value that is the whole text; `None` where it raises.
pub fn loads(text: &str) -> Option<Value> {
    let mut reader = Reader {
        text,
        at: 0,
        depth: 0,
    };
    reader.skip_space();
    let value = reader.value()?;
    reader.skip_space();
    (reader.at == text.len()).then_some(value)
}

/// `JSONDecoder().raw_decode(text)`: the value at the beginning of the text, and the
/// byte where it ends.
pub fn raw_decode(text: &str) -> Option<(Value, usize)> {
    let mut reader = Reader {
        text,
        at: 0,
        depth: 0,
    };
    let value = reader.value()?;
    Some((value, reader.at))
}

/// Places in a text that are tried as the beginning of an object: nobody's model writes as many,
/// and each may be read to the end.
const TRIES_MAX: usize = 1000;

/// The object at each `{` of a text that begins one, nested ones too.
pub fn objects(text: &str) -> impl Iterator<Item = Map<String, Value>> {
    text.match_indices('{')
        .take(TRIES_MAX)
        .filter_map(|(at, _)| match raw_decode(&text[at..]) {
            Some((Value::Object(object), _)) => Some(object),
            _ => None,
        })
}

/// The first of [`objects`].
pub fn first_object(text: &str) -> Option<Map<String, Value>> {
    objects(text).next()
}

struct Reader<'t> {
    text: &'t str,
    at: usize,
    depth: usize,
}

impl Reader<'_> {
    fn rest(&self) -> &str {
        &self.text[self.at..]
    }

    fn peek(&self) -> Option<u8> {
        self.text.as_bytes().get(self.at).copied()
    }

    fn take(&mut self, token: &str) -> Option<()> {
        self.rest()
            .starts_with(token)
            .then(|| self.at += token.len())
    }

    fn skip_space(&mut self) {
        while matches!(self.peek(), Some(b' ' | b'\t' | b'\n' | b'\r')) {
            self.at += 1;
        }
    }

    fn value(&mut self) -> Option<Value> {
        const WORDS: [(&str, Value); 3] = [
            ("null", Value::Null),
            ("true", Value::Bool(true)),
            ("false", Value::Bool(false)),
        ];
        const FLOATS: [(&str, &str); 3] =
            [("NaN", "nan"), ("Infinity", "inf"), ("-Infinity", "-inf")];
        match self.peek()? {
            b'{' => self.nested(Self::object),
            b'[' => self.nested(Self::array),
            b'"' => self.string().map(Value::String),
            _ => {
                for (word, value) in WORDS {
                    if self.take(word).is_some() {
                        return Some(value);
                    }
                }
                for (word, value) in FLOATS {
                    if self.take(word).is_some() {
                        return Some(value.into());
                    }
                }
                self.number()
            }
        }
    }

    fn nested(&mut self, read: fn(&mut Self) -> Option<Value>) -> Option<Value> {
        self.depth += 1;
        let value = if self.depth > DEPTH_MAX {
            None
        } else {
            read(self)
        };
        self.depth -= 1;
        value
    }

    fn object(&mut self) -> Option<Value> {
        let mut object = Map::new();
        self.take("{")?;
        self.skip_space();
        if self.take("}").is_some() {
            return Some(object.into());
        }
        loop {
            let key = self.string()?;
            self.skip_space();
            self.take(":")?;
            self.skip_space();
            object.insert(key, self.value()?);
            self.skip_space();
            if self.take("}").is_some() {
                return Some(object.into());
            }
            self.take(",")?;
            self.skip_space();
        }
    }

    fn array(&mut self) -> Option<Value> {
        let mut items = Vec::new();
        self.take("[")?;
        self.skip_space();
        if self.take("]").is_some() {
            return Some(items.into());
        }
        loop {
            items.push(self.value()?);
            self.skip_space();
            if self.take("]").is_some() {
                return Some(items.into());
            }
            self.take(",")?;
            self.skip_space();
        }
    }

    fn string(&mut self) -> Option<String> {
        let mut string = String::new();
        self.take("\"")?;
        loop {
            let stop = self
                .rest()
                .find(|c: char| c == '"' || c == '\\' || c < ' ')?;
            string.push_str(&self.rest()[..stop]);
            self.at += stop + 1;
            match self.text.as_bytes()[self.at - 1] {
                b'"' => return Some(string),
                b'\\' => string.push(self.escape()?),
                _ => return None,
            }
        }
    }

    fn escape(&mut self) -> Option<char> {
        let letter = self.peek()?;
        self.at += 1;
        Some(match letter {
            b'"' | b'\\' | b'/' => char::from(letter),
            b'b' => '\u{8}',
            b'f' => '\u{c}',
            b'n' => '\n',
            b'r' => '\r',
            b't' => '\t',
            b'u' => {
                let high = self.hex()?;
                let before = self.at;
                let low = if (0xd800..0xdc00).contains(&high) && self.take("\\u").is_some() {
                    self.hex()
                } else {
                    None
                };
                match low.filter(|low| (0xdc00..0xe000).contains(low)) {
                    Some(low) => {
                        char::from_u32(0x10000 + ((high - 0xd800) << 10) + (low - 0xdc00))?
                    }
                    None => {
                        self.at = before;
                        char::from_u32(high).unwrap_or(char::REPLACEMENT_CHARACTER)
                    }
                }
            }
            _ => return None,
        })
    }

    fn hex(&mut self) -> Option<u32> {
        let digits = self
            .rest()
            .get(..4)
            .filter(|digits| digits.bytes().all(|digit| digit.is_ascii_hexdigit()))?;
        let code = u32::from_str_radix(digits, 16).ok()?;
        self.at += 4;
        Some(code)
    }

    fn number(&mut self) -> Option<Value> {
        let start = self.at;
        let _ = self.take("-");
        match self.peek()? {
            b'0' => self.at += 1,
            b'1'..=b'9' => self.digits(),
            _ => return None,
        }
        let whole = self.at;
        let digit = |byte: Option<&u8>| byte.is_some_and(u8::is_ascii_digit);
        let bytes = self.text.as_bytes();
        if bytes.get(self.at) == Some(&b'.') && digit(bytes.get(self.at + 1)) {
            self.at += 1;
            self.digits();
        }
        if matches!(bytes.get(self.at), Some(b'e' | b'E')) {
            let sign = usize::from(matches!(bytes.get(self.at + 1), Some(b'+' | b'-')));
            if digit(bytes.get(self.at + 1 + sign)) {
                self.at += 1 + sign;
                self.digits();
            }
        }
        let text = &self.text[start..self.at];
        if self.at == whole {
            if let Ok(number) = text.parse::<i64>() {
                return Some(number.into());
            }
            if let Ok(number) = text.parse::<u64>() {
                return Some(number.into());
            }
        }
        let number: f64 = text.parse().ok()?;
        match serde_json::Number::from_f64(number) {
            Some(number) => Some(number.into()),
            None => Some(if number > 0.0 { "inf" } else { "-inf" }.into()),
        }
    }

    fn digits(&mut self) {
        while self.peek().is_some_and(|byte| byte.is_ascii_digit()) {
            self.at += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    #[test]
    fn what_python_reads_and_serde_does_not() {
        assert_eq!(
            loads("[NaN, Infinity, -Infinity, 1e999]"),
            Some(json!(["nan", "inf", "-inf", "inf"]))
        );
        assert_eq!(
            loads(r#"{"a": 1, "b": 2, "a": 3}"#)
                .map(|it| it.to_string())
                .as_deref(),
            Some(r#"{"a":3,"b":2}"#)
        );
        assert_eq!(
            loads(r#""\ud83d\ude00 \ud83d""#),
            Some(json!("\u{1f600} \u{fffd}"))
        );
    }

    #[test]
    fn what_python_refuses() {
        let refused = [
            "\u{feff}1",
            "01",
            "1.",
            "+1",
            "[1,]",
            "{\"a\":1,}",
            "\"a\nb\"",
            r#""\x""#,
            "{'a': 1}",
            "1 2",
            "",
            "nul",
        ];
        for text in refused {
            assert_eq!(loads(text), None, "{text:?}");
        }
        assert_eq!(loads(&("[".repeat(100_000) + &"]".repeat(100_000))), None);
    }

    proptest! {
        #[test]
        fn what_serde_writes_is_read_as_it_was(text in "\\PC{0,40}", number: i64, float in -1e300..1e300_f64) {
            let value = json!({ "t": text, "n": [number, float], "u": null });
            prop_assert_eq!(loads(&value.to_string()), Some(value.clone()));
            prop_assert_eq!(first_object(&format!("{{ {value}")), value.as_object().cloned());
        }

        #[test]
        fn nothing_panics(text in "(\\PC|[{}\\[\\]\",:0-9.eE+\\\\u-]|NaN|null){0,60}") {
            let _ = (loads(&text), objects(&text).count());
        }
    }
}
