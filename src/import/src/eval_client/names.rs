//! Names of folders and files.

use serde_json::Value;

/// Of what has no letter that may stand in a name.
const UNKNOWN: &str = "unknown";

/// A value as a folder name: what is no ASCII letter, digit, `.`, `_` or `-` becomes one `_`, and
/// none of `._` stands at the ends. As in Python, nothing is `None`.
pub fn path_component(value: &Value) -> String {
    let text = match value {
        Value::Null => "None".to_owned(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    let mut name = String::with_capacity(text.len());
    let mut replaced = false;
    for letter in text.chars() {
        let kept = letter.is_ascii_alphanumeric() || "._-".contains(letter);
        if kept {
            name.push(letter);
        } else if !replaced {
            name.push('_');
        }
        replaced = !kept;
    }
    match name.trim_matches(['.', '_']) {
        "" => UNKNOWN.to_owned(),
        name => name.to_owned(),
    }
}

/// A model's name as part of a path: also without `-`.
pub fn model_slug(model: &str) -> String {
    path_component(&Value::from(model.replace(['-', '/'], "_")))
}
