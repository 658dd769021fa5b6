//! Plans of small flats: each leads to the goal when its effects are applied one by one.

use std::collections::BTreeMap;

use reel_world::{
    DoorState, FLOOR, Family, InstanceId, PlanStep, ReceptacleId, Scene, Task, WorldGraph,
};
use serde_json::{Value, json};

use crate::plan::{Intent, PlanningState, calls, cost_to_go, plan, published_plan};

/// A table, a desk, a fridge and a washer with doors, and a lid that holds nothing; two
/// apples and a cup.
fn flat() -> (Scene, Task) {
    let receptacle = |id: &str, door: bool, placeable: bool| {
        json!({"id": id, "room": "room", "category": id, "door": door, "placeable": placeable,
               "surface_min": [0.0, 0.0, 0.0], "surface_max": [1.0, 1.0, 0.7]})
    };
    let scene = json!({"scene_id": "flat", "rooms": [], "receptacles": [
        receptacle("table_1", false, true), receptacle("desk_1", false, true), receptacle("fridge_1", true, true),
        receptacle("washer_1", true, true), receptacle("lid_1", false, false)]});
    let scene: Scene = serde_json::from_value(scene).unwrap();
    let object = |instance: &str, category: &str, on: &str| {
        json!({"instance": instance, "asset": instance, "category": category, "size": [0.1, 0.1, 0.1],
               "position": [0.0, 0.0, 0.0], "receptacle": on})
    };
    let objects = json!([
        object("apple_a", "apple", "table_1"),
        object("apple_b", "apple", "table_1"),
        object("cup", "cup", "fridge_1")
    ]);
    let task = json!({"task_id": "t", "family": Family::FDP, "scene_id": "flat", "instruction": "", "precise_instruction": "",
        "objects": objects, "initial": {}, "goal": {}, "target": "apple_a", "src": "table_1", "dest": "desk_1"});
    let mut task: Task = serde_json::from_value(task).unwrap();
    task.initial = Task::initial_graph(&scene, &task.objects);
    task.goal = task.initial.clone();
    (scene, task)
}

fn shift(graph: &mut WorldGraph, object: &str, from: &str, to: &str) {
    assert!(
        graph.remove(&from.into(), &object.into()),
        "{object} is not on {from}"
    );
    graph.add(&to.into(), &object.into());
}

fn set_door(graph: &mut WorldGraph, receptacle: &str, door: DoorState) {
    graph.receptacles.get_mut(receptacle).unwrap().door = Some(door);
}

/// Applies a plan under the simulator's rules; panics where it breaks one.
fn run(
    intents: &[Intent],
    graph: &WorldGraph,
    held: Option<&InstanceId>,
    at: Option<&ReceptacleId>,
) -> WorldGraph {
    let (mut graph, mut held, mut at) = (graph.clone(), held.cloned(), at.cloned());
    let closed = |graph: &WorldGraph, id: &ReceptacleId| graph.door(id) == Some(DoorState::Closed);
    for intent in intents {
        match intent {
            Intent::NavTo(id) => at = Some(id.clone()),
            Intent::Find { target, .. } => assert_eq!(graph.receptacle_of(target), at.as_ref()),
            Intent::Pick(object) => {
                let here = at.clone().unwrap();
                assert!(held.is_none() && !closed(&graph, &here));
                assert!(graph.remove(&here, object));
                held = Some(object.clone());
            }
            Intent::Place(id) => {
                assert!(at.as_ref() == Some(id) && !closed(&graph, id));
                graph.add(id, &held.take().unwrap());
            }
            Intent::Open(id) | Intent::Close(id) => {
                assert!(at.as_ref() == Some(id) && held.is_none());
                let door = if matches!(intent, Intent::Open(_)) {
                    DoorState::Open
                } else {
                    DoorState::Closed
                };
                assert_ne!(graph.door(id), Some(door));
                graph.receptacles.get_mut(id).unwrap().door = Some(door);
            }
            Intent::Ask { .. } => {}
            Intent::Finish => {}
        }
    }
    assert_eq!(
        intents
            .iter()
            .filter(|intent| **intent == Intent::Finish)
            .count(),
        1
    );
    assert_eq!(intents.last(), Some(&Intent::Finish));
    graph
}

