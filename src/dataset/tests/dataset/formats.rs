//! Every format holds the same conversation, tag for image, and says where it comes from.

use std::fs;

use reel_dataset::{
    DatasetError, Episode, ExampleOptions, Format, ImageOptions, ImageStore, LeakKind,
    PrivilegedFacts, RefusalReason, Shards, Split, Step, Style, TaskBriefing, examples, find_leak,
    strip,
};
use reel_prompt::{Prompt, PromptWording};
use reel_world::{Digest, NameSet, ToolSpec};
use serde_json::{Value, json};

use crate::{
    leaks::{planted, secrets},
    sample::{episode, put_frames, told},
};

const TEXT: [Format; 5] = [
    Format::QwenVl,
    Format::MsSwift,
    Format::LlamaFactory,
    Format::Trl,
    Format::OpenAi,
];

fn options(style: Style) -> ExampleOptions {
    ExampleOptions {
        style,
        failed_calls: false,
    }
}

#[test]
fn single_turn_as_reals_trainer_puts_it() {
    let made = examples(&episode("e1", Split::Train), &options(Style::SingleTurn));
    let calls: Vec<u32> = made.examples.iter().map(|example| example.call).collect();
    assert_eq!(
        (calls, made.refused.len()),
        (vec![0, 1, 3, 4, 5], 0),
        "the failed call is context only"
    );
    let messages = made.examples[3].messages();
    let [("user", user), ("assistant", answer)] = &messages[..] else {
        panic!("{messages:?}")
    };
    for part in [
        "You are a household robot",
        "{\"name\": \"navigate_to\",",
        "1) In living room/0: shelf_1, table_2.\n",
        "Task: Bring the vase to the \"glass\" table.\nQuestions asked: 0 of 8\n",
        "Progress: {'History': '0) I did 0 things.\n1) I did 1 things.\n2) I did 2 things.\n3) I did 3 things.'}\n",
        "Last action: {\"tool_name\": \"pick\", \"args\": {\"marker_id\": \"2\"}}\n",
        "Last observation: View: <image>\nResult: Picked up the object with marker 2.",
    ] {
        assert!(user.contains(part), "{part}\n{user}");
    }
    assert!(user.ends_with("marker 2."), "{user}");
    let (thought, json) = answer.split_once('\n').unwrap();
    assert_eq!(thought, "<think>I think 4 times.</think>");
    let json: Value = serde_json::from_str(json).unwrap();
    assert_eq!(
        json["summary"]["History"].as_str().unwrap().lines().last(),
        Some("4) I did 4 things.")
    );
    assert_eq!(json["summary"]["Current subtask"], "Find \"it\".");
    assert_eq!(
        json["next action"],
        json!({ "tool_name": "ask", "args": { "question": "To which \"table\"?\n" } })
    );
    let first = made.examples[0].messages();
    assert!(
        first[0]
            .1
            .ends_with("Progress: {}\nLast action: {}\nLast observation: "),
        "{}",
        first[0].1
    );
    assert!(
        made.examples[4].messages()[0]
            .1
            .contains("Questions asked: 1 of 8")
    );
}

/// The answer of a row, as the format holds it.
fn answer_of(format: Format, row: &Value) -> String {
    let text = match format {
        Format::QwenVl | Format::LlamaFactory => &row["conversations"][1]["value"],
        Format::MsSwift | Format::OpenAi => &row["messages"][1]["content"],
        Format::Trl => &row["completion"][0]["content"][0]["text"],
        Format::Parquet => unreachable!("its rows are columns"),
    };
    text.as_str()
        .unwrap_or_else(|| panic!("{format:?}: {row}"))
        .to_owned()
}

