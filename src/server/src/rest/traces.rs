//! Recorded episodes: the files, what is in them, and what the simulator makes of them.

use std::{ops::Bound, sync::Arc};

use axum::{
    Json,
    body::Body,
    extract::{Request, State},
    http::{HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use reel_agents::{AgentError, RecordTo};
use reel_counterfactual::blame::BlameOptions;
use reel_counterfactual::branch::{Branch, BranchError, Continuation};
use reel_replay::Verdict;
use reel_reward::Preset;
#[cfg(feature = "rerun")]
use reel_trace::FrameLayers;
use reel_trace::{Images, RecordOptions, Trace, TraceError};
use reel_world::ToolCall;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt as _, AsyncSeekExt as _};
use tokio_util::io::ReaderStream;
use utoipa::{IntoParams, ToSchema};

use super::{
    ApiError, analyse,
    error::ErrorBody,
    extract::{Body as JsonBody, PathParams, QueryParams},
};
use crate::{archive::TraceFile, service::App};

/// Most entries of a list in one answer.
const PAGE: usize = 1_000;

#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct Page {
    /// From the one after this name on.
    #[serde(default)]
    after: String,
    /// At most so many, up to 1,000.
    #[serde(default = "page")]
    #[param(minimum = 1, maximum = 1000, default = 100)]
    limit: usize,
}

fn page() -> usize {
    100
}

/// A part of a list.
#[derive(Serialize, ToSchema)]
pub(super) struct Traces {
    traces: Vec<TraceFile>,
    /// What to give as `after` for the next part; null at the end.
    next: Option<String>,
}

/// Traces of the archive in the order of their names, one page at a time.
#[utoipa::path(get, path = "/api/traces", operation_id = "list_traces", tag = "traces", params(Page),
    responses((status = 200, body = Traces), (status = 400, body = ErrorBody), (status = 507, body = ErrorBody)))]
pub(super) async fn list(
    State(app): State<Arc<App>>,
    QueryParams(page): QueryParams<Page>,
) -> Result<Json<Traces>, ApiError> {
    let limit = limited(page.limit)?;
    let traces = app
        .archive
        .list(&page.after, limit)
        .map_err(ApiError::disk)?;
    let next = traces
        .last()
        .filter(|_| traces.len() == limit)
        .map(|last| last.trace.clone());
    Ok(Json(Traces { traces, next }))
}

pub(super) fn limited(limit: usize) -> Result<usize, ApiError> {
    if (1..=PAGE).contains(&limit) {
        Ok(limit)
    } else {
        Err(ApiError::bad_request(
            "bad_parameter",
            format!("limit must be from 1 to {PAGE}"),
        ))
    }
}

/// Takes a trace in. It is there when the answer comes, and only if it is sound.
#[utoipa::path(put, path = "/api/traces/{trace}", tag = "traces",
    params(("trace" = String, Path, description = "Name without .mcap")),
    request_body(description = "The file", content_type = "application/octet-stream"),
    responses((status = 201, body = TraceFile), (status = 400, body = ErrorBody), (status = 409, body = ErrorBody),
        (status = 422, body = ErrorBody), (status = 507, body = ErrorBody)))]
pub(super) async fn upload(
    State(app): State<Arc<App>>,
    PathParams(trace): PathParams<String>,
    request: Request,
) -> Result<(StatusCode, Json<TraceFile>), ApiError> {
    let limit = (app.config.limits.upload_mib as u64) << 20;
    let file = app
        .archive
        .receive(
            &trace,
            limit,
            app.read_patience(),
            request.into_body().into_data_stream(),
        )
        .await?;
    Ok((StatusCode::CREATED, Json(file)))
}

