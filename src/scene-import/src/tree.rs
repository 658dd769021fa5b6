//! Bodies on joints, as URDF and MJCF have them, and the furniture among them.

use crate::{
    categories,
    house::{Body, Joint, Moving, Piece, Solids, SourceSolid},
    notes::Notes,
};

/// A body or link with its solids in the frame of the file, all joints closed.
#[derive(Clone, PartialEq, Debug, Default)]
pub(crate) struct Node {
    pub(crate) name: String,
    pub(crate) solids: Vec<SourceSolid>,
    /// How it moves against its parent; `None` where it does not.
    pub(crate) joint: Option<Joint>,
    pub(crate) joint_name: String,
    pub(crate) children: Vec<Node>,
}

impl Node {
    fn has_joints(&self) -> bool {
        self.children
            .iter()
            .any(|child| child.joint.is_some() || child.has_joints())
    }

    fn has_solids(&self) -> bool {
        !self.solids.is_empty() || self.children.iter().any(Node::has_solids)
    }

    /// Whether it only holds others together.
    fn is_group(&self) -> bool {
        self.solids.is_empty()
            && !self.children.is_empty()
            && self.children.iter().all(|child| child.joint.is_none())
    }
}

/// The furniture among bodies. `model` is the name of the whole file: of a file with one body,
/// that says what it is if the body does not.
pub(crate) fn pieces(roots: Vec<Node>, model: &str, notes: &mut Notes) -> Vec<Piece> {
    let mut candidates = Vec::new();
    for root in roots {
        candidates_of(root, &mut candidates);
    }
    candidates.retain(Node::has_solids);
    let is_alone = candidates.len() == 1;
    let mut pieces = Vec::new();
    for node in candidates {
        notes.about(&node.name);
        if node.joint.is_some() {
            notes.left_out("joint: of the whole piece, which stays where it stands");
        }
        let of_model = || is_alone.then(|| categories::furniture(model)).flatten();
        let category = categories::furniture(&node.name).or_else(of_model);
        let guessed = || {
            (node.has_joints())
                .then_some("cabinet")
                .or(is_alone.then_some("table"))
        };
        let category = match category.or_else(|| {
            let guess = guessed()?;
            notes.approximated(format!(
                "furniture whose name says no category: taken for a {guess}"
            ));
            Some(guess)
        }) {
            Some(category) => category,
            None => {
                let kind = categories::kind_of(&node.name);
                notes.left_out(format!("not furniture to put objects on: {kind}"));
                continue;
            }
        };
        pieces.push(Piece {
            source: node.name.clone(),
            category: category.to_owned(),
            body: Body::Solids(solids(node, notes)),
        });
    }
    notes.about("");
    pieces
}

fn candidates_of(node: Node, found: &mut Vec<Node>) {
    if node.is_group() && categories::furniture(&node.name).is_none() {
        for child in node.children {
            candidates_of(child, found);
        }
    } else {
        found.push(node);
    }
}

fn solids(node: Node, notes: &mut Notes) -> Solids {
    let mut solids = Solids {
        fixed: node.solids,
        moving: Vec::new(),
    };
    for child in node.children {
        add(child, &mut solids, notes);
    }
    solids
}

fn add(node: Node, solids: &mut Solids, notes: &mut Notes) {
    match node.joint {
        None => {
            solids.fixed.extend(node.solids);
            for child in node.children {
                add(child, solids, notes);
            }
        }
        Some(joint) => {
            let source = node.joint_name.clone();
            let mut moving = Vec::new();
            gather(node, &mut moving, notes);
            if !moving.is_empty() {
                solids.moving.push(Moving {
                    source,
                    solids: moving,
                    joint,
                });
            }
        }
    }
}

/// The solids of a moving body and all that hangs on it.
fn gather(node: Node, found: &mut Vec<SourceSolid>, notes: &mut Notes) {
    found.extend(node.solids);
    for child in node.children {
        if child.joint.is_some() {
            notes.left_out("joint: on a part that moves itself, kept closed");
        }
        gather(child, found, notes);
    }
}
