//! Houses and furniture of other simulators as scenes: ProcTHOR and AI2-THOR JSON, USD,
//! MJCF, URDF.
//!
//! Every format is read into rooms and furniture of solids with joints (`house`), and that becomes a
//! scene (`assemble`) that is parsed and checked like any scene file. What is approximated and what
//! is left out is counted. Opens no file outside of the folder of the one it is given; never writes.

mod affine;
mod assemble;
mod captions;
mod categories;
mod colors;
mod element;
mod error;
mod files;
mod house;
mod meshes;
mod mjcf;
mod notes;
mod parts;
mod polygons;
mod procthor;
mod report;
mod sizes;
mod surfaces;
mod tree;
mod urdf;
mod usd;

use std::path::Path;

use reel_tasks::generate::scene::check;
use reel_world::Scene;

pub use error::ImportError;
pub use notes::Note;
pub use report::{ImportReport, ReceptacleReport};

use assemble::assemble;
use files::ImportFiles;
use house::House;
use procthor::AssetSizes;

/// A format of houses or furniture.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SceneFormat {
    /// A house of ProcTHOR or AI2-THOR, as JSON.
    Procthor,
    /// Universal Scene Description: text, binary or archive.
    Usd,
    /// The XML of MuJoCo.
    Mjcf,
    /// The Unified Robot Description Format.
    Urdf,
}

impl SceneFormat {
    /// Every format, in the order of the documentation.
    pub const ALL: [Self; 4] = [Self::Procthor, Self::Usd, Self::Mjcf, Self::Urdf];

    /// Its name in arguments and reports.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Procthor => "procthor",
            Self::Usd => "usd",
            Self::Mjcf => "mjcf",
            Self::Urdf => "urdf",
        }
    }

    /// By its name, e.g. `mjcf`.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.as_str() == name)
    }

    /// By a file's ending, and where that is not enough by how its text begins.
    fn detect(name: &str, text: &str) -> Option<Self> {
        match name.rsplit_once('.')?.1.to_ascii_lowercase().as_str() {
            "json" if procthor::is_house(text) => Some(Self::Procthor),
            "usd" | "usda" | "usdc" | "usdz" => Some(Self::Usd),
            "urdf" => Some(Self::Urdf),
            "mjcf" => Some(Self::Mjcf),
            "xml" if text.contains("<mujoco") => Some(Self::Mjcf),
            "xml" if text.contains("<robot") => Some(Self::Urdf),
            _ => None,
        }
    }
}

/// How to import a file.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct ImportOptions {
    /// `None`: by the file's ending and content.
    pub format: Option<SceneFormat>,
    /// Text of a JSON file with the sizes of ProcTHOR's assets, and its name for errors.
    pub asset_sizes: Option<(String, String)>,
    /// Name of the scene; `None`: that of the file.
    pub scene_id: Option<String>,
}

/// A scene, and what became of the file's content.
#[derive(Clone, PartialEq, Debug)]
pub struct Imported {
    /// The scene as it is parsed from its file.
    pub scene: Scene,
    /// What was read, approximated and left out, and whether the robot reaches it.
    pub report: ImportReport,
}

/// Imports a file.
///
/// # Errors
/// When it cannot be read, is torn or of no format that is read, or holds no furniture.
pub fn import(path: &Path, options: &ImportOptions) -> Result<Imported, ImportError> {
    let files = ImportFiles::beside(path)?;
    let file = files.name.clone();
    let text = String::from_utf8_lossy(&files.bytes(&file)?).into_owned();
    let format = options.format.or_else(|| SceneFormat::detect(&file, &text));
    let format = format.ok_or_else(|| ImportError::UnknownFormat { file: file.clone() })?;
    let house: House = match format {
        SceneFormat::Procthor => {
            let sizes = match &options.asset_sizes {
                Some((text, name)) => AssetSizes::parse(text, name)?,
                None => AssetSizes::default(),
            };
            procthor::read(&text, &file, &sizes)?
        }
        SceneFormat::Usd => usd::read(&files)?,
        SceneFormat::Mjcf => mjcf::read(&files)?,
        SceneFormat::Urdf => urdf::read(&files)?,
    };
    let scene_id = options
        .scene_id
        .clone()
        .unwrap_or_else(|| scene_id(&file, &house));
    let left_out = house.notes.left_out.clone();
    let assembled = assemble(&scene_id, house).ok_or_else(|| ImportError::Nothing {
        file: file.clone(),
        reason: nothing(&left_out),
    })?;
    let invalid = |problem: String| ImportError::invalid(&file, "the scene made of it", problem);
    let text =
        serde_json::to_string(&assembled.scene).map_err(|error| invalid(error.to_string()))?;
    let loaded =
        reel_tasks::scene::parse(&text, &file).map_err(|error| invalid(error.to_string()))?;
    let findings = check(&loaded.scene);
    let report = ImportReport::new(
        &file,
        format,
        &loaded,
        &findings,
        assembled.sources,
        assembled.notes,
    );
    Ok(Imported {
        scene: loaded.scene,
        report,
    })
}

/// The name of a file without its ending, as letters, digits and underscores.
fn scene_id(file: &str, house: &House) -> String {
    let stem = file.rsplit_once('.').map_or(file, |(stem, _)| stem);
    let plain = |text: &str| -> String {
        let sign = |letter: char| {
            if letter.is_ascii_alphanumeric() || letter == '-' {
                letter
            } else {
                '_'
            }
        };
        text.chars().take(80).map(sign).collect()
    };
    let name = plain(stem);
    if name.trim_matches('_').is_empty() {
        plain(&format!("scene_{}", house.name))
    } else {
        name
    }
}

fn nothing(left_out: &std::collections::BTreeMap<String, Note>) -> String {
    if left_out.is_empty() {
        return "it has no solids".to_owned();
    }
    let kinds: Vec<String> = left_out
        .iter()
        .take(8)
        .map(|(kind, note)| format!("{} x {kind}", note.count))
        .collect();
    format!("left out were {}", kinds.join("; "))
}
