//! Claims: a sentence about episodes, and the condition that decides for each of them whether it is
//! so. Says how many, with interval, in all and run by run. Stores nothing.

use std::collections::BTreeMap;

use reel_counterfactual::attribution::{Interval, clustered_interval};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use datafusion::sql::sqlparser::{dialect::GenericDialect, parser::Parser, tokenizer::Token};

/// Which episodes a sentence is about, and which of them bear it out.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Claim {
    /// Condition in SQL: the episodes that count; without it all that were played to an end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub of: Option<String>,
    /// Condition in SQL: those of them that bear the sentence out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub holds: Option<String>,
    /// Instead of `holds` a call pattern: those whose steps match it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pattern: Option<String>,
    /// Share that is promised at least, from 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_least: Option<f64>,
    /// Share that is promised at most, from 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_most: Option<f64>,
}

/// Whether a promise is kept, as far as the interval can tell.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ClaimVerdict {
    /// The whole interval lies within the promised shares.
    Holds,
    /// The interval lies on both sides of a promised share.
    Open,
    /// The whole interval lies outside the promised shares.
    Fails,
}

/// How many of the counted episodes bear a claim out.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Tally {
    /// How many episodes the condition `of` lets count.
    pub episodes: usize,
    /// How many distinct tasks these episodes play: the clusters of the interval.
    pub tasks: usize,
    /// Those of the episodes that bear it out.
    pub holding: usize,
    /// Their share; none where nothing counts.
    pub share: Option<f64>,
    /// Lower bound of the share at 95 %, with tasks as clusters.
    pub low: Option<f64>,
    /// Upper bound of the share at 95 %.
    pub high: Option<f64>,
    /// Whether the promise is kept; none without a promise or without episodes.
    pub verdict: Option<ClaimVerdict>,
}

/// A claim in one run.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct RunTally {
    /// Id of the run; none for episodes that name none.
    pub run_id: Option<String>,
    /// Modification time of the run's oldest trace file, in milliseconds since 1970.
    pub began_ms: Option<i64>,
    /// The counts of this run.
    #[serde(flatten)]
    pub tally: Tally,
}

/// An episode that shows what a claim means, or contradicts it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct ClaimExample {
    /// Id of the episode, as table `episodes` has it.
    pub episode_id: String,
    /// Where its trace lies; in answers of the service the name of the trace.
    pub trace: Option<String>,
    /// Id of the task that the episode plays.
    pub task_id: Option<String>,
    /// Name of the policy that decided in it.
    pub policy: Option<String>,
    /// Whether the goal held at the end.
    pub success: Option<bool>,
    /// Decisive step, where blame or a rule named one.
    pub step: Option<i64>,
}

/// Since when the verdict is what it is in the newest run that holds or fails.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Change {
    /// First run of those with that verdict.
    pub run_id: Option<String>,
    /// The verdict in the run before it.
    pub before: ClaimVerdict,
}

/// What a store says of a claim.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct ClaimReport {
    /// The counts over the episodes of all runs together.
    #[serde(flatten)]
    pub all: Tally,
    /// Counts run by run, in the order in which runs began.
    pub runs: Vec<RunTally>,
    /// Since when it is as it is in the newest run, where it was otherwise before.
    pub changed: Option<Change>,
    /// Episodes that bear it out, of different tasks where there are some.
    pub examples: Vec<ClaimExample>,
    /// Episodes that count and do not.
    pub counter_examples: Vec<ClaimExample>,
    /// Failed episodes of the store without a class, where a condition reads classes.
    pub unclassified: usize,
    /// Failed episodes of the store without blame, where a condition reads causes or decisive steps.
    pub unblamed: usize,
}

/// How many examples, and how many counter-examples, a report shows at most.
const EXAMPLES: usize = 3;
/// Deepest nesting of a condition.
const DEPTH_MAX: usize = 50;
/// Most runs that are told apart: the newest.
const RUNS: usize = 200;

/// What rows say of a run.
#[derive(Default)]
struct RunCounts {
    began_ms: Option<i64>,
    /// Hits and trials of each task.
    tasks: Vec<(usize, usize)>,
}

/// A row of the answer to [`Claim::question`].
#[derive(Deserialize)]
struct Row {
    part: String,
    run_id: Option<String>,
    began_ms: Option<i64>,
    hits: usize,
    trials: usize,
    tasks: usize,
    episode_id: Option<String>,
    trace: Option<String>,
    task_id: Option<String>,
    policy: Option<String>,
    success: Option<bool>,
    step: Option<i64>,
}

/// Checks that a text is one expression in SQL, and not a part of something larger.
fn parse_condition(text: &str) -> Result<(), String> {
    let mut parser = Parser::new(&GenericDialect {})
        .with_recursion_limit(DEPTH_MAX)
        .try_with_sql(text)
        .map_err(|error| error.to_string())?;
    parser.parse_expr().map_err(|error| error.to_string())?;
    match parser.peek_token().token {
        Token::EOF => Ok(()),
        token => Err(format!("'{token}' is too much")),
    }
}

