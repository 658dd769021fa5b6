//! A prompt template as REAL's trainer reads it: a text with `{PLACEHOLDER}`s, `{{` and `}}` for
//! braces. Checks what the trainer checks, and that nothing is left that it could not fill in.

use std::collections::BTreeSet;

use reel_world::{NameSet, ToolSpec};
use thiserror::Error;

use crate::{published::LEGACY_TOOLS, python};

/// Why a text is no usable template.
#[derive(Clone, PartialEq, Eq, Debug, Error)]
pub enum TemplateError {
    /// Nothing but white space.
    #[error("the template is empty")]
    Empty,
    /// A brace that opens or closes nothing.
    #[error(
        "line {line}: a single '{brace}'; write {brace}{brace} for a brace of the text, or a placeholder such as {{TASK}}"
    )]
    SingleBrace {
        /// Line of the template, counted from 1.
        line: usize,
        /// The brace that stands alone, `{` or `}`.
        brace: char,
    },
    /// A placeholder is missing.
    #[error(
        "the template lacks {}: REAL's trainer refuses it without",
        placeholders(names)
    )]
    MissingPlaceholders {
        /// The placeholders that the template lacks, in alphabetical order.
        names: Vec<&'static str>,
    },
    /// A tool is missing.
    #[error("the template lacks the tools {}: each must stand in it as \"name\": \"{}\"", names.join(", "), names.first().copied().unwrap_or_default())]
    MissingTools {
        /// In the published order.
        names: Vec<&'static str>,
    },
    /// A tool by the name of an earlier version.
    #[error("line {line}: \"{legacy}\" is a former tool name; write \"{canonical}\"")]
    LegacyTool {
        /// Line of the template, counted from 1.
        line: usize,
        /// The tool's former name, which the trainer refuses.
        legacy: &'static str,
        /// What it is called now.
        canonical: &'static str,
    },
    /// A placeholder that nobody fills in. REAL's check lets it pass and its first prompt fails.
    #[error("line {line}: unknown placeholder {{{name}}}; the placeholders are {}", placeholders(&FIELDS.map(|(name, _)| name)))]
    UnknownPlaceholder {
        /// Line of the template, counted from 1.
        line: usize,
        /// As it stands between the braces.
        name: String,
    },
}

/// A value of a prompt.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Field {
    Scene,
    Task,
    TaskProgress,
    LastAction,
    LastObservation,
    MaxAskLimit,
    AskCount,
    Hand,
}

const FIELDS: [(&str, Field); 8] = [
    ("SCENE_DESCRIPTION", Field::Scene),
    ("TASK", Field::Task),
    ("TASK_PROGRESS", Field::TaskProgress),
    ("LAST_ACTION", Field::LastAction),
    ("LAST_OBS", Field::LastObservation),
    ("max_ask_limit", Field::MaxAskLimit),
    ("ask_count", Field::AskCount),
    ("hand_state_description", Field::Hand),
];

/// Former names that a template must not offer. `place_on_top` passes the published check.
const REFUSED_LEGACY: usize = 5;

#[derive(Clone, PartialEq, Eq, Debug)]
enum Piece {
    Literal(String),
    Field(Field),
}

/// The values of one prompt.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Slots<'a> {
    /// Rooms and their receptacles, for `{SCENE_DESCRIPTION}`.
    pub scene: &'a str,
    /// The instruction, for `{TASK}`.
    pub task: &'a str,
    /// What the memory holds, for `{TASK_PROGRESS}`.
    pub task_progress: &'a str,
    /// The latest action as JSON, for `{LAST_ACTION}`.
    pub last_action: &'a str,
    /// The latest observation with its image marks, for `{LAST_OBS}`.
    pub last_observation: &'a str,
    /// Most questions of an episode, for `{max_ask_limit}`.
    pub max_ask_limit: u32,
    /// Questions asked so far, for `{ask_count}`.
    pub ask_count: u32,
    /// What the hand holds, in words, for `{hand_state_description}`.
    pub hand: &'a str,
}

