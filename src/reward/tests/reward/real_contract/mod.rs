//! The published reward class, trainer and metric, on vectors of inputs and outputs.

mod class;

use std::collections::BTreeSet;

use reel_reward::{
    AppliedTerm, EpisodeOutcome, MetricOptions, Preset, Term, TrainerEnd, TrainingFigures,
    TrainingMetric,
    trainer::{
        Categories, Graph, HandViolation, TextError, TrainerRollout, Turn, graph_rejection,
        is_not_found, marker_in_answer,
    },
};
use reel_vectors::{Report, items, load, text};
use reel_world::answer::AssistantTurn;
use serde_json::{Map, Value, json};

/// A preset from a published configuration.
fn preset(base: &str, config: &Value, more: &str) -> Preset {
    let (mut weights, mut rules) = (String::new(), String::new());
    for section in [
        "reward_weights",
        "partial_credit_weights",
        "anti_exploit_weights",
    ] {
        for (key, value) in config[section].as_object().into_iter().flatten() {
            match key.as_str() {
                "step_penalty_start" => rules += &format!("free_steps = {value}\n"),
                "ask_reward" => weights += &format!("ask = {value}\n"),
                "blind_pick_penalty" => weights += &format!("blind_pick = {value}\n"),
                key => weights += &format!("{key} = {value}\n"),
            }
        }
    }
    if config["use_partial_credit"] == false {
        for term in [
            "pick_correct_object",
            "partial_move",
            "replan_recover_pick",
            "ask",
            "ask_when_ambiguous",
            "used_marker_from_answer",
            "blind_pick",
        ] {
            weights += &format!("{term} = 0.0\n");
        }
    }
    if config["use_anti_exploit"] == true {
        rules += "anti_exploit = true\n";
    }
    Preset::from_toml(&format!(
        "name = 'of-a-vector'\nbase = '{base}'\n[weights]\n{weights}[rules]\n{rules}{more}"
    ))
    .unwrap()
}

fn sum(terms: &[AppliedTerm], of: &[Term]) -> f64 {
    terms
        .iter()
        .filter(|fired| of.contains(&fired.term))
        .map(|fired| fired.value)
        .sum()
}

fn count(terms: &[AppliedTerm], of: Term) -> usize {
    terms.iter().filter(|fired| fired.term == of).count()
}

const PARTIAL: &[Term] = &[Term::PickCorrectObject, Term::PartialMove];
const TRACK: &[Term] = &[
    Term::FirstVisitTargetFurniture,
    Term::NavRevisitWindow,
    Term::RepeatedPerception,
    Term::RepeatedGaze,
];
const TOOLS: &[Term] = &[
    Term::AskTool,
    Term::AskWhenAmbiguous,
    Term::UsedMarkerFromAnswer,
    Term::BlindPick,
];

#[test]
fn the_metric_counts_as_published() {
    let Some(document) = load("reward.json") else {
        return;
    };
    let mut report = Report::new("reward.json", "metric");
    for case in items(&document["metric"]) {
        let defaults = MetricOptions::default();
        let size = |key: &str, default: usize| {
            case["config"][key]
                .as_u64()
                .map_or(default, |value| value as usize)
        };
        let mut metric = TrainingMetric::new(MetricOptions {
            history_max: size("max_history", defaults.history_max),
            window: size("window_size", defaults.window),
            success_min: case["config"]["success_threshold"]
                .as_f64()
                .unwrap_or(defaults.success_min),
        });
        let mut episodes = Vec::new();
        for (id, episode) in items(&case["episodes"]).iter().enumerate() {
            let mut outcome = EpisodeOutcome::default();
            for step in items(&episode["steps"]) {
                let matched = step[1]["matched_diffs"].as_array().map_or(0, Vec::len);
                let targets = episode["targets"].as_u64().unwrap() as u32;
                outcome.step(
                    targets,
                    step[0].as_f64().unwrap(),
                    matched as u32,
                    step[1]["completion_rate"].as_f64(),
                );
            }
            let end = &episode["end"];
            outcome.completion = end["completion_rate"]
                .as_f64()
                .unwrap_or(outcome.completion);
            outcome.success = end["success"].as_bool();
            outcome.timeout = end["timeout"] == true;
            outcome.invalid_action = end["invalid_action"] == true;
            metric.push(outcome);
            episodes.push(json!({
                "episode_id": id, "total_steps": outcome.steps, "total_reward": outcome.reward,
                "completed_diff_count": outcome.completed, "completion_rate": outcome.completion,
                "is_success": metric.is_success(&outcome), "is_timeout": outcome.timeout,
            }));
        }
        let mut found = json!({ "metrics": all(&metric.figures()) });
        if !episodes.is_empty() {
            found["episodes"] = json!(episodes);
            found["recent"] = recent(&metric.recent(None));
            found["recent_2"] = recent(&metric.recent(Some(2)));
        }
        report.compare(text(&case["id"]), &case["expect"], &found);
    }
    report.finish();
}

