//! What a server says that has tools and nothing else: which revisions of the protocol it speaks,
//! and why it refuses the rest. rmcp answers empty lists to what was never declared, "no such
//! method" where only the params do not read, and texts to bodies that are no message.

use axum::{
    Json,
    body::{self, Body},
    extract::{Request, State},
    http::{Method, StatusCode, header},
    middleware::Next,
    response::{IntoResponse as _, Response},
};
use rmcp::{
    ErrorData,
    model::{
        CallToolRequestParams, ClientJsonRpcMessage, ClientRequest, CustomRequest, ErrorCode,
        InitializeRequestParams, JsonRpcError, JsonRpcMessage, ProtocolVersion, RequestId,
    },
};
use serde::Deserialize as _;
use serde_json::Value;

/// The revisions of the protocol that are spoken, the oldest first. That of 2025-03-26 is left out:
/// its servers have to take batches of messages, which no other revision knows.
pub const VERSIONS: &[ProtocolVersion] = &[
    ProtocolVersion::V_2024_11_05,
    ProtocolVersion::V_2025_06_18,
    ProtocolVersion::V_2025_11_25,
    ProtocolVersion::V_2026_07_28,
];

/// Those of [`VERSIONS`] that have sessions.
pub const WITH_SESSIONS: &[ProtocolVersion] = VERSIONS.split_at(VERSIONS.len() - 1).0;

/// The methods of a server that has tools and nothing else, for its `impl ServerHandler`.
#[macro_export]
macro_rules! tools_only {
    () => {
        async fn initialize(
            &self,
            request: rmcp::model::InitializeRequestParams,
            context: rmcp::service::RequestContext<rmcp::RoleServer>,
        ) -> Result<rmcp::model::InitializeResult, rmcp::ErrorData> {
            let mut result = self.negotiate_initialize(&request)?;
            let spoken = self.supported_protocol_versions();
            if let Some(version) = $crate::agreed_version(&request.protocol_version, &spoken) {
                result.protocol_version = version;
            }
            context.peer.set_peer_info(request);
            Ok(result)
        }

        async fn complete(
            &self,
            _: rmcp::model::CompleteRequestParams,
            _: rmcp::service::RequestContext<rmcp::RoleServer>,
        ) -> Result<rmcp::model::CompleteResult, rmcp::ErrorData> {
            type Asked = rmcp::model::CompleteRequestMethod;
            Err(rmcp::ErrorData::method_not_found::<Asked>())
        }

        async fn list_prompts(
            &self,
            _: Option<rmcp::model::PaginatedRequestParams>,
            _: rmcp::service::RequestContext<rmcp::RoleServer>,
        ) -> Result<rmcp::model::ListPromptsResult, rmcp::ErrorData> {
            type Asked = rmcp::model::ListPromptsRequestMethod;
            Err(rmcp::ErrorData::method_not_found::<Asked>())
        }

        async fn list_resources(
            &self,
            _: Option<rmcp::model::PaginatedRequestParams>,
            _: rmcp::service::RequestContext<rmcp::RoleServer>,
        ) -> Result<rmcp::model::ListResourcesResult, rmcp::ErrorData> {
            type Asked = rmcp::model::ListResourcesRequestMethod;
            Err(rmcp::ErrorData::method_not_found::<Asked>())
        }

        async fn list_resource_templates(
            &self,
            _: Option<rmcp::model::PaginatedRequestParams>,
            _: rmcp::service::RequestContext<rmcp::RoleServer>,
        ) -> Result<rmcp::model::ListResourceTemplatesResult, rmcp::ErrorData> {
            type Asked = rmcp::model::ListResourceTemplatesRequestMethod;
            Err(rmcp::ErrorData::method_not_found::<Asked>())
        }

        async fn on_custom_request(
            &self,
            request: rmcp::model::CustomRequest,
            context: rmcp::service::RequestContext<rmcp::RoleServer>,
        ) -> Result<rmcp::model::CustomResult, rmcp::ErrorData> {
            let version = context.protocol_version();
            let version = version.unwrap_or(rmcp::model::ProtocolVersion::V_2025_11_25);
            Err($crate::refusal(&request, &version))
        }
    };
}

