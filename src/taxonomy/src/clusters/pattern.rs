//! What several call sequences have in common, in the pattern language of `sequence_match`. Never
//! more: the pattern matches every one of them.

use reel_query::pattern::MAX_CONDITIONS;
use reel_world::ToolSpec;

use super::CallKind;

/// A pattern of the calls that all sequences make in the same order, whatever comes between them;
/// `None` if there is no such call.
pub fn common_pattern(sequences: &[&[CallKind]]) -> Option<String> {
    let (first, others) = sequences.split_first()?;
    let mut common: Vec<&CallKind> = first.iter().collect();
    for other in others {
        common = longest_common(&common, other);
    }
    let mut runs: Vec<(String, usize)> = Vec::new();
    for call in common {
        let step = step(call);
        match runs.last_mut() {
            Some((last, count)) if *last == step => *count += 1,
            _ => runs.push((step, 1)),
        }
    }
    // A pattern has at most so many different conditions.
    runs.truncate(MAX_CONDITIONS / 2);
    let told = runs.into_iter().map(|(step, count)| match count {
        1 => step,
        _ => format!("({step} _*){{{count}}}"),
    });
    let pattern = told.collect::<Vec<_>>().join(" .. ");
    (!pattern.is_empty()).then_some(pattern)
}

/// The longest common subsequence.
fn longest_common<'a>(one: &[&'a CallKind], other: &[CallKind]) -> Vec<&'a CallKind> {
    let width = other.len() + 1;
    let mut lengths = vec![0_u32; (one.len() + 1) * width];
    for row in (0..one.len()).rev() {
        for column in (0..other.len()).rev() {
            lengths[row * width + column] = if *one[row] == other[column] {
                lengths[(row + 1) * width + column + 1] + 1
            } else {
                lengths[(row + 1) * width + column].max(lengths[row * width + column + 1])
            };
        }
    }
    let (mut row, mut column, mut common) = (0, 0, Vec::new());
    while row < one.len() && column < other.len() {
        if *one[row] == other[column] {
            common.push(one[row]);
            (row, column) = (row + 1, column + 1);
        } else if lengths[(row + 1) * width + column] >= lengths[row * width + column + 1] {
            row += 1;
        } else {
            column += 1;
        }
    }
    common
}

/// One call as a step of the pattern.
fn step(call: &CallKind) -> String {
    let quoted = |text: &str| format!("'{}'", text.replace('\'', "''"));
    let mut conditions = Vec::new();
    let tool = if ToolSpec::POLICY
        .iter()
        .any(|spec| spec.paper_name == call.tool)
    {
        call.tool.clone()
    } else {
        conditions.push(format!("tool = {}", quoted(&call.tool)));
        "_".to_owned()
    };
    conditions.push(match &call.error {
        None => "ok".to_owned(),
        Some(class) => format!("error_class = {}", quoted(class)),
    });
    let columns = [
        ("object_match", &call.object),
        ("receptacle_match", &call.receptacle),
    ];
    for (column, value) in columns {
        conditions.extend(
            value
                .as_ref()
                .map(|value| format!("{column} = {}", quoted(value))),
        );
    }
    format!("{tool}[{}]", conditions.join(" and "))
}

#[cfg(test)]
mod tests {
    use reel_query::pattern::{Pattern, StepRow, Value};

    use super::*;

    impl StepRow for CallKind {
        fn value(&self, column: &str) -> Value<'_> {
            match column {
                "tool" => Value::Text(&self.tool),
                "object_match" => self.object.as_deref().map_or(Value::Null, Value::Text),
                "receptacle_match" => self.receptacle.as_deref().map_or(Value::Null, Value::Text),
                "error_class" | "error_code" => {
                    self.error.as_deref().map_or(Value::Null, Value::Text)
                }
                _ => Value::Null,
            }
        }
    }

    fn call(tool: &str, error: Option<&str>) -> CallKind {
        CallKind {
            tool: tool.to_owned(),
            object: (tool == "pick").then(|| "target".to_owned()),
            receptacle: None,
            error: error.map(str::to_owned),
        }
    }

    #[test]
    fn the_pattern_matches_every_sequence_that_it_was_made_from() {
        let one = [
            call("nav_to", None),
            call("pick", Some("moderate")),
            call("pick", Some("moderate")),
            call("it's new", Some("severe")),
            call("finish", None),
        ];
        let other = [
            call("pick", Some("moderate")),
            call("walk_around", None),
            call("pick", Some("moderate")),
            call("it's new", Some("severe")),
            call("nav_to", None),
            call("finish", None),
        ];
        let text = common_pattern(&[&one, &other]).unwrap();
        assert_eq!(
            text,
            "(pick[error_class = 'moderate' and object_match = 'target'] _*){2} .. \
             _[tool = 'it''s new' and error_class = 'severe'] .. finish[ok]"
        );
        let pattern = Pattern::parse(&text).unwrap();
        for sequence in [&one[..], &other] {
            assert!(pattern.matcher().is_match(&pattern.masks(sequence)));
        }
        assert!(!pattern.matcher().is_match(&pattern.masks(&one[..3])));
        assert_eq!(common_pattern(&[&one[..1], &other[..1]]), None);
    }
}
