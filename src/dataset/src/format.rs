//! The formats that trainers load (docs/spec.md#dataset-formats): one row of text an example.
//! Owns each format's shape; decides nothing about what is in an example. Parquet (vi) is
//! written elsewhere, from [`Example`]s.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde::Serialize;

use crate::{
    DatasetError, Example, ImageId, ImageStore, SharedText, StoredImage, Style, Turn,
    example::{IMAGE_TAG, call_json, tags_in},
    json,
};

/// A format of a dataset.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Format {
    /// (i) A JSON array as Qwen-VL's fine-tuning reads it.
    QwenVl,
    /// (ii) JSON lines for ms-swift.
    MsSwift,
    /// (iii) JSON lines in the sharegpt form, with `dataset_info.json`, for LLaMA-Factory.
    LlamaFactory,
    /// (iv) JSON lines for TRL.
    Trl,
    /// (v) JSON lines of OpenAI chats.
    #[serde(rename = "openai")]
    OpenAi,
    /// (vi) Parquet with Hugging Face's features.
    Parquet,
}

impl Format {
    /// All of them, in the order of docs/spec.md#dataset-formats.
    pub const ALL: [Format; 6] = [
        Format::QwenVl,
        Format::MsSwift,
        Format::LlamaFactory,
        Format::Trl,
        Format::OpenAi,
        Format::Parquet,
    ];

    /// As it stands on the command line and in manifests.
    pub fn as_str(self) -> &'static str {
        match self {
            Format::QwenVl => "qwen-vl",
            Format::MsSwift => "ms-swift",
            Format::LlamaFactory => "llama-factory",
            Format::Trl => "trl",
            Format::OpenAi => "openai",
            Format::Parquet => "parquet",
        }
    }

    /// Reads what [`Format::as_str`] wrote.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.as_str() == text)
    }

    /// One line for people.
    pub fn description(self) -> &'static str {
        match self {
            Format::QwenVl => {
                "JSON array of conversations (human, gpt) with image paths, for Qwen-VL's fine-tuning"
            }
            Format::MsSwift => "JSON lines of messages with image paths, for ms-swift",
            Format::LlamaFactory => {
                "JSON lines of sharegpt conversations with dataset_info.json, for LLaMA-Factory"
            }
            Format::Trl => {
                "JSON lines of prompt and completion (or messages) with content parts and image paths, for TRL"
            }
            Format::OpenAi => {
                "JSON lines of OpenAI chats with tool calls and images as data URLs; provenance in a file beside"
            }
            Format::Parquet => "Hugging Face Parquet with the images inside",
        }
    }

    /// Extension of its files.
    pub fn extension(self) -> &'static str {
        match self {
            Format::QwenVl => "json",
            Format::Parquet => "parquet",
            _ => "jsonl",
        }
    }

    /// Whether a row holds its provenance; otherwise a file beside the shard does, because the
    /// loader refuses other keys.
    pub fn holds_provenance(self) -> bool {
        self != Format::OpenAi
    }

    /// Whether the images are in the rows; otherwise the rows name files.
    pub fn embeds_images(self) -> bool {
        matches!(self, Format::OpenAi | Format::Parquet)
    }

    /// Why an example cannot be written in this format, if so: trainers that learn every answer of
    /// a conversation must not be given one of which only a part shall be learned.
    pub fn refuses(self, example: &Example) -> Option<&'static str> {
        let has_words_beside_calls = example.turns.iter().any(|turn| match turn {
            Turn::Call { thought, .. } => {
                !thought.is_empty() && !thought.trim_end().ends_with("</think>")
            }
            _ => false,
        });
        match (self, LossMask::of(example)) {
            (Format::Parquet, _) => Some("its rows are not text"),
            (Format::LlamaFactory, _) if has_words_beside_calls => {
                Some("its trainer reads no words beside a call, and this agent said some")
            }
            (_, LossMask::All) | (Format::MsSwift | Format::OpenAi, _) => None,
            (Format::LlamaFactory | Format::Trl, LossMask::Last)
                if example.style == Style::MultiTurnPrefix =>
            {
                None
            }
            (Format::QwenVl, _) => Some(
                "its trainer learns every turn of the model, and this example is not to be learned wholly",
            ),
            (_, LossMask::Last | LossMask::Some) => Some(
                "its trainer learns every turn of the model or the last, and in this example some of them",
            ),
        }
    }

    /// Appends an example as one line of JSON, without the line's end. The images must
    /// be in the store.
    ///
    /// # Errors
    /// When an image is missing or the format cannot hold the example (see [`Format::refuses`]).
    pub fn write_row(
        self,
        example: &Example,
        frames: &ImageStore,
        out: &mut Vec<u8>,
    ) -> Result<(), DatasetError> {
        if let Some(reason) = self.refuses(example) {
            return Err(DatasetError::UnsupportedFormat {
                example: example.id.clone(),
                format: self.as_str(),
                reason,
            });
        }
        let mut row = Row {
            example,
            frames,
            out,
        };
        match self {
            Format::QwenVl => row.qwen_vl(),
            Format::MsSwift => row.ms_swift(),
            Format::LlamaFactory => row.llama_factory(),
            Format::Trl => row.trl(),
            Format::OpenAi | Format::Parquet => row.open_ai(),
        }
    }
}

