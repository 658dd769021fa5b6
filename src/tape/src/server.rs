//! Sessions that answer from recordings as MCP servers: over Streamable HTTP, legacy HTTP+SSE and
//! standard input and output.

use std::{
    borrow::Cow,
    collections::BTreeMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError, Weak},
    time::Duration,
};

use axum::Router;
use reel_mcp::{
    Transports, WITH_SESSIONS, call_as_it_came, outgoing_result, policy_output, router_of,
    server_info, tools, tools_as_they_came, tools_only,
};
use reel_trace::AnsweredRequest;
use reel_world::{ToolCall, record::StepInput};
use rmcp::{
    ErrorData, RoleServer, ServerHandler, ServiceExt as _,
    model::{
        CallToolRequestParams, CallToolResponse, ClientNotification, ClientRequest,
        ListToolsResult, PaginatedRequestParams, ProtocolVersion, ServerConfig, ServerResult,
    },
    service::{self, NotificationContext, RequestContext},
};
use serde_json::{Map, Value, json};
use tokio::task::spawn_blocking;
use tokio_util::sync::CancellationToken;

use crate::{
    EpisodeReport, Tape, TapeSession, TapeSettings, Tapes, answers::Answer, tape::RecordedAnswer,
};

/// What bounds the transports of a replay server.
#[derive(Clone, Copy, Debug)]
pub struct TapeTransports {
    /// How many sessions may be open at a time.
    pub sessions: usize,
    /// A session ends when nothing came or went for so long.
    pub keep_alive: Duration,
    /// Most bytes of a message.
    pub max_body: usize,
}

/// Told of every recording that was played, when it ends.
type ReportObserver = Arc<dyn Fn(&EpisodeReport) + Send + Sync>;

/// All sessions of a replay server.
#[derive(Clone)]
pub struct TapeSessions(Arc<Shared>);

struct Shared {
    tapes: Arc<Tapes>,
    settings: Arc<TapeSettings>,
    observer: ReportObserver,
    open: Mutex<Vec<Weak<Reporting>>>,
}

/// A session whose reports go to the observer.
struct Reporting {
    session: Mutex<TapeSession>,
    observer: ReportObserver,
}

/// One connection of an agent to a replay server.
#[derive(Clone)]
pub struct TapeServer(Arc<Reporting>);

impl TapeSessions {
    /// Sessions that each play these recordings in their order. The observer is told of every
    /// recording that was played when it ends.
    pub fn new(
        tapes: Arc<Tapes>,
        settings: TapeSettings,
        observer: impl Fn(&EpisodeReport) + Send + Sync + 'static,
    ) -> Self {
        Self(Arc::new(Shared {
            tapes,
            settings: Arc::new(settings),
            observer: Arc::new(observer),
            open: Mutex::default(),
        }))
    }

    /// A session for one connection.
    pub fn open(&self, name: String) -> TapeServer {
        let Shared {
            tapes,
            settings,
            observer,
            open,
        } = &*self.0;
        let session = TapeSession::new(tapes.clone(), settings.clone(), name);
        let session = Arc::new(Reporting {
            session: Mutex::new(session),
            observer: observer.clone(),
        });
        let mut open = lock(open);
        open.retain(|session| session.strong_count() > 0);
        open.push(Arc::downgrade(&session));
        TapeServer(session)
    }

    /// Ends what every session plays, and tells the observer.
    pub fn end_all(&self) {
        let open = std::mem::take(&mut *lock(&self.0.open));
        for session in open.iter().filter_map(Weak::upgrade) {
            session.end();
        }
    }

    /// `/mcp`, `/sse` and `/messages/`. Host and Origin are the caller's to check.
    pub fn router(&self, transports: TapeTransports, closing: CancellationToken) -> Router {
        let sessions = self.clone();
        let factory = move || sessions.open(format!("s-{}", random()));
        let TapeTransports {
            sessions,
            keep_alive,
            max_body,
        } = transports;
        router_of(
            factory,
            &Transports {
                sessions,
                keep_alive,
                max_body,
                closing,
            },
        )
    }

    /// Serves one agent over standard input and output, until it goes.
    ///
    /// # Errors
    /// When the first message is not one of the protocol.
    pub async fn stdio(&self) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
        let server = AsItCame(self.open("stdio".to_owned()));
        let served = server.serve(rmcp::transport::stdio()).await?;
        served.waiting().await?;
        Ok(())
    }
}

impl Reporting {
    fn end(&self) {
        let mut session = lock(&self.session);
        session.end();
        self.tell(&mut session);
    }

    fn tell(&self, session: &mut TapeSession) {
        for report in session.take_reports() {
            (self.observer)(&report);
        }
    }
}

impl Drop for Reporting {
    fn drop(&mut self) {
        self.end();
    }
}

