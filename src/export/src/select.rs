//! Which episodes of a store, and which of their decisions, make a training set. Reads
//! columns and files' digests; never looks at a text, and never asks whether an
//! episode is verified ([`crate::verify`]).

use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    sync::Arc,
};

use reel_tables::{Store, StoreError, Table};
use reel_world::{Digest, Family, ToolSpec};
use serde::{Deserialize, Serialize};

use crate::{
    AnnotationSource, RefusedEpisode, contradictions::HistoryChecks, rollouts::GroupReturn,
};

/// Which episodes and decisions are wanted.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Selection {
    /// Only these episodes, by id; none: all.
    pub episodes: Option<BTreeSet<String>>,
    /// Failed and broken-off episodes too.
    pub failed: bool,
    /// Episodes with a discounted return below this are left out.
    pub return_min: Option<f64>,
    /// At most so many episodes a task; which ones is drawn by `seed`.
    pub per_task_max: Option<usize>,
    /// Decisions that were mistakes are examples too: calls that failed, picks and places that the
    /// goal does not want. Their place in the History of later decisions they keep in any case.
    pub mistakes: bool,
    /// Decisions that came right after a mistake are examples: what to do
    /// when something went wrong.
    pub recoveries: bool,
    /// Decisions of failed episodes from the decisive step on (table `classes`) are examples too.
    pub after_decisive: bool,
    /// Decisions whose own History contradicts the record are examples too; said of words that
    /// are exported as recorded.
    pub contradictions: bool,
    /// Answers that no call could be read from are examples too: a policy is rewarded for whatever it said.
    pub unread_answers: bool,
    /// Decisions of agents with tools of their own are examples too, where rows are conversations.
    pub own_tools: bool,
    /// No family has more decisions than the median family.
    pub balance_families: bool,
    /// No tool has more decisions than the median tool.
    pub balance_tools: bool,
    /// Seed of every random draw: of episodes, decisions and splits.
    pub seed: u64,
}

impl Default for Selection {
    fn default() -> Self {
        Self {
            episodes: None,
            failed: false,
            return_min: None,
            per_task_max: None,
            mistakes: false,
            recoveries: true,
            after_decisive: false,
            contradictions: false,
            unread_answers: false,
            own_tools: false,
            balance_families: false,
            balance_tools: false,
            seed: 0,
        }
    }
}

/// An episode that may become rows.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub episode_id: String,
    pub trace: String,
    pub trace_digest: String,
    pub task_digest: String,
    pub scene_id: String,
    pub family: Family,
    /// The decisions that are examples.
    pub decisions: Vec<Decision>,
    /// Whether its trace was replayed to the same bits.
    pub verified: bool,
    /// Whether a recorded History of it claims what the record refutes, or nobody could check.
    pub contradicts: bool,
    /// The rules that said how it failed, where they did.
    pub rules_version: Option<Arc<str>>,
    pub policy: String,
    pub seed: String,
    /// The prompt group that was recorded with it.
    pub group_id: Option<String>,
    /// None where it has no end.
    pub discounted_return: Option<f64>,
    /// What each step pays: as recorded, or under the preset of the export.
    pub rewards: Arc<[f64]>,
    /// The call with which the preset of the export is done with the episode; none where the record
    /// goes on to its end.
    pub paid_until: Option<u32>,
    /// What it was worth in its group, once that is known.
    pub worth: Option<GroupReturn>,
}

impl Candidate {
    /// One of a task, without decisions.
    #[cfg(test)]
    pub fn sample(task: &str) -> Self {
        Self {
            episode_id: String::new(),
            trace: String::new(),
            trace_digest: String::new(),
            task_digest: task.to_owned(),
            scene_id: String::new(),
            family: Family::ALL[0],
            decisions: Vec::new(),
            verified: true,
            contradicts: false,
            rules_version: None,
            policy: "model".to_owned(),
            seed: String::new(),
            group_id: None,
            discounted_return: None,
            rewards: Arc::new([]),
            paid_until: None,
            worth: None,
        }
    }

    /// That it, or one of its decisions, is refused.
    pub fn refusal(&self, call: Option<u32>, reason: String) -> RefusedEpisode {
        RefusedEpisode {
            episode_id: self.episode_id.clone(),
            trace: self.trace.clone(),
            call,
            reason,
        }
    }
}

