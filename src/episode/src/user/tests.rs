//! The simulated user in talk, and its four rules over generated questions.

use reel_world::{Family, language::attribute_words};
use serde_json::json;

use super::*;

const TARGET: &str = "a1_on_table_1_at_t7";
const GREEN: &str = "b2_on_table_1_at_t7";
const BANANA: &str = "c3_on_table_1_at_t7";
const TWIN: &str = "a1_on_table_2_at_t7";

fn object(instance: &str, category: &str, caption: &str, receptacle: &str) -> ObjectInstance {
    let instance = InstanceId::from(instance);
    ObjectInstance {
        asset: instance.asset(),
        instance,
        category: category.into(),
        caption: Some(caption.into()),
        attributes: attribute_words(caption),
        size: [0.1; 3],
        position: [0.0; 3],
        yaw: 0.0,
        receptacle: receptacle.into(),
        reference_rest: None,
    }
}

fn scene() -> Scene {
    let receptacle = |id: &str, category: &str, room: &str, door: bool, captions: &[&str]| {
        let captions: serde_json::Map<_, _> = captions
            .iter()
            .map(|caption| ((*caption).to_owned(), json!(1.0)))
            .collect();
        json!({ "id": id, "room": room, "category": category, "door": door, "captions": captions,
                "surface_min": [0, 0, 0], "surface_max": [1, 1, 1] })
    };
    serde_json::from_value(json!({ "scene_id": "flat", "rooms": [], "receptacles": [
        receptacle("table_1", "table", "dining room/0", false, &["the rectangular table", "the table where we have dinner"]),
        receptacle("table_2", "table", "living room/0", false, &["the rounded rectangular table", "the table to place my snack"]),
        receptacle("desk_1", "desk", "study room/0", false, &["white desk with round black knob"]),
        receptacle("desk_2", "desk", "bedroom/0", false, &["the desk near my bed"]),
        receptacle("fridge_0", "refrigerator", "kitchen/0", true, &[]),
    ]}))
    .unwrap()
}

fn task(dest: &str, instruction: &str, purpose: Option<&str>) -> Task {
    let objects = vec![
        object(
            TARGET,
            "apple",
            "Round, glossy red apple with a slender stem.",
            "table_1",
        ),
        object(
            TWIN,
            "apple",
            "Round, glossy red apple with a slender stem.",
            "table_2",
        ),
        object(
            GREEN,
            "apple",
            "Round green apple with small speckles.",
            "table_1",
        ),
        object(BANANA, "banana", "Curved yellow banana.", "table_1"),
    ];
    let initial = Task::initial_graph(&scene(), &objects);
    Task {
        placement_order: Vec::new(),
        task_id: "t7".into(),
        family: Family::SUL,
        task_type: None,
        scene_id: "flat".into(),
        instruction: instruction.into(),
        precise_instruction: "Take the round, glossy red apple with a slender stem.".into(),
        fuzzy: true,
        purpose: purpose.map(str::to_owned),
        objects,
        goal: initial.clone(),
        initial,
        target: TARGET.into(),
        src: "table_1".into(),
        dest: dest.into(),
        src_distractors: vec!["table_2".into()],
        dest_distractors: vec!["desk_2".into()],
        object_distractors: vec![],
        plan: vec![],
        published_goal: None,
        extra: Default::default(),
    }
}

fn fruit() -> Task {
    task(
        "desk_1",
        "Take a fruit from the table where we have dinner and put it on the white desk with round black knob.",
        Some("fruit"),
    )
}

fn say(user: &RuleUser, question: &str) -> String {
    user.answer(question).text
}

#[test]
fn before_the_target_was_seen_it_stays_vague() {
    let mut user = RuleUser::new(&fruit(), &scene());
    let vague = "I mean a fruit. Please check what is on the table where we have dinner.";
    assert_eq!(say(&user, "Which fruit do you mean?"), vague);
    user.observe("walk_around", &[GREEN.into(), TWIN.into()]);
    assert!(!user.saw_target());
    for question in [
        "Do you mean the red one?",
        "Do you mean the green apple?",
        "Where is it?",
        "Is it on the table?",
    ] {
        assert_eq!(say(&user, question), vague, "{question}");
    }
}

