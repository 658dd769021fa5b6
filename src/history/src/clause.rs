//! Reads a sentence as predicates: verbs with their polarity, mood and what belongs to them. Never judges; what it does not
//! understand it leaves out, or gives as an argument that may mean anything.

mod phrase;

use std::ops::Range;

use reel_world::ToolSpec;

use crate::{
    content::{Content, reasons},
    grammar::{Act, Class, Form, Link, Prep, Verb, class, verb},
    lex::{Kind, Token, tokens},
    names::{Names, Referent},
};

/// Whether a verb tells that something was done.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Mood {
    /// It was done.
    Done,
    /// It was tried.
    Tried,
    /// It was tried and failed.
    Failed,
    /// It is only spoken of: `the pick`, `opening`.
    Mention,
    /// It shall be done, or somebody else does it: no claim.
    Intent,
}

/// A state that a copula gives its subject.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum State {
    Open,
    Closed,
    Empty,
    Free,
    Visible,
}

/// A phrase that belongs to a verb.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Arg {
    pub(crate) prep: Prep,
    pub(crate) referent: Referent,
    /// In the sentence, in bytes.
    pub(crate) span: Range<usize>,
    /// `3 mugs`
    pub(crate) count: Option<(u32, Range<usize>)>,
    /// `marker 3`, or a number by itself.
    pub(crate) marker: Option<u32>,
    /// `no mug`, `nothing`
    pub(crate) no: bool,
    /// `all tables`
    pub(crate) all: bool,
    /// `another mug`, `nothing else`
    pub(crate) other: bool,
    /// `the door of ..`
    pub(crate) door: bool,
    /// `my hand`
    pub(crate) hand: bool,
    /// `the user`
    pub(crate) user: bool,
    /// `it`
    pub(crate) pronoun: bool,
}

/// A verb and what belongs to it.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Predicate {
    pub(crate) act: Act,
    pub(crate) mood: Mood,
    pub(crate) negated: bool,
    /// It speaks of the present.
    pub(crate) present: bool,
    pub(crate) passive: bool,
    /// `there is`
    pub(crate) existential: bool,
    /// The agent is its subject, or nobody is.
    pub(crate) agent: bool,
    /// The user is.
    pub(crate) user: bool,
    pub(crate) only: bool,
    /// The sentence speaks of the last action.
    pub(crate) last: bool,
    pub(crate) state: Option<State>,
    /// What stands before the verb.
    pub(crate) subjects: Vec<Arg>,
    /// What stands after it.
    pub(crate) args: Vec<Arg>,
    pub(crate) times: Option<(u32, Range<usize>)>,
    /// How it is joined to what stands before.
    pub(crate) link: Option<Link>,
    /// Whether a subordinate clause stands before its main clause.
    pub(crate) leading: bool,
    /// Error codes that the given reason may mean.
    pub(crate) reasons: Vec<&'static str>,
    /// What was asked or said.
    pub(crate) content: Content,
    /// In the sentence, in bytes.
    pub(crate) span: Range<usize>,
    /// Of the verb with its governor (`failed to pick`).
    pub(crate) verb_span: Range<usize>,
    pub(crate) verb: Option<Verb>,
}

impl Predicate {
    fn new(act: Act, span: Range<usize>) -> Self {
        Self {
            act,
            mood: Mood::Done,
            negated: false,
            present: false,
            passive: false,
            existential: false,
            agent: true,
            user: false,
            only: false,
            last: false,
            state: None,
            subjects: Vec::new(),
            args: Vec::new(),
            times: None,
            link: None,
            leading: false,
            reasons: Vec::new(),
            content: Content::default(),
            span: span.clone(),
            verb_span: span,
            verb: None,
        }
    }

    /// Subjects and arguments.
    pub(crate) fn all_args(&self) -> impl Iterator<Item = &Arg> {
        self.subjects.iter().chain(&self.args)
    }

    /// Whether a state is claimed rather than a deed.
    pub(crate) fn is_state(&self) -> bool {
        matches!(self.act, Act::Be | Act::Have | Act::Contain | Act::Leave) || self.act == Act::Hold
    }
}

