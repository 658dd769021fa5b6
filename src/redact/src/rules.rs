//! What a secret is: [shapes](SECRET_SHAPES) of known tokens, names of members that hold secrets, places in calls and results, and
//! values that are known. The built-in rules, and the file that adds to them; `docs/proxy.md` explains its format.

use regex::{Regex, RegexBuilder};
use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

use crate::{
    Redactor,
    redactor::Known,
    shapes::{SECRET, SECRET_SHAPES, SecretShape},
};

/// Largest rules file, in bytes.
pub const RULES_FILE_MAX: usize = 256 << 10;
/// Most patterns, keys or pointers of a file, each.
const ENTRIES_MAX: usize = 200;
/// Longest pattern, key or pointer of a file, in bytes.
const ENTRY_BYTES_MAX: usize = 1 << 10;
/// Largest compiled pattern, in bytes.
const COMPILED_MAX: usize = 1 << 20;
/// Longest name of a pattern, in bytes.
const NAME_MAX: usize = 32;
/// Shorter values of the environment are no secrets, but words.
const KNOWN_MIN: usize = 6;
/// The group of a member's name.
pub(crate) const MEMBER: &str = "member";
/// The name of rules for values that are known beforehand.
const ENVIRONMENT: &str = "environment";

/// Names of members that hold secrets: the name itself, and any name that ends with it (`db_password`, `X-Api-Key`).
const KEYS: &[&str] = &[
    "password",
    "passwd",
    "passwords",
    "passphrase",
    "secret",
    "secrets",
    "token",
    "api_key",
    "access_key",
    "private_key",
    "secret_key",
    "credential",
    "credentials",
    "authorization",
    "cookie",
    "x_amz_signature",
    "db_pass",
    "user_pass",
];

/// Names of members that hold secrets as a word of their own alone, at the end of the name: `db_pwd` and `dbPwd` do.
/// Not `pass`, which counts tests that passed.
const WORDS: &[&str] = &["pwd", "auth"];

/// Words in the name of a variable of the environment whose value is a secret, besides the keys.
const VARIABLE_ENDS: [&str; 3] = ["KEY", "AUTH", "PAT"];
/// The variable of the environment that holds the folder of work, and no password.
const WORKING_DIRECTORY: &str = "PWD";
/// Ends of names of variables that say where a secret is, and are none.
const VARIABLE_PLACES: [&str; 7] = ["FILE", "PATH", "DIR", "URL", "URI", "SOCK", "NAME"];

/// Where rules come from.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum RuleSource {
    /// There are no rules: nothing is redacted.
    #[default]
    None,
    /// The built-in rules alone.
    BuiltIn,
    /// The built-in rules, and those of a file.
    BuiltInAndFile,
    /// The rules of a file alone.
    File,
}

impl RuleSource {
    /// As it stands in traces.
    pub fn name(self) -> &'static str {
        match self {
            RuleSource::None => "none",
            RuleSource::BuiltIn => "built-in",
            RuleSource::BuiltInAndFile => "built-in and file",
            RuleSource::File => "file",
        }
    }
}

/// What is wrong with a rules file.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("line {line}, column {column}: {problem}")]
pub struct RulesError {
    /// Line of the mistake, from 1.
    pub line: usize,
    /// Column of the mistake, from 1, in characters.
    pub column: usize,
    /// What is wrong, and what could stand there.
    pub problem: String,
}

/// What counts as a secret.
#[derive(Clone, Debug, Default)]
pub struct Rules {
    source: RuleSource,
    pub(crate) patterns: Vec<Pattern>,
    /// Of these, where those of a file begin.
    pub(crate) of_file: usize,
    /// Members in texts, `password=...` and `"password": "..."`.
    pub(crate) members: Vec<Regex>,
    /// Members in texts whose value stands in brackets.
    pub(crate) nested: Option<Regex>,
    keys: Vec<Key>,
    /// Places in calls and results, as the segments of JSON pointers; `*` is any segment.
    pub(crate) pointers: Vec<Vec<String>>,
    pub(crate) known: Vec<Known>,
}

