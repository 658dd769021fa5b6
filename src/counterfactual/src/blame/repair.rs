//! The smallest change of an episode's calls that makes it succeed, by search over branches: one
//! edit at the decisive call, then what a better future did otherwise, as little of it as will do.
//! Never calls before the decisive step.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use crate::branch::{Branch, BranchError, Continuation, fork};
use reel_agents::{GoalHint, Planner, Policy, retrace};
use reel_replay::Fork;
use reel_trace::Trace;
use reel_world::{Tool, ToolCall};
use serde::Serialize;

use crate::blame::{
    CompetentAgent, Decisive,
    alternative::{better_future, recorded},
};

/// One change of a list of calls; numbers are of the parent's calls.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[serde(tag = "edit", rename_all = "snake_case")]
pub enum Edit {
    /// Before that call comes another one.
    Insert {
        /// Index of the parent's call that the new call precedes, from 0.
        before: usize,
        /// The call that is inserted there.
        call: ToolCall,
    },
    /// Instead of that call.
    Replace {
        /// Index of the parent's call that is replaced, from 0.
        at: usize,
        /// The call that replaces the parent's call.
        call: ToolCall,
    },
    /// One of the parent's calls is left out.
    Delete {
        /// Index of the parent's call that is left out, from 0.
        at: usize,
    },
}

/// A call of a repair that nobody could have made for a reason at that moment.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Presumed {
    /// Index of the call in the repaired episode, from 0.
    pub at: usize,
    /// The call as the repaired episode has it.
    pub call: ToolCall,
    /// What it takes for known, as a phrase.
    pub knowledge: &'static str,
}

/// The smallest change that was found to make a failed episode succeed.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Repair {
    /// What has to change; no single one of these can be left out.
    pub edits: Vec<Edit>,
    /// The first call that differs.
    pub at: usize,
    /// The calls from there on.
    pub calls: Vec<ToolCall>,
    /// What the edits take for known that the agent had not found out, by index of the repaired
    /// call; empty where the agent could have made the repair itself.
    pub presumed: Vec<Presumed>,
    /// Branches that were played to find it.
    pub tried: usize,
    /// The trace, where one was wanted.
    pub trace: Option<PathBuf>,
    /// Whether the trace was replayed and is exact, with the parent's past.
    pub verified: bool,
}

/// Searches the smallest repair, and records and verifies it where a path is given.
///
/// # Errors
/// When the episode cannot be executed up to there, or the branch cannot be written. Inside:
/// why there is none.
pub fn repair(
    trace: &Trace,
    decisive: &Decisive,
    record: Option<&Path>,
) -> Result<Result<Repair, String>, BranchError> {
    let at = decisive.step as usize;
    let moment = fork(trace, at, None)?;
    let parent: Vec<ToolCall> = trace.steps[at..]
        .iter()
        .map(|step| step.input.call.clone())
        .collect();
    let mut search = Search {
        fork: &moment,
        tried: 0,
    };
    let script = match search.one_edit(trace, decisive, &parent)? {
        Some(script) => script,
        None => {
            let better = match better_future(&moment, CompetentAgent::default())? {
                Ok(better) => better,
                Err(why) => return Ok(Err(why)),
            };
            search.least(align(&parent, &better.calls))?
        }
    };
    let tried = search.tried;
    let first = script
        .iter()
        .position(|op| !matches!(op, Op::Keep(_)))
        .unwrap_or(0);
    let calls: Vec<ToolCall> = applied(&script[first..]);
    let at = at + first;
    let verified = match record {
        Some(path) => recorded(
            &Branch {
                calls: calls.clone(),
                continuation: Continuation::Stop,
            },
            &fork(trace, at, None)?,
            path,
        )?,
        None => false,
    };
    let edits = edits(&script, decisive.step as usize);
    let presumed = presumed(&moment, &script)?;
    Ok(Ok(Repair {
        edits,
        at,
        calls,
        presumed,
        tried,
        trace: record.map(Path::to_owned),
        verified,
    }))
}

