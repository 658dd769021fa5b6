//! Our own files in the published schema: deviations are taken, broken files are
//! named, gibberish never panics.

use std::{collections::BTreeMap, fs};

use proptest::prelude::*;
use reel_tasks::{LoadReport, TaskError, TaskWarningKind::*};
use reel_world::{DoorState, Family};

use crate::{count_by_kind, data, fixture_scene};

fn load(path: &str) -> LoadReport {
    reel_tasks::load(&data(path), &fixture_scene())
}

/// Messages without the folder of this checkout.
fn messages(broken: &[TaskError]) -> Vec<String> {
    let folder = format!("{}/", data("broken").display());
    broken
        .iter()
        .map(|error| error.to_string().replace(&folder, ""))
        .collect()
}

#[test]
fn every_deviation_is_taken_and_listed() {
    let report = load("real_schema");
    assert_eq!(messages(&report.broken), Vec::<String>::new());
    let families = Family::ALL.map(|family| {
        report
            .tasks
            .iter()
            .filter(|task| task.family == family)
            .count()
    });
    assert_eq!(families, [5, 5, 5, 5]);
    let expected = [
        (SameAssetInSeveralPlaces, 6),
        (GoalDoesNotConserve, 3),
        (DestinationAmongSourceDistractors, 2),
        (CategoryAlias, 2),
        (ZeroSizeDistractor, 1),
        (ThinObject, 1),
        (GraphOmitsReceptacles, 14),
        (DestinationWithoutGeometry, 1),
        (UnplaceableReceptacle, 2),
        (InitialGraphDisagrees, 2),
        (ObjectsAndPlacementsDiffer, 4),
    ];
    let listed: Vec<String> = report.warnings.iter().map(ToString::to_string).collect();
    assert_eq!(
        count_by_kind(&report.warnings),
        expected.into(),
        "{listed:#?}"
    );
}

#[test]
fn fields_mean_what_the_files_say() {
    let tasks = load("real_schema").tasks;
    let task = |id: &str| tasks.iter().find(|task| task.task_id == id).unwrap();

    let sample = task("SUL/sample_3");
    assert!(sample.fuzzy && sample.published_goal.is_none());
    assert_eq!(
        sample.instruction,
        "Bring a writing tool from the white desk with orange drawer pulls to the oak shelf in the study."
    );
    assert!(
        sample
            .precise_instruction
            .starts_with("Bring the yellow hexagonal pencil"),
        "{}",
        sample.precise_instruction
    );
    assert_eq!(sample.purpose.as_deref(), Some("writing tool"));

    let sample = task("FDO/sample_5");
    assert_eq!(
        sample.initial.door(&"refrigerator_1".into()),
        Some(DoorState::Open)
    );
    assert_eq!(
        sample.initial.door(&"microwave_1".into()),
        Some(DoorState::Closed)
    );
    assert_eq!(sample.initial.door(&"table_1".into()), None);

    let sample = task("FDP/sample_1");
    let object = sample.target_object();
    assert_eq!(object.attributes["colour"], ["red"]);
    assert!(
        object
            .reference_rest
            .is_some_and(|rest| rest[2] < object.position[2])
    );
    assert_eq!(
        sample
            .plan
            .iter()
            .map(|step| step.action.as_str())
            .collect::<Vec<_>>(),
        ["nav_to", "find", "gaze_at", "pick", "nav_to", "place"]
    );
}

#[test]
fn unknown_fields_are_kept_under_their_path() {
    let tasks = load("real_schema").tasks;
    let sample = tasks
        .iter()
        .find(|task| task.task_id == "SUL/sample_4")
        .unwrap();
    let kept: BTreeMap<&str, String> = sample
        .extra
        .iter()
        .map(|(path, value)| (path.as_str(), value.to_string()))
        .collect();
    for (path, value) in [
        ("generator", "\"by hand\""),
        ("objects.clock_01_on_desk_2_at_sample_4.weight_kg", "0.4"),
        (
            "episodes[0].difficulty",
            "{\"level\":3,\"why\":[\"ambiguous\",\"far\"]}",
        ),
        (
            "episodes[0].execution_plan[0].comment",
            "\"go there first\"",
        ),
        (
            "episodes[0].placements.clock_01_on_desk_2_at_sample_4.tries",
            "12",
        ),
    ] {
        assert_eq!(
            kept.get(path).map(String::as_str),
            Some(value),
            "{path} in {kept:#?}"
        );
    }
}

#[test]
fn fixtures_survive_writing() {
    let scene = fixture_scene();
    for task in load("real_schema").tasks {
        let text = reel_tasks::yaml::write(&task, &scene);
        let (again, _) = reel_tasks::parse(&text, "written.yaml", &scene).unwrap();
        assert_eq!(again, task, "{}", task.task_id);
    }
}

