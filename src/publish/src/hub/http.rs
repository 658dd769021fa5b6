//! Requests to the Hub: headers, bounds, retries, and errors that say what to do. Knows no route.
//!
//! # When a request is sent again
//! After 408, 429, 500, 502, 503 and 504 and after a broken connection, if the request may be
//! repeated: 1, 2, 4 and 8 seconds later, or when `Retry-After` says, 60 at most. Commits are sent
//! once.

use std::{io::Read, time::Duration};

use reel_http::ureq::{
    self, Agent, SendBody,
    http::{HeaderMap, Method, Request, StatusCode},
};
use reel_world::printable_line;
use serde_json::Value;

use super::token::{HubToken, endpoint};
use crate::PublishError;

/// Longest answer that is read, in bytes: a page of a tree has a thousand files.
const ANSWER_BYTES_MAX: u64 = 32 << 20;
/// How often a request is sent again.
const RETRIES: u32 = 4;

/// Waits for a time: who calls owns the clock, and tests do not wait.
pub type Pause = Box<dyn Fn(Duration) + Send + Sync>;

/// What sends requests to one Hub.
pub(super) struct Http {
    agent: Agent,
    pub endpoint: String,
    pub token: Option<HubToken>,
    pause: Pause,
}

/// An answer: its status, its headers and its body.
pub(super) struct Response {
    pub status: StatusCode,
    pub headers: HeaderMap,
    pub body: Vec<u8>,
}

/// The body of a request, which can be sent again.
pub(super) enum Body<'b> {
    Empty,
    Json(&'b Value),
    Bytes(&'static str, &'b [u8]),
    /// So many bytes, from a reader that is opened for each try.
    Stream(
        u64,
        &'b dyn Fn() -> Result<Box<dyn Read + Send + 'b>, PublishError>,
    ),
}

/// What is asked, and how.
pub(super) struct Call<'c> {
    /// What it is for, as an error begins.
    pub action: &'c str,
    pub method: Method,
    pub url: String,
    pub body: Body<'c>,
    pub headers: Vec<(String, String)>,
    /// Whether the token is sent: only to the Hub itself.
    pub authorized: bool,
    /// Whether a second request does no harm.
    pub repeatable: bool,
}

impl<'c> Call<'c> {
    pub fn new(action: &'c str, method: Method, url: String, body: Body<'c>) -> Self {
        Self {
            action,
            method,
            url,
            body,
            headers: Vec::new(),
            authorized: true,
            repeatable: true,
        }
    }
}

impl Http {
    pub fn new(address: &str, token: Option<HubToken>, pause: Pause) -> Result<Self, PublishError> {
        let (endpoint, host) = endpoint(address)?;
        let settings = reel_http::settings(&host)
            .timeout_connect(Some(Duration::from_secs(30)))
            .timeout_recv_response(Some(Duration::from_secs(300)))
            .timeout_recv_body(Some(Duration::from_secs(300)));
        Ok(Self {
            agent: settings.build().into(),
            endpoint,
            token,
            pause,
        })
    }

    /// The address of a route of the Hub.
    pub fn url(&self, route: &str) -> String {
        format!("{}{route}", self.endpoint)
    }

    /// Whether an address is one of the Hub itself, to which the token may go.
    pub fn is_own(&self, url: &str) -> bool {
        url.strip_prefix(&self.endpoint)
            .is_some_and(|rest| rest.is_empty() || rest.starts_with(['/', '?']))
    }

    /// Sends a request, again where that may help; an answer of any status.
    pub fn send(&self, call: &Call<'_>) -> Result<Response, PublishError> {
        let mut attempts = 1;
        loop {
            let result = self.attempt(call);
            let asked = match &result {
                Ok(response) if is_transient(response.status) => {
                    reel_http::retry_after(&response.headers)
                }
                Err(PublishError::Connection { .. }) => None,
                _ => return result,
            };
            if !call.repeatable || attempts > RETRIES {
                return result;
            }
            (self.pause)(reel_http::pause(attempts, asked));
            attempts += 1;
        }
    }

    /// Sends a request; an error unless the answer is a success.
    pub fn expect(&self, call: &Call<'_>) -> Result<Response, PublishError> {
        let response = self.send(call)?;
        if response.status.is_success() {
            Ok(response)
        } else {
            Err(self.refused(call, &response))
        }
    }

