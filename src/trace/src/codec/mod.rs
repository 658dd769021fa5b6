//! Records to our protobuf messages and back, bit for bit. Knows neither files nor order.

mod decode;
mod encode;

pub(crate) use decode::*;
pub(crate) use encode::*;

use crate::{
    robot::{Alignment, PrimitiveOutcome, VlaLatency},
    schema::reel,
};

/// Conversions of a type whose message has the same fields; the compiler names a field that only
/// one of them has.
macro_rules! same_fields {
    ($name:ident { $($field:ident),* }) => {
        impl From<&$name> for reel::$name {
            fn from(value: &$name) -> Self {
                let $name { $($field),* } = value.clone();
                Self { $($field),* }
            }
        }

        impl From<reel::$name> for $name {
            fn from(message: reel::$name) -> Self {
                let reel::$name { $($field),* } = message;
                Self { $($field),* }
            }
        }
    };
}

same_fields!(PrimitiveOutcome {
    step,
    unix_ns,
    skill,
    target,
    success,
    duration_ns,
    control_steps,
    error
});
same_fields!(VlaLatency {
    step,
    unix_ns,
    latency_ns
});
same_fields!(Alignment {
    step,
    unix_ns,
    target,
    odometry_error_m,
    yaw_error_rad,
    image_shift_px,
    image_rmse_px
});

#[cfg(test)]
mod tests {
    use prost::Message;
    use reel_world::record::*;
    use serde_json::{Value, json};

    use super::*;

    #[test]
    fn minus_zero_and_not_a_number_keep_their_bits() {
        let odd = [
            f32::from_bits(0x8000_0000),
            f32::from_bits(0x7fc0_1234),
            f32::MIN_POSITIVE / 2.0,
        ];
        let robot = RobotState {
            base: [odd[0], odd[1]],
            yaw: odd[0],
            camera: odd,
            pitch: -0.0,
            path_length_m: odd[2],
        };
        let body = BodyState {
            body: "door:fridge_1".into(),
            position: odd,
            rotation: [odd[0], odd[1], odd[2], -0.0],
            linear_velocity: odd,
            angular_velocity: odd,
            asleep: true,
        };
        let message = sim_digest(Some(0), 7, &[body], &robot, &StateDigests::default());
        let bytes = message.encode_to_vec();
        let message = decode_message::<crate::schema::reel::SimDigest>(&bytes).unwrap();
        let moment = read_sim_digest(message).unwrap();
        assert_eq!(moment.step, Some(0));
        let bits = |values: &[f32]| {
            values
                .iter()
                .map(|value| value.to_bits())
                .collect::<Vec<_>>()
        };
        assert_eq!(bits(&moment.bodies[0].position), bits(&odd));
        assert_eq!(bits(&moment.robot.camera), bits(&odd));
        assert_eq!(moment.robot.yaw.to_bits(), odd[0].to_bits());
        assert_eq!(moment.robot.pitch.to_bits(), (-0.0f32).to_bits());
    }

    #[test]
    fn arguments_keep_every_number() {
        let arguments = json!({
            "z": u64::MAX, "a": i64::MIN, "third": 1.0 / 3.0, "tiny": 5e-324, "one": 1.0, "minus": -0.0,
            "long": 0.123_456_789_012_345_68_f64, "nested": [[null, true, "\u{0}\n"], {}],
        });
        let call = reel_world::ToolCall::new("pick", arguments.clone());
        let (read, lookup) = read_tool_call(tool_call(3, &call, None)).unwrap();
        assert_eq!((&read, lookup), (&call, None));
        assert_eq!(read.arguments.to_string(), arguments.to_string());
        let bare = reel_world::ToolCall::new("", Value::String("not an object".into()));
        let lookup = Some(Lookup {
            categories: vec!["mug".into(), "cup".into()],
            source: "e5".into(),
        });
        assert_eq!(
            read_tool_call(tool_call(3, &bare, lookup.as_ref())).unwrap(),
            (bare, lookup)
        );
    }
}
