//! Puts labels in the place of secrets, in texts and in JSON, and zeros in the place of numbers there, which stay numbers. A
//! secret that one rule found is known from then on, and is found wherever it stands again.

use std::{
    collections::{BTreeMap, HashMap},
    fmt,
    ops::Range,
    sync::Arc,
};

use aho_corasick::{AhoCorasick, MatchKind};
use regex::Match;
use serde_json::{Map, Value};

use crate::{
    Rules,
    escapes::{LEVELS, Unescaped},
    nested,
    rules::{MEMBER, Pattern},
    shapes::SECRET,
};

/// Shorter secrets are replaced where a rule finds them, and not looked for elsewhere: they are words, or numbers.
const REMEMBERED_MIN: usize = 8;
/// Shorter texts hold no secret that a built-in rule finds.
const SEARCHED_MIN: usize = 6;
/// Different secrets that are told apart; further ones get labels without a number.
const KNOWN_MAX: usize = 4096;
/// Longer strings of nothing but the letters of Base64 are files, and are not read.
const BASE64_MIN: usize = 4096;
/// The rule of texts that cannot be searched, and of places that a pointer names.
const UNREADABLE: &str = "unreadable";
const POINTER: &str = "pointer";

/// How many secrets were replaced, by the name of the rule.
pub type Redactions = BTreeMap<String, u64>;

/// What a JSON value is, as far as rules care.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Scope {
    /// Values that somebody sent: all rules hold.
    Data,
    /// Descriptions of values, such as the schemas of tools: a member `password` describes one there, so that only
    /// shapes and known values count.
    Schema,
}

/// A secret that is known, and what it is called.
#[derive(Clone, PartialEq, Eq)]
pub(crate) struct Known {
    name: String,
    pub secret: String,
}

impl Known {
    pub(crate) fn new(name: &str, secret: &str) -> Self {
        Self {
            name: name.to_owned(),
            secret: secret.to_owned(),
        }
    }
}

/// Without the secret: rules may stand in a log.
impl fmt::Debug for Known {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a secret of {}", self.name)
    }
}

/// Replaces the secrets of one session.
pub struct Redactor {
    rules: Arc<Rules>,
    /// By secret: the rule that found it first, and its label once it has one.
    known: HashMap<String, Remembered>,
    /// How many different secrets of a rule have a label.
    numbers: BTreeMap<String, u32>,
    redactions: Redactions,
    searched: Option<Searched>,
}

/// What is known of a secret.
#[derive(Clone)]
struct Remembered {
    name: String,
    label: Option<String>,
    /// Whether it is looked for in every text, or only called the same where a rule finds it again.
    searched: bool,
}

impl Remembered {
    fn unlabelled(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            label: None,
            searched: true,
        }
    }
}

/// The known secrets, made for searching.
struct Searched {
    automaton: AhoCorasick,
    secrets: Vec<String>,
}

/// A secret in a text.
struct Found {
    range: Range<usize>,
    name: String,
    secret: String,
    /// How far the secret itself is known: 0 known values, 1 shapes, 2 members, 3 what is in members of members.
    rank: u8,
    /// Whether it is a whole number of JSON inside of a text.
    is_number: bool,
}

/// The member of which a value is all or a part.
#[derive(Clone, Copy)]
struct Member<'a> {
    rule: &'a str,
    /// Whether the value stands in an object that the member holds, beside others: no secret by itself.
    is_parent: bool,
}

impl<'a> Member<'a> {
    fn new(rule: &'a str) -> Self {
        Self {
            rule,
            is_parent: false,
        }
    }
}

impl Found {
    fn of(secret: Match<'_>, name: &str, rank: u8) -> Option<Self> {
        (!secret.is_empty() && !is_label(secret.as_str())).then(|| Self {
            range: secret.range(),
            name: name.to_owned(),
            secret: secret.as_str().to_owned(),
            rank,
            is_number: false,
        })
    }

    /// Makes a number of JSON inside of a text a secret as a whole, without the brackets that stand behind it.
    fn take_number(&mut self, text: &str) {
        let Some(range) = nested::number(text, self.range.start) else {
            return;
        };
        let behind = text.get(range.end..self.range.end).unwrap_or_default();
        let behind = behind.trim_start_matches(|letter: char| {
            letter.is_ascii_whitespace() || "{}[],".contains(letter)
        });
        if !behind.starts_with(char::is_alphanumeric) {
            text[range.clone()].clone_into(&mut self.secret);
            self.range = range;
            self.is_number = true;
        }
    }
}

