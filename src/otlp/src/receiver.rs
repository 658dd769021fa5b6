//! Spans as a collector takes them: what a request has to be, what is answered, and which traces are complete.
//! Opens no socket and knows no clock: time is an argument.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use prost::Message;

use crate::{
    ExportTracePartialSuccess, ExportTraceServiceRequest, ExportTraceServiceResponse, Format,
    ResourceSpans, ScopeSpans, decode_request, gunzip, to_hex,
};

/// Most bytes of a request once it is decompressed.
const BYTES_MAX: u64 = 64 << 20;
/// `INVALID_ARGUMENT` of gRPC, which OTLP has in answers.
const INVALID: i32 = 3;
/// `UNAVAILABLE` of gRPC, which OTLP has in answers.
const UNAVAILABLE: i32 = 14;

/// An answer to a request over HTTP.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct HttpAnswer {
    /// The status of HTTP.
    pub status: u16,
    /// The encoding of the body, which is that of the request.
    pub format: Format,
    /// The body in that encoding.
    pub body: Vec<u8>,
}

/// `google.rpc.Status`, which OTLP answers where it takes nothing.
#[derive(Clone, PartialEq, Message, serde::Serialize)]
struct RpcStatus {
    #[prost(int32, tag = "1")]
    code: i32,
    #[prost(string, tag = "2")]
    message: String,
}

impl HttpAnswer {
    /// Nothing was taken. Status 503 lets exporters try again, the others do not.
    pub fn refused(format: Format, status: u16, message: String) -> Self {
        let code = if status == 503 { UNAVAILABLE } else { INVALID };
        let told = RpcStatus { code, message };
        let body = match format {
            Format::Protobuf => told.encode_to_vec(),
            Format::Json => serde_json::to_vec(&told).unwrap_or_default(),
        };
        Self {
            status,
            format,
            body,
        }
    }

    /// All was taken but for so many spans.
    pub fn taken(format: Format, rejected: u64, message: String) -> Self {
        let partial = ExportTracePartialSuccess {
            rejected_spans: i64::try_from(rejected).unwrap_or(i64::MAX),
            error_message: message,
        };
        let told = ExportTraceServiceResponse {
            partial_success: (partial != ExportTracePartialSuccess::default()).then_some(partial),
        };
        let body = match format {
            Format::Protobuf => told.encode_to_vec(),
            Format::Json => serde_json::to_vec(&told).unwrap_or_default(),
        };
        Self {
            status: 200,
            format,
            body,
        }
    }
}

/// The request in a body, by its `Content-Type` and `Content-Encoding`.
///
/// # Errors
/// What is answered instead, where it is none.
pub fn receive(
    content_type: Option<&str>,
    content_encoding: Option<&str>,
    body: Vec<u8>,
) -> Result<(Format, ExportTraceServiceRequest), HttpAnswer> {
    let format = content_type
        .and_then(Format::of_media_type)
        .ok_or_else(|| {
            let message = "send application/x-protobuf or application/json".to_owned();
            HttpAnswer::refused(Format::Json, 415, message)
        })?;
    let refuse = |status, message| HttpAnswer::refused(format, status, message);
    let bytes = match content_encoding.unwrap_or("identity") {
        "identity" | "" => body,
        "gzip" => gunzip(body, BYTES_MAX).map_err(|error| {
            let status = match error {
                crate::PayloadError::TooLarge { .. } => 413,
                _ => 400,
            };
            refuse(status, error.to_string())
        })?,
        other => {
            let message = format!(
                "encoding '{}' is not read; send gzip or none",
                other.escape_debug()
            );
            return Err(refuse(415, message));
        }
    };
    match decode_request(&bytes, format) {
        Ok(request) => Ok((format, request)),
        Err(error) => Err(refuse(400, error.to_string())),
    }
}

/// Bounds of what waits.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PendingLimits {
    /// Most bytes of all spans that wait.
    pub bytes: usize,
    /// Most spans of one trace; further ones are rejected.
    pub spans_of_trace: usize,
    /// How long a trace whose root is there has to be quiet until it is complete.
    pub quiet: Duration,
    /// The same, of a trace whose root did not come.
    pub quiet_without_root: Duration,
}

impl Default for PendingLimits {
    fn default() -> Self {
        Self {
            bytes: 256 << 20,
            spans_of_trace: 100_000,
            quiet: Duration::from_secs(5),
            quiet_without_root: Duration::from_secs(120),
        }
    }
}

/// Traces of which more spans may come.
#[derive(Debug)]
pub struct PendingTraces {
    limits: PendingLimits,
    traces: BTreeMap<Vec<u8>, PendingTrace>,
    bytes: usize,
}

