//! Canonical JSON: the one text of a value that digests are taken over.

use std::{cmp::Ordering, io, ops::Range};

use serde::Serialize;
use serde_json::ser::{CharEscape, CompactFormatter, Formatter, Serializer};

/// JSON with the keys of every object sorted by their UTF-8 bytes and no white space, so that equal
/// values give equal bytes. Numbers are those of a [`serde_json::Value`]: an `f32` is written with
/// the digits of the `f64` that equals it.
///
/// # Panics
/// When the value cannot be JSON (a map with keys that are not strings): a programmer's error.
pub fn canonical_json<T: Serialize + ?Sized>(value: &T) -> String {
    let mut sorted = Sorted {
        out: Vec::with_capacity(4096),
        ..Sorted::default()
    };
    value
        .serialize(&mut Serializer::with_formatter(io::sink(), &mut sorted))
        .expect("a value of ours is always JSON");
    String::from_utf8(sorted.out).expect("JSON is written as UTF-8")
}

/// Writes objects as they come and puts their entries in order when they end, which they mostly are
/// already: no tree of values is built. What goes to the serializer's own writer is nothing.
#[derive(Default)]
struct Sorted {
    out: Vec<u8>,
    /// Entries of the objects that have not ended, the innermost last.
    entries: Vec<Entry>,
    /// Where the entries of those objects begin.
    open: Vec<usize>,
    /// Whether what was written last needed an escape.
    escaped: bool,
    reordered: Vec<u8>,
}

/// Where an entry of an object stands in the text, without its comma.
#[derive(Clone)]
struct Entry {
    /// The key without its quotes, escaped.
    key: Range<usize>,
    /// Its first bytes, which mostly decide.
    prefix: u64,
    escaped: bool,
    end: usize,
}

impl Sorted {
    fn comma(&mut self, first: bool) {
        if !first {
            self.out.push(b',');
        }
    }

    fn sort_object(&mut self) {
        let entries = self.open.pop().map_or(0, |first| first)..;
        let Self {
            out,
            entries: all,
            reordered,
            ..
        } = self;
        let object = &mut all[entries.clone()];
        if !object.is_sorted_by(|a, b| order(out, a, b).is_lt()) {
            let start = object[0].key.start - 1;
            // of entries with the same key the last one counts: stable, so it comes last
            object.sort_by(|a, b| order(out, a, b));
            reordered.clear();
            for (index, entry) in object.iter().enumerate() {
                if object
                    .get(index + 1)
                    .is_some_and(|next| order(out, entry, next).is_eq())
                {
                    continue;
                }
                reordered.extend_from_slice(&out[entry.key.start - 1..entry.end]);
                reordered.push(b',');
            }
            reordered.pop();
            out.truncate(start);
            out.extend_from_slice(reordered);
        }
        all.truncate(entries.start);
    }
}

/// Which of two keys is first.
fn order(out: &[u8], a: &Entry, b: &Entry) -> Ordering {
    let text = |entry: &Entry| &out[entry.key.clone()];
    if a.escaped || b.escaped {
        return plain(text(a)).cmp(&plain(text(b)));
    }
    a.prefix.cmp(&b.prefix).then_with(|| text(a).cmp(text(b)))
}

/// What an escaped key reads.
fn plain(key: &[u8]) -> String {
    serde_json::from_slice(&[b"\"", key, b"\""].concat()).expect("a key that was just written")
}

/// The first eight bytes as a number that is in order as they are; what is shorter is
/// filled up with zeros.
fn prefix(key: &[u8]) -> u64 {
    let mut first = [0; 8];
    let length = key.len().min(8);
    first[..length].copy_from_slice(&key[..length]);
    u64::from_be_bytes(first)
}

/// Methods that write as [`CompactFormatter`] does.
macro_rules! compact {
    ($($name:ident($($argument:ident: $type:ty),*);)*) => {
        $(fn $name<W: ?Sized + io::Write>(&mut self, _: &mut W, $($argument: $type),*) -> io::Result<()> {
            CompactFormatter.$name(&mut self.out, $($argument),*)
        })*
    };
}

/// Methods that write one byte.
macro_rules! byte {
    ($($name:ident => $byte:literal;)*) => {
        $(fn $name<W: ?Sized + io::Write>(&mut self, _: &mut W) -> io::Result<()> {
            self.out.push($byte);
            Ok(())
        })*
    };
}

impl Formatter for &mut Sorted {
    compact! {
        write_null();
        write_bool(value: bool);
        write_i8(value: i8);
        write_i16(value: i16);
        write_i32(value: i32);
        write_i64(value: i64);
        write_i128(value: i128);
        write_u8(value: u8);
        write_u16(value: u16);
        write_u32(value: u32);
        write_u64(value: u64);
        write_u128(value: u128);
        write_f64(value: f64);
        write_number_str(value: &str);
        write_string_fragment(fragment: &str);
        write_byte_array(value: &[u8]);
        write_raw_fragment(fragment: &str);
    }

    byte! {
        begin_string => b'"';
        end_string => b'"';
        begin_array => b'[';
        end_array => b']';
        begin_object_value => b':';
    }

    fn begin_array_value<W: ?Sized + io::Write>(
        &mut self,
        _: &mut W,
        first: bool,
    ) -> io::Result<()> {
        self.comma(first);
        Ok(())
    }