fn all(figures: &TrainingFigures) -> Value {
    let mut found = json!({
        "success_rate": figures.success_rate, "timeout_rate": figures.timeout_rate,
        "invalid_action_rate": figures.invalid_action_rate, "total_episodes": figures.episodes,
        "avg_completion_rate": figures.completion[0], "avg_reward": figures.reward[0], "avg_steps": figures.steps[0],
    });
    if figures.episodes > 0 {
        found["std_completion_rate"] = json!(figures.completion[1]);
        found["std_reward"] = json!(figures.reward[1]);
        found["std_steps"] = json!(figures.steps[1]);
    }
    found
}

fn recent(figures: &TrainingFigures) -> Value {
    json!({
        "recent_success_rate": figures.success_rate, "recent_avg_completion_rate": figures.completion[0],
        "recent_avg_reward": figures.reward[0], "recent_avg_steps": figures.steps[0],
        "recent_timeout_rate": figures.timeout_rate, "recent_invalid_action_rate": figures.invalid_action_rate,
        "recent_episodes": figures.episodes,
    })
}

/// Items of a result with their texts as a server sends them.
fn content(of: &Value) -> Vec<Value> {
    let item = |item: &Value| match (item.get("debug"), item.get("json")) {
        (Some(debug), _) => json!({ "type": "text", "text": format!("Debug Info:\n{debug}") }),
        (_, Some(json)) => json!({ "type": "text", "text": json.to_string() }),
        _ => item.clone(),
    };
    of.as_array().into_iter().flatten().map(item).collect()
}

/// Whole episodes, step by step: pay, state, end.
#[test]
fn the_trainer_pays_whole_episodes_as_published() {
    let Some(document) = load("trainer_episodes.json") else {
        return;
    };
    let (mut resets, mut steps) = (
        Report::new("trainer_episodes.json", "resets"),
        Report::new("trainer_episodes.json", "steps"),
    );
    let mut ends = Report::new("trainer_episodes.json", "episodes");
    for episode in items(&document["episodes"]) {
        let id = text(&episode["id"]);
        if episode["payload"].is_null() {
            resets.deviation("the trainer stops at the tool list, before any payload: trainer_contract.json, tool_lists");
            continue;
        }
        let config = &episode["config"];
        let limits = format!(
            "max_turns = {}\n{}",
            episode["max_turns"],
            config["max_steps"]
                .as_u64()
                .map_or(String::new(), |steps| format!("max_steps = {steps}\n"))
        );
        let preset = preset("real-trainer", &config["reward_config"], &limits);
        let payload = &episode["payload"];
        let sent = if payload.is_object() {
            vec![json!({ "type": "text", "text": payload.to_string() })]
        } else {
            content(payload)
        };
        let (_, asked) = text(&episode["task"]).split_once('/').unwrap();
        let rollout = TrainerRollout::reset(&preset, asked, &sent);
        resets.compare(id, &reset_wanted(&episode["reset"]), &reset_found(&rollout));
        if let Ok(rollout) = rollout {
            play(rollout, episode, &mut steps, &mut ends);
        }
    }
    resets.finish();
    steps.finish();
    ends.finish();
}

fn reset_wanted(reset: &Value) -> Value {
    let keys = reel_world::words! {
        error invalid_task stale done target_diffs targets
    };
    keys.into_iter()
        .map(|key| (key.to_owned(), reset[key].clone()))
        .collect::<Map<String, Value>>()
        .into()
}

