//! Values of attributes as numbers and words, whatever their precision.

use openusd::{
    sdf::Value,
    usd::{Prim, TimeCode},
};

/// Whether a number may be a length, an angle or a factor.
pub fn is_sane(value: f64) -> bool {
    value.is_finite() && value.abs() <= 1e6
}

/// The value of an attribute; of an animated one the first.
pub fn value(prim: &Prim, name: &str) -> Option<Value> {
    let attribute = prim.attribute(name);
    let fixed = attribute.get::<Value>().ok().flatten();
    fixed.or_else(|| {
        let first = attribute.time_sample_times().ok()?.first().copied()?;
        attribute
            .get_at::<Value>(TimeCode::from(first))
            .ok()
            .flatten()
    })
}

/// An attribute of exactly so many finite numbers.
pub fn numbers<const N: usize>(prim: &Prim, name: &str) -> Option<[f64; N]> {
    let list: [f64; N] = list(&value(prim, name)?)?.try_into().ok()?;
    list.into_iter().all(is_sane).then_some(list)
}

/// The numbers of a value, flat; quaternions as x, y, z, w.
pub fn list(value: &Value) -> Option<Vec<f64>> {
    let single = f64::from;
    Some(match value {
        Value::Half(number) => vec![number.to_f64()],
        Value::Float(number) => vec![single(*number)],
        Value::Double(number) => vec![*number],
        Value::Int(number) => vec![f64::from(*number)],
        Value::Int64(number) => vec![*number as f64],
        Value::FloatVec(all) => all.iter().copied().map(single).collect(),
        Value::DoubleVec(all) => all.clone(),
        Value::Vec2f(v) => [v.x, v.y].map(single).into(),
        Value::Vec2hVec(all) => all
            .iter()
            .flat_map(|v| [v.x, v.y].map(|part| part.to_f64()))
            .collect(),
        Value::Vec2fVec(all) => all.iter().flat_map(|v| [v.x, v.y].map(single)).collect(),
        Value::Vec2dVec(all) => all.iter().flat_map(|v| [v.x, v.y]).collect(),
        Value::Vec4f(v) => [v.x, v.y, v.z, v.w].map(single).into(),
        Value::Vec3h(v) => [v.x, v.y, v.z].map(|part| part.to_f64()).into(),
        Value::Vec3f(v) => [v.x, v.y, v.z].map(single).into(),
        Value::Vec3d(v) => vec![v.x, v.y, v.z],
        Value::Quath(q) => [q.x, q.y, q.z, q.w].map(|part| part.to_f64()).into(),
        Value::Quatf(q) => [q.x, q.y, q.z, q.w].map(single).into(),
        Value::Quatd(q) => vec![q.x, q.y, q.z, q.w],
        Value::Matrix4d(matrix) => matrix.0.to_vec(),
        Value::Vec3hVec(all) => all
            .iter()
            .flat_map(|v| [v.x, v.y, v.z].map(|part| part.to_f64()))
            .collect(),
        Value::Vec3fVec(all) => all
            .iter()
            .flat_map(|v| [v.x, v.y, v.z].map(single))
            .collect(),
        Value::Vec3dVec(all) => all.iter().flat_map(|v| [v.x, v.y, v.z]).collect(),
        Value::ValueVec(all) => all.iter().filter_map(list).flatten().collect(),
        _ => return None,
    })
}

/// The integers of a value.
pub fn integers(value: &Value) -> Option<Vec<i64>> {
    Some(match value {
        Value::Int(number) => vec![i64::from(*number)],
        Value::IntVec(all) => all.iter().copied().map(i64::from).collect(),
        Value::UintVec(all) => all.iter().copied().map(i64::from).collect(),
        Value::Int64Vec(all) => all.clone(),
        Value::ValueVec(all) if all.is_empty() => Vec::new(),
        _ => return None,
    })
}

/// A token or text.
pub fn token(prim: &Prim, name: &str) -> Option<String> {
    word(&value(prim, name)?)
}

pub(super) fn word(value: &Value) -> Option<String> {
    match value {
        Value::Token(token) => Some(token.as_str().to_owned()),
        Value::String(text) => Some(text.clone()),
        Value::TokenVec(tokens) => tokens.first().map(|token| token.as_str().to_owned()),
        Value::StringVec(texts) => texts.first().cloned(),
        _ => None,
    }
}

/// The tokens of an attribute.
pub fn tokens(prim: &Prim, name: &str) -> Vec<String> {
    match value(prim, name) {
        Some(Value::TokenVec(tokens)) => tokens
            .iter()
            .map(|token| token.as_str().to_owned())
            .collect(),
        Some(Value::StringVec(texts)) => texts,
        _ => Vec::new(),
    }
}

/// The first target of a relationship.
pub fn target(prim: &Prim, name: &str) -> Option<String> {
    let targets = prim.relationship(name).targets().ok()?;
    targets.first().map(|path| path.as_str().to_owned())
}

/// The numbers of an attribute, flat.
pub(super) fn list_of(prim: &Prim, name: &str) -> Option<Vec<f64>> {
    list(&value(prim, name)?)
}
