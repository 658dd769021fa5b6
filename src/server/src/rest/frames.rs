//! Frames of recorded episodes: the image, depth or instance masks at any step, from any camera.

use std::sync::Arc;

use axum::{
    Json,
    extract::State,
    http::{StatusCode, header},
    response::{IntoResponse, Response},
};
use reel_replay::{Viewpoint, view_at};
use reel_trace::{Trace, encode_png, encode_png16};
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame};
use serde::Deserialize;
use serde_json::{Value, json};
use utoipa::{IntoParams, ToSchema};

use super::{
    ApiError, analyse,
    error::ErrorBody,
    extract::{PathParams, QueryParams},
};
use crate::service::App;

#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct Camera {
    /// head (what the agent saw), top-down, follow:OBJECT (an instance, asset or category of the
    /// task, or target), or free.
    #[serde(default = "head")]
    #[param(default = "head")]
    camera: String,
    /// With the free camera: where it is, x,y,z in metres in the scene's frame.
    eye: Option<String>,
    /// With the free camera: what it looks at.
    look_at: Option<String>,
    /// Layer of the frame: rgb (the image); depth (16-bit gray, millimetres along the optical axis, 0 where nothing
    /// is); masks (16-bit gray, the ids of `/api/traces/{trace}/instances`).
    #[serde(default)]
    #[param(inline)]
    layer: Layer,
}

impl Camera {
    /// The image that the agent saw.
    fn of_the_agent() -> Self {
        Self {
            camera: head(),
            eye: None,
            look_at: None,
            layer: Layer::Rgb,
        }
    }
}

/// What is answered where there is no image.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct Absence {
    /// Whether an episode whose images were not recorded and cannot be drawn (a robot's, say) is
    /// answered with 204 and no body instead of 422: for lists, which show an image if there is one.
    #[serde(default)]
    #[param(default = false)]
    if_any: bool,
}

/// What of a frame is shown.
#[derive(Clone, Copy, PartialEq, Eq, Default, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Layer {
    /// The image that the agent saw, or that the camera sees.
    #[default]
    Rgb,
    /// 16-bit depth in millimetres.
    Depth,
    /// Instance ids, 16 bits a pixel.
    Masks,
}

fn head() -> String {
    "head".to_owned()
}

/// A frame of a trace that somebody asked for.
pub(crate) struct FrameRequest<'a> {
    app: &'a App,
    trace: Trace,
    /// The step after which it is; `None` is the start.
    step: Option<u32>,
    viewpoint: Viewpoint,
    layer: Layer,
}

impl<'a> FrameRequest<'a> {
    /// Reads the trace and checks what is asked: `step` is `start` or the number of a step.
    pub(crate) fn new(
        app: &'a App,
        trace: &str,
        step: &str,
        camera: &Camera,
    ) -> Result<Self, ApiError> {
        let step = match step {
            "start" => None,
            number => Some(number.parse::<u32>().map_err(|_| {
                ApiError::bad_request("bad_path", "the step of a frame is 'start' or a number")
            })?),
        };
        let read = app.archive.read(trace)?;
        if step.is_some_and(|step| step as usize >= read.steps.len()) {
            return Err(ApiError::not_found(format!(
                "{trace} has {} steps",
                read.steps.len()
            )));
        }
        let viewpoint = Viewpoint::named(
            &camera.camera,
            camera.eye.as_deref(),
            camera.look_at.as_deref(),
            &read.task,
        );
        let viewpoint =
            viewpoint.map_err(|error| ApiError::bad_request("bad_camera", error.to_string()))?;
        Ok(Self {
            app,
            trace: read,
            step,
            viewpoint,
            layer: camera.layer,
        })
    }

    /// The frame, drawn by executing the episode up to there.
    fn drawn(&self) -> Result<Frame, ApiError> {
        let cache = Some(self.app.snapshots.cache());
        view_at(&self.trace, self.step, &self.viewpoint, cache)
            .map_err(|verdict| ApiError::not_executed(&verdict))
    }

    /// The layer that was asked for, as PNG. What was recorded is not drawn again.
    pub(crate) fn png(&self) -> Result<Vec<u8>, ApiError> {
        let is_head = self.viewpoint == Viewpoint::Head;
        let (trace, step) = (&self.trace, self.step);
        let (width, height) = (FRAME_WIDTH as u32, FRAME_HEIGHT as u32);
        Ok(match self.layer {
            Layer::Rgb => {
                let recorded = is_head.then(|| trace.frame_rgb(step).ok().flatten());
                let rgb = recorded
                    .flatten()
                    .map_or_else(|| self.drawn().map(|frame| frame.rgb), Ok)?;
                encode_png(&rgb, width, height)
            }
            Layer::Depth => {
                let recorded = is_head.then(|| trace.depth_mm(step).ok().flatten());
                let depth = recorded
                    .flatten()
                    .map_or_else(|| self.drawn().map(|frame| frame.depth_mm), Ok)?;
                encode_png16(&depth, width, height)
            }
            Layer::Masks => {
                let recorded = is_head.then(|| trace.instance_ids(step).ok().flatten());
                let ids = recorded
                    .flatten()
                    .map_or_else(|| self.drawn().map(|frame| frame.ids), Ok)?;
                encode_png16(&ids, width, height)
            }
        })
    }

