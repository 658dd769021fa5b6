//! glTF 2.0, as text or binary: the triangles of the default scene with the transforms of
//! their nodes, base colours and their textures, colours of vertices, normals. Skins, morph
//! targets, animations and other maps are passed over. Reads bytes and asks for the files
//! beside them; opens none.
//!
//! The crate `gltf` reads and checks the document. Container and accessors are read here, because
//! it trusts their lengths.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use gltf::{
    Document, Primitive, Semantic,
    accessor::{DataType, Dimensions},
    json::{self, mesh::Mode},
};
use reel_world::mesh::{Material, MeshData, TRIANGLES_MAX, Triangle, VERTICES_MAX};

use crate::assets::{
    DECIMATE, MeshError, SiblingFiles, color::clamped, limits::NODES_MAX, texture::TextureSet,
    upright,
};

/// A 4 x 4 transformation, stored column by column as in glTF.
type Matrix = [[f32; 4]; 4];

const IDENTITY: Matrix = [
    [1.0, 0.0, 0.0, 0.0],
    [0.0, 1.0, 0.0, 0.0],
    [0.0, 0.0, 1.0, 0.0],
    [0.0, 0.0, 0.0, 1.0],
];

/// Reads a glTF file of either kind.
///
/// # Errors
/// Why it is refused.
pub(crate) fn read(bytes: &[u8], beside: &dyn SiblingFiles) -> Result<MeshData, MeshError> {
    let (text, binary) = if bytes.starts_with(b"glTF") {
        chunks(bytes)?
    } else {
        (bytes, None)
    };
    let root: json::Root = json::deserialize::from_slice(text)
        .map_err(|error| MeshError::Broken(format!("no sound glTF document ({error})")))?;
    // The crate's own check looks accessors up before it knows that they are there.
    let primitives = root.meshes.iter().flat_map(|mesh| &mesh.primitives);
    if let Some(missing) = primitives
        .flat_map(|it| it.attributes.values())
        .find(|it| it.value() >= root.accessors.len())
    {
        return Err(MeshError::Broken(format!(
            "no sound glTF document (there is no accessor {})",
            missing.value()
        )));
    }
    let document = Document::from_json(root).map_err(|error| match error {
        gltf::Error::Validation(errors) => {
            let told = errors
                .iter()
                .take(3)
                .map(|(path, error)| format!("{}: {error}", path.as_str()));
            MeshError::Broken(format!(
                "no sound glTF document ({})",
                told.collect::<Vec<_>>().join("; ")
            ))
        }
        other => MeshError::Broken(format!("no sound glTF document ({other})")),
    })?;
    let mut reader = Reader {
        buffers: buffers(document.as_json(), binary, beside)?,
        document: &document,
        beside,
        frames: TextureSet::default(),
        materials: Vec::new(),
        textured: false,
        data: MeshData::default(),
    };
    for material in document.materials().map(Some).chain([None]) {
        reader.material(material.as_ref())?;
    }
    reader.textured = reader
        .materials
        .iter()
        .any(|material| material.texture.is_some());
    reader.walk()?;
    Ok(MeshData {
        materials: reader.materials,
        textures: reader.frames.finish(),
        ..reader.data
    })
}

/// The document and the binary chunk of a binary file.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), MeshError> {
    let broken = |what: &str| MeshError::Broken(format!("no sound binary glTF ({what})"));
    let number = |at: usize| Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?));
    let version = number(4).ok_or_else(|| broken("it ends in its header"))?;
    if version != 2 {
        return Err(MeshError::Unsupported(format!("glTF of version {version}")));
    }
    let chunk = |at: usize| -> Option<([u8; 4], &[u8])> {
        let data = bytes.get(at + 8..)?;
        Some((
            *bytes.get(at + 4..)?.first_chunk()?,
            data.get(..number(at)? as usize)?,
        ))
    };
    let (kind, text) = chunk(12).ok_or_else(|| broken("it ends in its first chunk"))?;
    if kind != *b"JSON" {
        return Err(broken("its first chunk is no JSON"));
    }
    let next = 20 + text.len();
    if next >= bytes.len() {
        return Ok((text, None));
    }
    match chunk(next).ok_or_else(|| broken("it ends in its second chunk"))? {
        (kind, data) if kind == *b"BIN\0" => Ok((text, Some(data))),
        _ => Ok((text, None)),
    }
}

