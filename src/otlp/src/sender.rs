//! Requests on their way to a collector: OTLP over HTTP, with the variables of the specification, retries and
//! what a collector rejects.

use std::{io::Write as _, time::Duration};

use flate2::{Compression, write::GzEncoder};
use reel_http::ureq::{self, Agent};
use url::Url;

use crate::{
    ExportTraceServiceRequest, ExportTraceServiceResponse, Format, Message as _, document,
    span_count,
};

/// Where spans are taken, below a collector's address.
const PATH: &str = "/v1/traces";
/// For one try, as the specification has it.
const TIMEOUT: Duration = Duration::from_secs(10);
/// How often a request is tried again.
const RETRIES: u32 = 5;
/// Longest answer that is read, in bytes.
const ANSWER_BYTES_MAX: u64 = 1 << 20;
/// Most characters of an answer in an error.
const EXCERPT_CHARACTERS: usize = 200;

/// Where spans go, and how.
#[derive(Clone, PartialEq, Eq)]
pub struct Endpoint {
    /// The whole address; holds no secret and is shown in errors.
    pub url: String,
    /// Sent with each request; shown nowhere.
    pub headers: Vec<(String, String)>,
    /// For one try, from connecting to the last byte of the answer.
    pub timeout: Duration,
    /// How the requests are encoded.
    pub format: Format,
    /// Whether the requests are compressed with gzip.
    pub gzip: bool,
}

impl std::fmt::Debug for Endpoint {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let names: Vec<&String> = self.headers.iter().map(|(name, _)| name).collect();
        f.debug_struct("Endpoint")
            .field("url", &self.url)
            .field("headers", &names)
            .finish_non_exhaustive()
    }
}

/// Why spans did not reach a collector.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum SendError {
    /// An address or a variable that cannot be used.
    #[error("{name}: {problem}")]
    Setting { name: String, problem: String },
    /// No answer after all tries.
    #[error("no answer after {attempts} tries: {problem}; is a collector listening there? {url}")]
    Connect {
        url: String,
        attempts: u32,
        problem: String,
    },
    /// The collector does not take them.
    #[error("the collector answers with status {status} after {attempts} tries: {excerpt} {url}")]
    Status {
        url: String,
        attempts: u32,
        status: u16,
        excerpt: String,
    },
}

impl Endpoint {
    /// The endpoint of an argument, else of the environment (`OTEL_EXPORTER_OTLP_ENDPOINT` and the others
    /// of the specification, which `variable` gives); `None` if neither names one.
    ///
    /// # Errors
    /// When an address, a header or another setting cannot be one.
    pub fn resolve(
        argument: Option<&str>,
        variable: impl Fn(&str) -> Option<String>,
    ) -> Result<Option<Self>, SendError> {
        let setting = |name: &str| {
            let own = format!("OTEL_EXPORTER_OTLP_TRACES_{name}");
            let of_all = format!("OTEL_EXPORTER_OTLP_{name}");
            [own, of_all].into_iter().find_map(|name| {
                let value = variable(&name).filter(|value| !value.trim().is_empty());
                value.map(|value| (name, value))
            })
        };
        let disabled = variable("OTEL_SDK_DISABLED").is_some_and(|value| value == "true");
        let url = match (argument, setting("ENDPOINT")) {
            (Some(address), _) => address_of("the address", address, true)?,
            (None, Some((name, address))) if !disabled => {
                let base = name == "OTEL_EXPORTER_OTLP_ENDPOINT";
                address_of(&name, &address, base)?
            }
            _ => return Ok(None),
        };
        let wrong = |name: String, problem: &str| SendError::Setting {
            name,
            problem: problem.to_owned(),
        };
        let format = match setting("PROTOCOL") {
            None => Format::Protobuf,
            Some((_, name)) if name == "http/protobuf" => Format::Protobuf,
            Some((_, name)) if name == "http/json" => Format::Json,
            Some((name, _)) => {
                let problem = "spans go over HTTP: set http/protobuf or http/json, and the collector's port for it (4318)";
                return Err(wrong(name, problem));
            }
        };
        let timeout = match setting("TIMEOUT") {
            None => TIMEOUT,
            Some((name, text)) => match text.trim().parse() {
                Ok(milliseconds) if milliseconds > 0 => Duration::from_millis(milliseconds),
                _ => return Err(wrong(name, "it is no number of milliseconds")),
            },
        };
        let headers = match setting("HEADERS") {
            None => Vec::new(),
            Some((name, text)) => headers(&text).ok_or_else(|| {
                wrong(
                    name,
                    "it is no list of headers: write name=value,name=value with values percent-encoded",
                )
            })?,
        };
        Ok(Some(Self {
            url,
            headers,
            timeout,
            format,
            gzip: setting("COMPRESSION").is_some_and(|(_, name)| name == "gzip"),
        }))
    }
}

