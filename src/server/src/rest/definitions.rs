//! Panels, pages, views and claims that are JSON files: those that come with Reel (`dashboards/definitions`), and
//! those in the folder `definitions`, which people add without building anything.

use std::{
    collections::BTreeMap,
    fs, io,
    path::{Path, PathBuf},
    sync::Arc,
};

use axum::{Json, extract::State, http::StatusCode};
use reel_live::check_name;
use reel_query::claim::Claim;
use rust_embed::RustEmbed;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    ApiError, analyse,
    error::ErrorBody,
    extract::{Body, PathParams},
};
use crate::{files::put, service::App};

/// Most that a file of a definition holds.
const FILE_BYTES: u64 = 64 << 10;
/// Most panels of a page.
const PANELS: usize = 24;

#[derive(RustEmbed)]
#[folder = "../../dashboards/definitions"]
struct BuiltIn;

/// A panel (a question and how its answer is drawn), a page (panels under one title), a view (an
/// address of the dashboards, with what is chosen there) or a claim (a sentence, its title, and which
/// episodes bear it out).
#[derive(Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Definition {
    /// What stands above it.
    title: String,
    /// What it shows, in a sentence or two.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    text: Option<String>,
    /// Of a panel: the question.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sql: Option<String>,
    /// Of a panel: values of `$parameters` in the question, where the reader gives no others.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    parameters: BTreeMap<String, String>,
    /// Of a panel: how the answer is drawn; without it as a table.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    chart: Option<Drawn>,
    /// Of a page: the names of its panels, in order.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    panels: Option<Vec<String>>,
    /// Of a view: its address, e.g. `/episodes?outcome=failure&policy=planner`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    view: Option<String>,
    /// Of a claim: which episodes count, and which of them bear it out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(schema_with = super::claims::schema)]
    claim: Option<Claim>,
}

/// How an answer is drawn.
#[derive(Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Drawn {
    /// Form in which the answer is drawn, e.g. as bars.
    kind: Kind,
    /// The column along the horizontal axis; without it the first one that fits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    x: Option<String>,
    /// The column of numbers that is drawn; without it the first one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    y: Option<String>,
    /// A column whose values get a colour each.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    group: Option<String>,
}

/// What rows are drawn as.
#[derive(Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(super) enum Kind {
    /// A table with the rows and columns of the answer.
    Table,
    /// A bar for each row.
    Bar,
    /// Points in a line.
    Line,
    /// A scatter plot: points that no line connects.
    Scatter,
}

/// A definition and where it comes from.
#[derive(Serialize, ToSchema)]
pub(super) struct Listed {
    /// Name of its file, without `.json`.
    name: String,
    /// Whether it comes with Reel; otherwise it lies in the folder `definitions`.
    builtin: bool,
    /// What it says; nothing where it cannot be read.
    #[serde(skip_serializing_if = "Option::is_none")]
    definition: Option<Definition>,
    /// Why it cannot be read.
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<String>,
}

/// Panels, pages, views and claims of the dashboards, by name. A file that is none is told with what
/// is wrong with it.
#[utoipa::path(get, path = "/api/definitions", operation_id = "list_definitions", tag = "tables",
    responses((status = 200, body = Vec<Listed>), (status = 503, body = ErrorBody)))]
pub(super) async fn list(State(app): State<Arc<App>>) -> Result<Json<Vec<Listed>>, ApiError> {
    let found = analyse(&app, |app| {
        let ours = BuiltIn::iter().filter_map(|file| {
            let name = file.strip_suffix(".json")?.to_owned();
            Some((name, true, BuiltIn::get(&file)?.data.into_owned()))
        });
        let mut found: BTreeMap<String, Listed> = ours
            .map(|(name, builtin, text)| (name.clone(), listed(name, builtin, Ok(text))))
            .collect();
        // Whoever has one of the same name wants theirs.
        for entry in fs::read_dir(app.config.definitions())
            .into_iter()
            .flatten()
            .flatten()
        {
            let file = entry.file_name();
            let Some(name) = file
                .to_str()
                .and_then(|file| file.strip_suffix(".json"))
                .filter(|name| check_name(name).is_ok())
            else {
                continue;
            };
            found.insert(
                name.to_owned(),
                listed(name.to_owned(), false, read(&entry.path())),
            );
        }
        Ok(found.into_values().collect())
    });
    found.await.map(Json)
}

