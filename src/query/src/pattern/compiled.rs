//! A parsed pattern: its conditions, the check against the columns there are, and its automaton.
//! Never matches itself: that is [`Matcher`].

use std::{fmt, sync::Arc};

use crate::pattern::{
    Condition, Matcher, PatternError, SourceLocation, StepRow,
    automaton::Automaton,
    parser::{self, ColumnUse, Expected},
    tools::nearest,
};

/// A pattern over the steps of an episode; see the crate's page for the language. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Pattern(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    text: String,
    conditions: Vec<Condition>,
    uses: Vec<ColumnUse>,
    automaton: Arc<Automaton>,
}

/// What a column holds.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ColumnKind {
    /// A column of text values, such as `tool`.
    Text,
    /// A column of numbers, either integers or floats.
    Number,
    /// A column of booleans, usable as a condition by itself.
    Flag,
}

impl fmt::Display for ColumnKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Text => "text",
            Self::Number => "a number",
            Self::Flag => "a bool",
        })
    }
}

impl Pattern {
    /// Parses a pattern.
    ///
    /// # Errors
    /// What is wrong and where, or the limit that it exceeds.
    pub fn parse(text: &str) -> Result<Self, PatternError> {
        let parsed = parser::pattern(text)?;
        let automaton = Arc::new(Automaton::new(&parsed.node, parsed.conditions.len())?);
        let (conditions, uses) = (parsed.conditions, parsed.uses);
        Ok(Self(Arc::new(Inner {
            text: text.to_owned(),
            conditions,
            uses,
            automaton,
        })))
    }

    /// Compares the columns that the pattern uses with those there are: `(name, what it holds)`.
    ///
    /// # Errors
    /// The first column that is not there or holds something else than its use asks for.
    pub fn check(&self, columns: &[(&str, ColumnKind)]) -> Result<(), PatternError> {
        check(&self.0.text, &self.0.uses, columns)
    }

    /// The different conditions of the pattern, at most
    /// [`MAX_CONDITIONS`](crate::pattern::MAX_CONDITIONS): bit `i` of a step's mask says whether
    /// the step fits the `i`-th. None of them is [`Condition::Any`] by itself.
    pub fn conditions(&self) -> &[Condition] {
        &self.0.conditions
    }

    /// The masks of an episode of plain rows.
    pub fn masks<R: StepRow>(&self, episode: &[R]) -> Vec<u64> {
        let mask = |step| {
            let bits = self.conditions().iter().enumerate();
            bits.fold(0, |mask, (bit, condition)| {
                mask | u64::from(condition.fits(episode, step)) << bit
            })
        };
        (0..episode.len()).map(mask).collect()
    }

    /// A matcher with an empty cache: one a thread, for all its episodes.
    pub fn matcher(&self) -> Matcher {
        Matcher::new(Arc::clone(&self.0.automaton))
    }
}

impl Condition {
    /// [`Condition::parse`], then the check of [`Pattern::check`].
    ///
    /// # Errors
    /// As those two.
    pub fn parse_for(text: &str, columns: &[(&str, ColumnKind)]) -> Result<Self, PatternError> {
        let (condition, uses) = parser::condition(text)?;
        check(text, &uses, columns)?;
        Ok(condition)
    }
}

/// The pattern as it was written.
impl fmt::Display for Pattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.text)
    }
}

fn check(
    text: &str,
    uses: &[ColumnUse],
    columns: &[(&str, ColumnKind)],
) -> Result<(), PatternError> {
    let find = |name: &str| {
        columns
            .iter()
            .find(|(known, _)| *known == name)
            .map(|(_, kind)| *kind)
    };
    let mut sorted: Vec<_> = uses.iter().collect();
    sorted.sort_by_key(|column| column.start);
    for ColumnUse {
        name,
        expected,
        start,
        end,
    } in sorted
    {
        let place = || SourceLocation::new(text, *start, end - start);
        let Some(found) = find(name) else {
            let nearest = nearest(name, columns.iter().map(|(known, _)| *known)).map(str::to_owned);
            return Err(PatternError::UnknownColumn {
                name: name.clone(),
                nearest,
                place: place(),
            });
        };
        let expected = match expected {
            Expected::Anything => continue,
            Expected::Kind(kind) => *kind,
            // an unknown one is found by its own use
            Expected::SameAs(other) => find(other).unwrap_or(found),
        };
        if expected != found {
            return Err(PatternError::WrongKind {
                name: name.clone(),
                expected,
                found,
                place: place(),
            });
        }
    }
    Ok(())
}
