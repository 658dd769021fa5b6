//! The camera that images are asked from, on the command line.

use reel_replay::Viewpoint;
use reel_world::Task;

/// Where images are taken from.
#[derive(clap::Args)]
pub struct Camera {
    /// head (what the agent saw), top-down (all of the home), follow:OBJECT (near an object,
    /// wherever it is; an instance, an asset or a category of the task, or target), or free
    /// (from --eye at --look-at)
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
    /// Whether images are those that the agent saw.
    pub fn is_head(&self) -> bool {
        self.camera == "head"
    }

    /// The viewpoint in an episode of that task.
    pub fn viewpoint(&self, task: &Task) -> anyhow::Result<Viewpoint> {
        Ok(Viewpoint::named(
            &self.camera,
            self.eye.as_deref(),
            self.look_at.as_deref(),
            task,
        )?)
    }
}