/// The file, or a range of it.
#[utoipa::path(get, path = "/api/traces/{trace}", tag = "traces",
    params(("trace" = String, Path), ("range" = Option<String>, Header, description = "e.g. bytes=0-1023")),
    responses((status = 200, content_type = "application/octet-stream"),
        (status = 206, content_type = "application/octet-stream", headers(("content-range" = String))),
        (status = 400, body = ErrorBody), (status = 404, body = ErrorBody), (status = 409, body = ErrorBody),
        (status = 416, body = ErrorBody, headers(("content-range" = String)))))]
pub(super) async fn download(
    State(app): State<Arc<App>>,
    PathParams(trace): PathParams<String>,
    request: Request,
) -> Result<Response, ApiError> {
    let path = app.archive.existing(&trace)?;
    let mut file = tokio::fs::File::open(&path).await.map_err(ApiError::disk)?;
    let size = file.metadata().await.map_err(ApiError::disk)?.len();
    let asked = request
        .headers()
        .get(header::RANGE)
        .and_then(|range| range.to_str().ok());
    let range = match asked.map(|range| range_of(range, size)) {
        // A header that is no range of bytes is passed over, as the protocol wants.
        None | Some(RangeRequest::Nothing) => None,
        Some(RangeRequest::Part(from, to)) => Some((from, to)),
        Some(RangeRequest::Outside) => {
            let headers = [(header::CONTENT_RANGE, format!("bytes */{size}"))];
            return Ok((
                headers,
                ApiError::not_satisfiable(format!("{trace} has {size} bytes")),
            )
                .into_response());
        }
    };
    let (from, to) = range.unwrap_or((0, size.saturating_sub(1)));
    let length = if size == 0 { 0 } else { to - from + 1 };
    file.seek(std::io::SeekFrom::Start(from))
        .await
        .map_err(ApiError::disk)?;
    let body = Body::from_stream(ReaderStream::with_capacity(file.take(length), 1 << 16));
    let mut response = Response::new(body);
    let headers = response.headers_mut();
    headers.insert(
        header::CONTENT_TYPE,
        HeaderValue::from_static("application/octet-stream"),
    );
    headers.insert(header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    headers.insert(header::CONTENT_LENGTH, HeaderValue::from(length));
    let name = HeaderValue::try_from(format!("attachment; filename=\"{trace}.mcap\""));
    headers.insert(
        header::CONTENT_DISPOSITION,
        name.expect("names of traces are plain"),
    );
    if range.is_some() {
        let range = HeaderValue::try_from(format!("bytes {from}-{to}/{size}"));
        headers.insert(header::CONTENT_RANGE, range.expect("numbers are plain"));
        *response.status_mut() = StatusCode::PARTIAL_CONTENT;
    }
    Ok(response)
}

/// What a `Range` header asks.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum RangeRequest {
    /// Nothing that is one range of bytes.
    Nothing,
    /// From one byte to another, both included.
    Part(u64, u64),
    /// What is not there.
    Outside,
}

fn range_of(range: &str, size: u64) -> RangeRequest {
    let Some(range) = range.strip_prefix("bytes=") else {
        return RangeRequest::Nothing;
    };
    let Some((from, to)) = range.split_once('-') else {
        return RangeRequest::Nothing;
    };
    let number = |text: &str| text.trim().parse::<u64>();
    let (start, end) = match (number(from), number(to)) {
        (Ok(from), Ok(to)) if from <= to => (Bound::Included(from), to.min(size.saturating_sub(1))),
        (Ok(from), Err(_)) if to.trim().is_empty() => {
            (Bound::Included(from), size.saturating_sub(1))
        }
        (Err(_), Ok(0)) if from.trim().is_empty() => return RangeRequest::Outside,
        (Err(_), Ok(last)) if from.trim().is_empty() => (
            Bound::Included(size.saturating_sub(last)),
            size.saturating_sub(1),
        ),
        _ => return RangeRequest::Nothing,
    };
    match start {
        Bound::Included(from) if from < size => RangeRequest::Part(from, end),
        _ => RangeRequest::Outside,
    }
}

