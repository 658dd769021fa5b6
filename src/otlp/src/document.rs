//! Requests as bytes: protobuf, OTLP/JSON, files with many of them as the collector's file exporter writes
//! them, gzip around any of these.

use std::io::Read as _;

use flate2::read::MultiGzDecoder;
use prost::Message as _;
use serde::Deserialize as _;

use crate::{
    ExportTraceServiceRequest, InstrumentationScope, Resource, ResourceSpans, ScopeSpans, Span,
};

/// How the bytes of a gzip stream begin.
const GZIP: &[u8] = &[0x1F, 0x8B];
/// How far a file is searched for the name that makes it one of spans.
const NAME_WITHIN: usize = 64 << 10;

/// An encoding of OTLP.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Format {
    /// The binary encoding of protobuf.
    Protobuf,
    /// OTLP/JSON, which is not the JSON of protobuf: ids are hexadecimal.
    Json,
}

impl Format {
    /// What HTTP calls it.
    pub fn media_type(self) -> &'static str {
        match self {
            Format::Protobuf => "application/x-protobuf",
            Format::Json => "application/json",
        }
    }

    /// The encoding that a `Content-Type` names; `None` if OTLP has no such.
    pub fn of_media_type(text: &str) -> Option<Self> {
        let name = text.split(';').next().unwrap_or_default().trim();
        [Format::Protobuf, Format::Json]
            .into_iter()
            .find(|format| name.eq_ignore_ascii_case(format.media_type()))
    }
}

/// Why bytes are no spans.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum PayloadError {
    /// Not JSON, or JSON of something else.
    #[error("not OTLP/JSON: {0}")]
    Json(String),
    /// Not protobuf, or the protobuf of something else.
    #[error("not OTLP in protobuf: {0}")]
    Protobuf(String),
    /// Compressed bytes that are none.
    #[error("gzip cannot be read: {0}")]
    Gzip(String),
    /// More bytes than are read.
    #[error("more than {limit} bytes after decompression, which are read at most")]
    TooLarge { limit: u64 },
}

/// One request.
///
/// # Errors
/// When the bytes are no request in that encoding.
pub fn decode_request(
    bytes: &[u8],
    format: Format,
) -> Result<ExportTraceServiceRequest, PayloadError> {
    match format {
        Format::Protobuf => ExportTraceServiceRequest::decode(bytes)
            .map_err(|error| PayloadError::Protobuf(error.to_string())),
        Format::Json => {
            serde_json::from_slice(bytes).map_err(|error| PayloadError::Json(error.to_string()))
        }
    }
}

/// The requests of a file in any of the forms: one message or one document, JSON documents one after another or in
/// a list, messages each behind its length (four bytes, the first one highest). What follows a broken one is
/// lost, and said.
pub fn decode(bytes: &[u8]) -> (Vec<ExportTraceServiceRequest>, Option<PayloadError>) {
    let text = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    match text.trim_ascii_start().first() {
        Some(b'{') => json_documents(text),
        Some(b'[') => match serde_json::from_slice(text) {
            Ok(list) => (list, None),
            Err(error) => (Vec::new(), Some(PayloadError::Json(error.to_string()))),
        },
        _ if bytes.first() == Some(&0) => behind_lengths(bytes),
        _ => match decode_request(bytes, Format::Protobuf) {
            Ok(request) => (vec![request], None),
            Err(error) => (Vec::new(), Some(error)),
        },
    }
}

fn json_documents(text: &[u8]) -> (Vec<ExportTraceServiceRequest>, Option<PayloadError>) {
    let mut reader = serde_json::Deserializer::from_slice(text);
    let mut found = Vec::new();
    loop {
        // Between documents there is white space alone.
        match reader.end() {
            Ok(()) => return (found, None),
            Err(_) => match ExportTraceServiceRequest::deserialize(&mut reader) {
                Ok(request) => found.push(request),
                Err(error) => return (found, Some(PayloadError::Json(error.to_string()))),
            },
        }
    }
}

fn behind_lengths(mut bytes: &[u8]) -> (Vec<ExportTraceServiceRequest>, Option<PayloadError>) {
    let mut found = Vec::new();
    while !bytes.is_empty() {
        let cut = || PayloadError::Protobuf("the last message is cut".to_owned());
        let Some((length, rest)) = bytes.split_first_chunk::<4>() else {
            return (found, Some(cut()));
        };
        let length = u32::from_be_bytes(*length) as usize;
        let Some((message, rest)) = rest.split_at_checked(length) else {
            return (found, Some(cut()));
        };
        match decode_request(message, Format::Protobuf) {
            Ok(request) => found.push(request),
            Err(error) => return (found, Some(error)),
        }
        bytes = rest;
    }
    (found, None)
}