impl Redactor {
    /// Begins a session: labels are numbered from 1.
    pub fn new(rules: Arc<Rules>) -> Self {
        let remember = |known: &Known| (known.secret.clone(), Remembered::unlabelled(&known.name));
        Self {
            known: rules.known.iter().map(remember).collect(),
            rules,
            numbers: BTreeMap::new(),
            redactions: Redactions::new(),
            searched: None,
        }
    }

    /// Makes a value a secret from now on, such as one of a header that is itself not written.
    pub fn learn(&mut self, name: &str, secret: &str) {
        if self.rules.is_none() || secret.len() < REMEMBERED_MIN || self.known.len() >= KNOWN_MAX {
            return;
        }
        if !self.known.contains_key(secret) {
            let remembered = Remembered::unlabelled(name);
            self.known.insert(secret.to_owned(), remembered);
            self.searched = None;
        }
    }

    /// What was replaced since this was asked the last time.
    pub fn take_redactions(&mut self) -> Redactions {
        std::mem::take(&mut self.redactions)
    }

    /// A text with labels in the place of its secrets.
    pub fn text(&mut self, text: &str) -> String {
        self.replaced(text, Scope::Data)
            .unwrap_or_else(|| text.to_owned())
    }

    /// Puts labels in the place of secrets in a value: of members with telling names, in texts and in names of members. A
    /// number becomes 0, so that the value keeps its types. `root` is what pointers call the value: `arguments`, `result` or `error`.
    pub fn value(&mut self, root: &str, value: &mut Value, scope: Scope) {
        if !self.rules.is_none() {
            self.walk(value, &mut vec![root.to_owned()], None, scope);
        }
    }

    /// The secrets that are known by now.
    pub(crate) fn into_known(self) -> Vec<Known> {
        let known = |(secret, remembered): (String, Remembered)| Known {
            name: remembered.name,
            secret,
        };
        let searched = self.known.into_iter().filter(|(_, it)| it.searched);
        let mut all: Vec<Known> = searched.map(known).collect();
        all.sort_by(|one, other| one.secret.cmp(&other.secret));
        all
    }

    fn walk(
        &mut self,
        value: &mut Value,
        path: &mut Vec<String>,
        under: Option<Member<'_>>,
        scope: Scope,
    ) {
        let rules = self.rules.clone();
        let pointed = rules.pointers.iter().any(|pointer| matches(pointer, path));
        let under = if pointed {
            Some(Member::new(POINTER))
        } else {
            under
        };
        match value {
            Value::Null | Value::Bool(_) => {}
            Value::String(text) => {
                if let Some(replaced) = self.leaf(text, under, scope) {
                    *text = replaced;
                }
            }
            Value::Number(number) => {
                let text = number.to_string();
                let mut of_file = rules.patterns[rules.of_file..].iter();
                let searched = under.is_some()
                    || self.known.contains_key(&text)
                    || of_file.any(|pattern| pattern.regex.is_match(&text));
                if searched && self.leaf(&text, under, scope).is_some() {
                    *value = Value::from(0);
                }
            }
            Value::Array(items) => {
                for (index, item) in items.iter_mut().enumerate() {
                    path.push(index.to_string());
                    self.walk(item, path, under, scope);
                    path.pop();
                }
            }
            Value::Object(members) => {
                let within = under.map(|member| Member {
                    is_parent: true,
                    ..member
                });
                for (name, member) in members.iter_mut() {
                    let key = rules.key(name).filter(|_| scope == Scope::Data);
                    path.push(name.clone());
                    self.walk(member, path, key.map(Member::new).or(within), scope);
                    path.pop();
                }
                self.names(members, scope);
            }
        }
    }

    /// Replaces secrets in the names of members.
    fn names(&mut self, members: &mut Map<String, Value>, scope: Scope) {
        let renamed: Vec<Option<String>> = members
            .keys()
            .map(|name| self.replaced(name, scope))
            .collect();
        if renamed.iter().all(Option::is_none) {
            return;
        }
        let old = std::mem::take(members);
        for ((name, value), new) in old.into_iter().zip(renamed) {
            members.insert(new.unwrap_or(name), value);
        }
    }