#[test]
fn broken_files_are_named_with_line_and_field() {
    let report = load("broken");
    assert_eq!(report.tasks, vec![]);
    let expected = [
        "alias_bomb.yaml:5: anchors and aliases copy more than 100000 values",
        "already_there.yaml:15: episodes[0].dest: is table_1, where the target stands already",
        "deep.yaml:1: nested deeper than 64 levels",
        "door_ajar.yaml:14: episodes[0].initial_world_graph.microwave_1.door: expected true, false, open or closed",
        "duplicate_key.yaml:15: the key \"src\" stands twice in its mapping",
        "empty.yaml:1: the file is empty",
        "empty_text.yaml:5: objects.mug_01_on_table_1_at_b.category: empty",
        "list_as_mapping.yaml:17: episodes[0].placements: expected a mapping, found a list",
        "missing_category.yaml:4: objects.mug_01_on_table_1_at_b.category: missing",
        "missing_dest.yaml:9: episodes[0].dest: missing",
        "missing_furniture.yaml:17: episodes[0].placements.mug_01_on_table_1_at_b.furniture: missing",
        "no_episode.yaml:8: episodes: expected 1 episode, found 0",
        "null_source.yaml:9: episodes[0].src: missing",
        "only_a_list.yaml:1: the document: expected a mapping, found a list",
        "other_scene.yaml:1: scene_id: is S7, but the scene given is home_with_pot",
        "position_infinite.yaml:6: a number that is not finite",
        "size_of_text.yaml:7: objects.mug_01_on_table_1_at_b.size[1]: expected a number, found text",
        "size_of_two.yaml:7: objects.mug_01_on_table_1_at_b.size: expected 3 numbers, found 2",
        "size_zero.yaml:7: objects.mug_01_on_table_1_at_b.size: expected lengths above 0 and at most 5 m, found [0.1, 0.1, 0.0]",
        "target_elsewhere.yaml:18: episodes[0].target_object_id: no mug_01 stands on table_3",
        "two_documents.yaml:19: a second document; one is expected",
        "two_episodes.yaml:9: episodes: expected 1 episode, found 2",
        "unclosed_bracket.yaml:7: illegal placement of ':' indicator",
        "unknown_family.yaml:10: episodes[0].family: expected FDP, FODP, FDO or SUL",
        "unknown_in_graph.yaml:13: episodes[0].initial_world_graph.attic_1: attic_1 is not a receptacle of the scene",
        "unknown_receptacle.yaml:15: episodes[0].dest: table_9 is not a receptacle of the scene",
    ];
    assert_eq!(messages(&report.broken), expected);
}

#[test]
fn one_broken_file_does_not_keep_the_rest_from_loading() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &[u8]| fs::write(folder.path().join(name), text).unwrap();
    let good = fs::read(data("real_schema/FDP/sample_1.yaml")).unwrap();
    write("a.yaml", &good);
    write("b.yaml", &good);
    write("c.yaml", b"caf\xe9: 1\n");
    write("d.yaml", &vec![b' '; 5 * 1024 * 1024]);
    write("notes.txt", b"not a task");
    let report = reel_tasks::load(folder.path(), &fixture_scene());
    let here = format!("{}/", folder.path().display());
    let messages: Vec<String> = report
        .broken
        .iter()
        .map(|error| error.to_string().replace(&here, ""))
        .collect();
    assert_eq!(
        messages,
        [
            "b.yaml: task FDP/sample_1 stands in a.yaml already",
            "c.yaml:1: not UTF-8 text",
            "d.yaml: larger than 4194304 bytes, which no task file is",
        ]
    );
    assert_eq!(report.tasks.len(), 1);
}

#[test]
fn a_place_without_tasks_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let problem = |path| {
        let report = reel_tasks::load(path, &fixture_scene());
        report
            .broken
            .iter()
            .map(ToString::to_string)
            .collect::<Vec<_>>()
            .concat()
    };
    assert!(problem(folder.path()).ends_with("no file in it ends with .yaml or .yml"));
    assert!(problem(&folder.path().join("nowhere.yaml")).contains("cannot be read"));
}

proptest! {
    #[test]
    fn gibberish_is_an_error_and_never_a_panic(pieces in prop::collection::vec(prop::sample::select(PIECES), 0..60)) {
        prop_assert!(reel_tasks::parse(&pieces.concat(), "gibberish.yaml", &fixture_scene()).is_err());
    }

    #[test]
    fn a_damaged_task_loads_or_is_an_error(cuts in prop::collection::vec((any::<prop::sample::Index>(), 0..40usize, prop::sample::select(PIECES)), 1..4)) {
        let mut text: Vec<char> = include_str!("../data/real_schema/FDO/sample_5.yaml").chars().collect();
        for (at, length, piece) in cuts {
            let from = at.index(text.len());
            text.splice(from..(from + length).min(text.len()), piece.chars());
        }
        let text: String = text.into_iter().collect();
        if let Err(error) = reel_tasks::parse(&text, "damaged.yaml", &fixture_scene()) {
            prop_assert!(error.to_string().starts_with("damaged.yaml:"), "{}", error);
        }
    }
}

/// What YAML is made of.
const PIECES: &[&str] = &[
    "\n",
    "\n  ",
    "\n    ",
    " ",
    ":",
    ": ",
    "- ",
    "? ",
    "[",
    "]",
    "{",
    "}",
    ",",
    "&a ",
    "*a",
    "!!int ",
    "!x ",
    "|",
    ">-\n",
    "\"",
    "'",
    "#",
    "%YAML 1.2\n",
    "---",
    "...",
    "~",
    "null",
    ".nan",
    "1e999",
    "0x1f",
    "-0.5",
    "\t",
    "\u{0}",
    "\u{feff}",
    "é",
    "<<",
    "@",
    "`",
    "episodes",
    "objects",
    "scene_id",
    "home_with_pot",
    "table_1",
    "true",
];
