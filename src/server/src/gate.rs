//! What every request passes before anything is done for it: Host and Origin, then what its route
//! demands: token and role, rate, size and pace of the body. Never which route demands what.

use std::{
    future::Future as _,
    io,
    num::NonZeroU32,
    pin::Pin,
    sync::Arc,
    task::{Context, Poll},
};

use axum::{
    body::{Body, Bytes, HttpBody},
    extract::{MatchedPath, Request, State},
    http::{HeaderMap, HeaderValue, StatusCode, header},
    middleware::Next,
    response::{IntoResponse as _, Response},
};
use governor::{DefaultKeyedRateLimiter, Quota, RateLimiter};
use hyper::body::{Frame, SizeHint};
use reel_live::Owner;
use reel_mcp::Caller;
use tokio::time::Instant;
use tokio_util::sync::{CancellationToken, WaitForCancellationFutureOwned};

use crate::{
    AuditEntry, Config, Role, TokenEntry, audit, connections::Client, rest::ApiError, service::App,
};

/// Whose request this task answers, as far as a token says.
pub(crate) fn owner() -> Owner {
    Caller::current().unwrap_or_default().owner
}

/// How many requests each client may make.
pub(crate) struct Rates(DefaultKeyedRateLimiter<String>);

impl Rates {
    pub fn new(config: &Config) -> Self {
        let number = |value: u32| NonZeroU32::new(value.max(1)).expect("at least one");
        let quota = Quota::per_second(number(config.limits.requests_per_s))
            .allow_burst(number(config.limits.burst));
        Self(RateLimiter::keyed(quota))
    }

    /// Counts a request of a client, by the name of its token or by its address; whether it may
    /// make it.
    pub fn admits(&self, client: &String) -> bool {
        self.0.check_key(client).is_ok()
    }

    /// Forgets clients that were not here lately.
    pub fn tidy(&self) {
        self.0.retain_recent();
    }
}

/// What a route demands of a request.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Demand {
    /// The role that its token needs; none: no token at all.
    pub role: Option<Role>,
    /// Whether the route reads and counts the body itself: traces come as long streams.
    streamed: bool,
    /// Whether requests that are not safe are on the audit log.
    audited: bool,
    /// Whether the token may also come as the password of the scheme Basic: all that clients can
    /// send who know nothing but a URL.
    basic: bool,
}

impl Demand {
    /// No token; rate and size of the body are limited all the same.
    pub const OPEN: Demand = Demand {
        role: None,
        streamed: false,
        audited: false,
        basic: false,
    };

    /// A token with this role.
    pub fn role(role: Role) -> Self {
        Self {
            role: Some(role),
            audited: role == Role::Admin,
            ..Self::OPEN
        }
    }

    /// The same, with changes on the audit log.
    pub fn audited(self) -> Self {
        Self {
            audited: true,
            ..self
        }
    }

    /// The same, with the token also as a password in the URL.
    pub fn basic(self) -> Self {
        Self {
            basic: true,
            ..self
        }
    }

    /// The same, with a body that the route counts.
    pub fn streamed(self) -> Self {
        Self {
            streamed: true,
            ..self
        }
    }
}

