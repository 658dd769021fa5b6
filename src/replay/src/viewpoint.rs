//! The images of an episode from any camera, drawn by executing it again. Only the head camera's
//! are what an agent saw.

use reel_sim::{Simulator, geometry::Camera, render::Detail};
use reel_trace::Trace;
use reel_world::{Frame, InstanceId, ObjectInstance, Task};

use crate::{
    Replay, SnapshotCache, Verdict, frame_at,
    seek::{no_call, seek},
};

/// Where an image is taken from.
#[derive(Clone, PartialEq, Debug)]
pub enum Viewpoint {
    /// The robot's head: what the agent saw, with its marks; the same view where a
    /// call gave no image.
    Head,
    /// From above, all of the home.
    TopDown,
    /// From one point at another, in metres in the scene's frame.
    Free {
        /// Where the camera is.
        eye: [f32; 3],
        /// What it looks at.
        look_at: [f32; 3],
    },
    /// Near an object, wherever it is.
    Follow(InstanceId),
}

/// A viewpoint that cannot be.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum ViewpointError {
    /// No camera of this name.
    #[error("no camera is called '{0}'; there are head, top-down, free and follow:OBJECT")]
    Unknown(String),
    /// Points for a camera that has its own.
    #[error("eye and look-at are for the free camera, not for {0}")]
    Fixed(String),
    /// The free camera without its points.
    #[error("the free camera needs {0} as x,y,z in metres, e.g. 2.5,1,1.8")]
    NoPoint(&'static str),
    /// A text that is not three finite coordinates `x,y,z`.
    #[error("'{0}' is not three finite numbers x,y,z")]
    NoNumbers(String),
    /// No object of the task has this name.
    #[error("task {task} has no object {name}; there are {known}")]
    NoObject {
        task: String,
        name: String,
        known: String,
    },
    /// Several of that name.
    #[error("several objects are called {name}: {found}")]
    Several { name: String, found: String },
}

impl Viewpoint {
    /// A viewpoint in an episode of a task by its name: `head`, `top-down`, `follow:OBJECT` (an
    /// instance, an asset or a category of the task, or `target`), or `free` with two points
    /// `x,y,z`, in metres in the scene's frame.
    ///
    /// # Errors
    /// When there is no such camera or object, or a point is missing or none.
    pub fn named(
        name: &str,
        eye: Option<&str>,
        look_at: Option<&str>,
        task: &Task,
    ) -> Result<Self, ViewpointError> {
        if name != "free" && (eye.is_some() || look_at.is_some()) {
            return Err(ViewpointError::Fixed(name.to_owned()));
        }
        match name {
            "head" => Ok(Viewpoint::Head),
            "top-down" => Ok(Viewpoint::TopDown),
            "free" => Ok(Viewpoint::Free {
                eye: point(eye.ok_or(ViewpointError::NoPoint("an eye"))?)?,
                look_at: point(look_at.ok_or(ViewpointError::NoPoint("a look-at"))?)?,
            }),
            other => match other.strip_prefix("follow:") {
                Some(name) => object(name, task).map(Viewpoint::Follow),
                None => Err(ViewpointError::Unknown(other.to_owned())),
            },
        }
    }
}

fn point(text: &str) -> Result<[f32; 3], ViewpointError> {
    let no_numbers = || ViewpointError::NoNumbers(text.to_owned());
    let numbers: Result<Vec<f32>, _> = text
        .split(',')
        .map(|number| number.trim().parse())
        .collect();
    let point =
        <[f32; 3]>::try_from(numbers.map_err(|_| no_numbers())?).map_err(|_| no_numbers())?;
    if point.iter().all(|value| value.is_finite()) {
        Ok(point)
    } else {
        Err(no_numbers())
    }
}