#[test]
fn after_it_was_seen_it_is_told_from_the_others_that_were_seen() {
    let mut user = RuleUser::new(&fruit(), &scene());
    user.observe("walk_around", &[TARGET.into(), BANANA.into()]);
    assert_eq!(say(&user, "Which fruit?"), "I mean the apple.");
    user.observe("walk_around", &[GREEN.into()]);
    assert_eq!(say(&user, "Which one?"), "I mean the red apple.");
    assert_eq!(
        say(&user, "Do you mean the red one?"),
        "Yes, I mean the red apple."
    );
    assert_eq!(
        say(&user, "Is it the green apple?"),
        "No, I mean the red apple."
    );
    assert_eq!(
        say(&user, "The red or the green one?"),
        "I mean the red apple."
    );
    assert_eq!(
        say(&user, "Is it the red or the green one?"),
        "I mean the red apple."
    );
    assert_eq!(user.answer("Which one?"), user.clone().answer("Which one?"));
    assert_eq!(
        say(&user, "Where can I find it?"),
        "You have seen it already. I mean the red apple."
    );
}

#[test]
fn questions_about_the_destination_get_its_caption() {
    let mut user = RuleUser::new(&fruit(), &scene());
    let place = "put it on the white desk with round black knob.";
    assert_eq!(
        say(&user, "Which desk should I bring it to?"),
        format!("Please {place}")
    );
    assert_eq!(
        say(&user, "Should I put it on the desk near my bed?"),
        format!("No, please {place}")
    );
    assert_eq!(
        say(&user, "Should I put it on desk_1?"),
        format!("Yes, please {place}")
    );
    user.observe("pick", &[]);
    user.observe_held(Some(&TARGET.into()));
    assert_eq!(
        say(&user, "What now?"),
        format!("Yes, that is what I meant. Please {place}")
    );
    user.observe_held(Some(&GREEN.into()));
    assert_eq!(
        say(&user, "Is this right?"),
        "That is not what I meant, please put it back. I mean the red apple."
    );
    let fridge = RuleUser::new(
        &task("fridge_0", "Can you put a fruit away?", Some("fruit")),
        &scene(),
    );
    assert_eq!(
        say(&fridge, "Where does it go?"),
        "Please put it into the refrigerator in the kitchen."
    );
    assert_eq!(
        say(&fridge, "Where is the fruit?"),
        "I mean a fruit. Please have a look around in the dining room."
    );
}

#[test]
fn a_reply_after_seeing_leaves_one_candidate() {
    let task = fruit();
    let mut user = RuleUser::new(&task, &scene());
    let seen: Vec<InstanceId> = task
        .objects
        .iter()
        .map(|object| object.instance.clone())
        .collect();
    user.observe("walk_around", &seen);
    let reply = say(&user, "Which fruit do you mean?");
    let fitting: BTreeSet<_> = task
        .objects
        .iter()
        .filter(|object| language::fits(&reply, object, None))
        .map(|object| &object.asset)
        .collect();
    assert_eq!(
        fitting
            .into_iter()
            .map(|asset| asset.as_str())
            .collect::<Vec<_>>(),
        ["a1"]
    );
}

/// Questions from openings, things and endings; more than 500.
fn questions() -> Vec<String> {
    let openings = reel_world::words! {
        Which "Do you mean" "Is it" "Should I pick" "Where is" "Can you describe" "What about"
        "I see" "Should I bring it to" "Where should I put" "Please tell me about" ""
    };
    let things = [
        "the apple",
        "the red one",
        "the green apple",
        "a fruit",
        "the banana",
        "table_1",
        "the rounded rectangular table",
        "it",
        "the desk near my bed",
        "the white desk with round black knob",
        "the thing on the left",
        TARGET,
        "a1",
    ];
    let endings = [
        "?",
        " on the table?",
        ", or another one?",
        " and where exactly?",
    ];
    let combine = |opening: &str| {
        things.map(|thing| endings.map(|ending| format!("{opening} {thing}{ending}")))
    };
    openings
        .iter()
        .flat_map(|opening| combine(opening).into_iter().flatten())
        .collect()
}

