//! From words to paint: colour, material and pattern words of captions and attributes, and stable
//! choices by identifier where the words say nothing. Never builds shapes.

use std::collections::{BTreeMap, BTreeSet};

use reel_world::{Digest, ObjectInstance, Receptacle};

use crate::geometry::Pattern;

/// Colour and pattern of a part.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Paint {
    pub(super) color: [u8; 3],
    pub(super) accent: [u8; 3],
    pub(super) pattern: Pattern,
}

impl Paint {
    /// Paint of one sRGB colour without a pattern.
    pub(super) const fn plain(color: [u8; 3]) -> Self {
        Self {
            color,
            accent: color,
            pattern: Pattern::Plain,
        }
    }

    /// Wood of a colour.
    pub(super) fn grain(color: [u8; 3]) -> Self {
        Self {
            color,
            accent: shade(color, 0.78),
            pattern: Pattern::Grain,
        }
    }

    /// Polished in a colour.
    pub(super) fn glossy(color: [u8; 3]) -> Self {
        Self {
            color,
            accent: tint(color, 0.5),
            pattern: Pattern::Glossy,
        }
    }

    /// The same, darker (below 1) or lighter (above 1).
    pub(super) fn shaded(self, factor: f32) -> Self {
        Self {
            color: shade(self.color, factor),
            accent: shade(self.accent, factor),
            ..self
        }
    }

    /// The second colour, plain.
    pub(super) fn second(self) -> Self {
        Self::plain(self.accent)
    }
}

/// A stable number below `count` for an identifier; `purpose` keeps choices apart.
pub(super) fn pick(id: &str, purpose: &str, count: usize) -> usize {
    let digest = Digest::of(format!("{purpose}:{id}").as_bytes());
    let number = u32::from_le_bytes([digest.0[0], digest.0[1], digest.0[2], digest.0[3]]);
    number as usize % count
}

/// Lower-case words of a text.
pub(super) fn words(text: &str) -> Vec<String> {
    let parts = text.split(|letter: char| !letter.is_alphanumeric());
    parts
        .filter(|word| !word.is_empty())
        .map(str::to_lowercase)
        .collect()
}

/// A part of a piece of furniture that words speak of.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(super) enum Feature {
    Body,
    Handles,
    Bedding,
    Pillows,
    Top,
    Legs,
    Detail,
}

/// What captions and attributes say of a piece of furniture.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Traits {
    id: String,
    said: BTreeMap<Feature, Vec<String>>,
    all: BTreeSet<String>,
}

impl Traits {
    /// Reads attributes, then captions (those that people use most first).
    pub(super) fn of(receptacle: &Receptacle) -> Self {
        let mut traits = Self {
            id: receptacle.id.to_string(),
            said: BTreeMap::new(),
            all: BTreeSet::new(),
        };
        for (kind, values) in &receptacle.attributes {
            let feature = words(kind)
                .iter()
                .find_map(|word| feature_of(word))
                .unwrap_or(Feature::Body);
            for value in values {
                let said = words(value);
                traits.all.extend(said.iter().cloned());
                traits.said.entry(feature).or_default().extend(said);
            }
        }
        let mut captions: Vec<(&String, f64)> = receptacle
            .captions
            .iter()
            .map(|(text, weight)| (text, *weight))
            .collect();
        captions.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(b.0)));
        for (caption, _) in captions {
            traits.read(caption);
        }
        traits
    }

    /// Whether any of the words was said.
    pub(super) fn has(&self, any: &[&str]) -> bool {
        any.iter().any(|word| self.all.contains(*word))
    }

    /// How a feature looks, if the words say it.
    pub(super) fn paint(&self, feature: Feature) -> Option<Paint> {
        self.said.get(&feature).and_then(|said| paint(said))
    }

    /// How a feature looks; a stable choice of a palette where the words do not say.
    pub(super) fn paint_or(&self, feature: Feature, palette: &[Paint]) -> Paint {
        self.paint(feature)
            .unwrap_or_else(|| palette[self.choose(&format!("{feature:?}"), palette.len())])
    }

    /// A stable number below `count`; pieces numbered one after the other differ.
    pub(super) fn choose(&self, purpose: &str, count: usize) -> usize {
        let kind = self
            .id
            .trim_end_matches(|letter: char| letter.is_ascii_digit());
        match self.id[kind.len()..].parse::<usize>() {
            Ok(number) => (pick(kind, purpose, count) + number % count) % count,
            Err(_) => pick(&self.id, purpose, count),
        }
    }

    /// Colours belong to the noun after them; without a known noun to the body, behind
    /// a "with" to nothing.
    fn read(&mut self, caption: &str) {
        let mut waiting: Vec<String> = Vec::new();
        let mut on_body = true;
        let mut rest = words(caption).into_iter().peekable();
        while let Some(word) = rest.next() {
            if ELSEWHERE.contains(&word.as_str()) {
                break;
            }
            self.all.insert(word.clone());
            if let Some(feature) = feature_of(&word) {
                // Of two nouns in a row the last counts: a bed runner is a runner.
                if rest.peek().is_some_and(|next| feature_of(next).is_some()) {
                    continue;
                }
                self.said.entry(feature).or_default().append(&mut waiting);
            } else if word == "with" {
                if on_body {
                    self.said
                        .entry(Feature::Body)
                        .or_default()
                        .append(&mut waiting);
                }
                waiting.clear();
                on_body = false;
            } else {
                waiting.push(word);
            }
        }
        if on_body {
            self.said
                .entry(Feature::Body)
                .or_default()
                .append(&mut waiting);
        }
    }
}

