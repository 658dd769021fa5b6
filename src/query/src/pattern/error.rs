//! Why a pattern is refused, with the place in its text. Never a panic: patterns come from outside.

use std::fmt;

use thiserror::Error;

use crate::pattern::{
    MAX_CONDITIONS, MAX_LENGTH, MAX_LOOKBACK, MAX_NESTING, MAX_POSITIONS, MAX_REPEAT,
    compiled::ColumnKind,
};

/// A pattern or condition that cannot be used. The text ends with the line concerned and
/// a mark below it.
#[derive(Clone, PartialEq, Eq, Debug, Error)]
#[non_exhaustive]
pub enum PatternError {
    /// The text does not follow the grammar.
    #[error("expected {expected}, found {found} {location}")]
    Unexpected {
        /// What could stand here.
        expected: &'static str,
        /// What stands at the place instead, as the message quotes it.
        found: String,
        /// Where in the pattern the unexpected token stands.
        location: SourceLocation,
    },
    /// A text literal without its closing quote.
    #[error("this text has no closing quote; a quote inside is written twice {place}")]
    OpenQuote {
        /// Location of the opening quote in the pattern.
        place: SourceLocation,
    },
    /// A character that means nothing here.
    #[error("`{character}` means nothing here; text stands in quotes {place}")]
    StrangeCharacter {
        /// The character that the pattern language does not know.
        character: char,
        /// Location of the character in the pattern.
        place: SourceLocation,
    },
    /// A name that is no tool.
    #[error("unknown tool `{name}`{} {place}", hint(*nearest, "; the tool of another agent stands in quotes, \"...\""))]
    UnknownTool {
        /// The name as written in the pattern.
        name: String,
        /// What was probably meant.
        nearest: Option<&'static str>,
        /// Location of the name in the pattern.
        place: SourceLocation,
    },
    /// A column that a step does not have.
    #[error("a step has no column `{name}`{} {place}", hint(nearest.as_deref(), ""))]
    UnknownColumn {
        /// The column name as written in the pattern.
        name: String,
        /// What was probably meant.
        nearest: Option<String>,
        /// Location of the column name in the pattern.
        place: SourceLocation,
    },
    /// A column used as what it is not.
    #[error("column `{name}` holds {found}, but is used as {expected} {place}")]
    WrongKind {
        /// Name of the column as written in the pattern.
        name: String,
        /// What its use asks for.
        expected: ColumnKind,
        /// Kind of values that the column actually holds.
        found: ColumnKind,
        /// Location where the pattern uses the column.
        place: SourceLocation,
    },
    /// Two quantifiers in a row.
    #[error("a repetition of a repetition; put the first in parentheses, as in `(a+)?` {place}")]
    DoubleRepeat {
        /// Location of the second quantifier in the pattern.
        place: SourceLocation,
    },
    /// A count that repeats nothing, or whose bounds are in the wrong order.
    #[error(
        "`{{{min},{max}}}` repeats nothing; the second number is at least 1 and not below the first {place}"
    )]
    EmptyRepeat {
        /// Fewest repetitions, the first number of the braces.
        min: u32,
        /// Most repetitions, the second number or the first if it stands alone.
        max: u32,
        /// Location of the quantifier, from its opening brace to its closing one.
        place: SourceLocation,
    },
    /// A count over the limit.
    #[error("a repetition counts to {MAX_REPEAT} at most; `*` and `+` have no bound {place}")]
    LongRepeat {
        /// Location of the number that exceeds the limit.
        place: SourceLocation,
    },
    /// A lookback of no step or over the limit.
    #[error("`@` looks back 1 to {MAX_LOOKBACK} steps, as in `argument@-2` {place}")]
    FarLookback {
        /// Location of the lookback, from its `@` on.
        place: SourceLocation,
    },
    /// The pattern has more bytes than the limit allows.
    #[error(
        "the pattern has {length} bytes, {MAX_LENGTH} at most; match parts of it and combine them in SQL"
    )]
    TooLong {
        /// Bytes of the pattern.
        length: usize,
    },
    /// Too many parentheses within each other.
    #[error("nested more than {MAX_NESTING} deep; leave out parentheses {place}")]
    TooDeep {
        /// Where it becomes too deep.
        place: SourceLocation,
    },
    /// Too many different conditions.
    #[error(
        "more than {MAX_CONDITIONS} different conditions; match parts of the pattern and combine them in SQL {place}"
    )]
    TooManyConditions {
        /// The first that is too many.
        place: SourceLocation,
    },
    /// Too large once the repetitions are written out.
    #[error(
        "the pattern has {positions} steps when its repetitions are written out, {MAX_POSITIONS} at most; use `*` or `+`"
    )]
    TooLarge {
        /// Steps and anchors, written out.
        positions: usize,
    },
}

/// A place in a pattern; shown as its byte, its line and a mark below.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct SourceLocation {
    /// Byte of the pattern, from 0.
    pub byte: usize,
    line: String,
    /// Characters of the line before the mark, and under it.
    mark: (usize, usize),
}

impl SourceLocation {
    /// The place of `length` bytes from `byte` on; both are cut to whole
    /// characters inside the text.
    pub(crate) fn new(text: &str, byte: usize, length: usize) -> Self {
        let byte = text.floor_char_boundary(byte.min(text.len()));
        let start = text[..byte].rfind('\n').map_or(0, |newline| newline + 1);
        let end = text[byte..]
            .find('\n')
            .map_or(text.len(), |newline| byte + newline);
        let marked = text.floor_char_boundary((byte + length).min(end)).max(byte);
        // a long line is shown around the mark only
        let first = text[start..byte]
            .char_indices()
            .rev()
            .nth(CONTEXT - 1)
            .map_or(start, |(index, _)| start + index);
        let line = text[first..end]
            .chars()
            .take(2 * CONTEXT)
            .map(|c| if c.is_control() { ' ' } else { c })
            .collect();
        let under = text[byte..marked].chars().count().clamp(1, CONTEXT);
        Self {
            byte,
            line,
            mark: (text[first..byte].chars().count(), under),
        }
    }
}

impl fmt::Display for SourceLocation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (before, under) = self.mark;
        if self.line.trim().is_empty() {
            return write!(f, "(byte {})", self.byte);
        }
        write!(
            f,
            "(byte {})\n  {}\n  {}{}",
            self.byte,
            self.line,
            " ".repeat(before),
            "^".repeat(under)
        )
    }
}

/// Characters shown on either side of a mark.
const CONTEXT: usize = 60;

fn hint(nearest: Option<&str>, otherwise: &str) -> String {
    nearest.map_or_else(
        || otherwise.to_owned(),
        |name| format!(", did you mean `{name}`?"),
    )
}
