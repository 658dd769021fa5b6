//! Why episodes failed: the classes that the rules give, what was measured, and the labels of
//! people, judges and injected faults. Never judges anything itself.

use std::{borrow::Cow, collections::BTreeMap};

use deltalake::{DeltaTable, kernel::Action};
use serde::{Deserialize, Serialize};

use super::{Refused, Store, StoreError, TRIES_MAX, parts::parts};
use crate::{Table, rows::Rows};

/// A failed episode with its class: a row of `classes`.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct ClassRow<'a> {
    /// Id of the failed episode, as in `episodes`.
    pub episode_id: &'a str,
    /// Of the trace that was judged.
    pub trace_digest: &'a str,
    /// Digest of the rule set.
    pub rules_version: &'a str,
    /// Class: one of the paper, or of a taxonomy of one's own.
    pub class: &'a str,
    /// Sub-class within the class, e.g. `missing_ask`.
    pub sub_class: &'a str,
    /// The rule that decided.
    pub rule: &'a str,
    /// The decisive step, at which the fault shows: the first of the rule's evidence; where time was
    /// lost, as `reel blame` measured it within the evidence.
    pub step: i32,
    /// The last step of the evidence.
    pub last_step: i32,
    /// The capacity that failed, in the words of `blame`.
    pub cause: &'a str,
    /// Why, in a sentence; `None` if nothing was measured.
    pub explanation: Option<Cow<'a, str>>,
    /// What a competent agent would have called there; `None` if that step was not measured.
    pub advised_call: Option<&'a str>,
    /// How sure the explanation is, from 0 to 1.
    pub confidence: f64,
    /// Sub-class of the next best explanation; `None` if there is none.
    pub runner_up: Option<&'a str>,
    /// In which rules and measurement disagree, for a person to look at.
    pub conflicts: Vec<String>,
    /// Columns that the rule looked at.
    pub fields: &'a [String],
    /// `full`, or `reduced` if the trace has no physics and the rules saw less.
    pub evidence: &'a str,
    /// What else was found.
    pub secondary: Vec<Finding<'a>>,
}

/// What a rule found.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct Finding<'a> {
    /// Name of the rule that made the finding.
    pub rule: &'a str,
    /// Failure class that the rule assigns.
    pub class: &'a str,
    /// Sub-class that the rule assigns within its class.
    pub sub_class: &'a str,
    /// The first step of its evidence.
    pub step: i32,
    /// The last step of the finding's evidence.
    pub last_step: i32,
}

/// A failed episode with the step that decided, measured: a row of `blame`. See the
/// columns of that table.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the schema of the table says what each is")]
pub struct BlameRow {
    pub episode_id: String,
    pub trace_digest: String,
    pub step: Option<i32>,
    pub tool: Option<String>,
    pub harm: Option<String>,
    pub cause: Option<String>,
    pub explanation: Option<String>,
    pub advised_call: Option<String>,
    pub wasted_steps: i32,
    pub point_of_no_return: Option<i32>,
    pub repairable_at_end: bool,
    pub perception: f64,
    pub communication: f64,
    pub memory: f64,
    /// Share of the loss that is due to skills of the robot, from 0 to 1.
    pub primitive: f64,
    pub other: f64,
    pub alternative: Option<String>,
    pub alternative_length: Option<i32>,
    pub alternative_trace: Option<String>,
    pub verified: bool,
    pub reason: Option<String>,
}

/// What comes of a failed episode with one capability perfect: a row of `attribution`. See the
/// columns of that table.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the schema of the table says what each is")]
pub struct AttributionRow {
    pub episode_id: String,
    pub trace_digest: String,
    pub capability: String,
    pub failures: i32,
    pub first_step: Option<i32>,
    pub played: bool,
    pub success: bool,
    pub replaced: i32,
    pub skipped: i32,
    pub length: Option<i32>,
    pub branch: Option<String>,
    pub verified: bool,
    pub reason: Option<String>,
}

/// What somebody says about an episode: a row of `labels`.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct LabelRow {
    /// Id of the episode that the label is about.
    pub episode_id: String,
    /// Who gives the label: a person, a model, or `injected`.
    pub author: String,
    /// `human`, `judge`, `injected` or `adjudicated`.
    pub kind: String,
    /// One of the four classes.
    pub class: String,
    /// Sub-class within the class; `None` if the author names none.
    #[serde(default)]
    pub sub_class: Option<String>,
    /// The decisive step of the episode; `None` if the author names none.
    #[serde(default)]
    pub step: Option<i32>,
    /// From 0 to 1.
    #[serde(default)]
    pub confidence: Option<f64>,
    /// The author's explanation in words; `None` if there is none.
    #[serde(default)]
    pub note: Option<String>,
    /// When it was said, milliseconds since 1970.
    #[serde(default)]
    pub at_ms: i64,
    /// Whether the author answered before seeing what the rules and `reel blame` say; `None` if
    /// nobody recorded that.
    #[serde(default)]
    pub blind: Option<bool>,
}

