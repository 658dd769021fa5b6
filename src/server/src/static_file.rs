//! Files that come with the program, as a browser takes them: compressed where it can, and sent once.

use axum::{
    body::Bytes,
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::{IntoResponse as _, Response},
};

/// What is said of a file besides its content.
pub(crate) struct StaticFile<'a> {
    /// Its type, e.g. `text/html`.
    pub kind: &'a str,
    /// How long it may be kept without asking.
    pub cache_control: &'static str,
    /// What a page may load.
    pub policy: &'static str,
    /// What changes with its content.
    pub tag: &'a str,
    /// Whether the content is that of a gzip file.
    pub compressed: bool,
}

impl StaticFile<'_> {
    /// The file, or that the client has it.
    pub fn answer(&self, headers: &HeaderMap, content: impl FnOnce() -> Bytes) -> Response {
        let tag = format!("\"{}\"", self.tag);
        let known = headers
            .get(header::IF_NONE_MATCH)
            .is_some_and(|it| it.as_bytes() == tag.as_bytes());
        let mut response = if known {
            StatusCode::NOT_MODIFIED.into_response()
        } else {
            content().into_response()
        };
        let mut say = |name, value: &str| {
            if let Ok(value) = HeaderValue::from_str(value) {
                response.headers_mut().insert(name, value);
            }
        };
        say(header::CONTENT_TYPE, self.kind);
        say(header::CACHE_CONTROL, self.cache_control);
        say(header::ETAG, &tag);
        say(header::VARY, "accept-encoding");
        say(header::CONTENT_SECURITY_POLICY, self.policy);
        say(header::X_CONTENT_TYPE_OPTIONS, "nosniff");
        say(header::REFERRER_POLICY, "no-referrer");
        if self.compressed {
            say(header::CONTENT_ENCODING, "gzip");
        }
        response
    }
}

/// Whether the client takes gzip.
pub(crate) fn takes_gzip(headers: &HeaderMap) -> bool {
    headers
        .get(header::ACCEPT_ENCODING)
        .and_then(|value| value.to_str().ok())
        .is_some_and(|it| it.contains("gzip"))
}
