//! No secret that passes by is written: whoever says it, wherever it stands, however it is escaped or cut.

use std::{
    fs,
    sync::{Arc, Mutex},
};

use mcap::{read::ChunkFlattener, records::Record};
use proptest::prelude::*;
use reel_redact::Rules;
use serde_json::{Value, json};

use super::{Recording, call, serve};

/// Secrets of one session.
#[derive(Clone, Debug)]
struct Secrets {
    /// By its shape, as the agent says it.
    token: String,
    /// By its shape, as the server says it.
    servers: String,
    /// By the name of a member.
    password: String,
    /// Sent in a header of each request.
    bearer: String,
    /// Known from the environment of the process.
    variable: String,
}

impl Secrets {
    fn all(&self) -> [&str; 5] {
        [
            &self.token,
            &self.servers,
            &self.password,
            &self.bearer,
            &self.variable,
        ]
    }

    fn rules(&self) -> Rules {
        Rules::built_in().with_environment([("ROBOT_TOKEN".to_owned(), self.variable.clone())])
    }
}

fn any_secrets() -> impl Strategy<Value = Secrets> {
    (
        "hf_[a-zA-Z0-9]{20}",
        "sk-[a-zA-Z0-9]{20}",
        "[a-zA-Z0-9]{12}",
        "[a-zA-Z0-9]{14}",
        "[a-zA-Z0-9]{16}",
    )
        .prop_map(|(token, servers, password, bearer, variable)| Secrets {
            token,
            servers,
            password,
            bearer,
            variable,
        })
}

/// The same JSON, in which the first letter of secrets is escaped.
fn escaped(json: &str, secrets: &Secrets) -> String {
    secrets.all().iter().fold(json.to_owned(), |json, secret| {
        let first = secret.chars().next().unwrap();
        json.replace(secret, &format!("\\u{:04x}{}", first as u32, &secret[1..]))
    })
}

/// What the server answers, with secrets in every place that is recorded.
fn answer(message: &Value, secrets: &Secrets) -> Value {
    let Secrets {
        servers,
        password,
        bearer,
        variable,
        token,
    } = secrets;
    let inner = json!({"password": password, "note": format!("{servers} {bearer}")}).to_string();
    let debug_info =
        json!({"CURRENT_INV": servers, "world_graph": {"table_1": {"content": [token]}}});
    let texts = [
        format!("as you said, {token}, {password} and {bearer}"),
        format!("{{\"config\": {}}}", json!(inner)),
        format!("API_KEY={variable} {servers}"),
        format!("Debug Info:\n{debug_info}"),
    ];
    let content: Vec<Value> = texts
        .iter()
        .map(|text| json!({"type": "text", "text": text}))
        .collect();
    let result = match message["method"].as_str() {
        Some("tools/list") => {
            json!({"tools": [{"name": "login", "description": format!("e.g. {servers}"), "inputSchema": {"type": "object"}}]})
        }
        Some("tools/call") if message["params"]["name"] == "finish" => {
            let task = json!({
                "task_id": format!("FDP/{servers}"), "family": "FDP", "task_description": format!("log in with {variable}"), "scene_id": "s",
                "rooms_and_furniture": {"kitchen": ["table_1"]}, "initial_world_graph": {"table_1": {"content": [servers]}},
                "target_object": {"id": "cup", "name": servers, "category": "cup"}, "source_furniture": "table_1", "destination_furniture": "table_1",
            });
            json!({"content": [{"type": "text", "text": task.to_string()}]})
        }
        Some("tools/call") if message["params"]["name"] == "fail" => {
            return json!({"jsonrpc": "2.0", "id": message["id"], "error": {"code": 1, "message": format!("no {servers}"), "data": {"token": password}}});
        }
        Some("tools/call") => {
            json!({"content": content, "structuredContent": {"token": password, servers.as_str(): [1, {"deep": variable}]}})
        }
        _ => json!({}),
    };
    json!({"jsonrpc": "2.0", "id": message["id"], "result": result})
}