impl Claim {
    /// Checks what can be told without a store.
    ///
    /// # Errors
    /// In words: what is missing or wrong.
    pub fn check(&self) -> Result<(), String> {
        let blank = |text: &Option<String>| text.as_ref().is_some_and(|it| it.trim().is_empty());
        match (&self.holds, &self.pattern) {
            (Some(_), Some(_)) => return Err("has `holds` or `pattern`, not both".to_owned()),
            (None, None) => {
                return Err(
                    "says by `holds`, a condition in SQL, or by `pattern`, a call pattern, which episodes bear it out"
                        .to_owned(),
                );
            }
            _ => {}
        }
        for (name, text) in [
            ("of", &self.of),
            ("holds", &self.holds),
            ("pattern", &self.pattern),
        ] {
            if blank(text) {
                return Err(format!("has an empty `{name}`"));
            }
        }
        for (name, text) in [("of", &self.of), ("holds", &self.holds)] {
            if let Some(text) = text {
                parse_condition(text)
                    .map_err(|problem| format!("has no condition in `{name}`: {problem}"))?;
            }
        }
        for (name, share) in [("at_least", self.at_least), ("at_most", self.at_most)] {
            if share.is_some_and(|share| !(0.0..=1.0).contains(&share)) {
                return Err(format!("has no share from 0 to 1 in `{name}`"));
            }
        }
        if let (Some(least), Some(most)) = (self.at_least, self.at_most)
            && least > most
        {
            return Err(format!("promises at least {least} and at most {most}"));
        }
        if let Some(pattern) = &self.pattern {
            crate::pattern::Pattern::parse(pattern)
                .map_err(|error| format!("has no pattern in `pattern`: {error}"))?;
        }
        Ok(())
    }

    /// The same claim about the episodes of one run.
    #[must_use]
    pub fn in_run(&self, run_id: &str) -> Self {
        let run = format!("run_id = '{}'", run_id.replace('\'', "''"));
        let of = match &self.of {
            Some(condition) => format!("({condition}\n) AND {run}"),
            None => run,
        };
        Self {
            of: Some(of),
            ..self.clone()
        }
    }