/// A regular expression that finds secrets.
#[derive(Clone, Debug)]
pub(crate) struct Pattern {
    pub name: String,
    pub regex: Regex,
}

/// The name of a member that holds a secret.
#[derive(Clone, PartialEq, Eq, Debug)]
struct Key {
    name: String,
    /// Its letters and digits alone, in lower case.
    plain: String,
    /// What labels are called after it.
    label: String,
    /// Whether it is the last word of a name, and no part of a longer word.
    is_word: bool,
}

impl Key {
    fn new(name: &str) -> Self {
        Self {
            name: name.to_ascii_lowercase(),
            plain: plain(name),
            label: label_name(&name.to_ascii_lowercase()),
            is_word: false,
        }
    }

    fn word(name: &str) -> Self {
        Self {
            is_word: true,
            ..Self::new(name)
        }
    }

    /// A regular expression of the name in any spelling.
    fn spelled(&self) -> String {
        let parts = self.name.split(['_', '-', '.', ' ']);
        let parts: Vec<String> = parts.map(regex::escape).collect();
        parts.join("[_. -]?")
    }
}

fn plain(name: &str) -> String {
    name.chars()
        .filter(char::is_ascii_alphanumeric)
        .map(|letter| letter.to_ascii_lowercase())
        .collect()
}

impl Rules {
    /// No rules: nothing is redacted.
    pub fn none() -> Self {
        Self::default()
    }

    /// The built-in rules: shapes of known tokens, and members with telling names.
    pub fn built_in() -> Self {
        let pattern = |shape: &SecretShape| Pattern {
            name: shape.rule.to_owned(),
            regex: compiled(shape.in_text).expect("the built-in patterns compile, as a test shows"),
        };
        let mut rules = Self {
            source: RuleSource::BuiltIn,
            patterns: SECRET_SHAPES.iter().map(pattern).collect(),
            of_file: SECRET_SHAPES.len(),
            keys: KEYS
                .iter()
                .map(|key| Key::new(key))
                .chain(WORDS.iter().map(|word| Key::word(word)))
                .collect(),
            ..Self::default()
        };
        rules.compile_members();
        rules
    }

    /// Reads a rules file.
    ///
    /// # Errors
    /// With line and column, what is no TOML, means nothing or is larger than the limits.
    pub fn parse(text: &str) -> Result<Self, RulesError> {
        let file = File { text };
        if text.len() > RULES_FILE_MAX {
            return Err(file.error(0, format!("the file is larger than {RULES_FILE_MAX} bytes")));
        }
        let table = DeTable::parse(text)
            .map_err(|error| file.error(error.span().map_or(0, |at| at.start), error.message()))?;
        let table = table.get_ref();
        let with_built_in = match table.iter().find(|(key, _)| key.get_ref() == "built_in") {
            None => true,
            Some((_, value)) => value
                .get_ref()
                .as_bool()
                .ok_or_else(|| file.error(value.span().start, "built_in is true or false"))?,
        };
        let mut rules = if with_built_in {
            Self::built_in()
        } else {
            Self::none()
        };
        rules.source = match with_built_in {
            true => RuleSource::BuiltInAndFile,
            false => RuleSource::File,
        };
        for (key, value) in table {
            match key.get_ref().as_ref() {
                "built_in" => {}
                "keys" => {
                    for (at, name) in file.strings(value, "keys")? {
                        if plain(name).is_empty() {
                            return Err(file.error(at, "a key needs a letter or a digit"));
                        }
                        rules.keys.push(Key::new(name));
                    }
                }
                "pointers" => {
                    for (at, pointer) in file.strings(value, "pointers")? {
                        rules
                            .pointers
                            .push(segments(pointer).map_err(|what| file.error(at, what))?);
                    }
                }
                "patterns" => rules.patterns.extend(file.patterns(value)?),
                other => {
                    return Err(file.error(
                        key.span().start,
                        format!(
                            "unknown key '{other}'; there are: built_in, keys, pointers, patterns"
                        ),
                    ));
                }
            }
        }
        rules.compile_members();
        Ok(rules)
    }

