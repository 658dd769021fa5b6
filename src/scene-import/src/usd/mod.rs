//! USD: a composed stage of layers, as text, binary or archive. Prims become rooms, walls and
//! furniture by their semantic labels and names, physics joints become drawers and doors.

mod joints;
mod labels;
mod layout;
mod shapes;

use reel_tasks::assets::{
    MeshError,
    usd::{self, FileRequests, Prim, xform},
};

use crate::{
    ImportError,
    affine::Affine,
    files::{DEPTH_MAX, ImportFiles},
    house::{House, Joint, SourceSolid},
    notes::Notes,
};

/// Most prims of a stage.
const PRIMS_MAX: usize = 200_000;

/// A prim with what matters of it.
struct PrimItem {
    path: String,
    name: String,
    /// The words of its semantic label, or its name.
    label: String,
    /// Whether it is a model of its own: of kind component, referenced, or called `model`.
    is_model: bool,
    children: usize,
}

/// A solid and the prim that it is of, in the frame of the scene.
struct ShapeItem {
    path: String,
    solid: SourceSolid,
}

/// A joint and the prim that it moves.
struct JointItem {
    path: String,
    moves: String,
    joint: Joint,
}

/// All of a stage that is read.
#[derive(Default)]
struct Content {
    prims: Vec<PrimItem>,
    shapes: Vec<ShapeItem>,
    joints: Vec<JointItem>,
    notes: Notes,
}

/// Reads a stage of the folder.
pub(crate) fn read(files: &ImportFiles) -> Result<House, ImportError> {
    let read = usd::contained(files.folder(), |requests| {
        content(&files.name, requests).map_err(Failure::Import)
    });
    match read {
        Ok(content) => Ok(layout::house(content)),
        Err(Failure::Import(error)) => Err(error),
        Err(Failure::Stage(problem)) => Err(ImportError::invalid(
            &files.name,
            "the file",
            problem.to_string(),
        )),
    }
}

/// Why a stage is not read: by our reader, or by what contains it.
enum Failure {
    Import(ImportError),
    Stage(MeshError),
}

impl From<MeshError> for Failure {
    fn from(problem: MeshError) -> Self {
        Failure::Stage(problem)
    }
}

fn content(file: &str, requests: FileRequests) -> Result<Content, ImportError> {
    let of_stage =
        |problem: MeshError| ImportError::invalid(file, "the stage", problem.to_string());
    // A house is of many layers, each no larger than a file may be.
    let (stage, _) = usd::open(file, None, requests, u64::MAX).map_err(of_stage)?;
    let frame = usd::frame(&stage).map_err(of_stage)?;
    let mut walk = Walk {
        file,
        frame,
        content: Content::default(),
        placed: Vec::new(),
        joints: Vec::new(),
    };
    for prim in walk.known(stage.prim("/").children())? {
        walk.prim(&prim, &frame, 0)?;
    }
    for problem in stage.composition_errors() {
        let text: String = problem.to_string().chars().take(100).collect();
        walk.content
            .notes
            .left_out(format!("layer or prim that does not compose: {text}"));
    }
    joints::place(&mut walk)?;
    Ok(walk.content)
}

/// What is gathered on the way through a stage.
struct Walk<'a> {
    file: &'a str,
    /// From the stage to metres with z up.
    frame: Affine,
    content: Content,
    /// The frames of all prims, for joints.
    placed: Vec<(String, Affine)>,
    joints: Vec<Prim>,
}

impl Walk<'_> {
    fn known<T>(&self, result: Result<T, impl std::fmt::Display>) -> Result<T, ImportError> {
        result.map_err(|error| ImportError::invalid(self.file, "the stage", error.to_string()))
    }

    fn prim(&mut self, prim: &Prim, outer: &Affine, depth: usize) -> Result<(), ImportError> {
        let path = prim.path().as_str().to_owned();
        if depth > DEPTH_MAX || self.content.prims.len() >= PRIMS_MAX {
            let problem = format!("over {PRIMS_MAX} prims, or nested deeper than {DEPTH_MAX}");
            return Err(ImportError::invalid(self.file, path, problem));
        }
        if !self.known(usd::is_shown(prim))? {
            return Ok(());
        }
        let kind = self.known(usd::type_name(prim))?;
        if kind.starts_with("Physics") && kind.ends_with("Joint") {
            self.joints.push(prim.clone());
            return Ok(());
        }
        if matches!(
            kind.as_str(),
            "Material" | "Shader" | "GeomSubset" | "Camera" | "PhysicsScene"
        ) || kind.ends_with("Light")
        {
            return Ok(());
        }
        let frame = xform::frame(prim, outer, &self.frame)
            .map_err(|problem| ImportError::invalid(self.file, &path, problem))?;
        self.placed.push((path.clone(), frame));
        let children = self.known(prim.children())?;
        let name = prim.path().name().unwrap_or_default().to_owned();
        self.content.prims.push(PrimItem {
            label: labels::label(prim).unwrap_or_else(|| name.clone()),
            is_model: labels::is_model(prim, &name),
            children: children.len(),
            path: path.clone(),
            name,
        });
        let solid = shapes::solid(prim, &kind, &frame, &mut self.content.notes)
            .map_err(|problem| ImportError::invalid(self.file, &path, problem))?;
        self.content
            .shapes
            .extend(solid.map(|solid| ShapeItem { path, solid }));
        for child in children {
            self.prim(&child, &frame, depth + 1)?;
        }
        Ok(())
    }
}
