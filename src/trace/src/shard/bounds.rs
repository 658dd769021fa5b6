//! How much a packed episode may hold: in memory an empty call takes some hundred times the bytes that it takes in a file, and
//! files come from strangers.

use prost::encoding::{DecodeContext, WireType, decode_key, decode_varint, skip_field};

/// Most bytes of an encoded episode.
const BYTES_MAX: usize = 32 << 20;
/// Most bytes of a chunk: writers begin a new one once there is more than the largest message can add.
pub(super) const CHUNK_MAX: usize = 2 * BYTES_MAX;
/// Most calls of an episode; those of REAL-Bench have some tens.
const STEPS_MAX: usize = 10_000;
/// Most replies, log-probabilities and times of all calls together.
const PARTS_MAX: usize = 20 * STEPS_MAX;
/// Number of the field `steps` of [`reel.v1.PackedEpisode`](../../../schemas/reel/v1/packed.proto).
const STEPS: u32 = 5;

/// Whether an encoded episode is within bounds, before anything is made of it; the error says which bound it passes.
pub(super) fn check(message: &[u8]) -> Result<(), String> {
    if message.len() > BYTES_MAX {
        return Err(format!("it has more than {} MB", BYTES_MAX >> 20));
    }
    let (mut steps, mut parts) = (0, 0);
    each_field(message, |tag, content| {
        if tag != STEPS {
            return Ok(());
        }
        steps += 1;
        if steps > STEPS_MAX {
            return Err(format!("it has more than {STEPS_MAX} calls"));
        }
        each_field(content, |_, _| {
            parts += 1;
            match parts {
                0..=PARTS_MAX => Ok(()),
                _ => Err(format!("its calls have more than {PARTS_MAX} parts")),
            }
        })
    })
}

/// The number and the bytes of each field of a protobuf message; no bytes where they are a number.
fn each_field(
    mut message: &[u8],
    mut field: impl FnMut(u32, &[u8]) -> Result<(), String>,
) -> Result<(), String> {
    while !message.is_empty() {
        let (tag, wire) = decode_key(&mut message).map_err(|error| error.to_string())?;
        let mut content = &[][..];
        if wire == WireType::LengthDelimited {
            let length = decode_varint(&mut message).map_err(|error| error.to_string())?;
            let length = usize::try_from(length).unwrap_or(usize::MAX);
            (content, message) = message
                .split_at_checked(length)
                .ok_or("a field leads out of it")?;
        } else {
            skip_field(wire, tag, &mut message, DecodeContext::default())
                .map_err(|error| error.to_string())?;
        }
        field(tag, content)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use prost::Message as _;

    use super::*;
    use crate::schema::reel::{PackedEpisode, PackedStep, UserDialogue};

    fn checked(steps: Vec<PackedStep>) -> Result<(), String> {
        let episode = PackedEpisode {
            steps,
            task: 3,
            name: "episode".to_owned(),
            ..Default::default()
        };
        check(&episode.encode_to_vec())
    }

    #[test]
    fn many_empty_calls_or_replies_are_refused() {
        assert_eq!(checked(vec![PackedStep::default(); STEPS_MAX]), Ok(()));
        let refused = checked(vec![PackedStep::default(); STEPS_MAX + 1]);
        assert!(refused.unwrap_err().contains("more than 10000 calls"));
        let talkative = |replies| PackedStep {
            replies: vec![UserDialogue::default(); replies],
            ..Default::default()
        };
        assert_eq!(checked(vec![talkative(PARTS_MAX)]), Ok(()));
        let refused = checked(vec![talkative(PARTS_MAX), talkative(1)]);
        assert!(refused.unwrap_err().contains("parts"));
    }

    #[test]
    fn what_is_torn_is_refused() {
        let whole = PackedEpisode {
            steps: vec![PackedStep::default()],
            chain: vec![7; 32],
            ..Default::default()
        }
        .encode_to_vec();
        assert_eq!(check(&whole), Ok(()));
        assert!(check(&whole[..whole.len() - 1]).is_err());
        assert!(check(&vec![0; BYTES_MAX + 1]).is_err());
    }
}