fn buffers(
    root: &json::Root,
    binary: Option<&[u8]>,
    beside: &dyn SiblingFiles,
) -> Result<Vec<Vec<u8>>, MeshError> {
    let read = |(index, buffer): (usize, &json::Buffer)| {
        let bytes = match (&buffer.uri, binary) {
            (Some(uri), _) => resource(uri, beside)?,
            (None, Some(binary)) if index == 0 => binary.to_vec(),
            (None, _) => return Err(MeshError::Broken(format!("buffer {index} is nowhere"))),
        };
        let (found, said) = (bytes.len() as u64, buffer.byte_length.0);
        if found < said {
            return Err(MeshError::Broken(format!(
                "buffer {index} has {found} bytes instead of {said}"
            )));
        }
        Ok(bytes)
    };
    root.buffers.iter().enumerate().map(read).collect()
}

/// What a URI names: a file beside, or data in the URI itself.
fn resource(uri: &str, beside: &dyn SiblingFiles) -> Result<Vec<u8>, MeshError> {
    let Some(data) = uri.strip_prefix("data:") else {
        return beside.read(&percent_decoded(uri));
    };
    let (_, encoded) = data
        .split_once(";base64,")
        .ok_or_else(|| MeshError::Unsupported("data in a URI that is not base64".into()))?;
    STANDARD
        .decode(encoded)
        .map_err(|error| MeshError::Broken(format!("a URI holds no base64 ({error})")))
}

