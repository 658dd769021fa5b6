//! URDF: links with shapes and the joints between them. One file is one piece of furniture.

use std::collections::{BTreeMap, BTreeSet};

use reel_world::{Solid, SolidShape};

use crate::{
    ImportError,
    affine::{Affine, Bounds, unit},
    element::Element,
    files::{DEPTH_MAX, ImportFiles},
    house::{House, Joint, SourceSolid},
    meshes,
    notes::Notes,
    tree::{self, Node},
};

/// What a shape without a colour looks like until one is chosen.
const PLAIN: [u8; 3] = [176, 172, 166];
/// How far a joint without limits opens: metres and degrees.
const UNLIMITED: (f64, f64) = (0.3, 90.0);

/// Reads a file of the folder.
pub(crate) fn read(files: &ImportFiles) -> Result<House, ImportError> {
    let root = Element::read(files, &files.name)?;
    if root.tag != "robot" {
        return Err(root.error("no URDF: its root is not <robot>"));
    }
    let mut reader = Reader {
        files,
        links: root
            .children_of("link")
            .map(|link| (link.name(), link))
            .collect(),
        joints: BTreeMap::new(),
        materials: materials(&root)?,
        notes: Notes::default(),
        seen: BTreeSet::new(),
    };
    let mut children = BTreeSet::new();
    for joint in root.children_of("joint") {
        let end = |tag: &str| {
            let name = joint.child(tag).and_then(|end| end.get("link"));
            let name = name.ok_or_else(|| joint.error(format!("has no <{tag} link=...>")))?;
            if reader.links.contains_key(name) {
                return Ok(name);
            }
            Err(joint.error(format!("its {tag} {name:?} is no link of the file")))
        };
        let (parent, child) = (end("parent")?, end("child")?);
        reader
            .joints
            .entry(parent)
            .or_default()
            .push((joint, child));
        children.insert(child);
    }
    for tag in ["gazebo", "transmission", "sensor"] {
        root.children_of(tag)
            .for_each(|_| reader.notes.left_out(format!("element <{tag}>")));
    }
    let mut roots = Vec::new();
    for link in root
        .children_of("link")
        .filter(|link| !children.contains(link.name()))
    {
        roots.push(reader.node(link, &Affine::IDENTITY, 0)?);
    }
    let in_circle = root
        .children_of("link")
        .find(|link| !reader.seen.contains(link.name()));
    if let Some(link) = in_circle {
        return Err(link.error("its joints form a circle: no link without a parent leads to it"));
    }
    if roots.is_empty() {
        return Err(root.error("has no links"));
    }
    let mut notes = reader.notes;
    let model = format!("{} {}", files.name.trim_end_matches(".urdf"), root.name());
    let mut pieces = tree::pieces(roots, &model, &mut notes);
    for piece in &mut pieces {
        piece.source = format!("{}/{}", root.name(), piece.source);
    }
    Ok(House {
        name: root.name().to_owned(),
        pieces,
        notes,
        ..House::default()
    })
}

fn materials(root: &Element) -> Result<BTreeMap<String, [u8; 3]>, ImportError> {
    let mut found = BTreeMap::new();
    for material in root.children_of("material") {
        if let Some(color) = color_of(material)? {
            found.insert(material.name().to_owned(), color);
        }
    }
    Ok(found)
}

fn color_of(material: &Element) -> Result<Option<[u8; 3]>, ImportError> {
    let Some(color) = material.child("color") else {
        return Ok(None);
    };
    Ok(color
        .numbers::<4>("rgba")?
        .map(|[r, g, b, _]| bytes_of([r, g, b])))
}

/// Red, green and blue from shares of 1.
pub(crate) fn bytes_of(color: [f64; 3]) -> [u8; 3] {
    color.map(|share| (share.clamp(0.0, 1.0) * 255.0).round() as u8)
}

struct Reader<'a> {
    files: &'a ImportFiles,
    links: BTreeMap<&'a str, &'a Element>,
    /// By their parent: the joint and its child.
    joints: BTreeMap<&'a str, Vec<(&'a Element, &'a str)>>,
    materials: BTreeMap<String, [u8; 3]>,
    notes: Notes,
    seen: BTreeSet<&'a str>,
}

impl<'a> Reader<'a> {
    fn node(
        &mut self,
        link: &'a Element,
        pose: &Affine,
        depth: usize,
    ) -> Result<Node, ImportError> {
        if depth > DEPTH_MAX || !self.seen.insert(link.name()) {
            return Err(
                link.error("is its own ancestor, has two parents, or is over 100 joints deep")
            );
        }
        let outer = self.notes.about(link.name());
        let mut node = Node {
            name: link.name().to_owned(),
            solids: self.solids(link, pose)?,
            ..Node::default()
        };
        for (joint, child) in self.joints.get(link.name()).cloned().unwrap_or_default() {
            let frame = pose.after(&origin(joint)?);
            let mut below = self.node(self.links[child], &frame, depth + 1)?;
            self.notes.about(joint.name());
            below.joint = self.joint(joint, &frame)?;
            below.joint_name = joint.name().to_owned();
            node.children.push(below);
        }
        self.notes.about(&outer);
        Ok(node)
    }

