//! Training sets that lie in `exports` of the data folder: what they are, what a row looks like to
//! the model, what is wrong.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
    time::UNIX_EPOCH,
};

use axum::{Json, extract::State};
use base64::{Engine as _, prelude::BASE64_STANDARD};
use reel_dataset::lint::{Dataset, Example, Image, LintOptions, Part, Turn, image_bytes, lint};
use reel_live::check_name;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use utoipa::{IntoParams, ToSchema};

use super::{
    ApiError, analyse,
    error::ErrorBody,
    extract::{PathParams, QueryParams},
};
use crate::service::App;

/// What an export writes last.
const MANIFEST: &str = "manifest.json";
/// Most examples of an answer: they come with their images.
const EXAMPLES_MAX: usize = 20;

/// A finished training set: its files, its manifest and its card.
#[derive(Serialize, ToSchema)]
pub(super) struct Export {
    /// Name of its folder.
    name: String,
    /// When it was finished, in seconds since 1970.
    created: u64,
    /// Size of its files, images included.
    bytes: u64,
    /// What it says of itself: format, options, counts, table version.
    #[schema(value_type = Object)]
    manifest: Value,
    /// Its card in Markdown; in lists it is left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    card: Option<String>,
}

/// The finished training sets, the newest first.
#[utoipa::path(get, path = "/api/exports", operation_id = "list_exports", tag = "tables",
    responses((status = 200, body = Vec<Export>), (status = 503, body = ErrorBody)))]
pub(super) async fn list(State(app): State<Arc<App>>) -> Result<Json<Vec<Export>>, ApiError> {
    let found = analyse(&app, |app| {
        let folders = fs::read_dir(app.config.exports())
            .into_iter()
            .flatten()
            .flatten();
        let mut found: Vec<Export> = folders.filter_map(|entry| export(&entry.path())).collect();
        found.sort_by(|a, b| b.created.cmp(&a.created).then_with(|| a.name.cmp(&b.name)));
        Ok(found)
    });
    found.await.map(Json)
}

/// A training set, with its card.
#[utoipa::path(get, path = "/api/exports/{export}", operation_id = "show_export", tag = "tables",
    params(("export" = String, Path)),
    responses((status = 200, body = Export), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 503, body = ErrorBody)))]
pub(super) async fn show(
    State(app): State<Arc<App>>,
    PathParams(name): PathParams<String>,
) -> Result<Json<Export>, ApiError> {
    let found = analyse(&app, move |app| {
        let folder = existing(app, &name)?;
        let card = fs::read_to_string(folder.join("README.md"))
            .ok()
            .map(|card| app.archive.redact_path(&card));
        Ok(Export {
            card,
            ..export(&folder).ok_or_else(|| unknown(&name))?
        })
    });
    found.await.map(Json)
}

#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct Rows {
    /// From this example on, over all files.
    #[serde(default)]
    #[param(maximum = 1_000_000_000)]
    from: usize,
    /// At most so many, up to 20.
    #[serde(default = "few")]
    #[param(minimum = 1, maximum = 20, default = 5)]
    limit: usize,
}

fn few() -> usize {
    5
}

