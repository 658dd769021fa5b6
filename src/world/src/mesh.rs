//! Meshes of objects as data: triangles with colours or textures, checked once, and known by the
//! digest of all that decides how they look and collide. Reads no files; see `reel-assets`.

use std::{collections::BTreeMap, fmt, sync::Arc};

use crate::{AssetId, Digest};

/// Most triangles of a mesh.
pub const TRIANGLES_MAX: usize = 100_000;
/// Most vertices of a mesh.
pub const VERTICES_MAX: usize = 300_000;
/// Most pixels of all textures of a mesh together: two of 2048 x 2048.
pub const TEXELS_MAX: usize = 1 << 23;
/// The longest side of a mesh lies between these, in its own units.
pub const EXTENT: [f32; 2] = [1e-6, 1e6];

/// What an episode's objects look like, by asset; those that are not there are drawn as primitives.
pub type Meshes = Arc<BTreeMap<AssetId, Arc<Mesh>>>;

/// Where meshes come from.
pub trait Assets: Sync {
    /// The mesh of an asset; none where there is no sound one.
    fn mesh(&self, asset: &AssetId) -> Option<Arc<Mesh>>;

    /// The meshes of those of the assets that have one.
    fn meshes(&self, of: &mut dyn Iterator<Item = &AssetId>) -> Meshes {
        Arc::new(
            of.filter_map(|asset| Some((asset.clone(), self.mesh(asset)?)))
                .collect(),
        )
    }
}

impl Assets for BTreeMap<AssetId, Arc<Mesh>> {
    fn mesh(&self, asset: &AssetId) -> Option<Arc<Mesh>> {
        self.get(asset).cloned()
    }
}

impl<A: Assets> Assets for Option<A> {
    fn mesh(&self, asset: &AssetId) -> Option<Arc<Mesh>> {
        self.as_ref()?.mesh(asset)
    }
}

/// Assets without any mesh: every object is drawn as primitives.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct NoAssets;

impl Assets for NoAssets {
    fn mesh(&self, _: &AssetId) -> Option<Arc<Mesh>> {
        None
    }
}

/// What a mesh consists of. In units of its own, z up. Colours are linear light, 0 to 1.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct MeshData {
    /// Position of each vertex, in the mesh's own units, z up.
    pub positions: Vec<[f32; 3]>,
    /// Of the vertices; empty where faces are flat.
    pub normals: Vec<[f32; 3]>,
    /// Of the vertices, from the upper left corner of a texture, which repeats; empty where
    /// nothing has a texture.
    pub texture_points: Vec<[f32; 2]>,
    /// Of the vertices, times the material's; empty where they have none.
    pub colors: Vec<[f32; 3]>,
    /// Seen from both sides.
    pub triangles: Vec<Triangle>,
    /// Materials that the triangles index; a valid mesh has at least one.
    pub materials: Vec<Material>,
    /// What materials refer to.
    pub textures: Vec<Texture>,
}

/// Three vertices and a material.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Triangle {
    /// Indexes of its three vertices in the vertex lists.
    pub corners: [u32; 3],
    /// Index of its material.
    pub material: u16,
}

/// How a surface looks.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Material {
    /// Linear RGB from 0 to 1, multiplied with the colour of the texture.
    pub color: [f32; 3],
    /// Index of its texture.
    pub texture: Option<u16>,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            color: [0.6; 3],
            texture: None,
        }
    }
}

/// An image that materials refer to, 8-bit sRGB.
#[derive(Clone, PartialEq, Eq)]
pub struct Texture {
    /// Width of the image in pixels.
    pub width: u32,
    /// Height of the image in pixels.
    pub height: u32,
    /// Row by row from above.
    pub rgb: Vec<u8>,
}

impl fmt::Debug for Texture {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Texture({} x {})", self.width, self.height)
    }
}

