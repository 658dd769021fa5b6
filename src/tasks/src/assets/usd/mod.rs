//! USD (`.usd`, `.usda`, `.usdc`, `.usdz`): composed stages of one folder. The triangles of a stage
//! are a mesh; `reel-scene-import` reads houses from the same stages.
//!
//! The crate `openusd` composes and decodes layers. What it would trust is checked before it reads
//! (`layers`, `crate_check`), and it runs on a thread of its own, which may panic.

mod crate_check;
mod geometry;
mod layers;
mod material;
mod package;
mod primvar;
mod stage;
pub mod values;
pub mod xform;

use std::{sync::mpsc, thread};

pub use layers::{FileRequests, Layers};
pub use material::plain_color;
pub use openusd::usd::{Prim, Stage};
pub use stage::{frame, is_shown, known, open, type_name};

use reel_world::mesh::MeshData;

use crate::assets::{MeshError, SiblingFiles, limits::FILE_BYTES_MAX};

/// Stack of the thread that reads: prims nest as deep as the limits say, in builds of any profile.
const STACK_BYTES: usize = 64 << 20;

/// Runs a reader of stages on a thread of its own and answers what it asks for from the files.
///
/// # Errors
/// Its own, or that it gave up: the library that reads USD is young, and panics on some torn files.
pub fn contained<T: Send, E: From<MeshError> + Send>(
    beside: &dyn SiblingFiles,
    read: impl FnOnce(FileRequests) -> Result<T, E> + Send,
) -> Result<T, E> {
    let (ask, asked) = mpsc::channel();
    let (answer, answers) = mpsc::channel();
    let end = End(ask.clone());
    thread::scope(|scope| {
        let thread = thread::Builder::new()
            .name("usd".to_owned())
            .stack_size(STACK_BYTES);
        let reader = thread.spawn_scoped(scope, move || {
            let _end = end;
            read(FileRequests { ask, answers })
        });
        let reader = reader.map_err(|error| {
            MeshError::Broken(format!("no thread can be had to read it ({error})"))
        })?;
        while let Ok(Some(name)) = asked.recv() {
            let name: String = name;
            if answer.send(beside.read(&name)).is_err() {
                break;
            }
        }
        reader.join().unwrap_or_else(|_| {
            let gave_up = "its reader gave up: is it whole? `usdchecker` says more, `usdcat FILE -o FILE.usda` writes it as text";
            Err(MeshError::Broken(gave_up.to_owned()).into())
        })
    })
}

/// Says that the reader has ended, also where it panics or leaves its stage behind.
struct End(mpsc::Sender<Option<String>>);

impl Drop for End {
    fn drop(&mut self) {
        // Nobody listens any more where the folder failed first.
        let _ = self.0.send(None);
    }
}

/// Reads the mesh of a USD file.
///
/// # Errors
/// Why it is refused.
pub(crate) fn read(
    name: &str,
    bytes: &[u8],
    beside: &dyn SiblingFiles,
) -> Result<MeshData, MeshError> {
    contained(beside, |requests| {
        let (stage, layers) = open(name, Some(bytes.to_vec()), requests, FILE_BYTES_MAX)?;
        geometry::read(&stage, &layers)
    })
}

/// A file name for bytes without one, by how they start.
pub(crate) fn name_of(bytes: &[u8]) -> &'static str {
    match bytes {
        [b'P', b'X', b'R', ..] => "mesh.usdc",
        [b'P', b'K', ..] => "mesh.usdz",
        _ => "mesh.usda",
    }
}
