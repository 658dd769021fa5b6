//! What the published conformance suite of the Model Context Protocol wants of a server
//! (`tests/conformance.sh`): tools, resources and prompts under the names of its scenarios, over
//! the transport and behind the guard of the real server.
//!
//! `conformance PORT` listens on 127.0.0.1 (0: any free port) and prints where. It serves nobody
//! but the suite: no world, no tokens, no limits.

use std::{
    collections::BTreeSet,
    future,
    io::{self, Write as _},
    sync::{Arc, Mutex},
    time::Duration,
};

use axum::{
    Router,
    body::Body,
    extract::{Request, State},
    http::request::Parts,
    middleware::{self, Next},
    response::Response,
};
use futures_util::{StreamExt as _, stream};
use reel_mcp::Guard;
#[expect(
    deprecated,
    reason = "the suite is of versions of the protocol that have logging and sampling"
)]
use rmcp::model::{
    CreateMessageRequestParams, LoggingLevel, LoggingMessageNotificationParam, SamplingMessage,
    SetLevelRequestParams,
};
use rmcp::{
    ErrorData, RoleServer, ServerHandler,
    model::{
        CallToolRequestParams, CallToolResponse, CallToolResult, ContentBlock, ElicitRequestParams,
        ElicitationSchema, GetPromptRequestParams, GetPromptResponse, GetPromptResult,
        Implementation, JsonObject, ListPromptsResult, ListResourceTemplatesResult,
        ListResourcesResult, ListToolsResult, PaginatedRequestParams, ProgressNotificationParam,
        Prompt, PromptArgument, PromptMessage, ReadResourceRequestParams, ReadResourceResponse,
        ReadResourceResult, Resource, ResourceContents, ResourceTemplate, Role, ServerCapabilities,
        ServerConfig, SubscribeRequestParams, Tool, UnsubscribeRequestParams,
    },
    service::{ElicitationMode, RequestContext},
};
use serde_json::{Value, json};
use tokio::{net::TcpListener, sync::Notify, time};
use tokio_util::sync::CancellationToken;

/// PNG file of one red pixel, in Base64.
const PNG: &str =
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAIAAACQd1PeAAAADElEQVR4nGP4z8AAAAMBAQDJ/pLvAAAAAElFTkSuQmCC";
/// A millisecond of silence.
const WAV: &str = "UklGRiwAAABXQVZFZm10IBAAAAABAAEAQB8AAEAfAAABAAgAZGF0YQgAAACAgICAgICAgA==";

const PAUSE: Duration = Duration::from_millis(50);
const SESSIONS: usize = 1_000;
const KEEP_ALIVE: Duration = Duration::from_secs(300);
const MAX_BODY: usize = 4 << 20;

#[tokio::main]
async fn main() -> io::Result<()> {
    let port = std::env::args()
        .nth(1)
        .map_or(Ok(0), |port| port.parse::<u16>());
    let Ok(port) = port else {
        eprintln!("usage: conformance [PORT]");
        std::process::exit(2);
    };
    let returned = Arc::new(Notify::new());
    let factory = {
        let returned = returned.clone();
        move || Fixture {
            returned: returned.clone(),
            ..Fixture::default()
        }
    };
    let service = reel_mcp::streamable_http(
        factory,
        (SESSIONS, SESSIONS),
        KEEP_ALIVE,
        MAX_BODY,
        CancellationToken::new(),
    );
    let router = Router::new()
        .route_service("/mcp", service)
        .layer(middleware::from_fn_with_state(returned, breakable))
        .layer(middleware::from_fn_with_state(
            Arc::new(Guard::default()),
            Guard::middleware,
        ));
    let listener = TcpListener::bind(("127.0.0.1", port)).await?;
    println!("listening on http://{}/mcp", listener.local_addr()?);
    io::stdout().flush()?;
    axum::serve(listener, router).await
}

/// Gives every request a token that breaks the stream of its answer off, as a network would, but
/// not before the first event; and tells when a client comes back for the rest of such a stream.
async fn breakable(
    State(returned): State<Arc<Notify>>,
    mut request: Request,
    next: Next,
) -> Response {
    let broken = CancellationToken::new();
    request.extensions_mut().insert(broken.clone());
    let resumes = request.headers().contains_key("last-event-id");
    let (head, body) = next.run(request).await.into_parts();
    if resumes {
        returned.notify_one();
    }
    let mut chunks = body.into_data_stream();
    let first = stream::iter(chunks.next().await);
    Response::from_parts(
        head,
        Body::from_stream(first.chain(chunks.take_until(broken.cancelled_owned()))),
    )
}

