//! How far a robot's odometry is from a reference: the absolute trajectory error and the relative
//! pose error of Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems" (2012), in the
//! plane. Pure functions over poses.

use reel_trace::robot::Odometry;
use serde_json::{Value, json};

use super::align::PlanarMotion;

/// Distance between the two poses of a relative error, in metres, where the mapping does not say it.
pub(crate) const INTERVAL_M: f64 = 1.0;
/// Longest time between two poses of the reference between which one is interpolated.
const GAP_NS_MAX: u64 = 500_000_000;

/// Errors of a trajectory against a reference.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct TrajectoryError {
    /// Poses of both at the same time.
    poses: usize,
    /// Absolute trajectory error: root mean square of the distances after the rigid motion that makes
    /// them least, in metres; `None` if the robot stood still.
    ate_m: Option<f64>,
    /// Distance on the reference's path between the two poses of a relative error, in metres.
    interval_m: f64,
    /// Pairs of poses that far apart.
    pairs: usize,
    /// Relative pose error: root mean squares of translation in metres and rotation in radians;
    /// `None` if the path is shorter than the interval.
    relative: Option<(f64, f64)>,
}

impl TrajectoryError {
    /// Compares odometry with a reference, each in the order of time. `None` if they have no two
    /// poses at the same time.
    pub(crate) fn of(
        estimate: &[Odometry],
        reference: &[Odometry],
        interval_m: f64,
    ) -> Option<Self> {
        let both: Vec<(Odometry, Odometry)> = estimate
            .iter()
            .filter_map(|pose| Some((*pose, interpolated(reference, pose.unix_ns)?)))
            .collect();
        if both.len() < 2 {
            return None;
        }
        let places: Vec<_> = both
            .iter()
            .map(|(pose, truth)| ([pose.x, pose.y], [truth.x, truth.y]))
            .collect();
        let ate_m = PlanarMotion::fit(&places).map(|motion| {
            let squares = places.iter().map(|(from, to)| {
                let [x, y] = motion.moved(*from);
                (x - to[0]).powi(2) + (y - to[1]).powi(2)
            });
            (squares.sum::<f64>() / places.len() as f64).sqrt()
        });
        let errors = relative_errors(&both, interval_m);
        let mean = |part: fn(&(f64, f64)) -> f64| {
            let squares = errors.iter().map(|error| part(error).powi(2));
            (squares.sum::<f64>() / errors.len() as f64).sqrt()
        };
        Some(Self {
            poses: both.len(),
            ate_m,
            interval_m,
            pairs: errors.len(),
            relative: (!errors.is_empty()).then(|| (mean(|error| error.0), mean(|error| error.1))),
        })
    }

    /// What a trace says of it.
    pub(crate) fn settings(&self) -> Value {
        let (translation, rotation) = self.relative.unzip();
        json!({
            "poses": self.poses, "ate_rmse_m": self.ate_m, "rpe_interval_m": self.interval_m, "rpe_pairs": self.pairs,
            "rpe_translation_rmse_m": translation, "rpe_rotation_rmse_rad": rotation,
        })
    }

    /// What people are told of it.
    pub(crate) fn note(&self) -> String {
        let ate = self.ate_m.map_or_else(
            || "none, the robot stood still".to_owned(),
            |ate| format!("{ate:.3} m"),
        );
        let relative = self.relative.map_or_else(
            || format!("none, the path is shorter than {} m", self.interval_m),
            |(translation, rotation)| {
                format!(
                    "{translation:.3} m and {:.2} degrees over {} m ({} pairs)",
                    rotation.to_degrees(),
                    self.interval_m,
                    self.pairs
                )
            },
        );
        format!(
            "odometry against the reference at {} poses: absolute trajectory error {ate}; relative pose error {relative}",
            self.poses
        )
    }
}

/// Of each pose and the first that is the interval further on the reference's path: the distance and
/// the angle by which the odometry's motion between them differs from the reference's.
fn relative_errors(both: &[(Odometry, Odometry)], interval_m: f64) -> Vec<(f64, f64)> {
    let mut travelled = vec![0.0];
    for pair in both.windows(2) {
        let (before, after) = (&pair[0].1, &pair[1].1);
        let way = (after.x - before.x).hypot(after.y - before.y);
        travelled.push(travelled[travelled.len() - 1] + way);
    }
    let mut errors = Vec::new();
    let mut end = 0;
    for begin in 0..both.len() {
        while end < both.len() && travelled[end] - travelled[begin] < interval_m {
            end += 1;
        }
        if end == both.len() {
            break;
        }
        let [x, y, yaw] = motion(&both[begin].0, &both[end].0);
        let [true_x, true_y, true_yaw] = motion(&both[begin].1, &both[end].1);
        errors.push((
            (x - true_x).hypot(y - true_y),
            wrapped(yaw - true_yaw).abs(),
        ));
    }
    errors
}

