//! Which key of a row holds what: fixed by the format, or
//! said by LLaMA-Factory's `dataset_info.json`.

use std::{collections::BTreeMap, fs, path::Path};

use base64::{Engine, engine::general_purpose};
use serde_json::{Map, Value};

use crate::lint::{Format, ImageSource, Role};

/// Keys and tags of a file's rows.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Columns {
    pub(crate) messages: String,
    pub(crate) images: Option<String>,
    pub(crate) system: Option<String>,
    pub(crate) tools: Option<String>,
    pub(crate) role: String,
    pub(crate) content: String,
    roles: BTreeMap<String, Role>,
}

impl Columns {
    /// What a format fixes.
    pub(crate) fn of(format: Format) -> Self {
        let conversations = matches!(format, Format::QwenVl | Format::LlamaFactory);
        let names: &[(&str, Role)] = match format {
            Format::QwenVl => &[
                ("human", Role::User),
                ("gpt", Role::Assistant),
                ("system", Role::System),
            ],
            Format::LlamaFactory => &[
                ("human", Role::User),
                ("gpt", Role::Assistant),
                ("system", Role::System),
                ("observation", Role::ToolResult),
                ("function_call", Role::ToolCall),
            ],
            Format::MsSwift => &[
                ("system", Role::System),
                ("user", Role::User),
                ("assistant", Role::Assistant),
                ("tool_call", Role::ToolCall),
                ("tool_response", Role::ToolResult),
                ("tool", Role::ToolResult),
            ],
            Format::Trl | Format::OpenAi | Format::Parquet => &[
                ("system", Role::System),
                ("developer", Role::System),
                ("user", Role::User),
                ("assistant", Role::Assistant),
                ("tool", Role::ToolResult),
            ],
        };
        let [messages, role, content] = if conversations {
            ["conversations", "from", "value"]
        } else {
            ["messages", "role", "content"]
        };
        Self {
            messages: messages.into(),
            images: Some(
                if format == Format::QwenVl {
                    "image"
                } else {
                    "images"
                }
                .into(),
            ),
            system: (format == Format::LlamaFactory || format == Format::MsSwift)
                .then(|| "system".into()),
            tools: Some("tools".into()),
            role: role.into(),
            content: content.into(),
            roles: names
                .iter()
                .map(|(name, role)| ((*name).to_owned(), role.clone()))
                .collect(),
        }
    }

    /// What an entry of `dataset_info.json` says; what it leaves out has LLaMA-Factory's defaults.
    fn of_entry(entry: &Value) -> Self {
        let said = |group: &str, key: &str| entry.get(group)?.get(key)?.as_str().map(str::to_owned);
        let tag =
            |key: &str, default: &str| said("tags", key).unwrap_or_else(|| default.to_owned());
        let openai = entry.get("formatting").and_then(Value::as_str) == Some("openai");
        let [role, content, user, assistant, observation, function] = if openai {
            ["role", "content", "user", "assistant", "tool", "function"]
        } else {
            [
                "from",
                "value",
                "human",
                "gpt",
                "observation",
                "function_call",
            ]
        };
        let roles = [
            (tag("user_tag", user), Role::User),
            (tag("assistant_tag", assistant), Role::Assistant),
            (tag("observation_tag", observation), Role::ToolResult),
            (tag("function_tag", function), Role::ToolCall),
            (tag("system_tag", "system"), Role::System),
        ];
        Self {
            messages: said("columns", "messages").unwrap_or_else(|| "conversations".into()),
            images: said("columns", "images"),
            system: said("columns", "system"),
            tools: said("columns", "tools"),
            role: tag("role_tag", role),
            content: tag("content_tag", content),
            roles: roles.into_iter().collect(),
        }
    }

    /// What the `dataset_info.json` beside a file says of it; of a named entry, which may be
    /// in the folder above.
    pub(crate) fn declared(file: &Path) -> Option<Self> {
        let name = file.file_name()?.to_str()?;
        let mut folder = file.parent()?;
        let mut inside = name.to_owned();
        loop {
            let info = fs::read(folder.join("dataset_info.json")).ok();
            let info: Option<Map<String, Value>> =
                info.and_then(|bytes| serde_json::from_slice(&bytes).ok());
            if let Some(info) = info {
                let names = |entry: &&Value| {
                    let file_name = entry.get("file_name").and_then(Value::as_str);
                    file_name.is_some_and(|it| {
                        it == inside
                            || inside.starts_with(&format!("{}/", it.trim_end_matches('/')))
                    })
                };
                let sharegpt = |entry: &&Value| {
                    matches!(
                        entry.get("formatting").and_then(Value::as_str),
                        Some("sharegpt" | "openai")
                    )
                };
                return info
                    .values()
                    .filter(sharegpt)
                    .find(names)
                    .map(Self::of_entry);
            }
            if inside.contains('/') {
                return None;
            }
            inside = format!("{}/{inside}", folder.file_name()?.to_str()?);
            folder = folder.parent()?;
        }
    }

    /// The role that a name stands for.
    pub(crate) fn role_of(&self, name: &str) -> Role {
        self.roles
            .get(name)
            .cloned()
            .unwrap_or_else(|| Role::Other(name.to_owned()))
    }

    /// The names of roles, for messages.
    pub(crate) fn role_names(&self) -> String {
        self.roles
            .keys()
            .map(String::as_str)
            .collect::<Vec<_>>()
            .join(", ")
    }
}

/// The bytes of a data URL, given without its `data:`.
pub(super) fn data_url(data: &str) -> ImageSource {
    let Some((head, digits)) = data.split_once(',') else {
        return ImageSource::Broken("a data URL without a comma".into());
    };
    if !head.ends_with(";base64") {
        return ImageSource::Broken("a data URL that is not base64".into());
    }
    match general_purpose::STANDARD.decode(digits.trim()) {
        Ok(bytes) => ImageSource::Bytes(bytes),
        Err(error) => ImageSource::Broken(format!("a data URL with broken base64: {error}")),
    }
}