/// Plays the repaired calls once more, watched by a competent agent that says which of the new
/// calls take for known what was not found out before.
fn presumed(fork: &Fork<'_>, script: &[Op]) -> Result<Vec<Presumed>, BranchError> {
    let branch = Branch {
        calls: applied(script),
        continuation: Continuation::Stop,
    };
    let (_, steps) = branch.play_for_steps(fork)?;
    let inserted: BTreeSet<usize> = script
        .iter()
        .filter(|op| !matches!(op, Op::Delete(_)))
        .enumerate()
        .filter(|(_, op)| matches!(op, Op::Insert(_)))
        .map(|(index, _)| fork.call() + index)
        .collect();
    let parent = fork.parent();
    let mut watcher = Planner::new(GoalHint::of_task(&parent.task), 0);
    let mut presumed = Vec::new();
    retrace(
        &parent.task,
        &parent.scene,
        &parent.start,
        &steps,
        |context, step| {
            let Some(step) = step else { return };
            let (at, call) = (step.step as usize, &step.input.call);
            if inserted.contains(&at)
                && let Some(presumption) = watcher.presumption(context, call)
            {
                presumed.push(Presumed {
                    at,
                    call: call.clone(),
                    knowledge: presumption.phrase(),
                });
            }
            watcher.observe(context, &step.input);
        },
    );
    Ok(presumed)
}

/// One call of a parent, or of a better future.
#[derive(Clone, PartialEq, Debug)]
enum Op {
    /// The call is in the parent and in the changed list.
    Keep(ToolCall),
    /// Only in the parent.
    Delete(ToolCall),
    /// Only in the other.
    Insert(ToolCall),
}

struct Search<'f, 't> {
    fork: &'f Fork<'t>,
    tried: usize,
}

impl Search<'_, '_> {
    fn succeeds(&mut self, script: &[Op]) -> Result<bool, BranchError> {
        self.tried += 1;
        let branch = Branch {
            calls: applied(script),
            continuation: Continuation::Stop,
        };
        Ok(branch.play(self.fork, None)?.success)
    }

    /// One edit at the decisive call: without it, another call instead of it or before it;
    /// what a competent agent would have called, or the same with another number of the map
    /// that lay before the agent.
    fn one_edit(
        &mut self,
        trace: &Trace,
        decisive: &Decisive,
        parent: &[ToolCall],
    ) -> Result<Option<Vec<Op>>, BranchError> {
        let at = decisive.step as usize;
        let [made, rest @ ..] = parent else {
            return Ok(None);
        };
        let shown = at
            .checked_sub(1)
            .map_or(&[][..], |before| &trace.steps[before].markers);
        let with = |marker| match Tool::parse(made).ok()? {
            Tool::Pick { .. } => Some(Tool::Pick { marker }),
            Tool::Place { .. } => Some(Tool::Place { marker }),
            _ => None,
        };
        let others = shown
            .iter()
            .filter_map(|marker| with(marker.id))
            .map(|tool| tool.to_call());
        let calls: Vec<ToolCall> = others
            .chain([decisive.advised_call.clone()])
            .filter(|call| call != made)
            .collect();
        let (gone, kept) = (Op::Delete(made.clone()), Op::Keep(made.clone()));
        let mut scripts = vec![vec![gone.clone()]];
        scripts.extend(
            calls
                .iter()
                .map(|call| vec![gone.clone(), Op::Insert(call.clone())]),
        );
        scripts.extend(
            calls
                .iter()
                .map(|call| vec![Op::Insert(call.clone()), kept.clone()]),
        );
        for mut script in scripts {
            script.extend(rest.iter().cloned().map(Op::Keep));
            if self.succeeds(&script)? {
                return Ok(Some(script));
            }
        }
        Ok(None)
    }

