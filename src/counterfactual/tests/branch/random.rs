//! Random branches, up to three deep, of episodes of all kinds of policies, and of what was
//! compacted or broke off and was recovered on the way. Each verifies against its parent,
//! to the last bit. `REEL_BRANCHES` says how many; a failure prints the number that makes
//! it again alone (`REEL_BRANCH=n`).

use std::{
    env, mem,
    sync::atomic::{AtomicUsize, Ordering},
};

use rayon::prelude::*;
use reel_agents::POLICIES;
use reel_counterfactual::branch::{Branch, Continuation};
use reel_replay::{compact, verify_branch};
use reel_reward::{Preset, metrics};
use reel_trace::{Images, Recorder, Trace, recover};
use reel_world::{Digest, ToolCall, record::EndReason};
use serde_json::json;

use crate::{episodes::tasks, folder::Folder};

/// Numbers drawn from a key.
struct Draw {
    key: String,
    count: u64,
}

impl Draw {
    fn below(&mut self, bound: usize) -> usize {
        self.count += 1;
        let digest = Digest::of(format!("{}/{}", self.key, self.count).as_bytes());
        let (number, _) = digest.0.split_first_chunk::<8>().unwrap();
        (u64::from_le_bytes(*number) % bound as u64) as usize
    }
}

#[test]
fn random_branches_verify_against_their_parents() {
    let number = |name: &str| {
        env::var(name)
            .ok()
            .and_then(|text| text.parse::<usize>().ok())
    };
    let wanted = number("REEL_BRANCHES").unwrap_or(12);
    let indices: Vec<usize> =
        number("REEL_BRANCH").map_or_else(|| (0..wanted).collect(), |index| vec![index]);
    let folder = Folder::new();
    let names: Vec<&str> = POLICIES.iter().map(|(name, _)| *name).collect();
    let pairs: Vec<(usize, &str)> = (0..4)
        .flat_map(|task| names.iter().map(move |name| (task, *name)))
        .collect();
    // Few branches need few parents.
    let step = (pairs.len() / indices.len().max(1)).max(1);
    let bases: Vec<Trace> = pairs
        .into_par_iter()
        .step_by(step)
        .map(|(task, name)| {
            folder.play(
                &tasks()[task],
                name,
                if task == 0 {
                    Images::Full
                } else {
                    Images::None
                },
            )
        })
        .collect();
    let [branches, compacted, recovered, deep] = [(); 4].map(|()| AtomicUsize::new(0));
    indices.par_iter().for_each(|index| {
        let mut draw = Draw {
            key: format!("branch/{index}"),
            count: 0,
        };
        let mut parent = bases[index % bases.len()].clone();
        let depth = 1 + draw.below(3);
        for level in 0..depth {
            let ended = parent
                .end
                .as_ref()
                .is_some_and(|end| end.reason != EndReason::Aborted);
            let at = draw.below(parent.steps.len() + usize::from(!ended));
            let branch = any_branch(&mut draw, &parent, at);
            let images = if draw.below(6) == 0 {
                Images::Full
            } else {
                Images::None
            };
            let made = folder.branch(&branch, &parent, at, images);
            let again = || format!("REEL_BRANCH={index}, level {level}: {branch:?} at {at}");
            let check = |made: &Trace, how: &str| {
                let descent = verify_branch(made, &parent);
                assert!(descent.holds(), "{}, {how}: {descent:?}", again());
            };
            check(&made, "as recorded");
            assert_ne!(
                made.header.episode_id,
                parent.header.episode_id,
                "{}",
                again()
            );
            let whole = mem::replace(&mut parent, made);
            let made = &parent;
            let next = match draw.below(3) {
                0 => {
                    let path = folder.next();
                    compact(made, &path, false).unwrap();
                    compacted.fetch_add(1, Ordering::Relaxed);
                    Some(Trace::read(&path).unwrap())
                }
                1 if made.steps.len() > 1 => {
                    recovered.fetch_add(1, Ordering::Relaxed);
                    Some(broken_off(
                        &folder,
                        made,
                        1 + draw.below(made.steps.len() - 1),
                    ))
                }
                _ => None,
            };
            if let Some(next) = next {
                let descent = verify_branch(&next, &whole);
                assert!(
                    descent.holds(),
                    "{}, compacted or recovered: {descent:?}",
                    again()
                );
                parent = next;
            }
            branches.fetch_add(1, Ordering::Relaxed);
            deep.fetch_add(usize::from(level == 2), Ordering::Relaxed);
        }
    });
    let [branches, compacted, recovered, deep] =
        [branches, compacted, recovered, deep].map(AtomicUsize::into_inner);
    eprintln!(
        "{branches} branches of {} episodes, {deep} at the third level; {compacted} compacted, {recovered} recovered",
        bases.len()
    );
    assert!(branches >= indices.len());
}

/// A few calls of the parent's, at another time, or nonsense; then nothing, the
/// parent, or any policy.
fn any_branch(draw: &mut Draw, parent: &Trace, at: usize) -> Branch {
    let mut calls = Vec::new();
    for _ in 0..draw.below(4) {
        calls.push(match draw.below(5) {
            0 => ToolCall::new("pick", json!({ "marker_id": draw.below(6) })),
            1 => ToolCall::new("show_receptacles", json!({})),
            2 => ToolCall::new("nav_to", json!({ "receptacle_name": parent.task.dest })),
            3 => ToolCall::new(
                "ask",
                json!({ "question": "Which of them?", "why": draw.below(100) }),
            ),
            _ => parent.steps[draw.below(parent.steps.len())]
                .input
                .call
                .clone(),
        });
    }
    let then = match draw.below(4) {
        0 if !calls.is_empty() => Continuation::Stop,
        1 if at < parent.steps.len() => {
            Continuation::Parent(at + draw.below(parent.steps.len() - at))
        }
        _ => Continuation::Policy {
            name: POLICIES[draw.below(POLICIES.len())].0.to_owned(),
            seed: draw.below(9) as u64,
        },
    };
    Branch {
        calls,
        continuation: then,
    }
}

/// The same recording, but its recorder died after so many calls, and it was recovered.
fn broken_off(folder: &Folder, trace: &Trace, calls: usize) -> Trace {
    let path = folder.next();
    let mut recorder = Recorder::create(
        &path,
        &trace.header,
        &trace.task,
        &trace.scene,
        Images::None,
    )
    .unwrap();
    recorder.start(&trace.start, None).unwrap();
    for step in &trace.steps[..calls] {
        recorder.input(step.step, &step.input).unwrap();
        recorder.step(step, None).unwrap();
    }
    drop(recorder);
    let score = |trace: &Trace, graphs: &_| {
        metrics(
            &Preset::paper(),
            &trace.task,
            &trace.start,
            &trace.steps,
            graphs,
        )
    };
    let recovery = recover(&path.with_added_extension("part"), None, score).unwrap();
    Trace::read(&recovery.trace).unwrap()
}