/// Deletes a trace. What the tables know of it stays.
#[utoipa::path(delete, path = "/api/traces/{trace}", tag = "traces",
    params(("trace" = String, Path)),
    responses((status = 204), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody), (status = 409, body = ErrorBody)))]
pub(super) async fn delete(
    State(app): State<Arc<App>>,
    PathParams(trace): PathParams<String>,
) -> Result<StatusCode, ApiError> {
    app.archive.delete(&trace).await?;
    tracing::info!(trace, "deleted");
    Ok(StatusCode::NO_CONTENT)
}

/// What a trace says of its episode: header, task, the state before the first call, end.
#[utoipa::path(get, path = "/api/traces/{trace}/episode", operation_id = "trace_episode", tag = "traces",
    params(("trace" = String, Path)),
    responses((status = 200, body = ref("#/components/schemas/TraceEpisode")), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 409, body = ErrorBody), (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn episode(
    State(app): State<Arc<App>>,
    PathParams(name): PathParams<String>,
) -> Result<Json<Value>, ApiError> {
    let answer = analyse(&app, move |app| {
        let trace = app.archive.read(&name)?;
        Ok(json!({
            "trace": name,
            "digest": trace.chain(),
            "header": trace.header,
            "task": *trace.task,
            "start": trace.start,
            "steps": trace.steps.len(),
            "images": trace.image_count(),
            "end": trace.end,
            "success": trace.end.as_ref().and_then(|end| end.success(&trace.task)),
            "open_reward": open_reward(Preset::parse(&trace.header.reward_preset).as_ref(), &trace),
        }))
    });
    answer.await.map(Json)
}

/// The scene that a trace plays in: rooms, walls, receptacles.
#[utoipa::path(get, path = "/api/traces/{trace}/scene", operation_id = "trace_scene", tag = "traces",
    params(("trace" = String, Path)),
    responses((status = 200, body = ref("#/components/schemas/Scene")), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 409, body = ErrorBody), (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn scene(
    State(app): State<Arc<App>>,
    PathParams(name): PathParams<String>,
) -> Result<Json<Value>, ApiError> {
    let answer = analyse(&app, move |app| Ok(json!(*app.archive.read(&name)?.scene)));
    answer.await.map(Json)
}

/// The episode as a glTF 2.0 binary: every surface of the scene, and the poses of what moves as an
/// animation in which second 0 is the start and second k + 1 the end of step k.
#[utoipa::path(get, path = "/api/traces/{trace}/scene.glb", operation_id = "trace_gltf", tag = "traces",
    params(("trace" = String, Path)),
    responses((status = 200, content_type = "model/gltf-binary"), (status = 400, body = ErrorBody),
        (status = 404, body = ErrorBody), (status = 409, body = ErrorBody), (status = 422, body = ErrorBody),
        (status = 503, body = ErrorBody)))]
pub(super) async fn gltf(
    State(app): State<Arc<App>>,
    PathParams(name): PathParams<String>,
) -> Result<Response, ApiError> {
    let answer = analyse(&app, move |app| {
        Ok(reel_view::glb(&app.archive.read(&name)?))
    });
    Ok(([(header::CONTENT_TYPE, "model/gltf-binary")], answer.await?).into_response())
}

/// What a recording shows of frames besides images.
#[cfg(feature = "rerun")]
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct RecordingLayers {
    /// depth, masks, or both with a comma between.
    layers: Option<String>,
}

/// The episode as a Rerun recording; `/rerun/?trace=NAME&step=N` opens it in the web viewer.
#[cfg(feature = "rerun")]
#[utoipa::path(get, path = "/api/traces/{trace}/rrd", operation_id = "trace_recording", tag = "traces",
    params(("trace" = String, Path), RecordingLayers),
    responses((status = 200, content_type = "application/octet-stream"), (status = 400, body = ErrorBody),
        (status = 404, body = ErrorBody), (status = 409, body = ErrorBody), (status = 422, body = ErrorBody),
        (status = 503, body = ErrorBody)))]
