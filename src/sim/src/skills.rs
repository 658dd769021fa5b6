//! Skills that fail now and then: the probabilities and errors measured on the paper's robot
//! ("Quantitative real-world evaluation"), and the actuation noise of a call, which is a pure
//! function of seed, task and call number: a draw depends on no other draw.

use reel_world::{Digest, Primitive, Skills};

use crate::nav::Viewpoint;

/// How far off the base arrives, in metres: mean and standard deviation of the odometry error.
const DRIFT_M: [f64; 2] = [0.0178, 0.0040];
/// How far it is turned, in radians: mean and standard deviation of the yaw error,
/// 0.74 and 0.57 degrees.
const DRIFT_YAW: [f64; 2] = [
    0.74 * std::f64::consts::PI / 180.0,
    0.57 * std::f64::consts::PI / 180.0,
];

/// The actuation noise of one call.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct ActuationNoise {
    skills: Skills,
    /// From 0 to 1: a skill fails where it is not below its probability of success.
    chance: f64,
    /// Where the base arrives, from where it wants to, in metres.
    drift_m: [f32; 2],
    /// How far it is turned from where it wants to look, in radians.
    drift_yaw: f32,
}

impl ActuationNoise {
    /// The actuation noise of a call (from 0) of an episode. Episodes of different tasks at one
    /// seed have nothing in common.
    pub fn of(skills: Skills, seed: u64, task_id: &str, call: u32) -> Self {
        if skills == Skills::Perfect {
            return Self {
                skills,
                chance: 0.0,
                drift_m: [0.0; 2],
                drift_yaw: 0.0,
            };
        }
        let draw = NoiseKey {
            key: format!("{seed}/skills {}/{task_id}/{call}", skills.as_str()),
        };
        let angle = 2.0 * std::f64::consts::PI * draw.uniform("direction");
        let far = draw.length("drift", DRIFT_M);
        let turned = draw.length("yaw", DRIFT_YAW)
            * if draw.uniform("side") < 0.5 {
                -1.0
            } else {
                1.0
            };
        Self {
            skills,
            chance: draw.uniform("skill"),
            drift_m: [
                (far * libm::cos(angle)) as f32,
                (far * libm::sin(angle)) as f32,
            ],
            drift_yaw: turned as f32,
        }
    }

    /// Whether a skill does it.
    pub fn succeeds(&self, primitive: Primitive) -> bool {
        self.chance < primitive.success(self.skills)
    }

    /// Where the base arrives that wants to a viewpoint; a place that `free` refuses
    /// is not arrived at.
    pub(crate) fn arrive(&self, wanted: Viewpoint, free: impl Fn([f32; 2]) -> bool) -> Viewpoint {
        let base = [
            wanted.base[0] + self.drift_m[0],
            wanted.base[1] + self.drift_m[1],
        ];
        let base = if free(base) { base } else { wanted.base };
        let mut camera = wanted.camera;
        camera.position[0] += base[0] - wanted.base[0];
        camera.position[1] += base[1] - wanted.base[1];
        camera.yaw += self.drift_yaw;
        Viewpoint {
            base,
            camera,
            ..wanted
        }
    }
}

/// Numbers by what they are for.
struct NoiseKey {
    key: String,
}

impl NoiseKey {
    /// From 0, below 1.
    fn uniform(&self, purpose: &str) -> f64 {
        let bytes = Digest::of(format!("{}/{purpose}", self.key).as_bytes()).0;
        let word = u64::from_le_bytes(bytes[..8].try_into().expect("a digest has 32 bytes"));
        (word >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A length with this mean and deviation, never negative: the sum of twelve uniform numbers is
    /// as good as normal.
    fn length(&self, purpose: &str, [mean, deviation]: [f64; 2]) -> f64 {
        let sum: f64 = (0..12)
            .map(|index| self.uniform(&format!("{purpose}/{index}")))
            .sum();
        (mean + deviation * (sum - 6.0)).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn luck_repeats_and_depends_on_every_part_of_its_key() {
        let noise = |seed, call| ActuationNoise::of(Skills::RealV1, seed, "FDP/a", call);
        assert_eq!(noise(1, 0), noise(1, 0));
        assert_ne!(noise(1, 0), noise(1, 1));
        assert_ne!(noise(1, 0), noise(2, 0));
        assert_ne!(
            noise(1, 0),
            ActuationNoise::of(Skills::RealV1, 1, "FDP/b", 0)
        );
        let perfect = ActuationNoise::of(Skills::Perfect, 1, "FDP/a", 0);
        assert!(
            Primitive::ALL
                .iter()
                .all(|primitive| perfect.succeeds(*primitive))
        );
        assert_eq!((perfect.drift_m, perfect.drift_yaw), ([0.0; 2], 0.0));
    }

    /// The paper's "Navigation/gaze repeatability": 1.78 +- 0.40 cm, 0.74 +- 0.57 degrees.
    #[test]
    fn the_drift_is_that_of_the_paper() {
        let noise: Vec<ActuationNoise> = (0..4000)
            .map(|call| ActuationNoise::of(Skills::RealV1, 20_261, "FDP/a", call))
            .collect();
        let of = |value: &dyn Fn(&ActuationNoise) -> f64| {
            let mean = noise.iter().map(value).sum::<f64>() / noise.len() as f64;
            let variance = noise
                .iter()
                .map(|noise| (value(noise) - mean) * (value(noise) - mean))
                .sum::<f64>()
                / noise.len() as f64;
            [mean, variance.sqrt()]
        };
        let [far, far_deviation] = of(&|noise| {
            100.0 * libm::hypot(f64::from(noise.drift_m[0]), f64::from(noise.drift_m[1]))
        });
        assert!(
            (far - 1.78).abs() < 0.03 && (far_deviation - 0.40).abs() < 0.03,
            "{far} +- {far_deviation} cm"
        );
        // What would be below zero is zero: the mean of the absolute error is a little higher, the
        // deviation a little smaller.
        let [turned, turned_deviation] = of(&|noise| f64::from(noise.drift_yaw.abs()).to_degrees());
        assert!(
            (turned - 0.74).abs() < 0.06 && (turned_deviation - 0.57).abs() < 0.07,
            "{turned} +- {turned_deviation} degrees"
        );
    }
}
