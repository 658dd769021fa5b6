//! A robot's map laid over the scene: the rotation and shift of the plane that take the receptacles of
//! the map nearest to those of the scene, and how far they stay apart. Never scales: both are in metres.

use std::collections::BTreeMap;

use reel_trace::robot::Odometry;
use reel_world::{Receptacle, Scene};
use serde_json::{Value, json};

/// Where receptacles stand in a robot's map, in metres.
pub(crate) type RobotMap = BTreeMap<String, [f64; 2]>;

/// A rotation of the plane and a shift after it.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct PlanarMotion {
    /// Rotation around z in radians, counter-clockwise.
    yaw: f64,
    /// Shift after the rotation, in metres.
    shift: [f64; 2],
}

impl PlanarMotion {
    /// The motion that takes the first of each two points nearest to the second: with the least
    /// squared distances (Umeyama 1991, without scale; in the plane its solution is the angle below).
    /// `None` if the points leave the angle open.
    pub(crate) fn fit(points: &[([f64; 2], [f64; 2])]) -> Option<Self> {
        let (from, to) = (
            mean(points.iter().map(|(there, _)| *there)),
            mean(points.iter().map(|(_, here)| *here)),
        );
        let (mut along, mut across) = (0.0, 0.0);
        for (there, here) in points {
            let [ax, ay] = [there[0] - from[0], there[1] - from[1]];
            let [bx, by] = [here[0] - to[0], here[1] - to[1]];
            along += ax * bx + ay * by;
            across += ax * by - ay * bx;
        }
        if along.hypot(across) == 0.0 {
            return None;
        }
        let yaw = across.atan2(along);
        let turned = rotated(from, yaw);
        Some(Self {
            yaw,
            shift: [to[0] - turned[0], to[1] - turned[1]],
        })
    }

    /// Where the motion takes a point.
    pub(crate) fn moved(&self, place: [f64; 2]) -> [f64; 2] {
        let [x, y] = rotated(place, self.yaw);
        [x + self.shift[0], y + self.shift[1]]
    }
}

/// The motion from a robot's map to the scene, with what it leaves over.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct MapAlignment {
    motion: PlanarMotion,
    /// Receptacles that map and scene have in common.
    pairs: usize,
    /// Root mean square of the distances between the two after the motion, in metres.
    rmse_m: f64,
    /// The largest of these distances, and whose it is.
    worst: (f64, String),
}

/// How far the receptacles of a map may stay from those of the scene after the motion, in metres
/// root mean square: robots may name the place before a piece of furniture instead of its middle.
const ERROR_MAX_M: f64 = 1.0;

impl MapAlignment {
    /// The motion that takes the map's receptacles nearest to the scene's; else why there is none.
    pub(crate) fn of(map: &RobotMap, scene: &Scene) -> Result<Self, &'static str> {
        // A scene of names alone has no places.
        let is_placed =
            |it: &Receptacle| (0..2).all(|axis| it.surface_max[axis] > it.surface_min[axis]);
        let centre = |id: &String| {
            let known = scene.receptacles.iter().find(|it| it.id.as_str() == id)?;
            let (low, high) = (known.surface_min, known.surface_max);
            is_placed(known).then(|| [0, 1].map(|axis| f64::midpoint(low[axis], high[axis])))
        };
        let pairs: Vec<(&String, [f64; 2], [f64; 2])> = map
            .iter()
            .filter_map(|(id, there)| Some((id, *there, centre(id)?)))
            .collect();
        if !scene.receptacles.iter().any(is_placed) {
            return Err(
                "the scene of the episode is not known (give --tasks, and --scenes where the task names a scene of yours), so nothing can be laid over it",
            );
        }
        if pairs.len() < 2 {
            return Err("the robot's map and the scene have no two receptacles in common");
        }
        let points: Vec<_> = pairs
            .iter()
            .map(|(_, there, here)| (*there, *here))
            .collect();
        let mut alignment = Self {
            motion: PlanarMotion::fit(&points)
                .ok_or("the receptacles of the robot's map stand all in one place")?,
            pairs: pairs.len(),
            rmse_m: 0.0,
            worst: (0.0, String::new()),
        };
        let mut squares = 0.0;
        for (id, there, here) in &pairs {
            let [x, y] = alignment.motion.moved(*there);
            let apart = (x - here[0]).hypot(y - here[1]);
            squares += apart * apart;
            if apart >= alignment.worst.0 {
                alignment.worst = (apart, (*id).clone());
            }
        }
        alignment.rmse_m = (squares / pairs.len() as f64).sqrt();
        Ok(alignment)
    }

    /// A pose of the map in the frame of the scene.
    pub(crate) fn pose(&self, measured: Odometry) -> Odometry {
        let [x, y] = self.motion.moved([measured.x, measured.y]);
        let yaw = measured.yaw + self.motion.yaw;
        Odometry {
            x,
            y,
            yaw: yaw.sin().atan2(yaw.cos()),
            ..measured
        }
    }

    /// Whether it is a map of the scene; else what is wrong with it.
    pub(crate) fn check(&self, error_max_m: Option<f64>) -> Result<(), String> {
        let error_max_m = error_max_m.unwrap_or(ERROR_MAX_M);
        if self.rmse_m <= error_max_m {
            return Ok(());
        }
        let (worst, id) = &self.worst;
        Err(format!(
            "the robot's map does not fit the scene: its {} receptacles stay {:.2} m root mean square from those of the scene, {worst:.2} m at {id}, at most {error_max_m} m are allowed (map_error_max_m); poses stay in the robot's frame. Is it a map of this scene, and are its places in metres?",
            self.pairs, self.rmse_m
        ))
    }

    /// What a trace says of it, and whether poses were brought into the frame of the scene by it.
    pub(crate) fn settings(&self, used: bool) -> Value {
        let PlanarMotion { yaw, shift } = self.motion;
        json!({
            "used": used,
            "yaw_rad": yaw, "x_m": shift[0], "y_m": shift[1], "receptacles": self.pairs,
            "rmse_m": self.rmse_m, "max_error_m": self.worst.0,
        })
    }

    /// What people are told of it.
    pub(crate) fn note(&self) -> String {
        let (worst, id) = &self.worst;
        format!(
            "the robot's map is laid over the scene by {} receptacles: turned by {:.1} degrees, moved by {:.2} m, {:.2} m; left over: {:.3} m root mean square, {worst:.3} m at {id}",
            self.pairs,
            self.motion.yaw.to_degrees(),
            self.motion.shift[0],
            self.motion.shift[1],
            self.rmse_m
        )
    }
}

fn rotated([x, y]: [f64; 2], yaw: f64) -> [f64; 2] {
    let (sine, cosine) = yaw.sin_cos();
    [cosine * x - sine * y, sine * x + cosine * y]
}

fn mean(points: impl ExactSizeIterator<Item = [f64; 2]>) -> [f64; 2] {
    let count = points.len() as f64;
    let sum = points.fold([0.0, 0.0], |sum, point| {
        [sum[0] + point[0], sum[1] + point[1]]
    });
    sum.map(|axis| axis / count)
}
