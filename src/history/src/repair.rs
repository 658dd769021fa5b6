//! Makes a History true: false claims are replaced where the record says by what, and their
//! sentences dropped otherwise. Never adds a claim of its own.

use std::{collections::BTreeSet, ops::Range};

use crate::{Checker, Claim, lex::sentences};

/// Passes after which what is still false is dropped with everything else.
const MOST_PASSES: usize = 12;

/// A History after repair, and how many sentences were repaired or dropped.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct RepairedHistory {
    /// The text, without contradiction.
    pub text: String,
    /// Sentences in which something was replaced.
    pub repaired: usize,
    /// Sentences that were dropped.
    pub dropped: usize,
    /// Sentences that stand as they were.
    pub unchanged: usize,
}

/// Mends a History against the deeds that a checker was told so far.
pub fn repair_history(checker: &mut Checker, history: &str) -> RepairedHistory {
    let before = sentences(history).len();
    let claims = checker.check(history);
    if !claims.iter().any(Claim::is_false) {
        return RepairedHistory {
            text: history.to_owned(),
            repaired: 0,
            dropped: 0,
            unchanged: before,
        };
    }
    let (mut text, mended) = replaced(history, &claims);
    let mut mended = mended;
    let mut dropped = 0;
    for _ in 0..MOST_PASSES {
        let claims = checker.check(&text);
        let wrong: Vec<Range<usize>> = claims
            .iter()
            .filter(|claim| claim.is_false())
            .map(|claim| claim.span.clone())
            .collect();
        if wrong.is_empty() {
            let kept = before.saturating_sub(mended.len() + dropped);
            return RepairedHistory {
                text,
                repaired: mended.len(),
                dropped,
                unchanged: kept,
            };
        }
        (text, dropped) = without(&text, &wrong, &mut mended, dropped);
    }
    RepairedHistory {
        text: String::new(),
        repaired: 0,
        dropped: before,
        unchanged: 0,
    }
}

/// The text with every replacement made, and the sentences (by number) that it touched.
fn replaced(text: &str, claims: &[Claim]) -> (String, BTreeSet<usize>) {
    let ranges = sentences(text);
    let mut fixes: Vec<&(Range<usize>, String)> = claims
        .iter()
        .filter(|claim| claim.is_false())
        .flat_map(|claim| &claim.fix)
        .collect();
    fixes.sort_by_key(|(range, _)| (range.start, range.end));
    let mut result = String::with_capacity(text.len());
    let mut touched = BTreeSet::new();
    let mut at = 0;
    for (range, new) in fixes {
        if range.start < at {
            continue;
        }
        result.push_str(&text[at..range.start]);
        result.push_str(new);
        at = range.end;
        touched.insert(ranges.partition_point(|sentence| sentence.end <= range.start));
    }
    result.push_str(&text[at..]);
    (result, touched)
}

/// The text without the sentences that hold wrong claims.
fn without(
    text: &str,
    wrong: &[Range<usize>],
    mended: &mut BTreeSet<usize>,
    mut dropped: usize,
) -> (String, usize) {
    let begins: BTreeSet<usize> = wrong.iter().map(|claim| claim.start).collect();
    let mut result = String::with_capacity(text.len());
    let mut at = 0;
    let mut kept = BTreeSet::new();
    let mut number = 0;
    for (index, range) in sentences(text).into_iter().enumerate() {
        let is_wrong = begins.range(range.clone()).next().is_some();
        if is_wrong {
            dropped += 1;
        } else {
            // the space before a sentence goes with it
            let from = if result.is_empty() { range.start } else { at };
            result.push_str(&text[from..range.end]);
            if mended.contains(&index) {
                kept.insert(number);
            }
            number += 1;
        }
        at = range.end;
    }
    *mended = kept;
    (result, dropped)
}
