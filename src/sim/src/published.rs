//! The tools of the published servers (branches `main` and `gspo`): what each call does, refuses
//! and says, to the letter. Which branch it is decides only how a category is found; `ask` and what
//! begins or ends an episode are the runner's.
//!
//! Unlike those of the paper (`tools`), these texts name instances, a marker is enough to act on
//! (no reach, no view), and a call that is refused takes time, too.

use reel_world::{
    DoorState, ErrorCode, InstanceId, Outcome, Primitive, ReceptacleId, ToolCall, ToolText,
    record::{Marker, MarkerTarget},
};
use serde_json::Value;

use crate::{
    CallContext, ToolResult,
    geometry::{Camera, Pose},
    model::Surface,
    nav::Viewpoint,
    render::{Detail, OverlayMark, Region},
    simulator::Simulator,
    tools::skill_failed,
};

/// Physics steps before the first call of an episode.
pub(crate) const START_STEPS: u32 = 550;
/// Physics steps of a call that moves nothing, refusals included.
const IDLE_STEPS: u32 = 200;
/// Physics steps of `navigate_to` and `focus_on`.
const MOVE_STEPS: u32 = 250;
const PICK_STEPS: u32 = 720;
const PLACE_STEPS: u32 = 1200;
/// Physics steps of `open` and `close`, whether the door moves or not.
const DOOR_STEPS: u32 = 300;

/// Opacity of the tint over objects, and over receptacles.
const OBJECT_TINT: f32 = 0.25;
const RECEPTACLE_TINT: f32 = 0.5;
/// Free distance between a placed object's centre and the surface's edge, in its half extents.
const EDGE_HALF_EXTENTS: f32 = 4.0;
/// How far above the surface an object is let go, in metres.
const DROP_M: f32 = 0.15;
/// Free height over an object that is put into something, in metres.
const HEADROOM_M: f32 = 0.005;
/// Receptacles of this kind hold nothing, whatever their geometry.
const LID: &str = "potlid";

/// What follows the tool's name where a published handler dies; the published text goes on with the
/// frames of the stack.
const TRACEBACK: &str = "Traceback (most recent call last):";

/// Why a call did nothing.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum PublishedError {
    /// The tool says no.
    Refused(Outcome),
    /// The published handler dies of an exception, with this last line.
    Exception(ErrorCode, String),
}

use PublishedError::{Exception, Refused};

impl From<Outcome> for PublishedError {
    fn from(outcome: Outcome) -> Self {
        Refused(outcome)
    }
}

/// An argument that a published handler reads.
///
/// # Errors
/// Fails if it is missing, as the published handler does.
pub fn argument<'a>(call: &'a ToolCall, name: &str) -> Result<&'a Value, PublishedError> {
    let missing = || Exception(ErrorCode::BadArguments, format!("KeyError: '{name}'"));
    call.arguments
        .as_object()
        .and_then(|arguments| arguments.get(name))
        .ok_or_else(missing)
}

/// A value as Python prints it.
pub fn python_text(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Null => "None".to_owned(),
        Value::Bool(true) => "True".to_owned(),
        Value::Bool(false) => "False".to_owned(),
        other => other.to_string(),
    }
}

/// Where the published servers put an object (half extents `half`): the point of the surface
/// nearest to the robot that keeps four half extents to each edge, the middle where there is none;
/// above it, but below a ceiling.
pub fn drop_point(surface: &Surface, half: [f32; 3], robot: [f32; 2]) -> [f32; 3] {
    let along = |axis: usize| {
        let [low, high] = [
            surface.min[axis] + EDGE_HALF_EXTENTS * half[axis],
            surface.max[axis] - EDGE_HALF_EXTENTS * half[axis],
        ];
        if low > high {
            (surface.min[axis] + surface.max[axis]) * 0.5
        } else {
            robot[axis].clamp(low, high)
        }
    };
    let gap = DROP_M
        .min(surface.clearance - 2.0 * half[2] - HEADROOM_M)
        .max(HEADROOM_M);
    [along(0), along(1), surface.z + half[2] + gap]
}

