//! Tokens into a tree of steps and their conditions, within the limits. Refuses with
//! a place; never panics.

use crate::pattern::{
    Condition, Literal, MAX_CONDITIONS, MAX_LENGTH, MAX_LOOKBACK, MAX_NESTING, MAX_REPEAT, Op,
    Operand, PatternError, SourceLocation, StepColumn,
    compiled::ColumnKind,
    lexer::{Token, TokenKind, tokens},
    tools::{is_tool, nearest_tool},
};

/// A pattern as written.
#[derive(Clone, PartialEq, Debug)]
pub(crate) enum Node {
    /// One step that fits a condition, by its index; `None`: any step.
    Step(Option<usize>),
    /// `^`: matches at the beginning of the episode.
    Begin,
    /// `$`: matches at the end of the episode.
    End,
    /// One after the other.
    Sequence(Vec<Node>),
    /// Alternatives, written `a | b`: any one of them may match.
    Either(Vec<Node>),
    /// At least `min` times, at most `max` times (at least 1).
    Repeat {
        node: Box<Node>,
        min: u32,
        max: Option<u32>,
    },
}

/// A parsed pattern with its conditions and the columns that it uses.
pub(crate) struct Parsed {
    pub node: Node,
    /// Without repetition, in the order of their first use.
    pub conditions: Vec<Condition>,
    pub uses: Vec<ColumnUse>,
}

/// A column where a pattern uses it.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct ColumnUse {
    pub name: String,
    pub expected: Expected,
    pub start: usize,
    pub end: usize,
}

/// What the use asks of a column.
#[derive(Clone, PartialEq, Debug)]
pub(crate) enum Expected {
    Anything,
    Kind(ColumnKind),
    /// What that other column holds.
    SameAs(String),
}

/// Parses a whole pattern.
pub(crate) fn pattern(text: &str) -> Result<Parsed, PatternError> {
    let mut parser = Parser::new(text)?;
    let node = parser.either()?;
    parser.end("a step, `|`, a repetition or the end of the pattern")?;
    Ok(Parsed {
        node,
        conditions: parser.conditions,
        uses: parser.uses,
    })
}

/// Parses what one step may be.
pub(crate) fn condition(text: &str) -> Result<(Condition, Vec<ColumnUse>), PatternError> {
    let mut parser = Parser::new(text)?;
    let condition = parser.step_set()?;
    parser.end("the end: this describes one step only")?;
    Ok((condition, parser.uses))
}

struct Parser<'a> {
    text: &'a str,
    tokens: Vec<Token>,
    at: usize,
    depth: usize,
    conditions: Vec<Condition>,
    uses: Vec<ColumnUse>,
}

impl<'a> Parser<'a> {
    fn new(text: &'a str) -> Result<Self, PatternError> {
        if text.len() > MAX_LENGTH {
            return Err(PatternError::TooLong { length: text.len() });
        }
        Ok(Self {
            text,
            tokens: tokens(text)?,
            at: 0,
            depth: 0,
            conditions: Vec::new(),
            uses: Vec::new(),
        })
    }

    // ---- steps in order ----

    fn either(&mut self) -> Result<Node, PatternError> {
        let mut nodes = vec![self.sequence()?];
        while self.take("|") {
            nodes.push(self.sequence()?);
        }
        Ok(single(nodes, Node::Either))
    }

    fn sequence(&mut self) -> Result<Node, PatternError> {
        let mut nodes = vec![self.item()?];
        while self.take(">") || self.starts_item() {
            nodes.push(self.item()?);
        }
        Ok(single(nodes, Node::Sequence))
    }

    fn starts_item(&self) -> bool {
        match self.kind() {
            TokenKind::Word(_) | TokenKind::Text(_) => true,
            TokenKind::Sign(sign) => ["^", "$", "..", "...", "(", "[", "!"].contains(sign),
            _ => false,
        }
    }

