//! The loaders of training frameworks get the frames that are drawn again.

use std::{fs, path::Path};

use reel_dataset::{Format, ImageOptions, WriterOptions};
use reel_export::ExportOptions;
use reel_tables::Store;
use reel_trace::{Images, Trace};
use reel_world::record::StepRecord;
use tempfile::TempDir;

use crate::{export, options, played::play, rows};

#[test]
fn the_loaders_get_the_frames_that_are_drawn_again() {
    let dir = TempDir::new().unwrap();
    let traces = play(&dir.path().join("traces"), "oracle", Images::None);
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    store.ingest(&traces[..2], &|_, _| ()).unwrap();
    let sets = dir.path().join("sets");
    for format in Format::ALL {
        let unscaled = ImageOptions {
            pixels_max: None,
            ..ImageOptions::default()
        };
        let writer = WriterOptions {
            images: unscaled,
            ..options(format).writer
        };
        let report = export(
            &store,
            &sets.join(format.as_str()),
            &ExportOptions {
                images: true,
                writer,
                ..options(format)
            },
        );
        assert_eq!(report.episodes, 2, "{}", format.as_str());
    }
    assert!(!sets.join("parquet/images").exists() && !sets.join("parquet/.images").exists());
    // every row's frame, drawn again; the first decision of an episode is shown none,
    // as with REAL's trainer
    let frames: Vec<u8> = rows(&sets.join("trl"), "train")
        .iter()
        .filter(|row| row["provenance"]["call"] != 0)
        .flat_map(|row| {
            let provenance = &row["provenance"];
            let trace = Trace::read(Path::new(provenance["trace_uri"].as_str().unwrap())).unwrap();
            let before =
                |step: &&StepRecord| u64::from(step.step) < provenance["call"].as_u64().unwrap();
            let latest = trace
                .steps
                .iter()
                .filter(before)
                .rfind(|step| step.digests.frame.is_some());
            let frame = reel_replay::frame_at(&trace, latest.map(|step| step.step), None);
            frame.unwrap().rgb
        })
        .collect();
    let file = dir.path().join("frames.rgb");
    fs::write(&file, frames).unwrap();
    let mut command = reel_vectors::script("bash", "loaders/run.sh");
    let said = reel_vectors::run(command.arg(&sets).env("REEL_FRAMES", &file));
    for format in Format::ALL {
        assert!(
            said.contains(&format!(" {}: ", format.as_str())),
            "{} was asked of no loader: {said}",
            format.as_str()
        );
    }
    assert!(
        !said.contains("decoded\n"),
        "images that were compared with nothing: {said}"
    );
}
