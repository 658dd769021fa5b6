//! Torn, missing and alien files: each is named, the steps before it are imported, nothing panics.

use std::{
    fs,
    path::{Path, PathBuf},
};

use proptest::prelude::*;
use reel_import::{ImportError, ImportedEpisode, import};
use reel_world::record::EndReason;

use crate::{PLAIN, fixture, folders, healthy, imported};

/// Every file under a folder, sorted.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path))
        } else {
            found.push(path)
        }
    }
    found.sort();
    found
}

/// Imports what may be broken: an error that names something, or a healthy trace.
fn survives(folder: &Path, out: &Path) -> Result<ImportedEpisode, ImportError> {
    let result = import(folder, out, &PLAIN);
    match &result {
        Ok(report) => {
            let trace = healthy(&report.trace);
            assert_eq!(trace.steps.len() as u32, report.steps);
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    result
}

#[test]
fn every_file_torn_anywhere_is_named() {
    let (_folder, root, out) = folders();
    let episode = fixture::full(&root);
    let (whole, _) = imported(episode.folder(), &out);
    // The steps differ in number only: two of each kind, the files about all, and the last.
    let wanted = |path: &PathBuf| {
        ["step_002", "step_006", "step_012"]
            .iter()
            .any(|step| path.to_string_lossy().contains(step))
    };
    for path in files(episode.folder())
        .into_iter()
        .filter(|path| wanted(path) || path.parent() == Some(episode.folder()))
    {
        let bytes = fs::read(&path).unwrap();
        for cut in [0, bytes.len() / 2, bytes.len() - 2] {
            fs::write(&path, &bytes[..cut]).unwrap();
            let result = survives(episode.folder(), &out);
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            match &result {
                // Torn text is text; a prompt is not read at all.
                Ok(report) if name.ends_with(".txt") => assert_eq!(report.steps, whole.steps),
                // What is missing is the checksum after the last pixel.
                Ok(report) if name.ends_with(".png") && report.losses.is_empty() => {
                    assert_eq!(*report, whole)
                }
                Ok(report) => {
                    assert!(
                        report.losses.iter().any(|loss| loss.file == path),
                        "{}: {cut}: {:?}",
                        path.display(),
                        report.losses
                    );
                    if name == "tool_call.json" || name == "debug_info.json" {
                        let step: u32 = path
                            .parent()
                            .unwrap()
                            .to_string_lossy()
                            .rsplit('_')
                            .next()
                            .unwrap()
                            .parse()
                            .unwrap();
                        assert_eq!((report.steps, report.end), (step, EndReason::Aborted));
                    } else {
                        assert_eq!(
                            (report.steps, report.end),
                            (whole.steps, EndReason::Finished)
                        );
                    }
                }
                Err(error) => assert!(name == "task_meta.json", "{}: {error}", path.display()),
            }
        }
        fs::write(&path, bytes).unwrap();
    }
    assert_eq!(survives(episode.folder(), &out).unwrap(), whole);
}

#[test]
fn a_missing_file_is_less_information() {
    let (_folder, root, out) = folders();
    let episode = fixture::full(&root);
    let (whole, _) = imported(episode.folder(), &out);
    for name in [
        "raw_response.txt",
        "inference_time.json",
        "textual_observation.txt",
        "image_observation_0.png",
        "user_message.txt",
    ] {
        for step in [1, 2, 12] {
            let path = episode.folder().join(format!("step_{step:03}")).join(name);
            let Ok(bytes) = fs::read(&path) else { continue };
            fs::remove_file(&path).unwrap();
            let report = survives(episode.folder(), &out).unwrap();
            assert_eq!(
                (report.steps, report.losses.len()),
                (whole.steps, 0),
                "{}",
                path.display()
            );
            fs::write(&path, bytes).unwrap();
        }
    }
    fs::remove_dir_all(episode.folder().join("step_005")).unwrap();
    let report = survives(episode.folder(), &out).unwrap();
    assert_eq!((report.steps, report.end), (5, EndReason::Aborted));
    assert!(
        report.losses[0]
            .to_string()
            .contains("step_005: it is missing, but there is a step 6"),
        "{:?}",
        report.losses
    );
    // A last step that the summary counts and that is gone.
    for step in 5..13 {
        let _ = fs::remove_dir_all(episode.folder().join(format!("step_{step:03}")));
    }
    let report = survives(episode.folder(), &out).unwrap();
    assert!(
        report.losses[0]
            .message
            .contains("it counts 13 steps, but there are 5"),
        "{:?}",
        report.losses
    );
    assert_eq!(report.end, EndReason::Aborted);
}

#[test]
fn alien_images_cost_the_image_alone() {
    let (_folder, root, out) = folders();
    let episode = fixture::full(&root);
    let path = episode.folder().join("step_004/image_observation_0.png");
    for alien in [
        b"GIF89a".to_vec(),
        fixture::png_of(64, 48, 1),
        fixture::png_of(60_000, 1, 1),
        vec![0x89; 100],
    ] {
        fs::write(&path, alien).unwrap();
        let report = survives(episode.folder(), &out).unwrap();
        assert_eq!(
            (report.steps, report.images, report.losses.len()),
            (13, 11, 1)
        );
        assert_eq!(report.losses[0].file, path);
    }
    fs::remove_file(&path).unwrap();
    fs::create_dir(&path).unwrap();
    assert_eq!(survives(episode.folder(), &out).unwrap().losses.len(), 1);
}

#[test]
fn values_of_other_types_are_passed_over() {
    let (_folder, root, out) = folders();
    let mut episode = fixture::full(&root);
    let step = |step: u32, name: &str| episode.folder().join(format!("step_{step:03}")).join(name);
    fs::write(
        step(1, "debug_info.json"),
        r#"{"world_graph": {"a": 3, "b": {"content": "x", "door": 7}}, "CURRENT_POS": [1e999]}"#,
    )
    .unwrap();
    fs::write(
        step(2, "debug_info.json"),
        r#"{"world_graph": 1, "WORLD_GRAPH": "]:[:'", "CURRENT_MARKER_MAP": {"x": 1, "4294967296": "y", "1": "z", "01": "w"}}"#,
    )
    .unwrap();
    fs::write(
        step(3, "tool_call.json"),
        r#"{"tool_name": 5, "args": [[]]}"#,
    )
    .unwrap();
    fs::write(
        step(4, "inference_time.json"),
        r#"{"inference_time": -1e300}"#,
    )
    .unwrap();
    let report = survives(episode.folder(), &out);
    assert!(report.is_ok() || matches!(report, Err(ImportError::NoStep { .. })));
    for value in [
        "[]",
        "{}",
        "\"x\"",
        "{\"target_object\": []}",
        "{\"source_furniture\": 1}",
    ] {
        fs::write(episode.folder().join("task_meta.json"), value).unwrap();
        assert!(survives(episode.folder(), &out).is_err());
    }
    episode.write_meta(|meta| {
        meta["target_object"] = serde_json::json!({"id": "_nowhere"});
        meta["source_furniture"] = serde_json::json!("moon");
    });
    let report = survives(episode.folder(), &out).unwrap();
    assert!(
        report
            .notes
            .iter()
            .any(|note| note.contains("_nowhere stands not on moon")),
        "{:?}",
        report.notes
    );
    assert!(matches!(
        survives(&out, &out),
        Err(ImportError::NoStep { .. })
    ));
    assert!(matches!(
        reel_import::episodes(&out),
        Err(ImportError::NoEpisode { .. })
    ));
    assert!(matches!(
        reel_import::episodes(&out.join("none")),
        Err(ImportError::List { .. })
    ));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn any_bytes_in_any_file(which in 0usize..1000, bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        let (_folder, root, out) = folders();
        let episode = fixture::others(&root).remove(0);
        let files = files(episode.folder());
        fs::write(&files[which % files.len()], bytes).unwrap();
        let _ = survives(episode.folder(), &out);
    }
}
