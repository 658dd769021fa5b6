//! Rules: a file each, with its class, sub-class, priority, prose and one question about a single
//! episode. Reads and checks them; never asks them.

use std::{collections::BTreeSet, fs, path::Path};

use reel_query::RowExpression;
use reel_world::{Digest, FailureClass};
use serde::Serialize;

use crate::TaxonomyError;

/// The paper's classes, in its order (Failure Mode Taxonomy).
pub const CLASSES: [&str; 4] = FailureClass::NAMES;

/// Most characters of a class.
const CLASS_CHARACTERS: usize = 60;
/// What the lines of a header begin with that are no prose.
const FIELDS: [&str; 6] = [
    "Class:",
    "Sub-class:",
    "Priority:",
    "Secondary:",
    "Slip:",
    "Needs:",
];

/// The rules that come with Reel: name and text.
const BUILT_IN: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/rules.rs"));

/// One rule of the taxonomy: an SQL question with its class and sub-class.
#[derive(Clone, Debug, Serialize)]
pub struct Rule {
    /// Its name: the file's, without `.sql`.
    pub name: String,
    /// Class of the failures that it finds: one of [`CLASSES`], or one of a taxonomy of one's own.
    pub class: String,
    /// Sub-class within that class, e.g. `wrong_attribute`.
    pub sub_class: String,
    /// Of several rules that hold the one with the lowest number decides; of equal ones that
    /// whose evidence comes first.
    pub priority: u32,
    /// Whether it is told beside what decides; what is left when nothing else was found is not.
    pub secondary: bool,
    /// Whether it explains nothing alone: it decides only where blame measured the capacity that it
    /// is about, or where no other rule holds.
    pub slip: bool,
    /// Whether it is asked only of episodes whose task has a goal in a world graph.
    pub needs_goal: bool,
    /// What it says, in prose.
    pub prose: String,
    /// Text of the whole rule file, its header comments included.
    pub sql: String,
    #[serde(skip)]
    pub(crate) question: RowExpression,
}

/// Rules that are applied together.
#[derive(Clone, Debug)]
pub struct RuleSet {
    rules: Vec<Rule>,
    version: Digest,
}

impl RuleSet {
    /// The rules of `queries/taxonomy`.
    ///
    /// # Panics
    /// When one of them is no rule, which a test rules out.
    pub fn built_in() -> Self {
        Self::new(
            BUILT_IN
                .iter()
                .map(|(name, sql)| (*name, (*sql).to_owned())),
        )
        .expect("a test reads every rule")
    }

    /// The built-in rules and those of a folder; one with the name of a built-in
    /// one takes its place.
    ///
    /// # Errors
    /// When the folder cannot be read or a file is no rule.
    pub fn with_folder(folder: &Path) -> Result<Self, TaxonomyError> {
        let failed = |source| TaxonomyError::Io {
            path: folder.to_owned(),
            source,
        };
        let mut files: Vec<(String, String)> = BUILT_IN
            .iter()
            .map(|(name, sql)| ((*name).into(), (*sql).into()))
            .collect();
        let mut paths = Vec::new();
        for entry in fs::read_dir(folder).map_err(failed)? {
            paths.push(entry.map_err(failed)?.path());
        }
        paths.retain(|path| path.extension().is_some_and(|extension| extension == "sql"));
        paths.sort();
        for path in paths {
            let name = path
                .file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            let sql = fs::read_to_string(&path).map_err(|source| TaxonomyError::Io {
                path: path.clone(),
                source,
            })?;
            files.retain(|(known, _)| *known != name);
            files.push((name, sql));
        }
        Self::new(files.into_iter())
    }

    fn new(
        files: impl Iterator<Item = (impl Into<String>, String)>,
    ) -> Result<Self, TaxonomyError> {
        let mut rules = files
            .map(|(name, sql)| Rule::parse(name.into(), sql))
            .collect::<Result<Vec<_>, _>>()?;
        rules.sort_by(|one, other| (one.priority, &one.name).cmp(&(other.priority, &other.name)));
        let text: String = rules
            .iter()
            .map(|rule| format!("{}\n{}\n", rule.name, rule.sql))
            .collect();
        Ok(Self {
            rules,
            version: Digest::of(text.as_bytes()),
        })
    }

    /// The rules in the order of their priority.
    pub fn rules(&self) -> &[Rule] {
        &self.rules
    }

    /// Digest of all of them: equal versions classify equally.
    pub fn version(&self) -> Digest {
        self.version
    }

    /// The class of a sub-class.
    pub fn class_of(&self, sub_class: &str) -> Option<&str> {
        self.rules
            .iter()
            .find(|rule| rule.sub_class == sub_class)
            .map(|rule| rule.class.as_str())
    }

    /// The classes in their order: the paper's, then those of one's own by name.
    pub fn classes(&self) -> Vec<&str> {
        let own: BTreeSet<&str> = self.rules.iter().map(|rule| rule.class.as_str()).collect();
        let own = own.into_iter().filter(|class| !CLASSES.contains(class));
        CLASSES.into_iter().chain(own).collect()
    }
}

