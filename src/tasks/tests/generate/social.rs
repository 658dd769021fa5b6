//! Questions in plans: needed, settled, where they shall be, and the same for the same seed.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{Arc, OnceLock},
};

use reel_episode::user::{RuleUser, violations};
use reel_tasks::generate::{
    scene::built_in,
    social::{
        AnnotateOptions, AnnotatedTask, Annotation, FIELD, Objection, QuestionTopic, SkipReason,
        Strategy, annotate, apply, insert, proposal, settles,
    },
    task::{Compatibility, TaskType, make},
};
use reel_tasks::library::objects;
use reel_world::{Family, PlanStep, Scene, Task};
use serde_json::json;

const BOTH: AnnotateOptions<'static> = AnnotateOptions {
    strategies: &Strategy::ALL,
    seed: 1,
};

/// Tasks of all families in two of the scenes.
fn made() -> &'static [(Arc<Scene>, Task)] {
    static MADE: OnceLock<Vec<(Arc<Scene>, Task)>> = OnceLock::new();
    MADE.get_or_init(|| {
        let scenes = ["S1", "S3"].map(|name| Arc::new(built_in(name).unwrap()));
        let (families, types) = (&Family::ALL, &TaskType::ALL);
        let (library, table) = (objects(), Compatibility::committed());
        let options = reel_tasks::generate::task::GenerateOptions {
            scenes: &scenes,
            library,
            table,
            families,
            types,
            count: 64,
            seed: 1,
            placing: reel_tasks::generate::task::Placing::NearEdge,
            jobs: 2,
        };
        let made = make(&options, || {}).unwrap().tasks;
        made.into_iter()
            .map(|(scene, task)| (scenes[scene].clone(), task))
            .collect()
    })
}

fn annotated(options: &AnnotateOptions<'_>) -> Vec<(&'static Scene, &'static Task, AnnotatedTask)> {
    let one = |(scene, task): &'static (Arc<Scene>, Task)| {
        Some((scene.as_ref(), task, annotate(task, scene, options).ok()?))
    };
    made().iter().filter_map(one).collect()
}

fn asks(task: &Task) -> Vec<&PlanStep> {
    task.plan
        .iter()
        .filter(|step| step.action == "ask")
        .collect()
}

/// A task of a family that can be annotated.
fn of(
    family: Family,
    options: &AnnotateOptions<'_>,
) -> (&'static Scene, &'static Task, AnnotatedTask) {
    annotated(options)
        .into_iter()
        .find(|(_, task, _)| task.family == family && task.goal_changes().len() == 2)
        .unwrap()
}

#[test]
fn every_kind_of_question_occurs_in_most_tasks() {
    let all = annotated(&BOTH);
    assert!(
        all.len() * 3 >= made().len() * 2,
        "{} of {}",
        all.len(),
        made().len()
    );
    let mut counts: BTreeMap<QuestionTopic, usize> = BTreeMap::new();
    for (_, task, annotated) in &all {
        assert!(
            (1..=3).contains(&annotated.annotations.len()),
            "{}",
            task.task_id
        );
        for annotation in &annotated.annotations {
            *counts.entry(annotation.about).or_default() += 1;
        }
    }
    assert_eq!(counts.len(), 3, "{counts:?}");
}

#[test]
fn what_was_said_before_leaves_two_and_the_answer_one() {
    for (scene, task, annotated) in annotated(&BOTH) {
        let next = &annotated.task;
        assert_eq!(settles(next, scene), Ok(()), "{}", task.task_id);
        // Under the instruction as it was, the questions that are new need not be asked.
        if next.instruction != task.instruction {
            let told = Task {
                instruction: task.instruction.clone(),
                ..next.clone()
            };
            assert!(
                matches!(settles(&told, scene), Err(Objection::Unneeded { .. })),
                "{}: {}",
                task.task_id,
                task.instruction
            );
        }
        // The user keeps to its rules.
        let user = RuleUser::new(next, scene);
        for step in asks(next) {
            let Some(question) = step.args.get("question") else {
                continue;
            };
            let reply = user.answer(question.as_str().unwrap()).text;
            assert_eq!(
                violations(next, scene, &reply, false),
                Vec::<&str>::new(),
                "{reply}"
            );
        }
    }
}

