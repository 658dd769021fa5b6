//! What is measured of each column: structs are laid flat into their fields, under names joined by
//! dots.

use polars::prelude::{DataType, Expr, NULL, col, lit, when};

use crate::{Column, table::type_name};

/// Levels of structs that are laid flat.
const DEPTH_MAX: usize = 5;
/// Columns that are measured; a set with more names what is left out.
pub(crate) const LEAVES_MAX: usize = 1_000;

/// What can be said of the values of a column.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Measure {
    Bool,
    Integer,
    Float,
    /// Values and lengths in characters.
    Text,
    /// Lengths of lists, in items.
    List,
    /// Sizes of binary values, in bytes.
    Binary,
    /// The first and the last of them.
    Time,
    /// Only whether there is a value.
    Other,
}

/// A column, or a field of a struct in one.
#[derive(Clone, Debug)]
pub(crate) struct Leaf {
    pub(crate) name: String,
    pub(crate) type_name: String,
    pub(crate) measure: Measure,
    pub(crate) value: Expr,
}

/// The leaves of these columns, at most [`LEAVES_MAX`], and how many were left out.
pub(crate) fn leaves(columns: &[Column]) -> (Vec<Leaf>, usize) {
    let mut leaves = Vec::new();
    for column in columns {
        let type_name = (column.type_name == "null").then_some("null");
        descend(
            &column.name,
            &column.data_type,
            col(column.name.as_str()),
            (0, type_name),
            &mut leaves,
        );
    }
    let left_out = leaves.len().saturating_sub(LEAVES_MAX);
    leaves.truncate(LEAVES_MAX);
    (leaves, left_out)
}

fn descend(
    name: &str,
    data_type: &DataType,
    value: Expr,
    (depth, named): (usize, Option<&str>),
    leaves: &mut Vec<Leaf>,
) {
    if let DataType::Struct(fields) = data_type
        && depth < DEPTH_MAX
    {
        for field in fields {
            let path = format!("{name}.{}", field.name);
            let value = value.clone().struct_().field_by_name(&field.name);
            descend(&path, &field.dtype, value, (depth + 1, None), leaves);
        }
        return;
    }
    let measure = match data_type {
        DataType::Boolean => Measure::Bool,
        DataType::String => Measure::Text,
        DataType::List(_) => Measure::List,
        DataType::Binary => Measure::Binary,
        DataType::Decimal(..) => Measure::Float,
        other if other.is_integer() => Measure::Integer,
        other if other.is_float() => Measure::Float,
        other if other.is_temporal() => Measure::Time,
        _ => Measure::Other,
    };
    leaves.push(Leaf {
        name: name.to_owned(),
        type_name: named.map_or_else(|| type_name(data_type), str::to_owned),
        measure,
        value,
    });
}

impl Leaf {
    /// The values that are counted one by one, if the column has such.
    pub(crate) fn counted(&self) -> Option<Expr> {
        match self.measure {
            Measure::Bool | Measure::Text => Some(self.value.clone()),
            Measure::Integer => Some(self.value.clone().cast(DataType::Int128)),
            Measure::Float => Some(self.value.clone().cast(DataType::Float64)),
            _ => None,
        }
    }

    /// The number of each row: the value itself or its length; null where it is not finite.
    pub(crate) fn number(&self) -> Option<Expr> {
        let number = match self.measure {
            Measure::Integer => self.value.clone(),
            Measure::Float => {
                let value = self.value.clone().cast(DataType::Float64);
                when(value.clone().is_finite())
                    .then(value)
                    .otherwise(lit(NULL))
            }
            Measure::Text => self.value.clone().str().len_chars(),
            Measure::List => self.value.clone().list().len(),
            Measure::Binary => self.value.clone().binary().size_bytes(),
            Measure::Bool | Measure::Time | Measure::Other => return None,
        };
        Some(number.cast(DataType::Float64))
    }

    /// What lengths count, for people.
    pub(crate) fn unit(&self) -> &'static str {
        match self.measure {
            Measure::Text => "characters",
            Measure::List => "items",
            Measure::Binary => "bytes",
            _ => "",
        }
    }
}
