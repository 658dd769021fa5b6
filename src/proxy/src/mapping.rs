//! Mapping files: which tools of another server are which of the eleven, and where its results say
//! how the world is. Never opens a file: texts come. `docs/proxy.md` explains the format.

use std::borrow::Cow;

use reel_import::{MappingError, MappingFile, Tools};
use reel_world::ToolCall;
use serde_json::{Map, Value};
use toml::{Spanned, de::DeValue};

/// The keys of `[state]`, and what they are in the debug information of the published server.
const STATE: [(&str, &str); 5] = [
    ("graph", "world_graph"),
    ("held", "CURRENT_INV"),
    ("landmark", "CURRENT_LANDMARK"),
    ("markers", "CURRENT_MARKER_MAP"),
    ("position", "CURRENT_POS"),
];
/// Where a result says that the call failed.
const ERROR: &str = "error";

/// Which tools there are which of ours, and where results say how the world is.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Mapping {
    tools: Tools,
    /// Our key and the JSON pointer there.
    state: Vec<(&'static str, String)>,
    error: Option<String>,
}

impl Mapping {
    /// Reads a mapping file.
    ///
    /// # Errors
    /// With line and column, what is no TOML or means nothing.
    pub fn parse(text: &str) -> Result<Self, MappingError> {
        let (file, table) = MappingFile::parse(text)?;
        let mut mapping = Self::default();
        for (key, value) in &table {
            match key.get_ref().as_ref() {
                "tools" => mapping.tools = Tools::parse(&file, value)?,
                "state" => {
                    for (key, pointer) in file.table(value, "state")? {
                        mapping.point(&file, key, pointer)?;
                    }
                }
                other => {
                    return Err(file.error(
                        Some(key.span()),
                        format!("unknown key '{other}'; there are: tools, state"),
                    ));
                }
            }
        }
        Ok(mapping)
    }

    fn point(
        &mut self,
        file: &MappingFile<'_>,
        key: &Spanned<Cow<'_, str>>,
        value: &Spanned<DeValue<'_>>,
    ) -> Result<(), MappingError> {
        let pointer = file.pointer_of(value)?;
        let name = key.get_ref().as_ref();
        match STATE.iter().find(|(ours, _)| *ours == name) {
            Some((_, debug_info)) => self.state.push((debug_info, pointer)),
            None if name == ERROR => self.error = Some(pointer),
            None => {
                let known = STATE
                    .iter()
                    .map(|(ours, _)| *ours)
                    .chain([ERROR])
                    .collect::<Vec<_>>()
                    .join(", ");
                return Err(file.error(
                    Some(key.span()),
                    format!("unknown key '{name}' in [state]; there are: {known}"),
                ));
            }
        }
        Ok(())
    }

    /// The call as one of the eleven; none where the file does not name the tool.
    pub(crate) fn call(&self, call: &ToolCall) -> Option<ToolCall> {
        self.tools.call(call)
    }

    /// What a result says of the world, under the keys of the published server's debug information:
    /// the structured content, else the first text in which a pointer finds something.
    pub(crate) fn state(&self, structured: Option<&Value>, texts: &[String]) -> Map<String, Value> {
        let sources = sources(structured, texts);
        let find = |(key, pointer): &(&'static str, String)| {
            Some((
                (*key).to_owned(),
                sources
                    .iter()
                    .find_map(|source| source.pointer(pointer))?
                    .clone(),
            ))
        };
        self.state.iter().filter_map(find).collect()
    }

    /// What a result says went wrong, if it does.
    pub(crate) fn error(&self, structured: Option<&Value>, texts: &[String]) -> Option<String> {
        let pointer = self.error.as_ref()?;
        let sources = sources(structured, texts);
        match sources.iter().find_map(|source| source.pointer(pointer))? {
            Value::Null | Value::Bool(false) => None,
            Value::String(text) if text.is_empty() => None,
            Value::String(text) => Some(text.clone()),
            other => Some(other.to_string()),
        }
    }
}

/// Where pointers look: the structured content, then every text from its first brace on that
/// is a JSON object.
fn sources(structured: Option<&Value>, texts: &[String]) -> Vec<Value> {
    let object = |text: &String| serde_json::from_str::<Value>(&text[text.find('{')?..]).ok();
    structured
        .cloned()
        .into_iter()
        .chain(texts.iter().filter_map(object))
        .collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    const FILE: &str = r#"
[tools.drive_to]
is = "nav_to"
arguments = { receptacle_name = "place" }

[tools.grasp]
is = "pick"
arguments.marker_id = "number"

[state]
graph = "/world"
held = "/robot/holds"
error = "/error"
"#;

    #[test]
    fn tools_and_state_of_another_server() {
        let mapping = Mapping::parse(FILE).unwrap();
        let call = mapping
            .call(&ToolCall::new(
                "drive_to",
                json!({"place": "table_1", "speed": 2}),
            ))
            .unwrap();
        assert_eq!(call.name, "nav_to");
        assert_eq!(
            call.arguments,
            json!({"speed": 2, "receptacle_name": "table_1"})
        );
        assert_eq!(mapping.call(&ToolCall::new("drive_by", json!({}))), None);
        let structured = json!({"robot": {"holds": "cup"}, "error": ""});
        let texts = [
            "done".to_owned(),
            "State: {\"world\": {\"table_1\": [\"cup\"]}}".to_owned(),
        ];
        let state = mapping.state(Some(&structured), &texts);
        assert_eq!(
            Value::Object(state),
            json!({"world_graph": {"table_1": ["cup"]}, "CURRENT_INV": "cup"})
        );
        assert_eq!(mapping.error(Some(&structured), &texts), None);
        assert_eq!(
            mapping.error(Some(&json!({"error": "stuck"})), &[]),
            Some("stuck".into())
        );
    }

    #[test]
    fn mistakes_have_lines() {
        let error = |text: &str| Mapping::parse(text).unwrap_err().to_string();
        assert_eq!(
            error("[tools.a]\nis = \"fly\"\n").split(':').next(),
            Some("line 2, column 6")
        );
        assert!(
            error("[tools.a]\nis = \"pick\"\narguments.place = \"x\"\n").starts_with(
                "line 3, column 11: pick takes no argument 'place'; it takes marker_id"
            )
        );
        assert!(error("[tools.a]\narguments.place = \"x\"\n").contains("needs 'is'"));
        assert!(
            error("[state]\ngraph = \"world\"\n")
                .starts_with("line 2, column 9: 'world' is not a JSON pointer")
        );
        assert!(
            error("[state]\npose = \"/x\"\n")
                .contains("there are: graph, held, landmark, markers, position, error")
        );
        assert!(error("[state\n").starts_with("line 1"));
        assert!(error("state = 3\n").contains("state must be a table"));
        assert!(error("[stat]\n").contains("unknown key 'stat'"));
    }
}
