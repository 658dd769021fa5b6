//! Spans of other agents, and files that are not what they should be.

use std::{fs, path::Path};

use proptest::prelude::*;
use reel_import::{
    ImportError, ImportedEpisode,
    otel::{self, SpanOptions},
};
use reel_otlp::{ExportTraceServiceRequest, Format, decode_request, encode, json_line};
use reel_trace::Trace;
use reel_vectors::golden_traces;
use reel_world::{
    ErrorCode,
    record::{Backend, EndReason, Score},
};
use serde_json::{Value, json};

use super::one;
use crate::PLAIN;

/// A request with these spans: name, id, parent, start, attributes, and further fields.
fn request(spans: &[(&str, &str, &str, u64, Value, Value)]) -> ExportTraceServiceRequest {
    request_of("aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa", spans)
}

fn request_of(
    trace: &str,
    spans: &[(&str, &str, &str, u64, Value, Value)],
) -> ExportTraceServiceRequest {
    let attributes = |map: &Value| {
        let value = |value: &Value| match value {
            Value::String(text) => json!({"stringValue": text}),
            Value::Number(number) if number.is_f64() => json!({"doubleValue": number}),
            value => json!({"intValue": value.to_string()}),
        };
        let pairs = map.as_object().unwrap().iter();
        pairs
            .map(|(key, told)| json!({"key": key, "value": value(told)}))
            .collect::<Value>()
    };
    let spans: Value = spans
        .iter()
        .map(|(name, id, parent, start, facts, more)| {
            let mut span = json!({
                "traceId": trace, "spanId": format!("00000000000000{id}"), "name": name,
                "parentSpanId": if parent.is_empty() { String::new() } else { format!("00000000000000{parent}") },
                "startTimeUnixNano": start.to_string(), "endTimeUnixNano": (start + 1).to_string(), "attributes": attributes(facts),
            });
            for (key, value) in more.as_object().unwrap() {
                span[key] = match key.as_str() {
                    "events" => value.as_array().unwrap().iter().map(|event| json!({
                        "name": event["name"], "attributes": attributes(&event["facts"]),
                    })).collect(),
                    _ => value.clone(),
                };
            }
            span
        })
        .collect();
    let resource = attributes(&json!({"service.name": "shop"}));
    let text = json!({"resourceSpans": [{"resource": {"attributes": resource}, "scopeSpans": [{"spans": spans}]}]});
    decode_request(text.to_string().as_bytes(), Format::Json).unwrap()
}

fn import_all(
    requests: Vec<ExportTraceServiceRequest>,
    out: &Path,
) -> Vec<(ImportedEpisode, Trace)> {
    let read = otel::read_requests(Path::new("spans.jsonl"), requests).unwrap();
    let import = |told| {
        let rule = "quality>=0.5".parse().unwrap();
        let imported = otel::import(told, out, &PLAIN, Some(&rule), Some("test.case.name"));
        let imported = imported.unwrap_or_else(|error| panic!("{error}"));
        let trace = Trace::read(&imported.trace).unwrap();
        (imported, trace)
    };
    read.episodes.iter().map(import).collect()
}

fn calls(trace: &Trace) -> Vec<(&str, &str)> {
    trace
        .steps
        .iter()
        .map(|step| (step.input.call.name.as_str(), step.outcome.text.as_str()))
        .collect()
}

