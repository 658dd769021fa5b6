//! What differs is explained: every field with its distance, the image, the text, the state at a
//! physics step. Traces are written again as another build might have recorded them: changed, with
//! checksums and chain that hold.

use std::collections::BTreeMap;

use reel_replay::{
    EpisodePosition, Verdict, body_changes, compact, expand, explain, first_divergence,
    replay_with, state_at,
};
use reel_trace::{Images, Recorder, Trace};
use reel_world::{FRAME_WIDTH, Frame};

use crate::episodes::{record, tasks};

#[test]
fn every_differing_field_is_named_with_its_distance_and_the_text_by_words() {
    let folder = tempfile::tempdir().unwrap();
    let base = Trace::read(&record(
        &folder.path().join("a.mcap"),
        &tasks()[0],
        "oracle",
        Images::None,
    ))
    .unwrap();
    let exact = explain(&base);
    assert!(
        exact.verdict.is_exact()
            && exact.fields.is_empty()
            && exact.text.is_none()
            && exact.image.is_none()
    );

    let mut other = base.clone();
    let step = other
        .steps
        .iter_mut()
        .find(|step| step.digests.physics_steps.len() > 20)
        .unwrap();
    let call = step.step;
    step.bodies[0].position[1] = step.bodies[0].position[1].next_up().next_up();
    step.bodies[0].linear_velocity[2] -= 1.0;
    step.digests.physics_steps[11] ^= 1;
    step.outcome.text = step.outcome.text.replacen(' ', " never ", 1);
    let name = step.bodies[0].body.clone();
    let explanation = explain(&other);
    let Verdict::Diverged { divergence } = &explanation.verdict else {
        panic!("{}", explanation.verdict)
    };
    assert_eq!(
        (divergence.position, divergence.physics_step),
        (EpisodePosition::Call(call), Some(11))
    );
    let field = |name: &str| {
        explanation
            .fields
            .iter()
            .find(|change| change.field == name)
            .unwrap()
    };
    assert_eq!(
        (
            field("position[1]").body.as_ref(),
            field("position[1]").ulps
        ),
        (Some(&name), Some(2))
    );
    assert!(field("linear_velocity[2]").ulps.unwrap() > 1000);
    assert!(
        explanation.text.as_ref().unwrap().contains("[-never"),
        "{:?}",
        explanation.text
    );
    assert!(
        explanation
            .fields
            .last()
            .unwrap()
            .field
            .starts_with("digests")
    );

    let states = state_at(&base, EpisodePosition::Call(call), 11)
        .unwrap()
        .unwrap();
    assert_eq!(explanation.bodies.as_ref(), Some(&states));
    let last = base.steps[call as usize].digests.physics_steps.len() - 1;
    assert_eq!(
        state_at(&base, EpisodePosition::Call(call), last)
            .unwrap()
            .unwrap(),
        base.steps[call as usize].bodies
    );
    assert_eq!(
        state_at(&base, EpisodePosition::Call(call), last + 1).unwrap(),
        None
    );
    let settled = base.start.digests.physics_steps.len() - 1;
    assert_eq!(
        state_at(&base, EpisodePosition::Start, settled)
            .unwrap()
            .unwrap(),
        base.start.bodies
    );
    let changes = body_changes(&base.start.bodies, &states);
    assert!(
        changes
            .iter()
            .all(|change| change.body.is_some() && change.recorded != change.replayed)
    );

    let found = first_divergence(&base, &other).unwrap();
    assert_eq!(
        (found.position, found.physics_step),
        (EpisodePosition::Call(call), Some(11))
    );
    assert_eq!(first_divergence(&base, &base), None);
    let mut shorter = base.clone();
    shorter.end = None;
    shorter.steps.pop();
    assert_eq!(
        first_divergence(&base, &shorter).map(|found| found.position),
        Some(EpisodePosition::End)
    );
}

#[test]
fn a_differing_image_is_measured() {
    let folder = tempfile::tempdir().unwrap();
    let base = Trace::read(&record(
        &folder.path().join("a.mcap"),
        &tasks()[1],
        "oracle",
        Images::Full,
    ))
    .unwrap();
    let mut frames: BTreeMap<Option<u32>, Frame> = BTreeMap::new();
    replay_with(&base, |step, frame| {
        drop(frames.insert(step, frame.clone()))
    })
    .unwrap();
    let call = base
        .steps
        .iter()
        .find(|step| step.digests.frame.is_some())
        .unwrap()
        .step;
    let mut other = base.clone();
    let frame = frames.get_mut(&Some(call)).unwrap();
    for (x, y) in [(40, 30), (41, 33)] {
        let value = &mut frame.rgb[(y * FRAME_WIDTH + x) * 3 + 1];
        *value = if *value > 100 { *value - 7 } else { *value + 7 };
    }
    other.steps[call as usize].digests.frame = Some(frame.digests());
    let path = folder.path().join("b.mcap");
    let mut recorder = Recorder::create(
        &path,
        &other.header,
        &other.task,
        &other.scene,
        Images::Full,
    )
    .unwrap();
    recorder.start(&other.start, frames.get(&None)).unwrap();
    for step in &other.steps {
        recorder.input(step.step, &step.input).unwrap();
        recorder.step(step, frames.get(&Some(step.step))).unwrap();
    }
    recorder.end(other.end.as_ref().unwrap()).unwrap();

    let explanation = explain(&Trace::read(&path).unwrap());
    let change = explanation.image.unwrap();
    assert_eq!(
        (change.pixels, change.bbox, change.most),
        (Some(2), Some([40, 30, 41, 33]), Some(7))
    );
    assert!(change.recorded.is_some() && change.replayed.is_some());
}

#[test]
fn compact_drops_what_expand_brings_back_and_nothing_that_it_could_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let full = record(&path("full.mcap"), &tasks()[3], "gibberish", Images::Full);
    let lean = record(&path("lean.mcap"), &tasks()[3], "gibberish", Images::None);
    let read = |path: &std::path::Path| std::fs::read(path).unwrap();

    compact(&Trace::read(&full).unwrap(), &path("compacted.mcap"), true).unwrap();
    assert!(
        read(&path("compacted.mcap")) == read(&lean),
        "compacting gives other bytes than recording without images"
    );
    expand(
        &Trace::read(&path("compacted.mcap")).unwrap(),
        &path("expanded.mcap"),
    )
    .unwrap();
    assert!(
        read(&path("expanded.mcap")) == read(&full),
        "expanding gives other bytes than recording with images"
    );

    let mut other = Trace::read(&full).unwrap();
    other.steps[0].robot.yaw += 1.0;
    let refused = compact(&other, &path("never.mcap"), true)
        .unwrap_err()
        .to_string();
    assert!(
        refused.contains("robot.yaw") && !path("never.mcap").exists(),
        "{refused}"
    );
}
