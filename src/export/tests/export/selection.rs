//! Which decisions become examples: no mistakes, but recoveries, and no tool beyond the median.

use reel_dataset::Format;
use reel_export::{ExportOptions, Selection};
use reel_tables::Store;
use reel_trace::Images;
use tempfile::TempDir;

use crate::{export, options, played::play};

#[test]
fn mistakes_are_no_examples_but_recoveries_are() {
    let dir = TempDir::new().unwrap();
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    store
        .ingest(
            &play(&dir.path().join("traces"), "wrong-object", Images::None),
            &|_, _| (),
        )
        .unwrap();
    let count = |name: &str, selection: Selection| {
        let report = export(
            &store,
            &dir.path().join(name),
            &ExportOptions {
                selection,
                ..options(Format::Trl)
            },
        );
        (
            report.episodes,
            report.examples.values().sum::<u64>(),
            report.excluded,
        )
    };
    let all = Selection {
        failed: true,
        mistakes: true,
        ..Selection::default()
    };
    let (episodes, everything, left_out) = count("all", all.clone());
    assert!(episodes > 0 && left_out.is_empty(), "{left_out:?}");
    let (_, without, left_out) = count(
        "without",
        Selection {
            mistakes: false,
            ..all.clone()
        },
    );
    let mistakes = left_out["decisions that were mistakes"];
    assert!(mistakes > 0);
    assert_eq!(without + mistakes, everything);
    let (_, fewer, left_out) = count(
        "fewer",
        Selection {
            mistakes: false,
            recoveries: false,
            ..all.clone()
        },
    );
    assert_eq!(
        fewer + mistakes + left_out["decisions right after a mistake"],
        everything
    );
    let (episodes, none, left_out) = count("won", Selection::default());
    assert_eq!(
        left_out
            .get("episodes that did not succeed")
            .copied()
            .unwrap_or(0)
            + episodes,
        4,
        "{none}"
    );
    // at most one a task, and no tool beyond the median
    let (_, balanced, left_out) = count(
        "balanced",
        Selection {
            balance_tools: true,
            ..all
        },
    );
    assert_eq!(
        balanced + left_out["decisions beyond the median tool's"],
        everything
    );
}
