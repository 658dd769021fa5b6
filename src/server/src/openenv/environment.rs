//! One environment of the contract: a session of the pool, with reset, step and state. Knows neither
//! sockets nor HTTP.

use std::{path::Path, sync::Arc, time::Instant};

use reel_live::{CallResult, LiveError, OwnSession, Session, StartedEpisode};
use reel_mcp::{
    AnsweredInput, Caller, OutsideAnswers, Response, ToolServerOptions, task_ids, tool_result,
};
use reel_world::{
    Lifecycle, Profile, Scene, Tool, ToolCall,
    record::{PolicyOutput, StepInput},
};
use rmcp::model::CallToolResult;
use serde_json::{Value, json};

use super::{
    branch::{self, Origin},
    message::{Action, Form, ResetBody},
    observation::{self, EpisodeFacts},
    reads,
    refusal::Refusal,
};
use crate::{rest::ApiError, service::App};

/// Name of the policy in traces where the configuration has none: clients do not say theirs.
const POLICY: &str = "openenv";

/// An environment of one client.
pub(super) struct Environment {
    app: Arc<App>,
    options: ToolServerOptions,
    caller: Caller,
    name: String,
    /// Closes the session with its connection, if it belongs to one.
    _own: Option<OwnSession>,
    /// Whether observations hold images.
    image: bool,
    /// What the client calls its episode.
    label: Option<String>,
}

/// The result of a call by the profile, and what the contract has beside it.
pub(super) struct Outcome {
    pub result: CallToolResult,
    pub reward: Option<f64>,
    pub done: bool,
    pub facts: Option<EpisodeFacts>,
}

impl Environment {
    /// The environment of one connection, closed with it.
    pub fn of_connection(app: Arc<App>, caller: Caller, name: String) -> Result<Self, Refusal> {
        let pool = app.pool.clone();
        pool.open(&name, &caller.owner).map_err(|error| {
            let most = match &error {
                LiveError::Full(most) => *most,
                LiveError::Quota { limit, .. } => *limit,
                _ => return Refusal::Live(error),
            };
            let of_caller = |owner: &Option<String>| owner.as_deref() == caller.owner.name();
            let counted =
                |owner: &Option<String>| matches!(error, LiveError::Full(_)) || of_caller(owner);
            let entries = pool.entries();
            Refusal::Capacity {
                message: error.to_string(),
                active: entries.iter().filter(|it| counted(&it.owner)).count(),
                most,
            }
        })?;
        let own = OwnSession::new(name.clone(), pool);
        Ok(Self {
            _own: Some(own),
            ..Self::named(app, caller, name)
        })
    }

    /// The environment of that name, which lasts until it is closed.
    pub fn named(app: Arc<App>, caller: Caller, name: String) -> Self {
        let mut options = app.tool_server_options();
        options.policy.get_or_insert_with(|| POLICY.to_owned());
        Self {
            app,
            options,
            caller,
            name,
            _own: None,
            image: false,
            label: None,
        }
    }

    /// Sets what the client calls its episode, and whether it wants images.
    pub fn set(&mut self, label: Option<String>, image: bool) {
        (self.label, self.image) = (label, image);
    }

    pub fn profile(&self) -> Profile {
        self.app.pool.setup().profile
    }

