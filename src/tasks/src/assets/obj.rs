//! Wavefront OBJ and MTL: vertices with colours, texture points, normals, polygons, `Kd` and
//! `map_Kd`. What else there is (lines, curves, groups, smoothing) is passed over. Reads bytes and
//! asks for the files beside them; opens none.
//!
//! Written here and not taken from a crate: the format is fifteen lines of grammar, and every index
//! has to be distrusted.

use std::collections::BTreeMap;

use reel_world::mesh::{Material, MeshData, TRIANGLES_MAX, Triangle};

use crate::assets::{
    MeshError, SiblingFiles,
    color::{clamped, linear},
    limits::LINE_BYTES_MAX,
    texture::TextureSet,
    upright,
};

/// What lines refer to by number.
#[derive(Default)]
struct Lists {
    positions: Vec<[f32; 3]>,
    colors: Vec<[f32; 3]>,
    texture_points: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
}

/// A corner of a face: position, texture point, normal.
type Corner = (usize, Option<usize>, Option<usize>);

/// Reads an OBJ file.
///
/// # Errors
/// Why it is refused.
pub(crate) fn read(bytes: &[u8], beside: &dyn SiblingFiles) -> Result<MeshData, MeshError> {
    let mut lists = Lists::default();
    let mut materials = Materials {
        list: vec![Material::default()],
        names: BTreeMap::new(),
        images: TextureSet::default(),
    };
    let mut faces: Vec<([Corner; 3], u16)> = Vec::new();
    let mut material = 0;
    for (number, line) in lines(bytes)? {
        let broken = |what: String| MeshError::Line {
            line: number,
            problem: what,
        };
        let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        match word {
            "v" => {
                let values = numbers(rest).map_err(broken)?;
                let (&position, more) = values
                    .split_first_chunk()
                    .ok_or_else(|| broken("a vertex has three coordinates".into()))?;
                lists.positions.push(position);
                // Four coordinates: the fourth is a weight. Six: a colour.
                lists.colors.push(
                    more.first_chunk()
                        .map_or([1.0; 3], |color| color.map(linear)),
                );
            }
            "vt" => {
                let values = numbers(rest).map_err(broken)?;
                let across = *values
                    .first()
                    .ok_or_else(|| broken("a texture point has a coordinate".into()))?;
                lists
                    .texture_points
                    .push([across, 1.0 - values.get(1).copied().unwrap_or(0.0)]);
            }
            "vn" => {
                let values = numbers(rest).map_err(broken)?;
                lists.normals.push(
                    *values
                        .first_chunk()
                        .ok_or_else(|| broken("a normal has three coordinates".into()))?,
                );
            }
            "f" => {
                let corners: Result<Vec<Corner>, String> = rest
                    .split_whitespace()
                    .map(|text| corner(text, &lists))
                    .collect();
                let corners = corners.map_err(broken)?;
                if corners.len() < 3 {
                    return Err(broken(format!("a face has {} corners", corners.len())));
                }
                faces.extend(
                    corners[1..]
                        .windows(2)
                        .map(|pair| ([corners[0], pair[0], pair[1]], material)),
                );
                if faces.len() > TRIANGLES_MAX {
                    return Err(MeshError::too_many_triangles());
                }
            }
            "usemtl" => material = materials.names.get(rest.trim()).copied().unwrap_or(0),
            "mtllib" => materials.read(rest.trim(), beside)?,
            _ => {}
        }
    }
    let colored = lists.colors.iter().any(|color| *color != [1.0; 3]);
    if colored {
        // Colours of the vertices, not on top of a default grey.
        materials.list[0].color = [1.0; 3];
    }
    Ok(joined(&lists, colored, &faces, materials))
}

/// Makes a vertex of each distinct corner.
fn joined(
    lists: &Lists,
    colored: bool,
    faces: &[([Corner; 3], u16)],
    materials: Materials,
) -> MeshData {
    let textures = materials.images.finish();
    let (textured, smooth) = (
        !textures.is_empty(),
        faces
            .iter()
            .flat_map(|(corners, _)| corners)
            .all(|corner| corner.2.is_some()),
    );
    let mut data = MeshData {
        materials: materials.list,
        textures,
        ..MeshData::default()
    };
    let mut known = BTreeMap::new();
    for (corners, material) in faces {
        let corners = corners.map(|(position, point, normal)| {
            let key = (
                position,
                point.filter(|_| textured),
                normal.filter(|_| smooth),
            );
            *known.entry(key).or_insert_with(|| {
                data.positions.push(upright(lists.positions[position]));
                if colored {
                    data.colors.push(clamped(lists.colors[position]));
                }
                if textured {
                    data.texture_points
                        .push(point.map_or([0.0; 2], |point| lists.texture_points[point]));
                }
                if let (true, Some(normal)) = (smooth, normal) {
                    data.normals.push(upright(lists.normals[normal]));
                }
                data.positions.len() as u32 - 1
            })
        });
        data.triangles.push(Triangle {
            corners,
            material: *material,
        });
    }
    data
}

