//! Logs of Inspect with what only few of them have: scores that were not given, faults, and samples that cannot be read.

use std::{
    fs::{self, File},
    io::{Read, Write},
    path::Path,
};

use reel_import::{
    ImportError, ImportedEpisode,
    inspect::{LogWriter, import},
};
use reel_trace::Trace;
use reel_world::record::{EndReason, Score};
use serde_json::{Value, json};
use zip::{ZipArchive, ZipWriter, write::SimpleFileOptions};

use crate::PLAIN;

const HEADER: &str =
    r#""eval": {"task": "builds", "model": "some/model"}, "results": {"mean": NaN}"#;

/// A sample of one turn, with its further fields as Inspect writes them.
fn sample(id: &str, more: &str) -> String {
    format!(
        r#"{{"id": "{id}", "epoch": 1, "input": "Mend it.", "target": "",
            "messages": [{{"role": "assistant", "content": "It is NaN."}}], {more}}}"#
    )
}

/// One sample with a fault, one with scores that were not given, one without a turn, and one that is none.
fn samples() -> [String; 4] {
    let scores = r#""scores": {
        "judge": {"value": NaN, "explanation": "no grade in NaN words"},
        "parts": {"value": {"given": 0.5, "none": null}}}"#;
    [
        sample(
            "faulty",
            r#""error": {"message": "the sandbox died", "traceback": "at", "traceback_ansi": "at"}"#,
        ),
        sample("unscored", scores),
        r#"{"id": "idle", "epoch": 1, "messages": []}"#.to_owned(),
        r#"{"epoch": 1}"#.to_owned(),
    ]
}

/// A log in one JSON document with these samples.
fn document(path: &Path, samples: &[String]) {
    let text = format!(r#"{{{HEADER}, "samples": [{}]}}"#, samples.join(", "));
    fs::write(path, text).unwrap();
}

/// The same log as an archive.
fn archive(path: &Path, samples: &[String]) {
    let mut zip = ZipWriter::new(File::create(path).unwrap());
    let mut add = |name: &str, text: &str| {
        zip.start_file(name, SimpleFileOptions::default()).unwrap();
        zip.write_all(text.as_bytes()).unwrap();
    };
    add("header.json", &format!("{{{HEADER}}}"));
    for (number, sample) in samples.iter().enumerate() {
        add(&format!("samples/{number}_epoch_1.json"), sample);
    }
    zip.finish().unwrap();
}

/// What came of each sample of a log.
fn results(log: &Path, out: &Path) -> Vec<Result<ImportedEpisode, ImportError>> {
    fs::create_dir_all(out).unwrap();
    import(log, out, &PLAIN, None).unwrap()
}

fn trace(result: &Result<ImportedEpisode, ImportError>) -> Trace {
    Trace::read(&result.as_ref().unwrap().trace).unwrap()
}

#[test]
fn scores_that_were_not_given_keep_their_names() {
    let folder = tempfile::tempdir().unwrap();
    let (log, out) = (folder.path().join("log.json"), folder.path().join("out"));
    document(&log, &samples()[1..2]);
    assert_eq!(
        reel_import::inspect::logs(folder.path()).unwrap(),
        std::slice::from_ref(&log)
    );
    let [result] = &results(&log, &out)[..] else {
        panic!("one sample is one result")
    };
    let score = |name: &str, value: Option<f64>, explanation: Option<&str>| Score {
        name: name.to_owned(),
        value,
        label: None,
        explanation: explanation.map(str::to_owned),
    };
    let read = trace(result);
    assert_eq!(
        read.end.as_ref().unwrap().reported.scores,
        [
            score("judge", None, Some("no grade in NaN words")),
            score("parts.given", Some(0.5), None),
            score("parts.none", None, None),
        ]
    );
    assert_eq!(
        read.steps[0].input.policy.as_ref().unwrap().raw,
        "It is NaN."
    );
}

#[test]
fn samples_that_cannot_be_read_are_results() {
    let folder = tempfile::tempdir().unwrap();
    let (one, other) = (
        folder.path().join("log.json"),
        folder.path().join("log.eval"),
    );
    document(&one, &samples());
    archive(&other, &samples());
    for (log, out) in [(&one, "of-json"), (&other, "of-eval")] {
        let results = results(log, &folder.path().join(out));
        let told: Vec<String> = results
            .iter()
            .map(|result| match result {
                Ok(imported) => imported.task_id.clone(),
                Err(error) => error.to_string(),
            })
            .collect();
        let [faulty, unscored, idle, none] = &told[..] else {
            panic!("four samples are four results: {told:?}")
        };
        assert_eq!(
            [faulty.as_str(), unscored.as_str()],
            ["builds/faulty", "builds/unscored"]
        );
        assert!(
            idle.contains("sample \"idle\", epoch 1: the agent does nothing"),
            "{idle}"
        );
        assert!(none.contains("missing field `id`"), "{none}");
        assert!(results[0].as_ref().unwrap().losses.is_empty());
    }
}

#[test]
fn faults_and_missing_scores_are_written_as_inspect_reads_them() {
    let folder = tempfile::tempdir().unwrap();
    let (log, out) = (folder.path().join("log.eval"), folder.path().join("out"));
    archive(&log, &samples()[..2]);
    let written = folder.path().join("written.eval");
    let mut writer = LogWriter::create(&written, "some/model").unwrap();
    for result in &results(&log, &out) {
        writer.add(&trace(result)).unwrap();
    }
    writer.finish("2026-01-01T00:00:00+00:00").unwrap();
    let mut zip = ZipArchive::new(File::open(&written).unwrap()).unwrap();
    let mut text_of = |name: &str| {
        let mut text = String::new();
        zip.by_name(name)
            .unwrap()
            .read_to_string(&mut text)
            .unwrap();
        text
    };
    let faulty: Value =
        serde_json::from_str(&text_of("samples/builds/faulty_epoch_1.json")).unwrap();
    assert_eq!(
        faulty["error"],
        json!({"message": "the sandbox died", "traceback": "", "traceback_ansi": ""})
    );
    let missing = r#""judge":{"value":NaN,"explanation":"no grade in NaN words"}"#;
    for name in ["samples/builds/unscored_epoch_1.json", "summaries.json"] {
        let text = text_of(name);
        assert!(text.contains(missing), "{name}: {text}");
        assert!(
            text.contains(r#""parts.none":{"value":NaN,"#),
            "{name}: {text}"
        );
    }

    // Reel reads what it wrote, too.
    let again = results(&written, &folder.path().join("again"));
    let ends: Vec<EndReason> = again
        .iter()
        .map(|it| trace(it).end.unwrap().reason)
        .collect();
    assert_eq!(ends, [EndReason::Fault, EndReason::Finished]);
    let scores = |result| trace(result).end.unwrap().reported.scores;
    assert_eq!(scores(&again[1]).len(), 3);
}

/// The samples of a log that Reel writes of these results, by their names in the archive.
fn written(results: &[Result<ImportedEpisode, ImportError>], path: &Path) -> Vec<(String, Value)> {
    let mut writer = LogWriter::create(path, "some/model").unwrap();
    for result in results {
        writer.add(&trace(result)).unwrap();
    }
    writer.finish("2026-01-01T00:00:00+00:00").unwrap();
    let mut zip = ZipArchive::new(File::open(path).unwrap()).unwrap();
    let names: Vec<String> = zip.file_names().map(str::to_owned).collect();
    let samples = names
        .into_iter()
        .filter(|name| name.starts_with("samples/"));
    samples
        .map(|name| {
            let value = serde_json::from_reader(zip.by_name(&name).unwrap()).unwrap();
            (name, value)
        })
        .collect()
}

#[test]
fn epochs_keep_their_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let (log, out) = (folder.path().join("log.json"), folder.path().join("out"));
    let of_epoch = |epoch: u32| {
        format!(
            r#"{{"id": "build", "epoch": {epoch}, "input": "Mend it.",
                "messages": [{{"role": "assistant", "content": "answer {epoch}"}}]}}"#
        )
    };
    let header = r#""eval": {"task": "builds", "model": "m", "config": {"epochs": 3}}"#;
    let samples: Vec<String> = [3, 1, 2].map(of_epoch).into();
    let text = format!(r#"{{{header}, "samples": [{}]}}"#, samples.join(", "));
    fs::write(&log, text).unwrap();
    let samples = written(&results(&log, &out), &folder.path().join("written.eval"));
    assert_eq!(samples.len(), 3);
    for (name, sample) in samples {
        let epoch = sample["epoch"].as_u64().unwrap();
        assert_eq!(name, format!("samples/builds/build_epoch_{epoch}.json"));
        let said = sample["messages"].to_string();
        assert!(said.contains(&format!("answer {epoch}")), "{said}");
    }
}