    fn item(&mut self) -> Result<Node, PatternError> {
        if self.take("^") {
            return Ok(Node::Begin);
        }
        if self.take("$") {
            return Ok(Node::End);
        }
        if self.take("..") || self.take("...") {
            return Ok(Node::Repeat {
                node: Box::new(Node::Step(None)),
                min: 0,
                max: None,
            });
        }
        let node = if self.take("(") {
            self.deeper()?;
            let node = self.either()?;
            self.expect(")", "`)`, a step, `|` or a repetition")?;
            self.depth -= 1;
            node
        } else {
            let start = self.at;
            let condition = self.step_set()?;
            self.step(condition, start)?
        };
        let Some((min, max)) = self.quantifier()? else {
            return Ok(node);
        };
        let again = self.at;
        if self.quantifier()?.is_some() {
            return Err(PatternError::DoubleRepeat {
                place: self.place_of(again),
            });
        }
        Ok(Node::Repeat {
            node: Box::new(node),
            min,
            max,
        })
    }

    fn step(&mut self, condition: Condition, start: usize) -> Result<Node, PatternError> {
        if condition == Condition::Any {
            return Ok(Node::Step(None));
        }
        let known = self.conditions.iter().position(|known| *known == condition);
        let index = known.unwrap_or(self.conditions.len());
        if index == self.conditions.len() {
            if index == MAX_CONDITIONS {
                return Err(PatternError::TooManyConditions {
                    place: self.place_of(start),
                });
            }
            self.conditions.push(condition);
        }
        Ok(Node::Step(Some(index)))
    }

    fn quantifier(&mut self) -> Result<Option<(u32, Option<u32>)>, PatternError> {
        let start = self.at;
        if self.take("*") {
            return Ok(Some((0, None)));
        }
        if self.take("+") {
            return Ok(Some((1, None)));
        }
        if self.take("?") {
            return Ok(Some((0, Some(1))));
        }
        if !self.take("{") {
            return Ok(None);
        }
        let min = self.count()?;
        let max = match self.take(",") {
            false => Some(min),
            true if *self.kind() == TokenKind::Sign("}") => None,
            true => Some(self.count()?),
        };
        self.expect("}", "`}`, as in `{2}`, `{2,}` or `{2,5}`")?;
        match max {
            Some(max) if max == 0 || max < min => Err(PatternError::EmptyRepeat {
                min,
                max,
                place: self.place_between(start, self.at),
            }),
            max => Ok(Some((min, max))),
        }
    }

    fn count(&mut self) -> Result<u32, PatternError> {
        match *self.kind() {
            TokenKind::Number(number) if number > f64::from(MAX_REPEAT) => {
                Err(PatternError::LongRepeat {
                    place: self.place_of(self.at),
                })
            }
            TokenKind::Number(number) if number.fract() == 0.0 => {
                self.at += 1;
                Ok(number as u32)
            }
            _ => Err(self.unexpected("a whole number, as in `{2}`, `{2,}` or `{2,5}`")),
        }
    }

    // ---- what one step may be ----

    fn step_set(&mut self) -> Result<Condition, PatternError> {
        if self.take("!") {
            self.deeper()?;
            let fits = self.step_set()?;
            self.depth -= 1;
            return Ok(Condition::Not(Box::new(Condition::IsTrue(Box::new(fits)))));
        }
        if !self.take("(") {
            return self.atom();
        }
        self.deeper()?;
        let mut parts = vec![self.step_set()?];
        while self.take("|") {
            parts.push(self.step_set()?);
        }
        self.expect(")", "`|` or `)`: this describes one step only")?;
        self.depth -= 1;
        Ok(single(parts, Condition::Or))
    }

