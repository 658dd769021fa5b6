//! Traces as spans of OpenTelemetry, and read again; spans of other agents are in [`foreign`].

mod foreign;

use std::{collections::BTreeSet, path::Path};

use reel_import::{
    ImportedEpisode,
    otel::{self, ImageParts, LOST, SpanClock, SpanFiles, SpanOptions},
};
use reel_otlp::{ExportTraceServiceRequest, Format, decode_request, encode, json_line, span_count};
use reel_trace::{Images, Recorder, Trace};
use reel_vectors::{
    golden_traces,
    round_trip::{self, LostFields},
};
use reel_world::{Frame, ToolCall, record::PolicyOutput};
use serde_json::{Value, json};

use crate::PLAIN;

/// What the golden traces lack, or what is not compared here.
const ABSENT: &[&str] = &["header.parent", "header.policy.parameters"];

/// The trace as if a model had decided it: with words that other formats could take for something else.
fn with_words(trace: &Trace, folder: &Path) -> Trace {
    let path = folder.join("words.mcap");
    let mut header = trace.header.clone();
    let settings = [("model", "a-model"), ("system_prompt", "You are a robot.")];
    header
        .policy
        .parameters
        .extend(settings.map(|(name, value)| (name.to_owned(), value.into())));
    let frame = |step| {
        let rgb = trace.frame_rgb(step).unwrap()?;
        Some(Frame::of_rgb(rgb))
    };
    let mut recorder =
        Recorder::create(&path, &header, &trace.task, &trace.scene, Images::Full).unwrap();
    recorder.start(&trace.start, frame(None).as_ref()).unwrap();
    for record in &trace.steps {
        let mut record = record.clone();
        let step = record.step;
        record.input.policy = (step % 4 != 3).then(|| PolicyOutput {
            raw: ["", "Now \"this\".", r#"[{"type": "text", "content": "x"}]"#][step as usize % 3]
                .to_owned(),
            reasoning: if step % 2 == 0 {
                "Because.\nSo.".to_owned()
            } else {
                String::new()
            },
            history: "what was".to_owned(),
            tokens: (step % 3 != 2).then_some([100 + step, step]),
            latency_ns: (step % 2 == 1).then_some(5_000_000),
            ..PolicyOutput::default()
        });
        if step % 7 == 5 {
            record.input.call = ToolCall::new("message", json!({}));
            record.tool = None;
        }
        if step % 5 == 2 {
            record.outcome.text = r#"[{"type": "text", "content": "quoted"}]"#.to_owned();
        }
        if step % 5 == 4 {
            record.outcome.text = r#""quoted""#.to_owned();
        }
        recorder.input(step, &record.input).unwrap();
        recorder.step(&record, frame(Some(step)).as_ref()).unwrap();
    }
    if let Some(end) = &trace.end {
        recorder.end(end).unwrap();
    }
    Trace::read(&path).unwrap()
}

fn one(spans: &SpanFiles, out: &Path) -> ImportedEpisode {
    assert_eq!(spans.episodes.len(), 1);
    otel::import(&spans.episodes[0], out, &PLAIN, None, None)
        .unwrap_or_else(|error| panic!("{error}"))
}

/// Every span through both encodings.
fn carried(requests: Vec<ExportTraceServiceRequest>) -> Vec<ExportTraceServiceRequest> {
    let through = |request: ExportTraceServiceRequest| {
        let line = json_line(&request).unwrap();
        assert_eq!(decode_request(&line, Format::Json).unwrap(), request);
        decode_request(&encode(&request), Format::Protobuf).unwrap()
    };
    requests.into_iter().map(through).collect()
}

#[test]
fn every_golden_trace_comes_back_but_for_what_is_listed() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let tools = [
        json!({"type": "function", "function": {"name": "pick", "description": "Picks.", "parameters": {"type": "object"}}}),
    ];
    let mut lost = LostFields::default();
    for (number, path) in golden_traces().iter().enumerate() {
        let mut trace = Trace::read(path).unwrap();
        if number % 2 == 0 {
            trace = with_words(&trace, folder);
        }
        for images in [ImageParts::Blob, ImageParts::Reference] {
            let options = SpanOptions {
                images,
                ..SpanOptions::default()
            };
            let requests = otel::requests(&trace, &tools, &options).unwrap();
            assert_eq!(requests, otel::requests(&trace, &tools, &options).unwrap());
            for request in &requests {
                let bytes = encode(request).len();
                assert!(
                    span_count(request) == 1 || bytes < otel::REQUEST_BYTES_MAX + 4096,
                    "{bytes}"
                );
            }
            let read = otel::read_requests(path, carried(requests)).unwrap();
            assert_eq!((read.losses.len(), read.without_agent), (0, 0));
            let imported = one(&read, folder);
            let name = path.display();
            assert_eq!(imported.losses, [], "{name}");
            let after = Trace::read(&imported.trace).unwrap();
            let (before, mut after) = (round_trip::parts(&trace), round_trip::parts(&after));
            let blank = before["images"]
                .as_array()
                .unwrap()
                .iter()
                .map(|_| Value::Null)
                .collect::<Value>();
            if images == ImageParts::Reference {
                assert_eq!(after["images"], blank, "{name}");
                after["images"] = before["images"].clone();
            }
            lost.compare(&before, &after);
        }
    }
    let _ = lost.expect_listed(LOST.iter().map(|(field, _)| *field), ABSENT);
}