/// Keeps a panel, a page, a view or a claim under a name.
#[utoipa::path(put, path = "/api/definitions/{file}", operation_id = "keep_definition", tag = "tables",
    params(("file" = String, Path)), request_body = Definition,
    responses((status = 201, body = Definition), (status = 400, body = ErrorBody), (status = 422, body = ErrorBody),
        (status = 503, body = ErrorBody), (status = 507, body = ErrorBody)))]
pub(super) async fn keep(
    State(app): State<Arc<App>>,
    PathParams(name): PathParams<String>,
    Body(definition): Body<Definition>,
) -> Result<(StatusCode, Json<Definition>), ApiError> {
    definition
        .check()
        .map_err(|problem| ApiError::unprocessable("bad_definition", problem))?;
    let kept = analyse(&app, move |app| {
        let file = file(app, &name)?;
        let text = serde_json::to_string_pretty(&definition)
            .map_err(|_| ApiError::internal("the definition cannot be written"))?
            + "\n";
        if text.len() as u64 > FILE_BYTES {
            return Err(ApiError::unprocessable(
                "bad_definition",
                format!("a definition has at most {FILE_BYTES} bytes"),
            ));
        }
        fs::create_dir_all(app.config.definitions())
            .and_then(|()| put(&file, &text))
            .map_err(ApiError::disk)?;
        Ok(definition)
    });
    kept.await
        .map(|definition| (StatusCode::CREATED, Json(definition)))
}

/// Takes away a panel, a page, a view or a claim of yours; one of Reel's that it hid comes back.
#[utoipa::path(delete, path = "/api/definitions/{file}", operation_id = "drop_definition", tag = "tables",
    params(("file" = String, Path)),
    responses((status = 204), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody), (status = 503, body = ErrorBody),
        (status = 507, body = ErrorBody)))]
pub(super) async fn drop(
    State(app): State<Arc<App>>,
    PathParams(name): PathParams<String>,
) -> Result<StatusCode, ApiError> {
    let gone = analyse(&app, move |app| match fs::remove_file(file(app, &name)?) {
        Ok(()) => Ok(StatusCode::NO_CONTENT),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Err(ApiError::not_found(format!(
            "unknown panel, page, view or claim '{name}'; see GET /api/definitions"
        ))),
        Err(error) => Err(ApiError::disk(error)),
    });
    gone.await
}

/// The claim of that name.
pub(super) fn kept_claim(app: &App, name: &str) -> Result<Claim, ApiError> {
    let unknown =
        || ApiError::not_found(format!("unknown claim '{name}'; see GET /api/definitions"));
    let text = match read(&file(app, name)?) {
        Ok(text) => text,
        Err(_) => BuiltIn::get(&format!("{name}.json"))
            .ok_or_else(unknown)?
            .data
            .into_owned(),
    };
    let listed = listed(name.to_owned(), false, Ok(text));
    if let Some(problem) = listed.problem {
        return Err(ApiError::unprocessable("bad_definition", problem));
    }
    listed
        .definition
        .and_then(|definition| definition.claim)
        .ok_or_else(unknown)
}

fn file(app: &App, name: &str) -> Result<PathBuf, ApiError> {
    check_name(name)?;
    Ok(app.config.definitions().join(format!("{name}.json")))
}

fn read(path: &Path) -> Result<Vec<u8>, String> {
    let size = fs::metadata(path).map_err(|error| error.to_string())?.len();
    if size > FILE_BYTES {
        return Err(format!(
            "it has {size} bytes; a definition has at most {FILE_BYTES}"
        ));
    }
    fs::read(path).map_err(|error| error.to_string())
}

fn listed(name: String, builtin: bool, text: Result<Vec<u8>, String>) -> Listed {
    let read = text.and_then(|text| {
        let definition: Definition =
            serde_json::from_slice(&text).map_err(|error| error.to_string())?;
        definition.check()?;
        Ok(definition)
    });
    match read {
        Ok(definition) => Listed {
            name,
            builtin,
            definition: Some(definition),
            problem: None,
        },
        Err(problem) => Listed {
            name,
            builtin,
            definition: None,
            problem: Some(problem),
        },
    }
}