/// The motion between two poses, in the frame of the first: metres and radians.
fn motion(from: &Odometry, to: &Odometry) -> [f64; 3] {
    let (sine, cosine) = from.yaw.sin_cos();
    let [x, y] = [to.x - from.x, to.y - from.y];
    [
        cosine * x + sine * y,
        cosine * y - sine * x,
        to.yaw - from.yaw,
    ]
}

/// The pose at a moment between two poses that are near each other in time.
fn interpolated(poses: &[Odometry], unix_ns: u64) -> Option<Odometry> {
    let after = poses.partition_point(|pose| pose.unix_ns < unix_ns);
    let next = poses.get(after)?;
    if next.unix_ns == unix_ns {
        return Some(*next);
    }
    let before = &poses[after.checked_sub(1)?];
    let gap = next.unix_ns - before.unix_ns;
    if gap > GAP_NS_MAX {
        return None;
    }
    let share = (unix_ns - before.unix_ns) as f64 / gap as f64;
    Some(Odometry {
        unix_ns,
        x: before.x + share * (next.x - before.x),
        y: before.y + share * (next.y - before.y),
        yaw: before.yaw + share * wrapped(next.yaw - before.yaw),
        ..*before
    })
}

/// An angle between -pi and pi.
fn wrapped(angle: f64) -> f64 {
    angle.sin().atan2(angle.cos())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(ms: u64, x: f64, y: f64, yaw: f64) -> Odometry {
        Odometry {
            step: None,
            unix_ns: ms * 1_000_000,
            x,
            y,
            yaw,
        }
    }

    /// A robot drives straight ahead, ten centimetres every tenth of a second.
    fn straight(yaw: f64, scale: f64) -> Vec<Odometry> {
        (0..=40)
            .map(|index| {
                let way = f64::from(index) * 0.1 * scale;
                pose(
                    u64::from(index as u16) * 100,
                    way * yaw.cos(),
                    way * yaw.sin(),
                    yaw,
                )
            })
            .collect()
    }

    #[test]
    fn another_frame_is_no_error() {
        let error = TrajectoryError::of(&straight(1.0, 1.0), &straight(-2.0, 1.0), 0.95).unwrap();
        assert!(error.ate_m.unwrap() < 1e-9);
        let (translation, rotation) = error.relative.unwrap();
        assert!(translation < 1e-9 && rotation < 1e-9);
        assert_eq!((error.poses, error.pairs), (41, 31));
    }

    #[test]
    fn a_wrong_scale_and_a_drift_of_the_heading() {
        // A tenth too long: 10 cm over each metre.
        let error = TrajectoryError::of(&straight(0.0, 1.1), &straight(0.0, 1.0), 1.0).unwrap();
        let (translation, rotation) = error.relative.unwrap();
        assert!(
            (translation - 0.1).abs() < 1e-9 && rotation == 0.0,
            "{error:?}"
        );
        // Deviations from the mean of the way, a tenth of them: 0.1 * 4 m / sqrt(12) for many poses.
        assert!((error.ate_m.unwrap() - 0.4 / 12f64.sqrt()).abs() < 0.01);
        // The heading turns by 0.05 rad a metre although the robot drives straight on.
        let mut turning = straight(0.0, 1.0);
        for (index, pose) in turning.iter_mut().enumerate() {
            pose.yaw = 0.005 * index as f64;
        }
        let error = TrajectoryError::of(&turning, &straight(0.0, 1.0), 2.0).unwrap();
        assert!((error.relative.unwrap().1 - 0.1).abs() < 1e-9, "{error:?}");
    }

    #[test]
    fn poses_are_compared_at_the_same_time() {
        let truth = [pose(0, 0.0, 0.0, 3.0), pose(400, 4.0, 0.0, -3.0)];
        let middle = interpolated(&truth, 200_000_000).unwrap();
        assert!((middle.x - 2.0).abs() < 1e-12);
        assert!((wrapped(middle.yaw) - wrapped(std::f64::consts::PI)).abs() < 1e-9);
        // Beyond the reference and in its gaps there is none.
        assert_eq!(interpolated(&truth, 500_000_000), None);
        let far = [pose(0, 0.0, 0.0, 0.0), pose(600, 1.0, 0.0, 0.0)];
        assert_eq!(interpolated(&far, 300_000_000), None);
        assert_eq!(TrajectoryError::of(&truth, &[], 1.0), None);
        let short = TrajectoryError::of(&truth, &truth, 10.0).unwrap();
        assert_eq!((short.pairs, short.relative), (0, None));
    }
}
