//! What the loader of each format passes over in silence,
//! or fails on (docs/spec.md#dataset-formats).
//!
//! Why: rows that are skipped and images that are ignored are noticed after the training, if
//! ever. Sure: yes, for the loaders of docs/spec.md#dataset-formats as they are; other loaders of
//! the same format may be kinder. Memory: constant.

use super::{Check, RowFacts};
use crate::lint::{
    Dataset, Example, Format, Role, Severity, Turn, example::FormatWarning, report::Findings,
};

pub(super) struct Loader {
    /// What is odd about whole files.
    files: Vec<(String, FormatWarning)>,
    /// By file: whether a `dataset_info.json` names it.
    declared: Vec<bool>,
    warned_undeclared: bool,
}

impl Loader {
    pub(super) fn new(dataset: &Dataset) -> Self {
        let odd = dataset.files().iter().flat_map(|file| {
            file.notes
                .iter()
                .map(|note| (file.path.display().to_string(), note.clone()))
        });
        Self {
            files: odd.collect(),
            declared: dataset.files().iter().map(|file| file.declared).collect(),
            warned_undeclared: false,
        }
    }
}

impl Check for Loader {
    fn about(&self) -> (&'static str, &'static str) {
        (
            "loader",
            "what the format's loader ignores, skips or fails on without a word",
        )
    }

    fn see(&mut self, seen: &RowFacts, found: &mut Findings) {
        let (example, places) = (seen.example, [seen.place()]);
        let mut add = |kind, severity, told: String| {
            found.add(kind, severity, &places, || (told, String::new()))
        };
        for warning in &example.warnings {
            add(
                warning.kind,
                if warning.harmful {
                    Severity::Error
                } else {
                    Severity::Warning
                },
                warning.message.clone(),
            );
        }
        if let Some(name) = example.turns.iter().find_map(|turn| {
            if let Role::Other(name) = &turn.role {
                Some(name)
            } else {
                None
            }
        }) {
            add(
                "role",
                Severity::Error,
                format!(
                    "the role `{name}`, which {} does not know",
                    example.format.as_str()
                ),
            );
        }
        match example.format {
            Format::QwenVl => {
                if example.meta.contains_key("images") {
                    add(
                        "ignored key",
                        Severity::Error,
                        "the key `images` is ignored: Qwen's loader reads `image`".into(),
                    );
                }
                alternating(example, &mut add);
            }
            Format::LlamaFactory => {
                if example.meta.contains_key("images") || example.meta.contains_key("image") {
                    add(
                        "ignored key",
                        Severity::Error,
                        "images in a column that dataset_info.json does not name are ignored"
                            .into(),
                    );
                }
                alternating(example, &mut add);
                let declared = usize::try_from(example.location.file)
                    .ok()
                    .and_then(|file| self.declared.get(file));
                if declared == Some(&false) && !self.warned_undeclared {
                    self.warned_undeclared = true;
                    add(
                        "undeclared",
                        Severity::Warning,
                        "no dataset_info.json beside the file names it: LLaMA-Factory does not find it".into(),
                    );
                }
            }
            Format::MsSwift => {
                if example.meta.contains_key("image") {
                    add(
                        "ignored key",
                        Severity::Error,
                        "the key `image` is ignored: ms-swift reads `images`".into(),
                    );
                }
                ends_with_answer(example, &mut add);
            }
            Format::OpenAi => {
                answered_calls(example, &mut add);
                ends_with_answer(example, &mut add);
            }
            Format::Trl | Format::Parquet => ends_with_answer(example, &mut add),
        }
    }

    fn finish(&mut self, found: &mut Findings) {
        for (path, warning) in &self.files {
            let severity = if warning.harmful {
                Severity::Error
            } else {
                Severity::Warning
            };
            found.add(warning.kind, severity, &[], || {
                (format!("{} ({path})", warning.message), String::new())
            });
        }
    }
}

/// sharegpt: user and model by turns, the user first, an even number; else the row
/// is skipped in silence.
fn alternating(example: &Example, add: &mut impl FnMut(&'static str, Severity, String)) {
    let turns: Vec<&Turn> = example
        .turns
        .iter()
        .skip_while(|turn| turn.role == Role::System)
        .collect();
    if turns.len() % 2 == 1 {
        add(
            "odd turns",
            Severity::Error,
            format!(
                "{} turns: an odd number makes the loader skip the row",
                turns.len()
            ),
        );
        return;
    }
    let wrong = turns
        .iter()
        .enumerate()
        .find(|(number, turn)| match turn.role {
            Role::User | Role::ToolResult => number % 2 == 1,
            Role::Assistant | Role::ToolCall => number % 2 == 0,
            Role::System => true,
            Role::Other(_) => false,
        });
    if let Some((number, turn)) = wrong {
        let told = format!(
            "turn {} is the {}'s: user and model must take turns, or the row is skipped",
            number + 1,
            turn.role.as_str()
        );
        add("order", Severity::Error, told);
    }
}

fn ends_with_answer(example: &Example, add: &mut impl FnMut(&'static str, Severity, String)) {
    if let Some(last) = example.turns.last().filter(|turn| !turn.role.is_answer()) {
        add(
            "order",
            Severity::Warning,
            format!(
                "the last turn is the {}'s: nothing is learned from it",
                last.role.as_str()
            ),
        );
    }
}

/// OpenAI: results follow the calls they answer.
fn answered_calls(example: &Example, add: &mut impl FnMut(&'static str, Severity, String)) {
    let mut open = 0_usize;
    for turn in &example.turns {
        match turn.role {
            Role::ToolResult if open == 0 => {
                add(
                    "order",
                    Severity::Error,
                    "a tool's result without a call before it: the server refuses the row".into(),
                );
                return;
            }
            Role::ToolResult => open -= 1,
            _ if open > 0 => {
                add(
                    "order",
                    Severity::Error,
                    "a call that no tool's result follows: the server refuses the row".into(),
                );
                return;
            }
            _ => open = turn.calls().count(),
        }
    }
}
