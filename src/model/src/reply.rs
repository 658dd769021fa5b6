//! What a model answered.

use reel_world::Digest;
use serde::{Deserialize, Serialize};
use serde_json::{Value, error::Category};

/// What a model answered.
#[derive(Clone, PartialEq, Debug)]
pub struct Reply {
    /// Its words.
    pub text: String,
    /// Whether it was cut off at [`crate::Endpoint::max_tokens`].
    pub truncated: bool,
    /// Tokens that it read, where the endpoint counts them.
    pub tokens_read: Option<u32>,
    /// Tokens that it wrote, where the endpoint counts them.
    pub tokens_written: Option<u32>,
    /// How long it took, pauses and tries in vain included; of a kept reply, when it was first given.
    pub latency_ns: u64,
    /// Whether nobody was asked, because the reply was kept from an equal request.
    pub cached: bool,
    /// Of the request's canonical JSON; leads to the log and the cache.
    pub request: Digest,
}

/// The part of a reply that came from the model.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub(crate) struct Answer {
    pub text: String,
    pub truncated: bool,
    pub tokens_read: Option<u32>,
    pub tokens_written: Option<u32>,
}

/// Why a body of status 200 is no answer.
pub(crate) struct NoAnswer {
    pub what: String,
    /// Whether it ends too early, so that another try may help.
    pub cut: bool,
}

/// Reads the body of an answer.
pub(crate) fn parse(body: &str) -> Result<Answer, NoAnswer> {
    let wrong = |what: String| NoAnswer { what, cut: false };
    let value: Value = serde_json::from_str(body)
        .map_err(|error| NoAnswer { what: format!("it is no JSON ({error})"), cut: error.classify() == Category::Eof })?;
    let choice = value.pointer("/choices/0").ok_or_else(|| wrong("it has no field `choices` with an entry".to_owned()))?;
    let content = choice.pointer("/message/content").and_then(words);
    let text = match content.or_else(|| choice.pointer("/message/refusal").and_then(words)) {
        Some(text) => text,
        None => return Err(wrong("its first choice holds no text (`message.content`)".to_owned())),
    };
    let tokens = |path| value.pointer(path).and_then(Value::as_u64).and_then(|count| u32::try_from(count).ok());
    Ok(Answer {
        text,
        truncated: choice.get("finish_reason").and_then(Value::as_str) == Some("length"),
        tokens_read: tokens("/usage/prompt_tokens"),
        tokens_written: tokens("/usage/completion_tokens"),
    })
}

/// A string, or the texts of a list of parts.
fn words(content: &Value) -> Option<String> {
    match content {
        Value::String(text) => Some(text.clone()),
        Value::Array(parts) => Some(parts.iter().filter_map(|part| part.get("text").and_then(Value::as_str)).collect()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms_of_content() {
        let text = |content: &str| {
            parse(&format!(r#"{{"choices": [{{"message": {content}, "finish_reason": "length"}}]}}"#))
                .map(|answer| answer.text)
                .ok()
        };
        assert_eq!(text(r#"{"content": "a"}"#).as_deref(), Some("a"));
        assert_eq!(text(r#"{"content": [{"type": "text", "text": "a"}, {"type": "text", "text": "b"}]}"#).as_deref(), Some("ab"));
        assert_eq!(text(r#"{"content": null, "refusal": "no"}"#).as_deref(), Some("no"));
        assert_eq!(text(r#"{"content": null}"#), None);
    }

    #[test]
    fn what_is_no_answer() {
        for (body, cut, word) in [
            (r#"{"choices": [{"message": {"content": "to"#, true, "JSON"),
            ("", true, "JSON"),
            ("<html>", false, "JSON"),
            ("[]", false, "choices"),
            (r#"{"choices": []}"#, false, "choices"),
            (r#"{"choices": [{"text": "old"}]}"#, false, "message.content"),
        ] {
            let error = parse(body).err().unwrap();
            assert!(error.cut == cut && error.what.contains(word), "{body}: {}", error.what);
        }
    }
}