impl Rule {
    fn parse(name: String, sql: String) -> Result<Self, TaxonomyError> {
        let wrong = |reason: String| TaxonomyError::Rule {
            rule: name.clone(),
            reason,
        };
        let header: Vec<&str> = sql
            .lines()
            .map_while(|line| line.strip_prefix("--"))
            .map(str::trim)
            .collect();
        let field = |key: &str| {
            let line = header
                .iter()
                .find_map(|line| line.strip_prefix(key)?.strip_prefix(':'));
            line.map(str::trim)
                .filter(|value| !value.is_empty())
                .ok_or_else(|| wrong(format!("its header has no line `-- {key}: ...`")))
        };
        let class = field("Class")?;
        if class.chars().count() > CLASS_CHARACTERS || class.chars().any(char::is_control) {
            return Err(wrong(format!(
                "its class is longer than {CLASS_CHARACTERS} characters, or has one that cannot be printed"
            )));
        }
        // Classes are compared to the letter: another spelling of one would be a second one.
        let meant = |known: &&str| known.eq_ignore_ascii_case(class) && *known != class;
        if let Some(known) = CLASSES.into_iter().find(meant) {
            return Err(wrong(format!("its class '{class}' is written '{known}'")));
        }
        let sub_class = field("Sub-class")?.to_owned();
        if !sub_class
            .chars()
            .all(|letter| letter.is_ascii_lowercase() || letter.is_ascii_digit() || letter == '_')
        {
            return Err(wrong(format!(
                "its sub-class '{sub_class}' has other characters than a-z, 0-9 and _"
            )));
        }
        let priority = field("Priority")?
            .parse()
            .map_err(|_| wrong("its priority is no whole number".into()))?;
        let says = |key: &str, word: &str| match field(key) {
            Ok(said) if said == word => Ok(true),
            Ok(other) => Err(wrong(format!(
                "`-- {key}: {other}` has to be `{word}`, or to be left out"
            ))),
            Err(_) => Ok(false),
        };
        let secondary = !says("Secondary", "never")?;
        let slip = says("Slip", "yes")?;
        let needs_goal = says("Needs", "goal")?;
        let is_prose = |line: &&&str| !FIELDS.iter().any(|key| line.starts_with(key));
        let prose = header
            .iter()
            .skip(1)
            .filter(is_prose)
            .copied()
            .collect::<Vec<_>>()
            .join(" ")
            .trim()
            .to_owned();
        if prose.is_empty() {
            return Err(wrong(
                "its header does not say in words what it finds".into(),
            ));
        }
        let question = RowExpression::parse(&sql).map_err(wrong)?;
        Ok(Self {
            class: class.to_owned(),
            sub_class,
            priority,
            secondary,
            slip,
            needs_goal,
            prose,
            question,
            name,
            sql,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "-- x\n--\n-- Words.\n--\n-- Class: Other\n-- Sub-class: x\n-- Priority: 7\nSELECT oscillation(steps) AS found FROM episodes";

    #[test]
    fn a_file_is_a_rule_or_says_why_not() {
        let rule = Rule::parse("x".into(), GOOD.into()).unwrap();
        assert_eq!(
            (
                rule.class.as_str(),
                rule.sub_class.as_str(),
                rule.priority,
                rule.prose.as_str()
            ),
            ("Other", "x", 7, "Words.")
        );
        for (from, to, complaint) in [
            (
                "Class: Other",
                "Class: lost memory",
                "is written 'Lost Memory'",
            ),
            ("Class: Other", "Class: \u{1b}[31m", "cannot be printed"),
            ("-- Class: Other\n", "", "no line `-- Class: ...`"),
            ("Sub-class: x", "Sub-class: X y", "other characters"),
            ("Priority: 7", "Priority: high", "no whole number"),
            ("Priority: 7", "Priority: 7\n-- Slip: no", "has to be `yes`"),
            (
                "Priority: 7",
                "Priority: 7\n-- Needs: robot",
                "has to be `goal`",
            ),
            ("-- Words.\n", "", "in words"),
            ("FROM episodes", "FROM labels", "from `episodes`"),
            ("SELECT", "SELEKT", "xpected"),
        ] {
            let refused = Rule::parse("x".into(), GOOD.replace(from, to))
                .unwrap_err()
                .to_string();
            assert!(
                refused.starts_with("rule 'x'") && refused.contains(complaint),
                "{refused}"
            );
        }
    }

    #[test]
    fn every_file_is_a_rule_and_the_version_is_that_of_their_text() {
        let set = RuleSet::built_in();
        assert!(set.rules().len() > 20);
        let mut names: Vec<_> = set.rules().iter().map(|rule| &rule.name).collect();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), set.rules().len());
        for class in CLASSES {
            assert!(
                set.rules().iter().any(|rule| rule.class == class),
                "{class}"
            );
        }
        assert_eq!(set.classes(), CLASSES);
        // a sub-class belongs to one class
        for rule in set.rules() {
            assert_eq!(
                set.class_of(&rule.sub_class),
                Some(rule.class.as_str()),
                "{}",
                rule.name
            );
        }
        let folder = tempfile::TempDir::new().unwrap();
        assert_eq!(
            RuleSet::with_folder(folder.path()).unwrap().version(),
            set.version()
        );
        let mine = GOOD.replace("Class: Other", "Class: Wrong File");
        fs::write(folder.path().join("mine.sql"), mine).unwrap();
        let more = RuleSet::with_folder(folder.path()).unwrap();
        assert_ne!(more.version(), set.version());
        assert_eq!(more.rules()[0].name, "mine");
        assert_eq!(more.classes()[4..], ["Wrong File"]);
        assert_eq!(more.class_of("x"), Some("Wrong File"));
    }
}
