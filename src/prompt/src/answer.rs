//! The one form of an answer that all of REAL's published parsers read: `<think>...</think>` and a
//! bare JSON object with the keys `summary` and `next action`, nothing after it. And the History in
//! it, as the lines that the trainer's memory takes.

use serde_json::{Value, json};

use crate::{conversation::thought, published::published_call, python};

/// Longest outcome in a line that stands for a sentence of the History, in characters.
const OUTCOME_CHARS_MAX: usize = 120;

/// The line of a History before the first call.
const NOTHING_YET: &str = "I have not done anything yet.";

/// The line of a History that a decision added nothing to.
const NOTHING_NEW: &str = "I noted nothing new.";

/// What a model says at a decision.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct DecisionAnswer<'a> {
    /// Why; empty if nobody said.
    pub reasoning: &'a str,
    /// `History`, as [`HistoryLines`] numbers it.
    pub history: &'a str,
    /// `New Schedule`: what is left to do.
    pub schedule: &'a str,
    /// `Current subtask`: what is done now.
    pub subtask: &'a str,
    /// The tool, by any of its names.
    pub tool_name: &'a str,
    /// Its arguments; null for none.
    pub arguments: Option<&'a Value>,
}

impl DecisionAnswer<'_> {
    /// The text. The tool goes by its published name and marker ids are strings,
    /// whatever the call said.
    pub fn text(&self) -> String {
        let object = json!({
            "summary": { "History": self.history, "New Schedule": self.schedule, "Current subtask": self.subtask },
            "next action": action(self.tool_name, self.arguments.unwrap_or(&Value::Null)),
        });
        format!("{}{object}", thought(self.reasoning))
    }
}

/// A call as the published clients are shown it: `{"tool_name": .., "args": {..}}`.
pub fn action(tool_name: &str, arguments: &Value) -> Value {
    let (tool_name, arguments) = published_call(tool_name, arguments);
    json!({ "tool_name": tool_name, "args": arguments })
}

/// A call and what came of it in one line, where nobody wrote a History.
pub fn log_line(tool_name: &str, arguments: &Value, outcome: &str) -> String {
    let outcome = one_line(outcome);
    format!(
        "{}: {}",
        action(tool_name, arguments),
        python::prefix(&outcome, OUTCOME_CHARS_MAX)
    )
}

/// What stands in a History where a decision told nothing new
/// ([`MemoryOptions::call_log`](crate::MemoryOptions)).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum CallLog<'a> {
    /// No line of Reel's.
    Off,
    /// The [`log_line`] of the call before; `None` at the first decision.
    Last(Option<&'a str>),
}

/// The Histories of an episode as numbered lines, one more at every decision. Annotators and models
/// tell what was done in prose that grows; REAL's trainer remembers the last line of each answer
/// and drops the rest.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct HistoryLines {
    lines: Vec<String>,
    before: String,
}

impl HistoryLines {
    /// The History of the next decision. `told` is its whole History in prose, empty if nobody
    /// wrote one. With a log of calls, the [`log_line`] of the call before (`None` at the first
    /// decision) stands where there is nothing new; without one, a History that nobody wrote is
    /// empty. A History that is numbered already stays as it is.
    pub fn next(&mut self, told: &str, log: CallLog<'_>) -> String {
        if let Some(lines) = numbered(told) {
            self.lines = lines;
            self.before.clear();
            return told.to_owned();
        }
        let new =
            one_line(told[shared_sentences(&self.before, told)..].trim_start_matches(is_break));
        self.before = told.to_owned();
        let line = match (log, new.is_empty()) {
            (_, false) => new,
            (CallLog::Off, true) if told.trim().is_empty() => return String::new(),
            (CallLog::Off, true) => NOTHING_NEW.to_owned(),
            (CallLog::Last(last), true) => last.unwrap_or(NOTHING_YET).to_owned(),
        };
        self.lines.push(format!("{}) {line}", self.lines.len()));
        self.lines.join("\n")
    }
}

/// The lines of a History of which every one begins with a number, as in `0) I went to the table.`
fn numbered(history: &str) -> Option<Vec<String>> {
    let is_numbered = |line: &str| {
        let rest = line.trim_start_matches(|c: char| c.is_ascii_digit());
        rest.len() < line.len()
            && rest
                .strip_prefix(')')
                .is_some_and(|rest| !rest.trim().is_empty())
    };
    let lines: Vec<String> = history
        .trim()
        .lines()
        .map(|line| line.trim().to_owned())
        .collect();
    (!lines.is_empty() && lines.iter().all(|line| is_numbered(line))).then_some(lines)
}

/// What stands between two clauses, as in `I saw 2 mugs; I picked one`.
fn is_break(c: char) -> bool {
    c == ';' || c.is_ascii_whitespace()
}

