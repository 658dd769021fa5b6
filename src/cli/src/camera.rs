//! The camera that pictures are asked from, on the command line.

use anyhow::{Context, bail};
use reel_replay::Viewpoint;
use reel_world::{InstanceId, Task};

/// Where pictures are taken from.
#[derive(clap::Args)]
pub struct Camera {
    /// head (what the agent saw), top-down (all of the home), follow:OBJECT (near an object, wherever it is; an instance, an
    /// asset or a category of the task, or target), or free (from --eye at --look-at)
    #[arg(long, value_name = "WHICH", default_value = "head")]
    camera: String,
    /// With --camera free: where the camera is, x,y,z in metres in the scene's frame
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    eye: Option<String>,
    /// With --camera free: what it looks at
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    look_at: Option<String>,
}

impl Camera {
    /// Whether pictures are those that the agent saw.
    pub fn is_head(&self) -> bool {
        self.camera == "head"
    }

    /// The viewpoint in an episode of that task.
    pub fn viewpoint(&self, task: &Task) -> anyhow::Result<Viewpoint> {
        if self.camera != "free" && (self.eye.is_some() || self.look_at.is_some()) {
            bail!("--eye and --look-at are for --camera free, not for {}", self.camera);
        }
        Ok(match self.camera.as_str() {
            "head" => Viewpoint::Head,
            "top-down" => Viewpoint::TopDown,
            "free" => {
                let point = |name: &str, text: &Option<String>| {
                    point(text.as_deref().with_context(|| format!("--camera free needs {name} x,y,z"))?)
                        .with_context(|| format!("{name} takes x,y,z in metres, e.g. 2.5,1,1.8"))
                };
                Viewpoint::Free { eye: point("--eye", &self.eye)?, look_at: point("--look-at", &self.look_at)? }
            }
            other => match other.strip_prefix("follow:") {
                Some(name) => Viewpoint::Follow(object(name, task)?),
                None => bail!("no camera is called '{other}'; there are head, top-down, free and follow:OBJECT"),
            },
        })
    }
}

fn point(text: &str) -> anyhow::Result<[f32; 3]> {
    let numbers: Vec<f32> = text.split(',').map(|number| number.trim().parse()).collect::<Result<_, _>>()?;
    match <[f32; 3]>::try_from(numbers) {
        Ok(point) if point.iter().all(|value| value.is_finite()) => Ok(point),
        _ => bail!("'{text}' is not three finite numbers"),
    }
}

/// The one object of the task that goes by this name.
fn object(name: &str, task: &Task) -> anyhow::Result<InstanceId> {
    if name == "target" {
        return Ok(task.target.clone());
    }
    let known = |is_it: &dyn Fn(&reel_world::ObjectInstance) -> bool| -> Vec<&InstanceId> {
        task.objects.iter().filter(|object| is_it(object)).map(|object| &object.instance).collect()
    };
    let ways = [
        known(&|object| object.instance.as_str() == name),
        known(&|object| object.asset.as_str() == name),
        known(&|object| object.category == name),
    ];
    let names = |ids: &[&InstanceId]| ids.iter().map(|id| id.as_str()).collect::<Vec<_>>().join(", ");
    match ways.iter().find(|ids| !ids.is_empty()).map(Vec::as_slice) {
        Some([one]) => Ok((*one).clone()),
        Some(several) => bail!("several objects are called {name}: {}", names(several)),
        None => bail!("task {} has no object {name}; there are {}", task.task_id, names(&known(&|_| true))),
    }
}
