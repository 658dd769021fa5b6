//! Where OTLP/JSON is not the JSON that serde derives: ids in hexadecimal digits, 64-bit integers as texts,
//! bytes in base64. Reads leniently: numbers where texts are due, names of enums, snake case is not read.

use serde::{Deserialize, Deserializer, de::Error};
use serde_json::Value;

/// Whether a field is left out.
pub(crate) fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// Bytes as hexadecimal digits.
pub(crate) mod hex {
    use super::*;

    pub(crate) fn serialize<S: serde::Serializer>(
        bytes: &[u8],
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&crate::to_hex(bytes))
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Vec<u8>, D::Error> {
        // What is no id is an empty one, which its span is refused for: the others of the request are good.
        let text = Option::<String>::deserialize(deserializer)?.unwrap_or_default();
        Ok(crate::from_hex(&text).unwrap_or_default())
    }
}

/// Bytes as a text in base64.
pub(crate) mod base64_bytes {
    use base64::{Engine as _, engine::general_purpose::STANDARD};

    use super::*;

    pub(crate) fn serialize<S: serde::Serializer>(
        bytes: &[u8],
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&STANDARD.encode(bytes))
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Vec<u8>, D::Error> {
        let text = String::deserialize(deserializer)?;
        STANDARD.decode(text).map_err(D::Error::custom)
    }
}

/// An integer in a text or as a number.
fn integer<'de, D: Deserializer<'de>, T: TryFrom<i128> + Default>(
    deserializer: D,
) -> Result<T, D::Error> {
    let wrong = || D::Error::custom("it is no integer of 64 bits");
    let value = match Value::deserialize(deserializer)? {
        Value::Null => return Ok(T::default()),
        Value::String(text) => text.trim().parse::<i128>().map_err(|_| wrong())?,
        Value::Number(number) => number
            .as_i128()
            .or_else(|| Some(number.as_f64().filter(|value| value.fract() == 0.0)? as i128))
            .ok_or_else(wrong)?,
        _ => return Err(wrong()),
    };
    T::try_from(value).map_err(|_| wrong())
}

/// An unsigned integer as a text.
pub(crate) mod text_u64 {
    use super::*;

    pub(crate) fn serialize<S: serde::Serializer>(
        value: &u64,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.collect_str(value)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
        integer(deserializer)
    }
}

/// A signed integer as a text.
pub(crate) mod text_i64 {
    use super::*;

    pub(crate) fn serialize<S: serde::Serializer>(
        value: &i64,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.collect_str(value)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<i64, D::Error> {
        integer(deserializer)
    }
}

/// A number of which JSON may have none: not a number and the infinities are texts.
pub(crate) mod double {
    use super::*;

    pub(crate) fn serialize<S: serde::Serializer>(
        value: &f64,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        match value {
            value if value.is_nan() => serializer.serialize_str("NaN"),
            value if value.is_infinite() => serializer.serialize_str(if *value > 0.0 {
                "Infinity"
            } else {
                "-Infinity"
            }),
            value => serializer.serialize_f64(*value),
        }
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
        let number = match Value::deserialize(deserializer)? {
            Value::Number(number) => number.as_f64(),
            // Rust reads the names of JSON in protobuf, too.
            Value::String(text) => text.parse().ok(),
            _ => None,
        };
        number.ok_or_else(|| D::Error::custom("it is no number"))
    }
}

/// A value of an enum: its number, or its name as some exporters write it.
fn of_enum<'de, D: Deserializer<'de>>(
    deserializer: D,
    by_name: impl Fn(&str) -> Option<i32>,
) -> Result<i32, D::Error> {
    Ok(match Value::deserialize(deserializer)? {
        Value::String(name) => by_name(&name).unwrap_or_default(),
        value => i32::try_from(value.as_i64().unwrap_or_default()).unwrap_or_default(),
    })
}

/// The kind of a span as its number.
pub(crate) mod span_kind {
    use super::*;
    use crate::span::SpanKind;

    pub(crate) fn serialize<S: serde::Serializer>(
        value: &i32,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.serialize_i32(*value)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<i32, D::Error> {
        of_enum(deserializer, |name| {
            SpanKind::from_str_name(name).map(i32::from)
        })
    }
}

/// The status of a span as its number.
pub(crate) mod status_code {
    use super::*;
    use crate::status::StatusCode;

    pub(crate) fn serialize<S: serde::Serializer>(
        value: &i32,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.serialize_i32(*value)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<i32, D::Error> {
        of_enum(deserializer, |name| {
            StatusCode::from_str_name(name).map(i32::from)
        })
    }
}
