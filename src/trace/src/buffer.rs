//! Memory that a thread uses again for the next file: what is fresh from the system costs more to
//! get than to fill.

use std::{
    cell::RefCell,
    mem,
    ops::{Deref, DerefMut},
};

/// Larger ones go back to the system.
const KEPT_BYTES: usize = 8 << 20;
/// So many are in use at a time: a file, and a chunk of it.
const KEPT: usize = 2;

thread_local! {
    static BUFFERS: RefCell<Vec<Vec<u8>>> = const { RefCell::new(Vec::new()) };
}

/// A buffer that goes back to its thread.
pub(crate) struct Buffer(Vec<u8>);

impl Buffer {
    /// An empty buffer, reused from this thread's pool if one is left.
    pub(crate) fn take() -> Self {
        Self(BUFFERS.with_borrow_mut(Vec::pop).unwrap_or_default())
    }
}

impl From<Vec<u8>> for Buffer {
    fn from(bytes: Vec<u8>) -> Self {
        Self(bytes)
    }
}

impl Deref for Buffer {
    type Target = Vec<u8>;

    fn deref(&self) -> &Vec<u8> {
        &self.0
    }
}

impl DerefMut for Buffer {
    fn deref_mut(&mut self) -> &mut Vec<u8> {
        &mut self.0
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        let mut bytes = mem::take(&mut self.0);
        bytes.clear();
        // a thread that ends keeps nothing
        let _ = BUFFERS.try_with(|buffers| {
            let mut buffers = buffers.borrow_mut();
            if bytes.capacity() <= KEPT_BYTES && buffers.len() < KEPT {
                buffers.push(bytes);
            }
        });
    }
}
