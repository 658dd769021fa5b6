//! Tools for assistants that look at what was recorded: read-only, on an endpoint and a role of
//! their own. No policy session lists them, and nothing here acts.

use std::{borrow::Cow, sync::Arc, time::Duration};

use axum::Router;
use base64::{Engine as _, prelude::BASE64_STANDARD};
use reel_counterfactual::blame::BlameOptions;
use reel_mcp::Caller;
use reel_query::Parameters;
use reel_trace::Trace;
use rmcp::{
    ErrorData, RoleServer, ServerHandler,
    model::{
        CallToolRequestParams, CallToolResponse, CallToolResult, ContentBlock, Implementation,
        JsonObject, ListToolsResult, PaginatedRequestParams, ProtocolVersion, ServerCapabilities,
        ServerConfig, Tool, ToolAnnotations,
    },
    service::RequestContext,
};
use serde_json::{Value, json};

use crate::{
    rest::{Camera, FrameRequest, asked_rows, rows},
    service::App,
};

/// Most rows of an answer: what an assistant can read.
const ROWS: usize = 200;
/// Most connections at once.
const SESSIONS: usize = 256;
/// How long an idle connection is kept.
const KEEP_ALIVE: Duration = Duration::from_secs(600);

pub(crate) fn router(app: &Arc<App>, max_body: usize) -> Router {
    let server = Analysis { app: app.clone() };
    let service = reel_mcp::streamable_http(
        move || server.clone(),
        (SESSIONS, SESSIONS / 2),
        KEEP_ALIVE,
        max_body,
        app.closing.clone(),
    );
    Router::new().route_service("/analysis/mcp", service)
}

#[derive(Clone)]
struct Analysis {
    app: Arc<App>,
}

/// Name, arguments (name, type, whether it must be there, meaning), description.
type Described = (
    &'static str,
    &'static [(&'static str, &'static str, bool, &'static str)],
    &'static str,
);

const TOOLS: [Described; 6] = [
    (
        "list_episodes",
        &[
            (
                "where",
                "string",
                false,
                "A condition in SQL on table episodes, e.g. NOT success AND family = 'SUL'.",
            ),
            ("limit", "integer", false, "At most so many, up to 200."),
        ],
        "List recorded episodes: id, task, family, policy, success, reward, length, trace.",
    ),
    (
        "show_episode",
        &[(
            "trace",
            "string",
            true,
            "Name of the trace, as list_episodes gives it.",
        )],
        "Show an episode call by call: what was called, what it said, rewards, how it ended.",
    ),
    (
        "show_frame",
        &[
            ("trace", "string", true, "Name of the trace."),
            (
                "step",
                "string",
                true,
                "The number of a step, from 0, or 'start'.",
            ),
            (
                "camera",
                "string",
                false,
                "head (what the agent saw; the default), top-down, follow:target, follow:OBJECT, or free.",
            ),
            (
                "eye",
                "string",
                false,
                "With camera free: where it is, x,y,z in metres.",
            ),
            (
                "look_at",
                "string",
                false,
                "With camera free: what it looks at, x,y,z in metres.",
            ),
            (
                "layer",
                "string",
                false,
                "rgb (the default), depth (16-bit gray, millimetres), or masks (16-bit gray, instance ids).",
            ),
        ],
        "Show what was seen after a step, from any camera: the image, and every instance in it with its pixels and its depth \
         in millimetres (least, median, greatest).",
    ),
    (
        "query",
        &[(
            "sql",
            "string",
            true,
            "One statement that asks; SHOW TABLES and DESCRIBE episodes tell what there is.",
        )],
        "Ask the tables in SQL. At most 200 rows come back: aggregate, or use LIMIT.",
    ),
    (
        "blame",
        &[("trace", "string", true, "Name of the trace.")],
        "Measure why an episode failed: the decisive step, its cause, what a competent agent would have done then.",
    ),
    (
        "explain_failure",
        &[("trace", "string", true, "Name of the trace.")],
        "Say in a few sentences why an episode failed: the decisive step, its class, and what would have been better.",
    ),
];

/// What a tool answers: a value, and an image where there is one.
struct Answer {
    value: Value,
    png: Option<Vec<u8>>,
}

impl From<Value> for Answer {
    fn from(value: Value) -> Self {
        Self { value, png: None }
    }
}

