//! Tests of the module above.

use super::*;

#[test]
fn trouble_by_name() {
    assert_eq!(
        InjectedError::parse("two-calls@4"),
        Ok((InjectedError::TwoCalls, 4))
    );
    for (wrong, word) in [
        ("gibberish", "KIND@CALL"),
        ("gibberish@x", "number"),
        ("sloth@1", "rate-limit"),
    ] {
        assert!(
            InjectedError::parse(wrong).unwrap_err().contains(word),
            "{wrong}"
        );
    }
}

fn plan() -> Vec<Line> {
    let line = |name: &str, arguments: Value, outcome: &str| Line {
        call: ToolCall::new(name, arguments),
        outcome: outcome.to_owned(),
        ..Line::finish()
    };
    vec![
        line(
            "nav_to",
            json!({"receptacle_name": "table_1"}),
            "Arrived: {}}: there.",
        ),
        line("pick", json!({"marker_id": 1}), "Picked it up."),
    ]
}

#[test]
fn where_an_episode_stands_is_read_from_any_template() {
    let plan = plan();
    let at = |prompt: &str| progress(prompt, &plan);
    let pick = r#"{"tool_name": "pick", "args": {"marker_id": "1"}}"#;
    let nav = r#"{"tool_name": "navigate_to", "args": {"receptacle_name": "table_1"}}"#;
    let first = "{'History': '0) (0 of 2 calls were made)'}";
    let second = "{'History': '0) (0 of 2 calls were made)\n1) (1 of 2 calls were made) I went.'}";
    assert_eq!(at("{}"), (0, true));
    assert_eq!(
        at(&format!("{first} {nav} Arrived: {{}}}}: there.")),
        (1, true)
    );
    assert_eq!(
        at(&format!("{first} {nav} The way is blocked.")),
        (0, false)
    );
    assert_eq!(at(&format!("{second} {pick} Picked it up.")), (2, true));
    assert_eq!(
        at(&format!("{second} {nav} Arrived: {{}}}}: there.")),
        (1, false)
    );
    // An answer that could not be read, and one that was only not strict.
    let unread = "{'History': '0) (0 of 2 calls were made)\n1) Unread.'}";
    assert_eq!(
        at(&format!("{unread} {{\"raw\": \"x\"}} no call")),
        (1, false)
    );
    assert_eq!(
        at(&format!("{unread} {{\"raw\": \"x\"}} Picked it up.")),
        (2, true)
    );
    assert_eq!(
        at("{'History': '0) Unread.'} {\"raw\": \"x\"} no call"),
        (0, false)
    );
}

#[test]
fn a_log_is_read_as_it_was_written() {
    let line =
        |outcome| reel_prompt::log_line("nav_to", &json!({"receptacle_name": "table_1"}), outcome);
    let prompt = format!(
        "{{'History': '0) {}\n1) {}'}}",
        line("Arrived: {}}: there."),
        line("Arrived again.")
    );
    let call = "navigate_to({\"receptacle_name\":\"table_1\"})".to_owned();
    let calls = [
        (call.clone(), "Arrived: {}}: there.".to_owned()),
        (call, "Arrived again.".to_owned()),
    ];
    assert_eq!(watched_calls(&prompt), calls);
    assert_eq!(progress(&prompt, &plan()), (1, false));
}

#[test]
fn two_models_give_the_same_tokens_a_little_less_or_more() {
    let of = |model: &str| {
        let said = completion(
            &json!({"model": model, "logprobs": true, "messages": []}),
            &text_message("pick the mug"),
            "stop",
        );
        let content = said["choices"][0]["logprobs"]["content"].clone();
        let field = |name: &str| -> Vec<Value> {
            content
                .as_array()
                .unwrap()
                .iter()
                .map(|it| it[name].clone())
                .collect()
        };
        (field("token"), field("logprob"))
    };
    let ((tokens, old), (others, new)) = (of("a"), of("b"));
    assert_eq!(
        (&tokens, &others),
        (&vec![json!("pick"), json!(" the"), json!(" mug")], &tokens)
    );
    assert_eq!(of("a").1, old, "it says the same every time");
    let apart =
        |(old, new): (&Value, &Value)| (old.as_f64().unwrap() - new.as_f64().unwrap()).abs();
    let apart: Vec<f64> = old.iter().zip(&new).map(apart).collect();
    assert!(
        apart.iter().any(|it| *it > 0.0) && apart.iter().all(|it| *it <= MODEL_SHARE),
        "{apart:?}"
    );
    let unasked = completion(
        &json!({"model": "a", "messages": []}),
        &text_message("pick"),
        "stop",
    );
    assert!(unasked["choices"][0].get("logprobs").is_none());
}

#[test]
fn nothing_that_comes_makes_it_fall() {
    let script = Script::new(&[], vec![(InjectedError::Cut, 0)]);
    for request in [
        json!(null),
        json!({"messages": []}),
        json!({"messages": [{"role": "user", "content": "Task: a"}]}),
        json!({"messages": [{"role": "user", "content": [{"text": "Task: a\n\nb"}]}]}),
    ] {
        assert!(script.answer(&request).is_err(), "{request}");
    }
    assert!(script.embed(&json!({"input": 3})).is_err());
    let vectors = script.embed(&json!({"input": ["mug", "mugs"]})).unwrap();
    assert_eq!(
        vectors["data"][0]["embedding"],
        vectors["data"][1]["embedding"]
    );
}
