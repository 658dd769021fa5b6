//! What the robot's head sees in the middle of a call, for videos and datasets with frames between decisions.

use std::collections::VecDeque;

use reel_world::record::RobotState;

use crate::Simulator;

/// What the robot's head sees in the middle of a call.
#[derive(Clone, Debug)]
pub struct MotionSample {
    /// Physics steps since the start of the episode, those of a world at rest included.
    pub sim_step: u64,
    /// Where the robot stands and looks.
    pub robot: RobotState,
    /// Whether the gripper holds an object.
    pub holds: bool,
    /// The image of the head camera without marks, 640 x 480, RGB.
    pub rgb: Vec<u8>,
}

/// Samples that are wanted, and those that were taken.
#[derive(Debug, Default)]
pub(crate) struct MotionSampler {
    /// Physics steps of the episode, ascending.
    due: VecDeque<u64>,
    taken: Vec<MotionSample>,
}

impl Simulator {
    /// Renders what the head sees after these physics steps of the episode (ascending, counted like
    /// [`Simulator::sim_step`]), as far as the next call executes them.
    pub fn sample_motion(&mut self, sim_steps: impl IntoIterator<Item = u64>) {
        self.motion.due = sim_steps.into_iter().collect();
        self.motion.taken.clear();
    }

    /// The samples since [`Simulator::sample_motion`], in its order; what was not reached is left out.
    pub fn take_samples(&mut self) -> Vec<MotionSample> {
        std::mem::take(&mut self.motion).taken
    }

    /// Renders what is due after `executed` physics steps of the episode.
    pub(crate) fn sample_due(&mut self, executed: u64) {
        while let Some(sim_step) = self.motion.due.pop_front_if(|due| *due <= executed) {
            let sample = MotionSample {
                sim_step,
                robot: self.robot,
                holds: self.held.is_some(),
                rgb: self.render_from(&self.camera()).rgb,
            };
            self.motion.taken.push(sample);
        }
    }
}
