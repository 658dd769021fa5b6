//! The triangles of a stage: its `Mesh` prims in one frame, with their colours, normals and texture
//! points. Polygons are cut as fans; subdivision surfaces are their cages, skinned meshes their
//! points at rest. Visible geometry of other types is refused, because the object would lack it.

use std::collections::{BTreeMap, BTreeSet};

use openusd::usd::{Prim, Stage};
use reel_world::mesh::{Material, MeshData, TRIANGLES_MAX, Triangle};

use super::{
    layers::Layers,
    material::{self, Surface},
    primvar::{Corner, Primvar},
    stage, values, xform,
};
use crate::assets::{
    MeshError,
    affine::{Affine, Vector, cross},
    color::clamped,
    limits::{NODES_MAX, USD_DEPTH_MAX},
    texture::TextureSet,
};

/// Reads all of a stage.
pub(super) fn read(stage: &Stage, layers: &Layers) -> Result<MeshData, MeshError> {
    let frame = stage::frame(stage)?;
    let mut reader = Reader {
        stage,
        layers,
        frame,
        prims: 0,
        surfaces: BTreeMap::new(),
        textures: TextureSet::default(),
        materials: Vec::new(),
        data: MeshData::default(),
    };
    let place = Place {
        frame,
        material: None,
        color: None,
    };
    let walked = reader.children(&stage.prim("/"), &place, 0);
    // A reference that leads nowhere explains what is missing better than what is missing does.
    if let Some(error) = stage::composition_error(stage, layers) {
        return Err(error);
    }
    walked?;
    Ok(reader.finish())
}

/// What prims have from those above them.
#[derive(Clone)]
struct Place {
    frame: Affine,
    material: Option<String>,
    color: Option<[f64; 3]>,
}

struct Reader<'a> {
    stage: &'a Stage,
    layers: &'a Layers,
    /// From the stage to metres with z up.
    frame: Affine,
    prims: usize,
    /// By the path of the material.
    surfaces: BTreeMap<String, Option<Surface>>,
    textures: TextureSet,
    materials: Vec<Material>,
    data: MeshData,
}

/// A vertex: a point and the values that it has at a corner.
type VertexKey = (usize, u16, Option<usize>, Option<usize>, Option<usize>);

