//! One episode: takes its deeds in their order and judges what a History says of them. Never keeps
//! a verdict, as a later deed may change it; sentences that were read once are not read again.

use std::{collections::BTreeMap, rc::Rc};

use crate::{
    EpisodeFacts, StepFacts,
    claim::{Claim, ClaimKind, ClaimVerdict},
    clause::{Arg, Mood, Predicate, predicates},
    facts::Facts,
    grammar::{Act, Link},
    judge::{Judge, Ruling, kind_of, slots},
    lex::sentences,
    names::{MatchQuality, Names},
};

/// Version of the verdicts: raise it when a change of this crate makes any text judged otherwise,
/// so that what was kept under the earlier version is checked again.
pub const CHECKER_VERSION: u32 = 1;

/// Sentences that are remembered.
const REMEMBERED: usize = 4096;

/// How many claims before or after one are looked at for what it hangs on.
const REACH: usize = 256;

/// Judges the Histories of one episode.
pub struct Checker {
    names: Names,
    facts: Facts,
    read: BTreeMap<String, Rc<[Predicate]>>,
}

/// A predicate in its text.
struct ReportedPredicate<'p> {
    predicate: &'p Predicate,
    /// Where its sentence begins, in bytes.
    offset: usize,
    sentence: usize,
    rulings: Vec<Ruling>,
    /// The deed it most likely speaks of.
    deed: Option<usize>,
}

impl Checker {
    /// Before the first decision.
    pub fn new(setting: EpisodeFacts) -> Self {
        let names = Names::new(setting);
        Self {
            facts: Facts::new(&names),
            names,
            read: BTreeMap::new(),
        }
    }

    /// One more decision was made.
    pub fn push_step(&mut self, deed: StepFacts) {
        self.facts.push(&self.names, deed);
    }

    /// Judges a History that was written after the deeds told so far. Claims come in the
    /// order of the text.
    pub fn check(&mut self, history: &str) -> Vec<Claim> {
        let ranges = sentences(history);
        let read: Vec<Rc<[Predicate]>> = ranges
            .iter()
            .map(|range| self.sentence(&history[range.clone()]))
            .collect();
        let mut told: Vec<ReportedPredicate> = Vec::new();
        for (sentence, (range, predicates)) in ranges.iter().zip(&read).enumerate() {
            let new = |predicate| ReportedPredicate {
                predicate,
                offset: range.start,
                sentence,
                rulings: Vec::new(),
                deed: None,
            };
            told.extend(predicates.iter().map(new));
        }
        let judge = Judge {
            facts: &self.facts,
            names: &self.names,
        };
        deeds(&judge, &mut told);
        denials(&judge, &mut told);
        states(&judge, &mut told);
        orders(&self.facts, &mut told);
        last_action(&judge, &mut told);
        let mut claims: Vec<Claim> = told.iter().flat_map(claims).collect();
        claims.sort_by_key(|claim| (claim.span.start, claim.span.end));
        claims
    }

    fn sentence(&mut self, sentence: &str) -> Rc<[Predicate]> {
        if let Some(known) = self.read.get(sentence) {
            return Rc::clone(known);
        }
        let read: Rc<[Predicate]> = predicates(&self.names, sentence).into();
        if self.read.len() < REMEMBERED {
            self.read.insert(sentence.to_owned(), Rc::clone(&read));
        }
        read
    }
}

fn claims(told: &ReportedPredicate) -> impl Iterator<Item = Claim> {
    let shift = |range: &std::ops::Range<usize>| range.start + told.offset..range.end + told.offset;
    told.rulings.iter().map(move |ruling| Claim {
        span: shift(&told.predicate.span),
        kind: ruling.kind,
        verdict: ruling.verdict.clone(),
        fix: ruling
            .fix
            .iter()
            .map(|(range, text)| (shift(range), text.clone()))
            .collect(),
    })
}