    fn atom(&mut self) -> Result<Condition, PatternError> {
        // A name in quotes is that of any agent's tool.
        let (tool, quoted) = match self.kind() {
            TokenKind::Word(word) => (Some(word.clone()), false),
            TokenKind::Text(name) => (Some(name.clone()), true),
            TokenKind::Sign("[") => (None, false),
            _ => return Err(self.unexpected("a step: a tool, `_`, `!`, `[` or `(`")),
        };
        let mut parts = Vec::new();
        if let Some(name) = tool {
            let place = self.at;
            self.at += 1;
            if quoted || name != "_" && name != "any" {
                if !quoted && !is_tool(&name) {
                    return Err(PatternError::UnknownTool {
                        nearest: nearest_tool(&name),
                        name,
                        place: self.place_of(place),
                    });
                }
                let left = self.used("tool", Expected::Kind(ColumnKind::Text), place, 0);
                parts.push(Condition::Compare {
                    left,
                    op: Op::Eq,
                    right: Operand::Literal(Literal::Text(name)),
                });
            }
        }
        if self.take("[") {
            parts.push(self.or()?);
            self.expect("]", "`]`, `and` or `or`")?;
        }
        Ok(if parts.is_empty() {
            Condition::Any
        } else {
            single(parts, Condition::And)
        })
    }

    fn or(&mut self) -> Result<Condition, PatternError> {
        let mut parts = vec![self.and()?];
        while self.keyword("or") {
            parts.push(self.and()?);
        }
        Ok(single(parts, Condition::Or))
    }

    fn and(&mut self) -> Result<Condition, PatternError> {
        let mut parts = vec![self.not()?];
        while self.keyword("and") {
            parts.push(self.not()?);
        }
        Ok(single(parts, Condition::And))
    }

    fn not(&mut self) -> Result<Condition, PatternError> {
        if !self.keyword("not") {
            return self.test();
        }
        self.deeper()?;
        let inner = self.not()?;
        self.depth -= 1;
        Ok(Condition::Not(Box::new(inner)))
    }

    /// A condition in parentheses, a word, or a column with what is asked of it; then
    /// perhaps `is [not] true`.
    fn test(&mut self) -> Result<Condition, PatternError> {
        let mut condition = if self.take("(") {
            self.deeper()?;
            let inner = self.or()?;
            self.expect(")", "`)`, `and` or `or`")?;
            self.depth -= 1;
            inner
        } else {
            self.word_test()?
        };
        if self.keyword("is") {
            let negated = self.keyword("not");
            if !self.keyword("true") {
                return Err(
                    self.unexpected("`true`, `not true`, or after a column `null`, `not null`")
                );
            }
            condition = not_if(negated, Condition::IsTrue(Box::new(condition)));
        }
        Ok(condition)
    }

    fn word_test(&mut self) -> Result<Condition, PatternError> {
        let start = self.at;
        let name = match self.kind() {
            TokenKind::Word(word) if !RESERVED.contains(&word.to_ascii_lowercase().as_str()) => {
                word.clone()
            }
            _ => {
                return Err(
                    self.unexpected("a condition: a column, `ok`, `failed`, `any`, `not` or `(`")
                );
            }
        };
        self.at += 1;
        match name.as_str() {
            "any" => return Ok(Condition::Any),
            "ok" | "failed" => {
                let error = self.used("error_code", Expected::Anything, start, 0);
                return Ok(not_if(name == "failed", Condition::IsNull(error)));
            }
            _ => {}
        }
        let back = self.lookback()?;
        let column = |parser: &mut Self, expected| parser.used(&name, expected, start, back);
        if let Some(op) = self.operator() {
            let right = self.operand()?;
            let expected = match &right {
                Operand::Literal(literal) => Expected::Kind(kind(literal)),
                Operand::Column(other) => Expected::SameAs(other.name.clone()),
            };
            return Ok(Condition::Compare {
                left: column(self, expected),
                op,
                right,
            });
        }
        if self.at_keywords("is", "null") {
            let negated = self.take_until("null");
            return Ok(not_if(
                negated,
                Condition::IsNull(column(self, Expected::Anything)),
            ));
        }
        let negated = self.keyword("not");
        if self.keyword("in") {
            let values = self.list()?;
            let expected = Expected::Kind(kind(&values[0]));
            return Ok(not_if(
                negated,
                Condition::InList {
                    column: column(self, expected),
                    values,
                },
            ));
        }
        if self.keyword("like") {
            let TokenKind::Text(pattern) = self.kind().clone() else {
                return Err(self.unexpected("a text in quotes"));
            };
            self.at += 1;
            let column = column(self, Expected::Kind(ColumnKind::Text));
            return Ok(not_if(negated, Condition::Like { column, pattern }));
        }
        if negated {
            return Err(self.unexpected("`in` or `like`"));
        }
        Ok(Condition::Flag(column(
            self,
            Expected::Kind(ColumnKind::Flag),
        )))
    }

