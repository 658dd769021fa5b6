//! Images: files that are missing, bytes that no decoder takes, tags and images that
//! do not pair off.
//!
//! Sure: yes for missing files, counts and roles; an image whose header is whole may still
//! be damaged inside. URLs are not read. Memory: what [`super::row_facts::ImageProbes`] keeps
//! of each image file.

use super::{Check, RowFacts};
use crate::lint::{Format, Part, Role, Severity, formats::has_tags, report::Findings};

pub(super) struct Images;

impl Check for Images {
    fn about(&self) -> (&'static str, &'static str) {
        (
            "images",
            "missing or broken images, <image> tags without an image, tags where no loader looks for them",
        )
    }

    fn see(&mut self, seen: &RowFacts, found: &mut Findings) {
        let (example, places) = (seen.example, [seen.place()]);
        for (image, look) in example.images.iter().zip(&seen.images) {
            if let Some((kind, why)) = &look.fault {
                found.add(kind, Severity::Error, &places, || {
                    (why.clone(), image.name.clone())
                });
            }
        }
        let parts = || {
            example
                .turns
                .iter()
                .flat_map(|turn| turn.parts.iter().map(move |part| (&turn.role, part)))
        };
        let tags = parts()
            .filter(|(_, part)| matches!(part, Part::Image(_)))
            .count();
        if tags != example.images.len() {
            let told = format!(
                "{tags} tags for {} images: the loader fails on the row or shows the wrong image",
                example.images.len()
            );
            found.add("tag mismatch", Severity::Error, &places, || {
                (told, String::new())
            });
        }
        let elsewhere = parts().find(|(role, part)| {
            matches!(part, Part::Image(_)) && !takes_images(example.format, role)
        });
        if let Some((role, _)) = elsewhere {
            let told = format!(
                "an image in a turn of the {}: only the user's turns may show one",
                role.as_str()
            );
            found.add("wrong turn", Severity::Error, &places, || {
                (told, String::new())
            });
        }
        // Where the format has no tags, a tag in the text is seven characters to the model. REAL's
        // trainer puts one into the text of a message whose images follow.
        if !has_tags(example.format) && !example.images.is_empty() {
            let literal = example.turns.iter().any(|turn| {
                let images = turn
                    .parts
                    .iter()
                    .filter(|part| matches!(part, Part::Image(_)))
                    .count();
                turn.texts()
                    .map(|text| text.matches("<image>").count())
                    .sum::<usize>()
                    > images
            });
            if literal {
                let told = "the text says <image>, which this format does not know: the model reads it as text";
                found.add("literal tag", Severity::Warning, &places, || {
                    (told.to_owned(), String::new())
                });
            }
        }
    }
}

fn takes_images(format: Format, role: &Role) -> bool {
    match role {
        Role::User => true,
        // ms-swift, LLaMA-Factory and TRL show what a tool brings.
        Role::ToolResult => !matches!(format, Format::QwenVl | Format::OpenAi),
        // An unknown role is told by the check of the loader.
        Role::Other(_) => true,
        _ => false,
    }
}
