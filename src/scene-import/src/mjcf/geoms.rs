//! Geoms as solids, and the meshes and colours that they name.

use reel_world::{Solid, SolidShape};

use super::{Compiler, Named, Reader};
use crate::{
    ImportError,
    affine::{Affine, Bounds, Vector, cross, dot, length, unit},
    element::Element,
    files::ImportFiles,
    house::SourceSolid,
    meshes,
    urdf::{bounds_solid, bytes_of, unplaced},
};

/// Meshes and materials of a file.
#[derive(Default)]
pub(super) struct Assets {
    meshes: Named<MeshItem>,
    colors: Named<[u8; 3]>,
}

/// Where a mesh comes from.
struct MeshItem {
    /// The file, or nothing where its points are given.
    file: Option<String>,
    points: Vec<f64>,
    scale: [f64; 3],
    element: Element,
}

impl Assets {
    pub(super) fn of(
        root: &Element,
        _files: &ImportFiles,
        compiler: &Compiler,
    ) -> Result<Self, ImportError> {
        let mut assets = Self::default();
        for section in root.children_of("asset") {
            for element in &section.children {
                match element.tag.as_str() {
                    "mesh" => assets.mesh(element, &compiler.mesh_folder)?,
                    "material" => {
                        if let Some([r, g, b, _]) = element.numbers::<4>("rgba")? {
                            assets
                                .colors
                                .insert(element.name().to_owned(), bytes_of([r, g, b]));
                        }
                    }
                    _ => {}
                }
            }
        }
        Ok(assets)
    }

    fn mesh(&mut self, element: &Element, folder: &str) -> Result<(), ImportError> {
        let file = element.get("file");
        // Without a name it has that of its file.
        let stem = || {
            let name = file?.rsplit('/').next()?;
            Some(name.rsplit_once('.').map_or(name, |(stem, _)| stem))
        };
        let name = element
            .get("name")
            .or_else(stem)
            .ok_or_else(|| element.error("has neither name nor file"))?;
        let item = MeshItem {
            file: file.map(|file| match folder.trim_end_matches('/') {
                "" => file.to_owned(),
                folder => format!("{folder}/{file}"),
            }),
            points: match element.get("vertex") {
                Some(text) => element.list_in("vertex", text)?,
                None => Vec::new(),
            },
            scale: element.numbers("scale")?.unwrap_or([1.0; 3]),
            element: Element {
                children: Vec::new(),
                ..element.clone()
            },
        };
        self.meshes.insert(name.to_owned(), item);
        Ok(())
    }
}