    /// A text or number of a value, replaced; `None` if it stays.
    fn leaf(&mut self, text: &str, under: Option<Member<'_>>, scope: Scope) -> Option<String> {
        match under {
            Some(_) if text.is_empty() || is_label(text) => None,
            Some(member) => {
                let mut found = self.find(text, scope).unwrap_or_default();
                found.push(Found {
                    range: 0..text.len(),
                    name: member.rule.to_owned(),
                    secret: text.to_owned(),
                    rank: if member.is_parent { 3 } else { 2 },
                    is_number: false,
                });
                Some(self.replace(text, found))
            }
            None => self.replaced(text, scope),
        }
    }

    fn replaced(&mut self, text: &str, scope: Scope) -> Option<String> {
        let of_file = self.rules.of_file < self.rules.patterns.len();
        let short = text.len() < SEARCHED_MIN && !of_file;
        if self.rules.is_none() || short || is_base64(text) {
            return None;
        }
        let found = self.find(text, scope).unwrap_or_else(|| {
            let everything = Found {
                range: 0..text.len(),
                name: UNREADABLE.to_owned(),
                secret: text.to_owned(),
                rank: 2,
                is_number: false,
            };
            vec![everything]
        });
        (!found.is_empty()).then(|| self.replace(text, found))
    }

    /// The secrets in a text, as it is and behind its escapes; `None` if it has too many of these.
    fn find(&mut self, text: &str, scope: Scope) -> Option<Vec<Found>> {
        let mut found = Vec::new();
        let mut views: Vec<Unescaped> = Vec::new();
        for _ in 0..=LEVELS {
            let shown = views.last().map_or(text, |view| view.text.as_str());
            let before = found.len();
            self.search(shown, scope, &mut found);
            for secret in &mut found[before..] {
                secret.take_number(shown);
                let range = secret.range.clone();
                secret.range = views
                    .iter()
                    .rev()
                    .fold(range, |range, view| view.in_source(range));
            }
            let shown = views.last().map_or(text, |view| view.text.as_str());
            match Unescaped::of(shown) {
                Ok(Some(view)) => views.push(view),
                Ok(None) => break,
                Err(_) => return None,
            }
        }
        Some(found)
    }

    fn search(&mut self, text: &str, scope: Scope, found: &mut Vec<Found>) {
        self.prepare();
        if let Some(searched) = &self.searched {
            for hit in searched.automaton.find_iter(text) {
                let secret = &searched.secrets[hit.pattern().as_usize()];
                found.push(Found {
                    range: hit.range(),
                    name: self.known[secret].name.clone(),
                    secret: secret.clone(),
                    rank: 0,
                    is_number: false,
                });
            }
        }
        for Pattern { name, regex } in &self.rules.patterns {
            for groups in regex.captures_iter(text) {
                let secret = groups.name(SECRET).or_else(|| groups.get(0));
                found.extend(secret.and_then(|secret| Found::of(secret, name, 1)));
            }
        }
        if scope == Scope::Schema {
            return;
        }
        for regex in &self.rules.members {
            for groups in regex.captures_iter(text) {
                let member = groups
                    .name(MEMBER)
                    .and_then(|name| self.rules.key(name.as_str()));
                let (Some(name), Some(secret)) = (member, groups.name(SECRET)) else {
                    continue;
                };
                if !is_no_secret(secret.as_str()) {
                    found.extend(Found::of(secret, name, 2));
                }
            }
        }
        // What stands in brackets within brackets is found with these: each is walked once, however long the text.
        let mut walked = 0;
        let nested = self.rules.nested.iter();
        for groups in nested.flat_map(|regex| regex.captures_iter(text)) {
            let member = groups
                .name(MEMBER)
                .and_then(|name| self.rules.key(name.as_str()));
            let (Some(name), Some(bracket)) = (member, groups.name(SECRET)) else {
                continue;
            };
            if bracket.start() < walked {
                continue;
            }
            // What stands beside others in an object is no secret by itself.
            let rank = if bracket.as_str() == "{" { 3 } else { 2 };
            let (values, end) = nested::values(text, bracket.start());
            walked = end;
            found.extend(values.into_iter().map(|range| Found {
                secret: text[range.clone()].to_owned(),
                range,
                name: name.to_owned(),
                rank,
                is_number: false,
            }));
        }
    }

