//! Owns the geometry of the diagram: which nodes and ribbons there are, in which order, how tall,
//! where. A pure function of the flows. Never draws and never writes labels.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use super::Flow;
use super::palette::{CLASSES, Color, FAMILY, class_color, tint};
use super::text::clean;

/// Nodes in three columns and the ribbons between them. All lengths in units of the scene; y from
/// the top of the chart, downwards.
pub struct Layout {
    pub families: Vec<Node>,
    pub classes: Vec<Node>,
    /// In the order of their classes.
    pub sub_classes: Vec<Node>,
    /// From families to classes.
    pub into_classes: Vec<Ribbon>,
    /// From classes to sub-classes.
    pub into_sub_classes: Vec<Ribbon>,
    /// Height of the whole chart, in units of the scene.
    pub height: f64,
    /// Episodes in all flows.
    pub episodes: u64,
}

/// A family, class or sub-class.
pub struct Node {
    pub name: String,
    pub episodes: u64,
    pub color: Color,
    pub y: f64,
    pub height: f64,
}

/// Episodes that two nodes share.
pub struct Ribbon {
    /// Indexes into the columns at its left and at its right.
    pub ends: [usize; 2],
    pub episodes: u64,
    /// Those of each family, by index; one only where it comes from a family.
    pub of_family: Vec<(usize, u64)>,
    pub color: Color,
    /// Where it begins at the left and at the right node: not quite equally tall where a thin
    /// one was made visible.
    pub spans: [Span; 2],
}

/// A piece of a node's edge.
#[derive(Clone, Copy, Default)]
pub struct Span {
    pub y: f64,
    pub height: f64,
}

/// The families of the benchmark in their order.
const FAMILIES: [&str; 4] = ["FDP", "FODP", "FDO", "SUL"];
/// Height of all episodes together, before anything small is made visible.
const EPISODES_HEIGHT: f64 = 380.0;
/// The least that is visible.
const NODE_HEIGHT_MIN: f64 = 3.0;
const RIBBON_HEIGHT_MIN: f64 = 1.5;
/// Room for a label of two lines, of one line.
pub const TWO_LINES: f64 = 42.0;
pub const ONE_LINE: f64 = 20.0;
const FAMILY_GAP: [f64; 2] = [18.0, 72.0];
const CLASS_GAP: f64 = 24.0;
const SUB_CLASS_GAP: f64 = 5.0;
/// How many names a column shows before the smallest are drawn together.
const NAMES_MAX: [usize; 3] = [12, 12, 60];
/// What follows the number of names that are drawn together, the last of their column or class.
const REST: &str = " more";

impl Layout {
    /// Lays out flows. Families and classes of the benchmark keep its order, others follow by size;
    /// sub-classes go by size within their class. As the classes are in the order of their
    /// sub-classes, no ribbons cross at the right.
    pub fn of(flows: &[Flow]) -> Self {
        let tally = fold(&tally(flows));
        let known_classes = CLASSES.map(|(name, _)| name);
        let families = ordered(sums(&tally, |[family, ..]| family.clone()), |name| {
            rank_in(&FAMILIES, name)
        });
        let classes = ordered(sums(&tally, |[_, class, _]| class.clone()), |name| {
            rank_in(&known_classes, name)
        });
        let class_index: BTreeMap<&str, usize> = classes
            .iter()
            .enumerate()
            .map(|(i, (name, _))| (name.as_str(), i))
            .collect();
        let sub_classes = ordered(
            sums(&tally, |[_, class, sub]| (class.clone(), sub.clone())),
            |(class, name)| (class_index[class.as_str()], is_rest(name)),
        );

        let family_index: BTreeMap<&str, usize> = families
            .iter()
            .enumerate()
            .map(|(i, (name, _))| (name.as_str(), i))
            .collect();
        let sub_index: BTreeMap<&(String, String), usize> = sub_classes
            .iter()
            .enumerate()
            .map(|(i, (name, _))| (name, i))
            .collect();
        let mut left: BTreeMap<[usize; 2], Vec<(usize, u64)>> = BTreeMap::new();
        let mut right = left.clone();
        for ([family, class, sub], &episodes) in &tally {
            let (family, class_at) = (family_index[family.as_str()], class_index[class.as_str()]);
            let sub = sub_index[&(class.clone(), sub.clone())];
            left.entry([family, class_at])
                .or_default()
                .push((family, episodes));
            right
                .entry([class_at, sub])
                .or_default()
                .push((family, episodes));
        }

        let class_node =
            |(name, episodes): (String, u64)| Node::new(class_color(&name), name, episodes);
        let mut layout = Self {
            episodes: add(tally.values()),
            families: families
                .iter()
                .map(|(name, episodes)| Node::new(FAMILY, name.clone(), *episodes))
                .collect(),
            classes: classes.iter().cloned().map(class_node).collect(),
            sub_classes: Vec::new(),
            into_classes: Vec::new(),
            into_sub_classes: Vec::new(),
            height: 0.0,
        };
        let mut rank = BTreeMap::new();
        for ((class, name), episodes) in &sub_classes {
            let rank = rank.entry(class).and_modify(|rank| *rank += 1).or_insert(0);
            layout.sub_classes.push(Node::new(
                tint(class_color(class), *rank),
                name.clone(),
                *episodes,
            ));
        }
        layout.into_classes = left
            .into_iter()
            .map(|(ends, of)| Ribbon::new(ends, of, layout.classes[ends[1]].color))
            .collect();
        layout.into_sub_classes = right
            .into_iter()
            .map(|(ends, of)| Ribbon::new(ends, of, layout.sub_classes[ends[1]].color))
            .collect();
        layout.set_heights();
        layout.set_places();
        attach(&mut layout.into_classes, &layout.families, &layout.classes);
        attach(
            &mut layout.into_sub_classes,
            &layout.classes,
            &layout.sub_classes,
        );
        layout
    }

