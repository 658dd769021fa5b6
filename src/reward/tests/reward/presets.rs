//! Presets by name, as files, and the pages that are made from them.

use proptest::prelude::*;
use reel_reward::{Base, Preset, Term};
use serde_json::Value;

const SCHEMA: &str = "schemas/reward_preset.schema.json";
const EXAMPLE: &str = include_str!("../../../../schemas/reward_preset.example.toml");

fn error(text: &str) -> String {
    Preset::from_toml(text).expect_err(text).to_string()
}

/// A file of one base with more lines.
fn file(base: &str, lines: &str) -> String {
    format!("name = \"mine\"\nbase = \"{base}\"\n{lines}")
}

#[test]
fn presets_have_names_and_versions() {
    let built_in = Preset::built_in();
    assert!(
        built_in
            .iter()
            .all(|preset| Preset::parse(preset.name()).as_ref() == Some(preset))
    );
    assert_eq!(Preset::parse("none"), None);
    assert_eq!(Preset::default(), Preset::paper());
    let versions: std::collections::BTreeSet<_> = built_in.iter().map(Preset::version).collect();
    assert_eq!(versions.len(), built_in.len());
}

#[test]
fn a_version_is_of_the_content_and_not_of_name_order_or_spelling() {
    let same = Preset::from_toml(&file(
        "paper",
        "# published\n[rules]\ngamma = 99e-2\n[weights]\nall_hold = 2\ntime = -0.030",
    ))
    .unwrap();
    assert_eq!(
        (same.name(), same.version()),
        ("mine", Preset::paper().version())
    );
    for other in [
        "[weights]\ntime = -0.031",
        "[rules]\ngamma = 1",
        "[rules]\nfree_steps = 4",
        "[rules]\nask_limit = 0",
    ] {
        assert_ne!(
            Preset::from_toml(&file("paper", other)).unwrap().version(),
            Preset::paper().version(),
            "{other}"
        );
    }
    let anti = Preset::from_toml(&file("real-repo", "[rules]\nanti_exploit = true")).unwrap();
    assert_ne!(anti.version(), Preset::real_repo().version());
}

/// The version stands in traces and tables: a change of the rules must change it,
/// and nothing else may.
#[test]
fn the_versions_of_the_built_in_presets_are_known() {
    let versions = Preset::built_in().map(|preset| preset.version().short());
    assert_eq!(
        versions,
        ["fc65e7ea1855", "81e46d38ce46", "20759209e021"],
        "if the rules changed, count up the base's revision and write the new versions here"
    );
}

#[test]
fn the_published_weights_are_those_of_the_definitions() {
    let weights = |base: Base| {
        base.terms()
            .map(|term| (term.name(), term.published_weight()))
            .collect::<Vec<_>>()
    };
    assert_eq!(
        weights(Base::Paper)[..4],
        [
            ("matched", 1.5),
            ("all_hold", 2.0),
            ("progress", 2.0),
            ("reversed", -0.5)
        ]
    );
    let off: f64 = Base::RealRepo
        .terms()
        .filter(|term| term.is_anti_exploit())
        .map(Term::published_weight)
        .sum();
    assert!((off - (1.0 + 0.3 - 0.2 - 0.3 - 0.2 - 3.0)).abs() < 1e-12);
}

#[test]
fn the_example_file_is_a_preset() {
    let preset = Preset::from_toml(EXAMPLE).unwrap();
    assert_eq!((preset.name(), preset.base()), ("patient", Base::RealRepo));
    assert_eq!(
        (preset.weight(Term::StepPenalty), preset.gamma()),
        (0.0, 1.0)
    );
    assert_eq!(
        preset.weight(Term::DiffMatch),
        Term::DiffMatch.published_weight()
    );
    for term in Base::RealRepo.terms() {
        assert!(
            EXAMPLE.contains(term.name()),
            "the example does not name {}",
            term.name()
        );
    }
}

#[test]
fn errors_say_where_and_what_to_do() {
    assert_eq!(
        error("name = \"mine\"\nbase = "),
        "line 2, column 8: string values must be quoted, expected literal string"
    );
    assert_eq!(
        error(&file("paper", "[weights]\n  tme = 1.0")),
        "line 4, column 3: unknown key 'tme' in [weights] of base paper; did you mean 'time'?"
    );
    assert_eq!(
        error(&file("paper", "[rules]\nnav_window = 3")),
        "line 4, column 1: unknown key 'nav_window' in [rules] of base paper; there are: gamma, free_steps, ask_limit"
    );
    assert_eq!(
        error(&file("paper", "wieghts = 3")),
        "line 3, column 1: unknown key 'wieghts' in a reward preset; did you mean 'weights'?"
    );
    assert_eq!(
        error(&file("paper", "[weights]\ntime = nan")),
        "line 4, column 8: time must be a finite number, not nan"
    );
    assert_eq!(
        error(&file("paper", "[weights]\ntime = -inf")),
        "line 4, column 8: time must be a finite number, not -inf"
    );
    assert_eq!(
        error(&file("paper", "[weights]\ntime = 1e999")),
        "line 4, column 8: time must be a finite number, not 1e999"
    );
    let huge =
        "line 4, column 8: time must be between -1e9 and 1e9, so that no total overflows, not ";
    assert_eq!(
        error(&file("paper", "[weights]\ntime = 1e308")),
        format!("{huge}1e308")
    );
    assert_eq!(
        error(&file("paper", "[weights]\ntime = -1000000001")),
        format!("{huge}-1000000001")
    );
    assert_eq!(
        error(&file("paper", "[weights]\ntime = \"1\"")),
        "line 4, column 8: time must be a finite number, not \"1\""
    );
    assert_eq!(
        error(&file("paper", "[rules]\ngamma = 1.5")),
        "line 4, column 9: gamma must be a number from 0 to 1, not 1.5"
    );
    assert_eq!(
        error(&file("paper", "[rules]\nfree_steps = -1")),
        "line 4, column 14: free_steps must be a whole number from 0 to 4294967295, not -1"
    );
    assert_eq!(
        error(&file("real-repo", "[rules]\nanti_exploit = 1")),
        "line 4, column 16: anti_exploit must be true or false, not 1"
    );
    assert_eq!(
        error(&file("papers", "")),
        "line 2, column 8: base must be \"paper\", \"real-repo\" or \"real-trainer\", not \"papers\""
    );
    assert_eq!(
        error("name = \"mine\""),
        "a reward preset needs 'base': \"paper\", \"real-repo\" or \"real-trainer\""
    );
    assert!(
        error("base = \"paper\"").starts_with("a reward preset needs 'name': lower-case letters")
    );
    assert!(
        error("name = \"paper\"\nbase = \"paper\"")
            .contains("not the name of a built-in preset, not \"paper\"")
    );
    assert_eq!(
        error(&file("paper", "weights = 3")),
        "line 3, column 11: weights must be a table, not 3"
    );
}

