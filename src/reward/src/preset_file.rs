//! Presets as TOML files, and the JSON Schema of those files. Never opens a file:
//! texts come and go.

use std::{borrow::Cow, ops::Range};

use serde_json::{Value, json};
use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

use crate::{
    error::RewardError,
    preset::{Preset, RuleSpec, RuleValue, WEIGHT_MAX},
    terms::{Base, Term},
};

/// How far a known key may be from an unknown one to be what was meant (normalised
/// Damerau-Levenshtein, 1 is equal).
const SIMILAR: f64 = 0.5;

/// The keys of a file.
const KEYS: [&str; 4] = ["name", "base", "weights", "rules"];

const NAME: &str =
    "lower-case letters, digits, '.', '_' and '-', and not the name of a built-in preset";

impl Preset {
    /// Reads a preset file: `name`, `base` (`paper`, `real-repo` or `real-trainer`), and what
    /// differs from the base under `[weights]` and `[rules]`.
    /// `schemas/reward_preset.example.toml` has all keys.
    ///
    /// # Errors
    /// With line and column, when the text is no TOML, a key is unknown, or a value is of another
    /// kind or out of range.
    pub fn from_toml(text: &str) -> Result<Preset, RewardError> {
        let file = File { text };
        let table = DeTable::parse(text)
            .map_err(|error| file.syntax(&error))?
            .into_inner();
        if let Some(key) = table
            .keys()
            .find(|key| !KEYS.contains(&key.get_ref().as_ref()))
        {
            return Err(file.unknown(key, "a reward preset", &KEYS));
        }
        let base = file.base(table.get("base"))?;
        let mut preset = Preset::published(base);
        preset.name = file.name(table.get("name"))?;
        for (key, value) in file.entries(table.get("weights"), "weights")? {
            let term = base
                .terms()
                .find(|term| term.name() == key.get_ref())
                .ok_or_else(|| {
                    let known: Vec<&str> = base.terms().map(Term::name).collect();
                    file.unknown(key, &format!("[weights] of base {base}"), &known)
                })?;
            preset.weights.set(term, file.weight(key.get_ref(), value)?);
        }
        for (key, value) in file.entries(table.get("rules"), "rules")? {
            let (rule, kind) = preset
                .rule_values()
                .find(|(rule, _)| rule.name == key.get_ref())
                .ok_or_else(|| {
                    let known: Vec<&str> = RuleSpec::of(base).map(|rule| rule.name).collect();
                    file.unknown(key, &format!("[rules] of base {base}"), &known)
                })?;
            preset
                .rules
                .set(rule.name, file.rule(rule.name, kind, value)?);
        }
        Ok(preset)
    }

    /// JSON Schema of preset files, made from the same tables as the rules.
    pub fn json_schema() -> Value {
        let bases: Vec<Value> = Base::ALL.into_iter().map(schema_of).collect();
        json!({
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            "title": "Reel reward preset",
            "description": "A TOML file for `reel store reward`: a base and what differs from it.",
            "oneOf": bases,
        })
    }
}

/// A text whose errors have lines.
struct File<'a> {
    text: &'a str,
}

type Entries<'a, 'i> = Vec<(&'a Spanned<Cow<'i, str>>, &'a Spanned<DeValue<'i>>)>;

