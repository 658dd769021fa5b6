//! What a binary layer (`.usdc`) claims, checked against its bytes before the library that reads it
//! trusts the claims: it allocates what a count says, follows every jump and every nested
//! dictionary. Values are not read here.
//!
//! [`crateFile.cpp`](https://github.com/PixarAnimationStudios/OpenUSD/blob/release/pxr/usd/usd/crateFile.cpp)
//! of OpenUSD defines the format.

use crate::assets::limits::{FILE_BYTES_MAX, USD_DEPTH_MAX};

/// Most elements of a list: what a file of the most bytes holds of numbers of four bytes.
const ELEMENTS_MAX: u64 = FILE_BYTES_MAX / 4;
/// Most values of a file, counting those in dictionaries and of animations.
const VALUES_MAX: usize = 4_000_000;
/// Deepest nesting of dictionaries.
const DICTIONARIES_MAX: usize = 16;
/// The versions that are read: 0.7 is of 2018.
const MINOR_VERSIONS: std::ops::RangeInclusive<u8> = 7..=12;

/// Checks a binary layer, and says what is wrong with it.
pub(super) fn check(bytes: &[u8]) -> Result<(), String> {
    let mut file = Claims { bytes, values: 0 };
    let [major, minor] = [8, 9].map(|at| bytes.get(at).copied());
    let (Some(major), Some(minor)) = (major, minor) else {
        return Err("it ends in its header".to_owned());
    };
    if major != 0 || !MINOR_VERSIONS.contains(&minor) {
        return Err(format!(
            "it is of version {major}.{minor}, and 0.7 to 0.12 are read; `usdcat FILE -o FILE.usdc` writes it anew"
        ));
    }
    file.tables()
        .ok_or_else(|| "it is torn, or its tables claim more than it holds".to_owned())
}

/// The bytes of a layer, and how many values were looked at.
struct Claims<'a> {
    bytes: &'a [u8],
    values: usize,
}

/// All methods answer `None` for what the file cannot hold.
impl<'a> Claims<'a> {
    fn u32(&self, at: usize) -> Option<u32> {
        Some(u32::from_le_bytes(*self.bytes.get(at..)?.first_chunk()?))
    }

    fn u64(&self, at: usize) -> Option<u64> {
        Some(u64::from_le_bytes(*self.bytes.get(at..)?.first_chunk()?))
    }

    /// A count at a place, of elements of so many bytes that follow it: where they end.
    fn list(&self, at: usize, element_bytes: usize) -> Option<usize> {
        let count = usize::try_from(self.u64(at)?).ok()?;
        let end = at
            .checked_add(8)?
            .checked_add(count.checked_mul(element_bytes)?)?;
        (end <= self.bytes.len()).then_some(end)
    }

    /// A count of elements that need not follow as they are.
    fn count(&self, at: usize) -> Option<u64> {
        self.u64(at).filter(|count| *count <= ELEMENTS_MAX)
    }

    /// A compressed block, its size before it: the block, and where it ends.
    fn block(&self, at: usize) -> Option<(&'a [u8], usize)> {
        let end = self.list(at, 1)?;
        Some((self.bytes.get(at + 8..end)?, end))
    }

    /// The tables of the file, each in a section, and every value that they refer to.
    fn tables(&mut self) -> Option<()> {
        let contents = usize::try_from(self.u64(16)?).ok()?;
        let count = self.u64(contents).filter(|count| *count < 64)?;
        for index in 0..usize::try_from(count).ok()? {
            let section = contents.checked_add(8 + index * 32)?;
            let name = self.bytes.get(section..section.checked_add(16)?)?;
            let name = name.split(|byte| *byte == 0).next()?;
            let start = usize::try_from(self.u64(section + 16)?).ok()?;
            match name {
                b"TOKENS" => {
                    self.count(start)?;
                    self.u64(start + 8)
                        .filter(|bytes| *bytes <= FILE_BYTES_MAX)?;
                    self.block(start + 16)?;
                }
                b"STRINGS" => drop(self.list(start, 4)?),
                b"FIELDS" => self.fields(start)?,
                b"FIELDSETS" => drop(self.integers(start, 1)?),
                b"PATHS" => self.paths(start)?,
                b"SPECS" => drop(self.integers(start, 3)?),
                _ => {}
            }
        }
        Some(())
    }

