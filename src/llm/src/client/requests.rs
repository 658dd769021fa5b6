//! Asking: the cache first, then the endpoint, again where that may help, and a line in the log.

use std::{io, sync::Arc, time::Duration};

use reel_http::ureq::{self, Agent, http::Uri};
use reel_world::{Digest, canonical_json};

use crate::client::{
    Cache, CallLog, Clock, Endpoint, LoggedCall, ModelError, Reply, Request,
    cache::CachedReply,
    error::excerpt,
    reply::{self, Answer, InvalidReply},
    request,
};

/// Longest answer that is read, in bytes.
const ANSWER_BYTES_MAX: u64 = 16 << 20;

/// A client of one endpoint, for any number of threads.
pub struct Client {
    endpoint: Endpoint,
    url: String,
    agent: Agent,
    clock: Arc<dyn Clock>,
    cache: Option<Cache>,
    log: Option<CallLog>,
}

impl Client {
    /// A client; nothing is asked yet.
    ///
    /// # Errors
    /// When the endpoint's address cannot be one.
    pub fn new(endpoint: Endpoint, clock: Arc<dyn Clock>) -> Result<Self, ModelError> {
        let url = endpoint.url()?;
        let agent = agent(&endpoint, &url)?;
        Ok(Self {
            endpoint,
            url,
            agent,
            clock,
            cache: None,
            log: None,
        })
    }

    /// Keeps replies, and gives kept ones.
    pub fn with_cache(self, cache: Cache) -> Self {
        Self {
            cache: Some(cache),
            ..self
        }
    }

    /// Adds a log that receives one line for every call.
    pub fn with_log(self, log: CallLog) -> Self {
        Self {
            log: Some(log),
            ..self
        }
    }

    /// The endpoint that the client sends its requests to.
    pub fn endpoint(&self) -> &Endpoint {
        &self.endpoint
    }

    /// Asks, and waits for the reply.
    ///
    /// # Errors
    /// When there is no reply after all tries, or it cannot be kept or logged as it should.
    pub fn complete(&self, request: &Request) -> Result<Reply, ModelError> {
        let body = canonical_json(&request::body(&self.endpoint, request));
        let digest = Digest::of(body.as_bytes());
        let time_ns = self.clock.now_ns();
        let kept = self.cache.as_ref().and_then(|cache| cache.get(&digest));
        let cached = kept.is_some();
        let (attempts, result) = match kept {
            Some(kept) => (0, Ok(kept)),
            None => self.ask_and_keep(&digest, &body, time_ns),
        };
        let tokens = result.as_ref().map_or([None; 2], |kept| {
            [kept.answer.tokens_read, kept.answer.tokens_written]
        });
        self.note(
            time_ns,
            digest,
            &self.url,
            (attempts, cached),
            tokens,
            result.as_ref().err(),
        )?;
        Ok(reply(result?, cached, digest))
    }

    /// The vectors of texts, by the endpoint's `/embeddings`, in the order of the texts. A cache
    /// keeps each text's vector.
    ///
    /// # Errors
    /// When there is no answer after all tries, or it cannot be kept or logged as it should.
    pub fn embed(&self, texts: &[&str]) -> Result<Vec<Vec<f32>>, ModelError> {
        let Some(cache) = &self.cache else {
            return self.request_vectors(texts);
        };
        let request =
            |text: &str| Digest::of_json(&request::embedding_body(&self.endpoint, &[text]));
        let mut vectors: Vec<Option<Vec<f32>>> =
            texts.iter().map(|text| cache.get(&request(text))).collect();
        let missing: Vec<usize> = (0..texts.len())
            .filter(|index| vectors[*index].is_none())
            .collect();
        if !missing.is_empty() {
            let asked: Vec<&str> = missing.iter().map(|index| texts[*index]).collect();
            for (index, vector) in missing.into_iter().zip(self.request_vectors(&asked)?) {
                cache.put(&request(texts[index]), &vector)?;
                vectors[index] = Some(vector);
            }
        }
        Ok(vectors.into_iter().flatten().collect())
    }

    fn request_vectors(&self, texts: &[&str]) -> Result<Vec<Vec<f32>>, ModelError> {
        let url = self.endpoint.embeddings_url()?;
        let body = canonical_json(&request::embedding_body(&self.endpoint, texts));
        let time_ns = self.clock.now_ns();
        let (attempts, result) =
            self.ask(&url, &body, |text| reply::parse_vectors(text, texts.len()));
        self.note(
            time_ns,
            Digest::of(body.as_bytes()),
            &url,
            (attempts, false),
            [None; 2],
            result.as_ref().err(),
        )?;
        result
    }

    /// A line of the log, where there is one.
    fn note(
        &self,
        time_ns: u64,
        request: Digest,
        url: &str,
        (attempts, cached): (u32, bool),
        [prompt_tokens, completion_tokens]: [Option<u32>; 2],
        error: Option<&ModelError>,
    ) -> Result<(), ModelError> {
        let Some(log) = &self.log else { return Ok(()) };
        log.write(&LoggedCall {
            time_ns,
            request,
            url: url.to_owned(),
            model: self.endpoint.model.clone(),
            attempts,
            cached,
            prompt_tokens,
            completion_tokens,
            latency_ns: self.clock.now_ns().saturating_sub(time_ns),
            error: error.map(ToString::to_string),
        })
    }

    /// The kept reply to a request, if there is one. Nobody is asked, and as no call is
    /// made none is logged.
    pub fn cached(&self, request: &Request) -> Option<Reply> {
        let digest = Digest::of(canonical_json(&request::body(&self.endpoint, request)).as_bytes());
        Some(reply(self.cache.as_ref()?.get(&digest)?, true, digest))
    }

