//! The language as its users meet it: matches against a naive reference, work that stays linear,
//! conditions on plain rows, and the texts of errors.

mod errors;
mod meaning;
mod reference;

use proptest::prelude::*;
use reel_query::pattern::{MAX_CONDITIONS, MAX_POSITIONS, Matcher, Pattern, PatternError};
use reference::{Tree, episode, tree};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn matches_are_those_of_the_reference(tree in tree(), episodes in prop::collection::vec(episode(), 1..6)) {
        let pattern = Pattern::parse(&tree.to_string()).unwrap();
        // one matcher for all: what an episode leaves behind must not matter
        let mut matcher = pattern.matcher();
        for episode in episodes {
            let masks = reference::masks(&pattern, &episode);
            prop_assert_eq!(matcher.is_match(&masks), tree.find(&episode).is_some(), "is_match: {}", tree);
            prop_assert_eq!(matcher.find(&masks), tree.find(&episode), "find: {}", tree);
            prop_assert_eq!(matcher.count(&masks), tree.count(&episode), "count: {}", tree);
        }
    }

    #[test]
    fn nothing_that_looks_like_a_pattern_panics(
        words in prop::collection::vec(prop::sample::select(reference::WORDS.to_vec()), 0..30),
        between in prop::sample::select(vec!["", " "]),
    ) {
        let text = words.join(between);
        match Pattern::parse(&text) {
            Ok(pattern) => prop_assert!(pattern.conditions().len() <= MAX_CONDITIONS),
            Err(error) => prop_assert!(!error.to_string().is_empty()),
        }
    }

    #[test]
    fn no_text_panics(text in "(?s).{0,80}") {
        if let Err(error) = Pattern::parse(&text) {
            prop_assert!(!error.to_string().is_empty());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    /// More truth vectors and states than the cache holds.
    #[test]
    fn forgetting_changes_nothing(masks in prop::collection::vec(any::<u64>(), 600..1200)) {
        let steps: Vec<String> = (0..64).map(|n| format!("[step = {n}]")).collect();
        let text = format!("{} ({}){{2,6}} {}", steps[0], steps.join("|"), steps[1]);
        let pattern = Pattern::parse(&text).unwrap();
        prop_assert_eq!(pattern.conditions().len(), 64);
        let mut one = pattern.matcher();
        // every mask has a bit, or none fits: in between anything but 0
        let fits = |begin: usize, end: usize| masks[begin] & 1 != 0 && masks[end] & 2 != 0 && masks[begin + 1..end].iter().all(|m| *m != 0);
        let longest = |begin: usize| (begin + 3..=begin + 7).rev().find(|end| *end < masks.len() && fits(begin, *end));
        let expected = (0..masks.len()).find_map(|begin| longest(begin).map(|end| begin..end + 1));
        prop_assert_eq!(one.find(&masks), expected);
        let (mut at, mut count) = (0, 0);
        while at < masks.len() {
            match longest(at) {
                Some(end) => (at, count) = (end + 1, count + 1),
                None => at += 1,
            }
        }
        prop_assert_eq!(one.count(&masks), count);
        prop_assert_eq!(one.count(&masks), count, "again, with what it remembers");
    }
}

/// Patterns on which backtracking takes exponential, and restarting at every step quadratic time.
#[test]
fn work_is_linear() {
    let nested = (0..20).fold("ask".to_owned(), |inner, _| format!("({inner})*"));
    let patterns = [
        "(ask|ask)* pick",
        "(ask*)* pick",
        "(ask|ask ask)* pick",
        "(ask{0,20}){0,20} pick",
        "(ask?){100} ask{100} pick",
        "ask (ask* pick)?",
        "(_* ask){8} pick",
        ".. ask .. ask .. ask .. pick ..",
        &format!("{nested} pick"),
    ];
    for text in patterns {
        let pattern = Pattern::parse(text).unwrap();
        for (steps, last) in [(20_000_usize, 0), (20_000, 1)] {
            // bit 0 is `ask`, bit 1 is `pick`: the one that comes first in the pattern comes first
            let mut masks = vec![1_u64; steps];
            masks.push(last << 1);
            for (call, bound) in [
                (is_match as fn(&mut Matcher, &[u64]), 1),
                (find, 3),
                (count, 3),
            ] {
                let mut matcher = pattern.matcher();
                call(&mut matcher, &masks);
                assert!(
                    matcher.work() <= bound * masks.len() as u64,
                    "{text}: {} for {steps} steps",
                    matcher.work()
                );
            }
        }
    }
}

fn is_match(matcher: &mut Matcher, masks: &[u64]) {
    matcher.is_match(masks);
}

fn find(matcher: &mut Matcher, masks: &[u64]) {
    matcher.find(masks);
}

fn count(matcher: &mut Matcher, masks: &[u64]) {
    matcher.count(masks);
}

#[test]
fn what_would_be_too_large_is_refused_before_it_is_built() {
    let towers = [
        "(ask{0,50}){0,50}",
        "((((ask{100}){100}){100}){100}){100}",
        "(((((^){100}){100}){100}){100}){100}",
    ];
    for text in towers {
        let found = Pattern::parse(text);
        assert!(
            matches!(found, Err(PatternError::TooLarge { positions }) if positions > MAX_POSITIONS),
            "{text}: {found:?}"
        );
    }
    assert!(Pattern::parse("(ask{0,22}){0,23}").is_ok());
}

#[test]
fn the_reference_knows_what_it_should() {
    let ask = || Box::new(Tree::Step(0));
    let some = Tree::Repeat(ask(), 1, Some(2));
    assert_eq!(some.find(&[1, 0, 0, 0]), Some(1..3));
    assert_eq!(some.count(&[1, 0, 0, 0]), 2);
    assert_eq!(Tree::Repeat(ask(), 0, None).find(&[1, 0]), Some(0..0));
}