impl File<'_> {
    fn syntax(&self, error: &toml::de::Error) -> RewardError {
        let (line, column) = self.position(error.span());
        RewardError::Toml {
            line,
            column,
            message: error.message().replace('\n', "; "),
        }
    }

    fn base(&self, value: Option<&Spanned<DeValue>>) -> Result<Base, RewardError> {
        let expected = "\"paper\", \"real-repo\" or \"real-trainer\"";
        let value = value.ok_or_else(|| RewardError::Missing {
            key: "base",
            expected: expected.to_owned(),
        })?;
        value
            .get_ref()
            .as_str()
            .and_then(Base::parse)
            .ok_or_else(|| self.wrong("base", expected, value))
    }

    fn name(&self, value: Option<&Spanned<DeValue>>) -> Result<String, RewardError> {
        let value = value.ok_or_else(|| RewardError::Missing {
            key: "name",
            expected: NAME.to_owned(),
        })?;
        let good = |name: &&str| {
            let letters = name
                .chars()
                .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || "._-".contains(c));
            !name.is_empty() && letters && Base::parse(name).is_none()
        };
        let name = value
            .get_ref()
            .as_str()
            .filter(good)
            .ok_or_else(|| self.wrong("name", NAME, value))?;
        Ok(name.to_owned())
    }

    /// The entries of a table that may be absent.
    fn entries<'a, 'i>(
        &self,
        table: Option<&'a Spanned<DeValue<'i>>>,
        name: &str,
    ) -> Result<Entries<'a, 'i>, RewardError> {
        let Some(value) = table else {
            return Ok(Vec::new());
        };
        let table = value
            .get_ref()
            .as_table()
            .ok_or_else(|| self.wrong(name, "a table", value))?;
        Ok(table.iter().collect())
    }

    fn rule(
        &self,
        name: &str,
        kind: RuleValue,
        value: &Spanned<DeValue>,
    ) -> Result<RuleValue, RewardError> {
        match kind {
            RuleValue::Share(_) => {
                let number = self.number(name, value)?;
                let good = (0.0..=1.0)
                    .contains(&number)
                    .then_some(RuleValue::Share(number));
                good.ok_or_else(|| self.wrong(name, "a number from 0 to 1", value))
            }
            RuleValue::Count(_) => {
                let count = integer(value.get_ref())
                    .and_then(|count| u32::try_from(count).ok())
                    .map(RuleValue::Count);
                count.ok_or_else(|| self.wrong(name, "a whole number from 0 to 4294967295", value))
            }
            RuleValue::Switch(_) => value
                .get_ref()
                .as_bool()
                .map(RuleValue::Switch)
                .ok_or_else(|| self.wrong(name, "true or false", value)),
        }
    }

    /// A weight: small enough that the totals of no episode overflow.
    fn weight(&self, key: &str, value: &Spanned<DeValue>) -> Result<f64, RewardError> {
        let weight = self.number(key, value)?;
        let good = (weight.abs() <= WEIGHT_MAX).then_some(weight);
        good.ok_or_else(|| {
            self.wrong(
                key,
                "between -1e9 and 1e9, so that no total overflows",
                value,
            )
        })
    }

    /// A finite number, also one without a point.
    fn number(&self, key: &str, value: &Spanned<DeValue>) -> Result<f64, RewardError> {
        let number = match value.get_ref() {
            DeValue::Float(text) => text.as_str().parse().ok(),
            whole => integer(whole).map(|whole| whole as f64),
        };
        number
            .filter(|number: &f64| number.is_finite())
            .ok_or_else(|| self.wrong(key, "a finite number", value))
    }

    fn wrong(&self, key: &str, expected: &str, value: &Spanned<DeValue>) -> RewardError {
        let (line, column) = self.position(Some(value.span()));
        let found = self
            .text
            .get(value.span())
            .unwrap_or(value.get_ref().type_str());
        RewardError::Value {
            line,
            column,
            key: key.to_owned(),
            expected: expected.to_owned(),
            found: found.to_owned(),
        }
    }

    fn unknown(&self, key: &Spanned<Cow<str>>, table: &str, known: &[&str]) -> RewardError {
        let (line, column) = self.position(Some(key.span()));
        let distance = |name: &str| strsim::normalized_damerau_levenshtein(key.get_ref(), name);
        let nearest = known
            .iter()
            .max_by(|a, b| distance(a).total_cmp(&distance(b)));
        let hint = match nearest.filter(|name| distance(name) >= SIMILAR) {
            Some(name) => format!("; did you mean '{name}'?"),
            None => format!("; there are: {}", known.join(", ")),
        };
        RewardError::UnknownKey {
            line,
            column,
            key: key.get_ref().to_string(),
            table: table.to_owned(),
            hint,
        }
    }

    /// Line and column, both from 1.
    fn position(&self, span: Option<Range<usize>>) -> (usize, usize) {
        let before = span
            .and_then(|span| self.text.get(..span.start))
            .unwrap_or(self.text);
        let line = before.rsplit('\n').next().unwrap_or_default();
        (before.matches('\n').count() + 1, line.chars().count() + 1)
    }
}

fn integer(value: &DeValue) -> Option<i64> {
    let integer = value.as_integer()?;
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}

fn schema_of(base: Base) -> Value {
    let preset = Preset::published(base);
    let weight = |term: Term| {
        (
            term.name().to_owned(),
            json!({ "type": "number", "minimum": -WEIGHT_MAX, "maximum": WEIGHT_MAX, "default": preset.weight(term), "description": term.doc() }),
        )
    };
    let weights: serde_json::Map<String, Value> = base.terms().map(weight).collect();
    let rule = |(rule, value): (&RuleSpec, RuleValue)| {
        let mut schema = match value {
            RuleValue::Share(_) => json!({ "type": "number", "minimum": 0, "maximum": 1 }),
            RuleValue::Count(_) => json!({ "type": "integer", "minimum": 0, "maximum": u32::MAX }),
            RuleValue::Switch(_) => json!({ "type": "boolean" }),
        };
        schema["default"] = value.json();
        schema["description"] = json!(rule.doc);
        (rule.name.to_owned(), schema)
    };
    let rules: serde_json::Map<String, Value> = preset.rule_values().map(rule).collect();
    let other_names = Base::ALL.map(Base::as_str);
    json!({
        "type": "object",
        "required": ["name", "base"],
        "additionalProperties": false,
        "properties": {
            "name": { "type": "string", "pattern": "^[a-z0-9._-]+$", "not": { "enum": other_names }, "description": "What it is called." },
            "base": { "const": base.as_str(), "description": "The rules it is made of." },
            "weights": { "type": "object", "additionalProperties": false, "properties": weights },
            "rules": { "type": "object", "additionalProperties": false, "properties": rules },
        },
    })
}
