//! The skills of a robot's arm, as the paper's table of executability counts them, and how often
//! each succeeds. Knows no physics.

use crate::Skills;

/// A skill of the arm, as the paper's table counts them.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Primitive {
    /// Pull a door open.
    Open,
    /// Push an open door closed again.
    Close,
    /// Take an object with the gripper.
    Pick,
    /// Put it on an open surface.
    PlaceOpen,
    /// Put it into something with a door, as into the paper's microwave.
    PlaceInside,
}

impl Primitive {
    /// All of them, in the order of the paper's table.
    pub const ALL: [Primitive; 5] = [
        Primitive::Open,
        Primitive::Close,
        Primitive::Pick,
        Primitive::PlaceOpen,
        Primitive::PlaceInside,
    ];

    /// The name of the class in tables: `open`, `close`, `pick`, `place_open`, `place_inside`.
    pub fn as_str(self) -> &'static str {
        match self {
            Primitive::Open => "open",
            Primitive::Close => "close",
            Primitive::Pick => "pick",
            Primitive::PlaceOpen => "place_open",
            Primitive::PlaceInside => "place_inside",
        }
    }

    /// Reads what [`Primitive::as_str`] wrote.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|primitive| primitive.as_str() == text)
    }

    /// How often it succeeds: of 120 executions each in the paper.
    pub fn success(self, skills: Skills) -> f64 {
        match (skills, self) {
            (Skills::Perfect, _) | (_, Primitive::Close | Primitive::PlaceOpen) => 1.0,
            (Skills::RealV1, Primitive::Open) => 0.633,
            (Skills::RealV1, Primitive::Pick) => 0.892,
            (Skills::RealV1, Primitive::PlaceInside) => 0.742,
        }
    }

    /// Which of the two places a receptacle is.
    pub fn place(has_door: bool) -> Self {
        if has_door {
            Primitive::PlaceInside
        } else {
            Primitive::PlaceOpen
        }
    }
}
