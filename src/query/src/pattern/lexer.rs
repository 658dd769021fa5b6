//! A pattern's text into tokens with their places. Knows no grammar.

use crate::pattern::{PatternError, SourceLocation};

/// A token and the bytes it came from.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Token {
    pub kind: TokenKind,
    pub start: usize,
    pub end: usize,
}

#[derive(Clone, PartialEq, Debug)]
pub(crate) enum TokenKind {
    /// A tool, a column or a keyword; also `_`.
    Word(String),
    /// Text in quotes, without them.
    Text(String),
    Number(f64),
    /// Punctuation or an operator, exactly as written in the pattern.
    Sign(&'static str),
    End,
}

/// Longer ones first: the first that fits is taken.
const SIGNS: &[&str] = &[
    "...", "..", "<=", ">=", "<>", "!=", "@", "<", ">", "=", "!", "(", ")", "[", "]", "{", "}",
    "|", "*", "+", "?", "^", "$", ",", "-",
];

/// All tokens, the last one [`TokenKind::End`].
pub(crate) fn tokens(text: &str) -> Result<Vec<Token>, PatternError> {
    let mut tokens = Vec::new();
    let mut at = 0;
    while let Some(first) = text[at..].chars().next() {
        if first.is_whitespace() {
            at += first.len_utf8();
            continue;
        }
        let (kind, length) = token(text, at, first)?;
        tokens.push(Token {
            kind,
            start: at,
            end: at + length,
        });
        at += length;
    }
    tokens.push(Token {
        kind: TokenKind::End,
        start: text.len(),
        end: text.len(),
    });
    Ok(tokens)
}

fn token(text: &str, at: usize, first: char) -> Result<(TokenKind, usize), PatternError> {
    let rest = &text[at..];
    let while_ = |fits: fn(char) -> bool| rest.find(|c| !fits(c)).unwrap_or(rest.len());
    if first == '\'' || first == '"' {
        return quoted(text, at, first);
    }
    if first.is_ascii_alphabetic() || first == '_' {
        let length = while_(|c| c.is_ascii_alphanumeric() || c == '_');
        return Ok((TokenKind::Word(rest[..length].to_owned()), length));
    }
    if first.is_ascii_digit() {
        let length = number(rest);
        if let Ok(number) = rest[..length].parse() {
            return Ok((TokenKind::Number(number), length));
        }
    }
    match SIGNS.iter().find(|sign| rest.starts_with(**sign)) {
        Some(sign) => Ok((TokenKind::Sign(sign), sign.len())),
        None => Err(PatternError::StrangeCharacter {
            character: first,
            place: SourceLocation::new(text, at, first.len_utf8()),
        }),
    }
}

/// Length of digits, perhaps with a fraction. Not of `1..`: there the dots mean "later".
fn number(rest: &str) -> usize {
    let digits = |from: usize| {
        rest[from..]
            .find(|c: char| !c.is_ascii_digit())
            .map_or(rest.len(), |length| from + length)
    };
    let whole = digits(0);
    let fraction = rest[whole..]
        .starts_with('.')
        .then(|| digits(whole + 1))
        .filter(|end| *end > whole + 1);
    fraction.unwrap_or(whole)
}

fn quoted(text: &str, at: usize, quote: char) -> Result<(TokenKind, usize), PatternError> {
    let mut content = String::new();
    let mut chars = text[at + 1..].char_indices().peekable();
    while let Some((index, c)) = chars.next() {
        if c != quote {
            content.push(c);
        } else if chars.next_if(|(_, next)| *next == quote).is_some() {
            content.push(quote);
        } else {
            return Ok((TokenKind::Text(content), index + 2));
        }
    }
    Err(PatternError::OpenQuote {
        place: SourceLocation::new(text, at, 1),
    })
}