#[test]
fn agents_of_the_current_conventions_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let asked =
        json!([{"role": "user", "parts": [{"type": "text", "content": "Weather in Paris?"}]}]);
    let output = json!([{"role": "assistant", "parts": [
        {"type": "reasoning", "content": "Look."}, {"type": "text", "content": "I look."},
        {"type": "tool_call", "id": "c1", "name": "weather", "arguments": {"city": "Paris"}},
        {"type": "tool_call", "id": "c2", "name": "weather", "arguments": "{\"city\": \"Rome\"}"},
    ], "finish_reason": "tool_call"}]);
    let later = json!([asked[0], output[0],
        {"role": "tool", "parts": [{"type": "tool_call_response", "id": "c2", "response": "sunny"}]},
        {"role": "tool", "parts": [{"type": "tool_call_response", "id": "c1", "result": {"sky": "grey"}}]},
        {"role": "user", "parts": [{"type": "text", "content": "Be brief."}, {"type": "uri", "modality": "image", "uri": "file:///etc/passwd"}]},
    ]);
    let said = json!([{"role": "assistant", "parts": [{"type": "text", "content": "Grey."}]}]);
    let chat = |input: &Value, output: &Value, read: u32| {
        json!({
            "gen_ai.operation.name": "chat", "gen_ai.request.model": "m-1", "gen_ai.request.temperature": 0.5,
            "gen_ai.input.messages": input.to_string(), "gen_ai.output.messages": output.to_string(),
            "gen_ai.system_instructions": json!([{"type": "text", "content": "You help."}]).to_string(),
            "gen_ai.usage.input_tokens": read, "gen_ai.usage.output_tokens": 3,
        })
    };
    let agent = json!({"gen_ai.operation.name": "invoke_agent", "gen_ai.agent.name": "guide", "test.case.name": "weather/1",
        "gen_ai.tool.definitions": json!([{"type": "function", "name": "weather"}]).to_string()});
    let score = json!({"events": [{"name": "gen_ai.evaluation.result", "facts": {
        "gen_ai.evaluation.name": "quality", "gen_ai.evaluation.score.value": 0.75, "gen_ai.evaluation.score.label": "good",
        "gen_ai.evaluation.explanation": "short",
    }}]});
    let tool = |id: &str, result: &str| {
        json!({"gen_ai.operation.name": "execute_tool", "gen_ai.tool.name": "weather",
        "gen_ai.tool.call.id": id, "gen_ai.tool.call.result": result})
    };
    let failed = json!({"status": {"code": 2, "message": "no such city"}});
    let made = request(&[
        (
            "execute_tool weather",
            "03",
            "01",
            30,
            tool("c1", "grey"),
            json!({}),
        ),
        (
            "chat m-1",
            "02",
            "01",
            20,
            chat(&asked, &output, 10),
            json!({}),
        ),
        (
            "execute_tool weather",
            "04",
            "01",
            31,
            json!({"gen_ai.operation.name": "execute_tool", "gen_ai.tool.name": "weather",
            "gen_ai.tool.call.id": "c2", "error.type": "LookupError"}),
            failed,
        ),
        (
            "POST /v1/chat",
            "07",
            "02",
            21,
            json!({"http.method": "POST"}),
            json!({}),
        ),
        (
            "chat m-1",
            "05",
            "01",
            40,
            chat(&later, &said, 20),
            json!({}),
        ),
        ("invoke_agent guide", "01", "", 10, agent, score),
    ]);
    let mut found = import_all(vec![made.clone(), made], folder.path());
    let (report, trace) = found.remove(0);
    assert!(found.is_empty());
    assert_eq!(trace.header.policy.name, "guide");
    assert_eq!(trace.header.backend, Backend::Imported);
    assert_eq!(trace.task.task_id, "weather/1");
    assert_eq!(trace.task.instruction, "Weather in Paris?");
    assert_eq!(
        calls(&trace),
        [
            ("weather", "grey"),
            ("weather", "no such city\nBe brief."),
            ("message", "")
        ]
    );
    let errors: Vec<_> = trace.steps.iter().map(|step| step.outcome.error).collect();
    assert_eq!(errors, [None, Some(ErrorCode::BackendError), None]);
    assert_eq!(trace.steps[1].input.call.arguments, json!({"city": "Rome"}));
    let policy = |step: usize| trace.steps[step].input.policy.clone().unwrap_or_default();
    assert_eq!(
        (policy(0).raw.as_str(), policy(0).reasoning.as_str()),
        ("I look.", "Look.")
    );
    assert_eq!(
        (policy(0).tokens, policy(2).tokens),
        (Some([10, 3]), Some([20, 3]))
    );
    assert_eq!(policy(2).raw, "Grey.");
    let parameters = &trace.header.policy.parameters;
    assert_eq!(parameters["model"], "m-1");
    assert_eq!(parameters["system_prompt"], "You help.");
    assert_eq!(parameters["temperature"], 0.5);
    assert_eq!(parameters["service.name"], "shop");
    assert_eq!(parameters["tools"][0]["function"]["name"], "weather");
    let end = trace.end.unwrap();
    let score = Score {
        name: "quality".to_owned(),
        value: Some(0.75),
        label: Some("good".to_owned()),
        explanation: Some("short".to_owned()),
    };
    assert_eq!(
        (end.reported.success, end.reported.scores),
        (Some(true), vec![score])
    );
    assert_eq!(end.reason, EndReason::Finished);
    // The file is named, and not opened.
    assert_eq!(report.losses.len(), 1);
    assert!(
        report.losses[0]
            .message
            .contains("image file:///etc/passwd is left out"),
        "{:?}",
        report.losses
    );
    assert!(
        report
            .notes
            .iter()
            .any(|note| note.contains("1 spans of something else")),
        "{:?}",
        report.notes
    );
}

