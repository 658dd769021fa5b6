//! The rules over the episodes: asks all of them in one pass and picks the class of each failed
//! episode. Reads no labels and writes nothing.

use std::collections::{BTreeMap, BTreeSet};

use arrow::{
    array::{Array, AsArray, BooleanArray, Int32Array, RecordBatch, StringArray},
    compute::cast,
    datatypes::{DataType, Int32Type},
};
use reel_query::{QueryError, QuerySession, fuse};
use reel_tables::{ClassRow, Finding};

use crate::{
    RuleSet, TaxonomyError,
    explain::{ACHIEVEMENTS, Evidence, FalseClaims, Measured, explain, heed_claims},
    rules::Rule,
};

/// Columns that name an episode, and its target: a task that names none has no goal.
const KEEP: [&str; 7] = [
    "episode_id",
    "trace_digest",
    "backend",
    "family",
    "policy",
    "length",
    "target",
];
/// The episodes that failed, and those of tasks without a goal of which nobody said how they went.
const FAILED: &str =
    "(NOT success OR (success IS NULL AND target = '' AND end_reason IS NOT NULL))";

/// The failed episodes with their classes.
#[derive(Debug)]
pub struct Classification {
    rules: Vec<Rule>,
    version: String,
    /// By rule: the columns that it looked at.
    fields: Vec<Vec<String>>,
    batches: Vec<RecordBatch>,
    found: Vec<ClassifiedEpisode>,
    /// What blame measured, by episode and trace.
    measured: BTreeMap<(String, String), Measured>,
    /// False claims of Histories, by trace.
    claims: BTreeMap<String, FalseClaims>,
}

/// One episode: where it stands, and what was found, the most important first.
#[derive(Debug)]
struct ClassifiedEpisode {
    batch: u32,
    row: u32,
    /// Number of its steps.
    length: i32,
    findings: Vec<Evidence>,
}

/// Applies the rules to the failed episodes of a store that fulfil a condition in SQL. Where a task
/// has no goal and nobody said how it went, an episode counts as failed if a rule holds.
///
/// # Errors
/// When a rule or the condition cannot be asked.
pub fn classify(
    session: &QuerySession,
    rules: &RuleSet,
    condition: Option<&str>,
) -> Result<Classification, TaxonomyError> {
    let questions: Vec<_> = rules.rules().iter().map(|rule| &rule.question).collect();
    let filter = match condition {
        Some(condition) => format!("{FAILED} AND ({condition})"),
        None => FAILED.to_owned(),
    };
    let batches = session.run(&fuse(&KEEP, &questions, &filter))?;
    let mut found = Vec::new();
    for (batch_index, batch) in batches.iter().enumerate() {
        let answers = rules
            .rules()
            .iter()
            .enumerate()
            .map(|(index, rule)| RuleMatches::new(batch, index, rule));
        let answers = answers.collect::<Result<Vec<_>, _>>()?;
        let lengths = cast(&batch["length"], &DataType::Int32).map_err(QueryError::from)?;
        let lengths: &Int32Array = lengths.as_primitive();
        let targets: &StringArray = batch["target"].as_string();
        for row in 0..batch.num_rows() {
            let has_goal = !targets.value(row).is_empty();
            let mut findings: Vec<Evidence> = (0_u16..)
                .zip(&answers)
                .filter(|(rule, _)| has_goal || !rules.rules()[usize::from(*rule)].needs_goal)
                .filter_map(|(rule, answer)| {
                    answer.at(row).map(|(first, last)| (rule, first, last))
                })
                .collect();
            // the rules stand in the order of their priority
            findings.sort_by_key(|(rule, first, _)| {
                (rules.rules()[usize::from(*rule)].priority, *first, *rule)
            });
            if findings.is_empty() && !has_goal {
                continue;
            }
            found.push(ClassifiedEpisode {
                batch: batch_index as u32,
                row: row as u32,
                length: lengths.value(row),
                findings,
            });
        }
    }
    let fields = rules
        .rules()
        .iter()
        .map(|rule| looked_at(session, rule))
        .collect::<Result<Vec<_>, _>>()?;
    let (rules, version) = (rules.rules().to_vec(), rules.version().to_string());
    Ok(Classification {
        rules,
        version,
        fields,
        batches,
        found,
        measured: measured(session)?,
        claims: claims(session)?,
    })
}

