//! What rows tell of an episode in their texts: receptacles, calls, outcomes. As deeds
//! for the History validator.
//!
//! Reads the single-turn prompts of Reel, today's and former ones, and the tools' texts of
//! docs/spec.md#published-texts; an outcome in other words is unknown, never guessed.

use reel_history::{EpisodeFacts, MarkerFacts, ReceptacleFacts, StepFacts};
use reel_world::{DoorState, ErrorCode, GraphEvent, ToolCall, ToolSpec, ToolText};
use serde_json::Value;

use crate::lint::Call;

/// The part of a prompt after a title, up to the end of the line.
pub(super) fn line_after<'t>(prompt: &'t str, title: &str) -> Option<&'t str> {
    let at = prompt.find(title)? + title.len();
    prompt[at..].lines().next().map(str::trim)
}

/// The setting that a prompt tells: `Task: ..`, and lines `1) In room: id, id.` or
/// `- id (category, room)`.
pub(super) fn setting(prompt: &str) -> EpisodeFacts {
    let place = |line: &str| {
        let (id, rest) = line.strip_prefix("- ")?.split_once(" (")?;
        let (category, room) = rest.strip_suffix(')')?.split_once(", ")?;
        Some(ReceptacleFacts {
            id: id.into(),
            category: category.into(),
            room: room.into(),
            captions: Vec::new(),
            door: None,
        })
    };
    let instruction = line_after(prompt, "Task: ").unwrap_or_default().to_owned();
    let room = |line: &str| {
        let (number, rest) = line.split_once(") In ")?;
        let (room, ids) = rest.strip_suffix('.')?.split_once(": ")?;
        number.parse::<u32>().ok()?;
        Some((room.to_owned(), ids.to_owned()))
    };
    let of_room = |(room, ids): (String, String)| {
        let place = |id: &str| ReceptacleFacts {
            id: id.into(),
            category: id
                .trim_end_matches(|c: char| c.is_ascii_digit())
                .trim_end_matches('_')
                .replace('_', " "),
            room: room.clone(),
            captions: Vec::new(),
            door: None,
        };
        ids.split(", ").map(place).collect::<Vec<_>>()
    };
    let places = prompt
        .lines()
        .filter_map(place)
        .chain(prompt.lines().filter_map(room).flat_map(of_room));
    EpisodeFacts {
        places: places.collect(),
        things: Vec::new(),
        instruction,
        complete: false,
    }
}

/// The last action and its outcome as a prompt tells them; `None` in the first decision.
///
/// # Errors
/// Where the prompt has no such lines or the action does not read.
pub(super) fn last(prompt: &str) -> Result<Option<(Call, String)>, ()> {
    let action = line_after(prompt, "Last action: ").ok_or(())?;
    if action.eq_ignore_ascii_case("none") || action == "{}" {
        return Ok(None);
    }
    let call = serde_json::from_str::<Value>(action)
        .ok()
        .as_ref()
        .and_then(Call::of_value)
        .ok_or(())?;
    let former = prompt
        .rsplit_once("Last outcome: ")
        .map(|(_, told)| told.split("\nCurrent view:").next().unwrap_or_default());
    let today = || {
        prompt
            .rsplit_once("Last observation: ")
            .and_then(|(_, told)| Some(told.split_once("Result: ")?.1))
    };
    let outcome = former.or_else(today).ok_or(())?;
    Ok(Some((call, outcome.trim_end().to_owned())))
}

/// Makes deeds of calls and the texts of their outcomes, in order.
#[derive(Default)]
pub(super) struct StepFactsBuilder {
    step: u32,
    holding: bool,
    markers: Vec<MarkerFacts>,
}

impl StepFactsBuilder {
    /// The next deed; `None` if the text does not tell whether the call succeeded: the deeds after
    /// it are not to be trusted.
    pub(super) fn deed(&mut self, call: &Call, outcome: &str) -> Option<StepFacts> {
        let mut deed = StepFacts::from_call(
            self.step,
            &ToolCall::new(call.name.clone(), call.arguments.clone()),
            outcome,
        );
        self.step += 1;
        let tool = ToolSpec::by_name(&call.name).map(|spec| spec.paper_name);
        match tool {
            // What a user answers may have the words of a failure.
            _ if deed.error.is_some() && tool != Some("ask") => {}
            None => deed.error = Some(ErrorCode::UnknownTool.as_str().to_owned()),
            Some(tool) => {
                let succeeded = |text: ToolText| text.begins(outcome.trim_start());
                if !outcome.is_empty() && !ToolText::success(tool).is_none_or(succeeded) {
                    return None;
                }
                self.done(tool, outcome, &mut deed);
            }
        }
        deed.held = self.holding.then(|| HELD.to_owned());
        deed.markers.clone_from(&self.markers);
        Some(deed)
    }

    fn done(&mut self, tool: &str, outcome: &str, deed: &mut StepFacts) {
        match tool {
            "nav_to" => {
                deed.receptacle.clone_from(&deed.argument);
                self.markers.clear();
            }
            "show_receptacles" | "walk_around" => self.markers.clone_from(&deed.markers),
            "show_object_by_category" => self.markers.clear(),
            "pick" => self.holding = true,
            "place" => self.holding = false,
            "open" | "close" => {
                let (to, from) = if tool == "open" {
                    (DoorState::Open, DoorState::Closed)
                } else {
                    (DoorState::Closed, DoorState::Open)
                };
                let change = |id: &String| GraphEvent::Door {
                    receptacle: id.as_str().into(),
                    from,
                    to,
                };
                deed.changes.extend(deed.receptacle.as_ref().map(change));
            }
            "ask" => deed.reply = Some(outcome.to_owned()),
            _ => {}
        }
    }
}

/// What the hand holds, of which rows tell no more.
const HELD: &str = "held";