pub(super) async fn recording(
    State(app): State<Arc<App>>,
    PathParams(name): PathParams<String>,
    QueryParams(asked): QueryParams<RecordingLayers>,
) -> Result<Response, ApiError> {
    let layers = match &asked.layers {
        Some(layers) => FrameLayers::parse(layers)
            .map_err(|error| ApiError::bad_request("bad_layers", format!("layers: {error}")))?,
        None => FrameLayers::default(),
    };
    let answer = analyse(&app, move |app| {
        let recording = reel_view::rrd(&app.archive.read(&name)?, layers);
        recording.map_err(|error| ApiError::unprocessable("bad_trace", error.to_string()))
    });
    Ok(([(header::CONTENT_TYPE, crate::viewer::RRD)], answer.await?).into_response())
}

#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct Steps {
    /// From this step on.
    #[serde(default)]
    #[param(value_type = u64, maximum = 4_294_967_295_i64)]
    from: u32,
    /// At most so many, up to 1,000.
    #[serde(default = "page")]
    #[param(minimum = 1, maximum = 1000, default = 100)]
    limit: usize,
}

/// The steps of an episode, as they were recorded.
#[utoipa::path(get, path = "/api/traces/{trace}/steps", tag = "traces",
    params(("trace" = String, Path), Steps),
    responses((status = 200, body = ref("#/components/schemas/Steps")), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 409, body = ErrorBody), (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn steps(
    State(app): State<Arc<App>>,
    PathParams(name): PathParams<String>,
    QueryParams(asked): QueryParams<Steps>,
) -> Result<Json<Value>, ApiError> {
    let limit = limited(asked.limit)?;
    let answer = analyse(&app, move |app| {
        let trace = app.archive.read(&name)?;
        Ok(json!(
            trace
                .steps
                .iter()
                .skip(asked.from as usize)
                .take(limit)
                .collect::<Vec<_>>()
        ))
    });
    answer.await.map(Json)
}

/// Executes an episode again and compares every digest. The verdict goes to the table `verdicts`.
#[utoipa::path(post, path = "/api/traces/{trace}/replay", tag = "traces",
    params(("trace" = String, Path)),
    responses((status = 200, body = ref("#/components/schemas/ReplayVerdict")), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 409, body = ErrorBody), (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn replay(
    State(app): State<Arc<App>>,
    PathParams(name): PathParams<String>,
) -> Result<Json<Value>, ApiError> {
    let answer = analyse(&app, move |app| {
        let path = app.archive.existing(&name)?;
        let judged = reel_replay::verify_file(app.archive.files(), &path);
        let verdict = &judged.verdict;
        if let (None, Verdict::Refused { reason }) = (judged.trace, verdict) {
            return Err(ApiError::unprocessable("bad_trace", reason.clone()));
        }
        #[cfg(feature = "tables")]
        app.tables.keep(&judged);
        Ok(
            json!({"trace": name, "exact": verdict.is_exact(), "verdict": verdict.name(), "message": verdict.to_string()}),
        )
    });
    answer.await.map(Json)
}

/// Another future of an episode.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct BranchBody {
    /// The call at which it branches off, from 0.
    at: usize,
    /// The calls that come there: tool name and arguments.
    #[serde(default)]
    #[schema(value_type = Vec<Object>)]
    calls: Vec<ToolCall>,
    /// A built-in policy that goes on after them, e.g. `planner`.
    policy: Option<String>,
    /// Its seed; without it that of the episode.
    #[schema(format = "uint64")]
    seed: Option<u64>,
    /// Go on with the parent's calls from this one on instead.
    parent_from: Option<usize>,
    /// Name of the new trace.
    #[schema(pattern = "^[A-Za-z0-9][A-Za-z0-9_.-]{0,199}$")]
    name: String,
}

/// Plays another future of an episode, from any call, into a trace of its own.
#[utoipa::path(post, path = "/api/traces/{trace}/branches", tag = "traces",
    params(("trace" = String, Path)), request_body = BranchBody,
    responses((status = 201, body = ref("#/components/schemas/Branch")), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 409, body = ErrorBody), (status = 422, body = ErrorBody), (status = 503, body = ErrorBody),
        (status = 507, body = ErrorBody)))]