/// What `reel blame` measured, where it did.
fn measured(session: &QuerySession) -> Result<BTreeMap<(String, String), Measured>, QueryError> {
    let batches = session.run(
        "SELECT episode_id, trace_digest, harm, cause, explanation, advised_call, step \
         FROM blame WHERE step IS NOT NULL",
    )?;
    let rows = batches.iter().flat_map(|batch| {
        let text = |column: usize, row: usize| {
            let column: &StringArray = batch.column(column).as_string();
            column.value(row).to_owned()
        };
        let steps = batch.column(6).as_primitive::<Int32Type>();
        (0..batch.num_rows()).map(move |row| {
            let measured = Measured {
                step: steps.value(row),
                harm: text(2, row),
                cause: text(3, row),
                explanation: text(4, row),
                advised_call: text(5, row),
            };
            ((text(0, row), text(1, row)), measured)
        })
    });
    Ok(rows.collect())
}

/// What the checker of Histories found, of the traces that it checked.
fn claims(session: &QuerySession) -> Result<BTreeMap<String, FalseClaims>, QueryError> {
    let checked = session.store().checked_traces()?;
    let newest = checked.iter().map(|trace| trace.checker_version).max();
    let found = checked
        .into_iter()
        .filter(|trace| Some(trace.checker_version) == newest)
        .map(|trace| {
            let steps = trace
                .claims
                .iter()
                .filter(|claim| ACHIEVEMENTS.contains(&claim.kind.as_str()))
                .map(|claim| claim.step as i32)
                .collect();
            (trace.trace_digest, FalseClaims(steps))
        });
    Ok(found.collect())
}

/// The columns of `episodes` that a rule reads, steps by their fields.
fn looked_at(session: &QuerySession, rule: &Rule) -> Result<Vec<String>, QueryError> {
    let mut fields: BTreeSet<String> = rule
        .question
        .columns()
        .iter()
        .filter(|name| *name != "steps")
        .cloned()
        .collect();
    if rule.question.columns().contains("steps") {
        let of_steps = session.step_fields(&rule.sql)?.unwrap_or_default();
        fields.extend(of_steps.into_iter().map(|field| format!("steps.{field}")));
    }
    Ok(fields.into_iter().collect())
}

/// What a rule answers for the episodes of a batch.
struct RuleMatches {
    first: Int32Array,
    last: Int32Array,
    holds: BooleanArray,
}

impl RuleMatches {
    fn new(batch: &RecordBatch, index: usize, rule: &Rule) -> Result<Self, TaxonomyError> {
        let wrong = |reason: &str| TaxonomyError::Rule {
            rule: rule.name.clone(),
            reason: reason.to_owned(),
        };
        let found = batch
            .column_by_name(&format!("found_{index}"))
            .expect("it was asked");
        let no_struct = "`found` has to be a struct with whole numbers `first` and `last`, as sequence_find gives";
        let found = found.as_struct_opt().ok_or_else(|| wrong(no_struct))?;
        let number = |name: &str| -> Result<Int32Array, TaxonomyError> {
            let column = found.column_by_name(name).ok_or_else(|| wrong(no_struct))?;
            let numbers = cast(column, &DataType::Int32).map_err(|_| wrong(no_struct))?;
            let numbers = numbers
                .as_primitive_opt::<Int32Type>()
                .ok_or_else(|| wrong(no_struct))?;
            // a struct that is null hides what its fields hold
            let nulls = arrow::buffer::NullBuffer::union(numbers.nulls(), found.nulls());
            Ok(Int32Array::new(numbers.values().clone(), nulls))
        };
        let holds = batch
            .column_by_name(&format!("holds_{index}"))
            .expect("it was asked")
            .as_boolean()
            .clone();
        Ok(Self {
            first: number("first")?,
            last: number("last")?,
            holds,
        })
    }