/// Whether the beginning of a file with one of these names may be one of spans: JSON has to name them.
pub fn is_document(extension: &str, beginning: &[u8]) -> bool {
    match extension {
        "json" | "jsonl" | "ndjson" => {
            let within = &beginning[..beginning.len().min(NAME_WITHIN)];
            let name = b"\"resourceSpans\"";
            within.windows(name.len()).any(|part| part == name)
        }
        "pb" | "binpb" | "otlp" => true,
        _ => false,
    }
}

/// A request in protobuf. Requests one after another are one request with the spans of all.
pub fn encode(request: &ExportTraceServiceRequest) -> Vec<u8> {
    request.encode_to_vec()
}

/// A request as one line of OTLP/JSON, as the collector's file exporter writes it.
///
/// # Errors
/// When a value cannot be JSON, which none is.
pub fn json_line(request: &ExportTraceServiceRequest) -> serde_json::Result<Vec<u8>> {
    let mut line = serde_json::to_vec(request)?;
    line.push(b'\n');
    Ok(line)
}

/// The bytes within gzip, or the bytes themselves where they are not compressed.
///
/// # Errors
/// When they are more than `limit`, or the compression is broken.
pub fn gunzip(bytes: Vec<u8>, limit: u64) -> Result<Vec<u8>, PayloadError> {
    if !bytes.starts_with(GZIP) {
        return match bytes.len() as u64 > limit {
            true => Err(PayloadError::TooLarge { limit }),
            false => Ok(bytes),
        };
    }
    let mut plain = Vec::new();
    MultiGzDecoder::new(bytes.as_slice())
        .take(limit.saturating_add(1))
        .read_to_end(&mut plain)
        .map_err(|error| PayloadError::Gzip(error.to_string()))?;
    match plain.len() as u64 > limit {
        true => Err(PayloadError::TooLarge { limit }),
        false => Ok(plain),
    }
}

/// Spans as requests of at most so many bytes each, in their order. A larger span is alone in its request.
pub fn batches(
    resource: &Resource,
    scope: &InstrumentationScope,
    spans: Vec<Span>,
    bytes_max: usize,
) -> Vec<ExportTraceServiceRequest> {
    let (mut requests, mut open, mut bytes) = (Vec::new(), Vec::new(), 0);
    let request = |spans| ExportTraceServiceRequest {
        resource_spans: vec![ResourceSpans {
            resource: Some(resource.clone()),
            scope_spans: vec![ScopeSpans {
                scope: Some(scope.clone()),
                spans,
                schema_url: String::new(),
            }],
            schema_url: String::new(),
        }],
    };
    for span in spans {
        let size = span.encoded_len();
        if !open.is_empty() && bytes + size > bytes_max {
            requests.push(request(std::mem::take(&mut open)));
            bytes = 0;
        }
        bytes += size;
        open.push(span);
    }
    if !open.is_empty() {
        requests.push(request(open));
    }
    requests
}

