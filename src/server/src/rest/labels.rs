//! What people say about episodes: labels of failures, and stars, tags and comments on any.

use std::sync::Arc;

use axum::{Json, extract::State, http::StatusCode};
use reel_query::Parameters;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio::process::Command;
use utoipa::{IntoParams, ToSchema};

use super::{
    ApiError, analyse,
    error::ErrorBody,
    extract::{Body, PathParams, QueryParams},
    tables::rows,
    told,
};
use crate::{gate, service::App};

/// Longest text of a label: it goes through a command line.
const TEXT_BYTES: usize = 16 << 10;

#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct LabelFilter {
    /// Only those of this episode.
    episode: Option<String>,
}

/// Labels of all episodes, or only those of one episode.
#[utoipa::path(get, path = "/api/labels", operation_id = "list_labels", tag = "tables", params(LabelFilter),
    responses((status = 200, body = Vec<Object>), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn list(
    State(app): State<Arc<App>>,
    QueryParams(which): QueryParams<LabelFilter>,
) -> Result<Json<Value>, ApiError> {
    let labels = analyse(&app, move |app| match which.episode {
        Some(id) => {
            let parameters = Parameters::from([("id".to_owned(), id)]);
            rows(
                app,
                "SELECT * FROM labels WHERE episode_id = $id ORDER BY author",
                &parameters,
            )
        }
        None => rows(
            app,
            "SELECT * FROM labels ORDER BY episode_id, author",
            &Parameters::new(),
        ),
    });
    labels.await.map(|labels| Json(json!(labels)))
}

/// A label by which an author classifies an episode's failure.
#[derive(Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct LabelBody {
    /// The episode's id; its beginning is enough where it is unique.
    episode: String,
    /// Object Confusion, Key Action Missing, Lost Memory or Other; follows from a known sub-class.
    class: Option<String>,
    /// What within the class.
    sub_class: Option<String>,
    /// Index of the decisive step in the episode, from 0.
    #[schema(minimum = 0)]
    step: Option<i32>,
    /// How sure, from 0 to 1.
    #[schema(minimum = 0, maximum = 1)]
    confidence: Option<f64>,
    /// Reason for the label, in free text.
    note: Option<String>,
    /// Who says so; with tokens, whose token it is counts.
    author: Option<String>,
    /// Whether this label decides between other labels that disagree.
    #[serde(default)]
    adjudicate: bool,
    /// Whether the author answered before seeing what the rules and `reel blame` say; null: unknown.
    blind: Option<bool>,
}

/// Stores the label of an episode in the tables.
#[utoipa::path(post, path = "/api/labels", tag = "tables", request_body = LabelBody,
    responses((status = 201, body = LabelBody), (status = 400, body = ErrorBody), (status = 422, body = ErrorBody)))]
pub(super) async fn set(
    State(app): State<Arc<App>>,
    Body(label): Body<LabelBody>,
) -> Result<(StatusCode, Json<Value>), ApiError> {
    let author = author(label.author.as_ref())?;
    let texts = [
        ("class", label.class.clone()),
        ("sub-class", label.sub_class.clone()),
        ("step", label.step.map(|step| step.to_string())),
        ("confidence", label.confidence.map(|sure| sure.to_string())),
        ("note", label.note.clone()),
        ("author", Some(author.clone())),
        ("blind", label.blind.map(|blind| blind.to_string())),
    ];
    let flag = label.adjudicate.then_some("--adjudicate");
    keep(&app, ["label", "set"], &label.episode, &texts, flag).await?;
    let mut kept = json!(label);
    kept["author"] = json!(author);
    Ok((StatusCode::CREATED, Json(kept)))
}

/// Whose labels are removed.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct LabelAuthor {
    /// Author of the labels; with tokens, whose token it is counts.
    author: Option<String>,
}

/// Removes the labels of an episode by one author, one that adjudicates too.
#[utoipa::path(delete, path = "/api/labels/{episode}", operation_id = "remove_labels", tag = "tables",
    params(("episode" = String, Path, description = "Id of the episode; its beginning is enough where it is unique"), LabelAuthor),
    responses((status = 204), (status = 400, body = ErrorBody), (status = 422, body = ErrorBody)))]