fn state<'a>(
    task: &'a Task,
    scene: &'a Scene,
    graph: &'a WorldGraph,
    held: Option<&'a InstanceId>,
    at: Option<&'a ReceptacleId>,
) -> PlanningState<'a> {
    PlanningState {
        task,
        scene,
        graph,
        held,
        at,
    }
}

fn words(intents: &[Intent]) -> String {
    intents
        .iter()
        .map(ToString::to_string)
        .collect::<Vec<_>>()
        .join("; ")
}

#[test]
fn a_move_between_tables_reads_as_in_the_paper() {
    let (scene, mut task) = flat();
    shift(&mut task.goal, "apple_a", "table_1", "desk_1");
    let situation = state(&task, &scene, &task.initial, None, None);
    let intents = plan(&situation).unwrap();
    assert_eq!(
        words(&intents),
        "go to table_1; find the apple; pick it up; go to desk_1; place it on desk_1; finish"
    );
    assert_eq!(cost_to_go(&situation), Some(8));
}

#[test]
fn doors_are_opened_with_a_free_hand_and_closed_at_the_end() {
    let (scene, mut task) = flat();
    shift(&mut task.goal, "apple_a", "table_1", "fridge_1");
    let situation = state(&task, &scene, &task.initial, None, None);
    let intents = plan(&situation).unwrap();
    let expected = "go to fridge_1; open fridge_1; go to table_1; find the apple; pick it up; go to fridge_1; \
                    place it on fridge_1; close fridge_1; finish";
    assert_eq!(words(&intents), expected);
    assert_eq!(calls(&intents), 12);
}

#[test]
fn a_full_hand_before_a_closed_door_puts_down_first() {
    let (scene, mut task) = flat();
    shift(&mut task.goal, "apple_a", "table_1", "fridge_1");
    let held: InstanceId = "apple_a".into();
    let mut now = task.initial.clone();
    now.remove(&"table_1".into(), &held);
    let at: ReceptacleId = "desk_1".into();
    let intents = plan(&state(&task, &scene, &now, Some(&held), Some(&at))).unwrap();
    assert!(words(&intents).starts_with(
        "place it on desk_1; go to fridge_1; open fridge_1; go to desk_1; find the apple"
    ));
    assert_eq!(run(&intents, &now, Some(&held), Some(&at)), task.goal);
}

#[test]
fn something_outside_the_goal_goes_back_even_behind_a_door() {
    let (scene, mut task) = flat();
    shift(&mut task.goal, "apple_a", "table_1", "desk_1");
    let held: InstanceId = "cup".into();
    let mut now = task.initial.clone();
    now.remove(&"fridge_1".into(), &held);
    let intents = plan(&state(&task, &scene, &now, Some(&held), None)).unwrap();
    assert_eq!(run(&intents, &now, Some(&held), None), task.goal);
}

#[test]
fn what_cannot_be_reached_is_named_with_the_reason() {
    let (scene, mut task) = flat();
    shift(&mut task.goal, "apple_a", "table_1", "desk_1");
    let mut now = task.initial.clone();
    shift(&mut now, "apple_a", "table_1", FLOOR);
    let situation = state(&task, &scene, &now, None, None);
    let error = plan(&situation).unwrap_err();
    assert_eq!(
        error.to_string(),
        "apple_a cannot be brought to its goal: it lies on the floor, where the arm cannot reach"
    );
    assert_eq!(cost_to_go(&situation), None);

    let (scene, mut task) = flat();
    shift(&mut task.goal, "apple_a", "table_1", "lid_1");
    let situation = state(&task, &scene, &task.initial, None, None);
    assert_eq!(
        plan(&situation).unwrap_err().reason,
        "nothing can be placed on lid_1"
    );
}

#[test]
fn bystanders_on_the_floor_do_not_matter() {
    let (scene, mut task) = flat();
    shift(&mut task.goal, "apple_a", "table_1", "desk_1");
    let mut now = task.initial.clone();
    shift(&mut now, "apple_b", "table_1", FLOOR);
    let intents = plan(&state(&task, &scene, &now, None, None)).unwrap();
    assert_eq!(calls(&intents), 8);
}

