//! What can go wrong when a dataset is written.

use std::{io, path::PathBuf};

use crate::ImageId;

/// Why something was not written.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// A file cannot be read or written.
    #[error("cannot write the dataset: {source}: {path}", path = path.display())]
    Io {
        /// The error that the operating system reported.
        source: io::Error,
        /// Path of the file or folder that could not be read or written.
        path: PathBuf,
    },
    /// An example's picture was not put into the store before.
    #[error(
        "example {example} shows picture {image}, which is not in the dataset: put it before the row"
    )]
    Image {
        /// Id of the example that shows the image.
        example: String,
        /// Digest of the image that is missing from the store.
        image: ImageId,
    },
    /// A picture's pixels are not what its size says.
    #[error("picture {image} has {found} bytes instead of 3 x {width} x {height}")]
    Pixels {
        /// Digest that names the image with the wrong number of bytes.
        image: ImageId,
        /// Number of bytes that were given as pixels.
        found: usize,
        /// Width that was given for the image, in pixels.
        width: u32,
        /// Height that was given for the image, in pixels.
        height: u32,
    },
    /// A picture cannot be resized or encoded.
    #[error("picture {image} cannot be encoded: {reason}")]
    Encode {
        /// Digest that names the image that cannot be resized or encoded.
        image: ImageId,
        /// The error that the image library reported.
        reason: String,
    },
    /// The format cannot hold an example as it is.
    #[error("example {example} cannot be written as {format}: {reason}")]
    UnsupportedFormat {
        /// Id of the example that cannot be written.
        example: String,
        /// Name of the format that cannot hold the example.
        format: &'static str,
        /// Why the format cannot hold the example.
        reason: &'static str,
    },
    /// A tokenizer's file is none.
    #[error("no tokenizer: {reason}: {path}; give the `tokenizer.json` that lies beside a model's weights", path = path.display())]
    Tokenizer {
        /// Why it cannot be read.
        reason: String,
        /// Path of the tokenizer file that was given.
        path: PathBuf,
    },
    /// Ratios of a split that are none.
    #[error("split ratios {found:?} are not three numbers from 0 that add up to more than 0")]
    Ratios {
        /// The ratios as given, for train, validation and test.
        found: [f64; 3],
    },
}

impl DatasetError {
    pub(crate) fn io(path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| DatasetError::Io { source, path }
    }
}
