//! Why a replay differs: everything that differs at the first differing moment, with the distance
//! of numbers in ULPs, the images side by side and the texts word by word, and the motion states
//! after any physics step. Never decides whether a trace is exact.

use reel_sim::{PreparedTask, Simulator, render::Detail};
use reel_trace::Trace;
use reel_world::{
    FRAME_HEIGHT, FRAME_WIDTH, Frame,
    record::{BodyState, StepRecord},
};
use serde::Serialize;
use serde_json::Value;
use similar::{ChangeTag, TextDiff};

use crate::{EpisodePosition, Replay, Verdict, player, seek};

/// Most differing fields that are listed.
const MOST_FIELDS: usize = 400;

/// What differs, and how much.
#[derive(Clone, Debug, Serialize)]
pub struct Explanation {
    /// What the replay found.
    pub verdict: Verdict,
    /// Every field that differs at that moment, digests last.
    pub fields: Vec<FieldChange>,
    /// The outcome's text, `[-recorded-]` and `{+replayed+}`, where it differs.
    pub text: Option<String>,
    /// The image, where it differs.
    pub image: Option<FrameChange>,
    /// Motion states here after the first differing physics step. A trace holds only digests of the
    /// steps within a call: the other side's values come from the build that recorded it.
    pub bodies: Option<Vec<BodyState>>,
}

/// One field that differs.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct FieldChange {
    /// The body it belongs to.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub body: Option<String>,
    /// Path of the field in its record or body, e.g. `position[2]`.
    pub field: String,
    /// As recorded; numbers of motion with their bits.
    pub recorded: String,
    /// Value when executed again, in the same format as the recorded one.
    pub replayed: String,
    /// How many floats lie between, for numbers of motion and of rewards.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ulps: Option<u64>,
}

/// How an image differs.
#[derive(Clone, Debug, Serialize)]
pub struct FrameChange {
    /// Pixels that differ; none where the trace does not hold the image.
    pub pixels: Option<u32>,
    /// Box of the differing pixels: x, y of the first and of the last.
    pub bbox: Option<[u16; 4]>,
    /// Largest difference of a channel.
    pub most: Option<u8>,
    /// RGB bytes of the recorded frame; `None` if the trace does not hold it.
    #[serde(skip)]
    pub recorded: Option<Vec<u8>>,
    /// RGB bytes of the replayed frame; `None` if the replay rendered none.
    #[serde(skip)]
    pub replayed: Option<Vec<u8>>,
}

/// Replays a trace and explains the first difference.
pub fn explain(trace: &Trace) -> Explanation {
    let plain = |verdict| Explanation {
        verdict,
        fields: Vec::new(),
        text: None,
        image: None,
        bodies: None,
    };
    let mut replay = match Replay::start(trace, Detail::Full) {
        Ok((replay, _)) => replay,
        Err(Verdict::Diverged { divergence }) if divergence.position == EpisodePosition::Start => {
            return at_start(trace, divergence);
        }
        Err(verdict) => return plain(verdict),
    };
    loop {
        match replay.step() {
            Ok(Some(_)) => {}
            Ok(None) => return plain(replay.finish(|_, _| {}).unwrap_or_else(|verdict| verdict)),
            Err(differing) => {
                let recorded = &trace.steps[replay.calls()];
                let output = &differing.output;
                let step = differing.divergence.physics_step;
                return Explanation {
                    fields: changes(recorded, &output.record),
                    text: text(recorded, &output.record),
                    image: image_change(trace, recorded, &output.record, output.frame.as_ref()),
                    bodies: step.and_then(|step| {
                        state_at(trace, EpisodePosition::Call(recorded.step), step)
                            .ok()
                            .flatten()
                    }),
                    verdict: differing.into(),
                };
            }
        }
    }
}

