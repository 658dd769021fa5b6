//! The types of JSON rows: which kinds of values each key holds, with the line that has the first.
//!
//! Polars infers types too, but silently: it turns a number and a text in one column into text and
//! a text beside a list into a list, and names no line. This pass reads every row once, stops at
//! the first that is broken, and keeps what Polars would hide.

use std::{collections::HashSet, fmt};

use indexmap::IndexMap;
use polars::prelude::{DataType, Field, PlSmallStr};
use serde::de::{DeserializeSeed, Error as _, MapAccess, SeqAccess, Visitor};

/// Keys from which an object is no record but a map, whose keys are data; it is read as text.
const RECORD_KEYS_MAX: usize = 256;
/// Levels of nesting that become types; what is deeper is read as text.
const DEPTH_MAX: usize = 8;
/// Integers beyond this have neighbours that a float cannot tell apart.
const FLOAT_EXACT_MAX: u64 = 1 << 53;

/// A kind of JSON value. Integers are told apart by the types that hold them exactly.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Kind {
    Bool,
    /// From -2^53 to 2^53.
    Integer,
    /// Integers that are less than -2^53.
    NegativeWide,
    /// From 2^53 to 2^63 - 1.
    Wide,
    /// From 2^63 to 2^64 - 1.
    Unsigned,
    Float,
    Text,
    List,
    Object,
}

const KINDS: [(Kind, &str); 9] = [
    (Kind::Bool, "booleans"),
    (Kind::Integer, "numbers"),
    (Kind::NegativeWide, "numbers"),
    (Kind::Wide, "numbers"),
    (Kind::Unsigned, "numbers"),
    (Kind::Float, "numbers"),
    (Kind::Text, "texts"),
    (Kind::List, "lists"),
    (Kind::Object, "objects"),
];

/// What was seen under one key.
#[derive(Clone, Debug, Default)]
pub(crate) struct Shape {
    /// Line of the first value of each kind, from 1; 0 if there is none.
    first: [u32; KINDS.len()],
    negative: bool,
    fields: IndexMap<String, Shape>,
    items: Option<Box<Shape>>,
}

/// A column whose values have no common type, and what they are.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct MixedColumn {
    /// Its keys, joined by dots; `[]` stands for the items of a list.
    pub(crate) path: String,
    /// The kinds, each with the line of the first.
    pub(crate) kinds: String,
}

impl Shape {
    fn see(&mut self, kind: Kind, line: u32) {
        let first = &mut self.first[kind as usize];
        if *first == 0 {
            *first = line;
        }
    }

    fn has(&self, kind: Kind) -> bool {
        self.first[kind as usize] != 0
    }

    /// Whether no value other than null was seen.
    pub(crate) fn is_null(&self) -> bool {
        self.first.iter().all(|line| *line == 0)
    }

    /// The keys of an object with their shapes.
    pub(crate) fn fields(&self) -> &IndexMap<String, Shape> {
        &self.fields
    }

    /// The type that holds every value exactly; text where there is none. Such columns are added
    /// to `mixed`.
    pub(crate) fn data_type(&self, path: &str, mixed: &mut Vec<MixedColumn>) -> DataType {
        self.typed(path, 0, mixed)
    }

    fn typed(&self, path: &str, depth: usize, mixed: &mut Vec<MixedColumn>) -> DataType {
        let integers = [
            Kind::Integer,
            Kind::NegativeWide,
            Kind::Wide,
            Kind::Unsigned,
        ];
        let number = integers.iter().any(|kind| self.has(*kind)) || self.has(Kind::Float);
        let groups = [
            self.has(Kind::Bool),
            number,
            self.has(Kind::Text),
            self.has(Kind::List),
            self.has(Kind::Object),
        ];
        match groups {
            [false, false, false, false, false] => DataType::String,
            [true, false, false, false, false] => DataType::Boolean,
            [false, true, false, false, false] => {
                self.number().unwrap_or_else(|| self.text(path, mixed))
            }
            [false, false, true, false, false] => DataType::String,
            [false, false, false, true, false] if depth < DEPTH_MAX => {
                let item = self.items.as_ref().map_or(DataType::String, |items| {
                    items.typed(&format!("{path}[]"), depth + 1, mixed)
                });
                DataType::List(Box::new(item))
            }
            [false, false, false, false, true]
                if depth < DEPTH_MAX
                    && !self.fields.is_empty()
                    && self.fields.len() <= RECORD_KEYS_MAX =>
            {
                let fields = self.fields.iter().map(|(name, shape)| {
                    let path = format!("{path}.{name}");
                    Field::new(
                        PlSmallStr::from_str(name),
                        shape.typed(&path, depth + 1, mixed),
                    )
                });
                DataType::Struct(fields.collect())
            }
            [false, false, false, true, false] | [false, false, false, false, true] => {
                DataType::String
            }
            _ => self.text(path, mixed),
        }
    }

