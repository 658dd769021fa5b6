//! The rules of preset `paper`, one by one and together.

mod flat;

use flat::{Act, Flat, GREEN, PEN, RED, object, start, task};
use proptest::prelude::*;
use reel_reward::{Paper, Preset, advantages, discounted_return, metrics, rewards};
use reel_world::{
    ErrorClass, ErrorCode, FLOOR, Task,
    record::{RewardTerm, StepRecord},
};

const REPLY: &str = "I mean the red one.";

fn play(task: &Task, script: &[Act]) -> (Flat, Vec<Vec<RewardTerm>>) {
    let flat = Flat::play(task, script);
    let terms = rewards(Preset::Paper, task, &self::task().1, &start(task), &flat.steps);
    (flat, terms)
}

fn sum(terms: &[RewardTerm]) -> f64 {
    terms.iter().map(|term| term.value).sum()
}

fn component(terms: &[Vec<RewardTerm>], name: &str) -> f64 {
    terms.iter().flatten().filter(|term| term.component == name).map(|term| term.value).sum()
}

#[track_caller]
fn close(found: f64, expected: f64) {
    assert!((found - expected).abs() < 1e-9, "found {found}, expected {expected}");
}

fn worked_example() -> Vec<Act> {
    use Act::*;
    vec![
        Nav("table_1"),
        Look("table_1"),
        Ask(REPLY),
        Nav("fridge_0"),
        Open("fridge_0"),
        Nav("table_1"),
        Pick(GREEN),
        Place("table_1"),
        Pick(RED),
        Nav("fridge_0"),
        Fail(ErrorCode::UnknownMarker),
        Place("fridge_0"),
        Finish,
    ]
}

#[test]
fn the_worked_example_of_the_documentation() {
    let (task, _) = task();
    let (mut flat, terms) = play(&task, &worked_example());
    let expected = [1.9, 0.0, 1.0, 1.87, 1.87, -0.03, -0.03, -0.03, 3.67, -0.03, -0.53, 3.87, -0.03];
    assert_eq!(terms.len(), expected.len());
    for (step, (terms, expected)) in terms.iter().zip(expected).enumerate() {
        assert!((sum(terms) - expected).abs() < 1e-9, "step {step}: expected {expected}, found {terms:?}");
    }
    for (step, terms) in flat.steps.iter_mut().zip(&terms) {
        step.reward.clone_from(terms);
    }
    let metrics = metrics(&task, &start(&task), &flat.steps, &flat.graph);
    assert!(metrics.success);
    close(metrics.completion, 1.0);
    close(metrics.total_reward, 13.5);
    assert_eq!((metrics.length, metrics.asks), (13, 1));
    close(metrics.spl.unwrap(), 4.0 / 26.0);
    close(metrics.discounted_return, discounted_return(&expected));
}

#[test]
fn an_undone_change_is_no_credit_twice_but_costs() {
    use Act::*;
    let (task, _) = task();
    let (flat, terms) = play(&task, &[Pick(RED), Place("table_1"), Pick(RED), Open("fridge_0"), Place("table_1"), Pick(RED)]);
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
    let (flat, terms) =
        play(&task, &[Open("fridge_0"), Pick(RED), Place("fridge_0"), Pick(RED), Place("fridge_0"), Close("fridge_0")]);
    let step = |index: usize, name| component(&terms[index..=index], name);
    close(step(2, "task"), 1.5 + 2.0);
    close(step(3, "phys"), -0.5);
    close(step(4, "task") + step(4, "phys") + step(4, "prog"), 0.0);
    close(step(5, "phys"), 0.0); // closing a door on the way back is free
    assert!(metrics(&task, &start(&task), &flat.steps, &flat.graph).success);
    let taken = Flat::play(&task, &[Open("fridge_0"), Pick(RED), Place("fridge_0"), Pick(RED)]);
    let metrics = metrics(&task, &start(&task), &taken.steps, &taken.graph);
    assert!(!metrics.success);
    close(metrics.completion, 0.5);
    close(metrics.spl.unwrap(), 0.0);
}

