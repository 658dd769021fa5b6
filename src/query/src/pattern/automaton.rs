//! The automaton of a pattern: its steps written out as positions, and which position may follow
//! which. Nothing here depends on the data; built once, when the pattern is parsed.
//!
//! A Glushkov automaton with anchors. Sets of positions are bit sets of `words` words; two bits of
//! every set are no positions but say that a match may end: [`ACCEPT`] here and now,
//! [`ACCEPT_AT_END`] if the episode ends here.

use crate::pattern::{MAX_POSITIONS, PatternError, parser::Node};

/// Bit of a set: a match may end before this step.
pub(crate) const ACCEPT: u64 = 1;
/// Bit of a set: a match may end here if the episode does.
pub(crate) const ACCEPT_AT_END: u64 = 2;
/// Bits below the first position.
const MARKS: usize = 2;

#[derive(Debug)]
pub(crate) struct Automaton {
    /// Words of a set.
    pub words: usize,
    /// Bits of a mask that count.
    pub used: u64,
    /// By position: the condition it asks for, as the mask bit; `None` is any step.
    asks: Vec<Option<u64>>,
    every: Vec<u64>,
    /// By position: the set of what may follow it.
    follow: Vec<u64>,
    /// What a match may begin with at the episode's first step.
    pub first: Vec<u64>,
    /// What it may begin with at any other.
    pub later: Vec<u64>,
}

impl Automaton {
    pub fn new(node: &Node, conditions: usize) -> Result<Self, PatternError> {
        let positions = written_out(node);
        if positions > MAX_POSITIONS {
            return Err(PatternError::TooLarge { positions });
        }
        let mut graph = Graph {
            places: vec![NfaState::Accept],
        };
        let start = graph.add(node, 0);
        let steps: Vec<(usize, Option<usize>, usize)> = graph
            .places
            .iter()
            .enumerate()
            .filter_map(|(index, place)| match place {
                NfaState::Step(condition, next) => Some((index, *condition, *next)),
                _ => None,
            })
            .collect();
        let words = (MARKS + steps.len()).div_ceil(64);
        let mut position_of = vec![0; graph.places.len()];
        for (position, (index, _, _)) in steps.iter().enumerate() {
            position_of[*index] = MARKS + position;
        }
        let mut every = vec![0; words];
        (0..steps.len()).for_each(|position| insert(&mut every, MARKS + position));
        let closure = |start, at_begin| graph.closure(start, at_begin, words, &position_of);
        Ok(Self {
            words,
            every,
            used: u64::MAX.checked_shr(64 - conditions as u32).unwrap_or(0),
            asks: steps
                .iter()
                .map(|(_, condition, _)| condition.map(|bit| 1 << bit))
                .collect(),
            follow: steps
                .iter()
                .flat_map(|(_, _, next)| closure(*next, false))
                .collect(),
            first: closure(start, true),
            later: closure(start, false),
        })
    }

    /// Calls `with` the set that may follow, for every position of `set`
    /// whose condition `mask` fulfils.
    pub fn step<'a>(&'a self, set: &[u64], mask: u64, mut with: impl FnMut(usize, &'a [u64])) {
        for bit in bits(set).filter(|bit| *bit >= MARKS) {
            let position = bit - MARKS;
            if self.asks[position].is_none_or(|asked| mask & asked != 0) {
                with(bit, &self.follow[position * self.words..][..self.words]);
            }
        }
    }

    /// All positions, without the marks.
    pub fn every(&self) -> &[u64] {
        &self.every
    }
}

/// Whether the sets share a position. The marks are none.
pub(crate) fn meet(one: &[u64], other: &[u64]) -> bool {
    let marks = ACCEPT | ACCEPT_AT_END;
    one[0] & other[0] & !marks != 0
        || one[1..]
            .iter()
            .zip(&other[1..])
            .any(|(one, other)| one & other != 0)
}

fn insert(set: &mut [u64], bit: usize) {
    set[bit / 64] |= 1 << (bit % 64);
}

