//! Training sets out of a store of played episodes: what a row holds, what is refused, equal bytes, going on after a break,
//! and that Hugging Face `datasets` reads what comes out.

mod played;

use std::{
    collections::BTreeMap,
    fs,
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
    process::Command,
    sync::atomic::{AtomicUsize, Ordering},
};

use played::{Played, play};
use reel_dataset::{Format, PictureOptions, Ratios, Split, Style, WriterOptions};
use reel_export::{ExportError, Selection, SftOptions, SftReport, SplitBy, Words, sft};
use reel_tables::Store;
use reel_trace::Images;
use serde_json::Value;
use tempfile::TempDir;

fn options(format: Format) -> SftOptions {
    SftOptions {
        selection: Selection::default(),
        writer: WriterOptions { rows_max: 20, ..WriterOptions::new(format) },
        style: Style::SingleTurn,
        words: Words::Auto,
        split_by: SplitBy::Task,
        ratios: Ratios::new([1.0, 0.0, 0.0]).unwrap(),
        pictures: false,
        allow_unverified: false,
        replay: true,
        name: "test".into(),
        licence: "MIT".into(),
        command: "reel export sft".into(),
    }
}

fn export(store: &Store, out: &Path, options: &SftOptions) -> SftReport {
    sft(store, out, options, &|_| (), &|_| ()).unwrap()
}

/// Every file of a folder with its bytes.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![folder.to_owned()];
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                found.insert(path.strip_prefix(folder).unwrap().display().to_string(), fs::read(&path).unwrap());
            }
        }
    }
    found
}

/// The rows of a part, each a line of JSON.
fn rows(folder: &Path, split: &str) -> Vec<Value> {
    let files = files(&folder.join(split));
    files.values().flat_map(|bytes| String::from_utf8(bytes.clone()).unwrap().lines().map(line).collect::<Vec<_>>()).collect()
}

fn line(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

#[test]
fn every_row_names_its_verified_trace_and_what_cannot_be_trusted_is_refused() {
    let dir = TempDir::new().unwrap();
    let traces = dir.path().join("traces");
    let good = play(&traces, "oracle", Images::None);
    // one whose outcome is not what its inputs give, one that was changed after it was ingested, one that is gone
    let Played { diverging, changed, gone, .. } = Played::spoilt(&traces);
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    let paths: Vec<_> = good.iter().chain([&diverging, &changed, &gone]).cloned().collect();
    let ingested = store.ingest(&paths, &|_, _| ()).unwrap();
    assert_eq!((ingested.added, ingested.quarantined.len()), (7, 0), "{:?}", ingested.quarantined);
    let mut bytes = fs::read(&changed).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&changed, bytes).unwrap();
    fs::remove_file(&gone).unwrap();

    let report = export(&store, &dir.path().join("sft"), &options(Format::Trl));
    assert_eq!((report.episodes, report.unverified), (4, 0));
    let reason = |path: &Path| {
        let path = path.display().to_string();
        report.refused.iter().find(|refusal| refusal.trace == path).map(|refusal| refusal.reason.clone()).unwrap()
    };
    assert_eq!(report.refused.len(), 3, "{:?}", report.refused);
    assert!(reason(&diverging).starts_with("diverged: DIVERGED"), "{}", reason(&diverging));
    assert!(reason(&changed).starts_with("refused: "), "{}", reason(&changed));
    assert!(reason(&gone).starts_with("the trace cannot be read"), "{}", reason(&gone));
    let rows = rows(&dir.path().join("sft"), "train");
    assert_eq!(rows.len() as u64, report.examples[&Split::Train]);
    for row in &rows {
        let row = row["provenance"].as_object().unwrap();
        assert_eq!((row["verdict"].as_str(), row["preset"].as_str()), (Some("exact"), Some("paper")));
        assert_eq!(row["table_version"], store.version());
        assert!(good.iter().any(|path| row["trace_uri"] == path.display().to_string()));
        for digest in ["trace_digest", "preset_digest"] {
            assert_eq!(row[digest].as_str().unwrap().len(), 64);
        }
    }

    // a second export replays nothing; asked for, the unverified come too, and say so
    assert_eq!(store.verdicts().unwrap().len(), 6);
    let known = SftOptions { replay: false, ..options(Format::Trl) };
    assert_eq!(export(&store, &dir.path().join("known"), &known).episodes, 4);
    assert_eq!(store.verdicts().unwrap().len(), 6);
    let all = SftOptions { allow_unverified: true, ..options(Format::Trl) };
    let report = export(&store, &dir.path().join("all"), &all);
    assert_eq!((report.episodes, report.refused.len()), (7, 0));
    let unverified =
        self::rows(&dir.path().join("all"), "train").iter().filter(|row| row["provenance"]["verdict"] == "unverified").count();
    assert!(unverified > 0 && report.unverified == unverified as u64);
}