/// Why something is no mesh.
#[derive(Clone, PartialEq, Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum MeshDefect {
    /// The mesh has no triangles, so there is nothing to draw.
    #[error("it has no triangles")]
    Empty,
    /// The mesh exceeds one of the limits on its size.
    #[error("it has {found} {kind}, and at most {limit} are taken; {advice}")]
    TooMany {
        /// What there is too much of, e.g. `triangles` or `materials`.
        kind: &'static str,
        found: usize,
        limit: usize,
        /// What to do about it, e.g. to decimate the mesh.
        advice: &'static str,
    },
    /// Infinite or no number.
    #[error("{kind} {index} is not finite")]
    NotFinite {
        /// Kind of the value that is not finite, e.g. `vertex` or `normal`.
        kind: &'static str,
        /// Index of that value in its list, from 0.
        index: usize,
    },
    /// A reference to nothing.
    #[error("triangle {triangle} refers to {kind} {index}, and there are {count}")]
    OutOfRange {
        /// Index of the triangle with the bad reference, from 0.
        triangle: usize,
        /// What the triangle refers to: `vertex` or `material`.
        kind: &'static str,
        index: usize,
        count: usize,
    },
    /// Too large or too small to compute with.
    #[error("its longest side is {found} units, which is not between {:e} and {:e}; scale it to metres", EXTENT[0], EXTENT[1])]
    Extent { found: f32 },
    /// Lines and points only.
    #[error("all of its {triangles} triangles have no area")]
    NoArea { triangles: usize },
    /// Lists that do not belong together.
    #[error("it has {found} {kind} for {expected} vertices")]
    Lengths {
        /// Which list has the wrong length: `normals`, `texture points` or `colours`.
        kind: &'static str,
        found: usize,
        expected: usize,
    },
    /// The bytes of a texture do not match its width and height.
    #[error("texture {texture} holds {bytes} bytes, which are not {width} x {height} pixels")]
    NoTextureImage {
        /// Index of the faulty texture, from 0.
        texture: usize,
        /// Length of the texture's data, in bytes.
        bytes: usize,
        width: u32,
        height: u32,
    },
    /// A material with a texture or a triangle with a material that is not there.
    #[error(
        "material {material} refers to a texture that is not there, or to one without points on it"
    )]
    NoTexture {
        /// Index of the faulty material, from 0.
        material: usize,
    },
}

/// A mesh that passed every check, with its bounds, mipmaps and digest.
#[derive(Clone)]
pub struct Mesh {
    data: MeshData,
    bounds: [[f32; 3]; 2],
    /// Each texture, then its halves, down to one pixel.
    levels: Vec<Vec<Texture>>,
    digest: Digest,
}

impl PartialEq for Mesh {
    fn eq(&self, other: &Self) -> bool {
        self.digest == other.digest
    }
}

impl fmt::Debug for Mesh {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "Mesh({}, {} triangles)",
            self.digest.short(),
            self.data.triangles.len()
        )
    }
}

impl Mesh {
    /// Checks what a mesh consists of.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn new(data: MeshData) -> Result<Self, MeshDefect> {
        check(&data)?;
        let mut bounds = [data.positions[data.triangles[0].corners[0] as usize]; 2];
        for &corner in data.triangles.iter().flat_map(|triangle| &triangle.corners) {
            let point = data.positions[corner as usize];
            bounds[0] = [0, 1, 2].map(|axis| bounds[0][axis].min(point[axis]));
            bounds[1] = [0, 1, 2].map(|axis| bounds[1][axis].max(point[axis]));
        }
        let found = [0, 1, 2]
            .map(|axis| bounds[1][axis] - bounds[0][axis])
            .into_iter()
            .fold(0.0, f32::max);
        if !(EXTENT[0]..=EXTENT[1]).contains(&found) {
            return Err(MeshDefect::Extent { found });
        }
        if data
            .triangles
            .iter()
            .all(|triangle| has_no_area(&data, triangle))
        {
            return Err(MeshDefect::NoArea {
                triangles: data.triangles.len(),
            });
        }
        let levels = data
            .textures
            .iter()
            .map(|texture| levels(texture.clone()))
            .collect();
        Ok(Self {
            digest: Digest::of(&bytes(&data)),
            bounds,
            levels,
            data,
        })
    }

    /// What it consists of.
    pub fn data(&self) -> &MeshData {
        &self.data
    }

    /// Lower and upper corner of the box around it.
    pub fn bounds(&self) -> [[f32; 3]; 2] {
        self.bounds
    }

    /// A texture, then its halves, down to one pixel.
    pub fn levels(&self, texture: u16) -> &[Texture] {
        &self.levels[usize::from(texture)]
    }

    /// Of all of it.
    pub fn digest(&self) -> Digest {
        self.digest
    }
}