/// What somebody says about an answer of the user: a row of `answer_labels`.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct AnswerLabelRow {
    /// Id of the episode.
    pub episode_id: String,
    /// The `ask` whose answer it is.
    pub step: i32,
    /// Who gives the label.
    pub author: String,
    /// `faithful`, `unfaithful` or `unclear`.
    pub label: String,
    /// The author's explanation in words; `None` if there is none.
    #[serde(default)]
    pub note: Option<String>,
    /// When it was said, milliseconds since 1970.
    #[serde(default)]
    pub at_ms: i64,
}

/// What a person remarks on an episode: a row of `remarks`.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct RemarkRow {
    /// Id of the episode that the remark is about.
    pub episode_id: String,
    /// Name of the person who makes the remark.
    pub author: String,
    /// What the remark is: `star`, `tag` or `comment`.
    pub kind: String,
    /// The tag or the comment; empty for a star.
    pub text: String,
    /// The step that it is about; `None`: the whole episode.
    pub step: Option<i32>,
    /// When it was made, milliseconds since 1970.
    pub at_ms: i64,
}

/// What comes of a plausible other call, played: a row of `counterfactuals`. See the columns of
/// that table.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the schema of the table says what each is")]
pub struct CounterfactualRow {
    pub episode_id: String,
    pub trace_digest: String,
    pub step: i32,
    pub call: String,
    pub tool: String,
    pub origin: String,
    pub with_recorded_success: bool,
    pub with_recorded_completion: f64,
    pub with_planner_success: Option<bool>,
    pub with_planner_completion: Option<f64>,
    pub with_planner_length: Option<i32>,
}

/// What became of an episode.
#[derive(Deserialize)]
struct OutcomeRow {
    trace: String,
    success: Option<bool>,
    parent_trace: Option<String>,
    target: String,
}

/// Rows of one file.
const ROWS_PER_BATCH: usize = 50_000;

impl Store {
    /// Puts these classes in the place of those that are there; earlier ones are in the store's
    /// earlier versions. `classes` is asked again where somebody else was quicker.
    ///
    /// # Errors
    /// When the store cannot be written.
    pub fn replace_classes<'a, I: Iterator<Item = ClassRow<'a>>>(
        &mut self,
        classes: impl Fn() -> I,
    ) -> Result<(), StoreError> {
        self.replace(Table::Classes, |_| Ok(Some(classes())))
    }

    /// Puts these rows of `blame` in the place of those that are there.
    ///
    /// # Errors
    /// When the store cannot be written.
    pub fn replace_blame(&mut self, rows: &[BlameRow]) -> Result<(), StoreError> {
        self.replace(Table::Blame, |_| Ok(Some(rows)))
    }

    /// Puts these rows of `attribution` in the place of those that are there.
    ///
    /// # Errors
    /// When the store cannot be written.
    pub fn replace_attribution(&mut self, rows: &[AttributionRow]) -> Result<(), StoreError> {
        self.replace(Table::Attribution, |_| Ok(Some(rows)))
    }

    /// The traces of the episodes that were played to an end, in the order of the store; branches
    /// are no trials of their policy and are left out, as are tasks without a goal.
    ///
    /// # Errors
    /// When the store cannot be read.
    pub fn ended_traces(&self) -> Result<Vec<String>, StoreError> {
        self.traces_where(|row| {
            row.success.is_some() && row.parent_trace.is_none() && !row.target.is_empty()
        })
    }

    /// The traces of the episodes that missed the goal of their task, in the order of the store.
    /// Where a task has no goal that Reel knows, a failure was told, and nothing can be measured or
    /// played out against it.
    ///
    /// # Errors
    /// When the store cannot be read.
    pub fn failed_traces(&self) -> Result<Vec<String>, StoreError> {
        self.traces_where(|row| row.success == Some(false) && !row.target.is_empty())
    }

    /// How many episodes failed as somebody told, of tasks without a goal: nothing is measured there.
    ///
    /// # Errors
    /// When the store cannot be read.
    pub fn count_failed_without_goal(&self) -> Result<usize, StoreError> {
        let traces =
            self.traces_where(|row| row.success == Some(false) && row.target.is_empty())?;
        Ok(traces.len())
    }

    fn traces_where(
        &self,
        wanted: impl Fn(&OutcomeRow) -> bool,
    ) -> Result<Vec<String>, StoreError> {
        let mut traces = Vec::new();
        let columns = ["trace", "success", "parent_trace", "target"];
        self.read(Table::Episodes, &columns, |batch| {
            let rows: Vec<OutcomeRow> = crate::rows_from(&batch)?;
            let wanted = rows.into_iter().filter(|row| wanted(row));
            traces.extend(wanted.map(|row| row.trace));
            Ok(())
        })?;
        Ok(traces)
    }

    /// Every label.
    ///
    /// # Errors
    /// When the store cannot be read.
    pub fn labels(&self) -> Result<Vec<LabelRow>, StoreError> {
        self.rows_of(&self.tables[&Table::Labels])
    }

    /// Every label of an answer.
    ///
    /// # Errors
    /// When the store cannot be read.
    pub fn answer_labels(&self) -> Result<Vec<AnswerLabelRow>, StoreError> {
        self.rows_of(&self.tables[&Table::AnswerLabels])
    }

