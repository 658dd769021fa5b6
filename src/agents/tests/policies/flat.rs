//! A flat without physics that keeps the rules of the tools: what policies are
//! tested in. Never images.

use std::{collections::BTreeSet, sync::Arc};

use reel_agents::{PerceivedItem, Policy, PolicyContext};
use reel_episode::{Briefing, Observation, Privileged};
use reel_world::{
    Attributes, DoorState, ErrorCode, FLOOR, HORIZON, InstanceId, ReceptacleId, Scene, Task, Tool,
    ToolCall, WorldGraph,
    record::{Marker, MarkerTarget, StepInput},
};
use serde_json::json;

/// Tables, desks, a fridge; apples, a pear and a cup.
pub fn scene() -> Arc<Scene> {
    let receptacle = |id: &str, category: &str, caption: &str, door: bool, placeable: bool| {
        json!({"id": id, "room": "room", "category": category, "captions": {caption: 1.0}, "door": door, "placeable": placeable,
               "surface_min": [0.0, 0.0, 0.0], "surface_max": [1.0, 1.0, 0.7]})
    };
    let scene = json!({"scene_id": "flat", "rooms": [], "receptacles": [
        receptacle("table_1", "table", "the round table", false, true), receptacle("table_2", "table", "the oak table", false, true),
        receptacle("desk_1", "desk", "the white desk", false, true), receptacle("desk_2", "desk", "the black desk", false, true),
        receptacle("fridge_1", "fridge", "the fridge", true, true), receptacle("lid_1", "lid", "the lid", false, false)]});
    Arc::new(serde_json::from_value(scene).unwrap())
}

/// A task that moves `red` from `src` to `dest`.
pub fn task(scene: &Scene, src: &str, dest: &str, fuzzy: bool) -> Task {
    let object = |name: &str, category: &str, caption: &str, on: &str| {
        json!({"instance": format!("{name}_on_{on}_at_t"), "asset": name, "category": category, "caption": caption,
               "size": [0.1, 0.1, 0.1], "position": [0.0, 0.0, 0.0], "receptacle": on})
    };
    let other_table = if src == "table_1" {
        "table_2"
    } else {
        "table_1"
    };
    let other_desks: Vec<&str> = ["desk_1", "desk_2"]
        .into_iter()
        .filter(|id| *id != dest)
        .collect();
    let caption = |id: &str| {
        scene
            .receptacle(&id.into())
            .unwrap()
            .main_caption()
            .unwrap()
            .to_owned()
    };
    let what = if fuzzy {
        "a fruit"
    } else {
        "the shiny red apple"
    };
    let instruction = format!(
        "Take {what} from {} and put it on {}.",
        caption(src),
        caption(dest)
    );
    let task = json!({"task_id": "t", "family": if fuzzy { "SUL" } else { "FODP" }, "scene_id": "flat", "instruction": instruction,
        "precise_instruction": instruction, "fuzzy": fuzzy, "purpose": if fuzzy { Some("fruit") } else { None },
        "objects": [object("red", "apple", "shiny red apple", src), object("green", "apple", "dull green apple", src),
                    object("pear", "pear", "green pear", src), object("cup", "cup", "white cup", src),
                    object("yellow", "apple", "yellow apple", other_table)],
        "initial": {}, "goal": {}, "target": format!("red_on_{src}_at_t"), "src": src, "dest": dest,
        "src_distractors": [other_table], "dest_distractors": other_desks,
        "object_distractors": ["pear"]});
    let mut task: Task = serde_json::from_value(task).unwrap();
    if dest == "fridge_1" {
        task.dest_distractors.clear();
    }
    task.initial = Task::initial_graph(scene, &task.objects);
    task.goal = task.initial.clone();
    task.goal.remove(&src.into(), &task.target.clone());
    task.goal.add(&dest.into(), &task.target.clone());
    task
}

/// An episode in the flat.
pub struct Flat {
    pub task: Arc<Task>,
    pub scene: Arc<Scene>,
    pub graph: WorldGraph,
    pub held: Option<InstanceId>,
    landmark: Option<ReceptacleId>,
    markers: Vec<Marker>,
    mapped: bool,
    listed: bool,
    /// Objects that are seen only by walking around.
    pub hidden: BTreeSet<InstanceId>,
    /// Objects that fall off when they are placed.
    pub slippery: BTreeSet<InstanceId>,
    /// Picks that fail for no reason.
    pub bad_grips: u32,
    /// Every call with its error.
    pub log: Vec<(ToolCall, Option<ErrorCode>)>,
    pub finished: bool,
}

