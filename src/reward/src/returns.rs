//! What an episode returns to a trainer: the named ways to sum its rewards up.

use reel_world::{GAMMA, HORIZON};
use serde::Serialize;

use crate::discounted_return;

/// How rewards become the return of an episode: the sum of `gamma^(t-1) r_t` over
/// the first `horizon` decisions.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
pub struct Returns {
    /// As it is named on the command line.
    pub name: &'static str,
    /// Discount factor; 1 is the plain sum.
    pub gamma: f64,
    /// Most decisions of an episode; later ones do not count.
    pub horizon: u32,
}

impl Returns {
    /// Of the paper (Full POMDP Definition): gamma 0.99, 30 decisions.
    pub const PAPER: Returns = Returns {
        name: "paper",
        gamma: GAMMA,
        horizon: HORIZON,
    };
    /// Of the published trainer: the plain sum of 50 decisions.
    pub const PUBLISHED: Returns = Returns {
        name: "published",
        gamma: 1.0,
        horizon: 50,
    };
    /// The presets of returns that have a name.
    pub const ALL: [Returns; 2] = [Returns::PAPER, Returns::PUBLISHED];

    /// The one of a name; `None` if there is none.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|returns| returns.name == name)
    }

    /// The return of an episode with these rewards, one a decision.
    pub fn of(&self, rewards: &[f64]) -> f64 {
        discounted_return(
            &rewards[..rewards.len().min(self.horizon as usize)],
            self.gamma,
        )
    }
}