#[derive(Debug)]
struct PendingTrace {
    parts: Vec<ResourceSpans>,
    spans: usize,
    bytes: usize,
    has_root: bool,
    last: Instant,
}

impl PendingTraces {
    /// Begins without any trace.
    pub fn new(limits: PendingLimits) -> Self {
        Self {
            limits,
            traces: BTreeMap::new(),
            bytes: 0,
        }
    }

    /// Takes the spans of a request; the answer says which were rejected, or that there is no room now.
    pub fn add(
        &mut self,
        format: Format,
        request: ExportTraceServiceRequest,
        now: Instant,
    ) -> HttpAnswer {
        let size = request.encoded_len();
        if self.bytes.saturating_add(size) > self.limits.bytes {
            let message = "too many spans wait for their traces to end; try again".to_owned();
            return HttpAnswer::refused(format, 503, message);
        }
        let (mut without_id, mut too_many) = (0, 0);
        for of_resource in request.resource_spans {
            for of_scope in of_resource.scope_spans {
                let mut by_trace: BTreeMap<Vec<u8>, Vec<_>> = BTreeMap::new();
                for span in of_scope.spans {
                    let has_id = span.trace_id.len() == 16
                        && span.span_id.len() == 8
                        && span.trace_id.iter().any(|byte| *byte != 0);
                    if has_id {
                        let of_trace = by_trace.entry(span.trace_id.clone()).or_default();
                        of_trace.push(span);
                    } else {
                        without_id += 1;
                    }
                }
                for (id, mut spans) in by_trace {
                    let trace = self.traces.entry(id).or_insert_with(|| PendingTrace {
                        parts: Vec::new(),
                        spans: 0,
                        bytes: 0,
                        has_root: false,
                        last: now,
                    });
                    let room = self.limits.spans_of_trace.saturating_sub(trace.spans);
                    too_many += spans.len().saturating_sub(room);
                    spans.truncate(room);
                    trace.last = now;
                    trace.spans += spans.len();
                    trace.has_root |= spans.iter().any(|span| span.parent_span_id.is_empty());
                    let part = ResourceSpans {
                        resource: of_resource.resource.clone(),
                        scope_spans: vec![ScopeSpans {
                            scope: of_scope.scope.clone(),
                            spans,
                            schema_url: of_scope.schema_url.clone(),
                        }],
                        schema_url: of_resource.schema_url.clone(),
                    };
                    let size = part.encoded_len();
                    trace.parts.push(part);
                    trace.bytes += size;
                    self.bytes += size;
                }
            }
        }
        let limit = self.limits.spans_of_trace;
        let reasons = [
            (
                without_id,
                "spans without a trace id of 16 and a span id of 8 bytes".to_owned(),
            ),
            (
                too_many,
                format!("spans of a trace that has {limit} already"),
            ),
        ];
        let told = reasons.iter().filter(|(count, _)| *count > 0);
        let told: Vec<String> = told.map(|(count, why)| format!("{count} {why}")).collect();
        HttpAnswer::taken(format, (without_id + too_many) as u64, told.join("; "))
    }

    /// Takes out the traces that are complete: their id in hexadecimal digits, and their spans.
    pub fn complete(&mut self, now: Instant) -> Vec<(String, ExportTraceServiceRequest)> {
        let limits = self.limits;
        let is_complete = |trace: &PendingTrace| {
            let quiet = match trace.has_root {
                true => limits.quiet,
                false => limits.quiet_without_root,
            };
            now.saturating_duration_since(trace.last) >= quiet
        };
        self.take(is_complete)
    }

    /// Takes out all traces, at the end.
    pub fn take_all(&mut self) -> Vec<(String, ExportTraceServiceRequest)> {
        self.take(|_| true)
    }

