//! What a record without sight leaves open of a reward, and what it does not.

use std::sync::Arc;

use proptest::prelude::*;
use reel_reward::{OpenReward, Preset, RewardBounds, open_reward, reward_bounds, rewards};
use reel_world::{
    Task,
    record::{GraphChanges, StepRecord},
};

use crate::{
    REPLY, close,
    flat::{Act, Flat, GREEN, RED, start, task},
    sum,
};

fn bounds(task: &Task, steps: &[StepRecord]) -> Option<RewardBounds> {
    let (_, scene) = crate::flat::task();
    reward_bounds(&Preset::paper(), task, &scene, &start(task), steps)
}

#[test]
fn a_question_is_open_unless_what_was_told_decides_it() {
    use Act::*;
    let (mut task, _) = task();
    let of = |task: &Task, script: &[Act]| bounds(task, &Flat::play(task, script).steps);
    // Two apples stand there, and nothing says whether the camera saw them.
    let open = of(&task, &[Nav("table_1"), Ask("Look closely.")]).unwrap();
    assert_eq!(open.first_step, 1);
    close(open.lower, 1.9);
    close(open.upper, 2.9);
    assert_eq!(
        open.to_string(),
        "nothing tells what the camera saw, and from step 1 on the reward for asking depends on \
         it: the total lies between 1.900 and 2.900"
    );
    // Both were listed.
    assert_eq!(of(&task, &[Look("table_1"), Ask("Look closely.")]), None);
    // Only one question pays, and it is open which.
    let asks = [Ask("Look closely."), Look("table_1"), Ask("Look closely.")];
    let open = of(&task, &asks).unwrap();
    assert_eq!(open.first_step, 0);
    close(open.lower, open.upper);
    assert_eq!(of(&task, &[Nav("table_1"), Finish]), None);
    // No question pays in a precise task without distractors.
    (task.fuzzy, task.purpose) = (false, None);
    task.objects
        .retain(|object| object.instance.as_str() != GREEN);
    task.initial.remove(&"table_1".into(), &GREEN.into());
    task.goal.remove(&"table_1".into(), &GREEN.into());
    assert_eq!(of(&task, &[Nav("table_1"), Ask("Look closely.")]), None);
}

#[test]
fn a_world_that_no_result_shows_leaves_everything_open() {
    use Act::*;
    let (task, scene) = task();
    let script = [Look("table_1"), Pick(RED), Nav("fridge_0"), Finish];
    let mut steps = Flat::play(&task, &script).steps;
    let of = |steps: &[StepRecord]| {
        let known = [Arc::new(task.clone())];
        open_reward(
            &Preset::paper(),
            &known,
            &task,
            &scene,
            &start(&task),
            steps,
        )
    };
    assert_eq!(of(&steps), None);
    for step in &mut steps {
        step.changes = GraphChanges::default();
        (step.object, step.receptacle) = (None, None);
    }
    let open = of(&steps).unwrap();
    assert_eq!(open, OpenReward::WorldUnknown { first_step: 1 });
    assert_eq!(
        open.to_string(),
        "no result shows the world, and from step 1 on success, completion and reward depend on \
         it: they are those of a world in which nothing changed"
    );
}

fn any_act() -> impl Strategy<Value = Act> {
    prop_oneof![
        2 => prop::sample::select(vec!["table_1", "desk_1", "fridge_0"]).prop_map(Act::Nav),
        3 => prop::sample::select(vec!["table_1", "desk_1"]).prop_map(Act::Look),
        4 => prop::sample::select(vec![REPLY, "Look around.", "Not the green one."]).prop_map(Act::Ask),
        1 => prop::sample::select(vec![RED, GREEN]).prop_map(Act::Pick),
        1 => Just(Act::Place("table_1")),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, failure_persistence: None, ..ProptestConfig::default() })]

    /// A record without images, in which only some of what was seen is told, and the one with
    /// everything.
    #[test]
    fn the_reward_of_who_saw_everything_lies_between_the_bounds(
        script in prop::collection::vec((any_act(), any::<bool>()), 0..16),
        several in any::<bool>(),
    ) {
        let (mut task, scene) = task();
        if several {
            // Two questions pay: the instruction fits two tables.
            task.src_distractors = vec!["desk_1".into()];
            task.instruction = "Take an apple and put it into the fridge.".into();
        }
        let (acts, tells): (Vec<Act>, Vec<bool>) = script.into_iter().unzip();
        let whole = Flat::play(&task, &acts).steps;
        let mut record = whole.clone();
        for (step, tells) in record.iter_mut().zip(tells) {
            step.visible.clear();
            if !tells {
                step.listed.clear();
            }
        }
        let preset = Preset::paper();
        let of = |steps: &[StepRecord]| rewards(&preset, &task, &scene, &start(&task), steps);
        let values = |steps: &[StepRecord]| -> Vec<f64> { of(steps).iter().map(|terms| sum(terms)).collect() };
        let (seen, told) = (values(&whole), values(&record));
        match bounds(&task, &record) {
            None => prop_assert_eq!(seen, told),
            Some(bounds) => {
                let total: f64 = seen.iter().sum();
                prop_assert!(bounds.lower - 1e-9 <= total && total <= bounds.upper + 1e-9);
                let first = bounds.first_step as usize;
                prop_assert_eq!(&seen[..first], &told[..first]);
            }
        }
    }
}