pub(super) async fn remove(
    State(app): State<Arc<App>>,
    PathParams(episode): PathParams<String>,
    QueryParams(of): QueryParams<LabelAuthor>,
) -> Result<StatusCode, ApiError> {
    let texts = [("author", Some(author(of.author.as_ref())?))];
    keep(&app, ["label", "remove"], &episode, &texts, None).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// What an author says about an answer of the user to `ask`.
#[derive(Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct AnswerLabelBody {
    /// The episode's id; its beginning is enough where it is unique.
    episode: String,
    /// The `ask` that was answered, counted from 0.
    #[schema(minimum = 0)]
    step: i32,
    /// `faithful` (right, and enough to go on), `unfaithful` (wrong) or `unclear` (not enough to
    /// tell).
    label: String,
    /// Reason for the label, in free text.
    note: Option<String>,
    /// Who says so; with tokens, whose token it is counts.
    author: Option<String>,
}

/// Stores the label of an answer in the tables.
#[utoipa::path(post, path = "/api/answer-labels", operation_id = "label_answer", tag = "tables", request_body = AnswerLabelBody,
    responses((status = 201, body = AnswerLabelBody), (status = 400, body = ErrorBody), (status = 422, body = ErrorBody)))]
pub(super) async fn answer(
    State(app): State<Arc<App>>,
    Body(label): Body<AnswerLabelBody>,
) -> Result<(StatusCode, Json<Value>), ApiError> {
    let author = author(label.author.as_ref())?;
    let texts = [
        ("as", Some(label.label.clone())),
        ("step", Some(label.step.to_string())),
        ("note", label.note.clone()),
        ("author", Some(author.clone())),
    ];
    keep(&app, ["label", "answer"], &label.episode, &texts, None).await?;
    let mut kept = json!(label);
    kept["author"] = json!(author);
    Ok((StatusCode::CREATED, Json(kept)))
}

/// Stars, tags and comments of all episodes, or only those of one episode, the oldest first.
#[utoipa::path(get, path = "/api/remarks", operation_id = "list_remarks", tag = "tables", params(LabelFilter),
    responses((status = 200, body = Vec<Object>), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn remarks(
    State(app): State<Arc<App>>,
    QueryParams(which): QueryParams<LabelFilter>,
) -> Result<Json<Value>, ApiError> {
    let remarks = analyse(&app, move |app| {
        let (condition, parameters) = match which.episode {
            Some(id) => (
                "WHERE episode_id = $id",
                Parameters::from([("id".to_owned(), id)]),
            ),
            None => ("", Parameters::new()),
        };
        let sql = format!("SELECT * FROM remarks {condition} ORDER BY at_ms, author, kind, text");
        rows(app, &sql, &parameters)
    });
    remarks.await.map(|remarks| Json(json!(remarks)))
}

/// The three kinds of remarks that people make on episodes.
#[derive(Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(super) enum RemarkKind {
    /// Marks the episode, to find it again.
    Star,
    /// Puts the episode with others of the same tag.
    Tag,
    /// Says something about the episode or one of its steps.
    Comment,
}

impl RemarkKind {
    fn name(self) -> &'static str {
        match self {
            RemarkKind::Star => "star",
            RemarkKind::Tag => "tag",
            RemarkKind::Comment => "comment",
        }
    }
}

/// A star, tag or comment of a person on an episode.
#[derive(Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct RemarkBody {
    /// The episode's id; its beginning is enough where it is unique.
    episode: String,
    /// Whether it is a star, a tag or a comment.
    kind: RemarkKind,
    /// The tag (1 to 60 characters without a comma) or the comment (1 to 4000); a star has none.
    text: Option<String>,
    /// The step that a comment is about, counted from 0; without it the whole episode.
    #[schema(minimum = 0)]
    step: Option<i32>,
    /// Who says so; with tokens, whose token it is counts.
    author: Option<String>,
}

/// Stores a star, tag or comment in the tables; what is there already stays as it is.
#[utoipa::path(post, path = "/api/remarks", tag = "tables", request_body = RemarkBody,
    responses((status = 201, body = RemarkBody), (status = 400, body = ErrorBody), (status = 422, body = ErrorBody)))]
