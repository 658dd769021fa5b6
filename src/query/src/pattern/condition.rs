//! What a step can be asked: a typed tree that a columnar engine evaluates over whole columns, and
//! its meaning on plain rows. Three-valued logic, as in SQL; never reads a table.

use std::{cmp::Ordering, fmt};

use crate::pattern::{PatternError, parser};

/// A predicate over one step and the few before it. A step fits where it is true (not
/// where it is null).
#[derive(Clone, PartialEq, Debug)]
pub enum Condition {
    /// Always true: `_`, which every step fits.
    Any,
    /// A column of bools by itself: `goal_object`.
    Flag(StepColumn),
    /// `left op right`; null if either side is.
    Compare {
        /// The column on the left side of the comparison.
        left: StepColumn,
        /// How to compare. Text compares by its bytes.
        op: Op,
        /// Right side, of the same kind.
        right: Operand,
    },
    /// `column in (values)`; null if the column is. Never empty; values of one kind.
    InList {
        /// The column whose value the list may contain.
        column: StepColumn,
        /// What it may be.
        values: Vec<Literal>,
    },
    /// `column like pattern`: `%` stands for any text, `_` for one character, `\`
    /// takes the next literally.
    Like {
        /// The text column that is matched with the pattern.
        column: StepColumn,
        /// The pattern as written, with its wildcards and escapes.
        pattern: String,
    },
    /// `column is null`; never null itself.
    IsNull(StepColumn),
    /// True if all of the conditions are true, as SQL's `and`.
    And(Vec<Condition>),
    /// True if any of the conditions is true, as SQL's `or`.
    Or(Vec<Condition>),
    /// The opposite; null stays null.
    Not(Box<Condition>),
    /// `is true`: true, not null. Never null itself.
    IsTrue(Box<Condition>),
}

/// A column of a step, or of one before it.
#[derive(Clone, PartialEq, Eq, Hash, Debug)]
pub struct StepColumn {
    /// Name of the column.
    pub name: String,
    /// Steps back in the same episode, 0 for the step itself; null before the episode's begin.
    pub back: u32,
}

/// The right side of a comparison.
#[derive(Clone, PartialEq, Debug)]
pub enum Operand {
    /// A constant that the left column is compared with.
    Literal(Literal),
    /// Another column that the left column is compared with.
    Column(StepColumn),
}

/// A constant in a condition: a text, a number or a bool.
#[derive(Clone, PartialEq, Debug)]
pub enum Literal {
    /// A text, written in quotes in a condition.
    Text(String),
    /// Integers too; compared as `f64`.
    Number(f64),
    /// A boolean constant, written `true` or `false`.
    Flag(bool),
}

/// How two values are compared.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Op {
    /// Equal to the right side, written `=`.
    Eq,
    /// `<>`, also written `!=`
    NotEq,
    /// Less than the right side, written `<`.
    Lt,
    /// At most the right side, written `<=`.
    LtEq,
    /// Greater than the right side, written `>`.
    Gt,
    /// At least the right side, written `>=`.
    GtEq,
}

/// A value of a row.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Value<'a> {
    /// No value, the same as SQL's null.
    Null,
    /// A text value, compared by its bytes.
    Text(&'a str),
    /// A number, whether integer or not, as `f64`.
    Number(f64),
    /// A boolean value, `true` or `false`.
    Flag(bool),
}

/// A step as a plain row, for tests and small uses.
pub trait StepRow {
    /// The column's value; [`Value::Null`] for a column it does not have.
    fn value(&self, column: &str) -> Value<'_>;
}

impl Condition {
    /// Parses what one step of a pattern may be: `pick[ok]`, `!ask`,
    /// `[reward < 0]`, `(open|close)`.
    ///
    /// # Errors
    /// As [`Pattern::parse`](crate::pattern::Pattern::parse).
    pub fn parse(text: &str) -> Result<Self, PatternError> {
        parser::condition(text).map(|(condition, _)| condition)
    }

    /// Whether step `at` of `episode` fits.
    ///
    /// # Panics
    /// If the episode has no step `at`.
    pub fn fits<R: StepRow>(&self, episode: &[R], at: usize) -> bool {
        assert!(
            at < episode.len(),
            "step {at} of an episode of {}",
            episode.len()
        );
        self.truth(episode, at) == Some(true)
    }

    fn truth<R: StepRow>(&self, episode: &[R], at: usize) -> Option<bool> {
        let value = |column: &StepColumn| -> Value<'_> {
            at.checked_sub(column.back as usize)
                .map_or(Value::Null, |step| episode[step].value(&column.name))
        };
        match self {
            Self::Any => Some(true),
            Self::Flag(column) => match value(column) {
                Value::Flag(flag) => Some(flag),
                _ => None,
            },
            Self::Compare { left, op, right } => {
                let right = match right {
                    Operand::Literal(literal) => literal.value(),
                    Operand::Column(column) => value(column),
                };
                compare(value(left), right).map(|ordering| op.holds(ordering))
            }
            Self::InList { column, values } => {
                let value = value(column);
                any(values
                    .iter()
                    .map(|known| compare(value, known.value()).map(Ordering::is_eq)))
            }
            Self::Like { column, pattern } => match value(column) {
                Value::Text(text) => Some(like(text, pattern)),
                _ => None,
            },
            Self::IsNull(column) => Some(value(column) == Value::Null),
            Self::And(parts) => any(parts
                .iter()
                .map(|part| part.truth(episode, at).map(|truth| !truth)))
            .map(|truth| !truth),
            Self::Or(parts) => any(parts.iter().map(|part| part.truth(episode, at))),
            Self::Not(part) => part.truth(episode, at).map(|truth| !truth),
            Self::IsTrue(part) => Some(part.truth(episode, at) == Some(true)),
        }
    }
}

