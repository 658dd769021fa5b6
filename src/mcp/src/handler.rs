//! A policy session: takes calls of one agent to its session, and says what came of them.

use std::{
    borrow::Cow,
    collections::BTreeMap,
    error::Error,
    sync::Arc,
    time::{Duration, Instant},
};

use axum::http::request::Parts;
use reel_live::{
    EpisodePosition, LiveError, OwnSession, Owner, Session, SessionPool, Situation, StartedEpisode,
};
use reel_world::{
    Lifecycle, Profile, Tool, ToolCall,
    record::{Lookup, StepInput, UserReply},
};
use rmcp::{
    ErrorData, RoleServer, ServerHandler, elicit_safe,
    model::{
        CallToolRequestParams, CallToolResponse, CallToolResult, ElicitRequest,
        ElicitRequestParams, ElicitResult, ElicitationAction, ElicitationSchema, Implementation,
        InputRequest, InputRequiredResult, ListToolsResult, PaginatedRequestParams,
        ProgressNotificationParam, ProtocolVersion, ServerCapabilities, ServerConfig,
    },
    schemars,
    service::{ElicitationMode, RequestContext},
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio::sync::oneshot;

use crate::{
    AnsweredInput, Caller, OutsideAnswers, Questions, VERSIONS, Withdrawn, Worker,
    answers::persons, catalogue, methods::WITH_SESSIONS, policy_output, response, tools_only,
    waiting,
};
use response::Response;
use waiting::WaitingSessions;

/// Who answers the questions that a policy asks with `ask`.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AskResponder {
    /// The rule-based user that the simulator provides.
    #[default]
    Rules,
    /// The person at the client, by elicitation; the rule-based user where the
    /// client cannot ask anybody.
    Client,
    /// A person who answers through [`Questions`].
    Rest,
    /// A model in the role of the user, [`AnswerSources::user`].
    Model,
}

/// Says which of the categories of a task a query means. It may take its time: it is asked on a
/// thread that serves nobody else.
pub type LookUp =
    Arc<dyn Fn(&str, &[&str]) -> Result<Lookup, Box<dyn Error + Send + Sync>> + Send + Sync>;

/// Adds what a simulated user says to a question of this moment, and what it was not let say. It may
/// take its time, as [`LookUp`].
pub type AskUser = Arc<
    dyn Fn(&Situation, &str, &mut StepInput) -> Result<(), Box<dyn Error + Send + Sync>>
        + Send
        + Sync,
>;

/// Who answers from outside of the simulator, while the session is free for others.
#[derive(Clone, Default)]
pub struct AnswerSources {
    /// Says what `show_object_by_category` looks for; `None` if Reel's word list does.
    pub matcher: Option<LookUp>,
    /// The user of [`AskResponder::Model`].
    pub user: Option<AskUser>,
    /// Who they are, for the traces: beside the policy's own settings.
    pub settings: BTreeMap<String, Value>,
    /// Which sessions wait for one of them.
    pub waiting: Arc<WaitingSessions>,
}

/// Told of every call: the tool (one of ours, or `unknown`), `ok`, `error` or `refused`, and how
/// long it took, waiting included.
pub type CallObserver = Arc<dyn Fn(&'static str, &'static str, Duration) + Send + Sync>;

/// How policy sessions behave.
#[derive(Clone)]
pub struct ToolServerOptions {
    /// Who answers the questions of `ask`; the rule-based user by default.
    pub ask: AskResponder,
    /// How long a person may take to answer.
    pub ask_patience: Duration,
    /// Name of the policy in the traces; without it, what the client calls itself.
    pub policy: Option<String>,
    /// Who answers from outside.
    pub sources: AnswerSources,
    /// Who is told of every call.
    pub watch: Option<CallObserver>,
}

impl Default for ToolServerOptions {
    fn default() -> Self {
        Self {
            ask: AskResponder::Rules,
            ask_patience: Duration::from_secs(120),
            policy: None,
            sources: AnswerSources::default(),
            watch: None,
        }
    }
}

/// One connection of an agent.
#[derive(Clone)]
pub struct ToolServer {
    pool: Arc<SessionPool>,
    questions: Arc<Questions>,
    options: Arc<ToolServerOptions>,
    home: SessionOwner,
    owner: Owner,
}

/// Whose session it is.
#[derive(Clone)]
enum SessionOwner {
    /// That of the connection, closed with it.
    Own(Arc<OwnSession>),
    /// A worker's, which outlives connections.
    Worker(Worker),
    /// That of the worker whom the path of each request names.
    Named,
}

/// What the person at the client fills in.
#[derive(Debug, Serialize, Deserialize, schemars::JsonSchema)]
#[schemars(crate = "rmcp::schemars")]
struct Reply {
    /// Your answer to the robot.
    answer: String,
}
elicit_safe!(Reply);