/// A decision that is an example.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Decision {
    pub call: u32,
    /// Index of the decision's tool in [`ToolSpec::POLICY`]; its length where none was called.
    pub(crate) tool: u8,
}

/// How many episodes and decisions were left out, by the reason.
pub(crate) type SkipCounts = BTreeMap<&'static str, u64>;

#[derive(Deserialize)]
struct CandidateRow<'a> {
    episode_id: &'a str,
    trace: &'a str,
    trace_digest: &'a str,
    task_digest: &'a str,
    scene_id: &'a str,
    family: &'a str,
    policy: &'a str,
    /// A column of numbers without a sign, which come as text.
    seed: String,
    group_id: Option<&'a str>,
    success: Option<bool>,
    discounted_return: Option<f64>,
    target: &'a str,
    steps: Vec<StepRow<'a>>,
}

#[derive(Deserialize)]
struct StepRow<'a> {
    step: u32,
    reward: f64,
    tool: &'a str,
    call_name: &'a str,
    error_code: Option<&'a str>,
    goal_object: Option<bool>,
    goal_receptacle: Option<bool>,
    raw: Option<&'a str>,
}

const COLUMNS: &[&str] = &reel_world::words! {
    episode_id trace trace_digest task_digest scene_id family policy seed group_id success
    discounted_return target "steps.list.element.call_name" "steps.list.element.step" "steps.list.element.reward"
    "steps.list.element.tool" "steps.list.element.error_code" "steps.list.element.goal_object"
    "steps.list.element.goal_receptacle" "steps.list.element.raw"
};

/// The episodes that are wanted, with all their decisions, in the order of the store's files. The
/// Histories of those that are exported as recorded are checked.
pub(crate) fn candidates(
    store: &Store,
    wanted: &Selection,
    words: AnnotationSource,
    left_out: &mut SkipCounts,
) -> Result<Vec<Candidate>, StoreError> {
    let classes = if wanted.failed {
        classes(store)?
    } else {
        HashMap::new()
    };
    let mut histories = HistoryChecks::open(store)?;
    let mut found = Vec::new();
    store.read(Table::Episodes, COLUMNS, |batch| {
        let rows: Vec<CandidateRow<'_>> = reel_tables::rows_from(&batch)?;
        let recorded = rows
            .iter()
            .filter(|row| row.is_recorded(words) && unwanted(row, wanted).is_none());
        histories.check(recorded.map(|row| (row.trace, row.trace_digest)));
        for row in rows {
            match unwanted(&row, wanted) {
                Some(reason) => *left_out.entry(reason).or_default() += 1,
                None => found.extend(candidate(
                    &row,
                    wanted,
                    words,
                    classes.get(row.episode_id),
                    histories.refuted_steps(row.trace_digest),
                    left_out,
                )),
            }
        }
        Ok(())
    })?;
    histories.save()?;
    Ok(found)
}

