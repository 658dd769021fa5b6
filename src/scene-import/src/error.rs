//! Why a file cannot be imported: where, what is wrong, and what to do.

/// Why nothing was imported from a file. The message names the file.
#[derive(Clone, PartialEq, Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum ImportError {
    /// The file or one that it names cannot be read.
    #[error("{file}: cannot read it ({reason})")]
    Unreadable { file: String, reason: String },
    /// Its text is torn or of another format.
    #[error("{file}:{line}: {problem}")]
    Syntax {
        file: String,
        line: usize,
        problem: String,
    },
    /// A part of it makes no sense.
    #[error("{file}: {at}: {problem}")]
    Invalid {
        file: String,
        /// The field, element or prim.
        at: String,
        problem: String,
    },
    /// The ending and the content name no format that is read.
    #[error(
        "{file}: no format that is read: ProcTHOR (.json), USD (.usda, .usdc, .usdz), MJCF (.xml, .mjcf), URDF (.urdf); if it is one of these, name it with --format"
    )]
    UnknownFormat { file: String },
    /// It was read, and holds no furniture that a scene can have.
    #[error("{file}: no furniture to put objects on: {reason}")]
    Nothing { file: String, reason: String },
}

impl ImportError {
    pub(crate) fn invalid(file: &str, at: impl Into<String>, problem: impl Into<String>) -> Self {
        ImportError::Invalid {
            file: file.to_owned(),
            at: at.into(),
            problem: problem.into(),
        }
    }
}
