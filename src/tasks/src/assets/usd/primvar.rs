//! Values of a mesh: one for all of it, or one of each face, point or corner.

use openusd::{sdf::Value, usd::Prim};

use super::values;

/// What each of its values belongs to.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Interpolation {
    Constant,
    Face,
    Point,
    Corner,
}

/// A corner of a face, in the numbering of its mesh.
#[derive(Clone, Copy)]
pub(super) struct Corner {
    pub face: usize,
    pub point: usize,
    /// Among all corners of the mesh.
    pub index: usize,
}

/// Values of a mesh, each of `N` numbers.
pub(super) struct Primvar<const N: usize> {
    values: Vec<[f64; N]>,
    indices: Option<Vec<i64>>,
    interpolation: Interpolation,
}

impl<const N: usize> Primvar<N> {
    /// Reads an attribute, if the prim has it; its values are of each point or of the whole where
    /// it does not say.
    pub fn of(prim: &Prim, name: &str, is_of_points: bool) -> Result<Option<Self>, String> {
        let Some(value) = values::value(prim, name) else {
            return Ok(None);
        };
        let numbers =
            values::list(&value).ok_or_else(|| format!("{name} is no list of numbers"))?;
        let (values, []) = numbers.as_chunks::<N>() else {
            return Err(format!("{name} has values of other than {N} numbers"));
        };
        if values.is_empty() {
            return Ok(None);
        }
        if let Some(at) = values
            .iter()
            .flatten()
            .position(|number| !number.is_finite())
        {
            return Err(format!("{name}[{}] is not finite", at / N));
        }
        let said = prim.attribute(name).get_metadata::<Value>("interpolation");
        let interpolation = match said.ok().flatten() {
            Some(Value::Token(token)) => match token.as_str() {
                "constant" => Interpolation::Constant,
                "uniform" => Interpolation::Face,
                "vertex" | "varying" => Interpolation::Point,
                "faceVarying" => Interpolation::Corner,
                other => {
                    let other: String = other.chars().take(40).collect();
                    return Err(format!("{name} has the interpolation {other}"));
                }
            },
            _ if is_of_points => Interpolation::Point,
            _ => Interpolation::Constant,
        };
        Ok(Some(Self {
            values: values.to_vec(),
            indices: values::value(prim, &format!("{name}:indices"))
                .and_then(|value| values::integers(&value)),
            interpolation,
        }))
    }

    /// The one value of all of the mesh.
    pub fn constant(&self) -> Option<[f64; N]> {
        let is_one = self.interpolation == Interpolation::Constant || self.values.len() == 1;
        is_one.then(|| self.values[0])
    }

    /// Which of the values a corner has.
    pub fn index(&self, corner: Corner) -> Option<usize> {
        let place = match self.interpolation {
            Interpolation::Constant => 0,
            Interpolation::Face => corner.face,
            Interpolation::Point => corner.point,
            Interpolation::Corner => corner.index,
        };
        let index = match &self.indices {
            Some(indices) => usize::try_from(*indices.get(place)?).ok()?,
            None => place,
        };
        (index < self.values.len()).then_some(index)
    }

    pub fn value(&self, index: usize) -> [f64; N] {
        self.values[index]
    }
}
