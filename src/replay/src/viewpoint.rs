//! The pictures of an episode from any camera, drawn by executing it again. Only the head camera's are what an agent saw.

use reel_sim::{Simulator, geometry::Camera, render::Detail};
use reel_trace::Trace;
use reel_world::InstanceId;

use crate::{
    Replay, SnapshotCache, Verdict, picture_at,
    seek::{no_call, seek},
};

/// Where a picture is taken from.
#[derive(Clone, PartialEq, Debug)]
pub enum Viewpoint {
    /// The robot's head: what the agent saw, with its marks; the same view where a call gave no picture.
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

/// The picture (RGB) from a viewpoint after a call (none: before the first).
///
/// # Errors
/// Why nothing can be executed, the first difference on the way, or that there is no such call or object.
pub fn view_at(
    trace: &Trace,
    call: Option<u32>,
    viewpoint: &Viewpoint,
    cache: Option<&SnapshotCache>,
) -> Result<Vec<u8>, Verdict> {
    let calls = match (viewpoint, call.map(|call| call as usize)) {
        (Viewpoint::Head, _) => return picture_at(trace, call, cache),
        (_, None) => 0,
        (_, Some(call)) if call < trace.steps.len() => call + 1,
        (_, Some(call)) => return Err(no_call(trace, call)),
    };
    viewpoint.outside(seek(trace, calls, cache)?.episode().simulator())
}

/// The pictures (RGB) from a viewpoint before the first call and after each, in order.
///
/// # Errors
/// Why nothing can be executed, the first difference, or that there is no such object.
pub fn views(trace: &Trace, viewpoint: &Viewpoint) -> Result<Vec<Vec<u8>>, Verdict> {
    let (mut replay, start) = Replay::start(trace, Detail::Picture)?;
    let mut pictures = Vec::new();
    let mut seen = Some(start);
    loop {
        let simulator = replay.episode().simulator();
        pictures.push(match (viewpoint, seen) {
            (Viewpoint::Head, Some(frame)) => frame.rgb,
            (Viewpoint::Head, None) => simulator.picture_from(&simulator.camera()).rgb,
            _ => viewpoint.outside(simulator)?,
        });
        match replay.step()? {
            Some(output) => seen = output.frame,
            None => return Ok(pictures),
        }
    }
}

impl Viewpoint {
    fn outside(&self, simulator: &Simulator) -> Result<Vec<u8>, Verdict> {
        let camera = match self {
            Viewpoint::Head => simulator.camera(),
            Viewpoint::TopDown => simulator.camera_above(),
            Viewpoint::Free { eye, look_at } => Camera::looking_at(*eye, *look_at),
            Viewpoint::Follow(object) => simulator.camera_on(object).ok_or_else(|| Verdict::Refused {
                reason: format!("there is no object {object} in task {}", simulator.task().task_id),
            })?,
        };
        Ok(simulator.picture_from_outside(&camera).rgb)
    }
}
