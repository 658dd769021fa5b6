//! What a span tells, by whichever convention it was made: the semantic conventions for generative AI of several
//! versions, OpenInference, OpenLLMetry.

use std::{collections::BTreeMap, sync::Arc};

use reel_otlp::{KeyValue, Span, span::Event, status::StatusCode};
use reel_world::record::Score;
use serde_json::Value;

use super::{
    messages::{self, Message},
    names,
};

/// Most characters of a message of an error.
const ERROR_CHARACTERS: usize = 2_000;

/// What a span is of.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Role {
    /// An agent from its start to its end.
    Agent,
    /// A response of a model.
    Chat,
    /// The execution of a tool.
    Tool,
    /// Something else, which is not read.
    Other,
}

/// A span with its attributes as JSON.
#[derive(Clone, Debug)]
pub(super) struct SpanFacts {
    pub(super) span: Span,
    pub(super) attributes: BTreeMap<String, Value>,
    pub(super) resource: Arc<BTreeMap<String, Value>>,
    pub(super) role: Role,
}

/// Attributes as JSON by their names.
pub(super) fn by_name(attributes: &[KeyValue]) -> BTreeMap<String, Value> {
    let pair = |pair: &KeyValue| Some((pair.key.clone(), pair.value.as_ref()?.to_json()));
    attributes.iter().filter_map(pair).collect()
}

impl SpanFacts {
    pub(super) fn new(mut span: Span, resource: Arc<BTreeMap<String, Value>>) -> Self {
        let attributes = by_name(&std::mem::take(&mut span.attributes));
        let role = role(&attributes);
        Self {
            span,
            attributes,
            resource,
            role,
        }
    }

    /// The first of these attributes that is there, as a text.
    pub(super) fn text(&self, keys: &[&str]) -> Option<String> {
        let mut values = keys.iter().filter_map(|key| self.attributes.get(*key));
        values.find_map(messages::text_of)
    }

    fn count(&self, keys: &[&str]) -> Option<u32> {
        let mut values = keys.iter().filter_map(|key| self.attributes.get(*key));
        values.find_map(|value| match value {
            Value::String(text) => text.parse().ok(),
            value => u32::try_from(value.as_u64()?).ok(),
        })
    }

    /// The conversation that the span names.
    pub(super) fn conversation(&self) -> Option<String> {
        self.text(&[
            names::CONVERSATION,
            "session.id",
            "traceloop.association.properties.session_id",
        ])
    }

    pub(super) fn agent(&self) -> Option<String> {
        self.text(&[names::AGENT_NAME, "agent.name", "traceloop.entity.name"])
    }

    pub(super) fn model(&self) -> Option<String> {
        self.text(&[
            names::REQUEST_MODEL,
            "gen_ai.response.model",
            "llm.model_name",
        ])
    }

    /// Tokens read and written.
    pub(super) fn tokens(&self) -> [Option<u32>; 2] {
        [
            self.count(&[
                names::INPUT_TOKENS,
                "gen_ai.usage.prompt_tokens",
                "llm.token_count.prompt",
            ]),
            self.count(&[
                names::OUTPUT_TOKENS,
                "gen_ai.usage.completion_tokens",
                "llm.token_count.completion",
            ]),
        ]
    }

    /// Class and message of the error, where the span ended in one.
    pub(super) fn error(&self) -> Option<String> {
        let kind = self.text(&[names::ERROR_TYPE]);
        let status = self.span.status.as_ref();
        let status = status.filter(|status| status.code() == StatusCode::Error);
        if kind.is_none() && status.is_none() {
            return None;
        }
        let of_event = |event: &Event| {
            let facts = by_name(&event.attributes);
            let words = facts
                .get("exception.message")
                .or(facts.get("exception.type"))?;
            messages::text_of(words)
        };
        let message = status.map(|status| status.message.clone());
        let message = message.filter(|message| !message.is_empty());
        let exception = || {
            let mut events = self.span.events.iter();
            events.find_map(|event| of_event(event).filter(|_| event.name == "exception"))
        };
        let words = message.or_else(exception).or(kind);
        let words = words.unwrap_or_else(|| "error".to_owned());
        Some(words.chars().take(ERROR_CHARACTERS).collect())
    }

