//! Reads a sentence as predicates: verbs with their polarity, mood and what belongs to
//! them. Never judges; what it does not understand it leaves out, or gives as an argument
//! that may mean anything.

mod phrase;
mod speech;
mod verb;

use std::ops::Range;

use crate::{
    content::{Content, reasons},
    grammar::{Act, Class, Form, Link, Prep, Verb, class, verb},
    lex::{Kind, Token, tokens},
    names::{Names, Referent},
};

/// Whether a verb tells that something was done.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Mood {
    /// The sentence says that it was done.
    Done,
    /// The sentence says that it was tried, without a result.
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
    /// Count and its span in bytes, as in `3 mugs`; `None` if nothing is counted.
    pub(crate) count: Option<(u32, Range<usize>)>,
    /// `marker 3`, or a number by itself.
    pub(crate) marker: Option<u32>,
    /// Whether the phrase is negated, as in `no mug` or `nothing`.
    pub(crate) no: bool,
    /// Whether the phrase means all of a kind, as in `all tables`.
    pub(crate) all: bool,
    /// `another mug`, `nothing else`
    pub(crate) other: bool,
    /// `the door of ..`
    pub(crate) door: bool,
    /// Whether the phrase names the gripper, as in `my hand`.
    pub(crate) hand: bool,
    /// Whether the phrase names the user, as in `the user`.
    pub(crate) user: bool,
    /// Whether the phrase is a pronoun, as in `it`.
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
    /// Whether it says that something exists, as in `there is a mug`.
    pub(crate) existential: bool,
    /// The agent is its subject, or nobody is.
    pub(crate) agent: bool,
    /// Whether the user is the subject, or the one who speaks.
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

    /// All phrases of the predicate: its subjects, then its arguments.
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
    /// Form of `be` before the verb: whether it is present; `None` if there is none.
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
                    reader.joins = reader.reason_from.is_none();
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
        let end_of = |predicate: &Predicate| {
            predicate
                .all_args()
                .map(|arg| arg.span.end)
                .max()
                .unwrap_or(0)
        };
        for predicate in &mut self.found {
            predicate.span.end = predicate.span.end.max(end_of(predicate));
            predicate.span.start = predicate
                .subjects
                .iter()
                .map(|arg| arg.span.start)
                .min()
                .unwrap_or(usize::MAX)
                .min(predicate.span.start);
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
        self.tokens
            .get(at)
            .filter(|token| token.kind == Kind::Word)
            .map(|token| class(token.word()))
    }

    /// The next token that is no adverb or negation, from `at` on.
    fn ahead(&self, mut at: usize) -> usize {
        while matches!(
            self.class_at(at),
            Some(Class::Adverb | Class::Not | Class::Only | Class::Success(_))
        ) {
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
            Class::Determiner
            | Class::No
            | Class::All
            | Class::Other
            | Class::It
            | Class::User
            | Class::Hand
            | Class::Number(_)
            | Class::Marker
            | Class::Door
            | Class::Noun => {
                if self.word_at(at) == "according" {
                    return self.says(at, Act::Say, true);
                }
                if self.calls_next() {
                    self.at += 1;
                    return;
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
            // `once the door was open`
            Class::Times(1)
                if matches!(
                    self.class_at(at + 1),
                    Some(Class::Determiner | Class::Agent | Class::It)
                ) =>
            {
                self.link(Link::Sub);
            }
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
        let verb_follows = verb(self.word_at(ahead))
            .is_some_and(|verb| !matches!(verb.form, Form::Base | Form::Gerund | Form::Present));
        match self.class_at(ahead) {
            Some(Class::To)
                if self.tokens[self.at + 1..ahead]
                    .iter()
                    .any(|token| token.word() == "yet") =>
            {
                self.before.not = true;
                self.before.governor = Some((Mood::Done, self.at));
            }
            Some(Class::To) => self.before.will = true,
            _ if verb_follows
                || matches!(
                    self.class_at(ahead),
                    Some(Class::Been | Class::Link(_) | Class::Prep(_) | Class::Agent) | None
                ) =>
            {
                self.before.have = true;
            }
            _ => {
                self.note_negation(self.at + 1, ahead);
                let present = self.word_at(self.at) != "had";
                self.push(Predicate {
                    present,
                    ..Predicate::new(Act::Have, self.tokens[self.at].span.clone())
                });
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
        let verb_follows = !adjective
            && verb(word).is_some_and(|verb| !matches!(verb.form, Form::Base | Form::Present));
        if verb_follows
            || matches!(
                self.class_at(ahead),
                Some(Class::Able(_) | Class::Been | Class::Will | Class::Success(_))
            )
        {
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
            self.push(Predicate {
                present,
                state,
                ..Predicate::new(Act::Be, self.tokens[self.at].span.clone())
            });
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
        if self.word_at(self.at) == "as"
            && matches!(
                self.class_at(self.at + 1),
                Some(Class::It | Class::Determiner | Class::Agent)
            )
        {
            self.reason_begins();
            self.boundary(Some(Link::Because));
        }
    }

    fn link(&mut self, link: Link) {
        if matches!(link, Link::Because | Link::But) {
            self.reason_begins();
        }
        // `after that`, `before that`
        let that = matches!(self.word_at(self.at + 1), "that" | "this" | "which")
            && matches!(link, Link::After | Link::Before);
        if that && (link == Link::After || !self.starts_clause(self.at + 2)) {
            self.at += 1;
            self.boundary((link == Link::After).then_some(Link::Then));
            return;
        }
        let previous = self.before.link;
        let leading = self.before.start.is_none_or(|start| start == self.at);
        self.boundary(Some(link));
        self.before.leading = leading;
        // `and then` is `then`
        if previous == Some(Link::Then) && link == Link::And
            || previous == Some(Link::And) && link == Link::Then
        {
            self.before.link = Some(Link::Then);
        }
    }

    fn starts_clause(&self, at: usize) -> bool {
        verb(self.word_at(at)).is_some()
    }

    fn reason_begins(&mut self) {
        let failed = self
            .found
            .iter()
            .rposition(|predicate| matches!(predicate.mood, Mood::Failed | Mood::Tried));
        if let (Some(index), None) = (failed, self.reason_from) {
            self.reason_from = Some((
                index,
                self.tokens[self.at.min(self.tokens.len() - 1)].span.start,
            ));
        }
    }

    /// A clause ends: what it left over continues the list of the last verb.
    fn boundary(&mut self, link: Option<Link>) {
        self.flush();
        if link.is_some() {
            // `gave up on the fridge and put ..`: a place belongs to its own clause
            self.pending.retain(|arg| arg.prep == Prep::Direct);
        }
        let link = link.or(self.before.link.filter(|_| self.before.start.is_none()));
        self.before = Before {
            link,
            ..Before::default()
        };
        self.prep = Prep::Direct;
        self.fresh = true;
        self.joins = matches!(link, None | Some(Link::And | Link::Or | Link::Then));
    }

    fn flush(&mut self) {
        let Some(last) = self.found.last_mut() else {
            return;
        };
        // `because of a bad argument`, `not the pear`
        if !self.joins || self.before.not {
            self.pending.clear();
        }
        let of_last = last.args.last().map(|arg| arg.prep);
        let continues =
            |arg: &Arg| !arg.no && (arg.prep == Prep::Direct || Some(arg.prep) == of_last);
        for mut arg in self.pending.drain(..).filter(continues) {
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
        if let Some(last) = self
            .found
            .last_mut()
            .filter(|last| last.act == Act::Be && !self.fresh)
        {
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
        let acts = |predicate: &Predicate| {
            !predicate.is_state() && !predicate.user && (predicate.mood != Mood::Intent || doing)
        };
        let Some(last) = self.found.last_mut().filter(|predicate| acts(predicate)) else {
            return false;
        };
        last.mood = mood;
        last.span.end = last.span.end.max(end);
        self.reason_from = None;
        true
    }

    /// Gives a predicate what stands before it, and begins to collect what stands behind.
    fn push(&mut self, mut predicate: Predicate) {
        let before = std::mem::take(&mut self.before);
        let (subjects, modifiers): (Vec<Arg>, Vec<Arg>) = self
            .pending
            .drain(..)
            .partition(|arg| arg.prep == Prep::Direct);
        predicate.negated = before.not || before.without || subjects.iter().any(|arg| arg.no);
        predicate.existential = before.there;
        predicate.user = before.user && !predicate.passive;
        predicate.agent = !predicate.user && (before.agent || subjects.is_empty());
        predicate.only = before.only;
        predicate.link = before.link;
        predicate.leading = before.leading;
        predicate.span.start = before
            .start
            .map_or(predicate.span.start, |start| self.tokens[start].span.start);
        // `was picked and placed`: the second has the first's subject
        predicate.subjects = match self.found.last() {
            Some(last)
                if subjects.is_empty()
                    && before.link == Some(Link::And)
                    && last.passive
                    && !before.agent
                    && !predicate.user =>
            {
                predicate.passive = last.passive;
                last.subjects.clone()
            }
            _ => subjects,
        };
        predicate.args = modifiers;
        // `X is the only receptacle I have visited`
        if let Some(last) = self.found.last().filter(|last| {
            last.act == Act::Be && last.only && !self.fresh && predicate.act == Act::Go
        }) {
            predicate.args.extend(last.subjects.iter().cloned());
            predicate.only = true;
        }
        if predicate.user && !matches!(predicate.act, Act::Say | Act::Ask) {
            predicate.mood = Mood::Intent;
        }
        self.found.push(predicate);
        self.fresh = false;
        self.prep = Prep::Direct;
    }
}
