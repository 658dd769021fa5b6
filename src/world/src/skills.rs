//! How reliable a robot's skills are. Only the name: what it does to a call is the simulator's.

use serde::{Deserialize, Serialize};

/// How reliable the robot's skills are.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Skills {
    /// A skill does what it is told, to the millimetre.
    #[default]
    Perfect,
    /// Skills fail and the base arrives beside its goal as often and as far as on the paper's
    /// robot ("Quantitative real-world evaluation").
    RealV1,
}

impl Skills {
    /// Both levels of reliability, the perfect one first.
    pub const ALL: [Skills; 2] = [Skills::Perfect, Skills::RealV1];

    /// As it stands on the command line and in traces.
    pub fn as_str(self) -> &'static str {
        match self {
            Skills::Perfect => "perfect",
            Skills::RealV1 => "real-v1",
        }
    }

    /// Reads what [`Skills::as_str`] wrote.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|skills| skills.as_str() == text)
    }

    /// Whether nothing ever goes wrong.
    pub fn are_perfect(&self) -> bool {
        *self == Skills::Perfect
    }
}