impl Simulator {
    /// Carries out a call of a published server.
    pub fn call_published(&mut self, call: &ToolCall, given: CallContext<'_>) -> ToolResult {
        let result = match call.name.as_str() {
            "list_receptacles" => self.list(),
            "navigate_to" => self.navigate(call, given),
            "explore_receptacle" => self.explore(),
            "find_objects" => self.find(call, given),
            "highlight_receptacles" => self.highlight(),
            "focus_on" => self.focus(call, given),
            "pick" => self.take(call, given),
            "place" => self.put(call, given),
            "open" => self.turn_door(call, DoorState::Open, given),
            "close" => self.turn_door(call, DoorState::Closed, given),
            name => Err(ToolText::UnknownTool.outcome(&[&name]).into()),
        };
        result.unwrap_or_else(|refusal| self.refuse(&call.name, refusal))
    }

    /// A call that moves nothing and says something.
    pub fn answer_published(
        &mut self,
        tool: &str,
        said: Result<String, PublishedError>,
    ) -> ToolResult {
        match said {
            Ok(text) => {
                self.run(IDLE_STEPS);
                ToolResult::new(Outcome::ok(text))
            }
            Err(refusal) => self.refuse(tool, refusal),
        }
    }

    /// Objects on each receptacle, in the order of the scene; on each in the order in
    /// which they came there.
    pub fn objects_by_receptacle(&self) -> Vec<(ReceptacleId, Vec<InstanceId>)> {
        let ids = self
            .stage
            .scene
            .receptacles
            .iter()
            .map(|receptacle| &receptacle.id);
        ids.map(|id| (id.clone(), self.contents(id))).collect()
    }

    fn contents(&self, id: &ReceptacleId) -> Vec<InstanceId> {
        let here = |instance: &&InstanceId| self.registry.receptacle_of(instance) == Some(id);
        self.arrivals
            .iter()
            .map(|index| &self.stage.task.objects[*index].instance)
            .filter(here)
            .cloned()
            .collect()
    }

    fn refuse(&mut self, tool: &str, refusal: PublishedError) -> ToolResult {
        match refusal {
            Refused(outcome) => {
                self.run(IDLE_STEPS);
                ToolResult::new(outcome)
            }
            Exception(code, last) => {
                let trace = format_args!("{TRACEBACK}\n{last}");
                let text = ToolText::Exception.text(&[&tool, &trace]);
                ToolResult::new(Outcome::error(code, text))
            }
        }
    }

    fn list(&mut self) -> Result<ToolResult, PublishedError> {
        self.markers_persist = false;
        self.run(IDLE_STEPS);
        Ok(ToolResult::new(Outcome::ok(
            self.stage.scene.furniture_listing(),
        )))
    }

    fn navigate(
        &mut self,
        call: &ToolCall,
        given: CallContext<'_>,
    ) -> Result<ToolResult, PublishedError> {
        self.clear_markers();
        let name = python_text(argument(call, "receptacle_name")?);
        let id = ReceptacleId::from(name.as_str());
        let unknown = || ToolText::UnknownReceptacle.outcome(&[&name]);
        let index = self.furniture_index(&id).ok_or_else(unknown)?;
        if !self.has_shelf(index) && self.stage.door_of[index].is_none() {
            return Err(ToolText::NotNavigable.outcome(&[&name]).into());
        }
        let perception = self.stage.perception.clone();
        let viewpoint = self.stage.model.furniture[index]
            .present
            .then(|| perception.viewpoint(self, index))
            .flatten();
        let blocked = || ToolText::NoWay.outcome(&[&format_args!("navigate to {name}")]);
        self.go(&given.noise.arrive(viewpoint.ok_or_else(blocked)?, |base| {
            self.stage.nav.standable(base)
        }));
        self.landmark = Some(index);
        self.run(MOVE_STEPS);
        Ok(ToolResult {
            receptacle: Some(id),
            ..self.plain()
        })
    }