impl Analysis {
    /// What a tool answers; where `gone` says that nobody waits for it, a question in SQL ends.
    fn answer(
        &self,
        name: &str,
        arguments: &JsonObject,
        gone: impl Fn() -> bool + Clone + Send + 'static,
    ) -> Result<Answer, String> {
        if name == "show_frame" {
            return self.frame(arguments);
        }
        let app = &self.app;
        let text = |key: &str| {
            let value = arguments.get(key).and_then(Value::as_str);
            value
                .map(str::to_owned)
                .ok_or_else(|| format!("{name}: argument '{key}' (a text) is missing"))
        };
        let told = |error: crate::rest::ApiError| error.to_string();
        match name {
            "list_episodes" => {
                let condition = arguments
                    .get("where")
                    .and_then(Value::as_str)
                    .unwrap_or("true");
                let limit = arguments
                    .get("limit")
                    .and_then(Value::as_u64)
                    .unwrap_or(50)
                    .clamp(1, ROWS as u64);
                let sql = format!(
                    "SELECT episode_id, task_id, family, policy, success, total_reward, length, trace FROM episodes \
                     WHERE ({condition}\n) ORDER BY episode_id LIMIT {limit}"
                );
                asked_rows(app, &sql, gone)
                    .map(|rows| json!(rows))
                    .map_err(told)
            }
            "query" => {
                let mut found = asked_rows(app, &text("sql")?, gone).map_err(told)?;
                let total = found.len();
                found.truncate(ROWS);
                Ok(json!({"rows": found, "of": total}))
            }
            "show_episode" => app
                .archive
                .read(&text("trace")?)
                .map(|trace| shown(&trace))
                .map_err(told),
            "blame" => self.blame(&text("trace")?),
            "explain_failure" => self.explain(&text("trace")?),
            other => Err(format!("no tool is called '{other}'")),
        }
        .map(Answer::from)
    }

    fn frame(&self, arguments: &JsonObject) -> Result<Answer, String> {
        // A number is as good as its digits.
        let text = |key: &str| match arguments.get(key) {
            Some(Value::String(text)) => Ok(text.clone()),
            Some(number @ Value::Number(_)) => Ok(number.to_string()),
            _ => Err(format!("show_frame: argument '{key}' (a text) is missing")),
        };
        let (trace, step) = (text("trace")?, text("step")?);
        let camera: Camera = serde_json::from_value(json!(arguments))
            .map_err(|error| format!("show_frame: {error}"))?;
        let told = |error: crate::rest::ApiError| error.to_string();
        let frame = FrameRequest::new(&self.app, &trace, &step, &camera).map_err(told)?;
        Ok(Answer {
            value: json!({"trace": trace, "step": step, "visible": frame.visible().map_err(told)?}),
            png: Some(frame.png().map_err(told)?),
        })
    }

    fn blame(&self, name: &str) -> Result<Value, String> {
        let path = self
            .app
            .archive
            .existing(name)
            .map_err(|error| error.to_string())?;
        let measured = reel_counterfactual::blame::blame_all(
            self.app.archive.files(),
            &[path],
            1,
            &BlameOptions {
                alternatives: true,
                ..BlameOptions::default()
            },
            || (),
        );
        let mut value = json!(
            measured
                .into_iter()
                .next()
                .unwrap_or_else(|| Err("nothing was measured".to_owned()))?
        );
        value["trace"] = json!(name);
        Ok(value)
    }

    fn explain(&self, name: &str) -> Result<Value, String> {
        let trace = self
            .app
            .archive
            .read(name)
            .map_err(|error| error.to_string())?;
        let blame = reel_counterfactual::blame::blame(&trace);
        let parameters = Parameters::from([("id".to_owned(), trace.header.episode_id.clone())]);
        let class = rows(
            &self.app,
            "SELECT class, sub_class FROM classes WHERE episode_id = $id",
            &parameters,
        );
        let class = class.ok().and_then(|mut rows| rows.pop());
        let said = match (&blame.decisive, blame.success) {
            (_, Some(true)) => format!(
                "The episode succeeded after {} decisions.",
                trace.steps.len()
            ),
            (None, _) => {
                "No single step lost the episode: nothing that was possible was lost for good."
                    .to_owned()
            }
            (Some(decisive), _) => format!(
                "The decisive step is call {}, {}: {} A competent agent would have done this instead: {}.",
                decisive.step, decisive.call, decisive.explanation, decisive.advised_call
            ),
        };
        Ok(
            json!({"trace": name, "summary": said, "class": class, "decisive": blame.decisive, "wasted_steps": blame.wasted_steps}),
        )
    }
}