/// Every state that three objects, two doors and the hand can be in, against every goal.
#[test]
fn every_state_leads_to_every_goal() {
    let (scene, base) = flat();
    let places = ["table_1", "desk_1", "fridge_1", "washer_1"];
    let objects = ["apple_a", "apple_b", "cup"];
    let arrangement = |mut code: usize, held: Option<usize>| {
        let mut graph = base.initial.clone();
        for state in graph.receptacles.values_mut() {
            state.content = BTreeMap::new();
        }
        for (index, object) in objects.iter().enumerate() {
            if held != Some(index) {
                graph.add(&places[code % 4].into(), &(*object).into());
            }
            code /= 4;
        }
        for door in ["fridge_1", "washer_1"] {
            set_door(
                &mut graph,
                door,
                if usize::is_multiple_of(code, 2) {
                    DoorState::Closed
                } else {
                    DoorState::Open
                },
            );
            code /= 2;
        }
        graph
    };
    let mut checked = 0;
    // Steps that share no factor with the number of arrangements visit them in a mixed order.
    for start in (0..256).step_by(5) {
        for goal in (0..256).step_by(7) {
            let mut task = base.clone();
            task.initial = arrangement(start, None);
            task.goal = arrangement(goal, None);
            for hand in [None, Some(0), Some(1), Some(2)] {
                let held: Option<InstanceId> = hand.map(|index: usize| objects[index].into());
                let now = arrangement(start, hand);
                let at: ReceptacleId = places[(start + goal) % 4].into();
                let situation = state(&task, &scene, &now, held.as_ref(), Some(&at));
                let intents = plan(&situation).unwrap();
                assert_eq!(
                    run(&intents, &now, held.as_ref(), Some(&at)),
                    task.goal,
                    "{}",
                    words(&intents)
                );
                checked += 1;
            }
        }
    }
    assert_eq!(checked, 52 * 37 * 4);
}

#[test]
fn a_published_plan_becomes_intents() {
    let (_, mut task) = flat();
    let step = |action: &str, key: &str, value: &str| PlanStep {
        action: action.into(),
        args: BTreeMap::from([(key.to_owned(), Value::from(value))]),
    };
    task.plan = vec![
        step("nav_to", "receptacle_name", "fridge_1"),
        step("open", "receptacle_name", "fridge_1"),
        step("nav_to", "receptacle_name", "table_1"),
        step("find", "target_category", "fruit"),
        step("gaze_at", "target_category", "fruit"),
        step("pick", "target_category", "fruit"),
        step("nav_to", "receptacle_name", "fridge_1"),
        step("place", "receptacle_name", "fridge_1"),
        step("close", "receptacle_name", "fridge_1"),
    ];
    let expected = "go to fridge_1; open fridge_1; go to table_1; find the fruit; pick it up; go to fridge_1; \
                    place it on fridge_1; close fridge_1; finish";
    let intents = published_plan(&task).unwrap();
    assert_eq!(words(&intents), expected);
    assert!(intents.contains(&Intent::Pick(task.target.clone())));
    task.plan.push(step("dance", "receptacle_name", "fridge_1"));
    assert_eq!(published_plan(&task), None);
    task.plan.clear();
    assert_eq!(published_plan(&task), None);
}

#[test]
fn questions_of_a_plan_are_kept_and_search_for_nothing_twice() {
    let (_, mut task) = flat();
    let step = |action: &str, args: &[(&str, &str)]| PlanStep {
        action: action.into(),
        args: args
            .iter()
            .map(|(key, value)| ((*key).to_owned(), Value::from(*value)))
            .collect(),
    };
    task.plan = vec![
        step(
            "ask",
            &[
                ("strategy", "B"),
                ("about", "destination"),
                ("question", "Which desk?"),
            ],
        ),
        step("nav_to", &[("receptacle_name", "table_1")]),
        step("find", &[("target_category", "apple")]),
        step("ask", &[("strategy", "A"), ("about", "object")]),
        step("gaze_at", &[("target_category", "apple")]),
        step("pick", &[("target_category", "apple")]),
        step("nav_to", &[("receptacle_name", "desk_1")]),
        step("place", &[("receptacle_name", "desk_1")]),
    ];
    let about = task.target.clone();
    let intents = published_plan(&task).unwrap();
    let expected = [
        Intent::Ask {
            about: about.clone(),
            question: Some("Which desk?".into()),
        },
        Intent::NavTo("table_1".into()),
        Intent::Find {
            category: "apple".into(),
            target: about.clone(),
        },
        Intent::Ask {
            about: about.clone(),
            question: None,
        },
        Intent::Pick(about),
        Intent::NavTo("desk_1".into()),
        Intent::Place("desk_1".into()),
        Intent::Finish,
    ];
    assert_eq!(intents, expected);
}
