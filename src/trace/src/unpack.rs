//! Sound chunks, decompressed in one go. What is wrong with the others the reader of `mcap` tells.

use std::cell::RefCell;

use mcap::records::{ChunkHeader, op};
use zstd::bulk::Decompressor;

use crate::{
    buffer::Buffer,
    container::{RECORD_PREFIX, first_record},
};

thread_local! {
    static ZSTD: RefCell<Option<Decompressor<'static>>> = RefCell::default();
}

/// The records of a chunk.
pub(crate) struct Unpacked(Buffer);

impl Unpacked {
    /// Decompresses a chunk. None where its checksum does not hold, where it is larger than the
    /// limit, or where it is not made of whole schemas, channels and messages.
    pub(crate) fn of(header: &ChunkHeader, data: &[u8], limit: usize) -> Option<Self> {
        let size = usize::try_from(header.uncompressed_size)
            .ok()
            .filter(|size| *size <= limit)?;
        let mut unpacked = Self(Buffer::take());
        unpacked.fill(&header.compression, data, size)?;
        let sound =
            unpacked.0.len() == size && crc32fast::hash(&unpacked.0) == header.uncompressed_crc;
        (sound && unpacked.is_whole()).then_some(unpacked)
    }

    fn fill(&mut self, compression: &str, data: &[u8], size: usize) -> Option<()> {
        let Self(bytes) = self;
        match compression {
            "" => bytes.extend_from_slice(data),
            "zstd" => ZSTD
                .with_borrow_mut(|zstd| {
                    bytes.try_reserve(size).ok()?;
                    if zstd.is_none() {
                        *zstd = Decompressor::new().ok();
                    }
                    zstd.as_mut()?.decompress_to_buffer(data, &mut **bytes).ok()
                })
                .map(drop)?,
            _ => return None,
        }
        Some(())
    }

    fn is_whole(&self) -> bool {
        let mut end = 0;
        for (opcode, body) in self.records() {
            if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
                return false;
            }
            end += RECORD_PREFIX + body.len();
        }
        end == self.0.len()
    }

    /// Opcode and body of each whole record.
    pub(crate) fn records(&self) -> impl Iterator<Item = (u8, &[u8])> {
        let mut rest: &[u8] = &self.0;
        std::iter::from_fn(move || {
            let (opcode, body, after) = first_record(rest)?;
            rest = after;
            Some((opcode, body))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: usize = 1 << 20;

    /// A message of three bytes, and a channel of none.
    fn records() -> Vec<u8> {
        let mut bytes = vec![op::MESSAGE, 3, 0, 0, 0, 0, 0, 0, 0, 1, 2, 3];
        bytes.extend([op::CHANNEL, 0, 0, 0, 0, 0, 0, 0, 0]);
        bytes
    }

    fn header(content: &[u8], compression: &str) -> ChunkHeader {
        ChunkHeader {
            message_start_time: 0,
            message_end_time: 0,
            uncompressed_size: content.len() as u64,
            uncompressed_crc: crc32fast::hash(content),
            compression: compression.to_owned(),
            compressed_size: 0,
        }
    }

    #[test]
    fn sound_chunks_are_read_and_others_are_not() {
        let content = records();
        let packed = zstd::bulk::compress(&content, 3).unwrap();
        for (compression, data) in [("", &content), ("zstd", &packed)] {
            let header = header(&content, compression);
            let unpacked = Unpacked::of(&header, data, LIMIT).unwrap();
            let expected: [(u8, &[u8]); 2] = [(op::MESSAGE, &[1, 2, 3]), (op::CHANNEL, &[])];
            assert!(unpacked.records().eq(expected));

            assert!(
                Unpacked::of(&header, data, content.len() - 1).is_none(),
                "too large"
            );
            assert!(
                Unpacked::of(&header, &data[..data.len() - 1], LIMIT).is_none(),
                "cut off"
            );
            for wrong in [
                ChunkHeader {
                    uncompressed_crc: 1,
                    ..header.clone()
                },
                ChunkHeader {
                    uncompressed_size: header.uncompressed_size - 1,
                    ..header.clone()
                },
                ChunkHeader {
                    uncompressed_size: header.uncompressed_size + 1,
                    ..header.clone()
                },
                ChunkHeader {
                    uncompressed_size: u64::MAX,
                    ..header.clone()
                },
                ChunkHeader {
                    compression: "lz4".into(),
                    ..header.clone()
                },
            ] {
                assert!(Unpacked::of(&wrong, data, LIMIT).is_none(), "{wrong:?}");
            }
        }
        for (torn, why) in [
            (&content[..content.len() - 1], "a prefix is cut"),
            (&content[..11], "a body is cut"),
            (&[op::CHUNK, 0, 0, 0, 0, 0, 0, 0, 0], "out of place"),
            (
                &[op::MESSAGE, 255, 255, 255, 255, 255, 255, 255, 255],
                "longer than anything",
            ),
        ] {
            assert!(
                Unpacked::of(&header(torn, ""), torn, LIMIT).is_none(),
                "{why}"
            );
        }
    }
}