/// State of one MCP session of the conformance server.
#[derive(Default)]
#[expect(deprecated, reason = "logging")]
struct Fixture {
    /// The least that the client wants to be told; without it, everything.
    level: Mutex<Option<LoggingLevel>>,
    watched: Mutex<BTreeSet<String>>,
    returned: Arc<Notify>,
}

type Context = RequestContext<RoleServer>;

impl Fixture {
    async fn call(
        &self,
        name: &str,
        arguments: &JsonObject,
        context: &Context,
    ) -> Result<Vec<ContentBlock>, String> {
        let argument = |name: &str| {
            arguments
                .get(name)
                .and_then(Value::as_str)
                .ok_or(format!("argument '{name}' is missing"))
        };
        match name {
            "test_simple_text" => Ok(vec![ContentBlock::text(
                "This is a simple text response for testing.",
            )]),
            "test_image_content" => Ok(vec![ContentBlock::image(PNG, "image/png")]),
            "test_audio_content" => Ok(vec![ContentBlock::audio(WAV, "audio/wav")]),
            "test_embedded_resource" => {
                let text = "This is an embedded resource content.";
                Ok(vec![resource(
                    "test://embedded-resource",
                    "text/plain",
                    text,
                )])
            }
            "test_multiple_content_types" => Ok(vec![
                ContentBlock::text("Multiple content types test:"),
                ContentBlock::image(PNG, "image/png"),
                resource(
                    "test://mixed-content-resource",
                    "application/json",
                    r#"{"test":"data","value":123}"#,
                ),
            ]),
            "test_error_handling" => {
                Err("This tool intentionally returns an error for testing".to_owned())
            }
            "test_tool_with_logging" => self.log(context).await,
            "test_tool_with_progress" => progress(context).await,
            "test_sampling" => sample(argument("prompt")?, context).await,
            "test_elicitation" => {
                elicit("User response", argument("message")?, user_form(), context).await
            }
            "test_elicitation_sep1034_defaults" => {
                elicit(
                    "Elicitation completed",
                    "Your profile",
                    defaults_form(),
                    context,
                )
                .await
            }
            "test_elicitation_sep1330_enums" => {
                elicit(
                    "Elicitation completed",
                    "Your choices",
                    enums_form(),
                    context,
                )
                .await
            }
            "test_reconnection" => self.reconnect(context).await,
            "json_schema_2020_12_tool" => Ok(vec![ContentBlock::text(
                Value::Object(arguments.clone()).to_string(),
            )]),
            _ => unreachable!("{name} is listed and not made"),
        }
    }

    #[expect(deprecated, reason = "logging")]
    async fn log(&self, context: &Context) -> Result<Vec<ContentBlock>, String> {
        for text in [
            "Tool execution started",
            "Tool processing data",
            "Tool execution completed",
        ] {
            let least = *self.level.lock().unwrap();
            if least.is_none_or(|least| least as u8 <= LoggingLevel::Info as u8) {
                let param = LoggingMessageNotificationParam::new(LoggingLevel::Info, json!(text));
                context
                    .peer
                    .notify_logging_message(param)
                    .await
                    .map_err(|error| error.to_string())?;
            }
            time::sleep(PAUSE).await;
        }
        Ok(vec![ContentBlock::text("Three messages were logged.")])
    }

    /// Breaks the answer off, and finishes it when the client has come back.
    async fn reconnect(&self, context: &Context) -> Result<Vec<ContentBlock>, String> {
        let parts = context
            .extensions
            .get::<Parts>()
            .ok_or("the request did not come over HTTP")?;
        parts
            .extensions
            .get::<CancellationToken>()
            .ok_or("the answer cannot be broken off")?
            .cancel();
        let returned = time::timeout(Duration::from_secs(10), self.returned.notified()).await;
        returned.map_err(|_| "the client did not come back")?;
        Ok(vec![ContentBlock::text(
            "The stream was broken off, and this came after.",
        )])
    }
}

