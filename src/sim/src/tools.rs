//! The paper's tool handlers (those of the published servers are in `published`): what each call
//! does to the world, what it shows and says (docs/spec.md#tools).
//!
//! Nothing privileged reaches the policy: texts name receptacles (which the agent knows), numbers
//! and categories, never instances, assets or poses. A failed call changes nothing.

use std::{collections::BTreeSet, fmt::Display};

use reel_world::{
    DoorState, Frame, InstanceId, Lifecycle, Outcome, Primitive, ReceptacleId, Skills, Tool,
    ToolSpec, ToolText, language,
    record::{Lookup, Marker, MarkerTarget},
    tool_text::{numbered, use_first},
};

use crate::{
    geometry::distance_2d,
    nav::REACH_M,
    placement,
    simulator::{Simulator, VISIBLE_PIXELS, furniture_entity},
    skills::ActuationNoise,
};

/// Physics steps after each kind of call.
const NAV_SETTLE_STEPS: u32 = 20;
const GAZE_SETTLE_STEPS: u32 = 10;
const PLACE_SETTLE_STEPS: u32 = 1000;
const DOOR_SETTLE_STEPS: u32 = 100;
/// Slack of the arm beyond the reach that viewpoints are chosen by, in metres.
const REACH_SLACK_M: f32 = 0.4;
/// Fewest pixels of a receptacle that is marked.
const RECEPTACLE_PIXELS: u32 = 120;

/// What a call came to.
#[derive(Clone, Debug)]
pub struct ToolResult {
    /// The text and, if the call failed, the error code that the policy reads.
    pub outcome: Outcome,
    /// The image, where the tool returns one.
    pub frame: Option<Frame>,
    /// Objects that the text told of.
    pub listed: Vec<InstanceId>,
    /// The object the call acted on.
    pub object: Option<InstanceId>,
    /// The receptacle the call acted on.
    pub receptacle: Option<ReceptacleId>,
}

impl ToolResult {
    /// A result without an image.
    pub fn new(outcome: Outcome) -> Self {
        Self {
            outcome,
            frame: None,
            listed: Vec::new(),
            object: None,
            receptacle: None,
        }
    }
}

/// What a call is a function of, besides itself and the state.
#[derive(Clone, Copy, Debug)]
pub struct CallContext<'a> {
    /// Actuation noise of the call: success of its skill and drift of the base.
    pub noise: ActuationNoise,
    /// Which categories a query means, where that was looked up outside.
    pub lookup: Option<&'a Lookup>,
}

impl Default for CallContext<'_> {
    /// Perfect skills, and a query means what the vocabulary says.
    fn default() -> Self {
        Self {
            noise: ActuationNoise::of(Skills::Perfect, 0, "", 0),
            lookup: None,
        }
    }
}

impl Simulator {
    /// Carries out a tool of the world. `ask`, `finish` and lifecycle tools but `list_receptacles`
    /// belong to the episode and do nothing here.
    pub fn call(&mut self, tool: &Tool, given: CallContext<'_>) -> ToolResult {
        let luck = &given.noise;
        let result = match tool {
            Tool::NavTo { receptacle } => self.nav_to(receptacle, luck),
            Tool::WalkAround => self.walk_around(),
            Tool::ShowObjectByCategory { category } => self.show_objects(category, given.lookup),
            Tool::ShowReceptacles => self.show_receptacles(),
            Tool::GazeAt { marker } => self.gaze_at(*marker, luck),
            Tool::Pick { marker } => self.pick(*marker, luck),
            Tool::Place { marker } => self.place(*marker, luck),
            Tool::Open { marker } => self.drive_door(*marker, true, luck),
            Tool::Close { marker } => self.drive_door(*marker, false, luck),
            Tool::Lifecycle(Lifecycle::ListReceptacles) => Ok(ToolResult::new(Outcome::ok(
                self.stage.scene.room_listing(),
            ))),
            Tool::Ask { .. } | Tool::Finish | Tool::Lifecycle(_) => {
                Ok(ToolResult::new(Outcome::ok("")))
            }
        };
        result.unwrap_or_else(ToolResult::new)
    }