fn reset_found(rollout: &Result<TrainerRollout, reel_reward::trainer::ResetError>) -> Value {
    use reel_reward::trainer::ResetError::*;
    let flags = |error: bool, invalid: bool, stale: bool, done: bool| json!({ "error": error, "invalid_task": invalid, "stale": stale, "done": done, "target_diffs": null, "targets": null });
    match rollout {
        Ok(rollout) => {
            let mut found = flags(false, false, false, false);
            found["target_diffs"] = json!(rollout.target_count());
            found["targets"] = targets(&rollout.state().remaining);
            found
        }
        Err(NoText) => flags(true, false, false, false),
        Err(AllDone { .. }) => flags(false, false, false, true),
        Err(OtherTask { .. }) => flags(true, true, true, false),
        Err(_) => flags(true, true, false, false),
    }
}

fn targets(remaining: &[(String, String, bool)]) -> Value {
    let mut targets: Vec<Value> = remaining
        .iter()
        .map(|(kind, place, add)| json!([kind, place, if *add { "add" } else { "remove" }]))
        .collect();
    targets.sort_by_key(Value::to_string);
    json!(targets)
}

fn sorted(values: &Value) -> Value {
    let mut values = values.as_array().cloned().unwrap_or_default();
    values.sort_by_key(Value::to_string);
    json!(values)
}

