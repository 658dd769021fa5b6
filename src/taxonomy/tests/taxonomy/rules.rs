//! A case for every rule, and what decides between several that hold.

use std::{collections::BTreeSet, fs, path::Path};

use reel_query::QuerySession;
use reel_tables::Store;
use reel_taxonomy::{RuleSet, classify};
use reel_world::{Digest, ErrorCode, Family, record::Backend, record::EndReason};
use tempfile::TempDir;

use crate::{
    classified, found,
    play::{DISTRACTOR, Play, TARGET, success},
};

/// Episodes with what has to be found in them: family, moves, sub-class and decisive step, other
/// findings. But where they begin with `bare`, they go to table_1 and look for alarm clocks first.
const CASES: &str = "
# paper, Key Action Missing / outranks the wrong object, which is another finding
SUL | pick DISTRACTOR / nav desk_1 / place desk_1 / finish | missing_ask 2 | wrong_attribute 2
# asked, but only after the deed
SUL | pick DISTRACTOR / ask No, the white one. / nav desk_1 / place desk_1 / finish | missing_ask 2 | wrong_attribute 2
SUL | ask The white one. / pick DISTRACTOR / finish | ignored_answer 3 | wrong_attribute 3
# an answer that fits both is no answer
SUL | ask An alarm clock. / pick DISTRACTOR / finish | uninformative_ask 3 | wrong_attribute 3
FDP | pick TARGET / nav desk_1 / place desk_1 / pick TARGET / finish | undone_success 5 | premature_finish 6
FDP | wants MUG desk_1 / pick TARGET / nav desk_1 / place desk_1 / finish | incomplete 5
FDO | nav cabinet_1 / open cabinet_1 / close cabinet_1 / nav table_1 / find alarm clock / pick TARGET / nav cabinet_1 / fails place door_closed / finish | door_closed_again 4 | missing_place 10
FDP | pick TARGET / nav desk_1 / ask Put it down. / again 4 / horizon | repeated_question 5 | repeated_call 5
# paper, Wrong Object Selection, with its stale marker
FDP | fails gaze_at unknown_marker / pick DISTRACTOR / nav desk_1 / place desk_1 / finish | wrong_attribute 3 | stale_marker 2
FDP | with clock_white_7 table_2 / pick TWIN / nav desk_1 / place desk_1 / finish | wrong_instance 2
FDP | pick MUG / nav desk_1 / place desk_1 / finish | wrong_kind 2
# nobody has to ask which of the clocks who takes a mug
SUL | pick MUG / nav desk_1 / place desk_1 / finish | wrong_kind 2
# paper, Similar Furniture Confusion
FDP | pick TARGET / nav desk_1 / nav desk_2 / place desk_2 / finish | similar_furniture 5
FDP | pick TARGET / nav table_2 / place table_2 / finish | wrong_receptacle 4
# put back and nothing taken instead: what is missing is the rest of the work
FDP | pick DISTRACTOR / place table_1 / finish | premature_finish 4
FDP | pick DISTRACTOR / place table_1 / find alarm clock / horizon | timeout 4
# put down elsewhere it is still the wrong one
FDP | pick DISTRACTOR / place table_2 / find alarm clock / horizon | wrong_attribute 2
# mended: the wrong object was put back, the wrong place is what is left
FDP | pick DISTRACTOR / place table_1 / pick TARGET / place desk_2 / finish | similar_furniture 5
FDO | pick TARGET / nav cabinet_1 / fails place door_closed / finish | missing_open 4 | missing_place 5
FDO | pick TARGET / nav cabinet_1 / horizon | missing_open 3
# paper, Lost Action Memory: eight calls, of which the third is the first that could bring nothing new
FDP | nav table_1 / pick TARGET / swing 8 desk_1 desk_2 / horizon | oscillation 6
FDP | pick TARGET / swing 7 desk_1 desk_2 table_2 / horizon | oscillation 6
# broken off in time: the loop is not what failed
FDP | swing 4 desk_1 table_1 / pick DISTRACTOR / finish | wrong_attribute 6
FDP | fails pick out_of_reach / again 3 / finish | repeated_failure 3 | premature_finish 6
FDP | pick TARGET / nav desk_1 / finish / says I picked the clock. I placed it on the desk. | false_history 4 | missing_place 4
FDP | nav desk_1 / finish / says went to table_1; picked 2 | false_history 3 | missing_pick 2 | premature_finish 3
# what failed, and is remembered as failed, is no false memory
FDP | fails pick out_of_reach / finish / says picked 2 (failed: out_of_reach) | premature_finish 3
FDP | pick TARGET / nav desk_1 / finish | missing_place 4
FDP | pick TARGET / finish | premature_finish 3
FDP | finish | premature_finish 2
FDP | nav desk_1 / fails place nothing_held / finish | missing_pick 2 | premature_finish 4
FDP bare | nav table_1 / nav desk_1 / fails place nothing_held / finish | never_looked 2 | premature_finish 3
FDP bare | nav desk_1 / find mug / fails place nothing_held / again 3 / finish | repeated_failure 3 | never_looked 6 | premature_finish 6
FDP | fails pick unknown_marker / fails gaze_at marker_not_in_view / finish | stale_marker 2
FDP | look table_2 / look desk_1 / look desk_2 / look cabinet_1 / nav table_2 / find mug / nav desk_1 / find mug / nav desk_2 / find mug / nav cabinet_1 / find mug / horizon | exploration 0 | oscillation 10
FDP | fails say unparsable_output / fails say unknown_tool / fails say bad_arguments / horizon | invalid_output 2
FDP | fails say unparsable_output / fails say bad_arguments / finish | invalid_output 2 | premature_finish 4
# most of what it wrote were calls
FDP | fails say unparsable_output / nav desk_2 / find mug / fails say bad_arguments / finish | premature_finish 6
# looked, but not where the target stood; numbers of no map explain nothing there
FDP bare | nav desk_1 / find alarm clock / finish | never_looked 2 | premature_finish 2
FDP bare | nav desk_2 / find mug / fails gaze_at no_marker_map / fails gaze_at no_marker_map / finish | never_looked 4 | stale_marker 2
# a door that could not be closed costs nothing
FDP | pick TARGET / nav desk_2 / fails close unknown_marker / finish | premature_finish 5 | stale_marker 4
FDP | pick TARGET / nav desk_1 / drops / finish | physical_failure 3
FDP | fails pick backend_error / finish | primitive_failure 2 | premature_finish 3
FDP | pick TARGET / find alarm clock / again 5 / horizon | repeated_call 4
FDP | pick TARGET / fault | unexplained 2
# told beside what explains it, and decisive only where blame measured lost time
FDP | nav desk_1 / nav desk_2 / nav table_2 / finish | premature_finish 5 | exploration 0
FDP | nav table_1 / nav desk_1 / find mug / finish | missing_pick 3 | premature_finish 5 | oscillation 2 | exploration 0
FDP | nav desk_1 / fails place nothing_held / again 3 / finish | missing_pick 2 | premature_finish 7 | repeated_failure 4
FDP | fails place nothing_held / again 2 / pick TARGET / fails say bad_arguments / again 2 / horizon | invalid_output 6 | repeated_failure 7
FDP | fails say bad_arguments / again 2 / pick TARGET / nav desk_1 / horizon | invalid_output 2
FDO | pick TARGET / nav cabinet_1 / fails place door_closed / nav table_1 / place table_1 / horizon | missing_open 4 | wrong_receptacle 6
";

