//! What the trainer reads from the texts of results: the observation, listed errors, the marker
//! that an answer names.

use std::sync::LazyLock;

use aho_corasick::AhoCorasick;
use serde_json::Value;

/// Texts that cost, severe ones first; the first of the list that occurs counts.
const LISTED: [&str; 13] = reel_world::words! {
    "[[internal error]]" "error executing" traceback "no object in the inventory"
    "cannot place object into a closed" "not found in the marker map"
    "cannot find a non-occluded position" "not found in the scene" "not implemented yet"
    "not recognized" "not aligned to bread target" "selected marker_id" "hand is empty"
};

/// How many of them are severe.
const SEVERE: u8 = 5;

/// Stands for an image of a result in the text of its observation.
const IMAGE: &str = "[Image received]";

/// What the texts of results that are no observation begin with.
const DEBUG_INFO: &str = "Debug Info:";

/// A listed text that occurs in an observation.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct TextError(u8);

impl TextError {
    /// The first of the listed texts that occurs, whatever its case.
    pub fn find(observation: &str) -> Option<Self> {
        static TEXTS: LazyLock<AhoCorasick> = LazyLock::new(|| {
            let builder = AhoCorasick::builder()
                .ascii_case_insensitive(true)
                .build(LISTED);
            builder.expect("thirteen short texts make an automaton")
        });
        TEXTS
            .find_overlapping_iter(observation)
            .map(|found| Self(found.pattern().as_u32() as u8))
            .min_by_key(|error| error.0)
    }

    /// Whether it costs as much as an invalid call.
    pub fn is_severe(self) -> bool {
        self.0 < SEVERE
    }

    /// The listed text that was found in the observation, in lower case.
    pub fn pattern(self) -> &'static str {
        LISTED[usize::from(self.0)]
    }
}

/// A call that the state of the hand forbids, as the trainer counts it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum HandViolation {
    /// `pick` while the hand counts as occupied.
    Pick,
    /// `place` while it counts as empty.
    Place,
    /// `open` while it counts as occupied.
    Open,
    /// `close` while it counts as occupied.
    Close,
}

impl HandViolation {
    /// The kind of error as the published trainer writes it in its log.
    pub fn as_str(self) -> &'static str {
        match self {
            HandViolation::Pick => "pick_while_hand_occupied",
            HandViolation::Place => "place_while_hand_empty",
            HandViolation::Open => "open_while_hand_occupied",
            HandViolation::Close => "close_while_hand_occupied",
        }
    }
}

/// Whether a text of a result is left out of the observation.
pub fn is_dropped(text: &str) -> bool {
    text.starts_with('{') || text.starts_with(DEBUG_INFO)
}

/// The observation that the trainer makes of the items of a result, one a line: all items but the
/// last, which is the debug information; an only item counts.
pub fn observation(content: &[Value]) -> String {
    let shown = if content.len() > 1 {
        &content[..content.len() - 1]
    } else {
        content
    };
    let mut lines = String::new();
    for item in shown {
        let line = match item["type"].as_str() {
            Some("image") => IMAGE,
            _ => item["text"]
                .as_str()
                .map(str::trim)
                .filter(|text| !is_dropped(text))
                .unwrap_or_default(),
        };
        if !line.is_empty() {
            lines.push_str(line);
            lines.push('\n');
        }
    }
    lines
}

/// Whether a failed reset says that the scene does not have the task, so that the trainer
/// goes to another server.
pub fn is_not_found(observation: &str, instruction: Option<&str>) -> bool {
    let says_so = |text: &str| text.to_lowercase().contains("not found");
    says_so(observation) || instruction.is_some_and(says_so)
}

/// The marker that an answer names: the longest of the known ones that occurs in it (the
/// first of equally long ones); where none is known, the word that follows `marker` and
/// one blank or underscore.
pub fn marker_in_answer(answer: &str, known: &[impl AsRef<str>]) -> Option<String> {
    if known.is_empty() {
        return after_marker(answer).map(str::to_owned);
    }
    let named = known
        .iter()
        .map(AsRef::as_ref)
        .filter(|marker| answer.contains(marker));
    named
        .min_by_key(|marker| usize::MAX - marker.len())
        .map(str::to_owned)
}

fn after_marker(answer: &str) -> Option<&str> {
    const WORD: &str = "marker";
    let is_letter = |letter: char| letter == '_' || letter.is_alphanumeric();
    let rests = answer.char_indices().filter_map(|(at, _)| {
        let (word, rest) = answer[at..].split_at_checked(WORD.len())?;
        word.eq_ignore_ascii_case(WORD).then_some(rest)
    });
    rests
        .filter_map(|rest| {
            rest.strip_prefix(|letter: char| letter == '_' || letter.is_whitespace())
        })
        .find(|rest| rest.starts_with(is_letter))
        .and_then(|rest| rest.split(|letter| !is_letter(letter)).next())
}