    /// Nodes are as tall as their episodes, but never too small to be seen, nor too
    /// small for their ribbons.
    fn set_heights(&mut self) {
        let unit = EPISODES_HEIGHT / self.episodes.max(1) as f64;
        let columns = [&mut self.families, &mut self.classes, &mut self.sub_classes];
        for (column, nodes) in columns.into_iter().enumerate() {
            for (index, node) in nodes.iter_mut().enumerate() {
                // Ribbons end at this node in the ribbons before its column, and begin
                // in those after it.
                let ends_here = |ribbons: &[Ribbon], end: usize| {
                    ribbons.iter().filter(|r| r.ends[end] == index).count()
                };
                let ribbons = match column {
                    0 => ends_here(&self.into_classes, 0),
                    1 => ends_here(&self.into_classes, 1).max(ends_here(&self.into_sub_classes, 0)),
                    _ => 1,
                };
                let least = NODE_HEIGHT_MIN.max(RIBBON_HEIGHT_MIN * ribbons as f64);
                node.height = (node.episodes as f64 * unit).max(least);
            }
        }
    }

    /// Every node gets a slot in which its label fits too, so that labels cannot overlap. A class
    /// and its sub-classes share a band and are centred in it.
    fn set_places(&mut self) {
        let mut bands: Vec<(f64, Vec<usize>)> = self
            .classes
            .iter()
            .map(|class| (class.height.max(TWO_LINES), Vec::new()))
            .collect();
        for ribbon in &self.into_sub_classes {
            bands[ribbon.ends[0]].1.push(ribbon.ends[1]);
        }
        for (height, members) in &mut bands {
            *height = height.max(stack_height(
                members.iter().map(|&member| &self.sub_classes[member]),
                ONE_LINE,
                SUB_CLASS_GAP,
            ));
        }
        let gaps = |count: usize| count.saturating_sub(1) as f64;
        let classes_height =
            bands.iter().map(|(height, _)| height).sum::<f64>() + CLASS_GAP * gaps(bands.len());
        let families_height = stack_height(self.families.iter(), TWO_LINES, FAMILY_GAP[0]);
        self.height = classes_height.max(families_height);

        let mut y = (self.height - classes_height) / 2.0;
        for (class, (height, members)) in self.classes.iter_mut().zip(&bands) {
            class.y = y + (height - class.height) / 2.0;
            let stack = stack_height(
                members.iter().map(|&member| &self.sub_classes[member]),
                ONE_LINE,
                SUB_CLASS_GAP,
            );
            let mut top = y + (height - stack) / 2.0;
            for &member in members {
                top = self.sub_classes[member].put(top, ONE_LINE) + SUB_CLASS_GAP;
            }
            y += height + CLASS_GAP;
        }

        let spare = self.height - families_height;
        let gap = (FAMILY_GAP[0] + spare / gaps(self.families.len()).max(1.0)).min(FAMILY_GAP[1]);
        let mut top = (self.height - stack_height(self.families.iter(), TWO_LINES, gap)) / 2.0;
        for family in &mut self.families {
            top = family.put(top, TWO_LINES) + gap;
        }
    }
}

impl Node {
    fn new(color: Color, name: String, episodes: u64) -> Self {
        Self {
            name,
            episodes,
            color,
            y: 0.0,
            height: 0.0,
        }
    }

    /// Height of the node's middle.
    pub fn middle(&self) -> f64 {
        self.y + self.height / 2.0
    }

    /// Centres the node in a slot that begins at `top`; the slot's end.
    fn put(&mut self, top: f64, label_height: f64) -> f64 {
        let slot = self.height.max(label_height);
        self.y = top + (slot - self.height) / 2.0;
        top + slot
    }
}

impl Ribbon {
    fn new(ends: [usize; 2], of_family: Vec<(usize, u64)>, color: Color) -> Self {
        let mut by_family = BTreeMap::new();
        for (family, episodes) in of_family {
            let sum: &mut u64 = by_family.entry(family).or_default();
            *sum = sum.saturating_add(episodes);
        }
        Self {
            ends,
            episodes: add(by_family.values()),
            of_family: by_family.into_iter().collect(),
            color,
            spans: Default::default(),
        }
    }
}

/// Family, class and sub-class of a flow, cleaned for display.
type Names = [String; 3];

