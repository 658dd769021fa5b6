//! Runs an automaton over the truth vectors of episodes, and remembers what it worked out
//! in a bounded cache.

use std::{collections::HashMap, ops::Range, sync::Arc};

use crate::pattern::automaton::{ACCEPT, ACCEPT_AT_END, Automaton, meet};

/// Matches one pattern against any number of episodes. An episode is one mask a step, in order; bit
/// `i` says whether the step fits the `i`-th of
/// [`Pattern::conditions`](crate::pattern::Pattern::conditions), other bits are ignored.
///
/// Keeps at most a few megabytes, whatever the data.
#[derive(Clone, Debug)]
pub struct Matcher {
    automaton: Arc<Automaton>,
    classes: Classes,
    /// Forward, a match may begin at any step.
    search: Machine,
    /// Forward from one step on.
    run: Machine,
    /// Backward: where a match can still be completed.
    alive: Machine,
    /// The backward sets of the episode in hand, one a step and one for its end.
    trail: Vec<u64>,
    work: u64,
}

impl Matcher {
    pub(crate) fn new(automaton: Arc<Automaton>) -> Self {
        let classes = Classes::new(automaton.used);
        let machine = |direction| Machine::new(direction, automaton.words, classes.limit);
        Self {
            search: machine(Direction::Search),
            run: machine(Direction::Run),
            alive: machine(Direction::Alive),
            classes,
            automaton,
            trail: Vec::new(),
            work: 0,
        }
    }

    /// Whether the pattern matches somewhere in the episode.
    pub fn is_match(&mut self, episode: &[u64]) -> bool {
        let mut state = self.search.start(&self.automaton.first);
        if state & ACCEPTS != 0 {
            return true;
        }
        for (step, &mask) in episode.iter().enumerate() {
            state = self
                .search
                .step(&self.automaton, &mut self.classes, state, mask);
            if state & ACCEPTS != 0 || state == EMPTY {
                self.work += step as u64 + 1;
                return state != EMPTY;
            }
        }
        self.work += episode.len() as u64;
        state & ACCEPTS_AT_END != 0
    }

    /// The steps of the leftmost match, and among those that begin with it the
    /// longest. May be empty.
    pub fn find(&mut self, episode: &[u64]) -> Option<Range<usize>> {
        if !self.is_match(episode) {
            return None;
        }
        self.look_back(episode);
        let begins = |step: usize| {
            let marks = self.start(step)[0];
            marks & ACCEPT != 0
                || (step == episode.len() && marks & ACCEPT_AT_END != 0)
                || self.can_begin(step)
        };
        let begin = (0..=episode.len()).find(|step| begins(*step))?;
        Some(begin..self.longest(episode, begin))
    }

    /// How many matches follow each other without overlap, each the leftmost and longest of the
    /// rest; empty ones do not count.
    pub fn count(&mut self, episode: &[u64]) -> usize {
        if !self.is_match(episode) {
            return 0;
        }
        self.look_back(episode);
        let (mut count, mut step) = (0, 0);
        while step < episode.len() {
            if self.can_begin(step) {
                step = self.longest(episode, step);
                count += 1;
            } else {
                step += 1;
            }
        }
        count
    }

    /// Steps that the automaton made so far: per call at most one a step of the episode for
    /// `is_match`, three for `find` and `count`.
    pub fn work(&self) -> u64 {
        self.work
    }

    fn start(&self, step: usize) -> &[u64] {
        if step == 0 {
            &self.automaton.first
        } else {
            &self.automaton.later
        }
    }

    /// Whether a match of at least one step begins here. Needs the trail.
    fn can_begin(&self, step: usize) -> bool {
        meet(self.start(step), self.trail_at(step))
    }

    fn trail_at(&self, step: usize) -> &[u64] {
        let words = self.automaton.words;
        &self.trail[step * words..][..words]
    }

    /// Fills the trail from the end: at each step the positions from which a
    /// match can be completed.
    fn look_back(&mut self, episode: &[u64]) {
        let words = self.automaton.words;
        self.trail.clear();
        self.trail.resize((episode.len() + 1) * words, 0);
        self.trail[episode.len() * words] = ACCEPT | ACCEPT_AT_END;
        let mut state = self.alive.start(&self.trail[episode.len() * words..]);
        for (step, &mask) in episode.iter().enumerate().rev() {
            state = self
                .alive
                .step(&self.automaton, &mut self.classes, state, mask);
            self.trail[step * words..][..words].copy_from_slice(self.alive.set(state));
        }
        self.work += episode.len() as u64;
    }

    /// Where the longest match from `begin` on ends. Reads no step after that end: the trail
    /// says where it is.
    fn longest(&mut self, episode: &[u64], begin: usize) -> usize {
        let words = self.automaton.words;
        let first = if begin == 0 {
            &self.automaton.first
        } else {
            &self.automaton.later
        };
        let mut state = self.run.start(first);
        let mut end = begin;
        while meet(self.run.set(state), &self.trail[end * words..][..words]) {
            state = self
                .run
                .step(&self.automaton, &mut self.classes, state, episode[end]);
            end += 1;
        }
        self.work += (end - begin) as u64;
        end
    }
}

/// A state: its number, and above it the flags of its set. [`EMPTY`] is the set from
/// which nothing can come.
type State = u32;
const ACCEPTS: State = 1 << 31;
const ACCEPTS_AT_END: State = 1 << 30;
const NUMBER: State = ACCEPTS_AT_END - 1;
const EMPTY: State = 0;
/// A transition that is not worked out yet.
const UNKNOWN: State = State::MAX;
/// States of a machine, before it forgets them all.
const MAX_STATES: usize = 1024;
/// Classes of masks, before all is forgotten.
const MAX_CLASSES: usize = 256;