    /// Takes changes back one after the other, as long as it still succeeds.
    fn least(&mut self, mut script: Vec<Op>) -> Result<Vec<Op>, BranchError> {
        loop {
            let mut changed = false;
            let mut index = script.len();
            while index > 0 {
                index -= 1;
                let mut candidate = script.clone();
                match &candidate[index] {
                    Op::Keep(_) => continue,
                    Op::Delete(call) => candidate[index] = Op::Keep(call.clone()),
                    Op::Insert(_) => drop(candidate.remove(index)),
                }
                if self.succeeds(&candidate)? {
                    script = candidate;
                    changed = true;
                }
            }
            if !changed {
                return Ok(script);
            }
        }
    }
}

fn applied(script: &[Op]) -> Vec<ToolCall> {
    let call = |op: &Op| match op {
        Op::Keep(call) | Op::Insert(call) => Some(call.clone()),
        Op::Delete(_) => None,
    };
    script.iter().filter_map(call).collect()
}

/// The shortest script that leads from one list of calls to another (longest common subsequence).
fn align(from: &[ToolCall], to: &[ToolCall]) -> Vec<Op> {
    let mut common = vec![vec![0usize; to.len() + 1]; from.len() + 1];
    for i in (0..from.len()).rev() {
        for j in (0..to.len()).rev() {
            common[i][j] = if from[i] == to[j] {
                common[i + 1][j + 1] + 1
            } else {
                common[i + 1][j].max(common[i][j + 1])
            };
        }
    }
    let (mut i, mut j, mut script) = (0, 0, Vec::new());
    while i < from.len() || j < to.len() {
        if i < from.len() && j < to.len() && from[i] == to[j] {
            script.push(Op::Keep(from[i].clone()));
            (i, j) = (i + 1, j + 1);
        } else if j == to.len() || i < from.len() && common[i + 1][j] >= common[i][j + 1] {
            script.push(Op::Delete(from[i].clone()));
            i += 1;
        } else {
            script.push(Op::Insert(to[j].clone()));
            j += 1;
        }
    }
    script
}

/// A script as edits: a call that goes with one that comes in its place is one.
fn edits(script: &[Op], first: usize) -> Vec<Edit> {
    let (mut edits, mut at, mut free): (Vec<Edit>, usize, Vec<usize>) =
        (Vec::new(), first, Vec::new());
    for op in script {
        match op {
            Op::Keep(_) => {
                at += 1;
                free.clear();
            }
            Op::Delete(_) => {
                free.push(edits.len());
                edits.push(Edit::Delete { at });
                at += 1;
            }
            Op::Insert(call) if free.is_empty() => edits.push(Edit::Insert {
                before: at,
                call: call.clone(),
            }),
            Op::Insert(call) => {
                if let Edit::Delete { at } = edits[free[0]] {
                    edits[free.remove(0)] = Edit::Replace {
                        at,
                        call: call.clone(),
                    };
                }
            }
        }
    }
    edits
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn calls(names: &str) -> Vec<ToolCall> {
        names
            .chars()
            .map(|name| ToolCall::new(name.to_string(), json!({})))
            .collect()
    }

    #[test]
    fn a_script_leads_from_one_list_to_the_other() {
        for (from, to, changes) in [
            ("abcd", "abcd", 0),
            ("abcd", "axcd", 1),
            ("abc", "abxc", 1),
            ("abc", "ac", 1),
            ("ab", "xyz", 3),
        ] {
            let script = align(&calls(from), &calls(to));
            assert_eq!(applied(&script), calls(to));
            assert_eq!(edits(&script, 4).len(), changes, "{from} {to}: {script:?}");
        }
        let replaced = edits(&align(&calls("abc"), &calls("axc")), 4);
        assert_eq!(
            replaced,
            [Edit::Replace {
                at: 5,
                call: calls("x")[0].clone()
            }]
        );
    }
}
