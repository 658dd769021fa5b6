//! A run in a few sentences, each with its evidence: the numbers in it and up to three traces that
//! show it. Counts what the tables hold; judges nothing.

use reel_query::{QuerySession, statistics::wilson};
use serde::{Deserialize, Serialize};

use super::rows;

/// Kinds of failure that get a sentence.
const KINDS_MAX: usize = 4;

/// A sentence and traces that show what it says.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub(super) struct Statement {
    pub sentence: String,
    pub traces: Vec<String>,
}

#[derive(Deserialize)]
struct Counts {
    episodes: u64,
    won: u64,
    side_effects: u64,
    failed: u64,
    measured: u64,
    repairable: u64,
    doubtful: u64,
}

#[derive(Deserialize)]
struct Kind {
    class: String,
    sub_class: String,
    cause: String,
    episodes: u64,
}

#[derive(Deserialize)]
struct Example {
    trace: String,
}

/// An object that the goal does not move was put elsewhere and not brought back.
const SIDE_EFFECT: &str = "sequence_match(steps, 'place[ok and not goal_object and put_back is not true] !place[put_back]* $')";

/// The statements about these episodes, a table expression in SQL.
pub(super) fn statements(session: &QuerySession, these: &str) -> anyhow::Result<Vec<Statement>> {
    let judged = format!(
        "{these} e LEFT JOIN classes c USING (episode_id) LEFT JOIN blame b USING (episode_id)"
    );
    let counts: Vec<Counts> = rows(
        session,
        &format!(
            "SELECT count(e.success) AS episodes, count(*) FILTER (WHERE e.success) AS won, \
             count(*) FILTER (WHERE e.success AND {SIDE_EFFECT}) AS side_effects, \
             count(*) FILTER (WHERE NOT e.success) AS failed, count(b.step) AS measured, \
             count(*) FILTER (WHERE b.repairable_at_end) AS repairable, \
             count(*) FILTER (WHERE array_length(c.conflicts) > 0) AS doubtful FROM {judged}"
        ),
    )?;
    let Some(counts) = counts.first() else {
        return Ok(Vec::new());
    };
    let examples = |condition: &str| -> anyhow::Result<Vec<String>> {
        let found: Vec<Example> = rows(
            session,
            &format!(
                "SELECT e.trace FROM {judged} WHERE {condition} ORDER BY e.length, e.episode_id LIMIT 3"
            ),
        )?;
        Ok(found.into_iter().map(|example| example.trace).collect())
    };
    let mut statements = Vec::new();
    let mut say = |sentence: String, condition: &str| -> anyhow::Result<()> {
        let traces = examples(condition)?;
        statements.push(Statement { sentence, traces });
        Ok(())
    };
    say(
        format!(
            "{} of {} episodes succeeded, {}.",
            counts.won,
            counts.episodes,
            share(counts.won, counts.episodes)
        ),
        "e.success",
    )?;
    if counts.side_effects > 0 {
        say(
            format!(
                "{} of the {} successes left an object elsewhere that the goal does not move.",
                counts.side_effects, counts.won
            ),
            &format!("e.success AND {SIDE_EFFECT}"),
        )?;
    }
    let kinds: Vec<Kind> = rows(
        session,
        &format!(
            "SELECT c.class, c.sub_class, min(c.cause) AS cause, count(*) AS episodes FROM {these} e JOIN classes c USING (episode_id) \
             WHERE NOT e.success GROUP BY 1, 2 ORDER BY 4 DESC, 1, 2 LIMIT {KINDS_MAX}"
        ),
    )?;
    for kind in &kinds {
        say(
            format!(
                "{} of the {} failures are {} ({}, a matter of {}): {}.",
                kind.episodes,
                counts.failed,
                kind.sub_class,
                kind.class,
                kind.cause,
                share(kind.episodes, counts.failed)
            ),
            &format!("NOT e.success AND c.sub_class = '{}'", kind.sub_class),
        )?;
    }
    if counts.measured > 0 {
        say(
            format!(
                "In {} of {} measured failures a competent agent could still have succeeded for sure at the last call.",
                counts.repairable, counts.measured
            ),
            "NOT e.success AND b.repairable_at_end",
        )?;
    }
    if counts.doubtful > 0 {
        say(
            format!(
                "{} explanations are in doubt: rules and measurement disagree.",
                counts.doubtful
            ),
            "array_length(c.conflicts) > 0",
        )?;
    }
    Ok(statements)
}

/// A share with Wilson's 95% interval.
fn share(count: u64, of: u64) -> String {
    let percent = |value: f64| (100.0 * value).round();
    match wilson(count as f64, of as f64) {
        None => "of none".to_owned(),
        Some((low, high)) => format!(
            "{}% [{}, {}]",
            percent(count as f64 / of as f64),
            percent(low),
            percent(high)
        ),
    }
}