    fn nav_to(
        &mut self,
        receptacle: &ReceptacleId,
        luck: &ActuationNoise,
    ) -> Result<ToolResult, Outcome> {
        let unknown = || ToolText::UnknownReceptacle.outcome(&[receptacle]);
        let index = self.furniture_index(receptacle).ok_or_else(unknown)?;
        let hidden = || ToolText::NoWay.outcome(&[&format_args!("navigate to {receptacle}")]);
        if !self.stage.model.furniture[index].present {
            return Err(hidden());
        }
        let viewpoint = self
            .stage
            .nav
            .viewpoint(&self.stage.model, self.robot.base, index)
            .ok_or_else(hidden)?;
        self.go(&luck.arrive(viewpoint, |base| self.stage.nav.standable(base)));
        self.landmark = Some(index);
        self.clear_markers();
        self.run(NAV_SETTLE_STEPS);
        let mut result = self.seen(ToolText::Arrived.outcome(&[receptacle]));
        result.receptacle = Some(receptacle.clone());
        Ok(result)
    }

    fn walk_around(&mut self) -> Result<ToolResult, Outcome> {
        let nav = self.name("nav_to");
        let landmark = self
            .landmark
            .ok_or_else(|| ToolText::NoLandmark.outcome(&[&nav]))?;
        let id = self.stage.model.furniture[landmark].id.clone();
        let hidden = self.door_state(landmark) == Some(DoorState::Closed);
        let here = |index: &usize| !hidden && self.support_of(*index) == Some(Some(landmark));
        let objects: Vec<InstanceId> = (0..self.stage.task.objects.len())
            .filter(here)
            .map(|index| self.stage.task.objects[index].instance.clone())
            .collect();
        if objects.is_empty() {
            self.clear_markers();
            return Err(ToolText::Empty.outcome(&[&id]));
        }
        let contents = self.contents_text(0, &objects);
        let targets = objects.iter().cloned().map(MarkerTarget::Object);
        self.set_markers((0..).zip(targets), true);
        let mut result = ToolResult::new(contents);
        result.frame = Some(self.capture_frame());
        result.listed = objects;
        result.receptacle = Some(id);
        Ok(result)
    }

    fn show_objects(
        &mut self,
        query: &str,
        lookup: Option<&Lookup>,
    ) -> Result<ToolResult, Outcome> {
        self.update_visible();
        let in_view = self.objects_in_view();
        let category = |index: &usize| &self.stage.task.objects[*index].category;
        let by_vocabulary = || {
            let categories: BTreeSet<&str> = in_view
                .iter()
                .map(|index| category(index).as_str())
                .collect();
            language::match_category(query, &categories).categories
        };
        let matched = lookup.map_or_else(by_vocabulary, |lookup| lookup.categories.clone());
        let found = in_view
            .iter()
            .copied()
            .filter(|index| matched.contains(category(index)));
        let found: Vec<usize> = found.collect();
        if found.is_empty() {
            self.clear_markers();
            return Err(ToolText::NoMatch.outcome(&[&query]));
        }
        let instance =
            |index: &usize| MarkerTarget::Object(self.stage.task.objects[*index].instance.clone());
        let targets: Vec<MarkerTarget> = found.iter().map(instance).collect();
        self.set_markers((1..).zip(targets), true);
        let numbers: Vec<String> = (1..=found.len()).map(|id| format!("marker {id}")).collect();
        Ok(self.seen(ToolText::Found.outcome(&[&found.len(), &query, &numbers.join(", ")])))
    }

