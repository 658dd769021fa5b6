//! More than 500 changed traces: none is exact, and a change of meaning is named where it was made.

use std::fs;

use rayon::prelude::*;
use reel_replay::{Divergence, EpisodePosition, Verdict, verify, verify_trace};
use reel_trace::{Images, Limits, Trace};
use reel_world::{
    Digest, GraphEvent, ReceptacleId, ToolCall,
    record::{Marker, MarkerTarget, RewardTerm, StepRecord},
};
use serde_json::json;

use crate::episodes::{record, tasks, write};

/// Flipped bits in each of two files.
const FLIPS: usize = 230;

/// A changed trace, what was changed, and what replay has to say of it.
struct Case {
    what: String,
    trace: Trace,
    moment: EpisodePosition,
    body: Option<String>,
    physics_step: Option<usize>,
    /// Beginning of the field's name; empty where any field may be the first.
    field: &'static str,
}

#[test]
fn no_changed_trace_is_exact() {
    let folder = tempfile::tempdir().unwrap();
    let with_frames = record(
        &folder.path().join("with_frames.mcap"),
        &tasks()[0],
        "oracle",
        Images::Full,
    );
    let plain = record(
        &folder.path().join("plain.mcap"),
        &tasks()[0],
        "oracle",
        Images::None,
    );
    let doors = record(
        &folder.path().join("doors.mcap"),
        &tasks()[2],
        "oracle",
        Images::None,
    );
    let flips = flipped(&with_frames) + flipped(&plain);

    let bases = [Trace::read(&plain).unwrap(), Trace::read(&doors).unwrap()];
    let files: Vec<(usize, u32)> = (0..bases.len())
        .flat_map(|base| (0..bases[base].steps.len() as u32).map(move |call| (base, call)))
        .collect();
    let wrong: Vec<String> = files
        .par_iter()
        .filter_map(|(base, call)| {
            let trace = removed(&bases[*base], *call, true);
            let path = write(&folder.path().join(format!("{base}-{call}.mcap")), &trace);
            let expected = if *call as usize == trace.steps.len() { EpisodePosition::End } else { EpisodePosition::Call(*call) };
            let verdict = verify(&path);
            let named = matches!(&verdict, Verdict::Diverged { divergence } if divergence.position == expected);
            (!named).then(|| format!("episode {base} written without call {call}: {verdict}"))
        })
        .collect();
    assert!(wrong.is_empty(), "{wrong:#?}");

    let mut removals = Vec::new();
    let mut arguments = Vec::new();
    let mut outputs = Vec::new();
    for base in &bases {
        removals.extend(without_calls(base));
        arguments.extend(other_arguments(base));
        outputs.extend(other_outputs(base));
    }
    let counts = [
        flips,
        files.len(),
        removals.len(),
        arguments.len(),
        outputs.len(),
    ];
    let cases: Vec<Case> = removals
        .into_iter()
        .chain(arguments)
        .chain(outputs)
        .collect();
    let wrong: Vec<String> = cases.par_iter().filter_map(Case::wrong).collect();
    eprintln!(
        "mutations: flips, written without a call, without a call, arguments, outputs: {counts:?}"
    );
    assert!(
        wrong.is_empty(),
        "{} of {}: {wrong:#?}",
        wrong.len(),
        cases.len()
    );
    assert!(counts.iter().sum::<usize>() >= 500, "{counts:?}");
}

impl Case {
    fn new(
        what: impl Into<String>,
        trace: Trace,
        moment: EpisodePosition,
        field: &'static str,
    ) -> Self {
        Self {
            what: what.into(),
            trace,
            moment,
            body: None,
            physics_step: None,
            field,
        }
    }

    /// What replay says, where that is not what it has to say.
    fn wrong(&self) -> Option<String> {
        let verdict = verify_trace(&self.trace);
        let fits = |found: &Divergence| {
            let body = self.field.is_empty() || found.body == self.body;
            let physics_step = self.field.is_empty() || found.physics_step == self.physics_step;
            found.position == self.moment
                && found.field.starts_with(self.field)
                && body
                && physics_step
        };
        let named = matches!(&verdict, Verdict::Diverged { divergence } if fits(divergence));
        (!named).then(|| {
            format!(
                "{}: expected {:?} field '{}', got: {verdict}",
                self.what, self.moment, self.field
            )
        })
    }
}

/// Flips single bits spread over a file; every one is refused before anything is executed.
fn flipped(path: &std::path::Path) -> usize {
    let bytes = fs::read(path).unwrap();
    let accepted: Vec<String> = (0..FLIPS)
        .into_par_iter()
        .filter_map(|index| {
            let (position, bit) = (index * bytes.len() / FLIPS, index % 8);
            let mut changed = bytes.clone();
            changed[position] ^= 1 << bit;
            let trace = Trace::from_bytes(path, &changed, &Limits::default()).ok()?;
            let verdict = verify_trace(&trace);
            (!matches!(verdict, Verdict::Refused { .. }))
                .then(|| format!("bit {bit} of byte {position}: {verdict}"))
        })
        .collect();
    assert!(accepted.is_empty(), "{accepted:#?}");
    FLIPS
}

fn removed(base: &Trace, call: u32, renumber: bool) -> Trace {
    let mut trace = base.clone();
    trace.steps.remove(call as usize);
    if renumber {
        for (index, step) in trace.steps.iter_mut().enumerate() {
            step.step = index as u32;
        }
        trace.end.as_mut().unwrap().steps = trace.steps.len() as u32;
    }
    trace
}

