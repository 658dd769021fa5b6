//! What a model answered.

use reel_world::{Digest, TokenLogprobs};
use serde::{Deserialize, Serialize};
use serde_json::{Value, error::Category};

/// What a model answered.
#[derive(Clone, PartialEq, Debug)]
pub struct Reply {
    /// Its words; none where it only called.
    pub text: String,
    /// The functions that it called, as it wrote them.
    pub calls: Vec<Value>,
    /// Whether it was cut off at [`crate::client::Endpoint::max_tokens`].
    pub truncated: bool,
    /// Tokens that it read, where the endpoint counts them.
    pub tokens_read: Option<u32>,
    /// Tokens that it wrote, where the endpoint counts them.
    pub tokens_written: Option<u32>,
    /// Log-probabilities of the tokens that it wrote; `None` if they were not asked for
    /// ([`crate::client::Endpoint::logprobs`]), or the endpoint gave none.
    pub logprobs: Option<TokenLogprobs>,
    /// How long it took, pauses and tries in vain included; of a kept reply, when
    /// it was first given.
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
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub calls: Vec<Value>,
    pub truncated: bool,
    pub tokens_read: Option<u32>,
    pub tokens_written: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub logprobs: Option<TokenLogprobs>,
}

/// Why a body of status 200 is no answer.
pub(crate) struct InvalidReply {
    pub reason: String,
    /// Whether it ends too early, so that another try may help.
    pub cut: bool,
}

/// Reads the body of an answer; `logprobs`: whether log-probabilities were asked for.
pub(crate) fn parse(body: &str, logprobs: bool) -> Result<Answer, InvalidReply> {
    let value = json(body)?;
    let choice = value
        .pointer("/choices/0")
        .ok_or_else(|| wrong("it has no field `choices` with an entry"))?;
    let calls = choice
        .pointer("/message/tool_calls")
        .and_then(Value::as_array)
        .cloned()
        .unwrap_or_default();
    let content = choice.pointer("/message/content").and_then(words);
    let text = match content.or_else(|| choice.pointer("/message/refusal").and_then(words)) {
        Some(text) => text,
        None if !calls.is_empty() => String::new(),
        None => {
            return Err(wrong(
                "its first choice holds no text (`message.content`) and no call",
            ));
        }
    };
    let tokens = |path| {
        value
            .pointer(path)
            .and_then(Value::as_u64)
            .and_then(|count| u32::try_from(count).ok())
    };
    Ok(Answer {
        text,
        calls,
        truncated: choice.get("finish_reason").and_then(Value::as_str) == Some("length"),
        tokens_read: tokens("/usage/prompt_tokens"),
        tokens_written: tokens("/usage/completion_tokens"),
        logprobs: if logprobs {
            token_logprobs(choice)?
        } else {
            None
        },
    })
}

/// Reads a body as the answer of a chat and as vectors. For the fuzz targets; requests are
/// [`super::Client`]'s.
#[doc(hidden)]
pub fn read_body(body: &str) -> Option<Vec<Value>> {
    let _ = parse_vectors(body, 2);
    parse(body, true).ok().map(|answer| answer.calls)
}

/// The log-probabilities of a choice; `None` if it has none.
fn token_logprobs(choice: &Value) -> Result<Option<TokenLogprobs>, InvalidReply> {
    #[derive(Deserialize)]
    struct Token {
        token: String,
        logprob: f64,
    }
    let Some(content) = choice
        .pointer("/logprobs/content")
        .filter(|content| !content.is_null())
    else {
        return Ok(None);
    };
    let refuse = |what: String| InvalidReply {
        reason: format!("its log-probabilities (`logprobs.content`) cannot be used: {what}"),
        cut: false,
    };
    let tokens = Vec::<Token>::deserialize(content).map_err(|error| refuse(error.to_string()))?;
    if tokens.is_empty() {
        return Ok(None);
    }
    let (tokens, logprobs) = tokens
        .into_iter()
        .map(|token| (token.token, token.logprob))
        .unzip();
    TokenLogprobs::sampled(tokens, logprobs)
        .map(Some)
        .map_err(|error| refuse(error.to_string()))
}

/// Reads the vectors of so many texts, in their order.
pub(crate) fn parse_vectors(body: &str, count: usize) -> Result<Vec<Vec<f32>>, InvalidReply> {
    let value = json(body)?;
    let data = value
        .get("data")
        .and_then(Value::as_array)
        .ok_or_else(|| wrong("it has no field `data` with a list"))?;
    let mut vectors = vec![Vec::new(); count];
    for (place, entry) in data.iter().enumerate() {
        let index = entry
            .get("index")
            .and_then(Value::as_u64)
            .map_or(place, |index| index as usize);
        let vector = entry
            .get("embedding")
            .and_then(|vector| Vec::<f32>::deserialize(vector).ok())
            .filter(|vector| vector.iter().all(|number| number.is_finite()));
        let vector = vector.ok_or_else(|| {
            wrong("an entry of `data` has no list of finite numbers (`embedding`)")
        })?;
        *vectors
            .get_mut(index)
            .ok_or_else(|| wrong("it holds more vectors than texts were sent"))? = vector;
    }
    match vectors.first().map_or(0, Vec::len) {
        length if length > 0 && vectors.iter().all(|vector| vector.len() == length) => Ok(vectors),
        _ => Err(wrong(
            "its vectors are of different lengths, or not one for each text",
        )),
    }
}

