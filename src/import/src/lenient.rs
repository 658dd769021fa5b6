//! Documents and fields that third-party programs wrote, read as leniently as they deserve.

use std::{borrow::Cow, ops::Range};

use serde::{Deserialize, de::DeserializeOwned};
use serde_json::Value;

/// The numbers that are none, as Python writes them into JSON, which has no word for them.
const NO_NUMBERS: [&[u8]; 3] = [b"NaN", b"Infinity", b"-Infinity"];

/// Most digits of an integer that a message shows.
const DIGITS_SHOWN: usize = 40;

/// A document in JSON as Python writes it: a number that is none is `null`.
pub(crate) fn document<T: DeserializeOwned>(bytes: &[u8]) -> serde_json::Result<T> {
    serde_json::from_slice(bytes).or_else(|error| match with_nulls(bytes) {
        Cow::Borrowed(_) => Err(error),
        Cow::Owned(bytes) => serde_json::from_slice(&bytes),
    })
}

/// The document with `null` for each number that is none; texts stay as they are.
fn with_nulls(bytes: &[u8]) -> Cow<'_, [u8]> {
    let (mut written, mut copied) = (Vec::new(), 0);
    for word in without_value(bytes) {
        written.extend_from_slice(&bytes[copied..word.start]);
        written.extend_from_slice(b"null");
        copied = word.end;
    }
    if copied == 0 {
        return Cow::Borrowed(bytes);
    }
    written.extend_from_slice(&bytes[copied..]);
    Cow::Owned(written)
}

/// How many numbers of a document are none, which [`document`] reads as `null`.
pub(crate) fn numbers_without_value(bytes: &[u8]) -> usize {
    without_value(bytes).count()
}

/// Where the numbers that are none stand.
fn without_value(bytes: &[u8]) -> impl Iterator<Item = Range<usize>> {
    bare_words(bytes).filter(move |word| NO_NUMBERS.contains(&&bytes[word.clone()]))
}

/// The integers of a document that 64 bits do not hold, which are read as the nearest fractions.
pub fn long_integers(bytes: &[u8]) -> Vec<&str> {
    let words = bare_words(bytes).filter_map(move |word| std::str::from_utf8(&bytes[word]).ok());
    let is_long = |word: &&str| {
        let digits = word.strip_prefix('-').unwrap_or(word);
        digits.bytes().all(|byte| byte.is_ascii_digit())
            && word.parse::<u64>().is_err()
            && word.parse::<i64>().is_err()
    };
    words.filter(is_long).collect()
}

/// What is lost of such integers, for people; `None` where there are none.
pub(crate) fn long_integers_told(bytes: &[u8]) -> Option<String> {
    let long = long_integers(bytes);
    let example: String = long.first()?.chars().take(DIGITS_SHOWN).collect();
    Some(format!(
        "integers of more than 64 bits are read as the nearest number of 64: {}, such as {example}; write them as texts",
        long.len(),
    ))
}

/// Where the numbers and names of a document stand, outside of its texts.
fn bare_words(bytes: &[u8]) -> impl Iterator<Item = Range<usize>> {
    let mut at = 0;
    std::iter::from_fn(move || {
        while at < bytes.len() {
            if bytes[at] == b'"' {
                at += text_length(&bytes[at..]);
                continue;
            }
            let of_word = |byte: &&u8| byte.is_ascii_alphanumeric() || b"+-.".contains(*byte);
            let length = bytes[at..].iter().take_while(of_word).count();
            if length > 0 {
                at += length;
                return Some(at - length..at);
            }
            at += 1;
        }
        None
    })
}

/// The length of the text that begins here, with both of its quotation marks.
fn text_length(bytes: &[u8]) -> usize {
    let mut at = 1;
    while at < bytes.len() {
        match bytes[at] {
            b'\\' => at += 2,
            b'"' => return at + 1,
            _ => at += 1,
        }
    }
    bytes.len()
}

/// A field that may be `null`.
pub(crate) fn or_empty<'de, D, T>(deserializer: D) -> Result<T, D::Error>
where
    D: serde::Deserializer<'de>,
    T: Default + Deserialize<'de>,
{
    Ok(Option::deserialize(deserializer)?.unwrap_or_default())
}

/// A field that is worth nothing where it is of another type: numbers of other libraries may be
/// texts, negative or `null`.
pub(crate) fn or_default<'de, D, T>(deserializer: D) -> Result<T, D::Error>
where
    D: serde::Deserializer<'de>,
    T: Default + DeserializeOwned,
{
    Ok(serde_json::from_value(Value::deserialize(deserializer)?).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn numbers_that_are_none_are_null_and_texts_stay() {
        let told =
            br#"{"NaN": NaN, "a": [-Infinity,Infinity, -1.5e3], "b": "NaN, \"NaN\" \\", "c": NaN}"#;
        let read: Value = document(told).unwrap();
        let expected = json!({
            "NaN": null, "a": [null, null, -1500.0], "b": "NaN, \"NaN\" \\", "c": null,
        });
        assert_eq!(read, expected);
        for wrong in [
            "{\"a\": NaNs}",
            "{\"a\": -NaN}",
            "[NaN",
            "\"NaN",
            "\"\\",
            "",
        ] {
            assert!(document::<Value>(wrong.as_bytes()).is_err(), "{wrong}");
        }
    }

    #[test]
    fn integers_beyond_64_bits_are_found() {
        let told = br#"[18446744073709551615, -9223372036854775808, 12345678901234567890123, 1e40,
            "12345678901234567890123", 12345678901234567890123.5, -9223372036854775809, -0, true]"#;
        assert_eq!(
            long_integers(told),
            ["12345678901234567890123", "-9223372036854775809"]
        );
    }
}