    fn show_receptacles(&mut self) -> Result<ToolResult, Outcome> {
        self.update_visible();
        let sights = self.sights();
        let mut found: Vec<(u64, usize)> = (0..self.stage.model.furniture.len())
            .filter_map(|index| {
                let sight = sights.get(usize::from(furniture_entity(index)))?.as_ref()?;
                (sight.pixels >= RECEPTACLE_PIXELS).then(|| (sight.column(), index))
            })
            .collect();
        found.sort_unstable();
        if found.is_empty() {
            self.clear_markers();
            return Err(ToolText::NoReceptacle.outcome(&[]));
        }
        let receptacle = |(_, index): &(u64, usize)| self.stage.model.furniture[*index].id.clone();
        let ids: Vec<ReceptacleId> = found.iter().map(receptacle).collect();
        let lines = numbered((1..).zip(&ids));
        let targets = ids.into_iter().map(MarkerTarget::Receptacle);
        self.set_markers((1..).zip(targets), false);
        Ok(self.seen(ToolText::ReceptaclesInView.outcome(&[&lines])))
    }

    fn gaze_at(&mut self, number: u32, luck: &ActuationNoise) -> Result<ToolResult, Outcome> {
        let (show, walk) = (
            self.name("show_object_by_category"),
            self.name("walk_around"),
        );
        let target = self.marker(number, &[show, walk])?;
        let (viewpoint, object, receptacle) = match &target {
            MarkerTarget::Object(instance) => {
                let index = self
                    .object_index(instance)
                    .expect("markers stand for objects of the task");
                let motion = self
                    .physics
                    .object_motion(index)
                    .ok_or_else(|| not_in_view(number))?;
                let place = self.support_of(index).flatten();
                if place
                    .is_some_and(|furniture| self.door_state(furniture) == Some(DoorState::Closed))
                {
                    return Err(not_in_view(number));
                }
                let viewpoint =
                    self.stage
                        .nav
                        .approach(self.robot.base, motion.pose.position, place);
                (viewpoint, Some(instance.clone()), None)
            }
            MarkerTarget::Receptacle(id) => {
                let index = self
                    .furniture_index(id)
                    .expect("markers stand for receptacles of the scene");
                let viewpoint = self
                    .stage
                    .nav
                    .viewpoint(&self.stage.model, self.robot.base, index);
                if viewpoint.is_some() {
                    self.landmark = Some(index);
                }
                (viewpoint, None, Some(id.clone()))
            }
        };
        let hidden = || ToolText::NoWay.outcome(&[&format_args!("look at marker {number} from")]);
        let viewpoint = viewpoint.ok_or_else(hidden)?;
        self.go(&luck.arrive(viewpoint, |base| self.stage.nav.standable(base)));
        self.run(GAZE_SETTLE_STEPS);
        if !self.markers_persist {
            self.markers.retain(|marker| marker.id == number);
        }
        let mut result = self.seen(ToolText::LookingAt.outcome(&[&number]));
        result.object = object;
        result.receptacle = receptacle;
        Ok(result)
    }

    fn pick(&mut self, number: u32, luck: &ActuationNoise) -> Result<ToolResult, Outcome> {
        if let Some(held) = self.held {
            let category = &self.stage.task.objects[held].category;
            return Err(ToolText::AlreadyHolding.outcome(&[category]));
        }
        let [show, walk, receptacles] =
            ["show_object_by_category", "walk_around", "show_receptacles"]
                .map(|tool| self.name(tool));
        let instance = match self.marker(number, &[show, walk, receptacles])? {
            MarkerTarget::Object(instance) => instance,
            MarkerTarget::Receptacle(id) => return Err(ToolText::NotGraspable.outcome(&[&id])),
        };
        let index = self
            .object_index(&instance)
            .expect("markers stand for objects of the task");
        self.update_visible();
        if !self.objects_in_view().contains(&index) {
            return Err(not_in_view(number));
        }
        let position = self
            .physics
            .object_motion(index)
            .expect("what is in view is not held")
            .pose
            .position;
        let distance_m = distance_2d(self.robot.base, [position[0], position[1]]);
        if distance_m > REACH_M + REACH_SLACK_M {
            let gaze = self.name("gaze_at");
            return Err(ToolText::OutOfReach.outcome(&[&format_args!("Marker {number}"), &gaze]));
        }
        if !luck.succeeds(Primitive::Pick) {
            return Err(skill_failed("pick", "closed on nothing"));
        }
        let receptacle = self
            .support_of(index)
            .flatten()
            .map(|furniture| self.stage.model.furniture[furniture].id.clone());
        if let Some(place) = self.registry.receptacle_of(&instance).cloned() {
            self.registry.remove(&place, &instance);
        }
        self.physics.remove_object(index);
        self.held = Some(index);
        let mut result = self.seen(ToolText::PickedUp.outcome(&[&number]));
        result.object = Some(instance);
        result.receptacle = receptacle;
        Ok(result)
    }

