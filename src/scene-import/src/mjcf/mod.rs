//! MJCF of MuJoCo: bodies with geoms and joints, defaults by class, includes.

mod defaults;
mod geoms;

use std::collections::BTreeMap;

use crate::{
    ImportError,
    affine::{Affine, unit},
    element::Element,
    files::{DEPTH_MAX, ImportFiles},
    house::{House, Joint, SourceSolid},
    notes::Notes,
    tree::{self, Node},
    urdf::fills,
};
use defaults::Defaults;
use geoms::Assets;

/// Most files that includes may name.
const INCLUDES_MAX: usize = 64;
/// Most elements of all files.
const ELEMENTS_MAX: usize = 500_000;
/// How far a joint without a range opens: metres and degrees.
const UNLIMITED: (f64, f64) = (0.3, 90.0);

/// Reads a file of the folder and those that it includes.
pub(crate) fn read(files: &ImportFiles) -> Result<House, ImportError> {
    let mut root = Element::read(files, &files.name)?;
    if root.tag != "mujoco" {
        return Err(root.error("no MJCF: its root is not <mujoco>"));
    }
    let mut trail = vec![files.name.clone()];
    let mut included = 0;
    include(&mut root, files, &mut trail, &mut included)?;
    if root.count() > ELEMENTS_MAX {
        return Err(root.error(format!("more than {ELEMENTS_MAX} elements")));
    }
    let compiler = Compiler::of(&root)?;
    let mut reader = Reader {
        assets: Assets::of(&root, files, &compiler)?,
        defaults: Defaults::of(&root)?,
        compiler,
        files,
        notes: Notes::default(),
    };
    for tag in [
        "equality",
        "tendon",
        "actuator",
        "sensor",
        "contact",
        "keyframe",
        "deformable",
    ] {
        for section in root.children_of(tag) {
            section
                .children
                .iter()
                .for_each(|_| reader.notes.left_out(format!("element of <{tag}>")));
        }
    }
    let mut roots = Vec::new();
    for world in root.children_of("worldbody") {
        reader.defaults.check_classes(world)?;
        let node = reader.node(world, &Affine::IDENTITY, None, 0)?;
        let geoms = world
            .children_of("geom")
            .filter(|geom| geom.get("type") != Some("plane"));
        geoms.for_each(|_| reader.notes.left_out("geom of the world itself"));
        roots.extend(node.children);
    }
    let mut notes = reader.notes;
    let model = format!(
        "{} {}",
        files.name.trim_end_matches(".xml"),
        root.get("model").unwrap_or_default()
    );
    let pieces = tree::pieces(roots, &model, &mut notes);
    Ok(House {
        name: root.get("model").unwrap_or_default().to_owned(),
        pieces,
        notes,
        ..House::default()
    })
}

/// Puts the children of included files in the place of their `<include>`.
fn include(
    element: &mut Element,
    files: &ImportFiles,
    trail: &mut Vec<String>,
    included: &mut usize,
) -> Result<(), ImportError> {
    let mut children = Vec::new();
    for mut child in std::mem::take(&mut element.children) {
        if child.tag != "include" {
            include(&mut child, files, trail, included)?;
            children.push(child);
            continue;
        }
        let name = child
            .get("file")
            .ok_or_else(|| child.error("has no file"))?
            .to_owned();
        *included += 1;
        if trail.contains(&name) {
            return Err(child.error(format!(
                "{name} includes itself: {} -> {name}",
                trail.join(" -> ")
            )));
        }
        if *included > INCLUDES_MAX {
            return Err(child.error(format!("more than {INCLUDES_MAX} files are included")));
        }
        let mut other = Element::read(files, &name).map_err(|error| match error {
            error @ ImportError::Syntax { .. } => error,
            error => child.error(error.to_string()),
        })?;
        trail.push(name);
        include(&mut other, files, trail, included)?;
        trail.pop();
        children.extend(other.children);
    }
    element.children = children;
    Ok(())
}

/// What `<compiler>` says of angles and folders.
struct Compiler {
    /// Radians in the unit of angles.
    angle: f64,
    /// Axes of Euler angles, and whether they are the turned ones.
    sequence: Vec<(usize, bool)>,
    mesh_folder: String,
    /// Whether a joint with a range has limits without saying so (`autolimits`).
    limits_by_range: bool,
}

