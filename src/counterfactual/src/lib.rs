//! What an episode could have been. [`branch`] plays a recorded episode again up to a call and goes
//! on with other calls or another policy; [`blame`] measures with branches which call decided a
//! failure, and repairs it.

pub mod blame;
pub mod branch;
pub mod truth;
