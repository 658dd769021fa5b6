//! Reads a verb: which of its meanings it has, and whether it tells that something was done.
//! Never looks at phrases.

use crate::{
    clause::{Mood, Predicate, Reader},
    grammar::{Act, Class, Form, Link, Prep, Verb, verb},
    lex::Kind,
};

impl Reader<'_> {
    pub(super) fn verb(&mut self) {
        let at = self.at;
        let Some(mut verb) = verb(self.word_at(at)) else {
            return;
        };
        let next = self.class_at(at + 1);
        let after = self.before.clone();
        if after.determiner && matches!(verb.form, Form::Base | Form::Any) && !self.nominal(verb) {
            return self.phrase();
        }
        match verb.act {
            Act::Try
                if verb.form != Form::Gerund && matches!(next, Some(Class::To | Class::Verb)) =>
            {
                self.before.governor = Some((Mood::Tried, at));
                self.before.determiner = false;
                self.at += 1;
                return;
            }
            Act::Try if matches!(verb.form, Form::Base | Form::Any) => {
                self.before.doing = true;
                self.at += 1;
                return;
            }
            Act::Fail | Act::Succeed | Act::Manage if verb.form != Form::Gerund => {
                return self.went_well_or_not(verb);
            }
            Act::Be => return self.be(verb.form == Form::Present || self.before.be == Some(true)),
            Act::Say => return self.says(at, Act::Say, false),
            Act::Ask => return self.says(at, Act::Ask, false),
            Act::Finish if next == Some(Class::Verb) => {
                self.at += 1;
                return;
            }
            _ => {}
        }
        verb.act = self.sense(verb);
        let (mood, negated) = self.mood(verb);
        let governor = after.governor.map_or(at, |(_, governor)| governor);
        let span = self.tokens[governor].span.start..self.tokens[at].span.end;
        let passive = (after.be.is_some() || after.been) && verb.form != Form::Gerund;
        let present = verb.act == Act::Hold
            && !after.did
            && (verb.form == Form::Base
                || verb.form == Form::Present
                || verb.form == Form::Gerund && after.be == Some(true));
        let predicate = Predicate {
            mood,
            passive,
            present,
            verb: Some(verb),
            ..Predicate::new(verb.act, span)
        };
        self.before.not = negated;
        self.push(predicate);
        self.at += 1;
    }

    /// Whether a base form behind a determiner is a deed (`the pick failed`) rather than
    /// a thing (`the place`).
    pub(super) fn nominal(&self, verb: Verb) -> bool {
        let next = self.class_at(self.at + 1);
        let deed =
            matches!(next, Some(Class::Doing)) || self.word_at(self.at + 1).starts_with("fail");
        deed || self.last
            || verb.act == Act::Pick
            || matches!(next, Some(Class::Prep(Prep::Of))) && verb.act != Act::Place
    }

    fn went_well_or_not(&mut self, verb: Verb) {
        let (at, next) = (self.at, self.class_at(self.at + 1));
        let well = (verb.act != Act::Fail) != std::mem::take(&mut self.before.not);
        let mood = if well { Mood::Done } else { Mood::Failed };
        let governs = matches!(next, Some(Class::To))
            || self.word_at(at + 1) == "in" && self.class_at(at + 2) == Some(Class::Verb);
        if self.before.will || self.before.infinitive {
        } else if governs {
            self.before.governor = Some((mood, at));
        } else if verb.act != Act::Manage && !self.fail_last(mood) {
            let predicate = Predicate {
                mood,
                ..Predicate::new(Act::Fail, self.tokens[at].span.clone())
            };
            self.push(predicate);
            if mood == Mood::Failed {
                self.at += 1;
                self.reason_begins();
                return;
            }
        }
        self.at += 1;
        if mood == Mood::Failed
            && !governs
            && matches!(self.class_at(self.at), Some(Class::Prep(_)) | None)
        {
            self.reason_begins();
        }
    }

    /// Which of its meanings a verb has here.
    fn sense(&self, verb: Verb) -> Act {
        let next = self.word_at(self.at + 1);
        let ahead = |wanted: &[&str]| {
            self.tokens[self.at + 1..]
                .iter()
                .take(14)
                .any(|token| wanted.contains(&token.word()))
        };
        let soon = |wanted: &[&str]| {
            self.tokens[self.at + 1..]
                .iter()
                .take(4)
                .any(|token| wanted.contains(&token.word()))
        };
        match (verb.base, verb.act) {
            ("take", _) if soon(&["look", "glance", "stock", "picture"]) => Act::Check,
            ("put" | "place" | "set", _) if soon(&["markers", "numbers", "labels"]) => Act::Mark,
            ("get", _)
                if soon(&[
                    "candidate",
                    "candidates",
                    "match",
                    "matches",
                    "result",
                    "results",
                    "hit",
                    "hits",
                ]) =>
            {
                Act::See
            }
            ("walk", _) if next == "around" => Act::Explore,
            ("look" | "search", _) if next != "for" && !ahead(&["for"]) => Act::Check,
            (
                "take" | "move" | "relocate" | "transfer" | "return",
                Act::Pick | Act::Go | Act::Carry,
            ) if !self.goes_itself(verb) => Act::Carry,
            ("carry", _) if ahead(&["to", "into", "onto"]) => Act::Carry,
            ("remove", _) => Act::Pick,
            (_, act) => act,
        }
    }

    /// `took the mug` and `moved to table_1`, but not `took the mug to table_1`
    /// and `moved the mug`.
    fn goes_itself(&self, verb: Verb) -> bool {
        let mut rest = self.tokens[self.at + 1..]
            .iter()
            .take(14)
            .take_while(|token| token.kind == Kind::Word || token.kind == Kind::Number);
        match verb.act {
            Act::Pick => !rest.any(|token| matches!(token.word(), "to" | "into" | "onto")),
            _ => {
                let next = self.class_at(self.ahead(self.at + 1));
                matches!(
                    next,
                    Some(Class::To | Class::Prep(_) | Class::Link(_)) | None
                ) && self.before.be.is_none()
                    && !self.before.been
            }
        }
    }

    fn mood(&self, verb: Verb) -> (Mood, bool) {
        let before = &self.before;
        let base_of_previous = || {
            self.found
                .last()
                .filter(|_| matches!(before.link, Some(Link::And | Link::Or)))
        };
        let governed = before.governor.map(|(mood, _)| mood);
        let negated = before.not || before.without;
        match verb.form {
            // `without dropping it` does not deny the placing
            _ if negated && verb.base == "drop" => (Mood::Intent, negated),
            Form::Gerund => {
                let told = before.be == Some(false)
                    || matches!(before.link, Some(Link::After | Link::Before | Link::Sub))
                    || before.by;
                let holds = verb.act == Act::Hold && before.be.is_some();
                match governed {
                    Some(mood) => (mood, negated),
                    None if told || holds || before.without => (Mood::Done, negated),
                    None if before.be.is_some() || before.have || before.been => {
                        (Mood::Intent, negated)
                    }
                    None => (Mood::Mention, negated),
                }
            }
            _ if before.infinitive && governed.is_some() => {
                (governed.unwrap_or(Mood::Done), negated)
            }
            _ if before.infinitive && before.doing => (Mood::Mention, false),
            _ if before.will || before.infinitive => (Mood::Intent, negated),
            _ if before.can && (negated || verb.act == Act::See) => match verb.act {
                Act::See => (Mood::Done, negated),
                _ => (Mood::Failed, false),
            },
            _ if before.can => (Mood::Intent, negated),
            Form::Base | Form::Any if before.did => (Mood::Done, negated),
            Form::Base if before.determiner || before.doing => (Mood::Mention, false),
            Form::Base if before.agent && matches!(verb.act, Act::Hold | Act::See) => {
                (Mood::Done, negated)
            }
            Form::Base => match base_of_previous() {
                Some(previous) if previous.verb.is_some_and(|verb| verb.form == Form::Base) => {
                    (previous.mood, negated || previous.negated)
                }
                _ => (Mood::Intent, negated),
            },
            Form::Any if before.determiner => (Mood::Mention, false),
            Form::Participle if !before.have && before.be.is_none() && !before.been => {
                (Mood::Mention, negated)
            }
            Form::PastOrParticiple | Form::Participle if before.link == Some(Link::Or) => (
                Mood::Done,
                negated || self.found.last().is_some_and(|previous| previous.negated),
            ),
            _ => (Mood::Done, negated),
        }
    }
}