impl Flat {
    pub fn new(task: Task, scene: Arc<Scene>) -> Self {
        Self {
            graph: task.initial.clone(),
            task: Arc::new(task),
            scene,
            held: None,
            landmark: None,
            markers: Vec::new(),
            mapped: false,
            listed: false,
            hidden: BTreeSet::new(),
            slippery: BTreeSet::new(),
            bad_grips: 0,
            log: Vec::new(),
            finished: false,
        }
    }

    /// Plays to the end.
    pub fn play(&mut self, policy: &mut dyn Policy) {
        let receptacles = self
            .scene
            .receptacles
            .iter()
            .map(|known| (known.id.clone(), known.category.clone(), known.room.clone()))
            .collect();
        let briefing = Briefing {
            instruction: self.task.instruction.clone(),
            receptacles,
        };
        let mut observation = Observation {
            text: String::new(),
            error: None,
            frame: None,
            held: None,
        };
        for step in 0..HORIZON {
            let seen = self.seen();
            let input: StepInput = {
                let privileged = Privileged {
                    task: &self.task,
                    scene: &self.scene,
                    graph: &self.graph,
                    markers: &self.markers,
                    held: self.held.as_ref(),
                    landmark: self.landmark.as_ref(),
                };
                let truth = policy.needs_privileged().then_some(&privileged);
                policy
                    .act(&PolicyContext {
                        briefing: &briefing,
                        observation: &observation,
                        perceived: &seen,
                        truth,
                        step,
                    })
                    .unwrap()
            };
            let result = match Tool::parse(&input.call) {
                Ok(tool) => self.use_tool(tool),
                Err(error) => Err(error.code()),
            };
            self.log.push((input.call, result.as_ref().err().copied()));
            observation = Observation {
                text: result.clone().unwrap_or_default(),
                error: result.err(),
                frame: None,
                held: None,
            };
            if self.finished {
                break;
            }
        }
    }

    /// The calls by name, in order.
    pub fn names(&self) -> Vec<&str> {
        self.log
            .iter()
            .map(|(call, _)| call.name.as_str())
            .collect()
    }

    /// Whether no goal change is left.
    pub fn success(&self) -> bool {
        let objects = &self.task.objects;
        objects.iter().all(|object| {
            self.graph.receptacle_of(&object.instance)
                == self.task.goal.receptacle_of(&object.instance)
        })
    }

    /// What stands here and can be seen from the viewpoint.
    fn in_view(&self) -> Vec<InstanceId> {
        let here = self.here();
        here.into_iter()
            .filter(|object| self.listed || !self.hidden.contains(object))
            .collect()
    }

    fn here(&self) -> Vec<InstanceId> {
        match &self.landmark {
            Some(id) if self.graph.door(id) != Some(DoorState::Closed) => self.graph.objects_on(id),
            _ => Vec::new(),
        }
    }

    fn seen(&self) -> Vec<PerceivedItem> {
        let object = |id: &InstanceId, marker| {
            let known = self.task.object(id).unwrap();
            PerceivedItem {
                marker,
                furniture: false,
                category: known.category.clone(),
                caption: known.caption.clone(),
                attributes: known.attributes.clone(),
                receptacle_hint: self.graph.receptacle_of(id).cloned(),
                object: self
                    .task
                    .objects
                    .iter()
                    .position(|object| object.instance == *id)
                    .map(|index| index as u32),
            }
        };
        let mut seen = Vec::new();
        let mut numbered = BTreeSet::new();
        for marker in &self.markers {
            seen.push(match &marker.target {
                MarkerTarget::Object(id) => {
                    numbered.insert(id.clone());
                    object(id, Some(marker.id))
                }
                MarkerTarget::Receptacle(id) => {
                    let known = self.scene.receptacle(id).unwrap();
                    PerceivedItem {
                        marker: Some(marker.id),
                        furniture: true,
                        category: known.category.clone(),
                        caption: known.main_caption().map(str::to_owned),
                        attributes: Attributes::new(),
                        receptacle_hint: Some(id.clone()),
                        object: None,
                    }
                }
            });
        }
        seen.extend(
            self.in_view()
                .iter()
                .filter(|id| !numbered.contains(*id))
                .map(|id| object(id, None)),
        );
        seen
    }