#[test]
fn spans_follow_the_conventions() {
    let folder = tempfile::tempdir().unwrap();
    let path = golden_traces()
        .into_iter()
        .find(|path| path.to_string_lossy().contains("workshop_errors"))
        .unwrap();
    let trace = with_words(&Trace::read(&path).unwrap(), folder.path());
    let spans = otel::export(&trace, &[], &SpanOptions::default()).unwrap();
    let (root, rest) = spans.split_first().unwrap();
    assert!(root.parent_span_id.is_empty());
    assert_eq!(
        root.name,
        format!("invoke_agent {}", trace.header.policy.name)
    );
    let mut ids = BTreeSet::new();
    for span in rest {
        assert_eq!(
            (&span.trace_id, &span.parent_span_id),
            (&root.trace_id, &root.span_id)
        );
        assert!(ids.insert(&span.span_id) && span.span_id.len() == 8 && span.trace_id.len() == 16);
        assert!(root.start_time_unix_nano <= span.start_time_unix_nano);
        assert!(span.start_time_unix_nano < span.end_time_unix_nano);
        assert!(span.end_time_unix_nano <= root.end_time_unix_nano);
    }
    let value = |span: &reel_otlp::Span, key: &str| {
        let found = span.attributes.iter().find(|pair| pair.key == key)?;
        Some(found.value.as_ref()?.to_json())
    };
    let of = |name: &'static str| {
        let is = move |span: &&reel_otlp::Span| {
            value(span, "gen_ai.operation.name") == Some(name.into())
        };
        rest.iter().filter(is)
    };
    let silent = trace
        .steps
        .iter()
        .filter(|step| step.input.call.name == "message");
    assert_eq!(
        of("execute_tool").count() + silent.count(),
        trace.steps.len()
    );
    let has_failed = |step: &reel_world::record::StepRecord| {
        step.outcome.error.is_some() && step.input.call.name != "message"
    };
    let failed = trace.steps.iter().filter(|step| has_failed(step)).count();
    assert!(failed > 0);
    assert_eq!(
        of("execute_tool")
            .filter(|span| value(span, "error.type").is_some())
            .count(),
        failed
    );
    assert_eq!(
        of("execute_tool")
            .filter(|span| span.status.as_ref().is_some_and(|it| it.code == 2))
            .count(),
        failed
    );
    let read: u64 = of("chat")
        .filter_map(|span| value(span, "gen_ai.usage.input_tokens")?.as_u64())
        .sum();
    let expected = trace
        .steps
        .iter()
        .filter_map(|step| step.input.policy.as_ref()?.tokens);
    assert_eq!(read, expected.map(|[read, _]| u64::from(read)).sum::<u64>());
    let scores: Vec<Value> = root
        .events
        .iter()
        .map(|event| {
            assert_eq!(event.name, "gen_ai.evaluation.result");
            event.attributes[0].value.as_ref().unwrap().to_json()
        })
        .collect();
    assert_eq!(scores, ["success", "completion", "total_reward"]);

    // Without words there are none, and calls with their errors are still there.
    let options = SpanOptions {
        content: false,
        ..SpanOptions::default()
    };
    let bare = otel::requests(&trace, &[], &options).unwrap();
    let text = String::from_utf8(json_line(&bare[0]).unwrap()).unwrap();
    for words in [
        &trace.task.instruction,
        "You are a robot.",
        "Because.",
        "reel.record",
        "arguments",
        "what was",
    ] {
        assert!(!text.contains(words), "{words}");
    }
    let read = otel::read_requests(&path, bare).unwrap();
    let after = Trace::read(&one(&read, folder.path()).trace).unwrap();
    let calls = |trace: &Trace| {
        trace
            .steps
            .iter()
            .map(|step| step.input.call.name.clone())
            .collect::<Vec<_>>()
    };
    assert_eq!(calls(&after), calls(&trace));
    let errors = |trace: &Trace| trace.steps.iter().map(has_failed).collect::<Vec<_>>();
    assert_eq!(errors(&after), errors(&trace));

    let at = |clock| {
        let options = SpanOptions {
            clock,
            ..SpanOptions::default()
        };
        let spans = otel::export(&trace, &[], &options).unwrap();
        (
            spans[0].start_time_unix_nano,
            spans[0].end_time_unix_nano,
            spans.last().unwrap().end_time_unix_nano,
        )
    };
    let (start, end, last) = at(SpanClock::Recorded);
    assert!(start < last && last <= end);
    assert_eq!(
        at(SpanClock::StartsAt(7_000)),
        (7_000, 7_000 + end - start, 7_000 + last - start)
    );
    let now = 1_800_000_000_000_000_000;
    assert_eq!(
        at(SpanClock::EndsAt(now)),
        (now - (end - start), now, now - (end - last))
    );
}