/// The motion states of this simulator after a physics step (from 0) of the start or of a call;
/// none where fewer steps were executed.
///
/// # Errors
/// Why nothing can be executed, or a difference before that call.
pub fn state_at(
    trace: &Trace,
    moment: EpisodePosition,
    step: usize,
) -> Result<Option<Vec<BodyState>>, Verdict> {
    match moment {
        EpisodePosition::Start => {
            let config = player::config(trace)?;
            let stage = PreparedTask::with_meshes(config.scene, config.task, config.meshes);
            let mut simulator =
                Simulator::new_watching(stage, config.profile, config.seed, Some(step));
            Ok(simulator.take_watched())
        }
        EpisodePosition::Call(call) => {
            let mut replay = seek(trace, call as usize, None)?;
            replay.watch(step);
            // Whether this call differs does not matter here: its state is asked for.
            let _ = replay.step();
            Ok(replay.take_watched())
        }
        EpisodePosition::Header | EpisodePosition::End => Ok(None),
    }
}

/// What differs between two lists of motion states.
pub fn body_changes(recorded: &[BodyState], replayed: &[BodyState]) -> Vec<FieldChange> {
    let mut found = Vec::new();
    let json =
        |bodies: &[BodyState]| serde_json::to_value(bodies).expect("a record is always JSON");
    collect(
        &json(recorded),
        &json(replayed),
        &mut FieldPath {
            path: "bodies".into(),
            body: None,
        },
        &mut found,
    );
    found
}

fn at_start(trace: &Trace, divergence: Box<crate::Divergence>) -> Explanation {
    let step = divergence.physics_step;
    let fields = player::config(trace)
        .ok()
        .and_then(|config| reel_episode::Episode::start(config).ok())
        .map_or_else(Vec::new, |(_, start, _)| changes(&trace.start, &start));
    let bodies = step.and_then(|step| state_at(trace, EpisodePosition::Start, step).ok().flatten());
    Explanation {
        verdict: Verdict::Diverged { divergence },
        fields,
        text: None,
        image: None,
        bodies,
    }
}

/// Every difference of two records, what people read first, digests last.
fn changes<T: Serialize>(recorded: &T, replayed: &T) -> Vec<FieldChange> {
    let json = |record: &T| serde_json::to_value(record).expect("a record is always JSON");
    let mut found = Vec::new();
    collect(
        &json(recorded),
        &json(replayed),
        &mut FieldPath {
            path: String::new(),
            body: None,
        },
        &mut found,
    );
    found.sort_by_key(|change| change.field.starts_with("digests"));
    found
}

/// Where in a record one is.
struct FieldPath {
    path: String,
    body: Option<String>,
}

fn collect(old: &Value, new: &Value, place: &mut FieldPath, found: &mut Vec<FieldChange>) {
    if old == new || found.len() >= MOST_FIELDS {
        return;
    }
    let length = place.path.len();
    match (old, new) {
        (Value::Object(a), Value::Object(b)) => {
            for key in a.keys().chain(b.keys().filter(|key| !a.contains_key(*key))) {
                place.path.push_str(if length == 0 { "" } else { "." });
                place.path.push_str(key);
                collect(
                    a.get(key).unwrap_or(&Value::Null),
                    b.get(key).unwrap_or(&Value::Null),
                    place,
                    found,
                );
                place.path.truncate(length);
            }
        }
        (Value::Array(a), Value::Array(b)) if place.path == "bodies" => {
            for (old, new) in a.iter().zip(b) {
                let name = old.get("body").and_then(Value::as_str).map(str::to_owned);
                let mut inside = FieldPath {
                    path: String::new(),
                    body: name,
                };
                collect(old, new, &mut inside, found);
            }
            count(a.len(), b.len(), place, found);
        }
        (Value::Array(a), Value::Array(b)) => {
            for (index, (old, new)) in a.iter().zip(b).enumerate() {
                place.path.push_str(&format!("[{index}]"));
                collect(old, new, place, found);
                place.path.truncate(length);
            }
            count(a.len(), b.len(), place, found);
        }
        (old, new) => {
            let (recorded, replayed, ulps) = numbers(old, new, place);
            found.push(FieldChange {
                body: place.body.clone(),
                field: place.path.clone(),
                recorded,
                replayed,
                ulps,
            });
        }
    }
}

fn count(old: usize, new: usize, place: &FieldPath, found: &mut Vec<FieldChange>) {
    if old != new {
        let field = format!("{} (count)", place.path);
        let (recorded, replayed) = (old.to_string(), new.to_string());
        found.push(FieldChange {
            body: place.body.clone(),
            field,
            recorded,
            replayed,
            ulps: None,
        });
    }
}

