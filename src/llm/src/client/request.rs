//! What is asked, and how it stands on the wire.

use base64::{Engine, engine::general_purpose::STANDARD};
use serde_json::{Map, Value, json};

use crate::client::Endpoint;

/// A conversation that the model is to continue.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Request {
    /// Messages of the conversation, the oldest first.
    pub messages: Vec<Message>,
    /// The functions that it may call, as a list of `{type: function, function: {...}}`; null
    /// where there are none.
    pub tools: Value,
    /// Seed of the draws; sent where the temperature is above 0, for else nothing is drawn.
    pub seed: Option<u64>,
}

/// A message of a conversation.
#[derive(Clone, PartialEq, Debug)]
pub struct Message {
    /// Who wrote the message: system, user, assistant or tool.
    pub role: Role,
    /// Texts and images in their order.
    pub parts: Vec<Part>,
    /// The functions that the model called in it, as it wrote them.
    pub calls: Vec<Value>,
    /// The call that it answers, by its id.
    pub answers: Option<String>,
}

impl Message {
    /// A message of texts and images.
    pub fn new(role: Role, parts: Vec<Part>) -> Self {
        Self {
            role,
            parts,
            calls: Vec::new(),
            answers: None,
        }
    }

    /// A message of one text.
    pub fn text(role: Role, text: impl Into<String>) -> Self {
        Self::new(role, vec![Part::Text(text.into())])
    }

    /// What came of a call.
    pub fn outcome(call: impl Into<String>, text: impl Into<String>) -> Self {
        Self {
            answers: Some(call.into()),
            ..Self::text(Role::Tool, text)
        }
    }
}

/// The author of a message in a conversation.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Role {
    /// Whoever wrote the prompt.
    System,
    /// The side that asks the model for an answer.
    User,
    /// The model that answers the messages.
    Assistant,
    /// A function that the model called.
    Tool,
}

/// A part of a message.
#[derive(Clone, PartialEq, Debug)]
pub enum Part {
    /// Plain text in a message's content.
    Text(String),
    /// An image, sent as a data URL.
    Image {
        /// Media type of the image file, e.g. `image/png`.
        media_type: String,
        /// Content of the image file, as encoded bytes.
        bytes: Vec<u8>,
    },
}

/// The body of a request for the vectors of texts.
pub(crate) fn embedding_body(endpoint: &Endpoint, texts: &[&str]) -> Value {
    json!({"model": endpoint.model, "input": texts})
}

/// The body of the request. It holds no address and no key.
pub(crate) fn body(endpoint: &Endpoint, request: &Request) -> Value {
    let messages: Vec<Value> = request.messages.iter().map(message).collect();
    let mut body = Map::new();
    body.insert("model".into(), json!(endpoint.model));
    body.insert("messages".into(), Value::Array(messages));
    body.insert("temperature".into(), json!(endpoint.temperature));
    body.insert("max_tokens".into(), json!(endpoint.max_tokens));
    if endpoint.logprobs {
        body.insert("logprobs".into(), json!(true));
    }
    if let Some(seed) = request.seed.filter(|_| endpoint.temperature > 0.0) {
        body.insert("seed".into(), json!(seed));
    }
    if !request.tools.is_null() {
        body.insert("tools".into(), request.tools.clone());
    }
    for (name, value) in &endpoint.extra {
        match value {
            Value::Null => drop(body.remove(name)),
            value => drop(body.insert(name.clone(), value.clone())),
        }
    }
    Value::Object(body)
}

/// One text is a plain string: servers without eyes take no lists.
fn message(message: &Message) -> Value {
    let role = match message.role {
        Role::System => "system",
        Role::User => "user",
        Role::Assistant => "assistant",
        Role::Tool => "tool",
    };
    let content = match message.parts.as_slice() {
        [] => Value::Null,
        [Part::Text(text)] => json!(text),
        parts => parts.iter().map(part).collect(),
    };
    let mut said = json!({"role": role, "content": content});
    if !message.calls.is_empty() {
        said["tool_calls"] = message.calls.iter().cloned().collect();
    }
    if let Some(call) = &message.answers {
        said["tool_call_id"] = json!(call);
    }
    said
}

fn part(part: &Part) -> Value {
    match part {
        Part::Text(text) => json!({"type": "text", "text": text}),
        Part::Image { media_type, bytes } => {
            json!({"type": "image_url", "image_url": {"url": format!("data:{media_type};base64,{}", STANDARD.encode(bytes))}})
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_is_sent_where_something_is_drawn() {
        let mut endpoint = Endpoint::new("http://localhost:9/v1", "m");
        let request = Request {
            seed: Some(7),
            ..Request::default()
        };
        assert_eq!(body(&endpoint, &request).get("seed"), None);
        endpoint.temperature = 0.5;
        assert_eq!(body(&endpoint, &request)["seed"], json!(7));
        endpoint.extra.insert("seed".to_owned(), Value::Null);
        assert_eq!(body(&endpoint, &request).get("seed"), None);
    }
}