#[test]
fn what_others_rarely_write_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let (one, other) = (
        folder.path().join("log.json"),
        folder.path().join("log.eval"),
    );
    let call = |function: &str, count: &str| {
        format!(r#"{{"id": "same", "function": "{function}", "arguments": {{"count": {count}}}}}"#)
    };
    let long = "12345678901234567890123";
    // The agent speaks first, two of its calls have one name, and one of them cannot be kept.
    let sample = format!(
        r#"{{"id": "rare", "epoch": 1, "input": "Mend it.", "messages": [
            {{"role": "assistant", "content": "", "tool_calls": [{}, {}]}},
            {{"role": "tool", "tool_call_id": "same", "content": "first"}},
            {{"role": "tool", "tool_call_id": "same", "content": "", "error": {{"type": "timeout", "message": "too slow"}}}},
            {{"role": "user", "content": "And?"}}]}}"#,
        call("read", long),
        call("write", "1")
    );
    document(&one, std::slice::from_ref(&sample));
    archive(&other, &[sample]);
    for (log, out) in [(&one, "of-json"), (&other, "of-eval")] {
        let results = results(log, &folder.path().join(out));
        let losses = &results[0].as_ref().unwrap().losses;
        assert_eq!(losses.len(), 1, "{losses:?}");
        assert!(losses[0].message.contains(long), "{losses:?}");
        let read = trace(&results[0]);
        assert_eq!(read.task.instruction, "Mend it.");
        let texts: Vec<&str> = read
            .steps
            .iter()
            .map(|it| it.outcome.text.as_str())
            .collect();
        assert_eq!(texts, ["first", "too slow\nAnd?"]);
        let again = folder.path().join(format!("{out}.eval"));
        let [(_, sample)] = &written(&results, &again)[..] else {
            panic!("one sample")
        };
        let errors = sample["messages"].as_array().unwrap().iter();
        let errors: Vec<&str> = errors
            .filter_map(|message| message["error"]["message"].as_str())
            .collect();
        assert!(
            errors.iter().any(|error| error.starts_with("too slow")),
            "{errors:?}"
        );
    }
}