impl Reader<'_> {
    fn children(&mut self, prim: &Prim, place: &Place, depth: usize) -> Result<(), MeshError> {
        for child in stage::known(prim.children())? {
            self.prim(&child, place, depth + 1)?;
        }
        Ok(())
    }

    fn prim(&mut self, prim: &Prim, outer: &Place, depth: usize) -> Result<(), MeshError> {
        self.prims += 1;
        if self.prims > NODES_MAX {
            return Err(MeshError::too_large(
                "prims",
                self.prims,
                NODES_MAX,
                "join them",
            ));
        }
        let at = |problem: String| MeshError::Prim {
            prim: prim.path().as_str().to_owned(),
            problem,
        };
        if depth > USD_DEPTH_MAX {
            return Err(at(format!("it is nested deeper than {USD_DEPTH_MAX}")));
        }
        if !stage::is_shown(prim)? {
            return Ok(());
        }
        let kind = stage::type_name(prim)?;
        if is_passed_over(&kind) {
            return Ok(());
        }
        if is_geometry(&kind) {
            return Err(at(format!(
                "a {kind} is not read; convert it to a mesh, in Blender with Object > Convert"
            )));
        }
        let color = Primvar::<3>::of(prim, "primvars:displayColor", false).map_err(at)?;
        let place = Place {
            frame: xform::frame(prim, &outer.frame, &self.frame).map_err(at)?,
            material: material::bound(prim).or_else(|| outer.material.clone()),
            color: color.as_ref().and_then(Primvar::constant).or(outer.color),
        };
        if kind == "Mesh" {
            self.mesh(
                prim,
                &place,
                color.filter(|color| color.constant().is_none()),
            )?;
        }
        self.children(prim, &place, depth)
    }

    fn mesh(
        &mut self,
        prim: &Prim,
        place: &Place,
        colors: Option<Primvar<3>>,
    ) -> Result<(), MeshError> {
        let at = |problem: String| MeshError::Prim {
            prim: prim.path().as_str().to_owned(),
            problem,
        };
        let faces = Faces::of(prim).map_err(at)?;
        if self.data.triangles.len().saturating_add(faces.triangles()) > TRIANGLES_MAX {
            return Err(MeshError::too_many_triangles());
        }
        let materials = self.materials_of(prim, place, colors.is_some(), faces.counts.len())?;
        let normals = match Primvar::of(prim, "primvars:normals", true).map_err(at)? {
            Some(normals) => Some(normals),
            None => Primvar::of(prim, "normals", true).map_err(at)?,
        };
        let mut points = BTreeMap::new();
        for name in materials.iter().filter_map(|look| look.points.clone()) {
            let primvar = Primvar::<2>::of(prim, &format!("primvars:{name}"), false);
            points.insert(name, primvar.map_err(at)?);
        }
        let mut mesh = MeshPrim {
            faces: &faces,
            frame: &place.frame,
            normals,
            colors,
            points,
            known: BTreeMap::new(),
            data: &mut self.data,
        };
        mesh.add(&materials).map_err(at)
    }

    /// How each face of a mesh looks: as its subset says, or as the mesh does.
    fn materials_of(
        &mut self,
        prim: &Prim,
        place: &Place,
        has_colors: bool,
        faces: usize,
    ) -> Result<Vec<Look>, MeshError> {
        let own = self.look(place.material.as_deref(), place.color, has_colors)?;
        let mut looks = vec![own; faces];
        for subset in stage::known(prim.children())? {
            if stage::type_name(&subset)? != "GeomSubset" {
                continue;
            }
            let Some(path) = material::bound(&subset) else {
                continue;
            };
            let look = self.look(Some(&path), place.color, has_colors)?;
            let indices = values::value(&subset, "indices");
            let indices = indices.and_then(|value| values::integers(&value));
            for index in indices.unwrap_or_default() {
                let face = usize::try_from(index).ok();
                let Some(face) = face.and_then(|face| looks.get_mut(face)) else {
                    return Err(MeshError::Prim {
                        prim: subset.path().as_str().to_owned(),
                        problem: format!("it names face {index}, and there are {faces}"),
                    });
                };
                *face = look.clone();
            }
        }
        Ok(looks)
    }

    /// What a material is made of, read once.
    fn surface(&mut self, path: Option<&str>) -> Result<Option<Surface>, MeshError> {
        let Some(path) = path else {
            return Ok(None);
        };
        if let Some(known) = self.surfaces.get(path) {
            return Ok(known.clone());
        }
        let read = material::surface(self.stage, path)?;
        self.surfaces.insert(path.to_owned(), read.clone());
        Ok(read)
    }

    /// The look of a material; of none that of the display colour.
    fn look(
        &mut self,
        path: Option<&str>,
        color: Option<[f64; 3]>,
        has_colors: bool,
    ) -> Result<Look, MeshError> {
        let surface = self.surface(path)?;
        let linear = |color: [f64; 3]| clamped(color.map(|channel| channel as f32));
        let mut look = Look {
            material: 0,
            points: None,
            is_colored: false,
        };
        let material = match surface.unwrap_or(Surface::Display) {
            Surface::Plain(color) => Material {
                color: linear(color),
                texture: None,
            },
            Surface::Textured {
                name,
                located,
                factor,
                points,
            } => {
                look.points = Some(points);
                let layers = self.layers;
                let read = || material::bytes(layers, &name, &located);
                let read = || read().map_err(|reason| MeshError::texture(&name, reason));
                let key = if located.is_empty() { &name } else { &located };
                Material {
                    color: linear(factor),
                    texture: Some(self.textures.of(key, read).map_err(|reason| {
                        // The key is a name of ours; messages have that of the file.
                        renamed(reason, key, &name)
                    })?),
                }
            }
            Surface::Display => {
                look.is_colored = has_colors;
                match color {
                    _ if has_colors => Material {
                        color: [1.0; 3],
                        texture: None,
                    },
                    Some(color) => Material {
                        color: linear(color),
                        texture: None,
                    },
                    None => Material::default(),
                }
            }
        };
        let known = self.materials.iter().position(|known| *known == material);
        let index = known.unwrap_or_else(|| {
            self.materials.push(material);
            self.materials.len() - 1
        });
        look.material = u16::try_from(index)
            .map_err(|_| MeshError::Broken("it has too many materials".into()))?;
        Ok(look)
    }

    fn finish(self) -> MeshData {
        let textures = self.textures.finish();
        let mut data = MeshData {
            materials: self.materials,
            ..self.data
        };
        // What no mesh has, vertices need not have.
        if textures.is_empty() {
            data.texture_points.clear();
        }
        if data.colors.iter().all(|color| *color == [1.0; 3]) {
            data.colors.clear();
        }
        if data.normals.iter().all(|normal| *normal == [0.0; 3]) {
            data.normals.clear();
        }
        MeshData { textures, ..data }
    }
}

