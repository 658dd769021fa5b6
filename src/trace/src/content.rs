//! What the bytes of a trace consist of.

use std::{collections::BTreeMap, path::Path};

use crate::{
    TraceError, TraceFiles,
    container::{self, At, Item},
    files,
    limits::Limits,
};

/// Bytes of a trace by what they are: each channel's messages and each attachment as they are
/// before chunks are compressed, the container around them, and the whole `file` as it is stored.
///
/// # Errors
/// When the file cannot be read or its container is damaged.
pub fn content(files: &TraceFiles, path: &Path) -> Result<BTreeMap<String, u64>, TraceError> {
    let limits = Limits::default();
    let bytes = files::read(files, path, &limits)?;
    let mut shares: BTreeMap<String, u64> = BTreeMap::new();
    container::walk(&bytes, path, &limits, &mut |_: At, item: Item| {
        let (what, length) = match item {
            Item::Message { topic, data, .. } => (topic.to_owned(), data.len()),
            Item::Attachment { header, data } => (header.name.clone(), data.len()),
            Item::Metadata(metadata) => (
                "metadata".to_owned(),
                metadata
                    .metadata
                    .iter()
                    .map(|(key, value)| key.len() + value.len())
                    .sum(),
            ),
            Item::Schema { data, .. } => ("schemas".to_owned(), data.len()),
            _ => return Ok(()),
        };
        *shares.entry(what).or_default() += length as u64;
        Ok(())
    })?;
    shares.insert("file".to_owned(), bytes.len() as u64);
    Ok(shares)
}