impl Definition {
    fn check(&self) -> Result<(), String> {
        if self.title.trim().is_empty() {
            return Err("it has no title".to_owned());
        }
        if self.sql.is_none() && (self.chart.is_some() || !self.parameters.is_empty()) {
            return Err("only a panel has a chart and parameters".to_owned());
        }
        match (&self.sql, &self.panels, &self.view, &self.claim) {
            (None, None, None, Some(claim)) => claim.check(),
            (Some(sql), None, None, None) if sql.trim().is_empty() => Err("its sql is empty".to_owned()),
            (Some(_), None, None, None) => Ok(()),
            (None, Some(panels), None, None) if !(1..=PANELS).contains(&panels.len()) => {
                Err(format!("a page has 1 to {PANELS} panels"))
            }
            (None, Some(panels), None, None) => {
                match panels.iter().find(|name| check_name(name).is_err()) {
                    Some(name) => Err(format!("'{name}' cannot be the name of a panel")),
                    None => Ok(()),
                }
            }
            // browsers read `\` as `/`, and leave control characters out
            (None, None, Some(view), None)
                if view.starts_with('/')
                    && !view.starts_with("//")
                    && !view.contains(|letter: char| letter == '\\' || letter.is_control()) =>
            {
                Ok(())
            }
            (None, None, Some(view), None) => Err(format!(
                "'{view}' is no address of a page, such as /episodes?outcome=failure"
            )),
            _ => Err(
                "it has one of `sql`, and is a panel, `panels`, and is a page, `view`, and is a view, and `claim`, and is a claim"
                    .to_owned(),
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_with_reel_can_be_read_and_has_its_panels() {
        let found: BTreeMap<String, Definition> = BuiltIn::iter()
            .map(|file| {
                let one = listed(
                    file.to_string(),
                    true,
                    Ok(BuiltIn::get(&file).unwrap().data.into_owned()),
                );
                (
                    file.trim_end_matches(".json").to_owned(),
                    one.definition
                        .unwrap_or_else(|| panic!("{file}: {:?}", one.problem)),
                )
            })
            .collect();
        assert!(!found.is_empty());
        for panel in found.values().flat_map(|one| one.panels.iter().flatten()) {
            assert!(
                found.get(panel).is_some_and(|panel| panel.sql.is_some()),
                "{panel}"
            );
        }
    }

    #[test]
    fn what_is_no_definition_is_told() {
        let problem = |text: &str| {
            listed("x".to_owned(), false, Ok(text.as_bytes().to_vec()))
                .problem
                .unwrap_or_default()
        };
        assert!(problem("{").contains("EOF"));
        assert!(problem(r#"{"title": " ", "sql": "SELECT 1"}"#).contains("title"));
        assert!(problem(r#"{"title": "a"}"#).contains("one of"));
        assert!(
            problem(r#"{"title": "a", "sql": "SELECT 1", "panels": ["b"]}"#).contains("one of")
        );
        assert!(
            problem(r#"{"title": "a", "panels": ["b"], "view": "/episodes"}"#).contains("one of")
        );
        assert!(problem(r#"{"title": "a", "view": "//elsewhere"}"#).contains("'//elsewhere'"));
        assert!(problem(r#"{"title": "a", "view": "javascript:x"}"#).contains("'javascript:x'"));
        assert!(problem(r#"{"title": "a", "view": "/\\elsewhere"}"#).contains("address"));
        assert!(problem(r#"{"title": "a", "view": "/\t/elsewhere"}"#).contains("address"));
        assert!(
            problem(r#"{"title": "a", "view": "/episodes", "parameters": {"b": "c"}}"#)
                .contains("panel")
        );
        assert_eq!(
            problem(r#"{"title": "a", "view": "/episodes?policy=b"}"#),
            ""
        );
        assert!(
            problem(r#"{"title": "a", "claim": {"holds": "success", "at_most": 2}}"#)
                .contains("at_most")
        );
        assert!(problem(r#"{"title": "a", "claim": {"of": "success"}}"#).contains("holds"));
        assert_eq!(
            problem(r#"{"title": "a", "claim": {"holds": "success", "at_least": 0.9}}"#),
            ""
        );
        assert!(problem(r#"{"title": "a", "panels": []}"#).contains("panels"));
        assert!(problem(r#"{"title": "a", "panels": ["../b"]}"#).contains("'../b'"));
        assert!(
            problem(r#"{"title": "a", "sql": "SELECT 1", "chart": {"kind": "pie"}}"#)
                .contains("pie")
        );
        assert_eq!(
            problem(r#"{"title": "a", "sql": "SELECT 1", "chart": {"kind": "bar"}}"#),
            ""
        );
    }
}