/// The look of a face.
#[derive(Clone)]
struct Look {
    material: u16,
    /// The primvar of its texture points.
    points: Option<String>,
    /// Whether its vertices have colours.
    is_colored: bool,
}

/// The polygons of a mesh.
struct Faces {
    points: Vec<Vector>,
    counts: Vec<usize>,
    /// The points of all corners, face by face.
    corners: Vec<usize>,
    holes: BTreeSet<i64>,
    is_left_handed: bool,
}

impl Faces {
    fn of(prim: &Prim) -> Result<Self, String> {
        let points = values::list_of(prim, "points").ok_or("it has no points")?;
        if let Some(at) = points.iter().position(|number| !number.is_finite()) {
            return Err(format!("points[{}] is not finite", at / 3));
        }
        let integers = |name: &str| values::integers(&values::value(prim, name)?);
        let list = |name: &str, least: usize| {
            let list = integers(name).ok_or_else(|| format!("it has no {name}"))?;
            let list = list.into_iter().map(usize::try_from);
            let list: Result<Vec<usize>, _> = list.collect();
            let list = list.map_err(|_| format!("{name} has a number below 0"))?;
            match list.iter().find(|number| **number < least) {
                Some(number) => Err(format!(
                    "{name} has {number}, and a face has 3 corners or more"
                )),
                None => Ok(list),
            }
        };
        let counts = list("faceVertexCounts", 3)?;
        let corners = list("faceVertexIndices", 0)?;
        let total = counts
            .iter()
            .try_fold(0_usize, |total, count| total.checked_add(*count));
        if total != Some(corners.len()) {
            return Err(format!(
                "faceVertexCounts and faceVertexIndices do not belong together: there are {} indices",
                corners.len()
            ));
        }
        let points: Vec<Vector> = points.as_chunks::<3>().0.to_vec();
        if let Some(corner) = corners.iter().find(|corner| **corner >= points.len()) {
            return Err(format!(
                "faceVertexIndices has {corner}, and there are {} points",
                points.len()
            ));
        }
        Ok(Self {
            points,
            counts,
            corners,
            holes: integers("holeIndices")
                .unwrap_or_default()
                .into_iter()
                .collect(),
            is_left_handed: values::token(prim, "orientation").as_deref() == Some("leftHanded"),
        })
    }

    fn triangles(&self) -> usize {
        self.corners.len() - 2 * self.counts.len()
    }
}

/// A mesh on its way into the data.
struct MeshPrim<'a> {
    faces: &'a Faces,
    frame: &'a Affine,
    normals: Option<Primvar<3>>,
    colors: Option<Primvar<3>>,
    points: BTreeMap<String, Option<Primvar<2>>>,
    known: BTreeMap<VertexKey, u32>,
    data: &'a mut MeshData,
}