/// Behind these words a caption speaks of something else.
const ELSEWHERE: [&str; 10] = [
    "next", "near", "front", "where", "for", "beside", "on", "by", "under", "than",
];

fn feature_of(word: &str) -> Option<Feature> {
    Some(match word {
        "handle" | "handles" | "knob" | "knobs" | "pull" | "pulls" => Feature::Handles,
        "bedding" | "sheet" | "sheets" | "cover" | "runner" | "blanket" | "duvet" | "quilt"
        | "mattress" | "cushion" | "cushions" | "bedspread" | "upholstery" => Feature::Bedding,
        "pillow" | "pillows" => Feature::Pillows,
        "top" | "tabletop" | "countertop" | "surface" => Feature::Top,
        "leg" | "legs" | "feet" | "base" => Feature::Legs,
        "backing" | "back" | "insert" | "grill" | "grille" | "cube" | "drawers" | "trim"
        | "edge" | "basin" | "stripe" | "panel" => Feature::Detail,
        "unit" | "desk" | "table" | "cabinet" | "bed" | "couch" | "sofa" | "nightstand"
        | "dresser" | "shelf" | "counter" | "sink" | "bench" | "stool" | "fridge"
        | "refrigerator" | "microwave" | "body" | "frame" | "colour" | "color" | "material"
        | "finish" => Feature::Body,
        _ => return None,
    })
}

/// How an object looks: by its attributes, then its caption, then its category, then its asset.
pub(super) fn object_paint(object: &ObjectInstance) -> Paint {
    let caption = words(object.caption.as_deref().unwrap_or_default());
    let attribute = |kinds: &[&str]| -> Vec<String> {
        let found = object
            .attributes
            .iter()
            .filter(|(kind, _)| kinds.contains(&kind.as_str()));
        found
            .flat_map(|(_, values)| values.iter().flat_map(|value| words(value)))
            .collect()
    };
    // Attribute lists need not name the main colour first; a caption does.
    let mut colors = attribute(&["colour", "color"]);
    colors.sort_by_key(|word| {
        caption
            .iter()
            .position(|said| said == word)
            .unwrap_or(usize::MAX)
    });
    let rest = attribute(&["material", "pattern", "finish", "texture"]);
    let said: Vec<String> = if colors.iter().any(|word| color(word).is_some()) {
        let hints = caption
            .iter()
            .filter(|word| color(word).is_none() && material(word).is_none());
        colors
            .into_iter()
            .chain(rest)
            .chain(hints.cloned())
            .collect()
    } else {
        rest.into_iter().chain(caption).collect()
    };
    let typical = words(&object.category)
        .iter()
        .rev()
        .find_map(|word| typical_color(word));
    let by_asset = OBJECT_PALETTE[pick(object.asset.as_str(), "colour", OBJECT_PALETTE.len())];
    match (paint(&said), typical) {
        (Some(paint), _) => paint,
        (None, Some([color, accent])) => Paint {
            color,
            accent,
            pattern: pattern_of(&said).unwrap_or_default(),
        },
        (None, None) => Paint {
            color: by_asset,
            accent: shade(by_asset, 0.6),
            pattern: pattern_of(&said).unwrap_or_default(),
        },
    }
}

