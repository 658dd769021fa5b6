//! An episode as text to read: calls, outcomes, graph changes, rewards, totals.

use std::fmt::Write as _;

use reel_trace::{Timing, Trace};
use reel_world::{
    GraphEvent, printable_lines,
    record::{Backend, EndReason, Score, StepRecord},
};

/// The whole episode, for people. Names instances and receptacles as the simulator knows them. What others wrote
/// moves no cursor: control characters are escapes.
pub fn transcript(trace: &Trace) -> String {
    let mut text = String::new();
    header(trace, &mut text);
    for record in &trace.steps {
        text.push_str(&step(record, trace.timings.get(&record.step)));
    }
    end(trace, &mut text);
    printable_lines(&text)
}

fn header(trace: &Trace, text: &mut String) {
    let (header, task) = (&trace.header, &trace.task);
    let mut line = |name: &str, value: &str| {
        let _ = writeln!(text, "{name:<12} {value}");
    };
    line("episode", &header.episode_id);
    line(
        "task",
        &format!(
            "{} ({}), scene {}",
            header.task_id, header.family, header.scene_id
        ),
    );
    line("instruction", &task.instruction);
    if task.fuzzy {
        line("precisely", &task.precise_instruction);
    }
    if task.has_goal() {
        let goal: Vec<String> = task
            .goal_changes()
            .iter()
            .map(ToString::to_string)
            .collect();
        line("goal", &goal.join("  "));
    }
    line(
        "policy",
        &format!(
            "{}, seed {}, profile {}",
            header.policy.name,
            header.seed,
            header.profile.as_str()
        ),
    );
    match header.backend.not_replayable_reason() {
        None => line(
            "recorded by",
            &format!("reel {}, simulator {}", header.build, header.sim_version),
        ),
        Some(origin) => line("recorded by", &format!("reel {}, {origin}", header.build)),
    }
    for channel in &trace.sensors {
        line("sensors", &channel.summary().to_string());
    }
    let redacted = trace.redacted();
    if !redacted.is_empty() {
        let counts: Vec<String> = redacted
            .iter()
            .map(|(rule, count)| format!("{count} {}", rule.escape_debug()))
            .collect();
        line("redacted", &counts.join(", "));
    }
}

/// One step, for people; with its clock, where one was kept.
pub fn step(record: &StepRecord, timing: Option<&Timing>) -> String {
    let mut text = String::new();
    let _ = writeln!(text, "\n{:>3}  {}", record.step, record.input.call);
    let mut line = |mark: &str, content: &str| {
        for (index, part) in content.trim_end().lines().enumerate() {
            let _ = writeln!(
                text,
                "     {:<8} {part}",
                if index == 0 { mark } else { "" }
            );
        }
    };
    if let Some(policy) = &record.input.policy {
        line("thought", &policy.reasoning);
        // An answer that spells its call is told by the line above.
        let spells_the_call = policy
            .raw
            .contains(&format!("\"{}\"", record.input.call.name));
        if !spells_the_call && policy.raw != policy.reasoning {
            line("said", &policy.raw);
        }
    }
    match record.outcome.error {
        None => line("ok", &record.outcome.text),
        Some(code) => line("ERROR", &format!("{code}: {}", record.outcome.text)),
    }
    if let Some(held) = &record.held {
        line("holds", held.as_str());
    }
    line("change", &join(&record.changes.physics));
    if record.changes.registry != record.changes.physics {
        let changes = join(&record.changes.registry);
        line(
            "registry",
            if changes.is_empty() {
                "no change"
            } else {
                &changes
            },
        );
    }
    let terms = record.reward.iter().map(|term| {
        let reason = if term.reason.is_empty() {
            String::new()
        } else {
            format!(" ({})", term.reason)
        };
        format!("{} {:+.2}{reason}", term.component, term.value)
    });
    let terms: Vec<String> = terms.collect();
    if !terms.is_empty() {
        line(
            "reward",
            &format!("{:+.2} = {}", record.reward_total(), terms.join(", ")),
        );
    }
    if let Some(timing) = timing {
        let seconds = |ns: u64| ns as f64 / 1e9;
        let thought = record
            .input
            .policy
            .as_ref()
            .and_then(|policy| policy.latency_ns);
        let thought = thought
            .map(|ns| format!(", decided in {:.3} s", seconds(ns)))
            .unwrap_or_default();
        line(
            "time",
            &format!("took {:.3} s{thought}", seconds(timing.took_ns)),
        );
    }
    text
}

fn join(events: &[GraphEvent]) -> String {
    events
        .iter()
        .map(ToString::to_string)
        .collect::<Vec<_>>()
        .join("  ")
}

fn end(trace: &Trace, text: &mut String) {
    let Some(end) = &trace.end else {
        let _ = writeln!(
            text,
            "\nthe trace breaks off after {} decisions",
            trace.steps.len()
        );
        return;
    };
    let metrics = &end.metrics;
    let reason = match end.reason {
        EndReason::Finished => "the policy finished",
        EndReason::Horizon => "the horizon was reached",
        EndReason::Fault => "a fault ended the episode",
        EndReason::Aborted => "the episode was aborted",
    };
    let verdict = match end.success(&trace.task) {
        Some(true) => "SUCCESS",
        Some(false) => "FAILURE",
        None => "NOT JUDGED",
    };
    let spl = metrics
        .spl
        .map(|spl| format!(", SPL {spl:.2}"))
        .unwrap_or_default();
    let _ = writeln!(
        text,
        "\n{verdict}: {reason} after {} decisions, {} asks{spl}",
        metrics.length, metrics.asks
    );
    for score in &end.reported.scores {
        let _ = writeln!(text, "{}", score_line(score));
    }
    if !trace.task.has_goal() {
        return;
    }
    let _ = writeln!(
        text,
        "{:.0}% of the goal done, reward {:+.2} (discounted {:+.2}){}",
        100.0 * metrics.completion,
        metrics.total_reward,
        metrics.discounted_return,
        driven(trace),
    );
    let mut components: Vec<(&str, f64)> = Vec::new();
    for term in trace.steps.iter().flat_map(|step| &step.reward) {
        match components
            .iter_mut()
            .find(|(name, _)| *name == term.component)
        {
            Some((_, sum)) => *sum += term.value,
            None => components.push((&term.component, term.value)),
        }
    }
    let sums: Vec<String> = components
        .iter()
        .map(|(name, sum)| format!("{name} {sum:+.2}"))
        .collect();
    let _ = writeln!(text, "{}", sums.join(", "));
}

/// A score that was told where the episode ran.
fn score_line(score: &Score) -> String {
    let value = score.value.map(|value| value.to_string());
    let mut line = format!("score {}:", score.name);
    for part in [&value, &score.label, &score.explanation]
        .into_iter()
        .flatten()
    {
        line.push(' ');
        line.push_str(part);
    }
    line
}

/// How far the base drove; only our simulator and robots know.
fn driven(trace: &Trace) -> String {
    match trace.header.backend {
        Backend::Proxy | Backend::Imported => String::new(),
        _ => format!(
            ", {:.1} m driven",
            trace
                .steps
                .last()
                .map_or(0.0, |step| step.robot.path_length_m)
        ),
    }
}