    fn at(&self, row: usize) -> Option<(i32, i32)> {
        let found = self.holds.value(row) && self.first.is_valid(row);
        found.then(|| {
            (
                self.first.value(row),
                if self.last.is_valid(row) {
                    self.last.value(row)
                } else {
                    self.first.value(row)
                },
            )
        })
    }
}

impl Classification {
    /// How many failed episodes there are.
    pub fn len(&self) -> usize {
        self.found.len()
    }

    /// Whether there is no failed episode to classify.
    pub fn is_empty(&self) -> bool {
        self.found.is_empty()
    }

    /// The rows of table `classes`, one a failed episode.
    pub fn classes(&self) -> impl Iterator<Item = ClassRow<'_>> {
        self.found.iter().filter_map(|verdict| {
            let text = |name| self.text(verdict, name);
            let (episode_id, trace_digest) = (text("episode_id"), text("trace_digest"));
            let key = (episode_id.to_owned(), trace_digest.to_owned());
            let length = verdict.length;
            let findings = &heed_claims(
                &verdict.findings,
                &self.rules,
                self.claims.get(trace_digest),
                length,
            );
            let explained = explain(findings, &self.rules, self.measured.get(&key))?;
            let primary = findings[explained.primary];
            let rule = self.rule(primary);
            let secondary = self.secondary(findings, explained.primary);
            Some(ClassRow {
                episode_id,
                trace_digest,
                rules_version: &self.version,
                class: &rule.class,
                sub_class: &rule.sub_class,
                rule: &rule.name,
                step: explained.step,
                last_step: primary.2.max(explained.step),
                cause: explained.cause,
                explanation: explained.sentence,
                advised_call: explained.advised_call,
                confidence: explained.confidence,
                runner_up: secondary.first().map(|finding| finding.sub_class),
                conflicts: explained.conflicts,
                fields: &self.fields[usize::from(primary.0)],
                evidence: if text("backend") == "sim" {
                    "full"
                } else {
                    "reduced"
                },
                secondary,
            })
        })
    }

    /// The findings beside the one that decides, each sub-class once.
    fn secondary(&self, findings: &[Evidence], primary: usize) -> Vec<Finding<'_>> {
        let mut told = BTreeSet::from([self.rule(findings[primary]).sub_class.as_str()]);
        let others = findings
            .iter()
            .filter(|finding| self.rule(**finding).secondary);
        others
            .filter_map(|(index, step, last_step)| {
                let rule = &self.rules[usize::from(*index)];
                told.insert(&rule.sub_class).then_some(Finding {
                    rule: &rule.name,
                    class: &rule.class,
                    sub_class: &rule.sub_class,
                    step: *step,
                    last_step: *last_step,
                })
            })
            .collect()
    }

    /// Family and policy of the episodes, in the order of [`Classification::classes`].
    pub fn groups(&self) -> impl Iterator<Item = (&str, &str)> {
        let some = self
            .found
            .iter()
            .filter(|verdict| !verdict.findings.is_empty());
        some.map(|verdict| (self.text(verdict, "family"), self.text(verdict, "policy")))
    }

    fn rule(&self, finding: Evidence) -> &Rule {
        &self.rules[usize::from(finding.0)]
    }

    fn text(&self, verdict: &ClassifiedEpisode, column: &str) -> &str {
        let column: &StringArray = self.batches[verdict.batch as usize][column].as_string::<i32>();
        column.value(verdict.row as usize)
    }
}