#[test]
fn agents_of_other_conventions_are_read() {
    let folder = tempfile::tempdir().unwrap();
    // OpenInference.
    let inference = request_of(
        "11111111111111111111111111111111",
        &[
            (
                "agent",
                "01",
                "",
                1,
                json!({"openinference.span.kind": "AGENT", "agent.name": "finder", "input.value": "Find it."}),
                json!({"status": {"code": 2, "message": "gave up"}}),
            ),
            (
                "llm",
                "02",
                "01",
                2,
                json!({
                    "openinference.span.kind": "LLM", "llm.model_name": "m-2", "llm.token_count.prompt": 5, "llm.token_count.completion": 6,
                    "llm.input_messages.0.message.role": "system", "llm.input_messages.0.message.content": "You find.",
                    "llm.input_messages.1.message.role": "user", "llm.input_messages.1.message.contents.0.message_content.type": "text",
                    "llm.input_messages.1.message.contents.0.message_content.text": "Find it.",
                    "llm.output_messages.0.message.role": "assistant", "llm.output_messages.0.message.content": "Looking.",
                    "llm.output_messages.0.message.tool_calls.0.tool_call.id": "x",
                    "llm.output_messages.0.message.tool_calls.0.tool_call.function.name": "grep",
                    "llm.output_messages.0.message.tool_calls.0.tool_call.function.arguments": "{\"for\": \"it\"}",
                    "llm.tools.0.tool.json_schema": "{\"type\": \"function\", \"function\": {\"name\": \"grep\"}}",
                }),
                json!({}),
            ),
            (
                "grep",
                "03",
                "01",
                3,
                json!({"openinference.span.kind": "TOOL", "tool.name": "grep", "input.value": "{\"for\": \"it\"}",
            "output.value": "line 3"}),
                json!({}),
            ),
            (
                "retrieve",
                "04",
                "01",
                4,
                json!({"openinference.span.kind": "RETRIEVER"}),
                json!({}),
            ),
        ],
    );
    // OpenLLMetry, a conversation in two traces.
    let metry = |trace: &str, start: u64, prompt: &[(&str, &str)], completion: &str| {
        let mut facts = json!({"gen_ai.system": "OpenAI", "llm.request.type": "chat", "gen_ai.request.model": "m-3",
            "traceloop.association.properties.session_id": "talk", "gen_ai.usage.prompt_tokens": 1, "gen_ai.usage.completion_tokens": 2,
            "gen_ai.completion.0.role": "assistant", "gen_ai.completion.0.content": completion});
        for (number, (role, content)) in prompt.iter().enumerate() {
            facts[format!("gen_ai.prompt.{number}.role")] = (*role).into();
            facts[format!("gen_ai.prompt.{number}.content")] = (*content).into();
        }
        request_of(trace, &[("openai.chat", "01", "", start, facts, json!({}))])
    };
    let first = metry(
        "22222222222222222222222222222222",
        100,
        &[("user", "Hi")],
        "Hello.",
    );
    let second = metry(
        "33333333333333333333333333333333",
        200,
        &[("user", "Hi"), ("assistant", "Hello."), ("user", "Hi")],
        "Again.",
    );
    // Events of the conventions of before, and content in an event of its own.
    let before = request_of(
        "44444444444444444444444444444444",
        &[(
            "chat m-4",
            "01",
            "",
            1,
            json!({"gen_ai.system": "openai", "gen_ai.operation.name": "chat", "gen_ai.request.model": "m-4"}),
            json!({"events": [
                {"name": "gen_ai.user.message", "facts": {"content": "Add."}},
                {"name": "gen_ai.choice", "facts": {"index": 0, "message": "{\"role\": \"assistant\", \"content\": \"4\"}"}},
            ]}),
        )],
    );
    // Calls without any words: an agent whose instrumentation records no content.
    let bare = request_of(
        "55555555555555555555555555555555",
        &[
            (
                "invoke_agent",
                "01",
                "",
                1,
                json!({"gen_ai.operation.name": "invoke_agent"}),
                json!({}),
            ),
            (
                "chat",
                "02",
                "01",
                2,
                json!({"gen_ai.operation.name": "chat", "gen_ai.usage.input_tokens": 9}),
                json!({}),
            ),
            (
                "a",
                "03",
                "01",
                3,
                json!({"gen_ai.operation.name": "execute_tool", "gen_ai.tool.name": "a"}),
                json!({}),
            ),
            (
                "b",
                "04",
                "01",
                4,
                json!({"gen_ai.operation.name": "execute_tool", "gen_ai.tool.name": "b"}),
                json!({}),
            ),
            (
                "chat",
                "05",
                "01",
                5,
                json!({"gen_ai.operation.name": "chat"}),
                json!({}),
            ),
        ],
    );
    let other = request_of(
        "66666666666666666666666666666666",
        &[(
            "GET /",
            "01",
            "",
            1,
            json!({"http.method": "GET"}),
            json!({}),
        )],
    );
    let requests = vec![second, inference, before, bare, first, other];
    let read = otel::read_requests(Path::new("s"), requests.clone()).unwrap();
    assert_eq!(read.without_agent, 1);
    let mut found = import_all(requests, folder.path());
    found.sort_by(|left, right| left.1.task.task_id.cmp(&right.1.task.task_id));
    let [(_, inference), (_, before), (_, bare), (report, talk)] = &found[..] else {
        panic!("{}", found.len());
    };
    assert_eq!(inference.header.policy.name, "finder");
    assert_eq!(calls(inference), [("grep", "line 3")]);
    assert_eq!(inference.task.instruction, "Find it.");
    assert_eq!(
        inference.steps[0].input.policy.as_ref().unwrap().tokens,
        Some([5, 6])
    );
    assert_eq!(inference.end.as_ref().unwrap().reason, EndReason::Fault);
    assert_eq!(inference.header.policy.parameters["error"], "gave up");
    assert_eq!(calls(before), [("message", "")]);
    assert_eq!(before.steps[0].input.policy.as_ref().unwrap().raw, "4");
    assert_eq!(before.task.instruction, "Add.");
    assert_eq!(calls(bare), [("a", ""), ("b", ""), ("message", "")]);
    assert_eq!(talk.task.task_id, "talk");
    assert_eq!(calls(talk), [("message", "Hi"), ("message", "")]);
    let said: Vec<_> = talk
        .steps
        .iter()
        .map(|step| step.input.policy.as_ref().unwrap().raw.as_str())
        .collect();
    assert_eq!(said, ["Hello.", "Again."]);
    assert_eq!(report.losses, []);
}

