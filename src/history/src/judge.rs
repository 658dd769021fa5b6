//! Claims of deeds beside the deeds. Never reads a text; what may be so is
//! left open, never refuted.

mod predicate;

use std::ops::Range;

use crate::{
    claim::{ClaimKind, ClaimVerdict},
    clause::{Arg, Mood, Predicate},
    content::Agreement,
    facts::{Fact, Facts},
    grammar::{Act, Prep},
    names::{MatchQuality, Names, Referent, looks_like_id},
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

    /// How a deed fits a predicate in a mood.
    pub(crate) fn fit(
        &self,
        predicate: &Predicate,
        mood: Mood,
        slots: &Slots,
        fact: &Fact,
    ) -> MatchQuality {
        let outcome = match mood {
            Mood::Done => fact.done(),
            Mood::Failed => !fact.ok(),
            _ => true,
        };
        if !outcome {
            return MatchQuality::No;
        }
        let act = self.fit_act(predicate.act, slots, fact);
        if act == MatchQuality::No {
            return MatchQuality::No;
        }
        let place = slots.place.map_or(MatchQuality::Yes, |arg| {
            self.fit_place(predicate.act, arg, fact)
        });
        let thing = slots.object.map_or(MatchQuality::Yes, |arg| {
            self.fit_thing(predicate.act, &arg.referent, fact)
        });
        let marker = self.fit_marker(predicate, slots, fact);
        act.min(place).min(thing).min(marker)
    }

    fn fit_marker(&self, predicate: &Predicate, slots: &Slots, fact: &Fact) -> MatchQuality {
        if slots.marker.is_none() {
            return MatchQuality::Yes;
        }
        match fact.marker {
            Some(given) if predicate.all_args().any(|arg| arg.marker == Some(given)) => {
                MatchQuality::Yes
            }
            // a place that is named says it better than the number, which may be the object's
            Some(_) if predicate.act == Act::Place && slots.place.is_some() => MatchQuality::Maybe,
            _ => MatchQuality::No,
        }
    }

    fn fit_act(&self, act: Act, slots: &Slots, fact: &Fact) -> MatchQuality {
        let Some(done) = fact.act else {
            return MatchQuality::No;
        };
        let yes = match act {
            // the robot drives up to a receptacle that it gazes at, too
            Act::Go => done == Act::Go || done == Act::Gaze,
            Act::Carry => {
                matches!(done, Act::Go | Act::Place | Act::Gaze)
                    || slots.place.is_none() && done == Act::Pick
            }
            Act::Get => matches!(done, Act::Pick | Act::Go),
            Act::Check => true,
            Act::Explore if done != Act::Explore => return MatchQuality::No,
            Act::Search if done == Act::Explore || done == Act::Go => return MatchQuality::Maybe,
            Act::Mark => done == Act::Mark || done == Act::Search,
            act => done == act,
        };
        if yes {
            MatchQuality::Yes
        } else {
            MatchQuality::No
        }
    }

    fn fit_place(&self, act: Act, arg: &Arg, fact: &Fact) -> MatchQuality {
        if arg.marker.is_some() && !matches!(act, Act::Go | Act::Check) {
            return MatchQuality::Yes;
        }
        if arg.referent.open {
            return MatchQuality::Maybe;
        }
        let at = |places: &[usize]| {
            places
                .iter()
                .map(|place| arg.referent.fits_receptacle(Some(*place)))
                .max()
                .unwrap_or(MatchQuality::No)
        };
        let fit = match act {
            Act::Go | Act::Carry if fact.place.is_none() && fact.act == Some(Act::Go) => {
                let same = fact
                    .step_facts
                    .argument
                    .as_deref()
                    .is_some_and(|argument| argument.to_lowercase() == arg.referent.words);
                return if same {
                    MatchQuality::Yes
                } else {
                    MatchQuality::No
                };
            }
            Act::Go if fact.act == Some(Act::Gaze) => at(&fact.at),
            _ if arg.referent.any_place => MatchQuality::Yes,
            Act::Mark => at(&fact.at).max(at(&fact.marked_places)),
            Act::Check | Act::Search | Act::Explore => at(&fact.at),
            _ => arg.referent.fits_receptacle(fact.place),
        };
        // a room, or a word that is not known
        if looks_like_id(&arg.referent.words) && arg.referent.places.is_empty() {
            MatchQuality::No
        } else {
            fit
        }
    }

    fn fit_thing(&self, act: Act, referent: &Referent, fact: &Fact) -> MatchQuality {
        if referent.open {
            return MatchQuality::Maybe;
        }
        match act {
            Act::Search if fact.act == Some(Act::Search) => {
                if referent.any_object
                    || self.names.same(
                        fact.step_facts.argument.as_deref().unwrap_or(""),
                        &referent.words,
                    )
                {
                    MatchQuality::Yes
                } else if referent.open || self.names.setting().things.is_empty() {
                    MatchQuality::Maybe
                } else {
                    MatchQuality::No
                }
            }
            Act::Search => {
                let spoken_of = self.names.mentions(&referent.words);
                if spoken_of || referent.open {
                    MatchQuality::Maybe
                } else {
                    MatchQuality::No
                }
            }
            Act::Mark if fact.act == Some(Act::Mark) => {
                if referent.is_receptacle() || referent.any_object {
                    MatchQuality::Yes
                } else {
                    MatchQuality::Maybe
                }
            }
            Act::Mark => self.fit_thing(Act::Search, referent, fact),
            Act::Carry if fact.act != Some(Act::Place) && fact.act != Some(Act::Pick) => referent
                .fits_object(fact.held)
                .min(if fact.step_facts.held.is_some() || referent.any_object {
                    MatchQuality::Yes
                } else {
                    MatchQuality::No
                }),
            Act::Check | Act::Go if fact.act != Some(Act::Gaze) => {
                if fact
                    .seen
                    .iter()
                    .any(|thing| referent.fits_object(Some(*thing)) > MatchQuality::No)
                {
                    MatchQuality::Maybe
                } else {
                    MatchQuality::No
                }
            }
            Act::Gaze if referent.is_receptacle() && !referent.is_object() => {
                referent.fits_receptacle(fact.place)
            }
            Act::Gaze if fact.object.is_none() && fact.place.is_some() => {
                if referent.any_object {
                    MatchQuality::Yes
                } else {
                    MatchQuality::No
                }
            }
            Act::Pick if fact.object.is_none() && fact.place.is_some() => {
                referent.fits_receptacle(fact.place)
            }
            _ if self.names.setting().complete || fact.object.is_some() || !fact.ok() => {
                match fact.object {
                    None if referent.any_object => MatchQuality::Yes,
                    None if fact.ok() => MatchQuality::Maybe,
                    None => MatchQuality::Maybe,
                    thing => referent.fits_object(thing),
                }
            }
            _ => MatchQuality::Maybe.max(referent.fits_object(fact.object)),
        }
    }

    fn counted(
        &self,
        predicate: &Predicate,
        slots: &Slots,
        count: u32,
        span: &Range<usize>,
    ) -> Ruling {
        let kind = kind_of(predicate.act);
        let count = count as usize;
        let until = self.facts.now();
        let fits =
            |fact: &&Fact| self.fit(predicate, predicate.mood, slots, fact) > MatchQuality::No;
        let facts: Vec<&Fact> = self.facts.all[..until].iter().filter(fits).collect();
        let distinct = |values: &mut dyn Iterator<Item = usize>| {
            let mut values: Vec<usize> = values.collect();
            values.sort_unstable();
            values.dedup();
            values.len()
        };
        let (least, most) = match predicate.act {
            Act::Go | Act::Check => {
                let (driven, all) = self.facts.visited();
                let meant = |places: &[usize]| {
                    let arg = slots.place.or(slots.object);
                    places
                        .iter()
                        .filter(|place| {
                            arg.is_none_or(|arg| {
                                arg.referent.fits_receptacle(Some(**place)) > MatchQuality::No
                                    || arg.referent.any_object
                            })
                        })
                        .count()
                };
                (meant(&driven), meant(&all))
            }
            Act::Mark | Act::Search => {
                let sizes: Vec<usize> = facts
                    .iter()
                    .map(|fact| fact.step_facts.markers.len())
                    .collect();
                if sizes.contains(&count) {
                    (count, count)
                } else {
                    sizes.last().map_or((0, 0), |size| (*size, *size))
                }
            }
            Act::Pick | Act::Place if self.names.setting().complete => {
                let number = distinct(&mut facts.iter().filter_map(|fact| fact.object));
                (number, number)
            }
            _ => return Ruling::unknown(kind),
        };
        let step = facts.last().map(|fact| fact.step_facts.step);
        if (least..=most).contains(&count) {
            return Ruling::supported(kind, step);
        }
        if count < least && !predicate.only && matches!(predicate.act, Act::Go | Act::Check) {
            // an earlier count may have been left standing
            return Ruling::unknown(kind);
        }
        Ruling::contradicted(kind, format!("it was {least}"), step)
            .with_fix((least > 1 && count > 1).then(|| (span.clone(), least.to_string())))
    }

    fn all_places(&self, predicate: &Predicate, arg: &Arg, kind: ClaimKind) -> Ruling {
        let (_, visited) = self.facts.visited();
        let meant = &arg.referent.places;
        if meant.is_empty() || !matches!(predicate.act, Act::Go | Act::Check | Act::Explore) {
            return Ruling::unknown(kind);
        }
        let missing: Vec<&str> = meant
            .iter()
            .filter(|place| !visited.contains(place))
            .map(|place| self.names.setting().places[*place].id.as_str())
            .collect();
        match (missing.is_empty(), predicate.negated) {
            (true, false) if predicate.act != Act::Explore => Ruling::supported(kind, None),
            (false, false) => Ruling::contradicted(
                kind,
                format!("{} was not visited", missing.join(", ")),
                None,
            ),
            (true, true) => Ruling::contradicted(kind, "all were visited", None),
            _ => Ruling::unknown(kind),
        }
    }

    /// `I only visited X`: any other place visited refutes it.
    fn only_visited(&self, predicate: &Predicate) -> Ruling {
        let (driven, _) = self.facts.visited();
        let named = |place: usize| {
            predicate.all_args().any(|arg| {
                arg.count.is_some() || arg.referent.fits_receptacle(Some(place)) > MatchQuality::No
            })
        };
        match driven.iter().find(|place| !named(**place)) {
            Some(place) => Ruling::contradicted(
                ClaimKind::Visit,
                format!("{} was visited too", self.names.setting().places[*place].id),
                None,
            ),
            None => Ruling::supported(ClaimKind::Visit, None),
        }
    }

    fn asked(&self, predicate: &Predicate, until: usize) -> Ruling {
        let kind = ClaimKind::Ask;
        let asks: Vec<usize> = (0..until.min(self.facts.now()))
            .filter(|index| self.facts.all[*index].act == Some(Act::Ask))
            .collect();
        let step = asks.first().and_then(|index| self.facts.step(*index));
        if predicate.user {
            return Ruling::unknown(kind);
        }
        if predicate.negated {
            return if asks.is_empty() {
                Ruling::supported(kind, None)
            } else {
                Ruling::contradicted(kind, "the user was asked", step)
            };
        }
        if asks.is_empty() {
            return Ruling::contradicted(kind, "the user was not asked", None);
        }
        let questions = || {
            asks.iter()
                .filter_map(|index| self.facts.all[*index].step_facts.argument.as_deref())
        };
        if predicate.content.quote.is_some()
            && predicate.content.quotes(questions()) == Agreement::Other
        {
            return Ruling::contradicted(kind, "the question was another", step);
        }
        let detail = self.in_detail(predicate, &asks, kind);
        Ruling {
            matches: asks,
            ..detail.unwrap_or_else(|| Ruling::supported(kind, step))
        }
    }

    fn said(&self, predicate: &Predicate, until: usize) -> Ruling {
        let kind = ClaimKind::Answer;
        if !predicate.user {
            return Ruling::unknown(kind);
        }
        let all = &self.facts.all[..until.min(self.facts.now())];
        let answered: Vec<usize> = (0..all.len())
            .filter(|index| all[*index].step_facts.reply.is_some())
            .collect();
        let replies = || {
            answered
                .iter()
                .filter_map(|index| all[*index].step_facts.reply.as_deref())
        };
        let step = answered.last().and_then(|index| self.facts.step(*index));
        let wants = predicate
            .verb
            .is_some_and(|verb| matches!(verb.base, "want" | "mean"));
        match (answered.is_empty(), predicate.negated) {
            (true, true) => return Ruling::supported(kind, None),
            (false, true) if predicate.content.words.is_empty() => {
                return Ruling::contradicted(kind, "the user answered", step);
            }
            (true, false) if !wants => {
                return Ruling::contradicted(kind, "the user said nothing", None);
            }
            (true, _) | (_, true) => return Ruling::unknown(kind),
            _ => {}
        }
        let agreement = match predicate.content.quote {
            Some(_) => predicate.content.quotes(replies()),
            None => {
                predicate
                    .content
                    .agrees(self.names, replies(), &self.names.setting().instruction)
            }
        };
        let ruling = match agreement {
            Agreement::Same => Ruling::supported(kind, step),
            Agreement::Other => Ruling::contradicted(
                kind,
                format!("the user said: {}", replies().next_back().unwrap_or("")),
                step,
            ),
            Agreement::Unclear => Ruling::unknown(kind),
        };
        Ruling {
            matches: answered.clone(),
            ..ruling
        }
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
