//! Claims of deeds beside the deeds. Never reads a text; what may be so is
//! left open, never refuted.

mod dialogue;
mod fit;
mod predicate;
mod quantities;

use std::ops::Range;

use crate::{
    claim::{ClaimKind, ClaimVerdict},
    clause::{Arg, Mood, Predicate},
    facts::{Fact, Facts},
    grammar::{Act, Prep},
    names::{MatchQuality, Names},
};
use predicate::bare;
pub(crate) use predicate::{kind_of, slots};

/// What came of judging one claim. Spans are those of the sentence.
#[derive(Clone, Debug)]
pub(crate) struct Ruling {
    pub(crate) kind: ClaimKind,
    pub(crate) verdict: ClaimVerdict,
    pub(crate) fix: Vec<(Range<usize>, String)>,
    /// Indices of the deeds that it surely speaks of.
    pub(crate) matches: Vec<usize>,
}

impl Ruling {
    pub(crate) fn unknown(kind: ClaimKind) -> Self {
        Self {
            kind,
            verdict: ClaimVerdict::Unknown,
            fix: Vec::new(),
            matches: Vec::new(),
        }
    }

    pub(crate) fn supported(kind: ClaimKind, step: Option<u32>) -> Self {
        Self {
            verdict: ClaimVerdict::Supported { step },
            ..Self::unknown(kind)
        }
    }

    pub(crate) fn contradicted(kind: ClaimKind, why: impl Into<String>, step: Option<u32>) -> Self {
        Self {
            verdict: ClaimVerdict::Contradicted {
                why: why.into(),
                step,
            },
            ..Self::unknown(kind)
        }
    }

    pub(crate) fn with_fix(mut self, fix: Option<(Range<usize>, String)>) -> Self {
        self.fix.extend(fix);
        self
    }
}

/// One reading of a predicate's arguments: one object, one place.
#[derive(Clone, Copy, Default)]
pub(crate) struct Slots<'p> {
    pub(crate) object: Option<&'p Arg>,
    pub(crate) place: Option<&'p Arg>,
    pub(crate) marker: Option<u32>,
}

/// Compares predicates with what was done.
pub(crate) struct Judge<'a> {
    pub(crate) facts: &'a Facts,
    pub(crate) names: &'a Names,
}