    /// Where the rules come from.
    pub fn source(&self) -> RuleSource {
        self.source
    }

    /// Whether nothing is redacted.
    pub fn is_none(&self) -> bool {
        self.source == RuleSource::None
    }

    /// The rules, and the values of an environment whose names look like those of secrets; of the others, the passwords
    /// in their URLs and the tokens in them.
    #[must_use]
    pub fn with_environment(self, variables: impl IntoIterator<Item = (String, String)>) -> Self {
        if self.is_none() {
            return self;
        }
        variables.into_iter().fold(self, |rules, (name, value)| {
            if names_secret(&name) {
                rules.with_known(&value)
            } else {
                rules.with_secrets_of(&value)
            }
        })
    }

    /// The rules, and the secrets in a command line: words such as `API_KEY=...`, `--token=...` and `--token ...`.
    #[must_use]
    pub fn with_command(mut self, words: &[String]) -> Self {
        if self.is_none() {
            return self;
        }
        for (index, word) in words.iter().enumerate() {
            self = match (word.split_once('='), words.get(index + 1)) {
                (Some((name, value)), _) if names_secret(name) => self.with_known(value),
                (None, Some(value)) if word.starts_with("--") && self.key(word).is_some() => {
                    self.with_known(value)
                }
                _ => self.with_secrets_of(word),
            };
        }
        self
    }

    /// The rules, and every secret that they find in a text as a value that is known from now on.
    #[must_use]
    pub fn with_secrets_of(mut self, text: &str) -> Self {
        let mut redactor = Redactor::new(self.clone().into());
        let _ = redactor.text(text);
        self.known = redactor.into_known();
        self
    }

    /// A text without its secrets, for a message: its labels mean nothing beside others.
    pub fn without_secrets(&self, text: &str) -> String {
        Redactor::new(self.clone().into()).text(text)
    }

    fn with_known(mut self, value: &str) -> Self {
        let value = value.trim();
        if value.len() >= KNOWN_MIN && self.known.iter().all(|known| known.secret != value) {
            self.known.push(Known::new(ENVIRONMENT, value));
        }
        self
    }

    /// The rule for a member of this name, if it holds a secret. Digits right behind the name count its values.
    pub(crate) fn key(&self, name: &str) -> Option<&str> {
        let unnumbered = name.trim_end_matches(|letter: char| letter.is_ascii_digit());
        // A `cookie_1` is a thing of a household.
        let is_numbered = unnumbered.ends_with(|letter: char| letter.is_ascii_alphabetic());
        let unnumbered = if is_numbered { unnumbered } else { name };
        let (word, spellings) = (last_word(unnumbered), [plain(name), plain(unnumbered)]);
        let names = |key: &&Key| match key.is_word {
            true => word.eq_ignore_ascii_case(&key.plain),
            false => spellings.iter().any(|name| name.ends_with(&key.plain)),
        };
        self.keys.iter().find(names).map(|key| key.label.as_str())
    }

