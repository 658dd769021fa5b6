//! What passes by, as far as it matters here: calls of tools and their results in JSON-RPC, and the tasks in whose name
//! results come later. Whatever else it is, it is not looked into.

use reel_import::long_integers;
use reel_redact::{Redactions, Redactor, Scope};
use reel_world::ToolCall;
use serde::Deserialize;
use serde_json::{Map, Value, json};

/// Code of JSON-RPC for what the one who answers could not do.
const INTERNAL_ERROR: i32 = -32603;
/// Keys of `_meta` in which clients of the newest protocol, which greets nobody, say who they are.
const CLIENT_IN_META: [&str; 2] = ["io.modelcontextprotocol/clientInfo", "clientInfo"];

/// A call of a tool.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Call {
    pub id: Value,
    pub call: ToolCall,
    /// Whether it brings what the server asked for: it goes on with a call that was made before.
    pub has_input: bool,
}

impl Call {
    /// Puts labels in the place of secrets; gives how many there were.
    pub(crate) fn redact(&mut self, redactor: &mut Redactor) -> Redactions {
        self.call.name = redactor.text(&self.call.name);
        redactor.value("arguments", &mut self.call.arguments, Scope::Data);
        redactor.take_redactions()
    }
}

/// What an agent asks about a task.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum TaskMethod {
    /// How far it is; since 2026-07-28 with its result.
    Status,
    /// Its result, of protocol 2025-11-25.
    Result,
}

/// A message of the agent.
#[derive(Clone, PartialEq, Debug)]
pub(crate) enum FromAgent {
    /// No JSON, no JSON-RPC, or a call that MCP does not have.
    Strange,
    /// The agent says who it is.
    Hello(Option<String>),
    /// Calls of tools; more than one in a batch.
    Calls(Vec<Call>),
    /// The agent asks for the first tools of the server.
    ListsTools(Value),
    /// The agent takes a request back.
    Cancelled(Value),
    /// The agent asks for a task, by the id of its request.
    AsksForTask {
        id: Value,
        method: TaskMethod,
        task_id: String,
    },
    /// Something else of the protocol.
    Other,
}

/// Reads a message of the agent.
pub(crate) fn from_agent(message: &[u8]) -> FromAgent {
    match serde_json::from_slice::<Value>(message) {
        Ok(Value::Array(messages)) => {
            let calls: Vec<Call> = messages.iter().filter_map(call).collect();
            if calls.is_empty() {
                FromAgent::Other
            } else {
                FromAgent::Calls(calls)
            }
        }
        Ok(message @ Value::Object(_)) => match message.get("method").and_then(Value::as_str) {
            Some("initialize") => FromAgent::Hello(name_in(message.pointer("/params/clientInfo"))),
            Some("notifications/cancelled") => match message.pointer("/params/requestId") {
                Some(id) => FromAgent::Cancelled(id.clone()),
                None => FromAgent::Other,
            },
            Some("tools/list") if message.pointer("/params/cursor").is_none() => {
                let id = message.get("id").cloned();
                id.map_or(FromAgent::Other, FromAgent::ListsTools)
            }
            Some(method @ ("tasks/get" | "tasks/result" | "tasks/cancel")) => {
                asks_for_task(method, &message).unwrap_or(FromAgent::Other)
            }
            Some("tools/call") => {
                call(&message).map_or(FromAgent::Strange, |call| FromAgent::Calls(vec![call]))
            }
            Some(_) => FromAgent::Other,
            None if message.get("result").or(message.get("error")).is_some() => FromAgent::Other,
            None => FromAgent::Strange,
        },
        _ => FromAgent::Strange,
    }
}

/// Whether a message begins a session.
pub(crate) fn is_hello(message: &[u8]) -> bool {
    matches!(from_agent(message), FromAgent::Hello(_))
}

/// Who the agent says it is in a message of a protocol without sessions.
pub(crate) fn client_of(message: &[u8]) -> Option<String> {
    let message: Value = serde_json::from_slice(message).ok()?;
    let meta = message.pointer("/params/_meta")?;
    CLIENT_IN_META.iter().find_map(|key| name_in(meta.get(key)))
}

fn name_in(client: Option<&Value>) -> Option<String> {
    client?
        .get("name")?
        .as_str()
        .filter(|name| !name.is_empty())
        .map(str::to_owned)
}