pub(super) async fn branch(
    State(app): State<Arc<App>>,
    PathParams(name): PathParams<String>,
    JsonBody(body): JsonBody<BranchBody>,
) -> Result<(StatusCode, Json<Value>), ApiError> {
    let answer = analyse(&app, move |app| {
        let wrong = |message: String| ApiError::unprocessable("bad_branch", message);
        let parent = app.archive.read(&name)?;
        let path = app.archive.path(&body.name)?;
        let taken = || {
            ApiError::conflict(
                "exists",
                format!("trace {} exists already; choose another name", body.name),
            )
        };
        if app.archive.is_taken(&path).map_err(ApiError::disk)? {
            return Err(taken());
        }
        let continuation = match (body.policy, body.parent_from) {
            (Some(_), Some(_)) => return Err(wrong("policy or parent_from, not both".to_owned())),
            (Some(name), None) => Continuation::Policy {
                name,
                seed: body.seed.unwrap_or(parent.header.seed),
            },
            (None, Some(from)) => Continuation::Parent(from),
            (None, None) if body.calls.is_empty() => {
                return Err(wrong(
                    "say what comes: calls, policy or parent_from".to_owned(),
                ));
            }
            (None, None) => Continuation::Stop,
        };
        let images = if parent.image_count() > 0 {
            Images::Full
        } else {
            Images::None
        };
        let record = RecordTo {
            path: path.clone(),
            options: RecordOptions::from(images),
        };
        let branch = Branch {
            calls: body.calls,
            continuation,
        };
        let report = reel_counterfactual::branch::fork(&parent, body.at, None)
            .and_then(|fork| branch.play(&fork, Some(&record)));
        let report = report.map_err(|error| match of_trace(&error) {
            Some(TraceError::PartExists { .. }) => taken(),
            Some(refused) if let Some((_, cause)) = refused.refused() => {
                let code = cause.raw_os_error().map(std::io::Error::from_raw_os_error);
                ApiError::disk(code.unwrap_or_else(|| cause.kind().into()))
            }
            _ => wrong(error.to_string()),
        })?;
        let made = Trace::read(&path).map_err(|error| wrong(error.to_string()))?;
        Ok(json!({
            "trace": body.name, "episode_id": report.episode_id, "parent": made.header.parent, "length": report.length,
            "success": report.success, "completion": report.completion, "total_reward": report.total_reward,
            "end_reason": report.end_reason,
        }))
    });
    answer.await.map(|made| (StatusCode::CREATED, Json(made)))
}

/// What was wrong with writing the trace of a branch, if that was it.
fn of_trace(error: &BranchError) -> Option<&TraceError> {
    match error {
        BranchError::Agent(AgentError::Trace { source, .. }) => source.downcast_ref(),
        _ => None,
    }
}

#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct BlameQuery {
    /// Whether the better future is played as well.
    #[serde(default)]
    alternative: bool,
}

