//! Attribute words: what a caption says of colour, material, shape and size, and of furniture also
//! handles, top and bedding. Words stand in the order of the caption.

use reel_world::Attributes;

const COLOURS: &[&str] = &reel_world::words! {
    beige black blue brass bronze brown chrome clear colorful colourful copper cream dark gold
    golden gray green grey ivory light lime magenta maroon metallic multicolored "multi-colored"
    navy olive orange pink purple red "semi-transparent" silver tan teal transparent turquoise
    violet white yellow yellowish
};
const MATERIALS: &[&str] = &reel_world::words! {
    aluminum bamboo brass cardboard ceramic chrome clay cloth copper cork cotton fabric fur glass
    graphite leather linen marble metal metallic oak paper plastic plush porcelain rubber silicone
    stainless steel stone velvet wax wicker wood wooden wool woven
};
const SHAPES: &[&str] = &reel_world::words! {
    circular conical cubic curved cylindrical domed flat hexagonal octagonal oval pointed
    rectangular round rounded slender spherical spiral "spiral-bound" square stacked tapered
    tapering triangular
};
const SIZES: &[&str] = &reel_world::words! {
    big compact deep huge large little long medium "medium-sized" mini narrow shallow short slim
    small tall thick thin tiny wide
};

/// Parts of furniture whose words describe the part, not the whole.
#[rustfmt::skip]
const PARTS: &[(&str, &[&str])] = &[
    ("handles", &["handle", "handles", "knob", "knobs", "pull", "pulls"]),
    ("top", &["top", "tabletop", "worktop"]),
    ("bedding", &["bedding", "sheet", "sheets", "mattress", "runner", "blanket", "quilt"]),
];

/// The attribute words of an object's caption, by kind: `colour`, `material`, `shape`, `size`.
pub fn from_caption(caption: &str) -> Attributes {
    let mut attributes = Attributes::new();
    add_words(&mut attributes, caption);
    attributes
}

/// The attribute words of furniture. What follows "with" counts only where it describes a part we
/// know (`handles`, `top`, `bedding`), and then under the name of that part.
pub fn from_furniture_captions<'a>(captions: impl IntoIterator<Item = &'a str>) -> Attributes {
    let mut attributes = Attributes::new();
    for caption in captions {
        let (whole, rest) = caption.split_once(" with ").unwrap_or((caption, ""));
        add_words(&mut attributes, whole);
        for piece in rest.split(" and ") {
            let names_part = |(_, names): &&(&str, &[&str])| {
                words(piece).any(|word| names.contains(&word.as_str()))
            };
            if let Some((part, _)) = PARTS.iter().find(names_part) {
                let described = words(piece).filter(|word| {
                    COLOURS.contains(&word.as_str()) || MATERIALS.contains(&word.as_str())
                });
                described.for_each(|word| add(&mut attributes, part, word));
            }
        }
    }
    attributes
}

fn add_words(attributes: &mut Attributes, text: &str) {
    for word in words(text) {
        for (kind, list) in [
            ("colour", COLOURS),
            ("material", MATERIALS),
            ("shape", SHAPES),
            ("size", SIZES),
        ] {
            if list.contains(&word.as_str()) {
                add(attributes, kind, word.clone());
            }
        }
    }
}

fn add(attributes: &mut Attributes, kind: &str, word: String) {
    let list = attributes.entry(kind.to_owned()).or_default();
    if !list.contains(&word) {
        list.push(word);
    }
}

/// Lower-case words; a hyphen joins, so that "short-sleeved" is not "short".
fn words(text: &str) -> impl Iterator<Item = String> {
    text.split(|c: char| !c.is_alphanumeric() && c != '-')
        .filter(|word| !word.is_empty())
        .map(str::to_lowercase)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(attributes: &Attributes) -> String {
        attributes
            .iter()
            .map(|(kind, words)| format!("{kind}: {}", words.join(" ")))
            .collect::<Vec<_>>()
            .join("; ")
    }

    #[test]
    fn a_caption_gives_its_words_in_order() {
        let caption = "Small red Ceramic mug, cylindrical, with a white, short-sleeved rim.";
        assert_eq!(
            text(&from_caption(caption)),
            "colour: red white; material: ceramic; shape: cylindrical; size: small"
        );
        assert_eq!(from_caption("Pear."), Attributes::new());
    }

    #[test]
    fn parts_of_furniture_keep_their_words_to_themselves() {
        let of = |caption: &str| text(&from_furniture_captions([caption]));
        assert_eq!(
            of("wide desk with orange drawer pulls"),
            "handles: orange; size: wide"
        );
        assert_eq!(of("bed with plain white bedding"), "bedding: white");
        assert_eq!(of("white cabinet with grey bottle"), "colour: white");
        assert_eq!(
            of("the brown table with a glass top and black handles"),
            "colour: brown; handles: black; top: glass"
        );
    }
}