#[test]
fn a_goal_object_on_a_wrong_receptacle() {
    use Act::*;
    let (task, _) = task();
    let (_, terms) = play(&task, &[Pick(RED), Place("desk_1"), Pick(GREEN), Place("desk_1"), Pick(RED), Place(FLOOR)]);
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
        terms.iter().flatten().filter(|term| term.reason.starts_with("recovery")).count()
    };
    assert_eq!(recovered(&[Pick(GREEN), Place("table_1"), Pick(RED)]), 1);
    assert_eq!(recovered(&[Pick(GREEN), Place("desk_1"), Pick(RED)]), 0);
    assert_eq!(recovered(&[Pick(GREEN), Place("desk_1"), Pick(GREEN), Place("table_1"), Pick(RED)]), 0);
    assert_eq!(recovered(&[Pick(RED), Place("desk_1"), Pick(RED)]), 0);
    assert_eq!(recovered(&[Pick(PEN), Place("desk_1")]), 0);
    let twice = [Pick(GREEN), Place("table_1"), Pick(RED), Place("desk_1"), Pick(PEN), Place("desk_1"), Pick(RED)];
    assert_eq!(recovered(&twice), 1);
}

#[test]
fn asking_pays_only_while_seen_candidates_remain_and_the_budget_lasts() {
    use Act::*;
    let (mut task, _) = task();
    let asks = |task: &Task, script: &[Act]| component(&play(task, script).1, "ask");
    close(asks(&task, &[Ask("Go and look."), Look("table_1")]), 0.0);
    close(asks(&task, &[Look("desk_1"), Ask("Go and look.")]), 0.0);
    close(asks(&task, &[Look("table_1"), Ask("Look closely."), Ask("Look closely.")]), 1.0); // B_ask = 1
    task.src_distractors = vec!["desk_1".into()];
    task.instruction = "Take an apple and put it into the fridge.".into();
    close(asks(&task, &[Look("table_1"), Ask("Look closely."), Ask("Look closely."), Ask("Look closely.")]), 2.0);
    close(asks(&task, &[Look("table_1"), Ask(REPLY), Ask(REPLY)]), 1.0); // one candidate is left
    task.instruction = "Take an apple from the plain table and put it into the fridge.".into();
    close(asks(&task, &[Look("table_1"), Ask("Look closely."), Ask("Look closely.")]), 1.0);
    for extra in 0..5 {
        let instance = format!("more{extra}_on_table_1_at_t");
        task.objects.push(object(&instance, "apple", "Green apple with speckles.", "table_1"));
        task.initial.add(&"table_1".into(), &instance.as_str().into());
        task.goal.add(&"table_1".into(), &instance.as_str().into());
    }
    let script = [Look("table_1"), Ask("Look."), Ask("Look."), Ask("Look."), Ask("Look.")];
    close(asks(&task, &script), 3.0);
    task.instruction = task.precise_instruction.clone();
    (task.fuzzy, task.purpose) = (false, None);
    close(asks(&task, &script), 0.0);
}

#[test]
fn a_precise_task_without_distractors_pays_no_question() {
    let (mut task, _) = task();
    (task.fuzzy, task.purpose) = (false, None);
    task.objects.retain(|object| object.instance.as_str() != GREEN);
    task.initial.remove(&"table_1".into(), &GREEN.into());
    task.goal.remove(&"table_1".into(), &GREEN.into());
    close(component(&play(&task, &[Act::Look("table_1"), Act::Ask("Look.")]).1, "ask"), 0.0);
}

#[test]
fn errors_cost_by_class_and_time_from_the_fourth_decision() {
    let (task, _) = task();
    for code in ErrorCode::ALL {
        let (_, terms) = play(&task, &[Act::Fail(*code)]);
        close(sum(&terms[0]), if code.class() == ErrorClass::Severe { -0.5 } else { -0.3 });
    }
    let (_, terms) = play(&task, &vec![Act::Finish; 5]);
    assert_eq!(terms.iter().map(Vec::len).collect::<Vec<_>>(), [0, 0, 0, 1, 1]);
    close(component(&terms, "time"), -0.06);
}

#[test]
fn a_failed_visit_and_a_visit_elsewhere_match_nothing() {
    let (task, scene) = task();
    let mut flat = Flat::play(&task, &[Act::Nav("table_1"), Act::Nav("desk_1")]);
    flat.steps[0].outcome.error = Some(ErrorCode::NoViewpoint);
    let mut paper = Paper::new(&task, &scene);
    paper.start(&start(&task));
    assert!(flat.steps.iter().all(|step| paper.step(step).iter().all(|term| term.component == "safe")));
    close(paper.progress(), 0.0);
}

#[test]
fn a_door_that_the_goal_opens_counts_once_and_closing_it_again_costs() {
    use Act::*;
    let (mut task, _) = task();
    task.goal.receptacles.get_mut("fridge_0").unwrap().door = Some(reel_world::DoorState::Open);
    let (_, terms) = play(&task, &[Open("fridge_0"), Close("fridge_0"), Open("fridge_0")]);
    close(component(&terms, "task"), 1.5);
    close(component(&terms, "prog"), 2.0 / 5.0);
    close(component(&terms, "phys"), -0.5);
}

