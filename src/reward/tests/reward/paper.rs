//! The rules of preset `paper`, one by one.

use reel_reward::{Preset, discounted_return, rewards};
use reel_world::{
    ErrorClass, ErrorCode, FLOOR, Task,
    record::{Graphs, Metrics, RewardTerm},
};

use crate::{
    close, component,
    flat::{Act, Flat, GREEN, PEN, RED, object, start, task},
    sum, worked_example,
};

use crate::REPLY;

fn play(task: &Task, script: &[Act]) -> (Flat, Vec<Vec<RewardTerm>>) {
    let flat = Flat::play(task, script);
    let terms = rewards(
        &Preset::paper(),
        task,
        &crate::flat::task().1,
        &start(task),
        &flat.steps,
    );
    (flat, terms)
}

fn metrics(task: &Task, flat: &Flat) -> Metrics {
    let graphs = Graphs {
        physics: flat.graph.clone(),
        ..Graphs::default()
    };
    reel_reward::metrics(&Preset::paper(), task, &start(task), &flat.steps, &graphs)
}

#[test]
fn the_worked_example_of_the_documentation() {
    let (task, _) = task();
    let (mut flat, terms) = play(&task, &worked_example(REPLY));
    let expected = [
        1.9, 0.0, 1.0, 1.87, 1.87, -0.03, -0.03, -0.03, 3.67, -0.03, -0.53, 3.87, -0.03,
    ];
    assert_eq!(terms.len(), expected.len());
    for (step, (terms, expected)) in terms.iter().zip(expected).enumerate() {
        assert!(
            (sum(terms) - expected).abs() < 1e-9,
            "step {step}: expected {expected}, found {terms:?}"
        );
    }
    for (step, terms) in flat.steps.iter_mut().zip(&terms) {
        step.reward.clone_from(terms);
    }
    let metrics = metrics(&task, &flat);
    assert!(metrics.success);
    close(metrics.completion, 1.0);
    close(metrics.total_reward, 13.5);
    assert_eq!((metrics.length, metrics.asks), (13, 1));
    close(metrics.spl.unwrap(), 4.0 / 26.0);
    close(
        metrics.discounted_return,
        discounted_return(&expected, 0.99),
    );
}

#[test]
fn an_undone_change_is_no_credit_twice_but_costs() {
    use Act::*;
    let (task, _) = task();
    let (flat, terms) = play(
        &task,
        &[
            Pick(RED),
            Place("table_1"),
            Pick(RED),
            Open("fridge_0"),
            Place("table_1"),
            Pick(RED),
        ],
    );
    close(component(&terms[..1], "task"), 1.5);
    close(component(&terms[1..], "task"), 1.5); // the door alone
    close(component(&terms, "prog"), 2.0 * 2.0 / 5.0);
    // 0.3 and 0.5 once; twice back on the source: reversed and not its goal
    close(component(&terms, "phys"), 0.3 + 0.5 + 2.0 * (-0.5 - 2.0));
    assert!(flat.steps.iter().all(|step| step.outcome.is_ok()));
}

#[test]
fn success_is_paid_once_and_taking_it_back_costs() {
    use Act::*;
    let (task, _) = task();
    let (flat, terms) = play(
        &task,
        &[
            Open("fridge_0"),
            Pick(RED),
            Place("fridge_0"),
            Pick(RED),
            Place("fridge_0"),
            Close("fridge_0"),
        ],
    );
    let step = |index: usize, name| component(&terms[index..=index], name);
    close(step(2, "task"), 1.5 + 2.0);
    close(step(3, "phys"), -0.5);
    close(step(4, "task") + step(4, "phys") + step(4, "prog"), 0.0);
    close(step(5, "phys"), 0.0); // closing a door on the way back is free
    assert!(metrics(&task, &flat).success);
    let taken = Flat::play(
        &task,
        &[Open("fridge_0"), Pick(RED), Place("fridge_0"), Pick(RED)],
    );
    let metrics = metrics(&task, &taken);
    assert!(!metrics.success);
    close(metrics.completion, 0.5);
    close(metrics.spl.unwrap(), 0.0);
}

#[test]
fn a_goal_object_on_a_wrong_receptacle() {
    use Act::*;
    let (task, _) = task();
    let (_, terms) = play(
        &task,
        &[
            Pick(RED),
            Place("desk_1"),
            Pick(GREEN),
            Place("desk_1"),
            Pick(RED),
            Place(FLOOR),
        ],
    );
    let phys = |index: usize| component(&terms[index..=index], "phys");
    close(phys(0), 0.8);
    close(phys(1), -2.0);
    close(phys(2) + phys(3), 0.0); // a distractor may lie anywhere
    close(phys(4), 0.0);
    close(phys(5), 0.0); // the floor is no receptacle
}