#[test]
fn the_four_rules_hold_over_500_questions_in_every_situation() {
    let scene = scene();
    let tasks = [
        fruit(),
        task("fridge_0", "Can you help me move an apple?", None),
        task(
            "table_2",
            "Please tidy up the table where we have dinner.",
            None,
        ),
        task(
            "desk_1",
            "Bring the round, glossy red apple with a slender stem to the white desk with round black knob.",
            None,
        ),
    ];
    assert!(questions().len() > 500);
    // Every situation has other questions, and all are asked.
    let stride = if reel_vectors::is_long() { 1 } else { 7 };
    let mut situation = 0;
    for task in &tasks {
        for seen in [
            vec![],
            vec![GREEN, TWIN, BANANA],
            vec![TARGET],
            vec![TARGET, GREEN, TWIN, BANANA],
        ] {
            for held in [None, Some(GREEN), Some(TARGET)] {
                let mut user = RuleUser::new(task, &scene);
                user.observe(
                    "walk_around",
                    &seen
                        .iter()
                        .map(|id| InstanceId::from(*id))
                        .collect::<Vec<_>>(),
                );
                user.observe_held(held.map(InstanceId::from).as_ref());
                situation += 1;
                for question in questions()
                    .into_iter()
                    .skip(situation % stride)
                    .step_by(stride)
                {
                    let reply = say(&user, &question);
                    let broken = violations(task, &scene, &reply, user.saw_target());
                    assert!(
                        broken.is_empty(),
                        "{question} -> {reply} breaks {broken:?} (task: {})",
                        task.instruction
                    );
                }
            }
        }
    }
}

#[test]
fn the_check_finds_each_broken_rule() {
    let (task, scene) = (fruit(), scene());
    #[rustfmt::skip]
    let cases: &[(&str, bool, &[&str])] = &[
        ("I mean a fruit.", false, &[]),
        ("I mean the red apple.", true, &[]),
        ("I mean the red apple.", false, &["target_named_too_early"]),
        ("It is red.", false, &["not_goal_driven", "target_named_too_early"]),
        ("Round, glossy red apple with a slender stem.", false, &["target_named_too_early"]),
        ("The fruit is on the rectangular table.", false, &["exact_position"]),
        ("The fruit is in the left corner.", true, &["exact_position"]),
        ("Take the fruit 20 cm from you.", true, &["exact_position"]),
        ("I mean a fruit—it lies near the edge—of course.", true, &["exact_position"]),
        ("Look for the fruit in the dining room\u{2014}corner.", true, &["exact_position"]),
        ("The fruit is in the corn\u{e9}r.", true, &["exact_position"]),
        ("Take a1_on_table_1_at_t7, a fruit.", true, &["raw_id"]),
        ("Go to table_1 for a fruit.", true, &["raw_id"]),
        ("Take the banana.", true, &["not_goal_driven"]),
        ("Bring the apple to the desk near my bed.", true, &["not_goal_driven"]),
        ("", true, &["not_goal_driven"]),
        ("How are you?", true, &["not_goal_driven"]),
    ];
    for (reply, seen, expected) in cases {
        let mut found = violations(&task, &scene, reply, *seen);
        if found.contains(&"raw_id")
            || found.contains(&"exact_position") && expected == &["exact_position"]
        {
            // ids and numbers may look like places too; the rule in question must
            // be among those found
            found.retain(|name| expected.contains(name));
        }
        assert_eq!(&found, expected, "{reply}");
    }
}