/// Where the sentences and clauses end with which both texts begin, in bytes.
fn shared_sentences(one: &str, other: &str) -> usize {
    let common = one
        .bytes()
        .zip(other.bytes())
        .take_while(|(one, other)| one == other)
        .count();
    if common == one.len()
        && other
            .as_bytes()
            .get(common)
            .is_none_or(|byte| is_break(char::from(*byte)))
    {
        return common;
    }
    let end = |(at, c): (usize, char)| matches!(c, '.' | '!' | '?' | ';').then_some(at + 1);
    let ends = other
        .char_indices()
        .filter_map(end)
        .take_while(|end| *end < common);
    ends.filter(|end| other.as_bytes()[*end].is_ascii_whitespace())
        .last()
        .unwrap_or(0)
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::published::{agent_answer, gym_answer, scheduler_action, trainer_action};

    #[test]
    fn all_published_parsers_read_it() {
        let arguments = json!({ "marker_id": 2 });
        let answer = DecisionAnswer {
            reasoning: "It is {red}.",
            history: "0) I went.\n1) I \"looked\".",
            schedule: "1. pick; 2. place",
            subtask: "pick it",
            tool_name: "gaze_at",
            arguments: Some(&arguments),
        };
        let text = answer.text();
        let action = json!({ "tool_name": "focus_on", "args": { "marker_id": "2" } });
        let agent = agent_answer(&text).unwrap();
        assert_eq!(
            (agent.tool_name.as_str(), agent.summary["History"].as_str()),
            ("focus_on", Some(answer.history))
        );
        assert_eq!(Value::from(agent.arguments), action["args"]);
        assert_eq!(trainer_action(&text).unwrap().tool_name, "focus_on");
        let gym = gym_answer(&text);
        assert_eq!(
            (
                gym.last_action.as_ref(),
                &gym.task_progress.unwrap()["Current subtask"]
            ),
            (Some(&action), &json!("pick it"))
        );
        assert_eq!(
            scheduler_action(&text),
            Some((Some(answer.history.to_owned()), Some(action)))
        );
    }

    #[test]
    fn a_history_in_prose_becomes_lines() {
        let mut lines = HistoryLines::default();
        assert_eq!(
            lines.next("Nothing was done.", CallLog::Last(None)),
            "0) Nothing was done."
        );
        assert_eq!(
            lines.next("I went to table_1.", CallLog::Last(Some("log"))),
            "0) Nothing was done.\n1) I went to table_1."
        );
        let next = lines.next(
            "I went to table_1. I saw 2 cups: red\nand blue.",
            CallLog::Last(Some("log")),
        );
        assert_eq!(next.lines().last(), Some("2) I saw 2 cups: red and blue."));
        // A sentence was taken back, one is new; then nothing is.
        let next = lines.next(
            "I went to table_1. I picked one.",
            CallLog::Last(Some("log")),
        );
        assert_eq!(next.lines().last(), Some("3) I picked one."));
        assert_eq!(
            lines
                .next(
                    "I went to table_1. I picked one.",
                    CallLog::Last(Some("log"))
                )
                .lines()
                .last(),
            Some("4) log")
        );
        assert_eq!(
            lines.next("", CallLog::Last(Some("log"))).lines().last(),
            Some("5) log")
        );
    }

    #[test]
    fn without_a_log_a_history_is_what_its_author_wrote() {
        let mut lines = HistoryLines::default();
        assert_eq!(lines.next("", CallLog::Off), "");
        assert_eq!(lines.next("I saw a cup.", CallLog::Off), "0) I saw a cup.");
        assert_eq!(
            lines.next("I saw a cup.", CallLog::Off),
            "0) I saw a cup.\n1) I noted nothing new."
        );
    }

    #[test]
    fn clauses_between_semicolons_become_lines() {
        let mut lines = HistoryLines::default();
        lines.next("saw 2 mugs", CallLog::Last(None));
        let next = lines.next("saw 2 mugs; took one; went on", CallLog::Last(Some("log")));
        assert_eq!(next.lines().last(), Some("1) took one; went on"));
        let next = lines.next(
            "saw 2 mugs; took one; put it down",
            CallLog::Last(Some("log")),
        );
        assert_eq!(next.lines().last(), Some("2) put it down"));
        assert_eq!(
            lines
                .next(
                    "saw 2 mugs; took one; put it down",
                    CallLog::Last(Some("log"))
                )
                .lines()
                .last(),
            Some("3) log")
        );
    }

    #[test]
    fn a_numbered_history_stays_as_it_is() {
        let mut lines = HistoryLines::default();
        assert_eq!(lines.next("0) a\n1) b", CallLog::Last(None)), "0) a\n1) b");
        assert_eq!(
            lines.next("", CallLog::Last(Some("log"))),
            "0) a\n1) b\n2) log"
        );
        assert_eq!(
            HistoryLines::default().next("", CallLog::Last(None)),
            "0) I have not done anything yet."
        );
    }
}