/// A prompt template that passed the published checks.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Template {
    pieces: Vec<Piece>,
    /// Number of pieces at the start that are the same at every decision of an episode.
    shared: usize,
}

impl Template {
    /// Reads a template.
    ///
    /// # Errors
    /// Fails if REAL's trainer would refuse the text, or could not fill it in.
    pub fn parse(text: &str) -> Result<Self, TemplateError> {
        check(text)?;
        let text = text.trim_end_matches(python::is_space);
        let mut pieces = Vec::new();
        for piece in split(text)? {
            pieces.push(match piece {
                Raw::Literal(text) => Piece::Literal(text),
                Raw::Field { name, line } => {
                    let field = FIELDS
                        .iter()
                        .find(|(known, _)| *known == name)
                        .map(|(_, field)| Piece::Field(*field));
                    field.ok_or(TemplateError::UnknownPlaceholder { line, name })?
                }
            });
        }
        let per_episode = |piece: &Piece| match piece {
            Piece::Literal(_) => true,
            Piece::Field(field) => matches!(field, Field::Scene | Field::Task | Field::MaxAskLimit),
        };
        let shared = pieces.iter().take_while(|piece| per_episode(piece)).count();
        Ok(Self { pieces, shared })
    }

    /// Fills all placeholders and gives the whole prompt.
    pub fn render(&self, slots: &Slots<'_>) -> String {
        self.render_shared(slots) + &self.render_rest(slots)
    }

    /// The beginning of the prompt, up to the first value that changes from decision to decision.
    pub fn render_shared(&self, slots: &Slots<'_>) -> String {
        render(&self.pieces[..self.shared], slots)
    }

    /// Fills what follows the part of [`Template::render_shared`].
    pub fn render_rest(&self, slots: &Slots<'_>) -> String {
        render(&self.pieces[self.shared..], slots)
    }
}

/// Checks a template as REAL's trainer does when it starts. An unknown placeholder passes,
/// as it does there.
///
/// # Errors
/// Fails if the trainer would refuse the text.
pub fn check(text: &str) -> Result<(), TemplateError> {
    if python::strip(text).is_empty() {
        return Err(TemplateError::Empty);
    }
    let fields: BTreeSet<String> = split(text)?
        .into_iter()
        .filter_map(|piece| {
            if let Raw::Field { name, .. } = piece {
                Some(name)
            } else {
                None
            }
        })
        .collect();
    let mut names: Vec<&str> = FIELDS
        .iter()
        .map(|(name, _)| *name)
        .filter(|name| !fields.contains(*name))
        .collect();
    if !names.is_empty() {
        names.sort_unstable();
        return Err(TemplateError::MissingPlaceholders { names });
    }
    let tools = ToolSpec::POLICY
        .iter()
        .map(|spec| spec.name(NameSet::RealRepo))
        .chain(["list_receptacles"]);
    let names: Vec<&str> = tools
        .filter(|name| !text.contains(&format!("\"name\": \"{name}\"")))
        .collect();
    if !names.is_empty() {
        return Err(TemplateError::MissingTools { names });
    }
    for (legacy, canonical) in &LEGACY_TOOLS[..REFUSED_LEGACY] {
        if let Some(at) = text.find(&format!("\"{legacy}\"")) {
            return Err(TemplateError::LegacyTool {
                line: line_of(text, at),
                legacy,
                canonical,
            });
        }
    }
    Ok(())
}

enum Raw {
    Literal(String),
    Field { name: String, line: usize },
}