#[test]
fn only_words_and_questions_are_new() {
    for (_, task, annotated) in annotated(&BOTH) {
        let mut back = annotated.task.clone();
        back.plan.retain(|step| step.action != "ask");
        assert_eq!(back.plan, task.plan);
        assert!(back.fuzzy);
        let before = annotated.task.extra[FIELD]
            .get("instruction_before")
            .map_or(json!(back.instruction), Clone::clone);
        assert_eq!(before, json!(task.instruction));
        assert_eq!(back.precise_instruction, task.precise_instruction);
        (
            back.instruction,
            back.fuzzy,
            back.purpose,
            back.extra,
            back.plan,
        ) = (
            task.instruction.clone(),
            task.fuzzy,
            task.purpose.clone(),
            task.extra.clone(),
            task.plan.clone(),
        );
        assert_eq!(back, *task);
    }
}

#[test]
fn indices_are_those_of_the_plan_as_it_was() {
    for (_, task, annotated) in annotated(&BOTH) {
        for annotation in &annotated.annotations {
            let about = |step: &&PlanStep| {
                step.action == "ask" && step.args["about"] == json!(annotation.about)
            };
            let at = annotated
                .task
                .plan
                .iter()
                .position(|step| about(&step))
                .unwrap();
            let follower = annotated.task.plan[at..]
                .iter()
                .find(|step| step.action != "ask");
            assert_eq!(
                follower,
                task.plan.get(annotation.insert_before),
                "{}",
                task.task_id
            );
            let before = &annotated.task.plan[..at];
            let has = |action: &str| before.iter().any(|step| step.action == action);
            let was_at = |id: &str| {
                before
                    .iter()
                    .any(|step| step.args.get("receptacle_name") == Some(&json!(id)))
            };
            match annotation.about {
                QuestionTopic::Object => assert!(has("find") && !has("gaze_at") && !has("pick")),
                QuestionTopic::Source => assert!(!has("nav_to")),
                QuestionTopic::Destination => assert!(!was_at(task.dest.as_str())),
            }
        }
    }
}

#[test]
fn questions_at_one_index_keep_their_order() {
    let ask = |about: QuestionTopic, insert_before| Annotation {
        strategy: if about == QuestionTopic::Object {
            Strategy::A
        } else {
            Strategy::B
        },
        about,
        insert_before,
        question: (about != QuestionTopic::Object).then(|| "Which one?".to_owned()),
    };
    let step = |action: &str| PlanStep {
        action: action.to_owned(),
        args: BTreeMap::new(),
    };
    let mut plan = ["nav_to", "find", "pick", "place"].map(step).to_vec();
    insert(
        &mut plan,
        &[
            ask(QuestionTopic::Object, 2),
            ask(QuestionTopic::Source, 0),
            ask(QuestionTopic::Destination, 0),
        ],
    );
    let words: Vec<&str> = plan
        .iter()
        .map(|step| {
            step.args
                .get("about")
                .map_or(step.action.as_str(), |about| about.as_str().unwrap())
        })
        .collect();
    assert_eq!(
        words,
        [
            "source",
            "destination",
            "nav_to",
            "find",
            "object",
            "pick",
            "place"
        ]
    );
}

#[test]
fn equal_seeds_give_equal_tasks_and_others_others() {
    let tasks = |seed| {
        annotated(&AnnotateOptions { seed, ..BOTH })
            .into_iter()
            .map(|(_, _, annotated)| annotated)
            .collect::<Vec<_>>()
    };
    assert_eq!(tasks(1), tasks(1));
    assert_ne!(tasks(1), tasks(2));
}

#[test]
fn annotated_tasks_survive_writing() {
    for (scene, task, annotated) in annotated(&BOTH) {
        let text = reel_tasks::yaml::write(&annotated.task, scene);
        let (again, _) = reel_tasks::parse(&text, "social.yaml", scene).unwrap();
        assert_eq!(again, annotated.task, "{}: {text}", task.task_id);
    }
}

#[test]
fn no_identifier_is_spoken() {
    for (scene, task, annotated) in annotated(&BOTH) {
        let spoken = asks(&annotated.task)
            .into_iter()
            .filter_map(|step| step.args.get("question")?.as_str())
            .collect::<Vec<_>>();
        for text in spoken
            .into_iter()
            .chain([annotated.task.instruction.as_str()])
        {
            assert!(!text.contains('_'), "{}: {text}", task.task_id);
            assert!(
                !scene
                    .receptacles
                    .iter()
                    .any(|one| text.contains(one.id.as_str())),
                "{text}"
            );
        }
    }
}