async fn progress(context: &Context) -> Result<Vec<ContentBlock>, String> {
    for percent in [0.0, 50.0, 100.0] {
        if let Some(token) = context.meta.get_progress_token() {
            let param = ProgressNotificationParam::new(token, percent).with_total(100.0);
            context
                .peer
                .notify_progress(param)
                .await
                .map_err(|error| error.to_string())?;
        }
        time::sleep(PAUSE).await;
    }
    Ok(vec![ContentBlock::text("All of it was done.")])
}

#[expect(deprecated, reason = "sampling")]
async fn sample(prompt: &str, context: &Context) -> Result<Vec<ContentBlock>, String> {
    if context
        .client_capabilities()
        .is_none_or(|client| client.sampling.is_none())
    {
        return Err("the client cannot sample".to_owned());
    }
    let params = CreateMessageRequestParams::new(vec![SamplingMessage::user_text(prompt)], 100);
    let result = context
        .peer
        .create_message(params)
        .await
        .map_err(|error| error.to_string())?;
    let text = result
        .message
        .content
        .first()
        .and_then(|block| block.as_text())
        .ok_or("the client sampled no text")?;
    Ok(vec![ContentBlock::text(format!(
        "LLM response: {}",
        text.text
    ))])
}

async fn elicit(
    what: &str,
    message: &str,
    properties: Value,
    context: &Context,
) -> Result<Vec<ContentBlock>, String> {
    if !context
        .peer
        .supported_elicitation_modes()
        .contains(&ElicitationMode::Form)
    {
        return Err("the client has nobody to ask".to_owned());
    }
    let names: Vec<&String> = properties
        .as_object()
        .into_iter()
        .flat_map(|properties| properties.keys())
        .collect();
    let schema = object(json!({"type": "object", "properties": properties, "required": names}));
    let requested_schema =
        ElicitationSchema::from_json_schema(schema).map_err(|error| error.to_string())?;
    let params = ElicitRequestParams::FormElicitationParams {
        meta: None,
        message: message.to_owned(),
        requested_schema,
    };
    let result = context
        .peer
        .create_elicitation(params)
        .await
        .map_err(|error| error.to_string())?;
    let (action, content) = (json!(result.action), result.content.unwrap_or_default());
    Ok(vec![ContentBlock::text(format!(
        "{what}: action={}, content={content}",
        action.as_str().unwrap_or_default()
    ))])
}

fn user_form() -> Value {
    json!({
        "username": {"type": "string", "description": "User's response"},
        "email": {"type": "string", "description": "User's email address"},
    })
}

fn defaults_form() -> Value {
    json!({
        "name": {"type": "string", "default": "John Doe"},
        "age": {"type": "integer", "default": 30},
        "score": {"type": "number", "default": 95.5},
        "status": {"type": "string", "enum": ["active", "inactive", "pending"], "default": "active"},
        "verified": {"type": "boolean", "default": true},
    })
}

fn enums_form() -> Value {
    let options = ["option1", "option2", "option3"];
    let titled = [
        json!({"const": "value1", "title": "First"}),
        json!({"const": "value2", "title": "Second"}),
        json!({"const": "value3", "title": "Third"}),
    ];
    json!({
        "untitledSingle": {"type": "string", "enum": options},
        "titledSingle": {"type": "string", "oneOf": titled},
        "legacyEnum": {
            "type": "string",
            "enum": ["opt1", "opt2", "opt3"],
            "enumNames": ["Option One", "Option Two", "Option Three"],
        },
        "untitledMulti": {"type": "array", "items": {"type": "string", "enum": options}},
        "titledMulti": {"type": "array", "items": {"anyOf": titled}},
    })
}

