//! What is a secret, what is written in its place, and what stays as it is.

use std::sync::{Arc, LazyLock};

use proptest::prelude::*;
use reel_redact::{Redactor, Rules, Scope, is_recorded_as, replace_value};
use serde_json::{Value, json};

fn built_in() -> Redactor {
    static RULES: LazyLock<Arc<Rules>> = LazyLock::new(|| Arc::new(Rules::built_in()));
    Redactor::new(RULES.clone())
}

#[test]
fn shapes_of_tokens() {
    for secret in [
        "sk-proj-abcdefghijkl",
        "hf_abcdefghijklmnopqrst",
        "ghp_abcdefghijklmnopqrstuvwxyz0123456789",
        "github_pat_11ABCDEFG0abcdefghijkl",
        "glpat-abcdefghijklmnopqrst",
        "xoxb-123456789012-abcdef",
        "AKIAIOSFODNN7EXAMPLE",
        "eyJhbGciOiJIUzI1NiJ9.eyJzdWIiOiIxMjM0In0.c2lnbmF0dXJl",
        "-----BEGIN RSA PRIVATE KEY-----\nMIIB\nabc\n-----END RSA PRIVATE KEY-----",
        "-----BEGIN OPENSSH PRIVATE KEY-----\ncut off",
    ] {
        let text = format!("before {secret}");
        let redacted = built_in().text(&text);
        assert!(
            redacted.starts_with("before [redacted:") && redacted.ends_with("#1]"),
            "{redacted}"
        );
    }
    let mut redactor = built_in();
    assert_eq!(
        redactor.text("Authorization: Bearer abc.def-ghi_jkl; then ok"),
        "Authorization: [redacted:bearer#1]"
    );
    assert_eq!(
        redactor.text("postgres://reel:hunter2hunter2@db.lab/x and again hunter2hunter2"),
        "postgres://reel:[redacted:userinfo#1]@db.lab/x and again hunter2hunter2"
    );
    assert_eq!(
        redactor.text("hunter2hunter2"),
        "[redacted:userinfo#1]",
        "what was found once is known"
    );
}

#[test]
fn members_of_texts_and_values() {
    let mut redactor = built_in();
    let mut value = json!({
        "db_password": "hunter2", "X-Api-Key": 12345, "token": null, "secret": {"a": ["one", "two"]},
        "config": "{\"password\": \"hunter2\", \"port\": 80}", "line": "PASSWORD=hunter2 --port 80",
        "deep": "{\"inner\": \"{\\\"password\\\": \\\"hunter2\\\"}\"}",
    });
    redactor.value("arguments", &mut value, Scope::Data);
    assert_eq!(
        value,
        json!({
            "db_password": "[redacted:password#1]", "X-Api-Key": 0, "token": null,
            "secret": {"a": ["[redacted:secret#1]", "[redacted:secret#2]"]},
            "config": "{\"password\": \"[redacted:password#1]\", \"port\": 80}",
            "line": "PASSWORD=[redacted:password#1] --port 80",
            "deep": "{\"inner\": \"{\\\"password\\\": \\\"[redacted:password#1]\\\"}\"}",
        })
    );
    let text = "one-word and another-word";
    let mut value = json!({"token": {"a": "one-word", "password": "another-word"}, "text": text});
    redactor.value("result", &mut value, Scope::Data);
    assert_eq!(
        value["text"], "one-word and [redacted:password#2]",
        "a part of a member is no secret elsewhere"
    );
    let counts = redactor.take_redactions();
    assert_eq!(
        (counts["password"], counts["api_key"], counts["secret"]),
        (6, 1, 2)
    );
    assert!(redactor.take_redactions().is_empty());
}

/// Servers repeat what they answer as a text, in JSON or as their language prints it.
#[test]
fn what_stands_in_brackets_or_quotes_of_a_text() {
    let mut redactor = built_in();
    let mut text = |text: &str| redactor.text(text);
    assert_eq!(
        text(
            "{\n  \"credentials\": {\n    \"user\": \"svc-robot\",\n    \"key\": \"LEAK_0011\"\n  },\n  \"secret\": [\"LEAK_2\", 3],\n  \"n\": 1\n}"
        ),
        "{\n  \"credentials\": {\n    \"user\": \"[redacted:credentials#1]\",\n    \"key\": \"[redacted:credentials#2]\"\n  },\n  \"secret\": [\"[redacted:secret#1]\", 0],\n  \"n\": 1\n}"
    );
    assert_eq!(
        text("secret = ['LEAK_2'] # of TOML"),
        "secret = ['[redacted:secret#1]'] # of TOML"
    );
    let nested = r#"{"text": "{\"secrets\": {\"a\": \"LEAK_3\"}}"}"#;
    assert!(!text(nested).contains("LEAK"), "{}", text(nested));
    for (given, expected) in [
        (
            "DB_PASSWORD='quoted pass word99' x",
            "DB_PASSWORD='[redacted:password#1]' x",
        ),
        ("password=\"a b c d\"", "password=\"[redacted:password#2]\""),
        (
            "{'password': 'e f g'}",
            "{'password': '[redacted:password#3]'}",
        ),
        (
            "\"password\":\"never ends",
            "\"password\":\"[redacted:password#4]",
        ),
        (
            "<password>h i</password>",
            "<password>[redacted:password#5]</password>",
        ),
        (
            "password: |\n  line one\n  line two\nport: 80",
            "password: |\n[redacted:password#6]port: 80",
        ),
        (
            "{\"password\": null, \"token\": true}",
            "{\"password\": null, \"token\": true}",
        ),
    ] {
        assert_eq!(text(given), expected);
    }
}