struct Materials {
    list: Vec<Material>,
    names: BTreeMap<String, u16>,
    images: TextureSet,
}

impl Materials {
    /// Reads an MTL file beside the mesh.
    fn read(&mut self, name: &str, beside: &dyn SiblingFiles) -> Result<(), MeshError> {
        let bytes = beside.read(name)?;
        let mut current: Option<usize> = None;
        for (number, line) in lines(&bytes)? {
            let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
            let broken = |what: String| MeshError::In {
                file: name.to_owned(),
                reason: Box::new(MeshError::Line {
                    line: number,
                    problem: what,
                }),
            };
            if word == "newmtl" {
                let index = u16::try_from(self.list.len())
                    .map_err(|_| broken("there are too many materials".into()))?;
                self.names.insert(rest.trim().to_owned(), index);
                self.list.push(Material::default());
                current = Some(usize::from(index));
            }
            let Some(material) = current.map(|index| &mut self.list[index]) else {
                continue;
            };
            match word {
                "Kd" => {
                    let values = numbers(rest).map_err(broken)?;
                    let color: [f32; 3] = *values
                        .first_chunk()
                        .ok_or_else(|| broken("a colour has three values".into()))?;
                    // An image is not darkened by the colour that stands for it elsewhere, unless
                    // a file means it: most do not.
                    material.color = if material.texture.is_some() {
                        [1.0; 3]
                    } else {
                        clamped(color.map(linear))
                    };
                }
                "map_Kd" => {
                    // Options come first, each with its own number of values; the name is last.
                    let file = if rest.trim_start().starts_with('-') {
                        rest.split_whitespace().last().unwrap_or("")
                    } else {
                        rest.trim()
                    };
                    material.texture = Some(self.images.file(file, beside)?);
                    material.color = [1.0; 3];
                }
                _ => {}
            }
        }
        Ok(())
    }
}

/// The lines with their numbers, without comments and empty ones.
fn lines(bytes: &[u8]) -> Result<Vec<(usize, &str)>, MeshError> {
    let mut found = Vec::new();
    for (number, line) in (1..).zip(bytes.split(|byte| *byte == b'\n')) {
        if line.len() > LINE_BYTES_MAX {
            return Err(MeshError::Line {
                line: number,
                problem: format!("it has more than {LINE_BYTES_MAX} bytes"),
            });
        }
        let line = str::from_utf8(line).map_err(|_| MeshError::Line {
            line: number,
            problem: "it is no text".into(),
        })?;
        let line = line.split('#').next().unwrap_or("").trim();
        if line.ends_with('\\') {
            return Err(MeshError::Line {
                line: number,
                problem: "it goes on in the next line, which is not supported".into(),
            });
        }
        if !line.is_empty() {
            found.push((number, line));
        }
    }
    Ok(found)
}

fn numbers(text: &str) -> Result<Vec<f32>, String> {
    text.split_whitespace()
        .map(|word| {
            word.parse()
                .map_err(|_| format!("'{}' is not a number", short(word)))
        })
        .collect()
}

fn corner(text: &str, lists: &Lists) -> Result<Corner, String> {
    let mut parts = text.split('/');
    let mut next = |what: &str, count: usize| match parts.next() {
        None | Some("") => Ok(None),
        Some(word) => index(word, count)
            .map(Some)
            .ok_or_else(|| format!("there is no {what} {}, but {count}", short(word))),
    };
    let position = next("vertex", lists.positions.len())?
        .ok_or_else(|| format!("'{}' is not a corner of a face", short(text)))?;
    Ok((
        position,
        next("texture point", lists.texture_points.len())?,
        next("normal", lists.normals.len())?,
    ))
}

/// From 1, or back from the end where it is negative.
fn index(word: &str, count: usize) -> Option<usize> {
    let number: i64 = word.parse().ok()?;
    let index = if number < 0 {
        i64::try_from(count).ok()?.checked_add(number)?
    } else {
        number.checked_sub(1)?
    };
    usize::try_from(index).ok().filter(|index| *index < count)
}

/// What of a word goes into a message.
fn short(word: &str) -> String {
    word.chars().take(40).collect()
}