    /// Begins an episode and gives its first observation.
    pub async fn reset(&mut self, body: ResetBody) -> Result<Value, Refusal> {
        let origin = body.trace.clone().map(|trace| Origin {
            trace,
            call: body.call.unwrap_or(0),
        });
        // An agent under evaluation neither continues other episodes nor chooses the name under which
        // the tables count it.
        for (wanted, what) in [
            (origin.is_some(), "to start from a recorded episode"),
            (body.policy.is_some(), "to name the policy"),
        ] {
            if wanted && !reads(&self.app, &self.caller) {
                let why = format!("{what} a token needs role 'read' besides 'act'");
                return Err(Refusal::Trace(ApiError::forbidden("role", why)));
            }
        }
        self.set(body.episode_id.clone(), body.image.unwrap_or(false));
        let label = body.episode_id.clone();
        let (app, name) = (self.app.clone(), self.name.clone());
        let policy = body.policy.clone().or_else(|| self.options.policy.clone());
        let policy = policy.unwrap_or_default();
        let work = move |session: &mut Session| {
            app.questions.withdraw(&name);
            session.set_policy(&policy);
            let begun = match &origin {
                Some(origin) => branch::begin(&app, session, origin, label.as_deref())?,
                None => session.begin_requested(&reel_live::EpisodeRequest {
                    task_id: body.task,
                    seed: body.seed,
                    label,
                })?,
            };
            let scene = session.scene().cloned().ok_or(LiveError::NoEpisode)?;
            let facts = facts(&app, session, origin);
            Ok::<_, Refusal>((begun, scene, facts))
        };
        let (begun, scene, mut facts) = self.with_session(work).await??;
        if self.image && reads(&self.app, &self.caller) {
            facts.marker_boxes = Some(begun.frame.marker_boxes.clone());
        }
        Ok(self.first_observation(begun, scene, &facts))
    }

    fn first_observation(
        &self,
        begun: StartedEpisode,
        scene: Arc<Scene>,
        facts: &EpisodeFacts,
    ) -> Value {
        let tools = observation::tools(self.profile());
        let receptacles = begun.briefing.receptacles.iter();
        let receptacles: Vec<Value> = receptacles
            .map(|(id, category, room)| json!({"id": id, "category": category, "room": room}))
            .collect();
        let response = Response::EpisodeStarted(Box::new(begun), scene);
        let said = tool_result(self.profile(), &response);
        let mut observation = observation::of_call(&said, self.image, Some(facts), &self.label);
        if self.profile() == Profile::Paper {
            observation.insert("receptacles".to_owned(), json!(receptacles));
        }
        observation.insert("available_tools".to_owned(), json!(tools));
        json!({"observation": observation, "reward": null, "done": false})
    }

    /// Executes an action and gives its observation.
    pub async fn step(&mut self, action: Action) -> Result<Value, Refusal> {
        let (call, policy, form) = match action {
            Action::Call { call, policy, form } => (call, policy, form),
            Action::ListTools => {
                let tools = observation::tools(self.profile());
                let observation = json!({"tools": tools, "metadata": {}});
                return Ok(json!({"observation": observation, "reward": null, "done": false}));
            }
        };
        let tool = call.name.clone();
        let Outcome {
            result: said,
            reward,
            done,
            facts,
        } = self.call(call, policy.map(|it| *it)).await?;
        let observation = match form {
            Form::Call => observation::of_call(&said, self.image, facts.as_ref(), &self.label),
            Form::Tool => {
                observation::of_tool(&tool, &said, self.image, facts.as_ref(), &self.label)
            }
        };
        Ok(json!({"observation": observation, "reward": reward, "done": done}))
    }

    /// Makes a call and waits until it is recorded.
    pub async fn call(
        &self,
        call: ToolCall,
        policy: Option<PolicyOutput>,
    ) -> Result<Outcome, Refusal> {
        let begun = Instant::now();
        let tool = self.profile().tool(&call).ok();
        let known = tool.as_ref().map_or("unknown", Tool::paper_name);
        let step = StepInput {
            policy,
            ..StepInput::from_call(call)
        };
        let made = self.execute(step, tool).await;
        let outcome = match &made {
            Ok((Response::CallMade(made), _)) if !made.step.outcome.is_ok() => "error",
            Ok(_) => "ok",
            Err(refusal) => {
                if let Refusal::Live(LiveError::Recording(error)) = refusal {
                    tracing::error!(session = self.name, known, %error, "recording failed");
                }
                "refused"
            }
        };
        if let Some(watch) = &self.options.watch {
            watch(known, outcome, begun.elapsed());
        }
        let (response, facts) = made?;
        let (reward, done) = match &response {
            Response::CallMade(made) => (Some(reward(made)), made.ended.is_some()),
            _ => (None, false),
        };
        Ok(Outcome {
            result: tool_result(self.profile(), &response),
            reward: reward.filter(|_| reads(&self.app, &self.caller)),
            done,
            facts,
        })
    }