/// Examples as the model sees them: turns of texts, calls and images (as `data:` URIs).
#[utoipa::path(get, path = "/api/exports/{export}/examples", tag = "tables",
    params(("export" = String, Path), Rows),
    responses((status = 200, body = ref("#/components/schemas/Examples")), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn examples(
    State(app): State<Arc<App>>,
    PathParams(name): PathParams<String>,
    QueryParams(rows): QueryParams<Rows>,
) -> Result<Json<Vec<Value>>, ApiError> {
    if !(1..=EXAMPLES_MAX).contains(&rows.limit) {
        return Err(ApiError::bad_request(
            "bad_parameter",
            format!("limit must be from 1 to {EXAMPLES_MAX}"),
        ));
    }
    let found = analyse(&app, move |app| {
        let dataset = open(app, &name)?;
        let rows = dataset
            .rows()
            .skip(rows.from)
            .take(rows.limit)
            .zip(rows.from..);
        Ok(rows
            .map(|(row, number)| {
                row.map_or_else(
                    |error| json!({"number": number, "error": error.to_string()}),
                    shown,
                )
            })
            .collect())
    });
    found.await.map(Json)
}

/// What is wrong with a training set: leaks, contradictions, duplicates,
/// bad labels, missing images.
#[utoipa::path(get, path = "/api/exports/{export}/lint", tag = "tables",
    params(("export" = String, Path)),
    responses((status = 200, body = ref("#/components/schemas/Lint")), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn findings(
    State(app): State<Arc<App>>,
    PathParams(name): PathParams<String>,
) -> Result<Json<Value>, ApiError> {
    let found = analyse(&app, move |app| {
        let report = lint(&open(app, &name)?, &LintOptions::default(), |_| ());
        let text = serde_json::to_string(&report)
            .map_err(|_| ApiError::internal("the report cannot be written"))?;
        serde_json::from_str(&app.archive.redact_path(&text))
            .map_err(|_| ApiError::internal("the report cannot be written"))
    });
    found.await.map(Json)
}

fn unknown(name: &str) -> ApiError {
    ApiError::not_found(format!(
        "unknown export '{name}'; start a job of kind 'export'"
    ))
}

fn existing(app: &App, name: &str) -> Result<PathBuf, ApiError> {
    check_name(name)?;
    let folder = app.config.exports().join(name);
    if folder.join(MANIFEST).is_file() {
        Ok(folder)
    } else {
        Err(unknown(name))
    }
}

fn open(app: &App, name: &str) -> Result<Dataset, ApiError> {
    let opened = Dataset::open(&[existing(app, name)?], None, None);
    opened.map_err(|error| ApiError::unprocessable("bad_export", error.to_string()))
}

/// A training set; none where it is not finished.
fn export(folder: &Path) -> Option<Export> {
    let file = folder.join(MANIFEST);
    let created = fs::metadata(&file)
        .ok()?
        .modified()
        .ok()?
        .duration_since(UNIX_EPOCH)
        .ok()?
        .as_secs();
    let mut manifest: Value = serde_json::from_slice(&fs::read(&file).ok()?).ok()?;
    // How it was made names paths of this machine; its files are many, and not for people.
    manifest
        .as_object_mut()?
        .retain(|key, _| key != "command" && key != "files");
    if let Some(options) = manifest.get_mut("options").and_then(Value::as_object_mut) {
        options.remove("command");
    }
    let name = folder.file_name()?.to_str()?.to_owned();
    Some(Export {
        name,
        created,
        bytes: bytes_in(folder),
        manifest,
        card: None,
    })
}

fn bytes_in(folder: &Path) -> u64 {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let size = |entry: fs::DirEntry| match entry.metadata() {
        Ok(found) if found.is_dir() => bytes_in(&entry.path()),
        Ok(found) => found.len(),
        Err(_) => 0,
    };
    entries.map(size).sum()
}

fn shown(example: Example) -> Value {
    let part = |part: &Part| match part {
        Part::Text(text) => json!({"text": text}),
        Part::Image(number) => json!({"image": number}),
        Part::Call(call) => json!({"call": {"name": call.name, "arguments": call.arguments}}),
    };
    let shown = |turn: &Turn, learned: bool| {
        let parts: Vec<Value> = turn.parts.iter().map(part).collect();
        json!({"role": turn.role.as_str(), "learned": learned, "parts": parts})
    };
    let turns = example.turns.iter();
    let turns: Vec<Value> = turns
        .map(|turn| shown(turn, turn.role.is_answer()))
        .collect();
    let rejected = example.rejected.iter();
    let rejected: Vec<Value> = rejected.map(|turn| shown(turn, false)).collect();
    json!({
        "number": example.location.index, "split": example.split, "turns": turns, "rejected": rejected, "tools": example.tools,
        "images": example.images.iter().map(data_uri).collect::<Vec<_>>(), "meta": example.meta,
        "warnings": example.warnings.iter().map(|warning| &warning.message).collect::<Vec<_>>(),
    })
}

/// An image as text; null where it is not there.
fn data_uri(image: &Image) -> Option<String> {
    let bytes = image_bytes(image)?;
    let kind = match &bytes[..] {
        [0x89, b'P', b'N', b'G', ..] => "png",
        [0xff, 0xd8, ..] => "jpeg",
        _ => "webp",
    };
    Some(format!(
        "data:image/{kind};base64,{}",
        BASE64_STANDARD.encode(&bytes)
    ))
}