/// Every call left out in memory, as the others were: named at the call that came next,
/// by its own number.
fn without_calls(base: &Trace) -> Vec<Case> {
    let last = base.steps.len() as u32 - 1;
    let case = |call: u32| {
        let moment = if call == last {
            EpisodePosition::End
        } else {
            EpisodePosition::Call(call + 1)
        };
        Case::new(
            format!("without call {call}, as numbered"),
            removed(base, call, false),
            moment,
            "",
        )
    };
    (0..=last).map(case).collect()
}

/// Every call with another argument, or where it has none, another call.
fn other_arguments(base: &Trace) -> Vec<Case> {
    let case = |step: &StepRecord| {
        let call = &step.input.call;
        let before = step
            .step
            .checked_sub(1)
            .map_or(&[][..], |before| &base.steps[before as usize].markers);
        let other = another(call, before, base);
        let what = format!("{call} at call {} became {other}", step.step);
        Case::new(
            what,
            changed(base, step.step, |step| step.input.call = other),
            EpisodePosition::Call(step.step),
            "",
        )
    };
    base.steps.iter().map(case).collect()
}

fn another(call: &ToolCall, markers: &[Marker], base: &Trace) -> ToolCall {
    let Some((key, value)) = call.arguments.as_object().and_then(|map| map.iter().next()) else {
        return ToolCall::new(
            if call.name == "finish" {
                "walk_around"
            } else {
                "finish"
            },
            json!({}),
        );
    };
    let value = match (value.as_u64(), call.name.as_str()) {
        (Some(marker), _) => {
            let other = markers
                .iter()
                .map(|other| u64::from(other.id))
                .find(|other| *other != marker);
            json!(other.unwrap_or(marker + 100))
        }
        (None, "nav_to") => {
            let ids = base
                .scene
                .receptacles
                .iter()
                .map(|receptacle| receptacle.id.as_str());
            json!(ids.rev().find(|id| Some(*id) != value.as_str()).unwrap())
        }
        _ => json!("volcano"),
    };
    ToolCall::new(call.name.clone(), json!({ key.as_str(): value }))
}

/// One output changed at a time, at the first, a middle and the last call, at the start
/// and at the end.
fn other_outputs(base: &Trace) -> Vec<Case> {
    let count = base.steps.len() as u32;
    let mut cases = Vec::new();
    for call in [0, count / 2, count - 1] {
        let at = |field: &'static str, change: &dyn Fn(&mut StepRecord)| {
            Case::new(
                format!("{field} at call {call}"),
                changed(base, call, change),
                EpisodePosition::Call(call),
                field,
            )
        };
        let floor = ReceptacleId::from("floor");
        let object = base.task.target.clone();
        let event = GraphEvent::Add {
            object: object.clone(),
            receptacle: floor,
        };
        cases.push(at("outcome.text", &|step| step.outcome.text.push('!')));
        cases.push(at("changes.physics", &|step| {
            step.changes.physics.push(event.clone())
        }));
        cases.push(at("reward", &|step| match step.reward.first_mut() {
            Some(term) => term.value += 0.5,
            None => step.reward.push(RewardTerm {
                component: "prog".into(),
                value: 0.5,
                reason: String::new(),
            }),
        }));
        cases.push(at("robot.yaw", &|step| {
            step.robot.yaw = next(step.robot.yaw)
        }));
        let target = MarkerTarget::Object(object.clone());
        cases.push(at("markers", &|step| {
            step.markers.push(Marker {
                id: 999,
                target: target.clone(),
            })
        }));
        cases.push(at("digests.state", &|step| {
            step.digests.state = Digest::of(b"another state")
        }));
        let body = base.steps[call as usize].bodies[0].body.clone();
        let moved = at("position[1]", &|step| {
            step.bodies[0].position[1] = next(step.bodies[0].position[1])
        });
        cases.push(Case {
            body: Some(body),
            ..moved
        });
    }
    let image = base
        .steps
        .iter()
        .find(|step| step.digests.frame.is_some())
        .unwrap()
        .step;
    let other = Digest::of(b"another image");
    let trace = changed(base, image, |step| {
        step.digests.frame.as_mut().unwrap().rgb = other
    });
    cases.push(Case::new(
        "image",
        trace,
        EpisodePosition::Call(image),
        "digests.frame.rgb",
    ));
    let moving = base
        .steps
        .iter()
        .find(|step| step.digests.physics_steps.len() > 2)
        .unwrap();
    let middle = moving.digests.physics_steps.len() / 2;
    let trace = changed(base, moving.step, |step| {
        step.digests.physics_steps[middle] ^= 1
    });
    let case = Case::new(
        "physics step",
        trace,
        EpisodePosition::Call(moving.step),
        "state digest of the physics step",
    );
    cases.push(Case {
        physics_step: Some(middle),
        ..case
    });

    let mut trace = base.clone();
    trace.start.bodies[0].position[2] = next(trace.start.bodies[0].position[2]);
    let body = Some(base.start.bodies[0].body.clone());
    cases.push(Case {
        body,
        ..Case::new("start", trace, EpisodePosition::Start, "position[2]")
    });
    let mut trace = base.clone();
    trace.end.as_mut().unwrap().metrics.total_reward += 1.0;
    cases.push(Case::new(
        "metrics",
        trace,
        EpisodePosition::End,
        "metrics.total_reward",
    ));
    cases
}

fn changed(base: &Trace, call: u32, change: impl FnOnce(&mut StepRecord)) -> Trace {
    let mut trace = base.clone();
    change(&mut trace.steps[call as usize]);
    trace
}

/// The next number that an `f32` can hold.
fn next(value: f32) -> f32 {
    f32::from_bits(value.to_bits() + 1)
}
