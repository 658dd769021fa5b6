//! What came back from a tool, as the published clients put it into a prompt.

use reel_reward::trainer::{TextError, is_dropped};

use crate::{PromptWording, python};

/// One content of a tool's result.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Item<'a> {
    /// A text item of the result.
    Text(&'a str),
    /// An image item of the result.
    Image,
}

/// A tool's result as the trainer shows it to the model.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Observation {
    /// The texts, with a mark where an image stood.
    pub text: String,
    /// How many images came with it.
    pub images: usize,
}

impl Observation {
    /// Reads the contents of a result. The last one is the debug information and never shown;
    /// neither are texts that begin like it, or like JSON. A result without anything to show says
    /// that the tool was called.
    pub fn of_result(tool: &str, contents: &[Item<'_>], wording: &PromptWording) -> Self {
        let shown = if contents.len() > 1 {
            &contents[..contents.len() - 1]
        } else {
            contents
        };
        let (mut text, mut images) = (String::new(), 0);
        for item in shown {
            match item {
                Item::Text(line) if is_dropped(python::strip(line)) => continue,
                Item::Text(line) => text.push_str(python::strip(line)),
                Item::Image => {
                    text.push_str(&wording.image_mark);
                    images += 1;
                }
            }
            text.push('\n');
        }
        let text = match python::strip(&text) {
            "" => wording.no_text.replace("{}", tool),
            text => text.to_owned(),
        };
        Self { text, images }
    }

    /// What the model is told of an answer without a usable action.
    pub fn of_invalid_answer(error: &super::ActionError, wording: &PromptWording) -> Self {
        Self {
            text: format!("{}{error}", wording.invalid_answer),
            images: 0,
        }
    }

    /// The sentence that a rollout's prompt holds: one `<image>` in it, whatever
    /// the number of images.
    pub fn in_rollout(&self, wording: &PromptWording) -> String {
        let introduction = if self.images > 0 {
            &wording.observed_image_and_text
        } else {
            &wording.observed_text
        };
        format!("{introduction}{}", self.text)
    }

    /// The sentence that the gym's prompt holds.
    pub fn in_gym(&self, wording: &PromptWording) -> String {
        if self.images == 0 {
            return format!("{}{}", wording.observed_text, self.text);
        }
        let text = self.text.replace(wording.image_mark.as_str(), "");
        match python::strip(&text) {
            "" => wording.gym_image.clone(),
            text => format!("{}{text}{}", wording.gym_text, wording.gym_and_image),
        }
    }
}

/// What the trainer believes of the hand: any pick whose observation reports no error fills it,
/// any place empties it.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Hand {
    occupied: bool,
}

impl Hand {
    /// Takes in an observation. `tool` goes by its canonical name.
    pub fn update(&mut self, tool: &str, observation: &str) {
        let failed = TextError::find(observation).is_some();
        match tool {
            "pick" if !failed => self.occupied = true,
            "place" if !failed => self.occupied = false,
            _ => {}
        }
    }

    /// The sentence of the prompt. `held` is the category in the inventory; `None` if nothing is.
    pub fn describe(&self, held: Option<&str>, wording: &PromptWording) -> String {
        match (self.occupied, held) {
            (false, _) => wording.hand_empty.clone(),
            (true, held) => wording
                .hand_holding
                .replace("{}", held.unwrap_or("an object")),
        }
    }
}