    fn explore(&mut self) -> Result<ToolResult, PublishedError> {
        let none = || ToolText::NoLandmark.outcome(&[&"navigate_to"]);
        let id = self.stage.model.furniture[self.landmark.ok_or_else(none)?]
            .id
            .clone();
        let objects = self.contents(&id);
        if objects.is_empty() {
            return Err(ToolText::Empty.outcome(&[&id]).into());
        }
        let outcome = self.contents_text(1, &objects);
        self.set_markers(
            (1..).zip(objects.iter().cloned().map(MarkerTarget::Object)),
            true,
        );
        self.run(IDLE_STEPS);
        Ok(ToolResult {
            outcome,
            listed: objects,
            receptacle: Some(id),
            ..self.plain()
        })
    }

    fn find(
        &mut self,
        call: &ToolCall,
        given: CallContext<'_>,
    ) -> Result<ToolResult, PublishedError> {
        let query = python_text(argument(call, "target_category")?);
        let wanted = self.category(&query, given);
        self.run(IDLE_STEPS);
        let mut found = self.in_view();
        found.retain(|target| match target {
            MarkerTarget::Object(instance) => self
                .stage
                .task
                .object(instance)
                .is_some_and(|object| Some(&object.category) == wanted.as_ref()),
            MarkerTarget::Receptacle(_) => false,
        });
        self.set_markers((1..).zip(found), true);
        Ok(self.searched(OBJECT_TINT))
    }

    /// The category that a query means: literally (branch `main` only), by what was looked up
    /// outside, else the nearest one.
    fn category(&self, query: &str, given: CallContext<'_>) -> Option<String> {
        let mut categories: Vec<&str> = self
            .stage
            .task
            .objects
            .iter()
            .map(|object| object.category.as_str())
            .collect();
        categories.sort_unstable();
        categories.dedup();
        if self.profile.takes_literally(query, &categories) {
            return Some(query.to_owned());
        }
        match given.lookup {
            Some(lookup) => lookup.categories.first().cloned(),
            None => self.stage.perception.nearest_category(query, &categories),
        }
    }

    fn highlight(&mut self) -> Result<ToolResult, PublishedError> {
        self.run(IDLE_STEPS);
        let mut found = self.in_view();
        found.retain(|target| matches!(target, MarkerTarget::Receptacle(_)));
        self.set_markers((1..).zip(found), false);
        Ok(self.searched(RECEPTACLE_TINT))
    }

    fn focus(
        &mut self,
        call: &ToolCall,
        given: CallContext<'_>,
    ) -> Result<ToolResult, PublishedError> {
        let target = self.marked_thing(call, &["find_objects", "explore_receptacle"])?;
        let MarkerTarget::Object(instance) = target else {
            let advice = " Cannot focus on it.";
            return Err(ToolText::NoGraspablePart
                .outcome(&[&name_of(&target), &advice])
                .into());
        };
        let index = self
            .object_index(&instance)
            .expect("markers stand for objects of the task");
        let close_up = self.stage.perception.clone().close_up(self, index);
        if self.landmark.is_none() {
            let lacking = if close_up.is_some() {
                ToolText::NoOrientation
            } else {
                ToolText::NoPosition
            };
            return Err(lacking.outcome(&[&"navigate_to"]).into());
        }
        match close_up {
            Some(viewpoint) => self.go(&given
                .noise
                .arrive(viewpoint, |base| self.stage.nav.standable(base))),
            None => self.look_from_here(index),
        }
        self.run(MOVE_STEPS);
        let result = if self.markers_persist {
            let seen = self.in_view();
            self.markers.retain(|marker| seen.contains(&marker.target));
            self.marked(OBJECT_TINT)
        } else {
            self.plain()
        };
        Ok(ToolResult {
            object: Some(instance),
            ..result
        })
    }

    fn take(
        &mut self,
        call: &ToolCall,
        given: CallContext<'_>,
    ) -> Result<ToolResult, PublishedError> {
        if let Some(held) = self.held() {
            return Err(ToolText::AlreadyHolding.outcome(&[held]).into());
        }
        let makers = [
            "find_objects",
            "explore_receptacle",
            "highlight_receptacles",
        ];
        let target = self.marked_thing(call, &makers)?;
        let MarkerTarget::Object(instance) = target else {
            return Err(ToolText::NoGraspablePart
                .outcome(&[&name_of(&target), &""])
                .into());
        };
        succeeds(given, Primitive::Pick, "pick", "closed on nothing")?;
        let index = self
            .object_index(&instance)
            .expect("markers stand for objects of the task");
        let receptacle = self.registry.receptacle_of(&instance).cloned();
        if let Some(place) = &receptacle {
            self.registry.remove(place, &instance);
        }
        self.arrivals.retain(|arrived| *arrived != index);
        self.physics.remove_object(index);
        self.held = Some(index);
        self.run(PICK_STEPS);
        Ok(ToolResult {
            object: Some(instance),
            receptacle,
            ..self.plain()
        })
    }

