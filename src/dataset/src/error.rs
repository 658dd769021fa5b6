//! What can go wrong when a dataset is written.

use std::{io, path::PathBuf};

use crate::ImageId;

/// Why something was not written.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum DatasetError {
    /// A file cannot be read or written.
    #[error("cannot write the dataset: {source}: {path}", path = path.display())]
    Io { source: io::Error, path: PathBuf },
    /// An example's image was not put into the store before.
    #[error(
        "example {example} shows image {image}, which is not in the dataset; put it before the row"
    )]
    Image { example: String, image: ImageId },
    /// An image's pixels are not what its size says.
    #[error("image {image} has {found} bytes instead of 3 x {width} x {height}")]
    Pixels {
        /// Digest that names the image with the wrong number of bytes.
        image: ImageId,
        /// Number of bytes that were given as pixels.
        found: usize,
        width: u32,
        height: u32,
    },
    /// An image cannot be resized or encoded.
    #[error("image {image} cannot be encoded: {reason}")]
    Encode { image: ImageId, reason: String },
    /// The format cannot hold an example as it is.
    #[error("example {example} cannot be written as {format}: {reason}")]
    UnsupportedFormat {
        example: String,
        format: &'static str,
        reason: &'static str,
    },
    /// A tokenizer's file is none.
    #[error("no tokenizer: {reason}: {path}; give the `tokenizer.json` of the model's weights", path = path.display())]
    Tokenizer { reason: String, path: PathBuf },
    /// Ratios of a split that are none.
    #[error("split ratios {found:?} are not three numbers from 0 that add up to more than 0")]
    Ratios { found: [f64; 3] },
}

impl DatasetError {
    pub(crate) fn io(path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| DatasetError::Io { source, path }
    }
}