/// `%20` and its like as what they stand for.
fn percent_decoded(uri: &str) -> String {
    let mut bytes = Vec::new();
    let mut rest = uri.as_bytes();
    while let Some((first, more)) = rest.split_first() {
        let code = more
            .get(..2)
            .filter(|_| *first == b'%')
            .and_then(|code| u8::from_str_radix(str::from_utf8(code).ok()?, 16).ok());
        bytes.push(code.unwrap_or(*first));
        rest = &more[if code.is_some() { 2 } else { 0 }..];
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

struct Reader<'a> {
    document: &'a Document,
    buffers: Vec<Vec<u8>>,
    beside: &'a dyn SiblingFiles,
    frames: TextureSet,
    /// Those of the document, then the default.
    materials: Vec<Material>,
    textured: bool,
    data: MeshData,
}

impl Reader<'_> {
    /// Adds a material; none is the default.
    fn material(&mut self, material: Option<&gltf::Material<'_>>) -> Result<(), MeshError> {
        let Some(material) = material else {
            self.materials.push(Material {
                color: [1.0; 3],
                texture: None,
            });
            return Ok(());
        };
        let base = material.pbr_metallic_roughness();
        let [red, green, blue, _] = base.base_color_factor();
        let texture = base.base_color_texture().map(|info| {
            if info.tex_coord() != 0 {
                return Err(MeshError::Unsupported(
                    "a texture by the second set of texture points".into(),
                ));
            }
            self.texture(info.texture().source().index())
        });
        let material = Material {
            color: clamped([red, green, blue]),
            texture: texture.transpose()?,
        };
        self.materials.push(material);
        Ok(())
    }

    fn texture(&mut self, image: usize) -> Result<u16, MeshError> {
        let json = &self.document.as_json().images[image];
        let (buffers, document, beside) = (&self.buffers, self.document, self.beside);
        let name = json
            .uri
            .clone()
            .filter(|uri| !uri.starts_with("data:"))
            .unwrap_or_else(|| format!("image {image}"));
        self.frames
            .of(&name, || match (&json.uri, json.buffer_view) {
                (Some(uri), _) => {
                    resource(uri, beside).map_err(|reason| MeshError::texture(&name, reason))
                }
                (None, Some(view)) => Ok(view_of(document, buffers, view.value())?.to_vec()),
                (None, None) => Err(MeshError::Broken(format!("image {image} is nowhere"))),
            })
    }

    /// Adds the meshes of the default scene, or of the first one; without scenes those of all nodes
    /// that are nobody's child.
    fn walk(&mut self) -> Result<(), MeshError> {
        let nodes = &self.document.as_json().nodes;
        let roots: Vec<usize> = match self
            .document
            .default_scene()
            .or_else(|| self.document.scenes().next())
        {
            Some(scene) => scene.nodes().map(|node| node.index()).collect(),
            None => {
                let child = |index: &usize| {
                    nodes
                        .iter()
                        .flat_map(|node| node.children.iter().flatten())
                        .any(|child| child.value() == *index)
                };
                (0..nodes.len().min(NODES_MAX))
                    .filter(|index| !child(index))
                    .collect()
            }
        };
        let mut open: Vec<(usize, Matrix)> = roots
            .into_iter()
            .rev()
            .map(|root| (root, IDENTITY))
            .collect();
        let mut visited = vec![false; nodes.len()];
        let mut count = 0;
        while let Some((index, outer)) = open.pop() {
            count += 1;
            if std::mem::replace(&mut visited[index], true) {
                return Err(MeshError::Broken(format!(
                    "node {index} is a child twice, or of itself"
                )));
            }
            if count > NODES_MAX {
                return Err(MeshError::too_large(
                    "nodes",
                    nodes.len(),
                    NODES_MAX,
                    "join them",
                ));
            }
            let node = self
                .document
                .nodes()
                .nth(index)
                .expect("the document was checked");
            let matrix = product(&outer, &node.transform().matrix());
            if let Some(mesh) = node.mesh() {
                for primitive in mesh.primitives() {
                    self.primitive(&primitive, &matrix)?;
                }
            }
            let children: Vec<usize> = node.children().map(|child| child.index()).collect();
            open.extend(children.into_iter().rev().map(|child| (child, matrix)));
        }
        Ok(())
    }

    fn primitive(&mut self, primitive: &Primitive<'_>, matrix: &Matrix) -> Result<(), MeshError> {
        if matches!(
            primitive.mode(),
            Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip
        ) {
            return Ok(());
        }
        let Some(positions) = primitive.get(&Semantic::Positions) else {
            return Ok(());
        };
        let count = positions.count();
        let first = self.data.positions.len();
        if first.saturating_add(count) > VERTICES_MAX {
            return Err(MeshError::too_large(
                "vertices",
                first.saturating_add(count),
                VERTICES_MAX,
                DECIMATE,
            ));
        }
        self.data.positions.extend(
            self.floats::<3>(&positions)?
                .into_iter()
                .map(|point| upright(transformed(matrix, point, 1.0))),
        );
        let optional = |semantic: &Semantic| {
            primitive
                .get(semantic)
                .filter(|accessor| accessor.count() == count)
        };
        // A list is either whole or empty: what another primitive has and this one has
        // not is filled up.
        if let Some(normals) = optional(&Semantic::Normals) {
            let normals = self.floats::<3>(&normals)?;
            let to_scene = normal_matrix(matrix);
            self.data.normals.resize(first, [0.0; 3]);
            self.data.normals.extend(
                normals
                    .into_iter()
                    .map(|normal| upright(transformed(&to_scene, normal, 0.0))),
            );
        }
        if let Some(points) = optional(&Semantic::TexCoords(0)).filter(|_| self.textured) {
            let points = self.floats::<2>(&points)?;
            self.data.texture_points.resize(first, [0.0; 2]);
            self.data.texture_points.extend(points);
        }
        if let Some(colors) = optional(&Semantic::Colors(0)) {
            let colors = match colors.dimensions() {
                Dimensions::Vec4 => self
                    .floats::<4>(&colors)?
                    .into_iter()
                    .map(|[red, green, blue, _]| [red, green, blue])
                    .collect(),
                _ => self.floats::<3>(&colors)?,
            };
            self.data.colors.resize(first, [1.0; 3]);
            self.data.colors.extend(colors.into_iter().map(clamped));
        }
        let end = first + count;
        fill(&mut self.data.normals, end, [0.0; 3]);
        fill(&mut self.data.colors, end, [1.0; 3]);
        if self.textured {
            self.data.texture_points.resize(end, [0.0; 2]);
        }
        let corners: Vec<usize> = match primitive.indices() {
            None => (0..count).collect(),
            Some(indices) => {
                let indices = self.indices(&indices)?;
                if let Some(index) = indices.iter().find(|index| **index >= count) {
                    return Err(MeshError::Broken(format!(
                        "a triangle refers to vertex {index}, and there are {count}"
                    )));
                }
                indices
            }
        };
        let triangles: Vec<[usize; 3]> = match primitive.mode() {
            Mode::TriangleStrip => {
                let swap = |(index, [a, b, c]): (usize, [usize; 3])| {
                    if index % 2 == 0 { [a, b, c] } else { [b, a, c] }
                };
                corners
                    .windows(3)
                    .map(|window| [window[0], window[1], window[2]])
                    .enumerate()
                    .map(swap)
                    .collect()
            }
            Mode::TriangleFan => corners
                .get(1..)
                .unwrap_or(&[])
                .windows(2)
                .map(|pair| [corners[0], pair[0], pair[1]])
                .collect(),
            _ => corners.as_chunks::<3>().0.to_vec(),
        };
        if self.data.triangles.len() + triangles.len() > TRIANGLES_MAX {
            return Err(MeshError::too_many_triangles());
        }
        let material = primitive
            .material()
            .index()
            .unwrap_or(self.materials.len() - 1);
        let material = u16::try_from(material)
            .map_err(|_| MeshError::Broken("it has too many materials".into()))?;
        let corner = |corner: usize| (first + corner) as u32;
        self.data
            .triangles
            .extend(triangles.into_iter().map(|corners| Triangle {
                corners: corners.map(corner),
                material,
            }));
        Ok(())
    }

    fn indices(&self, accessor: &gltf::Accessor<'_>) -> Result<Vec<usize>, MeshError> {
        if accessor.count() > TRIANGLES_MAX * 3 {
            return Err(MeshError::too_many_triangles());
        }
        let values = self.values(accessor, 1)?;
        let size = accessor.data_type().size();
        let number = |bytes: &[u8]| {
            (0..size)
                .rev()
                .fold(0usize, |number, at| number << 8 | usize::from(bytes[at]))
        };
        match accessor.data_type() {
            DataType::U8 | DataType::U16 | DataType::U32 => Ok(values.map(number).collect()),
            other => Err(MeshError::Broken(format!("indices are {other:?}"))),
        }
    }

    /// Vectors of floats; whole numbers where they are said to stand for 0 to 1.
    fn floats<const N: usize>(
        &self,
        accessor: &gltf::Accessor<'_>,
    ) -> Result<Vec<[f32; N]>, MeshError> {
        let size = accessor.data_type().size();
        let float: fn(&[u8]) -> f32 = match (accessor.data_type(), accessor.normalized()) {
            (DataType::F32, _) => {
                |bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])
            }
            (DataType::U8, true) => |bytes| f32::from(bytes[0]) / 255.0,
            (DataType::U16, true) => {
                |bytes| f32::from(u16::from_le_bytes([bytes[0], bytes[1]])) / 65_535.0
            }
            (kind, normalized) => {
                return Err(MeshError::Unsupported(format!(
                    "vertices of {kind:?}, normalized: {normalized}"
                )));
            }
        };
        Ok(self
            .values(accessor, N)?
            .map(|bytes| std::array::from_fn(|at| float(&bytes[at * size..])))
            .collect())
    }

    /// The bytes of each element of an accessor, which has so many components.
    fn values(
        &self,
        accessor: &gltf::Accessor<'_>,
        components: usize,
    ) -> Result<impl Iterator<Item = &[u8]>, MeshError> {
        let broken =
            |what: &str| MeshError::Broken(format!("accessor {} {what}", accessor.index()));
        if accessor.sparse().is_some() {
            return Err(MeshError::Unsupported("sparse accessors".into()));
        }
        if accessor.dimensions().multiplicity() != components {
            return Err(broken(&format!(
                "has {} components instead of {components}",
                accessor.dimensions().multiplicity()
            )));
        }
        let view = accessor.view().ok_or_else(|| broken("has no data"))?;
        let bytes = view_of(self.document, &self.buffers, view.index())?;
        let size = accessor.data_type().size() * components;
        let stride = view.stride().unwrap_or(size).max(size);
        let end = stride
            .checked_mul(accessor.count().saturating_sub(1))
            .and_then(|end| end.checked_add(size)?.checked_add(accessor.offset()));
        let bytes = end
            .and_then(|end| bytes.get(accessor.offset()..end))
            .ok_or_else(|| broken("ends behind its data"))?;
        Ok(bytes
            .chunks(stride)
            .take(accessor.count())
            .map(move |element| &element[..size]))
    }
}