    fn write_char_escape<W: ?Sized + io::Write>(
        &mut self,
        _: &mut W,
        escape: CharEscape,
    ) -> io::Result<()> {
        self.escaped = true;
        CompactFormatter.write_char_escape(&mut self.out, escape)
    }

    fn write_f32<W: ?Sized + io::Write>(&mut self, writer: &mut W, value: f32) -> io::Result<()> {
        self.write_f64(writer, value.into())
    }

    fn begin_object<W: ?Sized + io::Write>(&mut self, _: &mut W) -> io::Result<()> {
        self.open.push(self.entries.len());
        self.out.push(b'{');
        Ok(())
    }

    fn begin_object_key<W: ?Sized + io::Write>(
        &mut self,
        _: &mut W,
        first: bool,
    ) -> io::Result<()> {
        self.comma(first);
        self.escaped = false;
        let start = self.out.len() + 1;
        self.entries.push(Entry {
            key: start..start,
            prefix: 0,
            escaped: false,
            end: start,
        });
        Ok(())
    }

    fn end_object_key<W: ?Sized + io::Write>(&mut self, _: &mut W) -> io::Result<()> {
        if let Some(entry) = self.entries.last_mut() {
            entry.key.end = self.out.len() - 1;
            entry.escaped = self.escaped;
            entry.prefix = prefix(&self.out[entry.key.clone()]);
        }
        Ok(())
    }

    fn end_object_value<W: ?Sized + io::Write>(&mut self, _: &mut W) -> io::Result<()> {
        if let Some(entry) = self.entries.last_mut() {
            entry.end = self.out.len();
        }
        Ok(())
    }

    fn end_object<W: ?Sized + io::Write>(&mut self, _: &mut W) -> io::Result<()> {
        self.sort_object();
        self.out.push(b'}');
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::{collection, prelude::*};
    use serde_json::{Map, Value, json};

    use super::*;

    /// The definition: a tree of values, every map sorted.
    fn by_definition<T: Serialize>(value: &T) -> String {
        fn sorted(value: Value) -> Value {
            match value {
                Value::Array(items) => items.into_iter().map(sorted).collect(),
                Value::Object(map) => {
                    let entries: BTreeMap<String, Value> = map
                        .into_iter()
                        .map(|(key, value)| (key, sorted(value)))
                        .collect();
                    Value::Object(entries.into_iter().collect())
                }
                other => other,
            }
        }
        sorted(serde_json::to_value(value).unwrap()).to_string()
    }

    #[derive(Serialize)]
    enum Kind {
        Unit,
        Newtype(f32),
        Tuple(i8, u64),
        Struct {
            z: Option<char>,
            a: BTreeMap<u32, bool>,
        },
    }

    #[derive(Serialize)]
    struct Inner {
        late: u8,
        early: u8,
    }

    #[derive(Serialize)]
    struct Doubled {
        early: i64,
        #[serde(flatten)]
        inner: Inner,
        nothing: (),
    }

    #[test]
    fn objects_are_sorted_at_every_depth() {
        let value: Value =
            serde_json::from_str(r#"{"b":1,"a":{"d":2,"c":[3,{"z":{},"y":[]}]}}"#).unwrap();
        assert_eq!(
            canonical_json(&value),
            r#"{"a":{"c":[3,{"y":[],"z":{}}],"d":2},"b":1}"#
        );
    }

    #[test]
    fn keys_are_compared_as_they_read() {
        // escaped, the line feed would come after the letter; a prefix would come
        // after what it begins
        let value = json!({ "aB": 1, "a\n": 2, "a": 3, "a\"": 4, "ä": 5, "a\u{1F600}": 6 });
        assert_eq!(canonical_json(&value), by_definition(&value));
        assert!(canonical_json(&value).starts_with(r#"{"a":3,"a\n":2,"a\"":4,"aB":1"#));
    }

    #[test]
    fn every_shape_of_serde() {
        let shapes = (
            [Kind::Unit, Kind::Newtype(0.1), Kind::Tuple(-3, u64::MAX)],
            Kind::Struct {
                z: Some('"'),
                a: BTreeMap::from([(10, true), (9, false)]),
            },
            (f64::NAN, f32::INFINITY, -0.0_f64, 1e300, 1e-7_f32, i64::MIN),
            Doubled {
                early: 1,
                inner: Inner { late: 2, early: 3 },
                nothing: (),
            },
        );
        assert_eq!(canonical_json(&shapes), by_definition(&shapes));
        assert!(canonical_json(&shapes).ends_with(r#"{"early":3,"late":2,"nothing":null}]"#));
    }

    fn values() -> impl Strategy<Value = Value> {
        let leaf = prop_oneof![
            Just(Value::Null),
            any::<bool>().prop_map(Value::from),
            any::<i64>().prop_map(Value::from),
            any::<f64>().prop_map(Value::from),
            any::<f32>().prop_map(Value::from),
            any::<String>().prop_map(Value::from),
        ];
        leaf.prop_recursive(4, 64, 6, |inner| {
            let keys = prop_oneof!["[a-c]{0,3}", any::<String>()];
            prop_oneof![
                collection::vec(inner.clone(), 0..6).prop_map(Value::from),
                collection::vec((keys, inner), 0..6)
                    .prop_map(|entries| Value::Object(Map::from_iter(entries))),
            ]
        })
    }

    proptest! {
        #[test]
        fn as_the_definition_says(value in values()) {
            prop_assert_eq!(canonical_json(&value), by_definition(&value));
        }
    }
}
