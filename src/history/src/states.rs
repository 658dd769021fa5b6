//! Claims of what was seen and of how things stand. Never of deeds.

use reel_world::DoorState;

use crate::{
    claim::ClaimKind,
    clause::{Arg, Predicate, State},
    facts::Fact,
    grammar::{Act, Prep},
    judge::{Judge, Ruling, Slots, slots},
    names::{MatchQuality, Referent},
};

impl Judge<'_> {
    /// Judges having seen things, or none.
    pub(crate) fn sights(
        &self,
        predicate: &Predicate,
        until: usize,
        place: Option<&Arg>,
        thing: Option<&Arg>,
    ) -> Vec<Ruling> {
        let all = slots(predicate);
        all.iter()
            .map(|slots| {
                let vague = slots
                    .object
                    .is_none_or(|arg| arg.pronoun || arg.referent.any_object);
                let meant = if vague {
                    thing.or(slots.object)
                } else {
                    slots.object
                };
                self.sight(
                    predicate,
                    &Slots {
                        object: slots.object,
                        place: slots.place.or(place),
                        ..*slots
                    },
                    meant,
                    until,
                )
            })
            .collect()
    }

    fn sight(
        &self,
        predicate: &Predicate,
        slots: &Slots,
        meant: Option<&Arg>,
        until: usize,
    ) -> Ruling {
        let kind = ClaimKind::Sight;
        let anything = Referent::anything();
        let referent = meant.map_or(&anything, |arg| &arg.referent);
        let said = slots.object;
        if said.is_some_and(|arg| arg.other)
            || referent.is_receptacle() && !referent.is_object()
            || said.is_none() && !predicate.passive
        {
            return Ruling::unknown(kind);
        }
        let seen_by = |index: usize, fact: &Fact| -> MatchQuality {
            self.seen(index, fact, referent, slots.place)
        };
        let facts = &self.facts.all[..until.min(self.facts.now())];
        let seen: Vec<(usize, MatchQuality)> = facts
            .iter()
            .enumerate()
            .map(|(index, fact)| (index, seen_by(index, fact)))
            .collect();
        let yes: Vec<usize> = seen
            .iter()
            .filter(|(_, fit)| *fit == MatchQuality::Yes)
            .map(|(index, _)| *index)
            .collect();
        let maybe = seen.iter().any(|(_, fit)| *fit == MatchQuality::Maybe);
        let step = yes.first().and_then(|index| self.facts.step(*index));
        if predicate.negated || said.is_some_and(|arg| arg.no) {
            return self.not_seen(referent, slots.place, facts, &yes, maybe);
        }
        if let Some((count, span)) = said.and_then(|arg| arg.count.clone()) {
            return self.counted_sight(referent, slots.place, facts, (count, span));
        }
        let complete = self.names.setting().complete;
        match (yes.is_empty(), maybe || !complete || referent.open) {
            (false, _) => Ruling {
                matches: yes,
                ..Ruling::supported(kind, step)
            },
            (true, true) => Ruling::unknown(kind),
            (true, false) => Ruling::contradicted(kind, "it was never seen there", None),
        }
    }

    /// Whether a deed showed what a phrase means, there.
    fn seen(
        &self,
        index: usize,
        fact: &Fact,
        referent: &Referent,
        place: Option<&Arg>,
    ) -> MatchQuality {
        let there = |thing: usize| {
            let Some(arg) = place else {
                return MatchQuality::Yes;
            };
            let located = self
                .facts
                .place_of(thing, index + 1)
                .or_else(|| self.facts.place_of(thing, index));
            located.map_or(MatchQuality::Maybe, |place| {
                arg.referent.fits_receptacle(Some(place))
            })
        };
        let all = fact.seen.iter().chain(&fact.marked);
        all.map(|thing| referent.fits_object(Some(*thing)).min(there(*thing)))
            .max()
            .unwrap_or(MatchQuality::No)
    }

    fn not_seen(
        &self,
        referent: &Referent,
        place: Option<&Arg>,
        facts: &[Fact],
        yes: &[usize],
        maybe: bool,
    ) -> Ruling {
        let kind = ClaimKind::Sight;
        let here = |fact: &&Fact| {
            place.is_none_or(|arg| {
                fact.at
                    .iter()
                    .any(|at| arg.referent.fits_receptacle(Some(*at)) > MatchQuality::No)
            })
        };
        let in_vain = facts
            .iter()
            .filter(here)
            .filter(|fact| fact.found_nothing())
            .find(|fact| {
                fact.act == Some(Act::Explore)
                    || referent.any_object
                    || self.names.same(
                        fact.step_facts.argument.as_deref().unwrap_or(""),
                        &referent.words,
                    )
            });
        if let Some(fact) = in_vain {
            return Ruling::supported(kind, Some(fact.step_facts.step));
        }
        // without a place, `nothing` may be about any look
        if referent.any_object && place.is_none()
            || maybe
            || referent.open
            || !self.names.setting().complete
        {
            return Ruling::unknown(kind);
        }
        match yes.last() {
            Some(index) => Ruling::contradicted(kind, "it was seen", self.facts.step(*index)),
            None if facts.iter().any(|fact| here(&fact)) => Ruling::supported(kind, None),
            None => Ruling::unknown(kind),
        }
    }

    fn counted_sight(
        &self,
        referent: &Referent,
        place: Option<&Arg>,
        facts: &[Fact],
        (count, span): (u32, std::ops::Range<usize>),
    ) -> Ruling {
        let kind = ClaimKind::Sight;
        let count = count as usize;
        let mut last = None;
        for (index, fact) in facts.iter().enumerate() {
            let fits = |thing: &&usize| {
                let there = place.is_none_or(|arg| {
                    self.facts.place_of(**thing, index + 1).is_none_or(|place| {
                        arg.referent.fits_receptacle(Some(place)) > MatchQuality::No
                    })
                });
                there && referent.fits_object(Some(**thing)) > MatchQuality::No
            };
            let counts = [
                fact.seen.iter().filter(fits).count(),
                fact.marked.iter().filter(fits).count(),
            ];
            if counts.contains(&count) && (count > 0 || fact.found_nothing()) {
                return Ruling {
                    matches: vec![index],
                    ..Ruling::supported(kind, Some(fact.step_facts.step))
                };
            }
            if matches!(fact.act, Some(Act::Search | Act::Explore)) && counts[1] > 0 {
                last = Some((index, counts[1]));
            } else if last.is_none() && counts[0] > 0 {
                last = Some((index, counts[0]));
            }
        }
        // counted in two looks: each of several is one
        let all: std::collections::BTreeSet<usize> = facts
            .iter()
            .flat_map(|fact| fact.seen.iter().chain(&fact.marked))
            .copied()
            .filter(|thing| referent.fits_object(Some(*thing)) > MatchQuality::No)
            .collect();
        if !self.names.setting().complete || referent.open || all.len() == count {
            return Ruling::unknown(kind);
        }
        match last {
            Some((index, found)) => {
                let fix = (found > 1 && count > 1).then(|| (span, found.to_string()));
                Ruling::contradicted(kind, format!("{found} were seen"), self.facts.step(index))
                    .with_fix(fix)
            }
            None => Ruling::contradicted(kind, "none was seen", None),
        }
    }

    /// Judges how things stand at any of some moments.
    pub(crate) fn state(&self, predicate: &Predicate, moments: &[usize]) -> Vec<Ruling> {
        if predicate.user || predicate.mood != crate::clause::Mood::Done {
            return Vec::new();
        }
        let subject = predicate.subjects.last();
        let direct = predicate
            .args
            .iter()
            .find(|arg| arg.prep == Prep::Direct && !arg.user);
        let at = predicate
            .args
            .iter()
            .find(|arg| arg.prep == Prep::At && (arg.hand || arg.referent.is_receptacle()));
        let negated = predicate.negated;
        match predicate.act {
            Act::Be => match (predicate.state, subject) {
                (Some(State::Open | State::Closed), _) => self.doors(predicate, moments),
                (Some(State::Empty | State::Free), Some(hand)) if hand.hand => {
                    vec![self.holding(None, None, !negated, moments)]
                }
                (Some(State::Empty), _) => self
                    .places_of(predicate)
                    .map(|place| self.located(None, place, !negated, moments))
                    .collect(),
                (Some(State::Visible), Some(thing)) if thing.referent.is_object() => {
                    let as_sight = Slots {
                        object: Some(thing),
                        place: None,
                        marker: None,
                    };
                    vec![self.sight(
                        &Predicate {
                            passive: true,
                            ..predicate.clone()
                        },
                        &as_sight,
                        Some(thing),
                        self.facts.now(),
                    )]
                }
                (None, Some(marker)) if marker.marker.is_some() && !negated => direct
                    .map(|what| self.marker(marker, what))
                    .into_iter()
                    .collect(),
                (None, Some(thing))
                    if direct.is_some_and(|arg| arg.marker.is_some()) && !negated =>
                {
                    direct
                        .map(|marker| self.marker(marker, thing))
                        .into_iter()
                        .collect()
                }
                (None, _) if predicate.existential => match (direct, at) {
                    (Some(thing), Some(place)) if !place.hand => {
                        vec![self.located(Some(thing), place, negated, moments)]
                    }
                    _ => Vec::new(),
                },
                (None, Some(thing)) => match at {
                    Some(place) if place.hand => {
                        vec![self.holding(Some(thing), Some(thing), negated, moments)]
                    }
                    Some(place) => vec![self.located(Some(thing), place, negated, moments)],
                    None => Vec::new(),
                },
                (None, None) if predicate.agent => at
                    .filter(|at| !at.hand)
                    .map(|place| self.standing(place, negated, moments))
                    .into_iter()
                    .collect(),
                _ => Vec::new(),
            },
            Act::Hold | Act::Have | Act::Contain => match subject.filter(|arg| !arg.hand) {
                Some(place) if place.referent.is_receptacle() => match direct {
                    Some(thing) if !thing.door => {
                        vec![self.located(Some(thing), place, negated, moments)]
                    }
                    _ => Vec::new(),
                },
                Some(_) => Vec::new(),
                None if predicate.act == Act::Contain => Vec::new(),
                None => match direct {
                    Some(thing)
                        if thing.door
                            || thing.referent.is_receptacle() && !thing.referent.is_object()
                            || thing.marker.is_some() =>
                    {
                        Vec::new()
                    }
                    Some(thing) => vec![self.holding(Some(thing), Some(thing), negated, moments)],
                    None => Vec::new(),
                },
            },
            Act::Leave => match (subject.filter(|_| predicate.passive).or(direct), at) {
                (Some(thing), Some(place)) if thing.referent.is_object() && !place.hand => {
                    vec![self.located(Some(thing), place, negated, moments)]
                }
                _ => Vec::new(),
            },
            _ => Vec::new(),
        }
    }

    fn places_of<'p>(&self, predicate: &'p Predicate) -> impl Iterator<Item = &'p Arg> {
        predicate
            .subjects
            .iter()
            .filter(|arg| arg.referent.is_receptacle() && !arg.pronoun && !arg.referent.any_place)
    }

    fn doors(&self, predicate: &Predicate, moments: &[usize]) -> Vec<Ruling> {
        let kind = ClaimKind::DoorState;
        let wanted = if (predicate.state == Some(State::Open)) != predicate.negated {
            DoorState::Open
        } else {
            DoorState::Closed
        };
        let named = predicate
            .subjects
            .iter()
            .chain(predicate.args.iter().filter(|arg| arg.prep == Prep::Of));
        let judge = |arg: &Arg| {
            let (places, sure): (Vec<usize>, bool) = if arg.pronoun || arg.referent.any_place {
                ((0..self.names.setting().places.len()).collect(), false)
            } else {
                (
                    arg.referent.places.clone(),
                    arg.referent.maybe_places.is_empty(),
                )
            };
            let states: Vec<DoorState> = places
                .iter()
                .flat_map(|place| {
                    moments
                        .iter()
                        .filter_map(|moment| self.facts.door(*place, *moment))
                })
                .collect();
            match (states.is_empty(), states.contains(&wanted)) {
                (true, _) => Ruling::unknown(kind),
                (false, true) => Ruling::supported(kind, None),
                (false, false) if sure => {
                    Ruling::contradicted(kind, format!("it is {}", states[0]), None)
                }
                (false, false) => Ruling::unknown(kind),
            }
        };
        named.take(1).map(judge).collect()
    }

    /// Holding a thing (none: anything), or not.
    fn holding(
        &self,
        thing: Option<&Arg>,
        shown: Option<&Arg>,
        negated: bool,
        moments: &[usize],
    ) -> Ruling {
        let kind = ClaimKind::Hold;
        let fits = |moment: &usize| match (self.facts.held(*moment), thing) {
            _ if !self.facts.holds(*moment) => MatchQuality::No,
            (_, None) => MatchQuality::Yes,
            (held, Some(arg)) => arg.referent.fits_object(held),
        };
        let fits: Vec<MatchQuality> = moments.iter().map(fits).collect();
        let step = moments
            .last()
            .and_then(|moment| moment.checked_sub(1))
            .and_then(|index| self.facts.step(index));
        let held = moments.last().and_then(|moment| self.facts.held(*moment));
        match negated {
            false if fits.contains(&MatchQuality::Yes) => Ruling::supported(kind, step),
            true if fits.contains(&MatchQuality::No) => Ruling::supported(kind, step),
            _ if fits.contains(&MatchQuality::Maybe) => Ruling::unknown(kind),
            false => {
                let fix = held.zip(shown).map(|(held, arg)| {
                    (arg.span.clone(), format!("the {}", self.names.call(held)))
                });
                let why = held.map_or("nothing is held".to_owned(), |held| {
                    format!("the {} is held", self.names.call(held))
                });
                Ruling::contradicted(kind, why, step).with_fix(fix)
            }
            true => Ruling::contradicted(kind, "it is held", step),
        }
    }

    /// A thing (none: anything) at a place, or not.
    fn located(
        &self,
        thing: Option<&Arg>,
        place: &Arg,
        negated: bool,
        moments: &[usize],
    ) -> Ruling {
        let kind = ClaimKind::Location;
        let anything = Referent {
            any_object: true,
            ..Referent::default()
        };
        let referent = thing.map_or(&anything, |arg| &arg.referent);
        let negated = negated || thing.is_some_and(|arg| arg.no);
        let vague = thing.is_some_and(|arg| arg.pronoun || arg.other || arg.door)
            || place.pronoun
            || place.referent.any_place;
        if vague || !referent.is_object() || !self.names.setting().complete {
            return Ruling::unknown(kind);
        }
        let there = |thing: usize, moment: usize| match self.facts.place_of(thing, moment) {
            None => MatchQuality::No,
            at => place.referent.fits_receptacle(at),
        };
        let things = 0..self.names.setting().things.len();
        let fit = |moment: usize| {
            things
                .clone()
                .map(|thing| referent.fits_object(Some(thing)).min(there(thing, moment)))
                .max()
                .unwrap_or(MatchQuality::No)
        };
        let number = |moment: usize| {
            things
                .clone()
                .filter(|thing| {
                    referent
                        .fits_object(Some(*thing))
                        .min(there(*thing, moment))
                        > MatchQuality::No
                })
                .count()
        };
        let fits: Vec<MatchQuality> = moments.iter().map(|moment| fit(*moment)).collect();
        if let (Some((count, _)), false) = (thing.and_then(|arg| arg.count.as_ref()), negated) {
            let numbers: Vec<usize> = moments.iter().map(|moment| number(*moment)).collect();
            return match numbers.contains(&(*count as usize)) {
                true => Ruling::supported(kind, None),
                false
                    if (*count as usize) > numbers.iter().copied().max().unwrap_or(0)
                        && !referent.any_object =>
                {
                    Ruling::contradicted(
                        kind,
                        format!("there are {}", numbers.last().unwrap_or(&0)),
                        None,
                    )
                }
                false => Ruling::unknown(kind),
            };
        }
        let told_empty = || {
            let here = |fact: &Fact| {
                fact.at
                    .iter()
                    .any(|at| place.referent.fits_receptacle(Some(*at)) > MatchQuality::No)
            };
            self.facts
                .all
                .iter()
                .any(|fact| fact.found_nothing() && here(fact))
        };
        match negated {
            false if fits.contains(&MatchQuality::Yes) => Ruling::supported(kind, None),
            true if fits.contains(&MatchQuality::No) || told_empty() => {
                Ruling::supported(kind, None)
            }
            _ if fits.contains(&MatchQuality::Maybe) || referent.open => Ruling::unknown(kind),
            false => Ruling::contradicted(kind, "it is not there", None),
            true => Ruling::contradicted(kind, "it is there", None),
        }
    }

    /// Being at a place.
    fn standing(&self, place: &Arg, negated: bool, moments: &[usize]) -> Ruling {
        let kind = ClaimKind::Visit;
        let at = |moment: &usize| {
            let fact = moment
                .checked_sub(1)
                .and_then(|index| self.facts.all.get(index));
            fact.map_or(MatchQuality::No, |fact| {
                fact.at
                    .iter()
                    .map(|at| place.referent.fits_receptacle(Some(*at)))
                    .max()
                    .unwrap_or(MatchQuality::Maybe)
            })
        };
        let fits: Vec<MatchQuality> = moments.iter().map(at).collect();
        match negated {
            false if fits.contains(&MatchQuality::Yes) => Ruling::supported(kind, None),
            true if fits.contains(&MatchQuality::No) => Ruling::supported(kind, None),
            _ if fits.contains(&MatchQuality::Maybe) => Ruling::unknown(kind),
            false => Ruling::contradicted(kind, "the robot is elsewhere", None),
            true => Ruling::contradicted(kind, "the robot is there", None),
        }
    }

    /// What a marker stood for.
    fn marker(&self, marker: &Arg, what: &Arg) -> Ruling {
        let kind = ClaimKind::Marker;
        let fit = |fact: &Fact| {
            let mark = fact
                .step_facts
                .markers
                .iter()
                .find(|mark| Some(mark.number) == marker.marker)?;
            let place = mark
                .receptacle
                .as_deref()
                .map(|id| what.referent.fits_receptacle(self.names.receptacle(id)));
            let thing = mark
                .object
                .as_deref()
                .map(|key| what.referent.fits_object(self.names.object(key)));
            place.or(thing)
        };
        let fits: Vec<MatchQuality> = self.facts.all.iter().filter_map(fit).collect();
        if fits.contains(&MatchQuality::Yes) {
            Ruling::supported(kind, None)
        } else if fits.contains(&MatchQuality::Maybe)
            || what.referent.open
            || what.pronoun
            || !self.names.setting().complete
        {
            Ruling::unknown(kind)
        } else {
            Ruling::contradicted(kind, "the marker stood for something else", None)
        }
    }
}
