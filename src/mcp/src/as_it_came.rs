//! Results of other servers that are passed on as they came. rmcp has types for what the protocol
//! defines, and drops or orders what else a server said: such a result travels under a key of its
//! own, and takes its place when it goes out.

use std::sync::Arc;

use rmcp::{
    model::{
        CallToolResult, CustomResult, JsonRpcMessage, ListToolsResult, MetaObject,
        ServerJsonRpcMessage, ServerResult,
    },
    transport::streamable_http_server::session::ServerSseMessage,
};
use serde_json::Value;

/// The key of `_meta` under which a result travels.
const AS_IT_CAME: &str = "reel/as-it-came";

/// The result of a call, to be passed on as it came.
pub fn call_as_it_came(result: Value) -> CallToolResult {
    let mut travelling = CallToolResult::success(Vec::new());
    travelling.meta = Some(under_key(result));
    travelling
}

/// A list of tools, to be passed on as it came.
pub fn tools_as_they_came(result: Value) -> ListToolsResult {
    let mut travelling = ListToolsResult::with_all_items(Vec::new());
    travelling.meta = Some(under_key(result));
    travelling
}

/// A result as it goes out.
pub fn outgoing_result(result: ServerResult) -> ServerResult {
    match travelling(&result).cloned() {
        Some(result) => ServerResult::CustomResult(CustomResult::new(result)),
        None => result,
    }
}

/// The result that travels under the key, if one does.
fn travelling(result: &ServerResult) -> Option<&Value> {
    let meta = match result {
        ServerResult::CallToolResult(result) => &result.meta,
        ServerResult::ListToolsResult(result) => &result.meta,
        _ => return None,
    };
    meta.as_ref()?.get(AS_IT_CAME)
}

/// An event as it goes out; none but results that travel are changed.
pub(crate) fn outgoing_event(mut event: ServerSseMessage) -> ServerSseMessage {
    if let Some(message) = &event.message
        && let JsonRpcMessage::Response(response) = &**message
        && travelling(&response.result).is_some()
    {
        event.message = Some(Arc::new(outgoing((**message).clone())));
    }
    event
}

/// A message as it goes out.
pub(crate) fn outgoing(message: ServerJsonRpcMessage) -> ServerJsonRpcMessage {
    match message {
        JsonRpcMessage::Response(mut response) => {
            response.result = outgoing_result(response.result);
            JsonRpcMessage::Response(response)
        }
        other => other,
    }
}

fn under_key(result: Value) -> MetaObject {
    let mut meta = MetaObject::new();
    meta.insert(AS_IT_CAME.to_owned(), result);
    meta
}
