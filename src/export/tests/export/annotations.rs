//! Where a row's reasoning and history come from: notes, rules, or the model, whose false history
//! is mended or left out.

use std::fs;

use reel_annotate::{Annotation, Entry, Provenance, notes_path, write_notes};
use reel_dataset::Format;
use reel_export::{AnnotationSource, ExportOptions, RolloutOptions, Selection};
use reel_tables::Store;
use reel_trace::{Images, Trace};
use reel_world::record::PolicyOutput;
use tempfile::TempDir;

use crate::{episodes::write, export, options, played::play, rows};

#[test]
fn words_come_from_the_notes_beside_the_traces() {
    let dir = TempDir::new().unwrap();
    let traces = play(&dir.path().join("traces"), "oracle", Images::None);
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    store.ingest(&traces[..2], &|_, _| ()).unwrap();
    let trace = Trace::read(&traces[0]).unwrap();
    let note = Annotation {
        reasoning: "I wonder.".into(),
        history: "I went on.".into(),
        schedule: "All of it.".into(),
        subtask: "This.".into(),
    };
    let (version, steps) = (reel_world::Digest::of(b"prompt"), trace.steps.len());
    let provenance = Provenance {
        request: None,
        trace: trace.chain(),
        steps,
        annotator: "a-model".into(),
        version,
        seed: 0,
    };
    let entries = vec![Entry::from(note); steps];
    write_notes(&notes_path(&traces[0]), &provenance, &entries).unwrap();
    let report = export(
        &store,
        &dir.path().join("notes"),
        &ExportOptions {
            words: AnnotationSource::Notes,
            ..options(Format::MsSwift)
        },
    );
    assert_eq!((report.episodes, report.refused.len()), (1, 1));
    assert!(
        report.refused[0]
            .reason
            .contains("annotate the trace first"),
        "{:?}",
        report.refused
    );
    for row in rows(&dir.path().join("notes"), "train") {
        assert_eq!(
            row["provenance"]["annotator"],
            format!("a-model-{}", version.short())
        );
        assert!(
            row["messages"][1]["content"]
                .as_str()
                .unwrap()
                .starts_with("<think>I wonder.</think>")
        );
    }
}

#[test]
fn a_models_own_history_is_mended_left_out_or_left_alone() {
    let dir = TempDir::new().unwrap();
    let traces = dir.path().join("traces");
    let path = play(&traces, "oracle", Images::None).remove(0);
    // a model said of the third decision what never happened, and of the fourth what did
    let mut trace = Trace::read(&path).unwrap();
    let said = |history: &str| PolicyOutput {
        raw: "as it came".into(),
        history: history.into(),
        ..PolicyOutput::default()
    };
    trace.steps[2].input.policy = Some(said("I looked around. I placed the object on bed_1."));
    trace.steps[3].input.policy = Some(said("I looked around."));
    fs::remove_file(&path).unwrap();
    write(&path, &trace);
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    store.ingest(&[path], &|_, _| ()).unwrap();
    let export = |name: &str, how: ExportOptions| {
        let report = export(&store, &dir.path().join(name), &how);
        let row = rows(&dir.path().join(name), "train")
            .into_iter()
            .find(|row| row["provenance"]["call"] == 2);
        (
            report,
            row.map(|row| {
                row["completion"][0]["content"][0]["text"]
                    .as_str()
                    .unwrap()
                    .to_owned()
            }),
        )
    };
    let (report, row) = export("left-out", options(Format::Trl));
    assert_eq!(
        (
            report.excluded["decisions whose History contradicts the record"],
            row
        ),
        (1, None)
    );
    // it is kept under the checker's version, and not found twice
    let checked = store.checked_traces().unwrap();
    let claims: Vec<_> = checked.iter().flat_map(|trace| &trace.claims).collect();
    assert_eq!((checked.len(), claims.len(), claims[0].step), (1, 1, 2));
    reel_export::check_histories(&store, |_| ()).unwrap();
    assert_eq!(store.checked_traces().unwrap(), checked);
    let all = Selection {
        contradictions: true,
        ..Selection::default()
    };
    let (report, row) = export(
        "mended",
        ExportOptions {
            selection: all.clone(),
            ..options(Format::Trl)
        },
    );
    assert_eq!(report.history.corrected + report.history.dropped, 1);
    assert!(
        row.as_ref()
            .is_some_and(|row| row.contains("I looked around.") && !row.contains("bed_1")),
        "{row:?}"
    );
    // words that nobody exports are no reason
    let (report, row) = export(
        "rules",
        ExportOptions {
            words: AnnotationSource::Rules,
            ..options(Format::Trl)
        },
    );
    assert!(
        !report
            .excluded
            .contains_key("decisions whose History contradicts the record"),
        "{:?}",
        report.excluded
    );
    assert!(row.is_some_and(|row| !row.contains("bed_1")));
    // what is rewarded is what was said
    let alone = RolloutOptions {
        group_size: Some(1),
        ..RolloutOptions::default()
    };
    let (report, row) = export(
        "rollouts",
        ExportOptions {
            selection: all,
            rollouts: Some(alone),
            ..options(Format::Trl)
        },
    );
    assert_eq!(report.history.corrected + report.history.dropped, 0);
    assert!(row.is_some_and(|row| row.contains("I placed the object on bed_1.")));
}