fn tools() -> Vec<Tool> {
    let nothing = json!({"type": "object", "properties": {}});
    let text = |name: &str| json!({"type": "object", "properties": {name: {"type": "string"}}, "required": [name]});
    let address = json!({"type": "object", "properties": {"street": {"type": "string"}, "city": {"type": "string"}}});
    let newest = json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "type": "object",
        "$defs": {"address": address},
        "properties": {"name": {"type": "string"}, "address": {"$ref": "#/$defs/address"}},
        "additionalProperties": false,
    });
    #[rustfmt::skip]
    let tools = [
        ("test_simple_text", "Says a sentence.", nothing.clone()),
        ("test_image_content", "Shows a pixel.", nothing.clone()),
        ("test_audio_content", "Plays silence.", nothing.clone()),
        ("test_embedded_resource", "Embeds a resource.", nothing.clone()),
        ("test_multiple_content_types", "Says, shows and embeds.", nothing.clone()),
        ("test_error_handling", "Fails.", nothing.clone()),
        ("test_tool_with_logging", "Logs three messages.", nothing.clone()),
        ("test_tool_with_progress", "Reports progress three times.", nothing.clone()),
        ("test_sampling", "Has the client's model continue.", text("prompt")),
        ("test_elicitation", "Asks the person at the client.", text("message")),
        ("test_elicitation_sep1034_defaults", "Asks with a form of defaults.", nothing.clone()),
        ("test_elicitation_sep1330_enums", "Asks with a form of choices.", nothing.clone()),
        (
            "test_reconnection",
            "Breaks its answer off, and finishes it when the client has come back.",
            nothing,
        ),
        ("json_schema_2020_12_tool", "Has a schema with what JSON Schema 2020-12 brought.", newest),
    ];
    tools
        .into_iter()
        .map(|(name, description, schema)| Tool::new(name, description, Arc::new(object(schema))))
        .collect()
}

fn prompts() -> Vec<Prompt> {
    let needs = |names: &[&str]| {
        let arguments = names.iter().map(|name| {
            PromptArgument::new(*name)
                .with_description("Goes into it.")
                .with_required(true)
        });
        Some(arguments.collect::<Vec<_>>())
    };
    vec![
        Prompt::new("test_simple_prompt", Some("A sentence."), None),
        Prompt::new(
            "test_prompt_with_arguments",
            Some("Repeats its arguments."),
            needs(&["arg1", "arg2"]),
        ),
        Prompt::new(
            "test_prompt_with_embedded_resource",
            Some("Embeds a resource."),
            needs(&["resourceUri"]),
        ),
        Prompt::new("test_prompt_with_image", Some("Shows a pixel."), None),
    ]
}

fn prompt(name: &str, arguments: &JsonObject) -> Result<Vec<ContentBlock>, String> {
    let argument = |name: &str| {
        arguments
            .get(name)
            .and_then(Value::as_str)
            .ok_or(format!("argument '{name}' is missing"))
    };
    match name {
        "test_simple_prompt" => Ok(vec![ContentBlock::text(
            "This is a simple prompt for testing.",
        )]),
        "test_prompt_with_arguments" => {
            let (first, second) = (argument("arg1")?, argument("arg2")?);
            Ok(vec![ContentBlock::text(format!(
                "Prompt with arguments: arg1='{first}', arg2='{second}'"
            ))])
        }
        "test_prompt_with_embedded_resource" => Ok(vec![
            resource(
                argument("resourceUri")?,
                "text/plain",
                "Embedded resource content for testing.",
            ),
            ContentBlock::text("Please process the embedded resource above."),
        ]),
        "test_prompt_with_image" => Ok(vec![
            ContentBlock::image(PNG, "image/png"),
            ContentBlock::text("Please analyze the image above."),
        ]),
        _ => Err(format!("there is no prompt '{name}'")),
    }
}

fn resources() -> Vec<Resource> {
    let known = [
        (
            "test://static-text",
            "text/plain",
            "A text that never changes.",
        ),
        (
            "test://static-binary",
            "image/png",
            "An image that never changes.",
        ),
        (
            "test://watched-resource",
            "text/plain",
            "A text to subscribe to.",
        ),
    ];
    let resource = |(uri, kind, description)| {
        Resource::new(uri, uri)
            .with_mime_type(kind)
            .with_description(description)
    };
    known.map(resource).into()
}

fn read(uri: &str) -> Option<ResourceContents> {
    match uri {
        "test://static-text" => Some(
            ResourceContents::text("This is the content of the static text resource.", uri)
                .with_mime_type("text/plain"),
        ),
        "test://static-binary" => {
            Some(ResourceContents::blob(PNG, uri).with_mime_type("image/png"))
        }
        "test://watched-resource" => {
            Some(ResourceContents::text("Nothing happened yet.", uri).with_mime_type("text/plain"))
        }
        _ => {
            let id = uri
                .strip_prefix("test://template/")?
                .strip_suffix("/data")?;
            let data =
                json!({"id": id, "templateTest": true, "data": format!("Data for ID: {id}")});
            Some(ResourceContents::text(data.to_string(), uri).with_mime_type("application/json"))
        }
    }
}