    fn compile_members(&mut self) {
        // The longest first: a password of `api_key` is one of `key`, too.
        self.keys
            .sort_by_key(|key| std::cmp::Reverse(key.plain.len()));
        let (words, parts): (Vec<&Key>, Vec<&Key>) = self.keys.iter().partition(|key| key.is_word);
        let spelled = |keys: &[&Key]| {
            let names: Vec<String> = keys.iter().map(|key| key.spelled()).collect();
            names.join("|")
        };
        // Whatever stands before a name belongs to it, but for words.
        let mut names = Vec::new();
        if !parts.is_empty() {
            names.push(format!("(?i-u:{})", spelled(&parts)));
        }
        if !words.is_empty() {
            names.push(format!(r"(?:(?-u:\b)|_)(?i-u:{})", spelled(&words)));
            names.extend(words.iter().map(|word| capitalized(&word.name)));
        }
        let name = format!("(?P<{MEMBER}>{})[0-9]*", names.join("|"));
        let quoted = r#""[ \t\r\n]*:[ \t\r\n]*"(?P<secret>(?:[^"\\]|\\(?s:.))+)""#;
        let number = r#""[ \t\r\n]*:[ \t\r\n]*(?P<secret>-?[0-9][0-9.eE+-]*)"#;
        // Where the closing quote is missing, the line ends it.
        let in_double_quotes = r#"["']?[ \t]*[:=][ \t]*"(?P<secret>(?:[^"\\\r\n]|\\[^\r\n])+)"#;
        let in_single_quotes = r#"["']?[ \t]*[:=][ \t]*'(?P<secret>(?:[^'\\\r\n]|\\[^\r\n])+)"#;
        let assigned = r#"["']?[ \t]*[:=][ \t]*(?P<secret>[^ \t\r\n"',;&\[{][^ \t\r\n"',;&]*)"#;
        // A block of YAML: the lines below that are indented.
        let block =
            r"[ \t]*:[ \t]*[|>][0-9+-]*[ \t]*\r?\n(?P<secret>(?:[ \t]+[^\r\n]*(?:\r?\n|$))+)";
        let element = r"[ \t]*>(?P<secret>[^<]+)</";
        let compiled = |value: &str| {
            compiled(&format!("{name}{value}")).expect("names of bounded length compile")
        };
        let values = [
            quoted,
            number,
            in_double_quotes,
            in_single_quotes,
            assigned,
            block,
            element,
        ];
        if !names.is_empty() {
            self.members = values.into_iter().map(compiled).collect();
            self.nested = Some(compiled(
                r#"["']?[ \t\r\n]*[:=][ \t\r\n]*(?P<secret>[\[{])"#,
            ));
        }
    }
}

/// The last word of a name such as `db_pwd` or `dbPwd`.
fn last_word(name: &str) -> &str {
    let mut words = name.rsplit(|letter: char| !letter.is_ascii_alphabetic());
    let word = words.next().unwrap_or_default();
    let is_hump = |at: &usize| *at > 0 && word.as_bytes()[at - 1].is_ascii_lowercase();
    let hump = word.rfind(|letter: char| letter.is_ascii_uppercase());
    hump.filter(is_hump).map_or(word, |at| &word[at..])
}

/// A word of letters alone as it stands inside of a name such as `dbPwd`.
fn capitalized(word: &str) -> String {
    let (first, rest) = word.split_at(1);
    first.to_ascii_uppercase() + rest
}

/// What a label is called after a key: letters, digits, `-` and `_`.
fn label_name(key: &str) -> String {
    let letter = |letter: char| match letter {
        'a'..='z' | '0'..='9' | '-' | '_' => letter,
        _ => '_',
    };
    key.chars().map(letter).take(NAME_MAX).collect()
}

/// Whether a variable of the environment with this name holds a secret.
fn names_secret(name: &str) -> bool {
    let name = name
        .to_ascii_uppercase()
        .replace(|c: char| !c.is_ascii_alphanumeric(), "_");
    let name = name.trim_end_matches(|letter: char| letter.is_ascii_digit());
    let last = name.rsplit('_').next().unwrap_or_default();
    let words = format!("_{name}_");
    let tells = |key: &&str| {
        let key = key.to_ascii_uppercase();
        let fused = key.replace('_', "");
        last.ends_with(&fused)
            || [key, fused]
                .iter()
                .any(|key| words.contains(&format!("_{key}_")))
    };
    let is_word =
        name != WORKING_DIRECTORY && WORDS.iter().any(|word| last.eq_ignore_ascii_case(word));
    !VARIABLE_PLACES.contains(&last)
        && (VARIABLE_ENDS.contains(&last) || is_word || KEYS.iter().any(tells))
}

fn compiled(regex: &str) -> Result<Regex, String> {
    let built = RegexBuilder::new(regex).size_limit(COMPILED_MAX).build();
    built.map_err(|error| match error {
        regex::Error::CompiledTooBig(limit) => {
            format!("the pattern takes more than {limit} bytes; make its repetitions smaller")
        }
        other => other.to_string(),
    })
}