fn shown(trace: &Trace) -> Value {
    let steps: Vec<Value> = trace
        .steps
        .iter()
        .map(|step| {
            json!({"step": step.step, "call": step.input.call.to_string(), "text": step.outcome.text, "error": step.outcome.error,
                "reward": step.reward_total(), "held": step.held})
        })
        .collect();
    json!({
        "episode_id": trace.header.episode_id, "task_id": trace.task.task_id, "instruction": trace.task.instruction,
        "target": trace.task.target, "from": trace.task.src, "to": trace.task.dest, "policy": trace.header.policy.name,
        "steps": steps, "end": trace.end.as_ref().map(|end| json!({"reason": end.reason, "metrics": end.metrics})),
    })
}

impl ServerHandler for Analysis {
    fn get_info(&self) -> ServerConfig {
        let instructions = "Recorded episodes of embodied agents, read-only. Start with list_episodes or query; then blame and \
                            explain_failure say why one failed.";
        ServerConfig::new(ServerCapabilities::builder().enable_tools().build())
            .with_server_info(Implementation::new(
                "reel-analysis",
                env!("CARGO_PKG_VERSION"),
            ))
            .with_instructions(instructions)
    }

    fn supported_protocol_versions(&self) -> Cow<'static, [ProtocolVersion]> {
        Cow::Borrowed(reel_mcp::VERSIONS)
    }

    reel_mcp::tools_only!();

    async fn list_tools(
        &self,
        _: Option<PaginatedRequestParams>,
        _: RequestContext<RoleServer>,
    ) -> Result<ListToolsResult, ErrorData> {
        let tool = |(name, arguments, description): &Described| {
            let property = |(name, kind, _, meaning): &(&str, &str, bool, &str)| {
                (
                    (*name).to_owned(),
                    json!({"type": kind, "description": meaning}),
                )
            };
            let properties: JsonObject = arguments.iter().map(property).collect();
            let required: Vec<&str> = arguments
                .iter()
                .filter(|(.., must, _)| *must)
                .map(|(name, ..)| *name)
                .collect();
            let schema: JsonObject = [
                ("type".to_owned(), json!("object")),
                ("properties".to_owned(), json!(properties)),
                ("required".to_owned(), json!(required)),
            ]
            .into_iter()
            .collect();
            let hints = ToolAnnotations::new().read_only(true).open_world(false);
            Tool::new(*name, *description, Arc::new(schema)).with_annotations(hints)
        };
        Ok(ListToolsResult::with_all_items(
            TOOLS.iter().map(tool).collect(),
        ))
    }

    async fn call_tool(
        &self,
        request: CallToolRequestParams,
        context: RequestContext<RoleServer>,
    ) -> Result<CallToolResponse, ErrorData> {
        let caller = Caller::of(&context).cloned().unwrap_or_default();
        let place = tokio::select! {
            place = self.app.place(&caller.owner) => {
                place.map_err(|error| ErrorData::internal_error(error.to_string(), None))?
            }
            () = context.ct.cancelled() => {
                return Err(ErrorData::internal_error("the call was cancelled", None));
            }
        };
        let (server, name) = (self.clone(), request.name.to_string());
        let arguments = request.arguments.unwrap_or_default();
        let ends = context.ct.clone();
        let gone = move || ends.is_cancelled() || caller.revoked.is_cancelled();
        let answered = tokio::task::spawn_blocking(move || {
            let _place = place;
            server.answer(&name, &arguments, gone)
        })
        .await;
        let answered = answered.map_err(|_| {
            ErrorData::internal_error("the analysis panicked; the log has the details", None)
        })?;
        Ok(match answered {
            Ok(Answer { value, png }) => {
                let text = serde_json::to_string_pretty(&value).expect("a value is JSON");
                let mut content = vec![ContentBlock::text(text)];
                content.extend(
                    png.map(|png| ContentBlock::image(BASE64_STANDARD.encode(png), "image/png")),
                );
                let mut result = CallToolResult::success(content);
                // Structured content is an object; a list goes as text alone.
                result.structured_content = value.is_object().then_some(value);
                result
            }
            Err(why) => {
                let why = self.app.archive.redact_path(&why);
                CallToolResult::error(vec![ContentBlock::text(why)])
            }
        }
        .into())
    }
}
