//! Every row names its verified trace; what cannot be trusted is refused.

use std::{fs, path::Path};

use reel_dataset::{Format, Split};
use reel_export::ExportOptions;
use reel_tables::Store;
use reel_trace::Images;
use tempfile::TempDir;

use crate::{
    episodes::{record_seeded, tasks},
    export, options,
    played::{Played, play},
    rows,
};

#[test]
fn every_row_names_its_verified_trace_and_what_cannot_be_trusted_is_refused() {
    let dir = TempDir::new().unwrap();
    let traces = dir.path().join("traces");
    let good = play(&traces, "oracle", Images::None);
    // one whose outcome is not what its inputs give; and after ingest one that was changed, one
    // recorded anew, one that is gone
    let Played {
        diverging,
        changed,
        renewed,
        gone,
    } = Played::spoilt(&traces);
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    let paths: Vec<_> = good
        .iter()
        .chain([&diverging, &changed, &renewed, &gone])
        .cloned()
        .collect();
    let ingested = store.ingest(&paths, &|_, _| ()).unwrap();
    assert_eq!(
        (ingested.added, ingested.quarantined.len()),
        (8, 0),
        "{:?}",
        ingested.quarantined
    );
    fs::remove_file(&renewed).unwrap();
    record_seeded(&renewed, &tasks()[0], "oracle", 99, Images::None);
    let mut bytes = fs::read(&changed).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&changed, bytes).unwrap();
    fs::remove_file(&gone).unwrap();

    let report = export(&store, &dir.path().join("sft"), &options(Format::Trl));
    assert_eq!((report.episodes, report.unverified), (4, 0));
    let reason = |path: &Path| {
        let path = path.display().to_string();
        report
            .refused
            .iter()
            .find(|refusal| refusal.trace == path)
            .map(|refusal| refusal.reason.clone())
            .unwrap()
    };
    assert_eq!(report.refused.len(), 4, "{:?}", report.refused);
    assert!(
        reason(&renewed).starts_with("the file holds another recording"),
        "{}",
        reason(&renewed)
    );
    assert!(
        reason(&diverging).starts_with("diverged_without_rgb: DIVERGED"),
        "{}",
        reason(&diverging)
    );
    assert!(
        reason(&changed).starts_with("refused: "),
        "{}",
        reason(&changed)
    );
    assert!(
        reason(&gone).starts_with("the trace cannot be read"),
        "{}",
        reason(&gone)
    );
    let rows = rows(&dir.path().join("sft"), "train");
    assert_eq!(rows.len() as u64, report.examples[&Split::Train]);
    for row in &rows {
        let row = row["provenance"].as_object().unwrap();
        assert_eq!(
            (row["verdict"].as_str(), row["preset"].as_str()),
            (Some("exact_without_rgb"), Some("paper"))
        );
        assert_eq!(row["table_version"], store.version());
        assert!(
            good.iter()
                .any(|path| row["trace_uri"] == path.display().to_string())
        );
        for digest in ["trace_digest", "preset_digest"] {
            assert_eq!(row[digest].as_str().unwrap().len(), 64);
        }
    }

    // a second export replays nothing; asked for, the unverified come too, and say so
    assert_eq!(store.verdicts().unwrap().len(), 7);
    let known = ExportOptions {
        replay: false,
        ..options(Format::Trl)
    };
    assert_eq!(
        export(&store, &dir.path().join("known"), &known).episodes,
        4
    );
    assert_eq!(store.verdicts().unwrap().len(), 7);
    // rows with images need the colours compared, too; those without need no more than that
    let with_images = ExportOptions {
        images: true,
        ..options(Format::Trl)
    };
    export(&store, &dir.path().join("images"), &with_images);
    export(&store, &dir.path().join("again"), &options(Format::Trl));
    let verdicts = store.verdicts().unwrap();
    let count = |name| verdicts.iter().filter(|row| row.verdict == name).count();
    assert_eq!(
        [
            count("exact_without_rgb"),
            count("exact"),
            count("diverged_without_rgb"),
            count("diverged")
        ],
        [5, 5, 1, 1]
    );
    let all = ExportOptions {
        allow_unverified: true,
        ..options(Format::Trl)
    };
    let report = export(&store, &dir.path().join("all"), &all);
    assert_eq!((report.episodes, report.refused.len()), (8, 0));
    let unverified = self::rows(&dir.path().join("all"), "train")
        .iter()
        .filter(|row| row["provenance"]["verdict"] == "unverified")
        .count();
    assert!(unverified > 0 && report.unverified == unverified as u64);
}
