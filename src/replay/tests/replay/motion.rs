//! The frames between the decisions of an episode.

use reel_replay::{MotionFrame, MotionPhase, MotionRate, motion};
use reel_trace::{Images, Trace};
use reel_vectors::episodes::{record, tasks};

const RATE: MotionRate = MotionRate {
    fps: 10,
    drive_m_s: 0.5,
    turn_rad_s: 1.5,
};

fn frames(trace: &Trace, rate: Option<MotionRate>, marks: bool) -> Vec<MotionFrame> {
    let mut frames = Vec::new();
    motion(trace, rate, marks, |frame| frames.push(frame)).unwrap();
    frames
}

#[test]
fn the_robot_drives_without_jumps_and_things_move_as_physics_has_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let trace = Trace::read(&record(&path, &tasks()[0], "oracle", Images::Full)).unwrap();
    let marked = frames(&trace, None, true);
    assert_eq!(marked.len(), trace.steps.len());
    for (frame, recorded) in marked.iter().skip(1).zip(&trace.steps) {
        if let Some(image) = trace.frame_rgb(Some(recorded.step)).unwrap() {
            assert!(frame.rgb == image, "call {}", frame.call);
        }
    }
    let decisions = frames(&trace, None, false);
    let moving = frames(&trace, Some(RATE), false);
    let first: Vec<&MotionFrame> = moving
        .iter()
        .filter(|frame| frame.phase == MotionPhase::Decision)
        .collect();
    assert_eq!(first.len(), decisions.len());
    for (one, other) in first.iter().zip(&decisions) {
        assert!(one.call == other.call && one.state == other.state && one.rgb == other.rgb);
    }

    let step_m = RATE.drive_m_s / RATE.fps as f32;
    let mut driven = 0;
    for pair in moving.windows(2) {
        let [[x, y], [next_x, next_y]] = [pair[0].state.robot.base, pair[1].state.robot.base];
        let way = (next_x - x).hypot(next_y - y);
        assert!(
            way < step_m * 1.05 + 1e-4,
            "{way} m in a frame of call {}",
            pair[1].call
        );
        driven += u32::from(pair[1].phase == MotionPhase::Driving && way > 0.0);
    }
    assert!(driven > 20, "{driven} frames on the way");
    // What was placed falls and comes to rest: the first images of its physics differ, the last do not.
    let placed = trace
        .steps
        .iter()
        .find(|record| record.tool_name() == "place")
        .unwrap();
    let physics: Vec<&MotionFrame> = moving
        .iter()
        .filter(|frame| frame.call == placed.step && frame.phase == MotionPhase::Physics)
        .collect();
    assert!(physics.len() > 10, "{}", physics.len());
    let before = &first[placed.step as usize];
    assert!(before.state.holds && !physics[0].state.holds && before.rgb != physics[0].rgb);
    let [.., last, end] = &physics[..] else {
        panic!("a call of two frames");
    };
    assert!(last.rgb == end.rgb);
}

#[test]
fn equal_traces_give_equal_frames_and_a_forged_one_gives_none() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut trace = Trace::read(&record(&path, &tasks()[1], "gibberish", Images::None)).unwrap();
    let rate = MotionRate {
        fps: if reel_vectors::is_long() { 10 } else { 2 },
        ..RATE
    };
    let all = |trace: &Trace| {
        let frames = frames(trace, Some(rate), false);
        frames
            .into_iter()
            .map(|frame| (frame.call, frame.rgb))
            .collect::<Vec<_>>()
    };
    assert!(all(&trace) == all(&trace));
    let last = trace.steps.last_mut().unwrap();
    last.robot.base[0] += 0.1;
    assert!(motion(&trace, Some(RATE), false, |_| ()).is_err());
}