fn play(mut rollout: TrainerRollout, episode: &Value, steps: &mut Report, ends: &mut Report) {
    let id = text(&episode["id"]);
    let mut outcome = EpisodeOutcome::default();
    let mut horizon = 0.0;
    for (index, step) in items(&episode["steps"]).iter().enumerate() {
        let expected = &step["expect"];
        let result = &step["result"];
        let items_of_result = content(&result["content"]);
        let calls = items(&step["calls"]);
        let action = AssistantTurn::parse(text(&step["text"])).action;
        let turn = match (calls.first(), action) {
            (Some(_), _) if result["isError"] == true || result.get("raise").is_some() => {
                Turn::Failed
            }
            (Some(call), _) => Turn::Call {
                tool: text(&call["name"]),
                arguments: &call["arguments"],
                content: &items_of_result,
            },
            (None, None) => Turn::Unreadable,
            (None, Some(action)) if action.name == "finish" => Turn::Finish,
            (None, Some(_)) => Turn::TimedOut,
        };
        let called = matches!(turn, Turn::Call { .. });
        let before = rollout.state();
        let paid = rollout.step(turn);
        // the scheduler's term is an entry of its own
        let turn_limit = sum(&paid.terms, &[Term::TurnLimit]);
        horizon += turn_limit;
        let state = rollout.state();
        let done = state
            .ending
            .is_some_and(|ending| ending != TrainerEnd::TurnLimit);
        let failed = state.ending == Some(TrainerEnd::CallFailed);
        let told = TextError::find(&paid.observation).filter(|_| called && !failed);
        let completion = (called && !failed) || turn_is_finish(&paid.terms, state.ending);
        let found = json!({
            "reward": paid.reward - turn_limit, "done": done,
            "completion": completion.then_some(state.completion),
            "observation": called.then(|| paid.observation.trim_end().to_owned()).filter(|_| !failed),
            "hand_violation": state.hand_violation.map(HandViolation::as_str),
            "tool_error": told.map(|error| json!({
                "error_type": if error.is_severe() { "severe" } else { "moderate" }, "error_pattern": error.pattern(),
            })),
            "refusal": state.refusal.filter(|_| called && !failed).map(|refusal| refusal.as_str()),
            "matched": count(&paid.terms, Term::DiffMatch), "wrong": count(&paid.terms, Term::WrongDiff),
            "perfect": count(&paid.terms, Term::PerfectMatch) > 0,
            "progress": sum(&paid.terms, &[Term::ProgressShaping]), "partial": sum(&paid.terms, PARTIAL),
            "replan": sum(&paid.terms, &[Term::ReplanRecoverPick]),
            "anti": sum(&paid.terms, &[Term::TargetFirstDiscovered]),
            "tools": sum(&paid.terms, TOOLS),
            "terminal": sum(&paid.terms, &[Term::FinishComplete, Term::FinishIncomplete, Term::FinishCompletion, Term::PrematureFinish]),
            "limit": sum(&paid.terms, &[Term::StepLimit]),
            "hand_occupied": state.hand_occupied, "remaining": targets(&state.remaining), "graph": graph(&state.graph),
            "distractor_visible": state.ambiguous, "asked_since": state.asked, "last_ask_marker": state.named_marker,
        });
        let (info, breakdown, wanted) = (
            &expected["info"],
            &expected["info"]["reward_breakdown"],
            &expected["state"],
        );
        let observation = text(&expected["observation"]);
        let observation = observation
            .trim_end_matches("⟦+complete⟧")
            .trim_end_matches("⟦+horizon⟧")
            .trim_end();
        let number = |key: &str| breakdown[key].as_f64().unwrap_or(0.0);
        let length = |key: &str| breakdown[key].as_array().map_or(0, Vec::len);
        let tools = [
            "reward",
            "ask_when_ambiguous",
            "used_marker_from_answer",
            "blind_pick_penalty",
        ];
        let tools: f64 = tools
            .into_iter()
            .filter_map(|key| breakdown["tool_reward"][key].as_f64())
            .sum();
        let wanted = json!({
            "reward": expected["reward"], "done": expected["done"],
            "completion": info["completion_rate"],
            "observation": Some(observation).filter(|_| called && !failed),
            "hand_violation": info["hand_violation"]["violation_type"],
            "tool_error": info["tool_error"],
            "refusal": info["world_graph_rejected"],
            "matched": length("matched_diffs"), "wrong": length("wrong_diffs"),
            "perfect": breakdown["perfect_match"] == true,
            "progress": number("progress_reward"), "partial": number("partial_reward"), "replan": number("replan_reward"),
            "anti": number("anti_exploit_reward"), "tools": tools,
            "terminal": number("terminal_reward"), "limit": number("max_steps_penalty"),
            "hand_occupied": wanted["hand_occupied"], "remaining": sorted(&wanted["remaining"]),
            "graph": graph_wanted(&wanted["graph"]),
            "distractor_visible": wanted["distractor_visible"], "asked_since": wanted["asked_since"],
            "last_ask_marker": wanted["last_ask_marker"],
        });
        steps.compare(&format!("{id} {index}"), &wanted, &found);
        outcome.step(
            rollout.target_count() as u32,
            paid.reward - turn_limit,
            count(&paid.terms, Term::DiffMatch) as u32,
            Some(state.completion),
        );
        assert!(
            before.ending.is_none(),
            "{id} {index}: a step after the end"
        );
    }
    let Some(expected) = episode["rollout"].as_object() else {
        return;
    };
    let ending = rollout.ending();
    outcome.success = Some(ending == Some(TrainerEnd::Complete));
    let total = rollout.total();
    let label = match ending {
        Some(TrainerEnd::Complete) => "success",
        Some(TrainerEnd::TurnLimit) => "timeout",
        _ if total <= 0.0 => "failed",
        _ => "partial",
    };
    // an episode that the environment does not end has no entry in the metric
    let counted = !matches!(
        ending,
        None | Some(TrainerEnd::CallFailed | TrainerEnd::TurnLimit)
    );
    let found = json!({
        "total_reward": total, "done": ending.is_some_and(|ending| ending != TrainerEnd::TurnLimit),
        "success": ending == Some(TrainerEnd::Complete), "outcome": label,
        "metric": counted.then(|| json!({
            "total_steps": outcome.steps, "total_reward": outcome.reward, "target_diff_count": rollout.target_count(),
            "completed_diff_count": outcome.completed, "completion_rate": outcome.completion,
            "is_success": outcome.success, "is_timeout": ending == Some(TrainerEnd::StepLimit),
        })),
    });
    let wanted = json!({
        "total_reward": expected["total_reward"], "done": expected["done"], "success": expected["success"],
        "outcome": episode["outcome"], "metric": episode["metric"],
    });
    ends.compare(id, &wanted, &found);
    assert!(horizon <= 0.0);
}

fn turn_is_finish(terms: &[AppliedTerm], ending: Option<TrainerEnd>) -> bool {
    ending == Some(TrainerEnd::Finished) && !terms.is_empty()
}

