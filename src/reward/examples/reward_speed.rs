//! How many twelve-step episodes a second one core scores: from prepared facts, and from the
//! texts of table columns.
//!
//! `cargo run --release -p reel-reward --example reward_speed`

use reel_reward::{
    Authority, EpisodeFacts, EpisodeReward, MarkerReferent, Preset, Scorer, StepHead, TaskFacts,
};
use reel_world::{Scene, Task};
use serde_json::{Value, json};

/// Distinct episodes, which take turns.
const EPISODES: usize = 64;
/// Best of so many rounds, so that what else the machine does counts little.
const ROUNDS: usize = 20;
const EPISODES_A_ROUND: usize = 20_000;

const TARGET: &str = "remote_control_5f3a_on_coffeetable_0_at_SUL/verify_task_10";
const OTHER: &str = "remote_control_9c21_on_coffeetable_0_at_SUL/verify_task_10";

/// One step as the tables hold it.
struct Row {
    tool: &'static str,
    argument: Option<&'static str>,
    error: bool,
    object: Option<&'static str>,
    receptacle: Option<&'static str>,
    held: Option<&'static str>,
    reply: Option<String>,
    text: String,
    /// Event and receptacle, the same in both graphs; the object is the row's.
    change: Option<(&'static str, &'static str)>,
    seen: Vec<String>,
    markers: Option<Vec<String>>,
}

fn main() {
    let (task, scene) = flat();
    let rows: Vec<Vec<Row>> = (0..EPISODES).map(|number| episode(&task, number)).collect();
    let steps = rows.iter().map(Vec::len).sum::<usize>() as f64 / EPISODES as f64;
    println!(
        "{steps} steps an episode, {} objects, {} receptacles; best of {ROUNDS} rounds",
        task.objects.len(),
        scene.receptacles.len()
    );
    for preset in Preset::built_in()
        .into_iter()
        .chain(["real-repo", "real-trainer"].map(all_terms))
    {
        let mut facts = TaskFacts::new(&task, &scene);
        let prepared: Vec<EpisodeFacts> = rows
            .iter()
            .map(|rows| {
                let mut episode = EpisodeFacts::default();
                fill(&mut facts, &mut episode, rows);
                episode
            })
            .collect();
        let (mut scorer, mut reward) = (Scorer::new(&preset), EpisodeReward::default());
        let mut sum = 0.0;
        let from_facts = per_second(|number| {
            scorer.score(&mut facts, &prepared[number % EPISODES], &mut reward);
            sum += reward.total();
        });
        let mut buffer = EpisodeFacts::default();
        let from_columns = per_second(|number| {
            fill(&mut facts, &mut buffer, &rows[number % EPISODES]);
            scorer.score(&mut facts, &buffer, &mut reward);
            sum += reward.total();
        });
        let mean = sum / (2 * ROUNDS * EPISODES_A_ROUND) as f64;
        let name = preset.name();
        println!(
            "{name:>20}: {from_facts:>9.0} episodes/s from facts, {from_columns:>8.0} from texts (mean reward {mean:.4})"
        );
    }
}

/// The best round of calls.
#[expect(clippy::disallowed_types, reason = "a measurement needs a clock")]
fn per_second(mut call: impl FnMut(usize)) -> f64 {
    let mut best = 0.0_f64;
    for _ in 0..ROUNDS {
        let start = std::time::Instant::now();
        (0..EPISODES_A_ROUND).for_each(&mut call);
        best = best.max(EPISODES_A_ROUND as f64 / start.elapsed().as_secs_f64());
    }
    best
}

fn all_terms(base: &str) -> Preset {
    let text = format!("name = 'all-of-{base}'\nbase = '{base}'\n[rules]\nanti_exploit = true");
    Preset::from_toml(&text).expect("a preset of ours is good")
}

fn fill(facts: &mut TaskFacts, episode: &mut EpisodeFacts, rows: &[Row]) {
    facts.begin(episode);
    for row in rows {
        let call = facts.called(row.tool, None, row.argument);
        let head = StepHead {
            trainer_reading: facts.trainer_reading(&call, &row.text),
            error: row.error.then_some(reel_world::ErrorClass::Moderate),
            object: row.object.map(|object| facts.object(object)),
            receptacle: row.receptacle.map(|place| facts.receptacle(place)),
            held: row.held.map(|object| facts.object(object)),
            reply: row.reply.as_deref().map(|text| facts.text(text)),
            ..call
        };
        episode.step(head);
        if let Some((event, place)) = row.change {
            let change = facts
                .change(event, row.object, place, Some("closed"), Some("open"))
                .expect("a row of ours is a change");
            episode.change(Authority::Physics, change);
            episode.change(Authority::Registry, change);
        }
        for object in &row.seen {
            episode.push_visible(facts.object(object));
        }
        if let Some(markers) = &row.markers {
            episode.set_markers();
            for (number, object) in markers.iter().enumerate() {
                episode.mark(number as u32, MarkerReferent::Object(facts.object(object)));
            }
        }
    }
}

