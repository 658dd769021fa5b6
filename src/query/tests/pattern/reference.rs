//! Patterns as trees and a naive matcher that tries everything, sharing nothing with the
//! crate but the text.

use std::{collections::BTreeSet, fmt, ops::Range};

use proptest::prelude::*;
use reel_query::pattern::{Pattern, StepRow, Value};

/// The tools of the trees; an episode holds indices of these.
pub const TOOLS: [&str; 3] = ["ask", "pick", "place"];

/// Pieces of patterns, to be put together at random.
pub const WORDS: &[&str] = &reel_world::words! {
    ask pik "_" any ok failed not and or in like is null true argument goal_object reward error
    "@-1" "@-" "99" "1" "0.5" "'a'" "\"b\"" "'" "[" "]" "(" ")" "{" "}" "*" "+" "?" "^" "$" "|" "!"
    ".." ">" "<" "=" "<>" "," "-" "é" "\n"
};

#[derive(Clone, Debug)]
pub enum Tree {
    Step(usize),
    NotStep(usize),
    Any,
    Begin,
    End,
    Sequence(Vec<Tree>),
    Either(Vec<Tree>),
    Repeat(Box<Tree>, u32, Option<u32>),
}

/// Any pattern of moderate size.
pub fn tree() -> impl Strategy<Value = Tree> {
    let leaf = prop_oneof![
        8 => (0..TOOLS.len()).prop_map(Tree::Step),
        2 => (0..TOOLS.len()).prop_map(Tree::NotStep),
        2 => Just(Tree::Any),
        1 => Just(Tree::Begin),
        1 => Just(Tree::End),
    ];
    leaf.prop_recursive(4, 16, 3, |inner| {
        let bounds = prop_oneof![
            Just((0, None)),
            Just((1, None)),
            Just((0, Some(1))),
            Just((2, None)),
            Just((2, Some(2))),
            Just((1, Some(3)))
        ];
        prop_oneof![
            3 => prop::collection::vec(inner.clone(), 2..4).prop_map(Tree::Sequence),
            2 => prop::collection::vec(inner.clone(), 2..4).prop_map(Tree::Either),
            2 => (inner, bounds).prop_map(|(tree, (min, max))| Tree::Repeat(Box::new(tree), min, max)),
        ]
    })
    // at most 3^4 copies of 16 leaves would be too large in rare cases
    .prop_filter("within the limits", |tree| Pattern::parse(&tree.to_string()).is_ok())
}

/// Strategy for an episode of up to 8 steps, each an index into the tools.
pub fn episode() -> impl Strategy<Value = Vec<usize>> {
    prop::collection::vec(0..TOOLS.len(), 0..9)
}

/// The masks of an episode of tools.
pub fn masks(pattern: &Pattern, episode: &[usize]) -> Vec<u64> {
    struct Call(&'static str);
    impl StepRow for Call {
        fn value(&self, column: &str) -> Value<'_> {
            if column == "tool" {
                Value::Text(self.0)
            } else {
                Value::Null
            }
        }
    }
    let rows: Vec<_> = episode.iter().map(|tool| Call(TOOLS[*tool])).collect();
    pattern.masks(&rows)
}

impl Tree {
    /// The leftmost match, the longest of those.
    pub fn find(&self, episode: &[usize]) -> Option<Range<usize>> {
        (0..=episode.len())
            .find_map(|begin| self.ends(episode, begin).last().map(|end| begin..*end))
    }

    /// Matches after each other, without empty ones.
    pub fn count(&self, episode: &[usize]) -> usize {
        let (mut at, mut count) = (0, 0);
        while at < episode.len() {
            match self.ends(episode, at).last() {
                Some(end) if *end > at => (at, count) = (*end, count + 1),
                _ => at += 1,
            }
        }
        count
    }

    /// Where matches that begin at `at` can end.
    fn ends(&self, episode: &[usize], at: usize) -> BTreeSet<usize> {
        let one = |fits: bool| {
            if fits {
                BTreeSet::from([at + 1])
            } else {
                BTreeSet::new()
            }
        };
        let here = |fits: bool| {
            if fits {
                BTreeSet::from([at])
            } else {
                BTreeSet::new()
            }
        };
        match self {
            Tree::Step(tool) => one(episode.get(at) == Some(tool)),
            Tree::NotStep(tool) => one(episode.get(at).is_some_and(|found| found != tool)),
            Tree::Any => one(at < episode.len()),
            Tree::Begin => here(at == 0),
            Tree::End => here(at == episode.len()),
            Tree::Sequence(trees) => trees
                .iter()
                .fold(here(true), |from, tree| tree.ends_from(episode, &from)),
            Tree::Either(trees) => trees
                .iter()
                .flat_map(|tree| tree.ends(episode, at))
                .collect(),
            Tree::Repeat(tree, min, max) => {
                let mut reached =
                    (0..*min).fold(here(true), |from, _| tree.ends_from(episode, &from));
                let mut ends = reached.clone();
                // more rounds than there are steps reach nothing new
                for _ in 0..max.map_or(episode.len() + 1, |max| (max - min) as usize) {
                    reached = tree.ends_from(episode, &reached);
                    ends.extend(&reached);
                }
                ends
            }
        }
    }

    fn ends_from(&self, episode: &[usize], from: &BTreeSet<usize>) -> BTreeSet<usize> {
        from.iter().flat_map(|at| self.ends(episode, *at)).collect()
    }
}

/// Writes the tree in the syntax of the pattern language.
impl fmt::Display for Tree {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let join = |trees: &[Tree], between| {
            trees
                .iter()
                .map(ToString::to_string)
                .collect::<Vec<_>>()
                .join(between)
        };
        match self {
            Tree::Step(tool) => f.write_str(TOOLS[*tool]),
            Tree::NotStep(tool) => write!(f, "!{}", TOOLS[*tool]),
            Tree::Any => f.write_str("_"),
            Tree::Begin => f.write_str("^"),
            Tree::End => f.write_str("$"),
            Tree::Sequence(trees) => write!(f, "({})", join(trees, " ")),
            Tree::Either(trees) => write!(f, "({})", join(trees, " | ")),
            Tree::Repeat(tree, 0, None) => write!(f, "({tree})*"),
            Tree::Repeat(tree, 1, None) => write!(f, "({tree})+"),
            Tree::Repeat(tree, 0, Some(1)) => write!(f, "({tree})?"),
            Tree::Repeat(tree, min, None) => write!(f, "({tree}){{{min},}}"),
            Tree::Repeat(tree, min, Some(max)) if min == max => write!(f, "({tree}){{{min}}}"),
            Tree::Repeat(tree, min, Some(max)) => write!(f, "({tree}){{{min},{max}}}"),
        }
    }
}
