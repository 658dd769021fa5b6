//! Log-probabilities: they come back as they were recorded, outside of every digest, through
//! rewriting and recovery; and those of another policy are added to the same tokens or refused.

use std::{fs, path::Path};

use reel_trace::{Images, ScoredTokens, Trace, TraceError, examine, recover};
use reel_world::{
    LogprobError, TokenLogprobs,
    record::{Metrics, PolicyOutput},
};

use crate::sample::{Sample, Source};

const TOPIC: &[u8] = b"/logprobs";

fn tokens() -> Vec<String> {
    ["{", "\"next action\"", "}"].map(str::to_owned).to_vec()
}

/// A sample whose second decision alone has log-probabilities, or none has any.
fn sample(with: bool) -> Sample {
    let mut sample = Source::seeded(3).sample(3);
    for step in &mut sample.steps {
        let recorded = (with && step.step == 1)
            .then(|| TokenLogprobs::sampled(tokens(), vec![-0.25, -1.5, -0.0]).unwrap());
        step.input.policy = Some(PolicyOutput {
            raw: "as it came".into(),
            logprobs: recorded,
            ..PolicyOutput::default()
        });
    }
    sample
}

fn recorded(folder: &Path, name: &str, with: bool) -> Trace {
    let path = folder.join(name);
    sample(with).record(&path);
    Trace::read(&path).unwrap()
}

fn scored(policy: &str, logprobs: &[f64]) -> ScoredTokens {
    let episode_id = sample(true).header.episode_id;
    ScoredTokens {
        episode_id,
        step: 1,
        policy: policy.into(),
        tokens: Some(tokens()),
        logprobs: logprobs.to_vec(),
    }
}

#[test]
fn no_digest_knows_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let (with, without) = (
        recorded(folder.path(), "a.mcap", true),
        recorded(folder.path(), "b.mcap", false),
    );
    assert_eq!(with.chain(), without.chain());
    let bits = |values: &[f64]| {
        values
            .iter()
            .map(|value| value.to_bits())
            .collect::<Vec<_>>()
    };
    let (step, of) = with.logprobs().next().unwrap();
    assert_eq!(
        (step, of.tokens(), bits(of.of("old").unwrap())),
        (1, tokens().as_slice(), bits(&[-0.25, -1.5, -0.0]))
    );
    assert_eq!(without.logprobs().count(), 0);
    let holds = |path: &Path| {
        fs::read(path)
            .unwrap()
            .windows(TOPIC.len())
            .any(|bytes| bytes == TOPIC)
    };
    assert!(
        holds(&with.path) && !holds(&without.path),
        "a trace without them has no channel for them"
    );
    assert!(
        examine(&with.path).unwrap().findings.is_empty(),
        "reel trace doctor finds nothing wrong"
    );
}

#[test]
fn another_policy_is_added_to_the_same_tokens() {
    let folder = tempfile::tempdir().unwrap();
    let mut trace = recorded(folder.path(), "a.mcap", true);
    let chain = trace.chain();
    trace
        .add_scored(&scored("new", &[-0.5, -1.0, -0.125]))
        .unwrap();
    trace.save().unwrap();
    let read = Trace::read(&trace.path).unwrap();
    assert_eq!(read.chain(), chain);
    let lines: Vec<ScoredTokens> = read.scored_tokens().collect();
    assert_eq!(
        lines,
        [
            scored("new", &[-0.5, -1.0, -0.125]),
            scored("old", &[-0.25, -1.5, 0.0])
        ]
    );
    let text: String = lines
        .iter()
        .map(|line| serde_json::to_string(line).unwrap() + "\n\n")
        .collect();
    assert_eq!(
        ScoredTokens::read_lines(&text, Path::new("x.jsonl")).unwrap(),
        lines
    );
    assert_eq!(
        read.sampled_as("other", "ref"),
        [ScoredTokens {
            episode_id: "other".into(),
            ..scored("ref", &[-0.25, -1.5, 0.0])
        }]
    );

    // lean, and as it was recovered
    let lean = folder.path().join("lean.mcap");
    read.rewrite(&lean, Images::None, |_| None).unwrap();
    assert_eq!(
        Trace::read(&lean)
            .unwrap()
            .scored_tokens()
            .collect::<Vec<_>>(),
        lines
    );
    let torn = folder.path().join("torn.mcap");
    let bytes = fs::read(&read.path).unwrap();
    fs::write(&torn, &bytes[..bytes.len() - 20]).unwrap();
    let recovery = recover(&torn, None, |_: &Trace, _: &reel_world::record::Graphs| {
        Metrics::default()
    })
    .unwrap();
    assert_eq!(
        Trace::read(&recovery.trace)
            .unwrap()
            .scored_tokens()
            .collect::<Vec<_>>(),
        lines
    );
}

#[test]
fn what_is_not_of_the_recorded_tokens_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut trace = recorded(folder.path(), "a.mcap", true);
    let before = trace.clone();
    let mut refused = |scored: ScoredTokens| trace.add_scored(&scored).unwrap_err().to_string();
    let error = refused(ScoredTokens {
        step: 0,
        ..scored("new", &[-1.0; 3])
    });
    assert!(
        error.contains("step 0") && error.contains("reel bench --logprobs"),
        "{error}"
    );
    assert!(
        refused(ScoredTokens {
            step: 7,
            ..scored("new", &[-1.0; 3])
        })
        .contains("step 7")
    );
    let error = refused(scored("new", &[-1.0; 2]));
    assert!(
        error.contains("step 1") && error.contains("2 log-probabilities for 3 tokens"),
        "{error}"
    );
    assert!(refused(scored("new", &[-1.0, f64::NAN, -1.0])).contains("NaN"));
    assert!(refused(scored("new", &[-1.0, 0.5, -1.0])).contains("0.5"));
    let other = ScoredTokens {
        tokens: Some(vec!["{".into(), "x".into(), "}".into()]),
        ..scored("new", &[-1.0; 3])
    };
    assert!(refused(other).contains("token 1 is \"x\""));
    assert!(matches!(
        trace.add_scored(&scored("old", &[-1.0; 3])),
        Err(TraceError::Logprobs {
            step: 1,
            source: LogprobError::Sampled,
            ..
        })
    ));
    assert_eq!(trace, before);
    for (line, word) in [
        ("{}", "episode_id"),
        ("what", "expected"),
        (r#"{"episode": "a"}"#, "unknown field"),
    ] {
        let error = ScoredTokens::read_lines(&format!("\n{line}\n"), Path::new("x.jsonl"))
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("line 2") && error.contains(word) && error.contains("x.jsonl"),
            "{error}"
        );
    }
}
