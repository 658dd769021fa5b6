//! Traces as files of the evaluation client, and back.

use std::{fs, path::Path, sync::Arc};

use reel_import::{
    ImportOptions,
    eval_client::{RunSettings, replay::RecordedRun, run},
};
use reel_reward::{Preset, reward_bounds, rewards};
use reel_trace::Trace;
use reel_vectors::golden_traces;
use reel_world::{Scenes, Tool, ToolCall, record::RewardTerm};
use serde_json::{Map, Value, json};

use crate::imported_with;

fn settings(out: &Path) -> RunSettings {
    RunSettings {
        out: out.to_owned(),
        model: "m/x".to_owned(),
        prefix: "reel".to_owned(),
        steps_max: u32::MAX,
        start_idx: 0,
        end_idx: 999_999,
        metadata: Map::new(),
        run_tag: "t".to_owned(),
    }
}

#[test]
fn a_trace_written_as_eval_output_reads_back_as_the_same_episode() {
    for path in golden_traces() {
        let folder = tempfile::tempdir().unwrap();
        let (root, out) = (
            folder.path().join("eval_output"),
            folder.path().join("traces"),
        );
        fs::create_dir_all(&out).unwrap();
        let trace = Trace::read(&path).unwrap();
        let results = run(
            &settings(&root),
            &mut RecordedRun::new(
                &reel_trace::TraceFiles::default(),
                std::slice::from_ref(&path),
            ),
        )
        .unwrap();
        assert_eq!(results["total"], 1, "{}", path.display());
        let written: Value =
            serde_json::from_slice(&fs::read(root.join("reel_results_m_x_t.json")).unwrap())
                .unwrap();
        assert_eq!(written, results);

        if trace.steps.is_empty() {
            continue;
        }
        let episodes = reel_import::episodes(&root).unwrap();
        let tasks = [Arc::new((*trace.task).clone())];
        let scenes = Scenes::from(trace.scene.clone());
        let options = ImportOptions {
            run_id: "again",
            tasks: &tasks,
            scenes: Some(&scenes),
        };
        let (report, again) = imported_with(&episodes[0], &out, &options);
        assert_eq!(report.losses, [], "{}", path.display());
        let tools = |trace: &Trace| -> Vec<Result<Tool, ToolCall>> {
            trace
                .steps
                .iter()
                .map(|step| Tool::parse(&step.input.call).map_err(|_| step.input.call.clone()))
                .collect()
        };
        for (tool, read) in tools(&trace).iter().zip(&tools(&again)) {
            assert!(
                tool == read || tool.is_err(),
                "{}: {tool:?} {read:?}",
                path.display()
            );
        }
        assert_eq!(trace.steps.len(), again.steps.len());
        assert_eq!(again.start.graphs.registry, trace.start.graphs.registry);
        let end = trace.end.as_ref().unwrap();
        assert_eq!(
            again.end.as_ref().unwrap().graphs.registry,
            end.graphs.registry,
            "{}",
            path.display()
        );
        assert_eq!(
            again.end.as_ref().unwrap().reason,
            end.reason,
            "{}",
            path.display()
        );
        if end.graphs.registry == end.graphs.physics {
            assert_eq!(
                report.success,
                Some(end.metrics.success),
                "{}",
                path.display()
            );
        }
        let held = |trace: &Trace| {
            trace
                .steps
                .iter()
                .map(|step| step.held.clone())
                .collect::<Vec<_>>()
        };
        // `finish` shows the graph alone, so that what was held before stays known.
        assert_eq!(held(&again), held(&trace), "{}", path.display());
        let failed = |trace: &Trace| -> Vec<bool> {
            let steps = trace.steps.iter();
            steps.map(|step| !step.outcome.is_ok()).collect()
        };
        assert_eq!(failed(&again), failed(&trace), "{}", path.display());
        // The rules of the taxonomy read the History.
        let histories = |trace: &Trace| -> Vec<String> {
            let policies = trace.steps.iter().map(|step| &step.input.policy);
            policies
                .map(|policy| {
                    policy
                        .as_ref()
                        .map_or_else(String::new, |it| it.history.clone())
                })
                .collect()
        };
        assert_eq!(histories(&again), histories(&trace), "{}", path.display());
        // Rewards are those of the trace, under every preset, or lie where the import says.
        for preset in Preset::built_in() {
            let of = |trace: &Trace| -> Vec<Vec<(String, u64)>> {
                let terms = rewards(
                    &preset,
                    &trace.task,
                    &trace.scene,
                    &trace.start,
                    &trace.steps,
                );
                let paid = |term: RewardTerm| (term.component, term.value.to_bits());
                terms
                    .into_iter()
                    .map(|terms| terms.into_iter().map(paid).collect())
                    .collect()
            };
            let (own, read) = (of(&trace), of(&again));
            let bounds = reward_bounds(
                &preset,
                &again.task,
                &again.scene,
                &again.start,
                &again.steps,
            );
            let first = bounds
                .as_ref()
                .map_or(own.len(), |bounds| bounds.first_step as usize);
            let (path, name) = (path.display(), preset.name());
            assert_eq!(read[..first], own[..first], "{path} under {name}");
            if let Some(bounds) = bounds {
                let total: f64 = own
                    .iter()
                    .flatten()
                    .map(|(_, value)| f64::from_bits(*value))
                    .sum();
                assert!(
                    bounds.lower - 1e-9 <= total && total <= bounds.upper + 1e-9,
                    "{path} under {name}: {total}, {bounds}"
                );
            }
        }
    }
}

#[test]
fn episodes_of_a_folder_that_is_not_empty_are_skipped() {
    let folder = tempfile::tempdir().unwrap();
    let paths = golden_traces();
    let run = |tag: &str| {
        let settings = RunSettings {
            run_tag: tag.to_owned(),
            ..settings(folder.path())
        };
        run(
            &settings,
            &mut RecordedRun::new(&reel_trace::TraceFiles::default(), &paths[..1]),
        )
        .unwrap()
    };
    assert_eq!(run("first")["skipped"], 0);
    let again = run("second");
    assert_eq!((&again["skipped"], &again["total"]), (&json!(1), &json!(1)));
}
