//! What tools say: every text of an outcome, of Reel's tools and of the published servers, is
//! written and read here (docs/spec.md#published-texts). A text is recognised by a part of it,
//! since other servers put words around it. What the published trainer reads in the same texts is
//! its own rule, in `reel_reward::trainer`.

use std::fmt::{Display, Write as _};

use crate::{ErrorCode, Outcome};

macro_rules! texts {
    ($($name:ident = $code:expr, $template:literal, $mark:literal;)*) => {
        /// A text that a tool says. `{}` stands for a value.
        #[derive(Clone, Copy, PartialEq, Eq, Debug)]
        pub enum ToolText { $(#[doc = concat!("`", $template, "`")] $name,)* }

        impl ToolText {
            /// Every text, in the order in which a message is compared with them.
            pub const ALL: &[ToolText] = &[$(ToolText::$name,)*];

            /// The error code of the outcome; `None` if the call succeeded.
            pub fn code(self) -> Option<ErrorCode> {
                match self { $(ToolText::$name => $code,)* }
            }

            fn template(self) -> &'static str {
                match self { $(ToolText::$name => $template,)* }
            }

            /// The part by which the text is recognised.
            fn mark(self) -> &'static str {
                match self { $(ToolText::$name => $mark,)* }
            }
        }
    };
}

use ErrorCode as E;

texts! {
    Arrived = None, "Arrived at {}.", "Arrived at";
    Contents = None, "I found the following object(s): {}\n", "I found the following";
    Found = None, "Found {} object(s) matching '{}': {}.", "Found ";
    ReceptaclesInView = None, "Receptacles in view: {}\n", "Receptacles in view";
    LookingAt = None, "Looking at marker {}.", "Looking at";
    PickedUp = None, "Picked up the object with marker {}.", "Picked up";
    Placed = None, "Placed the object on {}.", "Placed ";
    Opened = None, "Opened the door of {}.", "Opened ";
    Closed = None, "Closed the door of {}.", "Closed ";
    Finished = None, "Episode finished.", "";

    SkillFailed = Some(E::SkillFailed), "Error executing {}: the gripper {}.", ": the gripper ";
    Exception = Some(E::BackendError), "Error executing {}: {}", "Error executing ";
    InvalidInput = Some(E::BadArguments), "Input validation error: {}", "Input validation error";
    NoCall = Some(E::UnparsableOutput), "No tool selected: {}", "No tool selected";
    UnknownReceptacle = Some(E::UnknownReceptacle),
        "Receptacle {} not found in the scene.", "not found in the scene";
    NoWay = Some(E::NoViewpoint),
        "Cannot find a non-occluded position to {}.", "Cannot find a non-occluded position";
    NoBounds = Some(E::NoViewpoint), "Cannot compute bounding box for {}.", "Cannot compute bounding box";
    NotNavigable = Some(E::NoViewpoint),
        "Object {} has no valid navigable component.", "no valid navigable component";
    NoLandmark = Some(E::NoLandmark), "No landmark selected. Use '{}' first.", "No landmark selected";
    NoPosition = Some(E::NoLandmark),
        "No camera position available. Use '{}' first.", "No camera position available";
    NoOrientation = Some(E::NoLandmark),
        "No camera orientation available. Use '{}' first.", "No camera orientation available";
    Empty = Some(E::NothingFound),
        "Seems there is no object on the {}'s top shelf to observe.", "Seems there is no object";
    NoMatch = Some(E::NothingFound), "No object matching '{}' is in view.", "No object matching";
    NoReceptacle = Some(E::NothingFound), "No receptacle is in view.", "No receptacle is in view";
    UnknownMarker = Some(E::UnknownMarker),
        "Marker ID {} not found in the marker map.", "not found in the marker map";
    NoMarkerMap = Some(E::NoMarkerMap), "No marker map available.{}", "No marker map available";
    NotInView = Some(E::MarkerNotInView),
        "The object with marker {} is not in view.", "is not in view";
    NotAvailable = Some(E::MarkerNotInView),
        "Object {} is not available. Cannot focus on it.", "is not available. Cannot focus on it";
    AlreadyHolding = Some(E::AlreadyHolding),
        "You are already holding '{}'. Place it before picking another object.",
        "You are already holding";
    NoGraspablePart = Some(E::NotGraspable),
        "Object {} has no graspable component.{}", "has no graspable component";
    NotGraspable = Some(E::NotGraspable),
        "Object {} is not graspable. Cannot pick it up.", "is not graspable";
    NothingHeld = Some(E::NothingHeld),
        "No object in the inventory to place.", "No object in the inventory";
    NotASurface = Some(E::NotASurface),
        "'{}' is not a valid placement surface.", "is not a valid placement surface";
    NoShelf = Some(E::NotASurface),
        "Furniture {} has no top_shelf component.", "has no top_shelf component";
    NotATarget = Some(E::NotASurface), "Target furniture {}", "Target furniture ";
    DoorClosed = Some(E::DoorClosed),
        "The door of '{}' is closed. Use 'open' first.", "is closed. Use";
    OutOfReach = Some(E::OutOfReach),
        "{} is out of reach. Use '{}' to approach it first.", "is out of reach";
    NoFreeSpot = Some(E::NoFreeSpot),
        "There is no free spot on '{}' for the held object.", "There is no free spot";
    NoDoor = Some(E::NoDoor), "{} has no door. Cannot {} it.", "has no door";
    HandNotFree = Some(E::HandNotFree),
        "The hand is not free. Place the held object before you {} '{}'.", "The hand is not free";
    UnknownTool = Some(E::UnknownTool), "Action '{}' not recognized.", "not recognized";
    NotAnObject = Some(E::BadArguments),
        "{}: arguments must be a JSON object, found {}", ": arguments must be a JSON object";
    MissingArgument = Some(E::BadArguments), "{}: missing argument '{}'", ": missing argument '";
    WrongType = Some(E::BadArguments), "{}: argument '{}' must be {}, found {}", ": argument '";
    OtherTask = Some(E::BadArguments),
        "Task {} can only be started by a session; this episode plays one task.",
        "can only be started by a session";
    EpisodeOver = Some(E::EpisodeOver), "The episode is over.", "The episode is over";
}