/// A call of a tool as MCP has it. With arguments that are no object it is none: a server refuses
/// it before any tool is called.
fn call(message: &Value) -> Option<Call> {
    if message.get("method")? != "tools/call" {
        return None;
    }
    let id = message.get("id").filter(|id| !id.is_null())?.clone();
    let params = message.get("params")?;
    let name = params.get("name")?.as_str()?;
    let arguments = match params.get("arguments") {
        None | Some(Value::Null) => json!({}),
        Some(arguments @ Value::Object(_)) => arguments.clone(),
        Some(_) => return None,
    };
    let has_input = ["inputResponses", "requestState"]
        .iter()
        .any(|key| params.get(key).is_some());
    Some(Call {
        id,
        call: ToolCall::new(name, arguments),
        has_input,
    })
}

fn asks_for_task(method: &str, message: &Value) -> Option<FromAgent> {
    let method = match method {
        "tasks/result" => TaskMethod::Result,
        _ => TaskMethod::Status,
    };
    Some(FromAgent::AsksForTask {
        id: message.get("id").filter(|id| !id.is_null())?.clone(),
        method,
        task_id: message.pointer("/params/taskId")?.as_str()?.to_owned(),
    })
}

/// The content of a result.
#[derive(Clone, PartialEq, Debug, Default)]
pub(crate) struct ToolResultContent {
    /// Texts of the result's content in their order, or the error's message.
    pub texts: Vec<String>,
    /// In Base64, with their types.
    pub images: Vec<(String, String)>,
    /// The result's `structuredContent`; `None` if it is absent or null.
    pub structured: Option<Value>,
    /// Whether it is an error, of the tool or of the protocol.
    pub failed: bool,
    /// The answer: a JSON object with its result or its error. `None` if none came.
    pub answer: Option<String>,
    /// How many secrets were replaced in all of this.
    pub redacted: Redactions,
}

impl ToolResultContent {
    /// An answer that never came, and why.
    pub(crate) fn none(why: &str) -> Self {
        Self {
            texts: vec![why.to_owned()],
            failed: true,
            ..Self::default()
        }
    }

    /// The task that the answer tells, if it begins an episode: the first text as JSON, in the
    /// words of the published server, or what Reel's own server says in profile `paper`.
    pub(crate) fn payload(&self) -> Option<Map<String, Value>> {
        if let Some(episode) = self
            .structured
            .as_ref()
            .and_then(|structured| structured.get("episode"))
        {
            let keys = [("task_id", "task_id"), ("instruction", "task_description")];
            return keys
                .iter()
                .map(|(said, key)| Some(((*key).to_owned(), episode.get(said)?.clone())))
                .collect();
        }
        let text = self.texts.first().filter(|text| text.starts_with('{'))?;
        let payload: Map<String, Value> = serde_json::from_str(text).ok()?;
        (payload.contains_key("task_id") && payload.contains_key("task_description"))
            .then_some(payload)
    }
}

/// A message of a server, as far as it is read.
#[derive(Deserialize)]
pub(crate) struct ServerMessage {
    #[serde(default)]
    id: Option<Value>,
    #[serde(default)]
    method: Option<Value>,
    #[serde(default)]
    params: Option<Value>,
    #[serde(default)]
    result: Option<Value>,
    #[serde(default)]
    error: Option<Value>,
}

/// The result of a request, or its error, as it came.
#[derive(Clone, PartialEq, Debug)]
pub(crate) enum Answer {
    Result(Value),
    Error(Value),
}

/// Reads the messages of a server; more than one in a batch.
pub(crate) fn from_server(message: &[u8]) -> Option<Vec<ServerMessage>> {
    let first = message.iter().find(|byte| !byte.is_ascii_whitespace())?;
    if *first == b'[' {
        return serde_json::from_slice(message).ok();
    }
    Some(vec![serde_json::from_slice(message).ok()?])
}

/// The answer to a request among what the server sends, if it is there.
pub(crate) fn answer_to(id: &Value, message: &[u8]) -> Option<Answer> {
    from_server(message)?
        .into_iter()
        .find_map(|message| message.answer_to(id))
}

impl ServerMessage {
    pub(crate) fn is_answer_to(&self, id: &Value) -> bool {
        self.method.is_none() && self.id.as_ref() == Some(id)
    }

    /// The answer to a request, if this is it.
    pub(crate) fn answer_to(self, id: &Value) -> Option<Answer> {
        if !self.is_answer_to(id) {
            return None;
        }
        match (self.result, self.error) {
            (_, Some(error)) => Some(Answer::Error(error)),
            (result, None) => result.map(Answer::Result),
        }
    }