/// The predicates of a sentence, in its order.
pub(crate) fn predicates(names: &Names, sentence: &str) -> Vec<Predicate> {
    if sentence.ends_with('?') {
        return Vec::new();
    }
    let tokens = tokens(sentence);
    let mut reader = Reader::new(names, &tokens);
    reader.read();
    let mut found = reader.found;
    if let Some(reason) = reader.reason_from {
        let codes = reasons(&sentence[reason.1..]);
        if let Some(predicate) = found.get_mut(reason.0) {
            predicate.reasons = codes;
        }
    }
    found
}

/// What stands before a verb in its clause.
#[derive(Clone, Default)]
struct Before {
    start: Option<usize>,
    not: bool,
    without: bool,
    will: bool,
    have: bool,
    /// The bool: present.
    be: Option<bool>,
    been: bool,
    did: bool,
    can: bool,
    infinitive: bool,
    /// `tried to`, `failed to`: the mood and where it begins.
    governor: Option<(Mood, usize)>,
    agent: bool,
    user: bool,
    there: bool,
    determiner: bool,
    doing: bool,
    only: bool,
    by: bool,
    link: Option<Link>,
    leading: bool,
}

struct Reader<'a> {
    names: &'a Names,
    tokens: &'a [Token],
    at: usize,
    found: Vec<Predicate>,
    before: Before,
    /// Phrases since the clause began, not yet given to a verb.
    pending: Vec<Arg>,
    /// Whether a boundary was met since the last verb.
    fresh: bool,
    /// Whether that boundary may continue a list.
    joins: bool,
    prep: Prep,
    last: bool,
    /// Which predicate's reason begins where, in bytes.
    reason_from: Option<(usize, usize)>,
}

impl<'a> Reader<'a> {
    fn new(names: &'a Names, tokens: &'a [Token]) -> Self {
        Self {
            names,
            tokens,
            at: 0,
            found: Vec::new(),
            before: Before::default(),
            pending: Vec::new(),
            fresh: true,
            joins: true,
            prep: Prep::Direct,
            last: false,
            reason_from: None,
        }
    }

    fn read(&mut self) {
        while let Some(token) = self.tokens.get(self.at) {
            match token.kind {
                Kind::Comma | Kind::Open | Kind::Close => self.skip(|reader| reader.boundary(None)),
                Kind::Colon => self.skip(|reader| {
                    reader.reason_begins();
                    reader.boundary(None);
                }),
                Kind::Number | Kind::Quote => self.phrase(),
                Kind::Word if self.is_call() => self.call(),
                Kind::Word => {
                    if class(token.word()) == Class::Hedge {
                        break;
                    }
                    self.word(class(token.word()));
                }
            }
        }
        self.flush();
        let end_of = |predicate: &Predicate| predicate.all_args().map(|arg| arg.span.end).max().unwrap_or(0);
        for predicate in &mut self.found {
            predicate.span.end = predicate.span.end.max(end_of(predicate));
            predicate.span.start = predicate.subjects.iter().map(|arg| arg.span.start).min().unwrap_or(usize::MAX).min(predicate.span.start);
            predicate.last = self.last;
        }
    }

    fn skip(&mut self, then: impl FnOnce(&mut Self)) {
        self.at += 1;
        then(self);
    }