/// Why a question has no answer yet.
enum Unanswered {
    /// The client is to ask its person, and to call again.
    AskClient(Box<CallToolResponse>),
    /// The session went on meanwhile.
    Overtaken,
}

/// The key of the one question that a call may have.
const ANSWER: &str = "answer";

impl ToolServer {
    /// A server for one connection, with a session of its own.
    pub fn new(
        pool: Arc<SessionPool>,
        questions: Arc<Questions>,
        options: Arc<ToolServerOptions>,
        name: String,
    ) -> Self {
        let home = SessionOwner::Own(Arc::new(OwnSession::new(name, pool.clone())));
        Self {
            pool,
            questions,
            options,
            home,
            owner: Owner::default(),
        }
    }

    /// A server for one connection of a worker, whose session outlives it.
    pub fn of_worker(
        pool: Arc<SessionPool>,
        questions: Arc<Questions>,
        options: Arc<ToolServerOptions>,
        worker: Worker,
    ) -> Self {
        Self {
            pool,
            questions,
            options,
            home: SessionOwner::Worker(worker),
            owner: Owner::default(),
        }
    }

    /// A server for the requests of workers, each of which names its worker in its path.
    pub fn of_workers(
        pool: Arc<SessionPool>,
        questions: Arc<Questions>,
        options: Arc<ToolServerOptions>,
    ) -> Self {
        Self {
            pool,
            questions,
            options,
            home: SessionOwner::Named,
            owner: Owner::default(),
        }
    }

    /// The same for a connection of this owner; requests that name another caller are that one's.
    pub fn of_owner(self, owner: Owner) -> Self {
        Self { owner, ..self }
    }

    /// Whose the session is that a request opens.
    fn owner(&self, context: &RequestContext<RoleServer>) -> Owner {
        Caller::of(context).map_or_else(|| self.owner.clone(), |caller| caller.owner.clone())
    }

    fn profile(&self) -> Profile {
        self.pool.setup().profile
    }

    /// Whose world a request is for, where its path says so.
    fn worker<'a>(&'a self, context: &'a RequestContext<RoleServer>) -> Option<&'a Worker> {
        match &self.home {
            SessionOwner::Worker(worker) => Some(worker),
            SessionOwner::Own(_) | SessionOwner::Named => context
                .extensions
                .get::<Parts>()
                .and_then(|parts| parts.extensions.get::<Worker>()),
        }
    }

    /// The session of a request.
    fn session(&self, context: &RequestContext<RoleServer>) -> Result<String, ErrorData> {
        match (self.worker(context), &self.home) {
            (Some(worker), _) => Ok(worker.session_name()),
            (None, SessionOwner::Own(own)) if !stateless(context) => Ok(own.name().to_owned()),
            _ => {
                let text = "protocol 2026-07-28 has no sessions, so nothing here says which world is yours: use /w/<name>/mcp \
                            with a name of your own";
                Err(ErrorData::invalid_request(text, None))
            }
        }
    }

    async fn answer(
        &self,
        session: &str,
        input: AnsweredInput,
        tool: Option<Tool>,
        context: &RequestContext<RoleServer>,
    ) -> CallToolResult {
        let profile = self.profile();
        let (name, begun) = (input.step.call.name.clone(), Instant::now());
        let known = tool.as_ref().map_or("unknown", Tool::paper_name);
        let said = self.request(session, input, tool, context).await;
        let outcome = match &said {
            Ok(Response::CallMade(made)) if !made.step.outcome.is_ok() => "error",
            Ok(_) => "ok",
            Err(_) => "refused",
        };
        let result = match said {
            Ok(said) => response::tool_result(profile, &said),
            Err(error) => {
                // Not in its own words: they may hold the policy's. The disk's do not.
                match &error {
                    LiveError::Recording(cause) => {
                        tracing::error!(session, known, error = %cause, "recording failed");
                    }
                    LiveError::Folder { path, source } => {
                        tracing::error!(session, known, path, error = %source, "recording failed");
                    }
                    _ => tracing::info!(session, known, "refused"),
                }
                response::refuse(profile, &name, &error)
            }
        };
        if let Some(watch) = &self.options.watch {
            watch(known, outcome, begun.elapsed());
        }
        result
    }