/// Why an episode failed, measured: what every step cost, the decisive one, and what
/// would have been better.
#[utoipa::path(get, path = "/api/traces/{trace}/blame", tag = "traces",
    params(("trace" = String, Path), BlameQuery),
    responses((status = 200, body = ref("#/components/schemas/Blame")), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 409, body = ErrorBody), (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn blame(
    State(app): State<Arc<App>>,
    PathParams(name): PathParams<String>,
    QueryParams(asked): QueryParams<BlameQuery>,
) -> Result<Json<Value>, ApiError> {
    let answer = analyse(&app, move |app| {
        let path = app.archive.existing(&name)?;
        let options = BlameOptions {
            alternatives: asked.alternative,
            ..BlameOptions::default()
        };
        let measured =
            reel_counterfactual::blame::blame_all(app.archive.files(), &[path], 1, &options, || ())
                .pop();
        let measured = measured.unwrap_or_else(|| Err("nothing was measured".to_owned()));
        let mut value =
            json!(measured.map_err(|error| ApiError::unprocessable("bad_trace", error))?);
        value["trace"] = json!(name);
        Ok(value)
    });
    answer.await.map(Json)
}

#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct RewardQuery {
    /// A built-in preset; without it the one the episode was recorded under.
    preset: Option<String>,
}

/// The rewards of an episode under a preset, term by term.
#[utoipa::path(get, path = "/api/traces/{trace}/reward", tag = "traces",
    params(("trace" = String, Path), RewardQuery),
    responses((status = 200, body = ref("#/components/schemas/RewardReport")), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 409, body = ErrorBody), (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn reward(
    State(app): State<Arc<App>>,
    PathParams(name): PathParams<String>,
    QueryParams(asked): QueryParams<RewardQuery>,
) -> Result<Json<Value>, ApiError> {
    let answer = analyse(&app, move |app| {
        let trace = app.archive.read(&name)?;
        let wanted = asked
            .preset
            .unwrap_or_else(|| trace.header.reward_preset.clone());
        let preset = Preset::parse(&wanted).ok_or_else(|| {
            let known = Preset::built_in()
                .map(|preset| preset.name().to_owned())
                .join("', '");
            ApiError::unprocessable(
                "unknown_preset",
                format!("no preset is called '{wanted}'; built in are '{known}'"),
            )
        })?;
        let mut rewarder = preset.rewarder(&trace.task, &trace.scene);
        rewarder.start(&trace.start);
        let steps: Vec<Value> = trace
            .steps
            .iter()
            .map(|step| {
                let terms = rewarder.step(step);
                json!({"step": step.step, "total": terms.iter().map(|term| term.value).sum::<f64>(), "terms": terms})
            })
            .collect();
        let total: f64 = steps.iter().filter_map(|step| step["total"].as_f64()).sum();
        Ok(
            json!({"trace": name, "preset": preset.name(), "version": preset.version(), "total": total, "steps": steps,
                "open_reward": open_reward(Some(&preset), &trace)}),
        )
    });
    answer.await.map(Json)
}

/// What the record leaves open of the reward under a preset, in a sentence. None also where the
/// preset is not known: no trace holds one that was a file.
fn open_reward(preset: Option<&Preset>, trace: &Trace) -> Option<String> {
    let open = reel_reward::open_reward_of_record(
        preset?,
        &trace.header,
        &trace.task,
        &trace.scene,
        &trace.start,
        &trace.steps,
    )?;
    Some(open.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_what_the_protocol_says() {
        let cases = [
            ("bytes=0-9", RangeRequest::Part(0, 9)),
            ("bytes=90-", RangeRequest::Part(90, 99)),
            ("bytes=-10", RangeRequest::Part(90, 99)),
            ("bytes=-1000", RangeRequest::Part(0, 99)),
            ("bytes=50-1000", RangeRequest::Part(50, 99)),
            ("bytes=100-", RangeRequest::Outside),
            ("bytes=-0", RangeRequest::Outside),
            ("bytes=9-0", RangeRequest::Nothing),
            ("bytes=0-1,3-4", RangeRequest::Nothing),
            ("bytes=-", RangeRequest::Nothing),
            ("items=0-1", RangeRequest::Nothing),
        ];
        for (range, expected) in cases {
            assert_eq!(range_of(range, 100), expected, "{range}");
        }
        assert_eq!(range_of("bytes=0-0", 0), RangeRequest::Outside);
    }
}