/// How many spans a request holds.
pub fn span_count(request: &ExportTraceServiceRequest) -> u64 {
    let scopes = request.resource_spans.iter().flat_map(|of| &of.scope_spans);
    scopes.map(|scope| scope.spans.len() as u64).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{KeyValue, any_value::Value, span::Event, to_hex};

    fn request() -> ExportTraceServiceRequest {
        let span = Span {
            trace_id: vec![7; 16],
            span_id: vec![1; 8],
            name: "chat".to_owned(),
            kind: 3,
            start_time_unix_nano: u64::MAX,
            attributes: vec![
                KeyValue::new("text", "a"),
                KeyValue::new("flag", true),
                KeyValue::new("int", i64::MIN),
                KeyValue::new("double", f64::NEG_INFINITY),
                KeyValue::new("list", vec!["x".to_owned()]),
                KeyValue::new("bytes", Value::BytesValue(vec![0, 255])),
            ],
            events: vec![Event {
                time_unix_nano: 1,
                name: "e".to_owned(),
                ..Event::default()
            }],
            ..Span::default()
        };
        let mut requests = batches(
            &Resource::default(),
            &InstrumentationScope::default(),
            vec![span],
            1 << 20,
        );
        requests.remove(0)
    }

    #[test]
    fn both_encodings_come_back() {
        let request = request();
        let line = json_line(&request).unwrap();
        assert_eq!(decode_request(&line, Format::Json).unwrap(), request);
        assert_eq!(
            decode_request(&encode(&request), Format::Protobuf).unwrap(),
            request
        );
        let json: serde_json::Value = serde_json::from_slice(&line).unwrap();
        let span = &json["resourceSpans"][0]["scopeSpans"][0]["spans"][0];
        assert_eq!(span["traceId"], to_hex(&[7; 16]));
        assert_eq!(span["startTimeUnixNano"], u64::MAX.to_string());
        assert_eq!(
            span["attributes"][2]["value"]["intValue"],
            i64::MIN.to_string()
        );
        assert_eq!(span["attributes"][3]["value"]["doubleValue"], "-Infinity");
        assert_eq!(span["attributes"][5]["value"]["bytesValue"], "AP8=");
    }

    #[test]
    fn files_in_all_forms_are_read() {
        let request = request();
        let line = json_line(&request).unwrap();
        let bytes = encode(&request);
        let mut behind = (bytes.len() as u32).to_be_bytes().to_vec();
        behind.extend(&bytes);
        let pretty = serde_json::to_vec_pretty(&request).unwrap();
        let list = serde_json::to_vec(&[&request, &request]).unwrap();
        for (file, count) in [
            ([&line[..], &line].concat(), 2),
            (pretty, 1),
            (list, 2),
            (bytes.clone(), 1),
            ([&behind[..], &behind].concat(), 2),
        ] {
            let (found, error) = decode(&file);
            assert_eq!((found.len(), error), (count, None));
            assert!(found.iter().all(|one| *one == request));
        }
        // Two messages one after another are one with the spans of both.
        let (found, error) = decode(&[&bytes[..], &bytes].concat());
        assert_eq!((found.len(), error), (1, None));
        assert_eq!(span_count(&found[0]), 2);
        // Cut files give what is whole in them.
        let (found, error) = decode(&[&line[..], &line[..line.len() / 2]].concat());
        assert_eq!((found.len(), error.is_some()), (1, true));
        let (found, error) = decode(&[&behind[..], &behind[..9]].concat());
        assert_eq!((found.len(), error.is_some()), (1, true));
        assert!(decode(b"none").1.is_some());
        assert!(decode(b"{\"resourceSpans\": 3}").1.is_some());
    }

    #[test]
    fn other_exporters_are_read_leniently() {
        let text = br#"{"resourceSpans": [{"scopeSpans": [{"spans": [{"traceId": "0A", "spanId": "ff", "parentSpanId": null,
            "kind": "SPAN_KIND_CLIENT", "startTimeUnixNano": 5, "status": {"code": "STATUS_CODE_ERROR"}, "unknown": {},
            "attributes": [{"key": "n", "value": {"intValue": 3}}, {"key": "none"}, {"key": "empty", "value": {}}]}]}]}]}"#;
        let request = decode_request(text, Format::Json).unwrap();
        let span = &request.resource_spans[0].scope_spans[0].spans[0];
        assert_eq!((span.kind, span.start_time_unix_nano), (3, 5));
        assert_eq!(span.status.as_ref().unwrap().code, 2);
        assert_eq!(span.trace_id, [10]);
        let values: Vec<_> = span
            .attributes
            .iter()
            .map(|pair| pair.value.as_ref().map(|value| value.to_json()))
            .collect();
        assert_eq!(
            values,
            [Some(3.into()), None, Some(serde_json::Value::Null)]
        );
        // What is no id is an empty one, for which its span alone is refused.
        let odd = br#"{"resourceSpans": [{"scopeSpans": [{"spans": [{"traceId": "xyz"}]}]}]}"#;
        let odd = decode_request(odd, Format::Json).unwrap();
        assert!(
            odd.resource_spans[0].scope_spans[0].spans[0]
                .trace_id
                .is_empty()
        );
    }

    #[test]
    fn compressed_bytes_have_a_limit() {
        use std::io::Write as _;
        let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        gzip.write_all(&[0; 10_000]).unwrap();
        let gzip = gzip.finish().unwrap();
        assert_eq!(gunzip(gzip.clone(), 10_000).unwrap().len(), 10_000);
        assert_eq!(
            gunzip(gzip.clone(), 9_999),
            Err(PayloadError::TooLarge { limit: 9_999 })
        );
        assert!(gunzip(gzip[..gzip.len() / 2].to_vec(), 10_000).is_err());
        assert_eq!(gunzip(b"plain".to_vec(), 5).unwrap(), b"plain");
        assert!(gunzip(b"plain".to_vec(), 4).is_err());
    }

    #[test]
    fn batches_stay_below_their_size() {
        let span = |size: usize| Span {
            name: "x".repeat(size),
            ..Span::default()
        };
        let (resource, scope) = Default::default();
        let spans = vec![span(600), span(300), span(300), span(5_000), span(10)];
        let made = batches(&resource, &scope, spans, 1_000);
        let counts: Vec<u64> = made.iter().map(span_count).collect();
        assert_eq!(counts, [2, 1, 1, 1]);
        assert!(batches(&resource, &scope, Vec::new(), 1_000).is_empty());
    }

    proptest::proptest! {
        #![proptest_config(proptest::prelude::ProptestConfig::with_cases(256))]

        /// No bytes, and no cut or changed file, make a reader panic.
        #[test]
        fn no_bytes_make_a_reader_panic(
            bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..200),
            at in 0usize..400,
            byte in proptest::num::u8::ANY,
        ) {
            let _ = decode(&bytes);
            let _ = gunzip([GZIP, &bytes].concat(), 1_000);
            for mut file in [encode(&request()), json_line(&request()).unwrap()] {
                let at = at % file.len();
                let _ = decode(&file[..at]);
                file[at] = byte;
                let _ = decode(&file);
            }
        }
    }
}
