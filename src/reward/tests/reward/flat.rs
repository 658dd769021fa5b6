//! A flat without physics that turns short scripts into step records: what the rules are tested on.
//! Both authorities see the same.

use std::collections::BTreeMap;

use reel_world::{
    AssetId, DoorState, ErrorCode, Family, GraphEvent, InstanceId, ObjectInstance, Outcome,
    ReceptacleId, Scene, Task, ToolCall, WorldGraph, language,
    record::{
        Graphs, Marker, MarkerTarget, StartRecord, StateDigests, StepInput, StepRecord, UserReply,
        UserSource, VisibleObject,
    },
};
use serde_json::json;

/// What a script may do.
#[derive(Clone, Debug)]
pub enum Act {
    Nav(&'static str),
    /// Lists and marks all objects on the receptacle.
    Look(&'static str),
    Gaze(u32),
    Pick(&'static str),
    Place(&'static str),
    Open(&'static str),
    Close(&'static str),
    Ask(&'static str),
    Fail(ErrorCode),
    Finish,
}

pub struct Flat {
    pub graph: WorldGraph,
    pub held: Option<InstanceId>,
    pub markers: Vec<Marker>,
    pub steps: Vec<StepRecord>,
}

pub const RED: &str = "red_on_table_1_at_t";
pub const GREEN: &str = "green_on_table_1_at_t";
pub const PEN: &str = "pen_on_desk_1_at_t";

/// The task of the worked example.
pub fn task() -> (Task, Scene) {
    let scene: Scene = serde_json::from_value(json!({
        "scene_id": "flat", "rooms": [],
        "receptacles": [receptacle("table_1", false), receptacle("desk_1", false), receptacle("fridge_0", true)],
    }))
    .unwrap();
    let objects = vec![
        object(GREEN, "apple", "Shiny green apple.", "table_1"),
        object(PEN, "pen", "Blue pen.", "desk_1"),
        object(RED, "apple", "Round red apple.", "table_1"),
    ];
    let initial = Task::initial_graph(&scene, &objects);
    let mut goal = initial.clone();
    goal.remove(&"table_1".into(), &RED.into());
    goal.add(&"fridge_0".into(), &RED.into());
    let instruction = "Take an apple from the table and put it into the fridge.".to_owned();
    let task = Task {
        placement_order: Vec::new(),
        task_id: "t".into(),
        family: Family::SUL,
        task_type: None,
        scene_id: "flat".into(),
        precise_instruction: "Take the round red apple from the table and put it into the fridge."
            .into(),
        instruction,
        fuzzy: true,
        purpose: Some("fruit".into()),
        objects,
        initial,
        goal,
        target: RED.into(),
        src: "table_1".into(),
        dest: "fridge_0".into(),
        src_distractors: vec![],
        dest_distractors: vec![],
        object_distractors: vec![AssetId::from("green")],
        plan: vec![],
        published_goal: None,
        extra: BTreeMap::new(),
    };
    (task, scene)
}

fn receptacle(id: &str, door: bool) -> serde_json::Value {
    let captions = json!({ format!("the plain {}", &id[..id.len() - 2]): 1.0 });
    json!({ "id": id, "room": "kitchen", "category": &id[..id.len() - 2], "door": door, "captions": captions,
            "surface_min": [0.0, 0.0, 0.5], "surface_max": [1.0, 1.0, 0.6] })
}

pub fn object(instance: &str, category: &str, caption: &str, receptacle: &str) -> ObjectInstance {
    let instance = InstanceId::from(instance);
    ObjectInstance {
        asset: instance.asset(),
        instance,
        category: category.into(),
        caption: Some(caption.into()),
        attributes: language::attribute_words(caption),
        size: [0.1; 3],
        position: [0.0; 3],
        yaw: 0.0,
        receptacle: receptacle.into(),
        reference_rest: None,
    }
}

pub fn start(task: &Task) -> StartRecord {
    let graphs = Graphs {
        physics: task.initial.clone(),
        registry: task.initial.clone(),
    };
    StartRecord {
        graphs,
        shortest_path_m: Some(4.0),
        ..StartRecord::default()
    }
}

impl Flat {
    pub fn new(task: &Task) -> Self {
        Self {
            graph: task.initial.clone(),
            held: None,
            markers: Vec::new(),
            steps: Vec::new(),
        }
    }

    pub fn play(task: &Task, script: &[Act]) -> Self {
        let mut flat = Self::new(task);
        script.iter().for_each(|act| flat.act(act));
        flat
    }

    /// Does what a simulator would: an act that is impossible fails.
    pub fn act(&mut self, act: &Act) {
        let mut step = StepRecord {
            step: self.steps.len() as u32,
            input: StepInput::from_call(ToolCall::new("", json!({}))),
            outcome: Outcome::ok(""),
            tool: None,
            reply: None,
            markers: vec![],
            visible: vec![],
            listed: vec![],
            object: None,
            receptacle: None,
            held: self.held.clone(),
            changes: Default::default(),
            bodies: vec![],
            robot: Default::default(),
            sim_step: 0,
            reward: vec![],
            digests: StateDigests::default(),
        };
        let before = self.graph.clone();
        let (tool, error) = self.change(act, &mut step);
        step.tool = tool.map(str::to_owned);
        if let Some(error) = error {
            step.outcome = Outcome::error(error, said(error));
        } else if let Some(reply) = &step.reply {
            step.outcome = Outcome::ok(&reply.text);
        }
        step.held = self.held.clone();
        step.markers.clone_from(&self.markers);
        step.changes.physics = self.graph.difference(&before);
        step.changes.registry.clone_from(&step.changes.physics);
        step.robot.path_length_m = 2.0 * (step.step + 1) as f32;
        self.steps.push(step);
    }

    fn change(
        &mut self,
        act: &Act,
        step: &mut StepRecord,
    ) -> (Option<&'static str>, Option<ErrorCode>) {
        match act {
            Act::Nav(to) => {
                step.input.call = ToolCall::new("nav_to", json!({ "receptacle_name": to }));
                step.receptacle = Some((*to).into());
                self.markers.clear();
                (Some("nav_to"), None)
            }
            Act::Gaze(marker) => {
                step.input.call = ToolCall::new("gaze_at", json!({ "marker_id": marker }));
                (Some("gaze_at"), None)
            }
            Act::Look(at) => {
                step.listed = self.graph.objects_on(&(*at).into());
                let seen = |object: &InstanceId| VisibleObject {
                    object: object.clone(),
                    pixels: 9,
                    bbox: [0; 4],
                };
                step.visible = step.listed.iter().map(seen).collect();
                let objects = step.listed.iter().enumerate();
                let marker = |(id, object): (usize, &InstanceId)| Marker {
                    id: id as u32,
                    target: MarkerTarget::Object(object.clone()),
                };
                self.markers = objects.map(marker).collect();
                (Some("walk_around"), None)
            }
            Act::Pick(object) => {
                let object = InstanceId::from(*object);
                let target = MarkerTarget::Object(object.clone());
                // A pick of what has no marker names one that nothing has.
                let marker = self
                    .markers
                    .iter()
                    .find(|marker| marker.target == target)
                    .map_or(99, |marker| marker.id);
                step.input.call = ToolCall::new("pick", json!({ "marker_id": marker }));
                let place = self.graph.receptacle_of(&object).cloned();
                let (None, Some(place)) = (&self.held, place) else {
                    return (Some("pick"), Some(ErrorCode::AlreadyHolding));
                };
                self.graph.remove(&place, &object);
                step.object = Some(object.clone());
                self.held = Some(object);
                (Some("pick"), None)
            }
            Act::Place(at) => {
                let at = ReceptacleId::from(*at);
                if self.graph.door(&at) == Some(DoorState::Closed) {
                    return (Some("place"), Some(ErrorCode::DoorClosed));
                }
                let Some(object) = self.held.take() else {
                    return (Some("place"), Some(ErrorCode::NothingHeld));
                };
                self.graph.add(&at, &object);
                (step.object, step.receptacle) = (Some(object), Some(at));
                (Some("place"), None)
            }
            Act::Open(at) => self.door("open", at, DoorState::Closed, DoorState::Open),
            Act::Close(at) => self.door("close", at, DoorState::Open, DoorState::Closed),
            Act::Ask(reply) => {
                step.reply = Some(UserReply {
                    text: (*reply).to_owned(),
                    source: UserSource::RuleBased,
                });
                (Some("ask"), None)
            }
            Act::Fail(code) => (None, Some(*code)),
            Act::Finish => (Some("finish"), None),
        }
    }

    fn door(
        &mut self,
        tool: &'static str,
        at: &str,
        from: DoorState,
        to: DoorState,
    ) -> (Option<&'static str>, Option<ErrorCode>) {
        if self.graph.door(&at.into()).is_none() {
            return (Some(tool), Some(ErrorCode::NoDoor));
        }
        if self.graph.door(&at.into()) == Some(from) {
            self.graph.apply(&[GraphEvent::Door {
                receptacle: at.into(),
                from,
                to,
            }]);
        }
        (Some(tool), None)
    }
}

/// The published text of a failure, or an unlisted text if the published server does
/// not know the failure.
fn said(error: ErrorCode) -> &'static str {
    match error {
        ErrorCode::UnknownTool => "Action 'x' not recognized.",
        ErrorCode::BadArguments => "Error executing x: a traceback",
        ErrorCode::UnknownReceptacle => "Receptacle x not found in the scene.",
        ErrorCode::UnknownMarker => "Marker ID 99 not found in the marker map.",
        ErrorCode::NothingHeld => "No object in the inventory to place.",
        _ => "It did not work.",
    }
}