/// Both values for people; motion is held in single precision, rewards and metrics in double.
fn numbers(old: &Value, new: &Value, place: &FieldPath) -> (String, String, Option<u64>) {
    let (Some(a), Some(b)) = (old.as_f64(), new.as_f64()) else {
        return (old.to_string(), new.to_string(), None);
    };
    if place.body.is_some() || place.path.starts_with("robot") {
        let (a, b) = (a as f32, b as f32);
        let show = |value: f32| format!("{value} ({:#010x})", value.to_bits());
        return (
            show(a),
            show(b),
            Some(u64::from(ordered_f32(a).abs_diff(ordered_f32(b)))),
        );
    }
    if old.is_f64() || new.is_f64() {
        let show = |value: f64| format!("{value} ({:#018x})", value.to_bits());
        return (
            show(a),
            show(b),
            Some(ordered_f64(a).abs_diff(ordered_f64(b))),
        );
    }
    (old.to_string(), new.to_string(), None)
}

/// Floats as integers in their order, so that neighbours differ by one.
fn ordered_f32(value: f32) -> i32 {
    let bits = value.to_bits() as i32;
    if bits < 0 {
        i32::MIN.wrapping_sub(bits)
    } else {
        bits
    }
}

fn ordered_f64(value: f64) -> i64 {
    let bits = value.to_bits() as i64;
    if bits < 0 {
        i64::MIN.wrapping_sub(bits)
    } else {
        bits
    }
}

fn text(recorded: &StepRecord, replayed: &StepRecord) -> Option<String> {
    let (old, new) = (&recorded.outcome.text, &replayed.outcome.text);
    if old == new {
        return None;
    }
    let mut text = String::new();
    for change in TextDiff::from_words(old.as_str(), new.as_str()).iter_all_changes() {
        match change.tag() {
            ChangeTag::Equal => text.push_str(change.value()),
            ChangeTag::Delete => text.push_str(&format!("[-{}-]", change.value())),
            ChangeTag::Insert => text.push_str(&format!("{{+{}+}}", change.value())),
        }
    }
    Some(text)
}

fn image_change(
    trace: &Trace,
    recorded: &StepRecord,
    replayed: &StepRecord,
    frame: Option<&Frame>,
) -> Option<FrameChange> {
    if recorded.digests.frame == replayed.digests.frame {
        return None;
    }
    let old = trace.frame_rgb(Some(recorded.step)).ok().flatten();
    let new = frame.map(|frame| frame.rgb.clone());
    let mut change = FrameChange {
        pixels: None,
        bbox: None,
        most: None,
        recorded: old,
        replayed: new,
    };
    if let (Some(old), Some(new)) = (&change.recorded, &change.replayed) {
        let (mut pixels, mut most, mut bbox) =
            (0, 0, [FRAME_WIDTH as u16, FRAME_HEIGHT as u16, 0, 0]);
        for (index, (a, b)) in old
            .chunks_exact(3)
            .zip(new.chunks_exact(3))
            .enumerate()
            .filter(|(_, (a, b))| a != b)
        {
            let (x, y) = ((index % FRAME_WIDTH) as u16, (index / FRAME_WIDTH) as u16);
            pixels += 1;
            most = a
                .iter()
                .zip(b)
                .map(|(a, b)| a.abs_diff(*b))
                .fold(most, u8::max);
            bbox = [
                bbox[0].min(x),
                bbox[1].min(y),
                bbox[2].max(x),
                bbox[3].max(y),
            ];
        }
        (change.pixels, change.most) = (Some(pixels), Some(most));
        change.bbox = (pixels > 0).then_some(bbox);
    }
    Some(change)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_are_one_ulp_apart_across_zero_too() {
        for (a, b, apart) in [
            (1.0f32, 1.0f32.next_up(), 1),
            (0.0, f32::from_bits(1), 1),
            (-0.0, f32::from_bits(1), 1),
        ] {
            assert_eq!(ordered_f32(a).abs_diff(ordered_f32(b)), apart, "{a} {b}");
        }
        assert_eq!(
            ordered_f32((-1.0f32).next_down()).abs_diff(ordered_f32(-1.0)),
            1
        );
        assert_eq!(
            ordered_f64(-f64::from_bits(1)).abs_diff(ordered_f64(f64::from_bits(1))),
            2
        );
    }
}