#[test]
fn files_are_found_and_read() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let trace = Trace::read(&golden_traces()[0]).unwrap();
    let requests = otel::requests(&trace, &[], &SpanOptions::default()).unwrap();
    let line = json_line(&requests[0]).unwrap();
    fs::create_dir(folder.join("below")).unwrap();
    // The parts of one trace lie in two files, of which one is torn.
    let mut halves = [requests[0].clone(), requests[0].clone()];
    let spans = |half: &mut ExportTraceServiceRequest| {
        std::mem::take(&mut half.resource_spans[0].scope_spans[0].spans)
    };
    let mut all = spans(&mut halves[0]);
    halves[1].resource_spans[0].scope_spans[0].spans = all.split_off(all.len() / 2);
    halves[0].resource_spans[0].scope_spans[0].spans = all;
    let torn = [
        &json_line(&halves[0]).unwrap()[..],
        b"{\"resourceSpans\": [{",
    ]
    .concat();
    fs::write(folder.join("one.jsonl"), torn).unwrap();
    fs::write(folder.join("below/two.pb"), encode(&halves[1])).unwrap();
    fs::write(folder.join("config.json"), "{}").unwrap();
    fs::write(folder.join("notes.txt"), "resourceSpans").unwrap();
    let files = otel::documents(folder).unwrap();
    assert_eq!(files.len(), 2);
    let read = otel::read(&files).unwrap();
    assert_eq!((read.episodes.len(), read.losses.len()), (1, 1));
    let out = folder.join("out");
    fs::create_dir(&out).unwrap();
    let imported = one(&read, &out);
    assert_eq!(imported.steps as usize, trace.steps.len());

    let empty = folder.join("empty");
    fs::create_dir(&empty).unwrap();
    assert!(matches!(
        otel::documents(&empty),
        Err(ImportError::NoSpans { .. })
    ));
    fs::write(empty.join("none.pb"), "none").unwrap();
    let error = otel::read(&otel::documents(&empty).unwrap())
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("not OTLP in protobuf") && error.contains("none.pb"),
        "{error}"
    );
    fs::write(empty.join("whole.json"), &line).unwrap();
    let read = otel::read(&otel::documents(&empty).unwrap()).unwrap();
    assert_eq!((read.episodes.len(), read.losses.len()), (1, 1));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Spans of any ids, parents, kinds and messages are read without a panic.
    #[test]
    fn no_span_makes_the_importer_panic(
        spans in prop::collection::vec((0u8..6, 0u8..6, 0u64..9, 0usize..4, 0usize..7, 0usize..7), 0..12),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let kinds = ["invoke_agent", "chat", "execute_tool", "other"];
        let texts = ["", "[]", "{}", "[1, null]", "[{\"role\": \"user\"}]", "[{\"type\": \"blob\", \"content\": \"!\"}]",
            "[{\"role\": \"assistant\", \"parts\": [{\"type\": \"tool_call\"}]}]"];
        let ids: Vec<(String, String)> = spans.iter().map(|span| (format!("{:02}", span.0), format!("{:02}", span.1))).collect();
        let made: Vec<_> = spans
            .iter()
            .zip(&ids)
            .map(|((_, _, start, kind, input, output), (id, parent))| (
                "s", id.as_str(), parent.as_str(), *start,
                json!({"gen_ai.operation.name": kinds[*kind], "gen_ai.input.messages": texts[*input], "gen_ai.output.messages": texts[*output],
                    "gen_ai.tool.call.result": texts[*input], "gen_ai.tool.call.arguments": texts[*output], "reel.record": texts[*input]}),
                json!({}),
            ))
            .collect();
        let read = otel::read_requests(Path::new("s"), vec![request(&made)]).unwrap();
        for told in &read.episodes {
            let _ = otel::import(told, folder.path(), &PLAIN, None, None);
        }
    }
}