    /// Name of the tool that was executed.
    pub(super) fn tool(&self) -> String {
        let name = self.text(&[names::TOOL_NAME, "tool.name", "traceloop.entity.name"]);
        let of_span = || {
            let name = &self.span.name;
            name.strip_prefix("execute_tool ")
                .unwrap_or(name)
                .to_owned()
        };
        name.unwrap_or_else(of_span)
    }

    pub(super) fn call_id(&self) -> Option<String> {
        self.text(&[names::CALL_ID, "tool_call.id", "tool.id"])
    }

    /// Arguments of the tool, where they are recorded.
    pub(super) fn arguments(&self) -> Option<Value> {
        let keys = [
            names::CALL_ARGUMENTS,
            "input.value",
            "traceloop.entity.input",
        ];
        let told = keys.iter().find_map(|key| self.attributes.get(*key))?;
        let arguments = messages::arguments(told);
        // OpenLLMetry has them below `inputs`.
        match arguments.get("inputs") {
            Some(inputs) if inputs.is_object() && arguments.get("tags").is_some() => {
                Some(inputs.clone())
            }
            _ => Some(arguments),
        }
    }

    /// The result of the tool, where it is recorded.
    pub(super) fn result(&self) -> Option<&Value> {
        let keys = [
            names::CALL_RESULT,
            "output.value",
            "traceloop.entity.output",
        ];
        keys.iter().find_map(|key| self.attributes.get(*key))
    }

    /// What the model or the agent got, system prompt first.
    pub(super) fn input(&self) -> Vec<Message> {
        let mut found = self.structured(names::SYSTEM_INSTRUCTIONS, "system");
        let mut messages = self.structured(names::INPUT_MESSAGES, "user");
        for prefix in ["llm.input_messages", "gen_ai.prompt"] {
            if messages.is_empty() {
                messages = messages::flattened(&self.attributes, prefix);
            }
        }
        if messages.is_empty() {
            messages = self.of_events(&["system", "user", "assistant", "tool"]);
        }
        for key in ["gen_ai.prompt", "input.value", "traceloop.entity.input"] {
            if messages.is_empty() && found.is_empty() {
                messages = self.structured(key, "user");
            }
        }
        found.append(&mut messages);
        found
    }

    /// What the model or the agent said; of several choices the first.
    pub(super) fn output(&self) -> Vec<Message> {
        let mut messages = self.structured(names::OUTPUT_MESSAGES, "assistant");
        for prefix in ["llm.output_messages", "gen_ai.completion"] {
            if messages.is_empty() {
                messages = messages::flattened(&self.attributes, prefix);
            }
        }
        if messages.is_empty() {
            messages = self.of_events(&["choice"]);
        }
        for key in [
            "gen_ai.completion",
            "output.value",
            "traceloop.entity.output",
        ] {
            if messages.is_empty() {
                messages = self.structured(key, "assistant");
            }
        }
        messages
    }

    fn structured(&self, key: &str, role: &str) -> Vec<Message> {
        let of_span = self.attributes.get(key).cloned();
        let value = of_span.or_else(|| {
            // Content may stand in an event of its own.
            let details = "gen_ai.client.inference.operation.details";
            let event = self
                .span
                .events
                .iter()
                .find(|event| event.name == details)?;
            by_name(&event.attributes).remove(key)
        });
        value.map_or_else(Vec::new, |value| messages::structured(&value, role))
    }