    fn lookback(&mut self) -> Result<u32, PatternError> {
        let start = self.at;
        if !self.take("@") {
            return Ok(0);
        }
        let minus = self.take("-");
        match *self.kind() {
            TokenKind::Number(back)
                if minus
                    && back.fract() == 0.0
                    && (1.0..=f64::from(MAX_LOOKBACK)).contains(&back) =>
            {
                self.at += 1;
                Ok(back as u32)
            }
            _ => Err(PatternError::FarLookback {
                place: self.place_between(start, self.at + 1),
            }),
        }
    }

    fn operator(&mut self) -> Option<Op> {
        let TokenKind::Sign(sign) = self.kind() else {
            return None;
        };
        let op = match *sign {
            "=" => Op::Eq,
            "<>" | "!=" => Op::NotEq,
            "<" => Op::Lt,
            "<=" => Op::LtEq,
            ">" => Op::Gt,
            ">=" => Op::GtEq,
            _ => return None,
        };
        self.at += 1;
        Some(op)
    }

    fn operand(&mut self) -> Result<Operand, PatternError> {
        if let Some(literal) = self.literal() {
            return Ok(Operand::Literal(literal));
        }
        let start = self.at;
        let TokenKind::Word(name) = self.kind().clone() else {
            return Err(self.unexpected("a text in quotes, a number, `true`, `false` or a column"));
        };
        if RESERVED.contains(&name.to_ascii_lowercase().as_str()) {
            return Err(self.unexpected("a text in quotes, a number, `true`, `false` or a column (`is null` tests for null)"));
        }
        self.at += 1;
        let back = self.lookback()?;
        Ok(Operand::Column(self.used(
            &name,
            Expected::Anything,
            start,
            back,
        )))
    }

    fn literal(&mut self) -> Option<Literal> {
        let start = self.at;
        let minus = self.take("-");
        let literal = match self.kind().clone() {
            TokenKind::Number(number) => Literal::Number(if minus { -number } else { number }),
            TokenKind::Text(text) if !minus => Literal::Text(text),
            TokenKind::Word(word) if !minus && word.eq_ignore_ascii_case("true") => {
                Literal::Flag(true)
            }
            TokenKind::Word(word) if !minus && word.eq_ignore_ascii_case("false") => {
                Literal::Flag(false)
            }
            _ => {
                self.at = start;
                return None;
            }
        };
        self.at += 1;
        Some(literal)
    }

    fn list(&mut self) -> Result<Vec<Literal>, PatternError> {
        const EXPECTED: &str = "a text in quotes, a number, `true` or `false`, all of one kind";
        self.expect("(", "`(` and the values, as in `tool in ('open', 'close')`")?;
        let mut values: Vec<Literal> = Vec::new();
        loop {
            let start = self.at;
            match self.literal() {
                Some(value)
                    if values
                        .first()
                        .is_none_or(|first| kind(first) == kind(&value)) =>
                {
                    values.push(value)
                }
                _ => {
                    self.at = start;
                    return Err(self.unexpected(EXPECTED));
                }
            }
            if !self.take(",") {
                self.expect(")", "`,` or `)`")?;
                return Ok(values);
            }
        }
    }

    // ---- tokens ----

