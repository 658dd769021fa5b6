//! A model plays the user of a served agent: what gives something away is refused and asked again,
//! and every reply is in the trace.

#[path = "../../../episode/tests/user_leaks/replies.rs"]
#[expect(dead_code, reason = "all but the honest replies")]
mod replies;

use std::{collections::BTreeMap, fs};

use serde_json::{Value, json};

use crate::{
    complaint,
    endpoint::{answering, completion},
    stdio_client::{StdioClient, traces},
};
use replies::LEAKS;

/// So many tasks, in each of which every way to leak is tried.
const TASKS: usize = 25;
const HONEST: &str = "I mean what I asked for; please go on looking.";

#[test]
fn a_served_user_model_leaks_nothing_in_500_dialogues() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(
        folder,
        "task draw --scene S3 --count 25 --seed 35 --out tasks"
    );
    let loaded = reel_tasks::load_with(
        &folder.join("tasks"),
        &reel_tasks::SceneSource::ById {
            built_in: reel_tasks::generate::scene::by_id,
            folders: Vec::new(),
        },
        reel_tasks::ObjectOrder::AsWritten,
    );
    let known: BTreeMap<String, _> = loaded
        .report
        .tasks
        .iter()
        .map(|task| {
            let scene = loaded.scenes.of(task).unwrap().clone();
            (task.instruction.clone(), (task.clone(), scene))
        })
        .collect();
    // Leaks in the way that the question names: once, twice, or however often it is asked.
    let url = answering(move |request| {
        let prompt = request["messages"][1]["content"].as_str().unwrap();
        let told = prompt.lines().next().unwrap();
        let instruction = told.strip_prefix("What you told the robot: ").unwrap();
        let (task, scene) = &known[instruction];
        let asked = prompt.split("The robot asks: way ").nth(1).unwrap();
        let way: usize = asked.split('?').next().unwrap().parse().unwrap();
        let refused = prompt.matches("You were about to say:").count();
        let leaks = refused <= way % 3;
        completion(&if leaks {
            LEAKS[way].1(task, scene)
        } else {
            HONEST.to_owned()
        })
    });
    let arguments = [
        "--tasks",
        "tasks",
        "--data",
        "data",
        "--no-images",
        "--user-model",
        "leaky",
        "--endpoint",
        &url,
    ];
    let mut client = StdioClient::start(folder, &arguments);
    for _ in 0..TASKS {
        client.call("finish", &json!({}));
        for way in 0..LEAKS.len() {
            let question = format!("way {way}? Which one do you mean?");
            let (text, failed) = client.call("ask", &json!({"question": question}));
            assert!(!failed, "{text}");
            assert_eq!(text.contains(HONEST), way % 3 < 2, "{text}");
        }
    }
    client.leave();

    let traces = traces(&folder.join("data/traces"));
    assert_eq!(traces.len(), TASKS);
    let mut dialogues = 0;
    for trace in &traces {
        for (step, (name, leak)) in trace.steps.iter().zip(LEAKS) {
            let (input, leak) = (&step.input, leak(&trace.task, &trace.scene));
            let tries = 1 + dialogues % LEAKS.len() % 3;
            assert_eq!(input.refused_replies.len(), tries, "{name}");
            for refused in &input.refused_replies {
                assert_eq!(refused.text, leak);
                assert!(!refused.rules.is_empty(), "{name}");
            }
            let reply = input.user_reply.as_ref().map(|reply| reply.text.as_str());
            assert_eq!(reply, (tries < 3).then_some(HONEST), "{name}");
            assert!(!step.outcome.text.contains(&leak), "{name}: {leak}");
            dialogues += 1;
        }
        assert_eq!(trace.header.policy.parameters["user"]["model"], "leaky");
    }
    assert_eq!(dialogues, 500);
    assert!(reel!(folder, "replay data/traces").contains("25"));

    reel!(folder, "ingest data/traces --store store");
    let episode = &traces[0].header.episode_id;
    for (step, label) in [(0, "faithful"), (1, "unclear"), (3, "unfaithful")] {
        reel!(
            folder,
            "store label answer {episode} --step {step} --as {label} --author ann --store store"
        );
    }
    reel!(
        folder,
        "store label answer {episode} --step 1 --as faithful --author ben --store store"
    );
    reel!(
        folder,
        "store label answer {episode} --step 0 --as faithful --author ann --store store"
    );
    let text = complaint(
        folder,
        2,
        &format!("store label answer {episode} --step 20 --as unclear --author ann --store store"),
    );
    assert!(text.contains("no answer to label at step 20"), "{text}");
    let rows = reel!(
        folder,
        "query --store store --named answer_fidelity --format json"
    );
    let rows: Vec<Value> = serde_json::from_str(&rows).unwrap();
    let counts = |row: &Value| {
        [
            "answers",
            "refused",
            "labelled",
            "faithful",
            "unclear",
            "unfaithful",
            "disputed",
        ]
        .map(|name| row[name].as_i64().unwrap())
    };
    // Two of three ways end with a reply of the model, refused once or twice before.
    assert_eq!(rows[0]["source"], "model");
    assert_eq!(counts(&rows[0]), [25 * 14, 25 * (7 + 2 * 7), 3, 1, 0, 1, 1]);
    assert_eq!(counts(&rows[1]), [25 * 6, 25 * 3 * 6, 0, 0, 0, 0, 0]);
}

#[test]
fn a_question_that_the_model_does_not_answer_is_not_asked() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 1 --seed 35 --out tasks");
    fs::write(
        folder.join("serve.toml"),
        "[play]\ntasks = \"tasks\"\nask = \"model\"\nuser = { model = \"m\", endpoint = \"http://127.0.0.1:9/v1\" }\n",
    )
    .unwrap();
    let mut client = StdioClient::start(folder, &["--config", "serve.toml", "--data", "data"]);
    client.call("finish", &json!({}));
    let (text, failed) = client.call("ask", &json!({"question": "Which one?"}));
    assert!(
        failed && text.contains("the user cannot be reached now"),
        "{text}"
    );
    assert!(!text.contains("127.0.0.1"), "{text}");
    client.leave();
    assert!(traces(&folder.join("data/traces"))[0].steps.is_empty());

    let text = complaint(folder, 2, "mcp --ask model --data none");
    assert!(
        text.contains("--user-model (play.user.model) is missing"),
        "{text}"
    );
    let text = complaint(folder, 2, "mcp --ask rules --user-model m --data none");
    assert!(text.contains("leave one of the two out"), "{text}");
}