#[test]
fn presets_have_names() {
    assert!(Preset::ALL.iter().all(|preset| Preset::parse(preset.name()) == Some(*preset)));
    assert_eq!(Preset::parse("none"), None);
}

#[test]
fn advantages_are_relative_to_the_group() {
    let found = advantages(&[1.0, 2.0, 3.0, 6.0], 0.0);
    let deviation = 3.5_f64.sqrt();
    found.iter().zip([-2.0, -1.0, 0.0, 3.0]).for_each(|(found, above)| close(*found, above / deviation));
    assert_eq!(advantages(&[4.0; 3], 0.0), [0.0; 3]);
    assert!(advantages(&[], 0.1).is_empty());
    close(discounted_return(&[1.0, 1.0, 1.0]), 1.0 + 0.99 + 0.9801);
}

fn any_act() -> impl Strategy<Value = Act> {
    let place = || prop::sample::select(vec!["table_1", "desk_1", "fridge_0"]);
    let thing = prop::sample::select(vec![RED, GREEN, PEN]);
    prop_oneof![
        place().prop_map(Act::Nav),
        place().prop_map(Act::Look),
        thing.prop_map(Act::Pick),
        prop_oneof![4 => place(), 1 => Just(FLOOR)].prop_map(Act::Place),
        place().prop_map(Act::Open),
        place().prop_map(Act::Close),
        prop::sample::select(vec![REPLY, "Look around.", "Not the green one."]).prop_map(Act::Ask),
        prop::sample::select(ErrorCode::ALL.to_vec()).prop_map(Act::Fail),
        Just(Act::Finish),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_episode_keeps_the_laws(script in prop::collection::vec(any_act(), 0..30)) {
        let (task, scene) = task();
        let (mut flat, terms) = play(&task, &script);
        let mut paper = Paper::new(&task, &scene);
        paper.start(&start(&task));
        // streaming equals batch, step by step, and does not read the recorded reward
        for (step, terms) in flat.steps.iter_mut().zip(&terms) {
            step.reward = vec![RewardTerm { component: "task".into(), value: 99.0, reason: String::new() }];
            prop_assert_eq!(&paper.step(step), terms);
            step.reward.clone_from(terms);
        }
        // progress telescopes
        prop_assert!((component(&terms, "prog") - 2.0 * paper.progress()).abs() < 1e-9);
        // credit is bounded: five elements, the bonus, one valid pick, one transit, one recovery
        prop_assert!(component(&terms, "task") <= 5.0 * 1.5 + 2.0 + 1e-9);
        let earned: f64 = terms.iter().flatten().filter(|term| term.component == "phys" && term.value > 0.0).map(|term| term.value).sum();
        prop_assert!(earned <= 1.8 + 1e-9);
        prop_assert!(component(&terms, "ask") <= 1.0);
        // components sum to the total
        let metrics = metrics(&task, &start(&task), &flat.steps, &flat.graph);
        let parts: f64 = ["task", "prog", "phys", "ask", "time", "safe"].iter().map(|name| component(&terms, name)).sum();
        prop_assert!((parts - metrics.total_reward).abs() < 1e-9);
        prop_assert!(terms.iter().flatten().all(|term| term.value != 0.0 && !term.reason.is_empty()));
        // SR is the state's
        prop_assert_eq!(metrics.success, flat.graph.place_of(&RED.into()).is_some_and(|place| place.as_str() == "fridge_0"));
    }

    #[test]
    fn what_else_stands_in_the_flat_changes_nothing(script in prop::collection::vec(any_act(), 0..25), order in 0..6usize) {
        let (task, scene) = task();
        let mut other = task.clone();
        other.objects.rotate_left(order % 3);
        if order > 2 {
            other.objects.reverse();
        }
        let unrelated = object("towel_on_desk_1_at_t", "towel", "White towel.", "desk_1");
        for graph in [&mut other.initial, &mut other.goal] {
            graph.add(&"desk_1".into(), &unrelated.instance);
        }
        other.objects.push(unrelated);
        let steps: Vec<StepRecord> = Flat::play(&other, &script).steps;
        let expected = play(&task, &script).1;
        prop_assert_eq!(rewards(Preset::Paper, &other, &scene, &start(&other), &steps), expected);
    }
}
