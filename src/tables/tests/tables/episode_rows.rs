//! What a row of an episode holds: all of its trace, nulls where it broke off; synthetic rows hold
//! possible steps.

use std::collections::BTreeSet;

use arrow::{
    array::{Array, AsArray, RecordBatch},
    datatypes::{Decimal128Type, Float64Type, Int32Type},
};
use reel_tables::{Store, Table, episode_batch};
use reel_trace::Images;
use reel_world::{ErrorCode, Family, Tool, ToolCall, ToolSpec, record::EndReason};
use tempfile::TempDir;

use crate::{
    batches, nested,
    play::{DISTRACTOR, Play, TARGET, success},
    texts,
};

#[test]
fn a_trace_becomes_a_row_with_all_that_belongs_to_it() {
    let dir = TempDir::new().unwrap();
    let one = success("oracle", Family::SUL, u64::MAX).record(dir.path(), Images::None);
    let two = Play::new("lost", Family::SUL, 2)
        .nav("table_1")
        .fails("pick", ErrorCode::DoorClosed)
        .ended(EndReason::Horizon);
    let two = two.record(dir.path(), Images::None);
    let episodes = episode_batch(&[one, two]).unwrap();
    assert_eq!(
        texts(&episodes, "policy"),
        [Some("oracle".into()), Some("lost".into())]
    );
    assert_eq!(
        texts(&episodes, "end_reason"),
        [Some("finished".into()), Some("horizon".into())]
    );
    assert_eq!(
        episodes["seed"].as_primitive::<Decimal128Type>().value(0),
        i128::from(u64::MAX)
    );
    assert!(
        episodes["success"].as_boolean().value(0) && !episodes["success"].as_boolean().value(1)
    );
    assert_eq!(
        nested(&episodes, "start_objects", 0).num_rows(),
        1,
        "the start shows one clock"
    );
    assert_eq!(nested(&episodes, "start_changes", 0).num_rows(), 0);
    let steps = nested(&episodes, "steps", 0);
    assert_eq!(steps.num_rows(), 7);
    assert_eq!(
        texts(&steps, "argument")[..3],
        [
            Some("table_1".into()),
            Some("alarm clock".into()),
            Some("Which one?".into())
        ]
    );
    assert_eq!(
        texts(&steps, "reply")[2].as_deref(),
        Some("The white one, please.")
    );
    assert_eq!(
        steps["candidate_count"]
            .as_primitive::<Int32Type>()
            .values()[..2],
        [2, 2],
        "the start shows one clock, the first call the other"
    );
    let pick = 3;
    assert_eq!(texts(&steps, "object")[pick].as_deref(), Some(TARGET));
    assert!(
        steps["goal_object"].as_boolean().value(pick)
            && !steps["goal_receptacle"].as_boolean().value(pick)
    );
    assert!(steps["goal_receptacle"].as_boolean().value(5));
    let events = |step: usize| texts(&nested(&steps, "changes", step), "event");
    assert_eq!(
        events(pick),
        [Some("remove".into()), Some("remove".into())],
        "by both authorities"
    );
    assert_eq!(events(5), [Some("add".into()), Some("add".into())]);
    let marked: Vec<_> = (0..7)
        .flat_map(|step| texts(&nested(&steps, "marker_map", step), "id"))
        .collect();
    assert_eq!(marked, [Some(TARGET.into()), Some(DISTRACTOR.into())]);
    let failed = nested(&episodes, "steps", 1);
    assert_eq!(
        texts(&failed, "error_code"),
        [None, Some("door_closed".into())]
    );
    assert_eq!(
        texts(&failed, "error_class"),
        [None, Some("moderate".into())]
    );
    let term = |steps: &RecordBatch, step| {
        nested(steps, "terms", step)["value"]
            .as_primitive::<Float64Type>()
            .values()
            .to_vec()
    };
    let terms = (0..7)
        .flat_map(|step| term(&steps, step))
        .chain((0..2).flat_map(|step| term(&failed, step)));
    assert!((terms.sum::<f64>() - (3.0 - 9.0 * 0.03)).abs() < 1e-9);
}

#[test]
fn a_broken_off_recording_is_an_episode_without_an_end() {
    let dir = TempDir::new().unwrap();
    let path = Play::new("killed", Family::FDP, 1)
        .nav("table_1")
        .record_as(&dir.path().join("a.mcap"), Images::None);
    let trace = reel_trace::Trace::read(&path).unwrap();
    let episodes = episode_batch(&[trace]).unwrap();
    assert!(episodes["end_reason"].is_null(0) && episodes["success"].is_null(0));
}

/// What was made up could have been recorded: every call is one of a tool, every failure has a
/// code, its class and the text of that code.
#[test]
fn synthetic_steps_are_possible_ones() {
    #[derive(serde::Deserialize)]
    struct Row {
        steps: Vec<Step>,
    }
    #[derive(serde::Deserialize)]
    struct Step {
        tool: String,
        call_name: String,
        arguments: String,
        text: String,
        error_code: Option<String>,
        error_class: Option<String>,
    }
    let dir = TempDir::new().unwrap();
    let trace = success("oracle", Family::FDP, 1).record(dir.path(), Images::None);
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    let (tasks, scene) = ([trace.task.clone()], &trace.scene);
    reel_tables::synthesize(&mut store, &tasks, scene, 400, 7, |_| ()).unwrap();
    let mut codes = BTreeSet::new();
    for batch in batches(&store, Table::Episodes) {
        let rows: Vec<Row> = reel_tables::rows_from(&batch).unwrap();
        for step in rows.into_iter().flat_map(|row| row.steps) {
            let arguments = serde_json::from_str(&step.arguments).unwrap();
            let call = ToolCall::new(&step.call_name, arguments);
            assert!(Tool::parse(&call).is_ok(), "{call}");
            assert_eq!(ToolSpec::by_name(&step.tool).unwrap().paper_name, step.tool);
            let code = step.error_code.map(|code| ErrorCode::parse(&code).unwrap());
            assert_eq!(ErrorCode::from_message(&step.text), code, "{}", step.text);
            let class = code.map(|code| format!("{:?}", code.class()).to_lowercase());
            assert_eq!(step.error_class, class);
            codes.extend(code);
        }
    }
    assert_eq!(codes.len(), 3);
}