/// The address that spans go to; below a base the path of the specification is added.
fn address_of(name: &str, text: &str, base: bool) -> Result<String, SendError> {
    let wrong = |problem: &str| SendError::Setting {
        name: name.to_owned(),
        problem: problem.to_owned(),
    };
    let mut url = Url::parse(text.trim())
        .ok()
        .filter(|url| ["http", "https"].contains(&url.scheme()) && url.has_host())
        .ok_or_else(|| {
            wrong("it is no address of a collector: give http://HOST:4318 or https://HOST")
        })?;
    if !url.username().is_empty() || url.password().is_some() {
        return Err(wrong(
            "it must hold no user name or password; put the token into OTEL_EXPORTER_OTLP_HEADERS",
        ));
    }
    if base && !url.path().ends_with(PATH) {
        let path = format!("{}{PATH}", url.path().trim_end_matches('/'));
        url.set_path(&path);
    }
    Ok(url.into())
}

/// Headers as the variable has them, which is as W3C Baggage; `None` if they are not.
fn headers(text: &str) -> Option<Vec<(String, String)>> {
    let pairs = text.split(',').filter(|pair| !pair.trim().is_empty());
    pairs
        .map(|pair| {
            let (name, value) = pair.split_once('=')?;
            let (name, value) = (name.trim().to_ascii_lowercase(), decoded(value.trim())?);
            let is_name =
                |byte: u8| byte.is_ascii_alphanumeric() || b"-_.!#$%&'*+^`|~".contains(&byte);
            let is_value = |byte: u8| byte == b' ' || byte.is_ascii_graphic();
            (!name.is_empty() && name.bytes().all(is_name) && value.bytes().all(is_value))
                .then_some((name, value))
        })
        .collect()
}

/// A text without its percent-encoding.
fn decoded(text: &str) -> Option<String> {
    let mut bytes = Vec::new();
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        match byte {
            b'%' => {
                let digits = [rest.next()?, rest.next()?];
                bytes.extend(crate::from_hex(std::str::from_utf8(&digits).ok()?)?);
            }
            byte => bytes.push(byte),
        }
    }
    String::from_utf8(bytes).ok()
}

/// What a collector made of a request.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Acknowledged {
    /// Spans that it took.
    pub accepted: u64,
    /// Spans that it rejected.
    pub rejected: u64,
    /// What it says of that, or as a warning; empty where it says nothing.
    pub message: String,
}

/// A connection to a collector, for one thread.
pub struct Sender {
    endpoint: Endpoint,
    agent: Agent,
}

impl Sender {
    /// A sender; nothing is sent yet.
    pub fn new(endpoint: Endpoint) -> Self {
        let agent = agent(&endpoint);
        Self { endpoint, agent }
    }

    /// Where the spans go.
    pub fn endpoint(&self) -> &Endpoint {
        &self.endpoint
    }

    /// Sends a request, and again where that may help (429, 502, 503, 504, no connection), after the pause
    /// that the collector asks for or a doubling one. `sleep` says whether to go on after the pause.
    ///
    /// # Errors
    /// When the collector does not take it, or does not answer.
    pub fn send(
        &self,
        request: &ExportTraceServiceRequest,
        mut sleep: impl FnMut(Duration) -> bool,
    ) -> Result<Acknowledged, SendError> {
        let body = self.body(request)?;
        let mut attempts = 1;
        loop {
            let failure = match self.attempt(&body, attempts) {
                Ok(response) => {
                    let partial = response.partial_success.unwrap_or_default();
                    let rejected = u64::try_from(partial.rejected_spans).unwrap_or_default();
                    return Ok(Acknowledged {
                        accepted: span_count(request).saturating_sub(rejected),
                        rejected,
                        message: partial.error_message,
                    });
                }
                Err(failure) => failure,
            };
            let again = failure.transient && attempts <= RETRIES;
            if !again || !sleep(reel_http::pause(attempts, failure.retry_after)) {
                return Err(failure.error);
            }
            attempts += 1;
        }
    }

    fn body(&self, request: &ExportTraceServiceRequest) -> Result<Vec<u8>, SendError> {
        let wrong = |problem: String| SendError::Setting {
            name: "the spans".to_owned(),
            problem,
        };
        let plain = match self.endpoint.format {
            Format::Protobuf => document::encode(request),
            Format::Json => {
                serde_json::to_vec(request).map_err(|error| wrong(error.to_string()))?
            }
        };
        if !self.endpoint.gzip {
            return Ok(plain);
        }
        let mut gzip = GzEncoder::new(Vec::new(), Compression::fast());
        gzip.write_all(&plain)
            .and_then(|()| gzip.finish())
            .map_err(|error| wrong(error.to_string()))
    }

