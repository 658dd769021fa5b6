//! REAL's annotation script: ours against `memory.json` and the
//! annotation column of `answers.json`.

use reel_annotate::published::{
    Episode, Pair, RequestWording, StreamStep, TaskMeta, action_text, json_text, normalise, pairs,
    thought,
};
use reel_vectors::{Report, items, load, text};
use serde_json::{Map, Value, json};

const MEMORY: &str = "memory.json";

/// Tokens in the place of published wording.
const TOKENS: RequestWording<'_> = RequestWording {
    system: "SYS",
    first_history: "⟦history 1⟧",
    important: "⟦fixed⟧",
    disambiguation: "⟦fixed⟧",
    asked: |_| "",
};

fn map(value: &Value) -> &Map<String, Value> {
    value.as_object().unwrap()
}

#[test]
fn answers_are_cleaned() {
    let Some(document) = load("answers.json") else {
        return;
    };
    let mut report = Report::new("answers.json", "annotation");
    for case in items(&document["cases"])
        .iter()
        .filter(|case| case.get("annotation").is_some())
    {
        let answer = text(&case["text"]);
        let ours = json!({ "json_text": json_text(answer), "canonical": thought(answer).map(|thought| thought.to_json()) });
        report.compare_ordered(text(&case["id"]), &case["annotation"], &ours);
    }
    report.finish();
}

#[test]
fn texts_of_actions() {
    let Some(document) = load(MEMORY) else { return };
    let mut report = Report::new(MEMORY, "action_format");
    for case in items(&document["action_format"]) {
        report.compare(
            &case["action"].to_string(),
            &case["text"],
            &json!(action_text(map(&case["action"]))),
        );
    }
    report.finish();
}

#[test]
fn events_become_actions() {
    let Some(document) = load(MEMORY) else { return };
    let mut report = Report::new(MEMORY, "normalise");
    for case in items(&document["normalise"]) {
        report.compare(
            &case["event"].to_string(),
            &case["normal"],
            &json!(normalise(map(&case["event"]))),
        );
    }
    report.finish();
}

#[test]
fn observations_follow_actions() {
    let Some(document) = load(MEMORY) else { return };
    let mut report = Report::new(MEMORY, "pairing");
    for (index, case) in items(&document["pairing"]).iter().enumerate() {
        let pair = |Pair {
                        action,
                        observation,
                    }: &Pair| {
            let action = action
                .as_ref()
                .map(|action| json!({ "name": action["action"], "payload": action["payload"] }));
            json!({ "action": action, "obs": observation.as_ref().map(|payload| json!({ "payload": payload })) })
        };
        let ours: Vec<Value> = pairs(items(&case["stream"])).iter().map(pair).collect();
        report.compare(&index.to_string(), &case["pairs"], &json!(ours));
    }
    report.finish();
}

#[test]
fn annotated_episodes() {
    let Some(document) = load(MEMORY) else { return };
    let mut report = Report::new(MEMORY, "annotation");
    for case in items(&document["annotation"]) {
        let step = |(action, text_of): (&Value, &Value)| StreamStep {
            action: map(action).clone(),
            text: text(text_of).to_owned(),
            // The vectors' observations without text are images.
            image: text(text_of).is_empty(),
        };
        let task = &case["samples"][0]["human"];
        let places = &task["Object disambiguation"];
        let names = |value: &Value| {
            items(value)
                .iter()
                .map(|name| text(name).to_owned())
                .collect()
        };
        let episode = Episode {
            number: 1,
            model_name: None,
            eval_subset: None,
            task: TaskMeta {
                task_description: text(&task["Task instruction"]).to_owned(),
                src: text(&places["src"]).to_owned(),
                dest: text(&places["dest"]).to_owned(),
                src_distractors: names(&places["src_distractors"]),
                dest_distractors: names(&places["dest_distractors"]),
            },
            steps: items(&case["actions"])
                .iter()
                .zip(items(&case["texts"]))
                .map(step)
                .collect(),
        };
        let answers: Vec<String> = items(&case["answers"])
            .iter()
            .map(|answer| text(answer).to_owned())
            .collect();
        let samples = episode.samples(&answers, &TOKENS);
        assert_eq!(samples.len(), items(&case["samples"]).len());
        for (index, (expected, sample)) in items(&case["samples"]).iter().zip(&samples).enumerate()
        {
            let sample = parsed(sample);
            let ours = json!({ "human": sample["conversations"][1]["value"], "samples": sample });
            report.compare_ordered(&format!("{} {index}", text(&case["id"])), expected, &ours);
        }
    }
    report.finish();
}

/// A record as the vectors show it: texts that are JSON objects parsed, the asked form
/// as its sorted keys.
fn parsed(record: &Value) -> Value {
    let mut record = record.clone();
    for message in record["conversations"].as_array_mut().unwrap() {
        let value: Option<Value> = serde_json::from_str(text(&message["value"]))
            .ok()
            .filter(Value::is_object);
        let Some(mut value) = value else { continue };
        if let Some(form) = value.get_mut("Output format (REQUIRED JSON)") {
            let mut keys: Vec<&String> = map(&form["Summary"]).keys().collect();
            keys.sort();
            *form = json!({ "⟦shape⟧": keys });
        }
        message["value"] = value;
    }
    record
}