#[test]
fn all_published_parsers_read_every_answer_of_every_format() {
    use reel_prompt::published::{agent_answer, gym_answer, scheduler_action, trainer_action};
    let folder = tempfile::tempdir().unwrap();
    let frames = ImageStore::new(folder.path(), ImageOptions::default());
    let mut episodes = [
        episode("paper", Split::Train),
        episode("real-repo", Split::Train),
        episode("untold", Split::Train),
    ];
    episodes[1].names = NameSet::RealRepo;
    for step in &mut episodes[1].steps {
        step.call_name = ToolSpec::by_name(&step.tool)
            .unwrap()
            .name(NameSet::RealRepo)
            .into();
    }
    for step in &mut episodes[2].steps {
        (step.reasoning, step.history) = (String::new(), String::new());
        (step.schedule, step.subtask) = (String::new(), String::new());
    }
    for episode in &episodes {
        put_frames(episode, &frames);
        let made = examples(
            episode,
            &ExampleOptions {
                style: Style::SingleTurn,
                failed_calls: true,
            },
        );
        assert_eq!(made.examples.len(), episode.steps.len());
        for (example, step) in made.examples.iter().zip(&episode.steps) {
            let mut answers = vec![example.messages().pop().unwrap().1.into_owned()];
            for format in TEXT {
                let mut row = Vec::new();
                format.write_row(example, &frames, &mut row).unwrap();
                answers.push(answer_of(format, &serde_json::from_slice(&row).unwrap()));
            }
            for answer in answers {
                let trainer = trainer_action(&answer).unwrap();
                let name = ToolSpec::by_name(&step.tool)
                    .unwrap()
                    .name(NameSet::RealRepo);
                assert_eq!(
                    (
                        trainer.requested_tool_name.as_str(),
                        trainer.tool_name.as_str()
                    ),
                    (name, name)
                );
                assert!(
                    trainer
                        .arguments
                        .get("marker_id")
                        .is_none_or(Value::is_string),
                    "{answer}"
                );
                let action = Some(json!({ "tool_name": name, "args": trainer.arguments }));
                let agent = agent_answer(&answer).unwrap();
                assert_eq!(
                    (agent.tool_name.as_str(), &agent.arguments),
                    (name, &trainer.arguments)
                );
                let gym = gym_answer(&answer);
                let (history, shown) = scheduler_action(&answer).unwrap();
                assert_eq!((&gym.last_action, &shown), (&action, &action));
                let summary = gym.task_progress.unwrap();
                assert_eq!(summary, Value::from(agent.summary));
                // A History that nobody wrote is empty, and no parser makes one.
                let history = history.expect("every answer has the key");
                assert_eq!(summary["History"], history, "{answer}");
                assert_eq!(history.is_empty(), step.history.is_empty(), "{answer}");
            }
        }
    }
}

#[test]
fn another_template_is_another_prompt() {
    let template = reel_prompt::TEMPLATE
        .replace("Last action:", "You did:")
        .replace("Task: {TASK}", "{TASK}<");
    let prompt =
        std::sync::Arc::new(Prompt::new("mine.txt", &template, PromptWording::default()).unwrap());
    let mut episode = episode("e1", Split::Train);
    let told = TaskBriefing::new("Bring it.", Vec::new(), PrivilegedFacts::none())
        .with_prompt(prompt.clone());
    episode.briefing = told.into();
    let made = examples(&episode, &options(Style::SingleTurn));
    let messages = made.examples[3].messages();
    assert!(
        messages[0].1.contains("\nBring it.<\n")
            && messages[0]
                .1
                .contains("\nYou did: {\"tool_name\": \"pick\"")
    );
    assert_eq!(
        made.examples[3].about.prompt_digest,
        prompt.digest().to_string()
    );
    assert_ne!(prompt.digest(), Prompt::builtin().digest());
}

#[test]
fn rows_are_json_with_a_tag_an_image() {
    let folder = tempfile::tempdir().unwrap();
    let frames = ImageStore::new(folder.path(), ImageOptions::default());
    let episode = episode("e1", Split::Train);
    put_frames(&episode, &frames);
    for style in Style::ALL {
        for failed_calls in [true, false] {
            let made = examples(
                &episode,
                &ExampleOptions {
                    style,
                    failed_calls,
                },
            );
            assert_eq!(
                made.examples.len(),
                match (style, failed_calls) {
                    (Style::MultiTurn, _) => 1,
                    (_, true) => 6,
                    (_, false) => 5,
                }
            );
            for (format, example) in TEXT
                .iter()
                .flat_map(|format| made.examples.iter().map(move |example| (*format, example)))
            {
                let mut row = Vec::new();
                match format.write_row(example, &frames, &mut row) {
                    Err(DatasetError::UnsupportedFormat { .. }) => {
                        let partial = style == Style::MultiTurnPrefix
                            && format == Format::QwenVl
                            && example.call > 0;
                        let some = style == Style::MultiTurn
                            && !failed_calls
                            && !matches!(format, Format::MsSwift | Format::OpenAi);
                        assert!(partial || some, "{format:?} {style:?} {}", example.id);
                        continue;
                    }
                    written => written.unwrap(),
                }
                let row: Value = serde_json::from_slice(&row).unwrap_or_else(|error| {
                    panic!(
                        "{format:?} {style:?}: {error}: {}",
                        String::from_utf8_lossy(&row)
                    )
                });
                let text = row.to_string();
                let tags = match format {
                    Format::Trl => text.matches("{\"type\":\"image\"}").count(),
                    Format::OpenAi => text.matches("data:image/png;base64,").count(),
                    _ => text.matches("<image>").count(),
                };
                assert_eq!(
                    tags,
                    example.images().count(),
                    "{format:?} {style:?} {}",
                    example.id
                );
                assert!(!text.contains("Debug Info"));
                assert_eq!(
                    format == Format::Trl && row.get("prompt").is_none(),
                    format == Format::Trl && style == Style::MultiTurn
                );
                if format.holds_provenance() {
                    assert_eq!(row["provenance"]["trace_digest"], "d".repeat(64));
                    assert_eq!(row["provenance"]["call"], example.call);
                    assert_eq!(row["provenance"]["table_version"], 12);
                    for path in row
                        .get("images")
                        .or(row.get("image"))
                        .and_then(Value::as_array)
                        .into_iter()
                        .flatten()
                    {
                        assert!(folder.path().join(path.as_str().unwrap()).is_file());
                    }
                }
            }
        }
    }
}

