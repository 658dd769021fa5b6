//! What was asked or said, and why something failed: words compared with words. Never
//! looks at the world.

use std::{collections::BTreeSet, ops::Range};

use reel_world::{ErrorCode, language};

use crate::{
    grammar::{Class, REASONS, class},
    lex::{Kind, Token},
    names::Names,
};

/// The words of a question, an answer or a call.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub(crate) struct Content {
    /// The quotation in it, if there is one.
    pub(crate) quote: Option<String>,
    /// Its words that say something, in their order.
    pub(crate) words: Vec<String>,
}

/// How words agree with a text.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Agreement {
    Same,
    Unclear,
    Other,
}

impl Content {
    pub(crate) fn of(tokens: &[Token]) -> Self {
        let quote = tokens.iter().find(|token| token.kind == Kind::Quote);
        let quote = quote.map(|token| {
            token
                .text
                .trim_matches(|letter: char| !letter.is_alphanumeric())
                .to_owned()
        });
        let says = |token: &&Token| match token.kind {
            Kind::Word => matches!(class(token.word()), Class::Noun | Class::Verb | Class::Door),
            Kind::Number => true,
            _ => false,
        };
        let words = tokens
            .iter()
            .filter(says)
            .map(|token| token.text.clone())
            .collect();
        Self { quote, words }
    }

    /// The first count of repetitions and its span: `twice`, `three times`; `None` if absent.
    pub(crate) fn times(&self, tokens: &[Token]) -> Option<(u32, Range<usize>)> {
        tokens.iter().enumerate().find_map(|(at, token)| {
            let number = match class(token.word()) {
                Class::Times(times) => return Some((times, token.span.clone())),
                Class::Number(number) => number,
                _ => token.number()?,
            };
            let next = tokens.get(at + 1).map(Token::word);
            matches!(next, Some("times" | "questions")).then(|| (number, token.span.clone()))
        })
    }

    /// Whether an argument stands in it.
    pub(crate) fn holds(&self, argument: &str) -> bool {
        let quoted = self.quote.as_deref().is_some_and(|quote| quote == argument);
        let wanted = lemmas(argument);
        let own: BTreeSet<String> = self.words.iter().flat_map(|word| lemmas(word)).collect();
        quoted || wanted.iter().all(|word| own.contains(word))
    }

    /// How an answer in the agent's own words agrees with what was said: it says otherwise only
    /// where it names things, and none of them was named.
    pub(crate) fn agrees<'t>(
        &self,
        names: &Names,
        replies: impl Iterator<Item = &'t str>,
        instruction: &str,
    ) -> Agreement {
        let said: BTreeSet<String> = replies.flat_map(lemmas).collect();
        let asked = lemmas(instruction);
        let own: BTreeSet<String> = self.words.iter().flat_map(|word| lemmas(word)).collect();
        if !own.is_empty() && own.is_subset(&said) {
            return Agreement::Same;
        }
        let mut specific = self
            .words
            .iter()
            .filter(|word| names.is_specific(word))
            .flat_map(|word| lemmas(word))
            .peekable();
        let is_other = specific.peek().is_some()
            && !specific.any(|word| said.contains(&word) || asked.contains(&word));
        if is_other {
            Agreement::Other
        } else {
            Agreement::Unclear
        }
    }

    /// How a quotation agrees with any of the texts.
    pub(crate) fn quotes<'t>(&self, texts: impl Iterator<Item = &'t str>) -> Agreement {
        let Some(quote) = &self.quote else {
            return Agreement::Unclear;
        };
        let says = |word: &String| {
            !matches!(
                class(word),
                Class::Determiner
                    | Class::Agent
                    | Class::Be(_)
                    | Class::It
                    | Class::Prep(_)
                    | Class::To
            )
        };
        let said: BTreeSet<String> = language::words(quote)
            .iter()
            .filter(|word| says(word))
            .map(|word| language::lemma(word))
            .collect();
        if said.is_empty() {
            return Agreement::Unclear;
        }
        let share = |text: &str| {
            let own = lemmas(text);
            said.iter().filter(|word| own.contains(*word)).count() * 100 / said.len()
        };
        match texts.map(share).max() {
            Some(90..) => Agreement::Same,
            Some(60..) => Agreement::Unclear,
            _ => Agreement::Other,
        }
    }
}

/// The distinct lemmas of a text.
pub(crate) fn lemmas(text: &str) -> BTreeSet<String> {
    language::words(text)
        .iter()
        .map(|word| language::lemma(word))
        .collect()
}

/// The error codes that a reason in words may mean.
pub(crate) fn reasons(text: &str) -> Vec<&'static str> {
    let lower = text.to_lowercase();
    let named = ErrorCode::ALL
        .iter()
        .map(|code| code.as_str())
        .filter(|code| lower.contains(code));
    let spaced: String = lower
        .split(|letter: char| !letter.is_alphanumeric())
        .collect::<Vec<_>>()
        .join(" ");
    let told = REASONS
        .iter()
        .filter(|(phrase, _)| spaced.contains(phrase))
        .flat_map(|(_, codes)| codes.iter().copied());
    let mut codes: Vec<&'static str> = named.chain(told).collect();
    codes.sort_unstable();
    codes.dedup();
    codes
}
