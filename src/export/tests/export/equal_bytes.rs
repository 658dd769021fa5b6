//! Equal stores and options give equal bytes, whatever the threads, the breaks and the store.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::atomic::{AtomicUsize, Ordering},
};

use reel_dataset::{Format, ImageOptions, Ratios, WriterOptions};
use reel_export::{ExportError, ExportOptions};
use reel_tables::Store;
use reel_trace::Images;
use tempfile::TempDir;

use crate::{export, files, options, played::play};

#[test]
fn equal_stores_and_options_give_equal_bytes() {
    let dir = TempDir::new().unwrap();
    let traces = dir.path().join("traces");
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    store
        .ingest(&play(&traces, "oracle", Images::Full), &|_, _| ())
        .unwrap();
    let how = ExportOptions {
        images: true,
        ratios: Ratios::new([0.5, 0.25, 0.25]).unwrap(),
        writer: WriterOptions {
            images: ImageOptions::default(),
            ..options(Format::MsSwift).writer
        },
        ..options(Format::MsSwift)
    };
    let on = |threads: usize, name: &str, store: &Store| {
        let out = dir.path().join(name);
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| export(store, &out, &how));
        files(&out)
    };
    let one = on(1, "one", &store);
    assert!(one.len() > 10, "{:?}", one.keys());
    assert!(one == on(2, "two", &store), "the number of threads shows");

    // the same version after more was ingested
    let version = store.version();
    store
        .ingest(
            &play(&dir.path().join("more"), "planner", Images::None),
            &|_, _| (),
        )
        .unwrap();
    assert!(store.version() > version);
    let before = Store::open_at(dir.path().join("store"), version).unwrap();
    assert!(one == on(2, "before", &before), "what came later shows");

    // broken off in the middle: the same call goes on
    let out = dir.path().join("broken");
    let written = AtomicUsize::new(0);
    let breaks = |_: usize| {
        assert!(
            written.fetch_add(1, Ordering::Relaxed) < 2,
            "broken off on purpose"
        )
    };
    catch_unwind(AssertUnwindSafe(|| {
        reel_export::export(&before, &out, &how, &|_| (), &breaks)
    }))
    .unwrap_err();
    let left = files(&out);
    assert!(
        left.keys().any(|name| name.starts_with("images/")) && !left.contains_key("manifest.json")
    );
    export(&before, &out, &how);
    assert!(one == files(&out), "the break shows");

    // killed before it was whole: with its last files there, with an image half written
    std::fs::write(out.join(".export.jsonl"), "").unwrap();
    std::fs::remove_file(out.join("manifest.json")).unwrap();
    let image = one.keys().find(|name| name.starts_with("images/")).unwrap();
    std::fs::write(out.join(image).with_file_name("7.part"), "half").unwrap();
    export(&before, &out, &how);
    assert!(one == files(&out), "the kill shows");

    // what is whole is not overwritten
    let error = reel_export::export(&before, &out, &how, &|_| (), &|_| ()).unwrap_err();
    assert!(matches!(error, ExportError::OtherDataset { .. }), "{error}");
}

#[test]
fn another_store_of_the_same_traces_gives_the_same_bytes() {
    let dir = TempDir::new().unwrap();
    let traces = play(&dir.path().join("traces"), "oracle", Images::None);
    // a file of the table each, whose names are drawn
    let of = |name: &str| {
        let mut store = Store::open_or_create(dir.path().join(name)).unwrap();
        for trace in &traces {
            store
                .ingest(std::slice::from_ref(trace), &|_, _| ())
                .unwrap();
        }
        export(
            &store,
            &dir.path().join(name).with_extension("sft"),
            &options(Format::Trl),
        );
        files(&dir.path().join(name).with_extension("sft"))
    };
    let first = of("first");
    assert!(
        first == of("second") && first == of("third"),
        "which store it was shows"
    );
}