    /// What a notification tells of a task.
    pub(crate) fn task_notification(&self, task_id: &str) -> Option<Value> {
        let told = self.params.as_ref()?;
        let method = self.method.as_ref()?.as_str()?;
        (method.starts_with("notifications/tasks") && told.get("taskId")? == task_id)
            .then(|| told.clone())
    }
}

/// How many integers of a message are none in its value, which was read from it: 64 bits do not
/// hold them.
pub(crate) fn rounded_integers(value: &Value, message: &[u8]) -> u64 {
    fn is_rounded(value: &Value) -> bool {
        match value {
            Value::Number(number) => number
                .as_f64()
                .is_some_and(|size| number.is_f64() && size.abs() >= i64::MAX as f64),
            Value::Array(items) => items.iter().any(is_rounded),
            Value::Object(fields) => fields.values().any(is_rounded),
            Value::Null | Value::Bool(_) | Value::String(_) => false,
        }
    }
    // Few messages have such numbers: the others are not looked at once more.
    if is_rounded(value) {
        long_integers(message).len() as u64
    } else {
        0
    }
}

/// What is told of a task that is over.
#[derive(Clone, PartialEq, Debug)]
pub(crate) enum TaskStatus {
    /// With its result or its error.
    Final(Answer),
    /// How it ended; its result is not in the message.
    Ended(String),
}

/// What the status of a task says; `None` while it goes on.
pub(crate) fn task_status(mut told: Value) -> Option<TaskStatus> {
    let status = told.get("status")?.as_str()?.to_owned();
    let mut payload = |name: &str| told.get_mut(name).map(Value::take);
    let answer = match status.as_str() {
        "completed" => payload("result").map(Answer::Result),
        "failed" => payload("error").map(Answer::Error),
        "cancelled" => None,
        _ => return None,
    };
    let why = told.get("statusMessage").and_then(Value::as_str);
    let why = why.map_or(String::new(), |why| format!(" ({why})"));
    Some(answer.map_or(
        TaskStatus::Ended(format!("is {status}{why}")),
        TaskStatus::Final,
    ))
}

impl Answer {
    /// The id of the task that will have the result, if this is no result.
    pub(crate) fn task(&self) -> Option<String> {
        let Answer::Result(result) = self else {
            return None;
        };
        let told = match result.get("resultType").and_then(Value::as_str) {
            Some("task") => result,
            // Protocol 2025-11-25: a result with a task in it, and without content.
            None if result.get("content").is_none() => result.get("task")?,
            _ => return None,
        };
        told.get("taskId")?.as_str().map(str::to_owned)
    }

    /// Whether the server wants to know something before it gives a result.
    pub(crate) fn asks_for_input(&self) -> bool {
        matches!(self, Answer::Result(result) if result.get("resultType").is_some_and(|kind| kind == "input_required"))
    }

    /// The result, if it is no error.
    pub(crate) fn result(self) -> Option<Value> {
        match self {
            Answer::Result(result) => Some(result),
            Answer::Error(_) => None,
        }
    }

    /// As JSON, with labels in the place of secrets.
    pub(crate) fn json(mut self, redactor: &mut Redactor, scope: Scope) -> String {
        self.redact(redactor, scope);
        self.to_json()
    }

    /// What it holds, with labels in the place of secrets.
    pub(crate) fn content(mut self, redactor: &mut Redactor) -> ToolResultContent {
        self.redact(redactor, Scope::Data);
        let redacted = redactor.take_redactions();
        let answer = Some(self.to_json());
        let content = match self {
            Answer::Result(result) => content(result),
            Answer::Error(error) => {
                let text = error
                    .get("message")
                    .and_then(Value::as_str)
                    .map_or_else(|| error.to_string(), str::to_owned);
                ToolResultContent::none(&text)
            }
        };
        ToolResultContent {
            answer,
            redacted,
            ..content
        }
    }

    fn redact(&mut self, redactor: &mut Redactor, scope: Scope) {
        match self {
            Answer::Result(result) => redactor.value("result", result, scope),
            Answer::Error(error) => redactor.value("error", error, scope),
        }
    }

    fn to_json(&self) -> String {
        match self {
            Answer::Result(result) => format!("{{\"result\":{result}}}"),
            Answer::Error(error) => format!("{{\"error\":{error}}}"),
        }
    }
}

