//! Frames of prims: their transform operations in order.

use openusd::usd::Prim;

use super::values;
use crate::assets::affine::Affine;

/// The frame of a prim from that of its parent and that of the stage, or what is wrong with it.
///
/// # Errors
/// The operation that is not read.
pub fn frame(prim: &Prim, outer: &Affine, stage: &Affine) -> Result<Affine, String> {
    let mut frame = *outer;
    for name in values::tokens(prim, "xformOpOrder") {
        if name == "!resetXformStack!" {
            frame = *stage;
            continue;
        }
        if name.starts_with("!invert!") {
            // Pivots come in pairs, an operation and its inverse.
            let own = name.trim_start_matches("!invert!");
            frame = frame.after(&inverse(prim, own)?);
            continue;
        }
        frame = frame.after(&operation(prim, &name)?);
    }
    Ok(frame)
}

fn operation(prim: &Prim, name: &str) -> Result<Affine, String> {
    let kind = name.split(':').nth(1).unwrap_or_default();
    let missing = || format!("{name} is no operation with finite numbers");
    let three = || values::numbers::<3>(prim, name).ok_or_else(missing);
    let angle = || {
        values::numbers::<1>(prim, name)
            .map(|[degrees]| degrees.to_radians())
            .ok_or_else(missing)
    };
    Ok(match kind {
        "translate" => Affine::translation(three()?),
        "scale" => Affine::scaled(three()?),
        "rotateX" => Affine::turned(0, angle()?),
        "rotateY" => Affine::turned(1, angle()?),
        "rotateZ" => Affine::turned(2, angle()?),
        "orient" => Affine::of_quaternion(values::numbers(prim, name).ok_or_else(missing)?),
        "transform" => matrix(&values::numbers::<16>(prim, name).ok_or_else(missing)?),
        order if order.len() == 9 && order.starts_with("rotate") => {
            let angles = three()?.map(f64::to_radians);
            let mut turn = Affine::IDENTITY;
            // The first axis of the name is applied first.
            for letter in order["rotate".len()..].chars() {
                let axis = "XYZ".find(letter).ok_or_else(missing)?;
                turn = Affine::turned(axis, angles[axis]).after(&turn);
            }
            turn
        }
        _ => return Err(format!("{name} is no transform operation that is known")),
    })
}

/// The inverse of an operation that pivots use: a move.
fn inverse(prim: &Prim, name: &str) -> Result<Affine, String> {
    if name.split(':').nth(1) != Some("translate") {
        return Err(format!(
            "the inverse of {name} is not read; only that of a translate is"
        ));
    }
    let Affine { origin, .. } = operation(prim, name)?;
    Ok(Affine::translation(origin.map(|value| -value)))
}

/// Rows are the images of the axes, the last one the origin.
fn matrix(values: &[f64; 16]) -> Affine {
    let row = |index: usize| std::array::from_fn(|axis| values[index * 4 + axis]);
    Affine {
        axes: [row(0), row(1), row(2)],
        origin: row(3),
    }
}