/// Splits a text as Python's `string.Formatter().parse` does. A conversion or format of a field
/// (`{TASK!r}`) stays in its name, so that it is unknown: the published prompts have none.
fn split(text: &str) -> Result<Vec<Raw>, TemplateError> {
    let mut pieces = Vec::new();
    let mut literal = String::new();
    let mut at = 0;
    while let Some(found) = text[at..].find(['{', '}']) {
        let brace_at = at + found;
        literal.push_str(&text[at..brace_at]);
        let brace = char::from(text.as_bytes()[brace_at]);
        let single = || TemplateError::SingleBrace {
            line: line_of(text, brace_at),
            brace,
        };
        at = brace_at + 1;
        if text[at..].starts_with(brace) {
            literal.push(brace);
            at += 1;
            continue;
        }
        let end = if brace == '{' {
            text[at..].find(['{', '}'])
        } else {
            None
        };
        let end = end
            .map(|end| at + end)
            .filter(|end| text[*end..].starts_with('}'))
            .ok_or_else(single)?;
        if !literal.is_empty() {
            pieces.push(Raw::Literal(std::mem::take(&mut literal)));
        }
        pieces.push(Raw::Field {
            name: text[at..end].to_owned(),
            line: line_of(text, brace_at),
        });
        at = end + 1;
    }
    literal.push_str(&text[at..]);
    if !literal.is_empty() {
        pieces.push(Raw::Literal(literal));
    }
    Ok(pieces)
}

fn render(pieces: &[Piece], slots: &Slots<'_>) -> String {
    let mut text = String::new();
    for piece in pieces {
        match piece {
            Piece::Literal(literal) => text.push_str(literal),
            Piece::Field(field) => match field {
                Field::Scene => text.push_str(slots.scene),
                Field::Task => text.push_str(slots.task),
                Field::TaskProgress => text.push_str(slots.task_progress),
                Field::LastAction => text.push_str(slots.last_action),
                Field::LastObservation => text.push_str(slots.last_observation),
                Field::MaxAskLimit => text.push_str(&slots.max_ask_limit.to_string()),
                Field::AskCount => text.push_str(&slots.ask_count.to_string()),
                Field::Hand => text.push_str(slots.hand),
            },
        }
    }
    text
}

fn line_of(text: &str, at: usize) -> usize {
    text[..at].matches('\n').count() + 1
}

fn placeholders(names: &[&str]) -> String {
    names
        .iter()
        .map(|name| format!("{{{name}}}"))
        .collect::<Vec<_>>()
        .join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::TEMPLATE;

    #[test]
    fn ours_passes_its_own_check_and_holds_every_value_once() {
        let slots = Slots {
            scene: "<scene>",
            task: "{TASK} \"mug\"",
            task_progress: "<progress>",
            last_action: "<action>",
            last_observation: "<observation>",
            max_ask_limit: 8,
            ask_count: 3,
            hand: "<hand>",
        };
        let template = Template::parse(TEMPLATE).unwrap();
        let prompt = template.render(&slots);
        for value in [
            slots.scene,
            slots.task,
            slots.task_progress,
            slots.last_action,
            slots.last_observation,
            slots.hand,
        ] {
            assert_eq!(prompt.matches(value).count(), 1, "{value}");
        }
        assert!(
            prompt.contains("3 of 8") && prompt.contains(r#"{"name": "pick""#),
            "{prompt}"
        );
        let shared = template.render_shared(&slots);
        assert!(
            prompt.starts_with(&shared) && shared.contains("<scene>") && !shared.contains("<hand>")
        );
    }

    #[test]
    fn what_is_wrong_is_told_with_its_line() {
        let error = |text: &str| Template::parse(text).unwrap_err().to_string();
        assert_eq!(error(" \n"), "the template is empty");
        let first = TEMPLATE.lines().count();
        assert!(
            error(&format!("{}\n{{OTHER}}", TEMPLATE.trim_end())).starts_with(&format!(
                "line {}: unknown placeholder {{OTHER}}",
                first + 1
            ))
        );
        assert!(error(&format!("{{TASK\n{TEMPLATE}")).starts_with("line 1: a single '{'"));
        assert!(error(&format!("a\n}} {TEMPLATE}")).starts_with("line 2: a single '}'"));
        let missing = error(&TEMPLATE.replace("{TASK}", "").replace("{LAST_OBS}", ""));
        assert!(missing.contains("{LAST_OBS} {TASK}"), "{missing}");
        assert!(error(&TEMPLATE.replace("\"name\": \"pick\"", "pick")).contains("the tools pick:"));
        assert_eq!(
            error(&format!("\"gaze_at\"\n{TEMPLATE}")),
            "line 1: \"gaze_at\" is a former tool name; write \"focus_on\""
        );
    }
}
