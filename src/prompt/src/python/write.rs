//! Values as Python writes them: `json.dumps` with its blanks after `,` and `:`, floats by `repr`,
//! and `str()` of a value.

use std::fmt::Write as _;

use serde_json::Value;

/// Whether characters beyond ASCII are escaped: the option `ensure_ascii` of Python's `json.dumps`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Ascii {
    /// Other characters become a backslash, `u` and four hexadecimal digits, as Python
    /// writes them by default.
    Escaped,
    /// Characters stay as they are.
    Plain,
}

/// The text that Python's `json.dumps(value)` writes: a space after each colon and comma.
pub fn dumps(value: &Value, ascii: Ascii) -> String {
    let mut out = String::new();
    json(&mut out, value, ascii, None, 0);
    out
}

/// The text that Python's `json.dumps(value, indent=2)` writes.
pub fn dumps_indented(value: &Value, ascii: Ascii) -> String {
    let mut out = String::new();
    json(&mut out, value, ascii, Some(2), 0);
    out
}

/// `str(value)`: texts as they are, everything else as Python source.
pub fn str(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        other => {
            let mut out = String::new();
            repr(&mut out, other);
            out
        }
    }
}

fn json(out: &mut String, value: &Value, ascii: Ascii, indent: Option<usize>, depth: usize) {
    let line = |out: &mut String, depth: usize, first: bool| match indent {
        None if first => {}
        None => out.push(' '),
        Some(width) => {
            out.push('\n');
            out.extend(std::iter::repeat_n(' ', width * depth));
        }
    };
    match value {
        Value::Null => out.push_str("null"),
        Value::Bool(value) => out.push_str(if *value { "true" } else { "false" }),
        Value::Number(_) => number(out, value),
        Value::String(text) => quoted(out, text, ascii),
        Value::Array(items) if items.is_empty() => out.push_str("[]"),
        Value::Object(object) if object.is_empty() => out.push_str("{}"),
        Value::Array(items) => {
            out.push('[');
            for (at, item) in items.iter().enumerate() {
                if at > 0 {
                    out.push(',');
                }
                line(out, depth + 1, at == 0);
                json(out, item, ascii, indent, depth + 1);
            }
            if indent.is_some() {
                line(out, depth, false);
            }
            out.push(']');
        }
        Value::Object(object) => {
            out.push('{');
            for (at, (key, item)) in object.iter().enumerate() {
                if at > 0 {
                    out.push(',');
                }
                line(out, depth + 1, at == 0);
                quoted(out, key, ascii);
                out.push_str(": ");
                json(out, item, ascii, indent, depth + 1);
            }
            if indent.is_some() {
                line(out, depth, false);
            }
            out.push('}');
        }
    }
}

fn quoted(out: &mut String, text: &str, ascii: Ascii) {
    out.push('"');
    for c in text.chars() {
        match c {
            '"' => out.push_str("\\\""),
            '\\' => out.push_str("\\\\"),
            '\n' => out.push_str("\\n"),
            '\r' => out.push_str("\\r"),
            '\t' => out.push_str("\\t"),
            '\u{8}' => out.push_str("\\b"),
            '\u{c}' => out.push_str("\\f"),
            ' '..='~' => out.push(c),
            _ if c < ' ' || ascii == Ascii::Escaped => {
                for unit in c.encode_utf16(&mut [0; 2]) {
                    let _ = write!(out, "\\u{unit:04x}");
                }
            }
            _ => out.push(c),
        }
    }
    out.push('"');
}

/// An integer as it is, a float as `repr` writes it: the shortest digits, an exponent below
/// 1e-4 and from 1e16.
fn number(out: &mut String, value: &Value) {
    let Some(float) = value.as_f64().filter(|_| value.is_f64()) else {
        let _ = write!(out, "{value}");
        return;
    };
    let size = float.abs();
    if size != 0.0 && !(1e-4..1e16).contains(&size) {
        let shortest = format!("{float:e}");
        let (digits, exponent) = shortest.split_once('e').unwrap_or((&shortest, "0"));
        let (sign, exponent) = exponent
            .strip_prefix('-')
            .map_or(("+", exponent), |exponent| ("-", exponent));
        let _ = write!(out, "{digits}e{sign}{exponent:0>2}");
    } else {
        let _ = write!(out, "{float:?}");
    }
}

fn repr(out: &mut String, value: &Value) {
    match value {
        Value::Null => out.push_str("None"),
        Value::Bool(value) => out.push_str(if *value { "True" } else { "False" }),
        Value::Number(_) => number(out, value),
        Value::String(text) => repr_text(out, text),
        Value::Array(items) => {
            out.push('[');
            for (at, item) in items.iter().enumerate() {
                out.push_str(if at > 0 { ", " } else { "" });
                repr(out, item);
            }
            out.push(']');
        }
        Value::Object(object) => {
            out.push('{');
            for (at, (key, item)) in object.iter().enumerate() {
                out.push_str(if at > 0 { ", " } else { "" });
                repr_text(out, key);
                out.push_str(": ");
                repr(out, item);
            }
            out.push('}');
        }
    }
}

fn repr_text(out: &mut String, text: &str) {
    let quote = if text.contains('\'') && !text.contains('"') {
        '"'
    } else {
        '\''
    };
    out.push(quote);
    for c in text.chars() {
        match c {
            '\\' => out.push_str("\\\\"),
            '\n' => out.push_str("\\n"),
            '\r' => out.push_str("\\r"),
            '\t' => out.push_str("\\t"),
            c if c == quote => {
                out.push('\\');
                out.push(c);
            }
            c if c.is_control() => {
                let _ = write!(out, "\\x{:02x}", u32::from(c));
            }
            c => out.push(c),
        }
    }
    out.push(quote);
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn json_as_python_writes_it() {
        let value = json!({"a": [1, 2.0, 1e16, 1e-5, -0.5, null], "中": "é\"\u{1f600}\n", "o": {}, "l": []});
        assert_eq!(
            dumps(&value, Ascii::Escaped),
            r#"{"a": [1, 2.0, 1e+16, 1e-05, -0.5, null], "\u4e2d": "\u00e9\"\ud83d\ude00\n", "o": {}, "l": []}"#
        );
        assert_eq!(dumps(&json!(["中"]), Ascii::Plain), r#"["中"]"#);
        assert_eq!(
            dumps_indented(&json!({"a": [1, {"b": 2}], "c": {}}), Ascii::Plain),
            "{\n  \"a\": [\n    1,\n    {\n      \"b\": 2\n    }\n  ],\n  \"c\": {}\n}"
        );
    }

    #[test]
    fn source_as_python_writes_it() {
        let value = json!({"it's": [true, null, 1.5, "say \"it's\"", "a\nb"], "x": "中"});
        assert_eq!(
            str(&value),
            r#"{"it's": [True, None, 1.5, 'say "it\'s"', 'a\nb'], 'x': '中'}"#
        );
        assert_eq!(str(&json!("as it's")), "as it's");
    }
}