    fn take(
        &mut self,
        is_due: impl Fn(&PendingTrace) -> bool,
    ) -> Vec<(String, ExportTraceServiceRequest)> {
        let due: Vec<Vec<u8>> = self
            .traces
            .iter()
            .filter(|(_, trace)| is_due(trace))
            .map(|(id, _)| id.clone())
            .collect();
        due.into_iter()
            .filter_map(|id| {
                let trace = self.traces.remove(&id)?;
                self.bytes -= trace.bytes;
                let request = ExportTraceServiceRequest {
                    resource_spans: trace.parts,
                };
                Some((to_hex(&id), request))
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;
    use crate::{InstrumentationScope, Resource, Span, batches, encode, json_line, span_count};

    fn span(trace: u8, id: u8, parent: u8) -> Span {
        let of = |byte: u8| if byte == 0 { Vec::new() } else { vec![byte; 8] };
        Span {
            trace_id: vec![trace; 16],
            span_id: of(id),
            parent_span_id: of(parent),
            ..Span::default()
        }
    }

    fn request(spans: Vec<Span>) -> ExportTraceServiceRequest {
        let (resource, scope) = (Resource::default(), InstrumentationScope::default());
        batches(&resource, &scope, spans, 1 << 20).remove(0)
    }

    fn partial(answer: &HttpAnswer) -> (i64, String) {
        assert_eq!(answer.status, 200);
        let told = ExportTraceServiceResponse::decode(&answer.body[..]).unwrap();
        let told = told.partial_success.unwrap_or_default();
        (told.rejected_spans, told.error_message)
    }

    #[test]
    fn bodies_are_read_by_their_headers() {
        let request = request(vec![span(1, 1, 0)]);
        let (protobuf, json) = (encode(&request), json_line(&request).unwrap());
        let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        gzip.write_all(&protobuf).unwrap();
        let gzip = gzip.finish().unwrap();
        let media = Some("application/x-protobuf");
        for (kind, encoding, body) in [
            (media, None, protobuf.clone()),
            (
                Some("Application/JSON; charset=utf-8"),
                Some("identity"),
                json.clone(),
            ),
            (media, Some("gzip"), gzip.clone()),
        ] {
            assert_eq!(receive(kind, encoding, body).unwrap().1, request);
        }
        let status = |kind, encoding, body: &[u8]| {
            receive(kind, encoding, body.to_vec()).unwrap_err().status
        };
        assert_eq!(status(None, None, &protobuf), 415);
        assert_eq!(status(Some("text/plain"), None, &protobuf), 415);
        assert_eq!(status(media, Some("br"), &protobuf), 415);
        assert_eq!(status(media, None, &json), 400);
        assert_eq!(status(media, Some("gzip"), &gzip[..9]), 400);
        let refused = receive(Some("application/json"), None, b"{".to_vec()).unwrap_err();
        let told: serde_json::Value = serde_json::from_slice(&refused.body).unwrap();
        assert!(told["message"].as_str().unwrap().contains("not OTLP/JSON"));
        let refused = receive(media, None, b"none".to_vec()).unwrap_err();
        assert_eq!(RpcStatus::decode(&refused.body[..]).unwrap().code, INVALID);
    }

    #[test]
    fn traces_are_complete_when_they_are_quiet() {
        let limits = PendingLimits {
            bytes: 1_000,
            spans_of_trace: 3,
            ..PendingLimits::default()
        };
        let mut pending = PendingTraces::new(limits);
        let begun = Instant::now();
        let at = |seconds| begun + Duration::from_secs(seconds);
        let add = |pending: &mut PendingTraces, spans, seconds| {
            pending.add(Format::Protobuf, request(spans), at(seconds))
        };
        let odd = Span {
            span_id: vec![1],
            ..span(3, 1, 0)
        };
        let answer = add(&mut pending, vec![span(1, 2, 1), span(2, 2, 1), odd], 0);
        let (rejected, why) = partial(&answer);
        assert_eq!(rejected, 1);
        assert!(why.contains("span id"), "{why}");
        assert_eq!(partial(&add(&mut pending, vec![span(1, 1, 0)], 3)).0, 0);
        assert!(pending.complete(at(7)).is_empty());
        let complete = pending.complete(at(8));
        assert_eq!(complete.len(), 1);
        assert_eq!(
            (complete[0].0.as_str(), span_count(&complete[0].1)),
            (&"01".repeat(16)[..], 2)
        );
        // Without its root a trace waits longer.
        assert!(pending.complete(at(100)).is_empty());
        let (rejected, why) = partial(&add(
            &mut pending,
            vec![span(2, 3, 1), span(2, 4, 1), span(2, 5, 1)],
            100,
        ));
        assert_eq!(rejected, 1);
        assert!(why.contains("that has 3 already"), "{why}");
        assert!(pending.complete(at(219)).is_empty());
        assert_eq!(span_count(&pending.complete(at(220))[0].1), 3);
        assert_eq!(pending.bytes, 0);
        // Without room exporters try again.
        let large = Span {
            name: "x".repeat(999),
            ..span(4, 1, 0)
        };
        assert_eq!(add(&mut pending, vec![large], 300).status, 503);
        add(&mut pending, vec![span(5, 1, 2)], 300);
        assert_eq!(pending.take_all().len(), 1);
        assert!(pending.take_all().is_empty());
    }
}