/// Twelve steps: look, ask, open, carry, with a wrong pick in every second episode.
fn episode(task: &Task, number: usize) -> Vec<Row> {
    let row = |tool, argument| Row {
        tool,
        argument,
        error: false,
        object: None,
        receptacle: None,
        held: None,
        reply: None,
        text: format!(
            "You are at the coffee table. {tool} shows: 1: a remote control, 2: a remote control, 3: a vase."
        ),
        change: None,
        seen: vec![],
        markers: None,
    };
    let drive = |to| Row {
        receptacle: Some(to),
        markers: Some(vec![]),
        ..row("nav_to", Some(to))
    };
    let on_table: Vec<String> = task
        .objects
        .iter()
        .take(4)
        .map(|object| object.instance.to_string())
        .collect();
    let look = || Row {
        seen: on_table.clone(),
        markers: Some(on_table.clone()),
        ..row("walk_around", None)
    };
    let pick = |object, marker| Row {
        object: Some(object),
        held: Some(object),
        change: Some(("remove", "coffeetable_0")),
        ..row("pick", Some(marker))
    };
    let place = |object, place| Row {
        object: Some(object),
        receptacle: Some(place),
        change: Some(("add", place)),
        ..row("place", Some("7"))
    };
    let reply = Some(format!(
        "I mean the {} one.",
        ["black", "slim", "grey"][number % 3]
    ));
    let mut rows = vec![
        drive("coffeetable_0"),
        look(),
        Row {
            reply,
            ..row("ask", None)
        },
        drive("cabinet_3"),
    ];
    rows.push(Row {
        receptacle: Some("cabinet_3"),
        change: Some(("door", "cabinet_3")),
        ..row("open", Some("1"))
    });
    rows.extend([drive("coffeetable_0"), look()]);
    if number.is_multiple_of(2) {
        rows.extend([pick(OTHER, "1"), place(OTHER, "coffeetable_0")]);
    } else {
        rows.extend([
            Row {
                error: true,
                ..row("gaze_at", Some("9"))
            },
            row("gaze_at", Some("0")),
        ]);
    }
    rows.extend([
        pick(TARGET, "0"),
        place(TARGET, "cabinet_3"),
        row("finish", None),
    ]);
    rows
}

/// As large as REAL-Bench's flat: 26 receptacles and 14 objects.
fn flat() -> (Task, Scene) {
    let names: Vec<String> = (0..25)
        .map(|number| format!("cabinet_{number}"))
        .chain(["coffeetable_0".to_owned()])
        .collect();
    let receptacle = |id: &String| {
        json!({ "id": id, "room": "living room", "category": "cabinet", "door": id == "cabinet_3",
                "surface_min": [0.0, 0.0, 0.5], "surface_max": [1.0, 1.0, 0.6] })
    };
    let scene = json!({ "scene_id": "flat", "rooms": [], "receptacles": names.iter().map(receptacle).collect::<Vec<_>>() });
    let scene: Scene = serde_json::from_value(scene).expect("the scene is well formed");
    let object = |instance: &str, category: &str, caption: &str, place: &str| -> Value {
        json!({ "instance": instance, "asset": instance.split_once("_on_").map(|(asset, _)| asset), "category": category,
                "caption": caption, "size": [0.1, 0.1, 0.1], "position": [0.0, 0.0, 0.0], "receptacle": place })
    };
    let mut objects = vec![
        object(
            TARGET,
            "remote control",
            "Slim black remote control.",
            "coffeetable_0",
        ),
        object(
            OTHER,
            "remote control",
            "Grey remote control.",
            "coffeetable_0",
        ),
    ];
    for number in 0..12 {
        let place = if number < 2 {
            "coffeetable_0".to_owned()
        } else {
            format!("cabinet_{number}")
        };
        let instance = format!("vase_{number:04x}_on_{place}_at_SUL/verify_task_10");
        objects.push(object(&instance, "vase", "White vase.", &place));
    }
    let objects: Vec<reel_world::ObjectInstance> =
        serde_json::from_value(objects.into()).expect("the objects are well formed");
    let initial = Task::initial_graph(&scene, &objects);
    let mut goal = initial.clone();
    goal.remove(&"coffeetable_0".into(), &TARGET.into());
    goal.add(&"cabinet_3".into(), &TARGET.into());
    let instruction = "Take the remote control from the coffee table and put it into the cabinet.";
    let task = json!({ "task_id": "SUL/verify_task_10", "family": "SUL", "scene_id": "flat", "instruction": instruction,
                       "precise_instruction": instruction, "fuzzy": true, "objects": objects, "initial": initial, "goal": goal,
                       "target": TARGET, "src": "coffeetable_0", "dest": "cabinet_3" });
    (
        serde_json::from_value(task).expect("the task is well formed"),
        scene,
    )
}
