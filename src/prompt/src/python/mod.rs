//! The parts of Python that REAL's clients lean on: reading JSON as `json` does, writing it
//! as `json.dumps` does, and `str()` of a value. Whoever wants the same bytes as these
//! clients goes through here.

mod read;
mod write;

pub use read::{first_object, loads, objects, raw_decode};
pub use write::{Ascii, dumps, dumps_indented, str};

/// What `str.strip()` takes off: Unicode white space, and the four separators that Rust does
/// not count as such.
pub fn is_space(c: char) -> bool {
    c.is_whitespace() || ('\u{1c}'..='\u{1f}').contains(&c)
}

/// Removes white space at both ends as Python's `str.strip()` does.
pub fn strip(text: &str) -> &str {
    text.trim_matches(is_space)
}

/// The first `count` characters, Python's `text[:count]`.
pub fn prefix(text: &str, count: usize) -> &str {
    text.char_indices()
        .nth(count)
        .map_or(text, |(end, _)| &text[..end])
}
