//! Furniture among the objects of a house, and the sizes of its assets.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::Value;

use super::{ITEMS_MAX, Triple};
use crate::{
    ImportError, categories,
    house::{Body, Extent, Piece},
    notes::Notes,
    sizes,
};

/// Furniture that is turned less than this from a right angle stands at it, in degrees.
const TURN_MAX_DEG: f64 = 3.0;
/// Lowest and greatest height that is believed of a place, in metres.
const HEIGHTS_M: [f64; 2] = [0.25, 2.6];

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct ObjectItem {
    #[serde(default)]
    id: String,
    #[serde(default)]
    asset_id: String,
    /// The middle of its bounding box.
    position: Option<Triple>,
    #[serde(default)]
    rotation: Triple,
    #[serde(default)]
    children: Vec<ObjectItem>,
}

/// Sizes of assets by their id: from side to side, up, from back to front.
#[derive(Clone, PartialEq, Debug, Default)]
pub(crate) struct AssetSizes {
    sizes: BTreeMap<String, [f64; 3]>,
    /// Types of assets, where the file gives them.
    types: BTreeMap<String, String>,
}

impl AssetSizes {
    /// Reads `{"asset": [x, y, z]}`, `{"asset": {"x": .., "y": .., "z": ..}}`, or ProcTHOR's
    /// `asset-database.json`: lists of `{assetId, boundingBox, objectType}` by type.
    pub(crate) fn parse(text: &str, file: &str) -> Result<Self, ImportError> {
        let parsed: BTreeMap<String, Value> =
            serde_json::from_str(text).map_err(|error| ImportError::Syntax {
                file: file.to_owned(),
                line: error.line(),
                problem: format!("no sizes of assets: {error}"),
            })?;
        let mut found = Self::default();
        for (key, value) in parsed {
            match &value {
                Value::Array(items) if items.iter().any(Value::is_object) => {
                    for item in items {
                        found.asset(&key, item).ok_or_else(|| {
                            ImportError::invalid(
                                file,
                                &key,
                                "an asset without assetId or a boundingBox of x, y, z above 0",
                            )
                        })?;
                    }
                }
                value => {
                    let size = size(value).ok_or_else(|| {
                        ImportError::invalid(file, &key, "its size is not three numbers above 0")
                    })?;
                    found.sizes.insert(key, size);
                }
            }
        }
        Ok(found)
    }

    fn asset(&mut self, kind: &str, item: &Value) -> Option<()> {
        let id = item.get("assetId")?.as_str()?.to_owned();
        let named = item
            .get("objectType")
            .and_then(Value::as_str)
            .unwrap_or(kind);
        self.types.insert(id.clone(), named.to_owned());
        self.sizes.insert(id, size(item.get("boundingBox")?)?);
        Some(())
    }
}

fn size(value: &Value) -> Option<[f64; 3]> {
    let numbers: Vec<f64> = match value {
        Value::Array(items) => items.iter().filter_map(Value::as_f64).collect(),
        value => ["x", "y", "z"]
            .iter()
            .filter_map(|key| value.get(key)?.as_f64())
            .collect(),
    };
    let size: [f64; 3] = numbers.try_into().ok()?;
    size.into_iter()
        .all(|side| side > 0.0 && side < 100.0)
        .then_some(size)
}

/// The furniture among objects. What stands on it, and what holds no objects, is counted.
pub(super) fn pieces(
    items: &[ObjectItem],
    known: &AssetSizes,
    file: &str,
    notes: &mut Notes,
) -> Result<Vec<Piece>, ImportError> {
    let mut pieces = Vec::new();
    for (index, item) in items.iter().enumerate() {
        let at = || format!("objects[{index}] ({})", item.id);
        let position = item.position.filter(Triple::is_sane);
        let Some(position) = position.filter(|_| item.rotation.is_sane()) else {
            return Err(ImportError::invalid(
                file,
                at(),
                "its position or rotation is not there or no finite triple",
            ));
        };
        notes.about(name_of(item));
        let mut count = 0;
        count_children(&item.children, notes, &mut count);
        if count > ITEMS_MAX {
            return Err(ImportError::invalid(
                file,
                at(),
                format!("more than {ITEMS_MAX} objects on it"),
            ));
        }
        match category(item, known) {
            Some(category) => pieces.push(piece((item, position), category, known, notes)),
            None => notes.left_out(format!("not furniture to put objects on: {}", kind(item))),
        }
    }
    notes.about("");
    Ok(pieces)
}

/// The id of an object, or its asset where it has none.
fn name_of(item: &ObjectItem) -> &str {
    if item.id.is_empty() {
        &item.asset_id
    } else {
        &item.id
    }
}

fn count_children(children: &[ObjectItem], notes: &mut Notes, count: &mut usize) {
    for child in children {
        *count += 1;
        notes.left_out(format!(
            "object on furniture (scenes hold none): {}",
            kind(child)
        ));
        count_children(&child.children, notes, count);
    }
}

/// The type that an object's id begins with, as in `DiningTable|2|0`.
fn id_type(item: &ObjectItem) -> Option<&str> {
    let first = item.id.split('|').next()?;
    first.starts_with(char::is_alphabetic).then_some(first)
}

fn category(item: &ObjectItem, known: &AssetSizes) -> Option<&'static str> {
    let named = known
        .types
        .get(&item.asset_id)
        .map(String::as_str)
        .or_else(|| id_type(item));
    named
        .and_then(categories::furniture)
        .or_else(|| categories::furniture(&item.asset_id))
}

fn kind(item: &ObjectItem) -> String {
    categories::kind_of(id_type(item).unwrap_or(&item.asset_id))
}

fn piece(
    (item, position): (&ObjectItem, Triple),
    category: &str,
    known: &AssetSizes,
    notes: &mut Notes,
) -> Piece {
    let size = match known.sizes.get(&item.asset_id) {
        Some([x, y, z]) => [*x, *z, *y],
        None => {
            notes.approximated(
                "size of an asset, which the file does not give: typical of its category",
            );
            let [width, depth, height] = sizes::typical(category);
            // It stands on the floor, and its place is the middle of its box.
            let told = position.y * 2.0;
            let believed = (HEIGHTS_M[0]..=HEIGHTS_M[1]).contains(&told);
            [width, depth, if believed { told } else { height }]
        }
    };
    let degrees = (90.0 - item.rotation.y).rem_euclid(360.0);
    let facing_deg = ((degrees / 90.0).round() * 90.0).rem_euclid(360.0);
    let off = (degrees - facing_deg + 180.0).rem_euclid(360.0) - 180.0;
    if off.abs() > TURN_MAX_DEG {
        notes.approximated("furniture at an odd angle: turned to a right one");
    }
    let is_tilted = [item.rotation.x, item.rotation.z].map(|angle| {
        let off = (angle + 180.0).rem_euclid(360.0) - 180.0;
        off.abs() > TURN_MAX_DEG
    });
    if is_tilted.contains(&true) {
        notes.approximated("furniture out of plumb, set upright");
    }
    Piece {
        source: name_of(item).to_owned(),
        category: category.to_owned(),
        body: Body::Sized(Extent {
            center: position.floor(),
            size,
            facing_deg,
        }),
    }
}