/// The segments of a JSON pointer into a call or a result.
fn segments(pointer: &str) -> Result<Vec<String>, String> {
    let roots = ["arguments", "result", "error"];
    let parts = pointer.strip_prefix('/').map(|rest| {
        rest.split('/')
            .map(|part| part.replace("~1", "/").replace("~0", "~"))
            .collect::<Vec<String>>()
    });
    parts
        .filter(|parts| parts.first().is_some_and(|root| roots.contains(&root.as_str())))
        .ok_or_else(|| {
            format!("'{pointer}' is not a place in a call or a result; write e.g. /arguments/pin or /result/content/*/text")
        })
}

/// A rules file, whose mistakes have lines.
struct File<'a> {
    text: &'a str,
}

impl File<'_> {
    fn error(&self, at: usize, problem: impl Into<String>) -> RulesError {
        let before = self.text.get(..at).unwrap_or(self.text);
        let line = before.rfind('\n').map_or(before, |end| &before[end + 1..]);
        RulesError {
            line: before.matches('\n').count() + 1,
            column: line.chars().count() + 1,
            problem: problem.into(),
        }
    }

    fn strings<'t>(
        &self,
        value: &'t Spanned<DeValue<'_>>,
        what: &str,
    ) -> Result<Vec<(usize, &'t str)>, RulesError> {
        let at = value.span().start;
        let list = value
            .get_ref()
            .as_array()
            .ok_or_else(|| self.error(at, format!("{what} is a list of texts")))?;
        if list.len() > ENTRIES_MAX {
            return Err(self.error(at, format!("{what} has more than {ENTRIES_MAX} entries")));
        }
        list.iter()
            .map(|entry| {
                let at = entry.span().start;
                let text = entry
                    .get_ref()
                    .as_str()
                    .ok_or_else(|| self.error(at, format!("{what} is a list of texts")))?;
                self.bounded(at, text).map(|text| (at, text))
            })
            .collect()
    }

    fn bounded<'t>(&self, at: usize, text: &'t str) -> Result<&'t str, RulesError> {
        if text.len() > ENTRY_BYTES_MAX {
            return Err(self.error(at, format!("this is longer than {ENTRY_BYTES_MAX} bytes")));
        }
        Ok(text)
    }

    fn patterns(&self, value: &Spanned<DeValue<'_>>) -> Result<Vec<Pattern>, RulesError> {
        let at = value.span().start;
        let table = value
            .get_ref()
            .as_table()
            .ok_or_else(|| self.error(at, "patterns is a table: NAME = 'regular expression'"))?;
        if table.len() > ENTRIES_MAX {
            return Err(self.error(at, format!("patterns has more than {ENTRIES_MAX} entries")));
        }
        let pattern = |(key, value): (&Spanned<_>, &Spanned<DeValue<'_>>)| {
            let name: &str = AsRef::<str>::as_ref(key.get_ref());
            if name.is_empty() || name.len() > NAME_MAX || label_name(name) != name {
                let what = format!(
                    "a pattern's name has up to {NAME_MAX} of the letters a to z, digits, '-' and '_'"
                );
                return Err(self.error(key.span().start, what));
            }
            let at = value.span().start;
            let text = value
                .get_ref()
                .as_str()
                .ok_or_else(|| self.error(at, "a pattern is a regular expression as text"))?;
            let regex = compiled(self.bounded(at, text)?).map_err(|what| self.error(at, what))?;
            if let Some(name) = regex.capture_names().flatten().find(|name| *name != SECRET) {
                let what = format!(
                    "the secret is the group (?P<{SECRET}>...); there is no group '{name}'"
                );
                return Err(self.error(at, what));
            }
            if regex.is_match("") {
                return Err(self.error(at, "this pattern matches an empty text, so everywhere"));
            }
            Ok(Pattern {
                name: name.to_owned(),
                regex,
            })
        };
        table
            .iter()
            .map(|(key, value): (&Spanned<std::borrow::Cow<'_, str>>, _)| pattern((key, value)))
            .collect()
    }
}