impl Judge<'_> {
    /// Judges what is claimed to have been done (or not) in deeds up to `until`. `place` and
    /// `thing` are what an unnamed place or object stands for.
    pub(crate) fn step_facts(
        &self,
        predicate: &Predicate,
        cursor: usize,
        until: usize,
        place: Option<&Arg>,
        thing: Option<&Arg>,
    ) -> Vec<Ruling> {
        if matches!(predicate.mood, Mood::Intent | Mood::Mention) {
            return Vec::new();
        }
        match predicate.act {
            Act::Ask => return vec![self.asked(predicate, until)],
            Act::Say => return vec![self.said(predicate, until)],
            Act::Finish => return vec![self.finished(predicate, until)],
            Act::Call => return self.called(predicate),
            Act::Fail | Act::Succeed | Act::Try | Act::Manage => return Vec::new(),
            Act::See => return self.sights(predicate, until, place, thing),
            _ => {}
        }
        let mut rulings = Vec::new();
        for slots in slots(predicate) {
            let ruling = self.one_deed(predicate, &slots, cursor, until);
            rulings.push(ruling);
        }
        if predicate.only && predicate.act == Act::Go && !predicate.negated {
            rulings.push(self.only_visited(predicate));
        }
        rulings
    }

    fn one_deed(
        &self,
        predicate: &Predicate,
        slots: &Slots,
        cursor: usize,
        until: usize,
    ) -> Ruling {
        let kind = kind_of(predicate.act);
        if let Some(arg) = slots.place.filter(|arg| arg.all) {
            return self.all_places(predicate, arg, kind);
        }
        let counted = [slots.object, slots.place]
            .into_iter()
            .flatten()
            .find_map(|arg| arg.count.as_ref());
        if let (Some((count, span)), false) = (counted, predicate.negated) {
            return self.counted(predicate, slots, *count, span);
        }
        let facts = &self.facts.all[..until.min(self.facts.now())];
        let graded: Vec<(usize, MatchQuality)> = facts
            .iter()
            .enumerate()
            .map(|(index, fact)| (index, self.fit(predicate, predicate.mood, slots, fact)))
            .collect();
        let yes: Vec<usize> = graded
            .iter()
            .filter(|(_, fit)| *fit == MatchQuality::Yes)
            .map(|(index, _)| *index)
            .collect();
        let maybe = graded.iter().any(|(_, fit)| *fit == MatchQuality::Maybe);
        let chosen = yes
            .iter()
            .find(|index| **index >= cursor)
            .or(yes.last())
            .copied();
        let step = chosen.and_then(|index| self.facts.step(index));
        let ruling = match (predicate.negated, chosen, maybe) {
            (false, Some(_), _) => self
                .in_detail(predicate, &yes, kind)
                .unwrap_or_else(|| Ruling::supported(kind, step)),
            // a verb of taking without what was taken is an idiom
            (false, None, false) if bare(predicate, slots) => Ruling::unknown(kind),
            (false, None, false) => self.refute(predicate, slots, kind),
            (true, Some(_), _) => Ruling::contradicted(kind, "it was done", step),
            (true, None, false) => Ruling::supported(kind, None),
            (_, None, true) => Ruling::unknown(kind),
        };
        // the chosen deed first: it says where the story stands
        let mut matches = yes;
        if let Some(chosen) = chosen {
            matches.retain(|index| *index != chosen);
            matches.insert(0, chosen);
        }
        Ruling { matches, ..ruling }
    }

    /// How often, and why it failed.
    fn in_detail(&self, predicate: &Predicate, yes: &[usize], kind: ClaimKind) -> Option<Ruling> {
        let step = yes.last().and_then(|index| self.facts.step(*index));
        if let Some((times, _)) = &predicate.times {
            let found = yes.len();
            if *times as usize > found || predicate.only && *times as usize != found {
                let said = ["never", "once", "twice"]
                    .get(found)
                    .map_or_else(|| format!("{found} times"), ToString::to_string);
                return Some(Ruling::contradicted(
                    kind,
                    format!("it was done {said}"),
                    step,
                ));
            }
            if (*times as usize) < found {
                return Some(Ruling::unknown(kind));
            }
        }
        if !predicate.reasons.is_empty() && predicate.mood == Mood::Failed {
            let errors: Vec<&str> = yes
                .iter()
                .map(|index| self.facts.all[*index].error())
                .filter(|error| !error.is_empty())
                .collect();
            if !errors.is_empty() && !errors.iter().any(|error| predicate.reasons.contains(error)) {
                return Some(Ruling::contradicted(
                    ClaimKind::Outcome,
                    format!("it failed because of {}", errors.join(", ")),
                    step,
                ));
            }
        }
        None
    }

    /// Nothing of the kind was done: what was, and what to write instead.
    fn refute(&self, predicate: &Predicate, slots: &Slots, kind: ClaimKind) -> Ruling {
        let find = |mood: Mood, slots: &Slots| -> Vec<usize> {
            let fits = |fact: &Fact| self.fit(predicate, mood, slots, fact) == MatchQuality::Yes;
            self.facts
                .all
                .iter()
                .enumerate()
                .filter(|(_, fact)| fits(fact))
                .map(|(index, _)| index)
                .collect()
        };
        let step = |index: usize| self.facts.step(index);
        let verb = predicate
            .verb
            .filter(|_| !predicate.passive && predicate.args.len() <= 3);
        if predicate.mood == Mood::Done
            && let Some(index) = find(Mood::Failed, slots).last().copied()
        {
            let fix = verb.map(|verb| {
                (
                    predicate.verb_span.clone(),
                    format!("tried to {}", verb.base),
                )
            });
            return Ruling::contradicted(
                ClaimKind::Outcome,
                format!("it failed: {}", self.facts.all[index].error()),
                step(index),
            )
            .with_fix(fix);
        }
        if predicate.mood == Mood::Failed
            && let Some(index) = find(Mood::Done, slots).last().copied()
        {
            let governed =
                verb.filter(|verb| predicate.reasons.is_empty() && verb.act != Act::Fail);
            let fix = governed.map(|verb| (predicate.verb_span.clone(), verb.past.to_owned()));
            return Ruling::contradicted(ClaimKind::Outcome, "it succeeded", step(index))
                .with_fix(fix.filter(|(span, _)| span.len() > 8));
        }
        if let Some(arg) = slots.place {
            let elsewhere = find(
                predicate.mood,
                &Slots {
                    place: None,
                    ..*slots
                },
            );
            let mut places: Vec<usize> = elsewhere
                .iter()
                .filter_map(|index| self.facts.all[*index].place)
                .collect();
            places.sort_unstable();
            places.dedup();
            if let (Some(index), true) = (
                elsewhere.last(),
                slots.object.is_some() || slots.marker.is_some(),
            ) {
                let names: Vec<&str> = places
                    .iter()
                    .map(|place| self.names.setting().places[*place].id.as_str())
                    .collect();
                let fix = (names.len() == 1 && arg.marker.is_none())
                    .then(|| (arg.span.clone(), names[0].to_owned()));
                return Ruling::contradicted(
                    kind,
                    format!("it was {}", names.join(", ")),
                    step(*index),
                )
                .with_fix(fix);
            }
        }
        if let Some(arg) = slots.object.filter(|arg| arg.marker.is_none()) {
            let others = find(
                predicate.mood,
                &Slots {
                    object: None,
                    ..*slots
                },
            );
            let mut things: Vec<usize> = others
                .iter()
                .filter_map(|index| self.facts.all[*index].object)
                .collect();
            things.sort_unstable();
            things.dedup();
            if let ([thing], Some(index)) = (&things[..], others.last()) {
                let name = format!("the {}", self.names.call(*thing));
                return Ruling::contradicted(kind, format!("it was {name}"), step(*index))
                    .with_fix(Some((arg.span.clone(), name)));
            }
        }
        Ruling::contradicted(kind, "nothing of the kind was done", None)
    }

    fn finished(&self, predicate: &Predicate, until: usize) -> Ruling {
        let kind = ClaimKind::Finish;
        let what = predicate
            .all_args()
            .find(|arg| !arg.user)
            .map(|arg| arg.referent.words.as_str());
        if !what.is_none_or(|what| matches!(what, "episode" | "run" | "trial")) {
            return Ruling::unknown(kind);
        }
        let finish = self.facts.all[..until.min(self.facts.now())]
            .iter()
            .find(|fact| fact.act == Some(Act::Finish));
        match (finish, predicate.negated) {
            (Some(fact), false) => Ruling::supported(kind, Some(fact.step_facts.step)),
            (None, true) => Ruling::supported(kind, None),
            (Some(fact), true) => {
                Ruling::contradicted(kind, "the episode was finished", Some(fact.step_facts.step))
            }
            (None, false) => Ruling::contradicted(kind, "the episode was not finished", None),
        }
    }

    fn called(&self, predicate: &Predicate) -> Vec<Ruling> {
        let kind = ClaimKind::Call;
        let Some((name, said)) = predicate.content.words.split_first() else {
            return Vec::new();
        };
        let tool = reel_world::ToolSpec::paper_name_of(name);
        let same = |fact: &Fact| {
            let argument = fact.step_facts.argument.as_deref().map(str::to_lowercase);
            let given = said.is_empty() && predicate.content.quote.is_none();
            let place = predicate
                .args
                .iter()
                .find(|arg| arg.prep == Prep::At && arg.referent.is_receptacle());
            let there = place.is_none_or(|arg| {
                fact.at
                    .iter()
                    .any(|at| arg.referent.fits_receptacle(Some(*at)) > MatchQuality::No)
            });
            there
                && fact.step_facts.tool == tool
                && argument.is_none_or(|argument| given || predicate.content.holds(&argument))
        };
        let found: Vec<usize> = (0..self.facts.now())
            .filter(|index| same(&self.facts.all[*index]))
            .collect();
        let step = found.first().and_then(|index| self.facts.step(*index));
        vec![match (found.is_empty(), predicate.negated) {
            (false, false) => Ruling {
                matches: found,
                ..Ruling::supported(kind, step)
            },
            (true, false) => Ruling::contradicted(kind, "there was no such call", None),
            (false, true) => Ruling::contradicted(kind, "there was such a call", step),
            (true, true) => Ruling::supported(kind, None),
        }]
    }
}