impl Compiler {
    fn of(root: &Element) -> Result<Self, ImportError> {
        let mut compiler = Self {
            angle: std::f64::consts::PI / 180.0,
            sequence: vec![(0, true), (1, true), (2, true)],
            mesh_folder: String::new(),
            limits_by_range: true,
        };
        for element in root.children_of("compiler") {
            match element.get("angle") {
                Some("radian") => compiler.angle = 1.0,
                Some("degree") | None => {}
                Some(_) => return Err(element.error("angle is radian or degree")),
            }
            if let Some(text) = element.get("autolimits") {
                compiler.limits_by_range = text != "false";
            }
            if let Some(text) = element.get("eulerseq") {
                let axis = |letter: char| {
                    let axis = "xyz".find(letter.to_ascii_lowercase())?;
                    Some((axis, letter.is_ascii_lowercase()))
                };
                let sequence: Option<Vec<_>> = text.chars().map(axis).collect();
                compiler.sequence = sequence
                    .filter(|sequence| sequence.len() == 3)
                    .ok_or_else(|| element.error("eulerseq is three of x, y, z, X, Y, Z"))?;
            }
            if element
                .get("coordinate")
                .is_some_and(|frame| frame == "global")
            {
                return Err(
                    element.error("global coordinates are not read: MuJoCo has none since 2.3")
                );
            }
            if let Some(folder) = element.get("meshdir").or(element.get("assetdir")) {
                folder.clone_into(&mut compiler.mesh_folder);
            }
        }
        Ok(compiler)
    }

    /// The place and turn of an element, by attributes of it or its class.
    fn pose(
        &self,
        element: &Element,
        get: &dyn Fn(&str) -> Option<String>,
    ) -> Result<Affine, ImportError> {
        let list = |name: &str| {
            get(name)
                .map(|text| element.list_in(name, &text))
                .transpose()
        };
        let at = match get("pos") {
            Some(text) => element.numbers_in("pos", &text)?,
            None => [0.0; 3],
        };
        let wrong = |name: &str| element.error(format!("{name} has the wrong number of values"));
        let zero = |name: &str| element.error(format!("{name} has no direction: it is zero"));
        let turn = if let Some(quat) = list("quat")? {
            let [w, x, y, z]: [f64; 4] = quat.try_into().map_err(|_| wrong("quat"))?;
            if [w, x, y, z] == [0.0; 4] {
                return Err(zero("quat"));
            }
            Affine::of_quaternion([x, y, z, w])
        } else if let Some(values) = list("axisangle")? {
            let [x, y, z, angle]: [f64; 4] = values.try_into().map_err(|_| wrong("axisangle"))?;
            unit([x, y, z]).ok_or_else(|| zero("axisangle"))?;
            Affine::around([x, y, z], angle * self.angle)
        } else if let Some(values) = list("euler")? {
            let angles: [f64; 3] = values.try_into().map_err(|_| wrong("euler"))?;
            self.euler(angles)
        } else if let Some(values) = list("xyaxes")? {
            let axes: [f64; 6] = values.try_into().map_err(|_| wrong("xyaxes"))?;
            geoms::of_axes(&axes).ok_or_else(|| element.error("xyaxes are no two directions"))?
        } else if let Some(values) = list("zaxis")? {
            let axis: [f64; 3] = values.try_into().map_err(|_| wrong("zaxis"))?;
            geoms::upright_to(axis)
        } else {
            Affine::IDENTITY
        };
        Ok(Affine::translation(at).after(&turn))
    }

    /// Turned axes (small letters) are applied after what came before, fixed ones before it.
    fn euler(&self, angles: [f64; 3]) -> Affine {
        let mut turn = Affine::IDENTITY;
        for ((axis, is_turned), angle) in self.sequence.iter().zip(angles) {
            let next = Affine::turned(*axis, angle * self.angle);
            turn = if *is_turned {
                turn.after(&next)
            } else {
                next.after(&turn)
            };
        }
        turn
    }
}

struct Reader<'a> {
    compiler: Compiler,
    defaults: Defaults,
    assets: Assets,
    files: &'a ImportFiles,
    notes: Notes,
}