fn bits(set: &[u64]) -> impl Iterator<Item = usize> {
    set.iter().enumerate().flat_map(|(word, bits)| {
        let mut left = *bits;
        std::iter::from_fn(move || {
            let bit = (left != 0).then(|| left.trailing_zeros() as usize)?;
            left &= left - 1;
            Some(64 * word + bit)
        })
    })
}

/// Steps and anchors once repetitions are written out. Every node counts at least one, so
/// this bounds all work.
fn written_out(node: &Node) -> usize {
    match node {
        Node::Step(_) | Node::Begin | Node::End => 1,
        Node::Sequence(nodes) | Node::Either(nodes) => {
            nodes.iter().map(written_out).fold(0, usize::saturating_add)
        }
        Node::Repeat { node, min, max } => {
            written_out(node).saturating_mul(max.unwrap_or(*min).max(1) as usize)
        }
    }
}

/// Thompson's construction: from place to place without a step, but for [`NfaState::Step`].
struct Graph {
    places: Vec<NfaState>,
}

enum NfaState {
    Accept,
    Step(Option<usize>, usize),
    Begin(usize),
    End(usize),
    Fork(Vec<usize>),
}

impl Graph {
    /// Adds what leads through `node` to `next`; returns where it begins.
    fn add(&mut self, node: &Node, next: usize) -> usize {
        match node {
            Node::Step(condition) => self.push(NfaState::Step(*condition, next)),
            Node::Begin => self.push(NfaState::Begin(next)),
            Node::End => self.push(NfaState::End(next)),
            Node::Sequence(nodes) => nodes
                .iter()
                .rev()
                .fold(next, |next, node| self.add(node, next)),
            Node::Either(nodes) => {
                let ways = nodes.iter().map(|node| self.add(node, next)).collect();
                self.push(NfaState::Fork(ways))
            }
            Node::Repeat {
                node,
                min,
                max: None,
            } => {
                let fork = self.push(NfaState::Fork(Vec::new()));
                let again = self.add(node, fork);
                self.places[fork] = NfaState::Fork(vec![again, next]);
                // of `min` times, the loop is the last; `*` may leave it out
                if *min == 0 {
                    fork
                } else {
                    (1..*min).fold(again, |next, _| self.add(node, next))
                }
            }
            Node::Repeat {
                node,
                min,
                max: Some(max),
            } => {
                let optional = (*min..*max).fold(next, |rest, _| {
                    let way = self.add(node, rest);
                    self.push(NfaState::Fork(vec![way, next]))
                });
                (0..*min).fold(optional, |next, _| self.add(node, next))
            }
        }
    }

    fn push(&mut self, place: NfaState) -> usize {
        self.places.push(place);
        self.places.len() - 1
    }

    /// The steps that may come next from `start`, and the marks if the match may end.
    fn closure(
        &self,
        start: usize,
        at_begin: bool,
        words: usize,
        position_of: &[usize],
    ) -> Vec<u64> {
        let mut set = vec![0; words];
        // by whether the episode has to end here, because a `$` was passed
        let mut seen = [
            vec![false; self.places.len()],
            vec![false; self.places.len()],
        ];
        let mut open = vec![(start, false)];
        while let Some((index, at_end)) = open.pop() {
            if std::mem::replace(&mut seen[usize::from(at_end)][index], true) {
                continue;
            }
            match &self.places[index] {
                NfaState::Accept => set[0] |= if at_end { ACCEPT_AT_END } else { ACCEPT },
                NfaState::Step(..) if at_end => {}
                NfaState::Step(..) => insert(&mut set, position_of[index]),
                NfaState::Begin(next) if at_begin => open.push((*next, at_end)),
                NfaState::Begin(_) => {}
                NfaState::End(next) => open.push((*next, true)),
                NfaState::Fork(ways) => open.extend(ways.iter().map(|way| (*way, at_end))),
            }
        }
        set
    }
}
