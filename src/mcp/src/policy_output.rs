//! What came with a decision, as far as a client says it in the `_meta` of a call.

use reel_world::record::PolicyOutput;
use serde::Deserialize as _;
use serde_json::{Map, Value};

/// The key of `_meta` under which a client says what its policy thought: an object with any of
/// [`POLICY_FIELDS`].
const POLICY: &str = "reel/policy";
const POLICY_FIELDS: [&str; 7] = reel_world::words! {
    reasoning history plan raw tokens latency_ns logprobs
};

/// What came with a decision, where the client says it: `meta` is what the protocol lets a client
/// add to a call.
///
/// # Errors
/// When the client says it in another way.
pub fn policy_output(meta: &Map<String, Value>) -> Result<Option<PolicyOutput>, String> {
    let wrong = |what: &str| format!("[\"{POLICY}\"] is not what came with a decision: {what}");
    let fields = match meta.get(POLICY) {
        None | Some(Value::Null) => return Ok(None),
        Some(Value::Object(fields)) => fields,
        Some(_) => return Err(wrong("it is no object")),
    };
    let unknown = |name: &&String| !POLICY_FIELDS.contains(&name.as_str());
    if let Some(name) = fields.keys().find(unknown) {
        let known = POLICY_FIELDS.join(", ");
        return Err(wrong(&format!("it may have {known}, not {name:?}")));
    }
    let output = PolicyOutput::deserialize(fields).map_err(|error| wrong(&error.to_string()))?;
    let tokens = output.tokens.into_iter().flatten();
    if tokens
        .max()
        .is_some_and(|most| i32::try_from(most).is_err())
        || output
            .latency_ns
            .is_some_and(|ns| i64::try_from(ns).is_err())
    {
        return Err(wrong("a number is too large"));
    }
    Ok(Some(output))
}