    fn place(&mut self, number: u32, luck: &ActuationNoise) -> Result<ToolResult, Outcome> {
        let held = self
            .held
            .ok_or_else(|| ToolText::NothingHeld.outcome(&[]))?;
        let receptacles = self.name("show_receptacles");
        let id = match self.marker(number, &[receptacles])? {
            MarkerTarget::Receptacle(id) => id,
            MarkerTarget::Object(_) => {
                return Err(ToolText::NotASurface.outcome(&[&format_args!("marker {number}")]));
            }
        };
        let index = self
            .furniture_index(&id)
            .expect("markers stand for receptacles of the scene");
        if !self.placeable(index) {
            return Err(ToolText::NotASurface.outcome(&[&id]));
        }
        if self.door_state(index) == Some(DoorState::Closed) {
            return Err(ToolText::DoorClosed.outcome(&[&id]));
        }
        let surface = self.surface(index);
        if placement::distance_to_surface(&surface, self.robot.base) > REACH_M + REACH_SLACK_M {
            let nav = self.name("nav_to");
            return Err(ToolText::OutOfReach.outcome(&[&format_args!("'{id}'"), &nav]));
        }
        let obstacles: Vec<[[f32; 3]; 2]> = (0..self.stage.task.objects.len())
            .filter_map(|object| self.physics.object_bounds(object))
            .collect();
        let half = self.stage.object_models[held].half;
        let full = || ToolText::NoFreeSpot.outcome(&[&id]);
        let pose =
            placement::clamp(&surface, half, self.robot.base, &obstacles).ok_or_else(full)?;
        if !luck.succeeds(Primitive::place(self.door_state(index).is_some())) {
            return Err(skill_failed("place", "did not let go of the object"));
        }
        let instance = self.stage.task.objects[held].instance.clone();
        self.physics
            .insert_object(held, &self.stage.object_models[held], pose);
        self.registry.add(&id, &instance);
        self.held = None;
        self.run(PLACE_SETTLE_STEPS);
        let mut result = self.seen(ToolText::Placed.outcome(&[&id]));
        result.object = Some(instance);
        result.receptacle = Some(id);
        Ok(result)
    }

    fn drive_door(
        &mut self,
        number: u32,
        open: bool,
        luck: &ActuationNoise,
    ) -> Result<ToolResult, Outcome> {
        let (verb, done) = if open {
            ("open", ToolText::Opened)
        } else {
            ("close", ToolText::Closed)
        };
        let no_door = |what: &dyn Display| ToolText::NoDoor.outcome(&[what, &verb]);
        let id = match self.marker(number, &[])? {
            MarkerTarget::Receptacle(id) => id,
            MarkerTarget::Object(_) => return Err(no_door(&format_args!("Marker {number}"))),
        };
        let index = self
            .furniture_index(&id)
            .expect("markers stand for receptacles of the scene");
        let (Some(door), Some(model)) = (
            self.stage.door_of[index],
            &self.stage.model.furniture[index].door,
        ) else {
            return Err(no_door(&format_args!("'{id}'")));
        };
        if self.held.is_some() {
            return Err(ToolText::HandNotFree.outcome(&[&verb, &id]));
        }
        if distance_2d(self.robot.base, [model.center[0], model.center[1]])
            > REACH_M + 2.0 * REACH_SLACK_M
        {
            let nav = self.name("nav_to");
            return Err(ToolText::OutOfReach.outcome(&[&format_args!("'{id}'"), &nav]));
        }
        if !luck.succeeds(if open {
            Primitive::Open
        } else {
            Primitive::Close
        }) {
            return Err(skill_failed(verb, "slipped off the handle"));
        }
        self.physics.drive_door(door, open);
        self.run(DOOR_SETTLE_STEPS.max(self.physics.travel_steps(door)));
        if let Some(state) = self.registry.receptacles.get_mut(&id) {
            state.door = Some(if open {
                DoorState::Open
            } else {
                DoorState::Closed
            });
        }
        let mut result = self.seen(done.outcome(&[&id]));
        result.receptacle = Some(id);
        Ok(result)
    }

