//! Traces that are named by URL: of a bucket, as far as an export can tell.

use std::{
    fs, io,
    path::{Path, PathBuf},
    sync::Arc,
};

use reel_dataset::Format;
use reel_export::{AnnotationSource, ExportOptions};
use reel_tables::Store;
use reel_trace::{FileMetadata, Images, RemoteFs, TraceFiles};
use tempfile::TempDir;

use crate::{export, options, played::play, rows};

const SCHEME: &str = "folder://";

/// Files of this machine under the names of a bucket; every read brings a copy of its own.
struct Bucket(TempDir);

impl RemoteFs for Bucket {
    fn list(&self, _: &str) -> io::Result<Vec<String>> {
        unreachable!("an export knows its traces by name")
    }

    fn metadata(&self, name: &str) -> io::Result<FileMetadata> {
        TraceFiles::default().metadata(Path::new(name.trim_start_matches(SCHEME)))
    }

    fn fetch(&self, name: &str) -> io::Result<PathBuf> {
        let from = Path::new(name.trim_start_matches(SCHEME));
        let copy = self.0.path().join(from.file_name().expect("a name"));
        fs::copy(from, &copy)?;
        Ok(copy)
    }
}

#[test]
fn traces_of_a_bucket_are_verified_drawn_and_refused_like_files() {
    let bucket_files = TraceFiles::with_remote(Arc::new(Bucket(TempDir::new().unwrap())));
    let dir = TempDir::new().unwrap();
    let at = |name: &str| dir.path().join(name);
    let files = play(&at("traces"), "oracle", Images::None);
    let named = |path: &PathBuf| PathBuf::from(format!("{SCHEME}{}", path.display()));
    let made = |name: &str, paths: &[PathBuf]| {
        let mut store = Store::open_or_create(at(name))
            .unwrap()
            .with_trace_files(bucket_files.clone());
        let ingested = store.ingest(paths, &|_, _| ()).unwrap();
        assert_eq!(
            (ingested.added, ingested.quarantined.len()),
            (4, 0),
            "{:?}",
            ingested.quarantined
        );
        store
    };
    let beside = made("beside", &files);
    let bucket = made("bucket", &files.iter().map(named).collect::<Vec<_>>());

    let how = ExportOptions {
        images: true,
        words: AnnotationSource::Rules,
        ..options(Format::Trl)
    };
    let exported = |store: &Store, name: &str| {
        let report = export(store, &at(name), &how);
        assert_eq!(
            (report.episodes, report.unverified, report.refused.len()),
            (4, 0, 0),
            "{:?}",
            report.refused
        );
        assert!(report.images > 4);
        rows(&at(name), "train")
    };
    let mut there = exported(&bucket, "of-bucket");
    for row in &mut there {
        let uri = row["provenance"]["trace_uri"].as_str().unwrap().to_owned();
        row["provenance"]["trace_uri"] = uri.strip_prefix(SCHEME).expect("named by URL").into();
    }
    assert_eq!(there, exported(&beside, "of-files"));

    let mut bytes = fs::read(&files[0]).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&files[0], bytes).unwrap();
    fs::remove_file(&files[1]).unwrap();
    let report = export(&bucket, &at("later"), &how);
    let mut reasons: Vec<&str> = report
        .refused
        .iter()
        .map(|refusal| refusal.reason.as_str())
        .collect();
    reasons.sort_unstable();
    assert_eq!((report.episodes, reasons.len()), (2, 2), "{reasons:?}");
    assert!(
        reasons[0].starts_with("refused: ") && reasons[1].starts_with("the trace cannot be read"),
        "{reasons:?}"
    );
    assert!(
        report
            .refused
            .iter()
            .all(|refusal| refusal.trace.starts_with(SCHEME))
    );
}
