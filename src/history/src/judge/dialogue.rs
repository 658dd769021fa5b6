//! Claims of what the agent asked the user, and of what the user said.

use super::{Judge, Ruling};
use crate::{claim::ClaimKind, clause::Predicate, content::Agreement, grammar::Act};

impl Judge<'_> {
    pub(super) fn asked(&self, predicate: &Predicate, until: usize) -> Ruling {
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

    pub(super) fn said(&self, predicate: &Predicate, until: usize) -> Ruling {
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
}