pub(super) async fn remark(
    State(app): State<Arc<App>>,
    Body(remark): Body<RemarkBody>,
) -> Result<(StatusCode, Json<Value>), ApiError> {
    let author = author(remark.author.as_ref())?;
    let refused = |text: &str| ApiError::unprocessable("bad_remark", text.to_owned());
    let text = remark.text.clone().unwrap_or_default();
    match remark.kind {
        RemarkKind::Star if !text.is_empty() => return Err(refused("a star has no text")),
        RemarkKind::Star | RemarkKind::Tag if remark.step.is_some() => {
            return Err(refused("only a comment is about a step"));
        }
        _ => {}
    }
    let texts = [
        (
            "text",
            Some(text).filter(|_| !matches!(remark.kind, RemarkKind::Star)),
        ),
        ("step", remark.step.map(|step| step.to_string())),
        ("author", Some(author.clone())),
    ];
    let action = ["remark", remark.kind.name()];
    keep(&app, action, &remark.episode, &texts, None).await?;
    let mut kept = json!(remark);
    kept["author"] = json!(author);
    Ok((StatusCode::CREATED, Json(kept)))
}

/// Which remark is taken back.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct RemarkFilter {
    /// Author of the remark; with tokens, whose token it is counts.
    author: Option<String>,
    /// Whether it is a star, a tag or a comment.
    kind: RemarkKind,
    /// The tag or the comment; a star has none.
    #[serde(default)]
    text: String,
    /// The step that the comment is about.
    step: Option<i32>,
}

/// Takes one star, tag or comment back.
#[utoipa::path(delete, path = "/api/remarks/{episode}", operation_id = "remove_remark", tag = "tables",
    params(("episode" = String, Path, description = "Id of the episode; its beginning is enough where it is unique"), RemarkFilter),
    responses((status = 204), (status = 400, body = ErrorBody), (status = 422, body = ErrorBody)))]
pub(super) async fn take_back(
    State(app): State<Arc<App>>,
    PathParams(episode): PathParams<String>,
    QueryParams(of): QueryParams<RemarkFilter>,
) -> Result<StatusCode, ApiError> {
    let texts = [
        ("kind", Some(of.kind.name().to_owned())),
        ("text", Some(of.text)),
        ("step", of.step.map(|step| step.to_string())),
        ("author", Some(author(of.author.as_ref())?)),
    ];
    keep(&app, ["remark", "remove"], &episode, &texts, None).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Who labels: whose token it is, else who the request says it is.
fn author(said: Option<&String>) -> Result<String, ApiError> {
    let author = gate::owner()
        .name()
        .map(str::to_owned)
        .or_else(|| said.cloned());
    let author = author.filter(|author| !author.trim().is_empty());
    author.ok_or_else(|| {
        ApiError::unprocessable(
            "no_author",
            "nobody is named who says so; set `author`".to_owned(),
        )
    })
}

/// Runs `reel store label` or `reel store remark`: the command knows what may be said, and the tables
/// take one writer at a time.
async fn keep(
    app: &App,
    what: [&str; 2],
    episode: &String,
    texts: &[(&str, Option<String>)],
    flag: Option<&str>,
) -> Result<(), ApiError> {
    let mut command = Command::new(reel_live::program().map_err(ApiError::disk)?);
    let [group, action] = what;
    command.args(["store", group, "--store", &app.config.store(), action]);
    let mut all = texts
        .iter()
        .filter_map(|(_, value)| value.as_ref())
        .chain([episode]);
    if all.any(|text| text.len() > TEXT_BYTES || text.contains('\0')) {
        let text = format!("a text of a {group} has at most {TEXT_BYTES} bytes, and no NUL");
        return Err(ApiError::unprocessable(refusal(group), text));
    }
    for (option, value) in texts {
        if let Some(value) = value {
            command.arg(format!("--{option}={value}"));
        }
    }
    command
        .args(flag)
        .args(["--", episode])
        .stdin(std::process::Stdio::null())
        .kill_on_drop(true);
    let output = command.output().await.map_err(ApiError::disk)?;
    if output.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&output.stderr)
        .trim()
        .trim_start_matches("reel: ")
        .to_owned();
    Err(told(app, ApiError::unprocessable(refusal(group), said)))
}

/// The error code of what may not be said so.
fn refusal(group: &str) -> &'static str {
    match group {
        "remark" => "bad_remark",
        _ => "bad_label",
    }
}
