//! JSON as Python's `json.dumps` spaces it, which texts of REAL's data generation contain.

use std::io;

use serde_json::{Value, ser::Formatter};

/// One line of JSON with a blank after every comma and colon, keys in their order,
/// letters as they are.
pub fn spaced_json(value: &Value) -> String {
    let mut out = Vec::new();
    let mut serializer = serde_json::Serializer::with_formatter(&mut out, Spaced);
    serde::Serialize::serialize(value, &mut serializer).expect("a value can be written to memory");
    String::from_utf8(out).expect("JSON is written as UTF-8")
}

struct Spaced;

impl Formatter for Spaced {
    fn begin_array_value<W: io::Write + ?Sized>(
        &mut self,
        writer: &mut W,
        first: bool,
    ) -> io::Result<()> {
        if first {
            Ok(())
        } else {
            writer.write_all(b", ")
        }
    }

    fn begin_object_key<W: io::Write + ?Sized>(
        &mut self,
        writer: &mut W,
        first: bool,
    ) -> io::Result<()> {
        if first {
            Ok(())
        } else {
            writer.write_all(b", ")
        }
    }

    fn begin_object_value<W: io::Write + ?Sized>(&mut self, writer: &mut W) -> io::Result<()> {
        writer.write_all(b": ")
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn blanks_follow_commas_and_colons() {
        let value = json!({"b": [1, 2.5, null], "a": {"ü": "x, y: z"}, "empty": [{}, []]});
        assert_eq!(
            spaced_json(&value),
            r#"{"b": [1, 2.5, null], "a": {"ü": "x, y: z"}, "empty": [{}, []]}"#
        );
    }
}