/// Judges what is said to have been done, and finds the deed that each claim most likely speaks of.
fn deeds(judge: &Judge, told: &mut [ReportedPredicate]) {
    let mut cursor = 0;
    for index in 0..told.len() {
        let predicate = told[index].predicate;
        if predicate.is_state() || denies(predicate) {
            continue;
        }
        let (place, thing) = unnamed(told, index);
        let rulings = judge.step_facts(predicate, cursor, judge.facts.now(), place, thing);
        let deed = rulings
            .iter()
            .filter_map(|ruling| ruling.matches.first().copied())
            .max();
        if let Some(deed) = deed.filter(|_| !matches!(predicate.act, Act::Say | Act::Finish)) {
            cursor = deed;
        }
        told[index].deed = deed;
        told[index].rulings = rulings;
    }
}

fn denies(predicate: &Predicate) -> bool {
    predicate.negated || predicate.args.iter().any(|arg| arg.no)
}

/// The place and the thing that stand in the clause before, for `found nothing` and `found one`.
fn unnamed<'p>(told: &[ReportedPredicate<'p>], index: usize) -> (Option<&'p Arg>, Option<&'p Arg>) {
    let before = told[..index]
        .iter()
        .rev()
        .take(REACH)
        .take_while(|other| other.sentence == told[index].sentence);
    let mut looks = before.map(|other| other.predicate).filter(|other| {
        matches!(
            other.act,
            Act::Search | Act::Explore | Act::Check | Act::Go | Act::Gaze | Act::See
        ) && other.mood == Mood::Done
    });
    let Some(look) = looks.next() else {
        return (None, None);
    };
    let found = slots(look);
    let thing = found
        .iter()
        .find_map(|slots| slots.object)
        .filter(|_| look.act == Act::Search);
    (
        found
            .iter()
            .find_map(|slots| slots.place)
            .filter(|place| !place.referent.any_place),
        thing,
    )
}

/// Judges what is said not to have been done or seen. What the text itself tells later
/// does not refute it.
fn denials(judge: &Judge, told: &mut [ReportedPredicate]) {
    for index in 0..told.len() {
        let predicate = told[index].predicate;
        if predicate.is_state() || !denies(predicate) {
            continue;
        }
        let later = told[index + 1..].iter().take(REACH).filter(|other| {
            other.predicate.act == predicate.act && other.predicate.mood == Mood::Done
        });
        let until = later
            .filter_map(|other| other.deed)
            .min()
            .unwrap_or(judge.facts.now());
        let (place, thing) = unnamed(told, index);
        told[index].rulings = judge.step_facts(predicate, 0, until, place, thing);
    }
}

/// Judges how things stand: between the deeds told before and after, and now where
/// nothing is told after.
fn states(judge: &Judge, told: &mut [ReportedPredicate]) {
    for index in 0..told.len() {
        let predicate = told[index].predicate;
        if predicate.is_state() {
            told[index].rulings = judge.state(predicate, &window(told, index, judge.facts.now()));
        }
    }
}

/// The moments at which a state may be meant.
fn window(told: &[ReportedPredicate], index: usize, now: usize) -> Vec<usize> {
    let before = told[..index]
        .iter()
        .rev()
        .take(REACH)
        .find_map(|other| other.deed)
        .map(|deed| deed + 1);
    let after = told[index + 1..]
        .iter()
        .take(REACH)
        .find_map(|other| other.deed);
    let present =
        told[index].predicate.present && told[index].predicate.link != Some(Link::Because);
    match (before, after) {
        // `was closed`: at any time
        _ if !present => (0..=now).collect(),
        // what is told next may be told once more
        (Some(before), Some(after)) if before <= after + 1 => {
            (before..=after + 1).chain([now]).collect()
        }
        (_, Some(_)) => (0..=now).collect(),
        (_, None) => vec![now],
    }
}