#[test]
fn a_fuzzy_task_asks_about_its_object_and_is_left_out_where_nothing_may() {
    let (scene, task, annotated) = of(Family::SUL, &BOTH);
    assert!(
        annotated
            .annotations
            .iter()
            .any(|annotation| annotation.about == QuestionTopic::Object)
    );
    assert_eq!(annotated.task.purpose, task.purpose);
    let only_b = AnnotateOptions {
        strategies: &[Strategy::B],
        seed: 1,
    };
    assert_eq!(annotate(task, scene, &only_b), Err(SkipReason::LeftVague));
    assert!(
        self::annotated(&only_b)
            .iter()
            .all(|(_, task, _)| task.family != Family::SUL)
    );
}

#[test]
fn strategy_a_is_a_dialogue_before_the_first_step() {
    let all = annotated(&AnnotateOptions {
        strategies: &[Strategy::A],
        seed: 1,
    });
    let families: BTreeSet<Family> = all.iter().map(|(_, task, _)| task.family).collect();
    assert!(families.len() > 2, "{families:?}");
    let mut with_follow_up = 0;
    for (scene, task, annotated) in &all {
        let next = &annotated.task;
        let turns: Vec<&PlanStep> = next
            .plan
            .iter()
            .take_while(|step| step.action == "ask")
            .collect();
        // Of what is vague already the robot may ask in view of the candidates alone.
        assert!(
            turns.len() == 2 || turns.is_empty() && task.family == Family::SUL,
            "{}: {turns:?}",
            task.task_id
        );
        assert!(asks(next).iter().all(|step| step.args["strategy"] == "A"));
        with_follow_up += usize::from(turns.len() == 2 && asks(next).len() == 3);
        // Each turn tells something: fewer receptacles than before are left.
        let user = RuleUser::new(next, scene);
        for turn in turns {
            let reply = user.answer(turn.args["question"].as_str().unwrap()).text;
            let room = |id| scene.receptacle(id).unwrap().room_name();
            let told = match turn.args["about"].as_str().unwrap() {
                "source" => reply.contains(room(&task.src)),
                _ => reply.starts_with("Please put it"),
            };
            assert!(told, "{turn:?}: {reply}");
        }
    }
    let dialogues = all
        .iter()
        .filter(|(_, _, annotated)| annotated.task.plan[0].action == "ask")
        .count();
    assert!(
        dialogues * 2 > all.len() && with_follow_up > 0 && all.len() * 2 > made().len(),
        "{dialogues} dialogues of {}, {with_follow_up} with a question in view; {} tasks",
        all.len(),
        made().len()
    );
}

#[test]
fn half_a_dialogue_is_none() {
    let options = AnnotateOptions {
        strategies: &[Strategy::A],
        seed: 1,
    };
    let (scene, task, good) = annotated(&options)
        .into_iter()
        .find(|(_, _, annotated)| annotated.annotations.len() == 2)
        .unwrap();
    let kind = |annotations: &[Annotation]| {
        apply(
            task,
            scene,
            good.task.instruction.clone(),
            annotations.to_vec(),
        )
        .unwrap_err()
        .kind()
    };
    assert_eq!(
        kind(&good.annotations[..1]),
        "strategy A is less than a dialogue"
    );
    let named = apply(
        task,
        scene,
        task.instruction.clone(),
        good.annotations.clone(),
    );
    assert_eq!(
        named.unwrap_err().kind(),
        "a question does not have to be asked"
    );
    let mut later = good.annotations.clone();
    later[1].insert_before = 1;
    assert_eq!(
        kind(&later),
        "a question is at a step where it cannot be asked"
    );
}

#[test]
fn gathering_asks_about_the_destination_alone() {
    let gathering: Vec<_> = annotated(&BOTH)
        .into_iter()
        .filter(|(_, task, _)| task.task_type.as_deref() == Some("gather"))
        .collect();
    assert!(!gathering.is_empty());
    for (_, _, annotated) in gathering {
        let abouts: Vec<QuestionTopic> = annotated
            .annotations
            .iter()
            .map(|annotation| annotation.about)
            .collect();
        assert_eq!(abouts, [QuestionTopic::Destination]);
    }
}