    fn kind(&self) -> &TokenKind {
        &self.tokens[self.at].kind
    }

    fn take(&mut self, sign: &'static str) -> bool {
        let found = *self.kind() == TokenKind::Sign(sign);
        self.at += usize::from(found);
        found
    }

    fn expect(&mut self, sign: &'static str, expected: &'static str) -> Result<(), PatternError> {
        if self.take(sign) {
            Ok(())
        } else {
            Err(self.unexpected(expected))
        }
    }

    fn end(&self, expected: &'static str) -> Result<(), PatternError> {
        if *self.kind() == TokenKind::End {
            Ok(())
        } else {
            Err(self.unexpected(expected))
        }
    }

    fn is_keyword(&self, at: usize, keyword: &str) -> bool {
        matches!(self.tokens.get(at), Some(Token { kind: TokenKind::Word(word), .. }) if word.eq_ignore_ascii_case(keyword))
    }

    fn keyword(&mut self, keyword: &str) -> bool {
        let found = self.is_keyword(self.at, keyword);
        self.at += usize::from(found);
        found
    }

    /// Whether `first last` or `first not last` stands here.
    fn at_keywords(&self, first: &str, last: &str) -> bool {
        let next = self.at + 1;
        let next = next + usize::from(self.is_keyword(next, "not"));
        self.is_keyword(self.at, first) && self.is_keyword(next, last)
    }

    /// Takes what [`Self::at_keywords`] saw; whether there was a `not`.
    fn take_until(&mut self, last: &str) -> bool {
        self.at += 1;
        let negated = self.keyword("not");
        let found = self.keyword(last);
        assert!(found, "`{last}` was seen before");
        negated
    }

    fn used(&mut self, name: &str, expected: Expected, token: usize, back: u32) -> StepColumn {
        let name = if name == "error" { "error_code" } else { name };
        let Token { start, end, .. } = self.tokens[token];
        self.uses.push(ColumnUse {
            name: name.to_owned(),
            expected,
            start,
            end,
        });
        StepColumn {
            name: name.to_owned(),
            back,
        }
    }

    fn deeper(&mut self) -> Result<(), PatternError> {
        self.depth += 1;
        if self.depth > MAX_NESTING {
            return Err(PatternError::TooDeep {
                place: self.place_of(self.at - 1),
            });
        }
        Ok(())
    }

    fn unexpected(&self, expected: &'static str) -> PatternError {
        let Token { kind, start, end } = &self.tokens[self.at];
        let found = match kind {
            TokenKind::End => "the end".to_owned(),
            TokenKind::Text(_) => "a text".to_owned(),
            _ => format!("`{}`", &self.text[*start..*end]),
        };
        PatternError::Unexpected {
            expected,
            found,
            location: self.place_of(self.at),
        }
    }

    fn place_of(&self, token: usize) -> SourceLocation {
        self.place_between(token, token + 1)
    }

    /// The place of the tokens from `first` up to but without `last`.
    fn place_between(&self, first: usize, last: usize) -> SourceLocation {
        let start = self.tokens[first].start;
        let end = self.tokens[last.min(self.tokens.len()) - 1].end;
        SourceLocation::new(self.text, start, end - start)
    }
}

/// Words that are no column.
const RESERVED: &[&str] = &[
    "and", "or", "not", "in", "like", "is", "null", "true", "false",
];

fn single<T>(mut parts: Vec<T>, several: fn(Vec<T>) -> T) -> T {
    if parts.len() == 1 {
        parts.swap_remove(0)
    } else {
        several(parts)
    }
}

fn not_if(negated: bool, condition: Condition) -> Condition {
    if negated {
        Condition::Not(Box::new(condition))
    } else {
        condition
    }
}

fn kind(literal: &Literal) -> ColumnKind {
    match literal {
        Literal::Text(_) => ColumnKind::Text,
        Literal::Number(_) => ColumnKind::Number,
        Literal::Flag(_) => ColumnKind::Flag,
    }
}
