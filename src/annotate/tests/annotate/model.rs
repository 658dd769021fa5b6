//! The writer that asks a model, against a scripted endpoint: batches, checkpoints, going on, and
//! what is not believed.

use std::{fs, path::Path, sync::Arc, time::Duration};

use reel_annotate::{
    AnnotateError, AnnotatedEpisode, BATCH, ModelAnnotator, PrivilegedFacts, PublicTask, Step,
    annotate, history_check, prompt_version, read_notes,
};
use reel_history::{EpisodeFacts, StepFacts};
use reel_llm::client::{CallLog, Client, Endpoint};
use reel_prompt::{Prompt, PromptWording, TEMPLATE};
use reel_trace::Trace;
use reel_world::Digest;
use serde_json::{Value, json};

use crate::{
    scripted::{Act, Received, Scripted, TestClock},
    traces, words,
};

/// A long episode, so that there are several batches.
fn episode() -> Trace {
    traces()
        .into_iter()
        .find(|trace| trace.steps.len() > 2 * BATCH)
        .unwrap()
}

fn chain(trace: &Trace) -> Digest {
    trace.chain()
}

fn run(
    trace: &Trace,
    base_url: &str,
    path: &Path,
    check: &reel_annotate::HistoryCheck<'_>,
) -> Result<AnnotatedEpisode, AnnotateError> {
    run_with(
        Prompt::builtin(),
        (BATCH, false),
        trace,
        base_url,
        path,
        check,
    )
}

/// An image before every decision but the second.
fn frame(decision: usize) -> Option<Vec<u8>> {
    (decision != 1).then(|| format!("image {decision}").into_bytes())
}