    /// The question in SQL whose rows [`ClaimReport::of`] reads. Conditions see the columns of
    /// `episodes`, and class, sub_class, rule, cause and decisive_step. Branches do not count, nor do
    /// episodes that were broken off.
    pub fn question(&self) -> String {
        // A line break ends a comment in what somebody wrote.
        let counted = match &self.of {
            Some(condition) => format!("coalesce(({condition}\n), false)"),
            None => "true".to_owned(),
        };
        let holds = match (&self.holds, &self.pattern) {
            (Some(condition), _) => format!("({condition}\n)"),
            (None, pattern) => {
                let pattern = pattern.as_deref().unwrap_or_default().replace('\'', "''");
                format!("sequence_match(steps, '{pattern}')")
            }
        };
        format!(
            "WITH episode AS (
  SELECT e.*, CASE WHEN e.success THEN NULL ELSE coalesce(c.class, 'not classified') END AS class, c.sub_class, c.rule, b.cause,
    coalesce(b.step, c.step) AS decisive_step, b.trace_digest AS blamed
  FROM episodes e
  LEFT JOIN classes c ON c.trace_digest = e.trace_digest
  LEFT JOIN blame b ON b.trace_digest = e.trace_digest
  WHERE e.end_reason <> 'aborted' AND e.parent_trace IS NULL
),
judged AS (
  SELECT episode_id, trace, task_id, coalesce(task_id, episode_id) AS task, policy, run_id, success, decisive_step,
    trace_modified_ns AS written_ns, coalesce({holds}, false) AS holds
  FROM episode WHERE {counted}
),
counts AS (
  SELECT grouping(run_id) AS whole, run_id, task, count(*) AS trials, count(*) FILTER (WHERE holds) AS hits, min(written_ns) AS began_ns
  FROM judged GROUP BY GROUPING SETS ((run_id, task), (task))
),
shown AS (
  SELECT *, row_number() OVER (PARTITION BY holds ORDER BY nth_of_task, success, episode_id) AS place FROM (
    SELECT *, row_number() OVER (PARTITION BY holds, task ORDER BY written_ns DESC, episode_id) AS nth_of_task FROM judged
  )
)
SELECT CASE WHEN whole = 1 THEN 'all' ELSE 'run' END AS part, run_id, min(began_ns) / 1000000 AS began_ms, hits, trials,
  count(*) AS tasks, CAST(NULL AS VARCHAR) AS episode_id, CAST(NULL AS VARCHAR) AS trace, CAST(NULL AS VARCHAR) AS task_id,
  CAST(NULL AS VARCHAR) AS policy, CAST(NULL AS BOOLEAN) AS success, CAST(NULL AS BIGINT) AS step, 0 AS place
FROM counts GROUP BY whole, run_id, hits, trials
UNION ALL
SELECT CASE WHEN holds THEN 'example' ELSE 'counter_example' END, run_id, NULL, 0, 0, 0, episode_id, trace, task_id, policy, success,
  decisive_step, place
FROM shown WHERE place <= {EXAMPLES}
UNION ALL
SELECT part, NULL, NULL, episodes, 0, 0, NULL, NULL, NULL, NULL, NULL, NULL, 0 FROM (
  SELECT 'unclassified' AS part, count(*) AS episodes FROM episode WHERE class = 'not classified'
  UNION ALL SELECT 'unblamed', count(*) FROM episode WHERE NOT success AND blamed IS NULL
)
ORDER BY part, place, hits, trials"
        )
    }

    /// Whether a condition names one of these columns.
    fn reads(&self, columns: &[&str]) -> bool {
        let conditions = [&self.of, &self.holds];
        let mut words = conditions
            .into_iter()
            .flatten()
            .flat_map(|text| text.split(|c: char| !(c.is_alphanumeric() || c == '_')));
        words.any(|word| {
            columns
                .iter()
                .any(|column| word.eq_ignore_ascii_case(column))
        })
    }

    fn verdict(&self, interval: Interval) -> Option<ClaimVerdict> {
        let (least, most) = (self.at_least, self.at_most);
        if least.is_none() && most.is_none() {
            return None;
        }
        let (least, most) = (least.unwrap_or(0.0), most.unwrap_or(1.0));
        Some(if interval.high < least || interval.low > most {
            ClaimVerdict::Fails
        } else if interval.low >= least && interval.high <= most {
            ClaimVerdict::Holds
        } else {
            ClaimVerdict::Open
        })
    }

    /// Counts over tasks of `(hits, trials)`.
    fn tally(&self, tasks: &[(usize, usize)]) -> Tally {
        let interval = clustered_interval(tasks, 0.0);
        Tally {
            episodes: tasks.iter().map(|(_, trials)| trials).sum(),
            tasks: tasks.len(),
            holding: tasks.iter().map(|(hits, _)| hits).sum(),
            share: interval.map(|it| it.value),
            low: interval.map(|it| it.low),
            high: interval.map(|it| it.high),
            verdict: interval.and_then(|it| self.verdict(it)),
        }
    }
}

impl ClaimReport {
    /// Reads the rows of the answer to [`Claim::question`].
    ///
    /// # Errors
    /// When they are not such rows.
    pub fn of(claim: &Claim, rows: Vec<Value>) -> Result<Self, serde_json::Error> {
        let mut all = Vec::new();
        let mut by_run: BTreeMap<Option<String>, RunCounts> = BTreeMap::new();
        let (mut examples, mut counter_examples) = (Vec::new(), Vec::new());
        let (mut unclassified, mut unblamed) = (0, 0);
        for row in rows {
            let row: Row = serde_json::from_value(row)?;
            // One row stands for all tasks with the same counts.
            let tasks = std::iter::repeat_n((row.hits, row.trials), row.tasks);
            match row.part.as_str() {
                "all" => all.extend(tasks),
                "run" => {
                    let run = by_run.entry(row.run_id).or_default();
                    run.began_ms = match (run.began_ms, row.began_ms) {
                        (Some(a), Some(b)) => Some(a.min(b)),
                        (a, b) => a.or(b),
                    };
                    run.tasks.extend(tasks);
                }
                "unclassified" if claim.reads(&["class", "sub_class", "rule"]) => {
                    unclassified = row.hits;
                }
                "unblamed" if claim.reads(&["cause", "decisive_step"]) => unblamed = row.hits,
                "unclassified" | "unblamed" => {}
                part => {
                    let example = ClaimExample {
                        episode_id: row.episode_id.unwrap_or_default(),
                        trace: row.trace,
                        task_id: row.task_id,
                        policy: row.policy,
                        success: row.success,
                        step: row.step,
                    };
                    match part {
                        "example" => examples.push(example),
                        _ => counter_examples.push(example),
                    }
                }
            }
        }
        let mut runs: Vec<RunTally> = by_run
            .into_iter()
            .map(|(run_id, run)| RunTally {
                run_id,
                began_ms: run.began_ms,
                tally: claim.tally(&run.tasks),
            })
            .collect();
        runs.sort_by_key(|run| run.began_ms);
        let runs = runs.split_off(runs.len().saturating_sub(RUNS));
        Ok(Self {
            all: claim.tally(&all),
            changed: changed(&runs),
            runs,
            examples,
            counter_examples,
            unclassified,
            unblamed,
        })
    }
}

