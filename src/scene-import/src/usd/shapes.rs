//! Shapes of prims as solids, with their colours.

use reel_tasks::assets::usd::{Prim, plain_color, values};
use reel_world::{Solid, SolidShape};

use crate::{
    affine::{Affine, Bounds},
    files::is_sane,
    house::SourceSolid,
    notes::Notes,
    urdf::{bounds_solid, bytes_of, unplaced},
};

/// The solid of a prim, if its type is a shape; or what is wrong with it.
pub(super) fn solid(
    prim: &Prim,
    kind: &str,
    frame: &Affine,
    notes: &mut Notes,
) -> Result<Option<SourceSolid>, String> {
    notes.about(prim.path().as_str());
    let found = shape(prim, kind, notes);
    notes.about("");
    let Some((local, is_bounds)) = found? else {
        return Ok(None);
    };
    let color = color(prim);
    let placed = frame.primitive(&local);
    if !Bounds::of(&placed).high.into_iter().all(is_sane) {
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

/// The shape of a prim in its own frame, and whether it only bounds a mesh.
fn shape(prim: &Prim, kind: &str, notes: &mut Notes) -> Result<Option<(Solid, bool)>, String> {
    let exact = |shape: SolidShape| Ok(Some((unplaced(shape), false)));
    match kind {
        "Cube" => exact(SolidShape::Box {
            half: [number(prim, "size", 2.0)? * 0.5; 3],
        }),
        "Sphere" => exact(SolidShape::Sphere {
            radius: number(prim, "radius", 1.0)?,
        }),
        "Cylinder" | "Cone" => {
            if kind == "Cone" {
                notes.approximated("cone: a cylinder");
            }
            let (radius, height) = (number(prim, "radius", 1.0)?, number(prim, "height", 2.0)?);
            Ok(Some((along_axis(prim, radius, height * 0.5), false)))
        }
        "Capsule" => {
            notes.approximated("capsule: a cylinder");
            let (radius, height) = (number(prim, "radius", 0.5)?, number(prim, "height", 1.0)?);
            Ok(Some((
                along_axis(prim, radius, height * 0.5 + radius),
                false,
            )))
        }
        "Mesh" => Ok(match mesh(prim)? {
            Some(bounds) => {
                notes.approximated("mesh: the box of its bounds");
                Some((bounds_solid(&bounds), true))
            }
            None => {
                notes.left_out("mesh without points");
                None
            }
        }),
        "" | "Xform" | "Scope" | "SkelRoot" | "Plane" => Ok(None),
        other => {
            let shown: String = other.chars().take(40).collect();
            notes.left_out(format!("prim of type {shown}"));
            Ok(None)
        }
    }
}

fn number(prim: &Prim, name: &str, usual: f64) -> Result<f64, String> {
    let value = values::numbers::<1>(prim, name).map_or(usual, |[value]| value);
    if value > 0.0 {
        Ok(value)
    } else {
        Err(format!("{name} must be above 0"))
    }
}

/// A cylinder along the axis that the prim names.
fn along_axis(prim: &Prim, radius: f64, half_height: f64) -> Solid {
    let turn = match values::token(prim, "axis").as_deref() {
        Some("X") => Affine::turned(1, std::f64::consts::FRAC_PI_2),
        Some("Y") => Affine::turned(0, -std::f64::consts::FRAC_PI_2),
        _ => Affine::IDENTITY,
    };
    turn.primitive(&unplaced(SolidShape::Cylinder {
        radius,
        half_height,
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
    first.or_else(|| plain_color(prim)).map(bytes_of)
}
