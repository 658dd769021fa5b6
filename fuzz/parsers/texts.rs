//! What models, people and servers say: answers of policies, replies of endpoints, notes,
//! Histories, questions, proposals, payloads of the trainer.

use std::sync::LazyLock;

use reel_episode::user::RuleUser;
use reel_history::{Checker, EpisodeFacts, StepFacts, repair_history};
use reel_reward::{
    Preset,
    trainer::{TrainerRollout, Turn},
};
use reel_tasks::{
    generate::{
        social::{Strategy, proposal},
        task::compatibility,
    },
    library,
};
use reel_world::{
    Digest, Task, Tool,
    answer::{AssistantTurn, Call},
};
use serde_json::Value;

use super::{HOME, TASK, file, text};

/// A task that loads, in its scene.
static SOME_TASK: LazyLock<Task> = LazyLock::new(|| {
    let parsed = reel_tasks::parse(TASK, "task.yaml", &HOME);
    parsed.expect("a task of the corpus").0
});

/// What a policy says, as Reel and as each of REAL's clients reads it.
pub fn answer(bytes: &[u8]) {
    use reel_prompt::published;
    text(bytes, |text| {
        let _ = AssistantTurn::parse(text).output();
        let _ = reel_prompt::python::objects(text).count();
        let _ = published::agent_answer(text);
        let _ = published::trainer_action(text);
        let _ = published::gym_answer(text);
        let _ = published::scheduler_action(text);
    });
}

/// Calls in a file.
pub fn calls(bytes: &[u8]) {
    text(bytes, |text| {
        let calls = reel_counterfactual::branch::parse_calls(text);
        for call in calls.iter().flatten() {
            let _ = Tool::parse(call);
        }
    });
}

/// A policy's running summary, whose claims are judged.
pub fn history(bytes: &[u8]) {
    let (task, scene) = (&*SOME_TASK, &*HOME);
    let mut checker = Checker::new(EpisodeFacts::of(task, scene, &task.initial));
    for (step, (tool, receptacle)) in (0..).zip([("nav_to", task.src.as_str()), ("find", "")]) {
        checker.push_step(StepFacts {
            step,
            tool: tool.to_owned(),
            argument: Some(receptacle.to_owned()),
            receptacle: Some(receptacle.to_owned()).filter(|name| !name.is_empty()),
            ..StepFacts::default()
        });
    }
    if let Ok(text) = str::from_utf8(bytes) {
        for claim in checker.check(text) {
            assert!(text.get(claim.span.clone()).is_some(), "{:?}", claim.span);
        }
        repair_history(&mut checker, text);
    }
}

/// The body that the endpoint of a model answers with.
pub fn model_body(bytes: &[u8]) {
    text(bytes, |text| {
        for call in reel_llm::client::read_body(text).iter().flatten() {
            let _ = Call::of_value(call).map(|call| call.canonical());
        }
        if let Ok(message) = serde_json::from_str(text) {
            let _ = AssistantTurn::of_message(&message).output();
        }
    });
}

/// Notes: a model's answer, and the file beside a trace.
pub fn notes(bytes: &[u8]) {
    text(bytes, |text| drop(reel_annotate::parse_answer(text)));
    file(bytes, "trace.mcap.notes.jsonl", |path| {
        let _ = reel_annotate::read_notes(path, &Digest::default());
    });
}

/// What a model proposes as a social task, and as things that a receptacle holds.
pub fn proposal(bytes: &[u8]) {
    let (task, scene) = (&*SOME_TASK, &*HOME);
    text(bytes, |text| {
        let _ = proposal::judge(task, scene, &Strategy::ALL, text);
        let _ = compatibility::judge(text, library::small_library());
    });
}

/// A question to the simulated user.
pub fn question(bytes: &[u8]) {
    let (task, scene) = (&*SOME_TASK, &*HOME);
    text(bytes, |text| {
        let mut user = RuleUser::new(task, scene);
        let _ = user.answer(text);
        user.observe(text, std::slice::from_ref(&task.target));
        user.observe_held(Some(&task.target));
        let _ = user.answer(text);
    });
}

/// The template of a prompt.
pub fn template(bytes: &[u8]) {
    text(bytes, |text| {
        let _ = reel_prompt::Template::parse(text);
    });
}

/// What the published trainer is sent: the answer to `finish_with_id`, then a result a line.
pub fn trainer(bytes: &[u8]) {
    let preset = Preset::real_trainer();
    text(bytes, |text| {
        let mut answers = text
            .lines()
            .map(|line| serde_json::from_str(line).unwrap_or_default());
        let content = |answer: Value| match answer {
            Value::Array(items) => items,
            item => vec![item],
        };
        let first = content(answers.next().unwrap_or_default());
        let Ok(mut rollout) = TrainerRollout::reset(&preset, "FDO/sample_1", &first) else {
            return;
        };
        for answer in answers {
            let (tool, arguments) = (answer["tool"].clone(), answer["arguments"].clone());
            rollout.step(Turn::Call {
                tool: tool.as_str().unwrap_or("pick"),
                arguments: &arguments,
                content: &content(answer["content"].clone()),
            });
        }
        let _ = (rollout.total(), rollout.ending(), rollout.state());
    });
}