fn graph(standing: &[(String, String, u32)]) -> Value {
    let named = |(kind, place, count): &(String, String, u32)| json!([place, kind, count]);
    sorted(&standing.iter().map(named).collect::<Vec<_>>().into())
}

/// Receptacles with content, without the doors, which are not compared.
fn graph_wanted(graph: &Value) -> Value {
    let mut counts = std::collections::BTreeMap::new();
    for (place, state) in graph.as_object().unwrap() {
        let content = state.as_array().or_else(|| state["content"].as_array());
        for kind in content.into_iter().flatten() {
            *counts
                .entry((place.clone(), text(kind).to_owned()))
                .or_insert(0) += 1;
        }
    }
    sorted(
        &counts
            .into_iter()
            .map(|((place, kind), count)| json!([place, kind, count]))
            .collect::<Vec<_>>()
            .into(),
    )
}

#[test]
fn names_become_categories_as_published() {
    let Some(document) = load("trainer_contract.json") else {
        return;
    };
    let mut report = Report::new("trainer_contract.json", "mapping");
    for (index, case) in items(&document["mapping"]).iter().enumerate() {
        let categories = Categories::of_payload(&case["payload"]);
        let found: Map<String, Value> = categories
            .iter()
            .map(|(asset, category)| (asset.to_owned(), json!(category)))
            .collect();
        report.compare(&index.to_string(), &case["mapping"], &Value::Object(found));
    }
    report.finish();
    let mut report = Report::new("trainer_contract.json", "convert");
    for (index, case) in items(&document["convert"]).iter().enumerate() {
        let entries = case["mapping"].as_object().unwrap().iter();
        let meta: Map<String, Value> = entries
            .map(|(asset, category)| (asset.clone(), json!({ "category": category })))
            .collect();
        let categories = Categories::of_payload(&json!({ "distractor_metadata": meta }));
        report.compare(
            &index.to_string(),
            &case["converted"],
            &categories.convert_json(&case["graph"]),
        );
    }
    report.finish();
}

#[test]
fn graphs_are_refused_as_published() {
    let Some(document) = load("trainer_contract.json") else {
        return;
    };
    let mut report = Report::new("trainer_contract.json", "validate");
    for (index, case) in items(&document["validate"]).iter().enumerate() {
        let [old, new] = [&case["old"], &case["new"]].map(|graph| Graph::of_json(graph).size());
        // a graph comes with a call alone; without one, and at the end, nobody counts the objects
        let counts = !matches!(text(&case["tool"]), "" | "finish");
        let new = if counts {
            new
        } else {
            reel_reward::trainer::GraphSize {
                objects: old.objects,
                ..new
            }
        };
        let found = graph_rejection(&old, &new);
        let found = json!({ "accepted": found.is_none(), "reason": found.map_or("", |refusal| refusal.as_str()) });
        report.compare(
            &index.to_string(),
            &json!({ "accepted": case["accepted"], "reason": case["reason"] }),
            &found,
        );
    }
    report.finish();
}

#[test]
fn texts_are_read_as_published() {
    let Some(document) = load("trainer_contract.json") else {
        return;
    };
    let trainer = Preset::real_trainer();
    let mut report = Report::new("trainer_contract.json", "error_text");
    for case in items(&document["error_text"]) {
        let error = TextError::find(text(&case["text"]));
        let term = |error: TextError| {
            if error.is_severe() {
                Term::ListedSevere
            } else {
                Term::ListedModerate
            }
        };
        let found = json!({
            "penalty": error.map_or(0.0, |error| trainer.weight(term(error))),
            "error_type": error.map(|error| if error.is_severe() { "severe" } else { "moderate" }),
            "error_pattern": error.map(TextError::pattern),
        });
        let wanted = json!({ "penalty": case["penalty"], "error_type": case["error_type"], "error_pattern": case["error_pattern"] });
        report.compare(text(&case["text"]), &wanted, &found);
    }
    report.finish();
    let mut report = Report::new("trainer_contract.json", "ask_marker");
    for case in items(&document["ask_marker"]) {
        let known: Vec<&String> = case["markers"]
            .as_object()
            .into_iter()
            .flatten()
            .map(|(marker, _)| marker)
            .collect();
        report.compare(
            text(&case["answer"]),
            &case["marker"],
            &json!(marker_in_answer(text(&case["answer"]), &known)),
        );
    }
    report.finish();
    let mut report = Report::new("trainer_contract.json", "not_found");
    for case in items(&document["not_found"]) {
        let found = is_not_found(text(&case["observation"]), case["instruction"].as_str());
        report.compare(
            text(&case["observation"]),
            &case["task_not_found"],
            &json!(found),
        );
    }
    report.finish();
}

