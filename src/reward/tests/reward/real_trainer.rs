//! The rules of preset `real-trainer`, one by one.

use reel_reward::{
    EpisodeFacts, EpisodeReward, Preset, Scorer, TaskFacts, Term, TrainerEnd, metrics, rewards,
    trainer::{ResetError, TrainerRollout, Turn},
};
use reel_world::{
    ErrorCode, ObjectInstance, Outcome,
    record::{Graphs, RewardTerm},
};
use serde_json::{Value, json};

use crate::{
    NAMES_ONE, close, close_steps, component,
    flat::{Act, Flat, GREEN, PEN, RED, start, task},
    play_by, sum, worked_example,
};

fn play(script: &[Act]) -> Vec<Vec<RewardTerm>> {
    play_by(&Preset::real_trainer(), &task().0, script).1
}

fn with(lines: &str) -> Preset {
    Preset::from_toml(&format!("name = 'other'\nbase = 'real-trainer'\n{lines}")).unwrap()
}

fn scored(preset: &Preset, script: &[Act]) -> EpisodeReward {
    let (task, scene) = task();
    let (mut facts, mut episode, mut reward) = (
        TaskFacts::new(&task, &scene),
        EpisodeFacts::default(),
        EpisodeReward::default(),
    );
    episode.record(
        &mut facts,
        &task,
        &start(&task),
        &Flat::play(&task, script).steps,
    );
    Scorer::new(preset).score(&mut facts, &episode, &mut reward);
    reward
}

#[test]
fn worked_example_of_the_trainer() {
    let (task, _) = task();
    let (mut flat, terms) = play_by(&Preset::real_trainer(), &task, &worked_example(NAMES_ONE));
    let expected = [
        0.0, 0.0, 1.0, -0.03, -0.03, -0.03, 2.77, -0.53, -0.03, -0.03, -0.33, 4.47, 0.0,
    ];
    let metrics = close_steps(&Preset::real_trainer(), &mut flat, &terms, &expected);
    close(metrics.total_reward, 7.23);
    close(metrics.discounted_return, metrics.total_reward); // the trainer adds up
    assert_eq!(
        scored(&Preset::real_trainer(), &worked_example(NAMES_ONE)).ending(),
        Some((11, TrainerEnd::Complete))
    );
}

#[test]
fn another_object_of_the_category_pays_in_full() {
    use Act::*;
    let script = [Open("fridge_0"), Pick(GREEN), Place("fridge_0")];
    let (task, _) = task();
    let (flat, terms) = play_by(&Preset::real_trainer(), &task, &script);
    close(component(&terms, "diff_match"), 3.0);
    close(component(&terms, "perfect_match"), 2.0);
    let success = |preset: &Preset| {
        let graphs = Graphs {
            registry: flat.graph.clone(),
            physics: flat.graph.clone(),
        };
        metrics(preset, &task, &start(&task), &flat.steps, &graphs).success
    };
    assert!(success(&Preset::real_trainer()));
    assert!(!success(&Preset::real_repo()));
}

#[test]
fn finish_pays_by_what_remains_and_ends_the_episode() {
    use Act::*;
    close(sum(&play(&[Finish])[0]), -1.0 - 3.0);
    let half = play(&[Pick(RED), Finish, Place("desk_1"), Ask("?")]);
    close(sum(&half[1]), -1.0 + 0.5 - 3.0);
    assert!(
        half[2..].iter().all(Vec::is_empty),
        "a step after the end pays"
    );
    assert_eq!(
        scored(&Preset::real_trainer(), &[Pick(RED), Finish]).ending(),
        Some((1, TrainerEnd::Finished))
    );
    assert_eq!(scored(&Preset::real_trainer(), &[Pick(RED)]).ending(), None);
    // only a task without targets can be finished complete: with others the episode is done before
    let (mut empty, _) = task();
    empty.goal.clone_from(&empty.initial);
    close(
        sum(&play_by(&Preset::real_trainer(), &empty, &[Finish]).1[0]),
        2.0,
    );
}

#[test]
fn limits_cost_one_and_end_the_episode() {
    use Act::*;
    let walk = || vec![Nav("desk_1"), Nav("table_1"), Nav("desk_1"), Nav("table_1")];
    let steps = with("[rules]\nmax_steps = 3");
    close(sum(&play_by(&steps, &task().0, &walk()).1[2]), -1.0);
    assert_eq!(
        scored(&steps, &walk()).ending(),
        Some((2, TrainerEnd::StepLimit))
    );
    // an unreadable answer counts, and does not end the episode itself
    let mut unreadable = walk();
    unreadable[2] = Fail(ErrorCode::UnparsableOutput);
    let terms = play_by(&steps, &task().0, &unreadable).1;
    close(sum(&terms[2]), -0.5);
    close(component(&terms[3..], "step_limit"), -1.0);
    let turns = with("[rules]\nmax_turns = 3");
    close(
        component(
            &play_by(&turns, &task().0, &unreadable).1[2..3],
            "turn_limit",
        ),
        -1.0,
    );
    assert_eq!(
        scored(&turns, &unreadable).ending(),
        Some((2, TrainerEnd::TurnLimit))
    );
    // both at once: the environment ends first
    let both = with("[rules]\nmax_turns = 3\nmax_steps = 3");
    close(
        component(&play_by(&both, &task().0, &walk()).1, "turn_limit"),
        0.0,
    );
    // completion on the last step costs nothing
    let done = [Open("fridge_0"), Pick(RED), Place("fridge_0")];
    close(
        component(&play_by(&steps, &task().0, &done).1, "step_limit"),
        0.0,
    );
}

