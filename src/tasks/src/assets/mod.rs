//! Meshes of objects from a folder of glTF, OBJ and USD files, each named by the asset it shows: read,
//! checked, and refused with a reason where they are not sound. Never changes a mesh: what has too
//! many triangles is refused, not decimated.
//!
//! [`AssetFolder`] is the one place that opens files, and only files of the folder itself.
//! The parsers believe nothing.

pub mod affine;
mod color;
mod folder;
mod gltf;
pub mod limits;
mod obj;
mod survey;
mod texture;
pub mod usd;

use reel_world::mesh::{Mesh, MeshDefect, TRIANGLES_MAX};

pub use folder::{AssetFolder, FileReport, MeshVerdict};
pub use survey::Survey;

/// Where a parser gets the files that a file names.
pub trait SiblingFiles {
    /// The bytes of a file beside it.
    ///
    /// # Errors
    /// Why they cannot be had.
    fn read(&self, name: &str) -> Result<Vec<u8>, MeshError>;
}

/// Sibling files of a mesh that stands alone: every read fails.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoSiblings;

impl SiblingFiles for NoSiblings {
    fn read(&self, name: &str) -> Result<Vec<u8>, MeshError> {
        Err(MeshError::Missing {
            file: name.to_owned(),
            why: "there are no files beside it".to_owned(),
        })
    }
}

/// The kinds of files that hold a mesh, the first one first where there are several of an asset.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum MeshFormat {
    /// Binary glTF, in files that end with `.glb`.
    Glb,
    /// glTF as JSON, in files that end with `.gltf`.
    Gltf,
    /// Wavefront OBJ text, in files that end with `.obj`.
    Obj,
    /// A USD layer or package, in files that end with `.usd`, `.usda`, `.usdc` or `.usdz`.
    Usd,
}

impl MeshFormat {
    /// By the end of a file's name.
    pub fn of(extension: &str) -> Option<Self> {
        match extension.to_ascii_lowercase().as_str() {
            "glb" => Some(MeshFormat::Glb),
            "gltf" => Some(MeshFormat::Gltf),
            "obj" => Some(MeshFormat::Obj),
            "usd" | "usda" | "usdc" | "usdz" => Some(MeshFormat::Usd),
            _ => None,
        }
    }
}

/// Reads a mesh from the bytes of its file.
///
/// # Errors
/// Why it is refused.
pub fn parse(kind: MeshFormat, bytes: &[u8], beside: &dyn SiblingFiles) -> Result<Mesh, MeshError> {
    parse_file(kind, usd::name_of(bytes), bytes, beside)
}

/// Reads a mesh from a file of that name, which layers of USD may refer to.
fn parse_file(
    kind: MeshFormat,
    name: &str,
    bytes: &[u8],
    beside: &dyn SiblingFiles,
) -> Result<Mesh, MeshError> {
    let data = match kind {
        MeshFormat::Glb | MeshFormat::Gltf => gltf::read(bytes, beside)?,
        MeshFormat::Obj => obj::read(bytes, beside)?,
        MeshFormat::Usd => usd::read(name, bytes, beside)?,
    };
    Ok(Mesh::new(data)?)
}

/// Why a file is no mesh of ours.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum MeshError {
    /// Not what its name says.
    #[error("{0}")]
    Broken(String),
    /// Something of its format that we do not read.
    #[error("it needs {0}, which is not supported; export it without")]
    Unsupported(String),
    /// A line of text.
    #[error("line {line}: {problem}")]
    Line {
        /// Number of the line in the file, from 1.
        line: usize,
        problem: String,
    },
    /// A prim of a USD stage, or a layer.
    #[error("{prim}: {problem}")]
    Prim {
        /// The path of the prim in the stage.
        prim: String,
        problem: String,
    },
    /// The mesh or a file that it needs exceeds a limit.
    #[error("it has {found} {what}, and at most {limit} are taken; {advice}")]
    TooLarge {
        /// The unit that is counted, e.g. `vertices` or `bytes`.
        what: &'static str,
        found: usize,
        limit: usize,
        /// What to change in the file, e.g. `join them`.
        advice: &'static str,
    },
    /// The file parses, but its data do not form a valid mesh.
    #[error(transparent)]
    Mesh(#[from] MeshDefect),
    /// In a file that it names.
    #[error("in {file}: {reason}")]
    In {
        /// Name of the file as it is written there, or e.g. `image 3` if it is embedded.
        file: String,
        reason: Box<MeshError>,
    },
    /// A file that it names cannot be read.
    #[error("the file {file} cannot be read ({why})")]
    Missing {
        file: String,
        /// Why the file cannot be read, e.g. the operating system's message.
        why: String,
    },
    /// A file that it names lies elsewhere.
    #[error(
        "it names {file}, which is not in its folder; put it beside the mesh and name it without a path"
    )]
    Outside { file: String },
}

impl MeshError {
    fn too_large(what: &'static str, found: usize, limit: usize, advice: &'static str) -> Self {
        MeshError::TooLarge {
            what,
            found,
            limit,
            advice,
        }
    }

    fn too_many_triangles() -> Self {
        Self::too_large(
            "triangles or more",
            TRIANGLES_MAX + 1,
            TRIANGLES_MAX,
            DECIMATE,
        )
    }

    /// Of a texture; files say their names themselves.
    fn texture(name: &str, reason: MeshError) -> Self {
        match reason {
            reason @ (MeshError::In { .. }
            | MeshError::Missing { .. }
            | MeshError::Outside { .. }) => reason,
            reason => MeshError::In {
                file: name.to_owned(),
                reason: Box::new(reason),
            },
        }
    }
}

const DECIMATE: &str = "decimate it, in Blender with the modifier of that name";

/// glTF and OBJ have y up and look along z; we have z up.
fn upright([x, y, z]: [f32; 3]) -> [f32; 3] {
    [x, -z, y]
}