    fn put(
        &mut self,
        call: &ToolCall,
        given: CallContext<'_>,
    ) -> Result<ToolResult, PublishedError> {
        let target = self.marked_thing(call, &["highlight_receptacles"])?;
        let held = self
            .held
            .ok_or_else(|| ToolText::NothingHeld.outcome(&[]))?;
        let name = name_of(&target).to_owned();
        let id = match target {
            MarkerTarget::Receptacle(id) if !name.starts_with(LID) => id,
            _ => return Err(ToolText::NotASurface.outcome(&[&name]).into()),
        };
        let index = self
            .furniture_index(&id)
            .expect("markers stand for receptacles of the scene");
        if self.registry.door(&id) == Some(DoorState::Closed) {
            return Err(ToolText::DoorClosed.outcome(&[&name]).into());
        }
        if !self.has_shelf(index) {
            return Err(ToolText::NoShelf.outcome(&[&name]).into());
        }
        if self.landmark.is_none() {
            let last = "TypeError: cannot unpack non-iterable NoneType object".to_owned();
            return Err(Exception(ErrorCode::NoLandmark, last));
        }
        succeeds(
            given,
            Primitive::place(self.door_state(index).is_some()),
            "place",
            "did not let go of the object",
        )?;
        let instance = self.stage.task.objects[held].instance.clone();
        let [x, y, _] = self.robot.camera;
        let model = &self.stage.object_models[held];
        let point = drop_point(&self.surface(index), model.half, [x, y]);
        self.physics
            .insert_object(held, model, Pose::yawed(point, 0.0));
        self.registry.add(&id, &instance);
        self.arrivals.push(held);
        self.held = None;
        self.run(PLACE_STEPS);
        Ok(ToolResult {
            object: Some(instance),
            receptacle: Some(id),
            ..self.plain()
        })
    }

    fn turn_door(
        &mut self,
        call: &ToolCall,
        wanted: DoorState,
        given: CallContext<'_>,
    ) -> Result<ToolResult, PublishedError> {
        let target = self.marked_thing(call, &[])?;
        let MarkerTarget::Receptacle(id) = target else {
            self.run(DOOR_STEPS);
            return Ok(self.plain());
        };
        let index = self
            .furniture_index(&id)
            .expect("markers stand for receptacles of the scene");
        let door = self.stage.door_of[index].filter(|_| self.registry.door(&id) != Some(wanted));
        let mut steps = DOOR_STEPS;
        if let Some(door) = door {
            let open = wanted == DoorState::Open;
            let (primitive, verb) = if open {
                (Primitive::Open, "open")
            } else {
                (Primitive::Close, "close")
            };
            succeeds(given, primitive, verb, "slipped off the handle")?;
            self.physics.drive_door(door, open);
            steps = steps.max(self.physics.travel_steps(door));
            self.registry
                .receptacles
                .entry(id.clone())
                .or_default()
                .door = Some(wanted);
        }
        self.run(steps);
        Ok(ToolResult {
            receptacle: Some(id),
            ..self.plain()
        })
    }

    /// What the marker of a call stands for; `makers` make a marker map.
    fn marked_thing(
        &self,
        call: &ToolCall,
        makers: &[&str],
    ) -> Result<MarkerTarget, PublishedError> {
        self.check_marker_map(makers)?;
        let number = python_text(argument(call, "marker_id")?);
        Ok(self.marker(number, makers)?)
    }