#[test]
fn the_text_that_holds_it_is_named_wherever_it_was_planted() {
    type Plant = (&'static str, fn(&mut Episode, String));
    let fields: [Plant; 9] = [
        ("the instruction", |episode, text| {
            episode.briefing = told(&text, "hall/0", secrets())
        }),
        ("receptacle table_2", |episode, text| {
            episode.briefing = told("Bring it.", &text, secrets())
        }),
        ("the reasoning of call 3", |episode, text| {
            episode.steps[3].reasoning = text
        }),
        ("the History of call 3", |episode, text| {
            episode.steps[3].history = text
        }),
        ("the New Schedule of call 3", |episode, text| {
            episode.steps[3].schedule = text
        }),
        ("the Current subtask of call 3", |episode, text| {
            episode.steps[3].subtask = text
        }),
        ("the tool of call 3", |episode, text| {
            episode.steps[3].call_name = text
        }),
        ("the arguments of call 3", |episode, text| {
            episode.steps[3].arguments = json!({ "question": text })
        }),
        ("the outcome of call 3", |episode, text| {
            episode.steps[3].outcome = text
        }),
    ];
    for (_, text) in planted() {
        for (expected, plant) in fields {
            let mut episode = episode("e1", Split::Train);
            episode.briefing = told("Bring it.", "hall/0", secrets());
            plant(&mut episode, format!("The lamp. {text}"));
            // whole payloads are no part of what a tool told
            if expected.contains("outcome")
                && find_leak(&strip(&episode.steps[3].outcome), &secrets()).is_none()
            {
                continue;
            }
            let made = examples(&episode, &options(Style::SingleTurn));
            let named = made.refused.iter().any(
                |it| matches!(&it.reason, RefusalReason::Leak { field, .. } if field == expected),
            );
            assert!(named, "{expected}: {text}: {:?}", made.refused);
        }
    }
}

/// The texts of an episode are looked at together first: what one ends with and the next begins
/// with must hide nothing.
#[test]
fn what_stands_around_a_text_hides_nothing_in_it() {
    let around = [
        ("", ""),
        ("{\"a\":", ",\"a\":1}"),
        ("[", "]"),
        ("[\"", "\"]"),
        ("{\"a\":\"", "\",\"a\":1}"),
        ("{\"a\":\"\\", "\"}"),
        ("shelf_1", ""),
    ];
    for ((before, after), (_, text)) in around
        .into_iter()
        .flat_map(|around| planted().into_iter().map(move |it| (around, it)))
    {
        for planted in 1..5 {
            let mut episode = episode("e1", Split::Train);
            episode.briefing = told("Bring it.", "hall/0", secrets());
            let [
                ..,
                step,
                Step {
                    reasoning,
                    history,
                    schedule,
                    subtask,
                    call_name,
                    ..
                },
                _,
                _,
            ] = &mut episode.steps[..]
            else {
                unreachable!("six steps")
            };
            let fields = [
                &mut step.outcome,
                reasoning,
                history,
                schedule,
                subtask,
                call_name,
            ];
            for (at, field) in fields.into_iter().enumerate() {
                *field = match at {
                    _ if at == planted => text.clone(),
                    _ if at + 1 == planted => before.to_owned(),
                    _ if at == planted + 1 => after.to_owned(),
                    _ => String::new(),
                };
            }
            let made = examples(&episode, &options(Style::SingleTurn));
            assert!(
                made.refused.iter().any(|it| it.call == Some(3)),
                "{before}{text}{after}: {:?}",
                made.refused
            );
        }
    }
}

#[test]
fn what_must_not_be_known_is_refused_with_all_that_repeats_it() {
    let mut episode = episode("e1", Split::Train);
    episode.steps[3].history = "I hold vase_03_on_shelf_1_at_t.".into();
    let calls = |made: &reel_dataset::Examples| {
        made.examples
            .iter()
            .map(|example| example.call)
            .collect::<Vec<_>>()
    };
    let made = examples(&episode, &options(Style::SingleTurn));
    assert_eq!(calls(&made), [0, 1]);
    assert_eq!(
        made.refused.iter().map(|it| it.call).collect::<Vec<_>>(),
        [Some(3), Some(4), Some(5)],
        "memory keeps it"
    );
    assert!(matches!(
        &made.refused[0].reason,
        RefusalReason::Leak {
            kind: LeakKind::Instance,
            ..
        }
    ));
    assert_eq!(
        calls(&examples(&episode, &options(Style::MultiTurn))),
        [5],
        "a History is in no conversation"
    );

    // An answer as it came: later prompts hold its History without the escapes, and thoughts are no harm.
    let mut rollout = episode.clone();
    rollout.steps[3].history = "I see <image>.".into();
    rollout.steps[3].answer =
        Some(r#"<think>So.</think>{"summary": {"History": "I see \u003cimage\u003e."}}"#.into());
    let made = examples(&rollout, &options(Style::SingleTurn));
    assert_eq!(calls(&made), [0, 1]);
    rollout.steps[3].history = "I see it.".into();
    rollout.steps[3].answer =
        Some(r#"<think>So.</think></think>{"summary": {"History": "I see it."}}"#.into());
    let made = examples(&rollout, &options(Style::SingleTurn));
    assert_eq!(calls(&made), [0, 1, 3, 4, 5]);

    episode.steps[1].outcome = "See <image>.".into();
    assert_eq!(
        calls(&examples(&episode, &options(Style::MultiTurnPrefix))),
        [0, 1]
    );
    assert!(
        examples(&episode, &options(Style::MultiTurn))
            .examples
            .is_empty()
    );

    episode.briefing = told(
        "Bring vase_03.",
        "hall/0",
        PrivilegedFacts::new([(LeakKind::Instance, "vase_03")], []),
    );
    let made = examples(&episode, &options(Style::SingleTurn));
    assert_eq!(
        (
            made.examples.len(),
            made.refused.len(),
            made.refused[0].call
        ),
        (0, 1, None)
    );
    assert_eq!(
        made.refused[0].reason.to_string(),
        "the instruction holds an object instance or asset: \"vase_03\""
    );
}

#[test]
fn shards_are_whole_files_of_at_most_so_many_rows() {
    for format in TEXT {
        let folder = tempfile::tempdir().unwrap();
        let mut shards = Shards::new(folder.path(), format, Split::Validation, 2);
        for at in 0..5 {
            shards
                .push(format!("{{\"at\":{at}}}").as_bytes(), b"{}")
                .unwrap();
        }
        let shards = shards.finish().unwrap();
        assert_eq!(
            shards.iter().map(|shard| shard.rows).collect::<Vec<_>>(),
            [2, 2, 1]
        );
        assert_eq!(
            shards[2].path,
            format!("validation/validation-00002.{}", format.extension())
        );
        let text = fs::read_to_string(folder.path().join(&shards[0].path)).unwrap();
        let rows: Vec<Value> = match format {
            Format::QwenVl => serde_json::from_str(&text).unwrap(),
            _ => text
                .lines()
                .map(|line| serde_json::from_str(line).unwrap())
                .collect(),
        };
        assert_eq!(rows.len(), 2);
        let beside = shards[0]
            .provenance
            .as_ref()
            .map(|path| fs::read_to_string(folder.path().join(path)).unwrap());
        assert_eq!(
            beside.as_deref(),
            (!format.holds_provenance()).then_some("{}\n{}\n")
        );
        assert!(
            fs::read_dir(folder.path().join("validation"))
                .unwrap()
                .all(|entry| entry
                    .unwrap()
                    .path()
                    .extension()
                    .is_none_or(|it| it != "part"))
        );
    }
}

#[test]
fn a_missing_image_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let frames = ImageStore::new(folder.path(), ImageOptions::default());
    let made = examples(&episode("e1", Split::Train), &options(Style::SingleTurn));
    let error = Format::MsSwift
        .write_row(&made.examples[1], &frames, &mut Vec::new())
        .unwrap_err();
    assert!(matches!(error, DatasetError::Image { image, .. } if image == Digest::of(b"e1 0")));
}
