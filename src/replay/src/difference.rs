//! The first difference between what was recorded and what was executed again.

use std::fmt;

use reel_world::record::{
    BodyState, EndRecord, EpisodeHeader, StartRecord, StateDigests, StepRecord,
};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Where in an episode a difference lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EpisodePosition {
    /// The episode header, which is compared before everything else.
    Header,
    /// Spawning and settling, before the first call.
    Start,
    /// A call, from 0.
    Call(u32),
    /// The end of the episode.
    End,
}

/// The first difference found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Divergence {
    /// Moment of the episode at which the first difference lies.
    #[serde(alias = "moment")]
    pub position: EpisodePosition,
    /// The call as recorded, for people.
    pub call: Option<String>,
    /// First physics step (from 0, within this call) whose state digest differs.
    pub physics_step: Option<usize>,
    /// The body whose state differs at the end of the call.
    pub body: Option<String>,
    /// The field that differs, e.g. `position[2]` or `outcome.text`.
    pub field: String,
    /// Value of the field in the recorded (or the first) trace, as text.
    pub recorded: String,
    /// Value of the field in the replay (or the second trace), as text.
    pub replayed: String,
}

impl Divergence {
    /// A difference of two texts.
    pub fn text(moment: EpisodePosition, field: &str, recorded: &str, replayed: &str) -> Self {
        let (recorded, replayed) = (recorded.to_owned(), replayed.to_owned());
        Self {
            position: moment,
            call: None,
            physics_step: None,
            body: None,
            field: field.to_owned(),
            recorded,
            replayed,
        }
    }
}

impl fmt::Display for Divergence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.position {
            EpisodePosition::Header => write!(f, "in the header")?,
            EpisodePosition::Start => write!(f, "at the start")?,
            EpisodePosition::Call(call) => write!(f, "at call {call}")?,
            EpisodePosition::End => write!(f, "at the end")?,
        }
        if let Some(call) = &self.call {
            write!(f, " {call}")?;
        }
        if let Some(step) = self.physics_step {
            write!(f, ", physics step {step}")?;
        }
        if let Some(body) = &self.body {
            write!(f, ", body {body}")?;
        }
        write!(
            f,
            ", field {}: recorded {}, replayed {}",
            self.field, self.recorded, self.replayed
        )
    }
}

type Found = Result<(), Box<Divergence>>;

/// Compares headers: the inputs themselves.
pub fn header(recorded: &EpisodeHeader, replayed: &EpisodeHeader) -> Found {
    let replayed = EpisodeHeader {
        build: recorded.build.clone(),
        ..replayed.clone()
    };
    if *recorded == replayed {
        Ok(())
    } else {
        fields(EpisodePosition::Header, None, None, recorded, &replayed)
    }
}

/// Compares the state before the first call.
pub fn start(recorded: &StartRecord, replayed: &StartRecord) -> Found {
    if recorded == replayed {
        return Ok(());
    }
    moving(
        EpisodePosition::Start,
        None,
        (&recorded.digests, &recorded.bodies),
        (&replayed.digests, &replayed.bodies),
    )?;
    fields(EpisodePosition::Start, None, None, recorded, replayed)
}

/// Compares a call and what came of it.
pub fn step(recorded: &StepRecord, replayed: &StepRecord) -> Found {
    if recorded == replayed {
        return Ok(());
    }
    let moment = EpisodePosition::Call(recorded.step);
    let call = Some(recorded.input.call.to_string());
    moving(
        moment,
        call.clone(),
        (&recorded.digests, &recorded.bodies),
        (&replayed.digests, &replayed.bodies),
    )?;
    fields(moment, call, None, recorded, replayed)
}

/// Compares final graphs and metrics.
pub fn end(recorded: &EndRecord, replayed: &EndRecord) -> Found {
    if recorded == replayed {
        Ok(())
    } else {
        fields(EpisodePosition::End, None, None, recorded, replayed)
    }
}

