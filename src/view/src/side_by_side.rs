//! Two episodes side by side as text to read, from the first difference on.

use std::fmt::Write as _;

use reel_replay::{CallPair, CallSummary, Comparison, EpisodeSummary};

use crate::canvas::wrap;

/// Characters of a column.
const COLUMN: usize = 58;
/// Most lines that one call takes besides itself.
const LINES_MAX: usize = 3;

/// Two columns: the calls, what they came to, what they changed and their reward, then
/// how each episode ended.
pub fn side_by_side(beside: &Comparison) -> String {
    let mut text = String::new();
    for (name, episode) in ["A", "B"].into_iter().zip(&beside.episodes) {
        let _ = writeln!(text, "{name}  {}", title(episode, beside));
    }
    let _ = writeln!(text, "task {}", beside.episodes[0].task_id);
    if !beside.inputs.is_empty() {
        let _ = writeln!(text, "other inputs: {}", beside.inputs.join(", "));
    }
    let same = beside.same_calls;
    let _ = match (beside.same_start, same, beside.rows.is_empty()) {
        (false, ..) => writeln!(text, "the worlds differ before the first call"),
        (true, _, true) => writeln!(text, "the same {same} calls, and all that came of them"),
        (true, 0, false) => writeln!(text, "they differ from the first call on"),
        (true, 1, false) => writeln!(text, "call 0 is the same"),
        (true, same, false) => writeln!(text, "calls 0 to {} are the same", same - 1),
    };
    if !beside.rows.is_empty() {
        let _ = writeln!(text);
        line(&mut text, ("A", "reward"), " ", ("B", "reward"));
    }
    for row in &beside.rows {
        write_row(&mut text, row);
    }
    let _ = writeln!(text);
    for ((name, end), reward) in ["A", "B"].into_iter().zip(&beside.ends).zip(beside.reward) {
        let _ = match end {
            Some(end) => writeln!(text, "{name}  {end}"),
            None => writeln!(text, "{name}  broken off, total reward {reward:.3}"),
        };
    }
    if !beside.graph.is_empty() {
        let events: Vec<String> = beside.graph.iter().map(ToString::to_string).collect();
        let _ = writeln!(
            text,
            "the world of B in the end, beside that of A:\n  {}",
            events.join("\n  ")
        );
    }
    text
}

fn title(episode: &EpisodeSummary, beside: &Comparison) -> String {
    let file = episode
        .trace
        .file_name()
        .map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let lineage = episode.parent.as_ref().map_or_else(String::new, |parent| {
        let of = ["A", "B"]
            .into_iter()
            .zip(&beside.episodes)
            .find(|(_, other)| other.chain == parent.trace);
        let whom = of.map_or_else(
            || format!("trace {}", &parent.trace.to_string()[..12]),
            |(name, _)| name.to_owned(),
        );
        format!(", branches from {whom} at call {}", parent.call)
    });
    format!(
        "{file}  ({}, seed {}{lineage})",
        episode.policy, episode.seed
    )
}

/// `=` where all is the same, `~` where the same call came to something else, `|`
/// where the calls differ.
fn write_row(text: &mut String, row: &CallPair) {
    let mark = match (row.same_call, row.same_outcome) {
        (true, true) => "=",
        (true, false) => "~",
        (false, _) => "|",
    };
    let [a, b] = [&row.a, &row.b].map(|deed| {
        deed.as_ref()
            .map_or_else(Vec::new, |deed| column(deed, row.same_outcome))
    });
    for index in 0..a.len().max(b.len()) {
        let part = |lines: &[(String, String)]| lines.get(index).cloned().unwrap_or_default();
        let ([a_left, a_right], [b_left, b_right]) =
            (<[String; 2]>::from(part(&a)), <[String; 2]>::from(part(&b)));
        line(
            text,
            (&a_left, &a_right),
            if index == 0 { mark } else { " " },
            (&b_left, &b_right),
        );
    }
}

/// The lines of one call: left and right-aligned text.
fn column(deed: &CallSummary, short: bool) -> Vec<(String, String)> {
    let reward = if deed.reward == 0.0 {
        String::new()
    } else {
        format!("{:+.2}", deed.reward)
    };
    let mut what = wrap(&deed.call_text, COLUMN - 12, 2).into_iter();
    let mut lines = vec![(
        format!("{:>3}  {}", deed.call, what.next().unwrap_or_default()),
        reward,
    )];
    lines.extend(what.map(|line| (format!("     {line}"), String::new())));
    if short {
        return lines;
    }
    let told = match deed.error {
        Some(code) => format!("ERROR {code}: {}", deed.text),
        None => deed.text.clone(),
    };
    let changes = deed.changes.iter().map(|event| event.to_string());
    let told = wrap(&told, COLUMN - 5, 2)
        .into_iter()
        .chain(changes.flat_map(|event| wrap(&event, COLUMN - 5, 2)));
    lines.extend(
        told.take(LINES_MAX + deed.changes.len())
            .map(|line| (format!("     {line}"), String::new())),
    );
    lines
}

fn line(text: &mut String, a: (&str, &str), mark: &str, b: (&str, &str)) {
    let fit = |(left, right): (&str, &str)| {
        let space = COLUMN.saturating_sub(left.chars().count());
        format!("{left}{right:>space$}")
    };
    let whole = format!("{} {mark} {}", fit(a), fit(b));
    let _ = writeln!(text, "{}", whole.trim_end());
}
