//! JSON-RPC inside the WebSocket: the tools of MCP without rewards, as the contract has it for
//! agents that are evaluated.

use reel_world::ToolCall;
use serde_json::{Map, Value, json};

use super::{environment::Environment, message, observation};

/// Codes of JSON-RPC 2.0.
const INVALID_REQUEST: i32 = -32_600;
const METHOD_NOT_FOUND: i32 = -32_601;
const INVALID_PARAMS: i32 = -32_602;
const SERVER_ERROR: i32 = -32_000;

/// Answers a request of JSON-RPC.
pub(super) async fn answer(environment: &Environment, request: Value) -> Value {
    let id = request.get("id").cloned().unwrap_or_default();
    let mut answer = json!({"jsonrpc": "2.0", "id": id});
    match result(environment, &request).await {
        Ok(result) => answer["result"] = result,
        Err((code, message)) => {
            answer["error"] = json!({"code": code, "message": message, "data": null});
        }
    }
    answer
}

async fn result(environment: &Environment, request: &Value) -> Result<Value, (i32, String)> {
    let is_id = |id: &Value| id.is_null() || id.is_string() || id.is_i64() || id.is_u64();
    let method = request["method"].as_str();
    let known_id = request.get("id").is_none_or(is_id);
    let Some(method) = method.filter(|_| known_id && request["jsonrpc"] == "2.0") else {
        return Err((INVALID_REQUEST, "Invalid request".to_owned()));
    };
    let none = Map::new();
    let params = match request.get("params") {
        None => &none,
        Some(Value::Object(params)) => params,
        Some(_) => return Err((INVALID_PARAMS, "Params must be an object".to_owned())),
    };
    match method {
        "tools/list" => {
            let of_mcp = |mut tool: Value| {
                tool["inputSchema"] = tool["input_schema"].take();
                if let Some(fields) = tool.as_object_mut() {
                    fields.remove("input_schema");
                }
                tool
            };
            let tools = observation::tools(environment.profile());
            let tools: Vec<Value> = tools.into_iter().map(of_mcp).collect();
            Ok(json!({"tools": tools}))
        }
        "tools/call" => call(environment, params).await,
        _ => {
            let method: String = method.chars().take(80).collect();
            Err((METHOD_NOT_FOUND, format!("Method not found: {method}")))
        }
    }
}

async fn call(
    environment: &Environment,
    params: &Map<String, Value>,
) -> Result<Value, (i32, String)> {
    let Some(name) = params.get("name").and_then(Value::as_str) else {
        return Err((INVALID_PARAMS, "Missing 'name' in params".to_owned()));
    };
    let arguments = params.get("arguments").cloned();
    let arguments = arguments.unwrap_or_else(|| Map::new().into());
    let action = json!({"name": name, "arguments": arguments});
    let call: ToolCall = match message::action(action, "params") {
        Ok(message::Action::Call { call, .. }) => call,
        Ok(message::Action::ListTools) => return Err((INVALID_PARAMS, "no call".to_owned())),
        Err(refusal) => return Err((INVALID_PARAMS, refusal.message())),
    };
    match environment.call(call, None).await {
        Ok(outcome) => Ok(observation::result(&outcome.result, true)),
        Err(refusal) => Err((SERVER_ERROR, refusal.message())),
    }
}