/// The bytes of a view.
fn view_of<'b>(
    document: &Document,
    buffers: &'b [Vec<u8>],
    view: usize,
) -> Result<&'b [u8], MeshError> {
    let json = &document.as_json().buffer_views[view];
    let start = json.byte_offset.map_or(0, |offset| offset.0 as usize);
    let end = start.checked_add(json.byte_length.0 as usize);
    let bytes = end.and_then(|end| buffers[json.buffer.value()].get(start..end));
    bytes.ok_or_else(|| MeshError::Broken(format!("view {view} ends behind its buffer")))
}

fn fill<T: Copy>(list: &mut Vec<T>, end: usize, with: T) {
    if !list.is_empty() {
        list.resize(end, with);
    }
}

fn product(outer: &Matrix, inner: &Matrix) -> Matrix {
    inner.map(|column| [0, 1, 2, 3].map(|row| (0..4).map(|k| outer[k][row] * column[k]).sum()))
}

fn transformed(matrix: &Matrix, [x, y, z]: [f32; 3], w: f32) -> [f32; 3] {
    [0, 1, 2].map(|row| {
        matrix[0][row] * x + matrix[1][row] * y + matrix[2][row] * z + matrix[3][row] * w
    })
}

/// What takes normals along: the cofactors of the upper left of a matrix.
fn normal_matrix(matrix: &Matrix) -> Matrix {
    let cofactor = |column: usize, row: usize| {
        let (c, d) = ((column + 1) % 3, (column + 2) % 3);
        let (r, s) = ((row + 1) % 3, (row + 2) % 3);
        matrix[c][r] * matrix[d][s] - matrix[c][s] * matrix[d][r]
    };
    let mut normals = IDENTITY;
    for (column, values) in normals.iter_mut().enumerate().take(3) {
        *values = [
            cofactor(column, 0),
            cofactor(column, 1),
            cofactor(column, 2),
            0.0,
        ];
    }
    normals
}
