//! What the material of a prim looks like: the diffuse colour or texture of its UsdPreviewSurface,
//! else the plain colour of a shader that is known by its inputs.

use openusd::{
    sdf::{Path, Value},
    usd::{Prim, Stage},
};

use super::{layers::Layers, values};
use crate::assets::MeshError;

/// Most connections from an input to where its value is.
const HOPS_MAX: usize = 16;
/// The diffuse colour of a UsdPreviewSurface that says none.
const PREVIEW_GREY: f64 = 0.18;

/// How a surface looks, its colours in linear light.
#[derive(Clone, PartialEq, Debug)]
pub(super) enum Surface {
    Plain([f64; 3]),
    /// A texture, the factor of its colours, and the primvar of its points.
    Textured {
        /// The file as the layer calls it, for messages.
        name: String,
        /// The file as the stage locates it; empty where it is not found.
        located: String,
        factor: [f64; 3],
        points: String,
    },
    /// The display colour of the mesh.
    Display,
}

/// The material that a prim binds itself, by its path.
pub(super) fn bound(prim: &Prim) -> Option<String> {
    ["material:binding:preview", "material:binding"]
        .iter()
        .find_map(|name| values::target(prim, name))
}

/// The plain colour of the material that a prim binds, whatever its shader.
pub fn plain_color(prim: &Prim) -> Option<[f64; 3]> {
    let path = bound(prim)?;
    shader_color(&prim.stage().prim(path.as_str()))
}

fn shader_color(material: &Prim) -> Option<[f64; 3]> {
    let shaders = material.children().ok()?;
    shaders.iter().find_map(|shader| {
        [
            "inputs:diffuseColor",
            "inputs:diffuse_color_constant",
            "inputs:base_color",
        ]
        .iter()
        .find_map(|name| values::numbers::<3>(shader, name))
    })
}

/// How a material looks; `None` where no shader of it is known.
pub(super) fn surface(stage: &Stage, path: &str) -> Result<Option<Surface>, MeshError> {
    let material = stage.prim(path);
    match source(&material, "outputs:surface") {
        Some(Source::Output(shader)) if is(&shader, "UsdPreviewSurface") => {
            diffuse(&shader).map(Some)
        }
        _ => Ok(shader_color(&material).map(Surface::Plain)),
    }
}

fn diffuse(shader: &Prim) -> Result<Surface, MeshError> {
    let own = || {
        let color = values::numbers::<3>(shader, "inputs:diffuseColor");
        Surface::Plain(color.unwrap_or([PREVIEW_GREY; 3]))
    };
    match source(shader, "inputs:diffuseColor") {
        Some(Source::Value(prim, name)) => {
            Ok(values::numbers::<3>(&prim, &name).map_or_else(own, Surface::Plain))
        }
        Some(Source::Output(node)) if is(&node, "UsdUVTexture") => texture(&node),
        Some(Source::Output(node)) if is(&node, "UsdPrimvarReader_float3") => {
            match word(&node, "inputs:varname").as_deref() {
                Some("displayColor") => Ok(Surface::Display),
                _ => Err(unread(&node, "a colour from a primvar")),
            }
        }
        Some(Source::Output(node)) => Err(unread(&node, "a diffuse colour of a shader network")),
        None => Ok(own()),
    }
}

fn texture(node: &Prim) -> Result<Surface, MeshError> {
    let file = match source(node, "inputs:file") {
        Some(Source::Value(prim, name)) => values::value(&prim, &name),
        _ => None,
    };
    let Some(Value::AssetPath(file)) = file else {
        return Err(unread(node, "a texture without a file"));
    };
    let points = match source(node, "inputs:st") {
        Some(Source::Output(reader)) if is(&reader, "UsdPrimvarReader_float2") => {
            word(&reader, "inputs:varname").unwrap_or_default()
        }
        Some(Source::Output(other)) => {
            return Err(unread(&other, "texture points that a shader moves"));
        }
        _ => "st".to_owned(),
    };
    let factor = values::list_of(node, "inputs:scale");
    let factor = factor.and_then(|factor| factor.first_chunk::<3>().copied());
    Ok(Surface::Textured {
        name: file.asset_path().chars().take(200).collect(),
        located: file.resolved_path().unwrap_or_default().to_owned(),
        factor: factor.unwrap_or([1.0; 3]),
        points,
    })
}

/// The bytes of a texture.
pub(super) fn bytes(layers: &Layers, name: &str, located: &str) -> Result<Vec<u8>, MeshError> {
    if located.is_empty() {
        return Err(MeshError::Missing {
            file: name.to_owned(),
            why: layers
                .refusal(name)
                .unwrap_or_else(|| "there is no such file in its folder".to_owned()),
        });
    }
    layers.file(located)
}

/// Where the value of an input comes from.
enum Source {
    /// An attribute of a prim.
    Value(Prim, String),
    /// An output of a shader.
    Output(Prim),
}

/// Follows connections, through the inputs of materials and graphs, to a value or a shader; `None`
/// where there is neither.
fn source(prim: &Prim, name: &str) -> Option<Source> {
    let (mut prim, mut name) = (prim.clone(), name.to_owned());
    for _ in 0..HOPS_MAX {
        let connections = prim.attribute(name.as_str()).connections().ok()?;
        let Some(next) = connections.first() else {
            let is_set = values::value(&prim, &name).is_some();
            return is_set.then_some(Source::Value(prim, name));
        };
        let (path, property) = split(next)?;
        prim = prim.stage().prim(path);
        name = property.to_owned();
        let is_shader = values::value(&prim, "info:id").is_some();
        if name.starts_with("outputs:") && is_shader {
            return Some(Source::Output(prim));
        }
    }
    None
}

fn split(property: &Path) -> Option<(&str, &str)> {
    property.as_str().rsplit_once('.')
}

fn is(shader: &Prim, id: &str) -> bool {
    values::token(shader, "info:id").is_some_and(|own| own == id)
}

/// A word that an input has or is connected to.
fn word(shader: &Prim, name: &str) -> Option<String> {
    match source(shader, name)? {
        Source::Value(prim, name) => values::token(&prim, &name),
        Source::Output(_) => None,
    }
}

fn unread(node: &Prim, what: &str) -> MeshError {
    MeshError::Prim {
        prim: node.path().as_str().to_owned(),
        problem: format!("{what} is not read; bake it to a texture or a plain colour"),
    }
}
