//! What came with a decision, as far as a client says it in the `_meta` of a call.

use reel_world::record::PolicyOutput;
use rmcp::{ErrorData, RoleServer, service::RequestContext};
use serde::Deserialize as _;
use serde_json::Value;

/// The key of `_meta` under which a client says what its policy thought: an object with any of
/// [`POLICY_FIELDS`].
const POLICY: &str = "reel/policy";
const POLICY_FIELDS: [&str; 7] = reel_world::words! {
    reasoning history plan raw tokens latency_ns logprobs
};

/// What came with a decision, where the client says it.
pub(crate) fn policy_output(
    context: &RequestContext<RoleServer>,
) -> Result<Option<PolicyOutput>, ErrorData> {
    let wrong = |what: &str| {
        let text = format!("_meta[\"{POLICY}\"] is not what came with a decision: {what}");
        ErrorData::invalid_params(text, None)
    };
    let fields = match context.meta.0.get(POLICY) {
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
