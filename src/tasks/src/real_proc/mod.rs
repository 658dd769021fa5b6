//! Files of REAL's task generator: `<scene>/<type>.yaml`, and `physics_passed.yaml` after its
//! physics check. One file holds the objects `obj_0`, `obj_1`, ... and any number of episodes that
//! place them; plans are texts, ids have no leading `_`.
//!
//! [`export`] writes them, and the loader reads them like any other task file. They say less than
//! files of REAL-Bench: no graphs, captions or attributes.

mod read;
mod write;

pub(crate) use read::{is_proc, read};
pub use write::{
    ProcEpisode, ProcFile, ProcKind, ProcObject, Source, export, group, paths, purpose_group,
    strip_underscore,
};