    /// Takes the image with the current markers in it.
    fn seen(&mut self, outcome: Outcome) -> ToolResult {
        let mut frame = self.capture_frame();
        self.draw_markers(&mut frame);
        ToolResult {
            frame: Some(frame),
            ..ToolResult::new(outcome)
        }
    }

    /// What lies on a receptacle, numbered from `first`.
    pub(crate) fn contents_text(&self, first: u32, objects: &[InstanceId]) -> Outcome {
        let category = |object: &InstanceId| {
            let object = self.stage.task.object(object);
            let category = &object.expect("an object of the task").category;
            format!("a(an) {category}.")
        };
        let lines = numbered((first..).zip(objects.iter().map(category)));
        ToolText::Contents.outcome(&[&lines])
    }

    /// Objects in the last image, from left to right.
    fn objects_in_view(&self) -> Vec<usize> {
        let sights = self.sights();
        let mut found: Vec<(u64, usize)> = (0..self.stage.task.objects.len())
            .filter_map(|index| {
                let sight = sights
                    .get(usize::from(self.object_entity(index)))?
                    .as_ref()?;
                (sight.pixels >= VISIBLE_PIXELS).then(|| (sight.column(), index))
            })
            .collect();
        found.sort_unstable();
        found.into_iter().map(|(_, index)| index).collect()
    }

    /// Fails if there is no marker map; `tools` make one.
    pub(crate) fn check_marker_map(&self, tools: &[&str]) -> Result<(), Outcome> {
        if self.has_marker_map {
            return Ok(());
        }
        Err(ToolText::NoMarkerMap.outcome(&[&use_first(tools)]))
    }

    /// What a marker stands for; `tools` make a marker map.
    pub(crate) fn marker(
        &self,
        number: impl Display,
        tools: &[&str],
    ) -> Result<MarkerTarget, Outcome> {
        self.check_marker_map(tools)?;
        let wanted = number.to_string();
        let found = self
            .markers
            .iter()
            .find(|marker| marker.id.to_string() == wanted);
        found
            .map(|marker| marker.target.clone())
            .ok_or_else(|| ToolText::UnknownMarker.outcome(&[&number]))
    }

    pub(crate) fn set_markers(
        &mut self,
        markers: impl Iterator<Item = (u32, MarkerTarget)>,
        persist: bool,
    ) {
        self.markers = markers.map(|(id, target)| Marker { id, target }).collect();
        self.has_marker_map = true;
        self.markers_persist = persist;
    }

    pub(crate) fn clear_markers(&mut self) {
        self.markers.clear();
        self.has_marker_map = false;
        self.markers_persist = false;
    }

    fn placeable(&self, furniture: usize) -> bool {
        let id = &self.stage.model.furniture[furniture].id;
        self.stage
            .scene
            .receptacle(id)
            .is_some_and(|receptacle| receptacle.placeable)
            && self.stage.model.furniture[furniture].present
    }

    /// A tool's name as this profile calls it.
    fn name(&self, paper_name: &str) -> &'static str {
        let spec = ToolSpec::by_name(paper_name).expect("a tool of ours");
        spec.name(self.profile.names())
    }
}

fn not_in_view(number: u32) -> Outcome {
    ToolText::NotInView.outcome(&[&number])
}

/// As the robot's tool server tells of an exception (docs/spec.md#skill-reliability).
pub(crate) fn skill_failed(tool: &str, what: &str) -> Outcome {
    ToolText::SkillFailed.outcome(&[&tool, &what])
}
