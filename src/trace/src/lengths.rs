//! Whether the lengths inside a record fit into it. The parser of `mcap` makes room for what a length promises before it looks for the
//! bytes: a changed one asks for gigabytes, which a machine with 32-bit addresses does not have.

use mcap::records::op;

/// A field of a record, in its order.
enum Field {
    /// A number of bytes that is the same in every record.
    Fixed(usize),
    /// A length in four bytes, and so many bytes.
    Prefixed,
    /// A length in four bytes, and so many bytes of prefixed texts.
    Texts,
}

use Field::{Fixed, Prefixed, Texts};

/// Whether every length of a record's body leads to bytes that are there; true of records without any.
pub(crate) fn fit(opcode: u8, body: &[u8]) -> bool {
    let fields: &[Field] = match opcode {
        op::HEADER => &[Prefixed, Prefixed],
        op::SCHEMA => &[Fixed(2), Prefixed, Prefixed, Prefixed],
        op::CHANNEL => &[Fixed(4), Prefixed, Prefixed, Texts],
        op::MESSAGE_INDEX => &[Fixed(2), Prefixed],
        op::METADATA => &[Prefixed, Texts],
        op::CHUNK => &[Fixed(28), Prefixed, Fixed(8)],
        op::CHUNK_INDEX => &[Fixed(32), Prefixed, Fixed(8), Prefixed],
        op::ATTACHMENT_INDEX => &[Fixed(40), Prefixed, Prefixed],
        op::METADATA_INDEX => &[Fixed(16), Prefixed],
        op::STATISTICS => &[Fixed(42), Prefixed],
        _ => &[],
    };
    let mut rest = Some(body);
    for field in fields {
        rest = rest.and_then(|rest| match field {
            Fixed(length) => rest.get(*length..),
            Prefixed => prefixed(rest).map(|(_, rest)| rest),
            Texts => prefixed(rest).and_then(|(texts, rest)| are_texts(texts).then_some(rest)),
        });
    }
    rest.is_some()
}

fn are_texts(mut bytes: &[u8]) -> bool {
    while !bytes.is_empty() {
        match prefixed(bytes) {
            Some((_, rest)) => bytes = rest,
            None => return false,
        }
    }
    true
}

fn prefixed(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    rest.split_at_checked(u32::from_le_bytes(*length) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_length_has_to_lead_to_bytes() {
        let header = [1, 0, 0, 0, b'x', 0, 0, 0, 0];
        assert!(fit(op::HEADER, &header) && !fit(op::HEADER, &header[..8]));
        assert!(!fit(op::HEADER, &[1, 0, 0, 0x80, b'x', 0, 0, 0, 0]));
        let metadata = [0, 0, 0, 0, 5, 0, 0, 0, 1, 0, 0, 0, b'k'];
        assert!(fit(op::METADATA, &metadata));
        let mut longer = metadata;
        longer[8] = 2;
        assert!(!fit(op::METADATA, &longer));
        assert!(fit(op::DATA_END, &[]) && !fit(op::STATISTICS, &[0; 42]));
    }
}