/// Annotates for a robot that acts on `prompt`, so many decisions a request, with images or without.
fn run_with(
    prompt: Arc<Prompt>,
    form: (usize, bool),
    trace: &Trace,
    base_url: &str,
    path: &Path,
    check: &reel_annotate::HistoryCheck<'_>,
) -> Result<AnnotatedEpisode, AnnotateError> {
    let endpoint = Endpoint {
        retries: 0,
        timeout: Duration::from_secs(20),
        ..Endpoint::new(base_url, "writer-1")
    };
    let log = CallLog::append(path.with_extension("log")).unwrap();
    let client = Client::new(endpoint, Arc::new(TestClock::default()))
        .unwrap()
        .with_log(log);
    let annotator = ModelAnnotator {
        client: &client,
        seed: 7,
        check,
        prompt,
        decisions: form.0,
        frames: form.1.then_some(&frame as &reel_annotate::FrameBefore<'_>),
    };
    let task = PublicTask::of(&trace.task, &trace.scene);
    annotator.annotate(
        &task,
        &Step::all(trace),
        &PrivilegedFacts::of(&trace.task),
        chain(trace),
        path,
    )
}

/// The steps that a request asks for.
fn asked(received: &Received) -> std::ops::Range<usize> {
    let content = &received.body["messages"][1]["content"];
    let text = content.as_str().or(content[0]["text"].as_str()).unwrap();
    let (_, range) = text.rsplit_once("notes of steps ").unwrap();
    let numbers: Vec<usize> = range
        .split(|c: char| !c.is_ascii_digit())
        .filter_map(|word| word.parse().ok())
        .collect();
    numbers[0]..numbers[1] + 1
}

fn answer(steps: std::ops::Range<usize>, change: impl Fn(usize, &mut Value)) -> String {
    let note = |step| {
        let mut note = json!({"step": step, "reasoning": format!("because {step}"), "history": format!("I did {step} things."),
            "schedule": "go on", "subtask": "this"});
        change(step, &mut note);
        note
    };
    Value::Array(steps.map(note).collect()).to_string()
}

fn fine(_: usize, _: &str) -> Option<String> {
    None
}

#[test]
fn step_by_step_with_what_the_robot_saw() {
    let (trace, folder) = (episode(), tempfile::tempdir().unwrap());
    let path = folder.path().join("notes.jsonl");
    let server = Scripted::answering(|received| Act::Reply(answer(asked(received), |_, _| {})));
    let written = run_with(
        Prompt::builtin(),
        (1, true),
        &trace,
        &server.base_url,
        &path,
        &fine,
    );
    let written = written.unwrap();
    assert_eq!(written.fallbacks(), 0);
    let form = written.provenance.request.unwrap();
    assert_eq!((form.decisions, form.frames), (1, true));
    assert_eq!(
        read_notes(&path, &chain(&trace)).unwrap().0,
        written.provenance
    );
    let received = server.received();
    assert_eq!(received.len(), trace.steps.len());
    for (step, received) in received.iter().enumerate() {
        assert_eq!(asked(received), step..step + 1);
        let parts = received.body["messages"][1]["content"].as_array();
        if step == 1 {
            assert!(parts.is_none(), "a result without an image");
            continue;
        }
        let parts = parts.unwrap();
        assert_eq!(
            parts[1]["text"],
            format!("What the robot saw before step {step}:")
        );
        let url = parts[2]["image_url"]["url"].as_str().unwrap();
        assert!(url.starts_with("data:image/png;base64,"), "{url}");
        // The result of the step before is there, its own is not.
        let text = parts[0]["text"].as_str().unwrap();
        let line = |number: usize| {
            let begin = format!("{{\"step\":{number},");
            let line = text.lines().find(|line| line.starts_with(&begin));
            serde_json::from_str::<Value>(line.unwrap()).unwrap()
        };
        assert!(line(step).get("outcome").is_none());
        assert!(step == 0 || line(step - 1).get("outcome").is_some());
        let earlier = format!("{{\"step\":{},", step.saturating_sub(2));
        assert!(step < 2 || !text.contains(&earlier));
        let history = format!("The history of step {} was: I did", step.saturating_sub(1));
        assert_eq!(text.contains(&history), step > 0);
    }
    // Asked in another way, it is asked anew.
    let again = run(&trace, &server.base_url, &path, &fine).unwrap();
    assert_eq!(again.resumed, 0);
}

#[test]
fn an_episode_in_batches_with_the_replies_logged() {
    let (trace, folder) = (episode(), tempfile::tempdir().unwrap());
    let path = folder.path().join("notes.jsonl");
    let server = Scripted::answering(|received| Act::Reply(answer(asked(received), |_, _| {})));
    let written = run(&trace, &server.base_url, &path, &fine).unwrap();
    let steps = trace.steps.len();
    assert_eq!(
        (written.entries.len(), written.fallbacks(), written.resumed),
        (steps, 0, 0)
    );
    assert_eq!(written.entries[3].note.reasoning, "because 3");
    assert_eq!(
        (
            written.provenance.version,
            written.provenance.annotator.as_str()
        ),
        (prompt_version(&Prompt::builtin()), "writer-1")
    );
    assert_eq!(
        read_notes(&path, &chain(&trace)).unwrap(),
        (written.provenance, written.entries)
    );
    let received = server.received();
    assert_eq!(received.len(), steps.div_ceil(BATCH));
    assert_eq!(
        fs::read_to_string(path.with_extension("log"))
            .unwrap()
            .lines()
            .count(),
        received.len()
    );
    // a batch sees no outcome of its last step, and the next one gets the history before it
    let text = |index: usize| {
        received[index].body["messages"][1]["content"]
            .as_str()
            .unwrap()
    };
    let line = |index: usize, step: usize| -> Value {
        text(index)
            .lines()
            .filter_map(|line| serde_json::from_str(line).ok())
            .find(|line: &Value| line["step"] == json!(step))
            .unwrap()
    };
    assert!(
        line(0, BATCH - 1).get("outcome").is_none() && line(1, BATCH - 1).get("outcome").is_some()
    );
    assert!(
        text(1).contains(&format!("was: I did {} things.", BATCH - 1)),
        "{}",
        text(1)
    );
    assert!(text(0).contains("for_your_eyes_only"));
}

#[test]
fn the_model_reads_the_prompt_of_the_robot_and_another_prompt_makes_other_notes() {
    let (trace, folder) = (episode(), tempfile::tempdir().unwrap());
    let path = folder.path().join("notes.jsonl");
    let own = Prompt::new(
        "own",
        &TEMPLATE.replacen("{TASK}", "It shall be done: {TASK}", 1),
        PromptWording::default(),
    )
    .unwrap();
    let server = Scripted::answering(|received| Act::Reply(answer(asked(received), |_, _| {})));
    let first = run(&trace, &server.base_url, &path, &fine).unwrap();
    let asked_first = server.received().len();
    let written = run_with(
        Arc::new(own.clone()),
        (BATCH, false),
        &trace,
        &server.base_url,
        &path,
        &fine,
    )
    .unwrap();
    assert_eq!(
        (written.resumed, written.provenance.version),
        (0, prompt_version(&own))
    );
    assert_ne!(written.provenance.version, first.provenance.version);
    let text = server.received()[asked_first].body["messages"][1]["content"]
        .as_str()
        .unwrap()
        .to_owned();
    assert!(
        text.contains(&format!("It shall be done: {}", trace.task.instruction)),
        "{text}"
    );
    let receptacle = trace.scene.receptacles.first().unwrap().id.as_str();
    assert!(
        text.split("END PROMPT")
            .next()
            .unwrap()
            .contains(receptacle),
        "{text}"
    );
}

#[test]
fn a_run_that_broke_off_goes_on_and_asks_nothing_twice() {
    let (trace, folder) = (episode(), tempfile::tempdir().unwrap());
    let path = folder.path().join("notes.jsonl");
    let broken = Scripted::start(vec![Act::Reply(answer(0..BATCH, |_, _| {}))]);
    let error = run(&trace, &broken.base_url, &path, &fine).unwrap_err();
    assert!(
        matches!(error, AnnotateError::Model { from: BATCH, .. })
            && error.to_string().contains("run the command again"),
        "{error}"
    );
    assert!(matches!(
        read_notes(&path, &chain(&trace)),
        Err(AnnotateError::Incomplete { found: BATCH, .. })
    ));

    let server = Scripted::answering(|received| Act::Reply(answer(asked(received), |_, _| {})));
    let written = run(&trace, &server.base_url, &path, &fine).unwrap();
    assert_eq!(
        (written.resumed, written.entries.len()),
        (BATCH, trace.steps.len())
    );
    assert_eq!(asked(&server.received()[0]).start, BATCH);
    let calls = server.received().len();
    let again = run(&trace, &server.base_url, &path, &fine).unwrap();
    assert_eq!(
        (server.received().len(), again.resumed, again.entries),
        (calls, trace.steps.len(), written.entries)
    );
    // notes of another recording are not written over
    let mut others = traces().into_iter();
    let other = others.find(|other| other.chain() != trace.chain()).unwrap();
    assert!(matches!(
        run(&other, &server.base_url, &path, &fine),
        Err(AnnotateError::OtherTrace { .. })
    ));
}

#[test]
fn what_an_agent_cannot_know_or_what_is_not_so_is_replaced_by_the_rules() {
    let (trace, folder) = (episode(), tempfile::tempdir().unwrap());
    let task = PublicTask::of(&trace.task, &trace.scene);
    let rules = annotate(&task, &Step::all(&trace), 7);
    let target = trace.task.target.to_string();
    let caption = trace
        .task
        .target_object()
        .caption
        .clone()
        .unwrap_or_else(|| "no caption".to_owned());
    let server = Scripted::answering(move |received| {
        let (target, caption) = (target.clone(), caption.clone());
        Act::Reply(answer(asked(received), move |step, note| match step {
            0 => note["reasoning"] = json!(format!("I know that it is {target}")),
            1 => note["schedule"] = json!("go to (1.25, -3.75)"),
            2 => note["history"] = json!("I flew."),
            3 => note["subtask"] = json!(""),
            4 => note["reasoning"] = json!("r"),
            5 => note["reasoning"] = json!(format!("Somewhere there is {caption}")),
            _ => {}
        }))
    });
    let check =
        |_: usize, history: &str| history.contains("flew").then(|| "nobody flew".to_owned());
    let written = run(
        &trace,
        &server.base_url,
        &folder.path().join("notes.jsonl"),
        &check,
    )
    .unwrap();
    for (index, word) in [
        (0, "object instance"),
        (1, "coordinates"),
        (2, "nobody flew"),
        (3, "no complete note"),
    ] {
        let entry = &written.entries[index];
        assert!(
            entry
                .fallback
                .as_ref()
                .is_some_and(|why| why.contains(word)),
            "{index}: {entry:?}"
        );
        assert_eq!(entry.note, rules[index]);
    }
    assert_eq!(
        (
            written.entries[4].fallback.as_ref(),
            words(&written.entries[4].note).starts_with('r')
        ),
        (None, true)
    );
    assert!(
        (4..=5).contains(&written.fallbacks()),
        "{:?}",
        written.entries
    );
}

#[test]
fn a_history_is_held_against_the_deeds_before_it() {
    let trace = traces().into_iter().find(|trace| {
        trace
            .steps
            .iter()
            .any(|step| step.tool_name() == "place" && step.outcome.is_ok())
    });
    let trace = trace.unwrap();
    let placed = trace
        .steps
        .iter()
        .find(|step| step.tool_name() == "place" && step.outcome.is_ok())
        .unwrap();
    let category = trace
        .task
        .object(placed.object.as_ref().unwrap())
        .unwrap()
        .category
        .clone();
    let history = format!(
        "I placed the {category} on {}.",
        placed.receptacle.as_ref().unwrap()
    );
    let setting = EpisodeFacts::of(&trace.task, &trace.scene, &trace.start.graphs.physics);
    let check = history_check(setting, trace.steps.iter().map(StepFacts::of).collect());
    assert_eq!(check(placed.step as usize + 1, &history), None);
    let why = check(placed.step as usize, &history).unwrap();
    assert!(why.contains(&history[..20]), "{why}");
}

#[test]
fn an_answer_that_cannot_be_read_is_asked_for_once_more() {
    let (trace, folder) = (episode(), tempfile::tempdir().unwrap());
    let server =
        Scripted::answering(
            |received| match received.body["messages"].as_array().unwrap().len() {
                2 => Act::Reply("I would rather not.".to_owned()),
                _ => Act::Reply("[]".to_owned()),
            },
        );
    let written = run(
        &trace,
        &server.base_url,
        &folder.path().join("notes.jsonl"),
        &fine,
    )
    .unwrap();
    assert_eq!(written.fallbacks(), trace.steps.len());
    assert_eq!(
        server.received().len(),
        2 * trace.steps.len().div_ceil(BATCH)
    );
}

#[test]
fn the_truth_is_found_in_every_part_of_a_note_and_the_rules_never_say_it() {
    for trace in traces() {
        let (task, steps, secrets) = (
            PublicTask::of(&trace.task, &trace.scene),
            Step::all(&trace),
            PrivilegedFacts::of(&trace.task),
        );
        for (index, note) in annotate(&task, &steps, 3).into_iter().enumerate() {
            assert_eq!(
                secrets.leak(&note, &steps[..index]),
                None,
                "{} step {index}",
                trace.path.display()
            );
            let planted = |part: usize| {
                let mut note = note.clone();
                let part = [
                    &mut note.reasoning,
                    &mut note.history,
                    &mut note.schedule,
                    &mut note.subtask,
                ]
                .into_iter()
                .nth(part)
                .unwrap();
                part.push_str(&format!(" {}", trace.task.target.as_str().to_uppercase()));
                note
            };
            assert!((0..4).all(|part| secrets.leak(&planted(part), &steps[..index]).is_some()));
        }
    }
}