/// Colour and pattern said by words in their order; none where no word has a colour.
fn paint(said: &[String]) -> Option<Paint> {
    let mut named: Vec<[u8; 3]> = Vec::new();
    let mut of_material: Vec<[u8; 3]> = Vec::new();
    let mut factor = None;
    for word in said {
        match word.as_str() {
            "dark" | "deep" => factor = Some(0.62),
            "light" | "pale" | "soft" | "pastel" => factor = Some(1.3),
            "bright" | "vibrant" | "vivid" => factor = None,
            _ => {
                let list = if color(word).is_some() {
                    &mut named
                } else {
                    &mut of_material
                };
                if let Some(found) =
                    color(word).or_else(|| material(word).and_then(|(color, _)| color))
                {
                    let found = factor.take().map_or(found, |factor| shade(found, factor));
                    if !list.contains(&found) {
                        list.push(found);
                    }
                }
            }
        }
    }
    let alone = factor.filter(|_| said.len() < 8).map(|factor| {
        if factor < 1.0 {
            [62, 57, 54]
        } else {
            [226, 218, 204]
        }
    });
    let mut colors = named.into_iter().chain(of_material).chain(alone);
    let color = colors.next()?;
    let pattern = pattern_of(said).unwrap_or_default();
    let second = colors.next();
    let accent = match pattern {
        // On one material a second colour is lettering or a detail, not the other half of it.
        Pattern::Grain => second
            .filter(|_| said.iter().any(|word| word == "striped"))
            .unwrap_or(shade(color, 0.78)),
        _ => second.unwrap_or(shade(color, if is_dark(color) { 1.8 } else { 0.72 })),
    };
    Some(Paint {
        color,
        accent,
        pattern,
    })
}

fn pattern_of(said: &[String]) -> Option<Pattern> {
    let any = |list: &[&str]| said.iter().any(|word| list.contains(&word.as_str()));
    if any(&["striped", "stripes", "checkered", "checked", "plaid"]) {
        return Some(Pattern::Stripes);
    }
    if any(&[
        "dotted",
        "dots",
        "speckled",
        "spotted",
        "spots",
        "sprinkles",
        "terrazzo",
        "floral",
    ]) {
        return Some(Pattern::Dots);
    }
    said.iter()
        .find_map(|word| material(word).and_then(|(_, pattern)| pattern))
}

/// Mixes a colour with black (below 1) or with white (above 1: 2 is white).
fn shade(color: [u8; 3], factor: f32) -> [u8; 3] {
    if factor > 1.0 {
        tint(color, (factor - 1.0).min(1.0))
    } else {
        color.map(|c| (f32::from(c) * factor) as u8)
    }
}

fn tint(color: [u8; 3], share: f32) -> [u8; 3] {
    color.map(|c| (f32::from(c) + (255.0 - f32::from(c)) * share) as u8)
}

fn is_dark([r, g, b]: [u8; 3]) -> bool {
    u32::from(r) + u32::from(g) + u32::from(b) < 180
}

fn color(word: &str) -> Option<[u8; 3]> {
    Some(match word {
        "white" => [240, 240, 236],
        "ivory" => [243, 238, 218],
        "cream" => [244, 232, 200],
        "beige" => [222, 204, 168],
        "tan" => [205, 170, 125],
        "khaki" => [190, 178, 120],
        "brown" => [122, 78, 44],
        "chocolate" => [82, 48, 28],
        "caramel" => [186, 118, 54],
        "black" => [28, 28, 30],
        "charcoal" => [54, 56, 60],
        "gray" | "grey" => [138, 140, 142],
        "silver" => [192, 196, 200],
        "red" => [204, 34, 36],
        "crimson" | "scarlet" => [190, 20, 52],
        "maroon" | "burgundy" => [112, 24, 36],
        "pink" => [240, 150, 178],
        "rose" => [226, 110, 134],
        "magenta" | "fuchsia" => [204, 40, 140],
        "coral" | "salmon" => [248, 126, 100],
        "peach" => [252, 200, 164],
        "orange" => [242, 128, 26],
        "amber" => [240, 170, 30],
        "yellow" => [246, 210, 40],
        "yellowish" => [236, 220, 130],
        "mustard" => [206, 160, 40],
        "gold" | "golden" => [212, 168, 56],
        "bronze" => [150, 108, 58],
        "copper" => [184, 110, 66],
        "brass" => [188, 152, 70],
        "green" => [58, 142, 60],
        "lime" => [152, 206, 52],
        "olive" => [112, 116, 44],
        "mint" => [162, 222, 186],
        "teal" => [20, 124, 126],
        "turquoise" => [54, 196, 190],
        "cyan" | "aqua" => [50, 196, 216],
        "blue" => [42, 94, 190],
        "navy" => [24, 38, 90],
        "indigo" => [64, 48, 140],
        "purple" => [118, 56, 150],
        "violet" => [140, 90, 196],
        "lavender" | "lilac" => [194, 176, 226],
        "transparent" | "clear" => [206, 226, 230],
        _ => return None,
    })
}