#[test]
fn tasks_that_cannot_be_annotated_say_why() {
    let (scene, task, annotated) = of(Family::FDP, &BOTH);
    assert_eq!(
        annotate(&annotated.task, scene, &BOTH),
        Err(SkipReason::AsksAlready)
    );
    let no_plan = Task {
        plan: Vec::new(),
        ..task.clone()
    };
    assert_eq!(annotate(&no_plan, scene, &BOTH), Err(SkipReason::NoPlan));
    let silent = Task {
        instruction: "Do as yesterday.".to_owned(),
        ..task.clone()
    };
    assert_eq!(annotate(&silent, scene, &BOTH), Err(SkipReason::NotWorded));
    let mut alone = scene.clone();
    alone
        .receptacles
        .retain(|one| one.id == task.src || one.id == task.dest);
    assert_eq!(
        annotate(
            task,
            &alone,
            &AnnotateOptions {
                strategies: &[Strategy::B],
                seed: 1
            }
        ),
        Err(SkipReason::NothingAlike)
    );
}

#[test]
fn rules_are_kept_whoever_annotates() {
    let options = AnnotateOptions {
        strategies: &[Strategy::B],
        seed: 1,
    };
    let found = annotated(&options)
        .into_iter()
        .find(|(_, task, annotated)| {
            task.goal_changes().len() == 2
                && annotated
                    .annotations
                    .iter()
                    .all(|annotation| annotation.about == QuestionTopic::Destination)
        });
    let (scene, task, good) = found.unwrap();
    let told = good.task.instruction.clone();
    let with = |change: &dyn Fn(&mut Annotation)| {
        let mut annotations = good.annotations.clone();
        change(&mut annotations[0]);
        apply(task, scene, told.clone(), annotations)
            .unwrap_err()
            .kind()
    };
    assert_eq!(
        apply(task, scene, told.clone(), good.annotations.clone()),
        Ok(good.clone())
    );
    assert_eq!(
        with(&|one| one.strategy = Strategy::A),
        "strategy A is less than a dialogue"
    );
    assert_eq!(
        with(&|one| one.about = QuestionTopic::Object),
        "a strategy does not ask about that"
    );
    assert_eq!(
        with(&|one| one.insert_before = 1000),
        "a question is at a step where it cannot be asked"
    );
    assert_eq!(
        with(&|one| one.insert_before = task.plan.len()),
        "a question is at a step where it cannot be asked"
    );
    assert_eq!(
        with(&|one| one.question = Some(format!("Do you mean {}?", task.dest))),
        "a text speaks an identifier"
    );
    assert_eq!(
        with(&|one| one.question = Some("Which\none?".into())),
        "a text cannot be said"
    );
    assert_eq!(
        with(&|one| one.question = Some("What is it that you mean?".into())),
        "the answer does not settle a question"
    );
    let objection = |instruction: &str, annotations: Vec<Annotation>| {
        apply(task, scene, instruction.to_owned(), annotations)
            .unwrap_err()
            .kind()
    };
    assert_eq!(
        objection(&task.instruction, good.annotations.clone()),
        "a question does not have to be asked"
    );
    assert_eq!(objection(&told, Vec::new()), "there is no question");
    let category = &scene.receptacle(&task.dest).unwrap().category;
    let vaguer = format!("Bring it to a {category}.");
    assert_eq!(
        objection(&vaguer, good.annotations.clone()),
        "something is told otherwise that nothing asks about"
    );
    let thing = told.replace(&format!(" {category}"), " thing");
    assert_eq!(
        objection(&thing, good.annotations.clone()),
        "the instruction does not say what is asked about"
    );
}

#[test]
fn a_models_proposal_is_read_leniently_and_judged_strictly() {
    let (scene, task, good) = of(
        Family::FODP,
        &AnnotateOptions {
            strategies: &[Strategy::B],
            seed: 1,
        },
    );
    let answer = json!({ "instruction": good.task.instruction, "actions": good.annotations });
    let judge = |answer: &str| proposal::judge(task, scene, &[Strategy::B], answer);
    let talkative = format!("<think>a {{ b</think>Here it is:\n```json\n{answer}\n```");
    assert_eq!(judge(&talkative), Ok(good));
    assert_eq!(
        judge("I will not.").unwrap_err().kind(),
        "the answer holds no proposal that can be read"
    );
    let silent = answer.to_string().replace("question", "words");
    assert_eq!(
        judge(&silent).unwrap_err().kind(),
        "a question about a receptacle has no words"
    );
    let refused = proposal::judge(task, scene, &[Strategy::A], &answer.to_string()).unwrap_err();
    assert_eq!(refused.kind(), "a strategy was not asked for");
    let summary = proposal::summary(task, scene, &[Strategy::B]);
    assert!(
        summary.contains(&task.instruction) && summary.contains(r#""action":"find""#),
        "{summary}"
    );
}