/// Which of the model's turns are learned.
#[derive(Clone, Copy, PartialEq, Eq)]
enum LossMask {
    All,
    Last,
    Some,
}

impl LossMask {
    fn of(example: &Example) -> Self {
        let learned = example.turns.iter().filter_map(|turn| match turn {
            Turn::Answer(_) => Some(true),
            Turn::Call { learn, .. } => Some(*learn),
            _ => None,
        });
        let learned: Vec<bool> = learned.collect();
        match learned.iter().filter(|learn| **learn).count() {
            count if count == learned.len() => LossMask::All,
            1 if learned.last() == Some(&true) => LossMask::Last,
            _ => LossMask::Some,
        }
    }
}

/// How turns begin in the forms of sharegpt and of messages.
const HUMAN: &str = "{\"from\":\"human\",\"value\":\"";
const GPT: &str = "{\"from\":\"gpt\",\"value\":\"";
const ASSISTANT: &str = "{\"role\":\"assistant\",\"content\":\"";

struct Row<'r> {
    example: &'r Example,
    frames: &'r ImageStore,
    out: &'r mut Vec<u8>,
}

impl Row<'_> {
    fn qwen_vl(&mut self) -> Result<(), DatasetError> {
        let example = self.example;
        self.put("{\"id\":");
        self.string(&example.id);
        if example.images().next().is_some() {
            self.put(",\"image\":");
            self.paths()?;
        }
        self.put(",\"conversations\":[");
        // Its conversations have no system turn: it opens the first human one, with the tools where
        // they are apart.
        self.begin(HUMAN);
        if let Some(Turn::System(text)) = example.turns.first() {
            self.out.extend_from_slice(text.escaped());
            self.escape("\n\n");
        }
        if let Some(tools) = &example.tools {
            self.escape("Tools:\n");
            self.out.extend_from_slice(tools.escaped());
            self.escape("\n\nCall a tool as <tool_call>\n{\"name\": ..., \"arguments\": {...}}\n</tool_call>.\n\n");
        }
        let mut is_open = true;
        for turn in &example.turns {
            match turn {
                Turn::System(_) => {}
                Turn::User {
                    setting,
                    situation,
                    images,
                } => {
                    if !std::mem::take(&mut is_open) {
                        self.begin(HUMAN);
                    }
                    self.user_text(setting, situation, images.len());
                    self.put("\"}");
                }
                Turn::Answer(text) => self.say(GPT, text, 0),
                Turn::Call {
                    thought,
                    name,
                    arguments,
                    ..
                } => {
                    self.say(
                        GPT,
                        &format!(
                            "{thought}<tool_call>\n{}\n</tool_call>",
                            call_json(name, arguments)
                        ),
                        0,
                    );
                }
                Turn::Outcome { text, images, .. } => {
                    self.say(
                        HUMAN,
                        &format!("<tool_response>\n{text}\n</tool_response>"),
                        images.len(),
                    );
                }
            }
        }
        self.put("]");
        self.close()
    }

    fn ms_swift(&mut self) -> Result<(), DatasetError> {
        let example = self.example;
        // `loss` stands in every turn of the model or in none, so that all rows
        // have the same fields.
        let loss = |learn: bool| match (example.style != Style::SingleTurn, learn) {
            (false, _) => "\"}",
            (true, true) => "\",\"loss\":true}",
            (true, false) => "\",\"loss\":false}",
        };
        self.put("{\"messages\":[");
        for turn in &example.turns {
            match turn {
                Turn::System(text) => {
                    self.begin("{\"role\":\"system\",\"content\":\"");
                    self.out.extend_from_slice(text.escaped());
                    self.put("\"}");
                }
                Turn::User {
                    setting,
                    situation,
                    images,
                } => {
                    self.begin("{\"role\":\"user\",\"content\":\"");
                    self.user_text(setting, situation, images.len());
                    self.put("\"}");
                }
                Turn::Answer(text) => {
                    self.begin(ASSISTANT);
                    self.escape(text);
                    self.put(loss(true));
                }
                Turn::Call {
                    thought,
                    name,
                    arguments,
                    learn,
                    ..
                } => {
                    if !thought.is_empty() {
                        self.begin(ASSISTANT);
                        self.escape(thought);
                        self.put(loss(*learn));
                    }
                    self.begin("{\"role\":\"tool_call\",\"content\":\"");
                    self.escape(&call_json(name, arguments));
                    self.put(loss(*learn));
                }
                Turn::Outcome { text, images, .. } => {
                    self.say(
                        "{\"role\":\"tool_response\",\"content\":\"",
                        text,
                        images.len(),
                    );
                }
            }
        }
        self.put("],\"images\":");
        self.paths()?;
        self.tools();
        self.close()
    }

    fn llama_factory(&mut self) -> Result<(), DatasetError> {
        let example = self.example;
        if !matches!(example.turns.first(), Some(Turn::System(_))) {
            self.put("{\"conversations\":[");
        }
        for turn in &example.turns {
            match turn {
                Turn::System(text) => {
                    self.put("{\"system\":\"");
                    self.out.extend_from_slice(text.escaped());
                    self.put("\",\"conversations\":[");
                }
                Turn::User {
                    setting,
                    situation,
                    images,
                } => {
                    self.begin(HUMAN);
                    self.user_text(setting, situation, images.len());
                    self.put("\"}");
                }
                Turn::Answer(text) => self.say(GPT, text, 0),
                Turn::Call {
                    thought,
                    name,
                    arguments,
                    ..
                } => {
                    let said = format!("{thought}{}", call_json(name, arguments));
                    self.say("{\"from\":\"function_call\",\"value\":\"", &said, 0);
                }
                Turn::Outcome { text, images, .. } => {
                    self.say("{\"from\":\"observation\",\"value\":\"", text, images.len());
                }
            }
        }
        self.put("],\"images\":");
        self.paths()?;
        self.tools();
        self.close()
    }

    fn trl(&mut self) -> Result<(), DatasetError> {
        let example = self.example;
        // Prompt and completion where the last turn is learned alone; then the trainer
        // learns the completion only.
        let pair = example.style != Style::MultiTurn;
        self.put(if pair {
            "{\"prompt\":["
        } else {
            "{\"messages\":["
        });
        let last = example.turns.len() - 1;
        for (index, turn) in example.turns.iter().enumerate() {
            if index == last && pair {
                self.put("],\"completion\":[");
            } else if index > 0 {
                self.put(",");
            }
            match turn {
                Turn::System(text) => {
                    self.put("{\"role\":\"system\",\"content\":[{\"type\":\"text\",\"text\":\"");
                    self.out.extend_from_slice(text.escaped());
                    self.put("\"}]}");
                }
                Turn::User {
                    setting,
                    situation,
                    images,
                } => {
                    self.put("{\"role\":\"user\",\"content\":[{\"type\":\"text\",\"text\":\"");
                    self.user_parts_text(setting, situation);
                    self.put("\"}");
                    images
                        .iter()
                        .for_each(|_| self.put(",{\"type\":\"image\"}"));
                    self.put("]}");
                }
                Turn::Answer(text) => {
                    self.put("{\"role\":\"assistant\",\"content\":[{\"type\":\"text\",\"text\":\"");
                    self.escape(text);
                    self.put("\"}]}");
                }
                Turn::Call {
                    thought,
                    id,
                    name,
                    arguments,
                    ..
                } => {
                    self.put("{\"role\":\"assistant\",\"content\":[");
                    if !thought.is_empty() {
                        self.put("{\"type\":\"text\",\"text\":\"");
                        self.escape(thought);
                        self.put("\"}");
                    }
                    self.put("]");
                    self.tool_calls(id, name, arguments);
                    self.put("}");
                }
                // Its tool messages hold no images.
                Turn::Outcome {
                    id,
                    name,
                    text,
                    images,
                } => {
                    self.put("{\"role\":\"tool\",\"tool_call_id\":");
                    self.string(id);
                    self.put(",\"name\":");
                    self.string(name);
                    self.put(",\"content\":[{\"type\":\"text\",\"text\":");
                    self.string(text);
                    self.put("}]}");
                    if !images.is_empty() {
                        let parts = vec!["{\"type\":\"image\"}"; images.len()].join(",");
                        self.put(",{\"role\":\"user\",\"content\":[");
                        self.put(&parts);
                        self.put("]}");
                    }
                }
            }
        }
        self.put("],\"images\":");
        self.paths()?;
        self.tools();
        self.close()
    }

    fn open_ai(&mut self) -> Result<(), DatasetError> {
        let example = self.example;
        let masked = LossMask::of(example) != LossMask::All;
        self.put("{\"messages\":[");
        for (index, turn) in example.turns.iter().enumerate() {
            if index > 0 {
                self.put(",");
            }
            match turn {
                Turn::System(text) => {
                    self.put("{\"role\":\"system\",\"content\":\"");
                    self.out.extend_from_slice(text.escaped());
                    self.put("\"}");
                }
                Turn::User {
                    setting,
                    situation,
                    images,
                } => {
                    self.put("{\"role\":\"user\",\"content\":[{\"type\":\"text\",\"text\":\"");
                    self.user_parts_text(setting, situation);
                    self.put("\"}");
                    for image in images {
                        self.put(",");
                        self.data_url(image)?;
                    }
                    self.put("]}");
                }
                Turn::Answer(text) => {
                    self.put("{\"role\":\"assistant\",\"content\":");
                    self.string(text);
                    self.put(if masked { ",\"weight\":1}" } else { "}" });
                }
                Turn::Call {
                    thought,
                    id,
                    name,
                    arguments,
                    learn,
                } => {
                    self.put("{\"role\":\"assistant\",\"content\":");
                    self.string(thought);
                    self.tool_calls(id, name, arguments);
                    if masked {
                        self.put(if *learn {
                            ",\"weight\":1"
                        } else {
                            ",\"weight\":0"
                        });
                    }
                    self.put("}");
                }
                Turn::Outcome {
                    id, text, images, ..
                } => {
                    self.put("{\"role\":\"tool\",\"tool_call_id\":");
                    self.string(id);
                    self.put(",\"content\":");
                    self.string(text);
                    self.put("}");
                    // Tool messages hold no images.
                    for (at, image) in images.iter().enumerate() {
                        self.put(if at == 0 {
                            ",{\"role\":\"user\",\"content\":["
                        } else {
                            ","
                        });
                        self.data_url(image)?;
                    }
                    if !images.is_empty() {
                        self.put("]}");
                    }
                }
            }
        }
        self.put("]");
        if let Some(tools) = &example.tools {
            self.put(",\"tools\":");
            self.put(tools.as_str());
            self.put(",\"parallel_tool_calls\":false");
        }
        self.put("}");
        Ok(())
    }

    fn put(&mut self, json: &str) {
        self.out.extend_from_slice(json.as_bytes());
    }

    /// Begins a turn, after a comma unless it is the first.
    fn begin(&mut self, turn: &str) {
        if self.out.last() != Some(&b'[') {
            self.put(",");
        }
        self.put(turn);
    }

    /// A turn of one text, with a tag for each image.
    fn say(&mut self, turn: &str, text: &str, images: usize) {
        self.begin(turn);
        self.escape(text);
        self.tags(images);
        self.put("\"}");
    }

    fn escape(&mut self, text: &str) {
        json::escape(self.out, text);
    }

    fn string(&mut self, text: &str) {
        json::string(self.out, text);
    }

    /// The text of a user's turn, with a tag for each image that it has none for yet.
    fn user_text(&mut self, setting: &SharedText, situation: &str, images: usize) {
        self.user_parts_text(setting, situation);
        self.tags(images.saturating_sub(tags_in(setting.as_str()) + tags_in(situation)));
    }

    /// The text of a user's turn whose images are parts of their own.
    fn user_parts_text(&mut self, setting: &SharedText, situation: &str) {
        self.out.extend_from_slice(setting.escaped());
        self.escape(situation);
    }

    fn tags(&mut self, images: usize) {
        (0..images).for_each(|_| self.put(IMAGE_TAG));
    }

    fn tool_calls(&mut self, id: &str, name: &str, arguments: &str) {
        self.put(",\"tool_calls\":[{\"id\":");
        self.string(id);
        self.put(",\"type\":\"function\",\"function\":{\"name\":");
        self.string(name);
        self.put(",\"arguments\":");
        // A text: as a value, loaders would give every call the arguments of all the others, empty.
        self.string(arguments);
        self.put("}}]");
    }

    /// The tools as a text, which every loader reads and none pads.
    fn tools(&mut self) {
        if let Some(tools) = &self.example.tools {
            self.put(",\"tools\":\"");
            self.out.extend_from_slice(tools.escaped());
            self.put("\"");
        }
    }

    fn paths(&mut self) -> Result<(), DatasetError> {
        let example = self.example;
        self.put("[");
        for (index, image) in example.images().enumerate() {
            let path = self.frame(image)?.path;
            self.put(if index > 0 { ",\"" } else { "\"" });
            self.put(&path);
            self.put("\"");
        }
        self.put("]");
        Ok(())
    }

    fn data_url(&mut self, image: &ImageId) -> Result<(), DatasetError> {
        let frame = self.frame(image)?;
        let bytes = self.frames.bytes(&frame)?;
        self.put("{\"type\":\"image_url\",\"image_url\":{\"url\":\"data:");
        self.put(self.frames.options().encoding.mime());
        self.put(";base64,");
        self.put(&STANDARD.encode(&bytes));
        self.put("\"}}");
        Ok(())
    }

    fn frame(&self, image: &ImageId) -> Result<StoredImage, DatasetError> {
        self.frames.get(image).ok_or_else(|| DatasetError::Image {
            example: self.example.id.clone(),
            image: *image,
        })
    }

    fn close(&mut self) -> Result<(), DatasetError> {
        if let Some(rollout) = &self.example.rollout {
            rollout.append(self.out);
        }
        self.put(",\"provenance\":");
        self.example.provenance(self.out);
        self.put("}");
        Ok(())
    }
}