#[derive(Clone, Copy, Debug)]
enum Direction {
    Search,
    Run,
    Alive,
}

/// A deterministic automaton, worked out as far as the data asked for it.
#[derive(Clone, Debug)]
struct Machine {
    direction: Direction,
    words: usize,
    classes: usize,
    /// Which classes the table is about: see [`Classes::epoch`].
    epoch: u64,
    /// State times class: the next state.
    table: Vec<State>,
    /// The sets of the states, one after the other.
    sets: Vec<u64>,
    states: HashMap<Box<[u64]>, State>,
    next: Vec<u64>,
}

impl Machine {
    fn new(direction: Direction, words: usize, classes: usize) -> Self {
        let (table, sets, states) = (Vec::new(), Vec::new(), HashMap::new());
        let mut machine = Self {
            direction,
            words,
            classes,
            epoch: 0,
            table,
            sets,
            states,
            next: vec![0; words],
        };
        machine.forget();
        machine
    }

    fn start(&mut self, set: &[u64]) -> State {
        // nearly always the first state made after the empty one: spares the hash of the set
        match self.sets.get(self.words..2 * self.words) {
            Some(first) if first == set => number(1, set),
            _ => self.state_of(set),
        }
    }

    fn set(&self, state: State) -> &[u64] {
        &self.sets[(state & NUMBER) as usize * self.words..][..self.words]
    }

    #[inline]
    fn step(
        &mut self,
        automaton: &Automaton,
        classes: &mut Classes,
        state: State,
        mask: u64,
    ) -> State {
        let class = classes.known(mask & automaton.used);
        if class != NO_CLASS && self.epoch == classes.epoch {
            let next = self.table[(state & NUMBER) as usize * self.classes + class as usize];
            if next != UNKNOWN {
                return next;
            }
        }
        self.work_out(automaton, classes, state, mask & automaton.used)
    }

    #[cold]
    fn work_out(
        &mut self,
        automaton: &Automaton,
        classes: &mut Classes,
        state: State,
        mask: u64,
    ) -> State {
        let from: Vec<u64> = self.set(state).to_vec();
        let mut next = std::mem::take(&mut self.next);
        next.fill(0);
        match self.direction {
            Direction::Search | Direction::Run => {
                if matches!(self.direction, Direction::Search) {
                    next.copy_from_slice(&automaton.later);
                }
                automaton.step(&from, mask, |_, follow| {
                    next.iter_mut()
                        .zip(follow)
                        .for_each(|(next, word)| *next |= word)
                });
            }
            Direction::Alive => {
                next[0] = ACCEPT;
                automaton.step(automaton.every(), mask, |bit, follow| {
                    if from
                        .iter()
                        .zip(follow)
                        .any(|(from, follow)| from & follow != 0)
                    {
                        next[bit / 64] |= 1 << (bit % 64);
                    }
                });
            }
        }
        let class = classes.class(mask);
        if self.epoch != classes.epoch || self.states.len() >= MAX_STATES {
            self.forget();
            self.epoch = classes.epoch;
        }
        let from = self.state_of(&from);
        let to = self.state_of(&next);
        self.table[(from & NUMBER) as usize * self.classes + class as usize] = to;
        self.next = next;
        to
    }

    fn state_of(&mut self, set: &[u64]) -> State {
        if let Some(state) = self.states.get(set) {
            return *state;
        }
        let state = number(self.states.len(), set);
        self.states.insert(set.into(), state);
        self.sets.extend_from_slice(set);
        self.table.resize(self.states.len() * self.classes, UNKNOWN);
        state
    }

    fn forget(&mut self) {
        self.states.clear();
        self.sets.clear();
        self.table.clear();
        let empty = self.state_of(&vec![0; self.words]);
        assert!(empty == EMPTY, "the empty set is the first state");
    }
}

fn number(index: usize, set: &[u64]) -> State {
    let flag = |mark, flag| if set[0] & mark != 0 { flag } else { 0 };
    index as State | flag(ACCEPT, ACCEPTS) | flag(ACCEPT_AT_END, ACCEPTS_AT_END)
}

/// The masks met so far, numbered: an open table without deletion, at most a quarter full.
#[derive(Clone, Debug)]
struct Classes {
    slots: Box<[(u64, u16)]>,
    met: usize,
    limit: usize,
    /// Counts how often all was forgotten.
    epoch: u64,
}

const NO_CLASS: u16 = u16::MAX;
const SLOTS: usize = 4 * MAX_CLASSES;

impl Classes {
    fn new(used: u64) -> Self {
        let limit = 1usize
            .checked_shl(used.count_ones())
            .map_or(MAX_CLASSES, |all| all.min(MAX_CLASSES));
        Self {
            slots: vec![(0, NO_CLASS); SLOTS].into_boxed_slice(),
            met: 0,
            limit,
            epoch: 0,
        }
    }

    /// The class of a mask, or [`NO_CLASS`].
    #[inline]
    fn known(&self, mask: u64) -> u16 {
        self.slots[self.slot(mask)].1
    }

    /// The class of a mask; a new one if need be.
    fn class(&mut self, mask: u64) -> u16 {
        if self.known(mask) == NO_CLASS {
            if self.met == self.limit {
                self.slots.fill((0, NO_CLASS));
                self.met = 0;
                self.epoch += 1;
            }
            self.slots[self.slot(mask)] = (mask, self.met as u16);
            self.met += 1;
        }
        self.known(mask)
    }

    /// Where the mask stands or would stand.
    #[inline]
    fn slot(&self, mask: u64) -> usize {
        let mut slot = (mask.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 54) as usize % SLOTS;
        while self.slots[slot].1 != NO_CLASS && self.slots[slot].0 != mask {
            slot = (slot + 1) % SLOTS;
        }
        slot
    }
}