/// A finding: sub-class and step.
type Found = (&'static str, i32);

fn begin(number: usize, family: Family) -> Play {
    Play::new(&format!("{number:02}"), family, 1)
        .nav("table_1")
        .find("alarm clock")
}

fn object(name: &str) -> &str {
    match name {
        "TARGET" => TARGET,
        "DISTRACTOR" => DISTRACTOR,
        "MUG" => "mug_1_on_table_1_at_t",
        "TWIN" => "clock_white_7_on_table_2_at_t",
        other => panic!("{other}"),
    }
}

fn moved(play: Play, text: &str) -> Play {
    let (verb, rest) = text.split_once(' ').unwrap_or((text, ""));
    let words: Vec<&str> = rest.split(' ').collect();
    match verb {
        "nav" => play.nav(rest),
        "find" => play.find(rest),
        "look" => play.nav(rest).find("alarm clock"),
        "pick" => play.pick(object(rest)),
        "place" => play.place(rest),
        "open" => play.open(rest),
        "close" => play.close(rest),
        "ask" => play.ask("Which?", rest),
        "fails" => play.fails(words[0], ErrorCode::parse(words[1]).unwrap()),
        "drops" => play.drops(),
        "finish" => play.finish(),
        "says" => play.remembering(rest),
        "with" => play.with_object(words[0], "alarm clock", words[1]),
        "wants" => {
            let (mut play, object) = (play, object(words[0]).into());
            play.task.goal.remove(&"table_1".into(), &object);
            play.task.goal.add(&words[1].into(), &object);
            play.header.task_digest = Digest::of_json(&play.task);
            play
        }
        "horizon" => play.ended(EndReason::Horizon),
        "fault" => play.ended(EndReason::Fault),
        other => panic!("{other}"),
    }
}

fn case(number: usize, line: &'static str) -> (Play, Found, Vec<Found>) {
    let found = |text: &'static str| {
        let (sub_class, step) = text.split_once(' ').unwrap();
        (sub_class, step.parse().unwrap())
    };
    let mut parts = line.split(" | ");
    let (family, moves) = (parts.next().unwrap(), parts.next().unwrap());
    let mut play = match family.split_once(' ') {
        Some((family, _)) => Play::new(&format!("{number:02}"), family_of(family), 1),
        None => begin(number, family_of(family)),
    };
    let mut last = "";
    for text in moves.split(" / ") {
        let (verb, rest) = text.split_once(' ').unwrap_or((text, ""));
        let words: Vec<&str> = rest.split(' ').collect();
        play = match verb {
            "again" => (0..rest.parse().unwrap()).fold(play, |play, _: usize| moved(play, last)),
            "swing" => (0..words[0].parse().unwrap()).fold(play, |play, turn: usize| {
                play.nav(words[1 + turn % (words.len() - 1)])
            }),
            _ => moved(play, text),
        };
        last = text;
    }
    (
        play,
        found(parts.next().unwrap()),
        parts.map(found).collect(),
    )
}