#[test]
fn the_page_about_rewards_has_every_term_with_its_weight() {
    let page = include_str!("../../../../docs/rewards.md");
    for term in Term::ALL {
        let (component, name, doc) = (term.component(), term.name(), term.doc());
        let weight = format!("{:?}", term.published_weight());
        for base in term.bases() {
            let row = match base {
                Base::RealRepo => format!("| `{name}` | {weight} |"),
                Base::Paper | Base::RealTrainer => format!("| {component} | `{name}` | {weight} |"),
            };
            assert!(
                page.contains(&row),
                "docs/rewards.md has no row that begins with {row}"
            );
        }
        assert!(!doc.is_empty());
    }
    for base in Preset::json_schema()["oneOf"].as_array().unwrap() {
        for (rule, schema) in base["properties"]["rules"]["properties"]
            .as_object()
            .unwrap()
        {
            let (begin, default) = (
                format!("| `{rule}` |"),
                format!("| {} |", schema["default"]),
            );
            assert!(
                page.lines()
                    .any(|row| row.starts_with(&begin) && row.contains(&default)),
                "docs/rewards.md: {begin} {default}"
            );
        }
    }
}

/// What the schema refuses is what the reader refuses.
#[test]
fn schema_and_reader_agree() {
    let schema = jsonschema::validator_for(&Preset::json_schema()).unwrap();
    let valid = |text: &str| schema.is_valid(&toml::from_str::<Value>(text).unwrap());
    let texts = [
        EXAMPLE.to_owned(),
        file("paper", ""),
        file("paper", "[weights]\ntime = 1"),
        file("paper", "[weights]\nwrong_diff = 1.0"),
        file("paper", "[weights]\ntime = true"),
        file("paper", "[weights]\ntime = 1e9"),
        file("paper", "[weights]\ntime = 1e10"),
        file("real-trainer", "[rules]\nmax_steps = 30"),
        file("real-repo", "[rules]\nmax_steps = 30"),
        file("paper", "[rules]\nanti_exploit = true"),
        file(
            "real-repo",
            "[rules]\nanti_exploit = true\ngamma = 0\nnav_window = 0",
        ),
        file("real-repo", "[rules]\nnav_window = 4294967296"),
        file("real-repo", "[rules]\nnav_window = -1"),
        file("real-repo", "[rules]\ngamma = 1.01"),
        file("other", ""),
        file("paper", "more = 1"),
        "name = \"mine\"".to_owned(),
        "base = \"paper\"".to_owned(),
        "name = \"Mine\"\nbase = \"paper\"".to_owned(),
        "name = \"real-repo\"\nbase = \"paper\"".to_owned(),
        "name = \"\"\nbase = \"paper\"".to_owned(),
    ];
    for text in &texts {
        assert_eq!(valid(text), Preset::from_toml(text).is_ok(), "{text}");
    }
    assert_eq!(texts.iter().filter(|text| valid(text)).count(), 6);
}

/// What a TOML file is made of, and what it is not.
const PIECES: &[&str] = &[
    "name",
    "base",
    "weights",
    "rules",
    "time",
    "gamma",
    "=",
    " = ",
    "\n",
    "[",
    "]",
    "\"paper\"",
    "\"",
    "1e9",
    "nan",
    "-",
    "0x",
    "_",
    ".",
    "{",
    "}",
    ",",
    "true",
    "'''",
    "#",
    "é",
    "\u{feff}",
    "1979-05-27",
];

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_text_breaks_the_reader(
        pieces in prop::collection::vec(prop_oneof![prop::sample::select(PIECES).prop_map(str::to_owned), any::<String>()], 0..20),
    ) {
        if let Err(error) = Preset::from_toml(&pieces.concat()) {
            prop_assert!(!error.to_string().is_empty());
        }
    }
}

/// `REEL_BLESS=1 cargo test -p reel-reward` rewrites the schema.
#[test]
#[expect(
    clippy::disallowed_methods,
    reason = "the page lies in a file, and who blesses it says so in the environment"
)]
fn the_schema_is_made_from_the_rules() {
    let path = format!("{}/../../{SCHEMA}", env!("CARGO_MANIFEST_DIR"));
    let schema = serde_json::to_string_pretty(&Preset::json_schema()).unwrap() + "\n";
    if std::env::var_os("REEL_BLESS").is_some() {
        std::fs::write(&path, &schema).unwrap();
    }
    let found = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        found == schema,
        "{SCHEMA} is stale: run REEL_BLESS=1 cargo test -p reel-reward"
    );
}