    fn attempt(&self, body: &[u8], attempts: u32) -> Result<ExportTraceServiceResponse, Failure> {
        let broken = |error: ureq::Error| Failure {
            transient: matches!(
                error,
                ureq::Error::Io(_)
                    | ureq::Error::Timeout(_)
                    | ureq::Error::HostNotFound
                    | ureq::Error::ConnectionFailed
            ),
            error: SendError::Connect {
                url: self.endpoint.url.clone(),
                attempts,
                problem: error.to_string(),
            },
            retry_after: None,
        };
        let format = self.endpoint.format;
        let mut post = self.agent.post(&self.endpoint.url);
        for (name, value) in &self.endpoint.headers {
            post = post.header(name, value);
        }
        post = post.content_type(format.media_type());
        if self.endpoint.gzip {
            post = post.header("content-encoding", "gzip");
        }
        let mut response = post.send(body).map_err(broken)?;
        let status = response.status();
        let retry_after = reel_http::retry_after(response.headers());
        let answered = response.headers().get("content-type");
        let answered = answered.and_then(|kind| Format::of_media_type(kind.to_str().ok()?));
        let limited = response.body_mut().with_config().limit(ANSWER_BYTES_MAX);
        let bytes = limited.read_to_vec().unwrap_or_default();
        if status.is_success() {
            // Some collectors answer with nothing, or with words: then all was taken.
            return Ok(match answered {
                Some(Format::Json) => serde_json::from_slice(&bytes).unwrap_or_default(),
                _ => ExportTraceServiceResponse::decode(&bytes[..]).unwrap_or_default(),
            });
        }
        let status = status.as_u16();
        Err(Failure {
            transient: [429, 502, 503, 504].contains(&status),
            error: SendError::Status {
                url: self.endpoint.url.clone(),
                attempts,
                status,
                excerpt: excerpt(&bytes),
            },
            retry_after,
        })
    }
}

/// A try that failed.
struct Failure {
    error: SendError,
    transient: bool,
    retry_after: Option<Duration>,
}

/// The beginning of an answer in printable characters; what is protobuf has few.
fn excerpt(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(bytes);
    let plain = text
        .chars()
        .filter(|letter| !letter.is_control() && *letter != '\u{FFFD}');
    plain.take(EXCERPT_CHARACTERS).collect()
}

fn agent(endpoint: &Endpoint) -> Agent {
    let url = Url::parse(&endpoint.url).ok();
    let host = url.as_ref().and_then(Url::host_str).unwrap_or_default();
    reel_http::agent(host, endpoint.timeout)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolve(
        argument: Option<&str>,
        variables: &[(&str, &str)],
    ) -> Result<Option<Endpoint>, SendError> {
        let found = |name: &str| variables.iter().find(|(key, _)| *key == name);
        Endpoint::resolve(argument, |name| {
            found(name).map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn addresses_follow_the_specification() {
        let url = |argument, variables: &[(&str, &str)]| {
            resolve(argument, variables).map(|found| found.map(|endpoint| endpoint.url))
        };
        let of = |url: &str| Ok(Some(url.to_owned()));
        assert_eq!(url(None, &[]), Ok(None));
        assert_eq!(
            url(Some("http://h:4318"), &[]),
            of("http://h:4318/v1/traces")
        );
        assert_eq!(
            url(Some("https://h/otlp/"), &[]),
            of("https://h/otlp/v1/traces")
        );
        assert_eq!(
            url(Some("http://h/v1/traces"), &[]),
            of("http://h/v1/traces")
        );
        let of_all = ("OTEL_EXPORTER_OTLP_ENDPOINT", "http://all:4318/");
        let of_traces = ("OTEL_EXPORTER_OTLP_TRACES_ENDPOINT", "http://own:1/as/is");
        assert_eq!(url(None, &[of_all]), of("http://all:4318/v1/traces"));
        assert_eq!(url(None, &[of_all, of_traces]), of("http://own:1/as/is"));
        assert_eq!(url(Some("http://a"), &[of_all]), of("http://a/v1/traces"));
        assert_eq!(
            url(None, &[of_all, ("OTEL_SDK_DISABLED", "true")]),
            Ok(None)
        );
        for wrong in ["h:4318", "grpc://h", "http://", "", "http://me:secret@h"] {
            let error = url(Some(wrong), &[]).unwrap_err().to_string();
            assert!(!error.contains("secret"), "{error}");
        }
        let grpc = ("OTEL_EXPORTER_OTLP_PROTOCOL", "grpc");
        let error = url(None, &[of_all, grpc]).unwrap_err().to_string();
        assert!(error.contains("OTEL_EXPORTER_OTLP_PROTOCOL"), "{error}");
    }

    #[test]
    fn headers_are_percent_encoded() {
        let of = |text| resolve(Some("http://h"), &[("OTEL_EXPORTER_OTLP_HEADERS", text)]);
        let endpoint = of("Authorization=Bearer%20a%3Db, x-team = robots")
            .unwrap()
            .unwrap();
        let expected = [("authorization", "Bearer a=b"), ("x-team", "robots")];
        let found: Vec<(&str, &str)> = endpoint
            .headers
            .iter()
            .map(|(name, value)| (name.as_str(), value.as_str()))
            .collect();
        assert_eq!(found, expected);
        assert!(!format!("{endpoint:?}").contains("Bearer"));
        for wrong in ["a", "a=%zz", "a=%0a", "=b", "a b=c"] {
            assert!(of(wrong).is_err(), "{wrong}");
        }
    }
}
