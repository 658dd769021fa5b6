//! Why an episode failed, measured: what every step cost, the step that decided, what
//! would have been better then, played and verified, and the smallest change of its calls
//! that makes it succeed.
//!
//! Never labels, rules of the taxonomy or words of the policy: only what was done and
//! what could be known.

mod alternative;
mod batch;
mod cost;
mod decide;
mod explanation;
mod preferred;
mod repair;
mod report;

pub use alternative::{Alternative, alternative};
pub use batch::{BlameOptions, MeasuredTrace, blame_all, measure};
pub(crate) use cost::outcome;
pub use cost::{CompetentAgent, StepCost};
pub use decide::Harm;
pub use preferred::{Preferred, preferred};
pub use repair::{Edit, Repair, repair};
pub use report::{Blame, Cause, Decisive, Shares, blame, blame_against};