#[test]
fn the_hand_counts_by_texts_and_not_by_what_is_held() {
    use Act::*;
    let hand = |script: &[Act]| component(&play(script), "hand");
    close(hand(&[Place("desk_1")]), -0.3);
    close(
        hand(&[Pick(RED), Open("fridge_0"), Close("fridge_0"), Pick(PEN)]),
        -0.9,
    );
    close(hand(&[Pick(RED), Place("desk_1"), Open("fridge_0")]), 0.0);
    // a pick that is refused with a text that is not listed counts as one that worked: holding
    // red, green is refused
    close(
        hand(&[
            Pick(RED),
            Place("desk_1"),
            Pick("ghost_on_attic_9_at_t"),
            Open("fridge_0"),
        ]),
        -0.3,
    );
    // placing nothing is listed, so that the hand stays as it was
    close(hand(&[Place("desk_1"), Open("fridge_0")]), -0.3);
}

#[test]
fn listed_texts_cost_whatever_the_code_says() {
    use Act::*;
    let listed = |code: ErrorCode| component(&play(&[Fail(code)]), "listed_error");
    close(listed(ErrorCode::NothingHeld), -0.5);
    close(listed(ErrorCode::BadArguments), -0.5);
    close(listed(ErrorCode::UnknownMarker), -0.3);
    close(listed(ErrorCode::UnknownTool), -0.3);
    close(listed(ErrorCode::DoorClosed), 0.0);
    close(listed(ErrorCode::UnparsableOutput), 0.0);
    // what a text says after a brace reaches nobody
    let (task, scene) = task();
    let mut flat = Flat::play(&task, &[Nav("desk_1")]);
    flat.steps[0].outcome = Outcome::ok("{\"error\": \"not found in the scene\"}");
    assert!(
        rewards(
            &Preset::real_trainer(),
            &task,
            &scene,
            &start(&task),
            &flat.steps
        )[0]
        .is_empty()
    );
}

#[test]
fn candidates_are_seen_by_name_and_only_picks_that_fail_are_judged() {
    use Act::*;
    // runtime names say no category, so that nothing is ambiguous
    let by_category = play(&[Look("table_1"), Ask("?"), Pick(RED)]);
    close(
        component(&by_category, "ask_when_ambiguous") + component(&by_category, "blind_pick"),
        0.0,
    );
    // unless they do by accident
    let (mut task, scene) = task();
    let rename = |object: &ObjectInstance| {
        object
            .instance
            .as_str()
            .replace("red_", "apple1_")
            .replace("green_", "apple2_")
    };
    let json = serde_json::to_string(&task).unwrap();
    let renamed = task.objects.iter().fold(json, |json, object| {
        json.replace(object.instance.as_str(), &rename(object))
    });
    task = serde_json::from_str(
        &renamed
            .replace("\"red\"", "\"apple1\"")
            .replace("\"green\"", "\"apple2\""),
    )
    .unwrap();
    let (one, two) = ("apple1_on_table_1_at_t", "apple2_on_table_1_at_t");
    let paid = |script: &[Act]| {
        let flat = Flat::play(&task, script);
        rewards(
            &Preset::real_trainer(),
            &task,
            &scene,
            &start(&task),
            &flat.steps,
        )
    };
    let asked = paid(&[Look("table_1"), Ask("Hm."), Ask("Take 1."), Pick(one)]);
    close(component(&asked, "ask_when_ambiguous"), 1.0);
    close(
        component(&asked, "used_marker_from_answer") + component(&asked, "blind_pick"),
        0.0,
    );
    close(
        component(&paid(&[Look("table_1"), Pick(one)]), "blind_pick"),
        0.0,
    );
    // a listed text: the marker is gone
    let failing = |answer: &'static str| {
        let mut flat = Flat::play(&task, &[Look("table_1"), Ask(answer), Pick(two)]);
        flat.steps[2].outcome = Outcome::error(
            ErrorCode::UnknownMarker,
            "Marker ID 1 not found in the marker map.",
        );
        rewards(
            &Preset::real_trainer(),
            &task,
            &scene,
            &start(&task),
            &flat.steps,
        )
    };
    let marker = |script: &[Act]| {
        Flat::play(&task, script)
            .steps
            .last()
            .unwrap()
            .input
            .call
            .arguments["marker_id"]
            .clone()
    };
    let two_is = marker(&[Look("table_1"), Pick(two)]);
    let (right, wrong) = if two_is == json!(1) {
        ("Take 1.", "Hm.")
    } else {
        ("Take 0.", "Hm.")
    };
    close(component(&failing(right), "used_marker_from_answer"), 0.5);
    close(component(&failing(wrong), "blind_pick"), -0.15);
}

