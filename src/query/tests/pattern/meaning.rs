//! What conditions and whole patterns mean on plain rows.

use std::ops::Range;

use proptest::prelude::*;
use reel_query::pattern::{Condition, Pattern, StepRow, Value};

/// A step: its columns, everything else null.
#[derive(Clone, Debug, Default)]
struct Step(Vec<(&'static str, Value<'static>)>);

impl StepRow for Step {
    fn value(&self, column: &str) -> Value<'_> {
        self.0
            .iter()
            .find(|(name, _)| *name == column)
            .map_or(Value::Null, |(_, value)| *value)
    }
}

/// `tool argument`, a `-` before it for a failed call.
fn episode(calls: &[&'static str]) -> Vec<Step> {
    calls
        .iter()
        .map(|call| {
            let (tool, argument) = call
                .trim_start_matches('-')
                .split_once(' ')
                .unwrap_or((call.trim_start_matches('-'), ""));
            let mut columns = vec![("tool", Value::Text(tool))];
            columns.extend((!argument.is_empty()).then_some(("argument", Value::Text(argument))));
            columns.extend(
                call.starts_with('-')
                    .then_some(("error_code", Value::Text("door_closed"))),
            );
            Step(columns)
        })
        .collect()
}

fn fits(condition: &str, step: &Step) -> bool {
    Condition::parse(condition)
        .unwrap_or_else(|error| panic!("{error}"))
        .fits(std::slice::from_ref(step), 0)
}

#[test]
fn conditions_mean_what_sql_means() {
    let step = Step(vec![
        ("tool", Value::Text("place")),
        ("argument", Value::Text("table_10%")),
        ("goal_object", Value::Flag(true)),
        ("reward", Value::Number(-0.5)),
        ("candidates", Value::Number(2.0)),
    ]);
    let yes = reel_world::words! {
        place "_" any "place[ok]" "[ok]" "!ask" "!place[failed]" "(pick|place)" "!(pick|open)"
        "[goal_object]" "[tool in ('place', 'open')]" "[reward < 0 and candidates >= 2]"
        "[held IS NULL AND NOT visible IS NOT NULL]" "[reward = -0.5]" "[not reward > 0]"
        "[argument like '%able%']" "[argument like 'table__0\\%']" "[argument not like 'tab']"
        "[argument is not null]" "[held is null]" "[goal_receptacle is not true]"
        "[goal_object = true]" "[argument = \"table_10%\"]" "[not (ok and tool = 'ask')]"
        "[held = 'x' or ok]" "![held = 'x']" "!place[held = 'x']" "[reward not in (1, 2)]"
        "[tool > 'pick']"
    };
    let no = reel_world::words! {
        ask "!place" "!_" "place[failed]" "[not goal_object]" "[goal_receptacle]"
        "[not goal_receptacle]" "[held = 'x']" "[held <> 'x']" "[not held = 'x']"
        "[held not in ('x')]" "[held like '%']" "[not held like '%']" "[argument like 'table']"
        "[argument like '%_%1']" "[reward = 'x']" "[tool = 1]" "[argument@-1 is not null]"
        "[argument = argument@-1]" "[held = 'x' and ok]" "[argument like '']"
    };
    yes.iter()
        .for_each(|condition| assert!(fits(condition, &step), "{condition}"));
    no.iter()
        .for_each(|condition| assert!(!fits(condition, &step), "{condition}"));
}

/// A pattern, the calls of an episode, the match to find, the number of matches that are not empty.
type Case<'a> = (&'a str, &'a [&'static str], Option<Range<usize>>, usize);

