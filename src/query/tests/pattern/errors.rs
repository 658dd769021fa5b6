//! The texts of errors, as a person sees them.

use reel_query::pattern::{ColumnKind, Condition, Pattern};

const COLUMNS: &[(&str, ColumnKind)] = &[
    ("tool", ColumnKind::Text),
    ("argument", ColumnKind::Text),
    ("error_code", ColumnKind::Text),
    ("goal_object", ColumnKind::Flag),
    ("reward", ColumnKind::Number),
];

/// Every refused pattern and what is said: `errors.txt` beside this file.
#[test]
fn errors_say_what_where_and_what_to_do() {
    let patterns = reel_world::words! {
        "" "nav_to pik place" navigate_to teleport "pick place)" "(pick | place" "pick |" "> pick"
        "pick+?" "pick{3,2}" "pick{0}" "pick{200}" "pick{,3}" "pick[error = door_closed"
        "pick[error = 'door_closed]" "pick[error == 'x']" "pick[held = null]"
        "pick[tool in ('open', 1)]" "pick[argument = argument@-99]" "pick[argument@2 = 'a']" "_[]"
        "!(pick place)" "nav_to\n  pick & place" "\u{e9}" "(ask{50}){50}" "pick[rewart < 0]"
        "pick[argument < 0]" "pick[argument = reward@-1]" "pick[reward]" "pick[goal_object = 'yes']"
    };
    let refused = |text: &str| {
        Pattern::parse(text)
            .and_then(|pattern| pattern.check(COLUMNS))
            .expect_err(text)
            .to_string()
    };
    let mut found: Vec<String> = patterns.iter().map(|text| refused(text)).collect();
    found.push(Condition::parse("pick place").unwrap_err().to_string());
    found.push(
        Pattern::parse(&"ask ".repeat(2000))
            .unwrap_err()
            .to_string(),
    );
    found.push(Pattern::parse(&"(".repeat(100)).unwrap_err().to_string());
    found.push(
        Pattern::parse(&(0..65).map(|n| format!("[step={n}]")).collect::<String>())
            .unwrap_err()
            .to_string(),
    );
    let found = found.join("\n\n") + "\n";
    assert!(
        found == include_str!("errors.txt"),
        "errors.txt is not what is said:\n{found}"
    );
}

#[test]
fn columns_that_are_there_are_fine() {
    let text = "pick[ok and goal_object] [reward@-1 < 0 and argument = argument@-2] [error in ('a') or goal_object is not true]";
    Pattern::parse(text).unwrap().check(COLUMNS).unwrap();
    Condition::parse_for("pick[reward < 0]", COLUMNS).unwrap();
    assert!(Condition::parse_for("pick[rewrad < 0]", COLUMNS).is_err());
}
