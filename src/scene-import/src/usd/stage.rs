//! Opening a stage: its layers from the folder of the file, its units and its up axis.

use std::{
    io::{self, Cursor, Read as _},
    path::{Path, PathBuf},
    time::SystemTime,
};

use openusd::{
    ar::{Asset, DefaultResolver, ResolvedPath, Resolver},
    sdf::Value,
    usd::Stage,
};
use reel_tasks::assets::limits::FILE_BYTES_MAX;

use super::values;
use crate::{
    ImportError,
    affine::Affine,
    files::{DEPTH_MAX, ImportFiles},
};

/// Opens the file as a stage.
pub(super) fn open(files: &ImportFiles) -> Result<Stage, ImportError> {
    let invalid = |problem: String| ImportError::invalid(&files.name, "the stage", problem);
    let bytes = files.bytes(&files.name)?;
    if let Some(line) = too_deep(&bytes) {
        return Err(ImportError::Syntax {
            file: files.name.clone(),
            line,
            problem: format!("brackets nest deeper than {DEPTH_MAX}"),
        });
    }
    let folder = files.folder().to_owned();
    let path = folder.join(&files.name);
    let resolver = FolderResolver {
        inner: DefaultResolver::with_search_paths([&folder]),
        folder,
    };
    let path = path
        .to_str()
        .ok_or_else(|| invalid("its path is no text".to_owned()))?;
    Stage::builder()
        .resolver(resolver)
        .open(path)
        .map_err(|error| {
            let text: String = format!("{error:#}").chars().take(400).collect();
            invalid(format!(
                "{text}; `usdcat` of OpenUSD converts between .usda, .usdc and .usdz"
            ))
        })
}

/// The line where brackets nest too deep in a text layer; its parser would recurse as deep.
fn too_deep(bytes: &[u8]) -> Option<usize> {
    if !bytes.starts_with(b"#usda") {
        return None;
    }
    let (mut depth, mut line) = (0_usize, 1);
    for byte in bytes {
        match byte {
            b'\n' => line += 1,
            b'{' | b'[' | b'(' => depth += 1,
            b'}' | b']' | b')' => depth = depth.saturating_sub(1),
            _ => {}
        }
        // A prim and what is in it count as two.
        if depth > 2 * DEPTH_MAX {
            return Some(line);
        }
    }
    None
}

/// From the stage's axes and units to metres with z up.
pub(super) fn frame(stage: &Stage, file: &str) -> Result<Affine, ImportError> {
    let metadata = |name: &str| stage.stage_metadata(name).ok().flatten();
    let metres = metadata("metersPerUnit").and_then(|value| values::list(&value)?.first().copied());
    // A stage that does not say is in centimetres, as the format has it.
    let metres = metres.unwrap_or(0.01);
    if !(metres > 0.0 && metres <= 1e4) {
        return Err(ImportError::invalid(
            file,
            "metersPerUnit",
            "must be above 0 and no more than 10000",
        ));
    }
    let is_z = matches!(metadata("upAxis"), Some(Value::Token(axis)) if axis.as_str() == "Z");
    let turn = if is_z {
        Affine::IDENTITY
    } else {
        Affine::turned(0, std::f64::consts::FRAC_PI_2)
    };
    Ok(turn.after(&Affine::scaled([metres; 3])))
}

/// Finds layers in one folder and below, and nowhere else.
struct FolderResolver {
    inner: DefaultResolver,
    /// Canonical path of the folder.
    folder: PathBuf,
}

impl FolderResolver {
    fn holds(&self, path: &Path) -> bool {
        // Of a package the file, not what is named in it.
        let text = path.to_string_lossy();
        let file = text.split('[').next().unwrap_or_default();
        Path::new(file)
            .canonicalize()
            .is_ok_and(|path| path.starts_with(&self.folder))
    }
}

impl Resolver for FolderResolver {
    fn create_identifier(&self, asset_path: &str, anchor: Option<&ResolvedPath>) -> String {
        self.inner.create_identifier(asset_path, anchor)
    }

    fn resolve(&self, asset_path: &str) -> Option<ResolvedPath> {
        self.inner
            .resolve(asset_path)
            .filter(|path| self.holds(path))
    }

    fn resolve_for_new_asset(&self, _: &str) -> Option<ResolvedPath> {
        None
    }

    fn open_asset(&self, path: &ResolvedPath) -> io::Result<Box<dyn Asset>> {
        if !self.holds(path) {
            return Err(io::Error::other(
                "lies outside of the folder of the file to import",
            ));
        }
        let mut bytes = Vec::new();
        self.inner
            .open_asset(path)?
            .take(FILE_BYTES_MAX + 1)
            .read_to_end(&mut bytes)?;
        if bytes.len() as u64 > FILE_BYTES_MAX {
            return Err(io::Error::other(format!(
                "is larger than {FILE_BYTES_MAX} bytes"
            )));
        }
        Ok(Box::new(Cursor::new(bytes)))
    }

    fn get_modification_timestamp(&self, _: &str, _: &ResolvedPath) -> Option<SystemTime> {
        None
    }

    fn identity(&self) -> String {
        self.folder.display().to_string()
    }
}