fn unwanted(row: &CandidateRow<'_>, wanted: &Selection) -> Option<&'static str> {
    if wanted
        .episodes
        .as_ref()
        .is_some_and(|episodes| !episodes.contains(row.episode_id))
    {
        return Some("episodes outside the condition");
    }
    match row.success {
        Some(false) if !wanted.failed => return Some("episodes that did not succeed"),
        None if !wanted.failed => {
            return Some(
                "episodes that were broken off, or of which nobody told whether they succeeded",
            );
        }
        _ => {}
    }
    let too_low = |least: f64| row.discounted_return.is_none_or(|it| it < least);
    wanted
        .return_min
        .is_some_and(too_low)
        .then_some("episodes of a lower return")
}

fn candidate(
    row: &CandidateRow<'_>,
    wanted: &Selection,
    words: AnnotationSource,
    class: Option<&Class>,
    refuted: Option<&BTreeSet<u32>>,
    left_out: &mut SkipCounts,
) -> Option<Candidate> {
    let recorded = row.is_recorded(words);
    let refutes = |step| refuted.is_some_and(|steps| steps.contains(&step));
    let mut decisions = Vec::new();
    let mut after_mistake = false;
    let decisive = class
        .map(|class| class.step)
        .filter(|_| !wanted.after_decisive);
    for step in &row.steps {
        let mistake = step.is_mistake();
        let tool = ToolSpec::POLICY
            .iter()
            .position(|spec| spec.paper_name == step.tool);
        let reason = match tool {
            _ if decisive.is_some_and(|decisive| step.step >= decisive) => {
                "decisions from the decisive step of a failure on"
            }
            _ if mistake && !wanted.mistakes => "decisions that were mistakes",
            _ if after_mistake && !wanted.recoveries => "decisions right after a mistake",
            _ if recorded && !wanted.contradictions && refutes(step.step) => {
                "decisions whose History contradicts the record"
            }
            None if row.has_own_tools() && wanted.own_tools => "",
            None if row.has_own_tools() => {
                "decisions of agents with tools of their own, which are taught by --style multi-turn"
            }
            None if !(wanted.unread_answers && step.raw.is_some()) => "decisions that call no tool",
            _ => "",
        };
        after_mistake = mistake;
        if reason.is_empty() {
            decisions.push(Decision {
                call: step.step,
                tool: tool.unwrap_or(ToolSpec::POLICY.len()) as u8,
            });
        } else {
            *left_out.entry(reason).or_default() += 1;
        }
    }
    let own_tools = row.has_own_tools().then_some(Family::Other);
    let family = Family::parse(row.family)
        .or(own_tools)
        .filter(|_| !decisions.is_empty())?;
    Some(Candidate {
        episode_id: row.episode_id.to_owned(),
        trace: row.trace.to_owned(),
        trace_digest: row.trace_digest.to_owned(),
        task_digest: row.task_digest.to_owned(),
        scene_id: row.scene_id.to_owned(),
        family,
        decisions,
        verified: true,
        contradicts: recorded && refuted.is_none_or(|steps| !steps.is_empty()),
        rules_version: class.map(|class| Arc::clone(&class.rules_version)),
        policy: row.policy.to_owned(),
        seed: row.seed.clone(),
        group_id: row.group_id.map(str::to_owned),
        discounted_return: row.discounted_return,
        rewards: row.steps.iter().map(|step| step.reward).collect(),
        paid_until: None,
        worth: None,
    })
}

impl CandidateRow<'_> {
    /// Whether its agent acted outside of homes: its task has no goal, and none of its calls is a
    /// call of REAL's tools.
    fn has_own_tools(&self) -> bool {
        has_own_tools(
            self.target,
            self.steps.iter().map(|step| (step.tool, step.call_name)),
        )
    }

    /// Whether the policy's own words are exported.
    fn is_recorded(&self, words: AnnotationSource) -> bool {
        words.of(|| self.steps.iter().any(|step| step.raw.is_some())) == AnnotationSource::Recorded
    }
}

/// Whether the calls (tool by the paper's name, name as called) of an episode without a goal are
/// those of other tools than REAL's.
pub(crate) fn has_own_tools<'a>(
    target: &str,
    mut calls: impl Iterator<Item = (&'a str, &'a str)>,
) -> bool {
    let is_reals = |tool: &str| ToolSpec::POLICY.iter().any(|spec| spec.paper_name == tool);
    target.is_empty() && calls.all(|(tool, name)| !is_reals(tool) && !name.is_empty())
}

impl StepRow<'_> {
    /// A call that failed, a pick of what the goal leaves where it is, a place where the goal
    /// does not want it.
    fn is_mistake(&self) -> bool {
        match self.tool {
            _ if self.error_code.is_some() => true,
            "pick" => self.goal_object == Some(false),
            "place" => self.goal_object == Some(true) && self.goal_receptacle == Some(false),
            _ => false,
        }
    }
}

/// What the rules said of a failed episode.
struct Class {
    step: u32,
    rules_version: Arc<str>,
}

