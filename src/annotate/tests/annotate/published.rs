//! Traces in the forms of REAL's annotation.

use reel_annotate::published::{RequestWording, answers, episode, events, pairs, thought};
use serde_json::Value;

use crate::{notes, traces};

const WORDING: RequestWording<'_> = RequestWording {
    system: "S",
    first_history: "1) Begun.",
    important: "I",
    disambiguation: "D",
    asked: |_| "...",
};

#[test]
fn every_trace_becomes_a_stream_and_its_records() {
    for trace in traces() {
        let written = episode(&trace, 7, None);
        assert_eq!(written.id(), "ep_000007");
        let stream = events(&trace, &written);
        let pairs = pairs(&stream);
        assert_eq!(
            pairs.len(),
            written.steps.len(),
            "{}",
            trace.header.episode_id
        );
        for (pair, step) in pairs.iter().zip(&written.steps) {
            let (name, payload) = step.action.iter().next().unwrap();
            let event = pair.action.as_ref().unwrap();
            assert_eq!(
                (event["action"].as_str().unwrap(), &event["payload"]),
                (name.as_str(), payload)
            );
            if ["open", "close"].contains(&name.as_str())
                && payload.get("receptacle_name").is_none()
            {
                assert!(
                    trace.steps.iter().any(|step| step.outcome.error.is_some()),
                    "a door without its receptacle"
                );
            }
        }

        let answers = answers(&notes(&trace));
        let samples = written.samples(&answers, &WORDING);
        assert_eq!(samples.len(), written.steps.len() + 1);
        for (step, sample) in samples.iter().enumerate() {
            assert_eq!(sample["metadata"]["step_id"], step);
            let said = thought(sample["conversations"][2]["value"].as_str().unwrap()).unwrap();
            let lines = said.history.lines().count();
            let answered = step < answers.len();
            assert_eq!(
                lines,
                if step == 0 || !answered { 0 } else { step + 1 },
                "{}",
                said.history
            );
            assert!(
                !answered
                    || said
                        .schedule
                        .is_some_and(|items| items.iter().all(|item| !item.contains(';')))
            );
        }
        let last: Value = serde_json::from_str(
            samples.last().unwrap()["conversations"][3]["value"]
                .as_str()
                .unwrap(),
        )
        .unwrap();
        assert_eq!(last["tool_name"], "finish");
        let template = &written.templates(&WORDING)[0];
        assert_eq!(template["conversations"][2]["value"], "");
        assert_eq!(
            (&template["metadata"], &template["obs_image"]),
            (&samples[0]["metadata"], &Value::from(""))
        );
    }
}