fn check(data: &MeshData) -> Result<(), MeshDefect> {
    let vertices = data.positions.len();
    if data.triangles.is_empty() {
        return Err(MeshDefect::Empty);
    }
    let decimate = "decimate it, in Blender with the modifier of that name";
    let texels = data
        .textures
        .iter()
        .map(|texture| texture.rgb.len() / 3)
        .sum();
    for (what, found, limit, advice) in [
        ("triangles", data.triangles.len(), TRIANGLES_MAX, decimate),
        ("vertices", vertices, VERTICES_MAX, decimate),
        (
            "pixels of textures",
            texels,
            TEXELS_MAX,
            "scale its images down",
        ),
        (
            "materials",
            data.materials.len(),
            usize::from(u16::MAX),
            "join those that are alike",
        ),
    ] {
        if found > limit {
            return Err(MeshDefect::TooMany {
                kind: what,
                found,
                limit,
                advice,
            });
        }
    }
    for (what, found) in [
        ("normals", data.normals.len()),
        ("texture points", data.texture_points.len()),
        ("colours", data.colors.len()),
    ] {
        if found != 0 && found != vertices {
            return Err(MeshDefect::Lengths {
                kind: what,
                found,
                expected: vertices,
            });
        }
    }
    finite("vertex", &data.positions)?;
    finite("normal", &data.normals)?;
    finite("texture point", &data.texture_points)?;
    finite("the colour of vertex", &data.colors)?;
    finite(
        "the colour of material",
        &data
            .materials
            .iter()
            .map(|material| material.color)
            .collect::<Vec<_>>(),
    )?;
    for (texture, Texture { width, height, rgb }) in data.textures.iter().enumerate() {
        if rgb.is_empty() || rgb.len() as u128 != u128::from(*width) * u128::from(*height) * 3 {
            return Err(MeshDefect::NoTextureImage {
                texture,
                bytes: rgb.len(),
                width: *width,
                height: *height,
            });
        }
    }
    for (material, Material { texture, .. }) in data.materials.iter().enumerate() {
        if texture.is_some_and(|texture| {
            usize::from(texture) >= data.textures.len() || data.texture_points.is_empty()
        }) {
            return Err(MeshDefect::NoTexture { material });
        }
    }
    for (index, triangle) in data.triangles.iter().enumerate() {
        let outside = |what, index_of: usize, count| MeshDefect::OutOfRange {
            triangle: index,
            kind: what,
            index: index_of,
            count,
        };
        if let Some(corner) = triangle
            .corners
            .iter()
            .map(|corner| *corner as usize)
            .find(|corner| *corner >= vertices)
        {
            return Err(outside("vertex", corner, vertices));
        }
        if usize::from(triangle.material) >= data.materials.len() {
            return Err(outside(
                "material",
                usize::from(triangle.material),
                data.materials.len(),
            ));
        }
    }
    Ok(())
}

fn finite<const N: usize>(what: &'static str, list: &[[f32; N]]) -> Result<(), MeshDefect> {
    match list
        .iter()
        .position(|values| !values.iter().all(|value| value.is_finite()))
    {
        Some(index) => Err(MeshDefect::NotFinite { kind: what, index }),
        None => Ok(()),
    }
}

/// In double precision, in which no product of the sides of a mesh within its limits is lost.
fn has_no_area(data: &MeshData, triangle: &Triangle) -> bool {
    let [a, b, c] = triangle
        .corners
        .map(|corner| data.positions[corner as usize].map(f64::from));
    let [u, v] = [b, c].map(|corner| [0, 1, 2].map(|axis| corner[axis] - a[axis]));
    (0..3).all(|axis| {
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        u[i] * v[j] == u[j] * v[i]
    })
}

/// An image and its halves: each pixel of one is the mean of four of the other.
fn levels(texture: Texture) -> Vec<Texture> {
    let mut levels = vec![texture];
    while let Some(last) = levels
        .last()
        .filter(|last| last.width > 1 || last.height > 1)
    {
        let (width, height) = ((last.width / 2).max(1), (last.height / 2).max(1));
        let mut rgb = Vec::with_capacity((width * height * 3) as usize);
        for y in 0..height {
            let rows = [y * 2, (y * 2 + 1).min(last.height - 1)];
            for x in 0..width {
                let columns = [x * 2, (x * 2 + 1).min(last.width - 1)];
                for channel in 0..3 {
                    let at = |x: u32, y: u32| {
                        u32::from(last.rgb[((y * last.width + x) * 3 + channel) as usize])
                    };
                    let sum: u32 = rows
                        .iter()
                        .map(|&y| at(columns[0], y) + at(columns[1], y))
                        .sum();
                    rgb.push(((sum + 2) / 4) as u8);
                }
            }
        }
        levels.push(Texture { width, height, rgb });
    }
    levels
}