#[test]
fn recovery_needs_the_wrong_object_back_in_its_place_and_is_paid_once() {
    use Act::*;
    let (task, _) = task();
    let recovered = |script: &[Act]| {
        let (_, terms) = play(&task, script);
        terms
            .iter()
            .flatten()
            .filter(|term| term.reason.starts_with("recovery"))
            .count()
    };
    assert_eq!(recovered(&[Pick(GREEN), Place("table_1"), Pick(RED)]), 1);
    assert_eq!(recovered(&[Pick(GREEN), Place("desk_1"), Pick(RED)]), 0);
    assert_eq!(
        recovered(&[
            Pick(GREEN),
            Place("desk_1"),
            Pick(GREEN),
            Place("table_1"),
            Pick(RED)
        ]),
        0
    );
    assert_eq!(recovered(&[Pick(RED), Place("desk_1"), Pick(RED)]), 0);
    assert_eq!(recovered(&[Pick(PEN), Place("desk_1")]), 0);
    let twice = [
        Pick(GREEN),
        Place("table_1"),
        Pick(RED),
        Place("desk_1"),
        Pick(PEN),
        Place("desk_1"),
        Pick(RED),
    ];
    assert_eq!(recovered(&twice), 1);
}

#[test]
fn asking_pays_only_while_seen_candidates_remain_and_the_budget_lasts() {
    use Act::*;
    let (mut task, _) = task();
    let asks = |task: &Task, script: &[Act]| component(&play(task, script).1, "ask");
    close(asks(&task, &[Ask("Go and look."), Look("table_1")]), 0.0);
    close(asks(&task, &[Look("desk_1"), Ask("Go and look.")]), 0.0);
    close(
        asks(
            &task,
            &[Look("table_1"), Ask("Look closely."), Ask("Look closely.")],
        ),
        1.0,
    ); // B_ask = 1
    task.src_distractors = vec!["desk_1".into()];
    task.instruction = "Take an apple and put it into the fridge.".into();
    close(
        asks(
            &task,
            &[
                Look("table_1"),
                Ask("Look closely."),
                Ask("Look closely."),
                Ask("Look closely."),
            ],
        ),
        2.0,
    );
    close(asks(&task, &[Look("table_1"), Ask(REPLY), Ask(REPLY)]), 1.0); // one candidate is left
    task.instruction = "Take an apple from the plain table and put it into the fridge.".into();
    close(
        asks(
            &task,
            &[Look("table_1"), Ask("Look closely."), Ask("Look closely.")],
        ),
        1.0,
    );
    for extra in 0..5 {
        let instance = format!("more{extra}_on_table_1_at_t");
        task.objects.push(object(
            &instance,
            "apple",
            "Green apple with speckles.",
            "table_1",
        ));
        task.initial
            .add(&"table_1".into(), &instance.as_str().into());
        task.goal.add(&"table_1".into(), &instance.as_str().into());
    }
    let script = [
        Look("table_1"),
        Ask("Look."),
        Ask("Look."),
        Ask("Look."),
        Ask("Look."),
    ];
    close(asks(&task, &script), 3.0);
    task.instruction = task.precise_instruction.clone();
    (task.fuzzy, task.purpose) = (false, None);
    close(asks(&task, &script), 0.0);
}

#[test]
fn a_precise_task_without_distractors_pays_no_question() {
    let (mut task, _) = task();
    (task.fuzzy, task.purpose) = (false, None);
    task.objects
        .retain(|object| object.instance.as_str() != GREEN);
    task.initial.remove(&"table_1".into(), &GREEN.into());
    task.goal.remove(&"table_1".into(), &GREEN.into());
    close(
        component(
            &play(&task, &[Act::Look("table_1"), Act::Ask("Look.")]).1,
            "ask",
        ),
        0.0,
    );
}

#[test]
fn errors_cost_by_class_and_time_from_the_fourth_decision() {
    let (task, _) = task();
    for code in ErrorCode::ALL {
        let (_, terms) = play(&task, &[Act::Fail(*code)]);
        close(
            sum(&terms[0]),
            if code.class() == ErrorClass::Severe {
                -0.5
            } else {
                -0.3
            },
        );
    }
    let (_, terms) = play(&task, &vec![Act::Finish; 5]);
    assert_eq!(
        terms.iter().map(Vec::len).collect::<Vec<_>>(),
        [0, 0, 0, 1, 1]
    );
    close(component(&terms, "time"), -0.06);
}

#[test]
fn a_failed_visit_and_a_visit_elsewhere_match_nothing() {
    let (task, scene) = task();
    let mut flat = Flat::play(&task, &[Act::Nav("table_1"), Act::Nav("desk_1")]);
    flat.steps[0].outcome.error = Some(ErrorCode::NoViewpoint);
    let terms = rewards(&Preset::paper(), &task, &scene, &start(&task), &flat.steps);
    assert!(terms.iter().flatten().all(|term| term.component == "safe"));
}

#[test]
fn a_door_that_the_goal_opens_counts_once_and_closing_it_again_costs() {
    use Act::*;
    let (mut task, _) = task();
    task.goal.receptacles.get_mut("fridge_0").unwrap().door = Some(reel_world::DoorState::Open);
    let (_, terms) = play(
        &task,
        &[Open("fridge_0"), Close("fridge_0"), Open("fridge_0")],
    );
    close(component(&terms, "task"), 1.5);
    close(component(&terms, "prog"), 2.0 / 5.0);
    close(component(&terms, "phys"), -0.5);
}