    fn number(&mut self, targets: impl IntoIterator<Item = MarkerTarget>) {
        self.markers = targets
            .into_iter()
            .enumerate()
            .map(|(id, target)| Marker {
                id: id as u32 + 1,
                target,
            })
            .collect();
        self.mapped = true;
    }

    fn marked(&self, marker: u32) -> Result<MarkerTarget, ErrorCode> {
        if !self.mapped {
            return Err(ErrorCode::NoMarkerMap);
        }
        let found = self.markers.iter().find(|known| known.id == marker);
        found
            .map(|known| known.target.clone())
            .ok_or(ErrorCode::UnknownMarker)
    }

    fn use_tool(&mut self, tool: Tool) -> Result<String, ErrorCode> {
        match tool {
            Tool::NavTo { receptacle } => {
                self.scene
                    .receptacle(&receptacle)
                    .ok_or(ErrorCode::UnknownReceptacle)?;
                self.landmark = Some(receptacle);
                self.markers.clear();
                (self.mapped, self.listed) = (false, false);
            }
            Tool::WalkAround => {
                self.landmark.as_ref().ok_or(ErrorCode::NoLandmark)?;
                self.listed = true;
                let objects = self.here();
                if objects.is_empty() {
                    return Err(ErrorCode::NothingFound);
                }
                self.number(objects.into_iter().map(MarkerTarget::Object));
            }
            Tool::ShowObjectByCategory { category } => {
                let fruit = |known: &str| category == "fruit" && ["apple", "pear"].contains(&known);
                let fits = |id: &InstanceId| {
                    let known = &self.task.object(id).unwrap().category;
                    *known == category || fruit(known)
                };
                let objects: Vec<InstanceId> = self.in_view().into_iter().filter(fits).collect();
                if objects.is_empty() {
                    return Err(ErrorCode::NothingFound);
                }
                self.number(objects.into_iter().map(MarkerTarget::Object));
            }
            Tool::ShowReceptacles => {
                let here = self.landmark.clone().ok_or(ErrorCode::NothingFound)?;
                self.number([
                    MarkerTarget::Receptacle("lid_1".into()),
                    MarkerTarget::Receptacle(here),
                ]);
            }
            Tool::GazeAt { marker } => {
                self.marked(marker)?;
            }
            Tool::Pick { marker } => {
                let target = self.marked(marker)?;
                if self.held.is_some() {
                    return Err(ErrorCode::AlreadyHolding);
                }
                let MarkerTarget::Object(object) = target else {
                    return Err(ErrorCode::NotGraspable);
                };
                if self.bad_grips > 0 {
                    self.bad_grips -= 1;
                    return Err(ErrorCode::OutOfReach);
                }
                let place = self
                    .graph
                    .receptacle_of(&object)
                    .cloned()
                    .ok_or(ErrorCode::OutOfReach)?;
                self.graph.remove(&place, &object);
                self.held = Some(object);
            }
            Tool::Place { marker } => {
                let target = self.marked(marker)?;
                let held = self.held.clone().ok_or(ErrorCode::NothingHeld)?;
                let MarkerTarget::Receptacle(id) = target else {
                    return Err(ErrorCode::NotASurface);
                };
                if !self.scene.receptacle(&id).unwrap().placeable {
                    return Err(ErrorCode::NotASurface);
                }
                if self.graph.door(&id) == Some(DoorState::Closed) {
                    return Err(ErrorCode::DoorClosed);
                }
                let place = if self.slippery.contains(&held) {
                    FLOOR.into()
                } else {
                    id
                };
                self.graph.add(&place, &held);
                self.held = None;
            }
            Tool::Open { marker } => self.set_door(marker, DoorState::Open)?,
            Tool::Close { marker } => self.set_door(marker, DoorState::Closed)?,
            Tool::Ask { .. } => return Ok("I mean the shiny red apple.".into()),
            Tool::Finish => self.finished = true,
            Tool::Lifecycle(_) => {}
        }
        Ok(String::new())
    }

    fn set_door(&mut self, marker: u32, door: DoorState) -> Result<(), ErrorCode> {
        let MarkerTarget::Receptacle(id) = self.marked(marker)? else {
            return Err(ErrorCode::NoDoor);
        };
        if self.graph.door(&id).is_none() {
            return Err(ErrorCode::NoDoor);
        }
        if self.held.is_some() {
            return Err(ErrorCode::HandNotFree);
        }
        self.graph.receptacles.get_mut(&id).unwrap().door = Some(door);
        Ok(())
    }
}