/// An episode of two objects in one receptacle, for what a single call does.
fn rollout(category: &Value) -> TrainerRollout {
    let names = ["u1_on_a_at_t", "u2_on_a_at_t"];
    let payload = json!({
        "task_id": "t", "target_object": { "id": "u1", "category": category },
        "distractor_metadata": { "u1": { "category": "goal" }, "u2": { "category": "other" } },
        "initial_world_graph": { "a": { "content": names }, "b": { "content": [] } },
        "target_world_graph": { "a": { "content": [names[1]] }, "b": { "content": [names[0]] } },
    });
    TrainerRollout::reset(
        &Preset::real_trainer(),
        "t",
        &[json!({ "type": "text", "text": payload.to_string() })],
    )
    .unwrap()
}

fn call(rollout: &mut TrainerRollout, tool: &str, items: &[Value]) {
    rollout.step(Turn::Call {
        tool,
        arguments: &json!({}),
        content: items,
    });
}

#[test]
fn the_hand_is_followed_as_published() {
    let Some(document) = load("trainer_contract.json") else {
        return;
    };
    let mut report = Report::new("trainer_contract.json", "hand");
    for case in items(&document["hand"]) {
        let mut rollout = rollout(&json!("mug"));
        if case["occupied"] == true {
            call(&mut rollout, "pick", &[]);
        }
        let paid = rollout.step(Turn::Call {
            tool: text(&case["tool"]),
            arguments: &json!({}),
            content: &[],
        });
        let violation = rollout.state().hand_violation.map(HandViolation::as_str);
        let found =
            json!({ "penalty": sum(&paid.terms, &[Term::HandViolation]), "violation": violation });
        report.compare(
            text(&case["tool"]),
            &json!({ "penalty": case["penalty"], "violation": case["violation"] }),
            &found,
        );
    }
    report.finish();
}

#[test]
fn candidates_are_seen_as_published() {
    let Some(document) = load("trainer_contract.json") else {
        return;
    };
    let mut report = Report::new("trainer_contract.json", "ambiguity");
    for (index, case) in items(&document["ambiguity"]).iter().enumerate() {
        let target = &case["target_object"];
        let first = target.as_array().map_or(target, |list| &list[0]);
        let category = first
            .get("category")
            .or(first.as_str().map(|_| first))
            .cloned()
            .unwrap_or(json!(""));
        let mut rollout = rollout(&category);
        // the vectors begin with an answer that named a marker
        let asked = json!({ "type": "text", "text": "marker_1" });
        call(&mut rollout, "ask", &[asked]);
        let debug = json!({ "CURRENT_MARKER_MAP": case["markers"] });
        call(
            &mut rollout,
            text(&case["tool"]),
            &[json!({ "type": "text", "text": format!("Debug Info:\n{debug}") })],
        );
        let state = rollout.state();
        let found = json!({ "distractor_visible": state.ambiguous, "asked_since": state.asked });
        let wanted = json!({ "distractor_visible": case["distractor_visible"], "asked_since": case["asked_since"] });
        report.compare(&index.to_string(), &wanted, &found);
    }
    report.finish();
}

/// So that a vector that is not read is noticed: the parts that belong to the trainer's view
/// are all compared here.
#[test]
fn the_parts_of_the_contract_are_known() {
    let Some(document) = load("trainer_contract.json") else {
        return;
    };
    let parts: BTreeSet<&str> = document
        .as_object()
        .unwrap()
        .keys()
        .map(String::as_str)
        .collect();
    let known = reel_world::words! {
        mapping convert validate error_text hand ambiguity ask_marker not_found
    };
    let elsewhere = ["README", "tool_lists", "names", "task_lists", "allocation"];
    assert_eq!(parts, known.into_iter().chain(elsewhere).collect());
}
