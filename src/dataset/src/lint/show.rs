//! An example as the model sees it: turns under the names of who speaks, images in their places,
//! the answer laid out.

use std::{borrow::Cow, fmt::Write as _, fs};

use reel_world::value_text;

use crate::lint::{AssistantTurn, Example, Image, ImageHeader, ImageSource, Part};

/// The turns of an example as text; the JSON of answers is laid out line by line.
pub fn show(example: &Example) -> String {
    let mut text = String::new();
    let split = example
        .split
        .as_deref()
        .map(|split| format!(", split {split}"))
        .unwrap_or_default();
    let _ = writeln!(
        text,
        "example {} ({}{split})",
        example.location.index,
        example.format.as_str()
    );
    let facts = example
        .meta
        .iter()
        .filter(|(_, value)| value.is_string() || value.is_number() || value.is_boolean());
    for (key, value) in facts {
        let _ = writeln!(text, "  {key}: {}", value_text(value));
    }
    if let Some(tools) = &example.tools {
        let _ = writeln!(text, "\n== tools ==\n{tools:#}");
    }
    let turns = example.turns.iter().map(|turn| (turn, ""));
    let rejected = example.rejected.iter().map(|turn| (turn, ", rejected"));
    for (turn, verdict) in turns.chain(rejected) {
        let _ = writeln!(text, "\n== {}{verdict} ==", turn.role.as_str());
        for part in &turn.parts {
            match part {
                Part::Text(said) if turn.role.is_answer() => text.push_str(&laid_out(said)),
                Part::Text(said) => text.push_str(said),
                Part::Image(number) => text.push_str(&tag(example.images.get(*number), *number)),
                Part::Call(call) => {
                    let _ = write!(text, "\n-> {}({:#})", call.name, call.arguments);
                }
            }
        }
        text.push('\n');
    }
    let shown = |number: &usize| {
        example
            .turns
            .iter()
            .flat_map(|turn| &turn.parts)
            .any(|part| *part == Part::Image(*number))
    };
    let unseen: Vec<usize> = (0..example.images.len())
        .filter(|number| !shown(number))
        .collect();
    if !unseen.is_empty() {
        let _ = writeln!(text, "\n== images without a place in the text ==");
        for number in unseen {
            let _ = writeln!(text, "{}", tag(example.images.get(number), number));
        }
    }
    text
}

/// The bytes of an image; `None` if they are elsewhere, missing or broken.
pub fn image_bytes(image: &Image) -> Option<Cow<'_, [u8]>> {
    match &image.source {
        ImageSource::Bytes(bytes) => Some(Cow::Borrowed(bytes)),
        ImageSource::File(path) => fs::read(path).ok().map(Cow::Owned),
        ImageSource::Remote | ImageSource::Broken(_) => None,
    }
}

fn tag(image: Option<&Image>, number: usize) -> String {
    let Some(image) = image else {
        return format!("<image {}: missing>", number + 1);
    };
    let looks = match (&image.source, image_bytes(image)) {
        (_, Some(bytes)) => ImageHeader::of(&bytes)
            .map_or_else(|error| error.to_string(), |frame| frame.to_string()),
        (ImageSource::Broken(why), None) => why.clone(),
        (ImageSource::Remote, None) => "not read".to_owned(),
        (_, None) => "missing file".to_owned(),
    };
    let name = if image.name.is_empty() {
        String::new()
    } else {
        format!(", {}", image.name)
    };
    format!("<image {}: {looks}{name}>", number + 1)
}

/// An answer with its JSON object, if it ends with one, over several lines.
fn laid_out(said: &str) -> Cow<'_, str> {
    let Some(object) = AssistantTurn::parse(said).object else {
        return Cow::Borrowed(said);
    };
    let object = serde_json::Value::Object(object);
    let from = said.rfind("</think>").unwrap_or(0);
    let found = said[from..].match_indices('{').find_map(|(at, _)| {
        let text = &said[from + at..];
        let mut values = serde_json::Deserializer::from_str(text).into_iter::<serde_json::Value>();
        let value = values.next()?.ok()?;
        (value == object).then_some((from + at, from + at + values.byte_offset()))
    });
    match found {
        Some((start, end)) => Cow::Owned(format!("{}{object:#}{}", &said[..start], &said[end..])),
        None => Cow::Borrowed(said),
    }
}
