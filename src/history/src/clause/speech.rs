//! Reads what was asked and said, and calls as they were written. Never looks inside
//! an answer for deeds.

use reel_world::ToolSpec;

use crate::{
    clause::{Mood, Predicate, Reader},
    content::Content,
    grammar::{Act, Class, Form, Link, verb},
    lex::Kind,
};

impl Reader<'_> {
    /// Asking and saying: what follows is content, up to the next clause of the agent.
    pub(super) fn says(&mut self, at: usize, act: Act, according: bool) {
        let verb = verb(self.word_at(at));
        let form = verb.map_or(Form::Past, |verb| verb.form);
        let before = self.before.clone();
        let mood = match form {
            // `without asking again` does not deny the first time
            Form::Gerund if before.without && self.word_at(at + 1) == "again" => Mood::Intent,
            Form::Gerund
                if matches!(before.link, Some(Link::After | Link::Before))
                    || before.without
                    || before.be == Some(false) =>
            {
                Mood::Done
            }
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
        self.push(Predicate {
            mood,
            passive,
            content,
            times,
            verb,
            verb_span: first_word,
            ..Predicate::new(act, span)
        });
        if let Some(said) = self.found.last_mut() {
            said.user = according || told || said.user && (!passive || act == Act::Say);
            said.agent = !said.user && (said.agent || user_asked);
        }
        self.at = end;
        self.fresh = true;
    }

    fn content_end(&self, from: usize) -> usize {
        let subordinate =
            self.before.without || matches!(self.before.link, Some(Link::After | Link::Before));
        let starts = |at: usize| {
            let at = if self.class_at(at) == Some(Class::Determiner) {
                at + 1
            } else {
                self.ahead(at)
            };
            match self.class_at(at) {
                Some(Class::Agent | Class::User | Class::Be(_) | Class::Have) => true,
                Some(Class::Verb) => verb(self.word_at(at))
                    .is_some_and(|verb| !matches!(verb.form, Form::Base | Form::Gerund)),
                _ => false,
            }
        };
        let mut at = from;
        while at < self.tokens.len() {
            let divides = match self.tokens[at].kind {
                Kind::Comma => {
                    starts(at + 1)
                        || matches!(self.class_at(at + 1), Some(Class::Link(_))) && starts(at + 2)
                }
                Kind::Word if self.class_at(at) == Some(Class::Agent) => subordinate,
                Kind::Word => {
                    matches!(
                        self.class_at(at),
                        Some(Class::Link(
                            Link::And | Link::But | Link::Then | Link::Before | Link::After
                        ))
                    ) && starts(at + 1)
                }
                _ => false,
            };
            if divides {
                break;
            }
            at += 1;
        }
        at.max(from)
    }

    /// Whether a call starts here, as in `pick({"marker_id": 3})` or `nav_to(table_1)`.
    pub(super) fn is_call(&self) -> bool {
        let word = &self.tokens[self.at];
        let next = self.tokens.get(self.at + 1);
        let opens =
            next.is_some_and(|open| open.kind == Kind::Open && word.span.end == open.span.start);
        let named = self
            .at
            .checked_sub(1)
            .is_some_and(|at| self.names_calls(at));
        (opens || named) && ToolSpec::by_name(word.word()).is_some()
    }

    /// Whether a verb such as `called` stands before a tool name, as in `called finish`.
    pub(super) fn calls_next(&self) -> bool {
        self.names_calls(self.at) && ToolSpec::by_name(self.word_at(self.at + 1)).is_some()
    }

    fn names_calls(&self, at: usize) -> bool {
        matches!(
            self.word_at(at),
            "called" | "used" | "executed" | "invoked" | "issued"
        )
    }

    pub(super) fn call(&mut self) {
        let start = self.at;
        let mut depth = 0;
        if self
            .tokens
            .get(start + 1)
            .is_none_or(|next| next.kind != Kind::Open)
        {
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
        self.push(Predicate {
            mood: Mood::Tried,
            content,
            ..Predicate::new(Act::Call, span)
        });
    }
}