/// Typical colour and pattern of a material or finish.
fn material(word: &str) -> Option<(Option<[u8; 3]>, Option<Pattern>)> {
    let (color, pattern) = match word {
        "wood" | "wooden" => (Some([172, 126, 80]), Pattern::Grain),
        "oak" => (Some([192, 152, 102]), Pattern::Grain),
        "walnut" => (Some([96, 66, 46]), Pattern::Grain),
        "pine" | "birch" | "maple" | "bamboo" => (Some([214, 180, 126]), Pattern::Grain),
        "cherry" | "mahogany" => (Some([126, 58, 38]), Pattern::Grain),
        "wicker" | "rattan" | "woven" | "fibers" => (Some([188, 150, 100]), Pattern::Grain),
        "marble" => (Some([228, 227, 224]), Pattern::Grain),
        "granite" | "stone" | "concrete" => (Some([150, 148, 144]), Pattern::Dots),
        "glass" | "crystal" => (Some([196, 220, 224]), Pattern::Glossy),
        "metal" | "metallic" | "steel" | "stainless" | "aluminum" | "aluminium" | "chrome"
        | "iron" => (Some([176, 180, 184]), Pattern::Glossy),
        "ceramic" | "porcelain" => (Some([238, 236, 230]), Pattern::Glossy),
        "clay" | "terracotta" => (Some([184, 108, 74]), Pattern::Plain),
        "leather" => (Some([112, 70, 44]), Pattern::Plain),
        "cardboard" => (Some([186, 146, 100]), Pattern::Plain),
        "paper" => (Some([240, 238, 230]), Pattern::Plain),
        "glossy" | "shiny" | "polished" | "satin" | "silky" | "lacquered" => {
            (None, Pattern::Glossy)
        }
        "grain" => (None, Pattern::Grain),
        _ => return None,
    };
    Some((
        color,
        Some(pattern).filter(|pattern| *pattern != Pattern::Plain),
    ))
}

/// Main and second colour that a kind of thing usually has.
fn typical_color(word: &str) -> Option<[[u8; 3]; 2]> {
    Some(match word {
        "apple" | "tomato" | "strawberry" => [[200, 36, 34], [86, 130, 50]],
        "orange" | "carrot" | "tangerine" => [[240, 134, 30], [84, 130, 52]],
        "banana" => [[244, 212, 62], [104, 74, 36]],
        "lemon" => [[246, 218, 64], [190, 170, 50]],
        "pear" => [[176, 190, 74], [100, 72, 40]],
        "pepper" => [[204, 44, 34], [64, 120, 44]],
        "avocado" | "cucumber" => [[70, 96, 44], [150, 180, 90]],
        "broccoli" | "lettuce" | "vegetable" | "cactus" | "plant" => {
            [[86, 148, 58], [150, 190, 100]]
        }
        "egg" => [[238, 220, 196], [222, 198, 170]],
        "bun" | "bread" | "cookie" | "pie" | "muffin" | "food" | "croissant" => {
            [[208, 152, 84], [150, 92, 46]]
        }
        "cake" | "dessert" => [[232, 200, 160], [188, 70, 84]],
        "soup" => [[226, 222, 214], [196, 104, 40]],
        "meat" | "steak" => [[158, 66, 58], [226, 178, 168]],
        "nut" | "peanut" | "potato" | "walnut" => [[178, 128, 76], [124, 82, 46]],
        "fruit" => [[220, 110, 60], [90, 130, 60]],
        "sushi" => [[240, 238, 230], [240, 120, 70]],
        "bear" | "teddy" => [[156, 108, 62], [206, 168, 120]],
        "laptop" | "remote" | "keyboard" | "mouse" | "headphones" | "phone" => {
            [[46, 47, 50], [120, 124, 130]]
        }
        "plate" | "bowl" | "saucer" | "cup" | "mug" => [[234, 233, 228], [120, 150, 180]],
        "basket" => [[188, 148, 96], [140, 104, 60]],
        "pencil" => [[238, 190, 40], [214, 120, 130]],
        "towel" => [[230, 228, 222], [120, 150, 190]],
        _ => return None,
    })
}

/// For things that no word describes.
const OBJECT_PALETTE: [[u8; 3]; 10] = [
    [196, 62, 54],
    [62, 108, 180],
    [70, 148, 96],
    [224, 168, 60],
    [146, 96, 168],
    [224, 122, 74],
    [66, 158, 168],
    [206, 112, 150],
    [120, 124, 132],
    [146, 104, 66],
];
