//! What every request passes before anything is done for it: Host and Origin, token and role, rate,
//! size and pace of the body.

use std::{num::NonZeroU32, sync::Arc, time::Instant};

use axum::{
    body::Body,
    extract::{MatchedPath, Request, State},
    http::{HeaderMap, HeaderValue, Method, header},
    middleware::Next,
    response::Response,
};
use governor::{DefaultKeyedRateLimiter, Quota, RateLimiter};

use crate::{Config, Role, connections::Client, rest::ApiError, service::App};

/// Who is calling, as far as a token says.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Caller(pub String);

/// How many requests each client may make.
pub(crate) struct Rates(DefaultKeyedRateLimiter<String>);

impl Rates {
    pub fn new(config: &Config) -> Self {
        let number = |value: u32| NonZeroU32::new(value.max(1)).expect("at least one");
        let quota = Quota::per_second(number(config.limits.requests_per_s))
            .allow_burst(number(config.limits.burst));
        Self(RateLimiter::keyed(quota))
    }

    /// Forgets clients that were not here lately.
    pub fn tidy(&self) {
        self.0.retain_recent();
    }
}

/// What a route demands; none: nothing.
fn needed(method: &Method, path: &str) -> Option<Role> {
    let reads = method == Method::GET || method == Method::HEAD;
    match path {
        "/healthz" | "/readyz" | "/api/openapi.json" => None,
        "/mcp" | "/sse" | "/messages/" => Some(Role::Act),
        "/metrics" | "/analysis/mcp" | "/api/sql" => Some(Role::Read),
        _ if path.starts_with("/w/") => Some(Role::Act),
        _ if path == "/api/leases" || path.starts_with("/api/leases/") => Some(Role::Act),
        _ if reads && path.starts_with("/api/") => Some(Role::Read),
        // The web pages: the same for everybody, and they show nothing that they are not given.
        _ if reads => None,
        // Computes and keeps nothing.
        _ if path.starts_with("/api/traces/") && path.ends_with("/replay") => Some(Role::Read),
        _ => Some(Role::Admin),
    }
}

/// Lets a request through, or says why not.
pub(crate) async fn pass(
    State(app): State<Arc<App>>,
    mut request: Request,
    next: Next,
) -> Response {
    let page = app.guard.page(&request);
    if let Some(answer) = page.preflight() {
        return answer;
    }
    let begun = Instant::now();
    let method = request.method().clone();
    let route = request
        .extensions()
        .get::<MatchedPath>()
        .map_or_else(|| "none".to_owned(), |path| path.as_str().to_owned());
    let mut response = match admit(&app, &mut request).await {
        Ok(()) => next.run(request).await,
        Err(error) => axum::response::IntoResponse::into_response(error),
    };
    page.add_cors_headers(&mut response);
    let headers = response.headers_mut();
    // Answers are never pages of somebody else's.
    headers.insert(
        header::X_CONTENT_TYPE_OPTIONS,
        HeaderValue::from_static("nosniff"),
    );
    headers.insert(
        header::REFERRER_POLICY,
        HeaderValue::from_static("no-referrer"),
    );
    let (status, took) = (response.status(), begun.elapsed());
    app.metrics
        .request(method.as_str(), &route, status.as_u16(), took);
    if status.is_server_error() {
        tracing::warn!(%method, route, status = status.as_u16(), ms = took.as_millis() as u64, "answered");
    } else {
        tracing::debug!(%method, route, status = status.as_u16(), ms = took.as_millis() as u64, "answered");
    }
    response
}

async fn admit(app: &App, request: &mut Request) -> Result<(), ApiError> {
    app.guard
        .check(request.headers(), request.uri())
        .map_err(|why| ApiError::forbidden("wrong_host", why))?;
    let address = request
        .extensions()
        .get::<Client>()
        .map_or_else(|| "local".to_owned(), |client| client.0.ip().to_string());
    let caller = authorize(
        app,
        request.method(),
        request.uri().path(),
        request.headers(),
    )?;
    let key = caller.as_ref().map_or(address, |caller| caller.0.clone());
    if app.rates.0.check_key(&key).is_err() {
        return Err(ApiError::too_many(
            "rate limit exceeded (limits.requests_per_s); wait a moment",
        ));
    }
    if let Some(caller) = caller {
        request.extensions_mut().insert(caller);
    }
    if !is_upload(request) {
        whole_body(app, request).await?;
    }
    Ok(())
}

