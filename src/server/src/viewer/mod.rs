//! Rerun's web viewer, out of its crate, and a page that opens an episode in it at a step.

use std::{net::SocketAddr, sync::OnceLock};

use axum::{
    Router,
    body::Bytes,
    http::header,
    response::{IntoResponse, Redirect, Response},
    routing::get,
};
use re_web_viewer_server::WebViewerData;
use tokio::net::TcpListener;

use crate::{
    ServeError,
    run::{runtime, stopped},
};

/// Content of an `.rrd` file.
pub(crate) const RRD: &str = "application/octet-stream";
/// The viewer is WebAssembly; it gets nothing from outside, and sends nothing there.
const POLICY: &str = "default-src 'self'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; \
                      img-src 'self' blob: data:; frame-ancestors 'none'";

/// The viewer's files; none where the crate was built without them.
fn viewer() -> Option<&'static WebViewerData> {
    static VIEWER: OnceLock<Option<WebViewerData>> = OnceLock::new();
    VIEWER
        .get_or_init(|| WebViewerData::load(None).ok())
        .as_ref()
}

/// The viewer at `/rerun/?trace=NAME&step=N`; it fetches `/api/traces/NAME/rrd`.
pub(crate) fn router<S: Clone + Send + Sync + 'static>() -> Router<S> {
    let file = |kind: &'static str, content: &'static [u8]| {
        get(move || async move { served(kind, content) })
    };
    let of = |part: fn(&'static WebViewerData) -> &'static [u8]| viewer().map_or(&[][..], part);
    Router::new()
        .route("/rerun", get(|| async { Redirect::permanent("/rerun/") }))
        .route(
            "/rerun/",
            file("text/html; charset=utf-8", include_bytes!("page.html")),
        )
        .route(
            "/rerun/start.js",
            file("text/javascript", include_bytes!("start.js")),
        )
        .route(
            "/rerun/re_viewer.js",
            file("text/javascript", of(WebViewerData::viewer_js)),
        )
        .route(
            "/rerun/re_viewer_bg.wasm",
            file("application/wasm", of(WebViewerData::viewer_wasm)),
        )
}

fn served(kind: &'static str, content: &'static [u8]) -> Response {
    let headers = [
        (header::CONTENT_TYPE, kind),
        (header::CACHE_CONTROL, "no-cache"),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
    ];
    (headers, Bytes::from_static(content)).into_response()
}

/// Serves one recording in Rerun's web viewer, until Ctrl-C. `on_listening` is told the
/// address of the page.
///
/// # Errors
/// When the address cannot be listened on.
pub fn view(
    listen: SocketAddr,
    name: &str,
    step: Option<usize>,
    recording: Vec<u8>,
    on_listening: impl FnOnce(String),
) -> Result<(), ServeError> {
    let recording = Bytes::from(recording);
    let runtime = runtime(Some(2))?;
    runtime.block_on(async {
        let listener = TcpListener::bind(listen)
            .await
            .map_err(|source| ServeError::Listen {
                address: listen,
                source,
            })?;
        let address = listener.local_addr().map_err(ServeError::System)?;
        let content = get(move || async move { ([(header::CONTENT_TYPE, RRD)], recording) });
        let router = router::<()>().route(&format!("/api/traces/{name}/rrd"), content);
        let at = step.map(|step| format!("&step={step}")).unwrap_or_default();
        on_listening(format!("http://{address}/rerun/?trace={name}{at}"));
        axum::serve(listener, router)
            .with_graceful_shutdown(stopped())
            .await
            .map_err(ServeError::System)
    })
}