impl Reader<'_> {
    fn node(
        &mut self,
        body: &Element,
        pose: &Affine,
        class: Option<&str>,
        depth: usize,
    ) -> Result<Node, ImportError> {
        if depth > DEPTH_MAX {
            return Err(body.error(format!("bodies nest deeper than {DEPTH_MAX}")));
        }
        let class = body.get("childclass").or(class);
        let own = |name: &str| body.get(name).map(str::to_owned);
        let pose = pose.after(&self.compiler.pose(body, &own)?);
        // what a frame holds is of the body around it
        let name = body.name();
        let outer = (!name.is_empty()).then(|| self.notes.about(name));
        let mut node = Node {
            name: name.to_owned(),
            ..Node::default()
        };
        let (mut collide, mut seen): (Vec<SourceSolid>, Vec<SourceSolid>) =
            (Vec::new(), Vec::new());
        for child in &body.children {
            match child.tag.as_str() {
                "body" => node
                    .children
                    .push(self.node(child, &pose, class, depth + 1)?),
                // A frame moves its children and is no body.
                "frame" => {
                    let frame = self.node(child, &pose, class, depth + 1)?;
                    node.solids.extend(frame.solids);
                    node.children.extend(frame.children);
                }
                "geom" if body.tag != "worldbody" => {
                    if let Some((solid, is_visual)) = self.geom(child, &pose, class)? {
                        if is_visual {
                            seen.push(solid)
                        } else {
                            collide.push(solid)
                        }
                    }
                }
                "joint" => {
                    let named = [child.name(), node.name.as_str()];
                    let named = named.into_iter().find(|name| !name.is_empty());
                    let body = self.notes.about(named.unwrap_or_default());
                    let joint = self.joint(child, &pose, class)?;
                    match (&node.joint, joint) {
                        (None, joint) => node.joint = joint,
                        (Some(_), Some(_)) => self
                            .notes
                            .left_out("joint: a second one of a body, kept closed"),
                        _ => {}
                    }
                    self.notes.about(&body);
                    child.name().clone_into(&mut node.joint_name);
                }
                "freejoint" => self
                    .notes
                    .left_out("joint: of the whole piece, which stays where it stands"),
                "site" | "light" | "camera" | "inertial" | "geom" => {}
                other => {
                    let shown: String = other.chars().take(40).collect();
                    self.notes.left_out(format!("element <{shown}> of a body"));
                }
            }
        }
        node.solids.extend(self.shown(collide, seen));
        if let Some(outer) = outer {
            self.notes.about(&outer);
        }
        Ok(node)
    }

    /// What a body consists of: what collides, in the colours of what is seen.
    fn shown(&mut self, collide: Vec<SourceSolid>, seen: Vec<SourceSolid>) -> Vec<SourceSolid> {
        if collide.is_empty() {
            return seen;
        }
        let rough = |solids: &[SourceSolid]| solids.iter().filter(|solid| solid.is_bounds).count();
        let is_finer = rough(&seen) < rough(&collide);
        if !seen.is_empty() && (is_finer || !fills(&collide, &seen)) {
            return seen;
        }
        seen.iter().for_each(|_| {
            self.notes
                .approximated("geom that does not collide: those that do stand for it")
        });
        let color = seen
            .iter()
            .find(|solid| solid.is_coloured)
            .map(|solid| solid.primitive.color);
        collide
            .into_iter()
            .map(|mut solid| {
                if let Some(color) = color {
                    solid.primitive.color = color;
                    solid.is_coloured = true;
                }
                solid
            })
            .collect()
    }

    fn joint(
        &mut self,
        joint: &Element,
        pose: &Affine,
        class: Option<&str>,
    ) -> Result<Option<Joint>, ImportError> {
        let get = |name: &str| self.defaults.get(joint, class, name);
        let axis = match get("axis") {
            Some(text) => joint.numbers_in("axis", &text)?,
            None => [0.0, 0.0, 1.0],
        };
        let axis =
            unit(pose.direction(axis)).ok_or_else(|| joint.error("its axis has no direction"))?;
        let at = match get("pos") {
            Some(text) => joint.numbers_in("pos", &text)?,
            None => [0.0; 3],
        };
        let limited = get("limited").filter(|limited| limited != "auto");
        let range = get("range");
        if range.is_some() && limited.is_none() && !self.compiler.limits_by_range {
            return Err(joint.error(
                "has a range, but does not say `limited`, which the compiler's autolimits=\"false\" asks for",
            ));
        }
        let is_free = limited.is_some_and(|limited| limited == "false");
        let range: Option<[f64; 2]> = match range.filter(|_| !is_free) {
            Some(text) => Some(joint.numbers_in("range", &text)?),
            None => None,
        };
        let farther = range.map(|[low, high]| if high.abs() >= low.abs() { high } else { low });
        let kind = get("type").unwrap_or_else(|| "hinge".to_owned());
        if farther.is_none() && matches!(kind.as_str(), "slide" | "hinge") {
            self.notes
                .approximated("joint without limits: opens 0.3 m or 90 degrees");
        }
        Ok(match kind.as_str() {
            "slide" => {
                let by = farther.unwrap_or(UNLIMITED.0);
                Some(Joint::Slide {
                    open_by: axis.map(|part| part * by),
                })
            }
            "hinge" => Some(Joint::Hinge {
                position: pose.point(at),
                axis,
                open_deg: farther.map_or(UNLIMITED.1, |angle| {
                    (angle * self.compiler.angle).to_degrees()
                }),
            }),
            "free" => None,
            other => {
                let shown: String = other.chars().take(40).collect();
                self.notes
                    .left_out(format!("joint: of type {shown}, kept closed"));
                None
            }
        })
    }
}

/// Meshes and colours by name.
type Named<T> = BTreeMap<String, T>;
