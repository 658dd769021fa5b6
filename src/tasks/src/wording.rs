//! The published ways to word an instruction, and phrases for what is in it.

pub use reel_world::language::{article, indefinite};

/// `{src}`, `{dest}` and `{object}` stand for phrases, `{at}` for "on" or "in".
pub const TEMPLATES: &[&str] = &[
    "Navigate to {src}, grasp {object}, and carry it to {dest}.",
    "First, drive to {src} to find {object}, then deliver it to {dest}.",
    "Go to {src}, pick up {object}, then travel to {dest} to place it.",
    "Move {object} located at {src} to {dest}.",
    "Retrieve {object} from {src} and deposit it at {dest}.",
    "Pick up {object} from {src} and place it {at} {dest}.",
    "Head over to {src}, fetch {object}, and bring it to {dest}.",
    "Transport {object} at {src} to {dest}.",
    "Take {object} from {src} and put it {at} {dest}.",
    "Bring {object} from {src} to {dest}.",
    "Get {object} from {src} and move it to {dest}.",
];

/// A caption as a phrase that means one thing: `A small red mug.` as `the small red mug`; empty
/// for an empty caption.
pub fn definite(caption: &str) -> String {
    let caption = caption.trim().trim_end_matches(['.', ',']);
    let bare = |article: &str| {
        let head = caption.get(..article.len())?;
        head.eq_ignore_ascii_case(article)
            .then(|| caption[article.len()..].trim_start())
    };
    let caption = ["a ", "an ", "the "]
        .iter()
        .find_map(|article| bare(article))
        .unwrap_or(caption);
    let mut letters = caption.chars();
    let Some(first) = letters.next() else {
        return String::new();
    };
    format!("the {}{}", first.to_lowercase(), letters.as_str())
}

/// A caption that names the category: as it is if it does, else with the category after it.
pub fn naming_category(caption: &str, category: &str) -> String {
    if caption.to_lowercase().contains(&category.to_lowercase()) {
        return caption.to_owned();
    }
    format!(
        "{}, {}",
        caption.trim_end().trim_end_matches('.'),
        indefinite(category)
    )
}

/// The two parts of a receptacle's id: `chestofdrawers_3` is number 3 of the type `chestofdrawers`.
/// What ends with no number has number 0.
pub fn furniture(id: &str) -> (&str, u32) {
    let (kind, number) = id.rsplit_once('_').unwrap_or((id, ""));
    (kind, number.parse().unwrap_or(0))
}

/// The type of a receptacle as people write it: `chestofdrawers` as `chest of drawers`.
pub fn furniture_name(kind: &str) -> &str {
    match kind {
        "chestofdrawers" => "chest of drawers",
        "tvstand" => "TV stand",
        "washingmachine" => "washing machine",
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn captions_become_definite_phrases() {
        assert_eq!(
            definite("Small red mug with a rim."),
            "the small red mug with a rim"
        );
        assert_eq!(definite("The Tall vase,"), "the tall vase");
        assert_eq!(definite("Theatre mask"), "the theatre mask");
        assert_eq!(
            (definite(" ."), article("Umbrella"), article("jar")),
            (String::new(), "an", "a")
        );
    }

    #[test]
    fn a_caption_names_its_category_and_an_id_its_type() {
        assert_eq!(
            naming_category("Tall blue VASE.", "vase"),
            "Tall blue VASE."
        );
        assert_eq!(
            naming_category("Tall and blue.", "urn"),
            "Tall and blue, an urn"
        );
        assert_eq!(
            (
                furniture("shoe_rack_12"),
                furniture("rug"),
                furniture("lamp_b")
            ),
            (("shoe_rack", 12), ("rug", 0), ("lamp", 0))
        );
        assert_eq!(
            (furniture_name("tvstand"), furniture_name("desk")),
            ("TV stand", "desk")
        );
    }
}
