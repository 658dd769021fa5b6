//! Reads the phrases that belong to a verb: articles, counts, markers, names. Never looks at verbs.

use crate::{
    clause::{Arg, Predicate, Reader},
    grammar::{Act, Class, Form, Prep, class, verb},
    lex::Kind,
    names::Referent,
};

/// Most words of a name that are looked at.
const LONGEST_NAME: usize = 14;

/// Words behind a preposition that say when or how, not where.
const TIMES: [&str; 14] = reel_world::words! {
    start beginning end moment way total turn order sequence meantime row process result episode
};

/// Parts of things: `the top of the table` is the table.
const PARTS: [&str; 17] = [
    "top", "front", "side", "middle", "edge", "corner", "centre", "center", "left", "right",
    "inside", "contents", "pair", "kind", "type", "vicinity", "pick",
];

impl Reader<'_> {
    /// Reads one noun phrase, if there is one, and gives it to its verb or keeps it for the next.
    pub(super) fn phrase(&mut self) {
        let first = self.at;
        let mut arg = Arg {
            prep: self.prep,
            referent: Referent::anything(),
            span: self.tokens[first].span.clone(),
            count: None,
            marker: None,
            no: false,
            all: false,
            other: false,
            door: false,
            hand: false,
            user: false,
            pronoun: false,
        };
        let mut words: Vec<&str> = Vec::new();
        let mut named = false;
        let mut determined = false;
        while let Some(token) = self.tokens.get(self.at) {
            match token.kind {
                Kind::Quote if words.is_empty() && !named => {
                    let quoted = token
                        .text
                        .trim_matches(|letter: char| !letter.is_alphanumeric());
                    arg.referent = self
                        .names
                        .phrase(&quoted.split_whitespace().collect::<Vec<_>>());
                    named = true;
                    self.at += 1;
                    break;
                }
                Kind::Number if words.is_empty() && !named => {
                    let Some(number) = token.number() else { break };
                    if matches!(self.word_at(self.at + 1), "time" | "times") {
                        return self.counted_times(number);
                    }
                    if self.name_follows() {
                        arg.count = Some((number, token.span.clone()));
                        self.at += 1;
                        continue;
                    }
                    arg.marker = Some(number);
                    self.at += 1;
                    named = true;
                    break;
                }
                Kind::Word => {}
                _ => break,
            }
            if let Some((length, referent)) = self.opening() {
                arg.referent = referent;
                named = true;
                self.at += length;
                break;
            }
            let word = token.word();
            match class(word) {
                Class::Determiner if words.is_empty() => determined = true,
                Class::No if words.is_empty() => {
                    arg.no = true;
                    if word != "no" {
                        self.at += 1;
                        if self.class_at(self.at) == Some(Class::Other) {
                            arg.other = true;
                            self.at += 1;
                        }
                        named = true;
                        break;
                    }
                }
                Class::All if words.is_empty() => arg.all = true,
                Class::Other if words.is_empty() => arg.other = true,
                Class::Only if determined || words.is_empty() => self.before.only = true,
                Class::Number(number) if words.is_empty() && !determined => {
                    if matches!(self.word_at(self.at + 1), "time" | "times") {
                        return self.counted_times(number);
                    }
                    arg.count = Some((number, token.span.clone()));
                    // `one` by itself
                    if !self.name_follows() {
                        self.at += 1;
                        named = true;
                        break;
                    }
                }
                Class::Number(1) if determined => words.push(word),
                Class::Marker if words.is_empty() => {
                    self.at += 1;
                    named = true;
                    arg.marker = self.tokens.get(self.at).and_then(crate::lex::Token::number);
                    self.at += usize::from(arg.marker.is_some());
                    arg.referent = if arg.marker.is_some() {
                        Referent::anything()
                    } else {
                        Referent {
                            open: true,
                            ..Referent::default()
                        }
                    };
                    break;
                }
                Class::Door => {
                    arg.door = true;
                    self.at += 1;
                    break;
                }
                Class::It if words.is_empty() => {
                    arg.pronoun = true;
                    named = true;
                    self.at += 1;
                    break;
                }
                Class::Hand => {
                    arg.hand = true;
                    named = true;
                    self.at += 1;
                    break;
                }
                Class::User => {
                    arg.user = true;
                    named = true;
                    self.at += 1;
                    break;
                }
                Class::Noun => words.push(word),
                Class::Adverb | Class::Free | Class::Empty
                    if determined && words.is_empty() && self.name_follows() =>
                {
                    words.push(word)
                }
                Class::Last if determined => {
                    self.last |= self.is_last_action();
                }
                Class::Verb if self.is_adjective(determined, &words) => {}
                Class::Verb if determined && words.is_empty() && self.is_name_of_its_own(word) => {
                    words.push(word)
                }
                _ => break,
            }
            self.at += 1;
        }
        if self.at == first {
            // nothing a phrase could begin with: never stand still
            self.at += 1;
            return;
        }
        if !words.is_empty() && !named {
            arg.referent = self.names.phrase(&words);
        }
        if self.class_at(self.at) == Some(Class::Door) {
            arg.door = true;
            self.at += 1;
        }
        let nothing_named = words.is_empty() && !named && !arg.door;
        if nothing_named && !arg.all && arg.count.is_none() {
            self.before.determiner |= determined;
            // `no` before a verb or at the end says no thing
            self.before.not |= arg.no;
            return;
        }
        arg.span.end = self.tokens[self.at - 1].span.end;
        self.give(arg);
    }

    fn opening(&self) -> Option<(usize, Referent)> {
        let rest = &self.tokens[self.at..];
        let words: Vec<&str> = rest
            .iter()
            .take(LONGEST_NAME)
            .take_while(|token| matches!(token.kind, Kind::Word | Kind::Number))
            .map(|token| token.text.as_str())
            .collect();
        self.names.opening(&words)
    }

    /// Whether a name stands behind the token here.
    fn name_follows(&self) -> bool {
        let next = self.at + 1;
        match self.class_at(next) {
            Some(Class::Noun | Class::Other) => true,
            Some(Class::Adverb) => matches!(self.class_at(next + 1), Some(Class::Noun)),
            Some(Class::Verb) => {
                verb(self.word_at(next)).is_some_and(|verb| {
                    verb.form == Form::PastOrParticiple && verb.act == Act::Mark
                }) && self.class_at(next + 1) == Some(Class::Noun)
            }
            _ => false,
        }
    }

    /// `the held object`, `the closed fridge`
    fn is_adjective(&self, determined: bool, words: &[&str]) -> bool {
        let form = verb(self.word_at(self.at)).map(|verb| verb.form);
        determined
            && words.is_empty()
            && matches!(
                form,
                Some(Form::PastOrParticiple | Form::Participle | Form::Any)
            )
            && self.class_at(self.at + 1) == Some(Class::Noun)
    }

    /// Whether a word that is also a verb names something of this episode.
    fn is_name_of_its_own(&self, word: &str) -> bool {
        if verb(word).is_some_and(|verb| self.nominal(verb)) {
            return false;
        }
        let referent = self.names.phrase(&[word]);
        !referent.places.is_empty() || !referent.objects.is_empty() || referent.any_place
    }

    fn counted_times(&mut self, number: u32) {
        self.times(number);
        self.at += 2;
    }

    fn give(&mut self, arg: Arg) {
        self.prep = Prep::Direct;
        if arg.user && self.fresh && arg.prep == Prep::Direct {
            self.before.user = true;
            return;
        }
        if arg.referent.open && TIMES.contains(&arg.referent.words.as_str()) {
            return;
        }
        if arg.prep == Prep::Of && self.merge(&arg) {
            return;
        }
        if arg.hand && arg.prep == Prep::At && self.in_hand() {
            return;
        }
        let arg = Arg {
            prep: if arg.prep == Prep::Of {
                Prep::Direct
            } else {
                arg.prep
            },
            ..arg
        };
        match self.found.last_mut() {
            Some(last) if !self.fresh => {
                last.negated |= arg.no;
                last.only |= std::mem::take(&mut self.before.only);
                last.args.push(arg);
            }
            _ => self.pending.push(arg),
        }
    }

    /// `with the mug in hand`: the mug is held.
    fn in_hand(&mut self) -> bool {
        let fresh = self.fresh;
        let list = match self.found.last_mut() {
            Some(last) if !fresh => &mut last.args,
            _ => &mut self.pending,
        };
        let Some(thing) = list.pop_if(|arg| arg.prep == Prep::With) else {
            return false;
        };
        let span = thing.span.start..self.tokens[self.at - 1].span.end;
        let args = vec![Arg {
            prep: Prep::Direct,
            ..thing
        }];
        let held = Predicate {
            args,
            ..Predicate::new(Act::Hold, span)
        };
        // before the last verb, so that what follows still belongs to that
        let at = if fresh {
            self.found.len()
        } else {
            self.found.len() - 1
        };
        self.found.insert(at, held);
        true
    }

    /// `the door of the fridge`, `one of the mugs`, `the top of table_1`: the second name
    /// says what is meant.
    fn merge(&mut self, arg: &Arg) -> bool {
        let fresh = self.fresh;
        let whole = match self.found.last_mut() {
            Some(last) if !fresh => last.args.last_mut(),
            _ => self.pending.last_mut(),
        };
        let Some(whole) = whole else { return false };
        let last = whole.referent.words.rsplit(' ').next().unwrap_or("");
        if whole.door
            || whole.referent.any_object
            || whole.referent.any_place
            || whole.referent.open && PARTS.contains(&last)
        {
            whole.referent = arg.referent.clone();
        }
        whole.marker = whole.marker.or(arg.marker);
        whole.span.end = arg.span.end;
        true
    }
}
