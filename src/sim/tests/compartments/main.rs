//! Shelves and drawers: what lies in them goes where they go, is hidden while they are closed,
//! and can be looked at, picked and placed; the state restores in the middle of a slide.

use std::{collections::BTreeSet, sync::Arc};

use reel_sim::{
    CallContext, PreparedTask, Simulator, Snapshot, model::scene_model, physics::Physics,
};
use reel_world::{
    DoorState, Outcome, Profile, Scene, Task, Tool, ToolCall, WorldGraph, record::MarkerTarget,
};
use serde_json::{Value, json};

const DRAWER: &str = "dresser_1_drawer_3";
const SHELF: &str = "bookshelf_1_shelf_3";

fn scene() -> Scene {
    let piece = |id: &str, category: &str, min: [f64; 3], max: [f64; 3]| {
        json!({
            "id": id, "room": "bedroom/0", "category": category, "captions": {(id): 1},
            "surface_min": min, "surface_max": max, "facing_deg": 0
        })
    };
    let part = |mut of: serde_json::Value, whole: &str, door: serde_json::Value| {
        of["part_of"] = json!(whole);
        of["door"] = door;
        of
    };
    let drawer = |number: usize, low: f64| {
        let of = piece(
            &format!("dresser_1_drawer_{number}"),
            "drawer",
            [0.14, 1.08, low],
            [0.5, 1.92, low + 0.01],
        );
        part(of, "dresser_1", json!("drawer"))
    };
    let shelf = |number: usize, low: f64| {
        let of = piece(
            &format!("bookshelf_1_shelf_{number}"),
            "shelf",
            [0.14, 3.04, low],
            [0.4, 3.96, low + 0.02],
        );
        part(of, "bookshelf_1", json!(false))
    };
    serde_json::from_value(json!({
        "scene_id": "parts",
        "rooms": [{"name": "bedroom/0", "min": [0, 0], "max": [4, 5]}],
        "receptacles": [
            piece("dresser_1", "dresser", [0.12, 1.0, 0.77], [0.55, 2.0, 0.8]),
            drawer(1, 0.1),
            drawer(2, 0.33),
            drawer(3, 0.56),
            piece("bookshelf_1", "bookshelf", [0.12, 3.0, 1.27], [0.42, 4.0, 1.3]),
            shelf(1, 0.1),
            shelf(2, 0.45),
            shelf(3, 0.85),
            piece("table_1", "table", [2.9, 1.2, 0.71], [3.7, 2.2, 0.74]),
        ]
    }))
    .unwrap()
}

fn task() -> Task {
    let object = |instance: &str, category: &str, at: &str, position: [f64; 3], size: [f64; 3]| {
        json!({
            "instance": instance, "asset": format!("{category}_1"), "category": category,
            "receptacle": at, "position": position, "size": size, "yaw": 0.0
        })
    };
    let mut initial = WorldGraph::default();
    for receptacle in &scene().receptacles {
        let state = initial
            .receptacles
            .entry(receptacle.id.clone())
            .or_default();
        state.door = receptacle.door.exists().then_some(DoorState::Closed);
    }
    initial.add(&DRAWER.into(), &"mug_a".into());
    initial.add(&"bookshelf_1_shelf_2".into(), &"book_a".into());
    let mut goal = initial.clone();
    goal.remove(&DRAWER.into(), &"mug_a".into());
    goal.add(&SHELF.into(), &"mug_a".into());
    let text = "Bring the mug in the drawer to the shelf.";
    serde_json::from_value(json!({
        "task_id": "parts/1", "family": "FDP", "scene_id": "parts",
        "instruction": text, "precise_instruction": text,
        "src": DRAWER, "dest": SHELF, "target": "mug_a", "initial": initial, "goal": goal,
        "objects": [
            object("book_a", "book", "bookshelf_1_shelf_2", [0.27, 3.4, 0.485], [0.15, 0.2, 0.03]),
            object("mug_a", "mug", DRAWER, [0.33, 1.5, 0.61], [0.08, 0.08, 0.08]),
        ]
    }))
    .unwrap()
}

fn simulator() -> Simulator {
    let stage = PreparedTask::new(Arc::new(scene()), Arc::new(task()));
    Simulator::new(stage, Profile::Paper, 1)
}

fn call(simulator: &mut Simulator, name: &str, arguments: Value) -> Outcome {
    let call: ToolCall =
        serde_json::from_value(json!({"name": name, "arguments": arguments})).unwrap();
    let tool = Tool::parse(&call).unwrap();
    simulator.call(&tool, CallContext::default()).outcome
}

/// A call that must succeed.
fn done(simulator: &mut Simulator, name: &str, arguments: Value) {
    let outcome = call(simulator, name, arguments);
    assert!(outcome.error.is_none(), "{name}: {}", outcome.text);
}

/// Goes to a receptacle and calls a tool on its marker.
fn at(simulator: &mut Simulator, receptacle: &str, tool: &str) -> Outcome {
    done(simulator, "nav_to", json!({"receptacle_name": receptacle}));
    done(simulator, "show_receptacles", json!({}));
    let wanted = MarkerTarget::Receptacle(receptacle.into());
    let marker = simulator
        .markers()
        .iter()
        .find(|marker| marker.target == wanted)
        .unwrap_or_else(|| panic!("{receptacle} has no marker: {:?}", simulator.markers()))
        .id;
    call(simulator, tool, json!({"marker_id": marker}))
}

fn pick(simulator: &mut Simulator, category: &str) {
    let arguments = json!({"target_category": category});
    done(simulator, "show_object_by_category", arguments);
    done(simulator, "pick", json!({"marker_id": 1}));
}