impl Literal {
    fn value(&self) -> Value<'_> {
        match self {
            Self::Text(text) => Value::Text(text),
            Self::Number(number) => Value::Number(*number),
            Self::Flag(flag) => Value::Flag(*flag),
        }
    }
}

impl Op {
    /// Whether `left op right` holds, given how left stands to right.
    pub fn holds(self, ordering: Ordering) -> bool {
        match self {
            Self::Eq => ordering.is_eq(),
            Self::NotEq => ordering.is_ne(),
            Self::Lt => ordering.is_lt(),
            Self::LtEq => ordering.is_le(),
            Self::Gt => ordering.is_gt(),
            Self::GtEq => ordering.is_ge(),
        }
    }
}

/// As written inside a bracket; parsing it gives the same condition.
impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let join = |f: &mut fmt::Formatter<'_>, parts: &[Condition], word: &str| {
            for (index, part) in parts.iter().enumerate() {
                let between = if index > 0 { word } else { "" };
                write!(f, "{between}({part})")?;
            }
            Ok(())
        };
        match self {
            Self::Any => f.write_str("any"),
            Self::Flag(column) => write!(f, "{column}"),
            Self::Compare {
                left,
                op,
                right: Operand::Literal(right),
            } => write!(f, "{left} {op} {right}"),
            Self::Compare {
                left,
                op,
                right: Operand::Column(right),
            } => write!(f, "{left} {op} {right}"),
            Self::InList { column, values } => {
                let values: Vec<_> = values.iter().map(ToString::to_string).collect();
                write!(f, "{column} in ({})", values.join(", "))
            }
            Self::Like { column, pattern } => {
                write!(f, "{column} like {}", Literal::Text(pattern.clone()))
            }
            Self::IsNull(column) => write!(f, "{column} is null"),
            Self::And(parts) => join(f, parts, " and "),
            Self::Or(parts) => join(f, parts, " or "),
            Self::Not(part) => write!(f, "not ({part})"),
            Self::IsTrue(part) => write!(f, "({part}) is true"),
        }
    }
}

impl fmt::Display for StepColumn {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.back {
            0 => f.write_str(&self.name),
            back => write!(f, "{}@-{back}", self.name),
        }
    }
}

impl fmt::Display for Literal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Text(text) => write!(f, "'{}'", text.replace('\'', "''")),
            Self::Number(number) => write!(f, "{number}"),
            Self::Flag(flag) => write!(f, "{flag}"),
        }
    }
}

impl fmt::Display for Op {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Eq => "=",
            Self::NotEq => "<>",
            Self::Lt => "<",
            Self::LtEq => "<=",
            Self::Gt => ">",
            Self::GtEq => ">=",
        })
    }
}

/// Kleene's three-valued "or"; `None` if no truth is `Some(true)` and one is unknown.
fn any(truths: impl Iterator<Item = Option<bool>>) -> Option<bool> {
    let mut known = true;
    for truth in truths {
        match truth {
            Some(true) => return Some(true),
            Some(false) => {}
            None => known = false,
        }
    }
    known.then_some(false)
}

/// `None` where SQL says null; values of different kinds do not compare.
fn compare(left: Value<'_>, right: Value<'_>) -> Option<Ordering> {
    match (left, right) {
        (Value::Text(left), Value::Text(right)) => Some(left.cmp(right)),
        (Value::Number(left), Value::Number(right)) => left.partial_cmp(&right),
        (Value::Flag(left), Value::Flag(right)) => Some(left.cmp(&right)),
        _ => None,
    }
}

/// SQL's LIKE: on a mismatch only the last `%` takes one more character, so at most
/// length times length steps.
fn like(text: &str, pattern: &str) -> bool {
    enum Piece {
        Many,
        One,
        Exactly(char),
    }
    let mut pieces = Vec::new();
    let mut chars = pattern.chars();
    while let Some(c) = chars.next() {
        pieces.push(match c {
            '%' => Piece::Many,
            '_' => Piece::One,
            '\\' => Piece::Exactly(chars.next().unwrap_or('\\')),
            c => Piece::Exactly(c),
        });
    }
    let text: Vec<char> = text.chars().collect();
    let (mut at, mut piece) = (0, 0);
    // the piece after the last `%`, and where the text it took ends
    let mut retry: Option<(usize, usize)> = None;
    while at < text.len() {
        match (pieces.get(piece), &mut retry) {
            (Some(Piece::Many), _) => {
                piece += 1;
                retry = Some((piece, at));
            }
            (Some(Piece::One), _) => (at, piece) = (at + 1, piece + 1),
            (Some(Piece::Exactly(c)), _) if *c == text[at] => (at, piece) = (at + 1, piece + 1),
            (_, Some((after, taken))) => {
                *taken += 1;
                (at, piece) = (*taken, *after);
            }
            (_, None) => return false,
        }
    }
    pieces[piece..]
        .iter()
        .all(|piece| matches!(piece, Piece::Many))
}