    /// Takes a call to the session.
    async fn request(
        &self,
        session: &str,
        input: AnsweredInput,
        tool: Option<Tool>,
        context: &RequestContext<RoleServer>,
    ) -> Result<Response, LiveError> {
        let setup = self.pool.setup().clone();
        let published = self.profile().is_published();
        match &tool {
            Some(Tool::Lifecycle(Lifecycle::ListReceptacles))
                if (!published || !self.outside(session, &self.owner).is_running())
                    && let Some(scene) = setup.scenes.only() =>
            {
                return Ok(Response::Receptacles(scene.clone()));
            }
            Some(Tool::Lifecycle(Lifecycle::ListTasks)) => {
                return Ok(Response::Tasks(response::task_ids(&setup.tasks)));
            }
            _ => {}
        }
        let owner = self.owner(context);
        let outside = self.outside(session, &owner);
        let input = outside.complete(tool.as_ref(), input).await?;
        let (questions, asked) = (self.questions.clone(), session.to_owned());
        let (begun, on_begin) = oneshot::channel();
        let policy = self.policy(context);
        let work = move |session: &mut Session| {
            // Nobody waits for it where the call has no progress token.
            let _ = begun.send(());
            // A question that still waits is one of a step that will be over.
            questions.withdraw(&asked);
            session.set_policy(&policy);
            let said_begun = |begun: StartedEpisode| {
                let scene = setup.scene(&begun.task).clone();
                Response::EpisodeStarted(Box::new(begun), scene)
            };
            match tool {
                Some(Tool::Lifecycle(Lifecycle::ListReceptacles))
                    if !published || !session.is_running() =>
                {
                    Ok(Response::Receptacles(
                        session.scene().cloned().ok_or(LiveError::NoEpisode)?,
                    ))
                }
                Some(Tool::Finish) => {
                    if session.is_running() {
                        session.call(input.step)?;
                    }
                    Ok(session
                        .begin_next()?
                        .map_or(Response::Completed, said_begun))
                }
                Some(Tool::Lifecycle(Lifecycle::FinishWithId { task_id })) => {
                    session.begin(&task_id).map(said_begun)
                }
                _ => {
                    let made = input.call(session)?;
                    Ok(Response::CallMade(Box::new(made)))
                }
            }
        };
        let mut done = Box::pin(self.pool.with_own_session(session, &owner, work));
        let Some(token) = context.meta.get_progress_token() else {
            return done.await?;
        };
        let report = |progress: f64, message: &str| {
            let param = ProgressNotificationParam::new(token.clone(), progress)
                .with_total(2.0)
                .with_message(message);
            let peer = context.peer.clone();
            // A client that went away hears of nothing.
            async move { drop(peer.notify_progress(param).await) }
        };
        report(0.0, "waiting for a simulator").await;
        let said = tokio::select! {
            said = &mut done => said?,
            Ok(()) = on_begin => {
                report(1.0, "simulating").await;
                done.await?
            }
        };
        report(2.0, "done").await;
        said
    }

    /// Asks a person, where one is to be asked: the reply, and the step that it is for where the
    /// protocol has sessions. An error of the result is what to answer the client instead.
    async fn ask_person(
        &self,
        session: &str,
        question: &str,
        request: &CallToolRequestParams,
        context: &RequestContext<RoleServer>,
    ) -> Result<(Option<UserReply>, Option<EpisodePosition>), Unanswered> {
        let owner = self.owner(context);
        let outside = self.outside(session, &owner);
        let asks_client = || {
            context
                .peer
                .supported_elicitation_modes()
                .contains(&ElicitationMode::Form)
        };
        match self.options.ask {
            AskResponder::Rules | AskResponder::Model => Ok((None, None)),
            // A question in an episode that does not run is refused, and nobody is bothered with it.
            _ if !outside.is_running() => Ok((None, None)),
            AskResponder::Client if stateless(context) => {
                let answered = request
                    .input_responses
                    .as_ref()
                    .and_then(|answers| answers.get(ANSWER));
                let Some(answered) = answered else {
                    return Err(Unanswered::AskClient(Box::new(elicitation(question))));
                };
                let result: Option<ElicitResult> = serde_json::from_value(answered.clone()).ok();
                let accepted = result.filter(|result| result.action == ElicitationAction::Accept);
                let reply = accepted
                    .and_then(|result| serde_json::from_value::<Reply>(result.content?).ok());
                Ok((Some(persons(reply.map(|reply| reply.answer))), None))
            }
            AskResponder::Client if !asks_client() => Ok((None, None)),
            AskResponder::Client | AskResponder::Rest => {
                // Without a situation there is no episode, and the call says so.
                let Ok(situation) = outside.situation().await else {
                    return Ok((None, None));
                };
                let position = Some(situation.position.clone());
                let patience = self.options.ask_patience;
                let answer = if self.options.ask == AskResponder::Rest {
                    let answered = self.questions.ask(session, question, situation, patience);
                    answered.await.map_err(|Withdrawn| Unanswered::Overtaken)?
                } else {
                    let answer = context
                        .peer
                        .elicit_with_timeout::<Reply>(question, Some(patience))
                        .await;
                    answer.ok().flatten().map(|reply| reply.answer)
                };
                Ok((Some(persons(answer)), position))
            }
        }
    }