#[test]
fn equal_stores_and_options_give_equal_bytes() {
    let dir = TempDir::new().unwrap();
    let traces = dir.path().join("traces");
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    store.ingest(&play(&traces, "oracle", Images::Full), &|_, _| ()).unwrap();
    let how = SftOptions {
        pictures: true,
        ratios: Ratios::new([0.5, 0.25, 0.25]).unwrap(),
        writer: WriterOptions { pictures: PictureOptions::default(), ..options(Format::MsSwift).writer },
        ..options(Format::MsSwift)
    };
    let on = |threads: usize, name: &str, store: &Store| {
        let out = dir.path().join(name);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| export(store, &out, &how));
        files(&out)
    };
    let one = on(1, "one", &store);
    assert!(one.len() > 10, "{:?}", one.keys());
    assert!(one == on(2, "two", &store), "the number of threads shows");

    // the same version after more was ingested
    let version = store.version();
    store.ingest(&play(&dir.path().join("more"), "planner", Images::None), &|_, _| ()).unwrap();
    assert!(store.version() > version);
    let before = Store::open_at(dir.path().join("store"), version).unwrap();
    assert!(one == on(2, "before", &before), "what came later shows");

    // broken off in the middle: the same call goes on
    let out = dir.path().join("broken");
    let written = AtomicUsize::new(0);
    let breaks = |_: usize| assert!(written.fetch_add(1, Ordering::Relaxed) < 2, "broken off on purpose");
    catch_unwind(AssertUnwindSafe(|| sft(&before, &out, &how, &|_| (), &breaks))).unwrap_err();
    let left = files(&out);
    assert!(left.keys().any(|name| name.starts_with("images/")) && !left.contains_key("manifest.json"));
    export(&before, &out, &how);
    assert!(one == files(&out), "the break shows");

    // what is whole is not overwritten
    let error = sft(&before, &out, &how, &|_| (), &|_| ()).unwrap_err();
    assert!(matches!(error, ExportError::OtherDataset { .. }), "{error}");
}

#[test]
fn mistakes_are_no_examples_but_recoveries_are() {
    let dir = TempDir::new().unwrap();
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    store.ingest(&play(&dir.path().join("traces"), "wrong-object", Images::None), &|_, _| ()).unwrap();
    let count = |name: &str, selection: Selection| {
        let report = export(&store, &dir.path().join(name), &SftOptions { selection, ..options(Format::Trl) });
        (report.episodes, report.examples.values().sum::<u64>(), report.left_out)
    };
    let all = Selection { failed: true, mistakes: true, ..Selection::default() };
    let (episodes, everything, left_out) = count("all", all.clone());
    assert!(episodes > 0 && left_out.is_empty(), "{left_out:?}");
    let (_, without, left_out) = count("without", Selection { mistakes: false, ..all.clone() });
    let mistakes = left_out["decisions that were mistakes"];
    assert!(mistakes > 0);
    assert_eq!(without + mistakes, everything);
    let (_, fewer, left_out) = count("fewer", Selection { mistakes: false, recoveries: false, ..all.clone() });
    assert_eq!(fewer + mistakes + left_out["decisions right after a mistake"], everything);
    let (episodes, none, left_out) = count("won", Selection::default());
    assert_eq!(left_out.get("episodes that did not succeed").copied().unwrap_or(0) + episodes, 4, "{none}");
    // at most one a task, and no tool beyond the median
    let (_, balanced, left_out) = count("balanced", Selection { balance_tools: true, ..all });
    assert_eq!(balanced + left_out["decisions beyond the median tool's"], everything);
}

#[test]
fn hugging_face_datasets_decodes_the_images() {
    let python = std::env::var("REEL_PYTHON").unwrap_or_else(|_| "python3".into());
    let importable =
        Command::new(&python).args(["-c", "import datasets, PIL"]).output().is_ok_and(|output| output.status.success());
    if !importable {
        eprintln!("skipped: {python} has no `datasets` and `pillow` (REEL_PYTHON names another one)");
        return;
    }
    let dir = TempDir::new().unwrap();
    let traces = play(&dir.path().join("traces"), "oracle", Images::None);
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    store.ingest(&traces, &|_, _| ()).unwrap();
    let how = SftOptions {
        pictures: true,
        writer: WriterOptions {
            pictures: PictureOptions { pixels_max: None, ..PictureOptions::default() },
            ..options(Format::Parquet).writer
        },
        ..options(Format::Parquet)
    };
    let out = dir.path().join("sft");
    let report = export(&store, &out, &how);
    assert!(!out.join("images").exists() && !out.join(".pictures").exists());
    // the first picture as it is drawn again
    let trace = reel_trace::Trace::read(&traces[0]).unwrap();
    fs::write(dir.path().join("first.rgb"), reel_replay::picture_at(&trace, None, None).unwrap()).unwrap();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/check_datasets.py");
    let output = Command::new(&python).arg(script).arg(&out).arg(dir.path()).arg(&trace.header.episode_id).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let rows = report.examples[&Split::Train];
    assert_eq!(String::from_utf8_lossy(&output.stdout).trim(), format!("{rows} rows, {rows} images of 640 x 480"));
}