    fn word_at(&self, at: usize) -> &'a str {
        self.tokens.get(at).map_or("", |token| token.word())
    }

    fn class_at(&self, at: usize) -> Option<Class> {
        self.tokens.get(at).filter(|token| token.kind == Kind::Word).map(|token| class(token.word()))
    }

    /// The next token that is no adverb or negation, from `at` on.
    fn ahead(&self, mut at: usize) -> usize {
        while matches!(self.class_at(at), Some(Class::Adverb | Class::Not | Class::Only | Class::Success(_))) {
            at += 1;
        }
        at
    }

    fn word(&mut self, class: Class) {
        let at = self.at;
        self.before.start.get_or_insert(at);
        let next = self.word_at(at + 1);
        match class {
            Class::No if next == "longer" => {
                self.at += 2;
                match self.found.last_mut() {
                    Some(last) if !self.fresh && last.act == Act::Be => last.negated = true,
                    _ => self.before.not = true,
                }
                return;
            }
            Class::Determiner | Class::No | Class::All | Class::Other | Class::It | Class::User | Class::Hand | Class::Number(_) | Class::Marker
            | Class::Door | Class::Noun => {
                if self.word_at(at) == "according" {
                    return self.says(at, Act::Say, true);
                }
                return self.phrase();
            }
            Class::Not => self.before.not = true,
            Class::Without => self.without(),
            Class::Only => self.before.only = true,
            Class::Have => return self.have(),
            Class::Be(present) => return self.be(present),
            Class::Been => self.before.been = true,
            Class::Did => self.before.did = true,
            Class::Can => self.before.can = true,
            Class::Will => self.before.will = true,
            Class::To => self.to(),
            Class::Prep(prep) => self.preposition(prep),
            Class::Link(link) => self.link(link),
            Class::Agent => self.before.agent = true,
            Class::There => self.before.there = self.fresh,
            Class::Times(times) => self.times(times),
            Class::Able(able) => {
                let able = able && !std::mem::take(&mut self.before.not);
                self.before.governor = Some((if able { Mood::Done } else { Mood::Failed }, at));
            }
            Class::Success(success) => self.outcome(success && !self.before.without),
            Class::Empty => self.complement(State::Empty),
            Class::Free => self.complement(State::Free),
            Class::Visible => self.complement(State::Visible),
            Class::Last => self.last |= self.is_last_action(),
            Class::Doing => self.before.doing = true,
            Class::Adverb | Class::Hedge => {}
            Class::Verb => return self.verb(),
        }
        self.at += 1;
    }

    /// `last action`, `the last thing I did`, `last I went`.
    fn is_last_action(&self) -> bool {
        let next = self.word_at(self.at + 1);
        matches!(class(next), Class::Doing) || matches!(next, "thing" | "tool" | "i" | "deed")
    }

    fn without(&mut self) {
        self.boundary(None);
        self.before.without = true;
    }

    fn have(&mut self) {
        let ahead = self.ahead(self.at + 1);
        let verb_follows = verb(self.word_at(ahead)).is_some_and(|verb| !matches!(verb.form, Form::Base | Form::Gerund | Form::Present));
        match self.class_at(ahead) {
            Some(Class::To) if self.tokens[self.at + 1..ahead].iter().any(|token| token.word() == "yet") => {
                self.before.not = true;
                self.before.governor = Some((Mood::Done, self.at));
            }
            Some(Class::To) => self.before.will = true,
            _ if verb_follows || matches!(self.class_at(ahead), Some(Class::Been | Class::Link(_) | Class::Prep(_) | Class::Agent) | None) => {
                self.before.have = true;
            }
            _ => {
                self.note_negation(self.at + 1, ahead);
                let present = self.word_at(self.at) != "had";
                self.push(Predicate { present, ..Predicate::new(Act::Have, self.tokens[self.at].span.clone()) });
                self.at = ahead;
                return;
            }
        }
        self.at += 1;
    }

    fn be(&mut self, present: bool) {
        let ahead = self.ahead(self.at + 1);
        let word = self.word_at(ahead);
        let adjective = matches!(word, "open" | "closed" | "shut");
        let verb_follows = !adjective && verb(word).is_some_and(|verb| !matches!(verb.form, Form::Base | Form::Present));
        if verb_follows || matches!(self.class_at(ahead), Some(Class::Able(_) | Class::Been | Class::Will | Class::Success(_))) {
            self.before.be = Some(present);
        } else if self.before.will || self.before.infinitive {
            // `must be open`: no claim
        } else {
            self.note_negation(self.at + 1, ahead);
            let state = match word {
                "open" => Some(State::Open),
                "closed" | "shut" => Some(State::Closed),
                _ => None,
            };
            self.push(Predicate { present, state, ..Predicate::new(Act::Be, self.tokens[self.at].span.clone()) });
            self.at = if adjective { ahead + 1 } else { ahead };
            return;
        }
        self.at += 1;
    }

    fn note_negation(&mut self, from: usize, to: usize) {
        self.before.not |= (from..to).any(|at| self.class_at(at) == Some(Class::Not));
        self.before.only |= (from..to).any(|at| self.class_at(at) == Some(Class::Only));
    }

    fn to(&mut self) {
        let next = self.word_at(self.ahead(self.at + 1));
        let base = verb(next).is_some_and(|verb| matches!(verb.form, Form::Base | Form::Any));
        if base || matches!(next, "be" | "have" | "do") {
            self.before.infinitive = true;
        } else {
            self.prep = Prep::To;
        }
    }

    fn preposition(&mut self, prep: Prep) {
        let before = self.at.checked_sub(1).map_or("", |at| self.word_at(at));
        self.prep = match (before, prep) {
            ("out", Prep::Of) => Prep::From,
            ("next", _) => Prep::Near,
            _ => prep,
        };
        self.before.by = self.word_at(self.at) == "by";
        // `as it has no door`
        if self.word_at(self.at) == "as" && matches!(self.class_at(self.at + 1), Some(Class::It | Class::Determiner | Class::Agent)) {
            self.reason_begins();
            self.boundary(Some(Link::Because));
        }
    }

    fn link(&mut self, link: Link) {
        if matches!(link, Link::Because | Link::But) {
            self.reason_begins();
        }
        // `after that`, `before that`
        let that = matches!(self.word_at(self.at + 1), "that" | "this" | "which") && matches!(link, Link::After | Link::Before);
        if that && !self.starts_clause(self.at + 2) || that && link == Link::After {
            self.at += 1;
            self.boundary((link == Link::After).then_some(Link::Then));
            return;
        }
        let previous = self.before.link;
        let leading = self.before.start.is_none_or(|start| start == self.at);
        self.boundary(Some(link));
        self.before.leading = leading;
        // `and then` is `then`
        if previous == Some(Link::Then) && link == Link::And || previous == Some(Link::And) && link == Link::Then {
            self.before.link = Some(Link::Then);
        }
    }

    fn starts_clause(&self, at: usize) -> bool {
        verb(self.word_at(at)).is_some()
    }

    fn reason_begins(&mut self) {
        let failed = self.found.iter().rposition(|predicate| matches!(predicate.mood, Mood::Failed | Mood::Tried));
        if let (Some(index), None) = (failed, self.reason_from) {
            self.reason_from = Some((index, self.tokens[self.at.min(self.tokens.len() - 1)].span.start));
        }
    }

    /// A clause ends: what it left over continues the list of the last verb.
    fn boundary(&mut self, link: Option<Link>) {
        self.flush();
        let link = link.or(self.before.link.filter(|_| self.before.start.is_none()));
        self.before = Before { link, ..Before::default() };
        self.prep = Prep::Direct;
        self.fresh = true;
        self.joins = matches!(link, None | Some(Link::And | Link::Or | Link::Then));
    }

    fn flush(&mut self) {
        let Some(last) = self.found.last_mut() else { return };
        // `because of a bad argument`, `not the pear`
        if !self.joins || self.before.not {
            self.pending.clear();
        }
        for mut arg in self.pending.drain(..) {
            if arg.prep == Prep::Direct
                && let Some(previous) = last.args.last()
            {
                arg.prep = previous.prep;
            }
            last.args.push(arg);
        }
    }

    fn times(&mut self, times: u32) {
        let span = self.tokens[self.at].span.clone();
        if let Some(last) = self.found.last_mut() {
            last.times = Some((times, span.clone()));
            last.span.end = last.span.end.max(span.end);
        }
    }

    fn complement(&mut self, state: State) {
        if let Some(last) = self.found.last_mut().filter(|last| last.act == Act::Be && !self.fresh) {
            last.state.get_or_insert(state);
            last.span.end = self.tokens[self.at].span.end;
        }
    }

    /// What was spoken of last went well, or failed.
    fn outcome(&mut self, success: bool) {
        if success {
            return;
        }
        self.fail_last(Mood::Failed);
    }

    fn fail_last(&mut self, mood: Mood) -> bool {
        let end = self.tokens[self.at].span.end;
        let doing = self.before.doing;
        let acts = |predicate: &Predicate| !predicate.is_state() && !predicate.user && (predicate.mood != Mood::Intent || doing);
        let Some(last) = self.found.last_mut().filter(|predicate| acts(predicate)) else { return false };
        last.mood = mood;
        last.span.end = last.span.end.max(end);
        self.reason_from = None;
        true
    }

    fn verb(&mut self) {
        let at = self.at;
        let Some(mut verb) = verb(self.word_at(at)) else { return };
        let next = self.class_at(at + 1);
        let after = self.before.clone();
        if after.determiner && matches!(verb.form, Form::Base | Form::Any) && !self.nominal(verb) {
            return self.phrase();
        }
        match verb.act {
            Act::Try if verb.form != Form::Gerund && matches!(next, Some(Class::To | Class::Verb)) => {
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
            Act::Fail | Act::Succeed | Act::Manage if verb.form != Form::Gerund => return self.went_well_or_not(verb),
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
        let present = verb.act == Act::Hold && !after.did
            && (verb.form == Form::Base || verb.form == Form::Present || verb.form == Form::Gerund && after.be == Some(true));
        let predicate = Predicate { mood, passive, present, verb: Some(verb), ..Predicate::new(verb.act, span) };
        self.before.not = negated;
        self.push(predicate);
        self.at += 1;
    }

    /// Whether a base form behind a determiner is a deed (`the pick failed`) rather than a thing (`the place`).
    fn nominal(&self, verb: Verb) -> bool {
        let next = self.class_at(self.at + 1);
        let deed = matches!(next, Some(Class::Doing)) || self.word_at(self.at + 1).starts_with("fail");
        deed || verb.act == Act::Pick || matches!(next, Some(Class::Prep(Prep::Of))) && verb.act != Act::Place
    }

    fn went_well_or_not(&mut self, verb: Verb) {
        let (at, next) = (self.at, self.class_at(self.at + 1));
        let well = (verb.act != Act::Fail) != std::mem::take(&mut self.before.not);
        let mood = if well { Mood::Done } else { Mood::Failed };
        let governs = matches!(next, Some(Class::To)) || self.word_at(at + 1) == "in" && self.class_at(at + 2) == Some(Class::Verb);
        if self.before.will || self.before.infinitive {
        } else if governs {
            self.before.governor = Some((mood, at));
        } else if verb.act != Act::Manage && !self.fail_last(mood) {
            let predicate = Predicate { mood, ..Predicate::new(Act::Fail, self.tokens[at].span.clone()) };
            self.push(predicate);
            if mood == Mood::Failed {
                self.at += 1;
                self.reason_begins();
                return;
            }
        }
        self.at += 1;
        if mood == Mood::Failed && !governs && matches!(self.class_at(self.at), Some(Class::Prep(_)) | None) {
            self.reason_begins();
        }
    }

    /// Which of its meanings a verb has here.
    fn sense(&self, verb: Verb) -> Act {
        let next = self.word_at(self.at + 1);
        let ahead = |wanted: &[&str]| self.tokens[self.at + 1..].iter().take(14).any(|token| wanted.contains(&token.word()));
        match (verb.base, verb.act) {
            ("walk", _) if next == "around" => Act::Explore,
            ("look", _) if matches!(next, "at" | "into" | "closely") => Act::Gaze,
            ("look" | "search", _) if next != "for" && !ahead(&["for"]) => Act::Check,
            ("take" | "move" | "relocate" | "transfer" | "return", Act::Pick | Act::Go | Act::Carry) if !self.goes_itself(verb) => Act::Carry,
            ("carry", _) if ahead(&["to", "into", "onto"]) => Act::Carry,
            ("remove", _) => Act::Pick,
            (_, act) => act,
        }
    }

    /// `took the mug` and `moved to table_1`, but not `took the mug to table_1` and `moved the mug`.
    fn goes_itself(&self, verb: Verb) -> bool {
        let mut rest = self.tokens[self.at + 1..].iter().take(14).take_while(|token| token.kind == Kind::Word || token.kind == Kind::Number);
        match verb.act {
            Act::Pick => !rest.any(|token| matches!(token.word(), "to" | "into" | "onto")),
            _ => {
                let next = self.class_at(self.ahead(self.at + 1));
                matches!(next, Some(Class::To | Class::Prep(_) | Class::Link(_)) | None) && self.before.be.is_none() && !self.before.been
            }
        }
    }

    fn mood(&self, verb: Verb) -> (Mood, bool) {
        let before = &self.before;
        let base_of_previous = || self.found.last().filter(|_| matches!(before.link, Some(Link::And | Link::Or)));
        let governed = before.governor.map(|(mood, _)| mood);
        let negated = before.not || before.without;
        match verb.form {
            Form::Gerund => {
                let told = before.be == Some(false) || matches!(before.link, Some(Link::After | Link::Before | Link::Sub)) || before.by;
                let holds = verb.act == Act::Hold && before.be.is_some();
                match governed {
                    Some(mood) => (mood, negated),
                    None if told || holds || before.without => (Mood::Done, negated),
                    None if before.be.is_some() || before.have || before.been => (Mood::Intent, negated),
                    None => (Mood::Mention, negated),
                }
            }
            _ if before.infinitive && governed.is_some() => (governed.unwrap_or(Mood::Done), negated),
            _ if before.infinitive && before.doing => (Mood::Mention, false),
            _ if before.will || before.infinitive => (Mood::Intent, negated),
            _ if before.can && (negated || verb.act == Act::See) => match verb.act {
                Act::See => (Mood::Done, negated),
                _ => (Mood::Failed, false),
            },
            _ if before.can => (Mood::Intent, negated),
            Form::Base | Form::Any if before.did => (Mood::Done, negated),
            Form::Base if before.determiner || before.doing => (Mood::Mention, false),
            Form::Base if before.agent && matches!(verb.act, Act::Hold | Act::See) => (Mood::Done, negated),
            Form::Base => match base_of_previous() {
                Some(previous) if previous.verb.is_some_and(|verb| verb.form == Form::Base) => (previous.mood, negated || previous.negated),
                _ => (Mood::Intent, negated),
            },
            Form::Any if before.determiner => (Mood::Mention, false),
            Form::Participle if !before.have && before.be.is_none() && !before.been => (Mood::Mention, negated),
            Form::PastOrParticiple | Form::Participle if before.link == Some(Link::Or) => {
                (Mood::Done, negated || self.found.last().is_some_and(|previous| previous.negated))
            }
            _ => (Mood::Done, negated),
        }
    }

    /// Gives a predicate what stands before it, and begins to collect what stands behind.
    fn push(&mut self, mut predicate: Predicate) {
        let before = std::mem::take(&mut self.before);
        let (subjects, modifiers): (Vec<Arg>, Vec<Arg>) = self.pending.drain(..).partition(|arg| arg.prep == Prep::Direct);
        predicate.negated = before.not || before.without || subjects.iter().any(|arg| arg.no);
        predicate.existential = before.there;
        predicate.user = before.user && !predicate.passive;
        predicate.agent = !predicate.user && (before.agent || subjects.is_empty());
        predicate.only = before.only;
        predicate.link = before.link;
        predicate.leading = before.leading;
        predicate.span.start = before.start.map_or(predicate.span.start, |start| self.tokens[start].span.start);
        // `was picked and placed`: the second has the first's subject
        predicate.subjects = match self.found.last() {
            Some(last) if subjects.is_empty() && before.link == Some(Link::And) && last.passive && !before.agent && !predicate.user => {
                predicate.passive = last.passive;
                last.subjects.clone()
            }
            _ => subjects,
        };
        predicate.args = modifiers;
        if predicate.user && !matches!(predicate.act, Act::Say | Act::Ask) {
            predicate.mood = Mood::Intent;
        }
        self.found.push(predicate);
        self.fresh = false;
        self.prep = Prep::Direct;
    }

    /// Asking and saying: what follows is content, up to the next clause of the agent.
    fn says(&mut self, at: usize, act: Act, according: bool) {
        let verb = verb(self.word_at(at));
        let form = verb.map_or(Form::Past, |verb| verb.form);
        let before = self.before.clone();
        let mood = match form {
            // `without asking again` does not deny the first time
            Form::Gerund if before.without && self.word_at(at + 1) == "again" => Mood::Intent,
            Form::Gerund if matches!(before.link, Some(Link::After | Link::Before)) || before.without || before.be == Some(false) => Mood::Done,
            Form::Gerund => Mood::Mention,
            _ if before.governor.is_some() => before.governor.map_or(Mood::Done, |(mood, _)| mood),
            _ if before.will || before.infinitive || before.can => Mood::Intent,
            Form::Base | Form::Any if !before.did && !before.user => Mood::Intent,
            _ => Mood::Done,
        };
        let passive = before.be.is_some() || before.been;
        let told = passive && self.word_at(at) == "told";
        let user_asked = passive && act == Act::Ask;
        let end = self.content_end(at + 1);
        let content = Content::of(&self.tokens[at + 1..end]);
        let times = content.times(&self.tokens[at + 1..end]);
        let span = self.tokens[at].span.start..self.tokens[end - 1].span.end;
        let first_word = self.tokens[at].span.clone();
        self.push(Predicate { mood, passive, content, times, verb, verb_span: first_word, ..Predicate::new(act, span) });
        if let Some(said) = self.found.last_mut() {
            said.user = according || told || !passive && said.user || passive && act == Act::Say && said.user;
            said.agent = !said.user && (said.agent || user_asked);
        }
        self.at = end;
        self.fresh = true;
    }

    fn content_end(&self, from: usize) -> usize {
        let subordinate = self.before.without || matches!(self.before.link, Some(Link::After | Link::Before));
        let starts = |at: usize| {
            let at = if self.class_at(at) == Some(Class::Determiner) { at + 1 } else { self.ahead(at) };
            match self.class_at(at) {
                Some(Class::Agent | Class::User | Class::Be(_) | Class::Have) => true,
                Some(Class::Verb) => verb(self.word_at(at)).is_some_and(|verb| !matches!(verb.form, Form::Base | Form::Gerund)),
                _ => false,
            }
        };
        let mut at = from;
        while at < self.tokens.len() {
            let divides = match self.tokens[at].kind {
                Kind::Comma => starts(at + 1) || matches!(self.class_at(at + 1), Some(Class::Link(_))) && starts(at + 2),
                Kind::Word if self.class_at(at) == Some(Class::Agent) => subordinate,
                Kind::Word => matches!(self.class_at(at), Some(Class::Link(Link::And | Link::But | Link::Then | Link::Before | Link::After))) && starts(at + 1),
                _ => false,
            };
            if divides {
                break;
            }
            at += 1;
        }
        at.max(from)
    }

    /// `pick({"marker_id": 3})`, `nav_to(table_1)`
    fn is_call(&self) -> bool {
        let word = &self.tokens[self.at];
        let next = self.tokens.get(self.at + 1);
        let opens = next.is_some_and(|open| open.kind == Kind::Open && word.span.end == open.span.start);
        // `called finish`
        let before = self.at.checked_sub(1).map_or("", |at| self.word_at(at));
        let named = matches!(before, "called" | "used" | "executed" | "invoked" | "issued");
        (opens || named) && ToolSpec::by_name(word.word()).is_some()
    }

    fn call(&mut self) {
        let start = self.at;
        let mut depth = 0;
        if self.tokens.get(start + 1).is_none_or(|next| next.kind != Kind::Open) {
            self.at += 1;
            return self.call_of(start);
        }
        loop {
            self.at += 1;
            match self.tokens.get(self.at).map(|token| token.kind) {
                Some(Kind::Open) => depth += 1,
                Some(Kind::Close) => depth -= 1,
                None => break,
                _ => {}
            }
            if depth == 0 {
                self.at += 1;
                break;
            }
        }
        self.call_of(start);
    }

    fn call_of(&mut self, start: usize) {
        let end = self.at.min(self.tokens.len());
        let content = Content::of(&self.tokens[start..end]);
        let span = self.tokens[start].span.start..self.tokens[end - 1].span.end;
        self.pending.clear();
        self.push(Predicate { mood: Mood::Tried, content, ..Predicate::new(Act::Call, span) });
        self.boundary(None);
    }
}
