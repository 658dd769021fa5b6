//! Which of an ordered row of candidates is the first that changes an episode: builds of the simulator, reward
//! presets, prompts, checkpoints. As `git bisect` does for one test, and for all episodes and their mean at once.

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

/// The value of a metric for each episode under one candidate.
pub type Values = BTreeMap<String, f64>;

/// A search among candidates in their order, the first of which is good and the last bad.
#[derive(Clone, Debug)]
pub struct Bisection {
    candidates: Vec<State>,
}

#[derive(Clone, Debug)]
enum State {
    NotMeasured,
    Skipped,
    Measured(Values),
}

/// Between which candidates a value turns from the good one's to the bad one's.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
pub struct Change {
    /// Value under the first candidate of all.
    pub good: f64,
    /// Value under the last candidate of all.
    pub bad: f64,
    /// Index of the last candidate found whose value is nearer to the good one's.
    pub last_good: usize,
    /// Index of the first candidate found whose value is nearer to the bad one's.
    pub first_bad: usize,
}

impl Change {
    /// Whether no candidate lies between the two, so that the first bad one is known.
    pub fn is_settled(&self) -> bool {
        self.first_bad == self.last_good + 1
    }
}

/// What one candidate says of a value.
enum Side {
    NotMeasured,
    Skipped,
    Good,
    Bad,
}

impl Bisection {
    /// A search of which nothing is measured.
    pub fn new(candidates: usize) -> Self {
        Self {
            candidates: vec![State::NotMeasured; candidates],
        }
    }

    /// Takes up what a candidate gave; none where it could not be measured.
    pub fn record(&mut self, candidate: usize, values: Option<Values>) {
        self.candidates[candidate] = values.map_or(State::Skipped, State::Measured);
    }

    /// What a candidate gave; none where it was not measured, or could not be.
    pub fn values(&self, candidate: usize) -> Option<&Values> {
        match &self.candidates[candidate] {
            State::Measured(values) => Some(values),
            State::NotMeasured | State::Skipped => None,
        }
    }

    /// The candidate to measure next: the ends, then the one that most searches wait for. None where
    /// nothing more can be found out.
    pub fn next_candidate(&self) -> Option<usize> {
        let ends = [0, self.candidates.len() - 1];
        let open = |end: &usize| matches!(self.candidates[*end], State::NotMeasured);
        if let Some(end) = ends.into_iter().find(open) {
            return Some(end);
        }
        let mut waiting: BTreeMap<usize, usize> = BTreeMap::new();
        let episodes = self.changed();
        let searches = episodes
            .iter()
            .filter_map(|episode| self.episode(episode).1);
        for candidate in searches.chain(self.search_mean().and_then(|(_, wanted)| wanted)) {
            *waiting.entry(candidate).or_default() += 1;
        }
        let most = waiting.values().max()?;
        waiting
            .iter()
            .find_map(|(candidate, count)| (count == most).then_some(*candidate))
    }

    /// Where each episode changes whose value differs between the ends.
    pub fn changes(&self) -> BTreeMap<String, Change> {
        let changed = self.changed().into_iter();
        changed
            .map(|episode| (episode.to_owned(), self.episode(episode).0))
            .collect()
    }

    /// Where the mean over all episodes changes; none where it is the same at both ends.
    pub fn mean_change(&self) -> Option<Change> {
        self.search_mean().map(|(change, _)| change)
    }

    /// Mean over the episodes that both ends have; none where the candidate lacks one of them.
    pub fn mean(&self, candidate: usize) -> Option<f64> {
        Some(self.means(candidate)?[0])
    }

    /// How many episodes both ends have.
    pub fn paired(&self) -> usize {
        self.ends().map_or(0, |(good, bad)| {
            good.keys().filter(|key| bad.contains_key(*key)).count()
        })
    }

    fn ends(&self) -> Option<(&Values, &Values)> {
        Some((self.values(0)?, self.values(self.candidates.len() - 1)?))
    }

    fn changed(&self) -> BTreeSet<&str> {
        let Some((good, bad)) = self.ends() else {
            return BTreeSet::new();
        };
        let differs = |(key, value): &(&String, &f64)| bad.get(*key).is_some_and(|b| b != *value);
        let changed = good.iter().filter(differs);
        changed.map(|(key, _)| key.as_str()).collect()
    }

    fn episode(&self, episode: &str) -> (Change, Option<usize>) {
        let value = |candidate: usize| self.values(candidate)?.get(episode).copied();
        let end = |candidate| value(candidate).unwrap_or(f64::NAN);
        let (good, bad) = (end(0), end(self.candidates.len() - 1));
        self.search(good, bad, |candidate| {
            value(candidate).map(|value| [value, good, bad])
        })
    }

    fn search_mean(&self) -> Option<(Change, Option<usize>)> {
        let last = self.candidates.len() - 1;
        let (good, bad) = (self.mean(0)?, self.mean(last)?);
        (good != bad).then(|| self.search(good, bad, |candidate| self.means(candidate)))
    }

    /// Means of a candidate and of both ends over the episodes that both ends have; none where the candidate lacks one of
    /// these, because a mean over others is no neighbour of theirs.
    fn means(&self, candidate: usize) -> Option<[f64; 3]> {
        let (values, (good, bad)) = (self.values(candidate)?, self.ends()?);
        let triples = values
            .iter()
            .filter_map(|(key, value)| Some([*value, *good.get(key)?, *bad.get(key)?]));
        let (mut sums, mut count) = ([0.0; 3], 0.0);
        for triple in triples {
            count += 1.0;
            for (sum, value) in sums.iter_mut().zip(triple) {
                *sum += value;
            }
        }
        (count > 0.0 && count == self.paired() as f64).then(|| sums.map(|sum| sum / count))
    }

    /// Halves the row between a good and a bad candidate until nothing that can be measured is left
    /// between them, or a candidate is wanted that is not measured yet.
    fn search(
        &self,
        good: f64,
        bad: f64,
        measured: impl Fn(usize) -> Option<[f64; 3]>,
    ) -> (Change, Option<usize>) {
        let side = |candidate: usize| match &self.candidates[candidate] {
            State::NotMeasured => Side::NotMeasured,
            State::Skipped => Side::Skipped,
            State::Measured(_) => match measured(candidate) {
                None => Side::Skipped,
                Some([value, good, bad]) if (value - bad).abs() < (value - good).abs() => Side::Bad,
                Some(_) => Side::Good,
            },
        };
        let (mut last_good, mut first_bad) = (0, self.candidates.len() - 1);
        let mut wanted = None;
        loop {
            let middle = usize::midpoint(last_good, first_bad);
            let open = (last_good + 1..first_bad)
                .filter(|candidate| !matches!(side(*candidate), Side::Skipped))
                .min_by_key(|candidate| candidate.abs_diff(middle));
            match open.map(|candidate| (candidate, side(candidate))) {
                Some((candidate, Side::Good)) => last_good = candidate,
                Some((candidate, Side::Bad)) => first_bad = candidate,
                Some((candidate, Side::NotMeasured)) => {
                    wanted = Some(candidate);
                    break;
                }
                Some((_, Side::Skipped)) | None => break,
            }
        }
        let change = Change {
            good,
            bad,
            last_good,
            first_bad,
        };
        (change, wanted)
    }
}