    /// The error that an answer stands for.
    pub fn refused(&self, call: &Call<'_>, response: &Response) -> PublishError {
        let excerpt = match self.excerpt(&response.body) {
            text if text.is_empty() => text,
            text => format!(": {text}"),
        };
        PublishError::Status {
            action: call.action.to_owned(),
            url: bare(&call.url),
            status: response.status.as_u16(),
            excerpt,
            hint: hint(response.status, self.token.is_some()).to_owned(),
        }
    }

    /// An answer's body as JSON.
    pub fn json(&self, call: &Call<'_>, response: &Response) -> Result<Value, PublishError> {
        serde_json::from_slice(&response.body)
            .map_err(|error| self.misread(call, &error.to_string()))
    }

    /// The error of an answer that the protocol does not have.
    pub fn misread(&self, call: &Call<'_>, reason: &str) -> PublishError {
        PublishError::Answer {
            action: call.action.to_owned(),
            url: bare(&call.url),
            reason: self.safe(reason),
        }
    }

    /// A text of a server for people: without the token, short, on one line.
    pub fn safe(&self, text: &str) -> String {
        let text = self
            .token
            .as_ref()
            .map_or_else(|| text.to_owned(), |token| token.redact(text));
        let text: String = text.chars().take(300).collect();
        printable_line(text.trim())
    }

    fn excerpt(&self, body: &[u8]) -> String {
        let value: Value = serde_json::from_slice(body).unwrap_or_default();
        match value["error"]
            .as_str()
            .or_else(|| value["message"].as_str())
        {
            Some(text) => self.safe(text),
            None => self.safe(&String::from_utf8_lossy(&body[..body.len().min(2000)])),
        }
    }

    fn attempt(&self, call: &Call<'_>) -> Result<Response, PublishError> {
        let broken = |error: ureq::Error| PublishError::Connection {
            action: call.action.to_owned(),
            url: bare(&call.url),
            reason: self.safe(&error.to_string()),
        };
        let mut request = Request::builder().method(&call.method).uri(&call.url);
        for (name, value) in &call.headers {
            request = request.header(name, value);
        }
        if let Some(token) = self.token.as_ref().filter(|_| call.authorized) {
            request = request.header("authorization", token.bearer());
        }
        let unsent = |error: ureq::http::Error| self.misread(call, &error.to_string());
        let mut response = match &call.body {
            Body::Empty => self.agent.run(request.body(()).map_err(unsent)?),
            Body::Json(value) => {
                let request = request.header("content-type", "application/json");
                let text = value.to_string();
                self.agent.run(request.body(text).map_err(unsent)?)
            }
            Body::Bytes(kind, bytes) => {
                let request = request.header("content-type", *kind);
                self.agent.run(request.body(*bytes).map_err(unsent)?)
            }
            Body::Stream(length, open) => {
                let mut reader = open()?;
                let request = request.header("content-length", length.to_string());
                let body = SendBody::from_reader(&mut *reader);
                self.agent.run(request.body(body).map_err(unsent)?)
            }
        }
        .map_err(broken)?;
        let body = response.body_mut().with_config().limit(ANSWER_BYTES_MAX);
        let body = body.read_to_vec().map_err(broken)?;
        Ok(Response {
            status: response.status(),
            headers: response.headers().clone(),
            body,
        })
    }
}

fn is_transient(status: StatusCode) -> bool {
    matches!(status.as_u16(), 408 | 429 | 500 | 502 | 503 | 504)
}

/// An address without its query, which may be a signature that gives access.
fn bare(url: &str) -> String {
    printable_line(url.split('?').next().unwrap_or_default())
}

/// What a person does about a status.
fn hint(status: StatusCode, has_token: bool) -> &'static str {
    match status.as_u16() {
        401 if !has_token => {
            "set HF_TOKEN to a token with write access (https://huggingface.co/settings/tokens), or run `hf auth login`"
        }
        401 => "the token is unknown or expired; set HF_TOKEN to another one with write access",
        403 => {
            "the token may not do this; take one with write access to the owner's datasets, or propose the change with --create-pr"
        }
        404 => {
            "there is no such repository or revision, or the token may not see it; check the name"
        }
        409 => "something else changes the repository at this moment; run the command again",
        412 => "the repository changed since it was compared; run the command again",
        413 => "it is larger than the Hub takes at once; export with fewer rows in a file",
        429 => "too many requests; wait some minutes and run the command again",
        300..=399 => "the repository has another name now; use that one",
        500..=599 => {
            "the Hub has trouble; run the command again later, what arrived is not sent again"
        }
        _ => "the Hub does not take it as it is; its answer says why",
    }
}