    /// Changes the labels: `change` gets those that are there now, and is asked again where
    /// somebody else was quicker.
    ///
    /// # Errors
    /// When the store cannot be read or written.
    pub fn change_labels(
        &mut self,
        change: impl Fn(Vec<LabelRow>) -> Vec<LabelRow>,
    ) -> Result<(), StoreError> {
        self.change(Table::Labels, change)
    }

    /// Changes the labels of answers as [`Store::change_labels`] does those of episodes.
    ///
    /// # Errors
    /// When the store cannot be read or written.
    pub fn change_answer_labels(
        &mut self,
        change: impl Fn(Vec<AnswerLabelRow>) -> Vec<AnswerLabelRow>,
    ) -> Result<(), StoreError> {
        self.change(Table::AnswerLabels, change)
    }

    /// Every star, tag and comment.
    ///
    /// # Errors
    /// When the store cannot be read.
    pub fn remarks(&self) -> Result<Vec<RemarkRow>, StoreError> {
        self.rows_of(&self.tables[&Table::Remarks])
    }

    /// Changes the remarks as [`Store::change_labels`] does the labels.
    ///
    /// # Errors
    /// When the store cannot be read or written.
    pub fn change_remarks(
        &mut self,
        change: impl Fn(Vec<RemarkRow>) -> Vec<RemarkRow>,
    ) -> Result<(), StoreError> {
        self.change(Table::Remarks, change)
    }

    /// Puts the rows of these episodes into `counterfactuals`, in the place of theirs that are
    /// there; an episode without rows loses them.
    ///
    /// # Errors
    /// When the store cannot be read or written.
    pub fn put_counterfactuals(
        &mut self,
        episodes: &[String],
        rows: &[CounterfactualRow],
    ) -> Result<(), StoreError> {
        self.change(
            Table::Counterfactuals,
            |mut before: Vec<CounterfactualRow>| {
                before.retain(|row| !episodes.contains(&row.episode_id));
                before.extend_from_slice(rows);
                before
            },
        )
    }

    fn change<R: Clone + PartialEq + Serialize + for<'a> Deserialize<'a>>(
        &mut self,
        table: Table,
        change: impl Fn(Vec<R>) -> Vec<R>,
    ) -> Result<(), StoreError> {
        self.replace(table, |store| {
            let before: Vec<R> = store.rows_of(&store.tables[&table])?;
            let after = change(before.clone());
            Ok((after != before).then_some(after))
        })
    }

    /// Puts other rows in the place of a table's; none: leaves it as it is.
    fn replace<R: Serialize, I: IntoIterator<Item = R>>(
        &mut self,
        table: Table,
        rows: impl Fn(&Self) -> Result<Option<I>, StoreError>,
    ) -> Result<(), StoreError> {
        for _ in 0..TRIES_MAX {
            self.reload()?;
            let Some(rows) = rows(self)? else {
                return Ok(());
            };
            match self.try_replace(table, rows) {
                Ok(()) => return self.reload(),
                Err(Refused::Conflict) => {}
                Err(Refused::Failed(error)) => return Err(error),
            }
        }
        Err(StoreError::Busy {
            tries: TRIES_MAX,
            location: self.location.to_string(),
        })
    }

    /// What a commit of `episodes` does not name yet goes too: whoever wrote it will be refused
    /// there, and try again.
    fn try_replace<R: Serialize>(
        &self,
        table: Table,
        rows: impl IntoIterator<Item = R>,
    ) -> Result<(), Refused> {
        let newest = self.newest_to_write(table)?;
        let mut actions: Vec<Action> = parts(&newest)
            .into_iter()
            .map(|part| Action::Remove(part.remove))
            .collect();
        let (mut batches, mut rows) = (Vec::new(), rows.into_iter());
        loop {
            let some: Vec<R> = rows.by_ref().take(ROWS_PER_BATCH).collect();
            if some.is_empty() {
                break;
            }
            batches.push(Rows::of(table, &some).map_err(StoreError::from)?);
        }
        if !batches.is_empty() {
            actions.extend(self.write_parts(&newest, batches)?);
        }
        let version = if actions.is_empty() {
            // A writer may have died when it had taken the rows out, and before that was named.
            if newest.version() == self.tables[&table].version() {
                return Ok(());
            }
            newest.version().unwrap_or_default()
        } else {
            self.commit_side(&newest, actions)?
        };
        self.commit_episodes(Vec::new(), &BTreeMap::from([(table, version)]))
            .map(drop)
    }

    pub(super) fn rows_of<R: for<'a> Deserialize<'a>>(
        &self,
        table: &DeltaTable,
    ) -> Result<Vec<R>, StoreError> {
        let mut rows: Vec<R> = Vec::new();
        self.read_parts(table, &parts(table), None, |_, batch| {
            rows.extend(
                serde_arrow::from_record_batch::<Vec<R>>(&batch).map_err(crate::RowsError::from)?,
            );
            Ok(())
        })?;
        Ok(rows)
    }
}
