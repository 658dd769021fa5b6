//! Claims of how many, of all places, and of none besides.

use std::ops::Range;

use super::{Judge, Ruling, Slots, kind_of};
use crate::{
    claim::ClaimKind,
    clause::{Arg, Predicate},
    facts::Fact,
    grammar::Act,
    names::MatchQuality,
};

impl Judge<'_> {
    pub(super) fn counted(
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

    pub(super) fn all_places(&self, predicate: &Predicate, arg: &Arg, kind: ClaimKind) -> Ruling {
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
    pub(super) fn only_visited(&self, predicate: &Predicate) -> Ruling {
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
}
