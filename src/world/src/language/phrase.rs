//! Finds the noun phrases of an instruction, question or reply that speak of an object, apart
//! from those that say where it stands or where it shall go. Simple rules over words; never
//! looks at a task.

use super::words::{ARTICLES, Token, tokens};

/// Words that may speak of an object, with pauses kept.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub(super) struct Phrase {
    pub(super) tokens: Vec<Token>,
    /// It follows a verb of taking or meaning: certainly an object.
    pub(super) taken: bool,
    /// `not the red one`
    pub(super) negated: bool,
}

/// After these an object is named: `fetch the red apple`.
const TAKING: [&str; 32] = crate::words! {
    take retrieve get grasp fetch find bring move transport pick grab collect carry hand give want
    need mean meant choose lift relocate deliver store looking seeing prefer see found holding put
    place
};

/// After these comes a place, or something that is no description.
const BOUNDARY: [&str; 26] = [
    "from", "located", "then", "at", "into", "onto", "to", "off", "inside", "under", "near",
    "beside", "next", "behind", "which", "that", "who", "but", "because", "so", "or", "when",
    "while", "lies", "stands", "please",
];

/// They speak of something named before.
const PRONOUNS: [&str; 8] = ["it", "them", "there", "here", "you", "yours", "back", "out"];

/// Verbs of motion: after `and` or a pause they begin another clause.
const MOTION: [&str; 15] = [
    "put", "place", "carry", "bring", "deliver", "deposit", "travel", "move", "drive", "go",
    "take", "set", "leave", "drop", "check",
];

/// The phrases of a text that may speak of an object.
pub(super) fn phrases(text: &str) -> Vec<Phrase> {
    let tokens = tokens(text);
    let sentences = tokens
        .split(|token| *token == Token::Stop)
        .filter(|sentence| !sentence.is_empty());
    sentences.flat_map(sentence_phrases).collect()
}

fn sentence_phrases(sentence: &[Token]) -> Vec<Phrase> {
    let taken = scan(sentence, true);
    if taken.iter().any(|phrase| phrase.taken) {
        taken
    } else {
        scan(sentence, false)
    }
}

/// With `after_verbs` a phrase opens only after a verb of taking or a negation, else also at the
/// start and after a pause.
fn scan(sentence: &[Token], after_verbs: bool) -> Vec<Phrase> {
    let mut found: Vec<Phrase> = Vec::new();
    let mut open: Option<Phrase> = (!after_verbs).then(Phrase::default);
    let mut index = 0;
    while index < sentence.len() {
        let rest = &sentence[index..];
        index += 1;
        let word = rest[0].word();
        let before = index
            .checked_sub(2)
            .and_then(|before| sentence[before].word());
        if let Some(opened) = opens(before, rest, after_verbs && open.is_none()) {
            found.extend(open.take());
            open = opened;
        } else if open.is_some() && ends(rest, open.as_ref().is_some_and(|phrase| phrase.negated)) {
            found.extend(open.take());
            // `No, not the pear, the apple`: what follows a negation is a phrase again
            if word.is_none() {
                open = Some(Phrase::default());
            }
        } else if let Some(phrase) = &mut open {
            phrase.tokens.push(rest[0].clone());
        } else if !after_verbs && word.is_none() {
            open = Some(Phrase::default());
        }
    }
    found.extend(open);
    found.retain(|phrase| {
        phrase
            .tokens
            .iter()
            .filter_map(Token::word)
            .any(|word| !ARTICLES.contains(&word) && word != "up")
    });
    found
}

/// Whether a phrase opens after `rest[0]`: `Some(None)` for a verb whose object is a pronoun.
fn opens(before: Option<&str>, rest: &[Token], may_open: bool) -> Option<Option<Phrase>> {
    let word = rest[0].word()?;
    let next = rest.get(1).and_then(Token::word);
    if ["not", "except"].contains(&word)
        || word.ends_with("n't") && next.is_some_and(|next| ARTICLES.contains(&next))
    {
        return Some(Some(Phrase {
            negated: true,
            ..Phrase::default()
        }));
    }
    // `the table to place my snack` is a place
    if !may_open || !TAKING.contains(&word) || word == "place" && before == Some("to") {
        return None;
    }
    let pronoun = next.is_none_or(|next| PRONOUNS.contains(&next));
    Some((!pronoun).then(|| Phrase {
        taken: true,
        ..Phrase::default()
    }))
}

fn ends(rest: &[Token], negated: bool) -> bool {
    let word = |offset: usize| rest.get(offset).and_then(Token::word);
    let Some(first) = word(0) else {
        return negated
            || word(1).is_some_and(|next| {
                MOTION.contains(&next) || next == "then" || next == "and" && moves(word(2))
            });
    };
    let place_follows =
        word(1).is_some_and(|next| ["the", "my", "your", "our", "this", "which"].contains(&next));
    BOUNDARY.contains(&first)
        || ["on", "in"].contains(&first) && place_follows
        || first == "and" && moves(word(1))
}

fn moves(word: Option<&str>) -> bool {
    word.is_some_and(|word| MOTION.contains(&word))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(text: &str) -> Vec<String> {
        let join = |phrase: &Phrase| {
            let words: Vec<&str> = phrase.tokens.iter().filter_map(Token::word).collect();
            format!(
                "{}{}",
                if phrase.negated { "not " } else { "" },
                words.join(" ")
            )
        };
        phrases(text).iter().map(join).collect()
    }

    #[test]
    fn the_object_is_told_from_the_places() {
        assert_eq!(
            texts(
                "Go to the rectangular table, pick up a notebook, then travel to the desk near my bed to place it."
            ),
            ["up a notebook"]
        );
        assert_eq!(
            texts("Transport the red apple, small stem at the couch to the table."),
            ["the red apple small stem"]
        );
        assert_eq!(
            texts(
                "First, drive to the white desk to find the pen with a clip, then deliver it to bed."
            ),
            ["the pen with a clip"]
        );
        assert_eq!(texts("Can you help me move a book?"), ["a book"]);
        assert_eq!(
            texts("Can you find my pen holder in the bedroom?"),
            ["my pen holder"]
        );
    }

    #[test]
    fn replies_and_questions() {
        assert_eq!(texts("Do you mean the red one?"), ["the red one"]);
        assert_eq!(
            texts("Is it the pencil on the white desk?"),
            ["is it the pencil"]
        );
        assert_eq!(
            texts("No, not the pear, the apple."),
            ["no", "not the pear", "the apple"]
        );
        assert_eq!(
            texts("I mean the red apple, not the green one."),
            ["the red apple", "not the green one"]
        );
        assert_eq!(
            texts("Please take it to the table where we have dinner."),
            Vec::<String>::new()
        );
    }
}