fn classes(store: &Store) -> Result<HashMap<String, Class>, StoreError> {
    #[derive(Deserialize)]
    struct Row<'a> {
        episode_id: &'a str,
        rules_version: &'a str,
        step: u32,
    }
    let mut classes = HashMap::new();
    let mut version: Arc<str> = Arc::from("");
    store.read(
        Table::Classes,
        &["episode_id", "rules_version", "step"],
        |batch| {
            for row in reel_tables::rows_from::<Row<'_>>(&batch)? {
                if row.rules_version != &*version {
                    version = Arc::from(row.rules_version);
                }
                classes.insert(
                    row.episode_id.to_owned(),
                    Class {
                        step: row.step,
                        rules_version: Arc::clone(&version),
                    },
                );
            }
            Ok(())
        },
    )?;
    Ok(classes)
}

/// At most so many episodes a task; those that are kept are drawn by the seed and
/// stay in their order.
pub(crate) fn cap_tasks(found: &mut Vec<Candidate>, wanted: &Selection, left_out: &mut SkipCounts) {
    let Some(most) = wanted.per_task_max else {
        return;
    };
    let mut by_task: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (index, candidate) in found.iter().enumerate() {
        by_task
            .entry(&candidate.task_digest)
            .or_default()
            .push(index);
    }
    let mut kept = vec![false; found.len()];
    for episodes in by_task.values_mut() {
        episodes.sort_by_cached_key(|index| draw(wanted.seed, &found[*index].episode_id, None));
        episodes
            .iter()
            .take(most)
            .for_each(|index| kept[*index] = true);
    }
    let before = found.len();
    let mut kept = kept.into_iter();
    found.retain(|_| kept.next().unwrap_or(false));
    count(
        left_out,
        "episodes beyond the most of their task",
        before - found.len(),
    );
}

/// Cuts the decisions of families and tools to the median of the families' and tools' sizes.
pub(crate) fn balance(found: &mut Vec<Candidate>, wanted: &Selection, left_out: &mut SkipCounts) {
    if wanted.balance_families {
        let cut = cut_to_median(found, wanted.seed, |candidate, _| candidate.family as u8);
        count(left_out, "decisions beyond the median family's", cut);
    }
    if wanted.balance_tools {
        let cut = cut_to_median(found, wanted.seed, |_, decision| decision.tool);
        count(left_out, "decisions beyond the median tool's", cut);
    }
    found.retain(|candidate| !candidate.decisions.is_empty());
}

/// Cuts every group of decisions to the median of their sizes: those of the smallest draws stay.
fn cut_to_median(
    found: &mut [Candidate],
    seed: u64,
    group: impl Fn(&Candidate, Decision) -> u8,
) -> usize {
    let mut groups: BTreeMap<u8, Vec<u64>> = BTreeMap::new();
    let number = |candidate: &Candidate, decision: Decision| {
        draw(seed, &candidate.episode_id, Some(decision.call))
    };
    for candidate in found.iter() {
        for decision in &candidate.decisions {
            groups
                .entry(group(candidate, *decision))
                .or_default()
                .push(number(candidate, *decision));
        }
    }
    let mut sizes: Vec<usize> = groups.values().map(Vec::len).collect();
    sizes.sort_unstable();
    let Some(median) = sizes.get(sizes.len() / 2).copied() else {
        return 0;
    };
    let last_kept = |draws: &mut Vec<u64>| match draws.len() {
        size if size <= median => u64::MAX,
        _ => *draws.select_nth_unstable(median - 1).1,
    };
    let limits: BTreeMap<u8, u64> = groups
        .iter_mut()
        .map(|(group, draws)| (*group, last_kept(draws)))
        .collect();
    let mut cut = 0;
    for candidate in found.iter_mut() {
        let mut decisions = std::mem::take(&mut candidate.decisions);
        let before = decisions.len();
        decisions.retain(|decision| {
            number(candidate, *decision) <= limits[&group(candidate, *decision)]
        });
        cut += before - decisions.len();
        candidate.decisions = decisions;
    }
    cut
}

/// A number drawn for an episode, or one of its decisions: the same whatever else is in the set.
pub(crate) fn draw(seed: u64, episode_id: &str, call: Option<u32>) -> u64 {
    let digest = Digest::of(format!("{seed}/{episode_id}/{call:?}").as_bytes());
    u64::from_le_bytes(digest.0[..8].try_into().expect("eight bytes"))
}

pub(crate) fn count(left_out: &mut SkipCounts, reason: &'static str, number: usize) {
    if number > 0 {
        *left_out.entry(reason).or_default() += number as u64;
    }
}