/// The run since which all have the newest one's verdict, if one before it had another. Runs without
/// a verdict, and open ones, say nothing.
fn changed(runs: &[RunTally]) -> Option<Change> {
    let mut judged = runs.iter().rev().filter_map(|run| {
        let decided = run.tally.verdict.filter(|it| *it != ClaimVerdict::Open)?;
        Some((&run.run_id, decided))
    });
    let (mut since, newest) = judged.next()?;
    for (run_id, verdict) in judged {
        if verdict != newest {
            return Some(Change {
                run_id: since.clone(),
                before: verdict,
            });
        }
        since = run_id;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn claim(text: &str) -> Result<Claim, String> {
        let claim: Claim = serde_json::from_str(text).map_err(|error| error.to_string())?;
        claim.check()?;
        Ok(claim)
    }

    #[test]
    fn what_is_no_claim_is_told() {
        let problem = |text: &str| claim(text).unwrap_err();
        assert!(problem("{}").contains("`holds`"));
        assert!(problem(r#"{"holds": "success", "pattern": "pick"}"#).contains("not both"));
        assert!(problem(r#"{"holds": " "}"#).contains("empty `holds`"));
        assert!(problem(r#"{"holds": "success", "of": ""}"#).contains("empty `of`"));
        assert!(problem(r#"{"holds": "success", "at_least": 70}"#).contains("from 0 to 1"));
        assert!(
            problem(r#"{"holds": "success", "at_least": 0.7, "at_most": 0.2}"#).contains("0.7")
        );
        assert!(problem(r#"{"pattern": "pick("}"#).contains("pattern"));
        assert!(problem(r#"{"holds": "success", "share": 1}"#).contains("share"));
        let closed = r#"{"holds": "true), false) OR coalesce((true"}"#;
        assert!(problem(closed).contains("no condition in `holds`"));
        assert!(problem(r#"{"holds": "success; DROP TABLE episodes"}"#).contains("`holds`"));
        claim(r#"{"of": "NOT success -- all", "holds": "class = 'Other'"}"#).unwrap();
        claim(r#"{"pattern": "^ !ask* pick[not goal_object]", "at_most": 0.1}"#).unwrap();
    }

    fn run(run_id: &str, began_ms: i64, hits: usize, tasks: usize) -> Value {
        json!({"part": "run", "run_id": run_id, "began_ms": began_ms, "hits": hits, "trials": 1, "tasks": tasks})
    }

    #[test]
    fn a_verdict_needs_the_whole_interval_and_changes_with_a_run() {
        let claim = claim(r#"{"holds": "success", "at_least": 0.5}"#).unwrap();
        let mut rows = vec![
            run("third", 30, 1, 60),
            run("second", 20, 1, 58),
            run("second", 20, 0, 2),
            run("first", 10, 0, 60),
            run("small", 25, 1, 3),
        ];
        rows.push(json!({"part": "all", "hits": 1, "trials": 1, "tasks": 121}));
        rows.push(json!({"part": "all", "hits": 0, "trials": 1, "tasks": 62}));
        let report = ClaimReport::of(&claim, rows.clone()).unwrap();
        let verdicts: Vec<_> = report
            .runs
            .iter()
            .map(|run| (run.run_id.as_deref().unwrap(), run.tally.verdict))
            .collect();
        use ClaimVerdict::{Fails, Holds, Open};
        assert_eq!(
            verdicts,
            [
                ("first", Some(Fails)),
                ("second", Some(Holds)),
                ("small", Some(Open)),
                ("third", Some(Holds))
            ]
        );
        assert_eq!((report.all.holding, report.all.episodes), (121, 183));
        let change = report.changed.unwrap();
        assert_eq!(
            (change.run_id.as_deref(), change.before),
            (Some("second"), Fails)
        );
        rows.remove(3);
        assert_eq!(ClaimReport::of(&claim, rows).unwrap().changed, None);
    }

    #[test]
    fn episodes_of_one_task_count_as_the_one_task_that_they_are() {
        let claim = claim(r#"{"holds": "success", "at_least": 0.5}"#).unwrap();
        let alike = json!({"part": "all", "hits": 60, "trials": 60, "tasks": 1});
        let report = ClaimReport::of(&claim, vec![alike]).unwrap();
        assert_eq!(report.all.verdict, Some(ClaimVerdict::Open));
        assert_eq!((report.all.share, report.all.tasks), (Some(1.0), 1));
    }

    #[test]
    fn nothing_counted_has_no_share() {
        let claim = claim(r#"{"holds": "success", "at_least": 0.5}"#).unwrap();
        let report = ClaimReport::of(&claim, Vec::new()).unwrap();
        assert_eq!((report.all.share, report.all.verdict), (None, None));
    }
}
