//! The bounds of meshes in files: OBJ and STL. Their triangles are not used.

use crate::{
    ImportError,
    affine::{Bounds, Vector},
    files::{ImportFiles, is_sane},
};

/// The bounds of a mesh file in its own units; `None` for a format that is not read.
pub(crate) fn bounds(files: &ImportFiles, name: &str) -> Result<Option<Bounds>, ImportError> {
    let ending = name
        .rsplit('.')
        .next()
        .unwrap_or_default()
        .to_ascii_lowercase();
    let points = match ending.as_str() {
        "obj" => obj(&files.bytes(name)?),
        "stl" => stl(&files.bytes(name)?),
        _ => return Ok(None),
    };
    let no_mesh = || ImportError::invalid(name, "mesh", "no vertices, or one that is not finite");
    let points = points.ok_or_else(no_mesh)?;
    if !points.iter().flatten().all(|value| is_sane(*value)) {
        return Err(no_mesh());
    }
    Bounds::of_points(points).map(Some).ok_or_else(no_mesh)
}

fn obj(bytes: &[u8]) -> Option<Vec<Vector>> {
    let text = String::from_utf8_lossy(bytes);
    let vertices = text
        .lines()
        .filter_map(|line| line.trim_start().strip_prefix("v "));
    vertices.map(point).collect()
}

fn point(text: &str) -> Option<Vector> {
    let mut words = text.split_ascii_whitespace().map(str::parse::<f64>);
    let mut next = || words.next()?.ok();
    Some([next()?, next()?, next()?])
}

/// Binary: a header of 80 bytes, a count, 50 bytes a triangle; or text.
fn stl(bytes: &[u8]) -> Option<Vec<Vector>> {
    let count = bytes
        .get(80..84)
        .and_then(|count| count.try_into().ok())
        .map(u32::from_le_bytes);
    let is_binary = count.is_some_and(|count| bytes.len() as u64 == 84 + u64::from(count) * 50);
    if !is_binary {
        let text = String::from_utf8_lossy(bytes);
        let vertices = text
            .lines()
            .filter_map(|line| line.trim_start().strip_prefix("vertex "));
        return vertices.map(point).collect();
    }
    let number =
        |bytes: &[u8]| f64::from(f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]));
    let corners = bytes[84..]
        .chunks_exact(50)
        .flat_map(|triangle| triangle[12..48].chunks_exact(12));
    Some(
        corners
            .map(|corner| [number(corner), number(&corner[4..]), number(&corner[8..])])
            .collect(),
    )
}
