//! Images from other cameras, and episodes as videos, from outside.

use std::fs;

use crate::{complaint, expect, failed_episode};

#[test]
fn cameras_and_films() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let trace = failed_episode(folder);
    let trace = trace.to_str().unwrap();
    let free = [
        "--camera",
        "free",
        "--eye",
        "1.5,-1,2",
        "--look-at",
        "2,2,0.5",
    ];
    for (out, camera) in [
        ("above", &["--camera", "top-down"][..]),
        ("target", &["--camera", "follow:target"]),
        ("free", &free),
    ] {
        expect(
            folder,
            0,
            &[
                &[
                    "trace",
                    "frames",
                    trace,
                    "--out",
                    out,
                    "--at",
                    "2",
                    "--no-cache",
                ],
                camera,
            ]
            .concat(),
        );
        assert!(folder.join(out).join("call_002.png").exists());
    }
    let all = reel!(folder, "trace frames {trace} --out all --camera top-down");
    assert!(
        all.contains("start.png") && !all.contains("contact_sheet"),
        "{all}"
    );
    assert_eq!(
        fs::read(folder.join("all/call_002.png")).unwrap(),
        fs::read(folder.join("above/call_002.png")).unwrap()
    );
    let refused = |camera: &[&str]| {
        complaint(
            folder,
            2,
            &[
                &["trace", "frames", trace, "--out", "no", "--at", "2"],
                camera,
            ]
            .concat(),
        )
    };
    assert!(refused(&["--camera", "side"]).contains("no camera is called 'side'"));
    assert!(refused(&["--camera", "free", "--eye", "1,2,3"]).contains("needs a look-at"));
    assert!(
        refused(&["--camera", "free", "--eye", "1,2", "--look-at", "1,2,3"])
            .contains("'1,2' is not three finite numbers")
    );
    assert!(refused(&["--camera", "follow:unicorn"]).contains("has no object unicorn"));
    assert!(refused(&["--eye", "1,2,3"]).contains("for the free camera"));

    reel!(
        folder,
        "branch {trace} --at 3 --policy oracle --out b.mcap --no-cache"
    );
    let film = [
        "trace",
        "video",
        trace,
        "--compare",
        "b.mcap",
        "--camera",
        "top-down",
        "--out",
        "film.gif",
        "--json",
    ];
    let told: serde_json::Value = serde_json::from_str(&expect(folder, 0, &film)).unwrap();
    assert_eq!(told["width"], 2 * 640 + 8);
    assert!(
        fs::read(folder.join("film.gif"))
            .unwrap()
            .starts_with(b"GIF89a")
    );
    for out in ["film.mp4", "again.mp4"] {
        let told = reel!(folder, "trace video {trace} --fps 2 --out {out}");
        assert!(told.contains("640 x 644"), "{told}");
    }
    let mp4 = fs::read(folder.join("film.mp4")).unwrap();
    assert_eq!(&mp4[4..8], b"ftyp");
    assert!(mp4.windows(4).any(|four| four == b"av01"));
    assert!(fs::read(folder.join("again.mp4")).unwrap() == mp4);
    assert!(
        complaint(folder, 2, &format!("trace video {trace} --out film.avi"))
            .contains("a .gif or an .mp4")
    );
    assert!(
        complaint(folder, 2, &format!("trace video {trace} --fps 0")).contains("--fps is from")
    );
}
