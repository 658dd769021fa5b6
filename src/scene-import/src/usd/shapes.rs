//! Shapes of prims as solids, with their colours.

use openusd::usd::Prim;
use reel_world::{Solid, SolidShape};

use super::values;
use crate::{
    affine::{Affine, Bounds},
    files::is_sane,
    house::SourceSolid,
    notes::Notes,
    urdf::{bytes_of, unplaced},
};

/// The solid of a prim, if its type is a shape; or what is wrong with it.
pub(super) fn solid(
    prim: &Prim,
    kind: &str,
    frame: &Affine,
    notes: &mut Notes,
) -> Result<Option<SourceSolid>, String> {
    let number = |name: &str, usual: f64| {
        let value = values::numbers::<1>(prim, name).map_or(usual, |[value]| value);
        if value > 0.0 {
            Ok(value)
        } else {
            Err(format!("{name} must be above 0"))
        }
    };
    let along = |radius: f64, half_height: f64| {
        let upright = unplaced(SolidShape::Cylinder {
            radius,
            half_height,
        });
        let turn = match values::token(prim, "axis").as_deref() {
            Some("X") => Affine::turned(1, std::f64::consts::FRAC_PI_2),
            Some("Y") => Affine::turned(0, -std::f64::consts::FRAC_PI_2),
            _ => Affine::IDENTITY,
        };
        turn.primitive(&upright)
    };
    let (local, is_bounds) = match kind {
        "Cube" => {
            let half = number("size", 2.0)? * 0.5;
            (unplaced(SolidShape::Box { half: [half; 3] }), false)
        }
        "Sphere" => (
            unplaced(SolidShape::Sphere {
                radius: number("radius", 1.0)?,
            }),
            false,
        ),
        "Cylinder" => (
            along(number("radius", 1.0)?, number("height", 2.0)? * 0.5),
            false,
        ),
        "Capsule" => {
            notes.approximated("capsule: a cylinder");
            let radius = number("radius", 0.5)?;
            (along(radius, number("height", 1.0)? * 0.5 + radius), false)
        }
        "Cone" => {
            notes.approximated("cone: a cylinder");
            (
                along(number("radius", 1.0)?, number("height", 2.0)? * 0.5),
                false,
            )
        }
        "Mesh" => match mesh(prim)? {
            Some(bounds) => {
                notes.approximated("mesh: the box of its bounds");
                (
                    bounds.solid(unplaced(SolidShape::Sphere { radius: 1.0 }).color),
                    true,
                )
            }
            None => {
                notes.left_out("mesh without points");
                return Ok(None);
            }
        },
        "" | "Xform" | "Scope" | "SkelRoot" | "Plane" => return Ok(None),
        other => {
            let shown: String = other.chars().take(40).collect();
            notes.left_out(format!("prim of type {shown}"));
            return Ok(None);
        }
    };
    let color = color(prim);
    let placed = frame.primitive(&local);
    let is_finite = Bounds::of(&placed).high.into_iter().all(is_sane);
    if !is_finite {
        return Err("its size or place is beyond a million metres".to_owned());
    }
    Ok(Some(SourceSolid {
        primitive: Solid {
            color: color.unwrap_or(local.color),
            ..placed
        },
        is_bounds,
        is_coloured: color.is_some(),
    }))
}

fn mesh(prim: &Prim) -> Result<Option<Bounds>, String> {
    let Some(points) = values::value(prim, "points").and_then(|value| values::list(&value)) else {
        return Ok(None);
    };
    if !points.iter().all(|value| is_sane(*value)) {
        return Err("points has a number that is not finite".to_owned());
    }
    Ok(Bounds::of_points(
        points
            .chunks_exact(3)
            .map(|point| [point[0], point[1], point[2]]),
    ))
}

/// Its display colour, or the plain colour of its material.
fn color(prim: &Prim) -> Option<[u8; 3]> {
    let shown = values::value(prim, "primvars:displayColor").and_then(|value| values::list(&value));
    let first = shown.and_then(|list| list.first_chunk::<3>().copied());
    first.or_else(|| material_color(prim)).map(bytes_of)
}

fn material_color(prim: &Prim) -> Option<[f64; 3]> {
    let path = values::target(prim, "material:binding")?;
    let material = prim.stage().prim(path.as_str());
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