    fn ask_and_keep(
        &self,
        digest: &Digest,
        body: &str,
        time_ns: u64,
    ) -> (u32, Result<CachedReply, ModelError>) {
        let (attempts, result) = self.ask(&self.url, body, |text| {
            reply::parse(text, self.endpoint.logprobs)
        });
        let result = result.and_then(|answer| {
            let kept = CachedReply {
                answer,
                latency_ns: self.clock.now_ns().saturating_sub(time_ns),
            };
            self.cache
                .as_ref()
                .map_or(Ok(()), |cache| cache.put(digest, kept.clone()))?;
            Ok(kept)
        });
        (attempts, result)
    }

    /// Asks until there is an answer or no hope of one; with how often it asked.
    fn ask<T>(
        &self,
        url: &str,
        body: &str,
        read: impl Fn(&str) -> Result<T, InvalidReply>,
    ) -> (u32, Result<T, ModelError>) {
        let mut attempts = 1;
        loop {
            match self.attempt(url, body, attempts, &read) {
                Ok(answer) => return (attempts, Ok(answer)),
                Err(failure)
                    if attempts > self.endpoint.retries || !failure.error.is_transient() =>
                {
                    return (attempts, Err(failure.error));
                }
                Err(failure) => {
                    self.clock
                        .sleep(reel_http::pause(attempts, failure.retry_after));
                    attempts += 1;
                }
            }
        }
    }

    fn attempt<T>(
        &self,
        url: &str,
        body: &str,
        attempts: u32,
        read: impl Fn(&str) -> Result<T, InvalidReply>,
    ) -> Result<T, Failure> {
        let broken = |error| Failure {
            error: self.broken(url, error, attempts),
            retry_after: None,
        };
        let mut post = self.agent.post(url).content_type("application/json");
        if let Some(key) = &self.endpoint.api_key {
            post = post.header("authorization", key.bearer());
        }
        let mut response = post.send(body).map_err(broken)?;
        let status = response.status();
        let retry_after = reel_http::retry_after(response.headers());
        let bytes = response
            .body_mut()
            .with_config()
            .limit(ANSWER_BYTES_MAX)
            .read_to_vec()
            .map_err(broken)?;
        let text = self.without_key(&String::from_utf8_lossy(&bytes));
        let url = url.to_owned();
        if !status.is_success() {
            let error = ModelError::Status {
                url,
                attempts,
                status: status.as_u16(),
                excerpt: excerpt(&text),
            };
            return Err(Failure { error, retry_after });
        }
        read(&text).map_err(|none| {
            let error = match none.cut {
                true => ModelError::Cut {
                    url,
                    attempts,
                    problem: none.reason,
                },
                false => ModelError::Answer {
                    url,
                    problem: none.reason,
                    excerpt: excerpt(&text),
                },
            };
            Failure {
                error,
                retry_after: None,
            }
        })
    }

    /// What the transport says, in our terms.
    fn broken(&self, url: &str, error: ureq::Error, attempts: u32) -> ModelError {
        let url = url.to_owned();
        let what = self.without_key(&error.to_string());
        match error {
            ureq::Error::Timeout(_) => ModelError::Timeout {
                url,
                attempts,
                timeout_s: self.endpoint.timeout.as_secs_f64(),
            },
            ureq::Error::HostNotFound | ureq::Error::ConnectionFailed => ModelError::Connect {
                url,
                attempts,
                problem: what,
            },
            ureq::Error::Io(error) => match error.kind() {
                io::ErrorKind::ConnectionRefused
                | io::ErrorKind::HostUnreachable
                | io::ErrorKind::NetworkUnreachable
                | io::ErrorKind::AddrNotAvailable => ModelError::Connect {
                    url,
                    attempts,
                    problem: what,
                },
                // rustls speaks through the connection it sits on
                io::ErrorKind::InvalidData => ModelError::Tls { url, problem: what },
                _ => ModelError::Cut {
                    url,
                    attempts,
                    problem: what,
                },
            },
            ureq::Error::Tls(_) | ureq::Error::Rustls(_) => ModelError::Tls { url, problem: what },
            ureq::Error::BodyExceedsLimit(_) | ureq::Error::BadUri(_) | ureq::Error::Http(_) => {
                ModelError::Answer {
                    url,
                    problem: what,
                    excerpt: excerpt(""),
                }
            }
            _ => ModelError::Cut {
                url,
                attempts,
                problem: what,
            },
        }
    }

    fn without_key(&self, text: &str) -> String {
        self.endpoint
            .api_key
            .as_ref()
            .map_or_else(|| text.to_owned(), |key| key.redact(text))
    }
}

fn reply(kept: CachedReply, cached: bool, request: Digest) -> Reply {
    let CachedReply {
        answer:
            Answer {
                text,
                calls,
                truncated,
                tokens_read,
                tokens_written,
                logprobs,
            },
        latency_ns,
    } = kept;
    Reply {
        text,
        calls,
        truncated,
        tokens_read,
        tokens_written,
        logprobs,
        latency_ns,
        cached,
        request,
    }
}

struct Failure {
    error: ModelError,
    retry_after: Option<Duration>,
}

fn agent(endpoint: &Endpoint, url: &str) -> Result<Agent, ModelError> {
    let uri: Uri = url.parse().map_err(|_| ModelError::BaseUrl {
        problem: "it cannot be read",
    })?;
    let host = uri.host().ok_or(ModelError::BaseUrl {
        problem: "it names no host",
    })?;
    Ok(reel_http::agent(host, endpoint.timeout))
}
