//! Depth and instance masks leave Reel: recorded, drawn again, and annotated as COCO has it.

use std::{fs, path::Path, process::Command};

use reel_trace::Trace;

use crate::{
    complaint, expect,
    gate::{NAMES, forged_corpus},
};

#[test]
fn depth_and_masks_are_the_same_recorded_and_drawn_again() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 1 --seed 35 --out tasks");
    reel!(folder, "run --tasks tasks --record depth,masks --out full");
    reel!(folder, "run --tasks tasks --no-images --out lean");
    let only = |name: &str| {
        let mut files = fs::read_dir(folder.join(name)).unwrap();
        let path = files.find_map(|entry| {
            let path = entry.unwrap().path();
            path.extension()
                .is_some_and(|it| it == "mcap")
                .then_some(path)
        });
        path.unwrap()
    };
    let (full, lean) = (only("full"), only("lean"));
    let (full, lean) = (full.display(), lean.display());
    assert!(reel!(folder, "replay {full}").contains("exact"));
    let trace = Trace::read(Path::new(&full.to_string())).unwrap();
    assert!(trace.layers().depth && trace.layers().masks);
    trace.verify_images().unwrap();
    // They are no part of what happened.
    let other = Trace::read(Path::new(&lean.to_string())).unwrap();
    assert_eq!(trace.chain(), other.chain());

    reel!(
        folder,
        "trace frames {lean} --layers depth,masks --out frames"
    );
    let text = reel!(
        folder,
        "trace frames {full} --at 2 --layers depth --camera top-down --out above"
    );
    assert!(text.contains("call_002.depth.png"), "{text}");
    reel!(folder, "export coco {full} --out coco");
    assert!(
        complaint(folder, 2, &format!("export coco {full} --out coco"))
            .contains("is there already")
    );
    assert!(
        complaint(folder, 2, "run --tasks tasks --record deep --out none")
            .contains("there are depth and masks, not 'deep'")
    );
    // A lean copy drops them, and what is written again keeps them.
    reel!(folder, "trace compact {full} --out compact");
    let compact = Trace::read(&only("compact")).unwrap();
    assert!(!compact.layers().any());

    let Some(python) = reel_vectors::python("pycocotools, mcap_protobuf, PIL") else {
        return;
    };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/layers/check.py");
    let done = Command::new(python)
        .arg(script)
        .args([full.to_string(), "frames".to_owned(), "coco".to_owned()])
        .current_dir(folder)
        .output()
        .unwrap();
    assert!(
        done.status.success(),
        "{}{}",
        String::from_utf8_lossy(&done.stdout),
        String::from_utf8_lossy(&done.stderr)
    );
}

#[test]
fn what_does_not_replay_is_not_annotated_however_often_it_is_given() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    forged_corpus(&folder.join("corpus"), 3);
    let forged = folder.join("corpus").join(NAMES[0]);
    fs::copy(&forged, folder.join("corpus/again.mcap")).unwrap();
    let command = "export coco corpus --out coco --json";
    let told: serde_json::Value = serde_json::from_str(&expect(folder, 3, command)).unwrap();
    assert_eq!(told["refused"], 2, "{told}");
    let whole = Trace::read(&folder.join("corpus").join(NAMES[1])).unwrap();
    assert_eq!(told["images"], whole.steps.len() + 1, "{told}");
    for kind in ["images", "panoptic"] {
        let chains: Vec<_> = fs::read_dir(folder.join("coco").join(kind))
            .unwrap()
            .map(|entry| entry.unwrap().file_name())
            .collect();
        assert_eq!(chains, [whole.chain().to_string().as_str()], "{kind}");
    }
}
