//! How well a deed fits a predicate: its mood, act, marker, place and object.

use super::{Judge, Slots};
use crate::{
    clause::{Arg, Mood, Predicate},
    facts::Fact,
    grammar::Act,
    names::{MatchQuality, Referent, looks_like_id},
};

impl Judge<'_> {
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
}