impl MeshPrim<'_> {
    fn add(&mut self, looks: &[Look]) -> Result<(), String> {
        let mut first = 0;
        for (face, (count, look)) in self.faces.counts.iter().zip(looks).enumerate() {
            let corners = first..first + count;
            first = corners.end;
            if self.faces.holes.contains(&(face as i64)) {
                continue;
            }
            let vertices: Result<Vec<u32>, String> = corners
                .map(|index| {
                    let point = self.faces.corners[index];
                    self.vertex(Corner { face, point, index }, look)
                })
                .collect();
            let vertices = vertices?;
            for pair in vertices[1..].windows(2) {
                let [a, b, c] = [vertices[0], pair[0], pair[1]];
                self.data.triangles.push(Triangle {
                    corners: match self.faces.is_left_handed {
                        true => [a, c, b],
                        false => [a, b, c],
                    },
                    material: look.material,
                });
            }
        }
        Ok(())
    }

    /// The vertex of a corner, a new one unless an equal corner has one.
    fn vertex(&mut self, corner: Corner, look: &Look) -> Result<u32, String> {
        let few = |what: &str| format!("{what} has too few values, or an index out of range");
        let normal = self.normals.as_ref().map(|all| all.index(corner));
        let normal = normal.map(|index| index.ok_or_else(|| few("normals")));
        let normal = normal.transpose()?;
        let colors = self.colors.as_ref().filter(|_| look.is_colored);
        let color = colors.map(|all| all.index(corner));
        let color = color.map(|index| index.ok_or_else(|| few("primvars:displayColor")));
        let color = color.transpose()?;
        let points = look.points.as_ref().map(|name| {
            let all = self.points.get(name).and_then(Option::as_ref);
            let missing = || format!("its texture needs primvars:{name}, which it does not have");
            all.ok_or_else(missing).map(|all| (name, all))
        });
        let points = points.transpose()?;
        let point = points.map(|(name, all)| all.index(corner).ok_or_else(|| few(name)));
        let point = point.transpose()?;
        let key = (corner.point, look.material, normal, color, point);
        if let Some(known) = self.known.get(&key) {
            return Ok(*known);
        }
        let single = |values: Vector| values.map(|value| value as f32);
        let at = self.frame.point(self.faces.points[corner.point]);
        self.data.positions.push(single(at));
        let normal = self
            .normals
            .as_ref()
            .zip(normal)
            .map(|(all, index)| all.value(index));
        let normal = normal.map_or([0.0; 3], |normal| turned(self.frame, normal));
        self.data.normals.push(single(normal));
        let color = self
            .colors
            .as_ref()
            .zip(color)
            .map(|(all, index)| all.value(index));
        self.data
            .colors
            .push(color.map_or([1.0; 3], |color| clamped(single(color))));
        let point = points.zip(point).map(|((_, all), index)| all.value(index));
        // From the lower left corner in the file, from the upper left one in a mesh.
        self.data
            .texture_points
            .push(point.map_or([0.0; 2], |[u, v]| [u as f32, (1.0 - v) as f32]));
        let vertex = self.data.positions.len() as u32 - 1;
        self.known.insert(key, vertex);
        Ok(vertex)
    }
}

/// A normal in an outer frame: by the cofactors, so that it stays upright under any scale.
fn turned(frame: &Affine, [x, y, z]: Vector) -> Vector {
    let [a, b, c] = frame.axes;
    let [p, q, r] = [cross(b, c), cross(c, a), cross(a, b)];
    std::array::from_fn(|axis| p[axis] * x + q[axis] * y + r[axis] * z)
}

/// Types that are no geometry, with all below them.
fn is_passed_over(kind: &str) -> bool {
    matches!(
        kind,
        "Material"
            | "Shader"
            | "NodeGraph"
            | "GeomSubset"
            | "Camera"
            | "Skeleton"
            | "SkelAnimation"
    ) || kind.starts_with("Physics")
        || kind.ends_with("Light")
}

/// Types that show, and are no mesh.
fn is_geometry(kind: &str) -> bool {
    matches!(
        kind,
        "Cube"
            | "Sphere"
            | "Cylinder"
            | "Cylinder_1"
            | "Cone"
            | "Capsule"
            | "Capsule_1"
            | "Plane"
            | "TetMesh"
            | "NurbsPatch"
            | "NurbsCurves"
            | "BasisCurves"
            | "HermiteCurves"
            | "Points"
            | "PointInstancer"
            | "Volume"
    )
}

/// The reason to refuse a texture, by the name that its layer has for it.
fn renamed(reason: MeshError, key: &str, name: &str) -> MeshError {
    match reason {
        MeshError::In { file, reason } if file == key => MeshError::In {
            file: name.to_owned(),
            reason,
        },
        reason => reason,
    }
}
