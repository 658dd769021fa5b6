//! Joints of physics as doors and drawers: which of the two bodies moves, and how.
//!
//! A joint says how its second body moves against its first, not which of them stands still. Here
//! the body stands still that is fixed to the world; else the largest of those that are joined.

use std::collections::BTreeMap;

use reel_tasks::assets::usd::{self, Prim, values};

use super::{JointItem, Walk};
use crate::{
    ImportError,
    affine::{Affine, Bounds, unit},
    house::Joint,
};

/// How far a joint without limits opens: metres and degrees.
const UNLIMITED: (f64, f64) = (0.3, 90.0);

/// A joint as its stage has it.
struct Link {
    path: String,
    prim: Prim,
    kind: LinkKind,
    /// Paths of the first and the second body; `None` is the world.
    bodies: [Option<String>; 2],
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum LinkKind {
    Slide,
    Hinge,
    Fixed,
}

/// Adds the joints of a stage. They come last: the prims they join may stand after them.
pub(super) fn place(walk: &mut Walk) -> Result<(), ImportError> {
    let mut links = Vec::new();
    for prim in std::mem::take(&mut walk.joints) {
        let kind = match walk.known(usd::type_name(&prim))?.as_str() {
            "PhysicsPrismaticJoint" => LinkKind::Slide,
            "PhysicsRevoluteJoint" => LinkKind::Hinge,
            "PhysicsFixedJoint" => LinkKind::Fixed,
            other => {
                let notes = &mut walk.content.notes;
                notes.about(prim.path().as_str());
                notes.left_out(format!("joint: {other}, kept closed"));
                notes.about("");
                continue;
            }
        };
        let bodies = ["physics:body0", "physics:body1"].map(|name| values::target(&prim, name));
        links.push(Link {
            path: prim.path().as_str().to_owned(),
            prim,
            kind,
            bodies,
        });
    }
    let distances = distances(walk, &links);
    for link in links {
        if link.kind == LinkKind::Fixed {
            continue;
        }
        // Farther from what stands still is what moves.
        let away = |body: &Option<String>| match body {
            Some(body) => distances.get(body).copied().unwrap_or(usize::MAX),
            None => 0,
        };
        let is_second = away(&link.bodies[1]) >= away(&link.bodies[0]);
        let moves = link.bodies[usize::from(is_second)].clone();
        let joint = moves.and_then(|moves| Some((moves, joint(walk, &link, is_second)?)));
        let Some((moves, joint)) = joint else {
            let notes = &mut walk.content.notes;
            notes.about(&link.path);
            notes.left_out("joint: its bodies or axis are not in the stage, kept closed");
            notes.about("");
            continue;
        };
        let path = link.path;
        walk.content.joints.push(JointItem { path, moves, joint });
    }
    Ok(())
}

/// How many joints lie between each body and what stands still of those joined with it.
fn distances(walk: &Walk, links: &[Link]) -> BTreeMap<String, usize> {
    let mut bodies: BTreeMap<&str, usize> = BTreeMap::new();
    for body in links.iter().flat_map(|link| link.bodies.iter().flatten()) {
        let next = bodies.len();
        bodies.entry(body).or_insert(next);
    }
    let ends = |link: &Link| {
        link.bodies
            .each_ref()
            .map(|it| Some(bodies[it.as_deref()?]))
    };
    // Bodies that are fixed to each other are one, called by the least of their numbers.
    let mut rigid: Vec<usize> = (0..bodies.len()).collect();
    for link in links.iter().filter(|link| link.kind == LinkKind::Fixed) {
        if let [Some(first), Some(second)] = ends(link) {
            let (kept, gone) = (
                rigid[first].min(rigid[second]),
                rigid[first].max(rigid[second]),
            );
            rigid
                .iter_mut()
                .filter(|it| **it == gone)
                .for_each(|it| *it = kept);
        }
    }
    let joined: Vec<[usize; 2]> = links
        .iter()
        .filter_map(|link| match ends(link) {
            [Some(first), Some(second)] => Some([rigid[first], rigid[second]]),
            _ => None,
        })
        .collect();
    // Fixed to the world, and the size of what is below it in the stage: the first is the most likely root.
    let mut likely = vec![(false, 0.0_f64); bodies.len()];
    for (path, number) in &bodies {
        likely[rigid[*number]].1 += volume(walk, path);
    }
    for link in links {
        // A slide or hinge on the world moves; only what is fixed to it stands.
        if link.kind == LinkKind::Fixed
            && let [Some(body), None] | [None, Some(body)] = ends(link)
        {
            likely[rigid[body]].0 = true;
        }
    }
    let mut roots: Vec<usize> = (0..bodies.len()).filter(|it| rigid[*it] == *it).collect();
    roots.sort_by(|a, b| {
        let order = likely[*b].0.cmp(&likely[*a].0);
        order.then(likely[*b].1.total_cmp(&likely[*a].1))
    });
    let mut distance: Vec<Option<usize>> = vec![None; bodies.len()];
    for root in roots {
        if distance[root].is_some() {
            continue;
        }
        distance[root] = Some(0);
        let mut reached = vec![root];
        let mut next = 0;
        while let Some(body) = reached.get(next).copied() {
            next += 1;
            let beside = joined.iter().filter_map(|ends| match *ends {
                [first, second] if first == body => Some(second),
                [first, second] if second == body => Some(first),
                _ => None,
            });
            for other in beside {
                if distance[other].is_none() {
                    distance[other] = distance[body].map(|far| far + 1);
                    reached.push(other);
                }
            }
        }
    }
    let far = |number: usize| distance[rigid[number]].unwrap_or_default();
    bodies
        .into_iter()
        .map(|(path, number)| (path.to_owned(), far(number)))
        .collect()
}

/// Volume of the box around all solids at or below a prim.
fn volume(walk: &Walk, path: &str) -> f64 {
    let below = |shape: &str| {
        let rest = shape.strip_prefix(path);
        rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
    };
    let shapes = walk.content.shapes.iter();
    let solids = shapes.filter(|shape| below(&shape.path));
    Bounds::of_all(solids.map(|shape| &shape.solid.primitive))
        .map_or(0.0, |bounds| bounds.half().iter().product())
}

/// How the moving body moves; against what a joint says where that is the first one.
fn joint(walk: &mut Walk, link: &Link, is_second: bool) -> Option<Joint> {
    let prim = &link.prim;
    let frame_of = |path: &str| {
        let found = walk.placed.iter().find(|(placed, _)| placed == path);
        found.map(|(_, frame)| *frame)
    };
    let bodies = link.bodies.each_ref();
    let [first, second] = bodies.map(|body| frame_of(body.as_deref()?));
    // The frame of the joint on a body; one is enough, as both agree while it is closed.
    let (body, at, turn) = match (first, second) {
        (Some(frame), _) => (frame, "physics:localPos0", "physics:localRot0"),
        (None, Some(frame)) => (frame, "physics:localPos1", "physics:localRot1"),
        (None, None) => return None,
    };
    let local = values::numbers::<3>(prim, at).unwrap_or_default();
    let turn = values::numbers::<4>(prim, turn).map_or(Affine::IDENTITY, Affine::of_quaternion);
    let frame = body.after(&Affine::translation(local)).after(&turn);
    let axis = match values::token(prim, "physics:axis").as_deref() {
        Some("Y") => 1,
        Some("Z") => 2,
        _ => 0,
    };
    let limit = |name: &str| values::numbers::<1>(prim, name).map(|[value]| value);
    let limits = [limit("physics:lowerLimit"), limit("physics:upperLimit")];
    let farther = match limits {
        [Some(low), Some(high)] => Some(if high.abs() >= low.abs() { high } else { low }),
        [low, high] => high.or(low),
    };
    if farther.is_none() {
        let notes = &mut walk.content.notes;
        notes.about(&link.path);
        notes.approximated("joint without limits: opens 0.3 m or 90 degrees");
        notes.about("");
    }
    let sense = if is_second { 1.0 } else { -1.0 };
    let axis = frame.axes[axis];
    Some(if link.kind == LinkKind::Slide {
        // Limits are in the stage's units, the axis is as long as one of them.
        let open_by = match farther {
            Some(distance) => axis.map(|part| sense * part * distance),
            None => unit(axis)?.map(|part| sense * part * UNLIMITED.0),
        };
        Joint::Slide { open_by }
    } else {
        Joint::Hinge {
            position: frame.origin,
            axis: unit(axis)?,
            open_deg: sense * farther.unwrap_or(UNLIMITED.1),
        }
    })
}
