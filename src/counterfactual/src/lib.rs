//! What an episode could have been. [`branch`] plays a recorded episode again up to a call and goes
//! on with other calls or another policy; [`blame`] measures with branches which call decided a
//! failure, and repairs it; [`plausible`] plays what one other call would have changed;
//! [`attribution`] measures over many episodes what each capability of the agent cost;
//! [`regression`] says where two runs of the same tasks come apart, and [`bisect`] which of many
//! builds, presets, prompts or checkpoints is the first that changes an episode.

pub mod attribution;
pub mod bisect;
pub mod blame;
pub mod branch;
pub mod plausible;
pub mod regression;
pub mod truth;
