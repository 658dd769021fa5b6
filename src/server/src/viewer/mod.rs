//! Rerun's web viewer, out of its crate, and a page that opens an episode in it at a step.

use std::{
    io::Write as _,
    net::SocketAddr,
    sync::{Arc, OnceLock},
};

use axum::{
    Router,
    body::Bytes,
    http::{HeaderMap, StatusCode, header},
    response::{IntoResponse as _, Redirect, Response},
    routing::get,
};
use flate2::{Compression, write::GzEncoder};
use re_web_viewer_server::WebViewerData;
use reel_world::Digest;
use tokio::net::TcpListener;

use crate::{
    ServeError,
    run::{runtime, stopped},
    static_file::{StaticFile, takes_gzip},
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
    let of = |part: fn(&'static WebViewerData) -> &'static [u8]| viewer().map_or(&[][..], part);
    let files: [(&str, &'static str, &'static [u8]); 4] = [
        (
            "/rerun/",
            "text/html; charset=utf-8",
            include_bytes!("page.html"),
        ),
        (
            "/rerun/start.js",
            "text/javascript",
            include_bytes!("start.js"),
        ),
        (
            "/rerun/re_viewer.js",
            "text/javascript",
            of(WebViewerData::viewer_js),
        ),
        (
            "/rerun/re_viewer_bg.wasm",
            "application/wasm",
            of(WebViewerData::viewer_wasm),
        ),
    ];
    let router = Router::new().route("/rerun", get(|| async { Redirect::permanent("/rerun/") }));
    files
        .into_iter()
        .fold(router, |router, (path, kind, content)| {
            let file = Arc::new(ViewerFile {
                kind,
                content,
                prepared: OnceLock::new(),
            });
            router.route(path, get(move |headers| served(file.clone(), headers)))
        })
}

/// A file of the viewer: tens of megabytes, compressed when somebody first asks.
struct ViewerFile {
    kind: &'static str,
    content: &'static [u8],
    /// What changes with its content, and that compressed.
    prepared: OnceLock<(String, Bytes)>,
}

impl ViewerFile {
    fn prepared(&self) -> &(String, Bytes) {
        self.prepared.get_or_init(|| {
            let mut zipped = GzEncoder::new(Vec::new(), Compression::default());
            // Nothing can go wrong in memory.
            let _ = zipped.write_all(self.content);
            let zipped = zipped.finish().unwrap_or_default();
            let tag = Digest::of(self.content).to_string();
            (tag[..32].to_owned(), zipped.into())
        })
    }
}

async fn served(file: Arc<ViewerFile>, headers: HeaderMap) -> Response {
    let prepare = file.clone();
    if tokio::task::spawn_blocking(move || {
        prepare.prepared();
    })
    .await
    .is_err()
    {
        return StatusCode::INTERNAL_SERVER_ERROR.into_response();
    }
    let (tag, zipped) = file.prepared();
    let compressed = takes_gzip(&headers);
    let tag = format!("{tag}{}", if compressed { "-gzip" } else { "" });
    StaticFile {
        kind: file.kind,
        cache_control: "no-cache",
        policy: POLICY,
        tag: &tag,
        compressed,
    }
    .answer(&headers, || match compressed {
        true => zipped.clone(),
        false => Bytes::from_static(file.content),
    })
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
