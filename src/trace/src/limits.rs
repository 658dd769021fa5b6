//! How much is taken from a file that nobody vouches for.

/// Bounds of what the reader takes from a file that nobody vouches for.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Limits {
    /// Largest file, in bytes.
    pub file_bytes: u64,
    /// Largest chunk, compressed or not, in bytes; bounds every message too.
    pub chunk_bytes: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            file_bytes: 2 << 30,
            chunk_bytes: 256 << 20,
        }
    }
}