fn resource(uri: &str, kind: &str, text: &str) -> ContentBlock {
    ContentBlock::resource(ResourceContents::text(text, uri).with_mime_type(kind))
}

fn object(value: Value) -> JsonObject {
    match value {
        Value::Object(map) => map,
        _ => unreachable!("every caller gives an object"),
    }
}

#[expect(deprecated, reason = "logging")]
impl ServerHandler for Fixture {
    fn get_info(&self) -> ServerConfig {
        let capabilities = ServerCapabilities::builder()
            .enable_logging()
            .enable_completions()
            .enable_prompts()
            .enable_resources()
            .enable_resources_subscribe()
            .enable_tools()
            .build();
        ServerConfig::new(capabilities).with_server_info(Implementation::new(
            "reel-conformance",
            env!("CARGO_PKG_VERSION"),
        ))
    }

    async fn list_tools(
        &self,
        _: Option<PaginatedRequestParams>,
        _: Context,
    ) -> Result<ListToolsResult, ErrorData> {
        Ok(ListToolsResult::with_all_items(tools()))
    }

    async fn call_tool(
        &self,
        request: CallToolRequestParams,
        context: Context,
    ) -> Result<CallToolResponse, ErrorData> {
        if !tools().iter().any(|tool| tool.name == request.name) {
            return Err(ErrorData::invalid_params(
                format!("there is no tool '{}'", request.name),
                None,
            ));
        }
        let made = self
            .call(
                &request.name,
                &request.arguments.unwrap_or_default(),
                &context,
            )
            .await;
        Ok(made
            .map_or_else(
                |why| CallToolResult::error(vec![ContentBlock::text(why)]),
                CallToolResult::success,
            )
            .into())
    }

    async fn list_resources(
        &self,
        _: Option<PaginatedRequestParams>,
        _: Context,
    ) -> Result<ListResourcesResult, ErrorData> {
        Ok(ListResourcesResult::with_all_items(resources()))
    }

    async fn list_resource_templates(
        &self,
        _: Option<PaginatedRequestParams>,
        _: Context,
    ) -> Result<ListResourceTemplatesResult, ErrorData> {
        let template = ResourceTemplate::new("test://template/{id}/data", "template")
            .with_mime_type("application/json");
        Ok(ListResourceTemplatesResult::with_all_items(vec![template]))
    }

    async fn read_resource(
        &self,
        request: ReadResourceRequestParams,
        _: Context,
    ) -> Result<ReadResourceResponse, ErrorData> {
        let unknown = || {
            ErrorData::resource_not_found(format!("there is no resource '{}'", request.uri), None)
        };
        Ok(ReadResourceResult::new(vec![read(&request.uri).ok_or_else(unknown)?]).into())
    }

    async fn subscribe(
        &self,
        request: SubscribeRequestParams,
        _: Context,
    ) -> Result<(), ErrorData> {
        self.watched.lock().unwrap().insert(request.uri);
        Ok(())
    }

    async fn unsubscribe(
        &self,
        request: UnsubscribeRequestParams,
        _: Context,
    ) -> Result<(), ErrorData> {
        let watched = self.watched.lock().unwrap().remove(&request.uri);
        if watched {
            Ok(())
        } else {
            Err(ErrorData::invalid_params(
                format!("'{}' was not subscribed to", request.uri),
                None,
            ))
        }
    }

    async fn list_prompts(
        &self,
        _: Option<PaginatedRequestParams>,
        _: Context,
    ) -> Result<ListPromptsResult, ErrorData> {
        Ok(ListPromptsResult::with_all_items(prompts()))
    }

    async fn get_prompt(
        &self,
        request: GetPromptRequestParams,
        _: Context,
    ) -> Result<GetPromptResponse, ErrorData> {
        let blocks = prompt(&request.name, &request.arguments.unwrap_or_default());
        let blocks = blocks.map_err(|why| ErrorData::invalid_params(why, None))?;
        Ok(GetPromptResult::new(
            blocks
                .into_iter()
                .map(|block| PromptMessage::new(Role::User, block))
                .collect(),
        )
        .into())
    }

    fn set_level(
        &self,
        request: SetLevelRequestParams,
        _: Context,
    ) -> impl Future<Output = Result<(), ErrorData>> {
        *self.level.lock().unwrap() = Some(request.level);
        future::ready(Ok(()))
    }
}