fn authorize(
    app: &App,
    method: &Method,
    path: &str,
    headers: &HeaderMap,
) -> Result<Option<Caller>, ApiError> {
    let Some(role) = needed(method, path) else {
        return Ok(None);
    };
    if !app.demands_tokens() {
        return Ok(None);
    }
    let given = headers
        .get(header::AUTHORIZATION)
        .and_then(|value| value.to_str().ok());
    let token = given
        .and_then(|value| value.split_once(' '))
        .filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer"));
    let Some((_, token)) = token else {
        return Err(ApiError::unauthorized(
            "no token: send `Authorization: Bearer <token>`; `reel server token create` creates one",
        ));
    };
    let Some(entry) = app.tokens.find(token.trim()) else {
        return Err(ApiError::unauthorized("unknown or revoked token"));
    };
    if entry.roles.contains(&role) || entry.roles.contains(&Role::Admin) {
        return Ok(Some(Caller(entry.name)));
    }
    let role = format!("{role:?}").to_lowercase();
    Err(ApiError::forbidden(
        "role",
        format!("token '{}' lacks role '{role}'", entry.name),
    ))
}

/// Traces come as long streams, and are counted where they are written.
fn is_upload(request: &Request) -> bool {
    request.method() == Method::PUT && request.uri().path().starts_with("/api/traces/")
}

/// Takes the body in before anything is done for it: within a size and a time.
async fn whole_body(app: &App, request: &mut Request) -> Result<(), ApiError> {
    let limit = app.config.limits.body_mib << 20;
    let declared = request
        .headers()
        .get(header::CONTENT_LENGTH)
        .and_then(|value| value.to_str().ok()?.parse::<u64>().ok());
    let too_large =
        || ApiError::too_large(format!("a body may have {limit} bytes (limits.body_mib)"));
    if declared.is_some_and(|bytes| bytes > limit as u64) {
        return Err(too_large());
    }
    let body = std::mem::take(request.body_mut());
    let read = tokio::time::timeout(app.read_patience(), axum::body::to_bytes(body, limit));
    match read.await {
        Err(_) => Err(ApiError::timeout(
            "the request body timed out (limits.read_timeout_s)",
        )),
        Ok(Ok(bytes)) => {
            *request.body_mut() = Body::from(bytes);
            Ok(())
        }
        Ok(Err(error))
            if std::error::Error::source(&error)
                .is_some_and(|cause| cause.to_string().contains("length limit")) =>
        {
            Err(too_large())
        }
        Ok(Err(error)) => Err(ApiError::bad_request(
            "broken_body",
            format!("the request body broke off: {error}"),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_policy_reaches_nothing_that_it_is_graded_by() {
        let act = [
            (Method::POST, "/mcp"),
            (Method::GET, "/sse"),
            (Method::POST, "/messages/"),
            (Method::POST, "/w/7/mcp"),
            (Method::GET, "/w/7/sse"),
            (Method::POST, "/api/leases"),
            (Method::DELETE, "/api/leases/7"),
        ];
        let read = [
            (Method::GET, "/api/episodes"),
            (Method::GET, "/api/traces/x"),
            (Method::POST, "/api/sql"),
            (Method::POST, "/analysis/mcp"),
            (Method::GET, "/metrics"),
            (Method::GET, "/api/sessions"),
            (Method::POST, "/api/traces/x/replay"),
        ];
        let admin = [
            (Method::PUT, "/api/traces/x"),
            (Method::DELETE, "/api/traces/x"),
            (Method::POST, "/api/jobs"),
            (Method::DELETE, "/api/sessions/x"),
            (Method::POST, "/api/labels"),
            (Method::POST, "/api/traces/x/branches"),
            (Method::POST, "/something/new"),
        ];
        for (role, routes) in [
            (Role::Act, &act[..]),
            (Role::Read, &read),
            (Role::Admin, &admin),
        ] {
            for (method, path) in routes {
                assert_eq!(needed(method, path), Some(role), "{method} {path}");
            }
        }
        for path in ["/healthz", "/", "/episodes/x", "/assets/index.js"] {
            assert_eq!(needed(&Method::GET, path), None);
        }
    }
}