fn position(simulator: &Simulator, body: &str) -> [f32; 3] {
    let bodies = simulator.bodies();
    let body = bodies.iter().find(|state| state.body == body).unwrap();
    body.position
}

fn place_of(simulator: &Simulator, object: &str) -> String {
    let graph = simulator.physical_graph();
    graph.receptacle_of(&object.into()).unwrap().to_string()
}

#[test]
fn what_lies_in_a_drawer_comes_out_with_it_and_goes_back() {
    let mut simulator = simulator();
    let before = position(&simulator, "mug_a");
    assert_eq!(place_of(&simulator, "mug_a"), DRAWER);
    done(&mut simulator, "nav_to", json!({"receptacle_name": DRAWER}));
    let hidden = call(
        &mut simulator,
        "show_object_by_category",
        json!({"target_category": "mug"}),
    );
    assert!(
        hidden.error.is_some(),
        "a closed drawer hides: {}",
        hidden.text
    );
    assert!(at(&mut simulator, DRAWER, "open").error.is_none());
    let (out, drawer) = (
        position(&simulator, "mug_a")[0] - before[0],
        position(&simulator, &format!("door:{DRAWER}"))[0] - 0.55,
    );
    assert!(drawer > 0.35, "the drawer came out: {drawer}");
    assert!((out - drawer).abs() < 0.02, "mug {out}, drawer {drawer}");
    assert_eq!(place_of(&simulator, "mug_a"), DRAWER);
    let graph = simulator.physical_graph();
    assert_eq!(graph.door(&DRAWER.into()), Some(DoorState::Open));
    assert!(at(&mut simulator, DRAWER, "close").error.is_none());
    let back = position(&simulator, "mug_a")[0] - before[0];
    assert!(back.abs() < 0.03, "the mug is {back} m off");
    assert_eq!(place_of(&simulator, "mug_a"), DRAWER);
    assert_eq!(
        simulator.graphs().physics.door(&DRAWER.into()),
        Some(DoorState::Closed)
    );
}

#[test]
fn from_a_drawer_onto_a_shelf_and_from_a_shelf_into_a_drawer() {
    let mut simulator = simulator();
    let refused = at(&mut simulator, "bookshelf_1_shelf_2", "open");
    assert!(
        refused.error.is_some(),
        "a shelf does not open: {}",
        refused.text
    );
    pick(&mut simulator, "book");
    let closed = at(&mut simulator, DRAWER, "place");
    assert!(
        closed.error.is_some(),
        "the drawer is closed: {}",
        closed.text
    );
    assert!(at(&mut simulator, "table_1", "place").error.is_none());
    assert!(at(&mut simulator, DRAWER, "open").error.is_none());
    pick(&mut simulator, "mug");
    assert!(at(&mut simulator, SHELF, "place").error.is_none());
    assert_eq!(place_of(&simulator, "mug_a"), SHELF);
    done(
        &mut simulator,
        "nav_to",
        json!({"receptacle_name": "table_1"}),
    );
    pick(&mut simulator, "book");
    assert!(at(&mut simulator, DRAWER, "place").error.is_none());
    assert_eq!(place_of(&simulator, "book_a"), DRAWER);
    assert!(at(&mut simulator, DRAWER, "close").error.is_none());
    assert_eq!(place_of(&simulator, "book_a"), DRAWER);
    assert_eq!(simulator.physical_graph().objects_on_floor(), []);
}

#[test]
fn a_full_drawer_and_what_is_too_high_for_a_shelf_are_refused() {
    let mut task = task();
    task.objects[0].size = [0.15, 0.2, 0.4];
    task.objects[0].position[2] = 0.7;
    task.objects[0].receptacle = "table_1".into();
    task.objects[0].position = [3.2, 1.7, 0.94];
    let stage = PreparedTask::new(Arc::new(scene()), Arc::new(task));
    let mut simulator = Simulator::new(stage, Profile::Paper, 1);
    done(
        &mut simulator,
        "nav_to",
        json!({"receptacle_name": "table_1"}),
    );
    pick(&mut simulator, "book");
    let high = at(&mut simulator, "bookshelf_1_shelf_2", "place");
    assert!(high.text.contains("no free"), "{}", high.text);
}

#[test]
fn an_episode_resumes_with_an_open_drawer() {
    let stage = PreparedTask::new(Arc::new(scene()), Arc::new(task()));
    let mut simulator = Simulator::new(stage.clone(), Profile::Paper, 1);
    assert!(at(&mut simulator, DRAWER, "open").error.is_none());
    let bytes = simulator.snapshot().to_bytes();
    let snapshot = Snapshot::from_bytes(&bytes).unwrap();
    let mut resumed = Simulator::resume(stage, Profile::Paper, 1, &snapshot).unwrap();
    for simulator in [&mut simulator, &mut resumed] {
        assert!(at(simulator, DRAWER, "close").error.is_none());
        assert!(at(simulator, "dresser_1_drawer_1", "open").error.is_none());
    }
    assert_eq!(simulator.digest(), resumed.digest());
}

#[test]
fn physics_restores_in_the_middle_of_a_slide() {
    let model = scene_model(&scene(), &BTreeSet::new());
    let mut physics = Physics::new(&model, 0);
    physics.drive_door(2, true);
    for _ in 0..60 {
        physics.step();
    }
    let half_way = physics.door_position(2);
    assert!((0.05..0.15).contains(&half_way), "{half_way}");
    let bytes = postcard::to_allocvec(&physics).unwrap();
    let mut restored: Physics = postcard::from_bytes(&bytes).unwrap();
    for step in 0..260 {
        for physics in [&mut physics, &mut restored] {
            physics.step();
        }
        assert_eq!(physics.step_digest(), restored.step_digest(), "step {step}");
    }
    assert!(physics.door_is_open(2) && !physics.door_is_open(1));
}