    fn joint(&mut self, joint: &Element, frame: &Affine) -> Result<Option<Joint>, ImportError> {
        let axis = match joint.child("axis") {
            Some(axis) => axis.numbers("xyz")?.unwrap_or([1.0, 0.0, 0.0]),
            None => [1.0, 0.0, 0.0],
        };
        let Some(axis) = unit(frame.direction(axis)) else {
            return Err(joint.error("its axis has no direction"));
        };
        let kind = joint.get("type").unwrap_or_default();
        if joint.child("mimic").is_some() {
            self.notes
                .approximated("joint that follows another one (<mimic>): moves on its own");
        }
        let open = |limited: bool| -> Result<Option<f64>, ImportError> {
            let Some(limit) = joint.child("limit").filter(|_| limited) else {
                return Ok(None);
            };
            let [lower] = limit.numbers("lower")?.unwrap_or([0.0]);
            let [upper] = limit.numbers("upper")?.unwrap_or([0.0]);
            Ok(Some(if upper.abs() >= lower.abs() {
                upper
            } else {
                lower
            }))
        };
        match kind {
            "fixed" => Ok(None),
            "prismatic" => {
                let by = self.or_usual(open(true)?, UNLIMITED.0);
                Ok(Some(Joint::Slide {
                    open_by: axis.map(|part| part * by),
                }))
            }
            "revolute" | "continuous" => {
                let angle = open(kind == "revolute")?.map(f64::to_degrees);
                Ok(Some(Joint::Hinge {
                    position: frame.origin,
                    axis,
                    open_deg: self.or_usual(angle, UNLIMITED.1),
                }))
            }
            other => {
                let shown: String = other.chars().take(40).collect();
                self.notes
                    .left_out(format!("joint: of type {shown}, kept closed"));
                Ok(None)
            }
        }
    }

    fn or_usual(&mut self, limit: Option<f64>, usual: f64) -> f64 {
        limit.unwrap_or_else(|| {
            self.notes
                .approximated("joint without limits: opens 0.3 m or 90 degrees");
            usual
        })
    }

    /// The shapes of a link: those seen if they are as exact as those that collide.
    fn solids(&mut self, link: &Element, pose: &Affine) -> Result<Vec<SourceSolid>, ImportError> {
        let seen = self.shapes(link, "visual", pose)?;
        let rough = |solids: &[SourceSolid]| solids.iter().filter(|solid| solid.is_bounds).count();
        if !seen.is_empty() && rough(&seen) == 0 {
            return Ok(seen);
        }
        let collide = self.shapes(link, "collision", pose)?;
        let takes_collision = !collide.is_empty()
            && (seen.is_empty() || (rough(&collide) < rough(&seen) && fills(&collide, &seen)));
        if !takes_collision {
            return Ok(seen);
        }
        if !seen.is_empty() {
            self.notes
                .approximated("link that is seen as a mesh: what collides of it stands for it");
        }
        let color = seen
            .iter()
            .find(|solid| solid.is_coloured)
            .map(|solid| solid.primitive.color);
        Ok(collide
            .into_iter()
            .map(|mut solid| {
                if let Some(color) = color.filter(|_| !solid.is_coloured) {
                    solid.primitive.color = color;
                    solid.is_coloured = true;
                }
                solid
            })
            .collect())
    }

    fn shapes(
        &mut self,
        link: &Element,
        tag: &str,
        pose: &Affine,
    ) -> Result<Vec<SourceSolid>, ImportError> {
        let mut solids = Vec::new();
        for item in link.children.iter().filter(|child| child.tag == tag) {
            let Some(shape) = item
                .child("geometry")
                .and_then(|geometry| geometry.children.first())
            else {
                return Err(item.error("has no shape in a <geometry>"));
            };
            let Some((local, is_bounds)) = self.shape(shape)? else {
                continue;
            };
            let color = match item.child("material") {
                Some(material) => {
                    color_of(material)?.or_else(|| self.materials.get(material.name()).copied())
                }
                None => None,
            };
            let placed = pose.after(&origin(item)?).primitive(&local);
            solids.push(SourceSolid {
                primitive: Solid {
                    color: color.unwrap_or(PLAIN),
                    ..placed
                },
                is_bounds,
                is_coloured: color.is_some(),
            });
        }
        Ok(solids)
    }