/// The one form that the digest is taken of: little-endian, each list after its length.
fn bytes(data: &MeshData) -> Vec<u8> {
    fn floats<const N: usize>(out: &mut Vec<u8>, list: &[[f32; N]]) {
        out.extend((list.len() as u64).to_le_bytes());
        out.extend(
            list.iter()
                .flatten()
                .flat_map(|value| value.to_bits().to_le_bytes()),
        );
    }
    let mut out = b"reel mesh 1".to_vec();
    floats(&mut out, &data.positions);
    floats(&mut out, &data.normals);
    floats(&mut out, &data.texture_points);
    floats(&mut out, &data.colors);
    out.extend((data.triangles.len() as u64).to_le_bytes());
    for triangle in &data.triangles {
        out.extend(
            triangle
                .corners
                .iter()
                .flat_map(|corner| corner.to_le_bytes()),
        );
        out.extend(triangle.material.to_le_bytes());
    }
    out.extend((data.materials.len() as u64).to_le_bytes());
    for material in &data.materials {
        out.extend(
            material
                .color
                .iter()
                .flat_map(|value| value.to_bits().to_le_bytes()),
        );
        out.extend(material.texture.map_or(u32::MAX, u32::from).to_le_bytes());
    }
    out.extend((data.textures.len() as u64).to_le_bytes());
    for texture in &data.textures {
        out.extend(texture.width.to_le_bytes());
        out.extend(texture.height.to_le_bytes());
        out.extend(&texture.rgb);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle() -> MeshData {
        MeshData {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            triangles: vec![Triangle {
                corners: [0, 1, 2],
                material: 0,
            }],
            materials: vec![Material::default()],
            ..MeshData::default()
        }
    }

    #[test]
    fn what_is_no_mesh_is_said() {
        let fault = |change: &dyn Fn(&mut MeshData)| {
            let mut data = triangle();
            change(&mut data);
            Mesh::new(data).unwrap_err().to_string()
        };
        assert_eq!(fault(&|data| data.triangles.clear()), "it has no triangles");
        assert_eq!(
            fault(&|data| data.positions[1][2] = f32::NAN),
            "vertex 1 is not finite"
        );
        assert_eq!(
            fault(&|data| data.triangles[0].corners[2] = 9),
            "triangle 0 refers to vertex 9, and there are 3"
        );
        assert_eq!(
            fault(&|data| data.triangles[0].material = 1),
            "triangle 0 refers to material 1, and there are 1"
        );
        assert_eq!(
            fault(&|data| data.positions[2] = [0.5, 0.0, 0.0]),
            "all of its 1 triangles have no area"
        );
        assert_eq!(
            fault(&|data| data.normals = vec![[0.0; 3]]),
            "it has 1 normals for 3 vertices"
        );
        assert!(fault(&|data| data.positions[1][0] = 1e30).contains("scale it to metres"));
        assert!(
            fault(&|data| data.positions = vec![[0.0; 3]; VERTICES_MAX + 1])
                .contains("decimate it")
        );
        assert!(fault(&|data| data.materials[0].texture = Some(0)).contains("material 0"));
        let image = Texture {
            width: 2,
            height: 2,
            rgb: vec![0; 11],
        };
        assert_eq!(
            fault(&|data| data.textures.push(image.clone())),
            "texture 0 holds 11 bytes, which are not 2 x 2 pixels"
        );
    }

    #[test]
    fn the_digest_is_of_everything() {
        let first = Mesh::new(triangle()).unwrap();
        let mut data = triangle();
        data.materials[0].color[0] = 0.5;
        assert_ne!(first.digest(), Mesh::new(data).unwrap().digest());
        assert_eq!(first, Mesh::new(triangle()).unwrap());
        assert_eq!(first.bounds(), [[0.0; 3], [1.0, 1.0, 0.0]]);
    }

    #[test]
    fn images_are_halved_to_one_pixel() {
        let rgb = (0..5 * 3).flat_map(|pixel| [pixel as u8 * 10; 3]).collect();
        let levels = levels(Texture {
            width: 5,
            height: 3,
            rgb,
        });
        let sizes: Vec<_> = levels
            .iter()
            .map(|level| (level.width, level.height))
            .collect();
        assert_eq!(sizes, [(5, 3), (2, 1), (1, 1)]);
        assert_eq!(levels[1].rgb[0], 30, "mean of 0, 10, 50 and 60");
    }
}