fn family_of(name: &str) -> Family {
    Family::parse(name).unwrap()
}

#[test]
fn every_rule_finds_its_case() {
    let dir = TempDir::new().unwrap();
    let lines = CASES.lines().filter(|line| line.contains('|'));
    let cases: Vec<_> = lines.enumerate().map(|(at, line)| case(at, line)).collect();
    let mut plays: Vec<Play> = cases.iter().map(|(play, ..)| play.clone()).collect();
    // who succeeds is not classified
    plays.push(success("zz", Family::FDP, 1));
    let found = classified(dir.path(), &plays);
    let mut wrong = String::new();
    for (found, (play, (sub_class, step), secondary)) in found.iter().zip(&cases) {
        assert_eq!(found.episode_id, play.header.episode_id);
        let others: Vec<(&str, i32)> = found
            .secondary
            .iter()
            .map(|(name, step)| (name.as_str(), *step))
            .collect();
        if (found.sub_class.as_str(), found.step, &others) != (*sub_class, *step, secondary) {
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
    let tested: BTreeSet<&str> = cases
        .iter()
        .map(|(_, (sub_class, _), _)| *sub_class)
        .collect();
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

/// Rules, pages and the judge's instructions name the sub-classes each in its own way.
#[test]
fn the_pages_and_the_judge_know_every_sub_class() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let rules: BTreeSet<(String, String)> = RuleSet::built_in()
        .rules()
        .iter()
        .map(|rule| (rule.class.to_owned(), rule.sub_class.clone()))
        .collect();

    let pages = fs::read_to_string(root.join("../../dashboards/src/lib/taxonomy.ts")).unwrap();
    let table = pages.split("CLASSES").nth(1).unwrap();
    let table = &table[..table.find("};").unwrap()];
    let (mut class, mut buttons) = (String::new(), BTreeSet::new());
    for line in table.lines() {
        let (name, list) = line.split_once(": [").unwrap_or(("", line));
        if !name.is_empty() {
            class = name.trim().trim_matches('"').to_owned();
        }
        let names = list.split('"').skip(1).step_by(2);
        buttons.extend(names.map(|name| (class.clone(), name.to_owned())));
    }
    assert_eq!(buttons, rules, "dashboards/src/lib/taxonomy.ts");

    let judge = fs::read_to_string(root.join("prompts/judge.md")).unwrap();
    let section = judge
        .split("\n# ")
        .find(|part| part.starts_with("Classes\n"));
    let (mut class, mut explained) = (String::new(), BTreeSet::new());
    for (name, _) in section
        .unwrap()
        .lines()
        .filter_map(|line| line.split_once(": "))
    {
        match name.strip_prefix("- ") {
            Some(sub_class) => drop(explained.insert((class.clone(), sub_class.to_owned()))),
            None => class = name.to_owned(),
        }
    }
    let mut expected = rules;
    // What no rule explains a judge is asked about; it cannot be the answer.
    expected.remove(&("Other".to_owned(), "unexplained".to_owned()));
    assert_eq!(explained, expected, "src/taxonomy/prompts/judge.md");
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