/// The one object of the task that goes by this name.
fn object(name: &str, task: &Task) -> Result<InstanceId, ViewpointError> {
    if name == "target" {
        return Ok(task.target.clone());
    }
    let known = |is_it: &dyn Fn(&ObjectInstance) -> bool| -> Vec<&InstanceId> {
        task.objects
            .iter()
            .filter(|object| is_it(object))
            .map(|object| &object.instance)
            .collect()
    };
    let ways = [
        known(&|object| object.instance.as_str() == name),
        known(&|object| object.asset.as_str() == name),
        known(&|object| object.category == name),
    ];
    let names = |ids: &[&InstanceId]| {
        ids.iter()
            .map(|id| id.as_str())
            .collect::<Vec<_>>()
            .join(", ")
    };
    let name = name.to_owned();
    match ways.iter().find(|ids| !ids.is_empty()).map(Vec::as_slice) {
        Some([one]) => Ok((*one).clone()),
        Some(several) => Err(ViewpointError::Several {
            found: names(several),
            name,
        }),
        None => Err(ViewpointError::NoObject {
            task: task.task_id.clone(),
            known: names(&known(&|_| true)),
            name,
        }),
    }
}

/// The frame from a viewpoint after a call (none: before the first).
///
/// # Errors
/// Why nothing can be executed, the first difference on the way, or that there is no
/// such call or object.
pub fn view_at(
    trace: &Trace,
    call: Option<u32>,
    viewpoint: &Viewpoint,
    cache: Option<&SnapshotCache>,
) -> Result<Frame, Verdict> {
    let calls = match (viewpoint, call.map(|call| call as usize)) {
        (Viewpoint::Head, _) => return frame_at(trace, call, cache),
        (_, None) => 0,
        (_, Some(call)) if call < trace.steps.len() => call + 1,
        (_, Some(call)) => return Err(no_call(trace, call)),
    };
    viewpoint.draw(seek(trace, calls, cache)?.episode().simulator())
}

/// An episode after one of its calls, from a viewpoint.
#[derive(Debug)]
pub struct View<'a> {
    /// The call; `None` before the first.
    pub step: Option<u32>,
    /// What is seen then.
    pub frame: Frame,
    /// Where it is seen from.
    pub camera: Camera,
    /// The state of the simulator then.
    pub simulator: &'a Simulator,
}

/// Shows what is seen from a viewpoint before the first call and after each, in order.
///
/// # Errors
/// Why nothing can be executed, the first difference, that of the end included, or that there is no such object.
pub fn views(
    trace: &Trace,
    viewpoint: &Viewpoint,
    mut show: impl FnMut(View<'_>),
) -> Result<(), Verdict> {
    let (mut replay, start) = Replay::start(trace, Detail::Full)?;
    let (mut step, mut seen) = (None, Some(start));
    loop {
        let simulator = replay.episode().simulator();
        let camera = viewpoint.camera(simulator)?;
        let frame = match (viewpoint, seen) {
            (Viewpoint::Head, Some(frame)) => frame,
            _ => viewpoint.draw(simulator)?,
        };
        show(View {
            step,
            frame,
            camera,
            simulator,
        });
        match replay.step()? {
            Some(output) => (step, seen) = (Some(output.record.step), output.frame),
            None => break,
        }
    }
    match replay.finish(|_, _| ())? {
        verdict if verdict.is_exact() => Ok(()),
        verdict => Err(verdict),
    }
}

impl Viewpoint {
    /// What is seen from here in the state that a simulator is in. The head's image has the marks
    /// of that state.
    ///
    /// # Errors
    /// When there is no such object.
    pub fn draw(&self, simulator: &Simulator) -> Result<Frame, Verdict> {
        let camera = self.camera(simulator)?;
        Ok(match self {
            Viewpoint::Head => simulator.render_from(&camera),
            _ => simulator.render_external(&camera),
        })
    }

    fn camera(&self, simulator: &Simulator) -> Result<Camera, Verdict> {
        Ok(match self {
            Viewpoint::Head => simulator.camera(),
            Viewpoint::TopDown => simulator.camera_above(),
            Viewpoint::Free { eye, look_at } => Camera::looking_at(*eye, *look_at),
            Viewpoint::Follow(object) => {
                simulator
                    .camera_on(object)
                    .ok_or_else(|| Verdict::Refused {
                        reason: format!(
                            "there is no object {object} in task {}",
                            simulator.task().task_id
                        ),
                    })?
            }
        })
    }
}
