//! Opening a stage: its layers from one folder, its units and its up axis, what it shows.

use std::rc::Rc;

use openusd::{
    pcp,
    sdf::Value,
    usd::{Prim, Stage},
};

use super::{
    layers::{FOLDER, FileRequests, FolderResolver, Layers, OUTSIDE},
    values,
};
use crate::assets::{MeshError, affine::Affine};

/// Opens a file as a stage, with its bytes where they are known, of so many bytes at most with the
/// files that it names. Layers that do not open are found
/// as it is walked, see `composition_error`.
///
/// # Errors
/// Why the file itself does not open.
pub fn open(
    name: &str,
    bytes: Option<Vec<u8>>,
    requests: FileRequests,
    bytes_max: u64,
) -> Result<(Stage, Rc<Layers>), MeshError> {
    let layers = Layers::new(requests, bytes_max);
    let root = layers.root(name, bytes)?;
    let resolver = FolderResolver(Rc::clone(&layers));
    let stage = Stage::builder()
        .resolver(resolver)
        .open(&root)
        .map_err(|error| {
            MeshError::Broken(format!(
                "{}; `usdcat` of OpenUSD converts between .usda, .usdc and .usdz",
                readable(&format!("{error:#}"), 400)
            ))
        })?;
    Ok((stage, layers))
}

/// From the stage's axes and units to metres with z up.
///
/// # Errors
/// Where `metersPerUnit` is no length.
pub fn frame(stage: &Stage) -> Result<Affine, MeshError> {
    let metadata = |name: &str| stage.stage_metadata(name).ok().flatten();
    let metres = metadata("metersPerUnit").and_then(|value| values::list(&value)?.first().copied());
    // A stage that does not say is in centimetres, as the format has it.
    let metres = metres.unwrap_or(0.01);
    if !(metres > 0.0 && metres <= 1e4) {
        return Err(MeshError::Broken(
            "metersPerUnit: must be above 0 and no more than 10000".to_owned(),
        ));
    }
    let is_z = matches!(metadata("upAxis"), Some(Value::Token(axis)) if axis.as_str() == "Z");
    let turn = if is_z {
        Affine::IDENTITY
    } else {
        // Not by an angle: a quarter turn is exact.
        Affine {
            axes: [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]],
            origin: [0.0; 3],
        }
    };
    Ok(turn.after(&Affine::scaled([metres; 3])))
}

/// Whether a prim shows: active, defined, no class, visible, and neither guide nor proxy.
///
/// # Errors
/// Where the stage cannot say.
pub fn is_shown(prim: &Prim) -> Result<bool, MeshError> {
    let is_there =
        known(prim.is_active())? && known(prim.is_defined())? && !known(prim.is_abstract())?;
    let hidden = values::token(prim, "visibility").is_some_and(|value| value == "invisible");
    let helper =
        values::token(prim, "purpose").is_some_and(|value| value == "guide" || value == "proxy");
    Ok(is_there && !hidden && !helper)
}

/// The name of a prim's type; empty where it has none.
///
/// # Errors
/// Where the stage cannot say.
pub fn type_name(prim: &Prim) -> Result<String, MeshError> {
    let name = known(prim.type_name())?;
    Ok(name.map_or_else(String::new, |name| name.as_str().to_owned()))
}

/// What the library answers, with its error as ours.
///
/// # Errors
/// That of the library.
pub fn known<T>(result: Result<T, impl std::fmt::Display>) -> Result<T, MeshError> {
    result.map_err(|error| MeshError::Broken(readable(&error.to_string(), 400)))
}

/// The first layer, reference or payload that left something out of what was walked, as a reason to
/// refuse the stage.
pub(super) fn composition_error(stage: &Stage, layers: &Layers) -> Option<MeshError> {
    stage
        .composition_errors()
        .iter()
        .find_map(|error| refusal(error, layers))
}

fn refusal(error: &pcp::Error, layers: &Layers) -> Option<MeshError> {
    use pcp::Error as E;
    let at = |prim: &str, problem: String| {
        Some(MeshError::Prim {
            prim: prim.to_owned(),
            problem,
        })
    };
    let unopened = |name: &str| {
        let reason = layers.refusal(name);
        let reason = reason.unwrap_or_else(|| "it cannot be opened".to_owned());
        format!("@{}@ is missing: {reason}", readable(name, 200))
    };
    match error {
        E::UnresolvedLayer {
            asset_path,
            site_path,
            ..
        } => at(site_path.as_str(), unopened(asset_path)),
        E::UnresolvedSublayer {
            asset_path,
            introduced_by,
        } => at(&readable(introduced_by, 200), unopened(asset_path)),
        E::ArcCycle(chain) => at(
            chain.composing.as_str(),
            "its references lead back to itself; remove one of them".to_owned(),
        ),
        E::MalformedLayer { site_path, .. }
        | E::InvalidPrimPath { site_path, .. }
        | E::UnresolvedPrimPath { site_path, .. }
        | E::MissingDefaultPrim { site_path, .. }
        | E::InvalidDefaultPrim { site_path, .. } => {
            at(site_path.as_str(), readable(&error.to_string(), 400))
        }
        E::MalformedSublayer { .. } | E::SublayerCycle { .. } | E::InvalidExpression { .. } => {
            Some(MeshError::Broken(readable(&error.to_string(), 400)))
        }
        // Targets and relocations that lead nowhere leave all prims in place.
        _ => None,
    }
}

/// A message of the library with our names for files, not too long.
fn readable(text: &str, length_max: usize) -> String {
    let text = text.replace(FOLDER, "").replace(OUTSIDE, "");
    text.chars().take(length_max).collect()
}