    /// A count and so many blocks of integers: where they end.
    fn integers(&self, at: usize, blocks: usize) -> Option<usize> {
        self.count(at)?;
        (0..blocks).try_fold(at + 8, |at, _| Some(self.block(at)?.1))
    }

    fn fields(&mut self, at: usize) -> Option<()> {
        let count = usize::try_from(self.count(at)?).ok()?;
        let values = self.integers(at, 1)?;
        let (block, _) = self.block(values)?;
        for value in unpacked(block, count.checked_mul(8)?)?.as_chunks::<8>().0 {
            self.value(u64::from_le_bytes(*value), 0)?;
        }
        Some(())
    }

    /// The tree of paths: every one is reached once, and none is too deep.
    fn paths(&self, at: usize) -> Option<()> {
        self.count(at)?;
        let count = usize::try_from(self.count(at + 8)?).ok()?;
        let (block, _) = self.block(self.integers(at + 8, 2)?)?;
        let jumps = integers_of(&unpacked(block, 4 + count.div_ceil(4) + 4 * count)?, count)?;
        let mut visited = vec![false; count];
        let mut pending: Vec<(usize, usize)> = jumps.first().map(|_| (0, 0)).into_iter().collect();
        while let Some((mut index, mut depth)) = pending.pop() {
            loop {
                let jump = *jumps.get(index)?;
                // A property is one deeper than its prim, a variant is one deeper than its set.
                if std::mem::replace(visited.get_mut(index)?, true) || depth > 2 * USD_DEPTH_MAX {
                    return None;
                }
                let (has_child, has_sibling) = (jump > 0 || jump == -1, jump >= 0);
                if has_child && has_sibling {
                    pending.push((index.checked_add(usize::try_from(jump).ok()?)?, depth));
                }
                if !has_child && !has_sibling {
                    break;
                }
                depth += usize::from(has_child);
                index += 1;
            }
        }
        Some(())
    }

    /// A value as the table of fields has it: a type, flags, and the value itself or its place.
    fn value(&mut self, value: u64, depth: usize) -> Option<()> {
        self.values += 1;
        if depth > DICTIONARIES_MAX || self.values > VALUES_MAX {
            return None;
        }
        let kind = (value >> 48) & 0xff;
        let [is_array, is_inlined, is_compressed] = [63, 62, 61].map(|bit| value & (1 << bit) != 0);
        let at = usize::try_from(value & ((1 << 48) - 1)).ok()?;
        if is_inlined || (is_array && at == 0) {
            return Some(());
        }
        if is_array {
            return self.array(kind, at, is_compressed);
        }
        match kind {
            31 => drop(self.dictionary(at, depth)?),
            // Lists of tokens, strings, paths, and of numbers.
            32 | 33 | 34 | 36 | 38 | 54 => self.edits(at, 4)?,
            37 | 39 | 55 => self.edits(at, 8)?,
            35 => self.references(at, depth)?,
            40 | 41 | 50 => drop(self.list(at, 4)?),
            45 | 48 | 58 => drop(self.list(at, 8)?),
            46 => self.samples(at, depth)?,
            49 => drop(self.list(at, 16)?),
            _ => {}
        }
        Some(())
    }

    fn array(&self, kind: u64, at: usize, is_compressed: bool) -> Option<()> {
        let bytes = element_bytes(kind)?;
        let count = self.count(at)?;
        if !is_compressed || count < 4 {
            return self.list(at, bytes).map(drop);
        }
        match kind {
            3..=6 => drop(self.block(at + 8)?),
            7..=9 | 56 => match self.bytes.get(at + 8)? {
                b'i' => drop(self.block(at + 9)?),
                b't' => {
                    let values = usize::try_from(self.u32(at + 9)?).ok()?;
                    let end = (at + 13).checked_add(values.checked_mul(bytes)?)?;
                    self.block(end)?;
                }
                _ => return None,
            },
            _ => return None,
        }
        Some(())
    }

    /// Lists that edit another list: those that its first byte names follow each other.
    fn edits(&self, at: usize, element_bytes: usize) -> Option<()> {
        let mut next = at.checked_add(1)?;
        for _ in 0..edit_lists(*self.bytes.get(at)?) {
            next = self.list(next, element_bytes)?;
        }
        Some(())
    }