/// Compares motion: the first physics step, and the first body and field at the end of the call.
fn moving(
    moment: EpisodePosition,
    call: Option<String>,
    recorded: (&StateDigests, &[BodyState]),
    replayed: (&StateDigests, &[BodyState]),
) -> Found {
    let (old, new) = (&recorded.0.physics_steps, &replayed.0.physics_steps);
    let physics_step = old
        .iter()
        .zip(new)
        .position(|(a, b)| a != b)
        .or_else(|| (old.len() != new.len()).then(|| old.len().min(new.len())));
    for (a, b) in recorded.1.iter().zip(replayed.1) {
        if let Some((field, recorded, replayed)) = body_field(a, b) {
            let body = Some(a.body.clone());
            return Err(Box::new(Divergence {
                position: moment,
                call,
                physics_step,
                body,
                field,
                recorded,
                replayed,
            }));
        }
    }
    if let Some(step) = physics_step {
        let value = |digests: &[u32]| {
            digests
                .get(step)
                .map_or_else(|| "none".to_owned(), |digest| format!("{digest:08x}"))
        };
        let (recorded, replayed) = (value(old), value(new));
        let field = "state digest of the physics step".to_owned();
        return Err(Box::new(Divergence {
            position: moment,
            call,
            physics_step,
            body: None,
            field,
            recorded,
            replayed,
        }));
    }
    Ok(())
}

fn body_field(a: &BodyState, b: &BodyState) -> Option<(String, String, String)> {
    if a.body != b.body {
        return Some(("body".into(), a.body.clone(), b.body.clone()));
    }
    let groups: [(&str, &[f32], &[f32]); 4] = [
        ("position", &a.position, &b.position),
        ("rotation", &a.rotation, &b.rotation),
        ("linear_velocity", &a.linear_velocity, &b.linear_velocity),
        ("angular_velocity", &a.angular_velocity, &b.angular_velocity),
    ];
    for (name, old, new) in groups {
        for (index, (old, new)) in old.iter().zip(new).enumerate() {
            if old.to_bits() != new.to_bits() {
                let show = |value: f32| format!("{value} ({:#010x})", value.to_bits());
                return Some((format!("{name}[{index}]"), show(*old), show(*new)));
            }
        }
    }
    (a.asleep != b.asleep).then(|| ("asleep".into(), a.asleep.to_string(), b.asleep.to_string()))
}

/// Compares two records field by field in the order of their declaration.
fn fields<T: Serialize>(
    moment: EpisodePosition,
    call: Option<String>,
    physics_step: Option<usize>,
    recorded: &T,
    replayed: &T,
) -> Found {
    let json = |record: &T| serde_json::to_value(record).expect("a record is always JSON");
    let mut path = String::new();
    let (recorded, replayed) = first_difference(&json(recorded), &json(replayed), &mut path)
        .unwrap_or_else(|| ("a value that JSON cannot hold".into(), "another one".into()));
    let field = if path.is_empty() {
        "record".to_owned()
    } else {
        path
    };
    Err(Box::new(Divergence {
        position: moment,
        call,
        physics_step,
        body: None,
        field,
        recorded,
        replayed,
    }))
}

fn first_difference(a: &Value, b: &Value, path: &mut String) -> Option<(String, String)> {
    let length = path.len();
    match (a, b) {
        _ if a == b => None,
        (Value::Object(old), Value::Object(new)) => {
            let keys = old
                .keys()
                .chain(new.keys().filter(|key| !old.contains_key(*key)));
            for key in keys {
                path.push_str(if length == 0 { "" } else { "." });
                path.push_str(key);
                let missing = Value::Null;
                let found = first_difference(
                    old.get(key).unwrap_or(&missing),
                    new.get(key).unwrap_or(&missing),
                    path,
                );
                if found.is_some() {
                    return found;
                }
                path.truncate(length);
            }
            None
        }
        (Value::Array(old), Value::Array(new)) => {
            for (index, (old, new)) in old.iter().zip(new).enumerate() {
                path.push_str(&format!("[{index}]"));
                let found = first_difference(old, new, path);
                if found.is_some() {
                    return found;
                }
                path.truncate(length);
            }
            path.push_str(" (count)");
            Some((old.len().to_string(), new.len().to_string()))
        }
        (a, b) => Some((a.to_string(), b.to_string())),
    }
}