/// Judges what is said to have come before what.
fn orders(facts: &Facts, told: &mut [ReportedPredicate]) {
    for index in 0..told.len() {
        let Some(link) = told[index].predicate.link else {
            continue;
        };
        if !eventful(&told[index]) {
            continue;
        }
        let same = |other: &usize| {
            told[*other].sentence == told[index].sentence && eventful(&told[*other])
        };
        let subordinate = |other: &usize| {
            matches!(
                told[*other].predicate.link,
                Some(Link::After | Link::Before)
            )
        };
        let before = (0..index).rev().take(REACH).find(same);
        let before_it = before.filter(|other| !subordinate(other));
        let after_it = (index + 1..told.len())
            .take(REACH)
            .find(|other| same(other) && !subordinate(other));
        let main = if told[index].predicate.leading {
            after_it.or(before_it)
        } else {
            before_it.or(after_it)
        };
        let pair = match link {
            Link::Then => before
                .or_else(|| told_before(told, index))
                .map(|before| (before, index)),
            Link::After => main.map(|main| (index, main)),
            Link::Before => main.map(|main| (main, index)),
            _ => None,
        };
        let Some((first, second)) = pair else {
            continue;
        };
        let all = |told: &ReportedPredicate| {
            told.rulings
                .iter()
                .flat_map(|ruling| ruling.matches.clone())
                .collect::<Vec<usize>>()
        };
        let (earlier, later) = (all(&told[first]), all(&told[second]));
        let (Some(begin), Some(end)) = (earlier.iter().min(), later.iter().max()) else {
            continue;
        };
        let step = facts.step(*end);
        let ruling = if begin < end
            || begin == end && told[first].predicate.act != told[second].predicate.act
        {
            Ruling::supported(ClaimKind::Order, step)
        } else {
            Ruling::contradicted(ClaimKind::Order, "it was the other way round", step)
        };
        told[index].rulings.push(ruling);
    }
}

/// The deed told last in the sentences before, for a sentence that opens with `then`.
fn told_before(told: &[ReportedPredicate], index: usize) -> Option<usize> {
    let opens = index
        .checked_sub(1)
        .is_none_or(|before| told[before].sentence != told[index].sentence);
    (0..index)
        .rev()
        .take(REACH)
        .find(|other| eventful(&told[*other]))
        .filter(|_| opens)
}

/// Whether a claim speaks of a deed that was found.
fn eventful(told: &ReportedPredicate) -> bool {
    !told.predicate.negated
        && !told.predicate.is_state()
        && told.deed.is_some()
        && told
            .rulings
            .iter()
            .all(|ruling| !matches!(ruling.verdict, ClaimVerdict::Contradicted { .. }))
}

/// Judges what is said to have been done last.
fn last_action(judge: &Judge, told: &mut [ReportedPredicate]) {
    let Some(fact) = judge.facts.all.last() else {
        return;
    };
    for index in 0..told.len() {
        let predicate = told[index].predicate;
        let first = told[..index]
            .iter()
            .rev()
            .take(REACH)
            .take_while(|other| other.sentence == told[index].sentence)
            .all(|other| other.predicate.act == Act::Be);
        if !predicate.last
            || !first
            || matches!(predicate.act, Act::Be | Act::Have)
            || predicate.negated
            || predicate.user
        {
            continue;
        }
        let step = Some(fact.step_facts.step);
        let last = format!("the last call was {}", fact.step_facts.tool);
        told[index].rulings = vec![if predicate.act == Act::Fail {
            let failed = predicate.mood == Mood::Failed;
            let why = !predicate.reasons.is_empty()
                && !fact.ok()
                && !predicate.reasons.contains(&fact.error());
            match failed == fact.ok() || failed && why {
                true => Ruling::contradicted(ClaimKind::Last, last, step),
                false => Ruling::supported(ClaimKind::Last, step),
            }
        } else {
            let mood = if predicate.mood == Mood::Failed {
                Mood::Failed
            } else {
                Mood::Tried
            };
            let fits = slots(predicate)
                .iter()
                .map(|slots| judge.fit(predicate, mood, slots, fact))
                .max()
                .unwrap_or(MatchQuality::Maybe);
            match fits {
                MatchQuality::Yes => Ruling::supported(ClaimKind::Last, step),
                MatchQuality::No
                    if kind_of(predicate.act) != ClaimKind::Outcome
                        && predicate.act != Act::See =>
                {
                    Ruling::contradicted(ClaimKind::Last, last, step)
                }
                _ => Ruling::unknown(ClaimKind::Last),
            }
        }];
    }
}
