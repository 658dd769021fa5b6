//! A case for every rule, and what decides between several that hold.

use std::collections::BTreeSet;

use reel_query::QuerySession;
use reel_tables::Store;
use reel_taxonomy::{RuleSet, classify};
use reel_world::{ErrorCode, Family, record::Backend, record::EndReason};
use tempfile::TempDir;

use crate::{
    classified, found,
    play::{DISTRACTOR, Play, TARGET, success},
};

const MUG: &str = "mug_1_on_table_1_at_t";
const TWIN: &str = "clock_white_7_on_table_2_at_t";

/// An episode with what has to be found in it: sub-class, decisive step, other findings.
type Case = (Play, &'static str, i32, &'static [(&'static str, i32)]);

fn begin(number: usize, family: Family) -> Play {
    Play::new(&format!("{number:02}"), family, 1)
        .nav("table_1")
        .find("alarm clock")
}

fn swing(play: Play, places: &[&str], times: usize) -> Play {
    (0..times).fold(play, |play, turn| play.nav(places[turn % places.len()]))
}

fn cases() -> Vec<Case> {
    use Family::{FDO, FDP, SUL};
    let horizon = |play: Play| play.ended(EndReason::Horizon);
    let cases: Vec<Box<dyn Fn(usize) -> Case>> = vec![
        // paper, Key Action Missing; outranks the wrong object, which is another finding
        Box::new(|n| {
            (
                begin(n, SUL)
                    .pick(DISTRACTOR)
                    .nav("desk_1")
                    .place("desk_1")
                    .finish(),
                "missing_ask",
                2,
                &[("wrong_attribute", 2)],
            )
        }),
        // asked, but only after the deed
        Box::new(|n| {
            (
                begin(n, SUL)
                    .pick(DISTRACTOR)
                    .ask("This?", "No, the white one.")
                    .nav("desk_1")
                    .place("desk_1")
                    .finish(),
                "missing_ask",
                2,
                &[("wrong_attribute", 2)],
            )
        }),
        Box::new(|n| {
            (
                begin(n, SUL)
                    .ask("Which?", "The white one.")
                    .pick(DISTRACTOR)
                    .finish(),
                "ignored_answer",
                3,
                &[("wrong_attribute", 3)],
            )
        }),
        // paper, Wrong Object Selection, with its stale marker
        Box::new(|n| {
            (
                begin(n, FDP)
                    .fails("gaze_at", ErrorCode::UnknownMarker)
                    .pick(DISTRACTOR)
                    .nav("desk_1")
                    .place("desk_1")
                    .finish(),
                "wrong_attribute",
                3,
                &[("stale_marker", 2)],
            )
        }),
        Box::new(|n| {
            (
                begin(n, FDP)
                    .with_object("clock_white_7", "alarm clock", "table_2")
                    .pick(TWIN)
                    .nav("desk_1")
                    .place("desk_1")
                    .finish(),
                "wrong_instance",
                2,
                &[],
            )
        }),
        Box::new(|n| {
            (
                begin(n, FDP)
                    .pick(MUG)
                    .nav("desk_1")
                    .place("desk_1")
                    .finish(),
                "wrong_kind",
                2,
                &[],
            )
        }),
        // nobody has to ask which of the clocks who takes a mug
        Box::new(|n| {
            (
                begin(n, SUL)
                    .pick(MUG)
                    .nav("desk_1")
                    .place("desk_1")
                    .finish(),
                "wrong_kind",
                2,
                &[],
            )
        }),
        // paper, Similar Furniture Confusion
        Box::new(|n| {
            (
                begin(n, FDP)
                    .pick(TARGET)
                    .nav("desk_1")
                    .nav("desk_2")
                    .place("desk_2")
                    .finish(),
                "similar_furniture",
                5,
                &[],
            )
        }),
        Box::new(|n| {
            (
                begin(n, FDP)
                    .pick(TARGET)
                    .nav("table_2")
                    .place("table_2")
                    .finish(),
                "wrong_receptacle",
                4,
                &[],
            )
        }),
        // put back and nothing taken instead: what is missing is the rest of the work
        Box::new(|n| {
            (
                begin(n, FDP).pick(DISTRACTOR).place("table_1").finish(),
                "premature_finish",
                4,
                &[],
            )
        }),
        Box::new(|n| {
            (
                horizon(
                    begin(n, FDP)
                        .pick(DISTRACTOR)
                        .place("table_1")
                        .find("alarm clock"),
                ),
                "timeout",
                4,
                &[],
            )
        }),
        // put down elsewhere it is still the wrong one
        Box::new(|n| {
            (
                horizon(
                    begin(n, FDP)
                        .pick(DISTRACTOR)
                        .place("table_2")
                        .find("alarm clock"),
                ),
                "wrong_attribute",
                2,
                &[],
            )
        }),
        // mended: the wrong object was put back, the wrong place is what is left
        Box::new(|n| {
            (
                begin(n, FDP)
                    .pick(DISTRACTOR)
                    .place("table_1")
                    .pick(TARGET)
                    .place("desk_2")
                    .finish(),
                "similar_furniture",
                5,
                &[],
            )
        }),
        Box::new(|n| {
            (
                begin(n, FDO)
                    .pick(TARGET)
                    .nav("cabinet_1")
                    .fails("place", ErrorCode::DoorClosed)
                    .finish(),
                "missing_open",
                4,
                &[],
            )
        }),
        Box::new(|n| {
            (
                horizon(begin(n, FDO).pick(TARGET).nav("cabinet_1")),
                "missing_open",
                3,
                &[],
            )
        }),
        // paper, Lost Action Memory: eight calls, from the fifth on
        Box::new(|n| {
            (
                horizon(swing(
                    begin(n, FDP).nav("table_1").pick(TARGET),
                    &["desk_1", "desk_2"],
                    8,
                )),
                "oscillation",
                4,
                &[],
            )
        }),
        Box::new(|n| {
            (
                horizon(swing(
                    begin(n, FDP).pick(TARGET),
                    &["desk_1", "desk_2", "table_2"],
                    7,
                )),
                "oscillation",
                3,
                &[],
            )
        }),
        // broken off in time: the loop is not what failed
        Box::new(|n| {
            (
                swing(begin(n, FDP), &["desk_1", "table_1"], 4)
                    .pick(DISTRACTOR)
                    .finish(),
                "wrong_attribute",
                6,
                &[],
            )
        }),
        Box::new(|n| {
            let play = begin(n, FDP);
            (
                (0..4)
                    .fold(play, |play, _| play.fails("pick", ErrorCode::OutOfReach))
                    .finish(),
                "repeated_failure",
                2,
                &[("premature_finish", 6)],
            )
        }),
        Box::new(|n| {
            (
                begin(n, FDP)
                    .pick(TARGET)
                    .nav("desk_1")
                    .finish()
                    .remembering("I picked the clock. I placed it on the desk."),
                "false_history",
                4,
                &[("missing_place", 4)],
            )
        }),
        Box::new(|n| {
            (
                begin(n, FDP)
                    .nav("desk_1")
                    .finish()
                    .remembering("went to table_1; picked 2"),
                "false_history",
                3,
                &[("missing_pick", 2), ("premature_finish", 3)],
            )
        }),
        // what failed, and is remembered as failed, is no false memory
        Box::new(|n| {
            (
                begin(n, FDP)
                    .fails("pick", ErrorCode::OutOfReach)
                    .finish()
                    .remembering("picked 2 (failed: out_of_reach)"),
                "premature_finish",
                3,
                &[],
            )
        }),
        Box::new(|n| {
            (
                begin(n, FDP).pick(TARGET).nav("desk_1").finish(),
                "missing_place",
                4,
                &[],
            )
        }),
        Box::new(|n| {
            (
                begin(n, FDP).pick(TARGET).finish(),
                "premature_finish",
                3,
                &[],
            )
        }),
        Box::new(|n| (begin(n, FDP).finish(), "premature_finish", 2, &[])),
        Box::new(|n| {
            (
                begin(n, FDP)
                    .nav("desk_1")
                    .fails("place", ErrorCode::NothingHeld)
                    .finish(),
                "missing_pick",
                2,
                &[],
            )
        }),
        Box::new(|n| {
            (
                Play::new(&format!("{n:02}"), FDP, 1)
                    .nav("table_1")
                    .nav("desk_1")
                    .fails("place", ErrorCode::NothingHeld)
                    .finish(),
                "never_looked",
                2,
                &[],
            )
        }),
        Box::new(|n| {
            (
                begin(n, FDP)
                    .fails("pick", ErrorCode::UnknownMarker)
                    .fails("gaze_at", ErrorCode::MarkerNotInView)
                    .finish(),
                "stale_marker",
                2,
                &[],
            )
        }),
        Box::new(|n| {
            let look = |play: Play, place: &str| play.nav(place).find("alarm clock");
            let places = ["table_2", "desk_1", "desk_2", "cabinet_1"].repeat(2);
            (
                horizon(places.into_iter().fold(begin(n, FDP), look)),
                "exploration",
                0,
                &[],
            )
        }),
        Box::new(|n| {
            let nonsense = [
                ErrorCode::UnparsableOutput,
                ErrorCode::UnknownTool,
                ErrorCode::BadArguments,
            ];
            (
                horizon(
                    nonsense
                        .into_iter()
                        .fold(begin(n, FDP), |play, code| play.fails("say", code)),
                ),
                "invalid_output",
                2,
                &[],
            )
        }),
        Box::new(|n| {
            (
                begin(n, FDP).pick(TARGET).nav("desk_1").drops().finish(),
                "physical_failure",
                3,
                &[],
            )
        }),
        Box::new(|n| {
            (
                begin(n, FDP)
                    .fails("pick", ErrorCode::BackendError)
                    .finish(),
                "primitive_failure",
                2,
                &[("premature_finish", 3)],
            )
        }),
        Box::new(|n| {
            (
                horizon((0..6).fold(begin(n, FDP).pick(TARGET), |play, _| {
                    play.find("alarm clock")
                })),
                "timeout",
                3,
                &[],
            )
        }),
        Box::new(|n| {
            (
                begin(n, FDP).pick(TARGET).ended(EndReason::Fault),
                "unexplained",
                2,
                &[],
            )
        }),
    ];
    cases
        .iter()
        .enumerate()
        .map(|(number, case)| case(number))
        .collect()
}

#[test]
fn every_rule_finds_its_case() {
    let dir = TempDir::new().unwrap();
    let cases = cases();
    let mut plays: Vec<Play> = cases.iter().map(|(play, ..)| play.clone()).collect();
    // who succeeds is not classified
    plays.push(success("zz", Family::FDP, 1));
    let found = classified(dir.path(), &plays);
    let mut wrong = String::new();
    for (found, (play, sub_class, step, secondary)) in found.iter().zip(&cases) {
        assert_eq!(found.episode_id, play.header.episode_id);
        let others: Vec<(&str, i32)> = found
            .secondary
            .iter()
            .map(|(name, step)| (name.as_str(), *step))
            .collect();
        if (found.sub_class.as_str(), found.step, &others[..]) != (*sub_class, *step, secondary) {
            wrong += &format!(
                "{}: {} at {} and {others:?}, not {sub_class} at {step} and {secondary:?}\n",
                found.episode_id, found.sub_class, found.step
            );
        }
        assert_eq!(
            RuleSet::built_in().class_of(&found.sub_class),
            Some(found.class.as_str())
        );
        assert!(
            found.step <= found.last_step && !found.fields.is_empty(),
            "{found:?}"
        );
        assert_eq!(found.evidence, "full");
    }
    assert_eq!(wrong, "");
    assert_eq!(found.len(), cases.len());
    // no rule is without a case, but for those of which another rule of the same sub-class has one
    let tested: BTreeSet<&str> = cases.iter().map(|(_, sub_class, ..)| *sub_class).collect();
    let known = RuleSet::built_in();
    let untested: Vec<&str> = known
        .rules()
        .iter()
        .map(|rule| rule.sub_class.as_str())
        .filter(|name| !tested.contains(name))
        .collect();
    assert_eq!(untested, [""; 0], "write a case for it");
}

#[test]
fn without_physics_the_evidence_is_reduced() {
    let dir = TempDir::new().unwrap();
    let mut play = begin(0, Family::FDP).pick(DISTRACTOR).finish();
    play.header.backend = Backend::Robot;
    let found = classified(dir.path(), &[play]);
    assert_eq!(
        (found[0].sub_class.as_str(), found[0].evidence.as_str()),
        ("wrong_attribute", "reduced")
    );
}

#[test]
fn a_file_more_is_a_rule_more() {
    let dir = TempDir::new().unwrap();
    let play = begin(0, Family::FDP)
        .pick(TARGET)
        .nav("desk_2")
        .place("desk_2")
        .finish();
    assert_eq!(
        classified(dir.path(), &[play])[0].sub_class,
        "similar_furniture"
    );
    let session = || QuerySession::new(Store::open(dir.path().join("store")).unwrap()).unwrap();
    let rules = dir.path().join("rules");
    std::fs::create_dir(&rules).unwrap();
    let rule = "-- desk_two\n--\n-- It always puts things on desk_2.\n--\n-- Class: Object Confusion\n-- Sub-class: desk_two\n-- Priority: 5\nSELECT sequence_find(steps, 'place[ok and receptacle = ''desk_2'']') AS found FROM episodes\n";
    std::fs::write(rules.join("desk_two.sql"), rule).unwrap();
    let found = found(&session(), &RuleSet::with_folder(&rules).unwrap());
    assert_eq!(
        (found[0].sub_class.as_str(), found[0].step),
        ("desk_two", 4)
    );
    assert_eq!(found[0].secondary, [("similar_furniture".to_owned(), 4)]);
    assert_eq!(
        found[0].fields,
        ["steps.error_code", "steps.receptacle", "steps.tool"]
    );
    // what SQL does not take is said with the rule's words, before anything is written
    std::fs::write(
        rules.join("desk_two.sql"),
        rule.replace("sequence_find(", "sequence_fynd("),
    )
    .unwrap();
    let refused = classify(&session(), &RuleSet::with_folder(&rules).unwrap(), None)
        .unwrap_err()
        .to_string();
    assert!(refused.contains("sequence_fynd"), "{refused}");
}