/// The revision that `initialize` is answered with: the one that was asked for, else the newest
/// before it, because a client knows those before its own; else the newest that has a handshake.
#[doc(hidden)]
pub fn agreed_version(
    asked: &ProtocolVersion,
    spoken: &[ProtocolVersion],
) -> Option<ProtocolVersion> {
    let with_handshake = || spoken.iter().filter(|version| version.has_initialize());
    with_handshake()
        .rfind(|version| version.as_str() <= asked.as_str())
        .or_else(|| with_handshake().next_back())
        .cloned()
}

/// Why a request of this revision is refused that rmcp could not read as one of a method that it
/// knows: its params, or its method.
#[doc(hidden)]
pub fn refusal(request: &CustomRequest, version: &ProtocolVersion) -> ErrorData {
    let read = match request.method.as_str() {
        "tools/call" => request
            .params_as::<CallToolRequestParams>()
            .map(|it| it.is_some()),
        "initialize" if version.has_initialize() => request
            .params_as::<InitializeRequestParams>()
            .map(|it| it.is_some()),
        "ping" | "server/discover" | "tools/list" => Ok(true),
        other => return ErrorData::new(ErrorCode::METHOD_NOT_FOUND, other.to_owned(), None),
    };
    let why = match read {
        Ok(true) => "they are none of this method".to_owned(),
        Ok(false) => "they are missing".to_owned(),
        Err(error) => error.to_string(),
    };
    ErrorData::invalid_params(format!("params of {}: {why}", request.method), None)
}

/// Answers with an error of JSON-RPC what rmcp answers with a text: a body that is no message, and
/// an `initialize` whose params do not read.
pub(crate) async fn explain(
    State(max_body): State<usize>,
    request: Request,
    next: Next,
) -> Response {
    if request.method() != Method::POST {
        return next.run(request).await;
    }
    let (head, body) = request.into_parts();
    let Ok(body) = body::to_bytes(body, max_body).await else {
        let text = format!("the body breaks off, or has more than {max_body} bytes");
        return (StatusCode::PAYLOAD_TOO_LARGE, text).into_response();
    };
    let request = Request::from_parts(head, Body::from(body.clone()));
    let response = next.run(request).await;
    let is_refused =
        [StatusCode::BAD_REQUEST, StatusCode::UNSUPPORTED_MEDIA_TYPE].contains(&response.status());
    // What rmcp says in JSON-RPC has a content type, and its texts have none.
    if !is_refused || response.headers().contains_key(header::CONTENT_TYPE) {
        return response;
    }
    match unread(&body) {
        Some(error) => (StatusCode::BAD_REQUEST, Json(error)).into_response(),
        None => response,
    }
}

/// Why a body does not read as a message of the protocol; none where it does.
fn unread(body: &[u8]) -> Option<JsonRpcError> {
    let value: Value = match serde_json::from_slice(body) {
        Ok(value) => value,
        Err(error) => {
            let error = ErrorData::parse_error(format!("not JSON: {error}"), None);
            return Some(JsonRpcError::new(None, error));
        }
    };
    let id = || RequestId::deserialize(value.get("id")?).ok();
    match ClientJsonRpcMessage::deserialize(&value) {
        Ok(JsonRpcMessage::Request(request)) => match request.request {
            ClientRequest::CustomRequest(custom) if custom.method == "initialize" => {
                let error = refusal(&custom, &ProtocolVersion::V_2025_11_25);
                Some(JsonRpcError::new(Some(request.id), error))
            }
            _ => None,
        },
        Ok(_) => None,
        Err(_) if value.is_array() => {
            let text = "batches are not taken: post each message in a request of its own";
            Some(JsonRpcError::new(
                None,
                ErrorData::invalid_request(text, None),
            ))
        }
        Err(_) if value.get("method").is_some_and(Value::is_string) && id().is_some() => {
            let text = "params of a request are an object";
            Some(JsonRpcError::new(
                id(),
                ErrorData::invalid_params(text, None),
            ))
        }
        Err(_) => {
            let text = "not a message of JSON-RPC 2.0";
            Some(JsonRpcError::new(
                id(),
                ErrorData::invalid_request(text, None),
            ))
        }
    }
}