    async fn execute(
        &self,
        step: StepInput,
        tool: Option<Tool>,
    ) -> Result<(Response, Option<EpisodeFacts>), Refusal> {
        let published = self.profile().is_published();
        match &tool {
            Some(Tool::Lifecycle(Lifecycle::ListTasks)) => {
                let tasks = task_ids(&self.app.pool.setup().tasks);
                return Ok((Response::Tasks(tasks), None));
            }
            Some(Tool::Lifecycle(Lifecycle::FinishWithId { .. })) => {
                let why = "is no action here; call reset() with `task`";
                return Err(Refusal::invalid("value_error", &["data", "name"], why));
            }
            Some(Tool::Lifecycle(Lifecycle::ListReceptacles)) if !published => {
                let scene = |session: &mut Session| session.scene().cloned();
                let scene = self.with_session(scene).await?;
                let scene = scene.ok_or(LiveError::NoEpisode)?;
                return Ok((Response::Receptacles(scene), None));
            }
            _ => {}
        }
        let outside = OutsideAnswers {
            pool: &self.app.pool,
            questions: &self.app.questions,
            options: &self.options,
            session: &self.name,
            owner: &self.caller.owner,
        };
        let input = outside.ask_person(tool.as_ref(), step).await?;
        let input: AnsweredInput = outside.complete(tool.as_ref(), input).await?;
        let (app, name, image) = (self.app.clone(), self.name.clone(), self.image);
        let told = reads(&self.app, &self.caller);
        let work = move |session: &mut Session| {
            app.questions.withdraw(&name);
            let mut facts = session.is_running().then(|| facts(&app, session, None));
            let mut made = input.call(session)?;
            if let (Some(facts), true) = (&mut facts, image && told) {
                let shown = made.frame.as_ref().or(made.head_frame.as_ref());
                facts.marker_boxes = shown.map(|frame| frame.marker_boxes.clone());
            }
            if !image {
                // It is persisted; nobody here wants it encoded.
                (made.frame, made.head_frame) = (None, None);
            }
            Ok::<_, LiveError>((Response::CallMade(Box::new(made)), facts))
        };
        Ok(self.with_session(work).await??)
    }

    /// How the episode stands, as the contract's state.
    pub async fn state(&self) -> Result<Value, Refusal> {
        let app = self.app.clone();
        let facts = move |session: &mut Session| {
            let status = session.state();
            let trace = session.recording().or(status.trace.as_deref());
            let trace = trace.and_then(|path| trace_name(&app, path));
            let id = session.episode_id().map(str::to_owned);
            (status, trace, id)
        };
        let (status, trace, id) = self.with_session(facts).await?;
        Ok(json!({
            "episode_id": self.label.clone().or(id),
            "step_count": status.steps,
            "status": status.state,
            "task_id": status.task_id,
            "trace": trace,
        }))
    }

    async fn with_session<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Session) -> T + Send + 'static,
    ) -> Result<T, LiveError> {
        self.app
            .pool
            .with_own_session(&self.name, &self.caller.owner, work)
            .await
    }
}

/// The reward of a call: the sum of its terms under the preset.
fn reward(made: &CallResult) -> f64 {
    made.step.reward.iter().map(|term| term.value).sum()
}

/// What observations say of the episode that runs.
fn facts(app: &App, session: &Session, origin: Option<Origin>) -> EpisodeFacts {
    EpisodeFacts {
        trace: session.recording().and_then(|path| trace_name(app, path)),
        episode_id: session.episode_id().map(str::to_owned),
        instruction: session.briefing().ok().map(|it| it.instruction),
        parent: origin.map(|it| (it.trace, it.call)),
        marker_boxes: None,
    }
}

fn trace_name(app: &App, path: &Path) -> Option<String> {
    app.archive.name_of(path)
}