#[test]
fn patterns_answer_the_questions_they_are_for() {
    let canonical = "nav_to show_object_by_category gaze_at? pick nav_to show_receptacles? place";
    let swing = "nav_to nav_to[argument <> argument@-1] (nav_to[argument = argument@-2]){2,}";
    let calls = [
        "nav_to a", "nav_to b", "nav_to a", "nav_to b", "nav_to a", "-pick 1", "ask", "pick 1",
        "place 2",
    ];
    #[rustfmt::skip]
    let cases: &[Case] = &[
        // Tools of another agent, which may be called like our keywords.
        (
            "'write_file' !(\"run_tests\")* $",
            &["read", "write_file", "run_tests", "write_file", "read"],
            Some(3..5),
            1,
        ),
        ("\"any\"", &["any", "all", "any"], Some(0..1), 2),
        (
            canonical,
            &[
                "nav_to a",
                "show_object_by_category",
                "pick 1",
                "nav_to b",
                "place 1",
                "finish",
            ],
            Some(0..5),
            1,
        ),
        (
            canonical,
            &[
                "nav_to a",
                "show_object_by_category",
                "ask",
                "pick 1",
                "nav_to b",
                "place 1",
            ],
            None,
            0,
        ),
        (swing, &calls, Some(0..5), 1),
        (swing, &["nav_to a", "nav_to a", "nav_to a", "nav_to a"], None, 0),
        ("^ !ask* pick", &calls, Some(0..6), 1),
        ("^ !ask* pick[ok]", &calls, None, 0),
        ("pick[error = 'door_closed'] .. pick[ok]", &calls, Some(5..8), 1),
        ("pick[failed] > ask", &calls, Some(5..7), 1),
        ("nav_to", &calls, Some(0..1), 5),
        ("nav_to+", &calls, Some(0..5), 1),
        ("nav_to{2}", &calls, Some(0..2), 2),
        ("place $", &calls, Some(8..9), 1),
        ("^ $", &[], Some(0..0), 0),
        ("ask*", &calls, Some(0..0), 1),
        ("ask | pick", &calls, Some(5..6), 3),
    ];
    for (text, calls, found, count) in cases {
        let pattern = Pattern::parse(text).unwrap_or_else(|error| panic!("{error}"));
        let masks = pattern.masks(&episode(calls));
        let mut matcher = pattern.matcher();
        assert_eq!(matcher.find(&masks), *found, "{text}");
        assert_eq!(matcher.count(&masks), *count, "{text}");
        assert_eq!(matcher.is_match(&masks), found.is_some(), "{text}");
    }
}

#[test]
fn a_condition_counts_once() {
    let pattern = Pattern::parse("nav_to pick[ok] nav_to _ .. pick[ok]").unwrap();
    assert_eq!(pattern.conditions().len(), 2);
    assert_eq!(
        pattern.conditions()[1].to_string(),
        "(tool = 'pick') and (error_code is null)"
    );
}

proptest! {
    #[test]
    fn a_condition_as_written_is_the_same_condition(condition in condition()) {
        let written = format!("[{condition}]");
        prop_assert_eq!(Condition::parse(&written).unwrap().to_string(), condition);
    }
}

/// Conditions in the form in which they are shown.
fn condition() -> impl Strategy<Value = String> {
    let column = prop::sample::select(vec!["argument", "reward", "goal_object", "argument@-2"]);
    let leaf = (column, 0..6).prop_map(|(column, form)| match form {
        0 => format!("{column} <= -1.5"),
        1 => format!("{column} = 'it''s'"),
        2 => format!("{column} in (1, 2)"),
        3 => format!("{column} like '%_\\%'"),
        4 => format!("{column} is null"),
        _ => column.to_owned(),
    });
    leaf.prop_recursive(3, 12, 3, |inner| {
        prop_oneof![
            prop::collection::vec(inner.clone(), 2..4)
                .prop_map(|parts| format!("({})", parts.join(") and ("))),
            prop::collection::vec(inner.clone(), 2..4)
                .prop_map(|parts| format!("({})", parts.join(") or ("))),
            inner.clone().prop_map(|part| format!("not ({part})")),
            inner.prop_map(|part| format!("({part}) is true")),
        ]
    })
}