impl Reader<'_> {
    /// A geom as a solid, and whether it is only seen; `None` for what is not read.
    pub(super) fn geom(
        &mut self,
        geom: &Element,
        pose: &Affine,
        class: Option<&str>,
    ) -> Result<Option<(SourceSolid, bool)>, ImportError> {
        let defaults = &self.defaults;
        let get = |name: &str| defaults.get(geom, class, name);
        let mut pose = pose.after(&self.compiler.pose(geom, &get)?);
        let size = match get("size") {
            Some(text) => geom.list_in("size", &text)?,
            None => Vec::new(),
        };
        let kind = get("type").unwrap_or_else(|| {
            if get("mesh").is_some() {
                "mesh"
            } else {
                "sphere"
            }
            .to_owned()
        });
        let mut between_ends = None;
        if let Some(text) = get("fromto") {
            let ends: [f64; 6] = geom.numbers_in("fromto", &text)?;
            let (from, to) = ([ends[0], ends[1], ends[2]], [ends[3], ends[4], ends[5]]);
            let along: Vector = std::array::from_fn(|axis| to[axis] - from[axis]);
            let middle: Vector = std::array::from_fn(|axis| (to[axis] + from[axis]) * 0.5);
            pose = pose
                .after(&Affine::translation(middle))
                .after(&upright_to(along));
            between_ends = Some(length(along) * 0.5);
        }
        let is_visual = ["contype", "conaffinity"]
            .iter()
            .all(|name| get(name).is_some_and(|value| value.trim() == "0"));
        let rgba: Option<[f64; 4]> = match get("rgba") {
            Some(text) => Some(geom.numbers_in("rgba", &text)?),
            None => None,
        };
        // What is nearly invisible shows no colour.
        let own = rgba
            .filter(|rgba| rgba[3] > 0.2)
            .map(|[r, g, b, _]| bytes_of([r, g, b]));
        let color = own.or_else(|| self.assets.colors.get(&get("material")?).copied());
        let mesh = get("mesh");
        let Some((local, is_bounds)) = self.shape(geom, &kind, &size, between_ends, mesh)? else {
            return Ok(None);
        };
        let placed = pose.primitive(&local);
        let solid = SourceSolid {
            primitive: Solid {
                color: color.unwrap_or(local.color),
                ..placed
            },
            is_bounds,
            is_coloured: color.is_some(),
        };
        Ok(Some((solid, is_visual)))
    }

    fn shape(
        &mut self,
        geom: &Element,
        kind: &str,
        size: &[f64],
        between_ends: Option<f64>,
        mesh: Option<String>,
    ) -> Result<Option<(Solid, bool)>, ImportError> {
        let side = |value: Option<f64>| {
            value
                .filter(|value| *value > 0.0)
                .ok_or_else(|| geom.error(format!("a {kind} needs sizes above 0")))
        };
        let at = |index: usize| side(size.get(index).copied());
        Ok(Some(match kind {
            "box" | "ellipsoid" => {
                if kind == "ellipsoid" {
                    self.notes.approximated("ellipsoid: the box of its bounds");
                }
                // between two ends, its first size is half its width
                let half = match between_ends {
                    Some(_) => [at(0)?, at(0)?, side(between_ends)?],
                    None => [at(0)?, at(1)?, at(2)?],
                };
                (unplaced(SolidShape::Box { half }), false)
            }
            "cylinder" | "capsule" => {
                if kind == "capsule" {
                    self.notes.approximated("capsule: a cylinder");
                }
                let radius = at(0)?;
                let round = if kind == "capsule" { radius } else { 0.0 };
                let shape = SolidShape::Cylinder {
                    radius,
                    half_height: side(between_ends.or(size.get(1).copied()))? + round,
                };
                (unplaced(shape), false)
            }
            "sphere" => (unplaced(SolidShape::Sphere { radius: at(0)? }), false),
            "mesh" => {
                let name = mesh.ok_or_else(|| geom.error("is a mesh and names none"))?;
                let Some(bounds) = self.mesh_bounds(geom, &name)? else {
                    return Ok(None);
                };
                self.notes.approximated("mesh: the box of its bounds");
                (bounds_solid(&bounds), true)
            }
            "plane" => return Ok(None),
            other => {
                let shown: String = other.chars().take(40).collect();
                self.notes.left_out(format!("geom of type {shown}"));
                return Ok(None);
            }
        }))
    }

    fn mesh_bounds(&mut self, geom: &Element, name: &str) -> Result<Option<Bounds>, ImportError> {
        let Some(item) = self.assets.meshes.get(name) else {
            let shown: String = name.chars().take(60).collect();
            return Err(geom.error(format!("no mesh {shown:?} among the assets")));
        };
        let bounds = match &item.file {
            Some(file) => {
                let found = meshes::bounds(self.files, file)
                    .map_err(|error| item.element.error(error.to_string()))?;
                if found.is_none() {
                    let ending = file.rsplit('.').next().unwrap_or_default();
                    self.notes.left_out(format!(
                        "mesh: of format .{ending}, which is not read (OBJ and STL are)"
                    ));
                }
                found
            }
            None => {
                let points = item
                    .points
                    .chunks_exact(3)
                    .map(|point| [point[0], point[1], point[2]]);
                let found = Bounds::of_points(points);
                Some(found.ok_or_else(|| item.element.error("has neither file nor vertices"))?)
            }
        };
        let scale = item.scale;
        Ok(bounds.map(|bounds| {
            let corner = |corner: Vector| std::array::from_fn(|axis| corner[axis] * scale[axis]);
            Bounds::of_points([corner(bounds.low), corner(bounds.high)]).expect("two points")
        }))
    }
}

/// A frame by its x and y; `None` where they are no two directions.
pub(super) fn of_axes(&[a, b, c, d, e, f]: &[f64; 6]) -> Option<Affine> {
    let x = unit([a, b, c])?;
    let along = dot(x, [d, e, f]);
    let y = unit([d - x[0] * along, e - x[1] * along, f - x[2] * along])?;
    Some(Affine {
        axes: [x, y, cross(x, y)],
        origin: [0.0; 3],
    })
}

/// The least turn that points z into a direction.
pub(super) fn upright_to(direction: Vector) -> Affine {
    let Some(to) = unit(direction) else {
        return Affine::IDENTITY;
    };
    let axis = cross([0.0, 0.0, 1.0], to);
    let angle = libm::atan2(length(axis), to[2]);
    if length(axis) < 1e-9 {
        return if to[2] < 0.0 {
            Affine::turned(0, std::f64::consts::PI)
        } else {
            Affine::IDENTITY
        };
    }
    Affine::around(axis, angle)
}