    fn references(&mut self, at: usize, depth: usize) -> Option<()> {
        let mut next = at.checked_add(1)?;
        for _ in 0..edit_lists(*self.bytes.get(at)?) {
            // Each has its layer, prim and offset, then a dictionary.
            self.list(next, 32)?;
            let count = self.u64(next)?;
            next += 8;
            for _ in 0..count {
                next = self.dictionary(next.checked_add(24)?, depth)?;
            }
        }
        Some(())
    }

    /// A dictionary: where its entries end.
    fn dictionary(&mut self, at: usize, depth: usize) -> Option<usize> {
        self.list(at, 12)?;
        let count = self.u64(at)?;
        let mut next = at + 8;
        for _ in 0..count {
            let place = self.jump(next.checked_add(4)?)?;
            self.value(self.u64(place)?, depth + 1)?;
            next = place + 8;
        }
        Some(next)
    }

    /// The place that an offset leads to, which counts from itself.
    fn jump(&self, at: usize) -> Option<usize> {
        let offset = self.u64(at)?.cast_signed();
        let place = i64::try_from(at).ok()?.checked_add(offset)?;
        usize::try_from(place).ok()
    }

    /// The values of an animation, by time.
    fn samples(&mut self, at: usize, depth: usize) -> Option<()> {
        let times = self.jump(at)?;
        self.value(self.u64(times)?, depth + 1)?;
        let values = self.jump(times + 8)?;
        let end = self.list(values, 8)?;
        for value in self.bytes.get(values + 8..end)?.as_chunks::<8>().0 {
            self.value(u64::from_le_bytes(*value), depth + 1)?;
        }
        Some(())
    }
}

/// How many lists the first byte of an edit names.
fn edit_lists(header: u8) -> u32 {
    (header & 0b0111_1110).count_ones()
}

/// Bytes of an element of an array, by the number of its type.
fn element_bytes(kind: u64) -> Option<usize> {
    Some(match kind {
        1 | 2 => 1,
        7 => 2,
        3 | 4 | 8 | 10 | 11 | 12 | 21 | 57 => 4,
        25 => 6,
        5 | 6 | 9 | 18 | 20 | 22 | 29 | 56 => 8,
        24 | 26 => 12,
        17 | 19 | 28 | 30 => 16,
        23 => 24,
        13 | 16 | 27 => 32,
        14 => 72,
        15 => 128,
        _ => return None,
    })
}

/// The bytes of an LZ4 block with the byte before it that counts its parts: 0 for one. Fails beyond
/// so many bytes.
fn unpacked(block: &[u8], bytes_max: usize) -> Option<Vec<u8>> {
    let (0, block) = block.split_first().map(|(parts, block)| (*parts, block))? else {
        return None;
    };
    let mut bytes = vec![0; bytes_max];
    let length = lz4_flex::decompress_into(block, &mut bytes).ok()?;
    bytes.truncate(length);
    Some(bytes)
}

/// Integers as differences: the most frequent one, two bits for the size of each, then the others.
fn integers_of(bytes: &[u8], count: usize) -> Option<Vec<i32>> {
    if count == 0 {
        return Some(Vec::new());
    }
    let common = i32::from_le_bytes(*bytes.first_chunk()?);
    let codes = bytes.get(4..4 + count.div_ceil(4))?;
    let mut rest = bytes.get(4 + codes.len()..)?;
    let mut take = |length: usize| {
        let (value, more) = rest.split_at_checked(length)?;
        rest = more;
        let mut wide = [if value.last()? & 0x80 == 0 { 0 } else { 0xff }; 4];
        wide[..length].copy_from_slice(value);
        Some(i32::from_le_bytes(wide))
    };
    let (mut last, mut values) = (0_i32, Vec::with_capacity(count));
    for index in 0..count {
        let step = match (codes[index / 4] >> (2 * (index % 4))) & 3 {
            0 => common,
            1 => take(1)?,
            2 => take(2)?,
            _ => take(4)?,
        };
        last = last.wrapping_add(step);
        values.push(last);
    }
    Some(values)
}