/// Everything that a session with these secrets writes, and what the two sides got of each other.
fn session(secrets: &Secrets, rules: Rules, chunk: usize, escapes: bool) -> (Vec<u8>, String) {
    let (got, script) = (Arc::new(Mutex::new(String::new())), secrets.clone());
    let heard = got.clone();
    let server = serve(move |request, response| {
        heard.lock().unwrap().push_str(&request.body);
        let mut body = answer(&request.json(), &script).to_string();
        if escapes {
            body = escaped(&body, &script);
        }
        response.stream();
        response.chunks(&format!("event: message\ndata: {body}\n\n"), chunk);
        response.end();
    });
    let recording = Recording::of(server, rules);
    let authorization = format!("Bearer {}", secrets.bearer);
    let say = |message: Value| {
        let mut body = message.to_string();
        if escapes {
            body = escaped(&body, secrets);
        }
        let content = recording.ask("POST", &[("authorization", authorization.as_str())], &body);
        got.lock().unwrap().push_str(&content);
    };
    let client = json!({"clientInfo": {"name": format!("agent {}", secrets.token)}});
    say(json!({"jsonrpc": "2.0", "id": 1, "method": "initialize", "params": client}));
    say(json!({"jsonrpc": "2.0", "id": 2, "method": "tools/list"}));
    say(call(3, "finish", json!({})));
    let arguments = json!({"user": {"db_password": secrets.password, "list": [{"x": secrets.token}]}, secrets.token.as_str(): 1});
    say(call(4, "login", json!({"arguments": arguments})));
    let mut written = Vec::new();
    // The unfinished recording is not compressed.
    recording
        .files()
        .iter()
        .for_each(|part| written.extend(fs::read(part).unwrap()));
    assert!(!written.is_empty());
    say(call(5, "fail", json!({})));
    say(call(6, &format!("tool {}", secrets.token), json!({})));
    let traces = recording.end();
    assert_eq!(
        (traces.len(), traces[0].steps.len()),
        (1, 3),
        "{}",
        recording.events.lock().unwrap()
    );
    for path in recording.files() {
        written.extend_from_slice(path.to_string_lossy().as_bytes());
        let bytes = fs::read(path).unwrap();
        for record in ChunkFlattener::new(&bytes).unwrap() {
            match record.unwrap() {
                Record::Message { data, .. } => written.extend_from_slice(&data),
                Record::Attachment { data, .. } => written.extend_from_slice(&data),
                other => written.extend_from_slice(format!("{other:?}").as_bytes()),
            }
        }
        written.extend(bytes);
    }
    written.extend_from_slice(recording.events.lock().unwrap().as_bytes());
    let got = got.lock().unwrap().clone();
    (written, got)
}

fn holds(bytes: &[u8], text: &str) -> bool {
    memchr::memmem::find(bytes, text.as_bytes()).is_some()
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(12) })]
    #[test]
    fn no_secret_is_written(secrets in any_secrets(), chunk in 1_usize..200, escapes in any::<bool>()) {
        let (written, got) = session(&secrets, secrets.rules(), chunk, escapes);
        for secret in secrets.all() {
            prop_assert!(!holds(&written, secret), "{secret} is written");
            let sent = if escapes { escaped(secret, &secrets) } else { secret.to_owned() };
            // The bearer token and the variable are the server's to say.
            prop_assert!(got.contains(&sent), "{secret} did not pass");
        }
        prop_assert!(holds(&written, "[redacted:token#1]") && holds(&written, "[redacted:password#1]"));
    }
}

/// Each of the secrets would be written, if it were not for the rules.
#[test]
fn without_rules_every_secret_is_written() {
    let secrets = Secrets {
        token: "hf_abcdefghijklmnopqrst".to_owned(),
        servers: "sk-abcdefghijklmnopqrst".to_owned(),
        password: "hunter2hunter2".to_owned(),
        bearer: "opaque-bearer-1".to_owned(),
        variable: "opaque-variable-1".to_owned(),
    };
    let (written, _) = session(&secrets, Rules::none(), 17, false);
    for secret in secrets.all() {
        assert!(holds(&written, secret), "{secret}");
    }
    let (written, _) = session(&secrets, secrets.rules(), 17, false);
    for secret in secrets.all() {
        assert!(!holds(&written, secret), "{secret}");
    }
}

#[test]
fn traces_say_how_much_was_redacted() {
    let server = serve(|request, response| {
        let id = &request.json()["id"];
        response.json(
            200,
            &super::result(id, "token=sk-abcdefghijklmnop ok sk-abcdefghijklmnop"),
        );
    });
    let recording = Recording::of(server, Rules::built_in());
    let arguments = json!({"password": "hunter2", "again": "hunter2"});
    recording.call(1, "login", json!({"arguments": arguments}));
    recording.call(2, "login", json!({"arguments": {"a": "b"}}));
    let traces = recording.end();
    let counts: Vec<(String, u64)> = traces[0]
        .redacted()
        .iter()
        .map(|(rule, count)| ((*rule).to_owned(), *count))
        .collect();
    assert_eq!(
        counts,
        [("password".to_owned(), 1), ("token".to_owned(), 4)]
    );
    assert_eq!(recording.setup.report.counts().redacted, 5);
    assert_eq!(traces[0].redactions[&Some(1)]["token"], 2);
    assert_eq!(traces[0].header.policy.parameters["redaction"], "built-in");
    let call = traces[0].steps[0].input.call.to_string();
    assert!(call.contains("[redacted:password#1]"), "{call}");
    let recording = Recording::of(server, Rules::none());
    recording.call(1, "login", json!({"arguments": {"password": "hunter2"}}));
    let traces = recording.end();
    assert!(
        traces[0].redacted().is_empty()
            && traces[0].header.policy.parameters["redaction"] == "none"
    );
}