/// The schema of a tool's output holds for what is recorded, too.
#[test]
fn numbers_stay_numbers() {
    let mut redactor = built_in();
    let given = json!({"next_token": 424_242, "credential": {"id": 123_456, "is_new": true}, "secret": 1.5});
    let expected = json!({"next_token": 0, "credential": {"id": 0, "is_new": true}, "secret": 0});
    let mut value = json!({
        "structuredContent": given, "text": format!("Result: {given}\n"),
        "deep": json!({"inner": given.to_string()}).to_string(), "lines": format!("{given}{given}"),
        "fenced": format!("```json\n{given:#}\n```"),
    });
    redactor.value("result", &mut value, Scope::Data);
    assert_eq!(
        value,
        json!({
            "structuredContent": expected, "text": format!("Result: {expected}\n"),
            "deep": json!({"inner": expected.to_string()}).to_string(), "lines": format!("{expected}{expected}"),
            "fenced": format!("```json\n{expected:#}\n```"),
        })
    );
    let counts = redactor.take_redactions();
    assert_eq!(
        (counts["token"], counts["credential"], counts["secret"]),
        (6, 6, 6)
    );
    let mut text = |text: &str| redactor.text(text);
    assert_eq!(
        text(r#"{"a": {"pin_token": 12345678}}"#),
        r#"{"a": {"pin_token": 0}}"#
    );
    assert_eq!(
        text(r#"{"n": 12345678, "m": 1}"#),
        r#"{"n": 0, "m": 1}"#,
        "it is known by now"
    );
    let told = text("the number 12345678 of token=9");
    assert!(!told.contains("12345678"), "{told}");
    assert_eq!(told.matches("[redacted:token#").count(), 2, "{told}");
    let unquoted = text(r#""password": 12}secret99"#);
    assert!(!unquoted.contains("secret99"), "{unquoted}");
}

#[test]
fn short_names_are_words_of_their_own() {
    for name in [
        "pwd",
        "db_pwd",
        "dbPwd",
        "DB_PASS",
        "dbPass",
        "user-pass",
        "passphrase",
        "auth",
        "password2",
        "DB_PASSWORD2",
        "X-Amz-Signature",
    ] {
        let mut value = json!({ name: "Zk39slQpz71" });
        built_in().value("arguments", &mut value, Scope::Data);
        let label = value[name].as_str().unwrap();
        assert!(label.starts_with("[redacted:"), "{name}: {label}");
        for text in [
            format!("{name}=Zk39slQpz71"),
            format!("{{\"{name}\": \"Zk39slQpz71\"}}"),
            format!("https://h/x?a=1&{name}=Zk39slQpz71&b=2"),
        ] {
            let redacted = built_in().text(&text);
            assert!(!redacted.contains("Zk39slQpz71"), "{redacted}");
        }
    }
    for name in [
        "pass",
        "tests_pass",
        "sig",
        "passes",
        "compass",
        "bypass",
        "author",
        "authors",
        "design",
        "config",
        "cookie_1",
        "signature_of",
    ] {
        let given = json!({ name: "Zk39slQpz71", "text": format!("{name}=Zk39slQpz71") });
        let mut value = given.clone();
        built_in().value("arguments", &mut value, Scope::Data);
        assert_eq!(value, given, "{name}");
    }
    let variables = [("PWD", "/repo/folder"), ("DB_PASS2", "opaque-value")];
    let variables = variables.map(|(name, value)| (name.to_owned(), value.to_owned()));
    let rules = Rules::built_in().with_environment(variables);
    assert_eq!(
        Redactor::new(Arc::new(rules)).text("in /repo/folder with opaque-value"),
        "in /repo/folder with [redacted:environment#1]"
    );
}

/// Brackets that never close cost no more than others.
#[test]
fn long_texts_of_open_brackets_are_read_once() {
    for text in [
        "secret=[".repeat(50_000),
        "secret={a b ".repeat(60) + &"word ".repeat(50_000),
    ] {
        let begun = std::time::Instant::now();
        let redacted = built_in().text(&text);
        assert!(!redacted.contains("word"), "{redacted:.100}");
        assert!(begun.elapsed().as_secs() < 20, "{:?}", begun.elapsed());
    }
}

#[test]
fn schemas_of_tools_stay() {
    let schema = json!({"tools": [{"name": "login", "description": "password: the user's", "inputSchema": {
        "properties": {"password": {"type": "string", "default": "a"}}}}]});
    let mut value = schema.clone();
    built_in().value("result", &mut value, Scope::Schema);
    assert_eq!(value, schema);
    let mut value = json!({"description": "try sk-abcdefghijklmnop"});
    built_in().value("result", &mut value, Scope::Schema);
    assert_eq!(value, json!({"description": "try [redacted:token#1]"}));
}

#[test]
fn texts_of_households_stay() {
    for text in [
        "Room: kitchen; furniture: table_1, shelf_2",
        "{\"CURRENT_INV\": null, \"CURRENT_MARKER_MAP\": {\"1\": \"cup_on_table_1_at_t\"}, \"tokens\": 12}",
        "Bring the key from the desk-lamp-side-table-1 to the risk-free-sk-box; author: you",
        "https://robot.lab:8000/mcp?x=1 and me@example.org",
    ] {
        assert_eq!(built_in().text(text), text);
    }
}

#[test]
fn what_is_known_of_the_environment_and_the_command() {
    let variables = [
        ("OPENAI_API_KEY", "opaque-value-1"),
        ("MAX_TOKENS", "100000"),
        ("AWS_WEB_IDENTITY_TOKEN_FILE", "/var/token"),
        ("DATABASE_URL", "postgres://u:opaque-value-2@h/d"),
        ("SHORT_TOKEN", "abc"),
    ];
    let variables = variables.map(|(name, value)| (name.to_owned(), value.to_owned()));
    let command = [
        "env",
        "ROBOT_TOKEN=opaque-value-3",
        "python",
        "--api-key",
        "opaque-value-4",
    ];
    let command = command.map(str::to_owned);
    let rules = Rules::built_in()
        .with_environment(variables)
        .with_command(&command);
    assert!(!format!("{rules:?}").contains("opaque"), "{rules:?}");
    let mut redactor = Redactor::new(Arc::new(rules));
    let text = "opaque-value-1 opaque-value-2 opaque-value-3 opaque-value-4 100000 /var/token abc opaque-value-1";
    let redacted = redactor.text(text);
    assert!(!redacted.contains("opaque"), "{redacted}");
    assert!(redacted.contains("100000 /var/token abc"), "{redacted}");
    assert_eq!(
        redacted.matches("[redacted:environment#1]").count(),
        2,
        "{redacted}"
    );
}

#[test]
fn a_rules_file() {
    let file = "keys = ['pin']\npointers = ['/arguments/card/number', '/result/content/*/note']\n\n[patterns]\nticket = 'T-(?P<secret>\\d{4})'\n";
    let mut redactor = Redactor::new(Arc::new(Rules::parse(file).unwrap()));
    let mut value = json!({"card": {"number": 4111, "holder": "T-1234"}, "pin": "9", "note": "sk-abcdefghijklmnop"});
    redactor.value("arguments", &mut value, Scope::Data);
    assert_eq!(
        value,
        json!({"card": {"number": 0, "holder": "T-[redacted:ticket#1]"}, "pin": "[redacted:pin#1]", "note": "[redacted:token#1]"})
    );
    let mut value = json!({"content": [{"note": "a note"}, {"text": "stays"}]});
    redactor.value("result", &mut value, Scope::Data);
    assert_eq!(
        value,
        json!({"content": [{"note": "[redacted:pointer#2]"}, {"text": "stays"}]})
    );
    let alone = Rules::parse("built_in = false\nkeys = ['pin']\n").unwrap();
    assert_eq!(
        Redactor::new(Arc::new(alone)).text("sk-abcdefghijklmnop pin=1"),
        "sk-abcdefghijklmnop pin=[redacted:pin#1]"
    );
}

#[test]
fn mistakes_have_lines() {
    let error = |text: &str| Rules::parse(text).unwrap_err().to_string();
    assert!(error("keys = 3\n").starts_with("line 1, column 8: keys is a list"));
    assert!(error("key = []\n").contains("there are: built_in, keys, pointers, patterns"));
    assert!(error("pointers = ['card']\n").starts_with("line 1, column 13: 'card' is not a place"));
    assert!(error("[patterns]\nA = 'x'\n").starts_with("line 2, column 1: a pattern's name"));
    assert!(error("[patterns]\na = '('\n").starts_with("line 2, column 5: "));
    assert!(error("[patterns]\na = 'x*'\n").contains("matches an empty text"));
    assert!(error("[patterns]\na = 'x(?P<secre>y)'\n").contains("there is no group 'secre'"));
    assert!(error("[patterns]\na = '(\\w{500}){500}'\n").contains("make its repetitions smaller"));
    assert!(error(&"#".repeat(300_000)).contains("larger than"));
    assert!(error("keys = ['-']\n").contains("needs a letter"));
    assert!(error("[keys\n").starts_with("line 1"));
}

#[test]
fn no_rules_change_nothing() {
    let rules = Rules::none().with_environment([("A_TOKEN".to_owned(), "opaque-value".to_owned())]);
    let mut redactor = Redactor::new(Arc::new(rules));
    redactor.learn("authorization", "opaque-value");
    let text = "opaque-value sk-abcdefghijklmnop";
    assert_eq!(redactor.text(text), text);
    assert_eq!(
        replace_value("Key sk\\u002d1 is wrong", "key", "sk-1"),
        "Key [redacted:key] is wrong"
    );
}

#[test]
fn labels_stand_for_secrets() {
    let same = |actual: Value, recorded: &str| is_recorded_as(&actual, &json!(recorded));
    assert!(same(json!("a"), "a") && !same(json!("a"), "b"));
    assert!(same(json!("x hunter2 y"), "x [redacted:password#1] y"));
    assert!(same(json!(1234), "[redacted:pin#1]") && !same(json!(true), "[redacted:pin#1]"));
    assert!(
        !same(json!("x  y"), "x [redacted:password#1] y"),
        "no secret is empty"
    );
    assert!(!same(json!("x hunter2"), "x [redacted:password#1] y"));
    assert!(same(json!("a=1 b=2"), "a=[redacted:a#1] b=[redacted:b#1]"));
    assert!(!same(json!("a=1 c=2"), "a=[redacted:a#1] b=[redacted:b#1]"));
    assert!(same(json!("[redacted: x]"), "[redacted: x]") && !same(json!("y"), "[redacted: x]"));
    let recorded = json!({"[redacted:token#1]": [1, "[redacted:token#2]"]});
    assert!(is_recorded_as(&json!({"sk-1": [1, "sk-2"]}), &recorded));
    assert!(!is_recorded_as(&json!({"sk-1": [2, "sk-2"]}), &recorded));
}

/// JSON of a string in which some characters are escaped though they need not be.
fn escaped(text: &str, which: &[bool]) -> String {
    let mut out = String::new();
    for (letter, escape) in text.chars().zip(which.iter().cycle()) {
        match letter {
            '"' | '\\' => out.extend(['\\', letter]),
            '\n' => out.push_str("\\n"),
            _ if *escape && letter.is_ascii() => out.push_str(&format!("\\u{:04x}", letter as u32)),
            _ => out.push(letter),
        }
    }
    out
}

proptest! {
    /// However deep a secret stands in strings of JSON, and however these are escaped, it is not written.
    #[test]
    fn no_secret_stays(
        secret in "sk-[a-z0-9]{16,24}", around in "[ a-zé{}:,]{0,12}", levels in 0_usize..4,
        which in proptest::collection::vec(any::<bool>(), 1..9), with_key in any::<bool>(),
    ) {
        let mut text = if with_key { format!("{{\"a\": \"{secret}\"}}") } else { format!("{around} {secret} {around}") };
        for _ in 0..levels {
            text = format!("{{\"inner\": \"{}\"}}", escaped(&text, &which));
        }
        let mut value = json!({"a": [{"b": text.clone()}, {secret.clone(): 1}], "c": format!("x {text}")});
        built_in().value("arguments", &mut value, Scope::Data);
        let mut written = value.to_string();
        for _ in 0..8 {
            prop_assert!(!written.contains(&secret), "{written}");
            // As a reader would who reads strings as JSON again.
            let quoted: String = written.replace("\\\\", "\u{1}").replace("\\\"", "\"").replace('\u{1}', "\\");
            let mut plain = quoted;
            while let Some(at) = plain.find("\\u00") {
                let Some(letter) = plain.get(at + 2..at + 6).and_then(|hex| u32::from_str_radix(hex, 16).ok()).and_then(char::from_u32) else { break };
                plain.replace_range(at..at + 6, &letter.to_string());
            }
            written = plain;
        }
        prop_assert!(written.contains("[redacted:token#1]"));
    }

    #[test]
    fn nothing_panics(text in "([{}\\[\\]:,\"= a-z\\\\é]|password|token|sk-abcdefghijklmnop|\\\\u0073|Bearer |https://|@|-----BEGIN PRIVATE KEY-----){0,30}") {
        let mut redactor = built_in();
        let first = redactor.text(&text);
        prop_assert!(first == text || first.contains("[redacted:"));
        let mut value: Value = json!({ "text": text });
        redactor.value("result", &mut value, Scope::Data);
    }
}
