//! Attributes and their values, from Rust and JSON and back.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde_json::{Number, Value as Json};

use crate::{AnyValue, KeyValue, any_value::Value};

/// Most levels of lists and objects within a value; what lies deeper is null.
const DEPTH_MAX: u32 = 64;

impl KeyValue {
    /// An attribute of that name.
    pub fn new(key: &str, value: impl Into<Value>) -> Self {
        Self {
            key: key.to_owned(),
            value: Some(AnyValue {
                value: Some(value.into()),
            }),
            key_strindex: 0,
        }
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Value::StringValue(text.to_owned())
    }
}

impl From<String> for Value {
    fn from(text: String) -> Self {
        Value::StringValue(text)
    }
}

impl From<bool> for Value {
    fn from(flag: bool) -> Self {
        Value::BoolValue(flag)
    }
}

impl From<f64> for Value {
    fn from(number: f64) -> Self {
        Value::DoubleValue(number)
    }
}

impl From<i64> for Value {
    fn from(number: i64) -> Self {
        Value::IntValue(number)
    }
}

impl From<u32> for Value {
    fn from(number: u32) -> Self {
        Value::IntValue(number.into())
    }
}

impl From<Vec<String>> for Value {
    fn from(texts: Vec<String>) -> Self {
        let value = |text| AnyValue {
            value: Some(Value::StringValue(text)),
        };
        Value::ArrayValue(crate::ArrayValue {
            values: texts.into_iter().map(value).collect(),
        })
    }
}

impl AnyValue {
    /// The value as JSON: bytes in base64, numbers that JSON has not as null.
    pub fn to_json(&self) -> Json {
        self.json(0)
    }

    fn json(&self, depth: u32) -> Json {
        if depth > DEPTH_MAX {
            return Json::Null;
        }
        let of = |value: &AnyValue| value.json(depth + 1);
        match &self.value {
            None | Some(Value::StringValueStrindex(_)) => Json::Null,
            Some(Value::StringValue(text)) => Json::String(text.clone()),
            Some(Value::BoolValue(flag)) => Json::Bool(*flag),
            Some(Value::IntValue(number)) => Json::from(*number),
            Some(Value::DoubleValue(number)) => {
                Number::from_f64(*number).map_or(Json::Null, Json::Number)
            }
            Some(Value::ArrayValue(list)) => list.values.iter().map(of).collect(),
            Some(Value::KvlistValue(list)) => list
                .values
                .iter()
                .map(|pair| {
                    (
                        pair.key.clone(),
                        pair.value.as_ref().map(of).unwrap_or_default(),
                    )
                })
                .collect(),
            Some(Value::BytesValue(bytes)) => Json::String(STANDARD.encode(bytes)),
        }
    }
}

/// Bytes as hexadecimal digits, in lower case.
pub fn to_hex(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 16] = b"0123456789abcdef";
    let digits = bytes.iter().flat_map(|byte| {
        [
            DIGITS[usize::from(byte >> 4)],
            DIGITS[usize::from(byte & 15)],
        ]
    });
    digits.map(char::from).collect()
}

/// Bytes from hexadecimal digits in any case; `None` if there are others, or half a byte.
pub fn from_hex(text: &str) -> Option<Vec<u8>> {
    let digit = |byte: &u8| char::from(*byte).to_digit(16).map(|digit| digit as u8);
    let pairs = text.as_bytes().chunks(2);
    pairs
        .map(|pair| match pair {
            [high, low] => Some(digit(high)? << 4 | digit(low)?),
            _ => None,
        })
        .collect()
}
