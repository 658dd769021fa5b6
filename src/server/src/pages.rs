//! The web pages of `dashboards/`, embedded when this was built: files with their types, compressed
//! where the client takes it. Everything that is no file is the one page, which finds its own way.

use axum::{
    http::{HeaderMap, Method, StatusCode, Uri, header},
    response::{Html, IntoResponse as _, Response},
};
use rust_embed::{EmbeddedFile, RustEmbed};

use crate::{
    rest::not_found,
    static_file::{StaticFile, takes_gzip},
};

#[derive(RustEmbed)]
#[folder = "../../dashboards/dist"]
#[allow_missing = true]
struct Files;

const INDEX: &str = "index.html";
/// Pages may load from here alone. Styles of single elements are set by charts.
const POLICY: &str = "default-src 'self'; img-src 'self' blob: data:; style-src 'self' 'unsafe-inline'; frame-ancestors 'none'";

/// What is at an address that no other route knows.
pub(crate) async fn page(method: Method, address: Uri, headers: HeaderMap) -> Response {
    let path = address.path().trim_start_matches('/');
    let wants_page = headers
        .get(header::ACCEPT)
        .and_then(|value| value.to_str().ok())
        .is_some_and(|it| it.contains("text/html"));
    if !matches!(method, Method::GET | Method::HEAD) || path.starts_with("api/") {
        return not_found().await.into_response();
    }
    if let Some(file) = Files::get(path).filter(|_| path != INDEX) {
        // Their names change with what is in them.
        let kept = if path.starts_with("assets/") {
            "public, max-age=31536000, immutable"
        } else {
            "no-cache"
        };
        return answer(path, file, kept, &headers);
    }
    if !wants_page {
        return not_found().await.into_response();
    }
    match Files::get(INDEX) {
        Some(file) => answer(INDEX, file, "no-cache", &headers),
        None => (StatusCode::NOT_FOUND, Html(MISSING)).into_response(),
    }
}

const MISSING: &str = "<!doctype html><title>Reel</title><p>This build of Reel has no web pages: Node was missing when it was built. \
                       Run <code>make pages</code> and build again. The service itself runs: see <a href=\"/api/openapi.json\">/api/openapi.json</a>.";

fn answer(path: &str, file: EmbeddedFile, kept: &'static str, headers: &HeaderMap) -> Response {
    let kind = file.metadata.mimetype().to_owned();
    let zipped = takes_gzip(headers)
        .then(|| Files::get(&format!("{path}.gz")))
        .flatten();
    let compressed = zipped.is_some();
    let file = zipped.unwrap_or(file);
    let hash = file.metadata.sha256_hash();
    let tag: String = hash
        .iter()
        .take(16)
        .map(|byte| format!("{byte:02x}"))
        .collect();
    StaticFile {
        kind: &kind,
        cache_control: kept,
        policy: POLICY,
        tag: &tag,
        compressed,
    }
    .answer(headers, || file.data.into_owned().into())
}