    /// The type of numbers, or `None` if none holds all of them exactly.
    fn number(&self) -> Option<DataType> {
        let wide = self.has(Kind::Wide) || self.has(Kind::NegativeWide);
        match (self.has(Kind::Float), self.has(Kind::Unsigned)) {
            (true, false) if !wide => Some(DataType::Float64),
            (true, _) => None,
            (false, false) => Some(DataType::Int64),
            (false, true) if !self.negative => Some(DataType::UInt64),
            (false, true) => Some(DataType::Int128),
        }
    }

    fn text(&self, path: &str, mixed: &mut Vec<MixedColumn>) -> DataType {
        let mut kinds: Vec<(&str, u32)> = Vec::new();
        for ((_, name), line) in KINDS.iter().zip(self.first) {
            if line == 0 {
                continue;
            }
            match kinds.iter_mut().find(|(known, _)| known == name) {
                Some((_, first)) => *first = line.min(*first),
                None => kinds.push((name, line)),
            }
        }
        let only_numbers = kinds.len() == 1;
        let kinds: Vec<String> = if only_numbers {
            vec!["fractions beside integers beyond 2^53".to_owned()]
        } else {
            kinds
                .iter()
                .map(|(name, line)| format!("{name} (first in line {line})"))
                .collect()
        };
        mixed.push(MixedColumn {
            path: path.to_owned(),
            kinds: kinds.join(" and "),
        });
        DataType::String
    }
}

/// Reads one row into a shape.
pub(crate) struct Seed<'a> {
    pub(crate) shape: &'a mut Shape,
    pub(crate) line: u32,
}

impl<'de> DeserializeSeed<'de> for Seed<'_> {
    type Value = ();

    fn deserialize<D: serde::Deserializer<'de>>(self, from: D) -> Result<(), D::Error> {
        from.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Seed<'_> {
    type Value = ();

    fn expecting(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter.write_str("a JSON value")
    }

    fn visit_bool<E>(self, _: bool) -> Result<(), E> {
        self.shape.see(Kind::Bool, self.line);
        Ok(())
    }

    fn visit_i64<E>(self, value: i64) -> Result<(), E> {
        self.shape.negative |= value < 0;
        let kind = match (value.unsigned_abs() > FLOAT_EXACT_MAX, value < 0) {
            (false, _) => Kind::Integer,
            (true, true) => Kind::NegativeWide,
            (true, false) => Kind::Wide,
        };
        self.shape.see(kind, self.line);
        Ok(())
    }

    fn visit_u64<E>(self, value: u64) -> Result<(), E> {
        let kind = match value {
            0..=FLOAT_EXACT_MAX => Kind::Integer,
            _ if i64::try_from(value).is_ok() => Kind::Wide,
            _ => Kind::Unsigned,
        };
        self.shape.see(kind, self.line);
        Ok(())
    }

    fn visit_f64<E>(self, _: f64) -> Result<(), E> {
        self.shape.see(Kind::Float, self.line);
        Ok(())
    }

    fn visit_str<E>(self, _: &str) -> Result<(), E> {
        self.shape.see(Kind::Text, self.line);
        Ok(())
    }

    fn visit_unit<E>(self) -> Result<(), E> {
        Ok(())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<(), A::Error> {
        self.shape.see(Kind::List, self.line);
        let shape = self.shape.items.get_or_insert_default();
        while items
            .next_element_seed(Seed {
                shape: &mut *shape,
                line: self.line,
            })?
            .is_some()
        {}
        Ok(())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<(), A::Error> {
        self.shape.see(Kind::Object, self.line);
        let mut ignored = Shape::default();
        let mut seen = SeenKeys::default();
        while let Some(key) = entries.next_key::<std::borrow::Cow<'de, str>>()? {
            let field = match field(&mut self.shape.fields, key, RECORD_KEYS_MAX + 1) {
                Some((index, key, field)) => {
                    seen.note(index, key)?;
                    field
                }
                // Not a record any more: what the other keys hold does not matter.
                None => &mut ignored,
            };
            entries.next_value_seed(Seed {
                shape: field,
                line: self.line,
            })?;
        }
        Ok(())
    }
}

/// The field of a key, made where there are fewer than so many; with its index and its name.
fn field<'a>(
    fields: &'a mut IndexMap<String, Shape>,
    key: std::borrow::Cow<'_, str>,
    fields_max: usize,
) -> Option<(usize, &'a str, &'a mut Shape)> {
    let index = match fields.get_index_of(&*key) {
        Some(index) => index,
        None if fields.len() < fields_max => {
            fields.insert_full(key.into_owned(), Shape::default()).0
        }
        None => return None,
    };
    let (name, field) = fields.get_index_mut(index)?;
    Some((index, name, field))
}