impl TapeServer {
    async fn answer(
        &self,
        request: CallToolRequestParams,
        context: &RequestContext<RoleServer>,
    ) -> Result<Answer, ErrorData> {
        let arguments = request.arguments.map_or_else(|| json!({}), Value::Object);
        let policy = policy_output(&context.meta.0)
            .map_err(|why| ErrorData::invalid_params(format!("_meta{why}"), None))?;
        let input = StepInput {
            policy,
            ..StepInput::from_call(ToolCall::new(request.name, arguments))
        };
        let client = context.client_info().map(|client| client.name);
        let client = client.filter(|name| !name.is_empty());
        let client: Option<String> = client.map(|name| {
            let letters = name.chars().filter(|letter| !letter.is_control());
            letters.take(64).collect()
        });
        let this = self.0.clone();
        let answered = spawn_blocking(move || {
            let mut session = lock(&this.session);
            if let Some(client) = client {
                session.set_policy(&client);
            }
            let answer = session.call(input);
            this.tell(&mut session);
            answer
        });
        answered
            .await
            .map_err(|error| ErrorData::internal_error(error.to_string(), None))
    }
}

impl ServerHandler for TapeServer {
    fn get_info(&self) -> ServerConfig {
        server_info("as it was recorded")
    }

    /// A session holds the place in a recording, so only protocols with sessions are spoken.
    fn supported_protocol_versions(&self) -> Cow<'static, [ProtocolVersion]> {
        Cow::Borrowed(WITH_SESSIONS)
    }

    tools_only!();

    async fn list_tools(
        &self,
        _: Option<PaginatedRequestParams>,
        _: RequestContext<RoleServer>,
    ) -> Result<ListToolsResult, ErrorData> {
        let session = lock(&self.0.session);
        let tape = session.tape();
        if tape.is_simulated() {
            return Ok(ListToolsResult::with_all_items(tools(tape.profile())));
        }
        let recorded = tape.recorded(AnsweredRequest::ToolList);
        let listed = recorded
            .unwrap_or_else(|| RecordedAnswer::Result(json!({"tools": called_tools(tape)})));
        Ok(tools_as_they_came(passed_on(listed)?))
    }

    async fn call_tool(
        &self,
        request: CallToolRequestParams,
        context: RequestContext<RoleServer>,
    ) -> Result<CallToolResponse, ErrorData> {
        match self.answer(request, &context).await? {
            Answer::Ours(result) => Ok((*result).into()),
            Answer::Recorded(recorded) => Ok(call_as_it_came(passed_on(recorded)?).into()),
        }
    }
}

/// [`TapeServer`] for a transport that sends results as it gets them.
struct AsItCame(TapeServer);

impl service::Service<RoleServer> for AsItCame {
    async fn handle_request(
        &self,
        request: ClientRequest,
        context: RequestContext<RoleServer>,
    ) -> Result<ServerResult, ErrorData> {
        let result = service::Service::handle_request(&self.0, request, context).await;
        result.map(outgoing_result)
    }

    async fn handle_notification(
        &self,
        notification: ClientNotification,
        context: NotificationContext<RoleServer>,
    ) -> Result<(), ErrorData> {
        service::Service::handle_notification(&self.0, notification, context).await
    }

    fn get_info(&self) -> ServerConfig {
        ServerHandler::get_info(&self.0)
    }

    fn supported_protocol_versions(&self) -> Cow<'static, [ProtocolVersion]> {
        ServerHandler::supported_protocol_versions(&self.0)
    }
}

/// The tools that were called in a recording, with every argument that they got.
fn called_tools(tape: &Tape) -> Vec<Value> {
    let mut tools: BTreeMap<String, Map<String, Value>> = BTreeMap::new();
    for call in (0..tape.len()).filter_map(|step| tape.call(step)) {
        let arguments = tools.entry(call.name).or_default();
        for name in call.arguments.as_object().into_iter().flat_map(Map::keys) {
            arguments.insert(name.clone(), json!({}));
        }
    }
    let tool = |(name, properties): (String, Map<String, Value>)| {
        json!({
            "name": name,
            "description": "Called in the recording, which does not keep the server's description.",
            "inputSchema": {"type": "object", "properties": properties},
        })
    };
    tools.into_iter().map(tool).collect()
}

/// The result that was recorded, or the error in its place.
fn passed_on(recorded: RecordedAnswer) -> Result<Value, ErrorData> {
    match recorded {
        RecordedAnswer::Result(result) => Ok(result),
        RecordedAnswer::Error(error) => Err(serde_json::from_value(error)
            .unwrap_or_else(|error| ErrorData::internal_error(error.to_string(), None))),
    }
}

fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

/// 128 bits that nobody can guess.
fn random() -> String {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).expect("the system has randomness");
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
