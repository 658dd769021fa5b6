//! Packages (`.usdz`): a ZIP archive whose files lie in it as they are, as the format demands.
//! Compressed entries are refused, so no archive holds more than its own bytes.

use crate::assets::MeshError;

/// Bytes of the record at the end of an archive, without its comment.
const END_BYTES: usize = 22;
/// Most files of a package.
const ENTRIES_MAX: usize = 1000;

/// A file of a package.
struct Entry<'a> {
    name: &'a str,
    method: u16,
    size: usize,
    /// Where its local header starts.
    at: usize,
}

/// The name of the layer that a package opens as: the first one.
pub(super) fn first_layer(package: &[u8]) -> Result<String, MeshError> {
    let is_layer = |name: &str| {
        let ending = name.rsplit('.').next().unwrap_or_default();
        matches!(
            ending.to_ascii_lowercase().as_str(),
            "usd" | "usda" | "usdc"
        )
    };
    let found = entries(package)?
        .into_iter()
        .find(|entry| is_layer(entry.name));
    found
        .map(|entry| entry.name.to_owned())
        .ok_or_else(|| broken("it holds no .usd, .usda or .usdc file"))
}

/// The bytes of a file of a package.
pub(super) fn file<'a>(package: &'a [u8], name: &str) -> Result<&'a [u8], MeshError> {
    let found = entries(package)?
        .into_iter()
        .find(|entry| entry.name == name);
    let entry = found.ok_or_else(|| MeshError::Missing {
        file: name.chars().take(200).collect(),
        why: "it is not in the package".to_owned(),
    })?;
    if entry.method != 0 {
        return Err(MeshError::Unsupported(
            "a package with compressed files (`usdzip` packs them as they are)".to_owned(),
        ));
    }
    let torn = || broken("an entry ends behind it");
    let header = package.get(entry.at..).ok_or_else(torn)?;
    if !header.starts_with(b"PK\x03\x04") {
        return Err(broken("an entry has no header"));
    }
    let lengths = number16(header, 26).zip(number16(header, 28));
    let (name_bytes, extra_bytes) = lengths.ok_or_else(torn)?;
    let start = 30 + usize::from(name_bytes) + usize::from(extra_bytes);
    header
        .get(start..)
        .and_then(|data| data.get(..entry.size))
        .ok_or_else(torn)
}

/// What the directory at the end of an archive lists.
fn entries(package: &[u8]) -> Result<Vec<Entry<'_>>, MeshError> {
    let torn = || broken("its directory is torn");
    let last = package.len().checked_sub(END_BYTES).ok_or_else(torn)?;
    let first = last.saturating_sub(usize::from(u16::MAX));
    let end = (first..=last)
        .rev()
        .find(|at| package[*at..].starts_with(b"PK\x05\x06"))
        .ok_or_else(torn)?;
    let count = usize::from(number16(package, end + 10).ok_or_else(torn)?);
    if count > ENTRIES_MAX {
        return Err(MeshError::too_large(
            "files in the package",
            count,
            ENTRIES_MAX,
            "join them",
        ));
    }
    let mut at = number32(package, end + 16).ok_or_else(torn)?;
    let mut found = Vec::new();
    for _ in 0..count {
        let record = package.get(at..).ok_or_else(torn)?;
        if !record.starts_with(b"PK\x01\x02") {
            return Err(torn());
        }
        let lengths = [28, 30, 32].map(|field| number16(record, field).map(usize::from));
        let [Some(name), Some(extra), Some(comment)] = lengths else {
            return Err(torn());
        };
        let text = record.get(46..46 + name).ok_or_else(torn)?;
        found.push(Entry {
            name: str::from_utf8(text).map_err(|_| broken("a name in it is no text"))?,
            method: number16(record, 10).ok_or_else(torn)?,
            size: number32(record, 24).ok_or_else(torn)?,
            at: number32(record, 42).ok_or_else(torn)?,
        });
        at += 46 + name + extra + comment;
    }
    Ok(found)
}

fn number16(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

fn number32(bytes: &[u8], at: usize) -> Option<usize> {
    let number = u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?);
    usize::try_from(number).ok()
}

fn broken(problem: &str) -> MeshError {
    MeshError::Broken(format!("no sound usdz package ({problem})"))
}