    /// A shape in its own frame, and whether it only bounds a mesh.
    fn shape(&mut self, shape: &Element) -> Result<Option<(Solid, bool)>, ImportError> {
        let above_zero = |name: &str| -> Result<f64, ImportError> {
            let value = shape
                .numbers::<1>(name)?
                .map(|[value]| value)
                .filter(|value| *value > 0.0);
            value.ok_or_else(|| shape.error(format!("{name} must be a number above 0")))
        };
        let solid = match shape.tag.as_str() {
            "box" => {
                let size: [f64; 3] = shape
                    .numbers("size")?
                    .ok_or_else(|| shape.error("has no size"))?;
                if size.into_iter().any(|side| side <= 0.0) {
                    return Err(shape.error("every side of its size must be above 0"));
                }
                SolidShape::Box {
                    half: size.map(|side| side * 0.5),
                }
            }
            "cylinder" | "capsule" => SolidShape::Cylinder {
                radius: above_zero("radius")?,
                half_height: above_zero("length")? * 0.5,
            },
            "sphere" => SolidShape::Sphere {
                radius: above_zero("radius")?,
            },
            "mesh" => return self.mesh(shape),
            other => {
                let shown: String = other.chars().take(40).collect();
                self.notes.left_out(format!("shape <{shown}>"));
                return Ok(None);
            }
        };
        Ok(Some((unplaced(solid), false)))
    }

    fn mesh(&mut self, shape: &Element) -> Result<Option<(Solid, bool)>, ImportError> {
        let named = shape
            .get("filename")
            .ok_or_else(|| shape.error("has no filename"))?;
        let name = named.strip_prefix("file://").unwrap_or(named);
        // A package is a folder somewhere: its files are looked for in a folder of its name beside
        // the URDF, then beside the URDF itself.
        let name = match name.strip_prefix("package://") {
            Some(path) if self.files.has(path) => path,
            Some(path) => match path.split_once('/') {
                Some((package, below)) => {
                    let shown: String = package.chars().take(40).collect();
                    self.notes.approximated(format!(
                        "mesh of the package {shown}: looked for beside the file"
                    ));
                    below
                }
                None => path,
            },
            None => name,
        };
        let scale = shape.numbers("scale")?.unwrap_or([1.0; 3]);
        let bounds =
            meshes::bounds(self.files, name).map_err(|error| shape.error(error.to_string()))?;
        let Some(bounds) = bounds else {
            let ending = name.rsplit('.').next().unwrap_or_default();
            self.notes.left_out(format!(
                "mesh: of format .{ending}, which is not read (OBJ and STL are)"
            ));
            return Ok(None);
        };
        self.notes.approximated("mesh: the box of its bounds");
        Ok(Some((
            Affine::scaled(scale).primitive(&bounds.solid(PLAIN)),
            true,
        )))
    }
}

/// Whether some solids reach as far as others do, but for ten centimetres and a tenth of their size
/// on each side: a post that collides does not stand for a cabinet that is seen, a front without
/// its handle does.
pub(crate) fn fills(solids: &[SourceSolid], others: &[SourceSolid]) -> bool {
    const MISSED_MAX_M: f64 = 0.1;
    const MISSED_SHARE_MAX: f64 = 0.1;
    let bounds =
        |solids: &[SourceSolid]| Bounds::of_all(solids.iter().map(|solid| &solid.primitive));
    let (Some(inner), Some(outer)) = (bounds(solids), bounds(others)) else {
        return false;
    };
    (0..3).all(|axis| {
        let missed = MISSED_MAX_M + MISSED_SHARE_MAX * (outer.high[axis] - outer.low[axis]);
        inner.low[axis] <= outer.low[axis] + missed && inner.high[axis] >= outer.high[axis] - missed
    })
}

/// A shape at the origin.
pub(crate) fn unplaced(shape: SolidShape) -> Solid {
    Solid {
        shape,
        position: [0.0; 3],
        rotation: [0.0, 0.0, 0.0, 1.0],
        color: PLAIN,
    }
}

/// The `<origin xyz rpy>` of an element: turned around the fixed axes x, y, z in this order.
fn origin(of: &Element) -> Result<Affine, ImportError> {
    let Some(origin) = of.child("origin") else {
        return Ok(Affine::IDENTITY);
    };
    let at = origin.numbers("xyz")?.unwrap_or_default();
    let [roll, pitch, yaw] = origin.numbers("rpy")?.unwrap_or_default();
    let turn = Affine::turned(2, yaw)
        .after(&Affine::turned(1, pitch))
        .after(&Affine::turned(0, roll));
    Ok(Affine::translation(at).after(&turn))
}

/// The box of a mesh that is given by its points.
pub(crate) fn bounds_solid(bounds: &Bounds) -> Solid {
    bounds.solid(PLAIN)
}
