//! Any moment from any camera: the same image by any way to the moment, and nothing
//! changes by taking it.

use reel_replay::{Viewpoint, frame_at, view_at, views};
use reel_trace::{Images, Trace};

use crate::episodes::{record, tasks};

#[test]
fn every_moment_from_every_camera_is_the_same_by_any_way() {
    let folder = tempfile::tempdir().unwrap();
    let task = &tasks()[0];
    let trace = Trace::read(&record(
        &folder.path().join("a.mcap"),
        task,
        "oracle",
        Images::None,
    ))
    .unwrap();
    let [x, y] = trace.start.robot.base;
    let free = Viewpoint::Free {
        eye: [x, y, 2.2],
        look_at: [x + 1.0, y, 0.5],
    };
    let cameras = [
        Viewpoint::Head,
        Viewpoint::TopDown,
        free,
        Viewpoint::Follow(task.target.clone()),
    ];
    let mut all = Vec::new();
    for camera in &cameras {
        let mut images = Vec::new();
        views(&trace, camera, |view| images.push(view.frame)).unwrap();
        assert_eq!(images.len(), trace.steps.len() + 1);
        for call in [None, Some(3)] {
            let expected = &images[call.map_or(0, |call| call as usize + 1)];
            assert!(
                view_at(&trace, call, camera, None).unwrap() == *expected,
                "{camera:?} after {call:?}"
            );
        }
        all.push(images);
    }
    assert!(all[0][4] == frame_at(&trace, Some(3), None).unwrap());
    // From above the target is on another place in the end, and the robot too.
    assert!(all[1].first() != all[1].last());
    // The target moves, and the camera with it; all cameras see something else.
    assert!((1..4).all(|camera| (0..camera).all(|other| all[camera][0] != all[other][0])));
    let refused = view_at(&trace, None, &Viewpoint::Follow("nothing".into()), None)
        .unwrap_err()
        .to_string();
    assert!(refused.contains("there is no object nothing"), "{refused}");
    assert!(
        view_at(&trace, Some(99), &Viewpoint::TopDown, None)
            .unwrap_err()
            .to_string()
            .contains("unknown call 99")
    );
}