impl ToolText {
    /// The text with its values, one for each `{}`.
    pub fn text(self, values: &[&dyn Display]) -> String {
        let mut parts = self.template().split("{}");
        let mut text = parts.next().unwrap_or_default().to_owned();
        for (part, value) in parts.zip(values) {
            write!(text, "{value}{part}").expect("a String takes any text");
        }
        text
    }

    /// The outcome that says this text.
    pub fn outcome(self, values: &[&dyn Display]) -> Outcome {
        Outcome {
            text: self.text(values),
            error: self.code(),
        }
    }

    /// Whether a message is this text or begins like it.
    pub fn begins(self, message: &str) -> bool {
        message.starts_with(self.mark())
    }

    /// The failure that a message tells of; `None` if it tells of none that is known. What a user
    /// answers is no message of a tool.
    pub fn failure(message: &str) -> Option<Self> {
        let tells = |text: &&ToolText| text.code().is_some() && message.contains(text.mark());
        Self::ALL.iter().find(tells).copied()
    }

    /// What a tool (by its paper name) says when it succeeds; `None` if it says anything.
    pub fn success(tool: &str) -> Option<Self> {
        Some(match tool {
            "nav_to" => Self::Arrived,
            "walk_around" => Self::Contents,
            "show_object_by_category" => Self::Found,
            "show_receptacles" => Self::ReceptaclesInView,
            "gaze_at" => Self::LookingAt,
            "pick" => Self::PickedUp,
            "place" => Self::Placed,
            "open" => Self::Opened,
            "close" => Self::Closed,
            _ => return None,
        })
    }

    /// The one value of a text, e.g. the receptacle of `Arrived at {}.`; `None` if the message is
    /// another text.
    pub fn value(self, message: &str) -> Option<&str> {
        let (before, _) = self.template().split_once("{}")?;
        let (_, value) = message.split_once(before)?;
        Some(value.trim_end().trim_end_matches('.'))
    }
}

/// The lines of a list with a number before each item, for [`ToolText::Contents`] and
/// [`ToolText::ReceptaclesInView`].
pub fn numbered(items: impl Iterator<Item = (u32, impl Display)>) -> String {
    items
        .map(|(number, item)| format!("\n\t{number}: {item}"))
        .collect()
}

/// The items of a text that [`numbered`] wrote.
pub fn read_numbered(text: &str) -> impl Iterator<Item = (u32, &str)> {
    text.lines().filter_map(|line| {
        let (number, item) = line.trim().split_once(": ")?;
        Some((number.parse().ok()?, item))
    })
}

/// The advice at the end of [`ToolText::NoMarkerMap`]: which tools make a map.
pub fn use_first(tools: &[&str]) -> String {
    let quoted: Vec<String> = tools.iter().map(|tool| format!("'{tool}'")).collect();
    match quoted.split_last() {
        None => String::new(),
        Some((last, [])) => format!(" Use {last} first."),
        Some((last, others)) => format!(" Use {} or {last} first.", others.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_text_is_read_as_what_was_written() {
        for text in ToolText::ALL {
            let said = text.outcome(&[&"table_1", &"nav_to", &"marker 1", &"2"]);
            let failure = ToolText::failure(&said.text);
            assert_eq!(
                failure.and_then(ToolText::code),
                said.error,
                "{}",
                said.text
            );
            assert!(said.text.contains(text.mark()), "{}", said.text);
            if said.is_ok() && text.template().matches("{}").count() == 1 {
                assert_eq!(text.value(&said.text), Some("table_1"));
            }
        }
    }

    #[test]
    fn a_list_is_read_as_it_was_written() {
        let items = [(0, "a(an) mug."), (1, "a(an) red: cup.")];
        let text = ToolText::Contents.text(&[&numbered(items.into_iter())]);
        assert_eq!(read_numbered(&text).collect::<Vec<_>>(), items);
        assert_eq!(use_first(&["a", "b", "c"]), " Use 'a', 'b' or 'c' first.");
        assert_eq!(use_first(&["a"]), " Use 'a' first.");
    }
}