    /// Makes the known secrets ready for searching.
    fn prepare(&mut self) {
        if self.searched.is_some() || self.known.is_empty() {
            return;
        }
        let searched = self.known.iter().filter(|(_, it)| it.searched);
        let secrets: Vec<String> = searched.map(|(secret, _)| secret.clone()).collect();
        let automaton = AhoCorasick::builder()
            .match_kind(MatchKind::LeftmostLongest)
            .build(&secrets);
        // It fails beyond four billion states only, which the number and size of messages exclude.
        self.searched = automaton
            .ok()
            .map(|automaton| Searched { automaton, secrets });
    }

    fn replace(&mut self, text: &str, mut found: Vec<Found>) -> String {
        found.sort_by_key(|it| (it.range.start, std::cmp::Reverse(it.range.end)));
        let (mut replaced, mut at) = (String::with_capacity(text.len()), 0);
        let mut found = found.into_iter().peekable();
        while let Some(first) = found.next() {
            let mut range = first.range.clone();
            let mut together = vec![first];
            while let Some(next) = found.next_if(|next| next.range.start < range.end) {
                range.end = range.end.max(next.range.end);
                together.push(next);
            }
            let label = self.label(&together);
            replaced.push_str(&text[at..range.start]);
            let is_number = together.iter().all(|it| it.is_number);
            replaced.push_str(if is_number { "0" } else { &label });
            at = range.end;
        }
        replaced.push_str(&text[at..]);
        replaced
    }

    /// The label of secrets that overlap: that of the one which is known best. All of them are known from now on.
    fn label(&mut self, together: &[Found]) -> String {
        let best = together
            .iter()
            .min_by_key(|it| (it.rank, it.secret.len()))
            .expect("a group of secrets has one");
        let secret = unescaped(&best.secret);
        let remembered = self
            .known
            .get(&best.secret)
            .or_else(|| self.known.get(&secret));
        let (name, label) = remembered.map_or((best.name.clone(), None), |it| {
            (it.name.clone(), it.label.clone())
        });
        let label = label.unwrap_or_else(|| {
            if self.known.len() >= KNOWN_MAX {
                return format!("[redacted:{name}]");
            }
            let number = self.numbers.entry(name.clone()).or_default();
            *number += 1;
            format!("[redacted:{name}#{number}]")
        });
        *self.redactions.entry(name.clone()).or_default() += 1;
        let forms = together
            .iter()
            .flat_map(|it| [it.secret.clone(), unescaped(&it.secret)].map(|form| (form, it.rank)));
        for (secret, rank) in forms {
            let searched = secret.len() >= REMEMBERED_MIN && rank < 3;
            self.remember(secret, &name, &label, searched);
        }
        label
    }

    fn remember(&mut self, secret: String, name: &str, label: &str, searched: bool) {
        if let Some(known) = self.known.get_mut(&secret) {
            known.label.get_or_insert_with(|| label.to_owned());
            return;
        }
        if self.known.len() < KNOWN_MAX {
            let remembered = Remembered {
                name: name.to_owned(),
                label: Some(label.to_owned()),
                searched,
            };
            self.known.insert(secret, remembered);
            if searched {
                self.searched = None;
            }
        }
    }
}

/// Whether the value of a member is the sign of none, or of a block below.
fn is_no_secret(value: &str) -> bool {
    let block = value.trim_start_matches(['|', '>']);
    let none = ["null", "none", "true", "false"];
    // The bracket after it belongs to what is around.
    let word = value.trim_end_matches(['}', ']', ')']);
    none.iter().any(|none| word.eq_ignore_ascii_case(none))
        || (block.len() < value.len()
            && block
                .trim_matches(|c: char| "+-".contains(c) || c.is_ascii_digit())
                .is_empty())
}