fn tally(flows: &[Flow]) -> BTreeMap<Names, u64> {
    let mut tally = BTreeMap::new();
    for flow in flows.iter().filter(|flow| flow.episodes > 0) {
        let sum: &mut u64 = tally
            .entry([
                clean(&flow.family),
                clean(&flow.class),
                clean(&flow.sub_class),
            ])
            .or_default();
        *sum = sum.saturating_add(flow.episodes);
    }
    tally
}

/// Draws the smallest names of a column together where there are too many of them; sub-classes
/// only within a class.
fn fold(tally: &BTreeMap<Names, u64>) -> BTreeMap<Names, u64> {
    let mut tally = tally.clone();
    for (column, &names_max) in NAMES_MAX.iter().enumerate() {
        let key = |names: &Names| {
            if column == 2 {
                [names[1].clone(), names[2].clone()]
            } else {
                [String::new(), names[column].clone()]
            }
        };
        let by_size = ordered(sums(&tally, key), |_| ());
        if by_size.len() <= names_max {
            continue;
        }
        let small: BTreeSet<_> = by_size[names_max - 1..]
            .iter()
            .map(|(key, _)| key)
            .collect();
        let mut together: BTreeMap<&str, usize> = BTreeMap::new();
        for [within, _] in &small {
            *together.entry(within).or_default() += 1;
        }
        let mut folded = BTreeMap::new();
        for (mut names, episodes) in tally {
            let this = key(&names);
            if small.contains(&this) {
                names[column] = format!("{}{REST}", together[this[0].as_str()]);
            }
            let sum: &mut u64 = folded.entry(names).or_default();
            *sum = sum.saturating_add(episodes);
        }
        tally = folded;
    }
    tally
}

fn sums<K: Ord>(tally: &BTreeMap<Names, u64>, key: impl Fn(&Names) -> K) -> BTreeMap<K, u64> {
    let mut sums = BTreeMap::new();
    for (names, episodes) in tally {
        let sum: &mut u64 = sums.entry(key(names)).or_default();
        *sum = sum.saturating_add(*episodes);
    }
    sums
}

/// By rank, then the largest first, then by name.
fn ordered<K: Ord + Clone, R: Ord>(
    sums: BTreeMap<K, u64>,
    rank: impl Fn(&K) -> R,
) -> Vec<(K, u64)> {
    let mut sums: Vec<(K, u64)> = sums.into_iter().collect();
    sums.sort_by_key(|(key, episodes)| (rank(key), Reverse(*episodes), key.clone()));
    sums
}

/// The place of a known name; the others come behind those, the rest behind all.
fn rank_in(known: &[&str], name: &str) -> (usize, bool) {
    (
        known
            .iter()
            .position(|other| *other == name)
            .unwrap_or(known.len()),
        is_rest(name),
    )
}

fn is_rest(name: &str) -> bool {
    name.strip_suffix(REST)
        .is_some_and(|number| number.parse::<usize>().is_ok())
}

fn add<'a>(numbers: impl IntoIterator<Item = &'a u64>) -> u64 {
    numbers
        .into_iter()
        .fold(0, |sum: u64, number| sum.saturating_add(*number))
}

fn stack_height<'a>(
    nodes: impl ExactSizeIterator<Item = &'a Node>,
    label_height: f64,
    gap: f64,
) -> f64 {
    let gaps = nodes.len().saturating_sub(1) as f64 * gap;
    nodes.map(|node| node.height.max(label_height)).sum::<f64>() + gaps
}

/// Gives every ribbon its piece of both its nodes; at each node they lie in the order
/// of their other ends.
fn attach(ribbons: &mut [Ribbon], left: &[Node], right: &[Node]) {
    for (end, nodes) in [left, right].into_iter().enumerate() {
        for (index, node) in nodes.iter().enumerate() {
            let mut here: Vec<&mut Ribbon> = ribbons
                .iter_mut()
                .filter(|ribbon| ribbon.ends[end] == index)
                .collect();
            here.sort_by_key(|ribbon| ribbon.ends[1 - end]);
            let episodes: Vec<u64> = here.iter().map(|ribbon| ribbon.episodes).collect();
            let mut y = node.y;
            for (ribbon, height) in here.into_iter().zip(divide(node.height, &episodes)) {
                ribbon.spans[end] = Span { y, height };
                y += height;
            }
        }
    }
}

/// Divides a height in proportion, but for parts that would be invisible: what those get more
/// the others have less.
fn divide(height: f64, parts: &[u64]) -> Vec<f64> {
    let sum: f64 = parts.iter().map(|&part| part as f64).sum();
    let wished: Vec<f64> = parts
        .iter()
        .map(|&part| (height * part as f64 / sum).max(RIBBON_HEIGHT_MIN))
        .collect();
    let least = RIBBON_HEIGHT_MIN * parts.len() as f64;
    let surplus = wished.iter().sum::<f64>() - least;
    if surplus <= 0.0 {
        return vec![height / parts.len() as f64; parts.len()];
    }
    wished
        .iter()
        .map(|wish| RIBBON_HEIGHT_MIN + (wish - RIBBON_HEIGHT_MIN) * (height - least) / surplus)
        .collect()
}