/// Lets a request through, or says why not.
pub(crate) async fn pass(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
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
    let mut response = match app.guard.check(request.headers(), request.uri()) {
        Ok(()) => next.run(request).await,
        Err(why) => ApiError::forbidden("wrong_host", why).into_response(),
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

/// Lets a request to its route, or says why not: the layer of every route. What changes something
/// is on the audit log before it is answered.
pub(crate) async fn admit(
    State((app, demand)): State<(Arc<App>, Demand)>,
    request: Request,
    next: Next,
) -> Result<Response, ApiError> {
    let client = request
        .extensions()
        .get::<Client>()
        .map_or_else(|| "local".to_owned(), |client| client.0.ip().to_string());
    let action = format!("{} {}", request.method(), request.uri().path());
    let mut entry = AuditEntry {
        client: Some(client),
        ..AuditEntry::of_command(action.chars().take(AUDITED_ACTION_MAX).collect())
    };
    if !demand.audited || request.method().is_safe() {
        return admitted(&app, demand, request, next, &mut entry).await;
    }
    // In a task of its own: a change that has begun ends, and is on the log, though its client is
    // gone.
    let change = tokio::spawn(async move {
        let answer = admitted(&app, demand, request, next, &mut entry).await;
        let status = answer
            .as_ref()
            .map_or_else(ApiError::status, Response::status);
        // Strangers, and clients that are too fast, change nothing and fill no disk. A known token
        // gets 401 only where it was revoked in the midst of the change.
        let heard = match status {
            StatusCode::UNAUTHORIZED => entry.token.is_some(),
            other => other != StatusCode::TOO_MANY_REQUESTS,
        };
        if heard {
            entry.at = audit::now();
            entry.status = Some(status.as_u16());
            let log = app.audit.clone();
            let work = app.pool.setup().host.work;
            let kept = work.spawn(move || log.append(&entry)).await;
            if let Err(error) = kept.map_err(io::Error::other).flatten() {
                tracing::error!(%error, "the audit log cannot be written");
            }
        }
        answer
    });
    match change.await {
        Ok(answer) => answer,
        Err(error) if error.is_panic() => std::panic::resume_unwind(error.into_panic()),
        Err(_) => Err(ApiError::busy("the server is shutting down")),
    }
}

/// Longest action of an entry of the audit log, in characters.
const AUDITED_ACTION_MAX: usize = 500;

/// Does for [`admit`] all but the audit log, whose entry it completes.
async fn admitted(
    app: &Arc<App>,
    demand: Demand,
    mut request: Request,
    next: Next,
    audited: &mut AuditEntry,
) -> Result<Response, ApiError> {
    let address = audited.client.clone().unwrap_or_default();
    let entry = match demand.role {
        Some(role) => authorize(app, (role, demand.basic), request.headers(), audited),
        None => Ok(None),
    };
    // Who guesses tokens is counted, too.
    let key = match &entry {
        Ok(Some(entry)) => &entry.name,
        Ok(None) | Err(_) => &address,
    };
    if !app.rates.admits(key) {
        return Err(ApiError::too_many(
            "rate limit exceeded (limits.requests_per_s); wait a moment",
        ));
    }
    let caller = entry?.map(|entry| Caller {
        owner: Owner::named(&entry.name),
        revoked: app.tokens.revocation(&entry),
    });
    if !demand.streamed {
        let body = whole_body(app, &mut request).await?;
        if body.len() <= AUDITED_BODY_MAX {
            audited.request = serde_json::from_slice(&body).ok();
        }
    }
    let Some(caller) = caller else {
        return Ok(next.run(request).await);
    };
    request.extensions_mut().insert(caller.clone());
    let revoked = caller.revoked.clone();
    tokio::select! {
        response = caller.scope(next.run(request)) => {
            Ok(response.map(|body| Body::new(Revocable::new(body, revoked))))
        }
        () = revoked.clone().cancelled_owned() => Err(ApiError::unauthorized(REVOKED)),
    }
}

const REVOKED: &str = "the token was revoked";

/// An answer that breaks off when the token of its request is revoked.
struct Revocable {
    body: Body,
    revoked: Pin<Box<WaitForCancellationFutureOwned>>,
}

impl Revocable {
    fn new(body: Body, revoked: CancellationToken) -> Self {
        Self {
            body,
            revoked: Box::pin(revoked.cancelled_owned()),
        }
    }
}

impl HttpBody for Revocable {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        if self.revoked.as_mut().poll(context).is_ready() {
            return Poll::Ready(Some(Err(axum::Error::new(io::Error::other(REVOKED)))));
        }
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// Largest body of a request that an entry of the audit log holds, in bytes.
const AUDITED_BODY_MAX: usize = 4 << 10;

fn authorize(
    app: &App,
    (role, basic): (Role, bool),
    headers: &HeaderMap,
    audited: &mut AuditEntry,
) -> Result<Option<TokenEntry>, ApiError> {
    if !app.demands_tokens() {
        return Ok(None);
    }
    let given = headers
        .get(header::AUTHORIZATION)
        .and_then(|value| value.to_str().ok());
    let token = given.and_then(|value| match value.split_once(' ')? {
        (scheme, token) if scheme.eq_ignore_ascii_case("bearer") => Some(token.trim().to_owned()),
        (scheme, pair) if basic && scheme.eq_ignore_ascii_case("basic") => password(pair.trim()),
        _ => None,
    });
    let Some(token) = token else {
        return Err(ApiError::unauthorized(
            "no token: send `Authorization: Bearer <token>`; whoever runs this server gives one",
        ));
    };
    let Some(entry) = app.tokens.find(&token) else {
        return Err(ApiError::unauthorized("unknown or revoked token"));
    };
    audited.token = Some(entry.name.clone());
    if entry.roles.contains(&role) || entry.roles.contains(&Role::Admin) {
        return Ok(Some(entry));
    }
    Err(ApiError::forbidden(
        "role",
        format!("token '{}' lacks role '{}'", entry.name, role.name()),
    ))
}

/// The password of the scheme Basic (RFC 7617); `None` if it is not in its form.
fn password(pair: &str) -> Option<String> {
    let decoded = base64::Engine::decode(&base64::engine::general_purpose::STANDARD, pair).ok()?;
    let (_, password) = std::str::from_utf8(&decoded).ok()?.split_once(':')?;
    Some(password.to_owned())
}

/// Takes the body in before anything is done for it: within a size and a time.
async fn whole_body(app: &App, request: &mut Request) -> Result<Bytes, ApiError> {
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
            *request.body_mut() = Body::from(bytes.clone());
            Ok(bytes)
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