fn json(body: &str) -> Result<Value, InvalidReply> {
    serde_json::from_str(body).map_err(|error| InvalidReply {
        reason: format!("it is not JSON ({error})"),
        cut: error.classify() == Category::Eof,
    })
}

fn wrong(what: &str) -> InvalidReply {
    InvalidReply {
        reason: what.to_owned(),
        cut: false,
    }
}

/// A string, or the texts of a list of parts.
fn words(content: &Value) -> Option<String> {
    match content {
        Value::String(text) => Some(text.clone()),
        Value::Array(parts) => Some(
            parts
                .iter()
                .filter_map(|part| part.get("text").and_then(Value::as_str))
                .collect(),
        ),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms_of_content() {
        let text = |content: &str| {
            parse(
                &format!(r#"{{"choices": [{{"message": {content}, "finish_reason": "length"}}]}}"#),
                false,
            )
            .map(|answer| answer.text)
            .ok()
        };
        assert_eq!(text(r#"{"content": "a"}"#).as_deref(), Some("a"));
        assert_eq!(
            text(r#"{"content": [{"type": "text", "text": "a"}, {"type": "text", "text": "b"}]}"#)
                .as_deref(),
            Some("ab")
        );
        assert_eq!(
            text(r#"{"content": null, "refusal": "no"}"#).as_deref(),
            Some("no")
        );
        assert_eq!(text(r#"{"content": null}"#), None);
        assert_eq!(
            text(r#"{"content": null, "tool_calls": [{"id": "a"}]}"#).as_deref(),
            Some("")
        );
    }

    #[test]
    fn log_probabilities_of_the_tokens() {
        let body = |logprobs: &str| {
            format!(
                r#"{{"choices": [{{"message": {{"content": "a b"}}, "logprobs": {logprobs}}}]}}"#
            )
        };
        let whole = r#"{"content": [{"token": "a", "logprob": -0.5, "bytes": [97], "top_logprobs": []},
            {"token": " b", "logprob": 0}]}"#;
        let asked = |logprobs: &str| {
            parse(&body(logprobs), true)
                .map(|answer| answer.logprobs)
                .map_err(|error| error.reason)
        };
        let found = asked(whole).unwrap().unwrap();
        assert_eq!(
            (found.tokens(), found.of("old")),
            (
                ["a".to_owned(), " b".to_owned()].as_slice(),
                Some([-0.5, 0.0].as_slice())
            )
        );
        assert!(
            parse(&body(whole), false).ok().unwrap().logprobs.is_none(),
            "nobody asked"
        );
        for none in ["null", "{}", r#"{"content": null}"#, r#"{"content": []}"#] {
            assert_eq!(asked(none), Ok(None), "{none}");
        }
        for (wrong, word) in [
            (
                r#"{"content": [{"token": "a", "logprob": 0.5}]}"#,
                "at most 0",
            ),
            (r#"{"content": [{"token": "a"}]}"#, "logprob"),
            (r#"{"content": 3}"#, "sequence"),
        ] {
            let error = asked(wrong).unwrap_err();
            assert!(
                error.contains("logprobs.content") && error.contains(word),
                "{error}"
            );
        }
    }

    #[test]
    fn vectors_come_in_the_order_of_the_texts() {
        let body =
            r#"{"data": [{"index": 1, "embedding": [0.5, 1]}, {"index": 0, "embedding": [2, 3]}]}"#;
        assert_eq!(
            parse_vectors(body, 2).ok(),
            Some(vec![vec![2.0, 3.0], vec![0.5, 1.0]])
        );
        for (count, body) in [
            (3, body),
            (1, body),
            (1, r#"{"data": [{"embedding": "x"}]}"#),
            (1, "{}"),
            (1, r#"{"data": []}"#),
        ] {
            assert!(parse_vectors(body, count).is_err(), "{body}");
        }
    }

    #[test]
    fn what_is_no_answer() {
        for (body, cut, word) in [
            (r#"{"choices": [{"message": {"content": "to"#, true, "JSON"),
            ("", true, "JSON"),
            ("<html>", false, "JSON"),
            ("[]", false, "choices"),
            (r#"{"choices": []}"#, false, "choices"),
            (
                r#"{"choices": [{"text": "old"}]}"#,
                false,
                "message.content",
            ),
        ] {
            let error = parse(body, false).err().unwrap();
            assert!(
                error.cut == cut && error.reason.contains(word),
                "{body}: {}",
                error.reason
            );
        }
    }
}