/// The keys that an object had so far. Readers of JSON keep one of two equal keys, and not all the
/// same one.
#[derive(Default)]
struct SeenKeys(HashSet<usize>);

impl SeenKeys {
    fn note<E: serde::de::Error>(&mut self, index: usize, key: &str) -> Result<(), E> {
        if self.0.insert(index) {
            return Ok(());
        }
        let shown: String = key.chars().take(60).collect();
        Err(E::custom(format!("the key {shown:?} is there twice")))
    }
}

/// Reads a row that has to be an object with at most [`COLUMNS_MAX`] keys in all rows.
///
/// # Errors
/// Fails if the text is not JSON, not an object, or if there are too many keys.
pub(crate) fn read_row(text: &[u8], line: u32, columns: &mut Shape) -> serde_json::Result<()> {
    let mut from = serde_json::Deserializer::from_slice(text);
    serde::Deserializer::deserialize_any(&mut from, Row { columns, line })?;
    from.end()
}

/// Columns that a table may have.
const COLUMNS_MAX: usize = 10_000;

struct Row<'a> {
    columns: &'a mut Shape,
    line: u32,
}

impl<'de> Visitor<'de> for Row<'_> {
    type Value = ();

    fn expecting(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter.write_str("an object with the columns of the row")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<(), A::Error> {
        self.columns.see(Kind::Object, self.line);
        let mut seen = SeenKeys::default();
        while let Some(key) = entries.next_key::<std::borrow::Cow<'de, str>>()? {
            let Some((index, key, field)) = field(&mut self.columns.fields, key, COLUMNS_MAX)
            else {
                return Err(A::Error::custom(format!(
                    "more than {COLUMNS_MAX} keys in the rows so far: the keys are data"
                )));
            };
            seen.note(index, key)?;
            entries.next_value_seed(Seed {
                shape: field,
                line: self.line,
            })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn types(rows: &[&str]) -> (Vec<String>, Vec<MixedColumn>) {
        let mut columns = Shape::default();
        for (index, row) in rows.iter().enumerate() {
            let line = u32::try_from(index + 1).expect("few");
            read_row(row.as_bytes(), line, &mut columns).expect("a row");
        }
        let mut mixed = Vec::new();
        let types = columns
            .fields()
            .iter()
            .map(|(name, shape)| format!("{name}: {:?}", shape.data_type(name, &mut mixed)));
        (types.collect(), mixed)
    }

    #[test]
    fn values_of_one_kind_have_its_type() {
        let (types, mixed) = types(&[
            r#"{"a": 1, "b": 1.5, "c": "x", "d": [1, 2], "e": {"f": true}, "g": null}"#,
            r#"{"a": -1, "b": 2, "c": null, "d": [], "e": {"h": [{"i": 1}]}}"#,
        ]);
        let expected = [
            "a: Int64",
            "b: Float64",
            "c: String",
            "d: List(Int64)",
            "e: Struct({'f': Boolean, 'h': List(Struct({'i': Int64}))})",
            "g: String",
        ];
        assert_eq!(types, expected);
        assert_eq!(mixed, []);
    }

    #[test]
    fn mixed_kinds_are_named_with_their_lines() {
        let (types, mixed) = types(&[
            r#"{"m": [{"content": "a"}]}"#,
            r#"{"m": [{"content": [{"text": "a"}]}], "n": 3}"#,
            r#"{"n": "3"}"#,
        ]);
        assert_eq!(types[1], "n: String");
        assert_eq!(mixed[0].path, "m[].content");
        assert_eq!(
            mixed[0].kinds,
            "texts (first in line 1) and lists (first in line 2)"
        );
        assert_eq!(
            mixed[1].kinds,
            "numbers (first in line 2) and texts (first in line 3)"
        );
    }

    #[test]
    fn wide_integers_keep_their_values() {
        let number = |rows: &[&str]| types(rows).0.remove(0);
        let unsigned = r#"{"a": 18446744073709551615}"#;
        assert_eq!(number(&[unsigned]), "a: UInt64");
        assert_eq!(number(&[unsigned, r#"{"a": -1}"#]), "a: Int128");
        assert_eq!(number(&[r#"{"a": 9007199254740993}"#]), "a: Int64");
        let (types, mixed) = types(&[r#"{"a": 9007199254740993}"#, r#"{"a": 0.5}"#]);
        assert_eq!(types, ["a: String"]);
        assert_eq!(mixed[0].kinds, "fractions beside integers beyond 2^53");
    }

    #[test]
    fn a_row_has_to_be_an_object() {
        let mut columns = Shape::default();
        for text in ["[1]", "3", "null", "{\"a\": 1} x", "{\"a\": "] {
            assert!(
                read_row(text.as_bytes(), 1, &mut columns).is_err(),
                "{text}"
            );
        }
    }
}