fn text(text: impl ToString) -> Value {
    json!({ "type": "text", "text": text.to_string() })
}

fn payload() -> Value {
    json!({
        "task_id": "t_1",
        "target_object": { "id": "u1", "category": "mug" },
        "distractor_metadata": { "u2": { "category": "bowl" } },
        "initial_world_graph": { "shelf": { "content": ["u1_on_shelf_at_t", "u2_on_shelf_at_t"] }, "bench": { "content": [] } },
        "target_world_graph": { "shelf": { "content": ["u2_on_shelf_at_t"] }, "bench": { "content": ["u1_on_shelf_at_t"] } },
    })
}

fn result(graph: Value, held: Value) -> Vec<Value> {
    let debug = json!({ "CURRENT_INV": held, "CURRENT_MARKER_MAP": { "1": "u1_on_shelf_at_t" }, "world_graph": graph });
    vec![
        json!({ "type": "image" }),
        text(format!("Debug Info:\n{debug}")),
    ]
}

fn begin() -> TrainerRollout {
    TrainerRollout::reset(&Preset::real_trainer(), "t_1", &[text(payload())]).unwrap()
}

fn pick(rollout: &mut TrainerRollout, graph: Value) -> f64 {
    let held = json!("u1_on_shelf_at_t");
    rollout
        .step(Turn::Call {
            tool: "pick",
            arguments: &json!({ "marker_id": "1" }),
            content: &result(graph, held),
        })
        .reward
}

#[test]
fn a_rollout_follows_a_server_and_refuses_graphs() {
    let without =
        json!({ "shelf": { "content": ["u2_on_shelf_at_t"] }, "bench": { "content": [] } });
    let mut rollout = begin();
    close(pick(&mut rollout, without.clone()), 1.5 + 1.0 + 0.3 + 0.5);
    assert_eq!(
        rollout.state().remaining,
        [("mug".to_owned(), "bench".to_owned(), true)]
    );
    // an unknown name: nothing changes, until a graph is taken again
    let mut rollout = begin();
    let strange = json!({ "shelf": { "content": ["u2_on_shelf_at_t", "x9_on_shelf_at_t"] }, "bench": { "content": [] } });
    close(pick(&mut rollout, strange), 0.3);
    assert_eq!(
        rollout.state().refusal.map(|refusal| refusal.as_str()),
        Some("unknown_objects")
    );
    close(pick(&mut rollout, without), -0.3 + 1.5 + 1.0 + 0.5);
    assert_eq!(rollout.state().refusal, None);
    // what the trainer never gets
    let mut rollout = begin();
    close(rollout.step(Turn::TimedOut).reward, -0.3);
    assert_eq!(rollout.ending(), None);
    close(rollout.step(Turn::Failed).reward, -1.0);
    assert_eq!(rollout.ending(), Some(TrainerEnd::CallFailed));
    close(rollout.step(Turn::Unreadable).reward, 0.0);
    close(rollout.total(), -1.3);
}

#[test]
fn a_rollout_begins_with_a_payload_of_the_task() {
    let reset =
        |content: &[Value]| TrainerRollout::reset(&Preset::real_trainer(), "t_1", content).err();
    assert_eq!(
        reset(&[json!({ "type": "image" })]),
        Some(ResetError::NoText)
    );
    assert!(matches!(
        reset(&[text("All episodes completed")]),
        Some(ResetError::AllDone { .. })
    ));
    assert!(matches!(
        reset(&[text("Task t_1 not found")]),
        Some(ResetError::NotFound { .. })
    ));
    assert!(matches!(
        reset(&[text("[1]")]),
        Some(ResetError::NoTask { .. })
    ));
    let changed = |key: &str, value: Value| {
        let mut payload = payload();
        payload[key] = value;
        reset(&[text(payload)])
    };
    let other = ResetError::OtherTask {
        asked: "t_1".into(),
        found: "t_2".into(),
    };
    assert_eq!(changed("task_id", json!("t_2")), Some(other));
    assert_eq!(
        changed("initial_world_graph", json!({})),
        Some(ResetError::NoGraph)
    );
    assert_eq!(
        changed(
            "target_world_graph",
            payload()["initial_world_graph"].clone()
        ),
        Some(ResetError::NoTargets)
    );
    let mut rollout = begin();
    assert_eq!((rollout.target_count(), rollout.ending()), (2, None));
    let finish = rollout.step(Turn::Finish);
    assert!(
        finish
            .terms
            .iter()
            .any(|fired| fired.term == Term::PrematureFinish)
    );
    close(finish.reward, -4.0);
}