/// Whether a recorded value is what an actual one was recorded as: equal, but for labels, each of which stands for any
/// secret.
pub fn is_recorded_as(actual: &Value, recorded: &Value) -> bool {
    match (actual, recorded) {
        (Value::Object(actual), Value::Object(recorded)) => {
            // A name that holds a secret has a label, too.
            let named = |name: &String| {
                let same = actual.get(name);
                same.or_else(|| {
                    let mut names = actual.iter().filter(|(other, _)| fits(other, name));
                    names.next().map(|(_, value)| value)
                })
            };
            actual.len() == recorded.len()
                && recorded
                    .iter()
                    .all(|(name, value)| named(name).is_some_and(|it| is_recorded_as(it, value)))
        }
        (Value::Array(actual), Value::Array(recorded)) => {
            actual.len() == recorded.len()
                && actual
                    .iter()
                    .zip(recorded)
                    .all(|(actual, recorded)| is_recorded_as(actual, recorded))
        }
        (Value::String(actual), Value::String(recorded)) => fits(actual, recorded),
        (Value::Number(_), Value::String(recorded)) => is_label(recorded),
        _ => actual == recorded,
    }
}

/// Whether a text is a recorded one, in which labels stand for secrets.
fn fits(actual: &str, recorded: &str) -> bool {
    let parts = around_labels(recorded);
    let [first, behind @ ..] = &parts[..] else {
        return false;
    };
    let (Some((last, between)), Some(rest)) = (behind.split_last(), actual.strip_prefix(first))
    else {
        return actual == recorded;
    };
    // As in a pattern with wildcards: the first place where a part stands is as good as any. No secret is empty.
    let mut rest = rest;
    for part in between {
        let Some(secret) = rest.chars().next() else {
            return false;
        };
        match rest[secret.len_utf8()..].find(part) {
            Some(at) => rest = &rest[secret.len_utf8() + at + part.len()..],
            None => return false,
        }
    }
    rest.strip_suffix(last)
        .is_some_and(|secret| !secret.is_empty())
}

/// What stands before, between and behind the labels of a text.
fn around_labels(text: &str) -> Vec<&str> {
    let (mut parts, mut from, mut at) = (Vec::new(), 0, 0);
    while let Some(begin) = text[at..].find("[redacted:").map(|found| at + found) {
        let end = text[begin..].find(']').map(|found| begin + found + 1);
        match end.filter(|end| is_label(&text[begin..*end])) {
            Some(end) => {
                parts.push(&text[from..begin]);
                (from, at) = (end, end);
            }
            None => at = begin + 1,
        }
    }
    parts.push(&text[from..]);
    parts
}

/// A text without one value, such as a key that an endpoint repeats in its errors, however JSON escapes it.
pub fn replace_value(text: &str, name: &str, value: &str) -> String {
    if value.is_empty() {
        return text.to_owned();
    }
    let label = format!("[redacted:{name}]");
    let mut text = text.replace(value, &label);
    for _ in 0..LEVELS {
        match Unescaped::of(&text) {
            Ok(Some(view)) if view.text.contains(value) => text = view.text.replace(value, &label),
            Ok(Some(_) | None) => break,
            Err(_) => return label,
        }
    }
    text
}

/// A secret as it reads with all of its escapes resolved.
fn unescaped(secret: &str) -> String {
    let mut secret = secret.to_owned();
    for _ in 0..LEVELS {
        match Unescaped::of(&secret) {
            Ok(Some(view)) => secret = view.text,
            _ => break,
        }
    }
    secret
}

/// Whether a text is a label of ours.
fn is_label(text: &str) -> bool {
    let inner = text
        .strip_prefix("[redacted:")
        .and_then(|rest| rest.strip_suffix(']'));
    inner.is_some_and(|inner| {
        !inner.is_empty()
            && inner
                .bytes()
                .all(|byte| byte.is_ascii_alphanumeric() || b"-_#".contains(&byte))
    })
}

/// Whether a text is a file in Base64, an image for example.
fn is_base64(text: &str) -> bool {
    text.len() > BASE64_MIN
        && text
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || b"+/=".contains(&byte))
}

fn matches(pointer: &[String], path: &[String]) -> bool {
    pointer.len() == path.len()
        && pointer
            .iter()
            .zip(path)
            .all(|(wanted, found)| wanted == "*" || wanted == found)
}