    /// Whether something can be put on it; a lid has the shelf, and is refused for what it is.
    fn has_shelf(&self, furniture: usize) -> bool {
        let id = &self.stage.model.furniture[furniture].id;
        self.stage
            .scene
            .receptacle(id)
            .is_some_and(|receptacle| receptacle.placeable || id.as_str().starts_with(LID))
    }

    /// What has a pixel in the image from here, in ascending instance id.
    fn in_view(&mut self) -> Vec<MarkerTarget> {
        self.update_visible();
        let segments = self.stage.perception.segments(self);
        segments
            .into_iter()
            .filter(|segment| segment.pixels > 0)
            .map(|segment| segment.target)
            .collect()
    }

    fn look_from_here(&mut self, object: usize) {
        if let Some(motion) = self.physics.object_motion(object) {
            let camera = Camera::looking_at(self.robot.camera, motion.pose.position);
            self.go(&Viewpoint {
                base: self.robot.base,
                camera,
                path_length_m: 0.0,
            });
        }
    }

    /// The image, and no word.
    fn plain(&mut self) -> ToolResult {
        let frame = self.capture_frame();
        ToolResult {
            frame: Some(frame),
            ..ToolResult::new(Outcome::ok(""))
        }
    }

    /// The image of a search. One that marked nothing found nothing, though the servers say
    /// no word of it.
    fn searched(&mut self, opacity: f32) -> ToolResult {
        let mut result = self.marked(opacity);
        result.outcome.error = self.markers.is_empty().then_some(ErrorCode::NothingFound);
        result
    }

    /// The image with the current markers in it, and no word.
    fn marked(&mut self, opacity: f32) -> ToolResult {
        let mut frame = self.capture_frame();
        let mark = |marker: &Marker| {
            Some(OverlayMark {
                number: marker.id,
                region: Region::Entity(self.entity(&marker.target)?),
            })
        };
        let marks: Vec<OverlayMark> = self.markers.iter().filter_map(mark).collect();
        if self.detail == Detail::Full && !marks.is_empty() {
            self.stage.perception.mark(&mut frame, &marks, opacity);
        }
        ToolResult {
            frame: Some(frame),
            ..ToolResult::new(Outcome::ok(""))
        }
    }
}

fn name_of(target: &MarkerTarget) -> &str {
    match target {
        MarkerTarget::Object(instance) => instance.as_str(),
        MarkerTarget::Receptacle(id) => id.as_str(),
    }
}

/// Fails as the robot's tool server does where a skill fails.
fn succeeds(
    given: CallContext<'_>,
    primitive: Primitive,
    tool: &str,
    what: &str,
) -> Result<(), PublishedError> {
    if given.noise.succeeds(primitive) {
        Ok(())
    } else {
        Err(skill_failed(tool, what).into())
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    const TABLE: Surface = Surface {
        min: [0.0, 0.0],
        max: [2.0, 1.0],
        z: 0.8,
        clearance: 1.0,
    };

    #[test]
    fn a_drop_point_keeps_four_half_extents_to_the_edge_or_takes_the_middle() {
        let near = |found: [f32; 3], wanted: [f32; 3]| {
            found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-5)
        };
        assert!(near(
            drop_point(&TABLE, [0.1, 0.05, 0.15], [4.5, -0.8]),
            [1.6, 0.2, 1.1]
        ));
        assert!(near(
            drop_point(&TABLE, [0.1, 0.05, 0.15], [1.0, 0.5]),
            [1.0, 0.5, 1.1]
        ));
        assert!(near(
            drop_point(&TABLE, [0.6, 0.2, 0.05], [4.5, -0.8]),
            [1.0, 0.5, 1.0]
        ));
        let box_shelf = Surface {
            clearance: 0.25,
            ..TABLE
        };
        assert!(
            near(
                drop_point(&box_shelf, [0.1, 0.05, 0.1], [1.0, 0.5]),
                [1.0, 0.5, 0.945]
            ),
            "under a ceiling"
        );
    }

    #[test]
    fn values_print_as_python_prints_them() {
        for (value, text) in [
            (json!(null), "None"),
            (json!(true), "True"),
            (json!("2"), "2"),
            (json!(2), "2"),
            (json!(1.5), "1.5"),
        ] {
            assert_eq!(python_text(&value), text);
        }
    }
}