    /// Messages as events `gen_ai.ROLE.message` and `gen_ai.choice`, which conventions of before have.
    fn of_events(&self, roles: &[&str]) -> Vec<Message> {
        let role = |event: &Event| {
            let name = event.name.strip_prefix("gen_ai.")?;
            let role = name.strip_suffix(".message").unwrap_or(name);
            roles.contains(&role).then(|| role.to_owned())
        };
        let events = self.span.events.iter();
        let found = events.filter_map(|event| Some((role(event)?, by_name(&event.attributes))));
        found
            .flat_map(|(role, mut facts)| {
                if role == "choice" {
                    let message = facts.remove("message").or(facts.remove("content"));
                    return message.map_or_else(Vec::new, |message| {
                        messages::structured(&message, "assistant")
                    });
                }
                facts
                    .entry("role".to_owned())
                    .or_insert(role.clone().into());
                if let Some(id) = facts.remove("id") {
                    facts.entry("tool_call_id".to_owned()).or_insert(id);
                }
                messages::structured(&facts.into_iter().collect(), &role)
            })
            .collect()
    }

    /// Tools that the agent could call, in OpenAI's schema.
    pub(super) fn tools(&self) -> Vec<Value> {
        let parsed = |value: &Value| match value {
            Value::String(text) => serde_json::from_str(text).ok(),
            value => Some(value.clone()),
        };
        if let Some(Value::Array(tools)) = self
            .attributes
            .get(names::TOOL_DEFINITIONS)
            .and_then(parsed)
        {
            return tools.into_iter().map(nested_tool).collect();
        }
        let schemas = messages::indexed(&self.attributes, "llm.tools").into_values();
        let schemas = schemas.filter_map(|fields| parsed(fields.get("tool.json_schema")?));
        schemas.map(nested_tool).collect()
    }

    /// The results of evaluations that the span has as events.
    pub(super) fn scores(&self) -> Vec<Score> {
        let results = self.span.events.iter();
        let results = results.filter(|event| event.name == names::EVALUATION);
        results
            .filter_map(|event| {
                let facts = by_name(&event.attributes);
                let text = |key: &str| facts.get(key).and_then(messages::text_of);
                let value = facts.get(names::SCORE_VALUE);
                Some(Score {
                    name: text(names::EVALUATION_NAME)?,
                    value: value.and_then(Value::as_f64),
                    label: text(names::SCORE_LABEL),
                    explanation: text(names::EXPLANATION),
                })
            })
            .collect()
    }
}

/// A tool in OpenAI's schema.
fn nested_tool(tool: Value) -> Value {
    let Value::Object(mut fields) = tool else {
        return tool;
    };
    if fields.contains_key("function") {
        return Value::Object(fields);
    }
    fields.remove("type");
    serde_json::json!({"type": "function", "function": fields})
}

fn role(attributes: &BTreeMap<String, Value>) -> Role {
    let text = |key: &str| attributes.get(key).and_then(Value::as_str);
    match text(names::OPERATION) {
        Some("invoke_agent" | "invoke_workflow") => return Role::Agent,
        Some("chat" | "generate_content" | "text_completion") => return Role::Chat,
        Some("execute_tool") => return Role::Tool,
        Some(_) => return Role::Other,
        None => {}
    }
    let kind = text("openinference.span.kind").map(str::to_ascii_lowercase);
    match kind.as_deref() {
        Some("agent") => return Role::Agent,
        Some("llm") => return Role::Chat,
        Some("tool") => return Role::Tool,
        Some(_) => return Role::Other,
        None => {}
    }
    match text("traceloop.span.kind") {
        Some("agent" | "workflow") => return Role::Agent,
        Some("tool") => return Role::Tool,
        Some(_) => return Role::Other,
        None => {}
    }
    let of_model = ["llm.request.type", "gen_ai.system", names::REQUEST_MODEL];
    if of_model.iter().any(|key| attributes.contains_key(*key)) {
        let embeds = text("llm.request.type") == Some("embedding");
        return if embeds { Role::Other } else { Role::Chat };
    }
    Role::Other
}