fn content(mut result: Value) -> ToolResultContent {
    let mut answer = ToolResultContent {
        failed: result
            .get("isError")
            .and_then(Value::as_bool)
            .unwrap_or(false),
        structured: result
            .get("structuredContent")
            .filter(|value| !value.is_null())
            .cloned(),
        ..ToolResultContent::default()
    };
    let text = |item: &mut Value, key: &str| match item.get_mut(key).map(Value::take) {
        Some(Value::String(text)) => Some(text),
        _ => None,
    };
    for item in result
        .get_mut("content")
        .and_then(Value::as_array_mut)
        .into_iter()
        .flatten()
    {
        match item.get("type").and_then(Value::as_str) {
            Some("text") => answer.texts.extend(text(item, "text")),
            Some("image") => {
                let kind = text(item, "mimeType").unwrap_or_default();
                answer
                    .images
                    .extend(text(item, "data").map(|data| (kind, data)));
            }
            _ => {}
        }
    }
    answer
}

/// An error in the place of an answer; not longer than `most`, none where that is
/// too short for any.
pub(crate) fn refusal(id: &Value, why: &str, most: Option<usize>) -> Option<String> {
    let error = |why: &str| {
        json!({"jsonrpc": "2.0", "id": id, "error": {"code": INTERNAL_ERROR, "message": why}})
            .to_string()
    };
    let texts = [why, "reel record: not recorded, see its log"];
    texts
        .into_iter()
        .map(error)
        .find(|text| most.is_none_or(|most| text.len() <= most))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use reel_redact::Rules;

    use super::*;

    fn read(id: &Value, message: &[u8]) -> Option<ToolResultContent> {
        let mut redactor = Redactor::new(Rules::none().into());
        answer_to(id, message).map(|answer| answer.content(&mut redactor))
    }

    proptest! {
        #[test]
        fn nothing_panics(text in "([{}\\[\\]:,\"0-9a-z]|\"id\":1|\"method\":\"tools/call\"|\"params\"|\"result\"|\"content\"){0,40}") {
            let _ = (from_agent(text.as_bytes()), client_of(text.as_bytes()), read(&json!(1), text.as_bytes()));
        }
    }

    #[test]
    fn messages_of_agents() {
        let read = |text: &str| from_agent(text.as_bytes());
        let FromAgent::Calls(calls) = read(
            r#"{"jsonrpc":"2.0","id":7,"method":"tools/call","params":{"name":"pick","arguments":{"marker_id":1}}}"#,
        ) else {
            panic!("no call");
        };
        assert_eq!(
            (calls[0].id.clone(), calls[0].call.to_string()),
            (json!(7), "pick(marker_id=1)".to_owned())
        );
        assert_eq!(
            read(r#"{"id":1,"method":"initialize","params":{"clientInfo":{"name":"gym"}}}"#),
            FromAgent::Hello(Some("gym".into()))
        );
        assert_eq!(
            read(r#"{"method":"notifications/cancelled","params":{"requestId":"a"}}"#),
            FromAgent::Cancelled(json!("a"))
        );
        assert_eq!(
            read(r#"{"id":1,"method":"tools/list"}"#),
            FromAgent::ListsTools(json!(1))
        );
        assert_eq!(read(r#"{"id":1,"result":{}}"#), FromAgent::Other);
        assert_eq!(
            read(r#"{"id":1,"method":"tools/call"}"#),
            FromAgent::Strange
        );
        let with = |arguments: &str| {
            read(&format!(
                r#"{{"id":1,"method":"tools/call","params":{{"name":"pick","arguments":{arguments}}}}}"#
            ))
        };
        assert!(matches!(with("null"), FromAgent::Calls(_)));
        assert_eq!(
            [with("[7]"), with("7"), with(r#""7""#)],
            [FromAgent::Strange, FromAgent::Strange, FromAgent::Strange]
        );
        assert_eq!(read(r#"{"a":1}"#), FromAgent::Strange);
        assert_eq!(read("\u{1}\u{2}"), FromAgent::Strange);
        let batch = r#"[{"id":1,"method":"tools/call","params":{"name":"a"}},{"id":2,"method":"tools/call","params":{"name":"b"}}]"#;
        assert!(matches!(read(batch), FromAgent::Calls(calls) if calls.len() == 2));
        let newest = br#"{"id":1,"method":"tools/call","params":{"name":"a","_meta":{"io.modelcontextprotocol/clientInfo":{"name":"n"}}}}"#;
        assert_eq!(client_of(newest), Some("n".into()));
    }

    #[test]
    fn answers() {
        let result = br#"{"jsonrpc":"2.0","id":7,"result":{"content":[{"type":"text","text":"a"},{"type":"image","data":"QQ==","mimeType":"image/png"}],"isError":false}}"#;
        let answer = read(&json!(7), result).unwrap();
        assert_eq!(
            (answer.texts, answer.images.len(), answer.failed),
            (vec!["a".to_owned()], 1, false)
        );
        assert_eq!(read(&json!(8), result), None);
        assert_eq!(
            read(&json!(7), br#"{"id":7,"method":"elicitation/create"}"#),
            None
        );
        let error = read(
            &json!("x"),
            br#"{"id":"x","error":{"code":1,"message":"no"}}"#,
        )
        .unwrap();
        assert_eq!((error.texts, error.failed), (vec!["no".to_owned()], true));
        let batch = br#" [{"id":1,"result":{"content":[]}},{"id":7,"result":{"isError":true,"content":[]}}]"#;
        assert!(read(&json!(7), batch).unwrap().failed);
    }

    #[test]
    fn tasks() {
        let read = |json: Value| from_agent(json.to_string().as_bytes());
        let asks = json!({"id": 3, "method": "tasks/result", "params": {"taskId": "t"}});
        let (id, method, task_id) = (json!(3), TaskMethod::Result, "t".to_owned());
        assert_eq!(
            read(asks),
            FromAgent::AsksForTask {
                id,
                method,
                task_id
            }
        );
        assert_eq!(
            read(json!({"method": "tasks/get", "params": {}})),
            FromAgent::Other
        );
        let task = |result: Value| Answer::Result(result).task();
        assert_eq!(
            task(json!({"task": {"taskId": "t", "status": "working"}})),
            Some("t".into())
        );
        assert_eq!(
            task(json!({"resultType": "task", "taskId": "t"})),
            Some("t".into())
        );
        assert_eq!(task(json!({"content": [], "task": {"taskId": "t"}})), None);
        assert_eq!(task_status(json!({"status": "working"})), None);
        assert_eq!(
            task_status(json!({"status": "failed", "statusMessage": "no way"})),
            Some(TaskStatus::Ended("is failed (no way)".into()))
        );
        assert_eq!(
            task_status(json!({"status": "completed", "result": {"content": []}})),
            Some(TaskStatus::Final(Answer::Result(json!({"content": []}))))
        );
    }

    #[test]
    fn what_begins_an_episode() {
        let text = |text: &str| ToolResultContent {
            texts: vec![text.to_owned()],
            ..ToolResultContent::default()
        };
        assert!(
            text(r#"{"task_id": "a", "task_description": "b", "scene_id": "c"}"#)
                .payload()
                .is_some_and(|it| it.len() == 3)
        );
        assert_eq!(text(r#"{"task_id": "a"}"#).payload(), None);
        assert_eq!(text("All evaluation episodes completed.").payload(), None);
        let structured = Some(
            json!({"ok": true, "episode": {"task_id": "a", "instruction": "b", "receptacles": []}}),
        );
        let payload = ToolResultContent {
            structured,
            ..text("Task: b")
        }
        .payload();
        assert_eq!(
            payload.map(Value::Object),
            Some(json!({"task_id": "a", "task_description": "b"}))
        );
    }

    #[test]
    fn a_refusal_is_as_short_as_it_must_be() {
        let why = "a long story ".repeat(20);
        assert!(refusal(&json!(1), &why, None).unwrap().contains(&why));
        let short = refusal(&json!(1), &why, Some(120)).unwrap();
        assert!(short.len() <= 120 && short.contains("not recorded"));
        assert_eq!(refusal(&json!(1), &why, Some(20)), None);
    }

    #[test]
    fn integers_that_no_64_bits_hold_are_counted() {
        let count = |text: &str| {
            let value: Value = serde_json::from_str(text).unwrap();
            rounded_integers(&value, text.as_bytes())
        };
        let [fitting, long] = [
            "[9223372036854775807, -9223372036854775808, 18446744073709551615, 1e30]",
            r#"{"a": [18446744073709551616], "b": {"c": -12345678901234567890123}, "d": "99999999999999999999"}"#,
        ];
        assert_eq!([fitting, long].map(count), [0, 2]);
    }
}
