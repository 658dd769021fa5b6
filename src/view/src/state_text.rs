//! The state of an episode at one moment as text to read.

use std::fmt::Write as _;

use reel_replay::Replay;
use reel_world::record::MarkerTarget;

/// What holds after the calls that a replay executed: robot, gripper, markers, graph, motion.
pub fn state_text(replay: &Replay<'_>) -> String {
    let simulator = replay.episode().simulator();
    let mut text = String::new();
    let mut line = |name: &str, value: &str| {
        let _ = writeln!(text, "{name:<12} {value}");
    };
    line("after calls", &replay.calls().to_string());
    line("state", &simulator.digest().to_string());
    line(
        "time",
        &format!(
            "{:.3} s ({} physics steps)",
            simulator.sim_step() as f64 / 240.0,
            simulator.sim_step()
        ),
    );
    let robot = simulator.robot();
    let [x, y] = robot.base;
    let at = simulator
        .landmark()
        .map_or("nothing".to_owned(), ToString::to_string);
    line(
        "robot",
        &format!(
            "({x:.3}, {y:.3}) m, yaw {:.3} rad, at {at}, {:.2} m driven",
            robot.yaw, robot.path_length_m
        ),
    );
    line(
        "holds",
        simulator.held().map_or("nothing", |held| held.as_str()),
    );
    for marker in simulator.markers() {
        let target = match &marker.target {
            MarkerTarget::Object(object) => object.to_string(),
            MarkerTarget::Receptacle(receptacle) => receptacle.to_string(),
        };
        line("marker", &format!("{} {target}", marker.id));
    }
    for (receptacle, state) in simulator.physical_graph().receptacles {
        let objects: Vec<&str> = state.content.keys().map(|object| object.as_str()).collect();
        if let Some(door) = state.door {
            line(
                "graph",
                &format!("{receptacle} (door {door}): {}", objects.join(", ")),
            );
        } else if !objects.is_empty() {
            line("graph", &format!("{receptacle}: {}", objects.join(", ")));
        }
    }
    for body in simulator.bodies() {
        let [x, y, z] = body.position;
        let [vx, vy, vz] = body.linear_velocity;
        let motion = if body.asleep {
            "asleep".to_owned()
        } else {
            format!("moving ({vx:.4}, {vy:.4}, {vz:.4}) m/s")
        };
        line(
            "body",
            &format!("{} at ({x:.4}, {y:.4}, {z:.4}) m, {motion}", body.body),
        );
    }
    text
}