    /// Who answers the calls of a session from outside.
    fn outside<'a>(&'a self, session: &'a str, owner: &'a Owner) -> OutsideAnswers<'a> {
        OutsideAnswers {
            pool: &self.pool,
            questions: &self.questions,
            options: &self.options,
            session,
            owner,
        }
    }

    fn policy(&self, context: &RequestContext<RoleServer>) -> String {
        let client = context.client_info().map(|client| client.name);
        let name = self
            .options
            .policy
            .clone()
            .or(client.filter(|name| !name.is_empty()))
            .unwrap_or_else(|| "client".to_owned());
        name.chars().filter(|c| !c.is_control()).take(64).collect()
    }
}

/// Asks the client of the newest protocol to ask its person, and to call again with the answer.
fn elicitation(question: &str) -> CallToolResponse {
    let schema = ElicitationSchema::from_type::<Reply>().expect("the form has one field of text");
    let params = ElicitRequestParams::FormElicitationParams {
        meta: None,
        message: question.to_owned(),
        requested_schema: schema,
    };
    let request = InputRequest::Elicitation(ElicitRequest::new(params));
    InputRequiredResult::from_input_requests([(ANSWER.to_owned(), request)].into()).into()
}

/// Whether the protocol has no sessions.
fn stateless(context: &RequestContext<RoleServer>) -> bool {
    context
        .protocol_version()
        .is_some_and(|version| version.as_str() >= ProtocolVersion::V_2026_07_28.as_str())
}

/// How a server with a household introduces itself, and what it tells the model; `which` says what is special about
/// the household.
pub fn server_info(which: &str) -> ServerConfig {
    let instructions = format!(
        "A household with a robot in it, {which}. Call 'finish' to begin the first episode: the answer holds your task. \
         Then act by calling tools one at a time; numbers in images and lists are marker ids. Call 'finish' again when \
         the task is done: the answer is the next task."
    );
    ServerConfig::new(ServerCapabilities::builder().enable_tools().build())
        .with_server_info(Implementation::new("reel", env!("CARGO_PKG_VERSION")))
        .with_instructions(instructions)
}

impl ServerHandler for ToolServer {
    fn get_info(&self) -> ServerConfig {
        server_info("one for you alone")
    }

    /// Where nothing but a session says whose world it is, only protocols with sessions are spoken.
    fn supported_protocol_versions(&self) -> Cow<'static, [ProtocolVersion]> {
        Cow::Borrowed(match self.home {
            SessionOwner::Own(_) => WITH_SESSIONS,
            SessionOwner::Worker(_) | SessionOwner::Named => VERSIONS,
        })
    }

    tools_only!();

    async fn list_tools(
        &self,
        _: Option<PaginatedRequestParams>,
        _: RequestContext<RoleServer>,
    ) -> Result<ListToolsResult, ErrorData> {
        Ok(ListToolsResult::with_all_items(catalogue::tools(
            self.profile(),
        )))
    }

    async fn call_tool(
        &self,
        request: CallToolRequestParams,
        context: RequestContext<RoleServer>,
    ) -> Result<CallToolResponse, ErrorData> {
        let session = self.session(&context)?;
        let arguments = request
            .arguments
            .clone()
            .map_or_else(|| json!({}), Value::Object);
        let call = ToolCall::new(request.name.clone(), arguments);
        let policy = policy_output(&context.meta.0)
            .map_err(|why| ErrorData::invalid_params(format!("_meta{why}"), None))?;
        let work = async {
            let tool = self.profile().tool(&call).ok();
            let (user_reply, position) = match &tool {
                Some(Tool::Ask { question }) => {
                    self.ask_person(&session, question, &request, &context)
                        .await?
                }
                _ => (None, None),
            };
            let step = StepInput {
                policy,
                user_reply,
                ..StepInput::from_call(call)
            };
            let input = AnsweredInput { step, position };
            Ok(self.answer(&session, input, tool, &context).await.into())
        };
        // A cancelled call was not made, or is persisted as a whole.
        tokio::select! {
            answer = work => Ok(answer.unwrap_or_else(|instead| match instead {
                Unanswered::AskClient(instead) => *instead,
                Unanswered::Overtaken => {
                    response::refuse(self.profile(), &request.name, &LiveError::Overtaken).into()
                }
            })),
            () = context.ct.cancelled() => Err(ErrorData::internal_error("the call was cancelled", None)),
        }
    }
}