    /// What stands in the frame: each instance with its pixels and its depth in millimetres
    /// (least, median and greatest), the largest first.
    #[cfg(feature = "tables")]
    pub(crate) fn visible(&self) -> Result<Vec<Value>, ApiError> {
        let frame = self.drawn()?;
        let mut depths: std::collections::BTreeMap<u16, Vec<u16>> =
            std::collections::BTreeMap::new();
        for (id, depth) in frame.ids.iter().zip(&frame.depth_mm) {
            depths.entry(*id).or_default().push(*depth);
        }
        let known = reel_world::instances(&self.trace.task, &self.trace.scene);
        let mut seen: Vec<(usize, Value)> = known
            .iter()
            .filter_map(|instance| {
                let depth = depths.get_mut(&instance.id)?;
                depth.sort_unstable();
                let mut value = json!(instance);
                value["pixels"] = json!(depth.len());
                value["depth_mm"] =
                    json!([depth[0], depth[depth.len() / 2], depth[depth.len() - 1]]);
                Some((depth.len(), value))
            })
            .collect();
        seen.sort_by_key(|(pixels, _)| std::cmp::Reverse(*pixels));
        Ok(seen.into_iter().map(|(_, value)| value).collect())
    }
}

/// An image of the episode as PNG, drawn by going there: `start`, or the number of a step.
#[utoipa::path(get, path = "/api/traces/{trace}/frames/{step}", tag = "traces",
    params(("trace" = String, Path), ("step" = String, Path, description = "start, or the number of a step"), Camera, Absence),
    responses((status = 200, content_type = "image/png"), (status = 204, description = "No image, where if_any asks so"), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 409, body = ErrorBody), (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn frame(
    State(app): State<Arc<App>>,
    PathParams((name, moment)): PathParams<(String, String)>,
    QueryParams(camera): QueryParams<Camera>,
    QueryParams(absence): QueryParams<Absence>,
) -> Result<Response, ApiError> {
    let drawn = analyse(&app, move |app| {
        let step = moment.strip_suffix(".png").unwrap_or(&moment);
        FrameRequest::new(app, &name, step, &camera)?.png()
    });
    match drawn.await {
        Ok(png) => Ok(([(header::CONTENT_TYPE, "image/png")], png).into_response()),
        Err(error) if absence.if_any && error.is_not_executed() => {
            Ok(StatusCode::NO_CONTENT.into_response())
        }
        Err(error) => Err(error),
    }
}

/// Where the numbers of the current markers are in the image that the agent saw: of each its
/// bounding box and that of its label, x and y of the first and of the last pixel. Empty where none
/// is drawn. The image is drawn again, by going there.
#[utoipa::path(get, path = "/api/traces/{trace}/frames/{step}/markers", tag = "traces",
    params(("trace" = String, Path), ("step" = String, Path, description = "start, or the number of a step")),
    responses((status = 200, body = ref("#/components/schemas/MarkerBoxes")), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 409, body = ErrorBody), (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn markers(
    State(app): State<Arc<App>>,
    PathParams((name, step)): PathParams<(String, String)>,
) -> Result<Json<Value>, ApiError> {
    let drawn = analyse(&app, move |app| {
        let frame = FrameRequest::new(app, &name, &step, &Camera::of_the_agent())?.drawn()?;
        Ok(json!(frame.marker_boxes))
    });
    drawn.await.map(Json)
}

/// What the instance ids in masks of an episode stand for.
#[utoipa::path(get, path = "/api/traces/{trace}/instances", operation_id = "trace_instances", tag = "traces",
    params(("trace" = String, Path)),
    responses((status = 200, body = ref("#/components/schemas/Instances")), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 409, body = ErrorBody), (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn instances(
    State(app): State<Arc<App>>,
    PathParams(name): PathParams<String>,
) -> Result<Json<Value>, ApiError> {
    let answer = analyse(&app, move |app| {
        let trace = app.archive.read(&name)?;
        Ok(json!(reel_world::instances(&trace.task, &trace.scene)))
    });
    answer.await.map(Json)
}
